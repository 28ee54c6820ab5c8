"""Batched laboratories with all agents: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from typing_extensions import Unpack

from ..config.scenario import Scenario, Settings
from ..kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from ..lab.engine import Laboratories
from ..lab.hidden import World
from ..roles.bench import Channel
from ..roles.manager_state import RUNNING
from .global_state import GlobalState
from .inputs import check_by_agent, check_count, checked_actions, number_of, parsed_reset

Arrays = dict[str, npt.NDArray[Any]]


class BatchedLaboratory:
    """N laboratories with the turns of :class:`~chemlab.envs.parallel.parallel_env`, in one set of arrays.

    Member i reset with seed s + i plays the same as a single laboratory with that seed, for any N. A laboratory whose
    episode ends is reset in the same step, unless ``autoreset`` is off.

    Args:
        num_envs: number of laboratories N.
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        idle_observations: whether observations of agents without the turn are updated as well; otherwise their rows
            keep the last ones of the episode (before them, zeros), which saves most of the observation time.
        copy: whether returned arrays are copies; if False, the next step overwrites them.
        autoreset: whether a laboratory whose episode ends is reset in the same step; otherwise the caller resets it
            before the next one by ``options["reset_mask"]``, and its arrays show the end until then.
        infos: whether infos are complete; otherwise they have ``has_turn``, ``action_mask``, ``experiment_over`` and
            ``score`` only, which takes less time, and for the manager ``paid`` [N] (of the score, for what was
            submitted) and ``partial`` [N] (:meth:`~chemlab.lab.engine.Laboratories.partial_worth`), of episodes that
            have ended.
        settings: ``rewards``, ``split`` and ``actions`` (:meth:`~chemlab.config.scenario.Scenario.configured`).

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: ``num_envs`` is no integer of at least 1, or the reward mix or the split is unknown.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        idle_observations: bool = False,
        copy: bool = True,
        autoreset: bool = True,
        infos: bool = True,
        **settings: Unpack[Settings],
    ) -> None:
        check_count("num_envs", num_envs, "scenario")
        self.num_envs = num_envs
        self.laboratories = labs = Laboratories(scenario, num_envs, **settings)
        self.scenario = labs.scenario
        self.possible_agents = list(labs.agents)
        self._whole = GlobalState(labs)
        self.idle_observations = idle_observations
        self.copy, self.autoreset, self.infos = copy, autoreset, infos
        self._random = np.random.default_rng()
        self._begun = False
        self._turns = np.zeros((len(labs.agents), num_envs), dtype=np.bool_)
        self._last_turn = np.zeros((len(labs.agents), num_envs), dtype=np.int64)
        self._observations: list[ObservationArray] = [
            np.zeros((num_envs, size), dtype=np.float32) for size in labs.observation_sizes
        ]
        self._masks: list[MaskArray] = [
            np.tile(np.arange(role.action_count) == role.resting_action, (num_envs, 1)).astype(np.int8)
            for role in labs.roles
        ]
        self._idle_actions = labs.no_actions()

    def observation_space(self, agent: str) -> gymnasium.spaces.Box:
        """Return the observation space of one agent in one laboratory."""
        return self.laboratories.observation_space(number_of(agent, self.possible_agents))

    def action_space(self, agent: str) -> gymnasium.Space[Any]:
        """Return the action space of one agent in one laboratory."""
        return self.laboratories.action_space(number_of(agent, self.possible_agents))

    @property
    def state_space(self) -> gymnasium.spaces.Box:
        """Space of one laboratory's :meth:`state`."""
        return self._whole.space

    @property
    def state_channels(self) -> list[Channel]:
        """Channels of :meth:`state` in order; see :mod:`chemlab.envs.global_state`."""
        return self._whole.channels

    def state(self, members: Any = None) -> ObservationArray:
        """Return [B, size] the true states of laboratories, by indices [B] or a mask [N] (default: all), for critics.

        For an episode that has just ended, it is the state of the next one (without ``autoreset``: of its end).
        """
        return self._whole.see(self.laboratories.members[... if members is None else members])

    def reset(
        self, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, ObservationArray], dict[str, Arrays]]:
        """Start episodes in every laboratory, or in those of ``options["reset_mask"]`` [N].

        Args:
            seed: s seeds member i with s + i; a sequence gives each member its own (None: the next episode of its
                series).
            options: ``{"reset_mask": bool [N]}``, ``{"goal": name}``, ``{"world": seed or values}`` (of all members).

        Returns:
            Observations [N, size] and infos by agent, as from :meth:`step`.

        Raises:
            ValueError: an option, goal or world is unknown, a mask or seeds have the wrong length, or a seed is not a
                non-negative integer; nothing has changed.
        """
        mask, seeds, goal, world = parsed_reset(
            seed, options, self.num_envs, self.scenario.lab_goals, self.laboratories.worlds, self._begun, self._random
        )
        labs, members = self.laboratories, np.flatnonzero(mask)
        self._begun = False  # until it is finished: after an interruption only a reset of all members helps
        for member in members.tolist():
            member_seed = seeds[member]
            if member_seed is not None:
                labs.seed(member, member_seed)
        self._restart(members, goal, world)
        self._turns[:, members] = True  # an interrupted step may have left rows of masks: all are written
        self._look()
        found = self._seen(), self._infos(self._told(members[:0], begun=True))
        self._begun = True
        return found

    def _restart(self, members: IntArray, goal: str | None = None, world: World | None = None) -> None:
        self.laboratories.reset(members, goal, world)
        self._last_turn[:, members] = 0
        for seen in self._observations:
            seen[members] = 0.0

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, ObservationArray],
        dict[str, FloatArray],
        npt.NDArray[np.bool_],
        npt.NDArray[np.bool_],
        dict[str, Arrays],
    ]:
        """Play one round in every laboratory: the manager's action if it has the turn, else one tick.

        Args:
            actions: actions of every agent with the turn anywhere: [N] integers or [N, n] numbers; rows of laboratories
                in which it does not have the turn are ignored.

        Returns:
            Observations [N, size] by agent; rewards [N] by agent; whether each laboratory's episode has terminated [N]
            and been truncated [N] (none is: a limit terminates it); infos by agent, those of
            :class:`~chemlab.envs.parallel.parallel_env` with an axis of N in front: ``has_turn`` [N] (in the next
            step), ``action_mask`` [N, actions] (discrete actions), ``elapsed_ticks`` [N] (since the agent last had the
            turn, or its episode began; where an episode has ended, until then), ``cost`` [N], ``events`` [N, kinds],
            ``illegal_action`` [N], ``experiment_over`` [N] and ``score`` [N] (of its experiment, for the manager of the
            episode; 0 where none has ended), and for the manager ``costs`` [N, items], ``goals``, ``submitted_mol`` and
            ``purity`` [N, orders] (of an episode that has ended, not of the one that follows). Where episodes have
            ended also ``final_obs`` [K, size] of the K laboratories, in order.

        Raises:
            ValueError: actions are no mapping, missing or outside their space (nothing has changed), :meth:`reset` was
                never called, or an earlier step was interrupted or failed.
        """
        labs, members = self.laboratories, self.laboratories.members
        checked = self.checked(actions, range(len(self.possible_agents)))
        self._begun = False  # until it is finished, as in reset
        labs.act_round(members, checked)
        rewards = dict(zip(self.possible_agents, labs.state.rewards.copy(), strict=True))
        ended = labs.state.status != RUNNING
        over = members[ended]
        told = self._told(over)
        finals: list[ObservationArray] = []
        if len(over):
            if self.infos or not self.autoreset:
                finals = [labs.observe(number, over) for number in range(len(self.possible_agents))]
            if self.autoreset:
                self._restart(over)
        self._look()
        if not self.autoreset and len(over):
            for seen, final in zip(self._observations, finals, strict=True):
                seen[over] = final
        infos = self._infos(told)
        for agent, final in zip(self.possible_agents, finals if self.infos else (), strict=False):
            infos[agent]["final_obs"] = final
        found = self._seen(), rewards, ended, np.zeros(self.num_envs, dtype=np.bool_), infos
        self._begun = True
        return found

    def checked(self, actions: Any, agents: Iterable[int]) -> list[npt.NDArray[Any]]:
        """Return the actions of a round, as for :meth:`step`, of some agents by index.

        Raises:
            ValueError: as for :meth:`step`.
        """
        if not self._begun:
            raise ValueError("step: the episodes have not begun, or a step was interrupted or failed: call reset()")
        check_by_agent(actions)
        labs = self.laboratories
        if not self.autoreset and (labs.state.status != RUNNING).any():
            raise ValueError('step: episodes are over: call reset(options={"reset_mask": ...}) for them')
        checked = []
        for number in agents:
            agent, turn = self.possible_agents[number], self._turns[number]
            if not turn.any():
                checked.append(self._idle_actions[number])
            elif agent in actions:
                space = labs.action_space(number)
                checked.append(checked_actions(agent, actions[agent], self.num_envs, space, turn))
            else:
                raise ValueError(f"{agent}: has the turn, so step() needs its actions; given {list(actions)}")
        return checked

    def _look(self) -> None:
        """Update turns, observations and masks."""
        labs, members = self.laboratories, self.laboratories.members
        before = self._turns.copy()
        labs.turns(members, self._turns)
        for number, role in enumerate(labs.roles):
            who = members[self._turns[number]]
            shown = members if self.idle_observations else who
            if len(shown):
                rows = None if len(shown) == self.num_envs else shown
                labs.observe(number, shown, self._observations[number], rows)
            if role.action_count:
                masks, rest = self._masks[number], members[before[number] & ~self._turns[number]]
                if len(rest):
                    masks[rest] = 0
                    masks[rest, role.resting_action] = 1
                if len(who):
                    legal = labs.mask(number, who)
                    assert legal is not None, "actions are discrete"
                    masks[who] = legal

    def _seen(self) -> dict[str, ObservationArray]:
        pairs = zip(self.possible_agents, self._observations, strict=True)
        return {agent: array.copy() if self.copy else array for agent, array in pairs}

    def _told(self, over: IntArray, begun: bool = False) -> list[Arrays]:
        """Return every agent's infos of the round before the episodes of ``over`` restart, or after a reset, when some
        have ``begun`` and nothing has happened in any.
        """
        labs, state = self.laboratories, self.laboratories.state
        acted = np.zeros_like(self._turns) if begun else self._turns
        scores = np.full_like(state.scores, np.nan) if begun else state.scores.copy()
        paid, partial = np.zeros(self.num_envs), np.zeros(self.num_envs)
        if len(over):
            scores[labs.manager.index, over] = labs.result(over)
            paid[over] = labs.worth(over).mean(axis=1)
            partial[over] = labs.partial_worth(over)
        ended = np.isfinite(scores)
        scores[~ended] = 0.0
        if not self.infos:
            few: list[Arrays] = [{"experiment_over": ended[a], "score": scores[a]} for a in range(len(scores))]
            few[labs.manager.index] |= {"paid": paid, "partial": partial}
            return few
        cost = np.zeros_like(state.cost) if begun else state.cost.copy()
        # An experiment may start with a safety event in a round in which its agent has not acted.
        eventful = acted | (cost > 0.0)
        elapsed = state.ticks - self._last_turn
        told: list[Arrays] = []
        for number, role in enumerate(labs.roles):
            info: Arrays = {"elapsed_ticks": elapsed[number], "cost": cost[number]}
            info["illegal_action"] = role.illegal & acted[number]
            info["events"] = role.events * eventful[number, :, None]
            info.update(role.accounts(slice(None)))
            told.append({**info, "experiment_over": ended[number], "score": scores[number]})
        return told

    def _infos(self, told: list[Arrays]) -> dict[str, Arrays]:
        """Return the complete infos: those of the round, next turns, and masks."""
        turns, ticks = self._turns.copy(), self.laboratories.state.ticks
        np.copyto(self._last_turn, ticks, where=turns)
        infos: dict[str, Arrays] = {}
        for number, agent in enumerate(self.possible_agents):
            infos[agent] = {"has_turn": turns[number], **told[number]}
            if self.laboratories.action_counts[number]:
                infos[agent]["action_mask"] = self._masks[number].copy() if self.copy else self._masks[number]
        return infos
