"""README tells the truth: its Python runs when pasted, and what it names exists."""

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
def test_runs_that_differ_in_their_seeds_are_one_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Its interval is over runs; a single run keeps its own, over episodes."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    import baselines

    told = {"scenario": "runaway", "split": "test", "low": 0.0, "high": 1.0, "runs": 1, "score": 0.5}
    told |= {"scenario_hash": "", "scores": [0.5], "scale": {"random": 0.0, "oracle": 1.0}}
    names = {f"runaway-manager/from-nothing/seed-{seed} (best)": value for seed, value in enumerate((0.2, 0.4, 0.9))}
    names |= {"runaway-rxn/benches/seed-0 (best)": 0.7, "random": 0.0, "scripted": 0.3, "oracle": 1.0}
    lines = [{**told, "policy": policy, "value": value} for policy, value in names.items()]
    (tmp_path / "leaderboard.json").write_text(json.dumps({"lines": lines}), encoding="utf-8")
    monkeypatch.setattr(baselines, "LEADERBOARD", tmp_path / "leaderboard.json")
    ends = stats.ttest_1samp([0.2, 0.4, 0.9], 0.0).confidence_interval(0.95)
    own = f"0.50 [{ends.low:.2f}, {ends.high:.2f}] (3)"
    cells = ["`runaway`", "0 (0.500)", "", "0.30 [0.00, 1.00]", own, "", "1 (0.500)"]
    assert baselines.table()[2] == f"| {' | '.join(cells)} |"
    assert baselines.clones()[2] == "| `runaway` |  |  |  | 0.70 [0.00, 1.00] |"
    names = ["oracle", "benches: clones, then PPO", "from nothing", "scripted", "random legal play"]
    assert [row[0] for row in baselines.standings()["runaway"]] == names


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_tables_of_baselines_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of the scenarios as they are; no score is above the oracle's."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from baselines import LEADERBOARD, PAGE, clones, crossplays, matrices, table

    for rows in (table(), clones(), matrices()):
        assert "\n".join(rows) in PAGE.read_text(encoding="utf-8"), "run: python docs/baselines.py"
    # Lines follow from their scores, as far as these are stored, and records come to what the lines say.
    checks = check_leaderboard(LEADERBOARD)
    assert {(check.scenario, check.policy): check.faults for check in checks if check.faults} == {}
    for line in leaderboard_lines(LEADERBOARD):
        assert line["scenario_hash"] == scenario_hash(load_scenario(line["scenario"]))
        assert line["value"] is None or line["value"] <= 1.0
    for one in crossplays():
        assert one["scenario_hash"] == scenario_hash(load_scenario(one["scenario"]))
        assert len(one["cells"]) == len(one["managers"]) * len(one["benches"])
        assert all(cell["value"] <= 1.0 for cell in one["cells"])
