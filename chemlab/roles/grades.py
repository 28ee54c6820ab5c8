"""What a manager may ask of an experiment besides its goal, what its bench is told, and what the bench reports."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from ..config.scenario import Scenario
from ..kernels.arrays import Field, FloatArray, IntArray, StreamArray
from ..kernels.jit import kernel
from ..kernels.rng import normal
from ..physics.chemistry import AMOUNTS

__all__ = ["REPORT", "GradeState", "Grades", "best_vessel", "noisy"]

REPORT = ("amount", "purity", "ticks")
"""What a bench reports of an experiment: mol of the goal in the vessel that has most of it by mol x purity, the purity
there, and the ticks it took."""


class GradeState(NamedTuple):
    """What a bench's experiments have where a scenario declares grades, or tells benches of its world. N laboratories,
    T numbers told."""

    grade: Annotated[IntArray, Field("N")]
    """[N] index of the experiment's grade"""
    told: Annotated[FloatArray, Field("N T", first=None)]
    """[N, T] what the bench is told of the world, each from 0 to 1"""


class Grades:
    """A scenario's grades as arrays.

    Attributes:
        names: of the K grades; there may be none.
        amount: [K] least mol.
        purity: [K] least purity.
        ticks: [K] allowed.
        shown: [K, 3] the same as a bench's agent sees them, from 0 to 1.
        largest: mol that an amount of 1 stands for.
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

    def met(self, grade: IntArray, found: FloatArray) -> IntArray:
        """[B] 1 where the amounts and purities ``found`` [B, 2] are those of the grade, else 0."""
        enough = (found[:, 0] >= self.amount[grade]) & (found[:, 1] >= self.purity[grade])
        return enough.astype(np.int64)


def best_vessel(rows: FloatArray, parts: IntArray, counts: FloatArray) -> FloatArray:
    """[B, 2] mol of the goal, and its purity, in the vessel where mol x purity is largest.

    Args:
        rows: [B, P, W] the experiments' vessels.
        parts: [B, 3] of each one's goal, see :class:`chemlab.roles.bench.Goals`.
        counts: [B, M] weight of each material in its purity.
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
    """Add normal noise from the members' own streams to numbers [B, K] from 0 to 1, which stay there."""
    for b in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[b, k] = min(max(out[b, k] + deviation * normal(stream[members[b]]), 0.0), 1.0)
