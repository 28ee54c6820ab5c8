"""Read training runs for evaluation, and aggregate runs that differ only in their seed."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from chemlab.config.display import markdown_table
from chemlab.kernels.arrays import FloatArray

from ..runs import Evaluation, Run, RunResult, find_runs
from . import statistics
from .statistics import interval_text, number_text

_ABBREVIATIONS = ("ppo", "a2c", "dqn", "sac", "td3", "xl")
_PER_RUN = ("seed", "versions", "label")
"""Settings that may differ between the runs of a cell."""


@dataclass(frozen=True)
class TrainedRun:
    """A training run, finished or not.

    Attributes:
        name: path relative to the folder that was read.
        config: content of ``config.json``.
        result: result; None if the run is not finished.
        curve: [P, 3] step, mean and standard deviation of the returns of the episodes that ended in each rollout.
        evaluations: evaluations during training.
        folder: folder of the run, with its checkpoints; None if it was read from a table.
    """

    name: str
    config: dict[str, Any]
    result: RunResult | None
    curve: FloatArray
    evaluations: list[Evaluation]
    folder: Run | None = None

    @property
    def finished(self) -> RunResult:
        """Result of a finished run."""
        assert self.result is not None, f"{self.name} is not finished"
        return self.result


def display_name(label: str) -> str:
    """Return the name of an algorithm or variant in figures: ``ppo-xl`` is PPO-XL, ``ppo-entropy`` PPO-entropy."""
    name, space, folder = label.partition(" ")
    return "-".join(part.upper() if part in _ABBREVIATIONS else part for part in name.split("-")) + space + folder


def task_title(run: TrainedRun) -> str:
    """Return a run's task: scenario, bench or agent, goals if not all, starts if not the default."""
    goals = run.config.get("goals") or []
    parts = [f"{run.config.get('scenario')}, {run.config.get('bench')}"]
    parts += [f"goal {goals[0]}"] if len(goals) == 1 else [f"{len(goals)} goals"] if goals else []
    parts += [f"starts {run.config['starts']}"] if run.config.get("starts", "paper") != "paper" else []
    parts += [f"background {run.config['background']}"] if run.config.get("background") else []
    return ", ".join(parts)


def read_runs(folder: Path) -> list[TrainedRun]:
    """Return all runs below a folder, sorted by path.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder of results")
    return [_from_folder(run, run.path.relative_to(folder).as_posix()) for run in find_runs(folder)]


def _from_folder(run: Run, name: str) -> TrainedRun:
    points = [
        (p.step, p.return_mean, p.return_std)
        for p in run.curve()
        if p.return_mean is not None and p.return_std is not None
    ]
    curve = np.array(points, dtype=np.float64).reshape(-1, 3)
    return TrainedRun(name, run.config() or {}, run.result(), curve, run.evaluations(), run)


@dataclass(frozen=True)
class Cell:
    """Finished runs of one task and label, which differ only in their seed."""

    title: str
    label: str
    runs: list[TrainedRun]

    @property
    def best(self) -> TrainedRun:
        """Run whose best policy has the highest mean return."""
        return max(self.runs, key=lambda run: run.finished.mean)

    @property
    def steps(self) -> int:
        """Number of steps of each run."""
        return self.runs[0].finished.steps

    @property
    def goals(self) -> list[str]:
        """Goals of the task."""
        return list(self.best.finished.by_goal)

    def relative(self) -> FloatArray:
        """Return [runs, G] ratios of each run's best policy to the scripted one; NaN if the latter is not above 0."""
        learned, scripted = self.by_goal(), self.scripted_by_goal()
        ratios: FloatArray = np.divide(learned, scripted, out=np.full(learned.shape, np.nan), where=scripted > 0.0)
        return ratios

    def by_goal(self) -> FloatArray:
        """Return [runs, G] returns of each run's best policy."""
        return np.array([[run.finished.by_goal[goal] for goal in self.goals] for run in self.runs])

    def scripted_by_goal(self) -> FloatArray:
        """Return [runs, G] returns of the scripted policy with each run's seeds; NaN if there is none."""
        return np.array(
            [[(run.finished.scripted_by_goal or {}).get(goal, np.nan) for goal in self.goals] for run in self.runs]
        )

    def means(self) -> FloatArray:
        """Return [runs] means over goals of each run's best policy."""
        return np.array([run.finished.mean for run in self.runs])

    def scripted_mean(self) -> float | None:
        """Return the mean return of the scripted policy over the evaluations of all runs; None if there is none."""
        known = [mean for run in self.runs if (mean := run.finished.scripted_mean) is not None]
        return float(np.mean(known)) if known else None


Cells = dict[str, dict[str, Cell]]
"""By task and label."""

Groups = dict[str, dict[str, list[TrainedRun]]]
"""Runs by task and label."""


def _settings(run: TrainedRun) -> str:
    """Return the settings of a run that are equal for all runs of a group, as JSON."""
    settings = {key: value for key, value in run.config.items() if key not in _PER_RUN and value is not None}
    # Seeds in the path of a policy that training began from may differ.
    return re.sub(r"seed-\d+", "seed", json.dumps(settings, sort_keys=True))


def group_runs(runs: Iterable[TrainedRun], task_of: Callable[[TrainedRun], str] = task_title) -> Groups:
    """Group runs, finished or not, that differ only in their seed.

    If runs of one label have different settings (steps, hyperparameters), the largest group has the label, or, of equal
    groups, the one with most steps. The labels of the others also name their folder: ``ppo (FOLDER)``.
    """
    found: dict[tuple[str, str], dict[str, list[TrainedRun]]] = {}
    for run in runs:
        key = task_of(run), str(run.config.get("label", run.name))
        found.setdefault(key, {}).setdefault(_settings(run), []).append(run)
    groups: Groups = {}
    for (task, label), by_settings in found.items():
        labels = groups.setdefault(task, {})
        by_size = sorted(by_settings.values(), key=lambda group: (len(group), group[0].config.get("steps") or 0))
        for group in reversed(by_size):
            path = PurePosixPath(group[0].name)
            folder = path.parent if path.name.startswith("seed-") else path
            names = (label, f"{label} ({folder})", f"{label} ({path})")
            labels[next(name for name in names if name not in labels)] = group
    return groups


def cells_of(groups: Groups) -> tuple[Cells, list[str]]:
    """Return the cells of finished runs, and the runs that are in no cell, with the reason.

    A cell has one run for each seed: repetitions are no further samples.
    """
    cells: Cells = {}
    left_out = []
    for task, labels in groups.items():
        for label, runs in labels.items():
            by_seed: dict[int, TrainedRun] = {}
            for run in runs:
                if run.result is None:
                    left_out.append(f"{run.name}: not finished")
                elif (first := by_seed.setdefault(run.result.seed, run)) is not run:
                    left_out.append(f"{run.name}: has the seed of {first.name}, {run.result.seed}, and equal settings")
            if by_seed:
                cells.setdefault(task, {})[label] = Cell(task, label, [by_seed[seed] for seed in sorted(by_seed)])
    return cells, left_out


def cells_table(cells: Iterable[Cell]) -> list[str]:
    """Return the lines of a Markdown table of returns and the comparison with the scripted policy.

    Confidence intervals are over training seeds; a single run has none.
    """
    names = (
        *("experiment", "algorithm", "runs", "steps", "mean", "interquartile mean", "best run", "last", "scripted"),
        *("P(better)", "best after", "minutes"),
    )
    return markdown_table({name: name not in names[:2] for name in names}, map(_cell_row, cells))


def _cell_row(cell: Cell) -> list[str]:
    results, scripted = [run.finished for run in cell.runs], cell.scripted_mean()
    better = "-"
    if scripted is not None:
        # Each run plays every goal.
        improvement = statistics.probability_of_improvement(
            list(cell.by_goal().T), list(cell.scripted_by_goal().T), together=True
        )
        better = interval_text(improvement.as_dict(), 2)
    return [
        *(cell.title, display_name(cell.label), str(len(results)), f"{cell.steps:,}"),
        *(str(statistics.mean([cell.means()])), str(statistics.interquartile_mean([cell.means()]))),
        number_text(cell.best.finished.mean),
        number_text(float(np.mean([result.last_mean for result in results]))),
        "-" if scripted is None else number_text(scripted),
        better,
        f"{np.median([result.best_step for result in results]) / 1000.0:.0f}k",
        f"{np.mean([result.seconds for result in results]) / 60.0:.1f}",
    ]
