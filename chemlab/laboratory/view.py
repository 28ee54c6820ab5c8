"""What the manager sees: outsides of vessels, readings it has paid for, benches, stock, orders."""

from __future__ import annotations

from ..bench.base import BoolArray, Channel, ObservationArray
from ..bench.instruments import InstrumentTable
from ..physics.jit import kernel
from ..physics.transfer import volume
from ..scenario import Scenario
from ..shelf import CAPACITY, PRESENT, TEMPERATURE, Chemistry, FloatArray, IntArray
from .manager import Desk, Rules

__all__ = ["manager_channels", "manager_observe", "order_channels"]

_COLDEST_K, _HOTTEST_K = 200.0, 800.0


def order_channels(scenario: Scenario) -> list[tuple[str, str]]:
    """(channel name, meaning) of each order's goal; a filled order shows zeros."""
    if scenario.orders == 1:
        return [("goal", "laboratory goal")]
    return [(f"goal_{o}", f"goal of order {o}, zeros once it is filled") for o in range(scenario.orders)]


def manager_channels(
    scenario: Scenario, instruments: InstrumentTable, roles: int, largest_capacity: float
) -> list[Channel]:
    """What the manager sees, in order."""
    channels = []
    for s in range(scenario.shelf.slots):
        benches = ", ".join(scenario.benches)
        channels += [
            Channel(f"slot_{s}_occupied", 1, "0 or 1", 0.0, 1.0, "whether a vessel stands here"),
            Channel(f"slot_{s}_fill", 1, "fraction", 0.0, 1.0, "how full it is"),
            Channel(f"slot_{s}_temperature", 1, "K", _COLDEST_K, _HOTTEST_K, "its temperature"),
            Channel(f"slot_{s}_capacity", 1, "L", 0.0, largest_capacity, "its capacity"),
            Channel(
                f"slot_{s}_last_bench", 1 + len(scenario.benches), "one-hot", 0.0, 1.0, f"last at: none, {benches}"
            ),
            Channel(f"slot_{s}_last_role", roles, "one-hot", 0.0, 1.0, "as: main vessel, B1, B2"),
        ]
        for channel in instruments.channels:
            meaning = f"last reading: {channel.meaning}"
            channels.append(
                Channel(f"slot_{s}_{channel.name}", channel.size, channel.unit, channel.low, channel.high, meaning)
            )
            limit = float(scenario.limits.ticks)
            channels.append(
                Channel(f"slot_{s}_{channel.name}_age", 1, "ticks", 0.0, limit, "its age; 1 = never measured")
            )
    for agent in scenario.bench_agents():
        channels += [
            Channel(f"{agent}_busy", 1, "0 or 1", 0.0, 1.0, "whether an experiment is running"),
            Channel(
                f"{agent}_goal", len(scenario.goals), "one-hot", 0.0, 1.0, "its goal: " + ", ".join(scenario.goals)
            ),
            Channel(f"{agent}_steps_left", 1, "fraction", 0.0, 1.0, "of its step limit"),
        ]
    channels += [
        Channel("stock", len(scenario.stock), "fraction", 0.0, 1.0, "left of: " + ", ".join(scenario.stock)),
        *(
            Channel(name, len(scenario.goals), "one-hot", 0.0, 1.0, f"{meaning}: " + ", ".join(scenario.goals))
            for name, meaning in order_channels(scenario)
        ),
        Channel("budget", 1, "fraction", 0.0, 1.0, "left of the budget for measurements"),
        Channel("actions", 1, "fraction", 0.0, 1.0, "left of the manager's actions"),
        Channel("ticks", 1, "fraction", 0.0, 1.0, "left of the ticks"),
    ]
    return [channel for channel in channels if channel.size > 0]


@kernel
def manager_observe(
    members: IntArray,
    busy: BoolArray,
    goals: IntArray,
    steps: IntArray,
    desk: Desk,
    rules: Rules,
    rows: FloatArray,
    per_lab: int,
    stock: FloatArray,
    roles: int,
    chem: Chemistry,
    out: ObservationArray,
) -> None:
    """Write what the manager sees into ``out`` [B, observation size]: outsides of vessels, readings, benches, stock."""
    n_goals, n_instruments = rules.parts.shape[0], desk.age.shape[2]
    for i in range(members.shape[0]):
        n = members[i]
        out[i, :] = 0.0
        at = 0
        for s in range(rules.slots):
            row = rows[n * per_lab + s]
            if row[PRESENT] > 0.0:
                out[i, at] = 1.0
                out[i, at + 1] = min(volume(row, chem) / row[CAPACITY], 1.0)
                out[i, at + 2] = min(max((row[TEMPERATURE] - _COLDEST_K) / (_HOTTEST_K - _COLDEST_K), 0.0), 1.0)
                out[i, at + 3] = min(row[CAPACITY] / rules.largest_capacity, 1.0)
                out[i, at + 4 + desk.last_bench[n, s]] = 1.0
                if desk.last_bench[n, s] > 0:
                    out[i, at + 5 + rules.benches + desk.last_role[n, s]] = 1.0
            at += 5 + rules.benches + roles
            for k in range(n_instruments):
                start, stop = rules.reading_start[k], rules.reading_start[k + 1]
                age = desk.age[n, s, k]
                if age >= 0:
                    for r in range(start, stop):
                        out[i, at + r - start] = desk.reading[n, s, r]
                at += stop - start
                out[i, at] = 1.0 if age < 0 else min(age / rules.tick_limit, 1.0)
                at += 1
        for b in range(busy.shape[0]):
            if busy[b, n]:
                out[i, at] = 1.0
                out[i, at + 1 + goals[b, n]] = 1.0
                out[i, at + 1 + n_goals] = 1.0 - steps[b, n] / rules.limit[b]
            at += 2 + n_goals
        for k in range(rules.stocked.shape[0]):
            m = rules.stocked[k]
            out[i, at] = min(max(stock[n, m] / rules.first_stock[m], 0.0), 1.0) if rules.first_stock[m] > 0.0 else 0.0
            at += 1
        for o in range(desk.goal.shape[1]):
            out[i, at + desk.goal[n, o]] = 0.0 if desk.filled[n, o] else 1.0
            at += n_goals
        out[i, at] = max(1.0 - desk.charges[n, 0] / rules.budget, 0.0)
        out[i, at + 1] = max(1.0 - desk.actions[n] / rules.action_limit, 0.0)
        out[i, at + 2] = max(1.0 - desk.ticks[n] / rules.tick_limit, 0.0)
