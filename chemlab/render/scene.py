"""Scenes: plain data that describe a picture of a laboratory, read from the state arrays.

A :class:`Scene` contains the true state. Agents observe only ``BenchPicture.seen`` and ``SlotPicture.readings``;
:func:`visible_scene` removes the properties that only a measurement can show. Pictures and pages show scenes only.

Layers have true proportions. ``VesselPicture.layers`` lists them with their volumes from the bottom up; the rest of the
vessel is air. If the contents are not separated, ``VesselPicture.mixture`` has the share of every liquid in equal
slices of the liquid, bottom first. It is the profile of the layer camera with the air moved to the top, because in a
stirred vessel the camera shows air at all heights. Fill level and liquid volumes are therefore true as well.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, IntArray
from ..lab.engine import Laboratories
from ..lab.experiments import ExperimentBatch
from ..lab.text import blank_channels
from ..physics.chemistry import AMOUNTS, PRESENT, ROLE_GAS, ROLE_ION, ROLE_SOLID
from ..physics.constants import FIRST_PHASE, SOLIDS
from ..physics.shelf import Shelf
from ..physics.stratification import profile
from ..roles.bench import CAMERA_PIXELS, Bench, Experiments, channel_slices
from ..roles.manager_state import COST_WORDS, RUNNING, STATUS_WORDS
from ..roles.manager_view import shown_share

MIXTURE_SLICES = 40
_SEPARATED = 1e-3
"""A profile within this distance of the stacked layers is drawn as stacked layers."""
_UNKNOWN = "#b9cbd8"
"""Colour of unknown contents."""
_SHOWN_MOL = 5e-6
"""Amount in mol below which a material is not drawn."""


@dataclass(frozen=True)
class MaterialPicture:
    """A material in the legend, with its colour and a unique tag."""

    name: str
    tag: str
    """abbreviation of at most 4 characters"""
    color: str
    """#rrggbb"""
    role: str


@dataclass(frozen=True)
class LayerPicture:
    """One layer of a vessel."""

    material: str
    """solvent of a liquid layer, or material of a solid one; empty if unknown"""
    phase: str
    """``solid`` (at the bottom) or ``liquid``"""
    volume_l: float
    """volume in litres, solutes included"""
    color: str


@dataclass(frozen=True)
class VesselPicture:
    """A vessel and its contents."""

    position: str
    """``slot 3`` on the shelf; the position's name (``main``, ``EV``, ``B1``) on a bench"""
    capacity_l: float
    volume_l: float
    """volume in litres of the contents without air"""
    temperature_k: float | None
    """None if it is not visible"""
    settling: float
    """0 when fully mixed, 1 when separated"""
    layers: tuple[LayerPicture, ...]
    """bottom first: solids, then liquids, densest first"""
    mixture: tuple[tuple[float, ...], ...]
    """[MIXTURE_SLICES][liquid layers] shares, bottom first; empty if the layers are stacked as listed"""
    contents: tuple[tuple[str, float], ...]
    """(material, mol) of all contents, which agents do not observe"""
    camera: tuple[float, ...]
    """latest grey values of the bench's camera, bottom first; empty without a camera"""


@dataclass(frozen=True)
class ReadingPicture:
    """The latest reading of an instrument on a vessel of the shelf."""

    instrument: str
    kind: str
    age: int
    """age in ticks"""
    unit: str
    low: float
    high: float
    values: tuple[float, ...]
    """values in [0, 1], scaled from [low, high]"""
    labels: tuple[str, ...]
    """labels of the values: a chromatograph's materials and the remainder; empty for other instruments"""


@dataclass(frozen=True)
class SlotPicture:
    """A slot of the shelf: with a vessel, reserved for a bench's vessel, or empty."""

    slot: int
    vessel: VesselPicture | None
    reserved_for: str | None
    """bench agent for whose vessel the slot is reserved, or None"""
    origin: str
    """last bench of the vessel and its position at the bench: ``ext EV``, or ``rxn`` for benches of one vessel"""
    readings: tuple[ReadingPicture, ...]


@dataclass(frozen=True)
class ChannelPicture:
    """One observation channel of a bench: ``values`` in [0, 1], scaled from [low, high] ``unit``."""

    name: str
    unit: str
    low: float
    high: float
    values: tuple[float, ...]


@dataclass(frozen=True)
class BenchPicture:
    """A bench: its experiment, its vessels and its agent's observation."""

    agent: str
    key: str
    kind: str
    busy: bool
    turn: bool
    """True if the bench's agent has the turn"""
    goal: str
    """goal of the experiment; empty if the bench is idle"""
    step: int
    step_limit: int
    positions: tuple[str, ...]
    vessels: tuple[VesselPicture, ...]
    """vessels at the bench"""
    seen: tuple[ChannelPicture, ...]
    """observation channels without the goal and without channels that always read 0; empty if the bench is idle"""
    events: tuple[tuple[str, float], ...]
    """safety events of the last action, by kind"""


@dataclass(frozen=True)
class OrderPicture:
    """An order of the laboratory; without terms, it arrives at the beginning and has no deadline."""

    goal: str
    filled: bool
    submitted_mol: float
    purity: float
    arrives: int = 0
    """tick at which agents can first observe the order"""
    due: int | None = None
    """last tick at which the order is paid in full"""
    price: float = 1.0
    amount_at_least_mol: float = 0.0
    purity_at_least: float = 0.0

    def state(self, ticks: int) -> str:
        """Return ``to come``, ``open``, ``overdue`` or ``filled``."""
        if self.filled:
            return "filled"
        if ticks < self.arrives:
            return "to come"
        return "open" if self.due is None or ticks <= self.due else "overdue"


@dataclass(frozen=True)
class BottlePicture:
    """The remaining stock of one material."""

    material: str
    mol: float
    full_mol: float


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A laboratory, a single bench or a single vessel (``kind``) at one time; see the module's documentation."""

    kind: str
    """``laboratory``, ``bench`` (without shelf, orders, costs and manager) or ``vessel`` (also without a bench)"""
    scenario: str
    title: str
    status: str
    """``running``, ``submitted`` or ``limit reached``; for a bench ``running`` or ``ended``"""
    turn: str = ""
    """agent that has the turn; empty after the episode"""
    manager_actions: int = 0
    manager_action_limit: int = 0
    ticks: int = 0
    tick_limit: int = 0
    orders: tuple[OrderPicture, ...] = ()
    result: float = 0.0
    """raw score if the episode ended now: orders filled so far, minus costs; NaN: not known to the agents"""
    costs: tuple[tuple[str, float], ...] = ()
    """(item, cost in units of the raw score)"""
    budget: float = 0.0
    """remaining budget of the manager for measurements"""
    safety: tuple[tuple[str, float], ...] = ()
    """(kind, total) of the safety events so far"""
    stock: tuple[BottlePicture, ...] = ()
    waste_l: float
    shelf: tuple[SlotPicture, ...] = ()
    benches: tuple[BenchPicture, ...] = ()
    materials: tuple[MaterialPicture, ...]
    """all materials of the scenario except gases"""
    largest_capacity_l: float
    """largest capacity of any vessel of the scenario, in litres: the scale of all vessels"""
    temperature_range_k: tuple[float, float]
    """common range of all thermometers in kelvin"""


def _tags(names: Iterable[str]) -> dict[str, str]:
    """Return a short unique tag for every name: a short name itself, else the initials of its parts with variations."""
    tags: dict[str, str] = {}
    for name in sorted(names, key=len):
        parts = re.findall(r"\d|[A-Za-z]+", name) or [name]
        initials = "".join(part[0].upper() for part in parts)
        options = [name] if len(name) <= 4 else []
        options += [initials[:4], *((initials[:-1] + parts[-1][:n].capitalize())[:4] for n in range(2, 5))]
        more = (f"{initials[:2]}{n}" for n in itertools.count(2))
        tags[name] = next(option for option in itertools.chain(options, more) if option not in tags.values())
    return tags


@functools.lru_cache(maxsize=32)
def material_pictures(scenario: Scenario) -> tuple[MaterialPicture, ...]:
    """Return the scenario's materials without gases, in the scenario's order."""
    shown = {name: material for name, material in scenario.materials.items() if material.role != "gas"}
    tags = _tags(shown)
    return tuple(MaterialPicture(name, tags[name], m.color.lower(), m.role) for name, m in shown.items())


class Camera:
    """Makes the pictures of one shelf's vessels; the picture of an unchanged vessel is reused.

    Args:
        scenario: scenario of the shelf.
        shelf: the shelf.
    """

    def __init__(self, scenario: Scenario, shelf: Shelf) -> None:
        self._scenario, self.shelf, self.known = scenario, shelf, shelf.known()
        columns = shelf.layout.fluid_columns
        self.colors = [material.color.lower() for material in scenario.materials.values()]
        self._scales: dict[int, tuple[float, tuple[float, float]]] = {}
        self._latest: dict[tuple[int, int], tuple[bytes, VesselPicture]] = {}
        self._layers: IntArray = np.zeros(columns + 1, dtype=np.int64)
        self._shares: FloatArray = np.zeros((columns, CAMERA_PIXELS))
        self._work: FloatArray = np.zeros((columns + 9, max(columns + 1, CAMERA_PIXELS)))

    def take(
        self, member: int, place: int, position: str, experiments: Experiments | None = None, role: int = 0
    ) -> VesselPicture | None:
        """Return the picture of a vessel, or None if the position is empty.

        Args:
            member: environment index.
            place: position of the vessel in the shelf's arrays.
            position: name of the position.
            experiments: experiments of the vessel's bench.
            role: index of the vessel at the bench.
        """
        row = self.shelf.vessels[member, place]
        if not row[PRESENT] > 0.0:
            return None
        image: FloatArray = np.zeros(0)
        if experiments is not None and hasattr(experiments, "image") and experiments.layers[member, role, 0] > 0:
            # Use the bench's layers, because a separation model may have computed them.
            layers, shares, image = (
                experiments.layers[member, role],
                experiments.profile[member, role],
                experiments.image[member, role],
            )
            state = b"".join(array.tobytes() for array in (row, layers, shares, image))
        else:
            layers, shares, state = self._layers, self._shares, row.tobytes()
        before, picture = self._latest.get((member, place), (b"", None))
        if before == state:
            return picture
        if layers is self._layers:
            profile(row, self.shelf.chem(), layers, shares, self._work)
        vessel = self.shelf.vessel(member, place)
        volume, amounts = vessel.volume_l, vessel.amounts(_SHOWN_MOL)
        listed, mixture = self._layered(row, amounts, layers, shares, max(vessel.capacity_l, volume))
        picture = VesselPicture(
            position=position,
            capacity_l=vessel.capacity_l,
            volume_l=volume,
            temperature_k=vessel.temperature_k,
            settling=min(max(vessel.settling, 0.0), 1.0),
            layers=tuple(listed),
            mixture=mixture,
            contents=tuple(amounts.items()),
            camera=tuple(image.tolist()),
        )
        self._latest[member, place] = state, picture
        return picture

    def scales(self, benches: Iterable[Bench], member: int) -> tuple[float, tuple[float, float]]:
        """Return the largest capacity in litres and the temperature range in kelvin of an episode's pictures."""
        if member in self._scales:
            return self._scales[member]
        ambient = self._scenario.ambient_temperature_k
        capacities = [vessel.capacity_l for vessel in self._scenario.shelf.vessel]
        low, high = ambient - 30.0, ambient + 70.0
        for bench in benches:
            capacities += [bench.auxiliary_capacity_l, bench.spec.start.capacity_l]
            options = bench.options
            piston, thermostat = getattr(options, "volume_l", None), getattr(options, "temperature_k", None)
            if piston is not None:
                capacities.append(float(piston.high))
            if thermostat is not None:
                low, high = min(low, float(thermostat.low)), max(high, float(thermostat.high))
            if any(process.kind == "heat" for process in getattr(options, "process", ())):
                low, high = min(low, float(options.coolest_k)), max(high, float(options.hottest_k))
        capacities += [self.shelf.vessel(member, p).capacity_l for p in range(self.shelf.vessels.shape[1])]
        self._scales[member] = max(capacities), (low, high)
        return self._scales[member]

    def _layered(
        self, row: FloatArray, amounts: dict[str, float], layers: IntArray, shares: FloatArray, total_l: float
    ) -> tuple[list[LayerPicture], tuple[tuple[float, ...], ...]]:
        """Return the layers, bottom first, and the mixture of the liquids if they are not separated."""
        names, chem = self.shelf.layout.materials, self.known
        count = int(layers[0])
        columns = shares[:count]
        volumes = columns.sum(axis=1) * (total_l / columns.shape[1])
        kinds = layers[1 : 1 + count]
        wet = not set(chem.solvents.tolist()).isdisjoint(kinds.tolist())
        liquids = [c for c in range(count) if kinds[c] != SOLIDS and kinds[c] != chem.air and volumes[c] > 0.0]
        listed = []
        if kinds[0] == SOLIDS and volumes[0] > 0.0:
            solids = []
            for name, mol in amounts.items():
                i = names.index(name)
                # Without a solvent, ions are shown as solid salt.
                if self.shelf.layout.most_layers and chem.dissolved_at[i] >= 0:
                    mol = max(mol - float(self._dissolved(row)[chem.dissolved_at[i]].sum()), 0.0)  # undissolved
                elif chem.role[i] != ROLE_SOLID and (chem.role[i] != ROLE_ION or wet):
                    continue
                if mol > _SHOWN_MOL:
                    solids.append((float(chem.density[i]), i, mol * float(chem.molar_volume[i])))
            listed = [self._layer(i, "solid", v) for _, i, v in sorted(solids, reverse=True)]
        listed += [self._liquid(row, int(kinds[c]), float(volumes[c])) for c in liquids]
        return listed, _mixture(columns[liquids]) if len(liquids) > 1 else ()

    def _dissolved(self, row: FloatArray) -> FloatArray:
        """Return [K, L] mol of each dissolving material in each solvent or phase."""
        layout = self.shelf.layout
        return row[AMOUNTS + len(layout.materials) :].reshape(len(layout.dissolved), -1)

    def _liquid(self, row: FloatArray, kind: int, volume_l: float) -> LayerPicture:
        """Return the picture of one liquid layer. A phase has the volume-weighted mean colour of its components."""
        if kind > FIRST_PHASE:
            return self._layer(kind, "liquid", volume_l)
        phase = FIRST_PHASE - kind
        litres = self._dissolved(row)[:, phase] * self.known.molar_volume[self.known.dissolved]
        colors = np.array([list(bytes.fromhex(self.colors[i][1:])) for i in self.known.dissolved])
        mixed = litres @ colors / max(litres.sum(), 1e-300)
        color = "#" + bytes(np.rint(mixed).astype(np.uint8).tolist()).hex()
        return LayerPicture(self.shelf.layout.solvents[phase], "liquid", volume_l, color)

    def _layer(self, material: int, phase: str, volume_l: float) -> LayerPicture:
        return LayerPicture(self.shelf.layout.materials[material], phase, volume_l, self.colors[material])


def _mixture(shares: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Convert shares [liquids, pixels] of the vessel to shares of equal slices of the liquid; () if separated."""
    # Interpolate each liquid's cumulative volume over the cumulative volume of all liquids at the slices' bounds.
    height = np.concatenate(([0.0], np.cumsum(shares.sum(axis=0))))
    bounds = np.linspace(0.0, height[-1], MIXTURE_SLICES + 1)
    reached = np.array([np.interp(bounds, height, np.concatenate(([0.0], np.cumsum(row)))) for row in shares])
    slices = np.diff(reached, axis=1) / (height[-1] / MIXTURE_SLICES)
    tops = np.cumsum(shares.sum(axis=1))
    lows = np.concatenate(([0.0], tops[:-1]))
    stacked = np.clip(bounds[None, :], lows[:, None], tops[:, None]) - lows[:, None]
    # A pixel that contains the boundary of two separated layers appears mixed in the profile.
    if np.abs(reached - stacked).max() <= 0.25 + _SEPARATED * height[-1]:
        return ()
    return tuple(tuple(column) for column in slices.T.tolist())


def _events(row: FloatArray, scenario: Scenario) -> tuple[tuple[str, float], ...]:
    return tuple((kind, float(x)) for kind, x in zip(scenario.safety_events, row, strict=True) if x > 0.0)


def _bench(camera: Camera, bench: Bench, experiments: Experiments, member: int, first: int, turn: bool) -> BenchPicture:
    """Return the picture of a bench whose vessels begin at position ``first`` of the shelf's arrays."""
    busy = bool(experiments.busy[member])
    vessels = [camera.take(member, first + p, name, experiments, p) for p, name in enumerate(bench.positions)]
    seen: list[ChannelPicture] = []
    if busy:
        observation = np.zeros((1, *bench.observation_space.shape), dtype=np.float32)
        bench.observe(camera.shelf, experiments, np.array([member]), observation)
        for channel, part in zip(bench.channels, channel_slices(bench.channels).values(), strict=True):
            if channel.name not in ("goal", *blank_channels(bench)):
                values = tuple(observation[0, part].tolist())
                seen.append(ChannelPicture(channel.name, channel.unit, channel.low, channel.high, values))
    return BenchPicture(
        agent=experiments.agent,
        key=bench.key,
        kind=bench.spec.kind,
        busy=busy,
        turn=turn,
        goal=bench.goals.names[experiments.goal[member]] if busy else "",
        step=int(experiments.steps[member]) if busy else 0,
        step_limit=bench.spec.step_limit,
        positions=bench.positions,
        vessels=tuple(vessel for vessel in vessels if vessel is not None),
        seen=tuple(seen),
        events=_events(experiments.events[member], bench.scenario),
    )


def _stock(scenario: Scenario, shelf: Shelf, member: int) -> tuple[BottlePicture, ...]:
    return tuple(
        BottlePicture(name, float(shelf.stock[member, shelf.layout.index(name)]), full)
        for name, full in scenario.stock.items()
    )


def _waste_l(shelf: Shelf, member: int) -> float:
    chem = shelf.known(member)
    return float(shelf.waste[member] @ (chem.molar_volume * (chem.role != ROLE_GAS)))


def laboratory_scene(laboratories: Laboratories, member: int = 0, camera: Camera | None = None) -> Scene:
    """Return the scene of one laboratory.

    Args:
        laboratories: laboratories after a reset; they are not changed.
        member: environment index.
        camera: camera of the laboratories' shelf, which reuses pictures of earlier scenes.
    """
    labs, state, scenario = laboratories, laboratories.state, laboratories.scenario
    camera = camera or Camera(scenario, labs.shelf)
    status = int(state.status[member])
    turn = labs.turn(member) if status == RUNNING else -1
    costs = labs.costs(member)
    largest, temperatures = camera.scales(labs.benches, member)
    return Scene(
        kind="laboratory",
        scenario=scenario.name,
        title=scenario.title,
        status=STATUS_WORDS[status],
        turn="" if turn < 0 else labs.agents[turn],
        manager_actions=int(state.actions[member]),
        manager_action_limit=scenario.limits.manager_actions,
        ticks=int(state.ticks[member]),
        tick_limit=scenario.limits.ticks,
        orders=_orders(labs, member),
        result=float(labs.result(np.array([member]))[0]),
        costs=tuple(zip(COST_WORDS, costs.values(), strict=True)),
        budget=scenario.limits.budget,
        safety=_events(labs.safety_totals[member], labs.scenario),
        stock=_stock(scenario, labs.shelf, member),
        waste_l=_waste_l(labs.shelf, member),
        shelf=tuple(_slot(labs, camera, member, s) for s in range(scenario.shelf.slots)),
        benches=tuple(
            _bench(camera, role.workplace, role.experiments, member, role.first_position, turn == role.index)
            for role in labs.bench_roles
        ),
        materials=material_pictures(scenario),
        largest_capacity_l=largest,
        temperature_range_k=temperatures,
    )


def _orders(labs: Laboratories, member: int) -> tuple[OrderPicture, ...]:
    state, feedback = labs.state, labs.feedback(member)
    pictures = []
    for o, goal in enumerate(state.goal[member]):
        terms: list[Any] = []
        if state.terms.shape[1]:
            arrives, within, *others = state.terms[member, o].tolist()
            terms = [math.ceil(arrives), math.floor(arrives + within), *others]
        filled, seen = bool(state.filled[member, o]), feedback[o].tolist()
        pictures.append(OrderPicture(labs.scenario.goals[goal], filled, *seen, *terms))
    return tuple(pictures)


def _slot(labs: Laboratories, camera: Camera, member: int, s: int) -> SlotPicture:
    state, table, scenario = labs.state, labs.instruments, labs.scenario
    vessel = camera.take(member, s, f"slot {s}")
    holder, kind = int(state.reserved[member, s]), int(state.last_bench[member, s])
    origin, readings = "", []
    if vessel is not None and kind > 0:
        bench = next(bench for bench in labs.benches if bench.key == list(scenario.benches)[kind - 1])
        role = f" {bench.positions[state.last_position[member, s]]}" if len(bench.positions) > 1 else ""
        origin = bench.key + role
    for i, name in enumerate(table.names):
        if vessel is not None and state.age[member, s, i] >= 0:
            channel, picture = table.channels[i], table.kinds[i].picture
            readings.append(
                ReadingPicture(
                    instrument=name,
                    kind=picture,
                    age=int(state.age[member, s, i]),
                    unit=channel.unit,
                    low=channel.low,
                    high=channel.high,
                    values=tuple(state.reading[member, s, table.start[i] : table.start[i + 1]].tolist()),
                    labels=(*table.analytes[i], table.kinds[i].rest) if picture == "bars" else (),
                )
            )
    return SlotPicture(s, vessel, labs.bench_agents[holder] if holder >= 0 else None, origin, tuple(readings))


def visible_scene(scene: Scene, scenario: Scenario) -> Scene:
    """Return a scene without properties that agents can only measure.

    Vessels keep their fill level, and at a bench the temperature and the camera picture that its agent observes. Fill
    levels, stock, waste and safety events have the resolution of the shelf. Orders that have not arrived are removed,
    too, and the result while agents do not know it. Without hidden parameters, nothing else is removed.

    Args:
        scene: scene with the true contents.
        scenario: scenario of the scene.
    """
    gauge, largest = scenario.shelf.gauge, scene.largest_capacity_l
    if scene.status == STATUS_WORDS[RUNNING] and (gauge or scenario.demand.feedback != 0.0):
        scene = dataclasses.replace(scene, result=math.nan)
    if not scenario.hides:
        return scene
    return dataclasses.replace(
        scene,
        orders=tuple(order for order in scene.orders if order.arrives <= scene.ticks),
        stock=tuple(
            dataclasses.replace(one, mol=shown_share(one.mol / (one.full_mol or 1.0), gauge) * one.full_mol)
            for one in scene.stock
        ),
        waste_l=_rounded(scene.waste_l, gauge * largest),
        safety=_visible_events(scene.safety, gauge),
        shelf=tuple(
            slot if slot.vessel is None else dataclasses.replace(slot, vessel=_opaque(slot.vessel, gauge, largest))
            for slot in scene.shelf
        ),
        benches=tuple(_visible_bench(bench, gauge, largest) for bench in scene.benches),
    )


def _rounded(value: float, resolution: float) -> float:
    """Return a value as a multiple of the resolution; 0: exactly."""
    return resolution * math.floor(value / resolution + 0.5) if resolution else value


def _visible_events(events: tuple[tuple[str, float], ...], gauge: float) -> tuple[tuple[str, float], ...]:
    """Return safety events with the resolution of the shelf, without those whose amount reads 0."""
    return tuple((kind, shown) for kind, amount in events if (shown := _rounded(amount, gauge)) > 0.0)


def _opaque(vessel: VesselPicture, gauge: float, largest_l: float) -> VesselPicture:
    """Return a vessel of which only the fill level is visible.

    Its capacity is rounded, too, because a piston may stop at the contents.
    """
    capacity = shown_share(vessel.capacity_l / largest_l, gauge) * largest_l
    volume = shown_share(vessel.volume_l / vessel.capacity_l, gauge) * capacity
    return dataclasses.replace(
        vessel,
        capacity_l=capacity,
        volume_l=volume,
        temperature_k=None,
        settling=1.0,
        layers=(LayerPicture("", "liquid", volume, _UNKNOWN),) if volume > 0.0 else (),
        mixture=(),
        contents=(),
        camera=(),
    )


def _visible_bench(bench: BenchPicture, gauge: float, largest_l: float) -> BenchPicture:
    """Return a bench with fill levels and, from its agent's first turn on, what the agent observes."""
    hidden = bench.busy and bench.step == 0 and not bench.turn
    seen = {} if hidden else {channel.name: channel for channel in bench.seen}
    vessels = []
    for vessel in bench.vessels:
        shown = _opaque(vessel, gauge, largest_l)
        if camera := seen.get(f"layers_{vessel.position}"):
            shown = dataclasses.replace(shown, camera=camera.values)
        if vessel.position == bench.positions[0] and (read := seen.get("temperature")):
            shown = dataclasses.replace(shown, temperature_k=read.low + read.values[0] * (read.high - read.low))
        vessels.append(shown)
    events = _visible_events(bench.events, gauge)
    return dataclasses.replace(bench, vessels=tuple(vessels), seen=tuple(seen.values()), events=events)


def bench_scene(batch: ExperimentBatch, member: int = 0) -> Scene:
    """Return the scene of one experiment on a single bench.

    Args:
        batch: batch of experiments of a :class:`chemlab.envs.role_env.RoleEnv` after a reset; it is not changed.
        member: environment index.
    """
    scenario, shelf, experiments = batch.scenario, batch.shelf, batch.experiments
    camera = Camera(scenario, shelf)
    picture = _bench(camera, batch.bench, experiments, member, 0, bool(experiments.busy[member]))
    largest, temperatures = camera.scales([batch.bench], member)
    return Scene(
        kind="bench",
        scenario=scenario.name,
        title=scenario.title,
        status="running" if picture.busy else "ended",
        turn=experiments.agent if picture.busy else "",
        ticks=int(experiments.steps[member]),
        tick_limit=batch.bench.spec.step_limit,
        orders=(OrderPicture(batch.bench.goals.names[experiments.goal[member]], False, 0.0, 0.0),),
        safety=picture.events,
        stock=_stock(scenario, shelf, member),
        waste_l=_waste_l(shelf, member),
        benches=(picture,),
        materials=material_pictures(scenario),
        largest_capacity_l=largest,
        temperature_range_k=temperatures,
    )


def vessel_scene(scenario: Scenario, shelf: Shelf) -> Scene:
    """Return the scene of a :class:`chemlab.sandbox.Flask`.

    Args:
        scenario: scenario whose materials are listed.
        shelf: shelf of the vessel; it is not changed.
    """
    camera = Camera(scenario, shelf)
    return Scene(
        kind="vessel",
        scenario=scenario.name,
        title=scenario.title,
        status="running",
        waste_l=_waste_l(shelf, 0),
        shelf=(SlotPicture(0, camera.take(0, 0, ""), None, "", ()),),
        materials=material_pictures(scenario),
        largest_capacity_l=shelf.vessel(0, 0).capacity_l,
        temperature_range_k=camera.scales([], 0)[1],
    )
