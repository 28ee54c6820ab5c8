"""Vapour over a vessel's liquids, boiling points, and the relief valve."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened, scratch
from ...chemistry import AIR, AMOUNTS, CAPACITY, ROLE_GAS, TEMPERATURE
from ...constants import GAS_CONSTANT, LEAST_CAPACITY, TRACE_MOL
from ...events import RELIEF
from ...transfer import heat_capacity, volume, within_range
from .. import separate
from .heats import add_heat
from .liquids import activities, clear_liquids, gather, liquids_in, on_curve, partial_pressures, split, vapor_mol
from .real_chemistry import AQUEOUS, MOST_FLUIDS, ORGANIC, RealChemistry
from .salts import let_salts_fall_out

_NO_BOILING = 1e4
"""Temperature in K that is returned if nothing boils."""
_CLOSE_K = 1e-3
_SAME_K = 0.1
"""Change of temperature in K below which activities are reused."""
_MOST_ROUNDS = 40
_FLASHED_K = 0.01
"""Distance in K above the boiling point at which flashing ends."""
_AT_ONCE = 0.05
"""Maximum share of the liquids that boils off at one vapour composition."""
_MOST_FLASHES = 200
_LONGEST_K = 30.0
_LEAST_AIR = 1e-12
"""mol of air that always remain in a sealed vessel, which is known by them"""
_COLDEST_K, _HOTTEST_K = 160.0, 890.0
_DRY_MOL = 1e-9
"""mol of liquids that have no vapour pressure; boiling to dryness leaves less."""


@helper
def headspace_gas(row: FloatArray, chem: Handle) -> float:
    """Return mol of gas in a sealed vessel: its air, and gases formed by reactions."""
    role = opened(RealChemistry, chem).role
    total = row[AIR]
    for i in range(role.shape[0]):
        if role[i] == ROLE_GAS:
            total += row[AMOUNTS + i]
    return float(total)


@helper
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Return the sum of x gamma p_i(T) over the liquids in kPa; immiscible layers add up."""
    block = clear_liquids()
    n, everything = gather(row, chem, block), 0.0
    for a in range(n):
        everything += liquids_in(block).mol[a]
    if everything <= _DRY_MOL:
        return 0.0
    activities(n, row[TEMPERATURE], chem, block)
    return partial_pressures(n, row[TEMPERATURE], chem, block, scratch(MOST_FLUIDS))


@helper
def latent_heat(n: int, temperature: float, partial: FloatArray, chem: Handle, block: FloatArray) -> float:
    """Return the latent heat of a vapour with the composition ``partial`` in J/mol."""
    liquids = liquids_in(block)
    vaporizing = opened(RealChemistry, chem).vaporizing
    total, latent = 0.0, 0.0
    for a in range(n):
        total += partial[a]
        latent += partial[a] * (on_curve(vaporizing, int(liquids.who[a]), temperature, chem) + liquids.parting[a])
    return latent / max(total, 1e-300)


@inner
def _boils_at(n: int, pressure: float, at: float, chem: Handle, block: FloatArray, partial: FloatArray) -> float:
    """Extrapolate from a temperature ``at`` (K) to the temperature with vapour ``pressure``.

    By Clausius and Clapeyron, ln of a vapour pressure falls linearly with 1 / T.
    """
    total = max(partial_pressures(n, at, chem, block, partial), 1e-300)
    # Per mol of vapour: with dimers, more than one mol of molecules.
    latent = max(latent_heat(n, at, partial, chem, block) * (vapor_mol(n, partial) / total), 1.0)
    inverse = 1.0 / at + GAS_CONSTANT * math.log(total / pressure) / latent
    there = 1.0 / inverse if inverse > 0.0 else _HOTTEST_K
    return max(min(there, at + _LONGEST_K, _HOTTEST_K), at - _LONGEST_K, _COLDEST_K)


@separate
def bubble_point(n: int, pressure: float, guess: float, chem: Handle, block: FloatArray, partial: FloatArray) -> float:
    """Return the bubble point in K at ``pressure`` (kPa); 10,000 if nothing boils.

    ``partial`` [n] receives the vapour's composition, and ``liquids`` their distribution over the phases there.
    """
    guess = min(guess, _HOTTEST_K)
    temperature, known, shared = guess, guess, guess
    split(n, temperature, chem, block)
    for _round in range(_MOST_ROUNDS):
        before = temperature
        temperature = _boils_at(n, pressure, temperature, chem, block, partial)
        if before >= _HOTTEST_K and temperature >= _HOTTEST_K:
            return _NO_BOILING
        if abs(temperature - before) < _CLOSE_K:
            break
        # Activities at a nearby temperature are accurate enough.
        if abs(temperature - shared) > _LONGEST_K:
            split(n, temperature, chem, block)
            known, shared = temperature, temperature
        elif abs(temperature - known) > _SAME_K:
            activities(n, temperature, chem, block)
            known = temperature
    return temperature


@helper
def boiling_point(row: FloatArray, chem: Handle) -> float:
    """Return the boiling point in K of the contents of an open vessel; 10,000 if nothing boils."""
    block = clear_liquids()
    n = gather(row, chem, block)
    if n == 0:
        return _NO_BOILING
    pressure = opened(RealChemistry, chem).ambient_pressure
    return bubble_point(n, pressure, row[TEMPERATURE], chem, block, scratch(MOST_FLUIDS))


@helper
def write_back(row: FloatArray, n: int, chem: Handle, block: FloatArray) -> None:
    """Write the amounts and phases of the liquids to a row; crystals are unchanged."""
    liquids = liquids_in(block)
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    for a in range(n):
        i = int(liquids.who[a])
        at = AMOUNTS + m + 2 * chemistry.dissolved_at[i]
        row[AMOUNTS + i] = max(row[AMOUNTS + i] + liquids.mol[a] - row[at + AQUEOUS] - row[at + ORGANIC], 0.0)
        row[at + ORGANIC] = liquids.mol[a] * liquids.share[a]
        row[at + AQUEOUS] = max(liquids.mol[a] - row[at + ORGANIC], 0.0)


@inner
def _flash(row: FloatArray, n: int, mol: float, partial: FloatArray, chem: Handle, block: FloatArray) -> float:
    """Remove ``mol`` of vapour with the composition ``partial`` from the contents, or all of them.

    The remainder is in ``liquids.work``. Returns the required heat in J besides that of the liquids at the vessel's
    temperature.
    """
    liquids = liquids_in(block)
    vaporizing = opened(RealChemistry, chem).vaporizing
    total, everything, taken = 0.0, 0.0, 0.0
    for a in range(n):
        total += partial[a]
        everything += liquids.mol[a]
    for a in range(n):
        held = liquids.mol[a]
        gone = held * -math.expm1(-mol * partial[a] / (total * held)) if mol < everything else held
        taken += gone * (on_curve(vaporizing, int(liquids.who[a]), row[TEMPERATURE], chem) + liquids.parting[a])
        liquids.work[a] = gone
        liquids.mol[a] -= gone
    write_back(row, n, chem, block)
    return taken


@separate
def flash_off(
    row: FloatArray, pressure: float, heat: float, condenser: float, chem: Handle, waste: FloatArray
) -> float:
    """Add heat (J) to an open vessel and boil off what is above its boiling point at ``pressure`` (kPa).

    A condenser removes up to ``condenser`` joules and returns its condensate; other vapour goes to ``waste`` [M].
    Returns the lost mol.
    """
    block, partial = clear_liquids(), scratch(MOST_FLUIDS)
    liquids = liquids_in(block)
    n, capacity = gather(row, chem, block), heat_capacity(row, chem)
    if capacity <= LEAST_CAPACITY and heat == 0.0:
        return 0.0  # at the temperature of the surroundings
    warm = within_range(row[TEMPERATURE] + heat / max(capacity, LEAST_CAPACITY))
    # Usually nothing boils, which one pressure evaluation shows.
    if n > 0:
        activities(n, warm, chem, block)
    if n == 0 or partial_pressures(n, warm, chem, block, partial) <= pressure:
        add_heat(row, heat, chem)
        return 0.0
    lost, mol, left, boiling = 0.0, 0.0, heat, row[TEMPERATURE]
    for flashed in range(_MOST_FLASHES):
        before = boiling
        boiling = bubble_point(n, pressure, boiling, chem, block, partial)
        capacity = heat_capacity(row, chem)
        if capacity <= LEAST_CAPACITY:
            break
        excess = left + (row[TEMPERATURE] - boiling) * capacity
        if flashed == 0:
            left -= min(max(excess, 0.0), condenser)
            excess -= min(max(excess, 0.0), condenser)
        if excess <= _FLASHED_K * capacity:
            break
        warming = min(left, max(boiling - row[TEMPERATURE], 0.0) * capacity)
        row[TEMPERATURE] += warming / capacity
        left -= warming
        everything = 0.0
        for a in range(n):
            everything += liquids.mol[a]
        # The boiling point rises as vapour leaves, which retains some of the heat.
        rise = max((boiling - before) / mol, 0.0) if mol > 0.0 else 0.0
        mol = min(excess / (latent_heat(n, boiling, partial, chem, block) + rise * capacity), _AT_ONCE * everything)
        taken = _flash(row, n, everything if everything <= 1e3 * TRACE_MOL else mol, partial, chem, block)
        for a in range(n):
            waste[int(liquids.who[a])] += liquids.work[a]
            lost += liquids.work[a]
        spent = max(min(left, taken), 0.0)
        left -= spent
        add_heat(row, spent - taken, chem)
        # During evaporation, not after it: precipitating salts absorb heat that then boils off no more liquid.
        let_salts_fall_out(row, chem)
        n = gather(row, chem, block)
        if n == 0:
            break
    add_heat(row, left, chem)
    return lost


@helper
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Open the relief valve of a sealed vessel: above ``rated`` kPa, gas and vapour leave in proportion to their
    pressures.

    A liquid whose vapour pressure alone exceeds the rating evaporates and cools.
    """
    chemistry = opened(RealChemistry, chem)
    headspace = max(row[CAPACITY] - volume(row, chem), 1e-3 * row[CAPACITY])
    gas = headspace_gas(row, chem)
    own = gas * GAS_CONSTANT * row[TEMPERATURE] / headspace
    vapor = vapor_pressure(row, chem)
    if own + vapor <= rated:
        return
    keep = max(rated - vapor, 0.0) / own if own > 0.0 else 0.0
    if keep < 1.0:
        row[AIR] = max(keep * row[AIR], _LEAST_AIR)
        for i in range(chemistry.role.shape[0]):
            if chemistry.role[i] == ROLE_GAS:
                gone = row[AMOUNTS + i] * (1.0 - keep)
                row[AMOUNTS + i] -= gone
                waste[i] += gone
                events[RELIEF] += gone
    if vapor > rated:
        events[RELIEF] += flash_off(row, rated, 0.0, 0.0, chem, waste)
