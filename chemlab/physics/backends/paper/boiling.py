"""Boiling: liquids boil one after another, lowest boiling point first, each at its own (PHYSICS section 4)."""

from __future__ import annotations

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, TEMPERATURE, Chemistry
from ...constants import TRACE_MOL
from ...events import BOILED_DRY, DRY_HEATING
from ...thermal import air_in_open_vessel
from ...transfer import add, heat_capacity, take


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
    """Heat (> 0) or cool (< 0) a vessel; vapour condenses into the receiver at ambient temperature.

    Liquids boil one after another, lowest boiling point first, each at its own boiling point.
    """
    chemistry = opened(Chemistry, chem)
    hottest, coolest = limits[0], limits[1]
    if joules == 0.0:
        return 0.0, 0.0
    contents = heat_capacity(row, chem)
    if contents <= 0.0:
        if joules > 0.0:
            events[DRY_HEATING] += 1.0
        return 0.0, 0.0
    air = air_in_open_vessel(row, chem) * chemistry.heat_capacity[chemistry.air]
    if joules < 0.0:
        # A vessel that is already colder than the coolant is not cooled further.
        target = max(row[TEMPERATURE] + joules / (contents + air), min(coolest, row[TEMPERATURE]))
        taken = (contents + air) * (target - row[TEMPERATURE])
        row[TEMPERATURE] = target
        return taken, 0.0
    left, condenser, boiled = joules, 0.0, False
    for j in range(chemistry.volatile.shape[0]):
        i = chemistry.volatile[j]
        amount = row[AMOUNTS + i]
        if amount <= TRACE_MOL:
            continue
        if chemistry.boiling_point[i] > hottest:
            break
        capacity = heat_capacity(row, chem) + air
        needed = capacity * (chemistry.boiling_point[i] - row[TEMPERATURE])
        if left < needed:
            row[TEMPERATURE] += left / capacity
            return joules, condenser
        # A liquid poured onto hotter contents boils from their heat first (needed < 0).
        left -= needed
        row[TEMPERATURE] = chemistry.boiling_point[i]
        vapor = min(left / chemistry.vaporization[i], amount)
        left -= vapor * chemistry.vaporization[i]
        take(row, chem, i, vapor)
        sensible = chemistry.heat_capacity[i] * (row[TEMPERATURE] - chemistry.ambient_temperature)
        condenser += vapor * (chemistry.vaporization[i] + sensible)
        add(receiver, i, vapor, chemistry.ambient_temperature, chem, waste, events)
        boiled = True
        if row[AMOUNTS + i] > TRACE_MOL:
            return joules, condenser
        left = max(left, 0.0)
    liquid = False
    for j in range(chemistry.volatile.shape[0]):
        liquid = liquid or row[AMOUNTS + chemistry.volatile[j]] > TRACE_MOL
    if not liquid:
        events[BOILED_DRY if boiled else DRY_HEATING] += 1.0
    capacity = heat_capacity(row, chem) + air
    if capacity > 0.0:
        target = max(min(row[TEMPERATURE] + left / capacity, hottest), row[TEMPERATURE])
        left -= capacity * (target - row[TEMPERATURE])
        row[TEMPERATURE] = target
    # Heat of the vessel itself that was spent on boiling does not return to the mantle.
    refused = min(left, joules)
    return joules - refused, condenser + (left - refused)
