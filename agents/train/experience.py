"""Experience of learners that take turns: every agent's transitions extend from one of its own turns to the next.

Rewards of an agent between two of its turns belong to the first. A bench's episode is an experiment and ends with the
experiment's score. The manager's episode is the laboratory's.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray

__all__ = ["Experience"]

_NONE = -1


class Experience:
    """The transitions of one role in the order of their start: S streams (agent and laboratory) side by side.

    Args:
        observation_space, action_space: spaces of the role.
        streams: number of streams S.
    """

    def __init__(
        self, observation_space: gymnasium.spaces.Box, action_space: gymnasium.Space[Any], streams: int
    ) -> None:
        self.streams, self._width = streams, observation_space.shape[0]
        self._actions = () if isinstance(action_space, gymnasium.spaces.Discrete) else (action_space.shape or ())
        self._masked = int(action_space.n) if isinstance(action_space, gymnasium.spaces.Discrete) else 0
        self._open: IntArray = np.full(streams, _NONE, dtype=np.int64)
        """[S] row of the stream's open transition, which its next turn completes, or -1"""
        self._allocate(1024)
        self._rows = 0

    def _allocate(self, rows: int) -> None:
        self.observation: ObservationArray = np.zeros((rows, self._width), dtype=np.float32)
        self.mask: MaskArray = np.zeros((rows, self._masked), dtype=np.int8)
        self.action: FloatArray = np.zeros((rows, *self._actions))
        self.value: FloatArray = np.zeros(rows)
        self.log_probability: FloatArray = np.zeros(rows)
        self.reward: FloatArray = np.zeros(rows)
        self.elapsed: IntArray = np.zeros(rows, dtype=np.int64)
        self.done: BoolArray = np.zeros(rows, dtype=np.bool_)
        self.next_row: IntArray = np.full(rows, _NONE, dtype=np.int64)

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return the columns, one row per transition."""
        return [
            self.observation,
            self.mask,
            self.action,
            self.value,
            self.log_probability,
            self.reward,
            self.elapsed,
            self.done,
            self.next_row,
        ]

    def __len__(self) -> int:
        return self._rows

    def begin(
        self,
        streams: IntArray,
        observation: ObservationArray,
        mask: MaskArray | None,
        action: npt.NDArray[Any],
        value: FloatArray,
        log_probability: FloatArray,
        tick: IntArray,
    ) -> None:
        """Add a turn in each of ``streams`` [B]: it completes the open transition there, and opens another.

        ``tick`` [B] is the laboratory's clock, for the elapsed ticks of a transition.
        """
        count = len(streams)
        while self._rows + count > len(self.value):
            self._grow()
        rows = np.arange(self._rows, self._rows + count)
        before = self._open[streams]
        known = before != _NONE
        self.next_row[before[known]] = rows[known]
        self.elapsed[before[known]] += tick[known]
        self.observation[rows], self.action[rows] = observation, action
        if mask is not None:
            self.mask[rows] = mask
        self.value[rows], self.log_probability[rows] = value, log_probability
        self.reward[rows], self.done[rows], self.next_row[rows] = 0.0, False, _NONE
        self.elapsed[rows] = -tick
        self._open[streams] = rows
        self._rows += count

    def _grow(self) -> None:
        old = self.arrays()
        self._allocate(2 * len(self.value))
        for array, kept in zip(self.arrays(), old, strict=True):
            array[: len(kept)] = kept

    def earn(self, streams: IntArray, reward: FloatArray) -> None:
        """Add to the rewards of the open transitions of ``streams`` [B]; a stream without one is ignored."""
        rows = self._open[streams]
        known = rows != _NONE
        np.add.at(self.reward, rows[known], reward[known])

    def end(self, streams: IntArray, tick: IntArray) -> None:
        """End the episodes of ``streams`` [B]: their open transitions are terminal."""
        rows = self._open[streams]
        known = rows != _NONE
        self.done[rows[known]] = True
        self.elapsed[rows[known]] += tick[known]
        self._open[streams] = _NONE

    def abandon(self) -> None:
        """Leave open transitions incomplete: the episodes restart."""
        self._open[:] = _NONE

    def finished(self) -> IntArray:
        """Return the rows of complete transitions: the next turn of their stream is known, or the episode has ended."""
        complete = self.done[: self._rows] | (self.next_row[: self._rows] != _NONE)
        return np.flatnonzero(complete)

    def advantages(self, gamma: float, gae_lambda: float, by_ticks: bool) -> FloatArray:
        """Return [rows] generalized advantage estimates along each stream.

        Open transitions are not estimated; the preceding one bootstraps from their value. With ``by_ticks`` a step is
        discounted by gamma to the power of its ticks (at least gamma once), else by gamma.

        Source: Schulman et al. (2016), eq. 16; Sutton, Precup and Singh (1999) for steps of different lengths.
        """
        found = np.zeros(self._rows)
        for row in self.finished()[::-1]:
            if self.done[row]:
                found[row] = self.reward[row] - self.value[row]
                continue
            after = self.next_row[row]
            discount = gamma ** max(int(self.elapsed[row]), 1) if by_ticks else gamma
            found[row] = self.reward[row] + discount * self.value[after] - self.value[row]
            found[row] += discount * gae_lambda * found[after]
        return found

    def whole(self) -> IntArray:
        """Return the rows of finished episodes."""
        ended = self.done[: self._rows].copy()
        for row in range(self._rows - 1, -1, -1):
            ended[row] |= self.next_row[row] != _NONE and ended[self.next_row[row]]
        return np.flatnonzero(ended)

    def forget(self) -> None:
        """Drop complete transitions; open ones are kept and completed by the next turns."""
        kept = np.flatnonzero(~(self.done[: self._rows] | (self.next_row[: self._rows] != _NONE)))
        position = np.full(self._rows, _NONE, dtype=np.int64)
        position[kept] = np.arange(len(kept))
        for array in self.arrays():
            array[: len(kept)] = array[kept]
        still = self._open != _NONE
        self._open[still] = position[self._open[still]]
        self._rows = len(kept)

    def get_state(self) -> dict[str, Any]:
        """Return copies of the open transitions, for :meth:`set_state`; call :meth:`forget` first."""
        return {
            "rows": self._rows,
            "open": self._open.copy(),
            "arrays": [a[: self._rows].copy() for a in self.arrays()],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`get_state`."""
        while len(self.value) < state["rows"]:
            self._allocate(2 * len(self.value))
        self._rows, self._open = state["rows"], state["open"].copy()
        for array, saved in zip(self.arrays(), state["arrays"], strict=True):
            array[: self._rows] = saved
