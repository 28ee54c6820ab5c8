"""Potential-based reward shaping.

A wrapper adds gamma phi(s') - phi(s) to each reward, with phi of a terminal state 0. An episode's discounted return
changes by -phi(s0), whatever is done in it, so the ranking of policies stays the same (Ng, Harada and Russell 1999). It
needs the learner's own gamma. Here phi is a small price on reagents that are left; beside it the same PPO without it.
The scores of all are unshaped.

    python recipes/shaping.py --out recipes/results/shaping.json

Needs the extra ``train``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from recipe_parts import PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.roles.bench import channel_slices

TARGET = Target(load_scenario("wurtz_dodecane"), "rxn")
GOAL = "dodecane"
GAMMA, PRICE = 0.99, 0.1


class PotentialShaping(gymnasium.vector.VectorWrapper):
    """Add gamma phi(s') - phi(s) to the rewards of a batch that resets in the same step.

    A truncated state keeps its potential, because the learner bootstraps there.

    Args:
        env: N members, with ``autoreset_mode="SameStep"``.
        potential: phi, from observations [N, size] to [N], in units of the reward.
        gamma: the learner's discount.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv, potential: Callable[[Any], Any], gamma: float) -> None:
        super().__init__(env)
        self.potential, self.gamma, self._phi = potential, gamma, np.zeros(env.num_envs)

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Begin episodes in every member."""
        observations, infos = self.env.reset(**arguments)
        self._phi = self.potential(observations)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Take one step, with the shaped rewards; the environment's own are ``infos["unshaped_reward"]``."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        last = np.array(observations)
        for i in np.flatnonzero(terminated | truncated):
            last[i] = infos["final_obs"][i]
        shaped = rewards + self.gamma * np.where(terminated, 0.0, self.potential(last)) - self._phi
        self._phi = self.potential(observations)
        return observations, shaped, terminated, truncated, {**infos, "unshaped_reward": np.array(rewards)}


def shaped_envs() -> ChemlabVecEnv:
    """The reaction bench for Stable-Baselines3, shaped."""
    batch = RoleVectorEnv(16, TARGET.scenario, bench=TARGET.bench, goals=GOAL, autoreset_mode="SameStep")
    left = channel_slices(batch.bench.channels)["reagents"]
    return ChemlabVecEnv(PotentialShaping(batch, lambda seen: PRICE * (1.0 - seen[:, left].mean(axis=1)), GAMMA))


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of PPO with shaping and without, and the script."""
    return {
        "PPO, shaped": score(learned("ppo", shaped_envs(), budget, gamma=GAMMA), TARGET, GOAL, budget),
        PLAIN: score(learned("ppo", training_envs(TARGET, GOAL), budget, gamma=GAMMA), TARGET, GOAL, budget),
        SCRIPTED: score("scripted", TARGET, GOAL, budget),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the reaction bench of `{TARGET.scenario.name}`, {GOAL}", steps=50_000)
