"""Evaluating policies: what is played, from which seeds, and what is reported."""

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from helpers import command, refused

from chemlab.agents.episodes import play_episode, play_laboratory
from chemlab.agents.evaluate.play import Target, bench_policy, evaluate, find_target, play_bench
from chemlab.agents.policies import make_policies
from chemlab.config.loading import load_scenario
from chemlab.config.parts import strangers_code
from chemlab.envs.aec import raw_env
from chemlab.envs.role_env import RoleEnv

DIT = "chemlab/WurtzDistillation-v0"


@pytest.mark.parametrize(("bench", "goal"), [("rxn", "NaCl"), ("ext", "dodecane"), ("dit", "4-ethyldecane")])
def test_a_batch_plays_what_single_environments_play(bench: str, goal: str) -> None:
    """Member i of a batch is a single environment reset with seed + i, step for step."""
    target = Target(load_scenario("wurtz_dodecane"), bench)
    batch = target.environment(4)
    played = play_bench(batch, bench_policy("scripted", batch.bench), goal, 30, record=True)
    for i in range(4):
        env = RoleEnv(target.scenario, bench=bench)
        env.reset(seed=30 + i, options={"goal": goal})
        total, steps, over = 0.0, 0, False
        for action in played.actions[i]:
            assert not over
            _, reward, over, _, _ = env.step(np.array(action) if bench == "rxn" else action)
            total, steps = total + reward, steps + 1
        assert over
        assert steps == played.lengths[i]
        assert total == pytest.approx(played.returns[i], abs=1e-12)


CONFIG = json.dumps(
    {"label": "ppo", "algo": "ppo", "scenario": "wurtz_dodecane", "bench": "dit", "goals": ["dodecane"]}
    | {"fingerprint": "", "env_id": "any", "seed": 0}
)
"""What every run says of itself."""


def test_only_first_episodes_count() -> None:
    """A member that ends early goes on with an experiment that is not counted, and its policy is told it is new."""

    class Enders:
        """Member 0 ends at once, member 1 never."""

        def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
            seen.append(step.tolist())
            return np.where(members == 0, 30, 3)  # the last action ends, number 3 heats a little

    seen: list[Any] = []
    env = Target(load_scenario("wurtz_dodecane"), "dit").environment(2)
    played = play_bench(env, Enders(), "dodecane", 0)
    assert played.lengths.tolist() == [1, 50]
    assert played.returns[0] == 0.0  # nothing was done
    assert seen == [[0, step] for step in range(50)]


def test_lost_turns_are_counted() -> None:
    """Masked actions are lost turns; the scripted policy has none."""

    class Stubborn:
        def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
            return mask.argmin(axis=1)  # an illegal one, as long as there is one

    env = Target(load_scenario("wurtz_dodecane"), "dit").environment(2)
    assert (play_bench(env, Stubborn(), "dodecane", 0).illegal == 50).all()
    assert (play_bench(env, bench_policy("scripted", env.bench), "dodecane", 0).illegal == 0).all()


def test_cases_are_what_is_in_the_vessel() -> None:
    """DiT begins with or without salt with equal chances, and with dodecane where salt is the goal."""
    env = Target(load_scenario("wurtz_dodecane"), "dit").environment(64)
    policy = bench_policy("scripted", env.bench)
    cases = play_bench(env, policy, "5-methylundecane", 5).cases
    assert set(cases) == {"with NaCl", "without NaCl"}
    assert 15 < cases.count("with NaCl") < 49  # 5 standard deviations
    for member in range(4):
        single = RoleEnv("wurtz_dodecane", bench="dit")
        single.reset(seed=5 + member, options={"goal": "5-methylundecane"})
        assert cases[member].startswith("without") != ("Na+" in single.batch.shelf.vessel(0, 0).amounts(1e-6))
    assert set(play_bench(env, policy, "NaCl", 5).cases) == {"with dodecane", "without dodecane"}
    rxn = Target(load_scenario("wurtz_dodecane"), "rxn").environment(2)
    assert play_bench(rxn, bench_policy("scripted", rxn.bench), "NaCl", np.int64(0)).cases == ["", ""]


def test_report_is_made_of_the_returns() -> None:
    """Means, differences and wins follow from the returns that are stored with them, pair by pair."""
    results = evaluate(find_target(DIT), ["random"], episodes=5, seed=3, goals=["dodecane", "NaCl"])
    rows = {row["policy"]: row for row in results["policies"]}
    assert list(rows) == ["scripted", "random"]  # the baseline is played as well
    ours, base = (np.array([rows[one]["returns"][goal] for goal in results["goals"]]) for one in ("random", "scripted"))
    row = rows["random"]
    assert row["mean"]["value"] == pytest.approx(ours.mean(), abs=1e-6)
    assert row["difference"]["value"] == pytest.approx((ours - base).mean(), abs=1e-6)
    assert row["improvement"]["value"] == pytest.approx((ours > base).mean())
    assert row["by_goal"]["NaCl"]["mean"]["value"] == pytest.approx(ours[1].mean(), abs=1e-6)
    assert rows["scripted"]["difference"] == {"value": 0.0, "low": 0.0, "high": 0.0}
    assert rows["scripted"]["improvement"]["value"] == 0.5
    assert rows["scripted"]["cases"] == rows["random"]["cases"]  # the same starting states
    for case, estimate in row["by_case"].items():
        members = np.array([row["cases"][goal] for goal in results["goals"]]) == case
        means = [values[chosen].mean() for values, chosen in zip(ours, members, strict=True) if chosen.any()]
        assert estimate["value"] == pytest.approx(np.mean(means), abs=1e-6)


def test_targets() -> None:
    """Environment ids, benches of scenarios and laboratories."""
    for name, spec in gymnasium.registry.items():
        if name.startswith("chemlab/") and str(spec.vector_entry_point).endswith(":RoleVectorEnv"):
            assert find_target(name).bench is not None
    ext = find_target("salt_from_oil", "ext", "lab")
    told = {"kind": "bench", "env_id": None, "scenario": "salt_from_oil", "bench": "ext"}
    assert ext.as_dict() == told | {"starts": "lab", "split": "train"}
    assert find_target("chemlab/FictitiousReaction-v0").goals == ("E", "F", "G", "H", "I")
    for wrong, bench, starts, words in (
        ("CartPole-v1", None, "paper", "not a single bench"),
        ("chemlab/LabManager-v1", None, "paper", "not a single bench of chemlab; give a scenario"),
        ("chemlab/Nothing-v0", None, "paper", "chemlab/WurtzReaction-v0"),
        ("wurtz_dodecane", "oven", "paper", "rxn, ext, dit"),
        ("no_such", None, "paper", "no_such"),
        ("chemlab/WurtzReaction-v0", "rxn", "paper", "bench: .* is a bench already"),
        ("wurtz_dodecane", None, "lab", "starts: only for single benches"),
    ):
        refused(words, find_target, wrong, bench, starts)


@pytest.mark.parametrize(
    ("scenario", "policy", "paid"),
    [("unlabelled", "scripted,manager=scripted:unsafe", 0), ("rush", "scripted", 3), ("wurtz_dodecane", "scripted", 1)],
)
def test_what_is_told_of_an_episode_adds_up(scenario: str, policy: str, paid: int) -> None:
    """The score is what orders pay, minus what is listed."""
    env = raw_env(scenario)
    labs = env.laboratories
    result = play_episode(env, make_policies(policy, labs), 3)
    assert (result.paid, result.orders) == (paid, labs.scenario.orders)
    pays = labs.worth(labs.members).mean()
    assert result.score == pytest.approx(pays - result.missed - sum(result.costs.values()), rel=1e-12)
    assert ("missed order" in result.words()) == (result.missed > 0.0) == (labs.scenario.demand.missed > 0.0)
    assert (f"{paid} of 8 orders paid; submitted" in result.words()) == (scenario == "rush")


def test_policies_are_for_the_agents_that_are_there() -> None:
    """A policy under a kind's name would not be played."""
    env = raw_env("wurtz_dodecane_direct")
    policies = make_policies("scripted", env.laboratories)
    said = "policies: needs one for each of manager_0, rxn_0, dit_0, given "
    for wrong in ({**policies, "manager": policies["manager_0"]}, {"rxn_0": policies["rxn_0"]}):
        refused(said, play_episode, env, wrong, 0)
        refused(said, play_laboratory, env.laboratories, wrong, None, 0)
    refused(f"{said}none", play_episode, env, {}, 0)


def test_command_for_people_and_programs(tmp_path: Path) -> None:
    """A table, or one JSON object; the file has each episode's return."""
    arguments = ["evaluate", DIT, "--goal", "dodecane", "--episodes", "4", "--seed", "2"]
    file = tmp_path / "sub" / "out.json"
    shown = command(*arguments, "-o", file)
    for part in ("scripted", "random", "interquartile", "P(improvement)", "without NaCl"):
        assert part in shown
    stored, printed = json.loads(file.read_text()), json.loads(command(*arguments, "--json"))
    assert [len(row["returns"]["dodecane"]) for row in stored["policies"]] == [4, 4]
    assert printed["policies"][1]["mean"] == stored["policies"][1]["mean"]
    assert "returns" not in printed["policies"][0]


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = RoleEnv("wurtz_dodecane", bench="dit").bench
    monkeypatch.chdir(tmp_path)
    for name in (".", "..", str(tmp_path)):
        refused(r"config\.json is missing", bench_policy, name, bench)
    (tmp_path / "config.json").write_text(CONFIG)
    refused("checkpoints is missing", bench_policy, str(tmp_path), bench)


def test_checkpoints_play_as_their_model(tmp_path: Path) -> None:
    """A run's folder, its checkpoint and the model file are the same policy, the model's own without exploration."""
    sb3 = pytest.importorskip("stable_baselines3")
    from chemlab.agents.sb3 import ChemlabVecEnv

    model = sb3.PPO("MlpPolicy", ChemlabVecEnv(1, bench="dit"), seed=1, n_steps=8, batch_size=8, device="cpu")
    folder = tmp_path / "checkpoints" / "best-8"
    folder.mkdir(parents=True)
    model.save(folder / "model.zip")
    (tmp_path / "config.json").write_text(CONFIG)
    env = Target(load_scenario("wurtz_dodecane"), "dit").environment(3)
    seen = env.reset(seed=0)[0]
    expected = model.predict(seen, deterministic=True)[0]
    for path in (tmp_path, folder, folder / "model.zip"):
        with strangers_code(True):  # the model has not been sealed
            policy = bench_policy(str(path), env.bench)
        found = policy.act(seen, env.action_masks().astype(np.int8), np.zeros(3, dtype=np.int64), np.arange(3))
        np.testing.assert_array_equal(found, expected)
    with strangers_code(True), pytest.raises(ValueError, match="was trained for"):
        bench_policy(str(tmp_path), RoleEnv("wurtz_dodecane", bench="ext").bench)
