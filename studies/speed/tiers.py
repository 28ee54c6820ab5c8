"""Speed of the backend ``real`` relative to ``paper``, bench by bench, and a profile of a step.

Run ``python studies/speed/tiers.py`` (``--json`` for machines, ``--update docs/performance.md``). Both backends
alternate in one run; ratios are medians.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from statistics import median
from typing import Any

from throughput import batched, parts, single

from chemlab.config.files import replace_between

BENCHES = ("WurtzReaction", "WurtzExtraction", "WurtzDistillation")


def measure(seconds: float, turns: int) -> dict[str, Any]:
    """Measure each bench.

    Returns:
        Steps per second of both backends, in a batch of 256 on one thread and singly, in alternation; and the
            microseconds
        of a step's parts in the backend ``real``.
    """
    result: dict[str, Any] = {}
    for name in BENCHES:
        found: dict[str, list[float]] = {"batch": [], "batch_paper": [], "single": [], "single_paper": []}
        for _ in range(turns):
            for tier, real in (("", "Real"), ("_paper", "")):
                found[f"batch{tier}"].append(batched(f"{real}{name}", 256, 1, seconds))
                found[f"single{tier}"].append(single(f"chemlab/{real}{name}-v0", seconds))
        ratios = {
            view: median(a / b for a, b in zip(found[view], found[f"{view}_paper"], strict=True))
            for view in ("batch", "single")
        }
        result[name] = {"steps_a_second": found, "ratio": ratios, "parts_us": parts(f"Real{name}", seconds)}
    return result


def table(result: dict[str, Any]) -> str:
    """Return the figures as Markdown."""
    lines = ["| bench | real, batch 256 | of paper | single, of paper | µs: physics | observation | python |"]
    lines.append("|---|--:|--:|--:|--:|--:|--:|")
    for name, figures in result.items():
        ratio, spent = figures["ratio"], figures["parts_us"]
        rate = median(figures["steps_a_second"]["batch"])
        cells = [f"{rate:,.0f}", f"{ratio['batch']:.2f}", f"{ratio['single']:.2f}"]
        cells += [f"{spent[part]:.2f}" for part in ("physics", "observation", "python")]
        lines.append(f"| `Real{name}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="of each backend")
    parser.add_argument("--update", type=Path, metavar="FILE", help="put the table into this Markdown file")
    chosen = parser.parse_args()
    result = measure(chosen.seconds, chosen.turns)
    print(json.dumps(result, indent=2) if chosen.json else table(result))
    if chosen.update:
        replace_between(chosen.update, "tiers", table(result).splitlines())


if __name__ == "__main__":
    main()
