"""Data files as text: TOML, and what they were made with."""

from __future__ import annotations

import importlib.metadata
import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from .. import __version__

__all__ = ["lock", "toml", "toml_key", "toml_tables"]

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_key(key: str) -> str:
    """A key, in quotes where TOML wants them."""
    return key if _BARE.fullmatch(key) else toml(key)


def toml(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{toml_key(key)} = {toml(v)}" for key, v in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML has JSON's escapes
    return str(value).lower() if isinstance(value, bool) else repr(value)


def toml_tables(values: Mapping[str, Any], inline: Sequence[str] = (), at: str = "") -> list[str]:
    """Lines of a table: its own values first, then its tables, each with a heading, and lists of tables.

    Args:
        values: what it holds.
        inline: keys of tables that stand on one line.
        at: the dotted key of the table itself.
    """
    lines, below = [], []
    for key, value in values.items():
        name = toml_key(key)
        here = f"{at}.{name}" if at else name
        several = isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value) and key not in inline
        if several:
            for entry in value:
                below += ["", f"[[{here}]]", *toml_tables(entry, inline, here)]
        elif isinstance(value, Mapping) and key not in inline:
            made = toml_tables(value, inline, here)
            head = [] if made and not made[0] else ["", f"[{here}]"]
            below += [*head, *made]
        else:
            lines.append(f"{name} = {toml(value)}")
    return [*lines, *below]


def lock(command: str, *packages: str) -> dict[str, str]:
    """What a file was made by: the command, and versions of chemlab and of packages that are there."""
    found = {"command": command, "chemlab": __version__}
    for package in packages:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found
