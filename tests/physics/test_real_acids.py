"""Acids and bases of the tier ``real``: standard buffers, closed forms of titrations, atoms, charge and heat."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_tier import enthalpy_of, filled, real_table
from scipy.optimize import brentq

from chemlab.kernels.arrays import FloatArray
from chemlab.kernels.jit import kernel
from chemlab.kernels.tables import Table
from chemlab.physics.backends.real.acids import acid_work_size, ph, settle_acids
from chemlab.physics.chemistry import AMOUNTS, ROLE_ION, ROLE_SOLVENT, TEMPERATURE
from chemlab.physics.constants import GAS_CONSTANT

ROOM = 298.15
WATER, PROTON, HYDROXIDE = range(3)
KILOGRAM = 1000.0 / 18.01528
"""mol of water"""
WATER_PK, WATER_HEAT = 13.995, 55_815.0


class Acid(NamedTuple):
    """Charge of the most acidic species, pK at 25 °C and heats (J/mol) of its steps."""

    charge: int
    pk: Sequence[float]
    heat: Sequence[float]


# pK and heats: Goldberg, Kishore, Lennen, J. Phys. Chem. Ref. Data 31 (2002) 231.
ACIDS = {
    "acetic": Acid(0, [4.756], [-410.0]),
    "boric": Acid(0, [9.237], [13_800.0]),
    "carbonic": Acid(0, [6.351, 10.329], [9_150.0, 14_700.0]),
    "citric": Acid(0, [3.128, 4.761, 6.396], [4_070.0, 2_230.0, -3_380.0]),
    "oxalic": Acid(0, [1.27, 4.266], [-3_900.0, -7_000.0]),
    "phosphoric": Acid(0, [2.148, 7.198, 12.35], [-8_000.0, 3_600.0, 16_000.0]),
    "phthalic": Acid(0, [2.950, 5.408], [-2_700.0, -2_170.0]),
    "tartaric": Acid(0, [3.036, 4.366], [3_190.0, 930.0]),
    "tris": Acid(1, [8.072], [47_450.0]),
}


class Solutions:
    """Water with some acids and an inert ion, a layer of it or two.

    Args:
        acids: by name, of :data:`ACIDS` or given.
        counter: charge of the inert ion.
        fields: of the chemistry.
    """

    def __init__(self, acids: Sequence[str | Acid] = (), counter: int = 1, layers: int = 1, **fields: Any) -> None:
        known = [ACIDS[acid] if isinstance(acid, str) else acid for acid in acids]
        charge, formation = [0, 1, -1], [-285_830.0, 0.0, -230_015.0]
        width = max((len(acid.pk) + 1 for acid in known), default=0)
        members, (pk, heat) = np.full((len(known), width), -1), np.zeros((2, len(known), width))
        self.first: list[int] = []
        """of each acid, the material that its most acidic species is"""
        for a, acid in enumerate(known):
            self.first.append(len(charge))
            steps = len(acid.pk)
            members[a, : steps + 1] = len(charge) + np.arange(steps + 1)
            pk[a, :steps], heat[a, :steps] = acid.pk, acid.heat
            charge += [acid.charge - p for p in range(steps + 1)]
            formation += [-400e3 + x for x in np.cumsum([0.0, *acid.heat])]
        charge.append(counter)
        formation.append(-200e3)
        self.materials = len(charge)
        self.charge = np.array(charge, dtype=np.float64)
        # H+ and the acids' bases are lighter by a proton each.
        self.protons = np.array([2.0, 1.0, 1.0, *(len(a.pk) - p for a in known for p in range(len(a.pk) + 1)), 0.0])
        self.formation = np.array(formation)
        self.counter = self.materials - 1
        values: dict[str, Any] = {
            "role": np.where(self.charge == 0.0, ROLE_SOLVENT, ROLE_ION),
            "charge": self.charge,
            "formation": self.formation,
            "acid": members,
            "acid_pk": pk,
            "acid_heat": heat,
            "ionization": np.array([PROTON, HYDROXIDE, WATER]),
            "water_pk": WATER_PK,
            "water_heat": WATER_HEAT,
            "debye": 0.509,
            "molar_mass": np.full(self.materials, 18.01528),
            "molar_volume": np.full(self.materials, 0.018),
            "heat_capacity": np.full(self.materials, 75.3),
            **fields,
        }
        self.table: Table[Any] = real_table(self.materials, range(self.materials), layers, **values)
        self.layers = layers

    def row(self, amounts: Mapping[int, float], temperature_k: float = ROOM) -> FloatArray:
        """A kilogram of water with other things (mol) in it, all in the first layer."""
        mol = np.zeros(self.materials)
        mol[WATER] = KILOGRAM
        for material, amount in amounts.items():
            mol[material] = amount
        parts = {i: [x, *[0.0] * (self.layers - 1)] for i, x in enumerate(mol)}
        return filled(self.table, mol, temperature_k, parts)

    def settle(self, row: FloatArray) -> FloatArray:
        """The row, settled."""
        settle_acids(row, self.table.handle, np.zeros(acid_work_size(self.table.arrays)))
        return row

    def ph(self, amounts: Mapping[int, float], temperature_k: float = ROOM) -> float:
        """pH of a kilogram of water with other things (mol) in it."""
        return read(self.settle(self.row(amounts, temperature_k)), self.table.handle)

    def amounts(self, row: FloatArray) -> FloatArray:
        """[M] mol."""
        return row[AMOUNTS : AMOUNTS + self.materials]


@kernel
def read(row: FloatArray, chem: Any) -> float:
    return ph(row, chem)


# mol/kg of each species of the acid, from the most acidic one on, and the pH at 25 and 37 °C: Buck et al., Pure Appl.
# Chem. 74 (2002) 2169.
BUFFERS: dict[str, tuple[str, int, Sequence[float], float, float | None]] = {
    "potassium tetroxalate": ("oxalic", 1, [0.05, 0.05], 1.679, None),
    "potassium hydrogen tartrate": ("tartaric", 1, [0.0, 0.0341], 3.557, 3.548),
    "potassium dihydrogen citrate": ("citric", 1, [0.0, 0.05], 3.776, 3.756),
    "potassium hydrogen phthalate": ("phthalic", 1, [0.0, 0.05], 4.005, 4.022),
    "acetate": ("acetic", 1, [0.1, 0.1], 4.644, None),
    "phosphate": ("phosphoric", 1, [0.0, 0.025, 0.025], 6.865, 6.838),
    "phosphate of blood": ("phosphoric", 1, [0.0, 0.008695, 0.03043], 7.413, 7.367),
    "tris": ("tris", -1, [0.05, 0.01667], 7.699, 7.382),
    "borax": ("boric", 1, [0.02, 0.02], 9.180, 9.081),
    "carbonate": ("carbonic", 1, [0.0, 0.025, 0.025], 10.012, 9.910),
}


@pytest.mark.parametrize("name", BUFFERS)
def test_standard_buffers_have_their_ph(name: str) -> None:
    acid, counter, parts, at_25, at_37 = BUFFERS[name]
    # As much heat capacity as keeps the temperature.
    solutions = Solutions([acid], counter, heat_capacity=np.full(20, 1e6))
    amounts = {solutions.first[0] + p: x for p, x in enumerate(parts)}
    amounts[solutions.counter] = abs(sum(x * solutions.charge[i] for i, x in amounts.items()))
    assert solutions.ph(amounts) == pytest.approx(at_25, abs=0.025)
    if at_37 is not None:
        assert solutions.ph(amounts, 310.15) == pytest.approx(at_37, abs=0.03)


# Mean activity coefficients at 0.1 mol/kg and 25 °C: Robinson and Stokes, Electrolyte Solutions, 2nd ed. 1959.
def test_strong_acid_strong_base_and_water() -> None:
    for ion, counter, gamma in ((PROTON, -1, 0.796), (HYDROXIDE, 1, 0.766)):
        found, log = Solutions([], counter).ph({ion: 0.1, 3: 0.1}), math.log10(0.1 * gamma)
        assert found == pytest.approx(-log if ion == PROTON else WATER_PK + log, abs=0.02)
    for temperature in (ROOM, 330.0):
        expected = 0.5 * (WATER_PK - WATER_HEAT / (math.log(10.0) * GAS_CONSTANT) * (1.0 / ROOM - 1.0 / temperature))
        assert Solutions().ph({}, temperature) == pytest.approx(expected, abs=1e-3)
    assert Solutions(debye=0.0).ph({}) == pytest.approx(0.5 * WATER_PK, abs=1e-6)


@pytest.mark.parametrize("pk", [-3.0, 2.0, 4.756, 9.0])
@pytest.mark.parametrize("acid", [1e-6, 1e-3, 0.1])
def test_titration_of_an_acid_with_a_strong_base(pk: float, acid: float) -> None:
    """Charges: h + b = Kw / h + c Ka / (Ka + h), at every amount b of base."""
    solutions = Solutions([Acid(0, [pk], [0.0])], debye=0.0, heat_capacity=np.full(6, 1e6))
    kw, ka = 10.0**-WATER_PK, 10.0**-pk
    for base in acid * np.array([0.0, 0.1, 0.5, 0.9, 0.999, 1.0, 1.001, 1.5]):

        def charges(log_h: float, base: float = base) -> float:
            h = math.exp(log_h)
            return h + base - kw / h - acid * ka / (ka + h)

        expected = -brentq(charges, -40.0, 5.0, xtol=1e-14) / math.log(10.0)
        amounts = {solutions.first[0]: acid, HYDROXIDE: base, solutions.counter: base}
        # Neutralization makes water: up to 0.2 % more of it dilute everything.
        assert solutions.ph(amounts) == pytest.approx(expected, abs=2e-3 * acid / 0.1 + 1e-5)


def test_an_acid_of_three_steps_is_shared_out_by_its_constants() -> None:
    """alpha_i = h^(3 - i) K_1 ... K_i / sum, at the h found."""
    solutions = Solutions(["phosphoric"], debye=0.0)
    for base in (0.0, 0.05, 0.1, 0.17, 0.25, 0.4):
        row = solutions.settle(solutions.row({3: 0.1, HYDROXIDE: base, solutions.counter: base}))
        warmer = (1.0 / ROOM - 1.0 / row[TEMPERATURE]) / GAS_CONSTANT
        acid = ACIDS["phosphoric"]
        constants = 10.0 ** -np.array(acid.pk) * np.exp(np.array(acid.heat) * warmer)
        h = 10.0 ** -read(row, solutions.table.handle)
        weights = h ** np.arange(3, -1, -1.0) * np.cumprod([1.0, *constants])
        np.testing.assert_allclose(solutions.amounts(row)[3:7], 0.1 * weights / weights.sum(), rtol=1e-9)


def test_activities_obey_the_law_of_mass_action() -> None:
    """a(H+) a(A-) / a(HA) = Ka with Davies' coefficients, whatever else is dissolved."""
    solutions = Solutions(["acetic"])
    for salt in (0.0, 0.02, 0.3):
        row = solutions.settle(solutions.row({3: 0.02, 4: 0.03, HYDROXIDE: salt, solutions.counter: 0.03 + salt}))
        mol = solutions.amounts(row) / (solutions.amounts(row)[WATER] / KILOGRAM)
        strength = 0.5 * mol @ solutions.charge**2
        log_gamma = -0.509 * (math.sqrt(strength) / (1.0 + math.sqrt(strength)) - 0.3 * strength)
        assert -read(row, solutions.table.handle) == pytest.approx(math.log10(mol[PROTON]) + log_gamma, abs=1e-3)
        expected = 10.0 ** (-4.756 - 2.0 * log_gamma)
        assert mol[PROTON] * mol[4] / mol[3] == pytest.approx(expected, rel=2e-3)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=300)
def test_atoms_charge_and_enthalpy_are_conserved(seed: int) -> None:
    """Anything in any amount of water: 1e-12 of atoms and charge, 1e-9 of the enthalpy; settled, it stays as it is."""
    rng = np.random.default_rng(seed)
    names = list(rng.choice([*ACIDS], size=rng.integers(0, 4), replace=False))
    solutions = Solutions(names, int(rng.choice([-2, -1, 1, 2])), layers=2)
    amounts = {i: 10.0 ** rng.uniform(-9.0, 0.5) for i in range(1, solutions.materials) if rng.random() < 0.6}
    # The inert ion makes up for the charge, or what is left over stays.
    charge = sum(x * solutions.charge[i] for i, x in amounts.items() if i != solutions.counter)
    amounts[solutions.counter] = max(-charge / solutions.charge[solutions.counter], 0.0)
    amounts[WATER] = KILOGRAM * 10.0 ** rng.uniform(-4.0, 0.0)
    row = solutions.row(amounts, rng.uniform(280.0, 360.0))
    before, heat = solutions.amounts(row).copy(), enthalpy_of(row, solutions.table.handle)
    solutions.settle(row)
    after = solutions.amounts(row)
    assert np.isfinite(row).all()
    assert row[AMOUNTS:].min() >= 0.0
    assert after @ solutions.charge == pytest.approx(before @ solutions.charge, abs=1e-12 * before.sum())
    assert after @ solutions.protons == pytest.approx(before @ solutions.protons, rel=1e-12)
    assert after[WATER] + after[HYDROXIDE] == pytest.approx(before[WATER] + before[HYDROXIDE], rel=1e-12)
    for first, name in zip(solutions.first, names, strict=True):
        every = slice(first, first + len(ACIDS[name].pk) + 1)
        assert after[every].sum() == pytest.approx(before[every].sum(), rel=1e-12, abs=1e-300)
    scale = np.abs(solutions.formation) @ before
    assert enthalpy_of(row, solutions.table.handle) == pytest.approx(heat, abs=1e-9 * scale)
    np.testing.assert_array_equal(row[AMOUNTS + solutions.materials :: 2], after)
    assert not row[AMOUNTS + solutions.materials + 1 :: 2].any()
    np.testing.assert_allclose(solutions.settle(row.copy()), row, rtol=1e-9, atol=1e-12)


def test_other_layers_and_crystals_take_no_part() -> None:
    solutions = Solutions(["acetic"], 1, layers=2)
    row = solutions.row({3: 0.1, HYDROXIDE: 0.05, solutions.counter: 0.05})
    alone = solutions.settle(row.copy())
    acid = AMOUNTS + 3
    in_other_layer = AMOUNTS + solutions.materials + 3 * 2 + 1
    row[acid] += 5.0
    row[in_other_layer] = 2.0  # and 3 of crystals
    solutions.settle(row)
    assert row[in_other_layer] == 2.0
    assert row[acid] == pytest.approx(alone[acid] + 5.0, rel=1e-9)  # a little cooler
    assert read(row, solutions.table.handle) == pytest.approx(read(alone, solutions.table.handle), abs=1e-3)


def test_without_water_nothing_happens() -> None:
    solutions = Solutions(["acetic"])
    row = solutions.row({WATER: 0.0, 3: 0.1, HYDROXIDE: 0.2, solutions.counter: 0.2})
    assert (solutions.settle(row.copy()) == row).all()
    assert math.isnan(read(row, solutions.table.handle))
    solutions = Solutions(["acetic"], ionization=np.array([PROTON, -1, WATER]))
    row = solutions.row({3: 0.1})
    assert (solutions.settle(row.copy()) == row).all()
