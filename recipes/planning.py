"""Model-based planning with snapshots.

The cross-entropy method (Rubinstein 1999) as model predictive control: before every step, sequences of actions for the
rest of the experiment are tried on copies of it (``get_state``, ``set_state``), sampled more densely around the best
ones. The first action of the best sequence is taken, and the search continues from there. A batched environment is its
own model: every member is a copy. The copies share the random streams, so the planner could exploit future noise; here
that is only the spectrum's, which it does not use.

    python recipes/planning.py --seeds 3 --out recipes/results/planning.json

PPO learns from as many steps as all planned episodes may try (by default one episode, because this bench has a single
initial state). It needs the extra ``train`` and is left out without it. Nothing else is needed.
"""

from __future__ import annotations

import importlib.util

import numpy as np
from recipe_parts import AUDIT_SEED, PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.kernels.arrays import FloatArray

GOAL = "I"
TARGET = Target(load_scenario("fictitious"), "rxn", split="test")
COPIES, ELITES = 64, 8
SMALLEST = 0.1
"""Minimum standard deviation of the sampled actions, whose range is 1."""


def tried(env: RoleVectorEnv, sequences: FloatArray) -> FloatArray:
    """Return [copies] the return of each copy with sequences [copies, steps, numbers]."""
    returns, running = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=np.bool_)
    for step in range(sequences.shape[1]):
        _, rewards, terminated, truncated, _ = env.step(sequences[:, step])
        returns += running * rewards
        running &= ~(terminated | truncated)
    return returns


def planned(env: RoleVectorEnv, seed: int, rounds: int, random: np.random.Generator) -> tuple[float, float, int]:
    """Plan an episode; return (return, cost, steps tried)."""
    env.reset(seed=[seed] * COPIES, options={"goal": GOAL})
    earned, cost, steps = 0.0, 0.0, 0
    numbers = (env.bench.step_limit, *(env.single_action_space.shape or ()))
    center, spread = np.full(numbers, 0.5), np.full(numbers, 0.5)
    best = center
    for left in range(env.bench.step_limit, 0, -1):
        now = env.get_state()
        for _ in range(rounds):
            sequences = np.clip(random.normal(center, spread, (COPIES, *center.shape)), 0.0, 1.0)
            sequences[0] = best
            env.set_state(now)
            returns = tried(env, sequences)
            steps += COPIES * left
            elites = sequences[np.argsort(returns)[-ELITES:]]
            best = elites[-1]
            center, spread = elites.mean(axis=0), np.maximum(elites.std(axis=0), SMALLEST)
        env.set_state(now)
        _, rewards, terminated, _, infos = env.step(np.tile(best[0], (COPIES, 1)))
        earned, cost = earned + float(rewards[0]), cost + float(infos["cost"][0])
        center, spread, best = center[1:], spread[1:], best[1:]
        if terminated[0]:
            break
    return earned, cost, steps


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Play one seed of the planner's random numbers and of PPO."""
    env = TARGET.environment(COPIES)
    random, limit = np.random.default_rng(budget.seed), env.bench.step_limit
    rounds = max(1, budget.steps // (budget.episodes * COPIES * limit * (limit + 1) // 2))
    episodes = [planned(env, AUDIT_SEED + i, rounds, random) for i in range(budget.episodes)]
    returns, costs, steps = np.array(episodes).T
    found = {"cross-entropy method": Outcome(float(returns.mean()), float(costs.mean()), int(steps.sum()))}
    if importlib.util.find_spec("stable_baselines3") is not None:
        found[PLAIN] = score(learned("ppo", training_envs(TARGET, GOAL), budget), TARGET, GOAL, budget)
    return found | {SCRIPTED: score("scripted", TARGET, GOAL, budget)}


if __name__ == "__main__":
    cook(recipe, __doc__, f"chemlab/FictitiousReaction-v0, {GOAL}", steps=41_000, episodes=1)
