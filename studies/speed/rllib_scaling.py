"""Turns per second of RLlib training with 1 and 2 env runners, and of the manager's view singly and in a batch.

Run ``python studies/speed/rllib_scaling.py`` (``--json`` for machines, ``--quick`` for a short run, ``--update PAGE``
to write the table between its marks). The runs exist side by side and alternate round by round, so that other load on
the machine affects them equally; figures are medians of rounds without the first. A round gathers a batch of turns and
learns from it. The learning rate is so small that policies stay constant: learning policies would play other episodes
(a manager that submits at once makes twenty times as many), which is other work. The number of episodes per round shows
that the work is the same. One process learns, so only gathering can scale.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import torch
from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS, NUM_ENV_STEPS_SAMPLED, NUM_EPISODES

from chemlab import load_scenario
from chemlab.agents.executors import connected
from chemlab.agents.roles import chosen_roles
from chemlab.config.files import replace_between
from chemlab.lab.engine import Laboratories

sys.path.insert(0, str(Path(__file__).parents[2] / "recipes"))
from rllib import algorithm_config

STILL = 1e-9
"""A learning rate without effect."""
VIEW, LABORATORIES = "chemlab/LabManager-v1", 64


class Timed:
    """An algorithm and its rounds: (turns, seconds of gathering, seconds of learning, episodes)."""

    clock = staticmethod(time.perf_counter)

    def __init__(self, scenario: str, roles: tuple[str, ...] | None, runners: int, batch: int) -> None:
        chosen = chosen_roles(Laboratories(scenario, 1), roles)
        settings: Any = {"runners": runners, "batch": batch, "learning_rate": STILL}
        self.algorithm = algorithm_config(load_scenario(scenario), chosen, **settings).build_algo()
        self.rounds: list[tuple[int, float, float, int]] = []
        self._learning = 0.0
        group: Any = self.algorithm.learner_group
        update = group.update

        def timed(*given: Any, **named: Any) -> Any:
            begun = self.clock()
            found = update(*given, **named)
            self._learning += self.clock() - begun
            return found

        group.update = timed

    def round(self) -> None:
        self._learning, begun = 0.0, self.clock()
        found = self.algorithm.train()[ENV_RUNNER_RESULTS]
        seconds = self.clock() - begun
        turns, episodes = int(found[NUM_ENV_STEPS_SAMPLED]), int(found.get(NUM_EPISODES, 0))
        self.rounds.append((turns, seconds - self._learning, self._learning, episodes))


def measure(scenario: str, roles: tuple[str, ...] | None, runners: tuple[int, ...], rounds: int, batch: int) -> Any:
    """Return the rates for every number of runners, all in one Ray instance."""
    torch.set_num_threads(1)
    # Ray gives its workers a low priority, so that other load on the machine would be measured.
    os.environ.setdefault("RAY_worker_niceness", "0")
    with connected(None, sum(runners)):
        runs = {n: Timed(scenario, roles, n, batch) for n in runners}
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
            run.algorithm.stop()
    return rows


def _view(settings: Any) -> gymnasium.Env[Any, Any] | gymnasium.vector.VectorEnv[Any, Any, Any]:
    """Return the manager's view: batched if a runner requests it."""
    if "num_envs" in settings:
        return gymnasium.make_vec(VIEW, settings["num_envs"], vectorization_mode="vector_entry_point")
    return gymnasium.make(VIEW)


def inside(rounds: int) -> dict[str, float]:
    """Return decisions per second of one runner with :data:`LABORATORIES` laboratories, singly and in a batch."""
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner
    from ray.tune.registry import register_env

    register_env("view", _view)
    runners = {}
    for mode in ("sync", "vector_entry_point"):
        config = PPOConfig().environment("view")
        config = config.env_runners(num_envs_per_env_runner=LABORATORIES, gym_env_vectorize_mode=mode)
        runners[mode] = SingleAgentEnvRunner(config=config)
    rates: dict[str, list[float]] = {mode: [] for mode in runners}
    turns = 32 * LABORATORIES
    for _ in range(rounds + 1):
        for mode, runner in runners.items():
            begun = Timed.clock()
            runner.sample(num_timesteps=turns)
            rates[mode].append(turns / (Timed.clock() - begun))
    return {mode: statistics.median(found[1:]) for mode, found in rates.items()}


def table(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table as Markdown."""
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
    rounds = 3 if given.quick else given.rounds
    rows = measure(given.scenario, roles, (1, 2), rounds, 4096)
    views = inside(rounds)
    if given.json:
        print(json.dumps({"rows": rows, "views": views, "cores": os.cpu_count(), "load": load}))
        return
    one, batch = views.values()
    lines = [
        *table(rows),
        "",
        f"{LABORATORIES} laboratories in a runner, the manager's view: {one:,.0f} decisions gathered a second one by "
        f"one, {batch:,.0f} ({batch / one:.2f}x) as a batch. {os.cpu_count()} cores; load average {load:.1f} before.",
    ]
    print("\n".join(lines))
    if given.update is not None:
        replace_between(given.update, "rllib-scaling", lines)


if __name__ == "__main__":
    main()
