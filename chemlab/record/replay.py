"""Replay of a record's actions on the simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..config.datafile import DataError
from ..config.draws import SPLITS
from ..config.parts import strangers_code
from ..config.scenario import Scenario
from ..lab.engine import Laboratories
from ..lab.hidden import NumberedWorld
from ..roles.manager_state import RUNNING
from .format import Header, HeaderError, Record, RecordError, recorded_scenario, short
from .recorder import Play


class Replay:
    """Replays a record's episode on the simulator turn by turn.

    Args:
        record: the record.
        trust: allow imports of benches and other parts that the record's scenario names (``module:Name``,
            ``file.py:Name``). Without it they raise an error, because a record may come from an unknown author.
        split: ``private:SALT``, for a record of a private split.
        beside: scenario beside whose file the parts ``file.py:Name`` are; default: they are beside the record.

    Attributes:
        laboratories: the laboratories after the turns played so far.
        split_known: False for a private split without its salt: the recorded world is used, not that of the seed.

    Raises:
        RecordError: the episode cannot be replayed here; the message states what is missing.
    """

    def __init__(
        self, record: Record, trust: bool = False, split: str | None = None, beside: Scenario | None = None
    ) -> None:
        self.record = record
        scenario = recorded_scenario(record)
        if beside is not None:
            scenario._origin = beside.origin
        header = record.checked_header()
        private = header.split == "private"
        if header.split not in (None, "private", *SPLITS):
            known = ", ".join([*SPLITS, "private"])
            raise HeaderError(f"{record.path}: header: split: must be {known}, given {short(header.split)}")
        self.split_known = not private or split is not None
        chosen = (split or "private:" + "0" * 32) if private else header.split or "train"
        try:
            with strangers_code(allowed=trust):
                self.laboratories = Laboratories(scenario, 1, split=chosen)
        except DataError as error:
            raise RecordError(short(str(error), 500)) from error
        self.rounds = header.rounds
        try:
            self._reset(header)
        except ValueError as error:
            raise HeaderError(short(f"{record.path}: header: {error}", 500)) from error

    def _reset(self, header: Header) -> None:
        labs, world = self.laboratories, header.options.get("world")
        labs.worlds.check(world)
        # If the world's number does not follow from the seed, use the recorded number, which determines the values.
        # A world requested by its seed follows from that seed if its split is known.
        unknown = not self.split_known or (header.seed is None and not isinstance(world, int))
        if labs.worlds.active and unknown:
            hidden: Any = header.hidden.get("world")
            if not isinstance(hidden, dict):
                raise ValueError("hidden.world: number is missing")
            number: Any = hidden.get("number")
            world = NumberedWorld(number, None if isinstance(world, int) else world)
        labs.seed(0, header.seed or 0)
        labs.reset(labs.members, header.options.get("goal"), world)
        # Without a seed, the random streams continued from an earlier episode; without a salt, they are unknown.
        if header.seed is None or not self.split_known:  # use the recorded ones
            if list(header.streams) != labs.agents:
                raise ValueError(f"streams: keys must be {', '.join(labs.agents)}, given {short(list(header.streams))}")
            if len(header.goals) != labs.scenario.orders:
                raise ValueError(f"goals: must have {labs.scenario.orders} entries, given {len(header.goals)}")
            goal = header.options.get("goal")
            if goal is not None and set(header.goals) != {goal}:
                raise ValueError(f"goals: must be {goal}, as requested in options, given {short(header.goals)}")
            for role in labs.roles:
                role.stream[0, 0] = header.streams[role.name]
            labs.state.goal[0] = [labs.goal_index(name) for name in header.goals]

    def play(self, turn: Mapping[str, Any]) -> list[Play]:
        """Play one recorded turn, and return each agent's observation and action.

        Args:
            turn: the recorded line.

        Raises:
            ValueError: the turn is not possible, because another agent has the turn or the action does not exist.
        """
        labs, recorded = self.laboratories, turn.get("play")
        if not isinstance(recorded, dict):
            raise ValueError("play: is missing or empty")
        if labs.state.status[0] != RUNNING:
            raise ValueError("play: the episode is over")
        numbers = np.flatnonzero(labs.turns(labs.members)[:, 0]).tolist() if self.rounds else [labs.turn()]
        agents = [labs.agents[number] for number in numbers]
        if list(recorded) != agents:
            raise ValueError(f"play: {', '.join(agents)} had the turn, not {short(', '.join(recorded)) or 'no agent'}")
        plays, actions = [], [np.zeros(0)] * len(labs.agents)
        for number, agent in zip(numbers, agents, strict=True):
            entry = recorded[agent]
            if not isinstance(entry, list) or len(entry) != 2:
                raise ValueError(f"play.{agent}: must be an observation's hash and an action, given {short(entry)}")
            if not isinstance(entry[1], (int, list)):
                raise ValueError(f"play.{agent}.1: must be an action, given {short(entry[1])}")
            try:
                action = labs.checked(number, np.array(entry[1]) if isinstance(entry[1], list) else entry[1])
            except (TypeError, ValueError) as error:  # may contain the text of a whole array
                raise ValueError(short(str(error), 200)) from error
            mask = labs.mask(number, labs.members)
            seen = labs.observe(number, labs.members)[0]
            plays.append(Play(number, seen, None if mask is None else mask[0], action[0]))
            actions[number] = action
        try:
            if self.rounds:
                labs.act_round(labs.members, actions)
            else:
                labs.act(numbers[0], labs.members, actions[numbers[0]])
        except ArithmeticError as error:  # the reactions are too stiff
            raise ValueError(short(str(error), 500)) from error
        return plays
