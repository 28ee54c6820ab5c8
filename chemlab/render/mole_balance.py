"""Mole balance of an episode: amounts of all materials by location, at the start and after each experiment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels.arrays import FloatArray
from ..lab.engine import Laboratories
from ..record import Record
from .history import Move, RecordReplay

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


class _Account:
    """Totals of the material that has left the vessels so far, by location."""

    def __init__(self, labs: Laboratories) -> None:
        self._labs = labs
        count = len(labs.shelf.layout.materials)
        self._out = {place: np.zeros(count) for place in ("samples", "discarded", "lost")}
        self._waste = labs.shelf.waste[0].copy()
        self._last = np.zeros(count)
        """Contents of the vessel whose submission ended the episode; such a vessel is not removed from the shelf."""

    def add(self, move: Move) -> None:
        """Add the material that a move removed from the vessels."""
        labs = self._labs
        kind = move.manager[0] if move.manager else ""
        place = {"measure": "samples", "discard": "discarded"}.get(str(kind), "lost")
        self._out[place] += labs.shelf.waste[0] - self._waste
        self._waste = labs.shelf.waste[0].copy()
        if kind == "submit":
            vessel = labs.shelf.amounts[0, int(move.manager[1])]
            self._last = vessel.copy()  # zeros if the vessel was removed

    def inventory(self, label: str) -> Inventory:
        """Return the inventory at the current state of the laboratory."""
        labs = self._labs
        shelf, state = labs.shelf, labs.state
        amounts = {
            "submitted": state.delivered[0] + self._last,
            "vessels": shelf.amounts[0].sum(axis=0) - self._last,
            "stock": shelf.bottled()[0],
            **self._out,
        }
        return Inventory(label, int(state.ticks[0]), np.array([amounts[place] for place in PLACES]))


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
    account = _Account(labs)
    inventories = [account.inventory("start")]
    for move in replay.moves():
        account.add(move)
        if move.scores:
            inventories.append(account.inventory(", ".join(move.scores)))
    # The last inventory includes the actions after the last experiment, such as measurements and submissions.
    inventories.append(account.inventory("end" if replay.over else "so far"))
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
