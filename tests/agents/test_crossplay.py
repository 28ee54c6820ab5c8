"""Managers with benches they have not learned with: who plays, what each cell is, what unseen cost."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import command, refused
from run_files import trained
from typer.testing import CliRunner

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.evaluate.benchmark import Row, benchmark
from chemlab.agents.evaluate.crossplay import crossplay, crossplay_count, find_players
from chemlab.agents.evaluate.jobs import AUDIT_SEED, BUDGETS, AuditBudget
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import Run
from chemlab.cli import app
from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from chemlab.record import verify_record

TINY = AuditBudget(episodes=5, plans=20, fewer=5, donors=2, planned=5)
Played = tuple[dict[str, Any], dict[str, Any], Path]


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """A benchmark, crossplay that goes on from its parts, and the folder of parts."""
    keep = tmp_path_factory.mktemp("parts")
    scored = benchmark(["unlabelled"], [Row("scripted", ("scripted",))], TINY, 1, keep=keep)
    spec = load_scenario("unlabelled")
    before = {path: path.stat().st_mtime_ns for path in (keep / "unlabelled").iterdir()}
    managers, benches = find_players(
        spec, ["scripted:unsafe", "scripted"], ["scripted", "scripted@0.2", "scripted:unsafe"]
    )
    seen: list[str] = []
    found = crossplay(spec, managers, benches, TINY, keep=keep / "unlabelled", watch=seen.append)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert len(seen) == crossplay_count(managers, benches, TINY, "test")
    assert len([*(keep / "unlabelled").iterdir()]) == len(before) + 6
    return scored["scenarios"]["unlabelled"], found, keep / "unlabelled"


def cell(found: dict[str, Any], manager: str, benches: str) -> dict[str, Any]:
    return dict(next(one for one in found["cells"] if (one["manager"], one["benches"]) == (manager, benches)))


@pytest.mark.slow
def test_who_plays_with_their_own_is_the_row_of_the_benchmark(played: Played) -> None:
    scored, found, _ = played
    row = scored["cells"]["scripted"]
    assert cell(found, "scripted", "scripted")["score"] == pytest.approx(row["score"], rel=1e-12)
    span = found["oracle"] - found["random"]
    for one in found["cells"]:
        assert one["value"] == pytest.approx((one["score"] - found["random"]) / span, rel=1e-9)
        assert one["value"] <= 1.0


@pytest.mark.slow
def test_a_cell_can_be_played_and_proved(played: Played, tmp_path: Path) -> None:
    """It is its manager over its benches, agent by agent; and what its policy's name stands for."""
    labs = Laboratories("unlabelled", 5, split="test")
    policies = make_policies("scripted@0.2", labs, AUDIT_SEED)
    policies["manager_0"] = make_policies("scripted:unsafe", labs, AUDIT_SEED)["manager_0"]
    scores = play_laboratory(labs, policies, None, AUDIT_SEED).returns
    one = cell(played[1], "scripted:unsafe", "scripted@0.2")
    assert one["score"] == pytest.approx(scores.mean(), rel=1e-12)
    words = ["run", "unlabelled", "--policy", one["policy"], "--split", "test", "--seed", str(AUDIT_SEED)]
    words += ["--episodes", "5", "--json", "--record", str(tmp_path / "a.jsonl")]
    found = [json.loads(line)["score"] for line in CliRunner().invoke(app, words).output.splitlines()]
    assert found == pytest.approx(scores, rel=1e-9)
    assert [verify_record(path).status for path in tmp_path.iterdir()] == ["ok"] * 5


@pytest.mark.slow
def test_a_gap_is_the_partners_score_less_the_mean_of_strangers(played: Played) -> None:
    found = played[1]
    gaps = {(one["side"], one["policy"]): one for one in found["gaps"]}
    assert set(gaps) == {("manager", "scripted"), ("benches", "scripted")}
    one = gaps["manager", "scripted"]
    assert one["unseen"] == ["scripted@0.2", "scripted:unsafe"]
    apart = [cell(found, "scripted", name)["value"] for name in one["unseen"]]
    own = cell(found, "scripted", "scripted")
    assert own["together"]
    assert one["gap"]["value"] == pytest.approx(own["value"] - np.mean(apart), abs=1e-12)
    assert one["gap"]["low"] <= one["gap"]["value"] <= one["gap"]["high"]
    other = gaps["benches", "scripted"]
    assert other["unseen"] == ["scripted:unsafe"]
    expected = own["value"] - cell(found, "scripted:unsafe", "scripted")["value"]
    assert other["gap"]["value"] == pytest.approx(expected, abs=1e-12)


def test_partners_that_learning_had_are_played_too() -> None:
    # The shipped manager of wurtz_dodecane has learned over benches that had learned alone, with nobody.
    scripted, isolated = ("scripted", "scripted"), "pretrained-isolated"
    managers, benches = partners("wurtz_dodecane", ["trained"], ["scripted"])
    assert managers == [("trained", isolated), scripted]
    assert benches == [scripted, (isolated, None)]
    # Benches of wurtz_any have learned in a running laboratory, under the scripted manager.
    managers, benches = partners("wurtz_any", ["scripted:unsafe"], ["pretrained", "pretrained@0.1"])
    assert [name for name, _ in managers] == ["scripted:unsafe", "scripted"]
    assert [partner for _, partner in benches] == ["scripted", None, "scripted"]
    # Bundled managers with notes have the partners of their training.
    assert partners("rush", ["trained"], ["scripted"]) == [[("trained", "scripted"), scripted], [scripted]]


def partners(scenario: str, *names: list[str]) -> list[list[tuple[str, str | None]]]:
    """Names of managers and of benches, with those that they have learned with."""
    return [[(one.name, one.partner) for one in found] for found in find_players(load_scenario(scenario), *names)]


@pytest.mark.slow
def test_runs_are_known_by_their_folders(played: Played, tmp_path: Path) -> None:
    """Two managers with scripted benches behind them, and a run in which everybody has learned."""
    manager = {"roles": "manager", "algo": "maskable-ppo"}
    for seed in (0, 1):
        trained(tmp_path / "runs" / f"seed-{seed}", scenario="unlabelled", seed=seed, **manager)
    trained(tmp_path / "team", scenario="unlabelled", algo="ippo", net_arch=(8,), practice=0.0)
    spec, team = load_scenario("unlabelled"), str(tmp_path / "team")
    managers, benches = find_players(spec, [str(tmp_path / "runs"), team], ["scripted:unsafe", team])
    first = tmp_path / "runs" / "seed-0"
    assert [player.name for player in managers] == [str(first), str(tmp_path / "runs" / "seed-1"), team, "scripted"]
    assert managers[0].policy == str(Run(first).checkpoint("best"))
    assert [player.partner for player in managers] == ["scripted", "scripted", team, "scripted"]
    expected = [("scripted:unsafe", None), (team, team), ("scripted", "scripted")]
    assert [(player.name, player.partner) for player in benches] == expected
    shutil.copytree(played[2], tmp_path / "parts")  # what the scale needs has been played
    found = crossplay(spec, managers, benches, TINY, keep=tmp_path / "parts")
    labs = Laboratories(spec, 5, split="test")
    scores = play_laboratory(labs, make_policies(team, labs, AUDIT_SEED), None, AUDIT_SEED).returns
    assert cell(found, team, team)["score"] == pytest.approx(scores.mean(), rel=1e-12)
    assert cell(found, team, team)["together"]
    assert cell(found, str(first), "scripted")["together"]
    assert not cell(found, str(first), team)["together"]
    unseen = {(one["side"], one["policy"]): one["unseen"] for one in found["gaps"]}
    assert unseen["manager", team] == ["scripted:unsafe", "scripted"]
    assert unseen["manager", str(first)] == ["scripted:unsafe", team]
    with pytest.raises(ValueError, match=r"benches: .*seed-0 has no policy for this side: it plays as 'scripted'"):
        find_players(spec, ["scripted"], [str(first)])
    refused("given twice", find_players, spec, [str(first), str(Run(first).checkpoint("last"))], ["scripted"])


def test_who_cannot_play_is_refused() -> None:
    spec, none = load_scenario("wurtz_dodecane"), "has no policy for this side: it plays as"
    for managers, benches, message in (
        (["pretrained"], ["scripted"], f"manager: pretrained {none} 'scripted'"),
        (["scripted"], ["trained"], f"benches: trained {none} 'pretrained-isolated'"),
        (["scripted,rxn=random"], ["scripted"], "give one policy; benches are given with --benches"),
        (["scripted"], ["scripted,manager=random"], "it plays as 'scripted'; give this name"),
        (["scripted", "scripted"], ["scripted"], "manager: scripted: given twice"),
        (["scripted:fifo"], ["scripted"], "has no orders to choose from"),
        (["scripted"], ["fictitious_rxn"], "does not fit"),
    ):
        refused(message, find_players, spec, managers, benches)


@pytest.mark.slow
def test_the_command(played: Played, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(played[2], tmp_path / "parts")
    monkeypatch.setitem(BUDGETS, "small", TINY)
    words = ["crossplay", "unlabelled", "--manager", "scripted:unsafe", "--manager", "scripted", "--processes", "1"]
    words += [word for name in ("scripted", "scripted@0.2", "scripted:unsafe") for word in ("--benches", name)]
    words += ["--keep", str(tmp_path / "parts"), "--out", str(tmp_path / "found.json")]
    done = CliRunner(env={"COLUMNS": "80"}).invoke(app, words)
    assert max(map(len, done.output.splitlines())) <= 80, done.output
    for text in ("scripted:unsafe", "scripted@0.2", "trained together", "Scores with unseen partners", "gap"):
        assert text in done.output
    written = json.loads((tmp_path / "found.json").read_text())
    assert {**written, "budget": "own"} == json.loads(json.dumps(played[1]))
    assert json.loads(command(*words, "--force", "--json")) == written
