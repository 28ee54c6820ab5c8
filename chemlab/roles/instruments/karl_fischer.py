"""Karl Fischer titration: mass fraction of water."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...config.reactions import WATER
from ...kernels.arrays import FloatArray, Handle
from ...kernels.jit import inner, opened
from ...physics.chemistry import AMOUNTS, Chemistry, ChemistryTable
from ..bench import Channel
from .instrument import Instrument, Reading


@inner
def _read(reading: Reading, chem: Handle) -> float:
    molar_mass = opened(Chemistry, chem).molar_mass
    grams, water = 0.0, 0.0
    for i in range(molar_mass.shape[0]):
        mass = reading.row[AMOUNTS + i] * molar_mass[i]
        grams += mass
        water += mass * reading.numbers[i]
    reading.out[0] = water / grams if grams > 0.0 else 0.0
    return 0.0


def _numbers(chemistry: ChemistryTable) -> FloatArray:
    """Return [M] 1 for water, 0 for all other materials."""
    return np.array([float(name == WATER) for name in chemistry.layout.materials])


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 1, "mass fraction", 0.0, 1.0, "water, of the mass of the contents")


def _words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    return f"{values[0]:.3%} water by mass"


INSTRUMENT = Instrument("mass fraction of water", _channel, _read, words=_words, numbers=_numbers)
