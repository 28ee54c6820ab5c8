"""The comparison of two commits: what makes it fail. Checkouts say rates that their files hold; nothing is timed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "studies" / "speed" / "compare_commits.py"


def checkout(folder: Path, text: str) -> Path:
    """A commit whose throughput.py is as given."""
    (folder / "studies" / "speed").mkdir(parents=True)
    (folder / "studies" / "speed" / "throughput.py").write_text(text)
    return folder


def compared(tmp_path: Path, before: str, after: str, *words: str) -> subprocess.CompletedProcess[str]:
    old, new = checkout(tmp_path / "before", before), checkout(tmp_path / "after", after)
    command = [sys.executable, str(SCRIPT), "--before", str(old), sys.executable, "--after", str(new), sys.executable]
    return subprocess.run([*command, "--rows", "CartPole", *words], capture_output=True, text=True)


@pytest.mark.parametrize(("least", "code"), [("0.6", 0), ("0.7", 0), ("0.71", 1)])
def test_a_rate_below_the_least_ratio_fails(least: str, code: int, tmp_path: Path) -> None:
    found = compared(
        tmp_path,
        "def single(name, seconds):\n    return 100.0",
        "def single(name, seconds):\n    return 70.0",
        "--least",
        least,
    )
    assert "0.70  [0.70, 0.70]" in found.stdout
    assert found.returncode == code
    assert ("CartPole" in found.stderr) == bool(code)


def test_a_row_that_is_slow_once_is_measured_again(tmp_path: Path) -> None:
    """The first call warms up; three of the first five pairs are slow, and none of the next five."""
    rates = "RATES = iter([1.0, {first}, *[100.0] * 10])\ndef single(name, seconds):\n    return next(RATES)"
    slow = rates.format(first="50.0, 50.0, 50.0, 100.0, 100.0")
    quick = rates.format(first="100.0, 100.0, 100.0, 100.0, 100.0")
    assert compared(tmp_path / "slow", quick, slow, "--least", "0.9").returncode == 0
    slow = rates.format(first=", ".join(["50.0"] * 9))
    found = compared(tmp_path / "slower", quick, slow, "--least", "0.9")
    assert (found.returncode, "0.50" in found.stdout) == (1, True)


def test_what_the_older_commit_cannot_measure_is_left_out(tmp_path: Path) -> None:
    """And what the newer cannot is a failure."""
    here, gone = "def single(name, seconds):\n    return 1.0", ""
    new = compared(tmp_path / "new", gone, here, "--least", "0.8")
    assert (new.returncode, new.stdout) == (0, "")
    assert "name 'single' is not defined" in new.stderr
    assert compared(tmp_path / "lost", here, gone, "--least", "0.8").returncode == 1
