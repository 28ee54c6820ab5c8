"""Episodes of one role in one set of arrays, each with its own start and end: a bench alone, or among other roles."""

from __future__ import annotations

import itertools
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, Handle, IntArray, ObservationArray
from ..kernels.jit import kernel, opened
from ..lab.engine import Laboratories
from ..lab.experiments import ExperimentBatch
from ..lab.hidden import World, Worlds
from ..lab.text import describe_laboratory
from ..roles.base import Workplace
from ..roles.manager_state import RUNNING, ManagerState
from .players import Players, as_policy

if TYPE_CHECKING:
    from ..render.scene import Scene

State = list[npt.NDArray[Any]]

Ended = list[tuple[IntArray, ObservationArray]]
"""Members whose episode has ended, with their last observations (those of SAME_STEP, which are replaced by the next
episode's).
"""

Policies = Mapping[str, Any] | Callable[[Laboratories], Mapping[str, Any]]
"""Policies of the other agents by name, as accepted by :func:`~chemlab.envs.players.as_policy`, or a function that
makes them for the laboratories.
"""


@kernel
def _collect(
    members: IntArray, focal: int, manager: Handle, rewards: FloatArray, costs: FloatArray, scores: FloatArray
) -> None:
    """Add the results of the last turn for agent ``focal`` to ``rewards``, ``costs`` and ``scores`` [N]."""
    state = opened(ManagerState, manager)
    for i in range(members.shape[0]):
        n = members[i]
        rewards[n] += state.rewards[focal, n]
        costs[n] += state.cost[focal, n]
        score = state.scores[focal, n]
        if not math.isnan(score):
            scores[n] = score + (0.0 if math.isnan(scores[n]) else scores[n])


class RoleEpisodes(ABC):
    """N members that play episodes of one role; subclasses define a member's step.

    Args:
        members: number of members N.
        agent: name of the acting agent.
        scenario: the scenario.
        goals: possible goals of an episode.
        longest: maximum number of steps of an episode.
        observation_space, action_space: spaces of a member.
        autoreset_mode: when the next episode of a member begins.

    Attributes:
        observations: [N, size] current observations.
        masks: [N, actions] legal actions (no columns for continuous actions).
        rewards, costs, scores, events, illegal, terminated: [N, ...] results of the last step (``scores``: NaN without
            a score).
        pending: [N] whether the episode has ended and the next one has not begun.
    """

    def __init__(
        self,
        members: int,
        agent: str,
        scenario: Scenario,
        goals: Sequence[str],
        longest: int,
        observation_space: gymnasium.spaces.Box,
        action_space: gymnasium.Space[Any],
        autoreset_mode: AutoresetMode,
    ) -> None:
        self.agent, self.scenario, self.goals, self.longest = agent, scenario, tuple(goals), longest
        self.observation_space, self.action_space = observation_space, action_space
        self.action_count = int(action_space.n) if isinstance(action_space, gymnasium.spaces.Discrete) else 0
        self.autoreset_mode = autoreset_mode
        self.observations = np.zeros((members, *observation_space.shape), dtype=np.float32)
        self.masks = np.ones((members, self.action_count), dtype=np.int8)
        self.rewards = np.zeros(members)
        self.costs = np.zeros(members)
        self.scores = np.full(members, np.nan)
        self.events = np.zeros((members, len(scenario.safety_events)))
        self.illegal = np.zeros(members, dtype=np.bool_)
        self.terminated = np.zeros(members, dtype=np.bool_)
        self.pending = np.zeros(members, dtype=np.bool_)

    worlds: Worlds
    """Worlds of the members."""
    workplace: Workplace
    """Bench or manager of the agent."""

    @abstractmethod
    def checked(self, action: Any) -> npt.NDArray[Any]:
        """Return one member's action as a batch of one.

        Raises:
            ValueError: the action is outside the action space.
        """

    @abstractmethod
    def seed(self, member: int, seed: int) -> None:
        """Restart the member's random streams."""

    @abstractmethod
    def begin(self, members: IntArray, goal: int | None, world: World | None) -> None:
        """Start episodes and observe them."""

    @abstractmethod
    def play(self, actions: npt.NDArray[Any]) -> Ended:
        """Play checked actions in every member with autoreset, and update the arrays; return the ended members."""

    def clear(self, members: IntArray | slice) -> None:
        """Forget what the last step of ``members`` [B] led to."""
        self.rewards[members], self.costs[members], self.events[members] = 0.0, 0.0, 0.0
        self.illegal[members], self.scores[members] = False, np.nan

    def play_one(self, action: npt.NDArray[Any]) -> None:
        """Play the checked action of the only member without autoreset."""
        self.play(action)

    def more_infos(self) -> dict[str, npt.NDArray[Any]]:
        """Return further infos [N] by name."""
        return {}

    def accounts(self) -> dict[str, Any]:
        """Return further infos of the first member, which only single environments have."""
        return {}

    def arrays(self) -> State:
        """Return every array that changes, for snapshots."""
        return [
            self.observations,
            self.masks,
            self.rewards,
            self.costs,
            self.events,
            self.scores,
            self.illegal,
            self.terminated,
            self.pending,
        ]

    def get_memory(self) -> Any:
        """Return a copy of the memory of the other roles' policies."""
        return None

    def set_memory(self, memory: Any) -> None:  # noqa: B027 - nothing to restore by default
        """Restore a :meth:`get_memory`."""

    @abstractmethod
    def text(self) -> str:
        """Return a description of the first member."""

    @abstractmethod
    def scene(self) -> Scene:
        """Return the scene of the first member, with true contents."""

    def close(self) -> None:  # noqa: B027 - no threads by default
        """Stop threads."""


class BenchEpisodes(RoleEpisodes):
    """N experiments of a bench alone; an episode is one experiment.

    Args:
        members, autoreset_mode: as for :class:`RoleEpisodes`.
        scenario, bench, goals, starts: as for :class:`~chemlab.lab.experiments.ExperimentBatch`.
        threads: threads to step with; results do not depend on it.

    Raises:
        DataError: the bench, goal or kind of initial states is unknown.
    """

    _pool: ThreadPoolExecutor | None = None
    _pool_process = 0
    """Id of the process of those threads; a forked child has none of them."""

    def __init__(
        self,
        members: int,
        scenario: Scenario,
        bench: str,
        goals: str | Sequence[str] | None,
        starts: str,
        threads: int,
        autoreset_mode: AutoresetMode,
    ) -> None:
        self.batch = ExperimentBatch(scenario, bench, members, goals, starts)
        self.bench, self.worlds = self.batch.bench, self.batch.worlds
        self.workplace = self.bench
        super().__init__(
            members,
            self.batch.experiments.agent,
            scenario,
            scenario.goals,
            self.bench.step_limit,
            self.bench.observation_space,
            self.bench.action_space,
            autoreset_mode,
        )
        self.threads = min(threads, members)
        self._waiting: list[Future[Any]] = []
        bounds = np.linspace(0, members, self.threads + 1).astype(int)
        # Each thread has its own members and scratch, and touches only its own rows.
        self._chunks = [
            (np.arange(low, high), self.bench if i == 0 else self.bench.separate_scratch())
            for i, (low, high) in enumerate(itertools.pairwise(bounds))
        ]

    def checked(self, action: Any) -> npt.NDArray[Any]:
        return self.bench.checked(self.agent, action)

    def seed(self, member: int, seed: int) -> None:
        self.batch.seed(member, seed)

    def begin(self, members: IntArray, goal: int | None, world: World | None) -> None:
        self._join()
        self.batch.reset(members, goal, world=world)
        for chunk, bench in self._chunks:
            self._look(chunk, bench)

    def play(self, actions: npt.NDArray[Any]) -> Ended:
        if self.threads == 1:
            return [self._step_chunk(*self._chunks[0], actions)]
        if self._pool is None or self._pool_process != os.getpid():
            self._pool = ThreadPoolExecutor(self.threads - 1, thread_name_prefix="chemlab")
            self._pool_process = os.getpid()
        for chunk in self._chunks[1:]:
            self._waiting.append(self._pool.submit(self._step_chunk, *chunk, actions))
        own = self._step_chunk(*self._chunks[0], actions)
        return [own, *(future.result() for future in self._join())]

    def play_one(self, action: npt.NDArray[Any]) -> None:
        """As :meth:`play`, without the selection of members, which takes as long as the step itself."""
        batch, bench = self.batch, self.bench
        batch.act(action)
        self.scores[0], self.costs[0], self.rewards[0] = np.nan, 0.0, 0.0
        shelf, experiments, members = batch.shelf, batch.experiments, batch.members
        bench.consequences(shelf, experiments, members, self.costs, self.rewards)
        arrays = experiments.table.arrays
        self.illegal[0], self.events[0], self.pending[0] = arrays.illegal[0], arrays.events[0], arrays.ended[0]
        # The last observation is of the running experiment: read it first.
        bench.observe(shelf, experiments, members, self.observations)
        if self.action_count:
            bench.mask(shelf, experiments, members, self.masks)
        if self.pending.item(0):
            self._score(bench, members)

    def _join(self) -> list[Future[Any]]:
        """Wait for the other threads' part of a step, including an interrupted one."""
        wait(self._waiting)
        done, self._waiting = self._waiting, []
        return done

    def _step_chunk(
        self, members: npt.NDArray[np.int64], bench: Any, actions: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
        """Step one thread's members; return the ended ones and, with SAME_STEP, their last observations."""
        batch = self.batch
        shelf, experiments = batch.shelf, batch.experiments
        low, high = int(members[0]), int(members[-1]) + 1
        self.terminated[low:high] = False
        self.scores[low:high] = np.nan
        acting, waiting = members, self.pending[low:high]
        if waiting.any():
            if self.autoreset_mode is AutoresetMode.NEXT_STEP:
                batch.reset(members[waiting], None, bench)
            acting = members[~waiting]
            self.clear(members[waiting])
            waiting[:] = False
        rows: Any = slice(low, high) if len(acting) == len(members) else acting
        batch.act(actions[rows], acting, bench)
        self.rewards[rows], self.costs[rows] = 0.0, 0.0
        bench.consequences(shelf, experiments, acting, self.costs, self.rewards)
        # A reset in the same step overwrites these.
        self.illegal[rows], self.events[rows] = experiments.illegal[rows], experiments.events[rows]
        ended = acting[experiments.ended[rows]]
        last = np.zeros((0, self.observations.shape[1]), dtype=np.float32)
        if len(ended):
            self.terminated[ended] = True
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                last = np.empty((len(ended), self.observations.shape[1]), dtype=np.float32)
                bench.observe(shelf, experiments, ended, last)
                self._score(bench, ended)
                batch.reset(ended, None, bench)
            else:
                # The last observation is of the running experiment: read it first.
                self._look(members, bench)
                self._score(bench, ended)
                self.pending[ended] = True
                return ended, last
        self._look(members, bench)
        return ended, last

    def _score(self, bench: Any, ended: npt.NDArray[np.int64]) -> None:
        score = bench.finish(self.batch.shelf, self.batch.experiments, ended)
        self.scores[ended] = score
        self.rewards[ended] += score

    def _look(self, members: npt.NDArray[np.int64], bench: Any) -> None:
        low, high = int(members[0]), int(members[-1]) + 1
        shelf, experiments = self.batch.shelf, self.batch.experiments
        bench.observe(shelf, experiments, members, self.observations[low:high])
        if bench.action_count:
            bench.mask(shelf, experiments, members, self.masks[low:high])

    def arrays(self) -> State:
        self._join()
        return [*self.batch.arrays(), *super().arrays()]

    def text(self) -> str:
        from ..render.scene import visible_scene

        (seen,), experiments = visible_scene(self.scene(), self.scenario).benches, self.batch.experiments
        doing = f"goal {self.bench.goals.names[experiments.goal[0]]}, step {experiments.steps[0]}/{seen.step_limit}"
        lines = [f"{self.scenario.title} - {seen.key}, {doing}"]
        for vessel in seen.vessels:
            kelvin = "" if vessel.temperature_k is None else f", {vessel.temperature_k:.1f} K"
            lines.append(f"  {vessel.position:<6} {vessel.volume_l:.2f}/{vessel.capacity_l:.2f} L{kelvin}")
        return "\n".join(lines)

    def scene(self) -> Scene:
        from ..render.scene import bench_scene

        return bench_scene(self.batch)

    def close(self) -> None:
        if self._pool is not None and self._pool_process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # Threads cannot be pickled or copied; they are restarted when needed.
        return {**vars(self), "_pool": None, "_waiting": []}


class LaboratoryEpisodes(RoleEpisodes):
    """N laboratories from one agent's point of view, in which background policies play the other roles.

    Args:
        laboratories: the laboratories.
        agent: name of the acting agent.
        policies: policies of the others.
        autoreset_mode: as for :class:`RoleEpisodes`.

    Raises:
        ValueError: the agent is unknown, or an agent has no policy.
        TypeError: policies are not given by agent, or an object is not a policy.
    """

    def __init__(
        self, laboratories: Laboratories, agent: str, policies: Policies | None, autoreset_mode: AutoresetMode
    ) -> None:
        self.laboratories = labs = laboratories
        scenario, count = labs.scenario, len(labs.members)
        if agent not in labs.agents:
            raise ValueError(f"agent: {scenario.name} has {', '.join(labs.agents)}; given {agent!r}")
        self.focal = labs.agents.index(agent)
        self._manages = self.focal == labs.manager.index
        given = policies(labs) if callable(policies) else policies or {}
        if not isinstance(given, Mapping):
            raise TypeError(
                f"policies: must be a dict of policies by agent, or a function that makes one; given {given!r:.200}; "
                "for policies by name: gymnasium.make('chemlab/LabAgent-v1', agent=..., background=...)"
            )
        unknown = [name for name in given if name not in labs.agents]
        if unknown:
            raise ValueError(f"policies: {scenario.name} has {', '.join(labs.agents)}; given {', '.join(unknown)}")
        missing = [name for name in labs.agents if name != agent and name not in given]
        if missing:
            raise ValueError(f"policies: missing for {', '.join(missing)}; given {', '.join(given) or 'none'}")
        self._players = Players(labs, [as_policy(given[name], name) if name != agent else None for name in labs.agents])
        limits = scenario.limits
        super().__init__(
            count,
            agent,
            scenario,
            scenario.lab_goals,
            limits.manager_actions if self._manages else limits.ticks,  # a bench has at most one turn per tick
            labs.observation_space(self.focal),
            labs.action_space(self.focal),
            autoreset_mode,
        )
        self.worlds, self.workplace = labs.worlds, labs.roles[self.focal].workplace
        self._lab_costs = np.zeros(count)
        self._elapsed = np.zeros(count, dtype=np.int64)
        self._last_turn = np.zeros(count, dtype=np.int64)
        weights = scenario.safety.weights
        self._event_weights = np.array([weights.get(kind, 0.0) for kind in scenario.safety_events])

    def checked(self, action: Any) -> npt.NDArray[Any]:
        return self.laboratories.checked(self.focal, action)

    def seed(self, member: int, seed: int) -> None:
        self.laboratories.seed(member, seed)
        self._players.seed(member, seed)

    def begin(self, members: IntArray, goal: int | None, world: World | None) -> None:
        self._restart(members, None if goal is None else self.goals[goal], world)
        self._look()

    def _restart(self, members: IntArray, goal: str | None, world: World | None = None) -> None:
        """Start new episodes and play up to the agent's first turn; earlier rewards do not count."""
        self._players.begin(members, lambda waiting: self.laboratories.reset(waiting, goal, world))
        self.clear(members)
        self._last_turn[members] = self.laboratories.state.ticks[members]

    def clear(self, members: IntArray | slice) -> None:
        super().clear(members)
        self._lab_costs[members], self._elapsed[members] = 0.0, 0

    def play(self, actions: npt.NDArray[Any]) -> Ended:
        labs, members = self.laboratories, self.laboratories.members
        self.terminated[:] = False
        acting = members[~self.pending]
        if len(acting) < len(members):
            if self.autoreset_mode is AutoresetMode.NEXT_STEP:
                self._restart(members[self.pending], None)
            self.pending[:] = False
        self.clear(acting)
        before = labs.safety_totals[acting]
        labs.act(self.focal, acting, actions[acting])
        self.illegal[acting] = labs.roles[self.focal].illegal[acting]
        self._collect(acting)
        # The others play until the agent has the turn again or all episodes are over.
        self._players.play_on(acting, lambda number, group: self._collect(group))
        self.events[acting] = labs.safety_totals[acting] - before
        # Not a matrix product, whose last digit depends on the number of rows.
        self._lab_costs[acting] = (self.events[acting] * self._event_weights).sum(axis=1)
        ticks, status = labs.state.ticks, labs.state.status
        self._elapsed[acting] = ticks[acting] - self._last_turn[acting]
        self._last_turn[acting] = ticks[acting]
        ended = acting[status[acting] != RUNNING]
        if not len(ended):
            self._look()
            return []
        self.terminated[ended] = True
        if self._manages:
            self.scores[ended] = labs.result(ended)
        last = labs.observe(self.focal, ended)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            kept = [array[ended].copy() for array in self._step_results()]
            self._restart(ended, None)
            for array, values in zip(self._step_results(), kept, strict=True):
                array[ended] = values
        else:
            self.pending[ended] = True
        self._look()
        return [(ended, last)]

    def _step_results(self) -> State:
        """Return the results of a step, which a reset in the same step must not change."""
        return [
            self.rewards,
            self.costs,
            self._lab_costs,
            self.events,
            self._elapsed,
            self.illegal,
            self.scores,
        ]

    def _collect(self, members: IntArray) -> None:
        """Add the consequences of the last turn of any agent to the agent's results."""
        _collect(members, self.focal, self.laboratories.table.handle, self.rewards, self.costs, self.scores)

    def _look(self) -> None:
        labs, members = self.laboratories, self.laboratories.members
        labs.observe(self.focal, members, self.observations)
        if self.action_count:
            labs.mask(self.focal, members, self.masks)

    def more_infos(self) -> dict[str, npt.NDArray[Any]]:
        return {"lab_cost": self._lab_costs.copy(), "elapsed_ticks": self._elapsed.copy()}

    def accounts(self) -> dict[str, Any]:
        return self.laboratories.roles[self.focal].accounts(0)

    def arrays(self) -> State:
        own = [self._lab_costs, self._elapsed, self._last_turn]
        return [*self.laboratories.arrays(), *own, *super().arrays()]

    def get_memory(self) -> Any:
        return self._players.get_memory()

    def set_memory(self, memory: Any) -> None:
        self._players.set_memory(memory)

    def text(self) -> str:
        return describe_laboratory(self.laboratories)

    def scene(self) -> Scene:
        from ..render.scene import laboratory_scene

        return laboratory_scene(self.laboratories)
