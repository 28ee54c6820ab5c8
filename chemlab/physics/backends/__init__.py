"""Physical laws, by tier: the one seam between what a laboratory does and which physics it does it by.

A *tier* is a module with an implementation of every law below, under the same name. Kernels call the laws; which tier
is compiled into them follows from the type of the chemistry they are given (its number of dimensions: see
:class:`chemlab.physics.chemistry.ChemistryTable`), so a choice costs nothing when they run and nobody else has to
know it.

To add a tier: a module with all of these functions (kernels or helpers), and an entry in
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
"""Laws that kernels of a tier other than the first call by their address, in the order of their addresses."""
_KINDS: dict[str, tuple[Any, Any]] = {}
"""Of each of them, numba types of its parameters but for ``chem``'s number of dimensions, and of its result."""


def _tier(dimensions: int) -> Any:
    return importlib.import_module(list(TIERS.values())[dimensions - 1])


def work_size(chemistry: ChemistryTable) -> tuple[int, int]:
    """Shape of the scratch array, ``work``, that a tier's laws need at least; and a last row that holds a vessel's."""
    rows, columns = _tier(tier_dimensions(chemistry.tier)).work_size(chemistry.world())
    return rows + 1, max(columns, chemistry.layout.width)


def _kinds(name: str, dimensions: int) -> tuple[tuple[Any, ...], Any]:
    """numba types of the parameters of a distant law, and of its result."""
    kinds, result = _KINDS[name]
    handle = numba.types.Array(numba.types.int64, dimensions, "C")
    return tuple(handle if kind is None else kind for kind in kinds), result


def law_addresses(dimensions: int) -> list[int]:
    """Where the code of a tier's distant laws is: what its handles end in. Compiles what is not compiled yet."""
    if not COMPILED or dimensions == 1:
        return []
    laws = _compilations(dimensions)
    kernels = [getattr(_tier(dimensions), name) for name in _DISTANT]
    compile_first(kernels, dimensions, functools.partial(_compilations, dimensions), laws)
    return [law() for law in laws]


def _compilations(dimensions: int) -> list[Callable[[], int]]:
    """What compiles each of a tier's distant laws, and returns its address."""
    return [
        functools.partial(address, getattr(_tier(dimensions), name), _kinds(name, dimensions)[0]) for name in _DISTANT
    ]


def _numba_type(name: str, annotation: str) -> Any:
    """The numba type of a law's parameter, by its annotation; None for the chemistry."""
    array = numba.types.Array(numba.types.float64, 2 if name == "work" else 1, "C")
    types: Any = numba.types
    around = types.NamedUniTuple(types.float64, len(Surroundings._fields), Surroundings)
    known = {"FloatArray": array, "float": types.float64, "int": types.int64, "Handle": None, "Surroundings": around}
    return known[annotation]


def law(stub: F, distant: bool = False) -> F:
    """A law of which every tier has its own version; ``stub`` has its parameters, one of them called ``chem``."""
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
            # A function of the law's own parameters that calls the tier's, which keeps its place in the cache.
            scope = {"_of_tier": target}
            listed = ", ".join(parameters)
            exec(f"def {name}({listed}):\n    return _of_tier({listed})", scope)
            return cast(Callable[..., Any], scope[name])

        overload(call, jit_options=cast(Any, INLINED), strict=False)(choose)
    return cast(F, call)


distant_law = functools.partial(law, distant=True)
"""A large law: kernels of tiers after the first call it by its address."""


@distant_law
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Pressure of the vapour over the liquids in a vessel, kPa."""
    raise NotImplementedError


@law
def headspace_gas(row: FloatArray, chem: Handle) -> float:
    """mol of gas above the contents of a sealed vessel, vapour not counted."""
    raise NotImplementedError


@distant_law
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Relief valve: above ``rated`` kPa gas leaves until the pressure is back there; lost vapour comes from the liquid
    and goes to ``waste`` [M], and is an event."""
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
    """Heat (> 0) or cool (< 0) a vessel; what boils condenses into the receiver at ambient temperature.

    Args:
        row, receiver: vessel rows.
        joules: heat offered, J.
        limits: [4, or more] temperatures of the heating mantle and of the coolant, K, past which no heat flows;
            theoretical stages between pot and condenser (1: the pot alone), and the mol that the column's head returns
            for each mol that it lets pass.
        chem: the chemistry.
        waste: [M] mol, receives what overflows the receiver.
        events: safety events row.

    Returns:
        (heat that went in, heat the condenser took away), J. Heat in = change of (sum n Cp + air) (T - ambient)
        over both vessels + heat to the condenser, as long as nothing spills.
    """
    raise NotImplementedError


@distant_law
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """What happens by itself in any vessel, after any operation: violent reactions, dissolution, precipitation.

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
    """Bring the dissolved amounts of a vessel from CLOCK_WAS to CLOCK; none becomes negative and none is lost.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        work: scratch of shape :func:`work_size`.
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
def solid_mol(row: FloatArray, material: int, chem: Handle) -> float:
    """mol of a material that lies in a vessel as a solid."""
    raise NotImplementedError


@law
def solid_volume(row: FloatArray, chem: Handle) -> float:
    """Volume of what is not liquid, L."""
    raise NotImplementedError


@law
def layer_density(row: FloatArray, layer: int, chem: Handle) -> float:
    """Density of a layer (by its code, as :func:`find_layers` gives it) of a vessel, kg/L."""
    raise NotImplementedError


@law
def layer_shade(row: FloatArray, layer: int, chem: Handle) -> float:
    """Grey value of a layer of a vessel, as a camera sees it."""
    raise NotImplementedError


@law
def drain_layer(source: FloatArray, target: FloatArray, layer: int, share: float, chem: Handle) -> float:
    """Move ``share`` (0 to 1) of a layer, or of the solids, with all that it holds; returns the heat capacity of what
    has moved, J/K."""
    raise NotImplementedError


@law
def rate_constant(reaction: int, temperature: float, chem: Handle) -> float:
    """Rate constant of a reaction at ``temperature`` (K), in its own unit."""
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
    """Let the contents of one vessel react for ``dt``. Of what boils meanwhile in a vessel that is not sealed, the
    condenser's share runs back; vapour beyond that is lost, and is an event.

    Args:
        row: vessel row, changed in place.
        dt: time, in the unit of the rate constants.
        around: what it stands in and under.
        chem: the chemistry.
        waste: [M] mol, receives what flies.
        events: safety events row.
        work: scratch of shape :func:`work_size`; its last row is for a copy of the vessel's.

    Returns:
        Number of steps taken, rejected ones included; -1 where that would have been too many: then the rest of ``dt``
        has not passed.
    """
    raise NotImplementedError


@distant_law
def dry(row: FloatArray, litres: float, chem: Handle, waste: FloatArray) -> None:
    """Air is drawn over the contents of an open vessel: ``litres`` of it leave at the contents' temperature, saturated
    with the vapour of their liquids, which goes to ``waste`` [M]. The air brings the heat that this takes, so the
    temperature stays as it is; solids stay, too."""
    raise NotImplementedError


@distant_law
def elapse(
    row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray
) -> bool:
    """Time passes for an open vessel, wherever it stands.

    Args:
        row: vessel row, changed in place.
        ticks: of laboratory time.
        chem: the chemistry.
        waste: [M] mol, receives what flies.
        events: safety events row.
        work: scratch of shape :func:`work_size`.

    Returns:
        Whether its contents have changed.
    """
    raise NotImplementedError
