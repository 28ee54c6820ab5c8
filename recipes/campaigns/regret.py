"""Regret of optimizers on a campaign, in 20 hidden worlds.

    python recipes/campaigns/regret.py --out recipes/campaigns/results.json --figure docs/images/regret.png

Every optimizer has the same hidden worlds (split ``test``) and all 24 vessels of each, two at a time. After every
experiment, the recipe with the best measured value so far is recommended. Its regret is its distance from the oracle,
1 - (value - random) / (oracle - random): values without noise; the oracle is the best recipe that a search with the
hidden parameters finds, random the mean of recipes drawn uniformly. ``--figure`` draws the curves. With the committed
``results.json`` as ``--out``, the tables of ``docs/chemist/campaign.md`` are written, too.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from random_search import drawn
from scipy import stats

from chemlab.campaign import Campaign, Choice
from chemlab.config.display import markdown_table
from chemlab.config.files import replace_between

PAGE = Path(__file__).resolve().parents[2] / "docs" / "chemist" / "campaign.md"
STORED = Path(__file__).resolve().with_name("results.json")

OPTIMIZERS = ("random_search", "scripted", "scipy_evolution", "optuna_tpe", "baybe_gp", "ax_client", "learned", "ppo")
_TRAINED = ("learned", "ppo")
_ROUNDS, _DRAWN, _KEPT = 7, 200, 20


def oracle(campaign: Campaign) -> tuple[float, float]:
    """Return the best value that an evolutionary search finds, and the mean value of random recipes."""
    rng = np.random.default_rng(0)
    recipes = [drawn(campaign, rng) for _ in range(_DRAWN)]
    values = campaign.true_values(recipes)
    random = float(values.mean())
    for step in range(_ROUNDS):
        best = [recipes[i] for i in np.argsort(-values)[:_KEPT]]
        recipes, values = _near(campaign, best, 0.15 * 0.6**step, rng), values[np.argsort(-values)[:_KEPT]]
        values = np.concatenate([values, campaign.true_values(recipes)])
        recipes = [*best, *recipes]
    return float(values.max()), random


def _near(campaign: Campaign, best: list[Any], width: float, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return changed copies of some recipes; a share of them has another catalyst."""
    found = []
    for recipe in best * (_DRAWN // _KEPT):
        other: dict[str, Any] = {}
        for name, allowed in campaign.space.items():
            if isinstance(allowed, Choice):
                other[name] = str(rng.choice(allowed.options)) if rng.random() < 0.2 else recipe[name]
                continue
            value = recipe[name] + width * (allowed.high - allowed.low) * rng.standard_normal()
            other[name] = min(max(round(value) if allowed.step else value, allowed.low), allowed.high)
        found.append(other)
    return found


def regrets(optimizer: str, seed: int, ends: tuple[float, float]) -> tuple[list[float], float]:
    """Return the regret after every experiment of one optimizer in one world, and the raw score of the episode."""
    campaign = Campaign(seed=seed, split="test")
    importlib.import_module(optimizer).optimize(campaign, seed)
    true = campaign.true_values([result.recipe for result in campaign.results])
    measured = [result.value for result in campaign.results]
    best, random = ends
    found = [1.0 - (true[int(np.argmax(measured[: n + 1]))] - random) / (best - random) for n in range(len(true))]
    return [round(float(value), 4) for value in found], round(campaign.finish(), 4)


def fixed(ends: list[Any]) -> dict[str, list[float]]:
    """Return regrets in every world of fixed recipes, the best of many by their mean value in as many training worlds.

    ``no measurement``: one recipe. ``catalyst measured``: the same conditions with the best catalyst of the world. By
    name of an optimizer: the 24 recipes that it chose in another world, the best by its value without noise.
    """
    rng, space = np.random.default_rng(1), Campaign().space["catalyst"]
    assert isinstance(space, Choice), "it is a category"
    conditions = [drawn(Campaign(), rng) for _ in range(_DRAWN)]
    recipes = [{**recipe, "catalyst": name} for recipe in conditions for name in space.options]
    seen = [Campaign(seed=seed).true_values(recipes).reshape(_DRAWN, -1) for seed in range(len(ends))]
    one, any_of = int(np.mean(seen, axis=(0, 2)).argmax()), int(np.max(seen, axis=2).mean(axis=0).argmax())
    found: dict[str, list[float]] = {"no measurement": [], "catalyst measured": []}
    for seed, (best, random) in enumerate(ends):
        campaign = Campaign(seed=seed, split="test")
        for name, which, chosen in (("no measurement", one, np.mean), ("catalyst measured", any_of, np.max)):
            values = campaign.true_values([{**conditions[which], "catalyst": c} for c in space.options])
            found[name].append(round(float(1.0 - (chosen(values) - random) / (best - random)), 4))
    for name in _TRAINED:
        campaigns = [Campaign(seed=seed, split="test") for seed in range(len(ends))]
        for seed, campaign in enumerate(campaigns):
            importlib.import_module(name).optimize(campaign, seed)
        found[name] = []
        for seed, (best, random) in enumerate(ends):
            values = campaigns[seed].true_values([r.recipe for r in campaigns[seed - 1].results])
            found[name].append(round(float(1.0 - (values.max() - random) / (best - random)), 4))
    return found


def fixed_table(found: dict[str, Any]) -> list[str]:
    """Return the regrets of fixed recipes, and of the best optimizer, as a Markdown table."""
    ends = {name: np.array(curves)[:, -1] for name, curves in found["regret"].items()}
    best = min(ends, key=lambda name: ends[name].mean())
    named = {
        "the best fixed recipe": found["fixed"]["no measurement"],
        "the best fixed conditions, with the best catalyst of each world": found["fixed"]["catalyst measured"],
        **{f"the 24 recipes that `{name}` chose in another world": found["fixed"][name] for name in _TRAINED},
        f"`{best}`, 24 measured experiments": ends[best],
    }
    rows = [(name, "{:.2f} ({:.2f} to {:.2f})".format(*interval(x))) for name, x in named.items()]
    return markdown_table({"recipes": False, "regret": True}, rows)


def interval(values: Any) -> tuple[float, float, float]:
    """Return mean and 95 % confidence interval (Student's t)."""
    values = np.asarray(values)
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean()), float(values.mean() - half), float(values.mean() + half)


def table(found: dict[str, Any]) -> list[str]:
    """Return the results as a Markdown table."""
    numbers = ("worlds", "regret after 8", "after 16", "after 24", "better than random search by", "raw score")
    rows = []
    random = np.array(found["regret"]["random_search"])[:, -1]
    for name, curves in found["regret"].items():
        curve = np.array(curves)
        cells = [f"`{name}`", str(len(curve))]
        cells += ["{:.2f} ({:.2f} to {:.2f})".format(*interval(curve[:, n - 1])) for n in (8, 16, 24)]
        gain = "{:+.2f} ({:+.2f} to {:+.2f})".format(*interval(random[: len(curve)] - curve[:, -1]))
        cells.append("" if name == "random_search" else gain)
        cells.append("{:.2f} ({:.2f} to {:.2f})".format(*interval(found["score"][name])))
        rows.append(cells)
    return markdown_table({"optimizer": False, **dict.fromkeys(numbers, True)}, rows)


def figure(found: dict[str, Any], path: Path) -> None:
    """Draw mean regrets with their intervals."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(figsize=(7.0, 4.2))
    for i, (name, curves) in enumerate(found["regret"].items()):
        curve = np.array(curves)
        mean, low, high = np.array([interval(column) for column in curve.T]).T
        n = np.arange(1, curve.shape[1] + 1)
        axes.plot(n, mean, ("-", "--", "-.", ":")[i % 4], label=name)  # not everyone tells the colours apart
        axes.fill_between(n, low, high, alpha=0.15)
    axes.set(xlabel="experiments", ylabel="regret (0: oracle, 1: random recipe)", ylim=(0.0, 1.0))
    axes.legend(frameon=False)
    fig.tight_layout()
    fig.savefig(path, dpi=90)


def main() -> None:
    """Run the study, or draw a stored one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, help="number of worlds")
    parser.add_argument("--only", nargs="*", default=OPTIMIZERS, choices=OPTIMIZERS, help="optimizers to run")
    parser.add_argument("--out", type=Path, help="JSON file; only worlds that it lacks are run")
    parser.add_argument("--fixed", action="store_true", help="judge fixed recipes as well")
    parser.add_argument("--figure", type=Path, help="draw the file of --out")
    given = parser.parse_args()
    warnings.filterwarnings("ignore")
    found: dict[str, Any] = {"ends": [], "regret": {}, "score": {}}
    if given.out is not None and given.out.is_file():
        found = json.loads(given.out.read_text(encoding="utf-8"))
    if len(found["ends"]) < given.seeds:
        seeds = range(len(found["ends"]), given.seeds)
        found["ends"] += [oracle(Campaign(seed=seed, split="test")) for seed in seeds]
    for name in given.only:
        curves, scores = found["regret"].setdefault(name, []), found["score"].setdefault(name, [])
        for seed in range(len(curves), given.seeds):
            print(name, seed, file=sys.stderr, flush=True)
            curve, score = regrets(name, seed, tuple(found["ends"][seed]))
            curves.append(curve)
            scores.append(score)
            if given.out is not None:
                given.out.write_text(json.dumps(found) + "\n", encoding="utf-8")
    if given.fixed:
        found["fixed"] = fixed(found["ends"])
        if given.out is not None:
            given.out.write_text(json.dumps(found) + "\n", encoding="utf-8")
    found["regret"] = {name: found["regret"][name] for name in OPTIMIZERS if name in found["regret"]}
    print(*table(found), sep="\n")
    if given.out is not None and given.out.resolve() == STORED:
        replace_between(PAGE, "regret", table(found))
        if "fixed" in found:
            replace_between(PAGE, "fixed", fixed_table(found))
    if given.figure is not None:
        figure(found, given.figure)


if __name__ == "__main__":
    main()
