"""Scripted callers of seats, and the tokens of their episodes: ``python -m studies.tools.seats [SCENARIO ...]``.

A scripted policy at every seat plays by calling verbs. Tokens are those of the vocabulary ``o200k_base``, which the
package bpe-openai contains (``pip install bpe-openai``).
"""

from __future__ import annotations

import functools
import statistics
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from chemlab.agents.policies import agent_policy
from chemlab.agents.seats import Room
from chemlab.config.display import markdown_table

Call = tuple[str, dict[str, Any]]


def call_for(room: Room, agent: str, action: Any) -> Call:
    """The call that stands for an action."""
    if isinstance(action, np.ndarray) and action.ndim:
        step = next(verb for verb in room.verbs(agent) if verb.name == "step")
        moves = zip(step.arguments[:2], action[:2].tolist(), strict=True)
        changes = {move.name: (2.0 * value - 1.0) * move.high for move, value in moves}
        return "step", changes | {a.name: v for a, v in zip(step.arguments[2:], action[2:].tolist(), strict=True)}
    return _calls(room, agent)[int(action)]


@functools.lru_cache(maxsize=64)
def _calls(room: Room, agent: str) -> dict[int, Call]:
    """All calls of an agent's discrete verbs, by the action that they stand for."""
    found: dict[int, Call] = {}
    for verb in room.verbs(agent):
        for given, action in verb.ways():
            found.setdefault(action, (verb.name, given))
    return found


def play_scripted(
    room: Room, most: int = 5000, seen: Callable[[str, str, bool], None] = lambda seat, text, replied: None
) -> list[tuple[str, str, dict[str, Any]]]:
    """Play an episode to its end with the scripted policies at every seat; returns the calls made.

    Args:
        room: at the beginning of an episode.
        most: calls, after which it gives up.
        seen: called with every seat and text: False for one that tells it that it has the turn, True for a reply.
    """
    labs: Any = room.laboratories
    policies = {seat: agent_policy("scripted", labs, labs.agents.index(seat)) for seat in room.seats}
    made: list[tuple[str, str, dict[str, Any]]] = []
    for _ in range(most):
        agent, text = room.turn()
        if not agent:
            return made
        if not made or made[-1][0] != agent:
            seen(agent, text, False)
        number = labs.agents.index(agent)
        mask = labs.mask(number, labs.members)
        step = labs.roles[number].turns_had
        action = policies[agent].act(labs.observe(number, labs.members), mask, step, labs.members)[0]
        verb, given = call_for(room, agent, action)
        reply = room.call(agent, verb, given)
        assert not reply.error, reply.text
        seen(agent, reply.text, True)
        made.append((agent, verb, given))
    raise AssertionError(f"the episode is not over after {most} calls")


def measure(name: str, count: Callable[[str], int]) -> list[str]:
    """One row of the table: tokens of an episode with a scripted policy at every seat."""
    from chemlab.lab.engine import Laboratories

    room = Room(name, Laboratories(name).agents, salt="70" * 16, seed=0)
    briefs = [count(room.brief(seat)) for seat in room.seats]
    replies: list[int] = []
    looks = [count(room.call(seat, "look").text) for seat in room.seats]
    sizes = dict.fromkeys(room.seats, 0)

    def seen(seat: str, text: str, replied: bool) -> None:
        sizes[seat] += count(text)
        if replied:
            replies.append(count(text))
        if not room.over:
            looks.append(count(room.call(seat, "look").text))

    play_scripted(room, seen=seen)
    columns = [
        max(briefs),
        round(statistics.median(looks)),
        max(looks),
        round(statistics.median(replies)),
        max(replies),
    ]
    return [name, *map(str, columns), str(len(replies)), str(max(sizes.values()))]


def main(names: list[str]) -> None:
    """Print the table, as Markdown."""
    import bpe_openai

    from chemlab.config.inherit import scenario_names

    encoding = bpe_openai.get_encoding("o200k_base")
    columns = "scenario", "brief", "look, median", "look, max", "reply, median", "reply, max", "calls"
    rows = [measure(name, lambda text: len(encoding.encode(text))) for name in names or scenario_names()]
    print("\n".join(markdown_table(dict.fromkeys((*columns, "episode of a seat, max"), False), rows)))


if __name__ == "__main__":
    main(sys.argv[1:])
