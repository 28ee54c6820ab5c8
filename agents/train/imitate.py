"""Behaviour cloning: initialize a learner with a policy's actions, and its critic with the returns.

Reinforcement learning then starts from a complete workflow instead of random actions, which rarely complete one.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from sb3_contrib.common.recurrent.type_aliases import RNNStates

from chemlab.envs.players import Policy, as_policy
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.kernels.arrays import BoolArray, FloatArray, IntArray

from ..advice import Advisor, with_advice
from ..runs import training_seeds

_SPREAD = 0.02
"""Minimum standard deviation of a clone's continuous actions."""

_EPOCHS = 10
_UPDATES = 1_100
"""Minimum number of updates; few examples are used more often."""
BATCH = 256
_SEQUENCES_BATCH = 2_048
"""Approximate number of turns in a minibatch of whole episodes."""
LEARNING_RATE = 1e-3
_SEQUENCES_LEARNING_RATE = 3e-3
"""Learning rate for whole episodes, whose minibatches have more turns."""
ENTROPY = 0.03
"""Entropy bonus, which keeps the clone from being deterministic where its examples agree, so that it can improve."""
VALUES = 0.5
"""Weight of the critic's error."""


def imitate(
    model: Any,
    batch: RoleVectorEnv,
    policy: Policy,
    steps: int,
    seed: int,
    advised: bool = False,
    rounds: int = 1,
    spread: float = _SPREAD,
) -> float:
    """Fit an on-policy learner's actor to a policy's actions, and its critic to the discounted returns.

    Behaviour cloning suffers from compounding errors. After the first round the learner therefore plays, and the policy
    labels its turns (DAgger: Ross, Gordon and Bagnell, 2011, https://proceedings.mlr.press/v15/ross11a.html); the
    learner is fitted to all rounds so far.

    Args:
        model: PPO, A2C, MaskablePPO or RecurrentPPO.
        batch: batch in which the policy plays, with ``autoreset_mode="SameStep"``; it is reset.
        policy: policy to imitate.
        steps: approximate number of turns; those of unfinished episodes are left out.
        seed: seed of the episodes and of the order of minibatches.
        advised: whether the learner observes the policy's action (:mod:`chemlab.agents.advice`) and learns to follow
            it.
        rounds: number of rounds.
        spread: minimum standard deviation of continuous actions.

    Returns:
        Share of the turns in which the learner's most probable action is the policy's (for continuous actions: the mean
        absolute difference).
    """
    remembers, hit, found = hasattr(model.policy, "lstm_actor"), 0.0, list[_Examples]()
    for learner in [None] + [as_policy(model)] * (rounds - 1):
        turns, own_seed = math.ceil(steps / rounds), None if found else seed
        found.append(_examples(batch, policy, learner, turns, own_seed, model.gamma, advised))
        seen, actions, returns, lengths = (np.concatenate([own[i] for own in found]) for i in range(4))
        masks = [own.masks for own in found if own.masks is not None]
        legal = np.concatenate(masks) if masks else None
        hit = fit(model, seen, legal, actions, returns, seed, lengths if remembers else None, spread)
    return hit


def fit(
    model: Any,
    observations: npt.NDArray[np.float32],
    masks: npt.NDArray[np.int8] | None,
    actions: npt.NDArray[Any],
    returns: npt.NDArray[np.float32],
    seed: int,
    lengths: IntArray | None = None,
    spread: float = _SPREAD,
) -> float:
    """Fit an on-policy learner's actor to the actions of T turns, and its critic to their returns.

    Args:
        model: as for :func:`imitate`, like the returned value.
        observations: [T, size] observations.
        masks: [T, actions] legal actions; None for continuous actions.
        actions: [T] (discrete) or [T, numbers] actions.
        returns: [T] discounted returns from each turn on.
        seed: seed of the order of minibatches.
        lengths: [E] turns of each episode in order, for a recurrent learner; None for any other.
        spread: as for :func:`imitate`.
    """
    shown = _Turns(model, observations, masks, actions)
    if lengths is not None:
        shown = _Episodes(model, observations, masks, actions, lengths)
    network = model.policy
    network.set_training_mode(True)

    def loss(some: IntArray) -> torch.Tensor:
        values, log_probability, entropy = shown.evaluated(some)
        bonus = entropy.mean() if entropy is not None else -log_probability.mean()
        missed = torch.nn.functional.mse_loss(values, torch.as_tensor(returns[shown.rows(some)]))
        return -log_probability.mean() - ENTROPY * bonus + VALUES * missed

    rng = np.random.default_rng(seed)
    minibatches = descend(network, loss, shown.count, shown.batch, shown.learning_rate, model.max_grad_norm, rng)
    with torch.no_grad():
        parts = np.array_split(np.arange(shown.count), minibatches)
        chosen = np.concatenate([shown.chosen(some) for some in parts])
        played = shown.actions[np.concatenate([shown.rows(some) for some in parts])]
        if hasattr(network, "log_std"):
            # Set the maximum likelihood value: in so few updates the optimizer would not reach it from the initial 1.
            missing = np.sqrt(((chosen - played) ** 2).mean(axis=0))
            network.log_std.copy_(torch.as_tensor(np.log(np.maximum(missing, spread))))
    if np.issubdtype(played.dtype, np.integer):
        return float((chosen == played).mean())
    return float(np.abs(chosen - played).mean())


def descend(
    network: torch.nn.Module,
    loss: Callable[[IntArray], torch.Tensor],
    count: int,
    batch: int,
    learning_rate: float,
    most: float,
    rng: np.random.Generator,
) -> int:
    """Minimize a loss of minibatches of ``count`` examples, at a learning rate that falls to 0; gradients are clipped
    to ``most``.

    Returns:
        The number of minibatches of an epoch.
    """
    minibatches = max(1, count // batch)
    epochs = max(_EPOCHS, -(-_UPDATES // minibatches))
    optimizer = torch.optim.Adam(network.parameters(), lr=learning_rate, fused=True)
    # Common features of the examples are learned fast; thresholds between two actions need small steps.
    falling = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, epochs * minibatches)
    for _ in range(epochs):
        for some in np.array_split(rng.permutation(count), minibatches):
            optimizer.zero_grad()
            loss(some).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), most)
            optimizer.step()
            falling.step()
    return minibatches


class _Turns:
    """T turns as independent training examples.

    Args:
        model, observations, masks, actions: as for :func:`fit`.
    """

    def __init__(
        self,
        model: Any,
        observations: npt.NDArray[np.float32],
        masks: npt.NDArray[np.int8] | None,
        actions: npt.NDArray[Any],
    ) -> None:
        network = model.policy
        self._network, self._observations, self.actions = network, observations, actions
        masked = hasattr(network, "action_dist") and "Maskable" in type(network.action_dist).__name__
        self._masks = masks if masked else None
        self.count, self.batch, self.learning_rate = len(actions), BATCH, LEARNING_RATE

    def rows(self, some: IntArray) -> IntArray:
        """Return the turns of some of ``count``."""
        return some

    def evaluated(self, some: IntArray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return (values, log-probabilities of the played actions, entropies) of :meth:`rows`."""
        seen, played = torch.as_tensor(self._observations[some]), torch.as_tensor(self.actions[some])
        legal = {} if self._masks is None else {"action_masks": self._masks[some]}
        values, log_probability, entropy = self._network.evaluate_actions(seen, played, **legal)
        return values.flatten(), log_probability, entropy

    def chosen(self, some: IntArray) -> npt.NDArray[Any]:
        """Return the learner's actions in :meth:`rows`."""
        legal = {} if self._masks is None else {"action_masks": self._masks[some]}
        return np.asarray(self._network.predict(self._observations[some], deterministic=True, **legal)[0])


class _Episodes(_Turns):
    """Whole episodes as training examples of a recurrent learner.

    Args:
        lengths: [E] turns of each episode in order.
    """

    def __init__(
        self,
        model: Any,
        observations: npt.NDArray[np.float32],
        masks: npt.NDArray[np.int8] | None,
        actions: npt.NDArray[Any],
        lengths: IntArray,
    ) -> None:
        super().__init__(model, observations, masks, actions)
        if masks is not None and model.observation_space.shape[0] > observations.shape[1]:
            self._observations = np.concatenate([observations, masks], axis=1, dtype=np.float32)
        self._lengths, self._first = lengths, np.cumsum(lengths) - lengths
        self.count, self.batch = len(lengths), max(1, int(_SEQUENCES_BATCH / lengths.mean()))
        self.learning_rate = _SEQUENCES_LEARNING_RATE

    def rows(self, some: IntArray) -> IntArray:
        return np.concatenate([padded[there] for _, padded, there in self._groups(some)])

    def _groups(self, some: IntArray) -> Iterator[tuple[IntArray, IntArray, BoolArray]]:
        """Yield groups of episodes of similar length, to limit padding.

        Yields:
            Episodes, [episodes * longest] turns in order, and a mask of the real ones.
        """
        doublings = np.frexp(self._lengths[some])[1]
        for doubling in np.unique(doublings):
            group = some[doublings == doubling]
            turn = np.arange(self._lengths[group].max())
            there = turn < self._lengths[group, None]
            yield group, np.where(there, self._first[group, None] + turn, 0).ravel(), there.ravel()

    def _begun(self, some: IntArray) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the zero initial state of the LSTM for these episodes."""
        layers, _, size = self._network.lstm_hidden_state_shape
        nothing = torch.zeros(layers, len(some), size)
        return nothing, nothing

    def evaluated(self, some: IntArray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        found = []
        for group, padded, there in self._groups(some):
            seen, played = torch.as_tensor(self._observations[padded]), torch.as_tensor(self.actions[padded])
            memory, kept = RNNStates(self._begun(group), self._begun(group)), torch.as_tensor(there)
            of_turns = self._network.evaluate_actions(seen, played, memory, torch.zeros(len(padded)))
            found.append([None if column is None else column.flatten()[kept] for column in of_turns])
        values, log_probability, entropy = zip(*found, strict=True)
        return torch.cat(values), torch.cat(log_probability), None if entropy[0] is None else torch.cat(entropy)

    def chosen(self, some: IntArray) -> npt.NDArray[Any]:
        found = []
        for group, padded, there in self._groups(some):
            seen = torch.as_tensor(self._observations[padded])
            distribution, _ = self._network.get_distribution(seen, self._begun(group), torch.zeros(len(padded)))
            found.append(distribution.get_actions(deterministic=True).numpy()[there])
        return np.concatenate(found)


class _Examples(NamedTuple):
    """T turns of whole episodes in order.

    Attributes:
        seen: [T, size] observations.
        actions: [T] or [T, numbers].
        returns: [T] discounted returns.
        lengths: [E] turns of each episode.
        masks: [T, actions], or None.
    """

    seen: npt.NDArray[np.float32]
    actions: npt.NDArray[Any]
    returns: npt.NDArray[np.float32]
    lengths: IntArray
    masks: npt.NDArray[np.int8] | None


def _examples(
    batch: RoleVectorEnv,
    policy: Policy,
    learner: Policy | None,
    steps: int,
    seed: int | None,
    gamma: float,
    advised: bool = False,
) -> _Examples:
    """Collect the actions of a policy, or its labels while a learner plays."""
    n, discrete = batch.num_envs, batch.single_action_space.shape == ()
    members, turns, shown = np.arange(n), np.zeros(n, dtype=np.int64), Advisor(policy)
    rows: list[tuple[Any, Any, Any]] = []
    rewards: list[FloatArray] = []
    ends: list[BoolArray] = []
    ended = np.zeros(n, dtype=np.bool_)
    observation, _ = batch.reset(seed=None if seed is None else training_seeds(seed, n))
    # A learner that never ends its episodes reaches the laboratory's limits.
    while len(rows) * n < steps or not (learner is None or ended.all()):
        mask = batch.action_masks().astype(np.int8) if discrete else None
        action = played = shown.advice(observation, mask, turns, members)
        seen = with_advice(observation, action, batch.action_count) if advised else observation.copy()
        rows.append((seen, mask, action))
        if learner is not None:
            played = learner.act(seen, mask, turns, members)
        shown.played(played, members)
        observation, reward, terminated, truncated, _ = batch.step(played)
        over = terminated | truncated
        turns = np.where(over, 0, turns + 1)
        ended |= over
        rewards.append(reward.copy())
        ends.append(over.copy())
    following, whole = np.zeros(n), np.zeros(n, dtype=np.bool_)
    returns, kept = np.zeros((len(rows), n), dtype=np.float32), np.zeros((len(rows), n), dtype=np.bool_)
    for t in reversed(range(len(rows))):
        whole |= ends[t]
        following = rewards[t] + gamma * np.where(ends[t], 0.0, following)
        returns[t], kept[t] = following, whole
    if not kept.any():
        raise ValueError(f"bc_steps: no episode ended within {steps} turns of {n} environments; give more")

    def in_order(column: list[Any]) -> npt.NDArray[Any]:
        return np.stack(column).swapaxes(0, 1)[kept.T]

    observed, masks, actions = zip(*rows, strict=True)
    lengths = np.diff(np.flatnonzero(in_order(ends)), prepend=-1)
    legal = in_order(list(masks)) if discrete else None
    return _Examples(in_order(list(observed)), in_order(list(actions)), returns.T[kept.T], lengths, legal)
