"""The chemlab command, as people and programs meet it."""

import contextlib
import errno
import io
import itertools
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock, Mock

import pytest
from helpers import FEATURED, command, mapping
from rich.console import Console
from rich.text import Text
from run_files import write_run
from typer.testing import CliRunner

import chemlab.scenarios
from chemlab import __main__, __version__
from chemlab.cli import PANELS, app, screen, training
from chemlab.cli.options import FORMER_COMMANDS
from chemlab.cli.screen import TextConsole, hanging, page, show_table
from chemlab.cli.servers import _origin
from chemlab.config.inherit import campaign_names, scenario_names, synthesis_names
from chemlab.config.loading import load_scenario
from chemlab.config.materials import shipped_materials
from chemlab.envs.aec import env
from chemlab.lab.describe import world_table
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.openchem.writing import toml_tables
from chemlab.record import read_record

FIELDS = (
    "scenario policy seed goal orders paid missed submitted_mol purity score manager_actions ticks rewards costs "
    "safety_events status"
)
FULL = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
PLAYED = Mock(side_effect=AssertionError("something is played, and lost"))
runner = CliRunner()


def test_list_names_every_scenario() -> None:
    """People and programs see the same scenarios."""
    rows = json.loads(command("list", "--json"))
    names = [*scenario_names(), *campaign_names(), *synthesis_names()]
    assert [row["name"] for row in rows] == names
    assert [row["name"] for row in rows if row["synthesis"]] == synthesis_names()
    assert all(row["agents"][0] == "manager_0" for row in rows)
    shown = command("list")
    assert all(name in shown for name in names)


@pytest.mark.parametrize("words", [["evaluate"], ["data", "material"]])
def test_paragraphs_of_help_fill_the_width(words: list[str]) -> None:
    shown = runner.invoke(app, [*words, "--help"], env={"COLUMNS": "80"}).stdout
    lines = [line.strip() for line in shown.partition("╭─")[0].splitlines()]
    for line, following in itertools.pairwise(lines):
        assert not line or not following or len(f"{line} {following.split()[0]}") > 78


def test_help_shows_commands_in_panels() -> None:
    """Every command is in the panel that names it, with -h as with --help."""
    shown, same = (runner.invoke(app, [flag], env={"COLUMNS": "80"}).stdout for flag in ("-h", "--help"))
    assert shown == same
    assert sum(map(len, PANELS.values())) <= 20
    places = [shown.index(f"─ {panel} ─") for panel in PANELS]
    assert places == sorted(places)
    for names, start, stop in zip(PANELS.values(), places, [*places[1:], len(shown)], strict=True):
        assert all(f"│ {name} " in shown[start:stop] for name in names)


def test_json_is_one_object_an_episode_and_nothing_else() -> None:
    """Standard output is machine-readable line by line, with consecutive seeds."""
    words = ["run", "wurtz_dodecane", "--policy", "scripted", "--episodes", "3", "--seed", "5", "--json"]
    done = subprocess.run([sys.executable, "-m", "chemlab", *words], capture_output=True, text=True, check=True)
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert [result["seed"] for result in results] == [5, 6, 7]
    for result in results:
        assert set(result) == set(FIELDS.split())
        assert result["status"] in ("submitted", "limit reached")
        assert set(result["rewards"]) == {"manager_0", "rxn_0", "ext_0", "dit_0"}
        maximum = load_scenario("wurtz_dodecane").theoretical_maximum_mol["dodecane"]
        product = result["submitted_mol"] * result["purity"] / maximum
        assert result["score"] == pytest.approx(product - sum(result["costs"].values()), abs=1e-12)
        assert result["rewards"]["manager_0"] == pytest.approx(result["score"], abs=1e-12)


def test_account_tells_who_does_what() -> None:
    """The live account names agents, goal, outcome and score, and ends with a table."""
    shown = command("run", "wurtz_dodecane", "--seed", "1")
    parts = ("manager_0", "rxn_0", "ext_0", "dit_0", "start rxn_0 on slot 0, goal dodecane", "submitted", "score")
    assert [part for part in (*parts, "Results") if part not in shown] == []


MISTAKES = {
    "run no_such": ["no_such", "wurtz_dodecane"],
    "run wurtz_dodecane --policy clever --record new/x.jsonl": ["clever", "scripted"],
    "run missing/file.toml": ["missing/file.toml", "no such file"],
    "play fictitious --role chef --record x.jsonl": ["no agent is called chef"],
    "play fictitious --background clever --record x.jsonl": ["clever"],
    "play fictitious --goal gold --record x.jsonl": ["gold"],
    "replay a.jsonl -o a.mov": ["unknown suffix .mov; choose from .html, .gif"],
    "new My-Lab --reactions fischer": ["lower-case letters, digits and _", "given 'My-Lab'"],
    "run wurtz_dodecane --policy scripted,rxn=wurtz_ext": ["rxn=wurtz_ext: has policies for ext only", "rxn=scripted"],
    "train rush --roles rxn_7 --algo ippo": ["rush has manager, rxn; given rxn_7"],
    "replay a.jsonl b -o a.gif": ["an animation or a protocol one"],
    "replay a.jsonl b c -o a.html": ["at most two"],
    "plot timeline a.jsonl -o x.gif": ["choose from png"],
    "plot moles a.jsonl --only Au -o x.png": ["Au is not in this record"],
    "plot curves . -o x.png": ["no training run"],
    "data pairs toluene toluene -o x.toml": ["with itself"],
    "data pairs toluene NaCl -o x.toml": ["not a molecule in a liquid (its role is 'solid')"],
    "data pairs toluene 4-nitrotoluene -o x.toml": ["make it with chemlab data material"],
    "describe fictitious --agent chef": ["--agent: no agent is called chef; known: manager_0, rxn_0, dit_0, all"],
    "evaluate chemlab/WurtzDistillation-v0 --policy clever --episodes 1": ["clever", "scripted", "path"],
    "evaluate wurtz_dodecane --policy clever --episodes 1": ["clever", "scripted"],
    "audit unlabelled --budget huge": ["budget: known: small, full; given 'huge'"],
    "audit plan salt_from_oil --budget some": ["--budget"],
    "benchmark unlabelled --budget huge --out parts": ["budget: known: small, full; given 'huge'"],
    "benchmark unlabelled --baseline clever --out parts": ["policies: clever: policy: must be one of scripted"],
    "plot runs . --out pages": ["contains no training runs; give"],
    # A group without the name of a kind stands for its first.
    "audit no_such": ["no_such"],
    "audit --budget small no_such": ["no_such"],
    # A variable of a script that is not set is no name for the current folder.
    "run ''": ["must not be empty"],
    "run fictitious --record ''": ["--record: must not be empty"],
    "train --out=": ["--out: must not be empty"],
    "train rush --steps 1e": ["must be a whole number, such as 1000000 or 1e6"],
    "train rush --steps 1e13": ["less than or equal to 1000000000000, given 10000000000000"],
}
for _name, _give in (("WurtzReaction-v0", "wurtz_dodecane"), ("LabManager-v1", "a scenario, such")):
    for _words in ("run", "describe", "audit", "audit plan"):
        MISTAKES[f"{_words} chemlab/{_name}"] = [f"scenario: chemlab/{_name} is an environment's id; give {_give}"]


def test_mistakes_are_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mistake is one readable message and exit code 2, not a traceback, and no file is made."""
    monkeypatch.chdir(tmp_path)
    command("run", "fictitious", "--record", "a.jsonl", "--json")
    for words, parts in MISTAKES.items():
        if find_spec({"plot": "matplotlib", "data": "ugropy", "train": "torch"}.get(words.split()[0], "chemlab")):
            said = command(*shlex.split(words), code=2)
            assert [part for part in parts if part not in said] == [], said
            assert "Traceback" not in said
            assert os.listdir() == ["a.jsonl"], words


def test_compare_updates_a_file(tmp_path: Path) -> None:
    """The table goes between the marks and nothing else changes; without marks the file is left alone."""
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- results: begin -->\nold\n<!-- results: end -->\nafter\n")
    arguments = ["evaluate", "fictitious", "--episodes", "2", "--update", page]
    shown = command(*arguments)
    assert "fictitious, laboratory: 2 episodes;" in shown
    assert re.search(r"P\(improvement\) +ticks", shown)
    text = page.read_text()
    assert text.startswith("before\n<!-- results: begin -->\n| scenario")
    assert text.endswith("<!-- results: end -->\nafter\n")
    assert "old" not in text
    assert text.count("`fictitious`") == 2
    # Rows of other scenarios stay, in their order.
    rest = "| `zzz` | random | 1 |"
    page.write_text(text.replace("<!-- results: end -->", f"{rest}\n<!-- results: end -->"))
    command(*arguments)
    assert page.read_text() == text.replace("<!-- results: end -->", f"{rest}\n<!-- results: end -->")
    page.write_bytes(b"\xff")
    assert "is not a text file" in command(*arguments, code=2)
    page.write_text("no marks")
    command(*arguments, code=2)
    assert page.read_text() == "no marks"


def test_version() -> None:
    """The command and the package agree, however it is called."""
    assert command("--version") == __version__
    module = subprocess.run([sys.executable, "-m", "chemlab", "--version"], capture_output=True, text=True, check=True)
    assert module.stdout.strip() == __version__


def test_an_interruption_while_modules_load_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    loading = type("Loading", (), {"main": property(Mock(side_effect=KeyboardInterrupt))})
    monkeypatch.setitem(sys.modules, "chemlab.cli", loading())
    with pytest.raises(SystemExit, match="130"):
        __main__.main()
    assert capsys.readouterr().err == "stopped\n"


# -- text is text -----------------------------------------------------------------------------------------------------

HOSTILE = "0.1 [mol] of [/bold] [red]tape[/red] :smile: \u202eback C:\\"
MATERIAL = "[/bold] oil :smile:"
SEEN = "0.1 [mol] of [/bold] [red]tape[/red] :smile: \ufffdback C:\\"


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A scenario file all of whose free texts would steer a terminal, in a folder whose name a shell would split."""
    values = mapping("salt_from_oil")
    values |= {"title": HOSTILE, "summary": HOSTILE, "name": "hostile", "material_files": ["own.toml"]}
    values["stock"] = {**values["stock"], MATERIAL: 1.0}
    path = tmp_path / "my [red] labs" / "hostile lab.toml"
    path.parent.mkdir()
    path.write_text("\n".join(toml_tables(values)), encoding="utf-8")
    hexane = shipped_materials()["hexane"].model_dump(exclude_none=True) | {"shade": 0.123}
    path.with_name("own.toml").write_text("\n".join(toml_tables({MATERIAL: hexane})), encoding="utf-8")
    assert load_scenario(path).title == HOSTILE
    return path


def test_text_of_files_is_shown_as_it_is(hostile: Path) -> None:
    """No markup, no emoji, no way to the terminal; and nothing is lost. So are paths in errors."""
    for arguments, typed in (
        (["run", "--policy", "random"], ""),
        (["describe"], ""),
        (["describe", "--agent", "all"], ""),
        (["play", "--role", "all"], "?\nmeasure slot 0\nsubmit slot 0\n"),
    ):
        command, *options = arguments
        done = runner.invoke(app, [command, str(hostile), *options], input=typed)
        assert done.exit_code == 0, done.output
        shown = " ".join(done.output.split())
        assert SEEN in shown
        assert not set(done.output) & {"\x1b", "\x07", "\x9b", "\u202e"}
        assert command != "describe" or MATERIAL in shown
    done = runner.invoke(app, ["run", str(hostile.with_name("no\x1b[1m [such].toml"))])
    assert done.exit_code == 2
    assert "no␛[1m [such].toml" in done.output
    assert "\x1b" not in done.output


def test_names_of_goals_and_runs_are_shown_as_they_are(hostile: Path) -> None:
    """Where somebody's own material is a goal, and a sweep's run is called something."""
    values = mapping("salt_from_oil") | {"name": "hostile", "material_files": ["own.toml"], "lab_goals": [MATERIAL]}
    values |= {"goals": [*values["goals"], MATERIAL], "theoretical_maximum_mol": {MATERIAL: 1.0}}
    values["stock"][MATERIAL] = 1.0
    hostile.write_text("\n".join(toml_tables(values)), encoding="utf-8")
    sweep = hostile.with_name("sweep.toml")
    sweep.write_text(f'[[runs]]\nname = "{MATERIAL.replace("/", "")}"\n', encoding="utf-8")
    brief = ["--episodes", "1"]
    for words, shown in (
        (["audit", "plan", str(hostile), "--budget", "50", *brief], MATERIAL),
        (["run", str(hostile), "--policy", "random"], MATERIAL),
        (["sweep", str(sweep), "--status", "--out", str(hostile.parent)], "[bold] oil"),
    ):
        assert shown in command(*words), words


def test_hints_name_commands_that_work(hostile: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is said to be run can be pasted into a shell, for a file as for a shipped scenario."""
    monkeypatch.chdir(tmp_path)
    given = hostile.relative_to(tmp_path)
    arguments = ["evaluate", str(given), "--bench", "ext", "--starts", "lab", "--episodes", "1"]
    hint = command(*arguments, code=2).partition("run: chemlab ")[2]
    assert hint == f"export starts {shlex.quote(str(given))}"
    command(*shlex.split(hint), "--episodes", "1")
    command(*arguments)
    said = command("export", "starts", "fictitious", code=2)
    assert "fictitious: its recorded vessels are part of the package" in said
    assert "chemlab run 'a folder/made.toml'" in command("data", "generate", "made", "-o", "a folder")
    if find_spec("ugropy"):
        new = ["new", "made", "--reactions", "a folder/made_reactions.toml", "-o", "a folder/made_reactions.toml"]
        assert "is an input of this command" in command(*new, code=2)
    assert "chemlab describe fictitious --agent NAME --trust" in command("describe", "fictitious", "--trust")
    plan = ["audit", "plan", "salt_from_oil", "--budget", "200", "--episodes", "1", "--trust", "-o"]
    assert "manager=plan:plan.json --trust" in command(*plan, "plan.json")
    for name in ("a,b.json", "a=b.json", "a@1.json"):
        assert "--policy plan:FILE cannot name" in command(*plan, name, code=2)


# -- tables -----------------------------------------------------------------------------------------------------------

LONG = ["a", "gas_chromatograph", "4-ethyl-5-methylnonane, 4,5-diethyloctane", "the quick brown fox", "", "12,345.678"]


@pytest.mark.parametrize("width", [40, 60, 80, 120, 200])
@pytest.mark.parametrize("columns", [1, 3, 6, 9])
def test_tables_break_no_word(
    width: int, columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every word stands whole on some line, and no line is longer than the terminal is wide."""
    monkeypatch.setattr(page, "_width", width)
    rows = [[LONG[(row + column) % len(LONG)] for column in range(columns)] for row in range(6)]
    show_table("", [f"name_{i}" for i in range(columns)], rows, right=(0, 2))
    shown = capsys.readouterr().out
    assert max(map(len, shown.splitlines())) <= width
    words = shown.replace(":", " ").split()
    for cell in (cell for row in rows for cell in row):
        assert set(cell.replace(":", " ").split()) <= set(words)


def test_a_table_has_its_cells_in_their_columns(capsys: pytest.CaptureFixture[str]) -> None:
    show_table("", ("name", "number"), [("one", 1), (Text("[two]", style="red"), "22")], right=(1,))
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert (lines[0], lines[2:]) == (" name   number", [" one         1", " [two]      22"])


# -- describe ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FEATURED)
def test_a_scenario_is_described_as_it_is(name: str) -> None:
    """Observations index by index without a gap, actions by number: those of the laboratory itself."""
    labs = Laboratories(name)  # first: it may say that it compiles
    told = json.loads(command("describe", name, "--json"))
    only = json.loads(command("describe", name, "--agent", "manager", "--json"))["agents"]
    assert only == {"manager_0": told["agents"]["manager_0"]}
    assert list(told["agents"]) == labs.agents
    assert (told["stock"], told["limits"]["ticks"]) == (dict(labs.scenario.stock), labs.scenario.limits.ticks)
    for number, (agent, one) in enumerate(told["agents"].items()):
        ends = [0, *(channel["stop"] for channel in one["observation"]["channels"])]
        names = [channel.name for channel in labs.roles[number].channels]
        assert [channel["name"] for channel in one["observation"]["channels"]] == names
        assert [channel["start"] for channel in one["observation"]["channels"]] == ends[:-1]
        assert (ends[-1],) == labs.observation_space(number).shape == (one["observation"]["size"],)
        space = labs.action_space(number)
        assert len(one["actions"]["meanings"]) == int(space.n if one["actions"]["discrete"] else space.shape[0])
        if agent == "manager_0":
            assert one["actions"]["meanings"] == labs.actions.action_meanings


def test_noise_and_what_always_reads_0_are_described() -> None:
    observed = " ".join(command("describe", "unlabelled", "--agent", "rxn_0").split())
    assert "volume the piston leaves; always 0" in observed
    assert "noise 0.05" in observed


@pytest.mark.parametrize(
    ("name", "observers"),
    [("relay", {"first_limit": "`rxn`", "titre": "no agent", "price": "manager, on arrival"}), ("relay@1", {})],
)
def test_hidden_parameters_grades_and_reports_are_described(name: str, observers: dict[str, str]) -> None:
    """For people: who observes a hidden parameter, what a grade asks for, how exact a report is. For programs: all."""
    told, shown = json.loads(command("describe", name, "--json")), runner.invoke(app, ["describe", name]).stdout
    assert told["world"]["draws"]["first_limit"]["told"] == ["rxn"]
    assert told["grades"]["quick"]["ticks"] == 8
    assert told["benches"]["rxn"]["report"] == 0.03
    rows = {row[0].strip("`"): row[-1] for row in world_table(load_scenario(name)).rows}
    assert {draw: rows[draw] for draw in observers} == observers
    assert ("all agents" in rows.values()) == (not observers)
    assert re.search(r"observed *$", shown, re.M)
    assert re.search(r"quick +0 +0 +8", shown)
    assert "rxn (0.03), fin (0.03)" in " ".join(shown.split())
    assert all(re.search(f"{what} 0 to 7 ", shown) for what in ("slot", "order")) == (not name.endswith("@1"))


@pytest.mark.parametrize("name", ["crude", "failing", "wurtz_two_lines"])
def test_descriptions_are_for_people(name: str) -> None:
    """80 columns hold every line, and each action of an agent has a line with its number."""
    labs = Laboratories(name)
    shown = runner.invoke(app, ["describe", name]).stdout
    parts = [*labs.agents, *labs.scenario.stock, *labs.scenario.instruments, *labs.scenario.goals]
    assert all(part in shown for part in parts)
    for number, agent in enumerate(labs.agents):
        done = runner.invoke(app, ["describe", name, "--agent", agent])
        assert max(map(len, done.stdout.splitlines())) <= 80
        joined = " ".join(done.stdout.split())
        for action, meaning in enumerate(labs.roles[number].action_meanings):
            assert f" {action} {meaning}" in joined
        assert all(re.sub(r"slot_\d+", "slot_s", channel.name) in joined for channel in labs.roles[number].channels[:9])


# -- progress ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "work", "kept"),
    [
        (["audit", "unlabelled"], "audit.audit", ["--keep", "parts"]),
        (["crossplay", "unlabelled"], "crossplay.crossplay", ["--keep", "parts"]),
        (["benchmark", "unlabelled", "--policy", "scripted", "--out", "parts"], "benchmark.benchmark", []),
    ],
)
def test_who_interrupts_is_told_how_to_resume(
    words: list[str], work: str, kept: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(f"chemlab.agents.evaluate.{work}", Mock(side_effect=KeyboardInterrupt))
    assert command(*words, *kept, code=130) == "stopped; the same command resumes from parts"
    if kept:
        assert "nothing is kept; with --keep FOLDER" in command(*words, code=130)


@pytest.mark.parametrize("width", [60, 160])
def test_a_bar_shows_its_clocks(width: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=width)
    monkeypatch.setattr(training, "err", console)

    def run(watcher: Any) -> Any:
        watcher.begun(0, 1_000_000)
        for step in range(100_000, 1_000_000, 100_000):
            watcher.advanced(step, 0.5 if step < 900_000 else None)  # no episode ended in the last one
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        training._watched(tmp_path, quiet=False, as_json=False, run=run)
    lines = Text.from_ansi(console.file.getvalue()).plain.splitlines()  # type: ignore[attr-defined]
    bar = next(line for line in reversed(lines) if "steps" in line)
    assert re.search(r" 90 % 0:00:\d\d left (-:--:--|0:00:\d\d) 900,000 steps, return", bar)
    assert len(bar) <= width


# -- what the system says ---------------------------------------------------------------------------------------------


def test_what_the_system_says_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder where a file is meant, a folder that is not there, a disk that is full."""
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    (tmp_path / "file").write_text("")
    cases = [
        (["run", str(folder)], f"error: {folder}: is not a regular file"),
        (["evaluate", "fictitious", "--episodes", "1", "--update", str(tmp_path / "no.md")], "no such file"),
        (["run", "fictitious", "--record", str(tmp_path / "file" / "x.jsonl")], os.strerror(errno.ENOTDIR)),
        (["export", "starts", "fictitious", "--episodes", "1", "-o", str(folder)], "is a folder; give a file's name"),
    ]
    for arguments, words in cases:
        said = command(*arguments, code=2)
        assert words in said
        assert "Traceback" not in said
        assert isinstance(runner.invoke(app, ["--traceback", *arguments]).exception, (OSError, ValueError))
        assert command(*arguments, code=2) == said, "where an error comes from is shown on request alone"
    monkeypatch.setattr(json, "dumps", FULL)
    assert command("list", "--json", code=2) == f"error: {os.strerror(errno.ENOSPC)}"
    monkeypatch.undo()
    command("list")


OUTPUTS: dict[str, list[str]] = {
    "audit": ["unlabelled", "--out"],
    "audit keep": ["unlabelled", "--keep"],
    "benchmark": ["unlabelled", "--out"],
    "crossplay": ["unlabelled", "--out"],
    "crossplay keep": ["unlabelled", "--keep"],
    "evaluate": ["fictitious", "--bench", "rxn", "--out"],
    "plan": ["fictitious", "--out"],
    "starts": ["fictitious", "--out"],
    "compare": ["fictitious", "--update"],
    "new": ["lab", "--reactions", "wurtz_real", "--out"],
    "replay": ["RECORD", "--out"],
    "plot timeline": ["RECORD", "--out"],
    "export": ["runs", "--out"],
    "figures": ["runs", "--out"],
    "train": ["fictitious", "--bench", "rxn", "--out"],
}
"""Commands that write something, up to the option for where."""


@pytest.mark.parametrize("task", OUTPUTS)
def test_a_place_that_cannot_be_written_is_said_before_anything_is_played(
    task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file where a folder is meant, a folder where a file is meant, a name that no file may have."""
    if task == "export":
        pytest.importorskip("torch")  # without it, that is what is said
    record = tmp_path / "a.jsonl"
    command("run", "fictitious", "--record", record, "--json")
    monkeypatch.setattr(Laboratories, "reset", PLAYED)
    monkeypatch.setattr(ExperimentBatch, "reset", PLAYED)
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "runs", "fictitious", "rxn", {"E": 0.5})
    (tmp_path / "file").write_text("")
    ending = {"new": ".toml", "plot timeline": ".png"}.get(task, ".json")
    (tmp_path / f"folder{ending}").mkdir()
    words = [str(record) if word == "RECORD" else word for word in OUTPUTS[task]]
    name = task.removesuffix(" keep").split()
    before = sorted(tmp_path.rglob("*"))
    folder = task in ("audit keep", "benchmark", "crossplay keep", "figures", "train")  # which write one
    for place in (f"file/below{ending}", *(() if folder else (f"folder{ending}",)), f"{'a' * 300}{ending}"):
        said = command(*name, *words, place, code=2)
        assert place in said or place.partition("/")[0] in said
        assert sorted(tmp_path.rglob("*")) == before


def test_results_are_shown_or_written_if_the_other_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk was found to have room, and has none any more when it comes to it."""
    page = tmp_path / "page.md"
    page.write_text("<!-- results: begin -->\n<!-- results: end -->\n")
    before = page.read_text()
    made = tmp_path / "a.json"
    cases = (
        (["evaluate", "fictitious", "--episodes", "1", "--update", page], "scripted"),
        (["evaluate", "fictitious", "--bench", "rxn", "--episodes", "1", "-o", made], "scripted"),
        (["audit", "plan", "salt_from_oil", "--budget", "200", "--episodes", "1", "-o", made], "plans tried"),
    )
    for words, shown in cases:
        with monkeypatch.context() as patch:
            patch.setattr("chemlab.config.files.sync_file", FULL)
            said = command(*words, code=2)
        assert shown in said
        assert os.strerror(errno.ENOSPC) in said
    assert page.read_text() == before
    assert list(tmp_path.iterdir()) == [page]
    with monkeypatch.context() as patch:  # and the other way round
        patch.setattr("chemlab.cli.evaluation._show", FULL)
        patch.setattr("chemlab.cli.auditing._tell", FULL)
        for *words, file in (words for words, _ in cases):
            command(*words, file, code=2)
            assert Path(file).read_text() not in ("", before)
            Path(file).unlink()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_and_a_reader_who_has_seen_enough() -> None:
    chemlab = [sys.executable, "-m", "chemlab"]
    with open("/dev/full", "w", encoding="utf-8") as full:
        for words in (["list", "--json"], ["list"], ["--help"]):
            done = subprocess.run([*chemlab, *words], stdout=full, stderr=subprocess.PIPE, text=True)
            assert (done.returncode, done.stderr) == (2, f"error: standard output: {os.strerror(errno.ENOSPC)}\n")
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*chemlab, "list", "--json"], stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert "Traceback" not in done.stderr
    assert "error" not in done.stderr


def test_what_is_read_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A result under the name of a scenario, record, policy or run that the command reads, whatever is forced."""
    monkeypatch.chdir(tmp_path)
    command("data", "generate", "lab")
    command("run", "fictitious", "--record", "a.jsonl", "--json")
    Path("link.json").symlink_to("lab.toml")
    Path("based.toml").write_text('base = "lab.toml"\n')
    Path("mine.json").write_text("{}")
    Path("plan.json").write_text("{}")
    Path("run", "checkpoints", "best-1").mkdir(parents=True)
    Path("run", "config.json").write_text("{}")
    monkeypatch.setattr(Laboratories, "reset", PLAYED)
    monkeypatch.setattr(ExperimentBatch, "reset", PLAYED)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    lab = ("lab.toml", "--force")
    for words in (
        ["replay", "a.jsonl", "-o", "a.jsonl", "--force"],
        ["replay", "a.jsonl", "-o", "run/../a.jsonl", "--force"],
        ["run", "lab.toml", "--record", "lab.toml", "--force"],
        ["run", "lab.toml", "--record", "link.json", "--force"],
        ["play", "lab.toml", "--record", "lab.toml", "--force"],
        ["run", "fictitious", "--policy", "scripted,manager=plan:plan.json", "--record", "plan.json", "--force"],
        ["run", "based.toml", "--record", "lab_reactions.toml", "--force"],
        ["evaluate", "lab.toml", "--out", "lab.toml"],
        ["evaluate", "based.toml", "--out", "lab.toml", "--force"],
        ["evaluate", "based.toml@3", "--out", "lab_materials.toml", "--force"],
        ["evaluate", "fictitious", "--policy", "plan.json", "--out", "plan.json"],
        ["audit", "lab.toml", "--out", "lab.toml"],
        ["crossplay", "lab.toml", "--out", "lab.toml"],
        ["audit", "plan", "lab.toml", "--out", "lab.toml"],
        ["export", "starts", "lab.toml", "--out", "lab.toml"],
        ["new", "lab", "--reactions", "lab.toml", "-o", *lab],
        ["new", "lab", "--reactions", "wurtz_real", "-o", "lab.toml", "--materials", *lab],
        ["data", "material", "benzyl chloride", "-o", "lab.toml", "--values", *lab],
        ["data", "material", "benzyl chloride", "-o", "n.toml", "--pairs", "lab.toml", "--values", *lab],
        ["data", "pairs", "hexane", "water", "-o", "lab.toml", "--materials", *lab],
        ["data", "reactions", "--smarts", "C>>C", "--reactants", "water", "-o", "lab.toml", "--materials", *lab],
        ["export", "run", "--out", "run/config.json"],
        ["export", "run", "--out", "mine"],
        ["export", "starts", "lab.toml", "--out", "mine.json"],
        ["evaluate", "fictitious", "--out", "mine.json"],
        ["audit", "fictitious", "--out", "mine.json"],
        ["audit", "plan", "fictitious", "--out", "mine.json"],
        ["crossplay", "fictitious", "--out", "mine.json"],
    ):
        if not find_spec({"export": "torch", "data": "ugropy"}.get(words[0], "chemlab")):
            continue  # that is what is said
        wanted = "already exists" if words[-1].startswith("mine") else "is an input of this command"
        assert wanted in command(*words, code=2), words
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="locales of POSIX")
def test_a_terminal_that_knows_no_umlauts(tmp_path: Path) -> None:
    """A name that it cannot show is no reason to lose an episode, or to find fault with a record."""
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    environment.pop("PYTHONIOENCODING", None)
    text = Path(chemlab.scenarios.__path__[0], "salt_from_oil.toml").read_text(encoding="utf-8")
    text = text.replace('name = "salt_from_oil"', 'name = "mine"')
    text = re.sub("^title = .*", 'title = "Säure"', text, flags=re.M)
    (tmp_path / "säure.toml").write_text(re.sub("^summary = .*", 'summary = "größer"', text, flags=re.M), "utf-8")
    for words in (
        ["run", "säure.toml", "--policy", "random", "--record", "é.jsonl"],
        ["verify", "é.jsonl", "--scenario", "säure.toml"],
        ["describe", "säure.toml"],
    ):
        program = [sys.executable, "-m", "chemlab", *words]
        done = subprocess.run(program, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
    assert "S\\xe4ure" in done.stdout
    assert (tmp_path / "é.jsonl").exists()


def test_without_the_extra_chem_one_line_names_it(tmp_path: Path) -> None:
    """Whatever of it is missing: each of the commands that need it, in a process that cannot import it."""
    code = (
        "import json, sys\n"
        "sys.modules.update(dict.fromkeys(('rdkit', 'chemicals', 'thermo', 'ugropy')))\n"
        "from typer.testing import CliRunner\n"
        "from chemlab.cli import app\n"
        "for words in json.loads(sys.argv[1]):\n"
        "    done = CliRunner().invoke(app, words)\n"
        "    print(json.dumps([done.exit_code, done.output]))\n"
    )
    words = [
        ["data", "material", "benzyl alcohol"],
        ["data", "pairs", "A", "B"],
        ["data", "reactions", "--smarts", "[C:1]>>[C:1]", "--reactants", "ethanol"],
        ["new", "lab", "--reactions", "wurtz_real"],
    ]
    given = [sys.executable, "-c", code, json.dumps([[*command, "-o", "made.toml"] for command in words])]
    plain = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(given, capture_output=True, text=True, cwd=tmp_path, env=plain, check=True)
    *refused, made = map(json.loads, done.stdout.splitlines())
    for exit_code, output in refused:
        assert exit_code == 2
        assert output.strip().startswith("error: ")
        assert len(output.strip().splitlines()) == 1
        assert 'pip install ".[chem]"' in output
    assert len(refused) == 3
    # All pairs of the last one are shipped, and nothing else was written.
    assert made[0] == 0, made
    assert list(tmp_path.iterdir()) == [tmp_path / "made.toml"]


@pytest.mark.skipif(sys.platform == "win32", reason="no terminal to pretend")
@pytest.mark.parametrize("key", [b"\x03", b"\x04"], ids=["interrupt", "end"])
def test_who_stops_answering_leaves_no_file(tmp_path: Path, key: bytes) -> None:
    """`chemlab new` asks where it stands at a terminal."""
    import pty

    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "chemlab", "new", "lab"]
    # What is started in the background has been told to ignore Ctrl-C, and its children with it.
    listens = signal.signal(signal.SIGINT, signal.default_int_handler)
    process = subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs, cwd=tmp_path, start_new_session=True)
    signal.signal(signal.SIGINT, listens)
    try:
        os.close(theirs)
        said = b""
        while b"reaction file: " not in said:
            said += os.read(ours, 1000)
        code = None
        time.sleep(0.5)
        for _ in range(12):  # what comes between the question and its waiting for the answer is heard with the next
            if key == b"\x03":
                process.send_signal(signal.SIGINT)
            else:
                os.write(ours, key)
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = process.wait(5.0)  # a second signal while it ends would kill it
                break
    finally:
        process.kill()
    said += os.read(ours, 1000)
    os.close(ours)
    assert code == 1
    assert b"Aborted" in said
    assert b"Traceback" not in said
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("former", FORMER_COMMANDS)
def test_former_commands_work_with_a_notice(former: str) -> None:
    words = FORMER_COMMANDS[former]
    before, after = runner.invoke(app, [former, "--help"]), runner.invoke(app, [*words, "--help"])
    assert (before.exit_code, before.stdout) == (0, after.stdout)
    said = f"chemlab {former} is now chemlab {' '.join(words)}; the old name ends with this release"
    assert before.stderr.split() == said.split()
    assert former not in [name for names in PANELS.values() for name in names]


@pytest.mark.parametrize(
    ("words", "former", "now"), [("replay none.jsonl", "output", "out"), ("audit fictitious", "jobs", "processes")]
)
def test_former_options_work_with_a_notice(words: str, former: str, now: str) -> None:
    found = runner.invoke(app, [*words.split(), f"--{former}=0", "--help"])
    assert (found.exit_code, f"--{former}" in found.stdout) == (0, False)
    assert " ".join(found.stderr.split()).startswith(f"--{former} is now --{now};")


def test_more_lines_of_a_log_are_indented(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In a terminal no line is longer than it, and no word is broken; elsewhere a turn is one line."""
    said = "[bold]measure slot 12[/bold] with an instrument -> nonpolar 0.50, chlorohexane 0.25, dodecane 0.125"
    hanging("tick   7  rxn_0      ", said)
    assert capsys.readouterr().out.count("\n") == 1
    terminal = TextConsole(soft_wrap=True)
    monkeypatch.setattr(screen, "out", terminal)
    monkeypatch.setattr(TextConsole, "is_terminal", True)
    terminal.width = 48
    hanging("tick   7  rxn_0      ", said)
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line).rstrip() for line in capsys.readouterr().out.splitlines()]
    assert len(lines) > 2
    assert all(len(line) <= 48 for line in lines)
    assert all(line.startswith(" " * 21) for line in lines[1:])
    assert " ".join(" ".join(lines).split()) == "tick 7 rxn_0 " + re.sub(r"\[/?bold\]", "", said)


def test_kernels_are_compiled_ahead() -> None:
    assert command("warm", "wurtz_dodecane_direct").endswith("1 scenarios are compiled")
    assert "wurtz_dodecane" in command("warm", "wurtz_dodecane_direct", "wurtz_dodecan", code=2)


def test_an_episode_is_watched_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    """`run --watch` opens the page of `serve`, with the episode that was asked for."""
    live = pytest.importorskip("chemlab.agents.live", reason="needs the extra live")
    opened = []

    class Server:
        def __init__(self, made: Any, host: str, port: int) -> None:
            opened.extend(made.state.show.lives)

        def run(self) -> None:
            assert [(one.seed, one.room.scenario.name) for one in opened] == [(3, "wurtz_dodecane_direct")]
            opened[0].room.close()

    monkeypatch.setattr(live, "live_server", Server)
    assert "watch: http://127.0.0.1:" in command("run", "wurtz_dodecane_direct", "--watch", "--seed", 3)
    assert "--watch: cannot be given with" in command("run", "wurtz_dodecane_direct", "--watch", "--json", code=2)
    assert len(opened) == 1


@pytest.mark.parametrize(("server", "option"), [("serve", "--port"), ("mcp", "--http")])
def test_addresses_that_cannot_be_had(server: str, option: str) -> None:
    pytest.importorskip("mcp" if server == "mcp" else "starlette")
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        for port, words in ((taken, f"port {taken} is taken; give another with {option}"), (65536, "65535")):
            said = command(server, "wurtz_dodecane_direct", option, port, code=2)
            assert words in said
            assert "http://" not in said
    for host in ("nowhere.invalid", "8.8.8.8") if server == "serve" else ():
        said = command("serve", "wurtz_dodecane_direct", "--host", host, "--port", 0, code=2)
        assert f"--host: cannot listen on {host}" in said
    assert (_origin("::1", 80), _origin("a.b", 80)) == ("http://[::1]:80", "http://a.b:80")


def test_addresses_are_those_that_others_can_open(monkeypatch: pytest.MonkeyPatch) -> None:
    probe = MagicMock()
    probe.return_value.__enter__.return_value.getsockname.return_value = ("10.1.2.3", 5)
    monkeypatch.setattr(socket, "socket", probe)
    assert _origin("0.0.0.0", 80) == "http://10.1.2.3:80"
    probe.side_effect = OSError  # without a network
    assert _origin("0.0.0.0", 80) == "http://0.0.0.0:80"


@pytest.mark.skipif(os.name != "posix", reason="needs signals of POSIX")
@pytest.mark.parametrize("sent", ["SIGHUP", "SIGTERM"])
def test_a_server_that_is_ended_writes_its_record(sent: str, tmp_path: Path) -> None:
    """When its terminal is closed, too; nothing is left in the folder of temporary files."""
    pytest.importorskip("starlette")
    (temporary := tmp_path / "temporary").mkdir()
    words = ["serve", "wurtz_dodecane_direct", "--port", "0", "--paused", "--out", str(tmp_path)]
    ending = getattr(signal, sent)
    options: Any = {"stdout": subprocess.PIPE, "text": True, "env": os.environ | {"TMPDIR": str(temporary)}}
    options["preexec_fn"] = lambda: signal.signal(ending, signal.SIG_DFL)  # under nohup, SIGHUP is ignored
    with subprocess.Popen([sys.executable, "-m", "chemlab", *words], **options) as server:
        try:
            assert any(line.startswith("watch: ") for line in server.stdout)
            time.sleep(1.0)  # until it listens
            server.send_signal(ending)
            assert server.wait(30) == 130
        finally:
            server.kill()
    assert (tmp_path / "0" / "episode-0000.jsonl.part").exists()
    assert list(temporary.iterdir()) == []


def test_notebooks_show_what_things_are(tmp_path: Path) -> None:
    """An environment as a picture, a scenario and a record as facts, none as pages of numbers."""
    path = tmp_path / "a<b>.jsonl"
    command("run", "wurtz_dodecane_direct", "--record", path)
    laboratory, record = env("wurtz_dodecane_direct"), read_record(path)
    assert "data:image/png;base64," in laboratory._repr_html_()
    for shown, words in (
        (record, ("wurtz_dodecane_direct", "a&lt;b&gt;.jsonl", "score")),
        (load_scenario("crude"), ("manager_0", "dodecane", "ticks", "hidden parameters")),
    ):
        assert all(word in shown._repr_html_() for word in words)
        assert len(repr(shown)) < 400
    assert repr(load_scenario("crude")).startswith("Scenario('crude', title=")
