"""Several orders, and who is paid what: submissions, endings, the observation's goals, reward mixes."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from helpers import allowed, choose, laboratory, manager, mapping, refused

from chemlab.agents.background import role_env, role_vector_env
from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import REWARD_MIXES, RewardSpec
from chemlab.envs.aec import raw_env
from chemlab.envs.batch import BatchedLaboratory
from chemlab.laboratory import parallel_env
from chemlab.physics.chemistry import PRESENT, element_matrix
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import SUBMIT

LINES = "wurtz_two_lines"


def goals(env: raw_env) -> list[str]:
    """What each order asks for."""
    return [env.scenario.goals[goal] for goal in env.laboratories.state.goal[0]]


def shown(env: raw_env, order: int) -> list[float]:
    """The goal channel of an order."""
    return env.observe("manager_0")[channel_slices(env.laboratories.channels)[f"goal_{order}"]].tolist()


def atoms(env: raw_env) -> Any:
    """Atoms of each element, and charge: in vessels, bottles, waste, and delivered."""
    labs = env.laboratories
    return element_matrix(env.scenario) @ (labs.shelf.total()[0] + labs.state.delivered[0])


def test_each_submission_is_paid_when_it_is_made_and_costs_at_the_end() -> None:
    env = laboratory(LINES)
    labs, scenario = env.laboratories, env.scenario
    first, second = goals(env)
    labs.shelf.fill(0, 0, 1.2, {"diethyl_ether": 3.0, first: 0.5})
    labs.shelf.fill(0, 1, 1.2, {"diethyl_ether": 1.0, second: 0.25})
    begun = atoms(env)
    maximum = scenario.theoretical_maximum_mol
    manager(env, "measure", 0, "balance")
    assert env.rewards["manager_0"] == 0.0
    manager(env, "submit", 1, 1)
    # A quarter of a mole, a fifth pure, of one of two orders; costs are not due yet.
    worth = 0.25 * (0.25 / 1.25) / maximum[second] / 2
    assert env.rewards["manager_0"] == pytest.approx(worth, rel=1e-12)
    assert not any(env.terminations.values())
    assert labs.shelf.vessel(0, 1).amounts() == {}
    delivered = dict(zip(scenario.materials, labs.state.delivered[0].tolist(), strict=True))
    assert {name: mol for name, mol in delivered.items() if mol} == pytest.approx({"diethyl_ether": 1.0, second: 0.25})
    np.testing.assert_allclose(atoms(env), begun, rtol=1e-12, atol=1e-12)
    manager(env, "submit", 0, 0)
    last = 0.5 * (0.5 / 3.5) / maximum[first] / 2
    costs = scenario.instruments["balance"].price
    assert env.rewards["manager_0"] == pytest.approx(last - costs, rel=1e-12)
    assert labs.result(labs.members)[0] == pytest.approx(worth + last - costs, rel=1e-12)
    assert all(env.terminations.values())
    np.testing.assert_allclose(atoms(env), begun, rtol=1e-12, atol=1e-12)
    info = env.infos["manager_0"]
    assert [scenario.goals[goal] for goal in info["goals"]] == [first, second]
    assert info["submitted_mol"] == pytest.approx([0.5, 0.25])
    assert info["purity"] == pytest.approx([0.5 / 3.5, 0.2])
    outcome = labs.outcome()
    assert [tuple(order.values()) for order in outcome["orders"]] == [
        (first, pytest.approx(0.5), pytest.approx(0.5 / 3.5)),
        (second, pytest.approx(0.25), pytest.approx(0.2)),
    ]
    assert outcome["submitted_mol"] == pytest.approx(0.75)
    assert outcome["purity"] == pytest.approx((0.5 * 0.5 / 3.5 + 0.25 * 0.2) / 0.75)


def test_a_filled_order_is_closed() -> None:
    env = laboratory(LINES)
    assert all(allowed(env, "submit", 0, order) for order in (0, 1))
    assert sum(shown(env, 0)) == sum(shown(env, 1)) == 1.0
    for order, goal in enumerate(goals(env)):
        assert shown(env, order)[env.scenario.goals.index(goal)] == 1.0
    manager(env, "submit", 0, 0)
    assert shown(env, 0) == [0.0] * len(env.scenario.goals)
    assert sum(shown(env, 1)) == 1.0
    assert not any(allowed(env, "submit", slot, 0) for slot in range(env.scenario.shelf.slots))
    assert allowed(env, "submit", 1, 1)
    # The slot is free; what it shows then: test_observability.py.
    assert env.observe("manager_0")[channel_slices(env.laboratories.channels)["slot_0_occupied"]] == 0.0
    # Submitting for it again is a lost turn.
    before = env.laboratories.state.submitted.copy()
    env.step(env.laboratories.actions.encode("submit", 1, 0))
    assert env.infos["manager_0"]["illegal_action"]
    np.testing.assert_array_equal(env.laboratories.state.submitted, before)
    assert not any(env.terminations.values())


def test_without_a_vessel_left_there_is_nothing_to_wait_for() -> None:
    """The last vessel on the shelf ends the episode, though an order is open; with a bench at work it does not."""
    env = laboratory(LINES)
    manager(env, "discard", 1)
    manager(env, "submit", 0, 1)
    assert all(env.terminations.values())
    assert env.infos["manager_0"]["submitted_mol"].tolist() == [0.0, 0.0]
    busy = laboratory(LINES)
    manager(busy, "start", "rxn_1", 0, goals(busy)[0])
    manager(busy, "submit", 1, 0)
    assert not any(busy.terminations.values())
    # Nothing on the shelf to submit, discard or measure; but to wait for, and to recall.
    legal = {busy.laboratories.actions.decode(int(a)) for a in np.flatnonzero(busy.infos["manager_0"]["action_mask"])}
    assert legal == {("wait",), ("recall", "rxn_1")}
    manager(busy, "recall", "rxn_1")
    manager(busy, "submit", 0, 1)
    assert all(busy.terminations.values())


def test_random_play_with_orders() -> None:
    """Atoms are what there was, and the episode ends when the design says."""
    rng = np.random.default_rng(2)
    filled = []
    for seed in range(10):
        env = laboratory(LINES, seed)
        labs, begun = env.laboratories, atoms(env)
        while labs.state.status[0] == 0:
            number = env.possible_agents.index(env.agent_selection)
            open_before = int((~labs.state.filled[0]).sum())
            action = choose(labs, number, 0, rng, bold=0.1, submit=0.02)
            env.step(action)
            submitted = number == 0 and labs.actions.table[action, 0] == SUBMIT
            submitted = submitted and not env.infos["manager_0"]["illegal_action"]
            assert open_before - (~labs.state.filled[0]).sum() == submitted
            if submitted:
                # The vessel of the last submission stays where it is, to be looked at.
                standing = (labs.shelf.vessels[0, : env.scenario.shelf.slots, PRESENT] > 0.0).sum()
                nothing = not labs.busy.any() and standing == (labs.state.status[0] == 1)
                assert bool(labs.state.status[0] == 1) is bool(labs.state.filled[0].all() or nothing)
            np.testing.assert_allclose(atoms(env), begun, rtol=1e-9, atol=1e-9)
        assert (labs.state.submitted[0][~labs.state.filled[0]] == 0.0).all()
        filled.append(int(labs.state.filled[0].sum()))
    assert max(filled) == 2


def test_goals_of_orders_are_drawn_apart() -> None:
    """Uniformly and independently, in the first episodes of seeds and in the next; asked-for goals are all orders'."""
    env = laboratory(LINES)
    labs, choices = env.laboratories, env.scenario.lab_goals
    counts = np.zeros((2, len(choices), len(choices)))
    for seed in range(3600):
        labs.seed(0, seed)
        for episode in range(2):
            labs.reset(labs.members)
            counts[(episode, *(choices.index(goal) for goal in goals(env)))] += 1
    expected = 3600 / len(choices) ** 2
    # 35 degrees of freedom: beyond 80 once in 40,000
    assert (((counts - expected) ** 2 / expected).sum(axis=(1, 2)) < 80.0).all()
    env.reset(seed=0, options={"goal": choices[3]})
    assert goals(env) == [choices[3]] * 2


@pytest.mark.slow
def test_the_scripted_manager_keeps_both_lines_busy() -> None:
    """Both reactions, both extractions, both distillations at the same time, in every episode."""
    env = raw_env(LINES)
    labs = env.laboratories
    policies = make_policies("scripted", labs)
    kinds = [bench.key for bench in labs.benches]
    for seed in range(6):
        together = set()

        def watch(turn: Any, together: set[str] = together) -> None:
            together |= {key for key in kinds if labs.busy[[kind == key for kind in kinds], 0].all()}

        assert play_episode(env, policies, seed, watch=watch).status == "submitted"
        assert together == set(kinds), f"seed {seed}"
        assert labs.state.filled[0].all(), f"seed {seed}"
        for order in labs.outcome()["orders"]:
            # Its own product, and not the other line's, or what was distilled off.
            assert order["submitted_mol"] > 0.15, f"seed {seed}"
            assert order["purity"] > 0.9, f"seed {seed}"


@pytest.mark.parametrize("name", [LINES, "wurtz_safe"])
def test_returns_are_the_mix(name: str) -> None:
    """Of the scores and the result that are reported."""
    mix = RewardSpec(bench_local=0.25, bench_team=-0.5, manager_local=2.0, manager_team=0.125)
    env, rng = parallel_env(name, rewards=mix), np.random.default_rng(4)
    scenario, labs, agents = env.scenario, env.laboratories, env.possible_agents
    for seed in range(3):
        _, infos = env.reset(seed=seed)
        paid, scores, lost = (dict.fromkeys(agents, 0.0) for _ in range(3))
        while env.agents:
            turn = [agent for agent in agents if infos[agent]["has_turn"]]
            actions = {agent: choose(labs, agents.index(agent), 0, rng, submit=0.02) for agent in turn}
            _, rewarded, *_, infos = env.step(actions)
            for agent in agents:
                paid[agent] += rewarded[agent]
                scores[agent] += infos[agent]["score"]
                lost[agent] += scenario.safety.reward_price * infos[agent]["cost"]
                lost[agent] += scenario.costs.illegal_action * infos[agent]["illegal_action"]
        result = float(labs.result(labs.members)[0])
        for agent, total in paid.items():
            # What lost turns and priced accidents take off is not mixed.
            expected = mix.bench_local * scores[agent] - lost[agent] + mix.bench_team * result
            if agent == "manager_0":
                expected = (mix.manager_local + mix.manager_team) * result
            assert total == pytest.approx(expected, rel=1e-9, abs=1e-12), agent


def test_mixes_by_name_number_and_file() -> None:
    """The same numbers, however they are given."""
    assert set(REWARD_MIXES) == {"individual", "cooperative", "mixed"}
    plain = load_scenario(LINES)
    for name, mix in REWARD_MIXES.items():
        assert load_scenario(mapping(LINES) | {"rewards": name}).rewards == mix
        for given in (name, mix, mix.model_dump()):
            assert raw_env(LINES, rewards=given).scenario.rewards == mix  # type: ignore[arg-type]
        # Everything else is the scenario's.
        changed = plain.configured(rewards=name)
        assert changed.materials == plain.materials
        assert changed.model_dump(exclude={"rewards"}) == plain.model_dump(exclude={"rewards"})
    # One result for everybody means the same return for everybody.
    numbers = {"bench_local": 0.0, "bench_team": 1.0, "manager_local": 0.0, "manager_team": 1.0}
    assert REWARD_MIXES["cooperative"].model_dump() == numbers
    assert all(load_scenario(name).rewards == REWARD_MIXES["individual"] for name in scenario_names())


@pytest.mark.parametrize("rewards", ["selfish", ["mixed"], {"bench": 1.0}, {"bench_local": "x"}])
def test_unknown_mixes_are_refused(rewards: Any) -> None:
    given = f"{rewards!r}.*individual, cooperative, mixed" if isinstance(rewards, str) else "reward"
    for make in (raw_env, parallel_env, partial(BatchedLaboratory, 2), role_env, partial(role_vector_env, 2)):
        refused(given, make, LINES, rewards=rewards)
