"""Random changes of open-loop policies, from which a search makes new ones."""

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
"""Most actions for each order, of the manager alone and of all agents."""
_OWN_GOAL = 4.0
"""Relative probability of starting an experiment for an order's goal rather than for another."""
_LEVELS = (0.0, 0.5, 1.0)
"""Constant values of an actuator; 0.5 leaves a temperature or a piston as it is, 0 adds nothing of a reagent."""
_FINER = (0.0, 0.25, 0.5, 0.75, 1.0)
_LONGEST_TAPE, _MOST_EXPERIMENTS, _NEAR = 64, 8, 256
_TAPED, _REPEATED = 0.4, 0.2
"""Shares of the changes of a plan of all agents that change a bench's tape, or repeat some actions of the manager."""
# Chances with which a random plan does something next, where it is possible.
_CHANCES = {START: 6.0, MEASURE: 0.0, DISCARD: 1.0, SUBMIT: 1.5, RECALL: 0.3, WAIT: 3.0, REPAIR: 0.5}


@dataclass(frozen=True)
class Tried:
    """A plan that has been tried.

    Attributes:
        score: mean over seeds.
        deviation: its standard deviation over seeds.
        team: of the manager's plan, what was played of it, and what was played when it had come to its end.
        legal: [len(plan), A] what could have been played instead of each action, or before it.
    """

    score: float
    deviation: float
    team: TeamPlan
    legal: BoolArray

    def steps(self) -> list[tuple[int, BoolArray]]:
        """The plan's actions, each with what was legal there."""
        return list(zip(self.team.plan, self.legal, strict=True))


class Moves:
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

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """Random legal actions, see :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        return np.array([self.draw(row != 0) for row in mask], dtype=np.int64)

    def changed(self, parents: Sequence[Tried]) -> TeamPlan:
        """A plan like one of the first of ``parents``, with one or a few changes."""
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

    def _pick(self, parents: Sequence[Tried]) -> Tried:
        return parents[int(len(parents) * self._rng.random() ** 2)]

    def _change(self, steps: list[tuple[int, BoolArray]], parents: Sequence[Tried]) -> None:
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

    def neighbours(self, tried: Tried) -> list[TeamPlan]:
        """All plans one change away: an action left out, put in, exchanged, elsewhere, or after the next; another
        value of an actuator, or another action, in a bench's tape."""
        plan, tapes = tried.team.plan, tried.team.benches
        found = [plan[:i] + plan[i + 1 :] for i in range(len(plan))]
        found += [(*plan[:i], plan[i + 1], plan[i], *plan[i + 2 :]) for i in range(len(plan) - 1)]
        for i, action in enumerate(plan):
            legal = np.flatnonzero(tried.legal[i] & self.useful).tolist()
            found += [(*plan[:i], other, *plan[i + 1 :]) for other in dict.fromkeys([*legal, *self.elsewhere[action]])]
            found += [(*plan[:i], other, *plan[i:]) for other in legal]
        teams = [TeamPlan(plan, tapes) for plan in found if len(plan) <= self.longest]
        near = [TeamPlan(plan, benches) for benches in self._near(tapes)]
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
