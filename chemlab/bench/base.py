"""What every bench has: positions, observation channels, actions, a score; and the arrays of its experiments."""

from __future__ import annotations

import copy
import importlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

from ..materials import DataError, validated
from ..physics.events import EVENT_KINDS
from ..physics.jit import helper, kernel
from ..physics.partition import partition
from ..physics.phases import settle_phases
from ..physics.transfer import place
from ..scenario import SAFETY_EVENTS, BenchSpec, Scenario
from ..shelf import AMOUNTS, WAVELENGTHS_NM, Chemistry, FloatArray, IntArray, Layout, Shelf, StreamArray

if TYPE_CHECKING:
    from .models import ReactionModel, SeparationModel

__all__ = [
    "BENCH_KINDS",
    "CAMERA_PIXELS",
    "Bench",
    "Channel",
    "Goals",
    "Station",
    "build_bench",
    "channel_slices",
    "check_box",
    "check_discrete",
    "goal_amount",
    "seed_streams",
    "weighted_amount",
]

BoolArray = npt.NDArray[np.bool_]
ObservationArray = npt.NDArray[np.float32]
MaskArray = npt.NDArray[np.int8]

CAMERA_PIXELS = 100

BENCH_KINDS: dict[str, str] = {
    "reaction": "chemlab.bench.reaction:ReactionBench",
    "extraction": "chemlab.bench.extraction:ExtractionBench",
    "distillation": "chemlab.bench.distillation:DistillationBench",
}
"""Bench kinds that a scenario may name in short."""


@dataclass(frozen=True)
class Channel:
    """One part of an observation vector: ``size`` numbers, each ``unit`` in [low, high] scaled to [0, 1]."""

    name: str
    size: int
    unit: str
    low: float
    high: float
    meaning: str


def channel_slices(channels: Sequence[Channel]) -> dict[str, slice]:
    """Where each channel stands in the flat observation."""
    found, start = {}, 0
    for channel in channels:
        found[channel.name] = slice(start, start + channel.size)
        start += channel.size
    return found


@dataclass(frozen=True)
class Goals:
    """The scenario's goals as arrays: which materials are counted as the goal, and how purity counts.

    Attributes:
        parts: [G, 3] material index of the goal and, where it is a salt, of its ions (else -1).
        solute_counts: [G, M] weight of each material in the goal's solute purity: solvents 0; an ion 1 and undissolved
            salt as its two ions, but where the goal is a salt a pair of ions counts as one.
        absolute_counts: [G, M] weight in the absolute purity: everything 1, an ion 1/2 (a pair is one formula unit of
            salt, dissolved or not, so that precipitation does not change a purity).
    """

    names: tuple[str, ...]
    parts: IntArray
    solute_counts: FloatArray
    absolute_counts: FloatArray

    @classmethod
    def of(cls, scenario: Scenario) -> Goals:
        """The arrays for a scenario's goals."""
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
                    absolute[g, i] = 0.5 if role == "ion" else 1.0
                    solute[g, i] = ion if role == "ion" else 2.0 * ion if name in salts else float(role != "solvent")
        return cls(tuple(scenario.goals), parts, solute, absolute)


@helper
def goal_amount(row: FloatArray, part: IntArray) -> float:
    """mol of the goal in a vessel; of a salt, dissolved pairs of ions count as salt. ``part`` is a row of
    Goals.parts."""
    amount = row[AMOUNTS + part[0]]
    if part[1] >= 0:
        amount += min(row[AMOUNTS + part[1]], row[AMOUNTS + part[2]])
    return float(amount)


@helper
def weighted_amount(row: FloatArray, weights: FloatArray) -> float:
    """Sum of weight x mol over the materials."""
    total = 0.0
    for i in range(weights.shape[0]):
        total += weights[i] * row[AMOUNTS + i]
    return total


@kernel
def _purity_scores(
    members: IntArray,
    places: IntArray,
    goal: IntArray,
    rows: FloatArray,
    parts: IntArray,
    counts: FloatArray,
    out: FloatArray,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        out[b] = 0.0
        for p in range(places.shape[1]):
            row = rows[places[m, p]]
            amount = goal_amount(row, parts[goal[m]])
            if amount > 0.0:
                out[b] += amount * amount / weighted_amount(row, counts[goal[m]])


@kernel
def _consequences(
    members: IntArray,
    events: FloatArray,
    illegal: BoolArray,
    weights: FloatArray,
    event_price: float,
    illegal_price: float,
    cost: FloatArray,
    reward: FloatArray,
) -> None:
    for b in range(members.shape[0]):
        m = members[b]
        happened = 0.0
        for k in range(weights.shape[0]):
            happened += weights[k] * events[m, k]
        cost[m] += happened
        reward[m] -= event_price * happened + illegal_price * illegal[m]


@kernel
def _provide(
    members: IntArray,
    places: IntArray,
    rows: FloatArray,
    chem: Chemistry,
    capacity: float,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> None:
    """Clean vessels for every position but the first, and the first one brought to its phase equilibrium."""
    for b in range(members.shape[0]):
        m = members[b]
        main = rows[places[m, 0]]
        settle_phases(main, chem, waste[m], events[m], work[0])
        partition(main, chem, work)
        for p in range(1, places.shape[1]):
            place(rows[places[m, p]], capacity, chem)


@dataclass
class Station:
    """One bench of N laboratories: the arrays of its running experiments. N laboratories, P positions.

    Attributes:
        agent: id of the agent that operates it.
        places: [N, P] row of each position's vessel in ``shelf.rows``.
        busy: [N] whether an experiment is running.
        goal: [N] index of the experiment's goal.
        steps: [N] steps the experiment has taken.
        ended: [N] whether the last action ended the experiment.
        illegal: [N] whether the last action was masked (and so lost).
        baseline: [N] the bench's measure of the contents when the experiment began.
        events: [N, E] safety events of the last action.
        stream: [N, 1] random stream of the bench's own draws (camera).
        supply: [N, R] mol each reagent the experiment may still take.
        changed: [N, P] whether the last action changed a vessel, so that its layers have to be worked out again.
        layers: [N, P, C + 1] and profile: [N, P, C, pixels], the layers of its vessels.
        image: [N, P, pixels] what the camera saw last.
    """

    agent: str
    places: IntArray
    busy: BoolArray
    goal: IntArray
    steps: IntArray
    ended: BoolArray
    illegal: BoolArray
    baseline: FloatArray
    events: FloatArray
    stream: StreamArray
    supply: FloatArray
    changed: BoolArray
    layers: IntArray
    profile: FloatArray
    image: FloatArray

    @classmethod
    def empty(cls, agent: str, bench: Bench, places: IntArray) -> Station:
        """An idle bench for every laboratory of ``places`` [N, P]."""
        n, positions = places.shape
        columns = bench.layout.fluid_columns if bench.camera else 0
        return cls(
            agent=agent,
            places=places,
            busy=np.zeros(n, dtype=np.bool_),
            goal=np.zeros(n, dtype=np.int64),
            steps=np.zeros(n, dtype=np.int64),
            ended=np.zeros(n, dtype=np.bool_),
            illegal=np.zeros(n, dtype=np.bool_),
            baseline=np.zeros(n),
            events=np.zeros((n, EVENT_KINDS)),
            stream=np.zeros((n, 1), dtype=np.uint64),
            supply=np.zeros((n, bench.reagents)),
            changed=np.ones((n, positions), dtype=np.bool_),
            layers=np.zeros((n, positions, columns + 1), dtype=np.int64),
            profile=np.zeros((n, positions, columns, CAMERA_PIXELS)),
            image=np.zeros((n, positions, CAMERA_PIXELS if bench.camera else 0)),
        )

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Every array that changes while experiments run, for snapshots."""
        return [
            self.busy,
            self.goal,
            self.steps,
            self.ended,
            self.illegal,
            self.baseline,
            self.events,
            self.stream,
            self.supply,
            self.changed,
            self.layers,
            self.profile,
            self.image,
        ]


class Bench(ABC):
    """A kind of bench of one scenario: what its agent sees and may do, and what an experiment is worth.

    A bench holds no experiment: its methods work on a :class:`Shelf` and a :class:`Station`, for the laboratories
    ``members`` [B] of them. The same object therefore serves single environments, batches and laboratories. To add a
    bench, subclass this in a module of your own and name it in the scenario (``kind = "package.module:Class"``).
    """

    options_model: ClassVar[type[BaseModel]]
    """Pydantic model of the scenario keys that are this bench's own."""
    positions: ClassVar[tuple[str, ...]] = ("main",)
    """Names of the vessels it works on, the one that is brought first."""
    kernels: ClassVar[tuple[Callable[..., Any], ...]] = ()
    """The bench's largest kernels: what a first step waits for while they compile."""
    score_meaning: ClassVar[str] = "score"
    """What an experiment's score is, for people."""
    camera: ClassVar[bool] = False
    """Whether it looks at its vessels with a layer camera."""
    scratch_names: ClassVar[tuple[str, ...]] = ("work",)
    """Attributes that kernels write into while they run."""
    reagents: int = 0
    """Number of reagents an experiment has a supply of."""

    def __init__(self, key: str, scenario: Scenario, layout: Layout, chemistry: Chemistry) -> None:
        self.key = key
        self.scenario = scenario
        self.spec: BenchSpec = scenario.benches[key]
        self.layout = layout
        self.chemistry = chemistry
        self.goals = Goals.of(scenario)
        columns = layout.fluid_columns
        self.work = np.zeros((columns + 9, max(columns + 1, len(WAVELENGTHS_NM))))
        """Scratch of the bench's kernels, which allocate nothing."""
        self.options: Any = validated(
            self.options_model, self.spec.model_extra or {}, f"{scenario.origin}: benches.{key}"
        )
        self.auxiliary_capacity_l = float(getattr(self.options, "auxiliary_capacity_l", 1.0))
        weights = scenario.safety.weights
        # Looked up once: reading a field of a scenario takes as long as a small kernel.
        self._prices = scenario.safety.reward_price, scenario.costs.illegal_action
        self.step_limit = self.spec.step_limit
        self._event_weights = np.array([weights.get(kind, 0.0) for kind in SAFETY_EVENTS])
        self.channels: tuple[Channel, ...] = ()
        self.action_space: gymnasium.Space[Any]
        self.observation_space: gymnasium.spaces.Box

    def _set_spaces(self, channels: Sequence[Channel], action_space: gymnasium.Space[Any]) -> None:
        """Declare the observation channels (the goal's one-hot is added) and the action space."""
        goal = Channel("goal", len(self.goals.names), "one-hot", 0.0, 1.0, "goal: " + ", ".join(self.goals.names))
        self.channels = (*channels, goal)
        size = sum(channel.size for channel in self.channels)
        self.observation_space = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)
        self.action_space = action_space

    @property
    def kind(self) -> str:
        """What the scenario calls this kind of bench: ``reaction``, ``extraction``, ..."""
        return self.spec.kind

    @property
    def action_count(self) -> int:
        """Number of discrete actions; 0 where actions are continuous."""
        return int(self.action_space.n) if isinstance(self.action_space, gymnasium.spaces.Discrete) else 0

    @property
    def end_action(self) -> int:
        """The discrete action that ends the experiment: the last one, unless a bench says otherwise."""
        return self.action_count - 1

    @property
    def action_meanings(self) -> list[str]:
        """What each action (or each number of a continuous action) does."""
        raise NotImplementedError(f"bench {self.key!r} does not describe its actions")

    def material(self, name: str, key: str) -> int:
        """Index of a material an option names; a :class:`DataError` names the option if it is unknown."""
        if name not in self.layout.materials:
            raise DataError(
                f"{self.scenario.origin}: benches.{self.key}.{key}: unknown material {name!r}; "
                f"this scenario has: {', '.join(self.layout.materials)}"
            )
        return self.layout.index(name)

    def begin(self, shelf: Shelf, station: Station, members: IntArray) -> None:
        """Start experiments: the first position's vessel is there, ``station.goal`` is set."""
        station.busy[members] = True
        station.steps[members] = 0
        station.ended[members] = False
        station.illegal[members] = False
        station.events[members] = 0.0
        _provide(
            members,
            station.places,
            shelf.rows,
            self.chemistry,
            self.auxiliary_capacity_l,
            shelf.waste,
            station.events,
            self.work,
        )
        self.prepare(shelf, station, members)
        station.baseline[members] = self.measure(shelf, station, members)

    def prepare(self, shelf: Shelf, station: Station, members: IntArray) -> None:  # noqa: B027 - may stay empty
        """Bench-specific part of :meth:`begin`."""

    def finish(self, shelf: Shelf, station: Station, members: IntArray) -> FloatArray:
        """End experiments and return their scores [B]."""
        score = self.measure(shelf, station, members) - station.baseline[members]
        station.busy[members] = False
        self.release(shelf, station, members)
        return score

    def release(self, shelf: Shelf, station: Station, members: IntArray) -> None:  # noqa: B027 - may stay empty
        """Bench-specific part of :meth:`finish`: leave the vessels as the shelf may have them."""

    @abstractmethod
    def measure(self, shelf: Shelf, station: Station, members: IntArray) -> FloatArray:
        """What the experiment's score is the change of, [B]."""

    @abstractmethod
    def act(self, shelf: Shelf, station: Station, members: IntArray, actions: npt.NDArray[Any]) -> None:
        """One step of the experiments of ``members``; fills the station's steps, ended, illegal and events."""

    @abstractmethod
    def observe(self, shelf: Shelf, station: Station, members: IntArray, out: ObservationArray) -> None:
        """Write what the agents see into ``out`` [B, observation size]; an idle bench sees zeros."""

    @abstractmethod
    def mask(self, shelf: Shelf, station: Station, members: IntArray, out: MaskArray) -> None:
        """Write the legal actions into ``out`` [B, actions] (1 = legal); benches with continuous actions have none."""

    @abstractmethod
    def checked(self, agent: str, action: Any) -> npt.NDArray[Any]:
        """The action as an array of one member, or ``ValueError`` if it is outside the action space."""

    def consequences(self, station: Station, members: IntArray, cost: FloatArray, reward: FloatArray) -> None:
        """Add what the last action led to: to ``cost`` [N] its weighted safety events, to ``reward`` [N] what they and
        a lost turn take off."""
        _consequences(members, station.events, station.illegal, self._event_weights, *self._prices, cost, reward)

    def separate_scratch(self) -> Bench:
        """The same bench with scratch arrays of its own, for use in another thread."""
        other = copy.copy(self)
        for name, value in vars(self).items():
            if name in self.scratch_names:
                setattr(other, name, value.copy())
        return other

    def purity_measure(self, shelf: Shelf, station: Station, members: IntArray, counts: FloatArray) -> FloatArray:
        """[B] sum over the positions of (mol of the goal x its purity there)."""
        out = np.empty(len(members))
        _purity_scores(members, station.places, station.goal, shelf.rows, self.goals.parts, counts, out)
        return out


def check_discrete(agent: str, action: Any, count: int) -> int:
    """The action as an int in [0, count), or ``ValueError`` naming agent, expected and given."""
    value = action.item() if isinstance(action, np.ndarray) and action.ndim == 0 else action
    if isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.bool_)) and 0 <= value < count:
        return int(value)
    raise ValueError(f"{agent}: action must be an integer from 0 to {count - 1}, given {action!r}")


def check_box(agent: str, action: Any, size: int) -> FloatArray:
    """The action as float64 [size] within [0, 1], or ``ValueError`` naming agent, expected and given."""
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


def build_bench(
    key: str,
    scenario: Scenario,
    layout: Layout,
    chemistry: Chemistry,
    reaction_model: ReactionModel | None = None,
    separation_model: SeparationModel | None = None,
) -> Bench:
    """The bench ``key`` of a scenario; models replace the built-in physics of benches that use them.

    Raises:
        DataError: the bench kind cannot be found, or its options are wrong.
    """
    kind = scenario.benches[key].kind
    target = BENCH_KINDS.get(kind, kind)
    module, _, name = target.partition(":")
    try:
        cls = getattr(importlib.import_module(module), name)
        if not (isinstance(cls, type) and issubclass(cls, Bench)):
            raise TypeError(f"{name} is not a Bench")
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise DataError(
            f"{scenario.origin}: benches.{key}.kind: cannot load {kind!r} ({error}); "
            f"known kinds: {', '.join(BENCH_KINDS)}; or name a class as 'package.module:Class'"
        ) from error
    bench: Bench = cls(key, scenario, layout, chemistry)
    if reaction_model is not None and hasattr(bench, "reaction_model"):
        bench.reaction_model = reaction_model
    if separation_model is not None and hasattr(bench, "separation_model"):
        bench.separation_model = separation_model
    return bench


def seed_streams(seed: np.random.SeedSequence, streams: Sequence[StreamArray], member: int) -> None:
    """Set the random stream of one member in each of ``streams`` from one seed sequence."""
    for stream, state in zip(streams, seed.generate_state(len(streams), np.uint64), strict=True):
        stream[member, 0] = state
