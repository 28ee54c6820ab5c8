"""No sequence of operations may break atoms, positivity, finiteness, solutes in their solvents, batch invariance."""

import numpy as np
import numpy.typing as npt
import pytest
from helpers import PIXELS, TRACE, Glassware, composition, four_solvents, mapping, slow_but
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from chemlab.agents.random_policy import RandomPolicy
from chemlab.config.loading import load_scenario
from chemlab.config.materials import COLDEST_K, HOTTEST_K
from chemlab.config.scenario import Scenario
from chemlab.envs.global_state import GlobalState
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.backends import vapor_pressure
from chemlab.physics.chemistry import AIR, AMOUNTS, CAPACITY, CLOCK, PRESENT, ROLE_GAS, ROLE_ION, TEMPERATURE
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX, Shelf
from chemlab.physics.thermal import pressure

IntArray = npt.NDArray[np.int64]

RUNNING = 0


def check_shelf(shelf: Shelf, swelling: float = 1e-6) -> None:
    """Amounts, temperatures, clocks, pressures and dissolved amounts of every vessel of every laboratory."""
    for array in (shelf.vessels, shelf.stock, shelf.waste):
        assert np.isfinite(array).all()
    assert shelf.amounts.min() >= 0.0
    assert shelf.stock.min() >= 0.0
    assert shelf.waste.min() >= 0.0
    assert shelf.dissolved.min(initial=0.0) >= 0.0
    assert (shelf.amounts[..., shelf.known().air] == 0.0).all()
    standing = shelf.vessels[..., PRESENT] > 0.0
    assert (shelf.vessels[~standing] == 0.0).all()
    rows = shelf.vessels[standing]
    assert rows[:, AIR].min() >= 0.0
    assert rows[:, CAPACITY].min() > 0.0
    # With real physics what boils off cools what it leaves, and what runs away heats it.
    assert rows[:, TEMPERATURE].min() > 200.0
    assert rows[:, TEMPERATURE].max() < (1500.0 if shelf.chemistry.tier == "real" else 1000.0)
    assert rows[:, CLOCK].min() >= T_MIX
    assert rows[:, CLOCK].max() <= CLOCK_SETTLED
    known = shelf.known()
    filled = shelf.amounts[standing] @ np.where(known.role == ROLE_GAS, 0.0, known.molar_volume)
    assert (filled <= rows[:, CAPACITY] * (1.0 + swelling)).all()  # dissolving moves the volume by a billionth
    solvents, solutes = known.solvents, known.dissolved
    wet = (shelf.amounts[..., solvents].max(axis=-1, initial=0.0) > TRACE) & standing
    dissolved, there = shelf.dissolved[wet].sum(axis=-1), shelf.amounts[wet][:, solutes]
    # What can crystallize may lie there undissolved.
    lying = np.asarray(getattr(known, "fusion", np.zeros(len(shelf.layout.materials))))[solutes] > 0.0
    np.testing.assert_allclose(dissolved[:, ~lying], there[:, ~lying], rtol=1e-9, atol=1e-12)
    assert (dissolved[:, lying] <= there[:, lying] * (1.0 + 1e-9) + 1e-12).all()


def check_seen(laboratories: Laboratories, members: IntArray) -> None:
    """Every agent's observation is in its box, and no mask is all zero."""
    for agent in range(len(laboratories.agents)):
        observation = laboratories.observe(agent, members)
        assert np.isfinite(observation).all()
        assert 0.0 <= observation.min() <= observation.max() <= 1.0
        mask = laboratories.mask(agent, members)
        if mask is not None:
            assert np.isin(mask, (0, 1)).all()
            assert mask.any(axis=1).all()


def check_pressures(laboratories: Laboratories) -> None:
    """Pressures of standing vessels are finite and not negative."""
    shelf = laboratories.shelf
    for row in shelf.rows[shelf.rows[:, PRESENT] > 0.0]:
        for value in (pressure(row, shelf.chem()), vapor_pressure(row, shelf.chem())):
            assert np.isfinite(value)
            assert value >= 0.0


def random_turns(laboratories: Laboratories, rng: np.random.Generator, policy: RandomPolicy, bold: float) -> int:
    """One turn of whoever has it in each running laboratory; with probability ``bold`` regardless of the mask."""
    turns = laboratories.state.cursor + 1
    played = 0
    for agent in range(len(laboratories.agents)):
        members = np.flatnonzero((turns == agent) & (laboratories.state.status == RUNNING))
        if not len(members):
            continue
        mask = laboratories.mask(agent, members)
        if mask is None:
            actions = rng.random((len(members), *laboratories.action_space(agent).shape))
            # Corners of the box are where contents overflow and reagents run out.
            actions = np.where(rng.random(actions.shape) < 0.2, actions.round(), actions)
        else:
            mask = np.where(rng.random((len(members), 1)) < bold, np.ones_like(mask), mask)
            actions = policy.act(np.empty((len(members), 0), dtype=np.float32), mask, members, members)
        laboratories.act(agent, members, actions)
        played += len(members)
    return played


@pytest.mark.parametrize("scenario", slow_but(["wurtz_two_lines", "refine", "aspirin"], "wurtz_two_lines"))
def test_random_agents_break_no_invariant(scenario: str) -> None:
    """Twenty thousand turns of random agents, one in ten of them against the mask: atoms to 1e-9 and all the rest."""
    laboratories = Laboratories(scenario, 40)
    laboratories.begin()
    rng, policy = np.random.default_rng(5), RandomPolicy(0, 6)
    _, atoms_in = composition(laboratories.scenario)
    shelf = laboratories.shelf
    start = laboratories.total() @ atoms_in

    def check(members: IntArray) -> None:
        found, first = (laboratories.total() @ atoms_in)[members], start[members]
        np.testing.assert_allclose(found[:, :-1], first[:, :-1], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found[:, -1], 0.0, atol=1e-9)  # the charge
        assert np.isfinite(laboratories.rewards).all()
        assert np.isfinite(laboratories.cost).all()
        assert laboratories.cost.min() >= 0.0
        # An acid takes a millilitre more than its ions, which spills when the vessel is next worked on.
        check_shelf(shelf, 1e-3 if laboratories.scenario.family.acid else 1e-6)
        check_seen(laboratories, members)

    turns, rounds, experiments = 0, 0, np.zeros(len(laboratories.experiments))
    events = np.zeros(laboratories.safety_totals.shape[1])
    while turns < 20_000:
        turns += random_turns(laboratories, rng, policy, 0.1)
        rounds += 1
        experiments += laboratories.busy.any(axis=1)
        events += laboratories.safety_totals.sum(axis=0)
        over = np.flatnonzero(laboratories.state.status != RUNNING)
        if rounds % 12 == 0:
            check(laboratories.members)
        elif len(over):
            check(over)
        if len(over):
            laboratories.reset(over)
            start[over] = laboratories.total()[over] @ atoms_in
    check_pressures(laboratories)
    assert (experiments > 0).all()  # every bench was used
    # It is not tame: spills, relief, boiling dry, dry heating and metal in water all happen.
    assert (events > 0.0).all() or scenario != "wurtz_two_lines", events
    assert laboratories.state.ticks.max() > 0


def extreme(name: str) -> Scenario:
    """A shipped scenario with apparatus as extreme as files may have it, in thin air, and instruments all of noise."""
    values, benches = mapping(name), {}
    for key, bench in values["benches"].items():
        if bench["kind"] == "reaction":
            benches[key] = {"temperature_k": {"low": COLDEST_K, "high": HOTTEST_K, "step": 3000.0}}
        else:
            benches[key] = {"hottest_k": HOTTEST_K, "coolest_k": COLDEST_K, "process": bench["process"]}
            for process in bench["process"]:
                amounts = {"heat": [1e4, 1e-3, -1e-3, -1e4], "pour": [1.0, 1.0 - 1e-12, 1e-9], "dry": [1e-3, 1e6]}
                process["magnitudes"] = amounts.get(process["kind"], process["magnitudes"])
    noisy = {"instruments": {instrument: {"noise": 1.0} for instrument in values.get("instruments", {})}}
    return load_scenario({"base": name, "name": "extreme", "ambient_pressure_kpa": 60.0, "benches": benches, **noisy})


def spoil(shelf: Shelf, rng: np.random.Generator) -> None:
    """Empty vessels but for traces and denormal numbers, and make them as cold or hot as vessels can be."""
    solid = np.isin(shelf.known().role, (ROLE_ION, ROLE_GAS))
    for row in shelf.rows[(shelf.rows[:, PRESENT] > 0.0) & (rng.random(len(shelf.rows)) < 0.3)]:
        amounts, fluids = row[AMOUNTS : AMOUNTS + len(solid)], row[AMOUNTS + len(solid) :]
        kind = rng.integers(5)
        if kind == 0:
            row[AMOUNTS:] *= rng.choice([1e-12, 1e-9, 1e-30, 1e-300])
        elif kind == 1:
            amounts[:], fluids[:] = np.where(solid, 0.0, 5e-324 * rng.integers(0, 5, len(solid))), 0.0
        elif kind == 2:
            row[AMOUNTS:] = 0.0
        row[TEMPERATURE] = rng.choice([COLDEST_K, HOTTEST_K, rng.uniform(COLDEST_K, HOTTEST_K), 400.0])


@pytest.mark.parametrize("scenario", slow_but(["crude", "refine", "recrystallization"], "crude"))
def test_extremes_leave_nothing_out_of_bounds(scenario: str) -> None:
    """Extreme actions on denormal amounts, traces or nothing, at extreme temperatures: all stays within bounds."""
    laboratories = Laboratories(extreme(scenario), 12)
    laboratories.begin()
    rng, policy = np.random.default_rng(7), RandomPolicy(0, 8)
    _, atoms_in = composition(laboratories.scenario)
    whole, shelf = GlobalState(laboratories), laboratories.shelf
    turns, rounds = 0, 0
    start = laboratories.total() @ atoms_in
    while turns < 1200:
        try:
            turns += random_turns(laboratories, rng, policy, 0.1)
        except ArithmeticError:  # too stiff: at 5000 K the paper's explicit method may give up, which changes nothing
            laboratories.reset(laboratories.members)
            start = laboratories.total() @ atoms_in
        rounds += 1
        assert np.isfinite(shelf.rows).all()
        assert shelf.rows[:, AMOUNTS:].min() >= 0.0
        standing = shelf.rows[shelf.rows[:, PRESENT] > 0.0, TEMPERATURE]
        assert standing.min() >= COLDEST_K
        assert standing.max() <= HOTTEST_K
        np.testing.assert_allclose(laboratories.total() @ atoms_in, start, rtol=1e-9, atol=1e-9)
        check_seen(laboratories, laboratories.members)
        check_pressures(laboratories)
        for state in whole.see(laboratories.members):
            assert whole.space.contains(state)
        over = np.flatnonzero(laboratories.state.status != RUNNING)
        if len(over):
            laboratories.reset(over)
        if rounds % 4 == 0:
            spoil(shelf, rng)
        start = laboratories.total() @ atoms_in


@pytest.mark.parametrize("bench", ["ext", "dit"])
def test_pictures_are_of_the_vessels_as_they_are(bench: str) -> None:
    """After every random action, legal or not, a bench's layer profiles are those of its vessels at that moment."""
    batch = ExperimentBatch("wurtz_dodecane", bench, 6)
    glass = Glassware("wurtz_dodecane", 1)
    for member in batch.members:
        batch.seed(member, int(member))
    batch.reset(batch.members)
    rng = np.random.default_rng(2)
    for _ in range(60):
        over = np.flatnonzero(batch.experiments.ended)
        if len(over):
            batch.reset(over)
        batch.act(rng.integers(0, batch.bench.action_space.n - 1, 6))
        profiles = batch.experiments.profile.reshape(-1, *batch.experiments.profile.shape[2:])
        columns = batch.experiments.layers.reshape(-1, batch.experiments.layers.shape[2])
        for row, shares, layers in zip(batch.shelf.rows, profiles, columns, strict=True):
            glass.rows[0] = row
            glass.partition(0)
            np.testing.assert_allclose(glass.rows[0], row, rtol=1e-12, atol=1e-15)
            names, fresh = glass.profile(0)
            assert (layers[: len(names) + 1] == glass.layers[: len(names) + 1]).all()
            np.testing.assert_allclose(shares[: len(names)], fresh, rtol=0.0, atol=1e-9)


ADDED = ["water", "diethyl_ether", "hexane", "ethyl_acetate", "dodecane", "1-chlorohexane", "Na", "NaCl", "NaOH"]


class TwoVessels(RuleBasedStateMachine):
    """Pour, drain, add, mix, settle, heat, cool, react and separate, in any order."""

    @initialize(capacities=st.tuples(st.floats(0.05, 2.0), st.floats(0.05, 2.0)))
    def stand(self, capacities: tuple[float, float]) -> None:
        self.glass = Glassware(four_solvents(), 2)
        for position, capacity in enumerate(capacities):
            self.glass.fill(position, {}, capacity)
        self.atoms = self.glass.atoms()

    def settle_down(self) -> None:
        """What benches do after every operation."""
        for position in (0, 1):
            self.glass.phases(position)
            self.glass.partition(position)

    @rule(position=st.integers(0, 1), name=st.sampled_from(ADDED), mol=st.floats(0.0, 3.0))
    def add(self, position: int, name: str, mol: float) -> None:
        self.glass.add(position, name, mol)
        self.atoms += mol * composition(self.glass.scenario)[1][self.glass.index(name)]
        self.settle_down()

    @rule(source=st.integers(0, 1), fraction=st.floats(0.0, 1.0))
    def pour(self, source: int, fraction: float) -> None:
        self.glass.pour(source, 1 - source, fraction)
        self.settle_down()

    @rule(source=st.integers(0, 1), pixels=st.floats(0.0, float(PIXELS)))
    def drain(self, source: int, pixels: float) -> None:
        self.glass.drain(source, 1 - source, pixels)
        self.settle_down()

    @rule(position=st.integers(0, 1), by=st.floats(-6.0, 6.0))
    def turn(self, position: int, by: float) -> None:
        self.glass.turn(position, by)

    @rule(source=st.integers(0, 1), kilojoules=st.floats(-100.0, 300.0))
    def heat(self, source: int, kilojoules: float) -> None:
        self.glass.heat(source, 1 - source, 1000.0 * kilojoules)
        self.settle_down()

    @rule(position=st.integers(0, 1))
    def phases(self, position: int) -> None:
        self.glass.phases(position)

    @invariant()
    def nothing_is_lost(self) -> None:
        if hasattr(self, "atoms"):
            np.testing.assert_allclose(self.glass.atoms(), self.atoms, rtol=1e-9, atol=1e-9)

    @invariant()
    def vessels_are_sound(self) -> None:
        if not hasattr(self, "glass"):
            return
        self.glass.check()
        assert self.glass.waste.min() >= 0.0
        assert self.glass.events.min() >= 0.0
        for position in (0, 1):
            row = self.glass.rows[position]
            assert self.glass.volume(position) <= row[CAPACITY] * (1.0 + 1e-6)
            assert 273.0 < row[TEMPERATURE] < 700.1
            assert np.isfinite(pressure(row, self.glass.chem))
            _, shares = self.glass.profile(position)
            np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=0.0, atol=1e-9)


class TestTwoVessels(TwoVessels.TestCase):
    """Runs the state machine."""

    settings = settings(max_examples=60, stateful_step_count=25)
