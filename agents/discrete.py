"""Policies across the two kinds of actions of a bench: numbers, or a choice among representative ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.envs.players import Policy
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.roles.discrete import Discretised

__all__ = ["ChoosingPolicy", "NearestPolicy"]


class _Around:
    """A policy that plays as another does, in other words: what it remembers and draws is the other's."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def __getattr__(self, name: str) -> Any:
        if name not in ("seed", "get_memory", "set_memory"):
            raise AttributeError(name)
        return getattr(self._policy, name)


class NearestPolicy(_Around):
    """A policy with continuous actions on a discretised bench: the representative action most like each.

    Args:
        policy: what is played.
        bench: where.
    """

    def __init__(self, policy: Policy, bench: Discretised) -> None:
        super().__init__(policy)
        self._bench = bench

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        return self._bench.nearest(self._policy.act(observation, None, step, members))


class ChoosingPolicy(_Around):
    """A policy of a discretised bench on the bench with continuous actions: the numbers that its choice stands for.

    Args:
        policy: what is played.
        rows: [A, n] what every discrete action stands for.
    """

    def __init__(self, policy: Policy, rows: FloatArray) -> None:
        super().__init__(policy)
        self._rows = rows

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        legal = np.ones((len(observation), len(self._rows)), dtype=np.int8)
        return np.asarray(self._rows[self._policy.act(observation, legal, step, members)])
