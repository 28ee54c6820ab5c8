"""Checkers of Gymnasium and Stable-Baselines3 on benches and views; Gymnasium's wrappers."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode
from helpers import FEATURED, random_legal, refused

from chemlab.agents.background import role_env, role_vector_env
from chemlab.config.loading import load_scenario
from chemlab.record import scenario_hash

MANAGER, AGENT = "chemlab/LabManager-v1", "chemlab/LabAgent-v1"
CHECKED: list[tuple[str, dict[str, Any]]] = [
    *((name, {}) for name in gymnasium.registry if name.startswith("chemlab/") and name not in (MANAGER, AGENT)),
    *((MANAGER, {"scenario": name}) for name in FEATURED),
    *((AGENT, {"scenario": name, "agent": bench}) for name in FEATURED for bench in load_scenario(name).bench_agents()),
]
"""Every registered bench, and every agent of scenarios."""


@pytest.mark.parametrize(("name", "arguments"), CHECKED)
def test_checkers_find_nothing(name: str, arguments: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(name, **arguments, render_mode="ansi", disable_env_checker=True).unwrapped)
        # Stable-Baselines3's advises actions in [-1, 1]; the laboratory's are fractions.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized Box action space.*")
        checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra train")
        checker.check_env(gymnasium.make(name, **arguments))


def test_the_managers_id_is_the_agents_for_the_manager() -> None:
    one, other = gymnasium.make(MANAGER), gymnasium.make(AGENT, agent="manager_0")
    check_environments_match(one, other, num_steps=100, seed=3, info_comparison="keys-superset")


@pytest.mark.filterwarnings("error::UserWarning")
def test_wrappers() -> None:
    """Gymnasium's passive checker is one of them, and warns of nothing."""
    env = gymnasium.make(MANAGER, max_episode_steps=7)
    env = gymnasium.wrappers.RecordEpisodeStatistics(env)
    env = gymnasium.wrappers.FrameStackObservation(env, 2)
    env = gymnasium.wrappers.FlattenObservation(env)
    env = gymnasium.wrappers.NormalizeReward(env)
    env = gymnasium.wrappers.RescaleObservation(env, np.float32(-1.0), np.float32(1.0))
    rng = np.random.default_rng(0)
    seen, info = env.reset(seed=0)
    bare = role_env()
    bare.reset(seed=0)
    earned, steps, over = 0.0, 0, False
    while not over:
        assert env.observation_space.contains(seen)
        action = random_legal(env.action_space, info.get("action_mask"), rng)
        seen, _, terminated, truncated, info = env.step(action)
        earned += bare.step(action)[1]
        steps, over = steps + 1, terminated or truncated
    assert steps <= 7
    assert (info["episode"]["l"], info["episode"]["r"]) == (steps, pytest.approx(earned, abs=1e-9))


def test_vector_wrappers() -> None:
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(role_vector_env(4))
    wrapped = gymnasium.wrappers.vector.NormalizeObservation(wrapped)
    wrapped = gymnasium.wrappers.vector.ClipReward(wrapped, -1.0, 1.0)
    _, infos = wrapped.reset(seed=0)
    rng = np.random.default_rng(0)
    episodes = 0
    for _ in range(60):
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in infos["action_mask"]])
        seen, _, terminated, truncated, infos = wrapped.step(actions)
        assert np.isfinite(seen).all()
        over = terminated | truncated
        assert ("episode" in infos) == bool(over.any())
        episodes += int(over.sum())
    assert episodes > 0


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("chemlab/WurtzReaction-v0", {}),
        ("chemlab/WurtzExtraction-v0", {}),
        ("chemlab/Bench-v1", {"scenario": "salt_from_oil", "bench": "ext"}),
        (MANAGER, {"scenario": "wurtz_scarce"}),
        ("chemlab/LabAgent-v1", {"agent": "ext_0"}),
    ],
)
def test_episodes_are_shorter_than_the_spec_says(name: str, arguments: dict[str, Any]) -> None:
    """The longest episode there can be ends as it does without a time limit, also where clients put one by the spec."""
    env = gymnasium.make(name, **arguments)
    bound = env.spec.max_episode_steps
    limited = gymnasium.make(env.spec)
    found: Any = env
    while found is not env.unwrapped:
        assert not isinstance(found, gymnasium.wrappers.TimeLimit)
        found = found.env
    steps = []
    for one in (env, limited):
        one.reset(seed=0)
        count, over = 0, (False, False)
        while not any(over):
            actions, action = one.action_space, np.full(one.action_space.shape or (), 0.5)  # type: ignore[attr-defined]
            if isinstance(actions, gymnasium.spaces.Discrete):
                # A masked action is a lost turn: nothing but the limit ends the episode (`settle` where all are legal).
                action = one.unwrapped.action_masks().argmin()  # type: ignore[attr-defined]
            _, _, terminated, truncated, _ = one.step(action)
            over = bool(terminated), bool(truncated)
            count += 1
        steps.append((count, over))
    assert steps[0] == steps[1]
    assert steps[0][1] in ((True, False), (False, True))
    # Others end the episodes of an agent in a laboratory sooner.
    assert steps[0][0] < bound if name == "chemlab/LabAgent-v1" else steps[0][0] == bound - 1


def test_batches_are_not_cut_short() -> None:
    single = gymnasium.make("chemlab/WurtzReaction-v0")
    batch = gymnasium.make_vec(single.spec, num_envs=2)
    assert batch.spec.max_episode_steps == single.spec.max_episode_steps == 21
    said = r"max_episode_steps.*up to 20 steps.*given 7"
    refused(said, gymnasium.make_vec, "chemlab/WurtzReaction-v0", num_envs=2, max_episode_steps=7)


def _given(how: str, folder: Path) -> Any:
    """A scenario as an environment may be given it."""
    mine = folder / "mine.toml"
    mine.write_text('name = "mine"\nbase = "wurtz_dodecane"\n')
    return {
        "path": mine,
        "loaded by name": load_scenario("wurtz_dodecane"),
        "loaded from a file": load_scenario(mine),
        "changed": load_scenario(mine).model_copy(update={"ambient_pressure_kpa": 95.0}),
        "of another split": load_scenario("rush", split="test"),
        "another tier": load_scenario("wurtz_real").model_copy(update={"ambient_pressure_kpa": 95.0}),
    }[how]


@pytest.mark.parametrize(
    "how", ["path", "loaded by name", "loaded from a file", "changed", "another tier", "of another split"]
)
def test_specs_are_json_that_makes_the_same_environment(how: str, tmp_path: Path) -> None:
    scenario = _given(how, tmp_path)
    made = {
        "chemlab/Bench-v1": {"bench": "rxn" if how == "of another split" else "ext"},
        MANAGER: {"rewards": load_scenario("wurtz_dodecane").rewards.model_copy(update={"manager_local": 0.5})},
    }
    for name, arguments in made.items():
        env = gymnasium.make(name, scenario=scenario, **arguments)
        again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        np.testing.assert_array_equal(env.reset(seed=5)[0], again.reset(seed=5)[0])
        one, other = (each.unwrapped.scenario for each in (env, again))  # type: ignore[attr-defined]
        assert scenario_hash(one) == scenario_hash(other)
        assert one.split == other.split
        batch = gymnasium.make_vec(name, num_envs=2, scenario=scenario, autoreset_mode=AutoresetMode.SAME_STEP)
        repeated = gymnasium.make_vec(EnvSpec.from_json(batch.spec.to_json()))
        assert repeated.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        np.testing.assert_array_equal(batch.reset(seed=5)[0], repeated.reset(seed=5)[0])
        kept = {"loaded by name": "wurtz_dodecane", "of another split": "rush"}
        kept |= dict.fromkeys(("path", "loaded from a file"), str(tmp_path / "mine.toml"))
        assert env.spec.kwargs["scenario"] == kept.get(how, env.spec.kwargs["scenario"]), "as short as it can be"


def test_a_spec_has_no_salt() -> None:
    split = f"private:{'0f' * 16}"
    for arguments in ({"scenario": load_scenario("rush", split=split)}, {"scenario": "rush", "split": split}):
        env = gymnasium.make("chemlab/Bench-v1", bench="rxn", **arguments)
        assert "0f" * 16 not in env.spec.to_json()
        refused(r"split: must be .* or private:SALT", gymnasium.make, env.spec)
        again = gymnasium.make(env.spec, split=split)
        np.testing.assert_array_equal(env.reset(seed=5)[0], again.reset(seed=5)[0])


@pytest.mark.parametrize(("name", "arguments"), [(MANAGER, {}), (AGENT, {"agent": "ext_0"}), ("chemlab/Bench-v1", {})])
def test_infos_have_types_of_numpys_and_stay_arrays_in_vector_environments(name: str, arguments: Any) -> None:
    env = gymnasium.make(name, **arguments)
    rng = np.random.default_rng(0)
    first = env.reset(seed=0)[1]
    for info in (first, env.step(random_legal(env.action_space, first.get("action_mask"), rng))[4]):
        for key, value in info.items():
            assert isinstance(value, (np.ndarray, np.number)), key
    several = gymnasium.vector.SyncVectorEnv([lambda: gymnasium.make(name, **arguments)] * 2)
    native = gymnasium.make_vec(name, num_envs=2, **arguments)
    infos, expected = several.reset(seed=0)[1], native.reset(seed=0)[1]
    for key, values in expected.items():
        assert infos[key].dtype == values.dtype, key
        np.testing.assert_array_equal(infos[key], values)


@pytest.mark.parametrize("name", ["chemlab/WurtzExtraction-v0", MANAGER])
def test_infos_of_the_last_step_are_where_gymnasium_puts_them(name: str) -> None:
    mode = {"autoreset_mode": AutoresetMode.SAME_STEP}
    native: Any = gymnasium.make_vec(name, 2, **mode)
    several = gymnasium.make_vec(name, 2, "sync", vector_kwargs=mode)
    masks, rng, ends = native.reset(seed=0)[1]["action_mask"], np.random.default_rng(0), 0
    several.reset(seed=0)
    for _ in range(90):
        actions = np.array([random_legal(native.single_action_space, mask, rng) for mask in masks])
        *_, infos = native.step(actions)
        *_, expected = several.step(actions)
        masks = infos["action_mask"]
        assert ("final_info" in infos) == ("final_info" in expected)
        for key, values in infos.get("final_info", {}).items():
            over = infos["_final_info"]
            np.testing.assert_array_equal(values[over], expected["final_info"][key][over])
            ends += 1
    assert ends


def test_what_a_wrapper_writes_into_a_batchs_infos_stays_where_it_is() -> None:
    env = gymnasium.make_vec("chemlab/WurtzExtraction-v0", num_envs=2)
    _, infos = env.reset(seed=0)
    arrays = [value for value in infos.values() if isinstance(value, np.ndarray)]
    for i, one in enumerate(arrays):
        assert not any(np.shares_memory(one, other) for other in arrays[:i])
