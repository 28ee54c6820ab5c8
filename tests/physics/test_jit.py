"""Kernels' cache on disk: another version's must not stop anybody."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

PLAY = """
import numpy as np
from chemlab.rng import uniform
print(uniform(np.array([7], dtype=np.uint64)))
"""


def play(cache: Path) -> str:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", PLAY], capture_output=True, text=True, env=environment, timeout=300)
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
    expected = play(tmp_path)
    indices = list(tmp_path.rglob("*.nbi"))
    assert indices, "something was cached"
    for index in indices:
        version = pickle.dumps(__import__("numba").__version__)
        index.write_bytes(version + content)
    assert play(tmp_path) == expected
