"""The shelf: views, snapshots, totals, and the text of a vessel."""

import math

import numpy as np
import pytest
from helpers import FEATURED, litres

from chemlab.config.loading import load_scenario
from chemlab.physics.chemistry import AMOUNTS, CAPACITY, PRESENT, TEMPERATURE, build_chemistry
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX, Shelf

SCENARIO = "wurtz_dodecane"


@pytest.fixture
def shelf() -> Shelf:
    """Two laboratories with three places each, the middle one of the second laboratory taken."""
    shelf = Shelf.empty(load_scenario(SCENARIO), 2, 3)
    shelf.fill(1, 1, 1.5, {"water": 10.0, "diethyl_ether": 2.0, "NaCl": 0.5})
    return shelf


def test_every_view_shares_the_vessels_memory(shelf: Shelf) -> None:
    vessel = shelf.vessel(1, 1)
    for view in (shelf.rows, shelf.amounts, shelf.dissolved, vessel.row):
        assert np.shares_memory(view, shelf.vessels)
    water = shelf.layout.index("water")
    # The same number by every way there is: laboratory 1 of three places each, place 1.
    shelf.amounts[1, 1, water] = 7.0
    assert shelf.vessels[1, 1, AMOUNTS + water] == 7.0
    assert shelf.rows[4, AMOUNTS + water] == 7.0
    assert vessel.row[AMOUNTS + water] == 7.0
    assert vessel.amounts()["water"] == 7.0
    shelf.rows[4, TEMPERATURE] = 350.0
    assert vessel.temperature_k == 350.0
    # Dissolved amounts are the last columns.
    layout = shelf.layout
    k, solvent = layout.dissolved.index("dodecane"), layout.solvents.index("diethyl_ether")
    shelf.dissolved[0, 2, k, solvent] = 0.25
    assert shelf.vessels[0, 2, AMOUNTS + len(layout.materials) + k * len(layout.solvents) + solvent] == 0.25
    assert np.count_nonzero(shelf.vessels[0]) == 1


def test_a_filled_vessel_is_at_rest_and_replaces_what_stood_there(shelf: Shelf) -> None:
    vessel = shelf.vessel(1, 1)
    assert vessel.present
    assert (vessel.capacity_l, vessel.settling) == (1.5, 1.0)
    assert vessel.temperature_k == load_scenario(SCENARIO).ambient_temperature_k
    assert vessel.amounts(1e-9) == {"water": 10.0, "diethyl_ether": 2.0, "NaCl": 0.5}
    assert vessel.volume_l == pytest.approx(litres(load_scenario(SCENARIO), vessel.amounts()), rel=1e-12)
    vessel = shelf.fill(1, 1, 0.5, {"diethyl_ether": 1.0})
    assert vessel.amounts(1e-9) == {"diethyl_ether": 1.0}
    assert vessel.capacity_l == 0.5
    # Only that place: nothing else stands anywhere.
    assert np.flatnonzero(shelf.vessels[..., PRESENT]).tolist() == [4]
    assert np.flatnonzero(shelf.vessels[..., CAPACITY]).tolist() == [4]


def test_the_settling_clock_runs_from_mixed_to_settled() -> None:
    # PHYSICS section 2: t_mix = -ln(2 sqrt(2 pi)).
    assert pytest.approx(-math.log(2.0 * math.sqrt(2.0 * math.pi)), rel=1e-15) == T_MIX
    assert CLOCK_SETTLED > T_MIX


def test_total_counts_vessels_bottles_and_waste_of_each_laboratory(shelf: Shelf) -> None:
    water, salt = shelf.layout.index("water"), shelf.layout.index("NaCl")
    shelf.stock[1, water] = 4.0
    shelf.waste[1, water] = 0.25
    shelf.fill(1, 2, 1.0, {"water": 1.0})
    total = shelf.total()
    assert total.shape == (2, len(shelf.layout.materials))
    assert total[1, water] == pytest.approx(10.0 + 1.0 + 4.0 + 0.25, rel=1e-15)
    assert total[1, salt] == pytest.approx(0.5, rel=1e-15)
    assert not total[0].any()


@pytest.mark.parametrize("name", FEATURED)
def test_the_arrays_say_what_the_materials_say(name: str) -> None:
    scenario = load_scenario(name)
    table = build_chemistry(scenario)
    layout, chemistry = table.layout, table.world()
    assert layout.materials == tuple(scenario.materials)
    assert chemistry.boiling_point.tolist() == [m.boiling_point_k for m in scenario.materials.values()]
    roles = {key: material.role for key, material in scenario.materials.items()}
    real = scenario.physics == "real"
    solvents = tuple(key for key, role in roles.items() if role == "solvent")
    assert layout.solvents == (("aqueous", "organic") if real else solvents)
    dissolved = ("solvent", "solute", "ion") if real else ("solute", "ion")
    assert layout.dissolved == tuple(key for key, role in roles.items() if role in dissolved)
    volatile = [layout.materials[i] for i in chemistry.volatile]
    assert set(volatile) == {key for key, role in roles.items() if role in ("solvent", "solute")}
    points = [scenario.materials[key].boiling_point_k for key in volatile]
    assert points == sorted(points)
