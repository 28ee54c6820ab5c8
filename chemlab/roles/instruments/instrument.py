"""What an instrument is: what its reading is, how it is taken, how it is spoken of and drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ...config.parts import Part
from ...kernels.arrays import FloatArray, Handle, IntArray, StreamArray
from ...physics.chemistry import Chemistry, ChemistryTable
from ..bench import Channel

__all__ = ["Instrument", "Reading", "in_numbers", "no_analytes", "no_numbers", "shares_in_words"]


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


def shares_in_words(values: FloatArray, channel: Channel, analytes: Sequence[str]) -> str:
    """Mole fractions of analytes in words; the last one is named as the channel's meaning ends."""
    rest = channel.meaning.rsplit(", ", 1)[-1].split(" (")[0]
    parts = [f"{name} {value:.1%}" for name, value in zip([*analytes, rest], values, strict=True) if value >= 5e-4]
    return ", ".join(parts) or "empty"


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
        rest: what the last of its ``bars`` is of; those before are of the analytes.
        needs: what it reads of the chemistry besides the fields of :class:`~chemlab.physics.chemistry.Chemistry`:
            only tiers of physics that have these can have the instrument.
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
