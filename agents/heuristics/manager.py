"""Scripted manager: routes one vessel through the benches, measures what comes out, submits the best vessel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.bench.base import Channel, MaskArray, ObservationArray, channel_slices
from chemlab.bench.instruments import BALANCE_RANGE_KG, InstrumentTable
from chemlab.laboratory.actions import ManagerActions
from chemlab.scenario import Scenario
from chemlab.shelf import IntArray

__all__ = ["ManagerHeuristic"]

_PURE_ENOUGH = 0.97
_MOST_DISTILLATIONS = 2


@dataclass
class _Notes:
    """What the manager remembers within an episode."""

    plan: list[str]
    stage: int = 0
    slot: int = 0
    running: str = ""
    distillations: int = 0
    measured: set[tuple[int, str]] = field(default_factory=set)


class ManagerHeuristic:
    """React; decant the leftover metal and throw it away; wash; distil; weigh and analyse what comes out; submit the
    best.

    Uses only the benches the scenario has. It knows the recipe and the public scenario, and of the vessels what
    the manager observes: where they were last, how full they are, and readings once it has paid for them.

    Args:
        scenario: the public scenario.
        channels: the manager's observation channels.
        actions: the manager's actions.
        instruments: the scenario's instruments.
    """

    def __init__(
        self, scenario: Scenario, channels: Sequence[Channel], actions: ManagerActions, instruments: InstrumentTable
    ) -> None:
        self._scenario, self._actions = scenario, actions
        self._slices = channel_slices(channels)
        self._keys = list(scenario.benches)
        self._agent_of = {key: f"{key}_0" for key in self._keys}
        kinds = {bench.kind: key for key, bench in scenario.benches.items()}
        self._rxn, self._ext, self._dit = (kinds.get(kind) for kind in ("reaction", "extraction", "distillation"))
        self._salts = {salt.solid for salt in scenario.family.salt}
        self._balance = next((n for n, spec in scenario.instruments.items() if spec.kind == "balance"), None)
        self._gc = next((n for n, spec in scenario.instruments.items() if spec.kind == "gas_chromatograph"), None)
        names = list(scenario.materials)
        self._analytes = [names[i] for i in instruments.analytes]
        self._molar_mass = np.array([scenario.materials[name].molar_mass_g_mol for name in self._analytes])
        self._notes: dict[int, _Notes] = {}

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policy.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        return np.array(
            [self._decide(o, m, int(s), int(i)) for o, m, s, i in zip(observation, mask, step, members, strict=True)],
            dtype=np.int64,
        )

    def _value(self, observation: ObservationArray, name: str) -> float:
        return float(observation[self._slices[name]][0])

    def _plan(self, goal: str) -> list[str]:
        """Benches in order; ``ext`` twice where metal has to be decanted before washing."""
        metal = {name for step in self._scenario.family.violent for name in step.reactants}
        plan = [self._rxn] if self._rxn else []
        if self._ext:
            decant = self._rxn is not None and bool(metal & set(self._scenario.stock))
            # Washing takes a salt away: where it is the goal, only the metal has to go.
            plan += [self._ext] * (2 if decant and goal not in self._salts else 1)
        return [*plan, *([self._dit] if self._dit else [])]

    def _slots(self, observation: ObservationArray, bench: str | None, role: int | None = None) -> list[int]:
        """Occupied slots whose vessel was last at ``bench`` (None: nowhere yet), in that role."""
        found = []
        for s in range(self._actions.slots):
            if self._value(observation, f"slot_{s}_occupied") < 0.5:
                continue
            last = int(observation[self._slices[f"slot_{s}_last_bench"]].argmax())
            was = int(observation[self._slices[f"slot_{s}_last_role"]].argmax())
            if last == (0 if bench is None else 1 + self._keys.index(bench)) and role in (None, was):
                found.append(s)
        return found

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        goal = self._scenario.goals[int(observation[self._slices["goal"]].argmax())]
        if step == 0:
            fresh = self._slots(observation, None)
            self._notes[member] = _Notes(self._plan(goal), slot=fresh[0] if fresh else 0)
        notes = self._notes[member]
        if any(self._value(observation, f"{agent}_busy") > 0.5 for agent in self._agent_of.values()):
            return self._actions.encode("wait")
        if notes.running:
            ended, notes.running = notes.running, ""
            if ended == self._ext:
                beakers = self._slots(observation, self._ext, role=1)
                if goal in self._salts and self._rxn is None and beakers:
                    notes.slot = beakers[0]  # the salt went into the washing water
                elif beakers and mask[self._actions.encode("discard", beakers[0])]:
                    return self._actions.encode("discard", beakers[0])
        if notes.stage < len(notes.plan):
            return self._start(notes, notes.plan[notes.stage], goal, mask)
        return self._finish(observation, mask, notes, goal)

    def _start(self, notes: _Notes, bench: str, goal: str, mask: MaskArray) -> int:
        action = self._actions.encode("start", self._agent_of[bench], notes.slot, goal)
        if not mask[action]:
            return self._fallback(notes, mask)
        notes.stage += 1
        notes.running = bench
        notes.distillations += bench == self._dit
        self._forget_readings(notes)
        return action

    @staticmethod
    def _forget_readings(notes: _Notes) -> None:
        """The vessel goes to a bench and will come back as another; readings of the others stay good."""
        notes.measured = {(slot, instrument) for slot, instrument in notes.measured if slot != notes.slot}

    def _fallback(self, notes: _Notes, mask: MaskArray) -> int:
        """Make room by discarding what is not being worked on; without any, submit what there is."""
        for slot in reversed(range(self._actions.slots)):
            if slot != notes.slot and mask[self._actions.encode("discard", slot)]:
                return self._actions.encode("discard", slot)
        return (
            self._actions.encode("submit", notes.slot)
            if mask[self._actions.encode("submit", notes.slot)]
            else int(mask.argmax())
        )

    def _finish(self, observation: ObservationArray, mask: MaskArray, notes: _Notes, goal: str) -> int:
        last = self._dit or self._ext or self._rxn
        candidates = [s for s in self._slots(observation, last) if self._value(observation, f"slot_{s}_fill") > 0.0]
        if not candidates:
            return self._fallback(notes, mask)
        for slot in candidates:
            for instrument in (self._gc, self._balance):
                if instrument is None or (len(candidates) == 1 and notes.distillations >= _MOST_DISTILLATIONS):
                    continue
                action = self._actions.encode("measure", slot, instrument)
                if (slot, instrument) not in notes.measured and mask[action]:
                    notes.measured.add((slot, instrument))
                    return action
        estimates = [self._estimate(observation, slot, goal) for slot in candidates]
        best = int(np.argmax([amount * purity for amount, purity in estimates]))
        slot = candidates[best]
        if self._dit and estimates[best][1] < _PURE_ENOUGH and notes.distillations < _MOST_DISTILLATIONS:
            again = self._actions.encode("start", self._agent_of[self._dit], slot, goal)
            if mask[again]:
                notes.slot, notes.running = slot, self._dit
                notes.distillations += 1
                self._forget_readings(notes)
                return again
        return self._actions.encode("submit", slot)

    def _estimate(self, observation: ObservationArray, slot: int, goal: str) -> tuple[float, float]:
        """(mol of the goal, its purity) from the readings; the fill level stands in for a balance that is not there."""
        if self._gc is None:
            return self._value(observation, f"slot_{slot}_fill"), 1.0
        fractions = observation[self._slices[f"slot_{slot}_{self._gc}"]].astype(np.float64)
        residue = self._scenario.materials[
            goal if goal in self._salts else next(iter(self._salts), goal)
        ].molar_mass_g_mol
        gram_per_mol = float(fractions[:-1] @ self._molar_mass + fractions[-1] * residue)
        if self._balance is None:
            grams = 1000.0 * self._value(observation, f"slot_{slot}_fill")
        else:
            grams = 1000.0 * BALANCE_RANGE_KG * self._value(observation, f"slot_{slot}_{self._balance}")
        purity = float(fractions[self._analytes.index(goal)] if goal in self._analytes else fractions[-1])
        return (grams / gram_per_mol * purity if gram_per_mol > 0.0 else 0.0), purity
