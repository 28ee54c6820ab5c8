"""Campaigns: recipes run in the laboratory come to what the published equations give, and cost what they say."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused
from scipy.integrate import solve_ivp

from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.campaign import Campaign, Choice, Range
from chemlab.config.inherit import campaign_names
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories

RECIPES = Path(__file__).parent.parent / "recipes" / "campaigns"
GOOD: dict[str, Any] = {"catalyst": "catalyst_c", "percent": 1.5, "equivalents": 1.3, "temperature_k": 378.0}
GOOD["minutes"] = 20
NEEDS = {"optuna_tpe": "optuna", "baybe_gp": "baybe", "ax_client": "ax"}


def published(campaign: Campaign, recipe: dict[str, Any]) -> tuple[float, float]:
    """Return (amount in mol, purity) by the publication's equations with the hidden factors of a world."""
    drawn: dict[str, Any] = dict(campaign._labs.worlds.values(0))
    factors = (drawn["catalysts"], drawn["second"])
    (extra,), (second,) = ([x for step, x in own.items() if recipe["catalyst"] in step] for own in factors)
    heat = 8.314462618 * recipe["temperature_k"]
    vessel = campaign.scenario.shelf.vessel[0].contents
    charge = {**vessel, "boronate": 0.167 * recipe["equivalents"], recipe["catalyst"]: 0.00167 * recipe["percent"]}
    known = campaign.scenario.materials
    litres = sum(mol * known[name].molar_mass_g_mol / known[name].density_kg_l / 1e3 for name, mol in charge.items())
    root = math.sqrt(charge[recipe["catalyst"]] / litres)
    numbers = (3.1e7 * drawn["coupling"], 55e3 + extra), (1e12, 100e3 + drawn["loss"]), (3.1e5 * second, 50e3)
    k = [a * root * math.exp(-energy / heat) for a, energy in numbers]

    def change(_: float, c: Any) -> list[float]:
        made, lost, second = k[0] * c[0] * c[1], k[1] * c[1], k[2] * c[1] * c[2]
        return [-made, -made - lost - second, made - second, lost, second]

    start = [0.167 / litres, charge["boronate"] / litres, 0.0, 0.0, 0.0]
    end = solve_ivp(change, (0.0, 60.0 * recipe["minutes"]), start, rtol=1e-9, atol=1e-12).y[:, -1]
    return float(end[2] * litres), float(end[2] / end.sum())


@pytest.mark.parametrize(
    "change", [{}, {"catalyst": "catalyst_a", "temperature_k": 395.0}, {"equivalents": 2.0, "percent": 0.7}], ids=repr
)
def test_a_recipe_comes_to_what_the_published_equations_give(change: dict[str, Any]) -> None:
    """Twenty minutes at temperature: nothing is left to the cooling of the last turn."""
    recipe = {**GOOD, **change}
    campaign = Campaign(seed=1)
    amount, purity = published(campaign, recipe)
    spent = 0.002 * 0.167 * recipe["equivalents"] + 0.00167 * recipe["percent"]
    assert campaign.true_value(**recipe) == pytest.approx(amount * purity / 0.167 - 8 * spent, abs=2e-3)
    results = [campaign.run(**recipe) for _ in range(8)]
    assert np.mean([result.amount_mol for result in results]) == pytest.approx(amount, rel=0.05)
    assert np.mean([result.purity for result in results]) == pytest.approx(purity, rel=0.05)
    assert results[0].reagents == pytest.approx(spent, rel=1e-6)
    assert len({result.amount_mol for result in results}) == 8, "readings have noise"


def test_less_time_makes_less() -> None:
    campaign = Campaign(seed=4)
    values = campaign.true_values([{**GOOD, "temperature_k": 330.0, "minutes": minutes} for minutes in (1, 5, 20)])
    assert values[0] < values[1] < values[2]


def test_no_temperature_is_the_best_in_all_worlds() -> None:
    best = []
    for seed in range(6):
        campaign = Campaign(seed=seed, split="test")
        names, kelvin = campaign.space["catalyst"].options, np.arange(310.0, 403.0, 10.0)  # type: ignore[union-attr]
        recipes = [{**GOOD, "catalyst": name, "temperature_k": float(t)} for t in kelvin for name in names]
        values = campaign.true_values(recipes).reshape(len(kelvin), -1)
        best.append(float(kelvin[int(values.max(axis=1).argmax())]))
    assert max(best) - min(best) >= 40.0


def test_two_at_once_take_the_time_of_one_and_cost_what_the_laboratory_charges() -> None:
    campaign = Campaign(seed=2)
    pair = campaign.run_batch(iter([GOOD, {**GOOD, "catalyst": "catalyst_d"}]))
    assert [result.ticks for result in pair] == [20, 20]
    assert [result.slot for result in pair] == [0, 1]
    assert campaign.left == 22
    costs = campaign._labs.charges(campaign._labs.members)[0]
    assert costs.sum() == pytest.approx(sum(r.reagents + r.measuring for r in pair) + 20 * 0.0001)
    campaign.run_batch([GOOD] * 22)
    assert campaign.left == 0
    refused("0 vessels are left", campaign.run, **GOOD)
    outcome = campaign.finish()
    assert campaign.left == 0
    orders = campaign._labs.outcome()["orders"]
    worth = sum(order["submitted_mol"] * order["purity"] / 0.167 for order in orders) / 8
    assert outcome == pytest.approx(worth - campaign._labs.charges(campaign._labs.members).sum())


def test_a_seed_is_a_world_and_its_noise() -> None:
    one, same, other = (Campaign(seed=seed).run(**GOOD) for seed in (1, 1, 2))
    assert one == same
    assert one.value != other.value
    assert Campaign(seed=1).true_values([]).shape == (0,)


def test_what_cannot_be_is_refused() -> None:
    """And a campaign that has orders left is finished once."""
    refused("seed: must be an integer of at least 0", Campaign, seed=-1)
    refused("scenario: crude must have reaction benches only", Campaign, "crude")
    campaign = Campaign(seed=2)
    with pytest.raises(ValueError, match=r"recipe 0: takes the parameters .*; given 'catalyst'"):
        campaign.run_batch(GOOD)  # type: ignore[arg-type]
    campaign.run(**GOOD)
    assert campaign.finish() == campaign.finish()
    refused("0 vessels are left", campaign.run, **GOOD)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"catalyst": "platinum"}, "catalyst: choose from catalyst_a, .*; given 'platinum'"),
    ({"catalyst": np.array(["catalyst_a", "catalyst_b"])}, "catalyst: choose from catalyst_a, .*; given array"),
    ({"percent": True}, "percent: from 0.5 to 2.5; given True"),
    ({"temperature_k": 500.0}, "temperature_k: from 303.15 to 403.15; given 500.0"),
    ({"percent": float("nan")}, "percent: from 0.5 to 2.5; given nan"),
    ({"percent": [1.0]}, r"percent: from 0.5 to 2.5; given \[1.0\]"),
    ({"minutes": 2.5}, "minutes: a whole number; given 2.5"),
    ({"minutes": "2"}, "minutes: from 1 to 20; given '2'"),
    ({"pressure": 1.0}, "takes the parameters catalyst, .*; given catalyst, "),
]


def test_wrong_recipes_change_nothing() -> None:
    campaign = Campaign(seed=1)
    before = campaign._labs.snapshot()
    for change, message in WRONG:
        refused(message, campaign.run, **{**GOOD, **change})
        assert campaign.left == 24
        for one, other in zip(before, campaign._labs.snapshot(), strict=True):
            np.testing.assert_array_equal(one, other)  # NaN is NaN


def test_values_in_many_worlds_are_those_of_each() -> None:
    """Whichever vessel is used, and however many there were before."""
    labs = Laboratories("optimize_coupling", 3)
    labs.begin()
    campaign, other = Campaign(), {**GOOD, "catalyst": "catalyst_a"}
    campaign.values_in(labs, [other] * 3, 4)
    values = campaign.values_in(labs, [GOOD, other, GOOD], 23)
    alone = [Campaign(seed=n).true_value(**recipe) for n, recipe in enumerate((GOOD, other, GOOD))]
    np.testing.assert_allclose(values, alone, rtol=1e-12)
    refused("one for each of 3 laboratories; given 1", campaign.values_in, labs, [GOOD])


def test_the_space_is_the_scenarios() -> None:
    space = Campaign().space
    assert space["catalyst"] == Choice(tuple(f"catalyst_{letter}" for letter in "abcde"))
    assert space["minutes"] == Range(1.0, 20.0, 1)
    assert space["equivalents"] == Range(pytest.approx(0.6), pytest.approx(3.0))


@pytest.mark.parametrize("name", [f"{name}{level}" for name in campaign_names() for level in ("", "@2", "@1")])
def test_scripted_agents_beat_random_play(name: str) -> None:
    def score(policy: str, seed: int) -> float:
        env = raw_env(load_scenario(name))
        return play_episode(env, make_policies(policy, env.laboratories, seed), seed, policy).score

    assert np.mean([score("scripted", s) for s in range(2)]) > np.mean([score("random", s) for s in range(2)]) + 0.2


@pytest.mark.parametrize(
    "name", [path.stem for path in sorted(RECIPES.glob("*.py")) if path.stem not in ("regret", "learned")]
)
def test_optimizers_use_every_vessel(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The contract of every recipe, on a small campaign."""
    pytest.importorskip(NEEDS.get(name, "scipy"), reason="needs its optimizer")
    monkeypatch.syspath_prepend(str(RECIPES))
    few = {"base": "optimize_coupling", "name": "few", "orders": 2}
    vessels = [{"capacity_l": 1.5, "contents": {"medium": 9.9, "halide": 0.167}}] * 8
    campaign = Campaign(load_scenario({**few, "shelf": {"vessel": vessels}}), seed=0)
    module = __import__(name)
    try:
        module.optimize(campaign, 0)
    finally:
        sys.modules.pop(name, None)
    assert campaign.left == 0
    assert len(campaign.results) == 8


def test_the_table_of_regrets_is_that_of_the_stored_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(RECIPES))
    from regret import fixed_table, table

    found = json.loads((RECIPES / "results.json").read_text(encoding="utf-8"))
    page = (RECIPES.parents[1] / "docs" / "chemist" / "campaign.md").read_text(encoding="utf-8")
    assert "\n".join(table(found)) in page, "write it: regret.py --only --out results.json"
    assert "\n".join(fixed_table(found)) in page
