"""Turn-by-turn history of a record: observations, actions, consequences, and the start and end of experiments.

Records store actions and hashes. All other values are recomputed by a replay on the simulator.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..kernels.arrays import MaskArray, ObservationArray
from ..record import Play, RecordError, Replay
from ..roles.manager_state import RUNNING


class Look(NamedTuple):
    """Observation and action mask of one agent."""

    observation: ObservationArray
    mask: MaskArray | None


@dataclass(frozen=True)
class Move:
    """A turn, or a simultaneous round of several agents, that was just played."""

    tick: int
    """laboratory tick before the turn"""
    plays: list[Play]
    manager: tuple[str | int, ...]
    """the manager's decoded action; empty if benches acted or the action was invalid"""
    lost: tuple[str, ...]
    """agents whose action was invalid"""
    rewards: dict[str, float]
    cost: dict[str, float]
    started: str
    """agent whose experiment started in this turn, or an empty string"""
    scores: dict[str, float]
    """scores of the experiments that ended in this turn, by agent"""
    last: dict[str, Look] = field(default_factory=dict)
    """observations of agents whose experiment ended, after their last action and before the end of the experiment"""


class RecordReplay(Replay):
    """A replay that yields the moves of a record in order, with their consequences.

    Arguments, attributes and errors are those of :class:`chemlab.record.Replay`.
    """

    def look(self, agent: int) -> Look:
        """Return an agent's current observation and mask."""
        labs = self.laboratories
        mask = labs.mask(agent, labs.members)
        return Look(labs.observe(agent, labs.members)[0], None if mask is None else mask[0])

    @property
    def over(self) -> bool:
        """True once the episode has ended."""
        return bool(self.laboratories.state.status[0] != RUNNING)

    def moves(self) -> Iterator[Move]:
        """Replay the record and yield its moves.

        Raises:
            RecordError: a turn is not possible or cannot be read; the message names the turn or the line.
        """
        labs = self.laboratories
        for number, turn in enumerate(self.record.turns):
            tick, busy, before = int(labs.state.ticks[0]), labs.state.busy[:, 0].copy(), labs.snapshot()
            try:
                plays = self.play(turn)
            except (ValueError, TypeError) as error:
                raise RecordError(f"{self.record.path}: turn {number}: {error} (see chemlab verify)") from error
            by_manager = plays[0].agent == labs.manager.index
            lost = tuple(labs.agents[play.agent] for play in plays if labs.roles[play.agent].illegal[0])
            ended = [labs.bench_roles[b].index for b in np.flatnonzero(busy & ~labs.state.busy[:, 0])]
            started = np.flatnonzero(~busy & labs.state.busy[:, 0])
            yield Move(
                tick=tick,
                plays=plays,
                manager=labs.actions.decode(int(plays[0].action)) if by_manager and not lost else (),
                lost=lost,
                rewards=dict(zip(labs.agents, labs.rewards[0].tolist(), strict=True)),
                cost=dict(zip(labs.agents, labs.cost[0].tolist(), strict=True)),
                started=labs.bench_agents[started[0]] if len(started) else "",
                scores={labs.agents[agent]: float(labs.scores[0, agent]) for agent in ended},
                last={labs.agents[agent]: self._last_look(before, plays, agent) for agent in ended},
            )

        if self.record.broken is not None:
            line, problem = self.record.broken
            raise RecordError(f"{self.record.path}: line {line} {problem} (see chemlab verify)")

    def _last_look(self, before: list[Any], plays: Sequence[Play], agent: int) -> Look:
        """Return the last observation of an agent whose experiment has ended.

        The bench is idle by then. The turn is therefore replayed up to the agent's action.
        """
        labs = self.laboratories
        after = labs.snapshot()
        labs.restore(before)
        for play in plays:
            for role in labs.bench_roles:  # a recall has no action of the bench
                if role.index == play.agent:
                    role.workplace.act(labs.shelf, role.experiments, labs.members, np.asarray(play.action)[None])
            if play.agent == agent:
                break
        last = self.look(agent)
        labs.restore(after)
        return last
