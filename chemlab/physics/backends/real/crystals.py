"""Crystals of molecules: which there are, and what saturates the liquids. They approach that while a vessel reacts
(:mod:`.kinetics`)."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import AMOUNTS, TEMPERATURE
from ...constants import GAS_CONSTANT, TRACE_MOL
from .chemistry import MOST_FLUIDS, RealChemistry
from .heats import crystals, dissolved
from .kinetics import COLUMN, CRYSTALS, PLACE, SATURATED, SATURATION, SHARE, SHARES
from .liquids import Liquids, clear_liquids, gather, split
from .partition import crystallizes

__all__ = ["find_crystals", "limit", "saturate"]

_MOST_ROUNDS = 60
_SATURATED = 1e-9
"""Of the logarithm of what is dissolved, where saturation counts as found."""
_FLAT = 0.1
"""Slope of an activity over the logarithm of its amount, below which its secant is not followed."""


@inner
def _dissolved_at_saturation(n: int, at: int, row: FloatArray, chem: Handle, liquids: Liquids) -> float:
    """mol of molecule ``at`` that the vessel's liquids hold in equilibrium with its crystals, by the secant of its
    activity over the logarithm of its amount, within a bracket; infinity where all that there is dissolves."""
    chemistry = opened(RealChemistry, chem)
    i = int(liquids.who[at])
    total = row[AMOUNTS + i]
    target = -chemistry.fusion[i] / GAS_CONSTANT * (1.0 / row[TEMPERATURE] - 1.0 / chemistry.melting[i])
    low, high = math.log(1e-9 * total), math.log(total)
    here, before, gap_before = high, high, 0.0
    for step in range(_MOST_ROUNDS):
        liquids.mol[at] = math.exp(here)
        split(n, row[TEMPERATURE], chem, liquids)
        phase = n + at if liquids.share[at] > 0.5 else at
        gap = liquids.log_gamma[phase] + math.log(max(liquids.x[phase], 1e-300)) - target
        if gap > 0.0:
            high = here
        elif step == 0:
            return math.inf
        else:
            low = here
        # In a thin solution the activity goes with the amount; where it hardly changes, or turns, halves are safe.
        slope = (gap - gap_before) / (here - before) if here != before else 1.0
        there = here - gap / slope if slope > _FLAT else low
        if not low < there < high:
            there = 0.5 * (low + high)
        before, gap_before, here = here, gap, there
        if abs(here - before) < _SATURATED or high - low < _SATURATED:
            break
    return math.exp(here)


@inner
def saturate(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Find the mol of every fluid that saturate the liquids: into a row of the scratch, infinity where all of it is
    not enough, and for what does not crystallize; with the share of it that goes into the organic phase."""
    chemistry = opened(RealChemistry, chem)
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        work[SATURATION, k], work[SHARES, k] = math.inf, 1.0
        if row[AMOUNTS + i] <= TRACE_MOL or not crystallizes(row, chem, i):
            continue
        liquids = clear_liquids()
        n, at = gather(row, chem, liquids), -1
        for a in range(n):
            if int(liquids.who[a]) == i:
                at = a
        others = 0.0
        for a in range(n):
            others += liquids.mol[a] if a != at else 0.0
        if others <= TRACE_MOL:
            work[SATURATION, k] = 0.0  # a melt below its melting point
            continue
        if at < 0:
            if n == MOST_FLUIDS:
                continue
            at = n
            liquids.who[at], liquids.share[at] = i, 0.5
            n += 1
        work[SATURATION, k] = _dissolved_at_saturation(n, at, row, chem, liquids)
        work[SHARES, k] = liquids.share[at]


@helper
def limit(row: FloatArray, chem: Handle, k: int) -> float:
    """Times saturation up to which fluid ``k`` stays dissolved."""
    return 1.0 if crystals(row, chem, k) > TRACE_MOL else float(opened(RealChemistry, chem).metastable)


@inner
def find_crystals(row: FloatArray, chem: Handle, work: FloatArray) -> int:
    """Describe in the scratch the crystals that dissolve or grow at the saturations that are there; returns how many
    kinds there are."""
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
