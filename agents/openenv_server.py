"""One seat of a room as an OpenEnv environment, whose actions are calls of tools: ``uvicorn server.app:app``."""

import functools
from typing import Any

from openenv.core.env_server import mcp_types as types
from openenv.core.env_server.http_server import create_app
from openenv.core.env_server.interfaces import Environment
from openenv.core.env_server.types import Observation, State

from .seats import Room


class SeatEnvironment(Environment):
    """A seat of a room of its own; the reward is the score at the end.

    Args:
        seat: the agent.
        options: of :class:`~chemlab.agents.seats.Room`.
    """

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, seat: str = "manager_0", **options: Any) -> None:
        super().__init__()
        self._seat, self._options = seat, options

    @functools.cached_property
    def _room(self) -> Room:
        """The room, begun when it is first used: a server also makes environments only to describe them."""
        return Room(seats=(self._seat,), **self._options)

    def reset(self, seed: int | None = None, episode_id: str | None = None, **options: Any) -> Observation:
        """Begin an episode with a seed of the room's own; a seed that is given is ignored, because seeds are secret."""
        if "_room" in vars(self):
            self._room.begin()
        text = f"{self._room.brief(self._seat)}\n\n{self._room.turn()[1]}"
        return types.CallToolObservation(tool_name="reset", result=text, done=self._room.over, reward=0.0)

    def step(self, action: Any, timeout_s: float | None = None, **options: Any) -> Observation:
        """List the seat's verbs, or call one."""
        if isinstance(action, types.ListToolsAction):
            return types.ListToolsObservation(tools=[types.Tool(**tool) for tool in self._room.tools(self._seat)])
        over = self._room.over
        reply = self._room.call(self._seat, action.tool_name, action.arguments)
        reward = self._room.score if reply.done and not over else 0.0
        return types.CallToolObservation(tool_name=action.tool_name, result=reply.text, done=reply.done, reward=reward)

    @property
    def state(self) -> State:
        """Number of calls."""
        return State(step_count=self._room.report()["seats"][self._seat]["calls"])

    def close(self) -> None:
        """End the episode."""
        if "_room" in vars(self):
            self._room.close()


def seat_app(**options: Any) -> Any:
    """The server's application, with an environment for each session; options as for :class:`SeatEnvironment`."""
    make = functools.partial(SeatEnvironment, **options)
    return create_app(make, types.CallToolAction, types.CallToolObservation, env_name="chemlab", max_concurrent_envs=16)
