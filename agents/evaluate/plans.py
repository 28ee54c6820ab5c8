"""The best that blind agents do: a search for constant plans of the manager, and episodes replayed without looking.

Whatever needs eyes must beat these. :func:`search_plan` tries fixed sequences of manager actions over benches that see;
:func:`replay_actions` plays again, from other seeds, what everybody did in a donor's episode.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Players, Policy
from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import MANAGER_AGENT, Laboratories
from chemlab.roles.manager_actions import DISCARD, MEASURE, RECALL, REPAIR, START, SUBMIT, WAIT, ManagerActions

from ..episodes import play_laboratory
from ..names import current_name
from ..plans import ConstantPlan, Context, Plan, PlanFile, Playback, all_contexts
from ..policies import agent_policy, make_policies
from ..roles import role_of
from ..runs import versions
from . import statistics
from .play import BATCH
from .statistics import Estimate

__all__ = [
    "PLAN_BUDGETS",
    "FoundPlan",
    "PlanSearch",
    "Replayed",
    "best_in_episode",
    "plan_budget",
    "plan_words",
    "replay_actions",
    "search_plan",
]

PLAN_BUDGETS = {"small": 10_000, "full": 100_000}
"""Plans tried in all."""

SEARCH_SEED = 3_000_000
"""Of the first episode that plans are tried on: seeds that neither training nor evaluation plays."""
SEEDS = 8
"""Seeds a promising plan is tried on."""
NOISE = 0.02
"""Standard deviation of good plans' scores over seeds below which one seed selects promising plans."""

_LONGEST = 12  # actions for each order
_POPULATION, _CHILDREN, _FIRST = 32, 128, 256
_ISLANDS, _PATIENCE = 3, 6
_SAME = 1e-9
_OWN_GOAL = 4.0
"""Relative probability of starting an experiment for an order's goal rather than for another."""
_SCRIPTED = ("scripted", "scripted:no-extraction", "scripted:unsafe")
_PROMISING, _FINALISTS, _FINAL_SEEDS = 4, 16, 64
# Chances with which a random plan does something next, where it is possible.
_CHANCES = {START: 6.0, MEASURE: 0.0, DISCARD: 1.0, SUBMIT: 1.5, RECALL: 0.3, WAIT: 3.0, REPAIR: 0.5}


@dataclass(frozen=True)
class FoundPlan:
    """The best plan for a public context; ``score`` is its mean over ``seeds`` episodes that it was chosen on, other
    than those it was found on."""

    context: Context
    plan: Plan
    score: float
    seeds: int


@dataclass(frozen=True)
class PlanSearch:
    """The result of a search.

    Attributes:
        scenario: where.
        benches: who operated the benches.
        found: for every public context.
        tried: number of plans.
    """

    scenario: Scenario
    benches: str
    found: list[FoundPlan]
    tried: int

    @property
    def plans(self) -> dict[Context, Plan]:
        """By context."""
        return {one.context: one.plan for one in self.found}

    def play(self, episodes: int = 100, seed: int = 0, split: str = "train") -> FloatArray:
        """[episodes] scores of the plans; episode i has seed + i, as ``chemlab evaluate`` plays it.

        Raises:
            ValueError: the search was not for every context.
        """
        labs = Laboratories(self.scenario, episodes, split=split)
        return play_laboratory(labs, self.policies(labs, seed), None, seed).returns

    def policies(self, labs: Laboratories, seed: int | None = None) -> dict[str, Policy]:
        """The manager that plays them, and who operates the benches."""
        manager = ConstantPlan(labs.scenario, labs.channels, labs.actions, self.plans)
        return {**make_policies(self.benches, labs, seed), MANAGER_AGENT: manager}

    def as_file(self, command: str, episodes: int = 100, seed: int = 0) -> PlanFile:
        """As it is stored, with the score from seeds of its own."""
        actions = ManagerActions.of(self.scenario)
        score = statistics.mean([self.play(episodes, seed)])
        plans = [
            {"goals": list(one.context), "score": one.score, "steps": [list(actions.decode(a)) for a in one.plan]}
            for one in self.found
        ]
        evaluation = {"episodes": episodes, "seed": seed, **score.as_dict()}
        return PlanFile(self.scenario.name, self.benches, command, versions(), self.tried, evaluation, plans)


def plan_words(scenario: Scenario, plan: Iterable[int]) -> list[str]:
    """A plan's actions in words."""
    meanings = ManagerActions.of(scenario).action_meanings
    return [meanings[action] for action in plan]


# -- trying plans -----------------------------------------------------------------------------------------------------


class _Trials:
    """Laboratories in which several things are tried, each on the same seeds of one public context.

    Args:
        scenario: where.
        context: the goals of the orders.
        seeds: of the episodes.
        most: things tried at once.
        split: worlds, of a scenario that draws some.
    """

    def __init__(
        self, scenario: Scenario, context: Context, seeds: Sequence[int], most: int, split: str = "train"
    ) -> None:
        self.labs = Laboratories(scenario, most * len(seeds), split=split)
        self.most, self.seeds = most, list(seeds)
        members = self.labs.members
        self.seed_of: IntArray = np.tile(np.array(self.seeds, dtype=np.int64), most)
        for member, seed in zip(members.tolist(), self.seed_of.tolist(), strict=True):
            self.labs.seed(member, np.random.SeedSequence(seed))
        self.labs.reset(members, context[0])
        # A reset by name asks for the same in every order; it draws what any other draws.
        self.labs.state.goal[members] = [scenario.goals.index(goal) for goal in context]
        self._begun = self.labs.snapshot()

    def seed_policies(self, policies: Iterable[Policy]) -> None:
        """Seed the policies' random streams, equally for equal seeds."""
        for number, policy in enumerate(policies):
            if hasattr(policy, "seed"):
                for member, seed in zip(self.labs.members.tolist(), self.seed_of.tolist(), strict=True):
                    policy.seed(member, np.random.SeedSequence([seed, number]))

    def play(self, policies: Sequence[Policy], count: int) -> FloatArray:
        """[count, seeds] the manager's scores; member i plays thing i // len(seeds)."""
        self.labs.restore(self._begun)
        members = self.labs.members[: count * len(self.seeds)]
        Players(self.labs, policies).play_on(members)
        return self.labs.result(members).reshape(count, len(self.seeds))


class _Recording(Playback):
    """Also writes down what was played, and what could have been.

    Attributes:
        played: [P, L] which actions of each sequence.
        legal: [P, L, A] what was legal at an action, or while the manager waited for it.
        after: what was played when a sequence had come to its end.
    """

    def __init__(self, actions: ManagerActions, plans: Sequence[Plan]) -> None:
        super().__init__(actions, plans)
        n, longest = self._steps.shape
        self.played: BoolArray = np.zeros((n, longest), dtype=np.bool_)
        self.legal: BoolArray = np.zeros((n, longest, len(actions)), dtype=np.bool_)
        self.after: list[list[int]] = [[] for _ in range(n)]

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        actions = super().act(observation, mask, step, members)
        position = self._next[members]
        last = np.maximum(position - 1, 0)
        # Waiting for the next action is none of the plan's, though the one before may have been to wait as well.
        own = (position > 0) & (actions == self._steps[members, last]) & ~self.played[members, last]
        at = np.where(own, last, position)
        self.legal[members, at] |= mask != 0
        self.played[members[own], at[own]] = True
        for i in np.flatnonzero(~own & (actions != self._wait)):
            self.after[members[i]].append(int(actions[i]))
        return actions


class _Moves:
    """Random actions for plans, and changes of plans.

    Args:
        actions: the manager's.
        context: the goals of the orders.
        rng: draws them.
        without: benches that are not used, by key.
    """

    def __init__(
        self, actions: ManagerActions, context: Context, rng: np.random.Generator, without: Collection[str] = ()
    ) -> None:
        table = actions.table
        asked = [actions.goals.index(goal) for goal in context]
        self._weights = np.where((table[:, 0] == START) & np.isin(table[:, 3], asked), _OWN_GOAL, 1.0)
        idle = [b for b, agent in enumerate(actions.bench_agents) if role_of(agent) in without]
        avoided = (table[:, 0] == START) & np.isin(table[:, 1], idle)
        self.longest = _LONGEST * actions.orders
        self._rng = rng
        self._of_kind: BoolArray = np.stack([(table[:, 0] == kind) & ~avoided for kind in _CHANCES])
        self._chances = np.array(list(_CHANCES.values()))
        self._kind = table[:, 0]
        self.useful: BoolArray = self._chances @ self._of_kind > 0.0
        slot_column = {START: 2, DISCARD: 1, SUBMIT: 1}
        self.elsewhere: list[list[int]] = []
        """By action: the same on other slots."""
        for action, row in enumerate(table):
            column = slot_column.get(int(row[0]))
            others = [] if column is None else np.flatnonzero((np.delete(table == row, column, 1)).all(axis=1)).tolist()
            self.elsewhere.append([other for other in others if other != action and not avoided[other]])

    def draw(self, legal: BoolArray) -> int:
        """One of the legal actions: first its kind, then which; WAIT, the last, where nothing is."""
        chances = self._chances * (self._of_kind & legal).any(axis=1)
        total = chances.sum()
        if total == 0.0:
            return len(legal) - 1
        kind = int(np.searchsorted(np.cumsum(chances), self._rng.random() * total, side="right"))
        weights = np.cumsum(self._weights * (self._of_kind[kind] & legal))
        return int(np.searchsorted(weights, self._rng.random() * weights[-1], side="right"))

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """Random legal actions, see :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        return np.array([self.draw(row != 0) for row in mask], dtype=np.int64)

    def changed(self, parents: Sequence[_Tried]) -> Plan:
        """A plan like one of the first of ``parents``, with one or a few changes."""
        steps = self._pick(parents).steps()
        while True:
            self._change(steps, parents)
            if self._rng.random() < 0.5:
                return tuple(action for action, _ in steps)[: self.longest]

    def _pick(self, parents: Sequence[_Tried]) -> _Tried:
        return parents[int(len(parents) * self._rng.random() ** 2)]

    def _change(self, steps: list[tuple[int, BoolArray]], parents: Sequence[_Tried]) -> None:
        """Change one action, or take over the end of another plan."""
        rng = self._rng
        if not steps:
            steps += self._pick(parents).steps()
            return
        i, what = int(rng.integers(len(steps))), rng.random()
        action, legal = steps[i]
        if what < 0.3:
            steps.insert(i, (self.draw(legal), legal))
        elif what < 0.5:
            same = legal & (self._kind == self._kind[action])
            steps[i] = self.draw(same if rng.random() < 0.5 and same.any() else legal), legal
        elif what < 0.75:
            others = self.elsewhere[action]
            if others:
                steps[i] = int(rng.choice(others)), legal
        elif what < 0.85:
            del steps[i]
        elif what < 0.92:
            j = int(rng.integers(len(steps)))
            steps[i], steps[j] = steps[j], steps[i]
        else:
            other = self._pick(parents).steps()
            steps[i:] = other[int(rng.integers(len(other) + 1)) :]

    def neighbours(self, tried: _Tried) -> list[Plan]:
        """All plans that one change away: an action left out, put in, exchanged, elsewhere, or after the next."""
        plan = tried.plan
        found = [plan[:i] + plan[i + 1 :] for i in range(len(plan))]
        found += [(*plan[:i], plan[i + 1], plan[i], *plan[i + 2 :]) for i in range(len(plan) - 1)]
        for i, action in enumerate(plan):
            legal = np.flatnonzero(tried.legal[i] & self.useful).tolist()
            found += [(*plan[:i], other, *plan[i + 1 :]) for other in dict.fromkeys([*legal, *self.elsewhere[action]])]
            found += [(*plan[:i], other, *plan[i:]) for other in legal]
        return [plan for plan in found if len(plan) <= self.longest]


@dataclass(frozen=True)
class _Tried:
    """A plan that has been tried.

    Attributes:
        score: mean over seeds.
        deviation: its standard deviation over seeds.
        plan: what was played of it, and what was played when it had come to its end.
        legal: [len(plan), A] what could have been played instead of each action, or before it.
    """

    score: float
    deviation: float
    plan: Plan
    legal: BoolArray

    def steps(self) -> list[tuple[int, BoolArray]]:
        """The plan's actions, each with what was legal there."""
        return list(zip(self.plan, self.legal, strict=True))


_Prepared = tuple[_Trials, list[Policy]]
"""Laboratories, and who plays there."""


class _Search:
    """The search for one public context: generations of changed plans, from several random beginnings (the first has
    also what scripted managers do) and then from the best of all; when they bring nothing new, every single change of
    the best.

    Args:
        scenario: where.
        benches: who operates the benches.
        context: the goals of the orders.
        budget: most plans tried.
        seed: of all that is drawn.
        watch: called with the number of plans just tried.
        without: benches that are not used, by key.
        seeds: of the episodes that plans are tried on.
        split: their worlds, of a scenario that draws some.

    Attributes:
        tried: number of plans.
        curve: [(plans tried, best score so far)].
    """

    def __init__(
        self,
        scenario: Scenario,
        benches: str,
        context: Context,
        budget: int,
        seed: np.random.SeedSequence,
        watch: Callable[[int], None],
        without: Collection[str] = (),
        seeds: Sequence[int] = range(SEARCH_SEED, SEARCH_SEED + SEEDS),
        split: str = "train",
    ) -> None:
        self._scenario, self._benches, self._context, self._watch = scenario, benches, context, watch
        self._budget, self.tried = budget, 0
        self._actions, self._without = ManagerActions.of(scenario), without
        self._moves = _Moves(self._actions, context, np.random.default_rng(seed), without)
        self._seen: set[Plan] = set()
        self._best: list[_Tried] = []
        self.curve: list[tuple[int, float]] = []
        self._split, self._first_seed = split, seeds[0]
        self._one, self._several = self._prepared(seeds[:1]), self._prepared(seeds)

    def _prepared(self, seeds: Sequence[int]) -> _Prepared:
        """Laboratories for these seeds, and who plays there; the manager's place is the plans'."""
        trials = _Trials(self._scenario, self._context, seeds, max(BATCH // len(seeds), 1), self._split)
        policies = make_policies(self._benches, trials.labs)
        return trials, [policies[agent] for agent in trials.labs.agents]

    def _play(self, prepared: _Prepared, plans: Sequence[Plan]) -> list[_Tried]:
        trials, policies = prepared
        found = []
        for first in range(0, len(plans), trials.most):
            some = plans[first : first + trials.most]
            seeds = len(trials.seeds)
            recording = _Recording(self._actions, [plan for plan in some for _ in range(seeds)])
            trials.seed_policies(policies[1:])
            scores = trials.play([recording, *policies[1:]], len(some))
            for i, (plan, score) in enumerate(zip(some, scores, strict=True)):
                rows = slice(i * seeds, (i + 1) * seeds)
                kept = np.flatnonzero(recording.played[rows].any(axis=0))
                after = recording.after[i * seeds]
                at = np.append(kept, np.full(len(after), len(plan), dtype=np.int64))
                played = (*(plan[k] for k in kept), *after)
                legal = np.asarray(recording.legal[rows].any(axis=0))[at]
                found.append(_Tried(float(score.mean()), float(score.std()), played, legal))
        return found

    def _try(self, plans: Iterable[Plan]) -> list[_Tried]:
        """Those of the plans that are new, tried, as far as the budget goes; the best are remembered.

        Where noise is small, what does not look promising from one seed is not played from several.
        """
        fresh = [plan for plan in dict.fromkeys(plans) if plan not in self._seen][: self._budget - self.tried]
        if not fresh:
            return []
        if self._best and np.median([tried.deviation for tried in self._best]) >= NOISE:
            found = sure = self._play(self._several, fresh)
        else:
            found = self._play(self._one, fresh)
            bar = self._best[-1].score if len(self._best) == _FINALISTS else -np.inf
            order = sorted(range(len(found)), key=lambda i: -found[i].score)
            promising = [i for i in order[:_PROMISING] if found[i].score > bar]
            sure = self._play(self._several, [fresh[i] for i in promising])
            for i, tried in zip(promising, sure, strict=True):
                found[i] = tried
        self._seen.update(fresh)
        self._seen.update(tried.plan for tried in found)
        self.tried += len(fresh)
        self._watch(len(fresh))
        self._best = _ranked([*self._best, *sure], _FINALISTS)
        self.curve.append((self.tried, self._best[0].score))
        return found

    def _random(self, count: int) -> list[Plan]:
        """Return the plans of random legal play in as many episodes of the first seed."""
        plans: list[Plan] = []
        trials, policies = self._prepared([self._first_seed])
        while len(plans) < count:
            taped = _Tape(self._moves, trials.labs.members)
            trials.seed_policies(policies[1:])
            trials.play([taped, *policies[1:]], trials.most)
            plans += [tuple(tape[0][: self._moves.longest]) for tape in taped.tapes]
        return plans

    def _scripted(self) -> list[Plan]:
        """Return the scripted managers' plans in the first seed's episode, without measurements."""
        plans = []
        trials, policies = self._prepared([self._first_seed])
        for name in _SCRIPTED:
            taped = _Tape(agent_policy(name, trials.labs, 0), trials.labs.members)
            trials.seed_policies(policies[1:])
            trials.play([taped, *policies[1:]], 1)
            plans.append(tuple(a for a in taped.tapes[0][0] if self._moves.useful[a]))
        return plans

    def improve(self, known: Sequence[Plan]) -> float:
        """Return the best score on the episodes themselves, from ``known`` and the scripted managers' plans: the score
        of an oracle."""
        self._try([*known, *self._scripted()])
        best = -np.inf
        while self.tried < self._budget and self._best[0].score > best + _SAME:
            best = self._best[0].score
            self._evolve(self._best, self._budget)
        return self._best[0].score

    def run(self, known: Sequence[Plan]) -> FoundPlan:
        """Search; ``known`` are plans to begin with."""
        beginning = [*known, *self._scripted()]
        islands, best = (1 if known else _ISLANDS), -np.inf
        while self.tried < self._budget:
            for _ in range(islands):
                first = self._try([*beginning, *self._random(_FIRST)])
                beginning = []
                self._evolve(first, self._budget // (2 * islands))
            self._evolve(self._best, self._budget)
            if self._best[0].score <= best + _SAME:
                break
            best = self._best[0].score
        return self._final()

    def _evolve(self, population: Sequence[_Tried], most: int) -> None:
        """Generations of changed plans, until nothing new comes of them or ``most`` plans have been tried."""
        population, stale, end = _ranked(population, _POPULATION), 0, min(self.tried + most, self._budget)
        while population and self.tried < end:
            best = population[0].score
            if stale < _PATIENCE:
                changed = [self._moves.changed(population) for _ in range(_CHILDREN)]
            else:
                changed = self._moves.neighbours(population[0])
            population = _ranked([*population, *self._try(changed)], _POPULATION)
            if population[0].score > best + _SAME:
                stale = 0
            elif stale == _PATIENCE:
                return
            else:
                stale += 1

    def _final(self) -> FoundPlan:
        """The best of the finalists on other seeds, without what it does not need."""
        seeds = range(SEARCH_SEED + SEEDS, SEARCH_SEED + SEEDS + _FINAL_SEEDS)
        final = self._prepared(seeds)
        best = _ranked(self._play(final, [tried.plan for tried in self._best]), 1)[0]
        while True:
            shorter = [best.plan[:i] + best.plan[i + 1 :] for i in range(len(best.plan))]
            # What is left out may come back when a plan has come to its end.
            played = [tried for tried in self._play(final, shorter) if len(tried.plan) < len(best.plan)]
            better = _ranked([tried for tried in played if tried.score >= best.score - _SAME], 1)
            if not better:
                return FoundPlan(self._context, best.plan, best.score, len(seeds))
            best = better[0]


def _ranked(tried: Sequence[_Tried], most: int) -> list[_Tried]:
    """The best, one of each score, the shortest first: plans of equal score do the same but for names."""
    ordered = sorted(tried, key=lambda one: (-round(one.score, 9), len(one.plan), one.plan))
    kept: dict[float, _Tried] = {}
    for one in ordered:
        kept.setdefault(round(one.score, 9), one)
        if len(kept) == most:
            break
    return list(kept.values())


def _translated(scenario: Scenario, plan: Plan, source: Context, target: Context) -> Plan:
    """A plan for another context: what was started for an order's goal is started for the goal it has there."""
    actions, goals = ManagerActions.of(scenario), dict(zip(reversed(source), reversed(target), strict=True))
    translated = []
    for action in plan:
        kind, *arguments = actions.decode(action)
        if kind == "start":
            arguments[2] = goals.get(str(arguments[2]), arguments[2])
        translated.append(actions.encode(str(kind), *arguments))
    return tuple(translated)


def plan_budget(budget: int | str) -> int:
    """A budget as a number of plans.

    Args:
        budget: a number, or one of :data:`PLAN_BUDGETS`.

    Raises:
        ValueError: it is neither.
    """
    if isinstance(budget, str) and budget not in PLAN_BUDGETS and not budget.isdecimal():
        raise ValueError(f"budget: a number of plans, or one of {', '.join(PLAN_BUDGETS)}; given {budget!r}")
    return PLAN_BUDGETS[budget] if isinstance(budget, str) and budget in PLAN_BUDGETS else int(budget)


def search_plan(
    scenario: str | Scenario,
    benches: str = "scripted",
    budget: int | str = "small",
    seed: int = 0,
    contexts: Sequence[Context] | None = None,
    watch: Callable[[int], None] | None = None,
    without: Collection[str] = (),
) -> PlanSearch:
    """Find the best constant plan of the manager, for every public context.

    An evolutionary search over sequences of actions, with every single change of the best tried where it stalls.
    A plan is played whatever is seen (:class:`~chemlab.agents.plans.Playback`); the benches' agents see. It holds no
    measurements: they cost something and tell a blind manager nothing. What is found depends on the arguments alone.

    Args:
        scenario: where.
        benches: who operates them, see :func:`~chemlab.agents.policies.make_policies`.
        budget: most plans tried, or one of :data:`PLAN_BUDGETS`; the first context gets half of it. A search ends
            sooner when new beginnings from random plans have found nothing better.
        seed: of the search.
        contexts: default: all that the scenario may draw.
        watch: called with the number of plans just tried.
        without: benches that plans do without, by key.

    Raises:
        ValueError: unknown benches, budget or context.
    """
    spec, benches = load_scenario(scenario), current_name(benches)
    most = plan_budget(budget)
    known = all_contexts(spec)
    chosen = known if contexts is None else list(dict.fromkeys(contexts))
    strange = [context for context in chosen if context not in known]
    if strange or not chosen:
        given = ", ".join(strange[0]) if strange else "none"
        raise ValueError(
            f"context: {spec.name} has {spec.orders} orders for {', '.join(spec.lab_goals)}; given {given}"
        )
    if most < len(chosen):
        raise ValueError(f"budget: at least one plan for each of {len(chosen)} contexts, given {most}")
    found: list[FoundPlan] = []
    left = most
    for i, context in enumerate(chosen):
        # The others begin with what has been found for the first.
        share = left // 2 if i == 0 and len(chosen) > 1 else left // (len(chosen) - i)
        own = np.random.SeedSequence([seed, known.index(context)])
        search = _Search(spec, benches, context, max(share, 1), own, watch or (lambda _: None), without)
        found.append(search.run([_translated(spec, one.plan, one.context, context) for one in found]))
        left -= search.tried
    return PlanSearch(spec, benches, found, most - left)


def best_in_episode(
    scenario: Scenario, seed: int, split: str, budget: int, known: Mapping[Context, Plan], benches: str = "scripted"
) -> tuple[float, list[tuple[int, float]]]:
    """The best plan of the manager that a search finds for one episode, which it may play as often as it likes.

    Args:
        scenario: where.
        seed: of the episode.
        split: its world's, of a scenario that draws some.
        budget: most plans tried.
        known: plans to begin with, besides what scripted managers do there, by context.
        benches: who operates them.

    Returns:
        Its score, and [(plans tried, best score so far)].
    """
    labs = Laboratories(scenario, 1, split=split)
    labs.seed(0, np.random.SeedSequence(seed))
    labs.reset(labs.members)
    context = tuple(scenario.goals[goal] for goal in labs.state.goal[0].tolist())
    own = np.random.SeedSequence([seed, budget])
    search = _Search(scenario, benches, context, budget, own, lambda _: None, (), [seed], split)
    score = search.improve([known[context]] if context in known else [])
    return score, search.curve


# -- replaying --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Replayed:
    """Blind replay beside the policies that were replayed, on the same seeds.

    Attributes:
        blind: the score of the best donor's actions, played again from every seed.
        seeing: the score of the policies that look.
        donors: seed of the best donor's episode, by context.
        scores: [episodes] of the blind ones.
    """

    blind: Estimate
    seeing: Estimate
    donors: dict[Context, int]
    scores: FloatArray


class _Tape:
    """Plays as another policy does, and keeps its actions.

    Args:
        policy: the other one.
        members: of the batch.

    Attributes:
        tapes: by member, of each of its experiments (the manager: of its episode), the actions.
    """

    def __init__(self, policy: Any, members: IntArray) -> None:
        self._policy = policy
        self.tapes: list[list[list[Any]]] = [[] for _ in members]

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        actions: npt.NDArray[Any] = self._policy.act(observation, mask, step, members)
        for member, turn, action in zip(members.tolist(), step.tolist(), actions.tolist(), strict=True):
            if turn == 0:
                self.tapes[member].append([])
            self.tapes[member][-1].append(action)
        return actions


class _Replay:
    """A bench's agent that plays a tape whatever it sees: in its n-th experiment what was played in the n-th.

    Where the tape has no more, or what it has is not legal, it ends the experiment; with continuous actions it goes on
    with the last one.

    Args:
        tapes: by member, see :class:`_Tape`.
        end: the action that ends an experiment.
        size: numbers of a continuous action, 0 where actions are discrete.
    """

    def __init__(self, tapes: Sequence[list[list[Any]]], end: int, size: int) -> None:
        self._tapes, self._end, self._size = tapes, end, size
        self._experiment = [-1] * len(tapes)

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        actions = []
        for i, (member, turn) in enumerate(zip(members.tolist(), step.tolist(), strict=True)):
            self._experiment[member] += turn == 0
            experiments = self._tapes[member]
            number = self._experiment[member]
            tape = experiments[number] if number < len(experiments) else []
            if mask is None:
                actions.append(tape[min(turn, len(tape) - 1)] if tape else [0.0] * self._size)
                continue
            action = tape[turn] if turn < len(tape) else self._end
            if not mask[i, action]:
                action = self._end if mask[i, self._end] else int(mask[i].argmax())
            actions.append(action)
        return np.array(actions, dtype=np.int64 if mask is not None else np.float64)


def replay_actions(
    scenario: str | Scenario,
    policy: str | PlanSearch = "scripted",
    donors: int = 20,
    episodes: int = 100,
    seed: int = 0,
    watch: Callable[[int], None] | None = None,
    split: str = "train",
) -> Replayed:
    """Play again, without looking, what all agents did in one episode: for each public context the best of some donors.

    The manager plays its actions as a constant plan does. Donors play seeds of their own and are chosen on others
    again; both blind and seeing agents are then scored on ``episodes`` further seeds. With ``plan`` for the policy, the
    donors' manager is blind already: a constant plan of everybody.

    Args:
        scenario: where.
        policy: who is replayed, see :func:`~chemlab.agents.policies.make_policies`; or found plans, with their benches.
        donors: episodes to choose from, for each context.
        episodes: episode i has seed + i and the goals that it draws.
        seed: of the first.
        watch: called with the number of episodes just played.
        split: worlds of the episodes that are scored, where the scenario draws any; donors are from train.

    Raises:
        ValueError: unknown policy, or fewer than one donor or episode.
    """
    spec = load_scenario(scenario)
    if donors < 1 or episodes < 1:
        raise ValueError(f"replay: needs at least one donor and one episode, given {donors} and {episodes}")
    told = watch or (lambda _: None)
    labs = Laboratories(spec, episodes, split=split)
    seeing = play_laboratory(labs, _players(policy, labs, seed), None, seed).returns
    contexts = [tuple(spec.goals[goal] for goal in row) for row in labs.state.goal.tolist()]
    told(episodes)
    blind, best = np.empty(episodes), {}
    for context in dict.fromkeys(contexts):
        own = [i for i, other in enumerate(contexts) if other == context]
        trials = _Trials(spec, context, range(SEARCH_SEED, SEARCH_SEED + donors), 1)
        tapes = _record(trials, policy)
        choice = _Trials(spec, context, range(SEARCH_SEED + donors, SEARCH_SEED + donors + SEEDS), donors)
        chosen = int(
            _replay(choice, [[tape[donor] for tape in tapes] for donor in range(donors)]).mean(axis=1).argmax()
        )
        final = _Trials(spec, context, [seed + i for i in own], 1, split)
        blind[own] = _replay(final, [[tape[chosen] for tape in tapes]])[0]
        best[context] = SEARCH_SEED + chosen
        told(donors * (1 + SEEDS) + len(own))
    return Replayed(statistics.mean([blind]), statistics.mean([seeing]), best, blind)


def _players(policy: str | PlanSearch, labs: Laboratories, seed: int | None = None) -> dict[str, Policy]:
    return make_policies(policy, labs, seed) if isinstance(policy, str) else policy.policies(labs, seed)


def _record(trials: _Trials, policy: str | PlanSearch) -> list[list[list[list[Any]]]]:
    """[agents][members] tapes of one episode from each of the trials' seeds."""
    policies = list(_players(policy, trials.labs).values())
    trials.seed_policies(policies)
    taped = [_Tape(each, trials.labs.members) for each in policies]
    trials.play(taped, 1)
    return [each.tapes for each in taped]


def _replay(trials: _Trials, tapes: Sequence[Sequence[list[list[Any]]]]) -> FloatArray:
    """[len(tapes), seeds] scores of tapes, each given by agent, played again from every seed of the trials."""
    labs = trials.labs
    of_member = [tape for tape in tapes for _ in trials.seeds]
    policies: list[Policy] = [Playback(labs.actions, [tuple(tape[0][0]) for tape in of_member])]
    for number, bench in enumerate(labs.benches, start=1):
        size = 0 if bench.action_count else int(labs.action_space(number).shape[0])  # type: ignore[index]
        policies.append(_Replay([tape[number] for tape in of_member], bench.end_action, size))
    return trials.play(policies, len(tapes))
