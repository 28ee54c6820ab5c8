"""Solubility of solids in solvents, compared with measured values.

    python studies/physics/solubility.py        # writes studies/physics/solubility.csv

x gamma = exp(-dHfus / R (1 / T - 1 / Tm)): Prausnitz, Lichtenthaler, de Azevedo, Molecular Thermodynamics of
Fluid-Phase Equilibria (1999), without the heat capacities. gamma by UNIFAC (Dortmund) of thermo, and by chemlab's NRTL
pairs.
"""

from __future__ import annotations

import math

import numpy as np
from distribution import Law, shipped_coefficients
from mixtures import GAS_CONSTANT, activity_coefficients, write
from scipy.optimize import brentq

from chemlab.config.materials import shipped_materials

MERCK = "Merck Index, as remembered"
AAPS = "AAPS PharmSciTech 23 (2022), doi 10.1208/s12249-021-02192-7, table IV"
BENZOIC = "J. Chem. Eng. Data 55 (2010) 5124, doi 10.1021/je100675r, table 2"
HEXANE = "IUPAC-NIST Solubility Database 59_92, evaluation"
SUNIER = "Sunier (1930), IUPAC-NIST Solubility Database 59_199"
HERIC = "Heric and Posey, J. Chem. Eng. Data 9 (1964) 35, as remembered"

MEASURED: list[tuple[str, str, float, float, str]] = [
    # Mole fraction in the saturated solution.
    ("benzoic_acid", "water", 298.15, 5.02e-4, "Seidell, 3.4 g/L, as remembered"),
    ("benzoic_acid", "ethanol", 293.15, 0.166, BENZOIC),
    ("benzoic_acid", "ethanol", 313.15, 0.234, BENZOIC),
    ("benzoic_acid", "diethyl_ether", 298.15, 0.221, MERCK),
    ("benzoic_acid", "hexane", 298.15, 0.0095, "Acree, IUPAC-NIST Solubility Data Series 99, as remembered"),
    ("benzoic_acid", "toluene", 298.15, 0.070, "Acree, IUPAC-NIST Solubility Data Series 99, as remembered"),
    ("salicylic_acid", "water", 298.15, 3.1e-4, "handbooks, 2.4 g/L, as remembered"),
    ("salicylic_acid", "ethanol", 298.15, 0.135, MERCK),
    ("salicylic_acid", "diethyl_ether", 298.15, 0.20, MERCK),
    ("acetylsalicylic_acid", "water", 298.15, 4.45e-4, AAPS),
    ("acetylsalicylic_acid", "ethanol", 310.15, 0.0632, AAPS),
    ("acetylsalicylic_acid", "diethyl_ether", 298.15, 0.044, MERCK),
    ("acetanilide", "water", 298.15, 7.2e-4, MERCK),
    ("acetanilide", "ethanol", 298.15, 0.113, MERCK),
    ("acetanilide", "diethyl_ether", 298.15, 0.041, MERCK),
    ("naphthalene", "water", 298.15, 4.45e-6, "Shiu and Ma (2000), 31.7 mg/L, as remembered"),
    ("naphthalene", "hexane", 298.15, 0.1197, HEXANE),
    ("naphthalene", "hexane", 313.15, 0.2227, HEXANE),
    ("naphthalene", "toluene", 298.15, 0.292, HERIC),
    ("naphthalene", "ethanol", 299.0, 0.0422, SUNIER),
    ("naphthalene", "ethanol", 316.3, 0.0829, SUNIER),
]


def ideal(solute: str, temperature_k: float) -> float:
    """Return ln of the mole fraction in an ideal saturated solution."""
    material = shipped_materials()[solute]
    assert material.real is not None
    assert material.real.fusion_enthalpy_j_mol is not None
    assert material.melting_point_k is not None
    slope = material.real.fusion_enthalpy_j_mol / GAS_CONSTANT
    return -slope * (1.0 / temperature_k - 1.0 / material.melting_point_k)


def solve(solute: str, solvent: str, temperature_k: float, law: Law) -> float:
    """Return the mole fraction of the saturated solution; the smallest if there are several."""
    right = ideal(solute, temperature_k)

    def excess(log_x: float) -> float:
        x = math.exp(log_x)
        return log_x + math.log(law((solute, solvent), temperature_k, [x, 1.0 - x])[0]) - right

    grid = np.linspace(-18.0, -1e-3, 600).tolist()
    at = next(i for i in range(1, len(grid)) if excess(grid[i]) >= 0.0)
    return math.exp(brentq(excess, grid[at - 1], grid[at]))


def main() -> None:
    """Write the table and print it."""
    rows = []
    for solute, solvent, temperature, measured, source in MEASURED:
        laws = (activity_coefficients, shipped_coefficients)
        found = [solve(solute, solvent, temperature, law) for law in laws]
        off = [math.log10(value / measured) for value in found]
        rows.append(
            (solute, solvent, temperature, measured, math.exp(ideal(solute, temperature)), *found, *off, source)
        )
    header = ("solute", "solvent", "kelvin", "measured", "ideal", "unifac", "shipped", "log10_unifac", "log10_shipped")
    write("solubility.csv", (*header, "source"), rows)
    for row in rows:
        print("{:22s}{:15s}{:7.1f}{:10.3g}{:10.3g}{:10.3g}{:10.3g}{:8.2f}{:8.2f}".format(*row[:9]))


if __name__ == "__main__":
    main()
