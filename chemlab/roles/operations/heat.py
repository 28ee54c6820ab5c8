"""Heat or cool: vapour condenses into the target."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.backends import heat
from .operation import Operation, Turn, always


@inner
def _act(turn: Turn, chem: Handle) -> float:
    heat(turn.row, turn.target, 1000.0 * turn.magnitude, turn.limits, chem, turn.waste, turn.events)
    return 0.0


OPERATION = Operation(
    unit="kJ",
    words="heat {vessel}",
    act=_act,
    legal=always,
    takes=frozenset({"target"}),
    negative="cool {vessel}",
)
