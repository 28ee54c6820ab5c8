"""The chemistry of the tier ``real``."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from ....arrays import FloatArray, merged
from ....chemistry import Chemistry, Parameter
from .fields import AcidFields, KineticFields

__all__ = ["HeatFields", "RealChemistry"]


class HeatFields(NamedTuple):
    """Heat contents of M materials."""

    formation: Annotated[FloatArray, Parameter("M")]
    """[M] J/mol at 298.15 K, of what dissolves: as a liquid or dissolved; of others: as they are"""
    fusion: Annotated[FloatArray, Parameter("M")]
    """[M] J/mol, 0 for what does not crystallize"""


RealChemistry: Any = merged(Chemistry, HeatFields, KineticFields, AcidFields)
"""One world's chemistry as the tier's kernels see it."""
