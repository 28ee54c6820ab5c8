"""A page of training runs: a table of what they came to, and their learning curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from chemlab.config.files import write_text
from chemlab.render.figure import SETTINGS, import_matplotlib, save_figure

from .curves import draw_tasks, group_tasks
from .results import cells_of, cells_table, read_runs
from .trained_managers import has_manager

_NOTE = (
    "Each run's best policy in the evaluation that ended training: mean over runs and interquartile mean with 95 % "
    "t intervals over the seeds of training; a single run has none. Last: mean over runs of the last policy instead. "
    "P(better): probability that a run's return for a goal is above the scripted policy's, ties counting one half, "
    "mean over goals. Best after: steps to a run's best policy, median. Minutes are those of a run."
)


def write_page(folder: Path, out: Path, formats: Sequence[str] = ("png",)) -> tuple[Path | None, list[str]]:
    """Write ``runs.md`` and the pictures ``runs_curves`` of all runs but managers', which have a page of their own
    (:mod:`chemlab.agents.evaluate.trained_managers`).

    Args:
        folder: runs as training leaves them, or tables of them.
        out: where page and pictures go; the page shows the first of the formats.
        formats: endings that matplotlib knows, such as ``png`` and ``svg``.

    Returns:
        The page, or None where there are no such runs; and runs that the table does not have, with the reason.

    Raises:
        ValueError: the folder is not there, or a file in it is not what was written.
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
        for path in pictures:
            with import_matplotlib().rc_context(SETTINGS):
                save_figure(draw_tasks(tasks), path)
        lines += ["", "## Learning curves", "", f"![learning curves]({pictures[0].name})"]
    if left_out:
        lines += ["", "## Left out", "", *(f"- {line}" for line in left_out)]
    write_text(page, "\n".join(lines) + "\n")
    return page, left_out
