"""UV-Vis spectrometer: absorption at 200 wavelengths."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.spectra import spectrum
from ..bench import Channel
from .instrument import Instrument, Reading


@inner
def _read(reading: Reading, chem: Handle) -> float:
    spectrum(reading.row, chem, reading.out)
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 200, "absorption", 0.0, 1.0, "UV-Vis absorption, 200 to 800 nm")


INSTRUMENT = Instrument("absorption at 200 wavelengths", _channel, _read, picture="curve")
