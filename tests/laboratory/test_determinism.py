"""The same seed is the same episode: in another process, after a restore, in the next episode of the same environment.

Run as a script, this file prints the digests of its episodes, which is how the test asks another process for them.
"""

import copy
import itertools
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, digest, random_legal, record_episode, refused

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.role_env import RoleEnv
from chemlab.lab.engine import Laboratories


def digests(names: Iterable[str]) -> dict[str, str]:
    """Of records of a careless and a scripted episode of scenarios: what was seen, played and paid, and all that is."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (policy, seed) in itertools.product(names, (("careless", 3), ("scripted", 4))):
            path = record_episode(Path(folder) / "episode.jsonl", name, policy, seed)
            turns = path.read_bytes().splitlines()[1:]  # the first line names the machine
            found[f"{name} {policy}"] = digest(turns)
    return found


@pytest.mark.slow
def test_another_process_plays_the_same_episodes() -> None:
    here = digests(FEATURED)
    # Another hash seed shuffles sets of strings: an order that comes from one would show.
    environment = dict(os.environ, PYTHONHASHSEED="271828", PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    words = [sys.executable, __file__, *FEATURED]
    run = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == here
    assert all(here[f"{name} careless"] != here[f"{name} scripted"] for name in FEATURED)


def test_the_seed_moves_the_camera_and_not_only_the_policy() -> None:
    """With the same actions, the pictures of two seeds differ, and nothing that is not drawn does."""
    env = raw_env("wurtz_dodecane")
    labs, pictures, hidden = env.laboratories, [], []
    for seed in (0, 0, 1):
        env.reset(seed=seed)
        env.step(labs.actions.encode("start", "ext_0", 0, "dodecane"))
        env.step(labs.actions.encode("wait"))
        for one in ("add water to EV, 0.2 L", "mix EV, 6 units of settling time", "settle, 0.5 units of settling time"):
            env.step(labs.benches[1].action_meanings.index(one))
        pictures.append(env.observe("ext_0").tobytes())
        hidden.append(labs.shelf.vessels.tobytes())
    assert pictures[0] == pictures[1] != pictures[2]
    assert hidden[0] == hidden[1] == hidden[2]


EPISODES = 4
WORLDLY = ("wurtz_any", "alike")
"""Scenarios whose goals and, in the second, whose hidden parameters are drawn."""


def drawn_scenario(name: str) -> Scenario:
    """A scenario that draws goals, and worlds where asked to, and whose episodes are short."""
    vessel = {"capacity_l": 1.2, "contents": {"diethyl_ether": 4.0, "1-chlorohexane": 1.0}}
    draw = {
        "what": "amount",
        "of": ["slot_0"],
        "material": "1-chlorohexane",
        "distribution": {"kind": "uniform", "low": 0.5, "high": 1.0},
    }
    worldly = {"shelf": {"slots": 8, "vessel": [vessel] * 3}, "world": {"draws": {"feed": draw}}}
    more = worldly if name == "alike" else {}
    limits = {"limits": {"manager_actions": 12, "ticks": 40, "budget": 10.0}}
    return load_scenario({"base": "wurtz_any", "name": name, "title": name, "summary": name, **limits, **more})


def beginning(labs: Any, member: int, *shown: Any) -> str:
    """Digest of all that an episode begins with: vessels, goals, orders, world, and every random stream."""
    world = labs.worlds.table.arrays.values[member] if labs.worlds.active else None
    if isinstance(labs, Laboratories):
        own = [labs.state.goal, labs.state.terms, labs.state.stream, *(one.stream for one in labs.experiments)]
    else:
        own = [labs.experiments.goal, labs.experiments.stream, labs.start_stream]
    return digest(*shown, labs.shelf.vessels[member], world, [array[member] for array in own])


def hasty_manager(mask: npt.NDArray[Any], labs: Laboratories, rng: np.random.Generator) -> int:
    """Submits what stands in the first slot at once."""
    return labs.actions.encode("submit", 0)


def busy_manager(mask: npt.NDArray[Any], labs: Laboratories, rng: np.random.Generator) -> int:
    """Measures, which draws instrument noise, and starts experiments, which draw the camera's, up to a limit."""
    legal = [int(a) for a in np.flatnonzero(mask) if labs.actions.decode(int(a))[0] != "submit"]
    return int(rng.choice(legal))


@pytest.mark.parametrize("name", WORLDLY)
def test_later_episodes_are_the_same_whatever_was_played_before(name: str) -> None:
    """For any two managers in AEC, with which tests of every other interface compare their later episodes."""
    spec, found = drawn_scenario(name), []
    for manager in (hasty_manager, busy_manager):
        env, rng = raw_env(spec), np.random.default_rng(1)
        labs = env.laboratories
        for i in range(EPISODES):
            env.reset(seed=5 if i == 0 else None)
            found.append(beginning(labs, 0))
            while not env.terminations["manager_0"]:
                number = labs.turn()
                mask, space = labs.mask(number, labs.members), labs.action_space(number)
                legal = None if mask is None else mask[0]
                env.step(random_legal(space, legal, rng) if number or legal is None else manager(legal, labs, rng))
    assert found[:EPISODES] == found[EPISODES:]
    assert len(set(found)) == EPISODES  # and no two are the same
    # A whole series can be put back in the middle of it, and goes on alike in a copy.
    other = Laboratories(spec)
    other.restore(labs.snapshot())
    copied = pickle.loads(pickle.dumps(labs)) if name == "wurtz_any" else copy.deepcopy(labs)
    nexts = []
    for each in (labs, other, copied):
        each.reset(each.members)
        nexts.append(beginning(each, 0))
    assert len(set(nexts)) == 1


@pytest.mark.parametrize("bench", ["rxn", "ext"])
def test_later_experiments_are_the_same_whatever_was_played_before(bench: str) -> None:
    """On single benches, too: goal, starting vessel and first picture, for who ends at once and who does not."""
    spec, found, rng = drawn_scenario("alike"), [], np.random.default_rng(2)
    for short in (True, False):
        env = RoleEnv(spec, bench=bench)
        for i in range(EPISODES):
            seen, _ = env.reset(seed=7 if i == 0 else None)
            found.append(beginning(env.batch, 0, seen))
            for _ in range(3 if short else 6):
                if env.episodes.pending[0]:
                    break
                if not env.bench.action_count:
                    env.step(rng.random(env.action_space.shape))  # type: ignore[arg-type]
                else:
                    env.step(env.bench.end_action if short else int(rng.integers(env.bench.end_action)))
    assert found[:EPISODES] == found[EPISODES:]
    assert len(set(found)) == EPISODES


def test_the_first_episode_of_a_seed_does_not_know_of_series() -> None:
    """What is published was played in first episodes: their streams are the seed's own words."""
    labs = Laboratories(drawn_scenario("alike"), 2)
    for member, seed in enumerate((3, 4)):
        labs.seed(member, seed)
    words = [np.random.SeedSequence(seed).generate_state(1 + len(labs.experiments), np.uint64) for seed in (3, 4)]
    for k, experiments in enumerate(labs.experiments):
        assert experiments.stream[:, 0].tolist() == [int(own[1 + k]) for own in words]
    labs.reset(labs.members)
    for k, experiments in enumerate(labs.experiments):
        assert experiments.stream[:, 0].tolist() == [int(own[1 + k]) for own in words]
    # One number for each order's goal has been taken from the manager's stream: SplitMix64 counts in this step.
    step = 0x9E3779B97F4A7C15
    expected = [(int(own[0]) + labs.scenario.orders * step) % 2**64 for own in words]
    assert labs.state.stream[:, 0].tolist() == expected
    refused("nope", labs.reset, labs.members, world={"nope": 1.0})
    assert labs.state.stream[:, 0].tolist() == expected  # refused: the second episode is still to come
    assert labs.episodes.begun.tolist() == [1, 1]


if __name__ == "__main__":
    print(json.dumps(digests(sys.argv[1:])))
