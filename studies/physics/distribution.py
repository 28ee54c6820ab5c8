"""Distribution of solutes at infinite dilution between water and an organic solvent, saturated with each other.

    python studies/physics/distribution.py        # writes studies/physics/distribution.csv

log10 of c(organic) / c(aqueous) = log10 of gamma(aq) V(aq) / (gamma(org) V(org)), V being a phase's mean molar volume.
References are both forms of UNIFAC by thermo, and measured values if known; ``shipped`` is the same sum with chemlab's
NRTL pairs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mixtures import Array, activity_coefficients, liquid_phases, molar_volume, write

from chemlab.config.pairs import log_activity_coefficients, pair_table, shipped_pairs

ROOM_K = 298.15
SOLVENTS = ("diethyl_ether", "hexane", "ethyl_acetate", "toluene", "dodecane")
SOLUTES = (
    "1-chlorohexane",
    "2-chlorohexane",
    "dodecane",
    "1-hexene",
    "toluene",
    "ethyl_acetate",
    "ethanol",
    "acetic_acid",
    "benzoic_acid",
    "salicylic_acid",
    "acetylsalicylic_acid",
    "acetanilide",
    "naphthalene",
)
_SPARE = 1e-9

MEASURED: dict[tuple[str, str], tuple[float, str]] = {
    # log10 K of the neutral molecule. Leo, Hansch and Elkins, Chem. Rev. 71 (1971) 525, table XVII, as remembered.
    ("benzoic_acid", "diethyl_ether"): (1.89, "Leo, Hansch, Elkins (1971), as remembered"),
    ("salicylic_acid", "diethyl_ether"): (2.37, "Leo, Hansch, Elkins (1971), as remembered"),
    ("acetic_acid", "diethyl_ether"): (-0.34, "Leo, Hansch, Elkins (1971), as remembered"),
    ("ethanol", "diethyl_ether"): (-0.57, "Leo, Hansch, Elkins (1971), as remembered"),
    ("acetic_acid", "ethyl_acetate"): (-0.08, "Treybal, Liquid Extraction (1963), as remembered"),
    ("naphthalene", "hexane"): (3.5, "from its solubilities in hexane (IUPAC-NIST 59_92) and water (31.7 mg/L)"),
}


def shipped_coefficients(names: Sequence[str], temperature_k: float, fractions: Sequence[float]) -> Array:
    """Return [n] activity coefficients by the bundled pairs."""
    table = pair_table(names, shipped_pairs())
    return np.exp(log_activity_coefficients(np.asarray(fractions), table.tau(temperature_k), table.alpha))


Law = Callable[[Sequence[str], float, Sequence[float]], Array]


def saturated(solvent: str, law: Law = activity_coefficients) -> tuple[Array, Array]:
    """Return the mole fractions of (solvent, water) in the organic and in the aqueous phase."""
    poor, rich = liquid_phases(lambda x: law((solvent, "water"), ROOM_K, [x, 1.0 - x]))
    return np.array([rich, 1.0 - rich]), np.array([poor, 1.0 - poor])


def log_k(solute: str, solvent: str, phases: tuple[Array, Array], law: Law) -> float:
    """Return log10 of the ratio of concentrations, organic over aqueous."""
    out = []
    for phase in phases:
        gamma = law((solute, solvent, "water"), ROOM_K, [_SPARE, *(phase * (1.0 - _SPARE)).tolist()])[0]
        volume = float(phase @ [molar_volume(solvent), molar_volume("water")])
        out.append(math.log10(1.0 / (float(gamma) * volume)))
    return out[0] - out[1]


def main() -> None:
    """Write the table and print the deviations of the bundled pairs from UNIFAC."""
    rows: list[tuple[Any, ...]] = []
    off: list[float] = []
    for solvent in SOLVENTS:
        phases = saturated(solvent)
        for solute in SOLUTES:
            if solute == solvent:
                continue
            judge = log_k(solute, solvent, phases, activity_coefficients)
            original = log_k(solute, solvent, phases, functools.partial(activity_coefficients, dortmund=False))
            shipped = log_k(solute, solvent, phases, shipped_coefficients)
            value, source = MEASURED.get((solute, solvent), (math.nan, ""))
            rows.append((solute, solvent, judge, original, shipped, value, source))
            off.append(min(abs(shipped - other) for other in (judge, original, *([value] if source else []))))
    write("distribution.csv", ("solute", "solvent", "unifac_dortmund", "unifac", "shipped", "measured", "source"), rows)
    for row in rows:
        print("{:22s}{:16s}{:8.2f}{:8.2f}{:8.2f}  {}".format(*row[:6]))
    print(f"{len(rows)} of them; {sum(o <= 0.2 for o in off)} of the shipped are within 0.2 of a judge")


if __name__ == "__main__":
    main()
