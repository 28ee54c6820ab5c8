"""Goal-conditioned learning with hindsight.

The goal is a mixture: amounts of the products E to I of `fictitious`, drawn from results of random play. The reward at
the end is 1 if every amount is within a tolerance of the goal, else 0. Hindsight experience replay (Andrychowicz et al.
2017) also learns from each experiment with its own result as the goal. The comparison has DQN without hindsight and
PPO, with equal rewards and discrete actions. There is no scripted policy for mixtures. A return is the share of
successful episodes. Evaluation goals differ from training goals.

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

from chemlab.envs.role_env import RoleEnv
from chemlab.kernels.arrays import FloatArray

PRODUCTS = ("E", "F", "G", "H", "I")
TOLERANCE_MOL = 0.05
REPLAY = {"learning_rate": 5e-4, "train_freq": 8, "gradient_steps": 32, "learning_starts": 500, "batch_size": 64}
SOONER = {"target_update_interval": 500, "exploration_fraction": 0.5}
"""Settings that improve DQN with hindsight, and impair it without."""
HINDSIGHT = {"n_sampled_goal": 4, "goal_selection_strategy": "final"}
Observation = dict[str, npt.NDArray[np.float32]]


class Mixtures(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A reaction bench whose goal is a mixture [6]: mol of each product, and 1 (the experiment is over)."""

    def __init__(self, goals: FloatArray) -> None:
        super().__init__(RoleEnv("fictitious", bench="rxn", goals=PRODUCTS[0], actions="discrete"))
        goal = gymnasium.spaces.Box(0.0, np.inf, (len(PRODUCTS) + 1,), np.float32)
        own = self.env.observation_space
        self.observation_space: gymnasium.Space[Any] = gymnasium.spaces.Dict(
            {"observation": own, "achieved_goal": goal, "desired_goal": goal}
        )
        self.goals, self.goal, self.over = goals, np.zeros(len(PRODUCTS) + 1), False

    def made(self) -> FloatArray:
        """Return [6] mol of each product in the vessel, and whether the experiment is over."""
        bench: Any = self.env
        amounts = bench.batch.shelf.vessel(0, 0).amounts(0.0)
        return np.array([*(amounts.get(name, 0.0) for name in PRODUCTS), float(self.over)])

    def compute_reward(self, achieved: Any, desired: Any, infos: Any) -> npt.NDArray[np.float32]:
        """Return 1 where all amounts are within the tolerance, else 0; for one goal or rows of goals."""
        return np.asarray((np.abs(achieved - desired) < TOLERANCE_MOL).all(axis=-1), dtype=np.float32)

    def _seen(self, observation: npt.NDArray[np.float32]) -> Observation:
        made, goal = self.made().astype(np.float32), self.goal.astype(np.float32)
        return {"observation": observation, "achieved_goal": made, "desired_goal": goal}

    def reset(self, **arguments: Any) -> tuple[Observation, dict[str, Any]]:
        """Start an experiment with a random goal."""
        observation, info = self.env.reset(**arguments)
        self.over, self.goal = False, self.goals[self.env.unwrapped.np_random.integers(len(self.goals))]
        return self._seen(observation), info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take a step; the bench's own reward is dropped."""
        observation, _, self.over, truncated, info = self.env.step(int(action))
        seen = self._seen(observation)
        reward = float(self.compute_reward(self.made(), self.goal, info))
        return seen, reward, self.over, truncated, {**info, "TimeLimit.truncated": False}


def played(env: Mixtures, episodes: int, model: Any = None) -> tuple[FloatArray, Outcome]:
    """Play episodes of a model, or of random play.

    Returns:
        [episodes, 6] results, and the success rate and mean cost.
    """
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
    """Train one seed of each learner, and score random play."""
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
