"""Time spans in which the volume of the liquids, saturations and the shifts of equilibria are nearly constant.

Reactions, and crystals that dissolve or grow, are integrated together with the values at the beginning of a span
(:mod:`.kinetics`). Acids, bases and salts settle at its end. If equilibria or the other values have changed by more
than the tolerance, the span is repeated with a shorter duration. Results therefore do not depend on the division of
time into calls.
"""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import AMOUNTS, ROLE_ION, TEMPERATURE
from ...constants import TRACE_MOL
from ...transfer import liquid_volume
from .acids import ionizes, settle_acids
from .crystals import find_crystals, limit, saturate
from .heats import crystals, dissolved
from .kinetics import COLUMN, PLACE, PREDICTED, PROBE, SATURATION, SHARE, Ways, add_species, available, dissolve, extra
from .real_chemistry import RealChemistry
from .salts import let_salts_fall_out, settle_salts

_VOLUME, _SATURATION, _CONCENTRATION, _KELVIN = 0.02, 0.01, 0.02, 0.5
"""Allowed changes in a span.

They bound the volume of the liquids, a saturation, the amount that equilibria leave of a concentration (all three
relative), and the temperature (by settling).
"""
_LEAST_LITRES = 1e-6
_PROBED = 1e-6
"""Probe size relative to the contents of acids, bases and salts, for their redistribution."""
_LONGEST_RATIO = 4.0


@helper
def _shifting(chem: Handle, material: int) -> bool:
    """Return True for materials in instantaneous equilibrium in water: its own ions, acids and bases, ions of salts."""
    chemistry = opened(RealChemistry, chem)
    if ionizes(chem):
        if material == chemistry.ionization[0] or material == chemistry.ionization[1]:
            return True
        for a in range(chemistry.acid.shape[0]):
            for p in range(chemistry.acid.shape[1]):
                if chemistry.acid[a, p] == material:
                    return True
    if chemistry.role[material] == ROLE_ION:
        for s in range(chemistry.salts.shape[0]):
            if chemistry.salts[s, 1] == material or chemistry.salts[s, 2] == material:
                return True
    return False


@helper
def _changes_shifting(chem: Handle, work: FloatArray, u: int) -> bool:
    """Return True if an unknown changes a material in such an equilibrium."""
    chemistry = opened(RealChemistry, chem)
    n = chemistry.independent.shape[0]
    if u >= n:
        return _shifting(chem, int(chemistry.dissolved[int(work[PLACE, u - n])]))
    for c in range(chemistry.changes.shape[1]):
        j = chemistry.changes[chemistry.independent[u], c]
        if j >= 0 and _shifting(chem, int(chemistry.species[j])):
            return True
    return False


@helper
def settle_shifts(row: FloatArray, chem: Handle, steady: bool, work: FloatArray) -> None:
    """Bring acids, bases and salts to equilibrium; their heat stays in the vessel, unless its temperature is held."""
    at = row[TEMPERATURE]
    if ionizes(chem):
        settle_acids(row, chem, work)
    if steady:
        row[TEMPERATURE] = at
        settle_salts(row, chem)
    else:
        let_salts_fall_out(row, chem)


@inner
def _ions(row: FloatArray, chem: Handle) -> float:
    """Return mol of materials in such an equilibrium."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for i in range(chemistry.role.shape[0]):
        total += max(row[AMOUNTS + i], 0.0) if _shifting(chem, i) else 0.0
    return total


@inner
def _held(row: FloatArray, chem: Handle, work: FloatArray, column: int, q: int) -> float:
    """Return mol of the material of a concentration."""
    if column < opened(RealChemistry, chem).species.shape[0]:
        return float(available(row, chem, column))
    return float(dissolved(row, chem, int(work[PLACE, q])))


@inner
def _probe(
    row: FloatArray, chem: Handle, steady: bool, work: FloatArray, u: int, mol: float, probe: FloatArray
) -> None:
    """Set ``probe`` to the vessel after ``mol`` more of unknown ``u`` have settled."""
    chemistry = opened(RealChemistry, chem)
    n = chemistry.independent.shape[0]
    for x in range(row.shape[0]):
        probe[x] = row[x]
    if u < n:
        for c in range(chemistry.changes.shape[1]):
            j = chemistry.changes[chemistry.independent[u], c]
            if j >= 0:
                # Instead of True, for which numba would compile the function again.
                shifts = u < n
                add_species(probe, chem, j, chemistry.stoichiometry[chemistry.independent[u], j] * mol, shifts)
    else:
        k = int(work[PLACE, u - n])
        probe[AMOUNTS + chemistry.dissolved[k]] += mol
        dissolve(probe, chem, k, mol, work[SHARE, u - n])
    settle_shifts(probe, chem, steady, work)


@inner
def _find_shifts(row: FloatArray, chem: Handle, steady: bool, work: FloatArray, found: int) -> bool:
    """Compute the redistribution by acids, bases and salts for each unknown into the scratch; return True if there
    is any.
    """
    chemistry = opened(RealChemistry, chem)
    n, columns = chemistry.independent.shape[0], chemistry.species.shape[0]
    shifts = False
    for u in range(n + found):
        more = extra(work, u)
        for j in range(columns + found):
            work[more, j] = 0.0
        if u >= n:
            work[more, int(work[COLUMN, u - n])] = 1.0
        shifts = shifts or _changes_shifting(chem, work, u)
    if not shifts:
        return False
    settle_shifts(row, chem, steady, work)
    mol, probe = _PROBED * _ions(row, chem) + TRACE_MOL, work[PROBE][: row.shape[0]]
    for u in range(n + found):
        if not _changes_shifting(chem, work, u):
            continue
        more = extra(work, u)
        for with_it in range(2):
            _probe(row, chem, steady, work, u, mol if with_it == 0 else 0.0, probe)
            for column in range(columns + found):
                held = _held(probe, chem, work, column, column - columns)
                work[more, column] = held if with_it == 0 else (work[more, column] - held) / mol
        for q in range(found):
            if int(work[COLUMN, q]) < columns:
                work[more, columns + q] = 0.0  # it has its species' column
        if u < n:
            for j in range(columns):
                work[more, j] -= chemistry.stoichiometry[chemistry.independent[u], j]
    return True


@helper
def prepare(row: FloatArray, chem: Handle, fresh: bool, steady: bool, leaves: bool, work: FloatArray) -> Ways:
    """Determine the processes in a vessel besides its reactions.

    Args:
        row: vessel row; acids, bases and salts settle.
        chem: the chemistry.
        fresh: whether its saturations are known.
        steady: whether its temperature is held.
        leaves: whether gas leaves it.
        work: scratch.
    """
    chemistry = opened(RealChemistry, chem)
    found = 0
    if _may_crystallize(row, chem):
        if not fresh:
            saturate(row, chem, work)
        found = find_crystals(row, chem, work)
    shifts = False
    if chemistry.salts.shape[0] > 0 or ionizes(chem):
        shifts = _find_shifts(row, chem, steady, work, found)
    else:
        for q in range(found):
            more = extra(work, chemistry.independent.shape[0] + q)
            for j in range(chemistry.species.shape[0] + found):
                work[more, j] = 0.0
            work[more, int(work[COLUMN, q])] = 1.0
    return Ways(found, shifts, leaves)


@helper
def _may_crystallize(row: FloatArray, chem: Handle) -> bool:
    chemistry = opened(RealChemistry, chem)
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if chemistry.fusion[i] > 0.0 and row[AMOUNTS + i] > TRACE_MOL:
            return True
    return False


@inner
def _changed_saturation(row: FloatArray, chem: Handle, work: FloatArray) -> float:
    """Return the largest relative change of a saturation in a span; the scratch receives the new saturations.

    For a saturation that did not exist before, the excess of the dissolved amount counts.
    """
    chemistry = opened(RealChemistry, chem)
    for k in range(chemistry.dissolved.shape[0]):
        work[PROBE, k] = work[SATURATION, k]
    saturate(row, chem, work)
    worst = 0.0
    for k in range(chemistry.dissolved.shape[0]):
        now = work[SATURATION, k]
        if now == math.inf:
            continue
        floor = max(now, TRACE_MOL)
        if work[PROBE, k] < math.inf and crystals(row, chem, k) > TRACE_MOL:
            worst = max(worst, abs(now - work[PROBE, k]) / floor)
        else:
            most = limit(row, chem, k) * floor
            worst = max(worst, (dissolved(row, chem, k) - most) / most)
    return worst


@inner
def _is_factor(chem: Handle, j: int) -> bool:
    """Return True if any rate depends on a species."""
    chemistry = opened(RealChemistry, chem)
    for r in range(chemistry.forward.shape[0]):
        for f in range(chemistry.forward.shape[1]):
            if chemistry.forward[r, f] == j:
                return True
        for f in range(chemistry.backward.shape[1]):
            if chemistry.backward[r, f] == j:
                return True
        for f in range(chemistry.inhibitors.shape[1]):
            if chemistry.inhibitors[r, f] == j:
                return True
    return False


@helper
def drifted(
    row: FloatArray, chem: Handle, steady: bool, litres: float, atol: float, ways: Ways, work: FloatArray
) -> float:
    """Return the drift of a span relative to the tolerance; equilibria have settled at its end.

    Args:
        row: vessel row after the integration of a span.
        chem: the chemistry.
        steady: whether its temperature is held.
        litres: volume of liquids at its beginning.
        atol: mol/L below which a concentration is ignored.
        ways: processes of its integration.
        work: scratch.
    """
    chemistry = opened(RealChemistry, chem)
    worst = 0.0
    if ways.shifts or chemistry.salts.shape[0] > 0:
        warm = row[TEMPERATURE]
        settle_shifts(row, chem, steady, work)
        worst = abs(row[TEMPERATURE] - warm) / _KELVIN
    if ways.shifts:
        for j in range(chemistry.species.shape[0]):
            if _shifting(chem, int(chemistry.species[j])) and _is_factor(chem, j):
                foreseen, now = work[PREDICTED, j], available(row, chem, j)
                most = max(now, foreseen, atol * litres)
                worst = max(worst, abs(now - foreseen) / most / _CONCENTRATION if now >= 0.0 else math.inf)
    if litres > _LEAST_LITRES and chemistry.independent.shape[0] > 0:
        worst = max(worst, abs(liquid_volume(row, chem) / litres - 1.0) / _VOLUME)
    if _may_crystallize(row, chem):
        worst = max(worst, _changed_saturation(row, chem, work) / _SATURATION)
    return worst


@helper
def lengthened(span: float, drift: float) -> float:
    """Return the length of the next span after one with a given ``drift``, for a drift within the tolerance."""
    return span * min(0.9 / max(drift, 1e-3), _LONGEST_RATIO) if drift <= 1.0 else span * max(0.8 / drift, 0.1)
