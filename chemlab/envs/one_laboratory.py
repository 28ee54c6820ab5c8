"""Common parts of the AEC and the parallel environment: one laboratory, its spaces, and resets."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt

from ..config.loading import load_scenario
from ..config.scenario import RewardSpec, Scenario
from ..kernels.rng import checked_seed
from ..lab.engine import Laboratories
from ..lab.text import describe_laboratory
from ..roles.bench import Channel
from ..roles.manager_state import RUNNING
from .global_state import GlobalState
from .inputs import checked_options, number_of
from .rendering import RENDER_MODES, Rendered

if TYPE_CHECKING:
    from ..render.scene import Scene


class OneLaboratory(Rendered):
    """One laboratory as a PettingZoo environment, independent of the interface."""

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's class attribute
        "name": "chemlab_laboratory_v1",
        "render_modes": list(RENDER_MODES),
        "render_fps": 8,
        "is_parallelizable": False,  # by PettingZoo's wrapper; parallel_env is
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        render_mode: str | None = None,
        rewards: str | RewardSpec | None = None,
        split: str | None = None,
        actions: str | None = None,
    ) -> None:
        super().__init__()
        self._set_render_mode(render_mode)
        self.scenario = load_scenario(scenario, rewards=rewards, split=split, actions=actions)
        self.laboratories = Laboratories(self.scenario, 1)
        self.possible_agents = list(self.laboratories.agents)
        self.agents: list[str] = []
        self._number = {agent: i for i, agent in enumerate(self.possible_agents)}
        self.observation_spaces = {agent: self.laboratories.observation_space(i) for agent, i in self._number.items()}
        self.action_spaces = {agent: self.laboratories.action_space(i) for agent, i in self._number.items()}
        self._whole = GlobalState(self.laboratories)
        self.state_space = self._whole.space
        self._members = self.laboratories.members
        self._seeded = False
        self._unfinished = False
        self._resting = [
            (np.arange(role.action_count) == role.resting_action).astype(np.int8) if role.action_count else None
            for role in self.laboratories.roles
        ]
        self._no_events = np.zeros(len(self.scenario.safety_events))
        self._allocate()

    @abstractmethod
    def _allocate(self) -> None:
        """Allocate the arrays that the interface reuses in every step."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.scenario.name}: {', '.join(self.possible_agents)}>"

    def observation_space(self, agent: str) -> gymnasium.spaces.Box:
        """Return the agent's observation space (always the same object); ValueError if it is unknown."""
        return self.observation_spaces[self._known(agent)]

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """Return the agent's action space (always the same object); ValueError if it is unknown."""
        return self.action_spaces[self._known(agent)]

    def _known(self, agent: str) -> str:
        return self.possible_agents[number_of(agent, self.possible_agents)]

    def observe(self, agent: str) -> npt.NDArray[np.float32]:
        """Return the agent's current observation, zeros for a bench without an experiment; ValueError if unknown."""
        number = number_of(agent, self.possible_agents)
        seen: npt.NDArray[np.float32] = self.laboratories.observe(number, self._members)[0]
        return seen

    def state(self) -> npt.NDArray[np.float32]:
        """Return [size] the true state in [0, 1]: see :attr:`state_channels`."""
        whole: npt.NDArray[np.float32] = self._whole.see(self._members)[0]
        return whole

    @property
    def state_channels(self) -> list[Channel]:
        """Channels of :meth:`state` in order; see :mod:`chemlab.envs.global_state`."""
        return self._whole.channels

    def _check_begun(self, call: str) -> None:
        """Raise a ValueError if there are no agents: before the first reset and after an episode."""
        if not self.agents:
            raise ValueError(f"{call}: the episode is over (or has not begun): call reset()")

    def _begin(self, seed: int | None, options: dict[str, Any] | None) -> None:
        seed = checked_seed(seed)
        # PettingZoo's api_test passes its own options, so unknown ones cannot be an error.
        options = checked_options(options, self.scenario.lab_goals, self.laboratories.worlds, strict=False)
        sequence = np.random.SeedSequence(seed) if seed is not None or not self._seeded else None
        self._unfinished = True
        if sequence is not None:
            self.laboratories.seed(0, sequence)
            self._seeded = True
        self.laboratories.reset(self._members, options.get("goal"), options.get("world"))
        self.agents = self.possible_agents[:]

    def _info(self, agent: int, acted: bool = True) -> dict[str, Any]:
        """Return an agent's info with fixed keys, types and shapes.

        It has the consequences of its last turn if it has just ``acted``, and the mask of an agent without the turn.
        """
        role = self.laboratories.roles[agent]
        info = {
            "cost": self.laboratories.state.cost.item(agent, 0),
            "illegal_action": acted and role.illegal.item(0),
            "events": (role.events[0] if acted else self._no_events).copy(),
            "experiment_over": False,
            "score": 0.0,
            "elapsed_ticks": 0,
        }
        resting = self._resting[agent]
        if resting is not None:
            info["action_mask"] = resting.copy()
        info.update(role.accounts(0))
        return info

    def _add_scores(self, infos: list[dict[str, Any]]) -> None:
        """Add the ends and scores of experiments in the last turn or round, and the end of the episode for the
        manager.
        """
        labs = self.laboratories
        if labs.experiment_ended:
            for info, score in zip(infos, labs.scores[0].tolist(), strict=True):
                if score == score:  # NaN if no experiment of the agent has ended
                    info["experiment_over"], info["score"] = True, info["score"] + score
        if labs.state.status.item(0) != RUNNING:
            own = infos[labs.manager.index]
            own["experiment_over"], own["score"] = True, labs.result(self._members).item()

    def _text(self) -> str:
        return describe_laboratory(self.laboratories)

    def _scene(self) -> Scene:
        from ..render.scene import laboratory_scene

        return laboratory_scene(self.laboratories)
