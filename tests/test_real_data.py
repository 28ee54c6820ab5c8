"""Data of the tier ``real``: against compilations, equations of state and each other, and unknown to ``paper``."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import changed, refused, written
from test_materials import GOO

from chemlab.config.datafile import DataError, read_toml
from chemlab.config.loading import load_scenario
from chemlab.config.materials import Material, RealProperties, VaporPressure, load_materials, shipped_materials
from chemlab.config.reactions import load_reactions

ROOM_K = 298.15


def real(material: Material) -> RealProperties:
    assert material.real is not None
    return material.real


def curve(name: str) -> VaporPressure:
    found = real(MATERIALS[name]).vapor_pressure
    assert found is not None
    return found


MATERIALS = shipped_materials()
KNOWN = {name: material for name, material in MATERIALS.items() if material.real is not None}
VOLATILE = sorted(name for name, material in KNOWN.items() if real(material).vapor_pressure)
FICTITIOUS = set(read_toml(Path(__file__).parents[1] / "chemlab" / "data" / "materials" / "fictitious.toml"))


def chemicals() -> Any:
    return pytest.importorskip("chemicals", reason='chemicals is not installed: pip install ".[test]"')


def thermo() -> Any:
    return pytest.importorskip("thermo", reason='thermo is not installed: pip install ".[test]"')


# Names of thermo's methods; none is the value's own source.
REFERENCES: dict[str, tuple[str, float, str]] = {
    "salicylic_acid": ("LANDOLT", 0.06, "a solid; the compilations disagree on its melt"),
    "benzoic_acid": ("ANTOINE_WEBBOOK", 0.04, "a solid; the compilations disagree on its boiling point by 1.4 K"),
    "2-chlorohexane": ("AMBROSE_WALTON", 0.06, "estimates both"),
    "3-chlorohexane": ("AMBROSE_WALTON", 0.06, "estimates both"),
}
for _method, _names in {
    "HEOS_FIT": ("water", "hexane", "dodecane", "ethanol", "toluene"),
    "VDI_PPDS": ("ethyl_acetate", "acetic_anhydride", "naphthalene"),
    "ANTOINE_WEBBOOK": ("1-chlorohexane", "acetanilide"),
    "WAGNER_POLING": ("diethyl_ether", "acetic_acid"),
    "LANDOLT": ("1-hexene", "pyrrolidine"),
    "AMBROSE_WALTON": ("trans-2-hexene",),
}.items():
    REFERENCES |= dict.fromkeys(_names, (_method, 0.03, ""))
ESTIMATED = {"4-ethyldecane", "5,6-dimethyldecane", "4-ethyl-5-methylnonane", "4,5-diethyloctane"}
ESTIMATED |= {"2,4-difluoronitrobenzene", "ortho_pyrrolidinyl", "para_pyrrolidinyl", "bis_pyrrolidinyl"}


def reference(material: Material, method: str) -> Any:
    package, library = chemicals(), thermo()
    cas = material.cas
    constants = {key: getattr(package, key)(cas) for key in ("Tc", "Pc", "omega")}
    found = library.VaporPressure(CASRN=cas, Tb=material.boiling_point_k, **constants)
    assert method in found.all_methods, f"{method} does not know {material.name}"
    return found


def test_every_vapor_pressure_is_compared() -> None:
    """And every material but the fictitious ones is known to the tier."""
    assert set(MATERIALS) - set(KNOWN) == FICTITIOUS
    assert {name for name, m in KNOWN.items() if m.role == "solvent"} <= set(VOLATILE)
    assert set(VOLATILE) == {*REFERENCES, *ESTIMATED, "5-methylundecane"}
    for name in ESTIMATED:
        assert real(MATERIALS[name]).source["vapor_pressure"].startswith("estimate: ")


@pytest.mark.parametrize("name", list(REFERENCES))
def test_vapor_pressures_are_those_of_another_source(name: str) -> None:
    method, tolerance, reason = REFERENCES[name]
    material = MATERIALS[name]
    own = re.search(r"\[([A-Z0-9_]+)\]$", real(material).source["vapor_pressure"])
    assert own is None or own.group(1) != method
    assert tolerance <= 0.03 or reason
    other = reference(material, method)
    low, high = other.T_limits[method]
    solid = material.melting_point_k is not None and material.melting_point_k > 300.0
    if solid:  # of the melt, from a little above the melting point: below it methods are carried on at will
        low = max(low, float(material.melting_point_k or 0.0) + 15.0)
    temperatures = np.linspace(max(250.0, low), min(material.boiling_point_k, high), 25)
    assert temperatures[0] < temperatures[-1]
    expected = [other.calculate(float(t), method) for t in temperatures]
    np.testing.assert_allclose(curve(name).pascal(temperatures), expected, rtol=tolerance)


def test_beyond_its_range_a_vapor_pressure_is_a_straight_line() -> None:
    # By Clausius and Clapeyron, with the heat of vaporization it has at that end.
    made = VaporPressure(form="antoine", coefficients=(10.0, 1500.0, -40.0), low_k=300.0, high_k=400.0)
    slope = -math.log(10.0) * 1500.0 * (350.0 / (350.0 - 40.0)) ** 2
    inside = made.pascal(np.array([349.999, 350.001]))
    assert np.diff(np.log(inside))[0] / np.diff(1.0 / np.array([349.999, 350.001]))[0] == pytest.approx(slope, rel=1e-4)
    for edge, beyond in ((400.0, (450.0, 520.0)), (300.0, (250.0, 280.0))):
        at = np.log(made.pascal(edge))
        rates = [(float(np.log(made.pascal(t))) - float(at)) / (1.0 / t - 1.0 / edge) for t in beyond]
        assert rates[0] == pytest.approx(rates[1], rel=1e-9)
        expected = -math.log(10.0) * 1500.0 * (edge / (edge - 40.0)) ** 2
        assert rates[0] == pytest.approx(expected, rel=1e-3)


# Acids pair up in their vapour, which then takes twice the moles for the same heat.
DIMERS = {"acetic_acid", "benzoic_acid", "salicylic_acid"}


@pytest.mark.parametrize("name", VOLATILE)
def test_boiling_points_and_heats_of_vaporization_follow_from_the_vapor_pressures(name: str) -> None:
    """One atmosphere, and Clausius and Clapeyron, from which the vapour departs by 3 to 6 %."""
    boiling = MATERIALS[name].boiling_point_k
    cold, at, warm = np.log(curve(name).pascal(np.array([boiling - 1.0, boiling, boiling + 1.0])))
    assert math.exp(at) == pytest.approx(101325.0, rel=0.025)
    slope = 8.314462618 * boiling**2 * float(warm - cold) / 2.0
    assert name in DIMERS or 0.84 < MATERIALS[name].vaporization_enthalpy_j_mol / slope < 1.02


@pytest.mark.parametrize("name", [name for name in KNOWN if KNOWN[name].role == "ion"])
def test_ions_have_the_formation_enthalpy_of_the_handbook(name: str) -> None:
    source = real(MATERIALS[name]).source["formation_enthalpy_j_mol"]
    if not source.endswith("[CRC_AQUEOUS]"):
        assert source.startswith(("estimate: ", "guess: "))
        return
    folder = Path(chemicals().__file__).parent / "Electrolytes"
    rows = (folder / "CRC Thermodynamic Properties of Aqueous Ions.tsv").read_text(encoding="utf-8").splitlines()
    column = rows[0].split("\t").index("Hf(aq)")
    value = next(row.split("\t")[column] for row in rows if row.startswith(f"{MATERIALS[name].cas}\t"))
    assert real(MATERIALS[name]).formation_enthalpy_j_mol == float(value)


def heat(change: dict[str, float]) -> float:
    """kJ of a change in moles, from formation enthalpies."""
    return sum(number * real(MATERIALS[name]).formation_enthalpy_j_mol for name, number in change.items()) / 1000.0


@pytest.mark.parametrize(
    ("change", "expected", "tolerance"),
    [
        # Neutralization at infinite dilution.
        ({"H+": -1, "OH-": -1, "water": 1}, -55.8, 0.3),
        # Dissolving: CRC Handbook, enthalpy of solution of electrolytes.
        ({"NaCl": -1, "Na+": 1, "Cl-": 1}, 3.88, 0.3),
        ({"NaOH": -1, "Na+": 1, "OH-": 1}, -44.5, 0.5),
        ({"sodium_acetate": -1, "Na+": 1, "acetate": 1}, -17.3, 0.5),
        ({"sodium_bicarbonate": -1, "Na+": 1, "HCO3-": 1}, 18.7, 0.5),
        ({"Na": -2, "water": -2, "Na+": 2, "OH-": 2, "H2": 1}, -368.6, 1.0),
        # 0.45 mol of dodecane give 314 kJ.
        ({"1-chlorohexane": -2, "Na": -2, "dodecane": 1, "NaCl": 2}, -698.0, 7.0),
        # Esterification is nearly athermal; hydrolysis of the anhydride: -58.5 kJ/mol (Conn et al. 1942).
        ({"acetic_acid": -1, "ethanol": -1, "ethyl_acetate": 1, "water": 1}, -3.2, 2.0),
        ({"acetic_anhydride": -1, "water": -1, "acetic_acid": 2}, -58.5, 1.5),
    ],
)
def test_heats_of_reaction(change: dict[str, float], expected: float, tolerance: float) -> None:
    assert heat(change) == pytest.approx(expected, abs=tolerance)


PARENTS = {
    "Cl-": ("NaCl", "Na+"),
    "acetate": ("sodium_acetate", "Na+"),
    "benzoate": ("sodium_benzoate", "Na+"),
    "ethoxide": ("sodium_ethoxide", "Na+"),
    "HCO3-": ("sodium_bicarbonate", "Na+"),
    "salicylate": ("salicylic_acid", "H+"),
    "acetylsalicylate": ("acetylsalicylic_acid", "H+"),
    "OH-": ("water", "H+"),
}


@pytest.mark.parametrize("ion", list(PARENTS))
def test_making_ions_keeps_volume_heat_capacity_and_mass(ion: str) -> None:
    parent, other = PARENTS[ion]
    whole, parts = MATERIALS[parent], [MATERIALS[ion], MATERIALS[other]]
    assert sum(m.molar_mass_g_mol for m in parts) == pytest.approx(whole.molar_mass_g_mol, rel=1e-6)
    volume = whole.molar_mass_g_mol / whole.density_kg_l
    assert sum(m.molar_mass_g_mol / m.density_kg_l for m in parts) == pytest.approx(volume, rel=1e-6)
    assert sum(m.heat_capacity_j_mol_k for m in parts) == pytest.approx(whole.heat_capacity_j_mol_k, rel=1e-6)


REAL = """
[goo.real]
vapor_pressure = { form = "antoine", coefficients = [9.88, 1950.0, 0.0], low_k = 260.0, high_k = 450.0 }
critical_temperature_k = 600.0
formation_enthalpy_j_mol = -100000.0
formation_state = "l"
fusion_enthalpy_j_mol = 12000.0

[goo.real.source]
vapor_pressure = "made up"
critical_temperature_k = "made up"
formation_enthalpy_j_mol = "made up"
fusion_enthalpy_j_mol = "made up"
"""


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("9.88, 1950.0, 0.0", "9.88, 1950.0", ["real.vapor_pressure.coefficients", "at least 3"]),
        ("9.88, 1950.0, 0.0", "9.88, 1950.0, 0.0, 1.0", ["real.vapor_pressure", "antoine has 3, given 4"]),
        ("9.88, 1950.0, 0.0", "9.88, -1950.0, 0.0", ["real.vapor_pressure", "must rise with temperature"]),
        ("9.88, 1950.0, 0.0", "9.88, 1950.0, -300.0", ["real.vapor_pressure", "pole"]),
        ("9.88, 1950.0, 0.0", "7.88, 1950.0, 0.0", ["real.vapor_pressure", "kPa at boiling_point_k = 400.0"]),
        ("low_k = 260.0", "low_k = 460.0", ["high_k = 450.0 must exceed low_k = 460.0"]),
        ('form = "antoine"', 'form = "wagner"', ["form", "'dippr101' or 'antoine'"]),
        ("critical_temperature_k = 600.0\n", "", ["critical_temperature_k is required"]),
        ("critical_temperature_k = 600.0", "critical_temperature_k = 390.0", ["must be above boiling_point_k = 400.0"]),
        ('formation_state = "l"', 'formation_state = "aq"', ["formation_state = 'aq'", "role 'solute'"]),
        ("formation_enthalpy_j_mol = -100000.0\n", "", ["formation_enthalpy_j_mol", "required"]),
        ('fusion_enthalpy_j_mol = "made up"\n', "", ["source must cite fusion_enthalpy_j_mol"]),
        ("fusion_enthalpy_j_mol = 12000.0", "fusion_enthalpy_j_mol = -1.0", ["fusion_enthalpy_j_mol", "greater than"]),
        ('formation_state = "l"', 'formation_state = "l"\npka = 4.2', ["real.pka", "unknown key"]),
    ],
)
def test_wrong_properties_are_named(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    file = written(tmp_path, GOO + REAL)
    assert real(load_materials([file])["goo"]).critical_temperature_k == 600.0
    file.write_text(GOO + changed(REAL, old, new))
    refused(lambda: load_materials([file]), f"{file}: goo", *parts)


def test_the_paper_refuses_a_material_without_polarity(tmp_path: Path) -> None:
    text = GOO.replace("polarity = 0.2\n", "").replace('polarity = "made up too"\n', "")
    file = written(tmp_path, text)
    assert load_materials([file])["goo"].polarity is None
    values = load_scenario("wurtz_dodecane").model_dump(mode="json", exclude_none=True)
    values |= {"material_files": [str(file)], "stock": {**values["stock"], "goo": 1.0}}
    with pytest.raises(DataError, match=r"'goo' has no polarity, which physics = 'paper' needs"):
        load_scenario(values)


def test_salt_dissolves_as_the_handbooks_say_alike_in_all_families() -> None:
    found: dict[str, list[Any]] = {"NaCl": [], "NaOH": []}
    for family in ("sodium_salts", "salt_water", "wurtz"):
        for salt in load_reactions(family, MATERIALS).salt:
            found.get(salt.solid, []).append(salt.solubility)
    assert all(len(same) >= 2 and same == [same[0]] * len(same) for same in found.values())
    (salt, *_), (base, *_) = found.values()
    # 6.1 mol of table salt in a litre of water (35.96 g in 100 g, IUPAC solubility data series 47), nothing in ether.
    assert salt.mol_per_kg("water", ROOM_K) == pytest.approx(359.6 / 58.44, rel=0.01)
    assert salt.mol_per_kg("water", ROOM_K) * 0.997 == pytest.approx(6.1, rel=0.02)
    assert salt.mol_per_kg("diethyl_ether", ROOM_K) == 0.0
    assert salt.mol_per_kg("water", 373.15) / salt.mol_per_kg("water", 273.15) == pytest.approx(1.094, abs=0.01)
    assert salt.mol_per_kg("water", 450.0) == salt.mol_per_kg("water", 373.15)
    assert base.mol_per_kg("water", 293.15) == pytest.approx(1090.0 / 40.0, rel=0.3)


SALT = """
name = "brine"

[[salt]]
solid = "NaCl"
cation = "Na+"
anion = "Cl-"
source = "made up"

[salt.solubility]
source = "made up"

[salt.solubility.solvents]
water = [[280.0, 6.0], [300.0, 7.0]]
"""


def test_solubilities_are_straight_lines_between_points(tmp_path: Path) -> None:
    (salt,) = load_reactions(str(written(tmp_path, SALT)), MATERIALS).salt
    assert salt.solubility is not None
    np.testing.assert_allclose(salt.solubility.mol_per_kg("water", np.array([250.0, 285.0, 310.0])), [6.0, 6.25, 7.0])
    np.testing.assert_array_equal(salt.solubility.mol_per_kg("hexane", np.array([250.0, 285.0])), [0.0, 0.0])


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("[300.0, 7.0]", "[270.0, 7.0]", "solvents.water: temperatures must rise, given [280.0, 270.0]"),
        ("[300.0, 7.0]", "[300.0, -7.0]", "solvents.water.1.1"),
        ("[[280.0, 6.0], [300.0, 7.0]]", "[]", "solvents.water"),
        ('[salt.solubility]\nsource = "made up"', "[salt.solubility]", "salt.0.solubility.source"),
    ],
)
def test_wrong_solubilities_are_named(tmp_path: Path, old: str, new: str, part: str) -> None:
    file = written(tmp_path, changed(SALT, old, new))
    refused(lambda: load_reactions(str(file), MATERIALS), file, part)
