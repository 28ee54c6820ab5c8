"""Dissolution, precipitation and instantaneous reactions in every vessel on every bench (PHYSICS section 5)."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, ROLE_GAS, Chemistry
from .partition import set_dissolved_total


@helper
def _set_amount(row: FloatArray, chem: Handle, material: int, total: float, share: FloatArray) -> None:
    chemistry = opened(Chemistry, chem)
    k = chemistry.dissolved_at[material]
    if k >= 0:
        set_dissolved_total(row, chem, k, total, share)
    else:
        row[AMOUNTS + material] = total


@helper
def react_violently(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, share: FloatArray) -> None:
    """Run every violent reaction until one of its reactants is consumed; gases are vented to ``waste``.

    A reaction's safety event grows by the mol of its first reactant.
    """
    chemistry = opened(Chemistry, chem)
    n = chemistry.role.shape[0]
    for v in range(chemistry.violent.shape[0]):
        extent, limiting = math.inf, -1
        for i in range(n):
            if chemistry.violent[v, i] < 0.0:
                if row[AMOUNTS + i] <= 0.0:
                    limiting = -1
                    break
                if row[AMOUNTS + i] / -chemistry.violent[v, i] < extent:
                    extent, limiting = row[AMOUNTS + i] / -chemistry.violent[v, i], i
        if limiting < 0:
            continue
        first = True
        for i in range(n):
            change = chemistry.violent[v, i] * extent
            if change == 0.0:
                continue
            if change < 0.0 and first and chemistry.violent_event[v] >= 0:
                events[chemistry.violent_event[v]] -= change
                first = False
            if chemistry.role[i] == ROLE_GAS:
                waste[i] += change
            elif i == limiting:
                _set_amount(row, chem, i, 0.0, share)
            else:
                _set_amount(row, chem, i, max(row[AMOUNTS + i] + change, 0.0), share)


@helper
def settle_salts(row: FloatArray, chem: Handle, share: FloatArray) -> None:
    """Bring every salt to the equilibrium [salt][solvent] = [cation][anion], summed over all solvents.

    Salts with a common cation share one quadratic: with c mol of it in solution, S mol of solvent, A mol of their
    anions and C mol of the cation (dissolved and solid), c^2 + (S + A - C) c - C S = 0, and every salt has the same
    undissolved share c / (S + c). The liquid's volume cancels.
    """
    chemistry = opened(Chemistry, chem)
    n_salts = chemistry.salts.shape[0]
    solvent = 0.0
    for layer in range(chemistry.solvents.shape[0]):
        solvent += row[AMOUNTS + chemistry.solvents[layer]]
    start = 0
    while start < n_salts:
        cation = chemistry.salts[start, 1]
        stop = start
        cations, anions = row[AMOUNTS + cation], 0.0
        while stop < n_salts and chemistry.salts[stop, 1] == cation:
            solid = row[AMOUNTS + chemistry.salts[stop, 0]]
            cations += solid
            anions += solid + row[AMOUNTS + chemistry.salts[stop, 2]]
            stop += 1
        if cations > 0.0 and anions > 0.0:
            b = solvent + anions - cations
            root = math.sqrt(b * b + 4.0 * cations * solvent)
            free = 2.0 * cations * solvent / (b + root) if b > 0.0 else 0.5 * (root - b)
            solids = max(min(cations - free, min(cations, anions)), 0.0)
            for s in range(start, stop):
                solid, anion = chemistry.salts[s, 0], chemistry.salts[s, 2]
                both = row[AMOUNTS + solid] + row[AMOUNTS + anion]
                precipitate = both * (solids / anions)
                row[AMOUNTS + solid] = precipitate
                _set_amount(row, chem, anion, both - precipitate, share)
            _set_amount(row, chem, cation, cations - solids, share)
        start = stop


@helper
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """Apply violent reactions, then salt equilibria; gases leave."""
    react_violently(row, chem, waste, events, work[0])
    settle_salts(row, chem, work[0])
    role = opened(Chemistry, chem).role
    for i in range(role.shape[0]):
        if role[i] == ROLE_GAS:  # gases made by reactions leave
            waste[i] += row[AMOUNTS + i]
            row[AMOUNTS + i] = 0.0
