"""Liquid chromatograph (HPLC): mole fraction of every molecule, volatile or not, and of all ions together.

Insoluble material (metals, undissolved salts) stays in the filter and is not detected.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...kernels.arrays import Handle, IntArray
from ...kernels.jit import inner, opened
from ...physics.chemistry import AMOUNTS, ROLE_ION, ROLE_SOLUTE, ROLE_SOLVENT, Chemistry
from ...physics.constants import TRACE_MOL
from ..bench import Channel
from .instrument import Instrument, Reading, shares_in_words


@inner
def _read(reading: Reading, chem: Handle) -> float:
    row, out, role = reading.row, reading.out, opened(Chemistry, chem).role
    count, ions = reading.analytes.shape[0], 0.0
    for i in range(role.shape[0]):
        if role[i] == ROLE_ION:
            ions += 0.5 * row[AMOUNTS + i]  # a pair is one salt
    total = ions
    for a in range(count):
        total += row[AMOUNTS + reading.analytes[a]]
    for a in range(count):
        out[a] = row[AMOUNTS + reading.analytes[a]] / total if total > TRACE_MOL else 0.0
    out[count] = ions / total if total > TRACE_MOL else 0.0
    return 0.0


def _analytes(chemistry: Chemistry) -> IntArray:
    return np.flatnonzero((chemistry.role == ROLE_SOLVENT) | (chemistry.role == ROLE_SOLUTE)).astype(np.int64)


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, len(analytes) + 1, "mole fraction", 0.0, 1.0, ", ".join(analytes) + ", ions (two as one)")


INSTRUMENT = Instrument(
    "mole fraction of every molecule, and of ions together",
    _channel,
    _read,
    _analytes,
    shares_in_words,
    "bars",
    rest="ions",
)
