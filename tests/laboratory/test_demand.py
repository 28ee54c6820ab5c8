"""Orders that come over time, against closed forms: when they are seen, what they pay; shelves that react."""

import math
import re
from typing import Any

import numpy as np
import pytest
from helpers import allowed, laboratory, manager, mapping, refused

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.describe import description, goal_words, order_table
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import RoleText
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_state import CLOSED, RUNNING
from chemlab.roles.manager_view import terms_channels


def shop(*orders: dict[str, float], **demand: Any) -> dict[str, Any]:
    """A campaign's laboratory with orders over time: three moles of four in the first vessels, nothing drawn."""
    values = mapping("campaign")
    values |= {"orders": len(orders), "specifications": {}, "demand": {"order": list(orders), **demand}, "world": {}}
    values["limits"]["ticks"] = 100
    for vessel in values["shelf"]["vessel"]:
        vessel["contents"] = {"2-chlorohexane": 3.0, "1-chlorohexane": 1.0}
    return values


def seen(env: raw_env, order: int) -> list[float]:
    """What the manager sees of an order: whether it is open, then its terms."""
    slices, shown = channel_slices(env.laboratories.channels), env.observe("manager_0")
    names = [f"goal_{order}", *terms_channels(f"goal_{order}")]
    return [float(shown[slices[name]][0]) for name in names]


def test_an_order_is_seen_once_it_has_come() -> None:
    env = laboratory(shop({"arrives": 0, "within": 40, "price": 1}, {"arrives": 7, "within": 20, "price": 3}))
    assert seen(env, 0) == pytest.approx([1.0, 1.0, 1 / 3, 0.0, 0.0])
    assert seen(env, 1) == [0.0] * 5
    assert allowed(env, "submit", 0, 0)
    assert not allowed(env, "submit", 0, 1)
    manager(env, "wait")  # nobody is busy: until the order comes
    assert env.laboratories.state.ticks[0] == 7
    assert seen(env, 0) == pytest.approx([1.0, 33 / 40, 1 / 3, 0.0, 0.0])
    assert seen(env, 1) == pytest.approx([1.0, 0.5, 1.0, 0.0, 0.0])
    assert allowed(env, "submit", 0, 1)
    # One that comes while benches work gives the manager the turn.
    env = laboratory(shop({}, {"arrives": 3}))
    manager(env, "start", "rxn_0", 0, "2-chlorohexane")
    manager(env, "wait")
    while env.agent_selection != "manager_0":
        env.step(np.full(3, 0.5, dtype=np.float32))
    assert env.laboratories.state.ticks[0] == 3
    assert env.laboratories.busy[0, 0]
    # In the tick of its deadline, an order is not late.
    env = laboratory(shop({"within": 7}, {"arrives": 7}))
    manager(env, "wait")
    assert "0: 2-chlorohexane now or earlier 1" in RoleText(env.laboratories, 0).text(env.observe("manager_0"))
    manager(env, "submit", 0, 0)
    assert env.laboratories.state.paid[0, 0] == 1.0


@pytest.mark.parametrize(
    ("terms", "demand", "wait", "paid"),
    [
        ({"within": 5, "price": 3}, {"late": 0.4}, True, 1.2),
        ({"amount_at_least_mol": 2.999, "price": 3}, {}, False, 3.0),
        ({"amount_at_least_mol": 3.001, "price": 3}, {}, False, 0.0),
        ({"purity_at_least": 0.751, "price": 3}, {"short": 0.25}, False, 0.75),
        ({"within": 5, "purity_at_least": 0.751}, {"late": 0.5, "short": 0.5}, True, 0.25),
    ],
)
def test_what_an_order_pays(terms: dict[str, float], demand: dict[str, float], wait: bool, paid: float) -> None:
    """The price, or the share of it that the file says; a third of the score for one of three orders."""
    env = laboratory(shop(terms, {"arrives": 50}, {"arrives": 60}, **demand))
    if wait:
        manager(env, "wait")  # until it is late
        assert env.laboratories.state.ticks[0] == 6
    labs = env.laboratories
    manager(env, "submit", 0, 0)
    assert labs.rewards[0, 0] == pytest.approx(paid / 3.0, rel=1e-12)
    costs = labs.charges(labs.members).sum()
    assert labs.result(labs.members)[0] == pytest.approx(paid / 3.0 - costs, rel=1e-12)


def test_terms_are_described() -> None:
    labs = laboratory(shop({"within": 5, "price": 3}, {"arrives": 50}, late=0.4, missed=0.1)).laboratories
    told = " ".join(goal_words(labs.scenario))
    assert re.search("0.4 of it if that is late, and nothing if.*pays nothing costs 0.1 of its price", told)
    assert order_table(labs.scenario).rows[0] == ("order 0", "0", "5", "3", "0", "0")
    assert description(labs)["demand"]["late"] == 0.4
    assert "less 0.1 x price" in labs.manager.workplace.score_meaning


def test_a_vessel_without_the_goal_pays_nothing_whatever_the_file_says() -> None:
    values = shop({"amount_at_least_mol": 1.0}, {"arrives": 50}, late=1.0, short=1.0)
    values["shelf"]["vessel"][0]["contents"] = {"1-chlorohexane": 1.0}
    env = laboratory(values)
    manager(env, "submit", 0, 0)
    assert env.laboratories.state.paid[0, 0] == 0.0


def test_an_episode_is_over_when_no_order_can_be_met() -> None:
    """Where late pays it goes on, and nobody waits for nothing."""
    env = laboratory(shop({"within": 5}, {"arrives": 10, "within": 5}))
    labs = env.laboratories
    manager(env, "wait")  # the first is late
    assert (labs.state.ticks[0], labs.state.status[0]) == (6, RUNNING)
    manager(env, "wait")  # the second comes
    manager(env, "wait")
    assert (labs.state.ticks[0], labs.state.status[0]) == (16, CLOSED)
    env = laboratory(shop({"within": 5}, late=0.5))
    manager(env, "wait")
    assert not allowed(env, "wait")
    assert allowed(env, "submit", 0)


def test_vessels_on_the_shelf_go_on_reacting_where_the_scenario_says_so() -> None:
    """A first-order decay at the temperature of the room, for as long as the manager waits."""
    values = shop({}, {"arrives": 30}, {"arrives": 60})
    values["shelf"]["tick"] = 40.0
    env = laboratory(values)
    labs = env.laboratories
    at = labs.shelf.layout.index("3-chlorohexane")
    first, second = (factor * math.exp(-85000.0 / (8.314462618 * 298.15)) * 40.0 for factor in (4.86e12, 4.86e11))
    for ticks in (30, 60):
        manager(env, "wait")
        left, kept = math.exp(-first * ticks), math.exp(-second * ticks)
        middle = 3.0 * kept + first / (second - first) * (left - kept)
        assert labs.shelf.amounts[0, 0, at] == pytest.approx(4.0 - left - middle, rel=5e-3)


def test_terms_are_drawn() -> None:
    labs = Laboratories("rush", 3, split="test")
    labs.begin(5)
    for member in range(3):
        drawn = labs.worlds.values(member)
        for which, key in enumerate(("arrives", "within", "price", "amount")):
            own = [drawn[key][f"order_{o}"] for o in range(labs.scenario.orders)]
            assert labs.state.terms[member, :, which].tolist() == own


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("orders", 2, "demand.order: must have one for each of orders = 2, given"),
        ("draw", {"of": ["order_9"]}, "world.draws.within.of: unknown order 'order_9'"),
        ("draw", {"distribution": {"kind": "normal", "mean": 0.0, "sd": 1.0}}, "within: Input should be"),
        ("draw", {"of": []}, "name at least one order"),
    ],
)
def test_orders_that_cannot_be_are_refused(key: str, value: Any, message: str) -> None:
    values = mapping("rush")
    if key == "draw":
        values["world"]["draws"]["within"] |= value
    else:
        values[key] = value
    with pytest.raises(DataError, match=message):
        load_scenario(values)


def test_a_wait_that_nothing_could_interrupt_for_minutes_is_refused() -> None:
    values = shop({"arrives": 1e6})
    values["limits"]["ticks"] = 1_000_000 // values["shelf"]["slots"]
    load_scenario(values)
    values["limits"]["ticks"] += 1
    with pytest.raises(DataError, match=r"limits\.ticks x shelf\.slots: .* at most 1000000"):
        load_scenario(values)
    load_scenario(values | {"demand": {}, "orders": 1})


@pytest.mark.parametrize("key", ["arrives", "within", "price", "amount_at_least_mol", "purity_at_least"])
def test_terms_are_numbers_within_bounds(key: str) -> None:
    for number in (-1.0, 1e9, math.inf, math.nan, "soon", *([] if key == "within" else [None])):
        refused(rf"demand\.order\.0\.{key}: ", load_scenario, shop({key: number}))


def test_there_are_as_many_orders_as_a_laboratory_may_have() -> None:
    assert len(refused("at most 16", load_scenario, shop(*[{"arrives": 0.0}] * 5000))) < 2000
