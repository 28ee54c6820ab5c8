"""The experiments of the paper, and which training runs in a folder of results belong to them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.arrays import FloatArray
from chemlab.scenario import load_scenario

from ..roles import MANAGER_ROLE, role_of
from ..runs import Run, RunResult, find_runs
from ..training.arguments import TrainArguments
from ..training.tasks import task_fingerprint

__all__ = [
    "EXPERIMENTS",
    "Cell",
    "Experiment",
    "FinishedRun",
    "Results",
    "curve_of",
    "display_name",
    "read_results",
    "trace_source",
]


@dataclass(frozen=True)
class Experiment:
    """One of the paper's experiments: a bench, and the algorithms that were trained on it."""

    key: str
    title: str
    scenario: str
    bench: str
    algorithms: tuple[str, ...]


_CONTINUOUS = ("ppo", "a2c", "sac", "td3")
_ABBREVIATIONS = ("ppo", "a2c", "dqn", "sac", "td3", "xl")
_DISCRETE = ("ppo-xl", "ppo", "a2c", "dqn")

EXPERIMENTS: dict[str, Experiment] = {
    e.key: e
    for e in (
        Experiment("wurtz_rxn", "Wurtz RxN", "wurtz_dodecane", "rxn", _CONTINUOUS),
        Experiment("fictitious_rxn", "Fictitious RxN", "fictitious", "rxn", _CONTINUOUS),
        Experiment("wurtz_ext", "Wurtz ExT", "wurtz_dodecane", "ext", _DISCRETE),
        Experiment("wurtz_dit", "Wurtz DiT", "wurtz_dodecane", "dit", _DISCRETE),
    )
}
"""By key, in the paper's order."""


def display_name(label: str) -> str:
    """What figures call an algorithm or one of its variants: ``ppo-xl`` is PPO-XL, ``ppo-entropy`` PPO-entropy."""
    return "-".join(part.upper() if part in _ABBREVIATIONS else part for part in label.split("-"))


def curve_of(run: Run) -> FloatArray:
    """[P, 3] step, mean and standard deviation of the returns of the episodes that ended in each rollout."""
    points = [
        (p.step, p.return_mean, p.return_std)
        for p in run.curve()
        if p.return_mean is not None and p.return_std is not None
    ]
    return np.array(points, dtype=np.float64).reshape(-1, 3)


@dataclass(frozen=True)
class FinishedRun:
    """A training run with its result."""

    run: Run
    config: dict[str, Any]
    result: RunResult

    def curve(self) -> FloatArray:
        """[P, 3] step, mean and standard deviation of the returns of the episodes that ended in each rollout."""
        return curve_of(self.run)


@dataclass(frozen=True)
class Cell:
    """The runs of one algorithm in one experiment, which differ in their seed alone."""

    experiment: Experiment
    label: str
    runs: list[FinishedRun]

    @property
    def best(self) -> FinishedRun:
        """The run whose best policy has the highest mean return."""
        return max(self.runs, key=lambda run: run.result.mean)

    @property
    def steps(self) -> int:
        """Steps of a run."""
        return self.runs[0].result.steps

    def relative(self, goal: str) -> FloatArray:
        """[runs] return of each run's best policy for a goal over the scripted one's; NaN where that is not above 0."""
        ratios = []
        for run in self.runs:
            reference = (run.result.heuristic_by_goal or {}).get(goal, 0.0)
            ratios.append(run.result.by_goal[goal] / reference if reference > 0.0 else np.nan)
        return np.array(ratios)

    @property
    def goals(self) -> list[str]:
        """Goals of the experiment."""
        return list(self.best.result.by_goal)

    def best_ratios(self) -> dict[str, float]:
        """:meth:`relative` of the best run, by goal."""
        index = self.runs.index(self.best)
        return {goal: float(self.relative(goal)[index]) for goal in self.goals}

    def mean_ratios(self) -> dict[str, float]:
        """Mean over runs of :meth:`relative`, by goal."""
        return {goal: float(self.relative(goal).mean()) for goal in self.goals}

    def means(self) -> FloatArray:
        """[runs] mean return over goals of each run's best policy."""
        return np.array([run.result.mean for run in self.runs])

    def heuristic_mean(self) -> float | None:
        """Mean return of the scripted policy, over the runs' evaluations of it."""
        found = [run.result.heuristic_mean for run in self.runs if run.result.heuristic_mean is not None]
        return float(np.mean(found)) if found else None

    def final_training_returns(self, window: float = 0.1) -> FloatArray:
        """[runs] mean training return in the last part of each curve, where it has one."""
        finals = []
        for run in self.runs:
            curve = run.curve()
            if len(curve):
                finals.append(curve[curve[:, 0] >= (1.0 - window) * curve[-1, 0], 1].mean())
        return np.array(finals)


@dataclass
class Results:
    """What a folder of results holds.

    Attributes:
        folder: the folder.
        cells: by experiment key and label, the paper's algorithms in the paper's order and then others.
        laboratories: finished runs in which a laboratory's manager learned; they are in no cell, and have a page of
            their own (:mod:`chemlab.agents.evaluation.laboratory`).
        traces: content of ``traces.json``, or None; without what is of
            another bench, or of another policy than the best now.
        left_out: what is in no cell (runs, traces), and why.
    """

    folder: Path
    cells: dict[str, dict[str, Cell]] = field(default_factory=dict)
    laboratories: list[FinishedRun] = field(default_factory=list)
    traces: dict[str, Any] | None = None
    left_out: list[str] = field(default_factory=list)

    def cell(self, experiment: str, label: str) -> Cell | None:
        """A cell, if there are runs for it."""
        return self.cells[experiment].get(label)

    def variants(self, experiment: str, label: str) -> list[str]:
        """An algorithm of the paper and the variants of it that were trained (but not those that the paper has)."""
        own = EXPERIMENTS[experiment].algorithms
        others = [name for name in self.cells[experiment] if name not in own and label in name.split("-")]
        return [label, *others]

    def missing(self, experiment: str) -> list[str]:
        """The paper's algorithms without runs."""
        return [label for label in EXPERIMENTS[experiment].algorithms if label not in self.cells[experiment]]

    def trace(self, experiment: str, policy: str) -> dict[str, Any] | None:
        """What the traces have of a policy (``heuristic``, ``random`` or an algorithm's label)."""
        found: dict[str, dict[str, Any]] = (self.traces or {}).get("experiments", {})
        policies: dict[str, dict[str, Any]] = found.get(experiment, {}).get("policies", {})
        return policies.get(policy)


_DEFAULTS = vars(TrainArguments())
_TRACES = 2
"""Format of ``traces.json``."""
_PER_RUN = ("seed", "versions", "label")
"""What may differ between the runs of a cell."""


def read_results(folder: Path) -> Results:
    """Read every run below a folder.

    An algorithm may have been trained in more than one way (numbers of steps, hyperparameters); a cell takes the way
    that has most runs, and of several the one with most steps. Runs of a bench that has changed since are left out.

    Raises:
        ValueError: the folder is not there, or a file in it is not what a run writes.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder of results")
    results = Results(folder, {key: {} for key in EXPERIMENTS})
    ways: dict[tuple[str, str], dict[str, list[FinishedRun]]] = {}
    for run in find_runs(folder):
        name = str(run.path.relative_to(folder))
        config, result = run.config() or {}, run.result()
        key = next((k for k, e in EXPERIMENTS.items() if _of(config, e)), None)
        manager = _has_manager(config)
        if key is None and not manager:
            results.left_out.append(f"{name}: not one of the paper's experiments")
        elif result is None:
            results.left_out.append(f"{name}: not finished")
        elif key is None:
            results.laboratories.append(FinishedRun(run, config, result))
        elif config.get("fingerprint") != _fingerprint(EXPERIMENTS[key]):
            results.left_out.append(f"{name}: the bench has changed since it was trained")
        else:
            # What an older version did not know yet had its default.
            own = {k: v for k, v in config.items() if k not in _PER_RUN and v != _DEFAULTS.get(k)}
            way = json.dumps(own, sort_keys=True)
            ways.setdefault((key, result.label), {}).setdefault(way, []).append(FinishedRun(run, config, result))
    for (key, label), groups in ways.items():
        chosen = max(groups.values(), key=lambda runs: (len(runs), runs[0].result.steps))
        results.cells[key][label] = Cell(EXPERIMENTS[key], label, sorted(chosen, key=lambda r: r.result.seed))
        for runs in groups.values():
            if runs is not chosen:
                names = (str(r.run.path.relative_to(folder)) for r in runs)
                results.left_out += [f"{name}: trained in another way than most {label} runs there" for name in names]
    for key, cells in results.cells.items():
        order = EXPERIMENTS[key].algorithms
        ranks = {label: order.index(label) if label in order else len(order) for label in cells}
        results.cells[key] = {label: cells[label] for label in sorted(cells, key=lambda label: (ranks[label], label))}
    _read_traces(results)
    return results


def _read_traces(results: Results) -> None:
    """Read ``traces.json``, without what is another policy's than the one that is shown now."""
    file = results.folder / "traces.json"
    if not file.exists():
        return
    again = f"chemlab figures {results.folder} --collect makes it anew"
    try:
        traces = json.loads(file.read_text(encoding="utf-8"))
        if traces["format"] != _TRACES:
            results.left_out.append(f"traces.json: of another version; {again}")
            return
        for key, traced in list(traces["experiments"].items()):
            title = EXPERIMENTS[key].title
            if traced["fingerprint"] != _fingerprint(EXPERIMENTS[key]):
                del traces["experiments"][key]
                results.left_out.append(f"traces.json: {title}: the bench has changed since; {again}")
            for label, policy in list(traced["policies"].items()):
                cell = results.cell(key, label)
                best = None if cell is None else trace_source(results.folder, cell)
                if policy["source"] != best:
                    del traced["policies"][label]
                    results.left_out.append(f"traces.json: {title}, {label}: not of the best policy now; {again}")
        results.traces = traces
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{file}: not what chemlab figures --collect writes ({error!r})") from error


def trace_source(folder: Path, cell: Cell) -> dict[str, Any]:
    """What a trace of a cell's best policy says of where it comes from: the run, and the checkpoint's step."""
    result = cell.best.result
    path = cell.best.run.path.relative_to(folder).as_posix()
    return {"run": path, "seed": result.seed, "step": result.best_step, "mean": result.mean}


def _fingerprint(experiment: Experiment) -> str:
    """Of the experiment's bench as it is now."""
    return task_fingerprint(
        TrainArguments(env_id="chemlab/Bench-v0", scenario=experiment.scenario, bench=experiment.bench)
    )


def _has_manager(config: dict[str, Any]) -> bool:
    """Whether a run's learners are a laboratory's agent or roles (``manager_0``; ``manager,rxn``) with its manager."""
    return any(name == MANAGER_ROLE or role_of(name) == MANAGER_ROLE for name in str(config.get("bench")).split(","))


def _of(config: dict[str, Any], experiment: Experiment) -> bool:
    """Whether a run belongs to an experiment: its bench, all goals, the paper's starting states."""
    return (
        (config.get("scenario"), config.get("bench")) == (experiment.scenario, experiment.bench)
        and config.get("starts", "paper") == "paper"
        and set(config.get("goals", ())) == set(load_scenario(experiment.scenario).goals)
    )
