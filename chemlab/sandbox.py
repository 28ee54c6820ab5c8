"""Interactive physics: a flask for notebooks, with the same kernels as the laboratory.

A flask has no agents, turns or random numbers. Its operations call the kernels of :mod:`chemlab.physics.backends`.

>>> ether = Flask({"diethyl_ether": 4.0, "dodecane": 0.45}, capacity_l=2.0)
>>> receiver = ether.another(capacity_l=2.0)
>>> heated = ether.heat(150e3, receiver)
>>> round(ether.amounts["diethyl_ether"] + receiver.amounts["diethyl_ether"], 9)  # nothing is lost
4.0
"""

from __future__ import annotations

import collections
import difflib
import functools
import hashlib
import html
import importlib.util
import itertools
import math
import os.path
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
import numpy.typing as npt

from .config.catalogue import (
    FAMILY,
    REAGENTS,
    SALTS,
    acids_and_bases,
    catalogue_material,
    catalogue_pairs,
    closest,
    keep_material,
    keep_names,
    keep_pairs,
    key_of,
    matches,
    normalized,
    salts,
    spellings,
    user_folder,
    wrong_cas,
)
from .config.datafile import DataError, read_text, read_toml
from .config.datamodel import validated
from .config.loading import load_scenario
from .config.materials import COLDEST_K, HOTTEST_K, Material, litres_of, load_materials, shipped_materials
from .config.pairs import Pair, log_activity_coefficients, pair_table
from .config.reactions import PROTON, ReactionFamily
from .config.scenario import SAFETY_EVENTS, InstrumentSpec, Scenario
from .kernels.arrays import FloatArray, Handle
from .physics import backends, transfer
from .physics.chemistry import AIR, AMOUNTS, CAPACITY, CLOCK, TEMPERATURE, ChemistryTable, build_chemistry
from .physics.constants import FIRST_PHASE, TRACE_MOL
from .physics.events import SPILL
from .physics.shelf import CLOCK_SETTLED, T_MIX, Shelf, Vessel
from .physics.stratification import profile
from .physics.surroundings import Surroundings
from .roles.instrument_table import InstrumentTable

if TYPE_CHECKING:
    from .render.scene import Scene

_PIXELS = 4000
"""Number of height steps when a flask is drained; a real separating funnel is not more precise."""
_MOST_PARTS = 10_000
"""Maximum number of time steps of one :meth:`Flask.wait`."""
_MOST_JOULES = 1e9
"""Maximum heat of one operation in J; up to this amount the heat balance is exact to 1e-7 J."""
_RTOL, _ATOL = 1e-6, 1e-9
"""Error tolerances of reactions: relative, and in mol/L."""
_SHOWN_MOL = 1e-6
_NEUTRAL = 1e-9
"""Maximum net charge of neutral contents, as a share of all charges."""
_SALT = re.compile(
    r"(?:Li|Na|K|Rb|Cs|Mg|Ca|Sr|Ba|Al|Fe|Cu|Zn|Ag|Mn|Ni|Co|NH4)(?:[A-Z][a-z]?|[\d()])+"
    r"|(?:lithium|sodium|potassium|rubidium|caesium|cesium|magnesium|calcium|strontium|barium|alumini?um|iron|ferrous|"
    r"ferric|copper|cupric|cuprous|zinc|silver|manganese|nickel|cobalt|ammonium)(?:\([iv]+\))?[ _][a-z ]+"
)
"""Formulas and names of salts of metals and of ammonium."""
_ACID_OR_BASE = re.compile(
    r"acid$|amine$|aniline|idine$|morpholine|(phen|naphth)ol$|cresol|vanillin|carbonate ion", re.IGNORECASE
)
"""Names of acids and bases: carboxylic acids, phenols, amines, carbonate ions."""
EVERYDAY = "everyday"
"""Default of ``reactions``: salts dissolve and acids ionize in water; nothing else reacts."""
_MOST_ROUNDS, _CLAUSIUS_K = 200, 4500.0
"""Dew point: maximum number of iterations; heat of vaporization over the gas constant in K, which sets their step."""
_MOST_SETTLINGS, _SETTLED_MOL, _WARMED_K = 500, 1e-7, 0.01
"""Acids and bases: maximum number of times that they settle, the change in mol below which they are settled, and the
change of temperature in K above which the contents may boil.
"""
_LONGEST_HISTORY = 10_000
"""Number of operations that a flask's history keeps."""


class SpillWarning(UserWarning):
    """A vessel overflowed; the lost material is in the flask's ``waste``."""


class BoilingWarning(UserWarning):
    """A thermostat holds a closed flask at a temperature at which its contents would boil in an open one."""


class SaltWarning(UserWarning):
    """A salt stays solid in water because the reaction file has no ``[[salt]]`` entry for it."""


class IonizationWarning(UserWarning):
    """The measured pH ignores an acid or a base that no ``[[acid]]`` entry names: it does not ionize."""


class Heated(NamedTuple):
    """Result of a heating step, J."""

    taken_j: float
    """heat absorbed by the flask; less than offered if the flask is empty or reaches the mantle's temperature"""
    condensed_j: float
    """heat removed by the condenser"""


class Amounts(dict[str, float]):
    """Amounts in mol by material; other names of a material are accepted: ``amounts["DCM"]``."""

    def __missing__(self, name: str) -> float:
        if (key := self._key(name)) == name:
            raise KeyError(f"{name!r} is not in the flask; choose from {', '.join(self)}")
        return self[key]

    def __contains__(self, name: object) -> bool:
        return super().__contains__(self._key(str(name)))

    def get(self, name: str, default: Any = None, /) -> Any:
        """Return the amount of a material, or ``default``."""
        return super().get(self._key(name), default)

    def _key(self, name: str) -> str:
        """Return the key of a material; an unknown or ambiguous name is returned as it is."""
        found = [name] if name in self.keys() else [key for key in matches(name) if key in self.keys()]
        return found[0] if len(found) == 1 else name


class Moment(NamedTuple):
    """State of a flask after an operation."""

    operation: str
    seconds: float
    """total time in s for which the flask has stood or reacted"""
    joules: float
    """total heat in J supplied by ``heat`` minus heat removed by ``cool``; thermostats and jackets are not counted"""
    temperature_k: float
    volume_l: float
    amounts: Mapping[str, float]
    """mol by material"""
    head_temperature_k: float | None = None
    """temperature in K of the vapour at the still head; None if nothing distilled"""
    distillate: Mapping[str, float] = {}
    """mol by material that this operation distilled"""
    solids: Mapping[str, float] = {}
    """mol by material of undissolved solids: crystals, salts, metals"""


@dataclass(frozen=True)
class Layer:
    """One layer of a flask."""

    name: str
    """``solids``, ``aqueous``, ``organic``; with the backend ``paper`` the solvent's name"""
    volume_l: float
    """volume in L, including solutes"""
    share: float
    """share of the volume of all layers"""
    contents: Mapping[str, float]
    """mol by material"""

    def __str__(self) -> str:
        return f"{self.name} {self.volume_l:.3f} L: {_listed(self.contents)}"


@dataclass(frozen=True)
class Measurement:
    """Reading of an instrument, without noise; no sample is consumed."""

    values: FloatArray
    """[size] in ``unit``"""
    unit: str
    labels: tuple[str, ...]
    """[size] meaning of each value, for chromatographs; empty for other instruments"""
    words: str
    """description of the reading"""

    def __str__(self) -> str:
        return self.words

    def __float__(self) -> float:
        """Return the value of a reading that has only one.

        Raises:
            TypeError: there are several values.
        """
        if len(self.values) != 1:
            raise TypeError(f"there are {len(self.values)} values; use .values")
        return float(self.values[0])


class _Setting(NamedTuple):
    """Settings that flasks must share to exchange material."""

    physics: str
    reactions: str
    material_files: tuple[str, ...]
    pair_files: tuple[str, ...]
    room_k: float
    room_kpa: float
    content: str
    """Digest of the files' content when the flask was made; it distinguishes versions of an edited file."""

    def read(self) -> str:
        """Return the digest of the files' current content.

        Raises:
            DataError: a file cannot be read.
        """
        files = [Path(self.reactions)] if self.reactions.endswith(".toml") else []
        for path in map(Path, self.material_files):
            files += sorted(path.glob("*.toml")) if path.is_dir() else [path]
        digest = hashlib.sha256()
        for file in [*files, *map(Path, self.pair_files)]:
            text = read_text(file)
            digest.update(f"{file}\0{len(text)}\0{text}".encode())
        return digest.hexdigest()


class _Chemistry(NamedTuple):
    """Chemistry of some materials and of their reaction products."""

    scenario: Scenario
    table: ChemistryTable


def _listed(amounts: Mapping[str, float]) -> str:
    return ", ".join(f"{mol:.4g} mol {name}" for name, mol in amounts.items()) or "nothing"


@functools.lru_cache(maxsize=64)
def _build_chemistry(setting: _Setting, names: frozenset[str]) -> _Chemistry:
    """Build the chemistry of a laboratory with one vessel that can contain ``names``.

    Raises:
        DataError: data that the backend needs is missing, or a file was edited since the setting was made.
    """
    if setting.read() != setting.content:
        raise DataError(
            "flask: a file of its materials, pairs or reactions was edited after this flask was made; make a new flask"
        )
    listed = sorted(names) or ["water"]
    loaded = _materials(setting.material_files, setting.content)
    used = {*listed, *_reaction_materials(setting.reactions)}
    found = [known for name in sorted(used) if name not in loaded and (known := catalogue_material(name))]
    files, reactions = {path for path, _ in found}, setting.reactions
    if reactions == EVERYDAY:
        # Acids and the catalogue's salts need materials beyond the contents; these are loaded only if required.
        ionic = SALTS in files or ("water" in names and not acids_and_bases().isdisjoint(names))
        ionic = ionic and setting.physics == "real"
        reactions = str(FAMILY) if ionic else "sodium_salts"
        files |= {SALTS} if ionic else set()
    values = {
        "name": "flask",
        "title": "A flask",
        "summary": "",
        "physics": setting.physics,
        "reactions": reactions,
        "material_files": [*setting.material_files, *sorted(map(str, files))],
        **({"pair_files": list(setting.pair_files)} if setting.pair_files else {}),
        "goals": listed[:1],
        "lab_goals": listed[:1],
        "theoretical_maximum_mol": {listed[0]: 1.0},
        "ambient_temperature_k": setting.room_k,
        "ambient_pressure_kpa": setting.room_kpa,
        "shelf": {"slots": 1, "vessel": [{"capacity_l": 1.0, "contents": dict.fromkeys(listed, 0.0)}]},
        "benches": {"none": {"kind": "extraction", "step_limit": 1}},
        "limits": {"manager_actions": 1, "ticks": 1},
    }
    try:
        scenario = load_scenario(values)
        scenario._origin = "flask"
        if setting.physics == "real":
            scenario._pairs |= _missing_pairs(scenario, set(load_materials(map(Path, setting.material_files))))
        return _Chemistry(scenario, build_chemistry(scenario))
    except DataError as error:
        raise DataError(str(error).replace("(scenario given as a mapping)", "flask")) from error


def _reaction_materials(reactions: str) -> set[str]:
    """Return the materials that a reaction file names; an empty set for a bundled family.

    Raises:
        DataError: the file is invalid.
    """
    if not reactions.endswith(".toml"):
        return set()
    return validated(ReactionFamily, read_toml(Path(reactions)), reactions).materials()


def _missing_pairs(scenario: Scenario, excluded: set[str]) -> dict[frozenset[str], Pair]:
    """Return activity coefficients for pairs of molecules that a scenario has none for, except ``excluded`` materials.

    They are read from the catalogue. Other pairs, with materials that were added on this machine, are fitted on first
    use and saved.

    Raises:
        ImportError: a pair has to be fitted, and the extra ``chem`` is not installed.
        OSError: the user's folder cannot be written to.
    """
    molecules = {name for name, m in scenario.materials.items() if m.role in ("solvent", "solute")} - excluded
    missing = {frozenset(two) for two in itertools.combinations(molecules, 2)} - set(scenario.pairs)
    found = catalogue_pairs(missing) if missing else {}
    unfitted = sorted(tuple(sorted(two)) for two in missing - set(found))
    if unfitted:
        from .openchem.activity import quick_pairs

        rows = quick_pairs(cast("list[tuple[str, str]]", unfitted), scenario.materials)
        keep_pairs(rows)
        found |= {frozenset((row.one, row.other)): row.pair() for row in rows}
    return found


def _dew_point(distillate: Mapping[str, float], chemistry: _Chemistry, guess: float) -> float:
    """Return the temperature in K at which a vapour begins to condense at the room's pressure, without acid dimers."""
    known = chemistry.scenario.materials
    names = [name for name, mol in distillate.items() if mol > 0.0 and known[name].real]
    curves = [real.vapor_pressure for name in names if (real := known[name].real)]
    y = np.array([distillate[name] for name in names])
    y, x, kpa = y / y.sum(), y / y.sum(), float(chemistry.table.world().ambient_pressure)
    pairs, temperature = pair_table(names, chemistry.scenario.pairs), guess
    for _ in range(_MOST_ROUNDS):
        pure = np.array([float(curve.pascal(temperature)) / 1000.0 if curve else 1e-9 for curve in curves])
        ratio = pure * np.exp(log_activity_coefficients(x, pairs.tau(temperature), pairs.alpha)) / kpa
        liquid = y / ratio
        step = math.log(float(liquid.sum())) * temperature**2 / _CLAUSIUS_K
        x, temperature = 0.5 * (x + liquid / liquid.sum()), temperature + max(min(step, 20.0), -20.0)
        if abs(step) < 1e-3 and float(np.abs(x - liquid / liquid.sum()).max()) < 1e-4:
            break
    return temperature


def _number(name: str, value: Any, low: float, high: float = math.inf) -> float:
    """Return ``value`` as a number within bounds.

    Raises:
        ValueError: it is not a number, or out of bounds.
    """
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: must be a number, given {value!r}") from error
    if not low <= number <= high or number == math.inf:
        most = "" if high == math.inf else f" and at most {high:g}"
        raise ValueError(f"{name}: must be a finite number of at least {low:g}{most}, given {value!r}")
    return number


P = ParamSpec("P")
R = TypeVar("R")


def _all_or_nothing(operation: Callable[Concatenate[Flask, P], R]) -> Callable[Concatenate[Flask, P], R]:
    """Restore the flasks if an operation fails or is interrupted; otherwise append it to their histories.

    No material is lost or duplicated in either case.
    """

    @functools.wraps(operation)
    def whole(self: Flask, *args: P.args, **kwargs: P.kwargs) -> R:
        flasks = [self, *(other for other in (*args, *kwargs.values()) if isinstance(other, Flask))]
        saved = [(dict(vars(flask)), [array.copy() for array in flask._state()]) for flask in flasks]
        try:
            result = operation(self, *args, **kwargs)
        except BaseException:
            for flask, (attributes, arrays) in zip(flasks, saved, strict=True):
                vars(flask).update(attributes)
                for array, before in zip(flask._state(), arrays, strict=True):
                    array[:] = before
            raise
        for flask in flasks:
            flask._append_moment(operation.__name__)
        return result

    return cast("Callable[Concatenate[Flask, P], R]", whole)


def _warn(message: str, category: type[Warning]) -> None:
    """Issue a warning at the line outside this module that called the operation."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals is globals():
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def _mapped(contents: Mapping[str, float] | None) -> dict[str, float]:
    """Return contents as a dict; None stands for an empty flask."""
    if contents is None or isinstance(contents, Mapping):
        return dict(contents or {})
    raise ValueError(f'contents must be a mapping such as {{"water": 1.0}}, given {contents!r:.100}')


class Flask:
    """An open flask in a room.

    Materials are loaded on first use, together with the products of their reactions. The layers of a new flask are
    settled and at equilibrium. Additions stir the contents partially; :meth:`mix` shakes them, which brings the layers
    to equilibrium. Crystals of molecules dissolve and grow in time (:meth:`wait`); salts dissolve and precipitate at
    once. All amounts are in mol, volumes in L, temperatures in K, heats in J.

    Args:
        contents: mol by material. Names, formulas, CAS numbers and structures (SMILES) are accepted: ``acetone``,
            ``DCM``, ``CCO``, ``67-64-1``, ``NaOH``. :meth:`known` lists the names, :meth:`material` adds materials.
            Strong acids become ions and need water.
        physics: physics backend: ``real`` or ``paper``.
        capacity_l: capacity in L; the excess overflows.
        temperature_k: temperature of the contents, molten above their melting points; default: the room's.
        reactions: possible reactions: the name of a bundled family or the path of a reaction file. By default, salts
            dissolve and acids ionize in water, and nothing else reacts. A family replaces this default: only the salts
            and acids that it lists dissolve and ionize. A reaction file may use materials of the catalogue.
        material_files: files with your own materials.
        pair_files: files with activity coefficients of your own pairs of liquids (``real``).
        room_k, room_kpa: temperature and pressure of the surroundings.

    Files are read when a flask is made. After an edit, new flasks have the new chemistry. Old flasks keep theirs and
    cannot exchange material with new ones.

    Raises:
        DataError: a material is unknown, or lacks data that the backend needs.
        ValueError: an amount or another number is out of bounds, the contents do not fit or are charged.
    """

    def __init__(
        self,
        contents: Mapping[str, float] | None = None,
        *,
        physics: str = "real",
        capacity_l: float = 1.0,
        temperature_k: float | None = None,
        reactions: str | os.PathLike[str] = EVERYDAY,
        material_files: Iterable[str | os.PathLike[str]] = (),
        pair_files: Iterable[str | os.PathLike[str]] = (),
        room_k: float = 298.15,
        room_kpa: float = 101.325,
    ) -> None:
        lists = [[files] if isinstance(files, (str, os.PathLike)) else files for files in (material_files, pair_files)]
        paths = [tuple(os.path.abspath(file) for file in files) for files in lists]
        family = os.fspath(reactions)
        family = os.path.abspath(family) if family.endswith(".toml") else family
        room = _number("room_k", room_k, 200.0, 350.0), _number("room_kpa", room_kpa, 1.0, 1000.0)
        setting = _Setting(physics, family, paths[0], paths[1], *room, "")
        self._fill(setting._replace(content=setting.read()), _mapped(contents), capacity_l, temperature_k)

    def _fill(
        self, setting: _Setting, contents: dict[str, float], capacity_l: float, temperature_k: float | None
    ) -> None:
        self._setting = setting
        capacity_l = _number("capacity_l", capacity_l, 1e-6, 100.0)
        contents = self._resolve_contents(contents)
        materials = {name: self._material(name) for name in contents}
        filled = litres_of(contents, materials)
        if filled > capacity_l:
            raise ValueError(f"contents: {filled:.4g} L do not fit in capacity_l = {capacity_l:g}")
        charges = [mol * materials[name].charge for name, mol in contents.items()]
        if abs(sum(charges)) > _NEUTRAL * sum(map(abs, charges)):
            raise ValueError(f"contents: have a charge of {sum(charges):+.4g} mol; add the ions that balance it")
        self._seconds, self._joules = 0.0, 0.0
        self._head: tuple[float | None, dict[str, float]] = (None, {})
        self._history: collections.deque[Moment] = collections.deque(maxlen=_LONGEST_HISTORY)
        self._names = frozenset(contents)
        self._chemistry = _build_chemistry(setting, self._names)
        self._insoluble: frozenset[str] = frozenset()
        self._warn_of_salts()
        self._shelf = Shelf(self._chemistry.table, 1, 1)
        self._work = np.zeros(backends.work_size(self._chemistry.table))
        self._events, self._spilled = np.zeros(len(SAFETY_EVENTS)), 0.0
        self._shelf.fill(0, 0, capacity_l, contents)
        if temperature_k is not None:
            self._row[TEMPERATURE] = _number("temperature_k", temperature_k, 150.0, 900.0)
            self._melt(contents)
        self._row[CLOCK] = T_MIX  # shaken to equilibrium, then settled
        self._equilibrate()
        self.settle()

    # -- contents -----------------------------------------------------------------------------------------------------

    @property
    def amounts(self) -> dict[str, float]:
        """Amounts in mol by material; 0 for reaction products and materials that are used up.

        Other names of a material are accepted, such as ``flask.amounts["DCM"]``.
        """
        return Amounts(self._vessel.amounts(-1.0))

    @property
    def history(self) -> tuple[Moment, ...]:
        """State of the flask after each of the last 10,000 operations, oldest first."""
        return tuple(self._history)

    @property
    def temperature_k(self) -> float:
        """Temperature of the contents in K."""
        return self._vessel.temperature_k

    @property
    def pressure_kpa(self) -> float:
        """Pressure above the contents in kPa; it equals the room's pressure, because the flask is open."""
        return float(self._chemistry.table.world().ambient_pressure)

    @property
    def vapor_pressure_kpa(self) -> float:
        """Vapour pressure of the liquids in kPa; they boil when it reaches :attr:`pressure_kpa`."""
        return float(backends.vapor_pressure(self._row, self._chem))

    @property
    def capacity_l(self) -> float:
        """Capacity in L."""
        return self._vessel.capacity_l

    @property
    def volume_l(self) -> float:
        """Volume of everything except gases in L."""
        return self._vessel.volume_l

    @property
    def mass_kg(self) -> float:
        """Mass of the contents in kg."""
        return float(self._vessel.row[self._columns] @ self._chemistry.table.world().molar_mass) / 1000.0

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Layers after settling: solids, then liquids, from the bottom up."""
        layout, air = self._shelf.layout, self._chemistry.table.world().air
        codes, volumes = np.zeros(layout.fluid_columns + 1, dtype=np.int64), np.zeros(layout.fluid_columns)
        count = backends.find_layers(self._row, self._chem, codes, volumes)
        layers = []
        for code, litres in zip(codes[1 : 1 + count].tolist(), volumes.tolist(), strict=False):
            if code == air or litres <= 0.0:
                continue
            rest, out = self._row.copy(), np.zeros_like(self._row)
            backends.drain_layer(rest, out, code, 1.0, self._chem)
            amounts = zip(layout.materials, out[self._columns].tolist(), strict=True)
            name = layout.materials[code] if code >= 0 else "solids"
            if code <= FIRST_PHASE:
                name = layout.solvents[FIRST_PHASE - code]
            if contents := {key: mol for key, mol in amounts if mol > TRACE_MOL}:
                layers.append(Layer(name, litres, litres / max(self.volume_l, litres), contents))
        return tuple(layers)

    @property
    def waste(self) -> dict[str, float]:
        """Material that the flask has lost, in mol: spilled, evaporated or vented."""
        lost = self._shelf.waste[0].tolist()
        return {name: mol for name, mol in zip(self._shelf.layout.materials, lost, strict=True) if mol > 0.0}

    @property
    def events(self) -> dict[str, float]:
        """Safety events so far, by kind (:data:`chemlab.config.scenario.SAFETY_EVENTS`)."""
        return {kind: float(x) for kind, x in zip(SAFETY_EVENTS, self._events, strict=True) if x > 0.0}

    # -- operations ---------------------------------------------------------------------------------------------------

    def another(self, contents: Mapping[str, float] | None = None, capacity_l: float | None = None) -> Flask:
        """Return another flask in the same room, with the same physics, reactions and files.

        Args:
            contents: mol by material.
            capacity_l: capacity in L; default: that of this flask.
        """
        other = Flask.__new__(Flask)
        other._fill(self._setting, _mapped(contents), self.capacity_l if capacity_l is None else capacity_l, None)
        return other

    def copy(self) -> Flask:
        """Return an independent copy of the flask."""
        other = self.another()
        self._connect(other)
        other._row[:] = self._row
        other._shelf.waste[:] = self._shelf.waste
        other._events[:], other._spilled = self._events, self._spilled
        other._seconds, other._joules, other._history = self._seconds, self._joules, self._history.copy()
        return other

    __copy__ = copy

    @_all_or_nothing
    def add(self, name: str, mol: float, temperature_k: float | None = None) -> None:
        """Add ``mol`` of a pure material at room temperature or ``temperature_k``; the excess spills.

        Raises:
            DataError: the material is unknown, or lacks data that the backend needs.
            ValueError: an amount or a temperature is out of bounds, or the material is an ion.
        """
        key = self._resolve(name)
        mol = _number(f"add: {name}", mol, 0.0, 1e4)
        kelvin = self._setting.room_k if temperature_k is None else temperature_k
        kelvin = _number("temperature_k", kelvin, 150.0, 900.0)
        if key in REAGENTS:  # a strong acid, added as its ions
            if self.amounts.get("water", 0.0) <= 0.0:
                raise ValueError(f"add: {key!r} is supported only as its ions in water; add water first")
            self._pour_in({part: mol * number for part, number in REAGENTS[key].items()}, kelvin)
        elif self._material(key).charge:
            raise ValueError(
                f"add: {name!r} is an ion; pour a neutral mixture: flask.another({{{name!r}: ..., ...}}).pour(flask, 1)"
            )
        elif self._is_molten(key, kelvin):
            self._pour_in({key: mol}, kelvin)
        else:
            self._extend(self._names | {key})
            material = self._shelf.layout.index(key)
            transfer.add(self._row, material, mol, kelvin, self._chem, self._shelf.waste[0], self._events)
        self._equilibrate()

    @_all_or_nothing
    def heat(
        self,
        joules: float,
        receiver: Flask | None = None,
        stages: int = 1,
        reflux: float = 1.0,
        hottest_k: float = 800.0,
    ) -> Heated:
        """Heat the flask; vapour is condensed to room temperature and collected in ``receiver``.

        Args:
            joules: offered heat in J.
            receiver: flask for the distillate; without one the distillate is lost (:attr:`waste`).
            stages: theoretical stages of a column between pot and condenser, of which the pot is one (``real``).
            reflux: reflux ratio: mol returned by the column's head per mol of distillate.
            hottest_k: temperature of the heating mantle in K; contents at this temperature or above are not heated.

        Returns:
            The heat balance in J.
        """
        joules = _number("joules", joules, 0.0, _MOST_JOULES)
        if int(_number("stages", stages, 1, 16)) != stages:
            raise ValueError(f"stages: must be a whole number, given {stages!r}")
        if stages > 1 and self._setting.physics == "paper":
            raise ValueError(f"stages = {stages}: a column needs physics='real'")
        limits = np.array(
            [_number("hottest_k", hottest_k, 150.0, HOTTEST_K), 0.0, stages, _number("reflux", reflux, 0.0, 100.0)]
        )
        collecting = self.another(capacity_l=100.0) if receiver is None else receiver
        self._connect(collecting)
        row, target = self._row, collecting._row
        before, spilled = target[self._columns].copy(), self._events[SPILL]
        overflow = np.zeros_like(self._shelf.waste[0])
        taken, condensed = backends.heat(row, target, joules, limits, self._chem, overflow, self._events, self._work)
        self._joules += float(taken)
        self._set_head(target[self._columns] + overflow - before, stages)
        # What overflows is lost by the receiver, as when it is poured.
        collecting._shelf.waste[0] += overflow
        collecting._events[SPILL] += self._events[SPILL] - spilled
        self._events[SPILL] = spilled
        if receiver is None:
            self._shelf.waste[0] += target[self._columns] + overflow
        else:
            receiver._equilibrate()
        self._equilibrate()
        return Heated(float(taken), float(condensed))

    @_all_or_nothing
    def cool(self, joules: float, coolest_k: float = 273.15) -> float:
        """Remove up to ``joules`` by a coolant at ``coolest_k``.

        Returns:
            Removed heat in J; less than requested if the contents reach the coolant's temperature.
        """
        limits = np.array([0.0, _number("coolest_k", coolest_k, COLDEST_K, HOTTEST_K), 1.0, 0.0])
        offered = -_number("joules", joules, 0.0, _MOST_JOULES)
        waste, events = self._shelf.waste[0], self._events
        taken, _ = backends.heat(self._row, self._row, offered, limits, self._chem, waste, events, self._work)
        self._joules += float(taken)
        self._equilibrate()
        return abs(float(taken))

    @_all_or_nothing
    def react(
        self,
        seconds: float,
        temperature_k: float | None = None,
        jacket_w_k: float | None = None,
        condenser_w: float | None = None,
    ) -> None:
        """Stir the flask for a time and let it react.

        Args:
            seconds: duration; with the backend ``paper`` in the unit of its rate constants.
            temperature_k: temperature of a thermostat around the closed flask, or of the jacket with
                ``jacket_w_k``. None: no heat exchange. The thermostat's flask is opened at the end: gas leaves, and
                hotter contents boil in the next :meth:`wait` or with a jacket.
            jacket_w_k: heat transfer in W/K between contents and jacket (``real``).
            condenser_w: cooling power in W of a reflux condenser above the open flask. Vapour that it cannot condense
                is lost and counts as a safety event. Default: unlimited (``real``).

        Raises:
            ArithmeticError: the reactions are too stiff; nothing has changed.
        """
        seconds = _number("seconds", seconds, 0.0)
        condenser = math.inf if condenser_w is None else _number("condenser_w", condenser_w, 0.0)
        transfer_w_k = -1.0
        if jacket_w_k is not None:
            transfer_w_k = _number("jacket_w_k", jacket_w_k, 0.0)
            if temperature_k is None:
                raise ValueError("jacket_w_k: requires temperature_k, the temperature of the jacket")
        jacket = self.temperature_k if temperature_k is None else _number("temperature_k", temperature_k, 150.0, 900.0)
        closed = temperature_k is not None and jacket_w_k is None
        if closed:
            self._row[TEMPERATURE] = jacket
        elif temperature_k is None:
            transfer_w_k = 0.0
        surroundings = Surroundings(jacket, transfer_w_k, -1.0 if closed else condenser, _RTOL, _ATOL)
        waste = self._shelf.waste[0]
        self._check_steps(backends.react(self._row, seconds, surroundings, self._chem, waste, self._events, self._work))
        self._seconds += seconds
        self._equilibrate(clock=T_MIX - CLOCK_SETTLED, closed=closed)
        if closed and self.vapor_pressure_kpa > self.pressure_kpa:
            _warn(
                f"at {jacket:g} K the contents would boil (vapour {self.vapor_pressure_kpa:.4g} of "
                f"{self.pressure_kpa:.4g} kPa); temperature_k alone closes the flask, jacket_w_k leaves it open",
                BoilingWarning,
            )

    @_all_or_nothing
    def wait(self, seconds: float) -> None:
        """Let the flask stand in the room.

        Layers separate, heat is exchanged, crystals grow or dissolve, and reactions continue. With the backend
        ``paper``, only the layers separate.

        Raises:
            ArithmeticError: the reactions are too stiff; nothing has changed.
        """
        seconds = _number("seconds", seconds, 0.0)
        ticks = seconds / self._chemistry.scenario.real.tick_s
        parts = min(max(math.ceil(ticks), 1), _MOST_PARTS)
        waste = self._shelf.waste[0]
        transfer.turn_clock(self._row, CLOCK_SETTLED - T_MIX)
        for _ in range(parts):
            steps = backends.elapse(self._row, ticks / parts, self._chem, waste, self._events, self._work)
            self._check_steps(steps)
            if steps:
                backends.partition(self._row, self._chem, self._work)
        self._seconds += seconds
        self._equilibrate()

    @_all_or_nothing
    def settle(self) -> None:
        """Let the layers separate at once."""
        self._equilibrate(clock=CLOCK_SETTLED - T_MIX)

    @_all_or_nothing
    def mix(self) -> None:
        """Shake the flask: mix the layers and bring them to equilibrium."""
        self._equilibrate(clock=T_MIX - CLOCK_SETTLED)

    @_all_or_nothing
    def drain(self, receiver: Flask, share: float) -> None:
        """Drain the lowest ``share`` (0 to 1) of the volume into another flask, solids first.

        For a settled flask, ``flask.drain(other, flask.layers[0].share)`` drains the lowest layer.

        Raises:
            ValueError: the share is out of bounds, or the flasks differ in their settings.
        """
        share = _number("share", share, 0.0, 1.0)
        self._connect(receiver)
        columns = self._shelf.layout.fluid_columns
        layers, shares = np.zeros(columns + 1, dtype=np.int64), np.zeros((columns, _PIXELS))
        work = np.zeros((columns + 9, max(columns + 1, _PIXELS)))
        lost, events, capacity_l = receiver._shelf.waste[0], receiver._events, self.capacity_l
        # Heights refer to a funnel that the contents fill, so that small volumes have the same relative precision.
        self._row[CAPACITY] = max(min(self.volume_l, capacity_l), 1e-9)
        profile(self._row, self._chem, layers, shares, work)
        transfer.drain(self._row, receiver._row, share * _PIXELS, shares, layers, self._chem, lost, events)
        self._row[CAPACITY] = capacity_l
        self._equilibrate()
        receiver._equilibrate()

    @_all_or_nothing
    def filter(self, receiver: Flask, cake_liquid: float = 0.0) -> None:
        """Filter the liquids into another flask; solids and crystals stay.

        Args:
            receiver: flask for the liquids.
            cake_liquid: litres of liquid retained per litre of solids.

        Raises:
            ValueError: a number is out of bounds, or the flasks differ in their settings.
        """
        cake_liquid = _number("cake_liquid", cake_liquid, 0.0, 100.0)
        self._connect(receiver)
        litres = transfer.free_liquid(self._row, cake_liquid, self._chem)
        columns = self._shelf.layout.fluid_columns
        layers, volumes = np.zeros(columns + 1, dtype=np.int64), np.zeros(columns)
        backends.find_layers(self._row, self._chem, layers, volumes)
        lost, events = receiver._shelf.waste[0], receiver._events
        transfer.strain(self._row, receiver._row, litres, layers, self._chem, lost, events)
        self._equilibrate()
        receiver._equilibrate()

    @_all_or_nothing
    def dry(self, litres: float) -> None:
        """Pass air over the contents; it leaves saturated with their vapour, which is lost.

        ``litres`` is the volume of the moist air that leaves.

        Temperature and solids are unchanged.
        """
        backends.dry(self._row, _number("litres", litres, 0.0, 1e6), self._chem, self._shelf.waste[0])
        self._equilibrate()

    @_all_or_nothing
    def pour(self, other: Flask, share: float) -> None:
        """Pour ``share`` (0 to 1) of everything into another flask; the excess spills.

        Raises:
            ValueError: the share is out of bounds, or the flasks differ in their settings.
        """
        share = _number("share", share, 0.0, 1.0)
        self._connect(other)
        transfer.pour(self._row, other._row, share, self._chem, other._shelf.waste[0], other._events)
        self._equilibrate()
        other._equilibrate()

    def measure(self, kind: str) -> Measurement:
        """Measure the contents with an instrument.

        Args:
            kind: kind of instrument (:data:`chemlab.roles.instruments.INSTRUMENTS`, or ``my_parts.py:NAME``).

        Raises:
            DataError: the kind is unknown, or not supported by the backend.
        """
        instruments = {"reading": validated(InstrumentSpec, {"kind": kind}, "measure")}
        table = InstrumentTable(
            self._chemistry.scenario.model_copy(update={"instruments": instruments}), self._chemistry.table
        )
        channel, instrument = table.channels[0], table.kinds[0]
        readings, first = np.zeros((1, 1, channel.size)), np.zeros(1, dtype=np.int64)
        # Only the assignment of layers to pixels is random.
        table.read(self._shelf, readings, np.zeros((1, 1), dtype=np.uint64), first, first, first)
        if kind == "ph_meter" and self.amounts.get("water", 0.0) > TRACE_MOL:
            self._warn_of_acids()
        words = table.words(0, readings[0, 0])
        endless = channel.size == 1 and not channel.unit.endswith("fraction")
        if endless and readings[0, 0, 0] >= 1.0 and re.search(r"\d", words):
            words += " or more, the end of its range"
        return Measurement(
            channel.unscaled(readings[0, 0]),
            channel.unit,
            (*table.analytes[0], instrument.rest) if instrument.picture == "bars" else (),
            words,
        )

    # -- available materials ------------------------------------------------------------------------------------------

    @staticmethod
    def known() -> tuple[str, ...]:
        """Return the names of all materials that flasks can contain without your own files."""
        return tuple(sorted({key for keys in spellings().values() for key in keys}, key=str.lower))

    @staticmethod
    def material(name: str) -> Material:
        """Return a material's data with their sources; if the catalogue lacks it, look it up and save it.

        Args:
            name: a name, a CAS number or a structure (SMILES).

        Raises:
            DataError: the name does not denote a single compound, or required data are missing.
            ImportError: the material has to be looked up, and the extra ``chem`` is not installed.
            OSError: the folder of saved materials (:func:`chemlab.config.catalogue.user_folder`) cannot be written to.
        """
        name = str(name)
        if found := _find(name):
            return found[1]
        from .openchem.compounds import checked_materials, material_tables
        from .openchem.identity import compound_of, structures
        from .openchem.writing import material_text

        compound = compound_of(name)
        known_name = "" if compound.name == compound.formula else compound.name
        # A short structure is also a formula (CO) or a bundled material (C).
        structure = [compound.smiles] if len(compound.smiles) > 2 else []
        for spelling in (structures().get(compound.smiles), compound.cas, *structure):
            if spelling and (found := _find(spelling)):
                keep_names(found[0], filter(None, (name.strip(), normalized(known_name))))
                return found[1]
        key = key_of(known_name or compound.common_name, compound.inchi_key)
        tables = material_tables([replace(compound, key=key)])
        names = [normalized(text) for text in (key, known_name, compound.cas, compound.common_name) if text]
        text = material_text(tables, f"Flask.material({name!r})")
        keep_material(key, text, [*names, name.strip(), *structure])
        return checked_materials(tables)[key]

    # -- display ------------------------------------------------------------------------------------------------------

    def __repr__(self) -> str:
        lines = [
            f"Flask: {self.volume_l:.3f} of {self.capacity_l:g} L at {self.temperature_k:.1f} K, "
            f"vapour {self.vapor_pressure_kpa:.1f} of {self.pressure_kpa:.1f} kPa"
        ]
        for layer in reversed(self.layers):
            shown = {name: mol for name, mol in layer.contents.items() if mol > _SHOWN_MOL}
            lines.append(f"  {Layer(layer.name, layer.volume_l, layer.share, shown)}")
        for label, values in (("lost", self.waste), ("events", self.events)):
            if values:
                lines.append(f"  {label}: " + ", ".join(f"{key} {value:.4g}" for key, value in values.items()))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        text = f"<pre>{html.escape(repr(self))}</pre>"
        try:
            from .render.frames import picture_html

            return picture_html(self.picture(240, 240), "The flask") + text
        except ImportError:  # Pillow is an extra
            return text

    def plot(self, path: str | Path | None = None) -> Any:
        """Plot the history of temperatures, amounts and compositions over time, or over heat if no time has passed.

        Args:
            path: file to write the figure to (png, svg, pdf).

        Returns:
            The matplotlib figure.

        Raises:
            ImportError: matplotlib is not installed (``pip install '.[plot]'``).
            ValueError: no operation has been performed yet.
        """
        from .render.bottles import flask_figure
        from .render.figure import save_figure

        if len(self._history) < 2:
            raise ValueError("plot: the history is empty; heat, add, react or wait first")
        figure = flask_figure(self.history)
        if path is not None:
            save_figure(figure, Path(path))
        return figure

    def report(self) -> str:
        """Return contents, history and a list of estimated or doubtful data as text."""
        lines = [repr(self), "", f"{'operation':<10} {'s':>8} {'kJ':>8} {'K':>7} {'head K':>7} {'L':>7}"]
        for moment in self._history:
            head = "" if moment.head_temperature_k is None else f"{moment.head_temperature_k:.1f}"
            lines.append(
                f"{moment.operation:<10} {moment.seconds:>8.0f} {moment.joules / 1000.0:>8.1f} "
                f"{moment.temperature_k:>7.1f} {head:>7} {moment.volume_l:>7.3f}"
            )
        held = {name for name, mol in self.amounts.items() if mol > 0.0}
        doubts = list(_uncertain_data(self._chemistry.scenario, held)) if self._setting.physics == "real" else []
        return "\n".join([*lines, *(["", "estimates and doubts:", *doubts] if doubts else [])])

    def scene(self) -> Scene:
        """Return the content of the flask's picture as plain data."""
        from .render.scene import vessel_scene

        return vessel_scene(self._chemistry.scenario, self._shelf)

    def picture(self, width: int = 240, height: int = 240) -> npt.NDArray[np.uint8]:
        """Return a picture of the flask as RGB values [height, width, 3].

        Raises:
            ImportError: Pillow is not installed (``pip install '.[plot]'``).
        """
        from .render.draw import draw_vessel

        return draw_vessel(self.scene(), width, height)

    # -- internals ----------------------------------------------------------------------------------------------------

    @property
    def _row(self) -> FloatArray:
        row: FloatArray = self._shelf.rows[0]
        return row

    @property
    def _vessel(self) -> Vessel:
        return self._shelf.vessel(0, 0)

    @property
    def _chem(self) -> Handle:
        return self._shelf.chem()

    @property
    def _columns(self) -> slice:
        return slice(AMOUNTS, AMOUNTS + len(self._shelf.layout.materials))

    def _materials(self) -> Mapping[str, Material]:
        return _materials(self._setting.material_files, self._setting.content)

    def _material(self, key: str) -> Material:
        """Return the material with a key.

        Raises:
            DataError: the file of a material that was added on this machine is missing.
        """
        if key in (loaded := self._materials()):
            return loaded[key]
        if found := catalogue_material(key):
            return found[1]
        raise DataError(
            f"{user_folder() / 'names.csv'}: lists {key!r}, but its file is missing; Flask.material({key!r}) makes it "
            "again"
        )

    def _resolve(self, name: str) -> str:
        """Return the key of a liquid, a solid or a strong acid from any of its names.

        Raises:
            DataError: the name is unknown or ambiguous, or denotes a gas.
        """
        loaded, name = self._materials(), str(name)
        if name in loaded and loaded[name].role != "gas":
            return name
        keys = matches(name) or _match_structure(name)
        keys = (name,) if name in keys else keys
        if len(keys) > 1:
            raise _ambiguous(name, keys)
        if keys:
            found = catalogue_material(keys[0])
            material = found[1] if found else loaded.get(keys[0])
            if material is None or material.role != "gas":
                return keys[0]
            gas = keys[0]
        else:  # bundled gases are not in the catalogue
            gases = (key for key, m in loaded.items() if m.role == "gas" and normalized(name) == normalized(m.name))
            gas = name if name in loaded else next(gases, "")
        if gas:
            formula = "" if gas == name else f" ({gas})"
            raise DataError(f"{name!r}{formula} is a gas, which an open flask cannot hold")
        if wrong_cas(name):
            raise DataError(f"{name!r} is not a CAS number: its check digit is wrong; correct it, or give a name")
        near = list(dict.fromkeys([*difflib.get_close_matches(name, loaded, 1, 0.9), *closest(name)]))[:3]
        hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        if _SALT.fullmatch(name.strip()):
            raise DataError(
                f"{name!r} is a salt that is not in the catalogue; {hint}it has {', '.join(salts())}; other salts need "
                "your own files in material_files"
            )
        raise DataError(
            f"unknown material {name!r}; {hint}Flask.known() lists all names; Flask.material({name!r}) looks up "
            "another molecule (needs pip install '.[chem]'); other salts, and materials that are not found, need your "
            "own files in material_files"
        )

    def _resolve_contents(self, contents: Mapping[str, float]) -> dict[str, float]:
        """Return mol by key, with strong acids split into their ions."""
        amounts: dict[str, float] = {}
        for name, value in contents.items():
            key, mol = self._resolve(name), _number(f"contents: {name}", value, 0.0, 1e4)
            if key in REAGENTS and not any(self._resolve(other) == "water" for other in contents):
                raise ValueError(f"contents: {name!r} is supported only as its ions in water; add water to them")
            for part, number in REAGENTS.get(key, {key: 1.0}).items():
                amounts[part] = amounts.get(part, 0.0) + number * mol
        return amounts

    def _pour_in(self, contents: dict[str, float], temperature_k: float) -> None:
        """Add contents at a temperature."""
        other = Flask.__new__(Flask)
        other._fill(self._setting, contents, 100.0, temperature_k)
        other._connect(self)
        transfer.pour(other._row, self._row, 1.0, other._chem, self._shelf.waste[0], self._events)

    def _set_head(self, distilled: FloatArray, stages: int) -> None:
        """Store the distillate of a heating step and the temperature at the still head for the history."""
        named = zip(self._shelf.layout.materials, distilled.tolist(), strict=True)
        moved = {name: mol for name, mol in named if mol > TRACE_MOL}
        if moved and self._setting.physics == "real":
            # Without a column, the vapour leaves at the boiling temperature of the pot.
            pot = self.temperature_k
            self._head = (pot if stages == 1 else min(_dew_point(moved, self._chemistry, pot), pot), moved)

    def _append_moment(self, operation: str) -> None:
        """Append the current state to the history."""
        head, distilled = self._head
        self._head = (None, {})
        held = {name: mol for name, mol in self._vessel.amounts(-1.0).items() if mol > TRACE_MOL}
        solids = next((layer.contents for layer in self.layers if layer.name == "solids"), {})
        now = self._seconds, self._joules, self.temperature_k, self.volume_l
        self._history.append(Moment(operation, *now, held, head, distilled, solids))

    def _extend(self, names: frozenset[str]) -> None:
        """Extend the chemistry to the materials ``names``; the contents are kept."""
        if names == self._names:
            return
        chemistry = _build_chemistry(self._setting, names)
        old, layout = self._shelf, self._shelf.layout
        new = Shelf(chemistry.table, 1, 1)
        new.rows[0, :AMOUNTS] = old.rows[0, :AMOUNTS]
        if self._names:  # an empty flask has water in its chemistry, but no amount of it
            same = [new.layout.materials.index(name) for name in layout.materials]
            new.amounts[0, 0, same], new.waste[0, same] = old.amounts[0, 0], old.waste[0]
            fluids = [new.layout.dissolved.index(name) for name in layout.dissolved]
            solvents = [new.layout.solvents.index(name) for name in layout.solvents]
            new.dissolved[0, 0][np.ix_(fluids, solvents)] = old.dissolved[0, 0]
        self._names, self._chemistry, self._shelf = names, chemistry, new
        self._warn_of_salts()
        self._work = np.zeros(backends.work_size(chemistry.table))

    def _warn_of_salts(self) -> None:
        """Warn once of each salt in water for which the user's reaction file has no ``[[salt]]`` entry."""
        scenario, family = self._chemistry.scenario, self._setting.reactions
        if not family.endswith(".toml") or "water" not in scenario.materials:
            return
        insoluble = frozenset(salts()) & set(scenario.materials) - {salt.solid for salt in scenario.family.salt}
        for name in sorted(insoluble - self._insoluble):
            _warn(f"{name} has no [[salt]] entry in {Path(family).name}, so it does not dissolve; add one", SaltWarning)
        self._insoluble |= insoluble

    def _warn_of_acids(self) -> None:
        """Warn of acids and bases, recognized by their names, that do not ionize in this chemistry."""
        scenario = self._chemistry.scenario
        ionize = {name for acid in scenario.family.acid for name in acid.species}
        held = [name for name, mol in self.amounts.items() if mol > TRACE_MOL and name not in ionize]
        if found := [name for name in held if _ACID_OR_BASE.search(scenario.materials[name].name)]:
            _warn(
                f"no [[acid]] entry names {' or '.join(found)}, so the pH is as without it; write one into your own "
                "reaction file",
                IonizationWarning,
            )

    def _state(self) -> list[FloatArray]:
        """Return the arrays that operations change."""
        return [self._shelf.rows, self._shelf.waste, self._events]

    def _is_molten(self, name: str, temperature_k: float) -> bool:
        """Return True for a molecule that is solid in the room and liquid at a temperature (backend ``real``)."""
        material = self._material(name)
        if self._setting.physics != "real" or material.role not in ("solvent", "solute"):
            return False
        melts = material.melting_point_k
        return melts is not None and self._setting.room_k < melts < temperature_k

    def _melt(self, contents: Mapping[str, float]) -> None:
        """Make contents above their melting points liquid."""
        layout = self._shelf.layout
        for name, mol in contents.items():
            if self._is_molten(name, self.temperature_k):
                self._shelf.dissolved[0, 0, layout.dissolved.index(name), layout.solvents.index("organic")] = mol

    def _connect(self, other: Flask) -> None:
        """Give two flasks the same chemistry, so that material can pass to the other one.

        Raises:
            TypeError: ``other`` is not a flask.
            ValueError: it is this flask, or differs in its settings.
        """
        if not isinstance(other, Flask):
            raise TypeError(f"receiver: must be a Flask, given {other!r:.100}; make one: flask.another()")
        if other is self:
            raise ValueError("receiver: is the flask itself; make another one: flask.another()")
        if other._setting != self._setting:
            settings = zip(self._setting._fields, self._setting, other._setting, strict=True)
            key, mine, theirs = next(setting for setting in settings if setting[1] != setting[2])
            if key == "content":
                raise ValueError(
                    "receiver: a file of its materials, pairs or reactions was edited after this flask was made; make "
                    "new flasks"
                )
            raise ValueError(
                f"receiver: has {key} = {theirs!r}, and this flask {mine!r}; make the receiver by flask.another()"
            )
        names = self._names | other._names
        self._extend(names)
        other._insoluble |= self._insoluble
        other._extend(names)

    def _check_steps(self, steps: int) -> None:
        """Check the number of steps of an integration.

        Raises:
            ArithmeticError: it is negative: the reactions are too stiff.
        """
        if steps < 0:
            raise ArithmeticError(
                f"the reactions are too stiff at {self.temperature_k:.1f} K, and nothing has changed; use a shorter "
                "time, a jacket, or smaller rate constants"
            )

    def _equilibrate(self, clock: float = 0.0, closed: bool = False) -> None:
        """Advance the settling clock by ``clock``, bring phases to equilibrium, and warn of spills.

        Nothing boils in a ``closed`` flask; its gas leaves when it is opened afterwards.
        """
        transfer.turn_clock(self._row, float(clock))
        self._row[AIR] = TRACE_MOL if closed else 0.0  # the kernels know a sealed vessel by its air
        for settled in range(_MOST_SETTLINGS if PROTON in self._shelf.layout.materials else 1):
            before, cooler, waste = self._row[self._columns].copy(), self.temperature_k, self._shelf.waste[0]
            backends.settle_phases(self._row, self._chem, waste, self._events, self._work)
            backends.partition(self._row, self._chem, self._work)
            # Newly dissolved bases react with acids, whose heat boils water off or dissolves more. Ions that boiled dry
            # form acids again.
            if abs(self.temperature_k - cooler) > _WARMED_K:
                around = Surroundings(self.temperature_k, -1.0, -1.0 if closed else 0.0, _RTOL, _ATOL)
                backends.react(self._row, 0.0, around, self._chem, waste, self._events, self._work)
            if settled and np.abs(self._row[self._columns] - before).max() < _SETTLED_MOL:
                break
        if closed:
            materials = self._chemistry.scenario.materials
            gas = [materials[name].role == "gas" for name in self._shelf.layout.materials]
            self._shelf.waste[0] += np.where(gas, self._row[self._columns], 0.0)
            self._row[self._columns][gas] = self._row[AIR] = 0.0
        spilled = float(self._events[SPILL])
        if spilled > self._spilled:
            excess = spilled - self._spilled
            _warn(f"{excess:.4g} L spilled: the capacity is {self.capacity_l:g} L", SpillWarning)
            self._spilled = spilled


def _find(name: str) -> tuple[str, Material] | None:
    """Return key and material for a name; None if it is unknown.

    Raises:
        DataError: the name is ambiguous, or denotes a strong acid, which is supported only as its ions.
    """
    keys = matches(name)
    for key in (name, *keys):
        if key != name and len(keys) > 1:
            raise _ambiguous(name, keys)
        if found := shipped_materials().get(key):
            return key, found
        if kept := catalogue_material(key):
            return key, kept[1]
        if key in REAGENTS:
            ions = " and ".join(REAGENTS[key])
            raise DataError(f"{name!r} is supported only as its ions in water: see the materials {ions}")
    return None


def _ambiguous(name: str, keys: Iterable[str]) -> DataError:
    return DataError(f"{name!r} may be {' or '.join(map(repr, keys))}; give one of these names")


def _match_structure(text: str) -> tuple[str, ...]:
    """Return the keys of a structure that is not in the catalogue's notation; an empty tuple without RDKit."""
    if importlib.util.find_spec("rdkit") is None or not re.search(r"[=#()\[\]]|[A-Zcnos]{3}", text):
        return ()
    from .openchem.identity import canonical

    try:
        return matches(canonical(text, "structure"))
    except DataError:
        return ()


def _uncertain_data(scenario: Scenario, names: set[str]) -> Iterator[str]:
    """Yield a line for each estimated or doubtful number of some materials, and one for each of their pairs."""
    for name in sorted(names):
        material = scenario.materials[name]
        cited = {**material.source, **(material.real.source if material.real else {})}
        for field, source in cited.items():
            if source.startswith(("estimate", "guess", "doubtful")):
                yield f"  {name}: {field}: {source}"
    for two, pair in scenario.pairs.items():
        if two <= names:
            yield f"  {' with '.join(pair.of)}: {pair.source}"


@functools.lru_cache(maxsize=16)
def _materials(files: tuple[str, ...], content: str) -> dict[str, Material]:
    """Return the bundled materials and those of files, by id; ``content`` is part of the cache key."""
    return {**shipped_materials(), **load_materials(Path(file) for file in files)}
