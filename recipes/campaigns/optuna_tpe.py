"""Optuna: its tree-structured Parzen estimator by ask and tell.

Needs optuna (run with 5.0.0).
"""

from __future__ import annotations

import optuna

from chemlab.campaign import Campaign, Choice


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)
    study = optuna.create_study(direction="maximize", sampler=sampler)

    def recipe(trial: optuna.Trial) -> dict[str, float | str]:
        found: dict[str, float | str] = {}
        for name, allowed in campaign.space.items():
            if isinstance(allowed, Choice):
                found[name] = trial.suggest_categorical(name, allowed.options)
            elif allowed.step:
                found[name] = trial.suggest_int(name, int(allowed.low), int(allowed.high))
            else:
                found[name] = trial.suggest_float(name, allowed.low, allowed.high)
        return found

    while campaign.left:
        trials = [study.ask() for _ in range(min(batch, campaign.left))]
        for trial, result in zip(trials, campaign.run_batch([recipe(t) for t in trials]), strict=True):
            study.tell(trial, result.value)
