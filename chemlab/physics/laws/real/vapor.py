"""Vapour over a vessel's liquids, what boils them, and the relief valve."""

from __future__ import annotations

import math

from ....arrays import FloatArray, Handle
from ....chemistry import AIR, AMOUNTS, CAPACITY, ROLE_GAS, TEMPERATURE
from ....jit import helper, inner, kernel, opened, scratch
from ...constants import GAS_CONSTANT, TRACE_MOL
from ...events import RELIEF
from ...transfer import heat_capacity, volume
from .chemistry import AQUEOUS, MOST_FLUIDS, ORGANIC, RealChemistry
from .liquids import Liquids, activities, clear_liquids, gather, on_curve, partial_pressures, split

__all__ = ["bubble_point", "flash_off", "headspace_gas", "reflux", "vapor_pressure", "vent", "write_back"]

_NO_BOILING = 1e4
"""K: returned where nothing boils."""
_CLOSE_K = 1e-4
_SAME_K = 0.1
"""Change of temperature that leaves activities as they are."""
_MOST_ROUNDS = 40
_FLASHED_K = 0.01
"""Above the boiling point, where flashing is over."""
_LONGEST_K = 30.0
_HOTTEST_K = 890.0


@helper
def headspace_gas(row: FloatArray, chem: Handle) -> float:
    """mol of gas that a sealed vessel holds: its air, and what reactions have made."""
    role = opened(RealChemistry, chem).role
    total = row[AIR]
    for i in range(role.shape[0]):
        if role[i] == ROLE_GAS:
            total += row[AMOUNTS + i]
    return float(total)


@kernel
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Sum of x gamma p_i(T) over the liquids, kPa; layers that do not mix add up."""
    liquids = clear_liquids()
    n = gather(row, chem, liquids)
    if n == 0:
        return 0.0
    activities(n, row[TEMPERATURE], chem, liquids)
    return partial_pressures(n, row[TEMPERATURE], chem, liquids, scratch(MOST_FLUIDS))


@inner
def bubble_point(n: int, pressure: float, guess: float, chem: Handle, liquids: Liquids, partial: FloatArray) -> float:
    """K at which the liquids' vapour has ``pressure`` (kPa); 10,000 where nothing boils. Then ``partial`` [n] says
    whose vapour it is, and ``liquids`` how they share out between the phases there."""
    chemistry = opened(RealChemistry, chem)
    temperature = guess
    split(n, temperature, chem, liquids)
    for _round in range(_MOST_ROUNDS):
        # With the activities as they are, the temperature; at that temperature, the activities.
        before = temperature
        for _again in range(_MOST_ROUNDS):
            total = partial_pressures(n, temperature, chem, liquids, partial)
            slope = 0.0
            for a in range(n):
                slope += partial[a] * on_curve(chemistry.vaporizing, int(liquids.who[a]), temperature, chem)
            slope /= GAS_CONSTANT * temperature * temperature * max(total, 1e-300)
            step = math.log(pressure / max(total, 1e-300)) / max(slope, 1e-6)
            step = max(min(step, _LONGEST_K), -_LONGEST_K)
            if temperature >= _HOTTEST_K and step > 0.0:
                return _NO_BOILING
            temperature = max(min(temperature + step, _HOTTEST_K), 160.0)
            if abs(step) < _CLOSE_K:
                break
        if abs(temperature - before) < _SAME_K:
            break
        if abs(temperature - before) > _LONGEST_K:
            split(n, temperature, chem, liquids)
        else:
            activities(n, temperature, chem, liquids)
    return temperature


@inner
def write_back(row: FloatArray, n: int, chem: Handle, liquids: Liquids) -> None:
    """Give a row the amounts and phases of its liquids; crystals stay."""
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    for a in range(n):
        i = int(liquids.who[a])
        at = AMOUNTS + m + 2 * chemistry.dissolved_at[i]
        row[AMOUNTS + i] = max(row[AMOUNTS + i] + liquids.mol[a] - row[at + AQUEOUS] - row[at + ORGANIC], 0.0)
        row[at + ORGANIC] = liquids.mol[a] * liquids.share[a]
        row[at + AQUEOUS] = max(liquids.mol[a] - row[at + ORGANIC], 0.0)


@kernel
def flash_off(row: FloatArray, pressure: float, chem: Handle, waste: FloatArray) -> float:
    """What is hotter than its boiling point at ``pressure`` (kPa) boils from its own heat until it is not; the vapour
    goes to ``waste`` [M]. Returns mol lost."""
    chemistry = opened(RealChemistry, chem)
    liquids = clear_liquids()
    partial = scratch(MOST_FLUIDS)
    n = gather(row, chem, liquids)
    lost = 0.0
    for _round in range(200):
        if n == 0:
            break
        boiling = bubble_point(n, pressure, row[TEMPERATURE], chem, liquids, partial)
        excess = (row[TEMPERATURE] - boiling) * heat_capacity(row, chem)
        if row[TEMPERATURE] - boiling <= _FLASHED_K:
            break
        latent, total, everything = 0.0, 0.0, 0.0
        for a in range(n):
            total += partial[a]
            latent += partial[a] * on_curve(chemistry.vaporizing, int(liquids.who[a]), boiling, chem)
            everything += liquids.mol[a]
        mol = min(excess / (latent / total), 0.05 * everything)
        if everything <= 1e3 * TRACE_MOL:
            mol = everything
        cooled = 0.0
        for a in range(n):
            i = int(liquids.who[a])
            gone = (
                liquids.mol[a] * -math.expm1(-mol * partial[a] / (total * liquids.mol[a]))
                if mol < everything
                else liquids.mol[a]
            )
            # The vapour leaves with the heat of a liquid at the vessel's temperature, and with its latent heat.
            cooled += gone * on_curve(chemistry.vaporizing, i, row[TEMPERATURE], chem)
            liquids.mol[a] -= gone
            waste[i] += gone
            lost += gone
        write_back(row, n, chem, liquids)
        row[TEMPERATURE] -= cooled / max(heat_capacity(row, chem), 1e-9)
        n = gather(row, chem, liquids)
    return lost


@kernel
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Relief valve of a sealed vessel: above ``rated`` kPa gas leaves, with vapour in the proportion of their
    pressures; a liquid whose vapour alone is above it boils down, and cools by that."""
    chemistry = opened(RealChemistry, chem)
    headspace = max(row[CAPACITY] - volume(row, chem), 1e-3 * row[CAPACITY])
    gas = headspace_gas(row, chem)
    own = gas * GAS_CONSTANT * row[TEMPERATURE] / headspace
    vapor = vapor_pressure(row, chem)
    if own + vapor <= rated:
        return
    keep = max(rated - vapor, 0.0) / own if own > 0.0 else 0.0
    if keep < 1.0:
        row[AIR] *= keep
        for i in range(chemistry.role.shape[0]):
            if chemistry.role[i] == ROLE_GAS:
                gone = row[AMOUNTS + i] * (1.0 - keep)
                row[AMOUNTS + i] -= gone
                waste[i] += gone
                events[RELIEF] += gone
    if vapor > rated:
        events[RELIEF] += flash_off(row, rated, chem, waste)


@kernel
def reflux(row: FloatArray, joules: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """What is hotter than its boiling point gives up to ``joules`` to the condenser above it; then it boils off."""
    pressure = opened(RealChemistry, chem).ambient_pressure
    liquids = clear_liquids()
    n = gather(row, chem, liquids)
    if n == 0:
        return
    # Most of the time nothing boils, which one look at the pressure tells.
    activities(n, row[TEMPERATURE], chem, liquids)
    partial = scratch(MOST_FLUIDS)
    if partial_pressures(n, row[TEMPERATURE], chem, liquids, partial) <= pressure:
        return
    boiling = bubble_point(n, pressure, row[TEMPERATURE], chem, liquids, partial)
    capacity = heat_capacity(row, chem)
    row[TEMPERATURE] -= min((row[TEMPERATURE] - boiling) * capacity, joules) / capacity
    events[RELIEF] += flash_off(row, pressure, chem, waste)
