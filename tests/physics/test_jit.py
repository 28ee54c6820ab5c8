"""Kernels' cache on disk: another version's must not stop anybody."""

from __future__ import annotations

import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import chemlab
from chemlab.kernels.jit import _checksum
from chemlab.kernels.rng import uniform

PLAY = """
import numpy as np
from chemlab.kernels.rng import uniform
print(uniform(np.array([7], dtype=np.uint64)))
"""


def here() -> str:
    """What it prints, in this process."""
    return f"{uniform(np.array([7], dtype=np.uint64))}\n"


def play(cache: Path) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", PLAY], capture_output=True, text=True, env=environment, timeout=900)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="without compiling there is no cache")
@pytest.mark.parametrize(
    "content",
    [
        # A class that is no more, a module that is no more, and a file that a crash has cut.
        pytest.param(pickle.dumps("stamp").replace(b"stamp", b"other"), id="other"),
        pytest.param(b"cchemlab.laboratory.view\nNoSuchClass\n.", id="class", marks=pytest.mark.slow),
        pytest.param(b"cchemlab.no_such_module\nAnything\n.", id="module", marks=pytest.mark.slow),
        pytest.param(b"\x80\x04", id="cut", marks=pytest.mark.slow),
    ],
)
def test_another_versions_cache_is_compiled_again(content: bytes, tmp_path: Path) -> None:
    assert play(tmp_path) == here()
    indices = list(tmp_path.rglob("*.nbi"))
    assert indices, "something was cached"
    for index in indices:
        index.write_bytes(_checksum(content) + content)
    assert play(tmp_path) == here()


@pytest.mark.slow
@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="without compiling there is no cache")
def test_damaged_files_are_compiled_again(tmp_path: Path) -> None:
    """Cut, or with a byte changed, at the beginning, in the middle and at the end, of index and code alike."""
    expected = play(tmp_path)
    files = {path: path.read_bytes() for path in (*tmp_path.rglob("*.nbi"), *tmp_path.rglob("*.nbc"))}
    assert len(files) >= 2
    for path, whole in files.items():
        for at in (0, 3, len(whole) // 2, len(whole) - 1):
            for damaged in (whole[:at], whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :]):
                path.write_bytes(damaged)
                assert play(tmp_path) == expected


@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="without compiling there is no cache")
@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ("caching.CompileResultCacheImpl._locator_classes = []", "no folder to keep compiled kernels in"),
        (
            "def full(*_):\n    raise OSError(28, 'No space left on device')\n"
            "caching.IndexDataCacheFile._open_for_write = full",
            "cannot be kept in",
        ),
    ],
    ids=["nowhere", "full"],
)
def test_without_a_place_for_the_cache_kernels_work_all_the_same(trouble: str, words: str, tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    code = f"from numba.core import caching\n{trouble}\n{PLAY}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=900)
    assert done.returncode == 0, done.stderr
    assert done.stdout == here()
    assert done.stderr.count("chemlab:") == 1
    assert words in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr


INTERRUPTED = """
import sys
from pathlib import Path
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
    print(doubled(1.5), flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
sys.stdin.read()
"""
"""A program with a kernel, of which the compilation may be interrupted; it lives until its input ends."""


@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="without compiling there is no cache")
def test_an_interrupted_compilation_keeps_no_other_process_waiting(tmp_path: Path) -> None:
    """The process that was interrupted lives on, as a notebook does, and another one compiles the kernel."""
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED, encoding="utf-8")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    command = [sys.executable, str(script)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    with subprocess.Popen([*command, "interrupted"], **pipes) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "interrupted\n"
        done = subprocess.run(
            [*command, "whole"], stdin=subprocess.DEVNULL, capture_output=True, text=True, env=environment, timeout=300
        )
        assert first.poll() is None
        first.communicate("")
    assert done.stdout == "3.0\n", done.stderr


@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="without compiling there is no cache")
@pytest.mark.parametrize("home", [True, False], ids=["home", "homeless"])
def test_kernels_are_kept_outside_the_package(home: bool, tmp_path: Path) -> None:
    """An installer would leave them behind, and the folder would hide an editable installation that comes after. They
    are beside the source all the same where no other folder can be written to."""
    packages, user = tmp_path / "packages", tmp_path / "user"
    shutil.copytree(Path(chemlab.__file__).parent, packages / "chemlab", ignore=shutil.ignore_patterns("__pycache__"))
    if home:
        user.mkdir()
    else:
        user.touch()
    homes = dict.fromkeys(("HOME", "USERPROFILE", "LOCALAPPDATA", "XDG_CACHE_HOME"), str(user))
    environment = {**os.environ, **homes, "PYTHONPATH": str(packages), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    code = f"{PLAY}import chemlab\nprint(chemlab.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=900
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{here()}{packages / 'chemlab' / '__init__.py'}\n"
    assert bool(list(user.rglob("*.nbi"))) == home
    assert bool(list(packages.rglob("__pycache__"))) != home
