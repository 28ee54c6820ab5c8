"""Parts that a scenario names: chemlab's own in short, anybody's by where they are written.

``kind = "balance"`` is one of chemlab's; ``kind = "my_parts.py:Refractometer"`` is a name in a file beside the
scenario's own, ``kind = "package.module:Name"`` one in a package that Python can import.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType
from typing import Any

from .materials import DataError
from .scenario import Scenario

__all__ = ["load_part", "strangers_code"]


def _from_file(path: Path) -> ModuleType:
    """The module of a file, the same one each time."""
    name = f"chemlab_part_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None or spec.loader is None or not path.is_file():
            raise ImportError(f"no file {path}")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


_strangers: ContextVar[bool] = ContextVar("strangers", default=True)


@contextmanager
def strangers_code(allowed: bool) -> Iterator[None]:
    """Whether scenarios may name code that is not chemlab's while the block runs; where not, that is a DataError."""
    token = _strangers.set(allowed)
    try:
        yield
    finally:
        _strangers.reset(token)


def load_part(
    name: str, scenario: Scenario, key: str, known: Mapping[str, str] | None = None, base: type | None = None
) -> Any:
    """What a scenario names.

    Args:
        name: a short name of ``known``, ``file.py:Name`` (from the scenario's folder) or ``package.module:Name``.
        scenario: whose file names it.
        key: under which key, for error messages.
        known: ``package.module:Name`` by short name.
        base: class it must be derived from.

    Raises:
        DataError: it cannot be loaded, or is something else.
    """
    known = known or {}
    if name not in known and not _strangers.get():
        raise DataError(
            f"{scenario.origin}: {key}: needs {name!r}, which is imported only if you say that you trust it"
        )
    where, _, wanted = known.get(name, name).partition(":")
    try:
        if where.endswith(".py"):
            module = _from_file((Path(scenario.origin).parent / where).resolve())
        else:
            module = importlib.import_module(where)
        part = getattr(module, wanted)
        if base is not None and not (isinstance(part, type) and issubclass(part, base)):
            raise TypeError(f"{wanted} is not a {base.__name__}")
    except (ImportError, AttributeError, ValueError, TypeError, OSError, SyntaxError) as error:
        short = f"known: {', '.join(known)}; or name one" if known else "name it"
        raise DataError(
            f"{scenario.origin}: {key}: cannot load {name!r} ({error}); {short} as 'file.py:Name' or "
            "'package.module:Name'"
        ) from error
    return part
