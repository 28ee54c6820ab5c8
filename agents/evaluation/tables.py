"""Tables of results: CSV files with a header, ``.csv`` or, packed, ``.csv.gz``."""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from chemlab.files import write_bytes

__all__ = ["markdown_table", "number", "read_table", "write_table"]


def number(value: float | None, decimals: int | None = None) -> str:
    """A number as a table has it, with at most so many decimals (None: as it is); an empty cell stands for None."""
    if value is None:
        return ""
    return repr(float(value) if decimals is None else round(float(value), decimals) + 0.0)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows as a file; the same rows make the same bytes."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = text.getvalue().encode()
    write_bytes(path, gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)


def read_table(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """The rows of a file, {column: cell}; none where there is no such file.

    Raises:
        ValueError: it is not a table, or has other columns.
    """
    try:
        content = path.read_bytes()
        text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode()
    except FileNotFoundError:
        return []
    except (OSError, EOFError, ValueError) as error:
        raise ValueError(f"{path}: not a table of results ({error})") from error
    reader = csv.DictReader(io.StringIO(text))
    rows = list(reader)
    if reader.fieldnames is None or list(reader.fieldnames) != list(columns):
        raise ValueError(f"{path}: has the columns {', '.join(reader.fieldnames or ())}; needs {', '.join(columns)}")
    if short := next((i for i, row in enumerate(rows, start=2) if None in row.values() or None in row), None):
        raise ValueError(f"{path}:{short}: has not {len(columns)} cells")
    return rows


def markdown_table(columns: Mapping[str, bool], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a Markdown table; ``columns``: {heading: whether it has numbers, which stand to the right}."""
    rules = ["--:" if numeric else "---" for numeric in columns.values()]
    return [f"| {' | '.join(columns)} |", f"|{'|'.join(rules)}|", *(f"| {' | '.join(cells)} |" for cells in rows)]
