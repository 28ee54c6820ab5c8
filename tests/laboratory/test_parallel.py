"""The parallel environment against the AEC environment: the same actions are the same laboratory, round by round.

The AEC environment is the reference; a round is one manager action, or one tick.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import assert_plays_rounds, lasting

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
