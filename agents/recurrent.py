"""A recurrent policy with action masks for sb3-contrib's ``RecurrentPPO``, which has none.

Observations end with the mask, one number per action (:class:`~chemlab.agents.sb3.ChemlabVecEnv`, ``show_masks``), so
that the learner's buffers store both. The mask is not an input of the LSTM.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import torch

from chemlab.config.extras import needs

with needs("training needs Stable-Baselines3", "train"):
    from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
    from stable_baselines3.common.distributions import Distribution
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

_NEVER = -1e8
"""Logit of illegal actions; finite, because padding has no legal action."""
_WIDE = 1_000
"""Input size above which torch's own LSTM is faster than oneDNN's."""


class _MaskSplitter(BaseFeaturesExtractor):
    """Splits the mask off the observations and keeps it for the action distribution."""

    def __init__(self, observation_space: gymnasium.spaces.Box, actions: int) -> None:
        super().__init__(observation_space, observation_space.shape[0] - actions)
        self.legal = torch.ones(0, dtype=torch.bool)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        seen = self.features_dim
        self.legal = observations[:, seen:] > 0.5
        return observations[:, :seen]


class MaskedLstmPolicy(RecurrentActorCriticPolicy):
    """sb3-contrib's LSTM policy for observations that end with the mask of discrete actions.

    Args:
        observation_space: space of observation and mask together.
        action_space: discrete.
        lr_schedule, settings: as for sb3-contrib's policy, without ``features_extractor_class`` and ``_kwargs``.
    """

    def __init__(
        self,
        observation_space: gymnasium.spaces.Box,
        action_space: Any,  # Discrete, which only some versions of Gymnasium declare generic
        lr_schedule: Any,
        **settings: Any,
    ) -> None:
        own = {"features_extractor_class": _MaskSplitter, "features_extractor_kwargs": {"actions": int(action_space.n)}}
        super().__init__(observation_space, action_space, lr_schedule, **{**settings, **own})

    @staticmethod
    def _process_sequence(
        features: torch.Tensor,
        lstm_states: tuple[torch.Tensor, torch.Tensor],
        episode_starts: torch.Tensor,
        lstm: torch.nn.LSTM,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # the second is in fact a pair
        # sb3-contrib processes a sequence turn by turn if an episode begins inside it. Its buffer cuts sequences where
        # episodes begin, so only the first turn of a sequence begins one, and resetting the initial state suffices.
        count = lstm_states[0].shape[1]
        starts = episode_starts.reshape(count, -1)
        if not starts[:, 1:].any():
            kept = (1.0 - starts[:, 0]).view(1, count, 1)
            lstm_states = (kept * lstm_states[0], kept * lstm_states[1])
            episode_starts = torch.zeros_like(episode_starts)
        # oneDNN's LSTM also computes the gradient of its inputs, which is not used and expensive for wide inputs.
        backend: Any = torch.backends.mkldnn
        one_dnn = backend.enabled
        backend.enabled = one_dnn and lstm.input_size < _WIDE
        try:
            return RecurrentActorCriticPolicy._process_sequence(features, lstm_states, episode_starts, lstm)
        finally:
            backend.enabled = one_dnn

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor) -> Distribution:
        # Every caller has just extracted the features of the same observations.
        assert isinstance(self.features_extractor, _MaskSplitter), "the extractor set in __init__"
        logits = self.action_net(latent_pi).masked_fill(~self.features_extractor.legal, _NEVER)
        return self.action_dist.proba_distribution(logits)
