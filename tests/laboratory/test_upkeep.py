"""Benches that wear and break, instruments that drift: closed forms, random walks, and nothing where undeclared."""

import math
from typing import Any, cast

import numpy as np
import pytest
from helpers import allowed, laboratory, manager, mapping

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import CLOCK, TEMPERATURE
from chemlab.roles.manager_state import COST_ITEMS, LIMIT
from chemlab.roles.operation_bench import OperationBench

GC = "gas_chromatograph"
HOLD = np.array([0.5, 0.5, 0.0])
"""A reaction bench that is left alone."""


def scenario(wear: dict[str, Any] | None = None, drift: dict[str, Any] | None = None, **more: Any) -> Scenario:
    """The campaign, whose rates are known, on two lines; they wear and its chromatograph drifts as is said."""
    values = mapping("campaign")
    values["name"], values["world"] = "failing_campaign", {}
    bench = {**values["benches"].pop("rxn"), "count": 2, **({"wear": wear} if wear is not None else {})}
    values["benches"]["rxn"] = bench
    values["instruments"][GC] |= {"noise": 0.0, **({"drift": drift} if drift is not None else {})}
    return load_scenario({**values, **more})


def run(labs: Laboratories, agent: str, slot: int = 0, actions: Any = HOLD) -> int:
    """One experiment at a line in every laboratory, alike in all of them; how many ticks it took."""
    number, members, ticks = labs.agents.index(agent), labs.members, 0
    for action in (labs.actions.encode("start", agent, slot, "2-chlorohexane"), labs.actions.encode("wait")):
        labs.act(0, members, np.full(len(members), action))
    while labs.busy[number - 1, 0]:
        labs.act(number, members, np.tile(actions, (len(members), 1)))
        ticks += 1
    return ticks


def begun(spec: Scenario, members: int = 1, seed: int = 0, **world: Any) -> Laboratories:
    labs = Laboratories(spec, members)
    labs.begin(seed, world=world or None)
    return labs


def test_a_weak_stirrer_makes_a_tick_shorter() -> None:
    """A -> P at 345 K: exp(-k t), with t a tick times the gain."""
    labs = begun(scenario({"gain": 0.3}))
    assert run(labs, "rxn_0") == 20
    k = 4.86e12 * math.exp(-85000.0 / (8.314462618 * 345.0))
    left = labs.shelf.amounts[0, 0, labs.shelf.layout.index("1-chlorohexane")]
    assert left == pytest.approx(4.0 * math.exp(-k * 20 * 0.016 * 0.3), rel=1e-3)


def test_heating_may_be_weak_instead() -> None:
    """A thermostat takes smaller steps; a mantle's heat is a share of what is asked for; a shaking counts for less."""
    values = mapping("wurtz_dodecane")
    for key, actuator in (("rxn", "heat"), ("dit", "heat"), ("ext", "stir")):
        values["benches"][key]["wear"] = {"actuator": actuator, "gain": 0.25}
    worn = load_scenario({**values, "name": "weak"})
    for bench, process, column in (("rxn", "", TEMPERATURE), ("dit", "heat", TEMPERATURE), ("ext", "mix", CLOCK)):
        changes = []
        for scenario in (worn, "wurtz_dodecane"):
            env = RoleEnv(scenario, bench=bench)
            env.reset(seed=0)
            before = env.batch.shelf.rows[0, column]
            if bench == "rxn":
                env.step(np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0]))
            else:
                table = cast(OperationBench, env.bench).table
                of_kind = [a for a, words in enumerate(env.action_meanings) if words.startswith(process)]
                env.step(min(of_kind, key=lambda a: table[a, 4]))
            settled = env.bench.options.settle_per_step if column == CLOCK else 0.0
            changes.append(env.batch.shelf.rows[0, column] - before - settled)
        assert abs(changes[1]) > 1e-3
        assert changes[0] == pytest.approx(0.25 * changes[1], rel=1e-2)


def test_gains_and_lives_are_as_declared() -> None:
    """ln of a gain: normal, then a walk whose variance grows with ticks of work; a life: exponential."""
    labs = begun(scenario({"gain": 0.8, "spread": 0.5, "drift": 0.05, "life": 5000.0}), 2000)
    for experiments in labs.experiments:
        first = np.log(experiments.gain[:, 0])
        assert first.mean() == pytest.approx(math.log(0.8), abs=4 * 0.5 / 2000**0.5)
        assert first.std() == pytest.approx(0.5, rel=0.07)
        assert experiments.life.mean() == pytest.approx(5000.0, rel=4 / 2000**0.5)
    gains = [np.log(one.gain[:, 0]) for one in labs.experiments]
    assert abs(np.corrcoef(gains[0], gains[1])[0, 1]) < 0.09
    lives = labs.experiments[0].life.copy()
    whole = begun(scenario({"spread": 0.5, "drift": 0.05}), 2000)
    before = [np.log(one.gain[:, 0]) for one in whole.experiments]
    assert run(whole, "rxn_0") == 20
    change = np.log(whole.experiments[0].gain[:, 0]) - before[0]
    assert change.std() == pytest.approx(0.05 * 20**0.5, rel=0.07)
    assert (np.log(whole.experiments[1].gain[:, 0]) == before[1]).all()  # which has not worked
    assert (whole.experiments[0].gain[:, 1] == 1.0).all()
    assert len(np.unique(lives)) == 2000


def test_a_bench_that_breaks_ends_its_experiment_and_waits_for_a_fitter() -> None:
    spec = scenario({"life": 1e6, "repair_price": 0.03, "repair_ticks": 7}, world={"draws": DRAWN_LIFE})
    env = raw_env(spec)
    env.reset(seed=0, options={"world": {"life": {"rxn_0": 5.0}}})
    labs = env.laboratories
    seen = {channel.name: i for i, channel in enumerate(labs.channels)}
    assert list(seen)[-4:] == ["rxn_0_broken", "rxn_0_repair", "rxn_1_broken", "rxn_1_repair"]
    manager(env, "start", "rxn_0", 0, "2-chlorohexane")
    manager(env, "wait")
    for tick in range(5):
        assert env.agent_selection == "rxn_0"
        assert labs.state.ticks[0] == tick
        env.step(HOLD.astype(np.float32))
    assert env.agent_selection == "manager_0"
    assert env.observe("manager_0")[-4:].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert not allowed(env, "start", "rxn_0", 0, "2-chlorohexane")
    assert not allowed(env, "wait")
    assert allowed(env, "start", "rxn_1", 0, "2-chlorohexane")
    manager(env, "repair", "rxn_0")
    assert labs.costs()["time"] == pytest.approx(0.03 + 5 * spec.costs.tick)
    assert env.observe("manager_0")[-4:] == pytest.approx([0.0, 7 / spec.limits.ticks, 0.0, 0.0])
    for action in (("start", "rxn_0", 0, "2-chlorohexane"), ("repair", "rxn_0")):
        assert not allowed(env, *action)
    manager(env, "wait")  # for the fitter, as nobody works
    assert labs.state.ticks[0] == 12
    assert allowed(env, "start", "rxn_0", 0, "2-chlorohexane")
    assert labs.costs()["time"] == pytest.approx(0.03 + 12 * spec.costs.tick)
    assert set(labs.costs()) == set(COST_ITEMS)


LIVES = {"kind": "uniform", "low": 1.0, "high": 1000.0}
DRAWN_LIFE = {"life": {"what": "life", "of": ["rxn_0", "rxn_1", "rxn"], "change": "value", "distribution": LIVES}}


def test_a_repair_is_over_while_another_line_works() -> None:
    """The manager has the turn then, and the other experiment goes on. Waiting for a fitter may end the episode."""
    env = laboratory(scenario({"repair_ticks": 3}))
    manager(env, "repair", "rxn_1")
    manager(env, "start", "rxn_0", 0, "2-chlorohexane")
    manager(env, "wait")
    for _ in range(3):
        env.step(HOLD.astype(np.float32))
    assert env.agent_selection == "manager_0"
    assert env.laboratories.busy[0, 0]
    assert allowed(env, "start", "rxn_1", 1, "2-chlorohexane")
    env = laboratory(scenario({"repair_ticks": 10_000}))
    manager(env, "repair", "rxn_1")
    manager(env, "wait")
    assert env.laboratories.state.status[0] == LIMIT
    assert env.laboratories.state.ticks[0] == env.scenario.limits.ticks


def test_single_benches_wear_and_break_too() -> None:
    spec = scenario({"spread": 0.5, "life": 8.0})
    one, several = RoleEnv(spec, bench="rxn"), RoleVectorEnv(4, spec, bench="rxn", threads=2)
    lengths = []
    for seed in range(6):
        one.reset(seed=seed)
        several.reset(seed=[90, 91, 92, seed])
        alone, among = one.batch.experiments, several.batch.experiments
        assert among.gain[3].tobytes() == alone.gain[0].tobytes()
        assert among.life[3] == alone.life[0]
        life, steps, over = float(one.batch.experiments.life[0]), 0, False
        while not over:
            _, _, over, _, _ = one.step(HOLD.astype(np.float32))
            steps += 1
        assert steps == min(math.ceil(life), 20)
        lengths.append(steps)
    assert len(set(lengths)) > 2


def readings(labs: Laboratories) -> Any:
    labs.act(0, labs.members, np.full(len(labs.members), labs.actions.encode("measure", 0, GC)))
    return labs.state.reading[:, 0].copy()


def test_biases_walk_with_time_and_go_with_a_calibration() -> None:
    """Values away from the ends of the scale: the variance of what they are off by grows with the ticks."""
    spec = scenario({}, {"first": 0.01, "walk": 0.004, "price": 0.02, "error": 0.002})
    labs, true = begun(spec, 1500), begun(scenario({}))
    assert run(labs, "rxn_0") == run(true, "rxn_0") == 20
    exact = readings(true)[0]
    middle = int(np.abs(exact - 0.5).argmin())
    assert 0.15 < exact[middle] < 0.85
    off = readings(labs)[:, middle] - exact[middle]
    assert off.std() == pytest.approx(math.sqrt(0.01**2 + 20 * 0.004**2), rel=0.08)
    assert ((readings(labs)[:, middle] - exact[middle]) == off).all()  # no time has passed
    labs.act(0, labs.members, np.full(1500, labs.actions.encode("calibrate", GC)))
    assert labs.charges(labs.members)[:, 0] == pytest.approx(2 * spec.instruments[GC].price + 0.02)
    assert (readings(labs)[:, middle] - exact[middle]).std() == pytest.approx(0.002, rel=0.08)


def test_a_trend_goes_on_from_the_last_calibration() -> None:
    spec = scenario({}, {"trend": 0.001})
    labs, true = begun(spec), begun(scenario({}))
    for expected in (0.02, 0.04, 0.02):
        for one in (labs, true):
            run(one, "rxn_0")
        exact = readings(true)[0]
        middle = int(np.abs(exact - 0.5).argmin())
        assert readings(labs)[0, middle] - exact[middle] == pytest.approx(expected, abs=1e-9)
        if expected == 0.04:
            labs.act(0, labs.members, np.array([labs.actions.encode("calibrate", GC)]))
    dear = laboratory(scenario({}, {"price": 0.5}))
    assert dear.scenario.limits.budget == 0.6
    manager(dear, "calibrate", GC)
    assert not allowed(dear, "calibrate", GC)
    at = [channel.name for channel in labs.channels].index(f"{GC}_calibrated")
    sizes = [channel.size for channel in labs.channels]
    assert labs.observe(0, labs.members)[0, sum(sizes[:at])] == pytest.approx(20 / spec.limits.ticks)


GAINS = {"kind": "lognormal", "median": 1.0, "sigma": 0.5, "low": 0.2, "high": 5.0}
BIASES, TRENDS = {"kind": "normal", "mean": 0.0, "sd": 0.05}, {"kind": "uniform", "low": 0.0, "high": 1e-4}
DRAWS: dict[str, dict[str, Any]] = {
    "gain": {"what": "gain", "of": ["rxn_0", "rxn_1", "rxn"], "distribution": GAINS, "test": [[2.0, 5.0]]},
    "bias": {"what": "bias", "of": [GC], "change": "offset", "distribution": BIASES},
    "trend": {"what": "trend", "of": [GC], "change": "value", "distribution": TRENDS},
    **DRAWN_LIFE,
}


def drawing(**wear: Any) -> Scenario:
    drift = {"walk": 0.002, "error": 0.001, "price": 0.01}
    return scenario({"drift": 0.02, "repair_ticks": 5, **wear}, drift, world={"draws": DRAWS})


def test_worlds_draw_the_condition_of_benches_and_instruments() -> None:
    spec = drawing(gain=0.5)
    labs = begun(spec, 50)
    for member in range(50):
        drawn = labs.worlds.values(member)
        for number, experiments in enumerate(labs.experiments):
            assert experiments.gain[member, 0] == pytest.approx(0.5 * drawn["gain"][f"rxn_{number}"])
            assert experiments.life[member] == drawn["life"][f"rxn_{number}"]
        assert labs.state.bias[member] == pytest.approx(drawn["bias"][GC])
        assert labs.state.trend[member] == pytest.approx(drawn["trend"][GC])
        assert max(drawn["gain"].values()) < 2.0
    drift = {"first": 0.05}
    many = begun(scenario({}, drift, world={"draws": {"gain": DRAWS["gain"] | {"test": []}}}), 400)
    gains = np.log(many.worlds.table.arrays.values)
    assert np.abs(np.corrcoef(gains.T, many.state.bias.T)[:3, 3:]).max() < 0.2  # a bias does not tell what was drawn
    bench = RoleEnv(spec, bench="rxn")
    bench.reset(seed=3)
    assert bench.batch.experiments.gain[0, 0] == pytest.approx(0.5 * bench.batch.worlds.values(0)["gain"]["rxn"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"of": ["rxn_2"]}, "'rxn_2' has no gain; choose from rxn_0, rxn_1, rxn"),
        ({"of": []}, "name at least one bench or instrument"),
        ({"distribution": {"kind": "normal", "mean": 1.0, "sd": 1.0}}, "must stay above 0"),
        ({"what": "bias", "of": [GC]}, "must be offset or value"),
        ({"what": "bias", "of": ["balance"], "change": "offset"}, "'balance' has no bias"),
    ],
)
def test_draws_of_what_is_not_there_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message):
        scenario({}, {"walk": 0.1}, world={"draws": {"gain": {**DRAWS["gain"], "test": [], **change}}})
    with pytest.raises(DataError, match=r"give benches\.rxn one: wear = \{ gain = 1\.0 \}"):
        scenario(world={"draws": {"gain": DRAWS["gain"]}})


def test_nothing_is_different_where_nothing_is_declared() -> None:
    """No action, no channel, no array of any size; a declared perfect bench and instrument change no number."""
    plain, perfect = begun(scenario(), 1, seed=2), begun(scenario({"gain": 1.0}, {"price": 0.0}), 1, seed=2)
    assert not {"calibrate", "repair"} & {plain.actions.decode(a)[0] for a in range(len(plain.actions))}
    assert plain.state.ready.size == plain.state.bias.size == plain.state.broken.size == 0
    assert not plain.worlds.active
    for one in (plain, perfect):
        run(one, "rxn_1")
    assert plain.shelf.vessels.tobytes() == perfect.shelf.vessels.tobytes()
    assert readings(plain).tobytes() == readings(perfect).tobytes()
    assert all(one.actions.encode("wait") == len(one.actions) - 1 for one in (plain, perfect))
    added = len(perfect.channels) - len(plain.channels)
    own = [f"{bench}_{what}" for bench in ("rxn_0", "rxn_1") for what in ("broken", "repair")]
    assert [channel.name for channel in perfect.channels[-added:]] == [f"{GC}_calibrated", *own]
    assert plain.observe(0, plain.members)[0].tobytes() == perfect.observe(0, perfect.members)[0, :-added].tobytes()
