"""Recipes run, and their page has the numbers that are kept of them."""

import json
import math
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import script

from chemlab.agents.demonstrations import demonstrations
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.record import read_record

ROOT = Path(__file__).parent.parent
RECIPES = sorted(path for path in (ROOT / "recipes").glob("*.py") if path.stem != "recipe_parts")
LEARNING = ("stable_baselines3", "sb3_contrib")
NEEDS = {
    "bayesian": ("sklearn",),
    "planning": (),
    "demonstrations": (*LEARNING, "minari", "h5py"),
    "value_based": (*LEARNING, "benchmarl"),
    "rllib": (*LEARNING, "ray.rllib"),
}
"""Packages that a recipe needs, where it is not what most need."""
pytestmark = pytest.mark.skipif(not RECIPES, reason="not a checkout")


def recipe(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A recipe as a module, if all that it needs is there."""
    for package in NEEDS.get(name, LEARNING):
        pytest.importorskip(package)
    monkeypatch.syspath_prepend(str(ROOT / "recipes"))
    return script(f"recipes/{name}.py")


@pytest.mark.slow
@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_recipes_run(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is kept of a toy run is what it printed, finite, and of everybody it names."""
    for package in NEEDS.get(path.stem, LEARNING):
        pytest.importorskip(package)
    seeds = 2 if path.stem in ("planning", "shaping") else 1
    out = tmp_path / "result.json"
    words = [str(path), "--toy", "--seeds", str(seeds), "--out", str(out)]
    if path.stem == "rllib":  # Ray ends with its process
        printed = subprocess.run([sys.executable, *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    else:
        monkeypatch.chdir(ROOT)
        monkeypatch.syspath_prepend(str(ROOT / "recipes"))
        monkeypatch.setattr(sys, "argv", words)
        monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # which a recipe sets
        runpy.run_path(str(path), run_name="__main__")
        printed = capsys.readouterr().out
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found == json.loads(printed)
    assert found["toy"]
    assert {"plain PPO", "scripted"} & set(found["outcomes"])
    for outcome in found["outcomes"].values():
        assert len(outcome["by_seed"]) == seeds
        assert all(math.isfinite(value) for value in (outcome["mean"], outcome["cost"], *outcome["by_seed"]))
        assert outcome["mean"] == pytest.approx(sum(outcome["by_seed"]) / seeds, abs=1e-4)
    # The script knows nothing that a seed would change, and plays the same episodes.
    assert len(set(found["outcomes"].get("scripted", {"by_seed": [0.0]})["by_seed"])) == 1


def test_the_page_has_the_kept_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    from recipes import PAGE, table

    assert "\n".join(table()) in PAGE.read_text(encoding="utf-8"), "run: python docs/recipes.py"


@pytest.mark.parametrize("path", sorted((ROOT / "recipes" / "results").glob("*.json")), ids=lambda path: path.stem)
def test_kept_results_are_no_toys(path: Path) -> None:
    """And say the command that makes them, which names this file and is the recipe's own."""
    found = json.loads(path.read_text(encoding="utf-8"))
    assert not found["toy"]
    assert found["command"].startswith(f"python recipes/{path.stem}.py ")
    assert f"recipes/results/{path.name}" in found["command"]
    assert f"    {found['command']}\n" in (ROOT / "recipes" / f"{path.stem}.py").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize(("trainer", "package"), [("sb3", "sb3_contrib"), ("torchrl", "torchrl"), ("chemlab", "torch")])
def test_first_teams_learn(trainer: str, package: str, tmp_path: Path) -> None:
    """A run of seconds has a curve up to the turns that were asked for."""
    pytest.importorskip(package)
    path = ROOT / "recipes" / "first_team" / "trainers.py"
    command = [sys.executable, str(path), trainer, "--steps", "100", "--out", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, timeout=1800)
    found = json.loads((tmp_path / f"{trainer}.json").read_text(encoding="utf-8"))
    assert found["curve"][-1][0] >= 100
    assert all(math.isfinite(mean) for _, mean in found["curve"])
    assert found["random"] < found["scripted"]


def test_kept_curves_are_of_the_printed_command() -> None:
    """All three end near the scripted bench, as the page says, and began as bad as random play."""
    for trainer in ("chemlab", "sb3", "torchrl"):
        path = ROOT / "recipes" / "first_team" / "results" / f"{trainer}.json"
        found = json.loads(path.read_text(encoding="utf-8"))
        assert found["command"] == f"python recipes/first_team/trainers.py {trainer} --steps 8000"
        assert found["curve"][-1][1] > 0.8 * found["scripted"] > found["random"]


def test_a_multiplier_takes_cost_off_rewards_and_ascends(monkeypatch: pytest.MonkeyPatch) -> None:
    constrained = recipe("constrained", monkeypatch)
    envs = [constrained.Priced(constrained.training_envs(constrained.TARGET, constrained.GOAL), m) for m in (0.0, 3.0)]
    for env in envs:
        env.seed(0)
        env.reset()
    everything_hot = np.tile(np.array([1.0, 0.5, 1.0], dtype=np.float32), (envs[0].num_envs, 1))
    total = np.zeros(envs[0].num_envs)
    for _ in range(constrained.PRICED.benches["rxn"].step_limit):
        (_, free, _, infos), (_, priced, dones, _) = (env.step(everything_hot) for env in envs)
        cost = np.array([info["cost"] for info in infos])
        np.testing.assert_allclose(priced, free - 3.0 * cost, atol=1e-6)
        total += cost
    assert dones.all()
    assert total.max() > 0.0
    np.testing.assert_allclose(envs[1].ended, total)
    callback = constrained.DualAscent()
    callback.model = SimpleNamespace(get_env=lambda: envs[1])
    callback.on_rollout_end()
    assert envs[1].multiplier == pytest.approx(3.0 + constrained.RATE * (total.mean() - constrained.LIMIT))
    assert envs[1].ended == []


def test_a_mixture_pays_at_the_end_where_all_of_it_is_near(monkeypatch: pytest.MonkeyPatch) -> None:
    env = recipe("goals", monkeypatch).Mixtures(np.array([[0.0] * 5 + [1.0]]))
    env.reset(seed=0)
    rewards, over = [], False
    while not over:
        seen, reward, over, _, _ = env.step(env.action_space.n - 1)  # hold: nothing is made
        rewards.append(reward)
    assert rewards == [0.0] * (len(rewards) - 1) + [1.0]
    achieved = np.stack([seen["achieved_goal"]] * 2)
    desired = achieved + np.array([[0.049], [0.051]]) * np.eye(6)[0]
    assert env.compute_reward(achieved, desired, None).tolist() == [1.0, 0.0]


def test_demonstrated_turns_are_the_records_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Of each episode all turns but the end, with what a discount makes of the rewards that follow."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # which the recipe sets
    made = recipe("demonstrations", monkeypatch)
    demonstrated = made.dataset(tmp_path, 2, 5)
    seen, masks, actions, returns = made.examples(demonstrated, 0.9)
    assert len(seen) == len(masks) == len(actions) == len(returns) == demonstrated.total_steps
    assert masks[np.arange(len(actions)), actions].all()
    at = 0
    for seed, episode in zip((5, 6), demonstrated.iterate_episodes(), strict=True):
        told = demonstrations(read_record(tmp_path / f"{seed}.jsonl"))["manager_0"][0]
        assert actions[at : at + len(told.actions)].tolist() == told.actions
        for t in range(len(told.rewards)):
            following = sum(0.9**k * reward for k, reward in enumerate(told.rewards[t:]))
            assert returns[at + t] == pytest.approx(following, abs=1e-6)
        np.testing.assert_array_equal(seen[at], episode.observations[0])
        at += len(told.rewards)
    assert at == len(actions)


@pytest.mark.parametrize("limit", [None, 7])
def test_shaping_keeps_the_order_of_returns(limit: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum telescopes: to -phi(s_0), and to gamma^T phi(s_T) - phi(s_0) where the episode is only truncated."""
    shaping = recipe("shaping", monkeypatch)
    weights = np.sin(np.arange(RoleEnv("wurtz_dodecane", bench="ext").observation_space.shape[0], dtype=np.float64))
    gamma, members = 0.93, 4
    batches = [RoleVectorEnv(members, "wurtz_dodecane", bench="ext", autoreset_mode="SameStep") for _ in range(2)]
    env, plain = shaping.PotentialShaping(batches[0], lambda seen: seen @ weights, gamma), batches[1]
    first = env.reset(seed=3)[0].copy()
    plain.reset(seed=3)
    rng, sums, over = np.random.default_rng(0), np.zeros((2, members)), np.zeros(members, dtype=bool)
    last, turns = first.copy(), 0
    while not over.all() and turns != limit:
        actions = rng.integers(plain.action_count - (limit is not None), size=members)  # the last one ends it
        seen, shaped, terminated, _, infos = env.step(actions)
        _, rewards, _, _, _ = plain.step(actions)
        np.testing.assert_array_equal(infos["unshaped_reward"], rewards)
        sums += np.where(over, 0.0, gamma**turns * np.stack([shaped, rewards]))
        over |= terminated
        last, turns = seen.copy(), turns + 1
    expected = sums[1] - first @ weights + (0.0 if limit is None else gamma**turns * (last @ weights))
    np.testing.assert_allclose(sums[0], expected, atol=1e-9)
    assert not np.allclose(sums[0], sums[1])
