"""Continuous benches as a choice among representative actions: the same bench, wherever it is seen from."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from helpers import record_episode

from chemlab.agents.episodes import play_episode
from chemlab.agents.evaluate.play import Target
from chemlab.agents.policies import RandomPolicy, make_policies
from chemlab.config.datamodel import written
from chemlab.config.loading import load_scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.laboratory import parallel_env, raw_env
from chemlab.record import scenario_hash, verify_record
from chemlab.roles.discrete import Discretised
from chemlab.roles.kinds import discretised_twin


def bench(name: str = "wurtz_dodecane") -> Discretised:
    made = RoleEnv(name, bench="rxn", actions="discrete").bench
    assert isinstance(made, Discretised)
    return made


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
        one = bench(name)
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


def test_every_view_takes_it_and_the_laboratory_goes_on_as_it_would() -> None:
    batch = BatchedLaboratory(2, actions="discrete")
    lone, together = raw_env(actions="discrete"), parallel_env(actions="discrete")
    made = gymnasium.make("chemlab/LabAgent-v1", agent="rxn_0", actions="discrete")
    spaces = [view.action_space("rxn_0") for view in (batch, lone, together)]
    assert {space.n for space in (*spaces, made.action_space)} == {36}
    assert batch.action_space("ext_0") == BatchedLaboratory(1).action_space("ext_0")
    _, infos = together.reset(seed=0)
    # Without the turn an agent is shown one action, to leave everything as it is.
    assert infos["rxn_0"]["action_mask"].tolist() == [0] * 35 + [1]
    scores = []
    for kind in ("native", "discrete"):
        labs = Laboratories(load_scenario("wurtz_dodecane").configured(actions=kind), 1)
        env = raw_env(labs.scenario)
        result = play_episode(env, make_policies("scripted", env.laboratories, 0), 5)
        scores.append(result.score)
    assert scores[0] == scores[1]


def test_records_of_it_are_verified(tmp_path: Path) -> None:
    path = record_episode(tmp_path / "episode.jsonl", policy="scripted,rxn=random", seed=1, actions="discrete")
    assert verify_record(path, raw_env(actions="discrete").scenario).status == "ok"
    assert verify_record(path).status == "foreign"  # the shipped scenario has the numbers
    assert '"actions":"discrete"' in path.read_text()


def test_copies_are_benches_like_it() -> None:
    one = bench()
    for other in (copy.copy(one), copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        assert type(other) is type(one)
        np.testing.assert_array_equal(other.action_rows, one.action_rows)
    env = RoleVectorEnv(4, bench="rxn", actions="discrete", threads=2)
    other = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(env.reset(seed=1)[0], other.reset(seed=1)[0])
    np.testing.assert_array_equal(env.step(np.arange(4))[0], other.step(np.arange(4))[0])


def test_scenarios_without_it_are_what_they_were() -> None:
    scenario = load_scenario("wurtz_dodecane")
    assert scenario.configured(actions=None) is scenario
    assert scenario_hash(scenario.configured(actions="native")) == scenario_hash(scenario)
    assert scenario_hash(scenario.configured(actions="discrete")) != scenario_hash(scenario)
    assert "actions" not in written(scenario.benches["rxn"])
    with pytest.raises(ValueError, match="actions: must be native or discrete, given 'some'"):
        scenario.configured(actions="some")
    assert discretised_twin(RoleEnv(bench="ext").bench) is None


def test_a_random_policy_chooses_among_them() -> None:
    env = RoleVectorEnv(200, bench="rxn", actions="discrete")
    observations, infos = env.reset(seed=0)
    actions = RandomPolicy(0, 1).act(observations, infos["action_mask"], np.zeros(200, dtype=np.int64), np.arange(200))
    assert len(set(actions.tolist())) > 30
