"""Simple distillation by Rayleigh's equation with UNIFAC activity coefficients: recovery in the pot by purity.

    python studies/physics/distillation.py        # writes studies/physics/distillation.csv

dn_i / dV = -y_i, with y_i = x_i gamma_i p_i / P at the bubble point: Lord Rayleigh, Phil. Mag. 4 (1902) 521. Vapour
pressures and activity coefficients are thermo's.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mixtures import Array, bubble_point, write

CHARGES: dict[str, dict[str, float]] = {
    "ether, dodecane": {"diethyl_ether": 4.0, "dodecane": 0.45},
    "ether, 1-chlorohexane, dodecane": {"diethyl_ether": 4.0, "1-chlorohexane": 0.5, "dodecane": 0.25},
    "4-ethyldecane, 5-methylundecane": {"4-ethyldecane": 0.5, "5-methylundecane": 0.5},
    "ethanol, water": {"ethanol": 1.0, "water": 1.0},
    "hexane, toluene": {"hexane": 0.5, "toluene": 0.5},
}
"""Moles in the pot."""
PURITIES = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999, 0.9999)
"""Mole fractions in the pot of the last component named."""
_STEP = 0.004
"""Share of the pot's content that boils off in one Runge-Kutta step."""
_LEAST = 1e-3


def rayleigh(charge: dict[str, float]) -> Iterator[tuple[float, Array]]:
    """Yield (K, mol) of the pot during evaporation."""
    names = list(charge)
    mol = np.array(list(charge.values()))

    def vapor(amounts: Array) -> tuple[float, Array]:
        return bubble_point(names, amounts / amounts.sum())

    temperature, y = vapor(mol)
    yield temperature, mol
    least = _LEAST * float(mol.sum())
    while mol.sum() > least:
        step = _STEP * float(mol.sum())
        k1 = y
        k2 = vapor(mol - 0.5 * step * k1)[1]
        k3 = vapor(mol - 0.5 * step * k2)[1]
        k4 = vapor(np.maximum(mol - step * k3, 0.0))[1]
        mol = np.maximum(mol - step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), 1e-15)
        temperature, y = vapor(mol)
        yield temperature, mol


def main() -> None:
    """Write the curves, and print the figures used in the backend's design."""
    rows = []
    for title, charge in CHARGES.items():
        names = list(charge)
        start = np.array(list(charge.values()))
        path = list(rayleigh(charge))
        purity = np.array([mol[-1] / mol.sum() for _, mol in path])
        recovery = np.array([mol[-1] / start[-1] for _, mol in path])
        kelvin = np.array([t for t, _ in path])
        left = np.array([mol.sum() / start.sum() for _, mol in path])
        if purity[-1] > purity[0]:
            for wanted in PURITIES:
                if purity[0] < wanted < purity.max():
                    at = int(np.argmax(purity >= wanted))
                    share = (wanted - purity[at - 1]) / (purity[at] - purity[at - 1])
                    found = [float(v[at - 1] + share * (v[at] - v[at - 1])) for v in (left, recovery, kelvin)]
                    rows.append((title, names[-1], wanted, *found))
        half = [float(np.interp(-0.5, -left, v)) for v in (purity, recovery, kelvin)]
        rows.append((title, names[-1], half[0], 0.5, half[1], half[2]))
    write("distillation.csv", ("charge", "kept", "purity", "left_in_pot", "recovery", "pot_k"), rows)
    for row in rows:
        print(f"{row[0]}: {row[1]} at {row[2]:.4f}: recovery {row[4]:.3f}, pot {row[5]:.1f} K, {row[3]:.3f} left")


if __name__ == "__main__":
    main()
