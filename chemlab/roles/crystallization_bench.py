"""The crystallization bench (CrT): dissolve, filter, cool, seed, wait, filter, wash, dry. Physics ``real`` only.

| Observation | Actions | Steps |
|---|---|---|
| 3 x 100 layer pixels (CV, F, W), T, V, P and solids of CV, goal | Discrete(35): 11 processes, end | 60 by default |
"""

from __future__ import annotations

import numpy as np

from ..config.datafile import DataError
from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, IntArray
from ..physics.chemistry import ChemistryTable
from ..physics.shelf import Shelf
from .bench import Experiments
from .operation_bench import OperationBench


class CrystallizationBench(OperationBench):
    """Crystallization bench: a crystallizer CV with a jacket, a filter and an air line; a filter flask F and a dish W.

    **Actions** - the scenario's table; by default: heat or cool CV, add water or ethanol, seed it with the goal, wait,
    filter CV -> F or CV -> W, pour CV -> W, F -> CV or W -> CV, dry CV; the last action ends the experiment. To wash is
    to add and to filter.

    **Observation** - for each vessel 100 layer pixels as on the extraction bench; temperature, volume, the vapour's
    pressure (at most ambient) and the solids' share of the volume in CV, scaled to their ranges; the goal's one-hot.

    **Reward** at the end - sum over the vessels of (mol of the goal x its absolute purity there), minus the same sum at
    the start. All materials count, including solvents; salt counts as salt whether dissolved or not.
    """

    positions = ("CV", "F", "W")
    score_meaning = "gain of mol x purity of the goal"
    process_kinds = ("heat", "add", "seed", "settle", "filter", "pour", "dry")

    def __init__(self, key: str, scenario: Scenario, chemistry: ChemistryTable) -> None:
        if scenario.physics == "paper":
            raise DataError(
                f"{scenario.origin}: benches.{key}.kind: 'crystallization' needs physics = 'real', "
                f"given {scenario.physics!r}"
            )
        super().__init__(key, scenario, chemistry)

    def _gauges(self) -> FloatArray:
        ambient, room = self.scenario.ambient_pressure_kpa, self.auxiliary_capacity_l
        return np.array([[self.options.coolest_k, self.options.hottest_k], [0.0, room], [0.0, ambient], [0.0, 1.0]])

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        return self.purity_measure(shelf, experiments, members, self.goals.absolute_counts)
