"""Scripted manager of orders that arrive over time: order acceptance, vessel assignment and cancellation."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.special import ndtr

from chemlab.config.draws import ORDER_QUANTITIES, VESSEL_QUANTITIES, Draw
from chemlab.config.scenario import DemandSpec, Scenario
from chemlab.envs.players import Policy
from chemlab.kernels.arrays import FloatArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.sampling import quantiles
from chemlab.roles.grades import REPORT
from chemlab.roles.manager_actions import MEASURE
from chemlab.roles.manager_view import terms_channels

from .belief import Belief, BeliefManager, run_experiment
from .script import Setting, midpoints

_GRID = 33
"""Number of titre candidates."""
_SURE = 0.9
"""Probability above which no further measurement is considered."""
_LIKELY = 0.25
"""Minimum probability of meeting an order for which reagent is used."""
_MOST_TICKS = 1_000_000
_SPREAD = 0.04
"""Relative standard deviation of a vessel's yield, in addition to the uncertainty of its reading."""
_RATES = 7
"""Number of candidates of a hidden parameter that is revealed to a stage's bench."""


def has_orders_to_schedule(scenario: Scenario) -> bool:
    """Return True if :class:`SchedulingManager` can play a scenario.

    Orders must arrive over time. Their products are made from vessels of unknown titre on one kind of bench after
    another: a reaction, then perhaps extractions.
    """
    first, *others = (bench.kind for bench in scenario.benches.values())
    known = first == "reaction" and {"reaction", "extraction"}.issuperset(others)
    return bool(scenario.demand.order) and known and _titre(scenario) is not None


def _titre(scenario: Scenario) -> Draw | None:
    """Return the draw of the titre of shelf vessels, or None."""
    draws = scenario.world.draws.values()
    return next((d for d in draws if d.what == "titre" and any(name.startswith("slot_") for name in d.of)), None)


@dataclass(frozen=True)
class _Order:
    """A known order: index, goal, remaining ticks, price, least amount (mol) and least purity."""

    number: int
    goal: str
    left: float
    price: float
    amount: float
    purity: float


@dataclass
class _Shop(Belief):
    """The manager's belief.

    Attributes:
        titre: by slot, the measured titre.
        stage: by slot, the number of stages that the vessel has completed.
        serves: by slot, the order for which the vessel was started.
        grades: by slot, the indices of the quality requirements of its runs.
        reported: by slot, amount (mol) and purity in the bench's report of its last run.
        rates: by stage, [L] the probability of each candidate of the parameter that is revealed to the stage's bench.
        seen: orders in the order of their arrival.
    """

    rates: list[FloatArray] = field(default_factory=list)
    titre: dict[int, float] = field(default_factory=dict)
    stage: dict[int, int] = field(default_factory=dict)
    serves: dict[int, int] = field(default_factory=dict)
    grades: dict[int, list[int]] = field(default_factory=dict)
    reported: dict[int, tuple[float, float]] = field(default_factory=dict)
    seen: list[int] = field(default_factory=list)


class SchedulingManager(BeliefManager[_Shop]):
    """Accepts the best paid orders that reagent and time allow, and ignores the others.

    The supply of reagents limits the number of orders. An order is accepted if its price is high enough among known
    orders and orders expected under the prior. It is made from the vessel with the highest probability of a sufficient
    yield, given its readings. A measurement is made if its value exceeds its price. Finished vessels fill the best paid
    orders first. A parameter that is revealed only to a bench is inferred from the bench's reports (Bayes), and
    determines the bench's quality requirement.

    Args:
        setting: the manager's laboratory; if not careful, it never measures. Its margin is that of the benches.
        script: function that makes the bench policies of the simulations, with a margin.
        schedule: False processes one order at a time, in the order of arrival, and drops only those past their time.
        remember: False infers nothing from reports.
    """

    def __init__(
        self, setting: Setting, schedule: bool = True, remember: bool = True, *, script: Callable[..., Policy]
    ) -> None:
        super().__init__(setting, ("gas_chromatograph",))
        scenario, channels, _, instruments, _, _, skip, margin_k = setting
        self._schedule, self._remember = schedule, remember
        self._high = {channel.name: channel.high for channel in channels}
        self._stages = list(scenario.benches)
        self._outcomes: dict[Any, tuple[FloatArray, FloatArray, FloatArray]] = {}  # cache of the current decision
        self._idle = bool(set(self._stages) & set(skip))
        self._agents = {key: [f"{key}_{i}" for i in range(scenario.benches[key].count)] for key in self._stages}
        # Ticks of every stage by quality requirement, the fastest first; without requirements, the step limits.
        ticks = {name: grade.ticks for name, grade in scenario.grades.items()} or {"": None}
        self._names = sorted(ticks, key=lambda name: ticks[name] or _MOST_TICKS)
        limits = {key: scenario.benches[key].step_limit for key in self._stages}
        self._grades = {key: [min(ticks[n] or most, most) for n in self._names] for key, most in limits.items()}
        self._ticks = sum(ticks[0] for ticks in self._grades.values())
        titre = _titre(scenario)
        assert titre is not None, "has_orders_to_schedule(scenario) holds"
        self._draw = titre
        self._titres = quantiles(titre, midpoints(_GRID))
        self._fresh = len(scenario.shelf.vessel)
        self._pure = _asks_for_purity(scenario)
        self._made = _foreseen(scenario, tuple(self._titres.tolist()), script, margin_k)
        prices = [draw for draw in scenario.world.draws.values() if draw.what == "price"]
        base = scenario.demand.order[0].price
        self._prices = base * quantiles(prices[0], midpoints(_GRID)) if prices else np.full(_GRID, base)
        name = self._instrument
        self._analytes = instruments.analytes[instruments.names.index(name)] if name else ()
        self._noise = scenario.instruments[name].noise if name else 0.0

    # -- observation ------------------------------------------------------------------------------------------

    def _value(self, observation: ObservationArray, name: str) -> float:
        return super()._value(observation, name) * self._high[name]

    def _known(self, observation: ObservationArray) -> list[_Order]:
        """Return the open orders."""
        orders = []
        for number, name in enumerate(self._orders):
            goal = observation[self._slices[name]]
            if goal.max() > 0.5:
                terms = [self._value(observation, channel) for channel in terms_channels(name)]
                orders.append(_Order(number, self._scenario.goals[int(goal.argmax())], *terms))
        return orders

    def _learn(self, belief: _Shop, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        materials, volumes = self._scenario.materials, []
        for name in (self._draw.material, self._draw.inert):
            material = materials[str(name)]
            litres = material.molar_mass_g_mol / material.density_kg_l
            volumes.append(float(reading[self._analytes.index(str(name))]) * litres)
        belief.titre[slot] = volumes[0] / max(sum(volumes), 1e-9)

    def _ended(self, belief: _Shop, agent: str, slot: int, observation: ObservationArray) -> None:
        stage, reports = belief.stage.get(slot, 0), [f"{agent}_reported_{what}" for what in REPORT[:2]]
        if reports[0] in self._slices:
            amount, purity = (self._value(observation, report) for report in reports)
            if self._remember and stage < len(self._stages):
                self._infer(belief, slot, stage, amount, purity)
            belief.reported[slot] = amount, purity
        belief.stage[slot] = stage + 1

    def _infer(self, shop: _Shop, slot: int, stage: int, amount: float, purity: float) -> None:
        """Update the probabilities of the parameter that is revealed to a stage's bench, from the bench's report."""
        key, grades = self._stages[stage], shop.grades.get(slot, [-1])
        report_noise = self._scenario.benches[key].report or 0.0
        amounts, purities = self._after(shop, slot, stage, grades[-2:])
        noise = np.hypot(_SPREAD * amounts, report_noise * self._high[f"{self._agents[key][0]}_reported_amount"])
        distance = ((amount - amounts) / noise) ** 2
        if self._pure:
            distance += ((purity - purities) / np.hypot(_SPREAD, report_noise)) ** 2
        likely = np.exp(-0.5 * distance) / noise
        weights = shop.rates[stage] * likely.mean(axis=0) + 1e-9
        shop.rates[stage] = weights / weights.sum()

    def _after(
        self, shop: _Shop, slot: int, stage: int, grades: Sequence[int], before: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return [..., L] mol and [..., L] purity after a stage, for each candidate of the parameter of its bench.

        Stage 0 begins with the measured titre, or with all candidates [T]; others with ``before`` [...] mol, or with
        the reported amount. ``grades`` are the quality requirements of the previous stage and of this one.
        """
        earlier = grades[0] if self._pure else 0
        if stage == 0:
            given, simulated = (np.array([shop.titre[slot]]) if slot in shop.titre else self._titres), self._titres
        else:
            given = np.array([shop.reported[slot][0]]) if before is None else before
            simulated = self._typical(stage - 1, earlier if self._pure else None)
        mol, purity = (
            np.stack([np.interp(given, simulated, row) for row in made], axis=-1)
            for made in self._made[:, stage, earlier, grades[-1]]
        )
        return mol, purity

    def _typical(self, stage: int, grade: int | None = None) -> FloatArray:
        """Return [T] mol after a stage from which the next one was simulated; None: of the best quality requirement."""
        made = self._made[0, stage, 0]
        return np.asarray(made[_best_grade(made) if grade is None else grade, made.shape[1] // 2])

    def _best(self, shop: _Shop, slot: int, order: _Order) -> tuple[float, int]:
        """Return the highest probability of meeting an order in time, and the best next quality requirement.

        Of requirements with about the same probability, the fastest is the best; without time for any, it is index 0.
        """
        steps = [self._grades[key] for key in self._stages[shop.stage.get(slot, 0) :]]
        best, chosen = (0, 0), (0.0, 0)
        for grades in itertools.product(range(len(self._names)), repeat=len(steps)):
            ticks = sum(durations[grade] for durations, grade in zip(steps, grades, strict=True))
            if ticks <= order.left:
                chance = self._chance(shop, slot, order, grades)
                if (round(20.0 * chance), -ticks) > best:
                    best, chosen = (round(20.0 * chance), -ticks), (chance, grades[0] if grades else 0)
        return chosen

    def _chance(self, shop: _Shop, slot: int, order: _Order, grades: Sequence[int]) -> float:
        """Return the probability of an order's amount and purity after the remaining stages with these requirements."""
        known = shop.reported.get(slot, shop.titre.get(slot))
        key = (slot in shop.reported, known, shop.stage.get(slot, 0), *shop.grades.get(slot, ()), None, *grades)
        if key not in self._outcomes:
            self._outcomes[key] = self._outcome(shop, slot, grades)
        amounts, purities, weights = self._outcomes[key]
        if order.purity > 0.0:
            weights = weights * ndtr((purities - order.purity) / _SPREAD)
        if known is None:
            return float(weights @ (amounts >= order.amount))
        spread = np.hypot(_SPREAD * amounts, self._noise * self._made[0, -1].max()) + 1e-9
        return float(weights @ ndtr((amounts - order.amount) / spread))

    def _outcome(self, shop: _Shop, slot: int, grades: Sequence[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return [K] mol and purities after the remaining stages, from the last report or the titre, and weights."""
        stage, done = min(shop.stage.get(slot, 0), len(self._stages)), shop.grades.get(slot, [])
        first = stage if slot in shop.reported else 0
        amounts, purities = (np.array([value]) for value in shop.reported.get(slot, (0.0, 1.0)))
        weights, runs = np.ones(1), [*([0] * stage + done)[len(done) :], *grades]
        for number in range(first, len(runs)):
            last_two = runs[max(number - 1, 0) : number + 1]
            amounts, purities = self._after(shop, slot, number, last_two, None if number == first else amounts)
            weights = np.multiply.outer(weights if number > first else np.ones(len(amounts)), shop.rates[number])
        return amounts.ravel(), purities.ravel(), (weights / weights.sum()).ravel()

    # -- decisions --------------------------------------------------------------------------------------------

    def _begin(self, observation: ObservationArray) -> _Shop:
        count = self._made.shape[4]
        return _Shop([], [], rates=[np.full(count, 1.0 / count) for _ in self._stages])

    def _pass_time(self, belief: _Shop, observation: ObservationArray) -> None:
        self._outcomes.clear()
        belief.orders = [order.number for order in self._known(observation)]
        belief.seen += [number for number in belief.orders if number not in belief.seen]

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        super()._replace_decision(observation, action, member)
        shop = self._kept[member]
        kind, slot, more = self._decode(action)
        if kind == "start" and more[0] in self._agents[self._stages[0]] and slot not in shop.serves:
            served = set(shop.serves.values())
            waiting = [order for order in self._known(observation) if order.number not in served]
            if waiting:
                shop.serves[slot] = max(waiting, key=lambda order: order.price).number

    def _started(self, belief: _Shop, agent: str, slot: int, more: list[Any]) -> None:
        grade = self._names.index(more[1]) if self._scenario.grades else 0
        belief.grades[slot] = [*belief.grades.get(slot, ()), grade]

    def _removed(self, belief: _Shop, slot: int) -> None:
        for memory in (belief.stage, belief.serves, belief.titre, belief.reported, belief.grades):
            memory.pop(slot, None)
        belief.stage[slot] = len(self._stages) + 1

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
            intended = [order for order in orders if order.number == shop.serves.get(slot)]
            for order in orders if self._schedule or not intended else intended:
                chance, _ = self._best(shop, slot, order)
                action = self._encode_submit(slot, order.number)
                if order.left > 0.0 and chance > 0.3 and chance * order.price > worth and mask[action]:
                    best, worth = action, chance * order.price
        return None if best is None else self._update(shop, best)

    def _go_on(self, shop: _Shop, orders: list[_Order], observation: ObservationArray, mask: MaskArray) -> int | None:
        """Send a vessel to the bench of its next stage."""
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
                    return self._update(shop, action)
        return None

    def _batches(self, observation: ObservationArray) -> int:
        """Return the number of runs for which there is reagent."""
        levels = observation[self._slices["stock"]] if "stock" in self._slices else np.ones(0)
        stock, runs = dict(zip(self._scenario.stock, levels.tolist(), strict=True)), [len(self._orders)]
        for key in self._stages:
            reagents: dict[str, float] = (self._scenario.benches[key].model_extra or {}).get("reagents", {})
            for name, mol in reagents.items():
                if name in stock:  # levels are rounded to the gauge's resolution
                    full = self._scenario.stock[name] / mol
                    runs.append(int((stock[name] + 0.5 * self._scenario.shelf.gauge) * full + 0.01))
        return min(runs)

    def _take(self, shop: _Shop, orders: list[_Order], observation: ObservationArray, mask: MaskArray) -> int | None:
        """Start a profitable order, or measure a vessel for it first if that is profitable."""
        batches = self._batches(observation)
        served = set(shop.serves.values())
        waiting = [order for order in orders if order.left >= self._ticks and order.number not in served]
        if batches < 1 or not waiting or all(agent in shop.running for agent in self._agents[self._stages[0]]):
            return None
        if self._schedule:
            # The remaining batches are for the best known and expected orders.
            expected = len(self._orders) - len(shop.seen)
            share = 1.0 - batches / (expected + 1)
            least = float(np.quantile(self._prices, share)) if share > 0.0 else 0.0
            waiting = sorted((o for o in waiting if o.price >= least), key=lambda o: -o.price)
        else:
            is_busy = bool(shop.running) or any(0 < stage <= len(self._stages) for stage in shop.stage.values())
            waiting = [] if is_busy else sorted(waiting, key=lambda o: shop.seen.index(o.number))[:1]
        used = {s for s, stage in shop.stage.items() if stage != 0} | set(shop.running.values())
        unused = [s for s in self._occupied(observation) if s not in used and s < self._fresh]
        for order in waiting:
            ranked = sorted(unused, key=lambda s: (-round(self._best(shop, s, order)[0], 1), shop.titre.get(s, 1.0)))
            if not ranked:
                return None
            chance, _ = self._best(shop, ranked[0], order)
            measure = self._measure_first(shop, unused, order, chance, mask)
            if measure is not None:
                return measure
            if chance >= _LIKELY or self._instrument is None or not mask[self._actions.table[:, 0] == MEASURE].any():
                action = self._start(shop, ranked[0], 0, order, mask)
                if action is not None:
                    shop.serves[ranked[0]] = order.number
                    return action
        return None

    def _measure_first(
        self, shop: _Shop, unused: list[int], order: _Order, chance: float, mask: MaskArray
    ) -> int | None:
        """Measure a vessel without a reading if the expected gain of finding a better one exceeds the price."""
        if self._instrument is None or chance >= _SURE:
            return None
        good = float((self._typical(-1) >= order.amount).mean())
        if (1.0 - chance) * good * order.price / len(self._orders) <= self._price:
            return None
        for slot in unused:
            if slot not in shop.titre and mask[self._measure(slot)]:
                return self._update(shop, self._measure(slot))
        return None


def _goal(scenario: Scenario, stage: int) -> str:
    """Return the goal of a stage; goals are listed in the order of production, and the last one is the product."""
    return scenario.goals[max(len(scenario.goals) - len(scenario.benches) + stage, 0)]


def _best_grade(made: FloatArray) -> int:
    """Return the quality requirement with the highest mean of a stage's yields [grades, L, T]."""
    return int(made.mean(axis=(1, 2)).argmax())


def _asks_for_purity(scenario: Scenario) -> bool:
    """Return True if an order may have a least purity."""
    drawn = any(draw.what == "purity_at_least" for draw in scenario.world.draws.values())
    return drawn or any(order.purity_at_least > 0.0 for order in scenario.demand.order)


@functools.lru_cache(maxsize=16)
def _foreseen(
    scenario: Scenario, titres: tuple[float, ...], script: Callable[..., Policy], margin_k: float | None
) -> FloatArray:
    """Simulate the stages of a vessel in the public scenario.

    Each stage is simulated for T titres and for L candidates of the parameter that is revealed to its bench. If orders
    have a least purity, the previous stage has each quality requirement, otherwise the best one. Earlier stages have
    the best one, and all other hidden parameters the median of their prior.

    Returns:
        [2, stages, previous grades, grades, L, T] mol and purity of each stage's goal.
    """
    titre, stages, by_purity = _titre(scenario), list(scenario.benches), _asks_for_purity(scenario)
    assert titre is not None, "has_orders_to_schedule(scenario) holds"
    slot = next(name for name in titre.of if name.startswith("slot_"))
    others = {
        name: draw
        for name, draw in scenario.world.draws.items()
        if draw.what not in (*VESSEL_QUANTITIES, *ORDER_QUANTITIES) and draw.variables == 1
    }
    medians = {name: float(quantiles(draw, np.array([0.5]))[0]) for name, draw in others.items()}
    draws = {"titre": titre.model_copy(update={"of": (slot,), "test": ()}), **others}
    world = scenario.world.model_copy(update={"draws": draws})
    public = scenario.model_copy(update={"world": world, "demand": DemandSpec()})
    revealed = [next((name for name, draw in others.items() if key in draw.told), None) for key in stages]
    count = _RATES if any(revealed) else 1
    grades: list[str | None] = [*scenario.grades] or [None]
    grades.sort(key=lambda name: (scenario.grades[name].ticks or _MOST_TICKS) if name else 0)
    labs, slot_index = Laboratories(public, count * len(titres)), int(slot[5:])
    policies = [None, *(script(bench, margin_k=margin_k) for bench in labs.benches)]
    earlier = range(len(grades)) if by_purity else range(1)
    out = np.zeros((2, len(stages), len(earlier), len(grades), count, len(titres)))

    def run(stage: int, grade: int) -> None:
        asked = [name for name in (grades[grade],) if name is not None]
        step = (f"{stages[stage]}_0", _goal(scenario, stage), *asked)
        run_experiment(labs, policies, step, labs.members, slot_index)

    for stage, name in enumerate(revealed):
        candidates = quantiles(others[name], midpoints(count)) if name else np.zeros(count)
        for member in labs.members:
            which, t = divmod(int(member), len(titres))
            values = medians | ({name: float(candidates[which])} if name else {})
            labs.reset(labs.members[member : member + 1], world={"titre": {slot: titres[t]}, **values})
        for before in range(stage - 1):
            run(before, _best_grade(out[0, before, 0]))
        ready = labs.snapshot()
        goal, rules = scenario.goals.index(_goal(scenario, stage)), labs.rules.arrays
        for b in earlier:
            labs.restore(ready)
            if stage:
                run(stage - 1, b if by_purity else _best_grade(out[0, stage - 1, 0]))
            begun = labs.snapshot()
            for g in range(len(grades)):
                labs.restore(begun)
                run(stage, g)
                amounts = labs.shelf.amounts[:, slot_index]
                made = amounts[:, rules.parts[goal, 0]]
                out[0, stage, b, g] = made.reshape(count, -1)
                out[1, stage, b, g] = (made / np.maximum(amounts @ rules.counts[goal], 1e-9)).reshape(count, -1)
    return out
