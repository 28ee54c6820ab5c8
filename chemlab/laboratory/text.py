"""The laboratory in plain text, for terminals and logs."""

from __future__ import annotations

from .core import Laboratories
from .manager import RUNNING

__all__ = ["describe_laboratory"]

_BAR = 20


def describe_laboratory(laboratories: Laboratories, member: int) -> str:
    """Shelf, benches, goal and costs of one laboratory: its outside, as its agents could see it.

    Args:
        laboratories: the laboratories.
        member: which one.
    """
    labs, desk, scenario = laboratories, laboratories.desk, laboratories.scenario
    status = ("running", "submitted", "truncated")[int(desk.status[member])]
    turn = labs.agents[labs.turn(member)] if desk.status[member] == RUNNING else "nobody"
    lines = [
        f"{scenario.title} - goal {scenario.goals[desk.goal[member, 0]]} - {status}",
        f"manager actions {desk.actions[member]}/{scenario.limits.manager_actions}, "
        f"ticks {desk.ticks[member]}/{scenario.limits.ticks}, turn: {turn}",
    ]
    keys = list(scenario.benches)
    for s in range(scenario.shelf.slots):
        vessel = labs.shelf.vessel(member, s)
        if not vessel.present:
            holder = int(desk.reserved[member, s])
            lines.append(f"  slot {s}  {'(kept for ' + labs.bench_agents[holder] + ')' if holder >= 0 else '-'}")
            continue
        fill = min(vessel.volume_l / vessel.capacity_l, 1.0)
        bar = "#" * round(fill * _BAR)
        kind = int(desk.last_bench[member, s])
        history = ""
        if kind > 0:
            bench = next(bench for bench in labs.benches if bench.key == keys[kind - 1])
            history = f"  from {bench.key} {bench.positions[desk.last_role[member, s]]}"
        read = [name for i, name in enumerate(labs.instruments.names) if desk.age[member, s, i] >= 0]
        measured = f"  measured: {', '.join(read)}" if read else ""
        lines.append(f"  slot {s}  [{bar:<{_BAR}}] {vessel.volume_l:.2f}/{vessel.capacity_l:.2f} L{history}{measured}")
    for bench, station in zip(labs.benches, labs.stations, strict=True):
        if station.busy[member]:
            goal = scenario.goals[station.goal[member]]
            state = f"step {station.steps[member]}/{bench.spec.step_limit}, goal {goal}"
        else:
            state = "idle"
        lines.append(f"  {station.agent:<7} {state}")
    costs = ", ".join(f"{item} {value:.4f}" for item, value in labs.costs(member).items() if value > 0.0)
    lines.append(f"  costs: {costs or 'none'}")
    return "\n".join(lines)
