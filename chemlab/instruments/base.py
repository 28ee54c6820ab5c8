"""What an instrument is: what its reading is, how it is taken, how it is spoken of and drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..arrays import FloatArray, Handle, IntArray, StreamArray
from ..bench.base import Channel
from ..chemistry import Chemistry, ChemistryTable
from ..parts import Part

__all__ = ["Instrument", "Reading", "in_numbers", "no_analytes", "no_numbers"]


class Reading(NamedTuple):
    """What an instrument works on in one laboratory."""

    row: FloatArray
    """[W] the vessel"""
    analytes: IntArray
    """[A] material indices that the instrument tells apart"""
    stream: StreamArray
    """random stream"""
    layers: IntArray
    """[C + 1], ``shares`` [C, pixels] and ``work``: scratch of the layer profile"""
    shares: FloatArray
    work: FloatArray
    numbers: FloatArray
    """what :attr:`Instrument.numbers` has made of the chemistry"""
    out: FloatArray
    """[size] the reading, to be written: values in [0, 1]"""


def no_analytes(chemistry: Chemistry) -> IntArray:
    """For instruments that do not tell materials apart."""
    return np.zeros(0, dtype=np.int64)


def no_numbers(chemistry: ChemistryTable) -> FloatArray:
    """For instruments that need nothing of the materials."""
    return np.zeros(0)


def in_numbers(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """A reading in words: one number with its unit, or how many there are."""
    if channel.size == 1:
        return f"{channel.low + values[0] * (channel.high - channel.low):.3f} {channel.unit}"
    return f"{channel.size} values of {channel.unit}"


@dataclass(frozen=True)
class Instrument(Part):
    """A kind of instrument.

    Attributes:
        summary: what it measures.
        channel: what its reading is, given the instrument's name in the scenario and the analytes' names.
        read: ``read(reading, chem)``, a kernel or a function: writes ``reading.out``. Noise is added and the sample
            taken by whoever calls it.
        analytes: material indices that it tells apart.
        words: the reading in words.
        numbers: what it needs to know of the materials by their names (``chemistry.layout.materials``), worked out
            once for a scenario: ``reading.numbers``.
        picture: how it is drawn: as a ``number``, a ``curve``, a ``column`` of grey values, or ``bars``.
    """

    summary: str
    channel: Callable[[str, Sequence[str]], Channel]
    read: Callable[[Reading, Handle], float]
    analytes: Callable[[Chemistry], IntArray] = no_analytes
    words: Callable[[FloatArray, Channel, Sequence[str]], str] = in_numbers
    picture: Literal["number", "curve", "column", "bars"] = "number"
    numbers: Callable[[ChemistryTable], FloatArray] = no_numbers
