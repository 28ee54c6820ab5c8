"""The characterization bench: a vessel goes in, a reading comes out, at a price and sometimes of a little sample."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..materials import DataError
from ..physics.jit import kernel
from ..physics.layers import camera, profile, uniform
from ..physics.spectra import spectrum
from ..physics.transfer import TRACE_MOL, remove_fraction
from ..scenario import Scenario
from ..shelf import AMOUNTS, ROLE_ION, Chemistry, FloatArray, IntArray, Layout, StreamArray
from .base import CAMERA_PIXELS, Channel

__all__ = ["INSTRUMENT_KINDS", "InstrumentKind", "InstrumentTable", "read_instrument"]

UV_VIS, LAYER_CAMERA, BALANCE, GAS_CHROMATOGRAPH = range(4)

_TAKEN = frozenset({"occupied", "fill", "temperature", "capacity", "last_bench", "last_role"})

BALANCE_RANGE_KG = 2.0
HOTTEST_COLUMN_K = 750.0
"""What boils above this does not pass the chromatograph's column; it counts as residue."""


class InstrumentTable:
    """The scenario's instruments as arrays; I instruments, R numbers of all readings together.

    Attributes:
        names: instrument names in the scenario's order.
        channels: what each reading is.
        kind: [I], start: [I + 1] where each reading begins, price: [I], sample: [I], noise: [I].
        analytes: [A] material indices the chromatograph tells apart.
    """

    def __init__(self, scenario: Scenario, layout: Layout, chemistry: Chemistry) -> None:
        self.names = tuple(scenario.instruments)
        specs = list(scenario.instruments.values())
        self.analytes: IntArray = np.flatnonzero(
            np.isin(np.arange(len(layout.materials)), chemistry.volatile) & (chemistry.boiling_point < HOTTEST_COLUMN_K)
        ).astype(np.int64)
        channels = []
        for name, spec in scenario.instruments.items():
            if name in _TAKEN or not re.fullmatch("[a-z][a-z0-9_]*", name):
                raise DataError(
                    f"{scenario.origin}: instruments.{name}: must be lower-case letters, digits and _, and none of "
                    f"{', '.join(sorted(_TAKEN))}, which name what the manager sees of a vessel anyway"
                )
            if spec.kind not in INSTRUMENT_KINDS:
                raise DataError(
                    f"{scenario.origin}: instruments.{name}.kind: unknown kind {spec.kind!r}; "
                    f"known: {', '.join(INSTRUMENT_KINDS)}"
                )
            channels.append(INSTRUMENT_KINDS[spec.kind].channel(name, [layout.materials[i] for i in self.analytes]))
        self.channels = tuple(channels)
        self.kind: IntArray = np.array([list(INSTRUMENT_KINDS).index(spec.kind) for spec in specs], dtype=np.int64)
        self.start: IntArray = np.cumsum([0, *(channel.size for channel in channels)])
        self.price: FloatArray = np.array([spec.price for spec in specs], dtype=np.float64)
        self.sample: FloatArray = np.array([spec.sample_fraction for spec in specs], dtype=np.float64)
        self.noise: FloatArray = np.array([spec.noise for spec in specs], dtype=np.float64)


@dataclass(frozen=True)
class InstrumentKind:
    """A kind of instrument: what its reading is."""

    summary: str
    channel: Callable[[str, list[str]], Channel]


INSTRUMENT_KINDS: dict[str, InstrumentKind] = {
    "uv_vis": InstrumentKind(
        "absorption at 200 wavelengths",
        lambda name, analytes: Channel(name, 200, "absorption", 0.0, 1.0, "UV-Vis absorption, 200 to 800 nm"),
    ),
    "layer_camera": InstrumentKind(
        "a picture of the layers",
        lambda name, analytes: Channel(name, CAMERA_PIXELS, "grey", 0.0, 1.0, "layers, bottom first"),
    ),
    "balance": InstrumentKind(
        "mass of the contents",
        lambda name, analytes: Channel(name, 1, "kg", 0.0, BALANCE_RANGE_KG, "mass of the contents"),
    ),
    "gas_chromatograph": InstrumentKind(
        "mole fraction of every volatile material, and of the residue",
        lambda name, analytes: Channel(
            name, len(analytes) + 1, "mole fraction", 0.0, 1.0, ", ".join(analytes) + ", residue (does not evaporate)"
        ),
    ),
}
"""Every kind of instrument, in the order of the kind numbers."""


@kernel
def _normal(stream: StreamArray) -> float:
    """A standard normal number (Box-Muller) of the stream."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream)))
    return radius * math.cos(2.0 * math.pi * uniform(stream))


@kernel
def read_instrument(
    kind: int,
    row: FloatArray,
    sample: float,
    noise: float,
    analytes: IntArray,
    molar_mass: FloatArray,
    chem: Chemistry,
    stream: StreamArray,
    waste: FloatArray,
    layers: IntArray,
    shares: FloatArray,
    work: FloatArray,
    out: FloatArray,
) -> None:
    """Read one instrument on one vessel.

    Args:
        kind: number of the instrument kind.
        row: vessel row; ``sample`` of its contents goes to ``waste`` [M].
        noise: standard deviation of what is added to every value.
        analytes: [A] materials the chromatograph tells apart.
        molar_mass: [M] g/mol.
        chem: material constants.
        stream: random stream.
        layers, shares, work: scratch of the layer profile.
        out: [size of the reading] values in [0, 1].
    """
    if kind == UV_VIS:
        spectrum(row, chem, out)
    elif kind == LAYER_CAMERA:
        profile(row, chem, layers, shares, work)
        camera(row, shares, layers, chem, stream, out)
    elif kind == BALANCE:
        grams = 0.0
        for i in range(molar_mass.shape[0]):
            grams += row[AMOUNTS + i] * molar_mass[i]
        out[0] = grams / (1000.0 * BALANCE_RANGE_KG)
    else:
        total, volatile = 0.0, 0.0
        for i in range(chem.role.shape[0]):
            # With the weighed sample and an internal standard the residue is known though it never leaves the column.
            total += row[AMOUNTS + i] * (0.5 if chem.role[i] == ROLE_ION else 1.0)
        for a in range(analytes.shape[0]):
            out[a] = row[AMOUNTS + analytes[a]] / total if total > TRACE_MOL else 0.0
            volatile += out[a]
        out[analytes.shape[0]] = 1.0 - volatile if total > TRACE_MOL else 0.0
    for i in range(out.shape[0]):
        value = out[i] + (noise * _normal(stream) if noise > 0.0 else 0.0)
        out[i] = min(max(value, 0.0), 1.0)
    if sample > 0.0:
        remove_fraction(row, sample, chem, waste)
