"""Many experiments on one kind of bench, without the laboratory around it: what single-bench environments are views
of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..bench.base import MaskArray, ObservationArray, Station, build_bench, seed_streams
from ..bench.models import ReactionModel, SeparationModel
from ..materials import DataError
from ..physics.layers import uniform
from ..scenario import Scenario, load_scenario
from ..shelf import FloatArray, IntArray, Shelf, StreamArray, build_chemistry

__all__ = ["BenchArena"]


class BenchArena:
    """N independent experiments of one bench of a scenario, in one set of arrays.

    Args:
        scenario: a shipped name, a path, or a loaded scenario.
        bench: the bench's key in the scenario (``rxn``, ``ext``, ``dit``, ...).
        members: N.
        goals: goals an experiment may be run for (default: all of the scenario's).
        reaction_model, separation_model: physics of your own.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        bench: str,
        members: int = 1,
        goals: Sequence[str] | None = None,
        reaction_model: ReactionModel | None = None,
        separation_model: SeparationModel | None = None,
    ) -> None:
        self.scenario = load_scenario(scenario)
        if bench not in self.scenario.benches:
            raise DataError(f"bench: {self.scenario.name} has {', '.join(self.scenario.benches)}, given {bench!r}")
        layout, chemistry = build_chemistry(self.scenario)
        self.bench = build_bench(bench, self.scenario, layout, chemistry, reaction_model, separation_model)
        chosen = tuple(self.scenario.goals) if goals is None else tuple(goals)
        unknown = [goal for goal in chosen if goal not in self.scenario.goals]
        if unknown or not chosen:
            raise DataError(f"goals: {self.scenario.name} has {', '.join(self.scenario.goals)}, given {goals!r}")
        self._goals = np.array([self.scenario.goals.index(goal) for goal in chosen])
        positions = len(self.bench.positions)
        self.shelf = Shelf.empty(self.scenario, members, positions)
        self.station = Station.empty(
            f"{bench}_0", self.bench, np.arange(members * positions).reshape(members, positions)
        )
        self.start_stream: StreamArray = np.zeros((members, 1), dtype=np.uint64)
        self.members: IntArray = np.arange(members)
        self._stock = np.array([self.scenario.stock.get(name, 0.0) for name in layout.materials])

    def seed(self, member: int, seed: int) -> None:
        """Start the member's random streams afresh."""
        streams = (self.station.stream, self.start_stream)
        seed_streams(np.random.SeedSequence(seed), streams, member)

    def reset(self, members: IntArray, goal: int | None = None) -> None:
        """Begin new experiments from the paper's starting state, for a goal drawn from the stream or given by index."""
        start = self.bench.spec.start
        names = self.scenario.goals
        for m in members:
            drawn = self._goals[int(uniform(self.start_stream[m]) * len(self._goals))] if goal is None else goal
            chance = uniform(self.start_stream[m])
            contents = dict(start.contents)
            name = names[drawn]
            if start.goal_mol > 0.0:
                contents[name] = contents.get(name, 0.0) + start.goal_mol
            if start.companion is not None and chance < start.companion.probability:
                other = start.companion.if_goal if name == start.companion.material else start.companion.material
                contents[other] = contents.get(other, 0.0) + start.companion.mol
            self.station.goal[m] = drawn
            self.shelf.vessels[m] = 0.0
            self.shelf.fill(m, 0, start.capacity_l, contents)
            self.shelf.stock[m] = self._stock
            self.shelf.waste[m] = 0.0
        self.bench.begin(self.shelf, self.station, members)

    def act(self, actions: npt.NDArray[Any], members: IntArray | None = None) -> None:
        """One step of the experiments of ``members`` (default: all)."""
        self.bench.act(self.shelf, self.station, self.members if members is None else members, actions)

    def finish(self, members: IntArray) -> FloatArray:
        """End experiments; their scores [B]."""
        return self.bench.finish(self.shelf, self.station, members)

    def observe(self, out: ObservationArray | None = None) -> ObservationArray:
        """[N, observation size] what the agents see."""
        if out is None:
            out = np.zeros((len(self.members), *(self.bench.observation_space.shape)), dtype=np.float32)
        self.bench.observe(self.shelf, self.station, self.members, out)
        return out

    def mask(self) -> MaskArray:
        """[N, actions] legal actions (discrete benches)."""
        out = np.zeros((len(self.members), int(self.bench.action_space.n)), dtype=np.int8)  # type: ignore[attr-defined]
        self.bench.mask(self.shelf, self.station, self.members, out)
        return out
