"""Reinforcement learning: a policy that proposes recipes, trained by PPO on training worlds.

    python recipes/campaigns/ppo.py --steps 1500000     # writes ppo.safetensors

An episode is a campaign of 24 experiments, two at a time, in a world of the split ``train``. The policy observes, for
each catalyst, the best recipe so far and its measured value, and chooses a catalyst and a level of each number. The
reward is the gain in the value, without noise, of the recipe with the best measured value. Training needs the extra
``train``; playing needs nothing but chemlab.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file, save_file

from chemlab.campaign import Campaign, Choice
from chemlab.lab.engine import Laboratories

_FILE = Path(__file__).with_name("ppo.safetensors")
_NUMBERS = {"percent": 9, "equivalents": 9, "temperature_k": 16, "minutes": 8}
"""Levels of each number."""
_EXPERIMENTS, _AT_ONCE, _NOISE = 24, 2, 0.02


class Notes:
    """Knowledge of policies about n campaigns.

    Args:
        count: n.
        space: of the campaigns.
    """

    def __init__(self, count: int, space: Any) -> None:
        assert isinstance(space["catalyst"], Choice), "it is a category"
        self.space, self.catalysts = space, space["catalyst"].options
        self.sizes = (len(self.catalysts), *_NUMBERS.values())
        self.best = np.zeros((count, len(self.catalysts), 6))
        """of each catalyst: whether it was tried, value and levels of the best recipe"""
        self.pending: list[Any] = []
        self.number = 0

    @property
    def observation(self) -> Any:
        """[n, 49] numbers: the best of each catalyst, its leader, the recipe that runs, and the time."""
        count, options = self.best.shape[:2]
        leader = np.eye(options)[np.where(self.best[..., 0] > 0, self.best[..., 1], -1.0).argmax(axis=1)]
        runs = np.zeros((count, options + len(_NUMBERS)))
        if self.pending:
            runs[:, :options] = np.eye(options)[self.pending[0][:, 0]]
            runs[:, options:] = self._shares(self.pending[0])
        time = np.full((count, 5), self.number / _EXPERIMENTS)
        time[:, 1:] = np.arange(4) == self.number // 6
        return np.concatenate([self.best.reshape(count, -1), leader, runs, time], axis=1).astype(np.float32)

    def _shares(self, actions: Any) -> Any:
        return actions[:, 1:] / (np.array(list(_NUMBERS.values())) - 1)

    def recipes(self, actions: Any) -> list[dict[str, Any]]:
        """Recipes of actions [n, 5]: a catalyst and four levels."""
        found = []
        for action, shares in zip(actions, self._shares(actions), strict=True):
            recipe: dict[str, Any] = {"catalyst": self.catalysts[action[0]]}
            for name, share in zip(_NUMBERS, shares.tolist(), strict=True):
                allowed = self.space[name]
                value = allowed.low + share * (allowed.high - allowed.low)
                recipe[name] = round(value) if allowed.step else value
            found.append(recipe)
        return found

    def begin(self, actions: Any) -> bool:
        """Note what is run; return whether its results come now, because enough run at once."""
        self.pending.append(np.asarray(actions))
        self.number += 1
        return len(self.pending) == _AT_ONCE or self.number == _EXPERIMENTS

    def end(self, values: list[Any]) -> None:
        """Note the measured values of all that runs."""
        rows = np.arange(len(self.best))
        for actions, value in zip(self.pending, values, strict=True):
            known = self.best[rows, actions[:, 0]]
            better = (known[:, 0] == 0) | (value > known[:, 1])
            known[better] = np.column_stack([np.ones(len(rows)), value, self._shares(actions)])[better]
            self.best[rows, actions[:, 0]] = known
        self.pending = []


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    weights, rng = load_file(_FILE), np.random.default_rng(seed)
    notes = Notes(1, campaign.space)
    while campaign.left:
        asked: list[Any] = []
        while len(asked) < min(batch, campaign.left):
            asked.append(_act(weights, notes, rng))
            notes.begin(asked[-1])
        results = campaign.run_batch([notes.recipes(actions)[0] for actions in asked])
        notes.end([np.array([result.value]) for result in results])


def _act(weights: dict[str, Any], notes: Notes, rng: np.random.Generator) -> Any:
    """Draw an action [1, 5] of the trained policy."""
    hidden = notes.observation
    for layer in ("0", "2"):
        hidden = np.tanh(hidden @ weights[f"{layer}.weight"].T + weights[f"{layer}.bias"])
    logits, action = hidden @ weights["out.weight"].T + weights["out.bias"], []
    for part in np.split(logits[0], np.cumsum(notes.sizes)[:-1]):
        chance = np.exp(part.astype(float) - part.max())
        action.append(int(rng.choice(len(part), p=chance / chance.sum())))
    return np.array([action])


def training_envs(count: int, seed: int) -> Any:
    """Campaigns in ``count`` worlds as Stable-Baselines3 takes them; each episode has new worlds."""
    from gymnasium import spaces
    from stable_baselines3.common.vec_env import VecEnv

    campaign = Campaign(seed=0)

    class Worlds(VecEnv):
        """All campaigns go on in step."""

        def __init__(self) -> None:
            self.labs, self.rng = Laboratories(campaign.scenario, count, split="train"), np.random.default_rng(seed)
            self.notes = Notes(count, campaign.space)
            size = self.notes.observation.shape[1]
            observed = spaces.Box(-np.inf, np.inf, (size,), np.float32)
            super().__init__(count, observed, spaces.MultiDiscrete(self.notes.sizes))

        def reset(self) -> Any:
            for member in self.labs.members:
                self.labs.seed(int(member), np.random.SeedSequence(int(self.rng.integers(2**63))))
            self.labs.reset(self.labs.members)
            self.notes = Notes(count, campaign.space)
            self.true, self.measured, self.values = np.zeros(count), np.full(count, -np.inf), list[Any]()
            return self.notes.observation

        def step_async(self, actions: Any) -> None:
            self.actions = actions

        def step_wait(self) -> Any:
            recipes = self.notes.recipes(self.actions)
            self.values.append(campaign.values_in(self.labs, recipes, self.notes.number))
            before = self.true
            if self.notes.begin(self.actions):
                noisy = [value + _NOISE * self.rng.standard_normal(count) for value in self.values]
                for value, seen in zip(self.values, noisy, strict=True):
                    self.true = np.where(seen > self.measured, value, self.true)
                    self.measured = np.maximum(self.measured, seen)
                self.notes.end(noisy)
                self.values = []
            done, infos = self.notes.number == _EXPERIMENTS, [dict[str, Any]() for _ in range(count)]
            reward, end = (self.true - before).astype(np.float32), self.true
            observation = self.notes.observation
            if done:
                infos = [
                    {"terminal_observation": seen, "value": float(v)} for seen, v in zip(observation, end, strict=True)
                ]
                observation = self.reset()
            return observation, reward, np.full(count, done), infos

        def close(self) -> None: ...

        def get_attr(self, attr_name: str, indices: Any = None) -> Any:
            return [None] * count

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None: ...

        def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
            raise NotImplementedError

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> Any:
            return [False] * count

    return Worlds()


def train(steps: int, envs: int = 256) -> dict[str, Any]:
    """Return the weights that PPO comes to; the mean value of the recommended recipes is printed on the way."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)

    class Course(BaseCallback):
        """Prints the mean value at the end of each round of episodes."""

        def _on_step(self) -> bool:
            ends = [info["value"] for info in self.locals["infos"] if "value" in info]
            if ends:
                print(self.num_timesteps, round(float(np.mean(ends)), 4), flush=True)
            return True

    model = PPO(
        "MlpPolicy",
        training_envs(envs, 0),
        n_steps=_EXPERIMENTS,
        batch_size=1024,
        n_epochs=6,
        gamma=1.0,
        ent_coef=0.001,
        learning_rate=lambda left: 1e-3 * left,
        seed=0,
        device="cpu",
    )
    model.learn(steps, Course())
    policy = model.policy
    found = {f"{key}": value for key, value in policy.mlp_extractor.policy_net.state_dict().items()}
    found |= {f"out.{key}": value for key, value in policy.action_net.state_dict().items()}
    return {key: value.numpy().astype(np.float32) for key, value in found.items()}


def main() -> None:
    """Train and write the weights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_500_000, help="experiments")
    save_file(train(parser.parse_args().steps), _FILE)


if __name__ == "__main__":
    main()
