"""The laboratory as a PettingZoo parallel environment: a step is one manager action or one tick.

| Import | `from chemlab import parallel_env` |
|---|---|
| Agents, observations, actions | as in AEC (see `chemlab.envs.aec`) |
| Masks | `info["action_mask"]` of every agent with discrete actions, always |

### Turns
Every agent is present in every step. While the manager has the turn, a step is its action. After its `wait`,
every step is one tick, in which every busy bench acts in the scenario's order, until the manager has the turn again. An
agent without the turn (`info["has_turn"]` is False) has a mask with one action only, `wait` for the manager and `end`
for a bench; its action is ignored and may be omitted. The dynamics are those of the AEC environment: equal actions give
equal rewards and states. Masks refer to the beginning of the tick: an action that another bench makes impossible in the
same tick (by taking the last of a bottle) is invalid.

### Infos
As in AEC for the step, and `has_turn` (in the next one). `elapsed_ticks` is the number of ticks since the
agent last had the turn, or since the beginning of the episode.

### Version history
- v1: worlds, version 2: no observation of a vessel before the first turn, noise and resolution as declared, a price for
  orders that are not met.
- v0: first version.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from pettingzoo import ParallelEnv

from ..lab.episode_streams import INTERRUPTED
from ..roles.manager_state import RUNNING
from .inputs import check_by_agent
from .one_laboratory import OneLaboratory


class parallel_env(OneLaboratory, ParallelEnv[str, npt.NDArray[np.float32], Any]):
    """The laboratory as a PettingZoo parallel environment, for all agents at once; it checks every action itself.

    Args:
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        render_mode: one of ``metadata["render_modes"]``, or None.
        rewards, split, actions: see :meth:`~chemlab.config.scenario.Scenario.configured`.

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: the render mode, reward mix or split is unknown.
    """

    def _allocate(self) -> None:
        labs = self.laboratories
        self._turns = np.zeros((len(labs.agents), 1), dtype=np.bool_)
        self._actions = labs.no_actions()

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, npt.NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Start an episode.

        Args:
            seed: starts a series of episodes that depends on the seed alone; None: the next episode of the series (the
                first reset draws a seed).
            options: ``{"goal": name}`` sets one of the scenario's laboratory goals instead of drawing it, ``{"world":
                seed or values}`` sets the world (see :meth:`chemlab.lab.hidden.Worlds.begin`).

        Raises:
            ValueError: the goal is unknown, the world is invalid, or the seed is not a non-negative integer; nothing
                has changed.
        """
        self._begin(seed, options)
        self._last_turn = [0] * len(self.agents)
        found = self._seen([self._info(number) for number in range(len(self.agents))])
        self._unfinished = False
        self._show()
        return found

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, npt.NDArray[np.float32]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Play the manager's action, or one tick.

        Args:
            actions: actions of all agents with the turn; others are ignored.

        Raises:
            ValueError: no mapping is given, an action is missing or outside its space (the message names the agent,
                what was expected and what was given), or the episode is over; nothing has changed.
            gymnasium.error.ResetNeeded: an earlier step was interrupted or failed.
        """
        if self._unfinished:
            raise gymnasium.error.ResetNeeded(INTERRUPTED)
        self._check_begun("step")
        check_by_agent(actions)
        labs, names = self.laboratories, self.possible_agents
        labs.turns(self._members, self._turns)  # a snapshot may have been restored
        acting = [number for number, turn in enumerate(self._turns[:, 0].tolist()) if turn]
        checked = []
        for number in acting:
            if names[number] not in actions:
                raise ValueError(f"{names[number]}: has the turn, so step() needs its action; given {list(actions)}")
            checked.append(labs.checked(number, actions[names[number]])[0])
        for number, action in zip(acting, checked, strict=True):
            self._actions[number][0] = action
        self._unfinished = True
        labs.act_round(self._members, self._actions)
        infos = [
            self._info(number, number in acting or cost > 0.0) for number, cost in enumerate(labs.cost[0].tolist())
        ]
        self._add_scores(infos)
        rewards = dict(zip(names, labs.rewards[0].tolist(), strict=True))
        over = labs.state.status.item(0) != RUNNING
        observations, found = self._seen(infos)
        if over:
            self.agents = []
        self._unfinished = False
        self._show()
        return (
            observations,
            rewards,
            dict.fromkeys(names, over),  # a limit terminates as well: see chemlab.roles.manager_state
            dict.fromkeys(names, False),
            found,
        )

    def _seen(
        self, infos: list[dict[str, Any]]
    ) -> tuple[dict[str, npt.NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Return all observations and complete infos."""
        labs, members, names = self.laboratories, self._members, self.possible_agents
        labs.turns(members, self._turns)
        ticks = labs.state.ticks.item(0)
        observations = {}
        for number, has_turn in enumerate(self._turns[:, 0].tolist()):
            info = infos[number]
            observations[names[number]] = labs.observe(number, members)[0]
            info["has_turn"] = has_turn
            info["elapsed_ticks"] = ticks - self._last_turn[number]
            if has_turn:
                self._last_turn[number] = ticks
                mask = labs.mask(number, members)
                if mask is not None:
                    info["action_mask"] = mask[0]
        return observations, dict(zip(names, infos, strict=True))
