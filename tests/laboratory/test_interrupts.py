"""A step that is interrupted, or fails in the middle, has come to its end or says at the next one: call reset()."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from helpers import digest

import chemlab
from chemlab.agents.background import role_env, role_vector_env
from chemlab.envs.aec import raw_env
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.parallel import parallel_env
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.sandbox import Flask

WURTZ = "wurtz_dodecane"
OWN = str(Path(chemlab.__file__).resolve().parents[1])
SEED, STEPS = 11, 8


class Interrupter:
    """Raises an error at the n-th line of chemlab's that is run."""

    def __init__(self, line: int) -> None:
        self.left = line

    def __call__(self, frame: FrameType, event: str, argument: Any) -> Any:
        if not frame.f_code.co_filename.startswith(OWN) or "/tests/" in frame.f_code.co_filename:
            return None
        if event == "line":
            self.left -= 1
            if self.left < 0:
                sys.settrace(None)
                raise KeyboardInterrupt
        return self


def traced(call: Callable[[], Any], interrupter: Interrupter) -> bool:
    """Whether a call was interrupted."""
    before = sys.gettrace()
    sys.settrace(interrupter)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def lines_of(call: Callable[[], Any]) -> int:
    """How many lines of chemlab's a call runs."""
    counter = Interrupter(10**9)
    traced(call, counter)
    return 10**9 - counter.left


def interrupted(call: Callable[[], Any], line: int) -> bool:
    """Whether a call was interrupted at that line."""
    return traced(call, Interrupter(line))


class Played(NamedTuple):
    """An environment that plays a script: by its turns, whatever its interface is."""

    env: Any
    reset: Callable[[], Any]
    """begins the episode of :data:`SEED` and returns what is shown"""
    step: Callable[[int], Any]
    """plays the k-th step and returns what comes of it"""
    arrays: Callable[[], list[Any]]
    """the state that an interruption may spoil"""

    def state(self) -> str:
        return digest([np.array(array) for array in self.arrays()])


def script(labs: Laboratories, number: int, k: int) -> Any:
    """The k-th action of a script: start both benches, wait, work a little."""
    if number == 0:
        actions = labs.actions
        moves = [("measure", 0, "balance"), ("start", "ext_0", 0, "dodecane"), ("start", "dit_0", 1, "dodecane")]
        return actions.encode(*moves[k]) if k < 3 else actions.encode("wait")
    bench = labs.benches[number - 1]
    return bench.end_action if k >= 5 else (3 * k + number) % bench.end_action


def aec(env: Any = None) -> Played:
    """Here and below: a new environment, or the one that is given."""
    env = env or raw_env(WURTZ)
    raw = env.unwrapped
    labs = raw.laboratories

    def shown() -> Any:
        return (env.agent_selection, env.rewards, raw._cumulative_rewards, env.terminations, env.infos)

    def reset() -> Any:
        env.reset(seed=SEED)
        return shown()

    def step(k: int) -> Any:
        env.step(script(labs, labs.turn(), k))
        return shown()

    return Played(env, reset, step, lambda: [*labs.arrays(), np.frombuffer(repr(shown()).encode(), np.uint8)])


def parallel(env: Any = None) -> Played:
    env = env or parallel_env(WURTZ)
    labs = env.laboratories

    def step(k: int) -> Any:
        turns = np.flatnonzero(labs.turns(labs.members)[:, 0])
        return env.step({labs.agents[n]: script(labs, int(n), k) for n in turns})

    return Played(env, lambda: env.reset(seed=SEED), step, labs.arrays)


def batched(env: Any = None) -> Played:
    env = env or BatchedLaboratory(2, WURTZ, idle_observations=True)
    labs = env.laboratories

    def step(k: int) -> Any:
        turns = np.flatnonzero(labs.turns(labs.members)[:, 0])
        return env.step({labs.agents[n]: np.array([script(labs, int(n), k)] * 2) for n in turns})

    return Played(env, lambda: env.reset(seed=SEED), step, lambda: [*labs.arrays(), env._turns, env._last_turn])


def for_one(env: Any, act: Callable[[int], Any]) -> Played:
    """An environment for one agent, which plays ``act(k)``."""
    return Played(env, lambda: env.reset(seed=SEED), lambda k: env.step(act(k)), lambda: env.get_state()[:-2])


def focal(env: Any = None) -> Played:
    env = env or role_env(WURTZ)
    return for_one(env, lambda k: script(env.laboratories, 0, k))


def focal_vector(env: Any = None) -> Played:
    env = env or role_vector_env(2, WURTZ, autoreset_mode=AutoresetMode.SAME_STEP)
    submit = env.laboratories.actions.encode("submit", 0)
    return for_one(env, lambda k: np.array([script(env.laboratories, 0, k), submit]))


def _bench_action(count: int, k: int) -> int:
    return count - 1 if k == 3 else (5 * k + 2) % (count - 1)


def bench(env: Any = None) -> Played:
    return for_one(env or RoleEnv(WURTZ, bench="ext"), lambda k: 1 + 2 * k)


def bench_vector(env: Any = None) -> Played:
    env = env or RoleVectorEnv(3, WURTZ, bench="ext", threads=2, autoreset_mode=AutoresetMode.NEXT_STEP)
    count = env.action_count
    return for_one(env, lambda k: np.array([_bench_action(count, k), 3, count - 1]))


def sb3(env: Any = None) -> Played:
    pytest.importorskip("stable_baselines3")
    from chemlab.agents.sb3 import ChemlabVecEnv

    env = env or ChemlabVecEnv(2, scenario=WURTZ, bench="ext")
    count = env.batch.action_count

    def reset() -> Any:
        env.seed(SEED)
        return env.reset()

    def step(k: int) -> Any:
        found = list(env.step(np.array([_bench_action(count, k), 3])))
        for info in found[3]:
            info.get("episode", {}).pop("t", None)
        return found

    return Played(env, reset, step, lambda: [*env.batch.get_state()[:-2], env._returns, env._lengths])


ENVIRONMENTS = {f.__name__: f for f in (aec, parallel, batched, focal, focal_vector, bench, bench_vector, sb3)}


def results_of(played: Played, first: int = 0) -> list[str]:
    """What comes of a whole episode: of its reset and of every step, or of the steps from ``first`` on."""
    begun = [] if first else [digest(played.reset())]
    return begun + [digest(played.step(k)) for k in range(first, STEPS)]


REFUSED = "call reset()"


def outcome(played: Played, k: int) -> str:
    """What comes of a step, or that it asks for a reset."""
    try:
        return digest(played.step(k))
    except (ValueError, gymnasium.error.ResetNeeded) as error:
        return REFUSED if REFUSED in str(error) else str(error)


def points(count: int) -> Iterator[int]:
    """Lines to interrupt at: the first and the last ones, and some in between."""
    yield from sorted({*range(min(4, count)), *range(max(count - 8, 0), count), *range(0, count, max(count // 12, 1))})


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_an_interrupted_step_is_whole_or_asks_for_a_reset(name: str) -> None:
    """Wherever it is interrupted: nothing has happened, or all of it, or the next step refuses; a reset heals."""
    played = ENVIRONMENTS[name]()
    results = results_of(played)
    assert results_of(ENVIRONMENTS[name]()) == results
    refused = 0
    for k in (0, 1, 3, STEPS - 2):
        played.reset()
        for j in range(k):
            played.step(j)
        count = lines_of(lambda k=k: played.step(k))  # type: ignore[misc]
        for line in points(count):
            assert [digest(played.reset()), *(digest(played.step(j)) for j in range(k))] == results[: k + 1]
            before = played.state()
            if not interrupted(lambda k=k: played.step(k), line):  # type: ignore[misc]
                continue  # another number of lines is run the second time
            following = k if played.state() == before else k + 1
            came = outcome(played, following)
            if came == REFUSED:
                refused += 1
                assert outcome(played, following) == REFUSED  # and goes on refusing
                continue
            rest = [came, *(digest(played.step(j)) for j in range(following + 1, STEPS))]
            assert rest == results[following + 1 :], f"step {k} goes on after line {line} of {count}"
    assert refused > 10
    assert results_of(played) == results


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_an_interrupted_reset_is_whole_or_asks_for_another(name: str) -> None:
    played = ENVIRONMENTS[name]()
    results = results_of(played)
    refused = 0
    for line in points(lines_of(played.reset)):
        played.reset()
        played.step(0)
        before = played.state()
        if not interrupted(played.reset, line):
            continue
        following = 1 if played.state() == before else 0
        came = outcome(played, following)
        if came == REFUSED:
            refused += 1
        else:
            rest = [came, *(digest(played.step(j)) for j in range(following + 1, STEPS))]
            assert rest == results[following + 1 :], f"goes on after line {line} of the reset"
        assert results_of(played) == results
    assert refused > 5


@pytest.mark.parametrize("name", ["aec", "parallel", "batched", "focal", "focal_vector"])
def test_a_step_that_fails_in_the_middle_asks_for_a_reset(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by an interruption: reward terms, models and policies of the user's own may raise anything."""
    played = ENVIRONMENTS[name]()
    results = results_of(played)
    played.reset()
    with monkeypatch.context() as patch:

        def fail(*arguments: Any) -> None:
            raise MemoryError("no room")

        patch.setattr(Laboratories, "age", fail)
        with pytest.raises(MemoryError):
            played.step(0)
    assert outcome(played, 0) == REFUSED
    assert results_of(played) == results


def test_a_flask_is_as_it_was_or_as_it_will_be() -> None:
    """A flask cannot be reset: an interrupted operation has happened in all of its flasks or in none."""

    def flasks() -> tuple[Flask, Flask]:
        pot = Flask({"water": 10.0, "diethyl_ether": 2.0}, physics="paper", capacity_l=1.0)
        return pot, pot.another({"water": 1.0})

    def state(pot: Flask, receiver: Flask) -> str:
        whole = [(one.amounts, one.waste, one.events, one.temperature_k, one._row.tolist()) for one in (pot, receiver)]
        return digest(whole)

    operations: dict[str, Callable[[Flask, Flask], Any]] = {
        "heat": lambda pot, receiver: pot.heat(60e3, receiver),
        "lose": lambda pot, receiver: pot.heat(60e3),
        "cool": lambda pot, receiver: pot.cool(5e3),
        "drain": lambda pot, receiver: pot.drain(receiver, 0.3),
        "pour": lambda pot, receiver: pot.pour(receiver, 0.5),
        "add": lambda pot, receiver: pot.add("dodecane", 0.5),
        "filter": lambda pot, receiver: pot.filter(receiver),
        "wait": lambda pot, receiver: pot.wait(10.0),
        "mix": lambda pot, receiver: pot.mix(),
    }
    for name, operation in operations.items():
        pot, receiver = flasks()
        operation(pot, receiver)
        after = state(pot, receiver)
        pot, receiver = flasks()
        before, undone = state(pot, receiver), 0
        count = lines_of(lambda p=pot, r=receiver, operation=operation: operation(p, r))  # type: ignore[misc]
        for line in points(count):
            pot, receiver = flasks()
            if not interrupted(lambda p=pot, r=receiver, operation=operation: operation(p, r), line):  # type: ignore[misc]
                continue
            now = state(pot, receiver)
            assert now in (before, after), f"{name}: line {line} of {count}"
            undone += now == before
            operation(pot, receiver) if now == before else None
            assert state(pot, receiver) == after, name
        assert undone > 0
