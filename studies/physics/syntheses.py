"""The bundled syntheses in a flask of chemlab, compared with publications and with integration by SciPy.

    python studies/physics/syntheses.py        # writes studies/physics/syntheses.csv

Unlike the other studies, this one runs chemlab's kernels: ``chemlab`` is the result of a
:class:`chemlab.sandbox.Flask`. ``published`` is from the publication in ``source``; ``independent`` is a sum or an
integration made here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from chemlab import Flask
from chemlab.config.materials import litres_of, shipped_materials

GAS = 8.314462618
MATERIALS = shipped_materials()


class Row(NamedTuple):
    """A row of the table; NaN for missing numbers."""

    synthesis: str
    quantity: str
    unit: str
    published: float
    independent: float
    chemlab: float
    source: str


def filled_up(contents: Mapping[str, float], solvent: str, litre: float = 0.5) -> dict[str, float]:
    """Add solvent to contents until they fill ``litre``."""
    rest = litre - litres_of(contents, MATERIALS)
    return {**contents, solvent: rest / litres_of({solvent: 1.0}, MATERIALS)}


# -- snar -------------------------------------------------------------------------------------------------------------

SUBSTRATE, AMINE = "2,4-difluoronitrobenzene", "pyrrolidine"
PRODUCTS = ("ortho_pyrrolidinyl", "para_pyrrolidinyl", "bis_pyrrolidinyl")
SNAR_KELVIN = 363.15
SNAR_AT_90_C = ((0.579, 33.3), (0.027, 35.3), (0.00865, 38.9), (0.0163, 44.8))
"""L/mol/s at 90 degrees C and kJ/mol: Hone et al. (2017) as in the Summit benchmark."""
_SNAR_SOURCE = "Hone et al. (2017), React. Chem. Eng. 2, 103, constants as in Summit's summit/benchmarks/snar.py"


def snar_profile(start: tuple[float, float], celsius: float, seconds: float, amines: float) -> list[float]:
    """Return mol/L of substrate and products after a time, by SciPy.

    Args:
        start: mol/L of substrate and amine.
        celsius, seconds: temperature and time.
        amines: amine consumed per substitution: 1 as in Summit's rate equations, 2 if one more binds the acid.
    """
    kelvin = celsius + 273.15
    k = [at * math.exp(-1000.0 * e / GAS * (1.0 / kelvin - 1.0 / SNAR_KELVIN)) for at, e in SNAR_AT_90_C]

    names = (SUBSTRATE, AMINE, *PRODUCTS)
    each = np.array([litres_of({name: 1.0}, MATERIALS) for name in names])
    first = np.array([*start, 0.0, 0.0, 0.0])

    def rates(_: float, mol: np.ndarray) -> list[float]:
        # The volume is a litre at first; with a solid salt (two amines) the liquid's volume decreases.
        volume = 1.0 + float(each @ (mol - first)) if amines == 2.0 else 1.0
        a, b, ortho, para, _bis = mol / math.sqrt(volume)
        r = k[0] * a * b, k[1] * a * b, k[2] * ortho * b, k[3] * para * b
        return [-r[0] - r[1], -amines * sum(r), r[0] - r[2], r[1] - r[3], r[2] + r[3]]

    found = solve_ivp(rates, (0.0, seconds), [*start, 0.0, 0.0, 0.0], method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
    return [float(found[i]) for i in (0, 2, 3, 4)]


def snar() -> list[Row]:
    """Yield concentration profiles at conditions of the publication, with excess and with little amine."""
    rows = []
    for celsius, equivalents, times in ((60.0, 5.0, (30, 60, 120)), (90.0, 5.0, (15, 30, 60)), (90.0, 2.0, (60,))):
        start = 0.2, 0.2 * equivalents
        contents = filled_up({SUBSTRATE: 0.5 * start[0], AMINE: 0.5 * start[1]}, "ethanol")
        for seconds in times:
            flask = Flask(contents, reactions="snar")
            flask.react(float(seconds), temperature_k=celsius + 273.15)
            made = [flask.amounts.get(name, 0.0) / 0.5 for name in (SUBSTRATE, *PRODUCTS)]
            summit, balanced = (snar_profile(start, celsius, seconds, amines) for amines in (1.0, 2.0))
            where = f"after {seconds} s at {celsius:g} C, 0.2 mol/L and {equivalents:g} equivalents"
            for name, *numbers in zip((SUBSTRATE, *PRODUCTS), summit, balanced, made, strict=True):
                rows.append(Row("snar", f"{name} {where}", "mol/L", *numbers, _SNAR_SOURCE))
    return rows


# -- fischer ----------------------------------------------------------------------------------------------------------

ACID, ALCOHOL, ESTER, WATER, CATALYST = "acetic_acid", "ethanol", "ethyl_acetate", "water", ("H+", "Cl-")
BERTHELOT = ((0.05, 0.05), (0.18, 0.171), (0.33, 0.293), (0.5, 0.414), (1.0, 0.665), (2.0, 0.858), (8.0, 0.966))
"""mol of ethanol per mol of acetic acid, mol of ester at equilibrium."""
_BERTHELOT_SOURCE = "Berthelot and Pean de Saint-Gilles (1862), as Nernst's Theoretical Chemistry has it, as remembered"
SMITH = (3.91, 10.2, 17.56)
"""mol/L of acid, alcohol and water of a charge at 100 degrees C."""
MIXED_HEAT = -3.6
"""kJ/mol of esterification at 313 K, by calorimetry; its authors give 0.2 as its error."""
_HEAT_SOURCE = "Excess enthalpies and heat of esterification reaction (2019), a calorimeter at 313 K, abstract (read)"
_SMITH_SOURCE = "Smith, Chemical Engineering Kinetics, 2nd ed. (1970), chapter 4, as remembered"
AZEOTROPES = ((ALCOHOL, 0.54, 344.96), (WATER, 0.69, 343.53))
"""Other component, mole fraction of the ester, boiling temperature in K at 101.325 kPa."""
_AZEOTROPE_SOURCE = (
    "CRC Handbook, azeotropic data, as remembered; that with ethanol is 0.539 and 71.8 C in a textbook's problem (read)"
)


def ester_at(start: tuple[float, float, float], seconds: float, k: float, equilibrium: float) -> float:
    """Return mol/L of ester formed from acid, alcohol and water, by SciPy; k in L/mol/s."""
    acid, alcohol, water = start

    def rate(_: float, c: np.ndarray) -> list[float]:
        return [k * ((acid - c[0]) * (alcohol - c[0]) - c[0] * (water + c[0]) / equilibrium)]

    return float(solve_ivp(rate, (0.0, seconds), [0.0], method="LSODA", rtol=1e-10, atol=1e-12).y[0, -1])


def _formed(name: str) -> float:
    real = MATERIALS[name].real
    assert real is not None
    return real.formation_enthalpy_j_mol


def _boiled(other: str, fraction: float) -> tuple[float, float]:
    """Return the boiling temperature in K of a mixture, and the mole fraction of the ester in its vapour."""
    flask = Flask({ESTER: 2.0 * fraction, other: 2.0 * (1.0 - fraction)})
    receiver = flask.another()
    while not receiver.volume_l > 1e-3:
        flask.heat(500.0, receiver)
    over = receiver.amounts
    return flask.temperature_k, over[ESTER] / (over[ESTER] + over[other])


def fischer() -> list[Row]:
    """Return equilibria, a conversion curve, and azeotropes."""
    rows = []
    for alcohol, published in BERTHELOT:
        flask = Flask({ACID: 1.0, ALCOHOL: alcohol, **dict.fromkeys(CATALYST, 1e-3)}, reactions="fischer")
        flask.react(1e11, temperature_k=298.15)
        total = 1.0 + alcohol
        expected = (4.0 * total - math.sqrt(16.0 * total**2 - 48.0 * alcohol)) / 6.0  # K = 4
        what = f"ester of 1 mol of acid and {alcohol:g} mol of alcohol"
        rows.append(Row("fischer", what, "mol", published, expected, flask.amounts[ESTER], _BERTHELOT_SOURCE))
    heat = _formed(ESTER) + _formed(WATER) - _formed(ACID) - _formed(ALCOHOL)
    equilibrium = 4.0 * math.exp(-heat / GAS * (1.0 / 373.15 - 1.0 / 298.15))
    rows.append(Row("fischer", "heat of esterification", "kJ/mol", MIXED_HEAT, heat / 1000.0, math.nan, _HEAT_SOURCE))
    rows.append(Row("fischer", "K at 100 C", "", 4.76 / 1.63, equilibrium, math.nan, _SMITH_SOURCE))
    contents = dict(zip((ACID, ALCOHOL, WATER), SMITH, strict=True))
    litre = litres_of(contents, MATERIALS)  # more than the nominal 1 L, because volumes are additive here
    start = SMITH[0] / litre, SMITH[1] / litre, SMITH[2] / litre
    for minutes, published in ((30, math.nan), (60, math.nan), (120, 0.35), (100_000, 0.54)):
        flask = Flask({**contents, **dict.fromkeys(CATALYST, 0.1 * litre)}, reactions="fischer", capacity_l=2.0)
        litre_now = flask.volume_l  # including the catalyst
        flask.react(60.0 * minutes, temperature_k=373.15)
        k = 1.86e4 * math.exp(-59780.0 / GAS / 373.15) * 0.1 * litre / litre_now
        thinned = (start[0] * litre / litre_now, start[1] * litre / litre_now, start[2] * litre / litre_now)
        expected = ester_at(thinned, 60.0 * minutes, k, equilibrium) / thinned[0]
        what = f"conversion of the acid after {minutes} min at 100 C"
        rows.append(Row("fischer", what, "", published, expected, flask.amounts[ESTER] / SMITH[0], _SMITH_SOURCE))
    for other, fraction, kelvin in AZEOTROPES:
        boils, over = _boiled(other, fraction)
        what = f"azeotrope of ethyl acetate and {other}"
        rows.append(Row("fischer", f"{what}, boils at", "K", kelvin, math.nan, boils, _AZEOTROPE_SOURCE))
        rows.append(Row("fischer", f"{what}, ester in its vapour", "", fraction, math.nan, over, _AZEOTROPE_SOURCE))
    return rows


# -- benzoic ----------------------------------------------------------------------------------------------------------

BENZOIC, BASE, RETURNS = "benzoic_acid", "NaOH", "sodium_bisulfate"
_OWN = Path(__file__).parents[2] / "scenarios" / "syntheses" / "benzoic"
_BENZOIC: dict[str, Any] = {"reactions": str(_OWN / "reactions.toml"), "material_files": [str(_OWN / "materials.toml")]}
_CHARGE_SOURCE = "balance of charge: the ions of a base that is short are those of the acid"
_SEIDELL = "Seidell, 3.4 g/L, as remembered"


def _shaken(contents: Mapping[str, float], base: float) -> Flask:
    """Dissolve contents (one day), then shake them with water and sodium hydroxide."""
    flask = Flask(contents, **_BENZOIC, capacity_l=2.0)
    flask.wait(86400.0)
    flask.add(WATER, 20.0)
    flask.add(BASE, base)
    flask.mix()
    return flask


def benzoic() -> list[Row]:
    """Return the extraction into water with a base and the recovery with an acid."""
    rows = []
    for base in (0.05, 0.1, 0.2):
        made = _shaken({"toluene": 4.0, BENZOIC: 0.25, "naphthalene": 0.25}, base).amounts["benzoate"]
        what = f"benzoate in water of 0.25 mol of acid in toluene and {base:g} mol of sodium hydroxide"
        rows.append(Row("benzoic", what, "mol", math.nan, base, made, _CHARGE_SOURCE))
    flask = Flask({WATER: 55.0, BENZOIC: 0.1}, **_BENZOIC, capacity_l=2.0)
    flask.wait(86400.0)
    layer = next(one for one in flask.layers if one.name == "aqueous")
    dissolved = (layer.contents[BENZOIC] + layer.contents.get("benzoate", 0.0)) / layer.volume_l
    rows.append(Row("benzoic", "solubility in water at 25 C", "mol/L", 0.0278, math.nan, dissolved, _SEIDELL))
    flask = _shaken({BENZOIC: 0.25}, 0.3)
    flask.add(RETURNS, 0.36)
    flask.mix()
    flask.wait(86400.0)
    layer = next(one for one in flask.layers if one.name == "aqueous")
    left = layer.contents[BENZOIC] + layer.contents.get("benzoate", 0.0)
    what = "acid that 0.36 mol of sodium bisulfate gives back of 0.25 mol"
    rows.append(Row("benzoic", what, "", math.nan, math.nan, 1.0 - left / 0.25, "solubility and pKa, as above"))
    return rows


# -- aspirin ----------------------------------------------------------------------------------------------------------

ASPIRIN, ANHYDRIDE = "acetylsalicylic_acid", "acetic_anhydride"
_ELDRIDGE = "Eldridge and Piret (1950), Chem. Eng. Prog. 46, 290, as textbooks have it, as remembered"
_AVERILL = "Averill and Eldredge, General Chemistry, table 14.1 (read)"
HYDROLYSES = (
    (ANHYDRIDE, 298.15, 600.0, math.exp(-0.158 * 10.0), (4650.0, 45600.0), _ELDRIDGE),
    (ANHYDRIDE, 313.15, 300.0, math.exp(-0.380 * 5.0), (4650.0, 45600.0), _ELDRIDGE),
    (ASPIRIN, 310.15, 3600.0 * 100.0, 3.83 / 5.55, (3.65e4, 72970.0), _AVERILL),
    (ASPIRIN, 310.15, 3600.0 * 300.0, 1.82 / 5.55, (3.65e4, 72970.0), _AVERILL),
)
"""Compound, K, s, remaining share; A in L/mol/s and J/mol."""


def aspirin() -> list[Row]:
    """Return the hydrolysis rates of the anhydride and the product."""
    rows = []
    for name, kelvin, seconds, published, (factor, activation), source in HYDROLYSES:
        flask = Flask({WATER: 55.0, name: 0.0055}, reactions="aspirin", capacity_l=2.0)
        if name == ASPIRIN:
            flask.wait(3600.0)  # crystals dissolve
        start = flask.amounts[name]
        water = flask.amounts[WATER] / flask.volume_l
        flask.react(seconds, temperature_k=kelvin)
        k = factor * math.exp(-activation / GAS / kelvin) * water
        what = f"{name} left after {seconds:g} s in water of {kelvin - 273.15:g} C"
        left = flask.amounts[name] / start
        rows.append(Row("aspirin", what, "", published, math.exp(-k * seconds), left, source))
    return rows


SYNTHESES: dict[str, Callable[[], list[Row]]] = {
    "snar": snar,
    "fischer": fischer,
    "benzoic": benzoic,
    "aspirin": aspirin,
}


def main() -> None:
    """Write the table and print it."""
    from mixtures import write  # needs the extra chem, which the calculations do not

    rows = [row for make in SYNTHESES.values() for row in make()]
    write("syntheses.csv", Row._fields, rows)
    for row in rows:
        print(f"{row.synthesis:9s}{row.quantity:75s}{row.published:10.4g}{row.independent:10.4g}{row.chemlab:10.4g}")


if __name__ == "__main__":
    main()
