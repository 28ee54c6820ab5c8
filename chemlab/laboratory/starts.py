"""Starting states recorded from laboratory runs: the vessels that a pretrained bench agent will really meet.

``chemlab starts`` plays the scripted laboratory and writes what was put on each bench to a JSON file, one a scenario;
the files of the shipped scenarios come with chemlab.
"""

from __future__ import annotations

import json
from pathlib import Path

from ..files import write_text
from ..materials import DataError
from ..scenario import Scenario, scenario_names

__all__ = ["lab_starts", "starts_file", "write_starts"]

Start = tuple[str, float, float, dict[str, float]]
"""Goal, weight, capacity in L, contents in mol."""


def starts_file(scenario: Scenario) -> Path:
    """Where a scenario's recorded starting states are: with chemlab, or beside the user's scenario file."""
    shipped = Path(__file__).parent.parent / "data" / "starts" / f"{scenario.name}.json"
    return shipped if scenario.name in scenario_names() else Path(scenario.origin).with_suffix(".starts.json")


def lab_starts(scenario: Scenario, bench: str) -> list[Start]:
    """Recorded vessels of one bench.

    Raises:
        DataError: nothing has been recorded for this scenario or bench, or the file names unknown materials.
    """
    path = starts_file(scenario)
    if not path.is_file():
        raise DataError(f"starts: no laboratory runs recorded for {scenario.name}; run: chemlab starts {scenario.name}")
    recorded = json.loads(path.read_text(encoding="utf-8"))["benches"].get(bench, [])
    if not recorded:
        raise DataError(f"starts: {path} has no vessels of bench {bench!r}; use starts='paper'")
    vessels: list[Start] = []
    for entry in recorded:
        unknown = set(entry["contents_mol"]) - set(scenario.materials)
        if unknown or entry["goal"] not in scenario.goals:
            raise DataError(f"{path}: benches.{bench}: unknown {sorted(unknown) or entry['goal']!r}; record it again")
        vessels.append((entry["goal"], 1.0, float(entry["capacity_l"]), dict(entry["contents_mol"])))
    return vessels


def write_starts(path: Path, scenario: Scenario, vessels: dict[str, list[Start]]) -> None:
    """Write recorded vessels by bench."""
    content = {
        "scenario": scenario.name,
        "benches": {
            bench: [
                {
                    "goal": goal,
                    "capacity_l": capacity,
                    "contents_mol": {n: float(f"{x:.6g}") for n, x in contents.items()},
                }
                for goal, _, capacity, contents in found
            ]
            for bench, found in vessels.items()
        },
    }
    write_text(path, json.dumps(content, separators=(",", ":")) + "\n")
