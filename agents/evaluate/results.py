"""Training runs as evaluation sees them, and what runs that differ in their seed alone come to together.

Runs are read from their folders, as training leaves them, or from the tables that :func:`write_runs` makes of those:

| File | A row for each | Columns |
|---|---|---|
| `runs.csv` | run | its path, configuration and scalars; `arguments` and `versions` are JSON |
| `returns.csv` | run and goal | mean return of the best and of the last checkpoint, and of the scripted policy |
| `evaluations.csv.gz` | evaluation and goal | the same during training |
| `curves.csv.gz` | rollout | mean and standard deviation of the training episodes that ended in it |

Curves have every point, rounded to 5 decimals: a thousandth of what a line of a figure is wide. Evaluations during
training are rounded to 9; returns are not rounded, since intervals over a few runs depend on which of their means tie.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.datafile import DataError, parse_json
from chemlab.kernels.arrays import FloatArray

from ..runs import Evaluation, Run, RunResult, checked_config, checked_result, differences, find_runs
from . import statistics
from .csv_tables import markdown_table, number, read_table, write_table
from .statistics import interval_text, number_text

_SCALARS: dict[str, type] = {
    "label": str,
    "algo": str,
    "env_id": str,
    "seed": int,
    "steps": int,
    "seconds": float,
    "frames_per_second": float,
    "best_step": int,
    "episodes_per_goal": int,
}
"""Of :class:`~chemlab.agents.runs.RunResult`."""
_NAMES = ("scenario", "bench", "fingerprint")
_TABLES: dict[str, tuple[str, ...]] = {
    "runs.csv": ("run", *_NAMES, *_SCALARS, "arguments", "versions"),
    "returns.csv": ("run", "goal", "best", "last", "scripted"),
    "evaluations.csv.gz": ("run", "step", "goal", "mean", "scripted"),
    "curves.csv.gz": ("run", "step", "mean", "std"),
}
_NUMBERS: dict[str, type] = (
    {key: kind for key, kind in _SCALARS.items() if kind is not str}
    | {"step": int}
    | dict.fromkeys(("best", "last", "scripted", "mean", "std"), float)
)
"""Columns of numbers."""
_CURVE_DECIMALS, _DECIMALS = 5, 9
_Rows = list[dict[str, str]]
_ABBREVIATIONS = ("ppo", "a2c", "dqn", "sac", "td3", "xl")
_PER_RUN = ("seed", "versions", "label")
"""Settings that may differ between the runs of a cell."""


@dataclass(frozen=True)
class TrainedRun:
    """A training run, finished or not.

    Attributes:
        name: its path below the folder that was read.
        config: its ``config.json``.
        result: None while it is not finished.
        curve: [P, 3] step, mean and standard deviation of the returns of the episodes that ended in each rollout.
        evaluations: those during training.
        folder: where its checkpoints may be; None where it comes from a table.
    """

    name: str
    config: dict[str, Any]
    result: RunResult | None
    curve: FloatArray
    evaluations: list[Evaluation]
    folder: Run | None = None

    @property
    def finished(self) -> RunResult:
        """The result of a run that has one."""
        assert self.result is not None, f"{self.name} is not finished"
        return self.result


def display_name(label: str) -> str:
    """Return the name of an algorithm or variant in figures: ``ppo-xl`` is PPO-XL, ``ppo-entropy`` PPO-entropy."""
    return "-".join(part.upper() if part in _ABBREVIATIONS else part for part in label.split("-"))


def task_title(run: TrainedRun) -> str:
    """Return a run's task: scenario, bench or agent, goals if not all, starts if not the default."""
    goals = run.config.get("goals") or []
    parts = [f"{run.config.get('scenario')}, {run.config.get('bench')}"]
    parts += [f"goal {goals[0]}"] if len(goals) == 1 else [f"{len(goals)} goals"] if goals else []
    parts += [f"starts {run.config['starts']}"] if run.config.get("starts", "paper") != "paper" else []
    parts += [f"benches {run.config['background']}"] if run.config.get("background") else []
    return ", ".join(parts)


# -- reading and writing ----------------------------------------------------------------------------------------------


def read_runs(folder: Path) -> list[TrainedRun]:
    """Every run of a folder of tables, or every run below another folder, in order of its path.

    Raises:
        ValueError: the folder is not there, or a file in it is not what was written.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder of results")
    if (folder / "runs.csv").exists():
        return _from_tables(folder)
    return [_from_folder(run, run.path.relative_to(folder).as_posix()) for run in find_runs(folder)]


def _from_folder(run: Run, name: str) -> TrainedRun:
    points = [
        (p.step, p.return_mean, p.return_std)
        for p in run.curve()
        if p.return_mean is not None and p.return_std is not None
    ]
    curve = np.array(points, dtype=np.float64).reshape(-1, 3)
    return TrainedRun(name, run.config() or {}, run.result(), curve, run.evaluations(), run)


def _from_tables(folder: Path) -> list[TrainedRun]:
    by_run: dict[str, dict[str, _Rows]] = {}
    for name, columns in _TABLES.items():
        for row in read_table(folder / name, columns, _NUMBERS, blank=("scripted",)):
            by_run.setdefault(row["run"], {}).setdefault(name, []).append(row)
    try:
        return [_from_rows(name, rows) for name, rows in by_run.items()]
    except DataError as error:
        raise ValueError(f"{folder}: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{folder}: not the tables of finished runs that belong together ({error!r})") from error


def _from_rows(name: str, rows: dict[str, _Rows]) -> TrainedRun:
    (row,) = rows["runs.csv"]
    best, best_mean = _by_goal(rows["returns.csv"], "best")
    last, last_mean = _by_goal(rows["returns.csv"], "last")
    scripted, scripted_mean = _by_goal(rows["returns.csv"], "scripted")
    returns: dict[str, Any] = {"by_goal": best, "mean": best_mean, "last_by_goal": last, "last_mean": last_mean}
    returns |= {"scripted_by_goal": scripted, "scripted_mean": scripted_mean}
    scalars = {key: kind(row[key]) for key, kind in _SCALARS.items()}
    result = checked_result({**scalars, **returns}, name)
    config: dict[str, Any] = {key: row[key] for key in (*_NAMES, "label", "algo", "env_id")}
    config |= {"seed": result.seed, "goals": list(result.by_goal), **parse_json(row["arguments"], f"{name}: arguments")}
    config["versions"] = parse_json(row["versions"], f"{name}: versions")
    checked_config(config, name)
    steps: dict[int, _Rows] = {}
    for one in rows.get("evaluations.csv.gz", ()):
        steps.setdefault(int(one["step"]), []).append(one)
    evaluations = []
    for step, some in steps.items():
        (ours, mean), (theirs, beside) = _by_goal(some, "mean"), _by_goal(some, "scripted")
        evaluations.append(Evaluation(step, mean or 0.0, ours or {}, beside, theirs))
    points = [(int(p["step"]), float(p["mean"]), float(p["std"])) for p in rows.get("curves.csv.gz", ())]
    return TrainedRun(name, config, result, np.array(points, dtype=np.float64).reshape(-1, 3), evaluations)


def _by_goal(rows: _Rows, column: str) -> tuple[dict[str, float] | None, float | None]:
    """A column's numbers by goal and their mean; None where a cell is empty (there is no scripted policy)."""
    if any(not row[column] for row in rows):
        return None, None
    by_goal = {row["goal"]: float(row[column]) for row in rows}
    return by_goal, float(np.mean(list(by_goal.values())))


def write_runs(folder: Path, runs: Iterable[TrainedRun]) -> None:
    """Make a folder's tables of finished runs (others are left out), in order of their names."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in _TABLES}
    elsewhere = {*_NAMES, *_SCALARS, "goals", "versions"} - {"steps"}
    for run in sorted((run for run in runs if run.result is not None), key=lambda run: run.name):
        config, result, name = run.config, run.finished, {"run": run.name}
        given = {key: value for key, value in config.items() if value is not None and key not in elsewhere}
        data = {"arguments": given, "versions": config.get("versions", {})}
        rows["runs.csv"].append(
            name
            | {key: config.get(key, "") for key in _NAMES}
            | {key: getattr(result, key) for key in _SCALARS}
            | {key: json.dumps(value, separators=(",", ":")) for key, value in data.items()}
        )
        for goal, best in result.by_goal.items():
            beside = {"last": result.last_by_goal[goal], "scripted": (result.scripted_by_goal or {}).get(goal)}
            cells = {key: number(value) for key, value in {"best": best, **beside}.items()}
            rows["returns.csv"].append(name | {"goal": goal} | cells)
        for e in run.evaluations:
            scripted = e.scripted_by_goal or {}
            for goal, mean in e.by_goal.items():
                cells = {"mean": number(mean, _DECIMALS), "scripted": number(scripted.get(goal), _DECIMALS)}
                rows["evaluations.csv.gz"].append(name | {"step": e.step, "goal": goal} | cells)
        for step, mean, deviation in run.curve:
            cells = {"mean": number(mean, _CURVE_DECIMALS), "std": number(deviation, _CURVE_DECIMALS)}
            rows["curves.csv.gz"].append(name | {"step": int(step)} | cells)
    for file, columns in _TABLES.items():
        write_table(folder / file, columns, rows[file])


# -- runs together ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """The finished runs of one task and label, which differ in their seed alone."""

    title: str
    label: str
    runs: list[TrainedRun]

    @property
    def best(self) -> TrainedRun:
        """The run whose best policy has the highest mean return."""
        return max(self.runs, key=lambda run: run.finished.mean)

    @property
    def steps(self) -> int:
        """Steps of a run."""
        return self.runs[0].finished.steps

    @property
    def goals(self) -> list[str]:
        """Goals of the task."""
        return list(self.best.finished.by_goal)

    def relative(self) -> FloatArray:
        """[runs, G] return of each run's best policy over the scripted one's; NaN where that is not above 0."""
        ours, theirs = self.by_goal(), self.scripted_by_goal()
        ratios: FloatArray = np.divide(ours, theirs, out=np.full(ours.shape, np.nan), where=theirs > 0.0)
        return ratios

    def by_goal(self) -> FloatArray:
        """[runs, G] return of each run's best policy."""
        return np.array([[run.finished.by_goal[goal] for goal in self.goals] for run in self.runs])

    def scripted_by_goal(self) -> FloatArray:
        """[runs, G] return of the scripted policy, on each run's seeds; NaN where there is none."""
        return np.array(
            [[(run.finished.scripted_by_goal or {}).get(goal, np.nan) for goal in self.goals] for run in self.runs]
        )

    def best_ratios(self) -> dict[str, float]:
        """:meth:`relative` of the best run, by goal."""
        return dict(zip(self.goals, self.relative()[self.runs.index(self.best)].tolist(), strict=True))

    def mean_ratios(self) -> dict[str, float]:
        """Mean over runs of :meth:`relative`, by goal."""
        return dict(zip(self.goals, self.relative().mean(axis=0).tolist(), strict=True))

    def means(self) -> FloatArray:
        """[runs] mean return over goals of each run's best policy."""
        return np.array([run.finished.mean for run in self.runs])

    def scripted_mean(self) -> float | None:
        """Mean return of the scripted policy, over the runs' evaluations of it."""
        known = [mean for run in self.runs if (mean := run.finished.scripted_mean) is not None]
        return float(np.mean(known)) if known else None

    def training_ends(self) -> FloatArray:
        """[runs] mean training return in the last tenth of each curve, where it has one."""
        curves = [run.curve for run in self.runs if len(run.curve)]
        return np.array([c[c[:, 0] >= 0.9 * c[-1, 0], 1].mean() for c in curves])


Cells = dict[str, dict[str, Cell]]
"""By task and label."""


def cells_of(runs: Sequence[TrainedRun], task_of: Callable[[TrainedRun], str] = task_title) -> tuple[Cells, list[str]]:
    """Finished runs together, and which runs are in no cell and why.

    A label may have been trained in more than one way (numbers of steps, hyperparameters); a cell takes the way that
    has most runs, and of several the one with most steps.
    """
    ways: dict[tuple[str, str], dict[str, list[TrainedRun]]] = {}
    left_out = [f"{run.name}: not finished" for run in runs if run.result is None]
    for run in runs:
        if run.result is not None:
            own = {k: v for k, v in run.config.items() if k not in _PER_RUN and v is not None}
            way = json.dumps(own, sort_keys=True)
            ways.setdefault((task_of(run), run.result.label), {}).setdefault(way, []).append(run)
    cells: Cells = {}
    for (task, label), groups in ways.items():
        chosen = max(groups.values(), key=lambda some: (len(some), some[0].finished.steps))
        cells.setdefault(task, {})[label] = Cell(task, label, sorted(chosen, key=lambda run: run.finished.seed))
        others = (run for some in groups.values() if some is not chosen for run in some)
        for run in others:
            other = [name for name in differences(run.config, chosen[0].config) if name not in _PER_RUN]
            left_out.append(f"{run.name}: {', '.join(other)} differ from most {label} runs there ({chosen[0].name})")
    return cells, left_out


def cells_table(cells: Iterable[Cell]) -> list[str]:
    """The lines of a Markdown table: returns over runs with confidence intervals over the seeds of training, and the
    comparison with the scripted policy. A single run has no intervals."""
    names = (
        *("experiment", "algorithm", "runs", "steps", "mean", "interquartile mean", "best run", "last", "scripted"),
        *("P(better)", "best after", "minutes"),
    )
    return markdown_table({name: name not in names[:2] for name in names}, map(_cell_row, cells))


def _cell_row(cell: Cell) -> list[str]:
    results, reference = [run.finished for run in cell.runs], cell.scripted_mean()
    better = "-"
    if reference is not None:
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
        "-" if reference is None else number_text(reference),
        better,
        f"{np.median([result.best_step for result in results]) / 1000.0:.0f}k",
        f"{np.mean([result.seconds for result in results]) / 60.0:.1f}",
    ]
