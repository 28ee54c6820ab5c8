"""The catalogue: everyday chemicals by any of their names, and activity coefficients of every two of them.

``chemlab/data/catalogue`` has a material file for each molecule (``KEY.toml``), salts and ions in ``_salts.toml``, how
they dissolve and ionize in ``_reactions.toml``, every spelling that is understood in ``names.csv``, and NRTL parameters
in ``pairs.csv``. Only :class:`chemlab.sandbox.Flask` reads it, and only the files of
what it holds; scenarios name the files that they want. A user's own folder (:func:`user_folder`) has the same files for
what was added by :meth:`chemlab.sandbox.Flask.material`. ``studies/tools/catalogue.py`` makes the bundled files.
"""

from __future__ import annotations

import csv
import difflib
import functools
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from .datafile import DataError, read_toml
from .files import write_text
from .materials import Material, load_materials, shipped_materials
from .pairs import Pair

FOLDER = Path(__file__).parent.parent / "data" / "catalogue"
SALTS, FAMILY = FOLDER / "_salts.toml", FOLDER / "_reactions.toml"
IDEAL_PAIR = "ideal"
"""Form of a pair without UNIFAC groups or interactions: all activity coefficients are 1."""
SOURCES = {
    IDEAL_PAIR: "estimate: ideal mixture, all activity coefficients 1; no form of UNIFAC describes both",
    "azeotrope": "through the azeotrope at 101.325 kPa, Gmehling et al. (2004) (as remembered, not looked up)",
}
_PAIR_CELLS, _WATER_PKA = 11, 14.0
_LONGEST_KEY = 100
"""Characters; a file is named by its key."""
LOW_K, HIGH_K = 270.0, 480.0
"""Range of temperatures of the fits."""

REAGENTS: dict[str, dict[str, float]] = {
    "hydrochloric acid": {"H+": 1.0, "Cl-": 1.0},
    "hydrobromic acid": {"H+": 1.0, "Br-": 1.0},
    "nitric acid": {"H+": 1.0, "NO3-": 1.0},
    "sulfuric acid": {"H+": 1.0, "HSO4-": 1.0},
}
"""Strong acids, which are ions in water: mol of each ion in a mol of the acid."""


@functools.lru_cache(maxsize=1)
def acids_and_bases() -> frozenset[str]:
    """Return the acids of ``_reactions.toml``, their bases, and the salts of these.

    An acid weaker than water (ethanol) is none; its base is one.
    """
    family = read_toml(FAMILY)
    species = {
        name
        for acid in family["acid"]
        for name, pka in zip(acid["species"], [*acid["pka"], 0.0], strict=True)
        if pka < _WATER_PKA
    }
    return frozenset(species | {salt["solid"] for salt in family["salt"] if salt["anion"] in species})


@functools.lru_cache(maxsize=1)
def salts() -> tuple[str, ...]:
    """Return the salts that dissolve in water."""
    return tuple(salt["solid"] for salt in read_toml(FAMILY)["salt"])


class CataloguePair(NamedTuple):
    """A row of ``pairs.csv``."""

    one: str
    other: str
    form: str
    """Of UNIFAC, ``azeotrope`` or ``ideal``."""
    alpha: float
    error: float
    """Largest error of ln gamma against UNIFAC, from 270 to 480 K where the two mix and at infinite dilution."""
    parameters: tuple[float, ...]
    """a12, a21, b12, b21, c12, c21"""

    def pair(self) -> Pair:
        """The same as a pair of a pair file."""
        a12, a21, b12, b21, c12, c21 = self.parameters
        return Pair(
            of=(self.one, self.other),
            a=(a12, a21),
            b=(b12, b21),
            c=(c12, c21),
            alpha=self.alpha,
            low_k=LOW_K,
            high_k=HIGH_K,
            error=self.error,
            source=SOURCES.get(self.form, self.form),
        )


def user_folder() -> Path:
    """The folder of chemicals that were added on this machine: ``CHEMLAB_CATALOGUE``, or in the user's cache."""
    own = os.environ.get("CHEMLAB_CATALOGUE")
    # Users without a home folder, as in some containers, have it in the working directory.
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache").removeprefix("~/")
    return Path(own) if own else Path(cache) / "chemlab" / "catalogue"


def normalized(name: str) -> str:
    """A name without capitals, and with one space for blanks and underscores."""
    return re.sub(r"[\s_]+", " ", name.strip()).casefold()


def spellings() -> dict[str, tuple[str, ...]]:
    """Keys by spelling: of names and formulas :func:`normalized`, of structures as they are written.

    What was added on this machine changes no bundled spelling.

    Raises:
        DataError: the list of what was added is malformed.
    """
    own = user_folder() / "names.csv"
    return {**_spellings(own, own.stat().st_mtime_ns if own.is_file() else 0), **_spellings(FOLDER / "names.csv", 0)}


@functools.lru_cache(maxsize=4)
def _spellings(path: Path, _changed: int) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for spelling, key in _rows(path, 2):
        found[spelling] = (*found.get(spelling, ()), key)
    return found


def _rows(path: Path, width: int, begin: tuple[str, ...] = ("",)) -> Iterator[list[str]]:
    """The rows of a list, of lines that begin with one of some texts; none without a file.

    Raises:
        DataError: a row does not have ``width`` cells, or the file is not UTF-8.
    """
    if not path.is_file():
        return
    try:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.reader(line for line in file if line.startswith(begin)):
                if len(row) != width:
                    raise _malformed(path, row, f"has {len(row)} cells, not {width}")
                yield row
    except (csv.Error, UnicodeDecodeError) as error:
        raise DataError(f"{path}: is not a table of {width} columns: {error}; correct it, or delete it") from error


def _malformed(path: Path, row: list[str], what: str) -> DataError:
    return DataError(f"{path}: the line {','.join(row)!r:.100} {what}; correct it, or delete it")


def matches(text: str) -> tuple[str, ...]:
    """Keys of what a text may mean: a name, a formula, a CAS number or a structure (SMILES).

    Raises:
        DataError: the list of what was added on this machine is malformed.
    """
    known, folded = spellings(), normalized(text)
    # C1CCSC1 is another structure than c1ccsc1.
    return known.get(text.strip()) or (() if _AROMATIC.fullmatch(folded) else known.get(folded, ()))


_AROMATIC = re.compile(r"[cnos()=\d]*[cnos]1[cnos()=\d]*")
"""Structures of a ring, in which small letters mean aromatic atoms."""


def key_of(name: str, inchi_key: str) -> str:
    """A free key for a new compound: its name without characters that files do not have, else its InChIKey."""
    key = re.sub(r"[^\w,.+()-]", "", re.sub(r"\s+", "_", name.strip().lower().translate(_BRACKETS))).lstrip("_.")
    taken = (
        not 0 < len(key) <= _LONGEST_KEY
        or key in shipped_materials()
        or matches(key)
        or (user_folder() / f"{key}.toml").exists()
    )
    return inchi_key if taken else key


_BRACKETS = str.maketrans("[]{}", "()()")


def closest(text: str) -> list[str]:
    """Names that a misspelt one may have meant."""
    known = spellings()
    near = difflib.get_close_matches(normalized(text), known, 3, 0.7)
    ends = [name for name in known if name.endswith((f"-{normalized(text)}", f" {normalized(text)}"))]
    return list(dict.fromkeys([*ends[:3], *near]))[:3]


def unknown_material(name: str, known: Iterable[str]) -> str:
    """Return the words of an error about a material that a file names and that is not among ``known``."""
    near = [key for key in matches(name) if key in known] or difflib.get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return (
        f"unknown material {name!r}; {hint}choose from {', '.join(sorted(known))}; chemlab data material makes files "
        "of others, which a scenario names under material_files"
    )


def wrong_cas(text: str) -> bool:
    """Return True for a text in the form of a CAS number with a wrong check digit."""
    if not re.fullmatch(r"\d{2,7}-\d{2}-\d", text.strip()):
        return False
    *digits, check = (int(digit) for digit in text.strip() if digit != "-")
    return sum(place * digit for place, digit in enumerate(reversed(digits), 1)) % 10 != check


def catalogue_material(key: str) -> tuple[Path, Material] | None:
    """The file and the material of a key, None if the catalogue does not have it.

    Raises:
        DataError: the file is malformed.
    """
    if not re.fullmatch(r"[\w,.+() -]+", key) or key.startswith("_") or len(key) > _LONGEST_KEY:
        return None
    for path in (FOLDER / f"{key}.toml", user_folder() / f"{key}.toml", SALTS):
        if path.is_file() and key in (found := _read(path, path.stat().st_mtime_ns)):
            return path, found[key]
    return None


@functools.lru_cache(maxsize=256)
def _read(path: Path, _changed: int) -> dict[str, Material]:
    return load_materials([path])


def keep_material(key: str, text: str, names: Iterable[str]) -> Path:
    """Write a material file and its names into the user's folder, and return the file's path.

    Raises:
        DataError: the list of names there is malformed.
        OSError: the folder cannot be written to.
    """
    path = user_folder() / f"{key}.toml"
    write_text(path, text)
    keep_names(key, names)
    return path


def keep_names(key: str, names: Iterable[str]) -> None:
    """Write further spellings of a key into the user's folder.

    Raises:
        DataError: the list of names there is malformed.
        OSError: the folder cannot be written to.
    """
    listed, made = user_folder() / "names.csv", dict.fromkeys(names, key)
    rows = [(spelling, of) for spelling, of in _rows(listed, 2) if spelling not in made]
    write_text(listed, names_text([*rows, *made.items()]))


def keep_pairs(rows: Iterable[CataloguePair]) -> None:
    """Add rows to ``pairs.csv`` of the user's folder.

    Raises:
        OSError: the folder cannot be written to.
    """
    path = user_folder() / "pairs.csv"
    before = path.read_text(encoding="utf-8") if path.is_file() else ""
    write_text(path, before + ("" if before.endswith("\n") or not before else "\n") + pairs_text(rows))


def catalogue_pairs(wanted: Iterable[frozenset[str]]) -> dict[frozenset[str], Pair]:
    """Those of some pairs that the catalogue has.

    Raises:
        DataError: the list of what was added on this machine is malformed.
    """
    left = set(wanted)
    begin = tuple(f"{_cell(name)}," for name in set[str]().union(*left))
    found: dict[frozenset[str], Pair] = {}
    for path in (FOLDER / "pairs.csv", user_folder() / "pairs.csv"):
        for row in _rows(path, _PAIR_CELLS, begin) if left else ():
            if frozenset(row[:2]) in left:
                try:
                    alpha, off, *parameters = map(float, row[3:])
                    made = CataloguePair(row[0], row[1], row[2], alpha, off, tuple(parameters)).pair()
                except ValueError as error:
                    raise _malformed(path, row, "has a cell that is not a number or is out of bounds") from error
                found[frozenset(row[:2])] = made
        left -= set(found)
    return found


def pairs_text(rows: Iterable[CataloguePair]) -> str:
    """The text of a ``pairs.csv``."""
    lines = (
        ",".join([_cell(row.one), _cell(row.other), row.form, *(f"{n:g}" for n in (row.alpha, row.error))])
        + "".join(f",{number:.5g}" for number in row.parameters)
        for row in rows
    )
    return "".join(f"{line}\n" for line in lines)


def names_text(rows: Iterable[tuple[str, str]]) -> str:
    """The text of a ``names.csv``, of spellings and keys."""
    return "".join(f"{_cell(spelling)},{_cell(key)}\n" for spelling, key in rows)


def _cell(text: str) -> str:
    return '"{}"'.format(text.replace('"', '""')) if "," in text or '"' in text else text
