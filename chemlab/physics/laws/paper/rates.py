"""Reactions at the temperature that the vessel is kept at (PHYSICS section 1)."""

from __future__ import annotations

from ....arrays import FloatArray, Handle
from ....chemistry import TEMPERATURE, Chemistry
from ....jit import helper
from ...kinetics import integrate, react_work_size
from ...transfer import heat_capacity, liquid_volume

__all__ = ["elapse", "enthalpy", "react", "reflux", "work_size"]


@helper
def react(
    row: FloatArray,
    chem: Handle,
    dt: float,
    jacket: float,
    transfer: float,
    rtol: float,
    atol: float,
    work: FloatArray,
) -> int:
    """Mass action at the temperature of the contents: reactions have no heat, so that of the jacket is theirs."""
    steps = integrate(row, chem, liquid_volume(row, chem), row[TEMPERATURE], dt, rtol, atol, work)
    work[0, 0] = row[TEMPERATURE]
    return steps


@helper
def enthalpy(row: FloatArray, chem: Handle) -> float:
    """Warmth alone: reactions have no heat."""
    return float(heat_capacity(row, chem) * row[TEMPERATURE])


@helper
def elapse(
    row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray
) -> bool:
    """Nothing happens in a vessel that nobody works on."""
    return False


@helper
def reflux(row: FloatArray, joules: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Nothing: a reaction does not heat."""


def work_size(chemistry: Chemistry) -> tuple[int, int]:
    """Of the scratch of reactions and of the partition."""
    rows, columns = react_work_size(chemistry)
    return max(rows, 2), max(columns, len(chemistry.solvents))
