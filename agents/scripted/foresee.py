"""Scripted manager that plans by simulating recipes in worlds drawn from the prior, weighted by its readings.

A *recipe* is a sequence of experiments of the scripted benches on one vessel. Before an episode, every candidate recipe
is simulated in laboratories of the public scenario with worlds drawn from the prior. For each experiment, the expected
reading and the value of a submission are stored. In an episode, the probability of each world is kept for every vessel
and updated with every reading (Bayes). The manager continues with the best recipe, and measures when the expected gain
of the information exceeds the price.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.draws import VESSEL_QUANTITIES
from chemlab.config.scenario import Scenario
from chemlab.envs.players import Policy
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Bench, channel_slices

from .belief import Belief, BeliefManager, Step, first_reading, first_worth, noiseless, run_experiment
from .script import Setting, cheapest, likelihood

_COMMON, _OWN, _OWN_OF_COMMON = 12, 512, 32
"""Numbers of simulated draws: of shared parameters; of a vessel's own parameters; the same for each shared draw."""
_MOST_RUNS = 12
"""Maximum number of experiments of a reaction bench on one vessel."""
_INSTRUMENTS = ("gas_chromatograph", "hplc", "uv_vis")
_MODEL_ERROR = 0.006
"""Standard deviation of readings in addition to their noise, because true worlds differ from the simulated ones."""
_SURPRISE = 1e-9
"""Lower bound of a likelihood relative to the best one."""
_UNWORKED = -1.0
"""Value of a vessel that cannot be submitted because it was at no bench: below that of any experiment."""
_SEED = 7_000_000
"""Seed of the simulated worlds."""


def foresees(scenario: Scenario) -> bool:
    """Return True if :class:`ForeseeingManager` can play a scenario.

    The shelf's vessels must be declared alike, and hidden parameters of vessels must apply to all of them.
    """
    draws = scenario.world.draws.values()
    slots = [f"slot_{i}" for i in range(len(scenario.shelf.vessel))]
    alike = all(vessel == scenario.shelf.vessel[0] for vessel in scenario.shelf.vessel)
    everywhere = all(
        set(slots) <= set(draw.of) or draw.shared == "episode"
        for draw in draws
        if draw.what in VESSEL_QUANTITIES and any(name in slots for name in draw.of)
    )
    return scenario.physics == "real" and bool(draws) and alike and everywhere


@dataclass(frozen=True)
class _Foresight:
    """Simulated outcomes of a vessel: S draws of shared parameters, O draws of a vessel's own, K stages of recipes.

    Attributes:
        stages: experiments of a vessel at each stage; stage 0 has none.
        after: by stage, the stages reachable from it, itself first.
        readings: [S * O, K, R] noise-free readings of the instrument.
        fills: [S * O] initial fill levels.
        worth: [S * O, K] values of a submission in raw score.
        costs: [S * O, K] cumulative costs.
    """

    stages: list[tuple[Step, ...]]
    after: list[IntArray]
    readings: FloatArray
    fills: FloatArray
    worth: FloatArray
    costs: FloatArray

    @functools.cached_property
    def remaining(self) -> list[FloatArray]:
        """By stage, [S * O, reachable stages] the value of a submission at a reachable stage less the costs to it."""
        gains = self.worth - self.costs
        return [gains[:, to] + self.costs[:, stage, None] for stage, to in enumerate(self.after)]


@dataclass
class _Vessels(Belief):
    """The manager's belief about V vessels; it fills the first order next.

    Attributes:
        likelihood: [V, S, O] likelihood of all readings of each vessel.
        filled: [V, S, O] likelihood of the initial fill levels.
        stage: [V] stage of each vessel.
        gone: indices of vessels that are submitted, or at a stage that was not simulated.
    """

    likelihood: FloatArray = field(default_factory=lambda: np.zeros(0))
    filled: FloatArray = field(default_factory=lambda: np.zeros(0))
    stage: list[int] = field(default_factory=list)
    gone: set[int] = field(default_factory=set)


class ForeseeingManager(BeliefManager[_Vessels]):
    """Processes the vessel with the highest expected value, and measures if the value of information exceeds the price.

    It measures a vessel once after each experiment, because a later reading is more informative than a repeated one.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
        script: makes the bench policies of the simulations.
        remember: False uses only the latest reading of each remaining vessel.
    """

    def __init__(self, setting: Setting, remember: bool = True, *, script: Callable[[Bench], Policy]) -> None:
        super().__init__(setting, _INSTRUMENTS, _MODEL_ERROR)
        scenario = setting.scenario
        self._remember = remember
        chosen = cheapest(scenario, _INSTRUMENTS)
        # A budget below the price of one measurement is equivalent to no instrument.
        self._instrument = self._instrument if self._price <= scenario.limits.budget else None
        skip = tuple(sorted(setting.skip))
        self._foresight = {
            goal: _foreseen(_public(scenario), goal, chosen, skip, script) for goal in scenario.lab_goals
        }
        self._shape = _sizes(scenario)
        self._fill_noise = float(np.hypot(scenario.shelf.gauge / np.sqrt(12.0), _MODEL_ERROR))
        self._errors = self._errors_of(next(iter(self._foresight.values())).readings.shape[2])

    # -- deciding ---------------------------------------------------------------------------------------------

    def _observe(self, observation: ObservationArray, step: int, member: int) -> None:
        super()._observe(observation, step, member)
        belief = self._kept[member]
        if not belief.running and belief.gone and len(belief.gone) == len(belief.slots):
            # The episode continues after the last submission only if another policy has acted for the manager.
            self._kept[member] = self._begin(observation)

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._kept[member]
        slot = self._decode(action)[1]
        if slot in belief.slots and belief.slots.index(slot) not in belief.gone:
            self._update(belief, action)

    def _started(self, belief: _Vessels, agent: str, slot: int, more: list[Any]) -> None:
        v, stages = belief.slots.index(slot), next(iter(self._foresight.values())).stages
        wanted = (*stages[belief.stage[v]], (agent, more[0]))
        belief.running = {agent: slot}
        if wanted in stages:
            belief.stage[v] = stages.index(wanted)
        else:
            belief.gone.add(v)  # the resulting stage was not simulated

    def _removed(self, belief: _Vessels, slot: int) -> None:
        belief.gone.add(belief.slots.index(slot))

    def _submitted(self, belief: _Vessels, order: int) -> None:
        belief.orders = belief.orders[1:]
        if not self._remember:
            belief.likelihood[list(belief.gone)] = 1.0

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        belief = self._kept[member]
        wait = self._actions.encode("wait")
        if belief.running or not belief.slots:
            return wait
        goal = self._next_goal(observation, belief)
        promises = self._promises(belief, goal)
        measured = self._next_look(belief, goal, promises, mask)
        if measured is not None:
            return self._update(belief, self._measure(belief.slots[measured]))
        v = int(np.argmax(promises.max(axis=1)))
        stage = int(promises[v].argmax())
        if stage != belief.stage[v]:
            return self._go_on(observation, mask, belief, v, goal, stage)
        return self._submit_for(mask, belief, belief.slots[v], self._next_order(belief))

    def _begin(self, observation: ObservationArray) -> _Vessels:
        slots = self._occupied(observation)
        fills = next(iter(self._foresight.values())).fills[:, None]
        likely = np.ones((len(slots), *self._shape))
        for v, slot in enumerate(slots):
            fill = np.array([self._value(observation, f"slot_{slot}_fill")])
            likely[v] = likelihood(fill, fills, self._fill_noise, _SURPRISE).reshape(self._shape)
        orders = list(range(len(self._orders)))
        return _Vessels(slots, orders, likelihood=likely, filled=likely.copy(), stage=[0] * len(slots))

    def _next_order(self, belief: _Vessels) -> int:
        return belief.orders[0] if belief.orders else len(self._orders) - 1

    def _next_goal(self, observation: ObservationArray, belief: _Vessels) -> str:
        return self._goal(observation, self._next_order(belief))

    def _go_on(
        self, observation: ObservationArray, mask: MaskArray, belief: _Vessels, v: int, goal: str, stage: int
    ) -> int:
        """Return the next experiment on the way to a stage, or an action that frees a slot for the returned vessels."""
        done, wanted = (self._foresight[goal].stages[k] for k in (belief.stage[v], stage))
        step = wanted[len(done)]
        start = self._actions.encode("start", step[0], belief.slots[v], step[1])
        if not mask[start]:
            for slot in self._occupied(observation):
                discard = self._actions.encode("discard", slot)
                if slot not in belief.slots and mask[discard]:
                    return discard
            return self._submit_for(mask, belief, belief.slots[v], self._next_order(belief))
        belief.stage[v] = self._foresight[goal].stages.index(wanted[: len(done) + 1])
        belief.running = {step[0]: belief.slots[v]}
        belief.read.discard(belief.slots[v])
        return start

    # -- belief -----------------------------------------------------------------------------------------------

    def _likely(self, readings: FloatArray, goal: str, stage: int) -> FloatArray:
        """Return [..., S * O] likelihoods of readings [..., R] of a vessel at a stage."""
        return likelihood(readings, self._foresight[goal].readings[:, stage], self._noise, _SURPRISE)

    def _learn(self, belief: _Vessels, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        v = belief.slots.index(slot)
        likely = self._likely(reading, self._next_goal(observation, belief), belief.stage[v])
        if not self._remember:
            belief.likelihood[v] = belief.filled[v]
        belief.likelihood[v] *= likely.reshape(self._shape)
        belief.likelihood[v] = np.maximum(belief.likelihood[v] / belief.likelihood[v].max(), _SURPRISE)

    def _posterior(self, likely: FloatArray) -> FloatArray:
        """Return [V, S * O] posterior probabilities of every world for each vessel, from likelihoods [V, S, O].

        Evidence about shared parameters from one vessel also applies to the others.
        """
        shared = likely.mean(axis=-1)
        others = np.exp(np.log(shared).sum(axis=-2, keepdims=True) - np.log(shared))
        weights = likely * others[..., None]
        weights = weights.reshape(*weights.shape[:-2], math.prod(weights.shape[-2:]))
        return np.asarray(weights / weights.sum(axis=-1, keepdims=True))

    def _promises(self, belief: _Vessels, goal: str) -> FloatArray:
        """Return [V, K] expected value of each vessel at each stage, less the remaining costs.

        Stages that cannot be reached and submitted vessels have -inf.
        """
        known = self._posterior(belief.likelihood)
        rows = [self._promise(known[v], goal, stage) for v, stage in enumerate(belief.stage)]
        for v in belief.gone:
            rows[v][:] = -np.inf
        return np.stack(rows)

    def _promise(self, known: FloatArray, goal: str, stage: int) -> FloatArray:
        """Return [..., K] expected values of one vessel, from the probabilities [..., S * O] of its worlds."""
        foresight = self._foresight[goal]
        to = foresight.after[stage]
        out = np.full((*known.shape[:-1], len(foresight.stages)), -np.inf)
        out[..., to] = known @ foresight.remaining[stage]
        return out

    def _total(self, bests: FloatArray, orders: int) -> FloatArray:
        """Return [...] total value of the best vessels for all open orders, from each vessel's value [..., V]."""
        best = np.sort(np.maximum(bests, 0.0), axis=-1)
        return np.asarray(best[..., -orders:].sum(axis=-1))

    def _next_look(self, belief: _Vessels, goal: str, promises: FloatArray, mask: MaskArray) -> int | None:
        """Return the vessel whose measurement has the highest value net of its price; None if no value is positive."""
        if self._instrument is None:
            return None
        orders = max(len(belief.orders), 1)
        bests, posterior = promises.max(axis=-1), self._posterior(belief.likelihood)
        now = float(self._total(bests, orders))
        best, highest = None, self._price
        evaluated = set[tuple[int, ...]]()
        for v, slot in enumerate(belief.slots):
            if v in belief.gone or slot in belief.read or not mask[self._measure(slot)]:
                continue
            # Of vessels with the same stage and posterior, one is evaluated.
            key = belief.stage[v], *(posterior[v] * 1e6).astype(np.int64).tolist()
            if key in evaluated:
                continue
            evaluated.add(key)
            gain = float(self._total(self._after_look(belief, goal, v, posterior[v], bests), orders).mean()) - now
            if gain > highest:
                best, highest = v, gain
        return best

    def _after_look(self, belief: _Vessels, goal: str, v: int, known: FloatArray, bests: FloatArray) -> FloatArray:
        """Return [samples, V] expected values of the vessels after another measurement of one of them."""
        readings = self._foresight[goal].readings[self._sampled(known), belief.stage[v]] + self._errors
        likely = self._likely(readings, goal, belief.stage[v])
        after = np.repeat(bests[None], len(readings), axis=0)
        if self._shape[0] > 1:
            shared = (likely * belief.likelihood[v].ravel()).reshape(-1, *self._shape).mean(axis=-1)
            self._reweight_others(belief, goal, v, shared, after)
        posterior = known * likely
        posterior /= posterior.sum(axis=1, keepdims=True)
        after[:, v] = self._promise(posterior, goal, belief.stage[v]).max(axis=-1)
        return after

    def _reweight_others(self, belief: _Vessels, goal: str, v: int, shared: FloatArray, after: FloatArray) -> None:
        """Write the other vessels' expected values into ``after`` [B, V] after B readings of vessel ``v``.

        ``shared`` [B, S] has the likelihoods of the shared parameters. The other vessels' values given these parameters
        stay the same and are only reweighted.
        """
        logs = np.log(belief.likelihood.mean(axis=-1))
        foresight = self._foresight[goal]
        for w, stage in enumerate(belief.stage):
            if w == v or w in belief.gone:
                continue
            weights = shared * np.exp(logs.sum(axis=0) - logs[v] - logs[w])
            here = belief.likelihood[w]
            worth = (here[:, None] @ foresight.remaining[stage].reshape(*self._shape, -1))[:, 0]
            after[:, w] = ((weights @ worth) / (weights @ here.sum(axis=-1))[:, None]).max(axis=-1)


# -- simulation -------------------------------------------------------------------------------------------------------


def _sizes(scenario: Scenario) -> tuple[int, int]:
    """Return (S, O): numbers of simulated draws of shared parameters and of a vessel's own parameters."""
    own = any(_is_own(scenario, name) for name in scenario.world.draws)
    common = any(not _is_own(scenario, name) for name in scenario.world.draws)
    return (_COMMON if common else 1), (_OWN_OF_COMMON if common else _OWN) if own else 1


def _is_own(scenario: Scenario, name: str) -> bool:
    """Return True if every vessel of the shelf has its own value of a draw."""
    draw = scenario.world.draws[name]
    return draw.what in VESSEL_QUANTITIES and draw.variables > 1 and any(of.startswith("slot_") for of in draw.of)


def _public(scenario: Scenario) -> Scenario:
    """Return the scenario for simulations: without noise, and with a budget for every measurement."""
    limits = scenario.limits.model_copy(update={"budget": 1e6})
    return noiseless(scenario).model_copy(update={"limits": limits})


def _stages(steps: Sequence[tuple[Step, int]]) -> Iterator[tuple[Step, ...]]:
    """Yield every sequence of steps in their order, each up to its maximum number of times; shorter sequences first."""
    sequences: list[tuple[tuple[Step, ...], int, int]] = [((), 0, 0)]
    while sequences:
        longer = []
        for stage, last, times in sequences:
            yield stage
            for i, (step, most) in enumerate(steps[last:], last):
                if i > last and stage and step[0] == stage[-1][0] and most == 1:
                    continue  # a bench that is used once is used for one goal only
                if i == last and times == most:
                    continue
                longer.append(((*stage, step), i, times + 1 if i == last else 1))
        sequences = longer


def _steps(labs: Laboratories, goal: str, skip: Collection[str]) -> list[tuple[Step, int]]:
    """Return the candidate experiments in the order of the benches, each with its maximum number of repetitions."""
    steps: list[tuple[Step, int]] = []
    for bench in labs.benches:
        if bench.key in skip or any(agent == f"{bench.key}_0" for (agent, _), _ in steps):
            continue
        runs = labs.scenario.limits.ticks // (bench.step_limit * labs.scenario.orders)
        most = max(min(_MOST_RUNS, runs), 1) if bench.kind == "reaction" else 1
        for wanted in [goal] if bench.kind == "extraction" else labs.scenario.goals:
            steps.append(((f"{bench.key}_0", wanted), most))
    return steps


@functools.lru_cache(maxsize=16)
def _foreseen(
    scenario: Scenario, goal: str, instrument: str | None, skip: tuple[str, ...], script: Callable[[Bench], Policy]
) -> _Foresight:
    """Simulate every recipe in worlds drawn from the prior."""
    common, own = _sizes(scenario)
    labs = Laboratories(scenario, common * own)
    members = labs.members
    _draw(labs, goal, own)
    policies: list[Policy | None] = [None, *(script(bench) for bench in labs.benches)]
    slices = channel_slices(labs.channels)
    fills = labs.observe(labs.manager.index, members)[:, slices["slot_0_fill"]][:, 0].astype(np.float64)
    for slot in range(1, len(scenario.shelf.vessel)):
        labs.act(labs.manager.index, members, np.full(len(members), labs.actions.encode("discard", slot)))
    initial_costs = labs.charges(members).sum(axis=1)
    snapshots: dict[tuple[Step, ...], list[npt.NDArray[Any]]] = {(): labs.snapshot()}
    stages = list(_stages(_steps(labs, goal, skip)))
    after = [
        np.array([k for k, other in enumerate(stages) if other[: len(stage)] == stage], dtype=np.int64)
        for stage in stages
    ]
    readings, worth, costs, goal_index = [], [], [], scenario.goals.index(goal)
    for stage, reachable in zip(stages, after, strict=True):
        if stage:
            labs.restore(snapshots[stage[:-1]])
            _make_room(labs, stage[-1], members)
            run_experiment(labs, policies, stage[-1], members)
            if len(reachable) > 1:
                snapshots[stage] = labs.snapshot()
        worth.append(first_worth(labs, goal_index) if stage or not scenario.hides else np.full(len(members), _UNWORKED))
        costs.append(labs.charges(members).sum(axis=1) - initial_costs)
        readings.append(first_reading(labs, instrument))
    return _Foresight(stages, after, np.stack(readings, 1), fills, np.stack(worth, 1), np.stack(costs, 1))


def _draw(labs: Laboratories, goal: str, own: int) -> None:
    """Assign worlds of the prior to the laboratories.

    Laboratory s * O + o has draw s of the S draws of shared parameters and draw o of the O draws of a vessel's own.
    """
    members = labs.members.tolist()
    labs.begin(_SEED, goal)
    drawn = [labs.worlds.values(member) for member in members]
    labs.episodes.again[:] = True  # the same episodes in other worlds
    for member in members:
        world = {
            name: drawn[member % own if _is_own(labs.scenario, name) else member // own][name]
            for name in labs.scenario.world.draws
        }
        labs.reset(labs.members[member : member + 1], goal, world)


def _make_room(labs: Laboratories, step: Step, members: IntArray) -> None:
    """Discard returned vessels other than the first slot's if they block the next experiment."""
    start = labs.actions.encode("start", step[0], 0, step[1])
    for slot in reversed(range(1, labs.actions.slots)):
        mask, discard = labs.mask(labs.manager.index, members), labs.actions.encode("discard", slot)
        assert mask is not None, "the manager has discrete actions"
        some = members[(mask[:, start] == 0) & (mask[:, discard] != 0)]
        if len(some):
            labs.act(labs.manager.index, some, np.full(len(some), discard))
