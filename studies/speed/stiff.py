"""Time of a tick of stiff reactions in the backend ``real``.

    python studies/speed/stiff.py

Networks of 6, 8 and 10 reactions over two species more, of order 1 and 2, half of them reversible, with 60 kJ/mol and
rate constants from 1e-3 to 1e6 at 298 K; ticks of 1 at rtol 1e-3, atol 1e-9 mol/L. *First* is the tick in which a fresh
mixture reaches its fast equilibria, *then* is the mean of the next hundred. Processor time, one thread, best of five.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from real_tier import filled, network

from chemlab.physics.backends.real.kinetics import ALONE, integrate, react_work_size
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.physics.surroundings import Surroundings

_ENERGY = 60e3


def stiff_network(reactions: int, seed: int) -> tuple[Any, np.ndarray]:
    """Return a chemistry and a vessel's contents."""
    rng = np.random.default_rng(seed)
    species = reactions + 2
    steps = []
    for _ in range(reactions):
        chosen = [int(j) for j in rng.permutation(species)]
        order = int(rng.integers(1, 3))
        step: dict[str, Any] = {
            "reactants": dict.fromkeys(chosen[:order], 1),
            "products": dict.fromkeys(chosen[order : 2 * order], 1),
            "k": 10.0 ** rng.uniform(-3.0, 6.0) * math.exp(_ENERGY / (GAS_CONSTANT * 298.15)),
            "energy": _ENERGY,
        }
        if rng.random() < 0.5:
            step["equilibrium"] = 10.0 ** rng.uniform(-2.0, 2.0)
        steps.append(step)
    return network(steps, species, rng.uniform(-5e3, 5e3, species)), rng.uniform(0.1, 1.0, species)


def microseconds(run: Callable[[], Any], times: int) -> float:
    """Return the processor time of a call, the best of five rounds."""
    best = math.inf
    for _ in range(5):
        begun = time.process_time()
        for _ in range(times):
            run()
        best = min(best, (time.process_time() - begun) / times)
    return best * 1e6


def main() -> None:
    """Print the table."""
    print(f"{'reactions':>9} {'vessel':>10} {'steps':>6} {'first/us':>9} {'then/us':>8}")
    for reactions in (6, 8, 10):
        for name, transfer in (("thermostat", math.inf), ("jacket", 50.0)):
            results = []
            for seed in range(5):
                table, amounts = stiff_network(reactions, seed)
                work = np.zeros(react_work_size(table.arrays))
                start = filled(table, amounts)
                row = start.copy()

                def tick(
                    row: np.ndarray = row, table: Any = table, work: np.ndarray = work, u: float = transfer
                ) -> int:
                    around = Surroundings(298.15, u, -1.0, 1e-3, 1e-9)
                    return integrate(row, 1.0, around, math.inf, ALONE, table.handle, work)[0]

                def fresh(row: np.ndarray = row, start: np.ndarray = start, tick: Callable[[], int] = tick) -> int:
                    row[:] = start
                    return tick()

                def hundred(fresh: Callable[[], int] = fresh, tick: Callable[[], int] = tick) -> None:
                    fresh()
                    for _ in range(100):
                        tick()

                first = microseconds(fresh, 200)
                results.append((fresh(), first, (microseconds(hundred, 5) - first) / 100.0))
            steps, first, then = np.mean(results, axis=0)
            print(f"{reactions:9d} {name:>10} {steps:6.0f} {first:9.1f} {then:8.1f}")
    table, amounts = stiff_network(10, 0)
    row, work = filled(table, 0.0 * amounts), np.zeros(react_work_size(table.arrays))
    around = Surroundings(298.15, 0.0, -1.0, 1e-3, 1e-9)
    nothing = microseconds(lambda: integrate(row, 1.0, around, math.inf, ALONE, table.handle, work)[0], 10_000)
    print(f"a vessel in which nothing can react: {nothing:.2f} us, the call from Python included")


if __name__ == "__main__":
    main()
