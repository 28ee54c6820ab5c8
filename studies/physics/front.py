"""Purity and recovery of the distillation bench of `wurtz_real`: residue in the pot as a function of the cut.

    python studies/physics/front.py                      # scripted cuts: writes front.csv and the figure
    python studies/physics/front.py --trained FOLDER     # trained agents as well; missing ones are trained

Scripted: the pot is heated in steps of 1 kJ until it reaches a temperature, with columns of several numbers of
theoretical stages. Trained: one PPO agent for each required purity (`studies/physics/front.toml`), trained from
scratch; the checkpoint with the best evaluation is used.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from front_parts import pot
from mixtures import write

from chemlab import load_scenario
from chemlab.agents.policies import bench_policy
from chemlab.config.files import write_text
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray, ObservationArray
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.chemistry import TEMPERATURE

HERE = Path(__file__).parent
TABLE, FIGURE = HERE / "front.csv", HERE.parents[1] / "docs" / "images" / "front.png"
BENCH, POT = "dit", 0
STAGES = (1, 2, 5, 15)
REFLUX = 3.0
"""Reflux: mol returned per mol distilled, with a column."""
CUTS_K = np.concatenate([np.arange(400.0, 480.0, 5.0), np.arange(480.0, 489.5, 0.5)])
WATER = 0.3
"""mol of water in the charge of `wurtz_real`."""
HEATING_KJ = 1.0
MOST_STEPS = 2_000
EPISODES = 50
STEPS = 300_000
"""Training steps for each purity."""


def asked(**bench: Any) -> Scenario:
    """Return the scenario with another column."""
    values = {"base": str(HERE / "front.toml"), "name": "front", "benches": {BENCH: bench}} if bench else None
    return load_scenario(values or HERE / "front.toml")


class Pots:
    """Distillations side by side, without an environment.

    Args:
        spec: the scenario.
        count: number of distillations N.
    """

    def __init__(self, spec: Scenario, count: int) -> None:
        self.batch = ExperimentBatch(spec, BENCH, count)
        self.bench, self.members = self.batch.bench, self.batch.members
        for member in range(count):
            self.batch.seed(member, member)
        self.batch.reset(self.members)
        self.begun = self.kept()[0]

    def kept(self) -> tuple[FloatArray, FloatArray]:
        """Return [N] mol of the goal in each pot, and its mole fraction there."""
        return pot(self.bench, self.batch.shelf, self.batch.experiments, self.members)

    def observe(self) -> ObservationArray:
        """Return the observations [N, numbers]."""
        out = np.zeros((len(self.members), *self.bench.observation_space.shape), dtype=np.float32)
        self.bench.observe(self.batch.shelf, self.batch.experiments, self.members, out)
        return out


def row(by: str, at: float, purity: float, recovery: float) -> dict[str, Any]:
    """Return a row of the table."""
    return {"by": by, "at": f"{at:g}", "purity": f"{purity:.4f}", "recovery": f"{recovery:.4f}"}


def scripted(stages: int, water: float = 0.0) -> Iterator[dict[str, Any]]:
    """Yield a row for each cut temperature to which a pot is heated; the charge has ``water`` mol of water."""
    start = {"start": {"contents": {"water": water}}} if water else {}
    pots = Pots(asked(stages=stages, reflux=REFLUX, step_limit=MOST_STEPS, **start), len(CUTS_K))
    heats = dict(zip(pots.bench.options.process[0].magnitudes, range(1_000), strict=False))
    heating, cutting = heats[HEATING_KJ], pots.members
    title = ("1 stage" if stages == 1 else f"{stages} stages") + (", not dried" if water else "")
    for _ in range(MOST_STEPS):
        kelvin = pots.batch.shelf.vessels[:, POT, TEMPERATURE]
        mol, purity = pots.kept()
        for i in cutting[kelvin[cutting] >= CUTS_K[cutting]]:
            yield row(title, CUTS_K[i], purity[i], mol[i] / pots.begun[i])
        cutting = cutting[kelvin[cutting] < CUTS_K[cutting]]
        if not len(cutting):
            return
        pots.batch.act(np.full(len(cutting), heating), cutting, pots.bench)


def run_of(folder: Path, grade: str) -> Path:
    """Return the training run for one required purity; start or resume it if it is not finished."""
    folder.mkdir(parents=True, exist_ok=True)
    others = [f"grades.{name}" for name in asked().grades if name != grade]
    scenario = folder / f"{grade}.toml"
    write_text(
        scenario,
        f'base = "{(HERE / "front.toml").as_posix()}"\nname = "front_{grade}"\nremove = {json.dumps(others)}\n',
    )
    command = ["train", scenario, "--bench", BENCH, "--preset", "ppo-entropy"]
    command += ["--trust", "--steps", str(STEPS), "--out", folder / grade]
    subprocess.run([sys.executable, "-m", "chemlab", *command], check=True)
    return folder / grade


def trained(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the mean recovery of agents trained for one purity each."""
    for name, grade in asked().grades.items():
        run = run_of(folder, name)
        pots = Pots(load_scenario(folder / f"{name}.toml"), EPISODES)
        agent = bench_policy(str(run), pots.bench)
        running = pots.members
        for step in range(pots.bench.step_limit):
            mask = np.zeros((EPISODES, pots.bench.action_space.n), dtype=np.int8)
            pots.bench.mask(pots.batch.shelf, pots.batch.experiments, pots.members, mask)
            action = agent.act(pots.observe(), mask, np.full(EPISODES, step), pots.members)
            pots.batch.act(action[running], running, pots.bench)
            running = running[~pots.batch.experiments.ended[running]]
            if not len(running):
                break
        mol, purity = pots.kept()
        yield row("PPO", grade.purity_at_least, purity.mean(), (mol / pots.begun).mean())


def draw(rows: list[dict[str, Any]]) -> None:
    """Draw the table as a figure."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for by in dict.fromkeys(one["by"] for one in rows):
        own = [
            (100.0 * float(one["recovery"]), 100.0 * (1.0 - float(one["purity"]))) for one in rows if one["by"] == by
        ]
        axes.plot(*zip(*own, strict=True), "o" if by == "PPO" else "-", label=by)
    axes.set(xlabel="dodecane kept (%)", ylabel="impurity in the pot (mole %)", yscale="log", xlim=(38, 100.5))
    axes.grid(alpha=0.3)
    axes.legend(title="cut at rising temperature")
    figure.savefig(FIGURE, dpi=110)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trained", type=Path, metavar="FOLDER", help="folder of the training runs")
    folder = parser.parse_args().trained
    with TABLE.open(newline="", encoding="utf-8") as file:
        before = [one for one in csv.DictReader(file) if one["by"] == "PPO"]
    rows = [line for stages in STAGES for line in scripted(stages)]
    rows += scripted(5, WATER)
    rows += trained(folder) if folder else before
    write(TABLE.name, list(rows[0]), [list(line.values()) for line in rows])
    draw(rows)


if __name__ == "__main__":
    main()
