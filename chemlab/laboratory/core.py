"""N laboratories in one set of arrays: turns, experiments, rewards. Every environment is a view of this."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ..bench.base import (
    CAMERA_PIXELS,
    Bench,
    Channel,
    Goals,
    MaskArray,
    ObservationArray,
    Station,
    build_bench,
    check_discrete,
    seed_streams,
)
from ..bench.instruments import InstrumentTable
from ..bench.models import ReactionModel, SeparationModel
from ..physics.events import EVENT_KINDS
from ..physics.jit import announce_compiling
from ..physics.layers import uniform
from ..scenario import SAFETY_EVENTS, Scenario, load_scenario
from ..shelf import FloatArray, IntArray, Shelf
from .actions import ManagerActions
from .manager import (
    COST_ITEMS,
    MANAGER,
    RUNNING,
    Desk,
    Rules,
    advance,
    close_actions,
    itemize,
    manager_act,
    manager_channels,
    manager_mask,
    manager_observe,
    rest_on_shelf,
    return_vessels,
)

__all__ = ["MANAGER_AGENT", "Laboratories"]

MANAGER_AGENT = "manager_0"


class Laboratories:
    """N independent laboratories of one scenario.

    Agents are numbered 0 (the manager), then the benches in the scenario's order; ``agents`` has their ids. In
    every method ``members`` [B] says which laboratories it is about; their arrays are independent of each
    other, so results do not depend on N.

    Attributes:
        rewards: [N, agents] what the last action earned each agent.
        cost: [N, agents] weighted safety events of the last action (the constrained-RL cost).
        scores: [N, agents] score of the experiment that the last action ended, NaN where none ended.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        laboratories: int = 1,
        reaction_model: ReactionModel | None = None,
        separation_model: SeparationModel | None = None,
    ) -> None:
        self.scenario = load_scenario(scenario)
        spec = self.scenario
        self.bench_agents = spec.bench_agents()
        self.agents = [MANAGER_AGENT, *self.bench_agents]
        n, slots = laboratories, spec.shelf.slots
        template = Shelf.empty(spec, 1, 1)
        kinds = {
            key: build_bench(key, spec, template.layout, template.chemistry, reaction_model, separation_model)
            for key in spec.benches
        }
        announce_compiling(manager_act, manager_observe, *(k for bench in kinds.values() for k in bench.kernels))
        self.benches: list[Bench] = [kinds[key] for key, bench in spec.benches.items() for _ in range(bench.count)]
        positions = np.array([len(bench.positions) for bench in self.benches], dtype=np.int64)
        first = slots + np.concatenate(([0], np.cumsum(positions)[:-1])).astype(np.int64)
        self.vessels_per_laboratory = int(slots + positions.sum())
        self.shelf = Shelf.empty(spec, n, self.vessels_per_laboratory)
        self.instruments = InstrumentTable(spec, self.shelf.layout, self.shelf.chemistry)
        self.actions = ManagerActions.of(spec)
        self.roles = int(positions.max())
        stations = len(self.benches)
        # One array for all stations: the manager's kernels read them together, a station sees its own row.
        self.busy = np.zeros((stations, n), dtype=np.bool_)
        self._goals = np.zeros((stations, n), dtype=np.int64)
        self._steps = np.zeros((stations, n), dtype=np.int64)
        self.stations: list[Station] = []
        for b, bench in enumerate(self.benches):
            places = np.arange(n)[:, None] * self.vessels_per_laboratory + first[b] + np.arange(positions[b])
            self.stations.append(Station.empty(self.bench_agents[b], bench, places))
        self._share_arrays()
        self.desk = Desk.empty(n, slots, stations, int(self.instruments.start[-1]), len(self.instruments.names))
        self._first_stock = np.array([spec.stock.get(name, 0.0) for name in self.shelf.layout.materials])
        self.rules = self._build_rules(positions, first)
        self.channels: list[Channel] = manager_channels(spec, self.instruments, self.roles, self.rules.largest_capacity)
        size = sum(channel.size for channel in self.channels)
        self.manager_observation_space = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)
        self.manager_action_space = gymnasium.spaces.Discrete(len(self.actions))
        self.rewards: FloatArray = np.zeros((n, len(self.agents)))
        self.cost: FloatArray = np.zeros((n, len(self.agents)))
        self.scores: FloatArray = np.full((n, len(self.agents)), np.nan)
        self.safety_totals: FloatArray = np.zeros((n, EVENT_KINDS))
        """[N, E] safety events since the episode began."""
        self._lab_goals = np.array([spec.goals.index(goal) for goal in spec.lab_goals])
        self._maximum = np.array([spec.theoretical_maximum_mol.get(goal, 1.0) for goal in spec.goals])
        columns = self.shelf.layout.fluid_columns
        self._layers = np.zeros(columns + 1, dtype=np.int64)
        self._shares = np.zeros((columns, CAMERA_PIXELS))
        self._work = np.zeros((columns + 9, max(columns + 1, CAMERA_PIXELS)))
        self._start = self._starting_shelf()
        self.members: IntArray = np.arange(n)

    def _share_arrays(self) -> None:
        """Each station's busy, goal and steps are its row of the arrays that the manager's kernels read."""
        for b, station in enumerate(self.stations):
            station.busy, station.goal, station.steps = self.busy[b], self._goals[b], self._steps[b]

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._share_arrays()

    def _build_rules(self, positions: IntArray, first: IntArray) -> Rules:
        spec, layout = self.scenario, self.shelf.layout
        goals = Goals.of(spec)
        keys = list(spec.benches)
        bench_of = np.array([keys.index(bench.key) for bench in self.benches], dtype=np.int64)
        capacities = [vessel.capacity_l for vessel in spec.shelf.vessel]
        capacities += [bench.auxiliary_capacity_l for bench in self.benches]
        return Rules(
            table=self.actions.table,
            slots=spec.shelf.slots,
            first=first,
            positions=positions,
            bench_of=bench_of,
            benches=len(keys),
            limit=np.array([bench.spec.step_limit for bench in self.benches], dtype=np.int64),
            parts=goals.parts,
            counts=goals.absolute_counts,
            molar_mass=np.array([material.molar_mass_g_mol for material in spec.materials.values()]),
            first_stock=self._first_stock,
            stocked=np.array([layout.index(name) for name in spec.stock], dtype=np.int64),
            stock_price=np.array([spec.costs.stock_per_mol.get(name, 0.0) for name in layout.materials]),
            instrument_kind=self.instruments.kind,
            reading_start=self.instruments.start,
            price=self.instruments.price,
            sample=self.instruments.sample,
            noise=self.instruments.noise,
            analytes=self.instruments.analytes,
            waste_per_l=spec.costs.waste_per_l,
            tick_price=spec.costs.tick,
            illegal_price=spec.costs.illegal_action,
            budget=spec.limits.budget,
            action_limit=spec.limits.manager_actions,
            tick_limit=spec.limits.ticks,
            largest_capacity=max(capacities),
        )

    def _starting_shelf(self) -> FloatArray:
        """[V, W] vessel rows an episode begins with: the scenario's vessels, at rest."""
        shelf = Shelf.empty(self.scenario, 1, self.vessels_per_laboratory)
        work = np.zeros((2, max(len(shelf.layout.solvents), 1)))
        for s, vessel in enumerate(self.scenario.shelf.vessel):
            row = shelf.fill(0, s, vessel.capacity_l, vessel.contents).row
            rest_on_shelf(row, shelf.chemistry, shelf.waste[0], np.zeros(EVENT_KINDS), work)
        return np.asarray(shelf.vessels[0])

    # -- episodes ---------------------------------------------------------------------------------------------

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Start the random streams of one laboratory afresh."""
        sequence = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        seed_streams(sequence, [self.desk.stream, *(station.stream for station in self.stations)], member)

    def reset(self, members: IntArray, goal: str | None = None) -> None:
        """Begin new episodes, with a laboratory goal drawn from each one's stream or given by name."""
        self.shelf.vessels[members] = self._start
        self.shelf.stock[members] = self._first_stock
        self.shelf.waste[members] = 0.0
        desk = self.desk
        for array, value in (
            (desk.reserved, -1),
            (desk.last_bench, 0),
            (desk.last_role, 0),
            (desk.reading, 0.0),
            (desk.age, -1),
            (desk.origin, 0),
            (desk.actions, 0),
            (desk.ticks, 0),
            (desk.cursor, MANAGER),
            (desk.finished, False),
            (desk.status, RUNNING),
            (desk.charges, 0.0),
            (desk.submitted, 0.0),
            (desk.illegal, False),
            (desk.begun, -1),
            (desk.recalled, -1),
        ):
            array[members] = value
        for m in members:
            draw = uniform(desk.stream[m])  # drawn even where the goal is given, so the rest of the episode is the same
            desk.goal[m] = self._lab_goals[int(draw * len(self._lab_goals))] if goal is None else self.goal_index(goal)
        self.busy[:, members] = False
        for station in self.stations:
            station.events[members] = 0.0
            station.illegal[members] = False
        self.rewards[members] = 0.0
        self.cost[members] = 0.0
        self.scores[members] = np.nan
        self.safety_totals[members] = 0.0

    def goal_index(self, goal: str) -> int:
        """Index of a laboratory goal; ``ValueError`` names the goals there are."""
        if goal not in self.scenario.lab_goals:
            raise ValueError(
                f"goal: {self.scenario.name} asks for {', '.join(self.scenario.lab_goals)}, given {goal!r}"
            )
        return self.scenario.goals.index(goal)

    # -- turns ------------------------------------------------------------------------------------------------

    def turn(self, member: int = 0) -> int:
        """Number of the agent that has the turn in a laboratory."""
        return int(self.desk.cursor[member]) + 1

    def checked(self, agent: int, action: Any) -> npt.NDArray[Any]:
        """The action as an array of one member; ``ValueError`` if it is outside the agent's action space."""
        if agent == 0:
            return np.array([check_discrete(MANAGER_AGENT, action, len(self.actions))])
        return self.benches[agent - 1].checked(self.agents[agent], action)

    def act(self, agent: int, members: IntArray, actions: npt.NDArray[Any]) -> None:
        """One turn of ``agent`` in each laboratory of ``members`` (which all give it the turn).

        Args:
            agent: number of the agent.
            members: [B] laboratories.
            actions: [B] int64, or [B, n] float64 for continuous actions, within the action space.
        """
        self.rewards[members] = 0.0
        self.cost[members] = 0.0
        self.scores[members] = np.nan
        if agent == 0:
            self._act_manager(members, actions)
        else:
            self._act_bench(agent - 1, members, actions)
        over = members[self.desk.status[members] != RUNNING]
        if len(over):
            self._settle_accounts(over)

    def _act_manager(self, members: IntArray, actions: IntArray) -> None:
        desk, shelf = self.desk, self.shelf
        manager_act(
            members,
            actions,
            self.busy,
            desk,
            self.rules,
            shelf.rows,
            self.vessels_per_laboratory,
            shelf.waste,
            shelf.chemistry,
            self._layers,
            self._shares,
            self._work,
        )
        begun, recalled = desk.begun[members], desk.recalled[members]
        if begun.max(initial=-1) >= 0:
            for b, station in enumerate(self.stations):
                some = members[begun == b]
                if len(some):
                    station.goal[some] = self.rules.table[actions[begun == b], 3]
                    self.benches[b].begin(shelf, station, some)
                    self._charge(b, some)
        if recalled.max(initial=-1) >= 0:
            for b in range(len(self.stations)):
                some = members[recalled == b]
                if len(some):
                    self._end(b, some)
        close_actions(members, desk, self.rules)

    def _act_bench(self, b: int, members: IntArray, actions: npt.NDArray[Any]) -> None:
        station = self.stations[b]
        self.benches[b].act(self.shelf, station, members, actions)
        self._charge(b, members)
        ended = members[station.ended[members]]
        if len(ended):
            self._end(b, ended)
            self.desk.finished[ended] = True
        advance(members, self.busy, self.desk, self.rules)

    def _charge(self, b: int, members: IntArray) -> None:
        """Book what the bench's last action cost: safety events and lost turns."""
        cost, reward = self.benches[b].consequences(self.stations[b], members)
        self.cost[members, b + 1] += cost
        self.rewards[members, b + 1] += reward
        self.safety_totals[members] += self.stations[b].events[members]
        self.desk.charges[members, 5] += self.scenario.safety.reward_price * cost

    def _end(self, b: int, members: IntArray) -> None:
        """End the experiment of station ``b``: its reward, and its vessels back to the shelf."""
        station, shelf = self.stations[b], self.shelf
        score = self.benches[b].finish(shelf, station, members)
        self.scores[members, b + 1] = score
        self.rewards[members, b + 1] += self.scenario.rewards.bench_local * score
        return_vessels(
            members,
            b,
            self.desk,
            self.rules,
            shelf.rows,
            self.vessels_per_laboratory,
            shelf.waste,
            station.events,
            shelf.chemistry,
            self._work,
        )

    def _settle_accounts(self, members: IntArray) -> None:
        """The episode is over: the manager's result, and everybody's share of it."""
        mix = self.scenario.rewards
        result = self.result(members)
        self.rewards[members, 0] += (mix.manager_local + mix.manager_team) * result
        self.rewards[members, 1:] += mix.bench_team * result[:, None]

    def result(self, members: IntArray) -> FloatArray:
        """[B] the manager's score: product by amount and purity, minus costs; before a submission, minus costs."""
        desk = self.desk
        itemize(members, desk, self.rules, self.shelf.stock, self.shelf.waste, self.shelf.chemistry)
        value = desk.submitted[members, 0] * desk.submitted[members, 1] / self._maximum[desk.goal[members]]
        return np.asarray(value - desk.charges[members].sum(axis=1))

    # -- what agents see --------------------------------------------------------------------------------------

    def observation_space(self, agent: int) -> gymnasium.spaces.Box:
        """The agent's observation space."""
        return self.manager_observation_space if agent == 0 else self.benches[agent - 1].observation_space

    def action_space(self, agent: int) -> gymnasium.Space[Any]:
        """The agent's action space."""
        return self.manager_action_space if agent == 0 else self.benches[agent - 1].action_space

    def observe(self, agent: int, members: IntArray, out: ObservationArray | None = None) -> ObservationArray:
        """[B, size] what an agent sees in each laboratory; a bench without an experiment sees zeros."""
        if out is None:
            out = np.empty((len(members), self.observation_space(agent).shape[0]), dtype=np.float32)
        shelf = self.shelf
        if agent == 0:
            manager_observe(
                members,
                self.busy,
                self._goals,
                self._steps,
                self.desk,
                self.rules,
                shelf.rows,
                self.vessels_per_laboratory,
                shelf.stock,
                self.roles,
                shelf.chemistry,
                out,
            )
        else:
            self.benches[agent - 1].observe(shelf, self.stations[agent - 1], members, out)
        return out

    def mask(self, agent: int, members: IntArray) -> MaskArray | None:
        """[B, actions] legal actions (1 = legal), or None where the action space is continuous."""
        space = self.action_space(agent)
        if not isinstance(space, gymnasium.spaces.Discrete):
            return None
        out = np.zeros((len(members), int(space.n)), dtype=np.int8)
        if agent == 0:
            manager_mask(members, self.busy, self.desk, self.rules, self.shelf.rows, self.vessels_per_laboratory, out)
        else:
            self.benches[agent - 1].mask(self.shelf, self.stations[agent - 1], members, out)
        return out

    def costs(self, member: int = 0) -> dict[str, float]:
        """What the manager has been charged so far, by item, in units of the score."""
        self.result(np.array([member]))
        return {item: float(value) for item, value in zip(COST_ITEMS, self.desk.charges[member], strict=True)}

    def events(self, agent: int, member: int = 0) -> dict[str, float]:
        """Safety events of the agent's last action, by kind; only those that happened."""
        if agent == 0:
            return {}
        row = self.stations[agent - 1].events[member]
        return {kind: float(value) for kind, value in zip(SAFETY_EVENTS, row, strict=True) if value != 0.0}

    # -- state ------------------------------------------------------------------------------------------------

    def _arrays(self) -> list[npt.NDArray[Any]]:
        state = [self.shelf.vessels, self.shelf.stock, self.shelf.waste, *self.desk]
        for station in self.stations:
            state += station.arrays()
        return [*state, self.rewards, self.cost, self.scores, self.safety_totals]

    def snapshot(self) -> list[npt.NDArray[Any]]:
        """Copies of every array that changes, for :meth:`restore`."""
        return [array.copy() for array in self._arrays()]

    def restore(self, snapshot: list[npt.NDArray[Any]]) -> None:
        """Put back a :meth:`snapshot`; everything then goes on exactly as it did."""
        for array, saved in zip(self._arrays(), snapshot, strict=True):
            array[...] = saved
