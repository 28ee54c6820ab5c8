"""A few hundred mutated records; more by ``python tests/fuzz/attacks.py records --look``."""

from pathlib import Path

import pytest
from forgeries import NUMBERS, forge
from fuzz_records import fuzz

pytest.importorskip("matplotlib", reason="needs matplotlib (extra plot)")


@pytest.mark.slow
def test_mutated_records_are_refused_in_words() -> None:
    outcomes, failures = fuzz(100, seed=20)
    assert not failures, "\n".join(failures)
    assert sum(outcomes.values()) == 100
    # It does get through to what it is meant to try.
    assert outcomes["record, verified: tampered"] > 25
    assert len(outcomes) > 3


@pytest.mark.parametrize("scenario", ["wurtz_dodecane", "relay", "rush"])
def test_forged_records_are_not_believed(scenario: str, tmp_path: Path) -> None:
    found = forge(1, tmp_path, scenario)
    assert found["paid_more"].keys() == {"tampered"}
    assert found["paid_more"]["tampered"] >= 2
    assert found["cut_short"].keys() == {"tampered"}
    assert found["impossible_numbers"] == {"tampered": 2 * len(NUMBERS)}
    assert found["other_spellings"].keys() <= {"tampered", "unchecked"}
    assert found["easier_scenario"] == {"foreign": 2}
    assert found["invented_world"] == ({} if scenario == "wurtz_dodecane" else {"tampered": 2})
