"""What an operation is: what it does to vessels, when it is possible, and how it is spoken of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...config.parts import Part
from ...kernels.arrays import FloatArray, Handle, IntArray
from ...kernels.jit import helper
from ...physics.transfer import volume

if TYPE_CHECKING:
    from ..bench import Bench

__all__ = ["Operation", "Turn", "always", "no_numbers", "not_empty"]


class Turn(NamedTuple):
    """What an operation works on in one laboratory."""

    row: FloatArray
    """[W] the vessel"""
    target: FloatArray
    """[W] the vessel that receives; the vessel itself where none does"""
    magnitude: float
    material: int
    """index of the material, -1 if the operation takes none"""
    stock: FloatArray
    """[M] mol in the bottles"""
    waste: FloatArray
    """[M] mol in the waste can"""
    events: FloatArray
    """[E] safety events, to be added to"""
    layers: IntArray
    """[C + 1] the vessel's layers, and ``profile`` [C, pixels] their shares of each pixel (see
    :func:`chemlab.physics.layers.profile`)"""
    profile: FloatArray
    limits: FloatArray
    """[5] of the apparatus: see :func:`chemlab.physics.backends.heat`; then the litres of liquid that a litre of solids
    keeps in a filter"""
    goal: int
    """index of the material that the experiment is for"""
    numbers: FloatArray
    """what :attr:`Operation.numbers` has made of the scenario"""


def no_numbers(bench: Bench) -> FloatArray:
    """For operations that need nothing of the scenario."""
    return np.zeros(0)


@dataclass(frozen=True)
class Operation(Part):
    """A kind of process that a bench's action table may have.

    Attributes:
        unit: of the magnitude.
        words: how an action begins in words, with ``{vessel}``, ``{target}`` and ``{material}``.
        act: ``act(turn, chem) -> float``: carries it out, a kernel or a function; returns how far all the bench's
            vessels settle meanwhile.
        legal: ``legal(turn, chem) -> bool``: whether it is possible; magnitudes make no difference.
        takes: of ``target`` and ``material``, what it needs.
        top: largest magnitude.
        negative: in words how it begins where the magnitude is below 0; None: it must be above.
        touches: whether it changes the vessels it works on (apart from settling).
        numbers: what it needs of the scenario, worked out once for a bench: ``turn.numbers``. Of a safety event of
            its own, say, ``bench.scenario.safety_events.index(NAME)``, where ``turn.events`` counts it.
    """

    unit: str
    words: str
    act: Callable[[Turn, Handle], float]
    legal: Callable[[Turn, Handle], bool]
    takes: frozenset[str] = field(default=frozenset())
    top: float = 1e4
    negative: str | None = None
    touches: bool = True
    numbers: Callable[[Bench], FloatArray] = no_numbers


@helper
def always(turn: Turn, chem: Handle) -> bool:
    """Possible at any time."""
    return True


@helper
def not_empty(turn: Turn, chem: Handle) -> bool:
    """Possible where the vessel holds something."""
    return bool(volume(turn.row, chem) > 0.0)
