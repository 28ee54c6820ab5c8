"""A tier of physics of a user's own: the paper's laws, but every rate constant is twice as large."""

from chemlab.arrays import Handle
from chemlab.jit import helper
from chemlab.physics.laws.paper import *  # noqa: F403 - all the others
from chemlab.physics.laws.paper import rate_constant as arrhenius


@helper
def rate_constant(reaction: int, temperature: float, chem: Handle) -> float:
    """2 A exp(-Ea / RT)."""
    return 2.0 * arrhenius(reaction, temperature, chem)
