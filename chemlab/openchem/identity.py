"""Identification of a compound from a CAS number, a name or a structure, offline."""

from __future__ import annotations

import difflib
import functools
import re
from dataclasses import dataclass
from typing import Any

from ..config.catalogue import matches
from ..config.datafile import DataError
from ..config.extras import needs
from ..config.materials import LOCK, shipped_materials
from .names import element_of, meaning, spellings

with needs("open chemistry needs rdkit and chemicals", "chem"):
    from chemicals.elements import periodic_table
    from chemicals.identifiers import check_CAS, pubchem_db
    from rdkit import Chem, RDLogger
    from rdkit.Chem.rdMolDescriptors import CalcMolFormula

RDLogger.DisableLog("rdApp.*")

_LONGEST = 500
"""Maximum length of a name or a structure in characters.

Longer chains have no estimated properties, and the time of structure algorithms is a power of the length.
"""
_LONGEST_KEY = 100
_LONGEST_NAME = 60
"""Maximum length of a name that is compared with similar names."""
_CAS = re.compile(r"\d{2,7}-\d{2}-\d")
_WEIGHTS = {"H": 1.00794, "C": 12.0107, "N": 14.0067, "O": 15.9994, "Na": 22.98977, "Cl": 35.453, "Ar": 39.948}
"""Atomic weights of the bundled files; reactions conserve mass only if all files use the same."""


@dataclass(frozen=True)
class Compound:
    """A molecule or an element."""

    key: str
    """Id of the compound's table in a material file."""
    name: str
    formula: str
    smiles: str
    """Canonical SMILES by RDKit."""
    inchi_key: str
    cas: str | None = None
    common_name: str = ""
    """Name in the list of chemicals, independent of the given name; empty if the compound is not listed."""

    @property
    def composition(self) -> dict[str, int]:
        """Atoms by element."""
        return composition_of(parsed(self.smiles, self.key))


def check_length(text: str, what: str) -> None:
    """Check the length of a name, structure or template.

    Raises:
        DataError: it is too long, or not printable; the message names ``what``.
    """
    if len(text) > _LONGEST or not text.isprintable():
        raise DataError(f"{what:.80}: must be {_LONGEST} printable characters at most, given {len(text)}: {text!r:.80}")


def parsed(smiles: str, what: str) -> Any:
    """Parse a structure with RDKit.

    Raises:
        DataError: it is not a structure, or too long; the message names ``what``.
    """
    check_length(smiles, what)
    molecule = Chem.MolFromSmiles(smiles) if smiles else None
    if not _is_structure(molecule):
        raise DataError(f"{what}: {smiles!r} is not a structure (SMILES)")
    return molecule


def _is_structure(molecule: Any) -> bool:
    """Return True if a molecule has atoms and each is of an element; in SMILES, a star is any atom."""
    return molecule is not None and molecule.GetNumAtoms() > 0 and all(a.GetAtomicNum() for a in molecule.GetAtoms())


def canonical(smiles: str, what: str) -> str:
    """Return the canonical SMILES of a structure.

    Raises:
        DataError: it is not a structure.
    """
    return str(Chem.MolToSmiles(parsed(smiles, what)))


def composition_of(molecule: Any) -> dict[str, int]:
    """Return the atoms of a molecule by element, carbon and hydrogen first."""
    counts: dict[str, int] = {}
    for atom in molecule.GetAtoms():
        counts[atom.GetSymbol()] = counts.get(atom.GetSymbol(), 0) + 1
        if hydrogens := atom.GetTotalNumHs():
            counts["H"] = counts.get("H", 0) + hydrogens
    return dict(sorted(counts.items(), key=lambda item: ({"C": 0, "H": 1}.get(item[0], 2), item[0])))


def molar_mass(composition: dict[str, int]) -> float:
    """Return the molar mass in g/mol; elements of the bundled files have the atomic weights of these files."""
    return float(
        sum(n * _WEIGHTS.get(element, getattr(periodic_table, element).MW) for element, n in composition.items())
    )


@functools.cache
def structures() -> dict[str, str]:
    """Return the ids of the bundled materials by canonical structure."""
    return {canonical(m.smiles, key): key for key, m in shipped_materials().items() if m.smiles}


def _checked_key(key: str) -> str:
    """Check the id of a material.

    Raises:
        DataError: it is not valid in a material file.
    """
    if len(key) > _LONGEST_KEY or not key.isprintable() or key == LOCK:
        raise DataError(
            f"{key!r:.80}: the id of a material must be {_LONGEST_KEY} printable characters at most, and not {LOCK}; "
            "give it another with --name KEY=WHAT"
        )
    return key


def _key(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip().lower())


def _near(text: str) -> str:
    """Return a suggestion of similar names as the end of a message; empty if there is none."""
    near = [key.replace("_", " ") for key in matches(text)]  # abbreviations, as THF
    if not near and 3 < len(text) <= _LONGEST_NAME:
        text = text.lower()
        # A comparison with all of the million names would take a second.
        similar = [name for name in pubchem_db.name_index if name[:1] == text[0] and abs(len(name) - len(text)) <= 2]
        near = difflib.get_close_matches(text, similar, 2, 0.8)
    return f"; did you mean {' or '.join(map(repr, near))}?" if near else ""


def _check_molecule(molecule: Any, text: str) -> None:
    """Check that a molecule is a single, neutral one of natural isotopes.

    Raises:
        DataError: it is a salt, an ion, several molecules, or isotopically labelled.
    """
    fragments, charge = len(Chem.GetMolFrags(molecule)), Chem.GetFormalCharge(molecule)
    charged = any(atom.GetFormalCharge() for atom in molecule.GetAtoms())
    if charge != 0 or (fragments > 1 and charged):
        shipped = structures().get(str(Chem.MolToSmiles(molecule)))
        what = f"has a charge of {charge:+d}" if fragments == 1 else f"has {fragments} fragments"
        use = f"use the bundled material {shipped!r}" if shipped else "use a bundled material"
        raise DataError(
            f"{text!r}: {what}: ions and salts have no boiling point and no groups for estimates; {use}, or write its "
            "tables by hand (docs: Write a material or a reaction), solubilities included"
        )
    if fragments > 1:
        raise DataError(f"{text!r}: has {fragments} fragments that do not form a salt; give each molecule separately")
    if any(atom.GetIsotope() for atom in molecule.GetAtoms()):
        for atom in molecule.GetAtoms():
            atom.SetIsotope(0)
        natural = Chem.MolToSmiles(Chem.RemoveHs(molecule))
        raise DataError(
            f"{text!r}: names an isotope; properties are those of the natural elements: give {natural} without it"
        )


def _check_name(text: str, name: str, entry: Any) -> None:
    """Check that a name denotes a single compound.

    Raises:
        DataError: it denotes a mixture, a polymer or several compounds; the message proposes alternatives.
    """
    if found := meaning(text, name, entry, pubchem_db.name_index):
        what, instead = found
        known = f" (the list of chemicals has {entry.common_name!r} under it)" if entry else ""
        take = f"take {instead}" if instead else f"give name, CAS number or structure of one compound{known}"
        raise DataError(f"{text!r} is {what}, and a material is one compound; {take}")


def _entry_of(text: str) -> tuple[Any, str]:
    """Look up a CAS number or a name in the list of chemicals.

    Returns:
        The entry or None, and the name in ASCII letters; the name is empty for a CAS number or without an entry.

    Raises:
        DataError: the text looks like a CAS number but is not one, or the name does not denote a single compound.
    """
    if _CAS.fullmatch(text):
        if not check_CAS(text):
            raise DataError(f"{text!r} is not a CAS number: its check digit is wrong")
        entry = pubchem_db.search_CAS(text)
        if not entry:
            raise DataError(f"{text!r}: this CAS number is not in the list of chemicals; give the structure (SMILES)")
        _check_name(text, text, entry)
        return entry, ""
    if element := element_of(text):
        return pubchem_db.search_CAS(element), text
    names = spellings(text)
    name = next((name for name in names if pubchem_db.search_name(name)), names[-1])
    entry = pubchem_db.search_name(name) or None
    _check_name(text, name, entry)
    plain = text if text.isascii() else name
    return entry, plain if entry else ""


def compound_of(text: str, key: str = "", structure: bool = False) -> Compound:
    """Return the compound that a text denotes.

    Args:
        text: a CAS number, an English name (as in PubChem; Greek letters or alpha, beta), or a structure (SMILES);
            tried in this order.
        key: id of the compound; default: its name with ``_`` for spaces.
        structure: whether to interpret the text as a structure only.

    Raises:
        DataError: the text is none of these or too long; denotes a salt, an ion, a mixture, a polymer or an
            isotopically labelled compound; or is both a name or formula of one compound and the structure of another.
    """
    text = text.strip()
    check_length(text, "compound")
    entry, named = (None, "") if structure or not text else _entry_of(text.replace("_", " "))
    drawn = Chem.MolFromSmiles(text) if text else None
    molecule: Any = parsed(entry.smiles, text) if entry else drawn
    if not _is_structure(molecule):
        raise DataError(
            f"{text!r}: unknown: neither a CAS number nor a name in the list of chemicals, nor a structure; give one "
            f"of these, a structure as SMILES (ethanol: CCO){_near(text.replace('_', ' '))}"
        )
    inchi_key = str(Chem.MolToInchiKey(molecule))
    listed: Any = entry
    if not entry and not structure and molecule.GetNumAtoms() > 1:  # CO: carbon monoxide, or the structure of methanol
        listed = pubchem_db.search_formula(text)
    drawn_key = str(Chem.MolToInchiKey(drawn)) if listed and _is_structure(drawn) else ""
    if drawn_key and drawn_key != (inchi_key if entry else listed.InChI_key):
        other = pubchem_db.search_InChI_key(drawn_key)
        raise DataError(
            f"{text!r}: is both a {'name' if entry else 'formula'} of {listed.common_name} (CAS number {listed.CASs}) "
            "and a structure (SMILES)"
            f"{f', of {other.common_name} (CAS number {other.CASs})' if other else ''}; give the number of one of them"
        )
    _check_molecule(molecule, text)
    entry = entry or pubchem_db.search_InChI_key(inchi_key) or None
    formula = str(CalcMolFormula(molecule))
    common = _common_name(entry) if entry else ""
    name = named or common or formula
    return Compound(
        _checked_key(key or _key(name)),
        name,
        formula,
        str(Chem.MolToSmiles(molecule)),
        inchi_key,
        entry.CASs if entry else None,
        common,
    )


def _common_name(entry: Any) -> str:
    """Return an entry's common name, or its IUPAC name if the list has a CAS number in place of the common name."""
    return str(entry.iupac_name if _CAS.fullmatch(entry.common_name) and entry.iupac_name else entry.common_name)
