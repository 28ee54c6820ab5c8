"""Random chemistries from a seed: balanced, physically plausible and solvable, with a given difficulty.

>>> train = [chemistry(seed, difficulty="medium") for seed in range(100)]
>>> test = [chemistry(seed, difficulty="medium") for seed in range(100, 120)]

A chemistry is an ordinary scenario. Chemistries of equal size and difficulty have equal spaces; their materials,
reactions, rate constants and boiling points differ. Equal arguments give equal chemistries on every machine with the
same version of chemlab. The theoretical maximum of a goal (``theoretical_maximum_mol``) follows from the stoichiometry;
:mod:`chemlab.openchem.difficulty` measures the attainable yield. No extra is required.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config.datafile import DataError
from ..config.datamodel import validated
from ..config.files import check_target, write_texts
from ..config.inherit import completed
from ..config.loading import restore_scenario
from ..config.materials import Material, Materials, litres_of, shipped_materials
from ..config.reactions import ReactionFamily, side_words
from ..config.scenario import PHYSICS_TIERS, Scenario
from ..physics.constants import GAS_CONSTANT
from .designs import INSTRUMENTS, SAFETY, SOLVENTS, design, scenario_text
from .invented import SOURCE, dilute_log, material_tables, pair_rows
from .reaction_networks import Draws, Network, Size, chosen_size, draw_network
from .writing import family_text, lock, material_text, pair_text, significant

_WARM_K = 330.0
"""Temperature in K at which rates are compared."""
_MOL_PER_L = 0.8
"""Concentration of reactants in mol/L to which the durations of reactions refer."""
_STEPS, _TICK_S = 30, 60.0
"""Steps, and seconds per step, of an experiment at the reaction bench."""
_ACTIVATION_J = (45_000.0, 75_000.0)
_LEAST_ACTIVATION_J = 15_000.0
_CATALYSED_J = (15_000.0, 30_000.0)
"""Range of activation energies in J/mol of catalysed reactions.

They are low, so that a product survives its distillation in the presence of catalyst residues.
"""
_BY_HEAT = 0.75
"""Probability that heat favours a side reaction over the competing main step; otherwise cold favours it."""
_APART_K = 35.0
"""Minimum distance in K of the goals' boiling points above the solvent's."""
_FEEDS_L, _MOL = 0.3, 0.5
"""Maximum volume in litres of all feeds, and maximum amount in mol of each."""
_CAPACITY_L, _SOLVENT_L = 1.2, (0.35, 0.7)
"""Capacity in litres of vessels, and litres of solvent in the first and the second; the second dilutes more."""
_MOST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Level:
    """Parameters of a difficulty level.

    Attributes:
        size: default size.
        lifetimes: duration of an experiment at 330 K in time constants 1/(k c) of a main step.
        side: rate of a side reaction at 330 K relative to the competing step's.
        decay: duration of an experiment at 330 K in lifetimes of a rearranging product.
        activation_j: difference in J/mol between the activation energies of side reactions and competing steps: higher,
            or lower for a quarter of them.
        gap_k: minimum distance in K between the boiling points of a goal and its neighbour, and the maximum for
            isomers.
    """

    size: Size
    lifetimes: tuple[float, float]
    side: tuple[float, float]
    decay: tuple[float, float]
    activation_j: tuple[float, float]
    gap_k: tuple[float, float]


LEVELS: dict[str, Level] = {
    "easy": Level(Size(1, 5, 3), (80.0, 150.0), (0.005, 0.03), (0.01, 0.05), (5e3, 20e3), (30.0, 60.0)),
    "medium": Level(Size(2, 8, 5), (50.0, 100.0), (0.03, 0.15), (0.05, 0.2), (15e3, 35e3), (15.0, 30.0)),
    "hard": Level(Size(3, 12, 9), (30.0, 60.0), (0.06, 0.25), (0.1, 0.4), (20e3, 40e3), (5.0, 12.0)),
}
"""Difficulties by name."""


@dataclass(frozen=True)
class Generated:
    """A chemistry as data.

    Attributes:
        name: name of the scenario.
        command: command that makes the chemistry again.
        tables: tables of the scenario file.
        family: tables of the reaction file.
        materials: tables of the material file.
        pairs: rows of the pair file (physics ``real``).
    """

    name: str
    command: str
    tables: dict[str, Any]
    family: dict[str, Any]
    materials: dict[str, dict[str, Any]]
    pairs: list[dict[str, Any]]

    def scenario(self) -> Scenario:
        """Return the scenario without writing files."""
        shipped = {name: material.model_dump(mode="json") for name, material in shipped_materials().items()}
        tables = completed(self.tables, self.name, Path())
        data = {"scenario": tables, "materials": {**shipped, **self.materials}, "reactions": self.family}
        return restore_scenario({**data, "pairs": self.pairs}, self.name)

    def files(self) -> dict[str, str]:
        """Return the texts of the files by name, the scenario's first."""
        texts = {
            f"{self.name}.toml": scenario_text(self.tables, self.command),
            f"{self.name}_reactions.toml": family_text(self.family),
            f"{self.name}_materials.toml": material_text(self.materials, self.command, ()),
        }
        if self.pairs:
            texts[f"{self.name}_pairs.toml"] = pair_text(self.pairs, self.command, ())
        return texts

    def write(self, folder: str | Path, force: bool = False) -> Path:
        """Write all files into a folder, or none.

        Args:
            folder: output folder; created if it does not exist.
            force: overwrite existing files.

        Returns:
            Path of the scenario.

        Raises:
            ValueError: a file exists already or cannot be written.
        """
        texts = {Path(folder) / name: text for name, text in self.files().items()}
        for path in texts:
            check_target(path, force)
        write_texts(texts)
        return next(iter(texts))


def chemistry(
    seed: int,
    materials: int | None = None,
    reactions: int | None = None,
    difficulty: str = "medium",
    physics: str = "paper",
    steps: int | None = None,
    goals: int = 1,
) -> Scenario:
    """Return a random chemistry as a scenario for any environment; see :func:`generated`.

    >>> import gymnasium
    >>> env = gymnasium.make("chemlab/Bench-v1", scenario=chemistry(7), bench="rxn")
    """
    return generated(seed, materials, reactions, difficulty, physics, steps, goals).scenario()


def generated(
    seed: int,
    materials: int | None = None,
    reactions: int | None = None,
    difficulty: str = "medium",
    physics: str = "paper",
    steps: int | None = None,
    goals: int = 1,
    name: str = "",
) -> Generated:
    """Return a random chemistry as data.

    Args:
        seed: seed; chemistries of different seeds are independent.
        materials, reactions, steps: numbers of materials without the solvent, of reactions, and of reactions on the
            route to the last goal; the defaults depend on the difficulty and on the given numbers.
        difficulty: one of :data:`LEVELS`.
        physics: physics backend, ``paper`` or ``real``.
        goals: number of goals: the last products of the route.
        name: name of the scenario; default: ``chemistry_SEED``.

    Raises:
        DataError: an argument is out of bounds, or no network has these numbers.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= _MOST_SEED:
        raise DataError(f"seed = {seed!r}: must be an integer from 0 to {_MOST_SEED}")
    for key, value, allowed in (("difficulty", difficulty, LEVELS), ("physics", physics, PHYSICS_TIERS)):
        if value not in allowed:
            raise DataError(f"{key} = {value!r}: must be one of {', '.join(allowed)}")
    level = LEVELS[difficulty]
    size = chosen_size(level.size, materials, reactions, steps)
    if not 1 <= goals <= size.steps:
        raise DataError(f"goals = {goals}: must be from 1 to {size.steps}, one for each step of the route")
    name = name or f"chemistry_{seed}"
    command = (
        f"chemlab data generate {name} --seed {seed} --materials {size.materials} --reactions {size.reactions} "
        f"--steps {size.steps} --goals {goals} --difficulty {difficulty} --physics {physics}"
    )
    draws = Draws("chemlab", seed, size.materials, size.reactions, size.steps, goals, difficulty, physics)
    network = draw_network(draws, size, catalysed=physics == "real")
    lab_goals = network.route[-goals:]
    shipped = shipped_materials()
    taken = [shipped[key].shade for key in ("air", "water", *SOLVENTS)]
    role = "solute" if physics == "paper" else "solvent"
    tables = material_tables(draws, network, lab_goals, level.gap_k, role, taken)
    family = {
        "name": name,
        "summary": "; ".join(f"{side_words(s.reactants)} -> {side_words(s.products)}" for s in network.steps) + ".",
        "lock": lock(command),
        "reaction": _reactions(draws, network, level),
    }
    known = {key: validated(Material, table, f"{name}: {key}") for key, table in tables.items()}
    solvent = _solvent(draws, known, lab_goals)
    head = {
        "name": name,
        "title": f"Invented chemistry {seed}, {difficulty}: {size.materials} materials, {size.reactions} reactions",
        "summary": f"{', '.join(lab_goals)} from {', '.join(network.feeds)} in {size.steps} steps. {family['summary']}",
        "physics": physics,
        "reactions": f"{name}_reactions.toml",
        "material_files": [f"{name}_materials.toml"],
    }
    if physics == "paper":
        return Generated(name, command, _paper(head, network, lab_goals, known, solvent), family, tables, [])
    known[solvent] = shipped[solvent]
    head["pair_files"] = [f"{name}_pairs.toml"]
    scenario = _real(head, network, lab_goals, known, solvent, family)
    return Generated(name, command, scenario, family, tables, pair_rows(known))


def _reactions(draws: Draws, network: Network, level: Level) -> list[dict[str, Any]]:
    """Return the tables of the reactions."""
    duration = _STEPS * _TICK_S
    main: list[tuple[float, float]] = []
    tables = []
    for step in network.steps:
        if step.kind == "main":
            constant, energy = draws.between(*level.lifetimes) / (_MOL_PER_L * duration), draws.between(*_ACTIVATION_J)
            main.append((constant, energy))
        else:
            constant, energy = main[step.beside]
            alone = step.kind == "rearranged" and not step.catalyst
            by_heat = alone or draws.happens(_BY_HEAT)
            energy += (1.0 if by_heat else -1.0) * draws.between(*level.activation_j)
            if step.catalyst:
                energy = draws.between(*_CATALYSED_J)
            constant = draws.between(*level.decay) / duration if alone else constant * draws.between(*level.side)
        energy = round(max(energy, _LEAST_ACTIVATION_J), -2)
        factor = significant(constant * math.exp(energy / (GAS_CONSTANT * _WARM_K)))
        tables.append(
            {
                "reactants": step.reactants,
                "products": step.products,
                **({"catalysts": {step.catalyst: 1}} if step.catalyst else {}),
                "pre_exponential": factor,
                "activation_energy_j_mol": energy,
                "source": f"{SOURCE}: {step.kind}, {constant:.2g} at {_WARM_K:g} K",
            }
        )
    return tables


def _solvent(draws: Draws, materials: Materials, goals: list[str]) -> str:
    """Return one of the two bundled solvents that mix best with all materials and boil far below the goals."""
    shipped = shipped_materials()
    lowest = min(materials[goal].boiling_point_k for goal in goals)
    fitting = [name for name in SOLVENTS if shipped[name].boiling_point_k < lowest - _APART_K]

    def worst(name: str) -> float:
        return max(dilute_log(material, shipped[name], _WARM_K) for material in materials.values())

    return draws.one_of(sorted(fitting, key=lambda name: (worst(name), name))[:2])


def _mol(feeds: Sequence[str], materials: Materials) -> float:
    """Return the equal amount of each feed in mol; the route consumes them completely."""
    return min(significant(_FEEDS_L / litres_of(dict.fromkeys(feeds, 1.0), materials), 2), _MOL)


def _paper(
    head: Mapping[str, Any], network: Network, goals: list[str], materials: Materials, solvent: str
) -> dict[str, Any]:
    """Return a scenario with the backend ``paper``, a reaction bench and a distillation bench, like ``fictitious``."""
    mol = _mol(network.feeds, materials)
    feeds = dict.fromkeys(network.feeds, mol)
    each = litres_of({solvent: 1.0}, shipped_materials())
    solvents = [{solvent: significant(volume / each, 3)} for volume in _SOLVENT_L]
    others = {name: significant(0.1 * mol, 2) for name in (*network.byproducts, *network.coproducts)}
    crude = {"capacity_l": _CAPACITY_L, "contents": {**solvents[0], **others}, "goal_mol": significant(0.7 * mol, 2)}
    benches = {
        "rxn": {
            "kind": "reaction",
            "step_limit": _STEPS,
            "reagents": feeds,
            "tick": _TICK_S,
            "vessel_volume_l": _CAPACITY_L,
            "start": {"capacity_l": _CAPACITY_L, "contents": solvents[0]},
        },
        "dit": {"kind": "distillation", "start": crude},
    }
    return {
        **head,
        "goals": goals,
        "lab_goals": goals,
        "theoretical_maximum_mol": dict.fromkeys(goals, mol),
        "stock": feeds,
        "shelf": {"slots": 6, "vessel": [{"capacity_l": _CAPACITY_L, "contents": contents} for contents in solvents]},
        "benches": benches,
        "instruments": INSTRUMENTS,
        "limits": {"manager_actions": 60, "ticks": 400, "budget": 0.2},
        "costs": {
            "waste_per_l": 0.002,
            "tick": 0.0002,
            "illegal_action": 0.005,
            "stock_per_mol": dict.fromkeys(feeds, 0.005),
        },
        "safety": SAFETY,
    }


def _real(
    head: Mapping[str, Any],
    network: Network,
    goals: list[str],
    materials: Materials,
    solvent: str,
    family: Mapping[str, Any],
) -> dict[str, Any]:
    """Return a scenario with the backend ``real``, as ``chemlab new`` designs it."""
    name, mol = str(head["name"]), _mol(network.feeds, materials)
    checked = validated(ReactionFamily, family, name)
    made = design(name, goals[-1], solvent, checked, materials, {}, mol, {}, wash=False)
    most = dict.fromkeys(goals, made["theoretical_maximum_mol"][goals[-1]])
    return {**made, **head, "goals": goals, "lab_goals": goals, "theoretical_maximum_mol": most}
