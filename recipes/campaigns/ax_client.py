"""Ax: Sobol points, then its Gaussian process and acquisition function for noisy expected improvement.

The search of the acquisition function has fewer starting points than by default, which takes a tenth of the time.
Needs ax-platform (run with 1.3.1), which needs PyTorch.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import torch
from ax.adapter.registry import Generators
from ax.api.client import Client
from ax.api.configs import ChoiceParameterConfig, RangeParameterConfig
from ax.generation_strategy.generation_node import GenerationNode
from ax.generation_strategy.generation_strategy import GenerationStrategy
from ax.generation_strategy.generator_spec import GeneratorSpec
from ax.generation_strategy.transition_criterion import MinTrials

from chemlab.campaign import Campaign, Choice

_FIRST = 6
_SEARCH = {"num_restarts": 3, "raw_samples": 64}


def _strategy(seed: int) -> GenerationStrategy:
    sobol = GeneratorSpec(generator_enum=Generators.SOBOL, generator_kwargs={"seed": seed})
    options = {"model_gen_options": {"optimizer_kwargs": _SEARCH}}
    process = GeneratorSpec(generator_enum=Generators.BOTORCH_MODULAR, generator_gen_kwargs=options)
    after = MinTrials(threshold=_FIRST, transition_to="process")
    first = GenerationNode(name="sobol", generator_specs=[sobol], transition_criteria=[after])
    return GenerationStrategy(name="campaign", nodes=[first, GenerationNode(name="process", generator_specs=[process])])


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    logging.getLogger("ax").setLevel(logging.ERROR)
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
    client.set_generation_strategy(_strategy(seed))

    def whole(recipe: Mapping[str, Any]) -> dict[str, Any]:
        """Round integers, which Ax takes as continuous: with integers and a category its search takes longer."""
        steps = {name for name, allowed in campaign.space.items() if getattr(allowed, "step", 0)}
        return {name: round(value) if name in steps else value for name, value in recipe.items()}

    while campaign.left:
        asked = client.get_next_trials(max_trials=min(batch, campaign.left))
        results = campaign.run_batch([whole(recipe) for recipe in asked.values()])
        for number, result in zip(asked, results, strict=True):
            client.complete_trial(trial_index=number, raw_data={"value": result.value})
