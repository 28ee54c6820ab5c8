"""TorchRL's environment over the batched laboratory: specs, the same episodes as elsewhere, and BenchMARL's critics."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused

pytest.importorskip("torchrl", reason="TorchRL is not installed: pip install torch==2.13.0 torchrl")

import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import agent_policy, make_policies
from chemlab.agents.torchrl.env import TorchLaboratory
from chemlab.lab.engine import Laboratories
from chemlab.laboratory import parallel_env

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")


@pytest.mark.parametrize(
    ("name", "more"),
    [("wurtz_two_lines", {}), ("unlabelled", {"actions": "discrete"}), ("fictitious", {"state": False})],
)
def test_specs(name: str, more: dict[str, Any]) -> None:
    env = TorchLaboratory(3, name, seed=0, **more)
    check_env_specs(env)
    assert env.group_map["rxn"] == ["rxn_0", "rxn_1"] or name != "wurtz_two_lines", "agents of a role are a group"
    assert ("state" in set(env.observation_spec.keys())) == more.get("state", True)


def test_roles_that_do_not_learn_are_played_as_in_any_other_laboratory() -> None:
    """The manager moves alone, with what the scripted one would play: the scripted laboratory's scores."""
    env = TorchLaboratory(3, "wurtz_two_lines", roles=["manager"])
    labs = Laboratories(env.scenario, 3)
    expected = play_laboratory(labs, make_policies("scripted", labs), None, 7)
    assert list(env.group_map) == ["manager"]
    assert {key for key in env.observation_spec.keys() if key != "state"} == {"manager"}  # noqa: SIM118
    seen = env._batch.laboratories
    manager = agent_policy("scripted", seen, 0)
    env.set_seed(7)
    now, scores = env.reset(), np.full(3, np.nan)
    while np.isnan(scores).any():
        turn = now["manager", "has_turn"][:, 0].numpy()
        members, actions = np.flatnonzero(turn), np.zeros(3, dtype=np.int64)
        if len(members):
            masks = now["manager", "action_mask"][members, 0].numpy().astype(np.int8)
            turns = seen.roles[0].turns_had[members]
            actions[members] = manager.act(now["manager", "observation"][members, 0].numpy(), masks, turns, members)
        now["manager", "action"] = torch.as_tensor(actions)[:, None]
        now = env.step(now)["next"]
        over = now["done"][:, 0].numpy() & np.isnan(scores)
        scores[over] = now["manager", "info", "score"][over, 0].numpy()
        now = env.reset(TensorDict({**now, "_reset": now["done"]}, [3])) if now["done"].any() else now
    np.testing.assert_allclose(scores, expected.returns, rtol=1e-6)
    with pytest.raises(ValueError, match=r"wurtz_two_lines has manager, rxn, ext, dit; given extraction"):
        TorchLaboratory(1, "wurtz_two_lines", roles=["extraction"])


def test_its_episodes_are_those_of_single_laboratories() -> None:
    """A random rollout, played again in the parallel environment; at an end the next row is of a new episode."""
    torch.manual_seed(0)
    rollout = TorchLaboratory(3, "wurtz_dodecane", seed=5).rollout(60, break_when_any_done=False)
    assert rollout["next", "done"].any()
    for member in range(3):
        single = parallel_env("wurtz_dodecane")
        observations, infos = single.reset(seed=5 + member)
        for step in range(60):
            now: Any = rollout[member, step]
            np.testing.assert_array_equal(now["state"].numpy(), single.state())
            for agent in single.possible_agents:
                group = agent.rpartition("_")[0]
                assert bool(now[group, "has_turn"][0]) == infos[agent]["has_turn"]
                if infos[agent]["has_turn"]:
                    np.testing.assert_array_equal(now[group, "observation"][0].numpy(), observations[agent])
                if "action_mask" in infos[agent]:
                    np.testing.assert_array_equal(now[group, "action_mask"][0].numpy(), infos[agent]["action_mask"])
                    assert now[group, "action_mask"][0, now[group, "action"][0]]
            actions = {agent: now[agent.rpartition("_")[0], "action"][0].numpy() for agent in single.possible_agents}
            observations, rewards, terminated, truncated, infos = single.step(actions)
            for agent in single.possible_agents:
                group = agent.rpartition("_")[0]
                assert float(now["next", group, "reward"][0, 0]) == pytest.approx(rewards[agent], rel=1e-6, abs=1e-7)
                assert float(now["next", group, "info", "score"][0]) == pytest.approx(infos[agent]["score"], rel=1e-6)
            assert bool(now["next", "terminated"]) == terminated["manager_0"]
            assert bool(now["next", "truncated"]) == truncated["manager_0"]
            if bool(now["next", "done"]):
                np.testing.assert_array_equal(now["next", "state"].numpy(), single.state())
                for agent, seen in observations.items():
                    np.testing.assert_array_equal(now["next", agent.rpartition("_")[0], "observation"][0].numpy(), seen)
                break


def test_seeds_begin_the_same_episodes_again() -> None:
    """A bad one is refused when it is given, and changes nothing."""
    env, other = TorchLaboratory(2, "unlabelled"), TorchLaboratory(2, "unlabelled", seed=3)
    first = []
    for _ in range(2):
        env.set_seed(3)
        for seed in (-1, 1.5, "2"):
            refused("seed: must be an integer of at least 0", env._set_seed, seed)
        first.append(env.reset()["state"].clone())
    assert torch.equal(*first)
    assert torch.equal(first[0], other.reset()["state"])
    assert not torch.equal(first[0], env.reset()["state"])


@pytest.mark.parametrize(("role", "background"), [("manager", "random"), ("east", "scripted")])
def test_a_refused_action_changes_nothing(role: str, background: str) -> None:
    """Nor what the others draw or remember."""
    env, twin = (TorchLaboratory(6, "failing", roles=[role], background=background, seed=0) for _ in range(2))
    now, expected, tried = env.reset(), twin.reset(), 0
    for _ in range(30):
        expected = twin.rand_action(expected)
        action = now[role, "action"] = expected[role, "action"].clone()
        if now[role, "has_turn"].any():
            refused(f"{role}.*: actions must be", env.step, now.clone().set((role, "action"), 0 * action + 10**6))
            tried += 1
        now, expected = env.step(now)["next"], twin.step(expected)["next"]
        assert torch.equal(now["state"], expected["state"])
        if now["done"].any():
            pairs = (env, now), (twin, expected)
            now, expected = (one.reset(seen.set("_reset", seen["done"])) for one, seen in pairs)
    assert tried > 20


def _trained(algorithm: str, folder: Path, **config: Any) -> Any:
    """An experiment of BenchMARL after two updates at toy size."""
    reason = "BenchMARL, or the TorchRL it needs, is not installed"
    pytest.importorskip("benchmarl.experiment", reason=reason, exc_type=ImportError)
    from benchmarl import algorithms
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from chemlab.agents.torchrl.task import laboratory_task

    settings = ExperimentConfig.get_from_yaml()
    settings.on_policy_collected_frames_per_batch = settings.off_policy_collected_frames_per_batch = 64
    settings.on_policy_n_envs_per_worker = settings.off_policy_n_envs_per_worker = 4
    settings.on_policy_minibatch_size = settings.off_policy_train_batch_size = 32
    settings.on_policy_n_minibatch_iters = settings.off_policy_n_optimizer_steps = 2
    settings.max_n_frames, settings.max_n_iters = 128, 2
    settings.evaluation, settings.render, settings.loggers, settings.create_json = False, False, [], False
    settings.save_folder, settings.checkpoint_interval, settings.checkpoint_at_end = str(folder), 0, False
    model = MlpConfig(num_cells=[16], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh)
    kind = getattr(algorithms, f"{algorithm}Config").get_from_yaml()
    task = laboratory_task("wurtz_dodecane_direct", rewards="cooperative", **config)
    experiment = Experiment(task=task, algorithm_config=kind, model_config=model, seed=0, config=settings)
    experiment.run()
    return experiment


def _critic_inputs(experiment: Any, group: str) -> int:
    """Numbers that the first layer of a group's critic takes."""
    critic = experiment.algorithm.get_loss_and_updater(group)[0].critic_network_params
    weights = [value for key, value in critic.items(True, True) if "weight" in str(key)]
    return int(weights[0].shape[-1])


def test_a_centralized_critic_sees_more_than_its_agents(tmp_path: Path) -> None:
    """MAPPO on the state, on what a group sees, and IPPO: with one agent a role the last two are the same algorithm."""
    state = _trained("Mappo", tmp_path)
    blind = _trained("Mappo", tmp_path, state=False)
    apart = _trained("Ippo", tmp_path)
    env = TorchLaboratory(1, "wurtz_dodecane_direct", actions="discrete")
    for group in env.group_map:
        seen = env.observation_spec[group, "observation"].shape[-1]
        assert _critic_inputs(state, group) == env.observation_spec["state"].shape[-1] > seen
        assert _critic_inputs(blind, group) == _critic_inputs(apart, group) == seen
    weights = [
        torch.cat([p.flatten() for p in one.group_policies["manager"].parameters()]) for one in (state, blind, apart)
    ]
    assert torch.isfinite(torch.stack(weights)).all()
    assert not torch.equal(weights[0], weights[2])


def test_a_value_based_learner_for_every_role(tmp_path: Path) -> None:
    experiment = _trained("Iql", tmp_path)
    assert experiment.total_frames == 128
    assert set(experiment.group_map) == {"manager", "rxn", "dit"}
