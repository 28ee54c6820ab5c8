"""The parallel environment against the AEC environment: the same actions are the same laboratory, round by round.

The AEC environment is the reference; a round is one manager action, or one tick.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from helpers import FEATURED, assert_plays_rounds, lasting

from chemlab.laboratory import parallel_env

WURTZ = "wurtz_dodecane"


class Parallel:
    """The parallel environment beside AEC's rounds; whoever has no turn says what nobody could take for an action, and
    what was handed out is written into."""

    autoreset, whole = False, True

    def __init__(self, name: str) -> None:
        self.env, self.rng = parallel_env(name), np.random.default_rng(0)
        self.given: list[Any] = []

    def reset(self, seed: int | None = None, which: Any = None) -> list[dict[str, Any]]:
        return self.shown(self.env.reset(seed=seed))

    def step(self, actions: list[dict[str, Any]]) -> list[dict[str, Any]]:
        things = [None, -1, 10**9, "wait", float("nan"), np.full(3, np.nan), object(), [], {}]
        noise = {agent: things[self.rng.integers(9)] for agent in self.env.agents if self.rng.random() < 0.7}
        for array in self.given:
            array[:] = 9
        found = self.env.step({**noise, **actions[0]})
        assert self.env.agents == ([] if any(found[2].values()) else self.env.possible_agents)
        return self.shown(found)

    def shown(self, found: Any) -> list[dict[str, Any]]:
        seen, *rest, infos = found
        self.given = [*seen.values(), *(info["action_mask"] for info in infos.values() if "action_mask" in info)]
        own = dict(zip(("rewards", "terminated", "truncated"), rest, strict=False))
        assert all(ends.keys() == seen.keys() == infos.keys() for ends in rest)
        own |= {"observations": seen, "infos": infos, "state": self.env.state()}
        return [{**own, "arrays": lasting(self.env.laboratories)}]


# -- the same laboratory --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["crude", "failing", "refine"])
def test_one_script_is_one_episode(name: str) -> None:
    """Rewards, costs, scores, infos, observations, masks and the whole state, after every round."""
    assert assert_plays_rounds(Parallel(name), name, 1, 400, submit=0.02) > 0


# -- masks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FEATURED)
def test_who_has_no_turn_has_one_action(name: str) -> None:
    """Without the turn the mask allows ``wait`` or ``end`` alone; playing by masks alone loses no turn by it."""
    env = parallel_env(name)
    labs = env.laboratories
    observations, infos = env.reset(seed=0)
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(i)
    waited = 0
    while env.agents:
        for number, agent in enumerate(env.possible_agents):
            space = env.action_space(agent)
            assert env.observation_space(agent).contains(observations[agent])
            if not isinstance(space, gymnasium.spaces.Discrete):
                assert "action_mask" not in infos[agent]
                continue
            mask = infos[agent]["action_mask"]
            assert mask.dtype == np.int8
            assert mask.shape == (space.n,)
            if infos[agent]["has_turn"]:
                legal = labs.mask(number, labs.members)
                assert legal is not None
                np.testing.assert_array_equal(mask, legal[0])
            else:
                only = labs.actions.encode("wait") if number == 0 else labs.benches[number - 1].end_action
                assert np.flatnonzero(mask).tolist() == [only]
                waited += number == 0
        actions = {
            agent: env.action_space(agent).sample(infos[agent]["action_mask"])
            if "action_mask" in infos[agent]
            else env.action_space(agent).sample()
            for agent in env.agents
        }
        last = infos
        observations, _, _, _, infos = env.step(actions)
        # Whoever played within its mask has lost a turn only if a bottle was emptied by another in the same tick.
        lost = [agent for agent in env.possible_agents if infos[agent]["illegal_action"]]
        assert all(last[agent]["has_turn"] for agent in lost)
        assert "manager_0" not in lost
        first = next((agent for agent in env.possible_agents if last[agent]["has_turn"]), None)
        assert first not in lost
    assert waited > 0 or labs.state.ticks[0] == 0


# -- actions that are none ------------------------------------------------------------------------------------------


def two_busy(name: str = WURTZ) -> tuple[parallel_env, dict[str, Any]]:
    """A laboratory in which reaction and extraction have the turn, and actions for both."""
    env = parallel_env(name)
    actions = env.laboratories.actions
    env.reset(seed=0)
    env.step({"manager_0": actions.encode("start", "rxn_0", 0, "dodecane")})
    env.step({"manager_0": actions.encode("start", "ext_0", 1, "dodecane")})
    *_, infos = env.step({"manager_0": actions.encode("wait")})
    assert [agent for agent in env.agents if infos[agent]["has_turn"]] == ["rxn_0", "ext_0"]
    return env, {"rxn_0": np.full(6, 0.5), "ext_0": 3}


@pytest.mark.parametrize("missing", ["rxn_0", "ext_0"])
def test_a_missing_action_is_asked_for(missing: str) -> None:
    env, actions = two_busy()
    before = env.laboratories.snapshot()
    del actions[missing]
    with pytest.raises(ValueError, match=f"{missing}: has the turn"):
        env.step(actions)
    with pytest.raises(ValueError, match="rxn_0: has the turn"):
        env.step({})
    for was, now in zip(before, env.laboratories.snapshot(), strict=True):
        np.testing.assert_array_equal(now, was)


# -- the interface --------------------------------------------------------------------------------------------------


def test_a_step_without_an_episode_is_refused() -> None:
    env = parallel_env(WURTZ)
    with pytest.raises(ValueError, match="reset"):
        env.step({"manager_0": 0})
    env.reset(seed=0)
    env.step({"manager_0": env.laboratories.actions.encode("submit", 0)})
    assert env.agents == []
    with pytest.raises(ValueError, match="reset"):
        env.step({"manager_0": 0})
    env.reset()
    assert env.agents == env.possible_agents


def test_the_registry_knows_it() -> None:
    pettingzoo = pytest.importorskip("pettingzoo", minversion="1.27")
    env = pettingzoo.make("parallel", "chemlab/Laboratory-v1", scenario="wurtz_dodecane_direct")
    assert env.possible_agents == ["manager_0", "rxn_0", "dit_0"]
    _, infos = env.reset(seed=0)
    assert infos["manager_0"]["has_turn"]
