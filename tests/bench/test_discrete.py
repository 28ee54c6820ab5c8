"""Continuous benches as a choice among representative actions: the same bench, wherever it is seen from."""

import numpy as np
from helpers import refused

from chemlab.agents.evaluate.play import Target
from chemlab.config.datamodel import written
from chemlab.config.loading import load_scenario
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.record import scenario_hash
from chemlab.roles.kinds import discretised_twin


def test_each_choice_does_what_its_numbers_do() -> None:
    """Stepped side by side with the continuous bench: observations, rewards and the end are equal to the last digit."""
    chosen, numbers = RoleVectorEnv(36, bench="rxn", actions="discrete"), RoleVectorEnv(36, bench="rxn")
    rows = chosen.bench.action_rows
    assert rows.shape == (36, 6)
    np.testing.assert_array_equal(chosen.reset(seed=3)[0], numbers.reset(seed=3)[0])
    draw = np.random.default_rng(0)
    for _ in range(25):
        actions = draw.permutation(36)
        for ours, theirs in zip(chosen.step(actions)[:4], numbers.step(rows[actions])[:4], strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_all_choices_are_legal_differ_and_say_what_they_do() -> None:
    for name in ("wurtz_dodecane", "fictitious", "campaign", "wurtz_real"):
        one = RoleEnv(name, bench="rxn", actions="discrete").bench
        assert len(np.unique(one.action_rows, axis=0)) == len(one.action_rows) == one.action_count
        assert len(set(one.action_meanings)) == one.action_count
        assert ((one.action_rows >= 0.0) & (one.action_rows <= 1.0)).all()
        assert one.action_meanings[one.end_action] == "hold"
        np.testing.assert_array_equal(one.action_rows[one.end_action, :2], 0.5)
        assert not one.action_rows[one.end_action, 2:].any()
    env = RoleEnv(bench="rxn", actions="discrete")
    _, info = env.reset(seed=0)
    assert info["action_mask"].all()
    assert env.action_masks().all()


def test_a_scripted_agent_loses_nothing_where_its_actions_are_in_the_table() -> None:
    scenario = load_scenario("wurtz_dodecane")
    for goal in scenario.goals:
        ours, theirs = (
            Target(scenario.configured(actions=kind), "rxn").play("scripted", goal, 4, 0).returns
            for kind in ("discrete", "native")
        )
        np.testing.assert_array_equal(ours, theirs)


def test_scenarios_without_it_are_what_they_were() -> None:
    scenario = load_scenario("wurtz_dodecane")
    assert scenario.configured(actions=None) is scenario
    assert scenario_hash(scenario.configured(actions="native")) == scenario_hash(scenario)
    assert scenario_hash(scenario.configured(actions="discrete")) != scenario_hash(scenario)
    assert "actions" not in written(scenario.benches["rxn"])
    refused("actions: must be native or discrete, given 'some'", scenario.configured, actions="some")
    assert discretised_twin(RoleEnv(bench="ext").bench) is None
