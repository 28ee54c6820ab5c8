"""Design of a scenario with the backend ``real`` for a reaction family: feeds, solvent and workup."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..config.datafile import DataError
from ..config.materials import Material, Materials, litres_of
from ..config.pairs import Pairs, log_activity_coefficients, pair_table
from ..config.reactions import Reaction, ReactionFamily
from ..config.scenario import SAFETY_EVENTS, RealSpec
from ..physics.constants import ATMOSPHERE_PA, GAS_CONSTANT, ROOM_K
from .writing import significant, toml_tables

WATER = "water"
SOLVENTS = ("diethyl_ether", "ethyl_acetate", "hexane", "toluene")
"""Bundled solvents for reactions and for washing with water, the lowest boiling first."""
_APART_K = 35.0
"""Minimum distance in K between the boiling points of goal and solvent."""
_MOL_PER_L = 0.8
"""Concentration of the goal at full conversion, in mol/L."""
_CAPACITY_L, _CRYSTALS_L = 1.5, 2.0
"""Capacity in litres of vessels, and of vessels for crystallization, which needs more solvent."""
_BELOW_BOILING_K = 8.0
"""Distance in K of the reaction temperature below the lowest boiling point."""
_LIFETIMES = (8.0, 40.0)
"""Duration of an experiment in time constants 1/k of the slowest step to the goal at full concentration.

The first is for first-order steps, the second for higher orders, which slow down with conversion.
"""
_STEPS = 60
"""Steps of an experiment at the reaction bench."""
_ROUNDS = 50
"""Iterations of the solubility calculation."""
_CLOCK_S = 60.0
"""Seconds per tick of the other benches; twice as many if the goal crystallizes."""
_CALM_W = 150.0
"""Heat of reaction in W that a flask of this size can remove, if released within half an experiment."""
_PARTED = 30.0
"""Ratio of two materials above and below a cut that a column has to reach."""
_MOST_STAGES = 15
_TICK_S = (10.0, 1800.0)
_CATALYST = 0.1
"""mol of a catalyst per mol of the goal."""
_STAYS, _SOLVENT_STAYS = 20.0, 10.0
"""Distribution criteria: ratio of activity coefficients in water and in the solvent, by litre, at infinite dilution.

Above the first, washing leaves a liquid in the solvent; above the second, the solvent itself remains. A liquid below a
tenth of the first is washed out.
"""
INSTRUMENTS: dict[str, dict[str, Any]] = {
    "uv_vis": {"kind": "uv_vis", "price": 0.002},
    "layer_camera": {"kind": "layer_camera", "price": 0.001},
    "balance": {"kind": "balance", "price": 0.0005},
    "gas_chromatograph": {"kind": "gas_chromatograph", "price": 0.01, "sample_fraction": 0.001},
}
SAFETY: dict[str, Any] = {"weights": {**dict.fromkeys(SAFETY_EVENTS, 1.0), "boiled_dry": 0.1, "dry_heating": 0.1}}


@dataclass(frozen=True)
class _Charge:
    """Composition and conditions of one preparation.

    Attributes:
        goal, solvent: materials.
        fed, reagents: mol of the starting materials, and of these and the catalysts that are charged with them.
        solvent_mol: mol of the solvent.
        tick: seconds per step of the reaction bench.
        warm_k: reaction temperature in K.
        heat_j: heat of reaction in J.
        washing, crystallizing: whether the product is washed with water, and whether it crystallizes.
        liquids: liquids that can occur.
    """

    goal: str
    solvent: str
    fed: dict[str, float]
    solvent_mol: float
    reagents: dict[str, float]
    tick: float
    warm_k: float
    heat_j: float
    washing: bool
    crystallizing: bool
    liquids: list[str]


def steps_to(goal: str, family: ReactionFamily) -> dict[str, Reaction]:
    """Return the route to the goal: for each material on it, the first reaction that makes the material."""
    ways = family.ways(goal)
    route: dict[str, Reaction] = {}
    names = [goal]
    while names:
        name = names.pop()
        if name in ways and name not in route:
            route[name] = ways[name][0]
            names += list(route[name].reactants)
    return route


def feeds(goal: str, family: ReactionFamily, mol: float) -> dict[str, float]:
    """Return mol of each starting material for an amount of the goal.

    Raises:
        DataError: no reaction makes the goal.
    """
    steps = steps_to(goal, family)
    if goal not in steps:
        products = sorted({name for step in family.reaction for name in step.products})
        raise DataError(f"goal {goal!r}: no reaction of {family.name!r} makes it; choose from {', '.join(products)}")
    needed, fed = {goal: mol}, dict[str, float]()
    for _ in range(len(steps) + 1):
        reactants: dict[str, float] = {}
        for name, amount in needed.items():
            if name not in steps:
                fed[name] = fed.get(name, 0.0) + amount
                continue
            step = steps[name]
            for reactant, number in step.reactants.items():
                reactants[reactant] = reactants.get(reactant, 0.0) + amount * number / step.products[name]
        needed = reactants
    return fed


def _liquid(material: Material) -> bool:
    return material.role in ("solvent", "solute") and not (material.melting_point_k or 0.0) > ROOM_K


def _crystallizes(material: Material) -> bool:
    solid = (material.melting_point_k or 0.0) > ROOM_K and material.role == "solute"
    return solid and material.real is not None and material.real.fusion_enthalpy_j_mol is not None


def _catalysts(goal: str, family: ReactionFamily) -> list[str]:
    """Return the catalysts of the steps to a goal."""
    steps = steps_to(goal, family).values()
    return list(dict.fromkeys(name for step in steps for name in step.catalysts))


def solvent_for(goal: str, family: ReactionFamily, materials: Materials) -> str:
    """Return a bundled solvent that boils far from the goal, preferably below it.

    A solvent that is a required catalyst is preferred, else one that takes no part in reactions.

    Raises:
        DataError: no bundled solvent is suitable.
    """
    boils = materials[goal].boiling_point_k
    reacting = {name for step in family.reaction for name in (*step.reactants, *step.products)}
    catalysts = [name for name in SOLVENTS if name in _catalysts(goal, family) and name not in reacting]
    candidates = catalysts or [name for name in SOLVENTS if name not in family.materials() and name != goal]
    below = [name for name in candidates if materials[name].boiling_point_k < boils - _APART_K]
    above = [name for name in candidates if materials[name].boiling_point_k > boils + _APART_K]
    if not below and not above:
        raise DataError(f"solvent: none of {', '.join(SOLVENTS)} fits; name one with --solvent")
    # The highest boiling solvent that can be distilled off, because most reactions are slow in the cold.
    return below[-1] if below else above[-1]


def _dilute(solute: str, solvent: str, materials: Materials, pairs: Pairs) -> float:
    """Return the activity coefficient at infinite dilution, per litre instead of per mole of solvent, at 298.15 K."""
    pair = pair_table((solute, solvent), pairs)
    gamma = log_activity_coefficients(np.array([0.0, 1.0]), pair.tau(ROOM_K), pair.alpha)[0]
    return litres_of({solvent: math.exp(float(gamma))}, materials)


def _tick(
    goal: str,
    family: ReactionFamily,
    temperature: float,
    litre: float,
    fed: Mapping[str, float],
    catalysts: Mapping[str, float],
) -> float:
    """Return the seconds per step of the reaction bench from the slowest reaction of the route; amounts are in mol."""
    longest = 0.0
    for step in steps_to(goal, family).values():
        k = step.pre_exponential * math.exp(-step.activation_energy_j_mol / (GAS_CONSTANT * temperature))
        k *= math.prod((catalysts[name] / litre) ** power for name, power in step.catalysts.items())
        order = sum(step.orders.values())
        concentration = max(fed.values()) / litre
        longest = max(longest, _LIFETIMES[order > 1.0] / (k * concentration ** (order - 1.0)))
    return significant(min(max(longest / _STEPS, _TICK_S[0]), _TICK_S[1]), 2)


def _soluble(solute: str, solvent: str, kelvin: float, materials: Materials, pairs: Pairs) -> float:
    """Return the solubility of a solid in mol per mol of solvent; ideal if the pair is unknown."""
    material = materials[solute]
    melts, heat = material.melting_point_k, material.real.fusion_enthalpy_j_mol if material.real else None
    if heat is None or melts is None or melts <= kelvin:
        return math.inf
    ideal = math.exp(-heat / GAS_CONSTANT * (1.0 / kelvin - 1.0 / melts))
    x = ideal
    if frozenset((solute, solvent)) in pairs:
        pair = pair_table((solute, solvent), pairs)
        for _ in range(_ROUNDS):
            gamma = log_activity_coefficients(np.array([x, 1.0 - x]), pair.tau(kelvin), pair.alpha)[0]
            x = math.sqrt(x * min(ideal * math.exp(-float(gamma)), 1.0 - 1e-9))
    return x / (1.0 - x)


def _dissolving_s(
    fed: Mapping[str, float], solvent: str, solvent_mol: float, kelvin: float, materials: Materials, pairs: Pairs
) -> float:
    """Return the time in seconds in which the slowest charged crystals dissolve to 1/e.

    If the solvent dissolves only a part at a time, the rest dissolves as the solute is consumed, which takes longer.
    """
    factors = [
        max(mol / max(solvent_mol * _soluble(key, solvent, kelvin, materials, pairs), 1e-9), 1.0)
        for key, mol in fed.items()
        if key != solvent and _crystallizes(materials[key])
    ]
    return max(factors, default=0.0) / RealSpec().crystal_rate


def _column(goal: str, others: Collection[str], materials: Materials) -> tuple[int, float]:
    """Return theoretical stages and reflux ratio that separate the goal from its neighbours in boiling point.

    The estimate is by Fenske (1932), with ideal vapour pressures and twice the number of stages at total reflux.
    """
    boils = materials[goal].boiling_point_k
    nearest = 1e9
    for key in others:
        real = materials[key].real
        if key == goal or real is None or real.vapor_pressure is None or _crystallizes(materials[key]):
            continue
        ratio = float(real.vapor_pressure.pascal(boils)) / ATMOSPHERE_PA
        nearest = min(nearest, max(ratio, 1.0 / max(ratio, 1e-9)))
    stages = 2.0 * math.log(_PARTED**2) / math.log(max(nearest, 1.2))
    return min(max(math.ceil(stages), 1), _MOST_STAGES), 1.0 if stages < 6.0 else 3.0


def _charge_litres(fed: Mapping[str, float], mol: float, materials: Materials) -> float:
    """Return the volume of a reaction's contents, solvent included."""
    return max(mol / _MOL_PER_L, 1.2 * litres_of(fed, materials))


def check_design(goal: str, solvent: str, family: ReactionFamily, materials: Materials, mol: float) -> None:
    """Check that a scenario can be designed; see :func:`design`.

    Raises:
        DataError: no reaction makes the goal; it or a starting material is a gas; the solvent is not a liquid or is the
            goal itself; a catalyst cannot be in a bottle; or the volume exceeds a vessel's capacity.
    """
    if materials[goal].role == "gas":
        raise DataError(f"goal {goal!r}: is a gas; vessels hold liquids and solids")
    if solvent not in materials or not _liquid(materials[solvent]):
        raise DataError(f"solvent {solvent!r}: is not a known liquid")
    if solvent == goal:
        raise DataError(f"solvent {solvent!r}: is the goal itself; name another")
    fed = feeds(goal, family, mol)
    ions = [key for key in fed if materials[key].charge]
    if ions:
        salts = [salt.solid for salt in family.salt if ions[0] in (salt.cation, salt.anion)]
        hint = f" ({', '.join(salts)})" if salts else ""
        raise DataError(
            f"goal {goal!r}: is made from {ions[0]!r}, an ion, which cannot be charged alone; write the reaction with "
            f"a salt of it{hint}, which dissociates in water"
        )
    gases = [key for key in fed if materials[key].role == "gas"]
    if gases:
        raise DataError(
            f"goal {goal!r}: is made from {gases[0]!r}, a gas; starting materials must be liquids or solids"
        )
    litre = _charge_litres(fed, mol, materials)
    if litre > 0.8 * _CAPACITY_L:
        raise DataError(f"mol = {mol:g}: {litre:.3g} L exceed a vessel's {_CAPACITY_L:g} L; use a smaller amount")
    for key in _catalysts(goal, family):
        if materials[key].role in ("ion", "gas"):
            raise DataError(
                f"catalyst {key!r}: is {'an ion' if materials[key].role == 'ion' else 'a gas'}, of which there is no "
                "bottle; write the scenario by hand, with it in a vessel, as in the bundled scenario fischer"
            )


def design(
    name: str,
    goal: str,
    solvent: str,
    family: ReactionFamily,
    materials: Materials,
    pairs: Pairs,
    mol: float,
    files: Mapping[str, Any],
    wash: bool = True,
) -> dict[str, Any]:
    """Return the tables of a designed scenario: benches, stock, time limits and costs.

    Args:
        name: name of the scenario.
        goal, solvent: materials.
        family: reactions; rate constants are per second.
        materials: known materials by id.
        pairs: activity coefficients of the materials that can occur.
        mol: theoretical maximum of the goal in mol.
        files: ``reactions``, ``material_files`` and ``pair_files`` of the scenario.
        wash: whether the product may be washed with water; otherwise pairs with water are not needed.

    Raises:
        DataError: see :func:`check_design`.
    """
    check_design(goal, solvent, family, materials, mol)
    fed = {key: significant(amount, 3) for key, amount in feeds(goal, family, mol).items()}
    litre = _charge_litres(fed, mol, materials)
    liquid = max(litre - litres_of(fed, materials), 0.2 * litre)
    in_solvent = significant(liquid / litres_of({solvent: 1.0}, materials), 3)
    others = [key for key in _catalysts(goal, family) if key not in (*fed, solvent)]
    violent = {key for step in family.violent if step.event != "none" for key in step.reactants}
    washing = wash and not violent & set(fed) and _washes(goal, solvent, family, materials, pairs)
    crystallizing = _crystallizes(materials[goal])
    reagents = {**fed, **dict.fromkeys(others, significant(_CATALYST * mol, 3))}
    liquids = [materials[k].boiling_point_k for k in (*reagents, solvent) if _liquid(materials[k])]
    warm = min(min(liquids) - _BELOW_BOILING_K, 420.0)
    heat = sum(abs(_heat(step, materials)) for step in steps_to(goal, family).values()) * mol
    contents = {**reagents, solvent: in_solvent + reagents.get(solvent, 0.0)}
    dissolving = _LIFETIMES[0] * _dissolving_s(reagents, solvent, in_solvent, warm, materials, pairs)
    tick = max(_tick(goal, family, warm, litre, fed, contents), significant(2.0 * heat / (_STEPS * _CALM_W), 2))
    tick = max(tick, min(significant(dissolving / _STEPS, 2), _TICK_S[1]))
    present = [key for key in dict.fromkeys((*fed, solvent, *sorted(family.materials()))) if _liquid(materials[key])]
    charge = _Charge(goal, solvent, fed, in_solvent, reagents, tick, warm, heat, washing, crystallizing, present)
    workup = {WATER: 80.0} if washing or crystallizing else {}
    workup |= {"ethanol": 20.0, goal: 0.01} if crystallizing else {}
    stock = {
        **reagents,
        solvent: significant(2.0 * in_solvent, 3),
        **{key: amount for key, amount in workup.items() if key not in reagents},
    }
    prices = {key: 5e-5 if key == WATER else 1e-3 if key not in reagents else 5e-3 for key in stock}
    vessel = {"capacity_l": _CRYSTALS_L if crystallizing else _CAPACITY_L, "contents": {solvent: in_solvent}}
    return {
        "name": name,
        "title": f"{materials[goal].name.capitalize()} from {' and '.join(materials[key].name for key in fed)}",
        "summary": family.summary,
        "physics": "real",
        **files,
        "goals": [goal],
        "lab_goals": [goal],
        "theoretical_maximum_mol": {goal: significant(mol + workup.get(goal, 0.0), 3)},
        # Ticks of the other benches are long, because a distillate has to cool and crystals need time.
        "real": {"tick_s": 2.0 * _CLOCK_S if crystallizing else _CLOCK_S},
        "stock": stock,
        "shelf": {"slots": 8, "vessel": [vessel]},
        "benches": _benches(charge, materials),
        "instruments": INSTRUMENTS,
        "limits": {"manager_actions": 60, "ticks": 500, "budget": 0.2},
        "costs": {"waste_per_l": 0.002, "tick": 0.0002, "illegal_action": 0.005, "stock_per_mol": prices},
        "safety": SAFETY,
    }


def _heat(step: Reaction, materials: Materials) -> float:
    """Return the heat of reaction in J per mol of the step, from formation enthalpies."""
    total = 0.0
    for sign, side in ((-1.0, step.reactants), (1.0, step.products)):
        for key, number in side.items():
            real = materials[key].real
            total += sign * number * (real.formation_enthalpy_j_mol if real else 0.0)
    return total


def _washes(goal: str, solvent: str, family: ReactionFamily, materials: Materials, pairs: Pairs) -> bool:
    """Return True if washing with water removes a salt, another liquid, or water that a reaction makes.

    Solvent and goal have to remain in the organic layer.
    """
    if WATER in (goal, solvent) or materials[goal].role == "solid":
        return False

    def stays(key: str) -> float:
        inside = litres_of({key: 1.0}, materials) if key == solvent else _dilute(key, solvent, materials, pairs)
        return _dilute(key, WATER, materials, pairs) / inside

    if stays(solvent) < _SOLVENT_STAYS or stays(goal) < _STAYS:
        return False
    salts = {salt.solid for salt in family.salt}
    present = {key for step in family.reaction for key in (*step.reactants, *step.products)}
    if WATER in present:
        return True
    present -= {goal, solvent}
    liquids = [key for key in present if materials[key].role in ("solvent", "solute")]
    return bool(salts & present) or any(stays(key) < 0.1 * _STAYS for key in liquids)


def _benches(charge: _Charge, materials: Materials) -> dict[str, Any]:
    """Return the tables of the benches."""
    goal, solvent = charge.goal, charge.solvent
    watts = charge.heat_j / (0.5 * _STEPS * charge.tick)
    start = {"capacity_l": _CAPACITY_L, "contents": {solvent: charge.solvent_mol}}
    made = significant(0.8 * min(charge.fed.values()), 3)
    crude = {**start, "contents": {solvent: charge.solvent_mol, goal: made}}
    low, high = min(ROOM_K - 30.0, charge.warm_k - 60.0), charge.warm_k + 2.0 * _BELOW_BOILING_K
    benches: dict[str, Any] = {
        "rxn": {
            "kind": "reaction",
            "step_limit": _STEPS,
            "reagents": charge.reagents,
            "temperature_k": {"low": round(low, 2), "high": round(high, 2), "step": 10.0},
            "volume_l": {"low": 0.6, "high": _CAPACITY_L, "step": 0.1},
            "vessel_volume_l": _CAPACITY_L,
            "rated_pressure_kpa": 500.0,
            "tick": charge.tick,
            "jacket_w_k": 6.0,
            "condenser_w": significant(max(80.0, 2.0 * watts), 3),
            "atol": 1e-9,
            "start": start,
        }
    }
    if charge.washing:
        benches["ext"] = {"kind": "extraction", "process": _WASHING, "start": crude}
    if charge.crystallizing:
        # Only the solvent is distilled off: a crystallizing goal is not distilled.
        hottest, stages, reflux = max(materials[solvent].boiling_point_k + 15.0, 375.0), 1, 1.0
    else:
        hottest = max(max(materials[key].boiling_point_k for key in charge.liquids) + 20.0, 478.15)
        stages, reflux = _column(goal, charge.liquids, materials)
    benches["dit"] = {
        "kind": "distillation",
        "step_limit": 100,
        "hottest_k": round(min(hottest, 650.0), 2),
        **({"stages": stages, "reflux": reflux} if stages > 1 else {}),
        "start": crude,
    }
    if charge.crystallizing:
        raw = {"capacity_l": _CRYSTALS_L, "contents": {goal: made}}
        benches["cry"] = {"kind": "crystallization", "step_limit": 120, "start": raw}
    return benches


_WASHING = [
    {"kind": "drain", "vessel": "EV", "target": "B1", "magnitudes": [1, 3, 8, 16, 32]},
    {"kind": "mix", "vessel": "EV", "magnitudes": [0.5, 1, 2, 4, 6]},
    {"kind": "pour", "vessel": "B1", "target": "EV", "magnitudes": [0.2, 0.4, 0.6, 0.8, 1]},
    {"kind": "pour", "vessel": "EV", "target": "B2", "magnitudes": [0.2, 0.4, 0.6, 0.8, 1]},
    {"kind": "add", "vessel": "EV", "material": WATER, "magnitudes": [0.05, 0.1, 0.2, 0.3, 0.4]},
    {"kind": "settle", "vessel": "EV", "magnitudes": [0.5, 1, 2, 4, 6]},
]


def occurring(goal: str, solvent: str, family: ReactionFamily, materials: Materials) -> list[tuple[str, str]]:
    """Return every pair of molecules whose activity coefficients a design may need."""
    names = [goal, solvent, WATER, *sorted(family.materials())]
    names += ["ethanol"] if _crystallizes(materials[goal]) else []
    molecules = [key for key in dict.fromkeys(names) if materials[key].role in ("solvent", "solute")]
    return list(itertools.combinations(molecules, 2))


def scenario_text(tables: Mapping[str, Any], command: str) -> str:
    """Return the text of a scenario file."""
    inline = "contents", "reagents", "start", "temperature_k", "volume_l", "process", "vessel", "weights"
    made_by = " ".join(command.split())  # the comment has one line
    lines = [f"# Made by {made_by}; every key: see chemlab's pages Write a scenario, and Keys of data files"]
    return "\n".join([*lines, *toml_tables(tables, (*inline, *INSTRUMENTS))]) + "\n"


def beside(path: Path, folder: Path) -> str:
    """Return a file's path relative to a scenario's folder, or its absolute path if it is outside."""
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return str(path.resolve())
