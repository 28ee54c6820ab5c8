"""Managers that learn from nothing, with one help left out.

``python studies/baselines/ablations.py RESULTS`` takes the finished runs below RESULTS (``ablations.toml``; runs of
other sweeps are left out) into ``results/ablations.json``; without RESULTS, the table of docs/training.md is written
from that file.
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path
from typing import Any

from chemlab.agents.runs import Run, find_runs
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between, write_json

SCORES = Path(__file__).parent / "results" / "ablations.json"
PAGE = Path(__file__).parent.parent.parent / "docs" / "training.md"
WORDS = {"all": "nothing", "none": "all options above"}


def table(runs: list[dict[str, Any]]) -> list[str]:
    """Return the lines of the table: medians over seeds of the best checkpoints, the range, and how many seeds."""
    scenarios, helps = sorted({run["scenario"] for run in runs}), list(dict.fromkeys(run["help"] for run in runs))
    last = ("none", "without-notes", "without-tied")
    helps.sort(key=lambda name: (name in last and 1 + last.index(name), name != "all"))
    rows = []
    for name in helps:
        cells = []
        for scenario in scenarios:
            found = [run["score"] for run in runs if (run["help"], run["scenario"]) == (name, scenario)]
            spread = f" ({min(found):.3f} to {max(found):.3f}, {len(found)})" if len(found) > 1 else " (1)"
            cells.append(f"{statistics.median(found):.3f}{spread}" if found else "")
        rows.append([words(name), *cells])
    return markdown_table({"left out": False, **{f"`{one}`": True for one in scenarios}}, rows)


def is_own(run: Run) -> bool:
    """Return True if a run is of this sweep, by its folder ``TASK/NAME/seed-N``."""
    return run.path.parent.name in WORDS or run.path.parent.name.startswith("without-")


def words(name: str) -> str:
    """Return what is left out in the runs of a name."""
    return WORDS[name] if name in WORDS else f"`--{name.removeprefix('without-')}`"


def main() -> None:
    """Take the scores of runs, if asked, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="?", type=Path, help="finished runs")
    asked = parser.parse_args()
    scores = json.loads(SCORES.read_text(encoding="utf-8")) if SCORES.exists() else []
    for run in [] if asked.results is None else find_runs(asked.results):
        result, config = run.result(), run.config()
        if result is None or config is None or not is_own(run):
            continue
        key = {"scenario": config["scenario"], "help": run.path.parent.name, "seed": result.seed}
        scores = [old for old in scores if any(old[name] != value for name, value in key.items())]
        scores.append({**key, "steps": result.steps, "score": result.mean, "last": result.last_mean})
    write_json(SCORES, scores)
    replace_between(PAGE, "ablations", table(scores))


if __name__ == "__main__":
    main()
