"""Scenarios from files, mappings and records, with the materials and reactions that can occur in them."""

from __future__ import annotations

import contextlib
import difflib
import functools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from typing_extensions import Unpack

from .checks import check_charges, check_draws, check_materials, check_vessels, mentioned_materials
from .datafile import DataError, bounded, read_toml
from .datamodel import validated, written
from .inherit import campaign_names, completed, scenario_names, shipped_file, split_level, synthesis_names
from .materials import LOCK, Material, Materials, load_materials, shipped_materials
from .pairs import Pair, Pairs, load_pairs, shipped_pairs
from .reactions import (
    HYDROXIDE,
    PROTON,
    WATER,
    Reaction,
    ReactionFamily,
    Violent,
    check_reactions,
    check_without_real,
    dissolved_reactions,
    load_reactions,
)
from .scenario import Scenario, Settings

_MOST_MATERIALS = 256


def _reachable(family: ReactionFamily, present: list[str], ionizes: bool) -> tuple[list[str], ReactionFamily]:
    """Close ``present`` under the family's reactions; drop what can never occur.

    If water ``ionizes``, its ions are available to reactions that name one of them.
    """
    order = list(dict.fromkeys(present))
    of_water = (PROTON, HYDROXIDE) if any({PROTON, HYDROXIDE} & s.materials() for s in family.reaction) else ()
    while True:
        known = set(order)
        new: list[str] = []
        steps: list[Reaction | Violent] = [*family.reaction, *family.violent]
        for step in steps:
            if _can_run(step, known):
                new += [name for name in (*step.reactants, *step.products) if name not in known]
        for salt in family.salt:
            if salt.solid in known or {salt.cation, salt.anion} <= known:
                new += [name for name in (salt.solid, salt.cation, salt.anion) if name not in known]
        if ionizes and WATER in known:
            new += [name for name in of_water if name not in known]
        for acid in family.acid:
            if WATER in known and not known.isdisjoint(acid.species):
                new += [name for name in (*acid.species, PROTON, HYDROXIDE) if name not in known]
        if not new:
            break
        order += list(dict.fromkeys(new))
    reactions = [step for step in family.reaction if _can_run(step, known)]
    kept = family.model_copy(
        update={
            "reaction": tuple(
                step.model_copy(update={"inhibitors": {n: k for n, k in step.inhibitors.items() if n in known}})
                for step in reactions
            ),
            "salt": tuple(salt for salt in family.salt if salt.solid in known),
            "violent": tuple(step for step in family.violent if _can_run(step, known)),
            "acid": tuple(acid for acid in family.acid if WATER in known and set(acid.species) <= known),
        }
    )
    return order, kept


def reachable_materials(spec: Scenario, present: Iterable[str]) -> set[str]:
    """Return what can occur in a scenario where some materials are present, these included."""
    ionizes = spec.physics == "real" and {PROTON, HYDROXIDE} <= set(spec.materials)
    return set(_reachable(spec.family, list(present), ionizes)[0])


def _can_run(step: Reaction | Violent, known: set[str]) -> bool:
    """Return True if the reactants and catalysts of a reaction are available in one direction or the other."""
    if isinstance(step, Violent):
        return set(step.reactants) <= known
    backward = step.equilibrium_constant is not None and set(step.products) <= known
    return set(step.catalysts) <= known and (set(step.reactants) <= known or backward)


def load_scenario(scenario: str | Path | Mapping[str, Any] | Scenario, **settings: Unpack[Settings]) -> Scenario:
    """Load and validate a scenario.

    Args:
        scenario: a bundled name (see :func:`scenario_names` and :func:`synthesis_names`), a path to a TOML file, either
            with a level (``unlabelled@1``), the parsed content of a file or a :func:`dump_scenario` as a mapping, or a
            loaded scenario.
        settings: ``rewards``, ``split`` and ``actions`` of :meth:`~chemlab.config.scenario.Scenario.configured`.

    Raises:
        DataError: unknown name, malformed file, unknown key or material, or a value out of bounds; the
            message names the file, the key, the value and the bound.
        ValueError: unknown reward mix, split or kind of actions.
    """
    return _loaded(scenario).configured(**settings)


def _loaded(scenario: str | Path | Mapping[str, Any] | Scenario) -> Scenario:
    if isinstance(scenario, Scenario):
        return scenario
    if isinstance(scenario, Mapping):
        where = "(scenario given as a mapping)"
        if isinstance(scenario.get("scenario"), Mapping):
            return restore_scenario(scenario, where)
        return _resolve(bounded(scenario, where), where, Path.cwd())
    if not isinstance(scenario, (str, Path)):
        raise DataError(f"scenario: must be a name, a path, a mapping or a loaded scenario, given {scenario!r}")
    name, level = split_level(str(scenario))
    if isinstance(scenario, str) and (file := shipped_file(scenario)):
        return _load_file(file, level)
    path = Path(name)
    if path.suffix != ".toml":
        known = [*scenario_names(), *campaign_names(), *synthesis_names()]
        plain = name.lower().replace("-", "_")
        near = [one for one in (f"{name}.toml",) if Path(one).is_file()] or [one for one in known if plain in one][:1]
        near = near or difflib.get_close_matches(plain, known, 1)
        raise DataError(
            f"scenario: unknown name {str(scenario)!r:.200}; {f'did you mean {near[0]}? ' if near else ''}"
            f"choose from {', '.join(known)}, or give a path to a .toml file"
        )
    return _resolve(read_toml(path), str(path), path.parent, level)


@functools.lru_cache(maxsize=64)
def _load_file(path: Path, level: int | None) -> Scenario:
    return _resolve(read_toml(path), str(path), path.parent, level)


def _resolve(values: Mapping[str, Any], where: str, folder: Path, level: int | None = None) -> Scenario:
    _check_is_scenario(values, where)
    if "@" in str(values.get("name")):
        raise DataError(f"{where}: name: {values['name']!r:.200} must not have a level; declare it under levels")
    if "base" in values and "name" not in values and Path(where).suffix == ".toml":
        # Two scenarios of one name would share recorded vessels and results.
        own = re.sub(r"[^a-z0-9_]+", "_", Path(where).stem.lower()).lstrip("0123456789_")[:90]
        values = {**values, "name": own} if own else values
    spec = validated(Scenario, completed(values, where, folder, level), where)
    known = dict(shipped_materials())
    for name, material in load_materials([folder / file for file in spec.material_files]).items():
        if name in known:
            raise DataError(f"{where}: material_files: {name!r} is already a bundled material; rename yours")
        known[name] = material
    family = load_reactions(spec.reactions, known, folder, where)
    # A dump keeps prices, but not the materials of missing bottles, so this check is not possible for a restored
    # scenario.
    check_materials([("costs.stock_per_mol", name) for name in spec.costs.stock_per_mol], known, where)
    pairs = load_pairs(folder / file for file in spec.pair_files)
    return _equipped(spec, known, family, pairs, where)


def _check_is_scenario(values: Mapping[str, Any], where: str) -> None:
    """Check that a file is no other kind of file.

    Raises:
        DataError: it has materials, reactions or pairs.
    """
    tables = [table for key, table in values.items() if key != LOCK]
    kinds = {
        "materials": all(isinstance(table, Mapping) and "molar_mass_g_mol" in table for table in tables),
        "reactions": isinstance(values.get("reaction"), list),
        "pairs": isinstance(values.get("pairs"), list),
    }
    for kind, key in (("materials", "material_files"), ("reactions", "reactions"), ("pairs", "pair_files")):
        if tables and kinds[kind]:
            raise DataError(f"{where}: is a file of {kind}, not a scenario; a scenario names it under {key}")


def _equipped(spec: Scenario, known: Materials, family: ReactionFamily, pairs: Pairs, where: str) -> Scenario:
    """Return ``spec`` with the materials and reactions that can occur, all validated except the family itself.

    Raises:
        DataError: a material is unknown, contents do not fit, a gas is in a bottle, or there are too many materials.
    """
    named = mentioned_materials(spec)
    check_materials(named, known, where)
    check_vessels(spec, known, where)
    check_charges(spec, known, family, where)
    check_draws(spec, known, where)
    names, ionizes = [name for _, name in named], spec.physics == "real" and {PROTON, HYDROXIDE} <= set(known)
    order, kept = _reachable(family, names, ionizes)
    if spec.physics == "real" and WATER in order:
        order, kept = _reachable(dissolved_reactions(family), names, ionizes)
    if len(order) > _MOST_MATERIALS:
        raise DataError(f"{where}: {len(order)} materials can occur; must be at most {_MOST_MATERIALS}")
    if "air" not in known:
        raise DataError(f"{where}: material 'air' is missing, which every vessel contains")
    for goal, wanted in spec.specifications.items():
        never = [name for name in wanted.purity_among if name not in order]
        if never:
            raise DataError(
                f"{where}: specifications.{goal}.purity_among: {never[0]!r} cannot occur; known: {', '.join(order)}"
            )
    present = {name: known[name] for name in [*order, *(["air"] if "air" not in order else [])]}
    if spec.physics == "paper":
        check_without_real(kept, where)
        present, kept = _of_paper(present, kept, where)
    else:
        every = {**shipped_pairs(), **pairs}
        spec._pairs = {names: pair for names, pair in every.items() if names <= set(present)}
    spec._materials = present
    spec._family = kept
    spec._origin = where
    return spec


def _of_paper(present: Materials, family: ReactionFamily, where: str) -> tuple[dict[str, Material], ReactionFamily]:
    """Return materials and reactions without the data of the backend ``real``.

    Raises:
        DataError: a material has no polarity, which the backend ``paper`` needs.
    """
    for name, material in present.items():
        if material.polarity is None:
            raise DataError(
                f"{where}: materials: {name!r} has no polarity, which physics = 'paper' needs; "
                "give it one with its source, or choose physics = 'real'"
            )
    plain = {name: material.model_copy(update={"real": None}) for name, material in present.items()}
    salts = tuple(salt.model_copy(update={"solubility": None}) for salt in family.salt)
    return plain, family.model_copy(update={"salt": salts})


def dump_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as plain data, with its materials and reactions; defaults are omitted."""
    return {
        "scenario": written(scenario),
        "materials": {name: written(material) for name, material in scenario.materials.items()},
        "reactions": written(scenario.family),
        **({"pairs": [written(pair) for pair in scenario.pairs.values()]} if scenario.pairs else {}),
    }


def plain_scenario(scenario: Scenario) -> str | dict[str, Any]:
    """Return an argument of :func:`load_scenario` for a loaded scenario.

    It is the scenario's name or file as long as these give the same scenario, else a :func:`dump_scenario`.
    """
    content = dump_scenario(scenario)
    for known in (scenario.name, scenario.origin + scenario.level):
        with contextlib.suppress(DataError):
            if dump_scenario(load_scenario(known)) == content:
                return known
    return content


def restore_scenario(data: Mapping[str, Any], where: str) -> Scenario:
    """Restore the scenario of a :func:`dump_scenario`, with the checks of a file; errors name ``where``.

    Raises:
        DataError: the data is not a dump, or its scenario is invalid.
    """
    tables: list[dict[str, Any]] = []
    for key in ("scenario", "materials", "reactions"):
        if not isinstance(data.get(key), dict):
            raise DataError(f"{where}: {key}: must be a table")
        tables.append(bounded(data[key], f"{where}: {key}"))
    values, materials, reactions = tables
    spec = validated(Scenario, values, where)
    known = {name: validated(Material, table, f"{where}: materials.{name}") for name, table in materials.items()}
    family = validated(ReactionFamily, reactions, f"{where}: reactions")
    check_reactions(family, known, f"{where}: reactions")
    listed = data.get("pairs", [])
    if not isinstance(listed, list):
        raise DataError(f"{where}: pairs: must be a list")
    made: list[Pair] = [
        validated(Pair, bounded(pair, f"{where}: pairs.{i}"), f"{where}: pairs.{i}") for i, pair in enumerate(listed)
    ]
    return _equipped(spec, known, family, {frozenset(pair.of): pair for pair in made}, where)
