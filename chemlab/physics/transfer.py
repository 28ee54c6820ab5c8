"""Volumes, pouring, draining, adding, spilling: transfer of material between rows, balanced to rounding.

Added material stirs the contents: the settling clock's distance from the mixed state shrinks by the volume share of the
previous contents. The dissolved amounts in a row are valid for CLOCK_WAS; after these operations the caller runs
:func:`chemlab.physics.backends.partition`, which updates them to CLOCK.
"""

from __future__ import annotations

from ..config.materials import COLDEST_K, HOTTEST_K
from ..kernels.arrays import FloatArray, Handle, IntArray
from ..kernels.jit import helper, opened
from .backends import drain_layer, solid_volume
from .chemistry import AMOUNTS, CAPACITY, CLOCK, CLOCK_WAS, PRESENT, ROLE_GAS, TEMPERATURE, Chemistry
from .constants import SOLIDS, TRACE_MOL
from .events import SPILL
from .shelf import CLOCK_SETTLED, T_MIX


@helper
def volume(row: FloatArray, chem: Handle) -> float:
    """Return the volume of everything in the vessel except gases in L."""
    chemistry = opened(Chemistry, chem)
    total = 0.0
    for i in range(chemistry.role.shape[0]):
        if chemistry.role[i] != ROLE_GAS:
            total += row[AMOUNTS + i] * chemistry.molar_volume[i]
    return total


@helper
def liquid_volume(row: FloatArray, chem: Handle) -> float:
    """Return the volume of the liquids and their solutes in L."""
    return volume(row, chem) - solid_volume(row, chem)


@helper
def heat_capacity(row: FloatArray, chem: Handle) -> float:
    """Return the heat capacity of the contents without air in J/K."""
    chemistry = opened(Chemistry, chem)
    total = 0.0
    for i in range(chemistry.role.shape[0]):
        total += row[AMOUNTS + i] * chemistry.heat_capacity[i]
    return total


@helper
def within_range(kelvin: float) -> float:
    """Clip a temperature to the physical range.

    The range is :data:`chemlab.config.materials.COLDEST_K` to :data:`~chemlab.config.materials.HOTTEST_K`.
    """
    return min(max(kelvin, COLDEST_K), HOTTEST_K)


@helper
def _stir(row: FloatArray, volume_before: float, volume_after: float) -> None:
    if volume_after > 0.0:
        row[CLOCK] = T_MIX + (row[CLOCK] - T_MIX) * min(volume_before / volume_after, 1.0)


@helper
def _mix_temperature(row: FloatArray, capacity_before: float, capacity_added: float, temperature_added: float) -> None:
    both = capacity_before + capacity_added
    if both > 0.0:
        row[TEMPERATURE] = within_range(
            (capacity_before * row[TEMPERATURE] + capacity_added * temperature_added) / both
        )


@helper
def remove_fraction(row: FloatArray, fraction: float, chem: Handle, into: FloatArray) -> None:
    """Move ``fraction`` (0 to 1) of everything in the vessel into an amounts array ``into`` [M] (mol)."""
    chemistry = opened(Chemistry, chem)
    n = chemistry.role.shape[0]
    for i in range(n):
        moved = row[AMOUNTS + i] * fraction
        row[AMOUNTS + i] -= moved
        into[i] += moved
    for i in range(AMOUNTS + n, row.shape[0]):
        row[i] -= row[i] * fraction


@helper
def spill(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Move the excess over the capacity to waste, an equal share of everything."""
    filled = volume(row, chem)
    if filled > row[CAPACITY] * (1.0 + 1e-12):
        remove_fraction(row, 1.0 - row[CAPACITY] / filled, chem, waste)
        events[SPILL] += filled - row[CAPACITY]


@helper
def pour(
    source: FloatArray, target: FloatArray, fraction: float, chem: Handle, waste: FloatArray, events: FloatArray
) -> None:
    """Pour ``fraction`` (0 to 1) of everything in ``source`` into ``target``; the excess spills."""
    before = volume(target, chem)
    there = heat_capacity(target, chem)
    arriving = fraction * heat_capacity(source, chem)
    if fraction <= 0.0 or arriving <= 0.0:
        return
    _mix_temperature(target, there, arriving, source[TEMPERATURE])
    for i in range(AMOUNTS, source.shape[0]):
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
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
) -> None:
    """Add ``mol`` of a pure material at ``temperature`` (K); the excess spills."""
    chemistry = opened(Chemistry, chem)
    if mol <= 0.0:
        return
    before = volume(row, chem)
    _mix_temperature(row, heat_capacity(row, chem), mol * chemistry.heat_capacity[material], temperature)
    row[AMOUNTS + material] += mol
    _stir(row, before, volume(row, chem))
    spill(row, chem, waste, events)


@helper
def pour_out(row: FloatArray, material: int, mol: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Add the volume of ``mol`` of the labelled material from a bottle, at ambient temperature.

    The true contents of the bottle are added.
    """
    chemistry = opened(Chemistry, chem)
    share, rest = chemistry.bottle_share[material], int(chemistry.bottle_rest[material])
    ambient = chemistry.ambient_temperature
    add(row, material, share * mol, ambient, chem, waste, events)
    litres = (1.0 - share) * mol * chemistry.molar_volume[material]
    add(row, rest, litres / chemistry.molar_volume[rest], ambient, chem, waste, events)


@helper
def drain(
    source: FloatArray,
    target: FloatArray,
    pixels: float,
    profile: FloatArray,
    layers: IntArray,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
) -> None:
    """Drain the lowest ``pixels`` of ``source`` into ``target``, exactly as given by the layer profile.

    Args:
        source, target: vessel rows.
        pixels: number of pixels; may be fractional.
        profile: [C, pixels] layer profile of ``source`` (see :mod:`chemlab.physics.stratification`).
        layers: [C + 1] the profile's columns: count, then SOLIDS or a material index each.
        chem: the chemistry.
        waste: [M] mol, receives spilled material.
        events: safety events row.
    """
    air = opened(Chemistry, chem).air
    count, height = layers[0], profile.shape[1]
    whole = int(min(pixels, height))
    before = volume(target, chem)
    there = heat_capacity(target, chem)
    arriving = 0.0
    for c in range(count):
        if layers[1 + c] == air:
            continue
        low, total = 0.0, 0.0
        for p in range(height):
            if p < whole:
                low += profile[c, p]
            elif p == whole:
                low += profile[c, p] * (pixels - whole)
            total += profile[c, p]
        share = min(low / total, 1.0) if total > 0.0 else 0.0
        if share > 0.0:
            arriving += drain_layer(source, target, layers[1 + c], share, chem)
    _mix_temperature(target, there, arriving, source[TEMPERATURE])
    _stir(target, before, volume(target, chem))
    spill(target, chem, waste, events)


@helper
def free_liquid(row: FloatArray, cake_liquid: float, chem: Handle) -> float:
    """Return the liquid in L that passes a filter: all but ``cake_liquid`` litres per litre of retained solids."""
    return max(liquid_volume(row, chem) - cake_liquid * solid_volume(row, chem), 0.0)


@helper
def strain(
    source: FloatArray,
    target: FloatArray,
    litres: float,
    layers: IntArray,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
) -> None:
    """Filter ``litres`` of the liquids of ``source`` into ``target``, the same share of every layer; solids and
    crystals stay.

    Args:
        source, target: vessel rows.
        litres: volume; at most the liquid volume.
        layers: [C + 1] the source's layers (see :func:`chemlab.physics.stratification.profile`).
        chem: the chemistry.
        waste: [M] mol, receives spilled material.
        events: safety events row.
    """
    air, wet = opened(Chemistry, chem).air, liquid_volume(source, chem)
    share = min(litres / wet, 1.0) if wet > 0.0 else 0.0
    if share <= 0.0:
        return
    before = volume(target, chem)
    there = heat_capacity(target, chem)
    arriving = 0.0
    for c in range(layers[0]):
        if layers[1 + c] != air and layers[1 + c] != SOLIDS:
            arriving += drain_layer(source, target, layers[1 + c], share, chem)
    _mix_temperature(target, there, arriving, source[TEMPERATURE])
    _stir(target, before, volume(target, chem))
    spill(target, chem, waste, events)


@helper
def row_has(row: FloatArray, material: int) -> bool:
    """Return True if more than a trace of ``material`` is in the vessel."""
    return bool(row[AMOUNTS + material] > TRACE_MOL)


@helper
def move(source: FloatArray, target: FloatArray) -> None:
    """Move the vessel of one row to another row."""
    for i in range(source.shape[0]):
        target[i] = source[i]
        source[i] = 0.0


@helper
def clear(row: FloatArray) -> None:
    """Remove the vessel of a row."""
    row[:] = 0.0


@helper
def place(row: FloatArray, capacity: float, chem: Handle) -> None:
    """Place a clean, empty vessel."""
    chemistry = opened(Chemistry, chem)
    row[:] = 0.0
    row[TEMPERATURE] = chemistry.ambient_temperature
    row[CAPACITY] = capacity
    row[CLOCK] = T_MIX
    row[CLOCK_WAS] = T_MIX
    row[PRESENT] = 1.0


@helper
def take(row: FloatArray, chem: Handle, material: int, mol: float) -> None:
    """Remove ``mol`` of a liquid from all layers in proportion, at most the available amount."""
    chemistry = opened(Chemistry, chem)
    n, n_solvents = chemistry.role.shape[0], chemistry.solvents.shape[0]
    before = row[AMOUNTS + material]
    left = max(before - mol, 0.0)
    k = chemistry.dissolved_at[material]
    if k >= 0 and before > 0.0:
        first = AMOUNTS + n + k * n_solvents
        for layer in range(n_solvents):
            row[first + layer] *= left / before
    row[AMOUNTS + material] = left


@helper
def turn_clock(row: FloatArray, by: float) -> None:
    """Settle (``by`` > 0) or mix (< 0) the vessel, within [T_MIX, CLOCK_SETTLED]."""
    row[CLOCK] = max(min(row[CLOCK] + by, CLOCK_SETTLED), T_MIX)
