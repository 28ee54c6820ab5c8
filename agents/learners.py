"""Stable-Baselines3's learners as checkpoints have them: ``model.zip`` of one, ``ROLE.zip`` of several that learned
together.

Needs the extra: ``pip install "chemlab-marl[train]"``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

try:
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
    from stable_baselines3.common.base_class import BaseAlgorithm
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install "chemlab-marl[train]"') from error

__all__ = ["LEARNERS", "load_learner", "load_team", "save_team"]

LEARNERS: dict[str, Any] = {"ppo": PPO, "a2c": A2C, "dqn": DQN, "sac": SAC, "td3": TD3, "maskable-ppo": MaskablePPO}
"""By the name that ``chemlab train --algo`` has for it."""


def load_learner(folder: Path, algo: str) -> BaseAlgorithm:
    """The learner of a checkpoint, to play with rather than to go on learning."""
    small = {"buffer_size": 1} if algo in ("dqn", "sac", "td3") else {}
    model: BaseAlgorithm = LEARNERS[algo].load(folder / "model.zip", device="cpu", **small)
    return model


def save_team(folder: Path, models: dict[str, Any]) -> None:
    """Write learners, by role, for :func:`load_team`."""
    for role, model in models.items():
        model.save(folder / (f"{role}.maskable.zip" if isinstance(model, MaskablePPO) else f"{role}.zip"))


def load_team(folder: Path) -> dict[str, Any]:
    """The learners of a joint run's checkpoint, by role."""
    found = {}
    for file in sorted(folder.glob("*.zip")):
        kind = MaskablePPO if "maskable" in file.stem else PPO
        found[file.stem.partition(".")[0]] = kind.load(file, device="cpu")
    return found
