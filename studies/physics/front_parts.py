"""Rewards of the agents in `front.toml`."""

from __future__ import annotations

import numpy as np

from chemlab.kernels.arrays import FloatArray, IntArray
from chemlab.physics.chemistry import AMOUNTS
from chemlab.physics.shelf import Shelf
from chemlab.roles.bench import Bench, Experiments


def pot(bench: Bench, shelf: Shelf, experiments: Experiments, members: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return [B] mol of the goal in the pots, and its mole fraction there."""
    amounts = shelf.rows[experiments.places[members, 0], AMOUNTS : AMOUNTS + len(bench.layout.materials)]
    goals = [bench.layout.index(bench.goals.names[goal]) for goal in experiments.goal[members]]
    mol = amounts[np.arange(len(members)), goals]
    return mol, mol / np.maximum(amounts.sum(axis=1), 1e-12)


def kept(bench: Bench, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
    """Return [B] mol of the goal in the pot at the end if it has the required purity, else 0.

    It replaces the bench's own score, which also counts the distillate.
    """
    mol, purity = pot(bench, shelf, experiments, members)
    grade = experiments.grade[members]
    gain = bench.measure(shelf, experiments, members) - experiments.baseline[members]
    met = bench.grades.met(grade, bench.best(shelf, experiments, members))
    score = np.where(met, gain, np.minimum(gain, 0.0))
    return np.where(experiments.ended[members], mol * (purity >= bench.grades.purity[grade]) - score, 0.0)
