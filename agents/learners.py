"""Stable-Baselines3's learners as checkpoints have them: ``model.zip`` of one, ``ROLE.zip`` of several that learned
together.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

from chemlab.config.datafile import DataError

from .seals import read_sealed, seal_file

try:
    from sb3_contrib import QRDQN, MaskablePPO, RecurrentPPO
    from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
    from stable_baselines3.common.base_class import BaseAlgorithm
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install ".[train]"') from error

__all__ = ["LEARNERS", "load_learner", "load_team", "save_learner", "save_team"]

LEARNERS: dict[str, Any] = {
    "ppo": PPO,
    "a2c": A2C,
    "dqn": DQN,
    "qr-dqn": QRDQN,
    "sac": SAC,
    "td3": TD3,
    "maskable-ppo": MaskablePPO,
    "recurrent-ppo": RecurrentPPO,
    "maskable-recurrent-ppo": RecurrentPPO,
}
"""By the name that ``chemlab train --algo`` has for it."""


def _load(kind: Any, path: Path, **settings: Any) -> Any:
    """A learner's file: a pickle among others, so sealed (:mod:`~chemlab.agents.seals`)."""
    return kind.load(BytesIO(read_sealed(path)), device="cpu", **settings)


def save_learner(folder: Path, model: BaseAlgorithm) -> None:
    """Write a learner for :func:`load_learner`."""
    model.save(folder / "model.zip")
    seal_file(folder / "model.zip")


def load_learner(folder: Path, algo: str, **settings: Any) -> BaseAlgorithm:
    """The learner of a checkpoint, to play with rather than to go on learning.

    Args:
        folder: the checkpoint's.
        algo: a name of ``LEARNERS``.
        settings: more of SB3's ``load``: with ``env`` it can go on learning.

    Raises:
        ValueError: unknown algorithm.
        DataError: the file is not this user's.
    """
    if algo not in LEARNERS:
        raise ValueError(f"{folder}: algo: known: {', '.join(LEARNERS)}; given {algo!r:.100}")
    small = {"buffer_size": 1} if algo in ("dqn", "qr-dqn", "sac", "td3") and not settings else {}
    model: BaseAlgorithm = _load(LEARNERS[algo], folder / "model.zip", **small, **settings)
    return model


def save_team(folder: Path, models: dict[str, Any]) -> None:
    """Write learners, by role, for :func:`load_team`."""
    for role, model in models.items():
        path = folder / (f"{role}.maskable.zip" if isinstance(model, MaskablePPO) else f"{role}.zip")
        model.save(path)
        seal_file(path)


def load_team(folder: Path) -> dict[str, Any]:
    """The learners of a joint run's checkpoint, by role.

    Raises:
        DataError: a file is not this user's, or of a chemlab that made other networks of it.
    """
    found = {}
    for file in sorted(folder.glob("*.zip")):
        kind = MaskablePPO if "maskable" in file.stem else PPO
        try:
            found[file.stem.partition(".")[0]] = _load(kind, file)
        except RuntimeError as error:  # torch's, of weights that do not fit
            raise DataError(f"{file}: was saved by a chemlab that made other networks of it: train it anew") from error
    return found
