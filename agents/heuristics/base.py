"""What scripted policies have in common."""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from chemlab.arrays import IntArray, MaskArray, ObservationArray
from chemlab.bench.base import Channel, channel_slices
from chemlab.instruments.table import InstrumentTable
from chemlab.laboratory.actions import ManagerActions
from chemlab.laboratory.view import order_channels
from chemlab.scenario import Scenario

__all__ = ["SAME_SHADE", "ScriptedManager", "Setting", "cheapest", "count_pixels"]

M = TypeVar("M")

SAME_SHADE = 1e-3
"""Grey values closer than this are the same material."""


def cheapest(scenario: Scenario, kinds: Collection[str]) -> str | None:
    """Of a scenario's instruments of some kinds, whose readings the manager sees, the one whose reading costs least;
    none if there is none."""
    specs = scenario.seen_instruments
    return min((n for n in specs if specs[n].kind in kinds), key=lambda n: specs[n].price, default=None)


def count_pixels(picture: ObservationArray, shades: Iterable[float]) -> int:
    """How many pixels of a picture [pixels] show one of some materials, by their grey values."""
    return sum(int(np.count_nonzero(np.abs(picture - shade) < SAME_SHADE)) for shade in shades)


class Setting(NamedTuple):
    """What a scripted manager is told of its laboratory, and what it is to do without.

    Attributes:
        scenario: the public scenario.
        channels: the manager's observation channels.
        actions: the manager's actions.
        instruments: the scenario's instruments.
        positions: how many vessels each bench works on.
        careful: False leaves out what only safety and measuring are for.
        skip: benches it does without.
    """

    scenario: Scenario
    channels: Sequence[Channel]
    actions: ManagerActions
    instruments: InstrumentTable
    positions: Mapping[str, int]
    careful: bool = True
    skip: Collection[str] = ()


class ScriptedManager(Generic[M]):
    """A manager that decides for one laboratory at a time, by what it keeps of it.

    Args:
        setting: what it is told.
    """

    def __init__(self, setting: Setting) -> None:
        self._scenario, self._actions = setting.scenario, setting.actions
        self._slices = channel_slices(setting.channels)
        self._orders = [name for name, _ in order_channels(setting.scenario)]
        self._kept: dict[int, M] = {}

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policies.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        return np.array(
            [self._decide(o, m, int(s), int(i)) for o, m, s, i in zip(observation, mask, step, members, strict=True)],
            dtype=np.int64,
        )

    def get_memory(self) -> Any:
        """See :class:`chemlab.laboratory.policy.Policy`."""
        return copy.deepcopy(self._kept)

    def set_memory(self, memory: Any) -> None:
        """See :class:`chemlab.laboratory.policy.Policy`."""
        self._kept = copy.deepcopy(memory)

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        raise NotImplementedError

    def _value(self, observation: ObservationArray, name: str) -> float:
        """The first number of a channel."""
        return float(observation[self._slices[name]][0])
