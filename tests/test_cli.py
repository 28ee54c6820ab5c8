"""The chemlab command, as people and programs meet it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from chemlab import __version__
from chemlab.cli import app
from chemlab.files import replace_between, write_text
from chemlab.materials import DataError
from chemlab.scenario import load_scenario, scenario_names

FIELDS = {
    "scenario",
    "policy",
    "seed",
    "goal",
    "submitted_mol",
    "purity",
    "score",
    "manager_actions",
    "ticks",
    "rewards",
    "costs",
    "safety_events",
    "terminated",
    "truncated",
}
runner = CliRunner()


def test_list_names_every_scenario() -> None:
    """People and programs see the same scenarios."""
    rows = json.loads(runner.invoke(app, ["list", "--json"]).stdout)
    assert [row["name"] for row in rows] == scenario_names()
    assert all(row["agents"][0] == "manager_0" for row in rows)
    shown = runner.invoke(app, ["list"]).stdout
    assert all(name in shown for name in scenario_names())


@pytest.mark.parametrize("policy", ["heuristic", "random"])
def test_json_is_one_object_an_episode_and_nothing_else(policy: str) -> None:
    """Standard output is machine-readable line by line, with consecutive seeds."""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from chemlab.cli import main; main()",
            "run",
            "wurtz_dodecane",
            "--policy",
            policy,
            "--episodes",
            "3",
            "--seed",
            "5",
            "--json",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert [result["seed"] for result in results] == [5, 6, 7]
    for result in results:
        assert set(result) == FIELDS
        assert result["terminated"] != result["truncated"]
        assert set(result["rewards"]) == {"manager_0", "rxn_0", "ext_0", "dit_0"}
        maximum = load_scenario("wurtz_dodecane").theoretical_maximum_mol["dodecane"]
        product = result["submitted_mol"] * result["purity"] / maximum
        assert result["score"] == pytest.approx(product - sum(result["costs"].values()), abs=1e-12)
        assert result["rewards"]["manager_0"] == pytest.approx(result["score"], abs=1e-12)


def test_account_tells_who_does_what() -> None:
    """The live account names agents, goal, outcome and score, and ends with a table."""
    shown = runner.invoke(app, ["run", "wurtz_dodecane", "--seed", "1"]).stdout
    for part in ("manager_0", "rxn_0", "ext_0", "dit_0", "start rxn_0 on slot 0, goal dodecane", "submitted", "score"):
        assert part in shown
    assert "Results" in shown


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["run", "no_such"], ["no_such", "wurtz_dodecane"]),
        (["run", "wurtz_dodecane", "--policy", "clever"], ["clever", "heuristic"]),
        (["run", "missing/file.toml"], ["missing/file.toml", "no such file"]),
    ],
)
def test_mistakes_are_explained(arguments: list[str], parts: list[str]) -> None:
    """A mistake is one readable message and exit code 2, not a traceback."""
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert all(part in result.output for part in parts)
    assert "Traceback" not in result.output


def test_compare_updates_a_file(tmp_path: Path) -> None:
    """The table goes between the marks and nothing else changes; without marks the file is left alone."""
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- results: begin -->\nold\n<!-- results: end -->\nafter\n")
    arguments = ["compare", "fictitious", "--episodes", "2", "--update", str(page)]
    assert runner.invoke(app, arguments).exit_code == 0
    text = page.read_text()
    assert text.startswith("before\n<!-- results: begin -->\n| scenario")
    assert text.endswith("<!-- results: end -->\nafter\n")
    assert "old" not in text
    assert text.count("`fictitious`") == 2
    page.write_text("no marks")
    assert runner.invoke(app, arguments).exit_code == 2
    assert page.read_text() == "no marks"


def test_starts_can_be_recorded(tmp_path: Path) -> None:
    """Recorded vessels name known materials and goals, and stay below their vessel's capacity."""
    path = tmp_path / "starts.json"
    assert runner.invoke(app, ["starts", "salt_from_oil", "--episodes", "1", "-o", str(path)]).exit_code == 0
    scenario = load_scenario("salt_from_oil")
    benches = json.loads(path.read_text())["benches"]
    assert set(benches) == {"ext", "dit", "submit"}
    for vessels in benches.values():
        assert vessels
        for vessel in vessels:
            assert vessel["goal"] in scenario.goals
            litres = sum(
                mol * scenario.materials[name].molar_mass_g_mol / scenario.materials[name].density_kg_l / 1000.0
                for name, mol in vessel["contents_mol"].items()
            )
            assert 0.0 < litres <= vessel["capacity_l"]


def test_files_survive_a_failed_write(tmp_path: Path) -> None:
    """A write that fails leaves the old file and no litter."""
    path = tmp_path / "kept.txt"
    write_text(path, "kept")
    with pytest.raises(UnicodeEncodeError):
        write_text(path, "\ud800")
    assert path.read_text() == "kept"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match="needs the lines"):
        replace_between(path, "mark", ["x"])


def test_version() -> None:
    """The command and the package agree, however it is called."""
    assert runner.invoke(app, ["--version"]).stdout.strip() == __version__
    module = subprocess.run([sys.executable, "-m", "chemlab", "--version"], capture_output=True, text=True, check=True)
    assert module.stdout.strip() == __version__


def test_where_an_error_comes_from_is_shown_on_request() -> None:
    plain = runner.invoke(app, ["evaluate", "no_such"])
    assert (plain.exit_code, isinstance(plain.exception, SystemExit)) == (2, True)
    assert isinstance(runner.invoke(app, ["--traceback", "evaluate", "no_such"]).exception, DataError)
    assert runner.invoke(app, ["evaluate", "no_such"]).exit_code == 2
