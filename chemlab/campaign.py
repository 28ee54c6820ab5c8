"""Campaigns for optimizers: run recipes in a laboratory and receive their measured results and costs.

A scenario in ``scenarios/campaigns`` has many equal vessels, reaction benches and one chromatograph. The optimizer
proposes recipes. Each :meth:`Campaign.run` starts a vessel at a bench, controls the bench by the recipe, and measures
the vessel. All of this consists of ordinary actions in one laboratory, with its costs, limits and noise.

>>> campaign = Campaign(seed=1)
>>> result = campaign.run(catalyst="catalyst_a", percent=1.5, equivalents=1.3, temperature_k=378.0, minutes=20)
>>> 0.0 <= result.purity <= 1.0
True
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from .agents.scripted.screening import catalysts
from .config.loading import load_scenario
from .config.scenario import Scenario
from .kernels.rng import checked_seed
from .lab.engine import Laboratories
from .roles.manager_state import RUNNING
from .roles.reaction_bench import ReactionBench

_TRACE = 1e-9
_LEAST = 0.2
"""Lower bounds of ``percent`` and ``equivalents`` as a share of the upper bounds.

The publication's range of the catalyst is 0.5 to 2.5 % (reactions.toml).
"""


@dataclass(frozen=True)
class Range:
    """Range of a numeric parameter; ``step`` is 1 for integers, else 0."""

    low: float
    high: float
    step: int = 0


@dataclass(frozen=True)
class Choice:
    """Options of a categorical parameter."""

    options: tuple[str, ...]


@dataclass(frozen=True)
class Result:
    """Outcome of one experiment.

    Attributes:
        recipe: the parameters.
        slot: slot of the vessel.
        amount_mol: amount of the product in mol, measured with noise.
        purity: purity of the product, measured with noise.
        reagents: price of the reagents used, in units of the score.
        measuring: price of the measurement, in units of the score.
        ticks: duration in ticks.
        value: objective to maximize, in units of the score: amount x purity / theoretical maximum, minus the price of
            the reagents times the number of orders.
    """

    recipe: Mapping[str, float | str]
    slot: int
    amount_mol: float
    purity: float
    reagents: float
    measuring: float
    ticks: int
    value: float


class Campaign:
    """Optimization of a recipe in one hidden world; every experiment uses up a vessel.

    Args:
        scenario: name or path of a campaign scenario, or a loaded scenario of the same form.
        seed: seed of the hidden world and of the noise.
        split: split from which the world is drawn.

    Raises:
        ValueError: the scenario does not have the form of a campaign.
    """

    def __init__(self, scenario: str | Scenario = "optimize_coupling", seed: int = 0, split: str = "train") -> None:
        spec = load_scenario(scenario)
        kinds = {bench.kind for bench in spec.benches.values()}
        names = catalysts(spec)
        others = [name for name in spec.stock if name not in names]
        if kinds != {"reaction"} or len(names) < 2 or len(others) != 1 or len(spec.instruments) != 1:
            raise ValueError(
                f"scenario: {spec.name} must have reaction benches only, one instrument, one reagent and at least two "
                "catalysts in its stock; see scenarios/campaigns/optimize_coupling.toml"
            )
        self.scenario = spec
        self._labs = Laboratories(spec, 1, split=split)
        self._labs.begin(checked_seed(seed) or 0)
        (self._goal, *_), (self._instrument,), (self._reagent,) = spec.lab_goals, spec.instruments, others
        bench = self._labs.benches[0]
        assert isinstance(bench, ReactionBench), "checked above"
        self._bench, options = bench, bench.options
        self._limiting = spec.theoretical_maximum_mol[self._goal]
        most = {name: options.reagents[name] / self._limiting for name in spec.stock}
        percent = 100.0 * min(most[name] for name in names)
        self.space: dict[str, Range | Choice] = {
            "catalyst": Choice(tuple(names)),
            "percent": Range(round(_LEAST * percent, 9), percent),
            "equivalents": Range(round(_LEAST * most[self._reagent], 9), most[self._reagent]),
            "temperature_k": Range(options.temperature_k.low, options.temperature_k.high),
            "minutes": Range(1.0, float(bench.spec.step_limit), 1),
        }
        """Parameters of a recipe by name, with bounds or options."""
        self.results: list[Result] = []
        self._fresh = list(range(len(spec.shelf.vessel)))
        self._finished = False

    @property
    def left(self) -> int:
        """Number of unused vessels; 0 after the end of the campaign."""
        return len(self._fresh) if self._running else 0

    @property
    def _running(self) -> bool:
        return not self._finished and bool(self._labs.state.status[0] == RUNNING)

    @property
    def score(self) -> float:
        """Raw score of the episode so far; only submitted batches count (see :meth:`finish`)."""
        return float(self._labs.result(self._labs.members)[0])

    def run(self, **recipe: float | str) -> Result:
        """Run one recipe; see :attr:`space` for its parameters.

        Raises:
            ValueError: a parameter is missing, unknown or out of bounds, or no vessel is left; the campaign is
                unchanged.
        """
        return self.run_batch([recipe])[0]

    def run_batch(self, recipes: Iterable[Mapping[str, float | str]]) -> list[Result]:
        """Run several recipes, as many at once as there are benches.

        Raises:
            ValueError: as for :meth:`run`.
        """
        given = list(recipes)
        checked = [self._checked(recipe, f"recipe {i}: " if len(given) > 1 else "") for i, recipe in enumerate(given)]
        if len(checked) > self.left:
            raise ValueError(f"campaign: {self.left} vessels are left, given {len(checked)} recipes; finish() ends it")
        results: list[Result] = []
        benches = self._labs.bench_agents
        for first in range(0, len(checked), len(benches)):
            results += self._run_parallel(dict(zip(benches, checked[first:], strict=False)))
        self.results += results
        return results

    def finish(self) -> float:
        """Submit the batches of highest value, one for each order, and return the raw score of the episode.

        This ends the campaign: no further recipe can be run. A second call only returns the score.
        """
        best = sorted(self.results, key=lambda result: -result.value)
        for order, result in zip(range(self.scenario.orders), best, strict=False):
            if self._running:
                self._manage("submit", result.slot, *([order] if self.scenario.orders > 1 else []))
        self._finished = True
        return self.score

    def true_value(self, **recipe: float | str) -> float:
        """Return a recipe's value without noise, from a copy of the world; for the evaluation of optimizers only."""
        return float(self.true_values([recipe])[0])

    def true_values(self, recipes: Sequence[Mapping[str, float | str]]) -> Any:
        """Return [n] values without noise; see :meth:`true_value`."""
        if not recipes:
            return np.zeros(0)
        labs = Laboratories(self.scenario, len(recipes))
        labs.reset(labs.members, world=self._labs.worlds.values(0))
        return self.values_in(labs, recipes)

    def values_in(self, laboratories: Laboratories, recipes: Sequence[Mapping[str, float | str]], slot: int = 0) -> Any:
        """Return the values [n] of one recipe in each of n laboratories, without noise; for training optimizers.

        Args:
            laboratories: laboratories of this scenario, each with its own world. The first bench has to be idle; it
                runs the recipes.
            recipes: one recipe for each laboratory.
            slot: slot of the vessel that is used.

        Raises:
            ValueError: a parameter is missing, unknown or out of bounds, or the number of recipes differs from the
                number of laboratories; the laboratories are unchanged.
        """
        labs, checked = laboratories, [self._checked(recipe, "") for recipe in recipes]
        if len(checked) != len(labs.members):
            raise ValueError(f"recipes: give one for each of {len(labs.members)} laboratories; given {len(checked)}")
        before = labs.shelf.stock.copy()
        for action in (("start", labs.bench_agents[0], slot, self._goal), ("wait",)):
            labs.act(labs.manager.index, labs.members, np.full(len(checked), labs.actions.encode(*action)))
        for turn in range(self._bench.spec.step_limit):
            labs.act(
                labs.bench_roles[0].index, labs.members, np.stack([self._control(recipe, turn) for recipe in checked])
            )
        amounts, rules = labs.shelf.amounts[:, slot], labs.rules.arrays
        goal = self.scenario.goals.index(self._goal)
        made, counted = amounts[:, rules.parts[goal, 0]], amounts @ rules.counts[goal]
        spent = (before - labs.shelf.stock) @ rules.stock_price
        return made * made / np.maximum(counted, _TRACE) / self._limiting - self.scenario.orders * spent

    def _checked(self, recipe: Mapping[str, float | str], where: str) -> dict[str, Any]:
        if not isinstance(recipe, Mapping) or set(recipe) != set(self.space):
            given = ", ".join(map(str, recipe)) or "none" if isinstance(recipe, Mapping) else repr(recipe)
            raise ValueError(f"{where}takes the parameters {', '.join(self.space)}; given {given}")
        for name, allowed in self.space.items():
            value = recipe[name]
            if isinstance(allowed, Choice):
                if not isinstance(value, str) or value not in allowed.options:
                    raise ValueError(f"{where}{name}: choose from {', '.join(allowed.options)}; given {value!r}")
            elif (
                not isinstance(value, Real)
                or isinstance(value, bool)
                or not allowed.low - _TRACE <= value <= allowed.high + _TRACE
            ):
                raise ValueError(f"{where}{name}: from {allowed.low:g} to {allowed.high:g}; given {value!r}")
            elif allowed.step and value != round(value):
                raise ValueError(f"{where}{name}: a whole number; given {value!r}")
        return dict(recipe)

    def _control(self, recipe: Mapping[str, Any], turn: int) -> Any:
        """Return the bench's action: add reagents and heat in the first turn, cool after the recipe's minutes."""
        span, names = self._bench.options.temperature_k, self._bench.reagent_names
        shares = np.zeros(len(names))
        if turn == 0:
            amounts = {
                recipe["catalyst"]: recipe["percent"] / 100.0 * self._limiting,
                self._reagent: recipe["equivalents"] * self._limiting,
            }
            for name, mol in amounts.items():
                shares[names.index(name)] = min(mol / self._bench.options.reagents[name], 1.0)
        change = {0: recipe["temperature_k"] - self.scenario.ambient_temperature_k, recipe["minutes"]: -span.step}
        heating = min(max(0.5 + change.get(turn, 0.0) / (2.0 * span.step), 0.0), 1.0)
        return np.array([heating, 0.5, *shares])

    def _manage(self, kind: str, *arguments: str | int) -> None:
        labs = self._labs
        labs.act(labs.manager.index, labs.members, np.array([labs.actions.encode(kind, *arguments)]))

    def _run_parallel(self, recipes: Mapping[str, dict[str, Any]]) -> list[Result]:
        """Run one recipe on each of some benches at the same time, and measure the vessels."""
        labs, state = self._labs, self._labs.state
        slots = {agent: self._fresh.pop(0) for agent in recipes}
        price, used = labs.rules.arrays.stock_price, dict.fromkeys(recipes, 0.0)
        begin = int(state.ticks[0])
        for agent, slot in slots.items():
            self._manage("start", agent, slot, self._goal)
        self._manage("wait")
        while (turn := labs.turn()) != labs.manager.index and self._running:
            agent, before = labs.agents[turn], labs.shelf.stock[0].copy()
            labs.act(turn, labs.members, self._control(recipes[agent], int(labs.roles[turn].turns_had[0]))[None])
            used[agent] += float((before - labs.shelf.stock[0]) @ price)
        ticks, cost = int(state.ticks[0]) - begin, self.scenario.instruments[self._instrument].price
        results = []
        for agent, slot in slots.items():
            self._manage("measure", slot, self._instrument)
            amount, purity = self._read(slot)
            value = amount * purity / self._limiting - self.scenario.orders * used[agent]
            results.append(Result(recipes[agent], slot, amount, purity, used[agent], cost, ticks, value))
        return results

    def _read(self, slot: int) -> tuple[float, float]:
        """Return amount in mol and purity from a vessel's chromatogram; the solvent is the internal standard."""
        labs, spec = self._labs, self.scenario
        (names,) = labs.instruments.analytes  # of the only instrument
        shares = dict(zip(names, labs.state.reading[0, slot, : len(names)].tolist(), strict=True))
        counted = spec.specifications[self._goal].purity_among or names
        solvents = {name: mol for name, mol in spec.shelf.vessel[slot].contents.items() if name not in counted}
        standard = sum(solvents.values()) / max(sum(shares[name] for name in solvents), _TRACE)
        return shares[self._goal] * standard, shares[self._goal] / max(sum(shares[n] for n in counted), _TRACE)
