"""The comparison of two commits: what makes it fail. Checkouts say rates that their files hold; nothing is timed."""

import subprocess
import sys
from pathlib import Path

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


RATES = "RATES = iter([1.0, {first}, *[{rest}] * 10])\ndef single(name, seconds):\n    return next(RATES)"


def test_a_row_that_is_too_slow_twice_fails(tmp_path: Path) -> None:
    """The first call warms up; where three of the first five pairs are slow, five more are measured."""
    before = RATES.format(first="100.0", rest="100.0")
    for case, (first, rest, least, code) in enumerate(
        (("50.0, 50.0, 50.0, 100.0, 100.0", "100.0", "0.9", 0), ("70.0", "70.0", "0.7", 0), ("70.0", "70.0", "0.71", 1))
    ):
        found = compared(tmp_path / str(case), before, RATES.format(first=first, rest=rest), "--least", least)
        assert found.returncode == code, found.stderr
        assert ("0.70  [0.70, 0.70]" in found.stdout) == (case > 0)
        assert ("CartPole" in found.stderr) == bool(code)


def test_what_the_older_commit_cannot_measure_is_left_out(tmp_path: Path) -> None:
    """And what the newer cannot is a failure."""
    here, gone = "def single(name, seconds):\n    return 1.0", ""
    new = compared(tmp_path / "new", gone, here, "--least", "0.8")
    assert (new.returncode, new.stdout) == (0, "")
    assert "name 'single' is not defined" in new.stderr
    assert compared(tmp_path / "lost", here, gone, "--least", "0.8").returncode == 1
