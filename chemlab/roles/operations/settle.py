"""Settle: let all of the bench's vessels stand for a while."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from .operation import Operation, Turn, always


@inner
def _act(turn: Turn, chem: Handle) -> float:
    return turn.magnitude


OPERATION = Operation(unit="clock", words="settle", act=_act, legal=always, touches=False)
