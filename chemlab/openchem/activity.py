"""Binary NRTL parameters from UNIFAC and from measured solubilities.

The Dortmund form of UNIFAC is used if it has all groups and interactions (except for water with hydrocarbons and their
chlorides), else the original, else the Dortmund form with interactions completed by machine learning. Parameters are
fitted to ln gamma from 270 to 480 K at all compositions that do not split into two liquids, infinite dilution included.
Measured pairs are fitted to the measurements instead. Groups come from thermo's list for a CAS number, else from
ugropy for the structure.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from ..config.datafile import DataError, read_toml
from ..config.materials import Material
from ..config.pairs import REFERENCE_K, log_activity_coefficients
from ..physics.constants import GAS_CONSTANT

try:
    import chemicals
    import thermo.unifac
except ImportError as error:
    raise ImportError(f'activity coefficients need thermo ({error}): pip install ".[chem]"') from error

Array = npt.NDArray[np.float64]

TEMPERATURES_K: Array = np.array([270.0, 285.0, 300.0, 320.0, 340.0, 365.0, 390.0, 420.0, 450.0, 480.0])
_HALF = [1e-10, 1e-4, 0.002, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4]
FRACTIONS: Array = np.array([*_HALF, 0.5, *(1.0 - x for x in reversed(_HALF))])
"""Mole fractions of the first component; 1e-10 represents infinite dilution."""
ALPHAS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.47, 0.55, 0.65)
"""Candidate values of alpha. Renon and Prausnitz propose 0.2 to 0.47; alcohol mixtures often need more, nearly
immiscible mixtures less.
"""
_DILUTE = 0.03
_LIGHT = 0.1
_MEASURED_ALPHAS = (0.2, 0.3, 0.4, 0.47)
_SHAPE = 0.02
"""Weight of UNIFAC's ln gamma of the solvent relative to a measured solubility."""
_SMALL = 0.01
"""Weight of the parameters' size in that fit."""
_ENDS = 3.0
"""Weight of infinite dilution relative to one mixture."""
_PASSES = 6
"""Number of fits; each puts more weight on the largest errors of the previous one."""
_RIDGE = 1e-3
_TRIES = ((1.0, 20.0), (_LIGHT, 20.0), (1.0, 0.0))
"""Candidate weights of high dilution, and of a spurious second liquid.

A liquid is spurious if an activity falls with its mole fraction although the reference has one liquid. The later
candidates are for mixtures whose dilute ends NRTL cannot meet otherwise.
"""
_MADE_UP = 0.1
"""Penalty, as an error of ln gamma, of each temperature with a spurious second liquid."""

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

APOLAR = {"CH3", "CH2", "CH", "C", "CH2=CH", "CH=CH", "CH2=C", "CH=C", "ACH", "AC", "ACCH3", "ACCH2", "ACCH"} | {
    "CH2CL",
    "CHCL",
    "CCL",
}
"""Groups of materials that hardly mix with water.

For the water that they dissolve, the original UNIFAC is right within 0.5 (hexane: x = 7e-4, measured 5e-4), and the
Dortmund form ten times too high.
"""

IDEAL = "estimate: ideal mixture, all activity coefficients 1; no form of UNIFAC has the groups of both"
"""Source of a pair without any data."""

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
            if not numbers.keys() >= GROUPS[key].keys():
                return None
            return {numbers[name]: n for name, n in GROUPS[key].items()}
        if material.cas is not None:
            try:
                listed = self.assignments.get(chemicals.search_chemical(material.cas).InChI_key)
            except ValueError:  # the CAS number is in no list
                listed = None
            if listed:
                return dict(listed)
        return _groups_of_structure(material.smiles, self.version) if material.smiles else None

    def lacks(self, groups: Iterable[Groups]) -> bool:
        """Return True if an interaction between some of the groups is missing."""
        mains = {self.subgroups[number].main_group_id for found in groups for number in found}
        return any(j not in self.interactions.get(i, {}) for i, j in itertools.permutations(mains, 2))

    def log_gamma(
        self, groups: list[Groups], temperatures_k: Array = TEMPERATURES_K, fractions: Array = FRACTIONS
    ) -> Array:
        """Return [T, X, 2] ln of the activity coefficients of two materials."""
        made = thermo.unifac.UNIFAC.from_subgroups(
            T=300.0,
            xs=[0.5, 0.5],
            chemgroups=groups,
            version=self.version,
            interaction_data=self.interactions,
            subgroups=self.subgroups,
        )
        rows = [[made.to_T_xs(t, [x, 1.0 - x]).gammas() for x in fractions.tolist()] for t in temperatures_k.tolist()]
        return np.log(np.array(rows))


@functools.cache
def _groups_of_structure(smiles: str, version: int) -> Groups | None:
    """Return the groups that ugropy finds in a structure, for the form of UNIFAC with this thermo version number."""
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
    """Return the forms of UNIFAC, the best first."""
    u = thermo.unifac
    u.load_unifac_ip()
    u.load_group_assignments_DDBST()
    return [
        Model("UNIFAC (Dortmund)", 1, u.DOUFSG, u.DOUFIP2016, u.DDBST_MODIFIED_UNIFAC_assignments),
        Model("UNIFAC", 0, u.UFSG, u.UFIP, u.DDBST_UNIFAC_assignments),
        # Hayer, Hasse, Jirasek, Modified UNIFAC 2.0: a group-contribution method completed with machine learning.
        Model("modified UNIFAC 2.0", 1, u.DOUFSG, u.DOUF2IP, u.DDBST_MODIFIED_UNIFAC_assignments),
    ]


def stable(log_gamma: Array, fractions: Array = FRACTIONS) -> npt.NDArray[np.bool_]:
    """Return [T, X] True where a mixture stays one liquid: on the lower hull of the Gibbs energy of mixing."""
    x = fractions
    ideal = x * np.log(x) + (1.0 - x) * np.log(1.0 - x)
    energy = ideal + x * log_gamma[..., 0] + (1.0 - x) * log_gamma[..., 1]
    out = np.zeros(energy.shape, dtype=np.bool_)
    for row, g in zip(out, energy, strict=True):
        hull: list[int] = []
        for k in range(len(x)):
            while len(hull) > 1:
                i, j = hull[-2], hull[-1]
                if (g[j] - g[i]) * (x[k] - x[i]) < (g[k] - g[i]) * (x[j] - x[i]):
                    break
                hull.pop()
            hull.append(k)
        row[hull] = True
    return out


def nrtl(parameters: Array, alpha: float, temperatures: Array, fractions: Array) -> Array:
    """Return [T, X, 2] ln gamma by NRTL with ``parameters`` a12, a21, b12, b21, c12, c21."""
    tau = np.zeros((len(temperatures), 1, 2, 2))
    rest = np.log(temperatures / REFERENCE_K)
    tau[:, 0, 0, 1] = parameters[0] + parameters[2] / temperatures + parameters[4] * rest
    tau[:, 0, 1, 0] = parameters[1] + parameters[3] / temperatures + parameters[5] * rest
    mixtures = np.broadcast_to(np.stack([fractions, 1.0 - fractions], axis=-1), (len(temperatures), len(fractions), 2))
    return log_activity_coefficients(mixtures, np.broadcast_to(tau, (*mixtures.shape, 2)), np.array(alpha))


@dataclass(frozen=True)
class Fit:
    """NRTL parameters and their errors."""

    parameters: Array
    alpha: float
    error: float


def _candidates(log_gamma: Array, alpha: float, tails: float, splits: float) -> list[tuple[int, Fit]]:
    """Return fits with one alpha, each with its number of temperatures with a spurious second liquid."""
    one_liquid = stable(log_gamma)
    whole: npt.NDArray[np.bool_] = one_liquid[:, 1:] & one_liquid[:, :-1]
    rises = np.diff(np.log(FRACTIONS))
    kept = np.repeat(one_liquid[..., None], 2, axis=-1)
    weight = kept.astype(np.float64)
    weight[:, np.minimum(FRACTIONS, 1.0 - FRACTIONS) < _DILUTE] *= tails
    if not kept.all():
        weight[:, 0, 0] = weight[:, -1, 1] = _ENDS
    scale = np.array([1.0, 1.0, 300.0, 300.0, 1.0, 1.0])
    start, out = np.array([1.0, 1.0, 100.0, 100.0, 0.0, 0.0]), []
    for _ in range(_PASSES):

        def residuals(p: Array, weight: Array = weight) -> Array:
            made = nrtl(p, alpha, TEMPERATURES_K, FRACTIONS)
            off = np.where(kept, (made - log_gamma) * weight, 0.0)
            falls = np.where(whole, np.minimum(np.diff(made[..., 0], axis=1) + 0.95 * rises, 0.0), 0.0)
            return np.concatenate([off.ravel(), splits * falls.ravel(), _RIDGE * p / scale])

        found = least_squares(residuals, start, x_scale=scale, max_nfev=100)
        made = nrtl(found.x, alpha, TEMPERATURES_K, FRACTIONS)
        off = np.where(kept, np.abs(made - log_gamma), 0.0)
        if np.isfinite(made).all():
            second = np.any(one_liquid & ~stable(made), axis=1) & np.all(one_liquid, axis=1)
            made_up = int(np.sum(second))
            out.append((made_up, Fit(found.x, alpha, float(off.max()))))
        start, weight = found.x, weight * np.sqrt(0.1 + off * weight / max(float((off * weight).max()), 1e-12))
    return out


def fit(log_gamma: Array) -> Fit:
    """Return NRTL parameters with a small maximum error of ln gamma [T, X, 2] wherever the mixture is one liquid.

    If NRTL predicts a spurious second liquid or large errors at high dilution, both are weighed against each other.
    """
    scored: list[tuple[float, Fit]] = []
    for tails, splits in _TRIES:
        for alpha in ALPHAS:
            found = _candidates(log_gamma, alpha, tails, splits)
            scored += [(made.error + _MADE_UP * made_up, made) for made_up, made in found]
        if min(score for score, _ in scored) < _MADE_UP:
            break
    return min(scored, key=lambda pair: pair[0])[1]


@dataclass(frozen=True)
class Measured:
    """Solubilities of one material in another: mole fractions by temperature."""

    solute: str
    solvent: str
    temperature_k: Array
    mole_fraction: Array
    source: str


@dataclass(frozen=True)
class Mutual:
    """Mutual solubility of two liquids: mole fractions by temperature."""

    first: str
    second: str
    temperature_k: Array
    first_in_second: Array
    second_in_first: Array
    source: str


def measured_pairs(path: Path) -> dict[frozenset[str], Measured | Mutual]:
    """Return measurements by pair.

    They are the tables ``solubility`` and ``mutual`` of a file, with the keys of :class:`Measured` and :class:`Mutual`.
    """
    out: dict[frozenset[str], Measured | Mutual] = {}
    tables = read_toml(path)
    for row in [*tables["solubility"], *tables["mutual"]]:
        arrays: dict[str, Any] = {k: np.array(v) if isinstance(v, list) else v for k, v in row.items()}
        made = Measured(**arrays) if "solute" in row else Mutual(**arrays)
        out[frozenset((made.solute, made.solvent) if isinstance(made, Measured) else (made.first, made.second))] = made
    return out


def ideal_solubility(material: Material, temperature_k: Array) -> Array:
    """Return ln of the ideal solubility as a mole fraction: -dHfus / R (1 / T - 1 / Tm)."""
    assert material.real is not None
    assert material.real.fusion_enthalpy_j_mol is not None
    assert material.melting_point_k is not None
    heat = material.real.fusion_enthalpy_j_mol / GAS_CONSTANT
    return np.asarray(-heat * (1.0 / temperature_k - 1.0 / material.melting_point_k))


def fit_measured(measured: Measured, solute: Material, log_gamma: Array) -> Fit:
    """Fit NRTL parameters to measured solubilities.

    Parameters are otherwise small and depend mostly on temperature. If the two do not mix, the solvent has UNIFAC's
    ``log_gamma`` (of solute and solvent) as far as the measurements allow. The error is that of the measured ln gamma.
    """
    temperature, x = measured.temperature_k, measured.mole_fraction
    wanted = ideal_solubility(solute, temperature) - np.log(x)
    near = (TEMPERATURES_K > 275.0) & (TEMPERATURES_K < 400.0)
    one_liquid = stable(log_gamma)
    kept = one_liquid[near]
    apart = 0.0 if one_liquid.all() else _SHAPE
    scale = np.array([0.3, 0.3, 300.0, 300.0])

    def off(p: Array, alpha: float) -> Array:
        return np.array([nrtl(p, alpha, temperature[i : i + 1], x[i : i + 1])[0, 0, 0] for i in range(len(x))]) - wanted

    scored: list[tuple[float, Fit]] = []
    for alpha in _MEASURED_ALPHAS:

        def residuals(p: Array, alpha: float = alpha) -> Array:
            full = np.array([*p, 0.0, 0.0])
            shape = nrtl(full, alpha, TEMPERATURES_K[near], FRACTIONS)[..., 1] - log_gamma[near][..., 1]
            return np.concatenate([off(full, alpha), apart * np.where(kept, shape, 0.0).ravel(), _SMALL * p / scale])

        found = least_squares(residuals, np.array([0.1, 0.1, 100.0, 100.0]), x_scale=scale, max_nfev=500)
        parameters = np.array([*found.x, 0.0, 0.0])
        made_up = np.any(one_liquid & ~stable(nrtl(parameters, alpha, TEMPERATURES_K, FRACTIONS)), axis=1)
        made = Fit(parameters, alpha, float(np.abs(off(parameters, alpha)).max()))
        scored.append((float(found.cost) + _MADE_UP * int(np.sum(made_up & np.all(one_liquid, axis=1))), made))
    return min(scored, key=lambda pair: pair[0])[1]


def fit_mutual(mutual: Mutual, alpha: float = 0.2) -> Fit:
    """Fit NRTL parameters that give both liquids equal activities in the two layers.

    Renon and Prausnitz propose this alpha for immiscible liquids. The error is that of ln of the activities.
    """
    temperature = mutual.temperature_k
    poor, rich = mutual.first_in_second, 1.0 - mutual.second_in_first
    ideal = np.log(np.stack([poor / rich, (1.0 - poor) / (1.0 - rich)], axis=-1))

    def off(p: Array) -> Array:
        full, out = np.array([*p, 0.0, 0.0]), np.array(ideal)
        for i in range(len(poor)):
            layers = nrtl(full, alpha, temperature[i : i + 1], np.array([poor[i], rich[i]]))[0]
            out[i] += layers[0] - layers[1]
        return out.ravel()

    found = least_squares(off, np.array([0.0, 0.0, 300.0, 1000.0]), x_scale=np.array([1.0, 1.0, 300.0, 300.0]))
    return Fit(np.array([*found.x, 0.0, 0.0]), alpha, float(np.abs(off(found.x)).max()))


def _apart(names: tuple[str, str], materials: Mapping[str, Material], forms: list[Model]) -> bool:
    """Return True if one of two materials is water and the other a hydrocarbon or its chloride."""
    others = [name for name in names if name != "water"]
    found = forms[0].groups(others[0], materials[others[0]]) if len(others) == 1 else None
    return found is not None and {forms[0].subgroups[number].group for number in found} <= APOLAR


def _forms(names: tuple[str, str], materials: Mapping[str, Material], forms: list[Model]) -> list[Model]:
    """Forms of UNIFAC, the best one for two materials first."""
    return sorted(forms, key=lambda form: form.name != "UNIFAC") if _apart(names, materials, forms) else forms


def _form(
    names: tuple[str, str], materials: Mapping[str, Material], forms: list[Model]
) -> tuple[Model, list[Groups]] | None:
    """Return the form of UNIFAC for two materials, and their groups in it; None if no form has all groups."""
    for form in _forms(names, materials, forms):
        groups = [found for name in names if (found := form.groups(name, materials[name])) is not None]
        if len(groups) == len(names) and not form.lacks(groups):
            return form, groups
    return None


def described(
    names: tuple[str, str],
    materials: Mapping[str, Material],
    forms: list[Model],
    measured: Mapping[frozenset[str], Measured | Mutual],
    known: dict[Any, Fit],
) -> dict[str, Any]:
    """Return a row of the pair file; an ideal mixture if no form of UNIFAC has the groups of both."""
    low, high = float(TEMPERATURES_K[0]), float(TEMPERATURES_K[-1])
    chosen = _form(names, materials, forms)
    if chosen is None:
        return {
            "of": list(names), "a": [0.0, 0.0], "b": [0.0, 0.0], "c": [0.0, 0.0], "alpha": 0.3,
            "low_k": low, "high_k": high, "error": 0.0, "source": IDEAL,
        }  # fmt: skip
    form, both = chosen
    log_gamma = form.log_gamma(both)
    given = measured.get(frozenset(names))
    source = form.name
    borrowed = [name for name in names if name in GROUPS]
    if borrowed:
        source += f", {' and '.join(borrowed)} by the groups of an isomer"
    if isinstance(given, Measured):
        if given.solute != names[0]:
            log_gamma = log_gamma[:, ::-1, ::-1]
        found = fit_measured(given, materials[given.solute], log_gamma)
        names, source = (given.solute, given.solvent), f"solubility of {given.solute}: {given.source}"
    elif isinstance(given, Mutual):
        found = fit_mutual(given)
        names, source = (given.first, given.second), f"mutual solubilities: {given.source}"
    else:
        key = (form.name, *(tuple(sorted(g.items())) for g in both))
        found = known[key] = known.get(key) or fit(log_gamma)
    if given is not None:
        low, high = float(given.temperature_k.min()) - 15.0, float(given.temperature_k.max()) + 15.0
    p = [float(f"{v:.7g}") for v in found.parameters]
    return {
        "of": list(names), "a": p[0:2], "b": p[2:4], "c": p[4:6], "alpha": found.alpha,
        "low_k": low, "high_k": high, "error": float(f"{found.error:.2g}"), "source": source,
    }  # fmt: skip


def _has_groups(name: str, materials: Mapping[str, Material]) -> bool:
    return any(form.groups(name, materials[name]) is not None for form in models())


def is_molecule(material: Material) -> bool:
    """Return True if a material can be in a liquid as a molecule."""
    return material.role in ("solvent", "solute") and not any(re.match("Q[a-z]", e) for e in material.composition)


def make_pairs(
    pairs: Sequence[tuple[str, str]],
    materials: Mapping[str, Material],
    measured: Mapping[frozenset[str], Measured | Mutual] | None = None,
    progress: Callable[[str], None] = lambda _: None,
    ideal: bool = False,
) -> list[dict[str, Any]]:
    """Return the rows of a pair file.

    Args:
        pairs: pairs of materials.
        materials: materials by id.
        measured: measurements that replace UNIFAC.
        progress: called with the name of every finished pair.
        ideal: whether pairs without UNIFAC groups become ideal mixtures, as their source then states.

    Raises:
        DataError: a material is unknown, not a molecule, or paired with itself; or ``ideal`` is False and UNIFAC lacks
            the groups of some pairs, all of which are named.
    """
    for name in (name for two in pairs for name in two):
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
    if not ideal and (without := [two for two in pairs if _form(two, materials, models()) is None]):
        listed = "; ".join(f"{one!r} with {other!r}" for one, other in without)
        strange = [name for name in dict.fromkeys(itertools.chain(*without)) if not _has_groups(name, materials)]
        groups = f" (without groups: {', '.join(map(repr, strange))})" if strange else ""
        raise DataError(
            f"pairs: no form of UNIFAC in thermo has the groups and interactions of {listed}{groups}; write measured "
            "parameters into your own pair file and name it with --pairs (docs: Write a material or a reaction), "
            "or treat these pairs as ideal mixtures with --ideal"
        )
    known: dict[Any, Fit] = {}
    rows = []
    for two in pairs:
        rows.append(described(two, materials, models(), measured or {}, known))
        progress(f"{two[0]}, {two[1]}")
    return rows
