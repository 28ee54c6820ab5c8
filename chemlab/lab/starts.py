"""Initial states recorded in laboratory episodes: the vessels that reach each bench, and those for reverse curricula.

``chemlab export starts`` plays the scripted laboratory and writes the vessels that were put on each bench or submitted
to a JSON file, one per scenario; the files of the bundled scenarios are bundled as well.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pydantic

from ..config.datafile import DataError, read_json
from ..config.datamodel import DataModel, validated
from ..config.files import write_text
from ..config.scenario import Scenario
from ..kernels.arrays import BoolArray, Field, FloatArray, IntArray, StreamArray
from ..kernels.jit import inner
from ..kernels.rng import uniform
from ..kernels.tables import Table
from ..physics.chemistry import ChemistryTable
from ..physics.shelf import Shelf

_FILE_BYTES = 20_000_000
_SUFFIX = ".starts.json"

SUBMIT = "submit"
"""Key for submitted vessels, beside the benches."""


class Start(NamedTuple):
    """A vessel and its goal."""

    goal: str
    weight: float
    """Relative probability among the vessels of its goal."""
    capacity_l: float
    contents_mol: dict[str, float]
    last_bench: str | None = None
    """Last bench of the vessel, as observed by the manager."""
    last_position: int = 0
    """Its position at that bench."""
    declared: bool = False
    """True if the scenario declares it; hidden contents replace those of declared vessels only."""


class _Vessel(DataModel):
    """A recorded vessel, independent of its purpose."""

    capacity_l: float = pydantic.Field(gt=0.0, le=100.0)
    contents_mol: dict[str, Annotated[float, pydantic.Field(ge=0.0, le=1e4)]]
    last_bench: str | None = None
    last_position: int = pydantic.Field(default=0, ge=0)

    def start(self, goal: str) -> Start:
        return Start(goal, 1.0, self.capacity_l, dict(self.contents_mol), self.last_bench, self.last_position)


class _Recorded(DataModel):
    """Schema of a file of recorded vessels."""

    scenario: str
    same_as: str | None = pydantic.Field(default=None, pattern=r"^[\w.-]+\.json$")
    """Name of a file beside this one with the same vessels."""
    vessels: tuple[_Vessel, ...] = ()
    """Each distinct vessel once."""
    benches: dict[str, dict[str, tuple[Annotated[int, pydantic.Field(ge=0)], ...]]] = {}
    """Indices into the recorded vessels, by bench and goal."""


def _read(path: Path) -> _Recorded:
    return validated(_Recorded, read_json(path, _FILE_BYTES), str(path))


class StartPool(NamedTuple):
    """Initial states to draw from: T vessels, grouped by goal; G goals."""

    rows: Annotated[FloatArray, Field("T W")]
    """[T, W] vessel rows"""
    first: Annotated[IntArray, Field("G+1")]
    """[G + 1] offset of each goal's vessels"""
    reached: Annotated[FloatArray, Field("T")]
    """[T] cumulative probability within the goal"""
    last_bench: Annotated[IntArray, Field("T")]
    """[T] 0 for none, else 1 + index of the bench"""
    last_position: Annotated[IntArray, Field("T")]
    """[T] position there"""
    declared: Annotated[BoolArray, Field("T")]
    """[T] whether the scenario declares the vessel"""


def start_pool(chemistry: ChemistryTable, scenario: Scenario, vessels: Sequence[Start]) -> Table[StartPool]:
    """Convert vessels to rows to draw from."""
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
            np.array([vessel.last_position for _, vessel in found], dtype=np.int64),
            np.array([vessel.declared for _, vessel in found], dtype=np.bool_),
        )
    )


@inner
def draw_start(pool: StartPool, goal: int, state: StreamArray) -> Any:
    """Draw a vessel of a goal; takes one random number. The goal must have vessels."""
    draw = uniform(state)
    t = pool.first[goal]
    while t < pool.first[goal + 1] - 1 and draw >= pool.reached[t]:
        t += 1
    return t


def starts_file(scenario: Scenario) -> Path:
    """Return the file of a scenario's recorded initial states: in the package, or beside the user's scenario file."""
    shipped = Path(__file__).parent.parent / "data" / "starts" / f"{scenario.name}.json"
    return shipped if scenario.shipped else Path(scenario.origin).with_suffix(_SUFFIX)


def lab_starts(scenario: Scenario, bench: str) -> list[Start]:
    """Return the recorded vessels of one bench, or the submitted ones (:data:`SUBMIT`), in the order of recording.

    Raises:
        DataError: nothing has been recorded for this scenario or bench, or the file does not fit the scenario.
    """
    again = f"run: chemlab export starts {scenario.argument}"
    path = starts_file(scenario)
    if not path.is_file():
        raise DataError(f"starts: no laboratory episodes recorded for {scenario.name}; {again}")
    recorded = _read(path)
    if recorded.same_as is not None:
        path = path.with_name(recorded.same_as)
        recorded = _read(path)
    found = recorded.benches.get(bench)
    if not found:
        raise DataError(f"starts: {path} has no vessels of bench {bench!r}; use starts='paper'")
    vessels: list[Start] = []
    for goal, indices in found.items():
        for i in indices:
            if i >= len(recorded.vessels):
                raise DataError(f"{path}: benches.{bench}.{goal}: no vessel {i} among {len(recorded.vessels)}; {again}")
            start = recorded.vessels[i].start(goal)
            last = () if start.last_bench is None else (start.last_bench,)
            unknown = {*start.contents_mol} - {*scenario.materials} | {goal} - {*scenario.goals}
            unknown |= {*last} - {*scenario.benches}
            if unknown:
                raise DataError(f"{path}: benches.{bench}.{goal}: vessel {i}: unknown {min(unknown)!r}; {again}")
            vessels.append(start)
    return vessels


def goals_met(scenario: Scenario, bench: str) -> list[str]:
    """Return the goals with recorded vessels of a bench, in the scenario's order; all goals if there are none."""
    try:
        met = {start.goal for start in lab_starts(scenario, bench)}
    except DataError:
        return list(scenario.goals)
    return [goal for goal in scenario.goals if goal in met]


def goals_practised(scenario: Scenario, bench: str) -> list[str]:
    """Return the goals that a bench practises: the laboratory's among :func:`goals_met`, or all of those."""
    met = goals_met(scenario, bench)
    return [goal for goal in scenario.lab_goals if goal in met] or met


def write_starts(path: Path, scenario: Scenario, vessels: dict[str, list[Start]]) -> None:
    """Write recorded vessels by bench: each distinct vessel once, and its indices by bench and goal in order."""
    numbers: dict[str, int] = {}
    benches: dict[str, dict[str, list[int]]] = {}
    for bench, found in vessels.items():
        benches[bench] = {}
        for start in found:
            contents = {name: float(f"{mol:.6g}") for name, mol in start.contents_mol.items()}
            vessel = {"capacity_l": start.capacity_l, "contents_mol": contents}
            vessel |= {} if start.last_bench is None else {"last_bench": start.last_bench}
            vessel |= {"last_position": start.last_position} if start.last_position else {}
            number = numbers.setdefault(json.dumps(vessel, separators=(",", ":")), len(numbers))
            benches[bench].setdefault(start.goal, []).append(number)
    lines = [
        f'{{"scenario":{json.dumps(scenario.name)},"vessels":[',
        ",\n".join(numbers),
        f'],"benches":{json.dumps(benches, separators=(",", ":"))}}}',
    ]
    write_text(path, "\n".join(lines) + "\n")
