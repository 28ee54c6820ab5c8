"""Scripted manager of production lines that degrade and break down, with an instrument that drifts."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from chemlab.config.scenario import DriftSpec, Scenario, WearSpec
from chemlab.kernels.arrays import FloatArray, MaskArray, ObservationArray
from chemlab.lab.sampling import quantiles

from .belief import Belief, BeliefManager
from .exploration import foreseen
from .script import Setting, midpoints, squared_distance

_PARTICLES = 128
"""Particles per line: hypotheses about the line and the vessel on it."""
_SAMPLES = 16
"""Readings sampled to estimate the value of one measurement."""
_SLOW = 0.2
"""Gain of the simulated batch; its course is resolved in fifths of a run."""
_COURSE = 60
"""Number of simulated runs at that gain."""
_MOST_RUNS = 24
"""Maximum number of further runs that are predicted."""
_WAITS = (0, 1, 2)
"""Numbers of runs before a measurement that are compared."""
_NEAR = 0.02
"""Minimum value of a batch before a measurement is considered, as a share of the best batch's value."""
_MOST_LOOKS = 3
"""Maximum number of measurements of an unchanged vessel."""
_LOST_SHARE = 0.3
"""Expected loss per line, as a share of a batch, by batches that are not finished."""
_MODEL_ERROR = 0.004
"""Standard deviation of readings in addition to their noise, because the simulated course is interpolated."""


def has_wearing_lines(scenario: Scenario) -> bool:
    """Return True if the scenario has only reaction benches of one kind, with degradation as the only hidden state."""
    benches = list(scenario.benches.values())
    alike = {bench.model_copy(update={"wear": None, "count": 1}).model_dump_json() for bench in benches}
    drawn = {draw.what for draw in scenario.world.draws.values()}
    worn = all(bench.kind == "reaction" and bench.wear is not None for bench in benches)
    return worn and len(alike) == 1 and drawn <= {"gain"}


@dataclass
class _Line:
    """The manager's belief about one line.

    Attributes:
        agent: the line's bench agent.
        wear: parameters of its degradation.
        speed: [K] particles: natural logarithm of the gain, paired with ``age``.
        slot: slot of its vessel, or None.
        age: [K] particles: progress of the batch, in runs at a gain of 1.
        begun: tick at which its experiment began, or None.
        looked: number of measurements since its last experiment.
    """

    agent: str
    wear: WearSpec
    speed: FloatArray
    slot: int | None = None
    age: FloatArray = field(default_factory=lambda: np.zeros(_PARTICLES))
    begun: int | None = None
    looked: int = 0


@dataclass
class _Lines(Belief):
    """The manager's belief; ``slots`` have unused vessels.

    Attributes:
        lines: belief of each line, in the order of the benches.
        left: (slot, age [K]) of vessels removed from a broken line.
        rng: generator of the particles and sampled readings, with the same seed in every episode.
        bias, doubt: [size] mean and variance of the instrument's bias.
        known: tick of the last observation, at which these are valid.
    """

    lines: list[_Line] = field(default_factory=list)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    bias: FloatArray = field(default_factory=lambda: np.zeros(0))
    doubt: FloatArray = field(default_factory=lambda: np.zeros(0))
    left: list[tuple[int, FloatArray]] = field(default_factory=list)
    known: int = 0


class UpkeepManager(BeliefManager[_Lines]):
    """Works on a batch at every line and stops each batch at its highest expected value.

    The course of a batch is simulated on the public scenario beforehand. A particle filter tracks gain and batch
    progress of every line: particles spread as lines drift, and are resampled at each reading. A Kalman filter tracks
    mean and variance of the instrument's bias, which grow with the time since the last calibration. The manager
    measures when the expected gain of the information exceeds the price, and calibrates when that improves the
    measurement by more than its own price. It repairs a line that is broken, or so slow that the repaired line gains
    more in the remaining time than the repair costs.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
        remember: False resets the belief after each batch.
    """

    def __init__(self, setting: Setting, remember: bool = True) -> None:
        super().__init__(setting, ("gas_chromatograph", "hplc", "uv_vis"), _MODEL_ERROR)
        scenario, actions, skip = setting.scenario, setting.actions, setting.skip
        self._remember = remember
        self._benches = [agent for agent in actions.bench_agents if agent.rpartition("_")[0] not in skip]
        spec = scenario.instruments.get(str(self._instrument))
        self._drift = (spec.drift if spec else None) or DriftSpec()
        self._steps = next(iter(scenario.benches.values())).step_limit
        # Readings and value of an undisturbed batch as functions of its age; columns that hardly change are left out.
        readings, self._value_at = _undisturbed(scenario, self._instrument, actions.bench_agents[0])
        self._ages = _SLOW * np.arange(_COURSE + 1)
        self._shown = np.flatnonzero(np.ptp(readings, axis=0) > _MODEL_ERROR)
        self._course = readings[:, self._shown]

    # -- deciding ---------------------------------------------------------------------------------------------

    def _left(self, observation: ObservationArray) -> int:
        """Return the number of remaining ticks."""
        return round(self._value(observation, "ticks") * self._scenario.limits.ticks)

    def _new_speed(self, wear: WearSpec, rng: np.random.Generator) -> FloatArray:
        """Sample [K] speeds of a new or repaired line."""
        return np.asarray(np.log(wear.gain) + wear.spread * rng.standard_normal(_PARTICLES))

    def _first_speed(self, agent: str, wear: WearSpec, rng: np.random.Generator) -> FloatArray:
        """Sample [K] initial speeds of a line, with the hidden parameters of the world."""
        speed = self._new_speed(wear, rng)
        for draw in self._scenario.world.draws.values():
            if agent in draw.of:
                drawn = np.log(quantiles(draw, rng.permutation(midpoints(_PARTICLES))))
                speed = drawn if draw.change == "value" else speed + drawn
        return speed

    def _begin(self, observation: ObservationArray) -> _Lines:
        belief = _Lines(self._occupied(observation), list(range(len(self._orders))))
        for agent in self._benches:
            wear = self._scenario.benches[agent.rpartition("_")[0]].wear or WearSpec()
            belief.lines.append(_Line(agent, wear, self._first_speed(agent, wear, belief.rng)))
        size = len(self._shown)
        belief.bias, belief.doubt = np.zeros(size), np.full(size, self._drift.first**2)
        return belief

    def _observe(self, observation: ObservationArray, step: int, member: int) -> None:
        super()._observe(observation, step, member)
        belief = self._kept[member]
        for line in belief.lines:
            if line.begun is not None and self._value(observation, f"{line.agent}_busy") < 0.5:
                ticks = belief.known - line.begun
                change = line.wear.drift * np.sqrt(ticks) * belief.rng.standard_normal(_PARTICLES)
                line.age = line.age + ticks / self._steps * np.exp(line.speed + 0.5 * change)
                line.speed, line.begun, line.looked = line.speed + change, None, 0

    def _pass_time(self, belief: _Lines, observation: ObservationArray) -> None:
        now = self._scenario.limits.ticks - self._left(observation)
        belief.bias = belief.bias + self._drift.trend * (now - belief.known)
        belief.doubt = belief.doubt + self._drift.walk**2 * (now - belief.known)
        belief.known = now

    def _learn(self, belief: _Lines, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        for line in belief.lines:
            if line.slot == slot:
                self._resample(belief, line, reading[self._shown])

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._kept[member]
        kind, _, more = self._decode(action)
        self._update(belief, action)
        if kind == "calibrate" and more[0] == self._instrument:
            self._calibrated(belief)
        elif kind == "repair":
            for line in belief.lines:
                if line.agent == more[0]:
                    line.speed = self._new_speed(line.wear, belief.rng)

    def _started(self, belief: _Lines, agent: str, slot: int, more: list[Any]) -> None:
        line = next(line for line in belief.lines if line.agent == agent)
        line.begun = belief.known
        if line.slot == slot:
            return
        # Another policy has put a vessel on the line.
        age = self._take_away(belief, slot)
        if line.slot is not None:
            belief.left.append((line.slot, line.age))
        line.slot, line.age, line.looked = slot, age, 0

    def _measured(self, belief: _Lines, slot: int) -> None:
        for line in belief.lines:
            line.looked += line.slot == slot

    def _removed(self, belief: _Lines, slot: int) -> None:
        self._take_away(belief, slot)

    def _take_away(self, belief: _Lines, slot: int) -> FloatArray:
        """Remove a vessel from the belief, and return its age [K]."""
        age = np.zeros(_PARTICLES)
        for line in belief.lines:
            if line.slot == slot:
                age, line.slot = line.age, None
        age = dict(belief.left).get(slot, age)
        belief.left = [(other, old) for other, old in belief.left if other != slot]
        belief.slots = [other for other in belief.slots if other != slot]
        return age

    def _calibrated(self, belief: _Lines) -> None:
        """Reset the belief about the instrument's bias after a calibration."""
        belief.bias[:], belief.doubt[:] = 0.0, self._drift.error**2

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        belief = self._kept[member]
        left = self._left(observation)
        for line in belief.lines:
            if line.begun is None:
                action = self._attend(belief, line, observation, mask, left)
                if action is not None:
                    return action
        wait = self._actions.encode("wait")
        if mask[wait]:
            return wait
        # No line can continue: submit the vessels in their present state.
        used = [line.slot for line in belief.lines if line.slot is not None] + [slot for slot, _ in belief.left]
        for slot in [*used, *belief.slots]:
            submit = self._submit(belief, slot)
            if mask[submit]:
                belief.orders = belief.orders[1:]
                return submit
        return int(mask.argmax())

    def _attend(
        self, belief: _Lines, line: _Line, observation: ObservationArray, mask: MaskArray, left: int
    ) -> int | None:
        """Return the next action for an idle line, or None if there is nothing to do."""
        if self._value(observation, f"{line.agent}_repair") > 0.0:
            return None
        broken = self._value(observation, f"{line.agent}_broken") > 0.5
        repair = self._actions.encode("repair", line.agent)
        if mask[repair] and belief.orders and self._wants_repair(belief, line, broken, left):
            line.speed = self._new_speed(line.wear, belief.rng)
            return repair
        if broken:
            if line.slot is not None:
                belief.left.append((line.slot, line.age))
                line.slot = None
            return None
        if line.slot is None and not self._next_batch(belief, line):
            return None
        return self._work(belief, line, mask, left)

    def _next_batch(self, belief: _Lines, line: _Line) -> bool:
        """Assign the next vessel to a line, used vessels before unused ones; return False if there is none."""
        if belief.left:
            line.slot, line.age = belief.left.pop(0)
            return True
        if not belief.slots:
            return False
        line.slot, line.age, line.looked = belief.slots.pop(0), np.zeros(_PARTICLES), 0
        if not self._remember:
            line.speed = self._new_speed(line.wear, belief.rng)
        return True

    def _wants_repair(self, belief: _Lines, line: _Line, broken: bool, left: int) -> bool:
        """Return True if a repaired line would gain more in the remaining time than the repair costs."""
        best = int(self._value_at.argmax())
        ticks = self._ages[best] * self._steps  # ticks of a batch at a gain of 1
        open_here = len(belief.orders) / len(belief.lines)
        begun = float(line.age.mean()) / self._ages[best] if line.slot is not None else 0.0

        def value(speed: FloatArray, time: float) -> float:
            batches = np.minimum(np.exp(speed) * max(time, 0.0) / ticks + begun, open_here)
            return float(np.maximum(batches - _LOST_SHARE, 0.0).mean() * self._value_at[best])

        without = 0.0 if broken else value(line.speed, left)
        repaired = value(self._new_speed(line.wear, belief.rng), left - line.wear.repair_ticks)
        return repaired - without > line.wear.repair_price

    def _work(self, belief: _Lines, line: _Line, mask: MaskArray, left: int) -> int | None:
        """Continue, measure or submit the line's batch."""
        assert line.slot is not None, "a working line has a vessel"
        runs = min(_MOST_RUNS, max(left - 1, 0) // self._steps)
        ages = self._ahead(line, runs, belief.rng)
        worth = np.interp(ages, self._ages, self._value_at)
        expected = worth.mean(axis=0) - self._scenario.costs.tick * self._steps * np.arange(runs + 1)
        is_near = worth[:, : len(_WAITS)].mean(axis=0).max() > _NEAR * self._value_at.max()
        if self._instrument is not None and mask[self._measure(line.slot)] and is_near:
            values = [self._informed_value(belief, ages, worth, wait, belief.doubt) for wait in _WAITS if wait <= runs]
            if values[0] >= max(values) and values[0] - self._price > expected.max() and line.looked < _MOST_LOOKS:
                if self._instrument in self._actions.drifting:
                    calibrate = self._actions.encode("calibrate", self._instrument)
                    doubt = np.full(len(self._shown), self._drift.error**2)
                    if mask[calibrate]:
                        calibrated = self._informed_value(belief, ages, worth, 0, doubt)
                        if (calibrated - values[0]) * len(belief.orders) > self._drift.price:
                            self._calibrated(belief)
                            return calibrate
                return self._update(belief, self._measure(line.slot))
            if max(values[1:], default=0.0) - self._price > expected.max():
                return self._start(belief, line, mask)
        if expected.argmax() > 0:
            return self._start(belief, line, mask)
        submit = self._update(belief, self._submit(belief, line.slot))
        return submit if mask[submit] else int(mask.argmax())

    def _start(self, belief: _Lines, line: _Line, mask: MaskArray) -> int | None:
        """Return the action that starts the line's experiment; None if it is illegal."""
        start = self._actions.encode("start", line.agent, int(line.slot or 0), self._scenario.lab_goals[0])
        return self._update(belief, start) if mask[start] else None

    # -- prediction -------------------------------------------------------------------------------------------

    def _ahead(self, line: _Line, runs: int, rng: np.random.Generator) -> FloatArray:
        """Return [K, runs + 1] ages after 0, 1, ... further runs."""
        changes = line.wear.drift * np.sqrt(self._steps) * rng.standard_normal((_PARTICLES, runs))
        speeds = line.speed[:, None] + np.cumsum(changes, axis=1) - 0.5 * changes
        added = np.pad(np.cumsum(np.exp(speeds), axis=1), ((0, 0), (1, 0)))
        return np.asarray(line.age[:, None] + added)

    def _expected_readings(self, ages: FloatArray) -> FloatArray:
        """Return [..., size] readings of an unbiased instrument without noise at ages [...]."""
        columns = [np.interp(ages, self._ages, column) for column in self._course.T]
        return np.stack(columns, axis=-1)

    def _informed_value(
        self, belief: _Lines, ages: FloatArray, worth: FloatArray, wait: int, doubt: FloatArray
    ) -> float:
        """Return the expected value of a batch that is measured after ``wait`` runs, without the price.

        ``ages`` and ``worth`` [K, runs + 1] are those after 0, 1, ... runs; ``doubt`` [size] is the bias's variance.
        """
        expected = self._expected_readings(ages[:, wait])
        variance = self._noise**2 + doubt
        which = belief.rng.integers(_PARTICLES, size=_SAMPLES)
        readings = expected[which] + np.sqrt(variance) * belief.rng.standard_normal((_SAMPLES, len(variance)))
        weights = _posterior(readings, expected, variance)
        costs = self._scenario.costs.tick * self._steps * np.arange(wait, worth.shape[1])
        return float((weights @ worth[:, wait:] - costs).max(axis=1).mean())

    def _resample(self, belief: _Lines, line: _Line, reading: FloatArray) -> None:
        """Resample a line's particles after a reading [size], and update the instrument's bias (Kalman filter)."""
        expected = self._expected_readings(line.age)
        variance = self._noise**2 + belief.doubt
        weights = _posterior(reading, expected + belief.bias, variance)
        positions = (np.arange(_PARTICLES) + belief.rng.random()) / _PARTICLES
        kept = np.searchsorted(np.cumsum(weights), positions).clip(0, _PARTICLES - 1)
        line.age, line.speed = line.age[kept], line.speed[kept]
        expected = expected[kept]
        gain = belief.doubt / (variance + expected.var(axis=0))
        belief.bias = belief.bias + gain * (reading - expected.mean(axis=0) - belief.bias)
        belief.doubt = belief.doubt * (1.0 - gain)

    def _submit(self, belief: _Lines, slot: int) -> int:
        """Return the action that submits a slot's vessel for the first open order."""
        return self._encode_submit(slot, belief.orders[0] if belief.orders else 0)


def _posterior(readings: FloatArray, expected: FloatArray, variance: FloatArray) -> FloatArray:
    """Return [..., K] probabilities of particles with expected readings [K, size], given readings [..., size]."""
    distance = squared_distance(readings, expected, variance)
    likely = np.exp(-0.5 * (distance - distance.min(axis=-1, keepdims=True)))
    return np.asarray(likely / likely.sum(axis=-1, keepdims=True))


@functools.lru_cache(maxsize=16)
def _undisturbed(scenario: Scenario, instrument: str | None, agent: str) -> tuple[FloatArray, FloatArray]:
    """Return readings [_COURSE + 1, size] and values [_COURSE + 1] of a batch on a line with a constant gain."""
    slow = {key: bench.model_copy(update={"wear": WearSpec(gain=_SLOW)}) for key, bench in scenario.benches.items()}
    exact = {name: one.model_copy(update={"drift": None}) for name, one in scenario.instruments.items()}
    steady = scenario.model_copy(
        update={
            "benches": slow,
            "instruments": exact,
            "world": scenario.world.model_copy(update={"draws": {}}),
            "limits": scenario.limits.model_copy(update={"ticks": 1_000_000, "manager_actions": 100_000}),
        }
    )
    readings, worth, _ = foreseen(steady, [None], instrument, agent, _COURSE)
    return readings[0], worth[0]
