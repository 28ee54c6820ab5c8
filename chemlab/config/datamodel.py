"""Validation of values against models; violations raise :class:`~chemlab.config.datafile.DataError`.

Separate from :mod:`chemlab.config.datafile`, because importing pydantic takes as long as everything else that ``chemlab
--help`` needs.
"""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core.core_schema import no_info_before_validator_function

from .datafile import DataError, shown

_LINES = 20
T = TypeVar("T")


def _number(value: Any) -> Any:
    if isinstance(value, (bool, str)):
        raise ValueError(f"must be a number, not {'true or false' if isinstance(value, bool) else 'a text'}")
    return value


def _numeric(schema: Any) -> Any:
    """Return a schema of pydantic whose numbers reject texts and booleans."""
    if isinstance(schema, list):
        return [_numeric(part) for part in schema]
    if not isinstance(schema, dict) or schema.get("function") == {"type": "no-info", "function": _number}:
        return schema
    made = {key: _numeric(part) for key, part in schema.items()}
    return no_info_before_validator_function(_number, made) if made.get("type") in ("int", "float") else made


class DataModel(BaseModel):
    """Immutable values of a file; unknown keys, NaN, infinity, and texts or booleans as numbers are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        return _numeric(handler(source))


_WORDS = {
    "extra_forbidden": "unknown key",
    "missing": "is required",
    "dict_type": "must be a table of keys and values",
    "model_type": "must be a table of keys and values",
}
"""Problems in the words of files, by pydantic's name."""


_ALTERNATIVE = re.compile(r"tuple\[|constrained-|literal\[|function-")
"""Pydantic's names of some alternatives of a value's type, which are no keys."""


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models(inner)


def _hint(kind: Any, place: Sequence[int | str], others: Sequence[str]) -> str:
    """Return what an unknown key may have meant, as the end of a sentence."""
    *path, key = place
    models = list(_models(kind))
    for part in path:  # an index, a key of a table of models, or the kind of one of several models is no field
        inside = [
            one
            for model in models
            if part in model.model_fields
            for one in _models(model.model_fields[str(part)].annotation)
        ]
        one_kind = [
            one
            for one in models
            if "kind" in one.model_fields and part in get_args(one.model_fields["kind"].annotation)
        ]
        models = inside or one_kind or models
    known = [*dict.fromkeys(field for model in models for field in model.model_fields), *others]
    near = difflib.get_close_matches(str(key), known, 1, 0.7)
    if near:
        return f"; did you mean {near[0]}?"
    return f"; known: {', '.join(known)}" if known else ""


def _described(error: ValidationError, where: str, kind: Any, others: Sequence[str]) -> str:
    """Turn a pydantic error into lines ``where: key: problem (given value)``."""
    found = error.errors(include_url=False)
    lines = []
    for item in found[:_LINES]:
        place = ".".join(str(part) for part in item["loc"] if not _ALTERNATIVE.match(str(part)))
        message = _WORDS.get(item["type"]) or re.sub(r"^Value error, ", "", item["msg"])
        given = item.get("input")
        message = re.sub(r"^\w+ should have (.*) after validation, not (\d+)$", r"must have \1, given \2", message)
        if item.get("ctx", {}).get("pattern", "").startswith("^[a-z]"):
            message = "must be lower-case letters, digits and _, beginning with a letter"
        if item["type"] in ("tuple_type", "list_type"):
            example = f", as in [{shown(given) if isinstance(given, str) else '1, 2'}]"
            tables = f" of tables, each under [[{place}]]"
            message = f"must be a list{tables if isinstance(given, dict) else example}"
        bare = isinstance(given, (dict, list, tuple, BaseModel)) or item["type"] == "missing"
        hint = _hint(kind, item["loc"], others) if item["type"] == "extra_forbidden" else ""
        words = message + ("" if bare else f", given {shown(given)}") + hint
        lines.append(": ".join(filter(None, (where, place, words))))
    if len(found) > _LINES:
        lines.append(f"{where}: and {len(found) - _LINES} more")
    return "\n".join(lines)


_reader: Callable[[Any], TypeAdapter[Any]] = functools.cache(TypeAdapter)


def validated(kind: type[T], values: Any, where: str, others: Sequence[str] = ()) -> T:
    """Build ``kind``, a model or a dataclass, from ``values``; an error about an unknown key also proposes ``others``.

    Raises:
        DataError: a value is invalid; the message names ``where`` and the key.
    """
    try:
        found: T = _reader(kind).validate_python(dict(values) if isinstance(values, Mapping) else values)
        return found
    except ValidationError as error:
        raise DataError(_described(error, where, kind, others)) from error


def written(model: BaseModel, without: Set[str] = frozenset()) -> dict[str, Any]:
    """Return a model's fields as JSON values, without those at their defaults and those named in ``without``."""
    return model.model_dump(mode="json", exclude_defaults=True, exclude=set(without))
