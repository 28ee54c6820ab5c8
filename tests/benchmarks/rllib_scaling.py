"""Turns per second of training on RLlib with 1 and 2 env runners.

Run ``python tests/benchmarks/rllib_scaling.py`` (``--json`` for machines, ``--quick`` for a look, ``--update PAGE`` to
write the table between its marks). The runs stand side by side and take turns, a round each, so that whatever else the
machine does meets them alike; figures are medians of rounds, the first not counted. A round gathers a batch of turns
and learns from it. The learning rate is so small that policies stay as they begin: those that learn play other episodes
(a manager that submits at once makes twenty times as many), which is other work. Episodes a round show that it is the
same. One process learns, so that only gathering can scale.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from pathlib import Path
from typing import Any

import torch

from chemlab.agents.executors import connected
from chemlab.agents.rllib.train import _Team
from chemlab.agents.roles import chosen_roles
from chemlab.agents.training.arguments import RllibArguments
from chemlab.agents.training.loop import Progress
from chemlab.files import replace_between
from chemlab.laboratory.core import Laboratories
from chemlab.scenario import load_scenario

STILL = 1e-9
"""A learning rate that moves nothing."""


class Timed:
    """A team, and what its rounds took: (turns, seconds of gathering, seconds of learning, episodes)."""

    clock = staticmethod(time.perf_counter)

    def __init__(self, arguments: RllibArguments) -> None:
        scenario = load_scenario(arguments.scenario)
        roles = chosen_roles(Laboratories(scenario, 1), arguments.roles)
        self.team = _Team(arguments, scenario, roles, 0)
        self.rounds: list[tuple[int, float, float, int]] = []
        self._learning = 0.0
        group: Any = self.team.algorithm.learner_group
        update = group.update

        def timed(*given: Any, **named: Any) -> Any:
            begun = self.clock()
            found = update(*given, **named)
            self._learning += self.clock() - begun
            return found

        group.update = timed

    def round(self) -> None:
        self._learning, begun = 0.0, self.clock()
        turns, scores = self.team.learn(Progress())
        seconds = self.clock() - begun
        self.rounds.append((turns, seconds - self._learning, self._learning, len(scores)))


def measure(scenario: str, roles: tuple[str, ...] | None, runners: tuple[int, ...], rounds: int, batch: int) -> Any:
    """Rates of every number of runners, all in one Ray."""
    torch.set_num_threads(1)
    # Ray gives its workers a low priority, so that whatever else the machine does would be measured.
    os.environ.setdefault("RAY_worker_niceness", "0")
    with connected(None, sum(runners)):
        runs = {
            n: Timed(RllibArguments(scenario, roles=roles, runners=n, batch=batch, learning_rate=STILL))
            for n in runners
        }
        for _ in range(rounds + 1):
            for run in runs.values():
                run.round()
        rows = [
            {
                "runners": n,
                "gathered_per_second": statistics.median(t / gathering for t, gathering, _, _ in run.rounds[1:]),
                "all_per_second": statistics.median(t / (g + learning) for t, g, learning, _ in run.rounds[1:]),
                "episodes": statistics.median(episodes for _, _, _, episodes in run.rounds[1:]),
            }
            for n, run in runs.items()
        ]
        for run in runs.values():
            run.team.stop()
    return rows


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Markdown."""
    first = rows[0]
    lines = ["| env runners | turns gathered a second | learning included | episodes a round |", "|--:|--:|--:|--:|"]
    for row in rows:
        cells = [f"{row[key]:,.0f} ({row[key] / first[key]:.2f}x)" for key in ("gathered_per_second", "all_per_second")]
        lines.append(f"| {row['runners']} | {' | '.join(cells)} | {row['episodes']:.0f} |")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="wurtz_dodecane")
    parser.add_argument("--roles", nargs="*", help="default: all")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="3 rounds")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--update", type=Path, help="page with the marks rllib-scaling")
    given = parser.parse_args()
    roles = tuple(given.roles) if given.roles else None
    load = os.getloadavg()[0]
    rows = measure(given.scenario, roles, (1, 2), 3 if given.quick else given.rounds, 4096)
    if given.json:
        print(json.dumps({"rows": rows, "cores": os.cpu_count(), "load": load}))
        return
    lines = [*table(rows), "", f"{os.cpu_count()} cores; load average {load:.1f} before."]
    print("\n".join(lines))
    if given.update is not None:
        replace_between(given.update, "rllib-scaling", lines)


if __name__ == "__main__":
    main()
