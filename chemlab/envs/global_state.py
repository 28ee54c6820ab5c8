"""``state()`` of the environments: the whole laboratory as one vector, for centralized critics.

It is everything that the rest of an episode depends on, but for the random streams: the true contents of every vessel,
bottle and waste can, and the state of every role (:meth:`chemlab.roles.base.Role.state`), with the arrays that a bench
of your own declares. Every part is in [0, 1]; quantities without a bound are clipped at one that is far off. A channel
is one kind of quantity. Its numbers are in the order of the axes that its meaning names; ``vessels`` are the slots and
then every bench's positions, ``materials`` those of the scenario.
"""

from __future__ import annotations

import math

import gymnasium
import numpy as np

from ..config.draws import ORDER_QUANTITIES
from ..kernels.arrays import IntArray, ObservationArray
from ..lab.engine import Laboratories
from ..physics.chemistry import AIR, CAPACITY, CLOCK, CLOCK_WAS, PRESENT, TEMPERATURE
from ..physics.constants import GAS_CONSTANT
from ..physics.shelf import CLOCK_SETTLED, T_MIX
from ..roles.base import VESSEL_TEMPERATURES_K, Quantity, one_hot
from ..roles.bench import Channel
from ..roles.manager_state import INSTRUMENTS, PRICE, RUNNING


class GlobalState:
    """The state of some laboratories as one vector.

    Attributes:
        channels: what the vector holds, in order.
        space: what it is an element of.
    """

    def __init__(self, laboratories: Laboratories) -> None:
        self._laboratories = laboratories
        self._known = laboratories.shelf.chemistry.world()  # of the data files: one scale for all worlds
        self._litres = self._known.molar_volume
        self.channels = [
            Channel(part.name, part.values[0].size, part.unit, part.low, part.high, part.meaning)
            for part in self._parts(laboratories.members[:1])
            if part.values[0].size
        ]
        size = sum(channel.size for channel in self.channels)
        self.space = gymnasium.spaces.Box(0.0, 1.0, (size,), np.float32)

    def see(self, members: IntArray) -> ObservationArray:
        """Return [B, size] the states of the laboratories ``members``."""
        out = np.empty((len(members), *self.space.shape), dtype=np.float32)
        at = 0
        with np.errstate(under="ignore"):  # traces underflow to 0
            for part in self._parts(members):  # one by one, so that the arrays fit into the processor's cache
                values = part.values.reshape(len(members), math.prod(part.values.shape[1:]))
                scaled = (values - part.low) * (1.0 / (part.high - part.low))
                out[:, at : at + values.shape[1]] = scaled
                at += values.shape[1]
        return np.clip(out, 0.0, 1.0, out=out)

    def _parts(self, members: IntArray) -> list[Quantity]:
        labs = self._laboratories
        return [
            *self._vessel_parts(members),
            *self._shelf_parts(members),
            *(part for role in labs.roles for part in role.state(members)),
            *self._order_parts(members),
            *self._turn_parts(members),
            *self._world_parts(members),
            *(part for role in (*labs.bench_roles, labs.manager) for part in role.condition(members)),
        ]

    def _vessel_parts(self, members: IntArray) -> list[Quantity]:
        labs, shelf = self._laboratories, self._laboratories.shelf
        largest = labs.rules.arrays.largest_capacity
        known, clock = self._known, (T_MIX, CLOCK_SETTLED)
        rows = shelf.vessels[members]
        air = rows[..., AIR] * GAS_CONSTANT * known.ambient_temperature / known.ambient_pressure
        dissolved = shelf.dissolved[members] * self._litres[known.dissolved][:, None]
        amounts = shelf.amounts[members] * self._litres
        return [
            Quantity("present", "0 or 1", "whether there is a vessel, by vessel", rows[..., PRESENT]),
            Quantity("capacity", "L", "by vessel", rows[..., CAPACITY], high=largest),
            Quantity("temperature", "K", "by vessel", rows[..., TEMPERATURE], *VESSEL_TEMPERATURES_K),
            Quantity("clock", "clock", "how far layers have settled, by vessel", rows[..., CLOCK], *clock),
            Quantity("clock_was", "clock", "when solutes were last spread", rows[..., CLOCK_WAS], *clock),
            Quantity("air", "L", "air in the vessel, as at ambient conditions, by vessel", air, high=largest),
            Quantity("amounts", "L", "mol x molar volume, by vessel, material", amounts, high=largest),
            Quantity("dissolved", "L", "the same in each solvent, by vessel, solute, solvent", dissolved, high=largest),
        ]

    def _shelf_parts(self, members: IntArray) -> list[Quantity]:
        labs, rules, state = self._laboratories, self._laboratories.rules.arrays, self._laboratories.state
        first = np.where(rules.first_stock > 0.0, rules.first_stock, 1.0)[rules.stocked]
        stock = labs.shelf.stock[members][:, rules.stocked] / first
        # An empty slot has no history.
        age = np.where(state.age[members] < 0, rules.tick_limit, state.age[members])
        standing = sum(sum(vessel.contents.values()) for vessel in labs.scenario.shelf.vessel)
        everything = float(rules.first_stock.sum()) + standing
        reserved = one_hot(state.reserved[members] + 1, len(labs.benches) + 1)
        bench = one_hot(state.last_bench[members], rules.kinds + 1)
        position = one_hot(state.last_position[members], rules.most_positions)
        return [
            Quantity("reserved", "one-hot", "for nobody or a bench, by slot", reserved),
            Quantity("last_bench", "one-hot", "none or its kind, by slot", bench),
            Quantity("last_position", "one-hot", "position it had there, by slot", position),
            Quantity("reading", "scaled", "last readings of instruments, by slot", state.reading[members]),
            Quantity(
                "age", "ticks", "age of readings (never: the limit), by slot, instrument", age, high=rules.tick_limit
            ),
            Quantity("stock", "fraction", "left, by bottle", stock),
            Quantity("waste", "mol", "of all there was, by material", labs.shelf.waste[members], high=everything),
            Quantity("delivered", "mol", "with submitted vessels", state.delivered[members], high=everything),
        ]

    def _order_parts(self, members: IntArray) -> list[Quantity]:
        labs, state = self._laboratories, self._laboratories.state
        goal, submitted = state.goal[members], state.submitted[members]
        worth = submitted[..., 0] / labs.rules.arrays.maximum[goal]
        return [
            Quantity("goal", "one-hot", "by order", one_hot(goal, len(labs.scenario.goals))),
            Quantity("filled", "0 or 1", "by order", state.filled[members]),
            Quantity("submitted", "fraction", "mol of the theoretical maximum, by order", worth),
            Quantity("purity", "fraction", "of what has been submitted, by order", submitted[..., 1]),
            *self._terms_parts(members),
        ]

    def _terms_parts(self, members: IntArray) -> list[Quantity]:
        labs, state = self._laboratories, self._laboratories.state
        most = labs.rules.arrays.most_terms
        terms = ("tick it arrives", "ticks it is to be met within", "price", "least mol", "least purity")
        parts = []
        if labs.scenario.demand.order:
            parts = [
                Quantity(what, "scaled", f"{words}, by order", state.terms[members, :, k], high=float(most[k]))
                for k, (what, words) in enumerate(zip(ORDER_QUANTITIES, terms, strict=True))
            ]
            parts.append(Quantity("paid", "scaled", "so far, by order", state.paid[members], high=float(most[PRICE])))
        reports = state.report[members]
        if reports.shape[1]:
            parts.append(Quantity("report", "fraction", "by bench: mol, purity, ticks", state.report[members]))
        if labs.scenario.grades:
            grades = [experiments.grade[members] for experiments in labs.experiments]
            hot = one_hot(np.stack(grades, axis=1), len(labs.scenario.grades))
            parts.append(Quantity("grade", "one-hot", "of the last experiment, by bench", hot))
        return parts

    def _turn_parts(self, members: IntArray) -> list[Quantity]:
        labs, rules, state = self._laboratories, self._laboratories.rules.arrays, self._laboratories.state
        budget = state.charges[members, INSTRUMENTS] / rules.budget
        return [
            Quantity("turn", "one-hot", "who has it, by agent", one_hot(labs.turn_of(members), len(labs.agents))),
            Quantity("finished", "0 or 1", "whether an experiment has ended in this tick", state.finished[members]),
            Quantity("over", "0 or 1", "whether the episode is", state.status[members] != RUNNING),
            Quantity("actions", "actions", "of the manager so far", state.actions[members], high=rules.action_limit),
            Quantity("ticks", "ticks", "so far", state.ticks[members], high=rules.tick_limit),
            Quantity("budget", "fraction", "of the budget for measurements spent", budget),
            Quantity("charges", "score", "to the manager so far, by item", labs.charges(members)),
        ]

    def _world_parts(self, members: IntArray) -> list[Quantity]:
        worlds = self._laboratories.worlds
        meaning = "share of the prior below what was drawn, or which option: " + ", ".join(worlds.names)
        return [Quantity("world", "fraction", meaning, worlds.positions(members))]
