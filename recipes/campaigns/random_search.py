"""Random search: recipes drawn uniformly from the space.

Needs nothing but chemlab.
"""

from __future__ import annotations

import numpy as np

from chemlab.campaign import Campaign, Choice


def drawn(campaign: Campaign, rng: np.random.Generator) -> dict[str, float | str]:
    """Return a recipe drawn uniformly."""
    recipe: dict[str, float | str] = {}
    for name, allowed in campaign.space.items():
        if isinstance(allowed, Choice):
            recipe[name] = str(rng.choice(allowed.options))
        elif allowed.step:
            recipe[name] = int(rng.integers(int(allowed.low), int(allowed.high) + 1))
        else:
            recipe[name] = float(rng.uniform(allowed.low, allowed.high))
    return recipe


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    rng = np.random.default_rng(seed)
    while campaign.left:
        campaign.run_batch([drawn(campaign, rng) for _ in range(min(batch, campaign.left))])
