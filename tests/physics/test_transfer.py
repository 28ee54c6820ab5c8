"""Pouring, draining, adding, spilling: equal shares, exact amounts, temperatures by heat capacity, clocks by volume."""

import numpy as np
import pytest
from helpers import PIXELS, Glassware, four_solvents, molar_volume
from hypothesis import given, settings
from hypothesis import strategies as st

from chemlab.physics.backends import solid_volume
from chemlab.physics.chemistry import AMOUNTS, CAPACITY, CLOCK, CLOCK_WAS, PRESENT, TEMPERATURE
from chemlab.physics.events import SPILL
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX
from chemlab.physics.transfer import clear, liquid_volume, place, remove_fraction, volume

SCENARIO = four_solvents()
MATERIALS = ["water", "diethyl_ether", "hexane", "dodecane", "1-chlorohexane", "NaCl"]
contents = st.dictionaries(st.sampled_from(MATERIALS), st.floats(1e-3, 4.0), min_size=1)


def glass_with(first: dict[str, float], second: dict[str, float], capacity: float = 50.0) -> Glassware:
    """Two vessels in phase equilibrium, the first at 320 K and half settled, the second at 290 K and mixed."""
    glass = Glassware(SCENARIO, 2)
    for position, (given_contents, temperature, clock) in enumerate(((first, 320.0, 0.5), (second, 290.0, T_MIX))):
        glass.fill(position, given_contents, capacity, temperature, clock)
        glass.phases(position)
        glass.partition(position)
    return glass


def test_volumes_are_mass_over_density() -> None:
    """Everything, the solids, and the rest: litres from the data files' densities; gases count not."""
    glass = Glassware("wurtz_dodecane", 1)
    row = glass.fill(0, {"water": 2.0, "dodecane": 0.5, "NaCl": 1.0, "Na": 0.3, "Na+": 0.1, "Cl-": 0.1, "H2": 5.0})
    solids = sum(n * molar_volume(glass.scenario, name) for name, n in {"NaCl": 1.0, "Na": 0.3}.items())
    liquid = {"water": 2.0, "dodecane": 0.5, "Na+": 0.1, "Cl-": 0.1}
    liquids = sum(n * molar_volume(glass.scenario, name) for name, n in liquid.items())
    assert solid_volume(row, glass.chem) == pytest.approx(solids, rel=1e-14)
    assert liquid_volume(row, glass.chem) == pytest.approx(liquids, rel=1e-12)
    assert volume(row, glass.chem) == pytest.approx(solids + liquids, rel=1e-14)


@given(contents, contents, st.floats(0.0, 1.0))
def test_pouring(first: dict[str, float], second: dict[str, float], f: float) -> None:
    """A fraction f of every amount, dissolved ones too, goes over, the rest stays; temperatures mix by heat capacity,
    T = (C1 T1 + f C0 T0) / (C1 + f C0); t - t_mix shrinks by the share of volume that was already there."""
    glass = glass_with(first, second)
    glass.turn(1, 3.0)
    before, volumes = glass.rows[:, AMOUNTS:].copy(), (glass.volume(1), f * glass.volume(0))
    arriving, there = f * glass.heat_capacity(0), glass.heat_capacity(1)
    glass.pour(0, 1, f)
    np.testing.assert_allclose(glass.rows[0, AMOUNTS:], (1.0 - f) * before[0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(glass.rows[1, AMOUNTS:], before[1] + f * before[0], rtol=1e-12, atol=1e-15)
    assert (glass.waste == 0.0).all()
    assert (glass.rows[0, TEMPERATURE], glass.rows[0, CLOCK]) == (320.0, 0.5)
    mixed = (290.0 * there + 320.0 * arriving) / (there + arriving)
    assert glass.rows[1, TEMPERATURE] == pytest.approx(mixed, rel=1e-12)
    assert glass.rows[1, CLOCK] - T_MIX == pytest.approx(3.0 * volumes[0] / sum(volumes), rel=1e-9)


@given(contents, st.floats(0.05, 0.95), st.booleans())
def test_two_pours_into_an_empty_vessel_are_one(first: dict[str, float], f: float, small: bool) -> None:
    """A part and then all of the rest: the same rows as everything at once, every column, spilt or not (1e-12)."""
    litres = sum(mol * molar_volume(SCENARIO, name) for name, mol in first.items())
    once, twice = glass_with(first, {}), glass_with(first, {})
    for glass in (once, twice):
        glass.rows[1, CAPACITY] = 0.8 * litres if small else 50.0
    once.pour(0, 1, 1.0)
    twice.pour(0, 1, f)
    twice.pour(0, 1, 1.0)
    np.testing.assert_allclose(twice.rows, once.rows, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(twice.waste, once.waste, rtol=1e-12, atol=1e-12)
    assert twice.events[SPILL] == pytest.approx(once.events[SPILL], rel=1e-12, abs=1e-12)
    for glass in (once, twice):
        glass.partition(1)
    np.testing.assert_allclose(twice.rows, once.rows, rtol=1e-12, atol=1e-12)


def test_moving_nothing_changes_nothing() -> None:
    """A zero fraction, no pixels, an empty source: no bit changes. Exactly a vessel's capacity is no spill."""
    brim = glass_with({"water": 1.0}, {})
    brim.rows[1, CAPACITY] = brim.volume(0)
    brim.pour(0, 1, 1.0)
    assert not brim.events.any()
    assert not brim.waste.any()
    for second in ({}, {"water": 2.0, "dodecane": 0.1}, {"hexane": 1.0}):
        for first, fraction, pixels in (({"hexane": 2.0, "NaCl": 0.3}, 0.0, 0.0), ({}, 1.0, 40.0)):
            glass = glass_with(first, second)
            before = glass.rows.copy()
            glass.pour(0, 1, fraction)
            glass.drain(0, 1, pixels)
            assert (glass.rows == before).all()
            assert (glass.waste == 0.0).all()
            assert (glass.events == 0.0).all()


@given(contents, contents, st.floats(0.05, 0.95))
def test_what_does_not_fit_spills_by_shares(first: dict[str, float], second: dict[str, float], share: float) -> None:
    """The receiver ends brim-full; an equal share of everything is in the waste, and its litres are the event."""
    glass = glass_with(first, second)
    together, litres = glass.rows[:, AMOUNTS:].sum(axis=0), glass.volume(0) + glass.volume(1)
    capacity = glass.volume(1) + share * glass.volume(0)
    glass.rows[1, CAPACITY] = capacity
    glass.pour(0, 1, 1.0)
    kept, m = capacity / litres, len(glass.layout.materials)
    assert glass.volume(1) == pytest.approx(capacity, rel=1e-12)
    np.testing.assert_allclose(glass.rows[1, AMOUNTS:], kept * together, rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(glass.waste, (1.0 - kept) * together[:m], rtol=1e-10, atol=1e-14)
    assert glass.events[SPILL] == pytest.approx(litres - capacity, rel=1e-9, abs=1e-12)
    assert (glass.rows[0, AMOUNTS:] == 0.0).all()


def test_adding_mixes_stirs_and_spills() -> None:
    """Added material counts in full: amount, temperature, clock; beyond the capacity it spills with the rest."""
    glass = glass_with({"hexane": 2.0}, {})
    there, volume_there = glass.heat_capacity(0), glass.volume(0)
    glass.add(0, "water", 3.0, 280.0)
    cp = 3.0 * glass.scenario.materials["water"].heat_capacity_j_mol_k
    assert glass.amount(0, "water") == 3.0
    assert glass.rows[0, TEMPERATURE] == pytest.approx((320.0 * there + 280.0 * cp) / (there + cp), rel=1e-12)
    arrived = 3.0 * molar_volume(SCENARIO, "water")
    expected = (0.5 - T_MIX) * volume_there / (volume_there + arrived)
    assert glass.rows[0, CLOCK] - T_MIX == pytest.approx(expected, rel=1e-12)
    glass.rows[0, CAPACITY] = 0.5
    glass.add(0, "water", 30.0)
    assert glass.volume(0) == pytest.approx(0.5, rel=1e-12)
    total = glass.shelf.total()[0]
    assert total[glass.index("water")] == pytest.approx(33.0, rel=1e-14)
    assert total[glass.index("hexane")] == pytest.approx(2.0, rel=1e-14)
    assert glass.events[SPILL] == pytest.approx(float(glass.waste @ glass.known.molar_volume), rel=1e-9)


@given(contents, st.floats(T_MIX, CLOCK_SETTLED), st.floats(0.0, 100.0))
@settings(max_examples=150)
def test_draining_takes_what_the_profile_says(first: dict[str, float], clock: float, pixels: float) -> None:
    """Of every layer goes the share that lies in the lowest pixels, with what is dissolved in it; solids likewise."""
    glass = Glassware(SCENARIO, 2)
    litres = sum(mol * molar_volume(SCENARIO, name) for name, mol in first.items())
    glass.fill(0, first, 1.6 * litres, 320.0, clock)
    glass.fill(1, {}, 50.0)
    glass.phases(0)
    glass.partition(0)
    amounts, dissolved, capacity = glass.amounts(0).copy(), glass.dissolved(0).copy(), glass.heat_capacity(0)
    names, shares = glass.drain(0, 1, pixels)
    below = np.clip(pixels - np.arange(PIXELS), 0.0, 1.0)  # how much of each pixel is drained
    gone = {
        name: float(row @ below / row.sum()) if row.sum() > 0.0 else 0.0
        for name, row in zip(names, shares, strict=True)
    }
    solvents = [name for name in names if name in glass.layout.solvents]
    expected = np.zeros_like(amounts)
    for i, (name, material) in enumerate(glass.scenario.materials.items()):
        if name in gone:
            expected[i] = amounts[i] * gone[name]
        elif material.role == "solid" or (material.role == "ion" and not solvents):
            expected[i] = amounts[i] * gone["solids"]
        elif material.role in ("solute", "ion"):
            k = glass.layout.dissolved.index(name)
            expected[i] = sum(dissolved[k, glass.layout.solvents.index(s)] * gone[s] for s in solvents)
    np.testing.assert_allclose(glass.amounts(1), expected, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(glass.amounts(0) + glass.amounts(1), amounts, rtol=1e-12, atol=1e-15)
    for layer, name in enumerate(glass.layout.solvents):
        expected = dissolved[:, layer] * gone.get(name, 0.0)
        np.testing.assert_allclose(glass.dissolved(1)[:, layer], expected, rtol=1e-10, atol=1e-13)
    if glass.heat_capacity(1) > 1e-6 * capacity:
        assert glass.rows[1, TEMPERATURE] == pytest.approx(320.0, rel=1e-9)


def test_a_clean_vessel_is_empty_and_mixed() -> None:
    """Place: empty, at ambient temperature, fully mixed; clear: nothing stands there at all."""
    glass = glass_with({"water": 3.0}, {})
    row = glass.rows[0]
    place(row, 0.7, glass.chem)
    assert row[[TEMPERATURE, CAPACITY, CLOCK, CLOCK_WAS, PRESENT]].tolist() == [298.15, 0.7, T_MIX, T_MIX, 1.0]
    assert (row[AMOUNTS:] == 0.0).all()
    clear(row)
    assert (row == 0.0).all()


@given(contents, st.floats(0.0, 1.0))
def test_taking_a_sample_takes_an_equal_share(first: dict[str, float], f: float) -> None:
    """A fraction of everything goes into an array of amounts; what stays keeps its composition."""
    glass = glass_with(first, {})
    before, into = glass.rows[0].copy(), np.zeros(len(glass.layout.materials))
    remove_fraction(glass.rows[0], f, glass.chem, into)
    np.testing.assert_allclose(glass.rows[0, AMOUNTS:], (1.0 - f) * before[AMOUNTS:], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(into, f * before[AMOUNTS : AMOUNTS + len(into)], rtol=1e-14, atol=0.0)
