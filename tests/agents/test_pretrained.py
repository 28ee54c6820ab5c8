"""Policies that need numpy alone: equal to what they were exported from, and refused where they do not fit."""

import json
import shlex
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import command, refused, slow_but
from run_files import trained, write_run

from chemlab.agents import pretrained
from chemlab.agents.policies import make_policies
from chemlab.agents.pretrained import (
    Card,
    Interface,
    PretrainedPolicy,
    fingerprint,
    interface,
    load_pretrained,
    pretrained_for,
    pretrained_names,
)
from chemlab.agents.runs import Run
from chemlab.agents.train.tasks import task_of
from chemlab.config.loading import load_scenario
from chemlab.envs.players import as_policy
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch

RXN, DIT = "chemlab/FictitiousReaction-v0", "chemlab/WurtzDistillation-v0"
CASES = [("ppo", RXN), ("sac", RXN), ("td3", RXN), ("dqn", DIT), ("qr-dqn", DIT), ("maskable-ppo", DIT)]


def bench_of(env_id: str) -> Any:
    scenario, key = ("fictitious", "rxn") if env_id == RXN else ("wurtz_dodecane", "dit")
    return ExperimentBatch(scenario, key).bench


def made_up(bench: Any, seed: int = 0, **changes: Any) -> PretrainedPolicy:
    """A random network for a bench, as if it had been trained there."""
    rng = np.random.default_rng(seed)
    sizes = [int(bench.observation_space.shape[0]), 8, bench.action_count or len(bench.action_meanings)]
    weights = {}
    for i in range(2):
        weights[f"{i}.weight"] = rng.normal(size=(sizes[i + 1], sizes[i])).astype(np.float32)
        weights[f"{i}.bias"] = rng.normal(size=sizes[i + 1]).astype(np.float32)
    told: dict[str, Any] = {"env_id": "chemlab/Bench-v1", "command": "chemlab train chemlab/Bench-v1"}
    told |= {"scenario": bench.scenario.name, "bench": bench.key, "goals": list(bench.goals.names), "starts": "paper"}
    told |= {"fingerprint": fingerprint(bench), "interface": interface(bench)}
    told |= {"output": "argmax" if bench.action_count else "clip"}
    told |= {"algo": "ppo", "label": "ppo", "seed": seed, "step": 1, "activation": "tanh", **changes}
    sized = {"observation_size": sizes[0], "action_size": sizes[-1]}
    return PretrainedPolicy(Card(name="made_up", versions={}, evaluation={}, **sized, **told), weights)


def ship(policy: PretrainedPolicy, folder: Path, name: str) -> None:
    """Write a policy's files."""
    from safetensors.numpy import save

    layers = enumerate(policy._layers)
    arrays = {f"{i}.{part}": a for i, (w, b) in layers for part, a in (("weight", w.T), ("bias", b))}
    weights = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
    (folder / f"{name}.safetensors").write_bytes(save(weights))
    (folder / f"{name}.json").write_text(policy.card.model_copy(update={"name": name}).model_dump_json())


def act(policy: PretrainedPolicy, seen: Any, mask: Any = None) -> Any:
    nothing = np.zeros(len(seen), dtype=np.int64)
    return policy.act(seen, mask, nothing, nothing)


def test_card_says_the_preset() -> None:
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.train.arguments import recorded_arguments, training_arguments

    arguments = training_arguments({"scenario": "chemlab/WurtzExtraction-v0", "preset": "ppo-entropy", "seed": 4})
    config = {"arguments": json.loads(json.dumps(arguments.stated())), "seed": 4}
    assert recorded_arguments(config, "config.json") == arguments
    assert arguments.command_line() == (
        "chemlab train wurtz_dodecane --algo ppo --preset ppo-entropy --steps 1000000 --seed 4 --bench ext"
    )
    with pytest.raises(ValueError, match=r"config.json: was made by a version before 0\.3; train it again"):
        recorded_arguments({"env_id": "chemlab/WurtzExtraction-v0", "seed": 4, "gamma": 0.9}, "config.json")


def exported(folder: Path, env_id: str, algo: str, **values: Any) -> tuple[PretrainedPolicy, Path, Any]:
    """A policy that was trained for a moment and exported, its best checkpoint, and the learner in that."""
    run = Run(folder / "run")
    trained(run.path, scenario=env_id, algo=algo, learning_rate=0.003, **values)
    from chemlab.agents.learners import load_learner
    from chemlab.agents.train.export import export_run

    card = export_run(run.path, folder / "models" / "mine")
    assert {path.name for path in (folder / "models").iterdir()} == {"mine.json", "mine.safetensors"}
    policy, best = load_pretrained(folder / "models" / "mine.json"), run.checkpoint("best")
    assert policy.card == card
    return policy, best, load_learner(best, algo)  # type: ignore[arg-type, return-value]


@pytest.mark.parametrize(("env_id", "algo"), [(RXN, "recurrent-ppo"), (DIT, "maskable-recurrent-ppo")])
def test_recurrent_exports_remember_as_the_learner_does(env_id: str, algo: str, tmp_path: Path) -> None:
    """The same actions over experiments that begin and end at different times, in members that are not all there."""
    policy, _, model = exported(tmp_path, env_id, algo, steps=64, memory=16, epochs=2)
    assert policy.card.memory == 16
    masked, original = algo.startswith("maskable"), as_policy(model)
    draw, steps = np.random.default_rng(0), np.zeros(4, dtype=np.int64)
    kept, sees = None, policy.card.observation_size
    for turn in range(30):
        members = np.flatnonzero(draw.random(4) < 0.7) if turn else np.arange(4)
        if not len(members):
            continue
        seen = draw.random((len(members), sees), dtype=np.float32)
        mask = (draw.random((len(members), policy.card.action_size)) < 0.5).astype(np.int8) if masked else None
        if mask is not None:
            mask[:, -1] = 1
        ours, theirs = (one.act(seen, mask, steps[members], members) for one in (policy, original))
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
        assert mask is None or mask[np.arange(len(members)), ours].all()
        steps[members] = np.where(draw.random(len(members)) < 0.1, 0, steps[members] + 1)
        if turn == 20:
            kept, after = policy.get_memory(), steps.copy()
    seen = draw.random((4, sees), dtype=np.float32)
    policy.set_memory(kept)
    first = policy.values(seen, after, np.arange(4))
    policy.values(seen, after + 1, np.arange(4))
    policy.set_memory(kept)
    np.testing.assert_array_equal(policy.values(seen, after, np.arange(4)), first)
    assert not np.array_equal(policy.values(seen, after * 0, np.arange(4)), first), "at 0 it forgets"


@pytest.mark.parametrize(("algo", "env_id"), CASES)
def test_exports_are_the_learner(algo: str, env_id: str, tmp_path: Path) -> None:
    values = {"gradient_steps": 10, "buffer_size": 1000, "batch_size": 16}
    values = values if algo in ("dqn", "qr-dqn", "sac", "td3") else {}
    policy, folder, model = exported(tmp_path, env_id, algo, rollout=40, steps=240, **values)
    from chemlab.agents.train.export import largest_difference

    scenario, key = policy.card.scenario, policy.card.bench
    words = shlex.split(policy.card.command)
    assert words[:3] == ["chemlab", "train", scenario]
    told = dict(zip(words[3::2], words[4::2], strict=True))
    flags = ("--bench", "--algo", "--steps", "--seed", "--envs")
    assert [told[flag] for flag in flags] == [key, algo, "240", "0", "2"]
    assert "--gamma" not in policy.card.command
    policy.check(bench_of(env_id))
    own = load_pretrained(folder / key)
    env = RoleVectorEnv(50, scenario, bench=key, autoreset_mode="SameStep")
    seen, infos = env.reset(seed=3)
    for _ in range(12):
        expected, _ = model.predict(seen, deterministic=True)
        chosen = act(policy, seen)
        if key == "rxn":
            np.testing.assert_allclose(chosen, expected, atol=1e-5)
        else:
            np.testing.assert_array_equal(chosen, expected)
            # In the run's own folder it plays as it learned.
            learned, masked = (act(one, seen, infos["action_mask"]) for one in (own, policy))
            as_it_did = {"action_masks": infos["action_mask"]} if algo == "maskable-ppo" else {}
            np.testing.assert_array_equal(learned, model.predict(seen, deterministic=True, **as_it_did)[0])
            assert infos["action_mask"][np.arange(50), masked].all()
            if algo == "maskable-ppo":
                np.testing.assert_array_equal(masked, learned)
        env.action_space.seed(0)
        seen, _, _, _, infos = env.step(env.action_space.sample())
    assert largest_difference(model, policy, seen) < 1e-5
    # A weight that is a little off is noticed.
    weight, bias = policy._layers[-1]
    policy._layers[-1] = (weight + np.float32(1e-2) * np.arange(weight.shape[1], dtype=np.float32), bias)
    assert largest_difference(model, policy, seen) > 1e-5


def test_sampled_actions_follow_the_logits_and_the_seed() -> None:
    """Shares of 4,000 draws are the softmax of the legal logits; a seed repeats them, whatever the batch."""
    policy = made_up(bench_of(DIT))
    seen = np.repeat(np.random.default_rng(5).random((1, 310), dtype=np.float32), 4000, axis=0)
    logits = policy.values(seen[:1])[0].astype(np.float64)
    mask = np.ones((4000, len(logits)), dtype=np.int8)
    mask[:, ::3] = 0
    steps, members = np.zeros(4000, dtype=np.int64), np.arange(4000)
    chosen = policy.as_played("sampled", 7).act(seen, mask, steps, members)
    weights = np.where(mask[0] != 0, np.exp(logits - logits.max()), 0.0)
    shares = np.bincount(chosen, minlength=len(logits)) / 4000
    assert not shares[::3].any()
    np.testing.assert_allclose(shares, weights / weights.sum(), atol=0.03)
    again = policy.as_played("sampled", 7)
    halves = [again.act(seen[own], mask[own], steps[own], members[own]) for own in np.split(members, 2)]
    np.testing.assert_array_equal(np.concatenate(halves), chosen)
    assert (policy.as_played("sampled", 8).act(seen, mask, steps, members) != chosen).any()
    greedy = again.as_played("greedy").act(seen, mask, steps, members)
    assert set(greedy.tolist()) == {int(np.where(mask[0] != 0, logits, -np.inf).argmax())}


def test_sampled_continuous_actions_have_the_exported_spread() -> None:
    plain = made_up(bench_of(RXN))
    refused("cannot be sampled: it has no log_std", plain.as_played, "sampled")
    size = plain.card.action_size
    weights = {**plain.weights, "log_std": np.full(size, -4.0, dtype=np.float32)}
    weights["1.weight"], weights["1.bias"] = plain.weights["1.weight"] * 0.01, np.full(size, 0.5, dtype=np.float32)
    policy = PretrainedPolicy(plain.card, weights).as_played("sampled", 3)
    seen = np.repeat(np.random.default_rng(5).random((1, plain.card.observation_size), dtype=np.float32), 4000, axis=0)
    found = policy.act(seen, None, np.zeros(4000, dtype=np.int64), np.arange(4000))
    np.testing.assert_allclose(found.mean(axis=0), policy.values(seen[:1])[0], atol=0.002)
    np.testing.assert_allclose(found.std(axis=0), np.exp(-4.0), rtol=0.1)
    refused("dqn learns values of actions", made_up(bench_of(DIT), algo="dqn").as_played, "sampled")


def test_policies_are_found_for_benches_they_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pretrained, "_shipped", lambda: tmp_path)
    bench = bench_of(DIT)
    refused(r"\(none for distillation is bundled\); train one", pretrained_for, bench)
    ship(made_up(bench, seed=1, scenario="elsewhere"), tmp_path, "a")
    ship(made_up(bench, seed=2), tmp_path, "b")
    ship(made_up(bench_of(RXN), seed=3), tmp_path, "c")
    assert pretrained_names() == ["a", "b", "c"]
    assert pretrained_for(bench).card.name == "b", "the one trained on this bench"
    # The direct scenario has the same bench of the same chemistry.
    direct = ExperimentBatch("wurtz_dodecane_direct", "dit").bench
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pretrained_for(direct).card.name in ("a", "b")
    for scenario, key, said in (
        ("wurtz_dodecane", "ext", r"no pretrained policy fits 'ext'.*\(none for extraction is bundled\)"),
        ("wurtz_real", "dit", r"fits 'dit' of wurtz_real \(a: .*; others that do not fit: 1\); train one"),
    ):
        refused(said, pretrained_for, ExperimentBatch(scenario, key).bench)


def test_benches_that_learned_in_laboratories_are_for_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pretrained, "_shipped", lambda: tmp_path)
    bench = bench_of(DIT)
    ship(made_up(bench, seed=1, scenario="wurtz_any", starts="lab", background="scripted"), tmp_path, "in_laboratory")
    ship(made_up(bench, seed=2), tmp_path, "paper")
    ship(made_up(bench, seed=3, starts="both"), tmp_path, "vessels")
    assert pretrained_for(bench).card.name == "paper"
    assert pretrained_for(bench, laboratory=True).card.name == "in_laboratory"
    assert pretrained_for(bench, laboratory=True, alone=True).card.name == "vessels"


def test_trained_managers_keep_the_benches_they_learned_over() -> None:
    labs = Laboratories("wurtz_dodecane")
    played = {name: make_policies(name, labs) for name in ("trained", "pretrained", "pretrained-isolated")}
    cards = {
        name: {agent: one.card.name for agent, one in policies.items() if isinstance(one, PretrainedPolicy)}
        for name, policies in played.items()
    }
    benches = {"rxn_0": "wurtz_rxn", "ext_0": "wurtz_ext_lab", "dit_0": "wurtz_dit_lab"}
    assert cards["trained"] == {"manager_0": "wurtz_dodecane_manager", **benches}
    assert cards["pretrained-isolated"] == benches
    assert cards["pretrained"] == {"rxn_0": "wurtz_rxn", "ext_0": "wurtz_any_ext", "dit_0": "wurtz_any_dit"}


def test_what_does_not_fit_is_named() -> None:
    policy = made_up(bench_of(DIT))
    refused(r"it is for distillation, this is reaction; train one for it: chemlab", policy.check, bench_of(RXN))
    oil = ExperimentBatch("salt_from_oil", "dit").bench
    refused(r"'dit' of salt_from_oil: observation '.*': it was trained with", policy.check, oil)
    values = load_scenario("wurtz_dodecane").model_dump()
    values["benches"]["dit"]["process"][0]["magnitudes"] = values["benches"]["dit"]["process"][0]["magnitudes"][:-1]
    fewer = ExperimentBatch(load_scenario(values), "dit").bench
    refused("has 31 actions, here there are 30; they differ from", policy.check, fewer)
    small = np.zeros((4, 12), dtype=np.float32)
    refused(r"observes \[B, 310\] numbers, given \(4, 12\)", policy.values, small)


def test_a_bench_that_has_changed_is_a_warning() -> None:
    policy = made_up(bench_of(DIT))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        policy.check(bench_of(DIT))
    changed = load_scenario({"base": "wurtz_dodecane", "benches": {"dit": {"step_limit": 51}}})
    with pytest.warns(UserWarning, match="has changed since it was trained.*chemlab train"):
        policy.check(ExperimentBatch(changed, "dit").bench)


def test_fingerprints_are_of_the_task() -> None:
    def changed(**tables: Any) -> str:
        return fingerprint(ExperimentBatch(load_scenario({"base": "wurtz_dodecane", **tables}), "dit").bench)

    same = fingerprint(bench_of(DIT))
    assert changed(title="Another") == same
    assert changed(limits={"manager_actions": 7}) == same
    assert changed(benches={"dit": {"count": 2}}) == same
    assert changed(costs={"illegal_action": 0.5}) != same
    assert changed(benches={"dit": {"step_limit": 7}}) != same
    assert changed(ambient_pressure_kpa=90.0) != same
    assert changed(safety={"events": {"hum": "a bench hums"}}) != same


def test_fingerprints_of_bundled_policies_are_of_the_scenarios_as_they_are() -> None:
    for name in pretrained_names():
        policy = load_pretrained(name)
        card, labs = policy.card, Laboratories(load_scenario(policy.card.scenario))
        role = {bench.key: bench for bench in labs.benches}.get(card.bench, labs.manager.workplace)
        assert fingerprint(role) == card.fingerprint, name


def test_cards_with_former_units_load() -> None:
    former = Interface(
        kind="ext", channels=[], actions=["mix EV, 6 clock", "pour EV -> B2, 1e-05 fraction"], discrete=True
    )
    assert former.actions == ["mix EV, 6 units of settling time", "pour EV -> B2, 0.001 %"]


def test_damaged_and_missing_files(tmp_path: Path) -> None:
    refused("no such card", load_pretrained, "nothing")
    made = made_up(bench_of(RXN))
    diverged = {**made.weights, "0.bias": np.full_like(made.weights["0.bias"], np.nan)}
    refused("0.bias: must be finite; if you trained it, training has diverged", PretrainedPolicy, made.card, diverged)
    ship(made_up(bench_of(DIT)), tmp_path, "a")
    file = tmp_path / "a.safetensors"
    file.write_bytes(file.read_bytes()[:-5])
    refused(r"a\.safetensors: cannot be read", load_pretrained, tmp_path / "a")
    ship(made_up(bench_of(RXN)), tmp_path, "b")
    file.write_bytes((tmp_path / "b.safetensors").read_bytes())
    refused("do not belong together", load_pretrained, tmp_path / "a")
    (tmp_path / "a.json").write_text("{}")
    refused("not a card of this version", load_pretrained, tmp_path / "a")


def test_export_says_what_is_missing(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    words = ["-o", tmp_path / "x"]
    assert "contains no training run" in command("export", tmp_path, *words, code=2)
    (tmp_path / "config.json").write_text("{}")
    assert "config.json: label: is required" in command("export", tmp_path, *words, code=2)
    run = write_run(tmp_path / "run", "fictitious", "rxn", {"E": 1.0})
    assert "contains no checkpoint" in command("export", run, *words, code=2)


@pytest.mark.parametrize("name", pretrained_names())
def test_what_it_puts_out_depends_on_what_it_sees_alone(name: str) -> None:
    """Not on the batch, nor on where that lies in memory: actions of nearly equal worth would be drawn by lot."""
    policy = load_pretrained(name)
    seen = np.random.default_rng(0).random((200, policy.card.observation_size), dtype=np.float32)
    together = policy.values(seen)
    np.testing.assert_array_equal(together, np.concatenate([policy.values(row[None]) for row in seen]))
    for offset in range(4):
        moved = np.empty(seen.size + 4, dtype=np.float32)[offset : offset + seen.size].reshape(seen.shape)
        moved[:] = seen
        np.testing.assert_array_equal(together, policy.values(moved))


@pytest.mark.parametrize("name", slow_but(pretrained_names(), "wurtz_ext", "fictitious_rxn", "wurtz_safe_manager"))
def test_shipped_policies_do_what_their_cards_say(name: str) -> None:
    policy = load_pretrained(name)
    card = policy.card
    episodes, seed = card.evaluation["episodes_per_goal"], card.evaluation["seed"]
    task = task_of(card, load_scenario(card.scenario))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        policy.check(task.workplace)
    found = task.by_goal(task.trained(policy.as_played(None, seed)), episodes, seed)
    mean = sum(found.values()) / len(found)
    assert mean == pytest.approx(card.evaluation["mean"], rel=0.03, abs=0.01)
