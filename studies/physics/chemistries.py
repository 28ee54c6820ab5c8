"""Random chemistries: loading, conservation of atoms, playability, and the share that the general script solves.

    python studies/physics/chemistries.py                   # 1,000 of each backend, to studies/physics/chemistries.csv
    python studies/physics/chemistries.py --physics real    # one backend only; the other's rows stay
    python studies/physics/chemistries.py --number 30       # fewer, nothing is written

Chemistry i has seed i and the difficulty easy, medium or hard in turn. Each is generated, and its files are written and
loaded again. The scripted agents play its hardest goal once (as ``chemlab run`` does), and its reaction bench is run
under constant conditions (``chemlab audit difficulty``). ``atoms`` is the largest relative change of any element, from
the initial stock to the submitted, discarded and remaining material. ``solved`` means a score of at least half of the
score for all of the goal, pure, without costs; ``solved_of_yield`` means half of that times the yield under constant
conditions. Scores, purities, yields and selectivities are medians, except the yield's 5 % quantile.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from chemlab import load_scenario
from chemlab.agents.episodes import Played, play_laboratory
from chemlab.agents.executors import executor
from chemlab.agents.policies import make_policies
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories
from chemlab.openchem.difficulty import constant_conditions
from chemlab.openchem.generate import LEVELS, generated
from chemlab.physics.chemistry import element_matrix

SOLVED = 0.5
NUMBER = 1000
Row = tuple[str, float, float, float, float, float, float]


def scripted(spec: Scenario) -> tuple[Played, FloatArray, FloatArray]:
    """Play one scripted episode for the hardest goal; return it with [E] mol of each element before and after."""
    labs = Laboratories(spec, 1)
    labs.reset(labs.members)
    atoms = element_matrix(spec)
    before = atoms @ labs.shelf.total()[0]
    played = play_laboratory(labs, make_policies("scripted", labs, 0), spec.goals[-1], 0)
    return played, before, atoms @ (labs.shelf.total()[0] + labs.state.delivered[0])


def play(physics: str, seed: int) -> Row:
    """Return difficulty, then score, purity, yield and selectivity under constant conditions, change of atoms,
    seconds.
    """
    begun = time.perf_counter()
    difficulty = list(LEVELS)[seed % len(LEVELS)]
    with tempfile.TemporaryDirectory() as folder:
        spec = load_scenario(generated(seed, difficulty=difficulty, physics=physics).write(folder))
    played, before, after = scripted(spec)
    lasted = time.perf_counter() - begun
    change = float(np.abs(after - before).max() / np.abs(before).max())
    found = constant_conditions(spec, spec.goals[-1])
    assert found is not None
    score, purity = float(played.returns[0]), float(played.measures["purity"][0])
    return difficulty, score, purity, found.reached, found.selectivity, change, lasted


def rows(physics: str, number: int, jobs: Executor) -> Iterator[tuple[object, ...]]:
    """Yield a row of the table for each difficulty."""
    played = list(jobs.map(play, [physics] * number, range(number)))
    for difficulty in LEVELS:
        numbers = np.array([row[1:] for row in played if row[0] == difficulty])
        score, purity, reached, selectivity, change, lasted = numbers.T
        yield (
            physics,
            difficulty,
            len(numbers),
            f"{change.max():.1e}",
            f"{(score >= SOLVED).mean():.3f}",
            f"{(score >= SOLVED * reached).mean():.3f}",
            *(f"{np.median(x):.3f}" for x in (score, purity, reached, selectivity)),
            f"{np.percentile(reached, 5):.3f}",
        )
        print(f"{physics} {difficulty}: median {np.median(lasted):.2f} s each", file=sys.stderr)


def main() -> None:
    """Run the command; the table is written only if it is complete."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--number", type=int, default=NUMBER)
    parser.add_argument("--processes", type=int)
    parser.add_argument("--address", help="as for chemlab audit")
    parser.add_argument("--physics", nargs="*", default=["paper", "real"])
    given = parser.parse_args()
    columns = ("atoms", "solved", "solved_of_yield", "score", "purity", "yield", "selectivity", "yield_5_percent")
    header = ("physics", "difficulty", "number", *columns)
    print(*(f"{name:>15}" for name in header))
    table = []
    with executor(given.address, given.processes) as jobs:
        for physics in given.physics:
            for row in rows(physics, given.number, jobs):
                table.append(row)
                print(*(f"{cell!s:>15}" for cell in row), flush=True)
    if given.number == NUMBER:
        path = Path(__file__).with_suffix(".csv")
        with path.open(encoding="utf-8", newline="") as handle:
            others = [row for row in csv.reader(handle) if row[0] in {"paper", "real"} - set(given.physics)]
        with path.open("w", encoding="utf-8", newline="") as handle:
            csv.writer(handle, lineterminator="\n").writerows(
                [header, *sorted([*others, *table], key=lambda row: row[0])]
            )


if __name__ == "__main__":
    main()
