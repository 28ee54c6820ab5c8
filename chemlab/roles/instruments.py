"""Instruments of the characterization bench: each takes a vessel and returns a reading.

To add a built-in instrument: its functions and an entry in :data:`INSTRUMENTS`. A user-defined one is an
:class:`Instrument` in a file beside the scenario, named there as ``kind = "my_parts.py:NAME"``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from ..config.parts import Part
from ..config.reactions import WATER
from ..kernels.arrays import FloatArray, Handle, IntArray, StreamArray
from ..kernels.jit import inner, opened
from ..physics.backends import find_layers, layer_density
from ..physics.backends.real.acids import ph
from ..physics.backends.real.heats import crystals
from ..physics.backends.real.real_chemistry import RealChemistry
from ..physics.chemistry import AMOUNTS, ROLE_ION, ROLE_SOLUTE, ROLE_SOLVENT, TEMPERATURE, Chemistry, ChemistryTable
from ..physics.constants import GAS_CONSTANT, SOLIDS, TRACE_MOL
from ..physics.spectra import spectrum
from ..physics.stratification import camera, profile
from .bench import CAMERA_PIXELS, Channel

BALANCE_KG = 2.0
"""Range of the balance."""
_COLDEST_K, _HOTTEST_K = 173.15, 773.15
"""Range of the thermometer: -100 to 500 degrees Celsius, as of a resistance thermometer."""
_HOTTEST_MELT_K = 673.15
"""End of the range of the melting point apparatus, which begins at ``_COLDEST_K``; there it means no reading."""
_LOWEST_PH, _HIGHEST_PH = -2.0, 16.0
"""Range beyond that of a glass electrode; the lowest value means no reading."""
_DENSEST_KG_L = 3.0
"""Range of the density meter."""
_HOTTEST_COLUMN_K = 750.0
"""Boiling point in K above which a material does not pass the gas chromatograph's column and counts as residue."""


class Reading(NamedTuple):
    """Objects of a measurement in one laboratory."""

    row: FloatArray
    """[W] the vessel"""
    analytes: IntArray
    """[A] indices of the distinguished materials"""
    stream: StreamArray
    """random stream"""
    layers: IntArray
    """[C + 1], ``shares`` [C, pixels] and ``work``: scratch of the layer profile"""
    shares: FloatArray
    work: FloatArray
    numbers: FloatArray
    """result of :attr:`Instrument.numbers`"""
    out: FloatArray
    """[size] the reading to write: values in [0, 1]"""


def no_analytes(chemistry: Chemistry) -> IntArray:
    """Return an empty array, for instruments that do not distinguish materials."""
    return np.zeros(0, dtype=np.int64)


def no_numbers(chemistry: ChemistryTable) -> FloatArray:
    """Return an empty array, for instruments that need no values of the materials."""
    return np.zeros(0)


def in_numbers(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """Describe a reading: one number with its unit, or the number of values."""
    if channel.size == 1:
        return f"{channel.unscaled(values[0]):.3f} {channel.unit}"
    return f"{channel.size} values of {channel.unit}"


def shares_in_words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """Describe mole fractions of analytes; the last one is named after the end of the channel's meaning."""
    rest = channel.meaning.rsplit(", ", 1)[-1].split(" (")[0]
    parts = [f"{name} {value:.1%}" for name, value in zip([*analytes, rest], values, strict=True) if value >= 5e-4]
    return ", ".join(parts) or "empty"


@dataclass(frozen=True)
class Instrument(Part):
    """A kind of instrument.

    Attributes:
        summary: the measured quantity.
        channel: channel of its reading, given the instrument's name in the scenario and the analytes' names.
        read: ``read(reading, chem)``, a kernel or a function: writes ``reading.out``. The caller adds noise and takes
            the sample.
        analytes: indices of the distinguished materials.
        words: description of the reading.
        numbers: values that it needs of the materials by name (``chemistry.layout.materials``), computed once per
            scenario: ``reading.numbers``.
        picture: representation in pictures: a ``number``, a ``curve``, a ``column`` of grey values, or ``bars``.
        rest: meaning of the last of its ``bars``; the others are the analytes.
        needs: fields of the chemistry that it reads besides those of :class:`~chemlab.physics.chemistry.Chemistry`;
            only physics backends with these fields support the instrument.
    """

    summary: str
    channel: Callable[[str, Sequence[str]], Channel]
    read: Callable[[Reading, Handle], float]
    analytes: Callable[[Chemistry], IntArray] = no_analytes
    words: Callable[[FloatArray, Channel, Sequence[str]], str] = in_numbers
    picture: Literal["number", "curve", "column", "bars"] = "number"
    numbers: Callable[[ChemistryTable], FloatArray] = no_numbers
    rest: str = "residue"
    needs: tuple[str, ...] = ()


def _channel(unit: str, low: float, high: float, meaning: str, name: str, analytes: Sequence[str]) -> Channel:
    """Return the channel of a single number."""
    return Channel(name, 1, unit, low, high, meaning)


def _shares_channel(rest: str, name: str, analytes: Sequence[str]) -> Channel:
    """Return the channel of the mole fractions of the analytes and of ``rest``."""
    return Channel(name, len(analytes) + 1, "mole fraction", 0.0, 1.0, ", ".join([*analytes, rest]))


def _or_none(none: str, values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """Describe a number; the lowest one means that there is none."""
    return in_numbers(values, channel, analytes) if values[0] > 0.0 else none


@inner
def _read_spectrum(reading: Reading, chem: Handle) -> float:
    """Measure the absorption at 200 wavelengths."""
    spectrum(reading.row, chem, reading.out)
    return 0.0


def _spectrum_channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 200, "absorption", 0.0, 1.0, "UV-Vis absorption, 200 to 800 nm")


@inner
def _read_layers(reading: Reading, chem: Handle) -> float:
    """Take a picture of the layers, bottom first."""
    profile(reading.row, chem, reading.layers, reading.shares, reading.work)
    camera(reading.row, reading.shares, reading.layers, chem, reading.stream, reading.out)
    return 0.0


def _layers_channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, CAMERA_PIXELS, "grey", 0.0, 1.0, "layers, bottom first")


@inner
def _read_mass(reading: Reading, chem: Handle) -> float:
    """Weigh the contents."""
    molar_mass = opened(Chemistry, chem).molar_mass
    grams = 0.0
    for i in range(molar_mass.shape[0]):
        grams += reading.row[AMOUNTS + i] * molar_mass[i]
    reading.out[0] = grams / (1000.0 * BALANCE_KG)
    return 0.0


@inner
def _read_volatile(reading: Reading, chem: Handle) -> float:
    """Measure the mole fraction of every volatile material, and of the residue."""
    row, out, role = reading.row, reading.out, opened(Chemistry, chem).role
    total, volatile = 0.0, 0.0
    for i in range(role.shape[0]):
        # The weighed sample and an internal standard determine the residue, which does not leave the column.
        total += row[AMOUNTS + i] * (0.5 if role[i] == ROLE_ION else 1.0)
    count = reading.analytes.shape[0]
    for a in range(count):
        out[a] = row[AMOUNTS + reading.analytes[a]] / total if total > TRACE_MOL else 0.0
        volatile += out[a]
    out[count] = 1.0 - volatile if total > TRACE_MOL else 0.0
    return 0.0


def _volatile(chemistry: Chemistry) -> IntArray:
    liquid = np.isin(np.arange(len(chemistry.role)), chemistry.volatile)
    return np.flatnonzero(liquid & (chemistry.boiling_point < _HOTTEST_COLUMN_K)).astype(np.int64)


@inner
def _read_temperature(reading: Reading, chem: Handle) -> float:
    """Measure the temperature of the contents."""
    reading.out[0] = (reading.row[TEMPERATURE] - _COLDEST_K) / (_HOTTEST_K - _COLDEST_K)
    return 0.0


@inner
def _read_ph(reading: Reading, chem: Handle) -> float:
    """Measure the activity of H+ in the aqueous layer."""
    value = ph(reading.row, chem)
    reading.out[0] = 0.0 if math.isnan(value) else (value - _LOWEST_PH) / (_HIGHEST_PH - _LOWEST_PH)
    return 0.0


@inner
def _read_density(reading: Reading, chem: Handle) -> float:
    """Measure the mass per litre of the liquids, all layers together, without solids."""
    air, volumes = opened(Chemistry, chem).air, reading.work[0]
    count = find_layers(reading.row, chem, reading.layers, volumes)
    kilograms, litres = 0.0, 0.0
    for c in range(count):
        layer = reading.layers[1 + c]
        if layer != air and layer != SOLIDS:
            litres += volumes[c]
            kilograms += volumes[c] * layer_density(reading.row, layer, chem)
    reading.out[0] = kilograms / (litres * _DENSEST_KG_L) if litres > TRACE_MOL else 0.0
    return 0.0


@inner
def _read_water(reading: Reading, chem: Handle) -> float:
    """Measure the mass fraction of water."""
    molar_mass = opened(Chemistry, chem).molar_mass
    grams, water = 0.0, 0.0
    for i in range(molar_mass.shape[0]):
        mass = reading.row[AMOUNTS + i] * molar_mass[i]
        grams += mass
        water += mass * reading.numbers[i]
    reading.out[0] = water / grams if grams > 0.0 else 0.0
    return 0.0


def _is_water(chemistry: ChemistryTable) -> FloatArray:
    """Return [M] 1 for water, 0 for all other materials."""
    return np.array([float(name == WATER) for name in chemistry.layout.materials])


def _water_words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    return f"{values[0]:.3%} water by mass"


@inner
def _read_melting(reading: Reading, chem: Handle) -> float:
    """Measure the temperature at which the last crystals melt, lowered by impurities in the melt.

    Schroeder and van Laar for an ideal melt (van 't Hoff's depression): 1 / T = 1 / T_m - R / H_fus ln x, with x the
    mole fraction of the crystallizing material among all that melts or dissolves in the melt. Of several crystals, the
    most abundant one is measured. Salts and metals do not melt with it.
    """
    chemistry = opened(RealChemistry, chem)
    most, which, total = TRACE_MOL, -1, 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        total += reading.row[AMOUNTS + i]
        solid = crystals(reading.row, chem, k) if chemistry.fusion[i] > 0.0 else 0.0
        if solid > most:
            most, which = solid, i
    reading.out[0] = 0.0
    if which >= 0:
        share = reading.row[AMOUNTS + which] / total
        inverse = 1.0 / chemistry.melting[which] - GAS_CONSTANT / chemistry.fusion[which] * math.log(share)
        reading.out[0] = min(max((1.0 / inverse - _COLDEST_K) / (_HOTTEST_MELT_K - _COLDEST_K), 0.0), 1.0)
    return 0.0


@inner
def _read_molecules(reading: Reading, chem: Handle) -> float:
    """Measure the mole fraction of every molecule, volatile or not, and of all ions together.

    Insoluble material (metals, undissolved salts) stays in the filter and is not detected.
    """
    row, out, role = reading.row, reading.out, opened(Chemistry, chem).role
    count, ions = reading.analytes.shape[0], 0.0
    for i in range(role.shape[0]):
        if role[i] == ROLE_ION:
            ions += 0.5 * row[AMOUNTS + i]  # a pair is one salt
    total = ions
    for a in range(count):
        total += row[AMOUNTS + reading.analytes[a]]
    for a in range(count):
        out[a] = row[AMOUNTS + reading.analytes[a]] / total if total > TRACE_MOL else 0.0
    out[count] = ions / total if total > TRACE_MOL else 0.0
    return 0.0


def _molecules(chemistry: Chemistry) -> IntArray:
    return np.flatnonzero((chemistry.role == ROLE_SOLVENT) | (chemistry.role == ROLE_SOLUTE)).astype(np.int64)


_PH = f"pH of the aqueous layer; {_LOWEST_PH:g} without one"
_MELTING = f"where the last crystals melt; {_COLDEST_K:g} without any"

INSTRUMENTS: dict[str, Instrument] = {
    "uv_vis": Instrument("absorption at 200 wavelengths", _spectrum_channel, _read_spectrum, picture="curve"),
    "layer_camera": Instrument("a picture of the layers", _layers_channel, _read_layers, picture="column"),
    "balance": Instrument(
        "mass of the contents", partial(_channel, "kg", 0.0, BALANCE_KG, "mass of the contents"), _read_mass
    ),
    "gas_chromatograph": Instrument(
        "mole fraction of every volatile material, and of the residue",
        partial(_shares_channel, "residue (does not evaporate)"),
        _read_volatile,
        _volatile,
        shares_in_words,
        "bars",
    ),
    "thermometer": Instrument(
        "temperature of the contents",
        partial(_channel, "K", _COLDEST_K, _HOTTEST_K, "temperature of the contents"),
        _read_temperature,
    ),
    "ph_meter": Instrument(
        "pH of the aqueous layer",
        partial(_channel, "pH", _LOWEST_PH, _HIGHEST_PH, _PH),
        _read_ph,
        words=partial(_or_none, f"no pH: nothing aqueous, or below {_LOWEST_PH:g}"),
        needs=("acid", "ionization"),
    ),
    "density_meter": Instrument(
        "density of the liquids",
        partial(_channel, "kg/L", 0.0, _DENSEST_KG_L, "density of the liquids; 0 without any"),
        _read_density,
        words=partial(_or_none, "no liquid"),
    ),
    "karl_fischer": Instrument(
        "mass fraction of water",
        partial(_channel, "mass fraction", 0.0, 1.0, "water, of the mass of the contents"),
        _read_water,
        words=_water_words,
        numbers=_is_water,
    ),
    "melting_point": Instrument(
        "temperature at which the last crystals melt",
        partial(_channel, "K", _COLDEST_K, _HOTTEST_MELT_K, _MELTING),
        _read_melting,
        words=partial(_or_none, "nothing that melts"),
        needs=("fusion", "melting"),
    ),
    "hplc": Instrument(
        "mole fraction of every molecule, and of ions together",
        partial(_shares_channel, "ions (two as one)"),
        _read_molecules,
        _molecules,
        shares_in_words,
        "bars",
        rest="ions",
    ),
}
"""Built-in kinds of instruments; their index is their order."""
