"""Open-loop policies: fixed action sequences of the manager or of all agents, and episodes replayed from other seeds.

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
"""Of the first episode that plans are tried on: seeds that neither training nor evaluation plays."""
SEEDS = 8
"""Seeds a promising plan is tried on."""

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
    """The best plan for a public context; ``score`` is its mean over episodes that it was chosen on, other than those
    it was found on."""

    context: Context
    team: TeamPlan
    score: float


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
        return {one.context: one.team.plan for one in self.found}

    def play(self, episodes: int = 100, seed: int = 0, split: str = "train") -> FloatArray:
        """[episodes] scores of the plans; episode i has seed + i, as ``chemlab evaluate`` plays it.

        Raises:
            ValueError: the search was not for every context.
        """
        labs = Laboratories(self.scenario, episodes, split=split)
        if not any(one.team.benches for one in self.found):
            return play_laboratory(labs, self.policies(labs), None, seed).returns
        scores = np.empty(episodes)
        for context, own in drawn_contexts(labs, seed).items():
            trials = Trials(self.scenario, context, [seed + i for i in own], 1, split)
            scores[own] = trials.play_teams([self.teams[context]], make_policies(self.benches, trials.labs))[0]
        return scores

    @property
    def teams(self) -> dict[Context, TeamPlan]:
        """By context, with the benches' tapes."""
        return {one.context: one.team for one in self.found}

    def policies(self, labs: Laboratories) -> dict[str, Policy]:
        """The manager that plays them, and who operates the benches."""
        manager = ConstantPlan(labs.scenario, labs.channels, labs.actions, self.plans)
        return {**make_policies(self.benches, labs), MANAGER_AGENT: manager}

    def as_file(self, command: str, episodes: int = 100) -> PlanFile:
        """As it is stored, with the score from seeds of its own."""
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


def drawn_contexts(labs: Laboratories, seed: int) -> dict[Context, list[int]]:
    """Return the public contexts of episodes that begin with ``seed``, each with the environment indices that have it;
    the laboratories are then at the start of these episodes."""
    labs.begin(seed)
    found: dict[Context, list[int]] = {}
    for member, row in enumerate(labs.state.goal.tolist()):
        found.setdefault(tuple(labs.scenario.goals[goal] for goal in row), []).append(member)
    return found


# -- replaying --------------------------------------------------------------------------------------------------------


class TapeRecorder(Watching):
    """Plays as another policy does, and keeps its actions.

    Args:
        policy: the other one.
        members: of the batch.

    Attributes:
        tapes: by member, of each of its experiments (the manager: of its episode), the actions.
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
        self._played = np.ones((max(len(known), 1), most), dtype=np.bool_)
        for tape, number in known.items():
            for e in range(most):
                actions = tape[min(e, len(tape) - 1)]
                self._played[number, e] = actions is not None
                if actions:
                    self._actions[number, e] = [*actions, *[actions[-1]] * (longest - len(actions))]

    def _place(self, members: IntArray) -> tuple[IntArray, BoolArray]:
        """Return [B] the row of the present experiment in a tape, and whether a tape is played."""
        number = np.maximum(self._manager.started[members, self._number] - 1, 0)  # clip looks up bounds of integers
        experiment, which = np.minimum(number, self._actions.shape[1] - 1), self._which[members]
        return experiment, self._played[which, experiment] & (which >= 0)

    def reads(self, members: IntArray) -> BoolArray:
        """See :class:`chemlab.envs.players.Policy`: where no tape is played."""
        return ~self._place(members)[1]

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        longest, (experiment, taped) = self._actions.shape[2], self._place(members)
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
    split: str = "train",
) -> FloatArray:
    """Play again, without looking, what all agents did in one episode: for each public context the best of some donors.

    The manager plays its actions as a constant plan does. Donors play seeds of their own, are chosen on others again,
    and are scored on ``episodes`` further seeds. With ``plan`` for the policy, the donors' manager is blind already: a
    constant plan of everybody.

    Args:
        scenario: where.
        policy: who is replayed, see :func:`~chemlab.agents.policies.make_policies`; or found plans, with their benches.
        donors: episodes to choose from, for each context.
        episodes: episode i has seed + i and the goals that it draws.
        seed: of the first.
        split: worlds of the episodes that are scored, where the scenario draws any; donors are from train.

    Returns:
        [episodes] scores.

    Raises:
        ValueError: unknown policy, or fewer than one donor or episode.
    """
    spec = load_scenario(scenario)
    if donors < 1 or episodes < 1:
        raise ValueError(f"replay: needs at least one donor and one episode, given {donors} and {episodes}")
    labs = Laboratories(spec, episodes, split=split)
    scores = np.empty(episodes)
    for context, own in drawn_contexts(labs, seed).items():
        trials = Trials(spec, context, range(SEARCH_SEED, SEARCH_SEED + donors), 1)
        tapes = recorded_tapes(trials, _players(policy, trials.labs))
        teams = [
            TeamPlan(tuple(manager[0]), tuple(map(tape_of, benches))) for manager, *benches in zip(*tapes, strict=True)
        ]
        choice = Trials(spec, context, range(SEARCH_SEED + donors, SEARCH_SEED + donors + SEEDS), donors)
        chosen = int(choice.play_teams(teams, _players(policy, choice.labs)).mean(axis=1).argmax())
        final = Trials(spec, context, [seed + i for i in own], 1, split)
        scores[own] = final.play_teams([teams[chosen]], _players(policy, final.labs))[0]
    return scores


def _players(policy: str | PlanSearch, labs: Laboratories) -> dict[str, Policy]:
    return make_policies(policy, labs) if isinstance(policy, str) else policy.policies(labs)


def recorded_tapes(trials: Trials, policies: Mapping[str, Policy]) -> list[list[list[list[Any]]]]:
    """[agents][members] tapes of one episode from each of the trials' seeds."""
    each = [policies[agent] for agent in trials.labs.agents]
    trials.seed_policies(each)
    taped = [TapeRecorder(policy, trials.labs.members) for policy in each]
    trials.play(taped, 1)
    return [own.tapes for own in taped]
