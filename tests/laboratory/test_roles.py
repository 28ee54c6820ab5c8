"""Roles: everything about an agent is asked of its role, and its index has no meaning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.batch import BatchedLaboratory
from chemlab.lab.engine import Laboratories


def played(name: str, seed: int) -> list[tuple[Any, ...]]:
    """Everything that random agents meet in an episode, by name."""
    env, rng, found = raw_env(name), np.random.default_rng(seed), []
    env.reset(seed=seed)
    for agent in env.agent_iter():
        observation, reward, over, _, info = env.last()
        known = {key: np.asarray(value).tolist() for key, value in info.items()}
        rewards = {} if over else env.rewards  # once it is over, PettingZoo drops agents one by one
        found.append((agent, observation.tolist(), reward, over, known, sorted(rewards.items())))
        if over:
            env.step(None)
            continue
        mask, space = info.get("action_mask"), env.action_space(agent)
        legal = () if mask is None else np.flatnonzero(mask)
        env.step(rng.random(space.shape) if mask is None else int(rng.choice(legal)))
    return found


@pytest.mark.parametrize("name", ["wurtz_dodecane", "failing"])
def test_an_episode_does_not_depend_on_the_order_of_the_agents(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = played(name, 5)
    assert len({turn[0] for turn in usual}) > 2
    agents = Scenario.agents
    monkeypatch.setattr(Scenario, "agents", lambda self: agents(self)[::-1])
    assert Laboratories(name).agents[-1] == "manager_0"
    other = played(name, 5)
    running = [turn for turn in usual if not turn[3]]
    assert other[: len(running)] == running
    # Where the episode is over, agents are taken in the order of PettingZoo's list.
    assert sorted(other[len(running) :], key=str) == sorted(usual[len(running) :], key=str)


def test_a_batch_pays_each_role_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def sums() -> dict[str, list[float]]:
        batch = BatchedLaboratory(3, "wurtz_dodecane")
        _, infos = batch.reset(seed=2)
        found, rng = {agent: np.zeros(3) for agent in batch.possible_agents}, np.random.default_rng(0)
        for _ in range(80):
            drawn = {}
            for agent in sorted(batch.possible_agents):
                mask, shape = infos[agent].get("action_mask"), batch.action_space(agent).shape or ()
                legal = [] if mask is None else [rng.choice(np.flatnonzero(row)) for row in mask]
                drawn[agent] = rng.random((3, *shape)) if mask is None else np.array(legal)
            _, rewards, _, _, infos = batch.step(drawn)
            for agent, own in rewards.items():
                found[agent] += own
        return {agent: own.tolist() for agent, own in sorted(found.items())}

    usual, agents = sums(), Scenario.agents
    assert np.any(usual["manager_0"])
    assert sum(np.any(own) for own in usual.values()) > 1
    monkeypatch.setattr(Scenario, "agents", lambda self: [*agents(self)[2:], *agents(self)[:2]])
    assert sums() == usual
