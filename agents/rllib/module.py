"""A role's networks for RLlib, and PPO with a discount for each role.

Needs the extra: ``pip install ".[rllib]"``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

try:
    import torch
    from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
    from ray.rllib.connectors.learner import GeneralAdvantageEstimation
    from ray.rllib.core.columns import Columns
    from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
    from ray.rllib.core.rl_module.torch import TorchRLModule
    from torch import nn
except ImportError as error:
    raise ImportError(f'training on a cluster needs Ray ({error}): pip install ".[rllib]"') from error

__all__ = ["PerRolePPOLearner", "RoleModule", "policy_weights"]

HIDDEN = (64, 64)
_NEVER = -1e8
"""Logit of an illegal action; finite, so that entropies stay so."""


def _network(sizes: list[int], gain: float) -> nn.Sequential:
    """Tanh layers with orthogonal weights, ``gain`` for the last layer: the start that SB3's PPO makes."""
    layers: list[nn.Module] = []
    for i, (before, after) in enumerate(itertools.pairwise(sizes)):
        last = i == len(sizes) - 2
        layer = nn.Linear(before, after)
        nn.init.orthogonal_(layer.weight, gain if last else math.sqrt(2.0))
        nn.init.zeros_(layer.bias)
        layers += [layer] if last else [layer, nn.Tanh()]
    return nn.Sequential(*layers)


class RoleModule(TorchRLModule, ValueFunctionAPI):
    """Policy and value network of a role, apart from each other, two tanh layers of 64 each.

    Discrete roles: logits, those of illegal actions (0 in the observation's ``action_mask``) so low that they are never
    drawn. Continuous ones: means and a standard deviation for each number, which does not depend on the observation;
    what is drawn is clipped to [0, 1] before it is played.
    """

    def setup(self) -> None:
        """Make the networks (RLlib calls this)."""
        space: Any = self.observation_space
        action_space: Any = self.action_space
        seen: Any = space["observations"] if isinstance(space, gymnasium.spaces.Dict) else space
        inputs = int(seen.shape[0])
        discrete = isinstance(action_space, gymnasium.spaces.Discrete)
        actions = int(action_space.n if discrete else action_space.shape[0])
        self.policy = _network([inputs, *HIDDEN, actions], 0.01)
        self.value = _network([inputs, *HIDDEN, 1], 1.0)
        self.log_std = None if discrete else nn.Parameter(torch.zeros(actions))

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        """What actions are drawn from, of [B, size] observations (and [B, actions] masks)."""
        seen = batch[Columns.OBS]
        if self.log_std is not None:
            mean = self.policy(seen)
            return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, self.log_std.expand_as(mean)], dim=-1)}
        logits = self.policy(seen["observations"])
        return {Columns.ACTION_DIST_INPUTS: torch.where(seen["action_mask"] != 0, logits, _NEVER)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        """[B] expected returns."""
        seen = batch[Columns.OBS]
        values: torch.Tensor = self.value(seen["observations"] if self.log_std is None else seen)
        return values.squeeze(-1)


def policy_weights(state: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[np.float32]]:
    """The policy network of a :class:`RoleModule`'s state, layers numbered as
    :class:`~chemlab.agents.pretrained.PretrainedPolicy` has them."""
    # Every second module of the network is an activation.
    return {
        f"{int(name.split('.')[1]) // 2}.{name.split('.')[2]}": np.array(array, dtype=np.float32)
        for name, array in state.items()
        if name.startswith("policy.")
    }


class _PerRoleAdvantages(GeneralAdvantageEstimation):
    """RLlib's advantages, with each role's own discount: RLlib has one for all."""

    def __init__(self, gammas: Mapping[str, float], lambda_: float) -> None:
        super().__init__(gamma=1.0, lambda_=lambda_)
        self._gammas = gammas

    def __call__(self, *, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        for role in list(batch):
            self.gamma = self._gammas[role]
            batch.update(super().__call__(batch={role: batch[role]}, **kwargs))
        return batch


class PerRolePPOLearner(PPOTorchLearner):
    """RLlib's PPO with the discount of each module's own settings."""

    def build(self) -> None:
        """Make what learns (RLlib calls this)."""
        super().build()
        roles = list(self.module.keys())
        gammas = {role: self.config.get_config_for_module(role).gamma for role in roles}
        pieces = self._learner_connector.connectors
        places = [i for i, piece in enumerate(pieces) if isinstance(piece, GeneralAdvantageEstimation)]
        assert len(places) == 1, "PPO computes advantages once"
        pieces[places[0]] = _PerRoleAdvantages(gammas, self.config.lambda_)
