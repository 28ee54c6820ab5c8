"""One seat of a room as an OpenEnv environment, whose actions are calls of tools: ``uvicorn server.app:app``."""

import functools
from typing import Any

try:
    from openenv.core.env_server.http_server import create_app
    from openenv.core.env_server.interfaces import Environment
    from openenv.core.env_server.mcp_types import (
        CallToolAction,
        CallToolObservation,
        ListToolsAction,
        ListToolsObservation,
        Tool,
    )
    from openenv.core.env_server.types import Observation, State
except ImportError as error:
    raise ImportError('openenv is missing: pip install "chemlab-marl[openenv]"') from error

from chemlab.lab.engine import MANAGER_AGENT

from .seats import Room, input_schema

__all__ = ["SeatEnvironment", "seat_app"]


class SeatEnvironment(Environment):
    """A seat of a room of its own; the reward is the score at the end.

    Args:
        scenario: a shipped name.
        seat: the agent.
        options: of :class:`~chemlab.agents.seats.Room`.
    """

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, scenario: str = "wurtz_dodecane", seat: str = MANAGER_AGENT, **options: Any) -> None:
        super().__init__()
        self._scenario, self._seat, self._options = scenario, seat, options

    @functools.cached_property
    def _room(self) -> Room:
        """The room, begun when it is first used: a server also makes environments only to describe them."""
        return Room(self._scenario, (self._seat,), **self._options)

    def reset(self, seed: int | None = None, episode_id: str | None = None, **options: Any) -> Observation:
        """Begin an episode with a seed of the room's own; a seed that is given is ignored, because seeds are secret."""
        if "_room" in vars(self):
            self._room.begin()
        text = f"{self._room.brief(self._seat)}\n\n{self._room.turn()[1]}"
        return CallToolObservation(tool_name="reset", result=text, done=self._room.over, reward=0.0)

    def step(self, action: Any, timeout_s: float | None = None, **options: Any) -> Observation:
        """List the seat's verbs, or call one."""
        if isinstance(action, ListToolsAction):
            verbs = self._room.verbs(self._seat)
            tools = [Tool(name=one.name, description=one.meaning, input_schema=input_schema(one)) for one in verbs]
            return ListToolsObservation(tools=tools)
        over = self._room.over
        reply = self._room.call(self._seat, action.tool_name, action.arguments)
        reward = self._room.score if reply.done and not over else 0.0
        return CallToolObservation(tool_name=action.tool_name, result=reply.text, done=reply.done, reward=reward)

    @property
    def state(self) -> State:
        """Number of calls."""
        return State(step_count=self._room.report()["seats"][self._seat]["calls"])

    def close(self) -> None:
        """End the episode."""
        if "_room" in vars(self):
            self._room.close()


def seat_app(**options: Any) -> Any:
    """The server's application; options as for :class:`SeatEnvironment`."""
    make = lambda: SeatEnvironment(**options)  # noqa: E731 - one environment for each session
    return create_app(make, CallToolAction, CallToolObservation, env_name="chemlab", max_concurrent_envs=16)
