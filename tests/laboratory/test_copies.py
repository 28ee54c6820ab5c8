"""Copies, pickles and states of every environment class go on alike in the middle of an episode."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import digest, random_legal
from test_interrupts import ENVIRONMENTS, SEED, STEPS, Played, aec, for_one, results_of

from chemlab.agents.background import role_env
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.laboratory import env as ordered_env

HOW = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


def alone(scenario: str, bench: str) -> Callable[..., Played]:
    """A bench alone, at random: in a world that is drawn, with wear; with crystals."""

    def make(env: Any = None) -> Played:
        env = env or RoleVectorEnv(3, scenario, bench=bench, threads=2)

        def act(k: int) -> Any:
            masks = env.action_masks() if env.action_count else [None] * env.num_envs
            rng = np.random.default_rng(k)
            return np.array([random_legal(env.single_action_space, mask, rng) for mask in masks])

        return for_one(env, act)

    return make


def among_others(env: Any = None) -> Played:
    """A bench's agent in a laboratory in which a random manager plays."""
    env = env or role_env("failing", "east_0", "random")
    return for_one(env, lambda k: random_legal(env.action_space, None, np.random.default_rng(k)))


def rllib(env: Any = None) -> Played:
    """RLlib's environment, in which the manager learns."""
    pytest.importorskip("ray.rllib")
    from chemlab.agents.rllib import LaboratoryMultiAgentEnv

    env = env or LaboratoryMultiAgentEnv({"roles": ["manager"], "background": "random", "scenario": "failing"})

    def reset() -> Any:
        env.told = env.reset(seed=SEED)[0]
        return env.told

    def step(k: int) -> Any:
        ((agent, own),) = env.told.items()
        action = random_legal(env.action_spaces[agent], own["action_mask"], np.random.default_rng(k))
        results = env.step({agent: action})
        env.told = env.reset()[0] if results[2]["__all__"] else results[0]
        return (*results, env.laboratory.state())

    return Played(env, reset, step, list)


KINDS: dict[str, Callable[..., Played]] = {
    **ENVIRONMENTS,
    "ordered": lambda env=None: aec(env or ordered_env("wurtz_dodecane")),
    "failing": alone("failing", "east"),
    "recrystallization": alone("recrystallization", "cry"),
    "among others": among_others,
    "rllib": rllib,
}


@pytest.mark.parametrize("kind", KINDS)
@np.errstate(all="raise")  # nothing here may fail by it, as in test_batch.py
def test_copies_play_on_alike(kind: str) -> None:
    make = KINDS[kind]
    played = make()
    played.reset()
    for k in range(4):
        played.step(k)
    copies = {name: make(how(played.env)) for name, how in HOW.items()}
    state = played.env.get_state() if hasattr(played.env, "get_state") else None
    expected = [digest(played.step(k)) for k in range(4, STEPS)]
    for name, other in copies.items():
        assert results_of(other, 4) == expected, name
    if state is not None:
        for each in (played, copies["pickle"]):
            each.env.set_state(state)
            assert results_of(each, 4) == expected
    for each in (played, *copies.values()):
        getattr(each.env, "close", lambda: None)()
