"""The scripted agents' way: rules of thumb, with every catalyst in turn.

It is what the scripted laboratory of the scenario does. Needs nothing but chemlab.
"""

from __future__ import annotations

from chemlab.campaign import Campaign, Choice


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""
    catalysts = campaign.space["catalyst"]
    assert isinstance(catalysts, Choice), "it is a category"
    tried = 0
    while campaign.left:
        names = [catalysts.options[(tried + i) % len(catalysts.options)] for i in range(min(batch, campaign.left))]
        rules = {"percent": 1.25, "equivalents": 1.3, "temperature_k": 363.15, "minutes": 20}
        campaign.run_batch([{"catalyst": name, **rules} for name in names])
        tried += len(names)
