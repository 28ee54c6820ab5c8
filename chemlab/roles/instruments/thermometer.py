"""Thermometer: temperature of the contents."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.chemistry import TEMPERATURE
from ..bench import Channel
from .instrument import Instrument, Reading

COLDEST_K, HOTTEST_K = 173.15, 773.15
"""-100 to 500 degrees Celsius, as of a resistance thermometer."""


@inner
def _read(reading: Reading, chem: Handle) -> float:
    reading.out[0] = (reading.row[TEMPERATURE] - COLDEST_K) / (HOTTEST_K - COLDEST_K)
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 1, "K", COLDEST_K, HOTTEST_K, "temperature of the contents")


INSTRUMENT = Instrument("temperature of the contents", _channel, _read)
