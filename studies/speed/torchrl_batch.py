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
from pathlib import Path
from typing import Any

import torch
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

from chemlab import parallel_env
from chemlab.agents.torchrl.env import TorchLaboratory
from chemlab.config.files import replace_between


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
    parser.add_argument("--update", type=Path, help="replace the table between the marks `torchrl` in a Markdown file")
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore")
    torch.set_num_threads(1)
    wrapper = PettingZooWrapper(parallel_env(arguments.scenario), use_mask=True, return_state=True)
    lines = ["| laboratories | frames/s | without the state |", "|--:|--:|--:|"]
    for count in (16, 64, 256):
        rates = [
            frames_per_second(TorchLaboratory(count, arguments.scenario, seed=0, state=state), count, arguments.steps)
            for state in (True, False)
        ]
        lines.append(f"| {count} | " + " | ".join(f"{rate:,.0f}" for rate in rates) + " |")
    lines.append(f"| 1, TorchRL's wrapper | {frames_per_second(wrapper, 1, arguments.steps):,.0f} | |")
    if arguments.update:
        replace_between(arguments.update, "torchrl", lines)
    print("\n".join(lines))


if __name__ == "__main__":
    main()
