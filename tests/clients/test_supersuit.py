"""SuperSuit's wrappers around the laboratory and its views.

What they cannot do here, and why:

- ``pad_action_space`` (hence ``pettingzoo_env_to_vec_env``, which makes one batch of all agents): where one role's
  actions are numbers and another's are choices. Where all are choices (``salt_from_oil``) both work.
- ``agent_indicator``, ``pettingzoo_env_to_vec_env``: without ``pad_observations``, as the roles see different things.
- ``clip_actions``, ``scale_actions``: with discrete roles.
- ``black_death``: it takes an episode for over when all agents are terminated *and* truncated, so it misses every end.
  It is not needed: nobody leaves the laboratory before the end.
- ``frame_skip``: it asks the parallel environment for ``np_random``, which is not in PettingZoo's interface, and plays
  the action of one agent for the next in AEC. A manager's action repeated is an illegal one anyway.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("supersuit", reason="SuperSuit is not installed: pip install supersuit")

import supersuit as ss
from helpers import random_legal, seeded
from pettingzoo.test import api_test, parallel_api_test

import chemlab  # noqa: F401 - registers the environments
from chemlab.laboratory import env as laboratory_env
from chemlab.laboratory import parallel_env

WURTZ, DISCRETE = "wurtz_dodecane", "salt_from_oil"
WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "frame_stack": lambda env: ss.frame_stack_v2(env, 3),
    "nan_noop": lambda env: ss.nan_noop_v0(env, 0),
    "clip_reward": lambda env: ss.clip_reward_v0(env, -0.1, 0.1),
}
"""One of observations, one of actions, one of rewards; :func:`homogeneous` makes one batch of all agents."""

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")


def legal(env: Any, agent: str, info: dict[str, Any], rng: np.random.Generator) -> Any:
    """A random legal action of an agent."""
    return random_legal(env.action_space(agent), info.get("action_mask"), rng)


def test_wrapped_laboratories_keep_to_pettingzoos_interface_and_masks_come_through() -> None:
    for wrapper, wrap in WRAPPERS.items():
        api_test(seeded(wrap(laboratory_env(WURTZ))), num_cycles=50)
        parallel_api_test(seeded(wrap(parallel_env(WURTZ))), num_cycles=50)
        rng = np.random.default_rng(0)
        env = wrap(laboratory_env(DISCRETE))
        env.reset(seed=3)
        for agent in env.agent_iter(60):
            _, _, terminated, truncated, info = env.last()
            if terminated or truncated:
                break
            np.testing.assert_array_equal(info["action_mask"], env.unwrapped.action_masks(), wrapper)
            env.step(legal(env, agent, info, rng))
        parallel = wrap(parallel_env(DISCRETE))
        _, infos = parallel.reset(seed=3)
        for _ in range(60):
            if not parallel.agents:
                break
            actions = {agent: legal(parallel, agent, infos[agent], rng) for agent in parallel.agents}
            _, _, _, _, infos = parallel.step(actions)
            assert not any(info["illegal_action"] for info in infos.values()), wrapper


def homogeneous(name: str) -> Any:
    """All agents with one observation space and one action space."""
    return ss.pad_action_space_v0(ss.pad_observations_v0(parallel_env(name)))


def test_one_batch_of_all_agents() -> None:
    """What each sees stands before the padding, whoever has the turn; a batch begins anew by itself."""
    batch, plain = ss.pettingzoo_env_to_vec_env_v1(homogeneous(DISCRETE)), parallel_env(DISCRETE)
    rng, agents = np.random.default_rng(0), plain.possible_agents
    (seen, infos), (expected, _) = batch.reset(seed=5), plain.reset(seed=5)
    while plain.agents:
        for i, agent in enumerate(agents):
            np.testing.assert_array_equal(seen[i], np.append(expected[agent], np.zeros(seen.shape[1]))[: seen.shape[1]])
        actions = [legal(plain, agent, infos[i], rng) for i, agent in enumerate(agents)]
        seen, rewards, _, _, infos = batch.step(np.array(actions))
        expected, earned, *_ = plain.step(dict(zip(agents, actions, strict=True)))
        np.testing.assert_allclose(rewards, list(earned.values()), rtol=1e-6)
    for i, agent in enumerate(agents):
        np.testing.assert_array_equal(infos[i]["terminal_observation"][: len(expected[agent])], expected[agent])
    assert infos[0]["action_mask"].any(), "the next episode has begun"
