"""Physical laws by backend: the only interface between laboratory processes and the physics that they use.

A backend is a module that implements every law below under the same name. Kernels call a law by its address, which the
chemistry that they receive holds (:attr:`chemlab.physics.chemistry.Chemistry.laws`): so kernels are compiled once for
all backends, and the backend is selected in Python.

To add a backend: a module with all of these functions (kernels or helpers) and ``MOST_STEPS``, and an entry in
:data:`chemlab.config.scenario.PHYSICS_TIERS`.
"""

from __future__ import annotations

import importlib
import inspect
import typing
from typing import Any, TypeVar, cast

import numpy as np
from numba import types
from numba.extending import overload

from ...config.scenario import PHYSICS_TIERS as TIERS
from ...kernels import jit
from ...kernels.arrays import FloatArray, Handle, IntArray
from ...kernels.cache import told
from ...kernels.jit import COMPILED, F, helper, opened
from ..chemistry import Chemistry, ChemistryTable
from ..surroundings import Surroundings

R = TypeVar("R")

LAWS: list[str] = []
"""Names of the laws, in the order of their addresses."""
SEPARATE: dict[str, Any] = dict.fromkeys(
    ("activities", "bubble_point", "flash_off", "integrate", "overhead", "saturate", "settle", "settle_acids", "split")
)
"""Large functions of the backend ``real``, in the order of their addresses, which follow those of the laws."""
_KINDS: dict[Any, Any] = {
    FloatArray: types.float64[::1],
    IntArray: types.int64[::1],
    Handle: types.int64,
    float: types.float64,
    int: types.int64,
    bool: types.boolean,
    type(None): types.none,
}
"""numba types of annotations."""


def _law(declared: F) -> F:
    """Declare a law: a helper that calls the one of its name in the chemistry's backend."""
    LAWS.append(declared.__name__)
    return helper(declared)


def separate(function: F) -> F:
    """Compile one of the functions :data:`SEPARATE` once. Kernels call it by its address, as they call a law.

    A helper is optimized again as a part of every kernel that contains it.
    """
    name, at = function.__name__, list(inspect.signature(function).parameters).index("chem")

    def call(*arguments: Any) -> Any:
        return _call(name, arguments[at], arguments)

    assert SEPARATE[name] is None, "its place among the addresses must be known in advance"
    call.__qualname__ = f"separate_{name}"
    SEPARATE[name] = helper(function, call)
    return cast(F, SEPARATE[name])


def _backend(name: str) -> Any:
    return importlib.import_module(TIERS[name])


def work_size(chemistry: ChemistryTable) -> tuple[int, int]:
    """Return the minimum shape of the scratch array ``work`` of a backend's laws; its last row holds a vessel's."""
    rows, columns = _backend(chemistry.tier).work_size(chemistry.world())
    return rows + 1, max(columns, chemistry.layout.width)


def most_steps(chemistry: ChemistryTable) -> int:
    """Return the number of steps of an integration beyond which a backend gives up, as reactions are too stiff."""
    return int(_backend(chemistry.tier).MOST_STEPS)


def law_addresses(name: str, declaration: Any) -> IntArray:
    """Return the addresses of a backend's laws. Compiles them if necessary.

    Args:
        name: the backend.
        declaration: schema of its chemistry. If it has the fields of the backend ``real``, the addresses of the
            :data:`SEPARATE` functions follow.
    """
    if not COMPILED:
        return np.zeros(0, dtype=np.int64)
    with told(name):
        called = [*LAWS, *SEPARATE] if hasattr(declaration, "nrtl") else LAWS
        return np.array([law_address(law, name) for law in called], dtype=np.int64)


def law_address(law: str, name: str) -> int:
    """Return the address of a backend's law, or of a :data:`SEPARATE` function. Compiles it if necessary."""
    backend = _backend(name)  # fills SEPARATE
    function = getattr(backend, law) if law in LAWS else SEPARATE[law]
    own = not function.__module__.startswith("chemlab.")
    return jit.code_address(function, _signature(law), TIERS[name] if own else __name__)


def _signature(law: str) -> Any:
    """Return the numba signature of a law, or of a :data:`SEPARATE` function, from its annotations."""
    hints = typing.get_type_hints((globals()[law] if law in LAWS else SEPARATE[law]).py_func)
    given = {name: types.float64[:, ::1] if name == "work" else _kind(hint) for name, hint in hints.items()}
    return given.pop("return")(*given.values())


def _kind(hint: Any) -> Any:
    """Return the numba type of an annotation, which may be a tuple or a NamedTuple."""
    if hint in _KINDS:
        return _KINDS[hint]
    named = typing.get_origin(hint) is not tuple
    parts = typing.get_type_hints(hint).values() if named else typing.get_args(hint)
    return types.BaseTuple.from_types([_kind(part) for part in parts], hint if named else None)


def _call(law: str, chem: Handle, arguments: Any) -> R:  # type: ignore[type-var]  # as its caller declares it
    """Call a law of the chemistry's backend."""
    found: R = getattr(_backend(chem.BACKEND), law)(*arguments)
    return found


if COMPILED:

    @overload(_call, prefer_literal=True)
    def _called(law, chem, arguments):  # type: ignore[no-untyped-def]  # numba wants no types here
        name = law.literal_value
        at, call = [*LAWS, *SEPARATE].index(name), jit.call_address(name, _signature(name))

        def found(law, chem, arguments):  # type: ignore[no-untyped-def]
            return call(opened(Chemistry, chem).laws[at], arguments)

        found.__qualname__ = f"call_{name}"
        return found


@_law
def vapor_pressure(row: FloatArray, chem: Handle) -> float:
    """Return the vapour pressure of the liquids in a vessel in kPa."""
    return _call("vapor_pressure", chem, (row, chem))


@_law
def headspace_gas(row: FloatArray, chem: Handle) -> float:
    """Return mol of gas above the contents of a sealed vessel, without vapour."""
    return _call("headspace_gas", chem, (row, chem))


@_law
def vent(row: FloatArray, rated: float, chem: Handle, waste: FloatArray, events: FloatArray) -> None:
    """Open the relief valve: above ``rated`` kPa, gas leaves until the pressure is back at ``rated``.

    Lost vapour is taken from the liquid and added to ``waste`` [M]; it is a safety event.
    """
    _call("vent", chem, (row, rated, chem, waste, events))


@_law
def heat(
    row: FloatArray,
    receiver: FloatArray,
    joules: float,
    limits: FloatArray,
    chem: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> tuple[float, float]:
    """Heat (> 0) or cool (< 0) a vessel; vapour condenses into the receiver at ambient temperature.

    Args:
        row, receiver: vessel rows.
        joules: offered heat in J.
        limits: [4] temperatures in K of the heating mantle and of the coolant, which bound the heat flow;
            theoretical stages between pot and condenser (1: the pot alone); reflux ratio, the mol that the
            column's head returns per mol that passes.
        chem: the chemistry.
        waste: [M] mol, receives the overflow of the receiver.
        events: safety events row.
        work: scratch.

    Returns:
        (absorbed heat, heat removed by the condenser) in J. Heat in = change of (sum n Cp + air) (T - ambient)
        over both vessels + heat to the condenser, as long as nothing spills.
    """
    return _call("heat", chem, (row, receiver, joules, limits, chem, waste, events, work))


@_law
def settle_phases(row: FloatArray, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> None:
    """Apply the processes that follow every operation in any vessel: violent reactions, dissolution, precipitation.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        waste: [M] mol, receives vented gases.
        events: safety events row.
        work: scratch of shape :func:`work_size`.
    """
    _call("settle_phases", chem, (row, chem, waste, events, work))


@_law
def partition(row: FloatArray, chem: Handle, work: FloatArray) -> None:
    """Update the dissolved amounts of a vessel from CLOCK_WAS to CLOCK; none becomes negative and totals are conserved.

    Args:
        row: vessel row, changed in place.
        chem: the chemistry.
        work: scratch of shape :func:`work_size`.
    """
    _call("partition", chem, (row, chem, work))


@_law
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
    return _call("find_layers", chem, (row, chem, layers, volumes))


@_law
def solid_mol(row: FloatArray, material: int, chem: Handle) -> float:
    """Return mol of a material in a vessel that is solid."""
    return _call("solid_mol", chem, (row, material, chem))


@_law
def solid_volume(row: FloatArray, chem: Handle) -> float:
    """Return the volume of non-liquid contents in L."""
    return _call("solid_volume", chem, (row, chem))


@_law
def layer_density(row: FloatArray, layer: int, chem: Handle) -> float:
    """Return the density in kg/L of a layer, given by its code from :func:`find_layers`."""
    return _call("layer_density", chem, (row, layer, chem))


@_law
def layer_shade(row: FloatArray, layer: int, chem: Handle) -> float:
    """Return the grey value of a layer in the camera picture."""
    return _call("layer_shade", chem, (row, layer, chem))


@_law
def drain_layer(source: FloatArray, target: FloatArray, layer: int, share: float, chem: Handle) -> float:
    """Move ``share`` (0 to 1) of a layer, or of the solids, with its contents; return the moved heat capacity in
    J/K.
    """
    return _call("drain_layer", chem, (source, target, layer, share, chem))


@_law
def rate_constant(reaction: int, temperature: float, chem: Handle) -> float:
    """Return the rate constant of a reaction at ``temperature`` (K), in its own unit."""
    return _call("rate_constant", chem, (reaction, temperature, chem))


@_law
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
    return _call("react", chem, (row, dt, around, chem, waste, events, work))


@_law
def dry(row: FloatArray, litres: float, chem: Handle, waste: FloatArray) -> None:
    """Draw air over the contents of an open vessel.

    ``litres`` of air leave at the contents' temperature, saturated with vapour of the liquids, which goes to ``waste``
    [M]. The air supplies the heat of vaporization, so the temperature is constant. Solids stay.
    """
    _call("dry", chem, (row, litres, chem, waste))


@_law
def elapse(row: FloatArray, ticks: float, chem: Handle, waste: FloatArray, events: FloatArray, work: FloatArray) -> int:
    """Let time pass for an open vessel, anywhere in the laboratory.

    Args:
        row: vessel row, changed in place.
        ticks: laboratory time in ticks.
        chem: the chemistry.
        waste: [M] mol, receives lost vapour.
        events: safety events row.
        work: scratch of shape :func:`work_size`.

    Returns:
        0 if the contents have not changed; -1 if their reactions exceeded the limit of steps: then the rest of the
        time has not passed.
    """
    return _call("elapse", chem, (row, ticks, chem, waste, events, work))
