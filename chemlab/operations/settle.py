"""Settle: all of the bench's vessels stand for a while."""

from __future__ import annotations

from ..arrays import Handle
from ..jit import inner
from .base import Operation, Turn, always

__all__ = ["OPERATION"]


@inner
def _act(turn: Turn, chem: Handle) -> float:
    return turn.magnitude


OPERATION = Operation(unit="clock", words="settle", act=_act, legal=always, touches=False)
