"""Scripted manager of lines that drift and break, and of an instrument that goes astray."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from chemlab.config.draws import quantiles
from chemlab.config.scenario import DriftSpec, Scenario, WearSpec
from chemlab.kernels.arrays import FloatArray, MaskArray, ObservationArray

from .campaign import foreseen
from .script import ScriptedManager, Setting, apart, cheapest

__all__ = ["UpkeepManager", "has_wearing_lines"]

_PARTICLES = 128
"""Possible conditions of a line and of the vessel on it."""
_SAMPLES = 16
"""Readings that are thought of before one is paid for."""
_SLOW = 0.2
"""Gain at which a batch is played beforehand, so that its course is known in steps of a fifth of a run."""
_COURSE = 60
"""Runs at that gain."""
_MOST_RUNS = 24
_WAITS = (0, 1, 2)
"""Runs after which a look is thought of."""
_NEAR = 0.02
"""Share of a perfect batch that one is expected to be worth before a look is thought of at all."""
_MOST_LOOKS = 3
"""At a vessel as it is."""
_LOST_SHARE = 0.3
"""Of a batch at each line: what is begun and not brought to its end."""
_MODEL_ERROR = 0.004
"""Standard deviation of readings besides their noise: courses are interpolated."""


def has_wearing_lines(scenario: Scenario) -> bool:
    """Whether there is nothing but reaction benches of one kind that wear, and nothing hidden besides."""
    benches = list(scenario.benches.values())
    alike = {bench.model_copy(update={"wear": None, "count": 1}).model_dump_json() for bench in benches}
    drawn = {draw.what for draw in scenario.world.draws.values()}
    worn = all(bench.kind == "reaction" and bench.wear is not None for bench in benches)
    return worn and len(alike) == 1 and drawn <= {"gain"}


@dataclass
class _Line:
    """What the manager knows of a line.

    Attributes:
        agent: its bench.
        wear: how it wears.
        speed: [K] possible natural logarithms of its gain, each with the ``age`` of the same place.
        slot: where its vessel stands, or None.
        age: [K] how far the vessel's batch may have come, in runs at a gain of 1.
        begun: tick at which its experiment began, or None.
        looked: measurements of the vessel as it is.
    """

    agent: str
    wear: WearSpec
    speed: FloatArray
    slot: int | None = None
    age: FloatArray = field(default_factory=lambda: np.zeros(_PARTICLES))
    begun: int | None = None
    looked: int = 0


@dataclass
class _Belief:
    """What the manager knows in an episode.

    Attributes:
        lines: in the order of their benches.
        fresh: slots of vessels that nobody has worked on.
        left: (slot, age [K]) of vessels that were taken off a line that broke.
        rng: what it thinks of is drawn from it, the same in every episode.
        bias, doubt: [size] mean and variance of what the instrument's values are off by.
        known: tick at which that was so.
        orders: those that are open.
        asked: line whose vessel is being measured.
    """

    lines: list[_Line]
    fresh: list[int]
    rng: np.random.Generator
    bias: FloatArray
    doubt: FloatArray
    orders: list[int]
    left: list[tuple[int, FloatArray]] = field(default_factory=list)
    known: int = 0
    asked: _Line | None = None


class UpkeepManager(ScriptedManager[_Belief]):
    """Works on a batch at every line, and stops each where it is expected to be worth most.

    How a batch goes it has worked out on the public scenario beforehand. Of each line it keeps possible gains and, with
    them, how far its batch may have come (particles): they spread as lines drift, and are drawn anew by each reading
    (Bayes). Of the instrument it keeps mean and variance of what every value is off by, which grow with the time since
    the last calibration (a Kalman filter). It looks where, and when, what is to be expected of knowing more is above
    the price; calibrates where a look would be so much better then; and has a line repaired that is broken, or so slow
    that a repaired one would make more of the time that is left.

    Args:
        setting: what it is told; not careful, it never measures.
        remember: False forgets what it knew when a batch is over.
    """

    def __init__(self, setting: Setting, remember: bool = True) -> None:
        super().__init__(setting)
        scenario, actions, careful, skip = setting.scenario, setting.actions, setting.careful, setting.skip
        self._remember = remember
        self._benches = [agent for agent in actions.bench_agents if agent.rpartition("_")[0] not in skip]
        self._instrument = cheapest(scenario, ("gas_chromatograph", "hplc", "uv_vis")) if careful else None
        spec = scenario.instruments.get(str(self._instrument))
        self._price, self._noise = (spec.price, float(np.hypot(spec.noise, _MODEL_ERROR))) if spec else (0.0, 1.0)
        self._drift = (spec.drift if spec else None) or DriftSpec()
        self._steps = next(iter(scenario.benches.values())).step_limit
        self._foresee()

    def _foresee(self) -> None:
        """Work out what an undisturbed batch reads, and what it is worth, by its age."""
        spec, agent = self._scenario, self._actions.bench_agents[0]
        slow = {key: bench.model_copy(update={"wear": WearSpec(gain=_SLOW)}) for key, bench in spec.benches.items()}
        exact = {name: one.model_copy(update={"drift": None}) for name, one in spec.instruments.items()}
        steady = spec.model_copy(
            update={
                "benches": slow,
                "instruments": exact,
                "world": spec.world.model_copy(update={"draws": {}}),
                "limits": spec.limits.model_copy(update={"ticks": 1_000_000, "manager_actions": 100_000}),
            }
        )
        readings, worth, _ = foreseen(steady, [None], self._instrument, agent, _COURSE)
        self._ages = _SLOW * np.arange(_COURSE + 1)
        # Where nothing is to be seen at any age a reading says nothing.
        self._shown = np.flatnonzero(np.ptp(readings[0], axis=0) > _MODEL_ERROR)
        self._course, self._value_at = readings[0][:, self._shown], worth[0]

    # -- deciding ---------------------------------------------------------------------------------------------

    def _left(self, observation: ObservationArray) -> int:
        """Ticks that are left."""
        return round(self._value(observation, "ticks") * self._scenario.limits.ticks)

    def _new_speed(self, wear: WearSpec, rng: np.random.Generator) -> FloatArray:
        return np.asarray(np.log(wear.gain) + wear.spread * rng.standard_normal(_PARTICLES))

    def _first_speed(self, agent: str, wear: WearSpec, rng: np.random.Generator) -> FloatArray:
        """[K] speeds as an episode begins: what the world may have drawn besides."""
        speed = self._new_speed(wear, rng)
        for draw in self._scenario.world.draws.values():
            if agent in draw.of:
                drawn = np.log(quantiles(draw, rng.permutation((np.arange(_PARTICLES) + 0.5) / _PARTICLES)))
                speed = drawn if draw.change == "value" else speed + drawn
        return speed

    def _begin(self, observation: ObservationArray) -> _Belief:
        rng = np.random.default_rng(0)
        lines = []
        for agent in self._benches:
            wear = self._scenario.benches[agent.rpartition("_")[0]].wear or WearSpec()
            lines.append(_Line(agent, wear, self._first_speed(agent, wear, rng)))
        size = len(self._shown)
        doubt = np.full(size, self._drift.first**2)
        return _Belief(lines, self._occupied(observation), rng, np.zeros(size), doubt, list(range(len(self._orders))))

    def _see(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            self._kept[member] = self._begin(observation)
        self._pass_time(self._kept[member], observation, self._left(observation))

    def _take_note(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._kept[member]
        kind, slot, more = self._taken_apart(action)
        if kind == "start":
            line = next(line for line in belief.lines if line.agent == more[0])
            self._put_on(belief, line, slot)
            line.begun = belief.known
        elif kind == "measure" and more[0] == self._instrument:
            for line in belief.lines:
                if line.slot == slot:
                    belief.asked, line.looked = line, line.looked + 1
        elif kind in ("submit", "discard"):
            self._take_away(belief, slot)
            if kind == "submit":
                belief.orders = [order for order in belief.orders if order != more[0]]
        elif kind == "calibrate" and more[0] == self._instrument:
            self._calibrated(belief)
        elif kind == "repair":
            for line in belief.lines:
                if line.agent == more[0]:
                    line.speed = self._new_speed(line.wear, belief.rng)

    def _put_on(self, belief: _Belief, line: _Line, slot: int) -> None:
        """Somebody else has put a vessel on a line."""
        if line.slot == slot:
            return
        age = self._take_away(belief, slot)
        if line.slot is not None:
            belief.left.append((line.slot, line.age))
        line.slot, line.age, line.looked = slot, age, 0

    def _take_away(self, belief: _Belief, slot: int) -> FloatArray:
        """A vessel is no longer where it was; its age [K]."""
        age = np.zeros(_PARTICLES)
        for line in belief.lines:
            if line.slot == slot:
                age, line.slot = line.age, None
        for other, own in belief.left:
            age = own if other == slot else age
        belief.left = [(other, own) for other, own in belief.left if other != slot]
        belief.fresh = [other for other in belief.fresh if other != slot]
        return age

    def _calibrated(self, belief: _Belief) -> None:
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
        # Nothing goes on any more: what stands there is submitted as it is.
        standing = [line.slot for line in belief.lines if line.slot is not None] + [slot for slot, _ in belief.left]
        for slot in [*standing, *belief.fresh]:
            submit = self._submit(belief, slot)
            if mask[submit]:
                belief.orders = belief.orders[1:]
                return submit
        return int(mask.argmax())

    def _pass_time(self, belief: _Belief, observation: ObservationArray, left: int) -> None:
        """Take in what has happened since the last decision: a reading, experiments that are over, time."""
        now = self._scenario.limits.ticks - left
        belief.bias = belief.bias + self._drift.trend * (now - belief.known)
        belief.doubt = belief.doubt + self._drift.walk**2 * (now - belief.known)
        belief.known = now
        if belief.asked is not None:
            line, belief.asked = belief.asked, None
            reading = observation[self._slices[f"slot_{line.slot}_{self._instrument}"]].astype(np.float64)
            self._learn(belief, line, reading[self._shown])
        for line in belief.lines:
            if line.begun is not None and self._value(observation, f"{line.agent}_busy") < 0.5:
                line.speed, line.age = self._worked(line, now - line.begun, belief.rng)
                line.begun, line.looked = None, 0

    def _worked(self, line: _Line, ticks: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Speeds and ages [K] after so many ticks of work."""
        change = line.wear.drift * np.sqrt(ticks) * rng.standard_normal(_PARTICLES)
        return line.speed + change, line.age + ticks / self._steps * np.exp(line.speed + 0.5 * change)

    def _attend(
        self, belief: _Belief, line: _Line, observation: ObservationArray, mask: MaskArray, left: int
    ) -> int | None:
        """What to do about a line that is idle; None: nothing."""
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

    def _next_batch(self, belief: _Belief, line: _Line) -> bool:
        """Take up another vessel, one that has been begun before one that has not."""
        if belief.left:
            line.slot, line.age = belief.left.pop(0)
            return True
        if not belief.fresh:
            return False
        line.slot, line.age, line.looked = belief.fresh.pop(0), np.zeros(_PARTICLES), 0
        if not self._remember:
            line.speed = self._new_speed(line.wear, belief.rng)
        return True

    def _wants_repair(self, belief: _Belief, line: _Line, broken: bool, left: int) -> bool:
        """Whether a repaired line would make more of the time that is left, by more than the price."""
        best = int(self._value_at.argmax())
        ticks = self._ages[best] * self._steps  # of a batch at a gain of 1
        open_here = len(belief.orders) / len(belief.lines)
        begun = float(line.age.mean()) / self._ages[best] if line.slot is not None else 0.0

        def made(speed: FloatArray, time: float) -> float:
            batches = np.minimum(np.exp(speed) * max(time, 0.0) / ticks + begun, open_here)
            return float(np.maximum(batches - _LOST_SHARE, 0.0).mean() * self._value_at[best])

        now = 0.0 if broken else made(line.speed, left)
        then = made(self._new_speed(line.wear, belief.rng), left - line.wear.repair_ticks)
        return then - now > line.wear.repair_price

    def _work(self, belief: _Belief, line: _Line, mask: MaskArray, left: int) -> int | None:
        """Go on with the batch, look at it, or submit it."""
        assert line.slot is not None, "a line that works has a vessel"
        runs = min(_MOST_RUNS, max(left - 1, 0) // self._steps)
        ages = self._ahead(line, runs, belief.rng)
        worth = np.interp(ages, self._ages, self._value_at)
        expected = worth.mean(axis=0) - self._scenario.costs.tick * self._steps * np.arange(runs + 1)
        look = self._encode_look(line.slot)
        near = worth[:, : len(_WAITS)].mean(axis=0).max() > _NEAR * self._value_at.max()
        if look is not None and mask[look] and near:
            gains = [self._look(belief, ages, worth, wait, belief.doubt) for wait in _WAITS if wait <= runs]
            if gains[0] >= max(gains) and gains[0] - self._price > expected.max() and line.looked < _MOST_LOOKS:
                calibrate = self._encode_calibrate()
                if calibrate is not None and mask[calibrate]:
                    better = self._look(belief, ages, worth, 0, np.full(len(self._shown), self._drift.error**2))
                    if (better - gains[0]) * len(belief.orders) > self._drift.price:
                        self._calibrated(belief)
                        return calibrate
                belief.asked, line.looked = line, line.looked + 1
                return look
            if max(gains[1:], default=0.0) - self._price > expected.max():
                return self._start(belief, line, mask, left)
        if expected.argmax() > 0:
            return self._start(belief, line, mask, left)
        submit = self._submit(belief, line.slot)
        line.slot, belief.orders = None, belief.orders[1:]
        return submit if mask[submit] else int(mask.argmax())

    def _start(self, belief: _Belief, line: _Line, mask: MaskArray, left: int) -> int | None:
        start = self._actions.encode("start", line.agent, int(line.slot or 0), self._scenario.lab_goals[0])
        if not mask[start]:
            return None
        line.begun = self._scenario.limits.ticks - left
        return start

    # -- thinking ---------------------------------------------------------------------------------------------

    def _ahead(self, line: _Line, runs: int, rng: np.random.Generator) -> FloatArray:
        """[K, runs + 1] ages after 0, 1, ... more runs."""
        changes = line.wear.drift * np.sqrt(self._steps) * rng.standard_normal((_PARTICLES, runs))
        speeds = line.speed[:, None] + np.cumsum(changes, axis=1) - 0.5 * changes
        ages = line.age[:, None] + np.concatenate(
            [np.zeros((_PARTICLES, 1)), np.cumsum(np.exp(speeds), axis=1)], axis=1
        )
        return np.asarray(ages)

    def _shows(self, ages: FloatArray) -> FloatArray:
        """[..., size] what the instrument would read, were it right."""
        columns = [np.interp(ages, self._ages, column) for column in self._course.T]
        return np.stack(columns, axis=-1)

    def _look(self, belief: _Belief, ages: FloatArray, worth: FloatArray, wait: int, doubt: FloatArray) -> float:
        """What the batch is expected to come to with a look after ``wait`` runs, the price left out."""
        shown = self._shows(ages[:, wait])
        variance = self._noise**2 + doubt
        which = belief.rng.integers(_PARTICLES, size=_SAMPLES)
        readings = shown[which] + np.sqrt(variance) * belief.rng.standard_normal((_SAMPLES, len(variance)))
        weights = _likelihood(readings, shown, variance)
        costs = self._scenario.costs.tick * self._steps * np.arange(wait, worth.shape[1])
        return float((weights @ worth[:, wait:] - costs).max(axis=1).mean())

    def _learn(self, belief: _Belief, line: _Line, reading: FloatArray) -> None:
        """Take in a reading: particles that it speaks for stay, what it shows of the instrument's bias is kept."""
        shown = self._shows(line.age)
        variance = self._noise**2 + belief.doubt
        weights = _likelihood(reading, shown + belief.bias, variance)
        positions = (np.arange(_PARTICLES) + belief.rng.random()) / _PARTICLES
        kept = np.searchsorted(np.cumsum(weights), positions).clip(0, _PARTICLES - 1)
        line.age, line.speed = line.age[kept], line.speed[kept]
        shown = shown[kept]
        share = belief.doubt / (variance + shown.var(axis=0))
        belief.bias = belief.bias + share * (reading - shown.mean(axis=0) - belief.bias)
        belief.doubt = belief.doubt * (1.0 - share)

    # -- actions ----------------------------------------------------------------------------------------------

    def _submit(self, belief: _Belief, slot: int) -> int:
        return self._encode_submit(slot, belief.orders[0] if belief.orders else 0)

    def _encode_look(self, slot: int) -> int | None:
        return None if self._instrument is None else self._actions.encode("measure", slot, self._instrument)

    def _encode_calibrate(self) -> int | None:
        known = self._instrument in self._actions.drifting
        return self._actions.encode("calibrate", str(self._instrument)) if known else None


def _likelihood(readings: FloatArray, shown: FloatArray, variance: FloatArray) -> FloatArray:
    """[..., K] probabilities of particles that show ``shown`` [K, size] after readings [..., size]."""
    found = apart(readings, shown, variance)
    likely = np.exp(-0.5 * (found - found.min(axis=-1, keepdims=True)))
    return np.asarray(likely / likely.sum(axis=-1, keepdims=True))
