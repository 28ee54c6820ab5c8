"""Open-loop managers: fixed action sequences, one for each public context, independent of later observations.

The *public context* is the goals of the orders, which are revealed at the start. Plans found by a search
(:mod:`chemlab.agents.evaluate.search`) are stored in ``models/plans/SCENARIO.BENCHES.json`` with the command that found
them.
"""

from __future__ import annotations

import importlib.resources
import itertools
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from chemlab.config.datafile import DataError, read_json
from chemlab.config.datamodel import DataModel, validated
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions, Remembering
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Channel, channel_slices
from chemlab.roles.manager_actions import START, SUBMIT, ManagerActions
from chemlab.roles.manager_view import order_channels

from .former_names import current_name

Context = tuple[str, ...]
"""The goal of every order, on which a plan may depend."""

Plan = tuple[int, ...]
"""Indices of manager actions in order."""

_END = -1


def all_contexts(scenario: Scenario) -> list[Context]:
    """Return every public context that a scenario may draw."""
    return list(itertools.product(scenario.lab_goals, repeat=scenario.orders))


class Playback(Remembering):
    """Plays fixed sequences of manager actions, one for each environment index.

    The next action is played as soon as it is legal. Until then the manager waits for the benches; if no bench is busy,
    the action is skipped. After the last action the manager waits while benches are busy, and then submits the vessel
    in the lowest slot for the first open order.

    Args:
        actions: the manager's actions.
        plans: the sequences, by environment index.

    Attributes:
        started: [N, benches] number of experiments at each bench in the episode so far.
    """

    _MEMORY = ("_plan", "_next")

    def __init__(self, actions: ManagerActions, plans: Sequence[Plan]) -> None:
        self._table = actions.table
        self.started: IntArray = np.zeros((len(plans), len(actions.bench_agents)), dtype=np.int64)
        longest = max(map(len, plans), default=0)
        self._steps: IntArray = np.full((len(plans), longest + 1), _END, dtype=np.int64)
        for row, plan in zip(self._steps, plans, strict=True):
            row[: len(plan)] = plan
        self._wait = actions.encode("wait")
        self._submissions = np.flatnonzero(actions.table[:, 0] == SUBMIT)
        self._plan: IntArray = np.zeros(0, dtype=np.int64)
        self._next: IntArray = np.zeros(0, dtype=np.int64)

    def choose(self, observation: ObservationArray, members: IntArray) -> IntArray:
        """Return [B] the indices of the sequences for new episodes; here, their environment indices."""
        return members

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        assert mask is not None, "the manager has discrete actions"
        lacking = int(members.max()) + 1 - len(self._next)
        if lacking > 0:
            self._next, self._plan = (np.pad(array, (0, lacking)) for array in (self._next, self._plan))
            self.started = np.resize(self.started, (len(self._next), self.started.shape[1]))
        new = step == 0
        if new.any():
            self.started[members[new]] = 0
            self._plan[members[new]] = self.choose(observation[new], members[new])
            self._next[members[new]] = 0
        plan, position, rows = self._plan[members], self._next[members], np.arange(len(members))
        may_wait = mask[:, self._wait] != 0
        while True:
            planned = self._steps[plan, position]
            legal = (planned != _END) & (mask[rows, planned] != 0)
            skipped = (planned != _END) & ~legal & ~may_wait
            if not skipped.any():
                break
            position += skipped
        self._next[members] = position + legal
        starts = np.flatnonzero(legal & (self._table[planned, 0] == START))
        self.started[members[starts], self._table[planned[starts], 1]] += 1
        submissions = mask[:, self._submissions] != 0
        submit = np.where(submissions.any(axis=1), self._submissions[submissions.argmax(axis=1)], mask.argmax(axis=1))
        return np.where(legal, planned, np.where(may_wait, self._wait, submit))


class ConstantPlan(Playback):
    """Open-loop manager with one plan for each public context; see :class:`Playback` for actions that are not legal.

    Args:
        scenario: the public scenario.
        channels: the manager's observation channels, of which only the initial goals are read.
        actions: the manager's actions.
        plans: plans by context.

    Raises:
        ValueError: a context of the scenario has no plan.
    """

    def __init__(
        self, scenario: Scenario, channels: Sequence[Channel], actions: ManagerActions, plans: Mapping[Context, Plan]
    ) -> None:
        contexts = all_contexts(scenario)
        lacking = [context for context in contexts if context not in plans]
        if lacking:
            raise ValueError(
                f"plan: {scenario.name} may draw the goals {', '.join(lacking[0])}, which have no plan; "
                f"search for plans: chemlab audit plan {scenario.argument} --out FILE.json, and play them: "
                "--policy scripted,manager=plan:FILE.json"
            )
        super().__init__(actions, [plans[context] for context in contexts])
        slices = channel_slices(channels)
        self._orders = [slices[name] for name, _ in order_channels(scenario)]
        self._contexts = {context: number for number, context in enumerate(contexts)}
        self._goals = scenario.lab_goals
        self._columns = [scenario.goals.index(goal) for goal in scenario.lab_goals]

    def choose(self, observation: ObservationArray, members: IntArray) -> IntArray:
        """Return [B] the index of the context in each observation [B, size].

        For orders that have not arrived, the first possible goal is assumed.
        """
        goals = np.stack([observation[:, part][:, self._columns].argmax(axis=1) for part in self._orders], axis=1)
        return np.array([self._contexts[tuple(self._goals[g] for g in row)] for row in goals], dtype=np.int64)


# -- stored plans -----------------------------------------------------------------------------------------------------


class StoredPlan(DataModel):
    """The plan of one context, with actions as in :meth:`~chemlab.roles.manager_actions.ManagerActions.decode`."""

    goals: list[str]
    score: float
    steps: list[Annotated[list[str | int], Field(max_length=8)]] = Field(max_length=10_000)


class PlanFile(DataModel):
    """Content of a plan file.

    Attributes:
        scenario: name of the scenario.
        benches: policy of the benches during the search, as in ``--policy``.
        command: command that repeats the search.
        versions: versions of chemlab, numpy and Python.
        tried: number of evaluated plans.
        evaluation: ``episodes``, ``seed`` and the score's ``value``, ``low`` and ``high``.
        plans: one plan for each context.
    """

    kind: Literal["plan"]
    format: Literal[1]
    scenario: str
    benches: str
    command: str
    versions: dict[str, str]
    tried: int
    evaluation: dict[str, int | float | None]
    plans: list[StoredPlan]

    def decoded(self, actions: ManagerActions) -> dict[Context, Plan]:
        """Return the plans as action indices of a laboratory.

        Raises:
            ValueError: the laboratory has no such action; the message lists the alternatives.
        """
        try:
            return {
                tuple(plan.goals): tuple(actions.encode(str(kind), *rest) for kind, *rest in plan.steps)
                for plan in self.plans
            }
        except (TypeError, ValueError) as error:
            raise ValueError(f"plan of {self.scenario}: does not fit this laboratory: {error}") from error


def _folder() -> Path:
    return Path(str(importlib.resources.files(__package__ or "chemlab.agents") / "models" / "plans"))


def plan_file(scenario: str, benches: str) -> Path:
    """Return the path of the bundled plan file for a scenario and benches, which need not exist."""
    return _folder() / f"{scenario}.{benches}.json"


def stored_plans() -> list[Path]:
    """Return the bundled plan files."""
    return sorted(_folder().glob("*.json"))


def load_plans(path: Path) -> PlanFile:
    """Read a plan file.

    Raises:
        ValueError: the file does not exist or is not a plan file.
    """
    content = read_json(path)
    try:
        return validated(PlanFile, content, str(path))
    except DataError as error:
        raise DataError(
            f"{path}: cannot be read: not a file of plans of this version; see `chemlab audit plan --out`\n{error}"
        ) from error


def plan_for(laboratories: Laboratories, benches: str = "scripted", file: str | None = None) -> ConstantPlan:
    """Return an open-loop policy for a laboratory's manager: a bundled one, or that of a file.

    Args:
        laboratories: the laboratories of the manager.
        benches: policy of the benches.
        file: path of a file written by ``chemlab audit plan --out``; None: the bundled plan.

    Raises:
        ValueError: no plan is bundled for this scenario and these benches, or the plan does not fit.
    """
    labs, path = laboratories, Path(file or "")
    if file is None:
        benches = current_name(benches)
        path = plan_file(labs.scenario.name, benches)
        if not path.exists():
            known = ", ".join(file.stem for file in stored_plans()) or "none"
            raise ValueError(
                f"plan: none is stored for {labs.scenario.name} with benches {benches!r} (stored: {known}); "
                f"search for one: chemlab audit plan {labs.scenario.argument} --benches {shlex.quote(benches)} --out "
                f"FILE.json, and play it: --policy {shlex.quote(benches)},manager=plan:FILE.json"
            )
    plans = load_plans(path)
    try:
        return ConstantPlan(labs.scenario, labs.channels, labs.actions, plans.decoded(labs.actions))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
