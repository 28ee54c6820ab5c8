"""Random mutations of open-loop policies, with which a search generates candidates."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from chemlab.envs.players import Actions
from chemlab.kernels.arrays import BoolArray, IntArray, MaskArray, ObservationArray
from chemlab.roles.bench import Bench
from chemlab.roles.manager_actions import DISCARD, MEASURE, RECALL, REPAIR, START, SUBMIT, WAIT, ManagerActions

from ..open_loop import Context
from ..roles import role_of
from .plans import Tape, TeamPlan

_LONGEST, _LONGEST_FREE = 12, 48
"""Maximum number of manager actions for each order, in a search over the manager's or over all agents' actions."""
_OWN_GOAL = 4.0
"""Relative probability of starting an experiment for an order's goal rather than for another."""
_LEVELS = (0.0, 0.5, 1.0)
"""Constant values of an actuator; 0.5 leaves a temperature or a piston as it is, 0 adds nothing of a reagent."""
_FINER = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Values of an actuator in mutations of a tape."""
_LONGEST_TAPE, _MOST_EXPERIMENTS, _NEAR = 64, 8, 256
_TAPED, _REPEATED = 0.4, 0.2
"""Probabilities that a mutation of all agents' policy changes a bench's tape, or repeats some manager actions."""
_CHANCES = {START: 6.0, MEASURE: 0.0, DISCARD: 1.0, SUBMIT: 1.5, RECALL: 0.3, WAIT: 3.0, REPAIR: 0.5}
"""Relative probabilities of kinds of actions in a random plan, if they are legal."""


@dataclass(frozen=True)
class Tried:
    """An evaluated plan.

    Attributes:
        score: mean score over seeds.
        deviation: standard deviation of the score over seeds.
        team: the policy, with the manager's actions that were actually played, including those after the plan's end.
        legal: [len(plan), A] True for actions that were legal instead of each action, or before it.
    """

    score: float
    deviation: float
    team: TeamPlan
    legal: BoolArray

    def steps(self) -> list[tuple[int, BoolArray]]:
        """Return the plan's actions, each with the legal actions [A] at its position."""
        return list(zip(self.team.plan, self.legal, strict=True))


class Moves:
    """Random actions and mutations of plans.

    Args:
        actions: the manager's actions.
        context: the goals of the orders.
        rng: random generator.
        without: benches that are not used, by key.
        benches: benches whose agents play tapes, which are mutated as well.

    Attributes:
        free: True if benches play tapes.
        longest: maximum length of a plan.
        useful: [A] True for actions that a random plan may contain.
        elsewhere: for each action, the same action on other slots.
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
        goals = [actions.goals.index(goal) for goal in context]
        self._weights = np.where((table[:, 0] == START) & np.isin(table[:, 3], goals), _OWN_GOAL, 1.0)
        unused = [b for b, agent in enumerate(actions.bench_agents) if role_of(agent) in without]
        avoided = (table[:, 0] == START) & np.isin(table[:, 1], unused)
        self.free = bool(benches)
        self.longest = (_LONGEST_FREE if self.free else _LONGEST) * actions.orders
        self._rng = rng
        self._of_kind: BoolArray = np.stack([(table[:, 0] == kind) & ~avoided for kind in _CHANCES])
        self._chances = np.array(list(_CHANCES.values()))
        self._kind = table[:, 0]
        self.useful: BoolArray = self._chances @ self._of_kind > 0.0
        slot_column = {START: 2, DISCARD: 1, SUBMIT: 1}
        self.elsewhere: list[list[int]] = []
        for action, row in enumerate(table):
            column = slot_column.get(int(row[0]))
            others = [] if column is None else np.flatnonzero((np.delete(table == row, column, 1)).all(axis=1)).tolist()
            self.elsewhere.append([other for other in others if other != action and not avoided[other]])

    def draw(self, legal: BoolArray) -> int:
        """Draw one of the legal actions [A]: first its kind, then the action. WAIT, the last one, if none is legal."""
        chances = self._chances * (self._of_kind & legal).any(axis=1)
        total = chances.sum()
        if total == 0.0:
            return len(legal) - 1
        kind = int(np.searchsorted(np.cumsum(chances), self._rng.random() * total, side="right"))
        weights = np.cumsum(self._weights * (self._of_kind[kind] & legal))
        return int(np.searchsorted(weights, self._rng.random() * weights[-1], side="right"))

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """Return random legal actions, see :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        return np.array([self.draw(row != 0) for row in mask], dtype=np.int64)

    def changed(self, parents: Sequence[Tried]) -> TeamPlan:
        """Return a mutation, with one or several changes, of a random plan; the first of ``parents`` are preferred."""
        parent = self._pick(parents)
        steps, benches = parent.steps(), parent.team.benches
        while True:
            if self._benches and self._rng.random() < _TAPED:
                benches = self._changed_benches(benches)
            else:
                self._change(steps, parents)
            if self._rng.random() < 0.5:
                return TeamPlan(tuple(action for action, _ in steps)[: self.longest], benches)

    def constant(self) -> tuple[Tape | None, ...]:
        """Return a tape with a random constant action for each kind of bench, or None with probability 0.2."""
        kinds = {bench.key: None if self._rng.random() < 0.2 else self._constant(bench) for bench in self._benches}
        return tuple(kinds[bench.key] for bench in self._benches)

    def _constant(self, bench: Bench) -> Tape:
        if bench.action_count:
            return ((int(self._rng.integers(bench.action_count)),),)
        return ((tuple(self._rng.choice(_LEVELS, bench.action_space.shape).tolist()),),)

    def _changed_benches(self, benches: tuple[Tape | None, ...]) -> tuple[Tape | None, ...]:
        """Return the tapes with that of one bench, or of all benches of its kind, changed or removed."""
        rng, tapes = self._rng, list(benches or [None] * len(self._benches))
        b = int(rng.integers(len(tapes)))
        tape, bench, choice = tapes[b], self._benches[b], rng.random()
        changed = self._constant(bench) if choice < 0.3 or not tape else self._changed_tape(tape, bench)
        whole_kind = rng.random() < 0.5
        for i, other in enumerate(self._benches):
            if i == b or (whole_kind and other.key == bench.key):
                tapes[i] = None if choice < 0.05 else changed
        return tuple(tapes)

    def _changed_tape(self, tape: Tape, bench: Bench) -> Tape:
        """Return a tape with an action changed, repeated or removed, or with a further, different experiment."""
        rng, experiments = self._rng, [list(actions or ()) for actions in tape]
        actions, choice = experiments[int(rng.integers(len(experiments)))], rng.random()
        if not actions:
            return self._constant(bench)
        i = int(rng.integers(len(actions)))
        if choice < 0.45:
            actions[i] = self._changed_action(actions[i], bench)
        elif choice < 0.7:  # hold an action longer; the last one is always held
            actions[i:i] = [actions[i]] * int(rng.choice((1, 2, 4, 8)))
            if i == len(actions) - 2 or rng.random() < 0.5:
                actions[-1] = self._changed_action(actions[-1], bench)
        elif choice < 0.9:
            del actions[i : i + int(rng.choice((1, 2, 4)))]
        elif len(experiments) < _MOST_EXPERIMENTS:
            last = list(experiments[-1])
            experiments.append([*last[:-1], self._changed_action(last[-1], bench)] if last else [])
        return tuple(tuple(own[:_LONGEST_TAPE]) for own in experiments)

    def _changed_action(self, action: Any, bench: Bench) -> Any:
        """Return another discrete action, or a continuous one with one number changed."""
        if bench.action_count:
            return int(self._rng.integers(bench.action_count))
        numbers = list(action)
        numbers[int(self._rng.integers(len(numbers)))] = float(self._rng.choice(_FINER))
        return tuple(numbers)

    def _pick(self, parents: Sequence[Tried]) -> Tried:
        """Draw a plan; the first ones are preferred."""
        return parents[int(len(parents) * self._rng.random() ** 2)]

    def _change(self, steps: list[tuple[int, BoolArray]], parents: Sequence[Tried]) -> None:
        """Change one action in ``steps``, or replace their end by that of another plan."""
        rng = self._rng
        if not steps:
            steps += self._pick(parents).steps()
            return
        i, choice = int(rng.integers(len(steps))), rng.random()
        if self.free and rng.random() < _REPEATED:
            end = i + int(rng.integers(1, 5))
            steps[end:end] = steps[i:end] * int(rng.choice((1, 2, 4)))
            return
        action, legal = steps[i]
        if choice < 0.3:
            steps.insert(i, (self.draw(legal), legal))
        elif choice < 0.5:
            same = legal & (self._kind == self._kind[action])
            steps[i] = self.draw(same if rng.random() < 0.5 and same.any() else legal), legal
        elif choice < 0.75:
            others = self.elsewhere[action]
            if others:
                steps[i] = int(rng.choice(others)), legal
        elif choice < 0.85:
            del steps[i]
        elif choice < 0.92:
            j = int(rng.integers(len(steps)))
            steps[i], steps[j] = steps[j], steps[i]
        else:
            other = self._pick(parents).steps()
            steps[i:] = other[int(rng.integers(len(other) + 1)) :]

    def neighbours(self, tried: Tried) -> list[TeamPlan]:
        """Return all plans with a single change.

        In the manager's plan, an action is removed, inserted, replaced, or swapped with the next. In a bench's tape, an
        action or a value of an actuator is replaced; at most ``_NEAR`` of these are drawn.
        """
        plan, tapes = tried.team.plan, tried.team.benches
        found = [plan[:i] + plan[i + 1 :] for i in range(len(plan))]
        found += [(*plan[:i], plan[i + 1], plan[i], *plan[i + 2 :]) for i in range(len(plan) - 1)]
        for i, action in enumerate(plan):
            legal = np.flatnonzero(tried.legal[i] & self.useful).tolist()
            found += [(*plan[:i], other, *plan[i + 1 :]) for other in dict.fromkeys([*legal, *self.elsewhere[action]])]
            found += [(*plan[:i], other, *plan[i:]) for other in legal]
        teams = [TeamPlan(plan, tapes) for plan in found if len(plan) <= self.longest]
        near = [TeamPlan(plan, benches) for benches in self._neighbouring_tapes(tapes)]
        chosen = self._rng.permutation(len(near))[:_NEAR] if len(near) > _NEAR else range(len(near))
        return [*teams, *(near[i] for i in chosen)]

    def _neighbouring_tapes(self, benches: tuple[Tape | None, ...]) -> Iterator[tuple[Tape | None, ...]]:
        """Yield the tapes with one action changed."""
        for b, tape in enumerate(benches):
            count = self._benches[b].action_count
            for e, actions in enumerate(tape or ()):
                for i, action in enumerate(actions or ()):
                    others: list[Any] = list(range(count))
                    if not count:
                        cells = itertools.product(range(len(action)), _FINER)
                        others = [(*action[:x], level, *action[x + 1 :]) for x, level in cells]
                    for other in others:
                        assert tape is not None
                        assert actions is not None
                        changed = (*actions[:i], other, *actions[i + 1 :])
                        yield (*benches[:b], (*tape[:e], changed, *tape[e + 1 :]), *benches[b + 1 :])
