"""What the manager sees: outsides of vessels, readings it has paid for, benches, stock, orders."""

from __future__ import annotations

from typing import NamedTuple

from ..bench.base import BoolArray, Channel, ObservationArray
from ..bench.instruments import InstrumentTable
from ..physics.jit import kernel
from ..physics.transfer import volume
from ..scenario import Scenario
from ..shelf import CAPACITY, PRESENT, TEMPERATURE, Chemistry, FloatArray, IntArray
from .manager import Desk, Rules

__all__ = ["Sight", "manager_channels", "manager_observe", "order_channels"]

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


class Sight(NamedTuple):
    """What of the desk, the rules and the chemistry the manager sees; handing over all of them takes longer than
    looking. Fields are those of :class:`~chemlab.laboratory.manager.Desk`,
    :class:`~chemlab.laboratory.manager.Rules` and :class:`~chemlab.shelf.Chemistry`."""

    last_bench: IntArray
    last_role: IntArray
    reading: FloatArray
    age: IntArray
    goal: IntArray
    filled: BoolArray
    charges: FloatArray
    actions: IntArray
    ticks: IntArray
    reading_start: IntArray
    limit: IntArray
    stocked: IntArray
    first_stock: FloatArray
    role: IntArray
    molar_volume: FloatArray
    slots: int
    benches: int
    goals: int
    tick_limit: int
    action_limit: int
    budget: float
    largest_capacity: float

    @classmethod
    def of(cls, desk: Desk, rules: Rules, chemistry: Chemistry) -> Sight:
        """Views of the arrays, and the numbers."""
        own = {"goals": rules.parts.shape[0], "role": chemistry.role, "molar_volume": chemistry.molar_volume}
        known = {**rules._asdict(), **desk._asdict(), **own}
        return cls(**{name: known[name] for name in cls._fields})


@kernel
def manager_observe(
    members: IntArray,
    busy: BoolArray,
    goals: IntArray,
    steps: IntArray,
    sight: Sight,
    rows: FloatArray,
    per_lab: int,
    stock: FloatArray,
    roles: int,
    out: ObservationArray,
) -> None:
    """Write what the manager sees into ``out`` [B, observation size]: outsides of vessels, readings, benches, stock."""
    n_goals, n_instruments = sight.goals, sight.age.shape[2]
    for i in range(members.shape[0]):
        n = members[i]
        out[i, :] = 0.0
        at = 0
        for s in range(sight.slots):
            row = rows[n * per_lab + s]
            if row[PRESENT] > 0.0:
                out[i, at] = 1.0
                out[i, at + 1] = min(volume(row, sight) / row[CAPACITY], 1.0)
                out[i, at + 2] = min(max((row[TEMPERATURE] - _COLDEST_K) / (_HOTTEST_K - _COLDEST_K), 0.0), 1.0)
                out[i, at + 3] = min(row[CAPACITY] / sight.largest_capacity, 1.0)
                out[i, at + 4 + sight.last_bench[n, s]] = 1.0
                if sight.last_bench[n, s] > 0:
                    out[i, at + 5 + sight.benches + sight.last_role[n, s]] = 1.0
            at += 5 + sight.benches + roles
            for k in range(n_instruments):
                start, stop = sight.reading_start[k], sight.reading_start[k + 1]
                age = sight.age[n, s, k]
                if age >= 0:
                    for r in range(start, stop):
                        out[i, at + r - start] = sight.reading[n, s, r]
                at += stop - start
                out[i, at] = 1.0 if age < 0 else min(age / sight.tick_limit, 1.0)
                at += 1
        for b in range(busy.shape[0]):
            if busy[b, n]:
                out[i, at] = 1.0
                out[i, at + 1 + goals[b, n]] = 1.0
                out[i, at + 1 + n_goals] = 1.0 - steps[b, n] / sight.limit[b]
            at += 2 + n_goals
        for k in range(sight.stocked.shape[0]):
            m = sight.stocked[k]
            out[i, at] = min(max(stock[n, m] / sight.first_stock[m], 0.0), 1.0) if sight.first_stock[m] > 0.0 else 0.0
            at += 1
        for o in range(sight.goal.shape[1]):
            out[i, at + sight.goal[n, o]] = 0.0 if sight.filled[n, o] else 1.0
            at += n_goals
        out[i, at] = max(1.0 - sight.charges[n, 0] / sight.budget, 0.0)
        out[i, at + 1] = max(1.0 - sight.actions[n] / sight.action_limit, 0.0)
        out[i, at + 2] = max(1.0 - sight.ticks[n] / sight.tick_limit, 0.0)
