"""Stable-Baselines3 learners in checkpoints, as ``model.zip``.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

from chemlab.config.extras import needs

from .seals import read_sealed, seal_file

with needs("training needs Stable-Baselines3", "train"):
    from sb3_contrib import QRDQN, MaskablePPO, RecurrentPPO
    from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
    from stable_baselines3.common.base_class import BaseAlgorithm

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
"""Learner classes by their name in ``chemlab train --algo``."""


def save_learner(folder: Path, model: BaseAlgorithm) -> None:
    """Write a learner for :func:`load_learner`."""
    model.save(folder / "model.zip")
    seal_file(folder / "model.zip")


def load_learner(folder: Path, algo: str, **settings: Any) -> BaseAlgorithm:
    """Load the learner of a checkpoint, for playing instead of further training.

    Args:
        folder: folder of the checkpoint.
        algo: a name of ``LEARNERS``.
        settings: further arguments of SB3's ``load``: with ``env`` it can be trained further.

    Raises:
        ValueError: the algorithm is unknown.
        DataError: the file has no valid signature.
    """
    if algo not in LEARNERS:
        raise ValueError(f"{folder}: algo: must be one of {', '.join(LEARNERS)}; given {algo!r:.100}")
    small = {"buffer_size": 1} if algo in ("dqn", "qr-dqn", "sac", "td3") and not settings else {}
    file = BytesIO(read_sealed(folder / "model.zip"))  # it contains a pickle, so its signature is checked
    model: BaseAlgorithm = LEARNERS[algo].load(file, device="cpu", **small, **settings)
    return model
