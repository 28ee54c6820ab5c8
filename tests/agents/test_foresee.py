"""The manager that foresees: recipes, beliefs about vessels and what they share, when it looks."""

import itertools
from typing import Any

import numpy as np
import pytest
from helpers import mapping
from scipy.stats import norm

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies, scripted_bench, scripted_manager
from chemlab.agents.scripted.foresee import ForeseeingManager, _foreseen, _public, _sizes, _stages, foresees
from chemlab.agents.scripted.script import likelihood
from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from chemlab.roles.manager_state import INSTRUMENTS


def test_recipes_keep_the_order_of_the_benches() -> None:
    wash, cut, strip, react = ("ext_0", "p"), ("dit_0", "p"), ("dit_0", "q"), ("rxn_0", "p")
    expected = [(), (wash,), (cut,), (strip,), (wash, cut), (wash, strip)]
    assert list(_stages([(wash, 1), (cut, 1), (strip, 1)])) == expected
    # Up to three reactions, and then a wash or none.
    found = list(_stages([(react, 3), (wash, 1)]))
    assert sorted(map(len, found)) == [0, 1, 1, 2, 2, 3, 3, 4]
    assert all(stage[:-1] in found for stage in found if stage)


def test_what_vessels_share_is_weighed_as_the_sum_over_all_worlds_has_it() -> None:
    """Two vessels, three worlds of what they share, four of what each has: Bayes by enumeration."""
    manager: Any = object.__new__(ForeseeingManager)
    likely = np.random.default_rng(0).random((2, 3, 4))
    expected = np.zeros((2, 3, 4))
    for s, first, second in itertools.product(range(3), range(4), range(4)):
        together = likely[0, s, first] * likely[1, s, second]
        expected[0, s, first] += together
        expected[1, s, second] += together
    expected /= expected.sum(axis=(1, 2), keepdims=True)
    assert manager._posterior(likely) == pytest.approx(expected.reshape(2, 12), rel=1e-12)


def test_it_is_for_worlds_of_numbers_in_vessels_that_are_alike() -> None:
    assert foresees(load_scenario("crude"))
    assert isinstance(scripted_manager(Laboratories("crude")), ForeseeingManager)
    assert foresees(load_scenario("selectivity"))
    # Six vessels have nothing in common; rate constants are the same in all three solutions, strengths are not.
    assert (_sizes(load_scenario("crude")), _sizes(load_scenario("selectivity"))) == ((1, 512), (12, 32))
    values = mapping("crude")
    values["shelf"]["vessel"][0]["contents"]["NaCl"] = 0.2
    assert not foresees(load_scenario(values))
    assert not any(foresees(load_scenario(name)) for name in ("unlabelled", "campaign", "wurtz_real"))


def test_what_is_foreseen_of_crude_product_is_what_its_contents_say() -> None:
    """Nothing for nothing; washes take no more dodecane than there is; salt left in keeps a vessel impure."""
    scenario = load_scenario("crude")
    seen = _foreseen(_public(scenario), "dodecane", "gas_chromatograph", (), scripted_bench)
    names = {stage: k for k, stage in enumerate(seen.stages)}
    wash, cut = ("ext_0", "dodecane"), ("dit_0", "dodecane")
    assert (seen.costs[:, 0] == 0.0).all()
    assert (seen.costs[:, 1:] > 0.0).all()
    salty = seen.readings[:, 0, len(Laboratories(scenario).instruments.analytes[0])] > 0.15
    assert salty.any()
    assert (seen.worth[salty, names[(cut,)]] == 0.0).all()
    assert (seen.worth[salty, names[(wash, cut)]] > 0.0).any()
    # A vessel that was at no bench cannot be submitted, however pure.
    assert (seen.worth[:, :1] < seen.worth[:, 1:]).all()


def test_it_does_not_look_where_that_costs_more_than_anything_can_bring() -> None:
    labs = Laboratories(load_scenario({"base": "crude", "instruments": {"gas_chromatograph": {"price": 0.29}}}), 5)
    play_laboratory(labs, make_policies("scripted", labs, 0), None, 0)
    assert (labs.charges(labs.members)[:, INSTRUMENTS] == 0.0).all()


def test_looking_finds_vessels_that_meet_the_order() -> None:
    """Against the same manager without instruments, on the same 40 episodes."""
    met = {}
    for name in ("scripted", "scripted:unsafe"):
        labs = Laboratories("crude", 40, split="validation")
        play_laboratory(labs, make_policies(name, labs, 0), None, 100)
        amount, purity = labs.state.submitted[:, 0, 0], labs.state.submitted[:, 0, 1]
        met[name] = float(np.mean((amount >= 0.2) & (purity >= 0.9)))
    assert met["scripted"] > met["scripted:unsafe"] + 0.15


def test_likelihoods_are_those_of_independent_normal_errors() -> None:
    draw = np.random.default_rng(0)
    readings, expected = draw.random((2, 4, 3)), draw.random((6, 3))
    found = np.exp(norm.logpdf(readings[:, :, None], expected, 0.02).sum(axis=-1))
    found = found / found.max(axis=-1, keepdims=True) + 1e-9
    assert likelihood(readings, expected, 0.02, 1e-9) == pytest.approx(found, rel=1e-9)


def test_a_look_at_one_vessel_tells_of_the_others_what_concluding_anew_does() -> None:
    scenario = load_scenario("selectivity")
    labs = Laboratories(scenario, 1)
    manager = make_policies("scripted", labs)["manager_0"]
    assert isinstance(manager, ForeseeingManager)
    labs.reset(labs.members)
    belief, goal = manager._begin(labs.observe(0, labs.members)[0]), scenario.lab_goals[0]
    belief.likelihood = np.random.default_rng(0).random(belief.likelihood.shape)
    belief.stage[1] = 2
    known, bests = manager._posterior(belief.likelihood), manager._promises(belief, goal).max(axis=-1)
    found = manager._after_look(belief, goal, 0, known[0], bests)
    readings = manager._foresight[goal].readings[manager._sampled(known[0]), 0] + manager._errors
    before = belief.likelihood.copy()
    for sample, likely in enumerate(manager._likely(readings, goal, 0)):
        belief.likelihood = before.copy()
        belief.likelihood[0] *= likely.reshape(manager._shape)
        assert found[sample] == pytest.approx(manager._promises(belief, goal).max(axis=-1), rel=1e-9)
