"""The whole laboratory as one vector, for critics that may know what no agent sees: ``state()`` of the environments.

It is everything that what happens next depends on, but for the random streams: true contents of every vessel, bottle
and waste can, and what the manager and the benches remember. Every part is in [0, 1]; those that have no bound of
their own are clipped at one that is far off. A channel is one kind of quantity, its numbers in the order of the axes
that its meaning names; ``vessels`` are the slots and then every bench's positions, ``materials`` those of the
scenario.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

from ..config.draws import ORDER_QUANTITIES
from ..kernels.arrays import IntArray, ObservationArray
from ..lab.engine import Laboratories
from ..physics.chemistry import AIR, CAPACITY, CLOCK, CLOCK_WAS, PRESENT, TEMPERATURE
from ..physics.constants import GAS_CONSTANT
from ..physics.shelf import CLOCK_SETTLED, T_MIX
from ..roles.bench import Channel
from ..roles.manager_state import INSTRUMENTS, PRICE, RUNNING
from ..roles.wear import MOST_GAIN

__all__ = ["GlobalState"]

_COLDEST_K, _HOTTEST_K = 200.0, 800.0


class _Part(NamedTuple):
    name: str
    unit: str
    low: float
    high: float
    meaning: str
    values: npt.NDArray[Any]
    """[B, ...] in ``unit``"""


class GlobalState:
    """What there is to know of some laboratories.

    Attributes:
        channels: what the vector holds, in order.
        space: what it is an element of.
    """

    def __init__(self, laboratories: Laboratories) -> None:
        self._laboratories = laboratories
        self._known = laboratories.shelf.chemistry.world()  # as the data files have it: one scale for all worlds
        self._litres = self._known.molar_volume
        self.channels = [
            Channel(part.name, part.values[0].size, part.unit, part.low, part.high, part.meaning)
            for part in self._parts(laboratories.members[:1])
            if part.values[0].size
        ]
        size = sum(channel.size for channel in self.channels)
        self.space = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)

    def see(self, members: IntArray) -> ObservationArray:
        """[B, size] the state of the laboratories ``members``."""
        out = np.empty((len(members), *self.space.shape), dtype=np.float32)
        at = 0
        with np.errstate(under="ignore"):  # traces are 0
            for part in self._parts(members):  # one by one: small enough for the processor's cache
                values = part.values.reshape(len(members), -1)
                scaled = (values - part.low) * (1.0 / (part.high - part.low))
                out[:, at : at + values.shape[1]] = scaled
                at += values.shape[1]
        return np.clip(out, 0.0, 1.0, out=out)

    def _parts(self, members: IntArray) -> list[_Part]:
        parts = (self._vessel_parts, self._shelf_parts, self._bench_parts, self._order_parts, self._turn_parts)
        return [part for some in (*parts, self._world_parts, self._condition_parts) for part in some(members)]

    def _vessel_parts(self, members: IntArray) -> list[_Part]:
        labs, shelf = self._laboratories, self._laboratories.shelf
        largest = labs.rules.arrays.largest_capacity
        known = self._known
        rows = shelf.vessels[members]
        air = rows[..., AIR] * GAS_CONSTANT * known.ambient_temperature / known.ambient_pressure
        dissolved = shelf.dissolved[members] * self._litres[known.dissolved][:, None]
        amounts = shelf.amounts[members] * self._litres
        return [
            _Part("present", "0 or 1", 0.0, 1.0, "whether there is a vessel, by vessel", rows[..., PRESENT]),
            _Part("capacity", "L", 0.0, largest, "by vessel", rows[..., CAPACITY]),
            _Part("temperature", "K", _COLDEST_K, _HOTTEST_K, "by vessel", rows[..., TEMPERATURE]),
            _Part("clock", "clock", T_MIX, CLOCK_SETTLED, "how far layers have settled, by vessel", rows[..., CLOCK]),
            _Part("clock_was", "clock", T_MIX, CLOCK_SETTLED, "when solutes were last spread", rows[..., CLOCK_WAS]),
            _Part("air", "L", 0.0, largest, "air in the vessel, as at ambient conditions, by vessel", air),
            _Part("amounts", "L", 0.0, largest, "mol x molar volume, by vessel, material", amounts),
            _Part("dissolved", "L", 0.0, largest, "the same in each solvent, by vessel, solute, solvent", dissolved),
        ]

    def _shelf_parts(self, members: IntArray) -> list[_Part]:
        labs, rules, state = self._laboratories, self._laboratories.rules.arrays, self._laboratories.state
        first = np.where(rules.first_stock > 0.0, rules.first_stock, 1.0)[rules.stocked]
        stock = labs.shelf.stock[members][:, rules.stocked] / first
        # Where a slot is empty, its history is none.
        age = np.where(state.age[members] < 0, rules.tick_limit, state.age[members])
        standing = sum(sum(vessel.contents.values()) for vessel in labs.scenario.shelf.vessel)
        everything = float(rules.first_stock.sum()) + standing
        return [
            _Part(
                "reserved",
                "one-hot",
                0.0,
                1.0,
                "for nobody or a bench, by slot",
                _hot(state.reserved[members] + 1, len(labs.benches) + 1),
            ),
            _Part(
                "last_bench",
                "one-hot",
                0.0,
                1.0,
                "none or its kind, by slot",
                _hot(state.last_bench[members], rules.kinds + 1),
            ),
            _Part(
                "last_position",
                "one-hot",
                0.0,
                1.0,
                "position it had there, by slot",
                _hot(state.last_position[members], rules.most_positions),
            ),
            _Part("reading", "scaled", 0.0, 1.0, "last readings of instruments, by slot", state.reading[members]),
            _Part(
                "age", "ticks", 0.0, rules.tick_limit, "age of readings (never: the limit), by slot, instrument", age
            ),
            _Part("stock", "fraction", 0.0, 1.0, "left, by bottle", stock),
            _Part("waste", "mol", 0.0, everything, "of all there was, by material", labs.shelf.waste[members]),
            _Part("delivered", "mol", 0.0, everything, "with submitted vessels", state.delivered[members]),
        ]

    def _bench_parts(self, members: IntArray) -> list[_Part]:
        labs, rules = self._laboratories, self._laboratories.rules.arrays
        parts, goals = [], len(labs.scenario.goals)
        for b, (bench, experiments) in enumerate(zip(labs.benches, labs.experiments, strict=True)):
            own = experiments.table.arrays
            busy, name = own.busy[members], experiments.agent
            most = rules.largest_capacity / float(self._litres[rules.parts[:, 0]].min())
            supply = np.zeros((len(members), 0))
            if bench.reagents:
                supply = own.supply[members] / np.maximum(bench.rules.arrays.full, 1e-12) * busy[:, None]
            jacket = np.zeros((len(members), 0))
            if getattr(bench.options, "jacket_w_k", None) is not None:
                jacket = own.jacket[members][:, None] * busy[:, None]
            goal = _hot(own.goal[members], goals) * busy[:, None]
            origin = _hot(labs.state.origin[members, b], rules.slots) * busy[:, None]
            parts += [
                _Part(f"{name}_busy", "0 or 1", 0.0, 1.0, "whether an experiment is running", busy),
                _Part(f"{name}_goal", "one-hot", 0.0, 1.0, "its goal", goal),
                _Part(f"{name}_steps", "steps", 0.0, bench.spec.step_limit, "taken", own.steps[members] * busy),
                _Part(f"{name}_origin", "one-hot", 0.0, 1.0, "slot its vessel came from", origin),
                _Part(
                    f"{name}_baseline", "mol", -most, most, "the score is the change from", own.baseline[members] * busy
                ),
                _Part(f"{name}_supply", "fraction", 0.0, 1.0, "left of the supply, by reagent", supply),
                _Part(f"{name}_jacket", "K", 0.0, _HOTTEST_K, "temperature of the jacket, if it has one", jacket),
            ]
        return parts

    def _order_parts(self, members: IntArray) -> list[_Part]:
        labs, state = self._laboratories, self._laboratories.state
        goal, submitted = state.goal[members], state.submitted[members]
        worth = submitted[..., 0] / labs.rules.arrays.maximum[goal]
        return [
            _Part("goal", "one-hot", 0.0, 1.0, "by order", _hot(goal, len(labs.scenario.goals))),
            _Part("filled", "0 or 1", 0.0, 1.0, "by order", state.filled[members]),
            _Part("submitted", "fraction", 0.0, 1.0, "mol of the theoretical maximum, by order", worth),
            _Part("purity", "fraction", 0.0, 1.0, "of what has been submitted, by order", submitted[..., 1]),
            *self._terms_parts(members),
        ]

    def _terms_parts(self, members: IntArray) -> list[_Part]:
        labs, state = self._laboratories, self._laboratories.state
        most = labs.rules.arrays.most_terms
        terms = ("tick it arrives", "ticks it is to be met within", "price", "least mol", "least purity")
        parts = []
        if labs.scenario.demand.order:
            parts = [
                _Part(what, "scaled", 0.0, float(most[k]), f"{words}, by order", state.terms[members, :, k])
                for k, (what, words) in enumerate(zip(ORDER_QUANTITIES, terms, strict=True))
            ]
            parts.append(_Part("paid", "scaled", 0.0, float(most[PRICE]), "so far, by order", state.paid[members]))
        if state.report.shape[1]:
            parts.append(_Part("report", "fraction", 0.0, 1.0, "by bench: mol, purity, ticks", state.report[members]))
        if labs.scenario.grades:
            grades = [experiments.grade[members] for experiments in labs.experiments]
            hot = _hot(np.stack(grades, axis=1), len(labs.scenario.grades))
            parts.append(_Part("grade", "one-hot", 0.0, 1.0, "of the last experiment, by bench", hot))
        return parts

    def _turn_parts(self, members: IntArray) -> list[_Part]:
        labs, rules, state = self._laboratories, self._laboratories.rules.arrays, self._laboratories.state
        budget = state.charges[members, INSTRUMENTS] / rules.budget
        return [
            _Part(
                "turn", "one-hot", 0.0, 1.0, "who has it, by agent", _hot(state.cursor[members] + 1, len(labs.agents))
            ),
            _Part(
                "finished", "0 or 1", 0.0, 1.0, "whether an experiment has ended in this tick", state.finished[members]
            ),
            _Part("over", "0 or 1", 0.0, 1.0, "whether the episode is", state.status[members] != RUNNING),
            _Part("actions", "actions", 0.0, rules.action_limit, "of the manager so far", state.actions[members]),
            _Part("ticks", "ticks", 0.0, rules.tick_limit, "so far", state.ticks[members]),
            _Part("budget", "fraction", 0.0, 1.0, "of the budget for measurements spent", budget),
            _Part("charges", "score", 0.0, 1.0, "to the manager so far, by item", labs.charges(members)),
        ]

    def _world_parts(self, members: IntArray) -> list[_Part]:
        worlds = self._laboratories.worlds
        meaning = "share of the prior below what was drawn, or which option: " + ", ".join(worlds.names)
        return [_Part("world", "fraction", 0.0, 1.0, meaning, worlds.positions(members))]

    def _condition_parts(self, members: IntArray) -> list[_Part]:
        """Condition of the benches that wear and of the instruments that drift."""
        labs, state, parts = self._laboratories, self._laboratories.state, []
        ticks, limit = state.ticks[members, None], labs.rules.arrays.tick_limit
        for b in labs.rules.arrays.wearing.tolist():
            experiments = labs.experiments[b]
            name, gain, most = experiments.agent, np.log(experiments.gain[members]), float(np.log(MOST_GAIN))
            life = np.minimum(experiments.life[members], limit)
            repair = np.maximum(state.ready[members, b] - ticks[:, 0], 0)
            parts += [
                _Part(f"{name}_gain", "ln", -most, most, "logarithm of it: stirring, heating", gain),
                _Part(f"{name}_life", "ticks", 0.0, limit, "of work until it breaks", life),
                _Part(f"{name}_broken", "0 or 1", 0.0, 1.0, "whether it is broken", experiments.broken[members]),
                _Part(f"{name}_repair", "ticks", 0.0, limit, "left of its repair", repair),
            ]
        if len(labs.rules.arrays.drifting):
            since, old = ticks - state.since[members], ticks - state.calibrated[members]
            parts += [
                _Part("bias", "scaled", -1.0, 1.0, "of readings when last worked out, by value", state.bias[members]),
                _Part("bias_age", "ticks", 0.0, limit, "since then, by instrument", since),
                _Part("trend", "scaled", -1.0, 1.0, "of the bias in a tick, by instrument", state.trend[members]),
                _Part("calibrated", "ticks", 0.0, limit, "since the calibration, by instrument", old),
            ]
        return parts


def _hot(indices: IntArray, size: int) -> npt.NDArray[np.float64]:
    """[..., size] one-hot."""
    return np.asarray((indices[..., None] == np.arange(size)).astype(np.float64))
