"""Scripted manager: routes one vessel per order through the benches, measures the products, submits the best vessel."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from chemlab.kernels.arrays import MaskArray, ObservationArray
from chemlab.roles.instruments import BALANCE_KG

from ..roles import role_of
from .script import ScriptedManager, Setting, cheapest
from .workup import keeps_apart

_PURE_ENOUGH = 0.97
"""Purity of a product that is submitted without further processing."""
_MOST_OF_IT = 0.5
"""Minimum amount of such a product with the physics backend `real`, as a share of the theoretical maximum."""
_MOST_DISTILLATIONS = 2


@dataclass
class _Line:
    """State of one order and the vessels that are processed for it."""

    order: int
    goal: str
    plan: list[str]
    slot: int
    mine: set[int]
    """Slots whose vessels belong to this order."""
    kept: set[int] = field(default_factory=set)
    """Slots reserved for the vessels at the bench."""
    stage: int = 0
    running: str = ""
    """Bench agent of the present experiment."""
    distillations: int = 0
    measured: set[tuple[int, str]] = field(default_factory=set)
    submitted: bool = False


class SynthesisManager(ScriptedManager[list[_Line]]):
    """Processes each order through a fixed sequence of benches and submits the purest vessel.

    The sequence is: react; decant leftover metal and discard it; wash; distil; crystallize. Products are analysed until
    one is pure enough. Only benches of the scenario are used, one of each kind per order, and as many orders are
    processed at once as there are benches. The manager uses the public scenario and its observation of the vessels:
    their last bench, fill levels and readings.

    Args:
        setting: the manager's laboratory; if not careful, steps for safety and measurement only are skipped: metal is
            not decanted, and nothing is analysed.
    """

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        scenario, instruments = setting.scenario, setting.instruments
        self._careful = setting.careful
        self._positions = setting.positions
        self._keys = list(scenario.benches)
        kinds = {bench.kind: key for key, bench in scenario.benches.items() if key not in setting.skip}
        self._rxn, self._ext, self._dit, self._cry = (
            kinds.get(kind) for kind in ("reaction", "extraction", "distillation", "crystallization")
        )
        self._salts = tuple(salt.solid for salt in scenario.family.salt)
        self._balance = cheapest(scenario, ("balance",))
        self._gc = cheapest(scenario, ("gas_chromatograph",))
        self._analytes = instruments.analytes[instruments.names.index(self._gc)] if self._gc else ()
        self._molar_mass = np.array([scenario.materials[name].molar_mass_g_mol for name in self._analytes])

    def _agent(self, bench: str, line: _Line) -> str:
        """Return the bench agent that works for an order."""
        return f"{bench}_{line.order % self._scenario.benches[bench].count}"

    def _plan(self, goal: str) -> list[str]:
        """Return the benches in order; ``ext`` occurs twice if metal has to be decanted before washing."""
        metal = {name for step in self._scenario.family.violent for name in step.reactants}
        plan = [self._rxn] if self._rxn else []
        if self._ext:
            # With the physics backend `real`, the reaction bench's scripted policy quenches the metal.
            metals = self._scenario.physics == "paper" and bool(metal & set(self._scenario.stock))
            decant = self._careful and self._rxn is not None and metals
            # Washing removes a salt: if the salt is the goal, only the metal is decanted.
            plan += [self._ext] * (2 if decant and goal not in self._salts else 1)
        if self._distils_first(goal):
            plan.insert(len(plan) - 1, str(self._dit))
        return [*plan, *(bench for bench in (self._dit, self._cry) if bench)]

    def _distils_first(self, goal: str) -> bool:
        """Return True if the goal is also distilled before it is washed, because its liquor is miscible with water."""
        spec = self._scenario
        if spec.physics == "paper" or not (self._ext and self._dit) or not keeps_apart(spec, goal):
            return False
        return not any(keeps_apart(spec, name) for vessel in spec.shelf.vessel for name in vessel.contents)

    def _history(self, observation: ObservationArray, slot: int) -> tuple[str | None, int]:
        """Return the last bench of a vessel and the vessel's position there."""
        last = int(observation[self._slices[f"slot_{slot}_last_bench"]].argmax())
        position = int(observation[self._slices[f"slot_{slot}_last_position"]].argmax())
        return (self._keys[last - 1] if last > 0 else None), position

    def _begin(self, observation: ObservationArray) -> list[_Line]:
        """Return one line for every order, with the shelf's vessels assigned to the lines."""
        occupied = self._occupied(observation)
        lines = []
        for order, channel in enumerate(self._orders):
            goal = self._scenario.goals[int(observation[self._slices[channel]].argmax())]
            slot = occupied[order % len(occupied)] if occupied else 0
            # With one order, all vessels belong to it; with several, one vessel belongs to each.
            mine = set(occupied) if len(self._orders) == 1 else {slot}
            lines.append(_Line(order, goal, self._plan(goal), slot, mine))
        return lines

    def _observe(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            self._kept[member] = self._begin(observation)

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        lines = self._kept[member]
        kind, slot, more = self._decode(action)
        if kind == "start":
            agent = more[0]
            line = next((line for line in lines if slot in line.mine), lines[0])
            left = line.plan[line.stage :]
            if role_of(agent) in left:
                line.stage += left.index(role_of(agent)) + 1
            line.slot = slot
            self._begun(observation, line, lines, agent)
        elif kind == "measure":
            for line in lines:
                line.measured.add((slot, more[0]))
        elif kind == "submit":
            lines[more[0]].submitted = True

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        lines = self._kept[member]
        for line in lines:
            if line.submitted or (line.running and self._value(observation, f"{line.running}_busy") > 0.5):
                continue
            action = self._advance(observation, mask, line, lines)
            if action is not None:
                return action
        wait = self._actions.encode("wait")
        return wait if mask[wait] else int(mask.argmax())

    def _advance(self, observation: ObservationArray, mask: MaskArray, line: _Line, lines: list[_Line]) -> int | None:
        """Return the line's next action; None while it waits for a bench."""
        if line.running:
            ended, line.running = role_of(line.running), ""
            if ended == self._ext:
                beakers = [
                    s
                    for s in self._occupied(observation)
                    if s in line.mine and self._history(observation, s) == (self._ext, 1)
                ]
                if line.goal in self._salts and self._rxn is None and beakers:
                    line.slot = beakers[0]  # the salt is in the washing water
                elif beakers and mask[self._actions.encode("discard", beakers[0])]:
                    return self._actions.encode("discard", beakers[0])
            elif ended == self._dit and self._ext in line.plan[line.stage :]:
                distillates = {s for s in line.mine if self._history(observation, s) == (self._dit, 1)}
                line.slot = min(distillates & set(self._occupied(observation)), default=line.slot)
        if line.stage < len(line.plan):
            return self._start(observation, mask, line, lines, line.plan[line.stage])
        return self._finish(observation, mask, line, lines)

    def _start(
        self, observation: ObservationArray, mask: MaskArray, line: _Line, lines: list[_Line], bench: str
    ) -> int | None:
        """Return the action that starts an experiment, or one that frees a slot for it; None if the bench is busy."""
        agent = self._agent(bench, line)
        if self._value(observation, f"{agent}_busy") > 0.5:
            return None
        action = self._actions.encode("start", agent, line.slot, line.goal)
        if not mask[action]:
            return self._fallback(mask, line, lines)
        line.stage += line.stage < len(line.plan)
        self._begun(observation, line, lines, agent)
        return action

    def _begun(self, observation: ObservationArray, line: _Line, lines: list[_Line], agent: str) -> None:
        """Update the lines after a vessel of one of them has been sent to a bench."""
        # The laboratory reserves the first free slots for returning vessels.
        taken = set(self._occupied(observation))
        for other in lines:
            # Reservations end with the experiment, also if the line has not been processed since.
            if other.running and self._value(observation, f"{other.running}_busy") > 0.5:
                taken |= other.kept
        free = [s for s in range(self._actions.slots) if s not in taken]
        kept = set(free[: self._positions[role_of(agent)] - 1])
        for other in lines:
            other.mine -= kept
        line.mine |= kept
        line.kept = kept | {line.slot}
        line.running = agent
        line.distillations += role_of(agent) == self._dit
        # Only the readings of the processed vessel become invalid.
        line.measured = {(slot, instrument) for slot, instrument in line.measured if slot != line.slot}

    def _fallback(self, mask: MaskArray, line: _Line, lines: list[_Line]) -> int | None:
        """Discard a vessel that no line needs; else submit the line's vessel, unless an experiment is running."""
        needed = {other.slot for other in lines if not other.submitted}
        for slot in reversed(range(self._actions.slots)):
            if slot not in needed and mask[self._actions.encode("discard", slot)]:
                return self._actions.encode("discard", slot)
        if any(other.running for other in lines):
            return None
        submit = self._submit(line, line.slot)
        return submit if mask[submit] else int(mask.argmax())

    def _submit(self, line: _Line, slot: int) -> int:
        line.submitted = True
        return self._encode_submit(slot, line.order)

    def _finish(self, observation: ObservationArray, mask: MaskArray, line: _Line, lines: list[_Line]) -> int | None:
        """Return the next action after the last bench: a measurement, another distillation, or the submission."""
        last = self._cry or self._dit or self._ext or self._rxn
        candidates = [
            s
            for s in self._occupied(observation)
            if s in line.mine
            and self._history(observation, s)[0] == last
            and self._value(observation, f"slot_{s}_fill") > 0.0
        ]
        if not candidates:
            return self._fallback(mask, line, lines)
        # After a second distillation the product is in B1, otherwise in the original vessel.
        in_receiver = line.distillations > 1
        candidates.sort(key=lambda s: self._history(observation, s)[1] != 1 if in_receiver else s != line.slot)
        if not self._careful:
            return self._submit(line, candidates[0])
        for slot in candidates:
            for instrument in (self._gc, self._balance):
                if instrument is None or (len(candidates) == 1 and line.distillations >= _MOST_DISTILLATIONS):
                    continue
                action = self._actions.encode("measure", slot, instrument)
                if (slot, instrument) not in line.measured and mask[action]:
                    line.measured.add((slot, instrument))
                    return action
            if self._gc is not None and self._is_product(*self._estimate(observation, slot, line.goal), line.goal):
                return self._submit(line, slot)
        estimates = [self._estimate(observation, slot, line.goal) for slot in candidates]
        best = int(np.argmax([amount * purity for amount, purity in estimates]))
        slot, impure = candidates[best], estimates[best][1] < _PURE_ENOUGH
        # A crystallized product is not distilled again.
        if self._dit and last == self._dit and impure and line.distillations < _MOST_DISTILLATIONS:
            line.slot = slot
            again = self._start(observation, mask, line, lines, self._dit)
            if again is None or again == self._actions.encode("start", self._agent(self._dit, line), slot, line.goal):
                return again
        return self._submit(line, slot)

    def _is_product(self, amount: float, purity: float, goal: str) -> bool:
        """Return True if no other vessel needs to be analysed; in `real` physics, a small residue is not enough."""
        most = self._scenario.theoretical_maximum_mol[goal] / len(self._orders)
        return purity >= _PURE_ENOUGH and (self._scenario.physics == "paper" or amount >= _MOST_OF_IT * most)

    def _estimate(self, observation: ObservationArray, slot: int, goal: str) -> tuple[float, float]:
        """Estimate (mol of the goal, purity) from the readings; without a balance, from the fill level."""
        if self._gc is None:
            return self._value(observation, f"slot_{slot}_fill"), 1.0
        fractions = observation[self._slices[f"slot_{slot}_{self._gc}"]].astype(np.float64)
        unseen = goal if goal in self._salts else next(iter(self._salts), goal)
        residue = self._scenario.materials[unseen].molar_mass_g_mol
        gram_per_mol = float(fractions[:-1] @ self._molar_mass + fractions[-1] * residue)
        if self._balance is None:
            grams = 1000.0 * self._value(observation, f"slot_{slot}_fill")
        else:
            grams = 1000.0 * BALANCE_KG * self._value(observation, f"slot_{slot}_{self._balance}")
        purity = float(fractions[self._analytes.index(goal)] if goal in self._analytes else fractions[-1])
        return (grams / gram_per_mol * purity if gram_per_mol > 0.0 else 0.0), purity
