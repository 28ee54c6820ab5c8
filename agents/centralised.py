"""Actor-critic policies with a centralised critic, which observes the true state during training (MAPPO).

Their input is the agent's observation followed by the laboratory's state
(:class:`~chemlab.envs.global_state.GlobalState`). The actor is not connected to the state and plays without it: a bare
observation is padded with zeros.

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


class _SeparateLayers(MlpExtractor):
    """Hidden layers of an actor on the first inputs only, and of a critic on all of them.

    The actor is initialised like a separate actor. In a common orthogonal layer its inputs would have little weight.

    Args:
        own: number of the actor's inputs.
        feature_dim: number of the critic's inputs.
        settings: arguments of Stable-Baselines3's extractor.
    """

    def __init__(self, own: int, feature_dim: int, **settings: Any) -> None:
        super().__init__(feature_dim, **settings)
        actor = MlpExtractor(own, **settings)
        self.own, self.policy_net, self.latent_dim_pi = own, actor.policy_net, actor.latent_dim_pi

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        return super().forward_actor(features[:, : self.own])


class _Centralised:
    """Common additions to both of Stable-Baselines3's policies."""

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
        self.mlp_extractor = _SeparateLayers(self._own, made.features_dim, **settings)

    def obs_to_tensor(self, observation: Any) -> tuple[torch.Tensor, bool]:
        """Convert observations as Stable-Baselines3 does; bare agent observations are padded with zeros."""
        behind = self.observation_space.shape[0] - observation.shape[-1]
        padded = np.pad(observation, [(0, 0)] * (observation.ndim - 1) + [(0, behind)])
        found: tuple[torch.Tensor, bool] = super().obs_to_tensor(padded)  # type: ignore[misc]
        return found


class CentralisedPolicy(_Centralised, ActorCriticPolicy):
    """PPO's policy with a centralised critic.

    Args:
        observation_space, action_space, lr_schedule: as for Stable-Baselines3's policy; the space contains observation
            and state.
        own: size of the agent's observation.
        settings: further arguments of Stable-Baselines3's policy, except feature extractors.
    """


class MaskableCentralisedPolicy(_Centralised, MaskableActorCriticPolicy):
    """MaskablePPO's policy with a centralised critic."""
