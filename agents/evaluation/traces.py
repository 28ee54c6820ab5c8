"""What the best policies do: average actions by step, and their best sequences of actions, as data for figures."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from chemlab.files import write_text
from chemlab.scenario import load_scenario

from ..player import Played, play_bench
from ..policies import bench_policy
from ..pretrained import fingerprint
from ..runs import versions
from .play import BenchTarget
from .results import EXPERIMENTS, Experiment, Results, trace_source

__all__ = ["collect_traces", "trace_count"]

EPISODES = 40
"""For each goal: enough to meet every starting state, and for the means of a random policy."""
SEED = 10_000
"""Of the first episode; training's own evaluations have other seeds."""


def trace_count(results: Results) -> int:
    """Number of policies that :func:`collect_traces` will play."""
    return sum(2 + len(cells) for cells in results.cells.values())


def collect_traces(
    results: Results, episodes: int = EPISODES, seed: int = SEED, watch: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Play the scripted policy, random actions and the best run of every algorithm; write ``traces.json``.

    Args:
        results: whose runs to play; the file stands beside them, for
            :func:`~chemlab.agents.evaluation.results.read_results`.
        episodes: for each goal; every policy plays the same seeds.
        seed: of the first episode.
        watch: called with each policy's name when it has been played.

    Returns:
        ``{"experiments": {key: {"fingerprint", "action_names", "goals", "policies": {label: ...}}}, ...}``. A
        policy has its ``source`` (its run's path below the results, seed, the checkpoint's step and result; or None)
        and, by goal, ``mean_return``, returns ``by_case`` (starting state) and either ``mean_actions``
        [steps][actions] or, by case, the ``best`` episode: return and actions.

    Raises:
        ValueError: a run's checkpoint is missing or was made for another environment.
    """
    experiments = {}
    for key, cells in results.cells.items():
        experiment = EXPERIMENTS[key]
        sources: dict[str, tuple[str, dict[str, Any] | None]] = {
            "heuristic": ("heuristic", None),
            "random": ("random", None),
        }
        for label, cell in cells.items():
            sources[label] = (str(cell.best.run.path), trace_source(results.folder, cell))
        experiments[key] = _played(experiment, sources, episodes, seed, watch)
    traces = {
        "kind": "traces",
        "format": 2,
        "episodes_per_goal": episodes,
        "seed": seed,
        "versions": versions(),
        "experiments": experiments,
    }
    write_text(results.folder / "traces.json", json.dumps(traces, separators=(",", ":")) + "\n")
    return traces


def _played(
    experiment: Experiment,
    sources: dict[str, tuple[str, dict[str, Any] | None]],
    episodes: int,
    seed: int,
    watch: Callable[[str], None] | None,
) -> dict[str, Any]:
    scenario = load_scenario(experiment.scenario)
    env = BenchTarget(scenario, experiment.bench).environment(episodes)
    policies = {}
    for label, (name, source) in sources.items():
        policy = bench_policy(name, env.bench, seed)
        goals = {goal: _goal(play_bench(env, policy, goal, seed, record=True), env) for goal in scenario.goals}
        mean = float(np.mean([goal["mean_return"] for goal in goals.values()]))
        policies[label] = {"source": source, "mean_return": mean, "by_goal": goals}
        if watch is not None:
            watch(f"{experiment.title}: {label}")
    return {
        "scenario": experiment.scenario,
        "bench": experiment.bench,
        "fingerprint": fingerprint(env.bench),
        "goals": list(scenario.goals),
        "action_names": _short_names(env) or env.action_meanings,
        "policies": policies,
    }


def _short_names(env: Any) -> list[str]:
    """Names of continuous actions."""
    names = getattr(env.bench, "reagent_names", None)
    return [] if names is None else ["temperature", "volume", *(f"add {name}" for name in names)]


def _goal(played: Played, env: Any) -> dict[str, Any]:
    """One policy's episodes for one goal."""
    assert played.actions is not None, "they were recorded"
    cases = np.array(played.cases)
    found: dict[str, Any] = {"mean_return": float(played.returns.mean()), "by_case": {}}
    for case in sorted(set(played.cases)):
        chosen = np.flatnonzero(cases == case)
        entry: dict[str, Any] = {"episodes": len(chosen), "mean_return": float(played.returns[chosen].mean())}
        if env.bench.action_count:
            # Of equal returns the shortest: what it did was enough.
            best = min(chosen, key=lambda i: (-round(float(played.returns[i]), 9), played.lengths[i]))
            entry["best"] = {"return": float(played.returns[best]), "actions": played.actions[best]}
        found["by_case"][case] = entry
    if not env.bench.action_count:
        steps = range(int(played.lengths.max()))
        running = [[episode[t] for episode in played.actions if t < len(episode)] for t in steps]
        found["mean_actions"] = [np.round(np.mean(actions, axis=0), 4).tolist() for actions in running]
    return found
