"""Search for open-loop policies.

:func:`search_plan` searches for fixed sequences of manager actions over benches with a policy, or (``free``) for fixed
sequences of all agents' actions. :func:`best_in_episode` searches for the best sequences of one episode, as a planner
that knows its hidden parameters.
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
from ..scripted.belief import noiseless
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

_NOISE = 0.02
"""Standard deviation of good plans' scores over seeds, below which promising plans are selected on one seed."""
_POPULATION, _CHILDREN, _FIRST = 32, 128, 256
"""Sizes of a population, of a generation of mutations, and of a random beginning."""
_EPISODES = 1024
"""Maximum number of concurrent episodes; results do not depend on it."""
_ISLANDS, _PATIENCE = 3, 6
"""Number of random beginnings, and of generations without improvement before all single changes are tried."""
_SAME = 1e-9
"""Scores that differ by at most this are equal."""
_BUNDLED = ("pretrained", "trained")
_PROMISING, _FINALISTS = 4, 16
"""Number of plans that are tried on all seeds after a generation on one seed, and number of remembered plans."""
_FEW_FINAL_SEEDS, _MOST_FINAL_SEEDS = 64, 1000


def scripted_names(scenario: Scenario) -> list[str]:
    """Return the names of the scripted policies that differ in a scenario."""
    extracts = any(bench.kind == "extraction" for bench in scenario.benches.values())
    return ["scripted", "scripted:unsafe", *(["scripted:no-extraction"] if extracts else [])]


class _Recording(Playback):
    """Plays plans, and records played and legal actions.

    Attributes:
        played: [P, L] True for the actions of each sequence that were played.
        legal: [P, L, A] True for actions that were legal at an action, or while the manager waited for it.
        after: actions after the end of each sequence, except waiting.
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
        # Waiting for the next action is not part of the plan, even if the previous action of the plan was to wait.
        planned = (position > 0) & (actions == self._steps[members, last]) & ~self.played[members, last]
        at = np.where(planned, last, position)
        self.legal[members, at] |= mask != 0
        self.played[members[planned], at[planned]] = True
        for i in np.flatnonzero(~planned & (actions != self._wait)):
            self.after[members[i]].append(int(actions[i]))
        return actions


_Prepared = tuple[Trials, dict[str, Policy]]
"""Laboratories for some seeds, and the policies of their agents."""


class Search:
    """Evolutionary search for one public context.

    Populations evolve from several random beginnings (the first one contains plans of scripted managers as well), and
    then from the best plans of all. If mutations bring no improvement, all single changes of the best plan are tried.

    Args:
        scenario: the scenario.
        benches: policy of the benches.
        context: the goals of the orders.
        budget: maximum number of plans tried.
        seed: seed of the random generator.
        watch: called with the number of plans just tried.
        without: benches that are not used, by key.
        seeds: seeds of the episodes in which plans are tried.
        split: split of their worlds, if the scenario has hidden parameters.
        free: True if the benches' agents play tapes as well.
        opening: policy played before every plan. Benches without a tape in the opening have no tape at all.

    Attributes:
        tried: number of plans tried.
        best: the best plans, in descending order of their scores.
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
        """Return laboratories for some seeds, and the policies there; the manager's policy is replaced by plans."""
        most = min(max(_EPISODES // len(seeds), 1), _FIRST)
        trials = Trials(self._scenario, self._context, seeds, most, self._split)
        return trials, make_policies(self._benches, trials.labs)

    def _play(self, prepared: _Prepared, teams: Sequence[TeamPlan]) -> list[Tried]:
        """Play plans on all seeds of the laboratories."""
        trials, policies = prepared
        found, seeds, opened = [], len(trials.seeds), len(self._opening.plan)
        for first in range(0, len(teams), trials.most):
            batch = teams[first : first + trials.most]
            complete = [team.after(self._opening) for team in batch]
            recording = _Recording(self._actions, [team.plan for team in complete for _ in range(seeds)])
            scores = trials.play_teams(complete, policies, recording)
            for i, (team, score) in enumerate(zip(batch, scores, strict=True)):
                plan, rows = complete[i].plan, slice(i * seeds, (i + 1) * seeds)
                kept = opened + np.flatnonzero(recording.played[rows, opened:].any(axis=0))
                after = recording.after[i * seeds]
                at = np.append(kept, np.full(len(after), len(plan), dtype=np.int64))
                played = (*(plan[k] for k in kept), *after)
                legal = np.asarray(recording.legal[rows].any(axis=0))[at]
                found.append(Tried(float(score.mean()), float(score.std()), TeamPlan(played, team.benches), legal))
        return found

    def _try(self, teams: Iterable[TeamPlan]) -> list[Tried]:
        """Try the new plans within the budget, and remember the best.

        If noise is small, plans are tried on one seed, and only promising ones on all seeds.
        """
        new = [team for team in dict.fromkeys(teams) if team not in self._seen][: self._budget - self.tried]
        if not new:
            return []
        noisy = self.best and np.median([tried.deviation for tried in self.best]) >= _NOISE
        if noisy or len(self._several[0].seeds) == 1:
            found = on_all_seeds = self._play(self._several, new)
        else:
            found = self._play(self._one, new)
            bar = self.best[-1].score if len(self.best) == _FINALISTS else -np.inf
            order = sorted(range(len(found)), key=lambda i: -found[i].score)
            promising = [i for i in order[:_PROMISING] if found[i].score > bar]
            on_all_seeds = self._play(self._several, [new[i] for i in promising])
            for i, tried in zip(promising, on_all_seeds, strict=True):
                found[i] = tried
        self._seen.update(new)
        self._seen.update(tried.team for tried in found)
        self.tried += len(new)
        self._watch(len(new))
        self.best = _ranked([*self.best, *on_all_seeds], _FINALISTS)
        self.curve.append((self.tried, self.best[0].score))
        return found

    def _random(self, count: int) -> list[TeamPlan]:
        """Return at least ``count`` plans of random legal play on the first seed, with constant tapes of benches."""
        plans: list[Plan] = []
        trials, policies = self._prepared([self._first_seed])
        while len(plans) < count:
            manager = TapeRecorder(self._moves, trials.labs.members)
            benches = [policies[agent] for agent in trials.labs.bench_agents]
            trials.seed_policies(benches)
            trials.play([manager, *benches], trials.most)
            plans += [tuple(tape[0][: self._moves.longest]) for tape in manager.tapes]
        return [TeamPlan(plan, self._moves.constant()) for plan in plans]

    def _donors(self, names: Sequence[str], scenario: Scenario | None = None) -> list[TeamPlan]:
        """Return the plans of policies in the episode of the first seed, without measurements.

        The benches' policy is that of the search. If benches are free, it is the policy itself, and its plans with the
        actions of benches, with and without measurements, are returned as well.

        Args:
            names: names of policies; policies that do not fit are omitted.
            scenario: scenario in which they play; default: that of the search.
        """
        teams = []
        trials = Trials(scenario or self._scenario, self._context, [self._first_seed], 1, self._split)
        for name in names:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # the scenario may have changed since training
                    policies = make_policies(name, trials.labs)
            except ValueError:
                continue
            if not self._moves.free:
                policies = {**make_policies(self._benches, trials.labs), MANAGER_AGENT: policies[MANAGER_AGENT]}
            manager, *benches = [tapes[0] for tapes in recorded_tapes(trials, policies)]
            plan, tapes = tuple(manager[0]), tuple(map(tape_of, benches))
            without_measurements = tuple(action for action in plan if self._moves.useful[action])
            teams.append(TeamPlan(without_measurements))
            if self._moves.free:
                teams += [TeamPlan(plan, tapes), TeamPlan(without_measurements, tapes)]
        return teams

    def improve(self, known: Sequence[TeamPlan], donors: bool = True) -> float:
        """Search, and return the best score on the search's own episodes, as of a planner with the hidden parameters.

        Args:
            known: initial plans.
            donors: True to add initial plans of scripted and bundled policies, also of ``scripted`` with exact
                instruments free of charge.
        """
        initial = list(known)
        if donors:
            initial += self._donors([*scripted_names(self._scenario), *_BUNDLED])
            initial += self._donors(["scripted"], noiseless(self._scenario, price=0.0))
        self._try(initial)
        best = -np.inf
        while self.tried < self._budget and self.best[0].score > best + _SAME:
            best = self.best[0].score
            self._evolve(self.best, self._budget)
        return self.best[0].score

    def run(self, known: Sequence[TeamPlan]) -> FoundPlan:
        """Search, and return the best plan on other episodes; ``known`` are initial plans."""
        initial = [*known, *self._donors(scripted_names(self._scenario))]
        islands, best = (1 if known else _ISLANDS), -np.inf
        while self.tried < self._budget:
            for _ in range(islands):
                first = self._try([*initial, *self._random(_FIRST)])
                initial = []
                self._evolve(first, self._budget // (2 * islands))
            self._evolve(self.best, self._budget)
            if self.best[0].score <= best + _SAME:
                break
            best = self.best[0].score
        return self._final()

    def _evolve(self, population: Sequence[Tried], most: int) -> None:
        """Evolve a population until it does not improve any more, or ``most`` plans have been tried."""
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
        """Return the best of the finalists on other seeds; unnecessary actions are removed from a manager's plan."""
        noisy = max(tried.deviation for tried in self.best) > _SAME
        count = min(max(_FEW_FINAL_SEEDS, self._budget // 10), _MOST_FINAL_SEEDS) if noisy else _FEW_FINAL_SEEDS
        first = SEARCH_SEED + SEEDS
        final = self._prepared(range(first, first + count))
        complete = _ranked(self._play(final, [tried.team for tried in self.best]), 1)[0]
        if self._moves.free:
            return FoundPlan(self._context, complete.team, complete.score)
        few = final if count == _FEW_FINAL_SEEDS else self._prepared(range(first, first + _FEW_FINAL_SEEDS))
        best = complete if few is final else self._play(few, [complete.team])[0]
        while True:
            plan = best.team.plan
            shorter = [TeamPlan(plan[:i] + plan[i + 1 :], best.team.benches) for i in range(len(plan))]
            # A removed action may be played after the end of the plan.
            played = [tried for tried in self._play(few, shorter) if len(tried.team.plan) < len(plan)]
            better = _ranked([tried for tried in played if tried.score >= best.score - _SAME], 1)
            if not better:
                break
            best = better[0]
        best = best if few is final else self._play(final, [best.team])[0]
        best = best if best.score >= complete.score - _SAME else complete
        return FoundPlan(self._context, TeamPlan(best.team.plan), best.score)


def _ranked(tried: Sequence[Tried], most: int) -> list[Tried]:
    """Return the best plans, one of each score: of equal scores the shortest, because they hardly differ."""
    ordered = sorted(tried, key=lambda one: (-round(one.score, 9), len(one.team.plan), one.team.plan))
    kept: dict[float, Tried] = {}
    for one in ordered:
        kept.setdefault(round(one.score, 9), one)
        if len(kept) == most:
            break
    return list(kept.values())


def _translated(scenario: Scenario, team: TeamPlan, source: Context, target: Context) -> TeamPlan:
    """Return a plan for another context, with the goal of each start replaced by the same order's goal there."""
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
    """Search for the best open-loop policy of the manager, or of all agents, for every public context.

    The search is evolutionary (:class:`Search`), and its result depends only on the arguments. A plan does not depend
    on observations (:class:`~chemlab.agents.open_loop.Playback`). It has no measurements, which cost something and
    change nothing else. The last 16 plans are compared on further seeds: a tenth of the budget, at least 64 and at
    most 1,000.

    Args:
        scenario: the scenario.
        benches: policy of the benches, see :func:`~chemlab.agents.policies.make_policies`.
        budget: maximum number of plans tried; the first context gets half of it. A search ends earlier if further
            random beginnings bring no improvement.
        seed: seed of the search.
        contexts: contexts to search for; default: all that the scenario may draw.
        watch: called with the number of plans just tried.
        without: benches that are not used, by key.
        free: True if the benches' agents play fixed sequences as well: constant actions, recorded episodes, and
            mutations of them. A bench may also keep its policy.

    Raises:
        ValueError: the benches or a context are unknown, or the budget is too small.
    """
    spec, benches = load_scenario(scenario), current_name(benches)
    known = all_contexts(spec)
    chosen = known if contexts is None else list(dict.fromkeys(contexts))
    unknown = [context for context in chosen if context not in known]
    if unknown or not chosen:
        given = ", ".join(unknown[0]) if unknown else "none"
        raise ValueError(
            f"context: {spec.name} has {spec.orders} orders for {', '.join(spec.lab_goals)}; given {given}"
        )
    if budget < len(chosen):
        raise ValueError(f"budget: at least one plan for each of {len(chosen)} contexts, given {budget}")
    found: list[FoundPlan] = []
    left = budget
    for i, context in enumerate(chosen):
        # Later contexts begin with the plans of earlier ones.
        share = left // 2 if i == 0 and len(chosen) > 1 else left // (len(chosen) - i)
        seeds = np.random.SeedSequence([seed, known.index(context)])
        search = Search(spec, benches, context, max(share, 1), seeds, watch or (lambda _: None), without, free=free)
        found.append(search.run([_translated(spec, one.team, one.context, context) for one in found]))
        left -= search.tried
    return PlanSearch(spec, benches, found, budget - left)


def best_in_episode(
    scenario: Scenario, seed: int, split: str, budget: int, known: Mapping[Context, Sequence[TeamPlan]] | None = None
) -> tuple[float, list[tuple[int, float]]]:
    """Search for the best open-loop policy of one episode, which is replayed for every plan.

    Args:
        scenario: the scenario.
        seed: seed of the episode.
        split: split of its world, if the scenario has hidden parameters.
        budget: maximum number of plans tried.
        known: initial plans by context, in addition to those of scripted and bundled policies.

    Returns:
        The best score, and [(plans tried, best score so far)].
    """
    (context,) = drawn_contexts(Laboratories(scenario, 1, split=split), seed)
    seeds = np.random.SeedSequence([seed, budget])
    search = Search(scenario, "scripted", context, budget, seeds, lambda _: None, (), [seed], split, free=True)
    score = search.improve((known or {}).get(context, ()))
    return score, search.curve
