"""Returns of bench policies on fixed experiments: each goal, the same seeds for every policy, all in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from gymnasium.vector import AutoresetMode

from chemlab.laboratory.bench_env import BenchVectorEnv
from chemlab.scenario import Scenario
from chemlab.shelf import FloatArray

from ..policy import Policy

__all__ = ["Trials"]


class Trials:
    """Experiments to compare policies on: ``episodes`` for each goal, with the seeds ``seed``, ``seed + 1``, ...

    Args:
        scenario, bench, goals, starts: as for :class:`~chemlab.laboratory.bench_env.BenchEnv`.
        episodes: episodes for each goal.
        seed: seed of each goal's first episode; an episode is what ``BenchEnv.reset`` with its seed and goal begins.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario,
        bench: str,
        episodes: int,
        seed: int,
        goals: Sequence[str] | None = None,
        starts: str = "paper",
    ) -> None:
        self.env = BenchVectorEnv(1, scenario, bench, goals, starts)
        spec = self.env.arena.scenario
        self.goals: tuple[str, ...] = spec.goals if goals is None else tuple(goals)
        self.episodes = episodes
        self.seed = seed
        self.env = BenchVectorEnv(episodes * len(self.goals), spec, bench, goals, starts, AutoresetMode.SAME_STEP)
        self.bench = self.env.bench

    def returns(self, policy: Policy) -> FloatArray:
        """[G, episodes] the returns of a policy."""
        env, count = self.env, self.env.num_envs
        seeds = [self.seed + i for i in range(self.episodes)] * len(self.goals)
        goal_of = np.repeat(np.arange(len(self.goals)), self.episodes)
        for g, goal in enumerate(self.goals):
            # The first reset has to be of all; each goal's members are then begun with the goal that is theirs.
            only = goal_of == g if g else np.ones(count, dtype=np.bool_)
            seen, infos = env.reset(seed=seeds, options={"goal": goal, "reset_mask": only})
        totals, running = np.zeros(count), np.ones(count, dtype=np.bool_)
        steps, members = np.zeros(count, dtype=np.int64), np.arange(count)
        while running.any():
            seen, rewards, ended, _, infos = env.step(policy.act(seen, infos.get("action_mask"), steps, members))
            totals += np.where(running, rewards, 0.0)
            running &= ~ended
            # Members that are through play on, uncounted, until all are: policies see whole batches.
            steps = np.where(ended, 0, steps + 1)
        return totals.reshape(len(self.goals), self.episodes)

    def by_goal(self, policy: Policy) -> dict[str, float]:
        """A policy's mean return for each goal."""
        return {goal: float(mean) for goal, mean in zip(self.goals, self.returns(policy).mean(axis=1), strict=True)}
