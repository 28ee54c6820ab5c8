"""A checkout works as it is: installed, installed otherwise, or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.skipif(not (ROOT / "chemlab").is_dir(), reason="not a checkout")


def bare_python(*arguments: str) -> str:
    """What Python says that was started in the checkout, in which no installed chemlab can be found.

    ``-S`` leaves out what installations add to the import system; the dependencies come by their folders alone.
    """
    folders = [path for path in sys.path if path and (Path(path) / "numpy").is_dir()]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(folders)}
    command = [sys.executable, "-S", *arguments]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_command_runs() -> None:
    assert "wurtz_dodecane" in bare_python("-m", "chemlab", "list")


def test_environments_and_every_part_are_those_of_the_checkout() -> None:
    program = """
import gymnasium
import chemlab, chemlab.agents.policies, chemlab.scenarios
environment = gymnasium.make("chemlab/LabManager-v1", scenario="fictitious")
environment.reset(seed=0)
for module in (chemlab, chemlab.agents, chemlab.scenarios):
    print(module.__file__)
"""
    files = bare_python("-c", program).split()
    assert files == [str(ROOT / folder / "__init__.py") for folder in ("chemlab", "agents", "scenarios")]
