"""Adapters between policies with continuous and with discretised actions of a bench."""

from __future__ import annotations

from typing import Any

import numpy as np

from chemlab.envs.players import Actions, Policy
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.roles.discrete import Discretised


class _Adapter:
    """Base class of adapters; memory and random numbers are those of the wrapped policy."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def __getattr__(self, name: str) -> Any:
        if name not in ("seed", "get_memory", "set_memory"):
            raise AttributeError(name)
        return getattr(self._policy, name)


class NearestPolicy(_Adapter):
    """Plays a continuous policy on a discretised bench: each action is mapped to the nearest representative one.

    Args:
        policy: the continuous policy.
        bench: the discretised bench.
    """

    def __init__(self, policy: Policy, bench: Discretised) -> None:
        super().__init__(policy)
        self._bench = bench

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        return self._bench.nearest(self._policy.act(observation, None, step, members))


class ChoosingPolicy(_Adapter):
    """Plays a discrete policy on the bench with continuous actions: each choice is mapped to the vector it represents.

    Args:
        policy: the discrete policy.
        rows: [A, n] vectors of the discrete actions.
    """

    def __init__(self, policy: Policy, rows: FloatArray) -> None:
        super().__init__(policy)
        self._rows = rows

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        legal = np.ones((len(observation), len(self._rows)), dtype=np.int8)
        return np.asarray(self._rows[self._policy.act(observation, legal, step, members)])
