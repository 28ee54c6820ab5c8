"""The one way a chemlab function is compiled."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
import math
import pickle
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.extending import _Intrinsic
from numba.np import arrayobj

from .arrays import SLOT, Handle, declared

__all__ = ["COMPILED", "SETTINGS", "announce_compiling", "chained", "helper", "inner", "kernel", "opened"]

_announced = False

_TYPES: Any = types
_BUILD: Any = cgutils
_ARRAYS: Any = arrayobj
"""numba's insides, which have no types."""

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


COMPILED: bool = not getattr(numba, "config").DISABLE_JIT  # noqa: B009 - numba makes its attributes up
"""Whether kernels are compiled; with ``NUMBA_DISABLE_JIT=1`` they are plain Python."""
# _nrt=False: kernels allocate nothing, so numba need not count references to the arrays handed to them; that
# counting (atomic, twice an array, at every inner call) took ten times as long as the physics.
SETTINGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}


@functools.cache
def _fingerprint(own: str) -> str:
    """Hash of every source file kernels are written in, and of a kernel's ``own`` file."""
    root = Path(__file__).resolve().parent
    made_of = {root / name for name in ("arrays.py", "chemistry.py", "jit.py", "shelf.py")}
    digest = hashlib.blake2b(digest_size=16)
    for path in [*sorted(root.rglob("*.py")), Path(own)]:
        source = path.read_bytes()
        # An edit to a file without kernels, or what they are made of, must not have all of them compiled again.
        if path in made_of or (root / "physics") in path.parents or b"jit import" in source:
            digest.update(source)
    return digest.hexdigest()


def kernel(function: F, **options: Any) -> F:
    """Compile ``function`` with numba on first use, cached on disk, releasing the GIL.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead, slowly, for debugging.
    """
    compiled: Any = numba.njit(**{"cache": True, **SETTINGS, **options})(function)
    # numba invalidates a cached kernel by its own file's time stamp alone: a kernel that inlines an edited
    # function from another file would go on running the old code. One stamp over all sources mends that.
    cache_file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if cache_file is not None and hasattr(cache_file, "_source_stamp"):
        cache_file._source_stamp = _fingerprint(function.__code__.co_filename)
        cache_file._load_index = functools.partial(_index_or_nothing, cache_file._load_index)
        for name in ("load", "save"):
            setattr(cache_file, name, functools.partial(_keyed, getattr(cache_file, name)))
    return cast(F, compiled)  # numba's dispatcher stands in for the function


def _index_or_nothing(load: Callable[[], Any]) -> Any:
    """What a kernel's cache holds; nothing if it is another version's.

    An index names argument types by their classes. One that this version does not have any more must mean compiling
    again, not an error.
    """
    try:
        return load()
    except (AttributeError, ImportError, EOFError, TypeError, ValueError, pickle.UnpicklingError):
        return {}


def _keyed(access: Callable[..., Any], key: Any, *data: Any) -> Any:
    """Read or write a kernel's cache under ``key``; with tiers of laws that are not chemlab's under theirs besides."""
    tiers = _other_tiers(tuple(getattr(sys.modules.get("chemlab.chemistry"), "TIERS", {}).values()))
    return access((key, tiers) if tiers else key, *data)


@functools.cache
def _other_tiers(modules: tuple[str, ...]) -> str:
    """Hash of the sources of the tiers that are not chemlab's, in the order that numbers them; empty without any."""
    others = [(number, name) for number, name in enumerate(modules) if not name.startswith("chemlab.")]
    digest = hashlib.blake2b(digest_size=16)
    for number, name in others:
        spec = importlib.util.find_spec(name)
        origin = Path(spec.origin) if spec is not None and spec.origin else None
        files = sorted(origin.parent.rglob("*.py")) if origin and origin.name == "__init__.py" else [origin]
        digest.update(f"{number} {name} ".encode() + b"".join(file.read_bytes() for file in files if file))
    return digest.hexdigest() if others else ""


def helper(function: F) -> F:
    """A kernel that is always inlined: for what is called many times a step."""
    return kernel(function, forceinline=True)


def inner(function: F) -> F:
    """A helper that takes opened tables, and that only kernels call: what Python would hand over to it takes longer to
    compile than most of them."""
    return kernel(function, forceinline=True, no_cpython_wrapper=True)


def chained(functions: Sequence[Callable[[Any, Handle], Any]], otherwise: Any) -> Callable[[int, Any, Handle], Any]:
    """A helper ``(number, work, chem)`` that calls one of some functions of (work, chem) by its number.

    Args:
        functions: kernels or helpers.
        otherwise: what it returns past the last.
    """
    calls = [f"    if number == {i}:\n        return function_{i}(work, chem)\n" for i in range(len(functions))]
    scope: dict[str, Any] = {f"function_{i}": function for i, function in enumerate(functions)}
    scope["otherwise"] = otherwise
    exec(f"def call(number, work, chem):\n{''.join(calls)}    return otherwise\n", scope)
    # Always inlined in a kernel that has its own place in the cache.
    return kernel(
        cast(Callable[[int, Any, Handle], Any], scope["call"]), forceinline=True, cache=False, no_cpython_wrapper=True
    )


if not COMPILED:

    def opened(declaration: type[T], handle: Handle) -> T:
        """The arrays of a table by its handle, inside a kernel: an instance of the table's ``declaration``, or of one
        whose fields the table's begin with."""
        fields: tuple[str, ...] = declaration._fields  # type: ignore[attr-defined]
        return declaration(*(getattr(handle, name) for name in fields))

else:

    def _seen(address: int, lengths: Sequence[int], dtype: np.dtype[Any]) -> npt.NDArray[Any]:
        size = dtype.itemsize * math.prod(lengths)
        if not size:
            return np.zeros(lengths, dtype)
        memory: Any = (ctypes.c_byte * size).from_address(address)
        return np.asarray(np.frombuffer(memory, dtype).reshape(lengths))

    class _Opened(_Intrinsic):  # type: ignore[misc]  # numba has no types
        def __call__(self, declaration: Any, handle: Handle) -> Any:
            numbers, values = handle.reshape(-1).tolist(), []
            for at, field in enumerate(declared(declaration)):
                address, *lengths = numbers[SLOT * at : SLOT * at + 1 + len(field.axes)]
                array = _seen(address, lengths if not field.number else [1], field.dtype)
                values.append(array[0].item() if field.number else array)
            return declaration(*values)

    def _open(context: Any, declaration: Any, handle: Any) -> Any:
        """The arrays of a table by its handle: an instance of the table's ``declaration``, or of one whose fields the
        table's begin with. In a kernel nothing is loaded but what is used; plain functions may call it, too."""
        cls = declaration.instance_class
        fields = declared(cls)
        kinds = [
            numba.from_dtype(field.dtype)
            if field.number
            else _TYPES.Array(numba.from_dtype(field.dtype), len(field.axes), "C")
            for field in fields
        ]
        result = _TYPES.NamedTuple(kinds, cls)

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            word = ir.IntType(64)
            base = _ARRAYS.make_array(handle)(target, builder, arguments[1]).data

            def load(position: int) -> Any:
                return builder.load(builder.gep(base, [ir.Constant(word, position)]))

            values = []
            for i, kind in enumerate(kinds):
                address = load(SLOT * i)
                if fields[i].number:
                    pointer = builder.inttoptr(address, target.get_value_type(kind).as_pointer())
                    values.append(builder.load(pointer))
                    continue
                size = target.get_abi_sizeof(target.get_data_type(kind.dtype))
                lengths = [load(SLOT * i + 1 + axis) for axis in range(kind.ndim)]
                strides: list[Any] = []
                step = ir.Constant(word, size)
                for length in reversed(lengths):
                    strides.insert(0, step)
                    step = builder.mul(step, length)
                array = _ARRAYS.make_array(kind)(target, builder)
                _ARRAYS.populate_array(
                    array,
                    data=builder.inttoptr(address, array.data.type),
                    shape=_BUILD.pack_array(builder, lengths, ty=word),
                    strides=_BUILD.pack_array(builder, strides, ty=word),
                    itemsize=ir.Constant(word, size),
                    meminfo=None,
                )
                values.append(array._getvalue())
            return target.make_tuple(builder, result, values)

        return result(declaration, handle), generate

    opened = _Opened("opened", _open)
    opened._register()


def announce_compiling(*kernels: Callable[..., Any]) -> None:
    """Tell the user, once a process and on standard error, when kernels have to be compiled before the first steps."""
    global _announced
    if not _announced and not _is_compiled(*kernels):
        _announced = True
        print(
            "chemlab: compiling kernels for this machine (half a minute); later starts load them from the cache",
            file=sys.stderr,
            flush=True,
        )


def _is_compiled(*kernels: Callable[..., Any]) -> bool:
    """Whether each kernel can be loaded from the disk cache (or needs no compiling), so that nobody has to wait for
    it."""
    for function in kernels:
        cache_file = getattr(getattr(function, "_cache", None), "_cache_file", None)
        if cache_file is not None and not cache_file._load_index():
            return False
    return True
