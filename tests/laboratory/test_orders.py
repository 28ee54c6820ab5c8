"""Several orders, and who is paid what: submissions, endings, the observation's goals, scenario errors, reward mixes.

Contents are put into vessels by hand, so that what a submission is worth has a closed form.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import allowed, choose, laboratory, manager, mapping, slow_but

import chemlab.scenarios
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


# -- submitting -----------------------------------------------------------------------------------------------------


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
    assert outcome["orders"] == [
        {"goal": first, "submitted_mol": pytest.approx(0.5), "purity": pytest.approx(0.5 / 3.5)},
        {"goal": second, "submitted_mol": pytest.approx(0.25), "purity": pytest.approx(0.2)},
    ]
    assert outcome["submitted_mol"] == pytest.approx(0.75)
    assert outcome["purity"] == pytest.approx((0.5 * 0.5 / 3.5 + 0.25 * 0.2) / 0.75)


def test_a_filled_order_is_closed() -> None:
    env = laboratory(LINES)
    manager(env, "measure", 0, "balance")
    assert all(allowed(env, "submit", 0, order) for order in (0, 1))
    assert sum(shown(env, 0)) == sum(shown(env, 1)) == 1.0
    for order, goal in enumerate(goals(env)):
        assert shown(env, order)[env.scenario.goals.index(goal)] == 1.0
    manager(env, "submit", 0, 0)
    assert shown(env, 0) == [0.0] * len(env.scenario.goals)
    assert sum(shown(env, 1)) == 1.0
    assert not any(allowed(env, "submit", slot, 0) for slot in range(env.scenario.shelf.slots))
    assert allowed(env, "submit", 1, 1)
    # The slot is free and forgotten.
    seen, at = env.observe("manager_0"), channel_slices(env.laboratories.channels)
    assert seen[at["slot_0_occupied"]] == 0.0
    assert seen[at["slot_0_balance"]] == 0.0
    assert seen[at["slot_0_balance_age"]] == 1.0
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


@pytest.mark.parametrize("orders", slow_but([1, 2, 3], 2))
def test_random_play_with_orders(orders: int) -> None:
    """Rewards add up to the score, atoms to what there was, and the episode ends when the design says."""
    values = mapping(LINES)
    values["orders"] = orders
    rng = np.random.default_rng(orders)
    filled = []
    for seed in range(10):
        env = laboratory(values, seed)
        labs, begun, paid = env.laboratories, atoms(env), 0.0
        while labs.state.status[0] == 0:
            number = env.possible_agents.index(env.agent_selection)
            open_before = int((~labs.state.filled[0]).sum())
            mask = env.infos[env.agent_selection].get("action_mask")
            if mask is None:
                action: Any = rng.random(env.action_space(env.agent_selection).shape)  # type: ignore[arg-type]
            else:
                legal = np.flatnonzero(mask) if rng.random() < 0.9 else np.arange(len(mask))
                action = int(rng.choice(legal))
            env.step(action)
            paid += env.rewards["manager_0"]
            submitted = number == 0 and labs.actions.table[action, 0] == SUBMIT
            submitted = submitted and not env.infos["manager_0"]["illegal_action"]
            assert open_before - (~labs.state.filled[0]).sum() == submitted
            if submitted:
                # The vessel of the last submission stays where it is, to be looked at.
                standing = (labs.shelf.vessels[0, : env.scenario.shelf.slots, PRESENT] > 0.0).sum()
                nothing = not labs.busy.any() and standing == (labs.state.status[0] == 1)
                assert bool(labs.state.status[0] == 1) is bool(labs.state.filled[0].all() or nothing)
            np.testing.assert_allclose(atoms(env), begun, rtol=1e-9, atol=1e-9)
        assert paid == pytest.approx(labs.result(labs.members)[0], rel=1e-9, abs=1e-12)
        assert (labs.state.submitted[0][~labs.state.filled[0]] == 0.0).all()
        filled.append(int(labs.state.filled[0].sum()))
    assert max(filled) == orders


# -- goals ----------------------------------------------------------------------------------------------------------


def test_goals_of_orders_are_drawn_apart() -> None:
    """Uniformly and independently, and asked-for goals are all orders'."""
    env = laboratory(LINES)
    labs, choices = env.laboratories, env.scenario.lab_goals
    counts = np.zeros((len(choices), len(choices)))
    for _ in range(3600):
        labs.reset(labs.members)
        counts[tuple(choices.index(goal) for goal in goals(env))] += 1
    expected = counts.sum() / counts.size
    assert ((counts - expected) ** 2 / expected).sum() < 80.0  # 35 degrees of freedom: beyond 80 once in 40,000
    env.reset(seed=0, options={"goal": choices[3]})
    assert goals(env) == [choices[3]] * 2


# -- two lines at once ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_scripted_manager_keeps_both_lines_busy() -> None:
    env = raw_env(LINES)
    labs = env.laboratories
    policies = make_policies("scripted", labs)
    kinds = [bench.key for bench in labs.benches]
    together = dict.fromkeys(kinds, 0)

    for seed in range(20):
        both = dict.fromkeys(kinds, 0)

        def watch(turn: Any, both: dict[str, int] = both) -> None:
            for key in set(kinds):
                experiments = [b for b, kind in enumerate(kinds) if kind == key]
                both[key] += bool(labs.busy[experiments, 0].all())

        result = play_episode(env, policies, seed, watch=watch)
        assert result.status == "submitted"
        outcome = labs.outcome()
        assert labs.state.filled[0].all(), f"seed {seed}"
        for order in outcome["orders"]:
            # Its own product, and not the other line's, or what was distilled off.
            assert order["submitted_mol"] > 0.15, f"seed {seed}"
            assert order["purity"] > 0.9, f"seed {seed}"
        assert sum(count > 0 for count in both.values()) >= 1, f"seed {seed}"
        together = {key: together[key] + (both[key] > 0) for key in together}
    # Both reactions, both extractions, both distillations at the same time, in every episode.
    assert together == dict.fromkeys(kinds, 20)


# -- who is paid what -------------------------------------------------------------------------------------------------

NUMBERS = RewardSpec(bench_local=0.25, bench_team=-0.5, manager_local=2.0, manager_team=0.125)
MIXES: list[Any] = ["individual", "cooperative", "mixed", NUMBERS]


def mix_of(rewards: Any) -> RewardSpec:
    """The numbers of a mix."""
    return REWARD_MIXES[rewards] if isinstance(rewards, str) else rewards


@pytest.mark.parametrize(("name", "rewards"), list(zip([LINES, "wurtz_safe"] * 2, MIXES, strict=True)), ids=str)
def test_returns_are_the_mix(name: str, rewards: Any) -> None:
    """Of the scores and the result that are reported."""
    mix, env, rng = mix_of(rewards), parallel_env(name, rewards=rewards), np.random.default_rng(4)
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


def test_mixes_by_name_number_and_file(tmp_path: Path) -> None:
    """The same numbers, however they are given."""
    assert set(REWARD_MIXES) == {"individual", "cooperative", "mixed"}
    for name, mix in REWARD_MIXES.items():
        values = mapping(LINES)
        values["rewards"] = name
        assert load_scenario(values).rewards == mix
        text = Path(chemlab.scenarios.__path__[0], f"{LINES}.toml").read_text(encoding="utf-8")
        file = tmp_path / f"{name}.toml"
        file.write_text(f'rewards = "{name}"\n{text}', encoding="utf-8")
        assert load_scenario(file).rewards == mix
        assert raw_env(LINES, rewards=name).scenario.rewards == mix
        assert raw_env(LINES, rewards=mix).scenario.rewards == mix
        assert raw_env(LINES, rewards=mix.model_dump()).scenario.rewards == mix  # type: ignore[arg-type]
        # Everything else is the scenario's.
        changed = load_scenario(LINES).configured(rewards=name)
        assert changed.materials == load_scenario(LINES).materials
        assert changed.model_dump(exclude={"rewards"}) == load_scenario(LINES).model_dump(exclude={"rewards"})
    # One result for everybody means the same return for everybody.
    assert mix_of("cooperative") == RewardSpec(bench_local=0.0, bench_team=1.0, manager_local=0.0, manager_team=1.0)
    assert all(load_scenario(name).rewards == REWARD_MIXES["individual"] for name in scenario_names())


@pytest.mark.parametrize("rewards", ["selfish", "Cooperative", "", 3, ["mixed"], {"bench": 1.0}, {"bench_local": "x"}])
def test_unknown_mixes_are_refused(rewards: Any) -> None:
    makers: list[Any] = [
        lambda: raw_env(LINES, rewards=rewards),
        lambda: parallel_env(LINES, rewards=rewards),
        lambda: BatchedLaboratory(2, LINES, rewards=rewards),
        lambda: role_env(LINES, rewards=rewards),
        lambda: role_vector_env(2, LINES, rewards=rewards),
    ]
    given = f"{rewards!r}.*individual, cooperative, mixed" if isinstance(rewards, str) else "reward"
    for make in makers:
        with pytest.raises(ValueError, match=given):
            make()
