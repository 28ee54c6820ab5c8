"""Bayesian optimization of how long batches are heated.

In `campaign`, four batches react in the same unknown world, to the product and on to waste. Each batch is one
evaluation: it is heated for the number of oven runs with the highest expected improvement (Jones et al. 1998,
"Efficient Global Optimization of Expensive Black-Box Functions"), and its purity is read from one chromatogram. A
Gaussian process of purity over the logarithm of the runs is fitted to the readings. The last batch is heated for the
optimum of the process and not measured. The method uses no kinetics. The scripted manager, in comparison, knows
everything except the rate, and may measure and continue. PPO is not compared, because nothing is trained.

    python recipes/bayesian.py --out recipes/results/bayesian.json

Needs scikit-learn (the extra ``recipes``).
"""

from __future__ import annotations

import numpy as np
from recipe_parts import AUDIT_SEED, SCRIPTED, Budget, Outcome, cook
from scipy.stats import norm
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from chemlab import load_scenario
from chemlab.agents.evaluate.play import Target
from chemlab.agents.policies import scripted_bench
from chemlab.agents.scripted.belief import run_experiment
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories

TARGET = Target(load_scenario("campaign"), split="test")
GOAL, INSTRUMENT = "2-chlorohexane", "gas_chromatograph"
RUNS = np.arange(1, 41)
KERNEL = ConstantKernel(0.3**2) * RBF(0.7) + WhiteKernel(0.05**2)
"""Guesses: purities differ by some 0.3 over factors of two in time, and are read to 0.05."""
GUESS = 0.4
"""Prior mean of the purity."""


def improvement(process: GaussianProcessRegressor, best: float) -> FloatArray:
    """Return [runs] expected improvement over the best purity so far."""
    mean, deviation = process.predict(np.log(RUNS)[:, None], return_std=True)
    above = mean + GUESS - best
    gained: FloatArray = above * norm.cdf(above / deviation) + deviation * norm.pdf(above / deviation)
    return gained


def purity(labs: Laboratories, slot: int) -> float:
    """Return the purity of a vessel from a paid chromatogram."""
    labs.act(labs.manager.index, labs.members, np.array([labs.actions.encode("measure", slot, INSTRUMENT)]))
    names = labs.instruments.analytes[labs.instruments.names.index(INSTRUMENT)]
    amounts = np.maximum(labs.state.reading[0, slot, : len(names)], 0.0)
    return float(amounts[names.index(GOAL)] / max(amounts.sum(), 1e-9))


def campaign(seed: int, first: int) -> float:
    """Return the score of one episode whose first batch has a given number of runs."""
    labs = Laboratories(TARGET.scenario, 1, split=TARGET.split)
    labs.seed(0, np.random.SeedSequence(seed))
    labs.reset(labs.members, GOAL)
    policies = [None, *(scripted_bench(bench) for bench in labs.benches)]
    process = GaussianProcessRegressor(KERNEL, optimizer=None)
    tried: list[int] = []
    read: list[float] = []
    for batch in range(TARGET.scenario.orders):
        last = batch == TARGET.scenario.orders - 1
        if tried:
            process.fit(np.log(tried)[:, None], np.array(read) - GUESS)
            worth = process.predict(np.log(RUNS)[:, None]) if last else improvement(process, max(read))
            first = int(RUNS[worth.argmax()])
        for _ in range(first):
            run_experiment(labs, policies, ("rxn_0", GOAL), labs.members, batch)
        if not last:
            tried.append(first)
            read.append(purity(labs, batch))
        labs.act(labs.manager.index, labs.members, np.array([labs.actions.encode("submit", batch, batch)]))
    return float(labs.result(labs.members)[0])


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Play one seed for each duration of the first batch, about which there is no information."""
    random = np.random.default_rng(budget.seed)
    firsts = random.integers(2, 20, budget.episodes)
    scores = [campaign(AUDIT_SEED + i, int(first)) for i, first in enumerate(firsts)]
    scripted = TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)
    return {"Bayesian optimization": Outcome(float(np.mean(scores)), 0.0, 0), SCRIPTED: Outcome.of(scripted)}


if __name__ == "__main__":
    cook(recipe, __doc__, f"the laboratory of `campaign`, {GOAL}", steps=1, episodes=40)
