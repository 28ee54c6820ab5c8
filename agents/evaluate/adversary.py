"""Adversarial learners of an audit: PPO of all roles, without memory, with or without instruments.

Their score without instruments is what can be learned without paid measurements, from any channel of the scenario. The
networks are feed-forward, so information of earlier observations is lost unless the scenario shows it again.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Actions, Policy, Watching
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories

from ..episodes import play_laboratory
from ..open_loop import Context
from ..policies import make_policies
from ..roles import MANAGER_ROLE, role_of
from .plans import SEARCH_SEED, TeamPlan, Trials

if TYPE_CHECKING:
    from ..train.ppo import PPOTeam

_DONORS = 16
"""Number of cloned episodes of every context."""
_CHECK_SEED = 4_600_000
"""Seed of the first episode of evaluations during training."""


def learned_scores(
    scenario: Scenario,
    turns: int,
    episodes: int,
    seed: int,
    begin: Mapping[Context, TeamPlan] | None = None,
) -> list[float]:
    """Train a team as ``chemlab train SCENARIO --roles all --no-notes`` does, and score it.

    Every agent's reward is the team's result. The networks with the best evaluation in ``validation``, greedy or
    sampled, are scored; the clone before training is evaluated as well.

    Args:
        scenario: the scenario.
        turns: number of training turns of all agents together.
        episodes: number of scored episodes; episode i has seed + i.
        seed: seed of the first scored episode.
        begin: open-loop policies by context that are cloned first; None: training starts from nothing.

    Returns:
        [episodes] scores in worlds of ``test``.
    """
    import torch

    from ..train.arguments import IPPO
    from ..train.ppo import PPOTeam

    spec = scenario.configured(rewards="cooperative")
    # Notes are a memory. A team that begins from a policy has no teacher. Other settings are those of stored audits.
    start = None if begin is None else "open loop"
    settings = IPPO(notes=False, rollout=128, batch_size=1024, begin_from=start)
    team = PPOTeam(spec, [MANAGER_ROLE, *spec.benches], settings, "scripted")
    if begin is not None:
        _clone(team, spec, begin, settings.bc_std)
    best: tuple[float, dict[str, Any], bool] = (-np.inf, {}, False)
    learned, rounds, checks = 0, 0, settings.evaluations if turns else 0
    for check in range(begin is None and turns > 0, checks + 1):
        while learned * checks < turns * check:
            learned += team.learn(learned / turns, rounds)
            rounds += 1
        for sampled in (False, True):
            score = float(np.mean(_score(team, spec, settings.eval_episodes, _CHECK_SEED, "validation", sampled)))
            if score > best[0]:
                states = {role: copy.deepcopy(one.network.state_dict()) for role, one in team.learners.items()}
                best = score, states, sampled
    for role, learner in team.learners.items():
        learner.network.load_state_dict(best[1][role])
        learner.network.eval()
    torch.manual_seed(seed)
    return _score(team, spec, episodes, seed, "test", best[2])


class _Learned:
    """Network of one role of a team as a policy."""

    def __init__(self, team: PPOTeam, role: str, sampled: bool) -> None:
        self._learner, self._sampled = team.learners[role], sampled and role not in team.fixed

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        allowed = None if mask is None else mask != 0
        actions, _ = self._learner.act(self._learner.seen(observation), allowed, greedy=not self._sampled)
        return actions if mask is not None else np.clip(actions, 0.0, 1.0).astype(np.float64)


def _score(team: PPOTeam, spec: Scenario, episodes: int, seed: int, split: str, sampled: bool) -> list[float]:
    """Return the scores of a team in episodes with seeds from ``seed`` on."""
    labs = Laboratories(spec, episodes, split=split)
    policies = {agent: _Learned(team, role_of(agent), sampled) for agent in labs.agents}
    scores: list[float] = play_laboratory(labs, policies, None, seed).returns.tolist()
    return scores


class _Recorded(Watching):
    """Plays as another policy does, and records observations, masks, actions and environment indices."""

    def __init__(self, policy: Policy) -> None:
        super().__init__(policy, self._note)
        self.turns: list[dict[str, npt.NDArray[Any] | None]] = []

    def _note(self, observation: ObservationArray, mask: Any, step: Any, members: IntArray, actions: Any) -> None:
        kind = np.float32 if mask is None else np.int64
        allowed = None if mask is None else mask != 0
        turn = {"observed": observation.copy(), "mask": allowed, "action": actions.astype(kind), "members": members}
        self.turns.append(turn)


def _clone(team: PPOTeam, spec: Scenario, begin: Mapping[Context, TeamPlan], least_std: float) -> None:
    """Fit the networks to the actions of open-loop policies in training worlds, and to the scores of the episodes."""
    from ..train.ppo import joined

    turns: dict[str, list[dict[str, npt.NDArray[Any] | None]]] = {}
    for context, plan in begin.items():
        trials = Trials(spec, context, range(SEARCH_SEED, SEARCH_SEED + _DONORS), 1)
        recorded = [
            _Recorded(policy) for policy in trials.team_policies([plan], make_policies("scripted", trials.labs))
        ]
        scores = trials.play(recorded, 1)[0].astype(np.float32)
        for agent, recorder in zip((MANAGER_AGENT, *trials.labs.bench_agents), recorded, strict=True):
            targets = [{**turn, "target": scores[turn["members"]]} for turn in recorder.turns]
            turns.setdefault(role_of(agent), []).extend(targets)
    for role, role_turns in turns.items():
        learner, batch = team.learners[role], joined(role_turns)
        observed = batch["observed"]
        assert observed is not None
        batch["observed"], batch["seen"] = learner.seen(observed), None
        learner.clone(batch, team.rng, least_std)
