"""Common functions and base classes of scripted policies."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.kernels.jit import inner, kernel
from chemlab.roles.bench import CAMERA_PIXELS, Bench, Channel, channel_slices
from chemlab.roles.instrument_table import InstrumentTable
from chemlab.roles.manager_actions import ManagerActions
from chemlab.roles.manager_view import order_channels
from chemlab.roles.operation_bench import OperationBench

M = TypeVar("M")

SAME_SHADE = 1e-3
"""Grey values closer than this belong to the same material."""
_SAME = np.float32(SAME_SHADE)


def choices(bench: OperationBench, kind: str, **which: str) -> dict[float, int]:
    """Return {magnitude: action} of a process, see :meth:`~chemlab.roles.operation_bench.OperationBench.choices`.

    Raises:
        ValueError: the bench has no such process.
    """
    if found := bench.choices(kind, **which):
        return found
    words = "".join(f", {name} {value}" for name, value in which.items())
    raise ValueError(
        f"benches.{bench.key}: its scripted policy needs a process {kind!r}{words}; add it, or choose another policy "
        "(of evaluate, also --baseline)"
    )


def revealed_column(bench: Bench, draw: str) -> int:
    """Return the column of the first number of a revealed draw in a bench's observation."""
    before = bench.scenario.world.numbers(bench.told[: bench.told.index(draw)])
    return int(channel_slices(bench.channels)["told"].start) + before


def cheapest(scenario: Scenario, kinds: Collection[str]) -> str | None:
    """Return the cheapest instrument of some kinds whose readings the manager observes, or None."""
    specs = scenario.seen_instruments
    return min((n for n in specs if specs[n].kind in kinds), key=lambda n: specs[n].price, default=None)


def midpoints(count: int) -> FloatArray:
    """Return the midpoints of ``count`` equal parts of [0, 1]."""
    return np.asarray((np.arange(count) + 0.5) / count)


def squared_distance(readings: FloatArray, expected: FloatArray, variance: FloatArray) -> FloatArray:
    """Return [..., K] squared distances of readings from expected values, in units of the variance.

    Args:
        readings: [..., size] readings.
        expected: [K, size] expected values.
        variance: [size] variance of each number.
    """
    distance = np.zeros((*readings.shape[:-1], len(expected)))
    for number in range(readings.shape[-1]):  # several times as fast as a sum over the short last axis
        square = readings[..., number, None] - expected[:, number]
        square *= square
        square /= variance[number]
        distance += square
    return distance


def likelihood(readings: FloatArray, expected: FloatArray, noise: float, least: float) -> FloatArray:
    """Return [..., K] likelihoods of readings, relative to that of the nearest expected value.

    Args:
        readings: [..., size] readings.
        expected: [K, size] expected values.
        noise: standard deviation of each number.
        least: lower bound of a relative likelihood.
    """
    rows = np.ascontiguousarray(readings.reshape(-1, readings.shape[-1]), dtype=np.float64)
    out = np.zeros((len(rows), len(expected)))
    _likelihood(rows, np.ascontiguousarray(expected.T), noise**2, least, out)
    return out.reshape(*readings.shape[:-1], len(expected))


_VANISHES = 38.0
"""exp(-x) at this x is below half of the last digit of 1."""


@kernel
def _likelihood(readings: FloatArray, expected: FloatArray, variance: float, least: float, out: FloatArray) -> None:
    """Fill ``out`` [B, K] with likelihoods of readings [B, R] given expected values [R, K]."""
    count = out.shape[1]
    vanishes = np.log(least) - _VANISHES
    for b in range(out.shape[0]):
        for r in range(readings.shape[1]):
            for k in range(count):
                off = readings[b, r] - expected[r, k]
                out[b, k] += off * off
        lowest = np.inf
        for k in range(count):
            out[b, k] /= variance
            lowest = min(lowest, out[b, k])
        for k in range(count):
            power = -0.5 * (out[b, k] - lowest)
            out[b, k] = np.exp(power) + least if power > vanishes else least


@inner
def shows(picture: ObservationArray, shade: float) -> int:
    """Count the pixels of an observed picture, which come first, that have one grey value."""
    count = 0
    for x in range(CAMERA_PIXELS):
        count += abs(picture[x] - shade) < _SAME
    return count


class Setting(NamedTuple):
    """A scripted manager's laboratory and options.

    Attributes:
        scenario: the public scenario.
        channels: the manager's observation channels.
        actions: the manager's actions.
        instruments: the scenario's instruments.
        positions: number of vessel positions of each bench.
        careful: False omits steps that serve only safety and measurement.
        skip: benches that are not used.
        margin_k: temperature margin of the benches, see :class:`.reaction.ScriptedReaction`.
    """

    scenario: Scenario
    channels: Sequence[Channel]
    actions: ManagerActions
    instruments: InstrumentTable
    positions: Mapping[str, int]
    careful: bool = True
    skip: Collection[str] = ()
    margin_k: float | None = 0.0


class ScriptedManager(Generic[M]):
    """Base class of scripted managers, which decide for one laboratory at a time from their memory of its episode.

    Args:
        setting: the manager's laboratory.
    """

    def __init__(self, setting: Setting) -> None:
        self._scenario, self._actions = setting.scenario, setting.actions
        self._slices = channel_slices(setting.channels)
        self._orders = [name for name, _ in order_channels(setting.scenario)]
        self._kept: dict[int, M] = {}
        self._memories: list[dict[int, Any]] = [self._kept]
        self._advised: dict[int, tuple[int, bytes, ObservationArray]] = {}
        """Advice to be confirmed by environment index: action, pickled memory before it, and observation."""

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        decided = self.advise(observation, mask, step, members, copied=False)
        self._advised.clear()
        return decided

    def advise(
        self,
        observation: ObservationArray,
        mask: MaskArray | None,
        step: IntArray,
        members: IntArray,
        copied: bool = True,
    ) -> npt.NDArray[Any]:
        """Return the actions the manager would play; they become decisions when :meth:`played` confirms them.

        Args:
            observation, mask, step, members: as for :meth:`act`.
            copied: False keeps no copy of the memory, so that the decision cannot be undone.
        """
        assert mask is not None, "the manager has discrete actions"
        decided = np.zeros(len(members), dtype=np.int64)
        for n, (o, m, s, i) in enumerate(zip(observation, mask, step.tolist(), members.tolist(), strict=True)):
            if s == 0:
                for memory in self._memories:
                    memory.pop(i, None)
            elif all(memory.get(i) is None for memory in self._memories):
                s = 0  # the first decision was not played
            self._observe(o, s, i)
            before = pickle.dumps([memory.get(i) for memory in self._memories], -1) if copied else b""
            decided[n] = self._decide(o, m, s, i)
            self._advised[i] = int(decided[n]), before, o
        return decided

    def played(self, actions: IntArray, members: IntArray) -> None:
        """Confirm the played actions; a decision that differs from the played action is undone.

        Args:
            actions, members: [B] actions and environment indices.
        """
        for action, i in zip(actions.tolist(), members.tolist(), strict=True):
            decided, pickled, seen = self._advised.pop(i)
            if action != decided:
                for memory, before in zip(self._memories, pickle.loads(pickled), strict=True):
                    memory[i] = before
                self._replace_decision(seen, action, i)

    def get_memory(self) -> Any:
        """See :class:`chemlab.envs.players.Policy`; advice that waits for :meth:`played` is part of the memory."""
        return copy.deepcopy([*self._memories, self._advised])

    def set_memory(self, memory: Any) -> None:
        """See :class:`chemlab.envs.players.Policy`."""
        for current, restored in zip([*self._memories, self._advised], copy.deepcopy(memory), strict=True):
            current.clear()
            current.update(restored)

    def _observe(self, observation: ObservationArray, step: int, member: int) -> None:
        """Update the memory with an observation before the decision."""

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        """Return the action to play, and update the memory with it."""
        raise NotImplementedError

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        """Update the memory with an action that was played instead of the manager's decision."""

    def _decode(self, action: int) -> tuple[str, int, list[Any]]:
        """Return (kind, slot of its vessel or -1, other arguments) of an action; a submission has its order."""
        kind, *arguments = self._actions.decode(action)
        position = {"start": 1, "measure": 0, "submit": 0, "discard": 0}.get(str(kind))
        slot = -1 if position is None else int(arguments.pop(position))
        return str(kind), slot, [0] if kind == "submit" and not arguments else list(arguments)

    def _encode_submit(self, slot: int, order: int) -> int:
        """Return the action that submits a slot's vessel for an order."""
        return self._actions.encode("submit", slot, *([order] if len(self._orders) > 1 else []))

    def _occupied(self, observation: ObservationArray) -> list[int]:
        """Return the occupied slots."""
        return [s for s in range(self._actions.slots) if self._value(observation, f"slot_{s}_occupied") > 0.5]

    def _value(self, observation: ObservationArray, name: str) -> float:
        """Return the first number of a channel."""
        return float(observation[self._slices[name]][0])
