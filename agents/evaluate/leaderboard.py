"""Leaderboards: a line for each row and scenario of a benchmark, with the scores of its episodes.

A line has ``scores`` (by episode, null if one was not played) and ``train_scores`` (with the same seeds, in worlds of
``train``). Mean, normalized score and intervals follow from them; :func:`check_leaderboard` recomputes these numbers
(``chemlab verify leaderboard.json``) and replays the records.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from chemlab.config.datafile import DataError, read_json
from chemlab.config.datamodel import validated
from chemlab.config.files import write_text
from chemlab.config.inherit import shipped_file
from chemlab.config.loading import load_scenario
from chemlab.config.parts import may_run
from chemlab.kernels.arrays import FloatArray
from chemlab.record import read_record, recorded_scenario, scenario_hash, verify_record

from .jobs import AUDIT_SEED
from .scale import Scale, interval

if TYPE_CHECKING:
    from typing_extensions import Self

_FILE_BYTES = 50_000_000
_TOLERANCE = 1e-9
"""Largest accepted error of recomputed numbers, in units of a score."""
_ROUNDING = 1e-5
"""The same for the score of a record that another version or platform has made."""
_ESTIMATES = ("over_baseline", "generalization")
_NUMBERS = re.compile(r"\[[\s\d.,eE+\-nul]*\]")

Line = dict[str, Any]

_Score = Annotated[float, Field(ge=-1e9, le=1e9)]


class _Open(BaseModel):
    """A model whose unknown fields are kept."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class _Estimate(_Open):
    """A normalized score and its interval."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


class _Ends(_Open):
    """Mean scores of random play and of the oracle in a line's episodes, as known to the command that wrote them."""

    random: _Score
    oracle: _Score


class _Entry(_Open):
    """Record of one episode of a line."""

    file: str
    seed: int
    score: _Score | None = None


class _Line(_Estimate):
    """A line of a leaderboard."""

    scenario: str
    policy: str
    split: str
    value: float | None
    scenario_hash: str
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

    @model_validator(mode="after")
    def _check_scores(self) -> Self:
        if self.value is not None and not (self.scores and self.scale and self.score is not None):
            raise ValueError("value: needs the scores that it follows from, and score and scale; restore the line")
        return self


class _Leaderboard(BaseModel):
    """Content of the file."""

    model_config = ConfigDict(extra="ignore")

    lines: list[_Line]


def leaderboard_lines(path: Path) -> list[Line]:
    """Return the lines of a leaderboard; an empty list if the file does not exist.

    Raises:
        DataError: the file is not a leaderboard.
    """
    if not path.exists():
        return []
    try:
        found = validated(_Leaderboard, read_json(path, _FILE_BYTES), str(path))
    except DataError as error:
        raise DataError(f"{error}; this is not a leaderboard: move it, or name another file or folder") from error
    return [line.model_dump(mode="json", exclude_unset=True) for line in found.lines]


def write_leaderboard(path: Path, new: Sequence[Line]) -> None:
    """Add lines to a leaderboard, which need not exist. They replace lines of the same rows; all get one scale.

    Raises:
        DataError: the existing file is not a leaderboard.
    """
    lines = _merged(leaderboard_lines(path), new)
    lines.sort(key=lambda line: (line["scenario"], np.inf if line["value"] is None else -line["value"]))
    text = json.dumps({"kind": "leaderboard", "format": 1, "lines": lines}, indent=1, allow_nan=False)
    # Write a list of numbers on one line.
    write_text(path, _NUMBERS.sub(lambda found: re.sub(r"\s+", "", found[0]).replace(",", ", "), text) + "\n")


def runs_of(runs: int, seeds: int, episodes: int) -> list[int] | None:
    """Return the index of the training run that played each episode; None if the row has fewer than two runs.

    Episodes are divided into ``seeds`` replications, which are assigned to the runs in turn.
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
    """Return statistics of a row's scores on the scale of the episodes that it has played.

    Args:
        scores: [E] scores of the row; NaN for episodes that were not played.
        random, oracle, baseline: [E] scores of these rows.
        runs: see :func:`runs_of`.
        train: [E] scores of the row in training worlds.

    Returns:
        ``value``, ``low`` and ``high`` of the normalized mean, ``score``, ``episodes`` and ``scale``, and, if given,
        the differences ``over_baseline`` and ``generalization`` (to the training worlds); None if no score is above
        random play in these episodes, so that there is no scale.
    """
    played = np.isfinite(scores)
    groups = None if runs is None else np.asarray(runs)[played].tolist()
    scale = Scale(random[played], oracle[played], groups)
    if scale.span <= 0.0:
        return None
    normalized = scale.mean(scores[played])
    found: dict[str, Any] = {
        **interval(normalized),
        "score": float(scores[played].mean()),
        "episodes": int(played.sum()),
        "scale": {"random": float(random[played].mean()), "oracle": float(oracle[played].mean())},
    }
    if baseline is not None:
        found["over_baseline"] = interval(normalized - scale.mean(baseline[played]))
    if train is not None:
        found["generalization"] = interval(normalized - scale.mean(train[played]))
    return found


def _key(line: Mapping[str, Any], policy: str | None = None) -> tuple[str, str, str]:
    return line["scenario"], policy or line["policy"], line["split"]


def _merged(stored: Sequence[Line], new: Sequence[Line]) -> list[Line]:
    """Merge stored and new lines; new lines replace those of the same row.

    The oracle's score may differ between commands. Its line keeps the higher score of each episode, and all lines of
    these episodes get its scale.
    """
    lines = {_key(line): line for line in stored}
    for line in new:
        old = _scores(lines.get(_key(line)), line) if line["policy"] == "oracle" else None
        lines[_key(line)] = line if old is None else line | {"scores": np.fmax(old, line["scores"]).tolist()}
    return [line | (_recomputed(line, lines) or {}) for line in lines.values()]


def _scores(line: Line | None, like: Line) -> FloatArray | None:
    """Return a line's scores, if they are of the same number of episodes of the same scenario as those of another."""
    if line is None or not line.get("scores") or line["scenario_hash"] != like["scenario_hash"]:
        return None
    scores = np.array(line["scores"], dtype=np.float64)  # null becomes NaN
    return scores if len(scores) == len(like.get("scores") or ()) else None


def _recomputed(line: Line, lines: Mapping[tuple[str, str, str], Line]) -> dict[str, Any] | None:
    """Compute a line's statistics from the scores of all lines; None for an empty line, or without a scale for it."""
    if line["value"] is None:
        return None
    random, oracle = (_scores(lines.get(_key(line, name)), line) for name in ("random", "oracle"))
    scores = np.array(line["scores"], dtype=np.float64)
    played = np.isfinite(scores)
    if random is None or oracle is None or not played.any() or not np.isfinite([random[played], oracle[played]]).all():
        return None
    if not _equal(line["scale"]["random"], float(random[played].mean())):
        return None
    other = _scores(lines.get(_key(line, line.get("baseline") or "")), line) if line.get("over_baseline") else None
    train_scores = line.get("train_scores") or []
    train = np.array(train_scores) if len(train_scores) == len(scores) and line.get("generalization") else None
    runs = runs_of(int(line.get("runs") or 0), int(line.get("seeds") or 1), len(scores))
    return on_scale(scores, random, oracle, runs, other, train)


@dataclass
class LineCheck:
    """Result of verifying a line.

    Attributes:
        scenario, policy, split: those of the line.
        proof: ``all`` (score, scale and intervals follow from stored scores), ``score`` (only the mean score does) or
            ``empty`` (the cell is empty).
        records: number of episodes that were replayed.
        faults: descriptions of numbers and records that are wrong.
    """

    scenario: str
    policy: str
    split: str
    proof: str
    records: int = 0
    faults: list[str] = field(default_factory=list)


def check_leaderboard(path: Path, watch: Callable[[LineCheck], None] | None = None) -> list[LineCheck]:
    """Recompute every line of a leaderboard from the stored scores, and replay its records.

    Args:
        path: the file; paths of records are relative to its folder.
        watch: called with the result of each line.

    Raises:
        DataError: the file does not exist, or is not a leaderboard.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    lines = leaderboard_lines(path)
    by_key = {_key(line): line for line in lines}
    found = []
    for line in lines:
        check = LineCheck(*_key(line), proof="score")
        if by_key[_key(line)] is not line:
            check.faults.append("there are two lines of this row")
        _check_numbers(check, line, by_key)
        entries = line.get("records") or ()
        if len({entry["seed"] for entry in entries}) < len(entries):
            check.faults.append("records: two are of one episode")
        for entry in entries:
            check.faults += [f"{entry['file']}: {fault}" for fault in _record_faults(check, line, entry, path.parent)]
        found.append(check)
        if watch is not None:
            watch(check)
    return found


def summary(checks: Sequence[LineCheck]) -> str:
    """Return a sentence with the number of lines of each kind."""
    kinds = Counter(check.proof for check in checks)
    return (
        f"{len(checks)} lines; {kinds['all']} follow from their scores; {kinds['score']} in their mean alone (the "
        f"scale's end or an interval is not proven); {kinds['empty']} are empty; "
        f"{sum(check.records for check in checks)} records played again"
    )


def _check_numbers(check: LineCheck, line: Line, lines: Mapping[tuple[str, str, str], Line]) -> None:
    """Compare a line's numbers with recomputed ones; set the proof and append faults."""
    if line["value"] is None:
        check.proof = "empty"
        return
    scale = line["scale"]
    if scale["oracle"] > scale["random"]:
        value = (line["score"] - scale["random"]) / (scale["oracle"] - scale["random"])
        _compare(check, "value", line["value"], value)
    else:
        check.faults.append(f"value: is {line['value']}, but the line has no valid scale")
    played = [score for score in line["scores"] if score is not None]
    _compare(check, "episodes", line.get("episodes"), len(played))
    _compare(check, "score", line["score"], math.fsum(played) / max(len(played), 1))
    random = _scores(lines.get(_key(line, "random")), line)
    if random is not None:
        rows = [score is not None for score in line["scores"]]
        _compare(check, "scale.random", scale["random"], float(random[rows].mean()))
    oracle = _scores(lines.get(_key(line, "oracle")), line)
    if oracle is not None and (np.array(line["scores"], dtype=np.float64) > oracle + _TOLERANCE).any():
        check.faults.append("scores: one is above the oracle's, with which the scale ends")
    computed = _recomputed(line, lines)
    if computed is None:
        return
    check.proof = "all"
    for key in ("low", "high"):
        _compare(check, key, line.get(key), computed[key])
    _compare(check, "scale.oracle", scale["oracle"], computed["scale"]["oracle"])
    for name in _ESTIMATES:
        if not line.get(name):
            continue
        if name not in computed:  # the required scores are not stored
            check.proof = "score"
            continue
        for key in ("value", "low", "high"):
            _compare(check, f"{name}.{key}", line[name].get(key), computed[name][key])


def _equal(stored: float | None, computed: float | None, tolerance: float = _TOLERANCE) -> bool:
    """Return True if two numbers are equal within the tolerance, or both are None."""
    if stored is None or computed is None:
        return stored is computed
    return abs(stored - computed) <= tolerance


def _compare(check: LineCheck, what: str, stored: float | None, computed: float | None) -> None:
    if not _equal(stored, computed):
        check.faults.append(f"{what}: is {stored}, and its scores give {computed}")


def _record_faults(check: LineCheck, line: Line, entry: Line, folder: Path) -> Iterator[str]:
    """Replay a record of a line, and yield its faults."""
    name, number = entry["file"], entry["seed"] - AUDIT_SEED
    scores = line.get("scores") or ()
    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        yield "is not below the leaderboard's folder"
        return
    stored = scores[number] if 0 <= number < len(scores) else None
    if stored is None or not _equal(stored, entry.get("score")):
        yield f"its score is {entry.get('score')}, and that of the line's episode {entry['seed']} is {stored}"
    try:
        record = read_record(folder / name)
        header, spec = record.checked_header(), recorded_scenario(record)
        salted = line["split"] if ":" in line["split"] else None
        proof = verify_record(record, None, may_run(otherwise=False), split=salted)
    except ValueError as error:  # of the record, its scenario, or the line's split
        yield str(error)
        return
    if (header.seed, spec.name) != (entry["seed"], line["scenario"]) or header.options:
        yield f"is of {spec.name}, seed {header.seed}{', with options' * bool(header.options)}"
    if header.split not in (None, line["split"].partition(":")[0]):
        yield f"is of the split {header.split}"
    own = scenario_hash(spec)
    if line["scenario_hash"] != own:
        yield "is of a scenario with other prices or rules"
    elif shipped_file(spec.name) and own != scenario_hash(load_scenario(spec.name)):
        yield f"is of another {spec.name} than the bundled one: prices or rules differ"
    check.records += 1
    # A record of another version, or of a platform that rounds differently, may still be right. Episodes of seats may
    # end without calls left; they count with the score at that time.
    unfinished = record.torn and not line.get("seats")
    if proof.status not in ("ok", "other", "foreign", "torn") or proof.where or proof.score is None or unfinished:
        yield f"{proof.status}: {proof.message}"
    elif not _equal(proof.score, entry.get("score"), _ROUNDING if proof.status == "other" else _TOLERANCE):
        yield f"its replay gives a score of {proof.score}, and the line has {entry.get('score')}"
