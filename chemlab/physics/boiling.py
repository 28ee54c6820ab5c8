"""Reactions in a vessel that is open, or open through a condenser: what boils meanwhile keeps its temperature."""

from __future__ import annotations

from typing import NamedTuple

from ..arrays import FloatArray, Handle
from ..chemistry import TEMPERATURE, Chemistry
from ..jit import helper, opened
from .laws import react, reflux, vapor_pressure

__all__ = ["Surroundings", "react_open"]

_WARMER_K = 0.5
"""By how much what then boils may warm before the condenser has its turn; losses are a few per cent out by that."""
_MOST_PARTS = 512


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
    jacket, transfer, rtol, atol = around.jacket, around.transfer, around.rtol, around.atol
    if around.condenser < 0.0:
        return react(row, chem, dt, jacket, transfer, rtol, atol, work)
    ambient = opened(Chemistry, chem).ambient_pressure
    kept = work[work.shape[0] - 1]
    left, part, total = dt, dt, 0
    while left > 0.0:
        part = min(part, left)
        for x in range(row.shape[0]):
            kept[x] = row[x]
        steps = react(row, chem, part, jacket, transfer, rtol, atol, work)
        if steps < 0:
            return steps
        total += steps
        at_end = row[TEMPERATURE]
        row[TEMPERATURE] = max(at_end, work[0, 0])
        boils = vapor_pressure(row, chem) > ambient
        warmer = row[TEMPERATURE] - kept[TEMPERATURE]
        row[TEMPERATURE] = at_end
        if boils:
            # As a whole first: mostly nothing boils. If it does, again from where it was, a little at a time.
            if warmer > 2.0 * _WARMER_K and part * _MOST_PARTS > dt:
                for x in range(row.shape[0]):
                    row[x] = kept[x]
                part = max(part * max(_WARMER_K / warmer, 0.1), dt / _MOST_PARTS)
                continue
            reflux(row, around.condenser * part, chem, waste, events)
        left -= part
        if warmer < _WARMER_K:
            part *= 2.0
    return total
