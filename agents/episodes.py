"""Play episodes of a laboratory with one policy per agent."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from chemlab.envs.aec import raw_env
from chemlab.lab.text import action_words
from chemlab.record import Play, Recorder
from chemlab.roles.manager_state import COST_ITEMS, LIMIT, RUNNING, STATUS_WORDS

from .policies import Policy

__all__ = ["EpisodeResult", "PlayedTurn", "play_episode"]


@dataclass(frozen=True)
class PlayedTurn:
    """One agent's turn, as it has just been played."""

    agent: str
    tick: int
    step: int
    action: Any
    meaning: str
    reward: float
    info: Mapping[str, Any]


@dataclass
class EpisodeResult:
    """What an episode came to; :meth:`as_dict` is what ``chemlab run --json`` prints.

    ``score`` is the manager's result: product by amount and purity, minus costs. ``status`` says how the episode ended
    (:data:`~chemlab.roles.manager_state.STATUS_WORDS`).
    """

    scenario: str
    policy: str
    seed: int
    goal: str = ""
    submitted_mol: float = 0.0
    purity: float = 0.0
    score: float = 0.0
    manager_actions: int = 0
    ticks: int = 0
    rewards: dict[str, float] = field(default_factory=dict)
    costs: dict[str, float] = field(default_factory=dict)
    safety_events: dict[str, float] = field(default_factory=dict)
    status: str = STATUS_WORDS[RUNNING]

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain Python values."""
        return dict(vars(self))

    def words(self) -> str:
        """The outcome, the costs and the score as a line."""
        costs = ", ".join(f"{item} {value:.4f}" for item, value in self.costs.items() if value > 0.0)
        end = f"submitted {self.submitted_mol:.3f} mol {self.goal} at purity {self.purity:.3f}"
        if self.status == STATUS_WORDS[LIMIT]:
            end = f"ran out of actions or ticks; {end if self.submitted_mol > 0.0 else 'nothing submitted'}"
        return f"{end}; costs: {costs or 'none'}; score {self.score:.3f}"


def play_episode(
    env: raw_env,
    policies: Mapping[str, Policy],
    seed: int,
    policy_name: str = "",
    watch: Callable[[PlayedTurn], None] | None = None,
    options: dict[str, Any] | None = None,
    recorder: Recorder | None = None,
) -> EpisodeResult:
    """Play one episode.

    Args:
        env: the laboratory, without wrappers.
        policies: a policy for every agent.
        seed: the episode's seed.
        policy_name: what to call the policies in the result.
        watch: called after every turn.
        options: passed to ``env.reset``.
        recorder: writes the episode's record.

    Returns:
        The episode's result.
    """
    env.reset(seed=seed, options=options)
    if recorder is not None:
        recorder.begin(seed, options)
    labs, members = env.laboratories, env.laboratories.members
    result = EpisodeResult(env.scenario.name, policy_name, seed, rewards=dict.fromkeys(env.possible_agents, 0.0))
    result.goal = ", ".join(env.scenario.goals[goal] for goal in labs.state.goal[0])
    while labs.state.status[0] == RUNNING:
        agent = env.agent_selection
        number = env.possible_agents.index(agent)
        observation, _, _, _, info = env.last()
        assert observation is not None
        mask = info.get("action_mask")
        tick = int(labs.state.ticks[0])
        step = int(labs.turns_had(number)[0])
        action = policies[agent].act(
            observation[None], None if mask is None else mask[None], np.array([step]), members
        )[0]
        env.step(action)
        if recorder is not None:
            recorder.turn([Play(number, observation, mask, action)])
        for name, reward in env.rewards.items():
            result.rewards[name] += reward
        if watch is not None:
            words = action_words(labs, number, action)
            watch(PlayedTurn(agent, tick, step, action, words, env.rewards[agent], env.infos[agent]))
    outcome = labs.outcome()
    result.submitted_mol, result.purity = outcome["submitted_mol"], outcome["purity"]
    result.score = float(labs.result(members)[0])
    result.manager_actions, result.ticks = int(labs.state.actions[0]), int(labs.state.ticks[0])
    result.costs = {item: float(value) for item, value in zip(COST_ITEMS, labs.state.charges[0], strict=True)}
    totals = zip(labs.scenario.safety_events, labs.safety_totals[0], strict=True)
    result.safety_events = {kind: float(value) for kind, value in totals if value > 0.0}
    result.status = STATUS_WORDS[labs.state.status[0]]
    return result
