"""Melting point apparatus: temperature at which the last crystals melt, lowered by impurities in the melt.

Schroeder and van Laar for an ideal melt (van 't Hoff's depression): 1 / T = 1 / T_m - R / H_fus ln x, with x the mole
fraction of the crystallizing material among all that melts or dissolves in the melt. Of several crystals, the most
abundant one is measured. Salts and metals do not melt with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...kernels.arrays import FloatArray, Handle
from ...kernels.jit import inner, opened
from ...physics.backends.real.heats import crystals
from ...physics.backends.real.real_chemistry import RealChemistry
from ...physics.chemistry import AMOUNTS
from ...physics.constants import GAS_CONSTANT, TRACE_MOL
from ..bench import Channel
from .instrument import Instrument, Reading, in_numbers

COLDEST_K, HOTTEST_K = 173.15, 673.15
"""The lowest value means no reading."""


@inner
def _read(reading: Reading, chem: Handle) -> float:
    chemistry = opened(RealChemistry, chem)
    most, which, total = TRACE_MOL, -1, 0.0
    for k in range(chemistry.dissolved.shape[0]):
        i = chemistry.dissolved[k]
        total += reading.row[AMOUNTS + i]
        solid = crystals(reading.row, chem, k) if chemistry.fusion[i] > 0.0 else 0.0
        if solid > most:
            most, which = solid, i
    reading.out[0] = 0.0
    if which >= 0:
        share = reading.row[AMOUNTS + which] / total
        inverse = 1.0 / chemistry.melting[which] - GAS_CONSTANT / chemistry.fusion[which] * math.log(share)
        reading.out[0] = min(max((1.0 / inverse - COLDEST_K) / (HOTTEST_K - COLDEST_K), 0.0), 1.0)
    return 0.0


def _channel(name: str, analytes: Sequence[str]) -> Channel:
    meaning = f"where the last crystals melt; {COLDEST_K:g} without any"
    return Channel(name, 1, "K", COLDEST_K, HOTTEST_K, meaning)


def _words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    return in_numbers(values, channel, analytes) if values[0] > 0.0 else "nothing that melts"


INSTRUMENT = Instrument(
    "temperature at which the last crystals melt", _channel, _read, words=_words, needs=("fusion", "melting")
)
