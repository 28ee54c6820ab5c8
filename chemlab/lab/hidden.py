"""Application of hidden parameters to laboratories: parameters of their chemistry, contents of their vessels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..config.datafile import DataError
from ..config.draws import (
    BOTTLE,
    DEVICE_QUANTITIES,
    ORDER_QUANTITIES,
    SPLITS,
    VESSEL_QUANTITIES,
    Draw,
    changed_limits,
    draw_limits,
)
from ..config.materials import COLDEST_K, HOTTEST_K
from ..config.reactions import equation
from ..config.scenario import Scenario
from ..kernels.arrays import FloatArray, Handle, IntArray, StreamArray
from ..kernels.jit import inner, kernel, opened
from ..kernels.rng import seed_streams
from ..physics.backends import work_size
from ..physics.chemistry import AMOUNTS, Chemistry, ChemistryTable, build_chemistry
from ..physics.shelf import Shelf, ShelfArrays
from ..roles.manager import rest_on_shelf
from .sampling import compile_draws, draw_worlds, given_values, named_values, next_numbers, positions, world_draws


@dataclass(frozen=True)
class NumberedWorld:
    """A world by number, as in a record.

    Attributes:
        number: number of the world, which includes its split (see :mod:`chemlab.config.draws`).
        given: values that replace drawn ones, by draw and target.
    """

    number: int
    given: Mapping[str, Any] | None = None


World = int | Mapping[str, Any] | NumberedWorld
"""Requested world of an episode: that of a seed, values by draw and target, or a recorded number."""

_SETTLED = frozenset({"molar_volume", "molar_mass", "density", "boiling_point", "bottle_share", "bottle_rest"})
"""Parameters that cannot be drawn: they depend on each other, order materials, or follow from bottle contents."""
_SIGNED = frozenset({"formation", "equilibrium_heat", "acid_heat", "acid_pk"})
"""Parameters that may have either sign."""

_APART = 0xD1B54A32D192ED03
"""Distance between the counters of two devices' streams: odd, and not a small multiple of a stream's increment."""


def _parameters(scenario: Scenario) -> list[str]:
    """Return the parameters of the chemistry that a scenario draws."""
    whats = [draw.what for draw in scenario.world.draws.values()]
    drawn_elsewhere = (*VESSEL_QUANTITIES, *DEVICE_QUANTITIES, *ORDER_QUANTITIES)
    bottles = any(_is_bottle(scenario, name) for draw in scenario.world.draws.values() for name in draw.of)
    found = [what for what in dict.fromkeys(whats) if what not in drawn_elsewhere]
    return found + ["bottle_share", "bottle_rest"] * bottles


def _is_bottle(scenario: Scenario, name: str) -> bool:
    """Return True if a target of a draw is a bottle."""
    return name == BOTTLE and name not in scenario.benches


def world_chemistry(scenario: Scenario, laboratories: int) -> ChemistryTable:
    """Return the chemistry of some laboratories.

    If the scenario draws any of it, world 0 is that of the data files, and n + 1 that of laboratory n.
    """
    varying = _parameters(scenario)
    return build_chemistry(scenario, laboratories + 1 if varying else 1, varying)


@dataclass(frozen=True)
class _Parameter:
    """A drawn parameter: the entries of a field, and the number of each ([T] each; None: a single number)."""

    field: str
    entries: IntArray | None
    columns: IntArray
    change: str


_CHANGES = ("factor", "offset", "value")
_POSITION, _MATERIAL, _INERT, _CHANGE, _QUANTITIES = range(5)
"""Columns of a table of drawn contents, with one row per material and vessel.

The last columns hold, for each of :data:`~chemlab.config.draws.VESSEL_QUANTITIES`, the column of its number, or -1.
"""
_IDENTITY, _AMOUNT, _TITRE = (_QUANTITIES + VESSEL_QUANTITIES.index(what) for what in ("identity", "amount", "titre"))


@inner
def _changed(given: float, number: float, change: int) -> float:
    """Apply a drawn number to a declared one; ``change`` is an index into :data:`_CHANGES`."""
    if change == 0:
        return given * number
    return given + number if change == 1 else number


@kernel
def _put_contents(
    members: IntArray, contents: IntArray, mol: FloatArray, values: FloatArray, shelf: Handle, chemistry: Handle
) -> None:
    """Replace the declared ``mol`` [C] by the drawn contents: ``contents`` [C, 7], ``values`` [N, K]."""
    arrays, volume = opened(ShelfArrays, shelf), opened(Chemistry, chemistry[0]).molar_volume
    for i in range(members.shape[0]):
        n = members[i]
        for c in range(contents.shape[0]):
            row, material = arrays.rows[n * arrays.vessels + contents[c, _POSITION]], contents[c, _MATERIAL]
            litres, share, real, inert = mol[c] * volume[material], 1.0, material, -1
            if contents[c, _IDENTITY] >= 0:
                real = int(values[n, contents[c, _IDENTITY]])
            if contents[c, _TITRE] >= 0:
                share, inert = values[n, contents[c, _TITRE]], contents[c, _INERT]
            if contents[c, _AMOUNT] >= 0:
                litres = _changed(mol[c], values[n, contents[c, _AMOUNT]], contents[c, _CHANGE]) * volume[material]
            row[AMOUNTS + material] -= mol[c]
            row[AMOUNTS + real] += share * litres / volume[real]
            if inert >= 0:
                row[AMOUNTS + inert] += (1.0 - share) * litres / volume[inert]


@kernel
def _change_terms(
    members: IntArray,
    quantity: IntArray,
    order: IntArray,
    column: IntArray,
    change: IntArray,
    values: FloatArray,
    terms: FloatArray,
) -> None:
    """Apply draws [D each], which are columns of ``values`` [N, K], to the ``terms`` [N, orders, quantities]."""
    for i in range(members.shape[0]):
        n = members[i]
        for d in range(order.shape[0]):
            o, q = order[d], quantity[d]
            terms[n, o, q] = _changed(terms[n, o, q], values[n, column[d]], change[d])


@kernel
def _rest_all(
    members: IntArray,
    slots: int,
    shelf: Handle,
    chemistry: Handle,
    waste: FloatArray,
    events: FloatArray,
    work: FloatArray,
) -> None:
    """Settle the first ``slots`` vessels of each laboratory in its own world."""
    arrays = opened(ShelfArrays, shelf)
    for i in range(members.shape[0]):
        n = members[i]
        for s in range(slots):
            rest_on_shelf(arrays.rows[n * arrays.vessels + s], chemistry[arrays.variant[n]], waste, events, work)


class Worlds:
    """The worlds of N laboratories.

    Args:
        scenario: the scenario with its declared draws.
        shelf: shelf with the chemistry (:func:`world_chemistry`) and vessels.
        split: split of worlds.

    Attributes:
        split: the split of worlds.
        active: whether anything is drawn.

    Raises:
        DataError: a drawn object does not exist, or a draw may have an impossible value.
        ValueError: the split is unknown.
    """

    def __init__(self, scenario: Scenario, shelf: Shelf) -> None:
        self.split = scenario.split
        self._spec, self._shelf = scenario.world, shelf
        self.active = scenario.hides
        materials = shelf.layout.materials
        try:
            self._variables = compile_draws(self._spec, materials)
        except ValueError as error:
            raise DataError(f"{scenario.origin}: {error}") from error
        n = len(shelf.stock)
        self.table = world_draws(n, self._variables)
        self._parameters: list[_Parameter] = []
        self._contents: dict[str, tuple[IntArray, FloatArray]] = {}
        """By bench ("": the shelf), the drawn contents of its vessels and the declared mol: see
        :func:`_put_contents`.
        """
        self._bottles: list[tuple[int, int, int]] = []
        """Labelled material, column of the number, and remainder: -1 if the number is the identity."""
        self._devices: dict[tuple[str, str], list[tuple[int, str]]] = {}
        """By quantity and bench or instrument: column of the number, and kind of change."""
        of = [name for name, draw in self._spec.draws.items() for _ in range(draw.variables)]
        names = {key: self._spec.told_to(key) for key in (*scenario.benches, "manager")}
        self._revealed = np.array([k for k, name in enumerate(of) if any(name in own for own in names.values())], int)
        """Columns that are revealed to any agent."""
        self._told: dict[str, IntArray] = {
            key: np.array([at for at, k in enumerate(self._revealed) if of[k] in own])
            for key, own in names.items()
            if own
        }
        """By bench or ``manager``, the entries of them that are revealed to it."""
        self._demand, self._ticks = scenario.demand, float(scenario.limits.ticks)
        terms: list[tuple[int, int, int, int]] = []
        column = 0
        for name, draw in self._spec.draws.items():
            where = f"{scenario.origin}: world.draws.{name}"
            columns = column + (
                np.arange(len(draw.of)) if draw.variables > 1 else np.zeros(len(draw.of), dtype=np.int64)
            )
            if draw.what in VESSEL_QUANTITIES:
                self._add_contents(scenario, draw, columns)
            elif draw.what in DEVICE_QUANTITIES:
                for target, own in zip(draw.of, columns.tolist(), strict=True):
                    self._devices.setdefault((draw.what, target), []).append((own, draw.change))
            elif draw.what in ORDER_QUANTITIES:
                which, change = ORDER_QUANTITIES.index(draw.what), _CHANGES.index(draw.change)
                terms += [(which, int(o[6:]), k, change) for o, k in zip(draw.of, columns.tolist(), strict=True)]
            else:
                self._parameters.append(self._parameter(scenario, draw, columns, column, where))
            column += draw.variables
        self._drawn_terms = np.ascontiguousarray(np.array(terms, dtype=np.int64).reshape(-1, 4).T)
        """Arguments of :func:`_change_terms`."""
        self._base_terms = np.array(
            [[self._default(getattr(order, what)) for what in ORDER_QUANTITIES] for order in self._demand.order]
        ).reshape(-1, len(ORDER_QUANTITIES))
        self._varying = _parameters(scenario)
        if self._varying:
            shelf.table.arrays.variant[:] = 1 + np.arange(n)
        self._scratch = np.zeros(len(materials)), np.zeros(len(scenario.safety_events))
        self._work = np.zeros(work_size(shelf.chemistry))

    # -- declarations -----------------------------------------------------------------------------------------

    def _parameter(self, scenario: Scenario, draw: Draw, columns: IntArray, first: int, where: str) -> _Parameter:
        chemistry = self._shelf.chemistry
        drawable = [
            field
            for field in chemistry.parameters
            if field not in _SETTLED and chemistry.axes(field)[:1] in ((), ("R",), ("M",))
        ]
        if draw.what not in drawable:
            known = ", ".join([*VESSEL_QUANTITIES, *DEVICE_QUANTITIES, *drawable])
            raise DataError(f"{where}.what: {draw.what!r:.100} cannot be drawn; choose from {known}")
        axis = chemistry.axes(draw.what)[:1]
        names = {
            (): [],
            ("R",): [equation(step) for step in scenario.family.reaction],
            ("M",): list(scenario.materials),
        }[axis]
        unknown = [name for name in draw.of if name not in names]
        if unknown or bool(draw.of) != bool(axis):
            of = f"some of {', '.join(names)}" if axis else "left out"
            raise DataError(f"{where}.of: must be {of}; given {', '.join(unknown or draw.of) or 'nothing'}")
        twice = [name for name in draw.of if names.count(name) > 1]
        if twice:
            raise DataError(
                f"{where}.of: several reactions are {twice[0]!r}, and a draw cannot say which one; make them one, "
                "or leave it out"
            )
        entries = np.array([names.index(name) for name in draw.of], dtype=np.int64)
        own = chemistry.parameters[draw.what][0]
        base = own[entries] if axis else own
        low, high = draw_limits(draw)
        ends = {"factor": (base * low, base * high), "offset": (base + low, base + high)}.get(draw.change, (low, high))
        # Values that are positive in the files must stay positive; heat capacities, for instance.
        least = np.broadcast_to(np.minimum(*ends), np.shape(base))
        if draw.what in _SIGNED:
            if not np.isfinite([*np.ravel(ends[0]), *np.ravel(ends[1])]).all():
                raise DataError(f"{where}: {draw.what} is unbounded; give low and high")
        elif not (np.isfinite(least).all() and ((least > 0.0) | ((np.asarray(base) == 0.0) & (least == 0.0))).all()):
            raise DataError(f"{where}: {draw.what} must stay above 0, and could become {np.min(least):g}; give low")
        if draw.what == "ambient_temperature" and not (np.min(ends) >= COLDEST_K and np.max(ends) <= HOTTEST_K):
            raise DataError(
                f"{where}: {draw.what} could become {np.min(ends):g} or {np.max(ends):g} K, and must stay from "
                f"{COLDEST_K:g} to {HOTTEST_K:g} K; give low and high"
            )
        return _Parameter(draw.what, entries if axis else None, columns if axis else np.array([first]), draw.change)

    def _add_contents(self, scenario: Scenario, draw: Draw, columns: IntArray) -> None:
        materials = self._shelf.layout.materials
        for name, column in zip(draw.of, columns.tolist(), strict=True):
            if _is_bottle(scenario, name):
                rest = -1 if draw.inert is None else materials.index(draw.inert)
                self._bottles.append((materials.index(str(draw.material)), column, rest))
                continue
            slot = name.startswith("slot_")
            position = int(name[5:]) if slot else 0
            start = scenario.shelf.vessel[position] if slot else scenario.benches[name].start
            material = str(draw.material)
            nothing = np.zeros((0, _QUANTITIES + len(VESSEL_QUANTITIES)), dtype=np.int64), np.zeros(0)
            table, mol = self._contents.get("" if slot else name, nothing)
            index = materials.index(material)
            found = np.flatnonzero((table[:, _POSITION] == position) & (table[:, _MATERIAL] == index))
            if not len(found):
                line = [position, index] + [-1] * (table.shape[1] - 2)
                table, mol = np.vstack([table, line]), np.append(mol, start.contents[material])
            line = table[found[0] if len(found) else -1]
            line[_QUANTITIES + VESSEL_QUANTITIES.index(draw.what)] = column
            if draw.what == "titre":
                line[_INERT] = -1 if draw.inert is None else materials.index(draw.inert)
            elif draw.what == "amount":
                line[_CHANGE] = _CHANGES.index(draw.change)
            self._contents["" if slot else name] = table, mol

    # -- drawing ----------------------------------------------------------------------------------------------

    def seed(self, member: int, seed: np.random.SeedSequence, streams: Sequence[StreamArray]) -> None:
        """Restart the stream of one laboratory's worlds, and the other ``streams`` of its episodes.

        In a private split, all follow from the salt, because agents may know the seed and could subtract the noise.
        """
        own, worlds = self.split.sequence(seed), self.table.arrays.stream
        if self.active and self.split.public == "private":
            seed_streams(own, [worlds, *streams], member)
            return
        seed_streams(seed, streams, member)
        if self.active:
            seed_streams(own, [worlds], member)

    def begin(self, members: IntArray, world: World | None = None) -> None:
        """Draw worlds for new episodes and set the parameters of the laboratories' chemistry.

        Args:
            members: [B] environment indices.
            world: common world of all, or some of its values, which replace drawn ones (a permutation may then have an
                option twice); None: each the next of its stream.

        Raises:
            ValueError: the scenario has no hidden parameters, or not the given ones; nothing has changed.
        """
        self.check(world)
        if not self.active:
            return
        drawn = self.table.arrays
        if isinstance(world, NumberedWorld):
            drawn.work[members, 0] = np.uint64(world.number)
            world = world.given
        elif isinstance(world, Mapping) or world is None:
            next_numbers(members, self.table.handle, self.split.number)
        else:
            drawn.work[members, 0] = np.uint64(self.split.world(int(world)))
        draw_worlds(members, self._variables.handle, self.table.handle, self.split.test)
        if isinstance(world, Mapping):
            given = given_values(self._spec, world, self._shelf.layout.materials)
            drawn.values[members] = np.where(np.isnan(given), drawn.values[members], given)
        self._set_parameters(members)

    def check(self, world: Any) -> None:
        """Check a requested world (None: none is).

        Raises:
            ValueError: the request is invalid; the message states the reason.
        """
        if world is None:
            return
        if not self.active:
            raise ValueError("world: this scenario has no hidden parameters")
        if isinstance(world, NumberedWorld):
            self._check_number(world.number)
            world = world.given or {}
        if isinstance(world, Mapping):
            given_values(self._spec, world, self._shelf.layout.materials)
        elif isinstance(world, bool) or not isinstance(world, (int, np.integer)) or world < 0:
            raise ValueError(f"world: must be a seed, or a table of values, given {world!r:.100}")

    def _check_number(self, number: Any) -> None:
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**64:
            raise ValueError(f"world: a number must be from 0 to 2**64 - 1, given {number!r:.100}")
        if number & 3 != self.split.number:
            of = [*SPLITS, "private"][number & 3]
            raise ValueError(f"world: number {number} is of split {of} and must be of {self.split.public}")

    def _set_parameters(self, members: IntArray) -> None:
        parameters, rows = self._shelf.chemistry.parameters, 1 + members
        for field in self._varying:
            parameters[field][rows] = parameters[field][0]
        for one in self._parameters:
            array = parameters[one.field]
            values = self.table.arrays.values[members][:, one.columns]
            values = values[:, 0] if one.entries is None else values
            values = values.reshape(values.shape + (1,) * (array.ndim - values.ndim))
            at: Any = rows if one.entries is None else (rows[:, None], one.entries)
            if one.change == "value":
                array[at] = values
            elif one.change == "factor":
                array[at] *= values
            else:
                array[at] += values
        for label, column, rest in self._bottles:
            own = self.table.arrays.values[members, column]
            parameters["bottle_share"][rows, label] = own if rest >= 0 else 0.0
            parameters["bottle_rest"][rows, label] = rest if rest >= 0 else own

    def fill(self, members: IntArray, bench: str = "") -> None:
        """Apply drawn contents to vessels that have just been filled.

        Args:
            members: [B] environment indices.
            bench: bench whose initial vessel was filled; None: the shelf.
        """
        if bench in self._contents:
            drawn, shelf = self._contents[bench], self._shelf
            _put_contents(members, *drawn, self.table.arrays.values, shelf.handle, shelf.chemistry.handles)

    def drawn(self, what: str, name: str, members: IntArray, values: FloatArray) -> FloatArray:
        """Return ``values`` [B, ...] of a bench or instrument, changed by its draws for ``members`` [B]."""
        for column, change in self._devices.get((what, name), ()):
            number = self.table.arrays.values[members, column].reshape((-1,) + (1,) * (values.ndim - 1))
            given = np.zeros_like(values) + number
            values = {"factor": values * number, "offset": values + number}.get(change, given)
        return values

    def device_streams(self, members: IntArray, device: int) -> StreamArray:
        """Return [B] initial random streams of a bench or instrument in the worlds of ``members`` [B].

        ``device`` is 0, 1, ... for benches and -2, -3, ... for instruments; -1 would be the world's own stream.
        """
        apart = np.uint64((_APART * (1 + device)) % 2**64)
        return np.asarray(self.table.arrays.number[members, 0] + apart)

    def _default(self, given: float | None) -> float:
        return self._ticks if given is None else float(given)

    def set_terms(self, members: IntArray, terms: FloatArray) -> None:
        """Write the order terms of ``members`` [B] into ``terms`` [N, orders, quantities].

        Quantities are in the order of :data:`~chemlab.config.draws.ORDER_QUANTITIES`; there are no orders if the
        scenario declares none.
        """
        terms[members] = self._base_terms
        if self._drawn_terms.size:
            quantity, order, column, change = self._drawn_terms
            _change_terms(members, quantity, order, column, change, self.table.arrays.values, terms)

    def told(self, members: IntArray) -> dict[str, FloatArray]:
        """Return [B, T] hidden parameters by the bench or manager to which they are revealed, see :meth:`positions`."""
        if not self._told:
            return {}
        found = positions(self._variables.arrays, self.table.arrays.values[members], self._revealed)
        return {key: found[:, columns] for key, columns in self._told.items()}

    def most_terms(self) -> FloatArray:
        """Return [quantities] the highest possible terms of any order; at least slightly above 0."""
        most = self._base_terms.max(axis=0, initial=0.0)
        for draw in self._spec.draws.values():
            if draw.what in ORDER_QUANTITIES:
                which = ORDER_QUANTITIES.index(draw.what)
                given = [self._base_terms[int(name[6:]), which] for name in draw.of]
                most[which] = max(most[which], *(changed_limits(draw, one)[1] for one in given))
        return np.asarray(np.maximum(most, 1e-9))

    def rest(self, members: IntArray, slots: int) -> None:
        """Settle the first ``slots`` vessels, each in its own world."""
        _rest_all(members, slots, self._shelf.handle, self._shelf.chemistry.handles, *self._scratch, self._work)

    # -- reading ----------------------------------------------------------------------------------------------

    def number(self, member: int) -> int:
        """Return the number of a laboratory's world."""
        return int(self.table.arrays.number[member, 0])

    def values(self, member: int) -> dict[str, Any]:
        """Return the drawn values of a laboratory by draw and target (see
        :func:`chemlab.lab.sampling.named_values`).
        """
        return named_values(self._spec, self.table.arrays.values[member], self._shelf.layout.materials)

    def positions(self, members: IntArray) -> FloatArray:
        """Return [B, K] the drawn values as positions in their distributions from 0 to 1, in the order of the
        declarations.
        """
        return positions(self._variables.arrays, self.table.arrays.values[members])

    @property
    def names(self) -> list[str]:
        """Names of the K numbers: draw, and target if there are several."""
        return [
            name if draw.variables == 1 else f"{name}.{target}"
            for name, draw in self._spec.draws.items()
            for target in ([name] if draw.variables == 1 else draw.of)
        ]

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return every array that changes, for snapshots."""
        if not self.active:
            return []
        parameters = self._shelf.chemistry.parameters
        varying = [parameters[field][1:] for field in self._varying]
        return [*self.table.changing(), *varying]
