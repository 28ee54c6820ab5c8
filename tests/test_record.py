"""Records of episodes: what is honest is found right, what is not is found and named, what is torn can be read."""

import contextlib
import errno
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from helpers import command, four_solvents, random_legal, record_episode, refused
from typer.testing import CliRunner

import chemlab
import chemlab.record.format as format_module
import chemlab.record.recorder as recorder_module
import chemlab.record.verify as verify_module
from chemlab.agents.demonstrations import demonstrations
from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.cli import app
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.parallel import parallel_env
from chemlab.lab.engine import Laboratories
from chemlab.record import LIMITS, Play, Recorder, RecordError, read_record, verify_record
from chemlab.roles.manager_actions import START, SUBMIT, WAIT

runner = CliRunner()
Lines = list[dict[str, Any]]


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of a scripted episode, with a measurement in it."""
    return record_episode(tmp_path_factory.mktemp("honest") / "episode.jsonl")


# -- honest records -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", ["scripted", "random", "careless"])
@pytest.mark.parametrize("name", ["failing", "wurtz_two_lines", "aspirin"])
def test_honest_records_are_right(name: str, policy: str, tmp_path: Path) -> None:
    path = record_episode(tmp_path / "a.jsonl", name, policy, 1)
    result, record = verify_record(path), read_record(path)
    assert result.status == "ok", result.message
    assert result.turns == len(record.turns) > 0
    assert (record.torn, record.broken) == (False, None)
    assert any("lost" in turn for turn in record.turns) == (policy == "careless")


def test_a_record_says_what_happened(tmp_path: Path) -> None:
    """Rewards, score, contents and readings are those of the laboratory, to the last bit."""
    env = raw_env("wurtz_dodecane")
    path = tmp_path / "a.jsonl"
    labs, contents, rewards = env.laboratories, [], []

    def watch(turn: Any) -> None:
        contents.append(labs.shelf.amounts[0].copy())
        rewards.append(dict(env.rewards))

    with Recorder(path, labs) as recorder:
        result = play_episode(env, make_policies("scripted", labs, 0), 0, watch=watch, recorder=recorder)
    record = read_record(path)
    end = record.end["end"]
    assert (end["score"], end["rewards"], end["costs"]) == (result.score, result.rewards, result.costs)
    vessels: dict[str, Any] = dict(record.header["hidden"]["vessels"])
    for turn, amounts, earned in zip(record.turns, contents, rewards, strict=True):
        assert {k: v for k, v in earned.items() if v} == turn.get("rewards", {})
        vessels.update(turn["hidden"].get("vessels", {}))
        for position, row in enumerate(amounts):
            vessel = vessels.get(str(position))
            assert row.tolist() == (vessel[1] if vessel else [0.0] * len(row))
    readings = [turn["reading"] for turn in record.turns if "reading" in turn]
    assert readings
    for reading in readings:
        size = next(c.size for c in labs.instruments.channels if c.name == reading["instrument"])
        assert len(reading["values"]) == size
    # What agents must not see stands under one key.
    shown = {"turn", "tick", "play", "rewards", "cost", "lost", "events", "scores", "reading"}
    assert all(set(turn) <= {*shown, "hidden"} for turn in record.turns)


@pytest.mark.parametrize("name", ["wurtz_dodecane", "relay"])
def test_what_was_played_before_leaves_nothing_in_a_record(name: str, tmp_path: Path) -> None:
    """Pictures, layers and supplies of an episode before are no state of this one."""
    env = raw_env(name)
    labs, records = env.laboratories, []
    for number, seed in enumerate((3, 8, 3)):
        path = tmp_path / f"{number}.jsonl"
        with Recorder(path, labs) as recorder:
            play_episode(env, make_policies("scripted", labs, seed), seed, recorder=recorder)
        records.append(path.read_bytes())
    assert records[0] == records[2] != records[1]


def test_streams_that_went_on(tmp_path: Path) -> None:
    """An episode without a seed of its own is played again from the streams it began with, whatever misuse."""
    env, path, rng = raw_env("wurtz_any"), tmp_path / "a.jsonl", np.random.default_rng(8)
    env.reset(seed=5)
    env.reset()
    recorder = Recorder(path, env.laboratories)
    refused("begin", recorder.turn, [])
    recorder.begin()
    refused("not over", recorder.begin)
    while not path.exists():
        agent, (observation, _, _, _, info) = env.agent_selection, env.last()
        mask = info.get("action_mask")
        action = random_legal(env.action_space(agent), mask, rng)
        env.step(action)
        recorder.turn([Play(env.possible_agents.index(agent), observation, mask, action)])
    assert verify_record(path).status == "ok"
    lines = load(path)
    lines[0]["streams"]["ext_0"] += 1
    assert verify_record(store(path, lines)).key == "hidden.state"


def test_rounds_of_the_parallel_environment(tmp_path: Path) -> None:
    """Some actions of a box are given as integers."""
    path = tmp_path / "a.jsonl"
    env = parallel_env("wurtz_dodecane")
    labs: Laboratories = env.unwrapped.laboratories
    recorder = Recorder(path, labs, rounds=True)
    observations, infos = env.reset(seed=4)
    recorder.begin(np.int64(4))  # type: ignore[arg-type]
    rng, together = np.random.default_rng(0), 0
    rare = np.where(np.isin(labs.actions.table[:, 0], (START, WAIT)), 1.0, 0.03)
    rare[labs.actions.table[:, 0] == SUBMIT] = 1e-4
    while env.agents:
        acting = [agent for agent in labs.agents if infos[agent]["has_turn"]]
        actions: dict[str, Any] = {}
        for agent in acting:
            mask = infos[agent].get("action_mask")
            actions[agent] = random_legal(env.action_space(agent), mask, rng)
            if agent == "manager_0":
                actions[agent] = rng.choice(len(mask), p=mask * rare / (mask * rare).sum())
            elif mask is None and together % 2:
                actions[agent] = np.rint(actions[agent]).astype(np.int64)
        shown = [Play(labs.agents.index(a), observations[a], infos[a].get("action_mask"), actions[a]) for a in acting]
        observations, _, _, _, infos = env.step(actions)
        recorder.turn(shown)
        together += len(acting) > 1
    assert together > 5
    result = verify_record(path)
    assert result.status == "ok", result.message
    found = read_record(path)
    for agent, episodes in demonstrations(found).items():
        earned = sum(sum(one.rewards) for one in episodes)
        assert earned == pytest.approx(found.end["end"]["rewards"][agent], abs=1e-12)


def test_a_scenario_of_ones_own_needs_no_file(tmp_path: Path) -> None:
    """The record holds the scenario; what the file says afterwards does not matter."""
    file, text = tmp_path / "mine.toml", 'base = "salt_from_oil"\nname = "mine"\n'
    file.write_text(text)
    path = record_episode(tmp_path / "a.jsonl", file)
    file.unlink()
    result = verify_record(path)
    assert (result.status, "mine is the record's own" in result.message) == ("foreign", True)
    assert verify_record(path, scenario="salt_from_oil").status == "foreign"
    file.write_text(text)
    assert verify_record(path, scenario=file).status == "ok"
    for more, status in (((), "foreign"), (("--scenario", file), "ok")):
        command("replay", path, "--force", *more)
        assert f'"verified":{{"status":"{status}"' in path.with_suffix(".html").read_text()
        command("replay", path, "-o", tmp_path / "a.md", "--force", *more)


@pytest.mark.parametrize("name", [*scenario_names(), ""])
def test_scenarios_survive_being_data(name: str) -> None:
    scenario = load_scenario(name) if name else four_solvents()
    text = json.dumps(dump_scenario(scenario))
    restored = restore_scenario(json.loads(text), "text")
    assert json.dumps(dump_scenario(restored)) == text
    assert list(restored.materials) == list(scenario.materials)


# -- tampering ------------------------------------------------------------------------------------------------


def load(path: Path) -> Lines:
    """The lines of a record."""
    return [json.loads(line) for line in path.read_text().splitlines()]


def store(path: Path, lines: Lines) -> Path:
    """Write lines as a recorder would: anybody can."""
    path.write_text("".join(json.dumps(x, separators=(",", ":"), ensure_ascii=False) + "\n" for x in lines))
    return path


Tamper = Callable[[Lines], Any]


def put(where: int | str, *path: Any, to: Any) -> Tamper:
    """What replaces a value, or makes another of it, in a line by its number or in the first turn's that has a key."""

    def tamper(lines: Lines) -> None:
        place: Any = lines[where] if isinstance(where, int) else next(line for line in lines[1:] if where in line)
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to(place[path[-1]]) if callable(to) else to

    return tamper


def played(agent: str, index: int, to: Any) -> Tamper:
    """What replaces a part of an agent's first action: what it saw, or what it did."""

    def tamper(lines: Lines) -> None:
        play = next(line["play"][agent] for line in lines[1:] if agent in line["play"])
        play[index] = to(play[index])

    return tamper


reward = put("rewards", "rewards", "rxn_0", to=lambda paid: paid + 1e-15)
score = put(-1, "end", "score", to=0.99)
state = put(4, "hidden", "state", to="f" * 16)
TAMPERING: dict[str, tuple[Tamper, str, str]] = {
    "number": (played("rxn_0", 1, lambda action: [0.75, *action[1:]]), "turn 2", "hidden.vessels"),
    "choice": (played("ext_0", 1, lambda action: (action + 1) % 40), "turn", ""),
    "impossible": (put(1, "play", "manager_0", 1, to=10**6), "turn 0", "play"),
    "somebody_else": (put(1, "play", to=lambda play: {"rxn_0": play["manager_0"]}), "turn 0", "play"),
    "removed": (lambda lines: lines.pop(10), "turn 9", "turn"),
    "swapped": (lambda lines: lines.insert(10, lines.pop(11)), "turn 9", "turn"),
    "doubled": (lambda lines: lines.insert(10, lines[10]), "turn 10", "turn"),
    "appended": (lambda lines: lines.append(lines[10]), "", ""),
    "ended_twice": (lambda lines: lines.append(lines[-1]), "", ""),
    "cut_short": (lambda lines: [lines.pop(-2) for _ in range(4)], "end", "end"),
    "seed": (put(0, "seed", to=lambda seed: seed + 1), "header", "streams"),
    "goal": (put(0, "goals", to=["NaCl"]), "header", "goals.0"),
    "stream": (put(0, "streams", "ext_0", to=lambda stream: stream ^ 1), "header", "streams.ext_0"),
    "event_hidden": (lambda lines: next(x for x in lines[1:] if "events" in x).pop("events"), "turn", "events"),
    "something_more": (put(7, "rewards", to={"rxn_0": 1.0}), "turn 6", "rewards"),
    "nobody": (put(7, "play", to={}), "turn 6", "play"),
}
"""What is done to a record: where and at which key the first difference is."""


@pytest.mark.parametrize("name", TAMPERING)
def test_tampering_is_found(name: str, honest: Path, tmp_path: Path) -> None:
    lines, (tamper, where, key) = load(honest), TAMPERING[name]
    before = json.dumps(lines)
    tamper(lines)
    assert json.dumps(lines) != before
    result = verify_record(store(tmp_path / "a.jsonl", lines))
    assert result.status == "tampered", result.message
    assert (result.where[: len(where)], result.key[: len(key)]) == (where, key)
    if where.startswith("turn"):
        assert result.turn == result.turns
        assert result.recorded != result.recomputed


def worn(scenario: dict[str, Any]) -> list[dict[str, Any]]:
    """The benches that wear, of which there is one at least."""
    found = [bench for bench in scenario["benches"].values() if bench.get("wear")]
    assert found
    return found


CONDITIONS: dict[str, tuple[str, Callable[[dict[str, Any]], Any]]] = {
    "life": ("failing", lambda s: [one["wear"].update(life=0.0) for one in worn(s)]),
    "spread": ("failing", lambda s: [one["wear"].update(spread=0.0) for one in worn(s)]),
    "repair": ("failing", lambda s: [one["wear"].update(repair_price=0.0) for one in worn(s)]),
    "drift": ("failing", lambda s: [one.pop("drift", None) for one in s["instruments"].values()]),
    "discrete": ("failing", lambda s: [one.update(actions="discrete") for one in worn(s)]),
    "late": ("rush", lambda s: s["demand"].update(late=1.0)),
    "within": ("rush", lambda s: [order.update(within=200.0) for order in s["demand"]["order"]]),
    "price": ("rush", lambda s: s["demand"]["order"][0].update(price=1000.0)),
    "grades": ("relay", lambda s: s["grades"].update(easy={})),
    "report": ("relay", lambda s: [bench.update(report=1.0) for bench in s["benches"].values()]),
    "told": ("relay", lambda s: [draw.update(told=list(s["benches"])) for draw in s["world"]["draws"].values()]),
    "tick": ("campaign", lambda s: s["shelf"].update(tick=1.0)),
    "purity_among": ("crude", lambda s: s.update(specifications={s["goals"][0]: {"purity_among": s["goals"][:1]}})),
}
"""What is made easier, or otherwise, in the scenario of a record, by the table it stands in."""
CHANGED_SCENARIOS = sorted({name for name, _ in CONDITIONS.values()})


@pytest.fixture(scope="module")
def openings(honest: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Lines]:
    """The first lines of a scripted episode of each, and all of another."""
    folder = tmp_path_factory.mktemp("openings")
    found = {name: load(record_episode(folder / f"{name}.jsonl", name))[:25] for name in CHANGED_SCENARIOS}
    return found | {"wurtz_dodecane": load(honest)}


@pytest.mark.parametrize("what", CONDITIONS)
def test_other_conditions_than_shipped_ones_are_not_ok(what: str, openings: dict[str, Lines], tmp_path: Path) -> None:
    name, make = CONDITIONS[what]
    lines = json.loads(json.dumps(openings[name]))
    assert verify_record(store(tmp_path / "a.jsonl", lines)).status == "torn"
    make(lines[0]["scenario"]["scenario"])
    assert lines != openings[name]
    result = verify_record(store(tmp_path / "b.jsonl", lines))
    assert result.status in ("tampered", "foreign", "unchecked"), result.message


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all numbers and texts."""
    if isinstance(value, (dict, list)):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from leaves(value[key], (*path, key))
    elif value is not None:
        yield path


def another(value: Any) -> Any:
    """The next number, or another hash."""
    if isinstance(value, float):
        return float(np.nextafter(value, np.inf))
    return "f" * 16 if isinstance(value, str) else value + 1


KINDS = {("rewards", "rxn_0"), ("scores", "rxn_0"), ("play", "rxn_0", ""), ("reading", "values", ""), ("tick",)}
KINDS |= {("hidden", *more) for more in (("vessels", "", ""), ("vessels", "", "", ""), ("stock", ""), ("state",))}
KINDS |= {("end", "score"), ("end", "rewards", "ext_0"), ("end", "orders", "", "submitted_mol")}
"""Some of those in a record of a laboratory."""


@pytest.mark.parametrize("name", ["wurtz_dodecane", *CHANGED_SCENARIOS])
def test_no_kind_of_number_may_be_another(name: str, openings: dict[str, Lines], tmp_path: Path) -> None:
    """One of each kind in every line but the header, by the least step; actions apart, which may lead to the same."""
    lines, tried = openings[name], set()
    for number in range(1, len(lines)):
        for path in leaves(lines[number]):
            kind = tuple("" if str(key).isdigit() else key for key in path)
            if kind in tried or (path[0] == "play" and path[2] == 1):
                continue
            tried.add(kind)
            changed = json.loads(json.dumps(lines[: number + 1]))
            put(number, *path, to=another)(changed)
            result = verify_record(store(tmp_path / "a.jsonl", changed))
            where = "end" if "end" in lines[number] else f"turn {number - 1}"
            said = (result.status, result.where, result.key)
            assert said == ("tampered", where, ".".join(map(str, path))), result.message
            assert result.turn == (None if where == "end" else result.turns)
            assert result.recorded != result.recomputed
    assert len(tried) >= 5
    assert tried >= KINDS or name != "wurtz_dodecane"


def test_what_no_record_can_prove_is_said(honest: Path, tmp_path: Path) -> None:
    """Names of policies change no number: the verdict calls them a claim."""
    lines = load(honest)
    lines[0]["policies"] = {"manager_0": "genius\x1b[31m"}
    result = verify_record(store(tmp_path / "a.jsonl", lines))
    said = ["claims that genius\\x1b[31m played, which cannot be proved"]
    assert (result.status, result.notes) == ("ok", said)
    record_episode(tmp_path / "b.jsonl", "wurtz_any", options={"goal": "NaCl"})
    assert any("NaCl" in note for note in verify_record(tmp_path / "b.jsonl").notes)


def test_a_right_record_on_an_easier_scenario_is_not_ok(tmp_path: Path) -> None:
    """It is right in itself; a script that looks at the exit code must not take it for a result of the shipped one."""
    shipped = load_scenario("wurtz_dodecane")
    data = dump_scenario(shipped)
    data["scenario"]["theoretical_maximum_mol"] = {"dodecane": shipped.theoretical_maximum_mol["dodecane"] / 2}
    easier = restore_scenario(data, "test")
    path = record_episode(tmp_path / "a.jsonl", easier)
    result = verify_record(path)
    assert (result.status, result.score > 1.0, "not " in result.message) == ("foreign", True, True)
    assert verify_record(path, scenario=easier).status == "ok"
    # Torn, and in the company of others: still not.
    lines = load(path)
    assert verify_record(store(tmp_path / "b.jsonl", lines[:-1])).status == "foreign"
    lines[-1]["end"]["score"] = 0.9
    assert verify_record(store(tmp_path / "b.jsonl", lines)).status == "tampered"


def test_other_versions_are_told_apart(honest: Path, tmp_path: Path) -> None:
    lines, path = load(honest), tmp_path / "a.jsonl"
    lines[0]["chemlab"] = "9.9"
    result = verify_record(store(path, lines))
    assert (result.status, "9.9" in result.message) == ("other", True)
    state(lines)  # which another version may keep otherwise
    assert f"all {len(lines) - 2} turns and the score" in verify_record(store(path, lines)).message
    reward(lines)
    assert "rewards.rxn_0: recorded" in verify_record(store(path, lines)).message
    lines[0]["format"]["version"] = 1
    result = verify_record(store(path, lines))
    assert result.status == "other"
    assert "has format 1, made by chemlab 9.9; this version reads format 5" in result.message
    assert "record the episode again" in result.message


def test_another_platform_may_round_otherwise(honest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Last digits and hashes may differ there, and are said to; a number that differs by more is tampering."""

    def verdict(*changes: Tamper) -> Any:
        lines = load(honest)
        for change in (put(0, "environment", "machine", to="abacus"), *changes):
            change(lines)
        return verify_record(store(tmp_path / "a.jsonl", lines))

    result = verdict(reward, state)
    assert (result.status, "abacus" in result.notes[0], "1 hashes" in result.message) == ("other", True, True)
    assert "1 numbers differ, by 1e-15 at most (turn " in result.message
    more = put(0, "scenario", "scenario", "stock", "water", to=lambda mol: mol * (1 + 1e-9))
    assert verdict(reward, state, more).status != "ok"
    assert verdict(put(4, "play", "rxn_0", 0, to="seen by me")).status == "tampered"  # no hash at all
    assert verdict(score).key == "end.score"
    # The same platform in another episode: nothing differs, and the difference is but a note.
    monkeypatch.setattr(verify_module, "environment_here", lambda: {"machine": "abacus"})
    result = verify_record(honest)
    assert (result.status, bool(result.notes)) == ("ok", True)


def test_a_header_that_makes_no_sense(honest: Path, tmp_path: Path) -> None:
    nonsense = [("seed", -1), ("seed", "x"), ("options", 3), ("options", {"goal": "gold"})]
    for key, value in (*nonsense, ("goals", []), ("streams", {}), ("hidden", None), ("materials", 5)):
        lines = load(honest)
        lines[0][key] = value
        result = verify_record(store(tmp_path / "a.jsonl", lines))
        assert (result.status, result.where) == ("tampered", "header"), key


# -- torn, unfinished, no records -----------------------------------------------------------------------------


def test_a_torn_record_can_be_read_up_to_the_tear(honest: Path, tmp_path: Path) -> None:
    content, path = honest.read_bytes(), tmp_path / "a.jsonl"
    ends = [i + 1 for i, byte in enumerate(content) if byte == ord("\n")]
    # In the middle of lines, at their ends, just before those.
    for length in (*range(ends[0], len(content), 1777), *ends[:-1:7], ends[-1] - 2, ends[-2] + 1):
        path.write_bytes(content[:length])
        whole = sum(end <= length for end in ends)
        record = read_record(path)
        assert (record.torn, record.broken, len(record.turns)) == (True, None, whole - 1)
    for length in (ends[0], ends[30], ends[30] + 5, ends[-2], ends[-1] - 2):
        path.write_bytes(content[:length])
        result = verify_record(path)
        assert (result.status, result.turns) == ("torn", sum(end <= length for end in ends) - 1)
    # A tear does not hide tampering.
    lines = load(honest)[:40]
    reward(lines)
    assert verify_record(store(path, lines)).status == "tampered"


def test_line_ends_of_another_system(honest: Path, tmp_path: Path) -> None:
    """Version control and editors change them; what the lines say is as it was, and nothing else is let through."""
    content, path = honest.read_bytes(), tmp_path / "a.jsonl"
    windows = content.replace(b"\n", b"\r\n")
    cases = {"CR LF": windows, "no newline": content[:-1], "both": windows[:-2], "half": windows[:-1]}
    for name, changed in cases.items():
        path.write_bytes(changed)
        result = verify_record(path)
        assert (result.status, result.score) == ("ok", verify_record(honest).score), (name, result.message)
        noted = " ".join(result.notes)
        assert ("CR LF" in noted) == (name != "no newline")
        assert ("no newline" in noted) == (name != "CR LF")
    first = content.index(b"\n")
    later = content.index(b"\n", first + 1)
    for changed in (
        content[:first] + b"\r" + content[first:],  # of one line alone
        content[:later] + b"\r" + content[later:],
        content.replace(b"\n", b"\r\r\n"),
        windows + b"\r\n",
        windows[:-2] + b" ",
    ):
        path.write_bytes(changed)
        assert verify_record(path).status == "tampered"
    # A tear, a tear in the last line, and tampering are what they were.
    for length in (windows.index(b"\n", windows.index(b"\n") + 1) + 9, len(windows) - 3):
        path.write_bytes(windows[:length])
        assert verify_record(path).status == "torn"
    path.write_bytes(windows.replace(b'"turns":', b'"turns":1', 1))
    assert verify_record(path).status == "tampered"


def test_a_file_has_one_writer(tmp_path: Path) -> None:
    """Whoever comes second hears of it before anything is played, and spoils nothing."""
    path = tmp_path / "a.jsonl"
    env, other = raw_env("wurtz_dodecane"), raw_env("wurtz_dodecane")
    labs = env.laboratories
    left = tmp_path / "a.jsonl.part"
    left.write_text("of a process that was killed")
    second = Recorder(path, other.laboratories, force=True)

    def watch(turn: Any) -> None:
        if turn.tick == 5:
            other.reset(seed=1)
            refused(r"a\.jsonl\.part: another process is recording there", second.begin, 1)

    with Recorder(path, labs, force=True) as recorder:
        play_episode(env, make_policies("scripted", labs, 3), 3, watch=watch, recorder=recorder)
    assert verify_record(path).status == "ok"
    assert not left.exists()
    # It may be had now, and the record stays until there is another whole one.
    other.reset(seed=1)
    second.begin(1)
    assert verify_record(path).status == "ok"
    second.close()
    # Lines held in memory are kept until they can be written.
    held = Recorder(tmp_path / "b.jsonl", labs, held=True)
    env.reset(seed=1)
    held.begin(1)
    held.part.write_text("of another process")
    refused("created by another process", held.close)
    held.part.unlink()
    held.close()
    assert held.part.read_text().startswith("{")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_what_is_no_file_is_not_replaced(tmp_path: Path) -> None:
    """A pipe, a device, a folder; also where the unfinished record would be. Nobody waits for a reader."""
    labs = raw_env("wurtz_dodecane").laboratories
    for name in ("pipe", "other.part"):
        os.mkfifo(tmp_path / name)
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("/dev/null")
    (tmp_path / "loop").symlink_to("loop")
    for name in ("pipe", "other", "folder", "link", "loop", "."):
        with pytest.raises(ValueError, match=r"(is a folder|not a regular file); give a file's name"):
            Recorder(tmp_path / name if name != "." else Path(), labs, force=True)
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "other.part").is_fifo()
    assert (tmp_path / "link").is_symlink()


def test_a_full_disk_is_told_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
    with pytest.raises(OSError, match=r"a\.jsonl\.part"):
        record_episode(tmp_path / "a.jsonl", "salt_from_oil")
    assert [file.name for file in tmp_path.iterdir()] == ["a.jsonl.part"]


def test_names_of_any_bytes(tmp_path: Path) -> None:
    """A name from a command line may have bytes that are no characters there: the record has the text that it is."""
    labs = raw_env("salt_from_oil").laboratories
    names = dict.fromkeys(labs.agents, os.fsencode("säure").decode("ascii", "surrogateescape"))
    labs.begin(1)
    with Recorder(tmp_path / "a.jsonl", labs, policies=names) as recorder:
        recorder.begin(1)
    assert set(read_record(recorder.part).header["policies"].values()) == {"säure"}


# -- worlds ---------------------------------------------------------------------------------------------------


def in_a_world(path: Path, world: Any, seed: int = 3, split: str = "train", name: str = "unlabelled") -> Lines:
    """The lines of a scripted episode in a world that was asked for, or in its seed's."""
    options = None if world is None else {"world": world}
    return load(record_episode(path, name, seed=seed, options=options, split=split))


def test_a_world_that_was_asked_for_is_a_verdict_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    drawn = in_a_world(path, None)[0]["hidden"]["world"]["values"]
    assert verify_record(path).status == "ok"
    for world in (5, drawn, {name: drawn[name] for name in list(drawn)[:1]}):
        lines = in_a_world(path, world)
        result = verify_record(path)
        assert (result.status, "was requested" in result.message) == ("chosen", True), result.message
        assert result.score is not None
        # Also without a seed, on another platform, torn, and never to be had as ok by taking the options out.
        lines[0]["seed"] = None
        assert verify_record(store(path, lines)).status == "chosen"
        assert verify_record(store(path, lines[:-1])).status == "chosen"
        lines[0]["environment"]["machine"] = "abacus"
        assert verify_record(store(path, lines)).status == "chosen"
        lines[0]["chemlab"] = "9.9"
        assert verify_record(store(path, lines)).status == "other"
        lines[-1]["end"]["score"] += 1.0
        lines[0]["chemlab"] = chemlab.__version__
        assert verify_record(store(path, lines)).status == "tampered"


@pytest.mark.parametrize("split", ["train", "private:" + "5" * 32])
def test_a_world_is_its_numbers(split: str, tmp_path: Path) -> None:
    """Without a seed, or without the salt of a split, a world's values follow from its number all the same."""
    path, seed = tmp_path / "a.jsonl", None if split == "train" else 3
    other = in_a_world(path, None, 4, split)[0]["hidden"]["world"]
    lines = in_a_world(path, None, 3, split)
    assert lines[0]["split"] == split.partition(":")[0]
    assert "5" * 32 not in path.read_text(), "the salt of a private split"
    assert verify_record(path, split=split).status == "ok"
    other_split = verify_record(path, split="test")
    assert (other_split.status, "not test" in other_split.message) == ("foreign", True)
    refused("must be train", verify_record, path, split="none")
    forged = json.loads(json.dumps(lines))
    forged[0]["split"] = "validation"
    assert verify_record(store(path, forged)).status == "tampered"
    lines[0]["seed"] = seed
    result = verify_record(store(path, lines))
    assert result.status == "ok"
    assert any("may have chosen" in note for note in result.notes)
    # The values of another world, played honestly, under its own number and under that of this one.
    honest = in_a_world(path, other["values"], 3, split)
    for number, status in ((other["number"], "ok"), (lines[0]["hidden"]["world"]["number"], "tampered")):
        forged = json.loads(json.dumps(honest))
        forged[0].update(seed=seed, options={})
        forged[0]["hidden"]["world"]["number"] = number
        result = verify_record(store(path, forged))
        assert result.status == status, result.message
        assert result.key.startswith("hidden.world.values") == (status == "tampered")
    # A number of another split, and none at all.
    for number in (lines[0]["hidden"]["world"]["number"] ^ 1, -1, 2**64, 1.5, "1", None, True):
        forged = json.loads(json.dumps(lines))
        forged[0]["hidden"]["world"]["number"] = number
        result = verify_record(store(path, forged))
        assert (result.status, result.where) == ("tampered", "header"), (number, result.message)


def test_an_episode_that_is_broken_off_leaves_its_part(tmp_path: Path) -> None:
    env = raw_env("wurtz_dodecane")
    path = tmp_path / "deep" / "a.jsonl"

    def stop(turn: Any) -> None:
        if turn.tick == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), Recorder(path, env.laboratories) as recorder:
        play_episode(env, make_policies("scripted", env.laboratories, 0), 0, watch=stop, recorder=recorder)
    assert [file.name for file in path.parent.iterdir()] == ["a.jsonl.part"]
    result = verify_record(recorder.part)
    assert result.status == "torn"
    assert result.turns == len(read_record(recorder.part).turns) > 5
    with pytest.raises(RecordError, match=r"not finished: read .*a\.jsonl\.part"):
        read_record(path)
    # Neither does anything write over it unasked.
    refused("already exists", Recorder, path, env.laboratories)
    with Recorder(path, env.laboratories, force=True) as recorder:
        play_episode(env, make_policies("scripted", env.laboratories, 0), 0, recorder=recorder)
    assert [file.name for file in path.parent.iterdir()] == ["a.jsonl"]


def test_a_file_that_appears_while_recording_is_kept(tmp_path: Path) -> None:
    env = raw_env("salt_from_oil")
    path = tmp_path / "a.jsonl"
    recorder = Recorder(path, env.laboratories)
    path.write_text("mine")
    refused("another process", play_episode, env, make_policies("scripted", env.laboratories, 0), 0, recorder=recorder)
    assert path.read_text() == "mine"
    assert verify_record(recorder.part).status == "ok"


def test_what_is_no_record(tmp_path: Path) -> None:
    """Nor does a pipe that nobody writes to keep one waiting."""
    path, pipe = tmp_path / "a", tmp_path / "pipe"
    for content in (b"", b"\n", b"{}\n", b"\x00\x01", b'{"format":3}\n', b'{"format":{}}\n', b"[" * 9999):
        path.write_bytes(content)
        assert verify_record(path).status == "unchecked"
    if hasattr(os, "mkfifo"):
        os.mkfifo(pipe)
        for path in (pipe, tmp_path, Path("/dev/zero"), tmp_path / ("a" * 300), Path("a\0b"), Path("")):
            assert verify_record(path).status == "unchecked", path


@pytest.mark.parametrize(("name", "laboratories"), [("failing", 1), ("failing", 3), ("wurtz_dodecane", 3)])
def test_the_state_of_a_record_is_all_of_the_laboratory_s(name: str, laboratories: int) -> None:
    """Each array's last number, changed as time goes on, is another state; those of other laboratories are not."""
    labs = Laboratories(name, laboratories)
    labs.reset(labs.members)
    lines, tried = recorder_module.EpisodeLines(labs, 0), set()
    for agent, table in zip(labs.agents, (labs.table, *(one.table for one in labs.experiments)), strict=True):
        for field, array in zip(table._fields, table._own, strict=True):
            if "N" not in field.axes or not field.field.kept or field.name == "reading" or not array.size:
                continue
            own = array.swapaxes(0, field.axes.index("N"))
            before = lines._state()
            for member in range(laboratories):
                place = (member, *(-1,) * (own.ndim - 1))
                kept = own[place].copy()
                own[place] = not kept if own.dtype == bool else np.nan_to_num(kept) + 1
                assert (lines._state() != before) == (member == 0), field.name
                own[place] = kept
            assert lines._state() == before
            tried.add(f"{agent} {field.name}")
    some = {"rxn_0 jacket", "rxn_0 supply", "rxn_0 baseline", "ext_0 image", "ext_0 profile", "ext_0 events"}
    assert tried >= (some if name == "wurtz_dodecane" else {"east_0 gain", "manager_0 drift_stream"})
    assert len(tried) > 50


# -- more than a record may be ---------------------------------------------------------------------------------


def test_what_is_too_large(honest: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the limit a record is read, one beyond it is refused; a scenario's parts are counted, too."""
    content, spec = honest.read_bytes(), load_scenario("wurtz_dodecane")
    for key, size, message in (
        ("file_bytes", len(content), "larger than"),
        ("turns", len(read_record(honest).turns), "more than .* turns"),
        ("values", sum(map(content.count, b",:[{")), "more than .* values"),
        ("materials", len(spec.materials), ""),
        ("reactions", len(spec.family.reaction) + len(spec.family.salt) + len(spec.family.violent), ""),
        ("goals", len(spec.goals), ""),
        ("agents", len(spec.bench_agents()), ""),
        ("instruments", len(spec.instruments), ""),
    ):
        monkeypatch.setattr(format_module, "LIMITS", LIMITS._replace(**{key: size}))
        assert verify_record(honest).status == "ok"
        monkeypatch.setattr(format_module, "LIMITS", LIMITS._replace(**{key: size - 1}))
        result = verify_record(honest)
        assert result.status == "unchecked"
        assert re.search(message or f"has {size} {key}; must be at most {size - 1}", result.message)


def test_a_line_that_is_too_much(honest: Path, tmp_path: Path) -> None:
    lines = honest.read_bytes().split(b"\n")
    large = [b"1e400", b"1E+400", b"0.1e0400", b"1e309", b"9" * 400 + b".0", b"9" * 38 + b"e300", b"Infinity"]
    for rubbish, problem in (
        (b'{"turn":"' + b"a" * LIMITS.line_bytes + b'"}', "longer than"),
        (b'{"turn":' + b"[" * 20 + b"]" * 20 + b"}", "nested lists and objects"),
        (b'{"turn":' + b"[" * 5000 + b"]" * 5000 + b"}", "not JSON"),
        (b'{"turn":' + b"9" * 4000 + b"}", "has an integer"),
        *((b'{"turn":[-%s]}' % number, "not finite") for number in large),
        (b'{"turn": [ 1, 1e999 ]}', "not finite"),
        (b'{"turn": [ 1, 1e999]}', "not finite"),
        (b'{"turn":-%d}' % 2**128, "has an integer"),
        (b'{"turn": ' + b"[" * 17 + b'"]]]]]]]]]]]]]]]]]"' + b"]" * 17 + b"}", "nested lists and objects"),
        (b'{"turn":1,"turn":1}', "the key 'turn' twice"),
        # At the end of as many others as a line may have: each compared with each would take minutes.
        (b"{" + b"".join(b'"%x":1,' % i for i in range(95_000)) + b'"turn":1,"turn":1}', "the key 'turn' twice"),
        (b'{"turn":"\\ud800"}', "not a character"),
    ):
        path = tmp_path / "a.jsonl"
        path.write_bytes(b"\n".join([*lines[:20], rubbish, *lines[21:]]))
        record = read_record(path)
        assert (record.broken[0], problem in record.broken[1], len(record.turns)) == (21, True, 19)
        result = verify_record(path)
        assert (result.status, result.turns) == ("tampered", 19)
        assert f"line 21 {record.broken[1]}" in result.message
        path.write_bytes(rubbish + b"\n")
        assert verify_record(path).status == "unchecked"


@pytest.mark.slow
def test_reading_takes_little_memory(honest: Path, tmp_path: Path) -> None:
    """As many short texts as a record may have, each an object of its own: they take half a gigabyte, no more."""
    head, line = honest.read_bytes().split(b"\n")[0], b'{"a":[' + b'"ab",' * 200_000 + b"1]}"
    path = tmp_path / "a.jsonl"
    path.write_bytes(b"\n".join([head, *[line] * 24, b""]))
    assert LIMITS.values - 200_000 < sum(map(path.read_bytes().count, b",:[{")) < LIMITS.values
    measure = (
        "import resource, sys; from chemlab.record import read_record\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "assert len(read_record(sys.argv[1]).turns) == 24\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    found = subprocess.run([sys.executable, "-c", measure, path], capture_output=True, text=True, check=True)
    kilobytes = int(found.stdout) / (1024 if sys.platform == "darwin" else 1)
    assert kilobytes < 500_000


# -- things of one's own --------------------------------------------------------------------------------------


def test_a_bench_of_ones_own_is_imported_only_on_trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A record names modules; what Python imports is the user's decision."""
    file, entry = tmp_path / "filtered.toml", 'kind = "filtration_bench:FiltrationBench"\nstep_limit = 5\n'
    file.write_text(f'base = "salt_from_oil"\nname = "filtered"\n[benches.fil]\n{entry}')
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parent / "bench"))
        path = record_episode(tmp_path / "a.jsonl", file, "random")
        result = verify_record(path)
        assert (result.status, "filtration_bench" in result.message) == ("unchecked", True)
        assert verify_record(path, trust=True).status == "foreign"
        assert verify_record(path, trust=True, scenario=file).status == "ok"
    lines = load(path)
    lines[0]["scenario"]["scenario"]["benches"]["fil"]["kind"] = "no_such_module:Bench"
    result = verify_record(store(tmp_path / "b.jsonl", lines), trust=True)
    assert (result.status, "no_such_module" in result.message) == ("unchecked", True)


@pytest.mark.parametrize("key", ["bench", "process", "observe", "reward", "model", "instrument", "manager"])
def test_no_part_of_a_record_is_imported_without_trust(key: str, honest: Path, tmp_path: Path) -> None:
    """Whatever of a scenario may be named in a file: one beside the record is not run."""
    lines = load(honest)
    spec, name = lines[0]["scenario"]["scenario"], "evil.py:Evil"
    if key == "bench":
        spec["benches"]["ext"]["kind"] = name
    elif key == "process":
        spec["benches"]["ext"]["process"][0]["kind"] = name
    elif key == "instrument":
        next(iter(spec["instruments"].values()))["kind"] = name
    elif key == "manager":
        spec["manager"] = {"reward": [name]}
    else:
        spec["benches"]["rxn"][key] = name if key == "model" else [name]
    (tmp_path / "evil.py").write_text("from pathlib import Path\nPath(__file__).with_name('ran').touch()\nEvil = 1\n")
    path = store(tmp_path / "a.jsonl", lines)
    result = verify_record(path)
    assert (result.status, "evil.py:Evil" in result.message) == ("unchecked", True)
    assert not (tmp_path / "ran").exists()
    with contextlib.suppress(Exception):  # it is no part of that kind
        verify_record(path, trust=True)
    assert (tmp_path / "ran").exists(), "the test would find out"


def test_parts_in_files_are_found_beside_the_required_scenario(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    parts = "import numpy as np\n\ndef free(labs, members):\n    return np.zeros(len(members))\n"
    (tmp_path / "my_parts.py").write_text(parts)
    file = tmp_path / "own.toml"
    file.write_text('base = "salt_from_oil"\nname = "own"\n[manager]\nreward = ["my_parts.py:free"]\n')
    path = record_episode(tmp_path / "there" / "a.jsonl", file, "random")
    assert verify_record(path, trust=True).status == "unchecked"
    assert verify_record(path, file).status == "unchecked"
    assert verify_record(path, file, trust=True).status == "ok"


def nothing(amount_mol: Any, temperature_k: float, volume_l: float, dt: float) -> Any:
    """A reaction model in which nothing happens."""
    return amount_mol


def test_records_name_the_physics_models_of_their_scenario(tmp_path: Path) -> None:
    env = raw_env({"base": "wurtz_dodecane", "name": "idle", "benches": {"rxn": {"model": f"{__name__}:nothing"}}})
    path = tmp_path / "a.jsonl"
    play_episode(env, make_policies("scripted", env.laboratories, 0), 0, recorder=Recorder(path, env.laboratories))
    assert f"benches.rxn.model: needs the untrusted code '{__name__}:nothing'" in verify_record(path).message
    assert verify_record(path, env.scenario, trust=True).status == "ok"
    lines = load(path)
    del lines[0]["scenario"]["scenario"]["benches"]["rxn"]["model"]
    assert verify_record(store(tmp_path / "b.jsonl", lines)).status == "tampered"


# -- the command ----------------------------------------------------------------------------------------------


def test_the_commands(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    run = ["run", "salt_from_oil", "--record", path, "--json"]
    command(*run)
    assert "already exists" in command(*run, code=2)
    command(*run, "--force")
    command(*run, "--episodes", 2, "--seed", 7)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a-7.jsonl", "a-8.jsonl", "a.jsonl"]
    assert read_record(tmp_path / "a-8.jsonl").header["seed"] == 8
    assert read_record(path).header["policies"] == {"manager_0": "scripted", "ext_0": "scripted", "dit_0": "scripted"}
    assert command("verify", *tmp_path.iterdir()).count("ok ") == 3


def test_exit_codes_of_verify(honest: Path, tmp_path: Path) -> None:
    """The worst record decides."""
    lines, missing = load(honest), tmp_path / "missing.json"
    torn = store(tmp_path / "torn.json", lines[:-1])
    put(0, "chemlab", to="9.9")(lines)
    other = store(tmp_path / "other", lines)
    put(0, "chemlab", to=chemlab.__version__)(lines)
    score(lines)
    tampered = store(tmp_path / "tampered", lines)
    for files, code in (
        ([honest], 0),
        ([honest, torn], 3),
        ([torn, other], 4),
        ([other, missing], 5),
        ([tampered, missing, other, torn, honest], 1),
    ):
        result = runner.invoke(app, ["verify", "--json", *map(str, files)])
        assert result.exit_code == code
        found = [json.loads(line) for line in result.stdout.splitlines()]
        assert [item["path"] for item in found] == [str(file) for file in files]
    assert "end.score: recorded 0.99, recomputed" in command("verify", tampered, code=1)


def test_too_stiff_reactions_are_words_in_verdict_and_command(honest: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stiff = "rxn_0: the reactions of laboratory 0 are too stiff"
    monkeypatch.setattr(Laboratories, "act", Mock(side_effect=ArithmeticError(stiff)))
    result = verify_record(honest)
    assert (result.status, "too stiff" in result.message) == ("tampered", True)
    assert f"error: {stiff}" in command("run", "fictitious", "--episodes", 1, code=2)
    monkeypatch.setattr(Laboratories, "act", Mock(side_effect=ZeroDivisionError("of ours")))
    assert isinstance(runner.invoke(app, ["run", "fictitious"]).exception, ZeroDivisionError)
