"""What counts as a safety event, and where gases go."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import Glassware, mapping

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.physics.backends import settle_phases
from chemlab.physics.chemistry import AMOUNTS, build_chemistry
from chemlab.physics.shelf import Shelf

NEUTRAL = """
name = "neutral"
[[violent]]
reactants = { acetic_anhydride = 1, water = 1 }
products = { acetic_acid = 2 }
source = "A test."
%s
"""


def settled(family: str, events: dict[str, str], tmp_path: Any) -> np.ndarray[Any, Any]:
    """Safety events of a vessel in which 0.3 mol of an anhydride meet 10 mol of water and react with it at once."""
    (tmp_path / "neutral.toml").write_text(family, encoding="utf-8")
    values = mapping("salt_from_oil")
    values |= {"name": "neutral", "reactions": str(tmp_path / "neutral.toml")}
    values["stock"] |= {"acetic_anhydride": 1.0}
    values["safety"]["events"] = events
    scenario = load_scenario(values)
    shelf = Shelf(build_chemistry(scenario), 1, 1)
    shelf.fill(0, 0, 1.0, {"water": 10.0, "acetic_anhydride": 0.3})
    seen = np.zeros(len(scenario.safety_events))
    settle_phases(shelf.rows[0], shelf.chem(), shelf.waste[0], seen, np.zeros((2, 8)))
    assert shelf.vessel(0, 0).amounts(1e-9) == pytest.approx({"water": 9.7, "acetic_acid": 0.6}, rel=1e-12)
    return seen


def test_a_violent_reaction_without_a_metal_is_no_metal_in_water(tmp_path: Any) -> None:
    assert not settled(NEUTRAL % "", {}, tmp_path).any()


def test_a_violent_reaction_counts_as_the_event_it_names(tmp_path: Any) -> None:
    seen = settled(NEUTRAL % 'event = "hydrolysed_mol"', {"hydrolysed_mol": "mol of anhydride"}, tmp_path)
    assert seen.tolist() == pytest.approx([0.0] * 5 + [0.3], rel=1e-12)


def test_an_event_that_nobody_knows_is_refused(tmp_path: Any) -> None:
    with pytest.raises(DataError, match=r"violent\.event: unknown safety event 'bang'; choose from none, .*decl"):
        settled(NEUTRAL % 'event = "bang"', {}, tmp_path)


def test_sodium_in_water_is_metal_in_water() -> None:
    glass = Glassware(vessels=1)
    glass.mixed(0, {"water": 10.0, "Na": 0.4})
    kinds = glass.scenario.safety_events
    assert dict(zip(kinds, glass.events.tolist(), strict=True))["metal_in_water_mol"] == pytest.approx(0.4, rel=1e-12)


def test_gas_that_is_in_a_vessel_leaves_it_for_the_waste() -> None:
    """Whatever reaction made it: mol by mol, and nothing else goes."""
    glass = Glassware(vessels=1)
    row = glass.fill(0, {"diethyl_ether": 2.0})
    row[AMOUNTS + glass.index("H2")] = 0.25
    atoms = glass.atoms()
    glass.phases(0)
    assert glass.amount(0, "H2") == 0.0
    assert glass.waste[glass.index("H2")] == 0.25
    assert glass.waste.sum() == 0.25
    np.testing.assert_allclose(glass.atoms(), atoms, rtol=1e-12)
