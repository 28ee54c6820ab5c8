"""Azeotropes of the catalogue's pairs at 101.325 kPa against measured ones: ``python studies/physics/azeotropes.py``.

Writes ``azeotropes.csv`` and the table in ``docs/chemist/distillation.md``. Measured values:
Gmehling et al., Azeotropic Data (2004), and the CRC Handbook, as remembered, not looked up again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from chemlab.config.catalogue import catalogue_pairs
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between, write_text
from chemlab.config.materials import Material
from chemlab.config.pairs import Pair, log_activity_coefficients, pair_table, shipped_pairs
from chemlab.sandbox import Flask

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent.parent / "docs" / "chemist" / "distillation.md"
ATMOSPHERE_KPA = 101.325
KELVIN, FRACTION = 1.0, 0.05
"""Tolerances of temperature and mole fraction."""

MEASURED: tuple[tuple[str, str, float, float], ...] = (
    ("ethanol", "water", 351.3, 0.895),
    ("1-propanol", "water", 360.9, 0.43),
    ("2-propanol", "water", 353.3, 0.685),
    ("tert-butanol", "water", 353.0, 0.646),
    ("tetrahydrofuran", "water", 336.6, 0.82),
    ("1,4-dioxane", "water", 361.0, 0.475),
    ("acetonitrile", "water", 349.4, 0.69),
    ("pyridine", "water", 367.0, 0.24),
    ("formic_acid", "water", 380.8, 0.57),
    ("benzene", "ethanol", 341.2, 0.552),
    ("benzene", "methanol", 331.4, 0.39),
    ("benzene", "cyclohexane", 350.7, 0.54),
    ("toluene", "ethanol", 349.9, 0.19),
    ("cyclohexane", "ethanol", 338.0, 0.56),
    ("hexane", "ethanol", 331.8, 0.668),
    ("ethyl_acetate", "ethanol", 345.0, 0.54),
    ("ethyl_acetate", "methanol", 335.4, 0.29),
    ("ethyl_acetate", "hexane", 338.3, 0.39),
    ("methyl_acetate", "methanol", 326.7, 0.66),
    ("acetone", "methanol", 328.7, 0.79),
    ("acetone", "chloroform", 337.6, 0.35),
    ("acetone", "hexane", 322.9, 0.65),
    ("chloroform", "methanol", 326.6, 0.65),
    ("chloroform", "ethanol", 332.5, 0.84),
    ("dichloromethane", "methanol", 311.0, 0.83),
)
"""Two liquids, K, mole fraction of the first."""
NONE = (("methanol", "water"), ("acetone", "water"), ("benzene", "toluene"), ("acetone", "benzene"))
"""Pairs without an azeotrope."""


class Row(NamedTuple):
    """A pair, measured and by chemlab; NaN where there is no azeotrope."""

    one: str
    other: str
    measured_k: float
    measured_x: float
    model_k: float
    model_x: float

    @property
    def met(self) -> bool:
        """True if the model is within the tolerances, or has no azeotrope where none was measured."""
        if math.isnan(self.measured_k):
            return math.isnan(self.model_k)
        return abs(self.model_k - self.measured_k) <= KELVIN and abs(self.model_x - self.measured_x) <= FRACTION


def _pure(material: Material, temperature: float) -> float:
    assert material.real is not None
    assert material.real.vapor_pressure is not None
    return float(material.real.vapor_pressure.pascal(temperature)) / 1000.0


def bubble_point(names: tuple[str, str], x: float, pair: Pair) -> float:
    """K, at which a mixture of one liquid boils; dimers in the vapour are left out."""
    materials = [Flask.material(name) for name in names]
    table = pair_table(names, {frozenset(names): pair})
    shares = np.array([x, 1.0 - x])

    def excess(temperature: float) -> float:
        gamma = np.exp(log_activity_coefficients(shares, table.tau(temperature), table.alpha))
        pressures = [_pure(material, temperature) for material in materials]
        return math.log(float(np.sum(shares * gamma * pressures)) / ATMOSPHERE_KPA)

    return float(brentq(excess, 250.0, 550.0))


def azeotrope(one: str, other: str) -> tuple[float, float]:
    """Temperature in K and mole fraction of the first where the boiling point has an extreme; NaN without one."""
    names = (one, other)
    key = frozenset(names)
    pair = shipped_pairs().get(key) or catalogue_pairs([key])[key]
    x = np.linspace(0.0, 1.0, 201)
    boils = np.array([bubble_point(names, float(share), pair) for share in x])
    for extreme in (int(np.argmin(boils)), int(np.argmax(boils))):
        if 1 < extreme < len(x) - 2:
            return float(boils[extreme]), float(x[extreme])
    return math.nan, math.nan


def rows() -> Iterator[Row]:
    """Every pair."""
    for one, other, temperature, share in MEASURED:
        yield Row(one, other, temperature, share, *azeotrope(one, other))
    for one, other in NONE:
        yield Row(one, other, math.nan, math.nan, *azeotrope(one, other))


def _shown(number: float, digits: int) -> str:
    return "none" if math.isnan(number) else f"{number:.{digits}f}"


def main() -> None:
    """Write the table."""
    found = list(rows())
    lines = ["one,other,measured_k,measured_x,model_k,model_x,met"]
    columns = "mixture", "measured (K)", "chemlab (K)", "measured (mole fraction)", "chemlab (mole fraction)", "met"
    table = []
    for row in found:
        cells = [_shown(row.measured_k, 1), _shown(row.model_k, 1), _shown(row.measured_x, 2), _shown(row.model_x, 2)]
        lines.append(",".join([f'"{row.one}"', f'"{row.other}"', cells[0], cells[2], cells[1], cells[3], str(row.met)]))
        names = f"{row.one} and {row.other}".replace("_", " ")
        table.append([names, *cells, "yes" if row.met else "no"])
    write_text(HERE / "azeotropes.csv", "\n".join(lines) + "\n")
    replace_between(PAGE, "azeotropes", markdown_table(dict.fromkeys(columns, False), table))
    print(f"{sum(row.met for row in found)} of {len(found)} met")


if __name__ == "__main__":
    main()
