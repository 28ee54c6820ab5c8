"""Open-loop policies: fixed action sequences found by a search, and episodes replayed from other seeds.

:func:`search_plan` searches for fixed sequences of manager actions over benches that a policy operates, or (``free``)
for fixed sequences of every agent. :func:`replay_actions` replays the actions of all agents in a donor's episode.
:func:`best_in_episode` searches for the best sequence of one episode, whose hidden parameters are then no secret.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Players, Policy
from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import MANAGER_AGENT, Laboratories
from chemlab.roles.bench import Bench
from chemlab.roles.manager_actions import DISCARD, MEASURE, RECALL, REPAIR, START, SUBMIT, WAIT, ManagerActions

from ..episodes import play_laboratory
from ..former_names import current_name
from ..open_loop import ConstantPlan, Context, Plan, PlanFile, Playback, all_contexts
from ..policies import make_policies
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
    "Search",
    "Tape",
    "TeamPlan",
    "Trials",
    "best_in_episode",
    "drawn_contexts",
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

_LONGEST, _LONGEST_FREE = 12, 48
"""Most actions for each order, of the manager alone and of all agents."""
_POPULATION, _CHILDREN, _FIRST = 32, 128, 256
_ISLANDS, _PATIENCE = 3, 6
_SAME = 1e-9
_OWN_GOAL = 4.0
"""Relative probability of starting an experiment for an order's goal rather than for another."""
_SCRIPTED = ("scripted", "scripted:no-extraction", "scripted:unsafe")
_BUNDLED = ("pretrained", "trained")
_PROMISING, _FINALISTS = 4, 16
_FEW_FINAL_SEEDS, _MOST_FINAL_SEEDS = 64, 1000
_LEVELS = (0.0, 0.5, 1.0)
"""Constant values of an actuator; 0.5 leaves a temperature or a piston as it is, 0 adds nothing of a reagent."""
_FINER = (0.0, 0.25, 0.5, 0.75, 1.0)
_LONGEST_TAPE, _MOST_EXPERIMENTS, _NEAR = 64, 8, 256
_TAPED, _REPEATED = 0.4, 0.2
"""Shares of the changes of a plan of all agents that change a bench's tape, or repeat some actions of the manager."""
# Chances with which a random plan does something next, where it is possible.
_CHANCES = {START: 6.0, MEASURE: 0.0, DISCARD: 1.0, SUBMIT: 1.5, RECALL: 0.3, WAIT: 3.0, REPAIR: 0.5}


Tape = tuple[tuple[Any, ...] | None, ...]
"""Open-loop policy of a bench's agent: the actions of each of its experiments, integers or tuples of numbers.

The last action of an experiment and the last experiment are repeated. None: a policy plays the experiment.
"""


@dataclass(frozen=True)
class TeamPlan:
    """Open-loop policy of all agents.

    Attributes:
        plan: actions of the manager.
        benches: tape of the agent of each bench; None where a policy plays. Empty: a policy plays all of them.
    """

    plan: Plan
    benches: tuple[Tape | None, ...] = ()

    def after(self, opening: TeamPlan) -> TeamPlan:
        """Return the policy that plays an opening first; a bench without a tape there has none at all."""
        if not opening.plan:
            return self
        pairs = zip(opening.benches, self.benches or [None] * len(opening.benches), strict=True)
        tapes = tuple(None if first is None else first + (then or (None,)) for first, then in pairs)
        return TeamPlan(opening.plan + self.plan, tapes)

    def as_list(self) -> list[Any]:
        """Return the content for a JSON file."""
        return [list(self.plan), list(self.benches)]

    @classmethod
    def of(cls, content: Sequence[Any]) -> TeamPlan:
        """Return what :meth:`as_list` has returned, also after a file."""
        plan, benches = content
        return cls(tuple(plan), tuple(None if tape is None else tape_of(tape) for tape in benches))


def tape_of(content: Sequence[Sequence[Any]]) -> Tape:
    """Return a tape from the lists of a recording or of a file."""
    return tuple(tuple(tuple(a) if isinstance(a, (list, tuple)) else a for a in actions) for actions in content)


@dataclass(frozen=True)
class FoundPlan:
    """The best plan for a public context; ``score`` is its mean over ``seeds`` episodes that it was chosen on, other
    than those it was found on."""

    context: Context
    plan: Plan
    score: float
    seeds: int
    benches: tuple[Tape | None, ...] = ()

    @property
    def team(self) -> TeamPlan:
        """The plan with the benches' tapes."""
        return TeamPlan(self.plan, self.benches)


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
        if not any(one.benches for one in self.found):
            return play_laboratory(labs, self.policies(labs, seed), None, seed).returns
        scores = np.empty(episodes)
        for context, own in drawn_contexts(labs, seed).items():
            trials = Trials(self.scenario, context, [seed + i for i in own], 1, split)
            scores[own] = trials.play_teams([self.teams[context]], make_policies(self.benches, trials.labs))[0]
        return scores

    @property
    def teams(self) -> dict[Context, TeamPlan]:
        """By context, with the benches' tapes."""
        return {one.context: one.team for one in self.found}

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


class Trials:
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

    def team_policies(
        self, teams: Sequence[TeamPlan], policies: Mapping[str, Policy], manager: Playback | None = None
    ) -> list[Policy]:
        """Return the policy of every agent that plays open-loop policies; arguments as of :meth:`play_teams`."""
        each = [team for team in teams for _ in self.seeds]
        own = [policies[agent] for agent in self.labs.agents]
        self.seed_policies(own[1:])
        own[0] = plays = manager or Playback(self.labs.actions, [team.plan for team in each])
        for b, bench in enumerate(self.labs.benches):
            if any(team.benches for team in teams):
                tapes = [team.benches[b] if team.benches else None for team in each]
                own[b + 1] = _Taped(tapes, bench, own[b + 1], plays, b)
        return own

    def play_teams(
        self, teams: Sequence[TeamPlan], policies: Mapping[str, Policy], manager: Playback | None = None
    ) -> FloatArray:
        """[len(teams), seeds] scores of open-loop policies, each played from every seed.

        Args:
            teams: the open-loop policies.
            policies: of the agents; they play benches without a tape.
            manager: plays the plans; default: :class:`~chemlab.agents.open_loop.Playback`.
        """
        return self.play(self.team_policies(teams, policies, manager), len(teams))


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
        benches: whose agents' tapes are changed as well.
    """

    def __init__(
        self,
        actions: ManagerActions,
        context: Context,
        rng: np.random.Generator,
        without: Collection[str] = (),
        benches: Sequence[Bench] = (),
    ) -> None:
        table, self._benches = actions.table, benches
        asked = [actions.goals.index(goal) for goal in context]
        self._weights = np.where((table[:, 0] == START) & np.isin(table[:, 3], asked), _OWN_GOAL, 1.0)
        idle = [b for b, agent in enumerate(actions.bench_agents) if role_of(agent) in without]
        avoided = (table[:, 0] == START) & np.isin(table[:, 1], idle)
        self.free = bool(benches)
        self.longest = (_LONGEST_FREE if self.free else _LONGEST) * actions.orders
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

    def changed(self, parents: Sequence[_Tried]) -> TeamPlan:
        """A plan like one of the first of ``parents``, with one or a few changes."""
        parent = self._pick(parents)
        steps, benches = parent.steps(), parent.benches
        while True:
            if self._benches and self._rng.random() < _TAPED:
                benches = self._changed_benches(benches)
            else:
                self._change(steps, parents)
            if self._rng.random() < 0.5:
                return TeamPlan(tuple(action for action, _ in steps)[: self.longest], benches)

    def constant(self) -> tuple[Tape | None, ...]:
        """A random constant action for each kind of bench; now and then a kind is left to its policy."""
        kinds = {bench.key: None if self._rng.random() < 0.2 else self._constant(bench) for bench in self._benches}
        return tuple(kinds[bench.key] for bench in self._benches)

    def _constant(self, bench: Bench) -> Tape:
        if bench.action_count:
            return ((int(self._rng.integers(bench.action_count)),),)
        return ((tuple(self._rng.choice(_LEVELS, bench.action_space.shape).tolist()),),)

    def _changed_benches(self, benches: tuple[Tape | None, ...]) -> tuple[Tape | None, ...]:
        """Change the tape of one bench, or of all of its kind."""
        rng, now = self._rng, list(benches or [None] * len(self._benches))
        b = int(rng.integers(len(now)))
        tape, bench, what = now[b], self._benches[b], rng.random()
        changed = self._constant(bench) if what < 0.3 or not tape else self._changed_tape(tape, bench)
        alike = rng.random() < 0.5
        for i, other in enumerate(self._benches):
            if i == b or (alike and other.key == bench.key):
                now[i] = None if what < 0.05 else changed
        return tuple(now)

    def _changed_tape(self, tape: Tape, bench: Bench) -> Tape:
        """Change, prolong or leave out an action of a tape, or let a further experiment differ."""
        rng, experiments = self._rng, [list(actions or ()) for actions in tape]
        actions, what = experiments[int(rng.integers(len(experiments)))], rng.random()
        if not actions:
            return self._constant(bench)
        i = int(rng.integers(len(actions)))
        if what < 0.45:
            actions[i] = self._changed_action(actions[i], bench)
        elif what < 0.7:  # an action is held longer; the last one is held anyway
            actions[i:i] = [actions[i]] * int(rng.choice((1, 2, 4, 8)))
            if i == len(actions) - 2 or rng.random() < 0.5:
                actions[-1] = self._changed_action(actions[-1], bench)
        elif what < 0.9:
            del actions[i : i + int(rng.choice((1, 2, 4)))]
        elif len(experiments) < _MOST_EXPERIMENTS:
            last = list(experiments[-1])
            experiments.append([*last[:-1], self._changed_action(last[-1], bench)] if last else [])
        return tuple(tuple(own[:_LONGEST_TAPE]) for own in experiments)

    def _changed_action(self, action: Any, bench: Bench) -> Any:
        if bench.action_count:
            return int(self._rng.integers(bench.action_count))
        numbers = list(action)
        numbers[int(self._rng.integers(len(numbers)))] = float(self._rng.choice(_FINER))
        return tuple(numbers)

    def _pick(self, parents: Sequence[_Tried]) -> _Tried:
        return parents[int(len(parents) * self._rng.random() ** 2)]

    def _change(self, steps: list[tuple[int, BoolArray]], parents: Sequence[_Tried]) -> None:
        """Change one action, or take over the end of another plan."""
        rng = self._rng
        if not steps:
            steps += self._pick(parents).steps()
            return
        i, what = int(rng.integers(len(steps))), rng.random()
        if self.free and rng.random() < _REPEATED:
            end = i + int(rng.integers(1, 5))
            steps[end:end] = steps[i:end] * int(rng.choice((1, 2, 4)))
            return
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

    def neighbours(self, tried: _Tried) -> list[TeamPlan]:
        """All plans one change away: an action left out, put in, exchanged, elsewhere, or after the next; another
        value of an actuator, or another action, in a bench's tape."""
        plan = tried.plan
        found = [plan[:i] + plan[i + 1 :] for i in range(len(plan))]
        found += [(*plan[:i], plan[i + 1], plan[i], *plan[i + 2 :]) for i in range(len(plan) - 1)]
        for i, action in enumerate(plan):
            legal = np.flatnonzero(tried.legal[i] & self.useful).tolist()
            found += [(*plan[:i], other, *plan[i + 1 :]) for other in dict.fromkeys([*legal, *self.elsewhere[action]])]
            found += [(*plan[:i], other, *plan[i:]) for other in legal]
        teams = [TeamPlan(plan, tried.benches) for plan in found if len(plan) <= self.longest]
        near = [TeamPlan(plan, benches) for benches in self._near(tried.benches)]
        some = self._rng.permutation(len(near))[:_NEAR] if len(near) > _NEAR else range(len(near))
        return [*teams, *(near[i] for i in some)]

    def _near(self, benches: tuple[Tape | None, ...]) -> Iterator[tuple[Tape | None, ...]]:
        """Yield the tapes with one action changed."""
        for b, tape in enumerate(benches):
            bench = self._benches[b]
            for e, actions in enumerate(tape or ()):
                for i, action in enumerate(actions or ()):
                    if bench.action_count:
                        others: list[Any] = list(range(bench.action_count))
                    else:
                        cells = itertools.product(range(len(action)), _FINER)
                        others = [(*action[:x], level, *action[x + 1 :]) for x, level in cells]
                    for other in others:
                        assert tape is not None
                        assert actions is not None
                        changed = (*actions[:i], other, *actions[i + 1 :])
                        yield (*benches[:b], (*tape[:e], changed, *tape[e + 1 :]), *benches[b + 1 :])


@dataclass(frozen=True)
class _Tried:
    """A plan that has been tried.

    Attributes:
        score: mean over seeds.
        deviation: its standard deviation over seeds.
        plan: what was played of it, and what was played when it had come to its end.
        legal: [len(plan), A] what could have been played instead of each action, or before it.
        benches: tapes of the benches.
    """

    score: float
    deviation: float
    plan: Plan
    legal: BoolArray
    benches: tuple[Tape | None, ...] = ()

    @property
    def team(self) -> TeamPlan:
        """The plan with the benches' tapes."""
        return TeamPlan(self.plan, self.benches)

    def steps(self) -> list[tuple[int, BoolArray]]:
        """The plan's actions, each with what was legal there."""
        return list(zip(self.plan, self.legal, strict=True))


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
        self._actions, self._without = ManagerActions.of(scenario), without
        self._seen: set[TeamPlan] = set()
        self.best: list[_Tried] = []
        self.curve: list[tuple[int, float]] = []
        self._split, self._first_seed = split, seeds[0]
        self._one, self._several = self._prepared(seeds[:1]), self._prepared(seeds)
        taped = self._one[0].labs.benches if free else ()
        self._moves = _Moves(self._actions, context, np.random.default_rng(seed), without, taped)

    def _prepared(self, seeds: Sequence[int]) -> _Prepared:
        """Laboratories for these seeds, and who plays there; the manager's place is the plans'."""
        trials = Trials(self._scenario, self._context, seeds, max(BATCH // len(seeds), 1), self._split)
        return trials, make_policies(self._benches, trials.labs)

    def _play(self, prepared: _Prepared, teams: Sequence[TeamPlan]) -> list[_Tried]:
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
                found.append(_Tried(float(score.mean()), float(score.std()), played, legal, team.benches))
        return found

    def _try(self, teams: Iterable[TeamPlan]) -> list[_Tried]:
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
            taped = _Tape(self._moves, trials.labs.members)
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
                    policies = make_policies(name, trials.labs, 0)
            except ValueError:
                continue
            if not self._moves.free:
                policies = {**make_policies(self._benches, trials.labs), MANAGER_AGENT: policies[MANAGER_AGENT]}
            manager, *benches = [tapes[0] for tapes in _record(trials, policies)]
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
            beginning += self._donors([*_SCRIPTED, *_BUNDLED])
            beginning += self._donors(["scripted"], _revealed(self._scenario))
        self._try(beginning)
        best = -np.inf
        while self.tried < self._budget and self.best[0].score > best + _SAME:
            best = self.best[0].score
            self._evolve(self.best, self._budget)
        return self.best[0].score

    def run(self, known: Sequence[TeamPlan]) -> FoundPlan:
        """Search; ``known`` are plans to begin with."""
        beginning = [*known, *self._donors(_SCRIPTED)]
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
        """Return the best of the finalists on other seeds; a plan of the manager without what it does not need."""
        noisy = max(tried.deviation for tried in self.best) > _SAME
        count = min(max(_FEW_FINAL_SEEDS, self._budget // 10), _MOST_FINAL_SEEDS) if noisy else _FEW_FINAL_SEEDS
        first = SEARCH_SEED + SEEDS
        final = self._prepared(range(first, first + count))
        whole = _ranked(self._play(final, [tried.team for tried in self.best]), 1)[0]
        if self._moves.free:
            return FoundPlan(self._context, whole.plan, whole.score, count, whole.benches)
        few = final if count == _FEW_FINAL_SEEDS else self._prepared(range(first, first + _FEW_FINAL_SEEDS))
        best = whole if few is final else self._play(few, [whole.team])[0]
        while True:
            shorter = [TeamPlan(best.plan[:i] + best.plan[i + 1 :], best.benches) for i in range(len(best.plan))]
            # What is left out may come back when a plan has come to its end.
            played = [tried for tried in self._play(few, shorter) if len(tried.plan) < len(best.plan)]
            better = _ranked([tried for tried in played if tried.score >= best.score - _SAME], 1)
            if not better:
                break
            best = better[0]
        best = best if few is final else self._play(final, [best.team])[0]
        best = best if best.score >= whole.score - _SAME else whole
        return FoundPlan(self._context, best.plan, best.score, count)


def _revealed(scenario: Scenario) -> Scenario:
    """Return the scenario with exact instruments that cost nothing."""
    exact = {"price": 0.0, "noise": 0.0}
    instruments = {
        name: spec.model_copy(update={key: value for key, value in exact.items() if hasattr(spec, key)})
        for name, spec in scenario.instruments.items()
    }
    return scenario.model_copy(update={"instruments": instruments})


def _ranked(tried: Sequence[_Tried], most: int) -> list[_Tried]:
    """The best, one of each score, the shortest first: plans of equal score do the same but for names."""
    ordered = sorted(tried, key=lambda one: (-round(one.score, 9), len(one.plan), one.plan))
    kept: dict[float, _Tried] = {}
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
        budget: most plans tried, or one of :data:`PLAN_BUDGETS`; the first context gets half of it. A search ends
            sooner when new beginnings from random plans have found nothing better.
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
        search = Search(spec, benches, context, max(share, 1), own, watch or (lambda _: None), without, free=free)
        found.append(search.run([_translated(spec, one.team, one.context, context) for one in found]))
        left -= search.tried
    return PlanSearch(spec, benches, found, most - left)


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


def drawn_contexts(labs: Laboratories, seed: int) -> dict[Context, list[int]]:
    """Return the public contexts of episodes that begin with ``seed``, each with the environment indices that have it;
    the laboratories are then at the start of these episodes."""
    for member in labs.members.tolist():
        labs.seed(member, np.random.SeedSequence(seed + member))
    labs.reset(labs.members)
    found: dict[Context, list[int]] = {}
    for member, row in enumerate(labs.state.goal.tolist()):
        found.setdefault(tuple(labs.scenario.goals[goal] for goal in row), []).append(member)
    return found


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


class _Taped:
    """A bench's agent that plays a tape whatever it observes; where there is no tape, a policy plays.

    Where an action is not legal, it ends the experiment.

    Args:
        tapes: by environment index.
        bench: whose agent it is.
        policy: plays where there is no tape.
        manager: starts the experiments.
        number: index of the bench.
    """

    def __init__(
        self, tapes: Sequence[Tape | None], bench: Bench, policy: Policy, manager: Playback, number: int
    ) -> None:
        self._policy, self._end, self._manager, self._number = policy, bench.end_action, manager, number
        shape = bench.action_space.shape or ()
        known = {tape: number for number, tape in enumerate(dict.fromkeys(tape for tape in tapes if tape))}
        self._which = np.array([known[tape] if tape else -1 for tape in tapes])
        most = max(map(len, known), default=1)
        longest = max((1, *(len(actions or ()) for tape in known for actions in tape)))
        kind = np.int64 if bench.action_count else np.float64
        self._actions = np.full((len(known), most, longest, *shape), bench.end_action if not shape else 0.0, dtype=kind)
        self._played = np.ones((len(known), most), dtype=np.bool_)
        for tape, number in known.items():
            for e in range(most):
                actions = tape[min(e, len(tape) - 1)]
                self._played[number, e] = actions is not None
                if actions:
                    self._actions[number, e] = [*actions, *[actions[-1]] * (longest - len(actions))]

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        _, most, longest = self._actions.shape[:3]
        experiment = np.clip(self._manager.started[members, self._number] - 1, 0, most - 1)
        taped = self._which[members] >= 0
        if taped.any():
            taped &= self._played[self._which[members], experiment]
        played = np.zeros((len(members), *self._actions.shape[3:]), dtype=self._actions.dtype)
        if not taped.all():
            allowed = None if mask is None else mask[~taped]
            played[~taped] = self._policy.act(observation[~taped], allowed, step[~taped], members[~taped])
        if taped.any():
            own, turn = members[taped], np.minimum(step[taped], longest - 1)
            chosen = self._actions[self._which[own], experiment[taped], turn]
            if mask is not None:
                allowed = mask[taped] != 0
                rows = np.arange(len(own))
                other = np.where(allowed[:, self._end], self._end, allowed.argmax(axis=1))
                chosen = np.where(allowed[rows, chosen], chosen, other)
            played[taped] = chosen
        return played


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
    told(episodes)
    blind, best = np.empty(episodes), {}
    for context, own in drawn_contexts(labs, seed).items():
        trials = Trials(spec, context, range(SEARCH_SEED, SEARCH_SEED + donors), 1)
        tapes = _record(trials, _players(policy, trials.labs))
        teams = [
            TeamPlan(tuple(manager[0]), tuple(map(tape_of, benches))) for manager, *benches in zip(*tapes, strict=True)
        ]
        choice = Trials(spec, context, range(SEARCH_SEED + donors, SEARCH_SEED + donors + SEEDS), donors)
        chosen = int(choice.play_teams(teams, _players(policy, choice.labs)).mean(axis=1).argmax())
        final = Trials(spec, context, [seed + i for i in own], 1, split)
        blind[own] = final.play_teams([teams[chosen]], _players(policy, final.labs))[0]
        best[context] = SEARCH_SEED + chosen
        told(donors * (1 + SEEDS) + len(own))
    return Replayed(statistics.mean([blind]), statistics.mean([seeing]), best, blind)


def _players(policy: str | PlanSearch, labs: Laboratories, seed: int | None = None) -> dict[str, Policy]:
    return make_policies(policy, labs, seed) if isinstance(policy, str) else policy.policies(labs, seed)


def _record(trials: Trials, policies: Mapping[str, Policy]) -> list[list[list[list[Any]]]]:
    """[agents][members] tapes of one episode from each of the trials' seeds."""
    each = [policies[agent] for agent in trials.labs.agents]
    trials.seed_policies(each)
    taped = [_Tape(policy, trials.labs.members) for policy in each]
    trials.play(taped, 1)
    return [own.tapes for own in taped]
