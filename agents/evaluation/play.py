"""Evaluate policies: many experiments at once, per goal, every policy from the same seeds."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

import chemlab
from chemlab.arrays import FloatArray, IntArray
from chemlab.bench.base import Bench
from chemlab.laboratory.bench_env import BenchVectorEnv
from chemlab.laboratory.core import Laboratories
from chemlab.laboratory.policy import play_on
from chemlab.laboratory.state import COST_ITEMS
from chemlab.materials import DataError
from chemlab.scenario import Scenario, load_scenario

from ..policy import Policy, RandomPolicy, bench_heuristic, make_policies
from ..pretrained import pretrained_for
from ..saved import find_saved, is_saved
from . import statistics
from .statistics import Estimate

__all__ = [
    "BenchTarget",
    "LaboratoryTarget",
    "Played",
    "bench_policy",
    "evaluate",
    "find_target",
    "play_bench",
    "play_laboratory",
    "versions",
]

BATCH = 256
"""Most experiments played at once; results do not depend on it (but those of random policies)."""

_TRACE_MOL = 1e-6


@dataclass
class Played:
    """What a policy's episodes for one goal came to, n episodes.

    Attributes:
        returns: [n] return of the bench's agent, or the manager's score of a laboratory.
        lengths: [n] steps taken (a laboratory: ticks).
        cost: [n] weighted safety events.
        illegal: [n] masked actions played (lost turns).
        cases: [n] which starting state it was, where there are several, else ''.
        measures: further numbers of each episode, {name: [n]}.
        actions: the actions of each episode, where they were recorded: integers, or rows of numbers.
    """

    returns: FloatArray
    lengths: IntArray
    cost: FloatArray
    illegal: IntArray
    cases: list[str]
    measures: dict[str, FloatArray]
    actions: list[list[Any]] | None = None

    @classmethod
    def joined(cls, parts: Sequence[Played]) -> Played:
        """Several batches as one."""
        names = parts[0].measures
        recorded = [part.actions for part in parts if part.actions is not None]
        return cls(
            np.concatenate([part.returns for part in parts]),
            np.concatenate([part.lengths for part in parts]),
            np.concatenate([part.cost for part in parts]),
            np.concatenate([part.illegal for part in parts]),
            [case for part in parts for case in part.cases],
            {name: np.concatenate([part.measures[name] for part in parts]) for name in names},
            [actions for part in recorded for actions in part] if recorded else None,
        )


# -- what is evaluated ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BenchTarget:
    """A single bench of a scenario; ``env_id`` where it was asked for by one."""

    scenario: Scenario
    bench: str
    starts: str = "paper"
    env_id: str | None = None

    @property
    def goals(self) -> tuple[str, ...]:
        """Goals its experiments may be run for."""
        return tuple(self.scenario.goals)

    def as_dict(self) -> dict[str, Any]:
        """For results files."""
        return {
            "kind": "bench",
            "env_id": self.env_id,
            "scenario": self.scenario.name,
            "bench": self.bench,
            "starts": self.starts,
        }

    def environment(self, members: int) -> BenchVectorEnv:
        """A batch of it."""
        return BenchVectorEnv(
            members, scenario=self.scenario, bench=self.bench, starts=self.starts, autoreset_mode="SameStep"
        )

    def play(
        self, policy: str, goal: str, episodes: int, seed: int, watch: Callable[[int], None] | None = None
    ) -> Played:
        """Episodes of a policy given by name, see :func:`play_bench`."""
        parts = []
        for first in range(0, episodes, BATCH):
            env = self.environment(min(BATCH, episodes - first))
            parts.append(play_bench(env, bench_policy(policy, env.bench, seed + first), goal, seed + first))
            if watch is not None:
                watch(env.num_envs)
        return Played.joined(parts)


@dataclass(frozen=True)
class LaboratoryTarget:
    """A whole laboratory."""

    scenario: Scenario

    @property
    def goals(self) -> tuple[str, ...]:
        """Goals a laboratory may be asked for."""
        return tuple(self.scenario.lab_goals)

    def as_dict(self) -> dict[str, Any]:
        """For results files."""
        return {"kind": "laboratory", "env_id": None, "scenario": self.scenario.name, "bench": None, "starts": None}

    def play(
        self, policy: str, goal: str, episodes: int, seed: int, watch: Callable[[int], None] | None = None
    ) -> Played:
        """Episodes of a policy given by name, see :func:`play_laboratory`."""
        parts = []
        for first in range(0, episodes, BATCH):
            labs = Laboratories(self.scenario, min(BATCH, episodes - first))
            parts.append(play_laboratory(labs, make_policies(policy, labs, seed + first), goal, seed + first))
            if watch is not None:
                watch(len(labs.members))
        return Played.joined(parts)


Target = BenchTarget | LaboratoryTarget


def find_target(name: str, bench: str | None = None, starts: str = "paper") -> Target:
    """What ``chemlab evaluate`` was asked for.

    Args:
        name: id of a registered single-bench environment, or a scenario.
        bench: bench of the scenario; without one the whole laboratory.
        starts: starting states of a single bench, ``paper``, ``lab`` or ``both``.

    Raises:
        ValueError: ``name`` is an id that is not registered or not a bench's.
        DataError: unknown scenario or bench.
    """
    if name in gymnasium.registry:
        spec = gymnasium.spec(name)
        if not str(spec.vector_entry_point).endswith(":BenchVectorEnv"):
            raise ValueError(f"{name}: not a single bench of chemlab")
        arguments: dict[str, Any] = {"scenario": "wurtz_dodecane", "bench": "rxn", "starts": starts, **spec.kwargs}
        return BenchTarget(load_scenario(arguments["scenario"]), arguments["bench"], arguments["starts"], name)
    if name.startswith("chemlab/"):
        known = ", ".join(key for key in gymnasium.registry if key.startswith("chemlab/"))
        raise ValueError(f"{name}: no such environment; known: {known}")
    scenario = load_scenario(name)
    if bench is None:
        return LaboratoryTarget(scenario)
    if bench not in scenario.benches:
        raise DataError(f"bench: {scenario.name} has {', '.join(scenario.benches)}, given {bench!r}")
    return BenchTarget(scenario, bench, starts)


def bench_policy(name: str, bench: Bench, seed: int = 0) -> Policy:
    """A policy for a bench by name.

    Args:
        name: ``heuristic``, ``random``, ``pretrained``, the name of a policy that comes with chemlab
            (:func:`~chemlab.agents.pretrained.pretrained_names`), or a path: a training run's folder, a checkpoint in
            it (folder or ``model.zip``), or exported weights (``.safetensors``).
        bench: whose experiments it is to run.
        seed: seed of a random policy.

    Raises:
        ValueError: there is no such policy for this bench.
    """
    if name == "heuristic":
        return bench_heuristic(bench)
    if name == "random":
        shape = bench.action_space.shape or (0,)
        return RandomPolicy(int(shape[0]), seed)
    if name == "pretrained":
        return pretrained_for(bench)
    if not is_saved(name):
        raise ValueError(
            f"policy: known: heuristic, random, pretrained, a shipped one's name, or a path that exists; given {name!r}"
        )
    saved = find_saved(name).load
    # A run of one role may be tried on any bench that it fits; which of several it is has to be clear.
    role = next(iter(saved)) if len(saved) == 1 else bench.key
    if role not in saved:
        raise ValueError(f"policy: {name} is for {', '.join(saved)}; given bench {bench.key!r}")
    return saved[role](bench)


# -- playing --------------------------------------------------------------------------------------------------------


def _case(env: BenchVectorEnv, goal: str, member: int) -> str:
    """Whether the starting state's companion is there, where that is left to chance."""
    companion = env.bench.spec.start.companion
    if companion is None or companion.probability in (0.0, 1.0):
        return ""
    other = companion.if_goal if goal == companion.material else companion.material
    forms = {other}
    forms |= {
        ion for salt in env.arena.scenario.family.salt if salt.solid == other for ion in (salt.cation, salt.anion)
    }
    present = bool(forms & env.arena.shelf.vessel(member, 0).amounts(_TRACE_MOL).keys())
    return f"{'with' if present else 'without'} {other}"


def play_bench(
    env: BenchVectorEnv,
    policy: Policy,
    goal: str | Sequence[str],
    seed: int | Sequence[int],
    record: bool = False,
) -> Played:
    """One experiment in every member of a batch; a member plays what a single environment reset with its seed plays.

    Args:
        env: batch of N with ``autoreset_mode="SameStep"``.
        policy: plays all members.
        goal: what the experiments are for, or one for each member.
        seed: of member 0, the others have the next ones; or one for each member.
        record: whether to keep the actions.

    Returns:
        N episodes.
    """
    n, limit = env.num_envs, env.bench.spec.step_limit
    goals = np.array([goal] * n if isinstance(goal, str) else goal)
    seeds = [seed + i for i in range(n)] if isinstance(seed, int) else list(seed)
    for i, one in enumerate(dict.fromkeys(goals.tolist())):
        # The first reset has to be of all; each other goal's members are then begun again with the goal that is theirs.
        only = goals == one if i else np.ones(n, dtype=np.bool_)
        observations, _ = env.reset(seed=seeds, options={"goal": one, "reset_mask": only})
    cases = [_case(env, one, member) for member, one in enumerate(goals.tolist())]
    played = Played(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n, dtype=np.int64), cases, {}, None)
    running, step, members = np.ones(n, dtype=np.bool_), np.zeros(n, dtype=np.int64), np.arange(n)
    rows: list[npt.NDArray[Any]] = []
    for _ in range(limit):
        mask = env.action_masks().astype(np.int8) if env.bench.action_count else None
        actions = policy.act(observations, mask, step, members)
        if record:
            rows.append(np.array(actions))
        observations, rewards, terminated, truncated, infos = env.step(actions)
        played.returns += running * rewards
        played.cost += running * infos["cost"]
        played.illegal += running * infos["illegal_action"]
        played.lengths += running
        ended = terminated | truncated
        # A member that has ended goes on with an experiment that does not count: its policy begins anew there.
        step = np.where(ended, 0, step + 1)
        running &= ~ended
        if not running.any():
            break
    if record:
        played.actions = [[row[i].tolist() for row in rows[: int(length)]] for i, length in enumerate(played.lengths)]
    return played


def play_laboratory(labs: Laboratories, policies: Mapping[str, Policy], goal: str | None, seed: int) -> Played:
    """One episode in each of N laboratories; laboratory i plays what ``play_episode`` plays with seed + i.

    Args:
        labs: N laboratories.
        policies: one for every agent, by its id.
        goal: the laboratory's goal; None: drawn, as in any episode.
        seed: of laboratory 0.

    Returns:
        N episodes: the manager's scores; measures ``submitted_mol``, ``purity`` (0 where nothing was submitted),
        ``instruments`` (what measuring has cost, in units of the score), ``manager_actions``, and the reward of every
        bench's agent.
    """
    n = len(labs.members)
    for member in labs.members:
        labs.seed(int(member), np.random.SeedSequence(seed + int(member)))
    labs.reset(labs.members, goal)
    cost, illegal, rewards = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros((n, len(labs.agents)))

    def count(number: int, members: IntArray) -> None:
        rewards[members] += labs.rewards[members]
        cost[members] += labs.cost[members].sum(axis=1)
        illegal[members] += labs.illegal(number)[members]

    play_on(labs, [policies[agent] for agent in labs.agents], labs.members, count)
    scores = labs.result(labs.members)
    submitted = labs.desk.submitted
    measures = {
        "submitted_mol": submitted[:, :, 0].sum(axis=1),
        "purity": submitted[:, :, 1].mean(axis=1),
        "instruments": labs.desk.charges[:, COST_ITEMS.index("instruments")].copy(),
        "manager_actions": labs.desk.actions.astype(np.float64),
    }
    measures |= {f"reward {agent}": rewards[:, i] for i, agent in enumerate(labs.agents) if i}
    return Played(scores, labs.desk.ticks.copy(), cost, illegal, [""] * n, measures)


# -- evaluating -----------------------------------------------------------------------------------------------------


def versions() -> dict[str, str]:
    """What results may depend on."""
    return {"chemlab": chemlab.__version__, "numpy": np.__version__, "python": platform.python_version()}


def evaluate(
    target: Target,
    policies: Sequence[str],
    episodes: int = 100,
    seed: int = 0,
    goals: Sequence[str] | None = None,
    baseline: str = "heuristic",
    watch: Callable[[int], None] | None = None,
) -> dict[str, Any]:
    """Play every policy from the same seeds and compare it with a baseline.

    Args:
        target: a bench or a laboratory.
        policies: names or paths, see :func:`bench_policy`; the baseline is played whether or not it is among them.
        episodes: for each goal; episode i has seed + i, whatever the policy and the goal.
        seed: of the first episode.
        goals: default: all of the target's.
        baseline: what improvement is measured over.
        watch: called with the number of episodes just played.

    Returns:
        Plain data, as ``chemlab evaluate --out`` writes it: what was played, and for each policy the mean,
        interquartile mean, mean paired difference to the baseline and paired probability of improvement over it (each
        ``value``, ``low``, ``high``), the same by goal, and every episode's return.

    Raises:
        ValueError: unknown policy or goal, or fewer than one episode.
    """
    chosen = tuple(goals or target.goals)
    unknown = [goal for goal in chosen if goal not in target.goals]
    if unknown or len(set(chosen)) < len(chosen):
        raise ValueError(f"goals: known: {', '.join(target.goals)}, each once; given {', '.join(chosen)}")
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, given {episodes}")
    found: dict[str, dict[str, Played]] = {
        name: {goal: target.play(name, goal, episodes, seed, watch) for goal in chosen}
        for name in dict.fromkeys((baseline, *policies))
    }
    return {
        "kind": "evaluation",
        "format": 1,
        "target": target.as_dict(),
        "goals": list(chosen),
        "episodes_per_goal": episodes,
        "seed": seed,
        "baseline": baseline,
        "confidence": statistics.CONFIDENCE,
        "resamples": statistics.RESAMPLES,
        "versions": versions(),
        "policies": [_report(name, played, found[baseline]) for name, played in found.items()],
    }


def _report(name: str, played: dict[str, Played], baseline: dict[str, Played]) -> dict[str, Any]:
    """One policy's part of the results."""
    episodes = list(played.values())
    cases = sorted({case for goal in episodes for case in goal.cases} - {""})
    everything = Played.joined(episodes)
    return {
        "policy": name,
        **_statistics(list(played), played, baseline),
        "by_goal": {
            goal: {**_statistics([goal], played, baseline), "mean_length": float(episodes.lengths.mean())}
            for goal, episodes in played.items()
        },
        "by_case": {
            case: statistics.mean(
                [some for goal in episodes if len(some := goal.returns[np.array(goal.cases) == case])]
            ).as_dict()
            for case in cases
        },
        "mean_length": float(everything.lengths.mean()),
        "mean_cost": float(everything.cost.mean()),
        "illegal_actions_per_episode": float(everything.illegal.mean()),
        "measures": {key: float(values.mean()) for key, values in everything.measures.items()},
        # 6 decimals: far finer than anything a score depends on, and half the file.
        "returns": {goal: np.round(episodes.returns, 6).tolist() for goal, episodes in played.items()},
        "cases": {goal: episodes.cases for goal, episodes in played.items()} if cases else {},
    }


def _statistics(
    goals: Sequence[str], played: dict[str, Played], baseline: dict[str, Played]
) -> dict[str, dict[str, float]]:
    ours = [played[goal].returns for goal in goals]
    theirs = [baseline[goal].returns for goal in goals]
    estimates: dict[str, Estimate] = {
        "mean": statistics.mean(ours),
        "interquartile_mean": statistics.interquartile_mean(ours),
        "difference": statistics.mean([x - y for x, y in zip(ours, theirs, strict=True)]),
        "improvement": statistics.paired_improvement(ours, theirs),
    }
    return {key: estimate.as_dict() for key, estimate in estimates.items()}
