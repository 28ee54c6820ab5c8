"""Condition of benches and instruments: initial state, change with use, repair and calibration.

It is drawn from streams of the world, one for each bench and instrument, so that each is independent of the use of the
others. Only scenarios that declare ``wear`` of a bench or ``drift`` of an instrument have it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..config.scenario import DriftSpec, Scenario, WearSpec
from ..kernels.arrays import Handle, IntArray
from ..kernels.jit import inner, kernel, opened
from ..kernels.rng import normal, uniform
from ..kernels.tables import Table
from .bench import HEAT, STIR, Bench, BenchRules, Experiments, ExperimentState
from .instrument_table import InstrumentTable
from .manager_state import INSTRUMENTS, TIME, ManagerState, Rules

if TYPE_CHECKING:
    from ..lab.hidden import Worlds

LEAST_GAIN, MOST_GAIN = 0.01, 100.0
"""Bounds of a drifting gain."""


def maintenance_rules(scenario: Scenario) -> dict[str, npt.NDArray[Any]]:
    """Rules of drift [I] and repair [B], by field of :class:`~.manager_state.Rules`; empty where there is none."""
    drifts = [spec.drift for spec in scenario.instruments.values()]
    wears = [bench.wear for bench in scenario.benches.values() for _ in range(bench.count)]
    drifting = [one or DriftSpec() for one in drifts] if any(drifts) else []
    wearing = [one or WearSpec() for one in wears] if any(wears) else []
    return {
        "drift_first": np.array([one.first for one in drifting]),
        "drift_walk": np.array([one.walk for one in drifting]),
        "drift_trend": np.array([one.trend for one in drifting]),
        "calibration_price": np.array([one.price for one in drifting]),
        "calibration_error": np.array([one.error for one in drifting]),
        "repair_price": np.array([one.repair_price for one in wearing]),
        "repair_ticks": np.array([one.repair_ticks for one in wearing], dtype=np.int64),
    }


@kernel
def _renew(members: IntArray, experiment: Handle, bench: Handle) -> None:
    state, rules = opened(ExperimentState, experiment), opened(BenchRules, bench)
    for b in range(members.shape[0]):
        m = members[b]
        stream = state.wear_stream[m]
        gain = rules.wear_gain * math.exp(rules.wear_spread * normal(stream))
        state.gain[m, rules.wear_actuator] = min(max(gain, LEAST_GAIN), MOST_GAIN)
        span = -math.log(1.0 - uniform(stream))
        state.life[m] = rules.wear_life * span if rules.wear_life > 0.0 else math.inf
        state.broken[m] = False


@kernel
def _wear_out(members: IntArray, experiment: Handle, bench: Handle) -> None:
    state, rules = opened(ExperimentState, experiment), opened(BenchRules, bench)
    k = rules.wear_actuator
    for b in range(members.shape[0]):
        m = members[b]
        if rules.wear_drift > 0.0:
            gain = state.gain[m, k] * math.exp(rules.wear_drift * normal(state.wear_stream[m]))
            state.gain[m, k] = min(max(gain, LEAST_GAIN), MOST_GAIN)
        state.life[m] -= 1.0
        if state.life[m] <= 0.0:
            state.broken[m] = True
            state.ended[m] = True


def renew(bench: Bench, experiments: Experiments, members: IntArray) -> None:
    """Draw gain and lifetime of new or repaired benches of ``members`` [B] from the degradation's stream."""
    _renew(members, experiments.handle, bench.rules.handle)


def wear_out(bench: Bench, experiments: Experiments, members: IntArray) -> None:
    """Apply one tick of work to the benches of ``members`` [B]; a breakdown ends the experiment."""
    if bench.spec.wear is not None:
        _wear_out(members, experiments.handle, bench.rules.handle)


def equip(bench: Bench, experiments: Experiments, members: IntArray, worlds: Worlds, device: int, name: str) -> None:
    """Set the benches of ``members`` [B] to the drawn condition of their worlds.

    Args:
        bench: the bench.
        experiments: arrays that hold the condition.
        members: environment indices of starting episodes.
        worlds: worlds of the laboratories.
        device: number of its stream.
        name: its name in draws.
    """
    spec = bench.spec.wear
    if spec is None:
        return
    experiments.wear_stream[members, 0] = worlds.device_streams(members, device)
    renew(bench, experiments, members)
    actuator = HEAT if spec.actuator == "heat" else STIR
    gain = worlds.drawn("gain", name, members, experiments.gain[members, actuator])
    experiments.gain[members, actuator] = gain
    experiments.life[members] = worlds.drawn("life", name, members, experiments.life[members])


@kernel
def _draw_biases(members: IntArray, manager: Handle, scenario: Handle) -> None:
    state, rules = opened(ManagerState, manager), opened(Rules, scenario)
    for b in range(members.shape[0]):
        n = members[b]
        for i in range(state.trend.shape[1]):
            state.trend[n, i] = rules.drift_trend[i]
            for r in range(rules.reading_start[i], rules.reading_start[i + 1]):
                state.bias[n, r] = rules.drift_first[i] * normal(state.drift_stream[n, i : i + 1])


def begin_drift(
    instruments: InstrumentTable, members: IntArray, table: Table[ManagerState], scenario: Handle, worlds: Worlds
) -> None:
    """Set the instruments of ``members`` [B] to the drawn biases of their worlds.

    Args:
        instruments: the instruments.
        members: environment indices of starting episodes.
        table: the laboratories' state, which holds the biases.
        scenario: pointer table of the scenario's :class:`~chemlab.roles.manager_state.Rules`.
        worlds: worlds of the laboratories.
    """
    state = table.arrays
    if not state.trend.shape[1]:
        return
    for i in range(len(instruments.names)):
        state.drift_stream[members, i] = worlds.device_streams(members, -2 - i)
    _draw_biases(members, table.handle, scenario)
    for i, name in enumerate(instruments.names):
        state.trend[members, i] = worlds.drawn("trend", name, members, state.trend[members, i])
        own = slice(*instruments.start[i : i + 2])
        state.bias[members, own] = worlds.drawn("bias", name, members, state.bias[members, own])


@kernel
def go_astray(members: IntArray, used: IntArray, manager: Handle, scenario: Handle) -> None:
    """Update the drift of instrument ``used`` [B] of laboratories ``members`` [B] to the current tick."""
    state, rules = opened(ManagerState, manager), opened(Rules, scenario)
    for b in range(members.shape[0]):
        n, i = members[b], used[b]
        ticks = state.ticks[n] - state.since[n, i]
        if ticks <= 0:
            continue
        state.since[n, i] = state.ticks[n]
        for r in range(rules.reading_start[i], rules.reading_start[i + 1]):
            state.bias[n, r] += state.trend[n, i] * ticks
            if rules.drift_walk[i] > 0.0:
                state.bias[n, r] += rules.drift_walk[i] * math.sqrt(ticks) * normal(state.drift_stream[n, i : i + 1])


@inner
def calibrate(n: int, i: int, state: ManagerState, rules: Rules) -> None:
    """Calibrate instrument ``i`` with its residual error, and charge the price."""
    for r in range(rules.reading_start[i], rules.reading_start[i + 1]):
        state.bias[n, r] = rules.calibration_error[i] * normal(state.drift_stream[n, i : i + 1])
    state.since[n, i] = state.ticks[n]
    state.calibrated[n, i] = state.ticks[n]
    state.charges[n, INSTRUMENTS] += rules.calibration_price[i]


@inner
def usable(n: int, b: int, state: ManagerState) -> bool:
    """Return True if bench ``b`` is neither broken nor under repair."""
    if state.ready.shape[1] == 0:
        return True
    return not state.broken[b, n] and bool(state.ready[n, b] <= state.ticks[n])


@inner
def under_repair(n: int, state: ManagerState) -> bool:
    """Return True if any bench is under repair."""
    found = False
    for b in range(state.ready.shape[1]):
        found = found or state.ready[n, b] > state.ticks[n]
    return found


@inner
def send_fitter(n: int, b: int, state: ManagerState, rules: Rules) -> None:
    """Start the repair of bench ``b``, and charge the price."""
    state.ready[n, b] = state.ticks[n] + rules.repair_ticks[b]
    state.charges[n, TIME] += rules.repair_price[b]
