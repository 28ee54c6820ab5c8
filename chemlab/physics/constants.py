"""Constants shared by the physics modules."""

from __future__ import annotations

GAS_CONSTANT = 8.31446261815324
"""Gas constant in J/mol/K (CODATA 2018, exact)."""
ROOM_K = 298.15
"""Temperature in K to which data of materials and reactions refer."""
ATMOSPHERE_PA = 101325.0
"""Standard pressure."""
TRACE_MOL = 1e-12
"""Amount in mol below which a material counts as absent, so that rounding remainders do not count as layers or
liquids.
"""
LEAST_CAPACITY = 1e-4
"""Heat capacity in J/K below which contents (a tenth of a milligram) take the temperature of their surroundings."""
SOLIDS = -2
"""Code of the solids at the bottom in a profile's columns."""
FIRST_PHASE = -3
"""Code of the first liquid phase of mixed materials (named by ``Layout.solvents``); further phases count down from
it.
"""
