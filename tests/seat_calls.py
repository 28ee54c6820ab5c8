"""Scripted callers of seats: what a policy would play, as calls of verbs."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from chemlab.agents.policies import agent_policy
from chemlab.agents.seats import Room
from chemlab.agents.verbs import Verb

Call = tuple[str, dict[str, Any]]


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


def play_scripted(room: Room, most: int = 2000) -> list[tuple[str, str, dict[str, Any]]]:
    """Play an episode to its end with the scripted policies at every seat; returns the calls made."""
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
        made.append((agent, verb, given))
    raise AssertionError(f"the episode is not over after {most} calls")
