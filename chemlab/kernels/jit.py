"""The one way a chemlab function is compiled: public numba, and pointer casts below it.

numba keeps compiled kernels in its own cache, in a folder that is named after the sources of all kernels: numba tells
whether a kernel is fresh by its own file's time stamp, and would go on running an edited function of another file.
Kernels in the cache have the code of all functions that they call in them, under names of numba's; so functions that
are made in a loop or a factory must have names of their own.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import importlib
import math
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.typing import templates

from .arrays import SLOT, FloatArray, Handle, declared

__all__ = ["COMPILED", "chained", "code_address", "folder", "helper", "inner", "kernel", "opened", "scratch"]

_NUMBA: Any = numba
_EXTENDING: Any = extending
_TYPES: Any = types
_BUILD: Any = cgutils
_TEMPLATES: Any = templates
"""numba, which has no types."""

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

COMPILED: bool = not _NUMBA.config.DISABLE_JIT
"""Whether kernels are compiled; with ``NUMBA_DISABLE_JIT=1`` they are plain Python."""
# Kernels allocate nothing, so numba need not count references to the arrays handed to them: that took a tenth of the
# time of a step, and as much of that to compile.
_SETTINGS: dict[str, Any] = {"error_model": "numpy", "forceinline": False, "_nrt": False}
_INSIDE: dict[str, Any] = {**_SETTINGS, "nogil": True, "no_cfunc_wrapper": True}
_TINY: dict[str, Any] = {**_INSIDE, "forceinline": True, "no_cpython_wrapper": True}
"""numba's settings for a function that Python calls, for one that kernels call, and for what becomes part of them."""
_UNUSED_S = 60 * 86400.0
"""Seconds after which kernels of other sources that no process has used are deleted."""
_ROOM_BYTES = 100 * 1024**2
"""Free space below which kernels are not kept."""
_DECORATING = threading.RLock()


def kernel(function: F) -> F:
    """Compile ``function`` with numba on first use, cached on disk, releasing the GIL.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead, slowly, for debugging.
    """
    return cast(F, _cached(_NUMBA.njit, function, "chemlab", **_INSIDE))


def helper(function: F) -> F:
    """A function that kernels call, and that Python may call, too: compiled in every process that compiles those."""
    return cast(F, _NUMBA.njit(**_INSIDE)(function))


def inner(function: F) -> F:
    """A helper that numba makes part of its callers: for what few of them call, for what takes opened tables, and for
    what returns :func:`scratch` arrays."""
    return cast(F, _NUMBA.njit(inline="always", **_INSIDE)(function))


def chained(
    name: str, functions: Sequence[Callable[[Any, Handle], Any]], otherwise: Any
) -> Callable[[int, Any, Handle], Any]:
    """A helper ``(number, work, chem)`` that calls one of some functions of (work, chem) by its number.

    Args:
        name: its own.
        functions: kernels or helpers.
        otherwise: what it returns past the last.
    """
    calls = [f"    if number == {i}:\n        return function_{i}(work, chem)\n" for i in range(len(functions))]
    scope: dict[str, Any] = {f"function_{i}": function for i, function in enumerate(functions)}
    scope |= {"otherwise": otherwise, "__name__": __name__}
    exec(f"def {name}(number, work, chem):\n{''.join(calls)}    return otherwise\n", scope)
    return inner(cast(Callable[[int, Any, Handle], Any], scope[name]))


# -- where compiled kernels are kept ---------------------------------------------------------------------------------


def _cached(compiler: Any, function: Callable[..., Any], place: str, *signature: Any, **options: Any) -> Any:
    """What one of numba's compilers makes of a function, kept in a :func:`folder`."""
    kept = folder(place) if COMPILED and os.path.isfile(function.__code__.co_filename) else None
    with _DECORATING:
        before, _NUMBA.config.CACHE_DIR = _NUMBA.config.CACHE_DIR, str(kept or "")
        try:
            return compiler(*signature, cache=kept is not None, **options)(function)
        finally:
            _NUMBA.config.CACHE_DIR = before


@functools.cache
def folder(module: str) -> Path | None:
    """Where kernels are kept that are made of chemlab's sources, and of those of a module (or package) of another's;
    below ``NUMBA_CACHE_DIR`` or the user's cache. None where there is no place for them."""
    user = {"win32": "LOCALAPPDATA"}.get(sys.platform, "XDG_CACHE_HOME")
    home = Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    place = Path(_NUMBA.config.CACHE_DIR or Path(os.environ.get(user) or home) / "chemlab")
    found = place / f"kernels-{_sources('chemlab')}"
    own = found if module.partition(".")[0] == "chemlab" else found / _sources(module)
    try:
        own.mkdir(parents=True, exist_ok=True)
        os.utime(found)
        if os.access(own, os.W_OK) and shutil.disk_usage(own).free > _ROOM_BYTES:
            _delete_unused(place)
            return own
        reason = "not writable, or full"
    except OSError as error:
        reason = error.strerror or str(error)
    _say_once(
        f"compiled kernels cannot be kept in {place} ({reason}), so every process compiles them anew; NUMBA_CACHE_DIR "
        "names another folder for them"
    )
    return None


def _delete_unused(place: Path) -> None:
    """Delete kernels of other sources that nobody uses any more."""
    for other in place.glob("kernels-*"):
        with contextlib.suppress(OSError):
            if time.time() - other.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(other, ignore_errors=True)


@functools.cache
def _sources(module: str) -> str:
    """Hash of every source file that kernels of a module, or package, are written in."""
    if module == "chemlab":
        root = Path(__file__).resolve().parents[1]
        kept = [root / "kernels", root / "physics"]
        # An edit to a file of chemlab's without kernels must not have all of them compiled again.
        read = {path: path.read_bytes() for path in sorted(root.rglob("*.py"))}
        read = {path: text for path, text in read.items() if {*kept} & {*path.parents} or b"jit import" in text}
    else:
        origin = Path(str(importlib.import_module(module).__file__))
        files = sorted(origin.parent.rglob("*.py")) if origin.name == "__init__.py" else [origin]
        read = {path: path.read_bytes() for path in files}
    return hashlib.blake2b(b"".join(read.values()), digest_size=8).hexdigest()


@functools.cache
def _say_once(words: str) -> None:
    print(f"chemlab: {words}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def told(name: str) -> Any:
    """Say that what happens here compiles kernels, the first time that it does so with a cache."""
    place = folder("chemlab")
    mark = place / f"{name}.compiled" if place is not None else None
    if COMPILED and not (mark is not None and mark.exists()):
        _say_once("compiling kernels for this machine (about a minute); later starts load them from the cache")
    yield
    if mark is not None:
        with contextlib.suppress(OSError):
            mark.touch()


# -- functions by their addresses ------------------------------------------------------------------------------------


@functools.cache
def code_address(function: Any, signature: Any, module: str) -> int:
    """Address of a function's code as a C callback, for :func:`call_address`.

    Args:
        function: a kernel or helper.
        signature: numba's, of its parameters and result.
        module: where its source is.
    """
    made = _cached(_NUMBA.cfunc, function.py_func, module, signature, **_SETTINGS)
    _ALIVE.append(made)
    return int(made.address)


_ALIVE: list[Any] = []
"""Callbacks whose addresses are in use."""


@functools.cache
def call_address(name: str, signature: Any) -> Any:
    """A function ``(address, arguments)`` that kernels call what :func:`code_address` found with, for a signature."""

    def typed(context: Any, address: Any, arguments: Any) -> Any:
        def generate(target: Any, builder: Any, own: Any, values: Any) -> Any:
            given = zip(_BUILD.unpack_tuple(builder, values[1]), arguments, signature.args, strict=True)
            cast_ = [target.cast(builder, value, kind, wanted) for value, kind, wanted in given]
            kinds = [target.get_value_type(kind) for kind in signature.args]
            code = ir.FunctionType(target.get_value_type(signature.return_type), kinds)
            return builder.call(builder.inttoptr(values[0], code.as_pointer()), cast_)

        return signature.return_type(_TYPES.int64, arguments), generate

    typed.__name__ = typed.__qualname__ = f"call_{name}"
    return _EXTENDING.intrinsic(typed)


# -- tables ----------------------------------------------------------------------------------------------------------


def opened(declaration: type[T], handle: Handle) -> T:
    """The arrays of a table by its handle: an instance of the table's ``declaration``, or of one whose fields the
    table's begin with. In a kernel nothing is loaded but what is used."""
    fields = declared(cast(Any, declaration))
    if not COMPILED:
        return declaration(*(getattr(handle, field.name) for field in fields))
    numbers, values = (ctypes.c_int64 * (SLOT * len(fields))).from_address(int(handle)), []
    for at, field in enumerate(fields):
        address, *lengths = numbers[SLOT * at : SLOT * at + 1 + len(field.axes)]
        array = _seen(address, lengths if not field.number else [1], field.dtype)
        values.append(array[0].item() if field.number else array)
    return declaration(*values)


def _seen(address: int, lengths: Sequence[int], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """The array at an address."""
    size = dtype.itemsize * math.prod(lengths)
    if not size:
        return np.zeros(lengths, dtype)
    memory: Any = (ctypes.c_byte * size).from_address(address)
    return np.asarray(np.frombuffer(memory, dtype).reshape(lengths))


class _Table(_TYPES.Type):  # type: ignore[misc]  # numba has no types
    """A table as kernels see it: the address of its handle. Handing over the arrays instead, some two hundred numbers
    to each function, took longer to compile than what the functions do."""

    def __init__(self, declaration: Any) -> None:
        self.kinds: dict[str, Any] = {}
        for field in declared(declaration):
            number = _NUMBA.from_dtype(field.dtype)
            self.kinds[field.name] = number if field.number else _TYPES.Array(number, len(field.axes), "C")
        digest = hashlib.blake2b(repr(self.kinds).encode(), digest_size=8).hexdigest()
        super().__init__(f"{declaration.__qualname__}_{digest}")


_EXTENDING.register_model(_Table)(_EXTENDING.models.OpaqueModel)


@_EXTENDING.intrinsic  # type: ignore[untyped-decorator]
def _table(context: Any, declaration: Any, handle: Any) -> Any:
    """The table at an address."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[1], _BUILD.voidptr_t)

    return _Table(declaration.instance_class)(declaration, _TYPES.int64), generate


@_EXTENDING.infer_getattr
class _Fields(_TEMPLATES.AttributeTemplate):  # type: ignore[misc]
    key = _Table

    def generic_resolve(self, table: Any, name: str) -> Any:
        return table.kinds.get(name)


@_EXTENDING.lower_getattr_generic(_Table)  # type: ignore[untyped-decorator]
def _field(context: Any, builder: Any, table: _Table, base: Any, name: str) -> Any:
    """A field of an opened table. Where arrays are does not change while kernels run, whatever these write, so
    compilers may look it up once."""
    kind, word = table.kinds[name], ir.IntType(64)
    at = SLOT * list(table.kinds).index(name)
    slots = builder.bitcast(base, word.as_pointer())

    def load(address: Any) -> Any:
        loaded = builder.load(address)
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    def number(i: int) -> Any:
        return load(_BUILD.gep(builder, slots, at + i))

    if not isinstance(kind, _TYPES.Array):
        return load(builder.inttoptr(number(0), context.get_value_type(kind).as_pointer()))
    return _array(context, builder, kind, number(0), [number(1 + axis) for axis in range(kind.ndim)])


def _array(context: Any, builder: Any, kind: Any, address: Any, lengths: list[Any]) -> Any:
    """An array of some lengths at an address, whose memory is not numba's to free."""
    array = _BUILD.create_struct_proxy(kind)(context, builder)
    strides = [ir.Constant(ir.IntType(64), context.get_abi_sizeof(context.get_data_type(kind.dtype)))]
    array.itemsize = strides[0]
    for length in reversed(lengths):
        strides.insert(0, builder.mul(strides[0], length))
    array.data = builder.inttoptr(address, array.data.type)
    array.nitems = functools.reduce(builder.mul, lengths)
    array.shape = _BUILD.pack_array(builder, lengths)
    array.strides = _BUILD.pack_array(builder, strides[1:])
    return array._getvalue()


@_EXTENDING.overload(opened, jit_options=_TINY)
def _opened(declaration, handle):  # type: ignore[no-untyped-def]
    return lambda declaration, handle: _table(declaration, handle)


if COMPILED:

    @_EXTENDING.intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
    def scratch(context: Any, count: Any) -> Any:
        """[count] numbers to work with, of any value, for as long as the kernel that asks runs. ``count`` is a
        constant."""
        if not isinstance(count, _TYPES.IntegerLiteral):
            return None  # numba says that no function takes it
        kind, size = _TYPES.Array(_TYPES.float64, 1, "C"), ir.Constant(ir.IntType(64), count.literal_value)

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            memory = _BUILD.alloca_once(builder, target.get_value_type(_TYPES.float64), size=count.literal_value)
            return _array(target, builder, kind, builder.ptrtoint(memory, size.type), [size])

        return kind(count), generate

else:

    def scratch(count: int) -> FloatArray:
        """[count] numbers to work with."""
        return np.empty(count)
