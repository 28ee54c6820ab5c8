"""The laboratory as a PettingZoo parallel environment: one manager action, or one tick, a step.

| Import | `from chemlab.laboratory import parallel_env` |
|---|---|
| Agents, observations, actions | as in AEC (see `chemlab.laboratory.aec`) |
| Masks | `info["action_mask"]` of every agent with discrete actions, always |

### Turns
Every agent is present in every step. While the manager has the turn the step is its action; after its `wait`, every
step is one tick, in which every busy bench acts, in the scenario's order, until an experiment ends. Whoever does not
have the turn (`info["has_turn"]` is False) has a mask that allows one action only, `wait` for the manager and `end` for
a bench, and what it plays is ignored: it may be left out. The dynamics are those of the AEC environment: the same
actions give the same rewards and states. Masks are of the tick's beginning: an action that another bench has made
impossible in the same tick (it took the last of a bottle) is a lost turn, as any other.

### Infos
`action_mask`, `has_turn` (in the next step), `cost`, `events`, `illegal_action` (of the step), `score` (of an
experiment that ended in it, else absent), `elapsed_ticks` (since the agent last had the turn, or since the
episode's beginning); for the manager also `costs`, and at the end `submitted_mol`, `purity` and `orders`.

### Version history
- v0: first version.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from pettingzoo import ParallelEnv

from .common import OneLaboratory
from .rendering import RENDER_MODES
from .state import RUNNING, TERMINATED

__all__ = ["parallel_env"]


class parallel_env(OneLaboratory, ParallelEnv[str, npt.NDArray[np.float32], Any]):
    """The laboratory for all agents at once; it checks every action itself.

    Args:
        scenario: a shipped name, a path to a TOML file, or a loaded scenario.
        render_mode: one of ``metadata["render_modes"]``, or None.
        rewards: replaces the scenario's reward mix: ``individual``, ``cooperative``, ``mixed`` or a RewardSpec.
        reaction_model, separation_model: physics of your own (see :mod:`chemlab.bench.models`).

    Raises:
        DataError: the scenario is wrong or unknown.
        ValueError: unknown render mode or reward mix.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's class attribute
        "name": "chemlab_laboratory_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": 8,
    }

    def _allocate(self) -> None:
        labs = self.laboratories
        self._turns = np.zeros((len(labs.agents), 1), dtype=np.bool_)
        self._actions = [
            np.zeros(1, dtype=np.int64) if count else np.zeros((1, *(space.shape or ())))
            for count, space in zip(labs.action_counts, self.action_spaces.values(), strict=True)
        ]
        self._resting = [
            _only(action, count) for action, count in zip(labs.resting_actions, labs.action_counts, strict=True)
        ]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, npt.NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Begin an episode.

        Args:
            seed: starts the random streams afresh; without one they go on (a first episode without a seed draws one).
            options: ``{"goal": name}`` asks for one of the scenario's laboratory goals instead of drawing it.

        Raises:
            ValueError: unknown goal.
        """
        self._begin(seed, options)
        self._last_turn = [0] * len(self.agents)
        infos: list[dict[str, Any]] = [{"cost": 0.0, "events": {}, "illegal_action": False} for _ in self.agents]
        self._show()
        return self._seen(infos)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, npt.NDArray[np.float32]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """The manager's action, or one tick.

        Args:
            actions: an action of every agent that has the turn; the others' are ignored.

        Raises:
            ValueError: an action is missing or outside its space (the message names the agent, what was expected and
                what was given), or the episode is over; nothing has changed.
        """
        if not self.agents:
            raise ValueError("step: the episode is over (or has not begun): call reset()")
        labs, names = self.laboratories, self.possible_agents
        acting = [number for number, turn in enumerate(self._turns[:, 0].tolist()) if turn]
        checked = []
        for number in acting:
            if names[number] not in actions:
                raise ValueError(f"{names[number]}: has the turn, so step() needs its action; given {list(actions)}")
            checked.append(labs.checked(number, actions[names[number]])[0])
        for number, action in zip(acting, checked, strict=True):
            self._actions[number][0] = action
        labs.act_round(self._members, self._actions)
        infos = [
            labs.info(number) if number in acting or cost else {"cost": 0.0, "events": {}, "illegal_action": False}
            for number, cost in enumerate(labs.cost[0].tolist())
        ]
        if labs.experiment_ended:
            for number, score in enumerate(labs.scores[0].tolist()):
                if score == score:  # NaN where none of its own has ended
                    infos[number]["score"] = score
        rewards = dict(zip(names, labs.rewards[0].tolist(), strict=True))
        status = labs.desk.status.item(0)
        observations, found = self._seen(infos)
        if status != RUNNING:
            found[names[0]].update(labs.outcome())
            self.agents = []
        self._show()
        return (
            observations,
            rewards,
            dict.fromkeys(names, status == TERMINATED),
            dict.fromkeys(names, status not in (RUNNING, TERMINATED)),
            found,
        )

    def _seen(
        self, infos: list[dict[str, Any]]
    ) -> tuple[dict[str, npt.NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Everybody's observations and, filled in, infos."""
        labs, members, names = self.laboratories, self._members, self.possible_agents
        labs.turns(members, self._turns)
        ticks = labs.desk.ticks.item(0)
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
            elif labs.action_counts[number]:
                info["action_mask"] = self._resting[number].copy()
        infos[0]["costs"] = labs.costs()
        return observations, dict(zip(names, infos, strict=True))


def _only(action: int, count: int) -> npt.NDArray[np.int8]:
    """A mask that allows one action."""
    mask = np.zeros(count, dtype=np.int8)
    mask[action : action + 1] = 1
    return mask
