"""An operation of a user's own as kernels: compiled when they are first called, and then loaded from the cache."""

from __future__ import annotations

import numpy as np

from chemlab.kernels.arrays import FloatArray, Handle
from chemlab.kernels.jit import kernel
from chemlab.physics.chemistry import AMOUNTS
from chemlab.physics.transfer import take
from chemlab.roles.bench import Bench
from chemlab.roles.operations import Operation, Turn


def vapour_event(bench: Bench) -> FloatArray:
    """Where the scenario's event ``vapour_mol`` stands among its events."""
    return np.array([bench.scenario.safety_events.index("vapour_mol")], dtype=np.float64)


@kernel
def blow_off(turn: Turn, chem: Handle) -> float:
    mol = turn.magnitude * turn.row[AMOUNTS + turn.material]
    take(turn.row, chem, turn.material, mol)
    turn.waste[turn.material] += mol
    turn.events[int(turn.numbers[0])] += mol
    return 0.5


@kernel
def can_blow_off(turn: Turn, chem: Handle) -> bool:
    return bool(turn.row[AMOUNTS + turn.material] > 0.0)


EVAPORATE = Operation(
    unit="fraction",
    words="blow {material} off {vessel}",
    act=blow_off,
    legal=can_blow_off,
    takes=frozenset({"material"}),
    top=1.0,
    numbers=vapour_event,
)
