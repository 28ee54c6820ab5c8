"""Read training runs for evaluation, and aggregate runs that differ only in their seed.

Runs are read from the folders that training writes, or from the tables that :func:`write_runs` writes:

| File | A row for each | Columns |
|---|---|---|
| `runs.csv` | run | its path, configuration and scalars; `arguments` and `versions` are JSON |
| `returns.csv` | run and goal | mean return of the best and of the last checkpoint, and of the scripted policy |
| `evaluations.csv.gz` | evaluation and goal | the same during training |
| `curves.csv.gz` | rollout | mean and standard deviation of the training episodes that ended in it |

Curves have all points, rounded to 5 decimals: a thousandth of the width of a line in a figure. Evaluations during
training are rounded to 9 decimals. Returns are not rounded, because intervals over a few runs depend on ties.
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
"""Fields of :class:`~chemlab.agents.runs.RunResult` in ``runs.csv``, with their types."""
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
"""Types of numeric columns."""
_CURVE_DECIMALS, _DECIMALS = 5, 9
_Rows = list[dict[str, str]]
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
    """Return the runs in a folder of tables, or all runs below another folder, sorted by path.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
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
        raise ValueError(f"{folder}: not tables of finished runs, or of different runs ({error!r})") from error


def _from_rows(name: str, rows: dict[str, _Rows]) -> TrainedRun:
    """Return a run from its rows of all tables."""
    (row,) = rows["runs.csv"]
    values: dict[str, Any] = {key: kind(row[key]) for key, kind in _SCALARS.items()}
    for column, prefix in (("best", ""), ("last", "last_"), ("scripted", "scripted_")):
        values[f"{prefix}by_goal"], values[f"{prefix}mean"] = _by_goal(rows["returns.csv"], column)
    result = checked_result(values, name)
    config: dict[str, Any] = {key: row[key] for key in (*_NAMES, "label", "algo", "env_id")}
    config |= {"seed": result.seed, "goals": list(result.by_goal), **parse_json(row["arguments"], f"{name}: arguments")}
    config["versions"] = parse_json(row["versions"], f"{name}: versions")
    checked_config(config, name)
    by_step: dict[int, _Rows] = {}
    for evaluation in rows.get("evaluations.csv.gz", ()):
        by_step.setdefault(int(evaluation["step"]), []).append(evaluation)
    evaluations = []
    for step, at_step in by_step.items():
        (by_goal, mean), (scripted, scripted_mean) = _by_goal(at_step, "mean"), _by_goal(at_step, "scripted")
        evaluations.append(Evaluation(step, mean or 0.0, by_goal or {}, scripted_mean, scripted))
    points = [(int(p["step"]), float(p["mean"]), float(p["std"])) for p in rows.get("curves.csv.gz", ())]
    return TrainedRun(name, config, result, np.array(points, dtype=np.float64).reshape(-1, 3), evaluations)


def _by_goal(rows: _Rows, column: str) -> tuple[dict[str, float] | None, float | None]:
    """Return a column's numbers by goal, and their mean; (None, None) if a cell is empty (no scripted policy)."""
    if any(not row[column] for row in rows):
        return None, None
    by_goal = {row["goal"]: float(row[column]) for row in rows}
    return by_goal, float(np.mean(list(by_goal.values())))


def write_runs(folder: Path, runs: Iterable[TrainedRun]) -> None:
    """Write the tables of finished runs, sorted by name, to a folder; other runs are omitted."""
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in _TABLES}
    in_columns = {*_NAMES, *_SCALARS, "goals", "versions"} - {"steps"}
    for run in sorted((run for run in runs if run.result is not None), key=lambda run: run.name):
        config, result, name = run.config, run.finished, {"run": run.name}
        arguments = {key: value for key, value in config.items() if value is not None and key not in in_columns}
        data = {"arguments": arguments, "versions": config.get("versions", {})}
        rows["runs.csv"].append(
            name
            | {key: config.get(key, "") for key in _NAMES}
            | {key: getattr(result, key) for key in _SCALARS}
            | {key: json.dumps(value, separators=(",", ":")) for key, value in data.items()}
        )
        for goal, best in result.by_goal.items():
            scripted_return = (result.scripted_by_goal or {}).get(goal)
            returns = {"best": best, "last": result.last_by_goal[goal], "scripted": scripted_return}
            rows["returns.csv"].append(name | {"goal": goal} | {key: number(value) for key, value in returns.items()})
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


# -- aggregates -------------------------------------------------------------------------------------------------------


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

    def best_ratios(self) -> dict[str, float]:
        """Return :meth:`relative` of the best run, by goal."""
        return dict(zip(self.goals, self.relative()[self.runs.index(self.best)].tolist(), strict=True))

    def mean_ratios(self) -> dict[str, float]:
        """Return the mean over runs of :meth:`relative`, by goal."""
        return dict(zip(self.goals, self.relative().mean(axis=0).tolist(), strict=True))

    def means(self) -> FloatArray:
        """Return [runs] means over goals of each run's best policy."""
        return np.array([run.finished.mean for run in self.runs])

    def scripted_mean(self) -> float | None:
        """Return the mean return of the scripted policy over the evaluations of all runs; None if there is none."""
        known = [mean for run in self.runs if (mean := run.finished.scripted_mean) is not None]
        return float(np.mean(known)) if known else None

    def training_ends(self) -> FloatArray:
        """Return the mean training return in the last tenth of each run's curve, for runs with a curve."""
        curves = [run.curve for run in self.runs if len(run.curve)]
        return np.array([c[c[:, 0] >= 0.9 * c[-1, 0], 1].mean() for c in curves])


Cells = dict[str, dict[str, Cell]]
"""By task and label."""


def settings_of(run: TrainedRun) -> str:
    """Return the settings of a run that are equal for all runs of a cell, as JSON."""
    settings = {k: v for k, v in run.config.items() if k not in _PER_RUN and v is not None}
    return json.dumps(settings, sort_keys=True)


def cells_of(runs: Sequence[TrainedRun], task_of: Callable[[TrainedRun], str] = task_title) -> tuple[Cells, list[str]]:
    """Return the cells of finished runs, and the runs that are in no cell, with the reason.

    If runs of one label have different settings (steps, hyperparameters), the cell has the settings of most runs, or,
    if there are several, those with most steps. A cell has one run for each seed: repetitions are no further samples.
    """
    groups: dict[tuple[str, str], dict[str, list[TrainedRun]]] = {}
    left_out = [f"{run.name}: not finished" for run in runs if run.result is None]
    for run in runs:
        if run.result is not None:
            by_settings = groups.setdefault((task_of(run), run.result.label), {})
            by_settings.setdefault(settings_of(run), []).append(run)
    cells: Cells = {}
    for (task, label), by_settings in groups.items():
        chosen = max(by_settings.values(), key=lambda group: (len(group), group[0].finished.steps))
        by_seed: dict[int, TrainedRun] = {}
        for run in chosen:
            first = by_seed.setdefault(run.finished.seed, run)
            if first is not run:
                left_out.append(f"{run.name}: has the seed of {first.name}, {run.finished.seed}, and equal settings")
        cells.setdefault(task, {})[label] = Cell(task, label, [by_seed[seed] for seed in sorted(by_seed)])
        for run in (run for group in by_settings.values() if group is not chosen for run in group):
            other = [name for name in differences(run.config, chosen[0].config) if name not in _PER_RUN]
            left_out.append(f"{run.name}: {', '.join(other)} differ from most {label} runs there ({chosen[0].name})")
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
