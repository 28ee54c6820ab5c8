"""File format of records, and reading of untrusted files."""

from __future__ import annotations

import contextlib
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

from ..config.datafile import DataError
from ..config.datamodel import validated
from ..config.display import facts_html
from ..config.files import read_bytes
from ..config.loading import dump_scenario, restore_scenario
from ..config.scenario import Scenario
from ..kernels.arrays import MaskArray, ObservationArray

FORMAT = {"name": "chemlab-episode", "version": 5}
"""Format entry of every record's first line.

The version is increased when readers have to change, or when the same episode would give another record.
"""

_HASH_BYTES = 8


class _Limits(NamedTuple):
    """Upper bounds on the size of a record, several times the sizes of records of bundled scenarios."""

    file_bytes: int = 64 * 2**20
    line_bytes: int = 2**20
    turns: int = 100_000
    values: int = 5_000_000
    """Numbers, strings, lists and objects in the whole file, counted by commas, colons and brackets."""
    depth: int = 16
    """Nesting depth of lists and objects."""
    integer: int = 2**128
    materials: int = 256
    """Materials of the scenario; this limit and the following ones apply to the scenario."""
    reactions: int = 256
    goals: int = 64
    agents: int = 64
    instruments: int = 32


LIMITS = _Limits()
"""Bounds enforced on reading and replaying a record; the error names the exceeded one."""


class RecordError(ValueError):
    """A file is not a record or cannot be replayed here; the message states the reason."""


class FormatError(RecordError):
    """A record has another format version."""


class HeaderError(RecordError):
    """The first line of a record is not a valid header."""


def short(value: Any, most: int = 80) -> str:
    """Format a value from a file for a message: printable, and no longer than ``most`` characters."""
    text = value if isinstance(value, str) else repr(value)
    text = "".join(mark if mark.isprintable() else ascii(mark)[1:-1] for mark in text[: most + 1].replace("\n", "; "))
    return text if len(text) <= most else text[: most - 3] + "..."


def digest(*parts: bytes) -> str:
    """Return a hash of bytes as text."""
    return hashlib.blake2b(b"".join(parts), digest_size=_HASH_BYTES).hexdigest()


def to_text(value: Any) -> str:
    """Serialize a value as compact JSON, with floats in shortest round-trip form.

    Raises:
        ValueError: a number is not finite.
    """
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def scenario_hash(scenario: Scenario) -> str:
    """Return a hash of a scenario's content, including materials and reactions."""
    return digest(to_text(dump_scenario(scenario)).encode())


def seen_hash(observation: ObservationArray, mask: MaskArray | None) -> str:
    """Return a hash of an agent's observation and, if there is one, its mask."""
    shown = np.ascontiguousarray(observation, dtype="<f4").tobytes()
    return digest(shown, b"" if mask is None else np.ascontiguousarray(mask, dtype=np.int8).tobytes())


_Word = Annotated[str, Field(max_length=200)]
_Text = Annotated[str, Field(max_length=4096)]


class Header(BaseModel):
    """Schema of the first line, the state at the start of the episode (see :mod:`chemlab.record`)."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    format: dict[str, Any]
    chemlab: _Word
    """Version of chemlab that wrote the record."""
    seed: int | None = Field(ge=0, lt=LIMITS.integer)
    """Seed of the reset; None if the random streams continued from an earlier episode."""
    options: dict[str, Any]
    """Options of the reset: the requested ``goal`` and ``world``, if any."""
    split: _Word | None = None
    """Split of worlds if the scenario has hidden parameters; ``private`` without its salt."""
    rounds: bool
    policies: dict[str, _Text]
    """Policy of each agent; a claim."""
    environment: dict[str, _Word]
    """Versions and platform that numbers may depend on; a claim."""
    agents: list[_Word] = Field(max_length=LIMITS.agents + 1)
    goals: list[_Word] = Field(max_length=LIMITS.goals)
    streams: dict[str, Annotated[int, Field(ge=0, lt=2**64)]] = Field(max_length=LIMITS.agents + 1)
    """State of each agent's random stream after the reset."""
    materials: list[_Word] = Field(max_length=LIMITS.materials)
    positions: list[_Word]
    hidden: dict[str, Any]
    scenario: dict[str, Any]


@dataclass(repr=False)
class Record:
    """A record as read from a file.

    Attributes:
        header: the first line.
        turns: one dictionary per turn, up to the first invalid line.
        end: the result, or None if the file ends before it.
        broken: (number of the first invalid line, reason), or None.
        notes: deviations of the line ends from the format.
        lines: the bytes of header, turns and end.
    """

    path: Path
    header: dict[str, Any]
    turns: list[dict[str, Any]] = field(default_factory=list)
    end: dict[str, Any] | None = None
    broken: tuple[int, str] | None = None
    notes: list[str] = field(default_factory=list)
    lines: list[bytes] = field(default_factory=list)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.path}: " + ", ".join(f"{k} {v}" for k, v in self._facts().items()) + ">"

    def _repr_html_(self) -> str:
        return facts_html(self.path.name, self._facts())

    def _facts(self) -> dict[str, Any]:
        """Return the facts that a notebook displays."""
        try:
            scenario = self.header["scenario"]["scenario"]["name"]
        except (KeyError, TypeError):
            scenario = "unknown"
        result = self.end["end"] if self.end else "missing"
        score = result.get("score") if isinstance(result, dict) else result
        return {"scenario": scenario, "seed": self.header.get("seed"), "turns": len(self.turns), "score": score}

    @property
    def torn(self) -> bool:
        """True if the end is missing: the episode was not finished, or the file was truncated."""
        return self.end is None

    def checked_header(self) -> Header:
        """Validate the first line key by key and return it.

        Raises:
            FormatError: the record has another format version.
            HeaderError: a key is missing, unknown or out of bounds; the message names it.
        """
        form = self.header["format"]
        if form != FORMAT:
            made = self.header.get("chemlab")
            by = f", made by chemlab {short(made)}" if made else ""
            raise FormatError(
                f"{self.path}: has format {short(form.get('version'))}{by}; this version reads format "
                f"{FORMAT['version']}: read it with the version that made it, or record the episode again"
            )
        try:
            header = validated(Header, self.header, f"{self.path}: header")
        except DataError as error:
            raise HeaderError(short(str(error), 500)) from error
        return header


def read_record(path: str | Path) -> Record:
    """Read a complete or truncated record.

    Line ends may be CR LF, as version control and editors write them, and the last may be missing.

    Raises:
        RecordError: the file does not exist, is not a record, or exceeds :data:`LIMITS`.
    """
    path = Path(path)
    try:
        content = read_bytes(path, LIMITS.file_bytes)
    except (OSError, ValueError) as error:  # a name that contains NUL raises ValueError
        hint = ""
        if isinstance(error, FileNotFoundError) and path.with_name(path.name + ".part").is_file():
            hint = f"; the episode was not finished: read {path}.part"
        raise RecordError(f"{path}: {getattr(error, 'strerror', None) or error}{hint}") from error
    lines = content.split(b"\n", LIMITS.turns + 3)
    whole, tail = lines[:-1], lines[-1]
    if sum(content.count(mark) for mark in (b",", b":", b"[", b"{")) > LIMITS.values:
        raise RecordError(f"{path}: has more than {LIMITS.values} values")
    notes = []
    if whole and all(line.endswith(b"\r") for line in whole):
        whole, tail = [line[:-1] for line in whole], tail.removesuffix(b"\r")
        notes.append("has lines that end with CR LF instead of LF, probably changed by version control or an editor")
    with contextlib.suppress(ValueError):  # a truncated object is not valid JSON
        _parse(tail)
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
            record.broken = number, "follows the end of the episode"
            return record
        elif "end" in line:
            record.end = line
        else:
            record.turns.append(line)
        record.lines.append(text)
    if record is None:
        raise RecordError(f"{path}: is not a record of an episode (its first line is not a header)")
    if record.end is not None and tail:
        record.broken = len(whole) + 1, "follows the end of the episode"
    return record


def _parse(text: bytes) -> dict[str, Any]:
    """Parse a line; raise ValueError with the reason if it is not valid in a record."""
    if len(text) > LIMITS.line_bytes:
        raise ValueError(f"is longer than {LIMITS.line_bytes} bytes")
    try:
        line = json.loads(text.decode(), object_pairs_hook=_reject_duplicates, parse_constant=_reject_constant)
    except _Rejected:
        raise
    except (ValueError, RecursionError) as error:
        raise ValueError("cannot be read: it is not JSON") from error
    if not isinstance(line, dict):
        raise ValueError("cannot be read: it is not a JSON object")
    # The text of nearly every line alone rules out values that are too deep or too large.
    if text.count(b"[") + text.count(b"{") > LIMITS.depth or _LARGE.search(text):
        _check_values(line, LIMITS.depth)
    if b"\\u" in text:
        try:
            to_text(line).encode()
        except UnicodeEncodeError as error:
            raise ValueError("has half of a surrogate pair, which is not a character") from error
    return line


_LARGE = re.compile(rb"[\[,:]\s*-?(?:[0-9.]+[eE]\+?[0-9]{3}|[0-9]{39})")
"""A number that may exceed the largest float, or has as many digits as a record's largest integer."""


class _Rejected(ValueError):
    """Content that Python's JSON parser accepts but a record must not have: duplicate keys and non-finite numbers."""


def _reject_constant(name: str) -> Any:
    raise _Rejected("has a number that is not finite")


def _reject_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        ((key, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise _Rejected(f"has the key {key[:80]!r} twice")
    return values


def _check_values(values: Any, deeper: int) -> None:
    """Raise ValueError if a number is not finite or too large, or values are nested more than ``deeper``."""
    if not deeper:
        raise ValueError(f"has more than {LIMITS.depth} nested lists and objects")
    for value in values.values() if type(values) is dict else values:
        kind = type(value)  # exact types: the parser creates no subclasses, and this runs for every number
        if kind is float:
            if not math.isfinite(value):
                raise ValueError("has a number that is not finite")
        elif kind is int:
            if abs(value) >= LIMITS.integer:
                raise ValueError("has an integer of 2**128 or more")
        elif kind is dict or kind is list:
            _check_values(value, deeper - 1)


def recorded_scenario(record: Record) -> Scenario:
    """Validate the scenario that a record contains, with the checks of a scenario file.

    Raises:
        RecordError: the record has another format, or its scenario is invalid or exceeds :data:`LIMITS`.
    """
    header = record.checked_header()
    try:
        scenario = restore_scenario(header.scenario, f"{record.path}: scenario")
    except (DataError, TypeError) as error:  # TypeError: a number in place of a table
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
            raise RecordError(f"{record.path}: scenario: has {size} {key}; must be at most {most}")
    return scenario
