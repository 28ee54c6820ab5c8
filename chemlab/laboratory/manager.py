"""The manager's side of a laboratory: what its actions do to the arrays, and what it sees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..bench.base import BoolArray, Channel, MaskArray, ObservationArray, goal_amount, weighted_amount
from ..bench.instruments import InstrumentTable, read_instrument
from ..physics.jit import helper, kernel
from ..physics.partition import partition
from ..physics.phases import settle_phases
from ..physics.transfer import clear, move, remove_fraction, volume
from ..scenario import Scenario
from ..shelf import (
    CAPACITY,
    CLOCK,
    CLOCK_SETTLED,
    PRESENT,
    ROLE_GAS,
    TEMPERATURE,
    Chemistry,
    FloatArray,
    IntArray,
    StreamArray,
)
from .actions import DISCARD, MEASURE, RECALL, START, SUBMIT

__all__ = [
    "COST_ITEMS",
    "Desk",
    "Rules",
    "advance",
    "close_actions",
    "itemize",
    "manager_act",
    "manager_channels",
    "manager_mask",
    "manager_observe",
    "rest_on_shelf",
    "return_vessels",
]

COST_ITEMS: tuple[str, ...] = ("instruments", "stock", "waste", "time", "illegal_actions", "safety")
"""What the manager's score is charged for, in units of the score."""

RUNNING, TERMINATED, TRUNCATED = range(3)
MANAGER = -1
"""Cursor value while the manager has the turn."""

_COLDEST_K, _HOTTEST_K = 200.0, 800.0


class Desk(NamedTuple):
    """The manager's arrays. N laboratories, S slots, B stations, I instruments, R numbers of all readings."""

    reserved: IntArray
    """[N, S] station a slot is reserved for, -1 if none"""
    last_bench: IntArray
    """[N, S] 0 for none, else 1 + index of the bench kind the vessel last was at"""
    last_role: IntArray
    """[N, S] position it had there"""
    reading: FloatArray
    """[N, S, R] last reading of every instrument"""
    age: IntArray
    """[N, S, I] ticks since that reading, -1 for never"""
    origin: IntArray
    """[N, B] slot the running experiment's main vessel came from"""
    goal: IntArray
    """[N] the laboratory's goal, an index into the scenario's goals"""
    actions: IntArray
    """[N] manager actions so far"""
    ticks: IntArray
    """[N] ticks so far"""
    cursor: IntArray
    """[N] station whose turn it is, or MANAGER"""
    finished: BoolArray
    """[N] whether an experiment has ended in this tick"""
    status: IntArray
    """[N] RUNNING, TERMINATED or TRUNCATED"""
    charges: FloatArray
    """[N, len(COST_ITEMS)] costs so far (stock and waste are filled in by itemize)"""
    submitted: FloatArray
    """[N, 2] mol of the goal and its purity in the submitted vessel"""
    stream: StreamArray
    """[N, 1] random stream of goals and instruments"""
    illegal: BoolArray
    """[N] whether the manager's last action was masked"""
    begun: IntArray
    """[N] station that the manager's last action started, -1 if none"""
    recalled: IntArray
    """[N] station that it recalled, -1 if none"""

    @classmethod
    def empty(cls, laboratories: int, slots: int, stations: int, readings: int, instruments: int) -> Desk:
        """Zeroed arrays."""
        n = laboratories
        whole = np.int64
        return cls(
            np.full((n, slots), -1, dtype=whole),
            np.zeros((n, slots), dtype=whole),
            np.zeros((n, slots), dtype=whole),
            np.zeros((n, slots, readings)),
            np.full((n, slots, instruments), -1, dtype=whole),
            np.zeros((n, stations), dtype=whole),
            np.zeros(n, dtype=whole),
            np.zeros(n, dtype=whole),
            np.zeros(n, dtype=whole),
            np.full(n, MANAGER, dtype=whole),
            np.zeros(n, dtype=np.bool_),
            np.zeros(n, dtype=whole),
            np.zeros((n, len(COST_ITEMS))),
            np.zeros((n, 2)),
            np.zeros((n, 1), dtype=np.uint64),
            np.zeros(n, dtype=np.bool_),
            np.full(n, -1, dtype=whole),
            np.full(n, -1, dtype=whole),
        )


class Rules(NamedTuple):
    """The scenario's numbers that manager kernels need."""

    table: IntArray
    """[A, 4] the manager's actions"""
    slots: int
    first: IntArray
    """[B] first vessel position of each station"""
    positions: IntArray
    """[B] number of vessels each station works on"""
    bench_of: IntArray
    """[B] index of the station's bench kind"""
    benches: int
    """number of bench kinds"""
    limit: IntArray
    """[B] step limits"""
    parts: IntArray
    """[G, 3] see Goals.parts"""
    counts: FloatArray
    """[G, M] see Goals.absolute_counts"""
    molar_mass: FloatArray
    """[M] g/mol"""
    first_stock: FloatArray
    """[M] mol in the bottles when an episode begins"""
    stocked: IntArray
    """indices of materials that have a bottle"""
    stock_price: FloatArray
    """[M] score per mol"""
    instrument_kind: IntArray
    reading_start: IntArray
    price: FloatArray
    sample: FloatArray
    noise: FloatArray
    analytes: IntArray
    waste_per_l: float
    tick_price: float
    illegal_price: float
    budget: float
    action_limit: int
    tick_limit: int
    largest_capacity: float


@helper
def _count_slots(n: int, base: int, desk: Desk, rules: Rules, rows: FloatArray) -> tuple[int, int]:
    """(free slots, occupied slots); a slot reserved for a vessel at a bench is neither."""
    free, occupied = 0, 0
    for s in range(rules.slots):
        if rows[base + s, PRESENT] > 0.0:
            occupied += 1
        elif desk.reserved[n, s] < 0:
            free += 1
    return free, occupied


@helper
def _allowed(
    n: int,
    a: int,
    base: int,
    slots: tuple[int, int],
    any_busy: bool,
    busy: BoolArray,
    desk: Desk,
    rules: Rules,
    rows: FloatArray,
) -> bool:
    kind, x, y = rules.table[a, 0], rules.table[a, 1], rules.table[a, 2]
    if kind == START:
        return not busy[x, n] and rows[base + y, PRESENT] > 0.0 and slots[0] >= rules.positions[x] - 1
    if kind == MEASURE:
        affordable = desk.charges[n, 0] + rules.price[y] <= rules.budget + 1e-12
        return bool(rows[base + x, PRESENT] > 0.0 and affordable)
    if kind == DISCARD:  # the last vessel stays: without one there would be nothing left to do
        return bool(rows[base + x, PRESENT] > 0.0 and (slots[1] > 1 or any_busy))
    if kind == SUBMIT:
        return bool(rows[base + x, PRESENT] > 0.0)
    if kind == RECALL:
        return bool(busy[x, n])
    return any_busy


@helper
def _any_busy(n: int, busy: BoolArray) -> bool:
    found = False
    for b in range(busy.shape[0]):
        found = found or busy[b, n]
    return found


@kernel
def manager_mask(
    members: IntArray, busy: BoolArray, desk: Desk, rules: Rules, rows: FloatArray, per_lab: int, out: MaskArray
) -> None:
    """Write the manager's legal actions into ``out`` [B, A]."""
    for i in range(members.shape[0]):
        n = members[i]
        base = n * per_lab
        slots, any_busy = _count_slots(n, base, desk, rules, rows), _any_busy(n, busy)
        for a in range(rules.table.shape[0]):
            out[i, a] = _allowed(n, a, base, slots, any_busy, busy, desk, rules, rows)


@kernel
def rest_on_shelf(row: FloatArray, chem: Chemistry, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """A vessel put on the shelf: ambient temperature, settled, at precipitation equilibrium. ``work`` is [2, L]."""
    row[TEMPERATURE] = chem.ambient_temperature
    row[CLOCK] = CLOCK_SETTLED
    settle_phases(row, chem, waste, events, work[0])
    partition(row, chem, work)


@helper
def _forget(n: int, s: int, desk: Desk) -> None:
    """The slot holds another vessel, or none: its history and readings are gone."""
    desk.last_bench[n, s] = 0
    desk.last_role[n, s] = 0
    desk.reading[n, s, :] = 0.0
    desk.age[n, s, :] = -1


@kernel
def manager_act(
    members: IntArray,
    actions: IntArray,
    busy: BoolArray,
    desk: Desk,
    rules: Rules,
    rows: FloatArray,
    per_lab: int,
    waste: FloatArray,
    chem: Chemistry,
    layers: IntArray,
    shares: FloatArray,
    work: FloatArray,
) -> None:
    """Carry out one manager action in each laboratory of ``members``; see the desk's flags for what it led to."""
    for i in range(members.shape[0]):
        n, a = members[i], actions[i]
        base = n * per_lab
        desk.begun[n], desk.recalled[n] = -1, -1
        desk.actions[n] += 1
        slots = _count_slots(n, base, desk, rules, rows)
        desk.illegal[n] = not _allowed(n, a, base, slots, _any_busy(n, busy), busy, desk, rules, rows)
        if desk.illegal[n]:
            desk.charges[n, 4] += rules.illegal_price
            continue
        kind, x, y = rules.table[a, 0], rules.table[a, 1], rules.table[a, 2]
        if kind == START:
            move(rows[base + y], rows[base + rules.first[x]])
            desk.origin[n, x] = y
            desk.reserved[n, y] = x
            wanted = rules.positions[x] - 1
            for s in range(rules.slots):
                if wanted > 0 and rows[base + s, PRESENT] <= 0.0 and desk.reserved[n, s] < 0:
                    desk.reserved[n, s] = x
                    wanted -= 1
            desk.begun[n] = x
        elif kind == MEASURE:
            start, stop = rules.reading_start[y], rules.reading_start[y + 1]
            read_instrument(
                rules.instrument_kind[y],
                rows[base + x],
                rules.sample[y],
                rules.noise[y],
                rules.analytes,
                rules.molar_mass,
                chem,
                desk.stream[n],
                waste[n],
                layers,
                shares,
                work,
                desk.reading[n, x, start:stop],
            )
            desk.age[n, x, y] = 0
            desk.charges[n, 0] += rules.price[y]
        elif kind == DISCARD:
            remove_fraction(rows[base + x], 1.0, chem, waste[n])
            clear(rows[base + x])
            _forget(n, x, desk)
        elif kind == SUBMIT:
            part = rules.parts[desk.goal[n]]
            amount = goal_amount(rows[base + x], part)
            total = weighted_amount(rows[base + x], rules.counts[desk.goal[n]])
            desk.submitted[n, 0] = amount
            desk.submitted[n, 1] = amount / total if total > 0.0 else 0.0
            desk.status[n] = TERMINATED
        elif kind == RECALL:
            desk.recalled[n] = x
        else:
            first = 0
            while not busy[first, n]:
                first += 1
            desk.cursor[n] = first
            desk.finished[n] = False


@kernel
def close_actions(members: IntArray, desk: Desk, rules: Rules) -> None:
    """After manager actions: truncate where they have been used up."""
    for i in range(members.shape[0]):
        n = members[i]
        if desk.status[n] == RUNNING and desk.actions[n] >= rules.action_limit:
            desk.status[n] = TRUNCATED


@kernel
def return_vessels(
    members: IntArray,
    b: int,
    desk: Desk,
    rules: Rules,
    rows: FloatArray,
    per_lab: int,
    waste: FloatArray,
    events: FloatArray,
    chem: Chemistry,
    work: FloatArray,
) -> None:
    """Bring what station ``b`` worked on back to the shelf: the main vessel to where it came from, the others to the
    slots reserved for them; empty ones are washed and gone."""
    for i in range(members.shape[0]):
        n = members[i]
        base = n * per_lab
        for p in range(rules.positions[b]):
            row = rows[base + rules.first[b] + p]
            slot = desk.origin[n, b]
            if p > 0:
                slot = -1
                if volume(row, chem) > 0.0:
                    for s in range(rules.slots - 1, -1, -1):
                        if desk.reserved[n, s] == b and s != desk.origin[n, b]:
                            slot = s
            if slot >= 0:
                rest_on_shelf(row, chem, waste[n], events[n], work)
                move(row, rows[base + slot])
                if p > 0:
                    _forget(n, slot, desk)
                desk.last_bench[n, slot] = 1 + rules.bench_of[b]
                desk.last_role[n, slot] = p
                desk.reserved[n, slot] = -1
            clear(row)
        for s in range(rules.slots):
            if desk.reserved[n, s] == b:
                desk.reserved[n, s] = -1


@kernel
def advance(members: IntArray, busy: BoolArray, desk: Desk, rules: Rules) -> None:
    """Pass the turn on after a bench has acted: to the next busy bench, or to the manager once the tick is over and
    an experiment has ended."""
    for i in range(members.shape[0]):
        n = members[i]
        b = desk.cursor[n] + 1
        while b < busy.shape[0] and not busy[b, n]:
            b += 1
        if b < busy.shape[0]:
            desk.cursor[n] = b
            continue
        desk.ticks[n] += 1
        desk.charges[n, 3] += rules.tick_price
        for s in range(rules.slots):
            for k in range(desk.age.shape[2]):
                if desk.age[n, s, k] >= 0:
                    desk.age[n, s, k] += 1
        if desk.ticks[n] >= rules.tick_limit:
            desk.status[n] = TRUNCATED
            desk.cursor[n] = MANAGER
        elif desk.finished[n] or not _any_busy(n, busy):
            desk.cursor[n] = MANAGER
        else:
            b = 0
            while not busy[b, n]:
                b += 1
            desk.cursor[n] = b


@kernel
def itemize(members: IntArray, desk: Desk, rules: Rules, stock: FloatArray, waste: FloatArray, chem: Chemistry) -> None:
    """Fill in the costs that follow from amounts: stock used and waste made."""
    for i in range(members.shape[0]):
        n = members[i]
        used, litres = 0.0, 0.0
        for m in range(stock.shape[1]):
            used += max(rules.first_stock[m] - stock[n, m], 0.0) * rules.stock_price[m]
            if chem.role[m] != ROLE_GAS:
                litres += waste[n, m] * chem.molar_volume[m]
        desk.charges[n, 1] = used
        desk.charges[n, 2] = litres * rules.waste_per_l


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
        Channel("goal", len(scenario.goals), "one-hot", 0.0, 1.0, "laboratory goal: " + ", ".join(scenario.goals)),
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
                for r in range(rules.reading_start[k], rules.reading_start[k + 1]):
                    out[i, at] = desk.reading[n, s, r]
                    at += 1
                age = desk.age[n, s, k]
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
        out[i, at + desk.goal[n]] = 1.0
        at += n_goals
        out[i, at] = max(1.0 - desk.charges[n, 0] / rules.budget, 0.0)
        out[i, at + 1] = max(1.0 - desk.actions[n] / rules.action_limit, 0.0)
        out[i, at + 2] = max(1.0 - desk.ticks[n] / rules.tick_limit, 0.0)
