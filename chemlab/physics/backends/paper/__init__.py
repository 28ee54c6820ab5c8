"""Backend ``paper``: the laws of the ChemGymRL paper, corrected where they violated conservation (docs/physics.md).

Arguments and results are those of :mod:`chemlab.physics.backends`.
"""

from ...mass_action import _MOST_STEPS as MOST_STEPS
from ...mass_action import arrhenius as rate_constant
from .boiling import heat
from .layers import drain_layer, find_layers, layer_density, layer_shade, solid_mol, solid_volume
from .partition import partition
from .phases import settle_phases
from .rates import elapse, react, work_size
from .vapor import dry, headspace_gas, vapor_pressure, vent
