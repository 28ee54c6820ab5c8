"""Steps per second of every environment, a profile of a step, and memory.

Run ``python studies/speed/throughput.py`` (``--json`` for machines, ``--quick`` for a short run). Random actions,
resets included. Every figure is also given as a ratio to Gymnasium's CartPole-v1 stepped singly in the same run, which
is comparable between machines. Machines are noisy, so compare ratios of one run only.
"""

from __future__ import annotations

import argparse
import functools
import os
import statistics
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from report import arguments, report

import chemlab  # noqa: F401 - registers the environments
from chemlab import BatchedLaboratory, load_scenario, parallel_env, raw_env
from chemlab.agents.background import role_vector_env
from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.agents.random_policy import RandomPolicy
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.kernels.arrays import FloatArray, Handle, IntArray
from chemlab.kernels.jit import kernel
from chemlab.laboratory import env as laboratory_env
from chemlab.physics.chemistry import AMOUNTS
from chemlab.physics.mass_action import rates as reaction_rates
from chemlab.physics.stratification import profile
from chemlab.record import Recorder, verify_record
from chemlab.roles.operation_bench import OperationBench

ROUNDS = 5
IDS = ("WurtzReaction", "FictitiousReaction", "WurtzExtraction", "SaltFromOilExtraction", "WurtzDistillation")
MEMORY = """
import gymnasium, chemlab
envs = gymnasium.make_vec("chemlab/{name}-v0", num_envs=4096, vectorization_mode="vector_entry_point")
envs.reset(seed=0)
for _ in range(3):
    envs.step(envs.action_space.sample())
print(next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")) / 1024)
"""


def rate(step: Callable[[int], int], seconds: float, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return steps per second: ``step(i)`` takes some steps and returns their number."""
    for i in range(20):
        step(i)
    done, i, begun = 0, 0, clock()
    while (elapsed := clock() - begun) < seconds:
        for _ in range(10):
            done += step(i)
            i += 1
    return done / elapsed


def single(name: str, seconds: float) -> float:
    """Return steps per second of one environment made by ``gymnasium.make``."""
    env = gymnasium.make(name)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(1000)]

    def step(i: int) -> int:
        _, _, terminated, truncated, _ = env.step(actions[i % 1000])
        if terminated or truncated:
            env.reset()
        return 1

    return rate(step, seconds)


def batched(name: str, count: int, threads: int, seconds: float, version: int = 0, **arguments: Any) -> float:
    """Return steps per second of a batch of ``count``."""
    envs = gymnasium.make_vec(
        f"chemlab/{name}-v{version}",
        num_envs=count,
        vectorization_mode="vector_entry_point",
        threads=threads,
        copy=False,
        **arguments,
    )
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(max(2, 4096 // count))]

    def step(i: int) -> int:
        envs.step(actions[i % len(actions)])
        return count

    found = rate(step, seconds)
    envs.close()
    return found


def parts(name: str, seconds: float) -> dict[str, float]:
    """Return microseconds per step of a batch of 256 in physics, in observing and masking, and in Python around
    them.
    """
    envs = gymnasium.make_vec(f"chemlab/{name}-v0", num_envs=256, vectorization_mode="vector_entry_point", copy=False)
    assert isinstance(envs, RoleVectorEnv)
    envs.reset(seed=0)
    actions = [envs.action_space.sample() for _ in range(16)]
    bench, spent = envs.bench, {"physics": 0.0, "observation": 0.0}

    def timed(method: Callable[..., None], part: str) -> Callable[..., None]:
        def call(*args: Any) -> None:
            begun = time.perf_counter()
            method(*args)
            spent[part] += time.perf_counter() - begun

        return call

    for i in range(60):
        envs.step(actions[i % 16])
    for method, part in (("act", "physics"), ("begin", "physics"), ("observe", "observation"), ("mask", "observation")):
        setattr(bench, method, timed(getattr(bench, method), part))
    steps, begun = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - begun) < seconds:
        envs.step(actions[steps % 16])
        steps += 1
    figures = {part: value / steps / 256 * 1e6 for part, value in spent.items()}
    figures["python"] = elapsed / steps / 256 * 1e6 - sum(figures.values())
    return {**figures, **floor(envs)}


@kernel
def _rates_once(rows: FloatArray, chem: Handle, work: FloatArray) -> None:
    for b in range(rows.shape[0]):
        reaction_rates(work[0], chem, rows[b, AMOUNTS:], work[1], work[2], work[3])


@kernel
def _profiles_once(rows: FloatArray, chem: Handle, layers: IntArray, out: FloatArray, work: FloatArray) -> None:
    for b in range(rows.shape[0]):
        profile(rows[b], chem, layers, out, work)


def floor(envs: RoleVectorEnv) -> dict[str, float]:
    """Return rough lower bounds of a batch step of 256, in microseconds per member: copying as many observations,
    reading and writing all vessels once, and computing the law once (all reaction rates, or the layers of one vessel).
    """
    bench, shelf, experiments = envs.bench, envs.batch.shelf, envs.batch.experiments
    out = np.zeros((256, *bench.observation_space.shape), dtype=np.float32)
    source, work = np.ones_like(out), np.zeros_like(bench.rules.arrays.work)
    first = shelf.rows[experiments.places[:, 0]]
    law: Callable[[], Any] = functools.partial(_rates_once, first, shelf.chem(0), work)
    if isinstance(bench, OperationBench):
        layers, shares = experiments.layers[0, 0].copy(), experiments.profile[0, 0].copy()
        law = functools.partial(_profiles_once, first, shelf.chem(0), layers, shares, work)
    calls: dict[str, Callable[[], Any]] = {
        "writing an observation": functools.partial(np.copyto, out, source),
        "a pass over the vessels": functools.partial(np.multiply, shelf.rows, 1.0, out=shelf.rows),
        "the law once": law,
    }
    return {name: min(timeit.repeat(call, number=40)) / 40 / 256 * 1e6 for name, call in calls.items()}


def laboratory(make: Callable[..., Any], seconds: float) -> float:
    """Return agent steps per second of an AEC laboratory under random legal actions."""
    env = make("wurtz_dodecane")
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def step(i: int) -> int:
        if not env.agents:
            env.reset()
        _, _, terminated, truncated, info = env.last()
        if terminated or truncated:
            env.step(None)
            return 0
        mask = info.get("action_mask")
        if mask is None:
            env.step(rng.random(6, dtype=np.float32))
        else:
            legal = mask.nonzero()[0]
            env.step(int(legal[int(rng.random() * len(legal))]))
        return 1

    return rate(step, seconds)


def parallel(seconds: float) -> float:
    """Return agent steps per second of the parallel laboratory (all agents act in every step), random legal actions."""
    env = parallel_env("wurtz_dodecane")
    _, infos = env.reset(seed=0)
    rng = np.random.default_rng(0)

    def step(i: int) -> int:
        nonlocal infos
        if not env.agents:
            _, infos = env.reset()
        actions: dict[str, Any] = {}
        for agent, info in infos.items():
            if info["has_turn"]:
                mask = info.get("action_mask")
                if mask is None:
                    actions[agent] = rng.random(6)
                else:
                    legal = mask.nonzero()[0]
                    actions[agent] = int(legal[int(rng.random() * len(legal))])
        _, _, _, _, infos = env.step(actions)
        return len(infos)

    return rate(step, seconds)


class Play:
    """Laboratories in which all agents play random legal actions.

    Attributes:
        spent: processor seconds in ``BatchedLaboratory.step`` so far.
    """

    spent = 0.0

    def __init__(self, scenario: str | Scenario, count: int) -> None:
        self._batch = BatchedLaboratory(count, scenario, copy=False)
        self._policies = {
            agent: RandomPolicy((self._batch.action_space(agent).shape or (0,))[0], seed)
            for seed, agent in enumerate(self._batch.possible_agents)
        }
        self._members, self._steps = np.arange(count), np.zeros(count, dtype=np.int64)
        self._seen, self._infos = self._batch.reset(seed=0)

    def round(self, _: int = 0) -> int:
        """Play a round; return the number of turns."""
        turns, actions = 0, {}
        for agent, policy in self._policies.items():
            acting = int(self._infos[agent]["has_turn"].sum())
            if acting:
                turns += acting
                mask = self._infos[agent].get("action_mask")
                actions[agent] = policy.act(self._seen[agent], mask, self._steps, self._members)
        begun = time.process_time()
        self._seen, _, _, _, self._infos = self._batch.step(actions)
        self.spent += time.process_time() - begun
        return turns


def batched_laboratory(
    count: int,
    seconds: float,
    scenario: str | Scenario = "wurtz_dodecane",
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return turns per second of ``count`` laboratories at once, random legal actions of all roles."""
    return rate(Play(scenario, count).round, seconds, clock)


def manager_view(count: int, seconds: float) -> float:
    """Return manager decisions per second of ``count`` laboratories with scripted benches, random legal decisions."""
    envs = role_vector_env(count, autoreset_mode="SameStep", copy=False)
    policy, members, steps = RandomPolicy(0, 0), np.arange(count), np.zeros(count, dtype=np.int64)
    observations, infos = envs.reset(seed=0)

    def step(i: int) -> int:
        nonlocal observations, infos
        actions = policy.act(observations, infos["action_mask"], steps, members)
        observations, _, _, _, infos = envs.step(actions)
        return count

    return rate(step, seconds)


def learning_team(scenario: str, every_role: bool, **settings: Any) -> Any:
    """Return what the built-in PPO trains, without practice: the manager over scripted benches, or every role."""
    import torch  # only here: the other rates need no PyTorch

    from chemlab.agents.train.arguments import IPPO
    from chemlab.agents.train.ppo import PPOTeam

    torch.set_num_threads(1)
    spec = load_scenario(scenario)
    roles = ("manager", *spec.benches) if every_role else ("manager",)
    return PPOTeam(spec, roles, IPPO(scenario=scenario, practice=0.0, **settings), "scripted")


def collection(seconds: float, scenario: str = "rush@1", every_role: bool = False) -> float:
    """Return turns per second of processor time that the built-in PPO collects in 256 laboratories: of the manager over
    scripted benches, or of every role. It learns nothing.
    """
    team = learning_team(scenario, every_role, envs=256, rollout=16)
    team.collect(1.0)
    before, begun = sum(team.turns.values()), time.process_time()
    while time.process_time() - begun < seconds:
        team.collect(1.0)
    return (sum(team.turns.values()) - before) / (time.process_time() - begun)


def verification(seconds: float) -> float:
    """Return turns per second of processor time that :func:`verify_record` verifies, in records of random episodes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for name in ("wurtz_dodecane", "relay", "rush", "failing"):
            env = raw_env(name)
            paths.append(Path(folder) / f"{name}.jsonl")
            with Recorder(paths[-1], env.laboratories) as recorder:
                play_episode(env, make_policies("random", env.laboratories), 0, recorder=recorder)

        def step(i: int) -> int:
            found = verify_record(paths[i % len(paths)])
            assert found.status == "ok", found.message
            return found.turns

        return rate(step, seconds, time.process_time)


def second_core(scenario: str, every_role: bool, updates: int) -> float:
    """Return how many times as many turns a second (wall time) training makes if the critic has a second core."""
    from chemlab.agents.train import ppo

    team, turns, taken = learning_team(scenario, every_role), {1: 0, 2: 0}, {1: 0.0, 2: 0.0}
    for number in range(2 * updates):
        ppo._CORES = 1 + number % 2
        begun = time.perf_counter()
        turns[ppo._CORES] += team.learn(number / 100.0, number)
        taken[ppo._CORES] += time.perf_counter() - begun
    return turns[2] / taken[2] / (turns[1] / taken[1])


def shares(scenario: str, every_role: bool, updates: int) -> dict[str, float]:
    """Return the share of processor time of each part of the built-in PPO's training, and its turns per second.

    As many updates as are measured come before, because self-imitation takes longer the more turns it remembers.
    """
    from chemlab.agents.train import ppo

    ppo._CORES = 1
    team, spent, inside = learning_team(scenario, every_role), dict[str, float](), [0.0]

    def time_part(owner: Any, names: str, part: str) -> None:
        """Count the time of methods to a part, without what they call of other parts."""
        for name in names.split():

            def call(method: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
                inside.append(0.0)
                begun = time.process_time()
                found = method(*args, **kwargs)
                taken = time.process_time() - begun
                spent[part] = spent.get(part, 0.0) + taken - inside.pop()
                inside[-1] += taken
                return found

            setattr(owner, name, functools.partial(call, getattr(owner, name)))

    time_part(team, "update", "the rest")
    time_part(team, "collect", "the rest")
    for learner in team.learners.values():
        time_part(learner, "act value", "forward passes, also of self-imitation")
        time_part(learner, "update", "updates")
    time_part(team._best, "learn", "the rest of self-imitation")
    time_part(team._best, "add rewarded", "other training help")
    time_part(team, "_helped _read", "other training help")
    time_part(team._players, "decide renew", "scripted benches")
    time_part(team.batch, "step", "laboratories")
    time_part(team.batch, "_look", "observations and masks")
    time_part(team.batch, "_told _infos", "infos")
    for number in range(2 * updates):
        if number == updates:
            spent.clear()
            turns, begun = sum(team.turns.values()), time.process_time()
        team.learn(number / 100.0, number)
    whole = time.process_time() - begun
    rate = (sum(team.turns.values()) - turns) / whole
    return {"turns a second": rate} | {part: value / whole for part, value in spent.items()}


def in_a_process(code: str) -> float:
    """Return the output of a new Python process that runs ``code``."""
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


def rates(seconds: float, quick: bool) -> dict[str, Any]:
    """Measure all running rates once."""
    cartpole = single("CartPole-v1", seconds)
    result: dict[str, Any] = {"cartpole_single": cartpole, "single": {}, "batched": {}, "parts_us": {}}
    for name in IDS:
        result["single"][name] = single(f"chemlab/{name}-v0", seconds)
        sizes = ((256, 1), (256, 2)) if quick else [(n, t) for n in (1, 16, 256, 4096) for t in (1, 2) if t <= n]
        result["batched"][name] = {f"{n}x{t}": batched(name, n, t, seconds) for n, t in sizes}
        result["parts_us"][name] = parts(name, seconds)
    result["materials"] = {
        scenario: {
            "materials": len(load_scenario(scenario).materials),
            "rxn_256": batched("Bench", 256, 1, seconds, 1, scenario=scenario, bench="rxn"),
            "dit_256": batched("Bench", 256, 1, seconds, 1, scenario=scenario, bench="dit"),
        }
        for scenario in ("fictitious", "wurtz_dodecane_direct", "wurtz_dodecane")
    }
    result["laboratory"] = {
        "`env`, agent steps": laboratory(laboratory_env, seconds),
        "`raw_env`, agent steps": laboratory(raw_env, seconds),
        "`parallel_env`, agent steps": parallel(seconds),
        "256 at once, all roles random, turns": batched_laboratory(256, 4.0 * seconds),
        **{
            f"manager's view, {count} at once, benches scripted, decisions": manager_view(count, seconds)
            for count in (64, 256)
        },
    }
    return result


def medians(found: list[Any]) -> Any:
    """Return the median of each figure over several measurements."""
    if isinstance(found[0], dict):
        return {key: medians([one[key] for one in found]) for key in found[0]}
    return statistics.median(found)


def measure(seconds: float, quick: bool) -> dict[str, Any]:
    """Return all figures as medians of rounds, so that temporary load does not distort them."""
    result: dict[str, Any] = medians([rates(seconds, quick) for _ in range(1 if quick else ROUNDS)])
    result["peak_memory_mib_4096"] = {name: in_a_process(MEMORY.format(name=name)) for name in IDS[::2]}
    return result


def table(result: dict[str, Any]) -> list[str]:
    """Return the figures as Markdown."""
    base = result["cartpole_single"]
    lines = [f"CartPole-v1, single: {base:,.0f} steps/s (= 1x)", ""]
    sizes = list(next(iter(result["batched"].values())))
    heads = " | ".join(f"batch {s.replace('x', ', ')} thr." for s in sizes)
    lines += [f"| environment | single | {heads} |", "|---|--:|" + "--:|" * len(sizes)]
    for name in IDS:
        row = [result["single"][name], *(result["batched"][name][s] for s in sizes)]
        lines.append(f"| `chemlab/{name}-v0` | " + " | ".join(f"{x:,.0f} ({x / base:.2f}x)" for x in row) + " |")
    lines += ["", "| laboratory | a second |", "|---|--:|"]
    for name, value in result["laboratory"].items():
        lines.append(f"| {name} | {value:,.0f} ({value / base:.2f}x) |")
    lines += [
        "",
        "| microseconds a step, batch 256, 1 thread | " + " | ".join(next(iter(result["parts_us"].values()))) + " |",
    ]
    lines.append("|---|" + "--:|" * len(next(iter(result["parts_us"].values()))))
    for name, figures in result["parts_us"].items():
        lines.append(f"| `{name}` | " + " | ".join(f"{x:.2f}" for x in figures.values()) + " |")
    lines += ["", "| scenario | materials | rxn, batch 256 | dit, batch 256 |", "|---|--:|--:|--:|"]
    for name, figures in result["materials"].items():
        lines.append(f"| `{name}` | {figures['materials']} | {figures['rxn_256']:,.0f} | {figures['dit_256']:,.0f} |")
    lines.append("")
    memory = ", ".join(f"{name} {value:.0f} MiB" for name, value in result["peak_memory_mib_4096"].items())
    return [*lines, f"peak memory of a process with a batch of 4,096: {memory}"]


def collections(seconds: float) -> list[str]:
    """Return the rates of :func:`collection` as Markdown: medians of rounds."""
    lines = ["| scenario | manager alone | every role |", "|---|--:|--:|"]
    for scenario in ("rush@1", "unlabelled@1"):
        found = [[collection(seconds, scenario, every) for every in (False, True)] for _ in range(ROUNDS)]
        rates = " | ".join(f"{statistics.median(column):,.0f}" for column in zip(*found, strict=True))
        lines.append(f"| `{scenario}` | {rates} |")
    found = {
        "`rush`, manager": shares("rush", False, 30),
        "`wurtz_dodecane`, every role": shares("wurtz_dodecane", True, 6),
    }
    lines += ["", f"| share of training | {' | '.join(found)} |", "|---|--:|--:|"]
    first, *parts = dict.fromkeys(part for each in found.values() for part in each)
    for part in sorted(parts, key=lambda part: -sum(each.get(part, 0.0) for each in found.values())):
        lines.append(f"| {part} | " + " | ".join(f"{each.get(part, 0.0):.1%}" for each in found.values()) + " |")
    lines.append(f"| {first} | " + " | ".join(f"{each[first]:,.0f}" for each in found.values()) + " |")
    more = [second_core("rush", False, 30), second_core("wurtz_dodecane", True, 6)]
    name = "wall-clock speed with two cores, as a multiple of that with one"
    lines.append(f"| {name} | " + " | ".join(f"{x:.2f}" for x in more) + " |")
    return [*lines, "", f"Load average {os.getloadavg()[0]:.1f}."]


def short_table(result: dict[str, Any]) -> list[str]:
    """Return the figures for README."""
    base = result["cartpole_single"]
    lines = ["| | single | batch of 256, 1 thread |", "|---|--:|--:|", f"| Gymnasium's `CartPole-v1` | {base:,.0f} | |"]
    for name in IDS[::2]:
        found = (result["single"][name], result["batched"][name]["256x1"])
        lines.append(f"| `chemlab/{name}-v0` | " + " | ".join(f"{x:,.0f} ({x / base:.2f}x)" for x in found) + " |")
    one, many = (result["laboratory"][name] for name in ("`env`, agent steps", "256 at once, all roles random, turns"))
    lines.append(
        f"| laboratory, turns of all agents | {one:,.0f} ({one / base:.2f}x) | {many:,.0f} ({many / base:.2f}x) |"
    )
    return lines


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer sizes, one round")
    parser.add_argument("--collection", action="store_true", help="only PPO's collection (needs PyTorch)")
    given = arguments(parser)
    if given.collection:
        lines = collections(1.0)
        report(given, lines, {"collection": lines})
    else:
        result = measure(0.3, given.quick)
        report(given, result, {"throughput": table(result), "speed": short_table(result)})


if __name__ == "__main__":
    main()
