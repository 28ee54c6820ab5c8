"""Tables: the arrays of a declaration, allocated, reset, copied and handed to kernels together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import numba
import numpy as np
import numpy.typing as npt

from .arrays import SLOT, Declared, Field, Handle, IntArray, addresses, declared, merged
from .jit import kernel, opened

__all__ = ["Table"]

T = TypeVar("T")


class _Bytes(NamedTuple):
    rows: Annotated[npt.NDArray[np.uint8], Field("N bytes")]


@kernel
def _reset_rows(members: IntArray, arrays: IntArray, first: npt.NDArray[np.uint8]) -> None:
    """Copy the bytes of ``first``, a row of each array one after the other, into the arrays' rows of ``members``."""
    at = 0
    for k in range(arrays.shape[0] // SLOT):
        rows = opened(_Bytes, arrays[k * SLOT : (k + 1) * SLOT]).rows
        for i in range(members.shape[0]):
            for byte in range(rows.shape[1]):
                rows[members[i], byte] = first[at + byte]
        at += rows.shape[1]


class Table(Generic[T]):
    """The arrays of one declaration, allocated together.

    Attributes:
        arrays: an instance of the declaration.
        handle: what kernels take in its place.
    """

    def __init__(self, arrays: T) -> None:
        self.declaration = type(arrays)
        values: tuple[Any, ...] = arrays  # type: ignore[assignment]  # a NamedTuple
        self._own = [
            np.asarray(value, dtype=field.dtype) for field, value in zip(declared(type(arrays)), values, strict=True)
        ]
        seen = [own if not field.number else value for field, own, value in self._rows(values)]
        self.arrays: T = type(arrays)(*seen)
        self.handle: Handle = self.arrays if numba.config.DISABLE_JIT else addresses(self._own)
        again = [
            (own, np.full(own.shape[1:], field.field.first, dtype=own.dtype))
            for field, own in zip(declared(self.declaration), self._own, strict=True)
            if field.field.first is not None and own.size and not field.number
        ]
        self._reset_handle = addresses([own.reshape(len(own), -1).view(np.uint8) for own, _ in again])
        self._first = np.concatenate([np.zeros(0, np.uint8), *(first.reshape(-1).view(np.uint8) for _, first in again)])

    def _rows(self, values: Sequence[Any]) -> list[tuple[Declared, npt.NDArray[Any], Any]]:
        return list(zip(declared(self.declaration), self._own, values, strict=True))

    @classmethod
    def empty(cls, declaration: type[T], **lengths: int) -> Table[T]:
        """Every array at its first value, for the lengths of the axes by name."""
        made = [
            np.full([lengths[axis] for axis in field.axes], field.field.first or 0, dtype=field.dtype)
            for field in declared(declaration)
        ]
        return cls(declaration(*made))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in ("arrays", "declaration", "handle"):
            raise AttributeError(name)  # while a copy is being made
        return getattr(self.arrays, name)

    def reset(self, members: IntArray) -> None:
        """Give every entry of ``members`` (along the first axis) its first value, where the declaration has one."""
        if not numba.config.DISABLE_JIT:
            _reset_rows(members, self._reset_handle, self._first)
            return
        for field, array in zip(declared(self.declaration), self._own, strict=True):
            if field.field.first is not None:
                array[members] = field.field.first

    def changing(self) -> list[npt.NDArray[Any]]:
        """Every array that goes on from step to step, for snapshots."""
        return [
            array for field, array in zip(declared(self.declaration), self._own, strict=True) if field.field.kept
        ]

    def copy(self) -> Table[T]:
        """The same with arrays of its own."""
        values: tuple[Any, ...] = self.arrays  # type: ignore[assignment]
        return Table(self.declaration(*(np.array(v) if isinstance(v, np.ndarray) else v for v in values)))

    def __reduce__(self) -> tuple[Any, ...]:
        # Addresses are another process's; a merged declaration is made anew from its parts.
        parts = getattr(self.declaration, "MERGED", (self.declaration,))
        return _restored, (parts, tuple(self.arrays))  # type: ignore[arg-type]  # a NamedTuple

    def __deepcopy__(self, memo: dict[int, Any]) -> Table[T]:
        return self.copy()


def _restored(declarations: tuple[type, ...], values: tuple[Any, ...]) -> Table[Any]:
    return Table(merged(*declarations)(*values))
