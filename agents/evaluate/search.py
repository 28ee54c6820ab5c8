"""The search for open-loop policies.

:func:`search_plan` searches for fixed sequences of manager actions over benches that a policy operates, or (``free``)
for fixed sequences of every agent. :func:`best_in_episode` searches for the best sequence of one episode, whose hidden
parameters are then no secret.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

import numpy as np

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Actions, Policy
from chemlab.kernels.arrays import BoolArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.manager_actions import ManagerActions

from ..former_names import current_name
from ..open_loop import Context, Plan, Playback, all_contexts
from ..policies import make_policies
from .moves import Moves, Tried
from .plans import (
    SEARCH_SEED,
    SEEDS,
    FoundPlan,
    PlanSearch,
    TapeRecorder,
    TeamPlan,
    Trials,
    drawn_contexts,
    recorded_tapes,
    tape_of,
)

NOISE = 0.02
"""Standard deviation of good plans' scores over seeds below which one seed selects promising plans."""

_POPULATION, _CHILDREN, _FIRST = 32, 128, 256
_EPISODES = 1024
"""Most episodes played at once; results do not depend on it."""
_ISLANDS, _PATIENCE = 3, 6
_SAME = 1e-9
_BUNDLED = ("pretrained", "trained")
_PROMISING, _FINALISTS = 4, 16
_FEW_FINAL_SEEDS, _MOST_FINAL_SEEDS = 64, 1000


def scripted_names(scenario: Scenario) -> list[str]:
    """Return the scripted policies that differ in a scenario."""
    extracts = any(bench.kind == "extraction" for bench in scenario.benches.values())
    return ["scripted", "scripted:unsafe", *(["scripted:no-extraction"] if extracts else [])]


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

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
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


_Prepared = tuple[Trials, dict[str, Policy]]
"""Laboratories, and who plays there."""


class Search:
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
        free: whether the benches' agents play tapes, too.
        opening: played before every plan. A bench that has no tape there has none in any plan.

    Attributes:
        tried: number of plans.
        best: the best plans, the best first.
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
        free: bool = False,
        opening: TeamPlan | None = None,
    ) -> None:
        self._opening = opening or TeamPlan(())
        self._scenario, self._benches, self._context, self._watch = scenario, benches, context, watch
        self._budget, self.tried = budget, 0
        self._actions = ManagerActions.of(scenario)
        self._seen: set[TeamPlan] = set()
        self.best: list[Tried] = []
        self.curve: list[tuple[int, float]] = []
        self._split, self._first_seed = split, seeds[0]
        self._several = self._prepared(seeds)
        self._one = self._prepared(seeds[:1]) if len(seeds) > 1 else self._several
        taped = self._one[0].labs.benches if free else ()
        self._moves = Moves(self._actions, context, np.random.default_rng(seed), without, taped)

    def _prepared(self, seeds: Sequence[int]) -> _Prepared:
        """Laboratories for these seeds, and who plays there; the manager's place is the plans'."""
        most = min(max(_EPISODES // len(seeds), 1), _FIRST)
        trials = Trials(self._scenario, self._context, seeds, most, self._split)
        return trials, make_policies(self._benches, trials.labs)

    def _play(self, prepared: _Prepared, teams: Sequence[TeamPlan]) -> list[Tried]:
        trials, policies = prepared
        found = []
        for first in range(0, len(teams), trials.most):
            some = teams[first : first + trials.most]
            seeds = len(trials.seeds)
            whole = [team.after(self._opening) for team in some]
            recording = _Recording(self._actions, [team.plan for team in whole for _ in range(seeds)])
            scores = trials.play_teams(whole, policies, recording)
            for i, (team, score) in enumerate(zip(some, scores, strict=True)):
                plan, opened = whole[i].plan, len(self._opening.plan)
                rows = slice(i * seeds, (i + 1) * seeds)
                kept = opened + np.flatnonzero(recording.played[rows, opened:].any(axis=0))
                after = recording.after[i * seeds]
                at = np.append(kept, np.full(len(after), len(plan), dtype=np.int64))
                played = (*(plan[k] for k in kept), *after)
                legal = np.asarray(recording.legal[rows].any(axis=0))[at]
                found.append(Tried(float(score.mean()), float(score.std()), TeamPlan(played, team.benches), legal))
        return found

    def _try(self, teams: Iterable[TeamPlan]) -> list[Tried]:
        """Those of the plans that are new, tried, as far as the budget goes; the best are remembered.

        Where noise is small, what does not look promising from one seed is not played from several.
        """
        fresh = [team for team in dict.fromkeys(teams) if team not in self._seen][: self._budget - self.tried]
        if not fresh:
            return []
        noisy = self.best and np.median([tried.deviation for tried in self.best]) >= NOISE
        if noisy or len(self._several[0].seeds) == 1:
            found = sure = self._play(self._several, fresh)
        else:
            found = self._play(self._one, fresh)
            bar = self.best[-1].score if len(self.best) == _FINALISTS else -np.inf
            order = sorted(range(len(found)), key=lambda i: -found[i].score)
            promising = [i for i in order[:_PROMISING] if found[i].score > bar]
            sure = self._play(self._several, [fresh[i] for i in promising])
            for i, tried in zip(promising, sure, strict=True):
                found[i] = tried
        self._seen.update(fresh)
        self._seen.update(tried.team for tried in found)
        self.tried += len(fresh)
        self._watch(len(fresh))
        self.best = _ranked([*self.best, *sure], _FINALISTS)
        self.curve.append((self.tried, self.best[0].score))
        return found

    def _random(self, count: int) -> list[TeamPlan]:
        """Return the plans of random legal play in as many episodes of the first seed; with constant benches, too."""
        plans: list[Plan] = []
        trials, policies = self._prepared([self._first_seed])
        while len(plans) < count:
            taped = TapeRecorder(self._moves, trials.labs.members)
            trials.seed_policies([policies[agent] for agent in trials.labs.agents[1:]])
            trials.play([taped, *(policies[agent] for agent in trials.labs.agents[1:])], trials.most)
            plans += [tuple(tape[0][: self._moves.longest]) for tape in taped.tapes]
        return [TeamPlan(plan, self._moves.constant()) for plan in plans]

    def _donors(self, names: Sequence[str], scenario: Scenario | None = None) -> list[TeamPlan]:
        """Return what policies play in the first seed's episode, over the search's benches: without measurements,
        and then with all their own actions, benches included, where these may be free.

        Args:
            names: of policies; names that do not fit are omitted.
            scenario: where they play; default: where is searched.
        """
        teams = []
        trials = Trials(scenario or self._scenario, self._context, [self._first_seed], 1, self._split)
        for name in names:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # of policies trained in another version
                    policies = make_policies(name, trials.labs)
            except ValueError:
                continue
            if not self._moves.free:
                policies = {**make_policies(self._benches, trials.labs), MANAGER_AGENT: policies[MANAGER_AGENT]}
            manager, *benches = [tapes[0] for tapes in recorded_tapes(trials, policies)]
            plan, tapes = tuple(manager[0]), tuple(map(tape_of, benches))
            blind = tuple(action for action in plan if self._moves.useful[action])
            teams.append(TeamPlan(blind))
            if self._moves.free:
                teams += [TeamPlan(plan, tapes), TeamPlan(blind, tapes)]
        return teams

    def improve(self, known: Sequence[TeamPlan], donors: bool = True) -> float:
        """Return the best score on the episodes themselves: the score of a planner with the hidden parameters.

        Args:
            known: plans to begin with.
            donors: whether it also begins with what scripted and bundled policies play there. ``scripted`` also plays
                with the parameters revealed: with exact instruments, free of charge.
        """
        beginning = list(known)
        if donors:
            beginning += self._donors([*scripted_names(self._scenario), *_BUNDLED])
            beginning += self._donors(["scripted"], _revealed(self._scenario))
        self._try(beginning)
        best = -np.inf
        while self.tried < self._budget and self.best[0].score > best + _SAME:
            best = self.best[0].score
            self._evolve(self.best, self._budget)
        return self.best[0].score

    def run(self, known: Sequence[TeamPlan]) -> FoundPlan:
        """Search; ``known`` are plans to begin with."""
        beginning = [*known, *self._donors(scripted_names(self._scenario))]
        islands, best = (1 if known else _ISLANDS), -np.inf
        while self.tried < self._budget:
            for _ in range(islands):
                first = self._try([*beginning, *self._random(_FIRST)])
                beginning = []
                self._evolve(first, self._budget // (2 * islands))
            self._evolve(self.best, self._budget)
            if self.best[0].score <= best + _SAME:
                break
            best = self.best[0].score
        return self._final()

    def _evolve(self, population: Sequence[Tried], most: int) -> None:
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
        """Return the best of the finalists on other seeds; a plan of the manager without what it does not need."""
        noisy = max(tried.deviation for tried in self.best) > _SAME
        count = min(max(_FEW_FINAL_SEEDS, self._budget // 10), _MOST_FINAL_SEEDS) if noisy else _FEW_FINAL_SEEDS
        first = SEARCH_SEED + SEEDS
        final = self._prepared(range(first, first + count))
        whole = _ranked(self._play(final, [tried.team for tried in self.best]), 1)[0]
        if self._moves.free:
            return FoundPlan(self._context, whole.team, whole.score)
        few = final if count == _FEW_FINAL_SEEDS else self._prepared(range(first, first + _FEW_FINAL_SEEDS))
        best = whole if few is final else self._play(few, [whole.team])[0]
        while True:
            plan = best.team.plan
            shorter = [TeamPlan(plan[:i] + plan[i + 1 :], best.team.benches) for i in range(len(plan))]
            # What is left out may come back when a plan has come to its end.
            played = [tried for tried in self._play(few, shorter) if len(tried.team.plan) < len(plan)]
            better = _ranked([tried for tried in played if tried.score >= best.score - _SAME], 1)
            if not better:
                break
            best = better[0]
        best = best if few is final else self._play(final, [best.team])[0]
        best = best if best.score >= whole.score - _SAME else whole
        return FoundPlan(self._context, TeamPlan(best.team.plan), best.score)


def _revealed(scenario: Scenario) -> Scenario:
    """Return the scenario with exact instruments that cost nothing."""
    exact = {"price": 0.0, "noise": 0.0}
    instruments = {
        name: spec.model_copy(update={key: value for key, value in exact.items() if hasattr(spec, key)})
        for name, spec in scenario.instruments.items()
    }
    return scenario.model_copy(update={"instruments": instruments})


def _ranked(tried: Sequence[Tried], most: int) -> list[Tried]:
    """The best, one of each score, the shortest first: plans of equal score do the same but for names."""
    ordered = sorted(tried, key=lambda one: (-round(one.score, 9), len(one.team.plan), one.team.plan))
    kept: dict[float, Tried] = {}
    for one in ordered:
        kept.setdefault(round(one.score, 9), one)
        if len(kept) == most:
            break
    return list(kept.values())


def _translated(scenario: Scenario, team: TeamPlan, source: Context, target: Context) -> TeamPlan:
    """A plan for another context: what was started for an order's goal is started for the goal it has there."""
    actions, goals = ManagerActions.of(scenario), dict(zip(reversed(source), reversed(target), strict=True))
    translated = []
    for action in team.plan:
        kind, *arguments = actions.decode(action)
        if kind == "start":
            arguments[2] = goals.get(str(arguments[2]), arguments[2])
        translated.append(actions.encode(str(kind), *arguments))
    return TeamPlan(tuple(translated), team.benches)


def search_plan(
    scenario: str | Scenario,
    benches: str = "scripted",
    budget: int = 10_000,
    seed: int = 0,
    contexts: Sequence[Context] | None = None,
    watch: Callable[[int], None] | None = None,
    without: Collection[str] = (),
    free: bool = False,
) -> PlanSearch:
    """Find the best open-loop policy of the manager, or of all agents, for every public context.

    An evolutionary search over sequences of actions, with every single change of the best tried where it stalls.
    A plan does not depend on observations (:class:`~chemlab.agents.open_loop.Playback`). It has no measurements, which
    cost something and do not change what follows. The result depends on the arguments alone. The last 16 plans are
    compared on a tenth as many further seeds as plans were allowed: at least 64, at most 1,000.

    Args:
        scenario: where.
        benches: who operates them, see :func:`~chemlab.agents.policies.make_policies`.
        budget: most plans tried; the first context gets half of it. A search ends sooner when new beginnings from
            random plans have found nothing better.
        seed: of the search.
        contexts: default: all that the scenario may draw.
        watch: called with the number of plans just tried.
        without: benches that plans do without, by key.
        free: whether the benches' agents play fixed sequences, too: constant actions first, then what the search makes
            of these and of recorded episodes. A bench may also stay with its policy.

    Raises:
        ValueError: unknown benches, budget or context.
    """
    spec, benches = load_scenario(scenario), current_name(benches)
    known = all_contexts(spec)
    chosen = known if contexts is None else list(dict.fromkeys(contexts))
    strange = [context for context in chosen if context not in known]
    if strange or not chosen:
        given = ", ".join(strange[0]) if strange else "none"
        raise ValueError(
            f"context: {spec.name} has {spec.orders} orders for {', '.join(spec.lab_goals)}; given {given}"
        )
    if budget < len(chosen):
        raise ValueError(f"budget: at least one plan for each of {len(chosen)} contexts, given {budget}")
    found: list[FoundPlan] = []
    left = budget
    for i, context in enumerate(chosen):
        # The others begin with what has been found for the first.
        share = left // 2 if i == 0 and len(chosen) > 1 else left // (len(chosen) - i)
        own = np.random.SeedSequence([seed, known.index(context)])
        search = Search(spec, benches, context, max(share, 1), own, watch or (lambda _: None), without, free=free)
        found.append(search.run([_translated(spec, one.team, one.context, context) for one in found]))
        left -= search.tried
    return PlanSearch(spec, benches, found, budget - left)


def best_in_episode(
    scenario: Scenario, seed: int, split: str, budget: int, known: Mapping[Context, Sequence[TeamPlan]] | None = None
) -> tuple[float, list[tuple[int, float]]]:
    """Find the best open-loop policy of one episode, which the search may play as often as it likes.

    Args:
        scenario: where.
        seed: of the episode.
        split: its world's, of a scenario that draws some.
        budget: most plans tried.
        known: plans to begin with, by context, besides what scripted and bundled policies play there.

    Returns:
        Its score, and [(plans tried, best score so far)].
    """
    labs = Laboratories(scenario, 1, split=split)
    (context,) = drawn_contexts(labs, seed)
    own = np.random.SeedSequence([seed, budget])
    search = Search(scenario, "scripted", context, budget, own, lambda _: None, (), [seed], split, free=True)
    score = search.improve((known or {}).get(context, ()))
    return score, search.curve
