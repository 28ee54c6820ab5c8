"""Reactions with heat: reversible, catalysed, inhibited, stiff or not, in a vessel with a heating or cooling jacket.

The unknowns are the extents of independent reactions and the heat through the jacket; the temperature follows from them
by the enthalpy balance. Atoms and energy are therefore conserved to rounding, whatever the integrator's error. Only
independent reactions are used (of A -> B, B -> C and A -> C the first two), because in cycles the extents of all
reactions, and their rounding errors, would grow without bound. Crystals that dissolve or grow are further unknowns
(:func:`.spans.prepare`). The method is RODAS3, a linearly implicit method of order 3(2) with four stages, L-stable and
stiffly accurate (Sandu et al., Atmos. Environ. 31 (1997) 3459; for such methods Hairer and Wanner, Solving Ordinary
Differential Equations II, 2nd ed. 1996, section IV.7).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ....kernels.arrays import FloatArray, Handle, IntArray
from ....kernels.jit import helper, inner, opened
from ...chemistry import AMOUNTS, ROLE_GAS, ROLE_ION, TEMPERATURE
from ...constants import GAS_CONSTANT, ROOM_K, TRACE_MOL
from ...mass_action import arrhenius as rate_constant
from ...surroundings import Surroundings
from ...transfer import heat_capacity, liquid_volume, within_range
from .. import separate
from .heats import dissolved
from .real_chemistry import AQUEOUS, ORGANIC, RealChemistry

_GAMMA = 0.5
_MOST_STEPS = 100_000
MOST_IN_SPAN = 1000
"""Number of steps after which an integration with shifting equilibria ends early, so that they settle."""
_USED_UP = 1e-15
"""mol below which a reactant counts as consumed."""
_LEAST_MOL = 1e-200
"""mol; divisions by less, as by a denormal number, may overflow."""
_ROUNDING = 4e-15
"""Rounding error of sums in mol/L, and relative.

A remainder of this size must not react, least of all below 0, where an autocatalytic reaction would diverge.
"""
_LEAST_ERROR, _LONGEST_RATIO = 1e-3, 8.0
"""Error below which step sizes grow no further, and maximum growth factor."""
_LEAST_LITRES = 1e-9
"""Minimum volume in L of a reacting liquid; smaller remainders are rounding errors without concentrations."""
_FIRST_SHARE = 0.1
"""Maximum share of a reactant that the first trial step uses at the initial rate."""
_HEAT_SCALE_K = 10.0
"""Temperature error equivalent to an error of a whole concentration: rates double about every 10 K."""
_SMALL = 0.01
"""Concentration, as a multiple of the absolute tolerance, below which orders under 1 (infinite slope at 0) become 1."""
_MOST_SWEEPS = 50
_SMALLEST_POWER, _LARGEST_POWER = -600.0, 300.0
"""Bounds of the exponent of a rate constant; beyond them it is effectively 0 or instantaneous."""
_OVERSHOT_K = 1.0
"""Allowed overshoot in K of a step beyond the final temperature."""
_COLDEST_K, _HOTTEST_K = 50.0, 5000.0
"""Temperature range of rate constants; trial steps may leave it."""

# Rows of the scratch: unknowns (length B + 1), reactions (R), species (S). The Jacobian and its factors follow.
_EXTENT, _TRIAL, _K1, _K2, _K3, _K4, _RATES, _PIVOT, _HEAT, _CAPACITY = range(10)
_FORWARD, _BACKWARD = range(10, 12)
_START, _NOW, _CONC, _POWERS = range(12, 16)
_VECTORS = 16

# Rows from the end of the scratch, which the integration reads and nothing else changes: a copy of the vessel row
# (:mod:`.reacting`), and another one; for each fluid the mol that saturate the liquids and the share of dissolved fluid
# in the organic phase; for the fluids whose crystals dissolve or grow, their index among the fluids, column among the
# concentrations, mol of crystals, mol at saturation, and that share; mol of each species after the integration. Before
# them, for each unknown, its changes besides the species of its reaction.
KEPT, PROBE, SATURATION, SHARES, PLACE, COLUMN, CRYSTALS, SATURATED, SHARE, PREDICTED = range(-1, -11, -1)
_ROWS_AT_END = 10


class Ways(NamedTuple):
    """Processes in a vessel besides its reactions, for :func:`integrate`."""

    crystals: int
    """number of fluids that dissolve or grow, described in the last rows of the scratch"""
    shifts: bool
    """whether acids, bases or salts redistribute products and reactants, as given by :func:`extra`"""
    leaves: bool
    """whether gas leaves the vessel as it is formed, so that it does not react"""


ALONE = Ways(0, False, False)
"""Reactions only."""


class _Vessel(NamedTuple):
    """Constants of a reacting vessel, per litre of its liquid."""

    energy: float
    """J/L, enthalpy relative to 298.15 K at the start"""
    capacity: float
    """J/K/L at the start"""
    jacket: float
    """jacket temperature in K"""
    transfer: float
    """W/K/L; < 0: the contents have the jacket's temperature"""
    rtol: float
    atol: float
    """mol/L"""
    hottest: float
    """K, temperature at which the integration ends"""
    ways: Ways
    litres: float
    work: FloatArray


def react_work_size(chemistry: RealChemistry) -> tuple[int, int]:
    """Return the shape of the scratch array that :func:`integrate` needs."""
    crystals = int((chemistry.fusion[chemistry.dissolved] > 0.0).sum())
    extents = chemistry.independent.shape[0] + crystals
    rows = _VECTORS + 2 * (extents + 1) + extents + _ROWS_AT_END
    n_reactions, n_species = chemistry.stoichiometry.shape
    return rows, max(extents + 1, n_reactions, n_species + crystals, len(chemistry.dissolved))


@helper
def extra(work: FloatArray, u: int) -> int:
    """Return the scratch row with the changes of each concentration by unknown ``u`` besides its stoichiometry."""
    return int(work.shape[0] - _ROWS_AT_END - 1 - u)


# -- contents --------------------------------------------------------------------------------------------------------


@helper
def available(row: FloatArray, chem: Handle, j: int) -> float:
    """Return mol of species ``j`` that can react: for dissolvable materials, the dissolved amount."""
    chemistry = opened(RealChemistry, chem)
    m, i = chemistry.role.shape[0], chemistry.species[j]
    k = chemistry.dissolved_at[i]
    if k < 0:
        return float(row[AMOUNTS + i])
    layers = (row.shape[0] - AMOUNTS - m) // chemistry.dissolved.shape[0]
    total = 0.0
    for layer in range(layers):
        total += row[AMOUNTS + m + k * layers + layer]
    return total


@helper
def _can_react(row: FloatArray, chem: Handle) -> bool:
    """Return True if any reaction has all its reactants, in one direction or the other."""
    chemistry = opened(RealChemistry, chem)
    for r in range(chemistry.forward.shape[0]):
        ready = True
        for f in range(chemistry.forward.shape[1]):
            j = chemistry.forward[r, f]
            if j >= 0 and available(row, chem, j) <= _USED_UP:
                ready = False
                break
        if ready:
            return True
        ready = chemistry.equilibrium[r] < math.inf
        for f in range(chemistry.backward.shape[1]):
            j = chemistry.backward[r, f]
            if not ready:
                break
            ready = j < 0 or available(row, chem, j) > _USED_UP
        if ready:
            return True
    return False


@helper
def _exchange_heat(row: FloatArray, chem: Handle, dt: float, around: Surroundings, hottest: float) -> float:
    """Exchange heat with the jacket up to its temperature or ``hottest`` (K); return the elapsed time.

    Without reactions there is a closed form.
    """
    at, jacket, transfer = row[TEMPERATURE], around.jacket, around.transfer
    if transfer == 0.0 or at == jacket or dt <= 0.0:
        return dt
    capacity = heat_capacity(row, chem)
    if capacity <= 0.0:
        return dt
    passed, left = dt, 0.0
    if 0.0 < transfer < math.inf:
        if at < hottest < jacket:
            passed = min(dt, capacity / transfer * math.log((jacket - at) / (jacket - hottest)))
        left = math.exp(-transfer * passed / capacity)
    row[TEMPERATURE] = within_range(jacket + (at - jacket) * left)
    return passed


@helper
def add_species(row: FloatArray, chem: Handle, j: int, change: float, shifts: bool) -> None:
    """Add ``change`` mol of species ``j`` (negative removes it) in proportion to its present distribution.

    A species that is not yet present goes to all layers by volume, an ion to water. If equilibria shift, a deficit
    stays as a negative amount in water until they have settled.
    """
    chemistry = opened(RealChemistry, chem)
    m, i = chemistry.role.shape[0], chemistry.species[j]
    k, n_dissolved = chemistry.dissolved_at[i], chemistry.dissolved.shape[0]
    before = available(row, chem, j)
    after = max(before + change, 0.0)
    if k < 0:
        row[AMOUNTS + i] = after
        return
    if shifts and before + change < 0.0:
        row[AMOUNTS + i] += change
        row[AMOUNTS + m + k * ((row.shape[0] - AMOUNTS - m) // n_dissolved)] += change
        return
    # Its crystals stay unchanged.
    row[AMOUNTS + i] = max(row[AMOUNTS + i] - before, 0.0) + after
    layers = (row.shape[0] - AMOUNTS - m) // n_dissolved
    first = AMOUNTS + m + k * layers
    if before > _LEAST_MOL:
        for layer in range(layers):
            row[first + layer] *= after / before
        return
    litres = 0.0
    for layer in range(1, layers):
        row[first + layer] = 0.0
        for d in range(n_dissolved):
            held = row[AMOUNTS + m + d * layers + layer] * chemistry.molar_volume[chemistry.dissolved[d]]
            row[first + layer] += held if d != k else 0.0
        litres += row[first + layer]
    water = 0.0
    for d in range(n_dissolved):
        water += row[AMOUNTS + m + d * layers] * chemistry.molar_volume[chemistry.dissolved[d]] if d != k else 0.0
    alone = chemistry.role[i] == ROLE_ION or litres <= 0.0
    row[first] = after
    for layer in range(1, layers):
        row[first + layer] = 0.0 if alone else after * row[first + layer] / (litres + water)
        row[first] = max(row[first] - row[first + layer], 0.0)


# -- rates and their derivatives -------------------------------------------------------------------------------------


@helper
def _power(concentration: float, order: float, small: float) -> float:
    """Return a concentration to the power of an order.

    Orders below 1, whose slope at 0 is infinite, change smoothly to order 1 below ``small``. Order 1 extends below 0,
    which trial steps may reach.
    """
    if order == 1.0:
        return concentration
    if order < 1.0 and concentration < small:
        bend = (order - 1.0) * max(concentration / small, 0.0)
        return float(concentration * small ** (order - 1.0) * (2.0 - order + bend))
    if concentration <= 0.0:
        return 0.0
    if order == 2.0:
        return concentration * concentration
    return float(concentration**order)


@helper
def _slope(concentration: float, order: float, small: float, power: float) -> float:
    """Return the derivative of ``power`` (:func:`_power`) with respect to the concentration."""
    if order == 1.0:
        return 1.0
    if order < 1.0 and concentration < small:
        bend = 2.0 * (order - 1.0) * max(concentration / small, 0.0)
        return float(small ** (order - 1.0) * (2.0 - order + bend))
    if concentration <= 0.0:
        return 0.0
    return order * power / concentration


@inner
def _temperature(chem: Handle, vessel: _Vessel, y: FloatArray) -> tuple[float, float]:
    """Return temperature (K) and heat capacity (J/K/L) at given extents and jacket heat, by the enthalpy balance."""
    n = opened(RealChemistry, chem).independent.shape[0] + vessel.ways.crystals
    energy, capacity = vessel.energy, vessel.capacity
    for b in range(n):
        energy -= vessel.work[_HEAT, b] * y[b]
        capacity += vessel.work[_CAPACITY, b] * y[b]
    if vessel.transfer < 0.0:
        return vessel.jacket, capacity
    capacity = max(capacity, 1e-3 * vessel.capacity)
    return ROOM_K + (energy + y[n]) / capacity, capacity


@helper
def _of_gas(chem: Handle, factors: IntArray, r: int) -> bool:
    """Return True if a gas is among the factors of a rate."""
    chemistry = opened(RealChemistry, chem)
    for f in range(factors.shape[1]):
        if factors[r, f] >= 0 and chemistry.role[chemistry.species[factors[r, f]]] == ROLE_GAS:
            return True
    return False


@inner
def _set_constants(chem: Handle, vessel: _Vessel, temperature: float) -> None:
    """Set forward and reverse rate constants at a temperature (K); 0 for reactions of gas that leaves."""
    chemistry, work = opened(RealChemistry, chem), vessel.work
    bounded = min(max(temperature, _COLDEST_K), _HOTTEST_K)
    inverse = (1.0 / bounded - 1.0 / ROOM_K) / GAS_CONSTANT
    for r in range(chemistry.stoichiometry.shape[0]):
        forward = rate_constant(r, bounded, chem)
        power = min(max(chemistry.equilibrium_heat[r] * inverse, _SMALLEST_POWER), _LARGEST_POWER)
        work[_FORWARD, r] = forward
        # Dividing by infinity gives 0.
        back = chemistry.equilibrium[r] < math.inf
        work[_BACKWARD, r] = forward * (math.exp(power) / chemistry.equilibrium[r]) if back else 0.0
        if vessel.ways.leaves and _of_gas(chem, chemistry.forward, r):
            work[_FORWARD, r] = 0.0
        if vessel.ways.leaves and back and _of_gas(chem, chemistry.backward, r):
            work[_BACKWARD, r] = 0.0


@helper
def _first_extra(chem: Handle, vessel: _Vessel) -> int:
    """Return the first unknown that changes more than the species of its reaction."""
    return 0 if vessel.ways.shifts else opened(RealChemistry, chem).independent.shape[0]


@helper
def _columns(chem: Handle, vessel: _Vessel) -> int:
    """Return the number of concentrations: species, then crystals that are not species."""
    return int(opened(RealChemistry, chem).species.shape[0] + vessel.ways.crystals)


@helper
def _concentrations(chem: Handle, vessel: _Vessel, y: FloatArray) -> None:
    """Compute the concentrations at given extents."""
    chemistry, work, columns = opened(RealChemistry, chem), vessel.work, _columns(chem, vessel)
    for j in range(columns):
        work[_CONC, j] = work[_START, j]
    for b in range(chemistry.independent.shape[0]):
        r = chemistry.independent[b]
        for c in range(chemistry.changes.shape[1]):
            j = chemistry.changes[r, c]
            if j >= 0:
                work[_CONC, j] += chemistry.stoichiometry[r, j] * y[b]
    for u in range(_first_extra(chem, vessel), chemistry.independent.shape[0] + vessel.ways.crystals):
        for j in range(columns):
            work[_CONC, j] += work[extra(work, u), j] * y[u]
    for j in range(columns):
        if abs(work[_CONC, j]) < _ROUNDING * (1.0 + work[_START, j]):
            work[_CONC, j] = 0.0


@inner
def _made(chem: Handle, extents: FloatArray, j: int) -> float:
    """Return the amount of species ``j`` formed by given extents."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for b in range(chemistry.independent.shape[0]):
        total += chemistry.stoichiometry[chemistry.independent[b], j] * extents[b]
    return total


@inner
def _change(chem: Handle, vessel: _Vessel, extents: FloatArray, j: int) -> float:
    """Return the change of concentration ``j`` by given extents (or their rates)."""
    chemistry = opened(RealChemistry, chem)
    total = _made(chem, extents, j) if j < chemistry.species.shape[0] else 0.0
    for u in range(_first_extra(chem, vessel), chemistry.independent.shape[0] + vessel.ways.crystals):
        total += vessel.work[extra(vessel.work, u), j] * extents[u]
    return total


@helper
def _effect(chem: Handle, vessel: _Vessel, u: int, j: int) -> float:
    """Return the change of concentration ``j`` per unit of unknown ``u``."""
    chemistry = opened(RealChemistry, chem)
    reaction = u < chemistry.independent.shape[0] and j < chemistry.species.shape[0]
    total = chemistry.stoichiometry[chemistry.independent[u], j] if reaction else 0.0
    if u >= _first_extra(chem, vessel):
        total += vessel.work[extra(vessel.work, u), j]
    return float(total)


@helper
def _lacking(vessel: _Vessel, q: int) -> float:
    """Return the undersaturation of the liquids with crystals ``q`` in mol/L."""
    work = vessel.work
    return float(work[SATURATED, q] / vessel.litres - work[_CONC, int(work[COLUMN, q])])


@helper
def _left(vessel: _Vessel, q: int, dissolved: float) -> float:
    """Return the mol/L of crystals ``q`` that remain after some have ``dissolved``."""
    return float(vessel.work[CRYSTALS, q] / vessel.litres - dissolved)


@inner
def _slowing(chem: Handle, work: FloatArray, r: int) -> float:
    """Return the factor by which inhibitors reduce a rate."""
    chemistry = opened(RealChemistry, chem)
    total = 1.0
    for f in range(chemistry.inhibitors.shape[1]):
        j = chemistry.inhibitors[r, f]
        if j >= 0:
            total += chemistry.inhibition[r, f] * max(work[_CONC, j], 0.0)
    return 1.0 / total


@helper
def _rates(chem: Handle, vessel: _Vessel, y: FloatArray, out: FloatArray) -> None:
    """Compute the rates of independent reactions (mol/L per time unit) and of heat through the jacket (W/L)."""
    chemistry = opened(RealChemistry, chem)
    n, work, small = chemistry.independent.shape[0], vessel.work, _SMALL * vessel.atol
    crystals = vessel.ways.crystals
    _concentrations(chem, vessel, y)
    temperature = _temperature(chem, vessel, y)[0]
    if vessel.transfer >= 0.0:
        _set_constants(chem, vessel, temperature)
        out[n + crystals] = vessel.transfer * (vessel.jacket - temperature)
    for q in range(crystals):
        out[n + q] = chemistry.crystal_rate * min(_left(vessel, q, y[n + q]), _lacking(vessel, q))
    for b in range(n):
        out[b] = 0.0
    for r in range(chemistry.stoichiometry.shape[0]):
        ahead, back = work[_FORWARD, r], work[_BACKWARD, r]
        for f in range(chemistry.forward.shape[1]):
            j = chemistry.forward[r, f]
            if j >= 0:
                ahead *= _power(work[_CONC, j], chemistry.forward_order[r, f], small)
        if back > 0.0:
            for f in range(chemistry.backward.shape[1]):
                j = chemistry.backward[r, f]
                if j >= 0:
                    back *= _power(work[_CONC, j], chemistry.backward_order[r, f], small)
        rate = (ahead - back) * _slowing(chem, work, r)
        for p in range(chemistry.parts.shape[1]):
            if chemistry.parts[r, p] >= 0:
                out[chemistry.parts[r, p]] += chemistry.part_numbers[r, p] * rate


@helper
def _spread(chem: Handle, vessel: _Vessel, r: int, j: int, slope: float) -> None:
    """Add the contribution of one rate's slope with respect to species ``j`` to the Jacobian."""
    chemistry, matrix = opened(RealChemistry, chem), vessel.work[_VECTORS:]
    for p in range(chemistry.parts.shape[1]):
        b = chemistry.parts[r, p]
        if b >= 0:
            part = slope * chemistry.part_numbers[r, p]
            for s in range(chemistry.independent.shape[0] + vessel.ways.crystals):
                matrix[b, s] += part * _effect(chem, vessel, s, j)


@helper
def _factor_slopes(chem: Handle, vessel: _Vessel, r: int, backward: bool, constant: float) -> float:
    """Add one direction of reaction ``r`` to the Jacobian; return its rate. ``constant`` is its signed rate
    constant.
    """
    chemistry = opened(RealChemistry, chem)
    factors = chemistry.backward if backward else chemistry.forward
    orders = chemistry.backward_order if backward else chemistry.forward_order
    conc, powers = vessel.work[_CONC], vessel.work[_POWERS]
    small = _SMALL * vessel.atol
    rate = constant
    for f in range(factors.shape[1]):
        powers[f] = 1.0
        j = factors[r, f]
        if j >= 0:
            powers[f] = _power(conc[j], orders[r, f], small)
            rate *= powers[f]
    for f in range(factors.shape[1]):
        j = factors[r, f]
        if j < 0:
            continue
        slope = constant * _slope(conc[j], orders[r, f], small, powers[f])
        for g in range(factors.shape[1]):
            if g != f:
                slope *= powers[g]
        if slope != 0.0:
            _spread(chem, vessel, r, j, slope)
    return rate


@helper
def _set_jacobian(chem: Handle, vessel: _Vessel, y: FloatArray) -> None:
    """Compute derivatives of :func:`_rates` with respect to the unknowns; concentrations and constants are those at
    ``y``.
    """
    chemistry, work = opened(RealChemistry, chem), vessel.work
    reactions = chemistry.independent.shape[0]
    n = reactions + vessel.ways.crystals
    matrix = work[_VECTORS:]
    temperature, capacity = _temperature(chem, vessel, y)
    per_square = 1.0 / (GAS_CONSTANT * temperature * temperature)
    for b in range(n + 1):
        for s in range(n + 1):
            matrix[b, s] = 0.0
    for r in range(chemistry.stoichiometry.shape[0]):
        slowing = _slowing(chem, work, r)
        ahead = _factor_slopes(chem, vessel, r, False, work[_FORWARD, r] * slowing)
        back = _factor_slopes(chem, vessel, r, True, -work[_BACKWARD, r] * slowing) if work[_BACKWARD, r] > 0.0 else 0.0
        for f in range(chemistry.inhibitors.shape[1]):
            j = chemistry.inhibitors[r, f]
            if j >= 0:
                _spread(chem, vessel, r, j, -(ahead + back) * slowing * chemistry.inhibition[r, f])
        energy = chemistry.activation_energy[r]
        hotter = (ahead * energy + back * (energy - chemistry.equilibrium_heat[r])) * per_square
        for p in range(chemistry.parts.shape[1]):
            if chemistry.parts[r, p] >= 0:
                matrix[chemistry.parts[r, p], n] += chemistry.part_numbers[r, p] * hotter
    for q in range(vessel.ways.crystals):
        u = reactions + q
        if _left(vessel, q, y[u]) < _lacking(vessel, q):
            matrix[u, u] = -chemistry.crystal_rate
            continue
        for s in range(n):
            matrix[u, s] = -chemistry.crystal_rate * _effect(chem, vessel, s, int(work[COLUMN, q]))
    matrix[n, n] = -vessel.transfer
    # So far the last column is the slope with temperature, which depends on extents and heat.
    for b in range(n + 1):
        slope = matrix[b, n] / capacity if vessel.transfer >= 0.0 else 0.0
        for s in range(n):
            matrix[b, s] -= slope * (work[_HEAT, s] + work[_CAPACITY, s] * (temperature - ROOM_K))
        matrix[b, n] = slope


# -- one step --------------------------------------------------------------------------------------------------------


@inner
def _factorize(n: int, h: float, work: FloatArray) -> bool:
    """Compute LU factors of 1 / (gamma h) - Jacobian with pivoting; return False if it is singular."""
    jacobian, lu, pivot = work[_VECTORS:], work[_VECTORS + n :], work[_PIVOT]
    for r in range(n):
        for s in range(n):
            lu[r, s] = -jacobian[r, s]
        lu[r, r] += 1.0 / (_GAMMA * h)
    for c in range(n):
        best = c
        for r in range(c + 1, n):
            if abs(lu[r, c]) > abs(lu[best, c]):
                best = r
        pivot[c] = best
        if not 0.0 < abs(lu[best, c]) < math.inf:
            return False
        if best != c:
            for s in range(n):
                lu[c, s], lu[best, s] = lu[best, s], lu[c, s]
        inverse = 1.0 / lu[c, c]
        for r in range(c + 1, n):
            if lu[r, c] != 0.0:
                lu[r, c] *= inverse
                for s in range(c + 1, n):
                    lu[r, s] -= lu[r, c] * lu[c, s]
    return True


@helper
def _solve(n: int, work: FloatArray, x: FloatArray) -> None:
    """Solve in place with the factors of :func:`_factorize`."""
    lu, pivot = work[_VECTORS + n :], work[_PIVOT]
    for c in range(n):
        best = int(pivot[c])
        x[c], x[best] = x[best], x[c]
    for r in range(1, n):
        for s in range(r):
            x[r] -= lu[r, s] * x[s]
    for r in range(n - 1, -1, -1):
        for s in range(r + 1, n):
            x[r] -= lu[r, s] * x[s]
        x[r] /= lu[r, r]


@helper
def _take_stages(chem: Handle, vessel: _Vessel, n: int, h: float) -> None:
    """Compute the four stages of RODAS3; the new unknowns are in the trial row, the error estimate in that of k4."""
    work = vessel.work
    y, trial, rates = work[_EXTENT], work[_TRIAL], work[_RATES]
    k1, k2, k3, k4 = work[_K1], work[_K2], work[_K3], work[_K4]
    for u in range(n):
        k1[u] = rates[u]
    _solve(n, work, k1)
    for u in range(n):
        k2[u] = rates[u] + 4.0 / h * k1[u]
    _solve(n, work, k2)
    for u in range(n):
        trial[u] = y[u] + 2.0 * k1[u]
    _rates(chem, vessel, trial, k3)
    for u in range(n):
        k3[u] += (k1[u] - k2[u]) / h
    _solve(n, work, k3)
    for u in range(n):
        trial[u] += k3[u]
    _rates(chem, vessel, trial, k4)
    for u in range(n):
        k4[u] += (k1[u] - k2[u] - 8.0 / 3.0 * k3[u]) / h
    _solve(n, work, k4)
    for u in range(n):
        trial[u] += k4[u]


@helper
def _error(chem: Handle, vessel: _Vessel) -> float:
    """Return the error of a trial step relative to the tolerance: RMS over concentrations, or the temperature's if
    larger.
    """
    chemistry = opened(RealChemistry, chem)
    n, columns = chemistry.independent.shape[0] + vessel.ways.crystals, _columns(chem, vessel)
    work = vessel.work
    _concentrations(chem, vessel, work[_TRIAL])
    total = 0.0
    for j in range(columns):
        held = max(work[_NOW, j], work[_CONC, j])
        ratio = _change(chem, vessel, work[_K4], j) / (vessel.atol + vessel.rtol * held)
        total += ratio * ratio
    worst = math.sqrt(total / columns)
    if vessel.transfer >= 0.0:
        temperature, capacity = _temperature(chem, vessel, work[_TRIAL])
        heat = work[_K4, n] if vessel.transfer > 0.0 else 0.0
        for b in range(n):
            heat -= (work[_HEAT, b] + work[_CAPACITY, b] * (temperature - ROOM_K)) * work[_K4, b]
        off = abs(heat / capacity) / (vessel.rtol * _HEAT_SCALE_K)
        # Not max(), which would hide NaN.
        worst = off if not off <= worst else worst
    return worst


@helper
def _hold_back(chem: Handle, vessel: _Vessel) -> bool:
    """Limit a trial step to the available amounts, reducing all consumers of a species alike.

    Returns:
        False if the reduction exceeds the tolerance or does not converge; then the step is rejected.
    """
    chemistry, work, rtol, atol = opened(RealChemistry, chem), vessel.work, vessel.rtol, vessel.atol
    y, trial = work[_EXTENT], work[_TRIAL]
    n = chemistry.independent.shape[0]
    for q in range(vessel.ways.crystals):
        over = -_left(vessel, q, trial[n + q])
        if over > 0.0:
            if over > atol + rtol * _left(vessel, q, y[n + q]):
                return False
            trial[n + q] -= over
            _concentrations(chem, vessel, trial)
    for _ in range(_MOST_SWEEPS):
        missing = False
        for j in range(_columns(chem, vessel)):
            lacking = -work[_CONC, j]
            if lacking <= 0.0:
                continue
            if lacking > atol + rtol * work[_NOW, j]:
                return False
            used = 0.0
            for u in range(n + vessel.ways.crystals):
                used += max(-_effect(chem, vessel, u, j) * (trial[u] - y[u]), 0.0)
            if used <= 0.0:
                continue
            missing = True
            keep = max(1.0 - lacking / used, 0.0)
            for u in range(n + vessel.ways.crystals):
                if _effect(chem, vessel, u, j) * (trial[u] - y[u]) < 0.0:
                    trial[u] = y[u] + keep * (trial[u] - y[u])
        if not missing:
            return True
        _concentrations(chem, vessel, trial)
    return False


# -- a vessel --------------------------------------------------------------------------------------------------------


@helper
def _begin(row: FloatArray, chem: Handle, vessel: _Vessel, dt: float) -> float:
    """Fill the scratch for the contents of a vessel; return the first trial step, 0 if nothing reacts."""
    chemistry, litres = opened(RealChemistry, chem), vessel.litres
    n, work, crystals = chemistry.independent.shape[0], vessel.work, vessel.ways.crystals
    for j in range(chemistry.species.shape[0]):
        work[_START, j] = available(row, chem, j) / litres
        work[_NOW, j] = work[_START, j]
    for b in range(n):
        r = chemistry.independent[b]
        work[_HEAT, b], work[_CAPACITY, b] = 0.0, 0.0
        for c in range(chemistry.changes.shape[1]):
            j = chemistry.changes[r, c]
            if j >= 0:
                i = chemistry.species[j]
                work[_HEAT, b] += chemistry.stoichiometry[r, j] * chemistry.formation[i]
                work[_CAPACITY, b] += chemistry.stoichiometry[r, j] * chemistry.heat_capacity[i]
    for q in range(crystals):
        k, other = int(work[PLACE, q]), chemistry.species.shape[0] + q
        work[_HEAT, n + q], work[_CAPACITY, n + q] = chemistry.fusion[chemistry.dissolved[k]], 0.0
        work[_START, other] = dissolved(row, chem, k) / litres if int(work[COLUMN, q]) == other else 0.0
        work[_NOW, other] = work[_START, other]
    for u in range(n + crystals + 1):
        work[_EXTENT, u], work[_TRIAL, u] = 0.0, 0.0
    if vessel.transfer < 0.0:
        _set_constants(chem, vessel, vessel.jacket)
    rates, h, running = work[_RATES], dt, False
    _rates(chem, vessel, work[_EXTENT], rates)
    for b in range(n):
        running = running or rates[b] != 0.0
    for q in range(crystals):
        running = running or abs(rates[n + q]) * dt * litres > _USED_UP
    if not running:
        return 0.0
    # The error estimate of a first step that consumes most of a reactant is not meaningful.
    for j in range(_columns(chem, vessel)):
        change = _change(chem, vessel, rates, j)
        if change < 0.0:
            h = min(h, (_FIRST_SHARE * work[_START, j] + vessel.atol) / -change)
    return h


@inner
def _next_step(error: float, last_error: float, ratio: float) -> float:
    """Return the ratio of the next step to one with ``error``.

    The previous step had ``last_error`` (0: none), and this one was longer by ``ratio``. The controller is predictive:
    growing errors are expected to grow further (Gustafsson, ACM Trans. Math. Softw. 20 (1994) 496).
    """
    error, last_error = max(error, _LEAST_ERROR), max(last_error, _LEAST_ERROR) if last_error > 0.0 else 0.0
    longer = 0.9 * error ** (-1.0 / 3.0)
    if last_error > 0.0:
        longer = min(longer, longer * ratio * (last_error / error) ** (1.0 / 3.0))
    return float(min(longer, _LONGEST_RATIO))


@inner
def _integrate(chem: Handle, vessel: _Vessel, first: float, dt: float) -> tuple[int, float]:
    """Integrate the extents from 0 to ``dt``, or until the contents are too hot.

    Returns:
        Number of steps, -1 if there are too many; elapsed time.
    """
    chemistry = opened(RealChemistry, chem)
    n, work = chemistry.independent.shape[0] + vessel.ways.crystals, vessel.work
    n += 1 if vessel.transfer > 0.0 else 0
    h, done, steps, fresh, last_error, last_step = first, 0.0, 0, True, 0.0, 1.0
    temperature = _temperature(chem, vessel, work[_EXTENT])[0]
    while done < dt:
        steps += 1
        if steps > _MOST_STEPS:
            return -1, done
        if steps > MOST_IN_SPAN and vessel.ways.shifts and done > 0.0:
            break
        last = h >= dt - done
        h = min(h, dt - done)
        if fresh:
            _set_jacobian(chem, vessel, work[_EXTENT])
        fresh = False
        if not _factorize(n, h, work):
            h *= 0.25
            continue
        _take_stages(chem, vessel, n, h)
        error = _error(chem, vessel)
        if not error < math.inf:
            h *= 0.25
            continue
        if error > 1.0:
            h *= max(0.1, 0.9 * error ** (-1.0 / 3.0))
            continue
        if not _hold_back(chem, vessel):
            h *= 0.5
            continue
        before, temperature = temperature, _temperature(chem, vessel, work[_TRIAL])[0]
        if vessel.transfer >= 0.0 and temperature > vessel.hottest + _OVERSHOT_K and before < vessel.hottest:
            h *= (vessel.hottest + 0.5 * _OVERSHOT_K - before) / (temperature - before)
            temperature = before
            continue
        done = dt if last else done + h
        for u in range(n):
            work[_EXTENT, u] = work[_TRIAL, u]
        for j in range(_columns(chem, vessel)):
            work[_NOW, j] = max(work[_CONC, j], 0.0)
        if vessel.transfer >= 0.0 and temperature >= vessel.hottest:
            break
        _rates(chem, vessel, work[_EXTENT], work[_RATES])
        fresh = True
        ratio = _next_step(error, last_error, h / last_step)
        last_error, last_step = error, h
        h *= ratio
    return steps, done


@inner
def dissolve(row: FloatArray, chem: Handle, k: int, mol: float, share: float) -> None:
    """Dissolve (or, for negative ``mol``, crystallize) mol of fluid ``k``.

    It is distributed like the dissolved amount, or by ``share``.
    """
    at = AMOUNTS + opened(RealChemistry, chem).role.shape[0] + 2 * k
    held = dissolved(row, chem, k)
    if held > TRACE_MOL:
        scale = max(held + mol, 0.0) / held
        row[at + AQUEOUS] *= scale
        row[at + ORGANIC] *= scale
    elif mol > 0.0:
        row[at + ORGANIC] += mol * share
        row[at + AQUEOUS] += mol * (1.0 - share)


@helper
def _finish(row: FloatArray, chem: Handle, vessel: _Vessel) -> None:
    """Write the final extents, crystals and temperature to a row."""
    chemistry, work = opened(RealChemistry, chem), vessel.work
    n, extent, litres = chemistry.independent.shape[0], work[_EXTENT], vessel.litres
    temperature = _temperature(chem, vessel, extent)[0]
    for growing in range(2):  # dissolved material may be consumed, and products may crystallize
        for q in range(vessel.ways.crystals):
            if (extent[n + q] < 0.0) == (growing == 1):
                dissolve(row, chem, int(work[PLACE, q]), litres * extent[n + q], work[SHARE, q])
        if growing == 1:
            break
        for j in range(chemistry.species.shape[0]):
            change = _made(chem, extent, j)
            if change != 0.0:
                add_species(row, chem, j, litres * change, vessel.ways.shifts)
    row[TEMPERATURE] = within_range(temperature)
    for j in range(chemistry.species.shape[0]):
        work[PREDICTED, j] = litres * work[_NOW, j]


@separate
def integrate(
    row: FloatArray, dt: float, around: Surroundings, hottest: float, ways: Ways, chem: Handle, work: FloatArray
) -> tuple[int, float]:
    """React the contents of one vessel with a jacket at constant volume, without boiling.

    Args:
        row: vessel row; its amounts (mol) and temperature (K) change in place.
        dt: time, in the unit of the rate constants, which is the second where heat passes through the wall.
        around: jacket and tolerances; that of temperature is ``rtol`` times 10 K. A transfer of 0 is a perfect
            insulator, infinity (or a negative number) keeps the contents as warm as the jacket.
        hottest: temperature in K at which (or up to 1 K above) this ends before ``dt``; ignored for contents at the
            jacket's temperature.
        ways: crystals that dissolve or grow, and shifting equilibria, with constant saturations and shifts.
        chem: the chemistry.
        work: scratch of shape :func:`react_work_size`.

    Returns:
        (number of steps, rejected ones included; elapsed time). The number is -1 if it exceeded
        100,000; nothing has changed then. With shifting equilibria, the time may end after :data:`MOST_IN_SPAN` steps:
        a salt that its ions use up would be replenished at the same share until then.
    """
    litres = 0.0
    if dt > 0.0 and (ways.crystals > 0 or _can_react(row, chem)):
        litres = liquid_volume(row, chem)
    if ways.crystals > 0 and dt > 0.0:
        litres = max(litres, 2.0 * _LEAST_LITRES)  # for traces that dissolve, and remainders of a melt
    if litres <= _LEAST_LITRES:
        return 0, _exchange_heat(row, chem, dt, around, hottest)
    capacity = heat_capacity(row, chem) / litres
    through = around.transfer / litres if around.transfer < math.inf else -1.0
    energy = capacity * (row[TEMPERATURE] - ROOM_K)
    vessel = _Vessel(energy, capacity, around.jacket, through, around.rtol, around.atol, hottest, ways, litres, work)
    first = _begin(row, chem, vessel, dt)
    if first <= 0.0:
        return 0, _exchange_heat(row, chem, dt, around, hottest)
    steps, passed = _integrate(chem, vessel, first, dt)
    if steps < 0:
        return -1, 0.0
    _finish(row, chem, vessel)
    return steps, passed
