"""Seats for language agents: typed verbs, refused calls, repeated calls, several seats in one room, secrecy."""

import functools
import inspect
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import typing
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from helpers import digest, refused

import chemlab
from chemlab.agents.ledger import append_entry, ended_episodes, read_ledger
from chemlab.agents.seats import LabTools, Room, call_of, input_schema
from chemlab.agents.verbs import ToolError, bench_verbs
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from chemlab.lab.text import folded_lines
from chemlab.record import verify_record
from studies.tools.seats import call_for, measure, play_scripted

SALT = "0123456789abcdef0123456789abcdef"
TWO, RELAY, RUNAWAY = ("manager_0", "dit_0"), ("manager_0", "fin_0"), ("manager_0", "rxn_0")


def snapshot(room: Room) -> str:
    """Digest of all that changes in its laboratory."""
    labs: Any = room.laboratories
    return digest(labs.snapshot())


@pytest.fixture
def room() -> Room:
    return Room("unlabelled", TWO, salt=SALT, seed=3)


def test_arguments_are_taken_as_text_or_number(room: Room) -> None:
    reply = room.call("manager_0", "start", {"bench": "dit_0", "slot": "1", "goal": "dodecane"})
    assert not reply.error
    assert "slot 1: vessel at dit_0" in reply.text
    assert "dit_0 has the turn" in room.call("manager_0", "wait").text
    assert not room.call("dit_0", "heat", {"amount": 0.5}).error
    assert not room.call("dit_0", "heat", {"amount": "10"}).error


@pytest.mark.parametrize(("scenario", "hides"), [("fictitious", False), ("unlabelled", True)])
def test_scores_of_experiments_are_no_readings_of_what_is_hidden(scenario: str, hides: bool) -> None:
    """A bench's score is the exact amount of product, and an agent may have the manager's seat, too."""
    texts: list[str] = []
    room = Room(scenario, Laboratories(scenario).agents, salt=SALT, seed=3)
    play_scripted(room, seen=lambda *told: texts.append(told[1]))
    told = [text for text in texts if "Experiment over" in text]
    assert told
    assert all(("Experiment over." in text) == hides for text in told)


def test_looking_is_free_and_complete(room: Room) -> None:
    before = snapshot(room)
    for seat in TWO:
        assert not room.call(seat, "look").error
    assert "slots 0-7" in room.call("manager_0", "look").text
    assert snapshot(room) == before


def test_details_are_shown_once_and_by_parts(room: Room) -> None:
    """Spectra and terms of orders: whole where they are new or asked for, else only named."""
    measured = room.call("manager_0", "measure", {"slot": 0, "instrument": "uv_vis"}).text
    curve = measured[measured.index("nm:%") :].splitlines()[0]
    assert "uv_vis at tick 0 (look at one slot to read it): 0" in room.call("manager_0", "look").text
    assert f"slot 0 {curve}" in room.call("manager_0", "look", {"at": 0}).text
    assert curve in room.display("manager_0")
    relay = Room("relay", RELAY, salt=SALT, seed=3)
    assert " -> (1) " in relay.brief("manager_0"), "numbers of reactions are no coefficients"
    while "due at tick" not in (first := relay.call("manager_0", "wait").text):
        assert not relay.over
    assert "orders (goal, due at tick, price, amount at least (mol)): " in first
    assert ": open (look at orders to read them)" in relay.call("manager_0", "look").text
    assert first.splitlines()[-1] in relay.call("manager_0", "look", {"at": "orders"}).text


def test_seats_and_playing_need_only_the_core() -> None:
    """Every module of a distribution that is no dependency of the core is hidden, as if it were not installed."""
    core = r"""
import importlib.metadata as meta, pathlib, re, sys
text = pathlib.Path(sys.argv[1]).read_text().split("\ndependencies = [")[1].split("\n]")[0]
named = [re.match(r"[\w.-]+", line)[0] for line in re.findall(r'"(.*?)"', text)]
assert len(named) == 12, "the core has grown: " + str(named)
queue, known = list(named), set()
while queue:
    name = re.sub("[-_.]+", "-", queue.pop()).lower()
    if name in known:
        continue
    known.add(name)
    try:
        wanted = meta.requires(name) or []
    except meta.PackageNotFoundError:  # for another platform or Python
        continue
    queue += [re.match(r"[\w.-]+", one)[0] for one in wanted if "extra ==" not in one]
owners = {m: {re.sub("[-_.]+", "-", d).lower() for d in ds} for m, ds in meta.packages_distributions().items()}
hidden = {m for m, ds in owners.items() if not ds & (known | {"chemlab-marl"})}
assert "pytest" in hidden
class Hide:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hide())
import chemlab.agents.seats
from chemlab.cli import main
sys.argv = ["chemlab", "play", "fictitious"]
main()
"""
    command = [sys.executable, "-c", core, str(Path(__file__).parents[2] / "pyproject.toml")]
    done = subprocess.run(command, input="q\n", capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "tick 0, " in done.stdout


def test_what_cannot_be_done_now_is_refused_with_what_is_possible(room: Room) -> None:
    before = snapshot(room)
    assert "manager_0 has it; nothing was done" in room.call("dit_0", "heat", {"amount": 1}).text
    assert "manager_0 has the turn" in room.call("dit_0", "wait").text
    text = room.call("manager_0", "start", {"bench": "rxn_0", "slot": 9, "goal": "dodecane"}).text
    assert "possible: bench rxn_0, dit_0; slot 0, 1, 2, 3, 4, 5, 6, 7;" in text
    assert "possible verbs: start" in room.call("manager_0", "recall", {"bench": "rxn_0"}).text
    assert snapshot(room) == before
    room.call("manager_0", "start", {"bench": "dit_0", "slot": 0, "goal": "dodecane"})
    room.call("manager_0", "wait")
    empty = room.call("dit_0", "pour", {"vessel": "B1", "target": "B2", "amount": 1}).text
    assert "possible: vessel DV; target B1; amount 0.1, " in empty
    one = Room("runaway").call("manager_0", "start", {"slot": 3}).text
    assert one == "Error: start: not possible with these arguments now; possible: slot 0, 1, 2"


def test_a_repeated_call_acts_once(room: Room) -> None:
    given = {"slot": 0, "instrument": "uv_vis", "turn": 1}
    first = room.call("manager_0", "measure", given)
    before = snapshot(room)
    assert room.call("manager_0", "measure", dict(given)) == first
    assert room.call("manager_0", "measure", {**given, "turn": "1"}) == first
    for other in ({**given, "slot": 1}, {**given, "turn": 0}, {**given, "turn": 7}, {**given, "turn": "x"}):
        assert room.call("manager_0", "measure", other).error
    assert snapshot(room) == before
    assert not room.call("manager_0", "measure", {**given, "turn": 2}).error


JUNK: tuple[Any, ...] = (
    None, True, False, -1, 10**400, 1.5, float("nan"), float("inf"), "", " ", "rxn_9", "\x1b[2J", "x" * 5000, [], [0],
    {}, {"a": 1}, b"\xff", object(), "0; drop", "None", "-0.0001", 1e308, ("start",),
)  # fmt: skip


NO_NUMBER = (None, True, float("nan"), float("inf"), 10**400, 1e308, -1e308, "", "x" * 5000, "one", [], {}, b"1")


def wrong_call(room: Room, rng: random.Random) -> tuple[Any, Any, Any]:
    """A call that is wrong in one respect."""
    agent = rng.choice(room.seats)
    way = rng.randrange(5)
    if way == 0:
        return agent, rng.choice([*JUNK, "reset", "get_reward", "__init__", "begin"]), {}
    if way == 1:
        return rng.choice(JUNK), "look", {}
    verb = rng.choice([verb for verb in room.verbs(agent) if verb.arguments or way == 2])
    given: Any = {one.name: one.options[0] if one.options else one.high for one in verb.arguments}
    if way == 2:
        return agent, verb.name, {**given, rng.choice(["Slot", "x" * 300, "self", "\n"]): 1}
    if way == 3:
        return agent, verb.name, rng.choice([[1, 2], "text", 5, {3: 4}, {str(i): 0 for i in range(1000)}])
    wrong = rng.choice(verb.arguments)
    del given[wrong.name]
    if wrong.default is not None or rng.random() < 0.7:
        junk = [value for value in JUNK if not (value == -1 and verb.name == "heat")]
        given[wrong.name] = rng.choice(junk if wrong.options else NO_NUMBER)
    return agent, verb.name, given


@pytest.mark.parametrize(("scenario", "seats", "count"), [("unlabelled", TWO, 8000), ("relay", RELAY, 2000)])
def test_ten_thousand_wrong_calls_change_nothing(scenario: str, seats: tuple[str, ...], count: int) -> None:
    room = Room(scenario, seats, salt=SALT, seed=3)
    rng, before, made = random.Random(0), snapshot(room), 0
    for i in range(count):
        agent, verb, given = wrong_call(room, rng)
        reply = room.call(agent, verb, given)
        assert reply.error, (agent, verb, given, reply.text)
        assert len(reply.text) < 600
        assert reply.text.isprintable()
        assert "Traceback" not in reply.text
        made += agent in room.seats if isinstance(agent, str) else 0
        if i % 1000 == 999:
            assert snapshot(room) == before
    assert sum(seat["wrong"] for seat in room.report()["seats"].values()) == made
    assert not room.call("manager_0", "discard", {"slot": 0}).error


def test_a_budget_of_calls_truncates() -> None:
    room = Room("unlabelled", calls=3)
    assert [room.call("manager_0", "look").done for _ in range(3)] == [False] * 3
    reply = room.call("manager_0", "look")
    assert (reply.done, "out of calls" in reply.text) == (True, True)
    assert room.report()["status"] == "out of calls"


def test_messages_are_quoted_and_counted() -> None:
    room = Room("unlabelled", TWO, say=20)
    assert "9 characters left" in room.call("dit_0", "say", {"to": "manager_0", "text": "ready\x1b[2J\nx"}).text
    assert room.call("dit_0", "say", {"to": "manager_0", "text": "1234567890"}).error
    reply = room.call("manager_0", "measure", {"slot": 0, "instrument": "uv_vis"})
    assert 'dit_0 says: "ready [2J x"' in reply.text
    assert "given 21 characters" in room.call("dit_0", "say", {"to": "manager_0", "text": "x" * 21}).text
    assert "given 201 characters" in room.call("dit_0", "look", {"reason": "x" * 201}).text
    assert "at most 64" in room.call("dit_0", "look", {str(i): i for i in range(65)}).text
    assert 'must be an object of at most 64 values by name, such as {"slot": 0}' in room.call("dit_0", "look", [1]).text
    room.call("dit_0", "say", {"to": "manager_0", "text": "heiß"})
    assert 'says: "heiß"' in room.call("manager_0", "measure", {"slot": 0, "instrument": "uv_vis"}).text
    assert "say" not in [verb.name for verb in Room("unlabelled", TWO).verbs("dit_0")]


@pytest.mark.parametrize(("scenario", "seats"), [("unlabelled", TWO), ("relay", RELAY)])
def test_two_seats_play_to_the_end(scenario: str, seats: tuple[str, ...], tmp_path: Path) -> None:
    """The record is right with the published salt, and two rooms with the same calls have the same record."""
    records = []
    for folder in ("a", "b"):
        room = Room(scenario, seats, folder=tmp_path / folder, salt=SALT, seed=5)
        calls = play_scripted(room)
        assert {agent for agent, *_ in calls} == set(seats)
        assert room.over
        records.append((tmp_path / folder / "episode-0000.jsonl").read_bytes())
    assert records[0] == records[1]
    lines = (tmp_path / "a" / "episode-0000.transcript.jsonl").read_text().splitlines()
    assert "canary" in lines[0]
    assert len(lines) == 1 + len(calls)
    assert "The episode is over" in lines[-1]
    found = verify_record(tmp_path / "a" / "episode-0000.jsonl", split=room.published()["split"])
    assert (found.status, found.score) == ("ok", room.score)


def test_nothing_on_the_disk_tells_the_world_while_an_episode_runs(tmp_path: Path) -> None:
    room = Room("unlabelled", folder=tmp_path)
    room.call("manager_0", "start", {"bench": "rxn_0", "slot": 0, "goal": "dodecane"})
    room.call("manager_0", "wait")
    refused("not over", room.published)
    labs: Any = room.laboratories
    secrets = [room._salt, str(room._seed), str(labs.worlds.number(0))]
    secrets += [f"{value:.6f}"[:8] for value in labs.worlds.values(0)["titre"].values()]
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path.name for path in files] == ["ledger.jsonl"]
    assert not any(secret in path.read_text() for path in files for secret in secrets)
    room.close()
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"ledger.jsonl", "episode-0000.jsonl.part", "episode-0000.transcript.jsonl"}
    assert room._salt in (tmp_path / "ledger.jsonl").read_text()


def test_a_full_disk_leaves_a_ledger_intact(tmp_path: Path) -> None:
    """Of a line that does not fit, nothing stays."""
    ledger = tmp_path / "ledger.jsonl"
    append_entry(ledger, {"event": "begun"})
    before, limits = ledger.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 10, limits[1]))
    try:
        with pytest.raises(OSError, match="ledger"):
            append_entry(ledger, {"event": "ended"})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert ledger.read_bytes() == before


def test_an_episode_that_could_not_be_written_is_written_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room, full = Room("unlabelled", folder=tmp_path), Mock(side_effect=OSError(28, "No space left on device"))
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        for end in (room.close, room.begin):
            with pytest.raises(OSError, match="No space left"):
                end()
            assert room.over
    room.begin()
    assert not room.over
    room.close()
    assert [entry["event"] for entry in read_ledger(tmp_path / "ledger.jsonl")] == ["begun", "ended"] * 2
    assert len(ended_episodes(tmp_path)) == 2
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            room.begin()
    assert room.over
    assert len(read_ledger(tmp_path / "ledger.jsonl")) == 4


def test_a_disk_that_is_full_at_the_end_costs_nothing(tmp_path: Path) -> None:
    room = Room("salt_from_oil", folder=tmp_path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
    try:
        for end in (functools.partial(room.call, "manager_0", "submit", {"slot": 0}), room.close):
            with pytest.raises(OSError, match="too large"):
                end()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    room.close()
    assert [entry["status"] for entry in ended_episodes(tmp_path).values()] == ["submitted"]
    assert verify_record(tmp_path / "episode-0000.jsonl").status == "ok"


def test_a_script_that_fails_keeps_its_episode(tmp_path: Path) -> None:
    code = "from chemlab.agents.seats import Room\nRoom('salt_from_oil', folder='.').call('manager_0', 'look')\n1 / 0"
    assert subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True).returncode == 1
    assert [entry["status"] for entry in ended_episodes(tmp_path).values()] == ["given up"]
    assert len((tmp_path / "episode-0000.transcript.jsonl").read_text().splitlines()) == 2


def test_forged_ledgers_are_refused(tmp_path: Path) -> None:
    ended = {"event": "ended", "begun": 0, "record": "", "seats": {}}
    for k, end in enumerate([ended, ended | {"begun": [0]}, {"event": "ended"}]):
        (tmp_path / str(k)).mkdir()
        for entry in ({"event": "begun"}, end):
            append_entry(tmp_path / str(k) / "ledger.jsonl", entry)
        refused("condition" if end is ended else "has not ended", ended_episodes, tmp_path / str(k))
    (tmp_path / "ledger.jsonl").write_text("[" * 100_000)
    refused("not intact", read_ledger, tmp_path / "ledger.jsonl")
    (tmp_path / "ledger.jsonl").unlink()
    os.mkfifo(tmp_path / "ledger.jsonl")
    with pytest.raises(OSError, match="not a regular file"):
        read_ledger(tmp_path / "ledger.jsonl")


def test_the_ledger_has_every_episode_and_shows_changes(tmp_path: Path) -> None:
    room = Room("unlabelled", folder=tmp_path)
    refused(r"goal: .* given 'gold'", room.begin, "gold")
    assert not room.over, "an unknown goal does not end the episode"
    tools = LabTools(room, "manager_0")
    tools.reset()  # plays the episode that the room has begun
    tools.reset()
    tools.reset(goal="dodecane", prompt="ignored")
    room.close()
    again = Room("unlabelled", folder=tmp_path / "again", salt=SALT, seed=3)
    goal = again.laboratories.scenario.goals[int(again.laboratories.state.goal[0, 0])]
    LabTools(again, "manager_0").reset(goal=goal)  # plays the episode that has begun, because it has this goal
    refused("counts once", again.begin)
    assert not again.over, "a world that is known is not played again, and the episode goes on"
    assert len(read_ledger(tmp_path / "again" / "ledger.jsonl")) == 1
    entries = read_ledger(tmp_path / "ledger.jsonl")
    assert [entry["event"] for entry in entries] == ["begun", "ended"] * 3
    assert len({entry["split"] for entry in entries if entry["event"] == "ended"}) == 3
    two = Room("unlabelled", ("manager_0", "rxn_0"))
    world = two.laboratories
    for seat in two.seats:
        LabTools(two, seat).reset()
    assert two.laboratories is world, "the second seat joins the episode of the first"
    lines = (tmp_path / "ledger.jsonl").read_text().splitlines()
    for changed in ([*lines[:2], *lines[4:]], [lines[0].replace("unlabelled", "crude"), *lines[1:]]):
        (tmp_path / "ledger.jsonl").write_text("\n".join(changed) + "\n")
        refused("not intact", read_ledger, tmp_path / "ledger.jsonl")


def test_opaque_names_hide_materials_everywhere(tmp_path: Path) -> None:
    room = Room("salt_from_oil", ("manager_0", "ext_0", "dit_0"), names="opaque", folder=tmp_path, salt=SALT, seed=1)
    shown = "".join(json.dumps([input_schema(v) for v in room.verbs(seat)]) + room.brief(seat) for seat in room.seats)
    assert len({agent for agent, *_ in play_scripted(room)}) > 1
    shown += (tmp_path / "episode-0000.transcript.jsonl").read_text()
    materials = [name for name in load_scenario("salt_from_oil").materials if name not in ("air", "H", "Na")]
    assert [name for name in materials if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", shown)] == []
    assert re.search(r"\bM\d\d\b", shown)
    assert verify_record(tmp_path / "episode-0000.jsonl").status == "ok"
    room = Room("unlabelled", names="opaque")
    tools = room.tools("manager_0")
    room.begin()
    assert room.tools("manager_0") == tools, "names stay those of the tools"


def test_introductions_have_prices_and_names_of_what_is_observed() -> None:
    failing = Room("failing", ("manager_0", "east_0"))
    assert "gas_chromatograph 0.01 (drifts; a calibration 0.004)" in failing.brief("manager_0")
    assert "An order not met costs 0.1." in failing.brief("manager_0")
    relay = Room("relay", RELAY)
    assert "An order not met costs 0.1 of its price." in relay.brief("manager_0")
    assert "revealed to fin as second_limit" in relay.brief("fin_0")
    assert "volume 0.6 to 1.6 L (not shown)" in relay.brief("fin_0")
    refine = "each for F (at most 3 mol; is judged by its purity among A, D, G, J and itself)."
    assert refine in Room("refine").brief("manager_0"), "no purity is needed"
    salt = Room("salt_from_oil", ("ext_0",))
    assert "an extraction bench" in salt.brief("ext_0")
    assert "how much (units of settling time)" in json.dumps(salt.tools("ext_0"))
    runaway = Room("runaway", RUNAWAY)
    assert "rxn has 1 times its effect. A repair costs 0.02" in runaway.brief("manager_0")
    assert "-80000 to 60000 J/mol; effect of heating before repairs (rxn_0)" in runaway.brief("rxn_0")
    jacketed = json.dumps(runaway.tools("rxn_0"))
    assert "change of the temperature of the jacket in K, -15 to 15" in jacketed
    assert "volume: no effect: the vessel is open" in jacketed
    assert "mostly noise" not in runaway.brief("rxn_0"), "no picture or spectrum is"
    assert "Resolution (of full scale): layers_DV 0.1, " in Room("crude", ("dit_0",)).brief("dit_0")


def test_observations_have_whole_names_and_what_is_measured() -> None:
    words = "hplc at tick 0: 2,4-difluoronitrobenzene 17%, ethanol 81.5%"
    assert folded_lines([("slot_0", words)]) == ["hplc at tick 0 (%): slot 0 2,4-difluoronitrobenzene 17 ethanol 81.5"]
    room, start = Room("failing", ("manager_0", "east_0")), {"bench": "east_0", "slot": 0}
    assert "gas_chromatograph: calibrated at tick 0" in room.call("manager_0", "start", start).text
    assert "west_0: idle, under repair: 10 ticks left" in room.call("manager_0", "repair", {"bench": "west_0"}).text
    assert "east_0 has the turn" in room.call("manager_0", "wait").text
    assert "spectrum" not in room.call("east_0", "look").text, "it always reads 0"
    runaway = Room("runaway", RUNAWAY)
    assert "298.2 K" in runaway.call("manager_0", "start", {"slot": 0}).text
    runaway.call("manager_0", "wait")
    assert "temperature 298.2 K" in runaway.call("rxn_0", "look").text, "the same temperature has the same digits"


def token_table() -> dict[str, list[int]]:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "language-agent.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if re.match(r"\| [a-z_]+ \| \d+ \|", line)]
    return {name: [int(cell) for cell in cells] for name, *cells in rows}


def test_texts_of_every_scenario_are_within_their_bars() -> None:
    table = token_table()
    assert sorted(table) == scenario_names()
    for name, (brief, _, look, reply, _, calls, episode) in table.items():
        assert brief <= 500, name
        assert look <= 400, name
        assert reply <= 80, name
        assert episode <= (2_000 if calls <= 200 else 15_000) or name == "refine", name  # as the page says


@pytest.mark.parametrize("name", ["fictitious", "wurtz_dodecane", "relay"])
def test_the_page_has_the_tokens_of_the_present_texts(name: str) -> None:
    encoding = pytest.importorskip("bpe_openai", reason="needs bpe-openai (extra test)").get_encoding("o200k_base")
    assert measure(name, lambda text: len(encoding.encode(text)))[1:] == list(map(str, token_table()[name]))


@pytest.mark.parametrize("name", scenario_names())
def test_every_role_has_typed_verbs_for_all_its_actions(name: str) -> None:
    """Every legal discrete action has a call; signatures, types and docstrings are what frameworks read."""
    labs = Laboratories(name)
    room = Room.__new__(Room)
    room.seats, room._say, room._name, room.laboratories = tuple(labs.agents), 0, str, labs
    room._verbs = {seat: {v.name: v for v in room._make_verbs(seat)} for seat in labs.agents}
    for agent, seat in enumerate(labs.agents):
        count = labs.action_counts[agent]
        for action in range(0, count, max(count // 40, 1)):
            call_for(room, seat, action)
        tools = LabTools(room, seat)
        verbs = {verb.name for verb in room.verbs(seat)}
        assert {word for word in dir(tools) if not word.startswith("_")} == verbs | {"reset", "get_reward"}
        for verb in room.verbs(seat):
            method = getattr(tools, verb.name)
            hints, signature = typing.get_type_hints(method), inspect.signature(method)
            assert "self" not in signature.parameters
            assert hints.pop("return") is str
            assert set(hints) == set(signature.parameters)
            described = re.findall(r"^    (\w+): .", inspect.getdoc(method) or "", re.MULTILINE)
            assert described == list(signature.parameters)
            assert set(input_schema(verb)["properties"]) == set(signature.parameters)


def test_amounts_in_verbs_have_all_their_digits(tmp_path: Path) -> None:
    """Large and nearly equal magnitudes are separate options; ``dry`` allows up to a million litres of air."""
    shipped = Path(chemlab.__file__).parents[1] / "scenarios" / "syntheses"
    shutil.copytree(shipped / "benzoic", tmp_path / "benzoic")
    text = (shipped / "benzoic.toml").read_text(encoding="utf-8")
    assert text.count("[20, 100, 200, 500]") == 1
    file = tmp_path / "air.toml"
    for magnitudes, options in (("[20, 1e6]", (20, 1_000_000)), ("[20.00001, 20.00002]", ("20.00001", "20.00002"))):
        file.write_text(text.replace("[20, 100, 200, 500]", magnitudes), encoding="utf-8")
        bench = next(bench for bench in Laboratories(str(file)).benches if bench.key == "cry")
        dry = next(verb for verb in bench_verbs(bench, str) if verb.name == "dry")
        assert [argument.options for argument in dry.arguments if argument.name == "amount"] == [options]
        actions = [dry.action(dry.checked({"amount": option})) for option in options if dry.action is not None]
        assert ["dry" in bench.action_meanings[action] for action in actions] == [True, True]
        assert actions[1] == actions[0] + 1


def test_a_call_is_found_at_the_end_of_a_long_answer() -> None:
    call = '{"verb": "look", "arguments": {}}'
    assert (call_of('{"a":' * 20_000 + call), call_of(call + " " * 10_000)) == (("look", {}), ("", {}))


def test_methods_return_text_and_raise_one_kind_of_error(room: Room) -> None:
    tools: Any = LabTools(room, "manager_0")
    assert tools.measure(0, instrument="uv_vis").startswith("Done; cost 0.02.")
    for mistake in (lambda: tools.measure(99, "uv_vis"), lambda: tools.measure(1, 2, 3, 4, 5), lambda: tools.measure()):
        with pytest.raises(ToolError, match="measure: "):
            mistake()
    assert tools.get_reward() == pytest.approx(-0.02 - load_scenario("unlabelled").demand.missed)
    assert "The episode is over" in tools.look(), "its exact score would tell what vessels hold"


def test_an_argument_of_one_value_may_be_given_by_name() -> None:
    tools: Any = LabTools(Room("runaway"), "manager_0")
    labs = tools._room.laboratories
    assert (len(labs.bench_agents), len(labs.scenario.lab_goals)) == (1, 1)
    with pytest.raises(ToolError, match=r"start: takes 1 argument \(slot\), given 3"):
        tools.start("rxn_0", 0, labs.scenario.goals[0])
    with pytest.raises(ToolError, match="start: bench must be one of rxn_0; given rxn_9"):
        tools.start(bench="rxn_9", slot=0)
    assert "rxn_0" in tools.start(bench="rxn_0", slot=0)


def test_mistakes_of_the_operator() -> None:
    for part, arguments in (
        ("seats: must be", {"seats": ("rxn_9",)}),
        ("seats: must be", {"seats": ()}),
        ("names: must be plain or opaque", {"names": "secret"}),
        ("patience: 0 to 15", {"patience": 16.0}),
        ("calls: at least 1", {"calls": 0}),
    ):
        refused(part, Room, "unlabelled", **arguments)
