"""Reaction networks as data: stoichiometry, orders and Arrhenius constants, checked for balance.

A reaction family is one TOML file of ``chemlab/data/reactions`` (or a path of the user's). It has ``[[reaction]]``
entries integrated by the kinetics kernel, ``[[salt]]`` entries at dissolution equilibrium, ``[[violent]]`` entries that
run to completion at once and may be safety events, and ``[[acid]]`` entries in permanent equilibrium with water.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from ..kernels.arrays import FloatArray
from .catalogue import unknown_material
from .datafile import DataError, read_toml
from .datamodel import DataModel, validated
from .materials import Materials, Text, atoms_of

PROTON, HYDROXIDE, WATER = "H+", "OH-", "water"
"""Materials of the ionization of water, through which acids and bases react."""

_BALANCE_TOLERANCE = 1e-9

Coefficients = Annotated[
    dict[Text, Annotated[float, Field(ge=0.001, le=100.0)]],
    Field(min_length=1, max_length=20),
]
"""Stoichiometric coefficients of one side, by material."""
Orders = Annotated[dict[Text, Annotated[float, Field(ge=0.01, le=20.0)]], Field(max_length=20)]
"""Orders by reactant; their sum is at most 20."""
_HIGHEST_ORDER = 20.0
"""Maximum total order. Observed orders are below 5; the kernel multiplies this many concentrations in every step."""
_SMALLEST_CONSTANT = 1e-50
_SOLUBLE = 0.01
"""Solubility in mol/kg of water above which a salt reacts as its ions."""
_KEPT_APART = 1.0
"""Inhibition in L/mol by water of the reaction of an undissolved salt.

The reaction proceeds without water, and adds 2 % to that of the ions in a saturated solution.
"""
Inhibition = Annotated[dict[Text, Annotated[float, Field(gt=0.0, le=1e12)]], Field(max_length=20)]
"""Inhibition constants in L/mol, by material."""
Enthalpy = Annotated[float, Field(ge=-1e7, le=1e7)]
"""J/mol"""


class _Balanced(DataModel):
    """Common fields of all kinds of reactions."""

    reactants: Coefficients
    products: Coefficients
    source: str = Field(min_length=1)


_REAL_ONLY = ("catalysts", "inhibitors", "equilibrium_constant", "enthalpy_j_mol")
"""Fields of a reaction that only the backend ``real`` supports."""


class Reaction(_Balanced):
    """One elementary step: rate = A exp(-Ea / RT) * prod(concentration ** order), in mol/L per time unit.

    Catalysts, inhibitors and the reverse reaction are supported by the backend ``real`` only.
    """

    orders: Orders = {}
    """Order in each reactant, above 0 because a consumed reactant must stop its reaction.

    Empty means the reactant's own coefficient (mass action).
    """
    pre_exponential: float = Field(gt=0.0, le=1e30)
    """A, in (L/mol)^(order - 1) per time unit."""
    activation_energy_j_mol: float = Field(ge=0.0, le=500_000.0)
    catalysts: Orders = {}
    """Order in each catalyst; without the catalyst, the reaction runs in neither direction."""
    inhibitors: Inhibition = {}
    """K in L/mol by inhibitor: the rate is divided by 1 + sum of K times its concentration."""
    equilibrium_constant: float | None = Field(default=None, gt=0.0, le=1e50)
    """Equilibrium constant at 298.15 K in terms of mol/L, between 1e-50 and 1e50.

    It makes the reaction reversible (k_back = k / K) and requires mass action.
    """
    enthalpy_j_mol: Enthalpy | None = None
    """Heat of reaction at 298.15 K, which determines the temperature dependence of K (van 't Hoff).

    By default it follows from the materials' formation enthalpies, with which it must agree.
    """

    @model_validator(mode="after")
    def _sound(self) -> Reaction:
        for key in self.orders:
            if key not in self.reactants:
                raise ValueError(f"orders.{key}: not a reactant of this reaction")
        if self.orders and set(self.orders) != set(self.reactants):
            raise ValueError("orders must name every reactant, or none")
        for key in self.catalysts:
            if key in self.reactants:
                raise ValueError(f"catalysts.{key}: is a reactant; give it a higher order under orders instead")
        for key in self.inhibitors:
            if key in self.catalysts:
                raise ValueError(f"inhibitors.{key}: is a catalyst of this reaction as well")
        orders = self.orders or dict(self.reactants)
        forward, backward = sum(orders.values()), 0.0
        if self.equilibrium_constant is not None:
            if self.equilibrium_constant < _SMALLEST_CONSTANT:
                raise ValueError(
                    f"equilibrium_constant: at least {_SMALLEST_CONSTANT:g}, given {self.equilibrium_constant:g}; "
                    "omit reactions that do not run forward"
                )
            if orders != self.reactants:
                raise ValueError(
                    "equilibrium_constant: requires mass action: omit orders, or write the reverse "
                    "reaction as a separate one"
                )
            backward = sum(self.products.values())
        total = max(forward, backward) + sum(self.catalysts.values())
        if total > _HIGHEST_ORDER:
            raise ValueError(f"orders: add up to {total:g}; at most {_HIGHEST_ORDER:g}")
        return self.model_copy(update={"orders": orders})

    def materials(self) -> set[str]:
        """Return every material that this reaction changes or depends on."""
        return {*self.reactants, *self.products, *self.catalysts, *self.inhibitors}

    @property
    def words(self) -> str:
        """Description of the reaction for messages.

        A reaction has no name, and its index changes when reactions that cannot run are removed.
        """
        return f"{' + '.join(self.reactants)} -> {' + '.join(self.products)}"


Point = tuple[Annotated[float, Field(ge=150.0, le=1000.0)], Annotated[float, Field(ge=0.0, le=100.0)]]
"""A temperature in K and a solubility in mol/kg."""


class Solubility(DataModel):
    """Solubility of a salt per kilogram of solvent; a mixture dissolves as its solvents do, by mass."""

    solvents: dict[Text, Annotated[tuple[Point, ...], Field(min_length=1, max_length=50)]] = Field(
        min_length=1, max_length=50
    )
    """Points (K, mol/kg) by solvent with increasing temperatures; linear between points, constant beyond the ends."""
    elsewhere_mol_kg: float = Field(default=0.0, ge=0.0, le=100.0)
    """Solubility in any other solvent, at all temperatures."""
    source: str = Field(min_length=1)

    @model_validator(mode="after")
    def _rises(self) -> Solubility:
        for name, points in self.solvents.items():
            if any(cold[0] >= warm[0] for cold, warm in itertools.pairwise(points)):
                raise ValueError(f"solvents.{name}: temperatures must rise, given {[point[0] for point in points]}")
        return self

    def mol_per_kg(self, solvent: str, temperature_k: FloatArray | float) -> FloatArray:
        """Return the solubility in one solvent in mol/kg, in the shape of ``temperature_k``."""
        temperature = np.asarray(temperature_k, dtype=np.float64)
        points = np.array(self.solvents.get(solvent, ((298.15, self.elsewhere_mol_kg),)))
        return np.asarray(np.interp(temperature, points[:, 0], points[:, 1]))


class Salt(DataModel):
    """A salt that dissolves as ``solid <-> cation + anion`` (one of each).

    In the backend ``paper`` it dissolves in every solvent with K = 1 mol/mol, in the backend ``real`` up to its
    solubility.
    """

    solid: Text
    cation: Text
    anion: Text
    source: str = Field(min_length=1)
    solubility: Solubility | None = None
    """Required by the backend ``real``; the backend ``paper`` ignores it."""


class Violent(_Balanced):
    """A reaction that goes to completion as soon as its reactants meet."""

    event: Text | None = None
    """Safety event that it counts as, by the mol of its first reactant.

    By default, a solid element that reacts with water counts as ``metal_in_water_mol``, and other reactions as none.
    """


class Acid(DataModel):
    """An acid with its bases, in permanent equilibrium with water; only in the backend ``real``.

    Strong acids and bases need no entry: they are ions from the start, one of them ``H+`` or ``OH-``.
    """

    species: tuple[Text, ...] = Field(min_length=2, max_length=8)
    """Species from the most acidic one on; each has one proton less than the previous one."""
    pka: tuple[Annotated[float, Field(ge=-20.0, le=40.0)], ...] = Field(min_length=1, max_length=7)
    """pKa of each step, at 298.15 K and infinite dilution."""
    enthalpy_j_mol: tuple[Enthalpy, ...] = Field(default=(), max_length=7)
    """Heat of each step, which determines the temperature dependence of its pKa (van 't Hoff).

    By default it follows from the materials' formation enthalpies.
    """
    source: str = Field(min_length=1)

    @model_validator(mode="after")
    def _sound(self) -> Acid:
        steps = len(self.species) - 1
        if len(set(self.species)) != len(self.species):
            raise ValueError("species: one is listed twice")
        for key, given in (("pka", self.pka), ("enthalpy_j_mol", self.enthalpy_j_mol)):
            if len(given) != steps and (given or key == "pka"):
                raise ValueError(f"{key}: {len(self.species)} species have {steps} steps, given {len(given)}")
        return self


class ReactionFamily(DataModel):
    """A named set of reactions, salts, violent reactions and acids."""

    name: Text
    summary: str = ""
    reaction: tuple[Reaction, ...] = Field(default=(), max_length=200)
    salt: tuple[Salt, ...] = Field(default=(), max_length=50)
    violent: tuple[Violent, ...] = Field(default=(), max_length=50)
    acid: tuple[Acid, ...] = Field(default=(), max_length=50)
    lock: dict[Text, str] = Field(default={}, max_length=50)
    """Origin of a generated file: command and versions."""

    def materials(self) -> set[str]:
        """Return every material that this family names."""
        found = {name for salt in self.salt for name in (salt.solid, salt.cation, salt.anion)}
        for step in self.violent:
            found |= set(step.reactants) | set(step.products)
        for reaction in self.reaction:
            found |= reaction.materials()
        for acid in self.acid:
            found |= {*acid.species, PROTON, HYDROXIDE, WATER}
        return found

    def towards(self, goal: str) -> set[str]:
        """Return the goal, and all reactants and catalysts of the reactions on the route to it."""
        steps = itertools.chain.from_iterable(self.ways(goal).values())
        return {goal}.union(*({*step.reactants, *step.catalysts} for step in steps))

    def ways(self, goal: str) -> dict[str, list[Reaction]]:
        """Return the reactions on the route to a goal, by the material that each makes, in the family's order.

        Reactions that start from their own product's derivatives are excluded: the hydrolysis of aspirin to salicylic
        acid is not a route to aspirin.
        """
        found: dict[str, list[Reaction]] = {}
        wanted = [goal]
        for name in wanted:  # which grows in the loop
            if name in found:
                continue
            made = [s for s in self.reaction if name in s.products and name not in _behind(s.reactants, found)]
            found[name] = made
            wanted += itertools.chain.from_iterable(step.reactants for step in made)
        return {name: made for name, made in found.items() if made}


def _behind(names: Iterable[str], ways: Mapping[str, list[Reaction]]) -> set[str]:
    """Return materials together with all materials that they are made of."""
    seen: set[str] = set()
    wanted = list(names)
    while wanted:
        name = wanted.pop()
        if name not in seen:
            seen.add(name)
            wanted += itertools.chain.from_iterable(step.reactants for step in ways.get(name, ()))
    return seen


def equation(step: Reaction | Violent) -> str:
    """Format a reaction as text: ``A + 2 B -> C``."""
    return f"{side_words(step.reactants)} -> {side_words(step.products)}"


def side_words(side: Mapping[str, float]) -> str:
    """Format a side of a reaction as text: ``A + 2 B``."""
    return " + ".join(f"{'' if number == 1 else f'{number:g} '}{name}" for name, number in side.items())


def dissolved_reactions(family: ReactionFamily) -> ReactionFamily:
    """Write reactions of soluble salts as those of their ions in water (backend ``real``).

    A reaction with such a salt as reactant or catalyst is followed by the same reaction of its ions; the reaction of
    the solid is for contents without water. Spectator ions are removed. An ion has the order of its salt; two consumed
    ions have half of it each.
    """
    salts = {
        salt.solid: salt
        for salt in family.salt
        if salt.solubility is not None and salt.solubility.mol_per_kg(WATER, 298.15) > _SOLUBLE
    }
    steps: list[Reaction] = []
    for step in family.reaction:
        needed = {*step.reactants, *step.catalysts, *step.inhibitors}
        needed |= set(step.products) if step.equilibrium_constant is not None else set()
        if needed.isdisjoint(salts) or WATER in step.inhibitors:
            steps.append(step)
            continue
        apart = step.model_copy(update={"inhibitors": {**step.inhibitors, WATER: _KEPT_APART}})
        ionic = _of_ions(step, salts)
        if ionic is None:
            steps.append(apart)
            continue
        if ionic.reactants.keys() | ionic.catalysts.keys() >= step.reactants.keys() | step.catalysts.keys():
            steps.append(ionic)  # only products or inhibitors are salts
            continue
        steps += [apart, ionic]
    return family.model_copy(update={"reaction": tuple(steps)})


def _parted(side: Mapping[str, float], salts: Mapping[str, Salt]) -> dict[str, float]:
    """Replace salts by their ions in a mapping of numbers by material."""
    total: dict[str, float] = {}
    for name, number in side.items():
        for part in (salts[name].cation, salts[name].anion) if name in salts else (name,):
            total[part] = total.get(part, 0.0) + number
    return total


def _of_ions(step: Reaction, salts: Mapping[str, Salt]) -> Reaction | None:
    """Return a reaction of dissolved salts; None if salts only exchange ions, which no ion takes part in."""
    before, after = _parted(step.reactants, salts), _parted(step.products, salts)
    taking_part = {*step.reactants, *step.products} & set(salts)
    for ion in {ion for name in taking_part for ion in (salts[name].cation, salts[name].anion)}:
        both = min(before.get(ion, 0.0), after.get(ion, 0.0))
        for side in (before, after):
            if both and side[ion] - both <= _BALANCE_TOLERANCE:
                del side[ion]
            elif both:
                side[ion] -= both
    if not before:
        return None
    orders: dict[str, float] = {}
    catalysts: dict[str, float] = {}
    for name, order in (*step.orders.items(), *step.catalysts.items()):
        ions = [salts[name].cation, salts[name].anion] if name in salts else [name]
        used = [ion for ion in ions if ion in before] if name in step.reactants else []
        acting = used or [ion for ion in ions if ion in (PROTON, HYDROXIDE)] or ions
        for ion in acting:
            target = orders if ion in before else catalysts
            target[ion] = target.get(ion, 0.0) + order / len(acting)
    orders |= {name: before[name] for name in before if name not in orders}
    inhibitors: dict[str, float] = {}
    for name, constant in step.inhibitors.items():
        inhibitors[salts[name].anion if name in salts else name] = constant
    values = {
        **step.model_dump(include={"pre_exponential", "activation_energy_j_mol", "equilibrium_constant"}),
        "reactants": before,
        "products": after,
        "orders": {} if step.equilibrium_constant is not None else orders,
        "catalysts": catalysts,
        "inhibitors": inhibitors,
        "source": f"{step.source}; its salts as ions",
    }
    return validated(Reaction, values, f"reaction {step.words}, of ions")


def shipped_reactions_folder() -> Path:
    """Return the folder of the bundled reaction families."""
    return Path(__file__).parent.parent / "data" / "reactions"


def load_reactions(name: str, materials: Materials, folder: Path | None = None, where: str = "") -> ReactionFamily:
    """Load a family by bundled name or by path, and check it against the materials.

    Args:
        name: a bundled family's name, or a path to a TOML file (relative to ``folder``).
        materials: known materials by id.
        folder: folder to which a relative path refers (the scenario's folder).
        where: origin of the request, for the error message.

    Raises:
        DataError: a family or material is unknown, or a reaction does not conserve atoms and charge.
    """
    shipped = {path.stem: path for path in sorted(shipped_reactions_folder().glob("*.toml"))}
    if name in shipped:
        path = shipped[name]
    elif name.endswith(".toml"):
        path = Path(name) if folder is None else folder / name
    else:
        asked = f"{where}: reactions" if where else "reactions"
        raise DataError(
            f"{asked}: unknown family {name!r}; choose from {', '.join(shipped)}, or give a path to a .toml file"
        )
    family = validated(ReactionFamily, read_toml(path), str(path))
    check_reactions(family, materials, str(path))
    return family


def check_reactions(family: ReactionFamily, materials: Materials, where: str) -> None:
    """Check that a chemistry can be built from a family.

    Args:
        family: the reactions.
        materials: known materials by id.
        where: the file they are from, for the error message.

    Raises:
        DataError: unknown material, a reaction that does not conserve atoms and charge, a salt that is not a solid of a
            positive and a negative ion, two salts of the same ions, acids that share a species.
    """
    unknown = sorted(family.materials() - set(materials))
    if unknown:
        raise DataError(f"{where}: {unknown_material(unknown[0], materials)}")
    steps = [(f"reaction.{i}", r.reactants, r.products) for i, r in enumerate(family.reaction)]
    steps += [(f"violent.{i}", v.reactants, v.products) for i, v in enumerate(family.violent)]
    steps += [(f"salt.{i}", {s.solid: 1.0}, {s.cation: 1.0, s.anion: 1.0}) for i, s in enumerate(family.salt)]
    if family.acid:
        steps.append(("acid: water", {WATER: 1.0}, {PROTON: 1.0, HYDROXIDE: 1.0}))
    for i, acid in enumerate(family.acid):
        for acidic, basic in zip(acid.species, acid.species[1:], strict=False):
            steps.append((f"acid.{i}: {acidic} to {basic}", {acidic: 1.0}, {basic: 1.0, PROTON: 1.0}))
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
    ions = [(salt.cation, salt.anion) for salt in family.salt]
    if len(set(ions)) != len(ions):
        raise DataError(f"{where}: salt: two salts have the same ions; remove one of them")
    taken = {PROTON: "water", HYDROXIDE: "water", WATER: "water"}
    for i, acid in enumerate(family.acid):
        for name in acid.species:
            if name in taken:
                raise DataError(f"{where}: acid.{i}: species: {name!r} is part of {taken[name]} already")
            if materials[name].role in ("solid", "gas"):
                raise DataError(
                    f"{where}: acid.{i}: species: {name!r} is a {materials[name].role}; it must be dissolved in water"
                )
            taken[name] = f"acid.{i}"


def check_without_real(family: ReactionFamily, where: str) -> None:
    """Check that a family needs no laws of the backend ``real``.

    Args:
        family: reactions of a scenario of another backend.
        where: the file of the scenario, for the error message.

    Raises:
        DataError: a reaction with a catalyst, an inhibitor, an equilibrium or a heat; an acid; salts that share an
            anion.
    """
    keys = [
        f"reaction {step.words}: {key}"
        for step in family.reaction
        for key in _REAL_ONLY
        if getattr(step, key) != Reaction.model_fields[key].default
    ]
    keys += ["acid"] if family.acid else []
    if keys:
        raise DataError(f"{where}: reactions {family.name!r}: {keys[0]} needs physics = 'real' in the scenario")
    anions = [salt.anion for salt in family.salt]
    if len(set(anions)) != len(anions):
        # The closed-form equilibrium is one quadratic per cation; an anion shared by two cations would couple them.
        raise DataError(
            f"{where}: salt: two salts share an anion; physics = 'paper' supports a shared cation only; "
            "choose physics = 'real'"
        )
