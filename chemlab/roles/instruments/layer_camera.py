"""Layer camera: a picture of the layers, bottom first."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.stratification import camera, profile
from ..bench import CAMERA_PIXELS, Channel
from .instrument import Instrument, Reading


@inner
def _read(reading: Reading, chem: Handle) -> float:
    profile(reading.row, chem, reading.layers, reading.shares, reading.work)
    camera(reading.row, reading.shares, reading.layers, chem, reading.stream, reading.out)
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, CAMERA_PIXELS, "grey", 0.0, 1.0, "layers, bottom first")


INSTRUMENT = Instrument("a picture of the layers", _channel, _read, picture="column")
