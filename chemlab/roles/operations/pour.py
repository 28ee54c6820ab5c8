"""Pour: a fraction of everything in a vessel into another."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.transfer import pour
from .operation import Operation, Turn, not_empty


@inner
def _act(turn: Turn, chem: Handle) -> float:
    pour(turn.row, turn.target, turn.magnitude, chem, turn.waste, turn.events)
    return 0.0


OPERATION = Operation(
    unit="fraction",
    words="pour {vessel} -> {target}",
    act=_act,
    legal=not_empty,
    takes=frozenset({"target"}),
    top=1.0,
)
