"""Record what reaches each bench in laboratory runs, as starting states for pretraining."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.bench.base import MaskArray, ObservationArray
from chemlab.laboratory.aec import raw_env
from chemlab.laboratory.starts import Start
from chemlab.scenario import Scenario
from chemlab.shelf import IntArray

from .policy import Policy, make_policies
from .run import Turn, play_episode

__all__ = ["record_starts"]

_EXPLORE = 0.1
_LEAST_MOL = 1e-6


class _Exploring:
    """A policy that plays another's actions, and now and then a random legal one."""

    def __init__(self, policy: Policy, explorer: Policy, rng: np.random.Generator) -> None:
        self._policy, self._explorer, self._rng = policy, explorer, rng

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policy.Policy`."""
        actions = self._policy.act(observation, mask, step, members)
        return self._explorer.act(observation, mask, step, members) if self._rng.random() < _EXPLORE else actions


def record_starts(
    scenario: Scenario, episodes: int, seed: int, progress: Callable[[], None] | None = None
) -> dict[str, list[Start]]:
    """Play the scripted laboratory and keep every vessel that is put on a bench.

    One action in ten of the reaction bench is random, so that what arrives is not always the same.

    Args:
        scenario: the laboratory; every goal its benches know is played, whether or not it is a laboratory goal.
        episodes: episodes for each goal.
        seed: first seed.
        progress: called after each episode.

    Returns:
        {bench key: starting states}.
    """
    every_goal = scenario.model_copy(
        update={"lab_goals": scenario.goals, "theoretical_maximum_mol": dict.fromkeys(scenario.goals, 1.0)}
    )
    env = raw_env(every_goal)
    labs = env.laboratories
    found: dict[str, list[Start]] = {key: [] for key in scenario.benches}
    names = labs.shelf.layout.materials

    def watch(turn: Turn) -> None:
        station = int(labs.desk.begun[0])
        if turn.agent != env.possible_agents[0] or station < 0:
            return
        bench = labs.benches[station]
        vessel = labs.shelf.vessel(0, int(labs.rules.first[station]))
        contents = {name: mol for name, mol in vessel.amounts(_LEAST_MOL).items() if name in names}
        goal = scenario.goals[labs.stations[station].goal[0]]
        found[bench.key].append((goal, 1.0, vessel.capacity_l, contents))

    for g, goal in enumerate(scenario.goals):
        for episode in range(episodes):
            number = seed + g * episodes + episode
            policies = make_policies("heuristic", labs, number)
            explorers = make_policies("random", labs, number)
            for b, bench in enumerate(labs.benches):
                if bench.spec.kind == "reaction":
                    agent = labs.bench_agents[b]
                    rng = np.random.default_rng(number)
                    policies[agent] = _Exploring(policies[agent], explorers[agent], rng)
            play_episode(env, policies, number, watch=watch, options={"goal": goal})
            if progress is not None:
                progress()
    return found
