"""Behaviour cloning: a learner begins with what a policy that is already there does, and with its returns as values.

Reinforcement learning then starts from a workflow instead of from random actions, among which whole workflows are rare.

Needs the extra: ``pip install "chemlab-marl[train]"``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from chemlab.arrays import BoolArray, FloatArray
from chemlab.laboratory.bench_env import BenchVectorEnv
from chemlab.laboratory.focal import FocalVectorEnv

from ..policies import Policy

__all__ = ["IMITATED", "fit", "imitate"]

IMITATED = 20_000
"""Turns to learn from, where nobody says how many."""

_EPOCHS = 10
_UPDATES = 1_100
"""At least; few examples are gone through more often."""
_BATCH = 256
_LEARNING_RATE = 1e-3
_ENTROPY = 0.03
"""Keeps the clone from being certain where its examples happen to agree, so that it can still find better."""
_VALUES = 0.5


def imitate(model: Any, batch: BenchVectorEnv | FocalVectorEnv, policy: Policy, steps: int, seed: int) -> float:
    """Fit an on-policy learner's actor to a policy's actions, and its critic to the discounted returns they had.

    Args:
        model: PPO, A2C or MaskablePPO.
        batch: where the policy plays, with ``autoreset_mode="SameStep"``; it is reset.
        policy: whom to imitate.
        steps: about how many of its turns to learn from; those of episodes that did not end are left out.
        seed: of the episodes and of the order of minibatches.

    Returns:
        Share of the turns in which the learner's most probable action is the policy's (of continuous actions: the mean
        absolute difference).
    """
    return fit(model, *_examples(batch, policy, steps, seed, model.gamma), seed)


def fit(
    model: Any,
    observations: npt.NDArray[np.float32],
    masks: npt.NDArray[np.int8] | None,
    actions: npt.NDArray[Any],
    returns: npt.NDArray[np.float32],
    seed: int,
) -> float:
    """Fit an on-policy learner's actor to the actions of T turns, and its critic to the returns they had.

    Args:
        model: as for :func:`imitate`, and so is what is returned.
        observations: [T, size] what was seen.
        masks: [T, actions] what was legal; None where actions are continuous.
        actions: [T] (discrete) or [T, numbers] what was played.
        returns: [T] discounted return from that turn on.
        seed: of the order of minibatches.
    """
    network, rng = model.policy, np.random.default_rng(seed)
    network.set_training_mode(True)
    optimizer = torch.optim.Adam(network.parameters(), lr=_LEARNING_RATE)
    masked = masks is not None and hasattr(network, "action_dist") and "Maskable" in type(network.action_dist).__name__
    minibatches = max(1, len(actions) // _BATCH)
    epochs = max(_EPOCHS, -(-_UPDATES // minibatches))
    # What the examples agree on is found fast; thresholds between two actions only in small steps.
    falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, epochs * minibatches)
    for _ in range(epochs):
        for rows in np.array_split(rng.permutation(len(actions)), minibatches):
            seen, played = torch.as_tensor(observations[rows]), torch.as_tensor(actions[rows])
            legal = {"action_masks": masks[rows]} if masked and masks is not None else {}
            values, log_probability, entropy = network.evaluate_actions(seen, played, **legal)
            bonus = entropy.mean() if entropy is not None else -log_probability.mean()
            missed = torch.nn.functional.mse_loss(values.flatten(), torch.as_tensor(returns[rows]))
            loss = -log_probability.mean() - _ENTROPY * bonus + _VALUES * missed
            optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), model.max_grad_norm)
            optimizer.step()
            falling.step()
    legal = {"action_masks": masks} if masked and masks is not None else {}
    chosen = np.asarray(model.predict(observations, deterministic=True, **legal)[0])
    if np.issubdtype(actions.dtype, np.integer):
        return float((chosen == actions).mean())
    return float(np.abs(chosen - actions).mean())


def _examples(
    batch: BenchVectorEnv | FocalVectorEnv, policy: Policy, steps: int, seed: int, gamma: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int8] | None, npt.NDArray[Any], npt.NDArray[np.float32]]:
    """(observations, masks, actions, discounted returns) of the turns of whole episodes."""
    n, discrete = batch.num_envs, batch.single_action_space.shape == ()
    members, turns = np.arange(n), np.zeros(n, dtype=np.int64)
    rows: list[tuple[Any, Any, Any]] = []
    rewards: list[FloatArray] = []
    ends: list[BoolArray] = []
    observation, _ = batch.reset(seed=seed)
    while len(rows) * n < steps:
        mask = batch.action_masks().astype(np.int8) if discrete else None
        action = policy.act(observation, mask, turns, members)
        rows.append((observation.copy(), mask, np.asarray(action)))
        observation, reward, terminated, truncated, _ = batch.step(action)
        over = terminated | truncated
        turns = np.where(over, 0, turns + 1)
        rewards.append(reward.copy())
        ends.append(over.copy())
    following, whole = np.zeros(n), np.zeros(n, dtype=np.bool_)
    returns, kept = np.zeros((len(rows), n), dtype=np.float32), np.zeros((len(rows), n), dtype=np.bool_)
    for t in reversed(range(len(rows))):
        whole |= ends[t]
        following = rewards[t] + gamma * np.where(ends[t], 0.0, following)
        returns[t], kept[t] = following, whole
    if not kept.any():
        raise ValueError(f"imitate_steps: no episode ended within {steps} turns of {n} environments; give more")
    seen, masks, actions = ([row[i] for row in rows] for i in range(3))
    return np.stack(seen)[kept], np.stack(masks)[kept] if discrete else None, np.stack(actions)[kept], returns[kept]
