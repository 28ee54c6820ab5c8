"""Density meter: mass per litre of the liquids, all layers together, without solids."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.arrays import FloatArray, Handle
from ...kernels.jit import inner, opened
from ...physics.backends import find_layers, layer_density
from ...physics.chemistry import Chemistry
from ...physics.constants import SOLIDS, TRACE_MOL
from ..bench import Channel
from .instrument import Instrument, Reading, in_numbers

RANGE_KG_L = 3.0


@inner
def _read(reading: Reading, chem: Handle) -> float:
    air, volumes = opened(Chemistry, chem).air, reading.work[0]
    count = find_layers(reading.row, chem, reading.layers, volumes)
    kilograms, litres = 0.0, 0.0
    for c in range(count):
        layer = reading.layers[1 + c]
        if layer != air and layer != SOLIDS:
            litres += volumes[c]
            kilograms += volumes[c] * layer_density(reading.row, layer, chem)
    reading.out[0] = kilograms / (litres * RANGE_KG_L) if litres > TRACE_MOL else 0.0
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 1, "kg/L", 0.0, RANGE_KG_L, "density of the liquids; 0 without any")


def _words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    return in_numbers(values, channel, analytes) if values[0] > 0.0 else "no liquid"


INSTRUMENT = Instrument("density of the liquids", _channel, _read, words=_words)
