"""Seats of a room as a taskset and an environment of verifiers: ``vf-eval chemlab-seats``."""

import json
from contextlib import AsyncExitStack
from typing import Any

import verifiers.v1 as vf
from anyio.to_thread import run_sync
from pydantic import Field

from .seats import Room, call_of

_EXAMPLE = '{"verb": "look", "arguments": {}}'


class LaboratoryConfig(vf.TasksetConfig):
    """Scenario, seats, number of episodes, and options of :class:`~chemlab.agents.seats.Room`."""

    scenario: str = "wurtz_dodecane"
    seats: tuple[str, ...] = ("manager_0",)
    episodes: int = 10
    options: dict[str, Any] = Field(default_factory=dict)


class Laboratory(vf.Taskset[vf.Task, LaboratoryConfig]):
    """Episodes of one scenario as tasks; one is like another, because every room draws its own world."""

    def load(self) -> list[vf.Task]:
        """The tasks."""
        return [vf.Task(vf.TaskData(name=f"{self.config.scenario} {k}")) for k in range(self.config.episodes)]


class SeatsConfig(vf.EnvConfig):
    """The models of the manager's seat and of benches' seats; they answer with text, which holds a call."""

    manager: vf.AgentConfig = vf.AgentConfig(harness={"id": "null"}, runtime={"type": "subprocess"})
    bench: vf.AgentConfig = vf.AgentConfig(harness={"id": "null"}, runtime={"type": "subprocess"})


class Seats(vf.Env[SeatsConfig]):
    """Every seat is an interaction of its own, all with the laboratory's score as reward."""

    async def run(self, task: vf.Task, agents: vf.Agents) -> None:
        """Play an episode; one ends early where an interaction does."""
        config, before, text = self.taskset.config, "", ""
        room = Room(config.scenario, config.seats, **{"calls": 1000, **config.options})
        async with AsyncExitStack() as stack:
            stack.callback(room.close)  # also where a model fails
            talks = {}
            for seat in room.seats:
                player = agents.manager if seat == "manager_0" else agents.bench
                prompt = (
                    f"{room.brief(seat)}\nTools: {json.dumps(room.tools(seat))}\nEnd answers with a call: {_EXAMPLE}"
                )
                data = vf.TaskData(name=task.data.name, system_prompt=prompt)
                talks[seat] = await stack.enter_async_context(player.interaction(vf.Task(data)))
            while (now := room.turn())[0]:
                agent, view = now
                segment = await talks[agent].turn(text if agent == before else view)
                if segment.terminated:
                    break
                used = talks[agent].trace.calls[-1].usage
                room.spent(agent, used.input_tokens + used.completion_tokens if used else 0)
                text = (await run_sync(room.call, agent, *call_of(segment.last_reply))).text
                before = agent
            room.close()
            for seat, talk in talks.items():
                talk.trace.record_reward("raw_score", room.score)
                for name, count in room.report()["seats"][seat].items():
                    talk.trace.record_metric(name, float(count))
