"""Materials: cited properties as data, with validation.

A material is one table in a TOML file of ``chemlab/data/materials`` (or of a user's folder); adding one needs no code.
Quantities: mol, g/mol, kg/L, J/mol/K, K, J/mol.
"""

from __future__ import annotations

import functools
import math
import os.path
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from ..kernels.arrays import FloatArray
from .datafile import DataError, read_toml, toml_key
from .datamodel import DataModel, validated

Role = Literal["solvent", "solute", "ion", "solid", "gas"]

_CITED = (
    "molar_mass_g_mol",
    "density_kg_l",
    "heat_capacity_j_mol_k",
    "boiling_point_k",
    "vaporization_enthalpy_j_mol",
)
_FILES = 100
LOCK = "lock"
"""Table of a data file with its origin: the command and versions that made it."""
_ATMOSPHERE_KPA = 101.325
_GAS_CONSTANT = 8.31446261815324
COLDEST_K, HOTTEST_K = 50.0, 5000.0
"""Physical range of temperatures.

Files cannot exceed it, and no vessel leaves it. Rates, vapour pressures and activity coefficients are finite in it.
"""

Text = Annotated[str, Field(min_length=1, max_length=200)]
"""A name or a formula."""
Count = Annotated[float, Field(ge=0.001, le=10_000.0)]


class AbsorptionPeak(DataModel):
    """One Gaussian peak of a UV-Vis spectrum: ``height * exp(-((x - center) / width)**2 / 2)``."""

    height_l_mol: float = Field(gt=0.0, le=1.0)
    """Absorption per mol/L at the centre (dimensionless per mol/L)."""
    center_nm: float = Field(ge=100.0, le=1000.0)
    width_nm: float = Field(ge=0.1, le=200.0)


class VaporPressure(DataModel):
    """Vapour pressure of a liquid as a formula, p in Pa and T in K.

    ``dippr101``, five coefficients: ln p = A + B / T + C ln T + D T^E; ``antoine``, three: log10 p = A - B / (T + C).
    """

    form: Literal["dippr101", "antoine"]
    coefficients: tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...] = Field(min_length=3, max_length=5)
    low_k: float = Field(ge=1.0, le=5000.0)
    high_k: float = Field(ge=1.0, le=5000.0)
    """Upper end of the formula's range, which begins at ``low_k``."""

    @model_validator(mode="after")
    def _sound(self) -> VaporPressure:
        number = {"dippr101": 5, "antoine": 3}[self.form]
        if len(self.coefficients) != number:
            raise ValueError(f"coefficients: {self.form} has {number}, given {len(self.coefficients)}")
        if self.low_k + 0.5 > self.high_k:
            raise ValueError(f"high_k = {self.high_k} must exceed low_k = {self.low_k} by at least 0.5")
        if self.form == "antoine" and self.low_k + self.coefficients[2] <= 0.0:
            raise ValueError(f"low_k = {self.low_k} is beyond the pole of the Antoine equation")
        with np.errstate(all="ignore"):
            inside = self._log(np.linspace(self.low_k, self.high_k, 100))
        if not np.isfinite(inside).all() or (np.diff(inside) <= 0.0).any() or np.abs(inside).max() > 100.0:
            raise ValueError("must rise with temperature from low_k to high_k, and stay within e^-100 and e^100 Pa")
        return self

    def _log(self, temperature: FloatArray) -> FloatArray:
        """Return ln(p / Pa) from the formula."""
        if self.form == "antoine":
            a, b, c = self.coefficients
            return np.asarray(math.log(10.0) * (a - b / (temperature + c)))
        a, b, c, d, e = self.coefficients
        return np.asarray(a + b / temperature + c * np.log(temperature) + d * temperature**e)

    def pascal(self, temperature_k: FloatArray | float) -> FloatArray:
        """Return the vapour pressure.

        Args:
            temperature_k: K, of any shape. Below ``low_k`` and above ``high_k``, ln p is extrapolated linearly in 1 / T
                (Clausius-Clapeyron with the heat of vaporization at that end).

        Returns:
            Pa, in the given shape.
        """
        temperature = np.asarray(temperature_k, dtype=np.float64)
        inside = np.clip(temperature, self.low_k, self.high_k)
        at_end, step = inside, 0.1
        inward = np.where(inside - self.low_k < self.high_k - inside, step, -step)
        slope = (self._log(at_end + inward) - self._log(at_end)) / (1.0 / (at_end + inward) - 1.0 / at_end)
        return np.asarray(np.exp(self._log(at_end) + slope * (1.0 / temperature - 1.0 / at_end)))

    def heat(self, temperature_k: float) -> float:
        """Return the heat of vaporization in J/mol to an ideal gas by the slope of the curve (Clausius-Clapeyron)."""
        low, high = 0.999 * temperature_k, 1.001 * temperature_k
        return float(_GAS_CONSTANT * np.log(self.pascal(high) / self.pascal(low)) / (1.0 / low - 1.0 / high))


class Dimerization(DataModel):
    """Dimers in a vapour, 2 A = A2.

    Their pressure is K times the square of the monomers' pressure, in atmospheres, with ln K = (entropy - enthalpy / T)
    / R.
    """

    enthalpy_j_mol: float = Field(ge=-2e5, le=-1e3)
    """Enthalpy of dimerization per mol of dimers."""
    entropy_j_mol_k: float = Field(ge=-500.0, le=0.0)

    def log_root_constant(self) -> tuple[float, float]:
        """Return a and b (K) of ln sqrt(K) = a + b / T, with K in 1/kPa."""
        a = 0.5 * (self.entropy_j_mol_k / _GAS_CONSTANT - math.log(_ATMOSPHERE_KPA))
        return a, -0.5 * self.enthalpy_j_mol / _GAS_CONSTANT

    def monomer(self, temperature_k: FloatArray, pressure_kpa: FloatArray) -> FloatArray:
        """Return the pressure of the monomers in kPa in a pure vapour of ``pressure_kpa``."""
        a, b = self.log_root_constant()
        constant = np.exp(2.0 * (a + b / temperature_k))
        return np.asarray(2.0 * pressure_kpa / (1.0 + np.sqrt(1.0 + 4.0 * constant * pressure_kpa)))


class RealProperties(DataModel):
    """Properties of a material for the physics backend ``real``; every number has a ``source``."""

    vapor_pressure: VaporPressure | None = None
    """Vapour pressure of the liquid, also for materials that are solid when pure; None: non-volatile.

    The heat of vaporization at the boiling point is that of the material.
    """
    critical_temperature_k: float | None = Field(default=None, ge=1.0, le=10_000.0)
    """Critical temperature, for the temperature dependence of the heat of vaporization (Watson 1943)."""
    formation_enthalpy_j_mol: float = Field(ge=-1e7, le=1e7)
    """Enthalpy of formation from the elements at 298.15 K and 1 bar."""
    formation_state: Literal["l", "s", "g", "aq"]
    """State of the formation enthalpy: liquid, solid, gas, or the ion in water at infinite dilution (with H+ at 0)."""
    fusion_enthalpy_j_mol: float | None = Field(default=None, ge=1.0, le=1e6)
    """Heat of fusion at the melting point; None: the material does not crystallize."""
    dimerization: Dimerization | None = None
    """Dimers in the vapour of carboxylic acids; the vapour pressure is that of monomers and dimers together."""
    source: dict[Text, str] = Field(max_length=50)
    """Source of each number, by key."""

    @model_validator(mode="after")
    def _cited(self) -> RealProperties:
        optional = ("vapor_pressure", "critical_temperature_k", "fusion_enthalpy_j_mol", "dimerization")
        cited = ["formation_enthalpy_j_mol", *(key for key in optional if getattr(self, key) is not None)]
        missing = [key for key in cited if not self.source.get(key)]
        if missing:
            raise ValueError(f"source must cite {', '.join(missing)}")
        if self.vapor_pressure is not None and self.critical_temperature_k is None:
            raise ValueError("critical_temperature_k is required with vapor_pressure, for the heat of vaporization")
        if self.dimerization is not None and self.vapor_pressure is None:
            raise ValueError("dimerization: requires vapor_pressure")
        return self


_BOILING_ERROR = 0.1
"""Allowed relative deviation of a vapour pressure from 101.325 kPa at the boiling point, equivalent to 3 K."""


_HEAT_ERROR = 0.3
"""Allowed relative deviation of the slope of a vapour pressure from the heat of vaporization, at the boiling point."""


class Material(DataModel):
    """Properties of one material at 298.15 K and 101.325 kPa; every number has a ``source``.

    Density, heat capacity and boiling point of ions are chosen so that dissolution of their salt conserves volume and
    heat content.
    """

    name: Text
    formula: Text
    composition: dict[Text, Count] = Field(min_length=1, max_length=50)
    """Element (or, for fictitious materials, pseudo-element) counts per formula unit."""
    charge: int = Field(default=0, ge=-10, le=10)
    cas: str | None = Field(default=None, pattern=r"^\d{2,7}-\d{2}-\d$")
    smiles: str | None = Field(default=None, max_length=1000)
    molar_mass_g_mol: float = Field(ge=0.1, le=1000.0)
    density_kg_l: float = Field(ge=1e-5, le=25.0)
    heat_capacity_j_mol_k: float = Field(ge=1.0, le=2000.0)
    melting_point_k: float | None = Field(default=None, ge=0.1, le=5000.0)
    """Melting point, below the boiling point except for gases, which may sublime.

    It is optional, because the backend ``paper`` does not use it; if given, it needs a source.
    """
    boiling_point_k: float = Field(ge=1.0, le=7000.0)
    """Boiling point, at least :data:`COLDEST_K` for materials that can be liquid in a vessel."""
    vaporization_enthalpy_j_mol: float = Field(ge=1.0, le=1e6)
    polarity: float | None = Field(default=None, ge=0.0, le=2.0)
    """Reichardt's normalized solvent polarity E_T^N; above 1 for ions. Only the backend ``paper`` uses it, and
    requires it.
    """
    role: Role
    color: str = Field(pattern=r"^#[0-9a-fA-F]{6}$")
    shade: float = Field(ge=0.0, le=1.0)
    """Grey value of the material in the layer camera."""
    absorption: tuple[AbsorptionPeak, ...] = Field(default=(), max_length=50)
    source: dict[Text, str] = Field(max_length=50)
    """Source of each number, by key."""
    real: RealProperties | None = None
    """Properties for the backend ``real``, which requires them; the backend ``paper`` ignores them."""

    @model_validator(mode="after")
    def _physical(self) -> Material:
        melting = self.melting_point_k
        if melting is not None and self.boiling_point_k <= melting and self.role != "gas":
            raise ValueError(f"boiling_point_k = {self.boiling_point_k} must be above melting_point_k = {melting}")
        if self.role in ("solvent", "solute") and not self.boiling_point_k >= COLDEST_K:
            raise ValueError(
                f"boiling_point_k = {self.boiling_point_k} must be at least {COLDEST_K:g} K, the coldest of "
                f"vessels, for role {self.role!r}; use the role 'gas' for lower boiling points"
            )
        if (self.role == "ion") != (self.charge != 0):
            raise ValueError(f"role {self.role!r} does not fit charge {self.charge}: only ions must be charged")
        optional = [key for key in ("melting_point_k", "polarity") if getattr(self, key) is not None]
        missing = [key for key in (*_CITED, *optional) if not self.source.get(key)]
        if missing:
            raise ValueError(f"source must cite {', '.join(missing)}")
        if self.real is not None:
            self._check_real(self.real)
        return self

    def _check_real(self, real: RealProperties) -> None:
        """Check that properties of the backend ``real`` are consistent with the others."""
        if (real.formation_state == "aq") != (self.role == "ion"):
            raise ValueError(f"real.formation_state = {real.formation_state!r} does not fit role {self.role!r}")
        if real.fusion_enthalpy_j_mol is not None and self.melting_point_k is None:
            raise ValueError("real.fusion_enthalpy_j_mol needs melting_point_k")
        if real.critical_temperature_k is not None and real.critical_temperature_k <= self.boiling_point_k:
            raise ValueError(
                f"real.critical_temperature_k = {real.critical_temperature_k} must be above "
                f"boiling_point_k = {self.boiling_point_k}"
            )
        if real.vapor_pressure is not None:
            boiling = float(real.vapor_pressure.pascal(self.boiling_point_k)) / 1000.0
            if abs(boiling / _ATMOSPHERE_KPA - 1.0) > _BOILING_ERROR:
                raise ValueError(
                    f"real.vapor_pressure is {boiling:.4g} kPa at boiling_point_k = {self.boiling_point_k}; "
                    f"must be {_ATMOSPHERE_KPA} kPa within {_BOILING_ERROR:.0%}"
                )
            heat = real.vapor_pressure.heat(self.boiling_point_k)
            if real.dimerization is None and abs(heat / self.vaporization_enthalpy_j_mol - 1.0) > _HEAT_ERROR:
                raise ValueError(
                    f"vaporization_enthalpy_j_mol = {self.vaporization_enthalpy_j_mol:g}, and real.vapor_pressure "
                    f"rises at boiling_point_k = {self.boiling_point_k} as by {heat:.0f} J/mol; must agree within "
                    f"{_HEAT_ERROR:.0%}; give a boiling point, a heat and a vapour pressure that belong together"
                )


Materials = Mapping[str, Material]
"""Materials by id."""


def load_materials(paths: Iterable[Path]) -> dict[str, Material]:
    """Read material files into ``{id: Material}``.

    Args:
        paths: TOML files with one table per material; a folder represents its ``*.toml`` files. A table ``lock`` states
            the origin of the file and is not a material.

    Raises:
        DataError: a file is missing or malformed, a key is unknown, a value is out of bounds, or two files define the
            same material.
    """
    materials: dict[str, Material] = {}
    origin: dict[str, Path] = {}
    for given in paths:
        files = sorted(given.glob("*.toml")) if os.path.isdir(given) else [given]
        if len(files) > _FILES:
            raise DataError(f"{given}: has {len(files)} .toml files; at most {_FILES}")
        for path in files:
            for key, values in read_toml(path).items():
                if key == LOCK:
                    validated(dict[str, str], values, f"{path}: {LOCK}")
                    continue
                if not isinstance(values, dict):
                    raise DataError(f"{path}: {key}: must be a table [{toml_key(key)}], given {values!r:.100}")
                if key in materials:
                    raise DataError(f"{path}: {key}: already defined in {origin[key]}; rename one of them")
                materials[key] = validated(Material, values, f"{path}: {key}")
                origin[key] = path
    return materials


@functools.lru_cache(maxsize=1)
def shipped_materials() -> dict[str, Material]:
    """Return the bundled materials by id."""
    return load_materials([Path(__file__).parent.parent / "data" / "materials"])


def atoms_of(counts: Mapping[str, float], materials: Materials) -> dict[str, float]:
    """Return element totals (and the net charge under ``"charge"``) of ``{material: amount}``."""
    totals: dict[str, float] = {"charge": 0.0}
    for key, amount in counts.items():
        for element, number in materials[key].composition.items():
            totals[element] = totals.get(element, 0.0) + amount * number
        totals["charge"] += amount * materials[key].charge
    return totals


def litres_of(contents: Mapping[str, float], materials: Materials) -> float:
    """Return the volume in L of ``{material: mol}``, unmixed."""
    found = ((mol, materials[key]) for key, mol in contents.items())
    return sum(mol * one.molar_mass_g_mol / one.density_kg_l / 1000.0 for mol, one in found)
