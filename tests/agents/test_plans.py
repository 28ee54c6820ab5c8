"""Blind baselines: what a search for constant plans finds, how plans are played, and what replaying brings."""

import itertools
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import Watched, command, refused, slow_but
from typer.testing import CliRunner

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.evaluate.plans import FoundPlan, PlanSearch, TeamPlan, plan_words, replay_actions
from chemlab.agents.evaluate.search import search_plan
from chemlab.agents.open_loop import (
    ConstantPlan,
    Plan,
    Playback,
    all_contexts,
    load_plans,
    plan_file,
    plan_for,
    stored_plans,
)
from chemlab.agents.policies import make_policies
from chemlab.cli import app
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Players
from chemlab.kernels.arrays import IntArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.manager_actions import ManagerActions

EVERY_STORED = slow_but(
    stored_plans(), *(path for path in stored_plans() if path.stem.endswith(".scripted") or "_safe" in path.stem)
)


def small(actions: int) -> Scenario:
    """Three slots, two benches, one goal, and few manager actions."""
    return load_scenario({"base": "salt_from_oil", "shelf": {"slots": 3}, "limits": {"manager_actions": actions}})


def watched(scenario: str | Scenario, manager: Any, count: int, seed: int = 0) -> tuple[Watched, IntArray]:
    """(what a manager played over scripted benches in so many episodes, their goals)."""
    labs = Laboratories(scenario, count)
    policies = make_policies("scripted", labs)
    policies["manager_0"] = taped = Watched(manager(labs) if callable(manager) else manager, labs)
    play_laboratory(labs, policies, None, seed)
    return taped, labs.state.goal[:, 0].copy()


def played(scenario: Scenario, plan: Plan, seed: int = 0) -> list[tuple[str | int, ...]]:
    """What becomes of a plan over scripted benches."""
    actions = ManagerActions.of(scenario)
    taped, _ = watched(scenario, Playback(actions, [plan]), 1, seed)
    assert all(taped.legal[0])
    return [actions.decode(action) for action in taped.actions[0]]


@pytest.mark.slow
def test_the_search_finds_what_is_best_of_all_plans() -> None:
    """Where an episode has three actions, all sequences of three can be tried one by one."""
    scenario = small(actions=3)
    plans = list(itertools.product(range(len(ManagerActions.of(scenario))), repeat=3))
    labs = Laboratories(scenario, len(plans))
    for member in labs.members:
        labs.seed(int(member), 0)
    labs.reset(labs.members)
    policies = make_policies("scripted", labs)
    policies["manager_0"] = Playback(labs.actions, plans)
    Players(labs, list(policies.values())).play_on(labs.members)
    scores = labs.result(labs.members)
    best = search_plan(scenario, budget=3000, seed=1)
    assert best.tried <= 3000
    assert best.found[0].score == pytest.approx(scores.max(), abs=1e-6)
    # Most plans come to less, so that something was found.
    assert np.mean(scores > scores.max() - 1e-6) < 0.05


@pytest.mark.slow
def test_the_search_improves_on_what_scripted_managers_do() -> None:
    """It begins there, with what needs eyes left out; nothing in the plan measures."""
    first, best = (search_plan("wurtz_dodecane", budget=budget, seed=0).found[0] for budget in (3, 700))
    assert 0.8 < first.score < best.score
    assert not any("measure" in words for words in plan_words(load_scenario("wurtz_dodecane"), best.team.plan))


@pytest.mark.slow
def test_every_public_context_gets_a_plan() -> None:
    """Plans differ with the goal, which is public; the others begin with what the first has found."""
    search = search_plan("fictitious", budget=500, seed=0)
    scenario = search.scenario
    assert [one.context for one in search.found] == all_contexts(scenario)
    for one in search.found:
        goals = {word.rpartition("goal ")[2] for word in plan_words(scenario, one.team.plan) if "start rxn" in word}
        assert one.context[0] in goals
    assert search.play(50).mean() > 0.5


def test_bad_searches_are_refused() -> None:
    for said, arguments in (
        ("at least one plan", {"budget": 0}),
        ("dodecane.*NaCl", {"contexts": [("NaCl",)]}),
        ("none", {"contexts": []}),
        ("'omniscient'", {"benches": "omniscient", "budget": 5}),
    ):
        refused(said, search_plan, "wurtz_dodecane", **arguments)


def test_a_plan_is_blind() -> None:
    """The same actions whatever the seed: with a policy that lapses at the benches, too, but for waiting."""
    labs = Laboratories("wurtz_dodecane", 8)
    wait = labs.actions.encode("wait")
    taped, _ = watched("wurtz_dodecane", plan_for, 8)
    assert all(actions == taped.actions[0] for actions in taped.actions)
    policies = make_policies("scripted@0.2", labs, seed=5)
    policies["manager_0"] = noisy = Watched(plan_for(labs), labs)
    assert np.ptp(play_laboratory(labs, policies, None, 0).returns) > 0.0
    pairs = zip(noisy.actions, noisy.legal, strict=True)
    kept = [[a for a, legal in zip(*pair, strict=True) if legal and a != wait] for pair in pairs]
    planned = [a for a in taped.actions[0] if a != wait]
    # Where a vessel is not there an action is left out; none is put in.
    for actions in kept:
        remaining = iter(planned)
        assert all(action in remaining for action in actions)


def test_plans_may_know_the_goal() -> None:
    """What a plan does is a function of the public goal, and of nothing else."""
    scenario = load_scenario("fictitious")
    encode = ManagerActions.of(scenario).encode
    plans = {one: (encode("start", "rxn_0", 0, one[0]), encode("submit", 0)) for one in all_contexts(scenario)}
    labs = Laboratories(scenario, 1)
    taped, goals = watched(scenario, ConstantPlan(scenario, labs.channels, labs.actions, plans), 30)
    assert len(set(goals.tolist())) == len(scenario.lab_goals)
    for goal, did in zip(goals, taped.actions, strict=True):
        assert tuple(a for a in did if labs.actions.decode(a)[0] != "wait") == plans[(scenario.goals[goal],)]


def test_a_plan_waits_for_what_is_not_legal_yet_and_leaves_out_what_never_will_be() -> None:
    """A vessel at a bench is waited for, an empty slot is not; after the plan, lowest slots fill the orders."""
    scenario = load_scenario("wurtz_dodecane")
    code = ManagerActions.of(scenario).encode
    did = played(scenario, (code("start", "rxn_0", 0, "dodecane"), code("submit", 0)))
    assert did == [("start", "rxn_0", 0, "dodecane"), ("wait",), ("submit", 0)]
    plan = (code("submit", 7), code("discard", 7), code("discard", 0), code("recall", "dit_0"))
    assert played(scenario, plan) == [("discard", 0), ("submit", 1)]
    assert played(scenario, ()) == [("submit", 0)]
    # Benches are waited for before anything is submitted.
    assert played(scenario, (code("start", "dit_0", 0, "NaCl"),))[1:] == [("wait",), ("submit", 0)]
    assert played(load_scenario("wurtz_two_lines"), ()) == [("submit", 0, 0), ("submit", 1, 1)]


def test_a_plan_remembers_where_it_stands() -> None:
    """With its memory put back it goes on as it did; a new episode begins the plan anew."""
    labs = Laboratories(load_scenario("wurtz_dodecane"), 1)
    code = labs.actions.encode
    plan = (code("discard", 0), code("submit", 1))
    policy = Playback(labs.actions, [plan])
    mask = np.ones((1, len(labs.actions)), dtype=np.int8)
    seen, members = np.zeros((1, 1), dtype=np.float32), np.array([0])

    def act(step: int) -> int:
        return int(policy.act(seen, mask, np.array([step]), members)[0])

    assert act(0) == plan[0]
    memory = policy.get_memory()
    assert act(1) == plan[1]
    policy.set_memory(memory)
    assert act(1) == plan[1]
    assert act(0) == plan[0]


@pytest.mark.parametrize("path", EVERY_STORED, ids=lambda path: path.stem)
def test_stored_plans_reach_what_their_files_say(path: Path) -> None:
    """Every plan that comes along fits its scenario, and is worth on some of the same seeds what it says."""
    stored = load_plans(path)
    labs = Laboratories(stored.scenario, 20)
    plans = stored.decoded(labs.actions)
    assert list(plans) == all_contexts(labs.scenario)
    found = [FoundPlan(context, TeamPlan(plan), 0.0) for context, plan in plans.items()]
    episodes, seed = stored.evaluation["episodes"], stored.evaluation["seed"]
    scores = PlanSearch(labs.scenario, stored.benches, found, 0).play(episodes, seed)
    assert scores.mean() == pytest.approx(stored.evaluation["value"], abs=1e-9)


def test_plans_by_name() -> None:
    """``plan`` takes the plan that is stored for whoever operates the benches; a file may be named, too."""
    labs = Laboratories("wurtz_dodecane", 1)
    for name, benches in (
        ("plan", "scripted"),
        ("scripted,manager=plan", "scripted"),
        (f"pretrained,manager=plan:{plan_file('wurtz_dodecane', 'scripted')}", "scripted"),
        ("pretrained-isolated,manager=plan", "pretrained-isolated"),
    ):
        policy = make_policies(name, labs)["manager_0"]
        assert isinstance(policy, ConstantPlan)
        np.testing.assert_array_equal(policy._steps, plan_for(labs, benches)._steps)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    refused(rf"{file}.*no such file", load_plans, file)
    for text, said in (
        ("{", "not valid JSON"),
        ("[]", "not a file of plans"),
        ('{"kind": "evaluation", "format": 1}', "not a file of plans"),
        ('{"kind": "plan", "format": 1, "scenario": "x"}', "not a file of plans.*chemlab audit plan --out"),
    ):
        file.write_text(text)
        refused(f"(?s){file}.*{said}", load_plans, file)


def test_a_plan_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    """Another laboratory's plan names actions that are not there, or goals that it has no plan for."""
    file, own = str(plan_file("wurtz_dodecane", "scripted")), tmp_path / "own.toml"
    own.write_text('base = "wurtz_dodecane"\n')
    audit = "chemlab audit plan {} --benches {}"
    for scenario, benches, given, said in (
        ("salt_from_oil", "scripted", file, "does not fit this laboratory"),
        ("wurtz_any", "scripted", file, "may draw the goals 5-methylundecane"),
        ("wurtz_dodecane", "scripted:unsafe", None, audit.format("wurtz_dodecane", "scripted:unsafe --out")),
        (own, "scripted", None, re.escape(audit.format(own, "scripted"))),
    ):
        refused(said, plan_for, Laboratories(scenario), benches, file=given)


def test_the_command(tmp_path: Path) -> None:
    """The plan in words, its score and how many were tried; the file can be played."""
    file = tmp_path / "plan.json"
    arguments = ["audit", "plan", "salt_from_oil", "--budget", "400", "--episodes", "5"]
    told = command(*arguments, "--out", file)
    assert "submit slot" in told
    assert "400 plans tried" in told
    content = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert content == json.loads(file.read_text())
    made = "chemlab audit plan salt_from_oil --benches scripted --budget 400 --seed 0 --episodes 5"
    assert content["command"] == made
    run = json.loads(command("run", "salt_from_oil", "--policy", f"scripted,manager=plan:{file}", "--json"))
    assert run["score"] == pytest.approx(content["evaluation"]["value"], abs=0.02)


def test_replaying_an_episode_from_its_own_seed_gives_the_same_episode() -> None:
    """The only donor is the episode that is scored: blind and seeing are one."""
    from chemlab.agents.evaluate import plans as module

    scenario = load_scenario("wurtz_two_lines")
    for seed in range(3):
        labs = Laboratories(scenario, 1)
        expected = play_laboratory(labs, make_policies("scripted", labs), None, seed).returns
        context = tuple(scenario.goals[goal] for goal in labs.state.goal[0])
        trials, policies = module.Trials(scenario, context, [seed], 1), make_policies("scripted", labs)
        manager, *benches = [tapes[0] for tapes in module.recorded_tapes(trials, policies)]
        team = module.TeamPlan(tuple(manager[0]), tuple(map(module.tape_of, benches)))
        again = trials.play_teams([team], policies)
        assert module.TeamPlan.of(json.loads(json.dumps(team.as_list()))) == team
        assert again[0, 0] == pytest.approx(expected[0], abs=1e-12)


def test_a_constant_plan_of_everybody() -> None:
    """Donors whose manager is blind: nobody looks, and the score is that of the plan."""
    assert replay_actions("wurtz_dodecane", "plan", episodes=10, donors=3).mean() >= 0.97
    refused("at least one donor", replay_actions, "wurtz_dodecane", donors=0)
