"""Surroundings of a reacting vessel."""

from __future__ import annotations

from typing import NamedTuple


class Surroundings(NamedTuple):
    """Surroundings of a reacting vessel, and tolerances of the integration; all are floats."""

    jacket: float
    """jacket temperature in K"""
    transfer: float
    """heat transfer in W/K between contents and jacket; below 0: the contents have the jacket's temperature"""
    condenser: float
    """cooling power in W of a condenser; below 0: the vessel is sealed"""
    rtol: float
    atol: float
    """mol/L; tolerances as in ``scipy.integrate.solve_ivp``"""
