"""Policies whose critic sees more than the actor: learners in whose training the whole laboratory is known (MAPPO).

What they are given is the agent's observation and behind it the laboratory's state
(:class:`~chemlab.laboratory.global_state.GlobalState`). The actor is shown zeros in place of the state, so that it
plays without: behind an observation alone zeros are put.

Needs the extra: ``pip install "chemlab-marl[train]"``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch

try:
    from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install "chemlab-marl[train]"') from error

__all__ = ["CentralisedPolicy", "MaskableCentralisedPolicy"]


class _Side(BaseFeaturesExtractor):
    """What actor or critic sees of both; there is one for each.

    Args:
        observation_space: of observation and state together.
        own: how many numbers the agent's observation has.
    """

    def __init__(self, observation_space: gymnasium.spaces.Box, own: int) -> None:
        super().__init__(observation_space, observation_space.shape[0])
        self.own, self.is_actor = own, False

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        if not self.is_actor:
            return observations
        own = observations[:, : self.own]
        return torch.cat([own, torch.zeros_like(observations[:, self.own :])], dim=1)


class _Centralised:
    """What both policies add to theirs of Stable-Baselines3."""

    observation_space: Any
    pi_features_extractor: Any

    def __init__(
        self, observation_space: Any, action_space: Any, lr_schedule: Any, *, own: int, **settings: Any
    ) -> None:
        sides = {"features_extractor_class": _Side, "features_extractor_kwargs": {"own": own}}
        settings = {**settings, **sides, "share_features_extractor": False}
        super().__init__(observation_space, action_space, lr_schedule, **settings)  # type: ignore[call-arg]
        self.pi_features_extractor.is_actor = True

    @property
    def own(self) -> int:
        """How many numbers the agent's observation has."""
        return int(self.pi_features_extractor.own)

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
        settings: more of Stable-Baselines3's, but the feature extractors.
    """


class MaskableCentralisedPolicy(_Centralised, MaskableActorCriticPolicy):
    """The same of MaskablePPO's policy."""
