"""The materials and reactions of a scenario as arrays, in two halves: what is fixed, and numbers that a world may draw.

The *structure* (which material is a solvent, what reacts with what) is shared by every laboratory. The *parameters*
(boiling points, rate constants, ...) have a leading axis of worlds; laboratory n uses row ``variant[n]``
(:class:`chemlab.physics.shelf.ShelfArrays`). :class:`ChemistryTable` owns both, built once for a scenario; kernels
see one world at a time, as a :class:`Chemistry`.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from ..config.materials import DataError
from ..config.scenario import PHYSICS_TIERS as TIERS
from ..config.scenario import Scenario
from ..kernels.arrays import Field, FloatArray, Handle, IntArray, addresses, declared, merged
from ..kernels.jit import COMPILED

__all__ = [
    "AIR",
    "AMOUNTS",
    "CAPACITY",
    "CLOCK",
    "CLOCK_WAS",
    "PRESENT",
    "ROLE_GAS",
    "ROLE_ION",
    "ROLE_SOLID",
    "ROLE_SOLUTE",
    "ROLE_SOLVENT",
    "TEMPERATURE",
    "TIERS",
    "WAVELENGTHS_NM",
    "Chemistry",
    "ChemistryTable",
    "Layout",
    "Parameter",
    "Structure",
    "build_chemistry",
    "element_matrix",
    "network_fields",
    "tier_dimensions",
]

# Columns of a vessel row; amounts and dissolved amounts follow (see Layout).
TEMPERATURE, CAPACITY, CLOCK, CLOCK_WAS, AIR, PRESENT, AMOUNTS = range(7)

ROLE_SOLVENT, ROLE_SOLUTE, ROLE_ION, ROLE_SOLID, ROLE_GAS = range(5)
_ROLES = {"solvent": ROLE_SOLVENT, "solute": ROLE_SOLUTE, "ion": ROLE_ION, "solid": ROLE_SOLID, "gas": ROLE_GAS}

WAVELENGTHS_NM: FloatArray = np.linspace(200.0, 800.0, 200)


def tier_dimensions(tier: str) -> int:
    """Number of dimensions that a world's chemistry has in kernels: what they choose a tier's laws by.

    Raises:
        DataError: there is no such tier.
    """
    if tier not in TIERS:
        raise DataError(
            f"physics: unknown tier {tier!r}; known: {', '.join(TIERS)}; add yours to chemlab.physics.chemistry.TIERS"
        )
    return 1 + list(TIERS).index(tier)


class Structure(Field):
    """A part of the chemistry that all worlds share."""


class Parameter(Field):
    """Numbers of which every world has its own."""


class Chemistry(NamedTuple):
    """One world's chemistry as kernels see it: M materials, L solvents, K dissolvable materials; R reactions over S of
    the materials."""

    species: Annotated[IntArray, Structure("S")]
    """[S] material indices"""
    stoichiometry: Annotated[FloatArray, Structure("R S")]
    """[R, S] products minus reactants"""
    factors: Annotated[IntArray, Structure("R F")]
    """[R, F] species whose concentrations multiply to the rate, one entry per whole order, then -1"""
    changes: Annotated[IntArray, Structure("R C")]
    """[R, C] species a reaction changes, then -1"""
    fractions: Annotated[FloatArray, Structure("R S")]
    """[R, S] what is left of each order above its whole part; [0, 0] where all orders are whole"""
    pre_exponential: Annotated[FloatArray, Parameter("R")]
    """[R] per time unit, (L/mol)^(order - 1)"""
    activation_energy: Annotated[FloatArray, Parameter("R")]
    """[R] J/mol"""
    role: Annotated[IntArray, Structure("M")]
    """[M] one of the ROLE constants"""
    solvents: Annotated[IntArray, Structure("L")]
    """[L] material index of each solvent"""
    dissolved: Annotated[IntArray, Structure("K")]
    """[K] material index of each dissolvable material (liquid solutes and ions)"""
    dissolved_at: Annotated[IntArray, Structure("M")]
    """[M] where a material stands among the dissolvable ones, -1 if it is none"""
    volatile: Annotated[IntArray, Structure("V")]
    """Material indices of all liquids, lowest boiling point first."""
    salts: Annotated[IntArray, Structure("n 3")]
    """[n, 3] solid, cation, anion; rows of one cation stand together"""
    violent: Annotated[FloatArray, Structure("n M")]
    """[n, M] stoichiometry of reactions that go to completion at once"""
    violent_event: Annotated[IntArray, Structure("n")]
    """[n] safety event that each counts as, -1 for none"""
    air: Annotated[int, Structure("")]
    """Material index of air."""
    molar_volume: Annotated[FloatArray, Parameter("M")]
    """[M] L/mol"""
    molar_mass: Annotated[FloatArray, Parameter("M")]
    """[M] g/mol"""
    density: Annotated[FloatArray, Parameter("M")]
    """[M] kg/L"""
    heat_capacity: Annotated[FloatArray, Parameter("M")]
    """[M] J/mol/K"""
    bottle_share: Annotated[FloatArray, Parameter("M")]
    """[M] litres of each litre out of a bottle that are what its label says"""
    bottle_rest: Annotated[IntArray, Parameter("M")]
    """[M] material index of what the rest is"""
    boiling_point: Annotated[FloatArray, Parameter("M")]
    """[M] K"""
    vaporization: Annotated[FloatArray, Parameter("M")]
    """[M] J/mol"""
    polarity: Annotated[FloatArray, Parameter("M")]
    """[M] E_T^N"""
    shade: Annotated[FloatArray, Parameter("M")]
    """[M] grey value in the layer camera"""
    basis: Annotated[FloatArray, Parameter("M 200")]
    """[M, 200] absorption per mol/L"""
    ambient_temperature: Annotated[float, Parameter("")]
    """K"""
    ambient_pressure: Annotated[float, Parameter("")]
    """kPa"""


@dataclass(frozen=True)
class Layout:
    """Where things stand in a vessel row."""

    materials: tuple[str, ...]
    solvents: tuple[str, ...]
    dissolved: tuple[str, ...]
    most_layers: int = 0
    """Liquid layers there can be at most; 0: as many as there are solvents, or liquids."""

    @property
    def width(self) -> int:
        """Numbers a vessel takes."""
        return AMOUNTS + len(self.materials) + len(self.solvents) * len(self.dissolved)

    @property
    def fluid_columns(self) -> int:
        """Columns a layer profile can need: solids, the most layers there can be, air."""
        return 2 + (self.most_layers or max(len(self.solvents), len(self.dissolved), 1))

    def index(self, material: str) -> int:
        """Column of ``material`` among the amounts."""
        return self.materials.index(material)


class ChemistryTable:
    """The chemistry of a scenario: owner of its structure and of the parameters of W worlds.

    Attributes:
        layout: where things stand in a vessel row.
        tier: which physics it is for (see :mod:`chemlab.physics.backends`).
        structure: arrays by field of :class:`Chemistry`, shared by all worlds.
        parameters: [W, ...] arrays by field, a row for each world; [1, ...] of fields in which worlds do not differ.
        worlds: W. World 0 is the one of the data files.
        handles: what kernels take; ``handles[w]`` is the chemistry of world w.
    """

    def __init__(
        self,
        layout: Layout,
        values: Chemistry,
        tier: str = "paper",
        worlds: int = 1,
        varying: Collection[str] | None = None,
    ) -> None:
        self.layout, self.tier, self.worlds = layout, tier, worlds
        self.structure: dict[str, npt.NDArray[Any]] = {}
        self.parameters: dict[str, npt.NDArray[Any]] = {}
        self._declaration = cast(Any, type(values))
        for field, value in zip(declared(self._declaration), values, strict=True):
            array = np.ascontiguousarray(value, dtype=field.dtype)
            if isinstance(field.field, Parameter):
                rows = worlds if varying is None or field.name in varying else 1
                self.parameters[field.name] = np.stack([array.reshape(np.asarray(value).shape)] * rows)
            else:
                self.structure[field.name] = array
        self.handles: Handle = self._make_handles()

    def _row(self, world: int) -> list[npt.NDArray[Any]]:
        rows = []
        for field in declared(self._declaration):
            if field.name in self.structure:
                rows.append(self.structure[field.name])
                continue
            own = self.parameters[field.name]
            at = world if len(own) > 1 else 0
            rows.append(own[at : at + 1].reshape(own.shape[1:] or (1,)))
        return rows

    def axes(self, field: str) -> tuple[str, ...]:
        """Names of the axes that a parameter has in each world, as :class:`Chemistry` declares them."""
        return next(known.axes for known in declared(self._declaration) if known.name == field)

    def _make_handles(self) -> Handle:
        if not COMPILED:
            # Plain functions see the arrays themselves, of a class that says the tier.
            seen = type(self._declaration.__name__, (self._declaration,), {"TIER": self.tier})
            return [seen(*self.world(w)) for w in range(self.worlds)]
        laws: Any = importlib.import_module(f"{__package__}.backends")
        code = np.array(laws.law_addresses(tier_dimensions(self.tier)), dtype=np.int64)
        table = np.stack([np.concatenate([addresses(self._row(w)), code]) for w in range(self.worlds)])
        # The number of dimensions tells kernels the tier: see chemlab.physics.backends.
        return table.reshape(self.worlds, *(1,) * (tier_dimensions(self.tier) - 1), -1)

    def world(self, world: int = 0) -> Chemistry:
        """The chemistry of one world (views: what is written there, kernels read)."""
        numbers = {field.name for field in declared(self._declaration) if field.number}
        pairs = zip(declared(self._declaration), self._row(world), strict=True)
        made: Chemistry = self._declaration(*(a.item() if field.name in numbers else a for field, a in pairs))
        return made

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name not in ("handles", "_declaration")}
        # A merged declaration is made anew from its parts.
        return kept | {"_parts": getattr(self._declaration, "MERGED", (self._declaration,))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._declaration = merged(*state.pop("_parts"))
        vars(self).update(state)
        self.handles = self._make_handles()  # addresses are those of the copy


def network_fields(
    species: IntArray,
    stoichiometry: FloatArray,
    orders: FloatArray,
    pre_exponential: FloatArray,
    activation_energy: FloatArray,
) -> dict[str, npt.NDArray[Any]]:
    """The fields of a :class:`Chemistry` that are a reaction network's, from its stoichiometry [R, S], orders [R, S]
    and Arrhenius constants [R]."""
    whole = np.floor(orders).astype(np.int64)
    factors = np.full((len(orders), max(int(whole.sum(axis=1).max(initial=0)), 1)), -1, dtype=np.int64)
    for r, row in enumerate(whole):
        chosen = np.repeat(np.arange(len(row)), row)
        factors[r, : len(chosen)] = chosen
    changed = [np.flatnonzero(row) for row in stoichiometry]
    changes = np.full((len(orders), max((len(c) for c in changed), default=1)), -1, dtype=np.int64)
    for r, c in enumerate(changed):
        changes[r, : len(c)] = c
    fractions = orders - whole
    if not fractions.any():
        fractions = np.zeros((0, 0))
    return {
        "species": species,
        "stoichiometry": stoichiometry,
        "factors": factors,
        "changes": changes,
        "fractions": fractions,
        "pre_exponential": pre_exponential,
        "activation_energy": activation_energy,
    }


def _stoichiometry(steps: Any, names: list[str]) -> FloatArray:
    """[n, names] products minus reactants of some reactions."""
    out = np.zeros((len(steps), len(names)))
    for row, step in zip(out, steps, strict=True):
        for name, number in step.reactants.items():
            row[names.index(name)] -= number
        for name, number in step.products.items():
            row[names.index(name)] += number
    return out


def _network(scenario: Scenario) -> dict[str, npt.NDArray[Any]]:
    """The scenario's reactions, over the materials that take part in one."""
    steps = scenario.family.reaction
    names = list(scenario.materials)
    taking_part = [name for name in names if any(name in step.materials() for step in steps)]
    orders = np.zeros((len(steps), len(taking_part)))
    for row, step in zip(orders, steps, strict=True):
        for name in step.reactants:
            row[taking_part.index(name)] = step.orders[name]
    return network_fields(
        species=np.array([names.index(name) for name in taking_part], dtype=np.int64),
        stoichiometry=_stoichiometry(steps, taking_part),
        orders=orders,
        pre_exponential=np.array([step.pre_exponential for step in steps]),
        activation_energy=np.array([step.activation_energy_j_mol for step in steps]),
    )


def _violent_events(scenario: Scenario) -> IntArray:
    """[n] the safety event that each violent reaction counts as, -1 for none."""
    kinds, found = scenario.safety_events, []
    for step in scenario.family.violent:
        first = scenario.materials[next(iter(step.reactants))]
        metal = first.role == "solid" and len(first.composition) == 1 and "water" in step.reactants
        event = step.event or ("metal_in_water_mol" if metal else "none")
        if event not in ("none", *kinds):
            raise DataError(
                f"{scenario.origin}: reactions {scenario.family.name!r}: violent.event: unknown safety event "
                f"{event!r}; known: none, {', '.join(kinds)}; declare your own under safety.events"
            )
        found.append(-1 if event == "none" else kinds.index(event))
    return np.array(found, dtype=np.int64)


def build_chemistry(scenario: Scenario, worlds: int = 1, varying: Collection[str] | None = None) -> ChemistryTable:
    """The chemistry of a scenario, materials in the order of ``scenario.materials``; every world has the numbers of
    the data files. ``varying`` are the fields in which worlds may come to differ, default: all."""
    names = list(scenario.materials)
    table = list(scenario.materials.values())
    index = {name: i for i, name in enumerate(names)}
    role = np.array([_ROLES[m.role] for m in table], dtype=np.int64)
    solvents = np.flatnonzero(role == ROLE_SOLVENT)
    dissolved = np.flatnonzero((role == ROLE_SOLUTE) | (role == ROLE_ION))
    every = np.arange(len(names))
    boiling = np.array([m.boiling_point_k for m in table])
    liquids = np.flatnonzero((role == ROLE_SOLVENT) | (role == ROLE_SOLUTE))
    salts = sorted(
        [(index[s.solid], index[s.cation], index[s.anion]) for s in scenario.family.salt], key=lambda row: row[1]
    )
    basis = np.zeros((len(names), len(WAVELENGTHS_NM)))
    for i, material in enumerate(table):
        for peak in material.absorption:
            offset = (WAVELENGTHS_NM - peak.center_nm) / peak.width_nm
            with np.errstate(under="ignore"):  # far from a peak, its absorption is 0
                basis[i] += peak.height_l_mol * np.exp(-0.5 * offset**2)
    basis[basis < np.finfo(np.float64).tiny] = 0.0  # a sum with such numbers takes many times as long
    values = Chemistry(
        **_network(scenario),
        role=role,
        solvents=solvents.astype(np.int64),
        dissolved=dissolved.astype(np.int64),
        dissolved_at=np.where(np.isin(every, dissolved), np.searchsorted(dissolved, every), -1),
        volatile=liquids[np.argsort(boiling[liquids], kind="stable")].astype(np.int64),
        salts=np.array(salts, dtype=np.int64).reshape(len(salts), 3),
        violent=_stoichiometry(scenario.family.violent, names),
        violent_event=_violent_events(scenario),
        air=index["air"],
        molar_volume=np.array([m.molar_mass_g_mol / (1000.0 * m.density_kg_l) for m in table]),
        molar_mass=np.array([m.molar_mass_g_mol for m in table]),
        density=np.array([m.density_kg_l for m in table]),
        heat_capacity=np.array([m.heat_capacity_j_mol_k for m in table]),
        bottle_share=np.ones(len(names)),
        bottle_rest=every,
        boiling_point=boiling,
        vaporization=np.array([m.vaporization_enthalpy_j_mol for m in table]),
        polarity=np.array([m.polarity or 0.0 for m in table]),
        shade=np.array([m.shade for m in table]),
        basis=basis,
        ambient_temperature=scenario.ambient_temperature_k,
        ambient_pressure=scenario.ambient_pressure_kpa,
    )
    layout = Layout(tuple(names), tuple(names[i] for i in solvents), tuple(names[i] for i in dissolved))
    tier_dimensions(scenario.physics)  # or an error that says which tiers there are
    build = getattr(importlib.import_module(TIERS[scenario.physics]), "build", None)
    if build is not None:  # the tier knows more of its materials
        layout, values = build(scenario, layout, values)
    return ChemistryTable(layout, values, scenario.physics, worlds, varying)


def element_matrix(scenario: Scenario) -> FloatArray:
    """[E, M] atoms of each element in each material, and the charge: reactions leave ``matrix @ amounts`` as it is."""
    table = list(scenario.materials.values())
    elements = sorted({element for material in table for element in material.composition})
    rows = [[material.composition.get(element, 0.0) for material in table] for element in elements]
    return np.array([*rows, [float(material.charge) for material in table]])
