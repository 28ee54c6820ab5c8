"""The one way a chemlab function is compiled."""

from __future__ import annotations

import functools
import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

__all__ = ["announce_compiling", "helper", "kernel"]

_announced = False

F = TypeVar("F", bound=Callable[..., Any])


@functools.cache
def _fingerprint(own: str) -> str:
    """Hash of every source file kernels are written in, and of a kernel's ``own`` file."""
    root = Path(__file__).resolve().parent.parent
    files = [
        root / "shelf.py",
        *(file for room in ("physics", "bench", "laboratory") for file in (root / room).glob("*.py")),
    ]
    digest = hashlib.blake2b(digest_size=16)
    for path in [*sorted(files), Path(own)]:
        source = path.read_bytes()
        # An edit to a file without kernels must not have all of them compiled again.
        if path.parent.name in ("physics", root.name) or b"jit import" in source:
            digest.update(source)
    return digest.hexdigest()


def kernel(function: F, **options: Any) -> F:
    """Compile ``function`` with numba on first use, cached on disk, releasing the GIL.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead, slowly, for debugging.
    """
    # _nrt=False: kernels allocate nothing, so numba need not count references to the arrays handed to them; that
    # counting (atomic, twice an array, at every inner call) took ten times as long as the physics.
    settings: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, **options}
    compiled: Any = numba.njit(**settings)(function)
    # numba invalidates a cached kernel by its own file's time stamp alone: a kernel that inlines an edited
    # function from another file would go on running the old code. One stamp over all sources mends that.
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = _fingerprint(function.__code__.co_filename)
        cache_file._load_index = functools.partial(_index_or_nothing, cache_file._load_index)
    return cast(F, compiled)  # numba's dispatcher stands in for the function


def _index_or_nothing(load: Callable[[], Any]) -> Any:
    """What a kernel's cache holds; nothing if it is another version's.

    An index names argument types by their classes. One that this version does not have any more must mean compiling
    again, not an error.
    """
    try:
        return load()
    except (AttributeError, ImportError, EOFError, TypeError, ValueError, pickle.UnpicklingError):
        return {}


def helper(function: F) -> F:
    """A kernel that is always inlined: for what is called many times a step.

    A call hands over every array of a Chemistry, some hundred machine words: more than a small function costs.
    """
    return kernel(function, forceinline=True)


def announce_compiling(*kernels: Callable[..., Any]) -> None:
    """Tell the user, once a process and on standard error, when kernels have to be compiled before the first steps."""
    global _announced
    if not _announced and not _is_compiled(*kernels):
        _announced = True
        print(
            "chemlab: compiling kernels for this machine (half a minute); later starts load them from the cache",
            file=sys.stderr,
            flush=True,
        )


def _is_compiled(*kernels: Callable[..., Any]) -> bool:
    """Whether each kernel can be loaded from the disk cache (or needs no compiling), so that nobody has to wait for
    it."""
    for function in kernels:
        cache_file = getattr(getattr(function, "_cache", None), "_cache_file", None)
        if cache_file is not None and not cache_file._load_index():
            return False
    return True
