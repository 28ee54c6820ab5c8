"""Distributional learning: quantile regression DQN.

QR-DQN (Dabney et al. 2018, "Distributional Reinforcement Learning with Quantile Regression") learns quantiles of an
action's return, of which DQN learns the mean. The reaction bench has continuous actions; ``actions="discrete"``
replaces them by a choice among representative ones, for all three learners.

    python recipes/distributional.py --out recipes/results/distributional.json

Needs the extra ``train``.
"""

from __future__ import annotations

from recipe_parts import PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target

GOAL = "I"
TARGET = Target(load_scenario("fictitious").configured(actions="discrete"), "rxn", split="test")
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
"""Settings of DQN and QR-DQN: 64 updates per 16 steps of all environments, with returns of whole experiments (20
steps).

With one-step returns and Stable-Baselines3's default interval and exploration, neither learns.
"""
QUANTILES = {"policy_kwargs": {"n_quantiles": 50}}


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of each learner, and score the scripted agent with the same discrete actions."""
    policies = {
        "QR-DQN": learned("qr-dqn", training_envs(TARGET, GOAL), budget, **REPLAY, **QUANTILES),
        "DQN": learned("dqn", training_envs(TARGET, GOAL), budget, **REPLAY),
        PLAIN: learned("ppo", training_envs(TARGET, GOAL), budget),
        SCRIPTED: "scripted",
    }
    return {name: score(policy, TARGET, GOAL, budget) for name, policy in policies.items()}


if __name__ == "__main__":
    cook(recipe, __doc__, f"chemlab/FictitiousReaction-v0 with discrete actions, {GOAL}", steps=50_000)
