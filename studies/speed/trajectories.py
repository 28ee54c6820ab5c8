"""Hashes of whole trajectories, to compare a redesign with an earlier commit.

For every bundled scenario, several seeds, scripted and random agents, and for every single bench with random actions:
agents, observations, masks, actions, rewards and scores are combined into one hash per episode.

    python studies/speed/trajectories.py --write before.json     # on the old commit
    python studies/speed/trajectories.py --compare before.json   # on the new one: what differs, by episode
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from helpers import digest

from chemlab import load_scenario, raw_env
from chemlab.agents.episodes import PlayedTurn, play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.datafile import DataError
from chemlab.config.inherit import scenario_names, synthesis_names


def laboratory_episode(env: raw_env, policies: dict[str, Any], seed: int) -> str:
    """Return the hash of one episode with one policy per agent."""
    found: list[str] = []

    def watch(turn: PlayedTurn) -> None:
        own = env.agent_selection
        # Plus 0.0, so that -0.0 and 0.0 are equal.
        numbers = np.array([turn.info["cost"], *env.rewards.values()]) + 0.0
        over = bool(env.terminations[own]), bool(env.truncations[own])
        found.append(digest(turn.agent, np.asarray(turn.action), numbers, over))
        found.append(digest(own, env.observe(own) + 0.0, env.infos[own].get("action_mask")))

    result = play_episode(env, policies, seed, watch=watch)
    return digest(found, result.score, env.laboratories.total())


def bench_episode(env: gymnasium.Env[Any, Any], seed: int) -> str:
    """Return the hash of one episode of random legal actions."""
    found: list[str] = []
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    over = False
    while not over:
        mask = info.get("action_mask")
        action = env.action_space.sample() if mask is None else env.action_space.sample(mask)
        found.append(digest(observation + 0.0, mask, np.asarray(action)))
        observation, reward, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        found.append(digest(np.array([reward, info["cost"]]) + 0.0, bool(over)))
    return digest(found, observation + 0.0)


def hashes(seeds: int) -> dict[str, list[str]]:
    """Return the hashes by scenario and policy, one per seed."""
    found: dict[str, list[str]] = {}
    for scenario in (*scenario_names(), *synthesis_names()):
        env = raw_env(scenario)
        for name in ("random", "scripted", "scripted:unsafe"):
            policies = make_policies(name, env.laboratories, 0)
            found[f"{scenario} {name}"] = [laboratory_episode(env, policies, seed) for seed in range(seeds)]
            print(f"{scenario} {name}", file=sys.stderr, flush=True)
        for bench in load_scenario(scenario).benches:
            for starts in ("paper", "lab"):
                single = _bench(scenario, bench, starts)
                if single is not None:
                    name = f"{scenario} {bench} {starts}"
                    found[name] = [bench_episode(single, seed) for seed in range(seeds)]
                    print(name, file=sys.stderr, flush=True)
    return found


def _bench(scenario: str, bench: str, starts: str) -> gymnasium.Env[Any, Any] | None:
    """Return a single bench of a scenario; None if it has no recorded initial states."""
    try:
        return gymnasium.make("chemlab/Bench-v1", scenario=scenario, bench=bench, starts=starts)
    except (DataError, ValueError):
        return None


def main() -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    group = parser.add_mutually_exclusive_group(required=True)
    group.add_argument("--write", type=Path)
    group.add_argument("--compare", type=Path)
    arguments = parser.parse_args()
    if arguments.write:
        arguments.write.write_text(json.dumps(hashes(arguments.seeds), indent=1) + "\n", encoding="utf-8")
        return 0
    before = json.loads(arguments.compare.read_text(encoding="utf-8"))
    now = hashes(arguments.seeds)
    different = 0
    for name, old in before.items():
        pairs = list(zip(old, now.get(name, []), strict=False))
        wrong = [seed for seed, (a, b) in enumerate(pairs) if a != b]
        different += len(wrong) + (not pairs)
        print(f"{name}: {len(pairs) - len(wrong)} of {len(pairs)} equal" + (f"; not seeds {wrong}" if wrong else ""))
    return min(different, 1)


if __name__ == "__main__":
    sys.exit(main())
