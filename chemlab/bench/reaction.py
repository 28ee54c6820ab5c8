"""The reaction bench (RxN): heat, compress, add reagents, let them react.

| Observation | Actions | Steps |
|---|---|---|
| spectrum 200, temperature, volume, pressure, n reagents left, goal | Box(n + 2) | step limit, 20 by default |
"""

from __future__ import annotations

from typing import Annotated, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ..physics.jit import helper, kernel
from ..physics.kinetics import react, react_work_size
from ..physics.partition import partition
from ..physics.phases import settle_phases
from ..physics.spectra import spectrum
from ..physics.thermal import pressure, seal, vent
from ..physics.transfer import liquid_volume, spill, volume
from ..scenario import Scenario
from ..shelf import (
    AIR,
    AMOUNTS,
    CAPACITY,
    CLOCK,
    T_MIX,
    TEMPERATURE,
    WAVELENGTHS_NM,
    Chemistry,
    FloatArray,
    IntArray,
    Layout,
    Network,
    Shelf,
    build_network,
    element_matrix,
)
from .base import (
    Bench,
    BoolArray,
    Channel,
    MaskArray,
    ObservationArray,
    Station,
    check_box,
    goal_amount,
    weighted_amount,
)
from .models import ReactionModel, checked_reaction

__all__ = ["ReactionBench", "ReactionOptions", "Span", "act"]

_FROZEN = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_FULLEST = 0.98
"""The piston stops where the contents would fill this share of the vessel."""


class Span(BaseModel):
    """A quantity the agent moves within [low, high], by at most ``step`` a step."""

    model_config = _FROZEN

    low: float = Field(gt=0.0)
    high: float = Field(gt=0.0)
    step: float = Field(gt=0.0)

    @model_validator(mode="after")
    def _ordered(self) -> Span:
        if self.high <= self.low:
            raise ValueError(f"high = {self.high} must be above low = {self.low}")
        return self


class ReactionOptions(BaseModel):
    """Scenario keys of a reaction bench."""

    model_config = _FROZEN

    reagents: dict[str, Annotated[float, Field(gt=0.0, le=1e4)]] = Field(min_length=1)
    """mol of each reagent an experiment may take from stock."""
    temperature_k: Span
    volume_l: Span
    vessel_volume_l: float = Field(default=1.0, gt=0.0)
    """Where the piston stands when an experiment begins and ends."""
    rated_pressure_kpa: float = Field(gt=0.0)
    tick: float = Field(gt=0.0)
    """Reaction time of one step, in the unit of the rate constants."""
    rtol: float = Field(default=1e-3, gt=0.0)
    atol: float = Field(default=1e-6, gt=0.0)
    penalty: dict[str, float] = Field(default_factory=dict)
    """Score lost per mol of a by-product, unless it is the goal itself."""


@helper
def _load(
    m: int,
    action: FloatArray,
    row: FloatArray,
    knobs: FloatArray,
    reagents: IntArray,
    supply: FloatArray,
    stock: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    chem: Chemistry,
) -> None:
    """Move the piston, add reagents, set the temperature (theirs too: the vessel has a thermostat).

    knobs: T low, high, step; V low, high, step; rated; dt;
    rtol; atol."""
    n = reagents.shape[0]
    temperature = row[TEMPERATURE] + (2.0 * action[0] - 1.0) * knobs[2]
    arriving = 0.0
    for i in range(n):
        arriving += action[2 + i] * min(supply[m, i], stock[m, reagents[i]]) * chem.molar_volume[reagents[i]]
    lowest = max(knobs[3], (volume(row, chem) + arriving) / _FULLEST)
    row[CAPACITY] = min(max(row[CAPACITY] + (2.0 * action[1] - 1.0) * knobs[5], lowest), knobs[4])
    for i in range(n):
        mol = action[2 + i] * min(supply[m, i], stock[m, reagents[i]])
        supply[m, i] -= mol
        stock[m, reagents[i]] -= mol
        row[AMOUNTS + reagents[i]] += mol
    spill(row, chem, waste[m], events[m])
    row[TEMPERATURE] = min(max(temperature, knobs[0]), knobs[1])


@helper
def _settle(
    m: int, row: FloatArray, knobs: FloatArray, waste: FloatArray, events: FloatArray, chem: Chemistry, work: FloatArray
) -> None:
    """After the reaction: phases, stirred contents, relief valve."""
    settle_phases(row, chem, waste[m], events[m], work[0])
    row[CLOCK] = T_MIX
    partition(row, chem, work)
    vent(row, knobs[6], chem, waste[m], events[m])


@kernel
def _before(
    members: IntArray,
    actions: FloatArray,
    places: IntArray,
    rows: FloatArray,
    knobs: FloatArray,
    reagents: IntArray,
    supply: FloatArray,
    stock: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    chem: Chemistry,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        events[m, :] = 0.0
        _load(m, actions[b], rows[places[m, 0]], knobs, reagents, supply, stock, waste, events, chem)


@kernel
def _after(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    knobs: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    steps: IntArray,
    ended: BoolArray,
    limit: int,
    chem: Chemistry,
    work: FloatArray,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        _settle(m, rows[places[m, 0]], knobs, waste, events, chem, work)
        steps[m] += 1
        ended[m] = steps[m] >= limit


@kernel
def act(
    members: IntArray,
    actions: FloatArray,
    places: IntArray,
    rows: FloatArray,
    knobs: FloatArray,
    reagents: IntArray,
    supply: FloatArray,
    stock: FloatArray,
    waste: FloatArray,
    events: FloatArray,
    steps: IntArray,
    ended: BoolArray,
    limit: int,
    chem: Chemistry,
    network: Network,
    scratch: FloatArray,
    work: FloatArray,
) -> None:
    """One step of every member with the built-in kinetics: load, react, settle (see ReactionBench.act)."""
    for b in range(members.shape[0]):
        m = members[b]
        row = rows[places[m, 0]]
        events[m, :] = 0.0
        _load(m, actions[b], row, knobs, reagents, supply, stock, waste, events, chem)
        react(row, network, liquid_volume(row, chem), row[TEMPERATURE], knobs[7], knobs[8], knobs[9], scratch)
        _settle(m, row, knobs, waste, events, chem, work)
        steps[m] += 1
        ended[m] = steps[m] >= limit


@kernel
def _observe(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    busy: BoolArray,
    goal: IntArray,
    supply: FloatArray,
    stock: FloatArray,
    reagents: IntArray,
    full: FloatArray,
    knobs: FloatArray,
    scale: float,
    chem: Chemistry,
    work: FloatArray,
    out: ObservationArray,
) -> None:
    size = chem.basis.shape[1]
    light = work[0, :size]
    for b in range(members.shape[0]):
        m = members[b]
        out[b, :] = 0.0
        if not busy[m]:
            continue
        row = rows[places[m, 0]]
        spectrum(row, chem, light)
        for w in range(size):
            out[b, w] = light[w]
        out[b, size] = min(max((row[TEMPERATURE] - knobs[0]) / (knobs[1] - knobs[0]), 0.0), 1.0)
        out[b, size + 1] = min(max((row[CAPACITY] - knobs[3]) / (knobs[4] - knobs[3]), 0.0), 1.0)
        out[b, size + 2] = min(pressure(row, chem) / scale, 1.0)
        for i in range(reagents.shape[0]):
            left = min(supply[m, i], stock[m, reagents[i]])
            out[b, size + 3 + i] = min(max(left / full[i], 0.0), 1.0)
        out[b, size + 3 + reagents.shape[0] + goal[m]] = 1.0


@kernel
def _measure(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    goal: IntArray,
    parts: IntArray,
    penalty: FloatArray,
    out: FloatArray,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        row = rows[places[m, 0]]
        out[b] = goal_amount(row, parts[goal[m]]) - weighted_amount(row, penalty[goal[m]])


@kernel
def _seal(members: IntArray, places: IntArray, rows: FloatArray, capacity: float, chem: Chemistry) -> None:
    for b in range(members.shape[0]):
        row = rows[places[members[b], 0]]
        row[CAPACITY] = max(capacity, volume(row, chem) / _FULLEST)
        seal(row, chem)


class ReactionBench(Bench):
    """Reaction bench.

    **Actions** - ``Box(0, 1, (n + 2,))``: temperature down/up, piston in/out (0.5 = no change, each step at most the
    scenario's ``step``), then for each of n reagents the fraction of what is left of it to add.

    **Observation** - 200 absorptions of the UV-Vis spectrum; temperature, volume and pressure scaled to their ranges
    (pressure: 0 to 1.25 x the rated pressure); the fraction left of each reagent's supply; the goal's one-hot.

    **Reward** at the end - mol of the goal produced, minus the scenario's penalties on by-products.
    """

    options_model = ReactionOptions
    kernels = (act,)
    scratch_names = ("work", "_scratch")
    score_meaning = "mol of the goal produced"

    def __init__(self, key: str, scenario: Scenario, layout: Layout, chemistry: Chemistry) -> None:
        super().__init__(key, scenario, layout, chemistry)
        options: ReactionOptions = self.options
        self.reaction_model: ReactionModel | None = None
        """Replaces the built-in kinetics where set."""
        self.network = build_network(scenario)
        self.reagent_names = tuple(options.reagents)
        self.reagents = len(options.reagents)
        self._reagent_index = np.array([self.material(name, "reagents") for name in options.reagents], dtype=np.int64)
        self._full = np.array(list(options.reagents.values()))
        t, v = options.temperature_k, options.volume_l
        self._knobs = np.array(
            [
                t.low,
                t.high,
                t.step,
                v.low,
                v.high,
                v.step,
                options.rated_pressure_kpa,
                options.tick,
                options.rtol,
                options.atol,
            ]
        )
        self._pressure_scale = 1.25 * options.rated_pressure_kpa
        self._scratch = np.zeros(react_work_size(self.network))
        self._elements = element_matrix(scenario)
        self._penalty = np.zeros((len(self.goals.names), len(layout.materials)))
        for name, price in options.penalty.items():
            for g, goal in enumerate(self.goals.names):
                if goal != name:
                    self._penalty[g, self.material(name, "penalty")] = price
        channels = (
            Channel("spectrum", len(WAVELENGTHS_NM), "absorption", 0.0, 1.0, "UV-Vis absorption, 200 to 800 nm"),
            Channel("temperature", 1, "K", t.low, t.high, "temperature of the contents"),
            Channel("volume", 1, "L", v.low, v.high, "volume the piston leaves"),
            Channel("pressure", 1, "kPa", 0.0, self._pressure_scale, "pressure in the sealed vessel"),
            Channel(
                "reagents", self.reagents, "fraction", 0.0, 1.0, "left of the supply: " + ", ".join(self.reagent_names)
            ),
        )
        self._set_spaces(channels, gymnasium.spaces.Box(0.0, 1.0, (self.reagents + 2,), np.float32))

    @property
    def action_meanings(self) -> list[str]:
        t, v = self.options.temperature_k.step, self.options.volume_l.step
        return [
            f"temperature: 0 = {t:g} K down, 0.5 = hold, 1 = {t:g} K up",
            f"volume: 0 = {v:g} L in, 0.5 = hold, 1 = {v:g} L out",
            *(f"add this fraction of the {name} that is left" for name in self.reagent_names),
        ]

    def prepare(self, shelf: Shelf, station: Station, members: IntArray) -> None:
        station.supply[members] = self._full
        _seal(members, station.places, shelf.rows, self.options.vessel_volume_l, self.chemistry)

    def release(self, shelf: Shelf, station: Station, members: IntArray) -> None:
        _seal(members, station.places, shelf.rows, self.options.vessel_volume_l, self.chemistry)
        shelf.rows[station.places[members, 0], AIR] = 0.0

    def measure(self, shelf: Shelf, station: Station, members: IntArray) -> FloatArray:
        out = np.empty(len(members))
        _measure(members, station.places, shelf.rows, station.goal, self.goals.parts, self._penalty, out)
        return out

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        return check_box(agent, action, self.reagents + 2)[None]

    def act(self, shelf: Shelf, station: Station, members: IntArray, actions: npt.NDArray[Any]) -> None:
        s, chem, limit = station, self.chemistry, self.step_limit
        args = (s.places, shelf.rows, self._knobs, self._reagent_index, s.supply, shelf.stock, shelf.waste, s.events)
        if self.reaction_model is None:
            act(members, actions, *args, s.steps, s.ended, limit, chem, self.network, self._scratch, self.work)
            return
        _before(members, actions, *args, chem)
        for place in station.places[members, 0]:
            row = shelf.rows[place]
            amounts = row[AMOUNTS : AMOUNTS + len(self.layout.materials)]
            amounts[:] = checked_reaction(
                self.reaction_model,
                amounts,
                float(row[TEMPERATURE]),
                liquid_volume(row, chem),
                self.options.tick,
                self._elements,
            )
        _after(
            members, s.places, shelf.rows, self._knobs, shelf.waste, s.events, s.steps, s.ended, limit, chem, self.work
        )

    def observe(self, shelf: Shelf, station: Station, members: IntArray, out: ObservationArray) -> None:
        s = station
        _observe(
            members,
            s.places,
            shelf.rows,
            s.busy,
            s.goal,
            s.supply,
            shelf.stock,
            self._reagent_index,
            self._full,
            self._knobs,
            self._pressure_scale,
            self.chemistry,
            self.work,
            out,
        )

    def mask(self, shelf: Shelf, station: Station, members: IntArray, out: MaskArray) -> None:
        """Continuous actions have no mask."""
