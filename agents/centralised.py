"""Policies whose critic sees more than the actor: learners in whose training the whole laboratory is known (MAPPO).

What they are given is the agent's observation and behind it the laboratory's state
(:class:`~chemlab.envs.global_state.GlobalState`). The actor has no connection to the state, and plays
without: behind an observation alone zeros are put.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

try:
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.torch_layers import MlpExtractor
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install ".[train]"') from error

__all__ = ["CentralisedPolicy", "MaskableCentralisedPolicy"]


class _Sides(MlpExtractor):
    """Hidden layers of an actor that sees the first numbers only, and of a critic that sees all. So the actor begins as
    one that stands alone does: in a layer for all of them, orthogonal to begin with, its own would have little weight.

    Args:
        own: how many numbers the actor sees.
        feature_dim: how many the critic does.
        settings: Stable-Baselines3's.
    """

    def __init__(self, own: int, feature_dim: int, **settings: Any) -> None:
        super().__init__(feature_dim, **settings)
        actor = MlpExtractor(own, **settings)
        self.own, self.policy_net, self.latent_dim_pi = own, actor.policy_net, actor.latent_dim_pi

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        return super().forward_actor(features[:, : self.own])


class _Centralised:
    """What both policies add to theirs of Stable-Baselines3."""

    observation_space: Any
    mlp_extractor: Any

    def __init__(
        self, observation_space: Any, action_space: Any, lr_schedule: Any, *, own: int, **settings: Any
    ) -> None:
        self._own = own
        super().__init__(observation_space, action_space, lr_schedule, **settings)  # type: ignore[call-arg]

    def _build_mlp_extractor(self) -> None:
        made: Any = self
        settings = {"net_arch": made.net_arch, "activation_fn": made.activation_fn, "device": made.device}
        self.mlp_extractor = _Sides(self._own, made.features_dim, **settings)

    def obs_to_tensor(self, observation: Any) -> tuple[torch.Tensor, bool]:
        """Stable-Baselines3's, of an agent's observations, too: behind them nothing stands."""
        behind = self.observation_space.shape[0] - observation.shape[-1]
        padded = np.pad(observation, [(0, 0)] * (observation.ndim - 1) + [(0, behind)])
        found: tuple[torch.Tensor, bool] = super().obs_to_tensor(padded)  # type: ignore[misc]
        return found


class CentralisedPolicy(_Centralised, ActorCriticPolicy):
    """PPO's policy with a critic that sees the state.

    Args:
        observation_space, action_space, lr_schedule: as for Stable-Baselines3's policy; the space is of both.
        own: how many numbers the agent's observation has.
        settings: more of Stable-Baselines3's, but feature extractors.
    """


class MaskableCentralisedPolicy(_Centralised, MaskableActorCriticPolicy):
    """The same of MaskablePPO's policy."""
