"""Leaderboards: a line for each row of a benchmark and scenario, tied to the scores of its episodes.

A line has ``scores`` (by episode, null where one was not played) and ``train_scores`` (from the same seeds in worlds of
``train``), from which its mean, its place on the scale, its intervals and its records follow. :func:`check_leaderboard`
computes them again (``chemlab verify leaderboard.json``). Lines that earlier versions wrote have no scores: nothing but
their records proves what they say.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from chemlab.config.datafile import DataError, read_json
from chemlab.config.datamodel import validated
from chemlab.config.files import write_text
from chemlab.config.parts import may_run
from chemlab.kernels.arrays import FloatArray
from chemlab.record import RecordError, read_record, recorded_scenario, scenario_hash, verify_record

from .jobs import AUDIT_SEED
from .scale import Scale, interval

_FILE_BYTES = 50_000_000
_TOLERANCE = 1e-9
"""Of numbers that are computed again, in units of a score."""
_ESTIMATES = ("over_baseline", "generalization")
_NUMBERS = re.compile(r"\[[\s\d.,eE+\-nul]*\]")

Line = dict[str, Any]


_Score = Annotated[float, Field(ge=-1e9, le=1e9)]


class _Open(BaseModel):
    """A model whose unknown fields are kept."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _Estimate(_Open):
    """A number on the scale, and its interval."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


class _Ends(_Open):
    """Mean scores of random play and of the planner in a line's episodes, as far as its own command knew them."""

    random: _Score
    oracle: _Score


class _Entry(_Open):
    """A record of one of a line's episodes."""

    file: str
    seed: int
    score: _Score | None = None


class _Line(_Estimate):
    """A line of a leaderboard."""

    scenario: str
    policy: str
    split: str
    value: float | None
    scenario_hash: str | None = None
    score: _Score | None = None
    episodes: int | None = None
    runs: int | None = None
    seeds: int | None = Field(None, ge=1, le=100_000)
    baseline: str | None = None
    scale: _Ends | None = None
    over_baseline: _Estimate | None = None
    generalization: _Estimate | None = None
    scores: list[_Score | None] | None = None
    train_scores: list[_Score] | None = None
    records: list[_Entry] = []
    seats: dict[str, str | int | float | None] | None = None


class _Leaderboard(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="ignore")

    lines: list[_Line]


def leaderboard_lines(path: Path) -> list[Line]:
    """The lines of a leaderboard; none where there is no file.

    Raises:
        DataError: it is no leaderboard.
    """
    if not path.exists():
        return []
    try:
        found = validated(_Leaderboard, read_json(path, _FILE_BYTES), str(path))
    except DataError as error:
        raise DataError(f"{error}; this is no leaderboard: move it away, or name another folder with --out") from error
    return [line.model_dump(mode="json", exclude_unset=True) for line in found.lines]


def write_leaderboard(path: Path, new: Sequence[Line]) -> None:
    """Add lines to a leaderboard, or begin one: they replace those of the same rows, and all are on one scale.

    Raises:
        DataError: a file that is there already is no leaderboard.
    """
    lines = _together(leaderboard_lines(path), new)
    lines.sort(key=lambda line: (line["scenario"], -(line["value"] or -np.inf)))
    text = json.dumps({"kind": "leaderboard", "format": 1, "lines": lines}, indent=1, allow_nan=False)
    # A list of numbers stands on one line.
    write_text(path, _NUMBERS.sub(lambda found: re.sub(r"\s+", "", found[0]).replace(",", ", "), text) + "\n")


# -- on one scale -----------------------------------------------------------------------------------------------------


def runs_of(runs: int, seeds: int, episodes: int) -> list[int] | None:
    """The number of the training run that played each episode, where a row has several runs; None: one player.

    Episodes are dealt out to ``seeds`` replications, and these to the runs in turn.
    """
    if runs < 2:
        return None
    parts = np.array_split(np.arange(episodes), seeds)
    return [number % runs for number, part in enumerate(parts) for _ in part]


def on_scale(
    scores: FloatArray,
    random: FloatArray,
    oracle: FloatArray,
    runs: Sequence[int] | None = None,
    baseline: FloatArray | None = None,
    train: FloatArray | None = None,
) -> dict[str, Any] | None:
    """Statistics of a row's scores on the scale of the episodes that it has played.

    Args:
        scores: [E] of the row; NaN where it has not played.
        random, oracle, baseline: [E] scores of these rows.
        runs: see :func:`runs_of`.
        train: [E] scores of the row in training worlds.

    Returns:
        ``value``, ``low`` and ``high`` of the normalized mean, ``score``, ``episodes`` and ``scale``, and what it is
        above the baseline and above its own training worlds, where these are given; None where no score is above
        random play in these episodes, so that there is no scale.
    """
    there = np.isfinite(scores)
    groups = None if runs is None else [run for run, played in zip(runs, there, strict=True) if played]
    scale = Scale(random[there], oracle[there], groups)
    if scale.span <= 0.0:
        return None
    own = scale.mean(scores[there])
    found: dict[str, Any] = {
        **interval(own),
        "score": float(scores[there].mean()),
        "episodes": int(there.sum()),
        "scale": {"random": float(random[there].mean()), "oracle": float(oracle[there].mean())},
    }
    if baseline is not None:
        found["over_baseline"] = interval(own - scale.mean(baseline[there]))
    if train is not None:
        found["generalization"] = interval(own - scale.mean(train[there]))
    return found


def _key(line: Mapping[str, Any], policy: str | None = None) -> tuple[str, str, str]:
    return line["scenario"], policy or line["policy"], line["split"]


def _together(before: Sequence[Line], new: Sequence[Line]) -> list[Line]:
    """Merge earlier and new lines on the longest scale among them; new lines replace those of the same row.

    The end of a scale is the best score of one command, so commands differ in it.
    """
    lines = {_key(line): line for line in before}
    for line in new:
        old = lines.get(_key(line), line)
        if line["policy"] != "oracle" or _episodes(old) != _episodes(line) or _end(old) <= _end(line):
            lines[_key(line)] = line
    longest: dict[Any, float] = {}
    for line in lines.values():
        longest[_episodes(line)] = max(_end(line), longest.get(_episodes(line), -np.inf))
    found = {key: _rescaled(line, longest[_episodes(line)]) for key, line in lines.items()}
    return [line | (_measured(line, found) or {}) for line in found.values()]


def _episodes(line: Line) -> tuple[Any, ...]:
    """Return a key of a line's episodes; the mean score of random play identifies them."""
    return line["scenario"], line["split"], line.get("scenario_hash"), (line.get("scale") or {}).get("random")


def _end(line: Line) -> float:
    """Return the raw score of 1 on a line's scale; minus infinity for an empty cell."""
    return float(line["scale"]["oracle"]) if line.get("scale") else -np.inf


def _rescaled(line: Line, end: float) -> Line:
    """A line on the scale that ends there; 0 stays where it is."""
    if _end(line) in (end, -np.inf) or _end(line) <= line["scale"]["random"]:
        return line
    zero = line["scale"]["random"]
    factor = (_end(line) - zero) / (end - zero)

    def scaled(told: Line) -> Line:
        return told | {key: told[key] * factor for key in ("value", "low", "high") if told.get(key) is not None}

    told = {key: scaled(line[key]) for key in _ESTIMATES if line.get(key)}
    return scaled(line) | told | {"scale": {"random": zero, "oracle": end}}


def _scores(line: Line | None, like: Line) -> FloatArray | None:
    """Scores of a line, if they are of the same number of episodes of the same scenario as those of another."""
    if line is None or not line.get("scores") or line.get("scenario_hash") != like.get("scenario_hash"):
        return None
    found = np.array(line["scores"], dtype=np.float64)  # null becomes NaN
    return found if len(found) == len(like["scores"]) else None


def _measured(line: Line, lines: Mapping[tuple[str, str, str], Line]) -> dict[str, Any] | None:
    """Compute a line's statistics from its scores and the compared ones; None where scores are missing."""
    if not line.get("scores") or line.get("value") is None:
        return None
    own, random, best = (
        _scores(one, line) for one in (line, *(lines.get(_key(line, name)) for name in ("random", "oracle")))
    )
    if own is None or random is None or best is None:
        return None
    other = _scores(lines.get(_key(line, line.get("baseline") or "")), line) if line.get("over_baseline") else None
    train = line.get("train_scores") or []
    training = np.array(train) if len(train) == len(own) and line.get("generalization") else None
    there = np.isfinite(own)
    if not there.any() or not all(np.isfinite(one[there]).all() for one in (random, best)):
        return None
    runs = runs_of(int(line.get("runs") or 0), int(line.get("seeds") or 1), len(own))
    return on_scale(own, random, best, runs, other, training)


# -- checked ----------------------------------------------------------------------------------------------------------


@dataclass
class LineCheck:
    """The proof of a line.

    Attributes:
        scenario, policy, split: of the line.
        proof: ``all`` (score, scale and intervals follow from stored scores), ``score`` (the mean score alone does),
            ``none`` (it has no scores) or ``empty`` (an empty cell, which says nothing).
        records: episodes that were played again.
        faults: what does not follow.
    """

    scenario: str
    policy: str
    split: str
    proof: str
    records: int = 0
    faults: list[str] = field(default_factory=list)


def check_leaderboard(path: Path, watch: Callable[[LineCheck], None] | None = None) -> list[LineCheck]:
    """Compute every line of a leaderboard again, as far as its scores are stored, and play its records again.

    Args:
        path: the file; records stand beside it.
        watch: called with each line when it has been checked.

    Raises:
        DataError: there is no such file, or it is no leaderboard.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    lines = leaderboard_lines(path)
    by_key = {_key(line): line for line in lines}
    found = []
    for line in lines:
        check = LineCheck(*_key(line), proof="none")
        if by_key[_key(line)] is not line:
            check.faults.append("there are two lines of this row")
        _check_numbers(check, line, by_key)
        for entry in line.get("records") or ():
            _check_record(check, line, entry, path.parent)
        found.append(check)
        if watch is not None:
            watch(check)
    return found


def summary(checks: Sequence[LineCheck]) -> str:
    """A leaderboard's checks as a sentence, which says how many lines nothing proves, and of which scenarios."""
    kinds = Counter(check.proof for check in checks)
    said = [
        f"{len(checks)} lines",
        f"{kinds['all']} follow from their scores",
        f"{kinds['score']} in their mean alone (the scale's end or an interval is not proven)",
        f"{kinds['empty']} are empty",
        f"{sum(check.records for check in checks)} records played again",
    ]
    bare = Counter(check.scenario for check in checks if check.proof == "none")
    if bare:
        where = ", ".join(f"{scenario} {count}" for scenario, count in sorted(bare.items()))
        said.append(f"{kinds['none']} lines have no scores, so nothing but their records is proven ({where})")
    return "; ".join(said)


def _check_numbers(check: LineCheck, line: Line, lines: Mapping[tuple[str, str, str], Line]) -> None:
    if line.get("value") is None:
        check.proof = "empty"
        return
    scale = line.get("scale")
    if scale and line.get("score") is not None and scale["oracle"] > scale["random"]:
        value = (line["score"] - scale["random"]) / (scale["oracle"] - scale["random"])
        _compare(check, "value", line["value"], value)
    elif line.get("scores"):
        check.faults.append(f"value: is {line['value']}, but there is no score, or no scale on which it could be")
    if not line.get("scores"):
        return
    played = [score for score in line["scores"] if score is not None]
    check.proof = "score"
    _compare(check, "episodes", line.get("episodes"), len(played))
    _compare(check, "score", line.get("score"), math.fsum(played) / max(len(played), 1))
    random = _scores(lines.get(_key(line, "random")), line)
    there = np.array([score is not None for score in line["scores"]])
    if random is not None and scale:
        _compare(check, "scale.random", scale["random"], float(random[there].mean()))
    measured = _measured(line, lines)
    if measured is None:
        return
    check.proof = "all"
    for key in ("low", "high"):
        _compare(check, key, line.get(key), measured[key])
    _compare(check, "scale.oracle", (scale or {}).get("oracle"), measured["scale"]["oracle"])
    for name in _ESTIMATES:
        if not line.get(name):
            continue
        if name not in measured:  # the scores it needs are not stored
            check.proof = "score"
            continue
        for key in ("value", "low", "high"):
            _compare(check, f"{name}.{key}", line[name].get(key), measured[name][key])


def _compare(check: LineCheck, what: str, said: float | None, computed: float | None) -> None:
    if (said is None) is not (computed is None) or (
        said is not None and computed is not None and not abs(said - computed) <= _TOLERANCE
    ):
        check.faults.append(f"{what}: is {said}, and its scores give {computed}")


def _check_record(check: LineCheck, line: Line, entry: Line, folder: Path) -> None:
    name, number = entry["file"], entry["seed"] - AUDIT_SEED
    scores = line.get("scores")

    def fault(text: str) -> None:
        check.faults.append(f"{name}: {text}")

    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        fault("is not below the leaderboard's folder")
        return
    if scores is not None:
        stored = scores[number] if 0 <= number < len(scores) else None
        if stored is None or entry.get("score") is None or not abs(stored - entry["score"]) <= _TOLERANCE:
            fault(f"its score is {entry.get('score')}, and that of the line's episode {entry['seed']} is {stored}")
    try:
        record = read_record(folder / name)
        header, spec = record.checked_header(), recorded_scenario(record)
    except (RecordError, DataError) as error:
        fault(str(error))
        return
    if (header.seed, spec.name) != (entry["seed"], line["scenario"]) or header.options:
        fault(f"is of {spec.name}, seed {header.seed}{', with options' * bool(header.options)}")
    if header.split not in (None, line["split"].partition(":")[0]):
        fault(f"is of the split {header.split}")
    if line.get("scenario_hash") not in (None, scenario_hash(spec)):
        fault("is of a scenario with other prices or rules")
    private = line["split"] if ":" in line["split"] else None
    proof = verify_record(record, None, may_run(otherwise=False), split=private)
    check.records += 1
    # Of seats, episodes that ended without calls left count as they stood.
    if proof.status not in ("ok", "other", "foreign", *(["torn"] if line.get("seats") else [])):
        fault(f"{proof.status}: {proof.message}")
    # Another version or platform may round otherwise.
    elif proof.status != "other" and (
        proof.score is None or entry.get("score") is None or not abs(proof.score - entry["score"]) <= _TOLERANCE
    ):
        fault(f"comes to {proof.score}, and the line says {entry.get('score')}")
