"""Compare two commits: rows of throughput.py measured in alternation, with the ratio of each pair.

Each commit is a checkout with a Python that has chemlab's dependencies installed::

    git worktree add ../before <commit>
    python studies/speed/compare_commits.py --before ../before python --least 0.8

A machine's speed drifts, so only the ratios (after / before) are meaningful: the median of ``--rounds`` pairs, with
minimum and maximum. A row whose median is below ``--least`` is measured as many times again; if the median of all pairs
is still below, the exit code is 1. The exit code is also 1 if the newer commit cannot measure a row; a row that the
older commit cannot measure is left out.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import IO, cast

ROWS: dict[str, str] = {
    "CartPole-v1 (the machine)": 'single("CartPole-v1", SECONDS)',
    **{f"{name}, single": f'single("chemlab/{name}-v0", SECONDS)' for name in ("WurtzReaction", "WurtzExtraction")},
    "WurtzDistillation, single": 'single("chemlab/WurtzDistillation-v0", SECONDS)',
    "FictitiousReaction, single": 'single("chemlab/FictitiousReaction-v0", SECONDS)',
    "WurtzReaction, 256": 'batched("WurtzReaction", 256, 1, SECONDS)',
    "WurtzReaction, 256, 2 threads": 'batched("WurtzReaction", 256, 2, SECONDS)',
    "FictitiousReaction, 256": 'batched("FictitiousReaction", 256, 1, SECONDS)',
    "WurtzExtraction, 256": 'batched("WurtzExtraction", 256, 1, SECONDS)',
    "WurtzExtraction, 256, 2 threads": 'batched("WurtzExtraction", 256, 2, SECONDS)',
    "SaltFromOilExtraction, 256": 'batched("SaltFromOilExtraction", 256, 1, SECONDS)',
    "WurtzDistillation, 256": 'batched("WurtzDistillation", 256, 1, SECONDS)',
    **{
        f"Real{name}, 256": f'batched("Real{name}", 256, 1, SECONDS)'
        for name in ("WurtzReaction", "WurtzExtraction", "WurtzDistillation")
    },
    **{
        f"crystallization in {scenario}, 64": f'batched("Bench", 64, 1, SECONDS, 1, scenario={scenario!r}, bench="cry")'
        for scenario in ("benzoic", "recrystallization")
    },
    "env, agent steps": "laboratory(laboratory_env, SECONDS)",
    "raw_env, agent steps": "laboratory(raw_env, SECONDS)",
    "parallel_env, agent steps": "parallel(SECONDS)",
    "256 laboratories, turns": "batched_laboratory(256, 3 * SECONDS)",
    **{f"manager's view, {count}": f"manager_view({count}, SECONDS)" for count in (64, 256)},
    **{f"PPO's collection, manager, {s}": f"collection(4 * SECONDS, {s!r})" for s in ("rush@1", "unlabelled@1")},
    "PPO's collection, every role, rush@1": 'collection(4 * SECONDS, "rush@1", True)',
    "verification, turns": "verification(4 * SECONDS)",
}
WORKER = """
import json, sys
sys.path.insert(0, {folder!r})
from throughput import *
for line in sys.stdin:
    SECONDS, row = json.loads(line)
    try:
        found = eval(row)
    except Exception as error:
        found = f"{{type(error).__name__}}: {{error}}"
    print(json.dumps(found), flush=True)
"""


class Refused(Exception):
    """A commit cannot measure a row."""


class Worker:
    """A process of one checkout that measures rows on request."""

    def __init__(self, python: str, checkout: Path) -> None:
        code = WORKER.format(folder=str(checkout.resolve() / "studies" / "speed"))
        # Not inside the other checkout, whose chemlab would be imported.
        self._process = subprocess.Popen(
            [python, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=checkout.resolve().parent,
            env={**os.environ, "PYTHONPATH": str(checkout.resolve())},
        )

    def rate(self, row: str, seconds: float) -> float:
        """Return the rate of a row in steps per second.

        Raises:
            Refused: a required function is missing or fails.
        """
        inward, outward = cast(IO[str], self._process.stdin), cast(IO[str], self._process.stdout)
        inward.write(json.dumps([seconds, row]) + "\n")
        inward.flush()
        answer = outward.readline()
        if not answer:
            raise SystemExit(f"a worker ended while it measured {row}")
        found = json.loads(answer)
        if isinstance(found, str):
            raise Refused(found)
        return float(found)


def pairs(before: Worker, after: Worker, row: str, rounds: int, seconds: float, least: float) -> list[list[float]]:
    """Return rates (before, after) of a row in alternation; twice as many if the first median is below ``least``.

    Raises:
        Refused: one of the commits cannot measure it.
    """
    for worker in (before, after):
        worker.rate(row, 0.01)  # kernels compile
    found: list[list[float]] = []
    while len(found) < rounds or (len(found) == rounds and _middle(found) < least):
        found += [[worker.rate(row, seconds) for worker in (before, after)] for _ in range(rounds)]
    return found


def _middle(rates: list[list[float]]) -> float:
    return statistics.median(new / old for old, new in rates)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", nargs=2, required=True, metavar=("CHECKOUT", "PYTHON"))
    parser.add_argument("--after", nargs=2, default=[".", sys.executable], metavar=("CHECKOUT", "PYTHON"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.5, help="of each measurement")
    parser.add_argument("--least", type=float, default=0.0, help="smallest ratio that is not a failure")
    parser.add_argument("--rows", default="", help="only rows whose names contain this")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if not any(arguments.rows in name for name in ROWS):
        parser.error(f"--rows: no row contains {arguments.rows!r}; rows: {'; '.join(ROWS)}")
    before, after = (Worker(python, Path(checkout)) for checkout, python in (arguments.before, arguments.after))
    ratios: dict[str, list[float]] = {}
    slower: list[str] = []
    for name, row in ROWS.items():
        if arguments.rows not in name:
            continue
        try:
            rates = pairs(before, after, row, arguments.rounds, arguments.seconds, arguments.least)
        except Refused as error:
            print(f"{name:<32} {error}", file=sys.stderr)
            try:
                after.rate(row, 0.01)
            except Refused:
                slower.append(name)
            continue
        ratios[name] = [new / old for old, new in rates]
        if _middle(rates) < arguments.least:
            slower.append(name)
        if not arguments.json:
            told = " ".join(f"{statistics.median(column):>11,.0f}" for column in zip(*rates, strict=True))
            low, high = min(ratios[name]), max(ratios[name])
            print(f"{name:<32} {told}  {_middle(rates):5.2f}  [{low:.2f}, {high:.2f}]", flush=True)
    if arguments.json:
        print(json.dumps(ratios, indent=1))
    if slower:
        print(f"below {arguments.least:g} of before, or not measured: {', '.join(slower)}", file=sys.stderr)
    return int(bool(slower))


if __name__ == "__main__":
    sys.exit(main())
