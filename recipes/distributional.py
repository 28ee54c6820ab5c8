"""Distributional learning: quantile regression DQN.

QR-DQN (Dabney et al. 2018, "Distributional Reinforcement Learning with Quantile Regression") learns quantiles of an
action's return where DQN learns its mean. The reaction bench takes numbers; ``actions="discrete"`` makes a choice among
representative ones of them, which all three learners have here.

    python recipes/distributional.py --out recipes/results/distributional.json

Needs the extra ``train``.
"""

from __future__ import annotations

from recipe_parts import PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs

from chemlab.agents.evaluate.play import BenchTarget
from chemlab.config.scenario import load_scenario

GOAL = "I"
TARGET = BenchTarget(load_scenario("fictitious").with_actions("discrete"), "rxn", split="test")
REPLAY = {
    "learning_rate": 5e-4,
    "train_freq": 16,
    "gradient_steps": 64,
    "learning_starts": 500,
    "batch_size": 64,
    "n_steps": 20,
    "target_update_interval": 500,
    "exploration_fraction": 0.5,
}
"""Of DQN and QR-DQN alike: 64 updates after 16 steps of all environments, from returns of whole experiments (20 steps).
With one step, and Stable-Baselines3's own interval and exploration, neither learns anything."""
QUANTILES = {"policy_kwargs": {"n_quantiles": 50}}


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of each learner, and the scripted agent with the same choice of actions."""
    policies = {
        "QR-DQN": learned("qr-dqn", training_envs(TARGET, GOAL), budget, **REPLAY, **QUANTILES),
        "DQN": learned("dqn", training_envs(TARGET, GOAL), budget, **REPLAY),
        PLAIN: learned("ppo", training_envs(TARGET, GOAL), budget),
        SCRIPTED: "scripted",
    }
    return {name: score(policy, TARGET, GOAL, budget) for name, policy in policies.items()}


if __name__ == "__main__":
    cook(recipe, __doc__, f"chemlab/FictitiousReaction-v0 with discrete actions, {GOAL}", steps=50_000)
