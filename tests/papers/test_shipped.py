"""Shipped bench policies on their benches and in the laboratory: what is stored and what the table says."""

from pathlib import Path

import pytest
from helpers import refused

from chemlab.agents.evaluate.play import evaluate, find_target
from chemlab.agents.pretrained import load_pretrained
from chemlab.agents.runs import RESULT_SEED
from studies.paper import shipped
from studies.paper.shipped import bench_policies, benches_table, collect_benches


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipped, "bench_policies", lambda: [load_pretrained("wurtz_ext")])


def test_bench_policies_are_no_managers() -> None:
    keys = {policy.card.bench for policy in bench_policies()}
    assert {"rxn", "ext", "dit"} <= keys
    assert "fictitious" in {policy.card.scenario for policy in bench_policies()}
    assert "manager" not in keys


@pytest.mark.usefixtures("only")
def test_the_table_is_what_evaluate_says(tmp_path: Path) -> None:
    """Returns on both kinds of starting states, the bench's reward in the laboratory and its score."""
    refused("--collect RUNS makes it", benches_table, tmp_path)
    told: list[str] = []
    collect_benches(tmp_path, 3, told.append)
    assert told == ["wurtz_ext"]
    expected = []
    for starts in ("paper", "lab"):
        target = find_target("chemlab/WurtzExtraction-v0", starts=starts)
        found = evaluate(target, ["wurtz_ext", "scripted"], 3, RESULT_SEED, baseline="wurtz_ext")["policies"]
        expected.append([row["mean"]["value"] for row in found])
    laboratory = find_target("wurtz_dodecane")
    scripted, mixed = evaluate(laboratory, ["scripted,ext=wurtz_ext"], 3, RESULT_SEED)["policies"]
    expected.append([row["measures"]["reward ext_0"] for row in (mixed, scripted)])
    expected.append([row["mean"]["value"] for row in (mixed, scripted)])
    cells = [f"{trained:.3f} ({beside:.3f})" for trained, beside in expected]
    assert benches_table(tmp_path)[2:] == [f"| `wurtz_ext` | paper | {' | '.join(cells)} |"]
    assert expected[0][0] != expected[0][1]
