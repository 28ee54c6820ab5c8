"""Reactions at the controlled temperature of the vessel (PHYSICS section 1)."""

from __future__ import annotations

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper
from ...chemistry import TEMPERATURE, Chemistry
from ...mass_action import integrate, react_work_size
from ...surroundings import Surroundings
from ...transfer import liquid_volume


@helper
def react(
    row: FloatArray,
    dt: float,
    around: Surroundings,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> int:
    """React by mass action at the temperature of the contents; reactions have no heat, so nothing boils."""
    return integrate(row, chem, liquid_volume(row, chem), row[TEMPERATURE], dt, around.rtol, around.atol, work)


@helper
def elapse(row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> int:
    """Do nothing: idle vessels do not change."""
    return 0


def work_size(chemistry: Chemistry) -> tuple[int, int]:
    """Return the shape of the scratch of reactions and partition."""
    rows, columns = react_work_size(chemistry)
    return max(rows, 2), max(columns, len(chemistry.solvents))
