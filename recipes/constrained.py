"""Constrained learning: PPO with a Lagrange multiplier.

Maximise the return while the mean cost of an episode stays below a limit (a constrained Markov decision process, Altman
1999). The multiplier is the price of a unit of cost in the reward. It rises after rollouts that cost more than the
limit and falls after others (PPO-Lagrangian of Ray, Achiam and Amodei 2019, "Benchmarking Safe Exploration in Deep
Reinforcement Learning"). The cost is ``info["cost"]``: in `runaway`, vapour that is not condensed. The scenario's own
price is set to zero, so that returns measure the product. The comparison has PPO without the cost, and PPO with the
scenario's price.

    python recipes/constrained.py --out recipes/results/constrained.json

Needs the extra ``train``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from recipe_parts import PLAIN, SCRIPTED, Budget, Outcome, cook, learned, score, training_envs
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target

GOAL = "ortho_pyrrolidinyl"
PRICED = load_scenario("runaway")
FREE = PRICED.model_copy(update={"safety": PRICED.safety.model_copy(update={"reward_price": 0.0})})
TARGET = Target(FREE, "rxn", split="test")
LIMIT = 0.002
RATE = 2.0
"""Step of the dual ascent: change of the multiplier by a unit of cost above the limit."""


class Priced(VecEnvWrapper):
    """Subtracts cost at the current multiplier from the reward, and records the cost of episodes."""

    def __init__(self, envs: Any, multiplier: float = 0.0) -> None:
        super().__init__(envs)
        self.multiplier = multiplier
        self.ended: list[float] = []
        self._costs = np.zeros(envs.num_envs)

    def reset(self) -> Any:
        """Start new experiments."""
        self._costs[:] = 0.0
        return self.venv.reset()

    def step_wait(self) -> tuple[Any, npt.NDArray[Any], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Step all experiments at the multiplier's price."""
        observations, rewards, dones, infos = self.venv.step_wait()
        cost = np.array([info["cost"] for info in infos])
        self._costs += cost
        self.ended += self._costs[dones].tolist()
        self._costs[dones] = 0.0
        return observations, (rewards - self.multiplier * cost).astype(np.float32), dones, infos


class DualAscent(BaseCallback):
    """Updates the multiplier after every rollout."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        envs: Any = self.training_env
        excess = float(np.mean(envs.ended)) - LIMIT if envs.ended else 0.0
        envs.multiplier, envs.ended = max(0.0, envs.multiplier + RATE * excess), []


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of each learner."""
    envs = {name: Priced(training_envs(TARGET, GOAL)) for name in ("lagrangian", "plain")}
    price = PRICED.safety.reward_price
    models = {
        f"PPO-Lagrangian, cost at most {LIMIT:g}": learned("ppo", envs["lagrangian"], budget, DualAscent()),
        PLAIN: learned("ppo", envs["plain"], budget),
        f"PPO, a unit of cost at {price:g}": learned("ppo", Priced(training_envs(TARGET, GOAL), price), budget),
        SCRIPTED: "scripted",
    }
    return {name: score(model, TARGET, GOAL, budget) for name, model in models.items()}


if __name__ == "__main__":
    cook(recipe, __doc__, f"the reaction bench of `runaway`, {GOAL}", steps=60_000)
