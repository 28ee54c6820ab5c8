"""Models of data, and values checked against them: what is wrong is a :class:`~chemlab.config.datafile.DataError`.

Apart from :mod:`chemlab.config.datafile`, because importing pydantic takes as long as all else that ``chemlab
--help`` needs.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import BaseModel, SerializerFunctionWrapHandler, TypeAdapter, ValidationError, model_serializer

from .datafile import DataError, shown

__all__ = ["Grown", "validated"]

_LINES = 20


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


@functools.cache
def _reader(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def validated(kind: type, values: Any, where: str) -> Any:
    """Build ``kind``, a model or a dataclass, from ``values``.

    Raises:
        DataError: that cannot be; the message names ``where`` and the key.
    """
    try:
        return _reader(kind).validate_python(dict(values) if isinstance(values, Mapping) else values)
    except ValidationError as error:
        raise DataError(_described(error, where)) from error


class Grown(BaseModel):
    """A model that has got fields since its first version: they are left out of what is written down while they are at
    their defaults, so that a scenario that does not use them is the same as ever, down to its hash in a record."""

    _later: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _dumped(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = dump(self)
        for key in self._later:
            if getattr(self, key) == type(self).model_fields[key].default:
                values.pop(key, None)
        return values
