"""Hashes of whole trajectories, to compare a redesign with an earlier commit.

For every bundled scenario, several seeds, scripted and random agents, and for every single bench with random actions:
agents, observations, masks, actions, rewards and scores are combined into one hash per episode.

    python studies/speed/trajectories.py --write before.json     # on the old commit
    python studies/speed/trajectories.py --compare before.json   # on the new one: what differs, by episode
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import chemlab  # noqa: F401 - registers the single benches
from chemlab import load_scenario
from chemlab.config.datafile import DataError
from chemlab.config.inherit import scenario_names, synthesis_names


class Digest:
    """A hash of arrays and numbers, independent of their containers."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=12)

    def add(self, *values: Any) -> None:
        for value in values:
            if value is None:
                self._hash.update(b"none")
            elif isinstance(value, str):
                self._hash.update(value.encode())
            else:
                # -0.0 and 0.0 are equal.
                self._hash.update(np.ascontiguousarray(np.asarray(value) + 0).tobytes())

    def text(self) -> str:
        return self._hash.hexdigest()


def laboratory_episode(env: Any, policies: dict[str, Any], seed: int) -> str:
    """Return the hash of one episode with one policy per agent."""
    digest = Digest()
    for name, policy in policies.items():
        if hasattr(policy, "seed"):
            policy.seed(0, np.random.SeedSequence([seed, env.possible_agents.index(name)]))
    env.reset(seed=seed)
    members, steps = np.zeros(1, dtype=np.int64), dict.fromkeys(env.possible_agents, 0)
    for agent in env.agent_iter():
        observation, reward, terminated, truncated, info = env.last()
        digest.add(agent, observation, float(reward), float(terminated), float(truncated), float(info["cost"]))
        if terminated or truncated:
            env.step(None)
            continue
        mask = info.get("action_mask")
        number = env.possible_agents.index(agent)
        steps[agent] = int(env.laboratories.turns_had(number)[0])
        action = policies[agent].act(
            observation[None], None if mask is None else mask[None], np.array([steps[agent]]), members
        )[0]
        digest.add(mask, action)
        env.step(action)
    digest.add(float(env.laboratories.result(members)[0]), env.laboratories.total())
    return digest.text()


def bench_episode(env: gymnasium.Env[Any, Any], seed: int) -> str:
    """Return the hash of one episode of random legal actions."""
    digest = Digest()
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    over = False
    while not over:
        mask = info.get("action_mask")
        action = env.action_space.sample() if mask is None else env.action_space.sample(mask)
        digest.add(observation, mask, action)
        observation, reward, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        digest.add(float(reward), float(info["cost"]), float(over))
    digest.add(observation)
    return digest.text()


def hashes(seeds: int) -> dict[str, list[str]]:
    """Return the hashes by scenario and policy, one per seed."""
    from chemlab import raw_env
    from chemlab.agents.policies import make_policies

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
