"""The same seed is the same episode: in another process, after a restore, in the next episode of the same environment.

Run as a script, this file prints the digests of its episodes, which is how the test asks another process for them.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import EVERY_SCENARIO, FEATURED, slow_but

from chemlab.agents.policies import make_policies
from chemlab.laboratory.aec import raw_env
from chemlab.laboratory.core import Laboratories
from chemlab.scenario import scenario_names

OTHERS = tuple(name for name in scenario_names() if name not in FEATURED)


class Digest:
    """blake2b over everything an episode shows."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, *values: Any) -> None:
        """Take in arrays, numbers, flags and names."""
        for value in values:
            if isinstance(value, np.ndarray):
                self._hash.update(f"{value.dtype}{value.shape}".encode())
                self._hash.update(np.ascontiguousarray(value).tobytes())
            elif isinstance(value, dict):
                for key in sorted(value):
                    self.add(key, value[key])
            else:
                self._hash.update(repr(value).encode())

    def __str__(self) -> str:
        return self._hash.hexdigest()


def episode(env: raw_env, policy: str, seed: int, reset: bool = True) -> str:
    """Digest of every observation, reward, mask, flag and info of one episode, of all agents at every turn."""
    policies = make_policies(policy, env.laboratories, seed=seed)
    if reset:
        env.reset(seed=seed)
    digest, labs = Digest(), env.laboratories
    while True:
        agent = env.agent_selection
        digest.add(agent, env.rewards, env.terminations, env.truncations, env.infos, *map(env.observe, env.agents))
        if labs.state.status[0] != 0:
            return str(digest)
        number = env.possible_agents.index(agent)
        mask = env.infos[agent].get("action_mask")
        step = (labs.state.actions if number == 0 else labs.experiments[number - 1].steps)[:1]
        # Without submissions random episodes are long; the random manager has only that one way to end early.
        if mask is not None and number == 0 and policy == "random":
            mask = np.array([m and labs.actions.decode(a)[0] != "submit" for a, m in enumerate(mask)], dtype=np.int8)
        action = policies[agent].act(
            env.observe(agent)[None], None if mask is None else mask[None], step, labs.members
        )[0]
        digest.add(np.asarray(action))
        env.step(action)


def digests(names: Iterable[str]) -> dict[str, str]:
    """Of a random and a scripted episode of scenarios."""
    return {
        f"{name} {policy}": episode(raw_env(name), policy, seed)
        for name in names
        for policy, seed in (("random", 3), ("heuristic", 4))
    }


@pytest.mark.parametrize(
    "names", [pytest.param(FEATURED, id="featured"), pytest.param(OTHERS, id="others", marks=pytest.mark.slow)]
)
def test_another_process_plays_the_same_episodes(names: Sequence[str]) -> None:
    here = digests(names)
    # Another hash seed shuffles sets of strings: an order that comes from one would show.
    environment = dict(os.environ, PYTHONHASHSEED="271828", PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    run = subprocess.run(
        [sys.executable, str(Path(__file__)), *names],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == here
    assert all(here[f"{name} random"] != here[f"{name} heuristic"] for name in names)


@pytest.mark.parametrize("policy", ["random", "heuristic"])
@pytest.mark.parametrize("name", slow_but(scenario_names(), "fictitious", "wurtz_two_lines"))
def test_a_used_environment_plays_like_a_new_one(name: str, policy: str) -> None:
    env = raw_env(name)
    first = episode(env, policy, 1)
    episode(env, policy, 2)
    assert episode(env, policy, 1) == first
    # A fresh pair that goes on without a seed goes on alike.
    other = raw_env(name)
    for one in (env, other):
        one.reset(seed=9)
        one.reset()
    assert episode(env, policy, 5, reset=False) == episode(other, policy, 5, reset=False)


@pytest.mark.parametrize("name", slow_but(scenario_names(), "fictitious"))
def test_seeds_differ(name: str) -> None:
    env = raw_env(name)
    assert len({episode(env, "random", seed) for seed in range(5)}) == 5


def test_the_seed_moves_the_camera_and_not_only_the_policy() -> None:
    """With the same actions, the pictures of two seeds differ, and nothing that is not drawn does."""
    env = raw_env("wurtz_dodecane")
    labs, pictures, hidden = env.laboratories, [], []
    for seed in (0, 0, 1):
        env.reset(seed=seed)
        env.step(labs.actions.encode("start", "ext_0", 0, "dodecane"))
        env.step(labs.actions.encode("wait"))
        for meaning in ("add water to EV, 0.2 L", "mix EV, 6 clock", "settle, 0.5 clock"):
            env.step(labs.benches[1].action_meanings.index(meaning))
        pictures.append(env.observe("ext_0").tobytes())
        hidden.append(labs.shelf.vessels.tobytes())
    assert pictures[0] == pictures[1] != pictures[2]
    assert hidden[0] == hidden[1] == hidden[2]


def play(labs: Laboratories, rng: np.random.Generator, turns: int) -> list[tuple[int, Any]]:
    """Play random legal actions; what was played."""
    played: list[tuple[int, Any]] = []
    for _ in range(turns):
        if labs.state.status[0] != 0:
            break
        number = labs.turn()
        mask = labs.mask(number, labs.members)
        if mask is None:
            action: Any = rng.random((1, *labs.action_space(number).shape))  # type: ignore[misc]
        else:
            legal = [a for a in np.flatnonzero(mask[0]) if number or labs.actions.decode(int(a))[0] != "submit"]
            action = np.array([rng.choice(legal)])
        played.append((number, action))
        labs.act(number, labs.members, action)
    return played


def replay(labs: Laboratories, played: list[tuple[int, Any]]) -> str:
    """Digest of playing recorded actions again."""
    digest = Digest()
    for number, action in played:
        assert labs.turn() == number
        mask = labs.mask(number, labs.members)
        for agent in range(len(labs.agents)):
            digest.add(labs.observe(agent, labs.members))
        digest.add(mask)
        labs.act(number, labs.members, action)
        digest.add(labs.rewards, labs.cost, labs.scores, labs.state.status, labs.costs())
    return str(digest)


@pytest.mark.parametrize("name", EVERY_SCENARIO)
def test_a_restored_laboratory_goes_on_as_it_did(name: str) -> None:
    labs = Laboratories(name)
    labs.seed(0, 6)
    labs.reset(labs.members)
    rng = np.random.default_rng(6)
    play(labs, rng, 40)
    assert labs.state.status[0] == 0
    middle = labs.snapshot()
    played = play(labs, rng, 200)
    assert len(played) > (3 if name == "recrystallization" else 40)  # there, random managers soon submit
    end = labs.snapshot()
    labs.restore(middle)
    once = replay(labs, played)
    for array, was in zip(labs.snapshot(), end, strict=True):
        np.testing.assert_array_equal(array, was)
    # Nor does it matter what has happened in between, or in which object the snapshot is put.
    labs.seed(0, 77)
    labs.reset(labs.members)
    play(labs, rng, 30)
    labs.restore(middle)
    assert replay(labs, played) == once
    other = Laboratories(name)
    other.restore(middle)
    assert replay(other, played) == once


if __name__ == "__main__":
    print(json.dumps(digests(sys.argv[1:])))
