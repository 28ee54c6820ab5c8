"""Properties of invented materials, mutually consistent like those of real liquids.

| property | rule |
|---|---|
| molar mass, volume, heat capacity | sums over the invented atoms (the latter after Kopp, 1864; Neumann, 1831) |
| boiling point | Kinney, J. Am. Chem. Soc. 60 (1938) 3032: 230.14 b^(1/3) - 543, in Celsius; b is a sum over the atoms, and larger for polar materials |
| heat of vaporization | Everett, J. Chem. Soc. 1960, 2566 (Trouton's rule, the rising one): (36.6 + R ln T) T at the boiling point T, for liquids without hydrogen bonds |
| vapour pressure | Antoine's equation through 101.325 kPa with that heat there; C after Thomson, Chem. Rev. 38 (1946) 1 |
| critical temperature | 3/2 of the boiling point (Guldberg 1890) |
| activity coefficients | regular solutions (Scatchard 1931, Hildebrand 1933): ln gamma = V (d_1 - d_2)^2 / RT at high dilution, V the geometric mean of both volumes; as NRTL parameters |
| formation enthalpy | every reaction is exothermic |

Constants are from memory, and ranges are guesses. The ratio of b to the mass of a hydrocarbon is that of hexane and dodecane.
"""  # noqa: E501 - a table's line cannot be broken

from __future__ import annotations

import colorsys
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..config.materials import Material, Materials
from ..physics.constants import ATMOSPHERE_PA, GAS_CONSTANT, ROOM_K
from .reaction_networks import Draws, Network
from .writing import significant

_FREEZING_K = 273.15
_HEAVIEST_G = 230.0
"""Maximum molar mass in g/mol of final products; heavier ones would boil above the range of the benches."""
_ATOM_G, _COPRODUCT_G = (28.0, 80.0), (30.0, 60.0)
_NUMBER_PER_G = 0.21
"""Kinney's boiling point number of a hydrocarbon per g/mol."""
_FEED_K, _PRODUCT_K, _COPRODUCT_K = 340.0, 380.0, (370.0, 405.0)
"""Minimum boiling points of feeds and of their products; range of coproducts."""
_POLARITY = 0.05
"""E_T^N per boiling point number above a hydrocarbon's: 0.65 for ethanol, 0.36 for acetone, 0.1 for toluene."""
_DENSITY, _HEAT = (0.78, 1.05), (1.7, 2.2)
"""Ranges in kg/L and J/g/K of organic liquids."""
_SHADES, _APART = (0.06, 0.70), 0.01
_BANDS_NM = (225.0, 775.0)
_LOW_K, _HIGH_K = 250.0, 650.0
"""Temperature range of vapour pressures and activity coefficients."""
_MIDDLE_K = 360.0
_ALPHA = 0.3
_EXOTHERMIC_J = (25_000.0, 90_000.0)
SOURCE = "invented"


def boiling_point(number: float) -> float:
    """Return the boiling point in K for Kinney's boiling point number."""
    return 230.14 * math.pow(number, 1.0 / 3.0) - 543.0 + _FREEZING_K


def _boiling_number(kelvin: float) -> float:
    return float(((kelvin + 543.0 - _FREEZING_K) / 230.14) ** 3)


def _sums(network: Network, by_atom: Mapping[str, float]) -> dict[str, float]:
    """Return each material's sum of a property of its atoms."""
    return {name: sum(by_atom[e] * count for e, count in atoms.items()) for name, atoms in network.atoms.items()}


def _boiling_points(
    draws: Draws, network: Network, mass: Mapping[str, float], goals: Sequence[str], gap: tuple[float, float]
) -> dict[str, float]:
    """Return the boiling points in K.

    No material boils closer to a goal than the lower end of ``gap``. If the last product has isomers, one boils within
    the upper end.
    """
    boils: dict[str, float] = {}
    for name, grams in mass.items():
        hydrocarbon = _NUMBER_PER_G * grams
        if name in network.coproducts:
            boils[name] = draws.between(*_COPRODUCT_K)
        elif name in network.isomers:
            boils[name] = boils[network.isomers[name]] + draws.one_of((-1.0, 1.0)) * draws.between(*gap)
        else:
            least = _boiling_number(_FEED_K if name in network.feeds else _PRODUCT_K)
            boils[name] = boiling_point(max(hydrocarbon, least - 1.0) + draws.between(1.0, 5.0))
    _separate(draws, boils, network, goals, gap)
    return {name: round(kelvin, 1) for name, kelvin in boils.items()}


def _separate(
    draws: Draws, boils: dict[str, float], network: Network, goals: Sequence[str], gap: tuple[float, float]
) -> None:
    """Shift boiling points that are too close to a goal's: feeds down, products up."""
    for before, goal in itertools.pairwise(goals):
        boils[goal] = max(boils[goal], boils[before] + gap[0])
    for name in [key for key in boils if key not in goals]:
        down = name in network.feeds
        for goal in reversed(goals) if down else goals:
            if abs(boils[name] - boils[goal]) < gap[0]:
                boils[name] = boils[goal] + (-1.0 if down else 1.0) * draws.between(*gap)


def _enthalpies(draws: Draws, network: Network) -> dict[str, float]:
    """Return formation enthalpies in J/mol for which every reaction is exothermic."""
    found = {name: draws.between(-250e3, -60e3) for name in network.feeds}
    found |= {name: draws.between(-290e3, -180e3) for name in network.coproducts}
    for step in network.steps:
        released = sum(found[name] for name in step.products if name in found)
        new = [name for name in step.products if name not in found]
        heat = draws.between(*_EXOTHERMIC_J)
        if new:
            found[new[0]] = sum(found[name] * n for name, n in step.reactants.items()) - released - heat
    # A material that is formed both directly and from the product is more stable than the product.
    for step in network.steps:
        if step.kind == "rearranged":
            (product,), (isomer,) = step.reactants, step.products
            found[isomer] = min(found[isomer], found[product] - 5e3)
    return {name: round(joule, -2) for name, joule in found.items()}


def _vapor_pressure(boils: float, heat: float) -> dict[str, Any]:
    """Return the coefficients of Antoine's equation."""
    c = 17.75 - 0.19 * boils
    b = heat / GAS_CONSTANT * ((boils + c) / boils) ** 2 / math.log(10.0)
    a = math.log10(ATMOSPHERE_PA) + b / (boils + c)
    numbers = [significant(number, 7) for number in (a, b, c)]
    return {"form": "antoine", "coefficients": numbers, "low_k": _LOW_K, "high_k": round(1.4 * boils, 1)}


def _shades(number: int, taken: Sequence[float]) -> list[float]:
    """Return grey values that a camera can distinguish from each other and from the ``taken`` ones."""
    low, high = _SHADES
    shades = [low + (high - low) * i / max(number - 1, 1) for i in range(number)]
    step = min(_APART, 0.3 * (high - low) / max(number, 1))
    return [round(shade + (step if min(abs(shade - t) for t in taken) < 0.5 * step else 0.0), 4) for shade in shades]


def _looks(draws: Draws, number: int, taken: Sequence[float]) -> list[dict[str, Any]]:
    """Return distinct colours, shades and absorption bands of a number of materials."""
    low, high = _BANDS_NM
    looks = []
    for i, shade in enumerate(_shades(number, taken)):
        red, green, blue = colorsys.hls_to_rgb(i * 0.618 % 1.0, 0.45, 0.6)
        centers = [low + (high - low) * (i + 0.5) / number]
        if draws.happens(0.5):
            centers.append(draws.between(low, high))
        bands = [
            {
                "height_l_mol": round(draws.between(0.06, 0.15), 3),
                "center_nm": round(center, 1),
                "width_nm": round(draws.between(12.0, 20.0), 1),
            }
            for center in centers
        ]
        color = "#" + "".join(f"{round(255.0 * part):02x}" for part in (red, green, blue))
        looks.append({"color": color, "shade": shade, "absorption": bands})
    return looks


def material_tables(
    draws: Draws, network: Network, goals: Sequence[str], gap: tuple[float, float], role: str, taken: Sequence[float]
) -> dict[str, dict[str, Any]]:
    """Return the tables of a material file, in the order of ``network.atoms``.

    Args:
        draws: random numbers.
        network: the materials.
        goals: goals of the scenario.
        gap: minimum distance in K between the boiling points of a goal and its neighbour, and the maximum for isomers.
        role: role of all materials.
        taken: shades of the other materials of the scenario.
    """
    elements = list(dict.fromkeys(element for atoms in network.atoms.values() for element in atoms))
    most = min(_ATOM_G[1], 1.2 * _HEAVIEST_G / len(network.feeds))
    ranges = {e: _COPRODUCT_G if e[0] == "Y" else (max(_ATOM_G[0], 0.6 * most), most) for e in elements}
    grams = {e: round(draws.between(*ranges[e]), 2) for e in elements}
    litres = {e: grams[e] / draws.between(*_DENSITY) / 1000.0 for e in elements}
    heats = {e: grams[e] * draws.between(*_HEAT) for e in elements}
    mass, volume, heat = _sums(network, grams), _sums(network, litres), _sums(network, heats)
    boils = _boiling_points(draws, network, mass, goals, gap)
    formed = _enthalpies(draws, network)
    tables = {}
    for (name, atoms), look in zip(network.atoms.items(), _looks(draws, len(mass), taken), strict=True):
        kelvin = boils[name]
        vaporization = significant((36.6 + GAS_CONSTANT * math.log(kelvin)) * kelvin)
        polarity = _POLARITY * (_boiling_number(kelvin) - _NUMBER_PER_G * mass[name])
        swells = draws.between(0.98, 1.02)
        tables[name] = {
            "name": f"invented {name}",
            "formula": "".join(f"{element}{count if count > 1 else ''}" for element, count in sorted(atoms.items())),
            "composition": dict(sorted(atoms.items())),
            "molar_mass_g_mol": round(mass[name], 2),
            "density_kg_l": significant(mass[name] / volume[name] / swells / 1000.0),
            "heat_capacity_j_mol_k": significant(heat[name]),
            "boiling_point_k": kelvin,
            "vaporization_enthalpy_j_mol": vaporization,
            "polarity": round(min(max(polarity, 0.01), 0.9), 3),
            "role": role,
            **look,
            "source": _SOURCES,
            "real": {
                "critical_temperature_k": round(1.5 * kelvin, 1),
                "formation_enthalpy_j_mol": formed[name],
                "formation_state": "l",
                "vapor_pressure": _vapor_pressure(kelvin, vaporization),
                "source": _REAL_SOURCES,
            },
        }
    return tables


_SOURCES = {
    "molar_mass_g_mol": f"{SOURCE}: sum of its atoms",
    "density_kg_l": f"{SOURCE}: volumes of its atoms, within 2 %",
    "heat_capacity_j_mol_k": f"{SOURCE}: sum of its atoms (Kopp)",
    "boiling_point_k": f"{SOURCE}: Kinney's boiling point number",
    "vaporization_enthalpy_j_mol": f"{SOURCE}: Trouton's rule, after Everett",
    "polarity": f"{SOURCE}: by how much it boils above a hydrocarbon of its mass",
    "color_shade_absorption": f"{SOURCE}: spread colour and shade, artificial bands",
}
_REAL_SOURCES = {
    "critical_temperature_k": f"{SOURCE}: Guldberg's rule",
    "formation_enthalpy_j_mol": f"{SOURCE}: reactions give off heat",
    "vapor_pressure": f"{SOURCE}: Antoine's equation, C after Thomson",
}


# -- mixtures ---------------------------------------------------------------------------------------------------------


def _cohesion(material: Material) -> tuple[float, float]:
    """Return molar volume in m3/mol and solubility parameter in Pa^0.5, at 298.15 K."""
    assert material.real is not None
    assert material.real.critical_temperature_k is not None
    critical, boils = material.real.critical_temperature_k, material.boiling_point_k
    # Watson (1943) extrapolates the heat of vaporization from the boiling point.
    heat = material.vaporization_enthalpy_j_mol * ((critical - ROOM_K) / (critical - boils)) ** 0.38
    volume = material.molar_mass_g_mol / material.density_kg_l * 1e-6
    return volume, math.sqrt((heat - GAS_CONSTANT * ROOM_K) / volume)


def dilute_log(first: Material, second: Material, temperature_k: float) -> float:
    """Return ln gamma at infinite dilution of each of two liquids in the other."""
    (v1, d1), (v2, d2) = _cohesion(first), _cohesion(second)
    return math.sqrt(v1 * v2) * (d1 - d2) ** 2 / (GAS_CONSTANT * temperature_k)


def _tau(log: float) -> float:
    """Solve tau (1 + exp(-alpha tau)) = ``log`` (ln gamma at infinite dilution) for tau = tau_12 = tau_21."""
    tau = 0.5 * log
    for _ in range(20):  # Newton's method
        g = math.exp(-_ALPHA * tau)
        tau -= (tau * (1.0 + g) - log) / (1.0 + g * (1.0 - _ALPHA * tau))
    return tau


def pair_rows(materials: Materials) -> list[dict[str, Any]]:
    """Return the rows of a pair file for every pair of liquids.

    Args:
        materials: materials with properties of the backend ``real``.
    """
    rows = []
    for first, second in itertools.combinations(materials, 2):
        both = materials[first], materials[second]
        logs = {kelvin: dilute_log(*both, kelvin) for kelvin in (_LOW_K, _MIDDLE_K, _HIGH_K)}
        b = significant(_tau(logs[_MIDDLE_K]) * _MIDDLE_K, 6)
        error = max(abs(b / kelvin * (1.0 + math.exp(-_ALPHA * b / kelvin)) - log) for kelvin, log in logs.items())
        rows.append(
            {
                "of": [first, second],
                "a": [0.0, 0.0],
                "b": [b, b],
                "alpha": _ALPHA,
                "low_k": _LOW_K,
                "high_k": _HIGH_K,
                "error": significant(error, 2),
                "source": f"{SOURCE}: regular solution",
            }
        )
    return rows
