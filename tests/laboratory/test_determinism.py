"""The same seed is the same episode: in another process, after a restore, in the next episode of the same environment.

Run as a script, this file prints the digests of its episodes, which is how the test asks another process for them.
"""

from __future__ import annotations

import copy
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.vector import AutoresetMode
from helpers import FEATURED, digest

from chemlab.agents.background import role_vector_env
from chemlab.agents.policies import make_policies
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.parallel import parallel_env
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories


def episode(env: raw_env, policy: str, seed: int, reset: bool = True) -> str:
    """Digest of every observation, reward, mask, flag and info of one episode, of all agents at every turn."""
    policies = make_policies(policy, env.laboratories, seed=seed)
    if reset:
        env.reset(seed=seed)
    found, labs = list[Any](), env.laboratories
    while True:
        agent = env.agent_selection
        shown = env.rewards, env.terminations, env.truncations, env.infos
        found.append(digest(agent, shown, *map(env.observe, env.agents)))
        if labs.state.status[0] != 0:
            return digest(found)
        number = env.possible_agents.index(agent)
        mask = env.infos[agent].get("action_mask")
        step = (labs.state.actions if number == 0 else labs.experiments[number - 1].steps)[:1]
        # Without submissions random episodes are long; the random manager has only that one way to end early.
        if mask is not None and number == 0 and policy == "random":
            mask = np.array([m and labs.actions.decode(a)[0] != "submit" for a, m in enumerate(mask)], dtype=np.int8)
        action = policies[agent].act(
            env.observe(agent)[None], None if mask is None else mask[None], step, labs.members
        )[0]
        found.append(digest(np.asarray(action)))
        env.step(action)


def digests(names: Iterable[str]) -> dict[str, str]:
    """Of a random and a scripted episode of scenarios."""
    return {
        f"{name} {policy}": episode(raw_env(name), policy, seed)
        for name in names
        for policy, seed in (("random", 3), ("scripted", 4))
    }


def test_another_process_plays_the_same_episodes() -> None:
    here = digests(FEATURED)
    # Another hash seed shuffles sets of strings: an order that comes from one would show.
    environment = dict(os.environ, PYTHONHASHSEED="271828", PYTHONPATH=os.pathsep.join(p for p in sys.path if p))
    run = subprocess.run(
        [sys.executable, str(Path(__file__)), *FEATURED],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout) == here
    assert all(here[f"{name} random"] != here[f"{name} scripted"] for name in FEATURED)


@pytest.mark.parametrize("policy", ["random", "scripted"])
@pytest.mark.parametrize("name", ["failing", "wurtz_two_lines"])
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


# -- series of episodes ---------------------------------------------------------------------------------------------

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


MANAGERS = {"scripted:unsafe": hasty_manager, "busy": busy_manager}


def focal_beginnings(name: str, agent: str, style: str, mode: AutoresetMode, members: int) -> list[list[str]]:
    """[members][EPISODES] beginnings of a batch's episodes for an agent, the others being random policies."""
    env = role_vector_env(members, drawn_scenario(name), agent, background="random", autoreset_mode=mode)
    labs, rng = env.laboratories, np.random.default_rng(0)
    seen, infos = env.reset(seed=5)
    found = [[beginning(labs, m, seen[m])] for m in range(members)]
    waiting = np.zeros(members, dtype=np.bool_)
    while min(map(len, found)) < EPISODES:
        if agent == "manager_0":
            actions = np.array([MANAGERS[style](infos["action_mask"][m], labs, rng) for m in range(members)])
        else:
            shape = (members, *labs.action_space(env.focal).shape)  # type: ignore[misc]
            actions = np.full(shape, 0.5) if style == "scripted:unsafe" else rng.random(shape)
        seen, _, terminated, truncated, infos = env.step(actions)
        assert not truncated.any()
        begun = {AutoresetMode.NEXT_STEP: waiting, AutoresetMode.SAME_STEP: terminated}.get(mode, terminated)
        if mode is AutoresetMode.DISABLED and terminated.any():
            seen, infos = env.reset(options={"reset_mask": terminated})
        for m in np.flatnonzero(begun):
            found[m].append(beginning(labs, m, seen[m]))
        waiting = terminated
    return [own[:EPISODES] for own in found]


@pytest.mark.parametrize(
    ("name", "agent", "mode"),
    [
        ("wurtz_any", "manager_0", AutoresetMode.NEXT_STEP),
        ("alike", "manager_0", AutoresetMode.SAME_STEP),
        ("wurtz_any", "rxn_0", AutoresetMode.DISABLED),
    ],
)
def test_later_episodes_are_the_same_whatever_was_played_before(name: str, agent: str, mode: AutoresetMode) -> None:
    """The k-th episode of a slot begins with the same vessels, goals, orders, world and noise for any two policies.

    A bench's random manager plays whole episodes without it, which others stand in for.
    """
    hasty, busy = (focal_beginnings(name, agent, style, mode, 3) for style in MANAGERS)
    assert hasty == busy
    assert len({one for own in hasty for one in own}) == 3 * EPISODES  # and no two are the same
    assert focal_beginnings(name, agent, "busy", mode, 1) == busy[:1]  # nor does it depend on the batch


@pytest.mark.parametrize("name", WORLDLY)
def test_single_laboratories_and_batches_go_through_the_same_series(name: str) -> None:
    """AEC, parallel and batched laboratories without autoreset: reset() without a seed goes on to the next episode."""
    spec = drawn_scenario(name)
    found = []
    for manager in MANAGERS:
        rng = np.random.default_rng(1)
        aec, rounds = raw_env(spec), parallel_env(spec)
        batches = [BatchedLaboratory(1, spec, autoreset=autoreset) for autoreset in (True, False)]
        for i in range(EPISODES):
            aec.reset(seed=5 if i == 0 else None)
            found.append([beginning(aec.laboratories, 0)])
            while aec.agents and not aec.terminations["manager_0"]:
                aec.step(_chosen(manager, aec.laboratories, aec.laboratories.turn(), rng))
            rounds.reset(seed=5 if i == 0 else None)
            found[-1].append(beginning(rounds.laboratories, 0))
            while rounds.agents:
                rounds.step(_round(manager, rounds.laboratories, rng, single=True))
            for batch in batches:
                if i == 0:
                    batch.reset(seed=[5])
                elif not batch.autoreset:
                    batch.reset(options={"reset_mask": np.ones(1, dtype=np.bool_)})
                found[-1].append(beginning(batch.laboratories, 0))
                over = np.zeros(1, dtype=np.bool_)
                while not over[0]:
                    _, _, over, _, _ = batch.step(_round(manager, batch.laboratories, rng, single=False))
    assert all(len(set(own)) == 1 for own in found)
    assert found[:EPISODES] == found[EPISODES:]
    assert len({own[0] for own in found}) == EPISODES
    # A whole series can be put back in the middle of it, and goes on alike in a copy.
    snapshot = aec.laboratories.snapshot()
    other = Laboratories(spec)
    other.restore(snapshot)
    copied = pickle.loads(pickle.dumps(aec.laboratories)) if name == "wurtz_any" else copy.deepcopy(aec.laboratories)
    nexts = []
    for labs in (aec.laboratories, other, copied):
        labs.reset(labs.members)
        nexts.append(beginning(labs, 0))
    assert len(set(nexts)) == 1


def _chosen(manager: str, labs: Laboratories, number: int, rng: np.random.Generator) -> Any:
    """An action of whoever has the turn."""
    mask = labs.mask(number, labs.members)
    if number == 0:
        assert mask is not None
        return MANAGERS[manager](mask[0], labs, rng)
    return rng.random(labs.action_space(number).shape) if mask is None else int(rng.choice(np.flatnonzero(mask[0])))  # type: ignore[arg-type]


def _round(manager: str, labs: Laboratories, rng: np.random.Generator, single: bool) -> dict[str, Any]:
    """Actions of all who have the turn, of one laboratory."""
    actions = {
        labs.agents[n]: _chosen(manager, labs, int(n), rng) for n in np.flatnonzero(labs.turns(labs.members)[:, 0])
    }
    return actions if single else {agent: np.asarray(action)[None] for agent, action in actions.items()}


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("bench", ["rxn", "ext"])
def test_later_experiments_are_the_same_whatever_was_played_before(bench: str, mode: AutoresetMode) -> None:
    """On single benches, too: goal, starting vessel and first picture, for who ends at once and who does not."""
    spec, found = drawn_scenario("alike"), []
    for short in (True, False):
        rng = np.random.default_rng(2)
        env = RoleVectorEnv(2, spec, bench=bench, autoreset_mode=mode, threads=2)
        single = RoleEnv(spec, bench=bench)
        seen, _ = env.reset(seed=[7, 8])
        own = [beginning(env.batch, 0, seen[0])]
        alone = []
        waiting = np.zeros(2, dtype=np.bool_)
        while len(own) < EPISODES:
            actions = [_step(single, short, rng) for _ in range(2)]
            seen, _, terminated, _, _ = env.step(np.array(actions))
            if mode is AutoresetMode.DISABLED and terminated.any():
                seen, _ = env.reset(options={"reset_mask": terminated})
            if (waiting if mode is AutoresetMode.NEXT_STEP else terminated)[0]:
                own.append(beginning(env.batch, 0, seen[0]))
            waiting = terminated
        for i in range(EPISODES):
            seen, _ = single.reset(seed=7 if i == 0 else None)
            alone.append(beginning(single.batch, 0, seen))
            for _ in range(3 if short else 6):
                if single.episodes.pending[0]:
                    break
                single.step(_step(single, short, rng))
        env.close()
        found += [own, alone]
    assert all(own == found[0] for own in found)
    assert len(set(found[0])) == EPISODES


def _step(env: RoleEnv, short: bool, rng: np.random.Generator) -> Any:
    """An action that ends the experiment, where there is one and it is to be ``short``; else any that does not."""
    if not env.bench.action_count:
        return rng.random(env.action_space.shape)  # type: ignore[arg-type]
    return env.bench.end_action if short else int(rng.integers(env.bench.end_action))


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
    with pytest.raises(ValueError, match="nope"):
        labs.reset(labs.members, world={"nope": 1.0})
    assert labs.state.stream[:, 0].tolist() == expected  # refused: the second episode is still to come
    assert labs.episodes.begun.tolist() == [1, 1]


if __name__ == "__main__":
    print(json.dumps(digests(sys.argv[1:])))
