"""Adversaries of an audit: controllers that choose among plans by what agents have observed, and learners."""

import numpy as np
import pytest

from chemlab.agents.evaluate.adversary import learned_scores
from chemlab.agents.evaluate.informed import _choice, informed_scores, openings
from chemlab.agents.evaluate.plans import FoundPlan, PlanSearch, TeamPlan
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.roles.manager_actions import ManagerActions

CAMPAIGN = load_scenario("campaign")
CODE, CONTEXT = ManagerActions.of(CAMPAIGN).encode, (CAMPAIGN.goals[0],) * 4
PLAN = tuple(a for slot in range(4) for a in (CODE("start", "rxn_0", slot, CONTEXT[0]), CODE("submit", slot, slot)))
TEAM = TeamPlan(PLAN, ((((1.0, 0.5, 0.0),),),))


def test_a_controller_chooses_by_what_it_has_seen() -> None:
    """One of 30 numbers tells which of three plans is the best; where nothing does, the plan with the best mean is."""
    draw = np.random.default_rng(0)
    seen, now = draw.random((200, 30)).astype(np.float32), draw.random((100, 30)).astype(np.float32)
    scores = np.stack([seen[:, 4], 1.0 - seen[:, 4], np.full(200, 0.4)])
    chosen = _choice(seen, scores, now)
    sure = np.abs(now[:, 4] - 0.5) > 0.2
    assert (chosen[sure] == (now[sure, 4] < 0.5)).mean() > 0.95
    noise = np.stack([draw.random(200), draw.random(200), np.full(200, 0.9)])
    assert (_choice(seen, noise, now) == 2).all()
    assert (_choice(np.zeros_like(seen), scores, np.zeros_like(now)) == scores.mean(axis=1).argmax()).all()


@pytest.mark.parametrize("opening", ["submission", "look-rxn"])
def test_controllers_are_scored(opening: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The opening costs at most its ticks, so that the score is about that of the only plan that is known."""
    assert openings(CAMPAIGN) == ["look-rxn", "submission"]
    settings = {"worlds": 8, "library": 1, "budget": 1, "episodes": 3, "seed": 5}
    found = informed_scores(CAMPAIGN, opening, {CONTEXT: [TEAM]}, **settings)
    assert np.shape(found) == (2, 3)
    assert np.isfinite(found).all()
    if opening == "submission":  # of a plan of one submission there is no such opening
        assert informed_scores(CAMPAIGN, opening, {CONTEXT: [TeamPlan(())]}, 4, 1, 1, 2, 5) is None
    agents = Scenario.agents
    monkeypatch.setattr(Scenario, "agents", lambda self: agents(self)[::-1])
    assert informed_scores(CAMPAIGN, opening, {CONTEXT: [TEAM]}, **settings) == found


@pytest.mark.slow
def test_a_learner_begins_with_an_open_loop_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any learning, the clone plays what it was shown: its episodes cost as many ticks."""
    pytest.importorskip("torch")
    monkeypatch.setattr("chemlab.agents.train.imitate._UPDATES", 300)
    monkeypatch.setattr("chemlab.agents.evaluate.adversary._DONORS", 4)
    limits = CAMPAIGN.limits.model_copy(update={"manager_actions": 40, "ticks": 120})
    short = CAMPAIGN.model_copy(update={"limits": limits})
    found = PlanSearch(short, "scripted", [FoundPlan(CONTEXT, TEAM, 0.0)], 0)
    expected = found.play(8, 5, "test").mean()
    assert expected != 0.0
    assert np.mean(learned_scores(short, 0, 8, 5, {CONTEXT: TEAM})) == pytest.approx(expected, abs=1e-9)
    assert np.isfinite(learned_scores(short, 1, 8, 5)).all()
