"""Balance: mass of the contents."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.arrays import Handle
from ...kernels.jit import inner, opened
from ...physics.chemistry import AMOUNTS, Chemistry
from ..bench import Channel
from .instrument import Instrument, Reading

RANGE_KG = 2.0


@inner
def _read(reading: Reading, chem: Handle) -> float:
    molar_mass = opened(Chemistry, chem).molar_mass
    grams = 0.0
    for i in range(molar_mass.shape[0]):
        grams += reading.row[AMOUNTS + i] * molar_mass[i]
    reading.out[0] = grams / (1000.0 * RANGE_KG)
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 1, "kg", 0.0, RANGE_KG, "mass of the contents")


INSTRUMENT = Instrument("mass of the contents", _channel, _read)
