"""N laboratories in one set of arrays: turns, experiments, rewards. Every environment is a view of them."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from typing_extensions import Unpack

from ..config.datafile import DataError
from ..config.loading import load_scenario
from ..config.scenario import MANAGER_AGENT, OrderSpec, Scenario, Settings
from ..kernels.arrays import BoolArray, FloatArray, Handle, IntArray, MaskArray, ObservationArray, StreamArray
from ..kernels.jit import kernel, opened
from ..kernels.rng import as_sequence, uniform
from ..kernels.tables import Table, put_back
from ..physics.backends import work_size
from ..physics.chemistry import AMOUNTS
from ..physics.shelf import Shelf
from ..roles.base import Role
from ..roles.bench import Bench, Channel, Experiments, Goals
from ..roles.bench_role import BenchRole
from ..roles.instrument_table import InstrumentTable
from ..roles.kinds import build_bench
from ..roles.maintenance import begin_drift, equip, maintenance_rules
from ..roles.manager import (
    OVER,
    advance,
    age_on_shelf,
    having_turn,
    itemize,
    open_turn,
    rest_on_shelf,
    turns,
)
from ..roles.manager_actions import ManagerActions
from ..roles.manager_role import ManagerRole
from ..roles.manager_state import (
    ARRIVES,
    COST_ITEMS,
    LEAST_AMOUNT,
    LEAST_PURITY,
    PRICE,
    RUNNING,
    SAFETY,
    STOCK,
    WASTE,
    WITHIN,
    ManagerState,
    Rules,
)
from ..roles.reaction_bench import ReactionBench
from .episode_streams import EpisodeStreams
from .hidden import World, Worlds, world_chemistry
from .starts import SUBMIT, StartPool, draw_start, lab_starts, start_pool


@kernel
def _draw_goals(members: IntArray, choices: IntArray, stream: StreamArray, goal: IntArray) -> None:
    """Draw every order's goal from ``choices``.

    The same number of random numbers is used for a single choice, so that the rest of the episode is the same.
    """
    for i in range(members.shape[0]):
        n = members[i]
        for o in range(goal.shape[1]):
            goal[n, o] = choices[int(uniform(stream[n]) * choices.shape[0])]


@kernel
def _draw_stages(members: IntArray, reached: FloatArray, stream: StreamArray, out: IntArray) -> None:
    """Draw the stage at which each episode begins: ``reached`` [K] is cumulative, K is the scenario's own shelf."""
    for i in range(members.shape[0]):
        draw = uniform(stream[members[i]])
        k = 0
        while k < reached.shape[0] and draw >= reached[k]:
            k += 1
        out[i] = k


@kernel
def _put_starts(members: IntArray, starts: Handle, manager: Handle, vessels: FloatArray) -> None:
    """Replace the first vessel on the shelf by one of the pool's for the first order's goal."""
    state, pool = opened(ManagerState, manager), opened(StartPool, starts)
    for i in range(members.shape[0]):
        n = members[i]
        t = draw_start(pool, state.goal[n, 0], state.stream[n])
        for column in range(vessels.shape[2]):
            vessels[n, 0, column] = pool.rows[t, column]
        state.last_bench[n, 0] = pool.last_bench[t]
        state.last_position[n, 0] = pool.last_position[t]


class Laboratories:
    """N independent laboratories of one scenario.

    ``agents`` has the names of the agents, ``roles`` the role of each in the same order; ``manager`` and
    ``bench_roles`` are the same roles by kind. An agent's index has no other meaning. In every method ``members`` [B]
    are the laboratories that it is about; their arrays are independent of each other, so results do not depend on N.
    ``settings`` are those of :meth:`~chemlab.config.scenario.Scenario.configured`.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        laboratories: int = 1,
        **settings: Unpack[Settings],
    ) -> None:
        self.scenario = load_scenario(scenario, **settings)
        spec = self.scenario
        self.bench_agents = spec.bench_agents()
        self.agents = spec.agents()
        n, slots = laboratories, spec.shelf.slots
        chemistry = world_chemistry(spec, n)
        kinds = {key: build_bench(key, spec, chemistry) for key in spec.benches}
        self.benches: list[Bench] = [kinds[key] for key, bench in spec.benches.items() for _ in range(bench.count)]
        positions = np.array([len(bench.positions) for bench in self.benches], dtype=np.int64)
        if (most := int(positions.max())) > slots:
            key = self.benches[int(positions.argmax())].key
            raise DataError(f"{spec.origin}: shelf.slots: bench {key!r} needs at least {most} slots, given {slots}")
        first = slots + np.concatenate(([0], np.cumsum(positions)[:-1])).astype(np.int64)
        self.vessels_per_laboratory = int(slots + positions.sum())
        self.shelf = Shelf(chemistry, n, self.vessels_per_laboratory)
        self.worlds = Worlds(spec, self.shelf)
        self.instruments = InstrumentTable(spec, chemistry)
        self.actions = ManagerActions.of(spec)
        upkeep = maintenance_rules(spec)
        drifting, wearing = len(upkeep["drift_first"]), len(upkeep["repair_price"])
        numbers_read = int(self.instruments.rules.arrays.start[-1])
        self.table: Table[ManagerState] = Table.empty(
            ManagerState,
            **{
                "N": n,
                "S": slots,
                "B": len(self.benches),
                "G": len(self.agents),
                "O": spec.orders,
                "1": 1,
                "2": 2,
                "3": 3,
                "5": 5,
            },
            F=len(self.benches) if any(bench.report is not None for bench in spec.benches.values()) else 0,
            K=len(spec.demand.order),
            T=spec.world.numbers(spec.world.told_to("manager")),
            C=spec.orders if spec.demand.feedback not in (0.0, "none") else 0,
            I=len(self.instruments.names),
            R=numbers_read,
            W=wearing,
            D=drifting,
            Z=numbers_read if drifting else 0,
            M=len(chemistry.layout.materials),
            E=len(spec.safety_events),
            items=len(COST_ITEMS),
        )
        self.state = self.table.arrays
        self.experiments: list[Experiments] = []
        for b, bench in enumerate(self.benches):
            places = np.arange(n)[:, None] * self.vessels_per_laboratory + first[b] + np.arange(positions[b])
            self.experiments.append(Experiments(self.bench_agents[b], bench, places, **self._shared(b)))
        self._first_stock = np.array([spec.stock.get(name, 0.0) for name in chemistry.layout.materials])
        self.rules = Table(self._build_rules(positions, first))
        self.experiment_ended = False
        """True if the last turn or round has ended an experiment anywhere, so that there are scores."""
        self.manager = ManagerRole(self, MANAGER_AGENT)
        pairs = zip(self.benches, self.experiments, strict=True)
        self.bench_roles = [BenchRole(self, b, bench, own) for b, (bench, own) in enumerate(pairs)]
        self.roles: list[Role] = sorted([self.manager, *self.bench_roles], key=lambda role: role.index)
        """Role of every agent, in the order of ``agents``."""
        self._by_cursor = np.array([role.index for role in (*self.bench_roles, self.manager)])
        """Index of the agent that has the turn, by cursor; the manager's, which is -1, stands last."""
        self.observation_sizes = [int(role.observation_space.shape[0]) for role in self.roles]
        self.action_counts = [role.action_count for role in self.roles]
        """Number of each agent's discrete actions; 0 for continuous actions."""
        self._lab_goals = np.array([spec.goals.index(goal) for goal in spec.lab_goals])
        self._prepared: tuple[FloatArray, list[Table[StartPool]]] | None = None
        self.members: IntArray = np.arange(n)
        self.episodes = EpisodeStreams(n, len(self._streams()))

    def _shared(self, b: int) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays that the experiments of bench ``b`` share with the manager's kernels: its row of each."""
        broken = {"broken": self.state.broken[b]} if len(self.state.broken) else {}
        return {
            "busy": self.state.busy[b],
            "goal": self.state.bench_goal[b],
            "steps": self.state.bench_steps[b],
            **broken,
        }

    @property
    def busy(self) -> BoolArray:
        """[benches, N] whether an experiment is running."""
        return self.state.busy

    @property
    def safety_totals(self) -> FloatArray:
        """[N, E] safety events of the episode so far."""
        return self.state.safety_totals

    @property
    def rewards(self) -> FloatArray:
        """[N, agents] rewards of the last turn or round."""
        return self.state.rewards.T

    @property
    def cost(self) -> FloatArray:
        """[N, agents] weighted safety events of the last turn or round (the constrained-RL cost)."""
        return self.state.cost.T

    @property
    def scores(self) -> FloatArray:
        """[N, agents] scores of the experiments that ended, else NaN."""
        return self.state.scores.T

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.state = self.table.arrays  # a copy has its own arrays, which its parts share again
        for b, experiments in enumerate(self.experiments):
            experiments.share(**self._shared(b))

    def _build_rules(self, positions: IntArray, first: IntArray) -> Rules:
        spec, layout = self.scenario, self.shelf.layout
        goals = Goals.of(spec)
        keys = list(spec.benches)
        bench_of = np.array([keys.index(bench.key) for bench in self.benches], dtype=np.int64)
        capacities = [vessel.capacity_l for vessel in spec.shelf.vessel]
        capacities += [bench.auxiliary_capacity_l for bench in self.benches]
        capacities += [bench.options.vessel_volume_l for bench in self.benches if isinstance(bench, ReactionBench)]
        table, wanted = self.instruments.rules.arrays, spec.specifications
        return Rules(
            table=self.actions.table,
            manager=self.agents.index(MANAGER_AGENT),
            agent=np.array([self.agents.index(agent) for agent in self.bench_agents], dtype=np.int64),
            slots=spec.shelf.slots,
            first=first,
            positions=positions,
            most_positions=int(positions.max()),
            bench_of=bench_of,
            kinds=len(keys),
            limit=np.array([bench.spec.step_limit for bench in self.benches], dtype=np.int64),
            parts=goals.parts,
            counts=goals.order_counts,
            maximum=np.array([spec.theoretical_maximum_mol.get(goal, 1.0) for goal in spec.goals]),
            share=spec.rewards.manager_local + spec.rewards.manager_team,
            first_stock=self._first_stock,
            stocked=np.array([layout.index(name) for name in spec.stock], dtype=np.int64),
            stock_price=np.array([spec.costs.stock_per_mol.get(name, 0.0) for name in layout.materials]),
            reading_start=table.start,
            seen=np.array([name in spec.seen_instruments for name in spec.instruments], dtype=np.int64),
            price=table.price,
            waste_per_l=spec.costs.waste_per_l,
            tick_price=spec.costs.tick,
            illegal_price=spec.costs.illegal_action,
            event_price=spec.safety.reward_price,
            budget=spec.limits.budget,
            action_limit=spec.limits.manager_actions,
            tick_limit=spec.limits.ticks,
            largest_capacity=max(capacities),
            **maintenance_rules(spec),
            drifting=np.array([self.actions.instruments.index(name) for name in self.actions.drifting], dtype=np.int64),
            wearing=np.array([self.bench_agents.index(agent) for agent in self.actions.wearing], dtype=np.int64),
            least_purity=np.array([wanted.get(goal, OrderSpec()).purity_at_least for goal in spec.goals]),
            least_amount=np.array([wanted.get(goal, OrderSpec()).amount_at_least_mol for goal in spec.goals]),
            late=spec.demand.late,
            short=spec.demand.short,
            most_terms=self.worlds.most_terms(),
            feedback=-1.0 if spec.demand.feedback == "none" else float(spec.demand.feedback),
            hides=int(spec.hides),
            least_fill=spec.demand.fill_at_least,
            gauge=spec.shelf.gauge,
            work=np.zeros(work_size(self.shelf.chemistry)),
        )

    @functools.cached_property
    def _start(self) -> FloatArray:
        """[V, W] vessel rows at the start of an episode: the scenario's vessels, at rest."""
        shelf = Shelf(self.shelf.chemistry, 1, self.vessels_per_laboratory)
        for s, vessel in enumerate(self.scenario.shelf.vessel):
            row = shelf.fill(0, s, vessel.capacity_l, vessel.contents).row
            if not self.worlds.active:  # otherwise they settle when their contents are known
                self._rest(row)
        return np.asarray(shelf.vessels[0])

    def _rest(self, row: FloatArray) -> None:
        """Settle a vessel that is not in a laboratory yet."""
        waste, events = np.zeros(len(self.shelf.layout.materials)), np.zeros(len(self.scenario.safety_events))
        rest_on_shelf(row, self.shelf.chem(), waste, events, self.rules.arrays.work)

    # -- episodes ---------------------------------------------------------------------------------------------

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Seed one laboratory: the same seed gives the same series of episodes, independent of the actions."""
        self.worlds.seed(member, as_sequence(seed), self._streams()[:-1])
        self.episodes.seed(member, self._streams())

    def begin(self, seed: int = 0, goal: str | None = None, world: World | None = None) -> None:
        """Start an episode in every laboratory: that of ``seed`` in the first, of ``seed`` + i in laboratory i.

        Args:
            seed: seed of the first laboratory.
            goal, world: see :meth:`reset`.
        """
        for member in self.members.tolist():
            self.seed(member, seed + member)
        self.reset(self.members, goal, world)

    def _streams(self) -> list[StreamArray]:
        """Return every random stream of an episode; streams of degradation and drift derive from the world's number."""
        # By kind of role: a seed means the same, whatever the order of the agents.
        roles = (self.manager, *self.bench_roles)
        return [*(role.stream for role in roles), self.worlds.table.arrays.stream]

    def reset(self, members: IntArray, goal: str | None = None, world: World | None = None) -> None:
        """Start new episodes.

        Args:
            members: [B] environment indices.
            goal: goal of the laboratory; None: drawn from each one's stream.
            world: a seed or values (see :meth:`chemlab.lab.hidden.Worlds.begin`); None: drawn from a separate stream.

        Raises:
            ValueError: the goal is unknown, or the world is invalid; nothing has changed.
        """
        wanted = self._lab_goals if goal is None else np.array([self.goal_index(goal)])
        self.worlds.check(world)
        self.episodes.begin(members, self._streams())
        self.worlds.begin(members, world)
        self.shelf.vessels[members] = self._start
        self.shelf.stock[members] = self._first_stock
        self.shelf.waste[members] = 0.0
        if self.worlds.active:
            self.worlds.fill(members)
            self.worlds.rest(members, len(self.scenario.shelf.vessel))
        state = self.state
        self.table.reset(members)
        self.worlds.set_terms(members, state.terms)
        told = self.worlds.told(members)
        if "manager" in told:
            state.told[members] = told["manager"]
        _draw_goals(members, wanted, state.stream, state.goal)
        if self._prepared is not None:
            self._begin_half_way(members, *self._prepared)
        for bench, experiments in zip(self.benches, self.experiments, strict=True):
            experiments.table.reset(members)
            if bench.told:
                experiments.told[members] = told[bench.key]
        if self.scenario.errs:
            self.equip(members)
        open_turn(members, self.table.handle)

    def equip(self, members: IntArray) -> None:
        """Set benches and instruments to the drawn condition of the worlds of ``members`` [B]."""
        for b, (bench, experiments) in enumerate(zip(self.benches, self.experiments, strict=True)):
            equip(bench, experiments, members, self.worlds, b, experiments.agent)
        begin_drift(self.instruments, members, self.table, self.rules.handle, self.worlds)

    def prepare(self, shares: Mapping[str, float] | None) -> None:
        """Set the initial-state distribution of later episodes, for a reverse curriculum.

        A share of the episodes starts with a recorded vessel in the first slot in place of the scenario's first vessel.
        It was recorded on its way to a bench, for the episode's goal.

        Args:
            shares: share of all episodes, by the bench the vessel is on its way to, or ``submit`` for a finished one;
                the other episodes start with the scenario's own shelf. None or empty: all of them.

        Raises:
            DataError: no such vessels have been recorded for this scenario, or not for every goal.
            ValueError: a bench is unknown, or shares are negative or sum to more than 1.
        """
        if not shares:
            self._prepared = None
            return
        known = [*self.scenario.benches, SUBMIT]
        unknown = [stage for stage in shares if stage not in known]
        if unknown or not (min(shares.values()) >= 0.0 and sum(shares.values()) <= 1.0 + 1e-9):
            raise ValueError(
                f"shares of {', '.join(known)}, and no others, must be at least 0 and sum to at most 1; "
                f"given {dict(shares)}"
            )
        pools = []
        for stage in shares:
            pool = start_pool(self.shelf.chemistry, self.scenario, lab_starts(self.scenario, stage))
            lacking = [g for g in self._lab_goals if pool.arrays.first[g] == pool.arrays.first[g + 1]]
            if lacking:
                goal, again = self.scenario.goals[lacking[0]], f"chemlab export starts {self.scenario.argument}"
                raise DataError(f"prepare: no {stage!r} vessel of goal {goal!r}; run: {again}")
            arrays = pool.arrays
            positions = int(self.rules.arrays.most_positions)
            if arrays.last_position.max(initial=0) >= positions:
                raise DataError(
                    f"prepare: {stage!r}: last_position = {arrays.last_position.max()} must be below {positions}"
                )
            for row in arrays.rows:
                self._rest(row)
            pools.append(pool)
        self._prepared = np.cumsum(list(shares.values())), pools

    def _begin_half_way(self, members: IntArray, reached: FloatArray, pools: list[Table[StartPool]]) -> None:
        stages = np.empty(len(members), dtype=np.int64)
        _draw_stages(members, reached, self.state.stream, stages)
        for k, pool in enumerate(pools):
            some = members[stages == k]
            if len(some):
                _put_starts(some, pool.handle, self.table.handle, self.shelf.vessels)

    def goal_index(self, goal: str) -> int:
        """Return the index of a laboratory goal.

        Raises:
            ValueError: the goal is unknown; the message lists the goals.
        """
        if goal not in self.scenario.lab_goals:
            raise ValueError(
                f"goal: {self.scenario.name} has the goals {', '.join(self.scenario.lab_goals)}, given {goal!r}"
            )
        return self.scenario.goals.index(goal)

    # -- turns ------------------------------------------------------------------------------------------------

    def turn(self, member: int = 0) -> int:
        """Index of the agent that has the turn in a laboratory."""
        return int(self._by_cursor[self.state.cursor[member]])

    def turn_of(self, members: IntArray) -> IntArray:
        """[B] index of the agent that has the turn in each laboratory."""
        return np.asarray(self._by_cursor[self.state.cursor[members]])

    def having_turn(self, agent: int, members: IntArray) -> IntArray:
        """Return those of ``members`` [B] in which an agent has the turn."""
        which = np.empty_like(members)
        return which[: having_turn(members, self.roles[agent].cursor, self.table.handle, which)]

    def turns(self, members: IntArray, out: BoolArray | None = None) -> BoolArray:
        """[agents, B] whether an agent plays in a laboratory's next round: the manager or a busy bench; none if the
        episode is over."""
        if out is None:
            out = np.empty((len(self.agents), len(members)), dtype=np.bool_)
        turns(members, self.table.handle, self.rules.handle, out)
        return out

    def checked(self, agent: int, action: Any) -> npt.NDArray[Any]:
        """Return the action as an array of one member.

        Raises:
            ValueError: it is outside the agent's action space.
        """
        return self.roles[agent].checked(action)

    def no_actions(self) -> list[npt.NDArray[Any]]:
        """Return actions [N, ...] of every agent, of zeros."""
        kinds = [np.int64 if count else np.float64 for count in self.action_counts]
        pairs = zip(self.roles, kinds, strict=True)
        return [np.zeros((len(self.members), *(role.action_space.shape or ())), dtype) for role, dtype in pairs]

    def act(self, agent: int, members: IntArray, actions: npt.NDArray[Any]) -> None:
        """Play one turn of ``agent`` in each laboratory of ``members``, where it must have the turn.

        Args:
            agent: agent index.
            members: [B] environment indices.
            actions: [B] int64, or [B, n] float64 for continuous actions, within the action space.
        """
        open_turn(members, self.table.handle)
        self.experiment_ended = False
        self.roles[agent].act(members, actions)

    def act_round(self, members: IntArray, actions: Sequence[npt.NDArray[Any]]) -> None:
        """Play one round in each laboratory of ``members``: the manager's action if it has the turn, else the rest of
        the tick.

        The dynamics are those of :meth:`act`, turn after turn: benches act in their order.

        Args:
            members: [B] environment indices of running episodes.
            actions: actions of every agent, [N] int64 or [N, n] float64; rows of agents without the turn are ignored.
        """
        open_turn(members, self.table.handle)
        self.experiment_ended = False
        cursor = self.state.cursor
        waiting = cursor[members] == self.manager.cursor
        managed, ticking = members[waiting], members[~waiting]
        if len(managed):
            self.manager.act(managed, actions[self.manager.index][managed])
        for role in self.bench_roles:
            # At the end of the tick, the cursor is at the manager or at the first busy bench, which is before its last
            # position.
            group = self.having_turn(role.index, ticking)
            if len(group):
                role.act(group, actions[role.index][group])

    def handles(self) -> tuple[Handle, Handle, Handle, Handle]:
        """Return the tables that most of the manager's kernels take."""
        return self.table.handle, self.rules.handle, self.shelf.handle, self.shelf.chemistry.handles

    def pass_turn(self, members: IntArray) -> None:
        """Give the turn to the next role after a bench has acted; a tick may be over, and with it an episode."""
        since = self.state.ticks[members]
        flags = advance(members, *self.handles())
        self.age(members, since)
        if flags & OVER:
            self.settle(members)

    def age(self, members: IntArray, since: IntArray) -> None:
        """React the vessels on the shelf during the ticks elapsed ``since`` [B], if the scenario enables it.

        Raises:
            ArithmeticError: the reactions are too stiff.
        """
        tick = self.scenario.shelf.tick
        if tick and age_on_shelf(members, since, tick, *self.handles()) >= 0:
            raise ArithmeticError(
                f"{self.scenario.name}: the reactions of a vessel on the shelf are too stiff: more than 1,000,000 "
                "steps. Nothing has reacted in it; give the scenario a shorter shelf.tick, or smaller rate constants"
            )

    def settle(self, members: IntArray) -> None:
        """Pay every role its share of the result in those laboratories of ``members`` whose episode is over."""
        over = members[self.state.status[members] != RUNNING]
        self.state.charges[over] = charges = self.charges(over)
        result, spent = self._result(over, charges), charges.sum(axis=1)
        for role in self.roles:
            role.settle(over, result, spent)

    def result(self, members: IntArray) -> FloatArray:
        """Return [B] the manager's raw score.

        It is the payment of orders with terms, else each order's product by amount and purity, minus costs. An order
        without a submission, or with one that fails its specification, costs the scenario's penalty.
        """
        return self._result(members, self.charges(members))

    def _result(self, members: IntArray, charges: FloatArray) -> FloatArray:
        worth = self.worth(members)
        if self.scenario.demand.missed:
            unmet = worth == 0.0
            worth[unmet] -= self._missed(members)[unmet]
        return np.asarray(worth.sum(axis=1) / worth.shape[1] - charges.sum(axis=1))

    def missed(self, members: IntArray) -> FloatArray:
        """Return [B] the penalty so far for orders that pay nothing, as a mean over the orders."""
        return np.asarray((self._missed(members) * (self.worth(members) == 0.0)).mean(axis=1))

    def _missed(self, members: IntArray) -> FloatArray:
        """Return [B, O] the penalty of each order if it is not met."""
        prices = self.state.terms[members, :, PRICE] if self.scenario.demand.order else np.ones((len(members), 1))
        return self.scenario.demand.missed * np.broadcast_to(prices, (len(members), self.scenario.orders))

    def worth(self, members: IntArray) -> FloatArray:
        """Return [B, O] the value of each order's submission; 0 without one, or with one that fails."""
        if self.scenario.demand.order:
            worth = self.state.paid[members]
        else:
            rules, goals = self.rules.arrays, self.state.goal[members]
            amount, purity = self.state.submitted[members, :, 0], self.state.submitted[members, :, 1]
            worth = amount * purity / rules.maximum[goals]
            worth[(purity < rules.least_purity[goals]) | (amount < rules.least_amount[goals])] = 0.0
        return np.asarray(worth)

    def partial_worth(self, members: IntArray) -> FloatArray:
        """Return [B] what submissions that fail their specification are nearly worth, as a mean over the orders.

        It is half of what they would be worth without it, times the share of the required amount that they have and the
        fourth power of their share of the required purity. It is never part of a score; training can begin with it.
        """
        near, worth = self._near(
            members, self.state.submitted[members, :, None, 0], self.state.submitted[members, :, None, 1]
        )
        return np.asarray(np.where(near < 1.0, 0.5 * near * worth, 0.0).mean(axis=(1, 2)))

    def unfinished_worth(self, members: IntArray) -> FloatArray:
        """Return [B] what vessels that may be submitted later are nearly worth, as a mean over the orders.

        It is as in :meth:`partial_worth`. The orders that have arrived and are neither filled nor late are given the
        best vessel that is left, one after the other. It is never part of a score; training can give credit by it.
        """
        state, rules = self.state, self.rules.arrays
        amounts = self.shelf.vessels[members][..., AMOUNTS : AMOUNTS + rules.counts.shape[1]]
        made, *ions = (amounts[..., np.maximum(rules.parts[:, k], 0)] for k in range(3))
        made = made + np.where(rules.parts[:, 1] >= 0, np.minimum(*ions), 0.0)
        purity = made / np.maximum(amounts @ rules.counts.T, 1e-9)
        open_, found, each = ~state.filled[members], np.zeros(len(members)), np.arange(len(members))
        if self.scenario.demand.order:
            late = state.ticks[members, None] - state.terms[members, :, ARRIVES]
            open_ &= (late >= 0.0) & (late <= state.terms[members, :, WITHIN])
        goals = state.goal[members][:, None]
        near, worth = self._near(
            members, *(np.take_along_axis(part, goals, 2).swapaxes(1, 2) for part in (made, purity))
        )
        values = near * worth
        for order in range(values.shape[1]):
            best = values[:, order].argmax(axis=1)
            found += 0.5 * open_[:, order] * values[each, order, best]
            filled = each[open_[:, order]]
            values[filled, :, best[filled]] = 0.0
        return np.asarray(found / values.shape[1])

    def _near(self, members: IntArray, amount: FloatArray, purity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return [B, O, V], of amounts and purities [B, O, V] of V vessels for each order, how nearly they meet its
        specification (1: they do), and what they would be worth without it.
        """
        rules = self.rules.arrays
        goals, terms = self.state.goal[members][..., None], self.state.terms[members][:, :, None]
        least_amount, least_purity = rules.least_amount[goals], rules.least_purity[goals]
        worth = amount * purity / rules.maximum[goals]
        if self.scenario.demand.order:
            least_amount = np.maximum(least_amount, terms[..., LEAST_AMOUNT])
            least_purity, worth = np.maximum(least_purity, terms[..., LEAST_PURITY]), terms[..., PRICE]
        squared = np.minimum(purity / np.maximum(least_purity, 1e-9), 1.0) ** 2  # numpy's power of 4 takes much longer
        return squared**2 * np.minimum(amount / np.maximum(least_amount, 1e-9), 1.0), worth

    def feedback(self, which: int | slice) -> FloatArray:
        """Return [..., O, 2] mol and purity of each submission as the manager knows them: exactly at the end."""
        state, wanted = self.state, self.scenario.demand.feedback
        if wanted == 0.0:
            return state.submitted[which].copy()
        running = np.asarray(state.status[which] == RUNNING)[..., None, None]
        early = 0.0 if wanted == "none" else state.feedback[which][..., :2]
        return np.where(running, early, state.submitted[which])

    def shown_charges(self, members: IntArray) -> FloatArray:
        """Return [B, items] :meth:`charges` as the manager knows them.

        Until the end, costs of amounts (stock, waste, safety events) have the resolution of the shelf's gauge.
        """
        found, gauge, rules = self.charges(members), self.scenario.shelf.gauge, self.rules.arrays
        if gauge:
            unit = np.zeros(len(COST_ITEMS))
            unit[STOCK] = gauge * float(rules.first_stock @ rules.stock_price)
            unit[WASTE] = gauge * rules.largest_capacity * rules.waste_per_l
            unit[SAFETY] = gauge * rules.event_price
            steps = np.floor(np.divide(found, unit, out=np.zeros_like(found), where=unit > 0.0) + 0.5)
            rounded = (unit > 0.0) & (self.state.status[members, None] == RUNNING)
            found = np.where(rounded, steps * unit, found)
        return found

    def charges(self, members: IntArray) -> FloatArray:
        """Return [B, items] the managers' costs so far, in units of the score; items as in
        :data:`~chemlab.roles.manager_state.COST_ITEMS`.
        """
        out = np.empty((len(members), len(COST_ITEMS)))
        itemize(members, *self.handles(), out)
        return out

    # -- observations -----------------------------------------------------------------------------------------

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The manager's channels."""
        return self.manager.channels

    def observation_space(self, agent: int) -> gymnasium.spaces.Box:
        """Return the agent's observation space."""
        return self.roles[agent].observation_space

    def action_space(self, agent: int) -> gymnasium.Space[Any]:
        """Return the agent's action space."""
        return self.roles[agent].action_space

    def observe(
        self, agent: int, members: IntArray, out: ObservationArray | None = None, rows: IntArray | None = None
    ) -> ObservationArray:
        """Return [B, size] the agent's observations; zeros for a bench without an experiment.

        Args:
            agent: agent index.
            members: [B] environment indices.
            out: output array; default: a new array.
            rows: [B] row of ``out`` for each laboratory; default: in order.
        """
        if out is None:
            out = np.empty((len(members), self.observation_sizes[agent]), dtype=np.float32)
        self.roles[agent].observe(members, out, rows)
        return out

    def mask(self, agent: int, members: IntArray, out: MaskArray | None = None) -> MaskArray | None:
        """Return [B, actions] legal actions (1 = legal), or None for a continuous action space."""
        if not self.action_counts[agent]:
            return None
        if out is None:
            out = np.empty((len(members), self.action_counts[agent]), dtype=np.int8)
        self.roles[agent].mask(members, out)
        return out

    def costs(self, member: int = 0) -> dict[str, float]:
        """Return the manager's charges so far by item, in units of the score, as the manager knows them."""
        charges = self.shown_charges(self.members[member : member + 1])
        return dict(zip(COST_ITEMS, charges[0].tolist(), strict=True))

    def outcome(self, member: int = 0) -> dict[str, Any]:
        """Return the submissions: ``submitted_mol`` in all and its mean ``purity``, and the same with its ``goal`` for
        each of the ``orders``."""
        goals = self.state.goal[member].tolist()
        pairs = self.state.submitted[member].tolist()
        mol = sum(amount for amount, _ in pairs)
        return {
            "submitted_mol": mol,
            "purity": sum(amount * purity for amount, purity in pairs) / mol if mol > 0.0 else 0.0,
            "orders": [
                {"goal": self.scenario.goals[goal], "submitted_mol": amount, "purity": purity}
                for goal, (amount, purity) in zip(goals, pairs, strict=True)
            ],
        }

    def events(self, agent: int, member: int = 0) -> dict[str, float]:
        """Safety events of the agent's last action by kind, without zeros."""
        row = self.roles[agent].events[member].tolist()
        return (
            {kind: value for kind, value in zip(self.scenario.safety_events, row, strict=True) if value}
            if any(row)
            else {}
        )

    def total(self) -> FloatArray:
        """Return [N, M] mol in vessels, bottles, waste and delivered vessels, which only reactions change."""
        return np.asarray(self.shelf.total() + self.state.delivered)

    # -- state ------------------------------------------------------------------------------------------------

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return every array that changes, for snapshots."""
        state = self.shelf.arrays()
        for experiments in self.experiments:
            state += experiments.arrays()
        return [*state, *self.table.changing(), *self.worlds.arrays(), *self.episodes.arrays()]

    def snapshot(self) -> list[npt.NDArray[Any]]:
        """Return copies of every array that changes, for :meth:`restore`."""
        return [array.copy() for array in self.arrays()]

    def restore(self, snapshot: list[npt.NDArray[Any]]) -> None:
        """Restore a :meth:`snapshot`; the continuation is then identical.

        Raises:
            ValueError: it is of another laboratory; nothing changes.
        """
        put_back(self.arrays(), snapshot)
