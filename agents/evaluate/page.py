"""Page of training runs: a table of results, and learning curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .csv_tables import write_lines
from .curves import group_tasks, save_curves
from .results import cells_of, cells_table, read_runs
from .trained_managers import has_manager

_NOTE = (
    "Each run's best policy in the evaluation that ended training: mean over runs and interquartile mean with 95 % "
    "t intervals over the seeds of training; a single run has none. Last: mean over runs of the last policy instead. "
    "P(better): probability that a run's return for a goal is above the scripted policy's, ties counting one half, "
    "mean over goals. Best after: steps to a run's best policy, median. Minutes are those of a run."
)


def write_page(folder: Path, out: Path, formats: Sequence[str] = ("png",)) -> tuple[Path | None, list[str]]:
    """Write ``runs.md`` and the pictures ``runs_curves`` of all runs except those of managers.

    Managers have a separate page (:mod:`chemlab.agents.evaluate.trained_managers`).

    Args:
        folder: folder of training runs, or of their tables.
        out: output folder; the page shows the picture of the first format.
        formats: suffixes of the pictures, such as ``png`` and ``svg``.

    Returns:
        Path of the page, or None if there are no such runs; and the runs that are not in the table, with the reason.

    Raises:
        ValueError: the folder does not exist, or a file in it is malformed.
        ImportError: matplotlib is not installed.
    """
    runs = [run for run in read_runs(folder) if not has_manager(run)]
    cells, left_out = cells_of(runs)
    tasks = group_tasks(runs)
    page, pictures = out / "runs.md", [out / f"runs_curves.{ending}" for ending in formats]
    for path in (page, *pictures):
        path.unlink(missing_ok=True)
    if not runs:
        return None, left_out
    lines = ["# Training runs", "", _NOTE, "", *cells_table(c for labels in cells.values() for c in labels.values())]
    if tasks:
        save_curves(tasks, pictures)
        lines += ["", "## Learning curves", "", f"![learning curves]({pictures[0].name})"]
    if left_out:
        lines += ["", "## Left out", "", *(f"- {line}" for line in left_out)]
    write_lines(page, lines)
    return page, left_out
