"""Material files from names, CAS numbers and structures."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..config.datafile import DataError, read_toml, toml_key
from ..config.datamodel import validated
from ..config.materials import Material, shipped_materials
from .identity import Compound, compound_of
from .names import is_mineral
from .properties import DOUBTFUL, Properties, Value
from .writing import significant, toml_tables

OWN_FIELDS = (
    "density_kg_l", "heat_capacity_j_mol_k", "melting_point_k", "boiling_point_k", "vaporization_enthalpy_j_mol",
    "critical_temperature_k", "formation_enthalpy_j_mol", "fusion_enthalpy_j_mol",
)  # fmt: skip
"""Fields that users may give instead of looked-up values."""
_PALETTE = ("#332288", "#88ccee", "#44aa99", "#117733", "#999933", "#ddcc77", "#cc6677", "#882255", "#aa4499")
"""Paul Tol's muted colours."""
_WATERY = 0.14
"""Maximum distance of grey values that the camera takes for water's."""
_DESIGN = "design value: palette colour, spread shade, artificial bands"


def own_values(paths: Iterable[Path]) -> dict[str, dict[str, Value]]:
    """Read files with the user's own values, which are tables as in a material file, each with a ``source``.

    Returns:
        The values by material and field.

    Raises:
        DataError: a file is malformed, or a field is unknown, not a number, or without a source.
    """
    found: dict[str, dict[str, Value]] = {}
    for path in paths:
        for key, table in read_toml(path).items():
            place = f"{path}: {key}"
            if not isinstance(table, dict):
                raise DataError(f"{place}: must be a table [{toml_key(key)}]")
            sources = table.get("source", {})
            for field, number in table.items():
                if field == "source":
                    continue
                if field not in OWN_FIELDS:
                    raise DataError(f"{place}: {field}: unknown; choose from {', '.join(OWN_FIELDS)}")
                if isinstance(number, bool) or not isinstance(number, (int, float)):
                    raise DataError(f"{place}: {field}: must be a number, given {number!r}")
                if not isinstance(sources, dict) or not isinstance(sources.get(field), str) or not sources[field]:
                    raise DataError(f"{place}: source: must state the source of {field}")
                found.setdefault(key, {})[field] = Value(float(number), sources[field])
    return found


def compounds(texts: Sequence[str], named: Mapping[str, str] | None = None) -> list[Compound]:
    """Return the compounds denoted by some texts, in order and without repetition.

    Args:
        texts: CAS numbers, names or structures.
        named: further texts by the id that their compound shall have.

    Raises:
        DataError: some texts do not denote a compound; the message lists all of them.
    """
    found: dict[str, Compound] = {}
    errors = []
    for key, text in [*(("", text) for text in texts), *(named or {}).items()]:
        try:
            compound = compound_of(text, key)
        except DataError as error:
            errors.append(str(error))
            continue
        for other in found.values():
            if compound.key == other.key and compound.smiles != other.smiles:
                errors.append(f"{text!r}: would have the id {other.key!r} of {other.smiles}; use --name KEY={text}")
        found.setdefault(compound.smiles, compound)
    if errors:
        raise DataError("\n".join(errors))
    return list(found.values())


def appearance(compound: Compound, used: list[float], liquid: bool) -> dict[str, Any]:
    """Return the appearance of a material: a colour, a grey value distinct from others', two absorption bands.

    The grey value of a liquid is also distinct from water's.
    """
    number = int(hashlib.sha256(compound.inchi_key.encode()).hexdigest()[:8], 16)
    water = shipped_materials()["water"].shade
    shades = [round(0.12 + 0.01 * i, 2) for i in range(82)]
    allowed = [s for s in shades if not liquid or abs(s - water) > _WATERY]
    first = number % len(allowed)
    shade = max(allowed[first:] + allowed[:first], key=lambda s: min(abs(s - other) for other in used))
    used.append(shade)
    centers = 210.0 + (number % 97) * 2.0, 420.0 + (number // 97 % 181) * 2.0
    bands = [
        {"height_l_mol": height, "center_nm": center, "width_nm": width}
        for center, height, width in zip(centers, (0.08, 0.06), (11.0, 13.0), strict=True)
    ]
    return {"color": _PALETTE[number % len(_PALETTE)], "shade": shade, "absorption": bands}


def _table(compound: Compound, found: Properties, used: list[float]) -> tuple[dict[str, Any], list[str]]:
    """Return a material's table and its missing fields.

    Raises:
        DataError: the compound is a salt or a mineral.
    """
    metal, state = found.metal, found.state
    if state == "s" and is_mineral(compound.composition):
        raise DataError(
            f"{compound.key}: {compound.formula} is a salt or a mineral: its solubility is not estimated; "
            "use a bundled material, or write its tables by hand, solubilities included (docs: Write a material or a "
            "reaction)"
        )
    role = "gas" if state == "g" else "solid" if metal else "solvent" if state == "l" else "solute"
    values: dict[str, Any] = {"name": compound.name, "formula": compound.formula, "composition": compound.composition}
    values |= {"cas": compound.cas} if compound.cas else {}
    values |= {"smiles": compound.smiles, "molar_mass_g_mol": round(found.mass, 6)}
    source = {"molar_mass_g_mol": "sum of the atomic weights in the header of chemlab's solvents.toml; others: CIAAW"}
    real: dict[str, Any] = {}
    cited: dict[str, str] = {}
    missing = []

    def put(into: dict[str, Any], where: dict[str, str], field: str, value: Value | None, needed: bool = True) -> None:
        if value is not None:
            into[field], where[field] = significant(value.number, 6), found.doubt(field) + value.source
        elif needed:
            missing.append(field)

    put(values, source, "density_kg_l", found.density)
    put(values, source, "heat_capacity_j_mol_k", found.heat_capacity)
    boils, melts = found.boiling_point, found.melting_point
    if not (metal and boils and melts and boils.number <= melts.number):  # arsenic sublimes
        put(values, source, "melting_point_k", melts, needed=False)
    put(values, source, "boiling_point_k", found.boiling_point)
    put(values, source, "vaporization_enthalpy_j_mol", found.vaporization_enthalpy)
    values |= {"role": role, **appearance(compound, used, role == "solvent")}
    source["color_shade_absorption"] = _DESIGN
    if role in ("solvent", "solute"):
        if found.vapor_pressure is None:
            missing += ["vapor_pressure"] if found.boiling_point and not found.critical_temperature else []
        else:
            formula, cited["vapor_pressure"] = found.vapor_pressure
            real["vapor_pressure"] = formula.model_dump()
            if found.dimerization is not None:
                dimers, cited["dimerization"] = found.dimerization
                real["dimerization"] = dimers.model_dump()
        put(real, cited, "critical_temperature_k", found.critical_temperature)
    heat = found.formation_enthalpy
    put(real, cited, "formation_enthalpy_j_mol", heat[0] if heat else None)
    real["formation_state"] = heat[1] if heat else state
    if role == "solute":
        put(real, cited, "fusion_enthalpy_j_mol", found.fusion_enthalpy)
    return {**values, "source": source, "real": {**real, "source": cited}}, missing


def material_tables(
    wanted: Sequence[Compound],
    given: Mapping[str, Mapping[str, Value]] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, dict[str, Any]]:
    """Return validated tables of a material file by id.

    Args:
        wanted: the compounds.
        given: own values by id and field, see :func:`own_values`.
        progress: called with the id of every finished compound.

    Raises:
        DataError: some values were not found; the message lists all of them and states how to supply them.
    """
    unknown = sorted(set(given or {}) - {compound.key for compound in wanted})
    if unknown:
        requested = ", ".join(compound.key for compound in wanted)
        raise DataError(f"values: {unknown[0]!r} is not among the requested compounds: {requested}")
    used = [m.shade for m in shipped_materials().values() if m.role in ("solvent", "gas")]
    tables, missing = {}, {}
    for compound in wanted:
        tables[compound.key], fields = _table(compound, Properties(compound, (given or {}).get(compound.key)), used)
        if fields:
            missing[compound.key] = fields
        progress(compound.key)
    if missing:
        listed = "; ".join(f"{key}: {', '.join(fields)}" for key, fields in missing.items())
        template = {
            key: {**dict.fromkeys(fields, 0.0), "source": dict.fromkeys(fields, "where it is from")}
            for key, fields in missing.items()
        }
        raise DataError(
            f"not found: {listed}. Write each with its source into a file as below, with the "
            f"number for 0.0, and name the file with {_VALUES_OPTION}:\n" + "\n".join(toml_tables(template)).strip()
        )
    checked_materials(tables)
    return tables


def checked_materials(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Material]:
    """Return the materials of some tables.

    Raises:
        DataError: a table is invalid, for instance because compilations contradict each other.
    """
    try:
        return {key: validated(Material, table, f"material {key!r}") for key, table in tables.items()}
    except DataError as error:
        raise DataError(
            f"{error}; write your own numbers, with their sources, into a file named with {_VALUES_OPTION}"
        ) from error


_VALUES_OPTION = "--values (of chemlab data material or reactions)"
"""Option of the commands for the user's own numbers; ``Flask.material`` has none."""


def estimates(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return the estimated fields of each material."""
    return {
        key: [field for field, source in _sources(table) if source.startswith("estimate")]
        for key, table in tables.items()
    }


def doubts(tables: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a line for each number that compilations or an estimate contradict, and for each rejected number.

    The user's own numbers are included.
    """
    return [
        f"{key}: {field} = {table.get(field, table['real'].get(field))}: {source}"
        for key, table in tables.items()
        for field, source in _sources(table)
        if DOUBTFUL in source or "not taken" in source
    ]


def _sources(table: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    return itertools.chain(table["source"].items(), table["real"]["source"].items())
