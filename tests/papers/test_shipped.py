"""Shipped bench policies on their benches and in the laboratory: what is stored and what the table says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from chemlab.agents.evaluation import benches
from chemlab.agents.evaluation.benches import bench_policies, benches_table, collect_benches
from chemlab.agents.evaluation.play import evaluate, find_target
from chemlab.agents.pretrained import load_pretrained


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benches, "bench_policies", lambda: [load_pretrained("wurtz_ext")])


def test_bench_policies_are_no_managers() -> None:
    keys = {policy.card.bench for policy in bench_policies()}
    assert {"rxn", "ext", "dit"} <= keys
    assert "fictitious" in {policy.card.scenario for policy in bench_policies()}
    assert "manager" not in keys


@pytest.mark.usefixtures("only")
def test_what_is_stored_is_what_evaluate_says(tmp_path: Path) -> None:
    told: list[str] = []
    content = collect_benches(tmp_path, 3, told.append)
    assert told == ["wurtz_ext"]
    assert json.loads((tmp_path / "benches.json").read_text()) == content
    (row,) = content["policies"]
    for starts in ("paper", "lab"):
        target = find_target("chemlab/WurtzExtraction-v0", starts=starts)
        trained, scripted = evaluate(target, ["wurtz_ext", "heuristic"], 3, content["seed"], baseline="wurtz_ext")[
            "policies"
        ]
        assert row["trained"][starts] == pytest.approx(trained["mean"]["value"], abs=1e-12)
        assert row["scripted"][starts] == pytest.approx(scripted["mean"]["value"], abs=1e-12)
    laboratory = find_target("wurtz_dodecane")
    scripted, mixed = evaluate(laboratory, ["heuristic,ext=wurtz_ext"], 3, content["seed"])["policies"]
    for column, found in (("trained", mixed), ("scripted", scripted)):
        assert row[column]["score"] == pytest.approx(found["mean"]["value"], abs=1e-12)
        assert row[column]["reward"] == pytest.approx(found["measures"]["reward ext_0"], abs=1e-12)
    assert row["trained"]["paper"] != row["scripted"]["paper"]


@pytest.mark.usefixtures("only")
def test_the_table_has_a_line_for_each_policy(tmp_path: Path) -> None:
    (row,) = collect_benches(tmp_path, 1)["policies"]
    _, _, line = benches_table(tmp_path)
    assert line.startswith("| `wurtz_ext` | paper | ")
    assert f"{row['trained']['lab']:.3f} ({row['scripted']['lab']:.3f})" in line


def test_a_table_needs_its_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="--collect makes it"):
        benches_table(tmp_path)
    (tmp_path / "benches.json").write_text("{}")
    with pytest.raises(ValueError, match=r"benches\.json: not what"):
        benches_table(tmp_path)
