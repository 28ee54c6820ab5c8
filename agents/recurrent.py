"""A recurrent policy that chooses among legal actions, for sb3-contrib's ``RecurrentPPO``, which has no masks.

What it sees ends with the mask, one number an action (:class:`~chemlab.agents.sb3.ChemlabVecEnv`, ``show_masks``), so
that the learner's buffers keep it with the observation. Its LSTM does not see the mask.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import torch

try:
    from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
    from stable_baselines3.common.distributions import Distribution
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install ".[train]"') from error

__all__ = ["MaskedLstmPolicy"]

_NEVER = -1e8
"""Logit of what is illegal; finite, because padding has no legal action at all."""
_WIDE = 1_000
"""Numbers seen, from which on torch's own LSTM is faster than oneDNN's."""


class _Apart(BaseFeaturesExtractor):
    """Takes the mask off the observations' end, and keeps it for who chooses the actions."""

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
        observation_space: of observation and mask together.
        action_space: discrete.
        lr_schedule, settings: as for sb3-contrib's policy, without ``features_extractor_class`` and ``_kwargs``.
    """

    def __init__(
        self,
        observation_space: gymnasium.spaces.Box,
        action_space: gymnasium.spaces.Discrete,
        lr_schedule: Any,
        **settings: Any,
    ) -> None:
        own = {"features_extractor_class": _Apart, "features_extractor_kwargs": {"actions": int(action_space.n)}}
        super().__init__(observation_space, action_space, lr_schedule, **{**settings, **own})

    @staticmethod
    def _process_sequence(
        features: torch.Tensor,
        lstm_states: tuple[torch.Tensor, torch.Tensor],
        episode_starts: torch.Tensor,
        lstm: torch.nn.LSTM,
    ) -> tuple[torch.Tensor, torch.Tensor]:  # of which the second is two, in truth
        # sb3-contrib's goes through a sequence turn by turn wherever one begins an episode. Its buffer cuts sequences
        # where episodes begin, so that only a sequence's first turn does: then what is remembered before it is nothing.
        count = lstm_states[0].shape[1]
        starts = episode_starts.reshape(count, -1)
        if not starts[:, 1:].any():
            kept = (1.0 - starts[:, 0]).view(1, count, 1)
            lstm_states = (kept * lstm_states[0], kept * lstm_states[1])
            episode_starts = torch.zeros_like(episode_starts)
        # oneDNN's LSTM works out the gradient of its inputs, too, which nobody asks for: the wider, the longer.
        backend: Any = torch.backends.mkldnn
        one_dnn = backend.enabled
        backend.enabled = one_dnn and lstm.input_size < _WIDE
        try:
            return RecurrentActorCriticPolicy._process_sequence(features, lstm_states, episode_starts, lstm)
        finally:
            backend.enabled = one_dnn

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor) -> Distribution:
        # Whatever leads here has extracted the features of the same observations just before.
        assert isinstance(self.features_extractor, _Apart), "as it was made"
        logits = self.action_net(latent_pi).masked_fill(~self.features_extractor.legal, _NEVER)
        return self.action_dist.proba_distribution(logits)
