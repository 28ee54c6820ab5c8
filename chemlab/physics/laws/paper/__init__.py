"""The tier ``paper``: the laws of the ChemGymRL paper, mended where they did not conserve (docs/physics.md).

Arguments and results are those of :mod:`chemlab.physics.laws`.
"""

from ...kinetics import arrhenius as rate_constant
from ...kinetics import react_work_size
from .boiling import heat
from .layers import drain_layer, find_layers, layer_density, layer_shade, solid_volume
from .partition import partition
from .phases import settle_phases
from .rates import elapse, react, reflux
from .vapor import headspace_gas, vapor_pressure, vent

__all__ = [
    "drain_layer",
    "elapse",
    "find_layers",
    "headspace_gas",
    "heat",
    "layer_density",
    "layer_shade",
    "partition",
    "rate_constant",
    "react",
    "react_work_size",
    "reflux",
    "settle_phases",
    "solid_volume",
    "vapor_pressure",
    "vent",
]
