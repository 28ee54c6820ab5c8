"""Reaction networks as data: stoichiometry, orders and Arrhenius constants, checked for balance.

A reaction family is one TOML file of ``chemlab/data/reactions`` (or a path of the user's): ``[[reaction]]``
entries integrated by the kinetics kernel, ``[[salt]]`` entries taken to their dissolution equilibrium, and
``[[violent]]`` entries that run to completion at once and are safety events.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, model_validator

from .materials import DataError, Material, atoms_of, read_toml, validated

__all__ = ["Reaction", "ReactionFamily", "Salt", "Violent", "load_reactions", "shipped_reactions_folder"]

_BALANCE_TOLERANCE = 1e-9
_FROZEN = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Balanced(BaseModel):
    """What every kind of reaction has."""

    model_config = _FROZEN

    reactants: dict[str, float]
    products: dict[str, float]
    source: str = Field(min_length=1)

    @model_validator(mode="after")
    def _has_both_sides(self) -> _Balanced:
        for side, counts in (("reactants", self.reactants), ("products", self.products)):
            if not counts or min(counts.values()) <= 0.0:
                raise ValueError(f"{side} must give a positive coefficient for at least one material")
        return self


class Reaction(_Balanced):
    """One elementary step: rate = A exp(-Ea / RT) * prod(concentration ** order), in mol/L per time unit."""

    orders: dict[str, float] = Field(default_factory=dict)
    """Order in each reactant; empty means the reactant's own coefficient (mass action)."""
    pre_exponential: float = Field(gt=0.0)
    activation_energy_j_mol: float = Field(ge=0.0, le=500_000.0)

    @model_validator(mode="after")
    def _sound(self) -> Reaction:
        for key, order in self.orders.items():
            if key not in self.reactants:
                raise ValueError(f"orders.{key}: not a reactant of this reaction")
            if order <= 0.0:
                raise ValueError(f"orders.{key} = {order} must be above 0: a used-up reactant must stop its reaction")
        if not self.orders:
            return self.model_copy(update={"orders": dict(self.reactants)})
        if set(self.orders) != set(self.reactants):
            raise ValueError("orders must name every reactant, or none")
        return self


class Salt(BaseModel):
    """A salt that dissolves in every solvent: ``solid <-> cation + anion`` (one of each), K = 1 mol/mol."""

    model_config = _FROZEN

    solid: str
    cation: str
    anion: str
    source: str = Field(min_length=1)


class Violent(_Balanced):
    """A reaction that goes to completion the moment its reactants meet; running it is a safety event."""


class ReactionFamily(BaseModel):
    """A named set of reactions, salts and violent reactions."""

    model_config = _FROZEN

    name: str
    summary: str = ""
    reaction: tuple[Reaction, ...] = ()
    salt: tuple[Salt, ...] = ()
    violent: tuple[Violent, ...] = ()

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
    unknown = sorted(family.materials() - set(materials))
    if unknown:
        raise DataError(f"{path}: unknown material {unknown[0]!r}; known: {', '.join(sorted(materials))}")
    steps = [(f"reaction.{i}", r.reactants, r.products) for i, r in enumerate(family.reaction)]
    steps += [(f"violent.{i}", v.reactants, v.products) for i, v in enumerate(family.violent)]
    steps += [(f"salt.{i}", {s.solid: 1.0}, {s.cation: 1.0, s.anion: 1.0}) for i, s in enumerate(family.salt)]
    for where, reactants, products in steps:
        before, after = atoms_of(reactants, materials), atoms_of(products, materials)
        for element in sorted(set(before) | set(after)):
            left, right = before.get(element, 0.0), after.get(element, 0.0)
            if abs(left - right) > _BALANCE_TOLERANCE * max(1.0, abs(left)):
                raise DataError(
                    f"{path}: {where}: not balanced: {element} {left:g} on the left, {right:g} on the right"
                )
    anions = [salt.anion for salt in family.salt]
    if len(set(anions)) != len(anions):
        # The closed-form equilibrium is one quadratic per cation; an anion shared by two cations would couple them.
        raise DataError(f"{path}: salt: two salts share an anion; only a shared cation is supported")
    return family
