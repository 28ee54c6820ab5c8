"""Data files as TOML text, with the command and versions that made them."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from typing import Any

from .. import __version__
from ..config.datafile import toml_key


def significant(value: float, digits: int = 4) -> float:
    """Round ``value``, because the last bits of logarithms and roots differ between machines."""
    return float(f"{value:.{digits}g}")


def toml(value: Any) -> str:
    """Format a value on one line."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{toml_key(key)} = {toml(v)}" for key, v in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(v) for v in value) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # TOML has JSON's escapes, but not DEL
    return str(value).lower() if isinstance(value, bool) else repr(value)


def toml_tables(values: Mapping[str, Any], inline: Sequence[str] = (), at: str = "") -> list[str]:
    """Return the lines of a table: its values first, then its subtables with headings, and lists of tables.

    Args:
        values: content of the table.
        inline: keys of tables written on one line.
        at: dotted key of the table itself.
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
    """Return the origin of a file: the command, and the versions of chemlab and of installed packages."""
    found = {"command": command, "chemlab": __version__}
    for package in packages:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def material_text(
    tables: Mapping[str, Mapping[str, Any]],
    command: str,
    packages: Sequence[str] = ("chemicals", "thermo", "rdkit"),
) -> str:
    """Return the text of a material file.

    Args:
        tables: tables by material.
        command: command that made them.
        packages: packages used.
    """
    keys = ", and [KEY] at its end the table of the package chemicals or thermo" if packages else ""
    head = [
        "# Materials. Units and keys: see chemlab's page Write a material or a reaction. Made by the command below;",
        f"# a source says where each number is from{keys}.",
    ]
    locked = {"lock": lock(command, *packages)}
    lines = toml_tables({**locked, **tables}, inline=("composition", "absorption", "vapor_pressure", "dimerization"))
    return "\n".join([*head, *lines]) + "\n"


def family_text(tables: Mapping[str, Any]) -> str:
    """Return the text of a reaction file."""
    lines = [
        "# A reaction family. Units and keys: see chemlab's page Write a material or a reaction. Rates are per",
        "# second, so that a bench's tick is in seconds. Made by the command below.",
        *toml_tables(tables, inline=("reactants", "products", "orders", "catalysts", "solvents", "inhibitors")),
    ]
    return "\n".join(lines) + "\n"


def pair_text(
    rows: Sequence[Mapping[str, Any]],
    command: str,
    packages: Sequence[str] = ("chemicals", "numpy", "scipy", "thermo", "ugropy"),
) -> str:
    """Return the text of a pair file.

    Args:
        rows: a table for each pair.
        command: command that made them.
        packages: packages used.
    """
    lines = ["# Binary NRTL parameters: equation in chemlab/config/pairs.py. Made by the command below; do not edit."]
    # A top-level key must precede the first table.
    lines += ["", "pairs = [", *(f"    {toml(row)}," for row in rows), "]", "", "[lock]"]
    return "\n".join([*lines, *(f"{key} = {toml(value)}" for key, value in lock(command, *packages).items())]) + "\n"
