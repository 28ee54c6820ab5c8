"""Difficulty of a scenario's chemistry: ``chemlab audit difficulty``.

| measure | meaning |
|---|---|
| ``steps`` | reactions of the route to the goal |
| ``yield`` | highest yield under constant conditions of the reaction bench |
| ``selectivity`` | share of the consumed feed that has become the goal under these conditions |
| ``boils_apart_k`` | distance in K between the goal's boiling point and the nearest other liquid's |
| ``scripted`` | score of the general scripted agents |
| ``plan`` | score of the best open-loop plan of the manager found by a search, with scripted benches |
| ``nothing`` | score of a manager that only waits |
| ``chance`` | share of episodes of a random manager, over scripted benches, that score above 0.1 |
| ``decisions`` | decisions of that manager in an episode |

Constant conditions are a constant temperature, set at the beginning, and the reagents on the route to the goal. All
reagents are added at once, or one or all of them evenly over half of the experiment. All variants are tried from the
bench's initial state.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..agents.episodes import play_laboratory
from ..agents.evaluate.search import search_plan
from ..agents.policies import make_policies
from ..config.datafile import DataError
from ..config.loading import load_scenario
from ..config.scenario import MANAGER_AGENT, Scenario
from ..envs.players import as_policy
from ..envs.role_env import RoleVectorEnv
from ..kernels.arrays import IntArray, MaskArray, ObservationArray
from ..lab.engine import Laboratories
from ..roles.bench import channel_slices
from ..roles.manager_actions import WAIT
from ..roles.reaction_bench import ReactionBench, ReactionOptions
from .designs import feeds, steps_to

_TEMPERATURES = 8
"""Number of temperatures that are tried."""
_SLOWLY = 0.5
"""Duration of slow additions as a share of the experiment."""
_SAFE_PRESSURE = 0.68
"""Reading of the pressure gauge above which heating stops, as in the scripted policy."""
_TRACE_MOL = 1e-12
_SUCCESS = 0.1
"""Score above which an episode of the random manager counts as a success."""


@dataclass(frozen=True)
class Conditions:
    """The best constant conditions and their result.

    Attributes:
        temperature_k: constant temperature.
        slowly: reagents that are added over half of the experiment.
        reached: yield: mol of the goal relative to its maximum.
        selectivity: mol of the goal relative to the maximum from the feed that is consumed most.
    """

    temperature_k: float
    slowly: tuple[str, ...]
    reached: float
    selectivity: float


@dataclass(frozen=True)
class GoalDifficulty:
    """Difficulty of a goal; measures are None if they need a route, a bench, a boiling liquid or a search."""

    goal: str
    steps: int
    conditions: Conditions | None
    boils_apart_k: float | None
    boils_next: str | None
    scripted: float
    plan: float | None
    nothing: float
    chance: float
    decisions: float


class _Constant:
    """Policy of constant conditions: keeps a temperature and adds reagents; environment i follows ``recipes[i]``.

    Args:
        bench: the bench.
        recipes: temperature in K and slowly added reagents by environment index.
        wanted: all added reagents.
    """

    def __init__(self, bench: ReactionBench, recipes: list[tuple[float, tuple[str, ...]]], wanted: set[str]) -> None:
        slices, channels = channel_slices(bench.channels), {channel.name: channel for channel in bench.channels}
        # With a jacket, the jacket's temperature is set.
        self._channel = channels.get("jacket", channels["temperature"])
        self._gauge, self._pressure = slices[self._channel.name].start, slices["pressure"].start
        self._step_k = bench.options.temperature_k.step
        self._steps = max(round(_SLOWLY * bench.step_limit), 1)
        names = bench.reagent_names
        self._kelvin = np.array([kelvin for kelvin, _ in recipes])
        self._slow = np.array([[name in slow for name in names] for _, slow in recipes])
        self._wanted = np.array([name in wanted for name in names])

    def act(self, observation: npt.NDArray[Any], step: int) -> npt.NDArray[Any]:
        """Return the actions [B, n] for observations [B, m]."""
        now = self._channel.unscaled(observation[:, self._gauge])
        heating = np.clip(0.5 + (self._kelvin - now) / (2.0 * self._step_k), 0.0, 1.0)
        unsafe = observation[:, self._pressure] > _SAFE_PRESSURE
        heating = np.where(unsafe, np.minimum(heating, 0.5), heating)
        # Shares of the remainder, so that portions are equal.
        share = np.where(self._slow, 1.0 / max(self._steps - step, 1), 1.0) * self._wanted
        return np.column_stack((heating, np.where(unsafe, 1.0, 0.5), share))


def constant_conditions(scenario: Scenario, goal: str) -> Conditions | None:
    """Return the constant conditions with the highest yield of a goal; None without a reaction bench or a route.

    Args:
        scenario: the scenario.
        goal: one of its goals.
    """
    key = next((key for key, bench in scenario.benches.items() if bench.kind == "reaction"), None)
    if key is None:
        return None
    try:
        needed = feeds(goal, scenario.family, 1.0)
    except DataError:
        return None
    wanted = scenario.family.towards(goal)
    options = ReactionOptions.model_validate(scenario.benches[key].model_extra)
    reagents = tuple(name for name in options.reagents if name in wanted)
    slowly = dict.fromkeys([(), reagents, *((name,) for name in reagents)])
    kelvins = np.linspace(options.temperature_k.low, options.temperature_k.high, _TEMPERATURES)
    recipes = list(itertools.product(kelvins.tolist(), slowly))
    env = RoleVectorEnv(len(recipes), scenario, bench=key, autoreset_mode="Disabled", actions="native")
    assert isinstance(env.bench, ReactionBench)
    policy = _Constant(env.bench, recipes, wanted)
    observation, _ = env.reset(seed=0, options={"goal": goal})
    before = env.batch.shelf.total()
    for step in range(env.bench.step_limit):
        observation, *_ = env.step(policy.act(observation, step).astype(np.float32))
    change = env.batch.shelf.total() - before
    column = {name: i for i, name in enumerate(env.bench.layout.materials)}
    made = change[:, column[goal]]
    used = np.stack([-change[:, column[name]] / mol for name, mol in needed.items()]).max(axis=0)
    best = int(made.argmax())
    kelvin, slow = recipes[best]
    most = scenario.theoretical_maximum_mol.get(goal, 1.0)
    return Conditions(round(kelvin, 1), slow, float(made[best] / most), float(made[best] / max(used[best], _TRACE_MOL)))


def _nearest_boiling(scenario: Scenario, goal: str) -> tuple[float, str] | None:
    """Return the distance in K to the nearest boiling point of another liquid, and that liquid; or None."""
    liquids = {name: m for name, m in scenario.materials.items() if m.role in ("solvent", "solute")}
    if goal not in liquids or len(liquids) < 2:
        return None
    boils = liquids.pop(goal).boiling_point_k
    name = min(liquids, key=lambda other: abs(liquids[other].boiling_point_k - boils))
    return round(abs(liquids[name].boiling_point_k - boils), 2), name


def waiting(labs: Laboratories) -> Callable[[ObservationArray, MaskArray | None], IntArray]:
    """Return a policy of the manager that waits, or takes the first legal action if waiting is illegal."""
    wait = int(np.flatnonzero(labs.actions.table[:, 0] == WAIT)[0])

    def choose(observation: ObservationArray, mask: MaskArray | None) -> IntArray:
        assert mask is not None, "the manager's actions are discrete"
        return np.where(mask[:, wait] != 0, wait, mask.argmax(axis=1))

    return choose


def difficulty(
    scenario: str | Scenario, episodes: int = 20, plans: int = 100, seed: int = 0, explored: int = 200
) -> list[GoalDifficulty]:
    """Measure the difficulty of each goal of a scenario's laboratory.

    Args:
        scenario: name, path, or loaded scenario.
        episodes: number of episodes whose scores are averaged; episode i has seed + i.
        plans: maximum number of open-loop plans tried per goal; 0: no search.
        seed: seed of the first episode.
        explored: number of episodes of the random manager.

    Raises:
        DataError: the scenario is invalid.
        ValueError: ``episodes``, ``plans`` or ``explored`` is out of bounds.
    """
    if min(episodes, explored) < 1 or plans < 0:
        raise ValueError(
            f"episodes = {episodes}, explored = {explored}, plans = {plans}: episodes and explored must be at least 1, "
            "and plans at least 0"
        )
    spec = load_scenario(scenario)
    by_goal: dict[str, float] = {}
    if plans:
        contexts = [(goal,) * spec.orders for goal in spec.lab_goals]
        search = search_plan(spec, budget=plans * len(contexts), contexts=contexts)
        by_goal = {one.context[0]: one.score for one in search.found}
    rows = []
    for goal in spec.lab_goals:
        labs = Laboratories(spec, episodes)
        scripted = play_laboratory(labs, make_policies("scripted", labs), goal, seed).returns
        nearest = _nearest_boiling(spec, goal)
        others = Laboratories(spec, explored)
        random = play_laboratory(others, make_policies("scripted,manager=random", others), goal, seed)
        idle = make_policies("scripted", labs) | {MANAGER_AGENT: as_policy(waiting(labs))}
        rows.append(
            GoalDifficulty(
                goal=goal,
                steps=len(steps_to(goal, spec.family)),
                conditions=constant_conditions(spec, goal),
                boils_apart_k=nearest and nearest[0],
                boils_next=nearest and nearest[1],
                scripted=float(scripted.mean()),
                plan=by_goal.get(goal),
                nothing=float(play_laboratory(labs, idle, goal, seed).returns.mean()),
                chance=float((random.returns > _SUCCESS).mean()),
                decisions=float(random.measures["manager_actions"].mean()),
            )
        )
    return rows
