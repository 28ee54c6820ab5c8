"""Vessels as arrays, the laboratory as the leading axis; a :class:`Vessel` is a named view of one row.

One vessel is one row of float64 numbers (:class:`Layout` names the columns), so moving a vessel, taking a
snapshot and restoring one are array copies. :class:`Chemistry` holds the scenario's constants the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .scenario import SAFETY_EVENTS, Scenario

__all__ = [
    "AIR",
    "AMOUNTS",
    "CAPACITY",
    "CLOCK",
    "CLOCK_SETTLED",
    "CLOCK_WAS",
    "PRESENT",
    "ROLE_GAS",
    "ROLE_ION",
    "ROLE_SOLID",
    "ROLE_SOLUTE",
    "ROLE_SOLVENT",
    "TEMPERATURE",
    "T_MIX",
    "WAVELENGTHS_NM",
    "Chemistry",
    "FloatArray",
    "IntArray",
    "Layout",
    "Network",
    "Shelf",
    "StreamArray",
    "Vessel",
    "build_chemistry",
    "build_network",
    "element_matrix",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
StreamArray = npt.NDArray[np.uint64]

# Columns of a vessel row; amounts and dissolved amounts follow (see Layout).
TEMPERATURE, CAPACITY, CLOCK, CLOCK_WAS, AIR, PRESENT, AMOUNTS = range(7)

ROLE_SOLVENT, ROLE_SOLUTE, ROLE_ION, ROLE_SOLID, ROLE_GAS = range(5)
_ROLES = {"solvent": ROLE_SOLVENT, "solute": ROLE_SOLUTE, "ion": ROLE_ION, "solid": ROLE_SOLID, "gas": ROLE_GAS}

T_MIX = -float(np.log(2.0 * np.sqrt(2.0 * np.pi)))
"""Settling clock of a fully mixed vessel (PHYSICS section 2; there the variance of a layer is 2)."""
CLOCK_SETTLED = T_MIX + 6.0
"""Settling clock at which layers count as fully separated; the clock stops here."""

WAVELENGTHS_NM: FloatArray = np.linspace(200.0, 800.0, 200)


class Chemistry(NamedTuple):
    """A scenario's material constants as arrays; M materials, L solvents, K dissolvable materials."""

    molar_volume: FloatArray
    """[M] L/mol"""
    density: FloatArray
    """[M] kg/L"""
    heat_capacity: FloatArray
    """[M] J/mol/K"""
    boiling_point: FloatArray
    """[M] K"""
    vaporization: FloatArray
    """[M] J/mol"""
    polarity: FloatArray
    """[M] E_T^N"""
    shade: FloatArray
    """[M] grey value in the layer camera"""
    role: IntArray
    """[M] one of the ROLE constants"""
    solvents: IntArray
    """[L] material index of each solvent"""
    dissolved: IntArray
    """[K] material index of each dissolvable material (liquid solutes and ions)"""
    dissolved_at: IntArray
    """[M] where a material stands among the dissolvable ones, -1 if it is none"""
    volatile: IntArray
    """Material indices of all liquids, lowest boiling point first."""
    salts: IntArray
    """[n, 3] solid, cation, anion; rows of one cation stand together"""
    violent: FloatArray
    """[n, M] stoichiometry of reactions that go to completion at once"""
    basis: FloatArray
    """[M, 200] absorption per mol/L"""
    air: int
    """Material index of air."""
    ambient_temperature: float
    """K"""
    ambient_pressure: float
    """kPa"""


class Network(NamedTuple):
    """A reaction network over S of the scenario's materials; R reactions."""

    species: IntArray
    """[S] material indices"""
    stoichiometry: FloatArray
    """[R, S] products minus reactants"""
    pre_exponential: FloatArray
    """[R] per time unit, (L/mol)^(order - 1)"""
    activation_energy: FloatArray
    """[R] J/mol"""
    factors: IntArray
    """[R, F] species whose concentrations multiply to the rate, one entry per whole order, then -1"""
    changes: IntArray
    """[R, C] species a reaction changes, then -1"""
    fractions: FloatArray
    """[R, S] what is left of each order above its whole part; [0, 0] where all orders are whole"""

    @classmethod
    def of(
        cls,
        species: IntArray,
        stoichiometry: FloatArray,
        orders: FloatArray,
        pre_exponential: FloatArray,
        activation_energy: FloatArray,
    ) -> Network:
        """A network from its stoichiometry [R, S], orders [R, S] and Arrhenius constants [R]."""
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
        return cls(species, stoichiometry, pre_exponential, activation_energy, factors, changes, fractions)


@dataclass(frozen=True)
class Layout:
    """Where things stand in a vessel row."""

    materials: tuple[str, ...]
    solvents: tuple[str, ...]
    dissolved: tuple[str, ...]

    @property
    def width(self) -> int:
        """Numbers a vessel takes."""
        return AMOUNTS + len(self.materials) + len(self.solvents) * len(self.dissolved)

    @property
    def fluid_columns(self) -> int:
        """Columns a layer profile can need: solids, the most layers there can be, air."""
        liquids = len(self.dissolved)
        return 2 + max(len(self.solvents), liquids, 1)

    def index(self, material: str) -> int:
        """Column of ``material`` among the amounts."""
        return self.materials.index(material)


def build_chemistry(scenario: Scenario) -> tuple[Layout, Chemistry]:
    """Arrays of the scenario's material constants, in the order of ``scenario.materials``."""
    names = tuple(scenario.materials)
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
    violent = np.zeros((len(scenario.family.violent), len(names)))
    for i, step in enumerate(scenario.family.violent):
        for name, number in step.reactants.items():
            violent[i, index[name]] -= number
        for name, number in step.products.items():
            violent[i, index[name]] += number
    basis = np.zeros((len(names), len(WAVELENGTHS_NM)))
    for i, material in enumerate(table):
        for peak in material.absorption:
            offset = (WAVELENGTHS_NM - peak.center_nm) / peak.width_nm
            basis[i] += peak.height_l_mol * np.exp(-0.5 * offset**2)
    chemistry = Chemistry(
        molar_volume=np.array([m.molar_mass_g_mol / (1000.0 * m.density_kg_l) for m in table]),
        density=np.array([m.density_kg_l for m in table]),
        heat_capacity=np.array([m.heat_capacity_j_mol_k for m in table]),
        boiling_point=boiling,
        vaporization=np.array([m.vaporization_enthalpy_j_mol for m in table]),
        polarity=np.array([m.polarity for m in table]),
        shade=np.array([m.shade for m in table]),
        role=role,
        solvents=solvents.astype(np.int64),
        dissolved=dissolved.astype(np.int64),
        dissolved_at=np.where(np.isin(every, dissolved), np.searchsorted(dissolved, every), -1),
        volatile=liquids[np.argsort(boiling[liquids], kind="stable")].astype(np.int64),
        salts=np.array(salts, dtype=np.int64).reshape(len(salts), 3),
        violent=violent,
        basis=basis,
        air=index["air"],
        ambient_temperature=scenario.ambient_temperature_k,
        ambient_pressure=scenario.ambient_pressure_kpa,
    )
    layout = Layout(names, tuple(names[i] for i in solvents), tuple(names[i] for i in dissolved))
    return layout, chemistry


def build_network(scenario: Scenario) -> Network:
    """Arrays of the scenario's reactions, over the materials that take part in one."""
    steps = scenario.family.reaction
    names = list(scenario.materials)
    taking_part = [name for name in names if any(name in step.reactants or name in step.products for step in steps)]
    stoichiometry = np.zeros((len(steps), len(taking_part)))
    orders = np.zeros_like(stoichiometry)
    for r, step in enumerate(steps):
        for name, number in step.products.items():
            stoichiometry[r, taking_part.index(name)] += number
        for name, number in step.reactants.items():
            stoichiometry[r, taking_part.index(name)] -= number
            orders[r, taking_part.index(name)] = step.orders[name]
    return Network.of(
        species=np.array([names.index(name) for name in taking_part], dtype=np.int64),
        stoichiometry=stoichiometry,
        orders=orders,
        pre_exponential=np.array([step.pre_exponential for step in steps]),
        activation_energy=np.array([step.activation_energy_j_mol for step in steps]),
    )


def element_matrix(scenario: Scenario) -> FloatArray:
    """[E, M] atoms of each element in each material, and the charge: reactions leave ``matrix @ amounts`` as it is."""
    table = list(scenario.materials.values())
    elements = sorted({element for material in table for element in material.composition})
    rows = [[material.composition.get(element, 0.0) for material in table] for element in elements]
    return np.array([*rows, [float(material.charge) for material in table]])


@dataclass
class Shelf:
    """Every vessel, bottle and waste can of N laboratories.

    Attributes:
        vessels: [N, V, W] vessel rows (mol, L, K; see :class:`Layout`).
        stock: [N, M] mol in the bottles.
        waste: [N, M] mol thrown away, vented or spilled.
    """

    layout: Layout
    chemistry: Chemistry
    vessels: FloatArray
    stock: FloatArray
    waste: FloatArray
    rows: FloatArray = field(init=False)
    """[N * V, W] the same vessels without the laboratory axis (a view): what kernels work on."""

    def __post_init__(self) -> None:
        self.rows = self.vessels.reshape(-1, self.vessels.shape[-1])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "rows"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.__post_init__()  # in a copy, too, the rows are the vessels and not a second set of them

    @classmethod
    def empty(cls, scenario: Scenario, laboratories: int, vessels: int) -> Shelf:
        """A shelf without any vessel, bottle or waste, for ``laboratories`` laboratories."""
        layout, chemistry = build_chemistry(scenario)
        m = len(layout.materials)
        return cls(
            layout,
            chemistry,
            np.zeros((laboratories, vessels, layout.width)),
            np.zeros((laboratories, m)),
            np.zeros((laboratories, m)),
        )

    @property
    def amounts(self) -> FloatArray:
        """[N, V, M] mol of each material (a view)."""
        return self.vessels[..., AMOUNTS : AMOUNTS + len(self.layout.materials)]

    @property
    def dissolved(self) -> FloatArray:
        """[N, V, K, L] mol of each dissolvable material in each solvent (a view)."""
        shape = (*self.vessels.shape[:2], len(self.layout.dissolved), len(self.layout.solvents))
        return self.vessels[..., AMOUNTS + len(self.layout.materials) :].reshape(shape)

    def total(self) -> FloatArray:
        """[N, M] mol in vessels, bottles and waste together: what no operation may change but by reaction."""
        return np.asarray(self.amounts.sum(axis=1) + self.stock + self.waste)

    def vessel(self, laboratory: int, position: int) -> Vessel:
        """A named view of one vessel, for people and tests."""
        return Vessel(self, laboratory, position)

    def fill(self, laboratory: int, position: int, capacity_l: float, contents: dict[str, float]) -> Vessel:
        """Put a vessel with ``contents`` (mol) at ``position``: at rest at ambient temperature, settled.

        Dissolved amounts are not distributed yet; the phase step of whoever uses the vessel does that.
        """
        row = self.vessels[laboratory, position]
        row[:] = 0.0
        row[TEMPERATURE] = self.chemistry.ambient_temperature
        row[CAPACITY] = capacity_l
        # The distribution of solutes is worked out from the mixed state on, where it is known.
        row[CLOCK], row[CLOCK_WAS], row[PRESENT] = CLOCK_SETTLED, T_MIX, 1.0
        for name, mol in contents.items():
            row[AMOUNTS + self.layout.index(name)] += mol
        return self.vessel(laboratory, position)

    def snapshot(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Copies of all arrays, for :meth:`restore`."""
        return self.vessels.copy(), self.stock.copy(), self.waste.copy()

    def restore(self, snapshot: tuple[FloatArray, FloatArray, FloatArray]) -> None:
        """Put back a :meth:`snapshot`."""
        for array, saved in zip((self.vessels, self.stock, self.waste), snapshot, strict=True):
            array[...] = saved


@dataclass(frozen=True)
class Vessel:
    """One vessel by name; reading and writing go straight to the arrays."""

    shelf: Shelf
    laboratory: int
    position: int

    @property
    def row(self) -> FloatArray:
        """The vessel's numbers (a view)."""
        return np.asarray(self.shelf.vessels[self.laboratory, self.position])

    @property
    def present(self) -> bool:
        """Whether a vessel stands here."""
        return bool(self.row[PRESENT] > 0.0)

    @property
    def temperature_k(self) -> float:
        """Temperature of the contents, K."""
        return float(self.row[TEMPERATURE])

    @property
    def capacity_l(self) -> float:
        """Volume the vessel holds, L."""
        return float(self.row[CAPACITY])

    @property
    def settling(self) -> float:
        """0 when fully mixed, 1 when the layers have separated."""
        return float((self.row[CLOCK] - T_MIX) / (CLOCK_SETTLED - T_MIX))

    @property
    def volume_l(self) -> float:
        """Volume of everything but air, L."""
        m = len(self.shelf.layout.materials)
        return float(self.row[AMOUNTS : AMOUNTS + m] @ self.shelf.chemistry.molar_volume)

    def amounts(self, at_least_mol: float = 0.0) -> dict[str, float]:
        """{material: mol} of everything above ``at_least_mol``."""
        values = self.row[AMOUNTS : AMOUNTS + len(self.shelf.layout.materials)]
        return {n: float(x) for n, x in zip(self.shelf.layout.materials, values, strict=True) if x > at_least_mol}

    def __str__(self) -> str:
        if not self.present:
            return "(no vessel)"
        parts = ", ".join(f"{mol:.3f} mol {name}" for name, mol in self.amounts(5e-4).items()) or "empty"
        return f"{self.volume_l:.3f} of {self.capacity_l:.2f} L at {self.temperature_k:.1f} K: {parts}"


assert len(SAFETY_EVENTS) == 5, "physics/events.py numbers the safety events"
