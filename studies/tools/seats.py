"""Scripted callers of seats, and the tokens of their episodes: ``python -m studies.tools.seats [SCENARIO ...]``.

A scripted policy at every seat plays by calling verbs. The table counts tokens with tiktoken's ``o200k_base`` where it
can be loaded (``TIKTOKEN_CACHE_DIR`` names a folder with its file), else as 1.4 times the number of words.
"""

from __future__ import annotations

import itertools
import statistics
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from chemlab.agents.policies import agent_policy
from chemlab.agents.seats import Room
from chemlab.agents.verbs import Verb

__all__ = ["call_for", "main", "play_scripted"]

Call = tuple[str, dict[str, Any]]


def tokenizer() -> tuple[str, Callable[[str], int]]:
    """(name, function that counts the tokens of a text)."""
    try:
        import tiktoken

        encoding = tiktoken.get_encoding("o200k_base")
        return "o200k_base", lambda text: len(encoding.encode(text))
    except Exception:  # it is not installed, or its file cannot be fetched
        return "1.4 x words", lambda text: round(1.4 * len(text.split()))


def call_for(room: Room, agent: str, action: Any) -> Call:
    """The call that stands for an action: found by trying all."""
    if isinstance(action, np.ndarray) and action.ndim:
        step = next(verb for verb in room.verbs(agent) if verb.name == "step")
        moves = zip(step.arguments[:2], action[:2].tolist(), strict=True)
        changes = {move.name: (2.0 * value - 1.0) * move.high for move, value in moves}
        return "step", changes | {a.name: v for a, v in zip(step.arguments[2:], action[2:].tolist(), strict=True)}
    for verb in room.verbs(agent):
        for given in choices(verb):
            if verb.action is not None and agrees(verb, given, int(action)):
                return verb.name, given
    raise AssertionError(f"{agent}: no verb plays {action}")


def choices(verb: Verb) -> list[dict[str, Any]]:
    names = [argument.name for argument in verb.arguments]
    return [dict(zip(names, values, strict=True)) for values in itertools.product(*(a.options for a in verb.arguments))]


def agrees(verb: Verb, given: dict[str, Any], action: int) -> bool:
    assert verb.action is not None
    try:
        return bool(verb.action(given) == action)
    except ValueError:
        return False


def play_scripted(
    room: Room, most: int = 5000, seen: Callable[[str, str], None] = lambda seat, text: None
) -> list[tuple[str, str, dict[str, Any]]]:
    """Play an episode to its end with the scripted policies at every seat; returns the calls made.

    Args:
        room: at the beginning of an episode.
        most: calls, after which it gives up.
        seen: called with every seat and reply.
    """
    labs: Any = room._labs
    policies = {seat: agent_policy("scripted", labs, labs.agents.index(seat)) for seat in room.seats}
    made = []
    for _ in range(most):
        agent, _ = room.turn()
        if not agent:
            return made
        number = labs.agents.index(agent)
        mask = labs.mask(number, labs.members)
        step = labs.turns_had(number)
        action = policies[agent].act(labs.observe(number, labs.members), mask, step, labs.members)[0]
        verb, given = call_for(room, agent, action)
        reply = room.call(agent, verb, given)
        assert not reply.error, reply.text
        seen(agent, reply.text)
        made.append((agent, verb, given))
    raise AssertionError(f"the episode is not over after {most} calls")


def measure(name: str, count: Callable[[str], int]) -> list[str]:
    """One row of the table: tokens of an episode with a scripted policy at every seat."""
    from chemlab.lab.engine import Laboratories

    room = Room(name, Laboratories(name).agents, salt="tokens", seed=0)
    briefs = [count(room.brief(seat)) for seat in room.seats]
    replies: list[int] = []
    looks = [count(room.call(seat, "look").text) for seat in room.seats]
    sizes = dict.fromkeys(room.seats, 0)

    def seen(seat: str, text: str) -> None:
        replies.append(count(text))
        sizes[seat] += replies[-1]
        looks.append(count(room.call(seat, "look").text) if not room.over else 0)

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
    from chemlab.config.loading import scenario_names

    kind, count = tokenizer()
    print(f"Tokens ({kind}):\n")
    print(
        "| scenario | brief | look, median | look, max | reply, median | reply, max | calls | episode of a seat, max |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in names or scenario_names():
        print(f"| {' | '.join(measure(name, count))} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
