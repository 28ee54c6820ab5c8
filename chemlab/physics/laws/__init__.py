"""Physical laws, by tier: the one seam between what a laboratory does and which physics it does it by.

A *tier* is a module with an implementation of every law below, under the same name. Kernels call the laws; which tier
is compiled into them follows from the type of the chemistry they are given (its number of dimensions: see
:class:`chemlab.chemistry.ChemistryTable`), so a choice costs nothing when they run and nobody else has to know it.

To add a tier: a module with all of these functions (kernels or helpers), and an entry in
:data:`chemlab.scenario.PHYSICS_TIERS`.
"""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba.extending import overload

from ...arrays import FloatArray, Handle, IntArray
from ...chemistry import TIERS, tier_dimensions
from ...jit import COMPILED, SETTINGS

__all__ = ["find_layers", "heat", "law", "partition", "rate_constant", "settle_phases", "vapor_pressure", "vent"]

F = TypeVar("F", bound=Callable[..., Any])


def _implementation(law: str, dimensions: int) -> Any:
    return getattr(importlib.import_module(list(TIERS.values())[dimensions - 1]), law)


def law(stub: F) -> F:
    """A law of which every tier has its own version; ``stub`` has its parameters, one of them called ``chem``."""
    name, parameters = stub.__name__, list(inspect.signature(stub).parameters)
    where = parameters.index("chem")

    @functools.wraps(stub)
    def call(*arguments: Any) -> Any:
        chem = arguments[where]
        dimensions = chem.ndim if COMPILED else tier_dimensions(getattr(chem, "TIER", "paper"))
        return _implementation(name, dimensions)(*arguments)

    if COMPILED:

        def choose(*kinds: Any) -> Callable[..., Any]:
            # A function of the law's own parameters that calls the tier's, which keeps its place in the cache.
            scope = {"target": _implementation(name, kinds[where].ndim)}
            listed = ", ".join(parameters)
            exec(f"def {name}({listed}):\n    return target({listed})", scope)
            return cast(Callable[..., Any], scope[name])

        overload(call, jit_options=cast(Any, {**SETTINGS, "forceinline": True}), strict=False)(choose)
    return cast(F, call)


@law
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Pressure of the vapour over the liquids in a vessel, kPa."""
    raise NotImplementedError


@law
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Relief valve: above ``rated`` kPa gas leaves until the pressure is back there; lost vapour comes from the liquid
    and goes to ``waste`` [M], and is an event."""
    raise NotImplementedError


@law
def heat(
    row: FloatArray,
    receiver: FloatArray,
    joules: float,
    hottest: float,
    coolest: float,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
) -> tuple[float, float]:
    """Heat (> 0) or cool (< 0) a vessel; what boils condenses into the receiver at ambient temperature.

    Args:
        row, receiver: vessel rows.
        joules: heat offered, J.
        hottest, coolest: K, temperatures of the heating mantle and the coolant: no heat flows past them.
        chem: the chemistry.
        waste: [M] mol, receives what overflows the receiver.
        events: safety events row.

    Returns:
        (heat that went in, heat the condenser took away), J. Heat in = change of (sum n Cp + air) (T - ambient)
        over both vessels + heat to the condenser, as long as nothing spills.
    """
    raise NotImplementedError


@law
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, share: FloatArray) -> None:
    """What happens by itself in any vessel, after any operation: violent reactions, dissolution, precipitation.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        waste: [M] mol, receives vented gases.
        events: safety events row.
        share: [L] scratch.
    """
    raise NotImplementedError


@law
def partition(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Bring the dissolved amounts of a vessel from CLOCK_WAS to CLOCK; none becomes negative and none is lost.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        work: [2, L] or larger scratch.
    """
    raise NotImplementedError


@law
def find_layers(row: FloatArray, chem: Handle, layers: IntArray, volumes: FloatArray) -> int:
    """Solids, fluid layers and air of a vessel, densest fluid first.

    Args:
        row: vessel row.
        chem: the chemistry.
        layers: [C + 1] out: number of columns, then SOLIDS and a material index each (air last).
        volumes: [C] out: litres, of at most the vessel's capacity in total.

    Returns:
        Number of columns.
    """
    raise NotImplementedError


@law
def rate_constant(reaction: int, temperature: float, chem: Handle) -> float:
    """Rate constant of a reaction at ``temperature`` (K), in its own unit."""
    raise NotImplementedError
