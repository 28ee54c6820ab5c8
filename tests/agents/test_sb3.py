"""The adapter to Stable-Baselines3: what it returns, compared with single environments, and learners that run on it."""

from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason='Stable-Baselines3 is not installed: pip install ".[train]"')
pytest.importorskip("sb3_contrib", reason='sb3-contrib is not installed: pip install ".[train]"')

import torch
from gymnasium.wrappers.vector import TransformReward
from helpers import random_actions, refused, state_of, watched, weights
from sb3_contrib import MaskablePPO, RecurrentPPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy as evaluate_masked
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecNormalize

from chemlab.agents.advice import Advisor
from chemlab.agents.background import role_vector_env
from chemlab.agents.policies import agent_policy
from chemlab.agents.recurrent import MaskedLstmPolicy
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.config.loading import load_scenario
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv


def manager_batch(members: int, name: str = "wurtz_dodecane") -> ChemlabVecEnv:
    """The manager's view of a batch of laboratories."""
    return ChemlabVecEnv(role_vector_env(members, name, autoreset_mode="SameStep"))


@pytest.mark.parametrize(("bench", "copy"), [("rxn", True), ("ext", False), ("dit", True)])
def test_members_are_single_environments(bench: str, copy: bool) -> None:
    venv = ChemlabVecEnv(4, bench=bench, copy=copy)
    singles = [RoleEnv(bench=bench) for _ in range(4)]
    assert venv.observation_space == singles[0].observation_space
    assert venv.action_space == singles[0].action_space
    assert venv.seed(20) == [20, 21, 22, 23]
    seen = venv.reset()
    for i, one in enumerate(singles):
        np.testing.assert_array_equal(seen[i], one.reset(seed=20 + i)[0])
    returns, lengths, ends = np.zeros(4), np.zeros(4), 0
    kept: list[tuple[Any, Any]] = [(seen, seen.copy())]
    for action in random_actions(RoleEnv(bench=bench).action_space, 110, 4):
        seen, rewards, dones, infos = venv.step(action)
        kept.append((seen, seen.copy()))
        assert seen.dtype == rewards.dtype == np.float32
        for i, one in enumerate(singles):
            observation, reward, over, _, info = one.step(action[i])
            returns[i] += reward
            lengths[i] += 1
            assert rewards[i] == np.float32(reward)
            assert dones[i] == over
            assert infos[i]["TimeLimit.truncated"] is False
            assert "seen" not in infos[i], "what a wrapper writes into an info stays there"
            infos[i]["seen"] = 1
            assert (infos[i]["cost"], infos[i]["illegal_action"]) == (info["cost"], info["illegal_action"])
            assert ("terminal_observation" in infos[i]) == ("episode" in infos[i]) == ("score" in infos[i]) == over
            if over:
                ends += 1
                np.testing.assert_array_equal(infos[i]["terminal_observation"], observation)
                assert infos[i]["score"] == info["score"]
                assert infos[i]["episode"]["r"] == pytest.approx(returns[i], abs=1e-6)  # rounded, as Monitor does
                assert infos[i]["episode"]["l"] == lengths[i]
                assert infos[i]["episode"]["t"] >= 0.0
                returns[i], lengths[i] = 0.0, 0
                observation = one.reset()[0]
            np.testing.assert_array_equal(seen[i], observation)
    assert ends >= 8
    for once, then in kept:  # SB3 stores observations after the next step
        np.testing.assert_array_equal(once, then)
    venv.close()


def test_seeds_are_used_once() -> None:
    venv = ChemlabVecEnv(2, bench="rxn", goals=None)
    venv.seed(5)
    first = [venv.reset() for _ in range(12)]
    assert len({one.tobytes() for one in first}) > 1, "goals are drawn anew"
    venv.seed(5)
    np.testing.assert_array_equal(first, [venv.reset() for _ in range(12)])
    venv.seed(6)
    for wrong in (1.5, True, [1], [1, -1]):
        refused("seed.*given", venv.seed, wrong)
    other = [venv.reset() for _ in range(12)]
    np.testing.assert_array_equal(np.array(other)[:, 0], np.array(first)[:, 1])  # seed 6 is member 0's now


def test_options() -> None:
    venv = ChemlabVecEnv(3, bench="dit")
    goals = venv.get_attr("bench")[0].goals.names
    venv.seed(1)
    venv.set_options({"goal": "NaCl"})
    np.testing.assert_array_equal(venv.reset()[:, -len(goals) :].argmax(axis=1), [goals.index("NaCl")] * 3)
    venv.seed(1)
    venv.set_options([{"goal": "dodecane"}, {}, {"goal": "NaCl"}])
    seen = venv.reset()
    for i, options in enumerate(({"goal": "dodecane"}, None, {"goal": "NaCl"})):
        np.testing.assert_array_equal(seen[i], RoleEnv(bench="dit").reset(seed=1 + i, options=options)[0])
    venv.set_options([{"goal": "NaCl"}, {}, {}])
    venv.reset()
    assert venv.get_attr("batch")[0].episodes.begun.tolist() == [2, 2, 2], "every member goes on to its next episode"
    before = state_of(venv)
    venv.set_options([{"goal": "NaCl"}, {"goal": "gold"}, {}])
    refused("gold", venv.reset)
    assert state_of(venv) == before
    venv.step(np.zeros(3, dtype=np.int64))


def test_a_refused_action_is_not_told_to_the_advisor() -> None:
    batch = role_vector_env(2, "wurtz_scarce", autoreset_mode="SameStep")
    venv = ChemlabVecEnv(batch, advisor=Advisor(agent_policy("scripted", batch.laboratories, 0), batch.action_count))
    venv.reset()
    before = state_of(venv)
    refused("manager_0: actions must be 2 integers", venv.step, np.array([0, 10**6]))
    assert state_of(venv) == before


def test_attributes_and_methods() -> None:
    venv = ChemlabVecEnv(3, bench="ext", threads=2)
    venv.seed(0)
    venv.reset()
    assert venv.render_mode is None
    assert venv.get_attr("agent") == ["ext_0"] * 3
    assert venv.get_attr("action_space", [0, 2]) == [venv.action_space] * 2
    assert venv.get_attr("observation_space", 1) == [venv.observation_space]
    assert not venv.has_attr("no_such_thing")
    venv.set_attr("copy", False)
    assert venv.get_attr("copy") == [False] * 3
    venv.set_attr("copy", False, indices=[0, 1, -1])
    refused("members share it", venv.set_attr, "copy", True, indices=[0])
    assert venv.get_attr("copy") == [False] * 3
    with pytest.raises(AttributeError, match="no_such_thing"):
        venv.set_attr("no_such_thing", 1)
    with pytest.raises(AttributeError, match="no_such_method"):
        venv.env_method("no_such_method")
    state = venv.env_method("get_state", indices=0)[0]
    assert [type(one) for one in state] == [np.ndarray] * len(state)
    with pytest.raises(IndexError):
        venv.get_attr("copy", indices=3)
    assert venv.env_is_wrapped(Monitor) == [True] * 3  # "episode" is in the infos
    assert venv.env_is_wrapped(gymnasium.wrappers.TimeLimit, [1]) == [False]
    venv.close()


@pytest.mark.parametrize("bench", ["ext", "dit"])
def test_masks_are_where_sb3_contrib_looks(bench: str) -> None:
    venv = ChemlabVecEnv(5, bench=bench)
    batch = RoleVectorEnv(5, bench=bench, autoreset_mode="SameStep")
    venv.seed(2)
    venv.reset()
    batch.reset(seed=2)
    assert is_masking_supported(venv)
    for action in random_actions(RoleEnv(bench=bench).action_space, 60, 5):
        masks = get_action_masks(venv)
        assert masks.shape == (5, venv.action_space.n)  # type: ignore[attr-defined]
        assert masks.dtype == np.bool_
        np.testing.assert_array_equal(masks, batch.action_masks())
        np.testing.assert_array_equal(venv.env_method("action_masks", indices=[3]), masks[[3]])
        np.testing.assert_array_equal([method() for method in venv.get_attr("action_masks")], masks)
        venv.step(action)
        batch.step(action)
    continuous = ChemlabVecEnv(2, bench="rxn")
    assert not is_masking_supported(continuous)
    with pytest.raises(AttributeError, match="continuous"):
        continuous.env_method("action_masks")


def test_observations_that_end_with_the_mask() -> None:
    """The members play on as they did; what is new stands behind what there was, in the space, too."""
    plain, shown = ChemlabVecEnv(3, bench="dit"), ChemlabVecEnv(3, bench="dit", show_masks=True)
    size, actions = plain.observation_space.shape[0], plain.action_space.n  # type: ignore[index, attr-defined]
    assert shown.observation_space.shape == (size + actions,)
    assert shown.get_attr("observation_space") == [shown.observation_space] * 3
    for venv in (plain, shown):
        venv.seed(4)
    seen, both, ended = plain.reset(), shown.reset(), 0
    for action in random_actions(RoleEnv(bench="dit").action_space, 80, 3):
        np.testing.assert_array_equal(both, np.concatenate([seen, plain.action_masks()], axis=1))
        assert all(shown.observation_space.contains(one) for one in both)
        seen, rewards, _, _ = plain.step(action)
        both, same, dones, infos = shown.step(action)
        np.testing.assert_array_equal(rewards, same)
        for i in np.flatnonzero(dones):
            assert shown.observation_space.contains(infos[i]["terminal_observation"])
            ended += 1
    assert ended
    np.testing.assert_array_equal(shown.set_state(shown.get_state()), both)


def test_an_existing_batch_wrapped_or_not() -> None:
    batch = RoleVectorEnv(2, bench="rxn", autoreset_mode="SameStep")
    halved = TransformReward(RoleVectorEnv(2, bench="rxn", autoreset_mode="SameStep"), lambda rewards: 0.5 * rewards)
    plain_venv, wrapped_venv = ChemlabVecEnv(batch), ChemlabVecEnv(halved)
    for venv in (plain_venv, wrapped_venv):
        venv.seed(0)
        venv.reset()
    for action in random_actions(RoleEnv(bench="rxn").action_space, 45, 2):
        seen, rewards, _, _ = plain_venv.step(action)
        wrapped_seen, wrapped_rewards, _, infos = wrapped_venv.step(action)
        np.testing.assert_array_equal(seen, wrapped_seen)
        np.testing.assert_allclose(wrapped_rewards, 0.5 * rewards, atol=1e-6)
    assert wrapped_venv.get_attr("func")[0](2.0) == 1.0
    assert wrapped_venv.get_attr("batch")[0] is halved.unwrapped.batch  # type: ignore[attr-defined]
    assert infos[0]["TimeLimit.truncated"] is False


def test_batches_it_cannot_take() -> None:
    refused("SAME_STEP", ChemlabVecEnv, RoleVectorEnv(2, bench="rxn"))
    refused("SAME_STEP", ChemlabVecEnv, 2, autoreset_mode="NextStep")
    batch = RoleVectorEnv(2, bench="rxn", autoreset_mode="SameStep")
    refused("no arguments, given bench", ChemlabVecEnv, batch, bench="ext")
    refused("show_masks: continuous", ChemlabVecEnv, 2, bench="rxn", show_masks=True)
    with pytest.raises(TypeError, match="one of chemlab's batches"):
        ChemlabVecEnv(gymnasium.make_vec("CartPole-v1", num_envs=2))


def test_ppo_learns_reproducibly_and_hears_of_episodes() -> None:
    def learned(seed: int, env: Any) -> Any:
        model = PPO("MlpPolicy", env, n_steps=40, batch_size=80, n_epochs=2, seed=seed, device="cpu")
        before = weights(model)
        model.learn(320)
        assert not np.array_equal(weights(model), before)
        return model

    model, again, other = (learned(seed, ChemlabVecEnv(4, bench="rxn")) for seed in (3, 3, 4))
    assert len(model.ep_info_buffer) == 320 // 20  # an experiment has 20 steps
    assert {info["l"] for info in model.ep_info_buffer} == {20}
    np.testing.assert_array_equal(weights(again), weights(model))
    assert not np.array_equal(weights(other), weights(model))
    learned(3, VecNormalize(ChemlabVecEnv(4, bench="rxn")))


@pytest.mark.parametrize("bench", ["ext", "dit"])
def test_masked_ppo_never_plays_a_masked_action(bench: str) -> None:
    common: dict[str, Any] = {"n_steps": 64, "n_epochs": 1, "seed": 0, "device": "cpu"}
    remembering, small = ChemlabVecEnv(4, bench=bench, show_masks=True), {"lstm_hidden_size": 8}
    for model in (
        MaskablePPO("MlpPolicy", ChemlabVecEnv(4, bench=bench), **common),
        RecurrentPPO(MaskedLstmPolicy, remembering, policy_kwargs=small, **common),
    ):
        found = watched(model, 512)
        assert found["ends"] >= 8
        assert found["illegal"] == 0
    plain = PPO("MlpPolicy", ChemlabVecEnv(4, bench=bench), **common)
    assert watched(plain, 256)["illegal"] > 0, "without masks it does"


def test_a_sequence_goes_through_the_memory_at_once_as_turn_by_turn() -> None:
    """Whether its first turn begins an episode or goes on with one; sb3-contrib's own goes turn by turn."""
    torch.manual_seed(0)
    lstm, sequences, turns = torch.nn.LSTM(5, 4), 3, 7
    features, before = torch.randn(sequences * turns, 5), torch.randn(1, sequences, 4)
    starts = torch.zeros(sequences, turns)
    for begins in ((0, 0), (2, 0), (1, 3)):  # an episode that begins within a sequence, too
        starts[begins] = 1.0
        given = (features, (before, 2 * before), starts.flatten(), lstm)
        found, after = MaskedLstmPolicy._process_sequence(*given)
        one_by_one, last = RecurrentActorCriticPolicy._process_sequence(*given)
        torch.testing.assert_close(found, one_by_one)
        torch.testing.assert_close(after, last)


@pytest.mark.parametrize("name", ["wurtz_dodecane", "wurtz_two_lines"])
def test_masked_ppo_manages_a_batch_of_laboratories(name: str) -> None:
    model = MaskablePPO(
        "MlpPolicy", manager_batch(8, name), n_steps=16, batch_size=32, n_epochs=1, seed=0, device="cpu"
    )
    found = watched(model, 256)
    assert (found["illegal"], found["ends"] > 0) == (0, True)
    assert np.isfinite(weights(model)).all()
    assert max(found["ticks"]) > 1, "the benches' experiments are single steps of the manager"
    given: Any = {"n_eval_episodes": 4, "return_episode_rewards": True}
    rewards, lengths = evaluate_masked(model, manager_batch(2, name), **given)
    assert len(rewards) == len(lengths) == 4  # type: ignore[arg-type]
    assert max(lengths) <= load_scenario(name).limits.manager_actions  # type: ignore[arg-type, type-var]


def test_single_and_batched_views_train_alike() -> None:
    """The same seeds, the same episodes: PPO ends with the same weights whichever environment it ran on."""
    found = []
    for venv in (manager_batch(2), make_vec_env("chemlab/LabManager-v1", 2)):
        model = MaskablePPO("MlpPolicy", venv, n_steps=16, batch_size=32, n_epochs=1, seed=0, device="cpu")
        model.learn(64)
        found.append(weights(model))
    np.testing.assert_allclose(*found, rtol=1e-4, atol=1e-6)
