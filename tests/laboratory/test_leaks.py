"""What scenarios with hidden parameters give away for nothing: every hole that an attack found, as a test."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import allowed, laboratory, manager, mapping

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario, plain_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import AMOUNTS, CAPACITY
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import SUBMIT

HIDDEN = ("campaign", "crude", "failing", "refine", "relay", "runaway", "rush", "selectivity", "unlabelled")
"""The shipped scenarios with hidden parameters."""


def start(env: Any) -> str:
    """Start the first bench on the first slot, and return its agent."""
    spec, agent = env.laboratories.scenario, env.laboratories.bench_agents[0]
    manager(env, "start", agent, 0, spec.goals[0], *list(spec.grades)[:1])
    return str(agent)


@pytest.mark.parametrize("name", HIDDEN)
def test_a_bench_sees_nothing_before_its_first_turn_and_a_recall_takes_a_tick(name: str) -> None:
    env = laboratory(name)
    agent = start(env)
    assert not env.observe(agent).any()
    assert not allowed(env, "recall", agent)
    manager(env, "wait")
    assert env.agent_selection == agent
    assert env.observe(agent).any()


def test_the_paper_scenarios_show_and_recall_at_once_as_before() -> None:
    env = laboratory("wurtz_dodecane")
    agent = start(env)
    assert env.observe(agent).any()
    assert allowed(env, "recall", agent)


@pytest.mark.parametrize("name", HIDDEN)
def test_a_vessel_that_was_at_no_bench_cannot_be_submitted(name: str) -> None:
    labs = laboratory(name).laboratories
    submitting = labs.actions.table[:, 0] == SUBMIT

    def submitted() -> npt.NDArray[Any]:
        """What may be submitted."""
        return np.asarray(labs.mask(0, labs.members))[0] * submitting

    assert not submitted().any()
    labs.state.last_bench[0, 0] = 1
    labs.state.terms[0, :, 0] = 0.0  # every order has arrived
    assert submitted().sum() == labs.scenario.orders
    labs.shelf.vessels[0, 0, AMOUNTS:] = 0.0  # the vessel is empty
    assert not submitted().any()


@pytest.mark.parametrize("name", ["campaign", "rush"])
def test_orders_that_are_not_met_cost_their_share(name: str) -> None:
    labs = Laboratories(name, 3, split="validation")
    labs.begin()
    prices = labs.state.terms[:, :, 2] if labs.scenario.demand.order else np.ones((3, labs.scenario.orders))
    assert labs.result(labs.members) == pytest.approx(-0.1 * prices.mean(axis=1))


def ended(spec: Scenario) -> tuple[list[float], float, list[dict[str, Any]]]:
    """Submit one reacted vessel and let the episode end: the manager's rewards, the score, and the infos."""
    env = laboratory(spec.model_copy(update={"limits": spec.limits.model_copy(update={"ticks": 60})}))  # type: ignore[arg-type]
    labs, rewards, infos = env.laboratories, [], []
    start(env)
    manager(env, "wait")
    while env.agent_selection != "manager_0":
        env.step(np.array([1.0, 0.5, 0.0], dtype=np.float32))
    manager(env, "submit", 0, 0)
    rewards.append(env.rewards["manager_0"])
    infos.append(env.infos["manager_0"])
    while labs.state.status[0] == 0:
        if env.agent_selection == "manager_0":
            slot = int(np.flatnonzero(labs.shelf.rows[: labs.scenario.shelf.slots, 0] > 0.0)[0])
            manager(env, "start", "rxn_0", slot, labs.scenario.goals[0])
            rewards.append(env.rewards["manager_0"])
            manager(env, "wait")
        else:
            env.step(np.array([0.0, 0.5, 0.0], dtype=np.float32))
        rewards.append(env.rewards["manager_0"])
    infos.append(env.infos["manager_0"])
    return rewards, float(labs.result(labs.members)[0]), infos


def test_feedback_comes_when_the_scenario_says_and_the_rewards_are_the_score() -> None:
    told, values = {}, mapping("campaign") | {"specifications": {}}
    for feedback in ("none", 0.0, 0.2):
        values["demand"]["feedback"] = feedback
        rewards, score, (early, late) = ended(load_scenario(values))
        assert sum(rewards) == pytest.approx(score)
        told[feedback] = rewards[0], early["submitted_mol"][0], early["purity"][0]
        truth = late["submitted_mol"][0], late["purity"][0]
        assert truth[0] > 0.0
        assert not late["submitted_mol"][1:].any()
        if feedback == 0.0:
            assert told[feedback][1:] == truth
    assert told["none"] == (0.0, 0.0, 0.0)
    assert told[0.0][0] == pytest.approx(told[0.0][1] * told[0.0][2] / 4.0 / 4)
    assert told[0.2][1:] != told[0.0][1:]
    assert told[0.2][0] == pytest.approx(told[0.2][1] * told[0.2][2] / 4.0 / 4)


def test_amounts_have_the_declared_resolution_in_observation_and_info() -> None:
    """A trace that a bench takes is no message: the manager sees the stock by the marks of the gauge."""
    env = laboratory("unlabelled", render_mode="ansi")
    labs, gauge = env.laboratories, env.laboratories.scenario.shelf.gauge
    stock = channel_slices(labs.channels)["stock"]
    whole, text = env.observe("manager_0"), env.render()
    # An overfull vessel returns with a capacity that follows from its contents.
    labs.shelf.vessels[0, 0, CAPACITY] -= 0.01
    assert (env.observe("manager_0") == whole).all()
    assert env.render() == text
    before, costs = whole[stock].copy(), labs.costs()["stock"]
    labs.shelf.stock[0] *= 0.99
    assert (env.observe("manager_0")[stock] == before).all()
    assert labs.costs()["stock"] == costs
    labs.shelf.stock[0] *= 0.9
    marks = env.observe("manager_0")[stock] / gauge
    assert marks == pytest.approx(np.round(marks))
    assert (marks < before / gauge).all()
    assert labs.costs()["stock"] > costs
    labs.state.status[0] = 1
    assert labs.costs()["stock"] == pytest.approx(labs.charges(labs.members)[0, 1])


def test_infos_hide_orders_that_have_not_arrived() -> None:
    env = laboratory("rush")
    labs = env.laboratories
    assert (labs.state.terms[0, :, 0] > 0.0).all()
    assert env.infos["manager_0"]["goals"].tolist() == [-1] * 8
    while not (env.infos["manager_0"]["goals"] >= 0).any():
        manager(env, "wait")
    come = labs.state.terms[0, :, 0] <= labs.state.ticks[0]
    assert ((env.infos["manager_0"]["goals"] >= 0) == come).all()


def test_what_a_bench_observes_is_noisy_once_an_experiment_and_once_a_step() -> None:
    looks = []
    for _ in range(2):
        env = laboratory("campaign")
        agent = start(env)
        manager(env, "wait")
        first = env.observe(agent).copy()
        assert (env.observe(agent) == first).all()
        env.step(np.array([0.5, 0.5, 0.0], dtype=np.float32))
        looks.append((first, env.observe(agent).copy()))
    for ours, theirs in zip(*looks, strict=True):
        assert (ours == theirs).all()
    assert (looks[0][0][:200] == 0.0).all(), "the spectrum is coarser than its scale"
    assert looks[0][0][202] != looks[0][1][202], "pressure"
    assert looks[0][0].min() >= 0.0
    assert looks[0][0].max() <= 1.0
    env = laboratory("crude")
    agent = start(env)
    manager(env, "wait")
    pixels = env.observe(agent)[:300] * 10.0
    assert pixels.any()
    assert pixels == pytest.approx(np.round(pixels), abs=1e-5), "a resolution rounds"
    values = mapping("campaign")
    values["benches"]["rxn"]["noise"] = {"spectrum": 0.1, "smell": 0.1}
    with pytest.raises(DataError, match=r"benches\.rxn\.noise: unknown channel 'smell'; choose from spectrum"):
        Laboratories(load_scenario(values))


@pytest.mark.parametrize("bench", ["rxn", "dit"])
def test_half_of_a_bench_s_noise_stays_for_an_experiment(bench: str) -> None:
    """Also where a camera draws in every step: looking again does not replace an instrument."""
    seen: list[list[npt.NDArray[np.float32]]] = []
    channel = "temperature" if bench == "rxn" else "volume"
    for noise in ({channel: 0.05}, {}):
        values = mapping("wurtz_dodecane")
        values["benches"][bench]["noise"] = noise
        env = RoleVectorEnv(300, load_scenario(values), bench=bench)
        looks = [env.reset(seed=0)[0].copy()]
        for _ in range(4):
            actions = np.full((300, *env.single_action_space.shape), 0.5, dtype=np.float32)
            idle = env.single_action_space.n - 2 if bench == "dit" else 0  # pours from an empty vessel
            looks.append(env.step(actions if bench == "rxn" else np.full(300, idle))[0].copy())
        seen.append(looks)
    off = np.array(seen[0]) - np.array(seen[1])
    at = channel_slices(env.bench.channels)[channel].start
    assert off[..., at].std() == pytest.approx(0.05, rel=0.2)
    assert np.corrcoef(off[1, :, at], off[4, :, at])[0, 1] == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize(
    ("name", "agent", "channel"),
    [
        ("campaign", "rxn_0", "volume"),
        ("failing", "east_0", "volume"),
        ("failing", "west_0", "volume"),
        ("refine", "rxn_0", "volume"),
        ("relay", "rxn_0", "volume"),
        ("relay", "fin_0", "volume"),
        ("runaway", "rxn_0", "volume"),
        ("rush", "rxn_0", "volume"),
        ("unlabelled", "rxn_0", "volume"),
        ("unlabelled", "dit_0", "pressure"),
    ],
)
def test_a_gauge_without_noise_reads_the_same_in_every_world(name: str, agent: str, channel: str) -> None:
    """A piston stops at the contents, whose volume depends on what has reacted; vapours depend on the contents."""
    labs = Laboratories(name, 8)
    labs.begin()
    role, everywhere = next(role for role in labs.bench_roles if role.name == agent), labs.members
    at, bench = channel_slices(role.channels)[channel], role.workplace
    pushed = np.full(8, bench.end_action)
    if not bench.action_count:
        pushed = np.ones((8, *bench.action_space.shape))
        pushed[:, :2] = 0.5, 0.0  # the piston in, and all reagents
    for _ in range(3):
        for action in (("start", agent, 0, labs.scenario.goals[0]), ("wait",)):
            labs.act(labs.manager.index, everywhere, np.full(8, labs.actions.encode(*action)))
        while len(busy := everywhere[labs.busy[role.number]]):
            assert not np.ptp(labs.observe(role.index, busy)[:, at], axis=0).any()
            labs.act(role.index, busy, pushed[busy])
        if name == "failing":  # some benches may be broken
            return


@pytest.mark.parametrize("name", HIDDEN)
def test_levels_reveal_and_grow(name: str) -> None:
    top, easy, free = load_scenario(name), load_scenario(f"{name}@1"), load_scenario(f"{name}@2")
    assert load_scenario(f"{name}@3") == top
    assert [one.name for one in (easy, free, top)] == [f"{name}@1", f"{name}@2", name]
    assert all(spec.price == 0.0 for one in (easy, free) for spec in one.instruments.values())
    assert any(spec.price > 0.0 for spec in top.instruments.values())
    assert len(easy.shelf.vessel) < len(top.shelf.vessel) or easy.orders < top.orders
    assert (easy.world.revealed, free.world.revealed, top.world.revealed) == (True, False, False)
    assert plain_scenario(easy) == easy.argument == f"{name}@1"
    env = laboratory(easy)  # type: ignore[arg-type]
    labs = env.laboratories
    values = labs.worlds.positions(labs.members)[0]
    assert env.observe("manager_0")[channel_slices(labs.channels)["told"]] == pytest.approx(values, abs=1e-6)
    assert all(channel_slices(bench.channels)["told"] for bench in labs.benches)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("rush@4", r"rush\.toml: level 4: not declared under levels; choose from 1, 2, 3"),
        ("wurtz_dodecane@1", r"level 1: not declared under levels; it has none"),
        ({**mapping("campaign"), "levels": 3}, r"levels: must be tables \[levels\.1\] and \[levels\.2\], given 3"),
        ({**mapping("campaign"), "levels": {"2": {"remove": "costs"}}}, r"levels\.2: remove: must be a list of keys"),
        ({**mapping("campaign"), "levels": {"3": {}}}, r"levels: must be tables \[levels\.1\] and \[levels\.2\]"),
        ({**mapping("campaign"), "name": "campaign@1"}, r"name: 'campaign@1' must not have a level"),
    ],
)
def test_levels_that_do_not_exist_are_refused(given: Any, message: str) -> None:
    with pytest.raises(DataError, match=message):
        load_scenario(given)
