"""Batches of experiments on one kind of bench without a laboratory, behind the single-bench environments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..config.datafile import DataError
from ..config.loading import load_scenario
from ..config.scenario import Scenario
from ..kernels.arrays import BoolArray, FloatArray, Handle, IntArray, MaskArray, ObservationArray, StreamArray
from ..kernels.jit import kernel, opened
from ..kernels.rng import uniform
from ..physics.shelf import Shelf, ShelfArrays
from ..roles.bench import Bench, Experiments, ExperimentState
from ..roles.kinds import build_bench
from ..roles.maintenance import equip, wear_out
from .episode_streams import EpisodeStreams
from .hidden import World, Worlds, world_chemistry
from .starts import Start, StartPool, draw_start, lab_starts, start_pool


@kernel
def _draw_starts(
    members: IntArray,
    goals: IntArray,
    starts: Handle,
    stream: StreamArray,
    first_stock: FloatArray,
    experiment: Handle,
    shelf: Handle,
    declared: BoolArray,
) -> None:
    """Draw a goal of ``goals`` and one of its initial states for every member, from two random numbers each.

    ``declared`` [B] receives whether the scenario declares the state.
    """
    state, arrays, pool = opened(ExperimentState, experiment), opened(ShelfArrays, shelf), opened(StartPool, starts)
    for b in range(members.shape[0]):
        m = members[b]
        state.goal[m] = goals[int(uniform(stream[m]) * goals.shape[0])]
        t = draw_start(pool, state.goal[m], stream[m])
        declared[b] = pool.declared[t]
        for p in range(state.places.shape[1]):
            arrays.rows[state.places[m, p], :] = 0.0
        for i in range(arrays.rows.shape[1]):
            arrays.rows[state.places[m, 0], i] = pool.rows[t, i]
        for i in range(arrays.stock.shape[1]):
            arrays.stock[m, i] = first_stock[i]
            arrays.waste[m, i] = 0.0


@kernel
def _draw_grades(members: IntArray, grades: int, stream: StreamArray, out: IntArray) -> None:
    """Draw one of ``grades`` quality requirements for every member."""
    for b in range(members.shape[0]):
        out[members[b]] = int(uniform(stream[members[b]]) * grades)


class ExperimentBatch:
    """N independent experiments of one bench of a scenario, in one set of arrays.

    Args:
        scenario: a bundled name, a path, or a loaded scenario.
        bench: key of the bench in the scenario (``rxn``, ``ext``, ``dit``, ...).
        members: number of experiments N.
        goals: possible goals of an experiment (default: all of the scenario's).
        starts: ``paper`` for the paper's fixed initial states, ``lab`` for vessels as they reach this bench in
            laboratory runs (see :mod:`chemlab.lab.starts`), ``both`` for either as often.

    Raises:
        DataError: unknown bench, goal or starting states.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        bench: str,
        members: int = 1,
        goals: str | Sequence[str] | None = None,
        starts: str = "paper",
    ) -> None:
        self.scenario = load_scenario(scenario)
        if bench not in self.scenario.benches:
            raise DataError(f"bench: {self.scenario.name} has {', '.join(self.scenario.benches)}, given {bench!r}")
        chemistry = world_chemistry(self.scenario, members)
        self.bench: Bench = build_bench(bench, self.scenario, chemistry)
        chosen = self.scenario.goals if goals is None else (goals,) if isinstance(goals, str) else tuple(goals)
        unknown = [goal for goal in chosen if goal not in self.scenario.goals]
        if unknown or not chosen:
            given = ", ".join(map(repr, chosen)) or repr(goals)
            raise DataError(f"goals: {self.scenario.name} has {', '.join(self.scenario.goals)}, given {given}")
        positions = len(self.bench.positions)
        places = np.arange(members * positions).reshape(members, positions)
        self.shelf = Shelf(chemistry, members, positions)
        self.worlds = Worlds(self.scenario, self.shelf)
        self.experiments = Experiments(f"{bench}_0", self.bench, places)
        self.start_stream: StreamArray = np.zeros((members, 1), dtype=np.uint64)
        self.members: IntArray = np.arange(members)
        self.episodes = EpisodeStreams(members, len(self._streams()))
        self._stock = np.array([self.scenario.stock.get(name, 0.0) for name in chemistry.layout.materials])
        self.pool = start_pool(chemistry, self.scenario, self._starts(starts))
        self._goals = np.array([self.scenario.goals.index(goal) for goal in chosen])
        counts = np.diff(self.pool.arrays.first)
        missing = [goal for goal, g in zip(chosen, self._goals, strict=True) if counts[g] == 0]
        if missing:
            there = ", ".join(goal for goal, count in zip(self.scenario.goals, counts, strict=True) if count)
            raise DataError(
                f"starts: {starts!r} has no vessel of goal {missing[0]!r} for bench {bench!r}; choose from {there} "
                "by --goal (evaluate), --goals (train) or goals=... (Python)"
            )

    def _starts(self, kind: str) -> list[Start]:
        """Return the initial states of a kind; with ``both``, either kind is equally likely."""
        if kind == "paper":
            return self._paper_starts()
        if kind == "lab":
            return lab_starts(self.scenario, self.bench.key)
        if kind != "both":
            raise DataError(f"starts: must be 'paper', 'lab' or 'both', given {kind!r}")
        found = []
        for group in (self._paper_starts(), self._starts("lab")):
            total = {goal: sum(start.weight for start in group if start.goal == goal) for goal in self.scenario.goals}
            found += [start._replace(weight=start.weight / total[start.goal]) for start in group]
        return found

    def _paper_starts(self) -> list[Start]:
        start = self.bench.spec.start
        vessels = []
        for goal in self.scenario.goals:
            contents = dict(start.contents)
            if start.goal_mol > 0.0:
                contents[goal] = contents.get(goal, 0.0) + start.goal_mol
            companion = start.companion
            chance = 0.0 if companion is None else companion.probability
            if companion is not None and chance > 0.0:
                other = companion.if_goal if goal == companion.material else companion.material
                together = {**contents, other: contents.get(other, 0.0) + companion.mol}
                vessels.append(Start(goal, chance, start.capacity_l, together, declared=True))
            if chance < 1.0:
                vessels.append(Start(goal, 1.0 - chance, start.capacity_l, contents, declared=True))
        return vessels

    def seed(self, member: int, seed: int) -> None:
        """Seed a member: the same seed gives the same series of experiments, independent of the actions."""
        self.worlds.seed(member, np.random.SeedSequence(seed), self._streams()[:-1])
        self.episodes.seed(member, self._streams())

    def _streams(self) -> list[StreamArray]:
        """Return every random stream of an experiment."""
        return [self.experiments.stream, self.start_stream, self.worlds.table.arrays.stream]

    def reset(
        self, members: IntArray, goal: int | None = None, bench: Bench | None = None, world: World | None = None
    ) -> None:
        """Start new experiments.

        Goals are drawn from each member's stream or given by index; worlds are drawn from another stream or given (see
        :meth:`chemlab.lab.hidden.Worlds.begin`). ``bench`` is the thread's own (see :meth:`Bench.separate_scratch`).

        Raises:
            ValueError: the world is invalid; nothing has changed.
        """
        self.worlds.check(world)
        self.episodes.begin(members, self._streams())
        self.worlds.begin(members, world)
        goals = self._goals if goal is None else np.array([goal])
        shelf, experiments = self.shelf, self.experiments
        experiments.table.reset(members)
        declared = np.zeros(len(members), dtype=np.bool_)
        _draw_starts(
            members,
            goals,
            self.pool.handle,
            self.start_stream,
            self._stock,
            experiments.handle,
            shelf.handle,
            declared,
        )
        if self.bench.grades.names:
            _draw_grades(members, len(self.bench.grades.names), self.start_stream, experiments.grade)
        if self.bench.told:
            experiments.told[members] = self.worlds.told(members)[self.bench.key]
        if self.worlds.active:  # recorded vessels keep their recorded contents
            self.worlds.fill(members[declared], self.bench.key)
        equip(bench or self.bench, experiments, members, self.worlds, 0, self.bench.key)
        (bench or self.bench).begin(shelf, experiments, members)

    def act(self, actions: npt.NDArray[Any], members: IntArray | None = None, bench: Bench | None = None) -> None:
        """Step the experiments of ``members`` (default: all); ``bench`` is the thread's own."""
        some, own = self.members if members is None else members, bench or self.bench
        own.act(self.shelf, self.experiments, some, actions)
        wear_out(own, self.experiments, some)

    def finish(self, members: IntArray) -> FloatArray:
        """End experiments and return their scores [B]."""
        return self.bench.finish(self.shelf, self.experiments, members)

    def observe(self, out: ObservationArray | None = None) -> ObservationArray:
        """Return [N, observation size] the agents' observations."""
        if out is None:
            out = np.zeros((len(self.members), *(self.bench.observation_space.shape)), dtype=np.float32)
        self.bench.observe(self.shelf, self.experiments, self.members, out)
        return out

    def mask(self) -> MaskArray:
        """Return [N, actions] legal actions (discrete benches)."""
        out = np.zeros((len(self.members), self.bench.action_count), dtype=np.int8)
        self.bench.mask(self.shelf, self.experiments, self.members, out)
        return out

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return every array that changes, for snapshots."""
        own = [*self.shelf.arrays(), *self.experiments.arrays(), self.start_stream]
        return [*own, *self.worlds.arrays(), *self.episodes.arrays()]
