"""Crystals, filters and drying of the tier ``real``: closed forms, an independent integration, balances."""

import itertools
import math

import numpy as np
import pytest
from helpers import pascal
from scipy.integrate import solve_ivp
from test_real import Glass

from chemlab.agents.scripted.crystallization import solubility
from chemlab.config.loading import load_scenario
from chemlab.config.materials import shipped_materials
from chemlab.config.pairs import REFERENCE_K, log_activity_coefficients, pair_table, shipped_pairs
from chemlab.kernels.arrays import FloatArray, Handle
from chemlab.kernels.jit import kernel
from chemlab.physics import backends as laws
from chemlab.physics.backends.real.crystals import saturate
from chemlab.physics.backends.real.heats import enthalpy
from chemlab.physics.backends.real.kinetics import SATURATION
from chemlab.physics.backends.real.liquids import clear_liquids, gather, liquids_in, split
from chemlab.physics.chemistry import AMOUNTS, TEMPERATURE, build_chemistry, element_matrix
from chemlab.physics.constants import GAS_CONSTANT, TRACE_MOL
from chemlab.physics.shelf import Shelf
from chemlab.physics.stratification import profile
from chemlab.physics.transfer import add, free_liquid, liquid_volume, pour, strain

MATERIALS = shipped_materials()
CRUDE = ("benzoic_acid", "salicylic_acid", "NaCl", "silica", "water", "ethanol")
PIXELS = 100


def insulated(*names: str) -> Glass:
    """Vessels that exchange no heat with the room."""
    return Glass(*names, room_transfer_w_k_l=0.0)


def elapse(glass: Glass, position: int, ticks: float, kelvin: float | None = None) -> None:
    """Time passes, at a temperature that is kept if one is given."""
    row = glass.rows[position]
    for _ in range(10):
        if kelvin is not None:
            row[TEMPERATURE] = kelvin
        laws.elapse(row, ticks / 10.0, glass.chem, glass.waste, glass.events, glass.work)
        laws.partition(row, glass.chem, glass.work)
    if kelvin is not None:
        row[TEMPERATURE] = kelvin


def settle(glass: Glass, position: int) -> None:
    """What is at equilibrium at once."""
    laws.settle_phases(glass.rows[position], glass.chem, glass.waste, glass.events, glass.work)
    laws.partition(glass.rows[position], glass.chem, glass.work)


def strained(glass: Glass, share: float = 1.0, cake_liquid: float = 0.4) -> None:
    """Filter vessel 0 into vessel 1."""
    columns = glass.shelf.layout.fluid_columns
    layers, shares = np.zeros(columns + 1, dtype=np.int64), np.zeros((columns, PIXELS))
    profile(glass.rows[0], glass.chem, layers, shares, np.zeros((columns + 9, PIXELS)))
    litres = share * free_liquid(glass.rows[0], cake_liquid, glass.chem)
    strain(glass.rows[0], glass.rows[1], litres, layers, glass.chem, glass.waste, glass.events)


def crystals(glass: Glass, position: int, name: str) -> float:
    return float(laws.solid_mol(glass.rows[position], glass.names.index(name), glass.chem))


def litres(name: str, mol: float) -> float:
    return mol * MATERIALS[name].molar_mass_g_mol / (1000.0 * MATERIALS[name].density_kg_l)


@pytest.mark.parametrize(
    ("solute", "solvent", "kelvin"),
    [
        *itertools.product(("benzoic_acid", "salicylic_acid", "acetanilide"), ("water",), (278.15, 298.15, 353.15)),
        *itertools.product(("benzoic_acid",), ("ethanol", "toluene"), (278.15, 298.15)),
    ],
)
def test_what_stays_dissolved_is_the_solubility(solute: str, solvent: str, kelvin: float) -> None:
    """From above and from below: the heat of fusion and NRTL in NumPy say the same."""
    glass = insulated(solute, solvent)
    held = solubility(glass.scenario, solute, solvent, kelvin) * litres(solvent, 20.0)
    glass.fill(0, {solute: 3.0 * held, solvent: 20.0}, capacity_l=50.0, kelvin=kelvin)
    elapse(glass, 0, 1000.0, kelvin)
    assert 3.0 * held - crystals(glass, 0, solute) == pytest.approx(held, rel=1e-5)
    glass.fill(0, {solute: 3.0 * held, solvent: 20.0}, capacity_l=50.0, kelvin=kelvin + 10.0)
    elapse(glass, 0, 1000.0, kelvin + 10.0)
    warm = crystals(glass, 0, solute)
    elapse(glass, 0, 1000.0, kelvin)
    assert crystals(glass, 0, solute) > warm
    assert 3.0 * held - crystals(glass, 0, solute) == pytest.approx(held, rel=1e-5)


@kernel
def _activity(row: FloatArray, material: int, mol: float, chem: Handle) -> float:
    """Return ln of the activity of ``mol`` of a material that is all crystals yet, dissolved in the liquids."""
    block = clear_liquids()
    liquids = liquids_in(block)
    at = gather(row, chem, block)
    liquids.who[at], liquids.mol[at], liquids.share[at] = material, mol, 0.0
    split(at + 1, row[TEMPERATURE], chem, block)
    phase = 2 * at + 1 if liquids.share[at] > 0.5 else at
    return liquids.log_gamma[phase] + math.log(liquids.x[phase])


@pytest.mark.parametrize(
    ("kelvin", "water", "other", "mol", "total"),
    [
        *((kelvin, 6.0, "NaCl", 0.145, 0.25) for kelvin in (350.0, 367.8, 367.95, 368.0, 368.05, 368.1, 369.0)),
        (381.207, 2.7159, "NaCl", 0.1248, 1.9872),
        (348.839, 3.9394, "toluene", 0.1136, 2.9117),
        (352.789, 5.1814, "toluene", 0.1184, 1.2314),
        (346.738, 2.2623, "toluene", 0.0595, 0.9064),
    ],
)
def test_what_saturates_water_beside_an_oil(kelvin: float, water: float, other: str, mol: float, total: float) -> None:
    """Hot benzoic acid forms an oil in salt water: over a wide range, more of it hardly changes its activity."""
    glass = Glass("benzoic_acid", "water", other)
    glass.fill(0, {"water": water, other: mol, "benzoic_acid": total}, kelvin=kelvin)
    row, acid, melts = glass.rows[0], glass.names.index("benzoic_acid"), MATERIALS["benzoic_acid"]
    row[TEMPERATURE] = kelvin
    saturate(row, glass.chem, glass.work)
    found = glass.work[SATURATION, list(glass.shelf.layout.dissolved).index("benzoic_acid")]
    target = -melts.real.fusion_enthalpy_j_mol / GAS_CONSTANT * (1.0 / kelvin - 1.0 / melts.melting_point_k)

    def excess(amount: float) -> float:
        """By how much its activity is above that of its crystals, in ln."""
        return float(_activity(row, acid, amount, glass.chem)) - target

    if found == math.inf:
        assert excess(total) < 0.0
    else:
        assert excess(0.98 * found) < 0.0 < excess(1.02 * found)


def test_a_clear_solution_waits_for_a_seed() -> None:
    """Below the metastable limit nothing comes down until there is a crystal; beyond it all by itself."""
    kelvin, water = 298.15, 20.0
    for supersaturation, alone in ((1.2, False), (1.4, True)):
        glass = insulated("benzoic_acid", "water")
        assert 1.2 < glass.scenario.real.metastable < 1.4
        held = solubility(glass.scenario, "benzoic_acid", "water", kelvin) * litres("water", water)
        mol = supersaturation * held
        glass.fill(0, {"benzoic_acid": mol, "water": water}, kelvin=353.15)
        elapse(glass, 0, 1000.0, 353.15)
        assert crystals(glass, 0, "benzoic_acid") < TRACE_MOL
        elapse(glass, 0, 1000.0, kelvin)
        assert (crystals(glass, 0, "benzoic_acid") > TRACE_MOL) == alone
        add(glass.rows[0], glass.names.index("benzoic_acid"), 1e-4, kelvin, glass.chem, glass.waste, glass.events)
        elapse(glass, 0, 1000.0, kelvin)
        assert mol + 1e-4 - crystals(glass, 0, "benzoic_acid") == pytest.approx(held, rel=1e-5)


def test_crystals_grow_at_the_scenarios_rate() -> None:
    """What is missing to saturation falls as exp(-k t)."""
    glass, kelvin, water = insulated("benzoic_acid", "water"), 298.15, 20.0
    real = glass.scenario.real
    held = solubility(glass.scenario, "benzoic_acid", "water", kelvin) * litres("water", water)
    glass.fill(0, {"benzoic_acid": 5.0 * held, "water": water}, kelvin=368.15)
    elapse(glass, 0, 1000.0, 368.15)
    elapse(glass, 0, 3.0, kelvin)
    left = 5.0 * held - crystals(glass, 0, "benzoic_acid") - held
    expected = (5.0 * held - held) * math.exp(-real.crystal_rate * 3.0 * real.tick_s)
    # Half of a tenth of each step is at a temperature that crystallization has raised.
    assert left == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_a_filter_keeps_solids_and_some_liquor(share: float) -> None:
    glass = insulated(*CRUDE)
    contents = {"benzoic_acid": 0.3, "salicylic_acid": 0.01, "NaCl": 0.1, "silica": 0.2, "water": 30.0, "ethanol": 1.0}
    glass.fill(0, contents)
    glass.fill(1, {})
    settle(glass, 0)
    elapse(glass, 0, 100.0, 298.15)
    settle(glass, 0)
    before, solids = glass.rows[0].copy(), float(laws.solid_volume(glass.rows[0], glass.chem))
    liquid = float(liquid_volume(glass.rows[0], glass.chem))
    content = enthalpy(glass.rows[0], glass.chem)
    strained(glass, share)
    assert solids > 0.025
    assert float(laws.solid_volume(glass.rows[0], glass.chem)) == pytest.approx(solids, rel=1e-12)
    ran = share * (liquid - 0.4 * solids)
    assert float(liquid_volume(glass.rows[1], glass.chem)) == pytest.approx(ran, rel=1e-9)
    assert float(laws.solid_volume(glass.rows[1], glass.chem)) == pytest.approx(0.0, abs=1e-15)
    # Both liquors are one solution, and nothing is lost, neither matter nor heat.
    for k, name in enumerate(glass.shelf.layout.dissolved):
        there, here = glass.shelf.dissolved[0, 1, k].sum(), glass.shelf.dissolved[0, 0, k].sum()
        assert there * (liquid - ran) == pytest.approx(here * ran, rel=1e-9, abs=1e-15), name
    np.testing.assert_allclose((glass.rows[0] + glass.rows[1])[AMOUNTS:], before[AMOUNTS:], rtol=1e-12, atol=1e-15)
    after = enthalpy(glass.rows[0], glass.chem) + enthalpy(glass.rows[1], glass.chem)
    assert after == pytest.approx(content, rel=1e-12)


def test_a_wash_thins_the_liquor_in_the_cake() -> None:
    """Salt left: by what stays in the cake over what was there with the wash, each time."""
    glass = insulated(*CRUDE)
    glass.fill(0, {"silica": 5.0, "NaCl": 0.1, "water": 20.0})
    glass.fill(1, {})
    settle(glass, 0)
    strained(glass)
    expected = glass.mol(0, "Na+")
    for wash_mol in (3.0, 6.0):
        add(glass.rows[0], glass.names.index("water"), wash_mol, 298.15, glass.chem, glass.waste, glass.events)
        settle(glass, 0)
        wet = float(liquid_volume(glass.rows[0], glass.chem))
        strained(glass)
        expected *= 0.4 * litres("silica", 5.0) / wet
        assert glass.mol(0, "Na+") == pytest.approx(expected, rel=1e-9)
    assert expected < 0.02 * 0.1


def test_a_mixture_dries_as_integrated_by_scipy() -> None:
    """dn/dV = x gamma p / RT of ethanol and water, one liquid."""
    names, kelvin, start, air = ("ethanol", "water"), 300.0, np.array([1.0, 2.0]), 400.0
    table = pair_table(names, shipped_pairs())
    tau = table.a + table.b / kelvin + table.c * math.log(kelvin / REFERENCE_K)
    pressure = np.array([pascal(MATERIALS, name, kelvin) for name in names]) * 1e-3

    def rates(_: float, n: np.ndarray) -> np.ndarray:
        n = np.maximum(n, 1e-30)
        x = n / n.sum()
        gamma = np.exp(log_activity_coefficients(x, tau, table.alpha))
        return np.asarray(-x * gamma * pressure / (GAS_CONSTANT * kelvin))

    expected = solve_ivp(rates, (0.0, air), start, rtol=1e-9, atol=1e-12).y[:, -1]
    glass = insulated(*names)
    glass.fill(0, dict(zip(names, start.tolist(), strict=True)), kelvin=kelvin)
    laws.dry(glass.rows[0], air, glass.chem, glass.waste)
    assert 0.1 < expected[0] < 0.8
    left = np.array([glass.mol(0, name) for name in names])
    assert left == pytest.approx(expected, rel=3e-3)  # the vapour pressure's table has straight lines
    assert [glass.waste[glass.names.index(name)] for name in names] == pytest.approx(start - left, rel=1e-12)
    assert glass.rows[0, TEMPERATURE] == kelvin


@pytest.mark.parametrize("kelvin", [365.0, 370.0])
def test_what_flies_first_is_gone_before_the_rest(kelvin: float) -> None:
    """Of naphthalene over hot brine hardly any is left when the water goes: too small a number to be divided by."""
    shelf = Shelf.empty(load_scenario("benzoic"), 1, 1)
    names, fluids = list(shelf.layout.materials), list(shelf.layout.dissolved)
    shelf.rows[0, TEMPERATURE] = kelvin
    contents = {"water": 7.9, "benzoic_acid": 0.0092, "naphthalene": 0.0026, "Na+": 0.03, "SO4--": 0.015}
    for name, mol in contents.items():
        shelf.rows[0, AMOUNTS + names.index(name)] = mol
        shelf.dissolved[0, 0, fluids.index(name)] = mol, 0.0
    laws.dry(shelf.rows[0], 400.0, shelf.chem(), shelf.waste[0])
    assert np.isfinite(shelf.rows).all()
    amounts = dict(zip(names, shelf.amounts[0, 0] + shelf.waste[0], strict=True))
    for name in ("water", "benzoic_acid", "naphthalene"):
        assert amounts[name] == pytest.approx(contents[name], rel=1e-12)
    assert shelf.amounts[0, 0, names.index("naphthalene")] < 1e-12


def test_what_does_not_fly_stays() -> None:
    glass = insulated(*CRUDE)
    glass.fill(0, {"benzoic_acid": 0.3, "NaCl": 0.01, "silica": 0.1, "water": 1.0, "ethanol": 0.2})
    settle(glass, 0)
    elapse(glass, 0, 100.0, 298.15)
    for _ in range(8):
        laws.dry(glass.rows[0], 300.0, glass.chem, glass.waste)
        settle(glass, 0)
        elapse(glass, 0, 100.0, 298.15)
    assert glass.mol(0, "water") < 1e-9
    assert glass.mol(0, "ethanol") < 1e-9
    assert glass.mol(0, "NaCl") == pytest.approx(0.01, rel=1e-9)
    assert glass.mol(0, "silica") == 0.1
    # Benzoic acid in solution has a vapour pressure of its own, of a few pascal.
    assert 0.298 < glass.mol(0, "benzoic_acid") <= 0.3
    assert crystals(glass, 0, "benzoic_acid") == pytest.approx(glass.mol(0, "benzoic_acid"), rel=1e-6)


def test_crystals_under_the_last_trace_of_a_liquid() -> None:
    """What has dried to nothing begins to dissolve again in a trace of something else: no division by what is gone."""
    for left in (0.0, 5e-324):
        glass = insulated(*CRUDE)
        glass.fill(0, {"benzoic_acid": 1e-4, "salicylic_acid": 4e-11, "silica": 0.2})
        fluids = glass.shelf.layout.dissolved
        glass.shelf.dissolved[0, 0, fluids.index("salicylic_acid")] = 0.0, 4e-11
        glass.shelf.dissolved[0, 0, fluids.index("benzoic_acid")] = 0.0, left
        laws.elapse(glass.rows[0], 1.0, glass.chem, glass.waste, glass.events, glass.work)
        assert np.isfinite(glass.rows).all()
        assert 0.0 < glass.shelf.dissolved[0, 0, fluids.index("benzoic_acid")].sum() < 1e-9


def test_the_paper_dries_by_its_own_vapor_pressure() -> None:
    shelf = Shelf(build_chemistry(load_scenario("wurtz_dodecane")), 1, 1)
    row, chem = shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "Na": 0.5}).row, shelf.chem()
    names = shelf.layout.materials
    waste, air = np.zeros(len(names)), 30.0
    row[TEMPERATURE] = 290.0
    pressure = float(laws.vapor_pressure(row, chem))
    laws.dry(row, air, chem, waste)
    gone = 4.0 - row[AMOUNTS + names.index("diethyl_ether")]
    assert gone == pytest.approx(pressure * air / (GAS_CONSTANT * 290.0), rel=1e-9)
    assert waste.sum() == pytest.approx(gone, rel=1e-12)
    laws.dry(row, 1e6, chem, waste)
    assert row[AMOUNTS + names.index("diethyl_ether")] < 1e-9
    assert row[AMOUNTS + names.index("Na")] == 0.5


@pytest.mark.parametrize("seed", range(4))
def test_matter_and_energy_are_balanced_over_random_operations(seed: int) -> None:
    """Every joule: what the bath gives, what solvents and seeds bring, what vapour takes along as liquid (its heat of
    vaporization is the air's, or the condenser's), what keeps the temperature while salts fall out in a dryer."""
    rng, glass = np.random.default_rng(seed), insulated(*CRUDE)
    atoms = element_matrix(glass.scenario)
    known = glass.shelf.known()
    formation = np.array([MATERIALS[n].real.formation_enthalpy_j_mol for n in glass.names])  # type: ignore[union-attr]
    fusion = np.asarray(known.fusion)  # type: ignore[attr-defined]
    liquid = formation + np.where([MATERIALS[n].real.formation_state == "s" for n in glass.names], fusion, 0.0)  # type: ignore[union-attr]
    limits = np.array([368.15, 275.15, 1.0, 1.0])
    boiled = 0
    glass.fill(0, {"benzoic_acid": 0.3, "salicylic_acid": 0.05, "NaCl": 0.1, "silica": 0.2}, capacity_l=50.0)
    glass.fill(1, {}, capacity_l=50.0)
    glass.fill(2, {}, capacity_l=50.0)
    settle(glass, 0)

    def energy() -> float:
        return sum(float(enthalpy(row, glass.chem)) for row in glass.rows)

    def held(mol: np.ndarray, kelvin: float) -> float:
        return float(mol @ (liquid + known.heat_capacity * (kelvin - 298.15)))

    total, books = glass.shelf.amounts[0].sum(axis=0), energy()
    added = np.zeros_like(total)
    for _ in range(150):
        kind = rng.integers(7)
        row, kelvin = glass.rows[0], float(glass.rows[0, TEMPERATURE])
        waste = glass.waste.copy()
        if kind == 0:
            joules = float(rng.normal(0.0, 40e3))
            sinks = glass.waste, glass.events
            went, taken = laws.heat(row, glass.rows[1], joules, limits, glass.chem, *sinks, glass.work)
            books += went - taken
        elif kind == 1:
            name = str(rng.choice(["water", "ethanol", "benzoic_acid"], p=[0.5, 0.3, 0.2]))
            mol, i = float(rng.uniform(0.0, 8.0)) if name != "benzoic_acid" else 1e-3, glass.names.index(name)
            add(row, i, mol, 298.15, glass.chem, glass.waste, glass.events)
            added[i] += mol
            books += mol * (liquid[i] - (fusion[i] if name == "benzoic_acid" else 0.0))
        elif kind == 2:
            strained(glass, float(rng.uniform()))
        elif kind == 3:
            there = glass.shelf.amounts[0, 0].copy()
            laws.dry(row, float(rng.uniform(0.0, 100.0)), glass.chem, glass.waste)
            books += held(glass.shelf.amounts[0, 0] - there, kelvin)  # salts fall out at that temperature, too
        elif kind == 4:
            pour(glass.rows[1], row, float(rng.uniform()), glass.chem, glass.waste, glass.events)
        elif kind == 5:
            pour(row, glass.rows[2], float(rng.uniform(0.0, 0.2)), glass.chem, glass.waste, glass.events)
        before, waste = energy(), glass.waste.copy()
        for position in range(3):
            settle(glass, position)
            laws.elapse(glass.rows[position], 3.0, glass.chem, glass.waste, glass.events, glass.work)
            laws.partition(glass.rows[position], glass.chem, glass.work)
        if (glass.waste != waste).any():  # what boils from the heat of crystals takes its heat of vaporization along
            books += energy() - before
            boiled += 1
        assert np.isfinite(glass.rows).all()
        assert glass.shelf.amounts.min() >= 0.0
        assert glass.shelf.dissolved.min() >= 0.0
        # In joules: what stands there amounts to some ten million.
        assert energy() == pytest.approx(books, rel=1e-9)
        now = glass.shelf.amounts[0].sum(axis=0) + glass.waste
        np.testing.assert_allclose(atoms @ now, atoms @ (total + added), rtol=1e-9, atol=1e-12)
    assert boiled < 50
