"""A record as a file: what may stand in one, and reading it without believing it."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ..config.files import read_bytes
from ..config.materials import DataError, validated
from ..config.scenario import Scenario, dump_scenario, restore_scenario
from ..kernels.arrays import MaskArray, ObservationArray

__all__ = [
    "FORMAT",
    "LIMITS",
    "FormatError",
    "Header",
    "HeaderError",
    "Record",
    "RecordError",
    "digest",
    "read_record",
    "recorded_scenario",
    "scenario_hash",
    "seen_hash",
    "short",
    "to_text",
]

FORMAT = {"name": "chemlab-episode", "version": 3}
"""What the first line of every record begins with; the version counts up when a reader would have to change, or the
same episode would have another record."""

_HASH_BYTES = 8


class _Limits(NamedTuple):
    """How much a record may ask of its reader: several times what any shipped scenario needs."""

    file_bytes: int = 64 * 2**20
    line_bytes: int = 2**20
    turns: int = 100_000
    values: int = 5_000_000
    """Numbers, strings, lists and objects in the whole file, counted by their commas, colons and brackets."""
    depth: int = 16
    """Lists and objects inside each other."""
    integer: int = 2**128
    materials: int = 256
    """In the scenario; the other limits below likewise."""
    reactions: int = 256
    goals: int = 64
    agents: int = 64
    instruments: int = 32


LIMITS = _Limits()
"""Bounds that reading and playing a record keep; what is beyond is refused by name."""


class RecordError(ValueError):
    """A file is no record, or cannot be played again here; the message says why."""


class FormatError(RecordError):
    """A record is of another format than the one that is read here."""


class HeaderError(RecordError):
    """The first line of a record is one that no recorder writes."""


def short(value: Any, most: int = 80) -> str:
    """A value from a file for a message: printable, and no longer than ``most`` characters."""
    text = value if isinstance(value, str) else repr(value)
    text = "".join(mark if mark.isprintable() else ascii(mark)[1:-1] for mark in text[: most + 1].replace("\n", "; "))
    return text if len(text) <= most else text[: most - 3] + "..."


def digest(*parts: bytes) -> str:
    """Hash of bytes, as text."""
    found = hashlib.blake2b(digest_size=_HASH_BYTES)
    for part in parts:
        found.update(part)
    return found.hexdigest()


def to_text(value: Any) -> str:
    """Compact JSON; floats as the shortest text that reads back as the same number.

    Raises:
        ValueError: a number is not finite.
    """
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def scenario_hash(scenario: Scenario) -> str:
    """Hash of everything a scenario says, with its materials and reactions."""
    return digest(to_text(dump_scenario(scenario)).encode())


def seen_hash(observation: ObservationArray, mask: MaskArray | None) -> str:
    """Hash of what an agent was shown: its observation and, where it has one, its mask."""
    shown = np.ascontiguousarray(observation, dtype="<f4").tobytes()
    return digest(shown, b"" if mask is None else np.ascontiguousarray(mask, dtype=np.int8).tobytes())


# -- what may stand in the first line ---------------------------------------------------------------------------------

_Word = Annotated[str, Field(max_length=200)]
_Text = Annotated[str, Field(max_length=4096)]


class Header(BaseModel):
    """The first line: what the episode began with (see :mod:`chemlab.record`)."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    format: dict[str, Any]
    chemlab: _Word
    """The version it was made by."""
    seed: int | None = Field(ge=0, lt=LIMITS.integer)
    """None where the random streams went on from an episode before."""
    options: dict[str, Any]
    """Of the reset: the ``goal`` and the ``world`` that were asked for, or nothing."""
    split: _Word | None = None
    """Which worlds there may be, where the scenario draws any; ``private`` without its salt."""
    rounds: bool
    policies: dict[str, _Text]
    """Who played each agent; a claim."""
    models: dict[str, _Text]
    """Physics of the user's own that replaced chemlab's."""
    environment: dict[str, _Word]
    """What numbers could depend on besides chemlab; a claim."""
    agents: list[_Word] = Field(max_length=LIMITS.agents + 1)
    goals: list[_Word] = Field(max_length=LIMITS.goals)
    streams: dict[str, Annotated[int, Field(ge=0, lt=2**64)]] = Field(max_length=LIMITS.agents + 1)
    """State of each agent's random stream after the reset."""
    materials: list[_Word] = Field(max_length=LIMITS.materials)
    positions: list[_Word]
    hidden: dict[str, Any]
    scenario: dict[str, Any]


# -- reading ----------------------------------------------------------------------------------------------------------


@dataclass
class Record:
    """A record as it was found.

    Attributes:
        header: the first line.
        turns: one a turn, up to the first line that is not one.
        end: the result, or None where the file ends before it.
        broken: (number of the first line that is none of a record, what is the matter), or None.
        notes: how the file's line ends differ from a recorder's, where all lines are there.
        lines: the bytes that header, turns and end were read from.
    """

    path: Path
    header: dict[str, Any]
    turns: list[dict[str, Any]] = field(default_factory=list)
    end: dict[str, Any] | None = None
    broken: tuple[int, str] | None = None
    notes: list[str] = field(default_factory=list)
    lines: list[bytes] = field(default_factory=list, repr=False)

    @property
    def torn(self) -> bool:
        """Whether the end is missing: the episode was not over, or the file has been cut."""
        return self.end is None

    def checked_header(self) -> Header:
        """The first line, checked key by key.

        Raises:
            FormatError: it is of another format.
            HeaderError: a key is missing, unknown or out of bounds; the message names it.
        """
        form = self.header["format"]
        if form != FORMAT:
            made = self.header.get("chemlab")
            by = f", made by chemlab {short(made)}" if made else ""
            raise FormatError(
                f"{self.path}: is of format {short(form.get('version'))}{by}; this chemlab reads format "
                f"{FORMAT['version']}: read it with the chemlab that made it, or record the episode again"
            )
        try:
            header: Header = validated(Header, self.header, f"{self.path}: header")
        except DataError as error:
            raise HeaderError(short(str(error), 500)) from error
        return header


def read_record(path: str | Path) -> Record:
    """Read a record, or as much of one as there is.

    Line ends may be those of another system, as version control and editors make them, and the last may be missing.

    Raises:
        RecordError: there is no such file, it is no record of an episode, or it is larger than :data:`LIMITS`.
    """
    path = Path(path)
    content = _content(path)
    lines = content.split(b"\n", LIMITS.turns + 3)
    whole, tail = lines[:-1], lines[-1]
    if sum(content.count(mark) for mark in (b",", b":", b"[", b"{")) > LIMITS.values:
        raise RecordError(f"{path}: has more than {LIMITS.values} values")
    notes = []
    if whole and all(line.endswith(b"\r") for line in whole):
        whole, tail = [line[:-1] for line in whole], tail.removesuffix(b"\r")
        notes.append(
            "has lines that end with CR LF instead of LF, as version control or an editor may have changed them"
        )
    if _whole(tail):
        whole, tail = [*whole, tail], b""
        notes.append("has no newline at the end of its last line")
    if len(whole) > LIMITS.turns + 2:
        raise RecordError(f"{path}: has more than {LIMITS.turns} turns")
    record: Record | None = None
    for number, text in enumerate(whole, start=1):
        try:
            line = _parse(text)
        except ValueError as error:
            if record is None:
                break
            record.broken = number, str(error)
            return record
        if record is None:
            form = line.get("format")
            if not isinstance(form, dict) or form.get("name") != FORMAT["name"]:
                break
            record = Record(path, line, notes=notes)
        elif record.end is not None:
            record.broken = number, "stands after the end of the episode"
            return record
        elif "end" in line:
            record.end = line
        else:
            record.turns.append(line)
        record.lines.append(text)
    if record is None:
        raise RecordError(f"{path}: is not a record of an episode (its first line is not the header of one)")
    if record.end is not None and tail:
        record.broken = len(whole) + 1, "stands after the end of the episode"
    return record


def _whole(text: bytes) -> bool:
    """Whether a line without its newline is all there: what is left of an object that was cut off is none."""
    try:
        _parse(text)
    except ValueError:
        return False
    return True


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, LIMITS.file_bytes)
    except (OSError, ValueError) as error:  # a name with a NUL in it is a ValueError
        hint = ""
        if isinstance(error, FileNotFoundError) and path.with_name(path.name + ".part").is_file():
            hint = f"; the episode was not finished: read {path}.part"
        raise RecordError(f"{path}: {getattr(error, 'strerror', None) or error}{hint}") from error


def _parse(text: bytes) -> dict[str, Any]:
    """A line's object; ``ValueError`` says why it is none of a record."""
    if len(text) > LIMITS.line_bytes:
        raise ValueError(f"is longer than {LIMITS.line_bytes} bytes")
    try:
        line = json.loads(text.decode(), object_pairs_hook=_unique, parse_constant=_no_number)
    except _Refused:
        raise
    except (ValueError, RecursionError) as error:
        raise ValueError("cannot be read: it is no JSON") from error
    if not isinstance(line, dict):
        raise ValueError("cannot be read: it is no JSON object")
    # Of nearly every line its text says that nothing in it can be too deep or too large.
    if text.count(b"[") + text.count(b"{") > LIMITS.depth or _LARGE.search(text):
        _check_values(line, LIMITS.depth)
    if b"\\u" in text:
        try:
            to_text(line).encode()
        except UnicodeEncodeError as error:
            raise ValueError("has half of a surrogate pair, which is no character") from error
    return line


_LARGE = re.compile(rb"[\[,:]\s*-?(?:[0-9.]+[eE]\+?[0-9]{3}|[0-9]{39})")
"""A number that may be beyond the largest float, or have as many digits as the largest whole number of a record."""


class _Refused(ValueError):
    """What JSON as Python reads it allows, and a record does not: which of two values of a key would count is up to the
    reader, and some numbers are none."""


def _no_number(name: str) -> Any:
    raise _Refused("has a number that is not finite")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        ((key, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise _Refused(f"has the key {key[:80]!r} twice")
    return found


def _check_values(values: Any, deeper: int) -> None:
    """Refuse numbers that are not finite or too large, and more than ``deeper`` lists and objects in each other."""
    if not deeper:
        raise ValueError(f"has more than {LIMITS.depth} lists and objects inside each other")
    most = LIMITS.integer
    for value in values.values() if type(values) is dict else values:
        kind = type(value)  # of what a parser makes there are no subclasses, and every turn's every number comes by
        if kind is float:
            if not math.isfinite(value):
                raise ValueError("has a number that is not finite")
        elif kind is int:
            if abs(value) >= most:
                raise ValueError("has a whole number of 2**128 or more")
        elif kind is dict or kind is list:
            _check_values(value, deeper - 1)


def recorded_scenario(record: Record) -> Scenario:
    """The scenario a record was made on, from the record alone, with the checks of a scenario file.

    Raises:
        RecordError: it is of another format, what it says is no scenario, or one that is larger than :data:`LIMITS`.
    """
    header = record.checked_header()
    try:
        scenario = restore_scenario(header.scenario, f"{record.path}: scenario")
    except (DataError, TypeError) as error:  # a number where a table is meant
        raise RecordError(short(str(error), 500)) from error
    family = scenario.family
    sizes = {
        "materials": len(scenario.materials),
        "reactions": len(family.reaction) + len(family.salt) + len(family.violent),
        "goals": max(len(scenario.goals), len(scenario.lab_goals)),
        "agents": sum(bench.count for bench in scenario.benches.values()),
        "instruments": len(scenario.instruments),
    }
    for key, size in sizes.items():
        most: int = getattr(LIMITS, key)
        if size > most:
            raise RecordError(f"{record.path}: scenario: has {size} {key}; a record's may have {most}")
    return scenario
