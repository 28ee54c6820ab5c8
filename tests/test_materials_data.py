"""Material data files against the compilation that each value cites, and checked for consistency."""

import functools
import inspect
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
ROOM_K = 298.15

MASS, DENSITY, HEAT = "molar_mass_g_mol", "density_kg_l", "heat_capacity_j_mol_k"
MELT, BOIL, VAPOR = "melting_point_k", "boiling_point_k", "vaporization_enthalpy_j_mol"
PROPERTIES = (MASS, DENSITY, HEAT, MELT, BOIL, VAPOR)
CRITICAL, FUSION, FORMATION = "critical_temperature_k", "fusion_enthalpy_j_mol", "formation_enthalpy_j_mol"
REAL_PROPERTIES = (CRITICAL, FUSION, FORMATION)


def _load(files: tuple[str, ...]) -> list[tuple[str, str, Material]]:
    """Return (file, id, material) of every table of the files."""
    rows = []
    for file in files:
        with open(DATA / f"{file}.toml", "rb") as stream:
            rows += [(file, key, material) for key, material in tomllib.load(stream).items()]
    return rows


ROWS = _load(("solvents", "wurtz", "salts", "gases", "fictitious"))
MATERIALS: dict[str, Material] = {key: material for _, key, material in ROWS}
NEW: dict[str, Material] = {key: material for _, key, material in _load(("organics", "acids", "snar", "minerals"))}
ALL = MATERIALS | NEW
REAL = [key for file, key, _ in ROWS if file != "fictitious"]
FICTITIOUS = [key for file, key, _ in ROWS if file == "fictitious"]
CHLOROHEXANES = ["1-chlorohexane", "2-chlorohexane", "3-chlorohexane"]
PRODUCTS = ["dodecane", "5-methylundecane", "4-ethyldecane", "5,6-dimethyldecane"]
PRODUCTS += ["4-ethyl-5-methylnonane", "4,5-diethyloctane"]
GASES = {"air", "H2"}
SOLVENTS = ["diethyl_ether", "ethyl_acetate", "hexane", "water"]


chemicals = pytest.importorskip("chemicals")
thermo = pytest.importorskip("thermo")


@functools.cache
def _correlation(kind: str, cas: str, boiling: float | None) -> Any:
    """thermo's object for a temperature-dependent property, with the constants its methods need."""
    wanted = {"MW": chemicals.MW(cas), "Tb": boiling or chemicals.Tb(cas)}
    wanted |= {name: getattr(chemicals, name)(cas) for name in ("Tc", "Pc", "Vc", "omega")}
    known = inspect.signature(getattr(thermo, kind).__init__).parameters
    keywords = {name: value for name, value in wanted.items() if name in known and value is not None}
    return getattr(thermo, kind)(CASRN=cas, **keywords)


def _at(kind: str, cas: str, temperature: float, key: str, boiling: float | None = None) -> float:
    """A temperature-dependent property by the named method, refusing methods without data."""
    correlation = _correlation(kind, cas, boiling)
    assert key in correlation.all_methods, f"{kind} of {cas} has no {key}"
    value = float(correlation.calculate(temperature, key))
    assert math.isfinite(value)
    return value


def database(material: Material, field: str, key: str) -> float:
    """What the compilation or method `key` of the packages says about one property."""
    cas, phase = material["cas"], {"solid": "Solid", "gas": "Gas"}.get(material["role"], "Liquid")
    if field == HEAT:
        return _at(f"HeatCapacity{'Solid' if material.get(MELT, 0.0) > 300.0 else phase}", cas, ROOM_K, key)
    if field == DENSITY:
        return float(chemicals.MW(cas)) / 1e6 / _at(f"Volume{phase}", cas, ROOM_K, key)
    if field == VAPOR:
        # The boiling point is an input of the estimation methods, so theirs must be that of the file.
        return _at("EnthalpyVaporization", cas, material[BOIL], key, boiling=material[BOIL])
    lists = {CRITICAL: "Tc", FUSION: "Hfus", MELT: "Tm", BOIL: "Tb"}
    listed = f"Hf{material['real']['formation_state']}" if field == FORMATION else lists[field]
    value = getattr(chemicals, listed)(cas, method=key)
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


def test_uncited_values_say_what_they_are() -> None:
    # A number that no compilation key backs must name a work, or admit being an estimate or a design value.
    for key, field in itertools.product(REAL, (*PROPERTIES, "polarity")):
        text = MATERIALS[key]["source"][field]
        named_work = re.search(r"\(\d{4}\)|CRC Handbook|IAPWS", text)
        admitted = text.startswith(("estimate: ", "design value", "unused by the model"))
        derived = "atomic weights" in text or text.startswith("ideal gas law")
        assert cited_key(MATERIALS[key], field) or named_work or admitted or derived, f"{key} {field}: {text}"


@pytest.mark.parametrize("key", [key for key in ALL if key not in FICTITIOUS])
def test_formula_and_molar_mass_match_the_composition(key: str) -> None:
    table, material = chemicals.periodic_table, ALL[key]
    expected = sum(table[element].MW * count for element, count in material["composition"].items())
    assert material[MASS] == pytest.approx(expected, rel=1e-6)
    if key in REAL and key != "air":
        match = re.fullmatch(r"((?:[A-Z][a-z]?\d*)+)([+-]?)", material["formula"])
        assert match, material["formula"]
        counts: Counter[str] = Counter()
        for element, count in re.findall(r"([A-Z][a-z]?)(\d*)", match[1]):
            counts[element] += int(count or 1)
        charge = {"": 0, "+": 1, "-": -1}[match[2]]
        assert (dict(counts), charge) == (material["composition"], material.get("charge", 0))


@pytest.mark.parametrize("key", [key for key in (*REAL, *NEW) if key != "air"])
def test_cas_number_belongs_to_the_substance(key: str) -> None:
    material = ALL[key]
    if material.get("cas") is None:
        assert key == "acetylsalicylate" or "pyrrolidin" in key
        return
    found = chemicals.search_chemical(material["cas"])
    if found.charge != material.get("charge", 0):
        assert key == "salicylate"  # the package files it with its acid
        return
    assert material[MASS] == pytest.approx(found.MW, rel=1e-3)
    if key in REAL:
        assert found.smiles == material["smiles"]
        by_name = chemicals.search_chemical(material["name"].removesuffix(" metal"))
        assert by_name.CASs == material["cas"]


# Measured E_T(30) in kcal/mol; tetramethylsilane (30.7) and water (63.1) define the ends of the scale.
E_T_30 = {"diethyl_ether": 34.5, "water": 63.1, "hexane": 31.0, "ethyl_acetate": 38.1, "dodecane": 31.1}


def test_polarity_is_the_normalized_reichardt_scale() -> None:
    found = {key: MATERIALS[key]["polarity"] for key in E_T_30}
    assert found == pytest.approx({key: (value - 30.7) / (63.1 - 30.7) for key, value in E_T_30.items()}, abs=6e-4)


def test_shades_and_colors_are_distinct() -> None:
    def rgb(key: str) -> np.ndarray:
        return np.array([int(ALL[key]["color"][i : i + 2], 16) for i in (1, 3, 5)], dtype=float)

    for one, other in itertools.combinations(MATERIALS, 2):
        if not {one, other} <= GASES:
            assert abs(MATERIALS[one]["shade"] - MATERIALS[other]["shade"]) >= 0.02, (one, other)
    fictitious = [*FICTITIOUS, *SOLVENTS, "air"]
    for group, apart in ((REAL, 20.0), (fictitious, 20.0), ([*REAL, *NEW], 10.0)):
        for one, other in itertools.combinations(group, 2):
            assert np.linalg.norm(rgb(one) - rgb(other)) >= apart, (one, other)


WAVELENGTHS = np.linspace(200.0, 800.0, 200)
PYRROLIDINYLS = ["ortho_pyrrolidinyl", "para_pyrrolidinyl", "bis_pyrrolidinyl"]
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
    "substitution": ["2,4-difluoronitrobenzene", "pyrrolidine", "ethanol", *PYRROLIDINYLS],
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
