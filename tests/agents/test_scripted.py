"""The scripted policies: what they reach, how safely, and that they see nothing but what an agent may see."""

import copy
import functools
import gc
import json
import os
import subprocess
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import FEATURED, slow_but

from chemlab.agents.episodes import Played, play_episode, play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.config.inherit import scenario_names
from chemlab.envs.aec import raw_env
from chemlab.envs.players import Policy
from chemlab.lab.engine import Laboratories


@functools.cache
def played(scenario: str, policy: str, episodes: int, split: str = "train") -> tuple[Played, dict[str, float]]:
    """Episodes with seeds 0, 1, ..., and the sums of their safety events."""
    labs = Laboratories(scenario, episodes, split=split)
    found = play_laboratory(labs, make_policies(policy, labs, 0), None, 0)
    return found, dict(zip(labs.scenario.safety_events, labs.safety_totals.sum(axis=0).tolist(), strict=True))


@pytest.mark.parametrize("name", ["wurtz_dodecane", "wurtz_dodecane_direct"])
def test_dodecane_is_made_purely(name: str) -> None:
    """LABORATORY.md: the scripted manager submits at least 0.40 mol at a purity of at least 0.95."""
    found = played(name, "scripted", 100)[0].measures
    assert not found["limit"].any()
    assert ((found["submitted_mol"] >= 0.40) & (found["purity"] >= 0.95)).sum() >= 95
    # No more than the sodium and the chlorohexane allow.
    assert found["submitted_mol"].max() <= 0.5


def test_random_actions_make_next_to_nothing_and_are_not_safe() -> None:
    """Sodium can meet water, vessels can overflow: that scripted agents see to it says something."""
    found, events = played("wurtz_dodecane", "random", 100)
    assert found.returns.mean() < 0.1
    assert (found.measures["submitted_mol"] * found.measures["purity"]).mean() < 0.05
    assert events["metal_in_water_mol"] > 1.0
    assert events["spill_l"] > 1.0


def test_benches_crystallize_whatever_they_are_brought() -> None:
    """The bench has no process that seeds. The scripted manager brings no crude product, a random one does."""
    played("benzoic", "scripted,manager=random", 24)


@pytest.mark.parametrize("name", slow_but(scenario_names(), *FEATURED))
def test_scripted_agents_are_safe_and_clearly_better_than_chance(name: str) -> None:
    """In as many episodes as there are goals, and more, in worlds as those that audits play."""
    # Of a result that is 1 at best; where even a planner that knows the world is far from that, half of the planner's.
    margin = 0.3
    if (audit := Path(__file__).parents[2] / "docs" / "results" / "audits" / f"{name}.json").exists():
        found = json.loads(audit.read_text(encoding="utf-8"))
        margin = min(0.3, 0.5 * (found["oracle"]["score"] - found["random"]["score"]))
    scripted, random = (played(name, policy, 21, "test")[0] for policy in ("scripted", "random"))
    assert scripted.returns.mean() > random.returns.mean() + margin
    assert not scripted.illegal.any()
    assert not scripted.measures["unsafe"].any()


Call = tuple[str, Any, Any, Any, Any, Any]


class Recorder:
    """A policy that plays another and keeps copies of what that was given and answered."""

    def __init__(self, agent: str, policy: Policy, calls: list[Call]) -> None:
        self._agent, self._policy, self._calls = agent, policy, calls

    def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
        given = copy.deepcopy((observation, mask, step, members))
        action = self._policy.act(observation, mask, step, members)
        self._calls.append((self._agent, *given, np.array(action)))
        return action


def recorded(name: str, seeds: range) -> list[list[Call]]:
    """Every call of a policy in scripted episodes, by episode."""
    env = raw_env(name)
    policies = make_policies("scripted", env.laboratories)
    found = []
    for seed in seeds:
        calls: list[Call] = []
        play_episode(env, {agent: Recorder(agent, policy, calls) for agent, policy in policies.items()}, seed)
        found.append(calls)
    return found


@pytest.mark.parametrize("name", ["crude", "failing", "wurtz_two_lines"])
def test_heuristics_need_no_laboratory(name: str) -> None:
    """Given what they were given, they decide the same when laboratory, shelf and experiments are gone."""
    episodes = recorded(name, range(3))
    env = raw_env(name)
    policies = make_policies("scripted", env.laboratories)
    labs = env.laboratories
    gone = [weakref.ref(thing) for thing in (env, labs, labs.shelf, *labs.experiments)]
    del env, labs
    gc.collect()
    assert all(reference() is None for reference in gone), "a policy holds on to the laboratory"
    for calls in episodes:
        for agent, observation, mask, step, members, action in calls:
            given = copy.deepcopy((observation, mask, step, members))
            np.testing.assert_array_equal(policies[agent].act(*given), action)
            # Nor do they change what they are given.
            for one, other in zip(given, (observation, mask, step, members), strict=True):
                np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", FEATURED)
def test_acting_on_a_batch_is_acting_one_by_one(name: str) -> None:
    """Episodes side by side in one batch, whose members come and go, get the actions each gets alone."""
    episodes = recorded(name, range(4))
    env = raw_env(name)
    policies = make_policies("scripted", env.laboratories)
    batched = 0
    for agent in env.possible_agents:
        logs = [[call for call in calls if call[0] == agent] for calls in episodes]
        for turn in range(max(map(len, logs))):
            # Members in another order every turn, numbered apart.
            rows = [i for i, log in enumerate(logs) if turn < len(log)]
            rows = rows[turn % len(rows) :] + rows[: turn % len(rows)]
            calls = [logs[i][turn] for i in rows]
            observation = np.concatenate([call[1] for call in calls])
            mask = None if calls[0][2] is None else np.concatenate([call[2] for call in calls])
            step = np.concatenate([call[3] for call in calls])
            actions = policies[agent].act(observation, mask, step, np.array(rows) + 10)
            np.testing.assert_array_equal(actions, np.concatenate([call[5] for call in calls]))
            batched += len(rows) > 1
    assert batched > 10


@pytest.mark.parametrize("name", FEATURED)
def test_step_zero_makes_a_policy_forget(name: str) -> None:
    """Policies in the middle of an episode play the next one like fresh ones."""
    env = raw_env(name)
    used = make_policies("scripted", env.laboratories)
    fresh = make_policies("scripted", env.laboratories)
    play_episode(env, used, 0)
    # Broken off: a few turns only.
    env.reset(seed=1)
    members = env.laboratories.members
    for step in range(3):
        if env.agent_selection != "manager_0":
            break
        seen, mask = env.observe("manager_0")[None], env.infos["manager_0"]["action_mask"][None]
        env.step(used["manager_0"].act(seen, mask, np.array([step]), members)[0])
    assert play_episode(env, used, 2) == play_episode(env, fresh, 2)


@pytest.mark.slow
def test_the_manager_does_the_same_in_every_process() -> None:
    """Hash seeds 0 and 4 order a set of the names of two salts in two ways; a reading has the same salt in both."""
    code = (
        "from chemlab.agents.evaluate.play import Target\n"
        "from chemlab.config.loading import load_scenario\n"
        "target = Target(load_scenario('wurtz_any'))\n"
        "played = target.play('pretrained,manager=scripted', '4,5-diethyloctane', 1, 2_000_023)\n"
        "print(next(iter({'NaCl', 'NaOH'})), played.returns[0])"
    )
    said = []
    for seed in ("0", "4"):
        given: Any = {"env": {**os.environ, "PYTHONHASHSEED": seed}, "capture_output": True, "text": True}
        said.append(subprocess.run([sys.executable, "-c", code], check=True, **given).stdout.split())
    assert said[0][0] != said[1][0]
    assert said[0][1] == said[1][1]
