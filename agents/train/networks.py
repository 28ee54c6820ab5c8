"""Conversion of a Stable-Baselines3 learner's network to a policy that needs only NumPy.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.config.extras import needs
from chemlab.roles.base import Workplace

from ..pretrained import LOG_STD, LSTM, Card, PretrainedPolicy
from ..runs import RunConfig

with needs("training needs Stable-Baselines3", "train"):
    from sb3_contrib import MaskablePPO
    from torch import nn

    from ..recurrent import MaskedLstmPolicy


_ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


def learned_policy(model: Any, workplace: Workplace, **card: Any) -> PretrainedPolicy:
    """Return a learner's policy, which is played with masks if it was trained with masks.

    Args:
        model: the learner.
        workplace: its bench or manager.
        card: further fields of its :class:`~chemlab.agents.pretrained.Card`.

    Raises:
        ValueError: the network has layers other than fully connected ones with tanh or ReLU, or weights are not finite.
    """
    weights, activation, output = _network_of(model)
    masked = isinstance(model, MaskablePPO) or isinstance(model.policy, MaskedLstmPolicy)
    if "lstm.bias" in weights:
        card["memory"] = int(model.policy.lstm_actor.hidden_size)
    return PretrainedPolicy(Card.of(workplace, activation=activation, output=output, masked=masked, **card), weights)


def card_of(config: RunConfig, workplace: Workplace) -> dict[str, Any]:
    """Return the fields of a policy's card that its run's configuration states."""
    fields = {name: getattr(config, name) for name in ("env_id", "algo", "label", "seed", "versions")}
    return {"name": workplace.key, **fields}


def _network_of(model: Any) -> tuple[dict[str, npt.NDArray[np.float32]], str, str]:
    """Return a learner's weights, activation and output, as stated by :class:`~chemlab.agents.pretrained.Card`.

    Raises:
        ValueError: the network has layers other than fully connected ones with tanh or ReLU.
    """
    policy = model.policy
    if hasattr(policy, "q_net"):  # DQN
        parts, output = [policy.q_net.q_net], "argmax"
    elif hasattr(policy, "quantile_net"):  # QR-DQN
        parts, output = [policy.quantile_net.quantile_net], "argmax"
    elif hasattr(policy, "actor"):  # SAC's last layer is `mu`; TD3's `mu` is the whole network
        actor = policy.actor
        parts, output = [actor.latent_pi, actor.mu] if hasattr(actor, "latent_pi") else [actor.mu], "tanh"
    else:
        parts = [policy.mlp_extractor.policy_net, policy.action_net]
        output = "argmax" if isinstance(model.action_space, gymnasium.spaces.Discrete) else "clip"
    modules = [m for part in parts for m in part.modules() if not isinstance(m, nn.Sequential)]
    linear = [m for m in modules if isinstance(m, nn.Linear)]
    activation = policy.activation_fn
    others = {type(m) for m in modules} - {nn.Linear, activation, *([nn.Tanh] if output == "tanh" else [])}
    if activation not in _ACTIVATIONS or others:
        raise ValueError(f"cannot export a network with {activation.__name__}, {', '.join(o.__name__ for o in others)}")
    weights = {}
    for i, layer in enumerate(linear):
        weights[f"{i}.weight"] = np.ascontiguousarray(layer.weight.detach().numpy())
        weights[f"{i}.bias"] = np.ascontiguousarray(layer.bias.detach().numpy())
    if hasattr(policy, "lstm_actor"):
        ih, hh, *biases = (p.detach().numpy() for p in policy.lstm_actor.parameters())
        weights |= dict(zip(LSTM, (ih.copy(), hh.copy(), sum(biases)), strict=True))
    if isinstance(getattr(policy, "log_std", None), nn.Parameter):
        weights[LOG_STD] = policy.log_std.detach().numpy().copy()
    if hasattr(policy, "quantile_net"):  # the mean of the quantiles is also a linear layer
        last, actions = len(linear) - 1, int(model.action_space.n)
        for part in ("weight", "bias"):
            values = weights[f"{last}.{part}"]
            weights[f"{last}.{part}"] = values.reshape(-1, actions, *values.shape[1:]).mean(axis=0)
    return weights, _ACTIVATIONS[activation], output
