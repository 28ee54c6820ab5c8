"""A ledger of episodes: a file of lines, each of which has the hash of the line before it."""

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


class _Played(BaseModel):
    """An episode that is over: its conditions, the digest of its record, and counts of each seat."""

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
    """Add an entry to a ledger, with its number, the time and the hash of the entry before it.

    Raises:
        ValueError: the ledger is not intact, or another process keeps it locked.
        OSError: the disk is full; nothing has been added.
    """
    with path.open("a+b", buffering=0) as file:
        if not wait_locked(file.fileno(), _PATIENCE_S):
            raise ValueError(f"{path}: another process keeps it locked; try again")
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
            file.truncate(end)  # a part of a line would make the ledger useless
            raise
    return full


def read_ledger(path: Path) -> list[dict[str, Any]]:
    """The entries of a ledger.

    Raises:
        ValueError: a line has been changed, removed or added; the message says which.
        OSError: it is not a regular file, or larger than 256 MiB.
    """
    return _checked(path, read_bytes(path, _FILE_BYTES))


def ended_episodes(folder: Path) -> dict[Path, dict[str, Any]]:
    """All episodes of the ledgers in a folder, by the file of their record.

    Raises:
        ValueError: a ledger is not intact, an entry lacks a value, an episode has no end, or a record is missing or has
            been changed.
        OSError: a file is not a regular one, or too large.
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
                    f"{path}: line {number + 1}: this episode has no end. All episodes of a folder count: wait for the "
                    "end, or play into a new folder"
                )
            played = entry | ends[str(number)]
            validated(_Played, played, f"{path}: episode of line {number + 1}")
            stem = path.parent / f"episode-{number:04d}.jsonl"
            file = stem if stem.exists() else stem.with_name(f"{stem.name}.part")
            if not file.exists() or _digest(file) != played["record"]:
                raise ValueError(f"{stem}: is missing, or has been changed since the episode: restore it")
            found[file] = played
    return found


def _digest(file: Path) -> str:
    return hashlib.sha256(read_bytes(file, LIMITS.file_bytes)).hexdigest()


def _checked(path: Path, content: bytes) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = []
    for number, line in enumerate(content.splitlines()):
        try:
            entry = json.loads(line)
            previous = entries[-1]["hash"] if entries else ""
            sound = entry["hash"] == _hash(entry) and entry["previous"] == previous and entry["number"] == number
        except (ValueError, KeyError, TypeError, RecursionError):
            sound = False
        if not sound:
            raise ValueError(f"{path}: line {number + 1} is not what was written; the ledger is not intact")
        entries.append(entry)
    return entries
