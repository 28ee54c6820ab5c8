"""The paper's results beside ours: a table of its statements, and a table of every experiment and algorithm."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.files import write_text

from . import statistics
from .figures import FIGURES
from .play import versions
from .results import EXPERIMENTS, Cell, Results, display_name
from .statistics import interval_text, number_text

__all__ = ["Statement", "compare_with_paper", "describe_cells", "paper_table", "write_summary"]

_CLOSE = 0.9
"""Share of the scripted policy's return that the paper's "nearly match" and "come close" are read as."""
_MATCH = 0.97
"""Share that "match" is read as."""
_ZERO = 0.02
"""Returns within this of 0 are read as zero."""
_SALT = ("without NaCl", "with NaCl")


@dataclass(frozen=True)
class Statement:
    """Something the paper says, and what we found.

    Attributes:
        figure: number of the paper's figure it belongs to.
        says: the statement.
        paper: its number, or what it comes to.
        source: where it stands: in the text or in a figure's caption; no number is read off a picture.
        ours: what we found.
        holds: whether ours agrees by ``criterion``; None where results are missing.
        criterion: what agreeing means.
    """

    figure: int
    experiment: str
    says: str
    paper: str
    source: str
    ours: str
    holds: bool | None
    criterion: str


Finding = tuple[str, bool | None]
_NOTHING: Finding = ("no results", None)


def _heuristic(results: Results, key: str) -> float | None:
    traced = results.trace(key, "heuristic")
    if traced is not None:
        return float(traced["mean_return"])
    known = [value for cell in results.cells[key].values() if (value := cell.heuristic_mean()) is not None]
    return float(np.mean(known)) if known else None


def _near(value: float | None, paper: float, tolerance: float = 0.02) -> Finding:
    return _NOTHING if value is None else (f"{value:.3f}", abs(value - paper) <= tolerance)


def _random(results: Results, key: str) -> float | None:
    traced = results.trace(key, "random")
    return None if traced is None else float(traced["mean_return"])


def _of_cell(results: Results, key: str, label: str, find: Callable[[Cell], Finding]) -> Finding:
    cell = results.cell(key, label)
    return _NOTHING if cell is None else find(cell)


def _named(findings: Mapping[str, Finding]) -> list[Finding]:
    return [(f"{display_name(label)}: {text}", holds) for label, (text, holds) in findings.items()]


def _all_of(findings: Sequence[Finding]) -> Finding:
    """Several findings as one, which holds if all of them do."""
    verdicts = [holds for _, holds in findings]
    return "; ".join(text for text, _ in findings), None if None in verdicts else all(verdicts)


def _ppo(results: Results, key: str, find: Callable[[str], Finding]) -> Finding:
    """PPO and its variants as one finding, which holds if it does for any that was trained."""
    findings = _named({label: find(label) for label in results.variants(key, "ppo")})
    known = [(text, holds) for text, holds in findings if holds is not None]
    return "; ".join(t for t, _ in known) or findings[0][0], any(holds for _, holds in known) if known else None


def _goals_of(cell: Cell) -> list[str]:
    return list(cell.best.result.by_goal)


def _best_ratios(cell: Cell) -> dict[str, float]:
    """Relative return of the best run for each goal."""
    index = cell.runs.index(cell.best)
    return {goal: float(cell.relative(goal)[index]) for goal in _goals_of(cell)}


def _mean_ratios(cell: Cell) -> dict[str, float]:
    return {goal: float(cell.relative(goal).mean()) for goal in _goals_of(cell)}


def _least(ratios: dict[str, float], at_least: float) -> Finding:
    goal = min(ratios, key=lambda name: ratios[name])
    reached = sum(value >= at_least for value in ratios.values())
    text = f"{reached} of {len(ratios)} goals at {at_least:g} or more, least {ratios[goal]:.3f} ({goal})"
    return text, reached == len(ratios)


def _reached(ratios: dict[str, float], expected: Callable[[set[str]], bool]) -> Finding:
    goals = {goal for goal, value in ratios.items() if value >= _CLOSE}
    return f"{len(goals)} of {len(ratios)} goals ({', '.join(sorted(goals)) or 'none'})", expected(goals)


def _training_end(cell: Cell, holds: Callable[[float], bool]) -> Finding:
    finals = cell.final_training_returns()
    return _NOTHING if not len(finals) else (f"{finals.mean():.3f}", holds(float(finals.mean())))


def _converged(cell: Cell) -> Finding:
    """The evaluation from which on the mean over runs stays within a twentieth of the last one's.

    Evaluations have every goal equally often. In training, chance alone moves the mean by more than a twentieth, since
    returns differ most by goal.
    """
    runs = [run.run.evaluations() for run in cell.runs]
    count = min(len(run) for run in runs)
    if count < 2:
        return _NOTHING
    mean = np.mean([[evaluation.mean for evaluation in run[:count]] for run in runs], axis=0)
    away = np.flatnonzero(np.abs(mean - mean[-1]) > 0.05 * abs(mean[-1]))
    first = 0 if not len(away) else int(away[-1]) + 1
    step = runs[0][first].step
    # Runs that end there cannot show that nothing comes after it.
    holds = step < 300_000 and first < count - 1 if cell.steps >= 600_000 else None
    return f"by {step / 1000:.0f}k of {cell.steps / 1000:.0f}k steps", holds


def _gain(cell: Cell, at_least: float) -> Finding:
    reference = cell.heuristic_mean()
    if reference is None:
        return _NOTHING
    gains = cell.means() - reference
    return f"{gains.mean():+.3f} (best run {gains.max():+.3f})", bool(gains.mean() >= at_least)


def _case_ratios(results: Results, key: str, label: str) -> dict[str, float] | None:
    """Return over the scripted policy's with and without salt, mean over the goals that meet salt."""
    ours, reference = results.trace(key, label), results.trace(key, "heuristic")
    if ours is None or reference is None:
        return None
    ratios = {}
    for case in _SALT:
        pairs = [
            (goal["by_case"][case]["mean_return"], reference["by_goal"][name]["by_case"][case]["mean_return"])
            for name, goal in ours["by_goal"].items()
            if case in goal["by_case"] and case in reference["by_goal"][name]["by_case"]
        ]
        if not pairs:
            return None
        ratios[case] = sum(a for a, _ in pairs) / sum(b for _, b in pairs)
    return ratios


def _cases(results: Results, label: str, holds: Callable[[float, float], bool]) -> Finding:
    ratios = _case_ratios(results, "wurtz_dit", label)
    if ratios is None:
        return _NOTHING
    without, salted = ratios[_SALT[0]], ratios[_SALT[1]]
    return f"{without:.3f} without, {salted:.3f} with salt", holds(without, salted)


def _ends(results: Results, key: str, label: str, case: str, expected: bool) -> Finding:
    """Whether the best sequence for dodecane ends the experiment itself."""
    traced = results.trace(key, label)
    entry = None if traced is None else traced["by_goal"]["dodecane"]["by_case"].get(case)
    if entry is None or results.traces is None:
        return _NOTHING
    names = results.traces["experiments"][key]["action_names"]
    ends = names[entry["best"]["actions"][-1]].startswith("end")
    return ("ends it" if ends else "runs to the limit"), ends == expected


def compare_with_paper(results: Results) -> list[Statement]:
    """The paper's statements about its results, each beside what these results say."""
    rows: list[Statement] = []

    def add(figure: int, key: str, says: str, paper: str, source: str, found: Finding, criterion: str) -> None:
        rows.append(Statement(figure, EXPERIMENTS[key].title, says, paper, source, found[0], found[1], criterion))

    def among(key: str, labels: Iterable[str], find: Callable[[str], Finding]) -> Finding:
        """Each algorithm's finding; PPO's is that of all its variants."""
        found: list[Finding] = []
        for label in labels:
            found += [_ppo(results, key, find)] if label == "ppo" else _named({label: find(label)})
        return _all_of(found)

    def each(key: str, labels: Iterable[str], find: Callable[[Cell], Finding]) -> Finding:
        return among(key, labels, lambda label: _of_cell(results, key, label, find))

    def ends(key: str, case: str, expected: Mapping[str, bool]) -> Finding:
        return among(key, expected, lambda label: _ends(results, key, label, case, expected.get(label, True)))

    w, f, e, d = EXPERIMENTS
    text = "text"
    add(5, w, "heuristic, mean return", "about 0.62", text, _near(_heuristic(results, w), 0.62), "within 0.02")
    add(6, w, "random actions, mean return", "about 0.44", text, _near(_random(results, w), 0.44), "within 0.02")
    match = f"at least {_MATCH:g} x heuristic for every goal"
    says = "PPO matches the heuristic for all targets"
    found = each(w, ("ppo",), lambda c: _least(_best_ratios(c), _MATCH))
    add(5, w, f"{says} (best run)", "7 of 7", text, found, match)
    found = each(w, ("ppo",), lambda c: _least(_mean_ratios(c), _MATCH))
    add(5, w, f"{says} (mean of runs)", "7 of 7", text, found, match)
    add(
        5,
        w,
        "some SAC and TD3 agents come close on a few targets",
        "a few",
        text,
        each(w, ("sac", "td3"), lambda c: _reached(_best_ratios(c), lambda goals: 1 < len(goals) < 7)),
        f"best run: 2 to 6 goals at {_CLOSE:g} x heuristic or more",
    )
    add(
        5,
        w,
        "A2C comes close to the heuristic only for NaCl",
        "NaCl only",
        text,
        each(w, ("a2c",), lambda c: _reached(_best_ratios(c), lambda goals: goals == {"NaCl"})),
        f"best run: NaCl alone at {_CLOSE:g} x heuristic or more",
    )
    add(
        6,
        w,
        "agents of each algorithm achieve a return of at least 0.4",
        "0.4 or more",
        text,
        each(w, EXPERIMENTS[w].algorithms, lambda c: _training_end(c, lambda x: x >= 0.4)),
        "mean training return at the end",
    )
    add(
        6,
        w,
        "each algorithm converges before 300k steps",
        "before 300k",
        "caption",
        each(w, EXPERIMENTS[w].algorithms, _converged),
        "mean of evaluations within 5 % of the last one from then on",
    )
    add(7, f, "heuristic, mean return", "about 0.83", text, _near(_heuristic(results, f), 0.83), "within 0.02")
    found = each(f, ("ppo",), lambda c: _least(_mean_ratios(c), _MATCH))
    add(7, f, "PPO consistently matches the heuristic (mean of runs)", "5 of 5", text, found, match)
    add(
        7,
        f,
        "the best A2C and SAC nearly match the heuristic for all products but I",
        "all but I",
        text,
        each(f, ("a2c", "sac"), lambda c: _reached(_best_ratios(c), lambda goals: goals == {"E", "F", "G", "H"})),
        f"best run: E, F, G, H and not I at {_CLOSE:g} x heuristic or more",
    )
    add(
        7,
        f,
        "the best TD3 nearly matches the heuristic for all products but E",
        "all but E",
        text,
        each(f, ("td3",), lambda c: _reached(_best_ratios(c), lambda goals: goals == {"F", "G", "H", "I"})),
        f"best run: F, G, H, I and not E at {_CLOSE:g} x heuristic or more",
    )
    add(
        10,
        e,
        "the best PPO-XL policies exceed the heuristic, on average",
        "about +0.1",
        text,
        each(e, ("ppo-xl",), lambda c: _gain(c, 0.05)),
        "best policies' mean over runs at least 0.05 above",
    )
    add(
        10,
        e,
        "PPO outperforms the heuristic",
        "above 0",
        text,
        each(e, ("ppo",), lambda c: _gain(c, 0.0)),
        "best policies' mean over runs above",
    )
    add(
        10,
        e,
        "A2C does not achieve a return above zero",
        "0",
        text,
        each(e, ("a2c",), lambda c: _training_end(c, lambda x: x <= _ZERO)),
        f"mean training return at the end at most {_ZERO:g}",
    )
    add(
        10,
        e,
        "DQN ends with a negative return",
        "below 0",
        text,
        each(e, ("dqn",), lambda c: _training_end(c, lambda x: x < 0.0)),
        "mean training return at the end below 0",
    )
    add(
        11,
        e,
        "PPO and PPO-XL end the experiment themselves, A2C and DQN do not",
        "ends / does not",
        text,
        ends(e, "", {"ppo-xl": True, "ppo": True, "a2c": False, "dqn": False}),
        "last action of the best sequence, goal dodecane",
    )
    add(
        12,
        d,
        "every algorithm's mean return is positive",
        "above 0",
        "caption",
        each(d, EXPERIMENTS[d].algorithms, lambda c: _training_end(c, lambda x: x > 0.0)),
        "mean training return at the end above 0",
    )
    add(
        13,
        d,
        "PPO and PPO-XL achieve the optimal return with and without salt, by one agent",
        "1 and 1",
        text,
        among(d, ("ppo-xl", "ppo"), lambda n: _cases(results, n, lambda a, b: min(a, b) >= _MATCH)),
        f"best run at least {_MATCH:g} x heuristic in both cases",
    )
    add(
        13,
        d,
        "A2C and DQN do without salt as the heuristic does, and act the same when there is salt",
        "1 and less",
        text,
        among(d, ("a2c", "dqn"), lambda n: _cases(results, n, lambda a, b: a >= _CLOSE and b < _CLOSE)),
        f"best run at least {_CLOSE:g} x heuristic without salt and less with it",
    )
    add(
        13,
        d,
        "without salt, all but DQN end the experiment themselves",
        "ends / does not",
        text,
        ends(d, _SALT[0], {"ppo-xl": True, "ppo": True, "a2c": True, "dqn": False}),
        "last action of the best sequence, goal dodecane",
    )
    return rows


def describe_cells(results: Results) -> list[dict[str, Any]]:
    """Every experiment and algorithm: returns over runs with confidence intervals, and the comparison with the
    scripted policy. The paper's algorithms without runs are there with 0 runs."""
    rows: list[dict[str, Any]] = []
    for key, experiment in EXPERIMENTS.items():
        for label in (*results.cells[key], *results.missing(key)):
            cell = results.cell(key, label)
            row: dict[str, Any] = {"experiment": key, "title": experiment.title, "label": label}
            rows.append(row)
            if cell is None:
                row["runs"] = 0
                continue
            goals = _goals_of(cell)
            strata = [[run.result.by_goal[goal] for run in cell.runs] for goal in goals]
            reference = cell.heuristic_mean()
            row |= {
                "runs": len(cell.runs),
                "seeds": [run.result.seed for run in cell.runs],
                "steps": cell.steps,
                "mean": statistics.mean([cell.means()]).as_dict(),
                "interquartile_mean": statistics.interquartile_mean([cell.means()]).as_dict(),
                "best": cell.best.result.mean,
                "last_mean": float(np.mean([run.result.last_mean for run in cell.runs])),
                "heuristic": reference,
                "relative_by_goal": {
                    goal: {"best": _best_ratios(cell)[goal], "mean": _mean_ratios(cell)[goal]} for goal in goals
                },
                "frames_per_second": float(np.mean([run.result.frames_per_second for run in cell.runs])),
            }
            if reference is not None:
                known = [[(run.result.heuristic_by_goal or {})[goal] for run in cell.runs] for goal in goals]
                row["improvement"] = statistics.probability_of_improvement(strata, known).as_dict()
    return rows


def paper_table(results: Results) -> list[str]:
    """The lines of a Markdown table: the paper's experiments, by algorithm the mean over runs of each one's best policy
    with its interval, the scripted policy first."""
    rows = [row for row in describe_cells(results) if row["runs"]]
    columns = {key: {row["label"]: row for row in rows if row["experiment"] == key} for key in EXPERIMENTS}
    lines = [f"| | {' | '.join(spec.title for spec in EXPERIMENTS.values())} |", f"|---|{'--:|' * len(EXPERIMENTS)}"]
    scripted = [
        next((number_text(row["heuristic"]) for row in own.values() if row["heuristic"] is not None), "")
        for own in columns.values()
    ]
    lines.append(f"| scripted | {' | '.join(scripted)} |")
    for label in dict.fromkeys(row["label"] for row in rows):
        cells = [interval_text(own[label]["mean"]) if label in own else "" for own in columns.values()]
        lines.append(f"| {display_name(label)} | {' | '.join(cells)} |")
    return lines


def write_summary(results: Results, folder: Path, lacking: Mapping[str, Sequence[str]]) -> tuple[Path, Path]:
    """Write ``summary.md`` and ``summary.json``; their paths.

    Args:
        results: what was read.
        folder: where they go.
        lacking: what each figure lacks, as :func:`~chemlab.agents.evaluation.figures.write_figures` returns it.
    """
    statements, cells = compare_with_paper(results), describe_cells(results)
    data = {
        "kind": "summary",
        "format": 1,
        "versions": versions(),
        "statements": [vars(statement) for statement in statements],
        "cells": cells,
        "figures": {spec.stem: {"caption": spec.caption, "lacks": list(lacking[spec.stem])} for spec in FIGURES},
        "left_out": results.left_out,
    }
    plain, page = folder / "summary.json", folder / "summary.md"
    # A ratio to a scripted policy that earns nothing is no number; JSON has no NaN.
    write_text(plain, json.dumps(_without_nan(data), indent=1) + "\n")
    write_text(page, "\n".join(_markdown(folder, statements, cells, lacking, results.left_out)) + "\n")
    return page, plain


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _markdown(
    folder: Path,
    statements: Sequence[Statement],
    cells: Sequence[dict[str, Any]],
    lacking: Mapping[str, Sequence[str]],
    left_out: Sequence[str],
) -> list[str]:
    verdicts = {True: "yes", False: "**no**", None: "-"}
    lines = [
        "# The paper's results and ours",
        "",
        "## What the paper says",
        "",
        "The paper's values are those its text and captions state; none is read off a picture. A statement "
        "about PPO counts as confirmed if any variant of PPO confirms it; each is given.",
        "",
        "| figure | experiment | statement | paper | where | ours | agrees | criterion |",
        "|--:|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {s.figure} | {s.experiment} | {s.says} | {s.paper} | {s.source} | {s.ours} | {verdicts[s.holds]} "
        f"| {s.criterion} |"
        for s in statements
    ]
    lines += [
        "",
        "## Every experiment and algorithm",
        "",
        "Each run's best policy; mean over runs and interquartile mean with 95 % bootstrap intervals over the seeds of "
        "training. As in Stable-Baselines3, environment i of a run has the run's seed + i: neighbouring seeds differ "
        "in networks and exploration, and share most of their environments' random numbers. P(better): "
        "probability that a run's return for a goal is above the scripted policy's, ties counting one half, mean over "
        "goals.",
        "",
        "| experiment | algorithm | runs | steps | mean | interquartile mean | best run | heuristic | P(better) |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in cells:
        start = f"| {row['title']} | {display_name(row['label'])} | {row['runs']} "
        if not row["runs"]:
            lines.append(start + "| - | - | - | - | - | - |")
            continue
        better = interval_text(row["improvement"], 2) if "improvement" in row else "-"
        reference = "-" if row["heuristic"] is None else number_text(row["heuristic"])
        lines.append(
            f"{start}| {row['steps']:,} | {interval_text(row['mean'])} | {interval_text(row['interquartile_mean'])} "
            f"| {row['best']:.3f} | {reference} | {better} |"
        )
    lines += ["", "## Figures", ""]
    for spec in FIGURES:
        picture = f"{spec.stem}.png"
        lines.append(f"**The paper's figure {spec.number}.** {spec.caption}")
        lines += [f"Missing: {what}." for what in lacking[spec.stem]]
        lines += ["", f"![{spec.stem}]({picture})" if (folder / picture).exists() else "(no picture)", ""]
    if left_out:
        lines += ["## Runs that are in no figure", "", *(f"- {line}" for line in left_out)]
    return lines
