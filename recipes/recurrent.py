"""Memory for what is hidden: recurrent PPO.

In `runaway`, the strength of the solution, the heat of reaction and the cooling power of the jacket are hidden; the
temperature response to successive portions reveals them. sb3-contrib's PPO with an LSTM can remember the responses;
plain PPO has only the current observation. Training uses worlds of the split ``train``, and the score those of
``test``.

    python recipes/recurrent.py --out recipes/results/recurrent.json

Needs the extra ``train``.
"""

from __future__ import annotations

from recipe_parts import PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target

GOAL = "ortho_pyrrolidinyl"
TARGET = Target(load_scenario("runaway"), "rxn", split="test")
NETWORK = {"lstm_hidden_size": 64}


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of both learners, and score the scripted agent."""
    policies = {
        "PPO with an LSTM": learned("recurrent-ppo", training_envs(TARGET, GOAL), budget, policy_kwargs=NETWORK),
        PLAIN: learned("ppo", training_envs(TARGET, GOAL), budget),
        SCRIPTED: "scripted",
    }
    return {name: score(policy, TARGET, GOAL, budget) for name, policy in policies.items()}


if __name__ == "__main__":
    cook(recipe, __doc__, f"the reaction bench of `runaway`, {GOAL}", steps=100_000)
