"""Gas chromatograph: mole fraction of every volatile material, and of the residue."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...kernels.arrays import Handle, IntArray
from ...kernels.jit import inner, opened
from ...physics.chemistry import AMOUNTS, ROLE_ION, Chemistry
from ...physics.constants import TRACE_MOL
from ..bench import Channel
from .instrument import Instrument, Reading, shares_in_words

HOTTEST_COLUMN_K = 750.0
"""Boiling point in K above which a material does not pass the column and counts as residue."""


@inner
def _read(reading: Reading, chem: Handle) -> float:
    row, out, role = reading.row, reading.out, opened(Chemistry, chem).role
    total, volatile = 0.0, 0.0
    for i in range(role.shape[0]):
        # The weighed sample and an internal standard determine the residue, which does not leave the column.
        total += row[AMOUNTS + i] * (0.5 if role[i] == ROLE_ION else 1.0)
    count = reading.analytes.shape[0]
    for a in range(count):
        out[a] = row[AMOUNTS + reading.analytes[a]] / total if total > TRACE_MOL else 0.0
        volatile += out[a]
    out[count] = 1.0 - volatile if total > TRACE_MOL else 0.0
    return 0.0


def _analytes(chemistry: Chemistry) -> IntArray:
    liquid = np.isin(np.arange(len(chemistry.role)), chemistry.volatile)
    return np.flatnonzero(liquid & (chemistry.boiling_point < HOTTEST_COLUMN_K)).astype(np.int64)


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    meaning = ", ".join(analytes) + ", residue (does not evaporate)"
    return Channel(name, len(analytes) + 1, "mole fraction", 0.0, 1.0, meaning)


INSTRUMENT = Instrument(
    "mole fraction of every volatile material, and of the residue", _channel, _read, _analytes, shares_in_words, "bars"
)
