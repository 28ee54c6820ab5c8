"""Interface of an operation: effect, legality, and description."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...config.parts import Part
from ...kernels.arrays import FloatArray, Handle, IntArray
from ...kernels.jit import inner
from ...physics.transfer import volume

if TYPE_CHECKING:
    from ..bench import Bench


class Turn(NamedTuple):
    """Objects of an operation in one laboratory."""

    row: FloatArray
    """[W] the vessel"""
    target: FloatArray
    """[W] the receiving vessel; the vessel itself if there is none"""
    magnitude: float
    material: int
    """index of the material, -1 if the operation needs none"""
    stock: FloatArray
    """[M] mol in the bottles"""
    waste: FloatArray
    """[M] mol in the waste can"""
    events: FloatArray
    """[E] safety events, to which an operation adds"""
    layers: IntArray
    """[C + 1] the vessel's layers; ``profile`` [C, pixels] has their shares of each pixel (see
    :func:`chemlab.physics.stratification.profile`)
    """
    profile: FloatArray
    limits: FloatArray
    """[5] limits of the apparatus: see :func:`chemlab.physics.backends.heat`; then litres of liquid retained per litre
    of solids in a filter
    """
    goal: int
    """index of the goal of the experiment"""
    numbers: FloatArray
    """result of :attr:`Operation.numbers`"""


def no_numbers(bench: Bench) -> FloatArray:
    """Return an empty array, for operations that need no values of the scenario."""
    return np.zeros(0)


@dataclass(frozen=True)
class Operation(Part):
    """A kind of process in a bench's action table.

    Attributes:
        unit: unit of the magnitude.
        words: beginning of an action's description, with ``{vessel}``, ``{target}`` and ``{material}``.
        act: ``act(turn, chem) -> float``: carries it out, as a kernel or a function; returns the settling of all the
            bench's vessels meanwhile.
        legal: ``legal(turn, chem) -> bool``: whether it is legal, independent of the magnitude.
        takes: its required keys, of ``target`` and ``material``.
        top: largest magnitude.
        negative: beginning of the description if the magnitude is below 0; None: magnitudes must be above 0.
        touches: whether it changes the vessels it works on, apart from settling.
        numbers: values of the scenario that it needs, computed once per bench: ``turn.numbers``. For its own safety
            event, for instance, ``bench.scenario.safety_events.index(NAME)``, the index in ``turn.events``.
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


@inner
def always(turn: Turn, chem: Handle) -> bool:
    """Return True: legal at any time."""
    return True


@inner
def not_empty(turn: Turn, chem: Handle) -> bool:
    """Return True if the vessel is not empty."""
    return bool(volume(turn.row, chem) > 0.0)
