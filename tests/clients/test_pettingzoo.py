"""PettingZoo's own tests and tools on every scenario, through both interfaces.

``max_cycles_test`` is left out: it wants an environment whose agents all act the same number of times.
``test_save_obs`` and ``state_test`` stand with the AEC environment's own tests.
"""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import (
    api_test,
    bombardment_test,
    parallel_api_test,
    parallel_seed_test,
    performance_benchmark,
    render_test,
    seed_test,
)
from pettingzoo.utils import (
    AssertOutOfBoundsWrapper,
    BaseWrapper,
    TerminateIllegalWrapper,
    aec_to_parallel,
    parallel_to_aec,
)
from pettingzoo.utils.average_total_reward import average_total_reward
from pettingzoo.utils.random_demo import random_demo
from pettingzoo.utils.wrappers import MultiEpisodeEnv, MultiEpisodeParallelEnv

from chemlab.laboratory import env as laboratory_env
from chemlab.laboratory import parallel_env, plain_infos, raw_env
from chemlab.laboratory.state import COST_ITEMS
from chemlab.scenario import SAFETY_EVENTS, scenario_names

SCENARIOS = scenario_names()
DISCRETE = "salt_from_oil"
"""A scenario in which every agent's actions are discrete."""

pytestmark = pytest.mark.filterwarnings(
    "error::UserWarning",
    # The roles differ, a bench without an experiment sees nothing, and the tests pass an option of their own.
    "ignore:Agents have different observation space sizes",
    "ignore:Observations are different shapes",
    "ignore:Observation numpy array is all zeros",
    "ignore:.*reset options",
)


def seed_spaces(env: Any) -> None:
    """The tests sample actions from the spaces."""
    for i, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(i)


# -- its tests --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SCENARIOS)
def test_api(name: str) -> None:
    for env in (laboratory_env(name), plain_infos(laboratory_env(name))):
        seed_spaces(env)
        api_test(env, num_cycles=200)


@pytest.mark.parametrize("name", SCENARIOS)
def test_parallel_api(name: str) -> None:
    for env in (parallel_env(name), plain_infos(parallel_env(name))):
        seed_spaces(env)
        parallel_api_test(env, num_cycles=200)


@pytest.mark.parametrize("name", SCENARIOS)
def test_seeds(name: str) -> None:
    seed_test(lambda: laboratory_env(name), num_cycles=200)
    parallel_seed_test(lambda: parallel_env(name), num_cycles=200)


class StepReturnsObservation(BaseWrapper):
    """``bombardment_test`` takes what ``step`` returns for the next agent's observation.

    No environment of PettingZoo returns one, so without this the test fails on all of them.
    """

    def step(self, action: Any) -> Any:
        super().step(action)
        return self.env.observe(self.env.agent_selection)


@pytest.mark.parametrize("name", SCENARIOS)
def test_bombardment(name: str) -> None:
    env = StepReturnsObservation(laboratory_env(name))
    seed_spaces(env)
    bombardment_test(env, cycles=100)


@pytest.mark.parametrize("name", SCENARIOS)
def test_render(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setitem(raw_env.metadata, "render_fps", 1000)  # mode "human" keeps to it
    modes = raw_env.metadata["render_modes"]

    def make(render_mode: str) -> Any:
        # render_test begins with mode "human", only to read the metadata.
        return laboratory_env(name, render_mode=render_mode if render_mode in modes else None)

    agents = laboratory_env(name).possible_agents[1:]
    render_test(make, custom_tests={"ansi": lambda text: all(agent in text for agent in agents)})


@pytest.mark.parametrize("name", SCENARIOS)
def test_performance_benchmark(name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    # It takes five seconds by its own clock, which here runs twenty times too fast. That it runs is what counts here;
    # tests/benchmarks measures.
    module = sys.modules["pettingzoo.test.performance_benchmark"]
    clock = module.time.perf_counter  # type: ignore[attr-defined]
    monkeypatch.setattr(module, "time", SimpleNamespace(time=lambda: 20.0 * clock()))
    performance_benchmark(laboratory_env(name))
    words = capsys.readouterr().out.split()
    assert float(words[words.index("turns") - 1]) > 0.0


# -- its tools --------------------------------------------------------------------------------------------------------


def test_demonstrations(capsys: pytest.CaptureFixture[str]) -> None:
    assert np.isfinite(random_demo(laboratory_env(), render=False, episodes=2))
    assert np.isfinite(average_total_reward(laboratory_env(), max_episodes=2))
    assert capsys.readouterr().out.count("Average total reward") == 2


def test_conversions() -> None:
    env = parallel_to_aec(parallel_env())
    seed_spaces(env)
    api_test(env, num_cycles=100)
    with pytest.raises(AssertionError, match="is_parallelizable"):
        aec_to_parallel(laboratory_env())


def test_terminating_and_asserting_wrappers_read_the_mask_from_info() -> None:
    env = AssertOutOfBoundsWrapper(TerminateIllegalWrapper(raw_env(DISCRETE), illegal_reward=-1.0))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(30):
        _, _, terminated, truncated, info = env.last()
        if terminated or truncated:
            env.reset()
            continue
        env.step(int(rng.choice(np.flatnonzero(info["action_mask"]))))
    env.reset(seed=0)
    illegal = int(np.flatnonzero(env.last()[4]["action_mask"] == 0)[0])
    env.step(illegal)
    assert all(env.terminations.values())
    assert env.rewards["manager_0"] == -1.0
    env.reset(seed=0)
    with pytest.raises(AssertionError, match="action is not in action space"):
        env.step(10**6)


def test_several_episodes_in_one() -> None:
    episodes = 3

    class Counted(raw_env):
        begun = 0

        def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
            self.begun += 1
            super().reset(seed, options)

    env = Counted(DISCRETE)
    several = MultiEpisodeEnv(env, num_episodes=episodes)
    several.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in several.agent_iter():
        _, _, terminated, truncated, info = several.last()
        over = terminated or truncated
        several.step(None if over else int(rng.choice(np.flatnonzero(info["action_mask"]))))
    assert env.begun == episodes
    parallel = MultiEpisodeParallelEnv(parallel_env(DISCRETE), num_episodes=episodes)
    _, infos = parallel.reset(seed=0)
    ends = 0
    while parallel.agents:
        actions = {agent: int(rng.choice(np.flatnonzero(infos[agent]["action_mask"]))) for agent in parallel.agents}
        _, _, _, _, infos = parallel.step(actions)
        ends += "submitted_mol" in infos["manager_0"]
    assert ends >= 1


# -- plain infos ------------------------------------------------------------------------------------------------------


def assert_plain(plain: dict[str, Any], full: dict[str, Any], shapes: dict[str, Any]) -> None:
    """The same facts, in arrays whose shapes and types never change."""
    assert {key: (np.shape(value), np.asarray(value).dtype) for key, value in plain.items()} == shapes
    for key in plain.keys() & full.keys() - {"events", "costs"}:
        np.testing.assert_array_equal(plain[key], full[key])
    assert plain["experiment_over"] == ("score" in full)
    found = dict(zip(SAFETY_EVENTS, plain["events"], strict=True))
    assert {kind: value for kind, value in found.items() if value} == full["events"]
    if "costs" in full:
        assert dict(zip(COST_ITEMS, plain["costs"], strict=True)) == full["costs"]


@pytest.mark.parametrize("name", SCENARIOS)
def test_plain_infos_say_the_same_in_numbers(name: str) -> None:
    rng = np.random.default_rng(0)
    inner = raw_env(name)
    env = plain_infos(inner)
    shapes: dict[str, Any] = {}

    def compare() -> None:
        for agent in env.agents:
            info = env.infos[agent]
            if not shapes.get(agent):
                shapes[agent] = {key: (np.shape(value), np.asarray(value).dtype) for key, value in info.items()}
            assert_plain(info, inner.infos[agent], shapes[agent])
            if agent != env.agent_selection and "action_mask" in info and "action_mask" not in inner.infos[agent]:
                assert info["action_mask"].sum() == 1

    for seed in range(4):
        env.reset(seed=seed)
        compare()
        for _ in range(150):
            mask = env.infos[env.agent_selection].get("action_mask")
            space = env.action_space(env.agent_selection)
            legal = None if mask is None else np.flatnonzero(mask)
            env.step(rng.random(space.shape) if legal is None else int(rng.choice(legal)))
            compare()
            if any(env.terminations.values()) or any(env.truncations.values()):
                break
    assert {"costs", "submitted_mol", "purity"} <= shapes["manager_0"].keys()


def test_plain_infos_are_the_laboratorys() -> None:
    from pettingzoo.test.example_envs import generated_agents_env_v0

    with pytest.raises(TypeError, match="chemlab's laboratory"):
        plain_infos(generated_agents_env_v0.env())
