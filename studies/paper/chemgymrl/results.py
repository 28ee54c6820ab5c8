"""The paper's experiments, and the assignment of training runs to them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.evaluate.results import Cell, Cells, TrainedRun, cells_of, display_name, group_runs
from chemlab.agents.train.arguments import PPO
from chemlab.agents.train.tasks import task_fingerprint

from ..tables import read_runs, read_table

TABLES = Path(__file__).parent / "results"
"""Folder of the published results."""

TRACE_FILE = "traces.csv"
TRACE_COLUMNS = (
    *("experiment", "policy", "fingerprint", "run", "step", "goal", "case"),
    *("episodes", "mean_return", "best_return", "actions"),
)


@dataclass(frozen=True)
class Experiment:
    """One of the paper's experiments: a bench and the algorithms trained on it."""

    key: str
    title: str
    scenario: str
    bench: str
    algorithms: tuple[str, ...]

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the current bench."""
        return str(task_fingerprint(PPO(scenario=self.scenario, bench=self.bench)))

    @property
    def goals(self) -> tuple[str, ...]:
        """Goals of the bench."""
        return tuple(load_scenario(self.scenario).goals)

    @property
    def action_names(self) -> list[str]:
        """Names of the discrete actions, or of the numbers of a continuous action."""
        return _action_names(self.scenario, self.bench)


@cache
def _action_names(scenario: str, bench: str) -> list[str]:
    env = Target(load_scenario(scenario), bench).environment(1)
    reagents = getattr(env.bench, "reagent_names", None)
    return list(env.action_meanings) if reagents is None else ["temperature", "volume", *(f"add {r}" for r in reagents)]


_CONTINUOUS, _DISCRETE = ("ppo", "a2c", "sac", "td3"), ("ppo-xl", "ppo", "a2c", "dqn")

EXPERIMENTS: dict[str, Experiment] = {
    e.key: e
    for e in (
        Experiment("wurtz_rxn", "Wurtz RxN", "wurtz_dodecane", "rxn", _CONTINUOUS),
        Experiment("fictitious_rxn", "Fictitious RxN", "fictitious", "rxn", _CONTINUOUS),
        Experiment("wurtz_ext", "Wurtz ExT", "wurtz_dodecane", "ext", _DISCRETE),
        Experiment("wurtz_dit", "Wurtz DiT", "wurtz_dodecane", "dit", _DISCRETE),
    )
}
"""Experiments by key, in the paper's order."""


def experiment_of(run: TrainedRun) -> str | None:
    """Return the key of the experiment with a run's bench, all goals and the paper's starting states, or None."""
    for key, experiment in EXPERIMENTS.items():
        same = (run.config.get("scenario"), run.config.get("bench")) == (experiment.scenario, experiment.bench)
        everything = set(run.config.get("goals", ())) == set(experiment.goals)
        if same and everything and run.config.get("starts", "paper") == "paper":
            return key
    return None


class Trace(NamedTuple):
    """Actions of a policy for one goal from one starting state.

    Attributes:
        episodes: number of episodes.
        mean_return: mean return of these.
        best_return: return of the best one, for discrete actions.
        actions: actions of the best episode, or the mean of each step for continuous actions.
    """

    episodes: int
    mean_return: float
    best_return: float | None
    actions: list[Any]


@dataclass
class Results:
    """Content of the tables.

    Attributes:
        cells: by experiment key and label; the paper's algorithms in the paper's order, then others.
        traces: by experiment key, policy (``scripted``, ``random`` or an algorithm's label), goal and starting state
            ('' if there is one only), without traces of another bench or of a policy that is no longer the best.
        left_out: omitted runs and traces, with reasons.
    """

    cells: Cells = field(default_factory=lambda: {key: {} for key in EXPERIMENTS})
    traces: dict[str, dict[str, dict[str, dict[str, Trace]]]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)

    def cell(self, experiment: str, label: str) -> Cell | None:
        """Return a cell, or None without runs."""
        return self.cells[experiment].get(label)

    def variants(self, experiment: str, label: str) -> list[str]:
        """Return an algorithm of the paper and its trained variants that are not in the paper."""
        own = EXPERIMENTS[experiment].algorithms
        return [label, *(name for name in self.cells[experiment] if name not in own and label in name.split("-"))]

    def missing(self, experiment: str) -> list[str]:
        """Return the paper's algorithms without runs."""
        return [label for label in EXPERIMENTS[experiment].algorithms if label not in self.cells[experiment]]

    def trace(self, experiment: str, policy: str) -> dict[str, dict[str, Trace]] | None:
        """Return a policy's traces by goal and starting state, or None."""
        return self.traces.get(experiment, {}).get(policy)

    def played_mean(self, experiment: str, policy: str) -> float | None:
        """Return the mean return of a policy's traces over goals."""
        by_goal = self.trace(experiment, policy)
        if by_goal is None:
            return None
        means = [
            sum(t.episodes * t.mean_return for t in cases.values()) / sum(t.episodes for t in cases.values())
            for cases in by_goal.values()
        ]
        return sum(means) / len(means)

    def scripted_mean(self, experiment: str) -> float | None:
        """Return the mean return of the scripted policy in the runs' evaluations."""
        known = [mean for cell in self.cells[experiment].values() if (mean := cell.scripted_mean()) is not None]
        return sum(known) / len(known) if known else self.played_mean(experiment, "scripted")


def read_results(folder: Path = TABLES) -> Results:
    """Read a folder of tables, or of runs with an optional table of traces; see :func:`results_of`.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
    """
    results = results_of(read_runs(folder))
    _read_traces(results, folder)
    return results


def results_of(given: Iterable[TrainedRun]) -> Results:
    """Return the runs by experiment and label, without traces; runs of a bench that has changed since are left out."""
    results, runs = Results(), []
    for run in given:
        key = experiment_of(run)
        if key is None:
            results.left_out.append(f"{run.name}: not one of the paper's experiments")
        elif run.config.get("fingerprint") != EXPERIMENTS[key].fingerprint:
            results.left_out.append(f"{run.name}: the bench has changed since it was trained")
        else:
            runs.append(run)
    groups = group_runs(runs, lambda run: EXPERIMENTS[experiment_of(run) or ""].title)
    for labels in groups.values():
        for label in [label for label in labels if "(" in label]:
            results.left_out += [f"{run.name}: has other settings than most of its label" for run in labels.pop(label)]
    cells, others = cells_of(groups)
    results.left_out += others
    for key, experiment in EXPERIMENTS.items():
        own, order = cells.get(experiment.title, {}), experiment.algorithms
        ranks = {label: order.index(label) if label in order else len(order) for label in own}
        results.cells[key] = {label: own[label] for label in sorted(own, key=lambda label: (ranks[label], label))}
    return results


def source_of(cell: Cell) -> tuple[str, str]:
    """Return the source of a trace of a cell's best policy: the run, and the checkpoint's step."""
    return cell.best.name, str(cell.best.finished.best_step)


def _read_traces(results: Results, folder: Path) -> None:
    """Read the traces of the current best policies."""
    again = "python -m studies.paper --collect RUNS makes it again"
    left_out = set()
    for row in read_table(folder / TRACE_FILE, TRACE_COLUMNS):
        key, policy = row["experiment"], row["policy"]
        title, cell = EXPERIMENTS[key].title, results.cell(key, policy)
        source = ("", "") if cell is None else source_of(cell)
        if row["fingerprint"] != EXPERIMENTS[key].fingerprint:
            left_out.add(f"{TRACE_FILE}: {title}: the bench has changed since; {again}")
        elif (row["run"], row["step"]) != source:
            left_out.add(f"{TRACE_FILE}: {title}, {display_name(policy)}: not of the best policy now; {again}")
        else:
            best = float(row["best_return"]) if row["best_return"] else None
            trace = Trace(int(row["episodes"]), float(row["mean_return"]), best, json.loads(row["actions"]))
            by_goal = results.traces.setdefault(key, {}).setdefault(policy, {})
            by_goal.setdefault(row["goal"], {})[row["case"]] = trace
    results.left_out += sorted(left_out)
