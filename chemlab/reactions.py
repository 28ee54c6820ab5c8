"""Reaction networks as data: stoichiometry, orders and Arrhenius constants, checked for balance.

A reaction family is one TOML file of ``chemlab/data/reactions`` (or a path of the user's): ``[[reaction]]``
entries integrated by the kinetics kernel, ``[[salt]]`` entries taken to their dissolution equilibrium, and
``[[violent]]`` entries that run to completion at once and may be safety events.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from .arrays import FloatArray
from .datafile import DataError, Grown, read_toml, validated
from .materials import Material, Text, atoms_of

__all__ = [
    "Reaction",
    "ReactionFamily",
    "Salt",
    "Solubility",
    "Violent",
    "check_reactions",
    "load_reactions",
    "shipped_reactions_folder",
]

_BALANCE_TOLERANCE = 1e-9
_FROZEN = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

Coefficients = Annotated[
    dict[Text, Annotated[float, Field(ge=0.001, le=100.0)]],
    Field(min_length=1, max_length=20),
]
"""Stoichiometric coefficients of one side, by material."""
Orders = Annotated[dict[Text, Annotated[float, Field(ge=0.01, le=20.0)]], Field(max_length=20)]
"""Orders by reactant; together at most 20."""
_HIGHEST_ORDER = 20.0
"""Of a whole rate law. Observed ones stay below 5; the kernel multiplies as many concentrations at every step."""


class _Balanced(BaseModel):
    """What every kind of reaction has."""

    model_config = _FROZEN

    reactants: Coefficients
    products: Coefficients
    source: str = Field(min_length=1)


class Reaction(_Balanced):
    """One elementary step: rate = A exp(-Ea / RT) * prod(concentration ** order), in mol/L per time unit."""

    orders: Orders = {}
    """Order in each reactant, above 0 since a used-up reactant must stop its reaction; empty means the reactant's own
    coefficient (mass action)."""
    pre_exponential: float = Field(gt=0.0, le=1e30)
    """A, in (L/mol)^(order - 1) per time unit."""
    activation_energy_j_mol: float = Field(ge=0.0, le=500_000.0)

    @model_validator(mode="after")
    def _sound(self) -> Reaction:
        for key in self.orders:
            if key not in self.reactants:
                raise ValueError(f"orders.{key}: not a reactant of this reaction")
        if self.orders and set(self.orders) != set(self.reactants):
            raise ValueError("orders must name every reactant, or none")
        orders = self.orders or dict(self.reactants)
        if sum(orders.values()) > _HIGHEST_ORDER:
            raise ValueError(f"orders: add up to {sum(orders.values()):g}; at most {_HIGHEST_ORDER:g}")
        return self.model_copy(update={"orders": orders})


class Solubility(BaseModel):
    """How much of a salt a kilogram of solvent takes up, by temperature; solvents add up by mass."""

    model_config = _FROZEN

    temperature_k: tuple[Annotated[float, Field(ge=150.0, le=1000.0)], ...] = Field(min_length=1, max_length=50)
    """K, rising; between two of them the solubility is a straight line, beyond the first and the last constant."""
    solvents: dict[Text, tuple[Annotated[float, Field(ge=0.0, le=100.0)], ...]] = Field(min_length=1, max_length=50)
    """mol per kg of each solvent, a number for each temperature."""
    elsewhere_mol_kg: float = Field(default=0.0, ge=0.0, le=100.0)
    """mol per kg of any other solvent, at all temperatures."""
    source: str = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> Solubility:
        if any(cold >= warm for cold, warm in itertools.pairwise(self.temperature_k)):
            raise ValueError(f"temperature_k: must rise, given {list(self.temperature_k)}")
        for name, numbers in self.solvents.items():
            if len(numbers) != len(self.temperature_k):
                raise ValueError(
                    f"solvents.{name}: {len(numbers)} numbers for {len(self.temperature_k)} values of temperature_k"
                )
        return self

    def mol_per_kg(self, solvent: str, temperature_k: FloatArray | float) -> FloatArray:
        """Solubility in one solvent in mol/kg, in the shape of ``temperature_k``."""
        temperature = np.asarray(temperature_k, dtype=np.float64)
        if solvent not in self.solvents:
            return np.full(temperature.shape, self.elsewhere_mol_kg)
        return np.asarray(np.interp(temperature, self.temperature_k, self.solvents[solvent]))


class Salt(Grown):
    """A salt that dissolves as ``solid <-> cation + anion`` (one of each): in the tier ``paper`` in every solvent,
    K = 1 mol/mol, in the tier ``real`` up to its solubility."""

    model_config = _FROZEN
    _later: ClassVar[tuple[str, ...]] = ("solubility",)

    solid: Text
    cation: Text
    anion: Text
    source: str = Field(min_length=1)
    solubility: Solubility | None = None
    """Needed in scenarios of the tier ``real``, and unknown to those of the tier ``paper``."""


class Violent(_Balanced, Grown):
    """A reaction that goes to completion the moment its reactants meet."""

    _later = ("event",)

    event: Text | None = None
    """Safety event that it counts as, by the mol of its first reactant; without one, a solid element that reacts with
    water counts as ``metal_in_water_mol``, and others as none."""


class ReactionFamily(BaseModel):
    """A named set of reactions, salts and violent reactions."""

    model_config = _FROZEN

    name: Text
    summary: str = ""
    reaction: tuple[Reaction, ...] = Field(default=(), max_length=200)
    salt: tuple[Salt, ...] = Field(default=(), max_length=50)
    violent: tuple[Violent, ...] = Field(default=(), max_length=50)

    def materials(self) -> set[str]:
        """Every material this family names."""
        found = {name for salt in self.salt for name in (salt.solid, salt.cation, salt.anion)}
        for step in (*self.reaction, *self.violent):
            found |= set(step.reactants) | set(step.products)
        return found


def shipped_reactions_folder() -> Path:
    """Folder of the reaction families that come with chemlab."""
    return Path(__file__).parent / "data" / "reactions"


def load_reactions(
    name: str, materials: Mapping[str, Material], folder: Path | None = None, where: str = ""
) -> ReactionFamily:
    """Load a family by shipped name or by path and check it against the materials.

    Args:
        name: a shipped family's name, or a path to a TOML file (relative to ``folder``).
        materials: known materials by id.
        folder: where a relative path starts (the scenario's folder).
        where: what asks for the family, for the error message.

    Raises:
        DataError: unknown family or material, or a reaction that does not conserve atoms and charge.
    """
    shipped = {path.stem: path for path in sorted(shipped_reactions_folder().glob("*.toml"))}
    if name in shipped:
        path = shipped[name]
    elif name.endswith(".toml"):
        path = Path(name) if folder is None else folder / name
    else:
        asked = f"{where}: reactions" if where else "reactions"
        raise DataError(
            f"{asked}: unknown family {name!r}; shipped: {', '.join(shipped)}; or give a path to a .toml file"
        )
    family: ReactionFamily = validated(ReactionFamily, read_toml(path), str(path))
    check_reactions(family, materials, str(path))
    return family


def check_reactions(family: ReactionFamily, materials: Mapping[str, Material], where: str) -> None:
    """Refuse what no chemistry can be made of.

    Args:
        family: the reactions.
        materials: known materials by id.
        where: the file they are from, for the error message.

    Raises:
        DataError: unknown material, a reaction that does not conserve atoms and charge, a salt that is not a solid of a
            positive and a negative ion, salts that share an anion.
    """
    unknown = sorted(family.materials() - set(materials))
    if unknown:
        raise DataError(f"{where}: unknown material {unknown[0]!r}; known: {', '.join(sorted(materials))}")
    steps = [(f"reaction.{i}", r.reactants, r.products) for i, r in enumerate(family.reaction)]
    steps += [(f"violent.{i}", v.reactants, v.products) for i, v in enumerate(family.violent)]
    steps += [(f"salt.{i}", {s.solid: 1.0}, {s.cation: 1.0, s.anion: 1.0}) for i, s in enumerate(family.salt)]
    for key, reactants, products in steps:
        before, after = atoms_of(reactants, materials), atoms_of(products, materials)
        for element in sorted(set(before) | set(after)):
            left, right = before.get(element, 0.0), after.get(element, 0.0)
            if abs(left - right) > _BALANCE_TOLERANCE * max(1.0, abs(left)):
                raise DataError(f"{where}: {key}: not balanced: {element} {left:g} on the left, {right:g} on the right")
    for i, salt in enumerate(family.salt):
        solid, cation, anion = (materials[name] for name in (salt.solid, salt.cation, salt.anion))
        if solid.role != "solid" or cation.charge <= 0 or anion.charge >= 0:
            raise DataError(
                f"{where}: salt.{i}: must be a solid, a positive and a negative ion, "
                f"given {salt.solid!r} ({solid.role}), "
                f"{salt.cation!r} (charge {cation.charge}) and {salt.anion!r} (charge {anion.charge})"
            )
    anions = [salt.anion for salt in family.salt]
    if len(set(anions)) != len(anions):
        # The closed-form equilibrium is one quadratic per cation; an anion shared by two cations would couple them.
        raise DataError(f"{where}: salt: two salts share an anion; only a shared cation is supported")
