"""Parts that a scenario names: built-in ones by short name, user-defined ones by file or module.

``kind = "balance"`` is a built-in part. ``kind = "my_parts.py:REFRACTOMETER"`` is a name in a file beside the scenario,
and ``kind = "package.module:NAME"`` a name in an importable package.

The module name of a file contains the file's path, so that another process that receives a pickled part can import it.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .datafile import DataError

if TYPE_CHECKING:
    from ..kernels.arrays import FloatArray
    from .scenario import Scenario

__path__: list[str] = []
"""Makes the modules of files submodules of this one; :class:`_Files` finds them."""


class PartError(RuntimeError):
    """A user-defined part violates the interface of its kind."""


class Part:
    """Base class of objects that a scenario may name. An object loaded by name is pickled by name."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        where = vars(self).get("_where")
        return super().__reduce_ex__(protocol) if where is None else (_named, where)


def _named(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


class _Files(importlib.abc.MetaPathFinder):
    """Finds the module of a file by its name, which ends with the file's path in hexadecimal."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if not name.startswith(f"{__name__}."):
            return None
        return importlib.util.spec_from_file_location(name, bytes.fromhex(name.rpartition("_")[2]).decode())


sys.meta_path.append(_Files())


def _from_file(path: Path) -> ModuleType:
    """Return the module of a file, importing it at most once."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    word = re.sub(r"\W", "_", path.stem)
    return importlib.import_module(f"{__name__}.{word}_{str(path).encode().hex()}")


_strangers: ContextVar[bool | None] = ContextVar("strangers", default=None)


@contextlib.contextmanager
def strangers_code(allowed: bool) -> Iterator[None]:
    """Allow or forbid untrusted code inside the block: parts named by a scenario, and unsigned pickles.

    Forbidden code raises DataError. Outside of any block, a scenario loaded by a Python program may name parts, because
    the program itself can import anything, and an unsigned pickle (:mod:`chemlab.agents.seals`) is rejected. The
    ``chemlab`` command always sets it, by ``--trust``.
    """
    token = _strangers.set(allowed)
    try:
        yield
    finally:
        _strangers.reset(token)


def trust() -> bool | None:
    """Return the value of the enclosing :func:`strangers_code`; None outside of it."""
    return _strangers.get()


def may_run(otherwise: bool) -> bool:
    """Return the value of the enclosing :func:`strangers_code`, or ``otherwise`` outside of it."""
    told = trust()
    return otherwise if told is None else told


def _imported(one: Any, module: ModuleType) -> bool:
    """Return whether a name of a module is another module, or a class or function of one."""
    return isinstance(one, ModuleType) or (hasattr(one, "__qualname__") and one.__module__ != module.__name__)


def load_part(
    name: str,
    scenario: Scenario,
    key: str,
    known: Mapping[str, str] | None = None,
    base: type | None = None,
    of: Any = None,
) -> Any:
    """Load a part that a scenario names.

    Args:
        name: a short name of ``known``, ``file.py:NAME`` (relative to the scenario's folder) or
            ``package.module:NAME``.
        scenario: the scenario that names it.
        key: the key that names it, for error messages.
        known: ``package.module:NAME`` by short name.
        base: required base class.
        of: required class of the instance.

    Raises:
        DataError: it cannot be loaded, or is of another type.
    """
    known = known or {}
    if name not in known and ":" in name and not may_run(otherwise=True):
        raise DataError(
            f"{scenario.origin}: {key}: needs the untrusted code {name!r:.500}, which is imported only if you "
            "allow it: --trust"
        )
    where, colon, wanted = known.get(name, name).rpartition(":")
    try:
        if not (colon and where and wanted):
            raise ValueError("no such kind" if known else "it has no colon")
        if where.endswith(".py"):
            module = _from_file((Path(scenario.origin).parent / where).resolve())
        else:
            module = importlib.import_module(where)
        if not hasattr(module, wanted):
            own = (n for n, one in vars(module).items() if not n.startswith("_") and not _imported(one, module))
            there = ", ".join(own)
            raise AttributeError(f"{where} has no {wanted!r}; it has {there:.500}")
        part = getattr(module, wanted)
        if base is not None and not (isinstance(part, type) and issubclass(part, base)):
            raise TypeError(f"{wanted} must be a subclass of {base.__module__}.{base.__name__}, and is {part!r:.200}")
        if of is not None and not isinstance(part, of):
            raise TypeError(f"{wanted} must be a {of.__module__}.{of.__name__}, and is {part!r:.200}")
    except (Exception, SystemExit) as error:  # arbitrary errors of the imported file; one that exits is no success
        short = f"known: {', '.join(known)}; or name one" if known else "name it"
        kind = (
            "" if isinstance(error, (ValueError, TypeError, AttributeError, OSError)) else f"{type(error).__name__}: "
        )
        raise DataError(
            f"{scenario.origin}: {key}: cannot load {name!r} ({kind}{error}); {short} as 'file.py:NAME', from the "
            "scenario's folder, or 'package.module:NAME'"
        ) from error
    if isinstance(part, Part):
        vars(part)["_where"] = module.__name__, wanted
    return part


@contextlib.contextmanager
def blamed(name: str, *others: type[Exception]) -> Iterator[None]:
    """Attribute any error inside the block to the part, so that it is not taken for an input error of the user.

    Args:
        name: of the part.
        others: errors that are not the part's.

    Raises:
        PartError: names the part and the error.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, (PartError, *others)):
            raise
        raise PartError(f"{name}: {type(error).__name__}: {error}") from error


def checked_numbers(
    values: Any, shape: tuple[int, ...], name: str, low: float = -math.inf, high: float = math.inf
) -> FloatArray:
    """Validate numbers returned by a part and return them as an array.

    Args:
        values: the returned values.
        shape: required shape.
        name: name of the part and its function, for error messages.
        low, high: bounds; values beyond them by rounding are clipped.

    Raises:
        PartError: the shape is wrong, or a number is not finite or out of bounds.
    """
    import numpy as np

    try:
        given = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise PartError(f"{name}: must be numbers of shape {shape}, given {values!r:.200}") from None
    if given.shape != shape:
        raise PartError(f"{name}: must have shape {shape}, given shape {given.shape}")
    wrong = ~(np.isfinite(given) & (given >= low - 1e-6) & (given <= high + 1e-6))
    if wrong.any():
        at = np.argwhere(wrong)[0].tolist()
        bounds = "finite" if low == -math.inf else f"from {low:g} to {high:g}: scale it and clip it to this range"
        raise PartError(f"{name}: must be {bounds}; given {given[tuple(at)]:g} at {at}")
    return given if low == -math.inf else np.clip(given, low, high)
