"""Kernels compiled before the first step: side by side in two processes, with a line that says how far they are.

What is compiled is what a *rehearsal* calls: every turn that there is, of no laboratory at all, so nothing happens in
it. This process begins at its beginning and a child at its end; where they meet, each finds what the other has left in
the cache (:mod:`chemlab.kernels.jit` lets a process wait for a kernel that another is compiling). Where a child
cannot be started, or is of no use, this process does it all.
"""

from __future__ import annotations

import contextlib
import functools
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from . import jit

__all__ = ["Rehearsal", "compile_backwards", "compile_first"]

Rehearsal = Sequence[Callable[[], object]]
"""Calls that together need every kernel, in any order, and change nothing."""

_CHILD = """import sys
sys.path[:] = {path!r}
from chemlab.kernels.warmup import compile_backwards
compile_backwards()
"""
_IN_CHILD = "CHEMLAB_COMPILING"
"""Set in the environment of a child, which has no child of its own."""
_WORDS = "chemlab: compiling kernels for this machine (half a minute)"
_SOON = 2.0
"""Seconds after which a terminal sees how far it is."""


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_first(
    kernels: Sequence[Callable[..., Any]], dimensions: int, again: Callable[[], Rehearsal], rehearsal: Rehearsal
) -> None:
    """Go through a rehearsal, and tell who waits for it on standard error, unless the cache has what it needs.

    Args:
        kernels: the largest of those that it needs.
        dimensions: of the handles of their chemistry, which tell tiers apart.
        again: makes the same calls in another process; a function that can be pickled.
        rehearsal: the calls.
    """
    if not jit.COMPILED or _IN_CHILD in os.environ or all(jit.is_compiled(one, dimensions) for one in kernels):
        return
    done = [0, 0]
    """calls that this process and its child have ended"""
    # Of eight processes that begin at once one has a child: they wait for each other's kernels anyway.
    with jit.only_one(kernels[0]) as first, _child(again if first else None, done), _told(done, len(rehearsal)):
        for call in rehearsal:
            call()
            done[0] += 1


@contextlib.contextmanager
def _child(again: Callable[[], Rehearsal] | None, done: list[int]) -> Iterator[None]:
    """A process that goes through the rehearsal from its end, as long as the block runs, if there can be one."""
    child = None
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError, pickle.PicklingError):
        if again is not None and _cores() > 1 and sys.executable:
            work = pickle.dumps(again)
            # As this process finds modules, but nothing from the folder where it was started.
            path = [*filter(None, sys.path), str(Path(__file__).resolve().parents[2])]
            child = subprocess.Popen(
                [sys.executable, "-c", _CHILD.format(path=path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, _IN_CHILD: "1"},
            )
            # Writing takes as long as the child needs to begin to read.
            threading.Thread(target=_talk, args=(child.stdin, child.stdout, work, done), daemon=True).start()
    try:
        yield
    finally:
        if child is not None:
            child.kill()
            child.wait()


def compile_backwards() -> None:
    """What a child does: the rehearsal that comes on standard input, from its end, a line for each call."""
    for call in reversed(pickle.load(sys.stdin.buffer)()):
        call()
        print(flush=True)


def _talk(to_child: IO[bytes], from_child: IO[bytes], work: bytes, done: list[int]) -> None:
    with contextlib.suppress(OSError, ValueError):  # it may be gone
        to_child.write(work)
        to_child.close()
        for _line in from_child:
            done[1] += 1


@functools.cache
def _say_once() -> None:
    print(f"{_WORDS}; later starts load them from the cache", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _told(done: Sequence[int], calls: int) -> Iterator[None]:
    """Say on standard error that kernels are being compiled: once, or on a terminal how far they are."""
    if not sys.stderr.isatty():
        _say_once()
        yield
        return
    over, begun = threading.Event(), time.monotonic()

    def tell() -> None:
        while not over.wait(0.2):
            seconds = time.monotonic() - begun
            if seconds >= _SOON:
                share = min(sum(done), calls) / calls
                print(f"\r{_WORDS}: {share:4.0%}, {seconds:.0f} s\033[K", end="", file=sys.stderr, flush=True)
        print("\r\033[K", end="", file=sys.stderr, flush=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()
