"""Frames per second of the TorchRL environment over the batched laboratory, with random legal actions.

    python studies/speed/torchrl_batch.py [--scenario NAME] [--update docs/performance.md]

A frame is a round of one laboratory: every agent's observation, and the true state. Time is processor time on one
thread, so that other processes do not count. For comparison, TorchRL's wrapper around the single parallel environment
is measured as well.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import torch
from report import arguments, report
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

from chemlab import parallel_env
from chemlab.agents.torchrl.env import TorchLaboratory


def frames_per_second(env: Any, laboratories: int, steps: int) -> float:
    """Return frames per second of processor time, after a warm-up rollout that compiles the kernels."""
    env.rollout(5, break_when_any_done=False)
    begun = time.process_time()
    env.rollout(steps, break_when_any_done=False)
    return laboratories * steps / (time.process_time() - begun)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="wurtz_dodecane")
    parser.add_argument("--steps", type=int, default=100)
    given = arguments(parser)
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    wrapper = PettingZooWrapper(parallel_env(given.scenario), use_mask=True, return_state=True)
    figures: dict[int, Any] = {}
    lines = ["| laboratories | frames/s | without the state |", "|--:|--:|--:|"]
    for count in (16, 64, 256):
        figures[count] = [
            frames_per_second(TorchLaboratory(count, given.scenario, seed=0, state=state), count, given.steps)
            for state in (True, False)
        ]
        lines.append(f"| {count} | " + " | ".join(f"{rate:,.0f}" for rate in figures[count]) + " |")
    figures[1] = frames_per_second(wrapper, 1, given.steps)
    lines.append(f"| 1, TorchRL's wrapper | {figures[1]:,.0f} | |")
    report(given, figures, {"torchrl": lines})


if __name__ == "__main__":
    main()
