"""Easier beginnings: workflows that begin half way, and learners that begin as another policy's clone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from helpers import refused
from run_files import without_times
from sb3_contrib import MaskablePPO, RecurrentPPO
from test_training import Killed, Stop

from chemlab.agents.learners import load_learner
from chemlab.agents.policies import make_policies
from chemlab.agents.recurrent import MaskedLstmPolicy
from chemlab.agents.runs import Run
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.agents.start_recorder import record_starts
from chemlab.agents.train import imitate as imitation
from chemlab.agents.train.arguments import Stage, curriculum_of, training_arguments
from chemlab.agents.train.imitate import _examples, fit
from chemlab.agents.train.learn import train
from chemlab.agents.train.tasks import LaboratoryTask
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.envs.players import Watching, as_policy
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import SUBMIT, lab_starts
from chemlab.roles.bench import channel_slices

SMALL: dict[str, Any] = {"roles": "manager", "preset": "manager", "envs": 8, "rollout": 8, "steps": 256}
SMALL |= {"evaluations": 2, "checkpoints": 4, "eval_episodes": 2, "final_episodes": 2}


def begun(labs: Laboratories, seed: int = 0) -> Laboratories:
    labs.begin(seed)
    return labs


def test_a_share_of_the_episodes_begins_half_way() -> None:
    labs = Laboratories("wurtz_any", 400)
    labs.prepare({"dit": 0.25, SUBMIT: 0.5})
    begun(labs)
    last = labs.observe(0, labs.members)[:, channel_slices(labs.channels)["slot_0_last_bench"]]
    benches = ["none", *labs.scenario.benches]
    after = np.array([benches[i] for i in last.argmax(axis=1)])
    # Vessels on their way to distillation come from one of the two benches before it; finished ones from any.
    assert 0.15 < (after == "none").mean() < 0.35
    assert set(after) == {"none", "rxn", "ext", "dit"}
    starts = [start for stage in ("dit", SUBMIT) for start in lab_starts(labs.scenario, stage)]
    recorded = {(start.goal, round(sum(start.contents_mol.values()), 4)) for start in starts}
    for member in np.flatnonzero(after != "none")[:40]:
        amounts = labs.shelf.vessel(int(member), 0).amounts()
        goal = labs.scenario.goals[labs.state.goal[member, 0]]
        salt = sum(amounts.get(name, 0.0) for name in ("Na+", "Cl-"))  # salt may dissolve or fall out at rest
        totals = [total for other, total in recorded if other == goal]
        assert min(abs(total - sum(amounts.values())) for total in totals) <= salt + 1e-3, (goal, amounts)


def test_each_episode_depends_on_its_seed_alone() -> None:
    shares = {"rxn": 0.2, "ext": 0.2, "dit": 0.2, SUBMIT: 0.2}
    many = Laboratories("wurtz_any", 12)
    many.prepare(shares)
    begun(many, seed=7)
    one = Laboratories("wurtz_any", 1)
    one.prepare(shares)
    for member in (3, 11):
        one.seed(0, 7 + member)
        one.reset(one.members)
        np.testing.assert_array_equal(one.shelf.vessels[0], many.shelf.vessels[member])
        np.testing.assert_array_equal(one.observe(0, one.members)[0], many.observe(0, many.members)[member])


def test_without_a_share_nothing_is_different() -> None:
    plain, prepared = Laboratories("wurtz_any", 5), Laboratories("wurtz_any", 5)
    prepared.prepare({"dit": 1.0})
    begun(prepared)
    assert not np.array_equal(prepared.shelf.vessels, begun(plain).shelf.vessels)
    prepared.prepare(None)
    for mine, other in zip(begun(prepared).arrays(), begun(plain).arrays(), strict=True):
        np.testing.assert_array_equal(mine, other)


def test_a_prepared_vessel_can_be_submitted_at_once() -> None:
    labs = Laboratories("wurtz_dodecane", 20)
    labs.prepare({SUBMIT: 1.0})
    begun(labs)
    labs.act(0, labs.members, np.full(20, labs.actions.encode("submit", 0)))
    assert labs.result(labs.members).mean() > 0.3


def test_wrong_shares() -> None:
    """And of a scenario that nobody has played."""
    labs = Laboratories("wurtz_dodecane")
    refused("shares of rxn, ext, dit, submit", labs.prepare, {"oven": 0.5})
    for shares in ({"dit": -0.1}, {"dit": 0.7, "ext": 0.7}, {"dit": 0.5, "ext": float("nan")}):
        refused("sum to at most 1", labs.prepare, shares)
    scenario = labs.scenario.model_copy(update={"name": "never_played", "origin": "/nowhere/x.toml"})
    never = r"recorded for never_played; run: chemlab export starts FILE\.toml"
    refused(never, Laboratories(scenario).prepare, {"dit": 1.0})


@pytest.mark.parametrize("name", scenario_names())
def test_every_shipped_scenario_has_been_played(name: str) -> None:
    """For every bench and for submitting there are vessels of every laboratory goal."""
    scenario = load_scenario(name)
    for stage in (*scenario.benches, SUBMIT):
        found = {start.goal for start in lab_starts(scenario, stage)}
        # The salt is what washing takes away: nobody washes for it.
        washing = stage in scenario.benches and scenario.benches[stage].kind == "extraction"
        # The first of two ovens in a row is asked for what the second one needs.
        wanted = {"F"} if (name, stage) == ("relay", "rxn") else set(scenario.lab_goals)
        assert found >= wanted - ({"NaCl"} if washing else set())


def test_recording_is_repeatable_and_keeps_what_a_vessel_was() -> None:
    scenario = load_scenario("salt_from_oil")
    first, again = (record_starts(scenario, 2, 5) for _ in range(2))
    assert first == again
    assert {start.last_bench for start in first[SUBMIT]} == {"dit"}
    assert {start.last_bench for start in first["ext"]} == {None}


def test_either_kind_of_start_is_drawn_as_often() -> None:
    env = RoleVectorEnv(600, "wurtz_dodecane", bench="dit", starts="both")
    env.reset(seed=0, options={"goal": "dodecane"})
    product = np.array([env.batch.shelf.vessel(i, 0).amounts().get("dodecane", 0.0) for i in range(600)])
    assert 0.42 < np.isclose(product, 1.0, atol=1e-9).mean() < 0.58


def test_backward_adds_a_bench_at_a_time() -> None:
    """Or stages are one's own."""
    arguments = training_arguments({"steps": 1000, "roles": "manager", "curriculum": ["backward"]})
    stages, order = curriculum_of(arguments, ("rxn", "ext", "dit")), ["submit", "dit", "ext", "rxn"]
    assert [list(stage.shares) for stage in stages] == [order[:2], order[:3], order]
    assert [stage.until for stage in stages] == [200, 400, 600]
    assert all(sum(stage.shares.values()) == pytest.approx(1.0) for stage in stages)
    arguments = training_arguments({"roles": "manager", "curriculum": ["1_000: submit=1", "3000: dit=0.5 ext=0.25"]})
    assert curriculum_of(arguments, ()) == [Stage(1000, {"submit": 1.0}), Stage(3000, {"dit": 0.5, "ext": 0.25})]


def test_stages_that_are_not_understood(tmp_path: Path) -> None:
    """They have growing steps, and are for laboratories."""
    for text in ("soon: dit=1", "100 dit=1", "100:", "100: dit", "100: dit=many", "forward"):
        given = {"roles": "manager", "curriculum": [text]}
        refused(r"curriculum: stages are .*given", training_arguments, given)
    given = {"roles": "manager", "curriculum": ["100: dit=1", "100: ext=1"]}
    refused("growing steps", training_arguments, given)
    bench = training_arguments({"scenario": "chemlab/WurtzDistillation-v0", "curriculum": ["100: dit=1"]})
    refused("curriculum: is for a laboratory", train, bench, tmp_path / "run")
    late = training_arguments({**SMALL, "curriculum": ["100: dit=1", "200: oven=1"]})
    refused("^shares of rxn, ext, dit, submit, and no others", train, late, tmp_path / "run")
    assert not (tmp_path / "run").exists(), "a later stage is checked before training"


@pytest.mark.slow
def test_a_manager_that_stops_goes_on_in_the_same_stage(tmp_path: Path) -> None:
    """In the middle of one of two."""
    stages = ["192: submit=0.9", "320: dit=0.5"]
    arguments = training_arguments({**SMALL, "preset": "manager-curriculum", "curriculum": stages})
    whole, broken = Run(tmp_path / "whole"), Run(tmp_path / "broken")
    train(arguments, whole.path)
    with pytest.raises(Killed):
        train(arguments, broken.path, Stop(2))
    train(arguments, broken.path)
    assert without_times(broken) == without_times(whole)


def test_a_clone_of_continuous_actions(tmp_path: Path) -> None:
    values = {name: value for name, value in SMALL.items() if name not in ("preset", "roles")}
    values |= {"bench": "rxn", "bc": "scripted", "bc_steps": 3000, "learning_rate": 1e-6}
    result = train(training_arguments(values), tmp_path / "run")
    assert result.mean > 0.5 * result.scripted_mean


@pytest.mark.slow
def test_a_clone_that_has_to_remember(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is to be played all the time is seen in the first turn alone: a learner without memory hits half of it."""
    monkeypatch.setattr(imitation, "_UPDATES", 250)
    monkeypatch.setattr(imitation, "_SEQUENCES_LEARNING_RATE", 0.01)
    draw, episodes, turns = np.random.default_rng(0), 40, 4
    venv = ChemlabVecEnv(2, bench="dit", show_masks=True)
    first = draw.integers(2, size=episodes)
    actions = np.repeat(first, turns)
    lengths = draw.integers(2, turns + 1, size=episodes)  # and episodes are not equally long
    kept = (np.arange(turns) < lengths[:, None]).ravel()
    seen = np.zeros((episodes, turns, RoleEnv(bench="dit").observation_space.shape[0]), dtype=np.float32)
    seen[:, 0] = first[:, None]
    shown = (seen.reshape(len(actions), -1)[kept], np.ones((kept.sum(), venv.action_space.n), dtype=np.int8))
    returns = actions[kept].astype(np.float32)
    small: dict[str, Any] = {"lstm_hidden_size": 16, "net_arch": [16]}
    model = RecurrentPPO(MaskedLstmPolicy, venv, policy_kwargs=small, device="cpu", seed=0)
    assert fit(model, *shown, actions[kept], returns, 0, lengths) > 0.99
    forgetful = MaskablePPO("MlpPolicy", ChemlabVecEnv(2, bench="dit"), device="cpu", seed=0)
    assert fit(forgetful, *shown, actions[kept], returns, 0) < 0.75


class _Other:
    """Plays the last legal action at every third turn, the first at others."""

    def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
        first, last = mask.argmax(axis=1), mask.shape[1] - 1 - mask[:, ::-1].argmax(axis=1)
        return np.where(step % 3 == 0, last, first)


def test_a_learner_that_plays_itself_is_shown_what_would_have_been_played() -> None:
    """Turns, rewards and ends are the learner's, actions the policy's, asked at each of them."""
    task = LaboratoryTask("rush")
    own = _examples(task.batch(4), task.policy("scripted"), _Other(), 400, 3, 1.0)
    alone = _examples(task.batch(4), _Other(), None, 400, 3, 1.0)
    np.testing.assert_array_equal(own.seen, alone.seen)
    np.testing.assert_array_equal(own.returns, alone.returns)
    np.testing.assert_array_equal(own.lengths, alone.lengths)
    assert own.masks[np.arange(len(own.actions)), own.actions].all()
    assert 0.1 < (own.actions != alone.actions).mean() < 1.0


def test_after_the_first_round_the_learner_plays_and_all_rounds_are_learned_from(monkeypatch: Any) -> None:
    task, played, fitted = LaboratoryTask("rush"), list[tuple[Any, ...]](), list[int]()

    def examples(batch: Any, policy: Any, learner: Any, turns: int, seed: Any, *others: Any) -> Any:
        played.append((learner is not None, turns, seed))
        return _examples(batch, policy, learner, turns, seed, *others)

    monkeypatch.setattr(imitation, "_examples", examples)
    monkeypatch.setattr(imitation, "fit", lambda model, seen, *_: fitted.append(len(seen)))
    model = MaskablePPO("MlpPolicy", ChemlabVecEnv(task.batch(4)), device="cpu", seed=0)
    imitation.imitate(model, task.batch(4), task.policy("scripted"), 800, 5, rounds=2)
    assert played == [(False, 400, 5), (True, 400, None)]
    assert fitted[1] > 1.4 * fitted[0] > 100


def test_turns_to_imitate_are_of_whole_episodes_and_counted_by_experiment() -> None:
    """An episode ends in every laboratory: long ones are not left out. Steps of a bench begin at 0 again."""
    task, steps = LaboratoryTask("rush", "rxn_0"), list[int]()
    batch = task.batch(4)

    def told(observation: Any, mask: Any, step: Any, members: Any, actions: Any) -> None:
        steps.extend((step - batch.laboratories.roles[batch.focal].turns_had[members]).tolist())

    found = _examples(batch, Watching(task.policy("scripted"), told), None, 1, 0, 1.0)
    assert len(found.lengths) >= 4
    assert not any(steps)


@pytest.mark.usefixtures("hasty")
@pytest.mark.slow
def test_a_run_plays_the_role_that_learned_and_its_background_the_rest(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(training_arguments({**SMALL, "background": "scripted:unsafe", "bc_steps": 200}), run)
    labs = Laboratories("wurtz_dodecane")
    policies = make_policies(str(run), labs)
    assert not hasattr(policies["manager_0"], "_careful"), "it is the learner, not the scripted manager"
    expected = make_policies("scripted:unsafe", labs)
    assert vars(policies["dit_0"]).get("_careful") == vars(expected["dit_0"]).get("_careful")
    learner = as_policy(load_learner(Run(run).checkpoint("best"), "maskable-ppo"))
    seen, mask = begun(labs).observe(0, labs.members), labs.mask(0, labs.members)
    zero = np.zeros(1, dtype=np.int64)
    assert policies["manager_0"].act(seen, mask, zero, zero) == learner.act(seen, mask, zero, zero)
    assert LaboratoryTask("wurtz_dodecane", background=f"scripted:unsafe,manager={run}").goals == ("dodecane",)


def test_exceptions_are_for_roles_and_agents() -> None:
    labs = Laboratories("wurtz_two_lines")
    kinds = {name: type(policy).__name__ for name, policy in make_policies("scripted,ext=random", labs).items()}
    assert (kinds["ext_0"], kinds["ext_1"], kinds["dit_0"]) == ("RandomPolicy", "RandomPolicy", "ScriptedDistillation")
    one = make_policies("scripted,ext_1=random", labs)
    assert type(one["ext_0"]).__name__ == "ScriptedExtraction"
    assert type(one["ext_1"]).__name__ == "RandomPolicy"

    for name in ("scripted,oven=random", "scripted,ext", "scripted,ext="):
        refused(r"must be ROLE=POLICY; roles: .*manager", make_policies, name, labs)
    refused(r"begin with .*'scripted,ext=random'", make_policies, "ext=random", labs)


def test_a_lapse_is_a_random_legal_action_now_and_then() -> None:
    labs = Laboratories("wurtz_dodecane", 400)
    mask = np.zeros((400, labs.action_counts[3]), dtype=np.int8)
    mask[:, 3:9] = 1
    seen = np.zeros((400, labs.observation_sizes[3]), dtype=np.float32)
    zero, members = np.zeros(400, dtype=np.int64), labs.members
    steady = make_policies("scripted", labs, 0)["dit_0"].act(seen, mask, zero, members)
    policy = make_policies("scripted@0.3", labs, 0)["dit_0"]
    actions = policy.act(seen, mask, zero, members)
    assert 0.15 < (actions != steady).mean() < 0.35  # one random action in six is what was meant anyway
    assert set(actions[actions != steady]) <= set(range(3, 9))
    again = make_policies("scripted@0.3", Laboratories("wurtz_dodecane", 400), 0)["dit_0"]
    np.testing.assert_array_equal(again.act(seen, mask, zero, members), actions)
    memory = policy.get_memory()  # type: ignore[attr-defined]
    later = policy.act(seen, mask, zero + 1, members)
    policy.set_memory(memory)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(policy.act(seen, mask, zero + 1, members), later)
    reagents = make_policies("scripted@0.5,manager=scripted:unsafe", labs, 0)["rxn_0"]
    rxn = np.zeros((400, labs.observation_sizes[1]), dtype=np.float32)
    assert reagents.act(rxn, None, zero, members).shape == (400, 6)
    for name in ("scripted@often", "scripted@1.5", "random@-1"):
        refused("share of random actions after @ must be from 0 to 1", make_policies, name, labs)
