"""A bench's own numbers have bounds, and an error names the key."""

from __future__ import annotations

from typing import Any

import pytest
from helpers import mapping

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.lab.experiments import ExperimentBatch


@pytest.mark.parametrize(
    ("bench", "key", "value"),
    [
        ("rxn", "tick", 1e7),
        ("rxn", "rtol", 0.0),
        ("rxn", "rtol", 1.0),
        ("rxn", "atol", 1e-20),
        ("rxn", "rated_pressure_kpa", 1e9),
        ("rxn", "vessel_volume_l", 1e3),
        ("rxn", "temperature_k", {"low": 275.0, "high": 1e5, "step": 15.0}),
        ("rxn", "temperature_k", {"low": 1.0, "high": 400.0, "step": 15.0}),
        ("rxn", "penalty", {"NaCl": 1e9}),
        ("ext", "settle_per_step", 1e3),
        ("ext", "process", [{"kind": "settle", "vessel": "EV", "magnitudes": [1.0] * 1001}]),
        ("dit", "hottest_k", 1e4),
        ("dit", "hottest_k", 2.0),
    ],
)
def test_out_of_bounds_is_refused(bench: str, key: str, value: Any) -> None:
    values = mapping("wurtz_dodecane")
    values["benches"][bench][key] = value
    with pytest.raises(DataError, match=rf"benches\.{bench}: {key}"):
        ExperimentBatch(load_scenario(values), bench)


def test_a_temperature_out_of_range_is_named_with_its_bound() -> None:
    values = mapping("wurtz_dodecane")
    values["benches"]["dit"]["coolest_k"] = 1.0
    with pytest.raises(DataError, match=r"benches\.dit: coolest_k: .*greater than or equal to 50, given 1\.0"):
        ExperimentBatch(load_scenario(values), "dit")
