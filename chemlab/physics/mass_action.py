"""Reactions: mass action with Arrhenius constants, Dormand-Prince 5(4) with adaptive steps (PHYSICS section 1).

The unknowns are the extents of the reactions instead of concentrations, so atoms are conserved to rounding, whatever
the integrator's error. A step that would make an amount negative is halved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..kernels.arrays import FloatArray, Handle
from ..kernels.jit import helper, inner, opened
from .backends import rate_constant
from .chemistry import AMOUNTS, Chemistry
from .constants import GAS_CONSTANT

_A21 = 1 / 5
_A31, _A32 = 3 / 40, 9 / 40
_A41, _A42, _A43 = 44 / 45, -56 / 15, 32 / 9
_A51, _A52, _A53, _A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
_A61, _A62, _A63, _A64, _A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
_B1, _B3, _B4, _B5, _B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
# Fifth-order minus fourth-order weights for the error estimate.
_E1, _E3, _E4, _E5, _E6, _E7 = -71 / 57600, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40

_SMALLEST_STEP = 1e-12
_FIRST_SHARE = 0.3
"""Maximum share of a reactant that the first trial step uses at the initial rate."""
_MOST_STEPS = 1_000_000
"""Maximum number of steps of an integration; stiffer problems exceed an explicit method."""
_USED_UP = 1e-15
"""mol/L below which a reactant counts as consumed."""
_WORK_ROWS = 14


class _Rows(NamedTuple):
    """Rows of the scratch array."""

    constants: FloatArray  # [R]
    start: FloatArray  # [species] mol/L when the integration began
    extent: FloatArray  # [R] mol/L at the beginning of the step
    trial: FloatArray  # [R] at its end
    now: FloatArray  # [species] mol/L at the beginning of the step
    conc: FloatArray  # [species] at its end
    stages: FloatArray  # [7, R] rates of the stages
    defect: FloatArray  # [species] error, in mol/L per time


@inner
def _rows(work: FloatArray) -> _Rows:
    return _Rows(work[0], work[1], work[2], work[3], work[4], work[5], work[6:13], work[13])


def react_work_size(chemistry: Chemistry) -> tuple[int, int]:
    """Return the shape of the scratch array that :func:`integrate` needs."""
    return _WORK_ROWS, max(chemistry.stoichiometry.shape[0], chemistry.species.shape[0], 1)


@helper
def arrhenius(reaction: int, temperature: float, chem: Handle) -> float:
    """Return the rate constant A exp(-Ea / RT) of a reaction at ``temperature`` (K), in its own unit."""
    chemistry = opened(Chemistry, chem)
    power = -chemistry.activation_energy[reaction] / (GAS_CONSTANT * temperature)
    return float(chemistry.pre_exponential[reaction] * math.exp(power))


@helper
def _effective(concentration: float) -> float:
    """Return a concentration as used by rates: rounding remainders of consumed species are 0."""
    return concentration if concentration > _USED_UP else 0.0


@helper
def rates(
    constants: FloatArray, chem: Handle, start: FloatArray, extent: FloatArray, conc: FloatArray, out: FloatArray
) -> float:
    """Compute concentrations and rates at given extents; return the lowest concentration.

    It is negative if a trial step is too long.
    """
    chemistry = opened(Chemistry, chem)
    # Looked up once here instead of under a condition inside the loops.
    stoichiometry, changes = chemistry.stoichiometry, chemistry.changes
    factors, fractions = chemistry.factors, chemistry.fractions
    n_reactions, n_species = stoichiometry.shape
    for j in range(n_species):
        conc[j] = start[j]
    for r in range(n_reactions):
        for c in range(changes.shape[1]):
            j = changes[r, c]
            if j >= 0:
                conc[j] += stoichiometry[r, j] * extent[r]
    lowest = 0.0
    for j in range(n_species):
        lowest = min(lowest, conc[j])
    for r in range(n_reactions):
        rate = constants[r]
        for f in range(factors.shape[1]):
            if factors[r, f] >= 0:
                rate *= _effective(conc[factors[r, f]])
        for j in range(fractions.shape[1]):
            if fractions[r, j] > 0.0:
                rate *= _effective(conc[j]) ** fractions[r, j]
        out[r] = rate
    return lowest


@inner
def _first_step(chem: Handle, rows: _Rows, dt: float) -> float:
    """Return the first step to try; 0 if no reaction runs."""
    chemistry = opened(Chemistry, chem)
    stoichiometry = chemistry.stoichiometry
    n_reactions, n_species = stoichiometry.shape
    start, k, change = rows.start, rows.stages, rows.defect
    running = False
    for j in range(n_species):
        change[j] = 0.0
    for r in range(n_reactions):
        running = running or k[0, r] > 0.0
        for j in range(n_species):
            change[j] += stoichiometry[r, j] * k[0, r]
    if not running:
        return 0.0
    # A first step that consumes most of a reactant has no meaningful error estimate: start well below that.
    h = dt
    for j in range(n_species):
        if change[j] < 0.0:
            h = min(h, _FIRST_SHARE * start[j] / -change[j])
    return max(h, _SMALLEST_STEP * dt)


@inner
def _take_stages(chem: Handle, rows: _Rows, h: float) -> float:
    """Compute the rates of a step's stages, and the extents and concentrations at its end.

    Returns:
        Lowest concentration of the stages.
    """
    constants, start, extent, trial, _, conc, k, _ = rows
    n_reactions = opened(Chemistry, chem).stoichiometry.shape[0]
    for r in range(n_reactions):
        trial[r] = extent[r] + h * _A21 * k[0, r]
    lowest = rates(constants, chem, start, trial, conc, k[1])
    for r in range(n_reactions):
        trial[r] = extent[r] + h * (_A31 * k[0, r] + _A32 * k[1, r])
    lowest = min(lowest, rates(constants, chem, start, trial, conc, k[2]))
    for r in range(n_reactions):
        trial[r] = extent[r] + h * (_A41 * k[0, r] + _A42 * k[1, r] + _A43 * k[2, r])
    lowest = min(lowest, rates(constants, chem, start, trial, conc, k[3]))
    for r in range(n_reactions):
        trial[r] = extent[r] + h * (_A51 * k[0, r] + _A52 * k[1, r] + _A53 * k[2, r] + _A54 * k[3, r])
    lowest = min(lowest, rates(constants, chem, start, trial, conc, k[4]))
    for r in range(n_reactions):
        trial[r] = extent[r] + h * (_A61 * k[0, r] + _A62 * k[1, r] + _A63 * k[2, r] + _A64 * k[3, r] + _A65 * k[4, r])
    lowest = min(lowest, rates(constants, chem, start, trial, conc, k[5]))
    for r in range(n_reactions):
        trial[r] = extent[r] + h * (_B1 * k[0, r] + _B3 * k[2, r] + _B4 * k[3, r] + _B5 * k[4, r] + _B6 * k[5, r])
    return min(lowest, rates(constants, chem, start, trial, conc, k[6]))


@inner
def _judge(chem: Handle, rows: _Rows, h: float, rtol: float, atol: float) -> tuple[float, float]:
    """Return the error of a step in units of its tolerance, and the lowest concentration at its end."""
    chemistry = opened(Chemistry, chem)
    stoichiometry, changes = chemistry.stoichiometry, chemistry.changes
    n_reactions, n_species = stoichiometry.shape
    _, start, _, _, now, conc, k, defect = rows
    for j in range(n_species):
        defect[j] = 0.0
    for r in range(n_reactions):
        gap = _E1 * k[0, r] + _E3 * k[2, r] + _E4 * k[3, r] + _E5 * k[4, r] + _E6 * k[5, r] + _E7 * k[6, r]
        for c in range(changes.shape[1]):
            j = changes[r, c]
            if j >= 0:
                defect[j] += stoichiometry[r, j] * gap
    error, lowest = 0.0, 0.0
    for j in range(n_species):
        ratio = h * defect[j] / (atol + rtol * max(abs(now[j]), abs(conc[j])))
        error += ratio * ratio
        # Rounding in the sums of concentrations may leave -1e-17 instead of 0.
        lowest = min(lowest, conc[j] + 1e-15 * (start[j] + 1.0))
    return math.sqrt(error / n_species), lowest


@helper
def integrate(
    row: FloatArray,
    chem: Handle,
    volume: float,
    temperature: float,
    dt: float,
    rtol: float,
    atol: float,
    work: FloatArray,
) -> int:
    """Integrate the reactions of one vessel for ``dt`` at constant temperature and volume.

    Args:
        row: vessel row; its amounts (mol) change in place.
        chem: the chemistry.
        volume: liquid volume in L; without liquid nothing changes.
        temperature: temperature in K.
        dt: time, in the unit of the rate constants.
        rtol, atol: error tolerances on concentrations (relative; mol/L), as in ``scipy.integrate.solve_ivp``.
        work: scratch of shape :func:`react_work_size`.

    Returns:
        Number of steps, rejected ones included; -1 if it exceeded 1,000,000 (then nothing has
        changed).
    """
    chemistry = opened(Chemistry, chem)
    n_reactions, n_species = chemistry.stoichiometry.shape
    if n_reactions == 0 or volume <= 0.0 or dt <= 0.0:
        return 0
    rows = _rows(work)
    constants, start, extent, trial, now, conc, k, _ = rows
    for r in range(n_reactions):
        constants[r] = rate_constant(r, temperature, chem)
        extent[r] = 0.0
    for j in range(n_species):
        start[j] = row[AMOUNTS + chemistry.species[j]] / volume
        now[j] = start[j]
    rates(constants, chem, start, extent, conc, k[0])
    h = _first_step(chem, rows, dt)
    if h == 0.0:
        return 0
    done, steps = 0.0, 0
    while done < dt:
        steps += 1
        if steps > _MOST_STEPS:
            return -1
        h = min(h, dt - done)
        stage = _take_stages(chem, rows, h)
        error, lowest = _judge(chem, rows, h, rtol, atol)
        small = h <= _SMALLEST_STEP * dt
        if (lowest < 0.0 or stage < -atol or not error < math.inf) and not small:
            # Rates are cut off beyond zero, so the error estimate is not meaningful there.
            h *= 0.5
            continue
        if error > 1.0 and not small:
            h *= max(0.2, 0.9 * error**-0.2)
            continue
        if lowest < 0.0 or not error < math.inf:
            # A reactant is consumed within the smallest step: take the part of the step that consumes it.
            part = 1.0 if error < math.inf else 0.0
            for j in range(n_species):
                if conc[j] < 0.0:
                    part = min(part, max(now[j], 0.0) / (now[j] - conc[j]))
            for r in range(n_reactions):
                trial[r] = extent[r] + part * (trial[r] - extent[r])
            rates(constants, chem, start, trial, conc, k[6])
            error = 1.0
        done += h
        for r in range(n_reactions):
            extent[r] = trial[r]
            k[0, r] = k[6, r]
        for j in range(n_species):
            now[j] = conc[j]
        h *= 5.0 if error < 1e-4 else min(5.0, 0.9 * error**-0.2)
    for j in range(n_species):
        change = 0.0
        for r in range(n_reactions):
            change += chemistry.stoichiometry[r, j] * extent[r]
        column = AMOUNTS + chemistry.species[j]
        row[column] = max(row[column] + volume * change, 0.0)
    return steps
