"""Results of `chemlab data material` for common compounds, compared with values it did not use.

    python studies/physics/compounds.py     # writes compounds.csv, compounds_blind.csv and compounds_worst.csv

`compounds.csv`: for each field, the numbers of compounds with a measured value, an estimate or neither, and the
deviation of the chosen value from the median of the other compilations. `compounds_blind.csv`: the same for estimates
from the structure alone, compared with the compilations. `compounds_worst.csv`: the ten largest deviations of each
kind.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator

import numpy as np
from mixtures import write

from chemlab.openchem.identity import compound_of
from chemlab.openchem.properties import Properties, Value

COMPOUNDS = """
pentane; hexane; heptane; octane; nonane; decane; undecane; dodecane; tetradecane; hexadecane; isopentane;
2-methylpentane; 2,2,4-trimethylpentane; 3-methylpentane; 2,3-dimethylbutane; cyclopentane; cyclohexane; cycloheptane;
cyclooctane; methylcyclohexane; methylcyclopentane; ethylcyclohexane; decalin; 1-pentene; 1-hexene; 1-heptene; 1-octene;
1-decene; cyclohexene; cyclopentene; isoprene; limonene; 1-hexyne; benzene; toluene; ethylbenzene; o-xylene; m-xylene;
p-xylene; propylbenzene; cumene; mesitylene; butylbenzene; tert-butylbenzene; styrene; naphthalene; tetralin;
1-methylnaphthalene; biphenyl; anthracene; phenanthrene; diphenylmethane; indene; methanol; ethanol; 1-propanol;
2-propanol; 1-butanol; 2-butanol; isobutanol; tert-butanol; 1-pentanol; 3-methyl-1-butanol; 1-hexanol; 1-heptanol;
1-octanol; 1-decanol; cyclohexanol; cyclopentanol; benzyl alcohol; 2-phenylethanol; allyl alcohol; ethylene glycol;
propylene glycol; glycerol; 1,4-butanediol; diethylene glycol; phenol; o-cresol; m-cresol; p-cresol; catechol;
hydroquinone; 1-naphthol; 2-naphthol; diethyl ether; diisopropyl ether; dibutyl ether; methyl tert-butyl ether;
tetrahydrofuran; 1,4-dioxane; 1,2-dimethoxyethane; anisole; diphenyl ether; furan; 2-methoxyethanol; acetone;
2-butanone; 2-pentanone; 3-pentanone; methyl isobutyl ketone; 2-hexanone; 2-heptanone; cyclopentanone; cyclohexanone;
acetophenone; benzophenone; acetaldehyde; propionaldehyde; butyraldehyde; benzaldehyde; furfural; formic acid;
acetic acid; propionic acid; butyric acid; valeric acid; hexanoic acid; octanoic acid; benzoic acid; phenylacetic acid;
salicylic acid; cinnamic acid; adipic acid; succinic acid; oxalic acid; stearic acid; acetic anhydride;
phthalic anhydride; maleic anhydride; methyl formate; ethyl formate; methyl acetate; ethyl acetate; propyl acetate;
isopropyl acetate; butyl acetate; isobutyl acetate; isoamyl acetate; vinyl acetate; methyl propionate; ethyl butyrate;
methyl benzoate; ethyl benzoate; methyl methacrylate; dimethyl phthalate; dibutyl phthalate; diethyl carbonate;
methyl salicylate; dichloromethane; chloroform; carbon tetrachloride; 1,2-dichloroethane; 1,1,1-trichloroethane;
trichloroethylene; tetrachloroethylene; 1-chlorobutane; 1-chlorohexane; tert-butyl chloride; chlorobenzene;
1,2-dichlorobenzene; 1,4-dichlorobenzene; benzyl chloride; bromoethane; 1-bromobutane; bromobenzene; iodomethane;
iodobenzene; fluorobenzene; hexafluorobenzene; butylamine; diethylamine; triethylamine; pyrrolidine; piperidine;
morpholine; aniline; n-methylaniline; n,n-dimethylaniline; o-toluidine; p-toluidine; pyridine; 2-methylpyridine;
quinoline; pyrrole; indole; ethylenediamine; ethanolamine; acetonitrile; propionitrile; benzonitrile; acrylonitrile;
nitromethane; nitroethane; nitrobenzene; 4-nitrotoluene; formamide; n,n-dimethylformamide; n,n-dimethylacetamide;
acetamide; acetanilide; urea; n-methyl-2-pyrrolidone; dimethyl sulfoxide; carbon disulfide; thiophene; ethanethiol;
dimethyl sulfide; water; ammonia; hydrogen chloride; carbon dioxide; propane; ethylene; camphor; vanillin
"""
FIELDS = (
    "boiling_point", "melting_point", "critical_temperature", "vaporization_enthalpy", "density", "heat_capacity",
    "formation_enthalpy", "fusion_enthalpy", "vapor_pressure",
)  # fmt: skip
ABSOLUTE = {"formation_enthalpy": ("kJ/mol", 1000.0)}
"""Fields that may be zero: their deviations are in this unit, others' in %."""


def number_of(found: Properties, field: str) -> Value | None:
    """Return a field's number; for a vapour pressure, its value at 0.85 of the boiling point."""
    value = getattr(found, field)
    if field == "vapor_pressure" and value is not None:
        boils = found.boiling_point
        assert boils is not None
        return Value(float(value[0].pascal(0.85 * boils.number)), value[1])
    if field == "formation_enthalpy" and value is not None:
        return value[0] if isinstance(value[0], Value) else None
    return value if isinstance(value, Value) else None


def others(found: Properties, field: str, used: Value) -> list[float]:
    """Return the values of a field in unused compilations."""
    return [v for key, v in found.compilations(field).items() if f"[{key}]" not in used.source]


def deviation(field: str, number: float, expected: float) -> float:
    """Return the deviation in %, or in the unit of an absolute field."""
    if field in ABSOLUTE:
        return (number - expected) / ABSOLUTE[field][1]
    return 100.0 * (number / expected - 1.0)


def rows_of(names: list[str], blind: bool) -> Iterator[tuple[str, str, str, float | None]]:
    """Yield (compound, field, measured/estimate/missing, deviation)."""
    for name in names:
        compound = compound_of(name)
        known = Properties(compound)
        taken = Properties(dataclasses.replace(compound, cas=None)) if blind else known
        for field in FIELDS:
            if field == "fusion_enthalpy" and known.state != "s":
                continue
            # Without a melting point a compound is not known to be a solid.
            if blind and (field == "melting_point" or known.state != "l"):
                continue
            # A compound taken for a gas is not usable.
            value = number_of(taken, field) if taken.state == known.state or not blind else None
            if value is None:
                yield name, field, "missing", None
                continue
            listed = list(known.compilations(field).values()) if blind else others(known, field, value)
            off = deviation(field, value.number, float(np.median(listed))) if listed else None
            yield name, field, "estimate" if value.estimated else "measured", off


def summary(rows: list[tuple[str, str, str, float | None]]) -> Iterator[tuple[object, ...]]:
    """Yield a line for each field."""
    for field in FIELDS:
        mine = [row for row in rows if row[1] == field]
        if not mine:
            continue
        kinds = [sum(row[2] == kind for row in mine) for kind in ("measured", "estimate", "missing")]
        off = [(abs(row[3]), row[0]) for row in mine if row[3] is not None and math.isfinite(row[3])]
        sizes = np.array([size for size, _ in off]) if off else np.array([math.nan])
        unit = ABSOLUTE.get(field, ("%", 1.0))[0]
        worst = max(off)[1] if off else ""
        yield (field, len(mine), *kinds, len(off), unit, float(np.median(sizes)), float(np.quantile(sizes, 0.95)),
               float(sizes.max()), worst)  # fmt: skip


def main() -> None:
    """Compare and write the tables."""
    names = [name.strip() for name in COMPOUNDS.replace("\n", " ").split(";")]
    head = ("field", "compounds", "measured", "estimate", "missing", "compared")
    head += ("unit", "median", "q95", "largest", "of")
    worst: list[tuple[object, ...]] = []
    for blind, file in ((False, "compounds.csv"), (True, "compounds_blind.csv")):
        begun = time.perf_counter()
        rows = list(rows_of(names, blind))
        print(f"{len(names)} compounds in {time.perf_counter() - begun:.1f} s")
        table = list(summary(rows))
        write(file, head, table)
        for line in (head, *table):
            print("  ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in line))
        ranked = sorted((row for row in rows if row[3] is not None), key=lambda row: -abs(row[3] or 0.0))
        worst += [(file, *row[:3], row[3], ABSOLUTE.get(row[1], ("%",))[0]) for row in ranked[:10]]
    write("compounds_worst.csv", ("table", "compound", "field", "kind", "deviation", "unit"), worst)
    for line in worst:
        print(*line)


if __name__ == "__main__":
    main()
