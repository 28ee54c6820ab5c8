"""Physical laws by backend: the only interface between laboratory processes and the physics that they use.

A backend is a module that implements every law below under the same name. Kernels call the laws; the backend is
selected at compile time by the type of the chemistry they receive (its number of dimensions: see
:class:`chemlab.physics.chemistry.ChemistryTable`), so the selection has no run-time cost.

To add a backend: a module with all of these functions (kernels or helpers), and an entry in
:data:`chemlab.config.scenario.PHYSICS_TIERS`.
"""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.extending import overload

from ...kernels.arrays import SLOT, FloatArray, Handle, IntArray, declared
from ...kernels.jit import COMPILED, INLINED
from ...kernels.warmup import compile_first
from ..chemistry import TIERS, Chemistry, ChemistryTable, tier_dimensions
from ..surroundings import Surroundings

if COMPILED:
    from ...kernels.jit import address, calling

__all__ = [
    "distant_law",
    "drain_layer",
    "dry",
    "elapse",
    "find_layers",
    "headspace_gas",
    "heat",
    "law",
    "law_addresses",
    "layer_density",
    "layer_shade",
    "partition",
    "rate_constant",
    "react",
    "settle_phases",
    "solid_mol",
    "solid_volume",
    "vapor_pressure",
    "vent",
    "work_size",
]

F = TypeVar("F", bound=Callable[..., Any])


_DISTANT: list[str] = []
"""Laws that kernels of backends other than the first call by address, in the order of their addresses."""
_KINDS: dict[str, tuple[Any, Any]] = {}
"""numba types of each law's parameters, except the number of dimensions of ``chem``, and of its result."""


def _tier(dimensions: int) -> Any:
    return importlib.import_module(list(TIERS.values())[dimensions - 1])


def work_size(chemistry: ChemistryTable) -> tuple[int, int]:
    """Return the minimum shape of the scratch array ``work`` of a backend's laws; its last row holds a vessel's."""
    rows, columns = _tier(tier_dimensions(chemistry.tier)).work_size(chemistry.world())
    return rows + 1, max(columns, chemistry.layout.width)


def _kinds(name: str, dimensions: int) -> tuple[tuple[Any, ...], Any]:
    """Return numba types of the parameters of a distant law, and of its result."""
    kinds, result = _KINDS[name]
    handle = numba.types.Array(numba.types.int64, dimensions, "C")
    return tuple(handle if kind is None else kind for kind in kinds), result


def law_addresses(dimensions: int) -> list[int]:
    """Return the addresses of a backend's distant laws, which end its pointer table. Compiles them if necessary."""
    if not COMPILED or dimensions == 1:
        return []
    laws = _compilations(dimensions)
    kernels = [getattr(_tier(dimensions), name) for name in _DISTANT]
    compile_first(kernels, dimensions, functools.partial(_compilations, dimensions), laws)
    return [law() for law in laws]


def _compilations(dimensions: int) -> list[Callable[[], int]]:
    """Return functions that compile each distant law of a backend and return its address."""
    return [
        functools.partial(address, getattr(_tier(dimensions), name), _kinds(name, dimensions)[0]) for name in _DISTANT
    ]


def _numba_type(name: str, annotation: str) -> Any:
    """Return the numba type of a law's parameter from its annotation; None for the chemistry."""
    array = numba.types.Array(numba.types.float64, 2 if name == "work" else 1, "C")
    types: Any = numba.types
    around = types.NamedUniTuple(types.float64, len(Surroundings._fields), Surroundings)
    known = {"FloatArray": array, "float": types.float64, "int": types.int64, "Handle": None, "Surroundings": around}
    return known[annotation]


def law(stub: F, distant: bool = False) -> F:
    """Declare a law that every backend implements; ``stub`` has its parameters, one of them called ``chem``."""
    name, signature = stub.__name__, inspect.signature(stub)
    parameters = list(signature.parameters)
    where = parameters.index("chem")

    @functools.wraps(stub)
    def call(*arguments: Any) -> Any:
        chem = arguments[where]
        dimensions = chem.ndim if COMPILED else tier_dimensions(getattr(chem, "TIER", "paper"))
        return getattr(_tier(dimensions), name)(*arguments)

    if distant and COMPILED:
        types: Any = numba.types
        results = {"float": types.float64, "int": types.int64, "bool": types.boolean, "None": types.none}
        results["tuple[float, float]"] = types.UniTuple(types.float64, 2)
        kinds = tuple(_numba_type(key, value.annotation) for key, value in signature.parameters.items())
        _KINDS[name] = kinds, results[str(signature.return_annotation)]
        _DISTANT.append(name)

    if COMPILED:

        def choose(*kinds: Any) -> Callable[..., Any]:
            dimensions = kinds[where].ndim
            if distant and dimensions > 1:
                declaration = getattr(_tier(dimensions), "DECLARATION", Chemistry)
                position = SLOT * len(declared(declaration)) + _DISTANT.index(name)
                target = calling(parameters, where, position, *_kinds(name, dimensions))
            else:
                target = getattr(_tier(dimensions), name)
            # A function with the law's own parameters that calls the backend's law, so that it can be cached.
            scope = {"_of_tier": target}
            listed = ", ".join(parameters)
            exec(f"def {name}({listed}):\n    return _of_tier({listed})", scope)
            return cast(Callable[..., Any], scope[name])

        overload(call, jit_options=cast(Any, INLINED), strict=False)(choose)
    return cast(F, call)


distant_law = functools.partial(law, distant=True)
"""Declare a large law, which kernels of backends after the first call by address."""


@distant_law
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Return the vapour pressure of the liquids in a vessel in kPa."""
    raise NotImplementedError


@law
def headspace_gas(row: FloatArray, chem: Handle) -> float:
    """Return mol of gas above the contents of a sealed vessel, without vapour."""
    raise NotImplementedError


@distant_law
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Open the relief valve: above ``rated`` kPa, gas leaves until the pressure is back at ``rated``.

    Lost vapour is taken from the liquid and added to ``waste`` [M]; it is a safety event.
    """
    raise NotImplementedError


@distant_law
def heat(
    row: FloatArray,
    receiver: FloatArray,
    joules: float,
    limits: FloatArray,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
) -> tuple[float, float]:
    """Heat (> 0) or cool (< 0) a vessel; vapour condenses into the receiver at ambient temperature.

    Args:
        row, receiver: vessel rows.
        joules: offered heat in J.
        limits: [4 or more] temperatures in K of the heating mantle and of the coolant, which bound the heat flow;
            theoretical stages between pot and condenser (1: the pot alone); reflux ratio, the mol that the
            column's head returns per mol that passes.
        chem: the chemistry.
        waste: [M] mol, receives the overflow of the receiver.
        events: safety events row.

    Returns:
        (absorbed heat, heat removed by the condenser) in J. Heat in = change of (sum n Cp + air) (T - ambient)
        over both vessels + heat to the condenser, as long as nothing spills.
    """
    raise NotImplementedError


@distant_law
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """Apply the processes that follow every operation in any vessel: violent reactions, dissolution, precipitation.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        waste: [M] mol, receives vented gases.
        events: safety events row.
        work: scratch of shape :func:`work_size`.
    """
    raise NotImplementedError


@distant_law
def partition(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Update the dissolved amounts of a vessel from CLOCK_WAS to CLOCK; none becomes negative and totals are conserved.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        work: scratch of shape :func:`work_size`.
    """
    raise NotImplementedError


@law
def find_layers(row: FloatArray, chem: Handle, layers: IntArray, volumes: FloatArray) -> int:
    """Find the solids, fluid layers and air of a vessel, densest fluid first.

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
def solid_mol(row: FloatArray, material: int, chem: Handle) -> float:
    """Return mol of a material in a vessel that is solid."""
    raise NotImplementedError


@law
def solid_volume(row: FloatArray, chem: Handle) -> float:
    """Return the volume of non-liquid contents in L."""
    raise NotImplementedError


@law
def layer_density(row: FloatArray, layer: int, chem: Handle) -> float:
    """Return the density in kg/L of a layer, given by its code from :func:`find_layers`."""
    raise NotImplementedError


@law
def layer_shade(row: FloatArray, layer: int, chem: Handle) -> float:
    """Return the grey value of a layer in the camera picture."""
    raise NotImplementedError


@law
def drain_layer(source: FloatArray, target: FloatArray, layer: int, share: float, chem: Handle) -> float:
    """Move ``share`` (0 to 1) of a layer, or of the solids, with its contents; return the moved heat capacity in
    J/K.
    """
    raise NotImplementedError


@law
def rate_constant(reaction: int, temperature: float, chem: Handle) -> float:
    """Return the rate constant of a reaction at ``temperature`` (K), in its own unit."""
    raise NotImplementedError


@distant_law
def react(
    row: FloatArray,
    dt: float,
    around: Surroundings,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> int:
    """React the contents of one vessel for ``dt``.

    If the vessel is not sealed, the condenser returns its share of the boiling vapour; excess vapour is lost and is a
    safety event.

    Args:
        row: vessel row, changed in place.
        dt: time, in the unit of the rate constants.
        around: surroundings of the vessel.
        chem: the chemistry.
        waste: [M] mol, receives lost vapour.
        events: safety events row.
        work: scratch of shape :func:`work_size`; its last row holds a copy of the vessel's.

    Returns:
        Number of steps, rejected ones included; -1 if it exceeded the limit: then the rest of ``dt``
        has not passed.
    """
    raise NotImplementedError


@distant_law
def dry(row: FloatArray, litres: float, chem: Handle, waste: FloatArray) -> None:
    """Draw air over the contents of an open vessel.

    ``litres`` of air leave at the contents' temperature, saturated with vapour of the liquids, which goes to ``waste``
    [M]. The air supplies the heat of vaporization, so the temperature is constant. Solids stay.
    """
    raise NotImplementedError


@distant_law
def elapse(
    row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray
) -> bool:
    """Let time pass for an open vessel, anywhere in the laboratory.

    Args:
        row: vessel row, changed in place.
        ticks: laboratory time in ticks.
        chem: the chemistry.
        waste: [M] mol, receives lost vapour.
        events: safety events row.
        work: scratch of shape :func:`work_size`.

    Returns:
        True if the contents have changed.
    """
    raise NotImplementedError
