"""README tells the truth: its Python runs when pasted, and what it names exists."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from chemlab.agents.evaluation.benchmark import leaderboard_lines
from chemlab.record import scenario_hash
from chemlab.scenario import load_scenario, scenario_names

README = Path(__file__).parent.parent / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, re.S)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.strip().splitlines()[-1][:30])
def test_python_runs_when_pasted(block: str, tmp_path: Path) -> None:
    """Each block is a whole program."""
    script = tmp_path / "pasted.py"
    script.write_text(block, encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_two_commands() -> None:
    """One block installs and runs, one installs and tests; CI runs these very lines."""
    blocks = re.findall(r"```bash\n# (\w+)\n(.*?)```", TEXT, re.S)
    commands = dict(blocks)
    assert "pip install" in commands["run"]
    assert "chemlab run" in commands["run"]
    assert "pip install" in commands["test"]
    assert "pytest" in commands["test"]


def test_results_table_is_complete() -> None:
    """Every shipped scenario has its heuristic and its random row."""
    table = TEXT.partition("<!-- results: begin -->")[2].partition("<!-- results: end -->")[0]
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \|", table, re.M)
    assert set(rows) == {(name, policy) for name in scenario_names() for policy in ("heuristic", "random")}


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_tables_of_audits_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which are of the scenarios as they are: tests/agents/test_audit.py."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from audits import PAGES, table

    for page in PAGES:
        assert "\n".join(table()) in page.read_text(encoding="utf-8"), "run: python docs/audits.py"


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_tables_of_baselines_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of the scenarios as they are; nobody knows more than who knows the world."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from baselines import LEADERBOARD, PAGE, effort, shipped, table

    for rows in (table(), effort(), shipped()):
        assert "\n".join(rows) in PAGE.read_text(encoding="utf-8"), "run: python docs/baselines.py"
    for line in leaderboard_lines(LEADERBOARD):
        assert line["scenario_hash"] == scenario_hash(load_scenario(line["scenario"])), "play it again: --play"
        assert line["value"] is None or line["value"] <= 1.0


@pytest.mark.skipif(not (README.parent / "docs").is_dir(), reason="not a checkout")
def test_tables_of_crossplay_are_those_of_the_stored_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of the scenarios as they are; every manager with all the benches."""
    monkeypatch.syspath_prepend(str(README.parent / "docs"))
    from crossplay import PAGE, drops, found, matrices

    for rows in (matrices(), drops()):
        assert "\n".join(rows) in PAGE.read_text(encoding="utf-8"), "run: python docs/crossplay.py"
    for one in found():
        assert one["scenario_hash"] == scenario_hash(load_scenario(one["scenario"])), "play it again: --play"
        assert len(one["cells"]) == len(one["managers"]) * len(one["benches"])
        assert all(cell["value"] <= 1.0 for cell in one["cells"])
