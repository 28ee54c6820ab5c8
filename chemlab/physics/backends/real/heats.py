"""Enthalpy of vessel contents, which changes only by heat transfer."""

from __future__ import annotations

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, TEMPERATURE
from ...constants import LEAST_CAPACITY, ROOM_K
from ...transfer import heat_capacity, within_range
from .real_chemistry import AQUEOUS, ORGANIC, RealChemistry


@helper
def dissolved(row: FloatArray, chem: Handle, k: int) -> float:
    """Return mol of fluid ``k`` (index among the fluids) in both liquids."""
    at = AMOUNTS + opened(RealChemistry, chem).role.shape[0] + 2 * k
    return float(row[at + AQUEOUS] + row[at + ORGANIC])


@helper
def crystals(row: FloatArray, chem: Handle, k: int) -> float:
    """Return mol of fluid ``k`` (index among the fluids) that is in no liquid."""
    chemistry = opened(RealChemistry, chem)
    at = AMOUNTS + chemistry.role.shape[0] + 2 * k
    return float(max(row[AMOUNTS + chemistry.dissolved[k]] - row[at + AQUEOUS] - row[at + ORGANIC], 0.0))


@helper
def _standard_enthalpy(row: FloatArray, chem: Handle) -> float:
    """Return the enthalpy of a vessel's contents at 298.15 K in J."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for i in range(chemistry.role.shape[0]):
        total += row[AMOUNTS + i] * chemistry.formation[i]
    for k in range(chemistry.dissolved.shape[0]):
        if chemistry.fusion[chemistry.dissolved[k]] > 0.0:
            total -= crystals(row, chem, k) * chemistry.fusion[chemistry.dissolved[k]]
    return total


@helper
def enthalpy(row: FloatArray, chem: Handle) -> float:
    """Return the enthalpy of the contents without air in J.

    It is the sum of n (formation + Cp (T - 298.15 K)), less the heat of fusion of crystals.
    """
    return _standard_enthalpy(row, chem) + float(heat_capacity(row, chem) * (row[TEMPERATURE] - ROOM_K))


@helper
def add_heat(row: FloatArray, joules: float, chem: Handle) -> None:
    """Warm (> 0) or cool (< 0) the contents of a vessel, within the range of temperatures.

    Contents with negligible heat capacity take the ambient temperature.
    """
    capacity = heat_capacity(row, chem)
    if capacity > LEAST_CAPACITY:
        row[TEMPERATURE] = within_range(row[TEMPERATURE] + joules / capacity)
    else:
        row[TEMPERATURE] = opened(RealChemistry, chem).ambient_temperature


@helper
def set_enthalpy(row: FloatArray, value: float, chem: Handle) -> None:
    """Set the temperature of a vessel so that its contents have an enthalpy of ``value`` J, within the range of
    temperatures.

    Contents with negligible heat capacity take the ambient temperature.
    """
    capacity = heat_capacity(row, chem)
    if capacity > LEAST_CAPACITY:
        row[TEMPERATURE] = within_range(ROOM_K + (value - _standard_enthalpy(row, chem)) / capacity)
    else:
        row[TEMPERATURE] = opened(RealChemistry, chem).ambient_temperature
