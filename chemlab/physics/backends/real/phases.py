"""Spontaneous processes in a vessel: violent reactions, salts, acids and bases, crystals, gas, heat to the room."""

from __future__ import annotations

import math
from typing import Any

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import AIR, AMOUNTS, ROLE_GAS, TEMPERATURE
from ...constants import LEAST_CAPACITY, TRACE_MOL
from ...events import RELIEF
from ...surroundings import Surroundings
from ...transfer import heat_capacity, spill, volume, within_range
from .. import react, separate
from .acids import acid_work_size, settle_acids
from .heats import enthalpy, set_enthalpy
from .kinetics import react_work_size
from .partition import place_new
from .real_chemistry import RealChemistry
from .salts import change_amount, settle_with_heat
from .vapor import flash_off

_RTOL, _ATOL = 1e-3, 1e-9
_WARMED_K = 0.01
"""Change of temperature in K by acids and bases above which the contents may boil; below it, they were at equilibrium.
"""


def work_size(chemistry: Any) -> tuple[int, int]:
    """Return the shape of the scratch of reactions plus that of acids, which settle while its last rows are in use."""
    rows, columns = react_work_size(chemistry)
    acid_rows, acid_columns = acid_work_size(chemistry)
    return rows + acid_rows, max(columns, acid_columns)


@inner
def _react_violently(row: FloatArray, chem: Handle, events: FloatArray) -> bool:
    """Run every violent reaction until one of its reactants is consumed; return True if any ran.

    A reaction's safety event grows by the mol of its first reactant.
    """
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
    """Let gas leave an open vessel."""
    chemistry = opened(RealChemistry, chem)
    for i in range(chemistry.role.shape[0]):
        if chemistry.role[i] == ROLE_GAS and row[AMOUNTS + i] > 0.0:
            waste[i] += row[AMOUNTS + i]
            row[AMOUNTS + i] = 0.0


@helper
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """Apply equilibria that hold at any time to a vessel, which is sealed if it holds air: see :func:`settle`."""
    settle(row, chem, row[AIR] > 0.0, waste, events, work)


@separate
def settle(
    row: FloatArray, chem: Handle, sealed: bool, waste: FloatArray, events: FloatArray, work: FloatArray
) -> None:
    """Apply equilibria that hold at any time: violent reactions, acids and bases, salts.

    The enthalpy is conserved, so the temperature follows. Gas leaves a vessel that is not sealed, as does liquid above
    its boiling point.
    """
    chemistry = opened(RealChemistry, chem)
    place_new(row, chem)
    before = enthalpy(row, chem)
    changed, heated = _react_violently(row, chem, events), False
    if chemistry.ionization[0] >= 0:
        cooler = row[TEMPERATURE]
        settle_acids(row, chem, work)
        row[TEMPERATURE] = within_range(row[TEMPERATURE])
        heated = abs(row[TEMPERATURE] - cooler) > _WARMED_K
    if changed:
        set_enthalpy(row, before, chem)
    if settle_with_heat(row, before, chem):
        changed = True
    if sealed:
        return
    _let_out(row, chem, waste)
    if changed or heated:
        events[RELIEF] += flash_off(row, chemistry.ambient_pressure, 0.0, 0.0, chem, waste)
        spill(row, chem, waste, events)


@helper
def elapse(row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> int:
    """Let time pass for an open vessel: slow reactions, growth and dissolution of crystals, heat exchange with the
    room.

    Liquid that is above its boiling point afterwards boils off.
    """
    chemistry = opened(RealChemistry, chem)
    seconds, capacity = ticks * chemistry.tick_seconds, heat_capacity(row, chem)
    if capacity <= LEAST_CAPACITY:
        row[TEMPERATURE] = chemistry.ambient_temperature
    if capacity <= 0.0:
        return 0
    transfer = chemistry.room_transfer * max(volume(row, chem), 1e-3)
    around = Surroundings(chemistry.ambient_temperature, transfer, 0.0, _RTOL, _ATOL)
    lost = events[RELIEF]
    steps = react(row, seconds, around, chem, waste, events, work)
    if steps == 0 and events[RELIEF] > lost:
        steps = 1
    if steps != 0:
        _let_out(row, chem, waste)
        spill(row, chem, waste, events)
    return steps
