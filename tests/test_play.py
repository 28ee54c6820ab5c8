"""chemlab play and chemlab export demos, as people meet them."""

from pathlib import Path
from unittest.mock import Mock

import pytest
from typer.testing import CliRunner

from chemlab.cli import app
from chemlab.record import read_record, verify_record

runner = CliRunner()
SCRIPT = ["start rxn_0 on slot 0, goal dodecane", "wait", "measure slot 0 with gas", "submit slot 0"]


def play(path: Path, lines: list[str], *options: str) -> tuple[int, str]:
    """Play with these lines typed; (exit code, what was shown)."""
    arguments = ["play", "wurtz_dodecane", "--record", str(path), "--seed", "4", *options]
    done = runner.invoke(app, arguments, input="\n".join(lines) + "\n")
    return done.exit_code, done.output


def test_a_whole_episode_is_a_record_like_any_other(tmp_path: Path) -> None:
    path = tmp_path / "mine.jsonl"
    code, shown = play(path, SCRIPT)
    assert code == 0, shown
    assert "The episode is over: submitted" in shown
    assert "(meanwhile: rxn_0 20x)" in shown
    assert "experiment over" not in shown  # the score of somebody else's experiment is not the manager's to know
    assert verify_record(path).status == "ok"
    record = read_record(path)
    assert record.header["policies"] == dict.fromkeys(record.header["agents"], "scripted") | {"manager_0": "human"}
    decided = [turn["play"]["manager_0"][1] for turn in record.turns if "manager_0" in turn["play"]]
    assert len(decided) == len(SCRIPT)
    assert runner.invoke(app, ["verify", str(path)]).exit_code == 0


def test_a_person_at_a_bench(tmp_path: Path) -> None:
    path = tmp_path / "bench.jsonl"
    code, shown = play(path, ["T+ V- 1-chlo=1 Na=1", *[""] * 19], "--role", "rxn")
    assert code == 0, shown
    assert "experiment over: +" in shown
    record = read_record(path)
    mine = [turn["play"]["rxn_0"][1] for turn in record.turns if "rxn_0" in turn["play"]]
    assert mine == [[1.0, 0.0, 1.0, 0.0, 0.0, 1.0]] * 20
    assert verify_record(path).status == "ok"


def test_leaving_keeps_the_record_so_far(tmp_path: Path) -> None:
    for number, last in enumerate((["q"], ["Quit"], [])):
        path, part = tmp_path / f"{number}.jsonl", tmp_path / f"{number}.jsonl.part"
        code, shown = play(path, [*SCRIPT[:2], *last])
        assert (code, path.exists()) == (0, False)
        assert part.name in shown
        assert verify_record(part).status == "torn"
        assert len(read_record(part).turns) == 22  # start, wait, 20 steps of the reaction


def test_the_keyboards_interrupt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rich.console.Console.input", Mock(side_effect=KeyboardInterrupt))
    code, shown = play(tmp_path / "stopped.jsonl", [])
    assert code == 130
    assert "interrupted" in shown


def test_all_roles_and_other_backgrounds(tmp_path: Path) -> None:
    code, shown = play(tmp_path / "all.jsonl", ["submit slot 0"], "--role", "all", "--background", "scripted:unsafe")
    assert code == 0
    assert "You play manager_0, rxn_0, ext_0, dit_0" in shown


def test_with_hidden_parameters_people_are_told_no_exact_scores_and_amounts() -> None:
    arguments = ["play", "unlabelled", "--role", "rxn"]
    shown = runner.invoke(app, arguments, input="\n".join(["T+ V-", *[""] * 19, "q"])).output
    assert "experiment over\n" in shown
    assert "safety: relief valve\n" in shown
