"""Evaluate policies: every policy plays episodes with the same seeds, for each goal."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.lab.engine import Laboratories

from ..episodes import Played, play_bench, play_laboratory
from ..executors import Inline, completed
from ..former_names import GREEDY, SAMPLED, current_name, split_way
from ..policies import bench_policy, make_policies
from ..runs import versions
from ..saved import is_saved
from . import statistics
from .statistics import Estimate

BATCH = 256
"""Maximum number of concurrent episodes; results do not depend on it."""
_MOST = 0.5
_OBSTACLES = {"limit": "ran out of actions or ticks", "nothing": "submitted nothing"}
"""Descriptions of measures of a laboratory; a note reports a measure above ``_MOST``."""
DRAWN = "drawn"
"""Name used instead of a goal if each episode draws the goals of its orders."""


@dataclass(frozen=True)
class Target:
    """A bench or a laboratory in which policies are evaluated.

    Attributes:
        scenario: the scenario.
        bench: key of the bench; None: the laboratory.
        starts: initial states of a bench.
        env_id: id of the registered environment, if given by one.
        split: split of the worlds, if the scenario has hidden parameters.
    """

    scenario: Scenario
    bench: str | None = None
    starts: str = "paper"
    env_id: str | None = None
    split: str = "train"

    @property
    def goals(self) -> tuple[str, ...]:
        """Available goals."""
        return tuple(self.scenario.goals if self.bench else self.scenario.lab_goals)

    @property
    def default_goals(self) -> tuple[str, ...]:
        """All goals of a bench; :data:`DRAWN` for a laboratory."""
        return self.goals if self.bench else (DRAWN,)

    def as_dict(self) -> dict[str, Any]:
        """Return the description in result files."""
        return {
            "kind": "bench" if self.bench else "laboratory",
            "env_id": self.env_id,
            "scenario": self.scenario.name,
            "bench": self.bench,
            "starts": self.starts if self.bench else None,
            "split": self.split,
        }

    def environment(self, members: int) -> RoleVectorEnv:
        """Return a batch of environments of the bench."""
        assert self.bench is not None, "laboratories have no single-bench environment"
        return RoleVectorEnv(
            members,
            scenario=self.scenario,
            bench=self.bench,
            starts=self.starts,
            autoreset_mode="SameStep",
            split=self.split,
        )

    def check(self, policy: str) -> None:
        """Check that a policy fits.

        Raises:
            ValueError: it does not.
        """
        if self.bench:
            bench_policy(policy, self.environment(1).bench)
        else:
            make_policies(policy, Laboratories(self.scenario, 1, split=self.split))

    def play(self, policy: str, goal: str, episodes: int, seed: int) -> Played:
        """Play episodes of a policy given by name; episode i has seed + i."""
        batches = [(policy, goal, first) for first in range(0, episodes, BATCH)]
        return Played.joined([self.play_batch(batch, episodes, seed) for batch in batches])

    def play_batch(self, batch: tuple[str, str, int], episodes: int, seed: int) -> Played:
        """Play a batch of :meth:`play`'s episodes: (policy, goal, number of the first episode)."""
        policy, goal, first = batch
        count, seed = min(BATCH, episodes - first), seed + first
        if self.bench:
            env = self.environment(count)
            return play_bench(env, bench_policy(policy, env.bench), goal, seed)
        labs = Laboratories(self.scenario, count, split=self.split)
        return play_laboratory(labs, make_policies(policy, labs), None if goal == DRAWN else goal, seed)


def find_target(name: str, bench: str | None = None, starts: str = "paper", split: str = "train") -> Target:
    """Return the target of an evaluation.

    Args:
        name: id of a registered single-bench environment, or a scenario.
        bench: bench of the scenario; None: the laboratory.
        starts: initial states of a single bench: ``paper``, ``lab`` or ``both``.
        split: split of the worlds, if the scenario has hidden parameters.

    Raises:
        ValueError: ``name`` is an id that is not registered or not a bench's, or an argument does not apply to it.
        DataError: the scenario or the bench is unknown.
    """
    if name in gymnasium.registry:
        spec = gymnasium.spec(name)
        if not str(spec.vector_entry_point).endswith(":RoleVectorEnv"):
            raise ValueError(
                f"{name}: not a single bench of chemlab; give a scenario, such as wurtz_dodecane, for its laboratory"
            )
        if bench is not None:
            raise ValueError(f"bench: {name} is a bench already; leave it out, or give a scenario")
        arguments: dict[str, Any] = {"scenario": "wurtz_dodecane", "bench": "rxn", "starts": starts, **spec.kwargs}
        return Target(load_scenario(arguments["scenario"]), arguments["bench"], arguments["starts"], name, split)
    if name.startswith("chemlab/"):
        known = ", ".join(key for key in gymnasium.registry if key.startswith("chemlab/"))
        raise ValueError(f"{name}: no such environment; known: {known}")
    scenario = load_scenario(name)
    if bench is not None and bench not in scenario.benches:
        raise DataError(f"bench: {scenario.name} has {', '.join(scenario.benches)}, given {bench!r}")
    if bench is None and starts != "paper":
        raise ValueError(f"starts: only for single benches, not for a laboratory; given {starts!r}")
    return Target(scenario, bench, starts, split=split)


def evaluate(
    target: Target,
    policies: Sequence[str],
    episodes: int = 100,
    seed: int = 0,
    goals: Sequence[str] | None = None,
    baseline: str = "scripted",
    watch: Callable[[int], None] | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Play every policy from the same seeds and compare it with a baseline.

    Args:
        target: a bench or a laboratory.
        policies: names or paths, see :func:`~chemlab.agents.policies.bench_policy`; the baseline is added.
        episodes: number of episodes for each goal; episode i has seed + i for every policy and goal.
        seed: seed of the first episode.
        goals: default: all goals of a bench; in a laboratory each episode draws its goals (:data:`DRAWN`).
        baseline: policy that the others are compared with.
        watch: called with the number of episodes just played.
        executor: executor of the batches, see :mod:`chemlab.agents.executors`; None: this process.

    Returns:
        Plain data, as ``chemlab evaluate --out`` writes it: the settings, and for each policy the mean, interquartile
        mean, mean paired difference to the baseline and paired probability of improvement over it (each ``value``,
        ``low``, ``high``), the same by goal, and every episode's return.

    Raises:
        ValueError: a policy or goal is unknown, or there is no episode.
    """
    chosen = tuple(goals or target.default_goals)
    known = dict.fromkeys((*target.goals, *target.default_goals))
    if not set(chosen) <= set(known) or len(set(chosen)) < len(chosen):
        raise ValueError(f"goals: known: {', '.join(known)}, each once; given {', '.join(chosen)}")
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, given {episodes}")
    baseline = current_name(baseline)
    names = list(dict.fromkeys((baseline, *map(current_name, policies))))
    for name in names:
        target.check(name)
    firsts = range(0, episodes, BATCH)
    batches = [(name, goal, first) for name in names for goal in chosen for first in firsts]
    parts: dict[tuple[str, str, int], Played] = {}
    play = functools.partial(target.play_batch, episodes=episodes, seed=seed)
    for batch, part in completed(executor or Inline(), play, batches):
        parts[batch] = part
        if watch is not None:
            watch(len(part.returns))
    played = {
        name: {goal: Played.joined([parts[name, goal, first] for first in firsts]) for goal in chosen} for name in names
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
        "versions": versions(),
        "policies": [_report(name, by_goal, played[baseline]) for name, by_goal in played.items()],
    }


def _report(name: str, played: dict[str, Played], baseline: dict[str, Played]) -> dict[str, Any]:
    """Return the results of one policy; episodes are by goal."""
    everything = Played.joined(list(played.values()))
    cases = sorted(set(everything.cases) - {""})
    return {
        "policy": name,
        **_statistics(list(played), played, baseline),
        "by_goal": {
            goal: {**_statistics([goal], played, baseline), "mean_length": float(episodes.lengths.mean())}
            for goal, episodes in played.items()
        },
        "by_case": {case: _case_mean(case, list(played.values())).as_dict() for case in cases},
        "mean_length": float(everything.lengths.mean()),
        "mean_cost": float(everything.cost.mean()),
        "illegal_actions_per_episode": float(everything.illegal.mean()),
        "measures": {key: float(values.mean()) for key, values in everything.measures.items()},
        # Six decimals are much finer than differences of scores, and halve the size of the file.
        "returns": {goal: np.round(episodes.returns, 6).tolist() for goal, episodes in played.items()},
        "cases": {goal: episodes.cases for goal, episodes in played.items()} if cases else {},
    }


def notes(results: dict[str, Any]) -> list[str]:
    """Return notes on policies that submitted nothing or reached a limit in most episodes, unless the baseline did.

    Args:
        results: results of :func:`evaluate`.
    """
    rows = {row["policy"]: row["measures"] for row in results["policies"]}
    reference, found = rows[results["baseline"]], []
    for name, measures in rows.items():
        for measure, words in _OBSTACLES.items():
            share = measures.get(measure, 0.0)
            if share > _MOST and reference.get(measure, 0.0) <= _MOST:
                base = split_way(name)[0]
                advice = f"; compare {base}:{GREEDY} and {base}:{SAMPLED}" if is_saved(name) else ""
                found.append(f"{name} {words} in {share:.0%} of the episodes{advice}")
    return found


def _case_mean(case: str, goals: Sequence[Played]) -> Estimate:
    """Return the mean return of the episodes with one kind of initial state."""
    rows = [np.array(played.cases) == case for played in goals]
    together = all(np.array_equal(own, rows[0]) for own in rows)
    returns = [played.returns[own] for played, own in zip(goals, rows, strict=True) if own.any()]
    return statistics.mean(returns, together=together)


def _statistics(
    goals: Sequence[str], played: dict[str, Played], baseline: dict[str, Played]
) -> dict[str, dict[str, float]]:
    """Return statistics over goals; episodes of different goals with one seed belong together."""
    ours = [played[goal].returns for goal in goals]
    theirs = [baseline[goal].returns for goal in goals]
    estimates: dict[str, Estimate] = {
        "mean": statistics.mean(ours, together=True),
        "interquartile_mean": statistics.interquartile_mean(ours, together=True),
        "difference": statistics.mean([x - y for x, y in zip(ours, theirs, strict=True)], together=True),
        "improvement": statistics.paired_improvement(ours, theirs, together=True),
    }
    return {key: estimate.as_dict() for key, estimate in estimates.items()}
