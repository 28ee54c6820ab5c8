"""Kinetics: closed forms, the Arrhenius law, SciPy's solvers on random networks, conservation, the Wurtz facts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import Glassware, network_table
from hypothesis import event, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from chemlab.kernels.arrays import FloatArray
from chemlab.kernels.tables import Table
from chemlab.physics.chemistry import AMOUNTS, Chemistry
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.physics.mass_action import integrate as react
from chemlab.physics.mass_action import react_work_size

Step = tuple[Mapping[int, float], Mapping[int, float], float, float]
"""(reactants, products, pre-exponential, activation energy); species by number, orders are the coefficients."""

ROOM = 298.15
DEFAULT, TIGHT = (1e-3, 1e-6), (1e-9, 1e-12)


@dataclass(frozen=True)
class Scheme:
    """A mass-action scheme as arrays: [R, S] stoichiometry and orders, [R] Arrhenius constants."""

    stoichiometry: FloatArray
    orders: FloatArray
    pre_exponential: FloatArray
    activation_energy: FloatArray

    @classmethod
    def of(cls, steps: Sequence[Step], species: int) -> Scheme:
        """From reactions over species 0, 1, ..."""
        stoichiometry, orders = np.zeros((len(steps), species)), np.zeros((len(steps), species))
        for r, (reactants, products, _, _) in enumerate(steps):
            for j, number in reactants.items():
                stoichiometry[r, j] -= number
                orders[r, j] += number
            for j, number in products.items():
                stoichiometry[r, j] += number
        factors, energies = (np.array([step[i] for step in steps], dtype=np.float64) for i in (2, 3))
        return cls(stoichiometry, orders, factors, energies)

    @property
    def network(self) -> Table[Chemistry]:
        """What the kernel takes."""
        species = np.arange(self.orders.shape[1])
        return network_table(species, self.stoichiometry, self.orders, self.pre_exponential, self.activation_energy)


def run(
    scheme: Scheme,
    amounts: Sequence[float] | FloatArray,
    volume_l: float,
    dt: float,
    tolerance: tuple[float, float] = TIGHT,
    temperature_k: float = ROOM,
) -> FloatArray:
    """Amounts (mol) after ``dt`` in the kernel's hands."""
    network = scheme.network
    row = np.zeros(AMOUNTS + len(network.species))
    row[AMOUNTS:] = amounts
    react(row, network.handle, volume_l, temperature_k, dt, *tolerance, np.zeros(react_work_size(network.arrays)))
    return row[AMOUNTS:]


def scipy_amounts(
    scheme: Scheme, amounts: Sequence[float] | FloatArray, volume_l: float, dt: float, method: str = "LSODA"
) -> FloatArray:
    """Amounts (mol) after ``dt`` by SciPy, rtol 1e-8, rate constants at 298.15 K."""
    constants = scheme.pre_exponential * np.exp(-scheme.activation_energy / (GAS_CONSTANT * ROOM))

    def slope(_: float, concentration: FloatArray) -> FloatArray:
        rates = constants * np.prod(np.maximum(concentration, 0.0) ** scheme.orders, axis=1)
        return np.asarray(rates @ scheme.stoichiometry)

    start = np.asarray(amounts, dtype=np.float64) / volume_l
    solution = solve_ivp(slope, (0.0, dt), start, method=method, rtol=1e-8, atol=1e-11)
    assert solution.success, solution.message
    return np.asarray(solution.y[:, -1] * volume_l)


@pytest.mark.parametrize(("tolerance", "allowed"), [(DEFAULT, 5e-3), ((1e-7, 1e-10), 1e-6)])
def test_very_long_tick_ends_at_equilibrium(tolerance: tuple[float, float], allowed: float) -> None:
    """2 A + 2 B <-> C at k = 1e4 for a time of 1: a step that long overflows, yet rest is where rates balance."""
    scheme = Scheme.of([({0: 2, 1: 2}, {2: 1}, 1e4, 0.0), ({2: 2}, {0: 4, 1: 4}, 1e4, 0.0)], 3)
    # Rest: [A]^2 [B]^2 = 2 [C]^2 with a = b and c = (1 - a) / 2, in 0.2 L: 5 a^2 = (1 - a) / sqrt(2).
    a = (-np.sqrt(0.5) + np.sqrt(0.5 + 20.0 * np.sqrt(0.5))) / 10.0
    assert run(scheme, [1.0, 1.0, 0.0], 0.2, 1.0, tolerance) == pytest.approx([a, a, (1.0 - a) / 2.0], abs=allowed)


def test_nothing_reacts_without_liquid_time_or_reactant() -> None:
    """No volume, no time, or a missing reactant: the amounts stay as they were, bit for bit."""
    scheme = Scheme.of([({0: 1, 1: 1}, {2: 1}, 5.0, 0.0)], 3)
    start = np.array([0.3, 0.2, 0.1])
    assert (run(scheme, start, 0.0, 1.0) == start).all()
    assert (run(scheme, start, 0.5, 0.0) == start).all()
    assert (run(scheme, [0.3, 0.0, 0.1], 0.5, 1.0) == [0.3, 0.0, 0.1]).all()


@dataclass(frozen=True)
class Problem:
    """A random network that conserves mass, and what is in the vessel."""

    scheme: Scheme
    amounts: FloatArray
    volume: float
    dt: float


def problems(decades: tuple[float, float]) -> st.SearchStrategy[Problem]:
    """1 to 4 reactions of order 1 to 4 over 3 to 6 species of masses 1 to 3; log10 of the constants in ``decades``."""

    def build(n_reactions: int, species: int, seed: int) -> Problem:
        rng = np.random.default_rng(seed)
        masses = rng.integers(1, 4, species)
        steps: list[Step] = []
        for _ in range(n_reactions):
            chosen = rng.permutation(species)
            n_reactants, n_products = rng.integers(1, 3, 2)
            n_products = min(n_products, species - n_reactants)
            reactants = {int(j): float(rng.integers(1, 3)) for j in chosen[:n_reactants]}
            parts = {int(j): float(rng.integers(1, 3)) for j in chosen[n_reactants : n_reactants + n_products]}
            scale = sum(n * masses[j] for j, n in reactants.items()) / sum(n * masses[j] for j, n in parts.items())
            steps.append((reactants, {j: n * scale for j, n in parts.items()}, 10.0 ** rng.uniform(*decades), 0.0))
        amounts = rng.uniform(0.05, 1.5, species) * (rng.random(species) < 0.8)
        return Problem(Scheme.of(steps, species), amounts, rng.uniform(0.2, 2.0), 10.0 ** rng.uniform(-2.0, 0.3))

    return st.builds(build, st.integers(1, 4), st.integers(3, 6), st.integers(0, 2**32 - 1))


@given(problems(decades=(-1.5, 3.5)))
@settings(max_examples=120)
def test_random_networks_agree_with_scipy(problem: Problem) -> None:
    """Same final amounts as LSODA at rtol 1e-8, closer the tighter the tolerance; constants over five decades."""
    constants = problem.scheme.pre_exponential
    event(f"{len(constants)} reactions, spread 1e{int(np.log10(constants.max() / constants.min()))}")
    reference = scipy_amounts(problem.scheme, problem.amounts, problem.volume, problem.dt)
    # Both solvers bound the error of a step by atol + rtol c; over many steps errors add up, hence the factor.
    for rtol, atol in ((1e-3, 1e-6), (1e-5, 1e-8), (1e-7, 1e-10)):
        result = run(problem.scheme, problem.amounts, problem.volume, problem.dt, (rtol, atol))
        allowed = 20.0 * (rtol * problem.amounts.sum() + atol * problem.volume) + 1e-6
        np.testing.assert_allclose(result, reference, rtol=0.0, atol=allowed)


def test_robertson_like_network_agrees_with_an_implicit_solver() -> None:
    """A -> B, 2 B -> B + C, B + C -> A + C with constants from 0.04 to 1e4: as SciPy's Radau has it."""
    steps: list[Step] = [
        ({0: 1}, {1: 1}, 0.04, 0.0),
        ({1: 2}, {1: 1, 2: 1}, 1e4, 0.0),
        ({1: 1, 2: 1}, {0: 1, 2: 1}, 1e2, 0.0),
    ]
    scheme = Scheme.of(steps, 3)
    reference = scipy_amounts(scheme, [1.0, 0.0, 0.0], 1.0, 5.0, "Radau")
    assert run(scheme, [1.0, 0.0, 0.0], 1.0, 5.0, DEFAULT) == pytest.approx(reference, abs=2e-3)
    assert run(scheme, [1.0, 0.0, 0.0], 1.0, 5.0, (1e-7, 1e-10)) == pytest.approx(reference, abs=1e-6)


CHLORIDES = ("1-chlorohexane", "2-chlorohexane", "3-chlorohexane")


def wurtz(reagents: Sequence[str]) -> tuple[Glassware, Table[Chemistry]]:
    """4 mol ether, 1 mol of each reagent and 3 mol Na; the shipped network with k = 1 for all six reactions."""
    glass = Glassware("wurtz_dodecane", 1)
    network = glass.known
    assert len(network.pre_exponential) == 6
    glass.fill(0, {"diethyl_ether": 4.0, "Na": 3.0, **dict.fromkeys(reagents, 1.0)}, 2.0)
    return glass, Table(network._replace(pre_exponential=np.ones(6), activation_energy=np.zeros(6)))


def published(reagents: Sequence[str], goal: str) -> float:
    """mol of the goal after 0.2 where the volume is that of everything in the vessel, solids too, as it changes."""
    glass, network = wurtz(reagents)
    work = np.zeros(react_work_size(network.arrays))
    for _ in range(200):
        react(glass.rows[0], network.handle, glass.volume(0), ROOM, 0.001, 1e-8, 1e-11, work)
    return glass.amount(0, goal)


def test_the_facts_that_pin_the_wurtz_constants() -> None:
    """PHYSICS section 1: 0.449 and 0.270 mol of product, 2.077 of salt, mean 0.605; 0.445 when everything is added."""
    symmetric, mixed = published(CHLORIDES[:1], "dodecane"), published(CHLORIDES[:2], "5-methylundecane")
    salt = published(CHLORIDES, "NaCl")
    assert symmetric == pytest.approx(0.449, abs=1e-3)
    assert mixed == pytest.approx(0.270, abs=1e-3)
    assert salt == pytest.approx(2.077, abs=5e-3)
    assert (3 * symmetric + 3 * mixed + salt) / 7 == pytest.approx(0.605, abs=1e-3)
    # Two moles of salt for each mole of product: the six products together are half the salt.
    assert (salt / 2 + salt) / 7 == pytest.approx(0.445, abs=1e-3)


@pytest.mark.parametrize("power", [3, 6, 9, 12, 13, 14, 16, 20])
def test_a_reaction_of_any_speed_ends_and_leaves_the_others_alone(power: int) -> None:
    """A -> B as fast as can be, beside C -> D with k = 1: the closed forms of both."""
    scheme = Scheme.of([({0: 1.0}, {1: 1.0}, 10.0**power, 0.0), ({2: 1.0}, {3: 1.0}, 1.0, 0.0)], 4)
    found = run(scheme, [1.0, 0.0, 1.0, 0.0], 1.0, 1.0, DEFAULT)
    np.testing.assert_allclose(found, [0.0, 1.0, np.exp(-1.0), 1.0 - np.exp(-1.0)], atol=2e-3)
    np.testing.assert_allclose(found[[0, 2]] + found[[1, 3]], 1.0, rtol=1e-12)


@pytest.mark.parametrize("order", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("time", [0.5, 0.9, 2.0])
def test_a_fractional_order_uses_its_reactant_up_in_time(order: float, time: float) -> None:
    """dA/dt = -A^n ends at 1 / (1 - n): A = (1 - (1 - n) t)^(1 / (1 - n)) until then."""
    scheme = Scheme(np.array([[-1.0, 1.0]]), np.array([[order, 0.0]]), np.ones(1), np.zeros(1))
    expected = max(1.0 - (1.0 - order) * time, 0.0) ** (1.0 / (1.0 - order))
    for tolerance, allowed in ((DEFAULT, 2e-3), (TIGHT, 1e-6)):
        found = run(scheme, [1.0, 0.0], 1.0, time, tolerance)
        assert found[0] == pytest.approx(expected, abs=allowed)
        assert found.sum() == pytest.approx(1.0, rel=1e-12)


def test_what_is_too_stiff_is_given_up_and_changes_nothing() -> None:
    """A and B that turn into each other 1e9 times while C is used up: no explicit method gets there."""
    steps: list[Step] = [({0: 1.0}, {1: 1.0}, 1e9, 0.0), ({1: 1.0}, {0: 1.0}, 1e9, 0.0)]
    scheme = Scheme.of(steps, 2)
    row = np.zeros(AMOUNTS + 2)
    row[AMOUNTS:] = 1.0, 0.0
    network = scheme.network
    work = np.zeros(react_work_size(network.arrays))
    assert react(row, network.handle, 1.0, ROOM, 1.0, *DEFAULT, work) == -1
    assert row[AMOUNTS:].tolist() == [1.0, 0.0]
