"""Mole balance of an episode: amounts of all materials by location, at the start and after each experiment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels.arrays import FloatArray
from ..lab.engine import Laboratories
from ..record import Record
from .history import RecordReplay

PLACES = ("submitted", "vessels", "stock", "samples", "discarded", "lost")
"""Locations of material.

``vessels`` are all vessels on the shelf and at the benches. ``samples`` is material that instruments consumed. ``lost``
is material that was spilled or vented.
"""
_MOVED = 1e-9
"""Amount in mol up to which a change is a rounding error."""
_BALANCED = 1e-9
"""Largest relative error of a balance."""


@dataclass(frozen=True)
class Inventory:
    """Amounts of every material at every location at one time."""

    label: str
    tick: int
    amounts: FloatArray
    """[places, materials] mol"""


@dataclass(frozen=True)
class Group:
    """A conserved quantity: one element summed over all materials that reacted, or one material that did not react."""

    name: str
    element: bool
    weights: FloatArray
    """[materials]"""


@dataclass(frozen=True)
class Balance:
    """Inventories of an episode in chronological order."""

    materials: tuple[str, ...]
    inventories: tuple[Inventory, ...]
    groups: tuple[Group, ...]

    def amounts(self, group: Group) -> FloatArray:
        """Return the amounts of a group as [inventories, places, materials], in the group's unit."""
        return np.array([inventory.amounts * group.weights for inventory in self.inventories])

    def check(self) -> None:
        """Check that every group has the same total in every inventory.

        Raises:
            ValueError: a total changes; the message names the group and the difference.
        """
        for group in self.groups:
            totals = self.amounts(group).sum(axis=(1, 2))
            worst = float(np.abs(totals - totals[0]).max())
            if worst > _BALANCED * max(float(totals[0]), 1.0):
                raise ValueError(f"{group.name}: {totals[0]:.6g} mol at the start, off by {worst:.3g} mol later")


def mole_balance(record: Record, trust: bool = False) -> Balance:
    """Compute the mole balance at the start, after each experiment and at the end of a record.

    Args:
        record: a record, finished or not.
        trust: allow imports of code that the record names.

    Raises:
        RecordError: the record cannot be replayed here.
        ValueError: the amounts do not balance, which indicates a fault of the simulator.
    """
    replay = RecordReplay(record, trust)
    labs = replay.laboratories
    waste = labs.shelf.waste[0].copy()
    left = {place: np.zeros_like(waste) for place in ("samples", "discarded", "lost")}
    last = np.zeros_like(waste)  # in the vessel whose submission ended the episode, which stays on the shelf

    def inventory(label: str) -> Inventory:
        amounts = {
            "submitted": labs.state.delivered[0] + last,
            "vessels": labs.shelf.amounts[0].sum(axis=0) - last,
            "stock": labs.shelf.bottled()[0],
            **left,
        }
        return Inventory(label, int(labs.state.ticks[0]), np.array([amounts[place] for place in PLACES]))

    inventories = [inventory("start")]
    for move in replay.moves():
        kind = str(move.manager[0]) if move.manager else ""
        left[{"measure": "samples", "discard": "discarded"}.get(kind, "lost")] += labs.shelf.waste[0] - waste
        waste = labs.shelf.waste[0].copy()
        if kind == "submit":
            last = labs.shelf.amounts[0, int(move.manager[1])].copy()  # zeros if the vessel was removed
        if move.scores:
            inventories.append(inventory(", ".join(move.scores)))
    # The last inventory includes the actions after the last experiment, such as measurements and submissions.
    inventories.append(inventory("end" if replay.over else "so far"))
    balance = Balance(labs.shelf.layout.materials, tuple(inventories), tuple(_groups(labs, inventories)))
    balance.check()
    return balance


def _groups(labs: Laboratories, inventories: list[Inventory]) -> list[Group]:
    """Return the elements of all materials that reacted, then each material that was only moved."""
    totals = np.array([inventory.amounts.sum(axis=0) for inventory in inventories])
    reacted = np.abs(totals - totals[0]).max(axis=0) > _MOVED
    materials = list(labs.scenario.materials.values())
    groups = []
    for element in sorted({element for material in materials for element in material.composition}):
        atoms = np.array([material.composition.get(element, 0.0) for material in materials])
        if (atoms * reacted).any():
            groups.append(Group(element, True, atoms * reacted))
    stock = PLACES.index("stock")
    for m, name in enumerate(labs.shelf.layout.materials):
        elsewhere = max(float(np.delete(inventory.amounts[:, m], stock).max()) for inventory in inventories)
        if not reacted[m] and elsewhere > _MOVED:
            groups.append(Group(name, False, (np.arange(len(materials)) == m).astype(np.float64)))
    return groups
