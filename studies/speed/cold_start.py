"""Time of a scenario's first episode with an empty and with a filled kernel cache.

    python studies/speed/cold_start.py
    python studies/speed/cold_start.py --scenarios wurtz_real --before ../before python

A run is `chemlab run SCENARIO` in its own process with an empty kernel cache, followed by one with the filled cache. On
a busy machine only processor times (summed over processes) are meaningful, and mostly their ratios. With `--before
CHECKOUT PYTHON` (see compare_commits.py), both commits run in alternation.
"""

from __future__ import annotations

import argparse
import functools
import math
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from report import arguments, children_seconds, report

SCENARIOS = ("wurtz_dodecane", "fictitious", "wurtz_real", "recrystallization")
PLAY = "from chemlab.cli import main; main()"


def run(checkout: Path, python: str, scenario: str, cache: str) -> dict[str, float]:
    """Return wall and processor seconds of a first episode with a cache, and the number of cached kernels
    afterwards.
    """
    words = [python, "-c", PLAY, "run", scenario, "--json"]
    env = {**os.environ, "PYTHONPATH": str(checkout.resolve()), "NUMBA_CACHE_DIR": cache}
    # Not inside the other checkout, whose chemlab would be imported.
    episode = functools.partial(subprocess.run, words, check=True, capture_output=True, cwd=cache, env=env)
    wall, processor = children_seconds(episode)
    return {"wall_s": wall, "processor_s": processor, "kernels": sum(1 for _ in Path(cache).rglob("*.nbc"))}


def measure(scenario: str, checkouts: list[tuple[Path, str]], rounds: int) -> list[dict[str, Any]]:
    """Return medians of a scenario's cold and warm starts for each checkout, measured in alternation."""
    found: list[list[tuple[dict[str, float], dict[str, float]]]] = [[] for _ in checkouts]
    for _ in range(rounds):
        for rows, (checkout, python) in zip(found, checkouts, strict=True):
            with tempfile.TemporaryDirectory() as cache:
                rows.append((run(checkout, python, scenario, cache), run(checkout, python, scenario, cache)))
    return [
        {
            kind: {key: statistics.median(row[at][key] for row in rows) for key in rows[0][at]}
            for at, kind in enumerate(("cold", "warm"))
        }
        for rows in found
    ]


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--before", nargs=2, metavar=("CHECKOUT", "PYTHON"), help="another commit, to compare with")
    parser.add_argument("--most", type=float, default=math.inf, help="largest accepted ratio of cold starts")
    given = arguments(parser)
    checkouts = [(Path(__file__).parents[2], sys.executable)]
    if given.before:
        checkouts.insert(0, (Path(given.before[0]), given.before[1]))
    results = {name: measure(name, checkouts, given.rounds) for name in given.scenarios}
    ratios = {name: rows[-1]["cold"]["processor_s"] / rows[0]["cold"]["processor_s"] for name, rows in results.items()}
    table = ["| scenario | kernels | cold, processor | cold, wall | warm, processor |", "|---|--:|--:|--:|--:|"]
    for name, rows in results.items():
        cold, warm = rows[-1]["cold"], rows[-1]["warm"]
        ratio = f" ({ratios[name]:.2f}x)" if given.before else ""
        table.append(
            f"| `{name}` | {cold['kernels']:.0f} | {cold['processor_s']:.0f} s{ratio} | {cold['wall_s']:.0f} s "
            f"| {warm['processor_s']:.1f} s |"
        )
    report(given, results, {"cold-start": table})
    return int(max(ratios.values()) > given.most)


if __name__ == "__main__":
    sys.exit(main())
