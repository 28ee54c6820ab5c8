"""Make every published figure, table and page of results from stored tables: ``python -m studies.paper``.

| Tables | Output |
|---|---|
| `studies/paper/chemgymrl/results/` | `docs/results/summary.md`, figures, first table of `docs/results.md` |
| `studies/baselines/results/` | `docs/results/laboratory.md` with curves, the other tables of `docs/results.md` |

``--collect RUNS`` first makes these tables from training runs of ``chemlab sweep`` and plays their best checkpoints;
rows of other runs are kept. Needs the extra ``plot``, and ``train`` for collecting.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from chemlab.config.files import check_marks, replace_between

from .chemgymrl.figures import write_figures
from .chemgymrl.page import paper_table, write_page
from .chemgymrl.results import TABLES, experiment_of, read_results, results_of
from .chemgymrl.traces import collect_traces
from .managers import brief_table, collect, write_laboratory
from .shipped import benches_table, collect_benches
from .tables import read_runs, write_runs

ROOT = Path(__file__).parents[2]
LABORATORY = ROOT / "studies" / "baselines" / "results"
PAGES = {ROOT / "docs" / "results.md": ("paper", "managers", "benches", "measuring")}
"""Files with marks, between which the tables are written."""


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m studies.paper", description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--collect", type=Path, metavar="RUNS", help="first make the tables from these training runs")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results", help="folder of figures and pages")
    arguments = parser.parse_args()
    try:
        for page, marks in PAGES.items():
            for mark in marks:
                check_marks(page, mark)
        if arguments.collect is not None:
            collect_all(arguments.collect, lambda name: print(f"played {name}", file=sys.stderr))
        for line in make(arguments.out, PAGES):
            print(line)
    except (ImportError, ValueError) as error:
        raise SystemExit(f"error: {error}") from error


def collect_all(runs: Path, watch: Callable[[str], None]) -> None:
    """Make the tables from a folder of training runs.

    Raises:
        ValueError: the folder does not exist, or a run in it cannot be played.
        ImportError: Stable-Baselines3 is not installed.
    """
    ours = [run for run in read_runs(runs) if run.result is not None and experiment_of(run) is not None]
    if ours:
        known = read_runs(TABLES) if TABLES.is_dir() else []
        merged = {run.name: run for run in (*known, *ours)}
        collect_traces(results_of(merged.values()), TABLES, watch=watch)
        write_runs(TABLES, merged.values())
    for line in collect(runs, LABORATORY, watch=watch, keep=lambda run: experiment_of(run) is None):
        print(f"not played: {line}", file=sys.stderr)
    collect_benches(LABORATORY, watch=watch)


def make(out: Path, pages: Mapping[Path, Sequence[str]]) -> list[str]:
    """Make all outputs from the tables; return one line for each missing result and each written page.

    Raises:
        ValueError: a table is missing or malformed, has runs of a bench that has changed since, or a page lacks its
            marks.
        ImportError: matplotlib is not installed.
    """
    results = read_results(TABLES)
    if results.left_out:
        count, first = len(results.left_out), results.left_out[0]
        raise ValueError(
            f"{TABLES}: {count} runs and traces cannot be published, the first: {first}. Nothing was made: train them "
            "again (chemlab sweep) and --collect them, or take their rows from the tables"
        )
    lacking = write_figures(results, out)
    page, (laboratory, left_out) = write_page(results, out, lacking), write_laboratory(LABORATORY, out)
    tables = {
        "paper": paper_table(results),
        "managers": brief_table(LABORATORY, shipped=True),
        "measuring": brief_table(LABORATORY, shipped=False),
        "benches": benches_table(LABORATORY),
    }
    for file, marks in pages.items():
        for mark in marks:
            replace_between(file, mark, tables[mark])
    missing = [f"{stem}: missing: {'; '.join(what)}" for stem, what in lacking.items() if what]
    written = [page, *([laboratory] if laboratory else []), *pages]
    return [*missing, *(f"left out {line}" for line in left_out), *(f"wrote {path}" for path in written)]


if __name__ == "__main__":
    main()
