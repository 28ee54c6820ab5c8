"""The data of the tier ``real`` against the committed results of the scripts in ``studies/physics/``, without any
kernel."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

VALIDATE = Path(__file__).parent.parent / "studies" / "physics"


def rows(name: str) -> list[dict[str, str]]:
    with (VALIDATE / f"{name}.csv").open(encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


def test_distribution_coefficients_are_those_of_unifac_or_measured() -> None:
    # Pairs with a measured solubility are not UNIFAC's any more; there what was measured counts.
    judged = rows("distribution")
    measured = [row for row in judged if row["source"]]
    assert len(measured) >= 6
    for row in measured:
        assert abs(float(row["shipped"]) - float(row["measured"])) <= 0.2, row
    near = [
        row
        for row in judged
        if not row["source"]
        and min(abs(float(row["shipped"]) - float(row[key])) for key in ("unifac_dortmund", "unifac")) <= 0.2
    ]
    assert len(near) + len(measured) >= 40


def test_solids_dissolve_as_measured() -> None:
    judged = rows("solubility")
    assert len({(row["solute"], row["solvent"]) for row in judged}) >= 15
    for row in judged:
        assert abs(math.log10(float(row["shipped"]) / float(row["measured"]))) <= 0.12, row


def test_what_shares_out_between_ether_and_water_is_as_measured() -> None:
    judged = {row["organic"]: row for row in rows("layers")}
    for name in ("diethyl_ether", "ethyl_acetate"):
        for column in ("in_water", "of_water"):
            row = judged[name]
            assert float(row[f"shipped_{column}"]) == pytest.approx(float(row[f"measured_{column}"]), rel=0.06)
    for name in ("hexane", "toluene", "1-chlorohexane", "dodecane"):
        assert float(judged[name]["shipped_in_water"]) < 2e-4


def test_activity_coefficients_of_ions_are_needed_for_the_standard_buffers() -> None:
    judged = rows("acids")
    assert len(judged) == 10
    assert all(abs(float(row["davies"]) - float(row["assigned"])) < 0.02 for row in judged)
    assert sum(abs(float(row["ideal"]) - float(row["assigned"])) > 0.05 for row in judged) >= 8
