"""Reactions with their heat in a vessel that is sealed, open, or open through a condenser.

An open vessel is followed to its boiling point, and from there in parts. In each it reacts at the temperature that
boiling keeps; the heat that the condenser does not take goes into vapour, half of it beforehand, by what the part
before tells: so temperature and composition are those of the middle of the part (midpoint rule, of second order).
Where saturations, volumes or fast equilibria change, parts are short enough for that (:mod:`.spans`).
"""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import inner, kernel, opened
from ...chemistry import TEMPERATURE
from ...events import RELIEF
from ...surroundings import Surroundings
from ...transfer import heat_capacity, liquid_volume
from .. import vapor_pressure
from .chemistry import RealChemistry
from .heats import add_heat, enthalpy
from .kinetics import KEPT, integrate
from .spans import drifted, lengthened, prepare
from .vapor import boiling_point, flash_off

__all__ = ["react"]

_HEAT_K = 20.0
"""By which the heat of a part would warm the contents, at most, if nothing boiled."""
_RISE_K = 6.0
"""Of the boiling point, at most, in a part."""
_MOST_PARTS, _MOST_SPANS = 512, 4096
_LEAST_SPAN = 1e-9
"""Of the time, of a span at whose end equilibria lack something."""
_SHORTEST_S = 0.25
"""Of the shortest part: in a runaway a second decides."""
_LONGEST_RATIO, _STEEPEST = 2.0, 1.5
"""By which a part may be longer than the one before, and vapour be foreseen to come faster."""
_NEARLY_K = 0.3
"""Below the boiling point, from where on contents boil."""
_ABOVE_K = 1.0
"""Over jacket and contents, where it takes a look at the boiling point."""
_COOLED_K = 1.0
"""By which contents that were boiling may have cooled at the end of a part."""


@inner
def _copy(source: FloatArray, target: FloatArray) -> None:
    for x in range(min(source.shape[0], target.shape[0])):
        target[x] = source[x]


@inner
def _far_from_boiling(row: FloatArray, jacket: float, chem: Handle) -> float:
    """K to which the contents may come without boiling, by a look at their pressure there; 0 where they would boil."""
    at = row[TEMPERATURE]
    row[TEMPERATURE] = max(at, jacket) + _ABOVE_K
    hot, pressure = row[TEMPERATURE], vapor_pressure(row, chem)
    row[TEMPERATURE] = at
    return hot if pressure < opened(RealChemistry, chem).ambient_pressure else 0.0


@inner
def _foreseen(now: float, before: float, part: float, last: float, following: float) -> float:
    """W that will make vapour in the first half of the part that is ``following``, by those of a ``part`` and the one
    before, if they go on to change as they do."""
    trend = (now - before) * (part + 0.5 * following) / (part + last)
    return min(max(now + trend, 0.0), _STEEPEST * max(now, 0.0))


@kernel
def react(
    row: FloatArray,
    dt: float,
    around: Surroundings,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> int:
    """Let the contents of one vessel react for ``dt``, while crystals dissolve and grow; what boils runs back from the
    condenser, vapour that is too much for it is lost and an event."""
    pressure = opened(RealChemistry, chem).ambient_pressure
    kept = work[KEPT]
    follows = around.condenser >= 0.0 and 0.0 <= around.transfer < math.inf
    hottest, boils = math.inf, False
    if follows:
        hottest = _far_from_boiling(row, around.jacket, chem)
        if hottest == 0.0:
            hottest = boiling_point(row, chem)
            boils = row[TEMPERATURE] >= hottest - _NEARLY_K
    left, shortest, total, known = dt, min(dt / _MOST_PARTS, _SHORTEST_S), 0, False
    part, ahead, climb, rate, last = shortest, 0.0, 0.0, 0.0, shortest
    span, briefest, fresh = dt, dt / _MOST_SPANS, False
    while left > 0.0:
        part, span = min(part, left), min(span, left)
        at, content = row[TEMPERATURE], 0.0
        ways = prepare(row, chem, fresh, around.condenser >= 0.0, work)
        litres = liquid_volume(row, chem)
        _copy(row, kept)
        if boils:
            content = enthalpy(row, chem)
        jacket, transfer = (at, -1.0) if boils else (around.jacket, around.transfer)
        there = Surroundings(jacket, transfer, -1.0, around.rtol, around.atol)
        steps, passed = integrate(row, part if boils else span, there, hottest, ways, chem, work)
        if steps < 0:
            return steps
        total += steps
        drift = 0.0
        if steps > 0 or row[TEMPERATURE] != at:
            drift = drifted(row, chem, litres, around.atol, ways, work)
            if boils or not 0.0 <= around.transfer < math.inf:
                row[TEMPERATURE] = jacket  # what settles gives its heat to the thermostat
            least = _LEAST_SPAN * dt if drift == math.inf else shortest if boils else briefest
            if drift > 1.0 and passed > least:
                _copy(kept, row)
                span = max(lengthened(passed, drift), min(least, briefest))
                part, fresh = max(min(part, span), shortest), False
                continue
        if not boils:
            fresh = True
            left -= passed
            stopped, span = passed < span, max(lengthened(span, drift), briefest)
            if left > 0.0 and stopped:
                hottest = boiling_point(row, chem)
                boils = row[TEMPERATURE] >= hottest - _NEARLY_K
                part, ahead, climb, known = shortest, 0.0, 0.0, False
                fresh = not boils
            continue
        capacity = heat_capacity(row, chem)
        made = content - enthalpy(row, chem)
        # However little is left, a jacket cools it no further than to its own temperature.
        coolest = min(made, 0.0) + capacity * min(around.jacket - at, 0.0)
        heat = max(made + around.transfer * (around.jacket - at) * part, coolest)
        most = _HEAT_K * capacity
        if most <= 0.0:
            return total  # it has boiled dry
        surplus = max(heat - around.condenser * part, -most)
        if not known:
            # All that a short part tells is how long the first may be, and how fast it boils.
            _copy(kept, row)
            known, rate, last = True, surplus / part, part
            longer = min(left / part, 0.25 * most / max(abs(heat), 1e-9 * most))
            part, ahead = max(part * longer, shortest), 0.5 * max(surplus, 0.0) * longer
            ahead = ahead if part > shortest else 0.0
            if ahead > 0.0:
                events[RELIEF] += flash_off(row, pressure, ahead, 0.0, chem, waste)
                climb = max(row[TEMPERATURE] - at, 0.0) / (0.5 * part)
                part = max(min(part, _RISE_K / max(climb, 1e-9)), shortest)
            continue
        if part > shortest and (heat > 1.5 * most or heat < -_COOLED_K * capacity):
            _copy(kept, row)
            part = max(part * (0.25 if heat < 0.0 else max(0.8 * most / heat, 0.02)), shortest)
            continue
        left -= part
        following = min(_LONGEST_RATIO * part, part * most / max(heat, 1e-9 * most), _RISE_K / max(climb, 1e-9))
        following = min(max(min(following, lengthened(part, drift)), shortest), left)
        owed, ahead = ahead, 0.5 * following * _foreseen(surplus / part, rate, part, last, following)
        ahead = min(ahead, 0.5 * most) if following > shortest else 0.0
        rate, last = surplus / part, part
        hot = at + (heat - owed + ahead) / capacity
        events[RELIEF] += flash_off(row, pressure, heat - owed + ahead, around.condenser * part, chem, waste)
        if around.transfer > 0.0 and heat_capacity(row, chem) < 0.5 * capacity:
            # What has nearly boiled dry takes no more of the jacket's heat than to get as warm.
            row[TEMPERATURE] = min(row[TEMPERATURE], max(around.jacket, at))
        climb = max(row[TEMPERATURE] - at, 0.0) / part
        if row[TEMPERATURE] >= hot - 1e-9:  # nothing boils any more
            add_heat(row, -ahead, chem)
            hottest = boiling_point(row, chem)
            boils = row[TEMPERATURE] >= hottest - _NEARLY_K
            part, ahead, climb, known = shortest, 0.0, 0.0, False
            continue
        part = following
    if around.condenser >= 0.0 and not follows:
        events[RELIEF] += flash_off(row, pressure, 0.0, around.condenser * dt, chem, waste)
    return total
