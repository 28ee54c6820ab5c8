"""Training tasks: a bench on its own, or one role of a laboratory in which policies play the others."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache, partial
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Policy
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import starts_file
from chemlab.roles.base import Workplace
from chemlab.roles.bench import Bench

from ..advice import AdvisedPolicy, Advisor
from ..background import background_policies, role_vector_env
from ..episodes import play_bench, play_laboratory
from ..policies import agent_policy, as_trained, bench_policy, is_scripted
from ..pretrained import Card, fingerprint
from ..roles import MANAGER_ROLE, role_of
from .arguments import PPO, Arguments, Single


class Task(ABC):
    """Base class of training tasks."""

    scenario: Scenario
    agent: str
    """Learning agent: the key of a single bench, or the name of an agent of a laboratory."""
    goals: tuple[str, ...]
    workplace: Workplace
    background: str | None = None
    """Policies of the other agents of a laboratory."""

    @property
    def fingerprint(self) -> str:
        """Hash of the task; equal tasks have equal hashes."""
        return fingerprint(self.workplace)

    @abstractmethod
    def batch(self, members: int) -> RoleVectorEnv:
        """Return a batch of ``members`` environments for training, with autoreset mode ``SameStep``."""

    def prepare(self, batch: Any, shares: Mapping[str, float] | None) -> None:
        """Set the initial-state distribution of a :meth:`batch` (see :meth:`~chemlab.lab.engine.Laboratories.prepare`).

        Raises:
            ValueError: the task is a single bench, or a bench or share is invalid.
            DataError: no such vessels have been recorded for the scenario.
        """
        if shares is not None:
            raise ValueError("curriculum: is for a laboratory; a bench on its own has goals and starts")

    @abstractmethod
    def returns(self, policy: Policy, episodes: int, seed: int) -> FloatArray:
        """Return [G, episodes] a policy's returns for each goal, with the seeds ``seed``, ``seed + 1``, ..."""

    @abstractmethod
    def policy(self, name: str, seed: int = 0) -> Policy:
        """Return a policy for this task by name; ``seed`` is that of its random numbers until an episode sets another.

        Raises:
            ValueError: the name is unknown, or the policy does not fit.
        """

    def advisor(self, name: str, seed: int = 0) -> Advisor:
        """Return an advisor for the manager; arguments as for :meth:`policy`.

        Raises:
            ValueError: the policy is unknown, or the learning agent is not a laboratory's manager.
        """
        if self.workplace.key != MANAGER_ROLE:
            raise ValueError(f"hints: are for a laboratory's manager; {self.agent} learns here")
        return Advisor(self.policy(name, seed), self.workplace.action_count)

    def advised(self, policy: Policy, advice: str | None) -> Policy:
        """Return a policy with an advisor by name, or without one (None); errors as for :meth:`advisor`."""
        return policy if advice is None else AdvisedPolicy(policy, self.advisor(advice))

    def trained(self, policy: Policy) -> Policy:
        """Return a trained policy with the notes or the advisor of its training, if it had any."""
        return policy

    def warning(self) -> str | None:
        """Return a warning for the user before training, or None."""
        return None

    def scripted(self, episodes: int, seed: int) -> dict[str, float] | None:
        """Return the scripted policy's mean return by goal; None if the bench has no scripted policy."""
        if isinstance(self.workplace, Bench) and not is_scripted(self.workplace):
            return None
        return self.by_goal(self.policy("scripted"), episodes, seed)

    def by_goal(self, policy: Policy, episodes: int, seed: int) -> dict[str, float]:
        """Return a policy's mean return by goal."""
        means = self.returns(policy, episodes, seed).mean(axis=1)
        return {goal: float(mean) for goal, mean in zip(self.goals, means, strict=True)}


class BenchTask(Task):
    """A bench of a scenario on its own.

    Args:
        scenario, bench, goals, starts: as for :class:`~chemlab.envs.role_env.RoleEnv`.
        splits: splits of worlds for training and for evaluation.

    Raises:
        DataError: the scenario, bench, goal or initial-state distribution is unknown.
    """

    def __init__(
        self,
        scenario: Any,
        bench: str,
        goals: tuple[str, ...] | None = None,
        starts: str = "paper",
        splits: tuple[str, str] = ("train", "validation"),
    ) -> None:
        self._make = partial(
            RoleVectorEnv,
            scenario=load_scenario(scenario),
            bench=bench,
            goals=goals,
            starts=starts,
            autoreset_mode=AutoresetMode.SAME_STEP,
        )
        self._starts, self._splits = starts, splits
        self._batches: dict[int, RoleVectorEnv] = {}
        self.workplace: Bench = self.batch(1).bench
        self.scenario, self.agent = self.workplace.scenario, bench
        self.goals = self.scenario.goals if goals is None else tuple(goals)

    def batch(self, members: int) -> RoleVectorEnv:
        return self._make(members, split=self._splits[0])

    def returns(self, policy: Policy, episodes: int, seed: int) -> FloatArray:
        count = len(self.goals)
        if episodes not in self._batches:
            self._batches[episodes] = self._make(episodes * count, split=self._splits[1])
        # All goals are played in one batch, with the same seeds.
        goals, seeds = np.repeat(self.goals, episodes).tolist(), list(range(seed, seed + episodes)) * count
        played = play_bench(self._batches[episodes], policy, goals, seeds)
        return played.returns.reshape(count, episodes)

    def policy(self, name: str, seed: int = 0) -> Policy:
        return bench_policy(name, self.workplace, seed)

    def warning(self) -> str | None:
        """See :class:`Task`; there is a warning if the scenario declares no initial state of the single bench."""
        start = self.workplace.spec.start
        if self._starts == "lab" or start.contents or start.goal_mol or start.companion:
            return None
        advice = "; or train with --starts lab"
        if not starts_file(self.scenario).is_file():
            advice = (
                f"; or record vessels with chemlab export starts {self.scenario.argument}, and train with --starts lab"
            )
        return (
            f"bench {self.agent!r} of {self.scenario.name}: its experiments begin with an empty vessel, because the "
            f"scenario has no [benches.{self.agent}.start]; give it contents (moles by material)"
            f"{advice if is_scripted(self.workplace) else ''}"
        )


class LaboratoryTask(Task):
    """One agent of a laboratory; the manager's return is the raw score, another agent's return its own.

    Args:
        scenario: a bundled name, a path, or a loaded scenario.
        agent: name of the learning agent.
        background: policies of the other agents, by name.
        goals: laboratory goals of the episodes; None: all.
        splits: splits of worlds for training and for evaluation.

    Raises:
        DataError: the scenario is unknown.
        ValueError: the agent, a policy or a goal is unknown.
    """

    def __init__(
        self,
        scenario: Any,
        agent: str = MANAGER_AGENT,
        background: str = "scripted",
        goals: tuple[str, ...] | None = None,
        splits: tuple[str, str] = ("train", "validation"),
    ) -> None:
        self._splits = splits
        self.scenario, self.agent = load_scenario(scenario), agent
        self.background = self._background = background
        known = self.scenario.lab_goals
        self.goals = known if goals is None else tuple(goals)
        if set(self.goals) - set(known) or not self.goals:
            raise ValueError(f"goals: {self.scenario.name} asks for {', '.join(known)}, given {', '.join(self.goals)}")
        self._index = self.batch(1).focal
        self.workplace = Laboratories(self.scenario, 1).roles[self._index].workplace
        self._labs: dict[int, Laboratories] = {}

    def batch(self, members: int) -> RoleVectorEnv:
        return role_vector_env(
            members,
            self.scenario.model_copy(update={"lab_goals": self.goals}),
            self.agent,
            self._background,
            autoreset_mode=AutoresetMode.SAME_STEP,
            split=self._splits[0],
        )

    def prepare(self, batch: RoleVectorEnv, shares: Mapping[str, float] | None) -> None:
        batch.laboratories.prepare(shares)

    def returns(self, policy: Policy, episodes: int, seed: int) -> FloatArray:
        labs = self._labs.setdefault(episodes, Laboratories(self.scenario, episodes, split=self._splits[1]))
        policies = {**background_policies(self._background)(labs), self.agent: policy}
        played = [play_laboratory(labs, policies, goal, seed) for goal in self.goals]
        if self.agent == MANAGER_AGENT:
            return np.array([one.returns for one in played])
        return np.array([one.measures[f"reward {self.agent}"] for one in played])

    def policy(self, name: str, seed: int = 0) -> Policy:
        return agent_policy(name, Laboratories(self.scenario), self._index, seed)

    def trained(self, policy: Policy) -> Policy:
        return as_trained(policy, Laboratories(self.scenario), self._index)


def task_of(card: Card, scenario: Scenario, splits: tuple[str, str] = ("train", "validation")) -> Task:
    """Return the task of a policy's evaluation: a laboratory, or a single bench if its card states initial states.

    Args:
        card: card of the policy.
        scenario: scenario of its training.
        splits: splits of worlds for training and for evaluation.

    Raises:
        DataError: the scenario, bench, goal or initial-state distribution is unknown.
        ValueError: a background policy is unknown.
    """
    goals = tuple(card.goals)
    if card.bench != MANAGER_ROLE and (card.background is None or card.starts != "paper"):
        return BenchTask(scenario, card.bench, goals, card.starts, splits)
    agent = MANAGER_AGENT if card.bench == MANAGER_ROLE else f"{card.bench}_0"
    return LaboratoryTask(scenario, agent, card.background or "scripted", goals, splits)


def task_fingerprint(arguments: Arguments) -> str:
    """Return the fingerprint of the arguments' task; errors as for :func:`find_task`."""
    # Cached, because a sweep may have hundreds of runs of a few tasks.
    names = ("scenario", "bench", "roles", "actions", "rewards")
    return _fingerprint(*(getattr(arguments, name, None) for name in names), isinstance(arguments, Single))


@cache
def _fingerprint(scenario: str, bench: str | None, roles: Any, actions: Any, rewards: str | None, one: bool) -> str:
    if one:
        return find_task(PPO(scenario=scenario, bench=bench, roles=roles, actions=actions)).fingerprint
    return fingerprint(Laboratories(load_scenario(scenario, rewards=rewards), 1).manager.workplace)


def find_task(arguments: Single) -> Task:
    """Return the task of a run's arguments.

    Raises:
        DataError: the scenario, bench, goal or initial-state distribution is unknown.
        ValueError: an argument does not apply to this kind of task, or the agent is unknown or one of several.
    """
    a, splits = arguments, (arguments.split, arguments.evaluation_split)
    scenario = load_scenario(a.scenario, actions=a.actions)
    if a.bench is not None:
        if a.background is not None:
            raise ValueError(f"background: {a.bench} is a single bench without other roles, given {a.background!r}")
        return BenchTask(scenario, a.bench, a.goals, a.starts, splits)
    if a.starts != "paper":
        raise ValueError(f"starts: only for single benches, not for a laboratory; given {a.starts!r}")
    agents = Laboratories(scenario, 1).agents
    if a.agent not in agents:
        known = dict.fromkeys([*map(role_of, agents), *agents])
        raise ValueError(f"roles: {scenario.name} has {', '.join(known)}, or all; given {', '.join(a.roles or ())}")
    alike = [agent for agent in agents if role_of(agent) == role_of(a.agent)]
    if len(alike) > 1 and a.roles not in [(agent,) for agent in alike]:
        raise ValueError(
            f"roles: {a.algo} trains one agent, and {scenario.name} has {', '.join(alike)}; give one of them, or algo "
            "ippo for a policy that they share"
        )
    return LaboratoryTask(scenario, a.agent, a.background or "scripted", a.goals, splits)
