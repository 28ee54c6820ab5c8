"""Layers of a vessel: solids and crystals, water, the organic phase, air."""

from __future__ import annotations

from ....kernels.arrays import FloatArray, Handle, IntArray
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, CAPACITY, ROLE_SOLID
from ...constants import FIRST_PHASE, SOLIDS, TRACE_MOL
from .heats import crystals
from .real_chemistry import RealChemistry


@helper
def solid_mol(row: FloatArray, material: int, chem: Handle) -> float:
    """Return all of a solid's mol, or the crystals of a fluid."""
    chemistry = opened(RealChemistry, chem)
    if chemistry.role[material] == ROLE_SOLID:
        return float(row[AMOUNTS + material])
    if chemistry.fusion[material] > 0.0 and row[AMOUNTS + material] > 0.0:
        return crystals(row, chem, chemistry.dissolved_at[material])
    return 0.0


@helper
def solid_volume(row: FloatArray, chem: Handle) -> float:
    """Return the volume of solids and crystals in L."""
    chemistry = opened(RealChemistry, chem)
    total = 0.0
    for i in range(chemistry.role.shape[0]):
        total += solid_mol(row, i, chem) * chemistry.molar_volume[i]
    return total


@helper
def _phase(row: FloatArray, code: int, weights: FloatArray, chem: Handle) -> float:
    """Return the sum of mol x weight over the contents of a liquid layer."""
    chemistry = opened(RealChemistry, chem)
    at = AMOUNTS + chemistry.role.shape[0] + (FIRST_PHASE - code)
    total = 0.0
    for k in range(chemistry.dissolved.shape[0]):
        total += row[at + 2 * k] * weights[chemistry.dissolved[k]]
    return total


@helper
def layer_density(row: FloatArray, code: int, chem: Handle) -> float:
    """Return the density of a layer in kg/L."""
    chemistry = opened(RealChemistry, chem)
    if code > FIRST_PHASE:
        return float(chemistry.density[code])
    litres = _phase(row, code, chemistry.molar_volume, chem)
    return 1e-3 * _phase(row, code, chemistry.molar_mass, chem) / litres if litres > 0.0 else 0.0


@helper
def layer_shade(row: FloatArray, code: int, chem: Handle) -> float:
    """Return the grey value of a layer, the mean of its materials by volume."""
    chemistry = opened(RealChemistry, chem)
    if code > FIRST_PHASE:
        return float(chemistry.shade[code])
    at = AMOUNTS + chemistry.role.shape[0] + (FIRST_PHASE - code)
    litres, shade = 0.0, 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        part = row[at + 2 * k] * chemistry.molar_volume[i]
        litres += part
        shade += part * chemistry.shade[i]
    return min(shade / litres, 1.0) if litres > 0.0 else 0.0


@helper
def find_layers(row: FloatArray, chem: Handle, layers: IntArray, volumes: FloatArray) -> int:
    """Find the volumes of solids, liquid phases and air, densest liquid first."""
    chemistry = opened(RealChemistry, chem)
    layers[1], volumes[0] = SOLIDS, solid_volume(row, chem)
    count = 1
    for phase in range(2):
        litres = _phase(row, FIRST_PHASE - phase, chemistry.molar_volume, chem)
        if litres > TRACE_MOL:
            layers[1 + count], volumes[count] = FIRST_PHASE - phase, litres
            count += 1
    if count == 3 and layer_density(row, layers[2], chem) < layer_density(row, layers[3], chem):
        layers[2], layers[3] = layers[3], layers[2]
        volumes[1], volumes[2] = volumes[2], volumes[1]
    filled = 0.0
    for c in range(count):
        filled += volumes[c]
    layers[1 + count], volumes[count] = chemistry.air, max(row[CAPACITY] - filled, 0.0)
    layers[0] = count + 1
    return count + 1


@helper
def drain_layer(source: FloatArray, target: FloatArray, code: int, share: float, chem: Handle) -> float:
    """Move ``share`` of a layer, or of the solids and crystals; return their heat capacity in J/K."""
    chemistry = opened(RealChemistry, chem)
    m = chemistry.role.shape[0]
    arriving = 0.0
    for i in range(m):
        if code == SOLIDS and chemistry.role[i] == ROLE_SOLID:
            moved = source[AMOUNTS + i] * share
            source[AMOUNTS + i] -= moved
            target[AMOUNTS + i] += moved
            arriving += moved * chemistry.heat_capacity[i]
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        if code == SOLIDS:
            moved = crystals(source, chem, k) * share if chemistry.fusion[i] > 0.0 else 0.0
        else:
            at = AMOUNTS + m + 2 * k + (FIRST_PHASE - code)
            moved = min(source[at] * share, source[AMOUNTS + i])
            source[at] -= moved
            target[at] += moved
        source[AMOUNTS + i] -= moved
        target[AMOUNTS + i] += moved
        arriving += moved * chemistry.heat_capacity[i]
    return arriving
