"""Ledger of episodes: a file of JSON lines, each with the hash of the line before it."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from chemlab.config.datamodel import validated
from chemlab.config.files import read_bytes, wait_locked
from chemlab.record import LIMITS

LEDGER = "ledger.jsonl"
"""Name of the file."""

_PATIENCE_S = 10.0
_FILE_BYTES = 2**28


class _Episode(BaseModel):
    """A finished episode: its conditions, the hash of its record, and counts by seat."""

    condition: str
    names: str
    say: int
    budget: int | None
    record: str
    seats: dict[str, dict[str, int]]


def _hash(entry: Mapping[str, Any]) -> str:
    text = json.dumps({key: value for key, value in entry.items() if key != "hash"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def append_entry(path: Path, entry: Mapping[str, Any]) -> dict[str, Any]:
    """Append an entry to a ledger and return it with its number, the time, the previous hash and its own hash.

    Raises:
        ValueError: the ledger is not intact, or another process has locked it.
        OSError: the disk is full; nothing has been added.
    """
    with path.open("a+b", buffering=0) as file:
        if not wait_locked(file.fileno(), _PATIENCE_S):
            raise ValueError(f"{path}: another process has locked it; try again")
        file.seek(0)
        entries = _checked(path, file.read())
        previous = entries[-1]["hash"] if entries else ""
        full = {"number": len(entries), "time": int(time.time()), **entry, "previous": previous}
        full["hash"] = _hash(full)
        line, end = json.dumps(full).encode() + b"\n", file.seek(0, os.SEEK_END)
        try:
            if file.write(line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
            os.fsync(file.fileno())
        except OSError:
            file.truncate(end)  # an incomplete line would invalidate the ledger
            raise
    return full


def read_ledger(path: Path) -> list[dict[str, Any]]:
    """Return the entries of a ledger.

    Raises:
        ValueError: a line has been changed, removed or added; the message has its number.
        OSError: it is not a regular file, or larger than 256 MiB.
    """
    return _checked(path, read_bytes(path, _FILE_BYTES))


def ended_episodes(folder: Path) -> dict[Path, dict[str, Any]]:
    """Return all episodes of the ledgers below a folder, by the path of their record.

    Raises:
        ValueError: a ledger is not intact, an entry lacks a value, an episode is not finished, or a record is missing
            or has been changed.
        OSError: a file is not a regular file, or too large.
    """
    found = {}
    for path in sorted(folder.rglob(LEDGER)):
        entries = read_ledger(path)
        ends = {str(entry.get("begun")): entry for entry in entries if entry.get("event") == "ended"}
        for number, entry in enumerate(entries):
            if entry.get("event") != "begun":
                continue
            if str(number) not in ends:
                raise ValueError(
                    f"{path}: line {number + 1}: this episode has not ended. All episodes of a folder count: wait for "
                    "its end, or play into a new folder"
                )
            played = entry | ends[str(number)]
            validated(_Episode, played, f"{path}: episode of line {number + 1}")
            record = path.parent / f"episode-{number:04d}.jsonl"
            file = record if record.exists() else record.with_name(f"{record.name}.part")
            if not file.exists() or hashlib.sha256(read_bytes(file, LIMITS.file_bytes)).hexdigest() != played["record"]:
                raise ValueError(f"{record}: is missing, or has been changed since the episode: restore it")
            found[file] = played
    return found


def _checked(path: Path, content: bytes) -> list[dict[str, Any]]:
    """Return the entries of a ledger's content; ``path`` is for the error message."""
    entries: list[dict[str, Any]] = []
    for number, line in enumerate(content.splitlines()):
        try:
            entry = json.loads(line)
            previous = entries[-1]["hash"] if entries else ""
            intact = entry["hash"] == _hash(entry) and entry["previous"] == previous and entry["number"] == number
        except (ValueError, KeyError, TypeError, RecursionError):
            intact = False
        if not intact:
            raise ValueError(f"{path}: line {number + 1} has been changed; the ledger is not intact")
        entries.append(entry)
    return entries
