"""Vapour pressures and the relief valve: Raoult's law with Clausius-Clapeyron vapour pressures (PHYSICS section 1)."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened
from ...chemistry import AIR, AMOUNTS, CAPACITY, ROLE_SOLUTE, ROLE_SOLVENT, TEMPERATURE, Chemistry
from ...constants import GAS_CONSTANT, TRACE_MOL
from ...events import RELIEF
from ...thermal import pressure
from ...transfer import take, volume

_STEP = 0.05
"""Share of the liquids that evaporates in one step of drying."""
_MOST_STEPS = 1000


@helper
def _atmospheres(material: int, temperature: float, chem: Handle) -> float:
    """Return the vapour pressure of a pure liquid relative to that at its normal boiling point."""
    chemistry = opened(Chemistry, chem)
    power = (
        chemistry.vaporization[material] / GAS_CONSTANT * (1.0 / chemistry.boiling_point[material] - 1.0 / temperature)
    )
    return math.exp(min(power, 50.0))


@helper
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Return the sum of x_i p_i(T) over the liquids in kPa (Raoult; Clausius-Clapeyron from the normal boiling
    point).
    """
    chemistry = opened(Chemistry, chem)
    moles, partial = 0.0, 0.0
    for i in range(chemistry.role.shape[0]):
        if chemistry.role[i] == ROLE_SOLVENT or chemistry.role[i] == ROLE_SOLUTE:
            amount = row[AMOUNTS + i]
            if amount > 0.0:
                moles += amount
                partial += amount * _atmospheres(i, row[TEMPERATURE], chem)
    return 101.325 * partial / moles if moles > 0.0 else 0.0


@helper
def headspace_gas(row: FloatArray, chem: Handle) -> float:
    """Return mol of air; other gases have left."""
    return float(row[AIR])


@helper
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Open the relief valve: above ``rated`` kPa, gas leaves until the pressure is back at ``rated``.

    Air and vapour leave in proportion to their pressures. Lost vapour is taken from the liquid and added to waste; it
    is a safety event. The liquid replaces lost vapour at once, so a vessel whose vapour pressure alone exceeds the
    rating vents every tick.
    """
    chemistry = opened(Chemistry, chem)
    total = pressure(row, chem)
    if total <= rated:
        return
    vapor = vapor_pressure(row, chem)
    headspace = max(row[CAPACITY] - volume(row, chem), 1e-3 * row[CAPACITY])
    leaving = (total - rated) * headspace / (GAS_CONSTANT * row[TEMPERATURE])
    row[AIR] -= min(leaving * (1.0 - vapor / total), row[AIR])
    moles = 0.0
    for i in range(chemistry.role.shape[0]):
        if chemistry.role[i] == ROLE_SOLVENT or chemistry.role[i] == ROLE_SOLUTE:
            moles += row[AMOUNTS + i]
    if moles <= 0.0:
        return
    per_pressure = leaving / total
    for j in range(chemistry.volatile.shape[0]):
        i = chemistry.volatile[j]
        amount = row[AMOUNTS + i]
        if amount > 0.0:
            lost = min(per_pressure * 101.325 * amount / moles * _atmospheres(i, row[TEMPERATURE], chem), amount)
            take(row, chem, i, lost)
            waste[i] += lost
            events[RELIEF] += lost


@helper
def dry(row: FloatArray, litres: float, chem: Handle, waste: FloatArray) -> None:
    """Remove air saturated with every liquid's x_i p_i(T), in steps of a fixed evaporated share."""
    chemistry = opened(Chemistry, chem)
    left = litres
    for _step in range(_MOST_STEPS):
        moles = 0.0
        for j in range(chemistry.volatile.shape[0]):
            moles += row[AMOUNTS + chemistry.volatile[j]]
        rate = vapor_pressure(row, chem) / (GAS_CONSTANT * row[TEMPERATURE])  # mol per litre of air
        if moles <= TRACE_MOL or rate <= 0.0 or left <= 1e-9 * litres:
            return
        air = min(left, _STEP * moles / rate)
        gone = 0.0
        for j in range(chemistry.volatile.shape[0]):
            i = chemistry.volatile[j]
            partial = 101.325 * _atmospheres(i, row[TEMPERATURE], chem) / (GAS_CONSTANT * row[TEMPERATURE] * moles)
            lost = row[AMOUNTS + i] * -math.expm1(-partial * air)
            take(row, chem, i, lost)
            waste[i] += lost
            gone += lost
        left -= gone / rate
