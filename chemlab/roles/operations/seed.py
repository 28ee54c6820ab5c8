"""Seed: add a pinch of pure crystals of the goal from stock, on which more can grow."""

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
    mol = min(turn.magnitude / chemistry.molar_mass[turn.goal], turn.stock[turn.goal])
    turn.stock[turn.goal] -= mol
    pour_out(turn.row, turn.goal, mol, chem, turn.waste, turn.events)
    return 0.0


@inner
def _legal(turn: Turn, chem: Handle) -> bool:
    return bool(turn.stock[turn.goal] > TRACE_MOL)


OPERATION = Operation(unit="g", words="seed {vessel} with the goal", act=_act, legal=_legal, top=100.0)
