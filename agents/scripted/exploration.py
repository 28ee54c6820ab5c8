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

from .reaction import ScriptedReaction
from .script import ScriptedManager, Setting, cheapest, likelihood

__all__ = ["CampaignManager", "foreseen", "has_unknown_rate", "run_once"]

_GRID = 48
"""Number of rate candidates: midpoints of equally likely parts of the prior."""
_MOST_RUNS = 40
_SAMPLES = 32
"""Readings sampled to estimate the value of one measurement."""
_MODEL_ERROR = 0.004
"""Standard deviation of readings besides their noise: true rates lie between the grid's."""
_SURPRISE = 1e-12
_LEAST_GAIN = 1e-3
"""Expected gain below which a free measurement is not taken either."""


def has_unknown_rate(scenario: Scenario) -> str | None:
    """Return the name of the drawn rate constant if it is the only hidden parameter and only reactions exist; else
    None.
    """
    draws = scenario.world.draws
    rates = [name for name, draw in draws.items() if draw.what == "pre_exponential" and draw.variables == 1]
    reacting = {bench.kind for bench in scenario.benches.values()} == {"reaction"}
    return rates[0] if rates and len(draws) == 1 and reacting else None


@dataclass
class _Belief:
    """The manager's belief in one episode.

    Attributes:
        weights: [T] probability of each rate.
        slots: slots of the remaining vessels; the manager works on the first.
        orders: open orders; the first is filled next.
        runs: number of experiments of each slot's vessel.
        asked: True if the last action measured the first vessel.
    """

    weights: FloatArray
    slots: list[int]
    orders: list[int]
    runs: dict[int, int] = field(default_factory=dict)
    asked: bool = False


class CampaignManager(ScriptedManager[_Belief]):
    """Runs the reaction bench on one batch after another, each until the expected gain of continuing is not positive.

    The outcome of a batch at every candidate rate is simulated on the public scenario beforehand. The probability of
    every rate is updated with each reading (Bayes) and carried over to the next batch. The manager measures when the
    expected gain of the information, for this and the later batches, exceeds the price.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
        remember: False resets the belief after each batch.
    """

    def __init__(self, setting: Setting, remember: bool = True) -> None:
        super().__init__(setting)
        scenario, careful, skip = setting.scenario, setting.careful, setting.skip
        self._remember = remember
        kinds = {bench.kind: key for key, bench in scenario.benches.items() if key not in skip}
        self._rxn = f"{kinds['reaction']}_0" if "reaction" in kinds else None
        self._instrument = cheapest(scenario, ("gas_chromatograph", "uv_vis")) if careful else None
        drawn = has_unknown_rate(scenario)
        assert drawn is not None, "has_unknown_rate(scenario) holds"
        self._numbers = quantiles(scenario.world.draws[drawn], (np.arange(_GRID) + 0.5) / _GRID)
        self._expected, self._worth = _foreseen(
            scenario, drawn, tuple(self._numbers.tolist()), self._instrument, self._rxn
        )
        spec = scenario.instruments.get(str(self._instrument))
        self._noise = float(np.hypot(spec.noise, _MODEL_ERROR)) if spec is not None else 1.0
        self._price = max(spec.price, _LEAST_GAIN) if spec is not None else 0.0
        # Fixed random numbers for every decision: rates, spread over all likely ones, and noise.
        self._shares = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        self._errors = np.random.default_rng(0).normal(0.0, self._noise, (_SAMPLES, self._expected.shape[2]))

    def _see(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            self._kept[member] = self._begin(observation, self._prior())
        belief = self._kept[member]
        if belief.asked:
            belief.asked = False
            reading = observation[self._slices[f"slot_{belief.slots[0]}_{self._instrument}"]].astype(np.float64)
            belief.weights = self._updated(belief.weights, reading, self._runs(belief))
        if not belief.slots or not belief.orders:
            # The episode continues although the manager submitted: another policy has acted in its place.
            self._kept[member] = self._begin(observation, belief.weights)

    def _begin(self, observation: ObservationArray, weights: FloatArray) -> _Belief:
        return _Belief(weights, self._occupied(observation) or [0], list(range(len(self._orders))))

    def _runs(self, belief: _Belief) -> int:
        return min(belief.runs.get(belief.slots[0], 0), _MOST_RUNS)

    def _take_note(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._kept[member]
        kind, slot, more = self._taken_apart(action)
        if slot not in belief.slots:
            return
        # Work on the vessel that another policy turned to.
        belief.slots.remove(slot)
        if kind in ("start", "measure"):
            belief.slots.insert(0, slot)
        if kind == "start":
            belief.runs[slot] = belief.runs.get(slot, 0) + 1
        elif kind == "measure":
            belief.asked = more[0] == self._instrument
        elif kind == "submit":
            self._submitted(belief, more[0])

    def _submitted(self, belief: _Belief, order: int) -> None:
        belief.orders = [other for other in belief.orders if other != order]
        if not self._remember:
            belief.weights = self._prior()

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        belief, wait = self._kept[member], self._actions.encode("wait")
        if self._rxn is not None and mask[wait] and self._value(observation, f"{self._rxn}_busy") > 0.5:
            return wait
        slot, order, runs = belief.slots[0], belief.orders[0], self._runs(belief)
        if self._measures(belief, mask, slot):
            belief.asked = True
            return self._actions.encode("measure", slot, str(self._instrument))
        if (belief.weights @ self._worth[:, runs:]).argmax() > 0 and self._rxn is not None:
            start = self._actions.encode("start", self._rxn, slot, self._goal(observation, order))
            if mask[start]:
                belief.runs[slot] = runs + 1
                return start
        submit = self._encode_submit(slot, order)
        belief.slots.pop(0)
        self._submitted(belief, order)
        return submit if mask[submit] else int(mask.argmax())

    def _goal(self, observation: ObservationArray, order: int) -> str:
        return self._scenario.goals[int(observation[self._slices[self._orders[order]]].argmax())]

    def _prior(self) -> FloatArray:
        return np.full(_GRID, 1.0 / _GRID)

    def _updated(self, weights: FloatArray, readings: FloatArray, runs: int) -> FloatArray:
        """Return [..., T] probabilities after readings [..., size] of a vessel with a number of runs."""
        found = weights * likelihood(readings, self._expected[:, runs], self._noise, _SURPRISE)
        return np.asarray(found / found.sum(axis=-1, keepdims=True))

    def _prospect(self, weights: FloatArray, runs: int, left: int) -> FloatArray:
        """Return the expected value [...] of this batch and ``left`` later ones, without another measurement."""
        here = (weights @ self._worth[:, runs:]).max(axis=-1)
        return np.asarray(here + left * (weights @ self._worth).max(axis=-1))

    def _measures(self, belief: _Belief, mask: MaskArray, slot: int) -> bool:
        """Return True if another measurement is worth its price."""
        runs = self._runs(belief)
        if self._instrument is None or runs == 0 or not mask[self._actions.encode("measure", slot, self._instrument)]:
            return False
        left = len(belief.orders) - 1 if self._remember else 0
        rates = np.searchsorted(np.cumsum(belief.weights), self._shares).clip(0, _GRID - 1)
        readings = self._expected[rates, runs] + self._errors
        after = self._prospect(self._updated(belief.weights, readings, runs), runs, left).mean()
        return bool(after - self._prospect(belief.weights, runs, left) > self._price)


@functools.lru_cache(maxsize=16)
def _foreseen(
    scenario: Scenario, drawn: str, numbers: tuple[float, ...], instrument: str | None, agent: str | None
) -> tuple[FloatArray, FloatArray]:
    """Simulate a batch at each candidate rate in the public scenario.

    Returns:
        Readings [T, runs, size] without noise, and the batch's value [T, runs] in raw score less the cost of time.
    """
    worlds = [{drawn: number} for number in numbers]
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
        worlds: hidden parameters of each world; None: nothing is drawn.
        instrument: instrument that measures the vessel; None: no readings.
        agent: bench that processes the vessel; None: no experiments.
        runs: number of experiments.

    Returns:
        Readings [T, runs + 1, size] without noise; raw score [T, runs + 1] that the vessel would add if submitted for
        one of the orders; elapsed ticks [runs + 1].
    """
    exact = {name: spec.model_copy(update={"noise": 0.0}) for name, spec in scenario.instruments.items()}
    labs = Laboratories(scenario.model_copy(update={"instruments": exact}), len(worlds))
    members, rules = labs.members, labs.rules.arrays
    for member, world in zip(members, worlds, strict=True):
        labs.reset(members[member : member + 1], world=world)
    goal = int(labs.state.goal[0, 0])
    name, orders = scenario.goals[goal], labs.state.goal.shape[1]
    size = 1 if instrument is None else labs.instruments.channels[labs.instruments.names.index(instrument)].size
    readings, worth = np.zeros((len(worlds), runs + 1, size)), np.zeros((len(worlds), runs + 1))
    ticks = np.zeros(runs + 1, dtype=np.int64)
    for run in range(runs + 1):
        amounts = labs.shelf.amounts[:, 0]
        made, all_there = amounts[:, rules.parts[goal, 0]], amounts @ rules.counts[goal]
        purity = made / np.maximum(all_there, 1e-12)
        met = (purity >= rules.least_purity[goal]) & (made >= rules.least_amount[goal])
        worth[:, run] = met * made * purity / rules.maximum[goal] / orders
        if instrument is not None:
            number = labs.instruments.names.index(instrument)
            zeros = np.zeros(len(members), dtype=np.int64)
            labs.instruments.read(labs.shelf, labs.state.reading, labs.state.stream, members, zeros, zeros + number)
            start, stop = labs.instruments.start[number : number + 2]
            readings[:, run] = labs.state.reading[:, 0, start:stop]
        if run < runs:
            ticks[run + 1] = ticks[run] + (0 if agent is None else run_once(labs, agent, name))
    return readings, worth, ticks


def run_once(labs: Laboratories, agent: str, goal: str) -> int:
    """Run one experiment of the scripted bench on the first vessel of every laboratory; return its ticks."""
    number, members, ticks = labs.agents.index(agent), labs.members, 0
    bench = labs.roles[number].workplace
    assert isinstance(bench, ReactionBench), "the manager starts reactions only"
    policy, grades = ScriptedReaction(bench), list(labs.scenario.grades)[-1:]
    for action in (labs.actions.encode("start", agent, 0, goal, *grades), labs.actions.encode("wait")):
        labs.act(labs.manager.index, members, np.full(len(members), action))
    while labs.busy[labs.bench_agents.index(agent), 0]:
        seen, step = labs.observe(number, members), labs.turns_had(number)[members]
        labs.act(number, members, policy.act(seen, None, step, members))
        ticks += 1
    return ticks
