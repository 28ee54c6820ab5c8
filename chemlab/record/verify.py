"""Verification of a record: replay its actions and compare every recorded value."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from .. import __version__
from ..config.draws import Split
from ..config.inherit import shipped_file
from ..config.loading import load_scenario
from ..config.scenario import Scenario
from .format import FormatError, Header, HeaderError, Record, RecordError, read_record, scenario_hash, short, to_text
from .recorder import EpisodeLines, environment_here
from .replay import Replay

_ROUNDING = 1e-6
"""Relative difference that another processor or compiler may cause in a number by the end of an episode."""

Status = Literal["ok", "tampered", "torn", "other", "unchecked", "foreign", "chosen"]
EXIT_CODES: dict[Status, int] = {
    "tampered": 1,
    "unchecked": 5,
    "other": 4,
    "foreign": 6,
    "chosen": 7,
    "torn": 3,
    "ok": 0,
}
"""Exit codes of ``chemlab verify``, worst first; 2 is a usage error."""
assert set(EXIT_CODES) == set(get_args(Status))


@dataclass
class Verification:
    """Result of a verification.

    Attributes:
        status: ``ok``; ``tampered`` (a value differs from the replay); ``torn`` (truncated: the end is missing, the
            rest is right); ``other`` (made by another version or platform, on which numbers may differ; see
            ``message``); ``foreign`` (right, but on a scenario that is neither bundled nor the requested one, or of
            another split than the requested one); ``chosen`` (right, but in a world that was requested instead of
            drawn); ``unchecked`` (not a record, or it cannot be replayed here).
        message: the result in words.
        turns: number of turns that agree with the replay.
        turn: the first wrong turn; None if there is none, or if the first or the last line is wrong.
        where: the first line that differs: ``header``, ``turn 12``, ``end``.
        key: the key that differs.
        recorded, recomputed: the two values of this key.
        score: raw score of the replay after its last turn; None if a turn differs, or if the record ends before the
            episode is over.
        notes: further remarks, and claims of the record that a replay cannot prove.
    """

    path: str
    status: Status
    message: str
    turns: int = 0
    turn: int | None = None
    where: str = ""
    key: str = ""
    recorded: Any = None
    recomputed: Any = None
    score: float | None = None
    notes: list[str] = field(default_factory=list)


class _Absent:
    """Placeholder for the value of a missing key."""

    def __repr__(self) -> str:
        return "nothing"


_ABSENT = _Absent()


def _differences(recorded: Any, recomputed: Any, key: str = "") -> Iterable[tuple[str, Any, Any]]:
    """Yield (key, recorded, recomputed) of all differences, in the order of the recomputed line."""
    if isinstance(recorded, dict) and isinstance(recomputed, dict):
        for name in [*recomputed, *(name for name in recorded if name not in recomputed)]:
            inner = f"{key}.{name}" if key else str(name)
            yield from _differences(recorded.get(name, _ABSENT), recomputed.get(name, _ABSENT), inner)
    elif isinstance(recorded, list) and isinstance(recomputed, list) and len(recorded) == len(recomputed):
        for i, (one, other) in enumerate(zip(recorded, recomputed, strict=True)):
            yield from _differences(one, other, f"{key}.{i}")
    elif isinstance(recorded, bool) is not isinstance(recomputed, bool) or recorded != recomputed:
        yield key, recorded, recomputed


def _is_hash(key: str, value: Any) -> bool:
    return (key.startswith("play.") or key == "hidden.state") and bool(re.fullmatch("[0-9a-f]{16}", str(value)))


class _Check:
    """Comparison of a record with its replay.

    Attributes:
        other_platform: True if the record claims another platform or other versions of packages.
        same_version: True if this version of chemlab made the record; otherwise hidden states are not compared,
            because versions represent them differently.
        rounded, hashes: numbers of differences in rounding and in hashes, which another platform may cause.
        largest, largest_at: largest relative difference in rounding, and its place.
        turns: number of turns that agree.
        score: raw score of the replay, see :class:`Verification`.
        difference: (line, key, recorded, recomputed) of the first difference, or None.
    """

    def __init__(self, record: Record, header: Header, replay: Replay) -> None:
        self.record, self.header, self.replay = record, header, replay
        self.environment = environment_here()
        self.other_platform = header.environment != self.environment
        self.same_version = header.chemlab == __version__
        self.rounded, self.hashes, self.largest, self.largest_at = 0, 0, 0.0, ""
        self.turns = 0
        self.score: float | None = None
        self.difference: tuple[str, str, Any, Any] | None = None

    def compare(self, number: int, where: str, recorded: dict[str, Any], recomputed: dict[str, Any]) -> bool:
        """Return True if line ``number`` agrees with the replay; otherwise store the first difference."""
        try:
            text = to_text(recomputed)
        except ValueError:
            self.difference = (where, "", "finite numbers", "numbers that are not finite")
            return False
        if text.encode() == self.record.lines[number]:
            return True
        same = True
        for key, one, other in _differences(recorded, recomputed):
            same = False
            if key == "hidden.state" and not self.same_version:
                continue
            if self.other_platform and self._tolerate(where, key, one, other):
                continue
            self.difference = (where, key, one, other)
            return False
        if same and self.record.lines[number].endswith(b"\r"):
            self.difference = (where, "", "CR LF at the end of the line", "LF, as in other lines")
        elif same:
            self.difference = (where, "", "the line as recorded", "the same values in another notation")
        return not same

    def _tolerate(self, where: str, key: str, recorded: Any, recomputed: Any) -> bool:
        """Count a difference and return True if another platform may have caused it.

        This holds for the last digits of a number, and for a hash that depends on such a number.
        """
        if _is_hash(key, recorded) and _is_hash(key, recomputed):
            self.hashes += 1
            return True
        numbers = (float, int)
        if not isinstance(recorded, numbers) or not isinstance(recomputed, float) or isinstance(recorded, bool):
            return False
        apart = abs(recorded - recomputed) / max(abs(recorded), abs(recomputed), 1.0)
        if apart > _ROUNDING:
            return False
        self.rounded += 1
        if apart >= self.largest:
            self.largest, self.largest_at = apart, f"{where}: {key}"
        return True

    def run(self) -> None:
        """Replay the record up to the first difference."""
        record, header, labs = self.record, self.header, self.replay.laboratories
        lines = EpisodeLines(labs, 0)
        # These claims are compared with themselves; the result's notes list them.
        claims = header.policies, header.environment, header.chemlab
        opening = lines.opening(header.seed, header.options, header.rounds, *claims)
        if not self.compare(0, "header", record.header, opening):
            return
        for number, turn in enumerate(record.turns):
            where, tick = f"turn {number}", int(labs.state.ticks[0])
            if lines.over:
                self.difference = (where, "play", turn.get("play"), "nothing: the episode is over")
                return
            try:
                plays = self.replay.play(turn)
            except (ValueError, TypeError) as error:
                key, _, problem = str(error).partition(": ")
                self.difference = (where, key if key.startswith("play") else "play", turn.get("play"), problem)
                return
            if not self.compare(number + 1, where, turn, lines.turn(tick, plays)):
                return
            self.turns += 1
        closing = lines.closing()
        if record.end is None or lines.over:
            self.score = closing["end"]["score"]
        if record.end is not None and lines.over:
            self.compare(len(record.turns) + 1, "end", record.end, closing)
        elif record.end is not None:
            self.difference = ("end", "end", record.end["end"], "nothing: the episode is not over")


def verify_record(
    path: str | Path | Record,
    scenario: str | Path | Scenario | None = None,
    trust: bool = False,
    split: str | None = None,
) -> Verification:
    """Replay a record's actions on the simulator and compare all recorded values.

    Args:
        path: the record or its path.
        scenario: required scenario of the record; default: the bundled scenario of the same name. Parts
            ``file.py:Name`` are looked for beside its file, by default beside the record.
        trust: allow imports of code that the record names.
        split: required split of the record, if its scenario has hidden parameters; ``private:SALT`` also proves that
            the world of a record of this split follows from the seed.

    Raises:
        DataError: ``scenario`` is invalid.
        ValueError: ``split`` is unknown.
    """
    public = None if split is None else Split.of(split).public
    name = str(path.path if isinstance(path, Record) else path)
    required = None if scenario is None else load_scenario(scenario)
    try:
        record = path if isinstance(path, Record) else read_record(path)
    except RecordError as error:
        return Verification(name, "unchecked", _message(error, name))
    made = record.header.get("chemlab")
    other = "" if made == __version__ else f"made by chemlab {short(made)}, this is {__version__}"
    try:
        header = record.checked_header()
        replay = Replay(record, trust, split if public == "private" else None, required)
    except RecordError as error:
        status: Status = "tampered" if isinstance(error, HeaderError) else "unchecked"
        messages, where = [_message(error, name)], "header" if isinstance(error, HeaderError) else ""
        if record.broken is not None:
            status, messages = "tampered", [_broken(record), *messages]
        elif isinstance(error, FormatError):
            status = "other"
        elif other:
            status, messages = "other", [other, *messages]
        return Verification(name, status, "; ".join(messages), where=where)
    check = _Check(record, header, replay)
    check.run()
    foreign = _foreign(replay.laboratories.scenario, required)
    if header.split is not None and public not in (None, header.split):
        foreign = f"its split is {header.split}, not {public}"
    return _verdict(check, other, foreign)


def _message(error: RecordError, name: str) -> str:
    return short(str(error).removeprefix(f"{name}: "), 500)


def _broken(record: Record) -> str:
    assert record.broken is not None
    return f"line {record.broken[0]} {record.broken[1]}"


def _foreign(spec: Scenario, required: Scenario | None) -> str:
    """Describe a scenario that is neither bundled nor the required one; otherwise return an empty text."""
    actual = scenario_hash(spec)
    if required is None and not shipped_file(spec.name):
        return f"scenario {spec.name} is the record's own (hash {actual}), not a bundled one"
    expected, origin = _bundled(spec.name) if required is None else (scenario_hash(required), required.origin)
    return "" if expected == actual else f"its scenario {spec.name} (hash {actual}) is not {origin}"


@functools.cache
def _bundled(name: str) -> tuple[str, str]:
    """Return hash and file of a bundled scenario."""
    scenario = load_scenario(name)
    return scenario_hash(scenario), scenario.origin


def _verdict(check: _Check, other: str, foreign: str) -> Verification:
    """Combine the findings into one result, the most severe first."""
    record = check.record
    chosen = "its world was requested (options.world), not drawn" if "world" in check.header.options else ""
    result = Verification(str(record.path), "ok", "", turns=check.turns, score=check.score)
    problems = []
    if check.difference is not None:
        result.where, key, recorded, recomputed = check.difference
        result.key = short(key)
        result.recorded, result.recomputed = _shown(recorded), _shown(recomputed)
        result.turn = int(result.where.split()[1]) if result.where.startswith("turn") else None
        place = ": ".join(part for part in (result.where, result.key) if part)
        problems.append(f"{place}: recorded {short(repr(recorded))}, recomputed {short(repr(recomputed))}")
    elif record.broken is not None:
        problems.append(_broken(record))
    played = f"all {check.turns} turns" + ("" if record.torn else f" and the score {check.score!r}")
    right = f"the end is missing; {played} up to there are right" if record.torn else f"{played} are right"
    deviations = []
    if check.rounded:
        deviations.append(f"{check.rounded} numbers differ, by {check.largest:.1g} at most ({check.largest_at})")
    if check.hashes:
        deviations.append(
            f"{check.hashes} hashes of observations or hidden state differ, which only that platform can verify"
        )
    if problems and (record.broken is not None or not other):
        result.status, parts = "tampered", [*problems, other, foreign, chosen]
    elif other or deviations:
        elsewhere = f"made on another platform: {', '.join(deviations)}" if deviations else ""
        agree = problems or ["nothing differs by more" if deviations else f"played on it, {played} agree"]
        missing = "the end is missing" if record.torn else ""
        result.status, parts = "other", [other, foreign, chosen, elsewhere, *agree, missing]
    elif foreign:
        result.status, parts = "foreign", [foreign, chosen, f"on it {right}"]
    elif chosen:
        result.status, parts = "chosen", [chosen, f"in it {right}"]
    else:
        result.status, parts = "torn" if record.torn else "ok", [right]
    result.message, result.notes = "; ".join(filter(None, parts)), _notes(check)
    return result


def _notes(check: _Check) -> list[str]:
    """Return the record's claims that a replay cannot prove."""
    header, notes = check.header, [*check.record.notes]
    if check.other_platform:
        differing = [
            f"{key} {short(header.environment.get(key))} (here {value})"
            for key, value in check.environment.items()
            if header.environment.get(key) != value
        ]
        unknown = sorted(header.environment.keys() - check.environment.keys())
        differing += [f"{short(key)} {short(header.environment[key])}" for key in unknown]
        notes.append(f"claims to have been made with {', '.join(differing)}")
    if header.policies:
        who = ", ".join(sorted({short(name) for name in header.policies.values()}))
        notes.append(f"claims that {short(who, 200)} played, which cannot be proved")
    chosen = "its author may have chosen the random streams, goals and world"
    if header.split == "private" and not check.replay.split_known:
        notes.append(f"is of a private split: without its salt, {chosen}")
    if header.seed is None:
        notes.append(f"has no seed: {chosen}")
    elif header.options:
        requested = [f"{key} {short(value)}" for key, value in header.options.items()]
        notes.append(f"was requested: {', '.join(requested)}")
    return notes


def _shown(value: Any) -> Any:
    """Shorten a value for a report."""
    if value is _ABSENT:
        return None
    return value if isinstance(value, (int, float, bool)) or value is None else short(value)
