"""Reactions in a vessel that is open, or open through a condenser: what boils meanwhile keeps its temperature."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..arrays import FloatArray, Handle
from ..chemistry import TEMPERATURE, Chemistry
from ..jit import helper, opened
from .laws import enthalpy, react, reflux, vapor_pressure
from .transfer import heat_capacity

__all__ = ["Surroundings", "react_open"]

_OVERSHOT_K = 1.0
"""Beyond the boiling point, up to which contents may be followed as if they could not boil."""
_LOST_K = 5.0
"""By which the heat that the condenser does not take would warm the contents, at most, in a part of the time."""
_MOST_PARTS = 512
_NEARLY = 0.99
"""Of the room's pressure, at which contents count as boiling to begin with."""


class Surroundings(NamedTuple):
    """What a vessel stands in and under while it reacts, and how exactly it is followed."""

    jacket: float
    """K"""
    transfer: float
    """W/K between contents and jacket; below 0: the contents have its temperature"""
    condenser: float
    """W that a condenser takes from what boils; below 0: the vessel is sealed"""
    rtol: float
    atol: float
    """mol/L"""


@helper
def _copy(source: FloatArray, target: FloatArray) -> None:
    for x in range(min(source.shape[0], target.shape[0])):
        target[x] = source[x]


@helper
def _without_boiling(
    row: FloatArray, kept: FloatArray, dt: float, around: Surroundings, chem: Handle, work: FloatArray
) -> tuple[int, float]:
    """React as if nothing could boil. Returns the steps, and the share of ``dt`` in which contents that were ``kept``
    get to their boiling point and just beyond: infinite if they do not, 1 if they are just there, 0 if they were."""
    steps = react(row, chem, dt, around.jacket, around.transfer, around.rtol, around.atol, work)
    ambient = opened(Chemistry, chem).ambient_pressure
    cold, end = kept[TEMPERATURE], row[TEMPERATURE]
    hot = max(end, work[0, 0])
    row[TEMPERATURE] = hot
    after = vapor_pressure(row, chem)
    row[TEMPERATURE] = end
    if after <= ambient:
        return steps, math.inf
    before = vapor_pressure(kept, chem)
    if around.transfer < 0.0 or hot - cold <= _OVERSHOT_K:
        return steps, 1.0
    if before >= ambient:
        return steps, 0.0
    # The logarithm of a vapour pressure falls with the inverse of the temperature (Clausius and Clapeyron).
    slope = (1.0 / cold - 1.0 / hot) / math.log(after / max(before, 1e-9 * after))
    boiling = 1.0 / (1.0 / hot + slope * math.log(after / ambient))
    if hot - boiling <= _OVERSHOT_K:
        return steps, 1.0
    return steps, min(max((boiling + 0.5 * _OVERSHOT_K - cold) / (hot - cold), 0.02), 0.8)


@helper
def _at_boiling_point(
    row: FloatArray, dt: float, around: Surroundings, chem: Handle, work: FloatArray
) -> tuple[int, float]:
    """React at the temperature that boiling keeps, and leave the heat that it will take in the contents. Returns the
    steps, and how much longer than ``dt`` this could be done: 0 if by then nothing boils."""
    at, content = row[TEMPERATURE], enthalpy(row, chem)
    steps = react(row, chem, dt, at, -1.0, around.rtol, around.atol, work)
    heat = content - enthalpy(row, chem) + around.transfer * (around.jacket - at) * dt
    capacity = heat_capacity(row, chem)
    row[TEMPERATURE] += heat / capacity
    if heat <= 0.0:
        return steps, 0.0
    return steps, _LOST_K * capacity / max(heat - around.condenser * dt, 1e-3 * _LOST_K * capacity)


@helper
def react_open(
    row: FloatArray,
    dt: float,
    around: Surroundings,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> int:
    """Let the contents of one vessel react for ``dt``; what boils runs back from the condenser, vapour that is too much
    for it is lost and an event.

    Args:
        row: vessel row, changed in place.
        dt: time, in the unit of the rate constants.
        around: what it stands in and under.
        chem: the chemistry.
        waste: [M] mol, receives what flies.
        events: safety events row.
        work: scratch of shape :func:`chemlab.physics.laws.work_size`; its last row is for this function.

    Returns:
        Number of steps taken; below 0 where that would have been too many: then the rest of ``dt`` has not passed.
    """
    if around.condenser < 0.0:
        return react(row, chem, dt, around.jacket, around.transfer, around.rtol, around.atol, work)
    kept = work[work.shape[0] - 1]
    ambient = opened(Chemistry, chem).ambient_pressure
    left, part, total, turned = dt, dt, 0, False
    boiling = around.transfer >= 0.0 and vapor_pressure(row, chem) >= _NEARLY * ambient
    while left > 0.0:
        part = min(part, left)
        _copy(row, kept)
        if boiling:
            steps, share = _at_boiling_point(row, part, around, chem, work)
        else:
            steps, share = _without_boiling(row, kept, part, around, chem, work)
        if steps < 0:
            return steps
        total += steps
        if share < 1.0 and part * _MOST_PARTS > dt:
            _copy(kept, row)
            if share == 0.0:
                if boiling and turned:
                    part *= 0.5  # so that this ends
                boiling, turned = not boiling, True
            else:
                part *= max(share, 0.02)
            continue
        boiling = around.transfer >= 0.0 and (share == 1.0 or (boiling and share > 0.0))
        if share < math.inf:
            reflux(row, around.condenser * part, chem, waste, events)
        left -= part
        part *= min(max(share, 1.0), 4.0)
    return total
