"""Infos of numbers only, for clients that make tensors of them: ``plain_infos``.

Such clients (TorchRL's ``PettingZooWrapper``) read off what there is at the first reset and expect the same keys and
shapes ever after; the laboratory's own infos are for people, with items by name and only what has happened.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import BaseParallelWrapper, BaseWrapper

from .common import OneLaboratory
from .core import MANAGER_AGENT

__all__ = ["plain_infos"]

Environment = TypeVar("Environment", AECEnv[str, Any, Any], ParallelEnv[str, Any, Any])
Infos = dict[str, dict[str, Any]]

_COPIED = ("cost", "illegal_action", "elapsed_ticks", "has_turn")


def plain_infos(env: Environment) -> Environment:
    """The laboratory, AEC or parallel, with infos whose keys, shapes and types never change.

    Every agent's info has ``cost``, ``illegal_action``, ``elapsed_ticks`` (in AEC 0 without the turn),
    ``experiment_over``, ``score`` (of the experiment; 0 unless it is over) and ``events`` [kinds, as in
    :attr:`chemlab.scenario.Scenario.safety_events`]; where actions are discrete ``action_mask``, which without the turn
    allows one action only; in the parallel environment ``has_turn``. The manager's has ``costs`` [items, as in
    :data:`chemlab.laboratory.state.COST_ITEMS`], and ``submitted_mol`` and ``purity`` (0 until the end).

    Args:
        env: :func:`chemlab.laboratory.env`, ``raw_env`` or ``parallel_env``, bare or in PettingZoo's wrappers.

    Raises:
        TypeError: it is no laboratory.
    """
    laboratory = env.unwrapped
    if not isinstance(laboratory, OneLaboratory):
        raise TypeError(f"plain_infos needs chemlab's laboratory, given {env!r}")
    return _PlainParallel(env, laboratory) if isinstance(env, ParallelEnv) else _PlainAEC(env, laboratory)


class _Plain:
    """What one laboratory's infos become."""

    def __init__(self, laboratory: OneLaboratory) -> None:
        labs = laboratory.laboratories
        self._resting: dict[str, npt.NDArray[np.int8]] = {}
        for agent, action, count in zip(labs.agents, labs.resting_actions, labs.action_counts, strict=True):
            if count:
                self._resting[agent] = (np.arange(count) == action).astype(np.int8)
        self._labs = labs

    def infos(self, infos: Mapping[str, Mapping[str, Any]]) -> Infos:
        """All agents' infos."""
        return {agent: self._info(agent, info) for agent, info in infos.items()}

    def _info(self, agent: str, info: Mapping[str, Any]) -> dict[str, Any]:
        plain = {"elapsed_ticks": 0, **{name: info[name] for name in _COPIED if name in info}}
        plain["experiment_over"] = "score" in info
        plain["score"] = info.get("score", 0.0)
        plain["events"] = np.array([info["events"].get(kind, 0.0) for kind in self._labs.scenario.safety_events])
        if agent in self._resting:
            mask = info.get("action_mask")
            plain["action_mask"] = self._resting[agent].copy() if mask is None else mask
        if agent == MANAGER_AGENT:
            plain["costs"] = np.array(list(self._labs.costs().values()))
            plain["submitted_mol"], plain["purity"] = info.get("submitted_mol", 0.0), info.get("purity", 0.0)
        return plain


class _PlainAEC(BaseWrapper[str, npt.NDArray[np.float32], Any]):  # type: ignore[misc]  # PettingZoo ships no types
    def __init__(self, env: AECEnv[str, Any, Any], laboratory: OneLaboratory) -> None:
        super().__init__(env)
        self.plain = _Plain(laboratory)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        self.env.reset(seed=seed, options=options)
        self.infos = self.plain.infos(self.env.infos)

    def step(self, action: Any) -> None:
        self.env.step(action)
        self.infos = self.plain.infos(self.env.infos)


class _PlainParallel(BaseParallelWrapper[str, npt.NDArray[np.float32], Any]):  # type: ignore[misc]  # PettingZoo ships no types
    def __init__(self, env: ParallelEnv[str, Any, Any], laboratory: OneLaboratory) -> None:
        super().__init__(env)
        self.plain = _Plain(laboratory)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, npt.NDArray[np.float32]], Infos]:
        observations, infos = self.env.reset(seed=seed, options=options)
        return observations, self.plain.infos(infos)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, npt.NDArray[np.float32]], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        *results, infos = self.env.step(actions)
        return (*results, self.plain.infos(infos))
