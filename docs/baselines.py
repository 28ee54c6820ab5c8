"""Write the tables of the committed baselines into docs/protocol.md: ``python docs/baselines.py``.

``--play RESULTS [SCENARIO ...]`` first runs ``chemlab benchmark`` on the trained policies in RESULTS
(``studies/baselines/worlds.toml``, ``worlds_benches.sh``, ``worlds_joint.sh``). Each finished run of each learner and
scenario plays all episodes and gives one row. Played episodes are kept in ``RESULTS/benchmark``. Its leaderboard starts
as a copy of the committed one and is copied back to ``docs/results/leaderboard.json``; records of bundled policies go
to ``docs/results/records``. Rows of runs that were trained elsewhere or earlier are kept.

``--scores [SCENARIO ...]`` replays the rows that need neither training nor search (random legal actions, scripted
agents, bundled policies) and stores the score of each episode in the committed rows, whose values change with the
scores. ``chemlab verify docs/results/leaderboard.json`` recomputes them.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from rerecord import record_again

from chemlab import load_scenario
from chemlab.agents.evaluate.benchmark import world_scenarios
from chemlab.agents.evaluate.jobs import AUDIT_SEED, Crew, Job, budget_of
from chemlab.agents.evaluate.leaderboard import leaderboard_lines, write_leaderboard
from chemlab.agents.evaluate.statistics import interquartile_mean, interval_text, mean, paired_improvement
from chemlab.agents.runs import find_runs
from chemlab.config.files import replace_between, write_text
from chemlab.record import read_record

__all__ = [
    "LEADERBOARD",
    "LEARNERS",
    "PAGE",
    "REPLAYED",
    "ROOT",
    "add_scores",
    "effort",
    "finished",
    "markdown",
    "overall",
    "shipped",
    "standings",
    "table",
]

ROOT = Path(__file__).parent.parent
LEADERBOARD = ROOT / "docs" / "results" / "leaderboard.json"
PAGE = ROOT / "docs" / "protocol.md"
_ENDS = ("random", "oracle")
_SCRIPTED = {"plan": "best plan", "scripted": "scripted"}
LEARNERS = {
    "manager_0/feedforward": "PPO",
    "manager_0/recurrent": "recurrent PPO",
    "manager_0/advised": "PPO with advice",
    "joint/benches": "benches",
    "manager_0/over-benches": "recurrent PPO over benches",
    "manager_0/advised-over-benches": "PPO with advice over benches",
    "joint/together": "IPPO",
    "joint/together-state": "MAPPO",
}
"""Folders of runs below RESULTS/SCENARIO, and their names in the tables."""
_ELSEWHERE = ("manager_0/over-benches",)
"""Learners of two scenarios only, which appear only in the table of training effort."""
_EVERYWHERE = {f"{folder} (best)": name for folder, name in LEARNERS.items() if folder not in _ELSEWHERE}
_KINDS = ("best", "last")
_SEED = re.compile(r"/seed-\d+(?= \()")
_SHIPPED = ("pretrained", "trained")
REPLAYED = ("random", "scripted", *_SHIPPED)
"""Rows that can be replayed without training or search."""


def _runs() -> dict[tuple[str, str], list[dict[str, Any]]]:
    """Return the rows of the committed leaderboard by scenario and name (``LEARNERS``), one per training run.

    For a folder whose runs shared the episodes, only its common row is returned.
    """
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for line in leaderboard_lines(LEADERBOARD):
        row = _SEED.sub("", line["policy"].removeprefix(f"{line['scenario']}-"))
        found.setdefault((line["scenario"], row), []).append(line)
    for row, lines in found.items():
        most = max(lines, key=lambda line: line["runs"])
        single = [line for line in lines if line["runs"] == 1]
        found[row] = single if len(single) > most["runs"] else [most]
    return found


def scored() -> list[str]:
    """Return the scenarios with hidden parameters that have rows."""
    names = {scenario for scenario, _ in _runs()}
    return [name for name in world_scenarios() if name in names]


def _lines() -> dict[tuple[str, str], dict[str, Any]]:
    """Return the rows with runs that differ only in their seeds merged into one; intervals are over runs."""
    return {row: _joined(lines) if len(lines) > 1 else lines[0] for row, lines in _runs().items()}


def _joined(lines: list[dict[str, Any]]) -> dict[str, Any]:
    told = {
        key: _over_runs([line[key] for line in lines]) if all(line.get(key) for line in lines) else None
        for key in ("over_baseline", "generalization")
    }
    hours = sum(line["hours"] for line in lines)
    return {**lines[0], **_over_runs(lines), **told, "runs": len(lines), "hours": hours}


def _over_runs(estimates: list[dict[str, Any]]) -> dict[str, Any]:
    found = mean([[one["value"] for one in estimates]])
    return {key: getattr(found, key) for key in ("value", "low", "high")}


def _cell(line: dict[str, Any] | None) -> str:
    if line is None or line["value"] is None:
        return ""
    runs = f" ({line['runs']})" if line["steps"] else ""
    return interval_text(line, 2) + runs


def markdown(rows: list[list[str]]) -> list[str]:
    """Return the lines of a table; the first row is the head, the first column text, the others numbers."""
    head, *body = rows
    return [f"| {' | '.join(row)} |" for row in [head, ["---"] + ["--:"] * (len(head) - 1), *body]]


def table() -> list[str]:
    """Return the committed baselines as a Markdown table, with the best learner by validation score."""
    lines = _lines()
    names = {**_SCRIPTED, **_EVERYWHERE, "people": "people"}
    rows = [["scenario", _ENDS[0], *names.values(), _ENDS[1]]]
    for scenario in scored():
        low, high = (f"{lines[scenario, name]['value']:.0f} ({lines[scenario, name]['score']:.3f})" for name in _ENDS)
        rows.append([f"`{scenario}`", low, *(_cell(lines.get((scenario, name))) for name in names), high])
    return markdown(rows)


def standings() -> dict[str, list[tuple[str, float, str]]]:
    """Return (policy, normalized score, the score with its interval) of each scenario with rows, best first."""
    lines = _lines()
    names = {"oracle": "oracle", "random": "random legal play", **_SCRIPTED, **{name: name for name in _SHIPPED}}
    found = {}
    for scenario in scored():
        rows = [
            (words, float(lines[scenario, row]["value"]), _cell(lines[scenario, row]))
            for row, words in {**names, **_EVERYWHERE}.items()
            if lines.get((scenario, row), {}).get("value") is not None
        ]
        found[scenario] = sorted(rows, key=lambda row: -row[1])
    return found


def overall() -> list[str]:
    """Return scores over all scenarios with equal weights, of policies present in every scenario, best first.

    Intervals are over runs within scenarios; if a scenario has a single row there are none. Interquartile means need
    equally many runs in each.
    """
    runs, scenarios = _runs(), scored()
    scripted = [runs[scenario, "scripted"][0]["value"] for scenario in scenarios]
    found = []
    for name, called in {**dict(zip(_ENDS, _ENDS, strict=True)), **_SCRIPTED, **_EVERYWHERE}.items():
        cells = [runs[scenario, name] for scenario in scenarios if (scenario, name) in runs]
        if len(cells) < len(scenarios):
            continue
        samples = [[line["value"] for line in cell] for cell in cells]
        counts = sorted({sum(line["runs"] for line in cell) for cell in cells if cell[0]["steps"]})
        beside = [[value] * len(sample) for value, sample in zip(scripted, samples, strict=True)]
        even = len({len(sample) for sample in samples}) == 1
        average, middle = mean(samples), interquartile_mean(samples) if even else None
        estimates = (average, middle, paired_improvement(samples, beside))
        texts = [interval_text(one.as_dict(), 2) if one else "" for one in estimates]
        found.append((average.value, [called, "-".join(map(str, counts)), *texts]))
    found.sort(key=lambda one: -one[0])
    return markdown(
        [["who", "runs in each", "mean", "interquartile mean", "above scripted"], *(row for _, row in found)]
    )


def effort() -> list[str]:
    """Return the training effort of each learner, the score of its last checkpoint and its score in training worlds."""
    lines = _lines()
    heads = ["runs", "steps of each", "hours in all", *_KINDS, "best, less scripted", "test less train (best)"]
    rows = [["scenario and learner", *heads]]
    for scenario in scored():
        for folder, name in LEARNERS.items():
            best, last = (lines.get((scenario, f"{folder} ({kind})")) for kind in _KINDS)
            if best is None or last is None:
                continue
            gap = best["generalization"] or {"value": float("nan")}
            numbers = [str(best["runs"]), f"{best['steps']:,}", f"{best['hours']:.2f}"]
            scores = [f"{one['value']:.2f}" for one in (best, last)]
            over = best.get("over_baseline")  # older rows have no such entry
            more = interval_text(over, 3, "+") if over else ""
            rows.append([f"`{scenario}`, {name}", *numbers, *scores, more, f"{gap['value']:+.2f}"])
    return markdown(rows)


def shipped() -> list[str]:
    """Return the table of bundled trained policies: benches (pretrained), benches and a manager (trained)."""
    lines = _lines()
    rows = [["scenario", "scripted", *_SHIPPED, *(f"{name} / scripted" for name in _SHIPPED)]]
    for scenario in scored():
        scripted, *others = (lines.get((scenario, name)) for name in ("scripted", *_SHIPPED))
        if scripted is None or not any(_cell(one) for one in others):
            continue
        above = scripted["value"] is not None and scripted["value"] > 0.0
        ratios = [f"{one['value'] / scripted['value']:.2f}" if above and one and _cell(one) else "" for one in others]
        rows.append([f"`{scenario}`", *map(_cell, (scripted, *others)), *ratios])
    return markdown(rows)


def finished(results: Path, scenario: str) -> list[str]:
    """Return folders of finished runs below ``results``; print the unfinished ones."""
    chosen = []
    for folder in (f"{scenario}-{learner}" for learner in LEARNERS):
        runs = find_runs(results / folder) if (results / folder).is_dir() else []
        chosen += [str(run.path.relative_to(results)) for run in runs if run.result() is not None]
        for run in runs:
            if run.result() is None:
                print(f"{run.path.relative_to(results)}: unfinished", flush=True)
        if not runs:
            print(f"{folder}: not begun", flush=True)
    return chosen


def _play(results: Path, scenarios: list[str], budget: str) -> None:
    """Run the benchmark on every finished run; rows of other policies stay in the table."""
    own = results / "benchmark" / "leaderboard.json"
    if LEADERBOARD.exists() and not own.exists():
        own.parent.mkdir(parents=True, exist_ok=True)
        write_text(own, LEADERBOARD.read_text(encoding="utf-8"))
    for scenario in scenarios:
        chosen = [word for folder in finished(results, scenario) for word in ("--policy", folder)]
        along = [word for name in ("scripted", *_SHIPPED) for word in ("--policy", name)]
        # Records of bundled policies are stored beside the table.
        for policies, records in ((chosen + along, "0"), (along, "1")):
            words = ["benchmark", scenario, *policies, "--budget", budget, "--records", records, "--processes", "1"]
            command = [sys.executable, "-m", "chemlab", *words, "--out", "benchmark"]
            subprocess.run(command, check=True, cwd=results)
        kept = Path("records") / scenario
        shutil.rmtree(LEADERBOARD.parent / kept, ignore_errors=True)
        shutil.copytree(own.parent / kept, LEADERBOARD.parent / kept)
    write_text(LEADERBOARD, own.read_text(encoding="utf-8"))


def add_scores(scenarios: list[str]) -> None:
    """Replay the rows that need neither training nor search, and store the scores of their episodes.

    If the mean has changed (another processor, changed physics), the row's value and interval are shifted by the
    difference. A changed mean of random play shifts all rows of its scenario. Records of changed episodes are replayed.
    """
    lines = leaderboard_lines(LEADERBOARD)
    for line in lines:
        if line["scenario"] not in scenarios or line["policy"] not in REPLAYED or line["value"] is None:
            continue
        begun, was = time.process_time(), line["score"]
        played = {split: _replayed(line, split) for split in dict.fromkeys((line["split"], "train"))}
        line["scores"] = played[line["split"]]
        line["score"] = math.fsum(line["scores"]) / len(line["scores"])
        if line["generalization"] is not None:
            line["train_scores"] = played["train"]
        seconds = time.process_time() - begun
        print(f"{line['scenario']}, {line['policy']}: {was:.6f} -> {line['score']:.6f}, {seconds:.0f} s", flush=True)
    for scenario in scenarios:
        own = [line for line in lines if line["scenario"] == scenario and line["value"] is not None]
        zero = next((line["score"] for line in own if line["policy"] == "random" and line.get("scores")), None)
        shifts = {line["policy"]: _move(line, zero) for line in own}
        for line in own:
            over = line.get("over_baseline")
            if over and over.get("value") is not None:
                _shift(over, shifts[line["policy"]] - shifts.get(line.get("baseline") or "", 0.0))
        for line in own:
            for entry in line["records"]:
                entry["score"] = _recorded(LEADERBOARD.parent / entry["file"], line, entry["seed"])
    write_leaderboard(LEADERBOARD, lines)


def _move(line: dict[str, Any], zero: float | None) -> float:
    """Update a row's value and interval for its mean score and the scale's zero; return the change."""
    scale = line["scale"]
    scale["random"] = scale["random"] if zero is None else zero
    value = (line["score"] - scale["random"]) / (scale["oracle"] - scale["random"])
    change = value - line["value"]
    _shift(line, change)
    line["value"] = value
    return float(change)


def _shift(estimate: dict[str, Any], change: float) -> None:
    estimate.update({key: estimate[key] + change for key in ("value", "low", "high") if estimate[key] is not None})


def _recorded(file: Path, line: dict[str, Any], seed: int) -> float:
    """Return the score of a row's record; re-record it if its actions now give another score."""
    if record_again(file, changed=line["policy"] == "plan"):
        words = ["run", line["scenario"], "--policy", line["policy"], "--split", line["split"], "--seed", str(seed)]
        command = [sys.executable, "-m", "chemlab", *words, "--record", str(file), "--force", "--json"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    end = read_record(file).end
    assert end is not None, f"{file} is whole"
    return float(end["end"]["score"])


def _replayed(line: dict[str, Any], split: str) -> list[float]:
    """Return a row's scores in the parts in which the benchmark plays them."""
    spec, budget = load_scenario(line["scenario"]), budget_of(line["budget"])
    parts = np.array_split(np.arange(budget.episodes), 1 if line["policy"] == "random" else line["seeds"])
    jobs = [
        Job(
            f"{part[0]}",
            "play",
            {"policy": line["policy"], "seed": AUDIT_SEED + int(part[0]), "episodes": len(part), "split": split},
        )
        for part in parts
    ]
    found = Crew(spec, budget).run(jobs)
    return [score for job in jobs for score in found[job.name]["scores"]]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--play", type=Path, metavar="RESULTS", help="first play the policies trained there")
    parser.add_argument("--scores", action="store_true", help="replay rows without training runs")
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="to play (default: with hidden parameters)")
    parser.add_argument("--budget", default="full", help="of chemlab benchmark (default: %(default)s)")
    asked = parser.parse_args()
    if asked.play is not None:
        _play(asked.play, asked.scenarios or world_scenarios(), asked.budget)
    if asked.scores:
        add_scores(asked.scenarios or world_scenarios())
    replace_between(PAGE, "baselines", table())
    replace_between(PAGE, "overall", overall())
    replace_between(PAGE, "effort", effort())
    replace_between(PAGE, "shipped", shipped())
