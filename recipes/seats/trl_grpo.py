"""Train a language model at a seat with TRL's GRPO: ``python recipes/seats/trl_grpo.py MODEL``.

TRL needs no adapter: a seat's methods are the tools, ``reset`` begins an episode, ``get_reward`` is the score. The
contract was checked with transformers 5.24.0 and the sources of TRL 1.16.0. No model was trained: this needs a GPU.
"""

from __future__ import annotations

import sys

from chemlab.agents.seats import LabTools, Room

SCENARIO, SEAT = "wurtz_dodecane", "manager_0"


def environment() -> LabTools:
    """A seat in a room of its own; TRL makes one for every episode that is played at the same time."""
    return LabTools(Room(SCENARIO, (SEAT,), calls=100), SEAT)


def main(model: str) -> None:
    """Train, with rows that only ask for an episode."""
    from datasets import Dataset
    from trl import GRPOConfig, GRPOTrainer

    rows = Dataset.from_list([{"prompt": [{"role": "user", "content": "Run the laboratory with the tools."}]}] * 1000)
    settings = GRPOConfig(output_dir="runs/grpo", max_completion_length=8192)
    GRPOTrainer(model, args=settings, train_dataset=rows, environment_factory=environment).train()


if __name__ == "__main__":
    main(sys.argv[1])
