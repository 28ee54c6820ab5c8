"""The one way a chemlab function is compiled."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import hashlib
import importlib.util
import math
import os
import pickle
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.core import caching, cgutils, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.datamodel import models
from numba.core.extending import _Intrinsic
from numba.core.runtime.nrt import rtsys
from numba.core.typing import templates
from numba.np import arrayobj

from .arrays import SLOT, Declared, FloatArray, Handle, declared

__all__ = [
    "COMPILED",
    "INLINED",
    "SETTINGS",
    "address",
    "calling",
    "chained",
    "helper",
    "inner",
    "is_compiled",
    "kernel",
    "only_one",
    "opened",
    "routine",
    "scratch",
]

_TYPES: Any = types
_BUILD: Any = cgutils
_ARRAYS: Any = arrayobj
_CACHE: Any = caching.FunctionCache
_CACHE_FILE: Any = caching.IndexDataCacheFile
_PLACES: Any = caching.CompileResultCacheImpl
_EXTENDING: Any = numba.extending
_MODELS: Any = models
_TEMPLATES: Any = templates
_LIBRARY: Any = JITCodeLibrary
_COMPILER: Any = Compiler
_RUNTIME: Any = rtsys
"""numba's insides, which have no types."""

fcntl: Any
try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None

_LONGEST_TURN = 600.0
"""Seconds that a process waits for another's kernel before it compiles its own: the largest takes half a minute, many
times that on a busy machine. A process that ends keeps nobody waiting."""

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


COMPILED: bool = not getattr(numba, "config").DISABLE_JIT  # noqa: B009 - numba makes its attributes up
"""Whether kernels are compiled; with ``NUMBA_DISABLE_JIT=1`` they are plain Python."""
# _nrt=False: kernels allocate nothing, so numba need not count references to the arrays handed to them; that
# counting (atomic, twice an array, at every inner call) took ten times as long as the physics.
# forceinline=False: a kernel would have it of an inlined function that is the first to call it, and then stand there as
# often as it is called.
SETTINGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "_nrt": False,
    "no_cfunc_wrapper": True,
    "forceinline": False,
}


class _NoEnvironment:
    """What a function needs to call Python is nowhere for one that has no code of its own."""

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing."""


class _InlinedLibrary(_LIBRARY):  # type: ignore[misc]  # numba has no types
    """What is only ever made part of kernels, which are optimized as a whole. numba makes machine code of every
    function, with all that is inlined in it, however deep it is nested: that took half of the time to compile."""

    codegen = _NoEnvironment()

    def finalize(self) -> None:
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _InlinedCompiler(_COMPILER):  # type: ignore[misc]  # numba has no types
    """numba's compiler, for functions that only kernels call."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        super().__init__(typing, target, library or _InlinedLibrary(target.codegen(), "inlined"), *rest)


INLINED: dict[str, Any] = {
    **SETTINGS,
    "forceinline": True,
    "no_cpython_wrapper": True,
    "pipeline_class": _InlinedCompiler,
}
"""numba's settings for a function that is made part of the kernels that call it."""


@functools.cache
def _sources() -> Any:
    """Hash of every source file of chemlab's that kernels are written in, to be gone on with in a copy."""
    root = Path(__file__).resolve().parent.parent
    made_of = {root / "kernels" / "arrays.py", root / "kernels" / "jit.py"}
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(root.rglob("*.py")):
        source = path.read_bytes()
        # An edit to a file without kernels, or what they are made of, must not have all of them compiled again.
        if path in made_of or (root / "physics") in path.parents or b"jit import" in source:
            digest.update(source)
    return digest


@functools.cache
def _fingerprint(own: str) -> str:
    """Hash of every source file kernels are written in, and of a kernel's ``own`` file."""
    digest = _sources().copy()
    digest.update(Path(own).read_bytes())
    return str(digest.hexdigest())


def kernel(function: F, **options: Any) -> F:
    """Compile ``function`` with numba on first use, cached on disk, releasing the GIL.

    With ``NUMBA_DISABLE_JIT=1`` the plain Python function runs instead, slowly, for debugging.
    """
    compiled: Any = numba.njit(**{**SETTINGS, **options})(function)
    if COMPILED:
        try:
            compiled._cache = _KernelCache(function)
            compiled.compile = _compile_in_turn(compiled)
        except RuntimeError as error:
            if "locator" not in str(error):
                raise
            _say_once("there is no folder to keep compiled kernels in: they are compiled anew in every process")
    return cast(F, compiled)  # numba's dispatcher stands in for the function


def _compile_in_turn(compiled: Any) -> Callable[[Any], Any]:
    """Compile a kernel, and let other processes go on however that ends: also where it is interrupted."""
    compile_once = compiled.compile

    def compile_(signature: Any) -> Any:
        try:
            return compile_once(signature)
        finally:
            compiled._cache._cache_file.end_turn()

    return compile_


class _KernelPlaces(_PLACES):  # type: ignore[misc]  # numba has no types
    """Where numba keeps kernels: in ``NUMBA_CACHE_DIR``, or else in the user's cache folder; beside the source only
    where neither can be written to. An installer does not take away what it did not put there, and a package's folder
    with nothing but kernels in it hides the package where that is installed next (``pip install -e .``)."""

    _locator_classes = sorted(_PLACES._locator_classes, key=lambda place: "InTree" in place.__name__)


class _KernelCache(_CACHE):  # type: ignore[misc]  # numba has no types
    """Where numba looks for a kernel before it compiles it."""

    _impl_class = _KernelPlaces

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = _fingerprint(function.__code__.co_filename)
        self._cache_file = _CheckedCacheFile(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The kernel, or None. numba prepares all that it would compile with first, which took half of the time to a
        first step; what is compiled needs its runtime alone, and whoever compiles prepares it all the same."""
        _RUNTIME.initialize(target)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, target)


@functools.cache
def _say_once(words: str) -> None:
    print(f"chemlab: {words}; NUMBA_CACHE_DIR names a folder for them", file=sys.stderr, flush=True)


class _CheckedCacheFile(_CACHE_FILE):  # type: ignore[misc]  # numba has no types
    """What numba keeps of one kernel, with a checksum: of a file that is cut or damaged, as of another version's,
    nothing is loaded, and the kernel is compiled again.

    numba tells whether a kernel is fresh by its own file's time stamp alone: one that inlines an edited function from
    another file would go on running the old code. The stamp here is of all sources.
    """

    def _dump(self, obj: Any) -> bytes:
        data: bytes = super()._dump(obj)
        return _checksum(data) + data

    def _read(self, path: str) -> Any:
        data = Path(path).read_bytes()
        size = len(_checksum(b""))
        return pickle.loads(data[size:]) if data[:size] == _checksum(data[size:]) else None

    def _save_index(self, overloads: dict[Any, str]) -> None:
        with self._open_for_write(self._index_path) as file:
            file.write(self._dump((self._version, self._source_stamp, overloads)))

    def _load_index(self) -> dict[Any, str]:
        try:
            version, stamp, overloads = self._read(self._index_path) or (None, None, {})
        except (OSError, AttributeError, ImportError, EOFError, TypeError, ValueError, pickle.UnpicklingError):
            # Not there yet; or it names classes of arguments that this version does not have any more.
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _load_data(self, name: str) -> Any:
        return self._read(self._data_path(name))

    def load(self, key: Any) -> Any:
        found = super().load(_keyed(key))
        if found is None and self._take_turn():
            found = super().load(_keyed(key))
            if found is not None:
                self.end_turn()
        return found

    def save(self, key: Any, data: Any) -> None:
        try:
            super().save(_keyed(key), data)
        except OSError as error:
            _say_once(f"compiled kernels cannot be kept in {self._cache_path} ({error.strerror})")
        self.end_turn()

    def _take_turn(self) -> bool:
        """Wait as long as another process compiles this kernel; it has left it in the cache then. False where there is
        no telling. Kernels wait for those that they call, and never the other way round."""
        end = time.monotonic() + _LONGEST_TURN
        while not (taken := _take(self._cache_path, self._index_name)) and time.monotonic() < end:
            time.sleep(0.05)
        return bool(taken)

    def end_turn(self) -> None:
        """Let other processes compile this kernel."""
        _give(self._cache_path, self._index_name)


def _byte(name: str) -> int:
    return zlib.crc32(name.encode())


def _take(folder: str, name: str) -> bool:
    """Take something in a folder of the cache, which one process at a time may have; True where there is no telling. A
    process that ends lets go of what it has."""
    turns = _turns(folder)
    try:
        if turns is not None:
            fcntl.lockf(turns, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _byte(name))
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks
        return True
    return True


def _give(folder: str, name: str) -> None:
    turns = _turns(folder)
    if turns is not None:
        with contextlib.suppress(OSError):
            fcntl.lockf(turns, fcntl.LOCK_UN, 1, _byte(name))


@contextlib.contextmanager
def only_one(function: Callable[..., Any]) -> Iterator[bool]:
    """Whether this process is the only one in such a block, of those that have a kernel's cache in common."""
    folder = getattr(getattr(function, "_cache", None), "_cache_path", None)
    taken = folder is None or _take(folder, "")
    try:
        yield taken
    finally:
        if taken and folder is not None:
            _give(folder, "")


@functools.cache
def _turns(folder: str) -> int | None:
    """A file in a folder of the cache, of which one process at a time may lock a byte; None without such locks."""
    with contextlib.suppress(OSError):
        if fcntl is not None:
            return os.open(os.path.join(folder, "turns.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    return None


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=16).digest()


def _keyed(key: Any) -> Any:
    """The key of a kernel's cache; with tiers of laws that are not chemlab's, theirs besides."""
    tiers = _other_tiers(tuple(getattr(sys.modules.get("chemlab.physics.chemistry"), "TIERS", {}).values()))
    return (key, tiers) if tiers else key


def _signature(key: Any) -> tuple[Any, ...]:
    """Types of a kernel's parameters, by its key in the cache."""
    signature: tuple[Any, ...] = (key[0] if isinstance(key[1], str) else key)[0]
    return signature


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


def inner(function: F) -> F:
    """A function that only kernels call, and that is always inlined: for what is called many times a step, and what
    takes opened tables."""
    return cast(F, _Part(function, INLINED)) if COMPILED else function


def helper(function: F) -> F:
    """A function that is always inlined in kernels, and that Python may call, too."""
    return cast(F, _Helper(function, INLINED)) if COMPILED else function


def routine(function: F) -> F:
    """A function of which a kernel has one copy however often it calls it, and that Python may call, too: for what is
    long and called in several places, which takes many times as long to compile if it is inlined in all of them."""
    return cast(F, _Helper(function, {**INLINED, "forceinline": False})) if COMPILED else function


class _Part:
    """What is made part of kernels: no sooner than one is compiled, because most never are in most processes."""

    def __init__(self, function: Callable[..., Any], settings: dict[str, Any]) -> None:
        functools.update_wrapper(cast(Any, self), function)
        self.py_func = function
        self._settings = settings

    @functools.cached_property
    def _dispatcher(self) -> Any:
        return numba.njit(**self._settings)(self.py_func)

    @property
    def _numba_type_(self) -> Any:
        return _TYPES.Dispatcher(self._dispatcher)

    def __reduce__(self) -> str:
        return self.py_func.__qualname__  # by its name, as functions are


class _Helper(_Part):
    """Two things by one name: what is made part of kernels, and a kernel for Python that is compiled if Python calls
    it."""

    @functools.cached_property
    def _kernel(self) -> Any:
        return kernel(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self._kernel(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in ("_kernel", "_settings", "py_func"):
            raise AttributeError(name)  # while a copy is being made
        return getattr(self._kernel, name)


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
    return inner(cast(Callable[[int, Any, Handle], Any], scope["call"]))


if not COMPILED:

    def calling(parameters: Sequence[str], table: int, position: int, kinds: Any, result: Any) -> Any:
        """Only what is compiled has an address."""
        raise NotImplementedError

    def address(function: Any, kinds: Any) -> int:
        """Only what is compiled has an address."""
        raise NotImplementedError

    def scratch(count: int) -> FloatArray:
        """[count] numbers to work with, of any value, for as long as the kernel that asks runs. ``count`` is a
        constant; what a helper has asked for is its kernel's."""
        return np.empty(count)

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

    class _Table(_TYPES.Type):  # type: ignore[misc]  # numba has no types
        """A table as kernels see it: where its handle is. Handing over the arrays instead, some two hundred numbers to
        each inlined function, took longer to compile than what the functions do."""

        def __init__(self, declaration: Any) -> None:
            self.declaration = declaration
            super().__init__(f"table of {declaration.__qualname__}")

        @property
        def key(self) -> Any:
            return self.declaration

        def kind(self, field: Declared) -> Any:
            """numba type of a field."""
            number = numba.from_dtype(field.dtype)
            return number if field.number else _TYPES.Array(number, len(field.axes), "C")

        def find(self, name: str) -> tuple[int, Declared]:
            """A field and where it stands."""
            return next((i, field) for i, field in enumerate(declared(self.declaration)) if field.name == name)

    @_EXTENDING.register_model(_Table)
    class _TableModel(_MODELS.PrimitiveModel):  # type: ignore[misc]
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, ir.IntType(64).as_pointer())

    @_EXTENDING.infer_getattr
    class _Fields(_TEMPLATES.AttributeTemplate):  # type: ignore[misc]
        key = _Table

        def generic_resolve(self, table: Any, name: str) -> Any:
            return table.kind(table.find(name)[1]) if name in table.declaration._fields else None

    @_EXTENDING.lower_getattr_generic(_Table)  # type: ignore[untyped-decorator]
    def _field(context: Any, builder: Any, table: Any, base: Any, name: str) -> Any:
        word, (at, field) = ir.IntType(64), table.find(name)
        kind = table.kind(field)

        def load(pointer: Any) -> Any:
            loaded = builder.load(pointer)
            # Where arrays are does not change while kernels run, whatever these write: it is looked up but once.
            loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
            return loaded

        def number(position: int) -> Any:
            return load(builder.gep(base, [ir.Constant(word, SLOT * at + position)]))

        if field.number:
            return load(builder.inttoptr(number(0), context.get_value_type(kind).as_pointer()))
        size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
        lengths = [number(1 + axis) for axis in range(kind.ndim)]
        strides: list[Any] = []
        step = ir.Constant(word, size)
        for length in reversed(lengths):
            strides.insert(0, step)
            step = builder.mul(step, length)
        array = _ARRAYS.make_array(kind)(context, builder)
        _ARRAYS.populate_array(
            array,
            data=builder.inttoptr(number(0), array.data.type),
            shape=_BUILD.pack_array(builder, lengths, ty=word),
            strides=_BUILD.pack_array(builder, strides, ty=word),
            itemsize=ir.Constant(word, size),
            meminfo=None,
        )
        return array._getvalue()

    def _open(context: Any, declaration: Any, handle: Any) -> Any:
        """The arrays of a table by its handle: what has the fields of the table's ``declaration``, or of one whose
        fields the table's begin with. In a kernel nothing is loaded but what is used; plain functions may call it,
        too."""

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _ARRAYS.make_array(handle)(target, builder, arguments[1]).data

        return _Table(declaration.instance_class)(declaration, handle), generate

    opened = _Opened("opened", _open)
    opened._register()

    def calling(parameters: Sequence[str], table: int, position: int, kinds: Any, result: Any) -> Any:
        """A function that kernels call by its address, so that its code is not made part of theirs: linking large
        kernels into everything that calls them took nine tenths of the time they take to compile.

        Args:
            parameters: names of its parameters.
            table: which of them is the handle that holds the address,
            position: and where.
            kinds: numba types of the parameters.
            result: numba type of what it returns.
        """

        def typed(*given: Any) -> Any:
            def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                array = _ARRAYS.make_array(signature.args[table])(target, builder, arguments[table])
                address = builder.load(builder.gep(array.data, [ir.Constant(ir.IntType(64), position)]))
                convention = target.call_conv
                called = convention.get_function_type(result, kinds)
                pointer = builder.inttoptr(address, called.as_pointer())
                # No kernel raises (error_model numpy), so there is no status to look at.
                return convention.call_function(builder, pointer, result, kinds, arguments)[1]

            return result(*kinds), generate

        listed = ", ".join(parameters)
        scope: dict[str, Any] = {"typed": typed}
        exec(f"def call(context, {listed}):\n    return typed({listed})", scope)
        return numba.extending.intrinsic(scope["call"])

    def address(function: Any, kinds: Any) -> int:
        """Where the compiled code of a kernel is, for some numba types of its parameters."""
        function.compile(tuple(kinds))
        compiled = function.overloads[tuple(kinds)]
        found: int = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
        return found

    @numba.extending.intrinsic(prefer_literal=True)
    def scratch(context: Any, count: Any) -> Any:
        """[count] numbers to work with, of any value, for as long as the kernel that asks runs. ``count`` is a
        constant; what a helper has asked for is its kernel's."""
        kind = _TYPES.Array(_TYPES.float64, 1, "C")
        if not isinstance(count, _TYPES.IntegerLiteral):
            return None  # numba says that no function takes it
        size = count.literal_value

        def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            word = ir.IntType(64)
            memory = _BUILD.alloca_once(builder, ir.ArrayType(ir.DoubleType(), size))
            array = _ARRAYS.make_array(kind)(target, builder)
            _ARRAYS.populate_array(
                array,
                data=builder.bitcast(memory, array.data.type),
                shape=_BUILD.pack_array(builder, [ir.Constant(word, size)], ty=word),
                strides=_BUILD.pack_array(builder, [ir.Constant(word, 8)], ty=word),
                itemsize=ir.Constant(word, 8),
                meminfo=None,
            )
            return array._getvalue()

        return kind(count), generate


def is_compiled(function: Callable[..., Any], dimensions: int) -> bool:
    """Whether a kernel that takes handles of chemistries [W, ..., numbers] with so many dimensions can be loaded from
    the disk cache (or would not be kept there), so that nobody has to wait for it."""
    cache_file = getattr(getattr(function, "_cache", None), "_cache_file", None)
    if cache_file is None:
        return True
    known = [*getattr(function, "overloads", ()), *(_signature(key) for key in cache_file._load_index())]
    handles = _TYPES.Array(_TYPES.int64, dimensions, "C")
    return any(handles in signature for signature in known)
