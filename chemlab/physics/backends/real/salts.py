"""Salts: dissolved in water up to their solubility product, undissolved beyond it."""

from __future__ import annotations

import math

from ....kernels.arrays import FloatArray, Handle
from ....kernels.jit import helper, inner, opened
from ...chemistry import AMOUNTS, TEMPERATURE
from .heats import enthalpy, set_enthalpy
from .liquids import on_curve
from .real_chemistry import AQUEOUS, ORGANIC, RealChemistry

_MOST_ROUNDS = 60
_CLOSE = 1e-12
_CLOSE_K = 1e-10
"""Convergence tolerance in K of the temperature at which salts settle."""


@helper
def change_amount(row: FloatArray, chem: Handle, material: int, mol: float) -> None:
    """Add or remove an amount of a material and update a fluid's phases; additions go to water if there is any."""
    chemistry = opened(RealChemistry, chem)
    before = row[AMOUNTS + material]
    after = max(before + mol, 0.0)
    row[AMOUNTS + material] = after
    k = chemistry.dissolved_at[material]
    if k < 0:
        return
    at = AMOUNTS + chemistry.role.shape[0] + 2 * k
    placed = row[at + AQUEOUS] + row[at + ORGANIC]
    if mol < 0.0 and placed > 0.0:
        scale = max(placed + mol, 0.0) / placed
        row[at + AQUEOUS] *= scale
        row[at + ORGANIC] *= scale
    elif mol > 0.0:
        home = AQUEOUS if chemistry.liquid[material] == 2 or material == chemistry.water or placed <= 0.0 else ORGANIC
        if placed > 0.0 and home == ORGANIC:
            row[at + AQUEOUS] += mol * row[at + AQUEOUS] / placed
            row[at + ORGANIC] += mol * row[at + ORGANIC] / placed
        else:
            row[at + home] += mol


@inner
def _water_phase(row: FloatArray, chem: Handle, salt: int) -> float:
    """Return the solubility product of a salt in the aqueous phase in mol^2: (solubility x kilograms of molecules)^2.

    In a mixture, the logarithms of the solubilities are averaged by mass (Yalkowsky's log-linear rule).
    """
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    curves = chemistry.solubility[salt]
    mass, weighted = 0.0, 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if chemistry.liquid[i] != 1:
            continue
        grams = row[AMOUNTS + m + 2 * k + AQUEOUS] * chemistry.molar_mass[i]
        mass += grams
        weighted += grams * on_curve(curves, i, row[TEMPERATURE], chem)
    if mass <= 1e-9:
        return 0.0
    return (1e-3 * mass * math.exp(max(weighted / mass, -300.0))) ** 2


@helper
def settle_salts(row: FloatArray, chem: Handle) -> bool:
    """Bring every salt to its solubility product [cation][anion] at the vessel's temperature, or dissolve all of it.

    Salts with a common ion are iterated until none moves.

    Returns:
        True if any moved.
    """
    chemistry = opened(RealChemistry, chem)
    moved = False
    for _round in range(_MOST_ROUNDS):
        worst = 0.0
        for s in range(chemistry.salts.shape[0]):
            solid, cation, anion = chemistry.salts[s, 0], chemistry.salts[s, 1], chemistry.salts[s, 2]
            undissolved, c, a = row[AMOUNTS + solid], row[AMOUNTS + cation], row[AMOUNTS + anion]
            if undissolved <= 0.0 and (c <= 0.0 or a <= 0.0):
                continue
            product = _water_phase(row, chem, s)
            # (c + x)(a + x) = product; of the two roots, the one that leaves both ions non-negative.
            gap = 0.5 * (c - a)
            dissolving = math.sqrt(gap * gap + product) - 0.5 * (c + a)
            dissolving = min(max(dissolving, -min(c, a)), undissolved)
            if abs(dissolving) <= _CLOSE * (undissolved + c + a):
                continue
            change_amount(row, chem, solid, -dissolving)
            change_amount(row, chem, cation, dissolving)
            change_amount(row, chem, anion, dissolving)
            worst = max(worst, abs(dissolving))
            moved = True
        if worst <= _CLOSE:
            break
    return moved


@helper
def settle_with_heat(row: FloatArray, content: float, chem: Handle) -> bool:
    """Bring every salt to its solubility product at the temperature at which the contents have an enthalpy of
    ``content`` J.

    The heat of solution changes the temperature, and this the solubilities. Solved by a secant method within the
    temperatures known to be too cold and too hot.

    Returns:
        True if any salt moved.
    """
    here = row[TEMPERATURE]
    if not settle_salts(row, chem):
        return False
    cold, hot, before, gap_before = -math.inf, math.inf, here, 0.0
    for _round in range(_MOST_ROUNDS):
        set_enthalpy(row, content, chem)
        there = row[TEMPERATURE]
        gap = there - here
        if abs(gap) <= _CLOSE_K:
            break
        if gap > 0.0:
            cold = here
        else:
            hot = here
        slope = (gap - gap_before) / (here - before) if here != before else -1.0
        before, gap_before = here, gap
        here = here - gap / slope if slope < 0.0 else there
        if not cold < here < hot:
            here = 0.5 * (cold + hot) if hot - cold < math.inf else there
        row[TEMPERATURE] = here
        settle_salts(row, chem)
    else:
        set_enthalpy(row, content, chem)  # several salts need not converge; the heat stays in the vessel all the same
    return True


@helper
def let_salts_fall_out(row: FloatArray, chem: Handle) -> bool:
    """Precipitate salts that the remaining solvent no longer holds, or dissolve them; their heat of solution changes
    the temperature. Return True if any moved.
    """
    return settle_with_heat(row, enthalpy(row, chem), chem)
