"""Scripted manager of unlabelled vessels: measures while information exceeds its price, then processes the best one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from chemlab.config.draws import Draw, Permutation
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray
from chemlab.lab.sampling import quantiles
from chemlab.physics.chemistry import AMOUNTS
from chemlab.physics.shelf import Shelf
from chemlab.roles.instrument_table import InstrumentTable

from .belief import Belief, BeliefManager, noiseless
from .router import SynthesisManager
from .script import Setting, midpoints

_GRID = 24
"""Number of titre candidates."""
_MODEL_ERROR = 0.005
"""Standard deviation of readings in addition to their noise, because true titres lie between the candidates."""
_SURPRISE = 1e-12
"""Lower bound of a likelihood relative to the best one."""
_YIELD = 0.9
"""Assumed yield of the benches as a share of the vessel's content."""
_MOST_ORDERS = 20_000


def has_unlabelled_vessels(scenario: Scenario) -> bool:
    """Return True if the identity of shelf vessels is hidden."""
    return bool(_identities(scenario))


def _identities(scenario: Scenario) -> list[Draw]:
    """Return the draws of the identities of shelf vessels."""
    draws = scenario.world.draws.values()
    return [draw for draw in draws if draw.what == "identity" and any(name.startswith("slot_") for name in draw.of)]


def _arranged(options: Sequence[int], count: int) -> Iterator[tuple[int, ...]]:
    """Yield every distinct arrangement of ``count`` of the options, which may include equal ones."""
    if count == 0:
        yield ()
        return
    for option in dict.fromkeys(options):
        others = list(options)
        others.remove(option)
        yield from ((option, *rest) for rest in _arranged(others, count - 1))


@dataclass
class Contents(Belief):
    """The manager's belief about the V unlabelled vessels of one episode.

    Attributes:
        likelihood: [V, O, T] likelihood of the readings of each vessel, by option and titre.
        chosen: chosen slots by order; empty before the decision.
    """

    likelihood: FloatArray = field(default_factory=lambda: np.zeros(0))
    chosen: list[int] = field(default_factory=list)


class IdentifyingManager(BeliefManager[Contents]):
    """Identifies the vessel that an order needs among unlabelled ones, then plays as :class:`.router.SynthesisManager`.

    The prior is the scenario's declaration of each vessel's possible contents; it is updated with each reading (Bayes).
    The vessel with the highest value of information is measured as long as this value, the expected gain of choosing
    after the reading instead of now, exceeds the price.

    Args:
        setting: the manager's laboratory; if not careful, it never measures.
    """

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting, ("uv_vis", "gas_chromatograph"), _MODEL_ERROR)
        self._router = SynthesisManager(setting)
        self._memories += self._router._memories
        scenario = setting.scenario
        (identity, *_) = _identities(scenario)
        self._vessels = [int(name[5:]) for name in identity.of if name.startswith("slot_")]
        self._options = list(dict.fromkeys(str(option) for option in getattr(identity.distribution, "options", ())))
        titres = [
            draw
            for draw in scenario.world.draws.values()
            if draw.what == "titre" and draw.material == identity.material and set(identity.of) <= set(draw.of)
        ]
        self._titre = titres[0] if titres else None
        self._titres = quantiles(self._titre, midpoints(_GRID)) if self._titre is not None else np.ones(1)
        self._arrangements, self._prior = self._possible(identity)
        self._expected = self._readings(identity) if self._instrument else np.zeros(0)

    def _possible(self, identity: Draw) -> tuple[IntArray, FloatArray]:
        """Return [P, V] all arrangements of the options in the vessels, and the probability of each."""
        distribution, count = identity.distribution, len(self._vessels)
        options = [self._options.index(str(option)) for option in getattr(distribution, "options", ())]
        is_permutation = isinstance(distribution, Permutation)
        choices = itertools.product(range(len(self._options)), repeat=count)
        every = _arranged(options, count) if is_permutation else choices
        arrangements = np.array(list(itertools.islice(every, _MOST_ORDERS)), dtype=np.int64)
        if is_permutation:
            return arrangements, np.ones(len(arrangements))
        weights = np.bincount(options, getattr(distribution, "weights", ()) or None)
        return arrangements, np.asarray(weights[arrangements].prod(axis=1), dtype=np.float64)

    def _readings(self, identity: Draw) -> FloatArray:
        """Return [V, O, T, size] noise-free readings of each vessel for each option and titre."""
        spec, count = self._scenario, len(self._options) * len(self._titres)
        known = noiseless(spec)
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
        return np.array(parts).reshape(len(self._vessels), len(self._options), len(self._titres), -1)

    def _begin(self, observation: ObservationArray) -> Contents:
        likelihood = np.ones((len(self._vessels), len(self._options), len(self._titres)))
        return Contents(self._vessels, list(range(len(self._orders))), likelihood=likelihood)

    def _replace_decision(self, observation: ObservationArray, action: int, member: int) -> None:
        belief = self._kept[member]
        kind, slot, _ = self._decode(action)
        if not belief.chosen:
            if kind == "measure" and slot in self._vessels:
                self._update(belief, action)
            if kind != "start":
                return
            belief.chosen.append(slot)
            self._choose(belief, observation, member)
        self._router._replace_decision(observation, action, member)

    def _decide(self, observation: ObservationArray, mask: MaskArray, step: int, member: int) -> int:
        belief = self._kept[member]
        if not belief.chosen:
            measured = self._next_look(belief, self._ordered(observation)[0], mask)
            if measured is not None:
                return self._update(belief, self._measure(self._vessels[measured]))
            self._choose(belief, observation, member)
        return self._router._decide(observation, mask, step, member)

    def _ordered(self, observation: ObservationArray) -> FloatArray:
        """Return [orders, O, T] the raw score of a vessel for each order, by content."""
        return np.array([self._worth(self._goal(observation, order)) for order in range(len(self._orders))])

    def _choose(self, belief: Contents, observation: ObservationArray, member: int) -> None:
        """Choose a vessel for every order without one, and begin the router's lines with them."""
        for scores in self._ordered(observation)[len(belief.chosen) :]:
            expected = (self._posterior(belief) * scores).sum(axis=(1, 2))
            free = [v for v, slot in enumerate(self._vessels) if slot not in belief.chosen]
            best = max(free or range(len(self._vessels)), key=lambda v: expected[v])
            belief.chosen.append(self._vessels[best])
        lines = self._router._kept[member] = self._router._begin(observation)
        for line, slot in zip(lines, belief.chosen, strict=True):
            line.slot = slot

    def _worth(self, goal: str) -> FloatArray:
        """Return [O, T] the raw score of a vessel for a goal, by content."""
        most = self._scenario.theoretical_maximum_mol[goal]
        stocked = set(self._scenario.stock)
        made = np.zeros(len(self._options))
        for step in self._scenario.family.reaction:
            for o, option in enumerate(self._options):
                if goal in step.products and option in step.reactants and set(step.reactants) <= {option} | stocked:
                    made[o] = step.products[goal] / step.reactants[option]
        made += [1.0 * (option == goal) for option in self._options]
        return np.asarray(_YIELD * made[:, None] * self._titres / most)

    def _learn(self, belief: Contents, slot: int, reading: FloatArray, observation: ObservationArray) -> None:
        v = self._vessels.index(slot)
        # script.likelihood sums in another order, and the last digit decides between identical vessels.
        distance = ((reading - self._expected[v]) ** 2).sum(axis=-1) / self._noise**2
        belief.likelihood[v] = np.exp(-0.5 * (distance - distance.min())) + _SURPRISE

    def _posterior(self, belief: Contents) -> FloatArray:
        """Return [V, O, T] posterior probability of each vessel's content."""
        evidence = belief.likelihood.mean(axis=2)
        vessels = np.arange(len(self._vessels))
        weights = self._prior * evidence[vessels, self._arrangements].prod(axis=1)
        weights /= weights.sum()
        held = np.zeros(evidence.shape)
        for o in range(len(self._options)):
            held[:, o] = weights @ (self._arrangements == o)
        titre = belief.likelihood / belief.likelihood.sum(axis=2, keepdims=True)
        return np.asarray(held[:, :, None] * titre)

    def _next_look(self, belief: Contents, worth: FloatArray, mask: MaskArray) -> int | None:
        """Return the vessel whose measurement has the highest value net of its price; None if no value is positive."""
        if self._instrument is None:
            return None
        posterior = self._posterior(belief)
        now = float((posterior * worth).sum(axis=(1, 2)).max())
        best, gain = None, 0.0
        for v, slot in enumerate(self._vessels):
            if slot in belief.read or not mask[self._measure(slot)]:
                continue
            net = float((posterior[v] * np.maximum(worth, now)).sum()) - now - self._price
            if net > gain:
                best, gain = v, net
        return best
