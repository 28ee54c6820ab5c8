"""Acid-base equilibrium of the aqueous layer: protonation states, and the reading of a pH meter.

With the activity of H+ as the only unknown, the proton balance is a monotonic function. It is solved by Newton's method
within brackets. Ionic strength, temperature and the mass of water depend on the result and are found by fixed-point
iteration. Water, H+ and OH- close the balances of atoms and charge, so these hold to rounding.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import AMOUNTS, TEMPERATURE
from ...constants import GAS_CONSTANT, ROOM_K, TRACE_MOL
from ...transfer import heat_capacity
from .. import separate
from .real_chemistry import RealChemistry

_LN10 = math.log(10.0)
_SALTIEST = 0.5
"""Ionic strength in mol/kg above which the Davies equation is invalid; activity coefficients are constant beyond."""
_FARTHEST = 25.0 * _LN10
"""Bound on the absolute value of ln of the activity of H+."""
_MOST_TRIALS, _MOST_ROUNDS = 200, 100
_CLOSE = 1e-13
_WATER_KEPT = 1e-3
"""Minimum share of the water that remains while the equilibrium is sought."""


class _Solution(NamedTuple):
    """Inputs of the proton balance, in mol, and activities."""

    kilograms: float
    """kilograms of water"""
    temperature: float
    """temperature in K"""
    log_gamma: float
    """ln of the activity coefficient of an ion of charge 1"""
    protons: float
    """[H+] - [OH-] plus the protons on all acids, which acid-base reactions conserve"""
    inert: float
    """mol of squared charge of the other ions"""


def acid_work_size(chemistry: RealChemistry) -> tuple[int, int]:
    """Return the shape of the scratch array that :func:`settle_acids` needs."""
    return max(chemistry.acid.shape[0], 1), 2 * chemistry.acid.shape[1] + 1


# -- the aqueous layer -----------------------------------------------------------------------------------------------


@helper
def _column(row: FloatArray, chem: Handle, material: int) -> int:
    """Return the column of a row with the amount of a material in the aqueous layer, which is the first."""
    chemistry = opened(RealChemistry, chem)
    m, k = chemistry.role.shape[0], chemistry.dissolved_at[material]
    if k < 0:
        return AMOUNTS + material
    return int(AMOUNTS + m + k * ((row.shape[0] - AMOUNTS - m) // chemistry.dissolved.shape[0]))


@helper
def _set_amount(row: FloatArray, chem: Handle, material: int, mol: float) -> None:
    """Set the amount of a material in the aqueous layer, and update its total."""
    column = _column(row, chem, material)
    if column != AMOUNTS + material:
        # The amount outside the aqueous layer: in another layer, or crystals.
        elsewhere = max(row[AMOUNTS + material] - row[column], 0.0)
        row[AMOUNTS + material] = elsewhere + mol
    row[column] = mol


@helper
def ionizes(chem: Handle) -> bool:
    """Return True if H+, OH- and water are materials of a chemistry, which equilibrate with acids and bases."""
    ionization = opened(RealChemistry, chem).ionization
    return bool(ionization[0] >= 0 and ionization[1] >= 0 and ionization[2] >= 0)


@helper
def _kilograms(row: FloatArray, chem: Handle) -> float:
    """Return the mass of water in the aqueous layer in kg."""
    chemistry = opened(RealChemistry, chem)
    water = chemistry.ionization[2]
    if water < 0:
        return 0.0
    mol = row[_column(row, chem, water)]
    return float(1e-3 * mol * chemistry.molar_mass[water]) if mol > TRACE_MOL else 0.0


@helper
def _charges(row: FloatArray, chem: Handle) -> float:
    """Return the sum of mol times squared charge over the ions of the aqueous layer."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if chemistry.charge[i] != 0.0:
            total += row[_column(row, chem, i)] * chemistry.charge[i] * chemistry.charge[i]
    return total


@helper
def _log_gamma(strength: float, temperature: float, chem: Handle) -> float:
    """Return ln of the activity coefficient of an ion of charge 1 at an ionic strength in mol/kg.

    Davies, J. Chem. Soc. 1938, 2093, with the 0.3 of his Ion Association (1962). For charge z it is z^2 times this
    value. A follows temperature by the permittivity of water (Malmberg and Maryott, J. Res. NBS 56 (1956) 1).
    """
    t = min(max(temperature - 273.15, 0.0), 100.0)
    permittivity = 87.740 - 0.40008 * t + 9.398e-4 * t * t - 1.410e-6 * t * t * t
    closer = 78.304 * ROOM_K / (permittivity * (t + 273.15))
    root = math.sqrt(min(strength, _SALTIEST))
    davies = root / (1.0 + root) - 0.3 * root * root
    return float(-_LN10 * opened(RealChemistry, chem).debye * closer * math.sqrt(closer) * davies)


@helper
def _log_water(temperature: float, chem: Handle) -> float:
    """Return ln Kw at a temperature in K."""
    chemistry = opened(RealChemistry, chem)
    return float(-_LN10 * chemistry.water_pk + chemistry.water_heat / GAS_CONSTANT * (1.0 / ROOM_K - 1.0 / temperature))


# -- the balance of protons ------------------------------------------------------------------------------------------


@inner
def _share(chem: Handle, work: FloatArray, a: int, log_h: float, solution: _Solution) -> tuple[float, float, float]:
    """Distribute acid ``a`` over its species at an activity of H+, into the first columns of its row of ``work``.

    Returns:
        Per mole of acid: protons (relative to the last species), their variance, squared charge.
    """
    chemistry = opened(RealChemistry, chem)
    inverse = (1.0 / ROOM_K - 1.0 / solution.temperature) / GAS_CONSTANT
    ladder, highest, count = 0.0, -math.inf, 0
    for p in range(chemistry.acid.shape[1]):
        if chemistry.acid[a, p] < 0:
            break
        z = chemistry.charge[chemistry.acid[a, p]]
        work[a, p] = ladder - p * log_h - z * z * solution.log_gamma
        highest = max(highest, work[a, p])
        ladder += -_LN10 * chemistry.acid_pk[a, p] + chemistry.acid_heat[a, p] * inverse
        count += 1
    total = 0.0
    for p in range(count):
        work[a, p] = math.exp(work[a, p] - highest)
        total += work[a, p]
    mean, square, charges = 0.0, 0.0, 0.0
    for p in range(count):
        work[a, p] /= total
        left, z = count - 1 - p, chemistry.charge[chemistry.acid[a, p]]
        mean += work[a, p] * left
        square += work[a, p] * left * left
        charges += work[a, p] * z * z
    return mean, max(square - mean * mean, 0.0), charges


@helper
def _balance(chem: Handle, work: FloatArray, log_h: float, solution: _Solution) -> tuple[float, float, float]:
    """Return the excess of protons (mol) at an activity of H+, its derivative with ln of it, mol of squared charge."""
    chemistry = opened(RealChemistry, chem)
    proton = solution.kilograms * math.exp(log_h - solution.log_gamma)
    hydroxide = solution.kilograms * math.exp(_log_water(solution.temperature, chem) - log_h - solution.log_gamma)
    excess, slope, charges = proton - hydroxide, proton + hydroxide, solution.inert + proton + hydroxide
    last = work.shape[1] - 1
    for a in range(chemistry.acid.shape[0]):
        if work[a, last] > 0.0:
            mean, variance, squares = _share(chem, work, a, log_h, solution)
            excess += work[a, last] * mean
            slope += work[a, last] * variance
            charges += work[a, last] * squares
    return excess - solution.protons, slope, charges


@inner
def _solve(chem: Handle, work: FloatArray, start: float, solution: _Solution) -> float:
    """Return ln of the activity of H+ that balances the protons, by Newton's method within brackets."""
    low, high, log_h = -_FARTHEST, _FARTHEST, min(max(start, -_FARTHEST), _FARTHEST)
    for _ in range(_MOST_TRIALS):
        excess, slope, _charges_there = _balance(chem, work, log_h, solution)
        if excess > 0.0:
            high = log_h
        else:
            low = log_h
        step = -excess / slope
        if abs(step) < _CLOSE:
            return log_h
        log_h += step
        if not low < log_h < high:
            log_h = 0.5 * (low + high)
            if high - low < _CLOSE:
                return log_h
    return log_h


@inner
def _gather(row: FloatArray, chem: Handle, work: FloatArray) -> tuple[float, float]:
    """Copy amounts and totals of the acids into ``work``.

    Returns:
        mol of protons in the balance, and mol of squared charge of the acids, H+ and OH-.
    """
    chemistry = opened(RealChemistry, chem)
    width, last = chemistry.acid.shape[1], work.shape[1] - 1
    proton = row[_column(row, chem, chemistry.ionization[0])]
    hydroxide = row[_column(row, chem, chemistry.ionization[1])]
    protons, charges = proton - hydroxide, proton + hydroxide
    for a in range(chemistry.acid.shape[0]):
        count = 0
        while count < width and chemistry.acid[a, count] >= 0:
            count += 1
        work[a, last] = 0.0
        for p in range(count):
            i = chemistry.acid[a, p]
            mol = row[_column(row, chem, i)]
            work[a, width + p] = mol
            work[a, last] += mol
            protons += (count - 1 - p) * mol
            charges += mol * chemistry.charge[i] * chemistry.charge[i]
    return protons, charges


@inner
def _balance_species(chem: Handle, work: FloatArray) -> float:
    """Convert shares to amounts that add up to their totals; return the mol of released protons."""
    chemistry = opened(RealChemistry, chem)
    width, last = chemistry.acid.shape[1], work.shape[1] - 1
    freed = 0.0
    for a in range(chemistry.acid.shape[0]):
        if work[a, last] <= 0.0:
            for p in range(width):
                work[a, p] = work[a, width + p] if chemistry.acid[a, p] >= 0 else 0.0
            continue
        most, rest = 0, work[a, last]
        for p in range(width):
            if chemistry.acid[a, p] < 0:
                break
            work[a, p] *= work[a, last]
            if work[a, p] > work[a, most]:
                most = p
        for p in range(width):
            if chemistry.acid[a, p] >= 0 and p != most:
                rest -= work[a, p]
        work[a, most] = max(rest, 0.0)
        for p in range(width):
            if chemistry.acid[a, p] >= 0:
                # One proton less for each further species.
                freed += p * (work[a, p] - work[a, width + p])
    return freed


@inner
def _heat_released(chem: Handle, work: FloatArray, proton: float, hydroxide: float) -> tuple[float, float]:
    """Return the heat of the change to the amounts in ``work``: J at 298.15 K, and change of heat capacity in J/K.

    ``proton`` mol of H+ and ``hydroxide`` mol of OH- are formed in addition, from water.
    """
    chemistry = opened(RealChemistry, chem)
    h, oh, water = chemistry.ionization[0], chemistry.ionization[1], chemistry.ionization[2]
    heat = proton * chemistry.formation[h] + hydroxide * (chemistry.formation[oh] - chemistry.formation[water])
    capacity = proton * chemistry.heat_capacity[h]
    capacity += hydroxide * (chemistry.heat_capacity[oh] - chemistry.heat_capacity[water])
    width = chemistry.acid.shape[1]
    for a in range(chemistry.acid.shape[0]):
        for p in range(width):
            i = chemistry.acid[a, p]
            if i >= 0:
                heat += (work[a, p] - work[a, width + p]) * chemistry.formation[i]
                capacity += (work[a, p] - work[a, width + p]) * chemistry.heat_capacity[i]
    return -heat, capacity


@separate
def settle_acids(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Bring acids, bases and water of the aqueous layer to equilibrium; the heat changes the temperature.

    Args:
        row: vessel row, changed in place; unchanged without water.
        chem: the chemistry.
        work: scratch of shape :func:`acid_work_size`.
    """
    chemistry = opened(RealChemistry, chem)
    kilograms = _kilograms(row, chem)
    if kilograms <= 0.0 or not ionizes(chem):
        return
    h, oh, water = chemistry.ionization[0], chemistry.ionization[1], chemistry.ionization[2]
    proton_was, hydroxide_was = row[_column(row, chem, h)], row[_column(row, chem, oh)]
    water_was, start = row[_column(row, chem, water)], row[TEMPERATURE]
    protons, own = _gather(row, chem, work)
    inert = max(_charges(row, chem) - own, 0.0)
    capacity_was = heat_capacity(row, chem)
    temperature, mass = start, kilograms
    gamma = _log_gamma(0.5 * (inert + own) / mass, temperature, chem)
    log_h = _log_activity(row, chem, mass, gamma)
    proton, hydroxide = proton_was, hydroxide_was
    for _ in range(_MOST_ROUNDS):
        solution = _Solution(mass, temperature, gamma, protons, inert)
        log_h = _solve(chem, work, log_h, solution)
        charges = _balance(chem, work, log_h, solution)[2]
        # The rarer of H+ and OH- is set by the equilibrium; the other closes the charge balance.
        left = proton_was - hydroxide_was + _balance_species(chem, work)
        if left >= 0.0:
            hydroxide = mass * math.exp(_log_water(temperature, chem) - log_h - gamma)
            proton = left + hydroxide
        else:
            proton = mass * math.exp(log_h - gamma)
            hydroxide = proton - left
        formed = hydroxide_was - hydroxide
        heat, more = _heat_released(chem, work, proton - proton_was, -formed)
        before = mass, temperature, gamma
        capacity = max(capacity_was + more, 1e-3 * capacity_was)
        temperature = ROOM_K + (capacity_was * (start - ROOM_K) + heat) / capacity
        mass = kilograms * max(1.0 + formed / water_was, _WATER_KEPT)
        gamma = _log_gamma(0.5 * charges / mass, temperature, chem)
        change = abs(gamma - before[2]) + abs(temperature / before[1] - 1.0) + abs(mass / before[0] - 1.0)
        if change < _CLOSE:
            break
    if hydroxide - hydroxide_was > water_was:
        return
    width = chemistry.acid.shape[1]
    for a in range(chemistry.acid.shape[0]):
        for p in range(width):
            if chemistry.acid[a, p] >= 0:
                _set_amount(row, chem, chemistry.acid[a, p], work[a, p])
    _set_amount(row, chem, h, proton)
    _set_amount(row, chem, oh, hydroxide)
    _set_amount(row, chem, water, water_was - (hydroxide - hydroxide_was))
    row[TEMPERATURE] = temperature


@helper
def _log_activity(row: FloatArray, chem: Handle, kilograms: float, log_gamma: float) -> float:
    """Return ln of the activity of H+ from the amount of H+, or else of OH-; that of pure water without either."""
    chemistry = opened(RealChemistry, chem)
    proton = row[_column(row, chem, chemistry.ionization[0])]
    if proton > 0.0:
        return math.log(proton / kilograms) + log_gamma
    log_water = _log_water(row[TEMPERATURE], chem)
    hydroxide = row[_column(row, chem, chemistry.ionization[1])]
    if hydroxide > 0.0:
        return log_water - math.log(hydroxide / kilograms) - log_gamma
    return 0.5 * log_water


@helper
def _log_activity_alone(row: FloatArray, chem: Handle, kilograms: float, log_gamma: float) -> float:
    """Return ln of the activity of H+ if at most one of H+ and OH- is a material, so that nothing else exchanges
    protons.

    It follows from the ionization of water and the charge balance.
    """
    ionization = opened(RealChemistry, chem).ionization
    excess = 0.0
    for ion in range(2):
        if ionization[ion] >= 0:
            excess += (1.0 - 2.0 * ion) * row[_column(row, chem, ionization[ion])] / kilograms
    log_water = _log_water(row[TEMPERATURE], chem)
    half = 0.5 * abs(excess)
    # mol/kg of the more abundant ion
    more = half + math.sqrt(half * half + math.exp(log_water - 2.0 * log_gamma))
    log_more = math.log(more) + log_gamma
    return log_more if excess > 0.0 else log_water - log_more


@helper
def ph(row: FloatArray, chem: Handle) -> float:
    """Return the reading of a pH meter in an equilibrated vessel (:func:`settle_acids`).

    It is -log10 of the activity of H+ in the aqueous layer; NaN without an aqueous layer.
    """
    kilograms = _kilograms(row, chem)
    if kilograms <= 0.0:
        return math.nan
    gamma = _log_gamma(0.5 * _charges(row, chem) / kilograms, row[TEMPERATURE], chem)
    if not ionizes(chem):
        return -_log_activity_alone(row, chem, kilograms, gamma) / _LN10
    return -_log_activity(row, chem, kilograms, gamma) / _LN10
