"""Open-loop policies: fixed action sequences of the manager or of all agents, and episodes replayed with other seeds.

:class:`Trials` plays several policies on the same seeds. :func:`replay_actions` replays the actions of all agents in a
donor's episode. The search for sequences is in :mod:`chemlab.agents.evaluate.search`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Actions, Players, Policy, Watching
from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Bench
from chemlab.roles.manager_actions import ManagerActions

from ..episodes import play_laboratory
from ..open_loop import ConstantPlan, Context, Plan, PlanFile, Playback, StoredPlan
from ..policies import make_policies
from ..runs import versions
from . import statistics

SEARCH_SEED = 3_000_000
"""Seed of the first episode in which plans are tried; training and evaluation use other seeds."""
SEEDS = 8
"""Number of seeds on which promising plans are tried."""

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
        """Return the policy with an opening before it; benches without a tape in the opening have no tape at all."""
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
        """Return the policy of a result of :meth:`as_list`, also one read from a file."""
        plan, benches = content
        return cls(tuple(plan), tuple(None if tape is None else tape_of(tape) for tape in benches))


def tape_of(content: Sequence[Sequence[Any]]) -> Tape:
    """Return a tape from the lists of a recording or of a file."""
    return tuple(tuple(tuple(a) if isinstance(a, (list, tuple)) else a for a in actions) for actions in content)


@dataclass(frozen=True)
class FoundPlan:
    """The best plan for a public context; ``score`` is its mean over episodes that the search did not use."""

    context: Context
    team: TeamPlan
    score: float


@dataclass(frozen=True)
class PlanSearch:
    """The result of a search.

    Attributes:
        scenario: the scenario.
        benches: policy of the benches.
        found: the best plan of each public context.
        tried: number of plans tried.
    """

    scenario: Scenario
    benches: str
    found: list[FoundPlan]
    tried: int

    @property
    def plans(self) -> dict[Context, Plan]:
        """The manager's plans by context."""
        return {one.context: one.team.plan for one in self.found}

    def play(self, episodes: int = 100, seed: int = 0, split: str = "train") -> FloatArray:
        """Return [episodes] scores of the plans; episode i has seed + i, as in ``chemlab evaluate``.

        Raises:
            ValueError: a context has no plan.
        """
        labs = Laboratories(self.scenario, episodes, split=split)
        if not any(one.team.benches for one in self.found):
            return play_laboratory(labs, self.policies(labs), None, seed).returns
        scores = np.empty(episodes)
        for context, members in drawn_contexts(labs, seed).items():
            trials = Trials(self.scenario, context, [seed + i for i in members], 1, split)
            scores[members] = trials.play_teams([self.teams[context]], make_policies(self.benches, trials.labs))[0]
        return scores

    @property
    def teams(self) -> dict[Context, TeamPlan]:
        """The plans by context, with the benches' tapes."""
        return {one.context: one.team for one in self.found}

    def policies(self, labs: Laboratories) -> dict[str, Policy]:
        """Return the policies of all agents: the manager with the plans, and the benches."""
        manager = ConstantPlan(labs.scenario, labs.channels, labs.actions, self.plans)
        return {**make_policies(self.benches, labs), MANAGER_AGENT: manager}

    def as_file(self, command: str, episodes: int = 100) -> PlanFile:
        """Return the content of a plan file, with the score over episodes with seeds 0, 1, ..."""
        actions = ManagerActions.of(self.scenario)
        score = statistics.mean([self.play(episodes, 0)])
        plans = [
            StoredPlan(goals=list(o.context), score=o.score, steps=[list(actions.decode(a)) for a in o.team.plan])
            for o in self.found
        ]
        evaluation = {"episodes": episodes, "seed": 0, **score.as_dict()}
        return PlanFile(
            kind="plan",
            format=1,
            scenario=self.scenario.name,
            benches=self.benches,
            command=command,
            versions=versions(),
            tried=self.tried,
            evaluation=evaluation,
            plans=plans,
        )


def plan_words(scenario: Scenario, plan: Iterable[int]) -> list[str]:
    """Return the descriptions of a plan's actions."""
    meanings = ManagerActions.of(scenario).action_meanings
    return [meanings[action] for action in plan]


# -- trying plans -----------------------------------------------------------------------------------------------------


class Trials:
    """Laboratories in which several candidates are tried, each on the same seeds of one public context.

    Args:
        scenario: the scenario.
        context: the goals of the orders.
        seeds: seeds of the episodes.
        most: maximum number of concurrent candidates.
        split: split of the worlds, if the scenario has hidden parameters.
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
        # A reset with a goal sets it for all orders; its random draws are those of any other reset.
        self.labs.state.goal[members] = [scenario.goals.index(goal) for goal in context]
        self._start = self.labs.snapshot()

    def seed_policies(self, policies: Iterable[Policy]) -> None:
        """Seed the policies' random streams; equal seeds of episodes give equal streams."""
        for number, policy in enumerate(policies):
            if hasattr(policy, "seed"):
                for member, seed in zip(self.labs.members.tolist(), self.seed_of.tolist(), strict=True):
                    policy.seed(member, np.random.SeedSequence([seed, number]))

    def play(self, policies: Sequence[Policy], count: int) -> FloatArray:
        """Return [count, seeds] the manager's scores; environment i plays candidate i // len(seeds).

        Args:
            policies: the manager's, then those of the benches.
            count: number of candidates.
        """
        self.labs.restore(self._start)
        own = dict(zip((self.labs.manager, *self.labs.bench_roles), policies, strict=True))
        members = self.labs.members[: count * len(self.seeds)]
        Players(self.labs, [own[role] for role in self.labs.roles]).play_on(members)
        return self.labs.result(members).reshape(count, len(self.seeds))

    def team_policies(
        self, teams: Sequence[TeamPlan], policies: Mapping[str, Policy], manager: Playback | None = None
    ) -> list[Policy]:
        """Return the policies for :meth:`play` of open-loop policies; arguments as for :meth:`play_teams`."""
        team_of = [team for team in teams for _ in self.seeds]
        benches = [policies[agent] for agent in self.labs.bench_agents]
        self.seed_policies(benches)
        playback = manager or Playback(self.labs.actions, [team.plan for team in team_of])
        if any(team.benches for team in teams):
            for b, bench in enumerate(self.labs.benches):
                tapes = [team.benches[b] if team.benches else None for team in team_of]
                benches[b] = _Taped(tapes, bench, benches[b], playback, b)
        return [playback, *benches]

    def play_teams(
        self, teams: Sequence[TeamPlan], policies: Mapping[str, Policy], manager: Playback | None = None
    ) -> FloatArray:
        """Return [len(teams), seeds] scores of open-loop policies, each played with every seed.

        Args:
            teams: the open-loop policies.
            policies: policies by agent, which play benches without a tape.
            manager: manager with the plans; default: :class:`~chemlab.agents.open_loop.Playback`.
        """
        return self.play(self.team_policies(teams, policies, manager), len(teams))


def drawn_contexts(labs: Laboratories, seed: int) -> dict[Context, list[int]]:
    """Start episodes, with ``seed`` in laboratory 0, and return the environment indices of each public context."""
    labs.begin(seed)
    found: dict[Context, list[int]] = {}
    for member, row in enumerate(labs.state.goal.tolist()):
        found.setdefault(tuple(labs.scenario.goals[goal] for goal in row), []).append(member)
    return found


# -- replaying --------------------------------------------------------------------------------------------------------


class TapeRecorder(Watching):
    """Plays as another policy does, and records its actions.

    Args:
        policy: the other policy.
        members: environment indices of the batch.

    Attributes:
        tapes: actions of each experiment (of a manager: of the episode), by environment index.
    """

    def __init__(self, policy: Policy, members: IntArray) -> None:
        super().__init__(policy, self._note)
        self.tapes: list[list[list[Any]]] = [[] for _ in members]

    def _note(self, observation: Any, mask: Any, step: IntArray, members: IntArray, actions: Any) -> None:
        for member, turn, action in zip(members.tolist(), step.tolist(), actions.tolist(), strict=True):
            if turn == 0:
                self.tapes[member].append([])
            self.tapes[member][-1].append(action)


class _Taped:
    """Plays tapes at a bench, or another policy in experiments without a tape.

    If an action is not legal, it ends the experiment.

    Args:
        tapes: tapes by environment index.
        bench: the bench.
        policy: policy of experiments without a tape.
        manager: manager that starts the experiments.
        number: index of the bench.
    """

    def __init__(
        self, tapes: Sequence[Tape | None], bench: Bench, policy: Policy, manager: Playback, number: int
    ) -> None:
        self._policy, self._end, self._manager, self._number = policy, bench.end_action, manager, number
        shape = bench.action_space.shape or ()
        rows = {tape: row for row, tape in enumerate(dict.fromkeys(tape for tape in tapes if tape))}
        self._row_of = np.array([rows[tape] if tape else -1 for tape in tapes])
        most = max(map(len, rows), default=1)
        longest = max((1, *(len(actions or ()) for tape in rows for actions in tape)))
        kind = np.int64 if bench.action_count else np.float64
        self._actions = np.full((len(rows), most, longest, *shape), bench.end_action if not shape else 0.0, dtype=kind)
        self._has_tape = np.ones((max(len(rows), 1), most), dtype=np.bool_)
        for tape, row in rows.items():
            for e in range(most):
                actions = tape[min(e, len(tape) - 1)]
                self._has_tape[row, e] = actions is not None
                if actions:
                    self._actions[row, e] = [*actions, *[actions[-1]] * (longest - len(actions))]

    def _current(self, members: IntArray) -> tuple[IntArray, BoolArray]:
        """Return [B] the index of the current experiment in a tape, and [B] True where a tape is played."""
        number = np.maximum(self._manager.started[members, self._number] - 1, 0)  # faster than np.clip for integers
        experiment, row = np.minimum(number, self._actions.shape[1] - 1), self._row_of[members]
        return experiment, self._has_tape[row, experiment] & (row >= 0)

    def reads(self, members: IntArray) -> BoolArray:
        """See :class:`chemlab.envs.players.Policy`. Observations are read where no tape is played."""
        return ~self._current(members)[1]

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        experiment, taped = self._current(members)
        actions = np.zeros((len(members), *self._actions.shape[3:]), dtype=self._actions.dtype)
        if not taped.all():
            allowed = None if mask is None else mask[~taped]
            actions[~taped] = self._policy.act(observation[~taped], allowed, step[~taped], members[~taped])
        if taped.any():
            row, turn = self._row_of[members[taped]], np.minimum(step[taped], self._actions.shape[2] - 1)
            chosen = self._actions[row, experiment[taped], turn]
            if mask is not None:
                legal = mask[taped] != 0
                end = np.where(legal[:, self._end], self._end, legal.argmax(axis=1))
                chosen = np.where(legal[np.arange(len(legal)), chosen], chosen, end)
            actions[taped] = chosen
        return actions


def replay_actions(
    scenario: str | Scenario,
    policy: str | PlanSearch = "scripted",
    donors: int = 20,
    episodes: int = 100,
    seed: int = 0,
    split: str = "train",
) -> FloatArray:
    """Replay the actions of all agents in one episode, the best of several donor episodes for each public context.

    The manager's actions are played as an open-loop plan. Donor episodes, the episodes on which the best donor is
    chosen, and the scored episodes have different seeds. With found plans or the policy ``plan``, the result is an
    open-loop policy of all agents with this plan.

    Args:
        scenario: the scenario.
        policy: policy of the donors, see :func:`~chemlab.agents.policies.make_policies`; or found plans.
        donors: number of donor episodes for each context.
        episodes: number of scored episodes; episode i has seed + i and draws its goals.
        seed: seed of the first scored episode.
        split: split of the scored worlds, if the scenario has hidden parameters; donors are from ``train``.

    Returns:
        [episodes] scores.

    Raises:
        ValueError: the policy is unknown, or there is no donor or episode.
    """
    spec = load_scenario(scenario)
    if donors < 1 or episodes < 1:
        raise ValueError(f"replay: needs at least one donor and one episode, given {donors} and {episodes}")
    labs = Laboratories(spec, episodes, split=split)
    scores = np.empty(episodes)
    for context, members in drawn_contexts(labs, seed).items():
        trials = Trials(spec, context, range(SEARCH_SEED, SEARCH_SEED + donors), 1)
        tapes = recorded_tapes(trials, _players(policy, trials.labs))
        teams = [
            TeamPlan(tuple(manager[0]), tuple(map(tape_of, benches))) for manager, *benches in zip(*tapes, strict=True)
        ]
        choice = Trials(spec, context, range(SEARCH_SEED + donors, SEARCH_SEED + donors + SEEDS), donors)
        chosen = int(choice.play_teams(teams, _players(policy, choice.labs)).mean(axis=1).argmax())
        final = Trials(spec, context, [seed + i for i in members], 1, split)
        scores[members] = final.play_teams([teams[chosen]], _players(policy, final.labs))[0]
    return scores


def _players(policy: str | PlanSearch, labs: Laboratories) -> dict[str, Policy]:
    return make_policies(policy, labs) if isinstance(policy, str) else policy.policies(labs)


def recorded_tapes(trials: Trials, policies: Mapping[str, Policy]) -> list[list[list[list[Any]]]]:
    """Play one episode with each of the trials' seeds, and return the tapes [1 + benches][environments]."""
    ordered = [policies[agent] for agent in (MANAGER_AGENT, *trials.labs.bench_agents)]
    trials.seed_policies(ordered)
    recorders = [TapeRecorder(policy, trials.labs.members) for policy in ordered]
    trials.play(recorders, 1)
    return [recorder.tapes for recorder in recorders]
