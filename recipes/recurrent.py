"""Memory for what is hidden: recurrent PPO.

In `runaway` nobody is told how strong the solution is, how hot the reaction gets, nor how much the jacket takes: what
portions do to the temperature, one after the other, tells. sb3-contrib's PPO with an LSTM can remember that; plain PPO
has the present observation alone. Training is in worlds of the split ``train``, the score in those of ``test``.

    python recipes/recurrent.py --out recipes/results/recurrent.json

Needs the extra ``train``.
"""

from __future__ import annotations

from recipe_parts import PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs

from chemlab.agents.evaluate.play import BenchTarget
from chemlab.config.scenario import load_scenario

GOAL = "ortho_pyrrolidinyl"
TARGET = BenchTarget(load_scenario("runaway"), "rxn", split="test")
NETWORK = {"lstm_hidden_size": 64}


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of both learners, and the scripted agent."""
    policies = {
        "PPO with an LSTM": learned("recurrent-ppo", training_envs(TARGET, GOAL), budget, policy_kwargs=NETWORK),
        PLAIN: learned("ppo", training_envs(TARGET, GOAL), budget),
        SCRIPTED: "scripted",
    }
    return {name: score(policy, TARGET, GOAL, budget) for name, policy in policies.items()}


if __name__ == "__main__":
    cook(recipe, __doc__, f"the reaction bench of `runaway`, {GOAL}", steps=100_000)
