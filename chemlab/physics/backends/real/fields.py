"""Fields of the chemistry for kinetics and acids of the backend ``real``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ....config.datafile import DataError
from ....config.reactions import HYDROXIDE, PROTON, WATER
from ....kernels.arrays import FloatArray, IntArray
from ...chemistry import Parameter, Structure

if TYPE_CHECKING:
    from ....config.scenario import Scenario

_HEAT_TOLERANCE = 5000.0
"""Allowed difference in J/mol between a reaction's heat and its materials' formation enthalpies, as between
compilations.
"""
_DEBYE = 0.509
"""A in -log10 gamma = A z^2 sqrt(I) of water at 298.15 K, in (kg/mol)^(1/2).

Bates, Determination of pH, 2nd ed. 1973, appendix.
"""
_WATER_PK, _WATER_HEAT = 13.995, 55_815.0
"""Ionization of water at 298.15 K: pKw at infinite dilution, and heat in J/mol.

pKw: Harned and Owen, The Physical Chemistry of Electrolytic Solutions, 3rd ed. 1958; Marshall and Franck, J. Phys.
Chem. Ref. Data 10 (1981) 295. Heat: CODATA key values 1989: OH- -230.015, H2O -285.830 kJ/mol.
"""


class KineticFields(NamedTuple):
    """Kinetic fields in addition to :class:`~chemlab.physics.chemistry.Chemistry`: R reactions over S species."""

    independent: Annotated[IntArray, Structure("B")]
    """[B] reactions whose stoichiometries are a basis of all stoichiometries"""
    parts: Annotated[IntArray, Structure("R P")]
    """[R, P] basis reactions of each reaction, then -1"""
    part_numbers: Annotated[FloatArray, Structure("R P")]
    """[R, P] their coefficients"""
    forward: Annotated[IntArray, Structure("R F")]
    """[R, F] species in the rate law, catalysts included, then -1"""
    forward_order: Annotated[FloatArray, Structure("R F")]
    """[R, F] their orders"""
    backward: Annotated[IntArray, Structure("R G")]
    """[R, G] species in the rate law of the reverse reaction; -1 everywhere without one"""
    backward_order: Annotated[FloatArray, Structure("R G")]
    """[R, G] their orders"""
    inhibitors: Annotated[IntArray, Structure("R I")]
    """[R, I] inhibitors, then -1"""
    inhibition: Annotated[FloatArray, Parameter("R I")]
    """[R, I] inhibition constants in L/mol; the rate is divided by 1 + the sum of constant times concentration"""
    equilibrium: Annotated[FloatArray, Parameter("R")]
    """[R] equilibrium constant at 298.15 K in terms of mol/L; infinite for irreversible reactions"""
    equilibrium_heat: Annotated[FloatArray, Parameter("R")]
    """[R] heat in J/mol of its temperature dependence"""


class AcidFields(NamedTuple):
    """Acids and their bases: A acids of at most P species; M materials."""

    charge: Annotated[FloatArray, Structure("M")]
    """[M] charge in elementary charges"""
    acid: Annotated[IntArray, Structure("A P")]
    """[A, P] materials, each with one proton less than the previous one; then -1"""
    acid_pk: Annotated[FloatArray, Parameter("A P")]
    """[A, P] pK at 298.15 K of the step to the next one"""
    acid_heat: Annotated[FloatArray, Parameter("A P")]
    """[A, P] heat in J/mol of its temperature dependence"""
    ionization: Annotated[IntArray, Structure("3")]
    """[3] materials H+, OH-, water; -1 for missing ones"""
    water_pk: Annotated[float, Parameter("")]
    """pKw at 298.15 K"""
    water_heat: Annotated[float, Parameter("")]
    """heat in J/mol of its temperature dependence"""
    debye: Annotated[float, Parameter("")]
    """A in the Davies equation at 298.15 K, (kg/mol)^(1/2); 0 makes solutions ideal"""


def independent_reactions(stoichiometry: FloatArray) -> dict[str, npt.NDArray[Any]]:
    """Select linearly independent reactions and express all reactions by them.

    Args:
        stoichiometry: [R, S].

    Returns:
        The fields ``independent``, ``parts`` and ``part_numbers``.
    """
    chosen: list[int] = []
    for r in range(len(stoichiometry)):
        if np.linalg.matrix_rank(stoichiometry[[*chosen, r]]) > len(chosen):
            chosen.append(r)
    numbers = np.linalg.lstsq(stoichiometry[chosen].T, stoichiometry.T, rcond=None)[0].T
    numbers[chosen] = np.eye(len(chosen))
    parts, part_numbers = padded([{int(b): row[b] for b in np.flatnonzero(np.abs(row) > 1e-12)} for row in numbers])
    return {"independent": np.array(chosen, dtype=np.int64), "parts": parts, "part_numbers": part_numbers}


def padded(rows: Sequence[Mapping[int, float]]) -> tuple[IntArray, FloatArray]:
    """Return mappings as padded arrays: ([n, width] keys, then -1; [n, width] values, then 0)."""
    width = max((len(row) for row in rows), default=0)
    keys, values = np.full((len(rows), width), -1, dtype=np.int64), np.zeros((len(rows), width))
    for r, row in enumerate(rows):
        keys[r, : len(row)], values[r, : len(row)] = list(row), list(row.values())
    return keys, values


def _summed(*orders: Mapping[str, float]) -> dict[str, float]:
    """Return orders by material, summed over factors; a product may catalyse its own reaction."""
    total: dict[str, float] = {}
    for part in orders:
        for name, order in part.items():
            total[name] = total.get(name, 0.0) + order
    return total


def kinetic_fields(
    scenario: Scenario, names: Sequence[str], formation: FloatArray
) -> dict[str, npt.NDArray[Any] | float]:
    """Return the :class:`KineticFields` of a scenario.

    Args:
        scenario: the scenario with its reactions.
        names: its materials, in the order of a vessel row.
        formation: [M] formation enthalpies in J/mol.

    Raises:
        DataError: a reaction's heat contradicts its materials' formation enthalpies.
    """
    steps = scenario.family.reaction
    taking_part = [name for name in names if any(name in step.materials() for step in steps)]
    heats = []
    for step in steps:
        formed = sum(x * formation[names.index(name)] for name, x in step.products.items())
        formed -= sum(x * formation[names.index(name)] for name, x in step.reactants.items())
        heats.append(formed if step.enthalpy_j_mol is None else step.enthalpy_j_mol)
        if abs(heats[-1] - formed) > _HEAT_TOLERANCE:
            raise DataError(
                f"{scenario.origin}: reactions {scenario.family.name!r}: reaction {step.words}: enthalpy_j_mol = "
                f"{heats[-1]:g}: the formation enthalpies of its materials give {formed:.0f}, and may differ by "
                f"{_HEAT_TOLERANCE:g}; leave it out, or correct real.formation_enthalpy_j_mol of a material"
            )

    def indexed(values: Mapping[str, float]) -> dict[int, float]:
        return {taking_part.index(name): value for name, value in values.items()}

    reversible = [step.equilibrium_constant is not None for step in steps]
    forward, forward_order = padded([indexed(_summed(step.orders, step.catalysts)) for step in steps])
    backward, backward_order = padded(
        [indexed(_summed(s.products, s.catalysts)) if back else {} for s, back in zip(steps, reversible, strict=True)]
    )
    inhibitors, inhibition = padded([indexed(step.inhibitors) for step in steps])
    stoichiometry = np.zeros((len(steps), len(taking_part)))
    for row, step in zip(stoichiometry, steps, strict=True):
        for j, number in indexed(_summed(step.products, {k: -x for k, x in step.reactants.items()})).items():
            row[j] = number
    return {
        **independent_reactions(stoichiometry),
        "forward": forward,
        "forward_order": forward_order,
        "backward": backward,
        "backward_order": backward_order,
        "inhibitors": inhibitors,
        "inhibition": inhibition,
        "equilibrium": np.array([step.equilibrium_constant or np.inf for step in steps]),
        "equilibrium_heat": np.array(heats),
    }


def acid_fields(scenario: Scenario, names: Sequence[str], formation: FloatArray) -> dict[str, npt.NDArray[Any] | float]:
    """Return the :class:`AcidFields` of a scenario; arguments as for :func:`kinetic_fields`."""
    index = {name: i for i, name in enumerate(names)}
    acids = scenario.family.acid
    width = max((len(acid.species) for acid in acids), default=0)
    species = np.full((len(acids), width), -1, dtype=np.int64)
    pk, heat = np.zeros((2, len(acids), width))
    for a, acid in enumerate(acids):
        steps = len(acid.pka)
        species[a, : steps + 1] = [index[name] for name in acid.species]
        pk[a, :steps] = acid.pka
        formed = np.diff(formation[species[a, : steps + 1]]) + formation[index[PROTON]]
        heat[a, :steps] = acid.enthalpy_j_mol or formed
    return {
        "charge": np.array([float(scenario.materials[name].charge) for name in names]),
        "acid": species,
        "acid_pk": pk,
        "acid_heat": heat,
        "ionization": np.array([index.get(name, -1) for name in (PROTON, HYDROXIDE, WATER)], dtype=np.int64),
        "water_pk": _WATER_PK,
        "water_heat": _WATER_HEAT,
        "debye": _DEBYE,
    }
