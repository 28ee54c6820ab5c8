"""Boiling: differential distillation (Rayleigh 1902) of a non-ideal pot, through a column of theoretical stages.

The pot is stirred by its own boiling, so its phases are at equilibrium; its vapour has the bubble point's composition.
A column has constant molar flows, no holdup and a total condenser.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened, scratch
from ...chemistry import TEMPERATURE
from ...constants import LEAST_CAPACITY, TRACE_MOL
from ...events import BOILED_DRY, DRY_HEATING
from ...transfer import add, heat_capacity, within_range
from .acids import ionizes, settle_acids
from .column import LADDER, MOST_STAGES, overhead
from .heats import add_heat, enthalpy, set_enthalpy
from .liquids import clear_liquids, count_ions, gather, liquids_in, on_curve
from .partition import melt, melting_point
from .real_chemistry import MOST_FLUIDS, RealChemistry
from .salts import let_salts_fall_out, settle_salts, settle_with_heat
from .vapor import bubble_point, latent_heat, write_back

_STEP = 0.15
"""Maximum share of the liquid that boils off in one step of the integration (second order)."""
_MOST_STEPS = 400
_MOST_ATTEMPTS = 6
_SHORT = 0.999
"""Share of the remaining heat that a step uses if its own demand is larger."""
_SAME_IONS = 1e-6
"""Relative change of the ions, by salts that dissolve on warming, below which the boiling point is the same."""
_MANTLE_K = 0.05
"""Allowed difference in K between the mantle's temperature and the boiling point at which boiling ends."""
_JUMP_K = 2.0
"""Maximum rise in K of the boiling point in a step that begins with two layers, of which one may boil away."""
_LEAST_PART = 0.2
"""Minimum part of a step that a shorter attempt keeps."""
_TRIFLE = 2e-3
"""Share of the heat that may remain unused at the end by boiling contents."""


@helper
def evaporate(n: int, mol: float, partial: FloatArray, before: FloatArray, at: FloatArray, block: FloatArray) -> None:
    """Remove ``mol`` of vapour with the composition ``partial`` from the amounts ``before``.

    Each molecule leaves at the rate that belongs to the amounts ``at``; none becomes negative, however volatile.
    """
    liquids = liquids_in(block)
    total = 0.0
    for a in range(n):
        total += partial[a]
    for a in range(n):
        share = total * at[a]  # too small for the division when almost nothing is left
        rate = partial[a] / share if share > 0.0 else 0.0
        liquids.mol[a] = before[a] * math.exp(-min(rate * mol, 700.0))


class _Still(NamedTuple):
    """Parameters of a column, and scratch of the integration."""

    trays: int
    returned: float
    """reflux ratio: mol returned per mol that leaves"""
    hottest: float
    ladder: FloatArray
    partial: FloatArray
    before: FloatArray
    halfway: FloatArray


@helper
def _boil(
    row: FloatArray, n: int, boiling: float, left: float, begun: bool, still: _Still, chem: Handle, block: FloatArray
) -> tuple[float, float]:
    """Integrate one midpoint step of at most ``left`` joules; the new amounts are in ``liquids``, the old in
    ``still.before``.

    Returns:
        Joules spent on vapour, and the change in K of the boiling point that the pot follows; vapour leaves halfway.
    """
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    ambient, before, halfway, partial = chemistry.ambient_pressure, still.before, still.halfway, still.partial
    mol, spent, rise, jump = 0.0, 0.0, 0.0, math.inf
    for a in range(n):
        before[a] = liquids.mol[a]
        mol += _STEP * liquids.mol[a]
        if 0.0 < liquids.share[a] < 1.0:
            jump = _JUMP_K
    for attempt in range(_MOST_ATTEMPTS):
        if attempt > 0:
            for a in range(n):
                liquids.mol[a] = before[a]
            bubble_point(n, ambient, boiling, chem, block, partial)
        price = (1.0 + still.returned) * latent_heat(n, boiling, partial, chem, block)
        mol = min(mol, left / price)
        if still.trays > 0:
            overhead(n, still.trays, still.returned, begun, chem, block, still.ladder, partial)
        evaporate(n, 0.5 * mol, partial, before, before, block)
        for a in range(n):
            halfway[a] = liquids.mol[a]
        warmer = bubble_point(n, ambient, boiling, chem, block, partial)
        if still.trays > 0:
            begun = attempt >= 0  # True; numba would compile the function again for a constant
            overhead(n, still.trays, still.returned, begun, chem, block, still.ladder, partial)
        evaporate(n, mol, partial, before, halfway, block)
        # The pot follows its boiling point up to the temperature of the heat source.
        room, climb = still.hottest - boiling, 2.0 * (warmer - boiling)
        if (climb > 0.5 * room or jump < math.inf) and attempt < _MOST_ATTEMPTS - 1:
            climb = bubble_point(n, ambient, warmer, chem, block, partial) - boiling
            # Less boils off until the boiling point is that of the mantle, or until a layer has boiled away.
            if climb > min(room + _MANTLE_K, jump):
                mol *= max(min(room, jump) / climb, _LEAST_PART)
                continue
        rise = max(min(2.0 * (warmer - boiling), room), 0.0)
        spent, warming = 0.0, rise * heat_capacity(row, chem)
        for a in range(n):
            i = int(liquids.who[a])
            gone = before[a] - liquids.mol[a]
            spent += gone * (on_curve(chemistry.vaporizing, i, boiling + 0.5 * rise, chem) + liquids.parting[a])
            warming -= 0.5 * rise * gone * chemistry.heat_capacity[i]
        spent *= 1.0 + still.returned
        if spent + warming <= left * (1.0 + 1e-12) or attempt == _MOST_ATTEMPTS - 1:
            break
        mol *= _SHORT * left / (spent + warming)
    taken = spent
    for a in range(n):
        capacity = chemistry.heat_capacity[int(liquids.who[a])]
        taken += 0.5 * rise * (before[a] - liquids.mol[a]) * capacity
    if taken > left:
        # A small remainder in the pot has no heat content of its own: evaporation is limited by the supplied heat.
        for a in range(n):
            liquids.mol[a] = before[a] - left / taken * (before[a] - liquids.mol[a])
        spent *= left / taken
    return spent, rise


@helper
def _change_warmth(row: FloatArray, joules: float, coolest: float, hottest: float, chem: Handle) -> float:
    """Warm (> 0) or cool (< 0) the contents within the limits; return the absorbed joules."""
    capacity, was = heat_capacity(row, chem), row[TEMPERATURE]
    if capacity <= LEAST_CAPACITY:
        row[TEMPERATURE] = opened(RealChemistry, chem).ambient_temperature
    else:
        row[TEMPERATURE] = within_range(max(min(was + joules / capacity, max(hottest, was)), min(coolest, was)))
    return float(capacity * (row[TEMPERATURE] - was))


@helper
def _exchange_salty(row: FloatArray, temperature: float, joules: float, chem: Handle) -> float:
    """Warm (> 0) or cool (< 0) contents whose salts dissolve or precipitate, up to a temperature in K; return the J
    left.
    """
    content = enthalpy(row, chem)
    row[TEMPERATURE] = temperature
    settle_salts(row, chem)
    left = content + joules - enthalpy(row, chem)
    if left * joules < 0.0:
        set_enthalpy(row, content + joules, chem)
        settle_with_heat(row, content + joules, chem)
        left = 0.0
    return left


@helper
def _collect(
    receiver: FloatArray,
    n: int,
    distilled: FloatArray,
    chem: Handle,
    block: FloatArray,
    waste: FloatArray,
    events: FloatArray,
) -> float:
    """Move the distillate into the receiver; return J of the heat of fusion of what is solid at room temperature."""
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    solidified = 0.0
    for a in range(n):
        if distilled[a] > 0.0:
            i = int(liquids.who[a])
            add(receiver, i, distilled[a], chemistry.ambient_temperature, chem, waste, events)
            solidified += distilled[a] * chemistry.fusion[i]
    for a in range(MOST_FLUIDS):
        distilled[a] = 0.0
    return solidified


@helper
def heat(
    row: FloatArray,
    receiver: FloatArray,
    joules: float,
    limits: FloatArray,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> tuple[float, float]:
    """Heat (> 0) or cool (< 0) a vessel; vapour condenses into the receiver at ambient temperature."""
    chemistry = opened(RealChemistry, chem)
    hottest, coolest = limits[0], limits[1]
    if joules == 0.0 or heat_capacity(row, chem) <= LEAST_CAPACITY:
        if joules > 0.0:
            events[DRY_HEATING] += 1.0
        return 0.0, 0.0
    if joules < 0.0:
        taken = _change_warmth(row, joules, coolest, math.inf, chem)
        if taken > joules and row[TEMPERATURE] >= coolest:
            taken = joules - _exchange_salty(row, coolest, joules - taken, chem)
        return taken, 0.0
    trays = int(min(max(limits[2] - 1.0, 0.0), MOST_STAGES))
    partial, before, halfway = scratch(MOST_FLUIDS), scratch(MOST_FLUIDS), scratch(MOST_FLUIDS)
    distilled, block = scratch(MOST_FLUIDS), clear_liquids()
    liquids = liquids_in(block)
    returned = limits[3] if trays > 0 else 0.0
    still = _Still(trays, returned, hottest, scratch(LADDER), partial, before, halfway)
    n = gather(row, chem, block)
    for a in range(n):
        distilled[a] = 0.0
    left, condenser, boiled, dry = joules, 0.0, False, n == 0
    profiled = 0  # molecules in the column's profile, from which the next step begins
    for _step in range(_MOST_STEPS):
        everything = 0.0
        for a in range(n):
            everything += liquids.mol[a]
        dry = everything <= 10.0 * n * TRACE_MOL
        boiling = math.inf
        if not dry:
            boiling = bubble_point(n, chemistry.ambient_pressure, row[TEMPERATURE], chem, block, partial)
        melting = melting_point(row, chem)
        if melting <= min(boiling, hottest):
            needed = heat_capacity(row, chem) * (melting - row[TEMPERATURE])
            if left < needed:
                break
            row[TEMPERATURE] = melting
            left -= needed + melt(row, melting, left - needed, chem)
            condenser += _collect(receiver, n, distilled, chem, block, waste, events)
            n, profiled = gather(row, chem, block), 0
            continue
        if not dry and liquids.ions[1] > TRACE_MOL and row[TEMPERATURE] < min(boiling, hottest):
            # Salts dissolve while it warms.
            ions = liquids.ions[0]
            left = _exchange_salty(row, min(boiling, hottest), left, chem)
            if left <= 0.0:
                break
            count_ions(row, chem, block)
            if abs(liquids.ions[0] - ions) > _SAME_IONS * ions:
                continue
        if dry or boiling > hottest - _MANTLE_K:
            break
        needed = heat_capacity(row, chem) * (boiling - row[TEMPERATURE])
        if left < needed:
            break
        # A liquid poured onto hotter contents boils from their heat first (needed < 0).
        left -= needed
        row[TEMPERATURE] = boiling
        # Only here: after the last of a volatile material has left, a step warms the pot beyond its new boiling point.
        if left <= _TRIFLE * joules:
            hottest = boiling
            break
        spent, rise = _boil(row, n, boiling, left, profiled == n, still, chem, block)
        profiled = n
        for a in range(n):
            gone = before[a] - liquids.mol[a]
            distilled[a] += gone
            capacity = gone * chemistry.heat_capacity[int(liquids.who[a])]
            condenser += capacity * (boiling + 0.5 * rise - chemistry.ambient_temperature)
            left -= 0.5 * rise * capacity
        condenser += spent
        left -= spent
        boiled = True
        write_back(row, n, chem, block)
        capacity, was = heat_capacity(row, chem), row[TEMPERATURE]
        add_heat(row, min(rise * capacity, left), chem)
        left -= capacity * (row[TEMPERATURE] - was)
        if capacity <= LEAST_CAPACITY:
            dry = True
            break
        if ionizes(chem):
            settle_acids(row, chem, work)
            row[TEMPERATURE] = within_range(row[TEMPERATURE])
            condenser += _collect(receiver, n, distilled, chem, block, waste, events)
            n = gather(row, chem, block)
        if let_salts_fall_out(row, chem):
            count_ions(row, chem, block)
    if boiled:
        write_back(row, n, chem, block)  # boiling has stirred the layers
    condenser += _collect(receiver, n, distilled, chem, block, waste, events)
    if dry:
        events[BOILED_DRY if boiled else DRY_HEATING] += 1.0
    if left > 0.0:
        left -= _change_warmth(row, left, 0.0, hottest, chem)
    # Heat of the vessel itself that was spent on boiling does not return to the mantle.
    refused = min(max(left, 0.0), joules)
    return joules - refused, condenser + (left - refused)
