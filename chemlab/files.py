"""Writing files so that a crash loses nothing."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

__all__ = ["check_folder", "check_marks", "replace_between", "write_bytes", "write_text"]


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` by way of a temporary file: readers see the old file or the whole new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8, see :func:`write_bytes`."""
    write_bytes(path, text.encode())


def check_folder(path: Path) -> None:
    """Make a folder if it is not there, and see that files can be written to it: before there is anything to lose.

    Raises:
        ValueError: they cannot.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise ValueError(f"{path}: cannot write there: {error.strerror}; give another folder") from error


def check_marks(path: Path, mark: str) -> tuple[str, int, int]:
    """A Markdown file's text, and where what stands between ``<!-- mark: begin -->`` and ``<!-- mark: end -->`` begins
    and ends in it.

    Raises:
        ValueError: the file is not there, or does not have both marks in this order.
    """
    begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
    if not path.is_file():
        raise ValueError(f"{path}: no such file; it needs the lines {begin} and {end} around what is to be replaced")
    text = path.read_text(encoding="utf-8")
    start, stop = text.find(begin), text.find(end)
    if start < 0 or stop < start:
        raise ValueError(f"{path}: needs the lines {begin} and {end} around what is to be replaced")
    return text, start + len(begin), stop


def replace_between(path: Path, mark: str, lines: list[str]) -> None:
    """Replace what stands between a file's marks, see :func:`check_marks`."""
    text, start, stop = check_marks(path, mark)
    write_text(path, text[:start] + "\n" + "\n".join(lines) + "\n" + text[stop:])
