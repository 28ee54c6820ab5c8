"""Degradation, drift and breakdown of a bench's apparatus: see :class:`chemlab.config.scenario.WearSpec`."""

from __future__ import annotations

import math

from ..kernels.arrays import Handle, IntArray
from ..kernels.jit import kernel, opened
from ..kernels.rng import normal, uniform
from .bench import Bench, BenchRules, Experiments, ExperimentState

LEAST_GAIN, MOST_GAIN = 0.01, 100.0
"""Bounds of a drifting gain."""


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
