"""The paper's results beside ours, as a page and as data: its statements, every experiment and algorithm, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.files import write_text

from ..runs import versions
from . import statistics
from .figures import FIGURES
from .results import EXPERIMENTS, Results, display_name
from .statements import Statement, compare_with_paper
from .statistics import interval_text, number_text

__all__ = ["describe_cells", "paper_table", "write_summary"]


def describe_cells(results: Results) -> list[dict[str, Any]]:
    """Every experiment and algorithm: returns over runs with confidence intervals, and the comparison with the scripted
    policy. A single run has no intervals (None); the paper's algorithms without runs are there with 0 runs."""
    rows: list[dict[str, Any]] = []
    for key, experiment in EXPERIMENTS.items():
        for label in (*results.cells[key], *results.missing(key)):
            cell = results.cell(key, label)
            row: dict[str, Any] = {"experiment": key, "title": experiment.title, "label": label}
            rows.append(row)
            if cell is None:
                row["runs"] = 0
                continue
            goals, runs = cell.goals, len(cell.runs)
            best, mean = cell.best_ratios(), cell.mean_ratios()
            strata = [[run.result.by_goal[goal] for run in cell.runs] for goal in goals]
            reference = cell.heuristic_mean()
            row |= {
                "runs": runs,
                "seeds": [run.result.seed for run in cell.runs],
                "steps": cell.steps,
                "mean": statistics.mean([cell.means()]).as_dict(),
                "interquartile_mean": statistics.interquartile_mean([cell.means()]).as_dict(),
                "best": cell.best.result.mean,
                "best_step": float(np.median([run.result.best_step for run in cell.runs])),
                "last_mean": float(np.mean([run.result.last_mean for run in cell.runs])),
                "heuristic": reference,
                "relative_by_goal": {goal: {"best": best[goal], "mean": mean[goal]} for goal in goals},
                "seconds": float(np.mean([run.result.seconds for run in cell.runs])),
                "frames_per_second": float(np.mean([run.result.frames_per_second for run in cell.runs])),
            }
            if reference is not None:
                known = [[(run.result.heuristic_by_goal or {})[goal] for run in cell.runs] for goal in goals]
                row["improvement"] = statistics.probability_of_improvement(strata, known).as_dict()
    return rows


def paper_table(results: Results) -> list[str]:
    """The lines of a Markdown table: the paper's experiments, by algorithm the mean over runs of each one's best policy
    with its interval, the scripted policy first."""
    rows = [row for row in describe_cells(results) if row["runs"]]
    columns = {key: {row["label"]: row for row in rows if row["experiment"] == key} for key in EXPERIMENTS}
    lines = [f"| | {' | '.join(spec.title for spec in EXPERIMENTS.values())} |", f"|---|{'--:|' * len(EXPERIMENTS)}"]
    scripted = [
        next((number_text(row["heuristic"]) for row in own.values() if row["heuristic"] is not None), "")
        for own in columns.values()
    ]
    lines.append(f"| scripted | {' | '.join(scripted)} |")
    for label in dict.fromkeys(row["label"] for row in rows):
        cells = [interval_text(own[label]["mean"]) if label in own else "" for own in columns.values()]
        lines.append(f"| {display_name(label)} | {' | '.join(cells)} |")
    return lines


def write_summary(
    results: Results, folder: Path, lacking: Mapping[str, Sequence[str]], formats: Sequence[str] = ("png",)
) -> tuple[Path, Path]:
    """Write ``summary.md`` and ``summary.json``; their paths.

    Args:
        results: what was read.
        folder: where they go.
        lacking: what each figure lacks, as :func:`~chemlab.agents.evaluation.figures.write_figures` returns it.
        formats: those it was given; the page shows the first.
    """
    statements, cells = compare_with_paper(results), describe_cells(results)
    data = {
        "kind": "summary",
        "format": 1,
        "versions": versions(),
        "statements": [vars(statement) for statement in statements],
        "cells": cells,
        "figures": {spec.stem: {"caption": spec.caption, "lacks": list(lacking[spec.stem])} for spec in FIGURES},
        "left_out": results.left_out,
    }
    plain, page = folder / "summary.json", folder / "summary.md"
    # A ratio to a scripted policy that earns nothing is no number; JSON has no NaN.
    write_text(plain, json.dumps(_without_nan(data), indent=1) + "\n")
    write_text(page, "\n".join(_markdown(folder, statements, cells, lacking, formats[0], results.left_out)) + "\n")
    return page, plain


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _verdict(statement: Statement) -> str:
    said = {True: "yes", False: "**no**", None: "-"}[statement.holds]
    return f"{said} ({', '.join(statement.variants)}: yes)" if statement.variants else said


def _markdown(
    folder: Path,
    statements: Sequence[Statement],
    cells: Sequence[dict[str, Any]],
    lacking: Mapping[str, Sequence[str]],
    ending: str,
    left_out: Sequence[str],
) -> list[str]:
    lines = [
        "# The paper's results and ours",
        "",
        "## What the paper says",
        "",
        "The paper's values are those its text and captions state; none is read off a picture. What an "
        "algorithm is in the paper decides (PPO, not a variant with other settings); variants that agree where it does "
        "not are named. -: no runs, or runs that cannot tell.",
        "",
        "| figure | experiment | statement | paper | where | ours | agrees | criterion |",
        "|--:|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {s.figure} | {s.experiment} | {s.says} | {s.paper} | {s.source} | {s.ours} | {_verdict(s)} "
        f"| {s.criterion} |"
        for s in statements
    ]
    lines += [
        "",
        "## Every experiment and algorithm",
        "",
        "Each run's best policy; mean over runs and interquartile mean with 95 % bootstrap intervals over the seeds of "
        "training. As in Stable-Baselines3, environment i of a run has the run's seed + i: neighbouring seeds differ "
        "in networks and exploration, and share most of their environments' random numbers. P(better): "
        "probability that a run's return for a goal is above the scripted policy's, ties counting one half, mean over "
        "goals. Best after: steps to a run's best policy, median. Minutes are those of a run, on one core that others "
        "may have shared: "
        f"{sum(row['runs'] * row.get('seconds', 0.0) for row in cells) / 3600.0:.1f} hours in all.",
        "",
        "| experiment | algorithm | runs | steps | mean | interquartile mean | best run | heuristic | P(better) "
        "| best after | minutes |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in cells:
        start = f"| {row['title']} | {display_name(row['label'])} | {row['runs']} "
        if not row["runs"]:
            lines.append(start + "| - | - | - | - | - | - | - | - |")
            continue
        better = interval_text(row["improvement"], 2) if "improvement" in row else "-"
        reference = "-" if row["heuristic"] is None else number_text(row["heuristic"])
        lines.append(
            f"{start}| {row['steps']:,} | {interval_text(row['mean'])} | {interval_text(row['interquartile_mean'])} "
            f"| {row['best']:.3f} | {reference} | {better} "
            f"| {row['best_step'] / 1000.0:.0f}k | {row['seconds'] / 60.0:.1f} |"
        )
    lines += ["", "## Figures", ""]
    for spec in FIGURES:
        picture = f"{spec.stem}.{ending}"
        lines.append(f"**The paper's figure {spec.number}.** {spec.caption}")
        lines += [f"Missing: {what}." for what in lacking[spec.stem]]
        lines += ["", f"![{spec.stem}]({picture})" if (folder / picture).exists() else "(no picture)", ""]
    if left_out:
        lines += ["## What is in no figure", "", *(f"- {line}" for line in left_out)]
    return lines
