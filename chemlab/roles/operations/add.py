"""Add: a material from stock."""

from __future__ import annotations

from ...kernels.arrays import Handle
from ...kernels.jit import inner, opened
from ...physics.chemistry import Chemistry
from ...physics.constants import TRACE_MOL
from ...physics.transfer import pour_out
from .operation import Operation, Turn


@inner
def _act(turn: Turn, chem: Handle) -> float:
    chemistry = opened(Chemistry, chem)
    mol = min(turn.magnitude / chemistry.molar_volume[turn.material], turn.stock[turn.material])
    turn.stock[turn.material] -= mol
    pour_out(turn.row, turn.material, mol, chem, turn.waste, turn.events)
    return 0.0


@inner
def _legal(turn: Turn, chem: Handle) -> bool:
    return bool(turn.stock[turn.material] > TRACE_MOL)


OPERATION = Operation(
    unit="L", words="add {material} to {vessel}", act=_act, legal=_legal, takes=frozenset({"material"})
)
