"""Cost of the backend ``real`` and of hidden parameters: rates with and without them, in alternation.

    python studies/speed/ratios.py tiers      each bench, with a profile of a step
    python studies/speed/ratios.py worlds     256 laboratories of every scenario with hidden parameters

``tiers`` counts steps per second; the other backend is ``paper``. ``worlds`` counts turns per processor second of
laboratories with a world each; the others are of the same scenario without hidden parameters. Ratios are medians.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median
from typing import Any

from report import arguments, report
from throughput import batched, batched_laboratory, parts, single

from chemlab.config.draws import WorldSpec
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario

BENCHES = ("WurtzReaction", "WurtzExtraction", "WurtzDistillation")
LABORATORIES = 256


def compared(rate: Callable[..., float], one: Any, other: Any, turns: int) -> dict[str, Any]:
    """Return rates of two cases in alternation, [turns, 2], the median of the first, and the median ratio to it."""
    rates = [(rate(one), rate(other)) for _ in range(turns)]
    return {"rates": rates, "rate": median(a for a, _ in rates), "ratio": median(a / b for a, b in rates)}


def tiers(names: list[str], seconds: float, turns: int) -> dict[str, Any]:
    """Return steps per second of benches in a batch of 256 on one thread and singly, and µs of a step's parts."""
    return {
        f"Real{name}": {
            "batch": compared(lambda name: batched(name, 256, 1, seconds), f"Real{name}", name, turns),
            "single": compared(lambda name: single(f"chemlab/{name}-v0", seconds), f"Real{name}", name, turns),
            "parts_us": parts(f"Real{name}", seconds),
        }
        for name in names or BENCHES
    }


def tiers_table(result: dict[str, Any]) -> list[str]:
    """Return the figures as Markdown."""
    lines = ["| bench | real, batch 256 | of paper | single, of paper | µs: physics | observation | python |"]
    lines.append("|---|--:|--:|--:|--:|--:|--:|")
    for name, figures in result.items():
        batch, spent = figures["batch"], figures["parts_us"]
        cells = [f"{batch['rate']:,.0f}", f"{batch['ratio']:.2f}", f"{figures['single']['ratio']:.2f}"]
        cells += [f"{spent[part]:.2f}" for part in ("physics", "observation", "python")]
        lines.append(f"| `{name}` | " + " | ".join(cells) + " |")
    return lines


def worlds(names: list[str], seconds: float, turns: int) -> dict[str, Any]:
    """Return the turns per processor second of 256 laboratories of scenarios."""

    def rate(spec: Any) -> float:
        return batched_laboratory(LABORATORIES, seconds, spec, time.process_time)

    specs = [spec for spec in map(load_scenario, names or scenario_names()) if names or spec.world.draws]
    return {spec.name: compared(rate, spec, spec.model_copy(update={"world": WorldSpec()}), turns) for spec in specs}


def worlds_table(result: dict[str, Any]) -> list[str]:
    """Return the figures as Markdown."""
    lines = ["| scenario | turns a second, 256 worlds | of one world |", "|---|--:|--:|"]
    return [*lines, *(f"| `{name}` | {one['rate']:,.0f} | {one['ratio']:.2f} |" for name, one in result.items())]


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("tiers", "worlds"))
    parser.add_argument("names", nargs="*", help="benches, or scenarios; default: all")
    parser.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    parser.add_argument("--turns", type=int, default=5, help="of each of the two")
    given = arguments(parser)
    measure, table = {"tiers": (tiers, tiers_table), "worlds": (worlds, worlds_table)}[given.what]
    result = measure(given.names, given.seconds, given.turns)
    report(given, result, {given.what: table(result)})


if __name__ == "__main__":
    main()
