"""Seats of a room as a task of inspect_ai: ``inspect eval chemlab/laboratory -T scenario=unlabelled``."""

from typing import Any

from anyio.to_thread import run_sync
from inspect_ai import Task, task
from inspect_ai.dataset import Sample
from inspect_ai.model import ChatMessage, ChatMessageSystem, ChatMessageUser, execute_tools, get_model
from inspect_ai.scorer import Score, Scorer, Target, mean, scorer, stderr
from inspect_ai.solver import Generate, Solver, TaskState, solver
from inspect_ai.tool import Tool, ToolDef, ToolError, ToolParams

from .seats import Room


# inspect_ai prefixes the package of modules in site-packages, not that of an editable install with another name.
@task(name="laboratory" if "-packages" in __file__ else "chemlab/laboratory")
def laboratory(
    scenario: str = "wurtz_dodecane", seats: str | list[str] = "manager_0", episodes: int = 10, **options: Any
) -> Task:
    """Episodes as samples, with ``options`` of Room; a seat's model is ``--model-role SEAT=MODEL``, else the task's."""
    names, first = [seats] if isinstance(seats, str) else seats, options.pop("seed", None)
    seeds = [None if first is None else first + k for k in range(episodes)]
    samples = [Sample(f"{scenario}: {', '.join(names)}", metadata={"seed": seed}) for seed in seeds]
    return Task(dataset=samples, solver=play_seats(scenario, names, **options), scorer=raw_score())


@solver
def play_seats(scenario: str, seats: list[str], **options: Any) -> Solver:
    """Play an episode: each seat is a conversation. An output without a call counts as a refused call of 1000."""

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        room = Room(scenario, seats, **{"calls": 1000, **options, "seed": state.metadata["seed"]})
        tools = {seat: [_tool(room, seat, tool) for tool in room.tools(seat)] for seat in seats}
        talks: dict[str, list[ChatMessage]] = {seat: [ChatMessageSystem(content=room.brief(seat))] for seat in seats}
        before = ""
        try:
            while (now := room.turn())[0]:
                agent, view = now
                talk = talks[agent]
                if agent != before:
                    talk.append(ChatMessageUser(content=view))
                before = agent
                output = await get_model(role=agent).generate(talk, tools[agent])
                room.spent(agent, output.usage.total_tokens if output.usage else 0)
                talk.append(output.message)
                answers = (await execute_tools(talk, tools[agent])).messages
                talk += answers or [ChatMessageUser(content=room.call(agent, "").text)]
        finally:  # a limit of inspect ends the sample by an exception; what it has reached is scored
            room.close()
            state.metadata["report"] = room.report()
            state.messages = [one for seat in seats for one in talks[seat]]
        return state

    return solve


def _tool(room: Room, seat: str, tool: dict[str, Any]) -> Tool:
    async def call(**kwargs: Any) -> str:
        reply = await run_sync(room.call, seat, tool["name"], kwargs)
        if reply.error:
            raise ToolError(reply.text)
        return str(reply.text)

    return ToolDef(call, tool["name"], tool["description"], ToolParams(**tool["input_schema"])).as_tool()


@scorer(metrics=[mean(), stderr()])
def raw_score() -> Scorer:
    """The laboratory's raw score, with what stands beside it as metadata."""

    async def score(state: TaskState, target: Target) -> Score:
        report = state.metadata["report"]
        return Score(value=report["score"], metadata=report)

    return score
