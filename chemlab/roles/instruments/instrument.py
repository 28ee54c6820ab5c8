"""Interface of an instrument: reading, measurement, description, and picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ...config.parts import Part
from ...kernels.arrays import FloatArray, Handle, IntArray, StreamArray
from ...physics.chemistry import Chemistry, ChemistryTable
from ..bench import Channel


class Reading(NamedTuple):
    """Objects of a measurement in one laboratory."""

    row: FloatArray
    """[W] the vessel"""
    analytes: IntArray
    """[A] indices of the distinguished materials"""
    stream: StreamArray
    """random stream"""
    layers: IntArray
    """[C + 1], ``shares`` [C, pixels] and ``work``: scratch of the layer profile"""
    shares: FloatArray
    work: FloatArray
    numbers: FloatArray
    """result of :attr:`Instrument.numbers`"""
    out: FloatArray
    """[size] the reading to write: values in [0, 1]"""


def no_analytes(chemistry: Chemistry) -> IntArray:
    """Return an empty array, for instruments that do not distinguish materials."""
    return np.zeros(0, dtype=np.int64)


def no_numbers(chemistry: ChemistryTable) -> FloatArray:
    """Return an empty array, for instruments that need no values of the materials."""
    return np.zeros(0)


def in_numbers(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """Describe a reading: one number with its unit, or the number of values."""
    if channel.size == 1:
        return f"{channel.low + values[0] * (channel.high - channel.low):.3f} {channel.unit}"
    return f"{channel.size} values of {channel.unit}"


def shares_in_words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """Describe mole fractions of analytes; the last one is named after the end of the channel's meaning."""
    rest = channel.meaning.rsplit(", ", 1)[-1].split(" (")[0]
    parts = [f"{name} {value:.1%}" for name, value in zip([*analytes, rest], values, strict=True) if value >= 5e-4]
    return ", ".join(parts) or "empty"


@dataclass(frozen=True)
class Instrument(Part):
    """A kind of instrument.

    Attributes:
        summary: the measured quantity.
        channel: channel of its reading, given the instrument's name in the scenario and the analytes' names.
        read: ``read(reading, chem)``, a kernel or a function: writes ``reading.out``. The caller adds noise and takes
            the sample.
        analytes: indices of the distinguished materials.
        words: description of the reading.
        numbers: values that it needs of the materials by name (``chemistry.layout.materials``), computed once per
            scenario: ``reading.numbers``.
        picture: representation in pictures: a ``number``, a ``curve``, a ``column`` of grey values, or ``bars``.
        rest: meaning of the last of its ``bars``; the others are the analytes.
        needs: fields of the chemistry that it reads besides those of :class:`~chemlab.physics.chemistry.Chemistry`;
            only physics backends with these fields support the instrument.
    """

    summary: str
    channel: Callable[[str, Sequence[str]], Channel]
    read: Callable[[Reading, Handle], float]
    analytes: Callable[[Chemistry], IntArray] = no_analytes
    words: Callable[[FloatArray, Channel, Sequence[str]], str] = in_numbers
    picture: Literal["number", "curve", "column", "bars"] = "number"
    numbers: Callable[[ChemistryTable], FloatArray] = no_numbers
    rest: str = "residue"
    needs: tuple[str, ...] = ()
