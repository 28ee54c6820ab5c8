"""Scripted manager of vessels without a label: measures until another look would not pay, then works on the best."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from chemlab.config.draws import Draw, Permutation, quantiles
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.physics.chemistry import AMOUNTS
from chemlab.physics.shelf import Shelf
from chemlab.roles.instruments.table import InstrumentTable

from .manager import ManagerHeuristic
from .script import Setting, cheapest

__all__ = ["IdentifyingManager", "has_unlabelled_vessels"]

_GRID = 24
"""Titres that are told apart."""
_MODEL_ERROR = 0.005
"""Standard deviation of readings besides their noise: titres lie between those of the grid."""
_SURPRISE = 1e-12
"""Likelihood that is left to what a reading speaks against."""
_YIELD = 0.9
"""Of what stands in the vessel, what the benches make of it."""
_MOST_ORDERS = 20_000


def has_unlabelled_vessels(scenario: Scenario) -> bool:
    """Whether it is left to find out what vessels of the shelf hold."""
    return bool(_identities(scenario))


def _identities(scenario: Scenario) -> list[Draw]:
    draws = scenario.world.draws.values()
    return [draw for draw in draws if draw.what == "identity" and any(name.startswith("slot_") for name in draw.of)]


def _arranged(options: Sequence[int], count: int) -> Iterator[tuple[int, ...]]:
    """Every different way to put ``count`` of some options, of which several may be alike, in order."""
    if count == 0:
        yield ()
        return
    for option in dict.fromkeys(options):
        left = list(options)
        left.remove(option)
        yield from ((option, *rest) for rest in _arranged(left, count - 1))


@dataclass
class _Belief:
    """What a manager knows of an episode's vessels.

    Attributes:
        likelihood: [V, O, T] of what has been read of each vessel, by option and titre.
        looked: vessels that have been measured.
        asked: the vessel that is being measured, or None.
        chosen: slots to work on, by order, once it has been decided.
    """

    likelihood: FloatArray
    looked: set[int] = field(default_factory=set)
    asked: int | None = None
    chosen: list[int] = field(default_factory=list)


class IdentifyingManager(ManagerHeuristic):
    """Looks for what an order needs among vessels that look alike, then does what the scripted manager does with it.

    It keeps the probability of everything that each vessel may hold, as the scenario's world declares it (the prior),
    and brings it up to date with each reading (Bayes). It measures the vessel of which a look would be worth most, as
    long as that is more than its price: the expected gain of choosing after it over choosing now.

    Args:
        setting: what it is told; not careful, it never measures.
    """

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting)
        scenario, careful = setting.scenario, setting.careful
        (identity, *_) = _identities(scenario)
        self._vessels = [int(name[5:]) for name in identity.of if name.startswith("slot_")]
        self._options = list(dict.fromkeys(str(option) for option in getattr(identity.distribution, "options", ())))
        titres = [
            draw
            for draw in scenario.world.draws.values()
            if draw.what == "titre" and draw.material == identity.material and set(identity.of) <= set(draw.of)
        ]
        self._titre = titres[0] if titres else None
        # The middle of each part of the prior: all as likely.
        shares = (np.arange(_GRID) + 0.5) / _GRID
        self._titres = quantiles(self._titre, shares) if self._titre is not None else np.ones(1)
        self._arrangements, self._prior = self._possible(identity)
        self._instrument = cheapest(scenario, ("uv_vis", "gas_chromatograph")) if careful else None
        self._expected = self._readings(identity) if self._instrument else np.zeros(0)
        self._beliefs: dict[int, _Belief] = {}
        self._memories.append(self._beliefs)

    def _possible(self, identity: Draw) -> tuple[IntArray, FloatArray]:
        """[P, V] every way in which the options may stand in the vessels, and how likely each is."""
        drawn, count = identity.distribution, len(self._vessels)
        options = [self._options.index(str(option)) for option in getattr(drawn, "options", ())]
        if isinstance(drawn, Permutation):
            found = _arranged(options, count)
        else:
            found = itertools.product(range(len(self._options)), repeat=count)
        arrangements = np.array(list(itertools.islice(found, _MOST_ORDERS)), dtype=np.int64)
        if isinstance(drawn, Permutation):
            return arrangements, np.ones(len(arrangements))
        weights = np.bincount(options, getattr(drawn, "weights", ()) or None)
        return arrangements, np.asarray(weights[arrangements].prod(axis=1), dtype=np.float64)

    def _readings(self, identity: Draw) -> FloatArray:
        """[V, O, T, size] what the instrument shows of each vessel for each option and titre, without noise."""
        spec, count = self._scenario, len(self._options) * len(self._titres)
        exact = {name: one.model_copy(update={"noise": 0.0}) for name, one in spec.instruments.items()}
        known = spec.model_copy(update={"instruments": exact})
        shelf = Shelf.empty(known, count, 1)
        table = InstrumentTable(known, shelf.chemistry)
        number = table.names.index(str(self._instrument))
        volume = shelf.chemistry.world().molar_volume
        parts = []
        for slot in self._vessels:
            vessel = spec.shelf.vessel[slot]
            label = shelf.layout.index(str(identity.material))
            litres = vessel.contents[str(identity.material)] * volume[label]
            for n, (option, titre) in enumerate(itertools.product(self._options, self._titres)):
                row = shelf.fill(n, 0, vessel.capacity_l, dict(vessel.contents)).row
                row[AMOUNTS + label] = 0.0
                held = shelf.layout.index(option)
                row[AMOUNTS + held] += titre * litres / volume[held]
                if self._titre is not None:
                    inert = shelf.layout.index(str(self._titre.inert))
                    row[AMOUNTS + inert] += (1.0 - titre) * litres / volume[inert]
            readings = np.zeros((count, 1, int(table.start[-1])))
            members, zeros = np.arange(count), np.zeros(count, dtype=np.int64)
            table.read(shelf, readings, np.zeros((count, 1), dtype=np.uint64), members, zeros, zeros + number)
            parts.append(readings[:, 0, table.start[number] : table.start[number + 1]])
        shape = (len(self._vessels), len(self._options), len(self._titres), -1)
        return np.array(parts).reshape(shape)

    # -- deciding ---------------------------------------------------------------------------------------------

    def _see(self, observation: ObservationArray, step: int, member: int) -> None:
        if step == 0:
            shape = (len(self._vessels), len(self._options), len(self._titres))
            self._beliefs[member] = _Belief(np.ones(shape))
        if self._beliefs[member].asked is not None:
            self._learn(self._beliefs[member], observation)

    def _take_note(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._beliefs[member]
        kind, slot, more = self._taken_apart(action)
        if not belief.chosen:
            if kind == "measure" and slot in self._vessels and more[0] == self._instrument:
                belief.asked = self._vessels.index(slot)
            if kind != "start":
                return
            belief.chosen.append(slot)
            self._choose(belief, observation, member)
        super()._take_note(observation, action, member)

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        belief = self._beliefs[member]
        if belief.chosen:
            return super()._decide(observation, mask, step, member)
        worth = self._ordered(observation)
        look = self._next_look(belief, worth[0], mask)
        if look is not None:
            belief.asked = look
            return self._actions.encode("measure", self._vessels[look], str(self._instrument))
        self._choose(belief, observation, member)
        return super()._decide(observation, mask, 1, member)

    def _ordered(self, observation: ObservationArray) -> FloatArray:
        """[orders, O, T] score of a vessel for each order, by what is in it."""
        goals = [self._scenario.goals[int(observation[self._slices[name]].argmax())] for name in self._orders]
        return np.array([self._worth(goal) for goal in goals])

    def _choose(self, belief: _Belief, observation: ObservationArray, member: int) -> None:
        """Choose a vessel for every order that has none yet, and begin with them."""
        for own in self._ordered(observation)[len(belief.chosen) :]:
            expected = (self._posterior(belief) * own).sum(axis=(1, 2))
            free = [v for v, slot in enumerate(self._vessels) if slot not in belief.chosen]
            best = max(free or range(len(self._vessels)), key=lambda v: expected[v])
            belief.chosen.append(self._vessels[best])
        self._kept[member] = self._begin(observation)
        for line, slot in zip(self._kept[member], belief.chosen, strict=True):
            line.slot = slot

    def _worth(self, goal: str) -> FloatArray:
        """[O, T] score of a vessel for a goal, by what is in it."""
        most = self._scenario.theoretical_maximum_mol[goal]
        stocked = set(self._scenario.stock)
        made = np.zeros(len(self._options))
        for step in self._scenario.family.reaction:
            for o, option in enumerate(self._options):
                if goal in step.products and option in step.reactants and set(step.reactants) <= {option} | stocked:
                    made[o] = step.products[goal] / step.reactants[option]
        made += [1.0 * (option == goal) for option in self._options]
        return np.asarray(_YIELD * made[:, None] * self._titres / most)

    def _learn(self, belief: _Belief, observation: ObservationArray) -> None:
        """Take in the reading that has been asked for."""
        v, belief.asked = belief.asked, None
        assert v is not None, "something has been asked for"
        belief.looked.add(v)
        name = f"slot_{self._vessels[v]}_{self._instrument}"
        noise = np.hypot(self._scenario.instruments[str(self._instrument)].noise, _MODEL_ERROR)
        # Not `base.likelihood`, which sums in another order: among bottles that look alike a last digit decides.
        apart = ((observation[self._slices[name]] - self._expected[v]) ** 2).sum(axis=-1) / noise**2
        belief.likelihood[v] = np.exp(-0.5 * (apart - apart.min())) + _SURPRISE

    def _posterior(self, belief: _Belief) -> FloatArray:
        """[V, O, T] probability of what each vessel may hold."""
        evidence = belief.likelihood.mean(axis=2)
        vessels = np.arange(len(self._vessels))
        weights = self._prior * evidence[vessels, self._arrangements].prod(axis=1)
        weights /= weights.sum()
        held = np.zeros(evidence.shape)
        for o in range(len(self._options)):
            held[:, o] = weights @ (self._arrangements == o)
        titre = belief.likelihood / belief.likelihood.sum(axis=2, keepdims=True)
        return np.asarray(held[:, :, None] * titre)

    def _next_look(self, belief: _Belief, worth: FloatArray, mask: MaskArray) -> int | None:
        """The vessel that it pays most to measure, None where it pays for none."""
        if self._instrument is None:
            return None
        posterior = self._posterior(belief)
        now = float((posterior * worth).sum(axis=(1, 2)).max())
        price = self._scenario.instruments[self._instrument].price
        best, gain = None, 0.0
        for v, slot in enumerate(self._vessels):
            legal = mask[self._actions.encode("measure", slot, self._instrument)]
            if v in belief.looked or not legal:
                continue
            own = float((posterior[v] * np.maximum(worth, now)).sum()) - now - price
            if own > gain:
                best, gain = v, own
        return best
