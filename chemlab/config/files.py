"""Bounded reading of files, and atomic writing that leaves no partial files after a crash."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import secrets
import stat
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

DRAFT = ".draft-"
"""Prefix of the names of drafts, by which drafts of killed processes are recognized."""
_ABANDONED_S = 60.0
"""Age in seconds without writes after which a draft counts as abandoned."""
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
"""Errors of file systems without locks."""
_PAUSE_S = 0.02
"""Time in seconds between two attempts to lock a file."""
_LOCKED_BYTE = 2**30
"""Position of the byte that represents a whole file on systems that lock bytes."""


def open_regular(path: Path, limit: int) -> BinaryIO:
    """Open a regular file of at most ``limit`` bytes for reading.

    Pipes, devices and folders, and links to them, are rejected without blocking, because reading them might never end.

    Raises:
        OSError: it is not such a file, or cannot be opened; the error names it.
    """
    name = os.fspath(path)
    if not stat.S_ISREG(os.stat(name).st_mode):  # opening some devices has side effects
        raise OSError(errno.EINVAL, "is not a regular file", name)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    handle = os.open(name, flags)
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):  # replaced in between
            raise OSError(errno.EINVAL, "is not a regular file", name)
        if found.st_size > limit:
            raise OSError(errno.EFBIG, f"is larger than {limit} bytes", name)
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bytes(path: Path, limit: int) -> bytes:
    """Read a regular file of at most ``limit`` bytes; errors as for :func:`open_regular`."""
    with open_regular(path, limit) as file:
        content = file.read(limit + 1)
    if len(content) > limit:  # the file has grown, or the system reports no size
        raise OSError(errno.EFBIG, f"is larger than {limit} bytes", os.fspath(path))
    return content


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Yield a draft that replaces ``path`` when the block ends, so that readers see the old or the complete new file.

    The draft is in the same folder and has no suffix, so that it is not taken for a result. It is flushed to disk
    before it is renamed, and the folder is flushed before this returns. If the block fails, nothing changes.

    Raises:
        OSError: it cannot be written; the error names ``path``.
    """
    draft = path.parent / f"{DRAFT}{os.getpid()}-{secrets.token_hex(4)}"
    try:
        if path.exists() and not path.is_file():  # a device must not be replaced by a file
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path.parent)
        yield draft
        sync_file(draft)
        draft.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        # The user does not know the draft.
        at = path if error.filename in (None, str(draft)) else error.filename
        raise OSError(error.errno, error.strerror or str(error), str(at)) from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Write ``content`` to ``path`` atomically (see :func:`draft_of`)."""
    with draft_of(path) as draft:
        draft.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path`` as UTF-8 atomically (see :func:`draft_of`)."""
    write_bytes(path, text.encode())


def write_json(path: Path, value: Any) -> None:
    """Write a value to ``path`` as indented JSON atomically (see :func:`draft_of`)."""
    write_text(path, json.dumps(value, indent=1) + "\n")


def write_texts(texts: Mapping[Path, str]) -> None:
    """Write several related files: all, or none if there is no space (see :func:`draft_of`).

    Every text is flushed to disk before the first file is renamed; the first in ``texts`` is renamed last.
    """
    with ExitStack() as drafts:
        for path, text in texts.items():
            draft = drafts.enter_context(draft_of(path))
            draft.write_bytes(text.encode())
            sync_file(draft)


def sync_file(path: Path) -> None:
    """Flush a file's content to disk."""
    with path.open("rb+") as handle:
        os.fsync(handle.fileno())


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to disk if the system supports it."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems do not support it for folders
            os.fsync(handle)
    finally:
        os.close(handle)


def _sweep(folder: Path) -> None:
    """Remove drafts of killed processes from a folder."""
    now = time.time()
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(DRAFT):
                with contextlib.suppress(OSError):  # another process has removed it
                    if entry.is_file(follow_symlinks=False) and now - entry.stat().st_mtime > _ABANDONED_S:
                        os.unlink(entry.path)


def check_folder(path: Path) -> None:
    """Check that a folder, or the nearest one above it that exists, is writable, before any results exist.

    Raises:
        ValueError: it is not writable.
    """
    try:
        with tempfile.TemporaryFile(dir=next(at for at in (path, *path.absolute().parents) if at.exists())):
            pass
    except OSError as error:
        raise ValueError(f"{path}: cannot write there: {error.strerror}; give another folder") from error


def check_target(path: Path, force: bool) -> None:
    """Check that a file can be written, before any results exist.

    Raises:
        ValueError: it exists, unless ``force`` allows to overwrite it, or cannot be written.
        OSError: the name is not possible.
    """
    if path.is_file() and not force:
        raise ValueError(f"{path}: already exists; give another name, or use --force to overwrite it")
    if os.path.lexists(path) and not path.is_file():  # also a link that leads nowhere
        raise ValueError(f"{path}: {'is a folder' if path.is_dir() else 'not a regular file'}; give a file's name")
    check_folder(path.parent)


def check_apart(outputs: Iterable[Path], inputs: Iterable[Path] = ()) -> None:
    """Check that a command's outputs are distinct and differ from its inputs.

    Raises:
        ValueError: they do not; the message names the file.
    """
    written: list[Path] = []
    for path in outputs:
        if any(_same_file(path, other) for other in written):
            raise ValueError(f"{path}: is given for two outputs; give each its own file")
        written.append(path)
    for path in inputs:
        if any(_same_file(path, other) for other in written):
            raise ValueError(f"{path}: is an input of this command and would be overwritten; give another name")


def _same_file(one: Path, other: Path) -> bool:
    """Return True if two paths refer to the same file, also through links or different spellings."""
    with contextlib.suppress(OSError):  # one of them does not exist yet
        return one.samefile(other)
    return os.path.realpath(one) == os.path.realpath(other)


def locked(descriptor: int) -> bool:
    """Lock an open file until it is closed; return False if another process has locked it.

    On network file systems without locks, every process succeeds.
    """
    try:
        if sys.platform == "win32":
            import msvcrt

            # On such systems a locked byte cannot be read: use one beyond the end of any file.
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


def wait_locked(descriptor: int, seconds: float) -> bool:
    """Lock an open file like :func:`locked`; wait up to ``seconds`` for another process."""
    until = time.monotonic() + seconds
    while not locked(descriptor):
        if time.monotonic() >= until:
            return False
        time.sleep(_PAUSE_S)
    return True


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add ``path`` to system errors that name no file."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def check_marks(path: Path, mark: str) -> tuple[str, int, int]:
    """Return a Markdown file's text, and the start and end of the part between its marks.

    The marks are ``<!-- mark: begin -->`` and ``<!-- mark: end -->``.

    Raises:
        ValueError: the file does not exist, or does not have both marks in this order.
    """
    begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
    if not path.is_file():
        raise ValueError(f"{path}: no such file; it needs the lines {begin} and {end} around the part to be replaced")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is not a text file: {error}; give a Markdown file") from error
    start, stop = text.find(begin), text.find(end)
    if start < 0 or stop < start:
        raise ValueError(f"{path}: needs the lines {begin} and {end} around the part to be replaced")
    return text, start + len(begin), stop


def replace_between(path: Path, mark: str, lines: list[str]) -> None:
    """Replace the part between a file's marks, see :func:`check_marks`."""
    text, start, stop = check_marks(path, mark)
    write_text(path, text[:start] + "\n" + "\n".join(lines) + "\n" + text[stop:])
