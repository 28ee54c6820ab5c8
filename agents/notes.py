"""A manager's notes of an episode: the experiments that it has started, and readings that are out of date.

The laboratory forgets a vessel's readings when the vessel goes to a bench, and does not count its experiments. A policy
without other memory needs both where parameters are hidden. All of it follows from its own observations and actions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from chemlab.envs.players import Memory, Remembering
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.base import Workplace
from chemlab.roles.bench import Channel, channel_slices
from chemlab.roles.manager_actions import DISCARD, FIRST, KIND, SECOND, START, SUBMIT

WIDE = 32
"""Readings of more numbers are not remembered."""
_COUNT = 0.1
"""An experiment counts by this, so that notes have the size of observations."""


def remembered_instruments(workplace: Workplace) -> list[Channel]:
    """Return the readings of slot 0 that are remembered of every slot, as channels of the manager."""
    names = {channel.name for channel in workplace.channels}
    return [
        channel
        for channel in workplace.channels
        if channel.name.startswith("slot_0_") and f"{channel.name}_age" in names and channel.size <= WIDE
    ]


def notes_shape(workplace: Workplace) -> tuple[int, int, int, int]:
    """Return the numbers of slots, of notes of each, of kinds of benches (0: none), and of notes of each."""
    scenario, read = workplace.scenario, sum(channel.size for channel in remembered_instruments(workplace))
    kinds = len(scenario.benches)
    return scenario.shelf.slots, read + 2 + kinds, 1 + kinds, read + 1 + kinds


def notes_size(workplace: Workplace) -> int:
    """Return how many numbers :class:`Notes` adds to an observation."""
    slots, of_slot, kinds, of_kind = notes_shape(workplace)
    return slots * of_slot + kinds * of_kind


class Notes(Remembering):
    """The notes of a manager in each laboratory of a batch, with the interface of an advisor.

    Of each slot: its last readings, whether there are any, the number of experiments since, and the number of
    experiments at each kind of bench. Of each kind of bench, and of vessels that were at none: the same of the vessel
    from there that was read last, without the number since.

    Args:
        laboratories: of the scenario whose observations are given.
    """

    def __init__(self, laboratories: Laboratories) -> None:
        workplace, scenario = laboratories.manager.workplace, laboratories.scenario
        self._slots, self._of_slot, self._kinds, _ = notes_shape(workplace)
        slices, names = channel_slices(workplace.channels), list(scenario.benches)
        suffixes = [channel.name.removeprefix("slot_0") for channel in remembered_instruments(workplace)]
        columns = {name: np.arange(part.start, part.stop) for name, part in slices.items()}
        self._read = np.array(
            [[n for suffix in suffixes for n in columns[f"slot_{s}{suffix}"]] for s in range(self._slots)], dtype=int
        ).reshape(self._slots, -1)
        self._age = np.array(
            [
                [columns[f"slot_{s}{suffix}_age"][0] for suffix in suffixes for _ in columns[f"slot_{s}{suffix}"]]
                for s in range(self._slots)
            ],
            dtype=int,
        ).reshape(self._slots, -1)
        self._last = np.stack([columns[f"slot_{s}_last_bench"] for s in range(self._slots)])
        self._table = laboratories.actions.table
        self._kind = np.array([names.index(agent.rpartition("_")[0]) for agent in scenario.bench_agents()])
        self.size = notes_size(workplace)
        self._memory = Memory(self.size)

    def _parts(self, notes: Any) -> tuple[Any, Any]:
        """Return views [B, slots, notes] and [B, kinds, notes] of notes [B, size]."""
        at = self._slots * self._of_slot
        return notes[:, :at].reshape(len(notes), self._slots, -1), notes[:, at:].reshape(len(notes), self._kinds, -1)

    def shown(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> ObservationArray:
        """Return [B, observed + size] observations with notes; arguments as for :meth:`Policy.act`."""
        (notes,) = self._memory.recall(step, members)
        slots, kinds = self._parts(notes)
        reads = self._read.shape[1]
        if reads:
            age = observation[:, self._age]
            fresh = age < 1.0
            np.copyto(slots[..., :reads], observation[:, self._read], where=fresh)
            known = fresh.any(axis=2)
            slots[..., reads][known] = 1.0
            slots[..., reads + 1][known] = 0.0
            youngest = np.where(known, age.min(axis=2), np.inf)
            last = observation[:, self._last].argmax(axis=2)
            for kind in range(self._kinds):
                there = np.where(last == kind, youngest, np.inf)
                at = there.argmin(axis=1)
                rows = np.flatnonzero(np.isfinite(there.min(axis=1)))
                chosen = slots[rows, at[rows]]
                kinds[rows, kind] = np.delete(chosen, reads + 1, axis=1)
        self._memory.keep(members, notes)
        return np.concatenate([observation, notes], axis=1, dtype=np.float32)

    def played(self, actions: IntArray, members: IntArray) -> None:
        """Note the actions [B] that were played."""
        (notes,) = self._memory.recall(np.ones_like(members), members)
        slots, _ = self._parts(notes)
        rows, reads = self._table[actions], self._read.shape[1]
        begun = np.flatnonzero(rows[:, KIND] == START)
        slot, kind = rows[begun, SECOND], self._kind[rows[begun, FIRST]]
        slots[begun, slot, reads + 1] += _COUNT
        slots[begun, slot, reads + 2 + kind] += _COUNT
        gone = np.flatnonzero((rows[:, KIND] == SUBMIT) | (rows[:, KIND] == DISCARD))
        slots[gone, rows[gone, FIRST]] = 0.0
        self._memory.keep(members, notes)
