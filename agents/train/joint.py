"""Joint training of several roles of a laboratory with :class:`~chemlab.agents.train.ppo.PPOTeam`.

There are two regimes: ``together`` (all roles learn from every rollout) and ``in-turns`` (one role at a time learns,
round-robin). Benches may first learn on their own (``practice``); then the manager learns with these benches.

Needs PyTorch: ``pip install ".[train]"``.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from chemlab.config.loading import load_scenario
from chemlab.envs.players import Policy
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import goals_met

from ..episodes import play_laboratory
from ..policies import agent_policy, as_trained
from ..pretrained import Card, PretrainedPolicy, load_pretrained, save_policy
from ..roles import MANAGER_ROLE, chosen_roles, role_of
from ..runs import Evaluation, Run
from ..saved import find_saved
from .arguments import FOR_BENCHES, FOR_MANAGER, IPPO
from .checkpoints import load_state, random_state, restore_random_state, save_state
from .loop import Progress, Trainee, evaluation_fields
from .networks import card_of
from .ppo import PPOTeam, wide_columns
from .tasks import task_fingerprint


class Team(Trainee):
    """Roles that learn in a batch of laboratories; background policies play the other roles.

    Raises:
        DataError: the scenario is unknown.
        ValueError: a role or reward mix is unknown, or a background policy does not fit.
    """

    arguments: IPPO
    team: PPOTeam

    def __init__(self, arguments: IPPO) -> None:
        a = self.arguments = arguments
        self.steps, self._background = a.steps, a.background or "scripted"
        self.scenario = load_scenario(a.scenario, rewards=a.rewards)
        # Policies state the task, which does not depend on the reward mix.
        roles = reversed(Laboratories(load_scenario(a.scenario), 1).roles)
        self._workplaces = {role_of(role.name): role.workplace for role in roles}
        self._labs = labs = Laboratories(self.scenario, 1)
        self.has_policy = a.bc is not None or a.begin_from is not None
        self.learning = chosen_roles(labs, None if a.roles in (None, ("all",)) else a.roles)
        # An exported manager is scored over the background's benches, even if others learned with it.
        own = {MANAGER_ROLE} if MANAGER_ROLE in self.learning else self.learning
        for index, agent in enumerate(labs.agents):
            if role_of(agent) not in own:
                agent_policy(self._background, labs, index)
        config = self.described(a.scenario, ",".join(self.learning), list(self.scenario.lab_goals), task_fingerprint(a))
        self.config = config.model_copy(update={"background": self._background})
        self._taken: dict[str, PretrainedPolicy] | None = None

    def check(self) -> None:
        a, roles = self.arguments, ", ".join(self.learning)
        for index, agent in enumerate(self._labs.agents):
            if a.bc is not None and role_of(agent) in self.learning:
                agent_policy(a.bc, self._labs, index)
        manager, alone = MANAGER_ROLE in self.learning, len(self.learning) == 1
        idle = () if manager else FOR_MANAGER
        idle += (*(FOR_BENCHES if manager else ()), "regime") if alone else ()
        for name in idle:
            if name in a.unusual():
                raise ValueError(f"{name}: has no effect, because only {roles} learns; leave it out")
        if a.regime == "in-turns" and manager and a.practice and not alone:
            raise ValueError("practice: benches that practise do not learn in-turns with the manager; leave it out")
        self.make()

    def begin(self, run: Run) -> Progress:
        a, last = self.arguments, run.checkpoint("last")
        if last is not None:
            state = load_state(last)
            self.team = state["team"]
            restore_random_state(state)
            return Progress.of(state["progress"], last)
        self.make()
        progress, begun = Progress(), time.perf_counter()
        if a.bc is not None:
            self.team.clone(a.bc, a.bc_steps, a.bc_rounds, a.bc_std)
        progress.seconds = time.perf_counter() - begun
        return progress

    def make(self) -> None:
        """Make a new team, with the policies of ``begin_from``; ``bc`` is not cloned yet."""
        a = self.arguments
        initial = {} if a.begin_from is None else self._initial_policies(a.begin_from)
        self.team = PPOTeam(self.scenario, self.learning, a, self._background, self._observes_wide(initial))
        for role, policy in initial.items():
            try:
                self.team.learners[role].take(policy)
            except ValueError as error:
                raise ValueError(f"begin_from: {a.begin_from}: {role}: {error}") from error

    def _observes_wide(self, initial: Mapping[str, PretrainedPolicy]) -> bool:
        """Return True if the manager observes readings of many numbers, because a cloned or initial policy may."""
        policy = initial.get(MANAGER_ROLE)
        if policy is None or policy.card.memory:
            return self.arguments.bc is not None
        return bool(policy.weights["0.weight"][:, wide_columns(self.scenario)].any())

    def _initial_policies(self, text: str) -> dict[str, PretrainedPolicy]:
        """Return the policies of ``begin_from`` by role.

        Args:
            text: a policy of several roles, a folder with a policy for each role, or ``ROLE=POLICY,...``.

        Raises:
            ValueError: no policy exists, or one does not fit its role.
        """
        pairs = [part.partition("=") for part in text.split(",")]
        named = {role: policy for role, equals, policy in pairs if equals}
        if named and len(named) < len(pairs):
            raise ValueError(f"begin_from: must be one policy or folder, or ROLE=POLICY,... by role; given {text!r}")
        unknown = [role for role in named if role not in self.learning]
        if unknown:
            raise ValueError(f"begin_from: no {', '.join(unknown)} learns; roles: {', '.join(self.learning)}")
        if not named:
            single = {role: str(Path(text) / role) for role in self.learning if Path(text, role).exists()}
            named = single or dict.fromkeys(self.learning, text)
        initial = {}
        for role, name in named.items():
            try:
                load = find_saved(name).load
                policy = load[role](self._workplaces[role]) if role in load else None
            except ValueError as error:
                raise ValueError(f"begin_from: {role}: {error}") from error
            if isinstance(policy, PretrainedPolicy):
                initial[role] = policy
            elif name != text:
                raise ValueError(f"begin_from: {name}: holds no policy of {role} with its actions")
        if not initial:
            raise ValueError(f"begin_from: {text}: holds no policies of {', '.join(self.learning)}")
        return initial

    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        team = self.team
        turns = team.learn(progress.step / self.steps, progress.rounds)
        means = {role: float(np.mean(one.scores)) for role, one in team.practices.items() if one.scores}
        for role, mean in means.items():
            self.logger.record(f"practice/{role}", mean)
            team.practices[role].scores = []
        practised = ", ".join(f"{role} {mean:.3f}" for role, mean in means.items())
        self.note = f"practice: {practised}" if means else ""
        scores, team.scores = team.scores, []
        for role, count in team.turns.items():
            self.logger.record(f"turns/{role}", count)
        return turns, scores

    def scores(self, episodes: int, seed: int, sampled: bool) -> dict[str, float]:
        """See :class:`~chemlab.agents.train.loop.Trainee`; returns are raw scores of the laboratory.

        Benches that finished their practice are greedy, as in the manager's training.
        """
        learned = self._taken or {role: self._policy(role, 0, None, sampled) for role in self.learning}
        return self._evaluate(learned, self._background, episodes, seed)

    def scripted(self, episodes: int, seed: int) -> dict[str, float]:
        """See :class:`~chemlab.agents.train.loop.Trainee`; scripted policies play the learning roles."""
        background = ",".join([self._background, *(f"{role}=scripted" for role in self.learning)])
        return self._evaluate({}, background, episodes, seed)

    def _evaluate(
        self, learned: Mapping[str, PretrainedPolicy], background: str, episodes: int, seed: int
    ) -> dict[str, float]:
        """Return the mean raw score by goal of learned policies by role; background policies play the other roles.

        There is a warning if a checkpoint's policies mostly submit nothing.
        """
        labs = Laboratories(self.scenario, episodes, split=self.arguments.evaluation_split)
        means, nothing = {}, []
        for goal in self.scenario.lab_goals:
            policies: dict[str, Policy] = {}
            for index, agent in enumerate(labs.agents):
                policy = learned.get(role_of(agent))
                if policy is None:
                    policies[agent] = agent_policy(background, labs, index)
                else:
                    policies[agent] = as_trained(policy.as_played(None), labs, index)
            played = play_laboratory(labs, policies, goal, seed)
            means[goal] = float(played.returns.mean())
            nothing.append(played.measures["nothing"].mean())
        share = np.mean(nothing)
        if learned is self._taken and share > 0.5:
            text = f"the best checkpoint submits nothing in {share:.0%} of the episodes; give more --steps"
            warnings.warn(f"{text}, or longer help against sparse reward (docs/training.md)", stacklevel=2)
        return means

    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        save_state(folder, {"team": self.team, **random_state(), "progress": vars(progress)})
        for role in self.learning:
            policy = self._policy(role, progress.step, evaluation, progress.sampled)
            save_policy(folder / role, policy.card, policy.weights)

    def take(self, folder: Path) -> None:
        self._taken = {role: load_pretrained(folder / role) for role in self.learning}

    def _policy(self, role: str, step: int, evaluation: Evaluation | None, sampled: bool) -> PretrainedPolicy:
        """Return a role's policy with its card, for the scenario's complete observation, to be sampled or greedy."""
        workplace, manager = self._workplaces[role], role == MANAGER_ROLE
        card = Card.of(
            workplace,
            **card_of(self.config, workplace),
            goals=list(self.scenario.lab_goals) if manager else goals_met(self.scenario, role),
            starts="lab",
            step=step,
            command=self.arguments.command_line(),
            activation="tanh",
            output="argmax" if self.team.learners[role].network.discrete else "clip",
            evaluation=evaluation_fields(self.arguments, evaluation),
            background=self._background,
            sampled=sampled and role not in self.team.fixed,
            notes=manager and self.team.notes is not None,
        )
        return PretrainedPolicy(card, self.team.weights(role))
