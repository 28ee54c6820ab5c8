"""Drying: evaporation into a stream of air over the contents of a vessel."""

from __future__ import annotations

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, scratch
from ...chemistry import TEMPERATURE
from ...constants import GAS_CONSTANT, TRACE_MOL
from .boiling import evaporate
from .liquids import clear_liquids, count_ions, gather, liquids_in, partial_pressures, split, vapor_mol
from .real_chemistry import MOST_FLUIDS
from .salts import settle_salts
from .vapor import write_back

_STEP, _LEAST_STEP = 0.1, 1e-3
"""Maximum share of the liquids evaporated in one step of the integration (second order), and least such bound."""
_SLOWED = 0.8
"""Share of its initial rate below which evaporation may not slow in half a step."""
_MOST_STEPS = 400


@helper
def dry(row: FloatArray, litres: float, chem: Handle, waste: FloatArray) -> None:
    """Remove air saturated with x gamma p_i(T) of each liquid; small amounts of a liquid decay at first order.

    Air is measured by its vapour uptake, which is exact at constant pressure.
    """
    block = clear_liquids()
    liquids = liquids_in(block)
    partial, before, halfway = scratch(MOST_FLUIDS), scratch(MOST_FLUIDS), scratch(MOST_FLUIDS)
    n = gather(row, chem, block)
    temperature, left, most = row[TEMPERATURE], litres, _STEP
    for _step in range(_MOST_STEPS):
        everything = 0.0
        for a in range(n):
            everything += liquids.mol[a]
        if everything <= 10.0 * n * TRACE_MOL or left <= 1e-9 * litres:
            break
        split(n, temperature, chem, block)
        partial_pressures(n, temperature, chem, block, partial)
        rate = vapor_mol(n, partial) / (GAS_CONSTANT * temperature)  # mol/L
        mol, fastest = min(most * everything, rate * left), rate
        for a in range(n):
            before[a] = liquids.mol[a]
        evaporate(n, 0.5 * mol, partial, before, before, block)
        for a in range(n):
            halfway[a] = liquids.mol[a]
        split(n, temperature, chem, block)
        partial_pressures(n, temperature, chem, block, partial)
        rate = vapor_mol(n, partial) / (GAS_CONSTANT * temperature)
        if rate <= 0.0:
            break
        if rate < _SLOWED * fastest and most > _LEAST_STEP:  # a volatile liquid is nearly gone
            most *= 0.5
            for a in range(n):
                liquids.mol[a] = before[a]
            continue
        most = min(2.0 * most, _STEP)
        evaporate(n, min(mol, rate * left), partial, before, halfway, block)
        gone = 0.0
        for a in range(n):
            waste[int(liquids.who[a])] += before[a] - liquids.mol[a]
            gone += before[a] - liquids.mol[a]
        left -= gone / rate
        if liquids.ions[0] > 0.0:
            write_back(row, n, chem, block)
            settle_salts(row, chem)  # at constant temperature, because air and room supply the required heat
            count_ions(row, chem, block)
    for a in range(n):
        if liquids.mol[a] <= TRACE_MOL:  # the remainder of this liquid
            waste[int(liquids.who[a])] += liquids.mol[a]
            liquids.mol[a] = 0.0
    if n > 0:
        write_back(row, n, chem, block)
        settle_salts(row, chem)  # at constant temperature, because air and room supply the required heat
