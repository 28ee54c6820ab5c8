"""Tables of results: CSV files with a header, plain (``.csv``) or compressed (``.csv.gz``).

Runs are stored in four tables:

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

import csv
import gzip
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.agents.evaluate import results
from chemlab.agents.evaluate.results import TrainedRun
from chemlab.agents.runs import Evaluation, checked_config, checked_result
from chemlab.config.files import write_bytes

SCORES = "[what a score means](../glossary.md#what-a-score-means)"
"""Link of the pages of results."""

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
"""Fields of a run's result in ``runs.csv``, with their types."""
_NAMES = ("scenario", "bench", "fingerprint")
_TABLES: dict[str, tuple[str, ...]] = {
    "runs.csv": ("run", *_NAMES, *_SCALARS, "arguments", "versions"),
    "returns.csv": ("run", "goal", "best", "last", "scripted"),
    "evaluations.csv.gz": ("run", "step", "goal", "mean", "scripted"),
    "curves.csv.gz": ("run", "step", "mean", "std"),
}
_CURVE_DECIMALS, _DECIMALS = 5, 9
_Rows = list[dict[str, str]]


def number(value: float | None, decimals: int | None = None) -> str:
    """Return the cell of a number, rounded to ``decimals`` (None: with all digits); None is an empty cell."""
    if value is None:
        return ""
    return repr(float(value) if decimals is None else round(float(value), decimals) + 0.0)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as a file; equal rows give equal bytes."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = text.getvalue().encode()
    write_bytes(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def read_table(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the rows of a file, {column: cell}; an empty list if the file does not exist.

    Raises:
        ValueError: the file is not a table, or has other columns.
    """
    if not path.exists():
        return []
    try:
        content = path.read_bytes()
        reader = csv.DictReader(io.StringIO((gzip.decompress(content) if path.suffix == ".gz" else content).decode()))
        rows = list(reader)
    except (OSError, EOFError, ValueError, csv.Error) as error:
        raise ValueError(f"{path}: not a table of results ({error})") from error
    given = list(reader.fieldnames or ())
    if given != list(columns):
        raise ValueError(f"{path}: has the columns {', '.join(given)[:300]}; needs {', '.join(columns)}")
    return rows


def read_runs(folder: Path) -> list[TrainedRun]:
    """Return the runs in a folder of tables, or all runs below another folder, sorted by path.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
    """
    if not (folder / "runs.csv").exists():
        return list(results.read_runs(folder))
    by_run: dict[str, dict[str, _Rows]] = {}
    for name, columns in _TABLES.items():
        for row in read_table(folder / name, columns):
            by_run.setdefault(row["run"], {}).setdefault(name, []).append(row)
    try:
        return [_from_rows(name, rows) for name, rows in by_run.items()]
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
    config |= {"seed": result.seed, "goals": list(result.by_goal), **json.loads(row["arguments"])}
    config["versions"] = json.loads(row["versions"])
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
