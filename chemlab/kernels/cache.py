"""The folder of compiled kernels.

numba stores them in its own cache, in a folder that is named by a hash of the sources of all kernels. numba itself
checks the time stamp of a kernel's own file only, so it would run an outdated version of a function from another file.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numba

_UNUSED_S = 60 * 86400.0
"""Seconds without use after which kernels of other sources are deleted."""
_ROOM_BYTES = 100 * 1024**2
"""Minimum free space for storing kernels."""


@functools.cache
def folder(module: str) -> Path | None:
    """Return the cache folder of kernels from chemlab's sources, and from those of another module (or package).

    It is below ``NUMBA_CACHE_DIR`` or the user's cache. None if kernels cannot be stored.
    """
    user = {"win32": "LOCALAPPDATA"}.get(sys.platform, "XDG_CACHE_HOME")
    below = "Library/Caches" if sys.platform == "darwin" else ".cache"
    try:
        place = Path(numba.config.CACHE_DIR or Path(os.environ.get(user) or Path.home() / below) / "chemlab")
        found = place / f"kernels-{_sources('chemlab')}"
        own = found if module.partition(".")[0] == "chemlab" else found / _sources(module)
        own.mkdir(parents=True, exist_ok=True)
        os.utime(found)
        if os.access(own, os.W_OK) and shutil.disk_usage(own).free > _ROOM_BYTES:
            _delete_unused(place)
            return own
        reason: Any = f"{place} is not writable, or full"
    except (OSError, RuntimeError) as error:  # a user without a home folder is a RuntimeError
        reason = error
    _say_once(
        f"compiled kernels cannot be stored ({reason}), so every process compiles them again; set NUMBA_CACHE_DIR to "
        "another folder"
    )
    return None


def _delete_unused(place: Path) -> None:
    """Delete the kernels of sources that no process has used for :data:`_UNUSED_S`."""
    for other in place.glob("kernels-*"):
        with contextlib.suppress(OSError):
            if time.time() - other.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(other, ignore_errors=True)


@functools.cache
def _sources(module: str) -> str:
    """Return a hash of all source files that contain the kernels of a module or package."""
    if module == "chemlab":
        root = Path(__file__).resolve().parents[1]
        kept = [root / "kernels", root / "physics"]
        # An edit to a file without kernels must not invalidate them.
        read = {path: path.read_bytes() for path in sorted(root.rglob("*.py"))}
        read = {path: text for path, text in read.items() if {*kept} & {*path.parents} or b"jit import" in text}
    else:
        origin = Path(str(importlib.import_module(module).__file__))
        files = sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]
        read = {path: path.read_bytes() for path in files}
    return hashlib.blake2b(b"".join(read.values()), digest_size=8).hexdigest()


@functools.cache
def _say_once(words: str) -> None:
    print(f"chemlab: {words}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def told(name: str) -> Any:
    """Print a line if the block compiles kernels for the first time with this cache."""
    place = folder("chemlab")
    mark = place / f"{name}.compiled" if place is not None else None
    if mark is None or not mark.exists():
        _say_once("compiling kernels for this machine (30 to 60 seconds); later starts load them from the cache")
    yield
    if mark is not None:
        with contextlib.suppress(OSError):
            mark.touch()
