"""Page of training runs: a table of results, and learning curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from chemlab.config.display import inert
from chemlab.config.files import check_folder, write_text

from .curves import save_curves, with_curves
from .results import cells_of, cells_table, group_runs, read_runs

_NOTE = (
    "Each run's best policy in the evaluation that ended training: mean over runs and interquartile mean with 95 % "
    "t intervals over the seeds of training; a single run has none. Last: mean over runs of the last policy instead. "
    "P(better): probability that a run's return for a goal is above the scripted policy's, ties counting one half, "
    "mean over goals. Best after: steps to a run's best policy, median. Minutes are those of a run."
)


def write_page(folder: Path, out: Path, formats: Sequence[str] = ("png",)) -> tuple[Path, list[str]]:
    """Write ``runs.md`` and the pictures ``runs_curves`` of all runs below a folder.

    Args:
        folder: folder of training runs.
        out: output folder; the page shows the picture of the first format.
        formats: suffixes of the pictures, such as ``png`` and ``svg``.

    Returns:
        Path of the page, and the runs that are not in its table, with the reason.

    Raises:
        ValueError: the folder does not exist or has no runs, or a file in it is malformed.
        ImportError: matplotlib is not installed.
    """
    groups = group_runs(read_runs(folder))
    if not groups:
        raise ValueError(f"{folder}: contains no training runs; give a folder of runs")
    check_folder(out)
    (cells, left_out), drawn = cells_of(groups), with_curves(groups)
    page, pictures = out / "runs.md", [out / f"runs_curves.{ending}" for ending in formats]
    for path in (page, *pictures):
        path.unlink(missing_ok=True)
    lines = ["# Training runs", "", _NOTE, "", *cells_table(c for labels in cells.values() for c in labels.values())]
    if drawn:
        save_curves(drawn, pictures)
        lines += ["", "## Learning curves", "", f"![learning curves]({pictures[0].name})"]
    if left_out:
        lines += ["", "## Left out", "", *(f"- {line}" for line in left_out)]
    # Names of runs are text on the page, and lines that begin with "![" are its pictures.
    write_text(page, "\n".join(line if line.startswith("![") else inert(line) for line in lines) + "\n")
    return page, left_out
