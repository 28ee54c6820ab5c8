"""Layers: every solvent is a layer with its solutes (PHYSICS section 2)."""

from __future__ import annotations

from ....kernels.arrays import FloatArray, Handle, IntArray
from ....kernels.jit import helper, opened
from ...chemistry import AMOUNTS, CAPACITY, ROLE_ION, ROLE_SOLID, Chemistry
from ...constants import SOLIDS, TRACE_MOL
from ...transfer import row_has


@helper
def find_layers(row: FloatArray, chem: Handle, layers: IntArray, volumes: FloatArray) -> int:
    """Find the volumes of solids, fluid layers and air, densest fluid first."""
    chemistry = opened(Chemistry, chem)
    n, n_solvents, n_dissolved = chemistry.role.shape[0], chemistry.solvents.shape[0], chemistry.dissolved.shape[0]
    layers[1], volumes[0] = SOLIDS, 0.0
    count = 1
    for layer in range(n_solvents):
        i = chemistry.solvents[layer]
        if row[AMOUNTS + i] > TRACE_MOL:
            litres = row[AMOUNTS + i] * chemistry.molar_volume[i]
            for k in range(n_dissolved):
                litres += row[AMOUNTS + n + k * n_solvents + layer] * chemistry.molar_volume[chemistry.dissolved[k]]
            layers[1 + count], volumes[count] = i, litres
            count += 1
    no_solvent = count == 1
    for i in range(n):
        moles = row[AMOUNTS + i]
        if chemistry.role[i] == ROLE_SOLID or (no_solvent and chemistry.role[i] == ROLE_ION):
            volumes[0] += moles * chemistry.molar_volume[i]
    if no_solvent:
        for k in range(n_dissolved):
            i = chemistry.dissolved[k]
            if chemistry.role[i] != ROLE_ION and row[AMOUNTS + i] > TRACE_MOL:
                layers[1 + count], volumes[count] = i, row[AMOUNTS + i] * chemistry.molar_volume[i]
                count += 1
    for a in range(2, count):  # insertion sort, densest first
        b = a
        while b > 1 and chemistry.density[layers[1 + b]] > chemistry.density[layers[b]]:
            layers[1 + b], layers[b] = layers[b], layers[1 + b]
            volumes[b], volumes[b - 1] = volumes[b - 1], volumes[b]
            b -= 1
    filled = 0.0
    for c in range(count):
        filled += volumes[c]
    layers[1 + count], volumes[count] = chemistry.air, max(row[CAPACITY] - filled, 0.0)
    layers[0] = count + 1
    return count + 1


@helper
def solid_mol(row: FloatArray, material: int, chem: Handle) -> float:
    """Return all of a solid's mol."""
    return float(row[AMOUNTS + material]) if opened(Chemistry, chem).role[material] == ROLE_SOLID else 0.0


@helper
def solid_volume(row: FloatArray, chem: Handle) -> float:
    """Return the volume of the solids in L."""
    chemistry = opened(Chemistry, chem)
    total = 0.0
    for i in range(chemistry.role.shape[0]):
        total += solid_mol(row, i, chem) * chemistry.molar_volume[i]
    return total


@helper
def layer_density(row: FloatArray, layer: int, chem: Handle) -> float:
    """Return the density of the layer's solvent in kg/L."""
    return float(opened(Chemistry, chem).density[layer])


@helper
def layer_shade(row: FloatArray, layer: int, chem: Handle) -> float:
    """Return the grey value of the layer's solvent; solutes do not change it."""
    return float(opened(Chemistry, chem).shade[layer])


@helper
def drain_layer(source: FloatArray, target: FloatArray, layer: int, share: float, chem: Handle) -> float:
    """Move ``share`` of a solvent with its solutes, or of the solids; return the moved heat capacity in J/K.

    Ions that no liquid holds move with the solids.
    """
    chemistry = opened(Chemistry, chem)
    n, n_solvents, n_dissolved = chemistry.role.shape[0], chemistry.solvents.shape[0], chemistry.dissolved.shape[0]
    solvent_present, arriving = False, 0.0
    for column in range(n_solvents):
        solvent_present = solvent_present or row_has(source, chemistry.solvents[column])
    if layer < 0:
        for i in range(n):
            if chemistry.role[i] == ROLE_SOLID or (not solvent_present and chemistry.role[i] == ROLE_ION):
                moved = source[AMOUNTS + i] * share
                source[AMOUNTS + i] -= moved
                target[AMOUNTS + i] += moved
                arriving += moved * chemistry.heat_capacity[i]
        return float(arriving)
    moved = source[AMOUNTS + layer] * share
    source[AMOUNTS + layer] -= moved
    target[AMOUNTS + layer] += moved
    arriving += moved * chemistry.heat_capacity[layer]
    if not solvent_present:
        return float(arriving)
    for column in range(n_solvents):
        if chemistry.solvents[column] != layer:
            continue
        for k in range(n_dissolved):
            i = chemistry.dissolved[k]
            at = AMOUNTS + n + k * n_solvents + column
            moved = min(source[at] * share, source[AMOUNTS + i])
            source[at] -= moved
            target[at] += moved
            source[AMOUNTS + i] -= moved
            target[AMOUNTS + i] += moved
            arriving += moved * chemistry.heat_capacity[i]
    return float(arriving)
