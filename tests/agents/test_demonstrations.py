"""Demonstrations: what datasets hold is what happens in the environments they are of."""

import json
import warnings
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest
from helpers import command, laboratory, record_episode, refused
from typer.testing import CliRunner

from chemlab.agents.demonstrations import demonstrations, write_datasets
from chemlab.cli import app
from chemlab.config.loading import load_scenario
from chemlab.envs.role_env import RoleEnv
from chemlab.record import read_record
from chemlab.render.history import RecordReplay


@pytest.fixture(scope="module")
def scripted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of a scripted episode."""
    return record_episode(tmp_path_factory.mktemp("demonstrations") / "scripted.jsonl", named=True)


PLAYED = [("wurtz_two_lines", "scripted", {}), ("wurtz_two_lines", "careless", {}), ("wurtz_safe", "careless", {})]


@pytest.mark.parametrize(
    ("scenario", "policy", "more"), [*PLAYED, ("wurtz_dodecane", "scripted", {"rewards": "mixed"})]
)
def test_nothing_earned_is_lost(scenario: str, policy: str, more: Any, tmp_path: Path) -> None:
    """Rewards of an agent's episodes add up to the record's; turns and costs likewise."""
    found = read_record(record_episode(tmp_path / "one.jsonl", scenario, policy, 5, **more, named=True))
    told = demonstrations(found)
    for agent, episodes in told.items():
        played = [turn for turn in found.turns if agent in turn["play"]]
        assert sum(len(d.actions) for d in episodes) == len(played)
        if played:
            earned = sum(sum(d.rewards) for d in episodes)
            assert earned == pytest.approx(found.end["end"]["rewards"][agent], abs=1e-12)
        cost = sum(turn.get("cost", {}).get(agent, 0.0) for turn in played)
        assert sum(sum(d.costs) for d in episodes) == pytest.approx(cost, abs=1e-12)
        for d in episodes:
            assert len(d.observations) == len(d.elapsed) == len(d.costs) == len(d.actions) + 1
            assert len(d.masks) in (0, len(d.observations))
            assert d.terminated != d.truncated
            assert d.elapsed[0] == 0
    # The manager's elapsed ticks add up to the episode's; a bench has a turn each tick.
    (manager,) = told["manager_0"]
    assert sum(manager.elapsed) == found.end["end"]["ticks"]
    benches = [d for agent, episodes in told.items() if agent != "manager_0" for d in episodes]
    assert {ticks for d in benches for ticks in d.elapsed[1:]} == {1}
    ended = sum(len(turn.get("scores", {})) for turn in found.turns)
    with_turns = sum(d.terminated for d in benches)
    assert with_turns <= ended  # an experiment that was recalled before its first turn is no episode
    assert with_turns == ended or policy != "scripted"


def test_agents_saw_this(tmp_path: Path) -> None:
    """Observations, masks and elapsed ticks are those of the AEC environment, where the same actions are played."""
    found = read_record(record_episode(tmp_path / "one.jsonl", "wurtz_two_lines", "careless", 8, named=True))
    env = laboratory("wurtz_two_lines", 8)
    told = demonstrations(found)
    at = {agent: [(d, i) for d in episodes for i in range(len(d.actions))] for agent, episodes in told.items()}
    for turn in found.turns:
        ((agent, (_, action)),) = turn["play"].items()
        assert env.agent_selection == agent
        seen, _, _, _, info = env.last()
        d, i = at[agent].pop(0)
        np.testing.assert_array_equal(d.observations[i], seen)
        if "action_mask" in info:
            np.testing.assert_array_equal(d.masks[i], info["action_mask"])
        if i:
            assert d.elapsed[i] == info["elapsed_ticks"]
        env.step(np.array(action) if isinstance(action, list) else action)
    assert not any(at.values())


@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "wurtz_dodecane_direct"])
def test_experiments_are_episodes_of_the_single_bench(scenario: str, tmp_path: Path) -> None:
    """From the vessel that came to it, the single-bench environment shows and pays the same, to the last step."""
    found = read_record(record_episode(tmp_path / "one.jsonl", scenario, named=True))
    told = demonstrations(found)
    waiting = {agent: list(episodes) for agent, episodes in told.items()}
    replay = RecordReplay(found)
    labs = replay.laboratories
    compared = 0
    for move in replay.moves():
        if not move.started:
            continue
        number = labs.agents.index(move.started)
        bench, experiments = labs.benches[number - 1], labs.experiments[number - 1]
        env = RoleEnv(scenario, bench=bench.key)
        env.reset(seed=0, options={"goal": bench.goals.names[experiments.goal[0]]})
        env.batch.shelf.rows[:] = labs.shelf.rows[experiments.places[0]]
        env.batch.shelf.stock[0] = labs.shelf.stock[0]
        for mine, theirs in zip(env.batch.experiments.arrays(), experiments.arrays(), strict=True):
            mine[:] = theirs
        d = waiting[move.started].pop(0)
        seen = np.empty((1, len(d.observations[0])), dtype=np.float32)
        env.bench.observe(env.batch.shelf, env.batch.experiments, env.batch.members, seen)
        np.testing.assert_array_equal(d.observations[0], seen[0])
        for i, action in enumerate(d.actions):
            seen, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(d.observations[i + 1], seen)
            assert (d.rewards[i], d.costs[i + 1]) == (reward, info["cost"])
            assert (terminated, truncated) == (i == len(d.actions) - 1, False)
            if d.masks:
                np.testing.assert_array_equal(d.masks[i + 1], info["action_mask"])
            compared += 1
    assert compared == sum(len(d.actions) for agent, ds in told.items() if agent != "manager_0" for d in ds)


def test_an_unfinished_record_is_truncated(scripted: Path, tmp_path: Path) -> None:
    part = tmp_path / "torn.jsonl"
    part.write_bytes(b"\n".join(scripted.read_bytes().split(b"\n")[:31]) + b"\n")
    told = demonstrations(read_record(part))
    assert [d.truncated for d in told["manager_0"]] == [True]
    assert [d.terminated for d in told["rxn_0"]] == [True]
    assert [(d.terminated, d.truncated) for d in told["ext_0"]] == [(True, False), (False, True)][: len(told["ext_0"])]


@pytest.fixture
def minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Minari, with its datasets in a folder of the test's."""
    found = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    return found


def assert_replays(dataset: Any, env: Any, seeds: tuple[int, ...]) -> None:
    """Reset with its seed, an environment shows and pays what each episode of a dataset has."""
    for episode, seed in zip(dataset.iterate_episodes(), seeds, strict=True):
        seen, info = env.reset(seed=seed)
        np.testing.assert_array_equal(episode.observations[0], seen)
        for i, action in enumerate(episode.actions):
            for key, values in (episode.infos or {}).items():
                np.testing.assert_array_equal(values[i], info.get(key, 0), key)  # no ticks before the first turn
            seen, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(episode.observations[i + 1], seen)
            assert episode.rewards[i] == reward
            assert (episode.terminations[i], episode.truncations[i]) == (terminated, truncated)


def test_datasets_replay_in_the_environment_they_name(minari: Any, scripted: Path, tmp_path: Path) -> None:
    """The manager's, loaded."""
    second = record_episode(tmp_path / "second.jsonl", seed=4, named=True)
    written = write_datasets([scripted, second], "tests/wurtz")
    assert [dataset.agent for dataset in written] == ["manager_0", "rxn_0", "ext_0", "dit_0"]
    dataset = minari.load_dataset("tests/wurtz/manager_0-v0")
    env = dataset.recover_environment()
    assert (env.observation_space, env.action_space) == (dataset.observation_space, dataset.action_space)
    assert [entry["seed"] for entry in dataset.storage.get_episode_metadata([0, 1])] == [3, 4]
    assert {"action_mask", "elapsed_ticks"} <= next(dataset.iterate_episodes()).infos.keys()
    assert_replays(dataset, env, (3, 4))


def mine(folder: Path) -> Path:
    """A scenario file of one's own."""
    path = folder / "mine.toml"
    path.write_text('name = "mine"\nbase = "wurtz_dodecane"\nambient_pressure_kpa = 95.0\n')
    return path


def test_datasets_of_environments_with_scenarios_of_ones_own_name_them(minari: Any, tmp_path: Path) -> None:
    env = gymnasium.make("chemlab/Bench-v1", scenario=load_scenario(mine(tmp_path)), bench="ext")
    steps: dict[str, list[Any]] = {key: [] for key in ("actions", "rewards", "terminations", "truncations")}
    observations = [env.reset(seed=1)[0]]
    while not any(steps["terminations"]):
        action = env.action_space.sample()
        seen, *values, _ = env.step(action)
        observations.append(seen)
        for kept, value in zip(steps.values(), (action, *values), strict=True):
            kept.append(value)
    buffer = minari.data_collector.EpisodeBuffer(
        observations=np.array(observations), **{key: np.array(values) for key, values in steps.items()}
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".* is set to None")
        dataset = minari.create_dataset_from_buffers("tests/collected-v0", [buffer], env=env)
    again = dataset.recover_environment()
    assert again.unwrapped.bench.scenario.ambient_pressure_kpa == 95.0
    assert_replays(dataset, again, (1,))


def test_datasets_of_records_of_scenarios_of_ones_own_name_their_environment(minari: Any, tmp_path: Path) -> None:
    path = record_episode(tmp_path / "mine.jsonl", scenario=mine(tmp_path), named=True)
    mine(tmp_path).unlink()  # the record has all of it
    write_datasets([path], "tests/mine", agents=["manager_0"])
    dataset = minari.load_dataset("tests/mine/manager_0-v0")
    assert_replays(dataset, dataset.recover_environment(), (3,))


def test_datasets_of_a_split_name_it(minari: Any, tmp_path: Path) -> None:
    path = record_episode(tmp_path / "a.jsonl", scenario="unlabelled", split="test")
    write_datasets([path], "tests/split", agents=["manager_0"])
    env = minari.load_dataset("tests/split/manager_0-v0").recover_environment()
    assert env.unwrapped.scenario.split.name == "test"


def test_bench_datasets_have_the_spaces_of_the_bench(minari: Any, scripted: Path) -> None:
    write_datasets([scripted], "tests/benches")
    for agent, key in (("rxn_0", "rxn"), ("ext_0", "ext"), ("dit_0", "dit")):
        dataset = minari.load_dataset(f"tests/benches/{agent}-v0")
        env = RoleEnv("wurtz_dodecane", bench=key)
        assert (dataset.observation_space, dataset.action_space) == (env.observation_space, env.action_space)
        assert dataset.recover_environment().unwrapped.bench.key == key
        told = demonstrations(read_record(scripted))[agent]
        for d, episode in zip(told, dataset.iterate_episodes(), strict=True):
            np.testing.assert_array_equal(np.array(d.observations), episode.observations)
            np.testing.assert_array_equal(np.array(d.actions), episode.actions)
            np.testing.assert_array_equal(d.rewards, episode.rewards)
            assert episode.terminations.tolist() == [False] * (len(d.actions) - 1) + [True]


def test_the_command(minari: Any, scripted: Path) -> None:
    arguments = ["export", "demos", str(scripted), "-o", "tests/command", "--agent", "manager_0"]
    (row,) = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)
    assert row["id"] == "tests/command/manager_0-v0"
    assert minari.load_dataset(row["id"]).total_steps == row["steps"]
    assert "already exists" in command(*arguments, code=2)
    spaced = command("export", "demos", scripted, "--name", "chem lab", code=2)
    assert spaced.split(";")[1].strip() == "given 'chem lab'"
    assert "error: --name: a dataset's name has two or more letters" in spaced
    command(*arguments, "--force")


def test_a_dataset_is_replaced_whole(minari: Any, scripted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["export", "demos", str(scripted), "-o", "tests/kept", "--agent", "manager_0", "--force"]
    command(*arguments)
    before = minari.load_dataset("tests/kept/manager_0-v0").total_steps
    with monkeypatch.context() as patch:
        patch.setattr(minari, "create_dataset_from_buffers", Mock(side_effect=OSError(28, "No space left on device")))
        command(*arguments, code=2)
    assert minari.load_dataset("tests/kept/manager_0-v0").total_steps == before
    folder = minari.storage.get_dataset_path("tests/kept/manager_0-v0").parent
    command(*arguments)
    assert [path.name for path in folder.iterdir() if path.is_dir()] == ["manager_0-v0"]


def test_what_did_not_happen_is_no_demonstration(minari: Any, scripted: Path, tmp_path: Path) -> None:
    empty, edited = tmp_path / "empty.jsonl", tmp_path / "edited.jsonl"
    header, first, *others = scripted.read_text(encoding="utf-8").splitlines(keepends=True)
    empty.write_text(header, encoding="utf-8")
    changed = first.replace('"tick":0', '"tick":1')
    assert changed != first
    edited.write_text("".join([header, changed, *others]), encoding="utf-8")
    other = record_episode(tmp_path / "other.jsonl", "salt_from_oil", named=True)
    for message, records, *more in (
        ("is given twice", [scripted, scripted.parent / "." / scripted.name], "tests/none"),
        (r"empty\.jsonl: no agent has a turn", [empty], "tests/none"),
        ("cannot serve as a demonstration", [edited], "tests/edited"),
        ("another scenario", [scripted, other], "tests/both"),
        ("unknown agent chef", [scripted], "tests/chef", ["chef"]),
        (r"--name: .* given '\.\./away'", [scripted], "../away"),
    ):
        refused(message, write_datasets, records, *more)
    assert not (tmp_path / "datasets" / "tests").exists()
