"""Arrays of the backend ``real`` in addition to those of :class:`chemlab.physics.chemistry.Chemistry`.

There are two liquid phases: water with its solutes, and everything else. They replace the solvents of the paper's
backend (``solvents`` has two entries, the materials that name the phases). The fluids (every material that a liquid can
hold: solvents, solutes, ions) replace its dissolvable materials. A vessel row ends in [K, 2] mol of each fluid in each
phase. The remainder of a fluid's total is its crystals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from ....config.datafile import DataError
from ....config.materials import Material
from ....config.pairs import pair_table
from ....kernels.arrays import FloatArray, IntArray, merged
from ...chemistry import Chemistry, Layout, Parameter, Structure
from .fields import AcidFields, KineticFields, acid_fields, kinetic_fields

if TYPE_CHECKING:
    from ....config.scenario import Scenario

AQUEOUS, ORGANIC = 0, 1
"""The two liquid phases."""
MOST_FLUIDS = 32
"""Maximum number of molecules in a scenario's liquids, for which kernels reserve room."""
CURVE_POINTS = 257
_COLDEST_K, _HOTTEST_K = 150.0, 900.0
_KILOPASCAL = 1e-3
_WATSON = 0.38
"""Exponent of the temperature dependence of heats of vaporization (Watson, Ind. Eng. Chem. 35 (1943) 398)."""
_INVERSE = np.linspace(1.0 / _HOTTEST_K, 1.0 / _COLDEST_K, CURVE_POINTS)
"""Grid of the curves in 1/K."""
_LEAST_SOLUBILITY = 0.01
"""Minimum solubility in mol/kg of salt in any liquid of a mixture with water.

A smaller value would let a trace of the liquid precipitate all salt. It is a guess; ethanol dissolves 0.011 mol/kg of
NaCl.
"""
_NEVER = -700.0
"""ln of a negligible value."""
_HIGHEST = 100.0
"""ln of the highest vapour pressure in kPa of a curve, so that sums over mixtures stay finite."""


class FluidFields(NamedTuple):
    """Fluids, their vapour and crystals. M materials, K of them fluids, n salts, G points of a curve."""

    liquid: Annotated[IntArray, Structure("M")]
    """[M] 1 for molecules that can be liquid, 2 for ions (which stay in water), 0 for materials that are never in a
    liquid
    """
    water: Annotated[int, Structure("")]
    """material index of water, -1 without it"""
    nrtl: Annotated[FloatArray, Structure("M M 4")]
    """[M, M, 4] a, b (K), c and alpha of tau_ij = a + b / T + c ln(T / 300 K)"""
    vapor: Annotated[FloatArray, Structure("M G")]
    """[M, G] ln of the vapour pressure in kPa on the grid in 1 / T; for dimerizing vapours, of the monomer; -700 for
    non-volatile materials
    """
    dimer: Annotated[FloatArray, Structure("M 2")]
    """[M, 2] a, b (K) of ln sqrt(K) = a + b / T, K in 1/kPa, of the vapour's dimers; 0, 0 without dimers"""
    vaporizing: Annotated[FloatArray, Structure("M G")]
    """[M, G] heat of vaporization in J/mol on the same grid"""
    curve: Annotated[FloatArray, Structure("2")]
    """[2] 1/K, first point and spacing of the grid in 1 / T"""
    formation: Annotated[FloatArray, Parameter("M")]
    """[M] formation enthalpy in J/mol at 298.15 K; of fluids in the liquid or dissolved state"""
    fusion: Annotated[FloatArray, Parameter("M")]
    """[M] heat of fusion in J/mol, 0 for materials that do not crystallize"""
    melting: Annotated[FloatArray, Parameter("M")]
    """[M] melting point in K"""
    solubility: Annotated[FloatArray, Structure("n M G")]
    """[n, M, G] ln of the solubility of a salt in mol per kilogram of a liquid, on the same grid"""
    crystal_rate: Annotated[float, Parameter("")]
    """rate in 1/s of the approach of a slurry to saturation"""
    metastable: Annotated[float, Parameter("")]
    """ratio to saturation below which nothing crystallizes without crystals"""
    room_transfer: Annotated[float, Parameter("")]
    """heat transfer in W/K/L of a vessel to the room"""
    tick_seconds: Annotated[float, Structure("")]
    """duration of a laboratory tick in s"""


RealChemistry: Any = merged(Chemistry, FluidFields, KineticFields, AcidFields)
"""Chemistry of one world as seen by this backend's kernels."""


def _curves(materials: list[Material]) -> dict[str, FloatArray]:
    """Return vapour pressures and heats of vaporization of all materials on the grid in 1 / T."""
    temperature = 1.0 / _INVERSE
    vapor = np.full((len(materials), CURVE_POINTS), _NEVER)
    vaporizing, dimer = np.zeros_like(vapor), np.zeros((len(materials), 2))
    for i, material in enumerate(materials):
        real = material.real
        if real is None or real.vapor_pressure is None or real.critical_temperature_k is None:
            continue
        with np.errstate(over="ignore"):  # far beyond its range a formula may overflow
            pressure = np.minimum(real.vapor_pressure.pascal(temperature) * _KILOPASCAL, math.exp(_HIGHEST))
        if real.dimerization is not None:
            dimer[i] = real.dimerization.log_root_constant()
            pressure = real.dimerization.monomer(temperature, pressure)
        vapor[i] = np.log(np.maximum(pressure, math.exp(_NEVER)))
        # The heat vanishes near the critical point; a floor keeps the energy balance solvable.
        left = np.maximum(1.0 - temperature / real.critical_temperature_k, 0.02)
        boiling = 1.0 - material.boiling_point_k / real.critical_temperature_k
        vaporizing[i] = material.vaporization_enthalpy_j_mol * (left / boiling) ** _WATSON
    curve = np.array([_INVERSE[0], _INVERSE[1] - _INVERSE[0]])
    return {"vapor": vapor, "dimer": dimer, "vaporizing": vaporizing, "curve": curve}


def _heats(names: list[str], materials: list[Material], ambient: float, where: str) -> dict[str, FloatArray]:
    """Return formation enthalpies (of fluids: liquid), heats of fusion, and melting points.

    Materials that are liquid at room temperature do not freeze; otherwise every addition to a cold vessel would have to
    state whether it is liquid or crystalline.
    """
    formation, fusion, melting = np.zeros((3, len(names)))
    for i, (name, material) in enumerate(zip(names, materials, strict=True)):
        real = material.real
        if real is None:
            raise DataError(
                f"{where}: materials: {name!r} has no [{name}.real] with the formation enthalpy and other values that "
                "physics = 'real' needs; add it to its file, or set physics = 'paper'"
            )
        formation[i] = real.formation_enthalpy_j_mol
        fluid = material.role in ("solvent", "solute")
        melts, heat = material.melting_point_k, real.fusion_enthalpy_j_mol
        if fluid and heat is not None and melts is not None and melts > ambient:
            fusion[i], melting[i] = heat, melts
        if fluid and real.formation_state == "s":
            formation[i] += heat or 0.0
        if fluid and real.formation_state == "g":
            raise DataError(f"{where}: materials: {name!r}: real.formation_state: must be 'l' or 's' for a liquid")
    return {"formation": formation, "fusion": fusion, "melting": melting}


def _solubility(scenario: Scenario, names: list[str]) -> FloatArray:
    """Return [n, M, G] ln (mol/kg) of each salt, in the order of ``Chemistry.salts``."""
    salts = sorted(scenario.family.salt, key=lambda salt: names.index(salt.cation))
    out = np.zeros((len(salts), len(names), CURVE_POINTS))
    for row, salt in zip(out, salts, strict=True):
        if salt.solubility is None:
            raise DataError(
                f"{scenario.origin}: reactions {scenario.family.name!r}: salt {salt.solid!r} has no solubility, which "
                "physics = 'real' needs; add salt.solubility with its source"
            )
        for curve, name in zip(row, names, strict=True):
            curve[:] = np.log(np.maximum(salt.solubility.mol_per_kg(name, 1.0 / _INVERSE), _LEAST_SOLUBILITY))
    return out


def build(scenario: Scenario, layout: Layout, values: Chemistry) -> tuple[Layout, Any]:
    """Build the chemistry of a scenario with ``physics = "real"``.

    Args:
        scenario: the scenario.
        layout, values: layout and values of the backend ``paper``.

    Raises:
        DataError: a material, a pair of liquids or a salt lacks data that the backend needs.
    """
    names, table = list(layout.materials), list(scenario.materials.values())
    roles = [material.role for material in table]
    fluids = [i for i, role in enumerate(roles) if role in ("solvent", "solute", "ion")]
    molecules = [i for i in fluids if roles[i] != "ion"]
    if len(molecules) > MOST_FLUIDS:
        raise DataError(
            f"{scenario.origin}: {len(molecules)} liquids and soluble molecules; physics = 'real' supports at most "
            f"{MOST_FLUIDS}"
        )
    liquid = np.zeros(len(names), dtype=np.int64)
    liquid[fluids] = 2
    liquid[molecules] = 1
    nrtl = np.zeros((len(names), len(names), 4))
    for part, matrix in enumerate(pair_table([names[i] for i in molecules], scenario.pairs)):
        nrtl[np.ix_(molecules, molecules, [part])] = np.asarray(matrix)[:, :, None]
    every = np.arange(len(names))
    heats = _heats(names, table, scenario.ambient_temperature_k, scenario.origin)
    water = names.index("water") if "water" in names else -1
    first = molecules[0] if molecules else 0
    made: Mapping[str, Any] = {
        **values._asdict(),
        "solvents": np.array([water if water >= 0 else first, first], dtype=np.int64),
        "dissolved": np.array(fluids, dtype=np.int64),
        "dissolved_at": np.where(np.isin(every, fluids), np.searchsorted(fluids, every), -1),
        "liquid": liquid,
        "water": water,
        "nrtl": nrtl,
        **_curves(table),
        **heats,
        "solubility": _solubility(scenario, names),
        "crystal_rate": scenario.real.crystal_rate,
        "metastable": scenario.real.metastable,
        "room_transfer": scenario.real.room_transfer_w_k_l,
        "tick_seconds": scenario.real.tick_s,
        **kinetic_fields(scenario, names, heats["formation"]),
        **acid_fields(scenario, names, heats["formation"]),
    }
    shape = Layout(layout.materials, ("aqueous", "organic"), tuple(names[i] for i in fluids), most_layers=2)
    return shape, RealChemistry(**made)
