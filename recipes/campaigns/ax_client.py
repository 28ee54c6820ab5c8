"""Ax: its default strategy, Sobol points and then Bayesian optimization.

Needs ax-platform (run with 1.3.1), which needs PyTorch.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import torch
from ax.api.client import Client
from ax.api.configs import ChoiceParameterConfig, RangeParameterConfig

from chemlab.campaign import Campaign, Choice


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    logging.getLogger("ax").setLevel(logging.WARNING)
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    client = Client(random_seed=seed)
    parameters: list[RangeParameterConfig | ChoiceParameterConfig] = []
    for name, allowed in campaign.space.items():
        if isinstance(allowed, Choice):
            parameters.append(
                ChoiceParameterConfig(name=name, values=list(allowed.options), parameter_type="str", is_ordered=False)
            )
        else:
            bounds = allowed.low, allowed.high
            parameters.append(RangeParameterConfig(name=name, bounds=bounds, parameter_type="float"))
    client.configure_experiment(parameters=parameters)
    client.configure_optimization(objective="value")
    client.configure_generation_strategy(initialization_random_seed=seed)

    def whole(recipe: Mapping[str, Any]) -> dict[str, Any]:
        """Round integers, which Ax takes as continuous: a search over a category and an integer takes ten times as long."""
        return {name: round(recipe[name]) if getattr(campaign.space[name], "step", 0) else recipe[name] for name in recipe}

    while campaign.left:
        asked = client.get_next_trials(max_trials=min(batch, campaign.left))
        results = campaign.run_batch([whole(recipe) for recipe in asked.values()])
        for number, result in zip(asked, results, strict=True):
            client.complete_trial(trial_index=number, raw_data={"value": result.value})
