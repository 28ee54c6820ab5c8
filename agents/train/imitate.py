"""Behaviour cloning: fit a learner's actor to a policy's actions, and its critic to the returns.

Reinforcement learning then starts from complete workflows, which random actions rarely reach.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
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

LEAST_STD = 0.02
"""Lower bound of the standard deviation of a clone's continuous actions."""

_EPOCHS, _UPDATES = 10, 1_100
"""Minimum numbers of epochs and of updates."""
BATCH, LEARNING_RATE = 256, 1e-3
"""Approximate number of turns in a minibatch, and initial learning rate."""
_SEQUENCES_BATCH, _SEQUENCES_LEARNING_RATE = 2_048, 3e-3
"""The same for minibatches of whole episodes."""
ENTROPY = 0.03
"""Weight of the entropy bonus, without which the clone would hardly explore where its examples agree."""
VALUES = 0.5
"""Weight of the critic's loss."""


def imitate(
    model: Any,
    batch: RoleVectorEnv,
    policy: Policy,
    steps: int,
    seed: int,
    advised: bool = False,
    rounds: int = 1,
    least_std: float = LEAST_STD,
) -> float:
    """Fit an on-policy learner's actor to a policy's actions, and its critic to the discounted returns.

    Behaviour cloning suffers from compounding errors. After the first round, the learner therefore acts and the policy
    labels its turns (DAgger: Ross, Gordon and Bagnell, 2011, https://proceedings.mlr.press/v15/ross11a.html); the
    learner is fitted to all rounds so far.

    Args:
        model: PPO, A2C, MaskablePPO or RecurrentPPO.
        batch: batch of environments with ``autoreset_mode="SameStep"``; it is reset.
        policy: policy to clone.
        steps: approximate number of turns in all rounds; turns of unfinished episodes are left out.
        seed: seed of the episodes and of the order of minibatches.
        advised: True if the learner observes the policy's action as a hint (:mod:`chemlab.agents.advice`).
        rounds: number of rounds.
        least_std: lower bound of the standard deviation of continuous actions.

    Returns:
        Share of the turns in which the learner's most probable action is the policy's (for continuous actions: the mean
        absolute difference).
    """
    is_recurrent, agreement, collected = hasattr(model.policy, "lstm_actor"), 0.0, list[_Examples]()
    for learner in [None] + [as_policy(model)] * (rounds - 1):
        turns, reset_seed = math.ceil(steps / rounds), None if collected else seed
        collected.append(_examples(batch, policy, learner, turns, reset_seed, model.gamma, advised))
        seen, actions, returns, lengths = (np.concatenate([one[i] for one in collected]) for i in range(4))
        masks = [one.masks for one in collected if one.masks is not None]
        legal = np.concatenate(masks) if masks else None
        agreement = fit(model, seen, legal, actions, returns, seed, lengths if is_recurrent else None, least_std)
    return agreement


def fit(
    model: Any,
    observations: npt.NDArray[np.float32],
    masks: npt.NDArray[np.int8] | None,
    actions: npt.NDArray[Any],
    returns: npt.NDArray[np.float32],
    seed: int,
    lengths: IntArray | None = None,
    least_std: float = LEAST_STD,
) -> float:
    """Fit an on-policy learner's actor to the actions of T turns, and its critic to their returns.

    Args:
        model: as for :func:`imitate`, like the returned value.
        observations: [T, size] observations.
        masks: [T, actions] legal actions; None for continuous actions.
        actions: [T] (discrete) or [T, n] (continuous) actions.
        returns: [T] discounted returns from each turn on.
        seed: seed of the order of minibatches.
        lengths: [E] number of turns of each episode, for a recurrent learner; None for any other.
        least_std: as for :func:`imitate`.
    """
    examples = _Turns(model, observations, masks, actions)
    if lengths is not None:
        examples = _Episodes(model, observations, masks, actions, lengths)
    network = model.policy
    network.set_training_mode(True)

    def loss(some: IntArray) -> torch.Tensor:
        values, log_probability, entropy = examples.evaluated(some)
        bonus = entropy.mean() if entropy is not None else -log_probability.mean()
        value_loss = torch.nn.functional.mse_loss(values, torch.as_tensor(returns[examples.rows(some)]))
        return -log_probability.mean() - ENTROPY * bonus + VALUES * value_loss

    count, rng = examples.count, np.random.default_rng(seed)
    minibatches = descend(network, loss, count, examples.batch, examples.learning_rate, model.max_grad_norm, rng)
    with torch.no_grad():
        parts = np.array_split(np.arange(count), minibatches)
        chosen = np.concatenate([examples.chosen(some) for some in parts])
        wanted = examples.actions[np.concatenate([examples.rows(some) for some in parts])]
        if hasattr(network, "log_std"):
            # Set the maximum likelihood value: in so few updates the optimizer would not reach it from the initial 1.
            std = np.sqrt(((chosen - wanted) ** 2).mean(axis=0))
            network.log_std.copy_(torch.as_tensor(np.log(np.maximum(std, least_std))))
    if np.issubdtype(wanted.dtype, np.integer):
        return float((chosen == wanted).mean())
    return float(np.abs(chosen - wanted).mean())


def descend(
    network: torch.nn.Module,
    loss: Callable[[IntArray], torch.Tensor],
    count: int,
    batch: int,
    learning_rate: float,
    max_grad_norm: float,
    rng: np.random.Generator,
) -> int:
    """Minimize a loss of minibatches with Adam, at a learning rate that decays linearly to 0.

    Args:
        network: the network to train.
        loss: loss of a minibatch, given the indices of its examples, of which there are ``count``.
        batch: approximate size of a minibatch.
        learning_rate, max_grad_norm, rng: initial learning rate, bound of the gradient's norm, order of minibatches.

    Returns:
        The number of minibatches of an epoch.
    """
    minibatches = max(1, count // batch)
    epochs = max(_EPOCHS, -(-_UPDATES // minibatches))
    optimizer = torch.optim.Adam(network.parameters(), lr=learning_rate, fused=True)
    # Common features of the examples are learned fast; thresholds between two actions need small steps.
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, epochs * minibatches)
    for _ in range(epochs):
        for some in np.array_split(rng.permutation(count), minibatches):
            optimizer.zero_grad()
            loss(some).backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), max_grad_norm)
            optimizer.step()
            schedule.step()
    return minibatches


class _Turns:
    """T turns as independent training examples.

    Args:
        model, observations, masks, actions: as for :func:`fit`.
    """

    def __init__(self, model: Any, observations: Any, masks: Any, actions: Any) -> None:
        self._network, self._observations, self.actions = model.policy, observations, actions
        masked = "Maskable" in type(getattr(model.policy, "action_dist", None)).__name__
        self._masks = masks if masked else None
        self.count, self.batch, self.learning_rate = len(actions), BATCH, LEARNING_RATE

    def rows(self, some: IntArray) -> IntArray:
        """Return the turns of some examples, by their indices (0 to ``count`` - 1)."""
        return some

    def evaluated(self, some: IntArray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return (values, log-probabilities of the actions, entropies) of the turns of some examples."""
        seen, actions = torch.as_tensor(self._observations[some]), torch.as_tensor(self.actions[some])
        values, log_probability, entropy = self._network.evaluate_actions(seen, actions, **self._legal(some))
        return values.flatten(), log_probability, entropy

    def chosen(self, some: IntArray) -> npt.NDArray[Any]:
        """Return the learner's most probable actions in the turns of some examples."""
        seen = self._observations[some]
        return np.asarray(self._network.predict(seen, deterministic=True, **self._legal(some))[0])

    def _legal(self, some: IntArray) -> dict[str, npt.NDArray[np.int8]]:
        return {} if self._masks is None else {"action_masks": self._masks[some]}


class _Episodes(_Turns):
    """Whole episodes as training examples of a recurrent learner.

    Args:
        model, observations, masks, actions, lengths: as for :func:`fit`.
    """

    def __init__(self, model: Any, observations: Any, masks: Any, actions: Any, lengths: IntArray) -> None:
        if masks is not None and model.observation_space.shape[0] > observations.shape[1]:
            observations = np.concatenate([observations, masks], axis=1, dtype=np.float32)
        super().__init__(model, observations, masks, actions)
        self._lengths, self._first = lengths, np.cumsum(lengths) - lengths
        self.count, self.batch = len(lengths), max(1, int(_SEQUENCES_BATCH / lengths.mean()))
        self.learning_rate = _SEQUENCES_LEARNING_RATE

    def rows(self, some: IntArray) -> IntArray:
        return np.concatenate([padded[is_turn] for _, padded, is_turn in self._groups(some)])

    def _groups(self, some: IntArray) -> Iterator[tuple[IntArray, IntArray, BoolArray]]:
        """Yield groups of episodes of similar length, to limit padding.

        Yields:
            [G] episodes; [G * longest] their turns, padded with turn 0; and [G * longest] True where not padded.
        """
        doublings = np.frexp(self._lengths[some])[1]
        for doubling in np.unique(doublings):
            group = some[doublings == doubling]
            turn = np.arange(self._lengths[group].max())
            is_turn = turn < self._lengths[group, None]
            yield group, np.where(is_turn, self._first[group, None] + turn, 0).ravel(), is_turn.ravel()

    def _initial_state(self, episodes: IntArray) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the LSTM's hidden and cell state at the beginning of episodes: zeros."""
        layers, _, size = self._network.lstm_hidden_state_shape
        zeros = torch.zeros(layers, len(episodes), size)
        return zeros, zeros

    def evaluated(self, some: IntArray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        parts = []
        for group, padded, is_turn in self._groups(some):
            seen, actions = torch.as_tensor(self._observations[padded]), torch.as_tensor(self.actions[padded])
            memory, kept = RNNStates(self._initial_state(group), self._initial_state(group)), torch.as_tensor(is_turn)
            columns = self._network.evaluate_actions(seen, actions, memory, torch.zeros(len(padded)))
            parts.append([None if column is None else column.flatten()[kept] for column in columns])
        values, log_probability, entropy = zip(*parts, strict=True)
        return torch.cat(values), torch.cat(log_probability), None if entropy[0] is None else torch.cat(entropy)

    def chosen(self, some: IntArray) -> npt.NDArray[Any]:
        parts = []
        for group, padded, is_turn in self._groups(some):
            seen = torch.as_tensor(self._observations[padded])
            distribution, _ = self._network.get_distribution(seen, self._initial_state(group), torch.zeros(len(padded)))
            parts.append(distribution.get_actions(deterministic=True).numpy()[is_turn])
        return np.concatenate(parts)


class _Examples(NamedTuple):
    """T turns of whole episodes in order.

    Attributes:
        seen: [T, size] observations.
        actions: [T] discrete or [T, n] continuous actions.
        returns: [T] discounted returns.
        lengths: [E] number of turns of each episode.
        masks: [T, actions] legal actions; None for continuous actions.
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
    """Collect about ``steps`` turns with the actions of a policy, in which the policy or ``learner`` acts."""
    n, discrete = batch.num_envs, batch.single_action_space.shape == ()
    members, turns, teacher = np.arange(n), np.zeros(n, dtype=np.int64), Advisor(policy)
    rows: list[tuple[Any, Any, Any]] = []
    rewards: list[FloatArray] = []
    ends: list[BoolArray] = []
    ended = np.zeros(n, dtype=np.bool_)
    observation, _ = batch.reset(seed=None if seed is None else training_seeds(seed, n))
    # Without the last condition, long episodes would be missing. Every episode ends at the limits of its scenario.
    while len(rows) * n < steps or not ended.all():
        mask = batch.action_masks().astype(np.int8) if discrete else None
        action = played = teacher.advice(observation, mask, turns, members)
        seen = with_advice(observation, action, batch.action_count) if advised else observation.copy()
        rows.append((seen, mask, action))
        if learner is not None:
            played = learner.act(seen, mask, turns, members)
        teacher.played(played, members)
        observation, reward, over, _, infos = batch.step(played)
        turns = np.where(over | infos["experiment_over"], 0, turns + 1)
        ended |= over
        rewards.append(reward.copy())
        ends.append(over.copy())
    # Only turns of finished episodes are kept.
    following, is_finished = np.zeros(n), np.zeros(n, dtype=np.bool_)
    returns, kept = np.zeros((len(rows), n), dtype=np.float32), np.zeros((len(rows), n), dtype=np.bool_)
    for t in reversed(range(len(rows))):
        is_finished |= ends[t]
        following = rewards[t] + gamma * np.where(ends[t], 0.0, following)
        returns[t], kept[t] = following, is_finished

    def by_environment(column: Sequence[Any]) -> npt.NDArray[Any]:
        return np.stack(column).swapaxes(0, 1)[kept.T]

    observed, masks, actions = zip(*rows, strict=True)
    lengths = np.diff(np.flatnonzero(by_environment(ends)), prepend=-1)
    legal = by_environment(masks) if discrete else None
    return _Examples(by_environment(observed), by_environment(actions), returns.T[kept.T], lengths, legal)
