"""Kinetics of the tier ``real``: closed forms, Cantera on random stiff networks, energy and atoms, what is refused."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_tier import enthalpy_of, filled, give_enthalpy, network, react
from scipy.integrate import solve_ivp
from scipy.linalg import null_space

from chemlab.kernels.arrays import FloatArray
from chemlab.kernels.tables import Table
from chemlab.physics.chemistry import AMOUNTS, TEMPERATURE
from chemlab.physics.constants import GAS_CONSTANT

Step = Mapping[str, Any]

ROOM = 298.15
USUAL, TIGHT = (1e-3, 1e-9), (1e-8, 1e-11)
"""rtol, atol (mol/L): a catalyst of 1e-7 mol/L, as H+ in pure water, must count"""


class Result(NamedTuple):
    """What came of a reaction."""

    steps: int
    amounts: FloatArray
    temperature: float


def run(
    table: Table[Any],
    amounts: Sequence[float] | FloatArray,
    dt: float,
    jacket: float = ROOM,
    transfer: float = math.inf,
    tolerance: tuple[float, float] = TIGHT,
    start: float = ROOM,
) -> Result:
    """Let a vessel react: amounts in mol, 1 L for each mol."""
    row = filled(table, amounts, start)
    steps = react(row, table, dt, jacket, transfer, tolerance)
    return Result(steps, row[AMOUNTS:].copy(), float(row[TEMPERATURE]))


def litre(species: int, amounts: Sequence[float]) -> dict[str, FloatArray]:
    """The field that makes the contents a litre."""
    return {"molar_volume": np.full(species, 1.0 / sum(amounts))}


@pytest.mark.parametrize(("tolerance", "allowed"), [(USUAL, 2e-3), (TIGHT, 1e-7)])
def test_first_order_decay_is_exponential(tolerance: tuple[float, float], allowed: float) -> None:
    table = network([{"reactants": {0: 1}, "products": {1: 1}, "k": 2.0}], 2)
    for t in (0.01, 0.3, 1.0, 3.0):
        left = 0.7 * np.exp(-2.0 * t)
        assert run(table, [0.7, 0.1], t, tolerance=tolerance).amounts == pytest.approx([left, 0.8 - left], abs=allowed)


@pytest.mark.parametrize("power", [3, 6, 9, 12, 16, 20])
def test_a_reaction_of_any_speed_ends_and_leaves_the_others_alone(power: int) -> None:
    """A -> B as fast as can be, beside C -> D with k = 1: the closed forms of both."""
    steps = [
        {"reactants": {0: 1}, "products": {1: 1}, "k": 10.0**power},
        {"reactants": {2: 1}, "products": {3: 1}, "k": 1.0},
    ]
    found = run(network(steps, 4), [1.0, 0.0, 1.0, 0.0], 1.0, tolerance=USUAL).amounts
    np.testing.assert_allclose(found, [0.0, 1.0, np.exp(-1.0), 1.0 - np.exp(-1.0)], atol=2e-3)
    np.testing.assert_allclose(found[[0, 2]] + found[[1, 3]], 1.0, rtol=1e-12)


@pytest.mark.parametrize("speed", [3.0, 3e6, 3e12])
def test_a_reversible_reaction_comes_to_its_equilibrium(speed: float) -> None:
    """A <-> B: the distance from K decays with k + k / K."""
    table = network([{"reactants": {0: 1}, "products": {1: 1}, "k": speed, "equilibrium": 4.0}], 2)
    for t in (0.1, 0.4, 10.0):
        left = 0.2 + 0.7 * np.exp(-1.25 * speed * t)
        assert run(table, [0.9, 0.1], t).amounts == pytest.approx([left, 1.0 - left], abs=1e-6)
        left = 0.2 - 0.2 * np.exp(-1.25 * speed * t)
        assert run(table, [0.0, 1.0], t).amounts == pytest.approx([left, 1.0 - left], abs=1e-6)


def test_an_equilibrium_is_that_of_its_volume() -> None:
    """A <-> 2 B with K = 0.5 mol/L: b^2 / a = K in mol/L, in one litre and in ten."""
    step = {"reactants": {0: 1}, "products": {1: 2}, "k": 10.0, "equilibrium": 0.5}
    for volume in (1.0, 10.0):
        a, b = run(network([step], 2, molar_volume=np.full(2, volume)), [1.0, 0.0], 1000.0 * volume).amounts
        assert b * b / (a * volume) == pytest.approx(0.5, rel=1e-6)
        assert a + b / 2.0 == pytest.approx(1.0, rel=1e-13)


def test_an_equilibrium_follows_van_t_hoff() -> None:
    step = {"reactants": {0: 1}, "products": {1: 1}, "k": 1e9, "energy": 40e3, "equilibrium": 4.0}
    for temperature in (273.15, 350.0):
        a, b = run(network([step], 2, [0.0, -30e3]), [1.0, 0.0], 1e6, jacket=temperature).amounts
        expected = 4.0 * np.exp(30e3 / GAS_CONSTANT * (1.0 / temperature - 1.0 / ROOM))
        assert b / a == pytest.approx(expected, rel=1e-5)


def test_what_is_absent_holds_a_reverse_reaction_too() -> None:
    """A + B <-> C + D without A and D: nothing."""
    step = {"reactants": {0: 1, 1: 1}, "products": {2: 1, 3: 1}, "k": 1e3, "equilibrium": 1e-3}
    assert run(network([step], 4), [0.0, 1.0, 1.0, 0.0], 10.0).amounts.tolist() == [0.0, 1.0, 1.0, 0.0]


def test_a_catalyst_multiplies_and_is_not_used_up() -> None:
    step = {"reactants": {0: 1}, "products": {1: 1}, "k": 2.0, "catalysts": {2: 1.5}}
    amounts = [0.7, 0.0, 0.3]
    done = run(network([step], 3, **litre(3, amounts)), amounts, 0.8).amounts
    assert done[0] == pytest.approx(0.7 * np.exp(-2.0 * 0.3**1.5 * 0.8), rel=1e-6)
    assert done[2] == 0.3
    assert run(network([step], 3), [0.7, 0.3, 0.0], 0.8).amounts.tolist() == [0.7, 0.3, 0.0]
    step |= {"k": 50.0, "equilibrium": 3.0}  # which it does not move
    for catalyst in (0.01, 1.0):
        a, b, _ = run(network([step], 3), [1.0, 0.2, catalyst], 1e4).amounts
        assert b / a == pytest.approx(3.0, rel=1e-6)


def test_a_product_may_catalyse_its_own_reaction() -> None:
    """A -> B at k a b, the logistic curve."""
    step = {"reactants": {0: 1}, "products": {1: 1}, "k": 5.0, "catalysts": {1: 1.0}}
    done = run(network([step], 2), [0.99, 0.01], 1.2).amounts
    assert done[1] == pytest.approx(1.0 / (1.0 + 99.0 * np.exp(-5.0 * 1.2)), rel=1e-6)


def test_an_inhibitor_divides_the_rate() -> None:
    """By 1 + K c; with its own product as the inhibitor, ln(a0 / a) (1 + K a0) - K (a0 - a) = k t."""
    step = {"reactants": {0: 1}, "products": {1: 1}, "k": 2.0, "inhibitors": {2: 40.0}}
    done = run(network([step], 3), [0.7, 0.1, 0.2], 3.0).amounts
    assert done[0] == pytest.approx(0.7 * np.exp(-2.0 * 3.0 / (1.0 + 40.0 * 0.2)), rel=1e-6)
    step = {"reactants": {0: 1}, "products": {1: 1}, "k": 2.0, "inhibitors": {1: 5.0}}
    a = run(network([step], 2), [1.0, 0.0], 1.7).amounts[0]
    assert -np.log(a) * 6.0 - 5.0 * (1.0 - a) == pytest.approx(2.0 * 1.7, rel=1e-6)


@pytest.mark.parametrize("order", [2 / 3, 0.5, 0.1])
@pytest.mark.parametrize("time", [0.5, 0.9, 4.0])
def test_a_surface_is_used_up_in_time(order: float, time: float) -> None:
    """dA/dt = -A^n ends at 1 / (1 - n): A = (1 - (1 - n) t)^(1 / (1 - n)) until then; spheres have n = 2/3."""
    table = network([{"reactants": {0: 1}, "products": {1: 1}, "k": 1.0, "orders": {0: order}}], 2)
    found = run(table, [1.0, 0.0], time, tolerance=USUAL).amounts
    assert found[0] == pytest.approx(max(1.0 - (1.0 - order) * time, 0.0) ** (1.0 / (1.0 - order)), abs=2e-3)
    assert found.sum() == pytest.approx(1.0, rel=1e-12)


def test_the_adiabatic_rise_is_the_heat_over_the_heat_capacity_of_the_products() -> None:
    """A + B -> C, 80 kJ/mol: 0.4 mol of it in 5.6 mol of something else."""
    k = 1e3 * np.exp(20e3 / (GAS_CONSTANT * ROOM))
    step = {"reactants": {0: 1, 1: 1}, "products": {2: 1}, "k": k, "energy": 20e3}
    capacity = np.array([90.0, 70.0, 130.0, 180.0])
    table = network([step], 4, [-10e3, 0.0, -90e3, -5e3], heat_capacity=capacity)
    done = run(table, [0.4, 0.4, 0.0, 5.6], 1e4, transfer=0.0, tolerance=USUAL)
    assert done.amounts == pytest.approx([0.0, 0.0, 0.4, 5.6], abs=1e-5)
    # 32 kJ at 298.15 K warm 0.4 mol of C and 5.6 of the other: 1060 J/K.
    assert done.temperature == pytest.approx(ROOM + 32e3 / 1060.0, abs=0.01)


def test_a_jacket_alone_has_a_closed_form() -> None:
    table = network([{"reactants": {0: 1}, "products": {1: 1}, "k": 1.0}], 2)
    done = run(table, [0.0, 2.0], 30.0, jacket=350.0, transfer=5.0, start=280.0)
    assert done.temperature == pytest.approx(350.0 - 70.0 * np.exp(-5.0 * 30.0 / 200.0), rel=1e-12)
    assert done.steps == 0
    assert run(table, [0.0, 2.0], 30.0, jacket=350.0, transfer=0.0, start=280.0).temperature == 280.0
    for perfect in (math.inf, -1.0):
        assert run(table, [0.0, 2.0], 30.0, jacket=350.0, transfer=perfect, start=280.0).temperature == 350.0


@pytest.mark.parametrize("transfer", [0.5, 20.0, 1e6])
def test_a_jacket_and_a_reaction_without_activation_energy(transfer: float) -> None:
    """C dT/dt = q k a(t) + U (Tj - T) with a = exp(-k t): a sum of two exponentials."""
    k, q, capacity, jacket = 0.3, 15e3, 100.0, 290.0
    table = network([{"reactants": {0: 1}, "products": {1: 1}, "k": k}], 2, [0.0, -q])
    done = run(table, [1.0, 0.0], 4.0, jacket=jacket, transfer=transfer, start=310.0)
    rate = transfer / capacity
    driven = q * k / capacity * (np.exp(-k * 4.0) - np.exp(-rate * 4.0)) / (rate - k)
    assert done.temperature == pytest.approx(jacket + 20.0 * np.exp(-rate * 4.0) + driven, abs=1e-4)


def test_enthalpy_and_temperature_are_each_others_inverse() -> None:
    """Crystals hold less by their heat of fusion."""
    table = network(
        [], 3, [-100e3, 50e3, -20e3], heat_capacity=np.array([80.0, 120.0, 60.0]), fusion=np.array([0.0, 12e3, 0.0]),
        dissolved=np.array([1]), dissolved_at=np.array([-1, 0, -1]), solvents=np.arange(2),
    )  # fmt: skip
    row = filled(table, [1.5, 0.8, 2.0], 320.0, {1: [0.3, 0.1]})
    expected = -150e3 + 40e3 - 40e3 + (120.0 + 96.0 + 120.0) * (320.0 - ROOM) - 0.4 * 12e3
    assert enthalpy_of(row, table.handle) == pytest.approx(expected, rel=1e-14)
    give_enthalpy(row, expected + 3360.0, table.handle)
    assert row[TEMPERATURE] == pytest.approx(330.0, rel=1e-13)


class Problem(NamedTuple):
    """A random stiff network and what is done with it."""

    steps: list[Step]
    masses: npt.NDArray[np.int64]
    formation: FloatArray
    capacity: FloatArray
    amounts: FloatArray
    dt: float
    jacket: float
    transfer: float

    def table(self) -> Table[Any]:
        return network(self.steps, len(self.masses), self.formation, heat_capacity=self.capacity)


def problem(seed: int) -> Problem:
    """2 to 6 reactions, 4 to 7 species, k(298 K) 1e-3 to 1e6, half reversible, some catalysed, in any surroundings."""
    rng = np.random.default_rng(seed)
    species, reactions = int(rng.integers(4, 8)), int(rng.integers(2, 7))
    masses = rng.integers(1, 4, species)
    formation, capacity = rng.uniform(-40e3, 40e3, species), rng.uniform(60.0, 200.0, species)
    speeds = np.concatenate([[1e-3, 1e6], 10.0 ** rng.uniform(-3.0, 6.0, reactions - 2)])
    steps: list[Step] = []
    for speed in speeds:
        chosen = [int(j) for j in rng.permutation(species)]
        before, after = rng.integers(1, 3, 2)
        reactants = {j: float(rng.integers(1, 3)) if before == 1 else 1.0 for j in chosen[:before]}
        products = {j: float(rng.integers(1, 3)) for j in chosen[before : before + after]}
        scale = sum(x * masses[j] for j, x in reactants.items()) / sum(x * masses[j] for j, x in products.items())
        products = {j: x * scale for j, x in products.items()}
        heat = sum(x * formation[j] for j, x in products.items()) - sum(x * formation[j] for j, x in reactants.items())
        energy = max(rng.uniform(0.0, 80e3), heat + 1e3)
        k = speed * np.exp(energy / (GAS_CONSTANT * ROOM))
        step = {"reactants": reactants, "products": products, "energy": energy, "k": k}
        if rng.random() < 0.5:
            step["equilibrium"] = 10.0 ** rng.uniform(-2.0, 2.0)
        if rng.random() < 0.3:
            step["catalysts"] = {chosen[-1]: float(rng.choice([0.5, 1.0]))}
        steps.append(step)
    return Problem(
        steps=steps,
        masses=masses,
        formation=formation,
        capacity=capacity,
        amounts=rng.uniform(0.1, 1.0, species),
        dt=10.0 ** rng.uniform(-1.0, 2.0),
        jacket=rng.uniform(280.0, 330.0),
        transfer=[math.inf, 0.0, 10.0 ** rng.uniform(0.0, 3.0)][seed % 3],
    )


def by_cantera(given: Problem, start: float) -> tuple[FloatArray, float]:
    """(mol, K) at the end: an ideal gas of constant volume whose internal energy is our enthalpy."""
    ct = pytest.importorskip("cantera")
    names = [f"S{j}" for j in range(len(given.masses))]
    species = []
    for name, mass, formed, capacity in zip(names, given.masses, given.formation, given.capacity, strict=True):
        one = ct.Species(name, {"H": float(mass)})
        enthalpy_there, warming = formed + GAS_CONSTANT * ROOM, capacity + GAS_CONSTANT
        one.thermo = ct.ConstantCp(1.0, 1e5, 1e5, [ROOM, enthalpy_there * 1e3, 0.0, warming * 1e3])
        species.append(one)

    def named(*parts: Mapping[int, float]) -> dict[str, float]:
        return {names[j]: sum(part.get(j, 0.0) for part in parts) for j in {*parts[0], *parts[-1]}}

    def reaction(left: Mapping[int, float], right: Mapping[int, float], k: float, energy: float, step: Step) -> Any:
        made = ct.Reaction(named(left), named(right), ct.ArrheniusRate(k, 0.0, energy * 1e3))
        made.reversible, made.allow_nonreactant_orders = False, True
        made.orders = named(left, step.get("catalysts", {}))
        return made

    reactions = []
    for step in given.steps:
        left, right, k, energy = step["reactants"], step["products"], step["k"], step["energy"]
        reactions.append(reaction(left, right, k, energy, step))
        if "equilibrium" in step:
            heat = sum(x * given.formation[j] for j, x in right.items())
            heat -= sum(x * given.formation[j] for j, x in left.items())
            back = k / step["equilibrium"] * np.exp(-heat / (GAS_CONSTANT * ROOM))
            reactions.append(reaction(right, left, back, energy - heat, step))
    phase = {"thermo": "ideal-gas", "kinetics": "gas", "species": species}
    gas, outside = ct.Solution(**phase, reactions=reactions), ct.Solution(**phase, reactions=[])
    litres = given.amounts.sum()
    fractions = given.amounts / litres
    gas.TDX = start, float(fractions @ gas.molecular_weights), fractions
    reactor = ct.IdealGasReactor(gas, energy="off" if given.transfer == math.inf else "on", clone=False)
    reactor.volume = litres / 1000.0
    if 0.0 < given.transfer < math.inf:
        outside.TPX = given.jacket, 1e5, {names[0]: 1.0}
        wall = ct.Wall(ct.Reservoir(outside, clone=False), reactor, A=1.0, U=given.transfer)  # noqa: F841 - holds heat
    simulation = ct.ReactorNet([reactor])
    simulation.rtol, simulation.atol, simulation.max_steps = 1e-9, 1e-15, 1_000_000
    simulation.advance(given.dt)
    return np.asarray(reactor.phase.concentrations) * litres, float(reactor.phase.T)


# Of the first 42 Cantera's integrator gives two up.
@pytest.mark.parametrize("seed", sorted({*range(42)} - {10, 13}))
def test_random_stiff_networks_agree_with_cantera(seed: int) -> None:
    """Every species within 0.5 % (of the largest hundredth where there is less), at the usual tolerance."""
    given = problem(seed)
    start = given.jacket if given.transfer == math.inf else 300.0
    expected, temperature = by_cantera(given, start)
    done = run(given.table(), given.amounts, given.dt, given.jacket, given.transfer, USUAL, start=300.0)
    np.testing.assert_allclose(done.amounts, expected, rtol=5e-3, atol=5e-5 * given.amounts.sum())
    assert done.temperature == pytest.approx(temperature, abs=0.1)


def test_the_robertson_problem_agrees_with_an_implicit_solver() -> None:
    """A -> B, 2 B -> B + C, B + C -> A + C with constants from 0.04 to 3e7, for up to 4e5: as SciPy's Radau has it."""
    steps = [
        {"reactants": {0: 1}, "products": {1: 1}, "k": 0.04},
        {"reactants": {1: 2}, "products": {1: 1, 2: 1}, "k": 3e7},
        {"reactants": {1: 1, 2: 1}, "products": {0: 1, 2: 1}, "k": 1e4},
    ]

    def slope(_: float, c: FloatArray) -> list[float]:
        slow, fast, back = 0.04 * c[0], 3e7 * c[1] ** 2, 1e4 * c[1] * c[2]
        return [back - slow, slow - fast - back, fast]

    for t in (0.4, 40.0, 4e5):
        expected = solve_ivp(slope, (0.0, t), [1.0, 0.0, 0.0], method="Radau", rtol=1e-9, atol=1e-14).y[:, -1]
        done = run(network(steps, 3), [1.0, 0.0, 0.0], t, tolerance=(1e-3, 1e-9))
        np.testing.assert_allclose(done.amounts, expected, rtol=5e-3, atol=1e-6)
        done = run(network(steps, 3), [1.0, 0.0, 0.0], t, tolerance=(1e-7, 1e-13))
        np.testing.assert_allclose(done.amounts, expected, rtol=2e-6)


@given(st.integers(0, 2**32 - 1), st.sampled_from([USUAL, (1e-1, 1e-2), (1e-5, 1e-8)]))
@settings(max_examples=100)
def test_atoms_and_energy_are_conserved_and_nothing_is_negative(seed: int, tolerance: tuple[float, float]) -> None:
    """Every linear invariant to 1e-12, and without a jacket the enthalpy to 1e-9, however careless the tolerance."""
    case = problem(seed)._replace(transfer=0.0)
    table = case.table()
    row = filled(table, case.amounts, 300.0)
    before = enthalpy_of(row, table.handle)
    for part in (0.01, 0.09, 0.9):
        assert react(row, table, part * case.dt, 300.0, 0.0, tolerance) >= 0
        assert np.isfinite(row).all()
        assert row[AMOUNTS:].min() >= 0.0
    scale = np.abs(case.formation) @ case.amounts
    assert enthalpy_of(row, table.handle) == pytest.approx(before, abs=1e-9 * scale)
    invariants = null_space(np.asarray(table.arrays.stoichiometry))
    np.testing.assert_allclose(row[AMOUNTS:] @ invariants, case.amounts @ invariants, rtol=0.0, atol=1e-11)


def test_what_does_not_end_is_given_up_and_changes_nothing() -> None:
    """Lotka and Volterra's foxes and hares, for two million generations."""
    steps = [
        {"reactants": {0: 1}, "products": {0: 2}, "k": 1.0},
        {"reactants": {0: 1, 1: 1}, "products": {1: 2}, "k": 1.0},
        {"reactants": {1: 1}, "products": {2: 1}, "k": 1.0},
    ]
    done = run(network(steps, 3), [0.3, 0.5, 0.2], 2e6, jacket=310.0, tolerance=(1e-6, 1e-9))
    assert done == (-1, pytest.approx([0.3, 0.5, 0.2], abs=0.0), ROOM)


def test_nothing_reacts_without_liquid_time_or_reactant() -> None:
    table = network([{"reactants": {0: 1, 1: 1}, "products": {2: 1}, "k": 5.0}], 3)
    assert run(table, [0.3, 0.2, 0.1], 0.0, jacket=350.0) == (0, pytest.approx([0.3, 0.2, 0.1], abs=0.0), ROOM)
    assert run(table, [0.3, 0.0, 0.1], 1.0) == (0, pytest.approx([0.3, 0.0, 0.1], abs=0.0), ROOM)
    table = network([{"reactants": {0: 1, 1: 1}, "products": {2: 1}, "k": 5.0}], 3, role=np.full(3, 3))
    assert run(table, [0.3, 0.2, 0.1], 1.0) == (0, pytest.approx([0.3, 0.2, 0.1], abs=0.0), ROOM)
    empty = np.zeros(AMOUNTS + 3)
    assert react(empty, table, 1.0, 350.0, math.inf, USUAL) == 0
    assert not empty.any()


def test_crystals_do_not_react_and_layers_keep_their_shares() -> None:
    """A (0.5 of 2 mol dissolved, 4 to 1 in two layers) -> B, which is nowhere yet."""
    own = {"dissolved": np.arange(3), "dissolved_at": np.arange(3), "solvents": np.arange(2)}
    step = {"reactants": {0: 1}, "products": {1: 1}, "k": 1.0}
    table = network([step], 3, molar_volume=np.full(3, 0.2), **own)
    row = filled(table, [2.0, 0.0, 3.0], ROOM, {0: [0.4, 0.1], 2: [1.0, 2.0]})
    react(row, table, 0.7, ROOM, math.inf, TIGHT)
    left = 0.5 * np.exp(-0.7)
    assert row[AMOUNTS : AMOUNTS + 3] == pytest.approx([1.5 + left, 0.5 - left, 3.0], rel=1e-6)
    assert row[AMOUNTS + 3 : AMOUNTS + 5] == pytest.approx([0.8 * left, 0.2 * left], rel=1e-6)
    share = (0.8 * left + 1.0) / (left + 3.0)
    made = 0.5 - left
    assert row[AMOUNTS + 5 : AMOUNTS + 7] == pytest.approx([made * share, made * (1.0 - share)], rel=1e-6)
