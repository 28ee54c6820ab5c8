"""A hundred everyday names in a flask against handbooks, and ten mixtures: ``python studies/physics/everyday.py``.

Writes ``everyday.csv``, ``everyday_mixtures.csv`` and the table in ``docs/chemist/distillation.md``. Judges are the CRC
Handbook's boiling points and the VDI Heat Atlas' densities, as the package chemicals has them, and for mixtures the
NRTL parameters of ChemSep, which are fits to measured equilibria (package thermo). The mixtures are drawn by lot from
those of ChemSep whose substances the catalogue has, and whose data in chemlab were fitted to no measurement.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import azeotropes
import chemicals
import numpy as np
import thermo
from mixtures import ATMOSPHERE_PA, HERE, write
from scipy.optimize import brentq

from chemlab.config.catalogue import FOLDER, catalogue_pairs
from chemlab.config.files import replace_between
from chemlab.config.pairs import shipped_pairs
from chemlab.sandbox import Flask

LOT, MIXTURES, KELVIN = 47, 10, 1.0
"""Seed of the lot, number of mixtures, and the largest error that is met."""


class Row(NamedTuple):
    """A name; NaN where a handbook has nothing, or a flask does not boil."""

    name: str
    material: str
    boils_k: float
    handbook_k: float
    density: float
    handbook_density: float


def boiling_point(key: str) -> float:
    """K at which a mole of it boils in a flask; NaN if 240 kJ do not make it boil."""
    flask = Flask({key: 1.0}, capacity_l=3.0)
    for _ in range(60):
        flask.heat(4e3)
        if flask.waste.get(key, 0.0) > 1e-3:
            return flask.temperature_k
    return math.nan


def names() -> list[str]:
    """The names: the first column of the table. The first thirty were tried before the catalogue was made."""
    with (HERE / "everyday.csv").open(encoding="utf-8", newline="") as file:
        return [row["name"] for row in csv.DictReader(file)]


def rows() -> Iterator[Row]:
    """Every name."""
    for name in names():
        flask = Flask({"Water": 30.0, name: 0.1})  # "Water", so that the name may be "water"
        held = [key for key, mol in flask.amounts.items() if mol > 0.0 and key != "water"]
        key = "water" if flask.amounts["water"] > 30.05 else held[0]
        material = Flask.material(key)
        cas = material.cas or ""
        boils = chemicals.Tb(cas, method="CRC_ORG") if cas and "CRC_ORG" in chemicals.Tb_methods(cas) else None
        other = (material.melting_point_k or 0.0) < 298.15 and "[VDI_PPDS]" not in material.source["density_kg_l"]
        liquid: Any = thermo.VolumeLiquid(CASRN=cas)
        dense = liquid.calculate(298.15, "VDI_PPDS") if other and "VDI_PPDS" in liquid.all_methods else None
        yield Row(
            name,
            key if len(held) < 2 else " + ".join(held),
            boiling_point(key) if boils else math.nan,
            boils or math.nan,
            1.0 / Flask({key: 1000.0 / material.molar_mass_g_mol}, capacity_l=3.0).volume_l if dense else math.nan,
            material.molar_mass_g_mol / dense / 1e6 if dense else math.nan,
        )


def drawn() -> list[tuple[str, str]]:
    """The mixtures, by keys of the catalogue."""
    table: Any = thermo.interaction_parameters.IPDB.tables["ChemSep NRTL"]
    keys = {Flask.material(path.stem).cas: path.stem for path in sorted(FOLDER.glob("[!_]*.toml"))}
    found = {tuple(sorted(keys[cas] for cas in two.split())) for two in table if all(c in keys for c in two.split())}
    tuned = {frozenset(two[:2]) for two in (*azeotropes.MEASURED, *azeotropes.NONE)} | set(shipped_pairs())
    rows = catalogue_pairs([frozenset(two) for two in found])
    free = [
        two for two in sorted(found) if not {frozenset(two)} & tuned and "azeotrope" not in rows[frozenset(two)].source
    ]
    chosen = np.random.default_rng(LOT).choice(len(free), MIXTURES, replace=False)
    return [(free[i][0], free[i][1]) for i in sorted(chosen.tolist())]


def judged(one: str, other: str, x: float) -> float:
    """K at which a mixture boils by ChemSep's NRTL parameters and thermo's vapour pressures."""
    numbers = [str(Flask.material(key).cas) for key in (one, other)]
    get = thermo.interaction_parameters.IPDB.get_ip_asymmetric_matrix
    b, alpha = (np.array(get("ChemSep NRTL", numbers, kind)) for kind in ("bij", "alphaij"))
    pressures = [thermo.VaporPressure(CASRN=cas, Tb=chemicals.Tb(cas), Tc=chemicals.Tc(cas)) for cas in numbers]

    def excess(temperature: float) -> float:
        gammas = thermo.NRTL(T=temperature, xs=[x, 1.0 - x], tau_bs=b.tolist(), alpha_cs=alpha.tolist()).gammas()
        pure = [float(p.T_dependent_property(temperature)) for p in pressures]
        return math.log((x * gammas[0] * pure[0] + (1.0 - x) * gammas[1] * pure[1]) / ATMOSPHERE_PA)

    return float(brentq(excess, 260.0, 520.0))


def simulated(one: str, other: str, x: float, near_k: float) -> float:
    """K at which a flask with a mixture boils."""

    def excess(temperature: float) -> float:
        flask = Flask({one: x, other: 1.0 - x}, capacity_l=1.0, temperature_k=temperature)
        return math.log(flask.vapor_pressure_kpa / flask.pressure_kpa)

    return float(brentq(excess, near_k - 40.0, near_k + 40.0, xtol=1e-3))


def trial() -> Iterator[tuple[str, str, float, float]]:
    """Each mixture with its largest and its mean error in K, at mole fractions of 0.1 to 0.9."""
    for one, other in drawn():
        errors = []
        for x in np.linspace(0.1, 0.9, 9).tolist():
            expected = judged(one, other, x)
            errors.append(simulated(one, other, x, expected) - expected)
        yield one, other, max(errors, key=abs), float(np.mean(errors))


def main() -> None:
    """Write the tables."""
    found, mixed = list(rows()), list(trial())
    write("everyday.csv", Row._fields, found)
    header = ["one", "other", "largest_error_k", "mean_error_k", "met"]
    write("everyday_mixtures.csv", header, [(*row, abs(row[2]) <= KELVIN) for row in mixed])
    lines = ["| mixture | largest error (K) | mean error (K) | within 1 K |", "|---|---|---|---|"]
    for one, other, most, mean in mixed:
        names = f"{one} and {other}".replace("_", " ")
        lines.append(f"| {names} | {most:+.1f} | {mean:+.1f} | {'yes' if abs(most) <= KELVIN else 'no'} |")
    replace_between(azeotropes.PAGE, "mixtures", lines)
    for what, errors in (
        ("boiling point, K", [(row.boils_k - row.handbook_k, row.name) for row in found if row.boils_k == row.boils_k]),
        (
            "density, %",
            [(100 * (row.density / row.handbook_density - 1), row.name) for row in found if row.density > 0.0],
        ),
    ):
        worst = max(errors, key=lambda pair: abs(pair[0]))
        middle = float(np.median([abs(error) for error, _ in errors]))
        print(f"{what}: {len(errors)} of {len(found)} names, median {middle:.2g}, largest {worst[0]:+.2g} ({worst[1]})")


if __name__ == "__main__":
    main()
