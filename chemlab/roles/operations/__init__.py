"""Operations: processes of a bench with an action table, one file each.

To add a built-in operation: a file with an ``OPERATION``, and an entry in :data:`OPERATIONS`. A user-defined one is an
:class:`~chemlab.roles.operations.operation.Operation` in a file beside the scenario, named there as
``kind = "my_parts.py:NAME"``.
"""

from ...kernels.jit import chained
from . import add, drain, dry, filter, heat, mix, pour, seed, settle
from .operation import Operation, Turn

__all__ = ["OPERATIONS", "Operation", "Turn", "act", "legal"]

OPERATIONS: dict[str, Operation] = {
    "drain": drain.OPERATION,
    "mix": mix.OPERATION,
    "pour": pour.OPERATION,
    "add": add.OPERATION,
    "settle": settle.OPERATION,
    "heat": heat.OPERATION,
    "seed": seed.OPERATION,
    "filter": filter.OPERATION,
    "dry": dry.OPERATION,
}
"""Operations by kind; their index is their order."""

act = chained("act", [operation.act for operation in OPERATIONS.values()], 0.0)
"""Carry out operation ``number`` inside a kernel: ``act(number, turn, chem)``."""
legal = chained("legal", [operation.legal for operation in OPERATIONS.values()], True)
"""Return True if operation ``number`` is legal, inside a kernel: ``legal(number, turn, chem)``."""
