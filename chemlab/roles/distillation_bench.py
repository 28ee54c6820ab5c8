"""The distillation bench (DiT): boil the contents off, one boiling point after another.

| Observation | Actions | Steps |
|---|---|---|
| 3 x 100 layer pixels (DV, B1, B2), T, V, P of DV, goal | Discrete(31): 3 processes x 10 magnitudes, end | 50 |
"""

from __future__ import annotations

import numpy as np

from ..kernels.arrays import FloatArray, IntArray
from ..physics.shelf import Shelf
from .bench import Experiments
from .operation_bench import OperationBench


class DistillationBench(OperationBench):
    """Distillation bench: a distillation vessel DV, the condensate's beaker B1 and a second beaker B2.

    **Actions** - the scenario's table; by default: heat or cool DV, pour DV -> B1, pour B1 -> B2 (swap the
    receiver), with ten magnitudes each; the last action ends the experiment.

    **Observation** - for each vessel 100 layer pixels as on the extraction bench; temperature, volume and the vapour's
    pressure (at most ambient) in DV, scaled to their ranges; the goal's one-hot.

    **Reward** at the end - sum over the vessels of (mol of the goal x its absolute purity there), minus the same sum at
    the start. All materials count; salt counts as salt whether dissolved or not.
    """

    positions = ("DV", "B1", "B2")
    score_meaning = "gain of mol x purity of the goal"
    process_kinds = ("heat", "pour")

    def _gauges(self) -> FloatArray:
        ambient = self.scenario.ambient_pressure_kpa
        return np.array(
            [[self.options.coolest_k, self.options.hottest_k], [0.0, self.auxiliary_capacity_l], [0.0, ambient]]
        )

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        return self.purity_measure(shelf, experiments, members, self.goals.absolute_counts)
