"""The laboratory in plain text, for terminals and logs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..config.scenario import Scenario
from ..roles.manager_state import COST_ITEMS, RUNNING, STATUS_WORDS
from .engine import Laboratories

__all__ = ["action_words", "describe_laboratory", "measured_words", "named_costs", "named_events", "reading_words"]

_BAR = 20


def named_events(scenario: Scenario, info: Mapping[str, Any]) -> dict[str, float]:
    """The safety events of an agent's info by kind; only those that happened."""
    amounts = info["events"].tolist()
    return {kind: amount for kind, amount in zip(scenario.safety_events, amounts, strict=True) if amount}


def named_costs(info: Mapping[str, Any]) -> dict[str, float]:
    """The costs of the manager's info by item, in units of the score."""
    return dict(zip(COST_ITEMS, info["costs"].tolist(), strict=True))


def action_words(laboratories: Laboratories, agent: int, action: Any) -> str:
    """What an action does, in words; of continuous ones, what they change.

    Args:
        laboratories: the laboratories.
        agent: number of the agent whose action it is.
        action: an int, or the numbers of a continuous action.
    """
    labs = laboratories
    if agent == 0:
        return labs.actions.action_meanings[int(action)]
    bench = labs.benches[agent - 1]
    if bench.action_count:
        return bench.action_meanings[int(action)]
    values = [float(value) for value in action]
    names = getattr(bench, "reagent_names", None)
    if names is None:
        return ", ".join(f"{value:.2f}" for value in values)
    words = []
    for label, value in zip(("temperature", "volume"), values, strict=False):
        if abs(value - 0.5) > 5e-3:
            words.append(f"{label} {'up' if value > 0.5 else 'down'} {abs(2.0 * value - 1.0):.0%}")
    words += [
        f"add {value:.0%} of the {name} left" for name, value in zip(names, values[2:], strict=True) if value > 5e-3
    ]
    return ", ".join(words) or "hold"


def reading_words(laboratories: Laboratories, slot: int, instrument: str, member: int = 0) -> str:
    """The manager's last reading of an instrument on a slot, in words, with its price."""
    labs, table = laboratories, laboratories.instruments
    i = table.names.index(instrument)
    values = labs.state.reading[member, slot, table.start[i] : table.start[i + 1]]
    return f"{measured_words(labs, i, values)}; price {table.price[i]:g}"


def measured_words(laboratories: Laboratories, instrument: int, values: Any) -> str:
    """A reading in words.

    Args:
        laboratories: whose instruments they are.
        instrument: number of the instrument.
        values: the reading, in [0, 1].
    """
    return laboratories.instruments.words(instrument, values)


def describe_laboratory(laboratories: Laboratories, member: int) -> str:
    """Shelf, benches, goal and costs of one laboratory: its outside, as its agents could see it.

    Args:
        laboratories: the laboratories.
        member: which one.
    """
    labs, state, scenario = laboratories, laboratories.state, laboratories.scenario
    status = STATUS_WORDS[int(state.status[member])]
    turn = labs.agents[labs.turn(member)] if state.status[member] == RUNNING else "nobody"
    lines = [
        f"{scenario.title} - goal {scenario.goals[state.goal[member, 0]]} - {status}",
        f"manager actions {state.actions[member]}/{scenario.limits.manager_actions}, "
        f"ticks {state.ticks[member]}/{scenario.limits.ticks}, turn: {turn}",
    ]
    keys = list(scenario.benches)
    for s in range(scenario.shelf.slots):
        vessel = labs.shelf.vessel(member, s)
        if not vessel.present:
            holder = int(state.reserved[member, s])
            lines.append(f"  slot {s}  {'(kept for ' + labs.bench_agents[holder] + ')' if holder >= 0 else '-'}")
            continue
        fill = min(vessel.volume_l / vessel.capacity_l, 1.0)
        bar = "#" * round(fill * _BAR)
        kind = int(state.last_bench[member, s])
        history = ""
        if kind > 0:
            bench = next(bench for bench in labs.benches if bench.key == keys[kind - 1])
            history = f"  from {bench.key} {bench.positions[state.last_position[member, s]]}"
        read = [name for i, name in enumerate(labs.instruments.names) if state.age[member, s, i] >= 0]
        measured = f"  measured: {', '.join(read)}" if read else ""
        lines.append(f"  slot {s}  [{bar:<{_BAR}}] {vessel.volume_l:.2f}/{vessel.capacity_l:.2f} L{history}{measured}")
    for bench, experiments in zip(labs.benches, labs.experiments, strict=True):
        if experiments.busy[member]:
            goal = scenario.goals[experiments.goal[member]]
            doing = f"step {experiments.steps[member]}/{bench.spec.step_limit}, goal {goal}"
        else:
            doing = "idle"
        lines.append(f"  {experiments.agent:<7} {doing}")
    costs = ", ".join(f"{item} {value:.4f}" for item, value in labs.costs(member).items() if value > 0.0)
    lines.append(f"  costs: {costs or 'none'}")
    return "\n".join(lines)
