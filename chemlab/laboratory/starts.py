"""Starting states recorded from laboratory runs: the vessels that a pretrained bench agent will really meet, and those
with which a manager's workflow can begin half way.

``chemlab starts`` plays the scripted laboratory and writes what was put on each bench, and what was submitted, to a
JSON file, one a scenario; the files of the shipped scenarios come with chemlab.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..arrays import Field, FloatArray, IntArray, StreamArray
from ..chemistry import ChemistryTable
from ..files import write_text
from ..jit import inner
from ..materials import DataError
from ..rng import uniform
from ..scenario import Scenario, scenario_names
from ..shelf import Shelf
from ..tables import Table

__all__ = ["SUBMIT", "Start", "StartPool", "draw_start", "lab_starts", "start_pool", "starts_file", "write_starts"]

SUBMIT = "submit"
"""Stands among the benches for vessels that were submitted."""


class Start(NamedTuple):
    """A vessel and what is to be done with it."""

    goal: str
    weight: float
    """How often it is drawn, among those of its goal."""
    capacity_l: float
    contents_mol: dict[str, float]
    last_bench: str | None = None
    """Where it was last, as the manager sees it."""
    last_role: int = 0
    """As which of the bench's vessels."""


class StartPool(NamedTuple):
    """Starting states to draw from: T vessels, grouped by the goal they are for; G goals."""

    rows: Annotated[FloatArray, Field("T W")]
    """[T, W] vessel rows"""
    first: Annotated[IntArray, Field("G+1")]
    """[G + 1] where each goal's vessels begin"""
    reached: Annotated[FloatArray, Field("T")]
    """[T] cumulative probability within the goal"""
    last_bench: Annotated[IntArray, Field("T")]
    """[T] 0 for none, else 1 + index of the bench"""
    last_role: Annotated[IntArray, Field("T")]
    """[T] position there"""


def start_pool(chemistry: ChemistryTable, scenario: Scenario, vessels: Sequence[Start]) -> Table[StartPool]:
    """Vessels as rows to draw from."""
    draft, benches = Shelf(chemistry, 1, 1), list(scenario.benches)
    found = [(g, vessel) for g, goal in enumerate(scenario.goals) for vessel in vessels if vessel.goal == goal]
    rows = [draft.fill(0, 0, vessel.capacity_l, vessel.contents_mol).row.copy() for _, vessel in found]
    owner = np.array([g for g, _ in found], dtype=np.int64)
    first = np.searchsorted(owner, np.arange(len(scenario.goals) + 1))
    reached = np.zeros(len(rows))
    for start, stop in itertools.pairwise(first):
        shares = np.array([vessel.weight for _, vessel in found[start:stop]])
        reached[start:stop] = np.cumsum(shares) / shares.sum() if stop > start else 0.0
    return Table(
        StartPool(
            np.array(rows).reshape(len(rows), draft.layout.width),
            first.astype(np.int64),
            reached,
            np.array(
                [0 if v.last_bench is None else 1 + benches.index(v.last_bench) for _, v in found], dtype=np.int64
            ),
            np.array([vessel.last_role for _, vessel in found], dtype=np.int64),
        )
    )


@inner
def draw_start(pool: StartPool, goal: int, state: StreamArray) -> Any:
    """Which of a goal's vessels; takes one random number. The goal must have some."""
    draw = uniform(state)
    t = pool.first[goal]
    while t < pool.first[goal + 1] - 1 and draw >= pool.reached[t]:
        t += 1
    return t


def starts_file(scenario: Scenario) -> Path:
    """Where a scenario's recorded starting states are: with chemlab, or beside the user's scenario file."""
    shipped = Path(__file__).parent.parent / "data" / "starts" / f"{scenario.name}.json"
    return shipped if scenario.name in scenario_names() else Path(scenario.origin).with_suffix(".starts.json")


def lab_starts(scenario: Scenario, bench: str) -> list[Start]:
    """Recorded vessels of one bench, or those that were submitted (:data:`SUBMIT`).

    Raises:
        DataError: nothing has been recorded for this scenario or bench, or the file names unknown materials.
    """
    path = starts_file(scenario)
    if not path.is_file():
        raise DataError(
            f"starts: no laboratory runs recorded for {scenario.name}; run: chemlab starts {scenario.argument}"
        )
    recorded = json.loads(path.read_text(encoding="utf-8"))["benches"].get(bench, [])
    if not recorded:
        raise DataError(f"starts: {path} has no vessels of bench {bench!r}; use starts='paper'")
    vessels: list[Start] = []
    for entry in recorded:
        unknown = set(entry["contents_mol"]) - set(scenario.materials)
        if unknown or entry["goal"] not in scenario.goals:
            raise DataError(f"{path}: benches.{bench}: unknown {sorted(unknown) or entry['goal']!r}; record it again")
        last = entry.get("last_bench"), int(entry.get("last_role", 0))
        vessels.append(Start(entry["goal"], 1.0, float(entry["capacity_l"]), dict(entry["contents_mol"]), *last))
    return vessels


def write_starts(path: Path, scenario: Scenario, vessels: dict[str, list[Start]]) -> None:
    """Write recorded vessels by bench."""
    content = {
        "scenario": scenario.name,
        "benches": {
            bench: [
                {
                    "goal": start.goal,
                    "capacity_l": start.capacity_l,
                    "contents_mol": {n: float(f"{x:.6g}") for n, x in start.contents_mol.items()},
                    **({} if start.last_bench is None else {"last_bench": start.last_bench}),
                    **({"last_role": start.last_role} if start.last_role else {}),
                }
                for start in found
            ]
            for bench, found in vessels.items()
        },
    }
    write_text(path, json.dumps(content, separators=(",", ":")) + "\n")
