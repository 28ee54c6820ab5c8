"""Reaction families from reaction templates (SMARTS): all balanced reactions of given materials."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..config.datafile import DataError, toml_key
from ..config.datamodel import validated, written
from ..config.extras import needs
from ..config.materials import Materials
from ..config.reactions import ReactionFamily, load_reactions, shipped_reactions_folder, side_words
from ..physics.constants import GAS_CONSTANT, ROOM_K
from .identity import Compound, check_length, composition_of, compound_of, parsed
from .writing import lock, significant

with needs("reaction templates need rdkit", "chem"):
    from rdkit import Chem
    from rdkit.Chem import AllChem

_MOST_WAYS = 50_000
"""Maximum number of assignments of molecules to a template's reactants."""
_MOST_OUTCOMES = 20_000
"""Maximum number of product sets of a template; one assignment may give a thousand."""
_MOST_REACTIONS = 200
_GUESSED = ((2e-4, 60_000.0), (2e-5, 75_000.0))
"""Guessed rate constant at 298.15 K and activation energy in J/mol, for main reactions and for side reactions.

A main reaction takes an hour or two. A side reaction is ten times slower at 298.15 K, and heat favours it.
"""
_SURFACE_ORDER = 0.667
"""Order of a dissolving solid: shrinking spheres."""


@dataclass(frozen=True)
class Rate:
    """Rate of a template's reactions; constants that are None are guessed."""

    constant: float | None = None
    """Rate constant at 298.15 K, in (L/mol)^(order - 1) per s."""
    activation_j_mol: float | None = None
    equilibrium_constant: float | None = None
    source: str = ""

    def __post_init__(self) -> None:
        for name, value, least in (("rate", self.constant, 0.0), ("equilibrium", self.equilibrium_constant, 0.0)):
            if value is not None and not least < value < math.inf:
                raise DataError(f"{name}: must be a number above 0, given {value:g}")
        if self.activation_j_mol is not None and not 0.0 <= self.activation_j_mol <= 500_000.0:
            raise DataError(f"activation: must be 0 to 500000 J/mol, given {self.activation_j_mol:g}")


@dataclass(frozen=True)
class Template:
    """A reaction template.

    Args:
        smarts: reactants and products separated by dots, with ``>>`` between both; ions of a salt in one pair of
            brackets.
        rate: rate of all its reactions.
        side: whether it is a side reaction.

    Raises:
        DataError: it is not a reaction SMARTS.
    """

    smarts: str
    rate: Rate = field(default_factory=Rate)
    side: bool = False
    reaction: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_length(self.smarts, "template")
        try:
            made = AllChem.ReactionFromSmarts(self.smarts)
            made.Initialize()
        except (ValueError, RuntimeError) as error:
            why = str(error).strip().splitlines()[-1] if str(error).strip() else "it cannot be read"
            raise DataError(
                f"template {self.smarts!r}: not a reaction SMARTS: {why}; write REACTANTS>>PRODUCTS, as in "
                "'[C:1][Br].[OH:2][C:3]>>[C:1][O:2][C:3].Br'"
            ) from error
        if not made.GetNumReactantTemplates() or not made.GetNumProductTemplates():
            raise DataError(f"template {self.smarts!r}: has no reactants or no products")
        if made.GetNumAgentTemplates():
            agents = self.smarts.split(">")[1]
            raise DataError(
                f"template {self.smarts!r}: {agents} over the arrow is not supported; write "
                "REACTANTS>>PRODUCTS, with consumed reagents on the left, and name a catalyst with --catalyst"
            )
        object.__setattr__(self, "reaction", made)


@dataclass(frozen=True)
class Species:
    """A material that takes part: its id, or the id it would have, by structure."""

    inchi_key: str
    smiles: str
    key: str
    known: bool


@dataclass(frozen=True)
class Found:
    """A reaction made by a template: coefficients by material."""

    reactants: dict[str, int]
    products: dict[str, int]
    template: Template

    @property
    def words(self) -> str:
        """The reaction as text: ``A + 2 B -> C``."""
        return " -> ".join(side_words(side) for side in (self.reactants, self.products))


def _matched(molecule: Any) -> Any:
    """Return a molecule for matching with templates: hydrogen gas has explicit atoms, others implicit hydrogens."""
    return Chem.AddHs(molecule) if molecule.GetNumHeavyAtoms() == 0 else molecule


class _Pool:
    """All species so far, by InChIKey.

    The InChIKey does not depend on the notation of a structure, nor on a bond drawn in sodium chloride.
    """

    def __init__(self, materials: Materials, names: Mapping[str, str]) -> None:
        self.species: dict[str, Species] = {}
        self._known: dict[str, tuple[str, str]] = {}
        for key, material in materials.items():
            if material.smiles:
                molecule = parsed(material.smiles, key)
                self._known.setdefault(Chem.MolToInchiKey(molecule), (key, Chem.MolToSmiles(molecule)))
        self._names = {Chem.MolToInchiKey(parsed(smiles, key)): key for key, smiles in names.items()}
        self._taken = {*materials, *names}
        self.molecules: dict[str, Any] = {}

    def add(self, molecule: Any, where: str) -> Species:
        """Return the species of a molecule.

        Raises:
            DataError: the molecule is charged, or a salt that is not a known material.
        """
        inchi_key = str(Chem.MolToInchiKey(molecule))
        if inchi_key in self.species:
            return self.species[inchi_key]
        smiles = str(Chem.MolToSmiles(molecule))
        if inchi_key in self._known:
            key, smiles = self._known[inchi_key]
            made = Species(inchi_key, smiles, key, True)
        else:
            if Chem.GetFormalCharge(molecule) != 0:
                raise DataError(
                    f"{where}: makes {smiles}, a fragment with a charge of {Chem.GetFormalCharge(molecule):+d}; put "
                    "the ions of a salt into one pair of brackets, as in ([Na+:1].[Cl-:2]), or give atoms all bonds"
                )
            if len(Chem.GetMolFrags(molecule)) > 1:
                raise DataError(
                    f"{where}: makes the salt {smiles}, which is not a known material; write its material by hand "
                    "(docs: Write a material or a reaction) and name the file with --materials"
                )
            compound: Compound = compound_of(smiles, self._names.get(inchi_key, ""), structure=True)
            key, number = compound.key, 1
            while key in self._taken and key != self._names.get(inchi_key):
                number += 1
                key = f"{compound.key}_{number}"
            self._taken.add(key)
            made = Species(inchi_key, smiles, key, False)
        self.species[inchi_key] = made
        self.molecules[inchi_key] = _matched(parsed(smiles, made.key))
        return made


def _outcomes(template: Template, molecules: Sequence[Any]) -> tuple[list[tuple[Any, ...]], int, int]:
    """Apply a template to molecules in this order.

    Returns:
        Distinct sets of products, the number of impossible sets, and the total number of sets.
    """
    distinct: dict[tuple[str, ...], tuple[Any, ...]] = {}
    impossible = 0
    outcomes = template.reaction.RunReactants(tuple(molecules))
    for products in outcomes:
        cleaned = []
        try:
            for product in products:
                Chem.SanitizeMol(product)
                cleaned.append(Chem.RemoveHs(product))
        except (Chem.MolSanitizeException, ValueError):
            impossible += 1
            continue
        distinct.setdefault(tuple(sorted(Chem.MolToSmiles(m) for m in cleaned)), tuple(cleaned))
    return list(distinct.values()), impossible, len(outcomes)


def _check_balance(reactants: Iterable[Any], products: Iterable[Any], where: str) -> None:
    """Check that a reaction conserves atoms and charge.

    Raises:
        DataError: it does not; the message lists the elements.
    """
    sides = []
    for side in (reactants, products):
        totals: Counter[str] = Counter()
        for molecule in side:
            totals.update(composition_of(molecule))
            totals["charge"] += Chem.GetFormalCharge(molecule)
        sides.append(totals)
    before, after = sides
    wrong = [f"{e} {before[e]} -> {after[e]}" for e in sorted({*before, *after}) if before[e] != after[e]]
    if wrong:
        raise DataError(
            f"{where}: not balanced: {', '.join(wrong)}; add leaving molecules as products of the template (water: O, "
            "hydrogen chloride: Cl), and every reactant as often as it is consumed"
        )


def expand(
    templates: Sequence[Template],
    reactants: Sequence[str],
    materials: Materials,
    names: Mapping[str, str] | None = None,
    generations: int = 2,
) -> tuple[list[Found], list[Species]]:
    """Return all reactions that templates make of some materials and of their products.

    Args:
        templates: templates; each has to make at least one reaction.
        reactants: ids of materials, CAS numbers, names or structures.
        materials: known materials by id.
        names: structures of new materials by their ids.
        generations: number of times that products become reactants; salts do not, unless given in ``reactants``.

    Returns:
        The distinct reactions, and all species in the order of their appearance.

    Raises:
        DataError: a reactant is unknown; a template fits nothing or makes impossible, charged or unbalanced products;
            or the number of reactions exceeds the limit.
    """
    pool = _Pool(materials, names or {})
    available = [pool.add(_reactant(text, materials), f"reactant {text!r}").inchi_key for text in reactants]
    found: dict[Any, Found] = {}
    productive: set[int] = set()
    for _ in range(generations):
        before = set(available)
        for number, template in enumerate(templates):
            for step in _applied(template, available, pool):
                if step.reactants != step.products:
                    productive.add(number)
                    found.setdefault((frozenset(step.reactants.items()), frozenset(step.products.items())), step)
                if len(found) > _MOST_REACTIONS:
                    raise DataError(
                        f"template {template.smarts!r}: makes more than {_MOST_REACTIONS} reactions; make it more "
                        "specific, or use fewer --generations"
                    )
        molecules = [key for key, species in pool.species.items() if "." not in species.smiles]
        available += [key for key in molecules if key not in before]
        if set(available) == before:
            break
    for number, template in enumerate(templates):
        if number not in productive:
            species = ", ".join(pool.species[key].key for key in available)
            raise DataError(
                f"template {template.smarts!r}: changes none of {species}; check its atoms, bonds and hydrogens"
            )
    return list(found.values()), list(pool.species.values())


def _reactant(text: str, materials: Materials) -> Any:
    if text in materials:
        smiles = materials[text].smiles
        if not smiles:
            raise DataError(f"reactant {text!r}: its material has no structure; add smiles to its table")
        return parsed(smiles, text)
    return parsed(compound_of(text).smiles, text)


def _applied(template: Template, available: Sequence[str], pool: _Pool) -> Iterable[Found]:
    """Yield the reactions that one template makes of available species.

    Raises:
        DataError: the template is too general, or makes impossible, charged or unbalanced products.
    """
    patterns = [template.reaction.GetReactantTemplate(i) for i in range(template.reaction.GetNumReactantTemplates())]
    fitting = [[key for key in available if pool.molecules[key].HasSubstructMatch(pattern)] for pattern in patterns]
    if math.prod(len(keys) for keys in fitting) > _MOST_WAYS:
        raise DataError(f"template {template.smarts!r}: fits in more than {_MOST_WAYS} ways; make it more specific")
    impossible, made, total = 0, 0, 0
    for chosen in itertools.product(*fitting):
        molecules = [pool.molecules[key] for key in chosen]
        outcomes, wrong, number = _outcomes(template, molecules)
        impossible, total = impossible + wrong, total + number
        if total > _MOST_OUTCOMES:
            raise DataError(
                f"template {template.smarts!r}: gives more than {_MOST_OUTCOMES} sets of products; make it more "
                "specific"
            )
        for products in outcomes:
            made += 1
            before = Counter(pool.species[key].key for key in chosen)
            where = f"template {template.smarts!r}: {side_words(before)}"
            _check_balance(molecules, products, where)
            after = Counter(pool.add(product, where).key for product in products)
            yield Found(dict(before), dict(after), template)
    if impossible and not made:
        raise DataError(
            f"template {template.smarts!r}: its products are impossible (an atom has too many bonds); check charges, "
            "hydrogens and bonds on its right"
        )


def heat_of_reaction(found: Found, materials: Materials) -> float:
    """Return the heat of reaction in J/mol at 298.15 K from formation enthalpies; solids are counted as melts.

    Raises:
        DataError: a material has no formation enthalpy.
    """
    total = 0.0
    for sign, side in ((-1.0, found.reactants), (1.0, found.products)):
        for key, number in side.items():
            real = materials[key].real
            if real is None:
                raise DataError(f"material {key!r} has no [{toml_key(key)}.real] with its formation enthalpy")
            molten = (real.fusion_enthalpy_j_mol or 0.0) if real.formation_state == "s" else 0.0
            total += sign * number * (real.formation_enthalpy_j_mol + molten)
    return total


def rate_constant(template: Template) -> float:
    """Return a template's rate constant at 298.15 K, in (L/mol)^(order - 1) per s; a guess if none is given."""
    return _GUESSED[template.side][0] if template.rate.constant is None else template.rate.constant


def _entry(found: Found, materials: Materials, salts: Collection[str]) -> dict[str, Any]:
    """Return the table of a reaction; ``salts`` dissolve, so that their ions react by mass action."""
    rate, template = found.template.rate, found.template
    constant = rate_constant(template)
    activation = _GUESSED[template.side][1] if rate.activation_j_mol is None else rate.activation_j_mol
    values: dict[str, Any] = {"reactants": found.reactants, "products": found.products}
    solids = [key for key in found.reactants if materials[key].role == "solid" and key not in salts]
    if solids:
        if rate.equilibrium_constant is not None:
            raise DataError(
                f"{found.words}: equilibrium: not allowed for a surface reaction ({solids[0]!r} is a solid)"
            )
        values["orders"] = {key: _SURFACE_ORDER if key in solids else 1 for key in found.reactants}
    values["pre_exponential"] = significant(constant * math.exp(activation / (GAS_CONSTANT * ROOM_K)), 6)
    values["activation_energy_j_mol"] = float(activation)
    if rate.equilibrium_constant is not None:
        values["equilibrium_constant"] = rate.equilibrium_constant
    heat = heat_of_reaction(found, materials) / 1000.0
    given = rate.source or "given on the command line"
    words = [
        f"rate constant at 298.15 K {constant:g}: {'a guess' if rate.constant is None else given}",
        f"activation energy: {'a guess' if rate.activation_j_mol is None else given}",
    ]
    if rate.equilibrium_constant is not None:
        words.append(f"equilibrium constant: {given}")
    if solids:
        words.append("orders of a reaction on a surface: a guess")
    values["source"] = (
        f"template {template.smarts}; {'; '.join(words)}; heat by formation enthalpies: {heat:.4g} kJ/mol"
    )
    return values


def _bundled_entries(keys: Iterable[str], materials: Materials) -> dict[str, list[dict[str, Any]]]:
    """Return bundled families' entries for some materials: dissolution of salts, violent reactions with water."""
    present = set(keys)
    salts: dict[str, dict[str, Any]] = {}
    violent: dict[str, dict[str, Any]] = {}
    for path in sorted(shipped_reactions_folder().glob("*.toml")):
        family = load_reactions(path.stem, materials)
        for salt in family.salt:
            if salt.solid in present and salt.solubility is not None:
                salts.setdefault(salt.solid, written(salt))
        for step in family.violent:
            others = set(step.reactants) - {"water"}
            if others and others <= present and "water" in step.reactants:
                violent[" ".join(sorted(step.reactants))] = written(step)
    return {"salt": list(salts.values()), "violent": list(violent.values())}


def family_tables(
    name: str, found: Sequence[Found], materials: Materials, command: str, catalysts: Sequence[str] = ()
) -> dict[str, Any]:
    """Return a validated reaction family.

    Args:
        name: name of the family.
        found: reactions returned by :func:`expand`.
        materials: all participating materials by id.
        command: command that made the family.
        catalysts: required catalysts of the main reactions, of order 1.

    Raises:
        DataError: a material is unknown, or has no formation enthalpy.
    """
    keys = list(dict.fromkeys(key for step in found for key in (*step.reactants, *step.products)))
    for key in (*keys, *catalysts):
        if key not in materials:
            raise DataError(f"unknown material {key!r}; name its file with --materials")
    bundled = _bundled_entries(keys, materials)
    salts = [salt["solid"] for salt in bundled["salt"]]
    entries = [_entry(step, materials, salts) for step in found]
    for step, entry in zip(found, entries, strict=True):
        if catalysts and not step.template.side:
            entry["catalysts"] = dict.fromkeys(catalysts, 1)
    summary = "; ".join(step.words for step in found[:3]) + (f" and {len(found) - 3} more" if len(found) > 3 else "")
    tables = {
        "name": name,
        "summary": summary,
        "lock": lock(command, "rdkit"),
        "reaction": entries,
        **{key: value for key, value in bundled.items() if value},
    }
    validated(ReactionFamily, tables, f"reactions {name!r}")
    return tables
