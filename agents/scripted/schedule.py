"""Scripted manager of orders that arrive over time: order acceptance, vessel assignment and cancellation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import NormalDist

import numpy as np

from chemlab.config.draws import ORDER_QUANTITIES, VESSEL_QUANTITIES, Draw
from chemlab.config.scenario import DemandSpec, Scenario
from chemlab.kernels.arrays import FloatArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.sampling import quantiles
from chemlab.roles.manager_actions import MEASURE
from chemlab.roles.manager_view import terms_channels

from .campaign import run_once
from .script import ScriptedManager, Setting, cheapest

__all__ = ["SchedulingManager", "has_orders_to_schedule"]

_GRID = 33
"""Number of titre candidates."""
_SURE = 0.9
"""Probability above which no further measurement is considered."""
_LIKELY = 0.5
"""Minimum probability of meeting an order for which reagent is used."""
_MOST_TICKS = 1_000_000
_SPREAD = 0.04
"""Relative standard deviation of a vessel's yield besides the uncertainty of its reading; rates are hidden."""


def has_orders_to_schedule(scenario: Scenario) -> bool:
    """Return True if :class:`SchedulingManager` can play a scenario.

    Orders have to arrive over time and to be made by reacting vessels of unknown titre on one kind of bench after
    another.
    """
    reacting = {bench.kind for bench in scenario.benches.values()} == {"reaction"}
    return bool(scenario.demand.order) and reacting and _titre(scenario) is not None


def _titre(scenario: Scenario) -> Draw | None:
    draws = scenario.world.draws.values()
    return next((d for d in draws if d.what == "titre" and any(name.startswith("slot_") for name in d.of)), None)


@dataclass(frozen=True)
class _Order:
    """A known order: its index and its order terms."""

    number: int
    goal: str
    left: float
    price: float
    amount: float
    purity: float


@dataclass
class _Shop:
    """The manager's memory of one episode.

    Attributes:
        titre: by slot, the measured titre.
        stage: by slot, the number of benches that the vessel has been at.
        serves: by slot, the order for which the vessel was started.
        running: by bench agent, the slot of its vessel.
        reported: by slot, the amount that the bench reported for its last run.
        factor: ratio of actual to predicted yields.
        ended: number of runs behind ``factor``.
        seen: orders in the order of their arrival.
        asked: the slot that is being measured.
    """

    titre: dict[int, float] = field(default_factory=dict)
    stage: dict[int, int] = field(default_factory=dict)
    serves: dict[int, int] = field(default_factory=dict)
    running: dict[str, int] = field(default_factory=dict)
    reported: dict[int, float] = field(default_factory=dict)
    seen: list[int] = field(default_factory=list)
    factor: float = 1.0
    ended: int = 0
    asked: int | None = None


class SchedulingManager(ScriptedManager[_Shop]):
    """Accepts the best paying orders that reagent and time allow, and ignores the others.

    An order is accepted if its price is among the highest ones for which there is reagent, counting known orders and
    those expected under the prior. It is made from the vessel with the highest probability of a sufficient yield, given
    its readings. A measurement is paid for if its value exceeds its price. Finished vessels fill the best paying orders
    first.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
        schedule: False processes one order at a time in order of arrival and drops only orders that cannot be met any
            more.
    """

    def __init__(self, setting: Setting, schedule: bool = True) -> None:
        super().__init__(setting)
        scenario, channels, _, instruments, _, careful, skip = setting
        self._schedule = schedule
        self._high = {channel.name: channel.high for channel in channels}
        self._stages = list(scenario.benches)
        self._idle = bool(set(self._stages) & set(skip))
        self._agents = {key: [f"{key}_{i}" for i in range(scenario.benches[key].count)] for key in self._stages}
        # Quality requirements of every stage, the fastest first; without any, the step limits.
        ticks = {name: grade.ticks for name, grade in scenario.grades.items()} or {"": None}
        self._names = sorted(ticks, key=lambda name: ticks[name] or _MOST_TICKS)
        limits = {key: scenario.benches[key].step_limit for key in self._stages}
        self._grades = {key: [min(ticks[n] or most, most) for n in self._names] for key, most in limits.items()}
        self._ticks = sum(own[0] for own in self._grades.values())
        titre = _titre(scenario)
        assert titre is not None, "has_orders_to_schedule(scenario) holds"
        self._draw = titre
        shares = (np.arange(_GRID) + 0.5) / _GRID
        self._titres = quantiles(titre, shares)
        self._made = _foreseen(scenario, titre, self._titres, self._stages)
        prices = [draw for draw in scenario.world.draws.values() if draw.what == "price"]
        base = scenario.demand.order[0].price
        self._prices = base * quantiles(prices[0], shares) if prices else np.full(_GRID, base)
        chosen = cheapest(scenario, ("gas_chromatograph",)) if careful else None
        self._instrument = chosen
        self._analytes = instruments.analytes[instruments.names.index(chosen)] if chosen else ()
        self._noise = scenario.instruments[chosen].noise if chosen else 0.0
        self._price = scenario.instruments[chosen].price if chosen else 0.0

    # -- observation ------------------------------------------------------------------------------------------

    def _value(self, observation: ObservationArray, name: str) -> float:
        return super()._value(observation, name) * self._high[name]

    def _known(self, observation: ObservationArray) -> list[_Order]:
        """Return the open orders."""
        found = []
        for number, name in enumerate(self._orders):
            goal = observation[self._slices[name]]
            if goal.max() > 0.5:
                terms = [self._value(observation, channel) for channel in terms_channels(name)]
                found.append(_Order(number, self._scenario.goals[int(goal.argmax())], *terms))
        return found

    def _learn(self, shop: _Shop, observation: ObservationArray) -> None:
        """Update the memory with a requested reading and with reports of benches."""
        if shop.asked is not None:
            reading = observation[self._slices[f"slot_{shop.asked}_{self._instrument}"]].astype(np.float64)
            materials, volumes = self._scenario.materials, []
            for name in (self._draw.material, self._draw.inert):
                material = materials[str(name)]
                litres = material.molar_mass_g_mol / material.density_kg_l
                volumes.append(float(reading[self._analytes.index(str(name))]) * litres)
            shop.titre[shop.asked] = volumes[0] / max(sum(volumes), 1e-9)
            shop.asked = None
        for agent, slot in list(shop.running.items()):
            if self._value(observation, f"{agent}_busy") < 0.5:
                del shop.running[agent]
                shop.stage[slot] = shop.stage.get(slot, 0) + 1
                report = f"{agent}_reported_amount"
                if report in self._slices:
                    shop.reported[slot] = self._value(observation, report)
                    if shop.stage[slot] == len(self._stages) and slot in shop.titre:
                        foreseen = float(np.interp(shop.titre[slot], self._titres, self._made[-1]))
                        ratio = shop.reported[slot] / max(foreseen, 1e-9)
                        shop.factor += (min(ratio, 2.0) - shop.factor) / (1.0 + shop.ended)
                        shop.ended += 1

    def _chance(self, shop: _Shop, slot: int, order: _Order) -> float:
        """Return the probability that the yield of a vessel meets an order's amount."""
        made, stage = self._made[-1], shop.stage.get(slot, 0)
        if slot in shop.reported:
            own = self._made[stage - 1]
            mean = (
                shop.reported[slot] if stage == len(self._stages) else float(np.interp(shop.reported[slot], own, made))
            )
        elif slot not in shop.titre:
            return float((shop.factor * made >= order.amount).mean())
        else:
            mean = shop.factor * float(np.interp(shop.titre[slot], self._titres, made))
        spread = np.hypot(_SPREAD * mean, self._noise * made.max()) + 1e-9
        return NormalDist(mean, float(spread)).cdf(2.0 * mean - order.amount)

    # -- deciding ---------------------------------------------------------------------------------------------

    def _see(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            self._kept[member] = _Shop()
        shop = self._kept[member]
        self._learn(shop, observation)
        shop.seen += [order.number for order in self._known(observation) if order.number not in shop.seen]

    def _take_note(self, observation: ObservationArray, action: int, member: int) -> None:
        shop = self._kept[member]
        kind, slot, more = self._taken_apart(action)
        if kind == "start":
            agent = more[0]
            shop.running[agent] = slot
            served = set(shop.serves.values())
            waiting = [order for order in self._known(observation) if order.number not in served]
            if agent in self._agents[self._stages[0]] and slot not in shop.serves and waiting:
                shop.serves[slot] = max(waiting, key=lambda order: order.price).number
        elif kind in ("submit", "discard"):
            self._part_with(shop, slot)
        elif kind == "measure" and more[0] == self._instrument:
            shop.asked = slot

    def _part_with(self, shop: _Shop, slot: int) -> None:
        for memory in (shop.stage, shop.serves, shop.titre, shop.reported):
            memory.pop(slot, None)
        shop.stage[slot] = len(self._stages) + 1  # the vessel was removed

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        shop, orders = self._kept[member], self._known(observation)
        for choose in (self._submit, self._go_on, self._take):
            action = None if self._idle else choose(shop, orders, observation, mask)
            if action is not None:
                return action
        wait = self._actions.encode("wait")
        return wait if mask[wait] else int(mask.argmax())

    def _submit(self, shop: _Shop, orders: list[_Order], observation: ObservationArray, mask: MaskArray) -> int | None:
        """Fill an order with a finished vessel."""
        best, worth = None, 0.0
        for slot in [s for s, stage in shop.stage.items() if stage == len(self._stages)]:
            own = [order for order in orders if order.number == shop.serves.get(slot)]
            for order in orders if self._schedule or not own else own:
                chance = self._chance(shop, slot, order)
                action = self._encode_submit(slot, order.number)
                if order.left > 0.0 and chance > 0.3 and chance * order.price > worth and mask[action]:
                    best, worth = (slot, action), chance * order.price
        if best is None:
            return None
        self._part_with(shop, best[0])
        return best[1]

    def _go_on(self, shop: _Shop, orders: list[_Order], observation: ObservationArray, mask: MaskArray) -> int | None:
        """Send a vessel in process to its next bench."""
        left = {order.number: order.left for order in orders}
        for slot, stage in shop.stage.items():
            if 0 < stage < len(self._stages) and slot not in shop.running.values():
                action = self._start(shop, slot, stage, left.get(shop.serves.get(slot, -1), 0.0), mask)
                if action is not None:
                    return action
        return None

    def _start(self, shop: _Shop, slot: int, stage: int, left: float, mask: MaskArray) -> int | None:
        """Start a run on a free bench with the longest requirement that leaves time for the later stages."""
        steps = [self._grades[key] for key in self._stages[stage:]]
        in_time = [grade for grade, own in zip(self._names, zip(*steps, strict=True), strict=True) if sum(own) <= left]
        grade = [in_time[-1] if in_time else self._names[0]] if self._scenario.grades else []
        for agent in self._agents[self._stages[stage]]:
            if agent not in shop.running:
                action = self._actions.encode("start", agent, slot, _goal(self._scenario, stage), *grade)
                if mask[action]:
                    shop.running[agent] = slot
                    return action
        return None

    def _batches(self, observation: ObservationArray) -> int:
        """Return the number of runs for which there is reagent."""
        left = observation[self._slices["stock"]] if "stock" in self._slices else np.ones(0)
        stock, runs = dict(zip(self._scenario.stock, left.tolist(), strict=True)), [len(self._orders)]
        for key in self._stages:
            reagents: dict[str, float] = (self._scenario.benches[key].model_extra or {})["reagents"]
            for name, mol in reagents.items():
                if name in stock:  # a level is read to half of the gauge's resolution
                    most = self._scenario.stock[name] / mol
                    runs.append(int((stock[name] + 0.5 * self._scenario.shelf.gauge) * most + 0.01))
        return min(runs)

    def _take(self, shop: _Shop, orders: list[_Order], observation: ObservationArray, mask: MaskArray) -> int | None:
        """Start a profitable order, after a measurement if that is profitable."""
        batches = self._batches(observation)
        served = set(shop.serves.values())
        waiting = [order for order in orders if order.left >= self._ticks and order.number not in served]
        if batches < 1 or not waiting or all(agent in shop.running for agent in self._agents[self._stages[0]]):
            return None
        if self._schedule:
            # One batch for each of the best orders, known or expected.
            to_come = len(self._orders) - len(shop.seen)
            share = 1.0 - batches / (to_come + 1)
            least = float(np.quantile(self._prices, share)) if share > 0.0 else 0.0
            waiting = sorted((o for o in waiting if o.price >= least), key=lambda o: -o.price)
        else:
            at_work = bool(shop.running) or any(0 < stage <= len(self._stages) for stage in shop.stage.values())
            waiting = [] if at_work else sorted(waiting, key=lambda o: shop.seen.index(o.number))[:1]
        known = {s for s, stage in shop.stage.items() if stage != 0} | set(shop.running.values())
        fresh = [s for s in self._occupied(observation) if s not in known]
        for order in waiting:
            ranked = sorted(fresh, key=lambda s: (-round(self._chance(shop, s, order), 1), shop.titre.get(s, 1.0)))
            if not ranked:
                return None
            chance = self._chance(shop, ranked[0], order)
            look = self._look(shop, fresh, order, chance, mask)
            if look is not None:
                return look
            if chance >= _LIKELY or self._instrument is None or not self._may_look(mask):
                action = self._start(shop, ranked[0], 0, order.left, mask)
                if action is not None:
                    shop.serves[ranked[0]] = order.number
                    return action
        return None

    def _may_look(self, mask: MaskArray) -> bool:
        return bool(mask[self._actions.table[:, 0] == MEASURE].any())

    def _look(self, shop: _Shop, fresh: list[int], order: _Order, chance: float, mask: MaskArray) -> int | None:
        """Measure a vessel without a reading if the expected gain of finding a better one exceeds the price."""
        if self._instrument is None or chance >= _SURE:
            return None
        good = float((shop.factor * self._made[-1] >= order.amount).mean())
        if (1.0 - chance) * good * order.price / len(self._orders) <= self._price:
            return None
        for slot in fresh:
            action = self._actions.encode("measure", slot, self._instrument)
            if slot not in shop.titre and mask[action]:
                shop.asked = slot
                return action
        return None


def _goal(scenario: Scenario, stage: int) -> str:
    """Return the goal of a stage: goals are listed in production order, and the last is the ordered product."""
    return scenario.goals[max(len(scenario.goals) - len(scenario.benches) + stage, 0)]


def _foreseen(scenario: Scenario, titre: Draw, titres: FloatArray, stages: Sequence[str]) -> FloatArray:
    """Simulate the yields [stages, T] in mol of each stage's goal from the first vessel at each titre.

    The public scenario is used; all other hidden parameters have their prior's median.
    """
    slot = next(name for name in titre.of if name.startswith("slot_"))
    own = titre.model_copy(update={"of": (slot,), "test": ()})
    others = {
        name: draw
        for name, draw in scenario.world.draws.items()
        if draw.what not in (*VESSEL_QUANTITIES, *ORDER_QUANTITIES) and draw.variables == 1
    }
    typical = {name: float(quantiles(draw, np.array([0.5]))[0]) for name, draw in others.items()}
    world = scenario.world.model_copy(update={"draws": {"titre": own, **others}})
    known = scenario.model_copy(update={"world": world, "demand": DemandSpec()})
    labs = Laboratories(known, len(titres))
    for member, number in zip(labs.members, titres.tolist(), strict=True):
        labs.reset(labs.members[member : member + 1], world={"titre": {slot: number}, **typical})
    made = []
    for stage, key in enumerate(stages):
        goal = _goal(scenario, stage)
        run_once(labs, f"{key}_0", goal, int(slot[5:]))
        part = labs.rules.arrays.parts[scenario.goals.index(goal), 0]
        made.append(labs.shelf.amounts[:, int(slot[5:]), part].copy())
    return np.array(made)
