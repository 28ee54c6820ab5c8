"""BayBE: its default recommender, a Gaussian process with expected improvement of a batch.

Needs baybe (run with 0.15.0), which needs PyTorch.
"""

from __future__ import annotations

import pandas
import torch
from baybe import Campaign as Design
from baybe import Settings
from baybe.parameters import CategoricalParameter, NumericalDiscreteParameter
from baybe.searchspace import SearchSpace
from baybe.targets import NumericalTarget

from chemlab.campaign import Campaign, Choice, Range

_LEVELS = 5
"""Values of each number: BayBE's discrete spaces are searched exhaustively."""


def _parameter(name: str, allowed: Choice | Range) -> CategoricalParameter | NumericalDiscreteParameter:
    if isinstance(allowed, Choice):
        return CategoricalParameter(name, allowed.options)
    values = [allowed.low + i * (allowed.high - allowed.low) / (_LEVELS - 1) for i in range(_LEVELS)]
    return NumericalDiscreteParameter(name, [round(v) if allowed.step else v for v in values])


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    Settings(random_seed=seed).activate()
    torch.set_num_threads(1)
    space = SearchSpace.from_product([_parameter(name, allowed) for name, allowed in campaign.space.items()])
    design = Design(space, NumericalTarget("value").to_objective())
    while campaign.left:
        asked = design.recommend(min(batch, campaign.left))
        results = campaign.run_batch([{str(key): row[key] for key in row} for row in asked.to_dict("records")])
        told = asked.assign(value=[result.value for result in results])
        design.add_measurements(pandas.DataFrame(told))
