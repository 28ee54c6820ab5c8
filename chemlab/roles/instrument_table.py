"""Arrays of the scenario's instruments, and the kernel that takes their readings."""

from __future__ import annotations

import re
from typing import Annotated, Any, NamedTuple

import numba
import numpy as np
from numba.extending import overload

from ..config.datafile import DataError
from ..config.parts import PartError, blamed, checked_numbers, load_part
from ..config.scenario import Scenario
from ..kernels import jit
from ..kernels.arrays import Field, FloatArray, Handle, IntArray, StreamArray
from ..kernels.jit import COMPILED, helper, kernel, opened
from ..kernels.rng import normal
from ..kernels.tables import Table
from ..physics.chemistry import ChemistryTable
from ..physics.shelf import Shelf, ShelfArrays
from ..physics.transfer import remove_fraction
from .bench import CAMERA_PIXELS, Channel, check_vessels
from .instruments import INSTRUMENTS, Instrument, Reading

_TAKEN = frozenset({"occupied", "fill", "temperature", "capacity", "last_bench", "last_position"})


def _read_by(read: int, reading: Reading, chem: Handle) -> None:
    """Let a built-in instrument write its reading; nothing for -1. ``read`` is an :attr:`InstrumentRules.read`."""
    if read >= 0:
        list(INSTRUMENTS.values())[read].read(reading, chem)


def _signature() -> Any:
    """Return the numba signature of :attr:`Instrument.read`."""
    types = numba.types
    number, whole, bits = types.float64, types.int64, types.uint64
    kinds = [(number, 1), (whole, 1), (bits, 1), (whole, 1), (number, 2), (number, 2), (number, 1), (number, 1)]
    return number(types.NamedTuple([types.Array(kind, axes, "C") for kind, axes in kinds], Reading), whole)


if COMPILED:

    @overload(_read_by)
    def _called(read, reading, chem):  # type: ignore[no-untyped-def]  # numba wants no types here
        call = jit.call_address("read", _signature())

        def found(read, reading, chem):  # type: ignore[no-untyped-def]
            if read >= 0:
                call(read, (reading, chem))

        return found


class InstrumentRules(NamedTuple):
    """Arrays of a scenario's instruments: I instruments, A analytes in total, C layers."""

    read: Annotated[IntArray, Field("I")]
    """[I] address of a built-in instrument's code (without compilation: its index in ``INSTRUMENTS``), or -1"""
    start: Annotated[IntArray, Field("I+1")]
    """[I + 1] offset of each reading in the concatenated readings"""
    price: Annotated[FloatArray, Field("I")]
    """[I] price of one use in units of the score"""
    sample: Annotated[FloatArray, Field("I")]
    """[I] share of the contents that one use consumes"""
    noise: Annotated[FloatArray, Field("I")]
    """[I] standard deviation added to every value"""
    gain: Annotated[FloatArray, Field("I")]
    """[I] factor of every value; ``bias`` is added"""
    bias: Annotated[FloatArray, Field("I")]
    least: Annotated[FloatArray, Field("I")]
    """[I] detection limit, below which a value reads 0"""
    analytes: Annotated[IntArray, Field("A")]
    """[A] material indices, concatenated over instruments"""
    first_analyte: Annotated[IntArray, Field("I+1")]
    """[I + 1] offset of each instrument's analytes"""
    numbers: Annotated[FloatArray, Field("n")]
    """[n] values of each instrument's ``numbers``, concatenated"""
    first_number: Annotated[IntArray, Field("I+1")]
    """[I + 1] offset of each instrument's numbers"""
    layers: Annotated[IntArray, Field("C+1")]
    """scratch, as ``shares`` and ``work``"""
    shares: Annotated[FloatArray, Field("C pixels")]
    work: Annotated[FloatArray, Field("a b")]


@helper
def _reading(i: int, row: FloatArray, stream: StreamArray, out: FloatArray, rules: InstrumentRules) -> Reading:
    analytes = rules.analytes[rules.first_analyte[i] : rules.first_analyte[i + 1]]
    numbers = rules.numbers[rules.first_number[i] : rules.first_number[i + 1]]
    return Reading(row, analytes, stream, rules.layers, rules.shares, rules.work, numbers, out)


@kernel
def _take(
    members: IntArray,
    slots: IntArray,
    used: IntArray,
    readings: FloatArray,
    stream: StreamArray,
    instruments: Handle,
    shelf: Handle,
    chemistry: Handle,
) -> None:
    """Let instrument ``used[b]`` measure the vessel in slot ``slots[b]`` into ``readings`` [N, S, R], for b of
    ``members`` [B].

    The sample is consumed. Readings of user-defined instruments have been taken already.
    """
    rules, arrays = opened(InstrumentRules, instruments), opened(ShelfArrays, shelf)
    for b in range(members.shape[0]):
        m, i = members[b], used[b]
        chem, row = chemistry[arrays.variant[m]], arrays.rows[m * arrays.vessels + slots[b]]
        out = readings[m, slots[b], rules.start[i] : rules.start[i + 1]]
        _read_by(rules.read[i], _reading(i, row, stream[m], out, rules), chem)
        if rules.sample[i] > 0.0:
            remove_fraction(row, rules.sample[i], chem, arrays.waste[m])


@kernel
def _disturb(
    members: IntArray,
    slots: IntArray,
    used: IntArray,
    readings: FloatArray,
    stream: StreamArray,
    drifted: FloatArray,
    instruments: Handle,
) -> None:
    """Apply calibration, drift, noise and detection limit to the readings; ``drifted`` [N, R] or, for all, [1, R]."""
    rules = opened(InstrumentRules, instruments)
    for b in range(members.shape[0]):
        m, i = members[b], used[b]
        own = drifted[min(m, drifted.shape[0] - 1)]
        for k in range(rules.start[i], rules.start[i + 1]):
            value = rules.gain[i] * readings[m, slots[b], k] + rules.bias[i] + own[k]
            value += rules.noise[i] * normal(stream[m]) if rules.noise[i] > 0.0 else 0.0
            readings[m, slots[b], k] = min(max(value, 0.0), 1.0) if value >= rules.least[i] else 0.0


class InstrumentTable:
    """The scenario's instruments.

    Attributes:
        names: names in the scenario's order.
        kinds: their kinds.
        channels: channels of their readings.
        analytes: names of the materials that each distinguishes.
        rules: static parameters for kernels (:class:`InstrumentRules`).
    """

    def __init__(self, scenario: Scenario, chemistry: ChemistryTable) -> None:
        self.names = tuple(scenario.instruments)
        specs = list(scenario.instruments.values())
        self.kinds: list[Instrument] = []
        self.channels: tuple[Channel, ...] = ()
        self.analytes: list[tuple[str, ...]] = []
        known, indices = chemistry.world(), []
        self._numbers: list[FloatArray] = []
        for name, spec in scenario.instruments.items():
            where = f"{scenario.origin}: instruments.{name}"
            if name in _TAKEN or not re.fullmatch("[a-z][a-z0-9_]*", name):
                raise DataError(
                    f"{where}: must be lower-case letters, digits and _, and none of "
                    f"{', '.join(sorted(_TAKEN))}, which are other channels of the manager's observation"
                )
            if spec.kind not in INSTRUMENTS and ":" not in spec.kind:
                raise DataError(
                    f"{where}.kind: unknown kind {spec.kind!r}; choose from {', '.join(INSTRUMENTS)}, or your own, "
                    "'file.py:NAME'"
                )
            kind: Instrument = INSTRUMENTS.get(spec.kind) or load_part(
                spec.kind, scenario, f"instruments.{name}.kind", of=Instrument
            )
            missing = [field for field in kind.needs if not hasattr(known, field)]
            if missing:
                raise DataError(
                    f"{where}.kind: {spec.kind!r} needs {missing[0]!r} of the materials, which physics = "
                    f"{chemistry.tier!r} does not have; choose physics = 'real' or another instrument"
                )
            with blamed(f"{where}: {spec.kind}"):
                own = kind.analytes(known)
                self.analytes.append(tuple(chemistry.layout.materials[i] for i in own))
                channel = kind.channel(name, self.analytes[-1])
                self._numbers.append(np.asarray(kind.numbers(chemistry), dtype=np.float64))
            if not isinstance(channel, Channel) or channel.size < 1 or channel.name != name:
                raise PartError(
                    f"{where}: {spec.kind}: channel() must return a Channel named {name!r} with a size of at least 1, "
                    f"given {channel!r}"
                )
            self.kinds.append(kind)
            indices.append(own)
            self.channels += (channel,)
        builtin, columns = list(INSTRUMENTS.values()), chemistry.layout.fluid_columns
        self._own = [
            "" if kind in builtin else f"{scenario.origin}: instruments.{name}: {spec.kind}: read()"
            for kind, (name, spec) in zip(self.kinds, scenario.instruments.items(), strict=True)
        ]
        self.rules = Table(
            InstrumentRules(
                read=self._code(),
                start=np.cumsum([0, *(channel.size for channel in self.channels)]),
                price=np.array([spec.price for spec in specs], dtype=np.float64),
                sample=np.array([spec.sample_fraction for spec in specs], dtype=np.float64),
                noise=np.array([spec.noise for spec in specs], dtype=np.float64),
                gain=np.array([spec.gain for spec in specs], dtype=np.float64),
                bias=np.array([spec.bias for spec in specs], dtype=np.float64),
                least=np.array([spec.detection_limit for spec in specs], dtype=np.float64),
                analytes=np.concatenate([np.zeros(0, dtype=np.int64), *indices]),
                first_analyte=np.cumsum([0, *(len(own) for own in indices)]),
                numbers=np.concatenate([np.zeros(0), *(own.reshape(-1) for own in self._numbers)]),
                first_number=np.cumsum([0, *(own.size for own in self._numbers)]),
                layers=np.zeros(columns + 1, dtype=np.int64),
                shares=np.zeros((columns, CAMERA_PIXELS)),
                work=np.zeros((columns + 9, max(columns + 1, CAMERA_PIXELS))),
            )
        )
        self._right = np.zeros((1, int(self.rules.arrays.start[-1])))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.rules.arrays.read[:] = self._code()  # addresses are invalid in another process

    def _code(self) -> IntArray:
        """Return :attr:`InstrumentRules.read`. Instruments that the scenario lacks are not compiled."""
        reads, found = [kind.read for kind in INSTRUMENTS.values()], np.full(len(self.kinds), -1, dtype=np.int64)
        for i, kind in enumerate(self.kinds):
            if not self._own[i]:
                code: Any = kind.read
                found[i] = jit.code_address(code, _signature(), code.__module__) if COMPILED else reads.index(code)
        return found

    @property
    def start(self) -> IntArray:
        """[I + 1] offset of each reading in the concatenated readings."""
        return self.rules.arrays.start

    @property
    def price(self) -> FloatArray:
        """[I] price of one use in units of the score."""
        return self.rules.arrays.price

    def words(self, instrument: int, values: FloatArray) -> str:
        """Describe a reading (in [0, 1]) of the instrument with index ``instrument``."""
        return self.kinds[instrument].words(values, self.channels[instrument], self.analytes[instrument])

    def read(
        self,
        shelf: Shelf,
        readings: FloatArray,
        stream: StreamArray,
        members: IntArray,
        slots: IntArray,
        used: IntArray,
        drifted: FloatArray | None = None,
    ) -> None:
        """Let instrument ``used`` [B] measure the vessels of slots ``slots`` [B] in laboratories ``members`` [B].

        Readings are written to ``readings`` [N, S, R] and samples are consumed. ``drifted`` [N, R] is the drift of
        every value; None: no drift.
        """
        if any(self._own):
            rules: Any = self.rules.arrays
            reading = getattr(_reading, "py_func", _reading)
            for m, slot, i in zip(members.tolist(), slots.tolist(), used.tolist(), strict=True):
                if self._own[i]:
                    out = readings[m, slot, rules.start[i] : rules.start[i + 1]]
                    out[:] = np.nan  # a value that read() leaves out is an error, not the one of an earlier reading
                    turn = reading(i, shelf.vessels[m, slot], stream[m], out, rules)
                    with blamed(self._own[i]):
                        self.kinds[i].read(turn._replace(numbers=self._numbers[i]), shelf.chem(m))
                    out[:] = checked_numbers(out, out.shape, self._own[i], 0.0, 1.0)
                    check_vessels(turn.row[None], self._own[i])
        handles = self.rules.handle, shelf.handle, shelf.chemistry.handles
        _take(members, slots, used, readings, stream, *handles)
        off = self._right if drifted is None else drifted
        _disturb(members, slots, used, readings, stream, off, self.rules.handle)
