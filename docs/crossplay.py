"""Write the tables of the committed crossplay into docs/protocol.md: ``python docs/crossplay.py``.

``--play RESULTS SCENARIO ...`` first runs ``chemlab crossplay`` on the finished training runs in RESULTS (see
``docs/baselines.py``), with the scale of the benchmark stored there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from baselines import LEARNERS, PAGE, ROOT, finished, markdown

from chemlab.agents.evaluate.crossplay import PARTNERS
from chemlab.agents.evaluate.statistics import interval_text
from chemlab.config.files import replace_between

__all__ = ["FOLDER", "drops", "found", "matrices"]

FOLDER = ROOT / "docs" / "results" / "crossplay"
_WORDS = {"scripted@0.1": "epsilon-random"}


def found() -> list[dict[str, Any]]:
    """Return the committed crossplay by name of scenario."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.json"))]


def _called(scenario: str, policy: str) -> str:
    """Return a policy's name in the tables."""
    for folder, words in LEARNERS.items():
        learner, _, run = policy.removeprefix(f"{scenario}-").rpartition("/")
        if learner == folder:
            return f"{words}, {run}"
    return _WORDS.get(policy, policy)


def matrices() -> list[str]:
    """Return a matrix of managers by benches for each scenario; bold: trained together or written for one another."""
    lines: list[str] = []
    for one in found():
        scenario = one["scenario"]
        cells = {(cell["manager"], cell["benches"]): cell for cell in one["cells"]}
        managers, benches = ([player["name"] for player in one[side]] for side in ("managers", "benches"))
        rows = [[f"`{scenario}`: manager, by benches", *(_called(scenario, name) for name in benches)]]
        for name in managers:
            own = [cells[name, other] for other in benches]
            bold = ["**" * cell["together"] for cell in own]
            texts = [f"{mark}{interval_text(cell, 2)}{mark}" for mark, cell in zip(bold, own, strict=True)]
            rows.append([_called(scenario, name), *texts])
        lines += [*([""] if lines else []), *markdown(rows)]
    return lines


def drops() -> list[str]:
    """Return scores of learned policies with their own and with unseen partners."""
    rows = [["scenario and who", "with its partner", "with unseen partners", "drop"]]
    for one in found():
        for drop in one["drops"]:
            who = _called(one["scenario"], drop["policy"])
            numbers = [interval_text(drop[key], 2) for key in ("with_partner", "with_unseen", "drop")]
            rows.append([f"`{one['scenario']}`, {drop['side']}: {who}", *numbers])
    return markdown(rows)


def _play(results: Path, scenario: str) -> None:
    """Run the crossplay of every finished training run of a scenario."""
    words = ["crossplay", scenario]
    for name in PARTNERS:
        words += ["--manager", name, "--benches", name]
    for folder in finished(results, scenario):
        learner = folder.removeprefix(f"{scenario}-")
        if not learner.startswith("joint/benches"):
            words += ["--manager", folder]
        if learner.startswith("joint/"):
            words += ["--benches", folder]
    words += ["--budget", "full", "--keep", f"benchmark/parts/{scenario}", "--processes", "1"]
    command = [sys.executable, "-m", "chemlab", *words, "--out", str((FOLDER / f"{scenario}.json").resolve())]
    FOLDER.mkdir(parents=True, exist_ok=True)
    subprocess.run(command, check=True, cwd=results)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--play", type=Path, metavar="RESULTS", help="first play the policies trained there")
    parser.add_argument("scenario", nargs="*", help="scenarios to play (default: the committed ones)")
    asked = parser.parse_args()
    if asked.play is not None:
        for name in asked.scenario or [one["scenario"] for one in found()]:
            _play(asked.play, name)
    replace_between(PAGE, "crossplay", matrices())
    replace_between(PAGE, "drops", drops())
