"""Heat: boiling by hand, energy balance, limits and events; vapour pressure, sealed air, the relief valve."""

import math

import numpy as np
import pytest
from helpers import Glassware, molar_volume
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from chemlab.config.loading import load_scenario
from chemlab.physics.backends import vapor_pressure, vent
from chemlab.physics.chemistry import AIR, AMOUNTS, CAPACITY, TEMPERATURE
from chemlab.physics.events import BOILED_DRY, DRY_HEATING, RELIEF, SPILL
from chemlab.physics.thermal import pressure, seal_vessel

R = 8.31446261815324
ATMOSPHERE = 101.325
ROOM = 298.15


def open_air(glass: Glassware, position: int) -> float:
    """J/K of the air above the contents of an open vessel: ideal gas at 101.325 kPa and the vessel's temperature."""
    row = glass.rows[position]
    headspace = max(row[CAPACITY] - glass.volume(position), 0.0)
    return ATMOSPHERE * headspace / (R * row[TEMPERATURE]) * glass.scenario.materials["air"].heat_capacity_j_mol_k


def still(contents: dict[str, float], capacity: float = 1.2, temperature: float = ROOM) -> Glassware:
    """A distillation vessel and an empty receiver."""
    glass = Glassware("wurtz_dodecane", 2)
    glass.fill(0, contents, capacity, temperature)
    glass.fill(1, {}, 5.0)
    return glass


def test_one_call_crosses_three_boiling_points() -> None:
    """Ether goes, then water, then half of the dodecane, then the heat is used up: each leg reckoned by hand."""
    glass = still({"dodecane": 0.4, "diethyl_ether": 1.0, "water": 2.0, "NaCl": 0.3})
    order = [glass.scenario.materials[name] for name in ("diethyl_ether", "water", "dodecane")]
    amounts, stays = [1.0, 2.0, 0.4], 0.3 * glass.scenario.materials["NaCl"].heat_capacity_j_mol_k + open_air(glass, 0)
    joules, temperature = 0.0, ROOM
    for i, (material, mol) in enumerate(zip(order, amounts, strict=True)):
        left = sum(n * m.heat_capacity_j_mol_k for n, m in zip(amounts[i:], order[i:], strict=True))
        joules += (stays + left) * (material.boiling_point_k - temperature)
        joules += material.vaporization_enthalpy_j_mol * (mol if i < 2 else mol / 2.0)
        temperature = material.boiling_point_k
    taken, condenser = glass.heat(0, 1, joules)
    assert taken == joules
    assert glass.rows[0, TEMPERATURE] == temperature
    assert glass.amount(0, "diethyl_ether") == 0.0
    assert glass.amount(0, "water") == 0.0
    assert glass.amount(0, "dodecane") == pytest.approx(0.2, rel=1e-12)
    assert glass.amount(0, "NaCl") == 0.3
    arrived = [glass.amount(1, name) for name in ("diethyl_ether", "water", "dodecane")]
    assert arrived == pytest.approx([1.0, 2.0, 0.2], rel=1e-12)
    given_up = [
        n * (m.vaporization_enthalpy_j_mol + m.heat_capacity_j_mol_k * (m.boiling_point_k - ROOM))
        for n, m in zip([1.0, 2.0, 0.2], order, strict=True)
    ]
    assert condenser == pytest.approx(sum(given_up), rel=1e-12)
    assert glass.rows[1, TEMPERATURE] == pytest.approx(ROOM, rel=1e-14)
    assert (glass.events == 0.0).all()


def test_many_small_steps_are_one_large_step() -> None:
    """Fifty steps of 2 kJ boil off what one of 100 kJ does, but for some joules: warm air is less air."""
    once, often = still({"diethyl_ether": 2.0, "water": 3.0}), still({"diethyl_ether": 2.0, "water": 3.0})
    once.heat(0, 1, 100_000.0)
    for _ in range(50):
        often.heat(0, 1, 2_000.0)
    np.testing.assert_allclose(often.amounts(1), once.amounts(1), rtol=0.0, atol=1e-3)
    assert often.rows[0, TEMPERATURE] == once.rows[0, TEMPERATURE]


def test_superheated_liquid_boils_by_its_own_heat() -> None:
    """Ether in a vessel at 350 K boils from the heat of the vessel; one joule starts it."""
    glass = still({"diethyl_ether": 1.0, "NaCl": 2.0}, temperature=350.0)
    ether = glass.scenario.materials["diethyl_ether"]
    stored = (glass.heat_capacity(0) + open_air(glass, 0)) * (350.0 - ether.boiling_point_k)
    glass.heat(0, 1, 1.0)
    assert glass.rows[0, TEMPERATURE] == ether.boiling_point_k
    boiled = (stored + 1.0) / ether.vaporization_enthalpy_j_mol
    assert glass.amount(1, "diethyl_ether") == pytest.approx(boiled, rel=1e-12)


def test_receiver_that_is_full_spills() -> None:
    """What the receiver cannot hold goes to waste and is an event of so many litres; nothing is lost."""
    glass = still({"diethyl_ether": 4.0})
    glass.fill(1, {}, 0.1)
    glass.heat(0, 1, 80_000.0)
    litres = float(glass.waste @ glass.known.molar_volume)
    assert glass.volume(1) == pytest.approx(0.1, rel=1e-12)
    assert litres > 0.1
    assert glass.events[SPILL] == pytest.approx(litres, rel=1e-12)
    assert glass.shelf.total()[0, glass.index("diethyl_ether")] == pytest.approx(4.0, rel=1e-14)


LIQUIDS = ["water", "diethyl_ether", "1-chlorohexane", "dodecane", "4,5-diethyloctane"]
contents = st.dictionaries(st.sampled_from([*LIQUIDS, "NaCl", "Na", "Na+"]), st.floats(1e-4, 3.0), max_size=6)


@given(
    contents, contents, st.floats(-3e5, 3e5), st.floats(260.0, 520.0), st.floats(280.0, 400.0), st.floats(300.0, 700.0)
)
@settings(max_examples=100)
def test_energy_balance_closes(
    boiling: dict[str, float],
    receiving: dict[str, float],
    joules: float,
    temperature: float,
    receiver_temperature: float,
    hottest: float,
) -> None:
    """Heat in = heat stored in both vessels + heat to the condenser (1e-9), and matter is conserved."""
    glass = Glassware("wurtz_dodecane", 2)
    glass.fill(0, boiling, 2.0 + sum(boiling.values()), temperature)
    glass.fill(1, receiving, 10.0, receiver_temperature)
    air, total = open_air(glass, 0), glass.shelf.total()[0].copy()

    def stored() -> float:
        main = (glass.heat_capacity(0) + air) * (glass.rows[0, TEMPERATURE] - ROOM)
        return float(main + glass.heat_capacity(1) * (glass.rows[1, TEMPERATURE] - ROOM))

    before = stored()
    taken, condenser = glass.heat(0, 1, joules, hottest_k=hottest)
    scale = abs(joules) + abs(before) + abs(condenser) + 1.0
    assert glass.events[SPILL] == 0.0
    assert stored() - before + condenser == pytest.approx(taken, abs=1e-9 * scale)
    if temperature <= hottest:
        assert min(0.0, joules) - 1e-9 * scale <= taken <= max(0.0, joules) + 1e-9 * scale
    np.testing.assert_allclose(glass.shelf.total()[0], total, rtol=1e-12, atol=1e-15)
    assert min(glass.amounts(0).min(), glass.amounts(1).min(), glass.rows[:, TEMPERATURE].min()) >= 0.0


def test_cooling_stops_at_the_coolant() -> None:
    """Cooling takes C (T - coolant) at most; a vessel colder than the coolant stays as it is."""
    glass = still({"water": 3.0}, temperature=320.0)
    capacity = glass.heat_capacity(0) + open_air(glass, 0)
    taken, condenser = glass.heat(0, 1, -1e6, coolest_k=280.0)
    assert (taken, condenser) == (pytest.approx(-capacity * 40.0, rel=1e-12), 0.0)
    assert glass.rows[0, TEMPERATURE] == 280.0
    assert glass.heat(0, 1, -1e6, coolest_k=285.0) == (0.0, 0.0)
    assert glass.rows[0, TEMPERATURE] == 280.0


def test_heating_an_empty_vessel_is_an_event_and_nothing_else() -> None:
    """No contents: one dry-heating event, no heat taken, no bit changed; cooling it or 0 J is not even an event."""
    glass = still({})
    before = glass.rows.copy()
    assert glass.heat(0, 1, 5000.0) == (0.0, 0.0)
    assert (glass.rows == before).all()
    assert glass.events[DRY_HEATING] == 1.0
    glass.heat(0, 1, -5000.0)
    glass.heat(0, 1, 0.0)
    assert (glass.rows == before).all()
    assert glass.events.sum() == 1.0


def test_boiling_dry_is_an_event() -> None:
    """The last liquid's going is one event, dry heating another; remaining liquid or the mantle's limit is none."""
    wet = still({"diethyl_ether": 0.5, "dodecane": 1.0})
    wet.heat(0, 1, 1e6, hottest_k=450.0)
    assert (wet.amount(0, "diethyl_ether"), wet.amount(0, "dodecane")) == (0.0, 1.0)
    assert (wet.events == 0.0).all()
    glass = still({"diethyl_ether": 0.5, "NaCl": 1.0})
    glass.heat(0, 1, 50_000.0, hottest_k=450.0)
    assert glass.amount(0, "diethyl_ether") == 0.0
    assert glass.events[BOILED_DRY] == 1.0
    assert glass.events[DRY_HEATING] == 0.0
    glass.heat(0, 1, 1_000.0, hottest_k=450.0)
    assert glass.events[BOILED_DRY] == 1.0
    assert glass.events[DRY_HEATING] == 1.0
    assert glass.amount(0, "NaCl") == 1.0


def test_a_full_vessel_boils_dry_exactly() -> None:
    """Without air, an empty vessel has no heat capacity at all."""
    glass = still({"water": 10.0})
    row, material = glass.rows[0], glass.scenario.materials["water"]
    row[CAPACITY] = glass.volume(0)
    warming = material.heat_capacity_j_mol_k * (material.boiling_point_k - ROOM)
    glass.heat(0, 1, 10.0 * (warming + material.vaporization_enthalpy_j_mol))
    assert glass.amount(0, "water") == 0.0
    assert np.isfinite(row).all()


def test_nothing_gets_hotter_than_the_mantle() -> None:
    """Heat stops flowing at the mantle's temperature: liquids that boil above it stay, the rest of the heat too."""
    glass = still({"dodecane": 1.0, "NaCl": 0.5})
    capacity = glass.heat_capacity(0) + open_air(glass, 0)
    taken, condenser = glass.heat(0, 1, 1e6, hottest_k=450.0)
    assert glass.rows[0, TEMPERATURE] == 450.0
    assert (taken, condenser) == (pytest.approx(capacity * (450.0 - ROOM), rel=1e-12), 0.0)
    assert glass.heat(0, 1, 1e6, hottest_k=450.0)[0] == pytest.approx(0.0, abs=1e-9)
    hot = still({"dodecane": 1.0}, temperature=470.0)
    assert hot.heat(0, 1, 1000.0, hottest_k=450.0)[0] == pytest.approx(0.0, abs=1e-9)
    assert hot.rows[0, TEMPERATURE] == 470.0  # a mantle that is colder takes nothing away


@pytest.mark.parametrize("name", LIQUIDS)
def test_vapor_pressure_of_a_pure_liquid(name: str) -> None:
    """101.325 kPa at the normal boiling point, and ln(p2 / p1) = -dHvap/R (1/T2 - 1/T1)."""
    glass = Glassware("wurtz_dodecane", 1)
    material = glass.scenario.materials[name]
    row = glass.fill(0, {name: 0.7}, 1.0, material.boiling_point_k)
    assert vapor_pressure(row, glass.chem) == pytest.approx(ATMOSPHERE, rel=1e-14)
    seen = []
    for temperature in (280.0, 350.0):
        row[TEMPERATURE] = temperature
        seen.append(vapor_pressure(row, glass.chem))
    slope = -material.vaporization_enthalpy_j_mol / R * (1.0 / 350.0 - 1.0 / 280.0)
    assert math.log(seen[1] / seen[0]) == pytest.approx(slope, rel=1e-12)


def test_vapor_pressure_of_a_mixture_is_raoults() -> None:
    """p = sum x_i p_i over the liquids; salt and metal do not count, and without liquid there is no vapour."""
    glass = Glassware("wurtz_dodecane", 1)
    pure = []
    for name in ("diethyl_ether", "dodecane"):
        pure.append(vapor_pressure(glass.fill(0, {name: 1.0}, 1.0, 320.0), glass.chem))
    mixture = glass.fill(0, {"diethyl_ether": 1.0, "dodecane": 3.0, "NaCl": 2.0, "Na": 1.0}, 2.0, 320.0)
    assert vapor_pressure(mixture, glass.chem) == pytest.approx(0.25 * pure[0] + 0.75 * pure[1], rel=1e-12)
    assert vapor_pressure(glass.fill(0, {"NaCl": 2.0}, 2.0, 320.0), glass.chem) == 0.0


@given(st.floats(200.0, 600.0), st.floats(0.3, 3.0), st.floats(0.0, 1.5))
def test_sealed_air_is_an_ideal_gas(temperature: float, capacity: float, salt: float) -> None:
    """Sealed at ambient pressure, then heated and compressed: p V = n R T of the air in the headspace."""
    glass = Glassware("wurtz_dodecane", 1)
    row = glass.fill(0, {"NaCl": salt}, 1.0)
    headspace = 1.0 - glass.volume(0)
    seal_vessel(row, glass.chem)
    assert row[AIR] == pytest.approx(ATMOSPHERE * headspace / (R * ROOM), rel=1e-12)
    assert pressure(row, glass.chem) == pytest.approx(ATMOSPHERE, rel=1e-12)
    row[TEMPERATURE], row[CAPACITY] = temperature, capacity
    expected = ATMOSPHERE * (headspace / (capacity - glass.volume(0))) * (temperature / ROOM)
    assert pressure(row, glass.chem) == pytest.approx(expected, rel=1e-12)


def test_pressure_is_air_plus_vapor() -> None:
    """Over a liquid the sealed vessel shows the air's pressure plus the vapour's."""
    glass = Glassware("wurtz_dodecane", 1)
    row = glass.fill(0, {"diethyl_ether": 4.0, "1-chlorohexane": 1.0}, 1.2)
    seal_vessel(row, glass.chem)
    row[TEMPERATURE], row[CAPACITY] = 345.0, 0.8
    air = row[AIR] * R * 345.0 / (0.8 - glass.volume(0))
    assert pressure(row, glass.chem) == pytest.approx(air + vapor_pressure(row, glass.chem), rel=1e-12)
    brim = glass.fill(0, {"water": 1.0 / molar_volume(glass.scenario, "water")}, 1.0)
    brim[AIR] = 0.01
    assert np.isfinite(pressure(brim, glass.chem))


def sealed(contents: dict[str, float], temperature: float, capacity: float) -> Glassware:
    """A vessel sealed at 1.2 L and 298.15 K, then heated and compressed."""
    glass = Glassware("wurtz_dodecane", 1)
    row = glass.fill(0, contents, 1.2)
    glass.phases(0)
    glass.partition(0)
    seal_vessel(row, glass.chem)
    row[TEMPERATURE], row[CAPACITY] = temperature, capacity
    return glass


def test_below_the_rating_the_valve_stays_shut() -> None:
    """At or below the rated pressure no bit changes and nothing is recorded."""
    glass = sealed({"diethyl_ether": 4.0}, 330.0, 1.2)
    before = glass.rows.copy()
    vent(glass.rows[0], pressure(glass.rows[0], glass.chem), glass.chem, glass.waste, glass.events)
    assert (glass.rows == before).all()
    assert (glass.waste == 0.0).all()
    assert (glass.events == 0.0).all()


@given(
    st.dictionaries(st.sampled_from([*LIQUIDS, "NaCl", "Na"]), st.floats(0.01, 2.0), max_size=5),
    st.floats(300.0, 420.0),
    st.floats(0.3, 1.0),
    st.floats(110.0, 600.0),
)
@settings(max_examples=80)
def test_the_relief_valve_lets_out_volatile_matter_only(
    contents: dict[str, float], temperature: float, squeeze: float, rated: float
) -> None:
    """Pressure falls; what is lost is liquid, all of it in the waste, and its moles are the event."""
    contents = {name: mol for name, mol in contents.items() if not ("Na" in contents and name == "water")}
    litres = sum(mol * molar_volume(load_scenario("wurtz_dodecane"), n) for n, mol in contents.items())
    assume(litres < 1.1)
    glass = sealed(contents, temperature, litres + squeeze * (1.2 - litres))
    row = glass.rows[0]
    high, air, amounts, atoms = pressure(row, glass.chem), row[AIR], glass.amounts(0).copy(), glass.atoms()
    assume(high > rated)
    vent(row, rated, glass.chem, glass.waste, glass.events)
    assert pressure(row, glass.chem) < high
    assert 0.0 <= row[AIR] < air
    lost = amounts - glass.amounts(0)
    volatile = [glass.index(n) for n, m in glass.scenario.materials.items() if m.role in ("solvent", "solute")]
    assert (lost[np.setdiff1d(np.arange(len(lost)), volatile)] == 0.0).all()
    assert (lost >= 0.0).all()
    np.testing.assert_allclose(glass.waste, lost, rtol=1e-12, atol=1e-15)
    assert glass.events[RELIEF] == pytest.approx(lost.sum(), rel=1e-9, abs=1e-15)
    np.testing.assert_allclose(glass.atoms(), atoms, rtol=1e-12, atol=1e-15)
    glass.partition(0)
    glass.check()


def test_the_gas_that_leaves_has_the_composition_of_the_gas_inside() -> None:
    """(p - rated) V / R T moles leave: air and each vapour in the proportion of their pressures."""
    glass = sealed({"diethyl_ether": 3.0, "1-chlorohexane": 1.0}, 340.0, 0.7)
    row = glass.rows[0]
    high, headspace = pressure(row, glass.chem), 0.7 - glass.volume(0)
    air = row[AIR] * R * 340.0 / headspace
    amounts, air_mol = glass.amounts(0).copy(), row[AIR]
    leaving = (high - 300.0) * headspace / (R * 340.0)
    assert high > 320.0
    vent(row, 300.0, glass.chem, glass.waste, glass.events)
    assert air_mol - row[AIR] == pytest.approx(leaving * air / high, rel=1e-12)
    for name, share in (("diethyl_ether", 0.75), ("1-chlorohexane", 0.25)):
        material = glass.scenario.materials[name]
        exponent = material.vaporization_enthalpy_j_mol / R * (1.0 / material.boiling_point_k - 1.0 / 340.0)
        partial = share * ATMOSPHERE * math.exp(exponent)
        lost = amounts[glass.index(name)] - row[AMOUNTS + glass.index(name)]
        assert lost == pytest.approx(leaving * partial / high, rel=1e-12)
