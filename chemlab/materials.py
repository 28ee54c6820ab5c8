"""Materials: cited properties as data, and the arrays that kernels read.

A material is one table in a TOML file of ``chemlab/data/materials`` (or of a user's own folder);
adding one needs no code. Quantities: mol, g/mol, kg/L, J/mol/K, K, J/mol.
"""

from __future__ import annotations

import functools
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "AbsorptionPeak",
    "DataError",
    "Material",
    "Role",
    "atoms_of",
    "load_materials",
    "read_toml",
    "shipped_materials",
    "validated",
]

Role = Literal["solvent", "solute", "ion", "solid", "gas"]

_CITED = (
    "molar_mass_g_mol",
    "density_kg_l",
    "heat_capacity_j_mol_k",
    "melting_point_k",
    "boiling_point_k",
    "vaporization_enthalpy_j_mol",
    "polarity",
)


class DataError(ValueError):
    """A data file (material, reaction, scenario) is wrong; the message names file, key, value and bound."""


class AbsorptionPeak(BaseModel):
    """One Gaussian peak of a UV-Vis spectrum: ``height * exp(-((x - center) / width)**2 / 2)``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    height_l_mol: float = Field(gt=0.0, le=1.0)
    """Absorption per mol/L at the centre (dimensionless per mol/L)."""
    center_nm: float = Field(ge=100.0, le=1000.0)
    width_nm: float = Field(gt=0.0, le=200.0)


class Material(BaseModel):
    """One material's properties at 298.15 K and 101.325 kPa; every number has a ``source``.

    Ions carry the density, heat capacity and boiling point that make dissolving their parent salt leave
    volume and heat content unchanged.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(min_length=1)
    formula: str = Field(min_length=1)
    composition: dict[str, float]
    """Element (or, for fictitious materials, pseudo-element) counts per formula unit."""
    charge: int = 0
    cas: str | None = Field(default=None, pattern=r"^\d{2,7}-\d{2}-\d$")
    smiles: str | None = None
    molar_mass_g_mol: float = Field(gt=0.0, le=1000.0)
    density_kg_l: float = Field(gt=0.0, le=25.0)
    heat_capacity_j_mol_k: float = Field(gt=0.0, le=2000.0)
    melting_point_k: float = Field(gt=0.0, le=5000.0)
    boiling_point_k: float = Field(gt=0.0, le=7000.0)
    vaporization_enthalpy_j_mol: float = Field(gt=0.0, le=1e6)
    polarity: float = Field(ge=0.0, le=2.0)
    """Reichardt's normalized solvent polarity E_T^N; above 1 for ions."""
    role: Role
    color: str = Field(pattern=r"^#[0-9a-fA-F]{6}$")
    shade: float = Field(ge=0.0, le=1.0)
    """Grey value the layer camera shows for this material."""
    absorption: tuple[AbsorptionPeak, ...] = ()
    source: dict[str, str]

    @model_validator(mode="after")
    def _physical(self) -> Material:
        if self.boiling_point_k <= self.melting_point_k and self.role != "gas":
            raise ValueError(
                f"boiling_point_k = {self.boiling_point_k} must be above melting_point_k = {self.melting_point_k}"
            )
        if not self.composition or min(self.composition.values()) <= 0.0:
            raise ValueError("composition must give a positive count for at least one element")
        if (self.role == "ion") != (self.charge != 0):
            raise ValueError(f"role {self.role!r} does not fit charge {self.charge}: ions, and only ions, are charged")
        missing = [key for key in _CITED if not self.source.get(key)]
        if missing:
            raise ValueError(f"source must cite {', '.join(missing)}")
        return self


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; a missing or malformed file is a :class:`DataError` that names it."""
    try:
        with path.open("rb") as handle:
            return tomllib.load(handle)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: not valid TOML: {error}") from error


def describe_validation(error: ValidationError, where: str) -> str:
    """Turn a pydantic error into lines ``where: key: problem (given value)``."""
    lines = []
    for item in error.errors(include_url=False):
        key = ".".join(str(part) for part in item["loc"]) or "(whole entry)"
        message = re.sub(r"^Value error, ", "", item["msg"])
        given = item.get("input")
        shown = "" if isinstance(given, (dict, list, BaseModel)) or item["type"] == "missing" else f", given {given!r}"
        lines.append(f"{where}: {key}: {message}{shown}")
    return "\n".join(lines)


def validated(model: type[BaseModel], values: Mapping[str, Any], where: str) -> Any:
    """Build ``model`` from ``values``; failures become a :class:`DataError` naming ``where`` and the key."""
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        raise DataError(describe_validation(error, where)) from error


def load_materials(paths: Iterable[Path]) -> dict[str, Material]:
    """Read material files into ``{id: Material}``.

    Args:
        paths: TOML files, one table a material; a folder stands for the ``*.toml`` files in it.

    Raises:
        DataError: a file is missing or malformed, a key is unknown, a value is out of bounds, or two
            files define the same material.
    """
    materials: dict[str, Material] = {}
    origin: dict[str, Path] = {}
    for given in paths:
        for path in sorted(given.glob("*.toml")) if given.is_dir() else [given]:
            for key, values in read_toml(path).items():
                if not isinstance(values, dict):
                    raise DataError(f"{path}: {key}: a material is a table [{key}], given {values!r}")
                if key in materials:
                    raise DataError(f"{path}: {key}: already defined in {origin[key]}; rename one of them")
                materials[key] = validated(Material, values, f"{path}: {key}")
                origin[key] = path
    return materials


@functools.lru_cache(maxsize=1)
def shipped_materials() -> dict[str, Material]:
    """The materials that come with chemlab, by id."""
    return load_materials([Path(__file__).parent / "data" / "materials"])


def atoms_of(counts: Mapping[str, float], materials: Mapping[str, Material]) -> dict[str, float]:
    """Element totals (plus the net charge under ``"charge"``) of ``{material: amount}``."""
    totals: dict[str, float] = {"charge": 0.0}
    for key, amount in counts.items():
        for element, number in materials[key].composition.items():
            totals[element] = totals.get(element, 0.0) + amount * number
        totals["charge"] += amount * materials[key].charge
    return totals
