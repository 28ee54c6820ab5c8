"""The laws of the tier ``real`` together: against independent integrations, closed forms and conservation."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import pascal

from chemlab.config.loading import load_scenario
from chemlab.config.pairs import log_activity_coefficients, pair_table, shipped_pairs
from chemlab.config.scenario import Scenario
from chemlab.physics import backends as laws
from chemlab.physics.backends.real.heats import enthalpy
from chemlab.physics.backends.real.partition import place_new
from chemlab.physics.chemistry import AIR, AMOUNTS, CLOCK, TEMPERATURE, element_matrix
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.physics.shelf import T_MIX, Shelf
from chemlab.physics.surroundings import Surroundings
from chemlab.physics.thermal import pressure
from chemlab.physics.transfer import pour

FORMIC_ACID = Path(__file__).parent / "formic_acid"
VALIDATION = Path(__file__).resolve().parents[2] / "studies" / "physics"


def scenario(
    *names: str, reactions: str = "salt_water", files: Path | None = None, ambient: float = 101.325, **real: float
) -> Scenario:
    """A laboratory of the real tier with some materials in its bottles; ``real`` as in its [real], ``files`` a folder
    with formic acid and its pairs, ``ambient`` the pressure in kPa."""
    own = [] if files is None else [str(files / f"{kind}.toml") for kind in ("materials", "pairs")]
    return load_scenario(
        {
            "material_files": own[:1],
            "pair_files": own[1:],
            "ambient_pressure_kpa": ambient,
            "name": "glass",
            "title": "glass",
            "summary": "glass",
            "physics": "real",
            "real": real,
            "reactions": reactions,
            "goals": [names[0]],
            "lab_goals": [names[0]],
            "theoretical_maximum_mol": {names[0]: 1.0},
            "stock": dict.fromkeys(names, 1.0),
            "shelf": {"slots": 2, "vessel": [{"capacity_l": 1.0}]},
            "benches": {"dit": {"kind": "distillation"}},
            "limits": {"manager_actions": 10, "ticks": 10},
        }
    )


class Glass:
    """Three vessels of one chemistry, and the laws by name."""

    def __init__(self, *names: str, **arguments: Any) -> None:
        self.scenario = scenario(*names, **arguments)
        self.shelf = Shelf.empty(self.scenario, 1, 3)
        self.names = list(self.shelf.layout.materials)
        self.chem: Any = self.shelf.chem()
        self.rows, self.waste = self.shelf.rows, self.shelf.waste[0]
        self.events = np.zeros(len(self.scenario.safety_events))
        self.work = np.zeros(np.maximum(laws.work_size(self.shelf.chemistry), (4, 64)))

    def fill(self, position: int, contents: dict[str, float], capacity_l: float = 5.0, kelvin: float = 298.15) -> None:
        """Contents at equilibrium at a temperature."""
        self.shelf.fill(0, position, capacity_l, contents)
        self.rows[position, TEMPERATURE] = kelvin
        self.stir(position)

    def stir(self, position: int) -> None:
        """Bring the phases to equilibrium."""
        self.rows[position, CLOCK] = T_MIX
        laws.partition(self.rows[position], self.chem, self.work)

    def mol(self, position: int, name: str) -> float:
        """mol of a material."""
        return float(self.rows[position, AMOUNTS + self.names.index(name)])

    def phases(self, position: int) -> dict[str, tuple[float, float]]:
        """{fluid: (mol in water, mol in the organic phase)}."""
        dissolved = self.shelf.dissolved[0, position]
        return {n: (float(a), float(b)) for n, (a, b) in zip(self.shelf.layout.dissolved, dissolved, strict=True)}

    def heat(self, joules: float, stages: int = 1, reflux: float = 0.0) -> tuple[float, float]:
        """Boil vessel 0 into vessel 1."""
        limits = np.array([850.0, 250.0, stages, reflux])
        made: Any = laws.heat(*self.rows[:2], joules, limits, self.chem, self.waste, self.events, self.work)
        return float(made[0]), float(made[1])


CHARGES = {
    "ether, dodecane": ({"diethyl_ether": 4.0, "dodecane": 0.45}, "dodecane"),
    "ether, 1-chlorohexane, dodecane": ({"diethyl_ether": 4.0, "1-chlorohexane": 0.5, "dodecane": 0.25}, "dodecane"),
}


def judged(charge: str) -> list[tuple[float, float, float]]:
    """(purity, recovery, K) of an independent integration with UNIFAC (studies/physics/distillation.py)."""
    with (VALIDATION / "distillation.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["charge"] == charge]
    return [(float(r["purity"]), float(r["recovery"]), float(r["pot_k"])) for r in rows if float(r["purity"]) >= 0.95]


@pytest.mark.parametrize("charge", CHARGES)
def test_distillation_follows_an_independent_rayleigh_integration(charge: str) -> None:
    contents, kept = CHARGES[charge]
    glass = Glass(*contents)
    glass.fill(0, contents)
    glass.fill(1, {})
    points = judged(charge)[:4]
    assert len(points) == 4
    for purity, recovery, kelvin in points:
        while glass.mol(0, kept) / sum(glass.mol(0, name) for name in contents) < purity:
            glass.heat(100.0)
        assert glass.mol(0, kept) / contents[kept] == pytest.approx(recovery, abs=0.02)
        assert glass.rows[0, TEMPERATURE] == pytest.approx(kelvin, abs=2.0)


@pytest.mark.parametrize("stages", [1, 3, 6])
def test_a_column_at_high_reflux_separates_as_fenske_says(stages: int) -> None:
    # Isomers: all but ideal, and of nearly constant relative volatility, so Fenske's equation (1932) holds.
    glass = Glass("1-chlorohexane", "3-chlorohexane")
    glass.fill(0, {"1-chlorohexane": 20.0, "3-chlorohexane": 20.0}, kelvin=400.0)
    glass.fill(1, {})
    while glass.mol(1, "3-chlorohexane") == 0.0:
        glass.heat(20_000.0, stages=stages, reflux=100.0)
    over = glass.mol(1, "3-chlorohexane") / glass.mol(1, "1-chlorohexane")
    materials, kelvin = glass.scenario.materials, glass.rows[0, TEMPERATURE]
    alpha = pascal(materials, "3-chlorohexane", kelvin) / pascal(materials, "1-chlorohexane", kelvin)
    assert np.log(over) == pytest.approx(stages * np.log(alpha), rel=0.05)


def over(glass: Glass, contents: dict[str, float]) -> tuple[float, float]:
    """(boiling point, mole fraction of the first in what comes over) of a large charge that hardly boils."""
    first, second = contents
    glass.fill(0, {name: 20.0 * mol for name, mol in contents.items()}, kelvin=350.0)
    glass.fill(1, {})
    while glass.mol(1, first) + glass.mol(1, second) < 0.02:
        glass.heat(2000.0)
    return float(glass.rows[0, TEMPERATURE]), glass.mol(1, first) / (glass.mol(1, first) + glass.mol(1, second))


def test_water_and_acetic_acid_have_no_azeotrope() -> None:
    """The vapour over water and acetic acid at 101.3 kPa.

    Mole fractions as textbooks of distillation tabulate them (secondary, as remembered; the system was measured, for
    example, by Sebastiani and Lacquaniti, Chem. Eng. Sci. 22 (1967) 1155).
    """
    glass = Glass("water", "acetic_acid")
    for x, y in {0.1: 0.167, 0.3: 0.425, 0.5: 0.626, 0.7: 0.795, 0.9: 0.930, 0.95: 0.963}.items():
        assert over(glass, {"water": x, "acetic_acid": 1.0 - x})[1] == pytest.approx(y, abs=0.035)
    # Without dimers the relative volatility of water is 0.6 here.
    richest = over(glass, {"water": 0.98, "acetic_acid": 0.02})[1]
    assert richest / (1.0 - richest) > 1.2 * 0.98 / 0.02


@pytest.mark.parametrize(
    ("first", "second", "fraction", "kelvin"),
    [
        # Gmehling et al., Azeotropic Data, as in the CRC Handbook of Chemistry and Physics.
        ("ethanol", "water", 0.894, 351.3),
        ("ethyl_acetate", "ethanol", 0.54, 344.9),
        # 107.6 C at 77.5 % of the mass formic acid (handbooks), where it boils highest. Material and pair as ``chemlab
        # data material`` and ``chemlab data pairs`` make them: activity coefficients are UNIFAC's, and leave 2 K.
        ("water", "formic_acid", 0.43, 380.75),
    ],
)
def test_azeotropes(first: str, second: str, fraction: float, kelvin: float) -> None:
    highest = second == "formic_acid"
    glass = Glass(first, second, files=FORMIC_ACID if highest else None)
    low, high = (0.2, 0.7) if highest else (0.3, 0.98)
    for _ in range(12):
        x = 0.5 * (low + high)
        low, high = (low, x) if (over(glass, {first: x, second: 1.0 - x})[1] > x) == highest else (x, high)
    assert low == pytest.approx(fraction, abs=0.02 if highest else 0.03)
    assert over(glass, {first: low, second: 1.0 - low})[0] == pytest.approx(kelvin, abs=2.0 if highest else 1.5)


@pytest.mark.parametrize("kelvin", [300.0, 350.0, 391.05, 420.0])
def test_the_vapour_pressure_of_a_pure_acid_is_that_of_its_data(kelvin: float) -> None:
    glass = Glass("acetic_acid")
    glass.fill(0, {"acetic_acid": 1.0}, kelvin=kelvin)
    expected = pascal(glass.scenario.materials, "acetic_acid", kelvin) / 1000.0
    assert laws.vapor_pressure(glass.rows[0], glass.chem) == pytest.approx(expected, rel=1e-3)


def test_dimers_join_vapour_pressure_and_heat_of_vaporization() -> None:
    """Clausius and Clapeyron: dH = Z R T^2 d ln p / dT. With Z, mol of vapour for each of molecules, from the dimers it
    is the tabulated heat (CRC Handbook, 23.70 kJ/mol at the boiling point); of an ideal gas it would be 39 kJ/mol."""
    material = Glass("acetic_acid").scenario.materials["acetic_acid"]
    kelvin, step = material.boiling_point_k, 0.1
    pascal = material.real.vapor_pressure.pascal(np.array([kelvin - step, kelvin, kelvin + step]))
    whole = pascal[1] / 1000.0
    alone = float(material.real.dimerization.monomer(np.array(kelvin), np.array(whole)))
    z = whole / (alone + 2.0 * (whole - alone))
    heat = z * GAS_CONSTANT * kelvin**2 * np.log(pascal[2] / pascal[0]) / (2.0 * step)
    assert heat == pytest.approx(23_700.0, rel=0.02)


def test_a_column_knows_dimers_too() -> None:
    """Two stages at a reflux ratio of 100 are two equilibria, one above the other."""
    x = 0.5
    glass = Glass("water", "acetic_acid")
    first = over(glass, {"water": x, "acetic_acid": 1.0 - x})[1]
    second = over(glass, {"water": first, "acetic_acid": 1.0 - first})[1]
    glass.fill(0, {"water": 20.0 * x, "acetic_acid": 20.0 * (1.0 - x)}, kelvin=350.0)
    glass.fill(1, {})
    while glass.mol(1, "water") == 0.0:
        glass.heat(20_000.0, stages=2, reflux=100.0)
    found = glass.mol(1, "water") / (glass.mol(1, "water") + glass.mol(1, "acetic_acid"))
    assert found == pytest.approx(second, abs=0.01)


def test_traces_that_flash_do_not_cool_a_vessel_beyond_reason() -> None:
    """Flashing ends at the boiling point, at 160 K at least; it was at -11,819 K without heat to evaporate with."""
    glass = Glass("water", "diethyl_ether", "dodecane", "NaCl")
    rng = np.random.default_rng(2)
    for _ in range(300):
        row = glass.rows[0]
        glass.fill(0, {name: 10.0 ** rng.uniform(-14, -6) for name in ("water", "diethyl_ether", "dodecane")})
        row[AMOUNTS + glass.names.index("NaCl")] = 10.0 ** rng.uniform(-14, -6)
        row[TEMPERATURE] = hot = rng.uniform(400.0, 900.0)
        laws.vent(row, 10.0 ** rng.uniform(0, 3), glass.chem, glass.waste, glass.events)
        assert 160.0 <= row[TEMPERATURE] <= hot
        if rng.random() < 0.5:
            row[AMOUNTS:] = 0.0
        laws.elapse(row, 1.0, glass.chem, glass.waste, glass.events, glass.work)
        assert row[TEMPERATURE] == pytest.approx(298.15, abs=1e-6)


@pytest.mark.parametrize("residue", [0.0, 1e-6, 1e-4, 1e-2])
def test_a_pot_that_boils_dry_is_no_colder_than_before(residue: float) -> None:
    """Heat that boils a pot dry never cools what stays in it, and the balance of energy is exact."""
    glass = Glass("water", "ethanol", "NaCl", ambient=60.0)
    rng = np.random.default_rng(1)
    for _ in range(20):
        glass.fill(0, {"water": 10.0 ** rng.uniform(-6, 0), "ethanol": 10.0 ** rng.uniform(-6, 0)})
        glass.rows[0, AMOUNTS + glass.names.index("NaCl")] = residue
        glass.fill(1, {})
        laws.settle_phases(glass.rows[0], glass.chem, glass.waste, glass.events, glass.work)
        before, cold = enthalpy(glass.rows[0], glass.chem), glass.rows[0, TEMPERATURE]
        for joules in 10.0 ** rng.uniform(0, 5, 4):
            taken, condensed = glass.heat(joules)
            before += taken - condensed
            # The mantle has 850 K; salt that falls out last warms what is left by some mK.
            assert cold <= glass.rows[0, TEMPERATURE] < 851.0
        place_new(glass.rows[1], glass.chem)
        after = enthalpy(glass.rows[0], glass.chem) + enthalpy(glass.rows[1], glass.chem)
        assert after == pytest.approx(before, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("kelvin", [50.0, 298.15, 5000.0])
def test_activities_and_pressures_are_numbers_at_any_temperature(kelvin: float, tmp_path: Path) -> None:
    """Far from where its parameters were made for, a pair has tau = -2000 by its formula, and e^2000 is no number."""
    (tmp_path / "materials.toml").write_bytes((FORMIC_ACID / "materials.toml").read_bytes())
    pair = 'of = ["water", "formic_acid"], a = [0.0, 0.0], b = [-1e5, -1e5], alpha = 1.0, low_k = 1000.0'
    (tmp_path / "pairs.toml").write_text(
        f'pairs = [{{ {pair}, high_k = 2000.0, error = 0.0, source = "made up" }}]\n[lock]\ncommand = "by hand"\n'
    )
    glass = Glass("water", "formic_acid", files=tmp_path)
    glass.fill(0, {"water": 0.1, "formic_acid": 0.1}, kelvin=kelvin)
    assert np.isfinite(glass.rows[0]).all()
    found = laws.vapor_pressure(glass.rows[0], glass.chem)
    assert np.isfinite(found)
    assert found >= 0.0


def test_a_column_holds_back_what_never_evaporates() -> None:
    """Products of its ratios over many stages were infinite."""
    glass = Glass("water", "ethanol", "acetylsalicylic_acid")
    glass.fill(0, {"water": 5.0, "ethanol": 5.0, "acetylsalicylic_acid": 0.5}, kelvin=350.0)
    glass.fill(1, {})
    glass.heat(100_000.0, stages=16, reflux=5.0)
    assert np.isfinite(glass.rows).all()
    assert glass.mol(1, "ethanol") > 0.05
    assert glass.mol(1, "acetylsalicylic_acid") < 1e-9


def test_what_water_dissolves() -> None:
    glass = Glass("water", "diethyl_ether", "NaCl", "1-chlorohexane", "dodecane")
    glass.fill(0, {"water": 1000.0 / 18.01528, "NaCl": 20.0})
    laws.settle_phases(glass.rows[0], glass.chem, glass.waste, glass.events, glass.work)
    assert glass.mol(0, "Na+") == pytest.approx(6.15, rel=0.02)  # CRC Handbook: 26.4 % by mass at 298 K
    glass.fill(1, {"diethyl_ether": 9.6, "NaCl": 1.0})
    laws.settle_phases(glass.rows[1], glass.chem, glass.waste, glass.events, glass.work)
    assert glass.mol(1, "Na+") < 1e-6
    glass.fill(2, {"water": 20.0, "diethyl_ether": 4.0, "1-chlorohexane": 0.1, "dodecane": 0.1})
    phases = glass.phases(2)
    for name in ("1-chlorohexane", "dodecane"):
        assert phases[name][0] < 2e-3 * phases[name][1]


@pytest.mark.parametrize("solute", ["1-chlorohexane", "ethanol", "benzoic_acid"])
@pytest.mark.parametrize("solvent", ["diethyl_ether", "toluene"])
def test_distribution_is_that_of_the_pairs(solute: str, solvent: str) -> None:
    # studies/physics/distribution.csv: the same pairs at infinite dilution, in phases as UNIFAC has them.
    with (VALIDATION / "distribution.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if (row["solute"], row["solvent"]) == (solute, solvent)]
    glass = Glass("water", solvent, solute)
    glass.fill(0, {"water": 20.0, solvent: 20.0, solute: 1e-6})
    if solute == "benzoic_acid":  # it lies in the vessel as crystals
        for _ in range(200):
            laws.elapse(glass.rows[0], 1.0, glass.chem, glass.waste, glass.events, glass.work)
        glass.stir(0)
    phases, known = glass.phases(0), glass.shelf.known()
    litres = [sum(phases[n][p] * known.molar_volume[glass.names.index(n)] for n in phases) for p in range(2)]
    aqueous, organic = (phases[solute][p] / litres[p] for p in range(2))
    assert np.log10(organic / aqueous) == pytest.approx(float(rows[0]["shipped"]), abs=0.2)


def test_molecules_have_one_activity_in_both_phases() -> None:
    contents = {"water": 10.0, "diethyl_ether": 3.0, "ethanol": 1.0, "1-chlorohexane": 0.3, "benzoic_acid": 0.05}
    names = list(contents)
    glass = Glass(*names)
    glass.fill(0, contents, kelvin=400.0)  # above its melting point benzoic acid is a liquid like the others
    kelvin = float(glass.rows[0, TEMPERATURE])  # melting has cooled it a little
    assert 395.5 < kelvin < 400.0
    phases = glass.phases(0)
    table = pair_table(names, shipped_pairs())
    activities = []
    for phase in range(2):
        x = np.array([phases[name][phase] for name in names])
        x /= x.sum()
        activities.append(np.log(x) + log_activity_coefficients(x, table.tau(kelvin), table.alpha))
    np.testing.assert_allclose(activities[0], activities[1], atol=1e-5)


def test_random_operations_keep_atoms_and_energy() -> None:
    liquids = ("dodecane", "1-chlorohexane", "ethanol", "water", "diethyl_ether")
    glass = Glass(*liquids, "Na", "sodium_ethoxide", "NaCl", "NaOH", reactions="wurtz_real")
    atoms = element_matrix(glass.scenario)
    rng = np.random.default_rng(5)
    bottles = list(glass.scenario.stock)

    def heat_content() -> float:
        total = 0.0
        for row in glass.rows:
            place_new(row, glass.chem)
            total += enthalpy(row, glass.chem)
        return total

    for _episode in range(150):
        for position in range(3):
            chosen = rng.choice(bottles, rng.integers(0, 5), replace=False)
            glass.fill(position, {str(name): float(rng.exponential(0.5)) for name in chosen}, rng.uniform(0.5, 3.0))
        glass.waste[:] = 0.0
        for _turn in range(20):
            one, other = (int(i) for i in rng.choice(3, 2, replace=False))
            row, kind = glass.rows[one], int(rng.integers(6))
            before = atoms @ (glass.shelf.amounts[0].sum(axis=0) + glass.waste)
            content, lost = heat_content(), glass.waste.copy()
            balance: float | None = 0.0
            if kind == 0:
                laws.settle_phases(row, glass.chem, glass.waste, glass.events, glass.work)
            elif kind == 1:
                row[CLOCK] = rng.uniform(T_MIX, T_MIX + 6.0)
                laws.partition(row, glass.chem, glass.work)
            elif kind == 2:
                limits = np.array([800.0, 250.0, rng.integers(1, 5), 1.0])
                vessels = row, glass.rows[other]
                drawn, sinks = rng.normal(0, 3e4), (glass.waste, glass.events)
                made: Any = laws.heat(*vessels, drawn, limits, glass.chem, *sinks, glass.work)
                balance = float(made[0] - made[1])
            elif kind == 3:
                laws.elapse(row, rng.uniform(0, 5), glass.chem, glass.waste, glass.events, glass.work)
                balance = None  # heat goes to the room
            elif kind == 4:
                condenser = float(rng.choice([-1.0, 0.0, 20.0]))
                around = Surroundings(300.0, 0.0, condenser, 1e-3, 1e-6)
                balance = None if condenser > 0.0 else 0.0  # what it takes is not told
                laws.react(row, rng.uniform(0, 300), around, glass.chem, glass.waste, glass.events, glass.work)
            else:
                pour(row, glass.rows[other], rng.uniform(), glass.chem, glass.waste, glass.events)
            assert np.isfinite(glass.rows).all()
            assert glass.rows[:, AMOUNTS:].min() >= -1e-15
            after = atoms @ (glass.shelf.amounts[0].sum(axis=0) + glass.waste)
            np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-12)
            if balance is not None and (glass.waste == lost).all():
                assert heat_content() - content == pytest.approx(balance, abs=1e-9 * max(abs(content), 1e3))


@pytest.mark.parametrize("jacket", [263.0, 318.0, 360.0])
@pytest.mark.parametrize("mol", [1e-12, 1e-9, 1e-6, 1e-3, 1.0])
def test_a_jacket_brings_nothing_past_its_own_temperature(mol: float, jacket: float) -> None:
    """Nor what is left where nearly all has boiled away, which a jacket heats and cools in no time at all."""
    glass = Glass("diethyl_ether", "ethanol")
    glass.fill(0, {"diethyl_ether": mol, "ethanol": 0.1 * mol}, kelvin=303.0)  # boils at about 310 K
    around = Surroundings(jacket, 6.0, 80.0, 1e-3, 1e-6)
    for _ in range(3):
        laws.react(glass.rows[0], 60.0, around, glass.chem, glass.waste, glass.events, glass.work)
        # Next to nothing takes the temperature of the room, 298.15 K.
        assert min(jacket, 298.15) - 1e-9 <= glass.rows[0, TEMPERATURE] <= max(jacket, 303.0) + 1e-9


@pytest.mark.parametrize("charge", [charge for charge, _ in CHARGES.values()], ids=list(CHARGES))
def test_a_lot_of_heat_boils_off_what_it_does_little_by_little(charge: dict[str, float]) -> None:
    """What short steps leave is the limit of long ones."""
    at_once, slowly = Glass(*charge), Glass(*charge)
    for glass, times in ((at_once, 3), (slowly, 150)):
        glass.fill(0, charge)
        for _ in range(times):
            glass.heat(1.25e5 / times)
    for name, mol in charge.items():
        assert at_once.mol(0, name) == pytest.approx(slowly.mol(0, name), abs=0.006 * mol)
    assert at_once.rows[0, TEMPERATURE] == pytest.approx(slowly.rows[0, TEMPERATURE], abs=0.6)


def test_salts_fall_out_while_their_water_boils_away() -> None:
    """Superheated brine leaves no more dissolved than its water holds: stirring neither cools nor precipitates."""
    glass = Glass("water", "NaCl", "ethanol")
    glass.fill(0, {"water": 1.0, "NaCl": 0.1}, kelvin=298.15)
    row = glass.rows[0]
    row[TEMPERATURE] = 480.0
    insulated = Surroundings(300.0, 0.0, 0.0, 1e-3, 1e-6)
    laws.react(row, 1.0, insulated, glass.chem, glass.waste, glass.events, glass.work)
    assert glass.waste[glass.names.index("water")] > 0.1
    at, undissolved = row[TEMPERATURE], glass.mol(0, "NaCl")
    assert undissolved > 0.001
    glass.stir(0)
    assert glass.mol(0, "NaCl") == pytest.approx(undissolved, rel=1e-9)
    assert row[TEMPERATURE] == pytest.approx(at, abs=1e-6)


def test_gas_in_a_sealed_vessel() -> None:
    glass = Glass("diethyl_ether", "ethanol", "Na", reactions="wurtz_real")
    glass.fill(0, {}, capacity_l=1.0)
    row = glass.rows[0]
    row[AIR] = 0.04  # sealed
    row[AMOUNTS + glass.names.index("H2")] = 0.3
    assert pressure(row, glass.chem) == pytest.approx(0.34 * GAS_CONSTANT * 298.15 / 1.0)
