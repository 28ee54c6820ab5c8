"""PettingZoo's own tests and tools on every scenario, through both interfaces.

``max_cycles_test`` is left out: it wants an environment whose agents all act the same number of times.
``state_test`` stands with the AEC environment's own tests.
"""

from typing import Any

import numpy as np
import pytest
from helpers import FEATURED, seeded
from pettingzoo.test import api_test, bombardment_test, parallel_api_test, parallel_seed_test, render_test, seed_test
from pettingzoo.utils import AssertOutOfBoundsWrapper, BaseWrapper, TerminateIllegalWrapper
from pettingzoo.utils.conversions import aec_to_parallel, parallel_to_aec

from chemlab.lab.text import named_costs, named_events
from chemlab.laboratory import env as laboratory_env
from chemlab.laboratory import parallel_env, raw_env

DISCRETE = "salt_from_oil"
"""A scenario in which every agent's actions are discrete."""
SOME = ("crude", "failing", "wurtz_two_lines")
"""Where the interface is tried; ``tests/test_conformance.py`` tries every scenario."""

pytestmark = pytest.mark.filterwarnings(
    "error::UserWarning",
    # The roles differ, a bench without an experiment sees nothing, and the tests pass an option of their own.
    "ignore:Agents have different observation space sizes",
    "ignore:Observations are different shapes",
    "ignore:Observation numpy array is all zeros",
    "ignore:.*reset options",
)


@pytest.mark.parametrize("name", FEATURED)
def test_api(name: str) -> None:
    api_test(seeded(laboratory_env(name)), num_cycles=500)
    parallel_api_test(seeded(parallel_env(name)), num_cycles=200)


@pytest.mark.parametrize(("kind", "expected"), [("aec", raw_env), ("parallel", parallel_env)])
def test_the_registry_knows_the_laboratory(kind: str, expected: type) -> None:
    pettingzoo = pytest.importorskip("pettingzoo", minversion="1.27")
    env = pettingzoo.make(kind, "chemlab/Laboratory-v1", scenario="wurtz_dodecane_direct")
    env.reset(seed=0)
    assert env.possible_agents == ["manager_0", "rxn_0", "dit_0"]
    assert isinstance(env.unwrapped, expected)
    assert env.unwrapped.scenario.name == "wurtz_dodecane_direct"


class StepReturnsObservation(BaseWrapper):
    """``bombardment_test`` takes what ``step`` returns for the next agent's observation.

    No environment of PettingZoo returns one, so without this the test fails on all of them.
    """

    def step(self, action: Any) -> Any:
        super().step(action)
        return self.env.observe(self.env.agent_selection)


@pytest.mark.parametrize("name", SOME)
def test_seeds_bombardment_and_pictures(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seed_test(lambda: laboratory_env(name), num_cycles=200)
    parallel_seed_test(lambda: parallel_env(name), num_cycles=200)
    bombardment_test(StepReturnsObservation(seeded(laboratory_env(name))), cycles=100)
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setitem(raw_env.metadata, "render_fps", 1000)  # mode "human" keeps to it
    modes = raw_env.metadata["render_modes"]

    def make(render_mode: str) -> Any:
        # render_test begins with mode "human", only to read the metadata.
        return laboratory_env(name, render_mode=render_mode if render_mode in modes else None)

    agents = laboratory_env(name).possible_agents[1:]
    render_test(make, custom_tests={"ansi": lambda text: all(agent in text for agent in agents)})


def test_conversions() -> None:
    api_test(seeded(parallel_to_aec(parallel_env())), num_cycles=100)
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


def assert_flat(infos: dict[str, dict[str, Any]], shapes: dict[str, dict[str, Any]]) -> None:
    """Numbers and arrays of the same keys, shapes and types as at the beginning."""
    for agent, info in infos.items():
        found = {key: (np.shape(value), np.asarray(value).dtype) for key, value in info.items()}
        assert all(dtype.kind in "biuf" for _, dtype in found.values())
        assert shapes.setdefault(agent, found) == found


@pytest.mark.parametrize("name", SOME)
def test_infos_are_flat_and_say_what_has_happened(name: str) -> None:
    rng = np.random.default_rng(0)
    env = raw_env(name)
    labs = env.laboratories
    shapes: dict[str, dict[str, Any]] = {}
    for seed in range(4):
        env.reset(seed=seed)
        assert_flat(env.infos, shapes)
        for _ in range(150):
            agent = env.agent_selection
            number, mask = env.possible_agents.index(agent), env.infos[agent].get("action_mask")
            kept = {name: {key: np.copy(value) for key, value in info.items()} for name, info in env.infos.items()}
            seen = {name: dict(info) for name, info in env.infos.items()}
            env.step(rng.random(env.action_space(agent).shape) if mask is None else int(rng.choice(len(mask))))
            assert_flat(env.infos, shapes)
            # What was given before stays what it was, but for what an experiment's end adds to it.
            for name, info in seen.items():
                for key, value in info.items():
                    np.testing.assert_array_equal(value, kept[name][key])
            info = env.infos[agent]
            assert named_events(env.scenario, info) == labs.events(number)
            assert info["illegal_action"] == labs.roles[number].illegal[0]
            assert named_costs(env.infos["manager_0"]) == labs.costs() or env.agent_selection != "manager_0"
            for other in env.possible_agents:
                if other != env.agent_selection and "action_mask" in env.infos[other]:
                    resting = labs.roles[env.possible_agents.index(other)].resting_action
                    assert np.flatnonzero(env.infos[other]["action_mask"]).tolist() == [resting]
            if any(env.terminations.values()) or any(env.truncations.values()):
                assert env.infos["manager_0"]["score"] == labs.result(labs.members)[0]
                outcome = labs.outcome()
                assert env.infos["manager_0"]["submitted_mol"].sum() == pytest.approx(outcome["submitted_mol"])
                break
    assert {"costs", "goals", "submitted_mol", "purity"} <= shapes["manager_0"].keys()
