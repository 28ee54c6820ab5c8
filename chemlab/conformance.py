"""Conformance checks of a scenario, including the benches, operations and instruments that it names.

>>> from chemlab.conformance import check_scenario
>>> [result.name for result in check_scenario("fictitious") if result.error]
[]

Every check plays random legal actions. A scenario that passes all checks can be trained on, copied, batched and
recorded like a bundled one.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import pickle
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from .config.inherit import declared_levels
from .config.loading import load_scenario, reachable_materials
from .config.materials import Material, atoms_of
from .config.reactions import equation
from .config.scenario import OrderSpec, Scenario
from .envs.aec import raw_env
from .envs.batch import BatchedLaboratory
from .envs.parallel import parallel_env
from .envs.role_env import RoleEnv
from .physics.chemistry import element_matrix
from .physics.constants import GAS_CONSTANT
from .record import Play, Recorder, read_record, verify_record
from .roles.kinds import BENCH_KINDS

_ROUNDS = 300
"""Maximum number of rounds of an episode that a check plays."""
_MOST = 5000
"""Limit of actions and of ticks to which the check ``end`` lowers higher limits of a scenario."""
_ROUNDING = 1e-9
"""Largest relative change of an element's amount, or of the charge, that counts as a rounding error."""
_FROZEN_K = 200.0
"""If a bench's whole range of temperatures is below this, the range was probably given in degrees Celsius."""

_LEAST_BARRIER_J_MOL = 500.0
"""An activation energy below this, but above 0, was probably given in kJ/mol."""
_LEAST_TROUTON = 2.0
"""Likewise a heat of vaporization below this number times R and the boiling point; of helium it is 2.4 times."""


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check.

    Attributes:
        name: name of the check.
        meaning: the property that is checked.
        error: description of the violation; None if the check passes.
    """

    name: str
    meaning: str
    error: str | None


def doubts(scenario: Scenario) -> list[str]:
    """Return a line for each probable mistake in a valid scenario, beginning with its key.

    Raises:
        DataError: the scenario, another level of its file, or a part that it names cannot be loaded.
    """
    raw_env(scenario)  # checks the keys of benches
    file = Path(scenario.origin)
    for level in declared_levels(file) if file.suffix == ".toml" else ():
        raw_env(f"{file}@{level}")
    available = Counter(scenario.stock)
    for vessel in scenario.shelf.vessel:
        available.update(vessel.contents)
    available = +available  # without amounts of 0
    drawn = {name for draw in scenario.world.draws.values() for name in draw.materials}
    custom = any(bench.kind not in BENCH_KINDS or bench.model for bench in scenario.benches.values())
    lines = []
    for key, bench in scenario.benches.items():
        if bench.kind not in BENCH_KINDS:
            continue  # its options may mean anything
        extra = bench.model_extra or {}
        added = [*extra.get("reagents", ()), *(part.get("material") for part in extra.get("process", ()))]
        for name in dict.fromkeys(name for name in added if name):
            if scenario.stock.get(name, 0.0) <= 0.0 and name not in drawn:
                lines.append(f"benches.{key}: adds {name!r}, which is not in stock: give stock.{name} an amount in mol")
        hottest = (extra.get("temperature_k") or {}).get("high", _FROZEN_K)
        if hottest < _FROZEN_K:
            lines.append(
                f"benches.{key}.temperature_k: high = {hottest:g} K is {hottest - 273.15:.0f} degrees Celsius; give "
                "temperatures in K"
            )
    for name, material in scenario.materials.items():
        lines += [f"materials.{name}.{doubt}" for doubt in _doubts_of(material)]
    for step in scenario.family.reaction:
        barrier = step.activation_energy_j_mol
        if 0.0 < barrier < _LEAST_BARRIER_J_MOL:
            lines.append(
                f"reactions: {equation(step)}: activation_energy_j_mol = {barrier:g}; give it in J/mol, not kJ"
            )
    demand, wanted = scenario.demand, scenario.specifications
    least = [order.amount_at_least_mol for order in demand.order] or [0.0] * (demand.missed > 0.0)
    amounts_drawn = any(draw.what == "amount_at_least_mol" for draw in scenario.world.draws.values())
    for goal in scenario.lab_goals if 0.0 in least and not amounts_drawn and demand.fill_at_least == 0.0 else ():
        if wanted.get(goal, OrderSpec()).amount_at_least_mol == 0.0:
            lines.append(
                f"demand: an order is met by any trace of {goal!r}: give specifications.{goal}.amount_at_least_mol or "
                "demand.fill_at_least"
            )
    if custom:
        return lines
    atoms = atoms_of(available, scenario.materials)
    possible = reachable_materials(scenario, [*available, *drawn])
    for goal in scenario.goals:
        if goal not in possible:
            lines.append(f"goals: no reaction makes {goal!r} from the materials in stock and on the shelf")
        elif goal in scenario.lab_goals and not drawn:
            composition = scenario.materials[goal].composition
            most = min(atoms.get(element, 0.0) / number for element, number in composition.items())
            declared = scenario.theoretical_maximum_mol[goal]
            if declared > most * (1.0 + 1e-6):
                lines.append(
                    f"theoretical_maximum_mol.{goal}: {declared:g} mol, but the atoms in stock and on the shelf are "
                    f"enough for {most:.3g} mol"
                )
    return lines


def _doubts_of(material: Material) -> Iterator[str]:
    """Yield the probable mistakes in a material's numbers, each beginning with a key."""
    heat, boiling = material.vaporization_enthalpy_j_mol, material.boiling_point_k
    if heat < _LEAST_TROUTON * GAS_CONSTANT * boiling:
        yield (
            f"vaporization_enthalpy_j_mol: {heat:g} is little for a boiling point of {boiling:g} K; give it in J/mol, "
            "not kJ"
        )
    counted: Counter[str] = Counter()
    if re.fullmatch(r"([A-Z][a-z]?\d*)+", material.formula):
        for element, number in re.findall(r"([A-Z][a-z]?)(\d*)", material.formula):
            counted[element] += int(number or 1)
    if counted.keys() == material.composition.keys() and counted != Counter(material.composition):
        yield f"composition: differs from the formula {material.formula}"


class _Fault(Exception):
    """Violation of a checked property."""


def _same(one: Any, other: Any) -> bool:
    """Return True if nested dictionaries and sequences of arrays are equal bit for bit."""
    if isinstance(one, Mapping):
        return isinstance(other, Mapping) and one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(_same, one, other))
    first, second = np.asarray(one), np.asarray(other)
    return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=first.dtype.kind == "f")


def _legal(space: gymnasium.Space[Any], mask: Any, rng: np.random.Generator) -> Any:
    """Return a random legal action."""
    if isinstance(space, gymnasium.spaces.Discrete):
        return int(rng.choice(np.flatnonzero(mask)))
    return rng.random(space.shape)


class _Episode:
    """An episode of the parallel environment, played by random legal actions.

    Attributes:
        env: the environment.
        actions: each round's actions by agent.
        results: the return values of ``reset``, then of each ``step`` followed by the global state.
    """

    def __init__(self, env: Any, seed: int) -> None:
        self.env, self.rng = env, np.random.default_rng(seed)
        self.actions: list[dict[str, Any]] = []
        self.results: list[Any] = [env.reset(seed=seed)]
        self.infos: dict[str, Any] = self.results[0][1]

    @property
    def over(self) -> bool:
        """True once the episode has ended."""
        return not self.env.agents

    def play(self, rounds: int) -> list[Any]:
        """Play up to a number of rounds, and return their results."""
        first = len(self.results)
        for _ in range(rounds):
            if self.over:
                break
            actions = {
                agent: _legal(self.env.action_space(agent), self.infos[agent].get("action_mask"), self.rng)
                for agent in self.env.agents
                if self.infos[agent]["has_turn"]
            }
            result = self.env.step(actions)
            self.infos = result[-1]
            self.actions.append(actions)
            self.results.append((*result, self.env.state()))
        return self.results[first:]


def _played(scenario: Scenario, seed: int, rounds: int = _ROUNDS) -> _Episode:
    episode = _Episode(parallel_env(scenario), seed)
    episode.play(rounds)
    return episode


def _episodes(scenario: Scenario) -> Iterator[_Episode]:
    """Yield three or more random episodes that have just begun, until they have :data:`_ROUNDS` rounds together."""
    env, rounds = parallel_env(scenario), 0
    for seed in itertools.count():
        yield (episode := _Episode(env, seed))
        rounds += len(episode.actions)
        if seed >= 2 and rounds >= _ROUNDS:
            return


def _check_spaces(scenario: Scenario) -> None:
    for episode in _episodes(scenario):
        episode.play(_ROUNDS)
        for number, result in enumerate(episode.results):
            for agent, observation in result[0].items():
                space = episode.env.observation_space(agent)
                if not space.contains(observation):
                    outside = np.flatnonzero(~((observation >= space.low) & (observation <= space.high)))
                    raise _Fault(
                        f"round {number}, {agent}: entries {outside[:5].tolist()} of the observation are not "
                        f"in [0, 1]: {np.asarray(observation)[outside[:5]].tolist()}"
                    )
            for agent, info in result[-2 if number else 1].items():
                if info["has_turn"] and not np.any(info.get("action_mask", 1)):
                    raise _Fault(f"round {number}, {agent}: has the turn and no legal action")
                if not np.isfinite([info["cost"], *(result[1].values() if number else ())]).all():
                    raise _Fault(f"round {number}, {agent}: a reward or a cost is not finite")
                if info["illegal_action"]:
                    raise _Fault(f"round {number}, {agent}: an action that its mask allows was invalid")


def _check_end(scenario: Scenario) -> None:
    lowered = {key: min(number, _MOST) for key, number in dict(scenario.limits).items() if key != "budget"}
    limits = scenario.limits.model_copy(update=lowered)
    most = limits.manager_actions + limits.ticks + 1
    if not _played(scenario.model_copy(update={"limits": limits}), 0, most).over:
        raise _Fault(f"the episode continues after {most} rounds, beyond limits.manager_actions and limits.ticks")


def _experiments(env: RoleEnv) -> list[Any]:
    """Return all results of two experiments on a single bench, played by random legal actions."""
    rng = np.random.default_rng(1)
    results: list[Any] = []
    for seed in (1, None):
        results.append(env.reset(seed=seed))
        for _ in range(env.max_episode_steps):
            results.append(env.step(_legal(env.action_space, results[-1][-1].get("action_mask"), rng)))
            if results[-1][2]:
                break
    return results


def _check_seeds(scenario: Scenario) -> None:
    env = parallel_env(scenario)
    first, again = _Episode(env, 1), _Episode(parallel_env(scenario), 1)
    results = first.play(_ROUNDS)
    if not _same(results, again.play(_ROUNDS)):
        raise _Fault("the same seed gives another episode in a second environment")
    if not _same(results, _Episode(env, 1).play(_ROUNDS)):
        raise _Fault("the same seed gives another episode when an environment is used again")
    for key in scenario.benches:
        alone = RoleEnv(scenario, bench=key)
        if not _same(_experiments(alone), _experiments(alone)):
            raise _Fault(
                f"benches.{key} alone: the same seed gives another experiment when an environment is used again"
            )


def _check_copies(scenario: Scenario) -> None:
    episode = _played(scenario, 2, 12)
    others = {"a deep copy": copy.deepcopy(episode), "an unpickled copy": pickle.loads(pickle.dumps(episode))}
    labs = episode.env.laboratories
    kept = labs.snapshot()
    expected = episode.play(12)
    for name, other in others.items():
        if not _same(expected, other.play(12)):
            raise _Fault(f"{name} of an environment in mid-episode continues differently")
    if episode.over:  # the environment accepts no further step
        return
    after = labs.snapshot()
    labs.restore(kept)
    for actions in episode.actions[12:]:
        episode.env.step(actions)
    if not _same(after, labs.snapshot()):
        raise _Fault("a restored snapshot continues differently")


def _check_environments(scenario: Scenario) -> None:
    episode = _played(scenario, 3)
    returns = {agent: sum(result[1][agent] for result in episode.results[1:]) for agent in episode.env.possible_agents}
    single, batch = raw_env(scenario), BatchedLaboratory(2, scenario, autoreset=False)
    single.reset(seed=3)
    batch.reset(seed=2)
    singles, batched = dict.fromkeys(returns, 0.0), dict.fromkeys(returns, 0.0)
    shapes = {agent: batch.action_space(agent).shape or () for agent in returns}
    for actions in episode.actions:
        for _ in actions:
            single.step(actions[single.agent_selection])
            for agent in singles:
                singles[agent] += single.rewards[agent]
        arrays = {agent: np.zeros((2, *shape), np.float64 if shape else np.int64) for agent, shape in shapes.items()}
        for agent, action in actions.items():
            arrays[agent][1] = action
        _, rewards, over, _, _ = batch.step(arrays)
        for agent in batched:
            batched[agent] += rewards[agent][1]
        if over[0]:
            batch.reset(options={"reset_mask": np.array([True, False])})
    for name, sums, labs, member in (
        ("AEC environment", singles, single.laboratories, 0),
        ("batch", batched, batch.laboratories, 1),
    ):
        if not all(np.isclose(sums[agent], returns[agent], rtol=1e-9, atol=1e-12) for agent in returns):
            raise _Fault(f"returns in the {name} differ from those in the parallel environment: {sums}, {returns}")
        if not np.array_equal(labs.shelf.vessels[member], episode.env.laboratories.shelf.vessels[0]):
            raise _Fault(f"vessels in the {name} differ from those in the parallel environment after the same actions")


def _check_conservation(scenario: Scenario) -> None:
    atoms = element_matrix(scenario).T
    for episode in _episodes(scenario):
        labs = episode.env.laboratories
        initial = (labs.shelf.total() + labs.state.delivered)[0] @ atoms
        while not episode.over and len(episode.actions) < _ROUNDS:
            episode.play(1)
            change = (labs.shelf.total() + labs.state.delivered)[0] @ atoms - initial
            worst = int(np.abs(change / np.maximum(np.abs(initial), 1e-3)).argmax())
            if not abs(change[worst]) <= _ROUNDING * max(abs(initial[worst]), 1e-3):
                elements = sorted({e for material in scenario.materials.values() for e in material.composition})
                raise _Fault(
                    f"round {len(episode.actions)}: {[*elements, 'charge'][worst]} changed by {change[worst]:.3g} mol "
                    f"of {initial[worst]:.6g} mol after {episode.actions[-1]}"
                )
            for name, amounts in (("vessels", labs.shelf.amounts), ("bottles", labs.shelf.stock)):
                if not (np.isfinite(amounts).all() and (amounts >= 0.0).all()):
                    raise _Fault(f"round {len(episode.actions)}: {name} contain negative or non-finite amounts")


def _check_records(scenario: Scenario) -> None:
    env, rng = raw_env(scenario), np.random.default_rng(4)
    labs = env.laboratories
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.jsonl"
        with Recorder(path, labs) as recorder:
            env.reset(seed=4)
            recorder.begin(4)
            for _ in range(_ROUNDS):
                agent, mask = env.agent_selection, env.infos[env.agent_selection].get("action_mask")
                if env.terminations[agent]:
                    break
                seen, action = env.observe(agent), _legal(env.action_space(agent), mask, rng)
                env.step(action)
                recorder.turn([Play(labs.agents.index(agent), seen, mask, action)])
        record = read_record(path if path.exists() else recorder.part)
    # Paths of custom parts are relative to the record's folder; here it stands for the scenario's.
    record = dataclasses.replace(record, path=Path(scenario.origin).with_name(record.path.name))
    result = verify_record(record, scenario, trust=True)
    if result.status not in ("ok", "torn"):  # torn: the episode has more than _ROUNDS turns
        raise _Fault(f"verification of a random episode's record failed: {result.message}")


CHECKS: dict[str, tuple[str, Callable[[Scenario], None]]] = {
    "spaces": ("observations are in their spaces; rewards finite; legal actions exist and are valid", _check_spaces),
    "end": ("an episode ends at its limits", _check_end),
    "seeds": ("the same seed gives the same episode", _check_seeds),
    "copies": ("copies, pickles and snapshots continue alike", _check_copies),
    "environments": ("AEC, parallel and batched environments agree", _check_environments),
    "conservation": ("elements and charge are conserved; amounts are not negative", _check_conservation),
    "records": ("a record of an episode verifies", _check_records),
}
"""Meaning and function of each check, by name."""


def check_scenario(scenario: Scenario | str | Path) -> Iterator[CheckResult]:
    """Run every check and yield the results.

    Args:
        scenario: a loaded scenario, a bundled scenario's name, or a path.

    Raises:
        DataError: the scenario, or a part that it names, cannot be loaded.
    """
    spec = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    raw_env(spec)
    for name, (meaning, check) in CHECKS.items():
        error = None
        try:
            check(spec)
        except _Fault as fault:
            error = str(fault)
        except Exception as raised:  # raised by a bench or an instrument under test
            error = f"{type(raised).__name__}: {raised}"
        yield CheckResult(name, meaning, error)
