"""Heat contents: what stays the same when nothing but heat goes in or out."""

from __future__ import annotations

from ....arrays import FloatArray, Handle
from ....chemistry import AMOUNTS, TEMPERATURE
from ....jit import helper, opened
from ...transfer import heat_capacity
from .chemistry import RealChemistry
from .fields import STANDARD_K

__all__ = ["enthalpy", "set_enthalpy"]


@helper
def _standard_enthalpy(row: FloatArray, chem: Handle) -> float:
    """What the contents of a vessel would have at 298.15 K, J."""
    chemistry = opened(RealChemistry, chem)
    m, n_dissolved = chemistry.role.shape[0], chemistry.dissolved.shape[0]
    total = 0.0
    for i in range(m):
        total += row[AMOUNTS + i] * chemistry.formation[i]
    if n_dissolved == 0:
        return total
    layers = (row.shape[0] - AMOUNTS - m) // n_dissolved
    for k in range(n_dissolved):
        i = chemistry.dissolved[k]
        if chemistry.fusion[i] > 0.0:
            crystals = row[AMOUNTS + i]
            for layer in range(layers):
                crystals -= row[AMOUNTS + m + k * layers + layer]
            total -= max(crystals, 0.0) * chemistry.fusion[i]
    return total


@helper
def enthalpy(row: FloatArray, chem: Handle) -> float:
    """Enthalpy of the contents of a vessel without air, J: the sum of n (formation + Cp (T - 298.15 K)), less the heat
    of fusion of what has crystallized."""
    return _standard_enthalpy(row, chem) + heat_capacity(row, chem) * (row[TEMPERATURE] - STANDARD_K)


@helper
def set_enthalpy(row: FloatArray, value: float, chem: Handle) -> None:
    """Give the contents of a vessel the temperature at which they have an enthalpy of ``value`` J; an empty vessel has
    none."""
    capacity = heat_capacity(row, chem)
    if capacity > 0.0:
        row[TEMPERATURE] = STANDARD_K + (value - _standard_enthalpy(row, chem)) / capacity
