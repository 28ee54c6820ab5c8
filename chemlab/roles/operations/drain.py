"""Drain: the lowest part of a vessel into another."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.transfer import drain
from .operation import Operation, Turn, not_empty


@inner
def _act(turn: Turn, chem: Handle) -> float:
    pixels = turn.magnitude / 100.0 * turn.profile.shape[1]
    drain(turn.row, turn.target, pixels, turn.profile, turn.layers, chem, turn.waste, turn.events)
    return 0.0


OPERATION = Operation(
    unit="% of the height",
    words="drain {vessel} -> {target}",
    act=_act,
    legal=not_empty,
    takes=frozenset({"target"}),
    top=100.0,
)
