"""Write the tables of the committed baselines into docs/protocol.md: ``python docs/baselines.py``.

``--play RESULTS [SCENARIO ...]`` first runs ``chemlab benchmark`` and ``chemlab crossplay`` on the managers, teams and
cloned benches trained in RESULTS (``from_nothing.toml`` and ``worlds.toml`` of ``studies/baselines``). Each finished
run plays all episodes and gives one row; of each learner, crossplay takes the first finished run. Played episodes are
kept in ``RESULTS/benchmark``. Its leaderboard starts as a copy of the committed one and is copied back to
``docs/results/leaderboard.json``. Rows of runs that were trained elsewhere or earlier are kept.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from chemlab.agents.evaluate.benchmark import world_scenarios
from chemlab.agents.evaluate.leaderboard import leaderboard_lines
from chemlab.agents.evaluate.statistics import interval_text, mean
from chemlab.agents.runs import find_runs
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between, write_text

__all__ = ["CROSSPLAY", "LEADERBOARD", "PAGE", "clones", "crossplays", "has_row", "matrices", "standings", "table"]

ROOT = Path(__file__).parent.parent
LEADERBOARD = ROOT / "docs" / "results" / "leaderboard.json"
CROSSPLAY = ROOT / "docs" / "results" / "crossplay"
PAGE = ROOT / "docs" / "protocol.md"
LEARNERS = {"from-nothing": "from nothing", "team": "team", "cloned": "clone, then PPO", "benches": "clone, then PPO"}
"""Names of the sweep's runs, and what the tables of crossplay call them."""
_ENDS = ("random", "oracle")
_NAMES = {
    "plan": "best plan",
    "scripted": "scripted",
    "from-nothing (best)": "from nothing",
    "team (best)": "team from nothing",
}
_CLONES = {
    "cloned (first)": "clone",
    "cloned (best)": "clone, then PPO",
    "benches (first)": "benches: clones",
    "benches (best)": "benches: clones, then PPO",
}
_RUN = re.compile(rf"[\w-]+/({'|'.join(LEARNERS)})(?:/seed-\d+)?")
_WITH = ("scripted", "scripted:unsafe", "scripted@0.1")
"""Partners of every policy in crossplay."""


def _lines() -> dict[tuple[str, str], dict[str, Any]]:
    """Return the rows of the leaderboard by scenario and name; runs that differ in their seeds are one row."""
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for line in leaderboard_lines(LEADERBOARD):
        row = _RUN.sub(r"\1", line["policy"])
        found.setdefault((line["scenario"], row), []).append(line)
    return {row: _joined(lines) if len(lines) > 1 else lines[0] for row, lines in found.items()}


def _joined(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the rows of several runs as one, whose interval is over the runs."""
    over = mean([[line["value"] for line in lines]])
    return {**lines[0], "value": over.value, "low": over.low, "high": over.high, "runs": len(lines)}


def _cell(line: dict[str, Any] | None) -> str:
    if line is None or line["value"] is None:
        return ""
    return interval_text(line, 2) + (f" ({line['runs']})" if line["runs"] > 1 else "")


def table() -> list[str]:
    """Return the committed baselines as a Markdown table, with each learner's best checkpoint in validation."""
    lines = _lines()
    rows, numbers = [], (_ENDS[0], *_NAMES.values(), _ENDS[1])
    for scenario in sorted({scenario for scenario, _ in lines}):
        low, high = (f"{lines[scenario, name]['value']:.0f} ({lines[scenario, name]['score']:.3f})" for name in _ENDS)
        rows.append([f"`{scenario}`", low, *(_cell(lines.get((scenario, name))) for name in _NAMES), high])
    return markdown_table({"scenario": False, **dict.fromkeys(numbers, True)}, rows)


def clones() -> list[str]:
    """Return the same of learners that began as clones, before and after reinforcement learning."""
    lines = _lines()
    begun = sorted({scenario for scenario, name in lines if name in _CLONES})
    rows = [[f"`{scenario}`", *(_cell(lines.get((scenario, name))) for name in _CLONES)] for scenario in begun]
    return markdown_table({"scenario": False, **dict.fromkeys(_CLONES.values(), True)}, rows)


def standings() -> dict[str, list[tuple[str, float, str]]]:
    """Return (policy, normalized score, the score with its interval) of each scenario with rows, best first."""
    found: dict[str, list[tuple[str, float, str]]] = {}
    names = {"oracle": "oracle", "random": "random legal play", **_NAMES, **_CLONES}
    for (scenario, row), line in sorted(_lines().items()):
        if line["value"] is not None and not row.endswith("(last)"):
            found.setdefault(scenario, []).append((names.get(row, row), float(line["value"]), _cell(line)))
    return {scenario: sorted(rows, key=lambda row: -row[1]) for scenario, rows in found.items()}


def crossplays() -> list[dict[str, Any]]:
    """Return the committed crossplay by name of scenario."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(CROSSPLAY.glob("*.json"))]


def _called(policy: str) -> str:
    run = _RUN.fullmatch(policy)
    return LEARNERS[run[1]] if run else "epsilon-random" if "@" in policy else policy


def matrices() -> list[str]:
    """Return a matrix of managers by benches for each scenario; bold: trained together or written for one another."""
    lines: list[str] = []
    for one in crossplays():
        cells = {(cell["manager"], cell["benches"]): cell for cell in one["cells"]}
        managers, benches = ([player["name"] for player in one[side]] for side in ("managers", "benches"))
        heads = {f"`{one['scenario']}`: manager, by benches": False, **dict.fromkeys(map(_called, benches), True)}
        rows = []
        for name in managers:
            marks = ["**" * cells[name, other]["together"] for other in benches]
            texts = [interval_text(cells[name, other], 2) for other in benches]
            rows.append([_called(name), *(mark + text + mark for mark, text in zip(marks, texts, strict=True))])
        lines += [*([""] if lines else []), *markdown_table(heads, rows)]
    return lines


def has_row(folder: Path) -> bool:
    """Return True if runs of a folder ``TASK/NAME`` have rows: benches that learned from nothing have no column."""
    return folder.name in LEARNERS and (folder.name != "from-nothing" or folder.parent.name.endswith("-manager"))


def _play(results: Path, scenarios: list[str], budget: str) -> None:
    """Run the benchmark on every finished run, and crossplay where a bench has learned, too."""
    own = results / "benchmark" / "leaderboard.json"
    if LEADERBOARD.exists() and not own.exists():
        own.parent.mkdir(parents=True, exist_ok=True)
        write_text(own, LEADERBOARD.read_text(encoding="utf-8"))
    for scenario in scenarios:
        finished, first = [], []
        for folder in filter(has_row, sorted(results.glob(f"{scenario}-*/*"))):
            runs = [str(run.path.relative_to(results)) for run in find_runs(folder) if run.result() is not None]
            finished += runs
            first += runs[:1]
        policies = [word for name in ("scripted", *finished) for word in ("--policy", name)]
        _chemlab(results, "benchmark", scenario, *policies, "--budget", budget, "--records", "0", "--out", "benchmark")
        managers = [name for name in first if "/benches/" not in name]
        benches = [name for name in first if "/benches/" in name or "/team/" in name]
        if managers and benches:
            sides = {"--manager": [*_WITH, *managers], "--benches": [*_WITH, *benches]}
            words = [word for option, names in sides.items() for name in names for word in (option, name)]
            words += ["--keep", f"benchmark/parts/{scenario}", "--out", str((CROSSPLAY / f"{scenario}.json").resolve())]
            _chemlab(results, "crossplay", scenario, *words, "--budget", budget, "--force")
    write_text(LEADERBOARD, own.read_text(encoding="utf-8"))


def _chemlab(folder: Path, *words: str) -> None:
    subprocess.run([sys.executable, "-m", "chemlab", *words, "--processes", "1"], check=True, cwd=folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--play", type=Path, metavar="RESULTS", help="first play the policies trained there")
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="to play (default: with hidden parameters)")
    parser.add_argument("--budget", default="full", help="of chemlab benchmark (default: %(default)s)")
    asked = parser.parse_args()
    if asked.play is not None:
        _play(asked.play, asked.scenarios or world_scenarios(), asked.budget)
    replace_between(PAGE, "baselines", table())
    replace_between(PAGE, "clones", clones())
    replace_between(PAGE, "crossplay", matrices())
