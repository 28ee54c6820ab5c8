"""Materials and reactions of a scenario as arrays: a fixed structure, and parameters that may differ between worlds.

The *structure* (roles of materials, stoichiometry) is shared by all laboratories. The *parameters* (boiling points,
rate constants, ...) have a leading axis of worlds; laboratory n uses row ``variant[n]``
(:class:`chemlab.physics.shelf.ShelfArrays`). A :class:`ChemistryTable` owns both and is built once for a scenario;
kernels see one world at a time as a :class:`Chemistry`.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from ..config.datafile import DataError
from ..config.scenario import PHYSICS_TIERS as TIERS
from ..config.scenario import Scenario
from ..kernels.arrays import Field, FloatArray, Handle, IntArray, addresses, declared, merged
from ..kernels.jit import COMPILED

# Columns of a vessel row; amounts and dissolved amounts follow (see Layout).
TEMPERATURE, CAPACITY, CLOCK, CLOCK_WAS, AIR, PRESENT, AMOUNTS = range(7)

ROLE_SOLVENT, ROLE_SOLUTE, ROLE_ION, ROLE_SOLID, ROLE_GAS = range(5)
_ROLES = {"solvent": ROLE_SOLVENT, "solute": ROLE_SOLUTE, "ion": ROLE_ION, "solid": ROLE_SOLID, "gas": ROLE_GAS}

WAVELENGTHS_NM: FloatArray = np.linspace(200.0, 800.0, 200)


class Structure(Field):
    """A field of the chemistry that all worlds share."""


class Parameter(Field):
    """A field of which every world has its own values."""


class Chemistry(NamedTuple):
    """Chemistry of one world as seen by kernels.

    M materials, L solvents, K dissolvable materials; R reactions over S of the materials.
    """

    laws: Annotated[IntArray, Structure("laws")]
    """[laws] addresses of the backend's code: see :mod:`chemlab.physics.backends`"""
    species: Annotated[IntArray, Structure("S")]
    """[S] material indices"""
    stoichiometry: Annotated[FloatArray, Structure("R S")]
    """[R, S] products minus reactants"""
    factors: Annotated[IntArray, Structure("R F")]
    """[R, F] species in the rate law, one entry per whole order, then -1"""
    changes: Annotated[IntArray, Structure("R C")]
    """[R, C] species that a reaction changes, then -1"""
    fractions: Annotated[FloatArray, Structure("R S")]
    """[R, S] fractional part of each order; [0, 0] if all orders are whole"""
    pre_exponential: Annotated[FloatArray, Parameter("R")]
    """[R] pre-exponential factor per time unit, (L/mol)^(order - 1)"""
    activation_energy: Annotated[FloatArray, Parameter("R")]
    """[R] J/mol"""
    role: Annotated[IntArray, Structure("M")]
    """[M] one of the ROLE constants"""
    solvents: Annotated[IntArray, Structure("L")]
    """[L] material index of each solvent"""
    dissolved: Annotated[IntArray, Structure("K")]
    """[K] material index of each dissolvable material (liquid solutes and ions)"""
    dissolved_at: Annotated[IntArray, Structure("M")]
    """[M] index of a material among the dissolvable ones, or -1"""
    volatile: Annotated[IntArray, Structure("V")]
    """Material indices of all liquids, lowest boiling point first."""
    salts: Annotated[IntArray, Structure("n 3")]
    """[n, 3] solid, cation, anion; rows with a common cation are adjacent"""
    violent: Annotated[FloatArray, Structure("n M")]
    """[n, M] stoichiometry of instantaneous reactions"""
    violent_event: Annotated[IntArray, Structure("n")]
    """[n] safety event of each, -1 for none"""
    air: Annotated[int, Structure("")]
    """Material index of air."""
    molar_volume: Annotated[FloatArray, Parameter("M")]
    """[M] molar volume in L/mol"""
    molar_mass: Annotated[FloatArray, Parameter("M")]
    """[M] molar mass in g/mol"""
    density: Annotated[FloatArray, Parameter("M")]
    """[M] density in kg/L"""
    heat_capacity: Annotated[FloatArray, Parameter("M")]
    """[M] heat capacity in J/mol/K"""
    bottle_share: Annotated[FloatArray, Parameter("M")]
    """[M] volume share of the labelled material in a bottle"""
    bottle_rest: Annotated[IntArray, Parameter("M")]
    """[M] material index of the rest of a bottle"""
    boiling_point: Annotated[FloatArray, Parameter("M")]
    """[M] boiling point in K"""
    vaporization: Annotated[FloatArray, Parameter("M")]
    """[M] heat of vaporization in J/mol"""
    polarity: Annotated[FloatArray, Parameter("M")]
    """[M] polarity, E_T^N"""
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
    """Layout of a vessel row."""

    materials: tuple[str, ...]
    solvents: tuple[str, ...]
    dissolved: tuple[str, ...]
    most_layers: int = 0
    """Maximum number of liquid layers; 0: the number of solvents, or liquids."""

    @property
    def width(self) -> int:
        """Number of values of a vessel."""
        return AMOUNTS + len(self.materials) + len(self.solvents) * len(self.dissolved)

    @property
    def fluid_columns(self) -> int:
        """Maximum number of columns of a layer profile: solids, layers, air."""
        return 2 + (self.most_layers or max(len(self.solvents), len(self.dissolved), 1))

    def index(self, material: str) -> int:
        """Return the column of ``material`` among the amounts."""
        return self.materials.index(material)


class ChemistryTable:
    """Chemistry of a scenario; owns its structure and the parameters of W worlds.

    Attributes:
        layout: layout of a vessel row.
        tier: physics backend (see :mod:`chemlab.physics.backends`).
        structure: arrays by field of :class:`Chemistry`, shared by all worlds.
        parameters: [W, ...] arrays by field, a row for each world; [1, ...] for fields that do not differ between
            worlds.
        worlds: number of worlds W. World 0 has the values of the data files.
        handles: pointer tables for kernels; ``handles[w]`` is the chemistry of world w.
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
        """Return the names of a parameter's axes in each world, as declared in :class:`Chemistry`."""
        return next(known.axes for known in declared(self._declaration) if known.name == field)

    def _make_handles(self) -> Handle:
        if not COMPILED:
            # Plain functions see the arrays themselves; their class states the backend.
            seen = type(self._declaration.__name__, (self._declaration,), {"BACKEND": self.tier})
            return [seen(*self.world(w)) for w in range(self.worlds)]
        backends: Any = importlib.import_module(f"{__package__}.backends")
        self.structure["laws"] = backends.law_addresses(self.tier, self._declaration)
        self._addresses = np.stack([addresses(self._row(w)) for w in range(self.worlds)])
        return self._addresses.ctypes.data + np.arange(self.worlds) * self._addresses.strides[0]

    def world(self, world: int = 0) -> Chemistry:
        """Return the chemistry of one world as views: kernels read written values."""
        numbers = {field.name for field in declared(self._declaration) if field.number}
        pairs = zip(declared(self._declaration), self._row(world), strict=True)
        made: Chemistry = self._declaration(*(a.item() if field.name in numbers else a for field, a in pairs))
        return made

    def __getstate__(self) -> dict[str, Any]:
        made = ("handles", "_addresses", "_declaration")
        kept = {name: value for name, value in vars(self).items() if name not in made}
        # A merged schema is rebuilt from its parts.
        return kept | {"_parts": getattr(self._declaration, "MERGED", (self._declaration,))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._declaration = merged(*state.pop("_parts"))
        vars(self).update(state)
        self.handles = self._make_handles()  # the addresses are those of the copy


def network_fields(
    species: IntArray,
    stoichiometry: FloatArray,
    orders: FloatArray,
    pre_exponential: FloatArray,
    activation_energy: FloatArray,
) -> dict[str, npt.NDArray[Any]]:
    """Return the fields of a :class:`Chemistry` that describe a reaction network.

    Args are the stoichiometry [R, S], orders [R, S] and Arrhenius constants [R].
    """
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
    """Return [n, names] products minus reactants of some reactions."""
    out = np.zeros((len(steps), len(names)))
    for row, step in zip(out, steps, strict=True):
        for name, number in step.reactants.items():
            row[names.index(name)] -= number
        for name, number in step.products.items():
            row[names.index(name)] += number
    return out


def _network(scenario: Scenario) -> dict[str, npt.NDArray[Any]]:
    """Return the scenario's reactions over their participating materials."""
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
    """Return [n] the safety event of each violent reaction, -1 for none."""
    kinds, found = scenario.safety_events, []
    for step in scenario.family.violent:
        first = scenario.materials[next(iter(step.reactants))]
        metal = first.role == "solid" and len(first.composition) == 1 and "water" in step.reactants
        event = step.event or ("metal_in_water_mol" if metal else "none")
        if event not in ("none", *kinds):
            raise DataError(
                f"{scenario.origin}: reactions {scenario.family.name!r}: violent.event: unknown safety event "
                f"{event!r}; choose from none, {', '.join(kinds)}, or declare your own under safety.events"
            )
        found.append(-1 if event == "none" else kinds.index(event))
    return np.array(found, dtype=np.int64)


def build_chemistry(scenario: Scenario, worlds: int = 1, varying: Collection[str] | None = None) -> ChemistryTable:
    """Build the chemistry of a scenario, with materials in the order of ``scenario.materials``.

    Every world has the values of the data files. ``varying`` are the fields in which worlds may differ later; default:
    all.
    """
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
            with np.errstate(under="ignore"):  # far from a peak, the absorption underflows to 0
                basis[i] += peak.height_l_mol * np.exp(-0.5 * offset**2)
    basis[basis < np.finfo(np.float64).tiny] = 0.0  # sums with denormal numbers are many times slower
    values = Chemistry(
        laws=np.zeros(0, dtype=np.int64),
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
    if scenario.physics not in TIERS:
        known = ", ".join(TIERS)
        raise DataError(f"physics: unknown backend {scenario.physics!r}; choose from {known} (registered in TIERS)")
    build = getattr(importlib.import_module(TIERS[scenario.physics]), "build", None)
    if build is not None:  # the backend has further fields
        layout, values = build(scenario, layout, values)
    return ChemistryTable(layout, values, scenario.physics, worlds, varying)


def element_matrix(scenario: Scenario) -> FloatArray:
    """Return [E, M] atoms of each element in each material, and the charge; reactions conserve ``matrix @ amounts``."""
    table = list(scenario.materials.values())
    elements = sorted({element for material in table for element in material.composition})
    rows = [[material.composition.get(element, 0.0) for material in table] for element in elements]
    return np.array([*rows, [float(material.charge) for material in table]])
