"""Reading of untrusted data files within bounds; :mod:`chemlab.config.datamodel` validates them against models.

Every fault of a file raises a :class:`DataError` that names file, key, value and bound.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

from .files import read_bytes

_FILE_BYTES = 1_000_000
_DEPTH = 12
_ENTRIES = 10_000
_TEXT = 4000
_KEY = 100
_INTEGER = 2**53  # larger integers are not exact as floats
_SHOWN = 100
_LONGEST_PATH = 1000

_DOTTED = re.compile(
    rf"""(?<![\w.-])(?:(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{_DEPTH}}}""",
)
"""A dotted key deeper than files may be, rejected early because the parser's time is quadratic in its length."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")

_TOML_HINTS = {
    "overwrite a value": "; a key is given twice: remove one",
    "after a key": '; quote keys with other characters than letters, digits, _ and -, as in "Na+" = 1.0',
    "Expected newline": "; give one key a line, and a point in decimal numbers",
}
"""Ends of messages about malformed TOML, by words that tomllib and tomli share."""

_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
"""Terminal control characters, and surrogates, which no file can encode."""


def toml_key(key: str) -> str:
    """Format a key for TOML, quoted if it has characters other than letters, digits, _ and -."""
    # TOML has JSON's escapes, and requires DEL to be escaped.
    return key if _BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False).replace("\x7f", "\\u007f")


class DataError(ValueError):
    """A data file (material, reaction, scenario) is invalid; the message names file, key, value and bound."""


def read_text(path: Path, limit: int = _FILE_BYTES) -> str:
    """Read a text file of at most ``limit`` bytes.

    Raises:
        DataError: the file is missing, too large, or not text; the message names it.
    """
    if "\0" in str(path):
        raise DataError(f"{str(path)!r}: a path must not contain a null character")
    try:
        content = read_bytes(path, limit)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file") from error
    except OSError as error:
        name = str(path) if len(str(path)) <= _LONGEST_PATH else shown(str(path))
        raise DataError(f"{name}: {error.strerror or error}") from error
    try:
        return content.decode("utf-8-sig")  # some editors of Windows begin a file with a mark
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: not UTF-8: {error}") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file.

    Raises:
        DataError: the file is missing, too large, malformed, or nested too deeply; the message names it.
    """
    try:
        text = read_text(path)
        if _DOTTED.search(text):
            raise DataError(f"{path}: a dotted key of more than {_DEPTH} parts")
        return dict(bounded(tomllib.loads(text), str(path)))
    except RecursionError as error:
        raise DataError(f"{path}: nested more than {_DEPTH} levels deep") from error
    except DataError:
        raise
    except ValueError as error:  # not TOML, not UTF-8, an integer of more digits than Python reads
        hint = next((hint for words, hint in _TOML_HINTS.items() if words in str(error)), "")
        raise DataError(f"{path}: not valid TOML: {error}{hint}") from error


def read_json(path: Path, limit: int = _FILE_BYTES) -> Any:
    """Parse a JSON file of at most ``limit`` bytes.

    Raises:
        DataError: the file is missing, too large, malformed, or nested too deeply; the message names it.
    """
    return parse_json(read_text(path, limit), str(path))


def parse_json(text: str, where: str) -> Any:
    """Parse a JSON text.

    Raises:
        DataError: the text is malformed or nested too deeply; the message begins with ``where``.
    """
    try:
        return bounded(json.loads(text), where)
    except RecursionError as error:
        raise DataError(f"{where}: nested more than {_DEPTH} levels deep") from error
    except DataError:
        raise
    except ValueError as error:
        raise DataError(f"{where}: not valid JSON: {error}") from error


def dotted_key(text: object, where: str) -> list[str]:
    """Return the parts of a dotted TOML key: ``costs.stock_per_mol.'Na+'``.

    Raises:
        DataError: the text is not a dotted key.
    """
    parts: list[str] = []
    try:
        if not isinstance(text, str) or "\n" in text or _DOTTED.search(text):
            raise ValueError(text)
        found = tomllib.loads(f"{text} = 0")
        while isinstance(found, dict):
            ((part, found),) = found.items()
            parts.append(part)
        if found != 0:
            raise ValueError(text)
    except ValueError as error:
        raise DataError(f"{where}: must be keys as in a.b or a.'Na+', given {shown(text)}") from error
    return parts


def bounded(content: Any, where: str) -> Any:
    """Return ``content`` after checking the size of every table, list, text and number in it.

    Raises:
        DataError: a value is nested too deeply, too long, too large or not finite, or a text has control characters.
    """

    # The location is a chain of keys, so that valid content needs no copies.
    def wrong(problem: str, at: Any) -> DataError:
        keys: list[str] = []
        while at is not None:
            at, key = at
            keys.insert(0, str(key))
        return DataError(f"{where}: {'.'.join(keys) or '(whole file)'}: {problem}")

    left: list[tuple[Any, int, Any]] = [(None, 0, content)]
    while left:
        at, depth, value = left.pop()
        if isinstance(value, str):
            if len(value) > _TEXT or _CONTROL.search(value):
                given = shown(value)
                raise wrong(f"a text must be {_TEXT} characters at most without control characters, given {given}", at)
            continue
        if isinstance(value, float):
            if not math.isfinite(value):
                raise wrong(f"must be a finite number, given {value}", at)
            continue
        if isinstance(value, int):
            if abs(value) > _INTEGER:
                bits = value.bit_length()
                raise wrong(f"an integer must be within {_INTEGER}, given one of {bits} bits", at)
            continue
        if isinstance(value, (dict, Mapping)):  # in this order, because checks against an abstract class are slow
            for key in value:
                if not isinstance(key, str) or not 0 < len(key) <= _KEY or not key.isprintable():
                    raise wrong(f"a key must be 1 to {_KEY} printable characters, given {shown(key)}", at)
            inside: Iterable[tuple[Any, Any]] = value.items()
        elif isinstance(value, (list, tuple)):
            inside = enumerate(value)
        else:
            continue
        if value and depth >= _DEPTH:
            raise wrong(f"nested more than {_DEPTH} levels deep", at)
        if len(value) > _ENTRIES:
            raise wrong(f"has {len(value)} entries; at most {_ENTRIES}", at)
        left += [((at, key), depth + 1, child) for key, child in inside]
    return content


def shown(value: Any) -> str:
    """Format a value for a message, with bounded length."""
    try:
        text = repr(value)
    except (RecursionError, ValueError):
        text = f"a {type(value).__name__}"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... ({len(text)} characters)"
