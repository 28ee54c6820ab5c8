"""Reading files within bounds; writing them so that a crash loses nothing, and leaves nothing behind for good."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

__all__ = [
    "check_apart",
    "check_folder",
    "check_marks",
    "check_target",
    "draft_of",
    "locked",
    "naming",
    "open_regular",
    "read_bytes",
    "replace_between",
    "sync_file",
    "sync_folder",
    "write_bytes",
    "write_text",
    "write_texts",
]

_DRAFT = ".draft-"
"""What names of drafts begin with, so that those left by a killed process can be told from anything of the user's."""
_ABANDONED_S = 60.0
"""A draft that nobody has written to for so long has no writer any more."""
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Errors of file systems without locks."""
_LOCKED_BYTE = 2**30
"""Position of the byte that stands for a whole file, where a system locks bytes."""


def open_regular(path: Path, limit: int) -> BinaryIO:
    """Open a regular file of at most ``limit`` bytes for reading.

    Pipes, devices and folders, and links to them, are refused without waiting for anybody: reading them might never
    end.

    Raises:
        OSError: it is no such file, or cannot be opened; the error names it.
    """
    name = os.fspath(path)
    if not stat.S_ISREG(os.stat(name).st_mode):  # opening some devices has effects already
        raise OSError(errno.EINVAL, "is not a regular file", name)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    handle = os.open(name, flags)
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):  # somebody has replaced it in between
            raise OSError(errno.EINVAL, "is not a regular file", name)
        if found.st_size > limit:
            raise OSError(errno.EFBIG, f"is larger than {limit} bytes", name)
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a regular file of at most ``limit`` bytes; errors as :func:`open_regular`."""
    with open_regular(path, limit) as file:
        content = file.read(limit + 1)
    if len(content) > limit:  # it has grown, or is one of those that the system says no size of
        raise OSError(errno.EFBIG, f"is larger than {limit} bytes", os.fspath(path))
    return content


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """A draft to write to, which replaces ``path`` when the block ends: readers see the old file or the whole new one.

    The draft lies in the same folder and has no suffix, so that nobody takes it for a result. It reaches the disk
    before it takes the name, and so does the name before this returns. Where the block fails nothing has changed.

    Raises:
        OSError: it cannot be written; the error names ``path``.
    """
    draft = path.parent / f"{_DRAFT}{os.getpid()}-{secrets.token_hex(4)}"
    try:
        if path.exists() and not path.is_file():  # a device is not to be replaced by a file
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path.parent)
        yield draft
        sync_file(draft)
        draft.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        # Of the draft the user has never heard.
        at = path if error.filename in (None, str(draft)) else error.filename
        raise OSError(error.errno, error.strerror or str(error), str(at)) from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` whole or not at all (see :func:`draft_of`)."""
    with draft_of(path) as draft:
        draft.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8, whole or not at all (see :func:`draft_of`)."""
    write_bytes(path, text.encode())


def write_texts(texts: Mapping[Path, str]) -> None:
    """Write several files that belong together: all of them, or none where one has no room (see :func:`draft_of`).

    Every text is on the disk before the first file takes its name; the first in ``texts`` takes its name last.
    """
    with ExitStack() as drafts:
        for path, text in texts.items():
            draft = drafts.enter_context(draft_of(path))
            draft.write_bytes(text.encode())
            sync_file(draft)


def sync_file(path: Path) -> None:
    """Wait until a file's content is on the disk."""
    with path.open("rb+") as handle:
        os.fsync(handle.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until a folder's names are on the disk, where the system lets one ask for that."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems refuse it for folders
            os.fsync(handle)
    finally:
        os.close(handle)


def _sweep(folder: Path) -> None:
    """Remove drafts that killed processes have left in a folder."""
    now = time.time()
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(_DRAFT):
                with contextlib.suppress(OSError):  # somebody else has swept it
                    if entry.is_file(follow_symlinks=False) and now - entry.stat().st_mtime > _ABANDONED_S:
                        os.unlink(entry.path)


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


def check_target(path: Path) -> None:
    """See that a file can be written, and make its folder: before there is anything to lose.

    Raises:
        ValueError: it cannot.
        OSError: no file can be called so.
    """
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: {'is a folder' if path.is_dir() else 'not a regular file'}; give a file's name")
    check_folder(path.parent)


def check_apart(outputs: Iterable[Path], inputs: Iterable[Path] = ()) -> None:
    """See that a command writes no file twice, and none that it reads.

    Raises:
        ValueError: it would; the message names the file.
    """
    written: list[Path] = []
    for path in outputs:
        if any(_same_file(path, other) for other in written):
            raise ValueError(f"{path}: is given twice, as the file of two results; give each a file of its own")
        written.append(path)
    for path in inputs:
        if any(_same_file(path, other) for other in written):
            raise ValueError(f"{path}: is read by this command and would be replaced by its result; give another name")


def _same_file(one: Path, other: Path) -> bool:
    """Whether two paths lead to the same file, by links or another spelling, too."""
    with contextlib.suppress(OSError):  # one of them is not there yet
        return one.samefile(other)
    return os.path.realpath(one) == os.path.realpath(other)


def locked(descriptor: int) -> bool:
    """Take the system's lock on an open file, which ends when that is closed; False where somebody else has it.

    Some network file systems have no locks: there every process gets it.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            # Others cannot read a byte that is locked there: it is one that no file has.
            position = os.lseek(descriptor, 0, os.SEEK_CUR)
            os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
            try:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            finally:
                os.lseek(descriptor, position, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in _NO_LOCKS
    return True


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Have errors of the system that name no file name ``path``."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


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
