"""Crystals of molecules: they and what is dissolved of them approach saturation."""

from __future__ import annotations

import math

from ....arrays import FloatArray, Handle
from ....chemistry import AMOUNTS, TEMPERATURE
from ....jit import inner, opened
from ...constants import GAS_CONSTANT, TRACE_MOL
from .chemistry import AQUEOUS, MOST_FLUIDS, ORGANIC, RealChemistry
from .heats import crystals, enthalpy, set_enthalpy
from .liquids import Liquids, clear_liquids, gather, split
from .partition import crystallizes

__all__ = ["crystallize"]

_MOST_ROUNDS = 60
_SATURATED = 1e-9
"""Of the logarithm of what is dissolved, where saturation counts as found."""
_FLAT = 0.1
"""Slope of an activity over the logarithm of its amount, below which its secant is not followed."""


@inner
def _dissolved_at_saturation(n: int, at: int, row: FloatArray, chem: Handle, liquids: Liquids) -> float:
    """mol of molecule ``at`` that the vessel's liquids hold in equilibrium with its crystals, by the secant of its
    activity over the logarithm of its amount, within a bracket."""
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
            return float(total)
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
def crystallize(row: FloatArray, seconds: float, chem: Handle) -> bool:
    """Crystals and what is dissolved of them approach saturation; says whether there are any that do."""
    chemistry = opened(RealChemistry, chem)
    m, changed = chemistry.role.shape[0], False
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
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
        place = AMOUNTS + m + 2 * k
        solid = crystals(row, chem, k)
        dissolved = row[place + AQUEOUS] + row[place + ORGANIC]
        if others <= TRACE_MOL:
            saturated = 0.0  # a melt below its melting point
        else:
            if at < 0:
                if n == MOST_FLUIDS:
                    continue
                at = n
                liquids.who[at], liquids.share[at] = i, 0.5
                n += 1
            saturated = _dissolved_at_saturation(n, at, row, chem, liquids)
        if solid <= TRACE_MOL and dissolved <= chemistry.metastable * saturated:
            continue
        moved = (saturated - dissolved) * -math.expm1(-chemistry.crystal_rate * seconds)
        before = enthalpy(row, chem)
        if dissolved > TRACE_MOL:
            scale = (dissolved + moved) / dissolved
            row[place + AQUEOUS] *= scale
            row[place + ORGANIC] *= scale
        elif moved > 0.0:
            row[place + ORGANIC] = (dissolved + moved) * liquids.share[at]
            row[place + AQUEOUS] = max(dissolved + moved - row[place + ORGANIC], 0.0)
        set_enthalpy(row, before, chem)
        changed = changed or abs(moved) > TRACE_MOL
    return changed
