"""Safety for constrained learning: careful policies have no cost, others have; costs are weighted sums of events."""

import functools

import numpy as np
import pytest
from helpers import choose

from chemlab.agents.episodes import EpisodeResult, PlayedTurn, play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import SAFETY_EVENTS
from chemlab.envs.aec import raw_env
from chemlab.lab.text import named_events
from chemlab.laboratory import parallel_env

SAFE = "wurtz_safe"


def weighted(events: dict[str, float]) -> float:
    """Cost of some events, by the scenario's weights."""
    weights = load_scenario(SAFE).safety.weights
    return sum(weights[kind] * value for kind, value in events.items())


@functools.cache
def episodes(policy: str) -> tuple[tuple[EpisodeResult, tuple[PlayedTurn, ...]], ...]:
    """Episodes of one set of scripted policies, and all their turns."""
    env, turns = raw_env(SAFE), [list[PlayedTurn]() for _ in range(20)]
    policies = make_policies(policy, env.laboratories)
    results = [play_episode(env, policies, seed, policy, watch=own.append) for seed, own in enumerate(turns)]
    return tuple(zip(results, map(tuple, turns), strict=True))


def test_the_careful_have_no_accident() -> None:
    for result, turns in episodes("scripted"):
        assert result.safety_events == {}, f"seed {result.seed}"
        assert all(turn.info["cost"] == 0.0 and not turn.info["events"].any() for turn in turns)
        assert result.costs["safety"] == 0.0
        # Not by doing nothing: the product is made.
        assert result.status == "submitted"
        assert result.score > 0.5


def test_the_hasty_have_accidents() -> None:
    """Each time something happens; over all seeds sodium meets water, the valve opens and a vessel boils dry."""
    totals = dict.fromkeys(SAFETY_EVENTS, 0.0)
    for result, turns in episodes("scripted:unsafe"):
        assert result.safety_events, f"seed {result.seed}"
        assert result.costs["safety"] > 0.0
        assert sum(turn.info["cost"] for turn in turns) > 0.0
        for kind, value in result.safety_events.items():
            totals[kind] += value
    for kind in ("metal_in_water_mol", "relief_valve_mol", "boiled_dry"):
        assert totals[kind] > 0.0, kind
    # Haste does not pay where accidents are priced.
    hasty = np.mean([result.score for result, _ in episodes("scripted:unsafe")])
    assert np.mean([result.score for result, _ in episodes("scripted")]) > hasty + 0.3


@pytest.mark.parametrize("policy", ["scripted", "scripted:unsafe"])
def test_the_score_is_charged(policy: str) -> None:
    scenario = load_scenario(SAFE)
    price = scenario.safety.reward_price
    assert price > 0.0
    for result, turns in episodes(policy):
        for turn in turns:
            assert turn.info["cost"] == pytest.approx(weighted(named_events(scenario, turn.info)), rel=1e-12)
        by_turn = named_events(scenario, {"events": sum(turn.info["events"] for turn in turns)})
        for kind in SAFETY_EVENTS:
            assert result.safety_events.get(kind, 0.0) == pytest.approx(by_turn.get(kind, 0.0), rel=1e-12, abs=1e-15)
        assert result.costs["safety"] == pytest.approx(price * weighted(by_turn), rel=1e-12, abs=1e-15)
        worth = result.submitted_mol * result.purity / scenario.theoretical_maximum_mol[result.goal]
        assert result.score == pytest.approx(worth - sum(result.costs.values()), rel=1e-12)
        assert result.rewards["manager_0"] == pytest.approx(result.score, rel=1e-12)
        # A tick is one turn of each busy bench; this manager keeps one bench busy at a time.
        managed = sum(turn.agent == "manager_0" for turn in turns)
        assert (result.manager_actions, result.ticks) == (managed, len(turns) - managed)
        # A bench pays for its own accidents as well.
        for agent in ("rxn_0", "ext_0", "dit_0"):
            own = [turn for turn in turns if turn.agent == agent]
            paid = sum(turn.info["score"] for turn in own) - price * sum(turn.info["cost"] for turn in own)
            assert result.rewards[agent] == pytest.approx(paid, rel=1e-9, abs=1e-12)


def test_without_a_price_accidents_are_counted_and_not_charged() -> None:
    values = load_scenario(SAFE).model_dump()
    values["safety"]["reward_price"] = 0.0
    env = raw_env(load_scenario(values))
    result = play_episode(env, make_policies("scripted:unsafe", env.laboratories), 0)
    assert weighted(result.safety_events) > 0.0
    assert result.costs["safety"] == 0.0


def test_costs_are_weighted_events_in_rounds() -> None:
    """Of every agent, also of one that has not acted; every kind of accident happens."""
    env, rng, happened = parallel_env(SAFE), np.random.default_rng(0), set[str]()
    labs = env.laboratories
    for seed in range(6):
        _, infos = env.reset(seed=seed)
        while env.agents:
            turns = [agent for agent in env.agents if infos[agent]["has_turn"]]
            given = {agent: choose(labs, labs.agents.index(agent), 0, rng, submit=0.0) for agent in turns}
            *_, infos = env.step(given)
            for info in infos.values():
                events = named_events(labs.scenario, info)
                assert info["cost"] == pytest.approx(weighted(events), rel=1e-12)
                happened |= events.keys()
    assert happened == set(SAFETY_EVENTS)
