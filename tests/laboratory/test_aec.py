"""The laboratory as an AEC environment: its state, turns, spaces, masks, actions, rewards, endings."""

import re
from collections import Counter
from typing import Any

import gymnasium
import numpy as np
import pytest
from helpers import FEATURED, digest, laboratory, manager, random_legal, refused
from pettingzoo.test.state_test import test_state as check_state
from pettingzoo.test.state_test import test_state_space as check_state_space

from chemlab.envs.aec import raw_env
from chemlab.laboratory import env as laboratory_env
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import SUBMIT
from chemlab.roles.manager_state import CLOSED

WURTZ = "wurtz_dodecane"


def random_turn(env: raw_env, rng: np.random.Generator, submit: bool = True) -> Any:
    """A random legal action for the selected agent."""
    agent = env.agent_selection
    mask = env.infos[agent].get("action_mask")
    if agent == "manager_0" and not submit:
        mask = mask & (env.laboratories.actions.table[:, 0] != SUBMIT)
    return random_legal(env.action_space(agent), mask, rng)


@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize("name", FEATURED)
def test_state(name: str) -> None:
    env = laboratory_env(name)
    check_state_space(env)
    check_state(env, 100)  # plays any action of the spaces, legal or not
    assert sum(channel.size for channel in env.unwrapped.state_channels) == env.state_space.shape[0]


@pytest.mark.parametrize("name", FEATURED)
def test_turns_and_observations_in_random_play(name: str) -> None:
    env = raw_env(name)
    labs, rng = env.laboratories, np.random.default_rng(0)
    env.reset(seed=0)
    order: list[str] = []
    while labs.state.status[0] == 0:
        check_seen(env)
        agent, number = env.agent_selection, env.possible_agents.index(env.agent_selection)
        busy = [labs.agents[1 + b] for b in np.flatnonzero(labs.busy[:, 0])]
        assert agent == "manager_0" or agent in busy, "an idle bench has no turn"
        tick, action = int(labs.state.ticks[0]), random_turn(env, rng, submit=False)
        waits = number == 0 and labs.actions.decode(action) == ("wait",)
        env.step(action)
        if labs.state.status[0] != 0:
            break
        if number == 0:
            assert env.agent_selection == (busy[0] if waits and busy else "manager_0")
            # With every bench idle there may be something to wait for: a fitter, an order.
            worth_waiting = any(bench.wear for bench in labs.scenario.benches.values()) or labs.scenario.demand.order
            assert labs.state.ticks[0] == tick or (waits and not busy and worth_waiting)
            continue
        order.append(agent)
        if labs.state.ticks[0] == tick:  # the tick goes on: the next busy bench
            later = [other for other in busy if env.possible_agents.index(other) > number]
            assert env.agent_selection == later[0]
        else:
            still = [labs.agents[1 + b] for b in np.flatnonzero(labs.busy[:, 0])]
            # An experiment of this tick has ended exactly if not everybody who took part is still busy.
            due = still[0] if set(order) == set(still) else "manager_0"
            # An order that comes gives the manager the turn.
            assert env.agent_selection == due or (labs.scenario.demand.order and env.agent_selection == "manager_0")
            order = []
    # Orders over time end an episode when none can be met any more.
    assert labs.state.status[0] == 2 or labs.scenario.demand.order


def check_seen(env: raw_env) -> None:
    """Observations lie in their spaces, and idle benches see zeros."""
    for number, agent in enumerate(env.possible_agents):
        seen = env.observe(agent)
        assert env.observation_space(agent).contains(seen)
        if number == 0:
            continue
        own = env.laboratories.experiments[number - 1]
        # Nothing of a vessel before the first turn with it, where the scenario hides something.
        first = env.scenario.hides and own.steps[0] == 0 and env.agent_selection == "manager_0"
        if first or not own.busy[0]:
            assert not seen.any()
        else:
            goal = seen[channel_slices(env.laboratories.benches[number - 1].channels)["goal"]]
            assert goal.tolist() == np.eye(len(goal))[own.goal[0]].tolist()


@pytest.mark.parametrize("name", ["crude", "failing", "wurtz_two_lines"])
def test_masks_agree_with_what_actions_do(name: str) -> None:
    env = raw_env(name)
    labs, rng = env.laboratories, np.random.default_rng(8)
    price = env.scenario.costs.illegal_action
    assert price > 0.0
    played: Counter[tuple[bool, bool]] = Counter()
    # Some laboratories have no bench with actions that could be illegal.
    masked = any(bench.action_count for bench in labs.benches)
    for seed in range(4):
        env.reset(seed=seed)
        while labs.state.status[0] == 0:
            agent, space = env.agent_selection, env.action_space(env.agent_selection)
            mask = env.infos[agent].get("action_mask")
            if not isinstance(space, gymnasium.spaces.Discrete):
                assert mask is None
                refused(agent, env.action_masks)
                env.step(random_turn(env, rng))
                assert not env.infos[agent]["illegal_action"]
                continue
            assert mask.dtype == np.int8
            assert mask.shape == (space.n,)
            assert set(np.unique(mask)) <= {0, 1}
            assert mask.any()
            np.testing.assert_array_equal(env.action_masks(), mask == 1)
            # As often illegal as legal, but no submission.
            choices = np.flatnonzero(mask == 0) if rng.random() < 0.5 and not mask.all() else np.flatnonzero(mask)
            action = int(rng.choice(choices))
            if agent == "manager_0" and mask[action] and labs.actions.decode(action)[0] == "submit":
                continue
            before, costs = [array.copy() for array in labs.shelf.arrays()], labs.costs()
            env.step(action)
            illegal = mask[action] == 0
            played[agent == "manager_0", bool(illegal)] += 1
            assert env.infos[agent]["illegal_action"] is bool(illegal)
            ended = bool(np.isfinite(labs.scores[0]).any())
            if illegal and not ended:
                for was, now in zip(before, labs.shelf.arrays(), strict=True):
                    # Dissolved amounts are shared out anew, which may cost a last digit.
                    np.testing.assert_allclose(now, was, rtol=1e-12, atol=0.0)
            if agent == "manager_0":
                charged = labs.costs()["illegal_actions"] - costs["illegal_actions"]
                assert charged == pytest.approx(price if illegal else 0.0, abs=1e-15)
            elif illegal and not ended:
                assert env.rewards[agent] == -price
                assert env.infos[agent]["cost"] == 0.0
            elif not ended:
                # Accidents may have a price of their own.
                accidents = env.scenario.safety.reward_price * env.infos[agent]["cost"]
                assert env.rewards[agent] == pytest.approx(-accidents, rel=1e-12, abs=0.0)
    roles = (True, False) if masked else (True,)
    assert all(played[role, illegal] > 20 for role in roles for illegal in (True, False)), played


def test_every_way_to_write_an_action_is_the_same_action() -> None:
    numbers, fine = [int, np.int32, np.int64, np.array], [0.5, 0.25, 0.5, 0.0, 1.0, 0.125]
    boxes = [list, tuple, np.array, lambda values: np.array(values, dtype=np.float32)]
    for agent, action, written in (("manager_0", 3, numbers), ("ext_0", 3, numbers), ("rxn_0", fine, boxes)):
        states = set()
        for write in written:
            env = laboratory(WURTZ)
            if agent != "manager_0":
                manager(env, "start", agent, 0, "dodecane")
                manager(env, "wait")
            env.step(write(action))
            states.add(digest(env.laboratories.snapshot()))
        assert len(states) == 1, agent


@pytest.mark.parametrize("name", FEATURED)
def test_no_reward_is_lost(name: str) -> None:
    """``last()``, payments, and scores with the manager's result less costs are the same, and are in the infos."""
    env, rng = laboratory_env(name), np.random.default_rng(1)
    inner: Any = env.unwrapped
    env.reset(seed=3)
    agents, labs = inner.possible_agents, inner.laboratories
    price = inner.scenario.safety.reward_price
    seen, paid, scored, told = (dict.fromkeys(agents, 0.0) for _ in range(4))
    for agent in env.agent_iter():
        _, reward, terminated, truncated, info = env.last()
        seen[agent] += reward
        told[agent] += info["score"] - price * info["cost"]
        if terminated or truncated:
            env.step(None)
            continue
        env.step(random_turn(inner, rng))
        for other, value in env.rewards.items():
            paid[other] += value
        scored[agent] -= price * inner.infos[agent]["cost"]
        for i in np.flatnonzero(np.isfinite(labs.scores[0])):
            scored[agents[i]] += float(labs.scores[0, i])
    scored["manager_0"] = float(labs.result(labs.members)[0])
    assert seen == pytest.approx(paid, rel=1e-12, abs=1e-12)
    assert paid == pytest.approx(scored, rel=1e-12, abs=1e-12)
    assert told == pytest.approx(scored, rel=1e-12, abs=1e-12)


def test_a_start_and_a_recall_keep_what_is_unread() -> None:
    env = laboratory(WURTZ)
    labs, act = env.laboratories, env.laboratories.act
    env.infos["rxn_0"] |= {"experiment_over": True, "score": 0.5, "cost": 0.5}

    def eventful(number: int, *arguments: Any) -> None:
        act(number, *arguments)
        labs.state.cost[labs.agents.index("rxn_0"), 0] = 0.25

    labs.act = eventful  # type: ignore[method-assign]
    manager(env, "start", "rxn_0", 0, "dodecane")
    told = env.infos["rxn_0"]
    assert (told["cost"], told["experiment_over"], told["score"]) == (0.75, True, 0.5)
    manager(env, "recall", "rxn_0")
    assert (told["experiment_over"], told["score"]) == (True, 0.5 + labs.scores[0, 1])


def test_submitting_terminates_for_all() -> None:
    env = raw_env("wurtz_any")
    env.reset(seed=0, options={"goal": "NaCl"})
    env.laboratories.shelf.fill(0, 1, 1.2, {"diethyl_ether": 3.0, "NaCl": 1.0})
    manager(env, "start", "rxn_0", 0, "dodecane")  # a running experiment does not hold up the end
    manager(env, "submit", 1)
    assert all(env.terminations.values())
    assert not any(env.truncations.values())
    # 1 of 4 mol is salt, whether dissolved or not; the theoretical maximum is 3 mol; nothing has been used.
    assert env.rewards["manager_0"] == pytest.approx(1.0 * 0.25 / 3.0, rel=1e-12)
    assert env.infos["manager_0"]["submitted_mol"] == pytest.approx([1.0], rel=1e-12)
    assert env.infos["manager_0"]["purity"] == pytest.approx([0.25], rel=1e-12)
    order = []
    while env.agents:
        order.append(env.agent_selection)
        assert env.last()[2]
        env.step(None)
    assert sorted(order) == sorted(env.possible_agents)
    # Submitting with the last action of all is a submission.
    env = laboratory({"base": WURTZ, "limits": {"manager_actions": 1}})
    manager(env, "submit", 0)
    assert env.laboratories.state.status[0] == CLOSED


def test_a_goal_can_be_asked_for() -> None:
    """The draw is made all the same, so cameras and instruments of the episode do not depend on who chose the goal."""
    env = raw_env("wurtz_any")
    goals = env.scenario.lab_goals
    at = channel_slices(env.laboratories.channels)["goal"]
    env.reset(seed=5)
    drawn, state = env.scenario.goals[env.laboratories.state.goal[0, 0]], digest(env.laboratories.snapshot())
    for i, goal in enumerate(goals):
        env.reset(seed=5, options={"goal": goal})
        assert env.observe("manager_0")[at].tolist() == [float(i == g) for g in range(len(goals))]
        assert (digest(env.laboratories.snapshot()) == state) == (goal == drawn)


def test_an_unknown_option_is_a_warning() -> None:
    env = raw_env(WURTZ)
    with pytest.warns(UserWarning, match="ignored: gaol"):
        env.reset(seed=0, options={"gaol": "dodecane"})


@pytest.mark.parametrize("name", ["rush", "wurtz_two_lines"])
def test_rendering_as_text(name: str) -> None:
    env = laboratory(name, render_mode="ansi")
    rng = np.random.default_rng(0)
    texts = []
    while env.laboratories.state.status[0] == 0:
        texts.append(text := str(env.render()))
        first = int(env.infos["manager_0"]["goals"][0])
        assert f"goal {'unknown' if first < 0 else env.scenario.goals[first]} - " in text
        assert env.scenario.title in text
        assert f"turn: {env.agent_selection}" in text
        for start in (*(f"slot {slot}" for slot in range(env.scenario.shelf.slots)), *env.scenario.bench_agents()):
            assert re.search(rf"^\s*{start}\b", text, re.MULTILINE)
        env.step(random_turn(env, rng, submit=False))
    assert "limit reached" in str(env.render()) or env.scenario.demand.order
    assert any("step " in text for text in texts)


def test_rendering_without_a_mode_warns_and_an_unknown_mode_is_refused() -> None:
    env = laboratory(WURTZ)
    assert str(laboratory_env(WURTZ)) == str(env) == env.metadata["name"]
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None
    with pytest.raises(ValueError, match="'human'") as caught:
        raw_env(WURTZ, render_mode="hologram")
    assert "ansi" in str(caught.value)
