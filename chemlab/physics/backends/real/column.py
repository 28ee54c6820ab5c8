"""A distillation column above a boiling pot: stage by stage, at a constant reflux ratio.

With V mol of vapour rising, V R / (1 + R) mol returned and V / (1 + R) mol taken off, a balance from the top down to
between the stages k and k + 1 reads, for each molecule, y_k = (R x_(k+1) + y_top) / (1 + R). At given ratios K = y / x
that is linear and solved from the top; compositions then give new ratios (bubble-point method: Wang and Henke,
Hydrocarbon Processing 45 (1966) 155).
"""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened, scratch
from ...constants import GAS_CONSTANT
from .. import separate
from .liquids import clear_liquids, dimer_root, liquids_in, nrtl, on_curve, prepare
from .real_chemistry import MOST_FLUIDS, ORGANIC, RealChemistry

MOST_STAGES = 16
LADDER = MOST_STAGES * MOST_FLUIDS
_CLOSE = 1e-4
"""Convergence tolerance of every ln K."""
_MOST_ROUNDS = 60
_DAMPING = 0.9
_STEEPEST = 40.0
"""Bound on |ln K|, for which the product over all stages is finite."""


@helper
def _ratios(n: int, chem: Handle, block: FloatArray, guess: float, out: FloatArray, at: int) -> float:
    """Compute ln (y / x) of every molecule at the bubble point of a liquid with the mole fractions of ``tray``.

    The result is in ``out[at : at + n]``; the temperature in K is returned.
    """
    tray = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    temperature, pressure = guess, chemistry.ambient_pressure
    # Activity coefficients at the guessed temperature, which is the result of the previous iteration.
    prepare(n, temperature, chem, block)
    nrtl(n, ORGANIC, block)
    mol = 1.0
    for _round in range(20):
        total, slope, bound, mol = 0.0, 0.0, 0.0, 0.0
        for a in range(n):
            out[at + a] = on_curve(chemistry.vapor, int(tray.who[a]), temperature, chem) + tray.log_gamma[n + a]
            tray.work[a] = tray.x[n + a] * math.exp(out[at + a])
            tray.work[n + a] = dimer_root(int(tray.who[a]), temperature, chem)
            total += tray.work[a]
            bound += tray.work[n + a] * tray.work[a]
        bound = min(bound, 1e100)
        total += bound * bound
        for a in range(n):  # as if there were no dimers, see :func:`.liquids.partial_pressures`
            if tray.work[n + a] > 0.0:
                pairs = 2.0 * tray.work[n + a] * bound
                out[at + a] += math.log1p(pairs)
                tray.work[a] *= 1.0 + pairs
            mol += tray.work[a]
            slope += tray.work[a] * on_curve(chemistry.vaporizing, int(tray.who[a]), temperature, chem)
        mol /= max(total, 1e-300)
        slope /= GAS_CONSTANT * temperature * temperature * max(total, 1e-300)
        step = math.log(pressure / max(total, 1e-300)) / max(slope, 1e-6)
        temperature = max(min(temperature + max(min(step, 50.0), -50.0), 890.0), 160.0)
        if abs(step) < 1e-2:
            break
    for a in range(n):
        out[at + a] = min(max(out[at + a] - math.log(pressure * mol), -_STEEPEST), _STEEPEST)
    return temperature


@separate
def overhead(
    n: int,
    trays: int,
    reflux: float,
    warm: bool,
    chem: Handle,
    block: FloatArray,
    ladder: FloatArray,
    partial: FloatArray,
) -> None:
    """Convert the composition of the pot's vapour, ``partial`` [n], to that of the distillate.

    Args:
        n: number of molecules.
        trays: theoretical stages above the pot.
        reflux: mol returned per mol taken off.
        warm: whether ``ladder`` holds the ln K of the trays for a similar composition.
        chem, liquids: the pot.
        ladder: [trays * n] ln K, stage after stage.
        partial: [n] in: composition of the pot's vapour; out: of the distillate (any scale).
    """
    liquids = liquids_in(block)
    stage = clear_liquids()
    tray = liquids_in(stage)
    fraction, total = scratch(MOST_FLUIDS), 0.0
    weight = scratch(LADDER)
    fresh = scratch(LADDER)
    for a in range(n):
        total += partial[a]
        tray.who[a] = liquids.who[a]
    for a in range(n):
        fraction[a] = partial[a] / total  # y of the pot
    temperature = scratch(MOST_STAGES)
    for k in range(trays):
        temperature[k] = 350.0
    if not warm:
        # Initial guess at total reflux, from the bottom up: x of each tray is y of the one below.
        for a in range(n):
            tray.x[n + a] = fraction[a]
        for k in range(trays):
            temperature[k] = _ratios(n, chem, stage, temperature[max(k - 1, 0)], ladder, k * n)
            for a in range(n):
                tray.x[n + a] *= math.exp(ladder[k * n + a])
            _normalize(n, stage)
    back, taken = reflux / (1.0 + reflux), 1.0 / (1.0 + reflux)
    for _round in range(_MOST_ROUNDS):
        top = (trays - 1) * n
        for a in range(n):
            # weight: x of each tray for x = 1 at the top; the lowest is the pot's y.
            weight[top + a] = 1.0
            off = taken * math.exp(ladder[top + a])
            for k in range(trays - 1, 0, -1):
                weight[(k - 1) * n + a] = (back * weight[k * n + a] + off) * math.exp(-ladder[(k - 1) * n + a])
            scale = fraction[a] / (back * weight[a] + off)
            for k in range(trays):
                weight[k * n + a] *= scale
        worst = 0.0
        for k in range(trays):
            for a in range(n):
                tray.x[n + a] = max(weight[k * n + a], 1e-300)
            _normalize(n, stage)
            temperature[k] = _ratios(n, chem, stage, temperature[k], fresh, k * n)
            for a in range(n):
                gap = fresh[k * n + a] - ladder[k * n + a]
                worst = max(worst, abs(gap))
                ladder[k * n + a] += _DAMPING * gap
        if worst < _CLOSE:
            break
    for a in range(n):
        partial[a] = weight[(trays - 1) * n + a] * math.exp(ladder[(trays - 1) * n + a])


@inner
def _normalize(n: int, block: FloatArray) -> None:
    tray = liquids_in(block)
    total = 0.0
    for a in range(n):
        total += tray.x[n + a]
    for a in range(n):
        tray.x[n + a] /= total
