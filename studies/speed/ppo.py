"""Speed of SB3's PPO on each bench, compared with PPO on an environment with equal spaces that computes nothing.

Run ``python studies/speed/ppo.py`` (needs the extra ``train``; ``--update FILE`` writes the table between the marks
``<!-- ppo: begin -->`` and ``<!-- ppo: end -->`` of a Markdown file). 10 environments, 256 steps, SB3 defaults. Both
are timed in alternation; only the ratio of their medians is comparable between machines.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np
import torch
from report import arguments, report
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from chemlab.agents.sb3 import ChemlabVecEnv

ENVS, STEPS = 10, 256
BENCHES = ("rxn", "ext", "dit")


class Nothing(VecEnv):
    """Environment with given spaces, constant observations, no rewards and no ends."""

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
    """Return the training speed of a new PPO."""
    model = PPO("MlpPolicy", env, n_steps=STEPS, seed=0, device="cpu")
    begun = time.perf_counter()
    model.learn(frames)
    return frames / (time.perf_counter() - begun)


def measure(bench: str, rounds: int) -> dict[str, Any]:
    """Return medians of both, and their ratio."""
    chemistry = ChemlabVecEnv(ENVS, bench=bench)
    nothing = Nothing(chemistry)
    frames = 4 * ENVS * STEPS
    for env in (chemistry, nothing):
        frames_per_second(env, ENVS * STEPS)  # the first run compiles and allocates
    pairs = [(frames_per_second(chemistry, frames), frames_per_second(nothing, frames)) for _ in range(rounds)]
    with_us, without = (statistics.median(column) for column in zip(*pairs, strict=True))
    return {"bench": bench, "chemlab_fps": with_us, "nothing_fps": without, "ratio": with_us / without}


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    given = arguments(parser)
    torch.set_num_threads(1)
    results = [measure(bench, given.rounds) for bench in BENCHES]
    table = ["| bench of `wurtz_dodecane` | frames/s of PPO | computing nothing | ratio |", "|---|--:|--:|--:|"]
    table += [
        f"| `{row['bench']}` | {row['chemlab_fps']:,.0f} | {row['nothing_fps']:,.0f} | {row['ratio']:.2f} |"
        for row in results
    ]
    report(given, results, {"ppo": table})


if __name__ == "__main__":
    main()
