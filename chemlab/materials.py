"""Materials: cited properties as data, and the arrays that kernels read.

A material is one table in a TOML file of ``chemlab/data/materials`` (or of a user's own folder);
adding one needs no code. Quantities: mol, g/mol, kg/L, J/mol/K, K, J/mol.
"""

from __future__ import annotations

import functools
import os.path
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from .datafile import DataError, read_toml, validated

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
    "boiling_point_k",
    "vaporization_enthalpy_j_mol",
    "polarity",
)
_FILES = 100

Text = Annotated[str, Field(min_length=1, max_length=200)]
"""A name or a formula."""
Count = Annotated[float, Field(ge=0.001, le=10_000.0)]


class AbsorptionPeak(BaseModel):
    """One Gaussian peak of a UV-Vis spectrum: ``height * exp(-((x - center) / width)**2 / 2)``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    height_l_mol: float = Field(gt=0.0, le=1.0)
    """Absorption per mol/L at the centre (dimensionless per mol/L)."""
    center_nm: float = Field(ge=100.0, le=1000.0)
    width_nm: float = Field(ge=0.1, le=200.0)


class Material(BaseModel):
    """One material's properties at 298.15 K and 101.325 kPa; every number has a ``source``.

    Ions carry the density, heat capacity and boiling point that make dissolving their parent salt leave
    volume and heat content unchanged.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

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
    """No law of the paper's physics reads it, so a material may do without; if given, it is cited and below the boiling
    point (but for gases, which may sublime)."""
    boiling_point_k: float = Field(ge=1.0, le=7000.0)
    vaporization_enthalpy_j_mol: float = Field(ge=1.0, le=1e6)
    polarity: float = Field(ge=0.0, le=2.0)
    """Reichardt's normalized solvent polarity E_T^N; above 1 for ions."""
    role: Role
    color: str = Field(pattern=r"^#[0-9a-fA-F]{6}$")
    shade: float = Field(ge=0.0, le=1.0)
    """Grey value the layer camera shows for this material."""
    absorption: tuple[AbsorptionPeak, ...] = Field(default=(), max_length=50)
    source: dict[Text, str] = Field(max_length=50)
    """Where each number is from, by its key."""

    @model_validator(mode="after")
    def _physical(self) -> Material:
        melting = self.melting_point_k
        if melting is not None and self.boiling_point_k <= melting and self.role != "gas":
            raise ValueError(f"boiling_point_k = {self.boiling_point_k} must be above melting_point_k = {melting}")
        if (self.role == "ion") != (self.charge != 0):
            raise ValueError(f"role {self.role!r} does not fit charge {self.charge}: ions, and only ions, are charged")
        cited = [*_CITED, *(["melting_point_k"] if melting is not None else [])]
        missing = [key for key in cited if not self.source.get(key)]
        if missing:
            raise ValueError(f"source must cite {', '.join(missing)}")
        return self


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
        files = sorted(given.glob("*.toml")) if os.path.isdir(given) else [given]
        if len(files) > _FILES:
            raise DataError(f"{given}: has {len(files)} .toml files; at most {_FILES}")
        for path in files:
            for key, values in read_toml(path).items():
                if not isinstance(values, dict):
                    raise DataError(f"{path}: {key}: a material is a table [{key}], given {values!r:.100}")
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
