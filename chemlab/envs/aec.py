"""The laboratory: a PettingZoo AEC environment of a manager and its benches around a shared shelf of vessels.

| Import | `from chemlab import env, raw_env` |
|---|---|
| Agents | `manager_0`, then the scenario's benches: `rxn_0`, `ext_0`, `dit_0`, ... |
| Actions | reaction benches: `Box(0, 1)`; the manager and all others: `Discrete` |
| Observations | flat float32 `Box(0, 1)`; shapes follow the scenario |
| Masks | `info["action_mask"]` of every agent with discrete actions, on its turn |
| Parallel API | `parallel_env`, natively: see `chemlab.envs.parallel` |

### Turn order
The manager has the turn at the start, when an experiment or a repair has ended, when an order has arrived, and after
each of its own actions except `wait`; while all benches are idle, also at the deadline of an order. `wait` lets ticks
pass until one of these happens. In each tick, every busy bench has one turn in a fixed order. Idle benches have none.

### Rewards
A bench earns the score of its experiment at its end (see its class for the formula). The manager earns, at `submit`,
mol of the laboratory's goal in the vessel x its absolute purity / the scenario's theoretical maximum, or the price of
an order with terms, minus all costs and penalties for orders that pay nothing. The scenario mixes both (`[rewards]`).

### Infos
Infos are numbers and arrays with the same keys, types and shapes in every step. Every agent has:

- `cost`: weighted safety events of its last action, and of an experiment's beginning since; `events`: the same by kind,
  [kinds, as in `safety_events`].
- `illegal_action`: its last action was invalid.
- `experiment_over` and `score`: whether its experiment has ended by its last action or since, and the score (the sum,
  should several have ended), else 0; for the manager, those of the episode.
- `elapsed_ticks`: on its turn and at the end, ticks since its previous turn or the beginning of the episode (the
  discount of a semi-Markov step); else 0.
- `action_mask` for discrete actions: int8; without the turn only `wait` or `end` is legal.

The manager also has `costs` [items, as in :data:`~chemlab.roles.manager_state.COST_ITEMS`] (so far, in units of the
score), and for each order `goals` (index into the scenario's goals), `submitted_mol` and `purity` (0 before a
submission). :func:`chemlab.lab.text.named_events` and :func:`~chemlab.lab.text.named_costs` return them by name.

### State
`state()` is the complete true state in [0, 1], for centralized critics in training; `state_channels` names its parts
(:mod:`chemlab.envs.global_state`).

### Arguments
- `scenario`: bundled name, path to a TOML file, or a loaded scenario.
- `render_mode`: `ansi`, `rgb_array`, `rgb_array_true`, `human` or None.
- `rewards`: another reward mix: `individual`, `cooperative`, `mixed` or a RewardSpec.
- `split`: split of worlds for hidden parameters: `train`, `validation`, `test` or `private:SALT`.
- `actions`: `discrete` replaces continuous actions of benches by a choice among representative ones.

`reset(seed, options={"goal": name})` sets the goal instead of drawing it; `{"world": seed or values}` sets the world.

### Version history
- v1: worlds, version 2: no observation of a vessel before the first turn, noise and resolution as declared, a price for
  orders that are not met.
- v0: first version.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from pettingzoo import AECEnv
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from ..config.scenario import RewardSpec, Scenario
from ..lab.episode_streams import INTERRUPTED
from ..roles.manager_state import RUNNING
from .one_laboratory import OneLaboratory

_Last = tuple[npt.NDArray[np.float32] | None, float, bool, bool, dict[str, Any]]


def env(
    scenario: str | Path | Scenario = "wurtz_dodecane",
    render_mode: str | None = None,
    rewards: str | RewardSpec | None = None,
    split: str | None = None,
    actions: str | None = None,
) -> OrderEnforcingWrapper[str, npt.NDArray[np.float32], Any]:
    """Return the laboratory in PettingZoo's order-enforcing wrapper; arguments and errors as for :class:`raw_env`."""
    laboratory = raw_env(scenario, render_mode, rewards, split, actions)
    return _Enforced(laboratory)


class _Enforced(OrderEnforcingWrapper[str, npt.NDArray[np.float32], Any]):
    def last(self, observe: bool = True) -> _Last:
        found: _Last = self.env.last(observe)
        return found

    def __repr__(self) -> str:
        return repr(self.env)

    def __str__(self) -> str:
        return str(self.env)

    def _repr_html_(self) -> str:
        return self.unwrapped._repr_html_()  # type: ignore[no-any-return]


class raw_env(OneLaboratory, AECEnv[str, npt.NDArray[np.float32], Any]):
    """The laboratory as a PettingZoo AEC environment, without wrappers; it checks every action itself.

    Args:
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        render_mode: one of ``metadata["render_modes"]``, or None.
        rewards, split, actions: see :meth:`~chemlab.config.scenario.Scenario.configured`.

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: the render mode, reward mix or split is unknown.
    """

    def _allocate(self) -> None:
        self._one_action = np.zeros(1, dtype=np.int64)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
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
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos = {agent: self._info(number) for number, agent in enumerate(self.agents)}
        self._last_turn = dict.fromkeys(self.agents, 0)
        self._skip_agent_selection = None
        self._give_turn()
        self._unfinished = False
        self._show()

    def _give_turn(self) -> None:
        labs = self.laboratories
        number = labs.turn()
        self.agent_selection = agent = self.possible_agents[number]
        info = self.infos[agent]
        mask = labs.mask(number, self._members)
        if mask is not None:
            info["action_mask"] = mask[0]
        ticks = labs.state.ticks.item(0)
        info["elapsed_ticks"] = ticks - self._last_turn[agent]
        self._last_turn[agent] = ticks

    def step(self, action: Any) -> None:
        """Play the selected agent's turn.

        Raises:
            ValueError: the action is outside the agent's space (after the end: is not None), or there is no agent left;
                the message names agent, expected and given, and nothing has changed.
            gymnasium.error.ResetNeeded: an earlier step was interrupted or failed.
        """
        if self._unfinished:
            raise gymnasium.error.ResetNeeded(INTERRUPTED)
        self._check_begun("step")
        agent = self.agent_selection
        if self.terminations[agent]:
            if action is not None:
                raise ValueError(f"{agent}: the episode is over, so its action must be None, given {action!r}")
            self._unfinished = True
            self._was_dead_step(action)
            self._unfinished = False
            return
        number, labs = self._number[agent], self.laboratories
        if type(action) is int and 0 <= action < labs.action_counts[number]:
            checked = self._one_action  # the common case, without allocating an array
            checked[0] = action
        else:
            checked = labs.checked(number, action)
        self._unfinished = True
        self._cumulative_rewards[agent] = 0.0
        labs.act(number, self._members, checked)
        self.rewards = dict(zip(self.possible_agents, labs.rewards[0].tolist(), strict=True))
        infos = self.infos
        infos[agent] = self._info(number)
        manages = number == labs.manager.index
        if manages and labs.state.begun.item(0) >= 0:  # an experiment may start with a safety event
            for other, cost in enumerate(labs.cost[0].tolist()):
                if cost:
                    info = infos[self.possible_agents[other]]
                    info["cost"] += cost
                    info["events"] = info["events"] + labs.roles[other].events[0]
        status = labs.state.status.item(0)
        if labs.experiment_ended or status != RUNNING:
            self._add_scores(list(infos.values()))
        if status == RUNNING:
            self._give_turn()
        else:
            for name in self.agents:  # a limit terminates as well: see chemlab.roles.manager_state
                self.terminations[name] = True
                infos[name]["elapsed_ticks"] = labs.state.ticks.item(0) - self._last_turn[name]
            self.agent_selection = labs.manager.name
        if not manages and self.agent_selection == labs.manager.name:
            infos[self.agent_selection].update(labs.manager.accounts(0))
        self._accumulate_rewards()
        self._unfinished = False
        self._show()

    def last(self, observe: bool = True) -> _Last:
        """Return the selected agent's observation, reward since its last turn, termination, truncation and info.

        Raises:
            ValueError: no agent is left, or the first episode has not begun.
        """
        self._check_begun("last")
        found: _Last = super().last(observe)
        return found

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return the legal actions of the selected agent, in the format of sb3-contrib's MaskablePPO.

        Raises:
            ValueError: the selected agent's actions are continuous, no agent is left, or the first episode has not
                begun.
        """
        self._check_begun("action_masks")
        mask = self.laboratories.mask(self._number[self.agent_selection], self._members)
        if mask is None:
            raise ValueError(f"{self.agent_selection}: continuous actions have no mask")
        return np.asarray(mask[0], dtype=np.bool_)
