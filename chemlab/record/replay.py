"""A record's actions on the simulator again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..config.draws import SPLITS
from ..config.materials import DataError
from ..config.parts import strangers_code
from ..lab.engine import Laboratories
from ..lab.hidden import NumberedWorld
from ..roles.manager_state import RUNNING
from ..roles.models import ReactionModel, SeparationModel
from .format import Header, HeaderError, Record, RecordError, recorded_scenario, short
from .recorder import Play

__all__ = ["Replay"]


class Replay:
    """A record's episode on the simulator again, turn by turn.

    Args:
        record: the record.
        trust: import benches and other parts that the record's scenario names (``module:Name``, ``file.py:Name``);
            without it that is an error, because a file from elsewhere should not decide what Python runs.
        reaction_model, separation_model: the user's own physics, where the record was made with such.
        split: ``private:SALT``, for a record of a private split.

    Attributes:
        laboratories: as it stands after the turns played so far.
        split_known: whether its world follows from its seed; of a private split without the salt, it is as recorded.

    Raises:
        RecordError: the episode cannot be played here; the message says what is missing.
    """

    def __init__(
        self,
        record: Record,
        trust: bool = False,
        reaction_model: ReactionModel | None = None,
        separation_model: SeparationModel | None = None,
        split: str | None = None,
    ) -> None:
        self.record = record
        scenario = recorded_scenario(record)
        header = record.checked_header()
        given = {"reaction_model": reaction_model, "separation_model": separation_model}
        for key, name in header.models.items():
            if given.get(key) is None:
                raise RecordError(f"{record.path}: was made with {key} {short(name)}: give it to verify_record()")
        private = header.split == "private"
        if header.split not in (None, "private", *SPLITS):
            known = ", ".join([*SPLITS, "private"])
            raise HeaderError(f"{record.path}: header: split: must be {known}, given {short(header.split)}")
        self.split_known = not private or split is not None
        chosen = (split or "private:unknown") if private else header.split or "train"
        try:
            with strangers_code(allowed=trust):
                self.laboratories = Laboratories(scenario, 1, reaction_model, separation_model, chosen)
        except DataError as error:
            raise RecordError(short(str(error), 500)) from error
        self.rounds = header.rounds
        try:
            self._reset(header)
        except ValueError as error:
            raise HeaderError(short(f"{record.path}: header: {error}", 500)) from error

    def _reset(self, header: Header) -> None:
        labs, world = self.laboratories, header.options.get("world")
        if world is not None:
            labs.worlds.check(world)
        # Where a world's number does not follow from the seed, it is the record's; its values follow from the number.
        # A world that was asked for by its seed follows from that, if its split is known.
        unknown = not self.split_known or (header.seed is None and not isinstance(world, int))
        if labs.worlds.active and unknown:
            hidden: Any = header.hidden.get("world")
            if not isinstance(hidden, dict):
                raise ValueError("hidden.world: says nothing of its number")
            number: Any = hidden.get("number")
            world = NumberedWorld(number, None if isinstance(world, int) else world)
        labs.seed(0, header.seed or 0)
        labs.reset(labs.members, header.options.get("goal"), world)
        if header.seed is None:  # the streams went on from an episode before: the record begins with what they were
            streams = [labs.state.stream, *(experiments.stream for experiments in labs.experiments)]
            if list(header.streams) != labs.agents:
                raise ValueError(f"streams: must be of {', '.join(labs.agents)}, given {short(list(header.streams))}")
            if len(header.goals) != labs.scenario.orders:
                raise ValueError(f"goals: must be {labs.scenario.orders}, given {len(header.goals)}")
            goal = header.options.get("goal")
            if goal is not None and set(header.goals) != {goal}:
                raise ValueError(f"goals: must be {goal}, which was asked for, given {short(header.goals)}")
            for agent, stream in zip(labs.agents, streams, strict=True):
                stream[0, 0] = header.streams[agent]
            labs.state.goal[0] = [labs.goal_index(name) for name in header.goals]

    def play(self, turn: Mapping[str, Any]) -> list[Play]:
        """Play one recorded turn; returns what each agent was shown and did.

        Raises:
            ValueError: such a turn is not possible: somebody else has the turn, or there is no such action.
        """
        labs, recorded = self.laboratories, turn.get("play")
        if not isinstance(recorded, dict):
            raise ValueError("play: says nothing of who played what")
        if labs.state.status[0] != RUNNING:
            raise ValueError("play: the episode is over")
        numbers = np.flatnonzero(labs.turns(labs.members)[:, 0]).tolist() if self.rounds else [labs.turn()]
        having = [labs.agents[number] for number in numbers]
        if list(recorded) != having:
            given = short(", ".join(recorded)) or "nobody"
            raise ValueError(f"play: {', '.join(having)} had the turn, not {given}")
        plays, actions = [], []
        for number, agent in zip(numbers, having, strict=True):
            entry = recorded[agent]
            if not isinstance(entry, list) or len(entry) != 2:
                raise ValueError(f"play.{agent}: must be an observation's hash and an action, given {short(entry)}")
            if not isinstance(entry[1], (int, list)):
                raise ValueError(f"play.{agent}.1: must be an action, given {short(entry[1])}")
            try:
                action = labs.checked(number, np.array(entry[1]) if isinstance(entry[1], list) else entry[1])
            except (TypeError, ValueError) as error:  # which may show all of an array
                raise ValueError(short(str(error), 200)) from error
            mask = labs.mask(number, labs.members)
            seen = labs.observe(number, labs.members)[0]
            plays.append(Play(number, seen, None if mask is None else mask[0], action[0]))
            actions.append(action)
        try:
            self._act(numbers, actions)
        except ArithmeticError as error:  # reactions that are too stiff
            raise ValueError(short(str(error), 500)) from error
        return plays

    def _act(self, numbers: Sequence[int], actions: Sequence[npt.NDArray[Any]]) -> None:
        labs = self.laboratories
        if self.rounds:
            everybody: list[npt.NDArray[Any]] = [np.zeros(0)] * len(labs.agents)
            for number, action in zip(numbers, actions, strict=True):
                everybody[number] = action
            labs.act_round(labs.members, everybody)
        else:
            labs.act(numbers[0], labs.members, actions[0])
