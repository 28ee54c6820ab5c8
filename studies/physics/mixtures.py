"""Common parts of the reference calculations: UNIFAC (Dortmund) and vapour pressures by thermo, and CSV files.

Nothing here uses chemlab.
"""

from __future__ import annotations

import csv
import functools
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import chemicals
import numpy as np
import numpy.typing as npt
import thermo
import thermo.unifac
from scipy.optimize import brentq

Array = npt.NDArray[np.float64]

HERE = Path(__file__).resolve().parent
ATMOSPHERE_PA = 101325.0
GAS_CONSTANT = 8.314462618

SUBSTANCES: dict[str, tuple[str, dict[str, int]]] = {
    # CAS number and groups of the Dortmund form.
    "diethyl_ether": ("60-29-7", {"CH3": 2, "CH2": 1, "CH2O": 1}),
    "water": ("7732-18-5", {"H2O": 1}),
    "hexane": ("110-54-3", {"CH3": 2, "CH2": 4}),
    "ethyl_acetate": ("141-78-6", {"CH3": 1, "CH2": 1, "CH3COO": 1}),
    "toluene": ("108-88-3", {"ACH": 5, "ACCH3": 1}),
    "ethanol": ("64-17-5", {"CH3": 1, "CH2": 1, "OH(P)": 1}),
    "acetic_acid": ("64-19-7", {"CH3": 1, "COOH": 1}),
    "1-hexene": ("592-41-6", {"CH3": 1, "CH2": 3, "CH2=CH": 1}),
    "1-chlorohexane": ("544-10-5", {"CH3": 1, "CH2": 4, "CH2CL": 1}),
    "2-chlorohexane": ("638-28-8", {"CH3": 2, "CH2": 3, "CHCL": 1}),
    "dodecane": ("112-40-3", {"CH3": 2, "CH2": 10}),
    "5-methylundecane": ("1632-70-8", {"CH3": 3, "CH2": 8, "CH": 1}),
    "4-ethyldecane": ("1636-44-8", {"CH3": 3, "CH2": 8, "CH": 1}),
    "benzoic_acid": ("65-85-0", {"ACH": 5, "AC": 1, "COOH": 1}),
    "salicylic_acid": ("69-72-7", {"ACH": 4, "AC": 1, "ACOH": 1, "COOH": 1}),
    "acetylsalicylic_acid": ("50-78-2", {"ACH": 4, "AC": 2, "CH3COO": 1, "COOH": 1}),
    "acetanilide": ("103-84-4", {"ACH": 5, "AC": 1, "CONHCH3": 1}),  # those of N-methylbenzamide
    "naphthalene": ("91-20-3", {"ACH": 8, "AC": 2}),
}


@functools.cache
def _model(names: tuple[str, ...], dortmund: bool = True) -> Any:
    u = thermo.unifac
    u.load_unifac_ip()
    numbers = {group.group: number for number, group in u.DOUFSG.items() if number < 119}  # the same in both forms
    groups = [{numbers[key]: n for key, n in SUBSTANCES[name][1].items()} for name in names]
    return u.UNIFAC.from_subgroups(
        T=300.0,
        xs=[1.0 / len(names)] * len(names),
        chemgroups=groups,
        version=int(dortmund),
        interaction_data=u.DOUFIP2016 if dortmund else u.UFIP,
        subgroups=u.DOUFSG if dortmund else u.UFSG,
    )


def activity_coefficients(
    names: Sequence[str], temperature_k: float, fractions: Sequence[float], dortmund: bool = True
) -> Array:
    """Return [n] activity coefficients of a mixture by UNIFAC: the Dortmund form (parameters of 2016) or the
    original.
    """
    kept = np.maximum(np.asarray(fractions, dtype=np.float64), 1e-12)
    return np.array(_model(tuple(names), dortmund).to_T_xs(temperature_k, (kept / kept.sum()).tolist()).gammas())


METHODS = ("HEOS_FIT", "DIPPR_PERRY_8E", "LANDOLT", "ANTOINE_WEBBOOK", "AMBROSE_WALTON")


@functools.cache
def _vapor(name: str) -> tuple[Any, str]:
    cas = SUBSTANCES[name][0]
    found = thermo.VaporPressure(
        CASRN=cas, Tb=chemicals.Tb(cas), Tc=chemicals.Tc(cas), Pc=chemicals.Pc(cas), omega=chemicals.omega(cas)
    )
    # For some compounds, Landolt-Boernstein has only the boiling point.
    known = [m for m in METHODS if m in found.all_methods and found.T_limits[m][1] - found.T_limits[m][0] > 1.0]
    return found, known[0]


def vapor_pressure(name: str, temperature_k: float) -> float:
    """Return the vapour pressure in Pa by thermo's best method, extrapolated linearly in ln p over 1 / T beyond its
    range.
    """
    found, method = _vapor(name)
    low, high = found.T_limits[method]
    inside = min(max(temperature_k, low), high - 1.0)
    value = float(found.calculate(inside, method))
    if inside == temperature_k:
        return value
    step = 0.5 if inside == low else -0.5
    slope = math.log(found.calculate(inside + step, method) / value) / (1.0 / (inside + step) - 1.0 / inside)
    return value * math.exp(slope * (1.0 / temperature_k - 1.0 / inside))


@functools.cache
def molar_volume(name: str) -> float:
    """Return the molar volume of the liquid in L/mol at 298.15 K."""
    cas = SUBSTANCES[name][0]
    found = thermo.VolumeLiquid(
        CASRN=cas,
        MW=chemicals.MW(cas),
        Tb=chemicals.Tb(cas),
        Tc=chemicals.Tc(cas),
        Pc=chemicals.Pc(cas),
        Vc=chemicals.Vc(cas),
        omega=chemicals.omega(cas),
    )
    return float(found.T_dependent_property(298.15)) * 1000.0


def bubble_point(names: Sequence[str], fractions: Array) -> tuple[float, Array]:
    """Return the bubble point in K at one atmosphere, and the mole fractions of the vapour."""

    def partial(temperature: float) -> Array:
        pure = np.array([vapor_pressure(name, temperature) for name in names])
        return fractions * activity_coefficients(names, temperature, fractions.tolist()) * pure

    temperature = float(brentq(lambda t: float(partial(t).sum()) - ATMOSPHERE_PA, 250.0, 520.0, xtol=1e-8))
    vapor = partial(temperature)
    return temperature, vapor / vapor.sum()


def liquid_phases(gammas: Callable[[float], Array]) -> tuple[float, float]:
    """Return the mole fractions of the first component in both coexisting liquids, poor and rich.

    Both have equal activities. ``gammas`` gives both activity coefficients at a mole fraction of the first component.
    """
    poor, rich = 1e-9, 1.0 - 1e-6
    for _ in range(10_000):
        one, other = gammas(poor), gammas(rich)
        k1, k2 = one[0] / other[0], one[1] / other[1]  # x_rich = k1 x_poor; 1 - x_rich = k2 (1 - x_poor)
        new_poor = float((1.0 - k2) / (k1 - k2))
        new_rich = float(k1 * new_poor)
        change = abs(math.log(new_poor / poor)) + abs(math.log((1.0 - new_rich) / (1.0 - rich)))
        poor, rich = new_poor, new_rich
        if change < 1e-10:
            return poor, rich
    raise ArithmeticError("no two liquids found")


def write(name: str, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file beside this one, with numbers to six digits."""
    with (HERE / name).open("w", encoding="utf-8", newline="") as handle:
        table = csv.writer(handle, lineterminator="\n")
        table.writerow(header)
        table.writerows([f"{v:.6g}" if isinstance(v, float) else v for v in row] for row in rows)
