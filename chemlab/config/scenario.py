"""Scenarios: the complete configuration of a laboratory as one typed, frozen value loaded from TOML.

All numbers that a researcher might vary (stock, vessels, action tables, prices, limits, reward mix) are in the file;
types and bounds are here. A bench's own settings are validated by its options model.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, PrivateAttr, field_validator, model_validator

from .datafile import read_toml
from .datamodel import DataModel, validated
from .display import facts_html
from .draws import Split, WorldSpec
from .inherit import shipped_file
from .materials import Material
from .pairs import Pair
from .reactions import ReactionFamily

MANAGER_AGENT = "manager_0"
"""Name of the manager."""

SAFETY_EVENTS: tuple[str, ...] = ("spill_l", "relief_valve_mol", "boiled_dry", "dry_heating", "metal_in_water_mol")
"""Built-in kinds of safety events with their units.

They are litres spilled, moles of vapour lost through the relief valve, number of times a vessel boiled to dryness,
number of times a vessel without liquid was heated, moles of metal that met water.
"""

PHYSICS_TIERS: dict[str, str] = {"paper": "chemlab.physics.backends.paper", "real": "chemlab.physics.backends.real"}
"""Physics backends that a scenario may name, with the module of each (see :mod:`chemlab.physics.backends`)."""

_DATA = Path(__file__).resolve().parent.parent / "data"
_MOST_STARTS = 20_000

_MOST_VESSEL_TICKS = 1_000_000
"""Maximum number of vessel ticks within one uninterruptible manager action: a few seconds at up to 10 us each."""

Key = Annotated[str, Field(min_length=1, max_length=100)]
Mol = Annotated[float, Field(ge=0.0, le=1e4)]

Amounts = Annotated[dict[Key, Mol], Field(max_length=100)]
"""Moles, or prices per mole, by material."""

Maximum = Annotated[float, Field(ge=1e-6, le=1e4)]

Price = Annotated[float, Field(ge=0.0, le=1e6)]
"""Price in units of the score."""

Capacity = Annotated[float, Field(ge=1e-6, le=100.0)]
Goals = Annotated[tuple[Key, ...], Field(min_length=1, max_length=64)]


def _once(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name!r} is named twice; remove one")
    return names


Parts = Annotated[tuple[Annotated[str, Field(max_length=1000)], ...], Field(max_length=32), AfterValidator(_once)]
Share = Annotated[float, Field(ge=-1e6, le=1e6)]


class VesselSpec(DataModel):
    """A vessel on the shelf at the start of an episode."""

    capacity_l: Capacity
    """Volume up to the rim; the excess runs over (a spill)."""
    contents: Amounts = {}
    """Moles of each material."""


class ShelfSpec(DataModel):
    """The shared shelf: a number of slots and the vessels in the first of them."""

    slots: int = Field(ge=1, le=64)
    """Number of slots."""
    vessel: tuple[VesselSpec, ...] = ()
    """Vessels in the first slots, in order; the other slots are empty. At least one, because the manager acts on
    vessels.
    """
    gauge: float = Field(default=0.0, ge=0.0, le=0.5)
    """Resolution of what the manager observes of amounts; 0: exact.

    It is a share of the capacity for fill levels, of the largest capacity for capacities and waste, and of the first
    stock for bottles and their costs.
    """
    tick: float = Field(default=0.0, ge=0.0, le=1e6)
    """Reaction time per tick for vessels at rest, in the unit of the rate constants.

    Their contents react at room temperature (backend ``paper``; with ``real`` they always do). 0: nothing reacts on the
    shelf.
    """

    @model_validator(mode="after")
    def _fits(self) -> ShelfSpec:
        if not self.vessel:
            raise ValueError("vessel: must have at least one [[shelf.vessel]]: without a vessel no action is possible")
        if len(self.vessel) > self.slots:
            raise ValueError(f"vessel: {len(self.vessel)} vessels do not fit on {self.slots} slots")
        return self


class Companion(DataModel):
    """A further material of an initial state; ``if_goal`` replaces ``material`` if that is the goal itself."""

    material: Key
    """Material that may be present in addition."""
    mol: float = Field(gt=0.0, le=1e4)
    """Its amount in mol."""
    probability: float = Field(default=1.0, ge=0.0, le=1.0)
    """Probability of its presence, drawn in each episode."""
    if_goal: Key
    """Replacement in experiments whose goal is ``material``."""


class StartSpec(DataModel):
    """The paper's fixed initial state of a single-bench episode."""

    capacity_l: Capacity = 1.0
    """Volume of the vessel up to the rim."""
    contents: Amounts = {}
    """Moles of each material."""
    goal_mol: Mol = 0.0
    """Additional mol of the experiment's goal."""
    companion: Companion | None = None
    """A further material that may be present."""


class WearSpec(DataModel):
    """Degradation, drift and breakdown of a bench's apparatus. Agents observe only a breakdown."""

    actuator: Literal["stir", "heat"] = "stir"
    """Affected effect.

    ``stir``: share of a tick in which a reaction bench's contents react (and absorb heat), or effective share of a
    shaking. ``heat``: share of the requested heat that arrives: of a heating mantle's kJ, of a jacket's W/K, or of a
    thermostat's step.
    """
    gain: float = Field(default=1.0, ge=0.01, le=100.0)
    """Median factor of the effect for a new or repaired bench, from 0.01 to 100; 1 is nominal."""
    spread: float = Field(default=0.0, ge=0.0, le=3.0)
    """Standard deviation of its natural logarithm for a new or repaired bench."""
    drift: float = Field(default=0.0, ge=0.0, le=3.0)
    """Standard deviation of the change of its logarithm per tick of work (a random walk)."""
    life: float = Field(default=0.0, ge=0.0, le=1e6)
    """Mean number of ticks of work until a breakdown, with constant hazard; 0: no breakdowns."""
    repair_price: Price = 0.0
    """Price of a repair, in units of the score; a repair redraws gain and lifetime."""
    repair_ticks: int = Field(default=0, ge=0, le=1_000_000)
    """Duration of a repair in ticks."""


class BenchSpec(DataModel):
    """One kind of bench: number, step limit, and the bench's own options.

    Keys that are not listed here go to the options model of the bench ``kind``, which rejects unknown ones. Omitted
    keys have the defaults of ``chemlab/data/benches`` for the kind, if there are any.
    """

    model_config = ConfigDict(extra="allow")

    kind: str = Field(min_length=1, max_length=200)
    """``reaction``, ``extraction``, ``distillation``, ``crystallization``, or your own, ``my_bench.py:Class``."""
    count: int = Field(default=1, ge=1, le=16)
    """Number of benches of this kind, each with its own agent."""
    step_limit: int = Field(ge=1, le=10_000)
    """Maximum number of steps of an experiment."""
    observe: Parts = ()
    """Your own observation channels, ``my_parts.py:NAME`` each, after the bench's."""
    reward: Parts = ()
    """Your own reward terms, ``my_parts.py:NAME`` each, added to the reward of every action."""
    actions: Literal["native", "discrete"] = "native"
    """``native``: actions of the bench kind; ``discrete``: continuous actions are replaced by a choice among some."""
    model: Annotated[str, Field(max_length=1000)] | None = None
    """Physics of your own in place of the bench's, ``my_parts.py:NAME`` (:mod:`chemlab.roles.models`)."""
    wear: WearSpec | None = None
    """Degradation, drift and breakdown of its apparatus; None: nominal operation. The manager may have it repaired."""
    noise: dict[Key, Annotated[float, Field(ge=0.0, le=100.0)]] = Field(default={}, max_length=32)
    """Standard deviation of the noise on every value that the bench's agent observes, by channel, on the scale from 0
    to 1.

    Half of its variance is drawn for an experiment, half for each step. Channels that are not named are exact.
    """
    resolution: dict[Key, Annotated[float, Field(gt=0.0, le=10.0)]] = Field(default={}, max_length=32)
    """Resolution of these values, noise included, by channel, on the same scale. Above 2, a channel reads 0."""
    report: float | None = Field(default=None, ge=0.0, le=1.0)
    """Standard deviation of the self-reported outcome of an experiment, on the scale from 0 to 1.

    The report has mol of the goal, its purity, and the elapsed ticks. The manager observes it without paying; None: no
    report.
    """
    start: StartSpec = StartSpec()
    """Initial state of the single bench (``starts="paper"``); not used in a laboratory."""


class DriftSpec(DataModel):
    """Drift of an instrument's zero, and calibration."""

    first: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of the bias of every value of the (0 to 1) reading at the start of an episode."""
    walk: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of the change of every value's bias per tick (independent random walks)."""
    trend: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Constant change of every value's bias per tick."""
    price: Price = 0.0
    """Price of a calibration, in units of the score."""
    error: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of the bias of every value after a calibration."""


class InstrumentSpec(DataModel):
    """An instrument of the characterization bench.

    A reading is gain x true value + bias + noise, on the scale from 0 to 1 of its channel.
    """

    kind: Key
    """Kind of instrument.

    It is one of ``uv_vis``, ``layer_camera``, ``balance``, ``gas_chromatograph``, ``thermometer``, ``density_meter``,
    ``karl_fischer``, ``hplc``; with the backend ``real`` also ``ph_meter`` and ``melting_point``; or your own,
    ``my_parts.py:NAME``.
    """
    price: Price = 0.0
    """Price of one use, in units of the score."""
    sample_fraction: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Fraction of the vessel's contents that one use consumes (it goes to waste)."""
    noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """Standard deviation of Gaussian noise on every value of the (0 to 1) reading."""
    detection_limit: float = Field(default=0.0, ge=0.0, le=1.0)
    """Values of the (0 to 1) reading below it, noise included, read 0."""
    gain: float = Field(default=1.0, ge=0.0, le=100.0)
    """Calibration: factor of every value; 1 is exact."""
    bias: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Calibration: offset of every value of the (0 to 1) reading; 0 is exact."""
    drift: DriftSpec | None = None
    """Drift; None: no drift. The manager may have the instrument calibrated."""


class LimitSpec(DataModel):
    """Limits of an episode, which terminates when it reaches one."""

    manager_actions: int = Field(ge=1, le=100_000)
    """Maximum number of manager actions."""
    ticks: int = Field(ge=1, le=1_000_000)
    """Maximum number of ticks, in which every busy bench makes one step."""
    budget: float = Field(default=1.0, gt=0.0, le=1e6)
    """Budget of the manager for measurements and calibrations, in units of the score; actions beyond it are masked."""


class CostSpec(DataModel):
    """Prices in units of the score (1 = the theoretical maximum of the product, pure)."""

    stock_per_mol: Amounts = {}
    """Price of a mole taken from a bottle, by material."""
    waste_per_l: Price = 0.0
    """Price of a litre of waste; gas costs nothing."""
    tick: Price = 0.0
    """Price of a tick."""
    illegal_action: Price = 0.0
    """Penalty in the reward of an agent that plays a masked action, which has no other effect."""


class SafetySpec(DataModel):
    """Weights of safety events in ``info["cost"]``, and the price of that cost in the reward."""

    weights: dict[Key, Price]
    """Weight of each kind of event in the cost; without this key, 1 for each built-in kind."""
    events: dict[Key, str] = Field(default={}, max_length=32)
    """Your own kinds of events with their meanings; your own benches or operations report them."""
    reward_price: Price = 0.0
    """Price of a unit of that cost in the agent's reward."""

    @model_validator(mode="before")
    @classmethod
    def _weighed(cls, values: Any) -> Any:
        # Not a default, which hashes of scenarios leave out.
        return {"weights": dict.fromkeys(SAFETY_EVENTS, 1.0), **values} if isinstance(values, Mapping) else values

    @model_validator(mode="after")
    def _known(self) -> SafetySpec:
        for key in self.weights:
            if key not in (*SAFETY_EVENTS, *self.events):
                raise ValueError(
                    f"weights.{key}: unknown safety event; choose from {', '.join((*SAFETY_EVENTS, *self.events))}; "
                    "or declare your own under safety.events"
                )
        return self


class RewardSpec(DataModel):
    """Each agent's reward = local * own + team * the manager's result.

    Penalties of a bench's agent are subtracted from its reward in full. A scenario gives the numbers, or the name
    of one of :data:`REWARD_MIXES`.
    """

    bench_local: Share = 1.0
    """Weight of a bench agent's own experiment scores."""
    bench_team: Share = 0.0
    """Weight of the manager's result in its reward."""
    manager_local: Share = 1.0
    """Weight of the manager's own result."""
    manager_team: Share = 0.0
    """Weight of the team's result, which for the manager is the same, so that the two add up."""


REWARD_MIXES: dict[str, RewardSpec] = {
    name: RewardSpec(**numbers) for name, numbers in read_toml(_DATA / "rewards.toml").items()
}
"""Reward mixes by name, from ``data/rewards.toml``."""


def _reward_mix(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    if given not in REWARD_MIXES:
        raise ValueError(f"unknown reward mix {given!r}; choose from {', '.join(REWARD_MIXES)}, or give the numbers")
    return REWARD_MIXES[given]


class Settings(TypedDict, total=False):
    """Keywords of :meth:`Scenario.configured`, which every environment takes."""

    rewards: str | RewardSpec | Mapping[str, float] | None
    split: str | None
    actions: str | None


class OrderSpec(DataModel):
    """Requirements of a submission; a submission that fails them scores 0."""

    purity_at_least: float = Field(default=0.0, ge=0.0, le=1.0)
    """Minimum share of the goal in the vessel."""
    amount_at_least_mol: Mol = 0.0
    """Minimum mol of the goal."""


class ProductSpec(OrderSpec):
    """Requirements of every submission of a goal, and what its purity counts."""

    purity_among: tuple[Key, ...] = Field(default=(), max_length=64)
    """Materials among which the purity is computed, as in a chromatogram of products without solvents and salts.

    The score uses this purity as well. Dissolved ions of a salt count as the salt. Empty: everything in the vessel.
    """


class OrderTerms(OrderSpec):
    """Order terms: arrival, requirements, and payment."""

    arrives: float = Field(default=0.0, ge=0.0, le=1e6)
    """Tick of arrival; before it the order is unknown and nothing can be submitted for it."""
    within: float | None = Field(default=None, ge=0.0, le=1e6)
    """Ticks from arrival to the deadline; None: the end of the episode."""
    price: float = Field(default=1.0, ge=0.0, le=1e3)
    """Payment for a fulfilled order, as a multiple of its equal share of the score."""


class GradeSpec(OrderSpec):
    """Quality requirement of an experiment, chosen by the manager and observed by the bench's agent.

    An experiment that fails it is not paid, but its losses count: it scores at most 0.
    """

    ticks: int | None = Field(default=None, ge=1, le=10_000)
    """Maximum duration of the experiment in ticks; None: the bench's step limit."""


class DemandSpec(DataModel):
    """Terms of customers: orders that arrive over time with their own terms, penalties, and feedback.

    An order with terms pays its price for a submission in time that meets its requirements, and nothing for exceeding
    them. The score is the mean over the orders, minus all costs.
    """

    order: tuple[OrderTerms, ...] = Field(default=(), max_length=16)
    """Terms of every order; empty: all orders exist from the beginning and are paid by amount and purity."""
    missed: float = Field(default=0.0, ge=0.0, le=100.0)
    """Penalty of an order that pays nothing by the end of the episode, as a share of its price (1 without terms).

    Without a least amount or ``fill_at_least``, a submission with a trace of the goal avoids it.
    """
    fill_at_least: float = Field(default=0.0, ge=0.0, le=1.0)
    """Minimum fill level, as the manager observes it, of a vessel that may be submitted."""
    feedback: Annotated[float, Field(ge=0.0, le=1.0)] | Literal["none"] = 0.0
    """Standard deviation of what the manager learns of a submission at once, on the scale from 0 to 1.

    Feedback is mol of the goal (1: the theoretical maximum), its purity, and the reward that follows from both. The
    exact values and the rest of the reward come at the end of the episode, with ``none`` all of them.
    """
    late: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of the price for a late submission. If it is 0, the episode ends once no order can pay any more."""
    short: float = Field(default=0.0, ge=0.0, le=1.0)
    """Share of the price for a submission with less of the goal, or less pure, than required; 0 without any of the
    goal.
    """


class ManagerSpec(DataModel):
    """Changes to the manager's observation and reward."""

    observe: Parts = ()
    """Your own observation channels, ``my_parts.py:NAME`` each, after the manager's."""
    readings: tuple[Key, ...] | None = Field(default=None, max_length=32)
    """Instruments whose readings the manager observes for each slot; None: all.

    Of other instruments it observes only the age of the last reading, which keeps the observation small.
    """
    reward: Parts = ()
    """Your own reward terms, ``my_parts.py:NAME`` each, added to the reward of every action."""


class RealSpec(DataModel):
    """Options that only ``physics = "real"`` uses."""

    tick_s: float = Field(default=60.0, gt=0.0, le=1e6)
    """Duration of a laboratory tick in seconds."""
    room_transfer_w_k_l: float = Field(default=0.5, ge=0.0, le=1e4)
    """Heat exchange of a litre of contents with the room, W/K: a flask in still air."""
    crystal_rate: float = Field(default=2e-3, gt=0.0, le=1e3)
    """Rate in 1/s at which a slurry approaches saturation."""
    metastable: float = Field(default=1.3, ge=1.0, le=100.0)
    """Ratio to saturation up to which a solution without crystals stays clear."""


class Scenario(DataModel):
    """A laboratory as data; see the files under ``scenarios/`` for commented examples.

    ``materials`` and ``family`` are resolved at load and contain only what can occur in this scenario.
    """

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*(@[12])?$", max_length=100)
    """Name in commands and records; with its level, if that is not the file's own: ``unlabelled@1``."""
    title: str = Field(max_length=300)
    """One line for lists."""
    summary: str
    """A paragraph for its page."""
    physics: str = "paper"
    """Physics backend, one of :data:`PHYSICS_TIERS`."""
    reactions: str
    """Reaction family: a bundled one's name, or the path of a file relative to the scenario's folder."""
    material_files: tuple[str, ...] = Field(default=(), max_length=20)
    """Files with your own materials, relative to the scenario's folder."""
    pair_files: tuple[str, ...] = Field(default=(), max_length=20)
    """Files with activity coefficients of your own pairs of liquids, relative to the scenario's folder (backend
    ``real``).
    """
    real: RealSpec = RealSpec()
    """Options that only ``physics = "real"`` uses."""
    goals: Goals
    """Possible goals of experiments, in the order of every one-hot goal."""
    lab_goals: Goals
    """Possible goals of orders; each order's goal is drawn uniformly in each episode."""
    orders: int = Field(default=1, ge=1, le=16)
    """Number of vessels that the manager has to submit, each worth an equal share of the score."""
    theoretical_maximum_mol: dict[Key, Maximum]
    """Maximum mol of each laboratory goal that stock, shelf and kinetics allow, divided among the orders."""
    ambient_temperature_k: float = Field(default=298.15, ge=200.0, le=350.0)
    """Temperature of vessels at rest and of bottles."""
    ambient_pressure_kpa: float = Field(default=101.325, ge=1.0, le=1000.0)
    """Ambient pressure."""
    stock: Amounts = {}
    """Mol in the reagent and solvent bottles, shared by all benches."""
    shelf: ShelfSpec
    """The shared shelf of vessels."""
    manager: ManagerSpec = ManagerSpec()
    """Your own parts for the manager."""
    benches: dict[Key, BenchSpec] = Field(min_length=1, max_length=16)
    """Kinds of benches by key, after which their agents are named (``rxn_0``)."""
    instruments: dict[Key, InstrumentSpec] = Field(default={}, max_length=32)
    """Instruments of the characterization bench by name."""
    limits: LimitSpec
    """Limits at which an episode ends without the last submission."""
    costs: CostSpec = CostSpec()
    """Costs subtracted from the score."""
    safety: SafetySpec = SafetySpec(weights=dict.fromkeys(SAFETY_EVENTS, 1.0))
    """Weights and price of safety events."""
    rewards: Annotated[RewardSpec, BeforeValidator(_reward_mix)] = RewardSpec()
    """Reward mix: numbers, or a mix's name."""
    specifications: dict[Key, ProductSpec] = Field(default={}, max_length=64)
    """Minimum requirements of submissions by laboratory goal."""
    grades: dict[Key, GradeSpec] = Field(default={}, max_length=16)
    """Quality requirements by name that the manager may set for an experiment, in addition to its goal."""
    demand: DemandSpec = DemandSpec()
    """Orders that arrive over time, with deadlines, prices and their own terms."""
    world: WorldSpec = WorldSpec()
    """Hidden parameters."""

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
                raise ValueError(f"benches.{key}: a bench's key must be lower-case letters and not manager")
        starts = len(self.bench_agents()) * self.shelf.slots * len(self.goals) * max(len(self.grades), 1)
        if starts > _MOST_STARTS:
            raise ValueError(
                f"benches x slots x goals x grades: {starts} start actions; must be at most {_MOST_STARTS}"
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
            unknown = [key for key in draw.told if key not in (*self.benches, "manager")]
            if unknown:
                raise ValueError(
                    f"world.draws.{name}.told: {unknown[0]!r} is not one of benches ({', '.join(self.benches)}), nor "
                    "manager"
                )
        unknown = [name for name in self.manager.readings or () if name not in self.instruments]
        if unknown:
            raise ValueError(
                f"manager.readings: {unknown[0]!r} is not one of instruments ({', '.join(self.instruments)})"
            )
        if self.demand.order and len(self.demand.order) != self.orders:
            raise ValueError(
                f"demand.order: must have one for each of orders = {self.orders}, given {len(self.demand.order)}"
            )
        if self.shelf.tick and self.physics != "paper":
            raise ValueError(f"shelf.tick: not allowed with physics = {self.physics!r}, where vessels always react")
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
        """Materials that can occur, by id, in the order of every amounts array."""
        return self._materials

    @property
    def pairs(self) -> dict[frozenset[str], Pair]:
        """Activity coefficients of the liquids (backend ``real``)."""
        return self._pairs

    @property
    def family(self) -> ReactionFamily:
        """Reactions, salts and violent reactions that can occur."""
        return self._family

    @property
    def origin(self) -> str:
        """File of the scenario, for error messages."""
        return self._origin

    @property
    def safety_events(self) -> tuple[str, ...]:
        """Kinds of safety events in the order of every events array: built-in ones, then the scenario's own."""
        return (*SAFETY_EVENTS, *self.safety.events)

    @property
    def shipped(self) -> bool:
        """True if it comes with chemlab, at any level; a user's file of the same name does not."""
        file, origin = shipped_file(self.name), Path(self._origin)
        return file is not None and (origin.suffix != ".toml" or origin.resolve() == file.resolve())

    @property
    def argument(self) -> str:
        """Argument of ``chemlab`` commands for this scenario, quoted for a shell.

        It is a bundled one's name, else the path it was loaded from, or ``FILE.toml`` without a file.
        """
        path = Path(self._origin)
        shipped = path == shipped_file(path.stem)
        if path.suffix != ".toml" or (shipped and path.stem + self.level != self.name):  # created or changed in code
            return "FILE.toml"
        return self.name if shipped else shlex.quote(self._origin + self.level)

    @property
    def level(self) -> str:
        """Its level as part of its name, ``@1``; empty for the scenario as its file has it."""
        return "".join(self.name.rpartition("@")[1:]) if "@" in self.name else ""

    @property
    def errs(self) -> bool:
        """True if any bench or instrument has a condition that changes with use."""
        wearing = any(bench.wear is not None for bench in self.benches.values())
        return wearing or any(instrument.drift is not None for instrument in self.instruments.values())

    @property
    def hides(self) -> bool:
        """True if it has hidden parameters.

        Then agents act before they learn: a bench's agent observes a vessel from its first turn on, an experiment is
        recalled after a tick at the earliest, and only vessels that were at a bench are submitted.
        """
        return bool(self.world.draws) or self.errs

    @property
    def seen_instruments(self) -> dict[str, InstrumentSpec]:
        """Instruments whose readings the manager observes, by name."""
        seen = self.manager.readings
        return {name: spec for name, spec in self.instruments.items() if seen is None or name in seen}

    def agents(self) -> list[str]:
        """Names of all agents in order; nothing else says which one of them is the manager."""
        return [MANAGER_AGENT, *self.bench_agents()]

    def bench_agents(self) -> list[str]:
        """Return the names of the bench agents in turn order: ``rxn_0``, ``rxn_1``, ``ext_0``, ..."""
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

    def _repr_html_(self) -> str:
        facts = {
            "summary": self.summary,
            "agents": ", ".join(self.agents()),
            "products": ", ".join(self.lab_goals),
            "hidden parameters": len(self.world.draws),
            "horizon": f"{self.limits.ticks} ticks",
            "file": self.origin,
        }
        return facts_html(f"{self.name}: {self.title}", facts)

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        yield None, self.name
        yield "title", self.title
        yield "agents", self.agents()
        yield "goals", list(self.lab_goals)
        yield "origin", self.origin
