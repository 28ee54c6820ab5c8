"""The extraction bench (ExT): shake, settle, drain; separates solutes by their partition between solvents.

| Observation | Actions | Steps |
|---|---|---|
| 3 x 100 layer pixels (EV, B1, B2), goal | Discrete(41): 8 processes x 5 magnitudes, end | 50 by default |
"""

from __future__ import annotations

from ..kernels.arrays import FloatArray, IntArray
from ..physics.shelf import Shelf
from .bench import Experiments
from .operation_bench import OperationBench


class ExtractionBench(OperationBench):
    """Extraction bench: an extraction vessel EV and two beakers B1 and B2.

    **Actions** - the scenario's table; by default: drain EV -> B1 bottom first, mix EV, pour B1 -> EV, B2 -> EV, EV
    -> B2, add the first solvent, add the second, settle, with five magnitudes each; the last action ends the
    experiment.

    **Observation** - for each vessel 100 pixels, bottom first, each with the grey value of one layer drawn from the
    profile (solutes do not change it); the goal's one-hot.

    **Reward** at the end - sum over the vessels of (mol of the goal x its solute purity there), minus the same sum at
    the start. Solvents do not count; each ion counts; for a salt as goal, a pair of ions counts as one.
    """

    positions = ("EV", "B1", "B2")
    score_meaning = "gain of mol x solute purity of the goal"
    process_kinds = ("drain", "mix", "pour", "add", "settle")

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        return self.purity_measure(shelf, experiments, members, self.goals.solute_counts)
