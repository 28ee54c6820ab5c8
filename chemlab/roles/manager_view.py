"""The manager's observation: visible properties of vessels, paid readings, benches, stock, orders.

Each part of the observation is declared directly above the helper that writes it, which returns the offset of the next.
"""

from __future__ import annotations

import math

from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, Handle, IntArray, ObservationArray
from ..kernels.jit import helper, inner, kernel, opened
from ..physics.chemistry import CAPACITY, PRESENT, TEMPERATURE
from ..physics.shelf import ShelfArrays
from ..physics.transfer import volume
from .base import VESSEL_TEMPERATURES_K
from .bench import Channel
from .instrument_table import InstrumentTable
from .manager_actions import ManagerActions
from .manager_state import ARRIVES, INSTRUMENTS, LEAST_AMOUNT, LEAST_PURITY, PRICE, WITHIN, ManagerState, Rules

_COLDEST_K, _HOTTEST_K = VESSEL_TEMPERATURES_K


def manager_channels(scenario: Scenario, instruments: InstrumentTable, rules: Rules) -> list[Channel]:
    """Return the manager's observation channels in order."""
    positions, largest_capacity = rules.most_positions, rules.largest_capacity
    channels = []
    for slot in range(scenario.shelf.slots):
        channels += _vessel_channels(f"slot_{slot}", scenario, positions, largest_capacity)
        channels += _reading_channels(f"slot_{slot}", scenario, instruments)
    for agent in scenario.bench_agents():
        channels += _bench_channels(agent, scenario)
    channels.append(
        Channel("stock", len(scenario.stock), "fraction", 0.0, 1.0, "left of: " + ", ".join(scenario.stock))
    )
    channels += [*_order_channels(scenario, rules), *_limit_channels()]
    channels += _upkeep_channels(scenario)
    return [channel for channel in channels if channel.size > 0]


def _vessel_channels(slot: str, scenario: Scenario, positions: int, largest_capacity: float) -> list[Channel]:
    benches = ", ".join(scenario.benches)
    return [
        Channel(f"{slot}_occupied", 1, "0 or 1", 0.0, 1.0, "whether a vessel stands here"),
        Channel(f"{slot}_fill", 1, "fraction", 0.0, 1.0, "how full it is"),
        Channel(f"{slot}_temperature", 1, "K", _COLDEST_K, _HOTTEST_K, "its temperature"),
        Channel(f"{slot}_capacity", 1, "L", 0.0, largest_capacity, "its capacity"),
        Channel(f"{slot}_last_bench", 1 + len(scenario.benches), "one-hot", 0.0, 1.0, f"last at: none, {benches}"),
        Channel(f"{slot}_last_position", positions, "one-hot", 0.0, 1.0, "as: main vessel, B1, B2"),
    ]


@helper
def shown_share(share: float, gauge: float) -> float:
    """Return a share as a gauge shows it; what is not empty never reads 0."""
    if gauge > 0.0 and share > 0.0:
        share = gauge * max(math.floor(share / gauge + 0.5), 1.0)
    return float(min(share, 1.0))


@helper
def shown_fill(row: FloatArray, rules: Rules, chem: Handle) -> float:
    """Return the observed fill level of a vessel."""
    return shown_share(volume(row, chem) / row[CAPACITY], rules.gauge)


@inner
def _write_vessel(
    out: ObservationArray, at: int, n: int, s: int, state: ManagerState, rules: Rules, shelf: ShelfArrays, chem: Handle
) -> int:
    row = shelf.rows[n * shelf.vessels + s]
    if row[PRESENT] > 0.0:
        out[at] = 1.0
        out[at + 1] = shown_fill(row, rules, chem)
        out[at + 2] = min(max((row[TEMPERATURE] - _COLDEST_K) / (_HOTTEST_K - _COLDEST_K), 0.0), 1.0)
        out[at + 3] = shown_share(row[CAPACITY] / rules.largest_capacity, rules.gauge)  # an overfull one is larger
        out[at + 4 + state.last_bench[n, s]] = 1.0
        if state.last_bench[n, s] > 0:
            out[at + 5 + rules.kinds + state.last_position[n, s]] = 1.0
    return at + 5 + rules.kinds + rules.most_positions


def _reading_channels(slot: str, scenario: Scenario, instruments: InstrumentTable) -> list[Channel]:
    channels, limit = [], float(scenario.limits.ticks)
    for c in instruments.channels:
        if c.name in scenario.seen_instruments:
            channels.append(Channel(f"{slot}_{c.name}", c.size, c.unit, c.low, c.high, f"last reading: {c.meaning}"))
        channels.append(Channel(f"{slot}_{c.name}_age", 1, "ticks", 0.0, limit, "its age; 1 = never measured"))
    return channels


@inner
def _write_readings(out: ObservationArray, at: int, n: int, s: int, state: ManagerState, rules: Rules) -> int:
    for k in range(state.age.shape[2]):
        start, stop, age = rules.reading_start[k], rules.reading_start[k + 1], state.age[n, s, k]
        if rules.seen[k]:
            if age >= 0:
                shown, values = out[at : at + stop - start], state.reading[n, s, start:stop]
                for r in range(values.shape[0]):
                    shown[r] = values[r]
            at += stop - start
        out[at] = 1.0 if age < 0 else min(age / rules.tick_limit, 1.0)
        at += 1
    return at


def _bench_channels(agent: str, scenario: Scenario) -> list[Channel]:
    goals = ", ".join(scenario.goals)
    return [
        Channel(f"{agent}_busy", 1, "0 or 1", 0.0, 1.0, "whether an experiment is running"),
        Channel(f"{agent}_goal", len(scenario.goals), "one-hot", 0.0, 1.0, "its goal: " + goals),
        Channel(f"{agent}_steps_left", 1, "fraction", 0.0, 1.0, "of its step limit"),
    ]


@inner
def _write_bench(out: ObservationArray, at: int, n: int, b: int, state: ManagerState, rules: Rules) -> int:
    goals = rules.parts.shape[0]
    if state.busy[b, n]:
        out[at] = 1.0
        out[at + 1 + state.bench_goal[b, n]] = 1.0
        out[at + 1 + goals] = 1.0 - state.bench_steps[b, n] / rules.limit[b]
    return int(at + 2 + goals)


@inner
def _write_stock(out: ObservationArray, at: int, n: int, rules: Rules, shelf: ShelfArrays) -> int:
    for k in range(rules.stocked.shape[0]):
        m = rules.stocked[k]
        left = shelf.stock[n, m] / rules.first_stock[m] if rules.first_stock[m] > 0.0 else 0.0
        out[at + k] = max(shown_share(left, rules.gauge), 0.0)
    return int(at + rules.stocked.shape[0])


def order_channels(scenario: Scenario) -> list[tuple[str, str]]:
    """Return (channel name, meaning) of each order's goal; a filled order shows zeros."""
    if scenario.orders == 1:
        return [("goal", "laboratory goal")]
    shown = "zeros until it comes, and once it is filled" if scenario.demand.order else "zeros once it is filled"
    return [(f"goal_{o}", f"goal of order {o}, {shown}") for o in range(scenario.orders)]


def terms_channels(order: str) -> tuple[str, str, str, str]:
    """Return the channels of an order's terms: ticks left, price, least amount, least purity.

    Their names derive from the goal's channel (:func:`order_channels`).
    """
    return f"{order}_ticks_left", f"{order}_price", f"{order}_amount_at_least", f"{order}_purity_at_least"


def _order_channels(scenario: Scenario, rules: Rules) -> list[Channel]:
    goals = ", ".join(scenario.goals)
    most = rules.most_terms.tolist()
    kinds = [
        ("ticks", most[WITHIN], "until it is late"),
        ("price", most[PRICE], "what it pays"),
        ("mol", most[LEAST_AMOUNT], "least that it takes of its goal"),
        ("mole fraction", most[LEAST_PURITY], "least pure that it takes it"),
    ]
    channels = []
    for name, meaning in order_channels(scenario):
        channels.append(Channel(name, len(scenario.goals), "one-hot", 0.0, 1.0, f"{meaning}: {goals}"))
        if scenario.demand.order:
            pairs = zip(terms_channels(name), kinds, strict=True)
            channels += [Channel(own, 1, unit, 0.0, high, words) for own, (unit, high, words) in pairs]
    return channels


@inner
def _write_orders(out: ObservationArray, at: int, n: int, state: ManagerState, rules: Rules) -> int:
    for o in range(state.goal.shape[1]):
        if state.terms.shape[1] == 0:
            out[at + state.goal[n, o]] = 0.0 if state.filled[n, o] else 1.0
            at += rules.parts.shape[0]
            continue
        terms, most = state.terms[n, o], rules.most_terms
        after = at + rules.parts.shape[0]
        if state.ticks[n] >= terms[ARRIVES] and not state.filled[n, o]:
            out[at + state.goal[n, o]] = 1.0
            left = terms[ARRIVES] + terms[WITHIN] - state.ticks[n]
            out[after] = min(max(left / most[WITHIN], 0.0), 1.0)
            out[after + 1] = min(terms[PRICE] / most[PRICE], 1.0)
            out[after + 2] = min(terms[LEAST_AMOUNT] / most[LEAST_AMOUNT], 1.0)
            out[after + 3] = min(terms[LEAST_PURITY] / most[LEAST_PURITY], 1.0)
        at = after + 4
    return at


def report_channels(scenario: Scenario) -> list[Channel]:
    """Return the channels of the benches' self-reported outcomes."""
    most = max(scenario.theoretical_maximum_mol.values())
    channels = []
    for agent in scenario.bench_agents():
        key = agent.rpartition("_")[0]
        if scenario.benches[key].report is not None:
            channels += [
                Channel(f"{agent}_reported_amount", 1, "mol", 0.0, most, "what it says it has made; 0 before"),
                Channel(f"{agent}_reported_purity", 1, "mole fraction", 0.0, 1.0, "the purity it says that has"),
                Channel(
                    f"{agent}_reported_ticks", 1, "ticks", 0.0, scenario.benches[key].step_limit, "what it took for it"
                ),
            ]
    return channels


def _limit_channels() -> list[Channel]:
    return [
        Channel("budget", 1, "fraction", 0.0, 1.0, "left of the budget for measurements"),
        Channel("actions", 1, "fraction", 0.0, 1.0, "left of the manager's actions"),
        Channel("ticks", 1, "fraction", 0.0, 1.0, "left of the ticks"),
    ]


@inner
def _write_limits(out: ObservationArray, at: int, n: int, state: ManagerState, rules: Rules) -> int:
    out[at] = max(1.0 - state.charges[n, INSTRUMENTS] / rules.budget, 0.0)
    out[at + 1] = max(1.0 - state.actions[n] / rules.action_limit, 0.0)
    out[at + 2] = max(1.0 - state.ticks[n] / rules.tick_limit, 0.0)
    return at + 3


def _upkeep_channels(scenario: Scenario) -> list[Channel]:
    """Return the channels of the condition of instruments and benches, if it can change."""
    if not scenario.errs:
        return []
    limit, actions = float(scenario.limits.ticks), ManagerActions.of(scenario)
    channels = [
        Channel(f"{name}_calibrated", 1, "ticks", 0.0, limit, "since its calibration, or since the beginning")
        for name in actions.drifting
    ]
    for agent in actions.wearing:
        channels += [
            Channel(f"{agent}_broken", 1, "0 or 1", 0.0, 1.0, "whether it is broken"),
            Channel(f"{agent}_repair", 1, "ticks", 0.0, limit, "left of its repair"),
        ]
    return channels


@inner
def _write_upkeep(out: ObservationArray, at: int, n: int, state: ManagerState, rules: Rules) -> None:
    for k in range(rules.drifting.shape[0]):
        out[at] = min((state.ticks[n] - state.calibrated[n, rules.drifting[k]]) / rules.tick_limit, 1.0)
        at += 1
    for k in range(rules.wearing.shape[0]):
        b = rules.wearing[k]
        out[at] = 1.0 if state.broken[b, n] else 0.0
        out[at + 1] = min(max((state.ready[n, b] - state.ticks[n]) / rules.tick_limit, 0.0), 1.0)
        at += 2


@kernel
def manager_observe(
    members: IntArray,
    manager: Handle,
    scenario: Handle,
    shelf: Handle,
    chemistry: Handle,
    out: ObservationArray,
    rows: IntArray,
) -> None:
    """Write the observations of the managers of ``members`` [B] into ``rows`` [B] of ``out`` [any, size]."""
    state, rules, arrays = opened(ManagerState, manager), opened(Rules, scenario), opened(ShelfArrays, shelf)
    for i in range(members.shape[0]):
        n = members[i]
        chem = chemistry[arrays.variant[n]]
        seen = out[rows[i]]
        seen[:] = 0.0
        at = 0
        for s in range(rules.slots):
            at = _write_vessel(seen, at, n, s, state, rules, arrays, chem)
            at = _write_readings(seen, at, n, s, state, rules)
        for b in range(state.busy.shape[0]):
            at = _write_bench(seen, at, n, b, state, rules)
        at = _write_stock(seen, at, n, rules, arrays)
        at = _write_orders(seen, at, n, state, rules)
        at = _write_limits(seen, at, n, state, rules)
        _write_upkeep(seen, at, n, state, rules)
