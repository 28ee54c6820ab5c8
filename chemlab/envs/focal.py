"""The laboratory as a Gymnasium environment for one of its agents, the others played by policies; one or a batch.

| Id | Agent | Step |
|---|---|---|
| `chemlab/LabManager-v0` | `manager_0` | one manager decision, run to the next one (or to the episode's end) |
| `chemlab/LabAgent-v0` | any `agent` | one turn of that agent, run to its next one |

### Episodes
An episode is the laboratory's. It ends for every agent, with `terminated`, when the manager has submitted its last
order or a limit is reached; nothing is truncated here. For a bench's agent it spans all of its experiments; where one
has ended, `info["experiment_over"]` is True and `info["score"]` its score (the sum, should several have ended); for the
manager where the episode has. The reward is everything the agent has earned since its last turn. `reset` plays on to
the agent's first turn (episodes in which it never has one are played over).

### Semi-Markov steps
`info["elapsed_ticks"]` says how many ticks have passed since the agent's last turn: discount what follows by gamma to
that power where time matters, by gamma once where decisions do.

### Infos
In every step: `action_mask` (discrete actions), `cost` (weighted safety events of the agent's own actions), `lab_cost`
(of all agents'), `events` (the laboratory's in the step by kind, [kinds, as in the scenario's `safety_events`]),
`illegal_action`, `elapsed_ticks`, `experiment_over`, and `score` (0 where nothing has ended); in single environments
the manager's also `costs`, `goals`, `submitted_mol` and `purity`
(:meth:`~chemlab.roles.manager_role.ManagerRole.accounts`), and single values are of NumPy's types, too.

### Seeds
Member i of a batch that is reset with seed s plays what a single environment reset with seed s + i plays, as long as
background policies have no other randomness than what ``seed(member, seed)`` starts (scripted and random ones do).

### Version history
- v0: first version.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from typing_extensions import Unpack

from ..config.scenario import Scenario, Settings
from ..kernels.arrays import IntArray
from ..kernels.rng import checked_seed
from ..lab.engine import MANAGER_AGENT, Laboratories
from ..lab.hidden import World, Worlds
from ..lab.text import describe_laboratory
from ..roles.manager_state import RUNNING
from .players import Players, as_policy
from .rendering import RENDER_MODES, Rendered
from .vector import BatchEnv, BoundedSpec, State

if TYPE_CHECKING:
    from ..render.scene import Scene

__all__ = ["FocalEnv", "FocalVectorEnv", "Policies"]

Policies = Mapping[str, Any] | Callable[[Laboratories], Mapping[str, Any]]
"""Policies of the other agents by name, as accepted by :func:`~chemlab.envs.players.as_policy`, or a function that
makes them for the laboratories.
"""


class FocalVectorEnv(BatchEnv):
    """N laboratories from one agent's point of view in one set of arrays; background policies play all of them at once.

    Args:
        num_envs: number of laboratories N.
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        agent: name of the acting agent.
        policies: policies of the others.
        autoreset_mode: ``NEXT_STEP``, ``SAME_STEP`` or ``DISABLED``, as for
            :class:`~chemlab.envs.bench_env.BenchVectorEnv`.
        copy: whether returned arrays are copies; if False, the next step overwrites them.
        settings: ``rewards``, ``split`` and ``actions`` (:meth:`~chemlab.config.scenario.Scenario.configured`).
        max_episode_steps: for compatibility with Gymnasium; must exceed the scenario's limit.

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: the agent is unknown, an agent has no policy, or a render mode is given (batches do not render).
        TypeError: an object is not a policy.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        agent: str = MANAGER_AGENT,
        policies: Policies | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, given {num_envs}")
        self.laboratories = labs = Laboratories(scenario, num_envs, **settings)
        self.scenario = labs.scenario
        if agent not in labs.agents:
            raise ValueError(f"agent: {self.scenario.name} has {', '.join(labs.agents)}; given {agent!r}")
        self.focal = labs.agents.index(agent)
        self._manages = self.focal == labs.manager.index
        given = policies(labs) if callable(policies) else policies or {}
        unknown = [name for name in given if name not in labs.agents]
        if unknown:
            raise ValueError(f"policies: {self.scenario.name} has {', '.join(labs.agents)}; given {', '.join(unknown)}")
        missing = [name for name in labs.agents if name != agent and name not in given]
        if missing:
            raise ValueError(f"policies: missing for {', '.join(missing)}; given {', '.join(given) or 'none'}")
        self._players = Players(labs, [as_policy(given[name], name) if name != agent else None for name in labs.agents])
        limits = self.scenario.limits
        super().__init__(
            num_envs,
            agent,
            self.scenario.lab_goals,
            len(self.scenario.safety_events),
            limits.manager_actions if self._manages else limits.ticks,  # a bench has at most one turn per tick
            labs.observation_space(self.focal),
            labs.action_space(self.focal),
            autoreset_mode,
            copy,
            render_mode,
            max_episode_steps,
        )
        self._lab_costs = np.zeros(num_envs)
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._last_turn = np.zeros(num_envs, dtype=np.int64)
        weights = self.scenario.safety.weights
        self._event_weights = np.array([weights.get(kind, 0.0) for kind in self.scenario.safety_events])

    @property
    def action_meanings(self) -> list[str]:
        """Description of each action, or of each number of a continuous action."""
        return self.laboratories.roles[self.focal].action_meanings

    def _seed_member(self, member: int, seed: int) -> None:
        self.laboratories.seed(member, seed)
        self._players.seed(member, seed)

    @property
    def _worlds(self) -> Worlds:
        return self.laboratories.worlds

    def _begin(self, members: IntArray, goal: int | None, world: World | None) -> None:
        self._restart(members, None if goal is None else self._goal_names[goal], world)
        self._look()

    def _restart(self, members: IntArray, goal: str | None, world: World | None = None) -> None:
        """Start new episodes and play up to the agent's first turn; earlier rewards do not count."""
        self._players.begin(members, lambda waiting: self.laboratories.reset(waiting, goal, world))
        self._clear(members)
        self._last_turn[members] = self.laboratories.state.ticks[members]

    def _clear(self, members: IntArray) -> None:
        self._rewards[members], self._costs[members], self._lab_costs[members] = 0.0, 0.0, 0.0
        self._events[members], self._elapsed[members] = 0.0, 0
        self._illegal[members], self._scores[members] = False, np.nan

    def _play(self, actions: npt.NDArray[Any]) -> list[tuple[IntArray, npt.NDArray[np.float32]]]:
        labs, members = self.laboratories, self.laboratories.members
        self._terminated[:] = False
        acting = members[~self._pending]
        if len(acting) < len(members):
            if self.autoreset_mode is AutoresetMode.NEXT_STEP:
                self._restart(members[self._pending], None)
            self._pending[:] = False
        self._clear(acting)
        before = labs.safety_totals[acting]
        labs.act(self.focal, acting, actions[acting])
        self._illegal[acting] = labs.illegal(self.focal)[acting]
        self._collect(acting)
        # The others play until the agent has the turn again or all episodes are over.
        self._players.play_on(acting, lambda number, group: self._collect(group))
        self._events[acting] = labs.safety_totals[acting] - before
        # Not a matrix product, whose last digit depends on the number of rows.
        self._lab_costs[acting] = (self._events[acting] * self._event_weights).sum(axis=1)
        ticks, status = labs.state.ticks, labs.state.status
        self._elapsed[acting] = ticks[acting] - self._last_turn[acting]
        self._last_turn[acting] = ticks[acting]
        ended = acting[status[acting] != RUNNING]
        if not len(ended):
            self._look()
            return []
        self._terminated[ended] = True
        if self._manages:
            self._scores[ended] = labs.result(ended)
        last = labs.observe(self.focal, ended)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            kept = [array[ended].copy() for array in self._step_results()]
            self._restart(ended, None)
            for array, values in zip(self._step_results(), kept, strict=True):
                array[ended] = values
        else:
            self._pending[ended] = True
        self._look()
        return [(ended, last)]

    def _step_results(self) -> State:
        """Return the results of a step, which a reset in the same step must not change."""
        return [
            self._rewards,
            self._costs,
            self._lab_costs,
            self._events,
            self._elapsed,
            self._illegal,
            self._scores,
        ]

    def _collect(self, members: IntArray) -> None:
        """Add the consequences of the last turn of any agent to the agent's results."""
        labs, focal = self.laboratories, self.focal
        self._rewards[members] += labs.state.rewards[focal][members]
        self._costs[members] += labs.cost[members, focal]
        scores = labs.scores[members, focal]
        ended = np.isfinite(scores)
        if ended.any():
            before = self._scores[members[ended]]
            self._scores[members[ended]] = np.where(np.isnan(before), 0.0, before) + scores[ended]

    def _look(self) -> None:
        labs, members = self.laboratories, self.laboratories.members
        labs.observe(self.focal, members, self._observations)
        if self.action_count:
            labs.mask(self.focal, members, self._masks)

    def _more_infos(self) -> dict[str, npt.NDArray[Any]]:
        return {"lab_cost": self._lab_costs.copy(), "elapsed_ticks": self._elapsed.copy()}

    def get_state(self) -> State:
        """Return copies of everything that changes, including policies' memories, for :meth:`set_state`."""
        memories = np.empty(1, dtype=object)
        memories[0] = self._players.get_memory()
        return [*super().get_state(), memories]

    def set_state(self, state: State) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical batch; return the observations.

        Raises:
            ValueError: it is of another batch; nothing changes.
        """
        observations = super().set_state(state[:-1])
        self._players.set_memory(state[-1][0])
        return observations

    def _more_arrays(self) -> State:
        own = [self._lab_costs, self._elapsed, self._last_turn]
        return [*self.laboratories.arrays(), *own]


class FocalEnv(BoundedSpec, Rendered, gymnasium.Env[npt.NDArray[np.float32], Any]):
    """The laboratory for one of its agents; see this module's documentation for episodes and infos.

    Args:
        scenario, agent, policies, rewards, split, actions: as for :class:`FocalVectorEnv`.
        render_mode: ``ansi``, ``rgb_array``, ``human`` or None.

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: the agent or render mode is unknown, or an agent has no policy.
        TypeError: an object is not a policy.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's class attribute
        "render_modes": list(RENDER_MODES),
        "render_fps": 8,
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        agent: str = MANAGER_AGENT,
        policies: Policies | None = None,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        self._set_render_mode(render_mode)
        self.batch = FocalVectorEnv(1, scenario, agent, policies, AutoresetMode.DISABLED, **arguments)
        self.laboratories = self.batch.laboratories
        self.max_episode_steps = self.batch.max_episode_steps
        self.agent = agent
        self.observation_space: gymnasium.Space[Any] = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    @property
    def action_meanings(self) -> list[str]:
        """Description of each action, or of each number of a continuous action."""
        return self.batch.action_meanings

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start an episode and play up to the agent's first turn.

        Args:
            seed: starts a series of episodes that depends on the seed alone; None: the next episode of the series (the
                first reset draws a seed).
            options: ``{"goal": name}`` sets one of the scenario's laboratory goals instead of drawing it, ``{"world":
                seed or values}`` sets the world (see :meth:`chemlab.lab.hidden.Worlds.begin`).

        Raises:
            ValueError: an option or goal is unknown, the world is invalid, or the seed is not a non-negative integer;
                nothing has changed.
        """
        seed = checked_seed(seed)
        unknown = set(options or {}) - {"goal", "world"}
        if unknown:
            raise ValueError(f"reset options: known: goal, world; given {', '.join(sorted(map(str, unknown)))}")
        observations, infos = self.batch.reset(seed=seed, options=options)
        super().reset(seed=seed)
        self._show()
        return observations[0], self._info(infos)

    def step(self, action: Any) -> tuple[npt.NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Play one turn of the agent; the others then play up to its next one.

        Raises:
            ValueError: the action is outside the action space (nothing has changed).
            gymnasium.error.ResetNeeded: the episode is over or has not begun.
        """
        checked = self.laboratories.checked(self.batch.focal, action)
        observations, rewards, terminated, truncated, infos = self.batch.step(checked)
        self._show()
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._info(infos)

    def _info(self, infos: dict[str, Any]) -> dict[str, Any]:
        own = {name: values for name, values in infos.items() if not name.startswith("_")}
        # Booleans are zero-dimensional arrays, because Gymnasium's vector environments treat NumPy booleans as objects.
        info = {name: np.array(values[0]) if values.dtype == np.bool_ else values[0] for name, values in own.items()}
        info.update(self.laboratories.roles[self.batch.focal].accounts(0))
        return info

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return the legal actions, in the format of sb3-contrib's MaskablePPO.

        Raises:
            ValueError: the agent's actions are continuous.
        """
        masks: npt.NDArray[np.bool_] = self.batch.action_masks()[0]
        return masks

    def get_state(self) -> State:
        """Return copies of everything that changes, including policies' memories, for :meth:`set_state`."""
        return self.batch.get_state()

    def set_state(self, state: State) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical environment; return the observation."""
        observation: npt.NDArray[np.float32] = self.batch.set_state(state)[0]
        return observation

    def _text(self) -> str:
        return describe_laboratory(self.laboratories, 0)

    def _scene(self) -> Scene:
        from ..render.scene import laboratory_scene

        return laboratory_scene(self.laboratories)
