"""Backend ``real``: non-ideal liquids, heats, crystals, acids and bases (docs/physics_real.md).

Arguments and results are those of :mod:`chemlab.physics.backends`.
"""

from ...mass_action import arrhenius as rate_constant
from .boiling import heat
from .drying import dry
from .kinetics import _MOST_STEPS as MOST_STEPS
from .layers import drain_layer, find_layers, layer_density, layer_shade, solid_mol, solid_volume
from .partition import partition
from .phases import elapse, settle_phases, work_size
from .reacting import react
from .real_chemistry import build
from .vapor import headspace_gas, vapor_pressure, vent
