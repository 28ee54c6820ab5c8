"""A few hundred mutated records; more by ``python tests/fuzz/records.py``."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from records import fuzz

pytest.importorskip("matplotlib", reason="needs matplotlib (extra plot)")


def test_mutated_records_are_refused_in_words(tmp_path: Path) -> None:
    report = fuzz(200, 20, tmp_path)
    assert report.failures == []
    assert report.files == 200
    # It does get through to what it is meant to try.
    assert report.status["tampered"] > 50
    assert sum(report.readers.values()) > sum(report.refused.values()) > 50
