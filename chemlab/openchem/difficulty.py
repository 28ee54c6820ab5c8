"""How hard a scenario's chemistry is, measured: ``chemlab audit difficulty``.

| measure | what |
|---|---|
| ``steps`` | reactions of the route to the goal |
| ``yield`` | most of the goal that constant conditions of the reaction bench make, of what there can be |
| ``selectivity`` | there, how much of what the feeds have turned into is the goal |
| ``boils_apart_k`` | K between the boiling points of the goal and of the liquid that boils next to it |
| ``scripted`` | score of the general scripted agents |
| ``plan`` | score of the best constant plan of the manager that a search finds, over scripted benches |

Constant conditions are a temperature, gone to at once and kept, and reagents that are on the way to the goal, put in at
once, or evenly over half of the experiment: all of them, or one of them. All are tried from the bench's own beginning.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..agents.evaluate.plans import search_plan
from ..agents.player import play_laboratory
from ..agents.policies import make_policies
from ..config.datafile import DataError
from ..config.scenario import Scenario, load_scenario
from ..envs.bench_env import BenchVectorEnv
from ..kernels.arrays import FloatArray
from ..lab.engine import Laboratories
from ..physics.chemistry import AMOUNTS
from ..roles.bench import channel_slices
from ..roles.reaction_bench import ReactionBench, ReactionOptions
from .designs import feeds, steps_to

__all__ = ["Conditions", "GoalDifficulty", "constant_conditions", "difficulty"]

_TEMPERATURES = 8
_SLOWLY = 0.5
"""Share of an experiment over which a reagent is put in that is not put in at once."""
_SAFE_PRESSURE = 0.68
"""Of the gauge: above it nothing is heated further, as the scripted agents do."""
_TRACE_MOL = 1e-12


@dataclass(frozen=True)
class Conditions:
    """What the best constant conditions come to.

    Attributes:
        temperature_k: that is kept.
        slowly: reagents that are put in over half of the experiment.
        reached: mol of the goal that is made, of what there can be.
        selectivity: mol of the goal, of what the feed that is used up most could have become.
    """

    temperature_k: float
    slowly: tuple[str, ...]
    reached: float
    selectivity: float


@dataclass(frozen=True)
class GoalDifficulty:
    """How hard a goal is; None where there is no route or no bench to tell by, or nothing that boils."""

    goal: str
    steps: int
    conditions: Conditions | None
    boils_apart_k: float | None
    boils_next: str | None
    scripted: float
    plan: float | None

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain data."""
        return asdict(self)


class _Constant:
    """Keeps a temperature and puts reagents in, whatever it sees; member i by ``recipes[i]``.

    Args:
        bench: the bench it is for.
        recipes: temperature in K, and the reagents that are put in slowly, by member.
        wanted: reagents that are put in at all.
    """

    def __init__(self, bench: ReactionBench, recipes: list[tuple[float, tuple[str, ...]]], wanted: set[str]) -> None:
        slices = channel_slices(bench.channels)
        # Of a bench with a jacket it is the jacket that is set.
        self._gauge = slices["jacket" if "jacket" in slices else "temperature"].start
        self._pressure = slices["pressure"].start
        self._span = bench.options.temperature_k
        self._steps = max(round(_SLOWLY * bench.step_limit), 1)
        names = bench.reagent_names
        self._kelvin = np.array([kelvin for kelvin, _ in recipes])
        self._slow = np.array([[name in slow for name in names] for _, slow in recipes])
        self._wanted = np.array([name in wanted for name in names])

    def act(self, observation: npt.NDArray[Any], step: int) -> npt.NDArray[Any]:
        """[B, n] actions."""
        low, high, most = self._span.low, self._span.high, self._span.step
        now = low + observation[:, self._gauge] * (high - low)
        turn = np.clip(0.5 + (self._kelvin - now) / (2.0 * most), 0.0, 1.0)
        close = observation[:, self._pressure] > _SAFE_PRESSURE
        turn = np.where(close, np.minimum(turn, 0.5), turn)
        # Of what is left, the part that makes equal portions.
        share = np.where(self._slow, 1.0 / max(self._steps - step, 1), 1.0) * self._wanted
        return np.column_stack((turn, np.where(close, 1.0, 0.5), share))


def _reaction_bench(scenario: Scenario) -> str | None:
    return next((key for key, bench in scenario.benches.items() if bench.kind == "reaction"), None)


def constant_conditions(scenario: Scenario, goal: str) -> Conditions | None:
    """The constant conditions that make most of a goal; None where there is no reaction bench, or no route to it.

    Args:
        scenario: where.
        goal: one of its goals.
    """
    key = _reaction_bench(scenario)
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
    env = BenchVectorEnv(len(recipes), scenario, key, autoreset_mode="Disabled", actions="native")
    assert isinstance(env.bench, ReactionBench)
    policy = _Constant(env.bench, recipes, wanted)
    observation, _ = env.reset(seed=0, options={"goal": goal})
    before = _totals(env)
    for step in range(env.bench.step_limit):
        observation, *_ = env.step(policy.act(observation, step).astype(np.float32))
    change = _totals(env) - before
    column = {name: i for i, name in enumerate(env.bench.layout.materials)}
    made = change[:, column[goal]]
    used = np.stack([-change[:, column[name]] / mol for name, mol in needed.items()]).max(axis=0)
    best = int(made.argmax())
    kelvin, slow = recipes[best]
    most = scenario.theoretical_maximum_mol.get(goal, 1.0)
    return Conditions(round(kelvin, 1), slow, float(made[best] / most), float(made[best] / max(used[best], _TRACE_MOL)))


def _totals(env: BenchVectorEnv) -> FloatArray:
    """[N, M] mol of each material in bottles, vessels and waste."""
    shelf = env.batch.shelf
    inside = shelf.vessels[:, :, AMOUNTS : AMOUNTS + shelf.stock.shape[1]]
    total: FloatArray = shelf.stock + shelf.waste + inside.sum(axis=1)
    return total


def _boils_next(scenario: Scenario, goal: str) -> tuple[float, str] | None:
    """K to the boiling point of the liquid that boils next to a goal, and which that is."""
    liquids = {name: m for name, m in scenario.materials.items() if m.role in ("solvent", "solute")}
    if goal not in liquids or len(liquids) < 2:
        return None
    boils = liquids.pop(goal).boiling_point_k
    name = min(liquids, key=lambda other: abs(liquids[other].boiling_point_k - boils))
    return round(abs(liquids[name].boiling_point_k - boils), 2), name


def difficulty(scenario: str | Scenario, episodes: int = 20, plans: int = 100, seed: int = 0) -> list[GoalDifficulty]:
    """How hard each goal of a scenario's laboratory is.

    Args:
        scenario: name, path, or loaded.
        episodes: of which scores are the mean; episode i has seed + i.
        plans: most that the search for a constant plan tries, for each goal; 0: none is searched.
        seed: of the first episode.

    Raises:
        DataError: the scenario is none.
        ValueError: ``episodes`` or ``plans`` is out of bounds.
    """
    if episodes < 1 or plans < 0:
        raise ValueError(f"episodes = {episodes}, plans = {plans}: at least one episode, and no plans less than 0")
    spec = load_scenario(scenario)
    by_goal: dict[str, float] = {}
    if plans:
        contexts = [(goal,) * spec.orders for goal in spec.lab_goals]
        search = search_plan(spec, budget=plans * len(contexts), contexts=contexts)
        by_goal = {one.context[0]: one.score for one in search.found}
    rows = []
    for goal in spec.lab_goals:
        labs = Laboratories(spec, episodes)
        scripted = play_laboratory(labs, make_policies("scripted", labs, seed), goal, seed).returns
        apart = _boils_next(spec, goal)
        rows.append(
            GoalDifficulty(
                goal=goal,
                steps=len(steps_to(goal, spec.family)),
                conditions=constant_conditions(spec, goal),
                boils_apart_k=apart and apart[0],
                boils_next=apart and apart[1],
                scripted=float(scripted.mean()),
                plan=by_goal.get(goal),
            )
        )
    return rows
