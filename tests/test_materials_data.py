"""Material data files: compared with the chemicals and thermo packages, and checked for consistency.

Expected values come from the packages when the test runs. Two kinds of comparison are made: the value must be
the one its cited compilation lists (transcription), and it must agree with a second, independent source.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
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
ROOM_K = 298.15
ATMOSPHERE_PA = 101325.0
GAS_CONSTANT = 8.314462618

MASS, DENSITY, HEAT = "molar_mass_g_mol", "density_kg_l", "heat_capacity_j_mol_k"
MELT, BOIL, VAPOR = "melting_point_k", "boiling_point_k", "vaporization_enthalpy_j_mol"
PROPERTIES = (MASS, DENSITY, HEAT, MELT, BOIL, VAPOR)
NUMERIC = (*PROPERTIES, "polarity")
REQUIRED = {"name", "formula", "composition", "role", "color", "shade", "absorption", "source", *NUMERIC}
OPTIONAL = {"charge", "cas", "smiles", "real"}


def _load() -> list[tuple[str, str, Material]]:
    """Return (file, id, material) of every table of every file."""
    rows = []
    for file in FILES:
        with open(DATA / f"{file}.toml", "rb") as stream:
            rows += [(file, key, material) for key, material in tomllib.load(stream).items()]
    return rows


ROWS = _load()
MATERIALS: dict[str, Material] = {key: material for _, key, material in ROWS}
REAL = [key for file, key, _ in ROWS if file != "fictitious"]
FICTITIOUS = [key for file, key, _ in ROWS if file == "fictitious"]
IONS = ["Na+", "Cl-", "OH-"]
CHLOROHEXANES = ["1-chlorohexane", "2-chlorohexane", "3-chlorohexane"]
PRODUCTS = [
    "dodecane",
    "5-methylundecane",
    "4-ethyldecane",
    "5,6-dimethyldecane",
    "4-ethyl-5-methylnonane",
    "4,5-diethyloctane",
]
ROLES = {
    "solvent": {"diethyl_ether", "water", "hexane", "ethyl_acetate"},
    "solute": {*CHLOROHEXANES, *PRODUCTS, *"ABCDEFGHIJK"},
    "solid": {"Na", "NaCl", "NaOH"},
    "ion": set(IONS),
    "gas": {"air", "H2"},
}


# ---------------------------------------------------------------------------------------------------------
# Looking values up in the packages
# ---------------------------------------------------------------------------------------------------------


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


def _phase(material: Material) -> str:
    return {"solid": "Solid", "gas": "Gas"}.get(material["role"], "Liquid")


def database(material: Material, field: str, key: str) -> float:
    """Return what the compilation or method `key` of the packages says about one property."""
    cas, phase = material["cas"], _phase(material)
    if field == MELT:
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
    match = re.search(r"\[([A-Z0-9_]+)\]$", material["source"][field])
    return match.group(1) if match else None


# ---------------------------------------------------------------------------------------------------------
# Independent references that are not a plain lookup
# ---------------------------------------------------------------------------------------------------------

# Octanes branched like the branched dodecanes. For the latter the packages list neither heat capacity nor
# enthalpy of vaporization, for the octanes both; the effect of the branches hardly depends on chain length.
OCTANE, DODECANE = "111-65-9", "112-40-3"
HOMOMORPHS = {
    "5-methylundecane": "589-53-7",  # 4-methylheptane
    "4-ethyldecane": "619-99-8",  # 3-ethylhexane
    "5,6-dimethyldecane": "583-48-2",  # 3,4-dimethylhexane
    "4-ethyl-5-methylnonane": "583-48-2",
    "4,5-diethyloctane": "583-48-2",
}
CHLOROBUTANE, CHLOROPENTANE, CHLOROHEXANE = "109-69-3", "543-59-9", "544-10-5"
NITROGEN, OXYGEN, ARGON = "7727-37-9", "7782-44-7", "7440-37-1"
AIR = {NITROGEN: 0.78, OXYGEN: 0.21, ARGON: 0.01}


def _boiling_entropy(cas: str) -> float:
    """Return measured enthalpy of vaporization over boiling point (Trouton's ratio)."""
    boiling = _chemicals().Tb(cas)
    return _at("EnthalpyVaporization", cas, boiling, "CRC_HVAP_TB") / boiling


def homomorph_heat(material: Material) -> float:
    """Heat capacity of dodecane plus the measured effect of the same branches on octane."""
    homomorph = HOMOMORPHS[material["name"]]
    dodecane, branched, octane = (
        _at("HeatCapacityLiquid", cas, ROOM_K, "POLING_CONST") for cas in (DODECANE, homomorph, OCTANE)
    )
    return dodecane + branched - octane


def homomorph_vapor(material: Material) -> float:
    """Trouton's ratio of dodecane times the measured effect of the same branches on octane."""
    branching = _boiling_entropy(HOMOMORPHS[material["name"]]) / _boiling_entropy(OCTANE)
    return material[BOIL] * _boiling_entropy(DODECANE) * branching


def chlorohexane_vapor(material: Material) -> float:
    """Trouton's ratio of 1-chlorohexane, which is measured."""
    return material[BOIL] * _boiling_entropy(CHLOROHEXANE)


def series_heat(material: Material) -> float:
    """Next member of the measured series 1-chlorobutane, 1-chloropentane."""
    butane, pentane = (
        _at("HeatCapacityLiquid", cas, ROOM_K, "ZABRANSKY_SPLINE_C") for cas in (CHLOROBUTANE, CHLOROPENTANE)
    )
    return 2.0 * pentane - butane


def alkane_step_density(material: Material) -> float:
    """Molar volume of 1-chloropentane plus a CH2 measured as hexane less pentane."""
    step = _litres("110-54-3", "HEOS_FIT") - _litres("109-66-0", "HEOS_FIT")
    return _molar_mass(material["cas"]) / 1000.0 / (_litres(CHLOROPENTANE, "VDI_PPDS") + step)


def dadgostar_shaw(material: Material) -> float:
    """Heat capacity from the number of atoms per gram."""
    chemicals = _chemicals()
    mass = _molar_mass(material["cas"])
    similarity = chemicals.similarity_variable(dict(material["composition"]), mass)
    return float(chemicals.Dadgostar_Shaw(ROOM_K, similarity)) * mass / 1000.0


def vapor_pressure_boiling(material: Material) -> float:
    """Boiling point from the vapour pressures of Landolt-Boernstein."""
    temperature = material[BOIL]
    for _ in range(20):  # Clausius-Clapeyron steps: ln p is nearly linear in 1 / T
        pressure = _at("VaporPressure", material["cas"], temperature, "LANDOLT")
        warmer = _at("VaporPressure", material["cas"], temperature + 0.5, "LANDOLT")
        slope = math.log(warmer / pressure) / (1.0 / temperature - 1.0 / (temperature + 0.5))
        temperature = 1.0 / (1.0 / temperature - math.log(ATMOSPHERE_PA / pressure) / slope)
    return temperature


def thermochemical_vapor(material: Material) -> float:
    """Solid at 298 K -> vapour at the boiling point directly, less the way over the melt."""
    chemicals, cas = _chemicals(), material["cas"]
    melting, boiling = chemicals.Tm(cas, method="CRC_INORG"), chemicals.Tb(cas, method="CRC_INORG")

    def heat(phase: str, key: str, start: float, stop: float) -> float:
        grid = np.linspace(start, stop, 200)
        values = [_at(f"HeatCapacity{phase}", cas, float(t), key) for t in grid]
        return float(np.sum(np.diff(grid) * (np.array(values[1:]) + np.array(values[:-1])) / 2.0))

    # An element has no enthalpy of formation, and the WebBook does not list a zero for it.
    formation = 0.0 if len(material["composition"]) == 1 else chemicals.Hfs(cas, method="WEBBOOK")
    sublimation = chemicals.Hfg(cas, method="WEBBOOK") - formation
    melt_path = (
        heat("Solid", "WEBBOOK_SHOMATE", ROOM_K, melting)
        + chemicals.Hfus(cas, method="CRC")
        + heat("Liquid", "WEBBOOK_SHOMATE", melting + 0.5, boiling)
    )
    return float(sublimation + heat("Gas", "JANAF", ROOM_K, boiling) - melt_path)


def clapeyron_vapor(key: str) -> Callable[[Material], float]:
    """Clausius-Clapeyron slope of measured vapour pressures at the boiling point."""

    def reference(material: Material) -> float:
        boiling = material[BOIL]
        cold, hot = (_at("VaporPressure", material["cas"], boiling + step, key) for step in (-1.0, 1.0))
        return GAS_CONSTANT * boiling**2 * math.log(hot / cold) / 2.0

    return reference


def _air_mean(kind: str, temperature: float) -> float:
    return sum(x * _at(kind, cas, temperature, "HEOS_FIT") for cas, x in AIR.items())


def air_mass(_: Material) -> float:
    """Mean of the components' molar masses."""
    return sum(fraction * _molar_mass(cas) for cas, fraction in AIR.items())


def air_heat(_: Material) -> float:
    """Mean of the components' gas heat capacities."""
    return _air_mean("HeatCapacityGas", ROOM_K)


def air_boiling(_: Material) -> float:
    """Bubble point by Raoult's law."""
    low, high = 70.0, 90.0
    for _ in range(50):
        middle = (low + high) / 2.0
        low, high = (middle, high) if _air_mean("VaporPressure", middle) < ATMOSPHERE_PA else (low, middle)
    return low


def air_vapor(material: Material) -> float:
    """Mean of the components' enthalpies of vaporization at the bubble point."""
    return _air_mean("EnthalpyVaporization", material[BOIL])


def ideal_gas_density(material: Material) -> float:
    """Ideal gas at room conditions."""
    return material[MASS] * 1e-6 * ATMOSPHERE_PA / (GAS_CONSTANT * ROOM_K)


def virial_density(material: Material) -> float:
    """Gas density with the second virial coefficient of the CRC handbook."""
    volume = _correlation("VolumeGas", material["cas"]).calculate_P(ROOM_K, ATMOSPHERE_PA, "CRC_VIRIAL")
    return _molar_mass(material["cas"]) * 1e-6 / float(volume)


def package_mass(material: Material) -> float:
    """Molar mass the packages list for the CAS number."""
    return _molar_mass(material["cas"])


# ---------------------------------------------------------------------------------------------------------
# The comparison table
# ---------------------------------------------------------------------------------------------------------

# Two compilations of a measured value agree this well (relative).
MEASURED_TOLERANCE = {MASS: 1e-6, DENSITY: 0.002, HEAT: 0.01, MELT: 0.006, BOIL: 0.002, VAPOR: 0.012}


@dataclass(frozen=True)
class Check:
    """One value against one reference that is not the value's own source."""

    key: str
    field: str
    reference: str | Callable[[Material], float]
    tolerance: float | None = None  # None: MEASURED_TOLERANCE
    reason: str = ""  # why a wider tolerance is right for a value that is no estimate

    @property
    def label(self) -> str:
        reference = self.reference if isinstance(self.reference, str) else self.reference.__name__
        return f"{self.key}-{self.field}-{reference}"


CHECKS = [
    *(Check(key, MASS, package_mass) for key in REAL if key != "air"),
    Check("diethyl_ether", DENSITY, "DIPPR_PERRY_8E"),
    Check("diethyl_ether", HEAT, "HEOS_FIT"),
    Check("diethyl_ether", MELT, "COMMON_CHEMISTRY"),
    Check("diethyl_ether", BOIL, "HEOS"),
    Check("diethyl_ether", VAPOR, "HEOS_FIT"),
    Check("water", DENSITY, "CRC_INORG_L_CONST"),
    Check("water", HEAT, "HEOS_FIT"),
    Check("water", MELT, "COMMON_CHEMISTRY"),
    Check("water", BOIL, "HEOS"),
    Check("water", VAPOR, "HEOS_FIT"),
    Check("hexane", DENSITY, "HEOS_FIT"),
    Check("hexane", HEAT, "ZABRANSKY_SPLINE_C"),
    Check("hexane", MELT, "WEBBOOK"),
    Check("hexane", BOIL, "HEOS"),
    Check("hexane", VAPOR, "HEOS_FIT"),
    Check("ethyl_acetate", DENSITY, "DIPPR_PERRY_8E"),
    Check("ethyl_acetate", HEAT, "ZABRANSKY_QUASIPOLYNOMIAL"),
    Check("ethyl_acetate", MELT, "WEBBOOK"),
    Check("ethyl_acetate", BOIL, "WEBBOOK"),
    Check("ethyl_acetate", VAPOR, "VDI_PPDS"),
    Check("1-chlorohexane", DENSITY, alkane_step_density, 0.01),
    Check("1-chlorohexane", HEAT, series_heat),
    Check("1-chlorohexane", MELT, "WEBBOOK"),
    Check("1-chlorohexane", BOIL, "WEBBOOK"),
    Check("1-chlorohexane", VAPOR, "GHARAGHEIZI_HVAP_298"),
    *(Check(key, DENSITY, "YAMADA_GUNN", 0.02) for key in CHLOROHEXANES[1:]),
    *(Check(key, HEAT, dadgostar_shaw, 0.03) for key in CHLOROHEXANES[1:]),
    *(Check(key, BOIL, "WEBBOOK") for key in CHLOROHEXANES[1:]),
    *(Check(key, VAPOR, chlorohexane_vapor, 0.03) for key in CHLOROHEXANES[1:]),
    Check("Na", DENSITY, "CRC_INORG_S", 0.004, "the handbook rounds to two digits"),
    Check("Na", HEAT, "WEBBOOK_SHOMATE"),
    Check("Na", MELT, "WEBBOOK"),
    Check("Na", BOIL, "WEBBOOK"),
    Check("Na", VAPOR, thermochemical_vapor),
    Check("Na", VAPOR, clapeyron_vapor("ALCOCK_ELEMENTS"), 0.03, "extrapolated from 700 K"),
    Check("dodecane", DENSITY, "HEOS_FIT"),
    Check("dodecane", HEAT, "ZABRANSKY_SPLINE_C"),
    Check("dodecane", MELT, "COMMON_CHEMISTRY"),
    Check("dodecane", BOIL, "HEOS"),
    Check("dodecane", VAPOR, "HEOS_FIT"),
    *(Check(key, DENSITY, "YAMADA_GUNN", 0.04) for key in HOMOMORPHS),
    *(Check(key, HEAT, homomorph_heat, 0.01) for key in HOMOMORPHS),
    *(Check(key, VAPOR, homomorph_vapor, 0.03) for key in HOMOMORPHS),
    *(Check(key, MELT, "JOBACK", 0.05, "a group contribution, the only second source") for key in HOMOMORPHS),
    *(
        Check(key, BOIL, "JOBACK", 0.02, "a group contribution; nothing measured for some isomers")
        for key in HOMOMORPHS
    ),
    *(
        Check(key, BOIL, vapor_pressure_boiling)
        for key in ("5-methylundecane", "4-ethyldecane", "5,6-dimethyldecane", "4,5-diethyloctane")
    ),
    Check("4,5-diethyloctane", BOIL, "WEBBOOK", 0.01, "the compilations disagree, see the data file"),
    Check("NaCl", DENSITY, "CRC_INORG_S", 0.004, "the handbook rounds to three digits"),
    Check("NaCl", HEAT, "WEBBOOK_SHOMATE"),
    Check("NaCl", MELT, "COMMON_CHEMISTRY"),
    Check("NaCl", BOIL, "YAWS"),
    Check("NaCl", BOIL, "COMMON_CHEMISTRY", 0.04, "this compilation keeps the older 1413 degrees C"),
    Check("NaCl", VAPOR, thermochemical_vapor, 0.005),
    Check("NaCl", VAPOR, clapeyron_vapor("ANTOINE_WEBBOOK"), 0.15),
    Check("NaOH", HEAT, "WEBBOOK_SHOMATE"),
    Check("NaOH", MELT, "WIKIDATA", 0.01, "handbooks scatter between 318 and 323 degrees C"),
    Check("NaOH", BOIL, "WIKIDATA"),
    Check("NaOH", VAPOR, thermochemical_vapor, 0.08, "the real vapour is partly dimeric, the reference is not"),
    Check("air", MASS, air_mass),
    Check("air", DENSITY, ideal_gas_density),
    Check("air", HEAT, air_heat),
    Check("air", BOIL, air_boiling, 0.005, "Raoult's law ignores the small non-ideality"),
    Check("air", VAPOR, air_vapor, 0.02),
    Check("H2", DENSITY, virial_density),
    Check("H2", HEAT, "HEOS_FIT"),
    Check("H2", MELT, "COMMON_CHEMISTRY"),
    Check("H2", BOIL, "COMMON_CHEMISTRY"),
    Check("H2", VAPOR, "HEOS_FIT"),
]


@dataclass(frozen=True)
class Bound:
    """A value for which the packages have no second source, held between two named analogues."""

    key: str
    field: str
    low: Callable[[], float]
    high: Callable[[], float]
    reason: str


def _melting(cas: str, method: str) -> Callable[[], float]:
    return lambda: float(_chemicals().Tm(cas, method=method))


def _hydroxide_density(cas: str) -> Callable[[], float]:
    """Density NaOH would have with the molar volume of another alkali hydroxide."""
    return lambda: _molar_mass("1310-73-2") / 1000.0 / _litres(cas, "CRC_INORG_S", "Solid")


BOUNDS = [
    Bound(
        "NaOH",
        DENSITY,
        _hydroxide_density("1310-58-3"),
        _hydroxide_density("1310-65-2"),
        "only one compilation lists it; the molar volume grows from LiOH over NaOH to KOH with the cation",
    ),
    *(
        Bound(
            key,
            MELT,
            _melting("616-20-6", "CRC_ORG"),
            _melting(CHLOROHEXANE, "CRC_ORG"),
            "never measured; melts above the next smaller secondary chloride, 3-chloropentane, and below the "
            "unbranched isomer 1-chlorohexane",
        )
        for key in CHLOROHEXANES[1:]
    ),
    Bound(
        "air",
        MELT,
        _melting(OXYGEN, "CRC_INORG"),
        _melting(NITROGEN, "CRC_INORG"),
        "no compilation lists mixtures; air freezes between its two main components",
    ),
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.label)
def test_value_agrees_with_independent_source(check: Check) -> None:
    material = MATERIALS[check.key]
    tolerance = check.tolerance or MEASURED_TOLERANCE[check.field]
    if isinstance(check.reference, str):
        assert check.reference != cited_key(material, check.field), "compared with its own source"
        expected = database(material, check.field, check.reference)
    else:
        expected = check.reference(material)
    if check.tolerance is not None:
        estimated = "estimate" in material["source"][check.field]
        assert estimated or check.reason, "a wide tolerance needs an estimate or a reason"
    assert material[check.field] == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: f"{bound.key}-{bound.field}")
def test_value_lies_between_analogues(bound: Bound) -> None:
    assert bound.low() < MATERIALS[bound.key][bound.field] < bound.high(), bound.reason


CITED = [
    (key, field, cited)
    for key in REAL
    for field in PROPERTIES
    if (cited := cited_key(MATERIALS[key], field)) is not None
]


@pytest.mark.parametrize(("key", "field", "cited"), CITED)
def test_value_is_the_one_its_source_lists(key: str, field: str, cited: str) -> None:
    # Only rounding to the digits of the file is allowed.
    assert MATERIALS[key][field] == pytest.approx(database(MATERIALS[key], field, cited), rel=3e-4)


@pytest.mark.parametrize("key", [key for key in REAL if key not in IONS])
def test_every_property_is_compared(key: str) -> None:
    covered = {check.field for check in CHECKS if check.key == key}
    covered |= {bound.field for bound in BOUNDS if bound.key == key}
    assert covered == set(PROPERTIES)


# ---------------------------------------------------------------------------------------------------------
# Form of the files
# ---------------------------------------------------------------------------------------------------------


def test_ids_are_unique_and_complete() -> None:
    counts = Counter(key for _, key, _ in ROWS)
    assert [key for key, count in counts.items() if count > 1] == []
    assert set(counts) == set().union(*ROLES.values())


@pytest.mark.parametrize("key", list(MATERIALS))
def test_fields_are_complete(key: str) -> None:
    material = MATERIALS[key]
    assert set(material) - OPTIONAL == REQUIRED
    assert key in ROLES[material["role"]]
    if material["role"] != "gas" and key not in FICTITIOUS:
        assert {"cas", "smiles"} <= set(material)
    for field in (*NUMERIC, "shade"):
        assert isinstance(material[field], float), field
    for field in PROPERTIES:
        assert 0.0 < material[field] < math.inf, field
    assert material[BOIL] > material[MELT]
    assert re.fullmatch(r"#[0-9a-f]{6}", material["color"])
    for band in material["absorption"]:
        assert set(band) == {"height_l_mol", "center_nm", "width_nm"}


@pytest.mark.parametrize("key", list(MATERIALS))
def test_every_numeric_field_has_a_source(key: str) -> None:
    source = MATERIALS[key]["source"]
    assert set(source) == {*NUMERIC, "color_shade_absorption"}
    for field, text in source.items():
        assert len(text.strip()) >= 10, f"{field} needs a citation"


@pytest.mark.parametrize("key", REAL)
def test_uncited_values_say_what_they_are(key: str) -> None:
    # A number that no compilation key backs must name a work, or admit being an estimate or a design value.
    for field in NUMERIC:
        text = MATERIALS[key]["source"][field]
        named_work = re.search(r"\(\d{4}\)|CRC Handbook|IAPWS", text)
        admitted = text.startswith(("estimate: ", "design value", "unused by the model"))
        derived = "atomic weights" in text or text.startswith("ideal gas law")
        assert cited_key(MATERIALS[key], field) or named_work or admitted or derived, f"{field}: {text}"


# ---------------------------------------------------------------------------------------------------------
# Composition and molar mass
# ---------------------------------------------------------------------------------------------------------

VALENCE = {"C": 4, "O": 2, "N": 3, "Cl": 1}


def parse_formula(formula: str) -> tuple[dict[str, int], int]:
    """Return element counts and charge of a formula such as C12H26 or OH-."""
    match = re.fullmatch(r"((?:[A-Z][a-z]?\d*)+)([+-]?)", formula)
    assert match, formula
    counts: Counter[str] = Counter()
    for element, number in re.findall(r"([A-Z][a-z]?)(\d*)", match.group(1)):
        counts[element] += int(number or 1)
    return dict(counts), {"": 0, "+": 1, "-": -1}[match.group(2)]


def parse_smiles(smiles: str) -> tuple[dict[str, int], int]:
    """Return element counts and charge of an acyclic SMILES, with the implicit hydrogen atoms."""
    counts: Counter[str] = Counter()
    charge, order, previous = 0, 1, None
    atoms: list[tuple[str, int]] = []  # organic-subset atoms: element and used valence
    stack: list[int | None] = []
    for token in re.findall(r"\[[^]]+]|Cl|[CON=().]", smiles):
        if token.startswith("["):
            bracket = re.fullmatch(r"\[(Na|Cl|O|H)(H?)([+-]?)]", token)
            assert bracket, token
            counts[bracket.group(1)] += 1
            counts["H"] += bool(bracket.group(2))
            charge += {"": 0, "+": 1, "-": -1}[bracket.group(3)]
        elif token == "(":
            stack.append(previous)
        elif token == ")":
            previous = stack.pop()
        elif token == "=":
            order = 2
        elif token == ".":
            previous = None
        else:
            bonds = 0
            if previous is not None:
                element, used = atoms[previous]
                atoms[previous] = (element, used + order)
                bonds = order
            previous, order = len(atoms), 1
            atoms.append((token, bonds))
    for element, used in atoms:
        counts[element] += 1
        counts["H"] += VALENCE[element] - used
    return {element: count for element, count in counts.items() if count}, charge


def test_smiles_parser_counts_hydrogen() -> None:
    assert parse_smiles("CCOC(=O)C") == ({"C": 4, "H": 8, "O": 2}, 0)
    assert parse_smiles("[OH-].[Na+]") == ({"O": 1, "H": 1, "Na": 1}, 0)


@pytest.mark.parametrize("key", [key for key in REAL if key != "air"])
def test_composition_matches_formula_and_smiles(key: str) -> None:
    material = MATERIALS[key]
    assert parse_formula(material["formula"]) == (material["composition"], material.get("charge", 0))
    if material["smiles"] == "[HH]":  # the one SMILES whose brackets hold a molecule
        assert material["composition"] == {"H": 2}
    else:
        assert parse_smiles(material["smiles"]) == (material["composition"], material.get("charge", 0))


def test_composition_of_air_is_one_mole_of_gas() -> None:
    composition = MATERIALS["air"]["composition"]
    assert composition["N"] / 2 + composition["O"] / 2 + composition["Ar"] == pytest.approx(1.0, abs=1e-12)
    assert composition["N"] / 2 == pytest.approx(AIR[NITROGEN])
    assert composition["O"] / 2 == pytest.approx(AIR[OXYGEN])


@pytest.mark.parametrize("key", REAL)
def test_molar_mass_matches_composition(key: str) -> None:
    table = _chemicals().periodic_table
    composition = MATERIALS[key]["composition"]
    expected = sum(table[element].MW * count for element, count in composition.items())
    assert MATERIALS[key][MASS] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("key", [key for key in REAL if key != "air"])
def test_cas_number_belongs_to_the_substance(key: str) -> None:
    material = MATERIALS[key]
    found = _chemicals().search_chemical(material["cas"])
    assert found.smiles == material["smiles"]
    by_name = _chemicals().search_chemical(material["name"].removesuffix(" metal"))
    assert by_name.CASs == material["cas"]


# The two chlorohexanes each product is made of, in the order of PRODUCTS.
PAIRS = list(itertools.combinations_with_replacement(CHLOROHEXANES, 2))
# Stoichiometry: reactants negative. Masses, elements and charges must balance.
REACTIONS: list[dict[str, int]] = [
    *(
        {left: -1 - (left == right), right: -1 - (left == right), "Na": -2, product: 1, "NaCl": 2}
        for (left, right), product in zip(PAIRS, PRODUCTS, strict=True)
    ),
    {"NaCl": -1, "Na+": 1, "Cl-": 1},
    {"NaOH": -1, "Na+": 1, "OH-": 1},
    {"Na": -2, "water": -2, "Na+": 2, "OH-": 2, "H2": 1},
    {"A": -1, "B": -1, "C": -1, "E": 1},
    {"A": -1, "D": -1, "F": 1},
    {"B": -1, "D": -1, "G": 1},
    {"C": -1, "D": -1, "H": 1},
    {"F": -1, "G": -1, "H": -1, "I": 1},
]


@pytest.mark.parametrize("reaction", REACTIONS, ids=lambda reaction: "+".join(reaction))
def test_reaction_balances(reaction: dict[str, int]) -> None:
    elements: Counter[str] = Counter()
    for key, count in reaction.items():
        for element, number in MATERIALS[key]["composition"].items():
            elements[element] += count * number
    assert not any(elements.values())
    assert sum(count * MATERIALS[key].get("charge", 0) for key, count in reaction.items()) == 0
    change = sum(count * MATERIALS[key][MASS] for key, count in reaction.items())
    total = sum(count * MATERIALS[key][MASS] for key, count in reaction.items() if count > 0)
    assert abs(change) < 1e-6 * total


def carbon_bonds(smiles: str) -> tuple[list[tuple[int, int]], int]:
    """Return the bonds between carbon atoms and the atom that bears the chlorine (-1 if none does)."""
    bonds: list[tuple[int, int]] = []
    stack: list[int] = []
    previous, count, bearer = -1, 0, -1
    for token in re.findall(r"Cl|[C()]", smiles):
        if token == "(":
            stack.append(previous)
        elif token == ")":
            previous = stack.pop()
        elif token == "Cl":
            bearer = previous
        else:
            if previous >= 0:
                bonds.append((previous, count))
            previous, count = count, count + 1
    return bonds, bearer


def skeleton(bonds: list[tuple[int, int]]) -> list[list[float]]:
    """Return each atom's sorted distances to all others, which tells all dodecane skeletons here apart."""
    size = len(bonds) + 1
    distance = np.full((size, size), np.inf)
    np.fill_diagonal(distance, 0.0)
    for one, other in bonds:
        distance[one, other] = distance[other, one] = 1.0
    for middle in range(size):
        distance = np.minimum(distance, distance[:, [middle]] + distance[[middle], :])
    return sorted(np.sort(distance, axis=1).tolist())


@pytest.mark.parametrize(("pair", "product"), list(zip(PAIRS, PRODUCTS, strict=True)))
def test_chlorohexanes_couple_to_the_products(pair: tuple[str, str], product: str) -> None:
    # Bonding two hexyl groups at their chlorine-bearing atoms must give the carbon skeleton of the product.
    (left, left_end), (right, right_end) = (carbon_bonds(MATERIALS[key]["smiles"]) for key in pair)
    shifted = [(one + 6, other + 6) for one, other in right]
    coupled = skeleton([*left, *shifted, (left_end, right_end + 6)])
    matching = [key for key in PRODUCTS if skeleton(carbon_bonds(MATERIALS[key]["smiles"])[0]) == coupled]
    assert matching == [product]


# ---------------------------------------------------------------------------------------------------------
# Ions, polarity, appearance
# ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("salt", "ions"), [("NaCl", ("Na+", "Cl-")), ("NaOH", ("Na+", "OH-"))])
def test_dissolving_keeps_volume_heat_capacity_and_mass(salt: str, ions: tuple[str, str]) -> None:
    def total(quantity: Callable[[Material], float]) -> float:
        return sum(quantity(MATERIALS[ion]) for ion in ions)

    solid = MATERIALS[salt]
    assert total(lambda m: m[MASS] / m[DENSITY]) == pytest.approx(solid[MASS] / solid[DENSITY], rel=1e-6)
    assert total(lambda m: m[HEAT]) == pytest.approx(solid[HEAT], rel=1e-12)
    for field in (MELT, BOIL, VAPOR):
        assert MATERIALS[ions[1]][field] == solid[field]
    assert "parent salt" in MATERIALS[ions[1]]["source"][BOIL]


def test_sodium_ion_takes_the_values_of_sodium_chloride() -> None:
    for field in (DENSITY, MELT, BOIL, VAPOR):
        assert MATERIALS["Na+"][field] == MATERIALS["NaCl"][field]


# Measured E_T(30) in kcal/mol; tetramethylsilane (30.7) and water (63.1) define the ends of the scale.
E_T_30 = {"diethyl_ether": 34.5, "water": 63.1, "hexane": 31.0, "ethyl_acetate": 38.1, "dodecane": 31.1}


@pytest.mark.parametrize("key", list(E_T_30))
def test_polarity_is_the_normalized_reichardt_scale(key: str) -> None:
    assert MATERIALS[key]["polarity"] == pytest.approx((E_T_30[key] - 30.7) / (63.1 - 30.7), abs=6e-4)


def test_polarity_of_the_other_materials() -> None:
    polarity = {key: material["polarity"] for key, material in MATERIALS.items()}
    assert len({polarity[key] for key in IONS}) == 1, "unequal ions would charge the layers"
    assert polarity["Na+"] > polarity["water"] == 1.0
    assert all(polarity[key] == 0.0 for key in ROLES["solid"] | ROLES["gas"])
    assert all(0.18 <= polarity[key] <= 0.20 for key in CHLOROHEXANES)
    assert all(polarity["hexane"] < polarity[key] < polarity["dodecane"] for key in PRODUCTS[1:])
    assert all(0.1 <= polarity[key] <= 0.3 for key in FICTITIOUS)


SHADES = {
    "air": 0.0,
    "diethyl_ether": 0.35,
    "water": 0.75,
    "hexane": 0.25,
    "ethyl_acetate": 0.5,
    "Na": 0.95,
    "NaCl": 0.88,
    "NaOH": 0.92,
}


def test_shades_are_distinct() -> None:
    shade = {key: material["shade"] for key, material in MATERIALS.items()}
    assert {key: shade[key] for key in SHADES} == SHADES
    assert all(0.0 <= value <= 1.0 for value in shade.values())
    for one, other in itertools.combinations(MATERIALS, 2):
        if not {one, other} <= ROLES["gas"]:
            assert abs(shade[one] - shade[other]) >= 0.02, (one, other)


def test_colors_are_distinct() -> None:
    def rgb(key: str) -> np.ndarray:
        return np.array([int(MATERIALS[key]["color"][i : i + 2], 16) for i in (1, 3, 5)], dtype=float)

    for group in (REAL, [*FICTITIOUS, *sorted(ROLES["solvent"]), "air"]):
        for one, other in itertools.combinations(group, 2):
            assert np.linalg.norm(rgb(one) - rgb(other)) >= 20.0, (one, other)


# ---------------------------------------------------------------------------------------------------------
# Spectra
# ---------------------------------------------------------------------------------------------------------

WAVELENGTHS = np.linspace(200.0, 800.0, 200)
WURTZ_BASIS = [*CHLOROHEXANES, "Na", *PRODUCTS, "NaCl", "Na+", "Cl-", "diethyl_ether"]
BASES = {
    "wurtz": WURTZ_BASIS,
    "fictitious": [*FICTITIOUS, "diethyl_ether"],
    # Extraction adds the other solvents and quenching with water the hydroxide.
    "all-real": [key for key in REAL if key not in ROLES["gas"]],
    "fictitious-all-solvents": [*FICTITIOUS, *sorted(ROLES["solvent"])],
}


def basis(keys: list[str]) -> np.ndarray:
    """Return the absorbance per mol/L of each material as a column."""
    columns = []
    for key in keys:
        column = np.zeros_like(WAVELENGTHS)
        for band in MATERIALS[key]["absorption"]:
            offset = (WAVELENGTHS - band["center_nm"]) / band["width_nm"]
            column += band["height_l_mol"] * np.exp(-(offset**2) / 2.0)
        columns.append(column)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("name", list(BASES))
def test_spectra_are_well_conditioned(name: str) -> None:
    matrix = basis(BASES[name])
    assert np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0)) < 200.0


@pytest.mark.parametrize("name", list(BASES))
def test_linear_fit_recovers_concentrations(name: str) -> None:
    generator = np.random.default_rng(7)
    keys = BASES[name]
    amounts = generator.uniform(0.05, 1.0, len(keys))
    amounts[[MATERIALS[key]["role"] == "solvent" for key in keys]] *= 10.0
    signal = basis(keys) @ amounts + generator.normal(0.0, 2e-4, WAVELENGTHS.size)
    fitted = np.linalg.lstsq(basis(keys), signal, rcond=None)[0]
    strength = np.linalg.norm(basis(keys), axis=0)
    # The error of the fit scales with the inverse of the band strength.
    assert np.all(np.abs(fitted - amounts) * strength < 0.002)


@pytest.mark.parametrize("key", list(MATERIALS))
def test_band_heights_and_positions(key: str) -> None:
    material = MATERIALS[key]
    bands = material["absorption"]
    if material["role"] == "gas":
        assert bands == []
        return
    low, high = (0.01, 0.02) if material["role"] == "solvent" else (0.05, 0.15)
    assert 1 <= len(bands) <= 3
    for band in bands:
        assert low <= band["height_l_mol"] <= high
        assert 200.0 < band["center_nm"] < 800.0
        assert 10.0 <= band["width_nm"] <= 20.0  # several of the 3 nm steps wide, yet separable
