"""Turn order, and effects of the manager's actions on the arrays."""

from __future__ import annotations

import numpy as np

from ..kernels.arrays import BoolArray, FloatArray, Handle, IntArray, MaskArray
from ..kernels.jit import helper, inner, kernel, opened
from ..kernels.rng import normal
from ..physics.backends import elapse, partition, react, settle_phases
from ..physics.chemistry import CLOCK, PRESENT, ROLE_GAS, TEMPERATURE, Chemistry
from ..physics.shelf import CLOCK_SETTLED, ShelfArrays
from ..physics.surroundings import Surroundings
from ..physics.transfer import clear, move, remove_fraction, spill, volume
from .bench import ExperimentState, goal_amount, weighted_amount
from .maintenance import calibrate, send_fitter, under_repair, usable
from .manager_actions import CALIBRATE, DISCARD, FIRST, KIND, MEASURE, RECALL, REPAIR, SECOND, START, SUBMIT
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
from .manager_view import shown_fill

BEGUN, RECALLED, OVER, MEASURED, REPAIRED = 1, 2, 4, 8, 16
"""Flags of a turn's consequences: experiment started or recalled, episode over, measurement or repair due."""

_RTOL, _ATOL = 1e-3, 1e-6
"""Error tolerances of reactions on the shelf: the defaults of a reaction bench (relative; mol/L)."""


@helper
def _count_slots(n: int, base: int, state: ManagerState, rules: Rules, shelf: ShelfArrays) -> tuple[int, int]:
    """Return the numbers of free and occupied slots; a slot reserved for a vessel at a bench is neither."""
    free, occupied = 0, 0
    for s in range(rules.slots):
        if shelf.rows[base + s, PRESENT] > 0.0:
            occupied += 1
        elif state.reserved[n, s] < 0:
            free += 1
    return free, occupied


@helper
def _may_leave(n: int, s: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle) -> bool:
    """Return True if the vessel of a slot may be submitted.

    With hidden parameters, a bench must have worked on it; it must not be emptier than the scenario allows.
    """
    row = shelf.rows[n * shelf.vessels + s]
    if row[PRESENT] <= 0.0 or (rules.hides and state.last_bench[n, s] == 0):
        return False
    return bool(rules.least_fill <= 0.0 or shown_fill(row, rules, chem) >= rules.least_fill - 1e-9)


@helper
def _allowed(
    n: int,
    a: int,
    slots: tuple[int, int],
    any_busy: bool,
    state: ManagerState,
    rules: Rules,
    shelf: ShelfArrays,
    chem: Handle,
) -> bool:
    kind, x, y = rules.table[a, KIND], rules.table[a, FIRST], rules.table[a, SECOND]
    base = n * shelf.vessels
    if kind == START:
        free = slots[0] >= rules.positions[x] - 1
        return not state.busy[x, n] and shelf.rows[base + y, PRESENT] > 0.0 and free and usable(n, x, state)
    if kind == MEASURE:
        affordable = state.charges[n, INSTRUMENTS] + rules.price[y] <= rules.budget + 1e-12
        return bool(shelf.rows[base + x, PRESENT] > 0.0 and affordable)
    if kind == DISCARD:  # the last vessel cannot be discarded: without one no action would remain
        return bool(shelf.rows[base + x, PRESENT] > 0.0 and (slots[1] > 1 or any_busy))
    if kind == SUBMIT:
        has_come = state.terms.shape[1] == 0 or state.ticks[n] >= state.terms[n, y, ARRIVES]
        return bool(not state.filled[n, y] and has_come and _may_leave(n, x, state, rules, shelf, chem))
    if kind == RECALL:
        return bool(state.busy[x, n] and (state.bench_steps[x, n] > 0 or not rules.hides))
    if kind == CALIBRATE:
        return bool(state.charges[n, INSTRUMENTS] + rules.calibration_price[x] <= rules.budget + 1e-12)
    if kind == REPAIR:
        return not state.busy[x, n] and bool(state.ready[n, x] <= state.ticks[n])
    return any_busy or under_repair(n, state) or _expects(n, state)


@inner
def _expects(n: int, state: ManagerState) -> bool:
    """Return True if an arrival or a deadline is still to come."""
    ahead = False
    for o in range(state.terms.shape[1]):
        due = state.terms[n, o, ARRIVES] + state.terms[n, o, WITHIN]
        ahead = ahead or (not state.filled[n, o] and state.ticks[n] <= due)
    return ahead


@helper
def _is_closed(n: int, state: ManagerState, rules: Rules) -> bool:
    """Return True if no order can be fulfilled any more: each is filled, or late without payment."""
    closed = True
    for o in range(state.filled.shape[1]):
        lapsed = False
        if state.terms.shape[1] > 0 and rules.late == 0.0:
            lapsed = state.ticks[n] > state.terms[n, o, ARRIVES] + state.terms[n, o, WITHIN]
        closed = closed and (state.filled[n, o] or lapsed)
    return closed


@inner
def _differ(action: IntArray, other: IntArray) -> bool:
    """Return True if two rows of the table differ in the columns that :func:`_allowed` depends on."""
    return bool(action[KIND] != other[KIND] or action[FIRST] != other[FIRST] or action[SECOND] != other[SECOND])


@helper
def _next_busy(n: int, b: int, busy: BoolArray) -> int:
    """Return the first busy bench from ``b`` on; the number of benches if there is none."""
    while b < busy.shape[0] and not busy[b, n]:
        b += 1
    return b


@kernel
def manager_mask(
    members: IntArray, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle, out: MaskArray
) -> None:
    """Write the manager's legal actions into ``out`` [B, A]."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    for i in range(members.shape[0]):
        n = members[i]
        slots = _count_slots(n, n * arrays.vessels, state, rules, arrays)
        any_busy = _next_busy(n, 0, state.busy) < state.busy.shape[0]
        before, allowed, chem = 0, False, chemistry[arrays.variant[n]]
        for a in range(rules.table.shape[0]):
            # Goals and requirements of one start are adjacent and have the same legality.
            if a == 0 or _differ(rules.table[a], rules.table[before]):
                allowed = _allowed(n, a, slots, any_busy, state, rules, arrays, chem)
                before = a
            out[i, a] = allowed


@kernel
def rest_on_shelf(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """Put a vessel at rest: ambient temperature, settled, at precipitation equilibrium."""
    row[TEMPERATURE] = opened(Chemistry, chem).ambient_temperature
    row[CLOCK] = CLOCK_SETTLED
    settle_phases(row, chem, waste, events, work)
    partition(row, chem, work)


@helper
def _forget(n: int, s: int, state: ManagerState) -> None:
    """Clear the history and readings of a slot whose vessel has changed."""
    state.last_bench[n, s] = 0
    state.last_position[n, s] = 0
    state.reading[n, s, :] = 0.0
    state.age[n, s, :] = -1


@inner
def _start(n: int, x: int, y: int, state: ManagerState, rules: Rules, shelf: ShelfArrays) -> None:
    """Bring the vessel of slot ``y`` to bench ``x``, and reserve slots for the returning vessels."""
    base = n * shelf.vessels
    move(shelf.rows[base + y], shelf.rows[base + rules.first[x]])
    _forget(n, y, state)  # readings of the returning vessel are invalid
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
    """Remove a vessel from the shelf."""
    remove_fraction(row, 1.0, chem, into)
    clear(row)
    _forget(n, x, state)


@inner
def _payment(n: int, o: int, amount: float, purity: float, state: ManagerState, rules: Rules) -> float:
    """Return the payment of an order with terms for a submission."""
    terms, goal = state.terms[n, o], state.goal[n, o]
    paid = terms[PRICE] if amount > 0.0 else 0.0
    if state.ticks[n] > terms[ARRIVES] + terms[WITHIN]:
        paid *= rules.late
    least_amount = max(terms[LEAST_AMOUNT], rules.least_amount[goal])
    if amount < least_amount or purity < max(terms[LEAST_PURITY], rules.least_purity[goal]):
        paid *= rules.short
    return float(paid)


@helper
def _earned(n: int, o: int, amount: float, purity: float, state: ManagerState, rules: Rules) -> float:
    """Return the manager's reward for a submission with this amount and purity."""
    goal = state.goal[n, o]
    if state.terms.shape[1] > 0:
        return float(rules.share * _payment(n, o, amount, purity, state, rules) / state.goal.shape[1])
    if amount >= rules.least_amount[goal] and purity >= rules.least_purity[goal]:
        return float(rules.share * amount * purity / rules.maximum[goal] / state.goal.shape[1])
    return 0.0


@helper
def _answer(n: int, o: int, amount: float, purity: float, state: ManagerState, rules: Rules) -> None:
    """Give the customer's feedback on a submission: the reward, for noisy values where feedback is noisy."""
    if rules.feedback == 0.0:
        state.rewards[rules.manager, n] += _earned(n, o, amount, purity, state, rules)
    elif rules.feedback > 0.0:
        said = state.feedback[n, o]
        said[0] = max(amount + rules.feedback * rules.maximum[state.goal[n, o]] * normal(state.stream[n]), 0.0)
        said[1] = min(max(purity + rules.feedback * normal(state.stream[n]), 0.0), 1.0)
        said[2] = _earned(n, o, said[0], said[1], state, rules)
        state.rewards[rules.manager, n] += said[2]


@helper
def _submit(
    n: int, x: int, y: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle, last: bool
) -> None:
    """Fill order ``y`` with the vessel of slot ``x``.

    The episode ends if no other order can be fulfilled, or if no vessel remains (``last``).
    """
    row, goal = shelf.rows[n * shelf.vessels + x], state.goal[n, y]
    amount = goal_amount(row, rules.parts[goal])
    total = weighted_amount(row, rules.counts[goal])
    purity = amount / total if total > 0.0 else 0.0
    state.submitted[n, y, 0] = amount
    state.submitted[n, y, 1] = purity
    state.filled[n, y] = True
    if state.terms.shape[1] > 0:
        state.paid[n, y] = _payment(n, y, amount, purity, state, rules)
    _answer(n, y, amount, purity, state, rules)
    if last or _is_closed(n, state, rules):
        state.status[n] = CLOSED
    else:
        _remove(n, x, state, chem, row, state.delivered[n])


@helper
def _pass_tick(n: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle) -> bool:
    """End a tick: charge time, age vessels and readings, and check the limits.

    Returns:
        True if the manager gets the turn because a repair has ended or an order has arrived.
    """
    state.ticks[n] += 1
    state.charges[n, TIME] += rules.tick_price
    for s in range(rules.slots):
        row = shelf.rows[n * shelf.vessels + s]
        # Evaporation losses count as the episode's safety events.
        if row[PRESENT] > 0.0 and elapse(row, 1.0, chem, shelf.waste[n], state.safety_totals[n], rules.work):
            partition(row, chem, rules.work)
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
    """Wait with all benches idle until a repair ends, an order arrives, or a known order becomes late."""
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

    Returns:
        The flags BEGUN, RECALLED, OVER, MEASURED, REPAIRED of any laboratory; the state has them by laboratory.
    """
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    flags = 0
    for i in range(members.shape[0]):
        n, a = members[i], actions[i]
        base, chem = n * arrays.vessels, chemistry[arrays.variant[n]]
        state.begun[n], state.recalled[n], state.measured[n] = -1, -1, -1
        state.actions[n] += 1
        slots, first = _count_slots(n, base, state, rules, arrays), _next_busy(n, 0, state.busy)
        any_busy = first < state.busy.shape[0]
        state.illegal[n] = not _allowed(n, a, slots, any_busy, state, rules, arrays, chem)
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
            # Without vessels on the shelf and at the benches, no order can be filled.
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
    """Return the vessels of bench ``b``: the main one to its origin, others to their reserved slots, unless empty."""
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
                state.last_bench[n, slot] = 1 + rules.bench_of[b]
                state.last_position[n, slot] = p
                state.reserved[n, slot] = -1
            clear(row)
        for s in range(rules.slots):
            if state.reserved[n, s] == b:
                state.reserved[n, s] = -1


@kernel
def open_turn(members: IntArray, manager: Handle) -> None:
    """Clear the rewards, costs and scores of a new turn."""
    state = opened(ManagerState, manager)
    for i in range(members.shape[0]):
        n = members[i]
        for a in range(state.rewards.shape[0]):
            state.rewards[a, n] = 0.0
            state.cost[a, n] = 0.0
            state.scores[a, n] = np.nan


@kernel
def having_turn(members: IntArray, cursor: int, manager: Handle, which: IntArray) -> int:
    """Write those of ``members`` in which the role at ``cursor`` has the turn into ``which``; return their number."""
    state = opened(ManagerState, manager)
    count = 0
    for i in range(members.shape[0]):
        n = members[i]
        if state.cursor[n] == cursor and state.status[n] == RUNNING:
            which[count] = n
            count += 1
    return count


@kernel
def turns(members: IntArray, manager: Handle, scenario: Handle, out: BoolArray) -> None:
    """Write into ``out`` [agents, B] the agents of the laboratories' next round.

    They are the manager, or every busy bench that has not yet acted in this tick.
    """
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
    """Add the safety events of a turn of bench ``b`` to the episode's totals and the manager's charges.

    Returns:
        The number of members whose experiment has ended; they are written into ``which``.
    """
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
    """Pass the turn on after a bench has acted.

    It goes to the next busy bench, or to the manager at the end of the tick if an experiment or a repair has ended or
    an order has arrived. Returns OVER if an episode has ended.
    """
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    flags = 0
    for i in range(members.shape[0]):
        n = members[i]
        following = _next_busy(n, state.cursor[n] + 1, state.busy)
        if following < state.busy.shape[0]:
            state.cursor[n] = following
            continue
        news = _pass_tick(n, state, rules, arrays, chemistry[arrays.variant[n]])
        first = _next_busy(n, 0, state.busy)
        over = state.status[n] != RUNNING
        to_manager = over or state.finished[n] or news or first == state.busy.shape[0]
        state.cursor[n] = MANAGER if to_manager else first
        flags |= OVER if over else 0
    return flags


@kernel
def age_on_shelf(
    members: IntArray, since: IntArray, dt: float, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle
) -> int:
    """React the vessels on the shelf at their temperature, for ``dt`` per tick elapsed ``since`` [B].

    Returns:
        A laboratory in which the reactions were too stiff, or -1.
    """
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
                spill(row, chem, arrays.waste[n], state.safety_totals[n])  # reactions change the volume
                partition(row, chem, rules.work)
    return stiff


@kernel
def itemize(
    members: IntArray, manager: Handle, scenario: Handle, shelf: Handle, chemistry: Handle, out: FloatArray
) -> None:
    """Write all costs so far into ``out`` [B, items]: charges, and costs of used stock and of waste."""
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
