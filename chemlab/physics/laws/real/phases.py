"""What happens by itself in a vessel: violent reactions, salts, acids and bases, crystals, gas, heat to the room."""

from __future__ import annotations

import math
from typing import Any

from ....arrays import FloatArray, Handle
from ....chemistry import AIR, AMOUNTS, ROLE_GAS, TEMPERATURE
from ....jit import inner, kernel, opened
from ...constants import GAS_CONSTANT, TRACE_MOL
from ...events import RELIEF
from ...surroundings import Surroundings
from ...transfer import heat_capacity, spill, volume
from .. import react
from .acids import acid_work_size, settle_acids
from .chemistry import AQUEOUS, MOST_FLUIDS, ORGANIC, RealChemistry
from .heats import crystals, enthalpy, set_enthalpy
from .kinetics import react_work_size
from .liquids import Liquids, clear_liquids, gather, split
from .partition import crystallizes, place_new
from .salts import change_amount, settle_salts
from .vapor import flash_off

__all__ = ["elapse", "settle_phases", "work_size"]

_MOST_ROUNDS = 60
_RTOL, _ATOL = 1e-3, 1e-9
_SATURATED = 1e-9
"""Of the logarithm of what is dissolved, where saturation counts as found."""
_FLAT = 0.1
"""Slope of an activity over the logarithm of its amount, below which its secant is not followed."""


def work_size(chemistry: Any) -> tuple[int, int]:
    """Of the scratch of reactions and of acids."""
    sizes = react_work_size(chemistry), acid_work_size(chemistry)
    return max(rows for rows, _ in sizes), max(columns for _, columns in sizes)


@inner
def _react_violently(row: FloatArray, chem: Handle, events: FloatArray) -> bool:
    """Run every violent reaction until one of its reactants is gone; the event that one counts as grows by the mol of
    its first reactant. Says whether any ran."""
    chemistry = opened(RealChemistry, chem)
    n, ran = chemistry.role.shape[0], False
    for v in range(chemistry.violent.shape[0]):
        extent = math.inf
        for i in range(n):
            if chemistry.violent[v, i] < 0.0:
                extent = min(extent, row[AMOUNTS + i] / -chemistry.violent[v, i])
        if not TRACE_MOL < extent < math.inf:
            continue
        ran, first = True, True
        for i in range(n):
            change = chemistry.violent[v, i] * extent
            if change < 0.0 and first and chemistry.violent_event[v] >= 0:
                events[chemistry.violent_event[v]] -= change
                first = False
            if change != 0.0:
                change_amount(row, chem, i, change)
    return ran


@inner
def _let_out(row: FloatArray, chem: Handle, waste: FloatArray) -> None:
    """Gas leaves an open vessel."""
    chemistry = opened(RealChemistry, chem)
    for i in range(chemistry.role.shape[0]):
        if chemistry.role[i] == ROLE_GAS and row[AMOUNTS + i] > 0.0:
            waste[i] += row[AMOUNTS + i]
            row[AMOUNTS + i] = 0.0


@kernel
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """What is at equilibrium in any vessel at any time: violent reactions, acids and bases, salts. Heat content stays,
    so the temperature follows. Gas leaves an open vessel, and so does what then is above its boiling point."""
    chemistry = opened(RealChemistry, chem)
    place_new(row, chem)
    before = enthalpy(row, chem)
    changed = _react_violently(row, chem, events)
    if chemistry.ionization[0] >= 0:
        settle_acids(row, chem, work)
    if settle_salts(row, chem):
        changed = True
    if changed:
        set_enthalpy(row, before, chem)
    if row[AIR] > 0.0:
        return  # sealed
    _let_out(row, chem, waste)
    if changed:
        events[RELIEF] += flash_off(row, chemistry.ambient_pressure, 0.0, 0.0, chem, waste)
        spill(row, chem, waste, events)


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
def _crystallize(row: FloatArray, seconds: float, chem: Handle) -> bool:
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


@kernel
def elapse(
    row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray
) -> bool:
    """Time passes for an open vessel: slow reactions go on, crystals grow or dissolve, heat goes to the room; what is
    above its boiling point by then boils off."""
    chemistry = opened(RealChemistry, chem)
    seconds = ticks * chemistry.tick_seconds
    if heat_capacity(row, chem) <= 0.0:
        return False
    place_new(row, chem)
    transfer = chemistry.room_transfer * max(volume(row, chem), 1e-3)
    around = Surroundings(chemistry.ambient_temperature, transfer, 0.0, _RTOL, _ATOL)
    changed = react(row, seconds, around, chem, waste, events, work) != 0
    if _crystallize(row, seconds, chem):
        changed = True
    if changed:
        _let_out(row, chem, waste)
        spill(row, chem, waste, events)
    return changed
