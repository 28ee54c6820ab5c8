"""Filter: the liquid runs into the target; solids and crystals stay with some of it."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner
from ...physics.transfer import free_liquid, strain
from .operation import Operation, Turn

_CAKE_LIQUID = 4
"""Index in ``Turn.limits``."""
_LEAST_L = 1e-6


@inner
def _act(turn: Turn, chem: Handle) -> float:
    litres = turn.magnitude * free_liquid(turn.row, turn.limits[_CAKE_LIQUID], chem)
    strain(turn.row, turn.target, litres, turn.layers, chem, turn.waste, turn.events)
    return 0.0


@inner
def _legal(turn: Turn, chem: Handle) -> bool:
    return bool(free_liquid(turn.row, turn.limits[_CAKE_LIQUID], chem) > _LEAST_L)


OPERATION = Operation(
    unit="fraction",
    words="filter {vessel} -> {target}",
    act=_act,
    legal=_legal,
    takes=frozenset({"target"}),
    top=1.0,
)
