"""Purity and recovery of the distillation bench of `wurtz_real`: what stays in the pot, by where the cut is made.

    python validate/front.py                        # scripted cuts: writes validate/front.csv and the figure
    python validate/front.py --trained RUN          # the front of a trained agent, too
    python validate/front.py --figure               # docs/images/front.png from the table as it is

Scripted: the pot is heated in steps of 1 kJ until it reaches a temperature, with columns of several numbers of
theoretical stages. Trained: an agent that is asked for a purity (`validate/front.toml`), made by

    chemlab train chemlab/Bench-v0 --scenario validate/front.toml --bench dit --preset ppo-entropy
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mixtures import write

from chemlab.agents.policies import bench_policy
from chemlab.arrays import FloatArray, ObservationArray
from chemlab.chemistry import AMOUNTS, TEMPERATURE
from chemlab.laboratory.experiments import ExperimentBatch
from chemlab.scenario import Scenario, load_scenario

HERE = Path(__file__).parent
TABLE, FIGURE = HERE / "front.csv", HERE.parent / "docs" / "images" / "front.png"
BENCH, GOAL, POT = "dit", "dodecane", 0
STAGES = (1, 2, 5, 15)
REFLUX = 3.0
"""mol run back for each that leaves, where there is a column."""
CUTS_K = np.concatenate([np.arange(400.0, 480.0, 5.0), np.arange(480.0, 489.5, 0.5)])
WATER = 0.3
"""mol in the charge of `wurtz_real`."""
HEATING_KJ = 1.0
MOST_STEPS = 2_000
EPISODES = 50


def asked(**bench: Any) -> Scenario:
    """The scenario, with another column."""
    values = {"base": str(HERE / "front.toml"), "name": "front", "benches": {BENCH: bench}} if bench else None
    return load_scenario(values or HERE / "front.toml")


class Pots:
    """Distillations side by side, without an environment around them.

    Args:
        spec: the scenario.
        count: N.
    """

    def __init__(self, spec: Scenario, count: int) -> None:
        self.batch = ExperimentBatch(spec, BENCH, count)
        self.bench, self.members = self.batch.bench, self.batch.members
        for member in range(count):
            self.batch.seed(member, member)
        self.batch.reset(self.members)
        self.begun = self.kept()[1]

    def kept(self) -> FloatArray:
        """[2, N] purity (mole fraction) and mol of the goal in each pot."""
        shelf = self.batch.shelf
        amounts = shelf.vessels[:, POT, AMOUNTS : AMOUNTS + len(shelf.layout.materials)]
        goal = amounts[:, shelf.layout.index(GOAL)]
        return np.stack([goal / np.maximum(amounts.sum(axis=1), 1e-12), goal])

    def observe(self) -> ObservationArray:
        """[N, numbers] what agents see."""
        out = np.zeros((len(self.members), *self.bench.observation_space.shape), dtype=np.float32)
        self.bench.observe(self.batch.shelf, self.batch.experiments, self.members, out)
        return out


def row(by: str, at: float, purity: float, recovery: float) -> dict[str, Any]:
    """A line of the table."""
    return {"by": by, "at": f"{at:g}", "purity": f"{purity:.4f}", "recovery": f"{recovery:.4f}"}


def scripted(stages: int, water: float = 0.0) -> Iterator[dict[str, Any]]:
    """A pot for each cut, heated until it is that hot; ``water`` mol of it are in the charge."""
    start = {"start": {"contents": {"water": water}}} if water else {}
    pots = Pots(asked(stages=stages, reflux=REFLUX, step_limit=MOST_STEPS, **start), len(CUTS_K))
    heats = dict(zip(pots.bench.options.process[0].magnitudes, range(1_000), strict=False))
    heating, cutting = heats[HEATING_KJ], pots.members
    title = ("1 stage" if stages == 1 else f"{stages} stages") + (", not dried" if water else "")
    for _ in range(MOST_STEPS):
        kelvin = pots.batch.shelf.vessels[:, POT, TEMPERATURE]
        purity, mol = pots.kept()
        for i in cutting[kelvin[cutting] >= CUTS_K[cutting]]:
            yield row(title, CUTS_K[i], purity[i], mol[i] / pots.begun[i])
        cutting = cutting[kelvin[cutting] < CUTS_K[cutting]]
        if not len(cutting):
            return
        pots.batch.act(np.full(len(cutting), heating), cutting, pots.bench)


def trained(run: str) -> Iterator[dict[str, Any]]:
    """What an agent keeps for each purity that it is asked for, in the mean."""
    for g, grade in enumerate(asked().grades.values()):
        pots = Pots(asked(), EPISODES)
        agent = bench_policy(run, pots.bench)
        pots.batch.experiments.grade[:] = g
        running = pots.members
        for step in range(pots.bench.step_limit):
            mask = np.zeros((EPISODES, pots.bench.action_space.n), dtype=np.int8)
            pots.bench.mask(pots.batch.shelf, pots.batch.experiments, pots.members, mask)
            action = agent.act(pots.observe(), mask, np.full(EPISODES, step), pots.members)
            pots.batch.act(action[running], running, pots.bench)
            running = running[~pots.batch.experiments.ended[running]]
            if not len(running):
                break
        found = pots.kept()
        yield row("PPO", grade.purity_at_least, found[0].mean(), (found[1] / pots.begun).mean())


def draw() -> None:
    """The table as a figure."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with TABLE.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for by in dict.fromkeys(one["by"] for one in rows):
        own = [
            (100.0 * float(one["recovery"]), 100.0 * (1.0 - float(one["purity"]))) for one in rows if one["by"] == by
        ]
        axes.plot(*zip(*own, strict=True), "o" if by == "PPO" else "-", label=by)
    axes.set(xlabel="dodecane kept (%)", ylabel="impurity in the pot (mole %)", yscale="log", xlim=(60, 100.5))
    axes.grid(alpha=0.3)
    axes.legend(title="cut at rising temperature")
    figure.savefig(FIGURE, dpi=110)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trained", metavar="RUN", help="a training run of validate/front.toml")
    parser.add_argument("--figure", action="store_true", help="draw the table as it is")
    chosen = parser.parse_args()
    if not chosen.figure:
        rows = [line for stages in STAGES for line in scripted(stages)]
        rows += scripted(5, WATER)
        rows += trained(chosen.trained) if chosen.trained else []
        write(TABLE.name, list(rows[0]), [list(line.values()) for line in rows])
    draw()


if __name__ == "__main__":
    main()
