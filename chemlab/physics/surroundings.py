"""What a vessel stands in and under while it reacts."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Surroundings"]


class Surroundings(NamedTuple):
    """What a vessel stands in and under while it reacts, and how exactly it is followed; all of them floats."""

    jacket: float
    """K"""
    transfer: float
    """W/K between contents and jacket; below 0: the contents have its temperature"""
    condenser: float
    """W that a condenser takes from what boils; below 0: the vessel is sealed"""
    rtol: float
    atol: float
    """mol/L; tolerances as in ``scipy.integrate.solve_ivp``"""
