"""Mutual solubility of water and organic solvents, and the vapour pressure over both layers.

    python studies/physics/layers.py        # writes studies/physics/layers.csv

Equal activities in both liquids; the partial pressures of either layer are equal. UNIFAC (Dortmund) of thermo and
chemlab's NRTL pairs are compared with measured values.
"""

from __future__ import annotations

import math

import numpy as np
from distribution import ROOM_K, Law, saturated, shipped_coefficients
from mixtures import activity_coefficients, vapor_pressure, write

MEASURED: dict[str, tuple[float, float, str]] = {
    # Mole fractions: organic in water, water in organic. As remembered from the IUPAC Solubility Data Series.
    "diethyl_ether": (0.0154, 0.0517, "6.04 and 1.3 % by mass"),
    "ethyl_acetate": (0.0166, 0.134, "7.6 and 3.07 % by mass"),
    "hexane": (2.05e-6, 4.8e-4, "9.8 mg/L and 0.01 % by mass"),
    "toluene": (1.02e-4, 2.7e-3, "0.052 and 0.053 % by mass"),
    "1-chlorohexane": (1.5e-5, math.nan, "0.1 g/L"),
    "dodecane": (3.9e-10, 5.6e-4, "3.7 ug/L and 0.0059 % by mass"),
}


def coexisting(law: Law, name: str) -> list[float]:
    """Return the mole fractions of the organic in water and of water in the organic, and kPa over both layers."""
    organic, aqueous = saturated(name, law)
    pure = [vapor_pressure(each, ROOM_K) for each in (name, "water")]
    kpa = float(np.sum(organic * law((name, "water"), ROOM_K, organic.tolist()) * pure)) / 1000.0
    return [float(aqueous[0]), float(organic[1]), kpa]


def main() -> None:
    """Write the table and print it."""
    rows = []
    for name, (in_water, of_water, source) in MEASURED.items():
        found = [*coexisting(activity_coefficients, name), *coexisting(shipped_coefficients, name)]
        rows.append((name, in_water, of_water, *found, source))
    columns = ("in_water", "of_water", "kpa")
    header = ("organic", "measured_in_water", "measured_of_water", *(f"unifac_{c}" for c in columns))
    write("layers.csv", (*header, *(f"shipped_{c}" for c in columns), "measured"), rows)
    for row in rows:
        print("{:16s}{:10.2g}{:10.2g} |{:10.2g}{:10.2g}{:8.2f} |{:10.2g}{:10.2g}{:8.2f}".format(*row[:9]))


if __name__ == "__main__":
    main()
