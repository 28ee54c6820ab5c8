"""Numbers of the safety events in an events row; the order is ``chemlab.scenario.SAFETY_EVENTS``."""

from __future__ import annotations

__all__ = ["BOILED_DRY", "DRY_HEATING", "METAL_IN_WATER", "RELIEF", "SPILL"]

SPILL, RELIEF, BOILED_DRY, DRY_HEATING, METAL_IN_WATER = range(5)
