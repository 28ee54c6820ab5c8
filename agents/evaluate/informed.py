"""Policies without instruments that choose among open-loop plans by what agents have observed.

All plans have an opening in common. After it, a kernel ridge regression, fitted in training worlds, predicts from
observations what each plan will score in this world, and the plan with the highest prediction is played. If such a
policy scores more than any plan alone, then the observations of the opening hold information that no instrument was
paid for. The plans are the best open-loop policies and the best plans of single training worlds.

| opening | observations | detects |
|---|---|---|
| ``submission``: the best plan up to its first submission | ``feedback``: the manager's, and the terms and outcome of \
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
from ..roles import role_of
from .plans import SEARCH_SEED, Tape, TeamPlan, Trials, drawn_contexts
from .play import BATCH
from .search import Search

_WORLD_SEED = SEARCH_SEED + 500_000
"""Of the first training world in which plans are compared."""
_RIDGES = (1e-3, 1e-1, 10.0)
_WIDTHS = (None, 1.0, 3.0)
"""Widths of a Gaussian kernel, in units of the median distance; None: a linear kernel."""

Teams = Mapping[Context, Sequence[TeamPlan]]
Arrays = npt.NDArray[Any]


def openings(scenario: Scenario) -> list[str]:
    """Return the names of the openings that a scenario has."""
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
    """Score the policies that choose among plans after an opening.

    Args:
        scenario: where.
        opening: one of :func:`openings`.
        known: open-loop policies by context, the best last.
        worlds: training worlds in which plans are compared, for each context.
        library: training worlds for each of which the best plan is searched.
        budget: plans tried in each of these.
        episodes: episode i has seed + i.
        seed: of the first.

    Returns:
        [episodes] scores of the choice by the observations of all agents, and by the manager's alone; None if the best
        plan submits nothing before its end, so that there is no such opening.
    """
    labs = Laboratories(scenario, episodes, split="test")
    central, feedback = np.empty(episodes), np.empty(episodes)
    for context, own in drawn_contexts(labs, seed).items():
        teams = known[context]
        begun = _opening(labs, opening, context, teams[-1])
        if begun is None:
            return None
        first, rest = begun
        found = [rest, *teams]
        for world in range(library):
            at, numbers = _WORLD_SEED - 1 - world, np.random.SeedSequence([world, budget])
            search = Search(
                scenario, "scripted", context, budget, numbers, lambda _: None, (), [at], "train", True, first
            )
            search.improve(list(teams), donors=False)
            found.append(search.best[0].team)
        plans = [team.after(first) for team in dict.fromkeys(found)]
        seen, learned = _table(scenario, context, plans, first, range(_WORLD_SEED, _WORLD_SEED + worlds), "train")
        now, played = _table(scenario, context, plans, first, [seed + i for i in own], "test")
        manager = labs.observation_sizes[0] + _accounts(labs)
        for scores, part in ((central, slice(None)), (feedback, slice(manager))):
            known_of, asked_of = (one[:, :, part].reshape(len(one), -1) for one in (seen, now))
            scores[own] = played[_choice(known_of, learned, asked_of), np.arange(len(own))]
    return central.tolist(), feedback.tolist()


def _accounts(labs: Laboratories) -> int:
    """Return how many numbers the terms and outcome of submissions are."""
    return 2 * labs.scenario.orders


def _opening(labs: Laboratories, name: str, context: Context, best: TeamPlan) -> tuple[TeamPlan, TeamPlan] | None:
    """Return an opening, and what the best plan does after it; None if there is no such opening."""
    actions, agents = labs.actions, labs.bench_agents
    if name == "submission":
        kinds = actions.table[list(best.plan), KIND].tolist()
        if SUBMIT not in kinds[:-1]:
            return None
        end = kinds.index(SUBMIT) + 1
        begun = [actions.decode(action)[1] for action in best.plan[:end] if actions.decode(action)[0] == "start"]
        tapes = best.benches or (None,) * len(agents)
        first = tuple(_experiments(tape, begun.count(agent)) for tape, agent in zip(tapes, agents, strict=True))
        return TeamPlan(best.plan[:end], first), TeamPlan(best.plan[end:], best.benches)
    agent = next(agent for agent in agents if role_of(agent) == name.partition("-")[2])
    grade = actions.grades[:1]
    plan: list[int] = []
    for slot in range(len(labs.scenario.shelf.vessel)):
        plan += [actions.encode("start", agent, slot, context[0], *grade), actions.encode("recall", agent)]
    count = len(labs.scenario.shelf.vessel)
    tapes = tuple(
        (_idle(bench),) * (count if own == agent else 0) for own, bench in zip(agents, labs.benches, strict=True)
    )
    return TeamPlan(tuple(plan), tapes), best


def _experiments(tape: Tape | None, count: int) -> Tape | None:
    """Return the tape of the first experiments."""
    return None if tape is None else tuple(tape[min(i, len(tape) - 1)] for i in range(count))


def _idle(bench: Bench) -> tuple[Any, ...]:
    """Return the actions of an experiment that changes nothing."""
    if bench.action_count:
        return (bench.end_action,)
    size = int((bench.action_space.shape or (0,))[0])
    return (tuple([0.5, 0.5, *[0.0] * size][:size]),)


class _Observing(Playback):
    """Plays plans, and keeps what agents observe before each action of an opening and after the last.

    Attributes:
        seen: [N, opening + 1, size], what the manager observes first.
    """

    def __init__(self, labs: Laboratories, plans: Sequence[tuple[int, ...]], opening: int) -> None:
        super().__init__(labs.actions, plans)
        self._labs, self._opening = labs, opening
        size = sum(labs.observation_sizes) + _accounts(labs)
        self.seen = np.zeros((len(plans), opening + 1, size), dtype=np.float32)

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        actions = super().act(observation, mask, step, members)
        # A position is that of the action that is played or waited for.
        at = self._next[members] - (actions == self._steps[members, np.maximum(self._next[members] - 1, 0)])
        rows = np.flatnonzero(at <= self._opening)
        if len(rows):
            own, accounts = members[rows], self._labs.manager.accounts(slice(None))
            parts = [observation[rows], accounts["submitted_mol"][own], accounts["purity"][own]]
            parts += [self._labs.observe(number, own) for number in range(1, len(self._labs.agents))]
            self.seen[own, np.maximum(at[rows], 0)] = np.concatenate(parts, axis=1)
        return actions


def _table(
    scenario: Scenario,
    context: Context,
    plans: Sequence[TeamPlan],
    opening: TeamPlan,
    seeds: Sequence[int],
    split: str,
) -> tuple[Arrays, FloatArray]:
    """Return [seeds, turns, size] what is observed in the opening, and [plans, seeds] the scores."""
    seen, scores = [], np.empty((len(plans), len(seeds)))
    for first in range(0, len(seeds), BATCH):
        some = seeds[first : first + BATCH]
        trials = Trials(scenario, context, some, 1, split)
        policies = make_policies("scripted", trials.labs)
        for number, team in enumerate(plans):
            observing = _Observing(trials.labs, [team.plan] * len(some), len(opening.plan))
            manager = observing if number == 0 else None
            scores[number, first : first + len(some)] = trials.play_teams([team], policies, manager)[0]
            if number == 0:
                seen.append(np.nan_to_num(observing.seen).astype(np.float64))
    return np.concatenate(seen), scores


def _choice(seen: Arrays, scores: FloatArray, now: Arrays) -> IntArray:
    """Return the plan of each row of ``now`` [E, size], from observations [W, size] and scores [plans, W]."""
    varies = seen.std(axis=0) > 1e-6
    if not varies.any():
        return np.full(len(now), scores.mean(axis=1).argmax())
    mean, spread = seen[:, varies].mean(axis=0), seen[:, varies].std(axis=0)
    known, asked = ((part[:, varies] - mean) / spread for part in (seen, now))
    half = len(known) // 2
    options = [(width, ridge) for width in _WIDTHS for ridge in _RIDGES]

    def predicted(rows: slice, others: Arrays, width: float | None, ridge: float) -> FloatArray:
        own, center = known[rows], scores[:, rows].mean(axis=1)
        kernel, between = _kernels(own, others, width)
        weights = np.linalg.solve(kernel + ridge * np.eye(len(own)), (scores[:, rows] - center[:, None]).T)
        return np.asarray(between @ weights + center)

    def worth(width: float | None, ridge: float) -> float:
        """Score in each half of the choices fitted in the other."""
        halves = (slice(half, None), slice(0, half)), (slice(0, half), slice(half, None))
        return float(
            np.mean(
                [
                    scores[:, other][
                        predicted(fit, known[other], width, ridge).argmax(axis=1), np.arange(len(known[other]))
                    ].mean()
                    for fit, other in halves
                ]
            )
        )

    best = max(options, key=lambda option: worth(*option))
    if worth(*best) <= scores.mean(axis=1).max():
        return np.full(len(now), scores.mean(axis=1).argmax())
    return np.asarray(predicted(slice(None), asked, *best).argmax(axis=1))


def _kernels(own: Arrays, others: Arrays, width: float | None) -> tuple[Arrays, Arrays]:
    """Return the kernel of rows with themselves, and of other rows with them."""
    if width is None:
        return own @ own.T / own.shape[1], others @ own.T / own.shape[1]
    squares = (own**2).sum(axis=1)
    within = np.maximum(squares[:, None] + squares - 2.0 * own @ own.T, 0.0)
    between = np.maximum((others**2).sum(axis=1)[:, None] + squares - 2.0 * others @ own.T, 0.0)
    scale = 2.0 * width**2 * max(float(np.median(within)), 1e-12)
    return np.exp(-within / scale), np.exp(-between / scale)
