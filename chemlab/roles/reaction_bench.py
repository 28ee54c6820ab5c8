"""The reaction bench (RxN): heat, compress, add reagents, let them react.

| Observation | Actions | Steps |
|---|---|---|
| spectrum 200, temperature, volume, pressure, n reagents left, goal | Box(n + 2) | step limit, 20 by default |
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from ..config.datamodel import DataModel
from ..config.materials import COLDEST_K, HOTTEST_K
from ..config.scenario import Scenario
from ..kernels.arrays import Field as Array
from ..kernels.arrays import FloatArray, Handle, IntArray, MaskArray, ObservationArray, merged
from ..kernels.jit import helper, inner, kernel, opened
from ..physics.backends import most_steps, partition, react, settle_phases, vent
from ..physics.chemistry import (
    AIR,
    AMOUNTS,
    CAPACITY,
    CLOCK,
    TEMPERATURE,
    WAVELENGTHS_NM,
    Chemistry,
    ChemistryTable,
    element_matrix,
)
from ..physics.shelf import T_MIX, Shelf, ShelfArrays
from ..physics.spectra import spectrum
from ..physics.surroundings import Surroundings
from ..physics.thermal import pressure, seal_vessel
from ..physics.transfer import heat_capacity, liquid_volume, spill, volume, within_range
from .base import VESSEL_TEMPERATURES_K, Quantity
from .bench import (
    HEAT,
    STIR,
    Bench,
    BenchRules,
    Channel,
    Experiments,
    ExperimentState,
    check_box,
    goal_amount,
    on_scale,
    weighted_amount,
)
from .models import checked_reaction

_OPEN = "no effect: the vessel is open"
_FULLEST = 0.98
"""Share of the vessel that the contents may fill at most when the piston moves in."""
_WHOLE, _FIRST, _LAST = range(3)
"""Parts of a step: all of it, the part before the reaction, the part after it."""


class Span(DataModel):
    """A quantity that the agent moves within [low, high], by at most ``step`` per step."""

    low: float = Field(gt=0.0, le=1e4)
    high: float = Field(gt=0.0, le=1e4)
    step: float = Field(gt=0.0, le=1e4)

    @model_validator(mode="after")
    def _ordered(self) -> Span:
        if self.high <= self.low:
            raise ValueError(f"high = {self.high} must be above low = {self.low}")
        return self


class TemperatureSpan(Span):
    """A temperature that the agent moves, in K."""

    low: float = Field(ge=COLDEST_K, le=HOTTEST_K)
    high: float = Field(ge=COLDEST_K, le=HOTTEST_K)


class ReactionOptions(DataModel):
    """Scenario keys of a reaction bench."""

    reagents: dict[str, Annotated[float, Field(gt=0.0, le=1e4)]] = Field(min_length=1, max_length=100)
    """Maximum mol of each reagent that an experiment takes from stock."""
    temperature_k: TemperatureSpan
    volume_l: Span
    vessel_volume_l: float = Field(default=1.0, gt=0.0, le=100.0)
    """Piston position in L at the start and end of an experiment."""
    rated_pressure_kpa: float = Field(gt=0.0, le=1e6)
    tick: float = Field(gt=0.0, le=1e6)
    """Reaction time of one step, in the unit of the rate constants."""
    jacket_w_k: float | None = Field(default=None, gt=0.0, le=1e4)
    """Heat transfer between contents and jacket in W/K; the agent sets and observes the jacket's temperature.

    It needs the physics backend ``real``. Without it, the contents have the temperature that the agent sets.
    """
    condenser_w: float | None = Field(default=None, gt=0.0, le=1e6)
    """Cooling power of a reflux condenser in W, through which the vessel is open.

    The contents boil at their boiling point, and vapour beyond this power is lost (physics backend ``real``). Without
    it, the vessel is sealed.
    """
    rtol: float = Field(default=1e-3, ge=1e-12, le=0.1)
    atol: float = Field(default=1e-6, ge=1e-15, le=0.1)
    penalty: dict[str, Annotated[float, Field(ge=-1e4, le=1e4)]] = Field(default_factory=dict, max_length=100)
    """Score lost per mol of a by-product, unless it is the goal itself."""


class SupplyState(NamedTuple):
    """State of a reaction bench's experiments. N laboratories, Q reagents."""

    supply: Annotated[FloatArray, Array("N Q")]
    """[N, Q] remaining mol of each reagent that the experiment may take"""
    jacket: Annotated[FloatArray, Array("N")]
    """[N] K, jacket temperature"""


class ReactorRules(NamedTuple):
    """Static parameters of a reaction bench. Q reagents, G goals, M materials."""

    coldest: Annotated[float, Array("")]
    """K; bounds of the temperatures, and their changes per step"""
    hottest: Annotated[float, Array("")]
    temperature_step: Annotated[float, Array("")]
    smallest: Annotated[float, Array("")]
    """L; bounds of the volume, and its change per step"""
    largest: Annotated[float, Array("")]
    volume_step: Annotated[float, Array("")]
    vessel_volume: Annotated[float, Array("")]
    """L, piston position at the start and end of an experiment"""
    rated_pressure: Annotated[float, Array("")]
    """rated pressure in kPa"""
    pressure_scale: Annotated[float, Array("")]
    """kPa at a reading of 1 of the pressure gauge"""
    tick: Annotated[float, Array("")]
    """reaction time of a step"""
    transfer: Annotated[float, Array("")]
    """heat transfer in W/K between contents and jacket; below 0: the contents have the jacket's temperature"""
    condenser: Annotated[float, Array("")]
    """cooling power of a reflux condenser in W; below 0: the vessel is sealed"""
    rtol: Annotated[float, Array("")]
    atol: Annotated[float, Array("")]
    """mol/L"""
    reagents: Annotated[IntArray, Array("Q")]
    """[Q] material indices"""
    full: Annotated[FloatArray, Array("Q")]
    """[Q] maximum mol per experiment"""
    penalty: Annotated[FloatArray, Array("G M")]
    """[G, M] score lost per mol, by goal"""


ReactionState: Any = merged(ExperimentState, SupplyState)
ReactionRules: Any = merged(BenchRules, ReactorRules)


@helper
def _load(m: int, action: FloatArray, state: Any, rules: Any, shelf: ShelfArrays, chem: Handle) -> None:
    """Move the piston, add reagents and set the temperature, which a thermostat also gives to the reagents."""
    row = shelf.rows[state.places[m, 0]]
    state.events[m, :] = 0.0
    jacketed = rules.transfer >= 0.0
    temperature = state.jacket[m] if jacketed else row[TEMPERATURE]
    step = rules.temperature_step if jacketed else rules.temperature_step * state.gain[m, HEAT]
    temperature += (2.0 * action[0] - 1.0) * step
    chemistry = opened(Chemistry, chem)
    molar_volume = chemistry.molar_volume
    before = heat_capacity(row, chem) if jacketed else 0.0
    arriving = 0.0
    for i in range(rules.reagents.shape[0]):
        material = rules.reagents[i]
        arriving += action[2 + i] * min(state.supply[m, i], shelf.stock[m, material]) * molar_volume[material]
    lowest = max(rules.smallest, (volume(row, chem) + arriving) / _FULLEST)
    row[CAPACITY] = min(max(row[CAPACITY] + (2.0 * action[1] - 1.0) * rules.volume_step, lowest), rules.largest)
    for i in range(rules.reagents.shape[0]):
        material = rules.reagents[i]
        mol = action[2 + i] * min(state.supply[m, i], shelf.stock[m, material])
        state.supply[m, i] -= mol
        shelf.stock[m, material] -= mol
        share = chemistry.bottle_share[material]
        row[AMOUNTS + material] += share * mol
        if share < 1.0:
            rest = chemistry.bottle_rest[material]
            row[AMOUNTS + rest] += (1.0 - share) * mol * molar_volume[material] / molar_volume[rest]
    temperature = min(max(temperature, rules.coldest), rules.hottest)
    if jacketed:
        state.jacket[m] = temperature
        after = heat_capacity(row, chem)
        if after > 0.0:
            ambient = chemistry.ambient_temperature
            row[TEMPERATURE] = within_range(ambient + (row[TEMPERATURE] - ambient) * before / after)
    spill(row, chem, shelf.waste[m], state.events[m])
    if not jacketed:
        row[TEMPERATURE] = temperature


@inner
def _react(m: int, state: Any, rules: Any, shelf: ShelfArrays, chem: Handle) -> int:
    """React for one tick; return a negative number if the reactions are too stiff."""
    row = shelf.rows[state.places[m, 0]]
    jacket = state.jacket[m] if rules.transfer >= 0.0 else row[TEMPERATURE]
    around = Surroundings(jacket, rules.transfer * state.gain[m, HEAT], rules.condenser, rules.rtol, rules.atol)
    tick = rules.tick * state.gain[m, STIR]
    return react(row, tick, around, chem, shelf.waste[m], state.events[m], rules.work)


@helper
def _conclude(m: int, state: Any, rules: Any, shelf: ShelfArrays, chem: Handle) -> None:
    """Update phases, stirring and relief valve after the reaction."""
    row = shelf.rows[state.places[m, 0]]
    settle_phases(row, chem, shelf.waste[m], state.events[m], rules.work)
    spill(row, chem, shelf.waste[m], state.events[m])  # reactions change the volume
    row[CLOCK] = T_MIX
    partition(row, chem, rules.work)
    if rules.condenser < 0.0:
        vent(row, rules.rated_pressure, chem, shelf.waste[m], state.events[m])
    state.steps[m] += 1
    state.ended[m] = state.steps[m] >= rules.step_limit


@kernel
def _step(
    members: IntArray,
    actions: FloatArray,
    part: int,
    experiment: Handle,
    bench: Handle,
    shelf: Handle,
    chemistry: Handle,
) -> int:
    """Step every member: load, react by the built-in kinetics, conclude; or do the first or the last of these alone.

    Returns:
        The last member in which the reactions were too stiff, -1 if none.
    """
    state, rules, arrays = opened(ReactionState, experiment), opened(ReactionRules, bench), opened(ShelfArrays, shelf)
    stiff = -1
    for b in range(members.shape[0]):
        m = members[b]
        chem = chemistry[arrays.variant[m]]
        if part != _LAST:
            _load(m, actions[b], state, rules, arrays, chem)
        if part == _WHOLE and _react(m, state, rules, arrays, chem) < 0:
            stiff = m
        if part != _FIRST:
            _conclude(m, state, rules, arrays, chem)
    return stiff


@kernel
def _observe(
    members: IntArray, experiment: Handle, bench: Handle, shelf: Handle, chemistry: Handle, out: ObservationArray
) -> None:
    """Write spectrum, gauges, remaining supply and goal."""
    state, rules, arrays = opened(ReactionState, experiment), opened(ReactionRules, bench), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m = members[b]
        if not state.busy[m]:
            out[b, :] = 0.0
            continue
        chem = chemistry[arrays.variant[m]]
        row = arrays.rows[state.places[m, 0]]
        at = opened(Chemistry, chem).basis.shape[1]
        light = rules.work[0, :at]
        spectrum(row, chem, light)
        for w in range(at):
            out[b, w] = light[w]
        out[b, at] = on_scale(row[TEMPERATURE], rules.coldest, rules.hottest)
        out[b, at + 1] = on_scale(row[CAPACITY], rules.smallest, rules.largest)
        out[b, at + 2] = on_scale(pressure(row, chem), 0.0, rules.pressure_scale)
        at += 3
        for i in range(rules.reagents.shape[0]):
            left = min(state.supply[m, i], arrays.stock[m, rules.reagents[i]])
            out[b, at] = on_scale(left, 0.0, rules.full[i])
            at += 1
        if rules.transfer >= 0.0:
            out[b, at] = on_scale(state.jacket[m], rules.coldest, rules.hottest)
            at += 1
        out[b, at:] = 0.0
        out[b, at + state.goal[m]] = 1.0


@kernel
def _measure(members: IntArray, experiment: Handle, bench: Handle, shelf: Handle, out: FloatArray) -> None:
    state, rules, arrays = opened(ReactionState, experiment), opened(ReactionRules, bench), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m = members[b]
        row, goal = arrays.rows[state.places[m, 0]], state.goal[m]
        out[b] = goal_amount(row, rules.parts[goal]) - weighted_amount(row, rules.penalty[goal])


@kernel
def _seal(members: IntArray, experiment: Handle, bench: Handle, shelf: Handle, chemistry: Handle) -> None:
    state, rules, arrays = opened(ReactionState, experiment), opened(ReactionRules, bench), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        chem = chemistry[arrays.variant[members[b]]]
        row = arrays.rows[state.places[members[b], 0]]
        row[CAPACITY] = max(rules.vessel_volume, volume(row, chem) / _FULLEST)
        if rules.transfer >= 0.0:
            state.jacket[members[b]] = min(max(row[TEMPERATURE], rules.coldest), rules.hottest)
        if rules.condenser < 0.0:
            seal_vessel(row, chem)


class ReactionBench(Bench):
    """Reaction bench.

    **Actions** - ``Box(0, 1, (n + 2,))``: temperature (of the jacket, if there is one) down/up, piston in/out (0.5 = no
    change, each step at most the scenario's ``step``), then for each of n reagents the share of its
    remaining supply to add.

    **Observation** - 200 absorptions of the UV-Vis spectrum; temperature, volume and pressure scaled to their ranges
    (pressure: 0 to 1.25 x the rated pressure); the remaining share of each reagent's supply; the goal's one-hot.

    **Reward** at the end - mol of the goal produced, minus the scenario's penalties on by-products.
    """

    model_methods = ("__call__",)
    options_model = ReactionOptions
    own_state = (SupplyState,)
    own_rules = (ReactorRules,)
    score_meaning = "mol of the goal produced"

    def __init__(self, key: str, scenario: Scenario, chemistry: ChemistryTable) -> None:
        super().__init__(key, scenario, chemistry)
        options: ReactionOptions = self.options
        self.reagent_names = tuple(options.reagents)
        self.reagents = len(options.reagents)
        self._full = np.array(list(options.reagents.values()))
        t, v = options.temperature_k, options.volume_l
        self._pressure_scale = 1.25 * options.rated_pressure_kpa
        self._elements = element_matrix(scenario)
        place, pushes = "volume the piston leaves", "pressure in the sealed vessel"
        if options.condenser_w is not None:
            place, pushes = _OPEN, "vapour pressure of the contents (open through a condenser)"
        channels = (
            Channel("spectrum", len(WAVELENGTHS_NM), "absorption", 0.0, 1.0, "UV-Vis absorption, 200 to 800 nm"),
            Channel("temperature", 1, "K", t.low, t.high, "temperature of the contents"),
            Channel("volume", 1, "L", v.low, v.high, place),
            Channel("pressure", 1, "kPa", 0.0, self._pressure_scale, pushes),
            Channel(
                "reagents", self.reagents, "fraction", 0.0, 1.0, "left of the supply: " + ", ".join(self.reagent_names)
            ),
            *([Channel("jacket", 1, "K", t.low, t.high, "temperature of the jacket")] if options.jacket_w_k else []),
        )
        self._set_spaces(channels, gymnasium.spaces.Box(0.0, 1.0, (self.reagents + 2,), np.float32))

    @property
    def action_meanings(self) -> list[str]:
        t, v = self.options.temperature_k.step, self.options.volume_l.step
        jacket = "" if self.options.jacket_w_k is None else " of the jacket"
        opened_up = self.options.condenser_w is not None
        return [
            f"temperature{jacket}: 0 = {t:g} K down, 0.5 = hold, 1 = {t:g} K up",
            f"volume: {_OPEN if opened_up else f'0 = {v:g} L in, 0.5 = hold, 1 = {v:g} L out'}",
            *(f"add this fraction of the {name} that is left" for name in self.reagent_names),
        ]

    def representative_actions(self) -> list[tuple[str, FloatArray]]:
        """Return each control separately, and combinations on the route to a goal; see the method of :class:`Bench`."""
        t, v, names = self.options.temperature_k.step, self.options.volume_l.step, self.reagent_names
        rest = np.array([0.5, 0.5, *(0.0 for _ in names)])
        gauges = {f"{t:g} K down": (0, 0.0), f"{t / 4:g} K down": (0, 0.375), f"{t / 4:g} K up": (0, 0.625)}
        gauges |= {f"{t:g} K up": (0, 1.0), f"{v:g} L in": (1, 0.0), f"{v:g} L out": (1, 1.0)}
        moves = {"": rest}
        for words, (i, number) in gauges.items():
            moves[words] = rest.copy()
            moves[words][i] = number
        ways = [(words, row) for words, row in moves.items() if words]
        for i, name in enumerate(names):
            for share, words in ((0.25, f"add a quarter of the {name} that is left"), (1.0, f"add all {name}")):
                row = rest.copy()
                row[2 + i] = share
                ways.append((words, row))
        family = self.scenario.family
        needed = [[name in family.towards(goal) for name in names] for goal in self.goals.names]
        for which in dict.fromkeys(tuple(row) for row in needed):
            adding = ", ".join(name for name, wanted in zip(names, which, strict=True) if wanted)
            for words in ("", f"{t:g} K up", f"{v:g} L out"):
                row = moves[words].copy()
                row[2:] = which
                if sum(which) > 1 or (sum(which) == 1 and words):
                    ways.append((f"add all {adding}{': ' if words else ''}{words}", row))
        return [*ways, ("hold", rest)]

    def state_sizes(self, members: int, positions: int) -> dict[str, int]:
        return {**super().state_sizes(members, positions), "Q": self.reagents, "W": self.layout.width}

    def rules_values(self) -> dict[str, Any]:
        options: ReactionOptions = self.options
        t, v = options.temperature_k, options.volume_l
        penalty = np.zeros((len(self.goals.names), len(self.layout.materials)))
        for name, price in options.penalty.items():
            for g, goal in enumerate(self.goals.names):
                if goal != name:
                    penalty[g, self.material(name, "penalty")] = price
        return {
            "coldest": t.low,
            "hottest": t.high,
            "temperature_step": t.step,
            "smallest": v.low,
            "largest": v.high,
            "volume_step": v.step,
            "vessel_volume": options.vessel_volume_l,
            "rated_pressure": options.rated_pressure_kpa,
            "pressure_scale": self._pressure_scale,
            "tick": options.tick,
            "transfer": -1.0 if options.jacket_w_k is None else options.jacket_w_k,
            "condenser": -1.0 if options.condenser_w is None else options.condenser_w,
            "rtol": options.rtol,
            "atol": options.atol,
            "reagents": np.array([self.material(name, "reagents") for name in options.reagents], dtype=np.int64),
            "full": self._full,
            "penalty": penalty,
        }

    def prepare(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:
        experiments.supply[members] = self._full
        _seal(members, *self._handles(shelf, experiments))

    def release(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:
        _seal(members, *self._handles(shelf, experiments))
        shelf.rows[experiments.places[members, 0], AIR] = 0.0

    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        out = np.empty(len(members))
        _measure(members, experiments.handle, self.rules.handle, shelf.handle, out)
        return out

    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        return check_box(agent, action, self.reagents + 2)[None]

    def act(self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]) -> None:
        handles = self._handles(shelf, experiments)
        if self.model is None:
            stiff = _step(members, actions, _WHOLE, *handles)
            if stiff >= 0:
                raise ArithmeticError(
                    f"{experiments.agent}: the reactions of laboratory {stiff} at "
                    f"{shelf.rows[experiments.places[stiff, 0], TEMPERATURE]:.1f} K are too stiff: more than "
                    f"{most_steps(self.chemistry):,} steps for a tick of {self.options.tick:g}. Its tick has "
                    f"ended early; give the scenario a shorter benches.{self.key}.tick, or smaller rate constants"
                )
            return
        _step(members, actions, _FIRST, *handles)
        for m in members.tolist():
            row = shelf.rows[experiments.places[m, 0]]
            amounts = row[AMOUNTS : AMOUNTS + len(self.layout.materials)]
            amounts[:] = checked_reaction(
                self.model,
                self._model_name,
                amounts,
                float(row[TEMPERATURE]),
                liquid_volume(row, shelf.chem(m)),
                self.options.tick * float(experiments.gain[m, STIR]),
                self._elements,
            )
        _step(members, actions, _LAST, *handles)

    def memory(self, experiments: Experiments, members: IntArray) -> list[Quantity]:
        busy = experiments.busy[members][:, None]
        supply = experiments.supply[members] / np.maximum(self.rules.arrays.full, 1e-12) * busy
        parts = [Quantity("supply", "fraction", "left of the supply, by reagent", supply)]
        if self.options.jacket_w_k is not None:
            jacket = experiments.jacket[members][:, None] * busy
            parts.append(Quantity("jacket", "K", "temperature of the jacket", jacket, high=VESSEL_TEMPERATURES_K[1]))
        return [*parts, *super().memory(experiments, members)]

    def action_words(self, action: Any) -> str:
        if self.action_count:
            return super().action_words(action)
        values = [float(value) for value in action]
        words = [
            f"{label} {'up' if value > 0.5 else 'down'} {abs(2.0 * value - 1.0):.0%}"
            for label, value in zip(("temperature", "volume"), values, strict=False)
            if abs(value - 0.5) > 5e-3
        ]
        added = zip(self.reagent_names, values[2:], strict=True)
        words += [f"add {value:.0%} of the {name} left" for name, value in added if value > 5e-3]
        return ", ".join(words) or "hold"

    def see(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: ObservationArray) -> None:
        _observe(members, *self._handles(shelf, experiments), out)

    def mask(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: MaskArray) -> None:
        """Do nothing: continuous actions have no mask."""
