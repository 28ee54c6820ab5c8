"""Material data files: compared with the chemicals and thermo packages, and checked for consistency.

Expected values come from the packages when the test runs: each value must be the one its cited compilation lists.
``test_openchem.py`` compares it with the other compilations.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

Material = dict[str, Any]

DATA = Path(__file__).resolve().parents[1] / "chemlab" / "data" / "materials"
FILES = ("solvents", "wurtz", "salts", "gases", "fictitious")
NEW_FILES = ("organics", "acids", "snar", "minerals")
ROOM_K = 298.15

MASS, DENSITY, HEAT = "molar_mass_g_mol", "density_kg_l", "heat_capacity_j_mol_k"
MELT, BOIL, VAPOR = "melting_point_k", "boiling_point_k", "vaporization_enthalpy_j_mol"
PROPERTIES = (MASS, DENSITY, HEAT, MELT, BOIL, VAPOR)
NUMERIC = (*PROPERTIES, "polarity")
CRITICAL, FUSION, FORMATION = REAL_PROPERTIES = (
    "critical_temperature_k", "fusion_enthalpy_j_mol", "formation_enthalpy_j_mol"
)  # fmt: skip


def _load(files: tuple[str, ...]) -> list[tuple[str, str, Material]]:
    """Return (file, id, material) of every table of the files."""
    rows = []
    for file in files:
        with open(DATA / f"{file}.toml", "rb") as stream:
            rows += [(file, key, material) for key, material in tomllib.load(stream).items()]
    return rows


ROWS = _load(FILES)
MATERIALS: dict[str, Material] = {key: material for _, key, material in ROWS}
NEW: dict[str, Material] = {key: material for _, key, material in _load(NEW_FILES)}
ALL = MATERIALS | NEW
REAL = [key for file, key, _ in ROWS if file != "fictitious"]
FICTITIOUS = [key for file, key, _ in ROWS if file == "fictitious"]
CHLOROHEXANES = ["1-chlorohexane", "2-chlorohexane", "3-chlorohexane"]
PRODUCTS = [
    "dodecane",
    "5-methylundecane",
    "4-ethyldecane",
    "5,6-dimethyldecane",
    "4-ethyl-5-methylnonane",
    "4,5-diethyloctane",
]
GASES = {"air", "H2"}
SOLVENTS = ["diethyl_ether", "ethyl_acetate", "hexane", "water"]


# -- Looking values up in the packages -------------------------------------------------------------------------------


def _chemicals() -> Any:
    return pytest.importorskip("chemicals")


def _thermo() -> Any:
    return pytest.importorskip("thermo")


@functools.cache
def _correlation(kind: str, cas: str, boiling: float | None = None) -> Any:
    """Return thermo's object for a temperature-dependent property, with the constants its methods need."""
    chemicals, thermo = _chemicals(), _thermo()
    constants = {
        "MW": chemicals.MW(cas),
        "Tb": boiling or chemicals.Tb(cas),
        "Tc": chemicals.Tc(cas),
        "Pc": chemicals.Pc(cas),
        "Vc": chemicals.Vc(cas),
        "omega": chemicals.omega(cas),
    }
    wanted = {
        "HeatCapacityGas": ("MW",),
        "HeatCapacityLiquid": ("MW",),
        "HeatCapacitySolid": ("MW",),
        "VolumeGas": ("MW", "Tc", "Pc", "omega"),
        "VolumeLiquid": ("MW", "Tb", "Tc", "Pc", "Vc", "omega"),
        "VolumeSolid": ("MW", "Tb"),
        "EnthalpyVaporization": ("Tb", "Tc", "Pc", "omega"),
        "VaporPressure": ("Tb", "Tc", "Pc", "omega"),
    }[kind]
    keywords = {name: constants[name] for name in wanted if constants[name] is not None}
    return getattr(thermo, kind)(CASRN=cas, **keywords)


def _at(kind: str, cas: str, temperature: float, key: str, boiling: float | None = None) -> float:
    """Return a temperature-dependent property by the named method, refusing methods without data."""
    correlation = _correlation(kind, cas, boiling)
    assert key in correlation.all_methods, f"{kind} of {cas} has no {key}"
    value = correlation.calculate(temperature, key)
    assert isinstance(value, float)
    assert math.isfinite(value)
    return value


def _molar_mass(cas: str) -> float:
    return float(_chemicals().MW(cas))


def _litres(cas: str, key: str, phase: str = "Liquid") -> float:
    """Return the molar volume in litres at room temperature."""
    return _at(f"Volume{phase}", cas, ROOM_K, key) * 1000.0


def database(material: Material, field: str, key: str) -> float:
    """Return what the compilation or method `key` of the packages says about one property."""
    cas, phase = material["cas"], {"solid": "Solid", "gas": "Gas"}.get(material["role"], "Liquid")
    if field == HEAT and material.get(MELT, 0.0) > 300.0:
        phase = "Solid"
    if field == CRITICAL:
        value = _chemicals().Tc(cas, method=key)
    elif field == FUSION:
        value = _chemicals().Hfus(cas, method=key)
    elif field == FORMATION:
        value = getattr(_chemicals(), f"Hf{material['real']['formation_state']}")(cas, method=key)
    elif field == MELT:
        value = _chemicals().Tm(cas, method=key)
    elif field == BOIL:
        value = _chemicals().Tb(cas, method=key)
    elif field == HEAT:
        value = _at(f"HeatCapacity{phase}", cas, ROOM_K, key)
    elif field == DENSITY:
        value = _molar_mass(cas) / 1000.0 / _litres(cas, key, phase)
    elif field == VAPOR:
        # The boiling point is an input of the estimation methods, so theirs must be that of the file.
        value = _at("EnthalpyVaporization", cas, material[BOIL], key, boiling=material[BOIL])
    else:
        raise AssertionError(f"no lookup for {field}")
    assert value is not None, f"{key} does not list {field} of {cas}"
    return float(value)


def cited_key(material: Material, field: str) -> str | None:
    """Return the compilation key in brackets at the end of a source string."""
    cited = material["source"] | material.get("real", {}).get("source", {})
    match = re.search(r"\[([A-Z0-9_]+)\]$", cited.get(field, ""))
    return match.group(1) if match else None


CITED = [
    (key, field, cited)
    for key, material in ALL.items()
    for field in (*PROPERTIES, *REAL_PROPERTIES)
    if (cited := cited_key(material, field)) not in (None, "CRC_AQUEOUS")
]


def test_values_are_those_their_sources_list() -> None:
    # Only rounding to the digits of the file is allowed.
    for key, field, cited in CITED:
        value = (ALL[key]["real"] if field in REAL_PROPERTIES else ALL[key])[field]
        expected = pytest.approx(database(ALL[key], field, cited), rel=0.0 if key == "silica" else 3e-4)
        assert value == expected, (key, field, cited)


# -- Form of the files -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", REAL)
def test_uncited_values_say_what_they_are(key: str) -> None:
    # A number that no compilation key backs must name a work, or admit being an estimate or a design value.
    for field in NUMERIC:
        text = MATERIALS[key]["source"][field]
        named_work = re.search(r"\(\d{4}\)|CRC Handbook|IAPWS", text)
        admitted = text.startswith(("estimate: ", "design value", "unused by the model"))
        derived = "atomic weights" in text or text.startswith("ideal gas law")
        assert cited_key(MATERIALS[key], field) or named_work or admitted or derived, f"{field}: {text}"


# -- Composition and molar mass --------------------------------------------------------------------------------------


def parse_formula(formula: str) -> tuple[dict[str, int], int]:
    """Return element counts and charge of a formula such as C12H26 or OH-."""
    match = re.fullmatch(r"((?:[A-Z][a-z]?\d*)+)([+-]?)", formula)
    assert match, formula
    counts: Counter[str] = Counter()
    for element, number in re.findall(r"([A-Z][a-z]?)(\d*)", match.group(1)):
        counts[element] += int(number or 1)
    return dict(counts), {"": 0, "+": 1, "-": -1}[match.group(2)]


@pytest.mark.parametrize("key", [key for key in REAL if key != "air"])
def test_composition_matches_formula(key: str) -> None:
    material = MATERIALS[key]
    assert parse_formula(material["formula"]) == (material["composition"], material.get("charge", 0))


@pytest.mark.parametrize("key", [key for key in ALL if key not in FICTITIOUS])
def test_molar_mass_matches_composition(key: str) -> None:
    table = _chemicals().periodic_table
    expected = sum(table[element].MW * count for element, count in ALL[key]["composition"].items())
    assert ALL[key][MASS] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("key", [key for key in (*REAL, *NEW) if key != "air"])
def test_cas_number_belongs_to_the_substance(key: str) -> None:
    material = ALL[key]
    if material.get("cas") is None:
        assert key == "acetylsalicylate" or "pyrrolidin" in key
        return
    found = _chemicals().search_chemical(material["cas"])
    if found.charge != material.get("charge", 0):
        assert key == "salicylate"  # the package files it with its acid
        return
    assert material[MASS] == pytest.approx(found.MW, rel=1e-3)
    if key in REAL:
        assert found.smiles == material["smiles"]
        by_name = _chemicals().search_chemical(material["name"].removesuffix(" metal"))
        assert by_name.CASs == material["cas"]


# -- Ions, polarity, appearance --------------------------------------------------------------------------------------


# Measured E_T(30) in kcal/mol; tetramethylsilane (30.7) and water (63.1) define the ends of the scale.
E_T_30 = {"diethyl_ether": 34.5, "water": 63.1, "hexane": 31.0, "ethyl_acetate": 38.1, "dodecane": 31.1}


@pytest.mark.parametrize("key", list(E_T_30))
def test_polarity_is_the_normalized_reichardt_scale(key: str) -> None:
    assert MATERIALS[key]["polarity"] == pytest.approx((E_T_30[key] - 30.7) / (63.1 - 30.7), abs=6e-4)


def test_shades_are_distinct() -> None:
    shade = {key: material["shade"] for key, material in MATERIALS.items()}
    for one, other in itertools.combinations(MATERIALS, 2):
        if not {one, other} <= GASES:
            assert abs(shade[one] - shade[other]) >= 0.02, (one, other)


def test_colors_are_distinct() -> None:
    def rgb(key: str) -> np.ndarray:
        return np.array([int(ALL[key]["color"][i : i + 2], 16) for i in (1, 3, 5)], dtype=float)

    fictitious = [*FICTITIOUS, *SOLVENTS, "air"]
    for group, apart in ((REAL, 20.0), (fictitious, 20.0), ([*REAL, *NEW], 10.0)):
        for one, other in itertools.combinations(group, 2):
            assert np.linalg.norm(rgb(one) - rgb(other)) >= apart, (one, other)


# -- Spectra ---------------------------------------------------------------------------------------------------------

WAVELENGTHS = np.linspace(200.0, 800.0, 200)
WURTZ_BASIS = [*CHLOROHEXANES, "Na", *PRODUCTS, "NaCl", "Na+", "Cl-", "diethyl_ether"]
BASES = {
    "wurtz": WURTZ_BASIS,
    "fictitious": [*FICTITIOUS, "diethyl_ether"],
    # Extraction adds the other solvents and quenching with water the hydroxide.
    "all-real": [key for key in REAL if key not in GASES],
    "fictitious-all-solvents": [*FICTITIOUS, *SOLVENTS],
    "esterification": ["acetic_acid", "ethanol", "ethyl_acetate", "water", "toluene"],
    "aspirin": ["salicylic_acid", "acetic_anhydride", "acetylsalicylic_acid", "acetic_acid", "water", "ethanol"],
    "acid-base": ["benzoic_acid", "naphthalene", "benzoate", "Na+", "OH-", "H+", "Cl-", "water", "diethyl_ether"],
    "recrystallization": ["acetanilide", "benzoic_acid", "naphthalene", "ethanol", "water", "hexane"],
    "substitution": [
        "2,4-difluoronitrobenzene",
        "pyrrolidine",
        "ethanol",
        "ortho_pyrrolidinyl",
        "para_pyrrolidinyl",
        "bis_pyrrolidinyl",
    ],
    "wurtz with olefins": ["1-chlorohexane", "dodecane", "hexane", "1-hexene", "trans-2-hexene", "NaCl", "Na"],
}


def basis(keys: list[str]) -> np.ndarray:
    """Return the absorbance per mol/L of each material as a column."""
    columns = []
    for key in keys:
        column = np.zeros_like(WAVELENGTHS)
        assert ALL[key]["absorption"]
        for band in ALL[key]["absorption"]:
            offset = (WAVELENGTHS - band["center_nm"]) / band["width_nm"]
            column += band["height_l_mol"] * np.exp(-(offset**2) / 2.0)
        columns.append(column)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("name", list(BASES))
def test_spectra_are_well_conditioned(name: str) -> None:
    matrix = basis(BASES[name])
    assert np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0)) < 200.0
