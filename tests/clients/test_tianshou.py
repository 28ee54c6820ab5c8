"""Tianshou's DQN with masks, which it expects in the observation, on vectors of single environments."""

from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("tianshou", reason="Tianshou is not installed: pip install torch==2.13.0 tianshou")

import torch
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, CollectStats, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

import chemlab  # noqa: F401 - registers the environments
from chemlab.agents.background import role_env


class MaskInObservation(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Observations {"obs", "mask"}, as Tianshou reads them."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        masks = gymnasium.spaces.MultiBinary(int(env.action_space.n))  # type: ignore[attr-defined]
        self.observation_space = gymnasium.spaces.Dict({"obs": env.observation_space, "mask": masks})

    def reset(self, **arguments: Any) -> Any:
        seen, info = self.env.reset(**arguments)
        return {"obs": seen, "mask": info["action_mask"]}, info

    def step(self, action: Any) -> Any:
        seen, *rest, info = self.env.step(action)
        return {"obs": seen, "mask": info["action_mask"]}, *rest, info


def learner(env: gymnasium.Env[Any, Any], exploration: float) -> DQN[Any]:
    """DQN for a view."""
    seen = env.observation_space["obs"].shape  # type: ignore[index]
    network = Net(state_shape=seen, action_shape=int(env.action_space.n), hidden_sizes=[32])  # type: ignore[attr-defined]
    epsilon: Any = dict.fromkeys(("eps_training", "eps_inference"), exploration)
    spaces = {"action_space": env.action_space, "observation_space": env.observation_space}
    policy: Any = DiscreteQLearningPolicy(model=network, **spaces, **epsilon)
    return DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), target_update_freq=20)


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::DeprecationWarning")
@pytest.mark.slow
def test_dqn_with_masks_learns() -> None:
    np.random.seed(0)  # noqa: NPY002 - Tianshou explores with NumPy's global stream
    torch.manual_seed(0)

    def make() -> MaskInObservation:
        return MaskInObservation(role_env())

    training, testing = DummyVectorEnv([make] * 3), DummyVectorEnv([make])
    training.seed(0)
    testing.seed(9)
    algorithm = learner(make(), exploration=0.3)
    buffer = VectorReplayBuffer(600, 3)
    collector: Collector[CollectStats] = Collector(algorithm, training, buffer, exploration_noise=True)
    collector.reset()
    before = torch.nn.utils.parameters_to_vector(algorithm.policy.parameters()).clone()
    result = algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=collector,
            test_collector=Collector(algorithm, testing),
            max_epochs=1,
            epoch_num_steps=120,
            collection_step_num_env_steps=30,
            test_step_num_episodes=1,
            batch_size=16,
            update_step_num_gradient_steps_per_sample=0.2,
            verbose=False,
            show_progress=False,
        )
    )
    after = torch.nn.utils.parameters_to_vector(algorithm.policy.parameters())
    assert result.update_step > 0
    assert np.isfinite(result.best_score)
    assert torch.isfinite(after).all()
    assert not torch.equal(before, after)
    # Everything it has played, greedily or to explore, was legal.
    data, _ = buffer.sample(0)
    assert len(data) >= 120
    assert data.obs.mask[np.arange(len(data)), data.act].all()
    assert not data.info.illegal_action.any()
    assert (data.info.elapsed_ticks >= 0).all()
    assert (data.done == (data.terminated | data.truncated)).all()
