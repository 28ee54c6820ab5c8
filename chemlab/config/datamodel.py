"""Validation of values against models; violations raise :class:`~chemlab.config.datafile.DataError`.

Separate from :mod:`chemlab.config.datafile`, because importing pydantic takes as long as everything else that ``chemlab
--help`` needs.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Set
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from .datafile import DataError, shown

_LINES = 20
T = TypeVar("T")


class DataModel(BaseModel):
    """Immutable values of a file; unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _described(error: ValidationError, where: str) -> str:
    """Turn a pydantic error into lines ``where: key: problem (given value)``."""
    found = error.errors(include_url=False)
    lines = []
    for item in found[:_LINES]:
        place = ".".join(str(part) for part in item["loc"])
        message = re.sub(r"^Value error, ", "", item["msg"])
        given = item.get("input")
        bare = isinstance(given, (dict, list, tuple, BaseModel)) or item["type"] == "missing"
        lines.append(": ".join(filter(None, (where, place, message))) + ("" if bare else f", given {shown(given)}"))
    if len(found) > _LINES:
        lines.append(f"{where}: and {len(found) - _LINES} more")
    return "\n".join(lines)


_reader: Callable[[Any], TypeAdapter[Any]] = functools.cache(TypeAdapter)


def validated(kind: type[T], values: Any, where: str) -> T:
    """Build ``kind``, a model or a dataclass, from ``values``.

    Raises:
        DataError: a value is invalid; the message names ``where`` and the key.
    """
    try:
        found: T = _reader(kind).validate_python(dict(values) if isinstance(values, Mapping) else values)
        return found
    except ValidationError as error:
        raise DataError(_described(error, where)) from error


def written(model: BaseModel, without: Set[str] = frozenset()) -> dict[str, Any]:
    """Return a model's fields as JSON values, without those at their defaults and those named in ``without``."""
    return model.model_dump(mode="json", exclude_defaults=True, exclude=set(without))
