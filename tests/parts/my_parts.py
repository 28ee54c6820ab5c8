"""Parts of a user's own, beside the scenario that names them: numpy alone, nothing of chemlab's but what they need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from chemlab.kernels.arrays import FloatArray, Handle, IntArray
from chemlab.kernels.jit import opened
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import AMOUNTS, Chemistry, ChemistryTable
from chemlab.physics.shelf import Shelf
from chemlab.physics.transfer import take
from chemlab.roles.bench import Bench, Channel, Experiments, Observation
from chemlab.roles.instruments import Instrument, Reading
from chemlab.roles.operations import Operation, Turn

# -- instrument: refractometer ------------------------------------------------------------------------------------

REFRACTIVE_INDEX = {"water": 1.3330, "diethyl_ether": 1.3526, "1-chlorohexane": 1.4199, "dodecane": 1.4216}
"""n_D at 20 C; what is not listed does not count."""
LOW, HIGH = 1.3, 1.5


def indices(chemistry: ChemistryTable) -> FloatArray:
    """[M] refractive index of every material of the scenario, 0 where it is not known."""
    return np.array([REFRACTIVE_INDEX.get(name, 0.0) for name in chemistry.layout.materials])


def refract(reading: Reading, chem: Handle) -> float:
    """Refractive indices mix by volume."""
    index, molar_volume = reading.numbers, opened(Chemistry, chem).molar_volume
    litres = np.where(index > 0.0, reading.row[AMOUNTS : AMOUNTS + len(index)] * molar_volume, 0.0)
    mixed = litres @ index / litres.sum() if litres.sum() > 0.0 else 1.0
    reading.out[0] = np.clip((mixed - LOW) / (HIGH - LOW), 0.0, 1.0)
    return 0.0


def refractive_channel(name: str, analytes: Sequence[str]) -> Channel:
    return Channel(name, 1, "n_D", LOW, HIGH, "refractive index of the liquids")


REFRACTOMETER = Instrument("refractive index", refractive_channel, refract, numbers=indices)

# -- operation: evaporation, with a safety event of its own -------------------------------------------------------


def vapour_event(bench: Bench) -> FloatArray:
    """Where the scenario's event ``vapour_mol`` stands among its events."""
    return np.array([bench.scenario.safety_events.index("vapour_mol")], dtype=np.float64)


def blow_off(turn: Turn, chem: Handle) -> float:
    mol = turn.magnitude * turn.row[AMOUNTS + turn.material]
    take(turn.row, chem, turn.material, mol)  # from every layer alike
    turn.waste[turn.material] += mol
    turn.events[int(turn.numbers[0])] += mol
    return 0.5  # all of the bench's vessels settle meanwhile


def can_blow_off(turn: Turn, chem: Handle) -> bool:
    return bool(turn.row[AMOUNTS + turn.material] > 0.0)


EVAPORATE = Operation(
    unit="fraction",
    words="blow {material} off {vessel}",
    act=blow_off,
    legal=can_blow_off,
    takes=frozenset({"material"}),
    top=1.0,
    numbers=vapour_event,
)

# -- observation channels: a hydrometer on a bench, the waste can for the manager ---------------------------------


def float_hydrometer(bench: Bench, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
    """[B, 1] density of the first vessel's contents, of 2 kg/L."""
    amounts = shelf.rows[experiments.places[members, 0], AMOUNTS : AMOUNTS + len(bench.layout.materials)]
    grams, litres = (amounts * bench.known.molar_mass).sum(axis=1), (amounts * bench.known.molar_volume).sum(axis=1)
    return np.clip(grams / 1000.0 / np.maximum(litres, 1e-9) / 2.0, 0.0, 1.0)[:, None]


def hydrometer_channel(bench: Bench) -> Channel:
    return Channel("hydrometer", 1, "kg/L", 0.0, 2.0, f"density of what is in {bench.positions[0]}")


HYDROMETER = Observation(hydrometer_channel, float_hydrometer)


def look_into_can(labs: Laboratories, members: IntArray) -> FloatArray:
    """[B, 1] litres in the waste can, of 5."""
    litres = (labs.shelf.waste[members] * labs.shelf.known().molar_volume).sum(axis=1)
    return np.clip(litres / 5.0, 0.0, 1.0)[:, None]


def can_channel(labs: Laboratories) -> Channel:
    return Channel("waste_can", 1, "L", 0.0, 5.0, "how full the waste can is")


WASTE_CAN = Observation(can_channel, look_into_can)

# -- reward terms: on a bench and for the manager -----------------------------------------------------------------


def concentrate(bench: Bench, shelf: Shelf, experiments: Experiments, members: IntArray) -> FloatArray:
    """[B] every action costs 0.01 for a litre in the first vessel."""
    amounts = shelf.rows[experiments.places[members, 0], AMOUNTS : AMOUNTS + len(bench.layout.materials)]
    return -0.01 * (amounts * bench.known.molar_volume).sum(axis=1)


def tidy(labs: Laboratories, members: IntArray) -> FloatArray:
    """[B] every action costs the manager 0.001 for a reading that is not of this tick."""
    return -0.001 * (labs.state.age[members] > 0).sum(axis=(1, 2))
