"""Tables of results: CSV files with a header, plain (``.csv``) or compressed (``.csv.gz``); Markdown tables."""

from __future__ import annotations

import csv
import gzip
import io
import itertools
import sys
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from chemlab.config.display import inert
from chemlab.config.files import read_bytes, write_bytes, write_text

_TABLE_BYTES, _TABLE_ROWS = 32_000_000, 500_000
"""Maximum size of an uncompressed table: several times the curves of a thousand runs."""


def number(value: float | None, decimals: int | None = None) -> str:
    """Return the cell of a number, rounded to ``decimals`` (None: with all digits); None is an empty cell."""
    if value is None:
        return ""
    return repr(float(value) if decimals is None else round(float(value), decimals) + 0.0)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as a file; equal rows give equal bytes."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = text.getvalue().encode()
    write_bytes(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def read_table(
    path: Path, columns: Sequence[str], numbers: Mapping[str, type] | None = None, blank: Sequence[str] = ()
) -> list[dict[str, str]]:
    """Return the rows of a file, {column: cell}; an empty list if the file does not exist.

    Args:
        path: the file.
        columns: required columns, in order.
        numbers: type of numeric columns by name, ``int`` or ``float``; names that are not in ``columns`` are ignored.
        blank: numeric columns whose cells may be empty.

    Raises:
        ValueError: the file is not a table, is too large, has other columns, or has a cell that is not a number.
    """
    try:
        content = read_bytes(path, _TABLE_BYTES)
        if path.suffix == ".gz":
            with gzip.open(io.BytesIO(content)) as file:
                content = file.read(_TABLE_BYTES + 1)
        if len(content) > _TABLE_BYTES:
            raise ValueError(f"more than {_TABLE_BYTES} bytes")
        reader = csv.DictReader(io.StringIO(content.decode()))
        rows = list(itertools.islice(reader, _TABLE_ROWS + 1))
        if len(rows) > _TABLE_ROWS:
            raise ValueError(f"more than {_TABLE_ROWS} rows")
    except FileNotFoundError:
        return []
    except (OSError, EOFError, ValueError, zlib.error, csv.Error) as error:
        raise ValueError(f"{path}: not a table of results ({error})") from error
    given = list(reader.fieldnames or ())
    if given != list(columns):
        raise ValueError(f"{path}: has the columns {', '.join(given)[:300]}; needs {', '.join(columns)}")
    if wrong := next((i for i, row in enumerate(rows, start=2) if None in row.values() or None in row), None):
        raise ValueError(f"{path}:{wrong}: must have {len(columns)} cells")
    for column in columns:
        kind = (numbers or {}).get(column, str)
        for line, row in enumerate(rows if kind is not str else (), start=2):
            if not _is_number(row[column], kind) and (row[column] or column not in blank):
                raise ValueError(f"{path}:{line}: {column}: must be a number, given {row[column]!r:.100}")
    return rows


def _is_number(cell: str, kind: type) -> bool:
    try:
        return bool(abs(kind(cell)) <= sys.float_info.max)
    except ValueError:
        return False


def markdown_table(columns: Mapping[str, bool], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table; ``columns`` is {heading: True to align it to the right, as numbers}."""
    rules = ["--:" if numeric else "---" for numeric in columns.values()]
    return [f"| {' | '.join(columns)} |", f"|{'|'.join(rules)}|", *(f"| {' | '.join(cells)} |" for cells in rows)]


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a page in Markdown; names of runs are text there, and lines that begin with ``![`` are its pictures."""
    shown = (line if line.startswith("![") else inert(line) for line in lines)
    write_text(path, "\n".join(shown) + "\n")
