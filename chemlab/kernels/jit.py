"""Compilation of chemlab's functions: numba's public interface, and the intrinsics of an extension below it.

numba stores compiled kernels in its own cache, in a folder that is named by a hash of the sources of all kernels. numba
itself checks the time stamp of a kernel's own file only, so it would run an outdated version of a function from another
file. A cached kernel contains the code of all functions that it calls, under numba's names for them. Functions that are
made in a loop or a factory must therefore have different names.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import gc
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
from numba.core import cgutils, event
from numba.core.typing import templates

from .arrays import SLOT, FloatArray, Handle, declared

_NUMBA: Any = numba
_EXTENDING: Any = extending
_TYPES: Any = types
_BUILD: Any = cgutils
_TEMPLATES: Any = templates
_EVENT: Any = event
"""numba's modules, which have no type annotations."""

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

COMPILED: bool = not _NUMBA.config.DISABLE_JIT
"""False with ``NUMBA_DISABLE_JIT=1``: kernels are then plain Python."""
# Kernels allocate nothing, so numba need not count references to their arrays. Counting takes a tenth of the time of a
# step, and a tenth of the time of compilation.
_SETTINGS: dict[str, Any] = {"error_model": "numpy", "forceinline": False, "_nrt": False}
_INSIDE: dict[str, Any] = {**_SETTINGS, "nogil": True, "no_cfunc_wrapper": True}
_TINY: dict[str, Any] = {**_INSIDE, "forceinline": True, "no_cpython_wrapper": True}
"""Options for callbacks, for kernels and helpers, and for overloads that are inlined."""
_UNUSED_S = 60 * 86400.0
"""Seconds without use after which kernels of other sources are deleted."""
_ROOM_BYTES = 100 * 1024**2
"""Minimum free space for storing kernels."""
_DECORATING = threading.RLock()


def kernel(function: F) -> F:
    """Compile ``function`` with numba on first use, cached on disk, releasing the GIL.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead, slowly, for debugging.
    """
    return cast(F, _cached(_NUMBA.njit, function, "chemlab", **_INSIDE))


class _Helper:
    """A function for kernels. Its version for Python is compiled separately, when Python first calls it.

    numba spends about half of a small function's compilation on the conversion of Python's arguments.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self.inside = _NUMBA.njit(no_cpython_wrapper=True, **_INSIDE)(function)

    @functools.cached_property
    def outside(self) -> Any:
        return _cached(_NUMBA.njit, self.py_func, self.py_func.__module__, **_INSIDE)

    def __call__(self, *arguments: Any) -> Any:
        return self.outside(*arguments)

    def __reduce__(self) -> str:
        return self.py_func.__qualname__  # pickled by name, as a function


@_EXTENDING.typeof_impl.register(_Helper)  # type: ignore[untyped-decorator]
def _typeof(value: _Helper, context: Any) -> Any:
    return _TYPES.Dispatcher(value.inside)


def helper(function: F) -> F:
    """Compile ``function`` once for all kernels that call it; Python may also call it.

    A cached kernel contains it; only the version for Python is cached on its own.
    """
    return cast(F, _Helper(function)) if COMPILED else function


def inner(function: F) -> F:
    """Copy ``function`` into its callers before numba compiles them.

    For tiny functions, functions with a single call, and functions that return :func:`scratch` arrays. Compilation
    time grows with every copy.
    """
    return cast(F, _NUMBA.njit(inline="always", **_INSIDE)(function))


def chained(
    name: str, functions: Sequence[Callable[[Any, Handle], Any]], otherwise: Any
) -> Callable[[int, Any, Handle], Any]:
    """Return an inner function ``(number, work, chem)`` that calls one of several functions of (work, chem) by number.

    Args:
        name: its name.
        functions: kernels or helpers.
        otherwise: returned for a number past the last.
    """
    calls = [f"    if number == {i}:\n        return function_{i}(work, chem)\n" for i in range(len(functions))]
    scope: dict[str, Any] = {f"function_{i}": function for i, function in enumerate(functions)}
    scope |= {"otherwise": otherwise, "__name__": __name__}
    exec(f"def {name}(number, work, chem):\n{''.join(calls)}    return otherwise\n", scope)
    return inner(cast(Callable[[int, Any, Handle], Any], scope[name]))


class _NoCollection(_EVENT.Listener):  # type: ignore[misc]  # numba has no types
    """Stops the garbage collector while numba compiles: it would search the same structures again and again."""

    def __init__(self) -> None:
        self.running: list[bool] = []

    def on_start(self, event: Any) -> None:
        self.running.append(gc.isenabled())
        gc.disable()

    def on_end(self, event: Any) -> None:
        if self.running.pop():
            gc.enable()


_EVENT.register("numba:compile", _NoCollection())


# -- cache -----------------------------------------------------------------------------------------------------------


def _cached(compiler: Any, function: Callable[..., Any], place: str, *signature: Any, **options: Any) -> Any:
    """Apply one of numba's decorators to a function, with the cache in a :func:`folder`."""
    kept = folder(place) if COMPILED and os.path.isfile(function.__code__.co_filename) else None
    with _DECORATING:
        before, _NUMBA.config.CACHE_DIR = _NUMBA.config.CACHE_DIR, str(kept or "")
        try:
            return compiler(*signature, cache=kept is not None, **options)(function)
        finally:
            _NUMBA.config.CACHE_DIR = before


@functools.cache
def folder(module: str) -> Path | None:
    """Return the cache folder of kernels from chemlab's sources, and from those of another module (or package).

    It is below ``NUMBA_CACHE_DIR`` or the user's cache. None if kernels cannot be stored.
    """
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
        f"compiled kernels cannot be stored in {place} ({reason}), so every process compiles them again; set "
        "NUMBA_CACHE_DIR to another folder"
    )
    return None


def _delete_unused(place: Path) -> None:
    """Delete the kernels of sources that no process has used for :data:`_UNUSED_S`."""
    for other in place.glob("kernels-*"):
        with contextlib.suppress(OSError):
            if time.time() - other.stat().st_mtime > _UNUSED_S:
                shutil.rmtree(other, ignore_errors=True)


@functools.cache
def _sources(module: str) -> str:
    """Return a hash of all source files that contain the kernels of a module or package."""
    if module == "chemlab":
        root = Path(__file__).resolve().parents[1]
        kept = [root / "kernels", root / "physics"]
        # An edit to a file without kernels must not invalidate them.
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
    """Print a line if the block compiles kernels for the first time with this cache."""
    place = folder("chemlab")
    mark = place / f"{name}.compiled" if place is not None else None
    if COMPILED and not (mark is not None and mark.exists()):
        _say_once("compiling kernels for this machine (about a minute); later starts load them from the cache")
    yield
    if mark is not None:
        with contextlib.suppress(OSError):
            mark.touch()


# -- calls by address ------------------------------------------------------------------------------------------------


@functools.cache
def code_address(function: Any, signature: Any, module: str) -> int:
    """Compile a function as a callback and return its address, for :func:`call_address`.

    Args:
        function: a kernel or helper.
        signature: numba signature.
        module: name of the module that contains its source.
    """
    made = _cached(_NUMBA.cfunc, function.py_func, module, signature, **_SETTINGS)
    _ALIVE.append(made)
    return int(made.address)


_ALIVE: list[Any] = []
"""Callbacks whose addresses are in use."""


@functools.cache
def call_address(name: str, signature: Any) -> Any:
    """Return a function ``(address, arguments)`` with which kernels call a callback of a signature by its address."""

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
    """Return the arrays of a table from its handle, as an instance of ``declaration``.

    ``declaration`` is the table's schema, or one with the first of its fields. In a kernel, an array is loaded where it
    is used.
    """
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
    """Return a view of the array at an address."""
    size = dtype.itemsize * math.prod(lengths)
    if not size:
        return np.zeros(lengths, dtype)
    memory: Any = (ctypes.c_byte * size).from_address(address)
    return np.asarray(np.frombuffer(memory, dtype).reshape(lengths))


class _Table(_TYPES.Type):  # type: ignore[misc]  # numba has no types
    """numba type of a table: an address with the fields of a schema.

    Passing the arrays instead, about two hundred numbers for each call, takes longer to compile than the functions.
    """

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
    """Return the table at an address."""

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
    """Load a field of a table. Addresses and lengths are constant while kernels run, so each is loaded once."""
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
    data = builder.inttoptr(number(0), context.get_value_type(kind.dtype).as_pointer())
    return _array(context, builder, kind, data, [number(1 + axis) for axis in range(kind.ndim)])


def _array(context: Any, builder: Any, kind: Any, data: Any, lengths: list[Any]) -> Any:
    """Return an array with given lengths at an address; numba does not own its memory."""
    array = _BUILD.create_struct_proxy(kind)(context, builder)
    strides = [ir.Constant(ir.IntType(64), context.get_abi_sizeof(context.get_data_type(kind.dtype)))]
    array.itemsize = strides[0]
    for length in reversed(lengths):
        strides.insert(0, builder.mul(strides[0], length))
    array.data = builder.bitcast(data, array.data.type)
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
        """Return an uninitialized array [count] that exists while the calling kernel runs; ``count`` is a constant."""
        if not isinstance(count, _TYPES.IntegerLiteral):
            return None  # numba reports that no version fits
        kind, size = _TYPES.Array(_TYPES.float64, 1, "C"), ir.Constant(ir.IntType(64), count.literal_value)

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            memory = _BUILD.alloca_once(builder, target.get_value_type(_TYPES.float64), size=count.literal_value)
            return _array(target, builder, kind, memory, [size])

        return kind(count), generate

else:

    def scratch(count: int) -> FloatArray:
        """Return an uninitialized array [count]."""
        return np.empty(count)
