"""Scripted manager of several batches in one world: infers the reaction rate and applies it to later batches."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.sampling import quantiles
from chemlab.roles.reaction_bench import ReactionBench

from .belief import Belief, BeliefManager, first_reading, first_worth, noiseless, run_experiment
from .reaction import ScriptedReaction
from .script import Setting, likelihood, midpoints

_GRID = 48
"""Number of rate candidates: midpoints of equally likely parts of the prior."""
_MOST_RUNS = 40
_MODEL_ERROR = 0.004
"""Standard deviation of readings in addition to their noise, because true rates lie between the candidates."""
_SURPRISE = 1e-12
"""Lower bound of a likelihood relative to the best one."""
_LEAST_GAIN = 1e-3
"""Minimum expected gain of a measurement, even of a free one."""


def has_unknown_rate(scenario: Scenario) -> str | None:
    """Return the name of a rate constant that is the only hidden parameter, with reaction benches only; else None."""
    draws = scenario.world.draws
    rates = [name for name, draw in draws.items() if draw.what == "pre_exponential" and draw.variables == 1]
    reacting = {bench.kind for bench in scenario.benches.values()} == {"reaction"}
    return rates[0] if rates and len(draws) == 1 and reacting else None


@dataclass
class _Rates(Belief):
    """The manager's belief; it works on the first vessel, and fills the first order next.

    Attributes:
        weights: [T] probability of each rate.
        runs: number of experiments of each slot's vessel.
    """

    weights: FloatArray = field(default_factory=lambda: np.full(_GRID, 1.0 / _GRID))
    runs: dict[int, int] = field(default_factory=dict)


class CampaignManager(BeliefManager[_Rates]):
    """Runs the reaction bench on one batch after another, each until the expected gain of continuing is not positive.

    The outcome of a batch at every candidate rate is simulated on the public scenario beforehand. The probability of
    every rate is updated with each reading (Bayes) and carried over to the next batch. The manager measures when the
    expected gain of the information, for this and the later batches, exceeds the price. It measures a vessel once after
    each experiment, because a later reading is more informative than a repeated one; free readings may be repeated.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
        remember: False resets the belief after each batch.
    """

    def __init__(self, setting: Setting, remember: bool = True) -> None:
        super().__init__(setting, ("gas_chromatograph", "uv_vis"), _MODEL_ERROR)
        scenario, skip = setting.scenario, setting.skip
        self._remember = remember
        kinds = {bench.kind: key for key, bench in scenario.benches.items() if key not in skip}
        self._rxn = f"{kinds['reaction']}_0" if "reaction" in kinds else None
        drawn = has_unknown_rate(scenario)
        assert drawn is not None, "has_unknown_rate(scenario) holds"
        self._rates = quantiles(scenario.world.draws[drawn], midpoints(_GRID))
        rates = tuple(self._rates.tolist())
        self._expected, self._worth = _foreseen(scenario, drawn, rates, self._instrument, self._rxn)
        self._errors = self._errors_of(self._expected.shape[2])

    def _begin(self, observation: ObservationArray) -> _Rates:
        return _Rates(self._occupied(observation) or [0], list(range(len(self._orders))))

    def _observe(self, observation: ObservationArray, step: int, member: int) -> None:
        super()._observe(observation, step, member)
        belief = self._kept[member]
        if not belief.slots or not belief.orders:
            # The episode continues after the last submission only if another policy has acted for the manager.
            self._kept[member] = self._begin(observation)
            self._kept[member].weights = belief.weights

    def _learn(self, belief: _Rates, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        belief.weights = self._updated(belief.weights, reading, self._runs(belief))

    def _runs(self, belief: _Rates) -> int:
        """Return the number of experiments of the present vessel."""
        return min(belief.runs.get(belief.slots[0], 0), _MOST_RUNS)

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._kept[member]
        kind, slot, _ = self._decode(action)
        if slot in belief.slots:
            if kind in ("start", "measure"):
                # Continue with the vessel that another policy has chosen.
                belief.slots.remove(slot)
                belief.slots.insert(0, slot)
            self._update(belief, action)

    def _started(self, belief: _Rates, agent: str, slot: int, more: list[Any]) -> None:
        belief.runs[slot] = belief.runs.get(slot, 0) + 1

    def _removed(self, belief: _Rates, slot: int) -> None:
        belief.slots.remove(slot)

    def _submitted(self, belief: _Rates, order: int) -> None:
        super()._submitted(belief, order)
        if not self._remember:
            belief.weights = np.full(_GRID, 1.0 / _GRID)

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        belief, wait = self._kept[member], self._actions.encode("wait")
        if self._rxn is not None and mask[wait] and self._value(observation, f"{self._rxn}_busy") > 0.5:
            return wait
        slot, order, runs = belief.slots[0], belief.orders[0], self._runs(belief)
        if self._measures(belief, mask, slot):
            return self._update(belief, self._measure(slot))
        if (belief.weights @ self._worth[:, runs:]).argmax() > 0 and self._rxn is not None:
            start = self._actions.encode("start", self._rxn, slot, self._goal(observation, order))
            if mask[start]:
                return self._update(belief, start)
        return self._submit_for(mask, belief, slot, order)

    def _updated(self, weights: FloatArray, readings: FloatArray, runs: int) -> FloatArray:
        """Return [..., T] probabilities after readings [..., size] of a vessel with a number of experiments."""
        updated = weights * likelihood(readings, self._expected[:, runs], self._noise, _SURPRISE)
        return np.asarray(updated / updated.sum(axis=-1, keepdims=True))

    def _prospect(self, weights: FloatArray, runs: int, left: int) -> FloatArray:
        """Return the expected value [...] of this batch and ``left`` later ones, without another measurement."""
        here = (weights @ self._worth[:, runs:]).max(axis=-1)
        return np.asarray(here + left * (weights @ self._worth).max(axis=-1))

    def _measures(self, belief: _Rates, mask: MaskArray, slot: int) -> bool:
        """Return True if the value of another measurement exceeds its price."""
        runs = self._runs(belief)
        if self._instrument is None or runs == 0 or (self._price and slot in belief.read):
            return False
        if not mask[self._measure(slot)]:
            return False
        left = len(belief.orders) - 1 if self._remember else 0
        readings = self._expected[self._sampled(belief.weights), runs] + self._errors
        after = self._prospect(self._updated(belief.weights, readings, runs), runs, left).mean()
        return bool(after - self._prospect(belief.weights, runs, left) > max(self._price, _LEAST_GAIN))


@functools.lru_cache(maxsize=16)
def _foreseen(
    scenario: Scenario, drawn: str, rates: tuple[float, ...], instrument: str | None, agent: str | None
) -> tuple[FloatArray, FloatArray]:
    """Simulate a batch at each candidate rate in the public scenario.

    Returns:
        Readings [T, runs + 1, size] without noise, and the batch's value [T, runs + 1] less the cost of time.
    """
    draw = scenario.world.draws[drawn]
    is_single = draw.shared == "episode" or not draw.of
    worlds = [{drawn: rate if is_single else {draw.of[0]: rate}} for rate in rates]
    readings, worth, ticks = foreseen(scenario, worlds, instrument, agent, _MOST_RUNS)
    return readings, worth - scenario.costs.tick * ticks


def foreseen(
    scenario: Scenario,
    worlds: Sequence[Mapping[str, Any] | None],
    instrument: str | None,
    agent: str | None,
    runs: int,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Simulate the first vessel through successive experiments in given worlds of the public scenario.

    Args:
        scenario: the public scenario.
        worlds: hidden parameters of each world; None: the scenario has none.
        instrument: instrument that measures the vessel; None: no readings.
        agent: bench that processes the vessel; None: no experiments.
        runs: number of experiments.

    Returns:
        Readings [T, runs + 1, size] without noise; raw score [T, runs + 1] that the vessel would add if submitted for
        one of the orders; elapsed ticks [runs + 1].
    """
    labs = Laboratories(noiseless(scenario), len(worlds))
    members = labs.members
    for member, world in zip(members, worlds, strict=True):
        labs.reset(members[member : member + 1], world=world)
    goal = int(labs.state.goal[0, 0])
    step = (str(agent), scenario.goals[goal])
    policies = [None, *(ScriptedReaction(bench) for bench in labs.benches if isinstance(bench, ReactionBench))]
    readings, worth, ticks = [], [], np.zeros(runs + 1, dtype=np.int64)
    for run in range(runs + 1):
        if run and agent is not None:
            run_experiment(labs, policies, step, members)
        ticks[run] = labs.state.ticks[0]
        worth.append(first_worth(labs, goal))
        readings.append(first_reading(labs, instrument))
    return np.stack(readings, axis=1), np.stack(worth, axis=1), ticks
