"""Scripted manager of several batches in one world: learns how fast the reaction is, and uses it on the next ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from chemlab.config.draws import quantiles
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.reaction_bench import ReactionBench

from .reaction import ReactionHeuristic
from .script import ScriptedManager, Setting, cheapest, likelihood

__all__ = ["CampaignManager", "foreseen", "has_unknown_rate", "run_once"]

_GRID = 48
"""Rates that are told apart: the middle of each part of the prior, all as likely."""
_MOST_RUNS = 40
_SAMPLES = 32
"""Readings that are thought of before one is paid for."""
_MODEL_ERROR = 0.004
"""Standard deviation of readings besides their noise: rates lie between those of the grid."""
_SURPRISE = 1e-12


def has_unknown_rate(scenario: Scenario) -> str | None:
    """Name of the draw of one rate constant, where that is all that is hidden and there is nothing but reacting."""
    draws = scenario.world.draws
    rates = [name for name, draw in draws.items() if draw.what == "pre_exponential" and draw.variables == 1]
    reacting = {bench.kind for bench in scenario.benches.values()} == {"reaction"}
    return rates[0] if rates and len(draws) == 1 and reacting else None


@dataclass
class _Belief:
    """What the manager knows in an episode.

    Attributes:
        weights: [T] probability of each rate.
        slots: of the vessels that are left; it works on the first.
        orders: those that are open; the first is filled next.
        runs: experiments that a slot's vessel has had.
        asked: whether the last action was a measurement of the first.
    """

    weights: FloatArray
    slots: list[int]
    orders: list[int]
    runs: dict[int, int] = field(default_factory=dict)
    asked: bool = False


class CampaignManager(ScriptedManager[_Belief]):
    """Runs the reaction bench on one batch after the other, each until going on is not worth it.

    How a batch goes at each possible rate it has worked out on the public scenario beforehand. It keeps the probability
    of every rate, brings it up to date with each reading (Bayes), and carries it on to the next batch. It measures
    where the gain that is to be expected of knowing more, for this batch and those to come, is above the price.

    Args:
        setting: what it is told; not careful, it never measures.
        remember: False forgets what it knew when a batch is over.
    """

    def __init__(self, setting: Setting, remember: bool = True) -> None:
        super().__init__(setting)
        scenario, careful, skip = setting.scenario, setting.careful, setting.skip
        self._remember = remember
        kinds = {bench.kind: key for key, bench in scenario.benches.items() if key not in skip}
        self._rxn = f"{kinds['reaction']}_0" if "reaction" in kinds else None
        self._instrument = cheapest(scenario, ("gas_chromatograph", "uv_vis")) if careful else None
        drawn = has_unknown_rate(scenario)
        assert drawn is not None, "whoever makes this has asked"
        self._numbers = quantiles(scenario.world.draws[drawn], (np.arange(_GRID) + 0.5) / _GRID)
        self._expected, self._worth = _foreseen(scenario, drawn, self._numbers, self._instrument, self._rxn)
        spec = scenario.instruments.get(str(self._instrument))
        self._noise = float(np.hypot(spec.noise, _MODEL_ERROR)) if spec is not None else 1.0
        self._price = spec.price if spec is not None else 0.0
        # The same thoughts every time: which rates, spread over all that are likely, and which noise.
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
            # And yet it is not over: somebody else has acted in its place.
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
        # The vessel that somebody else turns to is the one that is worked on.
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
        """[..., T] probabilities after readings [..., size] of a vessel that has had so many runs."""
        found = weights * likelihood(readings, self._expected[:, runs], self._noise, _SURPRISE)
        return np.asarray(found / found.sum(axis=-1, keepdims=True))

    def _prospect(self, weights: FloatArray, runs: int, left: int) -> FloatArray:
        """[...] what this batch and ``left`` others after it are expected to come to, without another look."""
        here = (weights @ self._worth[:, runs:]).max(axis=-1)
        return np.asarray(here + left * (weights @ self._worth).max(axis=-1))

    def _measures(self, belief: _Belief, mask: MaskArray, slot: int) -> bool:
        """Whether another look is worth its price."""
        runs = self._runs(belief)
        if self._instrument is None or runs == 0 or not mask[self._actions.encode("measure", slot, self._instrument)]:
            return False
        left = len(belief.orders) - 1 if self._remember else 0
        rates = np.searchsorted(np.cumsum(belief.weights), self._shares).clip(0, _GRID - 1)
        readings = self._expected[rates, runs] + self._errors
        after = self._prospect(self._updated(belief.weights, readings, runs), runs, left).mean()
        return bool(after - self._prospect(belief.weights, runs, left) > self._price)


def _foreseen(
    scenario: Scenario, drawn: str, numbers: FloatArray, instrument: str | None, agent: str | None
) -> tuple[FloatArray, FloatArray]:
    """What a batch comes to at each possible rate: readings [T, runs, size] without noise, and worth [T, runs] to the
    score, less the time it takes; played on the public scenario."""
    readings, worth, ticks = foreseen(
        scenario, [{drawn: number} for number in numbers.tolist()], instrument, agent, _MOST_RUNS
    )
    return readings, worth - scenario.costs.tick * ticks


def foreseen(
    scenario: Scenario,
    worlds: Sequence[Mapping[str, Any] | None],
    instrument: str | None,
    agent: str | None,
    runs: int,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """What the first vessel comes to in some worlds of the public scenario, one experiment after the other.

    Args:
        scenario: the public scenario.
        worlds: what is given of each; None: nothing is drawn.
        instrument: that looks at it; None: none does.
        agent: bench that works on it; None: none does.
        runs: how many experiments.

    Returns:
        Readings [T, runs + 1, size] without noise; what it would be worth to the score as one of the orders
        [T, runs + 1]; ticks passed by then [runs + 1].
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


def run_once(labs: Laboratories, agent: str, goal: str, slot: int = 0) -> int:
    """One experiment of the scripted bench on a slot of every laboratory; its ticks."""
    number, members, ticks = labs.agents.index(agent), labs.members, 0
    bench = labs.benches[number - 1]
    assert isinstance(bench, ReactionBench), "the manager starts reactions only"
    policy = ReactionHeuristic(bench)
    grade = list(labs.scenario.grades)[-1:]
    for action in (labs.actions.encode("start", agent, slot, goal, *grade), labs.actions.encode("wait")):
        labs.act(0, members, np.full(len(members), action))
    while labs.busy[number - 1, 0]:
        seen, step = labs.observe(number, members), labs.turns_had(number)[members]
        labs.act(number, members, policy.act(seen, None, step, members))
        ticks += 1
    return ticks
