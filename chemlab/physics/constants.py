"""Numbers that physics shares."""

from __future__ import annotations

__all__ = ["FIRST_PHASE", "GAS_CONSTANT", "LEAST_CAPACITY", "SOLIDS", "TRACE_MOL"]

GAS_CONSTANT = 8.31446261815324
"""J/mol/K (CODATA 2018, exact)."""
TRACE_MOL = 1e-12
"""Below this many moles nothing is there: what divisions leave behind must not count as a layer or a liquid."""
LEAST_CAPACITY = 1e-4
"""J/K; contents with less (a tenth of a milligram) take the temperature of their surroundings at once."""
SOLIDS = -2
"""What a profile's columns say where they stand for the solids at the bottom."""
FIRST_PHASE = -3
"""What they say for the first liquid phase of mixed materials (``Layout.solvents`` names them); others go down from
it."""
