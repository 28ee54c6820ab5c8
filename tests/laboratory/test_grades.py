"""What a manager asks of an experiment besides its goal, what a bench is told of the world, and what it reports."""

from typing import Any

import numpy as np
import pytest
from helpers import laboratory, manager, mapping, refused

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import channel_slices

HOLD = np.array([0.5, 0.5, 0.0], dtype=np.float32)


def graded(report: float | None = 0.0, **grade: float) -> dict[str, Any]:
    """A campaign with two grades, whose bench observes the drawn rate; 3 mol there at first, 2 in the single bench."""
    values = mapping("campaign")
    values |= {"specifications": {}, "grades": {"quick": {"ticks": 4}, "asked": grade}}
    values["benches"]["rxn"] |= {"report": report, "start": {"capacity_l": 1.2, "contents": {"1-chlorohexane": 4.0}}}
    values["world"]["draws"]["rate"]["told"] = ["rxn"]
    for vessel in values["shelf"]["vessel"]:
        vessel["contents"] = {"2-chlorohexane": 1.0, "1-chlorohexane": 3.0}
    return values


def run(env: Any, grade: str) -> int:
    """One experiment without heat; the turns it takes."""
    manager(env, "start", "rxn_0", 0, "2-chlorohexane", grade)
    manager(env, "wait")
    turns = 0
    while env.agent_selection == "rxn_0":
        env.step(HOLD)
        turns += 1
    return turns


def test_a_grade_limits_the_ticks_of_an_experiment() -> None:
    env = laboratory(graded())
    assert run(env, "quick") == 4
    assert run(env, "asked") == 20
    # A start without a grade is of the last.
    encode, start = env.laboratories.actions.encode, ("start", "rxn_0", 2, "2-chlorohexane")
    assert encode(*start) == encode(*start, "asked")
    refused("takes 4 arguments", encode, *start[:3])


def test_the_bench_sees_what_is_asked_and_told_and_nobody_else_is_told() -> None:
    env = laboratory(graded(purity_at_least=0.3, amount_at_least_mol=2.0))
    labs = env.laboratories
    manager(env, "start", "rxn_0", 0, "2-chlorohexane", "asked")
    assert not env.observe("rxn_0").any()  # before its first turn
    manager(env, "wait")
    slices, seen = channel_slices(labs.benches[0].channels), env.observe("rxn_0")
    assert seen[slices["grade"]] == pytest.approx([0.5, 0.3, 1.0])
    assert seen[slices["told"]] == pytest.approx(labs.worlds.positions(labs.members)[0], abs=1e-6)
    other = laboratory(graded(purity_at_least=0.3, amount_at_least_mol=2.0))
    other.reset(seed=0, options={"world": {"rate": 3.9}})
    manager(other, "start", "rxn_0", 0, "2-chlorohexane", "asked")
    manager(other, "wait")
    assert (other.observe("manager_0") == env.observe("manager_0")).all()
    assert np.flatnonzero(other.observe("rxn_0") != seen).tolist() == [slices["told"].start]


@pytest.mark.parametrize(("purity", "met"), [(0.1, True), (0.99, False)])
def test_what_falls_short_of_its_grade_earns_nothing(purity: float, met: bool) -> None:
    """Without a grade the score is the goal that was made: some, in an oven that is never below 345 K."""
    plain, env = laboratory(graded()), laboratory(graded(purity_at_least=purity))
    for each in (plain, env):
        run(each, "asked")
    made, score = (each.laboratories.scores[0, 1] for each in (plain, env))
    assert made > 1e-4
    assert score == (made if met else 0.0)


def test_reports_say_what_is_there_as_well_as_sensors_can() -> None:
    env = laboratory(graded())
    labs = env.laboratories
    slices = channel_slices(labs.channels)
    said = [slices[f"rxn_0_reported_{what}"].start for what in ("amount", "purity", "ticks")]
    assert env.observe("manager_0")[said].tolist() == [0.0, 0.0, 0.0]
    run(env, "quick")
    made = labs.shelf.amounts[0, 0, labs.shelf.layout.index("2-chlorohexane")]
    assert env.observe("manager_0")[said] == pytest.approx([made / 4.0, made / 4.0, 4 / 20], rel=1e-6)
    many = Laboratories(load_scenario(graded(report=0.1)), 400)
    many.begin(world={"rate": 1.0})
    begin = many.actions.encode("start", "rxn_0", 0, "2-chlorohexane", "quick")
    for action in (begin, many.actions.encode("wait")):
        many.act(0, many.members, np.full(400, action))
    seen = many.observe(1, many.members)
    for _ in range(4):
        many.act(1, many.members, np.repeat(HOLD[None].astype(np.float64), 400, axis=0))
    amounts = many.state.report[:, 0, 0] - many.shelf.amounts[:, 0, many.shelf.layout.index("2-chlorohexane")] / 4.0
    assert abs(amounts.mean()) < 0.02  # standard error 0.005
    assert 0.08 < amounts.std() < 0.11
    pressure = seen[:, channel_slices(many.benches[0].channels)["pressure"]]
    assert abs(np.corrcoef(amounts, pressure[:, 0])[0, 1]) < 0.2  # the gauge's error does not tell the report's


def test_single_benches_meet_the_same_grades_and_are_told_the_same() -> None:
    values = load_scenario(graded(purity_at_least=0.2))
    labs = Laboratories(values)
    env, batch = RoleEnv(values, bench="rxn"), RoleVectorEnv(6, values, bench="rxn")
    assert env.observation_space == labs.observation_space(1)
    seen, _ = batch.reset(seed=3)
    slices = channel_slices(labs.benches[0].channels)
    grades = set()
    for member in range(6):
        own, _ = env.reset(seed=3 + member)
        assert (own == seen[member]).all()
        grades.add(float(own[slices["grade"]][2]))
        assert own[slices["told"]] == pytest.approx(env.batch.worlds.positions(env.batch.members)[0], abs=1e-6)
        turns, over = 0, False
        while not over:
            _, _, over, _, _ = env.step(HOLD)
            turns += 1
        assert turns == round(20 * float(own[slices["grade"]][2]))
    assert sorted(grades) == pytest.approx([0.2, 1.0])


def test_nobody_is_told_who_is_not_there() -> None:
    values = graded()
    values["world"]["draws"]["rate"]["told"] = ["dit"]
    with pytest.raises(DataError, match=r"world\.draws\.rate\.told: 'dit' is not one of benches"):
        load_scenario(values)
