"""Scenes that tests look at: scripted episodes, laboratories of awkward sizes, single benches."""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from helpers import FEATURED, laboratory, slow_but

from chemlab.agents.episodes import PlayedTurn, play_episode
from chemlab.agents.policies import make_policies, scripted_bench
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleEnv
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import CLOCK, CLOCK_WAS
from chemlab.render.scene import Scene, bench_scene, laboratory_scene

BENCHES = [(name, key) for name in scenario_names() for key in load_scenario(name).benches]
EVERY_BENCH = slow_but(BENCHES, *(bench for bench in BENCHES if bench[0] in FEATURED))
"""Cases of a test of what holds of any bench."""
_EVERY = 7
"""Turns from one look at an episode to the next."""


@functools.lru_cache(maxsize=len(scenario_names()))
def episode(name: str) -> tuple[Scene, ...]:
    """A scripted episode of a shipped scenario: its first scene, some in between, its last."""
    env = laboratory(name)
    scenes, turns = [laboratory_scene(env.laboratories)], 0

    def watch(turn: PlayedTurn) -> None:
        nonlocal turns
        turns += 1
        if turns % _EVERY == 0:
            scenes.append(laboratory_scene(env.laboratories))

    play_episode(env, make_policies("scripted", env.laboratories, 0), 0, watch=watch)
    return (*scenes, laboratory_scene(env.laboratories))


@functools.lru_cache(maxsize=len(BENCHES))
def experiment(name: str, key: str) -> tuple[Scene, ...]:
    """An experiment on a single bench: its first scene, some in between, the one after its end."""
    env = RoleEnv(name, bench=key)
    observation, info = env.reset(seed=1)
    policy = scripted_bench(env.bench)
    scenes, over, step = [bench_scene(env.batch)], False, 0
    while not over:
        mask = info.get("action_mask")
        given = None if mask is None else mask[None]
        action = policy.act(observation[None], given, np.array([step]), np.array([0]))[0]
        observation, _, over, _, info = env.step(action)
        step += 1
        if step % 3 == 1:
            scenes.append(bench_scene(env.batch))
    return (*scenes, bench_scene(env.batch))


def variant(slots: int, counts: Mapping[str, int], **changes: Any) -> Scenario:
    """``wurtz_any`` with another shelf and other numbers of benches."""
    data = load_scenario("wurtz_any").model_dump(mode="json")
    data["shelf"] = {"slots": slots, "vessel": [data["shelf"]["vessel"][0]] * min(4, slots)}
    for key, count in counts.items():
        data["benches"][key]["count"] = count
    title = "A title that goes on for longer than there is room in a picture" * 2
    return load_scenario({**data, "title": title, **changes})


@functools.lru_cache(maxsize=8)
def crowd(slots: int, rxn: int, ext: int, dit: int) -> tuple[Scene, ...]:
    """A laboratory as busy as can be: every bench started, random actions, everything measured."""
    labs = Laboratories(variant(slots, {"rxn": rxn, "ext": ext, "dit": dit}, orders=3))
    labs.begin()
    random = np.random.default_rng(0)
    scenes = [laboratory_scene(labs)]
    for turn in range(240):
        if labs.state.status[0] != 0:
            break
        agent = labs.turn()
        mask = labs.mask(agent, labs.members)
        if mask is None:
            action = random.random((1, *labs.action_space(agent).shape))
        else:
            legal = np.flatnonzero(mask[0])
            if agent == 0:
                kinds = [str(labs.actions.decode(int(a))[0]) for a in legal]
                wanted = ["start", "measure"] if turn % 3 else ["measure", "start"]
                kind = next((k for k in wanted if k in kinds), "wait")
                legal = legal[[k == kind for k in kinds]] if kind in kinds else legal
            elif random.random() < 0.95 and len(legal) > 1:
                legal = legal[:-1]  # the last action ends the experiment
            action = np.array([random.choice(legal)])
        labs.act(agent, labs.members, action)
        if turn % 12 == 0:
            scenes.append(laboratory_scene(labs))
    return (*scenes, laboratory_scene(labs))


def filled(contents: Mapping[str, float], clock: float | None = None, capacity_l: float = 1.2) -> Laboratories:
    """A laboratory of ``wurtz_any`` with these contents (mol) in slot 0, just as they are: no phases are settled."""
    labs = Laboratories("wurtz_any")
    labs.begin()
    row = labs.shelf.fill(0, 0, capacity_l, dict(contents)).row
    if clock is not None:
        row[CLOCK] = row[CLOCK_WAS] = clock
    return labs
