"""Compiled kernels and their cache on disk."""

import gc
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import pytest
from numba import extending, types

import chemlab
from chemlab.kernels.arrays import FloatArray
from chemlab.kernels.jit import COMPILED, chained, inner, kernel, scratch

pytestmark = pytest.mark.skipif(not COMPILED, reason="nothing is compiled")

PLAY = """
import numpy as np
from chemlab.lab.experiments import _draw_grades
out = np.zeros(1, dtype=np.int64)
_draw_grades(np.zeros(1, dtype=np.int64), 1000, np.array([[7]], dtype=np.uint64), out)
print(out[0])
"""
"""A kernel that calls a helper of another file, ``uniform``."""


def start(code: str, cache: Path | str, **environment: str) -> subprocess.Popen[str]:
    """A program with a cache of its own."""
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=os.sep,  # not in a checkout, whose chemlab would be found first
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), **environment},
    )


def play(cache: Path | str, code: str = PLAY, **environment: str) -> tuple[str, str]:
    """Output and errors of a program."""
    process = start(code, cache, **environment)
    out, err = process.communicate(timeout=900)
    assert process.returncode == 0, err
    return out, err


def test_what_is_compiled_is_kept_and_used(tmp_path: Path) -> None:
    first = play(tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")}
    assert len(kept) >= 1
    assert play(tmp_path) == first
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")} == kept


def test_the_garbage_collector_rests_while_numba_compiles() -> None:
    enabled = []

    @extending.intrinsic
    def looked(context: Any) -> Any:
        enabled.append(gc.isenabled())
        return types.int64(), lambda context, builder, signature, arguments: context.get_constant(types.int64, 7)

    @numba.njit
    def within() -> int:
        return looked()

    @numba.njit
    def around() -> int:
        return within() + looked()

    assert around() == 14
    assert set(enabled) == {False}
    assert gc.isenabled()
    gc.disable()
    try:
        numba.njit(lambda: 7)()
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.slow
def test_an_edit_to_a_function_of_another_file_is_compiled(tmp_path: Path) -> None:
    """numba itself looks at the file of the kernel alone."""
    packages, cache = tmp_path / "packages", tmp_path / "cache"
    shutil.copytree(Path(chemlab.__file__).parent, packages / "chemlab", ignore=shutil.ignore_patterns("__pycache__"))
    environment = {"PYTHONPATH": str(packages), "PYTHONDONTWRITEBYTECODE": "1"}
    before, _ = play(cache, **environment)
    source = packages / "chemlab" / "kernels" / "rng.py"
    text = source.read_text(encoding="utf-8")
    source.write_text(text.replace("_UNIT = 1.0 /", "_UNIT = 0.5 /"), encoding="utf-8")
    after, _ = play(cache, **environment)
    assert int(after) == int(before) // 2
    assert len(list(cache.glob("kernels-*"))) == 2


@pytest.mark.slow
def test_kernels_that_nobody_uses_any_more_are_deleted(tmp_path: Path) -> None:
    old, recent, other = tmp_path / "kernels-0", tmp_path / "kernels-1", tmp_path / "mine"
    for folder in (old, recent, other):
        folder.mkdir()
    for folder in (old, other):
        os.utime(folder, (0.0, 0.0))
    play(tmp_path)
    assert (old.exists(), recent.exists(), other.exists()) == (False, True, True)


@pytest.mark.slow
@pytest.mark.parametrize("trouble", ["nowhere", "full", "homeless"])
def test_without_a_place_for_the_cache_kernels_work_all_the_same(trouble: str, tmp_path: Path) -> None:
    expected, _ = play(tmp_path / "cache")
    place = "" if trouble == "homeless" else tmp_path / trouble
    if trouble == "nowhere":
        (tmp_path / trouble).touch()
    before = {
        "full": "import shutil\nshutil.disk_usage = lambda path: type('usage', (), {'free': 0})\n",
        "homeless": "import pathlib\ndef homeless(*_): raise RuntimeError\npathlib.Path.home = homeless\n",
    }
    nowhere = dict.fromkeys(("XDG_CACHE_HOME", "LOCALAPPDATA"), "")
    out, err = play(place, before.get(trouble, "") + PLAY, **nowhere)
    assert out == expected
    assert err.count("chemlab:") == 1
    assert "cannot be stored" in err
    assert "NUMBA_CACHE_DIR" in err


@pytest.mark.slow
def test_processes_that_start_at_once_agree(tmp_path: Path) -> None:
    processes = [start(PLAY, tmp_path) for _ in range(3)]
    assert {process.communicate(timeout=900)[0] for process in processes} == {play(tmp_path)[0]}


INTERRUPTED = """
import sys
import numba.extending
from chemlab.kernels.jit import kernel

def _two(): ...

@numba.extending.overload(_two)
def _overload_two():
    if sys.argv[1] == "interrupted":
        raise KeyboardInterrupt
    return lambda: 2.0

@kernel
def doubled(x):
    return _two() * x

try:
    print(doubled(1.5))
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interrupted_compilation_leaves_nothing_behind(tmp_path: Path) -> None:
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    for how, printed in (("interrupted", "interrupted\n"), ("whole", "3.0\n")):
        words = [sys.executable, str(script), how]
        run = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=300)
        assert run.stdout == printed


def test_an_interruption_waits_for_the_function_that_is_compiled() -> None:
    """A callback of LLVM would print and ignore it."""
    met = []

    @extending.intrinsic
    def interrupting(context: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        met.append("still compiling")
        return types.int64(), lambda context, builder, signature, arguments: context.get_constant(types.int64, 7)

    @numba.njit
    def interrupted() -> int:
        return interrupting()

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored by what starts in the background
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert met
        assert interrupted() == 7
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_kernels_are_kept_outside_the_package(tmp_path: Path) -> None:
    """An installer would leave them behind, and the folder would hide an editable installation that comes after."""
    packages, user = tmp_path / "packages", tmp_path / "user"
    shutil.copytree(Path(chemlab.__file__).parent, packages / "chemlab", ignore=shutil.ignore_patterns("__pycache__"))
    user.mkdir()
    homes = dict.fromkeys(("HOME", "USERPROFILE", "LOCALAPPDATA", "XDG_CACHE_HOME"), str(user))
    environment = {**homes, "PYTHONPATH": str(packages), "PYTHONDONTWRITEBYTECODE": "1"}
    out, _ = play("", f"{PLAY}import chemlab\nprint(chemlab.__file__)", **environment)
    assert out.splitlines()[1] == str(packages / "chemlab" / "__init__.py")
    assert list(user.rglob("*.nbi"))
    assert not list(packages.rglob("*.nbi"))


def test_the_first_start_says_that_it_compiles_and_later_ones_do_not(tmp_path: Path) -> None:
    """Also of a backend's laws, which are compiled with the first chemistry."""
    code = "from chemlab.kernels.cache import told\nwith told('laws'):\n    pass\n"
    assert play(tmp_path, code)[1].count("compiling kernels") == 1
    assert play(tmp_path, code)[1] == ""


@inner
def _room() -> tuple[FloatArray, FloatArray]:
    return scratch(3), scratch(3)


@kernel
def _fill(x: float) -> float:
    one, other = _room()
    for i in range(3):
        one[i] = x
        other[i] = 2.0 * x
    return float(one[0] + one[1] + one[2] + other[2])


def test_scratch_of_an_inner_function_is_its_callers() -> None:
    assert _fill(1.5) == pytest.approx(7.5)


@kernel
def _once(work: float, chem: float) -> float:
    return work + chem


@kernel
def _twice(work: float, chem: float) -> float:
    return work + 2.0 * chem


_some = chained("some", [_once, _twice], -1.0)
_others = chained("others", [_twice, _once], -2.0)


@kernel
def _choose(number: int) -> float:
    return float(_some(number, 1.0, 10.0) + 100.0 * _others(number, 1.0, 10.0))


def test_chains_call_by_number() -> None:
    assert [_choose(number) for number in range(3)] == [2111.0, 1121.0, -201.0]
