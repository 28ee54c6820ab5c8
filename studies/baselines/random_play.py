"""Random legal play: how often it scores, how long it takes, and whether it reaches the benches.

python studies/baselines/random_play.py --episodes 2000 unlabelled unlabelled@1
"""

from __future__ import annotations

import argparse

import numpy as np

from chemlab.agents.policies import make_policies
from chemlab.envs.players import Players
from chemlab.kernels.arrays import IntArray
from chemlab.lab.engine import Laboratories

SCENARIOS = ("campaign", "crude", "failing", "refine", "relay", "runaway", "rush", "selectivity", "unlabelled")
SEED = 6_000_000


def play(scenario: str, episodes: int) -> str:
    """Return a table row for a scenario, played in worlds of the split ``validation``."""
    labs = Laboratories(scenario, episodes, split="validation")
    labs.begin(SEED)
    policies = make_policies("random", labs, SEED)
    turns, acted = np.zeros(episodes, dtype=np.int64), np.zeros(episodes, dtype=np.bool_)

    def count(agent: int, members: IntArray) -> None:
        turns[members] += 1
        acted[members] |= agent != labs.manager.index

    Players(labs, [policies[agent] for agent in labs.agents]).play_on(labs.members, count)
    scores = labs.result(labs.members)
    return (
        f"{scenario} | {scores.mean():.4f} | {(scores > 0.1).mean():.2%} | {np.median(turns):.0f} | {acted.mean():.1%}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Random legal play.")
    parser.add_argument("scenarios", nargs="*", default=[name + level for name in SCENARIOS for level in ("", "@1")])
    parser.add_argument("--episodes", type=int, default=2000)
    arguments = parser.parse_args()
    print("scenario | raw score | episodes above 0.1 | median turns | episodes in which a bench acts")
    for scenario in arguments.scenarios:
        print(play(scenario, arguments.episodes), flush=True)


if __name__ == "__main__":
    main()
