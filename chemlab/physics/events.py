"""Indices of the built-in safety events in an events row; a scenario's own events follow."""

from __future__ import annotations

from ..config.scenario import SAFETY_EVENTS

SPILL = SAFETY_EVENTS.index("spill_l")
RELIEF = SAFETY_EVENTS.index("relief_valve_mol")
BOILED_DRY = SAFETY_EVENTS.index("boiled_dry")
DRY_HEATING = SAFETY_EVENTS.index("dry_heating")
METAL_IN_WATER = SAFETY_EVENTS.index("metal_in_water_mol")
