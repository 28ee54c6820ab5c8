"""Cost of one world per laboratory: turns per processor second relative to the same scenario without hidden parameters.

Run ``python studies/speed/worlds.py`` (``--json`` for machines, ``--update docs/performance.md``). Both alternate in
one run; ratios are medians.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from statistics import median
from typing import Any

from throughput import batched_laboratory

from chemlab.config.draws import WorldSpec
from chemlab.config.files import replace_between
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario

LABORATORIES = 256


def measure(names: list[str], seconds: float, turns: int) -> dict[str, Any]:
    """Return, for each scenario, turns per second of 256 laboratories with separate worlds and with one world."""
    result: dict[str, Any] = {}
    for name in names:
        drawn = load_scenario(name)
        plain = drawn.model_copy(update={"world": WorldSpec()})
        found: dict[str, list[float]] = {"worlds": [], "one_world": []}
        for _ in range(turns):
            for kind, spec in (("worlds", drawn), ("one_world", plain)):
                found[kind].append(batched_laboratory(LABORATORIES, seconds, spec, time.process_time))
        ratio = median(a / b for a, b in zip(found["worlds"], found["one_world"], strict=True))
        result[name] = {"turns_a_second": found, "ratio": ratio}
    return result


def table(result: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    lines = ["| scenario | turns a second, 256 worlds | of one world |", "|---|--:|--:|"]
    for name, figures in result.items():
        lines.append(f"| `{name}` | {median(figures['turns_a_second']['worlds']):,.0f} | {figures['ratio']:.2f} |")
    return "\n".join(lines)


def main() -> None:
    """Run the command."""
    worlds = [name for name in scenario_names() if load_scenario(name).world.draws]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", default=worlds, help="default: all with hidden parameters")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="of each of the two")
    parser.add_argument("--update", type=Path, metavar="FILE", help="put the table into this Markdown file")
    chosen = parser.parse_args()
    result = measure(chosen.scenarios, chosen.seconds, chosen.turns)
    print(json.dumps(result, indent=2) if chosen.json else table(result))
    if chosen.update:
        replace_between(chosen.update, "worlds", table(result).splitlines())


if __name__ == "__main__":
    main()
