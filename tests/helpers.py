"""What the tests share: a bench top of vessels on which single kernels run, and bookkeeping of atoms.

Numbers that tests compare with come from ``scenario.materials`` (the data files), not from the arrays kernels read.
"""

import functools
import hashlib
import importlib.util
import json
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from chemlab.config.loading import dump_scenario, load_scenario
from chemlab.config.materials import Material
from chemlab.config.scenario import SAFETY_EVENTS, Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.players import Memory, Watching
from chemlab.kernels.arrays import FloatArray, declared
from chemlab.kernels.tables import Table
from chemlab.lab.engine import Laboratories
from chemlab.physics.backends import heat, law_addresses, partition, settle_phases
from chemlab.physics.chemistry import AMOUNTS, CLOCK, TEMPERATURE, Chemistry, network_fields
from chemlab.physics.constants import SOLIDS
from chemlab.physics.shelf import T_MIX, Shelf
from chemlab.physics.stratification import profile
from chemlab.physics.transfer import add, drain, pour, turn_clock
from chemlab.roles.manager_actions import SUBMIT, WAIT

PIXELS = 100
TRACE = 1e-9
"""mol; tests call a solvent present only when there is clearly more or clearly less of it than the kernels' trace."""


def slow_but(values: Iterable[Any], *quick: Any) -> list[Any]:
    """Cases of a test of which only ``quick`` run by default; with ``-m ""`` all of them do. A tuple is a case's
    arguments."""
    return [
        value
        if value in quick
        else pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.slow)
        for value in values
    ]


@functools.cache
def script(path: str) -> ModuleType:
    """A script of the repository, by its path there, as a module."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, Path(__file__).parents[1] / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FEATURED = ("crude", "failing", "recrystallization", "refine", "relay", "runaway", "unlabelled", "wurtz_two_lines")
"""Shipped scenarios that together have every feature of them all (``tests/test_scenario.py`` says which): the cases of
a test of what holds in any scenario. ``tests/test_conformance.py`` checks every scenario."""


def mapping(name: str) -> dict[str, Any]:
    """All that a shipped scenario says, as a mapping to be changed."""
    return load_scenario(name).model_dump(mode="json", exclude_none=True)


def laboratory(values: dict[str, Any] | str, seed: int = 0, **arguments: Any) -> raw_env:
    """A laboratory at the start of an episode."""
    env = raw_env(load_scenario(values), **arguments)
    env.reset(seed=seed)
    return env


def manager(env: raw_env, *action: str | int) -> None:
    """Let the manager, which must have the turn, do something legal."""
    assert env.agent_selection == "manager_0"
    env.step(env.laboratories.actions.encode(*action))  # type: ignore[arg-type]
    assert not env.infos["manager_0"]["illegal_action"]


def allowed(env: raw_env, *action: str | int) -> bool:
    """Whether the manager's mask allows an action."""
    return bool(env.infos["manager_0"]["action_mask"][env.laboratories.actions.encode(*action)])  # type: ignore[arg-type]


def seeded(env: Any) -> Any:
    """The environment; PettingZoo's tests sample actions from the spaces."""
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(i)
    return env


def random_legal(space: Any, mask: npt.NDArray[Any] | None, rng: np.random.Generator) -> Any:
    """A random legal action: a number where there is a mask, else an array of a box."""
    return rng.random(space.shape, dtype=np.float32) if mask is None else int(rng.choice(np.flatnonzero(mask)))


def random_actions(space: gymnasium.Space[Any], steps: int, members: int, seed: int = 0) -> npt.NDArray[Any]:
    """[steps, members, ...] random actions, legal or not; 3 % of discrete ones end the experiment."""
    rng = np.random.default_rng(seed)
    if isinstance(space, gymnasium.spaces.Discrete):
        actions: npt.NDArray[Any] = rng.integers(space.n - 1, size=(steps, members))
        actions[rng.random(actions.shape) < 0.03] = space.n - 1
        return actions
    return rng.random((steps, members, *(space.shape or ())), dtype=np.float32)


class Watched(Watching):
    """Another manager's policy that keeps what each member plays, and whether that was legal."""

    def __init__(self, policy: Any, laboratories: Laboratories) -> None:
        super().__init__(policy, self._note)
        self.actions: list[list[int]] = [[] for _ in laboratories.members]
        self.legal: list[list[bool]] = [[] for _ in laboratories.members]

    def _note(self, observation: Any, mask: Any, step: Any, members: Any, actions: Any) -> None:
        for i, member in enumerate(members):
            self.actions[member].append(int(actions[i]))
            self.legal[member].append(bool(mask[i, actions[i]]))


def weights(model: Any) -> npt.NDArray[Any]:
    """All parameters of a model of Stable-Baselines3 in one array."""
    return np.concatenate([one.detach().numpy().ravel() for one in model.policy.parameters()])


def watched(model: Any, steps: int) -> dict[str, Any]:
    """Train such a model; lost turns, ends and steps, and the ticks between turns."""
    found: dict[str, Any] = {"illegal": 0, "ends": 0, "steps": 0, "ticks": []}

    def watch(now: dict[str, Any], _: Any) -> bool:
        found["illegal"] += sum(info["illegal_action"] for info in now["infos"])
        found["ends"] += int(now["dones"].sum())
        found["steps"] += len(now["infos"])
        found["ticks"] += [info["elapsed_ticks"] for info in now["infos"] if "elapsed_ticks" in info]
        return True

    model.learn(steps, watch)
    return found


def until(met: Callable[[], Any], seconds: float = 600.0) -> None:
    """Wait until something is true."""
    end = time.monotonic() + seconds
    while not met():
        assert time.monotonic() < end
        time.sleep(0.02)


@contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise a TimeoutError after that long; needs signals of POSIX."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"took more than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _parent(pid: int) -> int:
    """Number of the process that started one; 0 where that has ended."""
    try:
        state, parent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:2]
    except OSError:
        return 0
    return 0 if state == "Z" else int(parent)


def running(pid: int) -> bool:
    """Whether a process goes on, as Linux shows it; one that has ended and that nobody waited for does not."""
    return _parent(pid) != 0


def children(pid: int) -> list[int]:
    """Processes that one has started and that go on, as Linux shows them."""
    return [other for other in map(int, filter(str.isdigit, os.listdir("/proc"))) if _parent(other) == pid]


def said(name: str) -> str:
    """Hash of all that a scenario says."""
    return hashlib.sha256(json.dumps(dump_scenario(load_scenario(name))).encode()).hexdigest()[:16]


def pascal(materials: Mapping[str, Material], name: str, kelvin: float) -> float:
    """Vapour pressure of a pure material."""
    real = materials[name].real
    assert real is not None
    assert real.vapor_pressure is not None
    return float(real.vapor_pressure.pascal(kelvin))


def litres(scenario: Scenario, contents: Mapping[str, float]) -> float:
    """Volume of amounts in mol, from the cited molar masses and densities."""
    return sum(mol * molar_volume(scenario, name) for name, mol in contents.items())


def four_solvents() -> Scenario:
    """A scenario with four solvents, two salts with a common cation, metal and several liquid solutes."""
    return load_scenario(
        {
            "name": "four_solvents",
            "title": "Four solvents",
            "summary": "For tests of layers and partition.",
            "reactions": "wurtz",
            "goals": ["dodecane", "NaCl"],
            "lab_goals": ["dodecane"],
            "theoretical_maximum_mol": {"dodecane": 1.0},
            "stock": {
                "water": 10.0,
                "diethyl_ether": 10.0,
                "hexane": 10.0,
                "ethyl_acetate": 10.0,
                "1-chlorohexane": 1.0,
                "2-chlorohexane": 1.0,
                "3-chlorohexane": 1.0,
                "dodecane": 1.0,
                "Na": 1.0,
            },
            "shelf": {"slots": 4, "vessel": [{"capacity_l": 1.0}]},
            "benches": {"ext": {"kind": "extraction", "step_limit": 10}},
            "limits": {"manager_actions": 10, "ticks": 10},
        }
    )


def molar_volume(scenario: Scenario, name: str) -> float:
    """L/mol, from molar mass and density."""
    material = scenario.materials[name]
    return material.molar_mass_g_mol / (1000.0 * material.density_kg_l)


def composition(scenario: Scenario) -> tuple[list[str], FloatArray]:
    """(elements, [M, E] atoms of each element in a formula unit of each material); the last column is the charge."""
    materials = list(scenario.materials.values())
    elements = sorted({element for material in materials for element in material.composition})
    matrix = [[*(m.composition.get(e, 0.0) for e in elements), float(m.charge)] for m in materials]
    return [*elements, "charge"], np.array(matrix)


def network_table(
    species: npt.NDArray[np.int64],
    stoichiometry: FloatArray,
    orders: FloatArray,
    pre_exponential: FloatArray,
    activation_energy: FloatArray,
) -> Table[Chemistry]:
    """A chemistry that is nothing but a reaction network; its handle is good as long as the table is there."""
    sizes = {axis: 0 for field in declared(Chemistry) for axis in field.axes}
    fields = network_fields(species, stoichiometry, orders, pre_exponential, activation_energy)
    return Table(Table.empty(Chemistry, **sizes).arrays._replace(laws=law_addresses("paper", Chemistry), **fields))


class Glassware:
    """A row of vessels with a waste can, and the kernels with their scratch arrays.

    Args:
        scenario: whose materials there are.
        vessels: how many vessels stand there, empty.
    """

    def __init__(self, scenario: str | Scenario = "wurtz_dodecane", vessels: int = 2) -> None:
        self.scenario = load_scenario(scenario)
        self.shelf = Shelf.empty(self.scenario, 1, vessels)
        self.layout, self.chem, self.known = self.shelf.layout, self.shelf.chem(), self.shelf.known()
        self.rows = self.shelf.rows
        self.waste: FloatArray = self.shelf.waste[0]
        self.events = np.zeros(len(SAFETY_EVENTS))
        columns = self.layout.fluid_columns
        self.layers = np.zeros(columns + 1, dtype=np.int64)
        self.shares = np.zeros((columns, PIXELS))
        # More than any kernel's docstring asks for.
        self._scratch = np.zeros((columns + 16, columns + PIXELS))
        self._atoms = composition(self.scenario)[1]
        for position in range(vessels):
            self.fill(position, {})

    def fill(
        self,
        position: int,
        contents: Mapping[str, float],
        capacity_l: float = 1.2,
        temperature_k: float | None = None,
        clock: float | None = None,
    ) -> FloatArray:
        """Put a vessel with ``contents`` (mol) there and return its row; nothing is dissolved or separated yet."""
        row: FloatArray = self.shelf.fill(0, position, capacity_l, dict(contents)).row
        if temperature_k is not None:
            row[TEMPERATURE] = temperature_k
        if clock is not None:
            row[CLOCK] = clock
        return row

    def mixed(self, position: int, contents: Mapping[str, float], capacity_l: float = 1.2) -> FloatArray:
        """A freshly shaken vessel in phase equilibrium: every solute spread over the solvents by volume."""
        row = self.fill(position, contents, capacity_l, clock=T_MIX)
        self.phases(position)
        self.partition(position)
        return row

    def index(self, name: str) -> int:
        """Index of a material."""
        return self.layout.index(name)

    def amounts(self, position: int) -> FloatArray:
        """[M] mol in a vessel (a view)."""
        return np.asarray(self.rows[position, AMOUNTS : AMOUNTS + len(self.layout.materials)])

    def amount(self, position: int, name: str) -> float:
        """mol of one material in a vessel."""
        return float(self.amounts(position)[self.index(name)])

    def dissolved(self, position: int) -> FloatArray:
        """[K, L] mol of each dissolvable material in each solvent (a view)."""
        shape = (len(self.layout.dissolved), len(self.layout.solvents))
        return np.asarray(self.rows[position, AMOUNTS + len(self.layout.materials) :]).reshape(shape)

    def in_solvent(self, position: int, solute: str, solvent: str) -> float:
        """mol of a solute in one of the solvents."""
        k, layer = self.layout.dissolved.index(solute), self.layout.solvents.index(solvent)
        return float(self.dissolved(position)[k, layer])

    def volume(self, position: int, *names: str) -> float:
        """Litres of the named materials, or of everything."""
        chosen = names or self.layout.materials
        return sum(self.amount(position, name) * molar_volume(self.scenario, name) for name in chosen)

    def heat_capacity(self, position: int) -> float:
        """J/K of the contents, without air."""
        materials = self.scenario.materials.values()
        return float(self.amounts(position) @ np.array([m.heat_capacity_j_mol_k for m in materials]))

    def atoms(self) -> FloatArray:
        """[E] atoms (and charge) in vessels and waste together."""
        return np.asarray(self.shelf.total()[0] @ self._atoms)

    def phases(self, position: int) -> None:
        """Violent reactions, then dissolution and precipitation."""
        settle_phases(self.rows[position], self.chem, self.waste, self.events, self._scratch)

    def partition(self, position: int) -> None:
        """Bring the dissolved amounts up to the vessel's clock."""
        partition(self.rows[position], self.chem, self._scratch)

    def turn(self, position: int, by: float) -> None:
        """Settle (``by`` > 0) or mix (< 0), then redistribute."""
        turn_clock(self.rows[position], by)
        self.partition(position)

    def profile(self, position: int) -> tuple[list[str], FloatArray]:
        """(what each layer is, [C, pixels] shares), solids first and air last."""
        count = profile(self.rows[position], self.chem, self.layers, self.shares, self._scratch)
        names = ["solids" if i == SOLIDS else self.layout.materials[i] for i in self.layers[1 : 1 + count]]
        return names, self.shares[:count].copy()

    def pour(self, source: int, target: int, fraction: float) -> None:
        """Pour a fraction of everything."""
        pour(self.rows[source], self.rows[target], fraction, self.chem, self.waste, self.events)

    def add(self, position: int, name: str, mol: float, temperature_k: float = 298.15) -> None:
        """Add a pure material."""
        add(self.rows[position], self.index(name), mol, temperature_k, self.chem, self.waste, self.events)

    def drain(self, source: int, target: int, pixels: float) -> tuple[list[str], FloatArray]:
        """Drain the lowest pixels; returns the profile by which it was done."""
        seen = self.profile(source)
        drain(
            self.rows[source],
            self.rows[target],
            float(pixels),
            self.shares,
            self.layers,
            self.chem,
            self.waste,
            self.events,
        )
        return seen

    def heat(
        self, source: int, target: int, joules: float, hottest_k: float = 700.0, coolest_k: float = 273.15
    ) -> tuple[float, float]:
        """Heat or cool; returns (heat that went in, heat the condenser took), J."""
        row, receiver = self.rows[source], self.rows[target]
        limits = np.array([hottest_k, coolest_k, 1.0, 0.0])
        result: Any = heat(row, receiver, float(joules), limits, self.chem, self.waste, self.events, self._scratch)
        return float(result[0]), float(result[1])

    def check(self) -> None:
        """Every vessel's amounts are finite and not negative, and solutes are all somewhere (1e-9)."""
        assert np.isfinite(self.rows).all()
        solvents = [self.index(name) for name in self.layout.solvents]
        solutes = [self.index(name) for name in self.layout.dissolved]
        for position in range(len(self.rows)):
            amounts, dissolved = self.amounts(position), self.dissolved(position)
            assert amounts.min() >= 0.0
            assert dissolved.min(initial=0.0) >= 0.0
            if amounts[solvents].max(initial=0.0) > TRACE:
                np.testing.assert_allclose(dissolved.sum(axis=1), amounts[solutes], rtol=1e-9, atol=1e-12)


class Careless:
    """A policy that also plays what is not possible: any action of the space, but seldom a submission.

    Args:
        laboratories: whose agent it is for.
        agent: number of the agent.
        seed: of its own random numbers.
    """

    def __init__(self, laboratories: Laboratories, agent: int, seed: int) -> None:
        self._rng = np.random.default_rng([seed, agent])
        self._space = laboratories.action_space(agent)
        kinds = laboratories.actions.table[:, 0]
        self._chances = np.where(kinds == SUBMIT, 0.02, 1.0) * np.where(kinds == WAIT, 0.2 * len(kinds), 1.0)

    def act(
        self, observation: npt.NDArray[np.float32], mask: npt.NDArray[np.int8] | None, step: Any, members: Any
    ) -> Any:
        """See :class:`chemlab.envs.players.Policy`."""
        if mask is None:
            return self._rng.random((len(observation), *self._space.shape))  # type: ignore[misc]
        chances = self._chances if mask.shape[1] == len(self._chances) else np.ones(mask.shape[1])
        return self._rng.choice(mask.shape[1], size=len(mask), p=chances / chances.sum())


def play_experiments(batch: Any, policy: Any) -> FloatArray:
    """[N] scores of the experiments that run in a batch, played to their ends; vessels stay as they were left."""
    scores, live = np.full(len(batch.members), np.nan), batch.members
    while len(live):
        mask = batch.mask()[live] if batch.bench.action_count else None
        batch.act(policy.act(batch.observe()[live], mask, batch.experiments.steps[live], live), live)
        over = batch.experiments.ended[live]
        if over.any():
            scores[live[over]] = batch.finish(live[over])
        live = live[~over]
    return scores


def record_episode(
    path: Path,
    scenario: Any = "wurtz_dodecane",
    policy: str = "scripted",
    seed: int = 3,
    options: dict[str, Any] | None = None,
    named: bool = False,
    **more: Any,
) -> Path:
    """Record an episode of policies by name, or of careless ones.

    Args:
        path: the record.
        scenario, more: arguments of ``raw_env``.
        policy: a name, or ``careless``.
        seed: of the episode and of the policies.
        options: of ``reset``.
        named: True puts the policy's name into the record.
    """
    from chemlab.agents import episodes
    from chemlab.agents.policies import make_policies

    env = raw_env(scenario, **more)
    labs = env.laboratories
    careless: Any = {agent: Careless(labs, i, seed) for i, agent in enumerate(labs.agents)}
    policies = careless if policy == "careless" else make_policies(policy, labs, seed)
    episodes.record_episode(path, env, policies, seed, policy if named else "", options, force=True)
    return path


# -- what all interfaces have in common -------------------------------------------------------------------------------


def digest(*values: Any) -> str:
    """Of arrays (with their types and shapes), numbers, names and objects in nested dictionaries and sequences."""
    found = hashlib.blake2b(digest_size=16)

    def add(value: Any) -> None:
        if isinstance(value, dict):
            for key in sorted(value):
                found.update(str(key).encode())
                add(value[key])
        elif isinstance(value, (tuple, list)) or (isinstance(value, np.ndarray) and value.dtype == object):
            found.update(f"{len(value)}".encode())
            for one in value:
                add(one)
        elif isinstance(value, np.ndarray):
            found.update(f"{value.dtype}{value.shape}".encode())
            found.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, Memory):
            add(vars(value))
        else:
            found.update(repr(value).encode())

    add(values)
    return found.hexdigest()


def state_of(env: Any) -> str:
    """Digest of all that changes in an environment: arrays, generators, and what was last shown."""
    names = ("agents", "agent_selection", "rewards", "_cumulative_rewards", "infos", "_begun", "_unfinished", "_turns")
    arrays = env.get_state() if hasattr(env, "get_state") else env.laboratories.snapshot()
    random = [getattr(env, name).bit_generator.state for name in ("np_random", "_random") if hasattr(env, name)]
    return digest(arrays, random, *(vars(env).get(name) for name in names))


def refused(match: str, call: Callable[..., Any], *arguments: Any, **named: Any) -> str:
    """The message of the ValueError that a call raises, which must match."""
    with pytest.raises(ValueError, match=match) as caught:
        call(*arguments, **named)
    return str(caught.value)


def command(*words: object, code: int = 0, **given: Any) -> str:
    """What a chemlab command says, on one line; it must end with this code, and not with a traceback.

    Args:
        words: the command's.
        given: what it is given to read, and the like: see ``typer.testing.CliRunner``.
    """
    from typer.testing import CliRunner

    from chemlab.cli import app

    done = CliRunner().invoke(app, list(map(str, words)), **{"env": {"COLUMNS": "500"}, **given})
    assert done.exception is None or isinstance(done.exception, SystemExit), (words, done.exception)
    assert done.exit_code == code, (words, done.output)
    return " ".join(done.output.split())


def choose(
    labs: Laboratories, number: int, member: int, rng: np.random.Generator, bold: float = 0.2, submit: float = 0.05
) -> Any:
    """An action of one agent: legal, but with probability ``bold`` any of the space; with probability ``submit`` a
    submission or an experiment's end; corners of a box are frequent."""
    mask = labs.mask(number, np.array([member]))
    if mask is None:
        numbers = rng.random(labs.action_space(number).shape)  # type: ignore[arg-type]
        return np.where(rng.random(numbers.shape) < 0.3, numbers.round(), numbers)
    legal = np.arange(mask.shape[1]) if rng.random() < bold else np.flatnonzero(mask[0])
    rare = legal == labs.benches[number - 1].end_action if number else labs.actions.table[legal, 0] == SUBMIT
    if number == 0 and (wait := labs.actions.encode("wait")) in legal and rng.random() < 0.3:
        return wait
    wanted = rare if rng.random() < submit else ~rare
    legal = legal[wanted] if wanted.any() else legal
    return int(rng.choice(legal))


def lasting(labs: Laboratories) -> list[npt.NDArray[Any]]:
    """Every array that changes, but what the last turn or round alone has earned; and the totals of accidents."""
    passing = (labs.state.rewards, labs.state.cost, labs.state.scores)
    kept = [array for array in labs.arrays() if not any(np.shares_memory(array, own) for own in passing)]
    return [*kept, np.asarray(labs.safety_totals)]


class Rounds:
    """A laboratory in rounds (an action of the manager, or a tick) that is played turn by turn in AEC: the reference of
    every interface for all agents."""

    def __init__(self, scenario: Any) -> None:
        self.env = raw_env(scenario)
        self.laboratories = self.env.laboratories
        self.turn: list[str] = []
        self._arrays = lasting(self.laboratories)

    def choose(self, rng: np.random.Generator, submit: float) -> dict[str, Any]:
        """Actions of all who have the turn."""
        labs = self.laboratories
        return {agent: choose(labs, labs.agents.index(agent), 0, rng, submit=submit) for agent in self.turn}

    def reset(self, seed: int | None = None) -> dict[str, Any]:
        """See :meth:`step`."""
        self.env.reset(seed=seed)
        self._last = dict.fromkeys(self.env.possible_agents, 0)
        return self._shown(self._nothing())

    def step(self, actions: dict[str, Any]) -> dict[str, Any]:
        """Play a round; all that an interface may show after it."""
        env, labs, agents = self.env, self.laboratories, self.env.possible_agents
        tick, managed = labs.state.ticks[0], self.turn == ["manager_0"]
        rewards, infos = dict.fromkeys(agents, 0.0), self._nothing()
        for agent in self.turn:
            assert (env.agent_selection, env.infos[agent]["elapsed_ticks"]) == (agent, self._elapsed[agent])
            env.step(actions[agent])
            for number, name in enumerate(agents):
                rewards[name] += env.rewards[name]
                if name == agent or labs.cost[0, number]:  # an experiment may start with an accident
                    infos[name].update({key: env.infos[name][key] for key in ("cost", "events")})
                if np.isfinite(labs.scores[0, number]):
                    infos[name].update(experiment_over=True, score=float(labs.scores[0, number]))
            infos[agent]["illegal_action"] = env.infos[agent]["illegal_action"]
        over = bool(labs.state.status[0] != 0)
        assert managed or over or labs.state.ticks[0] != tick, "the round is over"
        paid = 0.0
        if over:
            infos["manager_0"].update(experiment_over=True, score=float(labs.result(labs.members)[0]))
            paid = infos["manager_0"]["score"] + sum(labs.costs().values())
        ends = {"terminated": dict.fromkeys(agents, over), "truncated": dict.fromkeys(agents, False)}
        assert (env.terminations, env.truncations) == (ends["terminated"], ends["truncated"])
        return {**self._shown(infos), **ends, "rewards": rewards, "paid": round(paid, 9)}

    def _nothing(self) -> dict[str, dict[str, Any]]:
        nothing = {"cost": 0.0, "illegal_action": False, "experiment_over": False, "score": 0.0}
        events = np.zeros(len(self.env.scenario.safety_events))
        return {agent: {**nothing, "events": events} for agent in self.env.possible_agents}

    def _shown(self, infos: dict[str, dict[str, Any]]) -> dict[str, Any]:
        env, labs = self.env, self.laboratories
        turns, ticks = labs.turns(labs.members)[:, 0], labs.state.ticks[0]
        self.turn = [agent for agent, turn in zip(env.possible_agents, turns, strict=True) if turn]
        self._elapsed = {agent: int(ticks - last) for agent, last in self._last.items()}
        for number, (agent, info) in enumerate(infos.items()):
            info.update(has_turn=turns[number], elapsed_ticks=self._elapsed[agent])
            self._last[agent] = ticks if turns[number] else self._last[agent]
            if count := labs.action_counts[number]:
                resting = labs.benches[number - 1].end_action if number else labs.actions.encode("wait")
                mask: Any = labs.mask(number, labs.members)
                info["action_mask"] = mask[0] if turns[number] else np.eye(count, dtype=np.int8)[resting]
        infos["manager_0"].update({**labs.manager.accounts(0), "costs": list(labs.costs().values())})
        if self.turn in ([], ["manager_0"]):
            for key in ("costs", "goals", "submitted_mol", "purity", "elapsed_ticks"):
                np.testing.assert_array_equal(infos["manager_0"][key], env.infos["manager_0"][key], key)
        for agent in self.turn[:1] or env.possible_agents:  # at the end, all of them
            assert env.infos[agent]["elapsed_ticks"] == infos[agent]["elapsed_ticks"]
            np.testing.assert_equal(infos[agent].get("action_mask"), env.infos[agent].get("action_mask"))
        seen = {agent: env.observe(agent) for agent in env.possible_agents}
        return {"observations": seen, "infos": infos, "state": env.state(), "arrays": self._arrays}


def assert_agrees(found: Any, expected: Any, where: str) -> None:
    """Everything that was found is as expected, bit for bit."""
    if isinstance(found, dict):
        for key, value in found.items():
            assert_agrees(value, expected[key], f"{where} {key}")
    elif isinstance(found, list):
        for one, other in zip(found, expected, strict=True):
            assert_agrees(one, other, where)
    else:
        np.testing.assert_array_equal(found, expected, where)


def assert_plays_rounds(
    interface: Any, scenario: Any, members: int, rounds: int, seed: int = 30, submit: float = 0.15
) -> int:
    """An interface shows what AEC shows of ``members`` laboratories, through several episodes; the number of ends.

    ``reset(seed)`` or ``reset(which)`` and ``step(actions)`` give, for every laboratory, a part of what :class:`Rounds`
    gives (all infos if ``whole``), and ``final`` observations of an end; ``autoreset`` has then begun the next episode.
    """
    ours, rngs = [Rounds(scenario) for _ in range(members)], [np.random.default_rng([seed, i]) for i in range(members)]
    actions: list[dict[str, Any]] = []
    for space in ("state_space", "state_channels"):
        assert getattr(interface.env, space) == getattr(ours[0].env, space)
    found, expected, ends = interface.reset(seed), [one.reset(seed + i) for i, one in enumerate(ours)], 0
    for step in range(rounds):
        for member in range(members):
            assert_agrees(found[member], expected[member], f"round {step}, laboratory {member}:")
            for agent, info in expected[member]["infos"].items() if interface.whole else ():
                assert found[member]["infos"][agent].keys() == info.keys()
        over = np.array([not one.turn for one in ours])
        if over.any() and not interface.autoreset:
            with pytest.raises(ValueError, match=r"over.*call reset\("):
                interface.step(actions)
            found = interface.reset(which=over)
            for member in np.flatnonzero(over):
                assert_agrees(found[member], ours[member].reset(), f"begun in round {step}, {member}:")
        actions = [one.choose(rng, submit) for one, rng in zip(ours, rngs, strict=True)]
        found = interface.step(actions)
        expected = [one.step(own) for one, own in zip(ours, actions, strict=True)]
        for member, one in enumerate(ours):
            if one.turn:
                assert "final" not in found[member]
                continue
            ends += 1
            assert_agrees(found[member].pop("final", {}), expected[member]["observations"], "final")
            if interface.autoreset:
                fresh = one.reset()
                for agent, info in expected[member]["infos"].items():
                    info.update({key: fresh["infos"][agent][key] for key in ("has_turn", "action_mask") if key in info})
                expected[member].update(observations=fresh["observations"], state=fresh["state"])
    return ends


def assert_is_singles(
    batch: Any, singles: list[Any], steps: int, act: Callable[[int, int], Any], seed: int, whole: bool = True
) -> int:
    """Members of a batch are single environments with seeds ``seed``, ``seed + 1``, ..., in all that they show, begun
    again as the batch's mode says; the number of ends.

    ``act(step, member)`` is played. With ``whole`` the batch has all infos that single environments have but accounts.
    """
    mode, ends, waiting = batch.autoreset_mode, 0, np.zeros(len(singles), dtype=np.bool_)

    def check(member: int, own: Any, info: dict[str, Any], where: str) -> None:
        np.testing.assert_array_equal(seen[member], own, where)
        told = {key for key in infos if not key.startswith("_")} - {"final_obs", "final_info"}
        assert told == info.keys() - {"costs", "goals", "submitted_mol", "purity"} or not whole
        for key in told & info.keys():
            np.testing.assert_array_equal(infos[key][member], info[key], f"{key} {where}")
            assert not whole or infos[f"_{key}"][member]

    seen, infos = batch.reset(seed=seed)
    for i, one in enumerate(singles):
        check(i, *one.reset(seed=seed + i), f"member {i} at first")
    for step in range(steps):
        actions = np.array([act(step, i) for i in range(len(singles))])
        seen, rewards, terminated, truncated, infos = batch.step(actions)
        for i, one in enumerate(singles):
            where = f"member {i}, step {step}"
            begun = one.reset() if waiting[i] else None  # NEXT_STEP: this step has been the reset
            own, *paid, info = (begun[0], 0.0, False, False, begun[1]) if begun else one.step(actions[i])
            assert (rewards[i], terminated[i], truncated[i]) == (rewards.dtype.type(paid[0]), *paid[1:]), where
            if any(paid[1:]) and mode is AutoresetMode.SAME_STEP:
                assert infos["_final_obs"][i]
                np.testing.assert_array_equal(infos["final_obs"][i], own, where)
                own, fresh = one.reset()
                info = {**info, **{key: fresh[key] for key in ("action_mask",) if key in fresh}}
            check(i, own, info, where)
        over = terminated | truncated
        ends += int(over.sum())
        waiting = over & (mode is AutoresetMode.NEXT_STEP)
        if mode is AutoresetMode.DISABLED and over.any():
            before = state_of(batch)
            with pytest.raises(ResetNeeded):
                batch.step(actions)
            assert state_of(batch) == before
            seen, infos = batch.reset(options={"reset_mask": over})
            for i in np.flatnonzero(over):
                check(i, *singles[i].reset(), f"member {i} begun after step {step}")
    return ends
