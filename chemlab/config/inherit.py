"""Inheritance of scenario files: keys from ``base``, levels, and defaults of the bench kinds.

It works on parsed files before they are validated by the models of :mod:`chemlab.config.scenario`.
"""

from __future__ import annotations

import copy
import difflib
import functools
import importlib.resources
import os.path
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .datafile import DataError, dotted_key, read_toml, shown

_BENCHES = Path(__file__).resolve().parent.parent / "data" / "benches"
_LONGEST_CHAIN = 16
_TOP = 3
"""Level of a scenario as its file has it."""


def scenario_folder() -> Path:
    """Return the folder of the bundled scenario files."""
    try:
        folder = Path(str(importlib.resources.files("chemlab.scenarios")))
        if folder.is_dir() and any(folder.glob("*.toml")):
            return folder
    except ModuleNotFoundError:
        pass  # a checkout on sys.path that is not installed: the files are beside the package
    return Path(__file__).resolve().parents[2] / "scenarios"


def scenario_names() -> list[str]:
    """Return the names of the bundled benchmark scenarios."""
    return sorted(path.stem for path in scenario_folder().glob("*.toml"))


def synthesis_names() -> list[str]:
    """Return the names of the bundled syntheses: scenarios that reproduce publications."""
    return sorted(path.stem for path in (scenario_folder() / "syntheses").glob("*.toml"))


def campaign_names() -> list[str]:
    """Return the names of the bundled campaigns: scenarios made for :class:`chemlab.campaign.Campaign`."""
    return sorted(path.stem for path in (scenario_folder() / "campaigns").glob("*.toml"))


def split_level(name: str) -> tuple[str, int | None]:
    """Return a scenario's name or path without its level, and the level: ``unlabelled@1``; None: none is given."""
    found = re.fullmatch(r"(.+)@([0-9]{1,9})", name, re.ASCII)
    return (name, None) if found is None else (found[1], int(found[2]))


def shipped_file(name: object) -> Path | None:
    """Return the file of a bundled scenario, campaign or synthesis, at any level; None for any other name."""
    if isinstance(name, str):
        name, _ = split_level(name)
    for folder, names in (("", scenario_names()), ("syntheses", synthesis_names()), ("campaigns", campaign_names())):
        if name in names:
            return scenario_folder() / folder / f"{name}.toml"
    return None


def files_of(path: Path) -> list[Path]:
    """Return a scenario's file and the existing files that it names: bases, materials, pairs, reactions and parts.

    Raises:
        DataError: one of them is malformed.
    """
    found: list[Path] = []
    left = [path]
    while left:
        file = Path(os.path.normpath(left.pop()))
        if os.path.isfile(file) and file not in found:
            found.append(file)
            texts = _texts(read_toml(file)) if file.suffix == ".toml" else ()
            left += [file.parent / name[0] for text in texts if (name := _FILE.match(text))]
    return found


_FILE = re.compile(r".+\.toml$|.+\.py(?=:)")


def _texts(value: Any) -> Iterator[str]:
    """All texts in a parsed file."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, (list, Mapping)):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(item)


@functools.cache
def _shipped_benches() -> dict[str, dict[str, Any]]:
    return {path.stem: read_toml(path) for path in sorted(_BENCHES.glob("*.toml"))}


def bench_defaults(kind: object) -> Mapping[str, Any]:
    """Return the defaults of a bench kind from ``data/benches``; empty for a kind without a file there."""
    return _shipped_benches().get(kind, {}) if isinstance(kind, str) else {}


def completed(values: Mapping[str, Any], where: str, folder: Path, level: int | None = None) -> dict[str, Any]:
    """Resolve the inheritance of a scenario file.

    Args:
        values: the parsed file.
        where: the file, for error messages.
        folder: folder to which its relative paths refer.
        level: level of the scenario; None: as the file has it.

    Returns:
        The base's tables with the file's own merged into them key by key, without the keys that the file removes.
        The tables of a level, and before it of those between it and the file's own, are merged in the same way.
        Missing keys of each bench are then filled from its kind. A bench's key is taken whole, from one or the other.

    Raises:
        DataError: the base is unknown or inherits from this file; a key to be removed does not exist; an empty table
            has no effect; the level is not declared; a bench is of an unknown kind.
    """
    content = _at_level(_inherited(values, where, folder, ()), where, level)
    benches = content.get("benches")
    if isinstance(benches, Mapping):
        content["benches"] = {
            key: _whole(bench, f"{where}: benches.{key}") if isinstance(bench, Mapping) else bench
            for key, bench in benches.items()
        }
    return content


def _at_level(content: dict[str, Any], where: str, level: int | None) -> dict[str, Any]:
    """Merge the tables ``levels.N`` of a scenario into it, from those below the top down to ``level``."""
    levels = content.pop("levels", {})
    known = {str(number) for number in range(1, _TOP)}
    if not isinstance(levels, Mapping) or not set(levels) <= known:
        raise DataError(f"{where}: levels: must be tables [levels.1] and [levels.2], given {shown(levels)}")
    for number, own in levels.items():
        if not isinstance(own, Mapping):
            raise DataError(f"{where}: levels.{number}: must be a table, given {shown(own)}")
        _check_remove(own.get("remove", []), f"{where}: levels.{number}")
    if level is None or (level == _TOP and levels):
        return content
    if str(level) not in levels:
        choice = f"choose from {', '.join([*sorted(levels), str(_TOP)])}" if levels else "it has none"
        raise DataError(f"{where}: level {level}: not declared under levels; {choice}")
    for number in range(_TOP - 1, level - 1, -1):
        own = dict(levels.get(str(number), {}))
        here = f"{where}: levels.{number}"
        for entry in own.pop("remove", []):
            content = _without(content, dotted_key(entry, f"{here}.remove"), entry, f"{here}.remove", where)
        content = _merged(content, own, here, ())
    return {**content, "name": f"{content.get('name')}@{level}"}


def declared_levels(path: Path) -> list[int]:
    """Return the levels of a scenario file besides its own.

    Raises:
        DataError: the file, or a base of it, cannot be read.
    """
    return sorted(int(number) for number in _inherited(read_toml(path), str(path), path.parent, ()).get("levels", {}))


def _check_remove(remove: Any, where: str) -> None:
    if not isinstance(remove, (list, tuple)):
        raise DataError(f'{where}: remove: must be a list of keys, as ["benches.ext"], given {shown(remove)}')


def _whole(bench: Mapping[str, Any], where: str) -> dict[str, Any]:
    kind = bench.get("kind")
    if isinstance(kind, str) and ":" not in kind and kind not in _shipped_benches():
        raise DataError(
            f"{where}.kind: unknown kind {kind!r:.200}; choose from {', '.join(_shipped_benches())}, or your own, "
            "'file.py:NAME'"
        )
    more = {key: value for key, value in bench_defaults(kind).items() if key not in bench}
    return {**bench, **copy.deepcopy(more)}


def _inherited(values: Mapping[str, Any], where: str, folder: Path, above: tuple[str, ...]) -> dict[str, Any]:
    own = dict(values)
    if "base" not in own:
        if misspelt := difflib.get_close_matches("base", own, 1, 0.7):
            raise DataError(f"{where}: {misspelt[0]}: unknown key; did you mean base?")
        if "remove" in own:
            raise DataError(f"{where}: remove: requires a base, and this scenario has none")
        return own
    base, remove = own.pop("base"), own.pop("remove", [])
    if split_level(str(base))[1] is not None:
        raise DataError(f"{where}: base: {base!r:.200} must not have a level; give the level to this scenario: NAME@1")
    path = shipped_file(base) or folder / str(base)
    if path.suffix != ".toml" or not os.path.isfile(path):
        shipped = ", ".join([*scenario_names(), *campaign_names(), *synthesis_names()])
        raise DataError(f"{where}: base: unknown {base!r:.200}; choose from {shipped}, or give a .toml file")
    if str(path.resolve()) in above:
        raise DataError(f"{where}: base: {base!r} inherits from this scenario")
    if len(above) >= _LONGEST_CHAIN:
        raise DataError(f"{where}: base: more than {_LONGEST_CHAIN} nested bases")
    under = _inherited(read_toml(path), str(path), path.parent, (*above, str(path.resolve())))
    under = _files_from(under, folder, path.parent)
    _check_remove(remove, where)
    for entry in remove:
        under = _without(under, dotted_key(entry, f"{where}: remove"), entry, f"{where}: remove", str(base))
    return _merged(under, own, where, ())


_FILES = ("material_files", "pair_files", "reactions", "kind", "model", "observe", "reward")
"""Keys whose values name data files (``file.toml``) or parts (``file.py:NAME``), anywhere in the file."""


def _files_from(value: Any, folder: Path, base: Path) -> Any:
    """Rewrite the data files and the parts (``file.py:NAME``) of a base's tables relative to another folder."""
    if isinstance(value, list):
        return [_files_from(item, folder, base) for item in value]
    if not isinstance(value, Mapping):
        return value
    return {
        key: _file_from(item, folder, base) if key in _FILES else _files_from(item, folder, base)
        for key, item in value.items()
    }


def _file_from(name: Any, folder: Path, base: Path) -> Any:
    if isinstance(name, list):
        return [_file_from(item, folder, base) for item in name]
    found = _FILE.match(name) if isinstance(name, str) else None
    if found is None:
        return name
    try:
        path = os.path.relpath(base / found[0], folder)
    except ValueError:  # another drive
        path = str((base / found[0]).resolve())
    return f"{Path(path).as_posix()}{name[found.end() :]}"


def _without(table: Mapping[str, Any], key: list[str], entry: str, where: str, base: str) -> dict[str, Any]:
    """Return ``table`` without ``key``, which must exist."""
    first, rest = key[0], key[1:]
    if first not in table or (rest and not isinstance(table[first], Mapping)):
        there = ", ".join(table) if first not in table else f"{first}, which is not a table"
        raise DataError(f"{where}: {entry!r} is not in the base {base!r}: {there:.1000} is there")
    kept = dict(table)
    if rest:
        kept[first] = _without(kept[first], rest, entry, where, base)
    else:
        del kept[first]
    return kept


def _merged(under: Mapping[str, Any], own: Mapping[str, Any], where: str, path: tuple[str, ...]) -> dict[str, Any]:
    merged = dict(under)
    for key, value in own.items():
        below, here = merged.get(key), (*path, key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            if below and not value:
                name = ".".join(part if re.fullmatch(r"[\w-]+", part, re.ASCII) else f"'{part}'" for part in here)
                raise DataError(
                    f"{where}: {name}: an empty table has no effect; omit it, or remove the base's "
                    f'with remove = ["{name}"]'
                )
            value = _merged(below, value, where, here)
        merged[key] = value
    return merged
