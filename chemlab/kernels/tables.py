"""Tables: the arrays of a schema, allocated, reset, copied and passed to kernels together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Generic, NamedTuple, TypeVar, cast

import numpy as np
import numpy.typing as npt

from .arrays import SLOT, WORD, Declared, Field, Handle, IntArray, addresses, declared
from .jit import COMPILED, kernel, opened

T = TypeVar("T")


class _Bytes(NamedTuple):
    rows: Annotated[npt.NDArray[np.uint8], Field("N bytes")]


@kernel
def _reset_rows(members: IntArray, arrays: Handle, count: int, first: npt.NDArray[np.uint8]) -> None:
    """Copy the bytes of ``first``, a concatenated row of each of ``count`` arrays, into the arrays' rows of
    ``members``.
    """
    at = 0
    for k in range(count):
        rows = opened(_Bytes, arrays + k * SLOT * WORD).rows
        # Without a sum or look-up in the inner loop, so that compilers can vectorize it.
        values = first[at : at + rows.shape[1]]
        for i in range(members.shape[0]):
            row = rows[members[i]]
            for byte in range(row.shape[0]):
                row[byte] = values[byte]
        at += rows.shape[1]


class Table(Generic[T]):
    """The arrays of one schema, allocated together; each is also an attribute of the table.

    Attributes:
        arrays: an instance of the schema.
        handle: the pointer table for kernels.
    """

    def __init__(self, arrays: T) -> None:
        values: tuple[Any, ...] = arrays  # type: ignore[assignment]  # a NamedTuple
        self._fields: tuple[Declared, ...] = declared(cast(Any, type(arrays)))
        pairs = list(zip(self._fields, values, strict=True))
        self._own = [np.asarray(value, dtype=field.dtype) for field, value in pairs]
        seen = [value if field.number else own for (field, value), own in zip(pairs, self._own, strict=True)]
        self.arrays: T = type(arrays)(*seen)
        self._addresses = addresses(self._own)
        self.handle: Handle = self._addresses.ctypes.data if COMPILED else self.arrays
        again = [
            (field.field.first, own)
            for field, own in zip(self._fields, self._own, strict=True)
            if field.field.first is not None and own.size and not field.number
        ]
        self._reset_at = addresses([own.reshape(len(own), -1).view(np.uint8) for _, own in again])
        self._resettable = self._reset_at.ctypes.data
        rows = [own.dtype.type(first).tobytes() * (own.size // len(own)) for first, own in again]
        self._first = np.frombuffer(bytearray().join(rows), dtype=np.uint8) if rows else np.zeros(0, np.uint8)

    @classmethod
    def empty(cls, declaration: type[T], **lengths: int) -> Table[T]:
        """Allocate a table with initial values, for given lengths of the axes."""
        made = [
            np.full([lengths[axis] for axis in field.axes], field.field.first or 0, dtype=field.dtype)
            for field in declared(cast(Any, declaration))
        ]
        return cls(declaration(*made))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in ("arrays", "handle"):
            raise AttributeError(name)  # while a copy is being made
        return getattr(self.arrays, name)

    def reset(self, members: IntArray) -> None:
        """Reset every entry of ``members`` (along the first axis) that has an initial value."""
        if COMPILED:
            _reset_rows(members, self._resettable, len(self._reset_at) // SLOT, self._first)
            return
        for field, array in zip(self._fields, self._own, strict=True):
            if field.field.first is not None:
                array[members] = field.field.first

    def changing(self) -> list[npt.NDArray[Any]]:
        """Return views of every array of the state between steps, with the laboratories' axis first if there is one."""
        return [
            np.moveaxis(array, field.axes.index("N"), 0) if "N" in field.axes else array
            for field, array in zip(self._fields, self._own, strict=True)
            if field.field.kept
        ]

    def member(self, member: int, without: str = "") -> list[npt.NDArray[Any]]:
        """The part of every array of :meth:`changing` that is one laboratory's (views, with axis N, of length 1)."""
        return [
            array[(slice(None),) * field.axes.index("N") + (slice(member, member + 1),)]
            for field, array in zip(self._fields, self._own, strict=True)
            if field.name != without and field.field.kept and "N" in field.axes
        ]

    def copy(self) -> Table[T]:
        """Return a copy with its own arrays."""
        values: tuple[Any, ...] = self.arrays  # type: ignore[assignment]
        return Table(type(self.arrays)(*(np.array(v) if isinstance(v, np.ndarray) else v for v in values)))

    def __reduce__(self) -> tuple[Any, ...]:
        return Table, (self.arrays,)  # addresses are invalid in another process

    def __deepcopy__(self, memo: dict[int, Any]) -> Table[T]:
        return self.copy()


def put_back(arrays: Sequence[npt.NDArray[Any]], saved: Sequence[npt.NDArray[Any]]) -> None:
    """Copy saved values into arrays.

    Raises:
        ValueError: the number, shapes or types of the arrays differ; nothing changes.
    """
    own, other = ([(np.shape(one), np.asarray(one).dtype) for one in some] for some in (arrays, saved))
    if own != other:
        at = next((i for i, (a, b) in enumerate(zip(own, other, strict=False)) if a != b), min(len(own), len(other)))
        raise ValueError(
            f"state: does not fit this environment: it has {len(other)} arrays instead of {len(own)}, and number {at} "
            f"differs: {[*other, 'missing'][at]}, here {[*own, 'missing'][at]}; use a state of an identical environment"
        )
    for array, values in zip(arrays, saved, strict=True):
        array[...] = values
