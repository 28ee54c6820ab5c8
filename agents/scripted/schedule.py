"""Scripted manager of orders that arrive over time: order acceptance, vessel assignment and cancellation."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import ndtr

from chemlab.config.draws import ORDER_QUANTITIES, VESSEL_QUANTITIES, Draw
from chemlab.config.scenario import DemandSpec, Scenario
from chemlab.kernels.arrays import FloatArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.sampling import quantiles
from chemlab.roles.manager_actions import MEASURE
from chemlab.roles.manager_view import terms_channels

from .campaign import run_once
from .reaction import told_rate
from .script import ScriptedManager, Setting, cheapest

__all__ = ["SchedulingManager", "has_orders_to_schedule"]

_GRID = 33
"""Number of titre candidates."""
_SURE = 0.9
"""Probability above which no further measurement is considered."""
_LIKELY = 0.25
"""Minimum probability of meeting an order for which reagent is used."""
_MOST_TICKS = 1_000_000
_SPREAD = 0.04
"""Relative standard deviation of a vessel's yield besides the uncertainty of its reading."""
_RATES = 7
"""Number of candidates of a rate that is revealed only to a bench: midpoints of equally likely parts of its prior."""


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
        grade: by slot, the number of the quality requirement of its last run.
        reported: by slot, the amount that the bench reported for its last run.
        rates: by stage, [L] the probability of each rate that may be revealed to the stage's bench.
        seen: orders in the order of their arrival.
        asked: the slot that is being measured.
    """

    rates: list[FloatArray]
    titre: dict[int, float] = field(default_factory=dict)
    stage: dict[int, int] = field(default_factory=dict)
    serves: dict[int, int] = field(default_factory=dict)
    running: dict[str, int] = field(default_factory=dict)
    grade: dict[int, int] = field(default_factory=dict)
    reported: dict[int, float] = field(default_factory=dict)
    seen: list[int] = field(default_factory=list)
    asked: int | None = None


class SchedulingManager(ScriptedManager[_Shop]):
    """Accepts the best paying orders that reagent and time allow, and ignores the others.

    An order is accepted if its price is among the highest ones for which there is reagent, counting known orders and
    those expected under the prior. It is made from the vessel with the highest probability of a sufficient yield, given
    its readings. A measurement is paid for if its value exceeds its price. Finished vessels fill the best paying orders
    first. A rate that is revealed only to a bench is inferred from what the bench reports (Bayes), and decides which
    quality requirement the bench is given.

    Args:
        setting: the manager's laboratory; if not careful, it never measures. Its margin is that of the benches.
        schedule: False processes one order at a time in order of arrival and drops only orders that cannot be met any
            more.
        remember: False infers nothing from reports.
    """

    def __init__(self, setting: Setting, schedule: bool = True, remember: bool = True) -> None:
        super().__init__(setting)
        scenario, channels, _, instruments, _, careful, skip, margin_k = setting
        self._schedule, self._remember = schedule, remember
        self._high = {channel.name: channel.high for channel in channels}
        self._stages = list(scenario.benches)
        self._outcomes: dict[Any, tuple[FloatArray, FloatArray]] = {}  # of the present decision
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
        self._made = _foreseen(scenario, tuple(self._titres.tolist()), margin_k)
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
                stage, report = shop.stage.get(slot, 0), f"{agent}_reported_amount"
                if report in self._slices:
                    said = self._value(observation, report)
                    if self._remember and stage < len(self._stages):
                        self._infer(shop, slot, stage, said)
                    shop.reported[slot] = said
                shop.stage[slot] = stage + 1

    def _infer(self, shop: _Shop, slot: int, stage: int, said: float) -> None:
        """Update the probabilities of the rate that is revealed to a stage's bench, from its report."""
        key = self._stages[stage]
        error = (self._scenario.benches[key].report or 0.0) * self._high[f"{self._agents[key][0]}_reported_amount"]
        expected = self._after(shop, slot, stage, shop.grade.get(slot, -1))
        noise = np.hypot(_SPREAD * expected, error)
        likely = np.exp(-0.5 * ((said - expected) / noise) ** 2) / noise
        weights = shop.rates[stage] * likely.mean(axis=0) + 1e-9
        shop.rates[stage] = weights / weights.sum()

    def _after(self, shop: _Shop, slot: int, stage: int, grade: int, before: FloatArray | None = None) -> FloatArray:
        """Return [..., L] mol after the run of a stage, at each rate that may be revealed to its bench.

        Args:
            shop, slot: the vessel.
            stage, grade: the run.
            before: [...] mol after the stage before; default: as reported, or the titre's candidates [T].
        """
        made = self._made[stage, grade]
        if stage == 0:
            given, at = (np.array([shop.titre[slot]]) if slot in shop.titre else self._titres), self._titres
        else:
            given = np.array([shop.reported[slot]]) if before is None else before
            at = self._typical(stage - 1)
        return np.stack([np.interp(given, at, own) for own in made], axis=-1)

    def _typical(self, stage: int) -> FloatArray:
        """Return [T] mol from which the next stage has been simulated."""
        return np.asarray(self._made[stage, _best_grade(self._made[stage]), self._made.shape[2] // 2])

    def _chance(self, shop: _Shop, slot: int, order: _Order) -> float:
        """Return the probability that a vessel meets an order's amount and time."""
        return self._best(shop, slot, order)[0]

    def _best(self, shop: _Shop, slot: int, order: _Order) -> tuple[float, int]:
        """Return the highest chance of meeting an order in time, and the number of the next stage's quality requirement
        for it: of about equal ones the fastest, and the fastest where there is no time."""
        steps = [self._grades[key] for key in self._stages[shop.stage.get(slot, 0) :]]
        best, chosen = (0, 0), (0.0, 0)
        for grades in itertools.product(range(len(self._names)), repeat=len(steps)):
            ticks = sum(own[grade] for own, grade in zip(steps, grades, strict=True))
            if ticks <= order.left:
                chance = self._met(shop, slot, order.amount, grades)
                if (round(20.0 * chance), -ticks) > best:
                    best, chosen = (round(20.0 * chance), -ticks), (chance, grades[0] if grades else 0)
        return chosen

    def _met(self, shop: _Shop, slot: int, amount: float, grades: Sequence[int]) -> float:
        """Return the probability that a vessel has an amount after runs of the remaining stages."""
        known = shop.reported.get(slot, shop.titre.get(slot))
        key = (slot in shop.reported, known, shop.stage.get(slot, 0), shop.grade.get(slot), *grades)
        if key not in self._outcomes:
            self._outcomes[key] = self._outcome(shop, slot, grades)
        amounts, weights = self._outcomes[key]
        if known is None:
            return float(weights @ (amounts >= amount))
        spread = np.hypot(_SPREAD * amounts, self._noise * self._made[-1].max()) + 1e-9
        return float(weights @ ndtr((amounts - amount) / spread))

    def _outcome(self, shop: _Shop, slot: int, grades: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return [K] mol after runs of the remaining stages, and [K] their probabilities: from the last report, or from
        the titre."""
        stage = min(shop.stage.get(slot, 0), len(self._stages))
        begun = stage if slot in shop.reported else 0
        amounts, weights = np.array([shop.reported.get(slot, 0.0)]), np.ones(1)
        for number, grade in enumerate([*[shop.grade.get(slot, 0)] * (stage - begun), *grades], begun):
            amounts = self._after(shop, slot, number, grade, None if number == begun else amounts)
            weights = np.multiply.outer(weights if number > begun else np.ones(len(amounts)), shop.rates[number])
        return amounts.ravel(), (weights / weights.sum()).ravel()

    # -- deciding ---------------------------------------------------------------------------------------------

    def _see(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            self._kept[member] = _Shop([np.full(self._made.shape[2], 1.0 / self._made.shape[2]) for _ in self._stages])
        shop = self._kept[member]
        self._outcomes.clear()
        self._learn(shop, observation)
        shop.seen += [order.number for order in self._known(observation) if order.number not in shop.seen]

    def _take_note(self, observation: ObservationArray, action: int, member: int) -> None:
        shop = self._kept[member]
        kind, slot, more = self._taken_apart(action)
        if kind == "start":
            agent = more[0]
            shop.running[agent] = slot
            shop.grade[slot] = self._names.index(more[2]) if self._scenario.grades else 0
            served = set(shop.serves.values())
            waiting = [order for order in self._known(observation) if order.number not in served]
            if agent in self._agents[self._stages[0]] and slot not in shop.serves and waiting:
                shop.serves[slot] = max(waiting, key=lambda order: order.price).number
        elif kind in ("submit", "discard"):
            self._part_with(shop, slot)
        elif kind == "measure" and more[0] == self._instrument:
            shop.asked = slot

    def _part_with(self, shop: _Shop, slot: int) -> None:
        for memory in (shop.stage, shop.serves, shop.titre, shop.reported, shop.grade):
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
        known = {order.number: order for order in orders}
        for slot, stage in shop.stage.items():
            if 0 < stage < len(self._stages) and slot not in shop.running.values():
                action = self._start(shop, slot, stage, known.get(shop.serves.get(slot, -1)), mask)
                if action is not None:
                    return action
        return None

    def _start(self, shop: _Shop, slot: int, stage: int, order: _Order | None, mask: MaskArray) -> int | None:
        """Start a run on a free bench, with the quality requirement that is best for the vessel's order."""
        grade = self._best(shop, slot, order)[1] if order is not None else 0
        names = [self._names[grade]] if self._scenario.grades else []
        for agent in self._agents[self._stages[stage]]:
            if agent not in shop.running:
                action = self._actions.encode("start", agent, slot, _goal(self._scenario, stage), *names)
                if mask[action]:
                    shop.running[agent], shop.grade[slot] = slot, grade
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
                action = self._start(shop, ranked[0], 0, order, mask)
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
        good = float((self._typical(-1) >= order.amount).mean())
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


def _best_grade(made: FloatArray) -> int:
    """Return the quality requirement of the highest yield of a stage [grades, L, T]."""
    return int(made.mean(axis=(1, 2)).argmax())


@functools.lru_cache(maxsize=16)
def _foreseen(scenario: Scenario, titres: tuple[float, ...], margin_k: float) -> FloatArray:
    """Simulate the yields [stages, grades, L, T] in mol of each stage's goal from the first vessel.

    The public scenario is used at each titre, and at each of L rates that may be revealed to the stage's bench. The
    stages before have had the best time, and all other hidden parameters have their prior's median.
    """
    titre, stages = _titre(scenario), list(scenario.benches)
    assert titre is not None, "has_orders_to_schedule(scenario) holds"
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
    rates = [told_rate(scenario, key) for key in stages]
    count = _RATES if any(rates) else 1
    grades: list[str | None] = [*scenario.grades] or [None]
    grades.sort(key=lambda name: (scenario.grades[name].ticks or _MOST_TICKS) if name else 0)
    labs, at = Laboratories(known, count * len(titres)), int(slot[5:])
    made = np.zeros((len(stages), len(grades), count, len(titres)))
    for stage, rate in enumerate(rates):
        shares = (np.arange(count) + 0.5) / count
        told = quantiles(others[rate], shares) if rate else np.zeros(count)
        for member in labs.members:
            which, t = divmod(int(member), len(titres))
            drawn = typical | ({rate: float(told[which])} if rate else {})
            labs.reset(labs.members[member : member + 1], world={"titre": {slot: titres[t]}, **drawn})
        for before in range(stage):
            grade = grades[_best_grade(made[before])]
            run_once(labs, f"{stages[before]}_0", _goal(scenario, before), at, grade, margin_k)
        ready = labs.snapshot()
        goal = _goal(scenario, stage)
        part = labs.rules.arrays.parts[scenario.goals.index(goal), 0]
        for g, grade in enumerate(grades):
            labs.restore(ready)
            run_once(labs, f"{stages[stage]}_0", goal, at, grade, margin_k)
            made[stage, g] = labs.shelf.amounts[:, at, part].reshape(count, -1)
    return made
