"""Scripted policy of an extraction bench with a second solvent, or with a base and an acid, in addition to water."""

from __future__ import annotations

import math

import numpy as np

from chemlab.config.materials import litres_of
from chemlab.config.pairs import log_activity_coefficients, pair_table
from chemlab.config.reactions import HYDROXIDE, PROTON, WATER
from chemlab.config.scenario import Scenario
from chemlab.kernels.tables import Table
from chemlab.physics.constants import ROOM_K
from chemlab.roles.separation_benches import ExtractionBench

from .extraction import WASH
from .real import ScriptedRealExtraction
from .script import choices

_APART = 30.0
"""Activity coefficient at infinite dilution in water above which a liquid is considered immiscible with water."""
_SOLVENT_L = 0.3
"""Volume of a second solvent in L."""
_DISSOLVING = 5
"""Number of steps for dissolving crystals before a base is added."""
_EXCESS = 1.2
"""Excess of base over the largest possible amount of the goal, and of acid over that base."""


def keeps_apart(scenario: Scenario, name: str) -> bool:
    """Return True if a liquid and water form two layers (physics backend ``real``)."""
    if name == WATER or scenario.materials[name].role != "solvent":
        return False
    table = pair_table((name, WATER), scenario.pairs)
    dilute = log_activity_coefficients(np.array([0.0, 1.0]), table.tau(ROOM_K), table.alpha)
    return float(dilute[0]) > math.log(_APART)


class ScriptedWorkup(ScriptedRealExtraction):
    """Washes with water; adds an immiscible solvent or uses acid-base extraction where needed.

    If all contents are miscible with water, an immiscible solvent is added first. If the goal is an acid and the bench
    has a solid base and another solid acid, the base transfers the goal into the water as its salt, the rest is poured
    off, and the acid recovers the goal.

    Args:
        bench: the bench.
        careful: False washes once.
    """

    def __init__(self, bench: ExtractionBench, careful: bool = True) -> None:
        super().__init__(bench, careful)
        scenario = bench.scenario

        def choose(wanted: float, kind: str, **which: str) -> int:
            """Return the action of a process with the smallest sufficient magnitude, or else the largest one."""
            sizes = choices(bench, kind, **which)
            return sizes[min((size for size in sizes if size >= wanted), default=max(sizes))]

        added = [str(process.material) for process in bench.options.process if process.kind == "add"]
        plan = self._plan.arrays
        steps = [WASH]
        base, acid = self._base_and_acid(bench, added)
        present = {name for vessel in scenario.shelf.vessel for name in vessel.contents}
        above: str | None = None  # the layer above the wash, which may contain as much alcohol as water
        solvent: str | None = next((name for name in added if keeps_apart(scenario, name)), None)
        if base and acid:
            most = max(scenario.theoretical_maximum_mol.get(goal, 0.0) for goal in bench.goals.names)
            basify, acidify = (
                choose(litres_of({name: excess * most}, scenario.materials), "add", material=name)
                for name, excess in ((base, _EXCESS), (acid, _EXCESS**2))
            )
            back = [choose(1.0, "pour", vessel=of, target=to) for of, to in (("EV", "B2"), ("B1", "EV"))]
            steps = [plan.mix, *[plan.settle] * _DISSOLVING, basify, WASH, *back, acidify, plan.mix, plan.settle]
        elif not any(keeps_apart(scenario, name) for name in present):
            if all(keeps_apart(scenario, goal) for goal in bench.goals.names):
                above = bench.goals.names[0]
                # Every wash removes a part of a goal that is itself a solvent: one wash less, with a small volume.
                add = np.array([choose(0.0, "add", material=WATER)])
                plan = plan._replace(adds=add, most=plan.most - 1)
            elif solvent is not None:
                above = solvent
                steps = [choose(_SOLVENT_L, "add", material=solvent), WASH]
        organic = np.array([scenario.materials[above].shade] if above else [], dtype=np.float32)
        self._plan = Table(plan._replace(steps=np.array(steps), organic=organic))

    @staticmethod
    def _base_and_acid(bench: ExtractionBench, added: list[str]) -> tuple[str | None, str | None]:
        """Return the bench's solid base and solid acid for an acidic goal."""
        family = bench.scenario.family
        acids = {name for acid in family.acid for name in acid.species[:-1]}
        if not set(bench.goals.names) <= acids:
            return None, None
        salts = {salt.solid: salt for salt in family.salt if salt.solid in added}
        base = next((name for name, salt in salts.items() if salt.anion == HYDROXIDE), None)
        acid = next((name for name, salt in salts.items() if salt.anion in acids or salt.cation == PROTON), None)
        return base, acid
