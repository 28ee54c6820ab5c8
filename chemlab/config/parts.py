"""Parts that a scenario names: chemlab's own in short, anybody's by where they are written.

``kind = "balance"`` is one of chemlab's; ``kind = "my_parts.py:REFRACTOMETER"`` is a name in a file beside the
scenario's own, ``kind = "package.module:NAME"`` one in a package that Python can import.

The module of a file is called after where the file is, so another process that is sent a part of it finds it again.
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

__all__ = ["Part", "PartError", "blamed", "checked_numbers", "load_part", "may_run", "strangers_code", "trust"]

__path__: list[str] = []
"""Makes the modules of files submodules of this one; :class:`_Files` finds them."""


class PartError(RuntimeError):
    """A part of somebody's own does not do what a part of its kind does."""


class Part:
    """What a scenario may name. Where it was loaded by its name, it is also pickled by it."""

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
    """The module of a file, the same one each time."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    word = re.sub(r"\W", "_", path.stem)
    return importlib.import_module(f"{__name__}.{word}_{str(path).encode().hex()}")


_strangers: ContextVar[bool | None] = ContextVar("strangers", default=None)


@contextlib.contextmanager
def strangers_code(allowed: bool) -> Iterator[None]:
    """Whether files may make Python run code that is not chemlab's while the block runs: parts that a scenario names,
    and pickles without this user's seal (:mod:`chemlab.agents.seals`); where not, that is a DataError.

    Where nobody says so, a scenario that a Python program loads may name parts, as the program itself imports what it
    likes, and an unsealed pickle is refused. The ``chemlab`` command says so each time, by ``--trust``.
    """
    token = _strangers.set(allowed)
    try:
        yield
    finally:
        _strangers.reset(token)


def trust() -> bool | None:
    """What :func:`strangers_code` was told; None outside of it."""
    return _strangers.get()


def may_run(otherwise: bool) -> bool:
    """What :func:`strangers_code` was told, or ``otherwise`` outside of it."""
    told = trust()
    return otherwise if told is None else told


def load_part(
    name: str,
    scenario: Scenario,
    key: str,
    known: Mapping[str, str] | None = None,
    base: type | None = None,
    of: Any = None,
) -> Any:
    """What a scenario names.

    Args:
        name: a short name of ``known``, ``file.py:NAME`` (from the scenario's folder) or ``package.module:NAME``.
        scenario: whose file names it.
        key: under which key, for error messages.
        known: ``package.module:NAME`` by short name.
        base: class it must be derived from.
        of: class it must be an instance of.

    Raises:
        DataError: it cannot be loaded, or is something else.
    """
    known = known or {}
    if name not in known and not may_run(otherwise=True):
        raise DataError(
            f"{scenario.origin}: {key}: needs {name!r:.500}, which is code that is imported only if you say that you "
            "trust it: --trust"
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
            there = ", ".join(n for n in vars(module) if not n.startswith("_"))
            raise AttributeError(f"{where} has no {wanted!r}; it has {there:.500}")
        part = getattr(module, wanted)
        if base is not None and not (isinstance(part, type) and issubclass(part, base)):
            raise TypeError(f"{wanted} must be a subclass of {base.__module__}.{base.__name__}, and is {part!r:.200}")
        if of is not None and not isinstance(part, of):
            raise TypeError(f"{wanted} must be a {of.__module__}.{of.__name__}, and is {part!r:.200}")
    except Exception as error:  # whatever the file does when it is run
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
def blamed(name: str) -> Iterator[None]:
    """Say of any error inside whose it is: an error of a part must not be taken for one of its user's input.

    Raises:
        PartError: names the part and what was wrong.
    """
    try:
        yield
    except PartError:
        raise
    except Exception as error:
        raise PartError(f"{name}: {type(error).__name__}: {error}") from error


def checked_numbers(
    values: Any, shape: tuple[int, ...], name: str, low: float = -math.inf, high: float = math.inf
) -> FloatArray:
    """What a part has returned, as an array.

    Args:
        values: what it returned.
        shape: what that must have.
        name: of the part and its function, for error messages.
        low, high: bounds; what is past them by rounding is put there.

    Raises:
        PartError: another shape, a number that is not finite or out of bounds.
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
        bounds = (
            "finite" if low == -math.inf else f"from {low:g} to {high:g}: scale it, and cut off what is past its range"
        )
        raise PartError(f"{name}: must be {bounds}; given {given[tuple(at)]:g} at {at}")
    return given if low == -math.inf else np.clip(given, low, high)
