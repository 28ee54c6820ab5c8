"""Discretised actions of continuous benches, for value-based learners: ``actions = "discrete"``."""

from __future__ import annotations

from functools import cache
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ..kernels.arrays import FloatArray, IntArray, MaskArray
from ..physics.shelf import Shelf
from .bench import Bench, Experiments, check_discrete


class Discretised(Bench):
    """Mixin of a discretised bench: see :func:`discretised`.

    Attributes:
        action_rows: [A, n] continuous action of each discrete one; the last changes nothing. All are always legal.
    """

    action_rows: FloatArray
    _words: list[str]

    def _set_spaces(self, channels: Any, action_space: gymnasium.Space[Any]) -> None:
        known = self.representative_actions()
        self._words, self.action_rows = [words for words, _ in known], np.array([row for _, row in known])
        super()._set_spaces(channels, gymnasium.spaces.Discrete(len(known)))

    @property
    def action_meanings(self) -> list[str]:
        return list(self._words)

    def act(self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]) -> None:
        super().act(shelf, experiments, members, self.action_rows[actions])  # type: ignore[safe-super]

    def mask(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: MaskArray) -> None:
        out[:] = 1

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        return np.array([check_discrete(agent, action, len(self.action_rows))])

    def nearest(self, actions: FloatArray) -> IntArray:
        """Return [B] the nearest discrete action of each continuous one of [B, n] (least squares)."""
        distance = ((np.asarray(actions)[:, None, :] - self.action_rows) ** 2).sum(axis=2)
        return np.asarray(distance.argmin(axis=1), dtype=np.int64)

    def __reduce_ex__(self, protocol: Any) -> Any:
        # The class is created at run time, so copies and pickles refer to its base class.
        return _empty, (type(self).__mro__[2],), vars(self)


@cache
def discretised(kind: type[Bench]) -> type[Bench]:
    """Return a bench class with its :meth:`~chemlab.roles.bench.Bench.representative_actions` as discrete actions."""
    doc = f"{kind.__doc__ or kind.__name__}\n\n    Discretised: an action is the number of a representative one.\n    "
    return type(f"Discrete{kind.__name__}", (Discretised, kind), {"__doc__": doc, "__module__": kind.__module__})


def _empty(kind: type[Bench]) -> Bench:
    cls = discretised(kind)
    return cls.__new__(cls)
