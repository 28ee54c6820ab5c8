"""Distribution of molecules: equal activities in water and in the organic phase, to the extent of mixing."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, CLOCK, CLOCK_WAS, TEMPERATURE
from ...constants import LEAST_CAPACITY, TRACE_MOL
from ...shelf import CLOCK_SETTLED, T_MIX
from ...transfer import heat_capacity, within_range
from .acids import settle_acids
from .heats import crystals
from .liquids import clear_liquids, gather, liquids_in, split, undissolved_salts
from .real_chemistry import AQUEOUS, ORGANIC, RealChemistry
from .salts import let_salts_fall_out

_STIRRED = 0.99
"""Share of the way to equilibrium from which acids and bases equilibrate across the layers."""
_MOST_ROUNDS, _CLOSE = 60, 1e-7
"""Iteration limit of that equilibrium, and share of all molecules, and mol of salts, that may still be moving."""
_LEAST_SHARE = 1e-9
"""Share of a fluid below which its location does not determine the distribution of the rest."""


@helper
def crystallizes(row: FloatArray, chem: Handle, material: int) -> bool:
    """Return True if a fluid is a solid at the vessel's temperature, which may lie in it undissolved."""
    chemistry = opened(RealChemistry, chem)
    return bool(chemistry.fusion[material] > 0.0 and row[TEMPERATURE] < chemistry.melting[material])


@helper
def _melted(row: FloatArray, chem: Handle, material: int, solid: float) -> float:
    """Return mol of a fluid's crystals that melt, cooling the contents to the melting point at most.

    All of a fluid that never crystallizes melts.
    """
    chemistry = opened(RealChemistry, chem)
    fusion = chemistry.fusion[material]
    if fusion <= 0.0:
        return solid
    capacity = heat_capacity(row, chem)
    if capacity <= LEAST_CAPACITY:
        return solid
    excess = capacity * (row[TEMPERATURE] - chemistry.melting[material])
    melted = min(solid, excess / fusion)
    row[TEMPERATURE] -= melted * fusion / capacity
    return float(melted)


@helper
def place_new(row: FloatArray, chem: Handle) -> float:
    """Update the phases of a row to its total amounts; return mol whose location is new.

    New amounts follow the present distribution of the fluid, or go to the phase of lower activity; removed amounts
    leave both phases in proportion. New crystals stay undissolved until they dissolve (:mod:`.kinetics`). Above their
    melting point they melt as far as the excess heat suffices.
    """
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    moved = 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        at = AMOUNTS + m + 2 * k
        total, placed = row[AMOUNTS + i], row[at + AQUEOUS] + row[at + ORGANIC]
        if placed > total:
            scale = total / placed
            row[at + AQUEOUS] *= scale
            row[at + ORGANIC] *= scale
        elif placed < total and not crystallizes(row, chem, i):
            melted = _melted(row, chem, i, total - placed)
            _liquefy(row, chem, k, melted)
            moved += placed + melted - placed
    return moved


@helper
def _liquefy(row: FloatArray, chem: Handle, k: int, mol: float) -> None:
    """Move mol of fluid ``k`` that is in no liquid into the liquids."""
    chemistry = opened(RealChemistry, chem)
    i, at = chemistry.dissolved[k], AMOUNTS + chemistry.role.shape[0] + 2 * k
    placed = row[at + AQUEOUS] + row[at + ORGANIC]
    total = placed + mol
    if placed > _LEAST_SHARE * total:
        row[at + AQUEOUS] *= total / placed
        row[at + ORGANIC] = max(total - row[at + AQUEOUS], 0.0)
    else:
        home = AQUEOUS if i == chemistry.water or chemistry.liquid[i] == 2 else ORGANIC
        row[at + home] = total
        row[at + AQUEOUS + ORGANIC - home] = 0.0


@helper
def melting_point(row: FloatArray, chem: Handle) -> float:
    """Return the lowest melting point (K) of the crystals in a vessel; infinity without crystals."""
    chemistry = opened(RealChemistry, chem)
    lowest = math.inf
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if chemistry.fusion[i] > 0.0 and crystals(row, chem, k) > TRACE_MOL:
            lowest = min(lowest, chemistry.melting[i])
    return lowest


@helper
def melting_heat(row: FloatArray, temperature: float, chem: Handle) -> float:
    """Return the heat of fusion (J) of all crystals whose melting point is at most ``temperature`` (K)."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if chemistry.fusion[i] > 0.0 and chemistry.melting[i] <= temperature:
            total += crystals(row, chem, k) * chemistry.fusion[i]
    return total


@helper
def melt(row: FloatArray, temperature: float, joules: float, chem: Handle) -> float:
    """Melt crystals whose melting point is at most ``temperature`` (K) with at most ``joules``; return those used."""
    chemistry = opened(RealChemistry, chem)
    left = joules
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        solid = crystals(row, chem, k)
        if chemistry.fusion[i] > 0.0 and chemistry.melting[i] <= temperature and solid > TRACE_MOL:
            melted = min(solid, left / chemistry.fusion[i])
            _liquefy(row, chem, k, melted)
            left -= melted * chemistry.fusion[i]
    return joules - left


@helper
def _is_acid(material: int, chem: Handle) -> bool:
    chemistry = opened(RealChemistry, chem)
    for a in range(chemistry.acid.shape[0]):
        for p in range(chemistry.acid.shape[1]):
            if chemistry.acid[a, p] == material:
                return True
    return False


@helper
def partition(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Update the phases from CLOCK_WAS to CLOCK: more stirring brings the activities closer.

    With s the settling clock between mixed (0) and settled (1), existing amounts move 1 - s^2 of the way. A settled
    vessel keeps the content of each layer; new amounts go to equilibrium at once.
    """
    chemistry = opened(RealChemistry, chem)
    settled = (row[CLOCK] - T_MIX) / (CLOCK_SETTLED - T_MIX)
    way = 1.0 - settled * settled
    fresh = place_new(row, chem)
    row[CLOCK_WAS] = row[CLOCK]
    if way <= 1e-12 and fresh <= TRACE_MOL:
        return
    moved = _share_out(row, way, fresh, 1.0, chem)
    if way < _STIRRED:
        return
    # Ions formed in the water make room for more of the acid, as long as there is base, and drive out other molecules.
    acids, push = chemistry.ionization[0] >= 0, 1.0
    for _ in range(_MOST_ROUNDS):
        undissolved = undissolved_salts(row, chem)
        if not let_salts_fall_out(row, chem) and not acids:
            return
        if acids:
            settle_acids(row, chem, work)
            row[TEMPERATURE] = within_range(row[TEMPERATURE])
        before = moved
        moved = _share_out(row, way, 0.0, push, chem)
        if max(abs(moved), abs(undissolved_salts(row, chem) - undissolved)) < _CLOSE:
            return
        push = 2.0 * push if moved * before > 0.0 else 1.0


@helper
def _share_out(row: FloatArray, way: float, fresh: float, push: float, chem: Handle) -> float:
    """Move molecules ``way`` of the way to equilibrium, acids ``push`` times as far.

    ``fresh`` mol count as stirred. Returns the acids' mol moved into the organic phase as a share of all molecules.
    """
    chemistry = opened(RealChemistry, chem)
    block = clear_liquids()
    liquids = liquids_in(block)
    n = gather(row, chem, block)
    if n == 0:
        return 0.0
    split(n, row[TEMPERATURE], chem, block)
    total, moved = 0.0, 0.0
    for a in range(n):
        total += liquids.mol[a]
    way = max(way, min(fresh / total, 1.0))
    m = chemistry.role.shape[0]
    for a in range(n):
        i = int(liquids.who[a])
        at = AMOUNTS + m + 2 * chemistry.dissolved_at[i]
        mol, was = row[at + AQUEOUS] + row[at + ORGANIC], row[at + ORGANIC]
        acid = _is_acid(i, chem)
        far = way * push if acid else way
        row[at + ORGANIC] = max(was + far * (mol * liquids.share[a] - was), 0.0)
        if acid:
            row[at + ORGANIC] = min(row[at + ORGANIC], mol)
        row[at + AQUEOUS] = max(mol - row[at + ORGANIC], 0.0)
        moved += row[at + ORGANIC] - was if acid else 0.0
    for k in range(chemistry.dissolved.shape[0]):  # ions follow the water
        if chemistry.liquid[chemistry.dissolved[k]] == 2:
            at = AMOUNTS + m + 2 * k
            row[at + AQUEOUS] += row[at + ORGANIC]
            row[at + ORGANIC] = 0.0
    return moved / total
