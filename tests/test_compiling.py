"""Compiling before the first step: two processes, every kernel once, nothing changed."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from chemlab.kernels.jit import COMPILED
from chemlab.kernels.warmup import compile_first
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch

compiled = pytest.mark.skipif(not COMPILED, reason="nothing is compiled")
NEW: Any = SimpleNamespace(_cache=SimpleNamespace(_cache_file=SimpleNamespace(_load_index=dict)))
"""Stands for a kernel that nobody has compiled."""


def wait_for(file: Path) -> None:
    end = time.monotonic() + 60.0
    while not file.exists():
        assert time.monotonic() < end, f"{file} does not come"
        time.sleep(0.01)


def note(folder: Path, number: int) -> None:
    with (folder / "calls").open("a") as calls:
        calls.write(f"{number} ")
    (folder / str(number)).touch()


def notes(folder: Path) -> list[Callable[[], object]]:
    return [functools.partial(note, folder, number) for number in range(3)]


def no_rehearsal() -> list[Callable[[], object]]:
    raise RuntimeError("this child is of no use")


@compiled
@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="not Linux")
def test_a_child_begins_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("chemlab.kernels.warmup._cores", lambda: 2)
    compile_first([NEW], 2, functools.partial(notes, tmp_path), [lambda: wait_for(tmp_path / "0")])
    assert (tmp_path / "calls").read_text() == "2 1 0 "


@compiled
@pytest.mark.parametrize("trouble", ["useless child", "one core", "no Python", "cannot be sent"])
def test_without_a_child_all_is_compiled_here(
    trouble: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("chemlab.kernels.warmup._cores", lambda: 1 if trouble == "one core" else 2)
    if trouble == "no Python":
        monkeypatch.setattr(sys, "executable", "")
    done: list[int] = []
    calls = [functools.partial(done.append, number) for number in range(5)]
    compile_first([NEW], 2, no_rehearsal if trouble == "useless child" else lambda: calls, calls)
    assert done == list(range(5))
    assert "Traceback" not in capfd.readouterr().err


@compiled
def test_nothing_is_called_where_everything_is_compiled() -> None:
    compile_first([], 2, no_rehearsal, [no_rehearsal])


@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "recrystallization", "unlabelled", "failing", "relay"])
def test_a_rehearsal_changes_nothing(scenario: str) -> None:
    labs = Laboratories(scenario, 2)
    for member in range(2):
        labs.seed(member, 7)
    labs.reset(labs.members)
    before = labs.snapshot()
    for call in labs.rehearsal():
        call()
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, labs.snapshot(), strict=True))


def test_a_rehearsal_of_a_bench_changes_nothing() -> None:
    batch = ExperimentBatch("wurtz_dodecane", "ext", 2)
    batch.seed(0, 7)
    batch.reset(batch.members)
    before = [array.copy() for array in batch.arrays()]
    for call in batch.rehearsal():
        call()
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, batch.arrays(), strict=True))


EPISODE = """
from chemlab.kernels import jit
from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.laboratory import raw_env

env = raw_env("wurtz_dodecane")
for call in env.laboratories.rehearsal():
    call()
late, load = [], jit._CheckedCacheFile.load
jit._CheckedCacheFile.load = lambda self, key: late.append(self._index_name) or load(self, key)
play_episode(env, make_policies("scripted", env.laboratories, 0), 0)
print(late)
"""
TOGETHER = """
import numpy as np
from numba.core import event
from chemlab.kernels.rng import normal

with event.install_recorder("numba:compile") as compiled:
    normal(np.array([7], dtype=np.uint64))
print(sum(e.data["dispatcher"].py_func is normal.py_func and e.is_start for _, e in compiled.buffer))
"""
LOADED = """
import sys
import numba
import numpy as np
from chemlab.kernels.rng import uniform

print(uniform(np.array([7], dtype=np.uint64)), "numba.np.arraymath" in sys.modules)
print(numba.njit(lambda numbers: numbers.sum())(np.ones(3)))
"""


def start(code: str, cache: Path | None = None) -> subprocess.Popen[str]:
    environment = {**os.environ, **({} if cache is None else {"NUMBA_CACHE_DIR": str(cache)})}
    return subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment)


@compiled
def test_after_a_rehearsal_nothing_is_left_to_compile() -> None:
    """An episode looks nothing up in the cache of kernels any more."""
    out, _ = start(EPISODE).communicate(timeout=1800)
    assert out.strip() == "[]"


@compiled
@pytest.mark.skipif(sys.platform == "win32", reason="there is no telling who compiles what")
def test_several_processes_compile_a_kernel_once(tmp_path: Path) -> None:
    processes = [start(TOGETHER, tmp_path) for _ in range(2)]
    counts = [int(process.communicate(timeout=900)[0]) for process in processes]
    assert sum(counts) == 1


@compiled
def test_a_kernel_in_the_cache_is_loaded_without_numbas_compiler(tmp_path: Path) -> None:
    """Which is there all the same for whoever compiles something."""
    first, second = (start(LOADED, tmp_path).communicate(timeout=900)[0].split() for _ in range(2))
    assert first[1:] == ["True", "3.0"]
    assert second == [first[0], "False", "3.0"]
