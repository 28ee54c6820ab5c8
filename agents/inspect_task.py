"""Seats of a room as a task of inspect_ai: ``inspect eval chemlab.agents.inspect_task -T scenario=unlabelled``."""

from typing import Any

try:
    import anyio.to_thread
    from inspect_ai import Task, task
    from inspect_ai.dataset import Sample
    from inspect_ai.model import ChatMessage, ChatMessageSystem, ChatMessageUser, execute_tools, get_model
    from inspect_ai.scorer import Score, Scorer, Target, mean, scorer, stderr
    from inspect_ai.solver import Generate, Solver, TaskState, solver
    from inspect_ai.tool import Tool, ToolDef, ToolError, ToolParams
except ImportError as error:
    raise ImportError('inspect_ai is missing: pip install "chemlab-marl[inspect]"') from error

from .seats import Room, input_schema
from .verbs import Verb

__all__ = ["laboratory", "play_seats", "raw_score"]


@task
def laboratory(
    scenario: str = "wurtz_dodecane", seats: str | list[str] = "manager_0", episodes: int = 10, **options: Any
) -> Task:
    """A task whose samples are episodes; a seat's model is ``--model-role SEAT=MODEL``, else the task's model.

    Args:
        scenario: a shipped name.
        seats: agents that models play.
        episodes: number of samples.
        options: of :class:`~chemlab.agents.seats.Room`; ``seed`` is that of the first episode.
    """
    names, first = [seats] if isinstance(seats, str) else seats, options.pop("seed", None)
    samples = [
        Sample(
            input=f"{scenario}: {', '.join(names)}", id=k + 1, metadata={"seed": None if first is None else first + k}
        )
        for k in range(episodes)
    ]
    return Task(dataset=samples, solver=play_seats(scenario, names, **options), scorer=raw_score())


@solver
def play_seats(scenario: str, seats: list[str], **options: Any) -> Solver:
    """Play an episode: each seat is a conversation of its own, and the seat that has the turn is asked for a call.

    A seat has 1000 calls, unless ``options`` say otherwise. An output without a call counts as a refused one.
    """

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        room = Room(scenario, seats, **{"calls": 1000, **options, "seed": state.metadata["seed"]})
        tools = {seat: [_tool(room, seat, verb) for verb in room.verbs(seat)] for seat in seats}
        talks: dict[str, list[ChatMessage]] = {seat: [ChatMessageSystem(content=room.brief(seat))] for seat in seats}
        before = ""
        while (now := room.turn())[0]:
            agent, view = now
            if agent != before:
                talks[agent].append(ChatMessageUser(content=view))
            before = agent
            output = await get_model(role=agent).generate(talks[agent], tools[agent])
            room.spent(agent, output.usage.total_tokens if output.usage else 0)
            talks[agent].append(output.message)
            answers = (await execute_tools(talks[agent], tools[agent])).messages
            talks[agent] += answers or [ChatMessageUser(content=room.call(agent, "").text)]
        state.messages, state.completed = [one for seat in seats for one in talks[seat]], True
        state.store.set("report", room.report())
        return state

    return solve


def _tool(room: Room, seat: str, verb: Verb) -> Tool:
    async def call(**kwargs: Any) -> str:
        reply = await anyio.to_thread.run_sync(room.call, seat, verb.name, kwargs)
        if reply.error:
            raise ToolError(reply.text)
        return str(reply.text)

    return ToolDef(call, verb.name, verb.meaning, ToolParams.model_validate(input_schema(verb))).as_tool()


@scorer(metrics=[mean(), stderr()])
def raw_score() -> Scorer:
    """The laboratory's raw score, with what stands beside it as metadata."""

    async def score(state: TaskState, target: Target) -> Score:
        report = state.store.get("report")
        return Score(value=report["score"], metadata=report)

    return score
