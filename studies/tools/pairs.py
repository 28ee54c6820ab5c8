"""Make the bundled pair file ``chemlab/data/pairs`` from UNIFAC and ``studies/tools/solubilities.toml``.

    python studies/tools/pairs.py                     # the bundled file, of all bundled molecules
    python studies/tools/pairs.py toluene cumene --materials my_materials.toml --out my_pairs.toml

Needs the extra ``chem``. The method is described in :mod:`chemlab.openchem.activity`; ``chemlab data pairs`` makes
pairs of your own materials. Measured pairs are fitted to the measurements instead. Ten rows of the bundled file, of
acetanilide with alkanes and salicylic acid, and of pyrrolidine with acids, are older than the check of how far a form
extrapolates; their form fails it, and making the file anew changes them.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from chemlab.config.datafile import DataError, read_toml
from chemlab.config.materials import Material, load_materials, shipped_materials
from chemlab.openchem.activity import Fit, best_form, is_molecule, make_pairs, nrtl, pair_row
from chemlab.openchem.fits import FINE, Array, stable
from chemlab.openchem.writing import pair_text
from chemlab.physics.constants import GAS_CONSTANT

HERE = Path(__file__).resolve().parent
SHIPPED = HERE.parents[1] / "chemlab" / "data" / "pairs" / "unifac.toml"
SOLUBILITIES = HERE / "solubilities.toml"

_MEASURED_ALPHAS = (0.2, 0.3, 0.4, 0.47)
_SHAPE = 0.02
"""Weight of UNIFAC's ln gamma of the solvent relative to a measured solubility."""
_SMALL = 0.01
"""Weight of the parameters' size in that fit."""
_MADE_UP = 0.1
"""Score of a temperature with a spurious second liquid."""


@dataclass(frozen=True)
class Measured:
    """Solubilities of one material in another: mole fractions by temperature."""

    solute: str
    solvent: str
    temperature_k: Array
    mole_fraction: Array
    source: str


@dataclass(frozen=True)
class Mutual:
    """Mutual solubility of two liquids: mole fractions by temperature."""

    first: str
    second: str
    temperature_k: Array
    first_in_second: Array
    second_in_first: Array
    source: str


def measured_pairs(path: Path) -> dict[frozenset[str], Measured | Mutual]:
    """Return measurements by pair.

    They are the tables ``solubility`` and ``mutual`` of a file, with the keys of :class:`Measured` and :class:`Mutual`.
    """
    out: dict[frozenset[str], Measured | Mutual] = {}
    tables = read_toml(path)
    for row in [*tables["solubility"], *tables["mutual"]]:
        arrays: dict[str, Any] = {k: np.array(v) if isinstance(v, list) else v for k, v in row.items()}
        made = Measured(**arrays) if "solute" in row else Mutual(**arrays)
        out[frozenset((made.solute, made.solvent) if isinstance(made, Measured) else (made.first, made.second))] = made
    return out


def ideal_solubility(material: Material, temperature_k: Array) -> Array:
    """Return ln of the ideal solubility as a mole fraction: -dHfus / R (1 / T - 1 / Tm)."""
    assert material.real is not None
    assert material.real.fusion_enthalpy_j_mol is not None
    assert material.melting_point_k is not None
    heat = material.real.fusion_enthalpy_j_mol / GAS_CONSTANT
    return np.asarray(-heat * (1.0 / temperature_k - 1.0 / material.melting_point_k))


def fit_measured(measured: Measured, solute: Material, log_gamma: Array) -> Fit:
    """Fit NRTL parameters to measured solubilities.

    Parameters are otherwise small and depend mostly on temperature. If the two do not mix, the solvent has UNIFAC's
    ``log_gamma`` (of solute and solvent) as far as the measurements allow. The error is that of the measured ln gamma.
    """
    temperature, x = measured.temperature_k, measured.mole_fraction
    wanted = ideal_solubility(solute, temperature) - np.log(x)
    near = (FINE.temperatures_k > 275.0) & (FINE.temperatures_k < 400.0)
    one_liquid = stable(log_gamma)
    kept = one_liquid[near]
    apart = 0.0 if one_liquid.all() else _SHAPE
    scale = np.array([0.3, 0.3, 300.0, 300.0])

    def off(p: Array, alpha: float) -> Array:
        return np.array([nrtl(p, alpha, temperature[i : i + 1], x[i : i + 1])[0, 0, 0] for i in range(len(x))]) - wanted

    scored: list[tuple[float, Fit]] = []
    for alpha in _MEASURED_ALPHAS:

        def residuals(p: Array, alpha: float = alpha) -> Array:
            full = np.array([*p, 0.0, 0.0])
            shape = nrtl(full, alpha, FINE.temperatures_k[near], FINE.fractions)[..., 1] - log_gamma[near][..., 1]
            return np.concatenate([off(full, alpha), apart * np.where(kept, shape, 0.0).ravel(), _SMALL * p / scale])

        found = least_squares(residuals, np.array([0.1, 0.1, 100.0, 100.0]), x_scale=scale, max_nfev=500)
        parameters = np.array([*found.x, 0.0, 0.0])
        made_up = np.any(one_liquid & ~stable(nrtl(parameters, alpha, FINE.temperatures_k, FINE.fractions)), axis=1)
        made = Fit(parameters, alpha, float(np.abs(off(parameters, alpha)).max()))
        scored.append((float(found.cost) + _MADE_UP * int(np.sum(made_up & np.all(one_liquid, axis=1))), made))
    return min(scored, key=lambda pair: pair[0])[1]


def fit_mutual(mutual: Mutual, alpha: float = 0.2) -> Fit:
    """Fit NRTL parameters that give both liquids equal activities in the two layers.

    Renon and Prausnitz propose this alpha for immiscible liquids. The error is that of ln of the activities.
    """
    temperature = mutual.temperature_k
    poor, rich = mutual.first_in_second, 1.0 - mutual.second_in_first
    ideal = np.log(np.stack([poor / rich, (1.0 - poor) / (1.0 - rich)], axis=-1))

    def off(p: Array) -> Array:
        full, out = np.array([*p, 0.0, 0.0]), np.array(ideal)
        for i in range(len(poor)):
            layers = nrtl(full, alpha, temperature[i : i + 1], np.array([poor[i], rich[i]]))[0]
            out[i] += layers[0] - layers[1]
        return out.ravel()

    found = least_squares(off, np.array([0.0, 0.0, 300.0, 1000.0]), x_scale=np.array([1.0, 1.0, 300.0, 300.0]))
    return Fit(np.array([*found.x, 0.0, 0.0]), alpha, float(np.abs(off(found.x)).max()))


def measured_row(row: dict[str, Any], given: Measured | Mutual, materials: Mapping[str, Material]) -> dict[str, Any]:
    """Return the row of a pair that was measured, given that of UNIFAC."""
    chosen = best_form((row["of"][0], row["of"][1]), materials)
    if chosen is None:
        return row
    low, high = float(given.temperature_k.min()) - 15.0, float(given.temperature_k.max()) + 15.0
    if isinstance(given, Mutual):
        source = f"mutual solubilities: {given.source}"
        return pair_row((given.first, given.second), fit_mutual(given), low, high, source)
    form, both = chosen
    log_gamma = form.log_gamma(both)
    if given.solute != row["of"][0]:
        log_gamma = log_gamma[:, ::-1, ::-1]
    found = fit_measured(given, materials[given.solute], log_gamma)
    return pair_row((given.solute, given.solvent), found, low, high, f"solubility of {given.solute}: {given.source}")


def main() -> None:
    """Fit the requested pairs and write them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="materials; without any, all shipped molecules")
    parser.add_argument("--materials", type=Path, action="append", default=[], help="material file of your own")
    parser.add_argument("--out", type=Path, default=None, help="pair file to write (default: the shipped one)")
    arguments = parser.parse_args()
    if arguments.names and arguments.out is None:
        parser.error("--out: required if materials are named")
    materials = {**shipped_materials(), **load_materials(arguments.materials)}
    names = arguments.names or sorted(name for name, m in shipped_materials().items() if is_molecule(m))
    pairs = list(itertools.combinations(names, 2))

    def tell(done: int) -> None:
        print(f"\r{done} of {len(pairs)} pairs", end="", file=sys.stderr, flush=True)

    measured = measured_pairs(SOLUBILITIES)
    rows = [
        measured_row(row, measured[frozenset(row["of"])], materials) if frozenset(row["of"]) in measured else row
        for row in make_pairs(pairs, materials, tell, ideal=True)
    ]
    print(file=sys.stderr)
    output = arguments.out or SHIPPED
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(pair_text(rows, " ".join(["python studies/tools/pairs.py", *arguments.names])), encoding="utf-8")
    print(f"{output}: {len(rows)} pairs; largest error of ln gamma {max(row['error'] for row in rows):.2f}")


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        sys.exit(str(error))
