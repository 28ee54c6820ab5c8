"""The manager's side of a laboratory: whose turn it is, and what the manager's actions do to the arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..bench.base import BoolArray, MaskArray, goal_amount, weighted_amount
from ..bench.instruments import read_instrument
from ..physics.jit import helper, kernel
from ..physics.partition import partition
from ..physics.phases import settle_phases
from ..physics.transfer import clear, move, remove_fraction, volume
from ..shelf import (
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
    "BEGUN",
    "COST_ITEMS",
    "OVER",
    "RECALLED",
    "Desk",
    "MaskDesk",
    "MaskRules",
    "Rules",
    "advance",
    "book",
    "itemize",
    "manager_act",
    "manager_mask",
    "open_turn",
    "rest_on_shelf",
    "return_vessels",
    "turns",
]

COST_ITEMS: tuple[str, ...] = ("instruments", "stock", "waste", "time", "illegal_actions", "safety")
"""What the manager's score is charged for, in units of the score."""

RUNNING, TERMINATED, TRUNCATED = range(3)
MANAGER = -1
"""Cursor value while the manager has the turn."""
BEGUN, RECALLED, OVER = 1, 2, 4
"""What a turn led to: an experiment begun, one recalled, an episode over."""


class Desk(NamedTuple):
    """The manager's arrays. N laboratories, S slots, B stations, O orders, I instruments, R numbers of all
    readings, M materials."""

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
    """[N, O] what each order asks for, an index into the scenario's goals"""
    filled: BoolArray
    """[N, O] whether a vessel has been submitted for the order"""
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
    """[N, len(COST_ITEMS)] costs so far (stock and waste, which follow from amounts, at the end: see itemize)"""
    submitted: FloatArray
    """[N, O, 2] mol of the goal and its purity in the vessel submitted for each order"""
    delivered: FloatArray
    """[N, M] mol that have left with submitted vessels while the episode goes on"""
    stream: StreamArray
    """[N, 1] random stream of goals and instruments"""
    illegal: BoolArray
    """[N] whether the manager's last action was masked"""
    begun: IntArray
    """[N] station that the manager's last action started, -1 if none"""
    recalled: IntArray
    """[N] station that it recalled, -1 if none"""

    @classmethod
    def empty(
        cls, laboratories: int, slots: int, stations: int, orders: int, readings: int, instruments: int, materials: int
    ) -> Desk:
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
            np.zeros((n, orders), dtype=whole),
            np.zeros((n, orders), dtype=np.bool_),
            np.zeros(n, dtype=whole),
            np.zeros(n, dtype=whole),
            np.full(n, MANAGER, dtype=whole),
            np.zeros(n, dtype=np.bool_),
            np.zeros(n, dtype=whole),
            np.zeros((n, len(COST_ITEMS))),
            np.zeros((n, orders, 2)),
            np.zeros((n, materials)),
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


class MaskDesk(NamedTuple):
    """What of a :class:`Desk` decides what is legal: handing over all of it takes longer than finding out."""

    reserved: IntArray
    charges: FloatArray
    filled: BoolArray


class MaskRules(NamedTuple):
    """What of the :class:`Rules` decides what is legal."""

    table: IntArray
    slots: int
    positions: IntArray
    price: FloatArray
    budget: float


@helper
def _count_slots(
    n: int, base: int, desk: Desk | MaskDesk, rules: Rules | MaskRules, rows: FloatArray
) -> tuple[int, int]:
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
    desk: Desk | MaskDesk,
    rules: Rules | MaskRules,
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
        return bool(rows[base + x, PRESENT] > 0.0 and not desk.filled[n, y])
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
    members: IntArray, busy: BoolArray, desk: MaskDesk, rules: MaskRules, rows: FloatArray, per_lab: int, out: MaskArray
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
    maximum: FloatArray,
    share: float,
    reward: FloatArray,
    work: FloatArray,
) -> int:
    """Carry out one manager action in each laboratory of ``members``.

    ``maximum`` [G] is the theoretical maximum of each goal in mol; ``share`` of what a submission is worth is added to
    ``reward`` [N]. Returns the flags BEGUN, RECALLED and OVER of what it led to in any of them; the desk says in which.
    """
    flags = 0
    for i in range(members.shape[0]):
        n, a = members[i], actions[i]
        base = n * per_lab
        desk.begun[n], desk.recalled[n] = -1, -1
        desk.actions[n] += 1
        slots = _count_slots(n, base, desk, rules, rows)
        desk.illegal[n] = not _allowed(n, a, base, slots, _any_busy(n, busy), busy, desk, rules, rows)
        if desk.illegal[n]:
            desk.charges[n, 4] += rules.illegal_price
            if desk.actions[n] >= rules.action_limit:
                desk.status[n] = TRUNCATED
                flags |= OVER
            continue
        kind, x, y = rules.table[a, 0], rules.table[a, 1], rules.table[a, 2]
        if kind == START:
            move(rows[base + y], rows[base + rules.first[x]])
            _forget(n, y, desk)  # what comes back is not what was measured
            desk.origin[n, x] = y
            desk.reserved[n, y] = x
            wanted = rules.positions[x] - 1
            for s in range(rules.slots):
                if wanted > 0 and rows[base + s, PRESENT] <= 0.0 and desk.reserved[n, s] < 0:
                    desk.reserved[n, s] = x
                    wanted -= 1
            desk.begun[n] = x
            flags |= BEGUN
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
            goal = desk.goal[n, y]
            amount = goal_amount(rows[base + x], rules.parts[goal])
            total = weighted_amount(rows[base + x], rules.counts[goal])
            purity = amount / total if total > 0.0 else 0.0
            desk.submitted[n, y, 0] = amount
            desk.submitted[n, y, 1] = purity
            desk.filled[n, y] = True
            reward[n] += share * amount * purity / maximum[goal] / desk.goal.shape[1]
            open_orders = 0
            for o in range(desk.goal.shape[1]):
                open_orders += not desk.filled[n, o]
            # What is left of the shelf cannot fill an order once it and the benches are empty.
            if open_orders == 0 or (slots[1] == 1 and not _any_busy(n, busy)):
                desk.status[n] = TERMINATED
                flags |= OVER
            else:
                remove_fraction(rows[base + x], 1.0, chem, desk.delivered[n])
                clear(rows[base + x])
                _forget(n, x, desk)
        elif kind == RECALL:
            desk.recalled[n] = x
            flags |= RECALLED
        else:
            first = 0
            while not busy[first, n]:
                first += 1
            desk.cursor[n] = first
            desk.finished[n] = False
        if desk.status[n] == RUNNING and desk.actions[n] >= rules.action_limit:
            desk.status[n] = TRUNCATED
            flags |= OVER
    return flags


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
def open_turn(members: IntArray, rewards: FloatArray, cost: FloatArray, scores: FloatArray) -> None:
    """Nobody has earned anything yet: clear the laboratories' columns of the [agents, N] arrays."""
    for i in range(members.shape[0]):
        n = members[i]
        for a in range(rewards.shape[0]):
            rewards[a, n] = 0.0
            cost[a, n] = 0.0
            scores[a, n] = np.nan


@kernel
def turns(members: IntArray, busy: BoolArray, desk: Desk, out: BoolArray) -> None:
    """Write into ``out`` [agents, B] who plays in the laboratories' next round: the manager, or every busy bench that
    has not had its turn in this tick."""
    for i in range(members.shape[0]):
        n = members[i]
        running = desk.status[n] == RUNNING
        out[0, i] = running and desk.cursor[n] == MANAGER
        for b in range(busy.shape[0]):
            out[b + 1, i] = running and desk.cursor[n] != MANAGER and b >= desk.cursor[n] and busy[b, n]


@kernel
def book(
    members: IntArray,
    events: FloatArray,
    cost: FloatArray,
    price: float,
    totals: FloatArray,
    charges: FloatArray,
    ended: BoolArray,
    finished: BoolArray,
    which: IntArray,
) -> int:
    """After a bench's turn: its safety events into the episode's totals and the manager's charges. Writes the members
    whose experiment has ended into ``which`` and returns their number."""
    count = 0
    for i in range(members.shape[0]):
        n = members[i]
        for k in range(events.shape[1]):
            totals[n, k] += events[n, k]
        charges[n, 5] += price * cost[n]
        if ended[n]:
            finished[n] = True
            which[count] = n
            count += 1
    return count


@kernel
def advance(
    members: IntArray,
    busy: BoolArray,
    cursor: IntArray,
    ticks: IntArray,
    charges: FloatArray,
    age: IntArray,
    status: IntArray,
    finished: BoolArray,
    tick_price: float,
    tick_limit: int,
) -> int:
    """Pass the turn on after a bench has acted: to the next busy bench, or to the manager once the tick is over and
    an experiment has ended. Returns OVER if an episode has been truncated by it.

    Takes the desk's arrays one by one: handing all of it over takes longer than the work.
    """
    flags = 0
    for i in range(members.shape[0]):
        n = members[i]
        b = cursor[n] + 1
        while b < busy.shape[0] and not busy[b, n]:
            b += 1
        if b < busy.shape[0]:
            cursor[n] = b
            continue
        ticks[n] += 1
        charges[n, 3] += tick_price
        for s in range(age.shape[1]):
            for k in range(age.shape[2]):
                if age[n, s, k] >= 0:
                    age[n, s, k] += 1
        if ticks[n] >= tick_limit:
            status[n] = TRUNCATED
            cursor[n] = MANAGER
            flags |= OVER
        elif finished[n] or not _any_busy(n, busy):
            cursor[n] = MANAGER
        else:
            b = 0
            while not busy[b, n]:
                b += 1
            cursor[n] = b
    return flags


@kernel
def itemize(
    members: IntArray,
    first_stock: FloatArray,
    stock_price: FloatArray,
    stock: FloatArray,
    waste_per_l: float,
    waste: FloatArray,
    role: IntArray,
    molar_volume: FloatArray,
    charges: FloatArray,
    out: FloatArray,
) -> None:
    """Write all costs so far into ``out`` [B, items]: what has been charged, and what follows from amounts, the stock
    used and the waste made."""
    for i in range(members.shape[0]):
        n = members[i]
        used, litres = 0.0, 0.0
        for m in range(stock.shape[1]):
            used += max(first_stock[m] - stock[n, m], 0.0) * stock_price[m]
            if role[m] != ROLE_GAS:
                litres += waste[n, m] * molar_volume[m]
        for item in range(charges.shape[1]):
            out[i, item] = charges[n, item]
        out[i, 1] = used
        out[i, 2] = litres * waste_per_l
