"""The manager's side of a laboratory: whose turn it is, and what the manager's actions do to the arrays."""

from __future__ import annotations

import numpy as np

from ..kernels.arrays import BoolArray, FloatArray, Handle, IntArray, MaskArray
from ..kernels.jit import helper, inner, kernel, opened
from ..physics.backends import elapse, partition, react, settle_phases
from ..physics.chemistry import CLOCK, PRESENT, ROLE_GAS, TEMPERATURE, Chemistry
from ..physics.shelf import CLOCK_SETTLED, ShelfArrays
from ..physics.surroundings import Surroundings
from ..physics.transfer import clear, move, remove_fraction, spill, volume
from .bench import ExperimentState, goal_amount, weighted_amount
from .maintenance import calibrate, send_fitter, under_repair, usable
from .manager_actions import (
    CALIBRATE,
    DISCARD,
    FIRST,
    KIND,
    MEASURE,
    RECALL,
    REPAIR,
    SECOND,
    START,
    SUBMIT,
)
from .manager_state import (
    ARRIVES,
    CLOSED,
    ILLEGAL,
    INSTRUMENTS,
    LEAST_AMOUNT,
    LEAST_PURITY,
    LIMIT,
    MANAGER,
    PRICE,
    RUNNING,
    SAFETY,
    STOCK,
    TIME,
    WASTE,
    WITHIN,
    ManagerState,
    Rules,
)

__all__ = [
    "BEGUN",
    "MEASURED",
    "OVER",
    "RECALLED",
    "REPAIRED",
    "advance",
    "age_on_shelf",
    "charge_events",
    "itemize",
    "manager_act",
    "manager_mask",
    "open_turn",
    "rest_on_shelf",
    "return_vessels",
    "turns",
]

BEGUN, RECALLED, OVER, MEASURED, REPAIRED = 1, 2, 4, 8, 16
"""What a turn led to: an experiment begun, one recalled, an episode over, a vessel to be measured, a bench repaired."""

_RTOL, _ATOL = 1e-3, 1e-6
"""Error tolerances of reactions on the shelf: those that a reaction bench has by default (relative; mol/L)."""


@inner
def _count_slots(n: int, base: int, state: ManagerState, rules: Rules, shelf: ShelfArrays) -> tuple[int, int]:
    """(free slots, occupied slots); a slot reserved for a vessel at a bench is neither."""
    free, occupied = 0, 0
    for s in range(rules.slots):
        if shelf.rows[base + s, PRESENT] > 0.0:
            occupied += 1
        elif state.reserved[n, s] < 0:
            free += 1
    return free, occupied


@inner
def _allowed(
    n: int, a: int, slots: tuple[int, int], any_busy: bool, state: ManagerState, rules: Rules, shelf: ShelfArrays
) -> bool:
    kind, x, y = rules.table[a, KIND], rules.table[a, FIRST], rules.table[a, SECOND]
    base = n * shelf.vessels
    if kind == START:
        free = slots[0] >= rules.positions[x] - 1
        return not state.busy[x, n] and shelf.rows[base + y, PRESENT] > 0.0 and free and usable(n, x, state)
    if kind == MEASURE:
        affordable = state.charges[n, INSTRUMENTS] + rules.price[y] <= rules.budget + 1e-12
        return bool(shelf.rows[base + x, PRESENT] > 0.0 and affordable)
    if kind == DISCARD:  # the last vessel stays: without one there would be nothing left to do
        return bool(shelf.rows[base + x, PRESENT] > 0.0 and (slots[1] > 1 or any_busy))
    if kind == SUBMIT:
        return bool(shelf.rows[base + x, PRESENT] > 0.0 and not state.filled[n, y] and _has_come(n, y, state))
    if kind == RECALL:
        return bool(state.busy[x, n])
    if kind == CALIBRATE:
        return bool(state.charges[n, INSTRUMENTS] + rules.calibration_price[x] <= rules.budget + 1e-12)
    if kind == REPAIR:
        return not state.busy[x, n] and bool(state.ready[n, x] <= state.ticks[n])
    return any_busy or under_repair(n, state) or _expects(n, state)


@helper
def _has_come(n: int, o: int, state: ManagerState) -> bool:
    """Whether the manager knows of an order."""
    return bool(state.terms.shape[1] == 0 or state.ticks[n] >= state.terms[n, o, ARRIVES])


@inner
def _expects(n: int, state: ManagerState) -> bool:
    """Whether an order is still to come, or a deadline is."""
    ahead = False
    for o in range(state.terms.shape[1]):
        due = state.terms[n, o, ARRIVES] + state.terms[n, o, WITHIN]
        ahead = ahead or (not state.filled[n, o] and state.ticks[n] <= due)
    return ahead


@inner
def _is_closed(n: int, state: ManagerState, rules: Rules) -> bool:
    """Whether no order can be met any more: each is filled, or late where that pays nothing."""
    closed = True
    for o in range(state.filled.shape[1]):
        lapsed = False
        if state.terms.shape[1] > 0 and rules.late == 0.0:
            lapsed = state.ticks[n] > state.terms[n, o, ARRIVES] + state.terms[n, o, WITHIN]
        closed = closed and (state.filled[n, o] or lapsed)
    return closed


@inner
def _differ(action: IntArray, other: IntArray) -> bool:
    """Whether two rows of the table differ in what :func:`_allowed` depends on."""
    return bool(action[KIND] != other[KIND] or action[FIRST] != other[FIRST] or action[SECOND] != other[SECOND])


@helper
def _any_busy(n: int, busy: BoolArray) -> bool:
    found = False
    for b in range(busy.shape[0]):
        found = found or busy[b, n]
    return found


@kernel
def manager_mask(members: IntArray, manager: Handle, scenario: Handle, shelf: Handle, out: MaskArray) -> None:
    """Write the manager's legal actions into ``out`` [B, A]."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    for i in range(members.shape[0]):
        n = members[i]
        slots = _count_slots(n, n * arrays.vessels, state, rules, arrays)
        any_busy = _any_busy(n, state.busy)
        before, allowed = 0, False
        for a in range(rules.table.shape[0]):
            # Goals and grades of one start stand together, and are legal or not together.
            if a == 0 or _differ(rules.table[a], rules.table[before]):
                allowed = _allowed(n, a, slots, any_busy, state, rules, arrays)
                before = a
            out[i, a] = allowed


@kernel
def rest_on_shelf(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """A vessel put on the shelf: ambient temperature, settled, at precipitation equilibrium."""
    row[TEMPERATURE] = opened(Chemistry, chem).ambient_temperature
    row[CLOCK] = CLOCK_SETTLED
    settle_phases(row, chem, waste, events, work)
    partition(row, chem, work)


@inner
def _forget(n: int, s: int, state: ManagerState) -> None:
    """The slot holds another vessel, or none: its history and readings are gone."""
    state.last_bench[n, s] = 0
    state.last_position[n, s] = 0
    state.reading[n, s, :] = 0.0
    state.age[n, s, :] = -1


@inner
def _start(n: int, x: int, y: int, state: ManagerState, rules: Rules, shelf: ShelfArrays) -> None:
    """Bring the vessel of slot ``y`` to bench ``x``, and keep slots for what will come back."""
    base = n * shelf.vessels
    move(shelf.rows[base + y], shelf.rows[base + rules.first[x]])
    _forget(n, y, state)  # what comes back is not what was measured
    state.origin[n, x] = y
    state.reserved[n, y] = x
    wanted = rules.positions[x] - 1
    for s in range(rules.slots):
        if wanted > 0 and shelf.rows[base + s, PRESENT] <= 0.0 and state.reserved[n, s] < 0:
            state.reserved[n, s] = x
            wanted -= 1
    state.begun[n] = x


@inner
def _remove(n: int, x: int, state: ManagerState, chem: Handle, row: FloatArray, into: FloatArray) -> None:
    """Take a vessel off the shelf."""
    remove_fraction(row, 1.0, chem, into)
    clear(row)
    _forget(n, x, state)


@inner
def _payment(n: int, o: int, state: ManagerState, rules: Rules) -> float:
    """What an order with terms pays for what has been submitted for it."""
    terms, goal = state.terms[n, o], state.goal[n, o]
    amount, purity = state.submitted[n, o, 0], state.submitted[n, o, 1]
    paid = terms[PRICE] if amount > 0.0 else 0.0
    if state.ticks[n] > terms[ARRIVES] + terms[WITHIN]:
        paid *= rules.late
    least_amount = max(terms[LEAST_AMOUNT], rules.least_amount[goal])
    if amount < least_amount or purity < max(terms[LEAST_PURITY], rules.least_purity[goal]):
        paid *= rules.short
    return float(paid)


@inner
def _submit(
    n: int, x: int, y: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle, last: bool
) -> None:
    """Fill order ``y`` with the vessel of slot ``x``; the episode is over once no other order can be met, or where
    nothing is left to meet one with (``last``)."""
    row, goal = shelf.rows[n * shelf.vessels + x], state.goal[n, y]
    amount = goal_amount(row, rules.parts[goal])
    total = weighted_amount(row, rules.counts[goal])
    purity = amount / total if total > 0.0 else 0.0
    state.submitted[n, y, 0] = amount
    state.submitted[n, y, 1] = purity
    state.filled[n, y] = True
    if state.terms.shape[1] > 0:
        state.paid[n, y] = _payment(n, y, state, rules)
        state.rewards[rules.manager, n] += rules.share * state.paid[n, y] / state.goal.shape[1]
    elif amount >= rules.least_amount[goal] and purity >= rules.least_purity[goal]:
        earned = rules.share * amount * purity / rules.maximum[goal] / state.goal.shape[1]
        state.rewards[rules.manager, n] += earned
    if last or _is_closed(n, state, rules):
        state.status[n] = CLOSED
    else:
        _remove(n, x, state, chem, row, state.delivered[n])


@inner
def _age_shelf(n: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle) -> None:
    """A tick passes for the vessels that nobody works on; what flies counts among the episode's events."""
    base = n * shelf.vessels
    for s in range(rules.slots):
        row = shelf.rows[base + s]
        if row[PRESENT] > 0.0 and elapse(row, 1.0, chem, shelf.waste[n], state.safety_totals[n], rules.work):
            partition(row, chem, rules.work)


@inner
def _pass_tick(n: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle) -> bool:
    """A tick of laboratory time is over: time is charged, vessels and readings age, and the episode may be at an end.
    Returns whether the manager has to hear of it: a repair is over, or an order has come."""
    state.ticks[n] += 1
    state.charges[n, TIME] += rules.tick_price
    _age_shelf(n, state, rules, shelf, chem)
    for s in range(state.age.shape[1]):
        for k in range(state.age.shape[2]):
            if state.age[n, s, k] >= 0:
                state.age[n, s, k] += 1
    news = False
    for b in range(state.ready.shape[1]):
        news = news or state.ready[n, b] == state.ticks[n]
    for o in range(state.terms.shape[1]):
        arrives = state.terms[n, o, ARRIVES]
        news = news or state.ticks[n] - 1 < arrives <= state.ticks[n]
    if state.ticks[n] >= rules.tick_limit:
        state.status[n] = LIMIT
    elif state.terms.shape[1] > 0 and _is_closed(n, state, rules):
        state.status[n] = CLOSED
    return news


@inner
def _idle(n: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle) -> None:
    """The manager waits with every bench idle: until a bench is repaired, an order comes, or one
    that it knows of is late."""
    waiting = True
    while waiting:
        news = _pass_tick(n, state, rules, shelf, chem)
        for o in range(state.terms.shape[1]):
            due = state.terms[n, o, ARRIVES] + state.terms[n, o, WITHIN]
            news = news or (not state.filled[n, o] and state.ticks[n] - 1 <= due < state.ticks[n])
        waiting = not news and state.status[n] == RUNNING


@kernel
def manager_act(
    members: IntArray, actions: IntArray, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle
) -> int:
    """Carry out one manager action in each laboratory of ``members``.

    Returns the flags BEGUN, RECALLED, OVER, MEASURED and REPAIRED of what it led to in any of them; the state says in
    which.
    """
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    flags = 0
    for i in range(members.shape[0]):
        n, a = members[i], actions[i]
        base, chem = n * arrays.vessels, chemistry[arrays.variant[n]]
        state.begun[n], state.recalled[n], state.measured[n] = -1, -1, -1
        state.actions[n] += 1
        slots, any_busy = _count_slots(n, base, state, rules, arrays), _any_busy(n, state.busy)
        state.illegal[n] = not _allowed(n, a, slots, any_busy, state, rules, arrays)
        kind, x, y = rules.table[a, KIND], rules.table[a, FIRST], rules.table[a, SECOND]
        if state.illegal[n]:
            state.charges[n, ILLEGAL] += rules.illegal_price
        elif kind == START:
            _start(n, x, y, state, rules, arrays)
            flags |= BEGUN
        elif kind == MEASURE:
            state.measured[n] = x
            state.age[n, x, y] = 0
            state.charges[n, INSTRUMENTS] += rules.price[y]
            flags |= MEASURED
        elif kind == DISCARD:
            _remove(n, x, state, chem, arrays.rows[base + x], arrays.waste[n])
        elif kind == SUBMIT:
            # What is left of the shelf cannot fill an order once it and the benches are empty.
            _submit(n, x, y, state, rules, arrays, chem, slots[1] == 1 and not any_busy)
        elif kind == RECALL:
            state.recalled[n] = x
            flags |= RECALLED
        elif kind == CALIBRATE:
            calibrate(n, x, state, rules)
        elif kind == REPAIR:
            send_fitter(n, x, state, rules)
            flags |= REPAIRED
        elif not any_busy:
            _idle(n, state, rules, arrays, chem)
        else:
            first = 0
            while not state.busy[first, n]:
                first += 1
            state.cursor[n] = first
            state.finished[n] = False
        if state.status[n] == RUNNING and state.actions[n] >= rules.action_limit:
            state.status[n] = LIMIT
        if state.status[n] != RUNNING:
            flags |= OVER
    return flags


@kernel
def return_vessels(
    members: IntArray, b: int, manager: Handle, scenario: Handle, experiment: Handle, shelf: Handle, chemistry: Handle
) -> None:
    """Bring what bench ``b`` worked on back to the shelf: the main vessel to where it came from, the others to the
    slots reserved for them; empty ones are washed and gone."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    events = opened(ExperimentState, experiment).events
    for i in range(members.shape[0]):
        n = members[i]
        base, chem = n * arrays.vessels, chemistry[arrays.variant[n]]
        for p in range(rules.positions[b]):
            row = arrays.rows[base + rules.first[b] + p]
            slot = state.origin[n, b]
            if p > 0:
                slot = -1
                if volume(row, chem) > 0.0:
                    for s in range(rules.slots - 1, -1, -1):
                        if state.reserved[n, s] == b and s != state.origin[n, b]:
                            slot = s
            if slot >= 0:
                rest_on_shelf(row, chem, arrays.waste[n], events[n], rules.work)
                move(row, arrays.rows[base + slot])
                if p > 0:
                    _forget(n, slot, state)
                state.last_bench[n, slot] = 1 + rules.bench_of[b]
                state.last_position[n, slot] = p
                state.reserved[n, slot] = -1
            clear(row)
        for s in range(rules.slots):
            if state.reserved[n, s] == b:
                state.reserved[n, s] = -1


@kernel
def open_turn(members: IntArray, manager: Handle) -> None:
    """Nobody has earned anything yet: clear the laboratories' columns of what agents have earned."""
    state = opened(ManagerState, manager)
    for i in range(members.shape[0]):
        n = members[i]
        for a in range(state.rewards.shape[0]):
            state.rewards[a, n] = 0.0
            state.cost[a, n] = 0.0
            state.scores[a, n] = np.nan


@kernel
def turns(members: IntArray, manager: Handle, scenario: Handle, out: BoolArray) -> None:
    """Write into ``out`` [agents, B] who plays in the laboratories' next round: the manager, or every busy bench that
    has not had its turn in this tick."""
    state, rules = opened(ManagerState, manager), opened(Rules, scenario)
    for i in range(members.shape[0]):
        n = members[i]
        running = state.status[n] == RUNNING
        out[rules.manager, i] = running and state.cursor[n] == MANAGER
        for b in range(state.busy.shape[0]):
            ticking = running and state.cursor[n] != MANAGER
            out[rules.agent[b], i] = ticking and b >= state.cursor[n] and state.busy[b, n]


@kernel
def charge_events(
    members: IntArray, b: int, experiment: Handle, manager: Handle, scenario: Handle, which: IntArray
) -> int:
    """After a turn of bench ``b``: its safety events into the episode's totals and the manager's charges. Writes the
    members whose experiment has ended into ``which`` and returns their number."""
    state, rules, own = opened(ManagerState, manager), opened(Rules, scenario), opened(ExperimentState, experiment)
    count = 0
    for i in range(members.shape[0]):
        n = members[i]
        for k in range(own.events.shape[1]):
            state.safety_totals[n, k] += own.events[n, k]
        state.charges[n, SAFETY] += rules.event_price * state.cost[rules.agent[b], n]
        if own.ended[n]:
            state.finished[n] = True
            which[count] = n
            count += 1
    return count


@kernel
def advance(members: IntArray, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle) -> int:
    """Pass the turn on after a bench has acted: to the next busy bench, or to the manager once the tick is over and
    an experiment has ended, a repair is over or an order has come. Returns OVER if an episode is over by it."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    flags = 0
    for i in range(members.shape[0]):
        n = members[i]
        b = state.cursor[n] + 1
        while b < state.busy.shape[0] and not state.busy[b, n]:
            b += 1
        if b < state.busy.shape[0]:
            state.cursor[n] = b
            continue
        news = _pass_tick(n, state, rules, arrays, chemistry[arrays.variant[n]])
        if state.status[n] != RUNNING:
            state.cursor[n] = MANAGER
            flags |= OVER
        elif state.finished[n] or news or not _any_busy(n, state.busy):
            state.cursor[n] = MANAGER
        else:
            b = 0
            while not state.busy[b, n]:
                b += 1
            state.cursor[n] = b
    return flags


@kernel
def age_on_shelf(
    members: IntArray, since: IntArray, dt: float, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle
) -> int:
    """Let vessels on the shelf go on reacting at their temperature, for ``dt`` each tick that has passed ``since`` [B].
    Returns a laboratory in which the reactions were too stiff, -1 if there is none."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    stiff = -1
    for i in range(members.shape[0]):
        n = members[i]
        base, chem = n * arrays.vessels, chemistry[arrays.variant[n]]
        time = dt * (state.ticks[n] - since[i])
        for s in range(rules.slots):
            row = arrays.rows[base + s]
            if time > 0.0 and row[PRESENT] > 0.0:
                around = Surroundings(row[TEMPERATURE], -1.0, -1.0, _RTOL, _ATOL)
                if react(row, time, around, chem, arrays.waste[n], state.safety_totals[n], rules.work) < 0:
                    stiff = n
                settle_phases(row, chem, arrays.waste[n], state.safety_totals[n], rules.work)
                spill(row, chem, arrays.waste[n], state.safety_totals[n])  # reacting changes the volume
                partition(row, chem, rules.work)
    return stiff


@kernel
def itemize(
    members: IntArray, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle, out: FloatArray
) -> None:
    """Write all costs so far into ``out`` [B, items]: what has been charged, and what follows from amounts, the stock
    used and the waste made."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    for i in range(members.shape[0]):
        n = members[i]
        known = opened(Chemistry, chemistry[arrays.variant[n]])
        used, litres = 0.0, 0.0
        for m in range(arrays.stock.shape[1]):
            used += max(rules.first_stock[m] - arrays.stock[n, m], 0.0) * rules.stock_price[m]
            if known.role[m] != ROLE_GAS:
                litres += arrays.waste[n, m] * known.molar_volume[m]
        for item in range(state.charges.shape[1]):
            out[i, item] = state.charges[n, item]
        out[i, STOCK] = used
        out[i, WASTE] = litres * rules.waste_per_l
