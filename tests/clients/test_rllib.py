"""Ray RLlib: the same laboratory turn by turn; masks and discounts of the recipe."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ray.rllib", reason='needs the extra: pip install ".[rllib]"')

import ray
import torch
from helpers import random_legal, refused, script
from ray.rllib.core.columns import Columns
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner

from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.agents.rllib import LaboratoryMultiAgentEnv
from chemlab.agents.roles import role_of
from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from chemlab.laboratory import raw_env

ROLES = ["manager", "rxn", "ext", "dit"]


@pytest.fixture
def recipe(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The recipe: networks and settings."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "recipes"))
    return script("recipes/rllib.py")


IGNORED = ("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::ResourceWarning")
pytestmark = pytest.mark.filterwarnings(*IGNORED)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A Ray for this module alone, which runs find and leave alone; a short path, as sockets want it."""
    folder = tempfile.mkdtemp(prefix="ray", dir="/tmp")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    small: Any = {"num_cpus": 2, "object_store_memory": 100_000_000}
    ray.init("local", include_dashboard=False, log_to_driver=False, _temp_dir=folder, **small)
    yield
    ray.shutdown()
    shutil.rmtree(folder, ignore_errors=True)


def parts(observation: Any) -> tuple[Any, Any]:
    """What an agent sees, and its mask."""
    if isinstance(observation, dict):
        return observation["observations"], observation["action_mask"]
    return observation, None


@pytest.mark.parametrize("scenario", ["wurtz_two_lines", "fictitious"])
def test_same_actions_give_the_same_observations_and_rewards(scenario: str) -> None:
    """RLlib's environment beside PettingZoo's in one script; the cooperative mix pays everybody for what others do."""
    ours = LaboratoryMultiAgentEnv({"scenario": scenario, "rewards": "cooperative"})
    theirs, rng = raw_env(scenario, rewards="cooperative"), np.random.default_rng(1)
    for seed in range(3):
        theirs.reset(seed=seed)
        observations, infos = ours.reset(seed=seed)
        earned, paid = dict.fromkeys(theirs.agents, 0.0), dict.fromkeys(theirs.agents, 0.0)
        acted, over = set(), False
        while not over:
            agent = theirs.agent_selection
            assert list(observations) == list(infos) == [agent]
            assert ours.observation_spaces[agent].contains(observations[agent])
            seen, mask = parts(observations[agent])
            observation, _, _, _, info = theirs.last()
            np.testing.assert_array_equal(seen, observation)
            np.testing.assert_equal(infos[agent], info)
            if mask is not None:
                np.testing.assert_array_equal(mask, info["action_mask"])
            action = random_legal(theirs.action_space(agent), mask, rng)
            acted.add(agent)
            theirs.step(action)
            for name, reward in theirs.rewards.items():
                paid[name] += reward
            observations, rewards, terminated, truncated, infos = ours.step({agent: action})
            for name, reward in rewards.items():
                assert reward == theirs._cumulative_rewards[name]
                earned[name] += reward
            over = terminated["__all__"] or truncated["__all__"]
            assert terminated["__all__"] == all(theirs.terminations.values())
            assert truncated["__all__"] == all(theirs.truncations.values())
        assert set(observations) == acted, "everybody who has had a turn gets a last observation"
        for name in acted:
            assert earned[name] == pytest.approx(paid[name], rel=1e-12, abs=1e-15), "nothing is lost between turns"
        assert ours.score == theirs.laboratories.result(theirs.laboratories.members)[0]


@pytest.mark.parametrize("roles", [["rxn"], ["manager"], ["ext", "dit"]])
def test_roles_that_do_not_learn_are_played_inside(roles: list[str]) -> None:
    """With the scripted policy of the learning roles the episode is the one that scripted policies play alone."""
    env = LaboratoryMultiAgentEnv({"scenario": "wurtz_dodecane", "roles": roles, "background": "scripted"})
    alone = raw_env("wurtz_dodecane")
    expected = play_episode(alone, make_policies("scripted", alone.laboratories), 7)
    observations, _ = env.reset(seed=7)
    learners, labs, over = make_policies("scripted", env.laboratory.laboratories), env.laboratory.laboratories, False
    while not over:
        (agent,) = observations
        assert role_of(agent) in roles
        seen, mask = parts(observations[agent])
        turns = labs.roles[labs.agents.index(agent)].turns_had
        action = learners[agent].act(seen[None], None if mask is None else mask[None], turns, labs.members)[0]
        observations, _, terminated, truncated, _ = env.step({agent: action})
        over = terminated["__all__"] or truncated["__all__"]
    assert env.score == expected.score
    assert set(env.agents) == {agent for agent in labs.agents if role_of(agent) in roles}


def test_seeds_begin_the_same_episodes() -> None:
    """Background policies' streams included; without a seed the streams go on; RLlib's runners get others."""
    settings = {"scenario": "wurtz_any", "roles": ["manager"], "background": "random"}
    env = LaboratoryMultiAgentEnv(settings)

    def episode(seed: int | None, env: LaboratoryMultiAgentEnv) -> list[float]:
        observations, rng, rewards, over = env.reset(seed=seed)[0], np.random.default_rng(0), [], False
        seen = [float(observations["manager_0"]["observations"].sum())]
        while not over:
            action = random_legal(None, observations["manager_0"]["action_mask"], rng)
            observations, reward, terminated, truncated, _ = env.step({"manager_0": action})
            rewards.append(reward["manager_0"])
            over = terminated["__all__"] or truncated["__all__"]
        return [*seen, *rewards]

    first, second = episode(3, env), episode(None, env)
    assert first == episode(3, env)
    assert second == episode(None, env)
    assert first != second

    class Context(dict[str, Any]):
        worker_index = 2

    assert episode(3, LaboratoryMultiAgentEnv(Context(settings))) == episode(2003, env)


def test_wrong_settings_and_steps_are_named() -> None:
    made, cook = LaboratoryMultiAgentEnv, "roles: wurtz_dodecane has manager, rxn, ext, dit; given cook"
    refused(r"env_config: known: scenario, .*; given scenery", made, {"scenery": "wurtz_dodecane"})
    refused(cook, made, {"roles": ["cook"]})
    chosen = made({"roles": "rxn", "actions": "discrete"})
    assert (chosen.possible_agents, chosen.reset(seed=0)[0].keys()) == (["rxn_0"], {"rxn_0"})
    assert "action_mask" in chosen.reset()[0]["rxn_0"]
    env = made({"scenario": "wurtz_dodecane"})
    refused("call reset", env.step, {"manager_0": 0})
    env.reset(seed=0)
    refused("manager_0: has the turn", env.step, {"rxn_0": np.zeros(4)})
    refused("step: needs a mapping of actions by agent", env.step, None)
    refused(r"manager_0: .*given -1", env.step, {"manager_0": -1})
    refused('options must be a dict such as {"goal": "dodecane"}', env.reset, options=["goal"])


TAPES: list[_Taped] = []


class _Taped(LaboratoryMultiAgentEnv):
    """Keeps what it was asked to do and what it paid for it, agent by agent."""

    def __init__(self, config: Any = None) -> None:
        super().__init__(config)
        self.episodes: list[dict[str, list[tuple[Any, Any, float]]]] = []
        self.illegal = 0
        TAPES.append(self)

    def reset(self, **arguments: Any) -> Any:
        observations, infos = super().reset(**arguments)
        self.episodes.append(defaultdict(list))
        self._open = {agent: parts(seen)[0] for agent, seen in observations.items()}
        self._played: dict[str, Any] = {}
        return observations, infos

    def step(self, action_dict: dict[str, Any]) -> Any:
        (agent,) = action_dict
        self._played[agent] = action_dict[agent]
        found = super().step(action_dict)
        self.illegal += bool(self.laboratory.infos[agent]["illegal_action"])
        for name, seen in found[0].items():
            if name in self._played:
                self.episodes[-1][name].append((self._open[name], self._played.pop(name), found[1][name]))
            self._open[name] = parts(seen)[0]
        return found


def test_rllib_collects_what_was_played(cluster: None, recipe: Any) -> None:
    """Through RLlib's env runner, which cuts episodes wherever a batch is full: every agent's observations, actions and
    rewards, in order, are those of the environment; no illegal action in 2000 turns; continuous ones are clipped."""
    TAPES.clear()
    config = recipe.algorithm_config(load_scenario("wurtz_dodecane"), ROLES, seed=11, envs=3).environment(_Taped)
    runner = MultiAgentEnvRunner(config=config, worker_index=1)
    chunks = [chunk for _ in range(60) for chunk in runner.sample(num_timesteps=37)]
    collected: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    ended = []
    for chunk in chunks:
        for agent, part in chunk.agent_episodes.items():
            seen = part.get_observations()
            seen = seen["observations"] if isinstance(seen, dict) else seen
            collected[chunk.id_][agent] += list(zip(seen[:-1], part.get_actions(), part.get_rewards(), strict=True))
        if chunk.is_done:
            ended.append(chunk.id_)
    assert len(ended) >= 10
    assert sum(tape.illegal for tape in TAPES) == 0
    tapes = [episode for tape in TAPES for episode in tape.episodes]
    found = 0
    for one in ended:
        lengths = {name: len(rows) for name, rows in collected[one].items()}
        same = [tape for tape in tapes if {name: len(rows) for name, rows in tape.items()} == lengths]
        found += any(alike(tape, collected[one]) for tape in same)
    assert found == len(ended)


def alike(tape: dict[str, list[Any]], collected: dict[str, list[Any]]) -> bool:
    for agent, rows in tape.items():
        for (seen, action, reward), (other, drawn, paid) in zip(rows, collected[agent], strict=True):
            drawn = np.clip(drawn, 0.0, 1.0) if role_of(agent) == "rxn" else drawn
            same = np.array_equal(seen, other) and np.allclose(action, drawn, atol=1e-7)
            if not (same and np.isclose(reward, paid, rtol=1e-6, atol=1e-9)):
                return False
    return True


def test_illegal_actions_have_no_probability(recipe: Any) -> None:
    labs = Laboratories("wurtz_dodecane", 1)
    env = LaboratoryMultiAgentEnv({"scenario": "wurtz_dodecane"})
    for number, agent in enumerate(labs.agents):
        space, actions = env.observation_spaces[agent], env.action_spaces[agent]
        module = recipe.RoleModule(observation_space=space, action_space=actions)
        seen = torch.rand(64, labs.observation_sizes[number])
        if not labs.action_counts[number]:
            batch = {Columns.OBS: seen}
            means, log_std = module.forward_train(batch)[Columns.ACTION_DIST_INPUTS].chunk(2, dim=-1)
            assert means.shape == log_std.shape == (64, actions.shape[0])
            continue
        mask = (torch.rand(64, labs.action_counts[number]) < 0.2).to(torch.int8)
        mask[:, 0] = 1
        batch = {Columns.OBS: {"observations": seen, "action_mask": mask}}
        logits = module.forward_train(batch)[Columns.ACTION_DIST_INPUTS]
        chances = module.get_train_action_dist_cls().from_logits(logits)
        assert (torch.softmax(logits, -1)[mask == 0] == 0.0).all()
        assert all(mask[torch.arange(64), chances.sample()].all() for _ in range(50))
        assert torch.isfinite(chances.entropy()).all()
        assert module.compute_values(batch).shape == (64,)


def test_every_role_has_its_own_discount(cluster: None, recipe: Any) -> None:
    """RLlib's own learner has one for all; here the manager's returns are plain sums, and the benches' discounted."""
    settings = {"envs": 2, "gamma": 0.5, "manager_gamma": 1.0, "gae_lambda": 1.0}
    config = recipe.algorithm_config(load_scenario("wurtz_dodecane"), ROLES, **settings)
    runner = MultiAgentEnvRunner(config=config, worker_index=1)
    learner = config.build_learner(spaces=runner.get_spaces())
    # lambda 1 makes the targets discounted sums of rewards, whatever the value network says, where episodes are whole.
    episodes = runner.sample(num_episodes=4)
    own = {
        role: [part.get_rewards() for e in episodes for name, part in e.agent_episodes.items() if role_of(name) == role]
        for role in ROLES
    }
    batch = learner._learner_connector(
        rl_module=learner.module, batch={}, episodes=episodes, shared_data={}, metrics=learner.metrics
    )
    for role, rewards in own.items():
        gamma, expected = (1.0 if role == "manager" else 0.5), []
        for row in rewards:
            sums, total = [], 0.0
            for reward in row[::-1]:
                total = float(reward) + gamma * total
                sums.append(total)
            expected += sums[::-1]
        real = batch[role]["loss_mask"]
        np.testing.assert_allclose(batch[role]["value_targets"][real].numpy(), expected, rtol=1e-4, atol=1e-5)
