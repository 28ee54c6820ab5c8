"""Operations: processes of a bench with an action table.

To add a built-in operation: its functions and an entry in :data:`OPERATIONS`. A user-defined one is an
:class:`Operation` in a file beside the scenario, named there as ``kind = "my_parts.py:NAME"``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..config.parts import Part
from ..kernels.arrays import FloatArray, Handle, IntArray
from ..kernels.jit import chained, inner, opened
from ..physics import backends as laws
from ..physics import transfer
from ..physics.chemistry import Chemistry
from ..physics.constants import TRACE_MOL

if TYPE_CHECKING:
    from .bench import Bench

_LEAST_L = 1e-6
"""Litres of liquid below which nothing can be filtered."""
_LEAST_DRIED_L = 1e-9


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
    """[4] limits of the apparatus: see :func:`chemlab.physics.backends.heat`"""
    cake_liquid: float
    """litres of liquid retained per litre of solids in a filter"""
    goal: int
    """index of the goal of the experiment"""
    work: FloatArray
    """scratch of the physics"""
    numbers: FloatArray
    """result of :attr:`Operation.numbers`"""


def no_numbers(bench: Bench) -> FloatArray:
    """Return an empty array, for operations that need no values of the scenario."""
    return np.zeros(0)


@dataclass(frozen=True)
class Operation(Part):
    """A kind of process in a bench's action table.

    Attributes:
        unit: unit of the magnitude; descriptions show a ``fraction`` as percent.
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
def _always(turn: Turn, chem: Handle) -> bool:
    """Return True: legal at any time."""
    return True


@inner
def _not_empty(turn: Turn, chem: Handle) -> bool:
    """Return True if the vessel is not empty."""
    return bool(transfer.volume(turn.row, chem) > 0.0)


@inner
def _drain(turn: Turn, chem: Handle) -> float:
    """Move the lowest part of a vessel into another."""
    pixels = turn.magnitude / 100.0 * turn.profile.shape[1]
    transfer.drain(turn.row, turn.target, pixels, turn.profile, turn.layers, chem, turn.waste, turn.events)
    return 0.0


@inner
def _mix(turn: Turn, chem: Handle) -> float:
    """Shake a vessel, which turns its settling clock back."""
    transfer.turn_clock(turn.row, -turn.magnitude)
    return 0.0


@inner
def _pour(turn: Turn, chem: Handle) -> float:
    """Pour a fraction of everything in a vessel into another."""
    transfer.pour(turn.row, turn.target, turn.magnitude, chem, turn.waste, turn.events)
    return 0.0


@inner
def _take(turn: Turn, material: int, mol: float, chem: Handle) -> None:
    """Take an amount from stock, if there is as much."""
    mol = min(mol, turn.stock[material])
    turn.stock[material] -= mol
    transfer.pour_out(turn.row, material, mol, chem, turn.waste, turn.events)


@inner
def _add(turn: Turn, chem: Handle) -> float:
    """Add a material from stock."""
    _take(turn, turn.material, turn.magnitude / opened(Chemistry, chem).molar_volume[turn.material], chem)
    return 0.0


@inner
def _can_add(turn: Turn, chem: Handle) -> bool:
    return bool(turn.stock[turn.material] > TRACE_MOL)


@inner
def _settle(turn: Turn, chem: Handle) -> float:
    """Let all of the bench's vessels stand for a while."""
    return turn.magnitude


@inner
def _heat(turn: Turn, chem: Handle) -> float:
    """Heat or cool; vapour condenses into the target."""
    laws.heat(turn.row, turn.target, 1000.0 * turn.magnitude, turn.limits, chem, turn.waste, turn.events, turn.work)
    return 0.0


@inner
def _seed(turn: Turn, chem: Handle) -> float:
    """Add a pinch of pure crystals of the goal from stock, on which more can grow."""
    _take(turn, turn.goal, turn.magnitude / opened(Chemistry, chem).molar_mass[turn.goal], chem)
    return 0.0


@inner
def _can_seed(turn: Turn, chem: Handle) -> bool:
    return bool(turn.stock[turn.goal] > TRACE_MOL)


@inner
def _filter(turn: Turn, chem: Handle) -> float:
    """Let the liquid run into the target; solids and crystals stay with some of it."""
    litres = turn.magnitude * transfer.free_liquid(turn.row, turn.cake_liquid, chem)
    transfer.strain(turn.row, turn.target, litres, turn.layers, chem, turn.waste, turn.events)
    return 0.0


@inner
def _can_filter(turn: Turn, chem: Handle) -> bool:
    return bool(transfer.free_liquid(turn.row, turn.cake_liquid, chem) > _LEAST_L)


@inner
def _dry(turn: Turn, chem: Handle) -> float:
    """Draw air over the contents, which removes vapour; non-volatile material stays."""
    laws.dry(turn.row, turn.magnitude, chem, turn.waste)
    return 0.0


@inner
def _can_dry(turn: Turn, chem: Handle) -> bool:
    return bool(transfer.liquid_volume(turn.row, chem) > _LEAST_DRIED_L)


_TARGET = frozenset({"target"})

OPERATIONS: dict[str, Operation] = {
    "drain": Operation("% of the height", "drain {vessel} -> {target}", _drain, _not_empty, _TARGET, top=100.0),
    "mix": Operation("units of settling time", "mix {vessel}", _mix, _not_empty),
    "pour": Operation("fraction", "pour {vessel} -> {target}", _pour, _not_empty, _TARGET, top=1.0),
    "add": Operation("L", "add {material} to {vessel}", _add, _can_add, frozenset({"material"})),
    "settle": Operation("units of settling time", "settle", _settle, _always, touches=False),
    "heat": Operation("kJ", "heat {vessel}", _heat, _always, _TARGET, negative="cool {vessel}"),
    "seed": Operation("g", "seed {vessel} with the goal", _seed, _can_seed, top=100.0),
    "filter": Operation("fraction", "filter {vessel} -> {target}", _filter, _can_filter, _TARGET, top=1.0),
    "dry": Operation("L of air", "dry {vessel}", _dry, _can_dry, top=1e6),
}
"""Operations by kind; their index is their order."""

act = chained("act", [operation.act for operation in OPERATIONS.values()], 0.0)
"""Carry out operation ``number`` inside a kernel: ``act(number, turn, chem)``."""
legal = chained("legal", [operation.legal for operation in OPERATIONS.values()], True)
"""Return True if operation ``number`` is legal, inside a kernel: ``legal(number, turn, chem)``."""
