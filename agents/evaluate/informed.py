"""Policies without instruments that choose among open-loop plans by what agents have observed.

All plans have a common opening. After it, a kernel ridge regression, fitted in training worlds, predicts the score of
each plan in this world from observations, and the plan with the highest prediction is played. If such a policy scores
higher than every single plan, the observations of the opening contain information without paid measurements. The plans
are the best open-loop policies and the best plans of single training worlds.

| opening | observations | detects |
|---|---|---|
| ``submission``: the best plan up to its first submission | ``feedback``: the manager's, and the amount and purity of \
its submissions; ``central``: also those of all benches | feedback from customers in place of measurements |
| ``look-KEY``: start a bench of that kind on every vessel and recall it | ``central`` | free looks at vessels |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Bench
from chemlab.roles.manager_actions import KIND, SUBMIT

from ..open_loop import Context, Playback
from ..policies import make_policies
from ..roles import action_size, role_of
from .plans import SEARCH_SEED, Tape, TeamPlan, Trials, drawn_contexts
from .play import BATCH
from .search import Search

_WORLD_SEED = SEARCH_SEED + 500_000
"""Seed of the first training world in which plans are compared."""
_RIDGES = (1e-3, 1e-1, 10.0)
"""Regularization parameters of the regression."""
_WIDTHS = (None, 1.0, 3.0)
"""Widths of a Gaussian kernel, in units of the median distance; None: a linear kernel."""

Teams = Mapping[Context, Sequence[TeamPlan]]
Arrays = npt.NDArray[Any]


def openings(scenario: Scenario) -> list[str]:
    """Return the names of a scenario's openings."""
    looks = [f"look-{key}" for key in scenario.benches]
    return [*looks, "submission"] if scenario.orders > 1 else looks


def informed_scores(
    scenario: Scenario,
    opening: str,
    known: Teams,
    worlds: int,
    library: int,
    budget: int,
    episodes: int,
    seed: int,
) -> tuple[list[float], list[float]] | None:
    """Score policies that choose among plans after an opening.

    Args:
        scenario: the scenario.
        opening: one of :func:`openings`.
        known: open-loop policies by context, the best last.
        worlds: number of training worlds in which plans are compared, for each context.
        library: number of training worlds for which the best plan is searched.
        budget: number of plans tried in each of these.
        episodes: number of episodes; episode i has seed + i.
        seed: seed of the first episode.

    Returns:
        [episodes] scores of the choice by the observations of all agents, and by the manager's only; None if the best
        plan has no submission before its last action, so that there is no such opening.
    """
    labs = Laboratories(scenario, episodes, split="test")
    central, feedback = np.empty(episodes), np.empty(episodes)
    for context, members in drawn_contexts(labs, seed).items():
        teams = known[context]
        parts = _opening(labs, opening, context, teams[-1])
        if parts is None:
            return None
        first, rest = parts
        candidates = [rest, *teams]
        for world in range(library):
            world_seed, seeds = _WORLD_SEED - 1 - world, np.random.SeedSequence([world, budget])
            search = Search(
                scenario, "scripted", context, budget, seeds, lambda _: None, (), [world_seed], "train", True, first
            )
            search.improve(list(teams), donors=False)
            candidates.append(search.best[0].team)
        plans = [team.after(first) for team in dict.fromkeys(candidates)]
        world_seeds = range(_WORLD_SEED, _WORLD_SEED + worlds)
        train_seen, train_scores = _table(scenario, context, plans, first, world_seeds, "train")
        test_seen, test_scores = _table(scenario, context, plans, first, [seed + i for i in members], "test")
        # With amount and purity of each submission.
        by_manager = labs.observation_sizes[labs.manager.index] + 2 * scenario.orders
        for scores, part in ((central, slice(None)), (feedback, slice(by_manager))):
            train, test = (seen[:, :, part].reshape(len(seen), -1) for seen in (train_seen, test_seen))
            scores[members] = test_scores[_choice(train, train_scores, test), np.arange(len(members))]
    return central.tolist(), feedback.tolist()


def _opening(labs: Laboratories, name: str, context: Context, best: TeamPlan) -> tuple[TeamPlan, TeamPlan] | None:
    """Return an opening, and the rest of the best plan after it; None if there is no such opening."""
    actions, agents = labs.actions, labs.bench_agents
    if name == "submission":
        kinds = actions.table[list(best.plan), KIND].tolist()
        if SUBMIT not in kinds[:-1]:
            return None
        end = kinds.index(SUBMIT) + 1
        started = [actions.decode(action)[1] for action in best.plan[:end] if actions.decode(action)[0] == "start"]
        tapes = best.benches or (None,) * len(agents)
        first = tuple(_experiments(tape, started.count(agent)) for tape, agent in zip(tapes, agents, strict=True))
        return TeamPlan(best.plan[:end], first), TeamPlan(best.plan[end:], best.benches)
    looking = next(agent for agent in agents if role_of(agent) == name.partition("-")[2])
    vessels, grade = len(labs.scenario.shelf.vessel), actions.grades[:1]
    plan: list[int] = []
    for slot in range(vessels):
        plan += [actions.encode("start", looking, slot, context[0], *grade), actions.encode("recall", looking)]
    tapes = tuple(
        (_idle(bench),) * (vessels if agent == looking else 0)
        for agent, bench in zip(agents, labs.benches, strict=True)
    )
    return TeamPlan(tuple(plan), tapes), best


def _experiments(tape: Tape | None, count: int) -> Tape | None:
    """Return the tape of the first ``count`` experiments."""
    return None if tape is None else tuple(tape[min(i, len(tape) - 1)] for i in range(count))


def _idle(bench: Bench) -> tuple[Any, ...]:
    """Return the actions of an experiment that changes nothing."""
    if bench.action_count:
        return (bench.end_action,)
    size = action_size(bench.action_space)
    return (tuple([0.5, 0.5, *[0.0] * size][:size]),)


class _Observing(Playback):
    """Plays plans, and records all agents' observations before each action of an opening and after the last one.

    Attributes:
        seen: [N, opening + 1, size] observations: the manager's, amounts and purities of submissions, the benches'.
    """

    def __init__(self, labs: Laboratories, plans: Sequence[tuple[int, ...]], opening: int) -> None:
        super().__init__(labs.actions, plans)
        self._labs, self._opening = labs, opening
        size = sum(labs.observation_sizes) + 2 * labs.scenario.orders
        self.seen = np.zeros((len(plans), opening + 1, size), dtype=np.float32)

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        actions = super().act(observation, mask, step, members)
        # Position of the action that is played or waited for.
        at = self._next[members] - (actions == self._steps[members, np.maximum(self._next[members] - 1, 0)])
        rows = np.flatnonzero(at <= self._opening)
        if len(rows):
            in_opening, accounts = members[rows], self._labs.manager.accounts(slice(None))
            parts = [observation[rows], accounts["submitted_mol"][in_opening], accounts["purity"][in_opening]]
            parts += [self._labs.observe(role.index, in_opening) for role in self._labs.bench_roles]
            self.seen[in_opening, np.maximum(at[rows], 0)] = np.concatenate(parts, axis=1)
        return actions


def _table(
    scenario: Scenario,
    context: Context,
    plans: Sequence[TeamPlan],
    opening: TeamPlan,
    seeds: Sequence[int],
    split: str,
) -> tuple[Arrays, FloatArray]:
    """Return [seeds, turns, size] observations in the opening, and [plans, seeds] scores."""
    seen, scores = [], np.empty((len(plans), len(seeds)))
    for first in range(0, len(seeds), BATCH):
        batch = seeds[first : first + BATCH]
        trials = Trials(scenario, context, batch, 1, split)
        policies = make_policies("scripted", trials.labs)
        observing = _Observing(trials.labs, [plans[0].plan] * len(batch), len(opening.plan))
        for i, team in enumerate(plans):
            manager = None if i else observing  # observations in the opening are the same for all plans
            scores[i, first : first + len(batch)] = trials.play_teams([team], policies, manager)[0]
        seen.append(np.nan_to_num(observing.seen).astype(np.float64))
    return np.concatenate(seen), scores


def _choice(seen: Arrays, scores: FloatArray, present: Arrays) -> IntArray:
    """Return [E] the plan for each world with observations ``present`` [E, size], by kernel ridge regression.

    The regression is fitted to observations ``seen`` [W, size] and ``scores`` [plans, W] in training worlds. Kernel and
    regularization are chosen by cross-validation with two folds. If no regression is better than the best single plan,
    that is chosen in all worlds.
    """
    single = np.full(len(present), scores.mean(axis=1).argmax())
    varies = seen.std(axis=0) > 1e-6
    if not varies.any():
        return single
    mean, deviation = seen[:, varies].mean(axis=0), seen[:, varies].std(axis=0)
    train, test = ((part[:, varies] - mean) / deviation for part in (seen, present))
    folds = slice(0, len(train) // 2), slice(len(train) // 2, None)
    options = [(width, ridge) for width in _WIDTHS for ridge in _RIDGES]

    def choose(rows: slice, others: Arrays, width: float | None, ridge: float) -> IntArray:
        """Return the plans with the highest predictions for other worlds, fitted on some of the training worlds."""
        center = scores[:, rows].mean(axis=1)
        kernel, between = _kernels(train[rows], others, width)
        weights = np.linalg.solve(kernel + ridge * np.eye(len(kernel)), (scores[:, rows] - center[:, None]).T)
        return np.asarray((between @ weights + center).argmax(axis=1))

    def validated(option: tuple[float | None, float]) -> float:
        """Return the mean score of choices in each fold that are fitted on the other."""
        means = []
        for fit, fold in (folds[::-1], folds):
            chosen = choose(fit, train[fold], *option)
            means.append(scores[:, fold][chosen, np.arange(len(chosen))].mean())
        return float(np.mean(means))

    best = max(options, key=validated)
    if validated(best) <= scores.mean(axis=1).max():
        return single
    return choose(slice(None), test, *best)


def _kernels(own: Arrays, others: Arrays, width: float | None) -> tuple[Arrays, Arrays]:
    """Return the kernel matrix of rows with themselves, and of other rows with them; see ``_WIDTHS``."""
    if width is None:
        return own @ own.T / own.shape[1], others @ own.T / own.shape[1]
    squares = (own**2).sum(axis=1)
    within = np.maximum(squares[:, None] + squares - 2.0 * own @ own.T, 0.0)
    between = np.maximum((others**2).sum(axis=1)[:, None] + squares - 2.0 * others @ own.T, 0.0)
    scale = 2.0 * width**2 * max(float(np.median(within)), 1e-12)
    return np.exp(-within / scale), np.exp(-between / scale)
