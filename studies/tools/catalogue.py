"""Makes the bundled catalogue, ``chemlab/data/catalogue``, from ``studies/tools/catalogue.toml``.

    python studies/tools/catalogue.py            # all of it: 2 minutes of CPU time, most of it for pairs.csv
    python studies/tools/catalogue.py --names    # material files and names.csv alone

Needs the extra ``chem``. The same versions of its packages make the same files.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import chemicals
import numpy as np
import thermo
from chemicals.identifiers import pubchem_db
from scipy.optimize import fsolve

from chemlab.config.catalogue import FAMILY, FOLDER, SALTS, CataloguePair, names_text, normalized, pairs_text
from chemlab.config.datafile import DataError, read_toml
from chemlab.config.materials import Material, shipped_materials
from chemlab.config.pairs import log_activity_coefficients, shipped_pairs
from chemlab.config.reactions import shipped_reactions_folder
from chemlab.openchem.activity import is_molecule, quick_pairs
from chemlab.openchem.compounds import appearance, checked_materials, compounds, doubts, estimates, material_tables
from chemlab.openchem.identity import canonical, molar_mass
from chemlab.openchem.names import spellings as spelled
from chemlab.openchem.properties import Value
from chemlab.openchem.writing import family_text, lock, material_text

HERE = Path(__file__).resolve().parent
COMMAND = "python studies/tools/catalogue.py"
CRC = "CRC Handbook, 95th ed. (2014)"
DESIGN = "design value: that of the alkali salts; never used"
PALETTE = "design value: palette colour, spread shade, artificial bands"
# Aqueous ions: composition, charge, formation enthalpy; volume and heat capacity are what the solid or the acid has
# beyond the other ion, so that dissolving it leaves both as they are.
IONS: dict[str, tuple[str, dict[str, int], int, float, str, str]] = {
    "K+": ("potassium ion", {"K": 1}, 1, -252400.0, "KCl", "Cl-"),
    "Br-": ("bromide ion", {"Br": 1}, -1, -121600.0, "NaBr", "Na+"),
    "I-": ("iodide ion", {"I": 1}, -1, -55200.0, "NaI", "Na+"),
    "NO3-": ("nitrate ion", {"N": 1, "O": 3}, -1, -207400.0, "NaNO3", "Na+"),
    "HSO4-": ("hydrogensulfate ion", {"H": 1, "S": 1, "O": 4}, -1, -887300.0, "", "H+"),
    "SO4--": ("sulfate ion", {"S": 1, "O": 4}, -2, -909300.0, "HSO4-", "H+"),
}
EVERYDAY = (
    "1-hexene", "acetanilide", "acetic_acid", "acetic_anhydride", "acetylsalicylic_acid", "benzoic_acid",
    "diethyl_ether", "dodecane", "ethanol", "ethyl_acetate", "hexane", "naphthalene", "salicylic_acid", "toluene",
    "water",
)  # fmt: skip
"""Bundled molecules that have pairs with the catalogue's; the others are products of single scenarios."""
PARTED = "; two layers at room temperature although the liquids mix"
SULFURIC = 98.079 / 1.83 / 1000.0, 138.9
"""L/mol and J/mol/K of liquid sulfuric acid (CRC)."""


def looks(key: str, used: list[float]) -> dict[str, Any]:
    """Colour, grey value and bands of something that is no molecule."""
    return appearance(cast(Any, SimpleNamespace(inchi_key=key)), used, False)


def salt_table(key: str, row: Mapping[str, Any], atoms: Mapping[str, int], used: list[float]) -> dict[str, Any]:
    """The table of a solid salt, by what compilations say of its CAS number."""
    cas = str(row["cas"])
    heat = thermo.HeatCapacitySolid(CASRN=cas, MW=chemicals.MW(cas)).calculate(298.15, "CRCSTD")
    volume = thermo.VolumeSolid(CASRN=cas, MW=chemicals.MW(cas)).calculate(298.15, "CRC_INORG_S")
    mass = molar_mass(dict(atoms))
    return {
        "name": row["name"], "formula": key, "composition": dict(atoms), "cas": cas,
        "molar_mass_g_mol": round(mass, 6), "density_kg_l": round(mass / volume / 1e6, 6),
        "heat_capacity_j_mol_k": round(float(heat), 2), "melting_point_k": float(chemicals.Tm(cas)),
        "boiling_point_k": float(chemicals.Tb(cas)), "vaporization_enthalpy_j_mol": 150000.0, "role": "solid",
        **looks(key, used),
        "source": {
            "molar_mass_g_mol": "sum of the atomic weights in the header of chemlab's solvents.toml; others: CIAAW",
            "density_kg_l": f"{CRC}, solid inorganic compounds [CRC_INORG_S]",
            "heat_capacity_j_mol_k": f"{CRC}, standard thermodynamic properties [CRCSTD]",
            "melting_point_k": f"{CRC}, inorganic compounds", "boiling_point_k": f"{CRC}, inorganic compounds",
            "vaporization_enthalpy_j_mol": DESIGN, "color_shade_absorption": PALETTE,
        },
        "real": {
            "formation_enthalpy_j_mol": float(chemicals.Hfs(cas)), "formation_state": "s",
            "source": {"formation_enthalpy_j_mol": f"{CRC}, standard thermodynamic properties [CRC]"},
        },
    }  # fmt: skip


def ion_table(key: str, known: Mapping[str, Any], used: list[float]) -> dict[str, Any]:
    """The table of an ion, what is known of its parent and its partner by then."""
    name, atoms, charge, enthalpy, parent, partner = IONS[key]

    def of(other: str) -> tuple[float, float]:
        m = known[other]
        return m["molar_mass_g_mol"] / m["density_kg_l"] / 1000.0, m["heat_capacity_j_mol_k"]

    whole, part = of(parent) if parent else SULFURIC, of(partner)
    mass = molar_mass(atoms)
    less = f"design value: that of {parent or 'sulfuric acid'} less that of {partner}"
    return {
        "name": name, "formula": key, "composition": atoms, "charge": charge, "molar_mass_g_mol": round(mass, 6),
        "density_kg_l": round(mass / (whole[0] - part[0]) / 1000.0, 7),
        "heat_capacity_j_mol_k": round(whole[1] - part[1], 3), "boiling_point_k": 1000.0,
        "vaporization_enthalpy_j_mol": 150000.0, "polarity": 1.3, "role": "ion", **looks(key, used),
        "source": {
            "molar_mass_g_mol": "sum of the atomic weights in the header of chemlab's solvents.toml; others: CIAAW",
            "density_kg_l": less, "heat_capacity_j_mol_k": less, "boiling_point_k": DESIGN,
            "vaporization_enthalpy_j_mol": DESIGN, "polarity": "design value, the same for every ion",
            "color_shade_absorption": PALETTE,
        },
        "real": {
            "formation_enthalpy_j_mol": enthalpy, "formation_state": "aq",
            "source": {"formation_enthalpy_j_mol": f"{CRC}, thermodynamic properties of aqueous ions [CRC_AQUEOUS]"},
        },
    }  # fmt: skip


def ionic_tables(salts: Mapping[str, Mapping[str, Any]], used: list[float]) -> dict[str, dict[str, Any]]:
    """Salts, and the ions that chemlab does not know yet."""
    known: dict[str, Any] = {key: m.model_dump() for key, m in shipped_materials().items()}
    atoms: dict[str, Mapping[str, float]] = {
        **{key: m.composition for key, m in shipped_materials().items()},
        **{k: v[1] for k, v in IONS.items()},
    }
    made: dict[str, dict[str, Any]] = {}
    for key, row in salts.items():
        counts: dict[str, int] = {}
        for ion in row["ions"]:
            for element, number in atoms[ion].items():
                counts[element] = counts.get(element, 0) + int(number)
        made[key] = known[key] = salt_table(key, row, counts, used)
    for key in IONS:
        made[key] = known[key] = ion_table(key, known, used)
    return made


def family(given: Mapping[str, Any]) -> dict[str, Any]:
    """The reaction family: bundled sodium salts, the catalogue's salts, acids."""
    bundled = read_toml(shipped_reactions_folder() / "sodium_salts.toml")["salt"]
    salts = []
    for key, row in given["salts"].items():
        mass = chemicals.MW(row["cas"])
        points = [
            [round(t + 273.15, 2), round(10.0 * g / mass, 4)]
            for t, g in zip(row["water_c"], row["water_g"], strict=True)
        ]
        salts.append({
            "solid": key, "cation": row["ions"][0], "anion": row["ions"][1],
            "source": "dissociation in water; solubilities below",
            "solubility": {
                "source": "CRC Handbook and Seidell, in g/100 g of water (as remembered, not looked up)",
                "solvents": {"water": points},
            },
        })  # fmt: skip
    return {
        "name": "everyday", "summary": "No reaction but the dissolving of salts and the ionization of acids.",
        "salt": [*bundled, *salts], "acid": given["acid"], "lock": lock(COMMAND),
    }  # fmt: skip


def names_of(key: str, material: Mapping[str, Any], more: Iterable[str]) -> list[str]:
    """Every spelling of a chemical, without repetition."""
    cas, found = material.get("cas"), [key, material["name"], material["formula"], *more]
    entry = pubchem_db.search_CAS(cas) if cas else None
    found += [cas] if cas else []
    found += [entry.common_name, entry.iupac_name] if entry else []
    out = [normalized(name) for text in found if text for name in spelled(text)]
    structures = {str(text) for text in (material.get("smiles"), entry.smiles if entry else None) if text}
    structures |= {canonical(text, key) for text in structures if material.get("role") != "ion"}
    # "CO" is a structure of methanol, and a formula of something else.
    return list(dict.fromkeys([*out, *sorted(text for text in structures if len(text) > 2)]))


def main() -> None:
    """Make the files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--names", action="store_true", help="leave pairs.csv as it is")
    arguments = parser.parse_args()
    given = read_toml(HERE / "catalogue.toml")
    listed: dict[str, list[str]] = {**given["liquids"], **given["solids"]}
    wanted = compounds([], {key: row[0] for key, row in listed.items()})
    own = {
        key: {field: Value(number, row["source"]) for field, number in row.items() if field != "source"}
        for key, row in given["values"].items()
    }
    tables: dict[str, dict[str, Any]] = material_tables(wanted, own)
    used = [m.shade for m in shipped_materials().values()]
    FOLDER.mkdir(parents=True, exist_ok=True)
    for old in FOLDER.glob("*.toml"):
        old.unlink()
    for key, table in tables.items():
        (FOLDER / f"{key}.toml").write_text(material_text({key: table}, COMMAND), encoding="utf-8")
    ionic = ionic_tables(given["salts"], used)
    SALTS.write_text(material_text(ionic, COMMAND), encoding="utf-8")
    FAMILY.write_text(family_text(family(given)), encoding="utf-8")
    tables |= ionic
    made = checked_materials(tables)
    shipped = {key: m.model_dump() for key, m in shipped_materials().items() if not key[0].isupper() or len(key) > 1}
    spelled_as: list[tuple[str, str]] = []
    for key, material in {**shipped, **tables}.items():
        if material["role"] == "gas" or any(e.startswith("Q") and len(e) > 1 for e in material["composition"]):
            continue
        more = listed.get(key, ["", *given["bundled"].get(key, [])])[1:]
        spelled_as += [(name, key) for name in names_of(key, material, more)]
    for key in ("hydrochloric_acid", "hydrobromic_acid", "nitric_acid", "sulfuric_acid"):
        spelled_as += [(normalized(name), normalized(key)) for name in (key, *given["bundled"][key])]
    (FOLDER / "names.csv").write_text(names_text(sorted(dict.fromkeys(spelled_as))), encoding="utf-8")
    print(f"{len(tables)} materials, {len(spelled_as)} spellings")
    for line in doubts(tables_of_molecules(tables)):
        print("doubt:", line)
    for key, fields in estimates(tables_of_molecules(tables)).items():
        if fields:
            print("estimated:", key, ", ".join(fields))
    if not arguments.names:
        write_pairs(made, given)


def tables_of_molecules(tables: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {key: table for key, table in tables.items() if table["role"] in ("solvent", "solute")}


def through_azeotrope(row: Mapping[str, Any], materials: Mapping[str, Material]) -> CataloguePair:
    """NRTL parameters by which a pair has a measured azeotrope: gamma of each is p / p_pure there.

    tau is the same at all temperatures: by b / T, what mixes at the azeotrope would have two layers when it is cold.
    """
    temperature, x = float(row["temperature_k"]), np.array([row["fraction"], 1.0 - row["fraction"]])
    curves: list[Any] = [materials[name].real for name in row["of"]]
    pure = [float(curve.vapor_pressure.pascal(temperature)) for curve in curves]

    def off(tau: Any) -> Any:
        matrix = np.array([[0.0, tau[0]], [tau[1], 0.0]])
        return log_activity_coefficients(x, matrix, np.array(row["alpha"])) - np.log(101325.0 / np.array(pure))

    tau = fsolve(off, [1.0, 1.0])
    numbers = (*(float(f"{t:.5g}") for t in tau), 0.0, 0.0, 0.0, 0.0)
    one, other = row["of"]
    return CataloguePair(one, other, "azeotrope", float(row["alpha"]), 0.0, numbers)


def write_pairs(made: Mapping[str, Material], given: Mapping[str, Any]) -> None:
    """Fit and write every pair that is not bundled yet."""
    known = {**shipped_materials(), **made}
    molecules = sorted(key for key, m in known.items() if is_molecule(m) and (key in made or key in EVERYDAY))
    two = [pair for pair in itertools.combinations(molecules, 2) if frozenset(pair) not in shipped_pairs()]
    rows: list[CataloguePair] = quick_pairs(
        two, known, lambda done: print(f"\r{done} fits", end="", file=sys.stderr, flush=True)
    )
    print(file=sys.stderr)
    better = {frozenset(row["of"]): through_azeotrope(row, known) for row in given["azeotrope"]}
    rows = [better.get(frozenset(row[:2]), row) for row in rows]
    parted = [{"water", name} for name in given["mixes"]["with_water"]]
    rows = [row._replace(form=f"{row.form}{PARTED}") if set(row[:2]) in parted else row for row in rows]
    (FOLDER / "pairs.csv").write_text(pairs_text(rows), encoding="utf-8")
    ideal = sum(row.form == "ideal" for row in rows)
    print(f"{len(rows)} pairs, {ideal} of them ideal; largest error of ln gamma {max(row.error for row in rows):.2f}")


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        sys.exit(str(error))
