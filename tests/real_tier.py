"""Chemistries of the tier ``real`` for tests of its laws one by one: made by hand, or from a family in TOML."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from chemlab.kernels.arrays import FloatArray, declared
from chemlab.kernels.jit import kernel
from chemlab.kernels.tables import Table
from chemlab.physics.backends import law_addresses
from chemlab.physics.backends.real.fields import independent_reactions, padded
from chemlab.physics.backends.real.heats import enthalpy, set_enthalpy
from chemlab.physics.backends.real.kinetics import ALONE, integrate, react_work_size
from chemlab.physics.backends.real.real_chemistry import RealChemistry
from chemlab.physics.chemistry import AMOUNTS, CAPACITY, PRESENT, ROLE_SOLVENT, TEMPERATURE, network_fields
from chemlab.physics.surroundings import Surroundings


@kernel
def enthalpy_of(row: FloatArray, chem: Any) -> float:
    """J, of the contents of a vessel."""
    return enthalpy(row, chem)


@kernel
def give_enthalpy(row: FloatArray, value: float, chem: Any) -> None:
    """Set the temperature of a vessel by the enthalpy of its contents."""
    set_enthalpy(row, value, chem)


def real_table(materials: int, dissolved: Sequence[int] = (), layers: int = 1, **fields: Any) -> Table[Any]:
    """A chemistry of which nothing is known but ``fields``; its handle is good as long as the table is there.

    Args:
        materials: how many; 1 L/mol and 100 J/mol/K each, all solvents, unless ``fields`` say something else.
        dissolved: those of them that dissolve, in ``layers`` layers.
        layers: number of solvents.
        fields: of :class:`RealChemistry`.
    """
    lengths = {axis: 0 for field in declared(RealChemistry) for axis in field.axes}
    blank = Table.empty(RealChemistry, **lengths).arrays
    at = np.full(materials, -1)
    at[list(dissolved)] = np.arange(len(dissolved))
    reactions = len(fields.get("stoichiometry", ()))
    nothing = np.zeros((reactions, 0))
    values: dict[str, Any] = {
        "laws": law_addresses("real", RealChemistry),
        "role": np.full(materials, ROLE_SOLVENT),
        "solvents": np.arange(layers),
        "dissolved": np.array(dissolved, dtype=np.int64),
        "dissolved_at": at,
        "molar_volume": np.ones(materials),
        "heat_capacity": np.full(materials, 100.0),
        "formation": np.zeros(materials),
        "fusion": np.zeros(materials),
        "charge": np.zeros(materials),
        "ionization": np.full(3, -1),
        "independent": np.zeros(0),
        "parts": nothing.astype(np.int64),
        "part_numbers": nothing,
        "forward": nothing.astype(np.int64),
        "forward_order": nothing,
        "backward": nothing.astype(np.int64),
        "backward_order": nothing,
        "inhibitors": nothing.astype(np.int64),
        "inhibition": nothing,
        "equilibrium": np.full(reactions, np.inf),
        "equilibrium_heat": np.zeros(reactions),
        **fields,
    }
    return Table(blank._replace(**values))


def filled(
    table: Table[Any],
    amounts: Sequence[float] | FloatArray,
    temperature_k: float = 298.15,
    dissolved: Mapping[int, Sequence[float]] | None = None,
) -> FloatArray:
    """A vessel row with ``amounts`` (mol), of which ``dissolved`` (material: mol in each layer) are in solution."""
    known: Any = table.arrays
    materials, count, layers = len(known.role), len(known.dissolved), len(known.solvents)
    row = np.zeros(AMOUNTS + materials + count * layers)
    row[TEMPERATURE], row[CAPACITY], row[PRESENT] = temperature_k, 1000.0, 1.0
    row[AMOUNTS : AMOUNTS + materials] = amounts
    for material, parts in (dissolved or {}).items():
        first = AMOUNTS + materials + known.dissolved_at[material] * layers
        row[first : first + layers] = parts
    return row


def network(
    steps: Sequence[Mapping[str, Any]], species: int, formation: Sequence[float] | FloatArray = (), **fields: Any
) -> Table[Any]:
    """A chemistry of reactions over materials 0, 1, ...

    Args:
        steps: ``reactants`` and ``products`` (coefficients by number), ``k`` (pre-exponential), and optionally
            ``energy`` (J/mol), ``orders``, ``catalysts``, ``inhibitors``, ``equilibrium``.
        species: how many materials.
        formation: J/mol, all 0 by default.
        fields: others of :class:`RealChemistry`.
    """
    heats = np.array(formation, dtype=np.float64) if len(formation) else np.zeros(species)
    stoichiometry, orders = np.zeros((len(steps), species)), np.zeros((len(steps), species))
    ahead: list[dict[int, float]] = []
    back: list[dict[int, float]] = []
    for r, step in enumerate(steps):
        order = {**(step.get("orders") or step["reactants"])}
        behind = dict(step["products"]) if "equilibrium" in step else {}
        for j, x in step["reactants"].items():
            stoichiometry[r, j] -= x
            orders[r, j] = order[j]
        for j, x in step["products"].items():
            stoichiometry[r, j] += x
        for j, x in step.get("catalysts", {}).items():
            order[j] = order.get(j, 0.0) + x
            if behind:
                behind[j] = behind.get(j, 0.0) + x
        ahead.append(order)
        back.append(behind)
    forward, forward_order = padded(ahead)
    backward, backward_order = padded(back)
    inhibitors, inhibition = padded([step.get("inhibitors", {}) for step in steps])
    values = network_fields(
        np.arange(species),
        stoichiometry,
        orders,
        np.array([step["k"] for step in steps], dtype=np.float64),
        np.array([step.get("energy", 0.0) for step in steps], dtype=np.float64),
    )
    return real_table(
        species,
        **{
            **values,
            **independent_reactions(stoichiometry),
            "forward": forward,
            "forward_order": forward_order,
            "backward": backward,
            "backward_order": backward_order,
            "inhibitors": inhibitors,
            "inhibition": inhibition,
            "equilibrium": np.array([step.get("equilibrium", np.inf) for step in steps]),
            "equilibrium_heat": stoichiometry @ heats,
            "formation": heats,
            **fields,
        },
    )


def react(
    row: FloatArray, table: Table[Any], dt: float, jacket: float, transfer: float, tolerance: tuple[float, float]
) -> int:
    """Let a vessel react that nothing boils in; returns the number of steps."""
    around, work = Surroundings(jacket, transfer, -1.0, *tolerance), np.zeros(react_work_size(table.arrays))
    steps, passed = integrate(row, dt, around, math.inf, ALONE, table.handle, work)
    assert passed == (dt if steps >= 0 else 0.0)
    return int(steps)
