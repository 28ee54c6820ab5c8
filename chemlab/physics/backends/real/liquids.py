"""Liquid mixtures: activity coefficients (NRTL), vapour pressures, and the split into an aqueous and an organic phase.

Renon and Prausnitz, AIChE J. 14 (1968) 135 (NRTL). Neutral molecules are salted out of water by Setschenow's rule; ions
stay in water and dilute it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ....config.pairs import REFERENCE_K, STRONGEST
from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened, part, scratch
from ...chemistry import AMOUNTS
from ...constants import GAS_CONSTANT, TRACE_MOL
from .. import separate
from .real_chemistry import AQUEOUS, MOST_FLUIDS, ORGANIC, RealChemistry

_ROOM = MOST_FLUIDS * MOST_FLUIDS
_BOTH = 2 * MOST_FLUIDS
_ALL = 10 * MOST_FLUIDS + 2 * _ROOM + 2
"""Size of the scratch of the liquids of a vessel."""
_SETSCHENOW = 0.2
"""Setschenow constant in L/mol (base 10) of dissolved salt: benzene in NaCl 0.195, typical of neutral organics.

Xie, Shiu, Mackay, Mar. Environ. Res. 44 (1997) 429.
"""
_MOST_SALT = 10.0
"""Maximum concentration of salt in mol/L to which the rule is applied."""
_WET = 0.1
"""Minimum mole fraction of water in a single liquid in which salts dissolve."""
_MOST_ROUNDS = 200
_FORESIGHT, _STEADY = 3, 0.95
"""Interval of extrapolation in iterations, and maximum contraction factor for which it is used."""
_CLOSE = 1e-6
"""Convergence tolerance of every ln K of the split."""
_SAME = 1e-4
"""|ln K| of all molecules below which two phases are identical."""
_STEEPEST = 300.0
_MOST_BOUND = 1e100
"""Upper bound of the square root of a dimer pressure in kPa, whose square is finite."""


class Liquids(NamedTuple):
    """The n molecules in the liquids of a vessel, and their two phases: scratch of one kernel."""

    who: FloatArray
    """[n] material indices"""
    mol: FloatArray
    """[n] mol in both phases"""
    share: FloatArray
    """[n] share of its mol in the organic phase"""
    parting: FloatArray
    """[n] J/mol, excess of a molecule's heat of vaporization in the mixture over that in its own vapour, which has more
    dimers
    """
    log_gamma: FloatArray
    """[2 * n] ln of the activity coefficients, phase after phase"""
    x: FloatArray
    """[2 * n] mole fractions among the molecules of each phase"""
    work: FloatArray
    """[2 * n]"""
    tau: FloatArray
    """[n * n] NRTL parameters at the temperature; in ``g``, exp(-alpha tau)"""
    g: FloatArray
    ions: FloatArray
    """[2] mol of ions; mol of undissolved salts"""


@inner
def clear_liquids() -> FloatArray:
    """Allocate scratch for the liquids of a vessel in the calling kernel, for :func:`liquids_in`.

    Kernels pass it on as a whole: numba passes an array as seven arguments, and :class:`Liquids` as seventy.
    """
    block: FloatArray = scratch(_ALL)
    return block


@inner
def liquids_in(block: FloatArray) -> Liquids:
    """Return the fields of scratch from :func:`clear_liquids`."""
    return Liquids(
        part(block, 0, MOST_FLUIDS),
        part(block, MOST_FLUIDS, MOST_FLUIDS),
        part(block, 2 * MOST_FLUIDS, MOST_FLUIDS),
        part(block, 3 * MOST_FLUIDS, MOST_FLUIDS),
        part(block, 4 * MOST_FLUIDS, _BOTH),
        part(block, 6 * MOST_FLUIDS, _BOTH),
        part(block, 8 * MOST_FLUIDS, _BOTH),
        part(block, 10 * MOST_FLUIDS, _ROOM),
        part(block, 10 * MOST_FLUIDS + _ROOM, _ROOM),
        part(block, 10 * MOST_FLUIDS + 2 * _ROOM, 2),
    )


@helper
def gather(row: FloatArray, chem: Handle, block: FloatArray) -> int:
    """Collect the liquid molecules of a vessel above a trace, with their distribution over its phases; return their
    number.
    """
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    n = 0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        at = AMOUNTS + m + 2 * k
        mol = row[at + AQUEOUS] + row[at + ORGANIC]
        if mol <= TRACE_MOL:
            continue
        if chemistry.liquid[i] == 2:
            continue
        liquids.who[n] = i
        liquids.mol[n] = mol
        liquids.share[n] = row[at + ORGANIC] / mol
        n += 1
    count_ions(row, chem, block)
    return n


@helper
def count_ions(row: FloatArray, chem: Handle, block: FloatArray) -> None:
    """Update the ions and undissolved salts among the contents of a vessel."""
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    liquids.ions[0] = 0.0
    for k in range(chemistry.dissolved.shape[0]):
        at = AMOUNTS + m + 2 * k
        mol = row[at + AQUEOUS] + row[at + ORGANIC]
        if chemistry.liquid[chemistry.dissolved[k]] == 2 and mol > TRACE_MOL:
            liquids.ions[0] += mol
    liquids.ions[1] = undissolved_salts(row, chem)


@helper
def undissolved_salts(row: FloatArray, chem: Handle) -> float:
    """Return mol of undissolved salts in a vessel."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for s in range(chemistry.salts.shape[0]):
        total += row[AMOUNTS + chemistry.salts[s, 0]]
    return total


@helper
def prepare(n: int, temperature: float, chem: Handle, block: FloatArray) -> None:
    """Compute the NRTL parameters at a temperature in K."""
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    inverse, rest = 1.0 / temperature, math.log(temperature / REFERENCE_K)
    for a in range(n):
        i = int(liquids.who[a])
        for b in range(n):
            j = int(liquids.who[b])
            tau = chemistry.nrtl[i, j, 0] + chemistry.nrtl[i, j, 1] * inverse + chemistry.nrtl[i, j, 2] * rest
            tau = min(max(tau, -STRONGEST), STRONGEST)
            liquids.tau[a * n + b] = tau
            liquids.g[a * n + b] = math.exp(-chemistry.nrtl[i, j, 3] * tau) if a != b else 1.0


@helper
def nrtl(n: int, phase: int, block: FloatArray) -> None:
    """Compute ln of the activity coefficients of a phase from its mole fractions."""
    liquids = liquids_in(block)
    x, tau, g, out, work = liquids.x, liquids.tau, liquids.g, liquids.log_gamma, liquids.work
    at = phase * n
    for j in range(n):
        weight, pull = 0.0, 0.0
        for k in range(n):
            part = g[k * n + j] * x[at + k]
            weight += part
            pull += tau[k * n + j] * part
        work[j] = 1.0 / weight
        work[n + j] = pull / weight
    for i in range(n):
        total = work[n + i]
        for j in range(n):
            total += x[at + j] * g[i * n + j] * work[j] * (tau[i * n + j] - work[n + j])
        out[at + i] = total


@separate
def activities(n: int, temperature: float, chem: Handle, block: FloatArray) -> None:
    """Compute mole fractions and activity coefficients in both current phases (an absent one has those of the
    other).
    """
    liquids = liquids_in(block)
    aqueous, organic = 0.0, 0.0
    for a in range(n):
        organic += liquids.mol[a] * liquids.share[a]
        aqueous += liquids.mol[a] * (1.0 - liquids.share[a])
    trace = min(TRACE_MOL, 0.25 * (aqueous + organic))
    for a in range(n):
        o, w = liquids.mol[a] * liquids.share[a], liquids.mol[a] * (1.0 - liquids.share[a])
        liquids.x[a] = w / aqueous if aqueous > trace else o / organic
        liquids.x[n + a] = o / organic if organic > trace else w / aqueous
    prepare(n, temperature, chem, block)
    if aqueous > trace:
        nrtl(n, AQUEOUS, block)
    if organic > trace:
        nrtl(n, ORGANIC, block)
    for a in range(n):
        if aqueous <= trace:
            liquids.log_gamma[a] = liquids.log_gamma[n + a]
        elif organic <= trace:
            liquids.log_gamma[n + a] = liquids.log_gamma[a]
    _salt(n, aqueous, chem, block)


@helper
def _salt(n: int, aqueous: float, chem: Handle, block: FloatArray) -> None:
    """Apply the effect of ions on the activities in water, of ``aqueous`` mol of molecules."""
    liquids = liquids_in(block)
    if liquids.ions[0] <= 0.0 or aqueous <= 0.0:
        return
    chemistry = opened(RealChemistry, chem)
    litres = 0.0
    for a in range(n):
        litres += liquids.x[a] * aqueous * chemistry.molar_volume[int(liquids.who[a])]
    salted = math.log(10.0) * _SETSCHENOW * min(0.5 * liquids.ions[0] / litres, _MOST_SALT)
    for a in range(n):
        if int(liquids.who[a]) == chemistry.water:
            liquids.log_gamma[a] += math.log(aqueous / (aqueous + liquids.ions[0]))
        else:
            liquids.log_gamma[a] += salted


@inner
def _shares(n: int, block: FloatArray, ratio: FloatArray, total: float) -> float:
    """Return the share of all molecules in the organic phase at given ratios of mole fractions organic / water.

    Rachford and Rice (1952); 0 or 1 if there is only one phase.
    """
    liquids = liquids_in(block)
    low, high = 0.0, 0.0
    for a in range(n):
        low += liquids.mol[a] * (ratio[a] - 1.0)
        high += liquids.mol[a] * (1.0 - 1.0 / ratio[a])
    if low <= 0.0:
        return 0.0
    if high >= 0.0:
        return 1.0
    left, right, beta = 0.0, 1.0, 0.5
    organic = 0.0
    for a in range(n):
        organic += liquids.mol[a] * liquids.share[a]
    if 0.0 < organic < total:
        beta = organic / total
    for _round in range(60):
        value, slope = 0.0, 0.0
        for a in range(n):
            part = (ratio[a] - 1.0) / (1.0 + beta * (ratio[a] - 1.0))
            value += liquids.mol[a] * part
            slope -= liquids.mol[a] * part * part
        if value > 0.0:
            left = beta
        else:
            right = beta
        step = beta - value / slope if slope < 0.0 else 0.5 * (left + right)
        if not left < step < right:
            step = 0.5 * (left + right)
        if abs(step - beta) <= 1e-12:
            return step
        beta = step
    return beta


@separate
def split(n: int, temperature: float, chem: Handle, block: FloatArray) -> None:
    """Distribute the molecules over water and the organic phase so that each has equal activities in both.

    The result is in ``liquids.share``, ``x`` and ``log_gamma``. Successive substitution from the current distribution.
    """
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    total, water, organic = 0.0, 0.0, 0.0
    for a in range(n):
        total += liquids.mol[a]
        if int(liquids.who[a]) == chemistry.water:
            water += liquids.mol[a]
        organic += liquids.mol[a] * liquids.share[a]
    if water <= TRACE_MOL or total - water <= TRACE_MOL:
        for a in range(n):
            liquids.share[a] = 0.0 if water > TRACE_MOL else 1.0
        activities(n, temperature, chem, block)
        return
    two = 1e-6 * total < organic < (1.0 - 1e-6) * total
    if not two:
        for a in range(n):
            liquids.share[a] = 1e-3 if int(liquids.who[a]) == chemistry.water else 1.0 - 1e-6
    ratio, last = scratch(MOST_FLUIDS), scratch(MOST_FLUIDS)
    activities(n, temperature, chem, block)
    for a in range(n):
        gap = liquids.log_gamma[a] - liquids.log_gamma[n + a]
        last[a] = max(min(gap, _STEEPEST), -_STEEPEST)
        ratio[a] = math.exp(last[a])
    moved = scratch(MOST_FLUIDS)
    for a in range(n):
        moved[a] = 0.0
    for turn in range(_MOST_ROUNDS):
        beta = _shares(n, block, ratio, total)
        if beta <= 0.0 or beta >= 1.0:
            _one_phase(n, water, total, temperature, chem, block)
            return
        aqueous = 0.0
        for a in range(n):
            fraction = liquids.mol[a] / total / (1.0 + beta * (ratio[a] - 1.0))
            liquids.x[a] = fraction
            liquids.x[n + a] = fraction * ratio[a]
            liquids.share[a] = beta * ratio[a] / (1.0 + beta * (ratio[a] - 1.0))
            aqueous += (1.0 - beta) * fraction * total
        nrtl(n, AQUEOUS, block)
        nrtl(n, ORGANIC, block)
        _salt(n, aqueous, chem, block)
        worst, widest, along, across = 0.0, 0.0, 0.0, 0.0
        for a in range(n):
            gap = max(min(liquids.log_gamma[a] - liquids.log_gamma[n + a], _STEEPEST), -_STEEPEST)
            step = gap - last[a]
            worst = max(worst, abs(step))
            widest = max(widest, abs(gap))
            along += step * moved[a]
            across += moved[a] * moved[a]
            moved[a] = step
            last[a] = gap
        # Steps that shrink by a constant factor allow extrapolation to the limit (Wegstein; Orbach and Crowe 1971).
        factor = along / across if across > 0.0 else 0.0
        # Steps that swing without shrinking (salting out feeds back on itself) lead to the point between them.
        steady = (0.0 < factor < _STEADY and worst < 1.0) or factor < -_STEADY
        if turn % _FORESIGHT == _FORESIGHT - 1 and steady:
            for a in range(n):
                last[a] += moved[a] * factor / (1.0 - factor)
                moved[a] = 0.0
        for a in range(n):
            ratio[a] = math.exp(last[a])
        if widest < _SAME:
            _one_phase(n, water, total, temperature, chem, block)
            return
        if worst < _CLOSE:
            return


@helper
def _one_phase(n: int, water: float, total: float, temperature: float, chem: Handle, block: FloatArray) -> None:
    """Put everything into one phase: water if most molecules are water, or for ions, or salts that may dissolve."""
    liquids = liquids_in(block)
    salty = liquids.ions[1] > TRACE_MOL and water > _WET * total
    wet = water > 0.5 * total or liquids.ions[0] > TRACE_MOL or salty
    for a in range(n):
        liquids.share[a] = 0.0 if wet else 1.0
    activities(n, temperature, chem, block)


@helper
def on_curve(curves: FloatArray, material: int, temperature: float, chem: Handle) -> float:
    """Return the value of a curve [M, G] (``vapor`` or ``vaporizing``) of a material at a temperature in K."""
    curve = opened(RealChemistry, chem).curve
    at = (1.0 / temperature - curve[0]) / curve[1]
    at = min(max(at, 0.0), curves.shape[1] - 1.0)
    low = min(int(at), curves.shape[1] - 2)
    part = at - low
    return float(curves[material, low] * (1.0 - part) + curves[material, low + 1] * part)


@helper
def dimer_root(material: int, temperature: float, chem: Handle) -> float:
    """Return the square root of a vapour's dimerization constant (1/kPa) at a temperature in K; 0 without dimers.

    The constant of a mixed dimer is twice the product of the roots (rule of the double geometric mean).
    """
    dimer = opened(RealChemistry, chem).dimer
    if dimer[material, 1] == 0.0:
        return 0.0
    return math.exp(dimer[material, 0] + dimer[material, 1] / temperature)


@helper
def partial_pressures(n: int, temperature: float, chem: Handle, block: FloatArray, out: FloatArray) -> float:
    """Compute the vapour over the liquids; each molecule has its activity in the phase that holds most of it.

    The pressures of immiscible layers add up (steam distillation).

    Carboxylic acids form dimers: activities are those of the monomers (chemical theory: Prausnitz, Lichtenthaler and
    de Azevedo, Molecular Thermodynamics of Fluid-Phase Equilibria, 3rd ed. 1999, section 5.9). With the monomers'
    pressures p and r the roots of their constants, all dimers have the pressure s^2 of s = sum of r p.

    Args:
        n, liquids: the liquids.
        temperature: K.
        chem: the chemistry.
        out: [n] kPa of every molecule without dimers: proportional to the mol in the vapour.

    Returns:
        Pressure of the vapour in kPa; a dimer counts as one molecule.
    """
    liquids = liquids_in(block)
    vapor = opened(RealChemistry, chem).vapor
    total, bound = 0.0, 0.0
    for a in range(n):
        at = n + a if liquids.share[a] > 0.5 else a
        power = on_curve(vapor, int(liquids.who[a]), temperature, chem) + liquids.log_gamma[at]
        out[a] = liquids.x[at] * math.exp(power)
        total += out[a]
        liquids.parting[a] = dimer_root(int(liquids.who[a]), temperature, chem)
        bound += liquids.parting[a] * out[a]
    bound = min(bound, _MOST_BOUND)
    for a in range(n):
        root = liquids.parting[a]
        if root > 0.0:
            i = int(liquids.who[a])
            out[a] *= 1.0 + 2.0 * root * bound
            alone = 2.0 * root * root * math.exp(on_curve(vapor, i, temperature, chem))
            apart = alone / (1.0 + alone) - 2.0 * root * bound / (1.0 + 2.0 * root * bound)
            liquids.parting[a] = apart * GAS_CONSTANT * opened(RealChemistry, chem).dimer[i, 1]
    return total + bound * bound


@helper
def vapor_mol(n: int, partial: FloatArray) -> float:
    """Return the sum of the pressures of all molecules without dimers."""
    total = 0.0
    for a in range(n):
        total += partial[a]
    return total
