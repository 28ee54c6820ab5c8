"""README tells the truth: its Python runs when pasted, and what it names exists."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from scipy import stats

from chemlab.agents.evaluate.leaderboard import check_leaderboard, leaderboard_lines
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.record import scenario_hash

README = Path(__file__).parent.parent / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.S)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.strip().splitlines()[-1][:30])
def test_python_runs_when_pasted(block: str, tmp_path: Path) -> None:
    """Each block is a whole program."""
    script = tmp_path / "pasted.py"
    script.write_text(block, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr


def test_results_table_is_complete() -> None:
    """Every shipped scenario has its scripted and its random row."""
    page = (README.parent / "docs" / "results" / "scripted.md").read_text(encoding="utf-8")
    table = page.partition("<!-- results: begin -->")[2].partition("<!-- results: end -->")[0]
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|", table, re.M)
    assert set(rows) == {(name, policy) for name in scenario_names() for policy in ("scripted", "random")}


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_tables_of_audits_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which are of the scenarios as they are: tests/agents/test_audit.py."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from audits import PAGE, table, tasks

    assert "\n".join(table()) in PAGE.read_text(encoding="utf-8"), "run: python docs/audits.py"
    assert "\n".join(tasks()) in TEXT, "run: python docs/audits.py"


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_runs_of_other_sittings_are_one_cell_together(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each seed's line may come from another machine; an interval is over them. A line of as many runs stands."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    import baselines

    common = {"scenario": "runaway", "split": "test", "steps": 10, "hours": 0.5, "over_baseline": None}
    own = [
        {"policy": f"runaway-manager_0/recurrent/seed-{seed} (best)", "runs": 1, "value": value}
        for seed, value in enumerate((0.2, 0.4, 0.9))
    ]
    for run, runs in (("", 2), ("/seed-7", 1)):
        own.append({"policy": f"runaway-joint/benches{run} (best)", "runs": runs, "value": runs})
    for run, runs in (("", 2), ("/seed-0", 1), ("/seed-1", 1), ("/seed-2", 1)):
        own.append({"policy": f"runaway-joint/together{run} (best)", "runs": runs, "value": runs / 4})
    own.append({"policy": "scripted", "runs": 0, "value": 0.3, "steps": None})
    told = {"low": 0.0, "high": 1.0}
    lines = [{**common, **told, **line, "generalization": {"value": line["value"] / 2}} for line in own]
    (tmp_path / "leaderboard.json").write_text(json.dumps({"lines": lines}), encoding="utf-8")
    monkeypatch.setattr(baselines, "LEADERBOARD", tmp_path / "leaderboard.json")
    found = baselines._lines()
    managers, benches = (found["runaway", name] for name in ("manager_0/recurrent (best)", "joint/benches (best)"))
    assert (managers["runs"], managers["hours"], managers["over_baseline"]) == (3, 1.5, None)
    assert managers["value"] == pytest.approx(0.5)
    assert managers["generalization"]["value"] == pytest.approx(0.25)
    ends = stats.ttest_1samp([0.2, 0.4, 0.9], 0.0).confidence_interval(0.95)
    assert (managers["low"], managers["high"]) == pytest.approx((ends.low, ends.high))
    assert (benches["runs"], benches["value"]) == (2, 2)
    team = found["runaway", "joint/together (best)"]
    assert (team["runs"], team["hours"], team["value"]) == (3, 1.5, 0.25)
    # All scenarios together, the best first: two of the three managers' runs are above the scripted agents.
    monkeypatch.setattr(baselines, "world_scenarios", lambda: ["runaway"])
    assert [row.split(" | ")[0] for row in baselines.overall()[2:]] == [
        "| benches",
        "| recurrent PPO",
        "| scripted",
        "| IPPO",
    ]
    _, runs, average, middle, above = baselines.overall()[3].strip("| ").split(" | ")
    assert (runs, average[:4], middle[:4], above[:4]) == ("3", "0.50", "0.50", "0.67")


def says_version_1(page: Path) -> bool:
    """Whether a page says that its results are of scenarios as they were; else they have to be of those that are."""
    return "All results on this page are for version 1 of the scenarios." in page.read_text(encoding="utf-8")


def test_tables_of_baselines_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of the scenarios as they are; nobody knows more than who knows the world."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from baselines import LEADERBOARD, PAGE, effort, overall, shipped, table

    for rows in (table(), overall(), effort(), shipped()):
        assert "\n".join(rows) in PAGE.read_text(encoding="utf-8"), "run: python docs/baselines.py"
    # Lines follow from their scores, as far as these are stored, and records come to what the lines say.
    checks = check_leaderboard(LEADERBOARD)
    assert {(check.scenario, check.policy): check.faults for check in checks if check.faults} == {}
    lines = leaderboard_lines(LEADERBOARD)
    for line in lines:
        assert line["scenario_hash"] == scenario_hash(load_scenario(line["scenario"])) or says_version_1(PAGE)
        assert line["value"] is None or line["value"] <= 1.0


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_tables_of_crossplay_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of the scenarios as they are; every manager with all the benches."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from crossplay import PAGE, drops, found, matrices

    for rows in (matrices(), drops()):
        assert "\n".join(rows) in PAGE.read_text(encoding="utf-8"), "run: python docs/crossplay.py"
    for one in found():
        assert one["scenario_hash"] == scenario_hash(load_scenario(one["scenario"])) or says_version_1(PAGE)
        assert len(one["cells"]) == len(one["managers"]) * len(one["benches"])
        assert all(cell["value"] <= 1.0 for cell in one["cells"])
