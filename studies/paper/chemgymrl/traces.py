"""Traces of the best policies: average actions by step, and best action sequences, as a table for the figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from chemlab import load_scenario
from chemlab.agents.episodes import play_bench
from chemlab.agents.evaluate.play import Target
from chemlab.agents.policies import bench_policy
from chemlab.roles.bench import Bench

from ..tables import number, read_table, write_table
from .results import EXPERIMENTS, TRACE_COLUMNS, TRACE_FILE, Experiment, Results, source_of

EPISODES = 40
"""Episodes per goal, enough to meet every starting state and to estimate a random policy's mean."""
SEED = 10_000
"""Seed of the first episode; evaluations during training use other seeds."""


def collect_traces(
    results: Results,
    folder: Path,
    episodes: int = EPISODES,
    watch: Callable[[str], None] | None = None,
) -> None:
    """Play the scripted policy, random actions and the best run of every algorithm; write ``traces.csv``.

    Args:
        results: results whose best runs are played; traces of runs known only from a table are kept.
        folder: folder of the table.
        episodes: episodes per goal; every policy plays the same seeds.
        watch: called with each policy's name when it has been played.

    Raises:
        ValueError: a run's checkpoint is missing or was made for another environment.
    """
    before = read_table(folder / TRACE_FILE, TRACE_COLUMNS)
    rows: list[dict[str, Any]] = []
    for key, cells in results.cells.items():
        experiment = EXPERIMENTS[key]
        sources = {"scripted": ("scripted", "", ""), "random": ("random", "", "")}
        for label, cell in cells.items():
            if cell.best.folder is None:
                rows += [row for row in before if (row["experiment"], row["policy"]) == (key, label)]
            else:
                sources[label] = (str(cell.best.folder.path), *source_of(cell))
        for label, (name, run, step) in sources.items():
            own = {"experiment": key, "policy": label, "fingerprint": experiment.fingerprint, "run": run, "step": step}
            rows += [{**own, **row} for row in _played(experiment, name, episodes)]
            if watch is not None:
                watch(f"{experiment.title}: {label}")
    write_table(folder / TRACE_FILE, TRACE_COLUMNS, rows)


def _played(experiment: Experiment, name: str, episodes: int) -> Iterator[dict[str, Any]]:
    """Yield a policy's rows."""
    env = Target(load_scenario(experiment.scenario), experiment.bench).environment(episodes)
    bench: Bench = env.bench
    policy = bench_policy(name, bench, SEED)
    for goal in experiment.goals:
        played = play_bench(env, policy, goal, SEED, record=True)
        assert played.actions is not None, "they were recorded"
        for case in sorted(set(played.cases)):
            chosen = np.flatnonzero(np.array(played.cases) == case)
            row = {"goal": goal, "case": case, "episodes": len(chosen)}
            row |= {"mean_return": number(float(played.returns[chosen].mean()), 9)}
            if bench.action_count:
                # Of equal returns, the shortest sequence.
                best = min(chosen, key=lambda i: (-round(float(played.returns[i]), 9), played.lengths[i]))
                actions: list[Any] = played.actions[best]
                row |= {"best_return": number(float(played.returns[best]), 9)}
            else:
                steps = range(int(played.lengths[chosen].max()))
                running = [[played.actions[i][t] for i in chosen if t < len(played.actions[i])] for t in steps]
                actions = [np.round(np.mean(some, axis=0), 4).tolist() for some in running]
            yield {**row, "actions": json.dumps(actions, separators=(",", ":"))}
