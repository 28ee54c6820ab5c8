"""Write the tables of the committed audits into docs/worlds.md and README.md: ``python docs/audits.py``.

``--make`` first makes the audits of the given scenarios, or of all whose audit is missing or older than the scenario:
``python docs/audits.py --make runaway --budget small --keep parts``. With ``--keep``, the same command resumes an
interrupted audit.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from chemlab.agents.roles import MANAGER_ROLE
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.lab.describe import hidden_words
from chemlab.record import scenario_hash

__all__ = ["FOLDER", "PAGE", "audits", "table"]

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "docs" / "results" / "audits"
PAGE = ROOT / "docs" / "worlds.md"
README = ROOT / "README.md"
LEARNED = ROOT / "studies" / "baselines" / "results" / "from_nothing.json"
_NUMBERS = {
    "open_loop": "open-loop",
    "best": "best",
    "value_of_information": "information",
    "coordination_gain": "coordination",
    "headroom": "headroom",
}
"""Measures and their column heads."""
_CRITERIA = _NUMBERS | {"value_of_bench": "least bench", "open_loop_deviation": "deviation"}
"""Criteria and what the table calls them."""


def audits() -> list[dict[str, Any]]:
    """Return the committed audits by name of scenario; scenarios with hidden parameters come first."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))]
    return sorted(found, key=lambda audit: (not load_scenario(audit["scenario"]).world.draws, audit["scenario"]))


def _cells(audit: dict[str, Any]) -> list[str]:
    # Audits of the first format, of scenarios without a bundled policy, do not state the best.
    numbers = [audit.get(name, audit["reference"])["value"] for name in _NUMBERS]
    missed = [_CRITERIA[name] for name, met in audit["criteria"].items() if met is False]
    return [
        f"`{audit['scenario']}`",
        *("" if number is None else f"{number:.2f}" for number in numbers),
        ", ".join(missed) or "none",
    ]


def table() -> list[str]:
    """Return the committed audits as a Markdown table."""
    heads = {"scenario": False, **dict.fromkeys(_NUMBERS.values(), True), "not met": False}
    return markdown_table(heads, map(_cells, audits()))


def tasks() -> list[str]:
    """Return README's table of scenarios with hidden parameters: what is hidden, and normalized scores.

    The best policy is that of the audit. Of what learned from nothing, a manager or a team, the table has the better in
    validation, on the scale of the audit: where it scores above the oracle's mean, it has 1.
    """
    rows, numbers = [], ("open-loop", "scripted", "from nothing")
    runs = json.loads(LEARNED.read_text(encoding="utf-8"))["runs"]
    for audit in audits():
        scenario = load_scenario(audit["scenario"])
        if not scenario.world.draws:
            continue
        zero, one = (audit[name]["score"] for name in ("random", "oracle"))
        most, value = -math.inf, ""
        teams = (",".join([MANAGER_ROLE, *scenario.benches]), "in stages")
        for roles, words in (("manager", ""), *((team, ", team") for team in teams)):
            own = [run for run in runs if (run["scenario"], run["roles"]) == (scenario.name, roles)]
            reached = statistics.median(run["best"] for run in own) if own else -math.inf
            if reached > most:
                score = statistics.median(run["audited"] for run in own)
                most, value = reached, f"{min((score - zero) / (one - zero), 1.0):.2f}{words}"
        scores = [f"{audit[name]['value']:.2f}" for name in ("open_loop", "reference")]
        best = f"{audit['best']['value']:.2f}, `{audit['best']['way']}`"
        hidden = "; ".join(hidden_words(scenario))
        rows.append([f"`{scenario.name}`", ", ".join(scenario.benches), hidden, *scores, value, best])
    said = ("scenario", "benches", "what is hidden")
    heads = {**dict.fromkeys(said, False), **dict.fromkeys(numbers, True), "best in audit": False}
    return markdown_table(heads, rows)


def stale() -> list[str]:
    """Return bundled scenarios without a current audit."""
    hashes = {audit["scenario"]: audit["scenario_hash"] for audit in audits()}
    return [name for name in scenario_names() if hashes.get(name) != scenario_hash(load_scenario(name))]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--make", nargs="*", metavar="SCENARIO", help="make these audits first; none: all out of date")
    parser.add_argument("--budget", help="small or full; default: full for scenarios with hidden parameters")
    parser.add_argument("--keep", type=Path, help="folder of finished parts, with a folder for each scenario")
    given = parser.parse_args()
    for name in () if given.make is None else given.make or stale():
        print(f"audit of {name}", flush=True)
        budget = given.budget or ("full" if load_scenario(name).world.draws else "small")
        command = ["chemlab", "audit", name, "--budget", budget, "--force"]
        command += ["--out", str(FOLDER / f"{name}.json")]
        if given.keep is not None:
            (given.keep / name).mkdir(parents=True, exist_ok=True)
            command += ["--keep", str(given.keep / name)]
        subprocess.run([sys.executable, "-m", *command], check=True)
        replace_between(PAGE, "audits", table())
    replace_between(PAGE, "audits", table())
    replace_between(README, "tasks", tasks())
