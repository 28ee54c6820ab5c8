"""A seat as an environment of aviary, and through it of NeMo Gym. Run with fhaviary 0.37.0."""

from __future__ import annotations

from typing import Any

from aviary.core import Environment, Message, Messages, Tool, ToolRequestMessage

from chemlab.agents.seats import LabTools, Room


class Seat(Environment[Room]):
    """A seat in a room; the reward is the score at the end."""

    def __init__(self, seat: str = "manager_0", **options: Any) -> None:
        self.state = Room(seats=(seat,), **options)
        self.seat = seat

    async def reset(self) -> tuple[Messages, list[Tool]]:
        """Return the introduction and the tools of the episode that the room has begun."""
        tools = LabTools(self.state, self.seat)
        self.tools = [Tool.from_function(getattr(tools, verb.name)) for verb in self.state.verbs(self.seat)]
        return [Message(content=f"{self.state.brief(self.seat)}\n\n{self.state.turn()[1]}")], self.tools

    async def step(self, action: ToolRequestMessage) -> tuple[Messages, float, bool, bool]:
        """Call tools in order; a refused call is answered with its error."""
        replies = await self.exec_tool_calls(action, concurrency=False, handle_tool_exc=True)
        return list(replies), self.state.score if self.state.over else 0.0, self.state.over, False

    def export_frame(self) -> Any:
        """Return what the room reports."""
        return self.state.report()
