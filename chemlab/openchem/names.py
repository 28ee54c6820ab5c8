"""Names that denote no single compound: mixtures, solutions, polymers, alloys, supported catalysts; Greek letters.

Lists of chemicals assign such names to a component, to the monomer, or to an unrelated compound: petroleum ether is
listed as benzene.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from typing import Any

from ..config.extras import needs

with needs("names need chemicals", "chem"):
    from chemicals.elements import periodic_table, simple_formula_parser

_GREEK = (
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu", "xi",
    "omicron", "pi", "rho", "sigma", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega",
)  # fmt: skip
"""Greek letters from U+03B1 on; sigma has two forms."""
_LETTERS = {chr(0x3B1 + i): name for i, name in enumerate(_GREEK)}
_DASHES, _PRIMES = (0x2010, 0x2011, 0x2012, 0x2013, 0x2014, 0x2212), (0x2032, 0x2018, 0x2019, 0x02B9)
_SIGNS = {**dict.fromkeys(_DASHES, "-"), **dict.fromkeys(_PRIMES, "'"), 0x2033: "''"}

_METALS = frozenset(("Al", "Ga", "In", "Tl", "Sn", "Pb", "Bi", "Po"))
"""Metals of the p block."""
_SEMIMETALS = frozenset(("B", "Si", "Ge", "As", "Sb", "Se", "Te", "C"))
"""Elements whose solids are as insoluble as metals; carbon is graphite."""

_ALKANES = "a mixture of hydrocarbons"
_POLYMER = "a polymer"
_WATERY = "a solution in water"
_SUPPORTED = "a catalyst on a support"
_MEANINGS: dict[str, tuple[str, str]] = {
    **dict.fromkeys(
        ("petroleum ether", "petrol ether", "petrolether", "pet ether", "pet. ether", "light petroleum", "ligroin",
         "ligroine", "benzine", "petroleum benzine", "petroleum benzin", "skellysolve", "skellysolve b"),
        (_ALKANES, "hexane"),
    ),
    **dict.fromkeys(
        ("gasoline", "petrol", "naphtha", "solvent naphtha", "petroleum naphtha", "white gas"), (_ALKANES, "octane")
    ),
    **dict.fromkeys(
        ("white spirit", "mineral spirits", "mineral spirit", "stoddard solvent", "kerosene", "kerosine",
         "paraffin oil", "mineral oil", "nujol", "diesel", "diesel fuel", "paraffin", "paraffin wax", "petrolatum",
         "vaseline", "crude oil", "petroleum"),
        (_ALKANES, "dodecane"),
    ),
    **dict.fromkeys(("peg", "pego", "polyethylene glycol", "carbowax", "macrogol"), (_POLYMER, "ethylene glycol")),
    **dict.fromkeys(("pvc",), (_POLYMER, "vinyl chloride")),
    **dict.fromkeys(("ptfe", "teflon"), (_POLYMER, "tetrafluoroethylene")),
    **dict.fromkeys(("pmma", "plexiglas", "plexiglass", "lucite"), (_POLYMER, "methyl methacrylate")),
    **dict.fromkeys(("pvp", "povidone"), (_POLYMER, "n-vinyl-2-pyrrolidone")),
    **dict.fromkeys(("pva", "pvac"), (_POLYMER, "vinyl acetate")),
    **dict.fromkeys(("styrofoam",), (_POLYMER, "styrene")),
    **dict.fromkeys(
        ("pet", "nylon", "kevlar", "abs", "rubber", "natural rubber", "latex", "silicone", "silicone oil", "pdms",
         "epoxy", "bakelite", "nafion", "amberlyst", "amberlite", "dowex", "cellulose", "starch", "lignin", "chitosan",
         "cotton", "agar", "gelatin", "protein"),
        (_POLYMER, ""),
    ),
    **dict.fromkeys(("hydrochloric acid", "muriatic acid"), (_WATERY, "hydrogen chloride and water")),
    "hydrobromic acid": (_WATERY, "hydrogen bromide and water"),
    **dict.fromkeys(("hydroiodic acid", "hydriodic acid"), (_WATERY, "hydrogen iodide and water")),
    "hydrofluoric acid": (_WATERY, "hydrogen fluoride and water"),
    **dict.fromkeys(("ammonia water", "ammonia solution", "ammonium hydroxide"), (_WATERY, "ammonia and water")),
    **dict.fromkeys(("formalin", "formol"), (_WATERY, "formaldehyde and water")),
    "vinegar": (_WATERY, "acetic acid and water"),
    "brine": (_WATERY, "the bundled NaCl and water"),
    "bleach": (_WATERY, ""),
    **dict.fromkeys(("spirit", "spirits"), ("a mixture with water", "ethanol and water")),
    "wood spirit": ("a mixture with water", "methanol and water"),
    **dict.fromkeys(("denatured alcohol", "methylated spirit", "methylated spirits"), ("a mixture", "ethanol")),
    "rubbing alcohol": ("a mixture with water", "isopropanol and water"),
    "turpentine": ("a mixture of terpenes", "alpha-pinene"),
    "aqua regia": ("a mixture", "nitric acid, hydrogen chloride and water"),
    "oleum": ("a mixture", "sulfuric acid"),
    "piranha": ("a mixture", "sulfuric acid and hydrogen peroxide"),
    **dict.fromkeys(("dowtherm", "dowtherm a"), ("a mixture", "biphenyl and diphenyl ether")),
    "air": ("a mixture", "the bundled air"),
    "bf3 etherate": ("a complex", "diethyl ether, and a catalyst of your own"),
    "raney nickel": ("a catalyst that is etched from an alloy", "nickel"),
    **dict.fromkeys(("lindlar catalyst", "lindlar's catalyst"), (_SUPPORTED, "palladium")),
    **dict.fromkeys(
        ("celite", "kieselguhr", "diatomaceous earth", "molecular sieve", "molecular sieves", "zeolite", "florisil",
         "silica gel", "silica sand", "sand", "glass"),
        ("a mineral or an adsorbent", "the bundled silica"),
    ),
    **dict.fromkeys(
        ("charcoal", "activated charcoal", "activated carbon", "norit", "carbon black", "coal"),
        ("a carbon material of varying composition", "carbon"),
    ),
    "sugar": ("a name for several compounds", "sucrose"),
    "nak": ("an alloy", "sodium or potassium"),
    **dict.fromkeys(("xylenes", "xylols"), ("a mixture of isomers", "o-xylene, m-xylene or p-xylene")),
    **dict.fromkeys(("cresols", "cresol"), ("a mixture of isomers", "o-cresol, m-cresol or p-cresol")),
    "lutidine": ("a name for several isomers", "2,6-lutidine or another of them"),
    "collidine": ("a name for several isomers", "2,4,6-collidine or another of them"),
}  # fmt: skip
"""Meaning of a name, and its replacement.

The names are those for which the list of chemicals is misleading, and common names that it lacks.
"""

_CARRIERS = r"(?:c|al2o3|sio2|baso4|caco3|tio2|zro2|ceo2|mgo|zno)"
_ACTIVE = ("Pd", "Pt", "Rh", "Ru", "Ni", "Ir", "Au", "Ag", "Cu", "Co", "Fe", "Re", "Os")
_ON_FORMULA = re.compile(
    rf"(?:\d+(?:\.\d+)?\s*(?:wt\.?)?\s*%\s*(?:wt\.?)?\s*)?({'|'.join(_ACTIVE)})(?:\(oh\)2|o2?)?\s*[/@-]\s*{_CARRIERS}",
    re.IGNORECASE,
)
_ON_WORDS = re.compile(
    r"\b(?:on|supported|-bound|bound to|loaded)\b.*\b(?:carbon|charcoal|alumina|silica|carbonate|sulfate|celite|"
    r"graphite|kieselguhr|polymer|polystyrene|zeolite|clay|asbestos)\b|\bpolymer[- ](?:supported|bound)\b"
)
_COUPLE = re.compile(r"(Zn|Na|Al|Mg|K|Li|Sn|Cd)\s*[/(-]\s*(?:Hg|Cu|Zn)\)?", re.IGNORECASE)
_WORDS = (
    (r"\b(?:alloys?|amalgams?|brass|bronze|steel|solder|pewter|couple)\b", "an alloy"),
    (r"\b(?:poly|co|homo|ter)polymers?\b|\bresins?\b|\brubbers?\b|\bplastics?\b|\bsilicones?\b", _POLYMER),
    (r"\b(?:mixtures?|mixed|blends?|emulsions?|suspensions?|isomers)\b", "a mixture"),
    (r"\b(?:solutions?|aqueous|aq|concentrated|conc|dilute)\b|\d\s*(?:%|m\b.*\bin\b)", "a solution"),
    (r"\b(?:petroleum|naphtha|ligroine?|kerosene|kerosine|gasoline)\b", _ALKANES),
    (r"\b(?:spirits?|oils?|oleoresin|essences?|extracts?|balsam|wax|waxes|tar|pitch|asphalt|bitumen|turpentine|"
     r"fuels?)\b", "a mixture"),
)  # fmt: skip
_PLURAL = re.compile(r"[\w,' -]*(?:anes|enes|ynes|ols|ones|ines|alcohols|acids|ethers|esters)")
_UNIQUE = frozenset((
    "dioxane", "quinone", "benzoquinone", "naphthoquinone", "deet", "d2", "deta", "tyrosine", "salicylate", "oxedrine",
    "orsellinic acid", "phthaloyl chloride", "phthalyl dichloride", "phthalodinitrile", "toluenesulfonyl chloride",
    "acetaminophenol", "l-sarcolysin", "dl-sarcolysin", "arsanilic acid", "octopamine", "terphenyl",
))  # fmt: skip
"""Names that denote one isomer without stating its position."""
_PLACES = ("o-", "m-", "p-", "ortho-", "meta-", "para-")


def is_metal(composition: Mapping[str, int]) -> bool:
    """Return True for an element whose solid is a metal, a semi-metal or graphite, which no liquid dissolves."""
    element = next(iter(composition))
    return len(composition) == 1 and (element in _SEMIMETALS or _metallic(element))


def is_mineral(composition: Mapping[str, int]) -> bool:
    """Return True for a carbon-free compound of a metal or an oxide of a semi-metal.

    Such a solid is a salt or a mineral, however its structure is drawn.
    """
    elements = composition.keys()
    oxide = len(elements) == 2 and "O" in elements and not elements.isdisjoint(_SEMIMETALS)
    return len(elements) > 1 and "C" not in elements and (oxide or any(map(_metallic, elements)))


def _metallic(element: str) -> bool:
    block = getattr(periodic_table, element).block
    return element in _METALS or (block in ("s", "d", "f") and element not in ("H", "He"))


def spellings(text: str) -> list[str]:
    """Return spellings of a name in the list of chemicals, the likeliest first: lower case, Greek letters in words."""
    plain = unicodedata.normalize("NFKC", text).translate(_SIGNS).lower()
    plain = re.sub(r"\.([a-z]+)\.", lambda m: m[1] if m[1] in _GREEK else m[0], plain)
    spelled = "".join(_LETTERS.get(letter, letter) for letter in plain)
    dashed = re.sub(rf"\b({'|'.join(_GREEK)})[ ]?(?=\d)", r"\1-", spelled)
    joined = re.sub(rf"\b({'|'.join(_GREEK)}) ", r"\1-", dashed)
    return list(dict.fromkeys((text.lower(), spelled, dashed, joined)))


def element_of(text: str) -> str | None:
    """Return the CAS number of the metal with this symbol, or None; case-sensitive."""
    known = text.isalpha() and len(text) <= 2 and hasattr(periodic_table, text) and text[0].isupper()
    if not known or text in ("B", "C") or not is_metal({text: 1}):
        return None
    return str(getattr(periodic_table, text).CAS)


def _formula(text: str) -> dict[str, float]:
    """Return the atoms of a formula that begins with a metal; empty if the text is not such a formula."""
    parts = re.findall(r"[A-Z][a-z]?", text)
    if not re.fullmatch(r"(?:[A-Z][a-z]?\d*)+", text) or not all(hasattr(periodic_table, part) for part in parts):
        return {}
    return dict(simple_formula_parser(text)) if is_metal({parts[0]: 1}) and parts[0] != "C" else {}


def meaning(text: str, name: str, entry: Any, index: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return the meaning of a name that denotes no single compound, and its replacement ("" if there is none).

    Args:
        text: the given text.
        name: the text in lower case, with Greek letters spelled out.
        entry: entry of the list of chemicals under this name or number, or None.
        index: the list of chemicals by name.

    Returns:
        None if the name denotes a single compound.
    """
    listed = str(entry.common_name) if entry else ""
    same = listed.lower() in ("", name)
    if name in _MEANINGS:
        return _MEANINGS[name]
    if found := _ON_FORMULA.fullmatch(name):
        return _SUPPORTED, getattr(periodic_table, found[1].capitalize()).name.lower()
    if _ON_WORDS.search(name):
        return _SUPPORTED, "" if same else listed
    if found := _COUPLE.fullmatch(name):
        return "an alloy", getattr(periodic_table, found[1].capitalize()).name.lower()
    if entry and re.fullmatch(r"[89]0\d\d-\d\d-\d", entry.CASs):
        return f"a mixture or a polymer by its CAS number, {entry.CASs}", ""
    if name.startswith("poly") and entry:
        monomer = name[4:].strip("()[] -")
        if monomer in index or not listed.lower().startswith("poly"):
            return _POLYMER, monomer if same and monomer in index else "" if same else listed
    for words, kind in _WORDS:
        if re.search(words, name):
            rest = re.sub(rf"{words}|\d+(?:\.\d+)?\s*%", " ", name).strip(" ,()")
            return kind, (rest if rest in index else "") if same else listed
    if _PLURAL.fullmatch(name) and name[:-1] in index:
        return "a mixture of isomers or a class of compounds", name[:-1]
    atoms = _formula(text)
    if atoms and entry and dict(simple_formula_parser(entry.formula)) != atoms:
        return "a formula, and in the list of chemicals a name of another compound", ""
    if entry and (isomers := _isomers(name, entry, index)):
        return "a name of several isomers, which are sold as a mixture", " or ".join(sorted(isomers))
    return None


def _isomers(name: str, entry: Any, index: Mapping[str, Any]) -> list[str]:
    """Return the isomers that a name without a position may denote: o-, m- and p-xylene for xylene.

    The list is empty for a name that denotes one compound.
    """
    if name in {str(entry.common_name).lower(), str(entry.iupac_name).lower()} | _UNIQUE:
        return []
    isomers: dict[str, str] = {}
    for key in (f"{place}{name}" for place in _PLACES):
        if key in index and index[key].formula == entry.formula:
            isomers.setdefault(index[key].CASs, key)
    return list(isomers.values()) if len(isomers) > 1 else []
