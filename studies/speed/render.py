"""Frames per second of pictures at 960 x 540, including the construction of the scene from the arrays.

Run ``python studies/speed/render.py`` (``--json`` for machines). Each scenario is played by its scripted policies, each
bench by random actions; every turn is drawn once. Needs no display.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from report import arguments, report

from chemlab import raw_env
from chemlab.agents.episodes import PlayedTurn, play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.display import markdown_table
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.envs.role_env import RoleEnv
from chemlab.render.draw import draw
from chemlab.render.scene import bench_scene, laboratory_scene


def laboratory(name: str, episodes: int) -> dict[str, float]:
    """Return frames per second and the slowest frame over whole episodes."""
    env = raw_env(name)
    env.reset(seed=0)
    seconds: list[float] = []

    def watch(turn: PlayedTurn) -> None:
        begun = time.perf_counter()
        draw(laboratory_scene(env.laboratories))
        seconds.append(time.perf_counter() - begun)

    for seed in range(episodes):
        play_episode(env, make_policies("scripted", env.laboratories, seed), seed, watch=watch)
    return summary(seconds)


def bench(name: str, key: str, frames: int) -> dict[str, float]:
    """Return the same for a single bench."""
    env = RoleEnv(name, bench=key)
    env.action_space.seed(0)
    seconds: list[float] = []
    over = True
    while len(seconds) < frames:
        if over:
            env.reset(seed=len(seconds))
        _, _, over, _, _ = env.step(env.action_space.sample())
        begun = time.perf_counter()
        draw(bench_scene(env.batch))
        seconds.append(time.perf_counter() - begun)
    return summary(seconds)


def summary(seconds: list[float]) -> dict[str, float]:
    """Return the mean rate and the slowest frame after the first, which loads fonts and draws the background."""
    return {
        "frames": len(seconds),
        "frames_per_second": round(1.0 / float(np.mean(seconds[1:])), 1),
        "slowest_ms": round(1000.0 * max(seconds[1:]), 1),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=3, help="episodes of each scenario")
    given = arguments(parser)
    results = {name: laboratory(name, given.episodes) for name in scenario_names()}
    for key in load_scenario("wurtz_dodecane").benches:
        results[f"wurtz_dodecane {key}"] = bench("wurtz_dodecane", key, 100)
    rows = [[name, f"{r['frames_per_second']:.1f}", f"{r['slowest_ms']:.1f}"] for name, r in results.items()]
    report(given, results, {"render": markdown_table({"": False, "frames/s": True, "slowest (ms)": True}, rows)})


if __name__ == "__main__":
    main()
