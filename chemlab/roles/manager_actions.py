"""The manager's actions as one flat table, used for decoding, masks, documentation and names."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..config.scenario import Scenario
from ..kernels.arrays import IntArray

START, MEASURE, DISCARD, SUBMIT, RECALL, WAIT, CALIBRATE, REPAIR = range(8)
KINDS = ("start", "measure", "discard", "submit", "recall", "wait", "calibrate", "repair")
KIND, FIRST, SECOND, GOAL, GRADE = range(5)
"""Columns of :attr:`ManagerActions.table`; FIRST and SECOND are the arguments that an action of any kind may have."""


@dataclass(frozen=True)
class ManagerActions:
    """The manager's actions, enumerated from the scenario.

    Attributes:
        table: [A, 5] kind, then its arguments (start: bench, slot, goal, and quality requirement if there are any;
            measure: slot, instrument; submit: slot, order; discard: slot; recall, repair: bench; calibrate: instrument;
            wait: none), -1 for missing ones.
        drifting: instruments that can be calibrated.
        wearing: benches that can be repaired.
    """

    bench_agents: tuple[str, ...]
    slots: int
    orders: int
    goals: tuple[str, ...]
    instruments: tuple[str, ...]
    grades: tuple[str, ...]
    table: IntArray
    drifting: tuple[str, ...] = ()
    wearing: tuple[str, ...] = ()

    @classmethod
    def of(cls, scenario: Scenario) -> ManagerActions:
        """Return the table of a scenario."""
        bench_agents, slots = scenario.bench_agents(), scenario.shelf.slots
        grades = range(len(scenario.grades)) if scenario.grades else (-1,)
        asked = list(itertools.product(range(len(scenario.goals)), grades))
        rows = [(START, b, s, *goal) for b in range(len(bench_agents)) for s in range(slots) for goal in asked]
        rows += [(MEASURE, s, i, -1, -1) for s in range(slots) for i in range(len(scenario.instruments))]
        rows += [(DISCARD, s, -1, -1, -1) for s in range(slots)]
        rows += [(SUBMIT, s, o, -1, -1) for s in range(slots) for o in range(scenario.orders)]
        rows += [(RECALL, b, -1, -1, -1) for b in range(len(bench_agents))]
        instruments = tuple(scenario.instruments)
        drifting = tuple(name for name, spec in scenario.instruments.items() if spec.drift is not None)
        kinds = [bench for bench in scenario.benches.values() for _ in range(bench.count)]
        wearing = tuple(agent for agent, bench in zip(bench_agents, kinds, strict=True) if bench.wear is not None)
        rows += [(CALIBRATE, instruments.index(name), -1, -1, -1) for name in drifting]
        rows += [(REPAIR, bench_agents.index(agent), -1, -1, -1) for agent in wearing]
        rows += [(WAIT, -1, -1, -1, -1)]
        table = np.array(rows, dtype=np.int64)
        named = scenario.goals, instruments, tuple(scenario.grades)
        return cls(tuple(bench_agents), slots, scenario.orders, *named, table, drifting, wearing)

    def __len__(self) -> int:
        return len(self.table)

    def encode(self, kind: str, *arguments: str | int) -> int:
        """Return the index of an action.

        Args:
            kind: ``start`` (bench agent, slot, goal, and the quality requirement if there are any; without it the last,
                which demands least), ``measure`` (slot, instrument), ``discard`` (slot), ``submit`` (slot, and the
                order if there are several), ``recall`` (bench agent), ``wait``; with drifting instruments or degrading
                benches ``calibrate`` (instrument) and ``repair`` (bench agent).
            arguments: bench agents, goals, requirements and instruments by name, slots and orders by index.

        Raises:
            ValueError: the action does not exist; the message lists the alternatives.
        """
        try:
            return self._numbers[(kind, *arguments)]
        except (KeyError, TypeError):  # an unhashable argument is not part of an action
            raise ValueError(f"manager action{self._mistake(kind, arguments)}") from None

    @cached_property
    def _numbers(self) -> Mapping[tuple[str | int, ...], int]:
        """Index of every result of :meth:`decode`."""
        found = {self.decode(action): action for action in range(len(self))}
        loosest = self.grades[-1:]
        graded = [key for key in found if loosest and key[0] == "start" and key[-1:] == loosest]
        return found | {key[:-1]: found[key] for key in graded}

    @property
    def arguments(self) -> Mapping[str, Mapping[str, tuple[str | int, ...]]]:
        """Arguments of each kind of action by name, with their values."""
        slot, order = {"slot": tuple(range(self.slots))}, {"order": tuple(range(self.orders))}
        bench, grade = {"bench": self.bench_agents}, {"grade": self.grades} if self.grades else {}
        return {
            "start": {**bench, **slot, "goal": self.goals, **grade},
            "measure": {**slot, "instrument": self.instruments},
            "discard": slot,
            "submit": {**slot, **(order if self.orders > 1 else {})},
            "recall": bench,
            "wait": {},
            **({"calibrate": {"instrument": self.drifting}} if self.drifting else {}),
            **({"repair": {"bench": self.wearing}} if self.wearing else {}),
        }

    def _mistake(self, kind: str, arguments: tuple[str | int, ...]) -> str:
        """Describe why an action does not exist."""
        spaces = self.arguments
        if kind not in spaces:
            return f": unknown kind {kind!r}; known: {', '.join(spaces)}"
        expected = spaces[kind].values()
        if len(arguments) != len(expected):
            return f" {kind!r}: takes {len(expected)} arguments, given {arguments!r}"
        for argument, values in zip(arguments, expected, strict=True):
            if not isinstance(argument, (str, int, float, np.number)) or argument not in values:
                return f" {kind!r}: argument {argument!r} is not one of {list(values)}"
        return f" {kind!r}: argument {arguments!r} is not one of {list(self._numbers)}"

    def decode(self, action: int) -> tuple[str | int, ...]:
        """Return (kind, arguments...) of an action: the inverse of :meth:`encode`."""
        kind, *arguments = (int(value) for value in self.table[action])
        if kind == START:
            grade = (self.grades[arguments[3]],) if self.grades else ()
            return "start", self.bench_agents[arguments[0]], arguments[1], self.goals[arguments[2]], *grade
        if kind == MEASURE:
            return "measure", arguments[0], self.instruments[arguments[1]]
        if kind in (RECALL, REPAIR):
            return KINDS[kind], self.bench_agents[arguments[0]]
        if kind == CALIBRATE:
            return "calibrate", self.instruments[arguments[0]]
        if kind == SUBMIT and self.orders > 1:
            return "submit", arguments[0], arguments[1]
        return (KINDS[kind], arguments[0]) if kind in (DISCARD, SUBMIT) else (KINDS[kind],)

    def words(self, action: int) -> str:
        """An action in words."""
        kind, *arguments = self.decode(action)
        return {
            "start": "start {} on slot {}, goal {}" + (", grade {}" if self.grades else ""),
            "measure": "measure slot {} with {}",
            "discard": "discard slot {}",
            "submit": "submit slot {} for order {}" if self.orders > 1 else "submit slot {}",
            "recall": "recall {}",
            "wait": "wait for the benches",
            "calibrate": "calibrate {}",
            "repair": "have {} repaired",
        }[str(kind)].format(*arguments)

    @property
    def action_meanings(self) -> list[str]:
        """Description of every action."""
        return [self.words(action) for action in range(len(self))]
