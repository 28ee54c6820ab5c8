"""Crystals of molecules: existing ones, and saturation of the liquids.

Vessels approach saturation while they react (:mod:`.kinetics`).
"""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import AMOUNTS, TEMPERATURE
from ...constants import GAS_CONSTANT, TRACE_MOL
from .. import separate
from .heats import crystals, dissolved
from .kinetics import COLUMN, CRYSTALS, PLACE, SATURATED, SATURATION, SHARE, SHARES
from .liquids import clear_liquids, gather, liquids_in, split
from .partition import crystallizes
from .real_chemistry import MOST_FLUIDS, RealChemistry

_MOST_ROUNDS = 60
_SATURATED = 1e-9
"""Convergence tolerance of ln of the dissolved amount at saturation."""
_FLAT = 0.1
"""Slope of an activity over the logarithm of the amount below which a molecule seems to form a liquid of its own."""


@helper
def _dilute(n: int, at: int, block: FloatArray) -> float:
    """Return mol of molecule ``at`` in a single liquid as dilute as the aqueous phase; 0 without one."""
    liquids = liquids_in(block)
    others, wet = 0.0, 0.0
    for a in range(n):
        if a != at:
            others += liquids.mol[a]
            wet += liquids.mol[a] * (1.0 - liquids.share[a])
    return liquids.mol[at] * (1.0 - liquids.share[at]) * others / wet if wet > TRACE_MOL else 0.0


@inner
def _dissolved_at_saturation(n: int, at: int, row: FloatArray, chem: Handle, block: FloatArray) -> float:
    """Return mol of molecule ``at`` in the vessel's liquids in equilibrium with its crystals; infinity if all
    dissolves.

    Solved by a bracketed secant method in the logarithm of the amount.
    """
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    i = int(liquids.who[at])
    total = row[AMOUNTS + i]
    target = -chemistry.fusion[i] / GAS_CONSTANT * (1.0 / row[TEMPERATURE] - 1.0 / chemistry.melting[i])
    low, high = math.log(1e-9 * total), math.log(total)
    here, before, gap_before, tried = high, high, 0.0, False
    for step in range(_MOST_ROUNDS):
        liquids.mol[at] = math.exp(here)
        for a in range(n):
            liquids.share[a] = 0.0  # begun with the liquids of another amount, it may miss one
        split(n, row[TEMPERATURE], chem, block)
        phase = n + at if liquids.share[at] > 0.5 else at
        gap = liquids.log_gamma[phase] + math.log(max(liquids.x[phase], 1e-300)) - target
        if gap > 0.0:
            high = here
        elif step == 0:
            return math.inf
        else:
            low = here
        # In dilute solution the activity is proportional to the amount. A molecule that forms a liquid of its own is
        # nearly as active however much there is: saturation may be below the amount at which that liquid appears.
        slope = (gap - gap_before) / (here - before) if here != before else 1.0
        there = here - gap / slope if slope > 0.0 else low
        if gap > 0.0 and slope < _FLAT and not tried:
            tried, there = True, math.log(max(_dilute(n, at, block), 1e-300)) - gap
        if not low < there < high:
            there = 0.5 * (low + high)
        before, gap_before, here = here, gap, there
        if abs(here - before) < _SATURATED or high - low < _SATURATED:
            break
    return math.exp(here)


@separate
def saturate(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Compute the mol of every fluid that saturate the liquids, and their share in the organic phase, into the scratch.

    The value is infinity for fluids that do not crystallize, and if the total amount does not saturate the liquids.
    """
    chemistry = opened(RealChemistry, chem)
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        work[SATURATION, k], work[SHARES, k] = math.inf, 1.0
        if row[AMOUNTS + i] <= TRACE_MOL or not crystallizes(row, chem, i):
            continue
        block = clear_liquids()
        liquids = liquids_in(block)
        n, at = gather(row, chem, block), -1
        for a in range(n):
            if int(liquids.who[a]) == i:
                at = a
        others = 0.0
        for a in range(n):
            others += liquids.mol[a] if a != at else 0.0
        if others <= TRACE_MOL:
            work[SATURATION, k] = 0.0  # the molten state below its melting point
            continue
        if at < 0:
            if n == MOST_FLUIDS:
                continue
            at = n
            liquids.who[at], liquids.share[at] = i, 0.5
            n += 1
        work[SATURATION, k] = _dissolved_at_saturation(n, at, row, chem, block)
        work[SHARES, k] = liquids.share[at]


@helper
def limit(row: FloatArray, chem: Handle, k: int) -> float:
    """Return the ratio to saturation up to which fluid ``k`` stays dissolved."""
    return 1.0 if crystals(row, chem, k) > TRACE_MOL else float(opened(RealChemistry, chem).metastable)


@inner
def find_crystals(row: FloatArray, chem: Handle, work: FloatArray) -> int:
    """Describe in the scratch the crystals that dissolve or grow at the current saturations; return the number of
    kinds.
    """
    chemistry = opened(RealChemistry, chem)
    found, columns = 0, chemistry.species.shape[0]
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if row[AMOUNTS + i] <= TRACE_MOL or not crystallizes(row, chem, i):
            continue
        solid = crystals(row, chem, k)
        if solid <= TRACE_MOL and dissolved(row, chem, k) <= chemistry.metastable * work[SATURATION, k]:
            continue
        work[PLACE, found], work[COLUMN, found] = k, columns + found
        for j in range(columns):
            if chemistry.species[j] == i:
                work[COLUMN, found] = j
        work[CRYSTALS, found], work[SATURATED, found] = solid, work[SATURATION, k]
        work[SHARE, found] = work[SHARES, k]
        found += 1
    return found
