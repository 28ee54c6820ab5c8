"""Runs the fuzzers at a budget, keeps what came of them in ``docs/results/attacks.json``, and puts the table that is
made of it into ``docs/security.md``.

    python tests/fuzz/attacks.py files --tries 8000 --seed 1      # records, files, agents, forgeries, honest
    python tests/fuzz/attacks.py table                            # the table alone

A run takes the place of what was kept of this kind and seed before; ``--forget`` leaves out its other seeds, too.
``--look`` keeps nothing but the files that fail, one folder each, and says where they are.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import forgeries
import fuzz_agents
import fuzz_files
import fuzz_records

from chemlab.agents.evaluate.benchmark import _commit
from chemlab.config.datafile import read_json
from chemlab.config.files import replace_between, write_json

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "docs" / "results" / "attacks.json"
PAGE = ROOT / "docs" / "security.md"
TURNS = 25
"""Played where a file loads."""
FORGED = ("wurtz_dodecane", "relay", "rush", "failing")
"""Scenarios of the episodes that are forged: the plain one, and ones with grades, reports, orders over time, wear."""
Outcomes = dict[str, dict[str, int]]
"""By kind of file or forgery: how many came out how."""


def _campaign(run: Callable[..., tuple[Counter[str], list[str]]]) -> Callable[[int, int], tuple[Outcomes, list[str]]]:
    def of(tries: int, seed: int) -> tuple[Outcomes, list[str]]:
        keep = Path(tempfile.mkdtemp(prefix="chemlab-fuzz-"))
        print(f"files that fail are kept in {keep}", file=sys.stderr, flush=True)
        counts, failures = run(tries, seed, TURNS, keep)
        found: Outcomes = {}
        for name, count in sorted(counts.items()):
            kind, _, outcome = name.partition(": ")
            found.setdefault(kind, {})[outcome] = count
        return found, failures

    return of


def forged(tries: int, seed: int) -> tuple[Outcomes, list[str]]:
    """Forgeries of that many episodes: how they verify."""
    outcomes: Outcomes = {}
    failures: list[str] = []
    for scenario in FORGED:
        with tempfile.TemporaryDirectory() as folder:
            found = forgeries.forge(tries, Path(folder), scenario)
        failures += [f"{scenario}: {name}: {n} found right" for name, counter in found.items() if (n := counter["ok"])]
        for name, counter in found.items():
            if counter:  # not every scenario has what is forged
                outcomes[f"{name.replace('_', ' ')}: {scenario}"] = dict(sorted(counter.items()))
    return outcomes, failures


def honest(tries: int, seed: int) -> tuple[Outcomes, list[str]]:
    """Honest records of every scenario: how they verify."""
    command = [sys.executable, ROOT / "studies" / "speed" / "verify.py", "--episodes", str(tries), "--json"]
    report = json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False).stdout)
    return {"honest records": report["status"]}, [str(alarm) for alarm in report["alarms"]]


KINDS: dict[str, Callable[[int, int], tuple[Outcomes, list[str]]]] = {
    "files": _campaign(fuzz_files.fuzz),
    "agents": _campaign(fuzz_agents.fuzz),
    "records": _campaign(fuzz_records.fuzz),
    "forgeries": forged,
    "honest": honest,
}


def kept() -> list[dict[str, Any]]:
    """What the runs came to."""
    return list(read_json(KEPT)) if KEPT.exists() else []


def table(runs: list[dict[str, Any]]) -> Iterator[str]:
    """The lines of the table: what was tried, how it came out, what failed, and how it is tried again."""
    yield "| what | tries | came out | failures | `attacks.py` |"
    yield "|---|--:|---|--:|---|"
    for run in sorted(runs, key=lambda run: (list(KINDS).index(run["kind"]), run["seed"])):
        for name, outcomes in run["outcomes"].items():
            tries, failed = sum(outcomes.values()), outcomes.get("failed", 0)
            words = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items() if outcome != "failed")
            again = f"`{run['kind']} --tries {run['tries']} --seed {run['seed']}`"
            yield f"| {name} | {tries} | {words} | {failed} | {again} |"
    total = sum(run["tries"] for run in runs if run["kind"] in ("files", "agents", "records"))
    failures = sum(run["failures"] for run in runs)
    yield f"| **files and records in all** | **{total}** | | **{failures}** | |"


def main() -> int:
    """Run, keep, write; 1 if something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=[*KINDS, "table"])
    parser.add_argument("--tries", type=int, default=1000, help="files, records, or episodes that are forged")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--forget", action="store_true", help="leave out what was kept of other seeds of this kind")
    parser.add_argument("--look", action="store_true", help="print what fails, and leave results and page as they are")
    arguments = parser.parse_args()
    failures: list[str] = []
    if arguments.kind != "table":
        outcomes, failures = KINDS[arguments.kind](arguments.tries, arguments.seed)
        print("\n".join(failures))
        if arguments.look:
            print(json.dumps(outcomes, indent=1))
            return int(bool(failures))
        own = {"kind": arguments.kind, "tries": arguments.tries, "seed": arguments.seed, "commit": _commit()}
        own |= {"outcomes": outcomes, "failures": len(failures)}
        forget = arguments.forget
        others = [run for run in kept() if run["kind"] != own["kind"] or not (forget or run["seed"] == own["seed"])]
        write_json(KEPT, [*others, own])
    replace_between(PAGE, "attacks", list(table(kept())))
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
