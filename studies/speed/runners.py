"""Scaling of RLlib training with env runners: measured with one and two, simulated with more.

Run ``python studies/speed/runners.py`` (``--json``, ``--update docs/performance.md docs/cluster.md``). One
and two runners exist side by side and alternate round by round; figures are medians of rounds without the first. A
round gathers a batch of turns and learns from it. The learning rate is so small that policies stay constant: learning
policies would play other episodes (a manager that submits at once makes twenty times as many), which is other work. The
number of episodes per round shows that the work is the same. One process learns, so only gathering can scale.

The table `rllib-scaling` has turns per second of the clock. The tables `runners` have processor times of each process,
which exclude other load on the machine; they describe the case of one core per runner.

A simulated round: every runner plays its share of turns, and the round waits for the slowest (each takes the time of a
randomly drawn measured round). The samples are sent to the learner process, which unpacks them and updates; the new
weights go to every runner. Measured: a runner's and the learner's seconds per turn, the bytes of a turn and of the
weights. Assumed: ``--gigabits`` of the learner's network, ``--share`` turns per runner. The simulated speed-up for two
runners is reported beside the measured one: the slower runner's time plus the learner's.
"""

from __future__ import annotations

import argparse
import os
import pickle
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS, NUM_ENV_STEPS_SAMPLED, NUM_EPISODES
from report import arguments, report

from chemlab import load_scenario
from chemlab.agents.executors import connected
from chemlab.agents.rllib import LaboratoryMultiAgentEnv
from chemlab.agents.roles import chosen_roles
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories

sys.path.insert(0, str(Path(__file__).parents[2] / "recipes"))
import rllib

RUNNERS = (1, 2, 8, 64, 512)
STILL = 1e-9
"""A learning rate without effect."""
_ROUNDS = 200
"""Rounds of a simulation."""


def clocks() -> FloatArray:
    """Return [2] seconds of the clock and of this process's processor time."""
    return np.array([time.perf_counter(), time.process_time()])


def processor_seconds(_: Any) -> float:
    """Return the processor seconds of an env runner's process."""
    return time.process_time()


def bytes_a_turn(runner: Any) -> float:
    """Return the bytes per turn that a runner sends."""
    turns = 256
    return len(pickle.dumps(runner.sample(num_timesteps=turns))) / turns


class Team:
    """An algorithm for all roles, and figures of its rounds.

    Attributes:
        rounds: of each, seconds per turn and the number of episodes. Seconds of the clock are ``gathering`` and
            ``learning``, processor seconds are ``slowest`` runner, ``apart`` (the learner process without updating)
            and ``update``.
        each: processor seconds per turn of every runner in every round.
    """

    def __init__(self, scenario: str, runners: int, batch: int) -> None:
        roles = chosen_roles(Laboratories(scenario, 1), None)
        settings: Any = {"runners": runners, "batch": batch, "learning_rate": STILL}
        self.algorithm = rllib.algorithm_config(load_scenario(scenario), roles, **settings).build_algo()
        self.rounds: list[dict[str, float]] = []
        self.each: list[float] = []
        self._learning = np.zeros(2)
        group: Any = self.algorithm.learner_group
        update = group.update

        def timed(*given: Any, **named: Any) -> Any:
            begun = clocks()
            found = update(*given, **named)
            self._learning += clocks() - begun
            return found

        group.update = timed

    def of_runners(self, function: Any) -> list[float]:
        """Return a number of each runner."""
        group = self.algorithm.env_runner_group
        found: list[float] = group.foreach_env_runner(function, local_env_runner=False)
        return found

    def round(self) -> None:
        """Play and learn once."""
        self._learning[:] = 0.0
        runners, begun = self.of_runners(processor_seconds), clocks()
        found = self.algorithm.train()[ENV_RUNNER_RESULTS]
        taken = clocks() - begun
        played = [after - before for before, after in zip(runners, self.of_runners(processor_seconds), strict=True)]
        turns = int(found[NUM_ENV_STEPS_SAMPLED])
        (gathering, apart), (learning, update) = (taken - self._learning) / turns, self._learning / turns
        self.each += [one * len(played) / turns for one in played]
        seconds = {"gathering": gathering, "learning": learning, "slowest": max(played) / turns, "apart": apart}
        self.rounds.append({**seconds, "update": update, "episodes": int(found.get(NUM_EPISODES, 0))})

    def middle(self, *names: str) -> float:
        """Return the median over rounds of a figure, or of the sum of several."""
        return float(median(sum(row[name] for name in names) for row in self.rounds[1:]))


def environment_alone(scenario: str, turns: int) -> float:
    """Return processor seconds per turn of the runners' environment with random legal actions."""
    env = LaboratoryMultiAgentEnv({"scenario": scenario})
    seen, _ = env.reset(seed=0)
    spent = 0.0
    for turn in range(2 * turns):
        if turn == turns:
            spent = 0.0  # the first half is the warm-up
        (agent,) = seen
        mask = seen[agent]["action_mask"] if isinstance(seen[agent], dict) else None
        action = env.get_action_space(agent).sample(mask)
        begun = time.process_time()
        seen, _, terminated, truncated, _ = env.step({agent: action})
        if terminated["__all__"] or truncated["__all__"]:
            seen, _ = env.reset()
        spent += time.process_time() - begun
    return spent / turns


def measure(scenario: str, rounds: int, batch: int) -> dict[str, Any]:
    """Return seconds per turn and bytes, with one runner and with two, all in one Ray instance."""
    torch.set_num_threads(1)
    # Ray's workers import the recipe, too.
    paths = (str(Path(rllib.__file__).parent), os.environ.get("PYTHONPATH"))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    # Ray gives its workers a low priority, so that other load on the machine would be measured.
    os.environ.setdefault("RAY_worker_niceness", "0")
    with connected(None, 3):
        runs = {n: Team(scenario, n, batch) for n in RUNNERS[:2]}
        for _ in range(rounds + 1):
            for run in runs.values():
                run.round()
        one = runs[1]
        found = {
            "runner_s": one.each[1:],
            "apart_s": one.middle("apart"),
            "update_s": one.middle("update"),
            "turn_bytes": median(one.of_runners(bytes_a_turn)),
            "weights_bytes": len(pickle.dumps(one.algorithm.learner_group.get_weights())),
            "round_s": {n: run.middle("slowest", "apart", "update") for n, run in runs.items()},
            "gathering_s": {n: run.middle("slowest") for n, run in runs.items()},
            "clock": {
                n: [1.0 / run.middle("gathering"), 1.0 / run.middle("gathering", "learning"), run.middle("episodes")]
                for n, run in runs.items()
            },
        }
        for run in runs.values():
            run.algorithm.stop()
    return {**found, "environment_s": environment_alone(scenario, batch)}


def simulate(found: dict[str, Any], runners: int, share: int, gigabits: float) -> dict[str, float]:
    """Return the seconds of a round by activity, and turns per second."""
    rng, turns = np.random.default_rng(runners), runners * share
    slowest = rng.choice(found["runner_s"], (_ROUNDS, runners)).max(axis=1).mean() * share
    speed = gigabits * 1e9 / 8.0
    parts = {
        "playing": float(slowest),
        "sending": (turns * found["turn_bytes"] + runners * found["weights_bytes"]) / speed,
        "taking apart": turns * found["apart_s"],
        "updating": turns * found["update_s"],
    }
    return {**parts, "turns_a_second": turns / sum(parts.values())}


def table(result: dict[str, Any]) -> list[str]:
    """Return the table as Markdown."""
    found = result["measured"]
    runner = median(found["runner_s"])
    figures = {
        "runner, time of a turn": (1e6 * runner, "µs of a processor"),
        "of which in the laboratory": (1e6 * found["environment_s"], "µs"),
        "learner, taking a turn apart": (1e6 * found["apart_s"], "µs of a processor"),
        "learner, updating with a turn": (1e6 * found["update_s"], "µs of a processor"),
        "size of a turn": (found["turn_bytes"] / 1024, "KiB"),
        "size of the weights": (found["weights_bytes"] / 1024, "KiB"),
        "two runners to one, gathering": (result["gathering_speedup"], "x"),
        "the same, learning included": (result["speedup"], "x"),
        "the same, simulated": (result["simulated_speedup"], "x"),
    }
    lines = [
        "| measured | | |",
        "|---|--:|---|",
        *(f"| {words} | {value:,.{0 if value >= 20 else 2}f} | {unit} |" for words, (value, unit) in figures.items()),
        "",
        "| env runners | turns a second | of one | playing | sending | taking apart | updating | bottleneck |",
        "|--:|--:|--:|--:|--:|--:|--:|---|",
    ]
    first = result["simulated"]["1"]["turns_a_second"]
    for runners, one in result["simulated"].items():
        parts = {name: seconds for name, seconds in one.items() if name != "turns_a_second"}
        whole = sum(parts.values())
        shares = " | ".join(f"{seconds / whole:.0%}" for seconds in parts.values())
        rate = one["turns_a_second"]
        bottleneck = max(parts, key=lambda name: parts[name])
        lines.append(f"| {runners} | {rate:,.0f} | {rate / first:.2f}x | {shares} | {bottleneck} |")
    return lines


def scaling_table(clock: dict[int, list[float]]) -> list[str]:
    """Return the turns per second of the clock as Markdown."""
    lines = ["| env runners | turns gathered a second | learning included | episodes a round |", "|--:|--:|--:|--:|"]
    for runners, (*rates, episodes) in clock.items():
        cells = [f"{rate:,.0f} ({rate / first:.2f}x)" for rate, first in zip(rates, clock[1], strict=False)]
        lines.append(f"| {runners} | {' | '.join(cells)} | {episodes:.0f} |")
    return lines


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="wurtz_dodecane")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--batch", type=int, default=2048, help="turns of a measured round")
    parser.add_argument("--share", type=int, default=2048, help="turns of each runner in a simulated round")
    parser.add_argument("--gigabits", type=float, default=10.0, help="a second, of the learner's network")
    given = arguments(parser)
    load = os.getloadavg()[0]
    found = measure(given.scenario, given.rounds, given.batch)
    # For the comparison, shares are those of the measured rounds, in which two runners together play as much as one.
    halves = [simulate(found, n, given.batch // n, given.gigabits)["turns_a_second"] for n in RUNNERS[:2]]
    result = {
        "measured": found,
        "gathering_speedup": found["gathering_s"][1] / found["gathering_s"][2],
        "speedup": found["round_s"][1] / found["round_s"][2],
        "simulated_speedup": halves[1] / halves[0],
        "simulated": {str(n): simulate(found, n, given.share, given.gigabits) for n in RUNNERS},
        "load": load,
    }
    before = f"load average {load:.1f} before."
    tables = {
        "runners": [*table(result), "", f"{given.rounds} rounds of {given.batch} turns; {before}"],
        "rllib-scaling": [*scaling_table(found["clock"]), "", f"{os.cpu_count()} cores; {before}"],
    }
    report(given, result, tables)


if __name__ == "__main__":
    main()
