"""The tier ``paper``: the laws of the ChemGymRL paper, mended where they did not conserve (docs/physics.md).

Arguments and results are those of :mod:`chemlab.physics.laws`.
"""

from .boiling import heat
from .layers import find_layers
from .partition import partition
from .phases import settle_phases
from .rates import rate_constant
from .vapor import vapor_pressure, vent

__all__ = ["find_layers", "heat", "partition", "rate_constant", "settle_phases", "vapor_pressure", "vent"]
