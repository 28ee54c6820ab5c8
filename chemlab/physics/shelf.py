"""Vessels as arrays with the laboratory as the leading axis; a :class:`Vessel` is a named view of one row.

One vessel is one row of float64 numbers, whose columns :class:`~chemlab.physics.chemistry.Layout` names. Moving a
vessel, taking a snapshot and restoring one are therefore array copies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..config.scenario import Scenario
from ..kernels.arrays import Field, FloatArray, Handle, IntArray
from ..kernels.tables import Table
from .chemistry import (
    AMOUNTS,
    CAPACITY,
    CLOCK,
    CLOCK_WAS,
    PRESENT,
    TEMPERATURE,
    Chemistry,
    ChemistryTable,
    Layout,
    build_chemistry,
)

T_MIX = -float(np.log(2.0 * np.sqrt(2.0 * np.pi)))
"""Settling clock of a fully mixed vessel (PHYSICS section 2; there the variance of a layer is 2)."""
CLOCK_SETTLED = T_MIX + 6.0
"""Settling clock at which layers count as fully separated; the clock stops here."""


class ShelfArrays(NamedTuple):
    """Arrays of a shelf: N laboratories, R vessels in total, W values per vessel, M materials."""

    rows: Annotated[FloatArray, Field("R W")]
    """[R, W] vessel rows (mol, L, K; see :class:`~chemlab.physics.chemistry.Layout`); a laboratory's rows are
    adjacent
    """
    stock: Annotated[FloatArray, Field("N M")]
    """[N, M] mol in the bottles according to their labels"""
    waste: Annotated[FloatArray, Field("N M")]
    """[N, M] mol discarded, vented or spilled"""
    variant: Annotated[IntArray, Field("N")]
    """[N] index of the laboratory's world"""
    vessels: Annotated[int, Field("", kept=False)]
    """vessel positions of a laboratory"""


class Shelf:
    """Vessels, bottles and waste of N laboratories.

    Attributes:
        table: the arrays (:class:`ShelfArrays`).
        chemistry: chemistry of the contents.
    """

    def __init__(self, chemistry: ChemistryTable, laboratories: int, vessels: int) -> None:
        layout = chemistry.layout
        self.chemistry = chemistry
        sizes = {"N": laboratories, "R": laboratories * vessels, "W": layout.width, "M": len(layout.materials)}
        self.table = Table(Table.empty(ShelfArrays, **sizes).arrays._replace(vessels=vessels))

    @classmethod
    def empty(cls, scenario: Scenario, laboratories: int, vessels: int) -> Shelf:
        """Return a shelf without vessels, bottles and waste, with its own chemistry."""
        return cls(build_chemistry(scenario), laboratories, vessels)

    @property
    def layout(self) -> Layout:
        """Layout of a vessel row."""
        return self.chemistry.layout

    @property
    def handle(self) -> Handle:
        """Pointer table of the :class:`ShelfArrays` for kernels."""
        return self.table.handle

    @property
    def rows(self) -> FloatArray:
        """[R, W] vessel rows."""
        return self.table.arrays.rows

    @property
    def vessels(self) -> FloatArray:
        """[N, V, W] the same by laboratory, as a view."""
        return self.rows.reshape(len(self.stock), -1, self.rows.shape[1])

    @property
    def stock(self) -> FloatArray:
        """[N, M] mol in the bottles according to their labels."""
        return self.table.arrays.stock

    @property
    def waste(self) -> FloatArray:
        """[N, M] mol discarded, vented or spilled."""
        return self.table.arrays.waste

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return every array that changes, for snapshots."""
        return [self.vessels, *self.table.changing()[1:]]

    def chem(self, laboratory: int = 0) -> Handle:
        """Return the pointer table of the chemistry of one laboratory's world."""
        return self.chemistry.handles[int(self.table.arrays.variant[laboratory])]

    def known(self, laboratory: int = 0) -> Chemistry:
        """Return the chemistry of one laboratory's world, for reading."""
        return self.chemistry.world(int(self.table.arrays.variant[laboratory]))

    @property
    def amounts(self) -> FloatArray:
        """[N, V, M] mol of each material, as a view."""
        return self.vessels[..., AMOUNTS : AMOUNTS + len(self.layout.materials)]

    @property
    def dissolved(self) -> FloatArray:
        """[N, V, K, L] mol of each dissolvable material in each solvent, as a view."""
        shape = (*self.vessels.shape[:2], len(self.layout.dissolved), len(self.layout.solvents))
        return self.vessels[..., AMOUNTS + len(self.layout.materials) :].reshape(shape)

    def total(self) -> FloatArray:
        """Return [N, M] mol in vessels, bottles and waste together, which only reactions change."""
        return np.asarray(self.amounts.sum(axis=1) + self.bottled() + self.waste)

    def bottled(self) -> FloatArray:
        """Return [N, M] true mol in the bottles, independent of their labels."""
        share, rest, volume = (self.chemistry.parameters[f] for f in ("bottle_share", "bottle_rest", "molar_volume"))
        variant = self.table.arrays.variant
        share, rest = (own[variant if len(own) > 1 else 0 * variant] for own in (share, rest))
        other = (1.0 - share) * self.stock * volume[0] / volume[0][rest]
        found = share * self.stock
        np.add.at(found, (np.arange(len(found))[:, None], rest), other)
        return np.asarray(found)

    def vessel(self, laboratory: int, position: int) -> Vessel:
        """Return a named view of one vessel."""
        return Vessel(self, laboratory, position)

    def fill(self, laboratory: int, position: int, capacity_l: float, contents: dict[str, float]) -> Vessel:
        """Put a vessel with ``contents`` (mol) at ``position``, settled at ambient temperature.

        Dissolved amounts are not distributed yet; the next phase step on the vessel does that.
        """
        row = self.vessels[laboratory, position]
        row[:] = 0.0
        row[TEMPERATURE] = self.known(laboratory).ambient_temperature
        row[CAPACITY] = capacity_l
        # The distribution of solutes is integrated from the mixed state, where it is known.
        row[CLOCK], row[CLOCK_WAS], row[PRESENT] = CLOCK_SETTLED, T_MIX, 1.0
        for name, mol in contents.items():
            row[AMOUNTS + self.layout.index(name)] += mol
        return self.vessel(laboratory, position)


@dataclass(frozen=True)
class Vessel:
    """A vessel by name; reads and writes access the arrays."""

    shelf: Shelf
    laboratory: int
    position: int

    @property
    def row(self) -> FloatArray:
        """The vessel's values, as a view."""
        return np.asarray(self.shelf.vessels[self.laboratory, self.position])

    @property
    def present(self) -> bool:
        """True if there is a vessel."""
        return bool(self.row[PRESENT] > 0.0)

    @property
    def temperature_k(self) -> float:
        """Temperature of the contents, K."""
        return float(self.row[TEMPERATURE])

    @property
    def capacity_l(self) -> float:
        """Capacity in L."""
        return float(self.row[CAPACITY])

    @property
    def settling(self) -> float:
        """0 when fully mixed, 1 when the layers have separated."""
        return float((self.row[CLOCK] - T_MIX) / (CLOCK_SETTLED - T_MIX))

    @property
    def volume_l(self) -> float:
        """Volume of everything except air, L."""
        m = len(self.shelf.layout.materials)
        return float(self.row[AMOUNTS : AMOUNTS + m] @ self.shelf.known(self.laboratory).molar_volume)

    def amounts(self, at_least_mol: float = 0.0) -> dict[str, float]:
        """Return {material: mol} of all amounts above ``at_least_mol``."""
        values = self.row[AMOUNTS : AMOUNTS + len(self.shelf.layout.materials)]
        return {n: float(x) for n, x in zip(self.shelf.layout.materials, values, strict=True) if x > at_least_mol}

    def __str__(self) -> str:
        if not self.present:
            return "(no vessel)"
        parts = ", ".join(f"{mol:.3f} mol {name}" for name, mol in self.amounts(5e-4).items()) or "empty"
        return f"{self.volume_l:.3f} of {self.capacity_l:.2f} L at {self.temperature_k:.1f} K: {parts}"
