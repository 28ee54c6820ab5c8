"""Growth of the time per turn and the memory per laboratory with benches, slots, materials, reactions, laboratories.

Run ``python studies/speed/growth.py`` (``--json``, ``--update docs/performance.md``; ``--axes`` selects axes, and
``--rounds 3 --seconds 0.1 --most 64`` is a short run). All agents play random legal actions. Time is processor time on
one thread of ``BatchedLaboratory.step`` alone, per turn of an agent; the sizes of an axis are measured in alternation,
``--rounds`` times. The exponent is the slope of log(time) over log(size), fitted in every round: median, minimum and
maximum; beside it the exponent of the two largest sizes, which approximates the limit. Memory is the allocation per
additional laboratory, by ``tracemalloc``; its exponent is that of the two largest sizes.

Benches and slots exceed the limits of a scenario file, to show the trend. Materials are isomers that convert into one
another. With more reactions each is proportionally slower, so that their total rate, and with it the number of
integrator steps, is constant.
"""

from __future__ import annotations

import argparse
import gc
import os
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from itertools import cycle, islice, permutations
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from report import arguments, report
from throughput import Play

from chemlab import BatchedLaboratory, load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleVectorEnv

BASE = "wurtz_dodecane"
_FEW_REACTIONS, _FEW_MATERIALS = 6, 20
_VESSELS = 4
_FIRST_TURNS = 200
"""Turns played before measuring, so that laboratories are at different stages of their episodes."""


def with_benches(count: int) -> Scenario:
    """Return a scenario with a number of each of three kinds of benches."""
    spec = load_scenario(BASE)
    benches = {key: bench.model_copy(update={"count": count}) for key, bench in spec.benches.items()}
    return spec.model_copy(update={"benches": benches})


def with_slots(count: int) -> Scenario:
    """Return a scenario with a shelf of this size and the base scenario's vessels."""
    spec = load_scenario(BASE)
    return spec.model_copy(update={"shelf": spec.shelf.model_copy(update={"slots": count})})


def isomers(materials: int, reactions: int) -> Scenario:
    """Return a scenario of isomers, distributed over four vessels, with reactions between them."""
    names = [f"m{i}" for i in range(materials)]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "materials.toml").write_text("\n".join(_material(i, name) for i, name in enumerate(names)))
        steps = "\n".join(
            f"[[reaction]]\nreactants = {{ {a} = 1 }}\nproducts = {{ {b} = 1 }}\n"
            f"pre_exponential = {1e5 / reactions:.6g}\n"
            'activation_energy_j_mol = 40000.0\nsource = "made up for a benchmark"\n'
            for a, b in islice(_pairs(names), reactions)
        )
        (Path(folder) / "family.toml").write_text(f'name = "family"\nsummary = "isomers"\n{steps}')
        vessels = []
        for own in (names[i::_VESSELS] for i in range(_VESSELS)):
            contents = ", ".join(["diethyl_ether = 4.0", *(f"{name} = {1.0 / len(own):.6g}" for name in own)])
            vessels.append(f"{{ capacity_l = 1.2, contents = {{ {contents} }} }}")
        goals = names[:5]
        text = 'name = "isomers"\nbase = "fictitious"\nreactions = "family.toml"\nmaterial_files = ["materials.toml"]\n'
        text += f"goals = {goals}\nlab_goals = {goals}\nstock = {{ m0 = 1.0 }}\n"
        text += 'remove = ["theoretical_maximum_mol", "costs.stock_per_mol", "benches.rxn.reagents", '
        text += '"benches.rxn.penalty", "benches.dit.start", "benches.rxn.start"]\n'
        text += f"theoretical_maximum_mol = {{ {', '.join(f'{goal} = 1.0' for goal in goals)} }}\n"
        text += f"[shelf]\nvessel = [{', '.join(vessels)}]\n"
        text += f"[benches.rxn]\nreagents = {{ m0 = 1.0 }}\nstart = {vessels[0]}\n"
        text += "[benches.dit]\nstart = { capacity_l = 1.2, contents = { diethyl_ether = 4.0 }, goal_mol = 1.0 }\n"
        path = Path(folder) / "isomers.toml"
        path.write_text(text)
        return load_scenario(path)


def _pairs(names: list[str]) -> Any:
    """Yield pairs: first a ring, so that every material takes part, then all others."""
    ring = list(zip(names, [*names[1:], names[0]], strict=True))
    return iter([*ring, *(pair for pair in permutations(names, 2) if pair not in set(ring))])


def _material(number: int, name: str) -> str:
    kelvin = 380.0 + 0.5 * number
    keys = ("molar_mass_g_mol", "density_kg_l", "heat_capacity_j_mol_k", "boiling_point_k")
    source = "\n".join(f'{key} = "made up"' for key in (*keys, "vaporization_enthalpy_j_mol", "polarity"))
    return f"""[{name}]
name = "{name}"
formula = "Q"
composition = {{ Qq = 1 }}
molar_mass_g_mol = 80.0
density_kg_l = 0.8
heat_capacity_j_mol_k = 150.0
boiling_point_k = {kelvin}
vaporization_enthalpy_j_mol = 35000.0
polarity = 0.2
role = "solute"
color = "#cc6677"
shade = {0.1 + 0.004 * number:.3f}
absorption = [{{ height_l_mol = 0.1, center_nm = {250 + 2 * number}.0, width_nm = 20.0 }}]

[{name}.source]
{source}
color_shade_absorption = "made up"
"""


class BenchPlay(Play):
    """Reaction benches alone."""

    def __init__(self, scenario: str | Scenario, count: int) -> None:
        self._envs = RoleVectorEnv(count, scenario=scenario, bench="rxn", copy=False)
        self._envs.reset(seed=0)
        self._envs.action_space.seed(0)
        self._actions = cycle([self._envs.action_space.sample() for _ in range(64)])

    def round(self, _: int = 0) -> int:
        """See :meth:`Play.round`."""
        action, begun = next(self._actions), time.process_time()
        self._envs.step(action)
        self.spent += time.process_time() - begun
        return self._envs.num_envs


def turns(play: Play, least: int, seconds: float) -> tuple[int, float]:
    """Play a minimum number of turns and seconds; return (turns, processor seconds in ``step``)."""
    done, before = 0, play.spent
    while done < least or play.spent - before < seconds:
        done += play.round()
    return done, play.spent - before


Axis = tuple[tuple[int, ...], Callable[[int], Scenario], int, type[Play]]
_MATERIALS, _REACTIONS = (10, 20, 50, 100, 200), (6, 12, 25, 50, 100, 200)
AXES: dict[str, Axis] = {
    "benches of each kind": ((1, 2, 4, 8, 16, 32, 64), with_benches, 64, Play),
    "slots": ((8, 16, 32, 64, 128, 256, 512), with_slots, 64, Play),
    "materials": (_MATERIALS, lambda count: isomers(count, _FEW_REACTIONS), 64, Play),
    "materials, reaction bench alone": (_MATERIALS, lambda count: isomers(count, _FEW_REACTIONS), 64, BenchPlay),
    "reactions": (_REACTIONS, lambda count: isomers(_FEW_MATERIALS, count), 64, Play),
    "reactions, reaction bench alone": (_REACTIONS, lambda count: isomers(_FEW_MATERIALS, count), 64, BenchPlay),
    "laboratories": ((1, 4, 16, 64, 256, 1024, 4096, 16384), lambda _: load_scenario(BASE), 0, Play),
}
"""By name: sizes, the scenario of a size, the number of laboratories (0: the size), and the player class."""


def memory(spec: Scenario, few: int = 2, more: int = 10) -> float:
    """Return the bytes per additional laboratory."""
    sizes = []
    for count in (few, few, more):  # objects loaded by the first laboratory are shared by the others
        gc.collect()
        tracemalloc.start()
        batch = BatchedLaboratory(count, spec, copy=False)
        batch.reset(seed=0)
        sizes.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        del batch
    return (sizes[2] - sizes[1]) / (more - few)


def slope(sizes: Any, values: Any) -> float:
    """Return the exponent of the best fitting power law."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def measure(name: str, rounds: int, seconds: float, most: int | None) -> dict[str, Any]:
    """Return microseconds per turn and bytes per laboratory at every size of an axis, with exponents."""
    sizes, scenario, count, player = AXES[name]
    sizes = tuple(size for size in sizes if most is None or size <= most)
    specs = [scenario(size) for size in sizes]
    plays = [player(spec, count or size) for spec, size in zip(specs, sizes, strict=True)]
    for play in plays:
        turns(play, _FIRST_TURNS, 0.0)
    found = []
    for _ in range(rounds):
        found.append([1e6 * spent / done for done, spent in (turns(play, 1, seconds) for play in plays)])
    del plays
    fits = [slope(sizes, row) for row in found]
    at_end = [slope(sizes[-2:], row[-2:]) for row in found]
    each = [memory(specs[0])] if not count else [memory(spec) for spec in specs]
    return {
        "sizes": sizes,
        "turn_us": [median(column) for column in zip(*found, strict=True)],
        "exponent": [median(fits), min(fits), max(fits)],
        "exponent_at_end": [median(at_end), min(at_end), max(at_end)],
        "bytes": each,
        "bytes_exponent": slope(sizes[-2:], each[-2:]) if count else 0.0,
    }


def table(result: dict[str, Any]) -> list[str]:
    """Return the figures as Markdown."""
    lines = ["| | sizes | µs a turn | exponent [range] | of the last two | KiB a laboratory | exponent |"]
    lines.append("|---|---|---|--:|--:|---|--:|")
    for name, one in result.items():
        fitted, last = (f"{m:.2f} [{a:.2f}, {b:.2f}]" for m, a, b in (one["exponent"], one["exponent_at_end"]))
        times, kib = (
            ", ".join(f"{x:.3g}" if x < 1000.0 else f"{x:,.0f}" for x in xs)
            for xs in (one["turn_us"], [b / 1024.0 for b in one["bytes"]])
        )
        sizes = ", ".join(f"{size:,}" for size in one["sizes"])
        lines.append(f"| {name} | {sizes} | {times} | {fitted} | {last} | {kib} | {one['bytes_exponent']:.2f} |")
    return lines


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--axes", nargs="*", default=list(AXES), choices=list(AXES), metavar="AXIS", help="default: all"
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.5, help="of each measurement")
    parser.add_argument("--most", type=int, help="no larger sizes")
    given = arguments(parser)
    load = os.getloadavg()[0]
    result = {name: measure(name, given.rounds, given.seconds, given.most) for name in given.axes}
    lines = [*table(result), "", f"{given.rounds} rounds; load average {load:.1f} before."]
    report(given, result, {"growth": lines})


if __name__ == "__main__":
    main()
