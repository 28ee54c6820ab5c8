"""Quality requirements of experiments, hidden parameters revealed to benches, and self-reported outcomes."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from ..config.scenario import Scenario
from ..kernels.arrays import BoolArray, Field, FloatArray, IntArray, StreamArray
from ..kernels.jit import kernel
from ..kernels.rng import normal
from ..physics.chemistry import AMOUNTS

REPORT = ("amount", "purity", "ticks")
"""Self-reported outcome: mol of the goal in the vessel with the largest mol x purity, its purity, the elapsed ticks."""


class GradeState(NamedTuple):
    """State of a bench's experiments with quality requirements or revealed hidden parameters.

    N laboratories, T revealed numbers.
    """

    grade: Annotated[IntArray, Field("N")]
    """[N] index of the experiment's quality requirement"""
    told: Annotated[FloatArray, Field("N T", first=None)]
    """[N, T] revealed hidden parameters, scaled to [0, 1]"""


class Grades:
    """Quality requirements of a scenario as arrays.

    Attributes:
        names: names of the K requirements; may be empty.
        amount: [K] minimum mol.
        purity: [K] minimum purity.
        ticks: [K] maximum ticks.
        shown: [K, 3] the same as observed by a bench's agent, scaled to [0, 1].
        largest: mol at a scaled amount of 1.
    """

    def __init__(self, scenario: Scenario, key: str) -> None:
        limit, wanted = scenario.benches[key].step_limit, list(scenario.grades.values())
        self.names = tuple(scenario.grades)
        self.amount = np.array([grade.amount_at_least_mol for grade in wanted])
        self.purity = np.array([grade.purity_at_least for grade in wanted])
        self.ticks = np.array([min(limit if grade.ticks is None else grade.ticks, limit) for grade in wanted])
        self.largest = max(scenario.theoretical_maximum_mol.values())
        columns = [np.minimum(self.amount / self.largest, 1.0), self.purity, self.ticks / limit]
        self.shown = np.stack(columns, axis=-1)

    def met(self, grade: IntArray, found: FloatArray) -> BoolArray:
        """Return [B] whether the amounts and purities ``found`` [B, 2] meet the requirement."""
        return np.asarray((found[:, 0] >= self.amount[grade]) & (found[:, 1] >= self.purity[grade]))


def best_vessel(rows: FloatArray, parts: IntArray, counts: FloatArray) -> FloatArray:
    """Return [B, 2] mol of the goal and its purity in the vessel with the largest mol x purity.

    Args:
        rows: [B, P, W] vessels of the experiments.
        parts: [B, 3] parts of each goal, see :class:`chemlab.roles.bench.Goals`.
        counts: [B, M] weight of each material in the purity.
    """
    amounts = rows[:, :, AMOUNTS : AMOUNTS + counts.shape[1]]
    each = np.arange(len(rows))
    made, *ions = (amounts[each, :, np.maximum(parts[:, k], 0)] for k in range(3))
    made = made + np.where(parts[:, None, 1] >= 0, np.minimum(*ions), 0.0)
    total = (amounts * counts[:, None]).sum(axis=2)
    purity = made / np.where(total > 0.0, total, 1.0)
    best = (made * purity).argmax(axis=1)
    return np.column_stack([made[each, best], purity[each, best]])


@kernel
def noisy(members: IntArray, deviation: float, stream: StreamArray, out: FloatArray) -> None:
    """Add normal noise from the members' own streams to numbers [B, K] in [0, 1], and clip them."""
    for b in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[b, k] = min(max(out[b, k] + deviation * normal(stream[members[b]]), 0.0), 1.0)
