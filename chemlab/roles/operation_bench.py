"""Benches whose actions are a table of operations on vessels: extraction, distillation, crystallization, or your own.

The scenario's table defines decoding, masks, documentation and execution of every action.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from ..config.datafile import DataError
from ..config.datamodel import DataModel
from ..config.materials import COLDEST_K, HOTTEST_K
from ..config.parts import PartError, blamed, checked_numbers, load_part
from ..config.scenario import Scenario
from ..kernels.arrays import BoolArray, FloatArray, Handle, IntArray, MaskArray, ObservationArray, merged
from ..kernels.arrays import Field as Array
from ..kernels.jit import inner, kernel, opened
from ..physics.backends import (
    elapse,
    find_layers,
    layer_density,
    partition,
    settle_phases,
    solid_volume,
    vapor_pressure,
)
from ..physics.chemistry import AMOUNTS, CLOCK, CLOCK_WAS, TEMPERATURE, Chemistry, ChemistryTable
from ..physics.constants import SOLIDS
from ..physics.shelf import Shelf, ShelfArrays
from ..physics.stratification import camera, profile
from ..physics.transfer import turn_clock, volume
from . import operations
from .bench import (
    CAMERA_PIXELS,
    HEAT,
    STIR,
    Bench,
    BenchRules,
    Channel,
    Experiments,
    ExperimentState,
    check_discrete,
    check_work,
    on_scale,
)
from .models import SeparationModel
from .operations import OPERATIONS, Operation, Turn

END = -1
_KIND, _VESSEL, _TARGET, _MATERIAL, _MAGNITUDE, _TOUCHES, _COLUMNS = range(7)
_BUILT_IN = len(OPERATIONS)
_HEATING, _MIXING = list(OPERATIONS).index("heat"), list(OPERATIONS).index("mix")
_GAUGES = (("temperature", "K"), ("volume", "L"), ("pressure", "kPa"), ("solids", "share of the volume"))


class Process(DataModel):
    """One row of an action table: a process and its magnitudes, each of which is one action."""

    kind: str
    """``drain``, ``mix``, ``pour``, ``add``, ``settle``, ``heat``, ``seed``, ``filter``, ``dry``, or your own operation
    as ``my_parts.py:NAME``.
    """
    vessel: str
    """Position the process works on (``settle`` works on all of the bench's vessels)."""
    target: str | None = None
    """Receiving position (drain, pour, filter, heat: the condenser's)."""
    material: str | None = None
    """Material that ``add`` adds from stock."""
    magnitudes: tuple[float, ...] = Field(min_length=1, max_length=1000)
    """drain: percent of the vessel's height; mix, settle: units of settling time (6 separates the layers); pour,
    filter: fraction; add: L; heat: kJ (< 0 cools); seed: g; dry: L of air."""


class OperationOptions(DataModel):
    """Scenario keys of a bench with a table of operations."""

    process: tuple[Process, ...] = Field(min_length=1, max_length=200)
    auxiliary_capacity_l: float = Field(default=1.0, gt=0.0, le=100.0)
    """Capacity of the clean vessels the bench provides."""
    settle_per_step: float = Field(default=0.0, ge=0.0, le=100.0)
    """Settling of every vessel per step."""
    hottest_k: float = Field(default=800.0, ge=COLDEST_K, le=HOTTEST_K)
    coolest_k: float = Field(default=273.15, ge=COLDEST_K, le=HOTTEST_K)
    stages: int = Field(default=1, ge=1, le=16)
    """Theoretical stages from the boiling pot, which is one of them, to the condenser (physics backend ``real``)."""
    reflux: float = Field(default=1.0, ge=0.0, le=100.0)
    """Reflux ratio: mol that the head of a column returns per mol that passes."""

    cake_liquid: float = Field(default=0.4, ge=0.0, le=10.0)
    """Litres of liquid that a litre of solids retains in a filter: the void fraction of a drained cake, a guess."""

    @model_validator(mode="after")
    def _ordered(self) -> OperationOptions:
        if self.hottest_k <= self.coolest_k:
            raise ValueError(f"hottest_k = {self.hottest_k} must be above coolest_k = {self.coolest_k}")
        return self


class ImageState(NamedTuple):
    """State of a bench with layer cameras. N laboratories, P positions, C layers."""

    changed: Annotated[BoolArray, Array("N P", first=True)]
    """[N, P] whether the last action changed a vessel, so that its layers have to be recomputed"""
    layers: Annotated[IntArray, Array("N P C+1")]
    """[N, P, C + 1] and profile [N, P, C, pixels]: the layers of its vessels"""
    profile: Annotated[FloatArray, Array("N P C pixels")]
    image: Annotated[FloatArray, Array("N P pixels")]
    """[N, P, pixels] latest camera pictures"""
    elapsed: Annotated[FloatArray, Array("N", kept=False)]
    """[N] settling of the vessels during the current action"""


class ApparatusRules(NamedTuple):
    """Static parameters of a bench with a table of operations. A actions."""

    table: Annotated[FloatArray, Array("A 6")]
    """[A, 6] kind, vessel, target, material, magnitude, whether vessels are touched; kind -1 ends the experiment"""
    gauges: Annotated[FloatArray, Array("g 2")]
    """[g, 2] low and high of T (K), V (L), P (kPa), share of solids: the first g of them"""
    limits: Annotated[FloatArray, Array("4")]
    """[4] temperatures of the heating mantle and of the coolant in K; theoretical stages; reflux ratio"""
    cake_liquid: Annotated[float, Array("")]
    """litres of liquid retained per litre of solids in a filter"""
    settle_per_step: Annotated[float, Array("")]


OperationState: Any = merged(ExperimentState, ImageState)
OperationRules: Any = merged(BenchRules, ApparatusRules)


@inner
def _turn(m: int, a: int, state: Any, rules: Any, shelf: ShelfArrays) -> Turn:
    """Return the objects of action ``a`` in laboratory ``m``."""
    vessel, target = int(rules.table[a, _VESSEL]), int(rules.table[a, _TARGET])
    kind, magnitude = int(rules.table[a, _KIND]), rules.table[a, _MAGNITUDE]
    if kind == _HEATING:
        magnitude *= state.gain[m, HEAT]
    elif kind == _MIXING:
        magnitude *= state.gain[m, STIR]
    return Turn(
        shelf.rows[state.places[m, vessel]],
        shelf.rows[state.places[m, target]],
        magnitude,
        int(rules.table[a, _MATERIAL]),
        shelf.stock[m],
        shelf.waste[m],
        state.events[m],
        state.layers[m, vessel],
        state.profile[m, vessel],
        rules.limits,
        rules.cake_liquid,
        int(rules.parts[state.goal[m], 0]),
        rules.work,
        rules.limits[:0],
    )


@inner
def _perform(m: int, a: int, state: Any, rules: Any, shelf: ShelfArrays, chem: Handle) -> None:
    """Carry out a built-in operation if it is legal; user-defined ones have been carried out already."""
    kind = int(rules.table[a, _KIND])
    if kind >= _BUILT_IN:
        return
    state.events[m, :] = 0.0
    state.elapsed[m] = 0.0
    if kind == END:
        state.illegal[m] = False
        return
    turn = _turn(m, a, state, rules, shelf)
    state.illegal[m] = not operations.legal(kind, turn, chem)
    if not state.illegal[m]:
        state.elapsed[m] = operations.act(kind, turn, chem)


@inner
def _conclude(m: int, a: int, state: Any, rules: Any, shelf: ShelfArrays, chem: Handle) -> None:
    """Apply the consequences of an operation: clocks, phases, the end of the experiment."""
    ended = int(rules.table[a, _KIND]) == END
    if not state.illegal[m] and not ended:
        touches = rules.table[a, _TOUCHES] > 0.0
        vessel, target = int(rules.table[a, _VESSEL]), int(rules.table[a, _TARGET])
        elapsed = rules.settle_per_step + state.elapsed[m]
        for p in range(state.places.shape[1]):
            row = shelf.rows[state.places[m, p]]
            state.changed[m, p] = touches and p in (vessel, target)
            if elapsed > 0.0:
                before = row[CLOCK]
                turn_clock(row, elapsed)
                state.changed[m, p] = state.changed[m, p] or row[CLOCK] != before
            if state.changed[m, p]:
                settle_phases(row, chem, shelf.waste[m], state.events[m], rules.work)
            if elapse(row, 1.0, chem, shelf.waste[m], state.events[m], rules.work):
                state.changed[m, p] = True
    state.steps[m] += 1
    state.ended[m] = ended or state.steps[m] >= rules.step_limit


@inner
def _separate(m: int, state: Any, rules: Any, shelf: ShelfArrays, chem: Handle) -> None:
    """Update dissolved amounts and layer profiles of the changed vessels."""
    for p in range(state.places.shape[1]):
        if state.changed[m, p]:
            row = shelf.rows[state.places[m, p]]
            partition(row, chem, rules.work)
            profile(row, chem, state.layers[m, p], state.profile[m, p], rules.work)
            state.changed[m, p] = False


@inner
def _look(m: int, state: Any, shelf: ShelfArrays, chem: Handle) -> None:
    """Take a new picture of every vessel."""
    for p in range(state.places.shape[1]):
        row = shelf.rows[state.places[m, p]]
        camera(row, state.profile[m, p], state.layers[m, p], chem, state.stream[m], state.image[m, p])


@kernel
def _step(
    members: IntArray,
    actions: IntArray,
    look: bool,
    experiment: Handle,
    bench: Handle,
    shelf: Handle,
    chemistry: Handle,
) -> None:
    """Step every member (skipped if the action is negative) and, if ``look`` is set, take pictures."""
    state, rules, arrays = opened(OperationState, experiment), opened(OperationRules, bench), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m, a = members[b], actions[b]
        chem = chemistry[arrays.variant[m]]
        if a >= 0:
            _perform(m, a, state, rules, arrays, chem)
            _conclude(m, a, state, rules, arrays, chem)
        if look:
            _separate(m, state, rules, arrays, chem)
            _look(m, state, arrays, chem)


@kernel
def _observe(
    members: IntArray, experiment: Handle, bench: Handle, shelf: Handle, chemistry: Handle, out: ObservationArray
) -> None:
    """Write pictures of every vessel, gauges of the first, and the goal."""
    state, rules, arrays = opened(OperationState, experiment), opened(OperationRules, bench), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m = members[b]
        if not state.busy[m]:
            out[b, :] = 0.0
            continue
        at = 0
        for p in range(state.image.shape[1]):
            shown, image = out[b, at : at + state.image.shape[2]], state.image[m, p]
            for x in range(image.shape[0]):
                shown[x] = image[x]
            at += image.shape[0]
        if rules.gauges.shape[0] > 0:
            row, chem = arrays.rows[state.places[m, 0]], chemistry[arrays.variant[m]]
            ambient, filled = opened(Chemistry, chem).ambient_pressure, volume(row, chem)
            solid = solid_volume(row, chem) / filled if filled > 0.0 else 0.0
            readings = (row[TEMPERATURE], filled, min(vapor_pressure(row, chem), ambient), solid)
            for g in range(rules.gauges.shape[0]):
                out[b, at] = on_scale(readings[g], rules.gauges[g, 0], rules.gauges[g, 1])
                at += 1
        out[b, at:] = 0.0
        out[b, at + state.goal[m]] = 1.0


@kernel
def _mask(
    members: IntArray, experiment: Handle, bench: Handle, shelf: Handle, chemistry: Handle, out: MaskArray
) -> None:
    state, rules, arrays = opened(OperationState, experiment), opened(OperationRules, bench), opened(ShelfArrays, shelf)
    table = rules.table
    for b in range(members.shape[0]):
        m = members[b]
        chem = chemistry[arrays.variant[m]]
        before, allowed = -1, False
        for a in range(table.shape[0]):
            # Magnitudes of one process are adjacent and have the same legality.
            if (
                before < 0
                or table[a, _KIND] != table[before, _KIND]
                or table[a, _VESSEL] != table[before, _VESSEL]
                or table[a, _MATERIAL] != table[before, _MATERIAL]
            ):
                kind = int(table[a, _KIND])
                allowed = kind == END or (
                    state.busy[m] and operations.legal(kind, _turn(m, a, state, rules, arrays), chem)
                )
                before = a
            out[b, a] = allowed


class OperationBench(Bench):
    """A bench with a flat ``Discrete`` action space: every magnitude of every process, then ``end``.

    Subclasses define ``positions`` and the score. The observation is the camera picture of each position, followed by
    the gauges (if any) and the goal.
    """

    model_methods = ("partition", "profile")
    options_model = OperationOptions
    own_state = (ImageState,)
    own_rules = (ApparatusRules,)
    camera = True
    process_kinds: ClassVar[tuple[str, ...]] = tuple(OPERATIONS)
    """Processes that this bench supports."""
    gauge_count: ClassVar[int] = 0
    """Number of gauges: the first ones of temperature, volume, pressure and solids."""

    def __init__(self, key: str, scenario: Scenario, chemistry: ChemistryTable) -> None:
        super().__init__(key, scenario, chemistry)
        options: OperationOptions = self.options
        self._others: list[Operation] = []
        """User-defined operations, numbered after the built-in ones. By their number here:"""
        self._names: list[str] = []
        self._numbers: list[FloatArray] = []
        self._own_actions: list[tuple[int, int]] = []
        """first and last + 1 of the actions of every user-defined process"""
        self.units: dict[str, str] = {}
        """unit of the magnitudes by kind of process"""
        self.table, self._meanings = self._build_table(options.process)
        ranges = [[options.coolest_k, options.hottest_k], [0.0, self.auxiliary_capacity_l]]
        ranges += [[0.0, scenario.ambient_pressure_kpa], [0.0, 1.0]]
        self.gauges = np.array(ranges[: self.gauge_count]).reshape(-1, 2)
        shown = tuple(
            Channel(f"layers_{name}", CAMERA_PIXELS, "grey", 0.0, 1.0, f"layers of {name}, bottom first")
            for name in self.positions
        )
        gauges = tuple(
            Channel(name, 1, unit, float(low), float(high), f"{name} of {self.positions[0]}")
            for (name, unit), (low, high) in zip(_GAUGES, self.gauges, strict=False)
        )
        self._set_spaces((*shown, *gauges), gymnasium.spaces.Discrete(len(self.table)))

    def state_sizes(self, members: int, positions: int) -> dict[str, int]:
        columns = self.layout.fluid_columns
        sizes = {"C": columns, "C+1": columns + 1, "pixels": CAMERA_PIXELS}
        return {**super().state_sizes(members, positions), **sizes}

    def rules_values(self) -> dict[str, Any]:
        options: OperationOptions = self.options
        return {
            "table": self.table,
            "gauges": self.gauges,
            "limits": np.array([options.hottest_k, options.coolest_k, options.stages, options.reflux]),
            "cake_liquid": options.cake_liquid,
            "settle_per_step": options.settle_per_step,
        }

    def _operation(self, process: Process, where: str) -> tuple[int, Operation]:
        """Return the number and the operation of a process."""
        if process.kind in self.process_kinds:
            return list(OPERATIONS).index(process.kind), OPERATIONS[process.kind]
        if ":" not in process.kind:
            raise DataError(
                f"{where}: kind: must be one of {', '.join(self.process_kinds)}, or your own, "
                f"'file.py:NAME'; given {process.kind!r}"
            )
        operation: Operation = load_part(process.kind, self.scenario, f"benches.{self.key}.process", of=Operation)
        if operation not in self._others:
            with blamed(f"{where}: {process.kind}: numbers()"):
                self._numbers.append(np.asarray(operation.numbers(self), dtype=np.float64))
            self._names.append(f"{self.scenario.origin}: benches.{self.key}.process: {process.kind}")
            self._others.append(operation)
        return _BUILT_IN + self._others.index(operation), operation

    def _build_table(self, processes: Sequence[Process]) -> tuple[FloatArray, list[str]]:
        rows: list[tuple[float, ...]] = []
        meanings = []
        for i, process in enumerate(processes):
            where = f"{self.scenario.origin}: benches.{self.key}.process.{i}"
            number, operation = self._operation(process, where)
            self.units[process.kind] = operation.unit
            for position in (process.vessel, process.target):
                if position is not None and position not in self.positions:
                    raise DataError(f"{where}: unknown vessel {position!r}; this bench has {', '.join(self.positions)}")
            for name, given in (("target", process.target), ("material", process.material)):
                if (given is None) == (name in operation.takes):
                    kinds = {**OPERATIONS, process.kind: operation}
                    takers = ", ".join(kind for kind, known in kinds.items() if name in known.takes)
                    raise DataError(f"{where}: {name}: required by {takers}, and not allowed for other processes")
            if process.target == process.vessel:
                raise DataError(f"{where}: target: must differ from vessel, given {process.target!r}")
            if number >= _BUILT_IN:
                self._own_actions.append((len(rows), len(rows) + len(process.magnitudes)))
            material = -1 if process.material is None else self.material(process.material, f"process.{i}.material")
            for magnitude in process.magnitudes:
                signed = operation.negative is not None and magnitude != 0.0
                if not (magnitude > 0.0 or signed) or abs(magnitude) > operation.top:
                    raise DataError(
                        f"{where}: magnitudes: must be above 0 and at most {operation.top:g}, given {magnitude}"
                    )
                vessel = self.positions.index(process.vessel)
                target = self.positions.index(process.target) if process.target else vessel
                rows.append((number, vessel, target, material, magnitude, float(operation.touches)))
                words = operation.words if magnitude > 0.0 else operation.negative or ""
                with blamed(f"{where}: {process.kind}: words may have {{vessel}}, {{target}} and {{material}}"):
                    what = words.format(vessel=process.vessel, target=process.target, material=process.material)
                size, unit = (100.0 * magnitude, "%") if operation.unit == "fraction" else (magnitude, operation.unit)
                meanings.append(f"{what}, {abs(size):g} {unit}")
        rows.append((END, 0, 0, -1, 0.0, 0.0))
        return np.array(rows, dtype=np.float64).reshape(-1, _COLUMNS), [*meanings, "end the experiment"]

    @property
    def action_meanings(self) -> list[str]:
        return list(self._meanings)

    def choices(self, kind: str, **wanted: str | None) -> dict[float, int]:
        """Return {magnitude: action} of the first process of a kind with the wanted vessel, target or material."""
        first = 0
        for process in self.options.process:
            if process.kind == kind and all(getattr(process, name) == value for name, value in wanted.items()):
                return {magnitude: first + i for i, magnitude in enumerate(process.magnitudes)}
            first += len(process.magnitudes)
        return {}

    def prepare(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:
        experiments.changed[members] = True
        self._show(shelf, experiments, members)

    def act(self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]) -> None:
        if self._others:
            self._perform_others(shelf, experiments, members, actions)
        _step(members, actions, self.model is None, *self._handles(shelf, experiments))
        if self.model is not None:
            self._show(shelf, experiments, members)

    def _own_turn(
        self, shelf: Shelf, experiments: Experiments, member: int, action: int
    ) -> tuple[str, Operation, Turn]:
        """Return the user-defined operation of an action, its name, and its objects."""
        number = int(self.table[action, _KIND]) - _BUILT_IN
        turn = getattr(_turn, "py_func", _turn)
        made: Turn = turn(member, action, experiments.table.arrays, self.rules.arrays, shelf.table.arrays)
        return self._names[number], self._others[number], made._replace(numbers=self._numbers[number])

    def _own_legal(self, shelf: Shelf, experiments: Experiments, member: int, action: int) -> bool:
        name, operation, turn = self._own_turn(shelf, experiments, member, action)
        with blamed(f"{name}: legal()"):
            return bool(operation.legal(turn, shelf.chem(member)))

    def _perform_others(
        self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]
    ) -> None:
        """Carry out user-defined operations."""
        others = self.table[actions, _KIND] >= _BUILT_IN
        for m, a in zip(members[others].tolist(), actions[others].tolist(), strict=True):
            experiments.events[m], experiments.elapsed[m] = 0.0, 0.0
            experiments.illegal[m] = not self._own_legal(shelf, experiments, m, a)
            if experiments.illegal[m]:
                continue
            name, operation, turn = self._own_turn(shelf, experiments, m, a)
            with blamed(f"{name}: act()"):
                elapsed = operation.act(turn, shelf.chem(m))
            experiments.elapsed[m] = checked_numbers(
                elapsed, (), f"{name}: act(), which must return the settling of vessels (0.0: none)"
            )
            check_work(f"{name}: act()", np.stack([turn.row, turn.target]), turn.events, turn.stock, turn.waste)

    def _show(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:
        """Update layers and pictures."""
        if self.model is not None:
            for m in members.tolist():
                for place, layers, shares in zip(
                    experiments.places[m], experiments.layers[m], experiments.profile[m], strict=True
                ):
                    self._separate_by_model(shelf.rows[place], shelf.known(m), shelf.chem(m), layers, shares)
            experiments.changed[members] = False
        _step(members, np.full(len(members), -1), True, *self._handles(shelf, experiments))

    def _separate_by_model(
        self, row: FloatArray, known: Chemistry, chem: Handle, layers: IntArray, shares: FloatArray
    ) -> None:
        """Separate one vessel by the user's model instead of the built-in one."""
        model: SeparationModel = self.model
        here = f"{self._model_name}: partition()"
        m, k, n_solvents = len(self.layout.materials), len(known.dissolved), len(known.solvents)
        amounts = row[AMOUNTS : AMOUNTS + m]
        dissolved = row[AMOUNTS + m :].reshape(k, n_solvents)
        solvent_volume = amounts[known.solvents] * known.molar_volume[known.solvents]
        if solvent_volume.sum() > 0.0:
            total = amounts[known.dissolved]
            clocks = float(row[CLOCK_WAS]), float(row[CLOCK])
            with blamed(here):
                returned = model.partition(dissolved.copy(), total.copy(), solvent_volume, *clocks)
            result = checked_numbers(returned, dissolved.shape, here)
            fits = np.allclose(result.sum(axis=1), total, rtol=1e-6, atol=1e-9)
            if not fits or result.min(initial=0.0) < -1e-9:
                raise PartError(
                    f"{here}: dissolved amounts must not be negative, and add up to the totals {total}, given {result}"
                )
            dissolved[...] = np.maximum(result, 0.0)
        else:
            dissolved[...] = 0.0
        row[CLOCK_WAS] = row[CLOCK]
        volumes = np.zeros(shares.shape[0])
        count = find_layers(row, chem, layers, volumes)
        density = np.array([0.0 if i == SOLIDS else layer_density(row, i, chem) for i in layers[1 : 1 + count]])
        here = f"{self._model_name}: profile()"
        with blamed(here):
            returned = model.profile(volumes[:count].copy(), density, float(row[CLOCK]), shares.shape[1])
        picture = checked_numbers(returned, (count, shares.shape[1]), here)
        expected = volumes[:count] / volumes[:count].sum() * shares.shape[1]
        fits = np.allclose(picture.sum(axis=1), expected, atol=1e-6)
        if not fits or not np.allclose(picture.sum(axis=0), 1.0, atol=1e-6) or picture.min() < -1e-9:
            raise PartError(
                f"{here}: shares must not be negative, must fill every pixel and conserve the layers' volumes, given "
                f"{picture}"
            )
        shares[:count] = picture

    def see(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: ObservationArray) -> None:
        _observe(members, *self._handles(shelf, experiments), out)

    def mask(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: MaskArray) -> None:
        _mask(members, *self._handles(shelf, experiments), out)
        for first, end in self._own_actions:  # the magnitudes of a process have the same legality
            for row, m in zip(out, members.tolist(), strict=True):
                row[first:end] = experiments.busy[m] and self._own_legal(shelf, experiments, m, first)

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        return np.array([check_discrete(agent, action, len(self.table))])
