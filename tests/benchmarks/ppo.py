"""Speed of SB3's PPO on RxN, beside the same PPO on an environment with the same spaces that computes nothing.

Run ``python tests/benchmarks/ppo.py`` (needs the extra ``train``). 10 environments, 256 steps, SB3 defaults; they are
timed in turns, and the ratio of their medians is what means something on another machine.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from chemlab.agents.sb3 import ChemlabVecEnv

ENVS, STEPS = 10, 256


class Nothing(VecEnv):
    """Given spaces, constant observations, no rewards and no ends."""

    def __init__(self, spaces: VecEnv) -> None:
        super().__init__(ENVS, spaces.observation_space, spaces.action_space)
        self._observation = np.random.default_rng(0).random((ENVS, *spaces.observation_space.shape), dtype=np.float32)
        self._rewards, self._dones = np.zeros(ENVS, dtype=np.float32), np.zeros(ENVS, dtype=np.bool_)
        self._infos: list[dict[str, Any]] = [{} for _ in range(ENVS)]

    def reset(self) -> Any:
        return self._observation

    def step_async(self, actions: Any) -> None:
        pass

    def step_wait(self) -> Any:
        return self._observation, self._rewards, self._dones, self._infos

    def close(self) -> None:
        pass

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        if attr_name == "render_mode":
            return [None] * ENVS
        raise AttributeError(attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        pass

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        return []

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * ENVS


def frames_per_second(env: VecEnv, frames: int) -> float:
    """Training speed of a fresh PPO."""
    model = PPO("MlpPolicy", env, n_steps=STEPS, seed=0, device="cpu")
    begun = time.perf_counter()
    model.learn(frames)
    return frames / (time.perf_counter() - begun)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    chemistry = ChemlabVecEnv(ENVS, bench="rxn")
    nothing = Nothing(chemistry)
    frames = 4 * ENVS * STEPS
    for env in (chemistry, nothing):
        frames_per_second(env, ENVS * STEPS)  # the first run compiles and allocates
    pairs = [
        (frames_per_second(chemistry, frames), frames_per_second(nothing, frames)) for _ in range(arguments.rounds)
    ]
    with_us, without = (statistics.median(column) for column in zip(*pairs, strict=True))
    result = {"chemlab_fps": with_us, "nothing_fps": without, "ratio": with_us / without}
    print(
        json.dumps(result) if arguments.json else f"{with_us:,.0f} of {without:,.0f} frames/s: {with_us / without:.3f}"
    )


if __name__ == "__main__":
    main()
