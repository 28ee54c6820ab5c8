"""Schemas and pointer tables of arrays, through which every layer passes its arrays to kernels.

A layer declares its arrays once as a schema, a ``NamedTuple`` whose annotations state shape, type and initial value::

    class ManagerState(NamedTuple):
        ticks: Annotated[IntArray, Field("N")]
        age: Annotated[IntArray, Field("N S I", first=-1)]

Allocation, reset, snapshots and pickling (:class:`chemlab.kernels.tables.Table`) and the kernels' view
(:func:`chemlab.kernels.jit.opened`) follow from it. A kernel receives a table as its ``handle``, a pointer table: one
small array of addresses. Passing twenty arrays one by one takes longer than most kernels run.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
StreamArray = npt.NDArray[np.uint64]
"""A random stream per row: see :mod:`chemlab.kernels.rng`."""
ObservationArray = npt.NDArray[np.float32]
MaskArray = npt.NDArray[np.int8]
Handle = Any
"""Address of a table's pointer table, which a kernel receives in place of it; without compilation, the arrays
themselves."""

SLOT = 5
"""Entries of an array in a pointer table: its address, then up to four lengths."""
WORD = 8
"""Bytes of an entry."""


@dataclass(frozen=True)
class Field:
    """Shape and initial value of a declared array.

    Attributes:
        dims: names of its axes, separated by spaces; a table is allocated for a length of each. "" is a single number.
        first: initial value of every entry, restored by :meth:`chemlab.kernels.tables.Table.reset`; None: not reset.
        kept: whether it is part of the state between steps, and so of snapshots.
    """

    dims: str
    first: float | None = 0
    kept: bool = True


@dataclass(frozen=True)
class Declared:
    """A resolved field of a schema."""

    name: str
    dtype: np.dtype[Any]
    axes: tuple[str, ...]
    field: Field
    number: bool
    """True if kernels see it as a number instead of an array."""


def _scalar(array: Any) -> Any:
    """Return the scalar type of an array from its annotation."""
    # From Python 3.12 on, it is an argument of NumPy's alias for arrays; before, of the dtype.
    last = typing.get_args(array)[-1]
    return (typing.get_args(last) or (last,))[0]


@functools.cache
def declared(declaration: Any) -> tuple[Declared, ...]:
    """Return the fields of a schema in order.

    Raises:
        TypeError: a field has no ``Field``, or a type that kernels do not support.
    """
    found = []
    for name, hint in typing.get_type_hints(declaration, include_extras=True).items():
        fields = [extra for extra in getattr(hint, "__metadata__", ()) if isinstance(extra, Field)]
        if len(fields) != 1:
            raise TypeError(f"{declaration.__name__}.{name}: must be Annotated[type, Field(...)], given {hint}")
        bare = hint.__origin__
        number = bare in (float, int)
        dtype = np.dtype(bare if number else _scalar(bare))
        found.append(Declared(name, dtype, tuple(fields[0].dims.split()), fields[0], number))
    return tuple(found)


def addresses(arrays: Sequence[npt.NDArray[Any]]) -> IntArray:
    """Return the pointer table of some arrays: :data:`SLOT` numbers each. The arrays must not move while it is used.

    Raises:
        ValueError: an array is not contiguous, or has more than four axes.
    """
    numbers: list[int] = []
    for array in arrays:
        if not array.flags.c_contiguous or array.ndim >= SLOT:
            raise ValueError(
                f"kernels require contiguous arrays of at most {SLOT - 1} axes, given strides {array.strides}"
            )
        # Several times faster than ``array.ctypes``; a laboratory has hundreds of arrays.
        numbers += [array.__array_interface__["data"][0], *array.shape, *[0] * (SLOT - 1 - array.ndim)]
    return np.array(numbers, dtype=np.int64)


@functools.cache
def merged(*declarations: type) -> Any:
    """Return a schema with the fields of several schemas in order: kernels open it as a whole, or as the first of
    them.
    """
    if len(declarations) == 1:
        return declarations[0]
    hints: dict[str, Any] = {}
    for declaration in declarations:
        hints.update(typing.get_type_hints(declaration, include_extras=True))
    name = "".join(declaration.__name__ for declaration in declarations)
    make: Any = typing.NamedTuple
    made = make(name, list(hints.items()))
    made.MERGED = declarations
    made.__reduce__ = _parts  # the class is created at run time, so copies and pickles refer to its parts
    return made


def _parts(values: Any) -> tuple[Any, ...]:
    return _made, (values.MERGED, tuple(values))


def _made(declarations: tuple[type, ...], values: tuple[Any, ...]) -> Any:
    return merged(*declarations)(*values)
