"""Benches whose actions are a table of operations on vessels: extraction, distillation, and any of your own.

One table, from the scenario, decodes, masks, documents and carries out every action.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ..materials import DataError
from ..physics.jit import helper, kernel
from ..physics.layers import SOLIDS, camera, layer_volumes, profile
from ..physics.partition import partition, turn_clock
from ..physics.phases import settle_phases
from ..physics.thermal import heat, vapor_pressure
from ..physics.transfer import TRACE_MOL, add, drain, pour, volume
from ..scenario import Scenario
from ..shelf import (
    AMOUNTS,
    CLOCK,
    CLOCK_WAS,
    TEMPERATURE,
    Chemistry,
    FloatArray,
    IntArray,
    Layout,
    Shelf,
    StreamArray,
)
from .base import CAMERA_PIXELS, Bench, BoolArray, Channel, MaskArray, ObservationArray, Station, check_discrete
from .models import SeparationModel

__all__ = ["OperationBench", "OperationOptions", "Process", "separate"]

DRAIN, MIX, POUR, ADD, SETTLE, HEAT, END = range(7)
_KINDS = {"drain": DRAIN, "mix": MIX, "pour": POUR, "add": ADD, "settle": SETTLE, "heat": HEAT}
_UNITS = {"drain": "% of the height", "mix": "clock", "pour": "fraction", "add": "L", "settle": "clock", "heat": "kJ"}
_COLUMNS = 5  # kind, vessel, target, material, magnitude


class Process(BaseModel):
    """One row of an action table: a process and its magnitudes, each of which is one action."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kind: Literal["drain", "mix", "pour", "add", "settle", "heat"]
    vessel: str
    """Position the process works on (``settle`` works on all of the bench's vessels)."""
    target: str | None = None
    """Position that receives (drain, pour, heat: the condenser's)."""
    material: str | None = None
    """What ``add`` adds, from stock."""
    magnitudes: tuple[float, ...] = Field(min_length=1)
    """drain: percent of the vessel's height; mix, settle: settling clock; pour: fraction; add: L; heat: kJ (< 0
    cools)."""


class OperationOptions(BaseModel):
    """Scenario keys of a bench with a table of operations."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    process: tuple[Process, ...] = Field(min_length=1)
    auxiliary_capacity_l: float = Field(default=1.0, gt=0.0, le=100.0)
    """Capacity of the clean vessels the bench provides."""
    settle_per_step: float = Field(default=0.0, ge=0.0)
    """How far every vessel settles in each step by itself."""
    hottest_k: float = Field(default=800.0, gt=0.0)
    coolest_k: float = Field(default=273.15, gt=0.0)

    @model_validator(mode="after")
    def _ordered(self) -> OperationOptions:
        if self.hottest_k <= self.coolest_k:
            raise ValueError(f"hottest_k = {self.hottest_k} must be above coolest_k = {self.coolest_k}")
        return self


@helper
def _legal(
    table: FloatArray, action: int, m: int, places: IntArray, rows: FloatArray, stock: FloatArray, chem: Chemistry
) -> bool:
    kind = int(table[action, 0])
    if kind == ADD:
        return bool(stock[m, int(table[action, 3])] > TRACE_MOL)
    if kind in (SETTLE, HEAT, END):
        return True
    return volume(rows[places[m, int(table[action, 1])]], chem) > 0.0


@kernel
def _operate(
    table: FloatArray,
    action: int,
    m: int,
    knobs: FloatArray,
    places: IntArray,
    rows: FloatArray,
    stock: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    layers: IntArray,
    profiles: FloatArray,
    changed: BoolArray,
    chem: Chemistry,
    share: FloatArray,
) -> None:
    """Carry out one operation on amounts, temperatures and clocks. knobs: hottest, coolest, settling per step."""
    kind, magnitude = int(table[action, 0]), table[action, 4]
    p, t = int(table[action, 1]), int(table[action, 2])
    row, target = rows[places[m, p]], rows[places[m, t]]
    if kind == DRAIN:
        pixels = magnitude / 100.0 * profiles.shape[3]
        drain(row, target, pixels, profiles[m, p], layers[m, p], chem, waste[m], events[m], share)
    elif kind == MIX:
        turn_clock(row, -magnitude)
    elif kind == POUR:
        pour(row, target, magnitude, chem, waste[m], events[m])
    elif kind == ADD:
        material = int(table[action, 3])
        mol = min(magnitude / chem.molar_volume[material], stock[m, material])
        stock[m, material] -= mol
        add(row, material, mol, chem.ambient_temperature, chem, waste[m], events[m])
    elif kind == HEAT:
        heat(row, target, 1000.0 * magnitude, knobs[0], knobs[1], chem, waste[m], events[m])
    for q in range(places.shape[1]):
        changed[m, q] = kind != SETTLE and q in (p, t)
    elapsed = knobs[2] + (magnitude if kind == SETTLE else 0.0)
    if elapsed > 0.0:
        for q in range(places.shape[1]):
            before = rows[places[m, q], CLOCK]
            turn_clock(rows[places[m, q]], elapsed)
            changed[m, q] = changed[m, q] or rows[places[m, q], CLOCK] != before


@kernel
def _operations(
    members: IntArray,
    actions: IntArray,
    table: FloatArray,
    knobs: FloatArray,
    places: IntArray,
    rows: FloatArray,
    stock: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    layers: IntArray,
    profiles: FloatArray,
    changed: BoolArray,
    steps: IntArray,
    ended: BoolArray,
    illegal: BoolArray,
    limit: int,
    chem: Chemistry,
    work: FloatArray,
) -> None:
    share = work[0]
    for b in range(members.shape[0]):
        m = members[b]
        events[m, :] = 0.0
        illegal[m] = not _legal(table, actions[b], m, places, rows, stock, chem)
        ended[m] = int(table[actions[b], 0]) == END
        if not illegal[m] and not ended[m]:
            _operate(
                table, actions[b], m, knobs, places, rows, stock, waste, events, layers, profiles, changed, chem, share
            )
            for p in range(places.shape[1]):
                if changed[m, p]:
                    settle_phases(rows[places[m, p]], chem, waste[m], events[m], share)
        steps[m] += 1
        ended[m] = ended[m] or steps[m] >= limit


@kernel
def separate(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    layers: IntArray,
    profiles: FloatArray,
    changed: BoolArray,
    chem: Chemistry,
    work: FloatArray,
) -> None:
    """Bring dissolved amounts and layer profiles of the vessels that have changed up to date."""
    for b in range(members.shape[0]):
        m = members[b]
        for p in range(places.shape[1]):
            if changed[m, p]:
                row = rows[places[m, p]]
                partition(row, chem, work)
                profile(row, chem, layers[m, p], profiles[m, p], work)
                changed[m, p] = False


@kernel
def _look(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    layers: IntArray,
    profiles: FloatArray,
    stream: StreamArray,
    image: FloatArray,
    chem: Chemistry,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        for p in range(places.shape[1]):
            camera(rows[places[m, p]], profiles[m, p], layers[m, p], chem, stream[m], image[m, p])


@kernel
def _step(
    members: IntArray,
    actions: IntArray,
    table: FloatArray,
    knobs: FloatArray,
    places: IntArray,
    rows: FloatArray,
    stock: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    layers: IntArray,
    profiles: FloatArray,
    changed: BoolArray,
    steps: IntArray,
    ended: BoolArray,
    illegal: BoolArray,
    stream: StreamArray,
    image: FloatArray,
    limit: int,
    chem: Chemistry,
    work: FloatArray,
) -> None:
    """Operate, separate and look in one call: handing a Chemistry over from Python takes as long as the physics."""
    _operations(
        members,
        actions,
        table,
        knobs,
        places,
        rows,
        stock,
        waste,
        events,
        layers,
        profiles,
        changed,
        steps,
        ended,
        illegal,
        limit,
        chem,
        work,
    )
    separate(members, places, rows, layers, profiles, changed, chem, work)
    _look(members, places, rows, layers, profiles, stream, image, chem)


@kernel
def _observe(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    busy: BoolArray,
    goal: IntArray,
    image: FloatArray,
    gauges: FloatArray,
    chem: Chemistry,
    out: ObservationArray,
) -> None:
    """gauges: [3, 2] low and high of T (K), V (L), P (kPa); empty where the bench shows none."""
    positions, pixels = image.shape[1], image.shape[2]
    for b in range(members.shape[0]):
        m = members[b]
        out[b, :] = 0.0
        if not busy[m]:
            continue
        at = 0
        for p in range(positions):
            for x in range(pixels):
                out[b, at] = image[m, p, x]
                at += 1
        if gauges.shape[0] == 3:
            row = rows[places[m, 0]]
            readings = (
                row[TEMPERATURE],
                volume(row, chem),
                min(vapor_pressure(row, chem), chem.ambient_pressure),
            )
            for g in range(3):
                value = (readings[g] - gauges[g, 0]) / (gauges[g, 1] - gauges[g, 0])
                out[b, at] = min(max(value, 0.0), 1.0)
                at += 1
        out[b, at + goal[m]] = 1.0


@kernel
def _mask(
    members: IntArray,
    table: FloatArray,
    places: IntArray,
    rows: FloatArray,
    busy: BoolArray,
    stock: FloatArray,
    chem: Chemistry,
    out: MaskArray,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        before, legal = -1, False
        for a in range(table.shape[0]):
            # Magnitudes of one process stand together and are legal or not together.
            if (
                before < 0
                or table[a, 0] != table[before, 0]
                or table[a, 1] != table[before, 1]
                or table[a, 3] != table[before, 3]
            ):
                legal = int(table[a, 0]) == END or (busy[m] and _legal(table, a, m, places, rows, stock, chem))
                before = a
            out[b, a] = legal


class OperationBench(Bench):
    """A bench with a flat ``Discrete`` action space: every magnitude of every process, then ``end``.

    Subclasses name their ``positions`` and say what is measured; what each position's camera shows is the observation,
    followed by the gauges (if any) and the goal.
    """

    options_model = OperationOptions
    kernels = (_step,)
    camera = True
    process_kinds: ClassVar[tuple[str, ...]] = ("drain", "mix", "pour", "add", "settle", "heat")
    """Processes this bench has the apparatus for."""

    def __init__(self, key: str, scenario: Scenario, layout: Layout, chemistry: Chemistry) -> None:
        super().__init__(key, scenario, layout, chemistry)
        options: OperationOptions = self.options
        self.separation_model: SeparationModel | None = None
        """Replaces the built-in layers and partition where set."""
        self.table, self._meanings = self._build_table(options.process)
        self._knobs = np.array([options.hottest_k, options.coolest_k, options.settle_per_step])
        self.gauges = self._gauges()
        shown = tuple(
            Channel(f"layers_{name}", CAMERA_PIXELS, "grey", 0.0, 1.0, f"layers of {name}, bottom first")
            for name in self.positions
        )
        names = (("temperature", "K"), ("volume", "L"), ("pressure", "kPa")) if len(self.gauges) else ()
        gauges = tuple(
            Channel(name, 1, unit, float(low), float(high), f"{name} of {self.positions[0]}")
            for (name, unit), (low, high) in zip(names, self.gauges, strict=True)
        )
        self._set_spaces((*shown, *gauges), gymnasium.spaces.Discrete(len(self.table)))

    def _gauges(self) -> FloatArray:
        """[3, 2] range of the temperature, volume and pressure gauges, or [0, 2] for none."""
        return np.zeros((0, 2))

    def _build_table(self, processes: Sequence[Process]) -> tuple[FloatArray, list[str]]:
        rows: list[tuple[float, ...]] = []
        meanings = []
        for i, process in enumerate(processes):
            where = f"{self.scenario.origin}: benches.{self.key}.process.{i}"
            if process.kind not in self.process_kinds:
                raise DataError(
                    f"{where}: kind: this bench can {', '.join(self.process_kinds)}, given {process.kind!r}"
                )
            for position in (process.vessel, process.target):
                if position is not None and position not in self.positions:
                    raise DataError(f"{where}: unknown vessel {position!r}; this bench has {', '.join(self.positions)}")
            if (process.target is None) == (process.kind in ("drain", "pour", "heat")):
                raise DataError(f"{where}: target: needed by drain, pour and heat, and by no other process")
            if (process.material is None) == (process.kind == "add"):
                raise DataError(f"{where}: material: needed by add, and by no other process")
            if process.target == process.vessel:
                raise DataError(f"{where}: target: must differ from vessel, given {process.target!r}")
            material = -1 if process.material is None else self.material(process.material, f"process.{i}.material")
            top = {"pour": 1.0, "drain": 100.0}.get(process.kind, 1e4)
            for magnitude in process.magnitudes:
                if not (magnitude > 0.0 or (process.kind == "heat" and magnitude != 0.0)) or abs(magnitude) > top:
                    raise DataError(f"{where}: magnitudes: must be above 0 and at most {top:g}, given {magnitude}")
                vessel = self.positions.index(process.vessel)
                target = self.positions.index(process.target) if process.target else vessel
                rows.append((_KINDS[process.kind], vessel, target, material, magnitude))
                what = {
                    "drain": f"drain {process.vessel} -> {process.target}",
                    "pour": f"pour {process.vessel} -> {process.target}",
                    "mix": f"mix {process.vessel}",
                    "add": f"add {process.material} to {process.vessel}",
                    "settle": "settle",
                    "heat": f"{'cool' if magnitude < 0 else 'heat'} {process.vessel}",
                }[process.kind]
                meanings.append(f"{what}, {abs(magnitude):g} {_UNITS[process.kind]}")
        rows.append((END, 0, 0, -1, 0.0))
        return np.array(rows, dtype=np.float64).reshape(-1, _COLUMNS), [*meanings, "end the experiment"]

    @property
    def action_meanings(self) -> list[str]:
        return list(self._meanings)

    def prepare(self, shelf: Shelf, station: Station, members: IntArray) -> None:
        station.changed[members] = True
        self._show(shelf, station, members)

    def act(self, shelf: Shelf, station: Station, members: IntArray, actions: npt.NDArray[Any]) -> None:
        s = station
        args = (
            members,
            actions,
            self.table,
            self._knobs,
            s.places,
            shelf.rows,
            shelf.stock,
            shelf.waste,
            s.events,
            s.layers,
            s.profile,
            s.changed,
            s.steps,
            s.ended,
            s.illegal,
        )
        if self.separation_model is None:
            _step(*args, s.stream, s.image, self.step_limit, self.chemistry, self.work)
        else:
            _operations(*args, self.step_limit, self.chemistry, self.work)
            self._show(shelf, station, members)

    def _show(self, shelf: Shelf, station: Station, members: IntArray) -> None:
        s = station
        if self.separation_model is None:
            separate(members, s.places, shelf.rows, s.layers, s.profile, s.changed, self.chemistry, self.work)
        else:
            for m in members:
                for p in range(s.places.shape[1]):
                    self._separate_by_model(shelf.rows[s.places[m, p]], s.layers[m, p], s.profile[m, p])
        _look(members, s.places, shelf.rows, s.layers, s.profile, s.stream, s.image, self.chemistry)

    def _separate_by_model(self, row: FloatArray, layers: IntArray, shares: FloatArray) -> None:
        """The same as the built-in separation of one vessel, by the user's model."""
        chem, model = self.chemistry, self.separation_model
        assert model is not None
        m, k, n_solvents = len(self.layout.materials), len(chem.dissolved), len(chem.solvents)
        amounts = row[AMOUNTS : AMOUNTS + m]
        dissolved = row[AMOUNTS + m :].reshape(k, n_solvents)
        solvent_volume = amounts[chem.solvents] * chem.molar_volume[chem.solvents]
        if solvent_volume.sum() > 0.0:
            total = amounts[chem.dissolved]
            result = model.partition(dissolved.copy(), total, solvent_volume, float(row[CLOCK_WAS]), float(row[CLOCK]))
            result = np.asarray(result, dtype=np.float64)
            fits = result.shape == dissolved.shape and np.allclose(result.sum(axis=1), total, rtol=1e-6, atol=1e-9)
            if not fits or result.min(initial=0.0) < -1e-9:
                raise ValueError(
                    f"separation model {model!r}: dissolved amounts must be [K, L] = {dissolved.shape}, not negative "
                    f"and add up to the totals {total!r}, given {result!r}"
                )
            dissolved[...] = np.maximum(result, 0.0)
        else:
            dissolved[...] = 0.0
        row[CLOCK_WAS] = row[CLOCK]
        volumes = np.zeros(shares.shape[0])
        count = layer_volumes(row, chem, layers, volumes)
        density = np.array([0.0 if i == SOLIDS else chem.density[i] for i in layers[1 : 1 + count]])
        picture = np.asarray(model.profile(volumes[:count], density, float(row[CLOCK]), shares.shape[1]))
        expected = volumes[:count] / volumes[:count].sum() * shares.shape[1]
        fits = picture.shape == (count, shares.shape[1]) and np.allclose(picture.sum(axis=1), expected, atol=1e-6)
        if not fits or not np.allclose(picture.sum(axis=0), 1.0, atol=1e-6) or picture.min() < -1e-9:
            raise ValueError(
                f"separation model {model!r}: a profile must be {(count, shares.shape[1])}, not negative, fill "
                f"every pixel and conserve the layers' volumes, given {picture!r}"
            )
        shares[:count] = picture

    def observe(self, shelf: Shelf, station: Station, members: IntArray, out: ObservationArray) -> None:
        s = station
        _observe(members, s.places, shelf.rows, s.busy, s.goal, s.image, self.gauges, self.chemistry, out)

    def mask(self, shelf: Shelf, station: Station, members: IntArray, out: MaskArray) -> None:
        s = station
        _mask(members, self.table, s.places, shelf.rows, s.busy, shelf.stock, self.chemistry, out)

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        return np.array([check_discrete(agent, action, len(self.table))])
