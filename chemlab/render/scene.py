"""What a picture of a laboratory shows, as plain data: read off the arrays, which stay as they are.

A :class:`Scene` is what people see, true contents included; of these, agents see what ``BenchPicture.seen`` and
``SlotPicture.readings`` say. Pictures and pages are drawn from it alone, so ``as_dict()`` is all a replay has to keep.

Layers are in true proportions. ``VesselPicture.layers`` lists them from the bottom up with their volumes; what is above
them is air. Where the contents are not separated, ``VesselPicture.mixture`` has the share of every liquid in equal
slices of the liquid, bottom first: the profile the layer camera draws from, with its air taken out to the top. So the
fill level and every liquid's volume are true in a stirred vessel, too, where the camera itself sees air at all heights.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, IntArray
from ..lab.engine import Laboratories
from ..lab.experiments import ExperimentBatch
from ..physics.chemistry import AMOUNTS, ROLE_GAS, ROLE_ION, ROLE_SOLID
from ..physics.constants import FIRST_PHASE, SOLIDS
from ..physics.layers import profile
from ..physics.shelf import Shelf
from ..roles.bench import CAMERA_PIXELS, Bench, Experiments
from ..roles.manager_state import COST_ITEMS, RUNNING, STATUS_WORDS

__all__ = [
    "MIXTURE_SLICES",
    "BenchPicture",
    "BottlePicture",
    "ChannelPicture",
    "LayerPicture",
    "MaterialPicture",
    "OrderPicture",
    "ReadingPicture",
    "Scene",
    "SlotPicture",
    "VesselPicture",
    "bench_scene",
    "laboratory_scene",
    "material_pictures",
    "vessel_scene",
]

MIXTURE_SLICES = 40
_SEPARATED = 1e-3
"""A profile that is nowhere farther than this from the stacked layers is shown as these."""
_SHOWN_MOL = 5e-6
"""Below this a material does not count as contents."""


@dataclass(frozen=True)
class MaterialPicture:
    """A line of the legend: colours are the materials' own (for colour-blind eyes, too), tags are unique."""

    name: str
    tag: str
    """at most 4 letters that stand for it in a picture"""
    color: str
    """#rrggbb"""
    role: str


@dataclass(frozen=True)
class LayerPicture:
    """One layer of a vessel."""

    material: str
    """the solvent, or what the layer consists of"""
    phase: str
    """``solid`` (at the bottom) or ``liquid``"""
    volume_l: float
    """with what is dissolved in it"""
    color: str


@dataclass(frozen=True)
class VesselPicture:
    """A vessel and its contents."""

    position: str
    """``slot 3`` on the shelf, the position's name (``main``, ``EV``, ``B1``) on a bench"""
    capacity_l: float
    volume_l: float
    """of the contents without air"""
    temperature_k: float
    settling: float
    """0 when fully mixed, 1 when separated"""
    layers: tuple[LayerPicture, ...]
    """bottom first: solids, then liquids, densest first"""
    mixture: tuple[tuple[float, ...], ...]
    """[MIXTURE_SLICES][liquid layers] shares, bottom first; empty where the layers stand as they are listed"""
    contents: tuple[tuple[str, float], ...]
    """(material, mol) of everything in it: hidden from agents"""
    camera: tuple[float, ...]
    """grey values the bench's camera saw last, bottom first; empty without a camera"""


@dataclass(frozen=True)
class ReadingPicture:
    """The last reading of an instrument on a vessel of the shelf."""

    instrument: str
    kind: str
    age: int
    """ticks ago"""
    unit: str
    low: float
    high: float
    values: tuple[float, ...]
    """in [0, 1], which stand for [low, high]"""
    labels: tuple[str, ...]
    """what each value is about: a chromatograph's materials and the rest; empty for other instruments"""


@dataclass(frozen=True)
class SlotPicture:
    """A place on the shelf: a vessel, a reservation for a bench's vessels, or neither."""

    slot: int
    vessel: VesselPicture | None
    reserved_for: str | None
    """bench agent"""
    origin: str
    """where the vessel has been, ``ext EV`` (or just ``rxn``, of one vessel); empty if nowhere"""
    readings: tuple[ReadingPicture, ...]


@dataclass(frozen=True)
class ChannelPicture:
    """A part of what a bench's agent sees: ``values`` in [0, 1], which stand for [low, high] ``unit``."""

    name: str
    unit: str
    low: float
    high: float
    values: tuple[float, ...]


@dataclass(frozen=True)
class BenchPicture:
    """A bench: what runs on it, its vessels, what its agent sees."""

    agent: str
    key: str
    kind: str
    busy: bool
    turn: bool
    """whether its agent has the turn"""
    goal: str
    """of the experiment; empty where none runs"""
    step: int
    step_limit: int
    positions: tuple[str, ...]
    vessels: tuple[VesselPicture, ...]
    """those that stand there"""
    seen: tuple[ChannelPicture, ...]
    """the observation by channels, without the goal; empty where no experiment runs"""
    events: tuple[tuple[str, float], ...]
    """safety events of its last action, by kind"""


@dataclass(frozen=True)
class OrderPicture:
    """What the laboratory is to make."""

    goal: str
    filled: bool
    submitted_mol: float
    purity: float


@dataclass(frozen=True)
class BottlePicture:
    """What is left of a material in stock."""

    material: str
    mol: float
    full_mol: float


@dataclass(frozen=True)
class Scene:
    """A laboratory, or a single bench (``kind``), at one moment; see the module's documentation."""

    kind: str
    """``laboratory``, ``bench`` or ``vessel``; a bench has no shelf, orders, costs or manager, a single vessel no
    bench either"""
    scenario: str
    title: str
    status: str
    """``running``, ``submitted`` or ``limit reached``; of a bench ``running`` or ``ended``"""
    turn: str
    """agent that has the turn; empty when it is over"""
    manager_actions: int
    manager_action_limit: int
    ticks: int
    tick_limit: int
    orders: tuple[OrderPicture, ...]
    result: float
    """manager's score if it ended now: orders filled so far, minus costs"""
    costs: tuple[tuple[str, float], ...]
    """(item, units of the score)"""
    budget: float
    """what the manager may spend on measuring"""
    safety: tuple[tuple[str, float], ...]
    """(kind, total) of the safety events that have happened"""
    stock: tuple[BottlePicture, ...]
    waste_l: float
    shelf: tuple[SlotPicture, ...]
    benches: tuple[BenchPicture, ...]
    materials: tuple[MaterialPicture, ...]
    """all that can occur in the scenario, without gases"""
    largest_capacity_l: float
    """no vessel of the scenario is larger, at any time: the scale of all vessels"""
    temperature_range_k: tuple[float, float]
    """the scale of all thermometers"""

    def as_dict(self, digits: int = 5) -> dict[str, Any]:
        """The fields as lists, dicts, strings and numbers (for JSON), floats rounded to significant ``digits``."""
        plain: dict[str, Any] = _plain(self, digits)
        return plain


def _plain(value: Any, digits: int) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, tuple):
        return [_plain(item, digits) for item in value]
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name), digits) for field in dataclasses.fields(value)}
    return value


def _tags(names: Iterable[str]) -> dict[str, str]:
    """A short unique tag for every name: itself if short, else the initials of its parts, longer where taken."""
    tags: dict[str, str] = {}
    for name in sorted(names, key=len):
        parts = re.findall(r"\d|[A-Za-z]+", name) or [name]
        initials = "".join(part[0].upper() for part in parts)
        options = [name] if len(name) <= 4 else []
        options += [initials[:4], *((initials[:-1] + parts[-1][:n].capitalize())[:4] for n in range(2, 5))]
        options += [f"{initials[:2]}{n}" for n in range(2, 100)]
        tags[name] = next(option for option in options if option not in tags.values())
    return tags


@functools.lru_cache(maxsize=32)
def material_pictures(scenario: Scenario) -> tuple[MaterialPicture, ...]:
    """The scenario's materials without gases, in the scenario's order."""
    shown = {name: material for name, material in scenario.materials.items() if material.role != "gas"}
    tags = _tags(shown)
    return tuple(MaterialPicture(name, tags[name], m.color.lower(), m.role) for name, m in shown.items())


class _Camera:
    """Pictures of the vessels of one shelf; holds the scratch arrays."""

    def __init__(self, scenario: Scenario, shelf: Shelf) -> None:
        self.shelf, self.known = shelf, shelf.known()
        columns = shelf.layout.fluid_columns
        self.colors = [material.color.lower() for material in scenario.materials.values()]
        self._layers: IntArray = np.zeros(columns + 1, dtype=np.int64)
        self._shares: FloatArray = np.zeros((columns, CAMERA_PIXELS))
        self._work: FloatArray = np.zeros((columns + 9, max(columns + 1, CAMERA_PIXELS)))

    def take(
        self, member: int, place: int, position: str, experiments: Experiments | None = None, role: int = 0
    ) -> VesselPicture | None:
        """The vessel at ``place`` of a laboratory, vessel number ``role`` of ``experiments``; None if none is."""
        vessel = self.shelf.vessel(member, place)
        if not vessel.present:
            return None
        image: FloatArray = np.zeros(0)
        if experiments is not None and hasattr(experiments, "image") and experiments.layers[member, role, 0] > 0:
            # The bench's own layers: a separation model may have made them.
            layers, shares, image = (
                experiments.layers[member, role],
                experiments.profile[member, role],
                experiments.image[member, role],
            )
        else:
            layers, shares = self._layers, self._shares
            profile(vessel.row, self.shelf.chem(), layers, shares, self._work)
        volume, amounts = vessel.volume_l, vessel.amounts(_SHOWN_MOL)
        listed, mixture = self._layered(vessel.row, amounts, layers, shares, max(vessel.capacity_l, volume))
        return VesselPicture(
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

    def _layered(
        self, row: FloatArray, amounts: dict[str, float], layers: IntArray, shares: FloatArray, total_l: float
    ) -> tuple[list[LayerPicture], tuple[tuple[float, ...], ...]]:
        """Layers bottom first, and the mixture of the liquids if they are not separated."""
        names, chem = self.shelf.layout.materials, self.known
        count = int(layers[0])
        columns = shares[:count]
        volumes = columns.sum(axis=1) * (total_l / columns.shape[1])
        kinds = layers[1 : 1 + count]
        liquids = [c for c in range(count) if kinds[c] != SOLIDS and kinds[c] != chem.air and volumes[c] > 0.0]
        listed = []
        if kinds[0] == SOLIDS and volumes[0] > 0.0:
            solids = []
            for name, mol in amounts.items():
                i = names.index(name)
                # Without a solvent ions are a crust of salt.
                if self.shelf.layout.most_layers and chem.dissolved_at[i] >= 0:
                    mol = max(mol - float(self._dissolved(row)[chem.dissolved_at[i]].sum()), 0.0)  # its crystals
                elif chem.role[i] != ROLE_SOLID and (chem.role[i] != ROLE_ION or self._wet(kinds)):
                    continue
                if mol > _SHOWN_MOL:
                    solids.append((float(chem.density[i]), i, mol * float(chem.molar_volume[i])))
            listed = [self._layer(i, "solid", v) for _, i, v in sorted(solids, reverse=True)]
        listed += [self._liquid(row, int(kinds[c]), float(volumes[c])) for c in liquids]
        return listed, _mixture(columns[liquids]) if len(liquids) > 1 else ()

    def _dissolved(self, row: FloatArray) -> FloatArray:
        """[K, L] mol of what dissolves, in each solvent or phase."""
        layout = self.shelf.layout
        return row[AMOUNTS + len(layout.materials) :].reshape(len(layout.dissolved), -1)

    def _liquid(self, row: FloatArray, kind: int, volume_l: float) -> LayerPicture:
        """A layer of one liquid; or of a phase, in the colour of what it holds, by volume."""
        if kind > FIRST_PHASE:
            return self._layer(kind, "liquid", volume_l)
        phase = FIRST_PHASE - kind
        litres = self._dissolved(row)[:, phase] * self.known.molar_volume[self.known.dissolved]
        colors = np.array([list(bytes.fromhex(self.colors[i][1:])) for i in self.known.dissolved])
        mixed = litres @ colors / max(litres.sum(), 1e-300)
        color = "#" + bytes(np.rint(mixed).astype(np.uint8).tolist()).hex()
        return LayerPicture(self.shelf.layout.solvents[phase], "liquid", volume_l, color)

    def _wet(self, kinds: IntArray) -> bool:
        return bool(np.isin(kinds, self.known.solvents).any())

    def _layer(self, material: int, phase: str, volume_l: float) -> LayerPicture:
        return LayerPicture(self.shelf.layout.materials[material], phase, volume_l, self.colors[material])


def _mixture(shares: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Shares [liquids, pixels] of the vessel's height as shares of equal slices of the liquid, or () if separated."""
    # Cumulative volume of each liquid over the cumulative volume of all of them, read off at the slices' bounds.
    height = np.concatenate(([0.0], np.cumsum(shares.sum(axis=0))))
    bounds = np.linspace(0.0, height[-1], MIXTURE_SLICES + 1)
    reached = np.array([np.interp(bounds, height, np.concatenate(([0.0], np.cumsum(row)))) for row in shares])
    slices = np.diff(reached, axis=1) / (height[-1] / MIXTURE_SLICES)
    tops = np.cumsum(shares.sum(axis=1))
    lows = np.concatenate(([0.0], tops[:-1]))
    stacked = np.clip(bounds[None, :], lows[:, None], tops[:, None]) - lows[:, None]
    # One pixel in which two layers meet is mixed in the profile, though the layers are separated.
    if np.abs(reached - stacked).max() <= 0.25 + _SEPARATED * height[-1]:
        return ()
    return tuple(tuple(column) for column in slices.T.tolist())


def _seen(bench: Bench, observation: Any) -> tuple[ChannelPicture, ...]:
    pictures, start = [], 0
    for channel in bench.channels:
        values = observation[start : start + channel.size]
        start += channel.size
        if channel.name != "goal":
            pictures.append(
                ChannelPicture(channel.name, channel.unit, channel.low, channel.high, tuple(values.tolist()))
            )
    return tuple(pictures)


def _events(row: FloatArray, scenario: Scenario) -> tuple[tuple[str, float], ...]:
    return tuple((kind, float(x)) for kind, x in zip(scenario.safety_events, row, strict=True) if x > 0.0)


def _bench(
    camera: _Camera, bench: Bench, experiments: Experiments, member: int, places: Sequence[int], turn: bool
) -> BenchPicture:
    busy = bool(experiments.busy[member])
    vessels = [camera.take(member, places[p], name, experiments, p) for p, name in enumerate(bench.positions)]
    seen: tuple[ChannelPicture, ...] = ()
    if busy:
        observation = np.zeros((1, *bench.observation_space.shape), dtype=np.float32)
        bench.observe(camera.shelf, experiments, np.array([member]), observation)
        seen = _seen(bench, observation[0])
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
        seen=seen,
        events=_events(experiments.events[member], bench.scenario),
    )


def _ranges(
    scenario: Scenario, benches: Iterable[Bench], shelf: Shelf, member: int
) -> tuple[float, tuple[float, float]]:
    """(largest capacity, temperature range): the scales of an episode's pictures, from the scenario."""
    ambient = scenario.ambient_temperature_k
    capacities = [vessel.capacity_l for vessel in scenario.shelf.vessel]
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
    capacities += [shelf.vessel(member, p).capacity_l for p in range(shelf.vessels.shape[1])]
    return max(capacities), (low, high)


def _stock(scenario: Scenario, shelf: Shelf, member: int) -> tuple[BottlePicture, ...]:
    return tuple(
        BottlePicture(name, float(shelf.stock[member, shelf.layout.index(name)]), full)
        for name, full in scenario.stock.items()
    )


def _waste_l(shelf: Shelf, member: int) -> float:
    chem = shelf.known(member)
    return float(shelf.waste[member] @ (chem.molar_volume * (chem.role != ROLE_GAS)))


def laboratory_scene(laboratories: Laboratories, member: int = 0) -> Scene:
    """The scene of one laboratory.

    Args:
        laboratories: the laboratories, after a reset; nothing in them changes.
        member: which one.
    """
    labs, state, scenario = laboratories, laboratories.state, laboratories.scenario
    camera = _Camera(scenario, labs.shelf)
    status, turn = int(state.status[member]), labs.turn(member)
    running = status == RUNNING
    slots = scenario.shelf.slots
    costs = labs.costs(member)
    result = float(labs.result(np.array([member]))[0])
    largest, temperatures = _ranges(scenario, labs.benches, labs.shelf, member)
    return Scene(
        kind="laboratory",
        scenario=scenario.name,
        title=scenario.title,
        status=STATUS_WORDS[status],
        turn=labs.agents[turn] if running else "",
        manager_actions=int(state.actions[member]),
        manager_action_limit=scenario.limits.manager_actions,
        ticks=int(state.ticks[member]),
        tick_limit=scenario.limits.ticks,
        orders=tuple(
            OrderPicture(
                scenario.goals[goal],
                bool(state.filled[member, o]),
                float(state.submitted[member, o, 0]),
                float(state.submitted[member, o, 1]),
            )
            for o, goal in enumerate(state.goal[member])
        ),
        result=result,
        costs=tuple((item, float(costs[item])) for item in COST_ITEMS),
        budget=scenario.limits.budget,
        safety=_events(labs.safety_totals[member], labs.scenario),
        stock=_stock(scenario, labs.shelf, member),
        waste_l=_waste_l(labs.shelf, member),
        shelf=tuple(_slot(labs, camera, member, s) for s in range(slots)),
        benches=tuple(
            _bench(
                camera,
                bench,
                experiments,
                member,
                range(first, first + len(bench.positions)),
                running and turn == b + 1,
            )
            for b, (bench, experiments, first) in enumerate(
                zip(labs.benches, labs.experiments, labs.rules.first.tolist(), strict=True)
            )
        ),
        materials=material_pictures(scenario),
        largest_capacity_l=largest,
        temperature_range_k=temperatures,
    )


def _slot(labs: Laboratories, camera: _Camera, member: int, s: int) -> SlotPicture:
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


def bench_scene(batch: ExperimentBatch, member: int = 0) -> Scene:
    """The scene of one experiment on a single bench (of a :class:`chemlab.envs.bench_env.BenchEnv`'s batch).

    Args:
        batch: the experiments, after a reset; nothing in them changes.
        member: which one.
    """
    scenario, shelf, experiments = batch.scenario, batch.shelf, batch.experiments
    picture = _bench(
        _Camera(scenario, shelf),
        batch.bench,
        experiments,
        member,
        range(len(batch.bench.positions)),
        bool(experiments.busy[member]),
    )
    largest, temperatures = _ranges(scenario, [batch.bench], shelf, member)
    return Scene(
        kind="bench",
        scenario=scenario.name,
        title=scenario.title,
        status="running" if picture.busy else "ended",
        turn=experiments.agent if picture.busy else "",
        manager_actions=0,
        manager_action_limit=0,
        ticks=int(experiments.steps[member]),
        tick_limit=batch.bench.spec.step_limit,
        orders=(OrderPicture(batch.bench.goals.names[experiments.goal[member]], False, 0.0, 0.0),),
        result=0.0,
        costs=(),
        budget=0.0,
        safety=picture.events,
        stock=_stock(scenario, shelf, member),
        waste_l=_waste_l(shelf, member),
        shelf=(),
        benches=(picture,),
        materials=material_pictures(scenario),
        largest_capacity_l=largest,
        temperature_range_k=temperatures,
    )


def vessel_scene(scenario: Scenario, shelf: Shelf, member: int = 0, place: int = 0) -> Scene:
    """The scene of a single vessel (of a :class:`chemlab.sandbox.Flask`); nothing in it changes.

    Args:
        scenario: whose materials there are.
        shelf: where the vessel stands.
        member, place: laboratory and position.
    """
    vessel = _Camera(scenario, shelf).take(member, place, "")
    _, temperatures = _ranges(scenario, [], shelf, member)
    return Scene(
        kind="vessel",
        scenario=scenario.name,
        title=scenario.title,
        status="running",
        turn="",
        manager_actions=0,
        manager_action_limit=0,
        ticks=0,
        tick_limit=0,
        orders=(),
        result=0.0,
        costs=(),
        budget=0.0,
        safety=(),
        stock=(),
        waste_l=_waste_l(shelf, member),
        shelf=(SlotPicture(place, vessel, None, "", ()),),
        benches=(),
        materials=material_pictures(scenario),
        largest_capacity_l=shelf.vessel(member, place).capacity_l,
        temperature_range_k=temperatures,
    )
