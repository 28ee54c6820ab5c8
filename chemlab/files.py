"""Writing files so that a crash loses nothing."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["replace_between", "write_text"]


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` by way of a temporary file: readers see the old file or the whole new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def replace_between(path: Path, mark: str, lines: list[str]) -> None:
    """Replace what stands between ``<!-- mark: begin -->`` and ``<!-- mark: end -->`` in a Markdown file.

    Raises:
        ValueError: the file does not have both marks in this order.
    """
    begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
    text = path.read_text(encoding="utf-8")
    start, stop = text.find(begin), text.find(end)
    if start < 0 or stop < start:
        raise ValueError(f"{path}: needs the lines {begin} and {end} around what is to be replaced")
    write_text(path, text[: start + len(begin)] + "\n" + "\n".join(lines) + "\n" + text[stop:])
