"""The parallel environment against the AEC environment: the same actions are the same laboratory, round by round.

The AEC environment is the reference; a round is one manager action, or one tick.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED

from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import named_costs
from chemlab.laboratory import parallel_env
from chemlab.roles.manager_actions import SUBMIT, WAIT

WURTZ = "wurtz_dodecane"


def lasting(labs: Laboratories) -> list[npt.NDArray[Any]]:
    """Every array that changes, but what the last turn or round alone has earned."""
    state = labs.state
    per_turn = (state.rewards, state.cost, state.scores)
    return [array for array in labs.arrays() if not any(np.shares_memory(array, own) for own in per_turn)]


"""The last arrays of a snapshot: rewards, cost and scores of the last turn or round, and the safety totals."""


def choose(labs: Laboratories, number: int, member: int, rng: np.random.Generator, bold: float = 0.2) -> Any:
    """An action of one agent: legal, but with probability ``bold`` any of the space; seldom a submission."""
    mask = labs.mask(number, np.array([member]))
    if mask is None:
        numbers = rng.random(labs.action_space(number).shape)  # type: ignore[arg-type]
        return np.where(rng.random(numbers.shape) < 0.3, numbers.round(), numbers)
    legal = np.arange(mask.shape[1]) if rng.random() < bold else np.flatnonzero(mask[0])
    if number == 0:
        kinds = labs.actions.table[legal, 0]
        if WAIT in kinds and rng.random() < 0.3:
            return int(legal[-1])
        others = legal[kinds != SUBMIT]
        legal = others if len(others) and rng.random() < 0.95 else legal
    elif rng.random() < 0.8:
        legal = legal[legal != labs.benches[number - 1].end_action]
    return int(rng.choice(legal))


def garbage(rng: np.random.Generator) -> Any:
    """What nobody could take for an action."""
    things = [None, -1, 10**9, "wait", float("nan"), np.full(3, np.nan), object(), [], {}]
    return things[int(rng.integers(len(things)))]


def same(one: Any, other: Any) -> bool:
    """Equality of infos: dictionaries of numbers, names, dictionaries and arrays, bit for bit."""
    if isinstance(one, dict):
        return isinstance(other, dict) and one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    return bool(np.array_equal(one, other))


def a_round(
    env: raw_env, rng: np.random.Generator
) -> tuple[dict[str, Any], dict[str, float], dict[str, dict[str, Any]], dict[str, int]]:
    """Play one round of the AEC environment: (actions, rewards, infos of what was done, elapsed ticks at the turn)."""
    labs = env.laboratories
    before, managed = labs.state.ticks[0], env.agent_selection == "manager_0"
    actions: dict[str, Any] = {}
    elapsed: dict[str, int] = {}
    rewards = dict.fromkeys(env.possible_agents, 0.0)
    infos: dict[str, dict[str, Any]] = {
        agent: {
            "cost": 0.0,
            "events": np.zeros(len(env.scenario.safety_events)),
            "illegal_action": False,
            "experiment_over": False,
            "score": 0.0,
        }
        for agent in env.possible_agents
    }
    while True:
        agent = env.agent_selection
        assert agent not in actions, "nobody has two turns in a round"
        actions[agent] = choose(labs, env.possible_agents.index(agent), 0, rng)
        elapsed[agent] = env.infos[agent]["elapsed_ticks"]
        env.step(actions[agent])
        for name in env.possible_agents:
            rewards[name] += env.rewards[name]
        infos[agent].update({key: env.infos[agent][key] for key in ("cost", "events", "illegal_action")})
        for i in np.flatnonzero(np.isfinite(labs.scores[0])):
            infos[env.possible_agents[i]].update(experiment_over=True, score=float(labs.scores[0, i]))
        if labs.state.status[0] != 0:
            infos["manager_0"].update(experiment_over=True, score=float(labs.result(labs.members)[0]))
        if managed or labs.state.status[0] != 0 or labs.state.ticks[0] != before:
            return actions, rewards, infos, elapsed


# -- the same laboratory --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "seed"), [("crude", 0), ("failing", 1), ("refine", 2)])
def test_one_script_is_one_episode(name: str, seed: int) -> None:
    """Rewards, costs, scores, infos, observations, masks and the whole state, after every round."""
    aec, parallel = raw_env(name), parallel_env(name)
    rng = np.random.default_rng(seed)
    aec.reset(seed=seed)
    observations, infos = parallel.reset(seed=seed)
    ticks_seen = dict.fromkeys(aec.possible_agents, 0)
    rounds = 0
    while True:
        # The charges for stock and waste are worked out when somebody asks for them.
        assert named_costs(infos["manager_0"]) == aec.laboratories.costs()
        for one, other in zip(lasting(aec.laboratories), lasting(parallel.laboratories), strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(aec.laboratories.safety_totals, parallel.laboratories.safety_totals)
        for agent in aec.possible_agents:
            np.testing.assert_array_equal(observations[agent], aec.observe(agent))
        np.testing.assert_array_equal(parallel.state(), aec.state())
        over = aec.laboratories.state.status[0] != 0
        turn = [agent for agent in parallel.possible_agents if infos[agent]["has_turn"]]
        assert bool(turn) is not over
        if over:
            break
        assert turn[0] == aec.agent_selection
        assert same(infos[turn[0]].get("action_mask"), aec.infos[turn[0]].get("action_mask"))
        promised = {agent: infos[agent]["elapsed_ticks"] for agent in turn}
        actions, rewards, done, elapsed = a_round(aec, rng)
        assert list(actions) == turn
        assert elapsed == promised
        for agent in turn:
            ticks_seen[agent] += elapsed[agent]
        # The others may say what they like, or nothing.
        noise = {agent: garbage(rng) for agent in parallel.possible_agents if rng.random() < 0.7}
        observations, paid, terminated, truncated, infos = parallel.step({**noise, **actions})
        rounds += 1
        assert paid == rewards
        for agent in parallel.possible_agents:
            kept = {
                key: value
                for key, value in infos[agent].items()
                if key in ("cost", "events", "illegal_action", "experiment_over", "score")
            }
            assert same(kept, done[agent]), (agent, kept, done[agent])
        status = aec.laboratories.state.status[0]
        assert set(terminated.values()) == {status != 0}
        assert set(truncated.values()) == {False}
        assert parallel.agents == (parallel.possible_agents if status == 0 else [])
    assert rounds > 3
    # What elapsed between an agent's turns, and from the last of them to the end, is the whole episode.
    for agent in aec.possible_agents:
        assert infos[agent]["elapsed_ticks"] == aec.infos[agent]["elapsed_ticks"]
        assert ticks_seen[agent] + infos[agent]["elapsed_ticks"] == aec.laboratories.state.ticks[0]
    for key in ("goals", "submitted_mol", "purity", "costs"):
        np.testing.assert_array_equal(infos["manager_0"][key], aec.infos["manager_0"][key])


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


def test_a_mask_handed_out_is_the_callers() -> None:
    """Writing into a mask or an observation that was handed out changes nothing."""
    env, twin = parallel_env(WURTZ), parallel_env(WURTZ)
    for one in (env, twin):
        one.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(60):
        if not env.agents:
            break
        turns = env.laboratories.turns(env.laboratories.members)[:, 0]
        actions = {
            env.possible_agents[number]: choose(env.laboratories, int(number), 0, rng)
            for number in np.flatnonzero(turns)
        }
        observations, rewards, *_, infos = env.step(actions)
        expected, expected_rewards, *_, expected_infos = twin.step(actions)
        assert rewards == expected_rewards
        for agent in env.possible_agents:
            np.testing.assert_array_equal(observations[agent], expected[agent])
            assert same(infos[agent], expected_infos[agent])
            observations[agent][:] = -1.0
            if "action_mask" in infos[agent]:
                infos[agent]["action_mask"][:] = 9


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


@pytest.mark.parametrize(
    ("agent", "action", "expected"),
    [
        ("ext_0", 41, "integer from 0 to 40"),
        ("ext_0", -1, "integer from 0 to 40"),
        ("ext_0", 0.5, "integer from 0 to 40"),
        ("ext_0", None, "integer from 0 to 40"),
        ("ext_0", "settle", "integer from 0 to 40"),
        ("rxn_0", np.full(6, np.nan), "6 finite numbers from 0 to 1"),
        ("rxn_0", np.full(5, 0.5), "6 finite numbers from 0 to 1"),
        ("rxn_0", np.full(6, 1.01), "6 finite numbers from 0 to 1"),
        ("rxn_0", 0, "6 finite numbers from 0 to 1"),
    ],
    ids=str,
)
def test_one_bad_action_spoils_the_round(agent: str, action: Any, expected: str) -> None:
    """Nobody's action is played, wherever in the order the bad one stands."""
    env, actions = two_busy()
    before = env.laboratories.snapshot()
    with pytest.raises(ValueError, match=agent) as caught:
        env.step({**actions, agent: action})
    assert expected in str(caught.value)
    assert repr(action) in str(caught.value)
    for was, now in zip(before, env.laboratories.snapshot(), strict=True):
        np.testing.assert_array_equal(now, was)
    twin, _ = two_busy()
    for one, other in zip(env.step(actions)[:4], twin.step(actions)[:4], strict=True):
        assert same(one, other)


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
