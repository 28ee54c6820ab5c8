"""SciPy: differential evolution with integers for the category, evaluated two at a time.

Needs nothing but chemlab, which needs SciPy.
"""

from __future__ import annotations

from typing import Any

from scipy.optimize import differential_evolution

from chemlab.campaign import Campaign, Choice


class _NoVesselLeft(Exception):
    pass


def optimize(campaign: Campaign, seed: int, batch: int = 2) -> None:
    """Use every vessel of the campaign."""

    def recipe(x: Any) -> dict[str, float | str]:
        found: dict[str, float | str] = {}
        for (name, allowed), value in zip(campaign.space.items(), x.tolist(), strict=True):
            found[name] = allowed.options[round(value)] if isinstance(allowed, Choice) else value
        return found

    def together(_: Any, points: Any) -> list[float]:
        found, points = [], list(points)
        for first in range(0, len(points), batch):
            recipes = [recipe(x) for x in points[first : first + min(batch, campaign.left)]]
            if not recipes:
                raise _NoVesselLeft
            found += [-result.value for result in campaign.run_batch(recipes)]
        return found

    spans = campaign.space.values()
    bounds = [(0, len(s.options) - 1) if isinstance(s, Choice) else (s.low, s.high) for s in spans]
    whole = [isinstance(s, Choice) or s.step > 0 for s in spans]
    settings: dict[str, Any] = {"popsize": 1, "maxiter": 1000, "tol": 0.0, "polish": False, "updating": "deferred"}
    try:
        differential_evolution(lambda x: 0.0, bounds, integrality=whole, rng=seed, workers=together, **settings)
    except _NoVesselLeft:
        return
