"""Every interface refuses actions outside their space, wrong seeds and options, and goes on unchanged."""

import itertools
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from helpers import laboratory, refused, state_of

from chemlab.agents.background import role_env, role_vector_env
from chemlab.config.loading import load_scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.inputs import checked_actions
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.laboratory import env as laboratory_env
from chemlab.laboratory import parallel_env, raw_env

WURTZ = "wurtz_dodecane"
WRONG_NUMBERS: list[Any] = [-1, None, "0", b"0", 0.0, 1.5, float("nan"), True, np.True_, np.float32(0.0)]
WRONG_NUMBERS += [np.array([0, 1]), np.array([0]), np.array(True), [0], {}, [], object(), 10**400, 1j]


def wrong_boxes(size: int) -> list[Any]:
    """Everything but ``size`` numbers from 0 to 1."""
    fine = np.full(size, 0.5)
    found: list[Any] = [None, 0.5, True, "0.5", b"0.5", {}, [], object(), 10**400, np.array(0.5), fine.astype(int) + 2]
    found += [fine[:-1], np.append(fine, 0.5), fine[None], fine[:, None], [list(fine), list(fine)], fine + 0.1j]
    found += [np.where(np.arange(size) == 1, wrong, fine) for wrong in (np.nan, np.inf, 1.0001, -0.0001)]
    found += [[0.5] * (size - 1) + [last] for last in ([0.5], "x", 10**400, None)] + [["0.5"] * size]
    return found


def aec(agent: str) -> tuple[Any, Callable[[Any], Any]]:
    """A laboratory in which an agent has the turn, and what plays its action."""
    env = laboratory(WURTZ)
    for action in () if agent == "manager_0" else (("start", agent, 0, "dodecane"), ("wait",)):
        env.step(env.laboratories.actions.encode(*action))
    return env, env.step


def parallel(agent: str) -> tuple[Any, Callable[[Any], Any]]:
    """The same, with another agent that has the turn, too, and plays what it may."""
    env = parallel_env(WURTZ)
    env.reset(seed=0)
    starts = (("start", "rxn_0", 0, "dodecane"), ("start", "ext_0", 1, "dodecane"), ("wait",))
    for action in () if agent == "manager_0" else starts:
        env.step({"manager_0": env.laboratories.actions.encode(*action)})
    return env, lambda action: env.step({"rxn_0": np.full(6, 0.5), "ext_0": 3, agent: action})


def view(agent: str) -> tuple[Any, Callable[[Any], Any]]:
    """The same through the view of the agent."""
    env = role_env(WURTZ, agent)
    env.reset(seed=0)
    return env, env.step


def alone(agent: str) -> tuple[Any, Callable[[Any], Any]]:
    """The same on a single bench."""
    env = RoleEnv(WURTZ, bench=agent.partition("_")[0])
    env.reset(seed=0)
    return env, env.step


def test_an_action_outside_its_space_changes_nothing() -> None:
    """Nobody's action is played, wherever in the order the bad one stands."""
    for make, agent in itertools.product((aec, parallel, view, alone), ("manager_0", "ext_0", "rxn_0")):
        if make is alone and agent == "manager_0":
            continue
        (env, step), (twin, step_twin) = make(agent), make(agent)
        space = env.action_space if make in (view, alone) else env.action_space(agent)
        if isinstance(space, gymnasium.spaces.Discrete):
            wrong, fine, expected = [*WRONG_NUMBERS, int(space.n)], 3, f"integer from 0 to {space.n - 1}"
        else:
            wrong, fine, expected = wrong_boxes(6), np.full(6, 0.5), "6 finite numbers from 0 to 1"
        before = state_of(env)
        for action in wrong:
            case = f"{make.__name__}, {agent}: {action!r}"
            message = refused(agent, step, action)
            assert expected in message
            assert repr(action) in message
            assert state_of(env) == before, case
        np.testing.assert_equal(step(fine), step_twin(fine))
        assert state_of(env) == state_of(twin) != before


def test_wrong_actions_of_batches_for_one_agent_change_nothing() -> None:
    wrong: list[Any] = [None, "x", -1, 10**6, True, np.full(5, 0.5), np.full(6, np.nan), np.full(6, 1.01), object()]
    wrong += [np.array([0, -1]), np.array([0.0, 0.5]), np.full((2, 6), 1.01)]
    batches = [role_vector_env(2, WURTZ, agent) for agent in ("manager_0", "rxn_0", "ext_0")]
    for batch in (*batches, *(RoleVectorEnv(2, WURTZ, bench=key) for key in ("rxn", "ext"))):
        batch.reset(seed=0)
        before = state_of(batch)
        for actions in wrong:
            refused(f"{batch.agent}: actions must be", batch.step, actions)
            assert state_of(batch) == before, actions


def test_the_wrong_number_of_a_large_batch_is_found() -> None:
    """Also where numpy would leave most of the batch out, and among the rows that count."""
    numbers, boxes = np.zeros(2000, dtype=np.int64), np.full((2000, 6), 0.5)
    numbers[[7, 1500]], boxes[7, 0], boxes[1500, 4] = 99, np.nan, np.nan
    rows = np.arange(2000) > 10
    for space, actions, found in (
        (gymnasium.spaces.Discrete(41), numbers, "99 at [1500]"),
        (gymnasium.spaces.Discrete(41), np.where(numbers, 2**64 - 1, 0).astype(np.uint64), f"{2**64 - 1} at [1500]"),
        (gymnasium.spaces.Box(0.0, 1.0, (6,)), boxes, "nan at [1500, 4]"),
    ):
        message = refused("x: actions must be", checked_actions, "x", actions, 2000, space, rows)
        assert message.endswith(f"given {found}")


def test_arguments_that_name_nothing() -> None:
    for env in (BatchedLaboratory(1, WURTZ), raw_env(WURTZ), parallel_env(WURTZ)):
        for of_agent in (env.action_space, env.observation_space, getattr(env, "observe", env.action_space)):
            refused("unknown agent 'rxn'; agents: manager_0, rxn_0", of_agent, "rxn")
    refused("one of 'NextStep', 'SameStep', 'Disabled', given 'same'", RoleVectorEnv, autoreset_mode="same")


def test_actions_of_a_round_are_by_agent() -> None:
    for make in (parallel_env, SEVERAL["laboratories"]):
        env: Any = make(WURTZ)
        env.reset(seed=0)
        before = state_of(env)
        for actions in (None, 3, [3], np.zeros(3, dtype=np.int64)):
            refused('mapping of actions by agent such as {"manager_0": ...}', env.step, actions)
            assert state_of(env) == before, actions


def test_a_dead_agent_has_one_action_and_none_has_a_turn_without_an_episode() -> None:
    """Refused calls change nothing: the end is played as if nobody had asked."""
    for make in (raw_env, laboratory_env):
        env: Any = make(WURTZ)

        def stepped(env: Any = env) -> None:
            env.unwrapped.step(None)

        for call in (env.last, env.action_masks, stepped):
            refused(r"the episode is over \(or has not begun\): call reset\(\)", call)
        env.reset(seed=0)
        env.step(env.unwrapped.laboratories.actions.encode("submit", 0))
        assert all(env.terminations.values())
        for agent in env.agent_iter():
            before = state_of(env.unwrapped)
            refused(f"{agent}: the episode is over, so its action must be None, given 0", env.step, 0)
            assert env.agent_selection == agent
            assert state_of(env.unwrapped) == before
            assert env.last()[2]
            env.step(None)
        assert not env.agents
        for call in (env.last, env.action_masks, stepped):
            refused(r"the episode is over \(or has not begun\): call reset\(\)", call)


ONE: dict[str, Callable[[str], Any]] = {
    "AEC": raw_env,
    "parallel": parallel_env,
    "view": role_env,
    "bench": lambda name: RoleEnv(name, bench=next(iter(load_scenario(name).benches))),
}
SEVERAL: dict[str, Callable[[str], Any]] = {
    "laboratories": lambda name: BatchedLaboratory(3, name),
    "views": lambda name: role_vector_env(3, name),
    "benches": lambda name: RoleVectorEnv(3, name, bench=next(iter(load_scenario(name).benches))),
}
ALL = (*ONE, *SEVERAL)
WRONG: list[tuple[str, dict[str, Any], str, tuple[str, ...]]] = [
    *(
        (WURTZ, {"seed": seed}, r"seed.*integer of at least 0", ALL)
        for seed in (-1, 1.9, True, [5, -1, 0], [1.9, "2", 0], np.array([1.0, 2.0, 3.0]), np.array(3))
    ),
    (WURTZ, {"seed": [5, 1, 2]}, r"seed.*integer of at least 0", tuple(ONE)),  # one for each of a batch
    (WURTZ, {"seed": [1, 2]}, "3 members, given 2", tuple(SEVERAL)),
    *(
        (WURTZ, {"seed": 1, "options": {"goal": goal}}, f"dodecane.*given.*{goal!r}", ALL)
        for goal in ("gold", "water", 3)
    ),
    (WURTZ, {"seed": 1, "options": "goal"}, 'options must be a dict such as {"goal": "dodecane"}, given .goal', ALL),
    (WURTZ, {"seed": 1, "options": {"gaol": "dodecane"}}, "reset options", ALL[2:]),  # PettingZoo's tests give others
    *(
        (WURTZ, {"options": {"reset_mask": mask}}, "reset_mask must be 3 booleans", tuple(SEVERAL))
        for mask in ([True], np.ones(3), np.ones(2, dtype=np.bool_), [1, 0, 1])
    ),
    (WURTZ, {"seed": 1, "options": {"world": 1}}, "no hidden parameters", ALL),
    *(("crude", {"seed": 1, "options": {"world": world}}, "must be a seed", ALL) for world in (-1, "x", True)),
    ("crude", {"seed": 1, "options": {"world": {"rote": 1.0}}}, "'rote' is not drawn", ALL),
]


def test_a_wrong_reset_changes_nothing() -> None:
    for name, scenario in itertools.product(ALL, (WURTZ, "crude")):
        env = {**ONE, **SEVERAL}[name](scenario)
        env.reset(seed=7)
        before = state_of(env)
        for where, arguments, message, whom in WRONG:
            if where == scenario and name in whom:
                refused(message, env.reset, **arguments)
                assert state_of(env) == before, f"{name}: {arguments}"


def test_a_goal_of_none_is_no_goal() -> None:
    """Every interface draws the goal then."""
    for name, make in {**ONE, **SEVERAL}.items():
        env, twin = make("wurtz_any"), make("wurtz_any")
        found, expected = env.reset(seed=7, options={"goal": None}), twin.reset(seed=7)
        np.testing.assert_equal(found or env.infos, expected or twin.infos, name)


def test_a_first_reset_is_of_all_and_comes_first() -> None:
    actions: list[Any] = [0, {"manager_0": 0}, 0, np.zeros(6)]
    actions += [{"manager_0": np.zeros(3, dtype=np.int64)}, np.zeros(3, dtype=np.int64), np.zeros((3, 6))]
    for make, action in zip((*ONE.values(), *SEVERAL.values()), actions, strict=True):
        env = make(WURTZ)
        with pytest.raises((ValueError, ResetNeeded), match=r"call reset\(\)"):
            env.step(action)
        if make in SEVERAL.values():
            refused("first reset", env.reset, options={"reset_mask": np.array([True, False, True])})


def test_numbers_of_members_and_threads() -> None:
    for make in (BatchedLaboratory, role_vector_env, RoleVectorEnv):
        for wrong in (0, True):
            refused(f"num_envs must be an integer of at least 1 .*given {wrong}", make, wrong)
        message = f"num_envs must be an integer of at least 1 and comes before scenario, given '{WURTZ}'"
        refused(message, make, WURTZ, 3)
    refused("threads must be an integer of at least 1", RoleVectorEnv, 1, bench="rxn", threads=0)
