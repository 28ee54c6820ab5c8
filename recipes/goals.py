"""Goal-conditioned learning with hindsight.

The goal is a mixture: amounts of the products E to I of `fictitious`, drawn from what random play comes to. There is a
reward at the end: 1 where every amount is within a tolerance of the goal, else 0. Hindsight experience replay
(Andrychowicz et al. 2017) learns from each experiment as if what came of it had been the goal as well. Beside it, DQN
without hindsight and PPO, on the same rewards and the same discrete actions. Nobody is scripted for mixtures; a return
is the share of episodes that succeed. Goals to score with are none of those to train with.

    python recipes/goals.py --out recipes/results/goals.json

Needs the extra ``train``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from recipe_parts import AUDIT_SEED, PLAIN, Budget, Outcome, cook, learned
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env

from chemlab.envs.bench_env import BenchEnv
from chemlab.kernels.arrays import FloatArray

PRODUCTS = ("E", "F", "G", "H", "I")
TOLERANCE_MOL = 0.05
REPLAY = {"learning_rate": 5e-4, "train_freq": 8, "gradient_steps": 32, "learning_starts": 500, "batch_size": 64}
SOONER = {"target_update_interval": 500, "exploration_fraction": 0.5}
"""With these DQN does better where it has hindsight, and worse where it has not."""
HINDSIGHT = {"n_sampled_goal": 4, "goal_selection_strategy": "final"}
Observation = dict[str, npt.NDArray[np.float32]]


class Mixtures(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A reaction bench whose goal is a mixture [6]: mol of each product, and 1 (the experiment is over)."""

    def __init__(self, goals: FloatArray) -> None:
        super().__init__(BenchEnv("fictitious", "rxn", goals=PRODUCTS[0], actions="discrete"))
        goal = gymnasium.spaces.Box(0.0, np.inf, (len(PRODUCTS) + 1,), np.float32)
        own = self.env.observation_space
        self.observation_space: gymnasium.Space[Any] = gymnasium.spaces.Dict(
            {"observation": own, "achieved_goal": goal, "desired_goal": goal}
        )
        self.goals, self.goal, self.over = goals, np.zeros(len(PRODUCTS) + 1), False

    def made(self) -> FloatArray:
        """[6] mol of each product in the vessel, and whether the experiment is over."""
        bench: Any = self.env
        amounts = bench.batch.shelf.vessel(0, 0).amounts(0.0)
        return np.array([*(amounts.get(name, 0.0) for name in PRODUCTS), float(self.over)])

    def compute_reward(self, achieved: Any, desired: Any, infos: Any) -> npt.NDArray[np.float32]:
        """1 where all of it is within the tolerance, else 0; of one goal or of rows of them."""
        return np.asarray((np.abs(achieved - desired) < TOLERANCE_MOL).all(axis=-1), dtype=np.float32)

    def _seen(self, observation: npt.NDArray[np.float32]) -> Observation:
        made, goal = self.made().astype(np.float32), self.goal.astype(np.float32)
        return {"observation": observation, "achieved_goal": made, "desired_goal": goal}

    def reset(self, **arguments: Any) -> tuple[Observation, dict[str, Any]]:
        """Begin an experiment, for a goal that is drawn."""
        observation, info = self.env.reset(**arguments)
        self.over, self.goal = False, self.goals[self.env.unwrapped.np_random.integers(len(self.goals))]
        return self._seen(observation), info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """A step; what the bench itself would pay is left out."""
        observation, _, self.over, truncated, info = self.env.step(int(action))
        seen = self._seen(observation)
        reward = float(self.compute_reward(self.made(), self.goal, info))
        return seen, reward, self.over, truncated, {**info, "TimeLimit.truncated": False}


def played(env: Mixtures, episodes: int, model: Any = None) -> tuple[FloatArray, Outcome]:
    """Episodes of a model, or of random play: ([episodes, 6] what came of them, how many succeeded, and cost)."""
    env.action_space.seed(0)
    ends, won, cost = np.zeros((episodes, len(PRODUCTS) + 1)), 0.0, 0.0
    for i in range(episodes):
        seen, _ = env.reset(seed=AUDIT_SEED + i)
        while not env.over:
            action = env.action_space.sample() if model is None else model.predict(seen, deterministic=True)[0]
            seen, reward, _, _, info = env.step(action)
            won, cost = won + reward, cost + info["cost"]
        ends[i] = env.made()
    return ends, Outcome(won / episodes, cost / episodes, getattr(model, "num_timesteps", 0))


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of each learner, and random play."""
    random, _ = played(Mixtures(np.zeros((1, len(PRODUCTS) + 1))), 20 if budget.toy else 600)
    train, test = np.split(random, 2)

    def outcome(algorithm: str, **settings: Any) -> Outcome:
        envs = make_vec_env(lambda: Mixtures(train), n_envs=8, seed=budget.seed)
        return played(Mixtures(test), budget.episodes, learned(algorithm, envs, budget, **settings))[1]

    hindsight = {"replay_buffer_class": HerReplayBuffer, "replay_buffer_kwargs": HINDSIGHT}
    return {
        "DQN with hindsight": outcome("dqn", **REPLAY, **SOONER, **hindsight),
        "DQN": outcome("dqn", **REPLAY),
        PLAIN: outcome("ppo"),
        "random": played(Mixtures(test), budget.episodes)[1],
    }


if __name__ == "__main__":
    cook(recipe, __doc__, "mixtures on chemlab/FictitiousReaction-v0 with discrete actions", steps=50_000)
