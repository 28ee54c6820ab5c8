"""Scenarios: everything a laboratory is set up with, as one typed, frozen value loaded from TOML.

All numbers a researcher might vary (stock, vessels, action tables, prices, limits, reward mix) live in
the file; types and bounds live here. A bench's own settings are checked by that bench's options model.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from .datafile import read_toml
from .datamodel import validated
from .draws import Split, WorldSpec
from .inherit import shipped_file
from .materials import Material
from .pairs import Pair
from .reactions import ReactionFamily

__all__ = [
    "MANAGER_AGENT",
    "PHYSICS_TIERS",
    "REWARD_MIXES",
    "SAFETY_EVENTS",
    "BenchSpec",
    "Companion",
    "CostSpec",
    "DemandSpec",
    "DriftSpec",
    "GradeSpec",
    "InstrumentSpec",
    "LimitSpec",
    "ManagerSpec",
    "OrderSpec",
    "OrderTerms",
    "RealSpec",
    "RewardSpec",
    "SafetySpec",
    "Scenario",
    "Settings",
    "ShelfSpec",
    "StartSpec",
    "VesselSpec",
    "WearSpec",
]

MANAGER_AGENT = "manager_0"
"""Name of the manager."""

SAFETY_EVENTS: tuple[str, ...] = ("spill_l", "relief_valve_mol", "boiled_dry", "dry_heating", "metal_in_water_mol")
"""Kinds of safety event, with their units: litres spilled, moles of vapour lost through the relief valve,
times a vessel boiled dry, times heat went into a vessel without liquid, moles of metal that met water."""

PHYSICS_TIERS: dict[str, str] = {"paper": "chemlab.physics.backends.paper", "real": "chemlab.physics.backends.real"}
"""Tiers of physical laws that a scenario may name, with the module of each (see :mod:`chemlab.physics.backends`)."""

_DATA = Path(__file__).resolve().parent.parent / "data"
_FROZEN = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_MOST_STARTS = 20_000

_MOST_VESSEL_TICKS = 1_000_000
"""That may pass within one action of the manager, which nothing interrupts: seconds, as a vessel at rest takes up to 10
us for a tick."""

Key = Annotated[str, Field(min_length=1, max_length=100)]
Mol = Annotated[float, Field(ge=0.0, le=1e4)]

Amounts = Annotated[dict[Key, Mol], Field(max_length=100)]
"""Moles, or prices of a mole, by material."""

Maximum = Annotated[float, Field(ge=1e-6, le=1e4)]

Price = Annotated[float, Field(ge=0.0, le=1e6)]
"""In units of the score."""

Capacity = Annotated[float, Field(ge=1e-6, le=100.0)]
Goals = Annotated[tuple[Key, ...], Field(min_length=1, max_length=64)]
Parts = Annotated[tuple[Annotated[str, Field(max_length=1000)], ...], Field(max_length=32)]
Share = Annotated[float, Field(ge=-1e6, le=1e6)]


class VesselSpec(BaseModel):
    """A vessel that stands on the shelf when an episode begins."""

    model_config = _FROZEN

    capacity_l: Capacity
    """Volume up to the rim; what is more runs over (a spill)."""
    contents: Amounts = {}
    """Moles of each material."""


class ShelfSpec(BaseModel):
    """The shared shelf: a number of slots and what stands in the first of them."""

    model_config = _FROZEN

    slots: int = Field(ge=1, le=64)
    """Places for vessels."""
    vessel: tuple[VesselSpec, ...] = ()
    """What stands in the first slots, in order; the others are empty. One at least: the manager's actions are about
    vessels."""
    gauge: float = Field(default=0.0, ge=0.0, le=0.5)
    """Step of the marks that the manager reads a vessel's fill level by, as a share of its capacity; 0: exactly."""
    tick: float = Field(default=0.0, ge=0.0, le=1e6)
    """Reaction time of a tick for vessels at rest, in the unit of the rate constants: what they hold goes on reacting
    at the temperature of the room (physics ``paper``; with ``real`` it always does). 0: nothing reacts on the shelf."""

    @model_validator(mode="after")
    def _fits(self) -> ShelfSpec:
        if not self.vessel:
            raise ValueError("vessel: give at least one [[shelf.vessel]]: without a vessel no action is possible")
        if len(self.vessel) > self.slots:
            raise ValueError(f"vessel: {len(self.vessel)} vessels do not fit on {self.slots} slots")
        return self


class Companion(BaseModel):
    """A further material of a starting state: ``if_goal`` replaces ``material`` where that is the goal itself."""

    model_config = _FROZEN

    material: Key
    """What may be there besides."""
    mol: float = Field(gt=0.0, le=1e4)
    """How much of it."""
    probability: float = Field(default=1.0, ge=0.0, le=1.0)
    """Of its being there, drawn each episode."""
    if_goal: Key
    """What is there instead in experiments for ``material`` itself."""


class StartSpec(BaseModel):
    """The paper's fixed starting state of a single-bench episode."""

    model_config = _FROZEN

    capacity_l: Capacity = 1.0
    """Volume of the vessel up to the rim."""
    contents: Amounts = {}
    """Moles of each material."""
    goal_mol: Mol = 0.0
    """Moles of the experiment's goal, besides."""
    companion: Companion | None = None
    """A further material that may be there."""


class WearSpec(BaseModel):
    """How a bench's apparatus errs, wears and breaks. Agents are told when it is broken, and nothing else."""

    model_config = _FROZEN

    actuator: Literal["stir", "heat"] = "stir"
    """What is at stake: ``stir``, the share of a tick in which a reaction bench's contents react (and take up heat), or
    of a shaking that counts; ``heat``, the share of the heat asked for that arrives: of a heating mantle's kJ, of a
    jacket's W/K, or of a thermostat's step."""
    gain: float = Field(default=1.0, ge=0.01, le=100.0)
    """What that is multiplied by (from 0.01 to 100) where the bench is new or repaired: the median; 1 is right."""
    spread: float = Field(default=0.0, ge=0.0, le=3.0)
    """Standard deviation of its natural logarithm then."""
    drift: float = Field(default=0.0, ge=0.0, le=3.0)
    """Standard deviation of what its logarithm changes by in a tick of work (a random walk)."""
    life: float = Field(default=0.0, ge=0.0, le=1e6)
    """Mean number of ticks of work until it breaks, which is as likely in every tick; 0: it never does."""
    repair_price: Price = 0.0
    """What a repair costs, in units of the score: with it the gain and the life are drawn anew."""
    repair_ticks: int = Field(default=0, ge=0, le=1_000_000)
    """Ticks until it can be used again."""


class BenchSpec(BaseModel):
    """One kind of bench: how many there are, how long an experiment may take, and the bench's own options.

    Keys that are not listed here go to the options model of the bench ``kind``, which refuses unknown ones. What a file
    leaves out is what ``chemlab/data/benches`` has for the kind, if it has it.
    """

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)

    kind: str = Field(min_length=1, max_length=200)
    """``reaction``, ``extraction``, ``distillation``, ``crystallization``, or yours, ``my_bench.py:Class``."""
    count: int = Field(default=1, ge=1, le=16)
    """How many of this kind, each with an agent of its own."""
    step_limit: int = Field(ge=1, le=10_000)
    """Steps after which an experiment is over."""
    observe: Parts = ()
    """Observation channels of your own, ``my_parts.py:NAME`` each, after the bench's."""
    reward: Parts = ()
    """Reward terms of your own, ``my_parts.py:NAME`` each, added to what every action earns."""
    actions: Literal["native", "discrete"] = "native"
    """``native``: as the bench's kind has them; ``discrete``: where those are continuous, a choice among some."""
    model: Annotated[str, Field(max_length=1000)] | None = None
    """Physics of your own in place of the bench's, ``my_parts.py:NAME`` (:mod:`chemlab.roles.models`)."""
    wear: WearSpec | None = None
    """How its apparatus errs, drifts and breaks; none: it does as it is told. The manager may have it repaired."""
    report: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard deviation of what the bench's own sensors say of an experiment when it ends, on the scale from 0 to 1:
    mol of the goal, its purity, ticks taken. The manager sees it without paying; left out: nothing is said."""
    start: StartSpec = StartSpec()
    """Where an experiment of the single bench starts (``starts="paper"``); not used in a laboratory."""


class DriftSpec(BaseModel):
    """How an instrument's zero goes astray, and what it takes to set it right."""

    model_config = _FROZEN

    first: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of what every value of the (0 to 1) reading is off by when an episode begins."""
    walk: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of what every value goes off by in a tick (a random walk, each value's its own)."""
    trend: float = Field(default=0.0, ge=-1.0, le=1.0)
    """What every value goes off by in a tick, always the same."""
    price: Price = 0.0
    """What a calibration costs, in units of the score."""
    error: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of what every value is off by after one."""


class InstrumentSpec(BaseModel):
    """An entry of the characterization bench. A reading is gain x what is there + bias + noise, on the scale from 0 to
    1 of its channel."""

    model_config = _FROZEN

    kind: Key
    """``uv_vis``, ``layer_camera``, ``balance``, ``gas_chromatograph``, ``thermometer``, ``density_meter``,
    ``karl_fischer``, ``hplc``; with physics ``real`` ``ph_meter`` and ``melting_point``; or one of your own,
    ``my_parts.py:NAME``."""
    price: Price = 0.0
    """Cost of one use, in units of the score."""
    sample_fraction: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Fraction of the vessel's contents that one use consumes (it goes to waste)."""
    noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of Gaussian noise on every value of the (0 to 1) reading."""
    detection_limit: float = Field(default=0.0, ge=0.0, le=1.0)
    """Below it a value of the (0 to 1) reading, noise included, is 0."""
    gain: float = Field(default=1.0, ge=0.0, le=100.0)
    """Calibration: what every value is multiplied by; 1 is right."""
    bias: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Calibration: what is added to every value of the (0 to 1) reading; 0 is right."""
    drift: DriftSpec | None = None
    """How it goes astray besides; none: it does not. The manager may then have it calibrated."""


class LimitSpec(BaseModel):
    """Limits of an episode; it terminates when it reaches one."""

    model_config = _FROZEN

    manager_actions: int = Field(ge=1, le=100_000)
    """Actions of the manager."""
    ticks: int = Field(ge=1, le=1_000_000)
    """Ticks of laboratory time, in which every busy bench makes one step."""
    budget: float = Field(default=1.0, gt=0.0, le=1e6)
    """What the manager may spend on measuring and calibrating, in units of the score; what is dearer is masked."""


class CostSpec(BaseModel):
    """Prices in units of the score (1 = the theoretical maximum of the product, pure)."""

    model_config = _FROZEN

    stock_per_mol: Amounts = {}
    """Price of a mole taken from a bottle, by material."""
    waste_per_l: Price = 0.0
    """Price of a litre of waste; gas costs nothing."""
    tick: Price = 0.0
    """Price of a tick."""
    illegal_action: Price = 0.0
    """Taken off the reward of an agent that plays a masked action, which loses its turn."""


class SafetySpec(BaseModel):
    """Weights of safety events in ``info["cost"]``, and what a unit of that cost takes off the reward."""

    model_config = _FROZEN

    weights: dict[Key, Price]
    """Weight of each kind of event in the cost."""
    events: dict[Key, str] = Field(default={}, max_length=32)
    """Kinds of event of your own, with what they mean; a bench or operation of your own says when they happen."""
    reward_price: Price = 0.0
    """Taken off the agent's reward for each unit of that cost."""

    @model_validator(mode="after")
    def _known(self) -> SafetySpec:
        for key in self.weights:
            if key not in (*SAFETY_EVENTS, *self.events):
                raise ValueError(
                    f"weights.{key}: unknown safety event; known: {', '.join((*SAFETY_EVENTS, *self.events))}; "
                    "declare your own under safety.events"
                )
        return self


class RewardSpec(BaseModel):
    """Each agent's reward = local * own + team * the manager's result.

    A scenario gives the numbers, or the name of one of :data:`REWARD_MIXES`.
    """

    model_config = _FROZEN

    bench_local: Share = 1.0
    """Share of a bench's agent in what its own experiments come to."""
    bench_team: Share = 0.0
    """Its share in the manager's result."""
    manager_local: Share = 1.0
    """The manager's share in its result."""
    manager_team: Share = 0.0
    """Its share in the same: its own result is the team's, so that the two add up."""


REWARD_MIXES: dict[str, RewardSpec] = {
    name: RewardSpec(**numbers) for name, numbers in read_toml(_DATA / "rewards.toml").items()
}
"""Reward mixes by name, from ``data/rewards.toml``."""


def _reward_mix(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    if given not in REWARD_MIXES:
        raise ValueError(f"unknown reward mix {given!r}; known: {', '.join(REWARD_MIXES)}; or give the numbers")
    return REWARD_MIXES[given]


class Settings(TypedDict, total=False):
    """Keywords of :meth:`Scenario.configured`, which every environment takes."""

    rewards: str | RewardSpec | Mapping[str, float] | None
    split: str | None
    actions: str | None


class OrderSpec(BaseModel):
    """What a submission has to be: one that falls short of it is worth nothing."""

    model_config = _FROZEN

    purity_at_least: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of the goal in the vessel."""
    amount_at_least_mol: Mol = 0.0
    """Moles of the goal."""
    purity_among: tuple[Key, ...] = Field(default=(), max_length=64)
    """Materials that purity is the goal's share of, as in a chromatogram of products, which sees neither solvent nor
    salt; the score counts that purity, too. Empty: everything in the vessel."""


class OrderTerms(OrderSpec):
    """When an order comes, what it asks for, and what it pays."""

    arrives: float = Field(default=0.0, ge=0.0, le=1e6)
    """Tick at which the manager hears of it; before that nothing can be submitted for it."""
    within: float | None = Field(default=None, ge=0.0, le=1e6)
    """Ticks from then on in which a submission is in time; left out: as long as the episode lasts."""
    price: float = Field(default=1.0, ge=0.0, le=1e3)
    """What it pays when it is met, in shares of the score that are the same for every order."""


class GradeSpec(OrderSpec):
    """What the manager may ask of an experiment besides its goal. Its agent sees it, and earns nothing for what falls
    short of it."""

    ticks: int | None = Field(default=None, ge=1, le=10_000)
    """Ticks that the experiment may take; left out: the bench's step limit."""


class DemandSpec(BaseModel):
    """Orders that come over time, each with terms of its own. An order pays its price for a submission that is in time
    and as it was asked for, whatever is above that; the score is the mean over the orders, less all costs."""

    model_config = _FROZEN

    order: tuple[OrderTerms, ...] = Field(default=(), max_length=16)
    """Terms of every order; nothing: all orders are there from the beginning, and are paid by amount and purity."""
    late: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of its price that an order pays for a submission that is late. Where that is nothing, the episode is over
    once no order can pay any more."""
    short: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of its price that an order pays for a submission that has less of the goal, or less pure, than was asked
    for; nothing where it has none of it."""


class ManagerSpec(BaseModel):
    """What the manager sees and earns otherwise than every manager does."""

    model_config = _FROZEN

    observe: Parts = ()
    """Observation channels of your own, ``my_parts.py:NAME`` each, after the manager's."""
    readings: tuple[Key, ...] | None = Field(default=None, max_length=32)
    """Instruments whose readings stand in its observation, for each slot; left out: all. Of the others it sees how old
    the last reading is and no more, so that spectra and pictures need not make it wide."""
    reward: Parts = ()
    """Reward terms of your own, ``my_parts.py:NAME`` each, added to what every action earns."""


class RealSpec(BaseModel):
    """What only ``physics = "real"`` reads."""

    model_config = _FROZEN

    tick_s: float = Field(default=60.0, gt=0.0, le=1e6)
    """Seconds that a tick of laboratory time takes."""
    room_transfer_w_k_l: float = Field(default=0.5, ge=0.0, le=1e4)
    """Heat that a litre of contents exchanges with the room, W/K: a flask in still air."""
    crystal_rate: float = Field(default=2e-3, gt=0.0, le=1e3)
    """1/s, at which a slurry approaches saturation."""
    metastable: float = Field(default=1.3, ge=1.0, le=100.0)
    """Ratio to saturation up to which a solution without crystals stays clear."""


class Scenario(BaseModel):
    """A laboratory as data; see the files under ``scenarios/`` for commented examples.

    ``materials`` and ``family`` are resolved at load: only what can occur in this scenario is kept.
    """

    model_config = _FROZEN

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=100)
    """By which commands and records call it."""
    title: str = Field(max_length=300)
    """One line for lists."""
    summary: str
    """A paragraph for its page."""
    physics: str = "paper"
    """Tier of physical laws, one of :data:`PHYSICS_TIERS`."""
    reactions: str
    """Reaction family: a shipped one's name, or the path of a file, from the scenario's folder."""
    material_files: tuple[str, ...] = Field(default=(), max_length=20)
    """Files with materials of your own, from the scenario's folder."""
    pair_files: tuple[str, ...] = Field(default=(), max_length=20)
    """Files with activity coefficients of your own pairs of liquids, from the scenario's folder (physics ``real``)."""
    real: RealSpec = RealSpec()
    """What only ``physics = "real"`` reads."""
    goals: Goals
    """Materials an experiment may be run for, in the order of every one-hot goal."""
    lab_goals: Goals
    """The goal of each order is drawn from these, uniformly, each episode."""
    orders: int = Field(default=1, ge=1, le=16)
    """Vessels the manager has to submit; each is worth an equal share of the score."""
    theoretical_maximum_mol: dict[Key, Maximum]
    """Most moles of each laboratory goal that stock, shelf and kinetics allow, divided among the orders."""
    ambient_temperature_k: float = Field(default=298.15, ge=200.0, le=350.0)
    """Temperature at which vessels and bottles stand."""
    ambient_pressure_kpa: float = Field(default=101.325, ge=1.0, le=1000.0)
    """Pressure outside the vessels."""
    stock: Amounts = {}
    """Moles in the reagent and solvent bottles, shared by all benches."""
    shelf: ShelfSpec
    """The shared shelf of vessels."""
    manager: ManagerSpec = ManagerSpec()
    """Parts of your own for the manager."""
    benches: dict[Key, BenchSpec] = Field(min_length=1, max_length=16)
    """Kinds of benches by key; a bench's agents are called after it (``rxn_0``)."""
    instruments: dict[Key, InstrumentSpec] = Field(default={}, max_length=32)
    """The characterization bench, by name."""
    limits: LimitSpec
    """When an episode ends without the last submission."""
    costs: CostSpec = CostSpec()
    """What is taken off the score."""
    safety: SafetySpec = SafetySpec(weights=dict.fromkeys(SAFETY_EVENTS, 1.0))
    """What events cost."""
    rewards: Annotated[RewardSpec, BeforeValidator(_reward_mix)] = RewardSpec()
    """How rewards are shared; numbers, or a mix's name."""
    specifications: dict[Key, OrderSpec] = Field(default={}, max_length=64)
    """What submissions for a laboratory goal have to be at least."""
    grades: dict[Key, GradeSpec] = Field(default={}, max_length=16)
    """What the manager may ask of an experiment besides its goal, by name: it starts one for a goal and a grade."""
    demand: DemandSpec = DemandSpec()
    """Orders that come over time, with deadlines, prices and terms of their own."""
    world: WorldSpec = WorldSpec()
    """What is drawn for an episode and not told."""

    _materials: dict[str, Material] = PrivateAttr(default_factory=dict)
    _family: ReactionFamily = PrivateAttr(default_factory=lambda: ReactionFamily(name="none"))
    _pairs: dict[frozenset[str], Pair] = PrivateAttr(default_factory=dict)
    _split: Split = PrivateAttr(default_factory=lambda: Split.of("train"))
    _origin: str = PrivateAttr(default="(scenario built in code)")

    @field_validator("physics")
    @classmethod
    def _known_tier(cls, tier: str) -> str:
        if tier not in PHYSICS_TIERS:
            raise ValueError(f"unknown backend; choose from {', '.join(PHYSICS_TIERS)}")
        return tier

    @model_validator(mode="after")
    def _sound(self) -> Scenario:
        for key in self.benches:
            if not re.fullmatch("[a-z]+", key) or key == "manager":
                raise ValueError(f"benches.{key}: a bench's key is lower-case letters, and manager is taken")
        starts = len(self.bench_agents()) * self.shelf.slots * len(self.goals) * max(len(self.grades), 1)
        if starts > _MOST_STARTS:
            raise ValueError(
                f"benches x slots x goals x grades: the manager could start {starts}; at most {_MOST_STARTS}"
            )
        for name, goals in (("goals", self.goals), ("lab_goals", self.lab_goals)):
            if len(set(goals)) != len(goals):
                raise ValueError(f"{name}: a goal is listed twice")
        listed = {"lab_goals": self.lab_goals, "theoretical_maximum_mol": self.theoretical_maximum_mol}
        for name, named in {**listed, "specifications": self.specifications}.items():
            for goal in named:
                if goal not in self.goals:
                    raise ValueError(f"{name}: {goal!r} is not one of goals ({', '.join(self.goals)})")
        for goal, wanted in self.specifications.items():
            if wanted.purity_among and goal not in wanted.purity_among:
                raise ValueError(f"specifications.{goal}.purity_among: {goal!r} itself must be one of them")
        for name, draw in self.world.draws.items():
            unknown = [key for key in draw.told if key not in self.benches]
            if unknown:
                raise ValueError(
                    f"world.draws.{name}.told: {unknown[0]!r} is not one of benches ({', '.join(self.benches)})"
                )
        unknown = [name for name in self.manager.readings or () if name not in self.instruments]
        if unknown:
            raise ValueError(
                f"manager.readings: {unknown[0]!r} is not one of instruments ({', '.join(self.instruments)})"
            )
        if self.demand.order and len(self.demand.order) != self.orders:
            raise ValueError(
                f"demand.order: give one for each of orders = {self.orders}, given {len(self.demand.order)}"
            )
        if self.shelf.tick and self.physics != "paper":
            raise ValueError(f"shelf.tick: vessels age by themselves with physics = {self.physics!r}; leave it out")
        repairs = any(bench.wear is not None and bench.wear.repair_ticks for bench in self.benches.values())
        longest = self.limits.ticks * self.shelf.slots
        if (self.demand.order or repairs) and longest > _MOST_VESSEL_TICKS:
            raise ValueError(
                "limits.ticks x shelf.slots: while the manager waits for an order or a repair, "
                f"{longest} ticks of a vessel could pass; at most {_MOST_VESSEL_TICKS}"
            )
        for goal in self.lab_goals:
            if goal not in self.theoretical_maximum_mol:
                raise ValueError(f"theoretical_maximum_mol.{goal}: must be given and above 0")
        return self

    @property
    def materials(self) -> dict[str, Material]:
        """Materials that can occur here, by id, in the order of every amounts array."""
        return self._materials

    @property
    def pairs(self) -> dict[frozenset[str], Pair]:
        """Activity coefficients of its liquids (physics ``real``)."""
        return self._pairs

    @property
    def family(self) -> ReactionFamily:
        """Reactions, salts and violent reactions that can happen here."""
        return self._family

    @property
    def origin(self) -> str:
        """The file this scenario came from, for error messages."""
        return self._origin

    @property
    def safety_events(self) -> tuple[str, ...]:
        """Kinds of safety event, in the order of every events array: chemlab's, then the scenario's own."""
        return (*SAFETY_EVENTS, *self.safety.events)

    @property
    def argument(self) -> str:
        """What ``chemlab`` commands take for this scenario: a shipped one's name, else the path it was loaded from,
        quoted for a shell; ``FILE.toml`` for one that has no file yet."""
        path = Path(self._origin)
        shipped = path == shipped_file(path.stem)
        if path.suffix != ".toml" or (shipped and path.stem != self.name):  # made or changed in code
            return "FILE.toml"
        return self.name if shipped else shlex.quote(self._origin)

    @property
    def errs(self) -> bool:
        """Whether any bench or instrument has a condition of its own, which changes while it is used."""
        wearing = any(bench.wear is not None for bench in self.benches.values())
        return wearing or any(instrument.drift is not None for instrument in self.instruments.values())

    @property
    def seen_instruments(self) -> dict[str, InstrumentSpec]:
        """Those whose readings stand in the manager's observation, by name."""
        seen = self.manager.readings
        return {name: spec for name, spec in self.instruments.items() if seen is None or name in seen}

    def agents(self) -> list[str]:
        """Names of all agents in order; nothing else says which one of them is the manager."""
        return [MANAGER_AGENT, *self.bench_agents()]

    def bench_agents(self) -> list[str]:
        """Agent ids of the benches in turn order: ``rxn_0``, ``rxn_1``, ``ext_0``, ..."""
        return [f"{key}_{i}" for key, bench in self.benches.items() for i in range(bench.count)]

    @property
    def split(self) -> Split:
        """Set of worlds that episodes draw from; ``train`` unless :meth:`configured` says otherwise."""
        return self._split

    def configured(
        self,
        rewards: str | RewardSpec | Mapping[str, float] | None = None,
        split: str | None = None,
        actions: str | None = None,
    ) -> Scenario:
        """Return the same laboratory with other settings; None keeps what the scenario has.

        Args:
            rewards: reward mix: ``individual``, ``cooperative``, ``mixed``, or the numbers.
            split: set of worlds that episodes draw from: ``train``, ``validation``, ``test`` or ``private:SALT``.
            actions: of all benches: ``native``, as the kind of bench has them, or ``discrete``, a choice among some
                where those are continuous (:meth:`chemlab.roles.bench.Bench.representative_actions`).

        Raises:
            ValueError: unknown reward mix, split or kind of actions, or invalid numbers.
        """
        changed: dict[str, Any] = {}
        if rewards is not None:
            mix = _reward_mix(rewards)
            if not isinstance(mix, (RewardSpec, Mapping)):
                raise ValueError(f"rewards: must be {', '.join(REWARD_MIXES)} or the numbers, given {rewards!r}")
            changed["rewards"] = mix if isinstance(mix, RewardSpec) else validated(RewardSpec, mix, "rewards")
        if actions is not None:
            if actions not in ("native", "discrete"):
                raise ValueError(f"actions: must be native or discrete, given {actions!r}")
            changed["benches"] = {key: b.model_copy(update={"actions": actions}) for key, b in self.benches.items()}
        chosen = self._split if split is None else Split.of(split)
        if not changed and chosen == self._split:
            return self
        found = self.model_copy(update=changed)
        found._split = chosen
        return found

    def __hash__(self) -> int:
        return hash((self.name, self._origin))

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        yield None, self.name
        yield "title", self.title
        yield "agents", self.agents()
        yield "goals", list(self.lab_goals)
        yield "origin", self.origin
