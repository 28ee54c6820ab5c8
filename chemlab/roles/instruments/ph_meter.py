"""pH meter: activity of H+ in the aqueous layer."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...kernels.arrays import FloatArray, Handle
from ...kernels.jit import inner
from ...physics.backends.real.acids import ph
from ..bench import Channel
from .instrument import Instrument, Reading, in_numbers

LOWEST, HIGHEST = -2.0, 16.0
"""Range beyond that of a glass electrode; the lowest value means no reading."""


@inner
def _read(reading: Reading, chem: Handle) -> float:
    value = ph(reading.row, chem)
    reading.out[0] = 0.0 if math.isnan(value) else (value - LOWEST) / (HIGHEST - LOWEST)
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    meaning = f"pH of the aqueous layer; {LOWEST:g} without one"
    return Channel(name, 1, "pH", LOWEST, HIGHEST, meaning)


def _words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    return in_numbers(values, channel, analytes) if values[0] > 0.0 else "no pH: nothing aqueous"


INSTRUMENT = Instrument("pH of the aqueous layer", _channel, _read, words=_words, needs=("acid", "ionization"))
