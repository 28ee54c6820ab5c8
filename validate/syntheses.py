"""The shipped syntheses in a flask of chemlab, against what was published and against integration by SciPy.

    python validate/syntheses.py        # writes validate/syntheses.csv

Unlike the other judges this one runs chemlab's kernels: ``chemlab`` is what a :class:`chemlab.sandbox.Flask` comes to.
``published`` is of the publication in ``source``, ``independent`` a sum or an integration made here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from chemlab.materials import shipped_materials
from chemlab.sandbox import Flask

GAS = 8.314462618
MATERIALS = shipped_materials()


class Row(NamedTuple):
    """A line of the table; NaN where there is no such number."""

    synthesis: str
    quantity: str
    unit: str
    published: float
    independent: float
    chemlab: float
    source: str


def litres(contents: Mapping[str, float]) -> float:
    """Volume of some mol of liquids, unmixed."""
    return sum(n * MATERIALS[k].molar_mass_g_mol / MATERIALS[k].density_kg_l / 1000.0 for k, n in contents.items())


def filled_up(contents: Mapping[str, float], solvent: str, litre: float = 0.5) -> dict[str, float]:
    """Contents with so much solvent that they fill ``litre``."""
    rest = litre - litres(contents)
    return {**contents, solvent: rest / litres({solvent: 1.0})}


# -- snar -------------------------------------------------------------------------------------------------------------

SUBSTRATE, AMINE = "2,4-difluoronitrobenzene", "pyrrolidine"
PRODUCTS = ("ortho_pyrrolidinyl", "para_pyrrolidinyl", "bis_pyrrolidinyl")
SNAR_KELVIN = 363.15
SNAR_AT_90_C = ((0.579, 33.3), (0.027, 35.3), (0.00865, 38.9), (0.0163, 44.8))
"""L/mol/s at 90 degrees C and kJ/mol: Hone et al. (2017) as in the Summit benchmark."""
_SNAR_SOURCE = "Hone et al. (2017), React. Chem. Eng. 2, 103, constants as in Summit's summit/benchmarks/snar.py"


def snar_profile(start: tuple[float, float], celsius: float, seconds: float, amines: float) -> list[float]:
    """mol/L of substrate and products after some time, by SciPy.

    Args:
        start: mol/L of substrate and amine.
        celsius, seconds: temperature and time.
        amines: used up in each substitution: 1 as in Summit's rate equations, 2 where one takes the acid.
    """
    kelvin = celsius + 273.15
    k = [at * math.exp(-1000.0 * e / GAS * (1.0 / kelvin - 1.0 / SNAR_KELVIN)) for at, e in SNAR_AT_90_C]

    def rates(_: float, c: np.ndarray) -> list[float]:
        a, b, ortho, para, _bis = c
        r = k[0] * a * b, k[1] * a * b, k[2] * ortho * b, k[3] * para * b
        return [-r[0] - r[1], -amines * sum(r), r[0] - r[2], r[1] - r[3], r[2] + r[3]]

    found = solve_ivp(rates, (0.0, seconds), [*start, 0.0, 0.0, 0.0], method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
    return [float(found[i]) for i in (0, 2, 3, 4)]


def snar() -> list[Row]:
    """Concentration profiles at conditions of the publication, with plenty of amine and with little."""
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


SYNTHESES: dict[str, Callable[[], list[Row]]] = {"snar": snar}


def main() -> None:
    """Write the table and print it."""
    from mixtures import write  # needs the extra chem, which the numbers do not

    rows = [row for make in SYNTHESES.values() for row in make()]
    write("syntheses.csv", Row._fields, rows)
    for row in rows:
        print(f"{row.synthesis:9s}{row.quantity:75s}{row.published:10.4g}{row.independent:10.4g}{row.chemlab:10.4g}")


if __name__ == "__main__":
    main()
