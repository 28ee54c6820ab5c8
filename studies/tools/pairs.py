"""Make the bundled pair file ``chemlab/data/pairs`` from UNIFAC and ``studies/tools/solubilities.toml``.

    python studies/tools/pairs.py                     # the bundled file, of all bundled molecules
    python studies/tools/pairs.py toluene cumene --materials my_materials.toml --output my_pairs.toml

Needs the extra ``chem``. The method is described in :mod:`chemlab.openchem.activity`; ``chemlab data pairs`` makes
pairs of your own materials.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

from chemlab.config.datafile import DataError
from chemlab.config.materials import load_materials, shipped_materials
from chemlab.openchem.activity import is_molecule, make_pairs, measured_pairs
from chemlab.openchem.writing import pair_text

HERE = Path(__file__).resolve().parent
SHIPPED = HERE.parents[1] / "chemlab" / "data" / "pairs" / "unifac.toml"
SOLUBILITIES = HERE / "solubilities.toml"


def main() -> None:
    """Fit the requested pairs and write them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", help="materials; without any, all shipped molecules")
    parser.add_argument("--materials", type=Path, action="append", default=[], help="material file of your own")
    parser.add_argument("--output", type=Path, default=None, help="pair file to write (default: the shipped one)")
    arguments = parser.parse_args()
    if arguments.names and arguments.output is None:
        parser.error("--output: required if materials are named")
    materials = {**shipped_materials(), **load_materials(arguments.materials)}
    names = arguments.names or sorted(name for name, m in shipped_materials().items() if is_molecule(m))
    pairs = list(itertools.combinations(names, 2))

    def tell(done: str) -> None:
        print(f"\r{done}{' ' * 30}", end="", file=sys.stderr, flush=True)

    rows = make_pairs(pairs, materials, measured_pairs(SOLUBILITIES), tell)
    print(file=sys.stderr)
    output = arguments.output or SHIPPED
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(pair_text(rows, " ".join(["python studies/tools/pairs.py", *arguments.names])), encoding="utf-8")
    print(f"{output}: {len(rows)} pairs; largest error of ln gamma {max(row['error'] for row in rows):.2f}")


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        sys.exit(str(error))
