"""pH of standard buffers: assigned values, and charge balances with and without activity coefficients.

    python studies/physics/acids.py        # writes studies/physics/acids.csv

pH(S) at 298.15 K: Bates, J. Res. NBS 66A (1962) 179; Staples and Bates, J. Res. NBS 73A (1969) 37; Buck et al., Pure
Appl. Chem. 74 (2002) 2169. Dissociation constants at infinite dilution: CRC Handbook and Robinson and Stokes,
Electrolyte Solutions (1959), as remembered. Activity coefficients: Davies (1962),
log10 gamma = -0.509 z^2 (I^0.5 / (1 + I^0.5) - 0.3 I).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mixtures import write
from scipy.optimize import brentq

PKW = 13.995
_DEBYE_HUECKEL = 0.509


@dataclass(frozen=True)
class Acid:
    """An acid at mol/kg in all its forms; ``charge`` is that of its fully protonated form."""

    total: float
    pka: tuple[float, ...]
    charge: int = 0


@dataclass(frozen=True)
class Buffer:
    """A solution: its acids, and the mol/kg of singly charged spectator ions."""

    name: str
    acids: tuple[Acid, ...]
    cations: float
    anions: float
    ph: float
    source: str


OXALIC, TARTARIC, CITRIC = (1.271, 4.266), (3.036, 4.366), (3.128, 4.761, 6.396)
PHTHALIC, PHOSPHORIC, CARBONIC = (2.950, 5.408), (2.148, 7.198, 12.35), (6.352, 10.329)
BATES = "Bates (1962)"
STAPLES = "Staples and Bates (1969)"
BUCK = "Buck et al. (2002)"

BUFFERS = (
    Buffer("potassium tetroxalate 0.05", (Acid(0.1, OXALIC),), 0.05, 0.0, 1.679, BATES),
    Buffer("potassium hydrogen tartrate 0.0341 (saturated)", (Acid(0.0341, TARTARIC),), 0.0341, 0.0, 3.557, BATES),
    Buffer("potassium dihydrogen citrate 0.05", (Acid(0.05, CITRIC),), 0.05, 0.0, 3.776, STAPLES),
    Buffer("potassium hydrogen phthalate 0.05", (Acid(0.05, PHTHALIC),), 0.05, 0.0, 4.005, BUCK),
    Buffer("acetic acid 0.1, sodium acetate 0.1", (Acid(0.2, (4.756,)),), 0.1, 0.0, 4.652, "Bates, as remembered"),
    Buffer("KH2PO4 0.025, Na2HPO4 0.025", (Acid(0.05, PHOSPHORIC),), 0.075, 0.0, 6.865, BUCK),
    Buffer("KH2PO4 0.008695, Na2HPO4 0.03043", (Acid(0.039125, PHOSPHORIC),), 0.069555, 0.0, 7.413, BUCK),
    Buffer("tris hydrochloride 0.05, tris 0.01667", (Acid(0.06667, (8.072,), 1),), 0.0, 0.05, 7.699, BUCK),
    Buffer("borax 0.01", (Acid(0.04, (9.237,)),), 0.02, 0.0, 9.180, BUCK),
    Buffer("NaHCO3 0.025, Na2CO3 0.025", (Acid(0.05, CARBONIC),), 0.075, 0.0, 10.012, STAPLES),
)


def forms(acid: Acid, hydrogen_activity: float, gamma: dict[int, float]) -> list[tuple[int, float]]:
    """Return (charge, mol/kg) of each form of an acid."""
    weights, product = [], 1.0
    for lost in range(len(acid.pka) + 1):
        if lost:
            product *= 10.0 ** -acid.pka[lost - 1] / hydrogen_activity
        charge = acid.charge - lost
        weights.append((charge, product * gamma[acid.charge] / gamma[charge]))
    whole = sum(weight for _, weight in weights)
    return [(charge, acid.total * weight / whole) for charge, weight in weights]


def ph(buffer: Buffer, activities: bool) -> float:
    """Return pH = -log10 a(H+) from the charge balance."""
    strength = 0.1

    def gammas() -> dict[int, float]:
        root = math.sqrt(strength)
        exponent = -_DEBYE_HUECKEL * (root / (1.0 + root) - 0.3 * strength) if activities else 0.0
        return {z: 10.0 ** (exponent * z * z) for z in range(-4, 3)}

    def charges(value: float) -> list[tuple[int, float]]:
        activity, gamma = 10.0**-value, gammas()
        found = [(1, activity / gamma[1]), (-1, 10.0 ** (value - PKW) / gamma[-1])]
        found += [(1, buffer.cations), (-1, buffer.anions)]
        return found + [form for acid in buffer.acids for form in forms(acid, activity, gamma)]

    value = 7.0
    for _ in range(200):
        value = float(brentq(lambda v: sum(z * mol for z, mol in charges(v)), 0.0, 14.0, xtol=1e-12))
        found = 0.5 * sum(z * z * mol for z, mol in charges(value))
        if abs(found - strength) < 1e-12:
            break
        strength = found
    return value


def main() -> None:
    """Write the table and print it."""
    rows = []
    for buffer in BUFFERS:
        made = [ph(buffer, activities) for activities in (True, False)]
        pka = " ".join(f"{value:g}" for acid in buffer.acids for value in acid.pka)
        rows.append((buffer.name, pka, buffer.ph, *made, buffer.source))
    write("acids.csv", ("buffer_mol_kg", "pka", "assigned", "davies", "ideal", "source"), rows)
    for row in rows:
        print("{:48s}{:22s}{:8.3f}{:8.3f}{:8.3f}".format(*row[:5]))


if __name__ == "__main__":
    main()
