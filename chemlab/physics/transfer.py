"""Volumes, pouring, draining, adding, spilling: moving matter between rows, balanced to rounding.

Receiving matter stirs: the settling clock's distance from the mixed state shrinks by the share of volume that
was already there. The dissolved amounts in a row are valid for CLOCK_WAS; after these operations the
caller runs :func:`chemlab.physics.partition.partition`, which brings them to CLOCK.
"""

from __future__ import annotations

from typing import Protocol

from ..shelf import (
    AMOUNTS,
    CAPACITY,
    CLOCK,
    CLOCK_WAS,
    PRESENT,
    ROLE_GAS,
    ROLE_ION,
    ROLE_SOLID,
    T_MIX,
    TEMPERATURE,
    Chemistry,
    FloatArray,
    IntArray,
)
from .events import SPILL
from .jit import helper, kernel

__all__ = [
    "TRACE_MOL",
    "Volumes",
    "add",
    "clear",
    "drain",
    "heat_capacity",
    "liquid_volume",
    "move",
    "place",
    "pour",
    "remove_fraction",
    "row_has",
    "solid_volume",
    "spill",
    "volume",
]

# Below this many moles nothing is there: what divisions leave behind must not count as a layer or a liquid.
TRACE_MOL = 1e-12


class Volumes(Protocol):
    """What a volume takes to know of the materials: a :class:`~chemlab.shelf.Chemistry` has it."""

    @property
    def role(self) -> IntArray:
        """[M] one of the ROLE constants"""
        ...  # a protocol has no body

    @property
    def molar_volume(self) -> FloatArray:
        """[M] L/mol"""
        ...  # a protocol has no body


@helper
def volume(row: FloatArray, chem: Volumes) -> float:
    """Volume of everything in the vessel but gases, L."""
    total = 0.0
    for i in range(chem.role.shape[0]):
        if chem.role[i] != ROLE_GAS:
            total += row[AMOUNTS + i] * chem.molar_volume[i]
    return total


@helper
def solid_volume(row: FloatArray, chem: Chemistry) -> float:
    """Volume of the solids, L."""
    total = 0.0
    for i in range(chem.role.shape[0]):
        if chem.role[i] == ROLE_SOLID:
            total += row[AMOUNTS + i] * chem.molar_volume[i]
    return total


@helper
def liquid_volume(row: FloatArray, chem: Chemistry) -> float:
    """Volume of the liquids and what is dissolved in them, L."""
    return volume(row, chem) - solid_volume(row, chem)


@helper
def heat_capacity(row: FloatArray, chem: Chemistry) -> float:
    """Heat capacity of the contents without air, J/K."""
    total = 0.0
    for i in range(chem.role.shape[0]):
        total += row[AMOUNTS + i] * chem.heat_capacity[i]
    return total


@helper
def _stir(row: FloatArray, volume_before: float, volume_after: float) -> None:
    if volume_after > 0.0:
        row[CLOCK] = T_MIX + (row[CLOCK] - T_MIX) * min(volume_before / volume_after, 1.0)


@helper
def _mix_temperature(row: FloatArray, capacity_before: float, capacity_added: float, temperature_added: float) -> None:
    both = capacity_before + capacity_added
    if both > 0.0:
        row[TEMPERATURE] = (capacity_before * row[TEMPERATURE] + capacity_added * temperature_added) / both


@helper
def remove_fraction(row: FloatArray, fraction: float, chem: Chemistry, into: FloatArray) -> None:
    """Move ``fraction`` (0 to 1) of everything in the vessel into an amounts array ``into`` [M] (mol)."""
    n = chem.role.shape[0]
    for i in range(n):
        moved = row[AMOUNTS + i] * fraction
        row[AMOUNTS + i] -= moved
        into[i] += moved
    for i in range(AMOUNTS + n, row.shape[0]):
        row[i] -= row[i] * fraction


@helper
def spill(row: FloatArray, chem: Chemistry, waste: FloatArray, events: FloatArray) -> None:
    """What does not fit goes to waste, an equal share of everything."""
    filled = volume(row, chem)
    if filled > row[CAPACITY] * (1.0 + 1e-12):
        remove_fraction(row, 1.0 - row[CAPACITY] / filled, chem, waste)
        events[SPILL] += filled - row[CAPACITY]


@helper
def pour(
    source: FloatArray, target: FloatArray, fraction: float, chem: Chemistry, waste: FloatArray, events: FloatArray
) -> None:
    """Pour ``fraction`` (0 to 1) of everything in ``source`` into ``target``; what does not fit spills."""
    n = chem.role.shape[0]
    before = volume(target, chem)
    there = heat_capacity(target, chem)
    arriving = fraction * heat_capacity(source, chem)
    if fraction <= 0.0 or arriving <= 0.0:
        return
    _mix_temperature(target, there, arriving, source[TEMPERATURE])
    for i in range(AMOUNTS, AMOUNTS + n):
        moved = source[i] * fraction
        target[i] += moved
        source[i] -= moved
    for i in range(AMOUNTS + n, source.shape[0]):
        moved = source[i] * fraction
        target[i] += moved
        source[i] -= moved
    _stir(target, before, volume(target, chem))
    spill(target, chem, waste, events)


@helper
def add(
    row: FloatArray,
    material: int,
    mol: float,
    temperature: float,
    chem: Chemistry,
    waste: FloatArray,
    events: FloatArray,
) -> None:
    """Add ``mol`` of a pure material at ``temperature`` (K); what does not fit spills."""
    if mol <= 0.0:
        return
    before = volume(row, chem)
    _mix_temperature(row, heat_capacity(row, chem), mol * chem.heat_capacity[material], temperature)
    row[AMOUNTS + material] += mol
    _stir(row, before, volume(row, chem))
    spill(row, chem, waste, events)


@kernel
def drain(
    source: FloatArray,
    target: FloatArray,
    pixels: float,
    profile: FloatArray,
    layers: IntArray,
    chem: Chemistry,
    waste: FloatArray,
    events: FloatArray,
    share: FloatArray,
) -> None:
    """Drain the lowest ``pixels`` of ``source`` into ``target``: exactly what the layer profile says is there.

    Args:
        source, target: vessel rows.
        pixels: number of pixels, of the profile's 100 or so; fractions of a pixel count.
        profile: [C, pixels] layer profile of ``source`` (see :mod:`chemlab.physics.layers`).
        layers: [C + 1] the profile's columns: count, then SOLIDS or a material index each.
        chem: material constants.
        waste: [M] mol, receives what spills.
        events: safety events row.
        share: [C] scratch.
    """
    n, count, height = chem.role.shape[0], layers[0], profile.shape[1]
    whole = int(min(pixels, height))
    for c in range(count):
        low, total = 0.0, 0.0
        for p in range(height):
            if p < whole:
                low += profile[c, p]
            elif p == whole:
                low += profile[c, p] * (pixels - whole)
            total += profile[c, p]
        share[c] = min(low / total, 1.0) if total > 0.0 else 0.0
    before = volume(target, chem)
    there = heat_capacity(target, chem)
    arriving = 0.0
    n_solvents, n_dissolved = chem.solvents.shape[0], chem.dissolved.shape[0]
    solvent_present = False
    for layer in range(n_solvents):
        solvent_present = solvent_present or row_has(source, chem.solvents[layer])
    for c in range(count):
        material = layers[1 + c]
        if material == chem.air or share[c] <= 0.0:
            continue
        if material < 0:  # the solids, and ions where no liquid holds them
            for i in range(n):
                if chem.role[i] == ROLE_SOLID or (not solvent_present and chem.role[i] == ROLE_ION):
                    moved = source[AMOUNTS + i] * share[c]
                    source[AMOUNTS + i] -= moved
                    target[AMOUNTS + i] += moved
                    arriving += moved * chem.heat_capacity[i]
            continue
        moved = source[AMOUNTS + material] * share[c]
        source[AMOUNTS + material] -= moved
        target[AMOUNTS + material] += moved
        arriving += moved * chem.heat_capacity[material]
        if not solvent_present:
            continue
        for layer in range(n_solvents):
            if chem.solvents[layer] != material:
                continue
            for k in range(n_dissolved):
                i = chem.dissolved[k]
                column = AMOUNTS + n + k * n_solvents + layer
                moved = min(source[column] * share[c], source[AMOUNTS + i])
                source[column] -= moved
                target[column] += moved
                source[AMOUNTS + i] -= moved
                target[AMOUNTS + i] += moved
                arriving += moved * chem.heat_capacity[i]
    _mix_temperature(target, there, arriving, source[TEMPERATURE])
    _stir(target, before, volume(target, chem))
    spill(target, chem, waste, events)


@helper
def row_has(row: FloatArray, material: int) -> bool:
    """Whether more than a trace of ``material`` is in the vessel."""
    return bool(row[AMOUNTS + material] > TRACE_MOL)


@helper
def move(source: FloatArray, target: FloatArray) -> None:
    """Put the vessel of one row into another row; no vessel is left behind."""
    for i in range(source.shape[0]):
        target[i] = source[i]
        source[i] = 0.0


@helper
def clear(row: FloatArray) -> None:
    """No vessel here any more."""
    row[:] = 0.0


@helper
def place(row: FloatArray, capacity: float, chem: Chemistry) -> None:
    """A clean, empty vessel."""
    row[:] = 0.0
    row[TEMPERATURE] = chem.ambient_temperature
    row[CAPACITY] = capacity
    row[CLOCK] = T_MIX
    row[CLOCK_WAS] = T_MIX
    row[PRESENT] = 1.0
