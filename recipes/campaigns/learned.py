"""A learned policy: a local search whose design and steps were found by the cross-entropy method on training worlds.

    python recipes/campaigns/learned.py --generations 20     # 3 minutes of one core; writes learned.json

Every other optimizer begins with an empty memory. This one has seen campaigns of other worlds (split ``train``), with
values without noise to which it adds noise of its own. It tries every catalyst under two conditions, and then varies
one of its best recipes. Needs nothing but chemlab.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.campaign import Campaign, Choice

_FILE = Path(__file__).with_name("learned.json")
_NUMBERS = ("percent", "equivalents", "temperature_k", "minutes")
_NOISE = 0.02
"""Standard deviation of the noise in training, about that of the laboratory."""
_POLICIES, _KEPT, _WORLDS, _SMOOTHING = 24, 5, 6, 0.3


class Policy:
    """Decides the next recipe from the results so far.

    Args:
        weights: [19] numbers: two first conditions (each four numbers from 0 to 1, as logits), widths of the four
            changes (as logarithms) and their decay, how far it repeats the last change that was better, how often it
            takes the best recipe of another catalyst, and the mean of the four changes.
        seed: seed of its choices.
    """

    size = 19

    def __init__(self, weights: Any, space: Any, seed: int) -> None:
        self._space, self._rng = space, np.random.default_rng(seed)
        self._first = 1.0 / (1.0 + np.exp(-np.reshape(weights[:8], (2, 4))))
        self._widths, self._decay = np.exp(weights[8:12]), float(np.exp(weights[12]))
        self._repeat, self._other = float(weights[13]), float(1.0 / (1.0 + np.exp(-weights[14])))
        self._drift = np.asarray(weights[15:19])
        self._catalysts = space["catalyst"].options
        self._tried: list[tuple[str, Any, float, Any]] = []

    def ask(self, number: int) -> dict[str, Any]:
        """Return the recipe of an experiment; results up to two before may be missing."""
        if number < 2 * len(self._catalysts):
            first = self._first[number // len(self._catalysts)]
            return self._recipe(self._catalysts[number % len(self._catalysts)], first)
        best = sorted(self._tried, key=lambda t: -t[2])
        leader = best[0]
        if self._rng.random() < self._other:
            leader = next(t for t in best if t[0] != leader[0])
        spread = self._widths * self._decay ** (number - 2 * len(self._catalysts))
        move = self._repeat * leader[3] + spread * (self._drift + self._rng.standard_normal(4))
        return self._recipe(leader[0], np.clip(leader[1] + move, 0.0, 1.0))

    def tell(self, recipe: dict[str, Any], value: float) -> None:
        """Note a result."""
        point = np.array(
            [(recipe[n] - self._space[n].low) / (self._space[n].high - self._space[n].low) for n in _NUMBERS]
        )
        before = max((t for t in self._tried if t[0] == recipe["catalyst"]), key=lambda t: t[2], default=None)
        change = point - before[1] if before is not None and value > before[2] else np.zeros(4)
        self._tried.append((recipe["catalyst"], point, value, change))

    def _recipe(self, catalyst: str, point: Any) -> dict[str, Any]:
        found: dict[str, Any] = {"catalyst": catalyst}
        for name, share in zip(_NUMBERS, point.tolist(), strict=True):
            allowed = self._space[name]
            value = allowed.low + share * (allowed.high - allowed.low)
            found[name] = round(value) if allowed.step else value
        return found


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    policy = Policy(np.array(json.loads(_FILE.read_text(encoding="utf-8"))["weights"]), campaign.space, seed)
    while campaign.left:
        first = len(campaign.results)
        recipes = [policy.ask(first + i) for i in range(min(batch, campaign.left))]
        for recipe, result in zip(recipes, campaign.run_batch(recipes), strict=True):
            policy.tell(recipe, result.value)


def played(weights: Any, campaign: Campaign, seed: int) -> Any:
    """Return [n] true values of the recipes that policies recommend in one world after all of its vessels.

    All of them play at the same time, with the same noise.
    """
    rng = np.random.default_rng(seed)
    policies = [Policy(w, campaign.space, seed) for w in weights]
    best, found = np.full(len(policies), -np.inf), np.zeros(len(policies))
    for first in range(0, campaign.left, 2):
        asked = [[policy.ask(first + i) for i in range(2)] for policy in policies]
        true = np.reshape(campaign.true_values([recipe for two in asked for recipe in two]), (-1, 2))
        noisy = true + _NOISE * rng.standard_normal(2)
        for i in range(2):
            for p, policy in enumerate(policies):
                policy.tell(asked[p][i], float(noisy[p, i]))
            found = np.where(noisy[:, i] > best, true[:, i], found)
            best = np.maximum(best, noisy[:, i])
    return found


def train(generations: int, worlds: int = _WORLDS, policies: int = _POLICIES) -> dict[str, Any]:
    """Return the weights that the cross-entropy method comes to, and the mean values on the way."""
    assert isinstance(Campaign().space["catalyst"], Choice), "it is a category"
    rng = np.random.default_rng(0)
    mean = np.concatenate([np.zeros(8), np.full(4, -2.0), [-0.05, 0.3, -1.5], np.zeros(4)])
    spread = np.concatenate([np.full(8, 1.0), np.full(4, 0.7), [0.05, 0.3, 1.0], np.full(4, 0.3)])
    course = []
    for generation in range(generations):
        weights = mean + spread * rng.standard_normal((policies, Policy.size))
        weights[0] = mean
        seeds = range(generation * worlds, (generation + 1) * worlds)
        values = np.mean([played(weights, Campaign(seed=seed), seed) for seed in seeds], axis=0)
        kept = weights[np.argsort(-values)[:_KEPT]]
        mean = _SMOOTHING * mean + (1.0 - _SMOOTHING) * kept.mean(axis=0)
        spread = _SMOOTHING * spread + (1.0 - _SMOOTHING) * kept.std(axis=0) + 0.02
        course.append(round(float(values.mean()), 4))
        print(generation, course[-1], round(float(values[0]), 4), flush=True)
    return {"generations": generations, "course": course, "weights": [round(float(x), 4) for x in mean]}


def main() -> None:
    """Train and write the weights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--generations", type=int, default=20)
    given = parser.parse_args()
    _FILE.write_text(json.dumps(train(given.generations)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
