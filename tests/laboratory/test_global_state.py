"""``state()``: the true state of a laboratory, by name, in [0, 1], the same for the same laboratory."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, laboratory, manager, random_legal

from chemlab.config.loading import load_scenario
from chemlab.laboratory import raw_env
from chemlab.roles.bench import channel_slices

ELSEWHERE = {"stream", "drift_stream", "rewards", "cost", "scores", "safety_totals", "illegal", "begun", "recalled"}
ELSEWHERE |= {"measured", "variant", "ready"}
"""Random streams, what the last turn led to, and totals for people: nothing else depends on them; the tick
when a fitter will have gone, of which the state says how many are left."""
PASSING = {"ended", "illegal", "events", "stream", "noise_stream", "places", "changed", "layers", "profile", "image"}
PASSING |= {"elapsed", "told"}
"""The same of experiments; pictures of vessels are worked out anew from them, and what a world tells a bench is the
world's."""


def parts(env: Any) -> dict[str, npt.NDArray[np.float32]]:
    """The state by channel."""
    state = env.state()
    assert env.state_space.contains(state)
    return {name: state[where] for name, where in channel_slices(env.state_channels).items()}


def played(name: str, seed: int, turns: int) -> raw_env:
    """A laboratory after some random turns, with a bench at work."""
    env, rng = laboratory(name, seed), np.random.default_rng(seed)
    scenario, labs = env.scenario, env.laboratories
    goal = scenario.goals[labs.state.goal[0, 0]]
    manager(env, "start", labs.bench_agents[0], 0, goal, *list(scenario.grades)[:1])
    manager(env, "wait")
    for _ in range(turns):
        if env.agent_selection == "manager_0":
            break
        mask = env.infos[env.agent_selection].get("action_mask")
        env.step(random_legal(env.action_space(env.agent_selection), None if mask is None else mask[:-1], rng))
    return env


@pytest.mark.parametrize("name", FEATURED)
def test_it_is_true_by_name(name: str) -> None:
    # No experiment may be over.
    turns = min(4, *(bench.step_limit - 1 for bench in load_scenario(name).benches.values()))
    env = played(name, 0, turns)
    labs, scenario, found = env.laboratories, env.scenario, parts(env)
    litres = np.array([m.molar_mass_g_mol / m.density_kg_l / 1000.0 for m in scenario.materials.values()])
    largest = labs.rules.largest_capacity
    amounts = found["amounts"].reshape(-1, len(litres)) * largest / litres
    np.testing.assert_allclose(amounts, labs.shelf.amounts[0], rtol=1e-6)
    assert amounts.sum() > 0.0
    dissolved = [list(scenario.materials).index(material) for material in labs.shelf.layout.dissolved]
    shares = found.get("dissolved", np.zeros(0)).reshape(labs.shelf.dissolved[0].shape)
    spread = shares * largest / litres[dissolved][:, None]
    np.testing.assert_allclose(spread, labs.shelf.dissolved[0], rtol=1e-6)
    for v, kelvin in enumerate(found["temperature"] * 600.0 + 200.0):
        if found["present"][v]:
            assert kelvin == pytest.approx(labs.shelf.vessel(0, v).temperature_k, rel=1e-6)
            # A piston may be drawn out further than any vessel is large: what is past the bound is at it.
            capacity = min(labs.shelf.vessel(0, v).capacity_l, largest)
            assert found["capacity"][v] * largest == pytest.approx(capacity, rel=1e-6)
            assert found["clock"][v] == pytest.approx(labs.shelf.vessel(0, v).settling, rel=1e-6, abs=1e-7)
    for k, (bottle, full) in enumerate(scenario.stock.items()):
        left = labs.shelf.stock[0, list(scenario.materials).index(bottle)]
        assert found["stock"][k] == pytest.approx(left / full, rel=1e-6)
    bench = labs.bench_agents[0]
    assert found[f"{bench}_busy"] == 1.0
    assert found[f"{bench}_origin"].tolist() == [1.0] + [0.0] * (scenario.shelf.slots - 1)
    assert found[f"{bench}_steps"] == pytest.approx(turns / labs.benches[0].spec.step_limit)
    assert [scenario.goals[g] for g in np.flatnonzero(found[f"{bench}_goal"])] == [
        scenario.goals[labs.state.goal[0, 0]]
    ]
    assert np.flatnonzero(found["turn"]).tolist() == [1]
    assert found["actions"] == pytest.approx(2 / scenario.limits.manager_actions)
    assert found["ticks"] == pytest.approx(turns / scenario.limits.ticks)
    goals = found["goal"].reshape(scenario.orders, -1).argmax(axis=1)
    np.testing.assert_array_equal(goals, labs.state.goal[0])
    assert not found["over"].any()
    np.testing.assert_allclose(found["charges"], labs.charges(labs.members)[0], rtol=1e-6)


@pytest.mark.parametrize("name", ["wurtz_dodecane", "wurtz_two_lines", "failing", "relay"])
def test_nothing_is_missing(name: str) -> None:
    """Whatever array of a running laboratory changes, the state changes with it."""
    env = played(name, 1, 3)
    labs = env.laboratories
    tables: list[tuple[Any, set[str]]] = [(labs.shelf.table, ELSEWHERE), (labs.table, ELSEWHERE)]
    for bench, experiments in zip(labs.benches, labs.experiments, strict=True):
        unused = set() if getattr(bench.options, "jacket_w_k", None) else {"jacket"}
        unused |= {"wear_stream"} if bench.spec.wear else {"gain", "life", "broken", "wear_stream"}
        tables += [(experiments.table, PASSING | unused)] if experiments.busy[0] else []
    assert len(tables) > 2
    before = labs.snapshot()
    whole = env.state()
    checked = 0
    for table, without in tables:
        for field, array in table.arrays._asdict().items():
            one_goal = field == "goal" and len(labs.scenario.goals) == 1
            if field in without or one_goal or not isinstance(array, np.ndarray) or not array.size:
                continue
            kept = array.copy()
            if array.dtype == np.bool_:
                array[...] = ~array
            elif array.dtype.kind == "i":  # at another of the values it may have
                array[...] = np.where(array > 0, array - 1, array + 1)
            else:
                array[...] = 0.9 * array + 0.01
            assert (env.state() != whole).any(), field
            array[...] = kept
            checked += 1
    assert checked > 20
    np.testing.assert_array_equal(env.state(), whole)
    env.step(0 if labs.action_counts[1] else np.full(env.action_space(env.agent_selection).shape, 0.5))
    assert (env.state() != whole).any()
    labs.restore(before)
    np.testing.assert_array_equal(env.state(), whole)
