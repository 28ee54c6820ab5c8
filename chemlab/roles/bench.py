"""Interface of benches: positions, observation channels, actions, score, and the arrays of experiments."""

from __future__ import annotations

import copy
import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Annotated, Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

from ..config.datafile import DataError, toml_key
from ..config.datamodel import validated
from ..config.materials import COLDEST_K, HOTTEST_K
from ..config.parts import Part, PartError, blamed, checked_numbers, load_part
from ..config.scenario import BenchSpec, ProductSpec, Scenario, WearSpec
from ..kernels.arrays import (
    BoolArray,
    Field,
    FloatArray,
    Handle,
    IntArray,
    MaskArray,
    ObservationArray,
    StreamArray,
    declared,
    merged,
)
from ..kernels.jit import helper, kernel, opened
from ..kernels.rng import normal, random_bits
from ..kernels.tables import Table
from ..physics.backends import partition, settle_phases, work_size
from ..physics.chemistry import AMOUNTS, PRESENT, TEMPERATURE, WAVELENGTHS_NM, Chemistry, ChemistryTable, Layout
from ..physics.shelf import Shelf, ShelfArrays
from ..physics.transfer import place
from .base import Quantity
from .grades import Grades, GradeState, best_vessel, noisy
from .models import load_model

CAMERA_PIXELS = 100

_ROUNDING_MOL = 1e-9
"""Negative amounts down to this value left by user-defined code count as rounding errors."""

_APART = np.uint64(0xD1342543DE82EF95)
"""Distance between the random numbers of two steps: odd, and no small multiple of a stream's increment."""

STIR, HEAT = range(2)
"""Actuators of a bench that may be degraded."""


@dataclass(frozen=True)
class Channel:
    """One part of an observation vector: ``size`` numbers, each ``unit`` in [low, high] scaled to [0, 1]."""

    name: str
    size: int
    unit: str
    low: float
    high: float
    meaning: str

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not isinstance(self.size, Integral):
            raise TypeError(f"a Channel has a name and an integer size, given {self.name!r} and {self.size!r}")
        if not -math.inf < self.low < self.high < math.inf:
            raise ValueError(f"Channel {self.name!r}: low must be below high, given {self.low!r} and {self.high!r}")

    def unscaled(self, values: Any) -> Any:
        """Return numbers in [0, 1] in the channel's unit."""
        return self.low + values * (self.high - self.low)


def told_channel(names: Sequence[str], size: int) -> Channel:
    """Return the channel of revealed hidden parameters."""
    words = "which part of what may be drawn is below: " + ", ".join(names)
    return Channel("told", size, "fraction", 0.0, 1.0, words)


@dataclass(frozen=True)
class Observation(Part):
    """A user-defined part of an observation vector, of a bench or of the manager.

    Attributes:
        channel: its channel: ``channel(bench) -> Channel``; for the manager ``channel(laboratories)``.
        see: its values in [0, 1]: ``see(bench, shelf, experiments, members) -> [B, size]`` for running experiments; for
            the manager ``see(laboratories, members)``.
    """

    channel: Callable[[Any], Channel]
    see: Callable[..., FloatArray]

    def declared(self, name: str, *owner: Any) -> Channel:
        """Return its channel.

        Raises:
            PartError: it has none.
        """
        with blamed(f"{name}: channel()"):
            channel = self.channel(*owner)
        if not isinstance(channel, Channel) or channel.size < 1:
            raise PartError(f"{name}: channel() must return a Channel with a size of at least 1, given {channel!r}")
        return channel

    def seen(self, name: str, members: int, size: int, *owner: Any) -> FloatArray:
        """Return its values [members, size].

        Raises:
            PartError: the shape is wrong, or values are outside [0, 1].
        """
        with blamed(f"{name}: see()"):
            values = self.see(*owner)
        return checked_numbers(values, (members, size), f"{name}: see()", 0.0, 1.0)


def load_parts(names: Sequence[str], scenario: Scenario, key: str, of: Any) -> dict[str, Any]:
    """Load the observation channels (``of=Observation``) or reward terms that a scenario names under a key, by name."""
    return {f"{scenario.origin}: {key}: {name}": load_part(name, scenario, key, of=of) for name in names}


def distinct_channels(channels: Iterable[Channel], where: str) -> tuple[Channel, ...]:
    """Return the channels of a role.

    Raises:
        DataError: two have the same name; the message begins with ``where``.
    """
    found: dict[str, Channel] = {}
    for channel in channels:
        if channel.name in found:
            raise DataError(f"{where}: two observation channels are named {channel.name!r}; rename one of your own")
        found[channel.name] = channel
    return tuple(found.values())


def channel_slices(channels: Sequence[Channel]) -> dict[str, slice]:
    """Return the slice of each channel in the flat observation."""
    slices, start = {}, 0
    for channel in channels:
        slices[channel.name] = slice(start, start + channel.size)
        start += channel.size
    return slices


@dataclass(frozen=True)
class Goals:
    """The scenario's goals as arrays: materials that count as the goal, and weights of the purity.

    Attributes:
        parts: [G, 3] material index of the goal and, for a salt, of its ions (else -1).
        solute_counts: [G, M] weight of each material in the goal's solute purity: solvents 0 (except the goal itself);
            an ion 1 and undissolved salt as its two ions, but for a salt as goal a pair of ions counts as one.
        absolute_counts: [G, M] weight in the absolute purity: all materials 1, an ion 1/2 (a pair is one formula unit
            of salt, dissolved or not, so that precipitation does not change a purity).
        order_counts: [G, M] the same for orders, requirements and reports: 0 for what ``purity_among`` leaves out.
    """

    names: tuple[str, ...]
    parts: IntArray
    solute_counts: FloatArray
    absolute_counts: FloatArray
    order_counts: FloatArray

    @classmethod
    def of(cls, scenario: Scenario) -> Goals:
        """Return the arrays of a scenario's goals."""
        names = list(scenario.materials)
        roles = [material.role for material in scenario.materials.values()]
        salts = {salt.solid: salt for salt in scenario.family.salt}
        parts = np.full((len(scenario.goals), 3), -1, dtype=np.int64)
        solute = np.zeros((len(scenario.goals), len(names)))
        absolute = np.zeros_like(solute)
        for g, goal in enumerate(scenario.goals):
            parts[g, 0] = names.index(goal)
            if goal in salts:
                parts[g, 1:] = names.index(salts[goal].cation), names.index(salts[goal].anion)
            ion = 0.5 if goal in salts else 1.0
            for i, (name, role) in enumerate(zip(names, roles, strict=True)):
                if role != "gas":
                    counted = role != "solvent" or name == goal
                    absolute[g, i] = 0.5 if role == "ion" else 1.0
                    solute[g, i] = ion if role == "ion" else 2.0 * ion if name in salts else float(counted)
        among = [scenario.specifications.get(goal, ProductSpec()).purity_among or names for goal in scenario.goals]
        alike = {name: {name} | {s.solid for s in salts.values() if name in (s.cation, s.anion)} for name in names}
        weighed = np.array([[not alike[name].isdisjoint(own) for name in names] for own in among], dtype=np.float64)
        return cls(tuple(scenario.goals), parts, solute, absolute, absolute * weighed)


class ExperimentState(NamedTuple):
    """Arrays of one bench's experiments in N laboratories; P positions, E kinds of safety events.

    A bench declares further ones (:attr:`Bench.own_state`).
    """

    places: Annotated[IntArray, Field("N P", first=None, kept=False)]
    """[N, P] row of each position's vessel in ``shelf.rows``"""
    busy: Annotated[BoolArray, Field("N")]
    """[N] whether an experiment is running"""
    goal: Annotated[IntArray, Field("N")]
    """[N] index of the experiment's goal"""
    steps: Annotated[IntArray, Field("N")]
    """[N] number of steps of the experiment"""
    ended: Annotated[BoolArray, Field("N")]
    """[N] whether the last action ended the experiment"""
    illegal: Annotated[BoolArray, Field("N")]
    """[N] whether the last action was invalid"""
    baseline: Annotated[FloatArray, Field("N")]
    """[N] the bench's measure of the contents at the start of the experiment"""
    events: Annotated[FloatArray, Field("N E")]
    """[N, E] safety events of the last action"""
    stream: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] random stream of the bench's own draws (camera)"""
    noise_stream: Annotated[StreamArray, Field("N 1")]
    """[N, 1] state of the stream at the start of the experiment, from which its noise is drawn"""
    gain: Annotated[FloatArray, Field("N 2", first=1.0)]
    """[N, 2] factors of the effects of stirring and of heating (:data:`STIR`, :data:`HEAT`)"""
    life: Annotated[FloatArray, Field("N", first=math.inf)]
    """[N] remaining ticks of work until a breakdown"""
    broken: Annotated[BoolArray, Field("N")]
    """[N] whether the bench is broken"""
    wear_stream: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] random stream of degradation, derived from the world"""


class BenchRules(NamedTuple):
    """Static parameters of a bench; G goals, M materials, E kinds of safety events.

    A bench declares further ones (:attr:`Bench.own_rules`).
    """

    parts: Annotated[IntArray, Field("G 3")]
    """see :class:`Goals`"""
    event_weights: Annotated[FloatArray, Field("E")]
    """[E] weight of each kind of event in the cost"""
    event_price: Annotated[float, Field("")]
    """price of a unit of cost in the reward"""
    illegal_price: Annotated[float, Field("")]
    """penalty of an invalid action"""
    step_limit: Annotated[int, Field("")]
    auxiliary_capacity: Annotated[float, Field("")]
    """capacity in L of the clean vessels it provides"""
    wear_actuator: Annotated[int, Field("")]
    """STIR or HEAT; how it degrades, with the four below: see :class:`chemlab.config.scenario.WearSpec`"""
    wear_gain: Annotated[float, Field("")]
    wear_spread: Annotated[float, Field("")]
    wear_drift: Annotated[float, Field("")]
    wear_life: Annotated[float, Field("")]
    work: Annotated[FloatArray, Field("A B")]
    """scratch of the bench's kernels, which allocate nothing"""


def is_bundled(cls: type) -> bool:
    """Return True for a class of chemlab's own."""
    return cls.__module__.startswith(f"{__package__}.")


@helper
def on_scale(value: float, low: float, high: float) -> float:
    """Return a gauge's reading: the position of a value between ``low`` and ``high`` from 0 to 1; 0 for NaN."""
    share = (value - low) / (high - low)
    if 0.0 <= share <= 1.0:
        return share
    return 1.0 if share > 1.0 else 0.0


def check_vessels(rows: FloatArray, name: str) -> None:
    """Check that vessels have possible contents.

    Args:
        rows: [B, W] vessel rows, possibly with empty places.
        name: name of the part that has worked on them, for error messages.

    Raises:
        PartError: an amount is negative or not finite, or a temperature is outside the physical range.
    """
    if not np.isfinite(rows).all() or rows[:, AMOUNTS:].min(initial=0.0) < -_ROUNDING_MOL:
        raise PartError(f"{name} has left amounts that are negative or not finite in a vessel")
    standing = rows[rows[:, PRESENT] > 0.0, TEMPERATURE]
    wrong = standing[(standing < COLDEST_K) | (standing > HOTTEST_K)]
    if len(wrong):
        raise PartError(
            f"{name} has left a vessel at {wrong[0]:g} K; temperatures must be from {COLDEST_K:g} to {HOTTEST_K:g} K"
        )


def check_work(name: str, rows: FloatArray, events: FloatArray, stock: FloatArray, waste: FloatArray) -> None:
    """Check what a user's part has made of vessels ``rows`` [B, W], safety events, stock and waste.

    Raises:
        PartError: they are impossible; the message begins with the ``name``.
    """
    check_vessels(rows, name)
    for where, numbers in (("the safety events", events), ("the stock", stock), ("the waste can", waste)):
        if not np.isfinite(numbers).all() or numbers.min(initial=0.0) < -_ROUNDING_MOL:
            raise PartError(f"{name} has left a number in {where} that is negative or not finite")


def _guarded(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method of a user's bench that attributes its errors to it and checks its results."""

    @functools.wraps(method)
    def call(self: Bench, shelf: Shelf, experiments: Experiments, members: IntArray, *given: Any, **named: Any) -> Any:
        where = f"{self.scenario.origin}: benches.{self.key}: {self.kind}: {name}()"
        before = experiments.steps[members]
        with blamed(where):
            found = method(self, shelf, experiments, members, *given, **named)
        owners = [vars(one) for one in type(self).__mro__ if name in vars(one) and not is_bundled(one)]
        if owners[0][name] is not call:  # called by a subclass, which may not have finished
            return found
        if name == "measure":
            return checked_numbers(found, members.shape, where)
        if name == "mask":
            _check_mask(where, experiments.busy[members], *given)
        elif name == "act":
            rows = shelf.rows[experiments.places[members]]
            bottles = shelf.stock[members], shelf.waste[members]
            check_work(where, rows.reshape(-1, rows.shape[-1]), experiments.events[members], *bottles)
            steps = experiments.steps[members]
            if not (steps > before).all() or not experiments.ended[members][steps >= self.step_limit].all():
                raise PartError(
                    f"{where}: must add 1 to experiments.steps, and set experiments.ended from step_limit = "
                    f"{self.step_limit} on"
                )
        return found

    return call


def _check_mask(where: str, busy: BoolArray, out: MaskArray) -> None:
    if not np.isin(out, (0, 1)).all() or not out[busy].any(axis=1).all():
        raise PartError(f"{where}: must write 0 or 1 for every action, and a 1 for some, given {out.tolist()!r:.200}")


@helper
def goal_amount(row: FloatArray, part: IntArray) -> float:
    """Return mol of the goal in a vessel, with dissolved pairs of ions for a salt. ``part`` is a row of Goals.parts."""
    amount = row[AMOUNTS + part[0]]
    if part[1] >= 0:
        amount += min(row[AMOUNTS + part[1]], row[AMOUNTS + part[2]])
    return float(amount)


@helper
def weighted_amount(row: FloatArray, weights: FloatArray) -> float:
    """Return the sum of weight x mol over the materials."""
    total = 0.0
    for i in range(weights.shape[0]):
        total += weights[i] * row[AMOUNTS + i]
    return total


@kernel
def _purity_scores(
    members: IntArray, experiment: Handle, shelf: Handle, parts: IntArray, counts: FloatArray, out: FloatArray
) -> None:
    state, arrays = opened(ExperimentState, experiment), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m = members[b]
        goal = state.goal[m]
        out[b] = 0.0
        for p in range(state.places.shape[1]):
            row = arrays.rows[state.places[m, p]]
            amount = goal_amount(row, parts[goal])
            if amount > 0.0:
                out[b] += amount * amount / weighted_amount(row, counts[goal])


@kernel
def _consequences(members: IntArray, experiment: Handle, bench: Handle, cost: FloatArray, reward: FloatArray) -> None:
    state, rules = opened(ExperimentState, experiment), opened(BenchRules, bench)
    for b in range(members.shape[0]):
        m = members[b]
        happened = 0.0
        for k in range(rules.event_weights.shape[0]):
            happened += rules.event_weights[k] * state.events[m, k]
        cost[m] += happened
        reward[m] -= rules.event_price * happened + rules.illegal_price * state.illegal[m]


@kernel
def _begin(members: IntArray, experiment: Handle, bench: Handle, shelf: Handle, chemistry: Handle) -> None:
    """Provide clean vessels at every position but the first, and equilibrate the phases of the first one."""
    state, rules, arrays = opened(ExperimentState, experiment), opened(BenchRules, bench), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m = members[b]
        chem = chemistry[arrays.variant[m]]
        state.busy[m] = True
        state.steps[m] = 0
        state.ended[m] = False
        state.illegal[m] = False
        state.events[m, :] = 0.0
        main = arrays.rows[state.places[m, 0]]
        settle_phases(main, chem, arrays.waste[m], state.events[m], rules.work)
        partition(main, chem, rules.work)
        for p in range(1, state.places.shape[1]):
            place(arrays.rows[state.places[m, p]], rules.auxiliary_capacity, chem)


@kernel
def _blur(
    members: IntArray,
    experiment: Handle,
    noise: FloatArray,
    resolution: FloatArray,
    work: StreamArray,
    out: ObservationArray,
) -> None:
    """Apply noise [size] and resolution [size] to the first values of observations ``out`` [B, any].

    Half of the noise's variance is drawn for the experiment, half for the step. It follows from the experiment's stream
    and step, so that it is the same whenever a step is observed.
    """
    state = opened(ExperimentState, experiment)
    for b in range(members.shape[0]):
        m = members[b]
        if state.busy[m]:
            work[0] = state.noise_stream[m, 0]
            work[1] = state.noise_stream[m, 0] ^ (np.uint64(1 + state.steps[m]) * _APART)
            work[1] = random_bits(work[1:])
            for k in range(noise.shape[0]):
                value = float(out[b, k])
                if noise[k] > 0.0:
                    value += noise[k] * math.sqrt(0.5) * (normal(work[:1]) + normal(work[1:]))
                if resolution[k] > 0.0:
                    value = resolution[k] * math.floor(value / resolution[k] + 0.5)
                out[b, k] = min(max(value, 0.0), 1.0)


def _is_usual(space: gymnasium.Space[Any]) -> bool:
    """Return True for the kinds of action space that all interfaces support."""
    if isinstance(space, gymnasium.spaces.Discrete):
        return bool(space.start == 0)
    if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
        return False
    return bool((space.low == 0.0).all() and (space.high == 1.0).all())


class Experiments:
    """One bench of N laboratories: the arrays of its running experiments.

    They are the fields of :class:`ExperimentState` and the bench's own, as attributes.

    Args:
        agent: name of the agent that operates it.
        bench: the bench.
        places: [N, P] row of each position's vessel in ``shelf.rows``.
        shared: arrays owned by others, by field.
    """

    def __init__(self, agent: str, bench: Bench, places: IntArray, **shared: npt.NDArray[Any]) -> None:
        self.agent = agent
        empty: Any = Table.empty(bench.state_declaration, **bench.state_sizes(*places.shape))
        self.table = Table(empty.arrays._replace(places=places, **shared))

    @property
    def handle(self) -> Handle:
        """Pointer table of the state."""
        return self.table.handle

    def __getattr__(self, name: str) -> Any:
        if name == "table" or name.startswith("__"):
            raise AttributeError(name)  # while a copy is being made
        return getattr(self.table.arrays, name)

    def share(self, **shared: npt.NDArray[Any]) -> None:
        """Replace some of the arrays by arrays owned by others."""
        self.table = Table(self.table.arrays._replace(**shared))

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return every array that changes while experiments run, for snapshots."""
        return self.table.changing()


class Bench(ABC):
    """A kind of bench of one scenario: observations, actions, and score of an experiment.

    A bench holds no experiment: its methods work on a :class:`Shelf` and an :class:`Experiments`, for the laboratories
    ``members`` [B]. The same object therefore serves single environments, batches and laboratories. To add a bench,
    subclass this in your own file and name it in the scenario (``kind = "my_bench.py:Class"``, or
    ``package.module:Class``).
    """

    options_model: ClassVar[type[BaseModel]]
    """Pydantic model of the bench's own scenario keys."""
    positions: ClassVar[tuple[str, ...]] = ("main",)
    """Names of the positions of its vessels, the main vessel first."""
    own_state: ClassVar[tuple[type, ...]] = ()
    """Schemas of further arrays of its experiments besides :class:`ExperimentState`."""
    own_rules: ClassVar[tuple[type, ...]] = ()
    """Schemas of further static parameters besides :class:`BenchRules`; see :meth:`rules_values`."""
    score_meaning: ClassVar[str] = "score"
    """Meaning of an experiment's score, for people."""
    model_methods: ClassVar[tuple[str, ...]] = ()
    """Methods of the model that may replace its physics (:mod:`chemlab.roles.models`); empty: it takes none."""
    camera: ClassVar[bool] = False
    """True if it observes its vessels with a layer camera."""

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        for name in () if is_bundled(cls) else ("prepare", "act", "see", "mask", "measure", "release"):
            if name in vars(cls):
                setattr(cls, name, _guarded(name, vars(cls)[name]))

    def __init__(self, key: str, scenario: Scenario, chemistry: ChemistryTable) -> None:
        self.key = key
        self.scenario = scenario
        self.spec: BenchSpec = scenario.benches[key]
        self.chemistry = chemistry
        self.goals = Goals.of(scenario)
        self.options: Any = validated(
            self.options_model,
            self.spec.model_extra or {},
            f"{scenario.origin}: benches.{key}",
            others=list(type(self.spec).model_fields),
        )
        self.auxiliary_capacity_l = float(getattr(self.options, "auxiliary_capacity_l", 1.0))
        self.step_limit = self.spec.step_limit
        self.rules: Table[Any]
        self.channels: tuple[Channel, ...] = ()
        self.action_space: gymnasium.Space[Any]
        self.observation_space: gymnasium.spaces.Box
        self.grades = Grades(scenario, key)
        self.told = scenario.world.told_to(key)
        self._told_numbers = scenario.world.numbers(self.told)
        self.model: Any = load_model(scenario, key, self.model_methods)
        """Replaces the built-in physics where the scenario names one."""
        self._model_name = f"{scenario.origin}: benches.{key}.model: {self.spec.model}"
        self._added = load_parts(self.spec.observe, scenario, f"benches.{key}.observe", Observation)
        self._terms = load_parts(self.spec.reward, scenario, f"benches.{key}.reward", Callable)

    @property
    def layout(self) -> Layout:
        """Layout of a vessel row."""
        return self.chemistry.layout

    @property
    def known(self) -> Chemistry:
        """The chemistry of the data files."""
        return self.chemistry.world()

    @property
    def state_declaration(self) -> Any:
        """Schema of the arrays of its experiments."""
        graded = (GradeState,) if self.grades.names or self.told else ()
        return merged(ExperimentState, *self.own_state, *graded)

    def state_sizes(self, members: int, positions: int) -> dict[str, int]:
        """Return the length of every axis of the experiments' arrays by name."""
        sizes = {"N": members, "P": positions, "E": len(self.scenario.safety_events), "1": 1, "2": 2}
        return {**sizes, "T": self._told_numbers}

    def rules_values(self) -> dict[str, Any]:
        """Return the values of the bench's own static parameters by field."""
        return {}

    def _set_rules(self) -> None:
        """Build the static parameters for kernels."""
        scenario, columns = self.scenario, self.layout.fluid_columns
        safety, wear = scenario.safety, self.spec.wear or WearSpec()
        declaration = merged(BenchRules, *self.own_rules)
        values = {
            "parts": self.goals.parts,
            "event_weights": np.array([safety.weights.get(kind, 0.0) for kind in scenario.safety_events]),
            "event_price": safety.reward_price,
            "illegal_price": scenario.costs.illegal_action,
            "step_limit": self.step_limit,
            "auxiliary_capacity": self.auxiliary_capacity_l,
            "wear_actuator": HEAT if wear.actuator == "heat" else STIR,
            "wear_gain": wear.gain,
            "wear_spread": wear.spread,
            "wear_drift": wear.drift,
            "wear_life": wear.life,
            "work": np.zeros(
                np.maximum((columns + 9, max(columns + 1, len(WAVELENGTHS_NM))), work_size(self.chemistry))
            ),
        }
        self.rules = Table(declaration(**values, **self.rules_values()))

    def _set_spaces(self, channels: Sequence[Channel], action_space: gymnasium.Space[Any]) -> None:
        """Set the observation channels and the action space.

        The goal's one-hot is appended, and then the channels of the scenario's ``observe``.
        """
        goal = Channel("goal", len(self.goals.names), "one-hot", 0.0, 1.0, "goal: " + ", ".join(self.goals.names))
        most = f"least mol (1: {self.grades.largest:g}), least purity, ticks allowed (1: {self.step_limit})"
        graded = [Channel("grade", 3, "fraction", 0.0, 1.0, most)] if self.grades.names else []
        if self.told:
            graded.append(told_channel(self.told, self._told_numbers))
        self._errors = self._channel_errors(channels)
        self._graded_from = sum(channel.size for channel in (*channels, goal))
        self._added_from = self._graded_from + sum(channel.size for channel in graded)
        added = [part.declared(name, self) for name, part in self._added.items()]
        where = f"{self.scenario.origin}: benches.{self.key}"
        self.channels = distinct_channels((*channels, goal, *graded, *added), where)
        size = sum(channel.size for channel in self.channels)
        if not _is_usual(action_space):
            raise PartError(
                f"{where}: {self.kind}: its actions must be Discrete(n), from 0, or Box(0.0, 1.0, (n,)), given "
                f"{action_space}"
            )
        self.observation_space = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)
        self.action_space = action_space
        self._set_rules()

    def _channel_errors(self, channels: Sequence[Channel]) -> tuple[FloatArray, FloatArray] | None:
        """Return noise and resolution [size] of the bench's own values; None if all are exact."""
        found = []
        for key in ("noise", "resolution"):
            named: dict[str, float] = getattr(self.spec, key)
            unknown = [name for name in named if name not in {channel.name for channel in channels}]
            if unknown:
                raise DataError(
                    f"{self.scenario.origin}: benches.{self.key}.{key}: unknown channel {unknown[0]!r}; choose from "
                    f"{', '.join(channel.name for channel in channels)}"
                )
            found.append(np.concatenate([np.full(one.size, named.get(one.name, 0.0)) for one in channels]))
        return (found[0], found[1]) if self.spec.noise or self.spec.resolution else None

    @property
    def kind(self) -> str:
        """Kind of the bench as named in the scenario: ``reaction``, ``extraction``, ..."""
        return self.spec.kind

    @property
    def action_count(self) -> int:
        """Number of discrete actions; 0 for continuous actions."""
        return int(self.action_space.n) if isinstance(self.action_space, gymnasium.spaces.Discrete) else 0

    @property
    def end_action(self) -> int:
        """Discrete action that ends the experiment or, if there is none, changes nothing; by default the last one."""
        return self.action_count - 1

    @property
    def action_meanings(self) -> list[str]:
        """Description of each action, or of each number of a continuous action."""
        raise NotImplementedError(f"bench {self.key!r} does not describe its actions")

    def action_words(self, action: Any) -> str:
        """An action in words; of a continuous one, its numbers."""
        if self.action_count:
            return self.action_meanings[int(action)]
        return ", ".join(f"{float(value):.2f}" for value in action)

    def representative_actions(self) -> list[tuple[str, FloatArray]]:
        """Return the discretised actions (``actions = "discrete"``): a description and the numbers [n] of each.

        The last one changes nothing. By default: each number at its low and high end, the others in the middle.
        """
        middle = np.full(len(self.action_meanings), 0.5)
        ways = []
        for i, words in enumerate(self.action_meanings):
            for level in (0.0, 1.0):
                row = middle.copy()
                row[i] = level
                ways.append((f"{words}: {level:g}", row))
        return [*ways, ("all in the middle", middle)]

    def material(self, name: str, key: str) -> int:
        """Return the index of a material that an option names.

        Raises:
            DataError: the material is unknown; the message names the option.
        """
        if name not in self.layout.materials:
            raise DataError(
                f"{self.scenario.origin}: benches.{self.key}.{key}: no material {name!r} in this scenario; choose from "
                f"{', '.join(self.layout.materials)}, or add it to the stock: stock.{toml_key(name)} = 1.0 (mol)"
            )
        return self.layout.index(name)

    def begin(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:
        """Start experiments: the first position's vessel is in place, and ``experiments.goal`` is set."""
        _begin(members, *self._handles(shelf, experiments))
        if self._errors is not None:
            experiments.stream[members] += _APART  # no two experiments have the same noise
            experiments.noise_stream[members] = experiments.stream[members]
        self.prepare(shelf, experiments, members)
        experiments.baseline[members] = self.measure(shelf, experiments, members)

    def prepare(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:  # noqa: B027 - may stay empty
        """Run the bench-specific part of :meth:`begin`."""

    def finish(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        """End experiments and return their scores [B]."""
        score: FloatArray = self.measure(shelf, experiments, members) - experiments.baseline[members]
        if self.grades.names:
            met = self.grades.met(experiments.grade[members], self.best(shelf, experiments, members))
            score = np.where(met, score, np.minimum(score, 0.0))
        experiments.busy[members] = False
        self.release(shelf, experiments, members)
        return score

    def best(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        """Return [B, 2] mol of the goal and its purity, as orders count it, in the vessel with the most of it."""
        rows, goal = shelf.rows[experiments.places[members]], experiments.goal[members]
        return best_vessel(rows, self.goals.parts[goal], self.goals.order_counts[goal])

    def reported(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        """Return [B, 3] the self-reported outcomes of ending experiments from 0 to 1: see :data:`.grades.REPORT`."""
        said = self.best(shelf, experiments, members)
        said[:, 0] /= self.grades.largest
        experiments.stream[members] += _APART  # the noise of observations began with the same numbers
        noisy(members, self.spec.report or 0.0, experiments.stream, said)
        return np.column_stack([said, experiments.steps[members] / self.step_limit])

    def release(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> None:  # noqa: B027 - may stay empty
        """Run the bench-specific part of :meth:`finish`: prepare the vessels for the shelf."""

    @abstractmethod
    def measure(self, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
        """Return [B] the measure whose change is the experiment's score."""

    @abstractmethod
    def act(self, shelf: Shelf, experiments: Experiments, members: IntArray, actions: npt.NDArray[Any]) -> None:
        """Step the experiments of ``members``; fills the experiments' steps, ended, illegal and events."""

    @abstractmethod
    def see(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: ObservationArray) -> None:
        """Write the bench's own channels and the goal's into ``out`` [B, size]; zeros for an idle bench."""

    def observe(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: ObservationArray) -> None:
        """Write the agents' observations into ``out`` [B, observation size]; zeros for an idle bench."""
        self.see(shelf, experiments, members, out)
        if self._errors is not None:
            _blur(members, experiments.handle, *self._errors, np.zeros(2, dtype=np.uint64), out)
        if not is_bundled(type(self)):  # the results of bundled benches are within bounds
            name = f"{self.scenario.origin}: benches.{self.key}: {self.kind}"
            vessels = shelf.rows[experiments.places[members]]
            check_vessels(vessels.reshape(-1, vessels.shape[-1]), f"{name}: act()")
            seen = out[:, : self._graded_from]
            seen[:] = checked_numbers(seen, seen.shape, f"{name}: see()", 0.0, 1.0)
        at = self._graded_from
        if self.grades.names:
            out[:, at : at + 3] = self.grades.shown[experiments.grade[members]] * experiments.busy[members][:, None]
            at += 3
        if self.told:
            out[:, at : self._added_from] = experiments.told[members] * experiments.busy[members][:, None]
        if self._added:
            self._observe_added(shelf, experiments, members, out)

    def _observe_added(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: ObservationArray) -> None:
        busy, at = experiments.busy[members], self._added_from
        some = members[busy]
        out[:, at:] = 0.0
        if len(some):
            for (name, part), channel in zip(self._added.items(), self.channels[-len(self._added) :], strict=True):
                seen = part.seen(name, len(some), channel.size, self, shelf, experiments, some)
                out[busy, at : at + channel.size] = seen
                at += channel.size

    @abstractmethod
    def mask(self, shelf: Shelf, experiments: Experiments, members: IntArray, out: MaskArray) -> None:
        """Write the legal actions into ``out`` [B, actions] (1 = legal); not for continuous actions."""

    @abstractmethod
    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        """Return the action as an array of one member.

        Raises:
            ValueError: it is outside the action space.
        """

    def consequences(
        self,
        shelf: Shelf,
        experiments: Experiments,
        members: IntArray,
        cost: FloatArray,
        reward: FloatArray,
        begun: bool = False,
    ) -> None:
        """Add the consequences of the last action to ``cost`` [N] and ``reward`` [N].

        They are weighted safety events, their price, the penalty of an invalid action, and the scenario's own terms. An
        experiment whose quality requirement allows no more ticks ends. ``begun``: the experiments have only started,
        without an action, so there are no terms.
        """
        _consequences(members, experiments.handle, self.rules.handle, cost, reward)
        if begun:
            return
        if self.grades.names:
            experiments.ended[members] |= experiments.steps[members] >= self.grades.ticks[experiments.grade[members]]
        for name, term in self._terms.items():
            with blamed(name):
                earned = term(self, shelf, experiments, members)
            reward[members] += checked_numbers(earned, members.shape, name)

    def memory(self, experiments: Experiments, members: IntArray) -> list[Quantity]:
        """The bench's own state in the global state (``env.state()``) of laboratories ``members`` [B].

        The arrays of ``own_state`` that a class of your own declares are part of it by themselves, scaled to [0, 1] as
        0.5 + arctan(x) / pi. Override this to give them units and bounds. Bundled benches list what does not follow
        from the contents of their vessels.
        """
        found = []
        for declaration in self.own_state:
            for field in () if is_bundled(declaration) else declared(declaration):
                if field.field.kept and "N" in field.axes:
                    array = np.moveaxis(getattr(experiments, field.name), field.axes.index("N"), 0)[members]
                    scaled = 0.5 + np.arctan(np.nan_to_num(array.astype(np.float64))) / np.pi
                    found.append(Quantity(field.name, "scaled", "0.5 + arctan(x) / pi of its own", scaled))
        return found

    def _handles(self, shelf: Shelf, experiments: Experiments) -> tuple[Handle, Handle, Handle, Handle]:
        """Return the pointer tables that most of a bench's kernels take."""
        return experiments.handle, self.rules.handle, shelf.handle, shelf.chemistry.handles

    def separate_scratch(self) -> Bench:
        """Return the same bench with its own scratch arrays, for use in another thread."""
        other = copy.copy(self)
        other.rules = self.rules.copy()
        return other

    def purity_measure(
        self, shelf: Shelf, experiments: Experiments, members: IntArray, counts: FloatArray
    ) -> FloatArray:
        """Return [B] the sum over the positions of mol of the goal x its purity."""
        out = np.empty(len(members))
        _purity_scores(members, experiments.handle, shelf.handle, self.goals.parts, counts, out)
        return out


def check_discrete(agent: str, action: Any, count: int) -> int:
    """Return the action as an int in [0, count).

    Raises:
        ValueError: it is not; the message names agent, expected and given.
    """
    value = action.item() if isinstance(action, np.ndarray) and action.ndim == 0 else action
    if isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.bool_)) and 0 <= value < count:
        return int(value)
    raise ValueError(f"{agent}: action must be an integer from 0 to {count - 1}, given {action!r}")


def check_box(agent: str, action: Any, size: int) -> FloatArray:
    """Return the action as float64 [size] within [0, 1].

    Raises:
        ValueError: it is not; the message names agent, expected and given.
    """
    try:
        value = np.asarray(action)
    except (TypeError, ValueError):
        value = np.empty(0)
    if (
        value.shape != (size,)
        or value.dtype.kind not in "fiu"
        or not all(0.0 <= number <= 1.0 for number in value.tolist())
    ):
        raise ValueError(f"{agent}: action must be {size} finite numbers from 0 to 1, given {action!r}")
    return value.astype(np.float64)
