"""A few hundred broken files, the same every time; thousands by ``python tests/fuzz/attacks.py files --look``."""

from pathlib import Path

import numpy as np
import pytest
from fuzz_files import KINDS, change, fuzz, places, seeds, toml, write
from helpers import slow_but

from chemlab.config.datafile import read_toml
from chemlab.config.draws import BOTTLE, DEVICE_QUANTITIES, ORDER_QUANTITIES, VESSEL_QUANTITIES
from chemlab.config.loading import load_scenario


def test_what_the_fuzzer_begins_with_loads(tmp_path: Path) -> None:
    for base in seeds():
        write(tmp_path, base)
        assert read_toml(tmp_path / "lab.toml") == base.scenario, "the writer writes what is meant"
        load_scenario(tmp_path / "lab.toml")


@pytest.mark.parametrize("each", slow_but((12, 25), 12))
def test_broken_files_are_readable_errors(each: int) -> None:
    files = each * len(KINDS)
    outcomes, failures = fuzz(files, seed=0, turns=5)
    assert not failures, "\n".join(failures)
    # The fuzzer would prove nothing if it broke nothing, or everything.
    assert sum(outcomes.values()) == files
    assert all(outcomes[f"{kind}: refused"] > each // 8 for kind in KINDS)
    assert sum(outcomes[f"{kind}: loaded"] for kind in KINDS) > 5


def test_the_fuzzer_begins_with_every_table_that_a_scenario_may_have() -> None:
    """A table of a newer kind, which no shipped scenario has, would not be tried."""
    dumped = [base.scenario for base in seeds()]
    benches = [bench for one in dumped for bench in one.get("benches", {}).values()]
    instruments = [instrument for one in dumped for instrument in one.get("instruments", {}).values()]
    draws = [draw for one in dumped for draw in one.get("world", {}).get("draws", {}).values()]
    wanted = [order for one in dumped for order in one.get("specifications", {}).values()]
    for tables, keys in (
        (dumped, ("demand", "grades", "specifications", "world", "real")), (benches, ("wear", "report", "actions")),
        (instruments, ("drift", "noise")), (draws, ("told", "correlation", "test")),
        (wanted, ("purity_among",)), ([one.get("shelf", {}) for one in dumped], ("tick", "gauge")),
    ):  # fmt: skip
        for key in keys:
            assert any(key in table for table in tables), key
    quantities = {draw.get("what") for draw in draws}
    assert {*VESSEL_QUANTITIES, *DEVICE_QUANTITIES, *ORDER_QUANTITIES} <= quantities
    assert any(BOTTLE in draw.get("of", ()) for draw in draws)
    assert all("lock" in table for base in seeds() for table in (base.material, base.reaction, base.pairs))
    assert all(base.pairs["pairs"] for base in seeds())


def test_a_change_stays_in_the_file_it_is_made_to() -> None:
    one, other = seeds()[1].scenario, seeds()[1].scenario
    rng = np.random.default_rng(3)
    for _ in range(50):
        change(one, rng)
    assert toml(one) != toml(other)
    assert other == seeds()[1].scenario
    assert len(places(other)) > 100
