"""The laboratory: a PettingZoo AEC environment of a manager and its benches around a shared shelf of vessels.

| Import | `from chemlab.laboratory import env, raw_env` |
|---|---|
| Agents | `manager_0`, then the scenario's benches: `rxn_0`, `ext_0`, `dit_0`, ... |
| Actions | manager, ext, dit: `Discrete`; rxn: `Box(0, 1)` |
| Observations | flat float32 `Box(0, 1)`; shapes follow the scenario |
| Masks | `info["action_mask"]` of every agent with discrete actions, on its turn |
| Parallel API | not in this version |

### Turn order
The manager has the turn at the start, whenever an experiment has just ended, and after each of its own actions except
`wait`. `wait` hands over: ticks run, in each of which every busy bench has one turn in a fixed order, until at least
one experiment ends. Idle benches have no turn.

### Rewards
A bench earns the score of its experiment when it ends (see its class for the formula). The manager earns, at
`submit`, mol of the laboratory's goal in the vessel x its absolute purity / the scenario's theoretical maximum,
minus all costs; without a submission, minus all costs when the episode is truncated. The scenario mixes the two
(`[rewards]`).

### Infos
`action_mask` (int8, on the agent's turn), `cost` (weighted safety events of its last action), `events` (the same by
kind), `illegal_action` (its last action was masked and did nothing), `score` (of the experiment its last turn ended,
else absent); for the manager also `costs` (what it has been charged so far, by item, in units of the score).

### Arguments
`scenario` (shipped name, path to a TOML file, or a loaded scenario), `render_mode` (`ansi` or None),
`reaction_model` and `separation_model` (physics of your own). `reset(seed, options={"goal": name})` asks for a goal
instead of drawing it.

### Version history
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

from ..bench.models import ReactionModel, SeparationModel
from ..scenario import Scenario
from .core import Laboratories
from .manager import RUNNING, TERMINATED
from .text import describe_laboratory

__all__ = ["env", "raw_env"]


def env(
    scenario: str | Path | Scenario = "wurtz_dodecane", **kwargs: Any
) -> OrderEnforcingWrapper[str, npt.NDArray[np.float32], Any]:
    """The laboratory in PettingZoo's order-enforcing wrapper; arguments as for :class:`raw_env`."""
    return OrderEnforcingWrapper(raw_env(scenario, **kwargs))


class raw_env(AECEnv[str, npt.NDArray[np.float32], Any]):
    """The laboratory without wrappers; it checks every action itself.

    Args:
        scenario: a shipped name, a path to a TOML file, or a loaded scenario.
        render_mode: ``"ansi"`` for text from :meth:`render`, or None.
        reaction_model: replaces the kinetics (see :class:`chemlab.bench.models.ReactionModel`).
        separation_model: replaces layers and partition (see :class:`chemlab.bench.models.SeparationModel`).

    Raises:
        DataError: the scenario is wrong or unknown.
        ValueError: unknown render mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's class attribute
        "name": "chemlab_laboratory_v0",
        "render_modes": ["ansi"],
        "is_parallelizable": False,
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        render_mode: str | None = None,
        reaction_model: ReactionModel | None = None,
        separation_model: SeparationModel | None = None,
    ) -> None:
        super().__init__()
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(
                f"render_mode must be one of {self.metadata['render_modes']} or None, given {render_mode!r}"
            )
        self.render_mode = render_mode
        self.laboratories = Laboratories(scenario, 1, reaction_model, separation_model)
        self.scenario = self.laboratories.scenario
        self.possible_agents = list(self.laboratories.agents)
        self.agents: list[str] = []
        self._number = {agent: i for i, agent in enumerate(self.possible_agents)}
        self.observation_spaces = {agent: self.laboratories.observation_space(i) for agent, i in self._number.items()}
        self.action_spaces = {agent: self.laboratories.action_space(i) for agent, i in self._number.items()}
        size = sum(int(space.shape[0]) for space in self.observation_spaces.values() if space.shape)
        self.state_space = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)
        self._members = self.laboratories.members
        self._seeded = False

    def observation_space(self, agent: str) -> gymnasium.spaces.Box:
        """The agent's observation space (always the same object)."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """The agent's action space (always the same object)."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Begin an episode.

        Args:
            seed: starts the random streams afresh; without one they go on (a first episode without a seed draws one).
            options: ``{"goal": name}`` asks for one of the scenario's laboratory goals instead of drawing it.

        Raises:
            ValueError: unknown goal.
        """
        options = options or {}
        unknown = set(options) - {"goal"}
        if unknown:
            # PettingZoo's api_test passes options of its own, so these cannot be an error.
            gymnasium.logger.warn(f"reset options: known: goal; ignored: {', '.join(sorted(map(str, unknown)))}")
        goal = options.get("goal")
        if goal is not None:
            self.laboratories.goal_index(goal)
        if seed is not None or not self._seeded:
            self.laboratories.seed(0, np.random.SeedSequence(seed))
            self._seeded = True
        self.laboratories.reset(self._members, goal)
        self.agents = self.possible_agents[:]
        self.rewards = dict.fromkeys(self.agents, 0.0)
        self._cumulative_rewards = dict.fromkeys(self.agents, 0.0)
        self.terminations = dict.fromkeys(self.agents, False)
        self.truncations = dict.fromkeys(self.agents, False)
        self.infos = {agent: {"cost": 0.0, "events": {}, "illegal_action": False} for agent in self.agents}
        self._skip_agent_selection = None
        self._give_turn()

    def _give_turn(self) -> None:
        number = self.laboratories.turn()
        self.agent_selection = self.possible_agents[number]
        info = self.infos[self.agent_selection]
        mask = self.laboratories.mask(number, self._members)
        if mask is not None:
            info["action_mask"] = mask[0]
        if number == 0:
            info["costs"] = self.laboratories.costs()

    def step(self, action: Any) -> None:
        """The selected agent's turn.

        Raises:
            ValueError: the action is outside the agent's space; the message names agent, expected and given, and
                nothing has changed.
        """
        agent = self.agent_selection
        if self.terminations[agent] or self.truncations[agent]:
            self._was_dead_step(action)
            return
        number, labs = self._number[agent], self.laboratories
        checked = labs.checked(number, action)
        self._cumulative_rewards[agent] = 0.0
        labs.act(number, self._members, checked)
        self.rewards = dict(zip(self.possible_agents, labs.rewards[0].tolist(), strict=True))
        illegal = labs.desk.illegal[0] if number == 0 else labs.stations[number - 1].illegal[0]
        info: dict[str, Any] = {
            "cost": float(labs.cost[0, number]),
            "events": labs.events(number),
            "illegal_action": bool(illegal),
        }
        self.infos[agent] = info
        for b in np.flatnonzero(np.isfinite(labs.scores[0])):
            self.infos[self.possible_agents[b]]["score"] = float(labs.scores[0, b])
        status = labs.desk.status[0]
        if status == RUNNING:
            self._give_turn()
        else:
            over = self.terminations if status == TERMINATED else self.truncations
            for name in self.agents:
                over[name] = True
            self.agent_selection = self.possible_agents[0]
            self.infos[self.agent_selection]["costs"] = labs.costs()
            self.infos[self.agent_selection]["submitted_mol"] = float(labs.desk.submitted[0, 0])
            self.infos[self.agent_selection]["purity"] = float(labs.desk.submitted[0, 1])
        self._accumulate_rewards()

    def observe(self, agent: str) -> npt.NDArray[np.float32]:
        """What the agent sees now; a bench without an experiment sees zeros."""
        return np.asarray(self.laboratories.observe(self._number[agent], self._members)[0])

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Legal actions of the selected agent, as sb3-contrib's MaskablePPO asks for them.

        Raises:
            ValueError: the selected agent's actions are continuous.
        """
        mask = self.laboratories.mask(self._number[self.agent_selection], self._members)
        if mask is None:
            raise ValueError(f"{self.agent_selection}: continuous actions have no mask")
        return np.asarray(mask[0], dtype=np.bool_)

    def state(self) -> npt.NDArray[np.float32]:
        """All agents' observations in one vector, agents in order."""
        return np.concatenate([self.observe(agent) for agent in self.possible_agents])

    def render(self) -> str | None:
        """The laboratory as text (render mode ``ansi``)."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() was called without a render_mode; pass render_mode='ansi' to raw_env().")
            return None
        return describe_laboratory(self.laboratories, 0)

    def close(self) -> None:
        """Nothing to release."""
