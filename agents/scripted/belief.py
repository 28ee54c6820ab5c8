"""Beliefs of scripted managers about vessels, benches and orders, and simulations of the public scenario.

:class:`BeliefManager` updates a belief with readings, ended experiments and actions. Each kind of scenario has a
subclass, which interprets readings and decides.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from chemlab.config.scenario import Scenario
from chemlab.envs.players import Players, Policy
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories

from .script import ScriptedManager, Setting, cheapest, midpoints

_SAMPLES = 32
"""Readings sampled to estimate the value of one measurement."""


@dataclass
class Belief:
    """Knowledge of a manager in one episode.

    Attributes:
        slots: slots of vessels.
        orders: open orders.
        asked: slot of the vessel that is being measured, or None.
        running: by bench agent, the slot of its vessel.
        read: slots of vessels that were measured after their last experiment.
    """

    slots: list[int]
    orders: list[int]
    asked: int | None = None
    running: dict[str, int] = field(default_factory=dict)
    read: set[int] = field(default_factory=set)


B = TypeVar("B", bound=Belief)


class BeliefManager(ScriptedManager[B]):
    """Base class of managers that decide from a belief, which is updated with observations and actions.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
        kinds: kinds of instruments; the cheapest instrument of these kinds is used.
        model_error: standard deviation of readings in addition to the instrument's noise.
    """

    def __init__(self, setting: Setting, kinds: Collection[str], model_error: float = 0.0) -> None:
        super().__init__(setting)
        self._instrument = cheapest(setting.scenario, kinds) if setting.careful else None
        spec = setting.scenario.instruments.get(str(self._instrument))
        self._price = spec.price if spec is not None else 0.0
        self._noise = float(np.hypot(spec.noise, model_error)) if spec is not None else 1.0

    def _errors_of(self, size: int) -> FloatArray:
        """Return [_SAMPLES, size] sampled errors of readings, which are the same for every decision."""
        return np.random.default_rng(0).normal(0.0, self._noise, (_SAMPLES, size))

    def _sampled(self, weights: FloatArray) -> Any:
        """Return [_SAMPLES] indices of worlds, evenly sampled from probabilities ``weights`` [K]."""
        return np.searchsorted(np.cumsum(weights), midpoints(_SAMPLES)).clip(0, len(weights) - 1)

    def _measure(self, slot: int) -> int:
        """Return the action that measures a slot's vessel with the manager's instrument."""
        return self._actions.encode("measure", slot, str(self._instrument))

    def _begin(self, observation: ObservationArray) -> B:
        """Return the belief at the start of an episode."""
        raise NotImplementedError

    def _pass_time(self, belief: B, observation: ObservationArray) -> None:
        """Update the belief with time and orders of an observation, before readings and ended experiments."""

    def _learn(self, belief: B, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        """Update the belief with the reading [R] of a vessel."""
        raise NotImplementedError

    def _ended(self, belief: B, agent: str, slot: int, observation: ObservationArray) -> None:
        """Update the belief after the end of an experiment."""

    def _started(self, belief: B, agent: str, slot: int, more: list[Any]) -> None:
        """Update the belief after the start of an experiment with a goal and perhaps a quality requirement."""

    def _measured(self, belief: B, slot: int) -> None:
        """Update the belief after a measurement has been requested."""

    def _removed(self, belief: B, slot: int) -> None:
        """Update the belief after a vessel has been submitted or discarded."""

    def _submitted(self, belief: B, order: int) -> None:
        """Update the belief after a vessel has been submitted for an order."""
        belief.orders = [other for other in belief.orders if other != order]

    def _observe(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            self._kept[member] = self._begin(observation)
        belief = self._kept[member]
        self._pass_time(belief, observation)
        if belief.asked is not None:
            slot, belief.asked = belief.asked, None
            reading = observation[self._slices[f"slot_{slot}_{self._instrument}"]].astype(np.float64)
            self._learn(belief, slot, reading, observation)
        for agent, slot in list(belief.running.items()):
            if self._value(observation, f"{agent}_busy") < 0.5:
                del belief.running[agent]
                self._ended(belief, agent, slot, observation)

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        self._update(self._kept[member], action)

    def _update(self, belief: B, action: int) -> int:
        """Update the belief with an action; return the action."""
        kind, slot, more = self._decode(action)
        if kind == "start":
            agent, *terms = more
            belief.running[agent] = slot
            belief.read.discard(slot)
            self._started(belief, agent, slot, terms)
        elif kind == "measure" and more[0] == self._instrument:
            belief.asked = slot
            belief.read.add(slot)
            self._measured(belief, slot)
        elif kind in ("submit", "discard"):
            self._removed(belief, slot)
            if kind == "submit":
                self._submitted(belief, more[0])
        return action

    def _submit_for(self, mask: MaskArray, belief: B, slot: int, order: int) -> int:
        """Submit a vessel for an order; the first legal action if that is illegal."""
        submit = self._update(belief, self._encode_submit(slot, order))
        return submit if mask[submit] else int(mask.argmax())

    def _goal(self, observation: ObservationArray, order: int) -> str:
        """Return the goal of an order."""
        return self._scenario.goals[int(observation[self._slices[self._orders[order]]].argmax())]


# -- simulation -------------------------------------------------------------------------------------------------------

Step = tuple[str, ...]
"""An experiment: the bench's agent, the goal, and its quality requirement if the scenario has any."""


def run_experiment(
    laboratories: Laboratories, policies: Sequence[Policy | None], step: Step, members: IntArray, slot: int = 0
) -> None:
    """Run one experiment on a slot of every laboratory, up to the manager's next turn.

    Args:
        laboratories: the laboratories.
        policies: policies of all agents in order; None for the manager.
        step: the experiment.
        members: [B] environment indices in which the experiment may be started.
        slot: the vessel's slot.
    """
    actions = laboratories.actions
    for action in (actions.encode("start", step[0], slot, *step[1:]), actions.encode("wait")):
        laboratories.act(laboratories.manager.index, members, np.full(len(members), action))
    Players(laboratories, policies).play_on(members)


def noiseless(scenario: Scenario, **others: float) -> Scenario:
    """Return the scenario with instruments without noise, and with other fields of all instruments as given."""
    exact = {name: spec.model_copy(update={"noise": 0.0, **others}) for name, spec in scenario.instruments.items()}
    return scenario.model_copy(update={"instruments": exact})


def first_worth(labs: Laboratories, goal: int) -> FloatArray:
    """Return [N] the raw score that the first slot's vessel would add if submitted for one of the orders."""
    rules, amounts = labs.rules.arrays, labs.shelf.amounts[:, 0]
    made = amounts[:, rules.parts[goal, 0]]
    purity = made / np.maximum(amounts @ rules.counts[goal], 1e-12)
    met = (purity >= rules.least_purity[goal]) & (made >= rules.least_amount[goal])
    return np.asarray(met * made * purity / rules.maximum[goal] / labs.scenario.orders)


def first_reading(labs: Laboratories, instrument: str | None) -> FloatArray:
    """Return [N, R] the instrument's reading of the first slot's vessel; zeros [N, 1] without an instrument."""
    if instrument is None:
        return np.zeros((len(labs.members), 1))
    table, members = labs.instruments, labs.members
    number, zeros = table.names.index(instrument), np.zeros(len(members), dtype=np.int64)
    table.read(labs.shelf, labs.state.reading, labs.state.stream, members, zeros, zeros + number)
    start, stop = table.start[number : number + 2]
    return np.array(labs.state.reading[:, 0, start:stop])
