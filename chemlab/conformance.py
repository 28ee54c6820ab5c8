"""Conformance checks of a scenario, with the benches, operations and instruments that it names.

>>> from chemlab.conformance import check_scenario
>>> [result.name for result in check_scenario("fictitious") if result.error]
[]

Every check plays random legal actions. A scenario that passes can be trained on, copied, batched and recorded like a
bundled one.
"""

from __future__ import annotations

import copy
import dataclasses
import pickle
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from .config.inherit import declared_levels
from .config.loading import load_scenario, reachable_materials
from .config.materials import atoms_of
from .config.scenario import Scenario
from .envs.aec import raw_env
from .envs.batch import BatchedLaboratory
from .envs.parallel import parallel_env
from .envs.role_env import RoleEnv
from .physics.chemistry import element_matrix
from .record import Play, Recorder, read_record, verify_record
from .roles.kinds import BENCH_KINDS

_ROUNDS = 300
"""Most rounds of an episode that a check plays."""
_MOST = 5000
"""Largest limit of actions or ticks that a check plays up to; a scenario's higher one is lowered for it."""
_ROUNDING = 1e-9
"""Largest relative change of an element's amount, or of the charge in mol, that counts as rounding."""


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check.

    Attributes:
        name: of the check.
        meaning: what holds where it passes.
        error: what is wrong; None if it passes.
    """

    name: str
    meaning: str
    error: str | None


_FROZEN_K = 200.0
"""A bench whose whole range of temperatures is below it was likely described in degrees Celsius."""


def doubts(scenario: Scenario) -> list[str]:
    """Return a line for each probable mistake in a valid scenario, beginning with its key.

    Raises:
        DataError: the scenario, another level of its file, or a part that it names cannot be loaded.
    """
    raw_env(scenario)  # checks the keys of benches
    file = Path(scenario.origin)
    for level in declared_levels(file) if file.suffix == ".toml" else ():
        raw_env(f"{file}@{level}")
    at_hand = {name: mol for name, mol in scenario.stock.items() if mol > 0.0}
    for vessel in scenario.shelf.vessel:
        for name, mol in vessel.contents.items():
            if mol > 0.0:
                at_hand[name] = at_hand.get(name, 0.0) + mol
    drawn = {name for draw in scenario.world.draws.values() for name in draw.materials}
    own = any(bench.kind not in BENCH_KINDS or bench.model for bench in scenario.benches.values())
    possible = reachable_materials(scenario, [*at_hand, *drawn])
    found = []
    for key, bench in scenario.benches.items():
        if bench.kind not in BENCH_KINDS:
            continue  # its options may mean anything
        extra = bench.model_extra or {}
        fed = [*extra.get("reagents", ()), *(part.get("material") for part in extra.get("process", ()))]
        for name in dict.fromkeys(name for name in fed if name):
            if scenario.stock.get(name, 0.0) <= 0.0 and name not in drawn:
                found.append(
                    f"benches.{key}: adds {name!r}, of which there is none: give stock.{name} an amount in mol"
                )
        hottest = (extra.get("temperature_k") or {}).get("high", _FROZEN_K)
        if hottest < _FROZEN_K:
            found.append(
                f"benches.{key}.temperature_k: high = {hottest:g} K is {hottest - 273.15:.0f} degrees Celsius; give "
                "temperatures in K"
            )
    for goal in scenario.lab_goals:
        if goal not in possible and not own:
            found.append(f"goals: no reaction makes {goal!r} of what is in stock and on the shelf")
        elif not drawn and not own:
            most = _most_of(goal, at_hand, scenario)
            given = scenario.theoretical_maximum_mol[goal]
            if given > most * (1.0 + 1e-6):
                found.append(
                    f"theoretical_maximum_mol.{goal}: {given:g} mol, but the atoms in stock and on the shelf are "
                    f"enough for {most:.3g} mol"
                )
    return found


def _most_of(goal: str, at_hand: Mapping[str, float], scenario: Scenario) -> float:
    """Return mol of a goal that the atoms of all materials at hand suffice for."""
    materials = scenario.materials
    atoms = atoms_of(at_hand, materials)
    return min(atoms.get(element, 0.0) / number for element, number in materials[goal].composition.items())


class _Fault(Exception):
    """A property that does not hold."""


def _same(one: Any, other: Any) -> bool:
    """Equality of nested dictionaries and sequences of arrays, bit for bit."""
    if isinstance(one, Mapping):
        return isinstance(other, Mapping) and one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(_same, one, other))
    first, second = np.asarray(one), np.asarray(other)
    return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=first.dtype.kind == "f")


def _legal(space: gymnasium.Space[Any], mask: Any, rng: np.random.Generator) -> Any:
    """A random legal action."""
    if isinstance(space, gymnasium.spaces.Discrete):
        return int(rng.choice(np.flatnonzero(mask)))
    return rng.random(space.shape)


class _Episode:
    """An episode of the parallel environment by random legal actions, and all that it showed."""

    def __init__(self, env: Any, seed: int) -> None:
        self.env, self.rng = env, np.random.default_rng(seed)
        self.actions: list[dict[str, Any]] = []
        self.shown: list[Any] = [env.reset(seed=seed)]
        self.infos: dict[str, Any] = self.shown[0][1]

    @property
    def over(self) -> bool:
        """True when the episode has ended."""
        return not self.env.agents

    def play(self, rounds: int) -> list[Any]:
        """Play up to a number of rounds; return what they showed."""
        begun = len(self.shown)
        for _ in range(rounds):
            if self.over:
                break
            turn = [agent for agent in self.env.agents if self.infos[agent]["has_turn"]]
            actions = {
                agent: _legal(self.env.action_space(agent), self.infos[agent].get("action_mask"), self.rng)
                for agent in turn
            }
            results = self.env.step(actions)
            self.infos = results[-1]
            self.actions.append(actions)
            self.shown.append((*results, self.env.state()))
        return self.shown[begun:]


def _played(scenario: Scenario, seed: int, rounds: int = _ROUNDS) -> _Episode:
    episode = _Episode(parallel_env(scenario), seed)
    episode.play(rounds)
    return episode


def _check_spaces(scenario: Scenario) -> None:
    for seed in range(3):
        episode = _played(scenario, seed)
        env = episode.env
        for number, shown in enumerate(episode.shown):
            for agent, observation in shown[0].items():
                space = env.observation_space(agent)
                if not space.contains(observation):
                    outside = np.flatnonzero(~((observation >= space.low) & (observation <= space.high)))
                    raise _Fault(
                        f"round {number}, {agent}: entries {outside[:5].tolist()} of the observation are not "
                        f"in [0, 1]: {np.asarray(observation)[outside[:5]].tolist()}"
                    )
            for agent, info in shown[-2 if number else 1].items():
                if info["has_turn"] and not np.any(info.get("action_mask", 1)):
                    raise _Fault(f"round {number}, {agent}: has the turn and no legal action")
                if not np.isfinite([info["cost"], *(shown[1].values() if number else ())]).all():
                    raise _Fault(f"round {number}, {agent}: a reward or a cost is not finite")
                if info["illegal_action"]:
                    raise _Fault(f"round {number}, {agent}: an action that its mask allows was invalid")


def _check_end(scenario: Scenario) -> None:
    lower = {key: min(number, _MOST) for key, number in dict(scenario.limits).items() if key != "budget"}
    limits = scenario.limits.model_copy(update=lower)
    most = limits.manager_actions + limits.ticks + 1
    if not _played(scenario.model_copy(update={"limits": limits}), 0, most).over:
        raise _Fault(f"the episode goes on after {most} rounds, beyond limits.manager_actions and limits.ticks")


def _experiments(env: RoleEnv) -> list[Any]:
    """Return what two experiments of a bench alone show, by random legal actions."""
    rng = np.random.default_rng(1)
    shown: list[Any] = []
    for seed in (1, None):
        shown.append(env.reset(seed=seed))
        for _ in range(env.max_episode_steps):
            shown.append(env.step(_legal(env.action_space, shown[-1][-1].get("action_mask"), rng)))
            if shown[-1][2]:
                break
    return shown


def _check_seeds(scenario: Scenario) -> None:
    env = parallel_env(scenario)
    first, again = _Episode(env, 1), _Episode(parallel_env(scenario), 1)
    shown = first.play(_ROUNDS)
    if not _same(shown, again.play(_ROUNDS)):
        raise _Fault("the same seed gives another episode in a second environment")
    if not _same(shown, _Episode(env, 1).play(_ROUNDS)):
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
            raise _Fault(f"{name} of an environment in mid-episode plays on differently")
    if episode.over:  # its environment takes no further step
        return
    after = labs.snapshot()
    labs.restore(kept)
    for actions in episode.actions[12:]:
        episode.env.step(actions)
    if not _same(after, labs.snapshot()):
        raise _Fault("a restored snapshot plays on differently")


def _check_environments(scenario: Scenario) -> None:
    episode = _played(scenario, 3)
    totals = {agent: sum(shown[1][agent] for shown in episode.shown[1:]) for agent in episode.env.possible_agents}
    single, batch = raw_env(scenario), BatchedLaboratory(2, scenario, autoreset=False)
    single.reset(seed=3)
    batch.reset(seed=2)
    paid, batched = dict.fromkeys(totals, 0.0), dict.fromkeys(totals, 0.0)
    for actions in episode.actions:
        for _ in actions:
            single.step(actions[single.agent_selection])
            for agent in paid:
                paid[agent] += single.rewards[agent]
        chosen = {agent: np.zeros((2, *(batch.action_space(agent).shape or ()))) for agent in totals}
        for agent, action in actions.items():
            chosen[agent][1] = action
        _, rewards, over, _, _ = batch.step(
            {agent: array if array.ndim > 1 else array.astype(np.int64) for agent, array in chosen.items()}
        )
        for agent in batched:
            batched[agent] += rewards[agent][1]
        if over[0]:
            batch.reset(options={"reset_mask": np.array([True, False])})
    for name, found, labs, member in (
        ("AEC environment", paid, single.laboratories, 0),
        ("batch", batched, batch.laboratories, 1),
    ):
        if not all(np.isclose(found[agent], totals[agent], rtol=1e-9, atol=1e-12) for agent in totals):
            raise _Fault(f"rewards of the {name} are not those of the parallel environment: {found}, {totals}")
        if not np.array_equal(labs.shelf.vessels[member], episode.env.laboratories.shelf.vessels[0]):
            raise _Fault(f"vessels of the {name} are not those of the parallel environment after the same actions")


def _check_conservation(scenario: Scenario) -> None:
    atoms = element_matrix(scenario).T
    for seed in range(3):
        episode = _Episode(parallel_env(scenario), seed)
        labs = episode.env.laboratories
        begun = (labs.shelf.total() + labs.state.delivered)[0] @ atoms
        while not episode.over and len(episode.actions) < _ROUNDS:
            episode.play(1)
            change = (labs.shelf.total() + labs.state.delivered)[0] @ atoms - begun
            worst = int(np.abs(change / np.maximum(np.abs(begun), 1e-3)).argmax())
            if not abs(change[worst]) <= _ROUNDING * max(abs(begun[worst]), 1e-3):
                raise _Fault(
                    f"round {len(episode.actions)}: {_elements(scenario)[worst]} changed by {change[worst]:.3g} mol "
                    f"of {begun[worst]:.6g} mol after {episode.actions[-1]}"
                )
            for name, amounts in (("vessels", labs.shelf.amounts), ("bottles", labs.shelf.stock)):
                if not (np.isfinite(amounts).all() and (amounts >= 0.0).all()):
                    raise _Fault(f"round {len(episode.actions)}: {name} hold amounts that are negative or not finite")


def _elements(scenario: Scenario) -> list[str]:
    """Names of the columns of the element matrix."""
    return [*sorted({e for material in scenario.materials.values() for e in material.composition}), "charge"]


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
    # Parts are found from the folder of the record, which is the scenario's here.
    record = dataclasses.replace(record, path=Path(scenario.origin).with_name(record.path.name))
    result = verify_record(record, scenario, trust=True)
    if result.status not in ("ok", "torn"):  # torn: the episode is longer than what was played
        raise _Fault(f"the record of a random episode does not verify: {result.message}")


CHECKS: dict[str, tuple[str, Callable[[Scenario], None]]] = {
    "spaces": ("observations are in their spaces; rewards finite; legal actions exist and are valid", _check_spaces),
    "end": ("an episode ends at its limits", _check_end),
    "seeds": ("the same seed gives the same episode", _check_seeds),
    "copies": ("copies, pickles and snapshots play on alike", _check_copies),
    "environments": ("AEC, parallel and batched environments agree", _check_environments),
    "conservation": ("elements and charge are conserved; amounts are not negative", _check_conservation),
    "records": ("a record of an episode verifies", _check_records),
}
"""Meaning and function of each check, by name."""


def check_scenario(scenario: Scenario | str | Path) -> Iterator[CheckResult]:
    """Run every check on a scenario: a loaded one, a bundled name, or a file.

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
        except Exception as raised:  # of a bench or an instrument under test
            error = f"{type(raised).__name__}: {raised}"
        yield CheckResult(name, meaning, error)
