"""Heat, boiling, condensing, vapour pressure and the relief valve (PHYSICS sections 1 and 4)."""

from __future__ import annotations

import math

from ..shelf import (
    AIR,
    AMOUNTS,
    CAPACITY,
    ROLE_SOLUTE,
    ROLE_SOLVENT,
    TEMPERATURE,
    Chemistry,
    FloatArray,
)
from .events import BOILED_DRY, DRY_HEATING, RELIEF
from .jit import helper, kernel
from .kinetics import GAS_CONSTANT
from .transfer import TRACE_MOL, add, heat_capacity, volume

__all__ = ["air_in_open_vessel", "heat", "pressure", "seal", "vapor_pressure", "vent"]


@helper
def air_in_open_vessel(row: FloatArray, chem: Chemistry) -> float:
    """mol of ambient-pressure air above the contents of an open vessel, at the vessel's temperature."""
    headspace = max(row[CAPACITY] - volume(row, chem), 0.0)
    return float(chem.ambient_pressure * headspace / (GAS_CONSTANT * row[TEMPERATURE]))


@helper
def seal(row: FloatArray, chem: Chemistry) -> None:
    """Close the vessel: the air above its contents stays in it."""
    row[AIR] = air_in_open_vessel(row, chem)


@helper
def vapor_pressure(row: FloatArray, chem: Chemistry) -> float:
    """Sum of x_i p_i(T) over the liquids (Raoult; Clausius-Clapeyron from the normal boiling point), kPa."""
    moles, partial = 0.0, 0.0
    for i in range(chem.role.shape[0]):
        if chem.role[i] == ROLE_SOLVENT or chem.role[i] == ROLE_SOLUTE:
            amount = row[AMOUNTS + i]
            if amount > 0.0:
                power = chem.vaporization[i] / GAS_CONSTANT * (1.0 / chem.boiling_point[i] - 1.0 / row[TEMPERATURE])
                moles += amount
                partial += amount * math.exp(min(power, 50.0))
    return 101.325 * partial / moles if moles > 0.0 else 0.0


@helper
def pressure(row: FloatArray, chem: Chemistry) -> float:
    """Pressure in a sealed vessel, kPa: its air in the headspace, plus vapour."""
    # A brim-full vessel has no headspace to divide by; one part in a thousand stands for the gap at the lid.
    headspace = max(row[CAPACITY] - volume(row, chem), 1e-3 * row[CAPACITY])
    return float(row[AIR] * GAS_CONSTANT * row[TEMPERATURE] / headspace + vapor_pressure(row, chem))


@kernel
def vent(row: FloatArray, rated: float, chem: Chemistry, waste: FloatArray, events: FloatArray) -> None:
    """Relief valve: above ``rated`` kPa gas leaves until the pressure is back there, air and vapour in the
    proportion of their pressures; lost vapour comes from the liquid and goes to waste, and is an event.

    The liquid replaces lost vapour at once, so a vessel whose vapour alone exceeds the rating vents every tick.
    """
    total = pressure(row, chem)
    if total <= rated:
        return
    vapor = vapor_pressure(row, chem)
    headspace = max(row[CAPACITY] - volume(row, chem), 1e-3 * row[CAPACITY])
    leaving = (total - rated) * headspace / (GAS_CONSTANT * row[TEMPERATURE])
    row[AIR] -= min(leaving * (1.0 - vapor / total), row[AIR])
    moles = 0.0
    for i in range(chem.role.shape[0]):
        if chem.role[i] == ROLE_SOLVENT or chem.role[i] == ROLE_SOLUTE:
            moles += row[AMOUNTS + i]
    if moles <= 0.0:
        return
    per_pressure = leaving / total
    for j in range(chem.volatile.shape[0]):
        i = chem.volatile[j]
        amount = row[AMOUNTS + i]
        if amount > 0.0:
            power = chem.vaporization[i] / GAS_CONSTANT * (1.0 / chem.boiling_point[i] - 1.0 / row[TEMPERATURE])
            lost = min(per_pressure * 101.325 * amount / moles * math.exp(min(power, 50.0)), amount)
            take(row, chem, i, lost)
            waste[i] += lost
            events[RELIEF] += lost


@helper
def take(row: FloatArray, chem: Chemistry, material: int, mol: float) -> None:
    """Remove ``mol`` of a liquid from the vessel (from every layer alike); never more than is there."""
    n, n_solvents = chem.role.shape[0], chem.solvents.shape[0]
    before = row[AMOUNTS + material]
    left = max(before - mol, 0.0)
    k = chem.dissolved_at[material]
    if k >= 0 and before > 0.0:
        first = AMOUNTS + n + k * n_solvents
        for layer in range(n_solvents):
            row[first + layer] *= left / before
    row[AMOUNTS + material] = left


@kernel
def heat(
    row: FloatArray,
    receiver: FloatArray,
    joules: float,
    hottest: float,
    coolest: float,
    chem: Chemistry,
    waste: FloatArray,
    events: FloatArray,
) -> tuple[float, float]:
    """Heat (> 0) or cool (< 0) a vessel; what boils condenses into the receiver at ambient temperature.

    Liquids boil one after the other, lowest boiling point first, each at its own boiling point.

    Args:
        row, receiver: vessel rows.
        joules: heat offered, J.
        hottest, coolest: K, temperatures of the heating mantle and the coolant: no heat flows past them.
        chem: material constants.
        waste: [M] mol, receives what overflows the receiver.
        events: safety events row.

    Returns:
        (heat that went in, heat the condenser took away), J. Heat in = change of (sum n Cp + air) (T - ambient)
        over both vessels + heat to the condenser, as long as nothing spills.
    """
    if joules == 0.0:
        return 0.0, 0.0
    contents = heat_capacity(row, chem)
    if contents <= 0.0:
        if joules > 0.0:
            events[DRY_HEATING] += 1.0
        return 0.0, 0.0
    air = air_in_open_vessel(row, chem) * chem.heat_capacity[chem.air]
    if joules < 0.0:
        # Cooling a vessel that is colder than the coolant already takes nothing out of it.
        target = max(row[TEMPERATURE] + joules / (contents + air), min(coolest, row[TEMPERATURE]))
        taken = (contents + air) * (target - row[TEMPERATURE])
        row[TEMPERATURE] = target
        return taken, 0.0
    left, condenser, boiled = joules, 0.0, False
    for j in range(chem.volatile.shape[0]):
        i = chem.volatile[j]
        amount = row[AMOUNTS + i]
        if amount <= TRACE_MOL:
            continue
        if chem.boiling_point[i] > hottest:
            break
        capacity = heat_capacity(row, chem) + air
        needed = capacity * (chem.boiling_point[i] - row[TEMPERATURE])
        if left < needed:
            row[TEMPERATURE] += left / capacity
            return joules, condenser
        # Poured onto something hotter than its boiling point, a liquid boils from that heat first (needed < 0).
        left -= needed
        row[TEMPERATURE] = chem.boiling_point[i]
        vapor = min(left / chem.vaporization[i], amount)
        left -= vapor * chem.vaporization[i]
        take(row, chem, i, vapor)
        sensible = chem.heat_capacity[i] * (row[TEMPERATURE] - chem.ambient_temperature)
        condenser += vapor * (chem.vaporization[i] + sensible)
        add(receiver, i, vapor, chem.ambient_temperature, chem, waste, events)
        boiled = True
        if row[AMOUNTS + i] > TRACE_MOL:
            return joules, condenser
        left = max(left, 0.0)
    liquid = False
    for j in range(chem.volatile.shape[0]):
        liquid = liquid or row[AMOUNTS + chem.volatile[j]] > TRACE_MOL
    if not liquid:
        events[BOILED_DRY if boiled else DRY_HEATING] += 1.0
    capacity = heat_capacity(row, chem) + air
    target = max(min(row[TEMPERATURE] + left / capacity, hottest), row[TEMPERATURE])
    left -= capacity * (target - row[TEMPERATURE])
    row[TEMPERATURE] = target
    # What the vessel itself gave up when something boiled from its heat does not flow back into the mantle.
    refused = min(left, joules)
    return joules - refused, condenser + (left - refused)
