"""TOML text of data files, with the command and the versions that made them."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Mapping, Sequence
from typing import Any

from .. import __version__
from ..config.datafile import toml_key


def significant(value: float, digits: int = 4) -> float:
    """Round a number to significant digits, because the last bits of logarithms and roots differ between machines."""
    return float(f"{value:.{digits}g}")


def toml(value: Any) -> str:
    """Return a value as TOML on one line."""
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
    lines, subtables = [], []
    for key, value in values.items():
        name = toml_key(key)
        path = f"{at}.{name}" if at else name
        if key not in inline and isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            for entry in value:
                subtables += ["", f"[[{path}]]", *toml_tables(entry, inline, path)]
        elif key not in inline and isinstance(value, Mapping):
            content = toml_tables(value, inline, path)
            heading = [] if content and not content[0] else ["", f"[{path}]"]
            subtables += [*heading, *content]
        else:
            lines.append(f"{name} = {toml(value)}")
    return [*lines, *subtables]


def lock(command: str, *packages: str) -> dict[str, str]:
    """Return the origin of a file: the command, and the versions of chemlab and of installed packages."""
    origin = {"command": command, "chemlab": __version__}
    for package in packages:
        try:
            origin[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            origin[package] = "not installed"
    return origin


def material_text(
    tables: Mapping[str, Mapping[str, Any]], command: str, packages: Sequence[str] = ("chemicals", "thermo", "rdkit")
) -> str:
    """Return the text of a material file.

    Args:
        tables: tables by material.
        command: command that made them.
        packages: packages whose versions are listed.
    """
    keys = ", and [KEY] at its end the table of the package chemicals or thermo" if packages else ""
    head = [
        "# Materials. Units and keys: see chemlab's page Write a material or a reaction. Made by the command below;",
        f"# a source says where each number is from{keys}.",
    ]
    inline = ("composition", "absorption", "vapor_pressure", "dimerization")
    return "\n".join([*head, *toml_tables({"lock": lock(command, *packages), **tables}, inline)]) + "\n"


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
        packages: packages whose versions are listed.
    """
    lines = ["# Binary NRTL parameters: equation in chemlab/config/pairs.py. Made by the command below; do not edit."]
    # A top-level key must precede the first table.
    lines += ["", "pairs = [", *(f"    {toml(row)}," for row in rows), "]", "", "[lock]"]
    return "\n".join([*lines, *(f"{key} = {toml(value)}" for key, value in lock(command, *packages).items())]) + "\n"
