"""Dry: draw air over the contents, which removes vapour; non-volatile material stays."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.backends import dry
from ...physics.transfer import liquid_volume
from .operation import Operation, Turn

_LEAST_L = 1e-9


@inner
def _act(turn: Turn, chem: Handle) -> float:
    dry(turn.row, turn.magnitude, chem, turn.waste)
    return 0.0


@inner
def _legal(turn: Turn, chem: Handle) -> bool:
    return bool(liquid_volume(turn.row, chem) > _LEAST_L)


OPERATION = Operation(unit="L of air", words="dry {vessel}", act=_act, legal=_legal, top=1e6)
