"""The laboratory as an RLlib environment (new API stack): :func:`chemlab.laboratory.raw_env`, turn by turn.

| | |
|---|---|
| Agents | agents of the learning roles; background policies play the others inside the environment |
| Steps | one turn: observations contain only the agent that has it |
| Observations | rxn: as in AEC; discrete roles: `{"observations": as in AEC, "action_mask": int8}` |
| Actions | as in AEC |
| Rewards | with each observation, the agent's rewards since its last one, as `last()` in AEC |
| End | `__all__`; every agent that has had a turn receives a last observation |

Nothing is computed here: `reset` with a seed and the same actions give the AEC environment's observations and rewards
exactly. Rewards of an agent before its first turn (a priced safety event at an experiment's start) arrive with its
first observation; RLlib ascribes them to none of its actions.

>>> from chemlab.agents.rllib import LaboratoryMultiAgentEnv                          # doctest: +SKIP
>>> env = LaboratoryMultiAgentEnv({"scenario": "wurtz_dodecane", "roles": ["manager"]})   # doctest: +SKIP

Needs the extra: ``pip install ".[rllib]"``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.config.extras import needs
from chemlab.config.scenario import Settings
from chemlab.envs.aec import raw_env
from chemlab.envs.inputs import check_by_agent, checked_options
from chemlab.kernels.arrays import IntArray
from chemlab.kernels.rng import checked_seed
from chemlab.lab.episode_streams import INTERRUPTED, Guarded
from chemlab.roles.manager_state import RUNNING

from .background import background_players
from .roles import chosen_roles, role_of

with needs("training on a cluster needs Ray", "rllib"):
    from ray.rllib.env.multi_agent_env import MultiAgentEnv

_SETTINGS = ("scenario", "roles", "background", *Settings.__annotations__)


class LaboratoryMultiAgentEnv(Guarded, MultiAgentEnv):
    """One laboratory for RLlib; see this module's documentation.

    Args:
        config: ``scenario`` (bundled name, path or loaded scenario; default ``wurtz_dodecane``), ``roles`` that learn
            (``manager`` and bench keys; default: all), ``background`` (name of the policies that play the others;
            default ``scripted``), and ``rewards``, ``split``, ``actions`` as for :class:`~chemlab.envs.aec.raw_env`.

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: a setting, role, background, reward mix or split is unknown.
    """

    def __init__(self, config: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        given = dict(config or {})
        unknown = sorted(set(given) - set(_SETTINGS))
        if unknown:
            raise ValueError(f"env_config: known: {', '.join(_SETTINGS)}; given {', '.join(unknown)}")
        roles, background = given.pop("roles", None), given.pop("background", "scripted")
        self.laboratory = raw_env(given.pop("scenario", "wurtz_dodecane"), **given)
        labs = self.laboratory.laboratories
        learning = chosen_roles(labs, roles)
        self.possible_agents = [agent for agent in labs.agents if role_of(agent) in learning]
        self.agents = list(self.possible_agents)
        self._players = background_players(labs, learning, background, self._play)
        self.observation_spaces = {agent: self._seen_space(agent) for agent in self.possible_agents}
        self.action_spaces = {agent: self.laboratory.action_space(agent) for agent in self.possible_agents}
        self._had_turn: set[str] = set()
        # RLlib seeds runners and laboratories of a runner with consecutive seeds, which would overlap.
        self._seed_offset = 1000 * int(getattr(config, "worker_index", 0))

    def _play(self, number: int, members: IntArray, actions: npt.NDArray[Any]) -> None:
        """Play a background policy's turn by AEC's own step, which accumulates rewards and infos."""
        self.laboratory.step(actions[0])

    def _seen_space(self, agent: str) -> gymnasium.Space[Any]:
        seen, actions = self.laboratory.observation_space(agent), self.laboratory.action_space(agent)
        if not isinstance(actions, gymnasium.spaces.Discrete):
            return seen
        mask = gymnasium.spaces.Box(0, 1, (int(actions.n),), np.int8)
        return gymnasium.spaces.Dict({"observations": seen, "action_mask": mask})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode and play up to the first turn of a learning agent.

        Episodes without such a turn are replaced; they occur if a background manager never starts their bench.

        Args:
            seed: starts a series of episodes that depends on the seed alone; None: the next episode of the series. In
                RLlib's env runner i, 1000 i is added.
            options: ``{"goal": name}``, ``{"world": seed or values}``, as in AEC.

        Raises:
            ValueError: an option, goal or world is unknown, or the seed is not a non-negative integer; nothing has
                changed.
            RuntimeError: the background policies never start these agents.
        """
        seed = checked_seed(seed)
        labs = self.laboratory.laboratories
        checked_options(options, labs.scenario.lab_goals, labs.worlds)
        super().reset(seed=seed, options=options)
        self._unfinished = True
        seeds = iter([] if seed is None else [seed + self._seed_offset])

        def begin(members: IntArray) -> None:
            own = next(seeds, None)
            self.laboratory.reset(seed=own, options=options or None)
            if own is not None:
                self._players.seed(0, own)

        self._players.begin(labs.members, begin)
        self._had_turn = set()
        observations, _, infos = self._at_turn()
        self._unfinished = False
        return observations, infos

    def _running(self) -> bool:
        return bool(self.laboratory.laboratories.state.status[0] == RUNNING)

    def step(
        self, action_dict: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Play one turn of the agent that has it; the others then play up to the next turn of a learning agent.

        Args:
            action_dict: the action of the agent that has the turn.

        Raises:
            ValueError: the episode is over, the action is missing or of an agent that does not have the turn, or it is
                outside the agent's space; nothing has changed.
            gymnasium.error.ResetNeeded: an earlier step was interrupted or failed.
        """
        if self._unfinished:
            raise gymnasium.error.ResetNeeded(INTERRUPTED)
        if not self._had_turn or not self._running():
            raise ValueError("step: the episode is over (or has not begun): call reset()")
        check_by_agent(action_dict)
        agent = self.laboratory.agent_selection
        if set(action_dict) != {agent}:
            raise ValueError(f"{agent}: has the turn, so step() needs its action alone; given {list(action_dict)}")
        self._guarded(self.laboratory.step, action_dict[agent])
        self._players.play_on(self.laboratory.laboratories.members)
        running = self._running()
        had_turn = [agent for agent in self.possible_agents if agent in self._had_turn]
        observations, rewards, infos = self._at_turn() if running else self._of(had_turn)
        self._unfinished = False
        return observations, rewards, {"__all__": not running}, {"__all__": False}, infos

    def _at_turn(self) -> tuple[dict[str, Any], dict[str, float], dict[str, Any]]:
        agent = self.laboratory.agent_selection
        self._had_turn.add(agent)
        return self._of([agent])

    def _of(self, agents: list[str]) -> tuple[dict[str, Any], dict[str, float], dict[str, Any]]:
        """Return observations, rewards and infos of some agents; the mask of an agent without the turn has one legal
        action.
        """
        laboratory = self.laboratory
        infos = {agent: dict(laboratory.infos[agent]) for agent in agents}  # RLlib keeps them
        observations: dict[str, Any] = {}
        for agent in agents:
            seen, space = laboratory.observe(agent), self.action_spaces[agent]
            if isinstance(space, gymnasium.spaces.Discrete):
                observations[agent] = {"observations": seen, "action_mask": infos[agent]["action_mask"]}
            else:
                observations[agent] = seen
        # As PettingZoo's last(): the agent's rewards since its own last turn.
        rewards = {agent: float(laboratory._cumulative_rewards[agent]) for agent in agents}
        return observations, rewards, infos

    @property
    def score(self) -> float:
        """The laboratory's raw score so far: delivered products minus all costs."""
        labs = self.laboratory.laboratories
        return float(labs.result(labs.members)[0])
