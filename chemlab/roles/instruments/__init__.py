"""Instruments of the characterization bench: a vessel goes in, a reading comes out. One file each.

To add one of chemlab's: a file with an ``INSTRUMENT``, and an entry in :data:`INSTRUMENTS`. One of your own is an
:class:`~chemlab.roles.instruments.instrument.Instrument` in a file beside your scenario, named there as
``kind = "my_parts.py:NAME"``.
"""

from . import (
    balance,
    density_meter,
    gas_chromatograph,
    hplc,
    karl_fischer,
    layer_camera,
    melting_point,
    ph_meter,
    thermometer,
    uv_vis,
)
from .instrument import Instrument, Reading

__all__ = ["INSTRUMENTS", "Instrument", "Reading"]

INSTRUMENTS: dict[str, Instrument] = {
    "uv_vis": uv_vis.INSTRUMENT,
    "layer_camera": layer_camera.INSTRUMENT,
    "balance": balance.INSTRUMENT,
    "gas_chromatograph": gas_chromatograph.INSTRUMENT,
    "thermometer": thermometer.INSTRUMENT,
    "ph_meter": ph_meter.INSTRUMENT,
    "density_meter": density_meter.INSTRUMENT,
    "karl_fischer": karl_fischer.INSTRUMENT,
    "melting_point": melting_point.INSTRUMENT,
    "hplc": hplc.INSTRUMENT,
}
"""Kinds of instrument that a scenario may name in short; their order numbers them."""
