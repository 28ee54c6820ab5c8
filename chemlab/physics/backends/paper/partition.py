"""Partition of solutes between solvents as in the paper, modified to conserve each solute (PHYSICS section 3)."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, CLOCK, CLOCK_WAS, Chemistry
from ...constants import TRACE_MOL
from ...shelf import T_MIX

_DECAY = 30.0
"""The paper's rate of transition from the mixed to the polarity-driven distribution."""


@helper
def _present(row: FloatArray, chem: Handle) -> tuple[int, int]:
    """Return the number of solvents in a vessel, and the column of the last one (-1 without any)."""
    chemistry = opened(Chemistry, chem)
    present, last = 0, -1
    for layer in range(chemistry.solvents.shape[0]):
        if row[AMOUNTS + chemistry.solvents[layer]] > TRACE_MOL:
            present += 1
            last = layer
    return present, last


@helper
def _mixed(clock: float) -> float:
    """Return the share of the mixed distribution in the equilibrium at a settling clock, from 1 to 0."""
    decay = _DECAY * (clock - T_MIX)
    return math.exp(-decay) if decay < 40.0 else 0.0


@helper
def equilibrium(row: FloatArray, chem: Handle, material: int, mixed: float, share: FloatArray) -> None:
    """Compute S*(clock) / [S], the equilibrium share of a solute in each of several solvents; the shares add up to one.

    Args:
        row: vessel row with the amounts of at least two solvents, which count by volume.
        chem: the chemistry.
        material: the solute.
        mixed: share of the mixed distribution (:func:`_mixed`).
        share: [L] out.
    """
    chemistry = opened(Chemistry, chem)
    n_solvents = chemistry.solvents.shape[0]
    litres, distances, weighted = 0.0, 0.0, 0.0
    for layer in range(n_solvents):
        i = chemistry.solvents[layer]
        if row[AMOUNTS + i] > TRACE_MOL:
            volume = row[AMOUNTS + i] * chemistry.molar_volume[i]
            distance = abs(chemistry.polarity[material] - chemistry.polarity[i])
            litres += volume
            distances += distance
            weighted += volume * distance
    # All solvents have exactly the solute's polarity and are equivalent.
    norm = 1.0 - weighted / (litres * distances) if distances > 0.0 else 0.0
    for layer in range(n_solvents):
        i = chemistry.solvents[layer]
        share[layer] = 0.0
        if row[AMOUNTS + i] > TRACE_MOL:
            volume = row[AMOUNTS + i] * chemistry.molar_volume[i]
            preference = 1.0
            if norm > 0.0:
                preference = (1.0 - abs(chemistry.polarity[material] - chemistry.polarity[i]) / distances) / norm
            share[layer] = volume / litres * (mixed + (1.0 - mixed) * preference)


@helper
def set_dissolved_total(row: FloatArray, chem: Handle, k: int, total: float, share: FloatArray) -> None:
    """Set the total of dissolvable material ``k`` in mol.

    A decrease is taken from all solvents in proportion; an increase is distributed by the equilibrium shares. ``share``
    is [L] scratch.
    """
    chemistry = opened(Chemistry, chem)
    n, n_solvents = chemistry.role.shape[0], chemistry.solvents.shape[0]
    material = chemistry.dissolved[k]
    before = row[AMOUNTS + material]
    if total == before:
        return
    row[AMOUNTS + material] = total
    first = AMOUNTS + n + k * n_solvents
    if total <= before:
        scale = total / before if before > 0.0 else 0.0
        for layer in range(n_solvents):
            row[first + layer] *= scale
        return
    present, last = _present(row, chem)
    if present > 1:
        equilibrium(row, chem, material, _mixed(row[CLOCK_WAS]), share)
        for layer in range(n_solvents):
            row[first + layer] += (total - before) * share[layer]
    elif present == 1:
        row[first + last] += total - before


@helper
def partition(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Update the dissolved amounts from CLOCK_WAS to CLOCK by the paper's three-case rule.

    Settling (t > t') keeps the deviation from S*; mixing (t < t') shrinks it in proportion. Amounts are then clipped at
    0 and scaled to the solute's total, so that none is negative and the total is conserved.
    """
    chemistry = opened(Chemistry, chem)
    n, n_solvents = chemistry.role.shape[0], chemistry.solvents.shape[0]
    clock, was = row[CLOCK], row[CLOCK_WAS]
    present, last = _present(row, chem)
    mixed_now, mixed_then = _mixed(clock), _mixed(was)
    now = work[0]
    then = work[1] if clock != was else now
    keep = 1.0
    if clock < was:
        keep = (clock - T_MIX) / (was - T_MIX)
    for k in range(chemistry.dissolved.shape[0]):
        material = chemistry.dissolved[k]
        total = row[AMOUNTS + material]
        first = AMOUNTS + n + k * n_solvents
        if total <= 0.0 or present < 2:
            for layer in range(n_solvents):
                row[first + layer] = max(total, 0.0) if layer == last else 0.0
            continue
        equilibrium(row, chem, material, mixed_now, now)
        if clock != was:
            equilibrium(row, chem, material, mixed_then, then)
        # Amounts without a location (a newly filled vessel, a new product) start at their equilibrium distribution.
        placed = 0.0
        for layer in range(n_solvents):
            placed += row[first + layer]
        for layer in range(n_solvents):
            row[first + layer] = row[first + layer] / placed * total if placed > 0.0 else total * then[layer]
        found = 0.0
        for layer in range(n_solvents):
            if row[AMOUNTS + chemistry.solvents[layer]] > TRACE_MOL:
                amount = total * now[layer] + keep * (row[first + layer] - total * then[layer])
                row[first + layer] = max(amount, 0.0)
                found += row[first + layer]
            else:
                row[first + layer] = 0.0
        for layer in range(n_solvents):
            row[first + layer] = row[first + layer] / found * total if found > 0.0 else total * now[layer]
    row[CLOCK_WAS] = clock
