"""Rate constants: Arrhenius (PHYSICS section 1)."""

from __future__ import annotations

import math

from ....arrays import Handle
from ....chemistry import Chemistry
from ....jit import helper, opened
from ...constants import GAS_CONSTANT

__all__ = ["rate_constant"]


@helper
def rate_constant(reaction: int, temperature: float, chem: Handle) -> float:
    """A exp(-Ea / RT)."""
    chemistry = opened(Chemistry, chem)
    power = -chemistry.activation_energy[reaction] / (GAS_CONSTANT * temperature)
    return float(chemistry.pre_exponential[reaction] * math.exp(power))
