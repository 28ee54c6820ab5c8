"""Compilation of chemlab's functions: numba's public interface, and the intrinsics of an extension below it.

A cached kernel (:mod:`.cache`) contains the code of all functions that it calls, under numba's names for them.
Functions that are made in a loop or a factory must therefore have different names.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import hashlib
import math
import os
import signal
import threading
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt
from numba import extending, types
from numba.core import cgutils, event
from numba.core.typing import templates

from .arrays import SLOT, FloatArray, Handle, declared
from .cache import folder

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")

COMPILED: bool = not numba.config.DISABLE_JIT
"""False with ``NUMBA_DISABLE_JIT=1``: kernels are then plain Python."""
# Kernels allocate nothing, so numba need not count references to their arrays. Counting takes a tenth of the time of a
# step, and a tenth of the time of compilation.
_SETTINGS: dict[str, Any] = {"error_model": "numpy", "forceinline": False, "_nrt": False}
_INSIDE: dict[str, Any] = {**_SETTINGS, "nogil": True, "no_cfunc_wrapper": True}
_TINY: dict[str, Any] = {**_INSIDE, "forceinline": True, "no_cpython_wrapper": True}
"""Options for callbacks, for kernels and helpers, and for overloads that are inlined."""
_DECORATING = threading.RLock()


class _WithoutGarbageCollector(event.Listener):  # type: ignore[misc]
    """Pauses Python's garbage collector while numba compiles: it would search numba's structures again and again.

    numba compiles in one thread at a time, and tells of functions that are compiled for others, too.
    """

    depth = 0
    collects = False

    def on_start(self, _: event.Event) -> None:
        if not self.depth:
            self.collects = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, _: event.Event) -> None:
        self.depth -= 1
        if self.collects and not self.depth:
            gc.enable()


class _Interruptible(event.Listener):  # type: ignore[misc]
    """Raises KeyboardInterrupt (Ctrl-C) only between two functions that numba compiles or loads.

    Within one, it may fall into a callback of LLVM, where Python prints and ignores it. A second one is raised at once.
    """

    depth = 0
    interrupted = False

    def on_start(self, _: event.Event) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self.note)
            self.depth, self.interrupted = 0, False
        self.depth += 1

    def on_end(self, _: event.Event) -> None:
        in_main_thread = threading.current_thread() is threading.main_thread()
        if not in_main_thread or signal.getsignal(signal.SIGINT) != self.note:
            return
        self.depth -= 1
        if not self.depth:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if self.interrupted:
            raise KeyboardInterrupt

    def note(self, number: int, frame: FrameType | None) -> None:
        """Note an interruption; a handler of signals."""
        if self.interrupted:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.default_int_handler(number, frame)
        self.interrupted = True


event.register("numba:compile", _WithoutGarbageCollector())
event.register("numba:compiler_lock", _Interruptible())


def kernel(function: F) -> F:
    """Compile ``function`` with numba on first use, cached on disk, releasing the GIL.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead, slowly, for debugging.
    """
    return cast(F, _cached(numba.njit, function, "chemlab", **_INSIDE))


class _Helper:
    """A function for kernels. Its version for Python is compiled separately, when Python first calls it.

    numba spends about half of a small function's compilation on the conversion of Python's arguments.
    """

    def __init__(self, function: Callable[..., Any], inside: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self.inside = numba.njit(no_cpython_wrapper=True, **_INSIDE)(inside)

    @functools.cached_property
    def outside(self) -> Any:
        return _cached(numba.njit, self.inside.py_func, self.py_func.__module__, **_INSIDE)

    def __call__(self, *arguments: Any) -> Any:
        return self.outside(*arguments)

    def __reduce__(self) -> str:
        return self.py_func.__qualname__  # pickled by name, as a function


@extending.typeof_impl.register(_Helper)  # type: ignore[untyped-decorator]
def _typeof(value: _Helper, context: Any) -> Any:
    return types.Dispatcher(value.inside)


def helper(function: F, inside: Callable[..., Any] | None = None) -> F:
    """Compile ``function`` once for all kernels that call it; Python may also call it.

    A cached kernel contains it, and LLVM optimizes it again there; only the version for Python is cached on its own.

    Args:
        function: the function.
        inside: what is compiled in its place, such as a call by its address.
    """
    return cast(F, _Helper(function, inside or function)) if COMPILED else function


def inner(function: F) -> F:
    """Copy ``function`` into its callers before numba compiles them.

    For tiny functions, functions with a single call, and functions that return :func:`scratch` arrays. Compilation
    time grows with every copy.
    """
    return cast(F, numba.njit(inline="always", **_INSIDE)(function))


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


def _cached(compiler: Any, function: Callable[..., Any], place: str, *signature: Any, **options: Any) -> Any:
    """Apply one of numba's decorators to a function, with the cache in a :func:`folder`."""
    kept = folder(place) if COMPILED and os.path.isfile(function.__code__.co_filename) else None
    with _DECORATING:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(kept or "")
        try:
            return compiler(*signature, cache=kept is not None, **options)(function)
        finally:
            numba.config.CACHE_DIR = before


# -- calls by address ------------------------------------------------------------------------------------------------


@functools.cache
def code_address(function: Any, signature: Any, module: str) -> int:
    """Compile a function as a callback and return its address, for :func:`call_address`.

    Args:
        function: a kernel or helper.
        signature: numba signature.
        module: name of the module that contains its source.
    """
    made = _cached(numba.cfunc, function.py_func, module, signature, **_SETTINGS)
    _ALIVE.append(made)
    return int(made.address)


_ALIVE: list[Any] = []
"""Callbacks whose addresses are in use."""


@functools.cache
def call_address(name: str, signature: Any) -> Any:
    """Return a function ``(address, arguments)`` with which kernels call a callback of a signature by its address."""

    def typed(context: Any, address: Any, arguments: Any) -> Any:
        def generate(target: Any, builder: Any, own: Any, values: Any) -> Any:
            given = zip(cgutils.unpack_tuple(builder, values[1]), arguments, signature.args, strict=True)
            cast_ = [target.cast(builder, value, kind, wanted) for value, kind, wanted in given]
            pointer = target.get_value_type(types.FunctionType(signature).ftype)
            return builder.call(builder.inttoptr(values[0], pointer), cast_)

        return signature.return_type(types.int64, arguments), generate

    typed.__name__ = typed.__qualname__ = f"call_{name}"
    return extending.intrinsic(typed)


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


@functools.cache
def _table_type(declaration: Any) -> Any:
    """Return the numba type of a table: an address with the fields of a schema.

    Passing the arrays instead, about two hundred numbers for each call, takes longer to compile than the functions.
    """
    kinds: dict[str, Any] = {}
    for field in declared(declaration):
        number = numba.from_dtype(field.dtype)
        kinds[field.name] = number if field.number else types.Array(number, len(field.axes), "C")
    digest = hashlib.blake2b(repr(kinds).encode(), digest_size=8).hexdigest()
    table = types.Opaque(f"{declaration.__qualname__}_{digest}")
    _FIELDS[table] = kinds
    return table


_FIELDS: dict[Any, dict[str, Any]] = {}
"""Types of the fields by the type of the table."""


@extending.infer_getattr
class _Fields(templates.AttributeTemplate):  # type: ignore[misc]  # infer_getattr requires this base class
    key = types.Opaque

    def generic_resolve(self, table: Any, name: str) -> Any:
        return _FIELDS.get(table, {}).get(name)


@extending.lower_getattr_generic(types.Opaque)  # type: ignore[untyped-decorator]
def _field(context: Any, builder: Any, table: Any, base: Any, name: str) -> Any:
    """Load a field of a table. Addresses and lengths are constant while kernels run, so each is loaded once."""
    kinds, word = _FIELDS[table], context.get_value_type(types.int64)
    at = SLOT * list(kinds).index(name)
    slots = builder.bitcast(base, word.as_pointer())

    def load(address: Any) -> Any:
        loaded = builder.load(address)
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    def number(i: int) -> Any:
        return load(cgutils.gep(builder, slots, at + i))

    kind = kinds[name]
    if not isinstance(kind, types.Array):
        return load(builder.inttoptr(number(0), context.get_value_type(kind).as_pointer()))
    data = builder.inttoptr(number(0), context.get_value_type(kind.dtype).as_pointer())
    return _array(context, builder, kind, data, [number(1 + axis) for axis in range(kind.ndim)])


@extending.intrinsic  # type: ignore[untyped-decorator]
def _table(context: Any, declaration: Any, handle: Any) -> Any:
    """Return the table at an address."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[1], cgutils.voidptr_t)

    return _table_type(declaration.instance_class)(declaration, types.int64), generate


def _array(context: Any, builder: Any, kind: Any, data: Any, lengths: list[Any]) -> Any:
    """Return an array with given lengths at an address; numba does not own its memory."""
    array = cgutils.create_struct_proxy(kind)(context, builder)
    size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    strides = [context.get_constant(types.intp, size)]
    array.itemsize = strides[0]
    for length in reversed(lengths):
        strides.insert(0, builder.mul(strides[0], length))
    array.data = builder.bitcast(data, array.data.type)
    array.nitems = functools.reduce(builder.mul, lengths)
    array.shape = cgutils.pack_array(builder, lengths)
    array.strides = cgutils.pack_array(builder, strides[1:])
    return array._getvalue()


@extending.overload(opened, jit_options=_TINY)
def _opened(declaration, handle):  # type: ignore[no-untyped-def]
    return lambda declaration, handle: _table(declaration, handle)


if COMPILED:

    @extending.intrinsic(prefer_literal=True)  # type: ignore[untyped-decorator]
    def scratch(context: Any, count: Any) -> Any:
        """Return an uninitialized array [count] that exists while the calling kernel runs; ``count`` is a constant."""
        if not isinstance(count, types.IntegerLiteral):
            return None  # numba reports that no version fits
        kind = types.Array(types.float64, 1, "C")

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            memory = cgutils.alloca_once(builder, target.get_value_type(types.float64), size=count.literal_value)
            return _array(target, builder, kind, memory, [target.get_constant(types.intp, count.literal_value)])

        return kind(count), generate

    @extending.intrinsic  # type: ignore[untyped-decorator]
    def part(context: Any, whole: Any, at: Any, count: Any) -> Any:
        """Return a view [count] of scratch [n], from index ``at`` on; its bounds are not checked."""
        kind = types.Array(types.float64, 1, "C")

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            memory = cgutils.create_struct_proxy(kind)(target, builder, value=arguments[0]).data
            return _array(target, builder, kind, builder.gep(memory, [arguments[1]]), [arguments[2]])

        return kind(kind, types.intp, types.intp), generate

else:

    def scratch(count: int) -> FloatArray:
        """Return an uninitialized array [count]."""
        return np.empty(count)

    def part(whole: FloatArray, at: int, count: int) -> FloatArray:
        """Return a view [count] of an array [n], from index ``at`` on."""
        return whole[at : at + count]
