"""Binary NRTL parameters from UNIFAC.

The first suitable form of UNIFAC is used: the Dortmund form, the original, or the Dortmund form with interactions
completed by machine learning. A form is suitable if it has all groups and interactions and does not extrapolate them
too far. For water with hydrocarbons and their chlorides, the original comes first, or the last where chlorine is on an
aromatic ring; for carbonates, the original comes last.

Parameters are fitted to ln gamma from 270 to 480 K at all compositions that do not split into two liquids, infinite
dilution included. Groups are from thermo's list for a CAS number, else from ugropy for the structure.
``studies/tools/pairs.py`` fits measured pairs to the measurements instead.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..config.catalogue import IDEAL_PAIR, SOURCES, CataloguePair
from ..config.datafile import DataError
from ..config.extras import needs
from ..config.materials import Material, Materials
from ..config.pairs import REFERENCE_K, log_activity_coefficients
from .fits import FINE, QUICK, Array, Grid, fits

with needs("activity coefficients need thermo", "chem"):
    import chemicals
    import thermo.unifac

_WIDEST, _LEAST = 6.0, -8.0
"""Largest change of ln gamma at infinite dilution from 270 to 480 K, and least ln gamma.

Beyond either, a form's group parameters are extrapolated too far in temperature, and the next form is used.
"""
_CHUNK = 20
"""Number of pairs that are fitted at once."""

GROUPS: dict[str, dict[str, int]] = {
    # Groups of an isomer, for molecules that neither form of UNIFAC can represent.
    "acetanilide": {"ACH": 5, "AC": 1, "CONHCH3": 1},  # N-methylbenzamide
    "acetic_anhydride": {"CH3CO": 1, "CH3COO": 1},  # the halves represented as a ketone and an ester
    "2,4-difluoronitrobenzene": {"ACH": 3, "ACF": 2, "ACNO2": 1},
    # A nitrogen between a ring and two CH2 is represented by that of a tertiary aliphatic amine; positional isomers are
    # equal.
    "ortho_pyrrolidinyl": {"ACH": 3, "AC": 1, "ACF": 1, "ACNO2": 1, "CY-CH2": 3, "CH2N": 1},
    "para_pyrrolidinyl": {"ACH": 3, "AC": 1, "ACF": 1, "ACNO2": 1, "CY-CH2": 3, "CH2N": 1},
    "bis_pyrrolidinyl": {"ACH": 3, "AC": 2, "ACNO2": 1, "CY-CH2": 6, "CH2N": 2},
}

_ALIPHATIC = {"CH3", "CH2", "CH", "C", "CH2=CH", "CH=CH", "CH2=C", "CH=C"}
_AROMATIC = {"ACH", "AC", "ACCH3", "ACCH2", "ACCH"}
APOLAR = _ALIPHATIC | _AROMATIC | {"CH2CL", "CHCL", "CCL", "ACCL"}
"""Groups of materials that hardly mix with water.

For the water that they dissolve, the original UNIFAC is right within 0.5 (hexane: x = 7e-4, measured 5e-4), and the
Dortmund form ten times too high. With chlorine on an aromatic ring (``ACCL``), modified UNIFAC 2.0 is best
(chlorobenzene: 0.004; original 0.16, Dortmund 0.03; measured, as remembered: 0.003).
"""

CARBONATES = {"(CH3)2CB", "(CH2)2CB", "CH2CH3CB"}
"""Groups of carbonates, which the original UNIFAC takes for an ether and an ester.

With it, dimethyl carbonate and methanol have no azeotrope (measured: 336.9 K, x = 0.14; modified UNIFAC 2.0: 336.5 K,
0.15; as remembered).
"""

Groups = dict[int, int]


@dataclass(frozen=True)
class Model:
    """A form of UNIFAC: thermo's version number, groups and interactions."""

    name: str
    version: int
    subgroups: Mapping[int, Any]
    interactions: Mapping[int, Mapping[int, Any]]
    assignments: Mapping[str, Groups]

    def groups(self, key: str, material: Material) -> Groups | None:
        """Return the groups of a material, or None if unknown."""
        if key in GROUPS:
            numbers = {group.group: number for number, group in self.subgroups.items()}
            known = numbers.keys() >= GROUPS[key].keys()
            return {numbers[name]: n for name, n in GROUPS[key].items()} if known else None
        if material.cas is not None:
            try:
                listed = self.assignments.get(chemicals.search_chemical(material.cas).InChI_key)
            except ValueError:  # the CAS number is not listed
                listed = None
            if listed:
                return dict(listed)
        return _groups_of_structure(material.smiles, self.version) if material.smiles else None

    def lacks(self, groups: Iterable[Groups]) -> bool:
        """Return True if an interaction between some of the groups is missing."""
        mains = {self.subgroups[number].main_group_id for found in groups for number in found}
        return any(j not in self.interactions.get(i, {}) for i, j in itertools.permutations(mains, 2))

    def log_gamma(self, groups: list[Groups], grid: Grid = FINE) -> Array:
        """Return [T, X, 2] ln of the activity coefficients of two materials."""
        mixture = thermo.unifac.UNIFAC.from_subgroups(
            T=300.0,
            xs=[0.5, 0.5],
            chemgroups=groups,
            version=self.version,
            interaction_data=self.interactions,
            subgroups=self.subgroups,
        )
        rows = [
            [mixture.to_T_xs(t, [x, 1.0 - x]).gammas() for x in grid.fractions.tolist()]
            for t in grid.temperatures_k.tolist()
        ]
        return np.log(np.array(rows))


@functools.cache
def _groups_of_structure(smiles: str, version: int) -> Groups | None:
    """Return the groups of a structure by ugropy for a form of UNIFAC, given by thermo's version number; or None."""
    try:
        import ugropy
    except ImportError:
        return None
    found = (ugropy.dortmund if version else ugropy.unifac).get_groups(
        smiles, "smiles", search_multiple_solutions=False
    )
    return {int(number): int(count) for number, count in found.subgroups_num.items()} or None


@functools.cache
def models() -> list[Model]:
    """Return the forms of UNIFAC in the order of preference."""
    u = thermo.unifac
    u.load_unifac_ip()
    u.load_group_assignments_DDBST()
    return [
        Model("UNIFAC (Dortmund)", 1, u.DOUFSG, u.DOUFIP2016, u.DDBST_MODIFIED_UNIFAC_assignments),
        Model("UNIFAC", 0, u.UFSG, u.UFIP, u.DDBST_UNIFAC_assignments),
        # Hayer, Hasse, Jirasek, Modified UNIFAC 2.0: a group-contribution method completed with machine learning.
        Model("modified UNIFAC 2.0", 1, u.DOUFSG, u.DOUF2IP, u.DDBST_MODIFIED_UNIFAC_assignments),
    ]


def nrtl(parameters: Array, alpha: float, temperatures: Array, fractions: Array) -> Array:
    """Return [T, X, 2] ln gamma by NRTL with ``parameters`` a12, a21, b12, b21, c12, c21."""
    tau = np.zeros((len(temperatures), 1, 2, 2))
    rest = np.log(temperatures / REFERENCE_K)
    tau[:, 0, 0, 1] = parameters[0] + parameters[2] / temperatures + parameters[4] * rest
    tau[:, 0, 1, 0] = parameters[1] + parameters[3] / temperatures + parameters[5] * rest
    mixtures = np.broadcast_to(np.stack([fractions, 1.0 - fractions], axis=-1), (len(temperatures), len(fractions), 2))
    return log_activity_coefficients(mixtures, np.broadcast_to(tau, (*mixtures.shape, 2)), np.array(alpha))


class Fit(NamedTuple):
    """NRTL parameters a12, a21, b12, b21, c12, c21; alpha; and the largest error of ln gamma."""

    parameters: Array
    alpha: float
    error: float


def _named_groups(name: str, materials: Materials, form: Model) -> set[str]:
    """Return the names of a material's groups; an empty set if they are unknown."""
    return {form.subgroups[number].group for number in form.groups(name, materials[name]) or ()}


def _forms(names: tuple[str, str], materials: Materials) -> Iterator[tuple[Model, list[Groups]]]:
    """Yield the forms of UNIFAC that have all groups and interactions of two materials, and the groups in each."""
    forms = models()
    groups_of = [_named_groups(name, materials, forms[0]) for name in names]
    for names_of in groups_of if "water" in names else ():
        if names_of and names_of <= APOLAR:
            best = "modified UNIFAC 2.0" if "ACCL" in names_of else "UNIFAC"
            forms = sorted(forms, key=lambda form: form.name != best)
    if any(names_of & CARBONATES for names_of in groups_of):
        forms = sorted(forms, key=lambda form: form.name == "UNIFAC")
    for form in forms:
        groups = [found for name in names if (found := form.groups(name, materials[name])) is not None]
        if len(groups) == len(names) and not form.lacks(groups):
            yield form, groups


def best_form(names: tuple[str, str], materials: Materials) -> tuple[Model, list[Groups]] | None:
    """Return the form of UNIFAC for two materials, and their groups in it.

    None if no form has all groups and interactions, and coefficients that are not extrapolated too far.
    """
    return next(((form, groups) for form, groups in _forms(names, materials) if _is_sound(form, groups)), None)


def _is_sound(form: Model, groups: list[Groups]) -> bool:
    """Return False if ln gamma by a form's group parameters is extrapolated too far."""
    curve = _curve(form.name, *map(_sorted, groups))
    ends = np.stack([curve[:, 0, 0], curve[:, -1, 1]])
    return bool(curve.min() >= _LEAST and np.ptp(ends, axis=1).max() <= _WIDEST)


def _sorted(groups: Groups) -> tuple[tuple[int, int], ...]:
    return tuple(sorted(groups.items()))


@functools.cache
def _curve(form: str, *groups: tuple[tuple[int, int], ...]) -> Array:
    """Return [T, X, 2] ln gamma by a form of UNIFAC on the quick grid."""
    (model,) = (model for model in models() if model.name == form)
    with np.errstate(divide="ignore"):
        return model.log_gamma([dict(found) for found in groups], QUICK)


def pair_row(names: Sequence[str], found: Fit, low_k: float, high_k: float, source: str) -> dict[str, Any]:
    """Return a row of the pair file."""
    p = [float(f"{v:.7g}") for v in found.parameters]
    return {
        "of": list(names), "a": p[0:2], "b": p[2:4], "c": p[4:6], "alpha": found.alpha,
        "low_k": low_k, "high_k": high_k, "error": float(f"{found.error:.2g}"), "source": source,
    }  # fmt: skip


def _fitted(
    pairs: Sequence[tuple[str, str]], materials: Materials, grid: Grid, progress: Callable[[int], None]
) -> list[tuple[str, Fit]]:
    """Return the form's name and the fit of each pair; without a suitable form, an ideal mixture (``IDEAL_PAIR``)."""
    keys: list[Any] = []
    curves: dict[Any, tuple[Model, list[Groups]]] = {}
    for two in pairs:
        chosen = best_form(two, materials)
        keys.append(None if chosen is None else (chosen[0].name, *map(_sorted, chosen[1])))
        curves |= {} if chosen is None else {keys[-1]: chosen}
    results: dict[Any, tuple[str, Fit]] = {None: (IDEAL_PAIR, Fit(np.zeros(6), 0.3, 0.0))}
    for first in range(0, len(curves), _CHUNK):
        chunk = list(curves.items())[first : first + _CHUNK]
        log_gamma = [_curve(*key) if grid is QUICK else form.log_gamma(groups, grid) for key, (form, groups) in chunk]
        for (key, (form, _)), parameters, alpha, error in zip(chunk, *fits(np.array(log_gamma), grid), strict=True):
            results[key] = form.name, Fit(parameters, float(alpha), float(error))
        progress(sum(key in results for key in keys))
    return [results[key] for key in keys]


def is_molecule(material: Material) -> bool:
    """Return True if a material can be in a liquid as a molecule."""
    return material.role in ("solvent", "solute") and not any(re.match("Q[a-z]", e) for e in material.composition)


def make_pairs(
    pairs: Sequence[tuple[str, str]],
    materials: Materials,
    progress: Callable[[int], None] = lambda _: None,
    ideal: bool = False,
) -> list[dict[str, Any]]:
    """Return the rows of a pair file.

    Args:
        pairs: pairs of materials.
        materials: materials by id.
        progress: called with the number of finished pairs.
        ideal: whether pairs that UNIFAC does not describe are treated as ideal mixtures; their source says so.

    Raises:
        DataError: a material is unknown, not a molecule, or paired with itself; or ``ideal`` is False and UNIFAC does
            not describe some pairs, all of which are listed.
    """
    for name in itertools.chain(*pairs):
        if name not in materials:
            raise DataError(
                f"pairs: unknown material {name!r}; make it with chemlab data material, then give its file: --materials"
            )
        if not is_molecule(materials[name]):
            role = materials[name].role
            raise DataError(
                f"pairs: {name!r} is not a molecule in a liquid (its role is {role!r}), so it has no groups"
            )
    for one, other in pairs:
        if one == other:
            raise DataError(f"pairs: {one!r} with itself; a pair needs two different materials")
    if not ideal and (without := [two for two in pairs if best_form(two, materials) is None]):
        listed = "; ".join(f"{one!r} with {other!r}" for one, other in without)
        names = dict.fromkeys(itertools.chain(*without))
        ungrouped = [name for name in names if all(form.groups(name, materials[name]) is None for form in models())]
        groups = f" (without groups: {', '.join(map(repr, ungrouped))})" if ungrouped else ""
        raise DataError(
            f"pairs: no form of UNIFAC in thermo describes {listed}{groups}: it lacks groups or interactions, or "
            "extrapolates them too far; write measured parameters into your own pair file (docs: Write a material or a "
            "reaction), which chemlab new reads by --pairs, or treat these pairs as ideal mixtures with --ideal"
        )
    span = float(FINE.temperatures_k[0]), float(FINE.temperatures_k[-1])
    rows = []
    for two, (form, fit) in zip(pairs, _fitted(pairs, materials, FINE, progress), strict=True):
        by_isomer = [name for name in two if name in GROUPS and form != IDEAL_PAIR]
        source = SOURCES.get(form, form)
        source += f", {' and '.join(by_isomer)} by the groups of an isomer" if by_isomer else ""
        rows.append(pair_row(two, fit, *span, source))
    return rows


def quick_pairs(
    pairs: Sequence[tuple[str, str]], materials: Materials, progress: Callable[[int], None] = lambda _: None
) -> list[CataloguePair]:
    """Return the NRTL parameters of some pairs by UNIFAC, fitted on the quick grid.

    Args:
        pairs: pairs of materials.
        materials: materials by id.
        progress: called with the number of finished pairs.

    Returns:
        A row for each pair; a pair that UNIFAC does not describe is an ideal mixture (``IDEAL_PAIR``).
    """
    rows = []
    for two, (form, fit) in zip(pairs, _fitted(pairs, materials, QUICK, progress), strict=True):
        rounded = tuple(float(f"{value:.5g}") for value in fit.parameters.tolist())
        rows.append(CataloguePair(*two, form, fit.alpha, float(f"{fit.error:.2g}"), rounded))
    return rows
