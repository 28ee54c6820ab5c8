"""Copies and pickles of every environment class, in the middle of an episode; NumPy set to raise."""

from __future__ import annotations

import copy
import importlib
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from helpers import FEATURED, digest, random_legal

from chemlab.agents.background import role_env, role_vector_env
from chemlab.config.loading import load_scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.laboratory import env as ordered_env
from chemlab.laboratory import parallel_env, raw_env

ONE_LEARNS = {"roles": ["manager"], "background": "random"}
HOW = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


def turns(env: Any, steps: int, rng: np.random.Generator) -> Any:
    """Play an AEC environment; what agents saw, earned and were told."""
    found = []
    for _ in range(steps):
        if not env.agents:
            env.reset()
        seen, reward, terminated, truncated, info = env.last()
        agent = env.agent_selection
        over = terminated or truncated
        env.step(None if over else random_legal(env.action_space(agent), info.get("action_mask"), rng))
        found.append((seen, reward, terminated, truncated, info, env.state()))
    return found


def rounds(env: Any, steps: int, rng: np.random.Generator) -> Any:
    """Play a parallel environment, one laboratory or several."""
    found, several = [], isinstance(env, BatchedLaboratory)
    infos = env.reset(seed=3)[1] if not hasattr(env, "told") else env.told
    for _ in range(steps):
        if not several and not env.agents:
            infos = env.reset()[1]
        actions = {}
        for agent, info in infos.items():
            space, mask = env.action_space(agent), info.get("action_mask")
            if several:
                members = range(env.num_envs)
                actions[agent] = np.array(
                    [random_legal(space, None if mask is None else mask[i], rng) for i in members]
                )
            else:
                actions[agent] = random_legal(space, mask, rng)
        results = env.step(actions)
        infos = env.told = results[-1]
        found.append((*results, env.state()))
    return found


def singly(env: Any, steps: int, rng: np.random.Generator) -> Any:
    """Play a Gymnasium environment."""
    found, over = [], getattr(env, "over", True)
    for _ in range(steps):
        if over:
            found.append(env.reset(seed=None if hasattr(env, "over") else 3))
        mask = env.action_masks() if isinstance(env.action_space, gymnasium.spaces.Discrete) else None
        results = env.step(random_legal(env.action_space, mask, rng))
        found.append(results)
        over = env.over = results[2] or results[3]
    return found


def together(env: Any, steps: int, rng: np.random.Generator) -> Any:
    """Play a batch of Gymnasium's."""
    found: list[Any] = []
    if not env._begun:
        env.reset(seed=3)
    space = env.single_action_space
    for _ in range(steps):
        masks = env.action_masks() if env.action_count else [None] * env.num_envs
        found.append(env.step(np.array([random_legal(space, mask, rng) for mask in masks])))
    return found


def with_sb3(env: Any, steps: int, rng: np.random.Generator) -> Any:
    """Play a batch of Stable-Baselines3's; infos are left out, which tell the time."""
    found: list[Any] = []
    if not hasattr(env, "told"):
        env.seed(3)
        env.told = env.reset()
    for _ in range(steps):
        masks = env.batch.action_masks() if env.batch.action_count else [None] * env.num_envs
        found.append(env.step(np.array([random_legal(env.action_space, mask, rng) for mask in masks]))[:3])
    return found


def with_rllib(env: Any, steps: int, rng: np.random.Generator) -> Any:
    """Play RLlib's environment, in which one agent with discrete actions learns."""
    found, seen = [], env.told if hasattr(env, "told") else env.reset(seed=3)[0]
    for _ in range(steps):
        ((agent, own),) = seen.items()
        results = env.step({agent: random_legal(env.action_spaces[agent], own["action_mask"], rng)})
        found.append((*results, env.laboratory.state()))
        seen = env.told = env.reset()[0] if results[2]["__all__"] else results[0]
    return found


def benches(make: Callable[..., Any], scenario: str, **arguments: Any) -> list[Any]:
    """An environment of every bench of a scenario."""
    return [make(scenario=scenario, bench=key, **arguments) for key in load_scenario(scenario).benches]


def benches_of(name: str) -> list[str]:
    """The agents of a scenario's benches."""
    return load_scenario(name).bench_agents()


def optional(package: str, module: str) -> Any:
    """A module of agents/ that needs a package."""
    pytest.importorskip(package)
    return importlib.import_module(f"chemlab.agents.{module}")


CLASSES: dict[str, tuple[Callable[[str], list[Any]], Callable[..., list[Any]]]] = {
    "raw_env": (lambda name: [raw_env(name)], turns),
    "env": (lambda name: [ordered_env(name)], turns),
    "parallel_env": (lambda name: [parallel_env(name)], rounds),
    "BatchedLaboratory": (lambda name: [BatchedLaboratory(2, name)], rounds),
    "RoleEnv, bench": (lambda name: benches(RoleEnv, name), singly),
    "RoleVectorEnv, bench": (lambda name: benches(RoleVectorEnv, name, num_envs=3, threads=2), together),
    "RoleEnv": (lambda name: [role_env(name), role_env(name, benches_of(name)[0])], singly),
    "RoleVectorEnv": (
        lambda name: [role_vector_env(2, name), role_vector_env(2, name, benches_of(name)[0], "random")],
        together,
    ),
    "ChemlabVecEnv": (
        lambda name: benches(optional("stable_baselines3", "sb3").ChemlabVecEnv, name, env=2, threads=2),
        with_sb3,
    ),
    "LaboratoryMultiAgentEnv": (
        lambda name: [optional("ray.rllib", "rllib").LaboratoryMultiAgentEnv(ONE_LEARNS | {"scenario": name})],
        with_rllib,
    ),
}


def begun(kind: str, scenario: str) -> tuple[list[Any], Callable[..., list[Any]]]:
    """Environments of a class in the middle of an episode, and what plays them."""
    make, play = CLASSES[kind]
    envs = make(scenario)
    for env in envs:
        if play is turns:
            env.reset(seed=3)
        play(env, 12, np.random.default_rng(1))
    return envs, play


@pytest.mark.parametrize("kind", CLASSES)
@pytest.mark.parametrize("scenario", ["failing", "recrystallization"])
@np.errstate(all="raise")  # a common way to find a learner's NaN: nothing here may fail by it
def test_copies_play_on_alike(scenario: str, kind: str) -> None:
    envs, play = begun(kind, scenario)
    for env in envs:
        copies = {name: how(env) for name, how in HOW.items()}
        state = env.get_state() if hasattr(env, "get_state") else None
        expected = play(env, 12, np.random.default_rng(2))
        for name, other in copies.items():
            again = play(other, 12, np.random.default_rng(2))
            assert digest(again) == digest(expected), name
        if state is not None and hasattr(env, "_begun"):  # single environments' players remember where an episode ended
            for name, each in {"state": env, "state of another": copies["pickle"]}.items():
                each.set_state(state)
                assert digest(play(each, 12, np.random.default_rng(2))) == digest(expected), name
        for each in (env, *copies.values()):
            getattr(each, "close", lambda: None)()


@pytest.mark.parametrize("scenario", FEATURED)
@np.errstate(all="raise")
def test_numpy_may_be_set_to_raise(scenario: str) -> None:
    (env,), play = begun("BatchedLaboratory", scenario)
    play(env, 40, np.random.default_rng(4))
