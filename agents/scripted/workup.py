"""Scripted policy of an extraction bench with more than water at hand: a solvent, or a base and an acid."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np

from chemlab.config.pairs import log_activity_coefficients, pair_table
from chemlab.config.reactions import HYDROXIDE, PROTON, WATER
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import MaskArray, ObservationArray
from chemlab.roles.extraction_bench import ExtractionBench

from .real import RealExtractionHeuristic

__all__ = ["WorkupHeuristic", "keeps_apart"]

_ROOM_K = 298.15
_APART = 30.0
"""Activity coefficient, highly dilute in water, above which a liquid does not mix with it."""
_SOLVENT_L = 0.3
_AIR = 0.05
"""Grey values this close to air's are no liquid's."""
_DISSOLVING = 5
"""Steps that crystals are given to dissolve before a base is added."""
_EXCESS = 1.2
"""Of base over the most of the goal that there can be, and of acid over that base."""


def keeps_apart(scenario: Scenario, name: str) -> bool:
    """Whether a liquid and water are two layers; physics ``real``."""
    if name == WATER or scenario.materials[name].role != "solvent":
        return False
    table = pair_table((name, WATER), scenario.pairs)
    dilute = log_activity_coefficients(np.array([0.0, 1.0]), table.tau(_ROOM_K), table.alpha)
    return float(dilute[0]) > math.log(_APART)


class WorkupHeuristic(RealExtractionHeuristic):
    """Washes with water. Where everything that stands there mixes with water, it adds a solvent first that does not.
    Where the goal is an acid and the bench has a base and another acid, both solids: adds the base, so that the goal
    goes into the water as its salt, pours off what stays behind, and gets the goal back with the acid.

    Args:
        bench: the bench it is for.
        careful: False washes once.
    """

    def __init__(self, bench: ExtractionBench, careful: bool = True) -> None:
        super().__init__(bench, careful)
        scenario, processes = bench.scenario, bench.options.process
        first: list[int] = np.cumsum([0, *(len(process.magnitudes) for process in processes)]).tolist()

        def choose(i: int, wanted: float) -> int:
            """The smallest magnitude of a process that is enough, or else the largest."""
            magnitudes: tuple[float, ...] = processes[i].magnitudes
            enough = [m for m in magnitudes if m >= wanted]
            return first[i] + magnitudes.index(min(enough, default=max(magnitudes)))

        added = {p.material: i for i, p in enumerate(processes) if p.kind == "add" and p.material is not None}
        poured = {(p.vessel, p.target): i for i, p in enumerate(processes) if p.kind == "pour"}
        self._organic_shade: float | None = None
        self._air_shade = scenario.materials["air"].shade
        self._before: list[int] = []
        self._after: list[int] = []
        """Actions before the first wash and after the last one."""
        base, acid = self._base_and_acid(bench, list(added))
        present = {name for vessel in scenario.shelf.vessel for name in vessel.contents}
        solvent: str | None = next((name for name in added if keeps_apart(scenario, name)), None)
        if base and acid:
            most = max(scenario.theoretical_maximum_mol.get(goal, 0.0) for goal in bench.goals.names)
            for name, excess, into in ((base, _EXCESS, self._before), (acid, _EXCESS**2, self._after)):
                material = scenario.materials[name]
                litres = excess * most * material.molar_mass_g_mol / material.density_kg_l / 1000.0
                into.append(choose(added[name], litres))
            back = [choose(poured[pour], 1.0) for pour in (("EV", "B2"), ("B1", "EV"))]
            self._before = [self._mix, *[self._settle] * _DISSOLVING, *self._before]
            self._after = [*back, *self._after, self._mix, self._settle]
        elif not any(keeps_apart(scenario, name) for name in present):
            if all(keeps_apart(scenario, goal) for goal in bench.goals.names):
                self._organic_shade = scenario.materials[bench.goals.names[0]].shade
                # The goal is a solvent itself, some of which every wash takes along: with little, and once less.
                self._add, self._washes_wanted = choose(added[WATER], 0.0), self._washes_wanted - 1
            elif solvent is not None:
                self._organic_shade = scenario.materials[solvent].shade
                self._before = [choose(added[solvent], _SOLVENT_L)]
        self._done: dict[int, int] = {}

    @staticmethod
    def _base_and_acid(bench: ExtractionBench, added: list[str]) -> tuple[str | None, str | None]:
        """Solids at the bench that take the goal into water, if it is an acid, and out of it."""
        family = bench.scenario.family
        acids = {name for acid in family.acid for name in acid.species[:-1]}
        if not set(bench.goals.names) <= acids:
            return None, None
        salts = {salt.solid: salt for salt in family.salt if salt.solid in added}
        base = next((name for name, salt in salts.items() if salt.anion == HYDROXIDE), None)
        acid = next((name for name, salt in salts.items() if salt.anion in acids or salt.cation == PROTON), None)
        return base, acid

    def get_memory(self) -> Any:
        """See :class:`chemlab.envs.players.Policy`."""
        return super().get_memory(), copy.deepcopy(self._done)

    def set_memory(self, memory: Any) -> None:
        """See :class:`chemlab.envs.players.Policy`."""
        washing, done = memory
        super().set_memory(washing)
        self._done = copy.deepcopy(done)

    def _boundary(self, picture: ObservationArray) -> int:
        """Pixels from the bottom up to the layer above the water, which may be half alcohol, and so have no shade that
        is known."""
        if self._organic_shade is None:
            return super()._boundary(picture)
        organic = np.abs(picture - self._organic_shade) < np.abs(picture - self._wash_shade)
        organic &= np.abs(picture - self._air_shade) > _AIR
        # Without a second layer nothing is drained: it is not water alone.
        return int(organic.argmax()) if organic.any() else 0

    def _decide(self, picture: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        if step == 0:
            self._done[member] = 0
        done = self._done[member]
        if done < len(self._before):
            self._done[member] = done + 1
            return self._before[done] if mask[self._before[done]] else self._decide(picture, mask, step + 1, member)
        if done == len(self._before):
            # The first call for a member begins its washing.
            self._done[member] = done + 1
            return super()._decide(picture, mask, 0, member)
        if done == len(self._before) + 1:
            action = super()._decide(picture, mask, step, member)
            if action != self._end:
                return action
        for action in self._after[max(done - len(self._before) - 1, 0) :]:
            self._done[member] += 1
            if mask[action]:
                return action
        return self._end
