"""Air and pressure in a vessel, open or sealed (PHYSICS section 1)."""

from __future__ import annotations

from ..kernels.arrays import FloatArray, Handle
from ..kernels.jit import helper, opened
from .backends import headspace_gas, vapor_pressure
from .chemistry import AIR, CAPACITY, TEMPERATURE, Chemistry
from .constants import GAS_CONSTANT
from .transfer import volume


@helper
def air_in_open_vessel(row: FloatArray, chem: Handle) -> float:
    """Return mol of ambient-pressure air above the contents of an open vessel, at the vessel's temperature."""
    chemistry = opened(Chemistry, chem)
    headspace = max(row[CAPACITY] - volume(row, chem), 0.0)
    return float(chemistry.ambient_pressure * headspace / (GAS_CONSTANT * row[TEMPERATURE]))


@helper
def seal_vessel(row: FloatArray, chem: Handle) -> None:
    """Close the vessel; the air above its contents stays in it."""
    row[AIR] = air_in_open_vessel(row, chem)


@helper
def pressure(row: FloatArray, chem: Handle) -> float:
    """Return the pressure in a sealed vessel in kPa: air in the headspace plus vapour."""
    # A completely full vessel has no headspace to divide by; a thousandth of the capacity represents the gap at the
    # lid.
    headspace = max(row[CAPACITY] - volume(row, chem), 1e-3 * row[CAPACITY])
    return float(headspace_gas(row, chem) * GAS_CONSTANT * row[TEMPERATURE] / headspace + vapor_pressure(row, chem))
