"""Reactions with heat in a vessel that is sealed, open, or open through a condenser.

An open vessel is integrated up to its boiling point, and from there in parts. In each part it reacts at the boiling
temperature. Heat that the condenser does not remove produces vapour, half of it in advance, predicted from the previous
part. Temperature and composition are therefore those of the middle of the part (midpoint rule, second order). Parts are
short enough for changes of saturations, volumes and fast equilibria (:mod:`.spans`), and for products that lower the
boiling point.

At the melting point of crystals the contents react at this temperature, part by part, and heat melts crystals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import TEMPERATURE
from ...constants import LEAST_CAPACITY
from ...events import RELIEF
from ...surroundings import Surroundings
from ...transfer import heat_capacity, liquid_volume
from .. import vapor_pressure
from .heats import add_heat, enthalpy
from .kinetics import KEPT, MOST_IN_SPAN, integrate
from .partition import melt, melting_heat, melting_point
from .phases import settle
from .real_chemistry import RealChemistry
from .spans import drifted, lengthened, prepare, settle_shifts
from .vapor import boiling_point, flash_off

_HEAT_K = 20.0
"""Maximum heat of a part, as warming of the contents in K without boiling."""
_RISE_K = 6.0
"""Maximum rise in K of the boiling point in a part."""
_MOST_PARTS, _MOST_SPANS = 512, 4096
_MOST_CUTS = 100
"""Maximum number of spans that end early because they need too many steps."""
_LEAST_SPAN = 1e-9
"""Share of the time below which a span is not shortened further for equilibria."""
_SHORTEST_S = 0.25
"""Minimum duration of a part in s; in a runaway, a second matters."""
_LONGEST_RATIO, _STEEPEST = 2.0, 1.5
"""Maximum ratio of the durations of successive parts, and maximum predicted growth of vaporization."""
_NEARLY_K = 0.3
"""Distance in K from the boiling point within which contents boil; products may lower it by as much in a part."""
_ABOVE_K = 1.0
"""Distance in K above jacket and contents at which the boiling point is checked."""
_COOLED_K = 1.0
"""Allowed cooling in K of boiling contents by the end of a part."""
_MELTED = 0.25
"""Maximum share of the crystals that melt in a part if anything reacts."""
_MELTING_K, _FREEZING_K = 1e-9, 0.5
"""Distances in K: below the melting point within which crystals melt, and from it within which they grow instead."""


@inner
def _copy(source: FloatArray, target: FloatArray) -> None:
    for x in range(min(source.shape[0], target.shape[0])):
        target[x] = source[x]


@inner
def _boils_above(row: FloatArray, jacket: float, chem: Handle) -> float:
    """Return a temperature (K) below which the contents do not boil.

    It is just above their own and the jacket's if their vapour pressure there is below ambient pressure. Otherwise it
    is their boiling point.
    """
    at = row[TEMPERATURE]
    row[TEMPERATURE] = max(at, jacket) + _ABOVE_K
    hot, pressure = row[TEMPERATURE], vapor_pressure(row, chem)
    row[TEMPERATURE] = at
    return hot if pressure < opened(RealChemistry, chem).ambient_pressure else float(boiling_point(row, chem))


@inner
def _foreseen(now: float, before: float, part: float, last: float, following: float) -> float:
    """Predict the vaporization power (W) in the first half of the ``following`` part by linear extrapolation.

    ``part`` and the part before it are the two known ones.
    """
    trend = (now - before) * (part + 0.5 * following) / (part + last)
    return min(max(now + trend, 0.0), _STEEPEST * max(now, 0.0))


class _Part(NamedTuple):
    """A part of the time, in which the contents have reacted at their boiling point."""

    duration: float  # s
    shortest: float  # s, minimum duration of any part
    left: float  # s, from its beginning to the end of the time
    made: float  # J, heat of the reactions
    drift: float  # from :func:`.spans.drifted`, or by the boiling point, which has fallen


class _Boiling(NamedTuple):
    """The last part's prediction for the next one."""

    ahead: float  # J with which vapour is already produced in advance
    climb: float  # K/s by which the boiling point rises
    known: bool  # False before the first part; the next two fields are then undefined
    rate: float  # W of vaporization in the last part
    last: float  # s, its duration


_REPEATED, _DONE, _STOPPED, _DRY = 0, 1, 2, 3
"""Outcomes of a part: to be repeated with another duration; still boiling; no longer boiling; boiled to dryness."""
_NOTHING_KNOWN = _Boiling(0.0, 0.0, False, 0.0, 0.0)


@inner
def _boil_part(
    row: FloatArray,
    kept: FloatArray,
    part: _Part,
    state: _Boiling,
    around: Surroundings,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
) -> tuple[float, _Boiling, int]:
    """Boil off vapour with the heat of a part.

    Args:
        row, kept: vessel row after and before the part. If the part is to be repeated, ``row`` is as before it, less
            vapour that boils off in advance.
        part, state: the part, and the prediction for it.
        around, chem, waste, events: as in :func:`react`.

    Returns:
        Duration of the next part in s, the prediction for it, and the outcome.
    """
    duration, shortest, left, made, drift = part
    at = row[TEMPERATURE]
    pressure = opened(RealChemistry, chem).ambient_pressure
    capacity = heat_capacity(row, chem)
    # A jacket cools even a small remainder only to its own temperature.
    coolest = min(made, 0.0) + capacity * min(around.jacket - at, 0.0)
    heat = max(made + around.transfer * (around.jacket - at) * duration, coolest)
    most = _HEAT_K * capacity
    if capacity <= LEAST_CAPACITY:
        return duration, state, _DRY
    surplus = max(heat - around.condenser * duration, -most)
    if not state.known:
        # A short first part determines the duration and boiling rate of the next.
        _copy(kept, row)
        climb = state.climb
        longer = min(left / duration, 0.25 * most / max(abs(heat), 1e-9 * most), 0.9 / max(drift, 1e-9))
        following, ahead = max(duration * longer, shortest), 0.5 * max(surplus, 0.0) * longer
        ahead = ahead if following > shortest else 0.0
        if ahead > 0.0:
            events[RELIEF] += flash_off(row, pressure, ahead, 0.0, chem, waste)
            climb = max(row[TEMPERATURE] - at, 0.0) / (0.5 * following)
            following = max(min(following, _RISE_K / max(climb, 1e-9)), shortest)
        return following, _Boiling(ahead, climb, True, surplus / duration, duration), _REPEATED
    if duration > shortest and (heat > 1.5 * most or heat < -_COOLED_K * capacity):
        _copy(kept, row)
        shorter = max(duration * (0.25 if heat < 0.0 else max(0.8 * most / heat, 0.02)), shortest)
        return shorter, state, _REPEATED
    rest = left - duration
    following = min(
        _LONGEST_RATIO * duration, duration * most / max(heat, 1e-9 * most), _RISE_K / max(state.climb, 1e-9)
    )
    following = min(max(min(following, lengthened(duration, drift)), shortest), rest)
    ahead = 0.5 * following * _foreseen(surplus / duration, state.rate, duration, state.last, following)
    ahead = min(ahead, 0.5 * most) if following > shortest else 0.0
    hot = at + (heat - state.ahead + ahead) / capacity
    events[RELIEF] += flash_off(row, pressure, heat - state.ahead + ahead, around.condenser * duration, chem, waste)
    if around.transfer > 0.0 and heat_capacity(row, chem) < 0.5 * capacity:
        # Nearly dry contents absorb only the heat that brings them to the jacket's temperature.
        row[TEMPERATURE] = min(row[TEMPERATURE], max(around.jacket, at))
    climb = max(row[TEMPERATURE] - at, 0.0) / duration
    if row[TEMPERATURE] < hot - 1e-9:
        return following, _Boiling(ahead, climb, True, surplus / duration, duration), _DONE
    add_heat(row, -ahead, chem)
    return shortest, _NOTHING_KNOWN, _STOPPED


@inner
def _melt_part(
    row: FloatArray, part: float, heat: float, reacted: bool, shortest: float, chem: Handle
) -> tuple[float, bool]:
    """Melt crystals with the heat (J) of a part of ``part`` s at their melting point, and warm with the rest.

    Returns:
        Duration of the next part in s, and whether crystals have melted.
    """
    at = row[TEMPERATURE]
    used = melt(row, at, max(heat, 0.0), chem)
    add_heat(row, heat - used, chem)
    following = part * melting_heat(row, at, chem) / heat if heat > 0.0 else part
    return max(_MELTED * following if reacted else following, shortest), used > 0.0


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
    """React the contents of one vessel for ``dt`` while crystals dissolve and grow.

    What has been added is in its phase before anything reacts. Vapour returns from the condenser; excess vapour is lost
    and is a safety event.
    """
    settle(row, chem, around.condenser < 0.0, waste, events, work)
    kept = work[KEPT]
    free = 0.0 <= around.transfer < math.inf
    if not free and dt > 0.0:  # the thermostat supplies the heat
        row[TEMPERATURE] = around.jacket
        melt(row, around.jacket, math.inf, chem)
        settle_shifts(row, chem, not free, work)
    follows = around.condenser >= 0.0 and free
    hottest, boils = math.inf, False
    if follows:
        hottest = _boils_above(row, around.jacket, chem)
        boils = row[TEMPERATURE] >= hottest - _NEARLY_K
    left, shortest, total, cuts = dt, min(dt / _MOST_PARTS, _SHORTEST_S), 0, 0
    if boils and dt > 0.0 and row[TEMPERATURE] > hottest + _ABOVE_K:  # no longer closed
        pressure = opened(RealChemistry, chem).ambient_pressure
        events[RELIEF] += flash_off(row, pressure, 0.0, around.condenser * shortest, chem, waste)
        hottest = boiling_point(row, chem)
    # A span is a part of the time in which the contents neither boil nor melt.
    part, span, briefest, state = shortest, dt, dt / _MOST_SPANS, _NOTHING_KNOWN
    fresh, melts, freezes = False, False, False
    while left > 0.0:
        melting = melting_point(row, chem) if free else math.inf
        freezes = freezes and abs(row[TEMPERATURE] - melting) < _FREEZING_K
        melted, melts = melts, row[TEMPERATURE] >= melting - _MELTING_K and not freezes
        if melts and not melted:
            if boils:
                add_heat(row, -state.ahead, chem)
            part, state, boils = shortest, _NOTHING_KNOWN, False
        # bool: of a literal, numba would compile a second version.
        held = boils or melts
        steady = held or not free
        at, content = row[TEMPERATURE], enthalpy(row, chem) if held else 0.0
        ways = prepare(row, chem, bool(fresh), steady, around.condenser >= 0.0, work)
        litres = liquid_volume(row, chem)
        _copy(row, kept)
        if melts:
            row[TEMPERATURE] = at = melting
        jacket, transfer = (at, -1.0) if held else (around.jacket, around.transfer)
        there = Surroundings(jacket, transfer, -1.0, around.rtol, around.atol)
        stop = hottest if freezes else min(hottest, melting)
        part, span = min(part, left), min(span, left)
        asked = part if held else span
        steps, passed = integrate(row, asked, there, stop, ways, chem, work)
        cuts += steps > MOST_IN_SPAN and passed < asked
        if steps < 0 or cuts > _MOST_CUTS:
            return -1
        total += steps
        if held and passed < part:
            _copy(kept, row)
            part, fresh = passed, False
            continue
        drift, bound = 0.0, hottest
        if steps > 0 or row[TEMPERATURE] != at:
            drift = drifted(row, chem, steady, litres, around.atol, ways, work)
            if steps > 0 and follows and not melts:  # products may boil at a lower temperature
                bound = _boils_above(row, around.jacket, chem)
                drift = max(drift, (row[TEMPERATURE] - bound) / _NEARLY_K)
            if steady:
                row[TEMPERATURE] = jacket  # the thermostat absorbs the heat of settling
            least = _LEAST_SPAN * dt if drift == math.inf else shortest if held else briefest
            if drift > 1.0 and passed > least:
                _copy(kept, row)
                span = max(lengthened(passed, drift), min(least, briefest))
                part, fresh = max(min(part, span), shortest), False
                continue
        made = content - enthalpy(row, chem) if held else 0.0
        if melts:
            left -= part
            heat = made + around.transfer * (around.jacket - at) * part
            part, any_melted = _melt_part(row, part, heat, steps > 0, shortest, chem)
            total += any_melted
            freezes, fresh, span = heat <= 0.0, False, left
            if follows:
                hottest = boiling_point(row, chem)
        elif boils:
            now = _Part(part, shortest, left, made, drift)
            following, state, outcome = _boil_part(row, kept, now, state, around, chem, waste, events)
            if outcome == _DRY:
                add_heat(row, 0.0, chem)  # at the temperature of the surroundings
                return total
            left -= 0.0 if outcome == _REPEATED else part
            part = following
            if outcome == _STOPPED:
                hottest = boiling_point(row, chem)
                boils = row[TEMPERATURE] >= hottest - _NEARLY_K
        else:
            fresh = True
            left -= passed
            stopped, hottest = passed < span or row[TEMPERATURE] >= bound, bound
            span = max(lengthened(span, drift), briefest)
            if left > 0.0 and stopped and follows:
                hottest = boiling_point(row, chem)
                boils = row[TEMPERATURE] >= hottest - _NEARLY_K
                part, state = shortest, _NOTHING_KNOWN
                fresh = not boils
    if around.condenser >= 0.0 and not boils and (row[TEMPERATURE] > hottest or not follows):
        pressure = opened(RealChemistry, chem).ambient_pressure
        events[RELIEF] += flash_off(row, pressure, 0.0, around.condenser * dt, chem, waste)
    return total
