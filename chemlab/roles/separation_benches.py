"""Benches that separate: extraction (ExT), distillation (DiT) and crystallization (CrT, physics ``real`` only).

Observations are 100 layer pixels of each of three vessels, gauges of the first vessel, and the goal.

| Bench | Gauges | Actions | Steps by default |
|---|---|---|---|
| extraction, by partition between solvents | none | Discrete(41): 8 processes x 5 magnitudes, end | 50 |
| distillation, by boiling points | T, V, P | Discrete(31): 3 processes x 10 magnitudes, end | 50 |
| crystallization, by solubility | T, V, P, solids | Discrete(35): 11 processes, end | 60 |
"""

from __future__ import annotations

from ..config.datafile import DataError
from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, IntArray
from ..physics.chemistry import ChemistryTable
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
    gauge_count = 3

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        return self.purity_measure(shelf, experiments, members, self.goals.absolute_counts)


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
    gauge_count = 4

    def __init__(self, key: str, scenario: Scenario, chemistry: ChemistryTable) -> None:
        if scenario.physics == "paper":
            raise DataError(
                f"{scenario.origin}: benches.{key}.kind: 'crystallization' needs physics = 'real', "
                f"given {scenario.physics!r}"
            )
        super().__init__(key, scenario, chemistry)

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        return self.purity_measure(shelf, experiments, members, self.goals.absolute_counts)
