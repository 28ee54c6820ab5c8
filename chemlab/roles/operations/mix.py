"""Mix: shake a vessel, which turns its settling clock back."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.transfer import turn_clock
from .operation import Operation, Turn, not_empty


@inner
def _act(turn: Turn, chem: Handle) -> float:
    turn_clock(turn.row, -turn.magnitude)
    return 0.0


OPERATION = Operation(unit="clock", words="mix {vessel}", act=_act, legal=not_empty)
