"""Arrays and their tables: what every layer hands to kernels. Nothing here knows of chemistry.

A layer declares its arrays once, as a ``NamedTuple`` whose annotations say shape, type and first value::

    class ManagerState(NamedTuple):
        ticks: Annotated[IntArray, Field("N")]
        age: Annotated[IntArray, Field("N S I", first=-1)]

From that follow allocation, reset, snapshots and pickles (:class:`chemlab.kernels.tables.Table`) and what kernels see
(:func:`chemlab.kernels.jit.opened`). A table is handed to a kernel as its ``handle``, one small array of addresses:
handing over twenty arrays one by one takes longer than most of what kernels do with them.
"""

from __future__ import annotations

import functools
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = [
    "SLOT",
    "BoolArray",
    "Field",
    "FloatArray",
    "Handle",
    "IntArray",
    "MaskArray",
    "ObservationArray",
    "StreamArray",
    "addresses",
    "declared",
    "merged",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
StreamArray = npt.NDArray[np.uint64]
"""A random stream for each row: see :mod:`chemlab.kernels.rng`."""
ObservationArray = npt.NDArray[np.float32]
MaskArray = npt.NDArray[np.int8]
Handle = Any
"""What a kernel takes in place of a table: its array of addresses; without compiling, the arrays themselves."""

SLOT = 5
"""Numbers that an array takes in a handle: its address, then up to four lengths."""


@dataclass(frozen=True)
class Field:
    """Shape and beginning of a declared array.

    Attributes:
        dims: names of its axes, by spaces; a table is made for a length of each. "" is a single number.
        first: what every entry is at first, and again when :meth:`chemlab.kernels.tables.Table.reset` says so; None:
        not reset.
        kept: whether it is part of what goes on from step to step, and so of snapshots.
    """

    dims: str
    first: float | None = 0
    kept: bool = True


@dataclass(frozen=True)
class Declared:
    """A field of a declaration, resolved."""

    name: str
    dtype: np.dtype[Any]
    axes: tuple[str, ...]
    field: Field
    number: bool
    """Whether kernels see it as a number and not as an array."""


def _scalar(array: Any) -> Any:
    """The type of the numbers in an array, by its annotation."""
    # Of NumPy's alias for arrays that is an argument of its own from Python 3.12 on, before that one of the dtype's.
    last = typing.get_args(array)[-1]
    return (typing.get_args(last) or (last,))[0]


@functools.cache
def declared(declaration: Any) -> tuple[Declared, ...]:
    """The fields of a declaration, in order.

    Raises:
        TypeError: a field without ``Field``, or of a type that no kernel takes.
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
    """The handle of some arrays: :data:`SLOT` numbers each. They must stay where they are while it is used.

    Raises:
        ValueError: an array is not contiguous, or has more than four axes.
    """
    numbers: list[int] = []
    for array in arrays:
        if not array.flags.c_contiguous or array.ndim >= SLOT:
            raise ValueError(
                f"kernels take contiguous arrays of at most {SLOT - 1} axes, given strides {array.strides}"
            )
        # Several times as fast as ``array.ctypes``, and a laboratory has hundreds of arrays.
        numbers += [array.__array_interface__["data"][0], *array.shape, *[0] * (SLOT - 1 - array.ndim)]
    return np.array(numbers, dtype=np.int64)


@functools.cache
def merged(*declarations: type) -> Any:
    """A declaration of all fields of several, in order: kernels open it whole, or as the first of them."""
    if len(declarations) == 1:
        return declarations[0]
    hints: dict[str, Any] = {}
    for declaration in declarations:
        hints.update(typing.get_type_hints(declaration, include_extras=True))
    name = "".join(declaration.__name__ for declaration in declarations)
    make: Any = typing.NamedTuple
    made = make(name, list(hints.items()))
    made.MERGED = declarations
    made.__reduce__ = _parts  # the class is made at run time, so copies and pickles name what it is made of
    return made


def _parts(values: Any) -> tuple[Any, ...]:
    return _made, (values.MERGED, tuple(values))


def _made(declarations: tuple[type, ...], values: tuple[Any, ...]) -> Any:
    return merged(*declarations)(*values)
