"""Verification of a record: replay its actions and compare every recorded value."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from .. import __version__
from ..config.inherit import shipped_file
from ..config.loading import load_scenario
from ..config.scenario import Scenario
from .format import FormatError, Header, HeaderError, Record, RecordError, read_record, scenario_hash, short, to_text
from .recorder import Witness, environment_here
from .replay import Replay

_ROUNDING = 1e-6
"""Relative difference that another processor or compiler may cause in a number by the end of an episode."""

Status = Literal["ok", "tampered", "torn", "other", "unchecked", "foreign", "chosen"]
EXIT_CODES: dict[Status, int] = {
    "ok": 0,
    "tampered": 1,
    "torn": 3,
    "other": 4,
    "unchecked": 5,
    "foreign": 6,
    "chosen": 7,
}
"""Exit codes of ``chemlab verify``; 2 is a usage error."""
assert set(EXIT_CODES) == set(get_args(Status))


@dataclass
class Verification:
    """Result of a verification.

    Attributes:
        status: ``ok``; ``tampered`` (a value differs from the replay); ``torn`` (truncated: the end is missing, the
            rest is right); ``other`` (made by another version or platform, on which numbers may differ; see
            ``message``); ``foreign`` (right, but on a scenario that is neither bundled nor the requested one);
            ``chosen`` (right, but in a world that was requested instead of drawn); ``unchecked`` (not a record, or it
            cannot be replayed here).
        message: the finding in words.
        turns: number of turns that were replayed and found right.
        turn: the first wrong turn; None if there is none, or if the first or the last line is wrong.
        where: the first line that differs: ``header``, ``turn 12``, ``end``.
        key: the key that differs.
        recorded, recomputed: its two values.
        score: raw score of the replay after its last turn; None if a turn differs, or if it claims an end that is none.
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
    """Represents a missing key."""

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
    """Replays a record; keeps the first difference, and counts differences that another platform may cause."""

    def __init__(self, record: Record, header: Header, replay: Replay) -> None:
        self.record, self.header, self.replay = record, header, replay
        self.environment = environment_here()
        self.elsewhere = header.environment != self.environment
        # Another version represents its state differently; then only results are compared.
        self.same_version = header.chemlab == __version__
        self.rounded, self.largest, self.largest_at = 0, 0.0, ""
        self.hashes = 0
        self.good = 0
        self.score: float | None = None
        self.found: tuple[str, str, Any, Any] | None = None

    def compare(self, number: int, where: str, recorded: dict[str, Any], recomputed: dict[str, Any]) -> bool:
        """Compare line ``number`` with the replay; keep the first difference and return True if there is none."""
        try:
            text = to_text(recomputed)
        except ValueError:
            self.found = (where, "", "finite numbers", "numbers that are not finite")
            return False
        if text.encode() == self.record.lines[number]:
            return True
        same = True
        for key, one, other in _differences(recorded, recomputed):
            same = False
            if key == "hidden.state" and not self.same_version:
                continue
            if self.elsewhere and self._elsewhere(where, key, one, other):
                continue
            self.found = (where, key, one, other)
            return False
        if same and self.record.lines[number].endswith(b"\r"):
            self.found = (where, "", "CR LF at the end of the line", "LF, as in other lines")
        elif same:
            self.found = (where, "", "the line as recorded", "the same values in another notation")
        return not same

    def _elsewhere(self, where: str, key: str, recorded: Any, recomputed: Any) -> bool:
        """Return True and count the difference if another platform may have caused it.

        Such differences are in the last digits of a number, or in a hash that depends on such a number.
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
        witness = Witness(labs, 0)
        # The header's claims are compared with themselves; the verdict reports them.
        claims = header.policies, header.environment, header.chemlab
        opening = witness.opening(header.seed, header.options, header.rounds, *claims)
        if not self.compare(0, "header", record.header, opening):
            return
        for number, turn in enumerate(record.turns):
            where, tick = f"turn {number}", int(labs.state.ticks[0])
            if witness.over:
                self.found = (where, "play", turn.get("play"), "nothing: the episode is over")
                return
            try:
                plays = self.replay.play(turn)
            except (ValueError, TypeError) as error:
                key, _, problem = str(error).partition(": ")
                self.found = (where, key if key.startswith("play") else "play", turn.get("play"), problem)
                return
            if not self.compare(number + 1, where, turn, witness.turn(tick, plays)):
                return
            self.good += 1
        closing = witness.closing()
        self.score = closing["end"]["score"] if witness.over or record.end is None else None
        if record.end is None:
            return
        if not witness.over:
            self.found = ("end", "end", record.end["end"], "nothing: the episode is not over")
            return
        self.compare(len(record.turns) + 1, "end", record.end, closing)


def verify_record(
    path: str | Path | Record,
    scenario: str | Path | Scenario | None = None,
    trust: bool = False,
    split: str | None = None,
) -> Verification:
    """Replay a record's actions on the simulator and compare all recorded values.

    Args:
        path: the record.
        scenario: scenario on which it must have been made; default: the bundled scenario of the same name.
        trust: allow imports of code that the record names.
        split: ``private:SALT``, for a record of a private split: proves that its world follows from the seed.

    Raises:
        DataError: ``scenario`` is invalid.
    """
    name = str(path.path if isinstance(path, Record) else path)
    asked = None if scenario is None else load_scenario(scenario)
    try:
        record = path if isinstance(path, Record) else read_record(path)
    except RecordError as error:
        return Verification(name, "unchecked", _plain(error, name))
    other = _other_version(record)
    try:
        header = record.checked_header()
        replay = Replay(record, trust, split)
    except RecordError as error:
        status: Status = "tampered" if isinstance(error, HeaderError) else "unchecked"
        messages, where = [_plain(error, name)], "header" if isinstance(error, HeaderError) else ""
        if record.broken is not None:
            status, messages = "tampered", [_broken(record), *messages]
        elif isinstance(error, FormatError):
            status = "other"
        elif other:
            status, messages = "other", [other, *messages]
        return Verification(name, status, "; ".join(messages), where=where)
    check = _Check(record, header, replay)
    check.run()
    return _verdict(check, other, _foreign(replay.laboratories.scenario, asked))


def _plain(error: RecordError, name: str) -> str:
    return short(str(error).removeprefix(f"{name}: "), 500)


def _broken(record: Record) -> str:
    assert record.broken is not None
    return f"line {record.broken[0]} {record.broken[1]}"


def _other_version(record: Record) -> str:
    """Describe the other version that made a record."""
    made = record.header.get("chemlab")
    return "" if made == __version__ else f"made by chemlab {short(made)}, this is {__version__}"


def _foreign(spec: Scenario, asked: Scenario | None) -> str:
    """Describe a scenario that is defined only by the record itself."""
    actual = scenario_hash(spec)
    if asked is None and not shipped_file(spec.name):
        return f"scenario {spec.name} is the record's own (hash {actual}), not a bundled one"
    expected, origin = _shipped(spec.name) if asked is None else (scenario_hash(asked), asked.origin)
    return "" if expected == actual else f"its scenario {spec.name} (hash {actual}) is not {origin}"


@functools.cache
def _shipped(name: str) -> tuple[str, str]:
    """Return hash and file of a bundled scenario."""
    scenario = load_scenario(name)
    return scenario_hash(scenario), scenario.origin


def _verdict(check: _Check, other: str, foreign: str) -> Verification:
    """Combine the findings into one result, the most severe first."""
    record = check.record
    chosen = "its world was requested (options.world), not drawn" if "world" in check.header.options else ""
    result = Verification(str(record.path), "ok", "", turns=check.good, score=check.score)
    problems = []
    if check.found is not None:
        result.where, key, recorded, recomputed = check.found
        result.key = short(key)
        result.recorded, result.recomputed = _shown(recorded), _shown(recomputed)
        result.turn = int(result.where.split()[1]) if result.where.startswith("turn") else None
        place = ": ".join(part for part in (result.where, result.key) if part)
        problems.append(f"{place}: recorded {short(repr(recorded))}, recomputed {short(repr(recomputed))}")
    elif record.broken is not None:
        problems.append(_broken(record))
    played = f"all {check.good} turns" + ("" if record.torn else f" and the score {check.score!r}")
    right = f"{played} are right"
    if record.torn:
        right = f"the end is missing; all {check.good} turns up to there are right"
    deviations = []
    if check.rounded:
        deviations.append(f"{check.rounded} numbers differ, by {check.largest:.1g} at most ({check.largest_at})")
    if check.hashes:
        deviations.append(
            f"{check.hashes} hashes of observations or hidden state differ, which only that platform can verify"
        )
    if problems and (record.broken is not None or not other):
        result.status, result.message = "tampered", "; ".join([*problems, *filter(None, (other, foreign, chosen))])
    elif other or deviations:
        result.status = "other"
        elsewhere = f"made on another platform: {', '.join(deviations)}" if deviations else ""
        agree = problems or ["nothing differs by more" if deviations else f"played on it, {played} agree"]
        missing = "the end is missing" if record.torn else ""
        result.message = "; ".join(filter(None, [other, foreign, chosen, elsewhere, *agree, missing]))
    elif foreign:
        result.status, result.message = "foreign", "; ".join(filter(None, (foreign, chosen, f"on it {right}")))
    elif chosen:
        result.status, result.message = "chosen", f"{chosen}; in it {right}"
    else:
        result.status, result.message = "torn" if record.torn else "ok", right
    result.notes = _notes(check)
    return result


def _notes(check: _Check) -> list[str]:
    """Return the record's claims that a replay cannot prove."""
    header, notes = check.header, [*check.record.notes]
    if check.elsewhere:
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
    if header.split == "private" and not check.replay.split_known:
        notes.append("is of a private split: without its salt, its author may have chosen the world")
    if header.seed is None:
        notes.append("has no seed: its author may have chosen the random streams, goals and world")
    elif header.options:
        asked = [f"{key} {short(value)}" for key, value in header.options.items()]
        notes.append(f"was requested: {', '.join(asked)}")
    return notes


def _shown(value: Any) -> Any:
    """Shorten a value for a report."""
    if value is _ABSENT:
        return None
    return value if isinstance(value, (int, float, bool)) or value is None else short(value)
