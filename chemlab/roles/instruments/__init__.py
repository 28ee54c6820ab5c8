"""Instruments of the characterization bench: each takes a vessel and returns a reading. One file each.

To add a built-in instrument: a file with an ``INSTRUMENT``, and an entry in :data:`INSTRUMENTS`. A user-defined one is
an :class:`~chemlab.roles.instruments.instrument.Instrument` in a file beside the scenario, named there as
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
"""Built-in kinds of instruments; their index is their order."""
