"""Proximal policy optimization for any roles of a batch of laboratories: IPPO, or MAPPO.

One file, in the style of CleanRL. Each role has one network, which its agents share. Experience is stored by turns, so
every role has its own rewards, elapsed times and episodes. Actions are masked categorical or normal. A critic observes
what its agent observes (IPPO), and also the true state of the laboratory (MAPPO); actors do not observe the state.
:mod:`~chemlab.agents.train.joint` trains with it.

From nothing, the manager learns without readings of many numbers (spectra, pictures). The exported policy takes the
whole observation, with weights of 0 for these columns.

Needs PyTorch: ``pip install ".[train]"``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.extras import needs
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.kernels.arrays import BoolArray, IntArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import goals_practised
from chemlab.physics.chemistry import PRESENT
from chemlab.roles.bench import Bench, Channel, channel_slices
from chemlab.roles.manager_actions import DISCARD, FIRST, MEASURE, SECOND, START, SUBMIT
from chemlab.roles.manager_state import INSTRUMENTS

from ..advice import Advisor
from ..background import background_players
from ..executors import Inline
from ..notes import WIDE, Notes
from ..policies import agent_policy
from ..pretrained import LOG_STD, PretrainedPolicy
from ..roles import MANAGER_ROLE, role_of
from ..runs import training_seeds
from .arguments import IPPO, MAPPO

with needs("training needs PyTorch", "train"):
    import torch
    from torch import nn

    from .imitate import BATCH, ENTROPY, LEARNING_RATE, VALUES, descend
    from .tied import Tanh, TiedLinear, Unit, action_units, notes_units, numbered, observed_units, tied_layers

__all__ = ["PPOTeam", "compact", "joined", "wide_columns"]

_LEAST_DEVIATION = 0.02
"""Lower bound of the standard deviation that normalizes an observed number."""
_FORBIDDEN = -1e9
"""Logit of an action that the mask forbids."""
_BEYOND = 0.25
"""Distance beyond a bound at which a component of a continuous action begins if it has no effect at that bound."""
_ROUNDS = 32, 128
"""Minimum and maximum of the default rounds of a rollout, which is half of the manager's action limit."""
_PRACTICE = 20
"""Steps in each environment before each update during practice."""
_REMEMBERED = 1 << 16
"""Maximum number of stored turns for self-imitation."""
_MEMORY = 1 << 26
"""Maximum number of numbers in the observations of these turns."""
_BY_TURN = ("_env", "_following", "_ended")
"""Arrays of these turns in addition to observations and actions."""
_RECALLED = 1 << 13
"""Maximum number of these turns that one update draws."""
_CRITIC_FIRST = 5
"""Number of first updates in which only the critic learns, after ``begin_from``."""
_CORES = torch.get_num_threads()
"""Number of cores; OMP_NUM_THREADS can limit it."""

Arrays = npt.NDArray[Any]


class _Network(nn.Module):
    """Actor and critic of one role.

    Args:
        observed, state, actions: sizes of the actor's input, of the state that the critic observes in addition, and of
            the actor's output.
        rest: [n] continuous action without effect; None: actions are discrete.
        hidden: sizes of the hidden layers.
        tied: laboratories whose slots, and orders, share weights; None: weights are not shared.
        units: meaning of the actor's inputs, if weights are shared (:mod:`~chemlab.agents.train.tied`).
    """

    mean: torch.Tensor
    scale: torch.Tensor

    def __init__(
        self,
        observed: int,
        state: int,
        actions: int,
        rest: Arrays | None,
        hidden: Sequence[int],
        tied: Laboratories | None = None,
        units: Sequence[Unit] = (),
    ) -> None:
        super().__init__()
        self.discrete = rest is None
        # Initial values are about 0: with other values and without a discount, endless episodes can seem better.
        if tied is None:
            self.actor = _layers(observed, hidden, actions, 0.01)
            self.critic = _layers(observed + state, hidden, 1, 0.01)
        else:
            seen = [*units, *((("state", k), -1, -1) for k in range(state))]
            self.actor = tied_layers(tied, units, action_units(tied), hidden)
            self.critic = tied_layers(tied, seen, [("value", -1, -1)], hidden)
        # Inputs are normalized: a reading of 0.01 can matter as much as one of 0.5.
        self.register_buffer("mean", torch.zeros(observed + state))
        self.register_buffer("scale", torch.ones(observed + state))
        if rest is not None:
            self.log_std = nn.Parameter(torch.full((actions,), -1.0))
            # A bench begins with the action without effect. From the bound itself, exploration would add small amounts
            # of reagents that do not matter to its own score.
            first = rest + _BEYOND * (1.0 * (rest >= 1.0) - (rest <= 0.0))
            with torch.no_grad():
                self.actor[-1].bias.copy_(torch.from_numpy(first))  # type: ignore[operator]

    def logits(self, observed: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
        """Return logits [B, actions] of discrete actions, or means [B, n] of continuous ones."""
        out: torch.Tensor = self.actor(self._normalized(observed))
        return out if mask is None else out.masked_fill(~mask, _FORBIDDEN)

    def normal(self, mean: torch.Tensor) -> torch.distributions.Distribution:
        """Return the distribution of continuous actions with these means [B, n]."""
        return torch.distributions.Normal(mean, self.log_std.exp().expand_as(mean), validate_args=False)

    def judge(
        self, observed: torch.Tensor, mask: torch.Tensor | None, action: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return log-probabilities [B] of actions, and the mean entropy; masked actions do not contribute to it."""
        logits = self.logits(observed, mask)
        if not self.discrete:
            normal = self.normal(logits)
            return normal.log_prob(action).sum(1), normal.entropy().sum(1).mean()
        log = logits.log_softmax(1)
        entropy = -(logits.softmax(1) * log.clamp(min=-50.0)).sum(1).mean()
        return log.gather(1, action[:, None])[:, 0], entropy

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """Return values [B] of the critic's inputs [B, size]."""
        found: torch.Tensor = self.critic(self._normalized(seen))[:, 0]
        return found

    def _normalized(self, x: torch.Tensor) -> torch.Tensor:
        return (x - self.mean[: x.shape[1]]) * self.scale[: x.shape[1]]


def _layers(size: int, hidden: Sequence[int], out: int, gain: float) -> nn.Sequential:
    """Return fully connected layers with tanh between them, orthogonally initialized."""
    widths = [size, *hidden, out]
    linear = [nn.Linear(a, b) for a, b in itertools.pairwise(widths)]
    for i, layer in enumerate(linear):
        nn.init.orthogonal_(layer.weight, gain if i == len(hidden) else 2.0**0.5)
        nn.init.zeros_(layer.bias)
    modules: list[nn.Module] = []
    for layer in linear:
        modules += [layer, Tanh()]
    return nn.Sequential(*modules[:-1])


def compact(scenario: Scenario) -> Scenario:
    """Return the scenario without readings of more than :data:`~.notes.WIDE` numbers in the manager's observation."""
    table = Laboratories(scenario, 1).instruments
    wide = {name for name, channel in zip(table.names, table.channels, strict=True) if channel.size > WIDE}
    kept = tuple(name for name in scenario.seen_instruments if name not in wide)
    return scenario.model_copy(update={"manager": scenario.manager.model_copy(update={"readings": kept})})


def _columns(whole: Sequence[Channel], part: Sequence[Channel]) -> IntArray:
    """Return the columns of the channels ``part`` in an observation of the channels ``whole``."""
    slices = channel_slices(whole)
    return np.concatenate([np.arange(slices[one.name].start, slices[one.name].stop) for one in part])


class _Learner:
    """Network and optimizer of one role.

    Args:
        columns: columns of its input in the whole scenario's observation, which has ``size`` numbers.
        network: the network.
        settings: arguments of the run.
        gamma: discount.
        groups: group of each input of the critic; all inputs of a group have the same normalization.
    """

    def __init__(
        self, columns: IntArray, size: int, network: _Network, settings: IPPO, gamma: float, groups: IntArray
    ) -> None:
        self.columns, self.size, self.network, self.gamma, self._groups = columns, size, network, gamma, groups
        self.settings, self.critic_first = settings, 0
        self._count, self._moments, self._normalizes = 0, np.zeros((2, len(groups))), True
        self._taken = False
        actor = [one for name, one in network.named_parameters() if not name.startswith("critic.")]
        parts = [{"params": own, "rate": settings.learning_rate} for own in (actor, [*network.critic.parameters()])]
        self.optimizer = torch.optim.Adam(parts, eps=1e-5, fused=True)

    def seen(self, whole: Arrays) -> Arrays:
        """Return the role's input [B, columns] from observations [B, size] of the whole scenario."""
        return whole[:, self.columns]

    def act(self, observed: Arrays, mask: BoolArray | None, greedy: bool = False) -> tuple[Arrays, Arrays]:
        """Return drawn or most probable actions [B] or [B, n], and their log-probabilities [B]."""
        with torch.inference_mode():
            logits = self.network.logits(torch.from_numpy(observed), None if mask is None else torch.from_numpy(mask))
            if self.network.discrete:
                probability = logits.softmax(1)
                drawn = probability.argmax(1, True) if greedy else _drawn(probability)
                return drawn[:, 0].numpy(), probability.gather(1, drawn)[:, 0].log().numpy()
            normal = self.network.normal(logits)
            action = logits if greedy else normal.sample()
            return action.numpy(), normal.log_prob(action).sum(1).numpy()

    def value(self, observed: Arrays) -> Arrays:
        """Return values [B] of the critic's inputs [B, size]."""
        with torch.inference_mode():
            return np.asarray(self.network.value(torch.from_numpy(observed)).numpy())

    def value_turns(self, track: _Track) -> None:
        """Write the values of all turns of a rollout."""
        acted = track.acted[1:]
        track.value[1:][acted] = self.value(track.seen[1:][acted])

    def update(self, batch: Mapping[str, Arrays | None], remaining: float, rng: np.random.Generator) -> None:
        """Learn from a batch of turns.

        Args:
            batch: ``observed`` [B, size], ``seen`` [B, size] (input of the critic; None: the same), ``mask`` [B, A] or
                None, ``action``, ``log_probability``, ``advantage`` and ``target`` [B].
            remaining: remaining share of training.
            rng: generator of the minibatches.
        """
        s, policy_weight = self.settings, 0.0 if self.critic_first else 1.0
        self.critic_first = max(self.critic_first - 1, 0)
        tensors = {name: None if array is None else torch.from_numpy(array) for name, array in batch.items()}
        for group in self.optimizer.param_groups:
            group["lr"] = group["rate"] * max(remaining, 0.05)
        count = len(tensors["advantage"])  # type: ignore[arg-type]
        self.network.train()
        with _another_core() as core:
            for _ in range(s.epochs):
                for rows in torch.from_numpy(rng.permutation(count)).split(s.batch_size):  # type: ignore[no-untyped-call]
                    if len(rows) < 2:  # advantages are normalized
                        continue
                    own = _rows(tensors, rows)
                    self.optimizer.zero_grad()
                    critic = core.submit(self._learn_values, own["seen"], own["target"])
                    policy, entropy = self._policy_losses(own)
                    bonus = s.ent_coef * max(remaining, 0.1) * entropy
                    (policy_weight * (policy - bonus)).backward()  # type: ignore[no-untyped-call]
                    critic.result()
                    nn.utils.clip_grad_norm_(self.network.parameters(), 0.5)
                    self.optimizer.step()

    def normalize(self, seen: Arrays) -> None:
        """Update the means and standard deviations of the normalization with inputs [B, size] of the critic.

        The normalization of a cloned policy is fixed. After ``begin_from`` it is set once, and the first layer is
        rescaled so that the policy remains the same.
        """
        if not self._normalizes:
            return
        self._count += len(seen)
        squares = np.einsum("ij,ij->j", seen, seen, dtype=np.float64)  # without a whole array of squares
        self._moments += np.stack([seen.sum(axis=0, dtype=np.float64), squares])
        sizes = np.bincount(self._groups)
        mean, square = (
            (np.bincount(self._groups, weights=one) / sizes)[self._groups] for one in self._moments / self._count
        )
        deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
        self.network.mean[:] = torch.from_numpy(mean)
        self.network.scale[:] = torch.from_numpy(1.0 / np.maximum(deviation, _LEAST_DEVIATION))
        if self._taken:
            self._normalizes, first = False, self.network.actor[0]
            assert isinstance(first, nn.Linear)  # no weights are shared
            with torch.no_grad():
                size = first.in_features
                first.bias.add_(first.weight @ self.network.mean[:size])
                first.weight.div_(self.network.scale[:size])

    def _learn_values(self, seen: torch.Tensor, target: torch.Tensor) -> None:
        """Compute the gradient of the value loss of a minibatch."""
        (0.5 * (self.network.value(seen) - target).square().mean()).backward()  # type: ignore[no-untyped-call]

    def _policy_losses(self, batch: Mapping[str, Any]) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the clipped policy loss and the entropy of a minibatch."""
        log_probability, entropy = self.network.judge(batch["observed"], batch["mask"], batch["action"])
        advantage = batch["advantage"]
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        ratio = (log_probability - batch["log_probability"]).exp()
        clip = self.settings.clip_range
        return -torch.min(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage).mean(), entropy

    def take(self, policy: PretrainedPolicy) -> None:
        """Initialize the actor with the weights of a policy; in the first updates only the critic learns.

        Raises:
            ValueError: the policy has other layers, observes hints, or observes notes and the learner does not.
        """
        card, width = policy.card, policy.weights["0.weight"].shape[1]
        if card.advice is not None:
            raise ValueError(f"{card.name} observes the hints of {card.advice}, which ippo and mappo do not give")
        if card.notes and width > self.size:
            raise ValueError(f"{card.name} observes its notes, which are off here; add --notes")
        linear = [layer for layer in self.network.actor if isinstance(layer, nn.Linear)]
        sizes = [len(policy.weights[f"{i}.bias"]) for i in range(sum("bias" in name for name in policy.weights))]
        if sizes != [layer.out_features for layer in linear] or card.memory or card.activation != "tanh":
            raise ValueError(
                f"{card.name} has hidden layers {sizes[:-1]} ({card.activation}, memory {card.memory}); "
                "give others with --net-arch, which are tanh without memory"
            )
        with torch.no_grad():
            for i, layer in enumerate(linear):
                weight = policy.weights[f"{i}.weight"]
                if i == 0:  # a policy may have been trained without notes
                    weight = self.seen(np.pad(weight, ((0, 0), (0, self.size - width))))
                layer.weight.copy_(torch.from_numpy(weight))
                layer.bias.copy_(torch.from_numpy(policy.weights[f"{i}.bias"]))
            if LOG_STD in policy.weights:
                self.network.log_std.copy_(torch.from_numpy(policy.weights[LOG_STD]))
        self.critic_first, self._taken = _CRITIC_FIRST, True
        critic = self.optimizer.param_groups[1]  # which is new
        critic["rate"] = max(self.settings.learning_rate, IPPO.model_fields["learning_rate"].default)

    def clone(self, batch: Mapping[str, Arrays | None], rng: np.random.Generator, least_std: float) -> float:
        """Fit the actor to the actions of a batch of turns, and the critic to their returns (``target``).

        Returns:
            Share of turns with the same action; for continuous actions the mean absolute difference.
        """
        tensors: dict[str, Any] = {n: None if array is None else torch.from_numpy(array) for n, array in batch.items()}
        network, self._normalizes = self.network, False
        network.train()

        def loss(rows: IntArray) -> Any:
            own = _rows(tensors, torch.from_numpy(rows))
            log_probability, entropy = network.judge(own["observed"], own["mask"], own["action"])
            value = (network.value(own["seen"]) - own["target"]).square().mean()
            return -log_probability.mean() - ENTROPY * entropy + VALUES * value

        descend(network, loss, len(tensors["target"]), BATCH, LEARNING_RATE, 0.5, rng)
        with torch.no_grad():
            chosen = network.logits(tensors["observed"], tensors["mask"])
            if network.discrete:
                return float(torch.eq(chosen.argmax(1), tensors["action"]).float().mean())
            # The maximum-likelihood estimate, which the optimizer would not reach in so few updates.
            missing = (chosen - tensors["action"]).square().mean(dim=0).sqrt()
            network.log_std.copy_(missing.clamp(min=least_std).log())
            return float((chosen - tensors["action"]).abs().mean())


def _drawn(probability: torch.Tensor) -> torch.Tensor:
    """Return an action [B, 1] drawn from each row of probabilities [B, A], faster than ``torch.multinomial``."""
    until = probability.cumsum(1)
    return torch.searchsorted(until, (1.0 - torch.rand(len(until), 1)) * until[:, -1:])  # never one of probability 0


def _fading(share: float, remaining: float) -> float:
    """Return the remaining strength, from 1 to 0, of help that fades over a share of training."""
    return max(1.0 - (1.0 - remaining) / share, 0.0) if share else 0.0


def _rows(tensors: Mapping[str, torch.Tensor | None], rows: torch.Tensor) -> dict[str, Any]:
    """Return some turns of a batch."""
    own = {name: None if tensor is None else tensor.index_select(0, rows) for name, tensor in tensors.items()}
    return {**own, "seen": own["observed"] if own["seen"] is None else own["seen"]}


def _another_core() -> Executor:
    """Return an executor of functions: in a second thread if there is another core, otherwise in this one.

    The results are the same, since each thread computes with one core.
    """
    return ThreadPoolExecutor(1, initializer=torch.set_num_threads, initargs=(1,)) if _CORES > 1 else Inline()


class _Track:
    """Rollout buffer of one agent in N laboratories, by rounds.

    Row 0 has turns of the previous rollout that still wait for the agent's next turn; the other rows are rounds.
    """

    def __init__(self, rounds: int, envs: int, observed: int, seen: int, action: tuple[int, ...], masked: int) -> None:
        rows = rounds + 1
        self.observed = np.zeros((rows, envs, observed), dtype=np.float32)
        self.shared = seen == observed
        self.seen = self.observed if self.shared else np.zeros((rows, envs, seen), dtype=np.float32)
        self.mask = np.zeros((rows, envs, masked), dtype=np.bool_) if masked else None
        self.action = np.zeros((rows, envs, *action), dtype=np.float32 if action else np.int64)
        self.log_probability, self.value, self.reward = (np.zeros((rows, envs), dtype=np.float32) for _ in range(3))
        self.acted, self.ended = (np.zeros((rows, envs), dtype=np.bool_) for _ in range(2))
        self.tick = np.zeros((rows, envs), dtype=np.int64)

    def clear(self) -> None:
        """Delete all turns."""
        self.acted[:] = self.ended[:] = False
        self.reward[:] = 0.0

    def __getstate__(self) -> dict[str, Any]:
        # Between rollouts only row 0 is in use.
        return {**vars(self), **{name: (array.shape, array[0]) for name, array in self.arrays().items()}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            if isinstance(value, tuple):
                shape, first = value
                state[name] = np.zeros(shape, dtype=first.dtype)
                state[name][0] = first
        if state["shared"]:
            state["seen"] = state["observed"]
        self.__dict__.update(state)

    def arrays(self) -> dict[str, Arrays]:
        """Return the arrays by name."""
        found = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return {name: value for name, value in found.items() if name != "seen" or not self.shared}

    def finished(
        self, next_value: Arrays, has_turn: BoolArray, gamma: float, gae_lambda: float, ticks: IntArray | None = None
    ) -> dict[str, Arrays | None]:
        """Return the complete turns with their advantages; keep the others for the next rollout.

        Args:
            next_value: [N] values of the current observations, where the agent has the turn.
            has_turn: [N] True where it has the turn.
            gamma, gae_lambda: see :class:`~.arguments.IPPO`.
            ticks: [N] current ticks, for a discount by ticks; None: discount by turns.
        """
        rows, envs = self.acted.shape
        value, advantage, reward = next_value * has_turn, np.zeros(envs, np.float32), np.zeros(envs, np.float32)
        known = has_turn.copy()
        advantages, complete = np.zeros((rows, envs), np.float32), np.zeros((rows, envs), np.bool_)
        open_reward = np.zeros(envs, np.float32)
        following = None if ticks is None else ticks.copy()
        for t in range(rows - 1, -1, -1):
            over = self.ended[t]
            value[over] = advantage[over] = reward[over] = 0.0
            known |= over
            reward += self.reward[t]
            acted = self.acted[t]
            factor: Any = gamma if following is None else gamma ** np.maximum(following - self.tick[t], 0)
            found = reward + factor * value - self.value[t] + factor * gae_lambda * advantage
            if following is not None:
                following = np.where(acted, self.tick[t], following)
            complete[t] = acted & known
            advantages[t] = np.where(known, found, 0.0)
            open_reward = np.where(acted & ~known, reward, open_reward)
            value = np.where(acted, self.value[t], value)
            advantage = np.where(acted, advantages[t], advantage)
            reward = np.where(acted, 0.0, reward)
            known |= acted
        batch = self.turns(complete)
        batch["log_probability"] = self.log_probability[complete]
        batch["advantage"] = advantages[complete]
        batch["target"] = advantages[complete] + self.value[complete]
        self._carry(self.acted & ~complete, open_reward)
        return batch

    def turns(self, chosen: BoolArray) -> dict[str, Arrays | None]:
        """Return ``observed``, ``seen`` (None: as observed), ``mask`` and ``action`` of some turns [rows, N]."""
        return {
            "observed": self.observed[chosen],
            "seen": None if self.shared else self.seen[chosen],
            "mask": None if self.mask is None else self.mask[chosen],
            "action": self.action[chosen],
        }

    def _carry(self, waiting: BoolArray, reward: Arrays) -> None:
        """Move turns that wait for the next turn to row 0, and delete the others."""
        t, n = np.nonzero(waiting)
        for array in self.arrays().values():
            kept = array[t, n]
            if array.dtype == np.bool_ and array.ndim == 2:
                array[:] = False
            array[0, n] = kept
        self.reward[:] = 0.0
        self.reward[0] = np.where(waiting.any(axis=0), reward, 0.0)


class _Best:
    """Buffer of the manager's latest turns with their undiscounted returns, for self-imitation.

    See `Oh et al., 2018 <https://arxiv.org/abs/1806.05635>`_.

    Args:
        envs: number of laboratories.
        track: rollout buffer of the manager.
    """

    def __init__(self, envs: int, track: _Track) -> None:
        size = self._size = min(_REMEMBERED, _MEMORY // track.seen.shape[2])
        self._turns = {
            name: np.zeros((size, *array.shape[2:]), dtype=array.dtype)
            for name, array in track.arrays().items()
            if name in ("observed", "seen", "mask", "action")
        }
        self._env, self._following = np.full(size, -1), np.zeros(size, dtype=np.float32)
        self._ended, self._earned, self._at = np.zeros(size, dtype=np.bool_), np.zeros(envs), 0

    def __getstate__(self) -> dict[str, Any]:
        # Unused rows are left out; they would enlarge a checkpoint by up to a gigabyte.
        taken = int((self._env >= 0).sum())
        turns = {name: kept[:taken] for name, kept in self._turns.items()}
        return {**vars(self), "_turns": turns, **{name: getattr(self, name)[:taken] for name in _BY_TURN}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        taken = len(state["_env"])
        for arrays, names in ((state["_turns"], list(state["_turns"])), (state, _BY_TURN)):
            for name in names:
                whole = np.zeros((state["_size"], *arrays[name].shape[1:]), dtype=arrays[name].dtype)
                whole[:taken] = arrays[name]
                arrays[name] = whole
        state["_env"][taken:] = -1
        self.__dict__.update(state)

    def add(self, track: _Track, t: int, rows: IntArray) -> None:
        """Add the turns of round ``t`` in the laboratories ``rows`` [B]."""
        at = (self._at + np.arange(len(rows))) % self._size
        self._at = int(at[-1] + 1) % self._size
        for name, kept in self._turns.items():
            kept[at] = getattr(track, name)[t, rows]
        self._env[at], self._following[at], self._ended[at] = rows, -self._earned[rows], False

    def rewarded(self, reward: Arrays, over: BoolArray) -> None:
        """Add the rewards [N] of a round; ``over`` [N] is True where the episode has ended."""
        self._earned += reward
        if over.any():
            mine = np.flatnonzero((self._env >= 0) & ~self._ended)
            mine = mine[over[self._env[mine]]]
            self._following[mine] += self._earned[self._env[mine]]
            self._ended[mine] = True
            self._earned[over] = 0.0

    def learn(self, learner: _Learner, rng: np.random.Generator) -> None:
        """Increase the probability of drawn turns whose return exceeds the critic's value."""
        ended = np.flatnonzero(self._ended)
        if not len(ended):
            return
        known = rng.choice(ended, min(len(ended), _RECALLED), replace=False)
        returns, seen = self._following[known], self._turns.get("seen", self._turns["observed"])
        learner.network.eval()
        value = learner.value(seen[known])
        better = (returns - value) / (returns.std() + 1e-8)
        chosen = np.flatnonzero(better > 0.0)  # in random order, as drawn
        learner.network.train()
        # The loss is the mean over all drawn turns, of which only the better ones contribute.
        scale = learner.settings.self_imitation * len(chosen) / len(known)
        parts = max(1, len(chosen) // learner.settings.batch_size)
        for rows in np.array_split(chosen, parts) if len(chosen) else ():
            own = {name: torch.from_numpy(values[known[rows]]) for name, values in self._turns.items()}
            log_probability, _ = learner.network.judge(own["observed"], own["mask"], own["action"])
            loss = -scale * (torch.from_numpy(better[rows]) * log_probability).mean()
            learner.optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(learner.network.parameters(), 0.5)
            learner.optimizer.step()


class _Practice:
    """Practice of one bench on its own, before it plays in the laboratory.

    Args:
        scenario, bench, learner, settings: those of the team.
        state: size of the state that a centralized critic observes; its values are 0 in practice.
    """

    def __init__(self, scenario: Scenario, bench: str, learner: _Learner, settings: IPPO, state: int) -> None:
        self.learner, self.settings, self.scores = learner, settings, list[float]()
        self.batch = RoleVectorEnv(
            settings.envs,
            scenario,
            bench=bench,
            goals=goals_practised(scenario, bench),
            autoreset_mode="SameStep",
            copy=False,
            split=settings.split,
        )
        size, actions = learner.size, self.batch.action_count
        shape = () if actions else tuple(self.batch.single_action_space.shape or ())
        self.track = _Track(_PRACTICE, settings.envs, size, size + state, shape, actions)
        self._observed, _ = self.batch.reset(seed=training_seeds(settings.seed, settings.envs))

    def learn(self, remaining: float, rng: np.random.Generator) -> int:
        """Play a short rollout and learn from it; return the number of turns."""
        track, learner = self.track, self.learner
        for t in range(1, _PRACTICE + 1):
            mask = self.batch.action_masks() if learner.network.discrete else None
            track.observed[t] = self._observed
            if not track.shared:
                track.seen[t, :, : learner.size] = self._observed
            played, track.log_probability[t] = learner.act(track.observed[t], mask)
            track.action[t], track.acted[t] = played, True
            if track.mask is not None:
                track.mask[t] = mask
            self._observed, track.reward[t], over, _, infos = self.batch.step(
                played if learner.network.discrete else np.clip(played, 0.0, 1.0)
            )
            track.ended[t] = over
            self.scores += infos["score"][over].tolist()
        learner.value_turns(track)
        seen = np.zeros_like(track.seen[0])
        seen[:, : learner.size] = self._observed
        everywhere = np.ones(self.settings.envs, dtype=np.bool_)
        batch = track.finished(learner.value(seen), everywhere, learner.gamma, self.settings.gae_lambda)
        learner.update(batch, remaining, rng)
        return self.settings.envs * _PRACTICE


class PPOTeam:
    """Roles that learn together in a batch of laboratories; a policy by name plays the others.

    Args:
        scenario: the laboratory.
        roles: roles that learn: ``manager``, or keys of benches.
        settings: arguments of the run.
        background: policy of the other roles.
        wide: True if the manager observes also readings of many numbers.

    Attributes:
        rounds: number of rounds of a rollout.
        turns: number of turns so far, by role.
        fixed: roles that play greedily and no longer learn.
        notes: the manager's notes; None without notes.
        scores: scores of episodes that have ended; the caller empties the list.
    """

    def __init__(
        self, scenario: Scenario, roles: Sequence[str], settings: IPPO, background: str, wide: bool = False
    ) -> None:
        self.settings, seed = settings, settings.seed
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        full, world = Laboratories(scenario, 1), scenario.world
        self._hides = len(world.told_to(MANAGER_ROLE)) < len(world.draws)
        self._shown = settings.shown_readings if world.draws else 0.0
        seen_by_all = compact(scenario) if MANAGER_ROLE in roles and not wide else scenario
        self.batch = BatchedLaboratory(settings.envs, seen_by_all, copy=False, infos=False, split=settings.split)
        self.labs = labs = self.batch.laboratories
        self.agents = self.batch.possible_agents
        noting = self._hides if settings.notes is None else settings.notes
        self.notes = Notes(labs) if noting and MANAGER_ROLE in roles else None
        self.learners: dict[str, _Learner] = {}
        self._players = background_players(labs, roles, background)
        self._tracks: dict[str, _Track] = {}
        state = self.batch.state_space.shape[0] if isinstance(settings, MAPPO) else 0
        # Rollouts much shorter than an episode learn little of long workflows; longer ones only delay updates.
        fitting = min(max(scenario.limits.manager_actions // 2, _ROUNDS[0]), _ROUNDS[1])
        self.rounds = settings.rollout or fitting
        # If a bench is rewarded for its own experiments only, its episode is the experiment.
        self._own_episodes = labs.scenario.rewards.bench_team == 0.0
        for number, agent in enumerate(self.agents):
            role, space = role_of(agent), self.batch.action_space(agent)
            if role not in roles:
                continue
            count = labs.action_counts[number]
            if role not in self.learners:
                whole = full.observation_sizes[number]
                columns = _columns(full.roles[number].channels, labs.roles[number].channels)
                size = count or int(space.shape[0])  # type: ignore[index]
                ties = self._hides if settings.tied is None else settings.tied
                tied = labs if role == MANAGER_ROLE and ties else None
                units = observed_units(labs) if tied else []
                if role == MANAGER_ROLE and self.notes is not None:
                    columns = np.concatenate([columns, whole + np.arange(self.notes.size)])
                    whole += self.notes.size
                    units += notes_units(labs) if tied else []
                bench = labs.roles[number].workplace
                rest = bench.representative_actions()[-1][1] if isinstance(bench, Bench) and not count else None
                network = _Network(len(columns), state, size, rest, settings.net_arch, tied, units)
                gamma = settings.manager_gamma if role == MANAGER_ROLE else settings.gamma
                kinds = [unit[0] for unit in units] if tied else range(len(columns))
                groups = numbered([*kinds, *(("state", k) for k in range(state))])
                self.learners[role] = _Learner(columns, whole, network, settings, gamma, groups)
            seen = len(self.learners[role].columns)
            self._tracks[agent] = _Track(
                self.rounds, settings.envs, seen, seen + state, () if count else tuple(space.shape or ()), count
            )
        self.practices = {
            role: _Practice(scenario, role, learner, settings, state)
            for role, learner in self.learners.items()
            if role != MANAGER_ROLE and settings.practice
        }
        self.fixed: set[str] = set()
        self._places = (np.arange(settings.envs) + 0.5) / settings.envs
        self._teachers: dict[str, Advisor] = {}
        self._tried = False
        self._restart()

    def _restart(self, done: float = 0.0) -> None:
        """Start new episodes, with the help of the completed share ``done`` of training, and delete all turns."""
        self._best: _Best | None = None
        for agent, track in self._tracks.items():
            track.clear()
            if agent == MANAGER_AGENT and self.settings.self_imitation:
                self._best = _Best(self.settings.envs, track)
        self.turns = dict.fromkeys(self.learners, 0)
        self.scores: list[float] = []
        self._rewarded, self._refunded = np.zeros(self.settings.envs), np.zeros(self.settings.envs)
        self._unread, everywhere = np.zeros(self.labs.state.age.shape, np.bool_), np.ones(self.settings.envs, np.bool_)
        seeds = training_seeds(self.settings.seed, self.settings.envs)
        self._observed, self._infos = self.batch.reset(seed=seeds)
        for member, seed in enumerate(seeds):
            self._players.seed(member, seed)
        self._earned = self.labs.unfinished_worth(self.labs.members)
        self._decided = np.zeros(self.settings.envs, np.int64)
        """[N] tick of the manager's last decision."""
        self._read(done, everywhere)

    def learn(self, done: float, rounds: int) -> int:
        """Play a rollout, learn from it, and return the number of turns, at least 1.

        Args:
            done: completed share of training.
            rounds: number of rollouts so far.
        """
        s = self.settings
        if self.practices and done < s.practice:
            learned = {role: practice.learn(1.0 - done, self.rng) for role, practice in self.practices.items()}
            self.turns = {role: turns + learned.get(role, 0) for role, turns in self.turns.items()}
            return sum(learned.values())
        # Help in the laboratory fades from the end of practice on.
        remaining = (1.0 - done) / (1.0 - (s.practice if self.practices else 0.0))
        # With a manager that starts them at random, benches would forget their skills.
        self.fixed = set(self.practices) if MANAGER_ROLE in self.learners else set()
        roles = [role for role in self.learners if role not in self.fixed]
        self.collect(remaining)
        learning = roles if s.regime == "together" else [roles[rounds // s.period % len(roles)]]
        return max(self.update(remaining, 1.0 - done, learning), 1)

    def _helps(self, share: float, done: float) -> BoolArray:
        """Return [N] True in laboratories where help that lasts for a share of training is still given."""
        return done < share * self._places

    def _read(self, done: float, over: BoolArray) -> None:
        """Measure vessels on the shelf automatically: each once, with a probability that falls to 0.

        Args:
            done: completed share of training.
            over: [N] True where an episode has just ended and the next one has begun.
        """
        labs, state = self.labs, self.labs.state
        share = _fading(self._shown, 1.0 - done)
        if MANAGER_ROLE not in self.learners or not share:
            return
        turn = self._infos[MANAGER_AGENT]["has_turn"].astype(np.bool_)
        present = labs.shelf.vessels[:, : labs.scenario.shelf.slots, PRESENT, None] > 0.0
        self._unread &= present & ~over[:, None, None]
        affordable = labs.rules.arrays.price <= labs.scenario.limits.budget
        new = turn[:, None, None] & present & affordable & (state.age < 0) & ~self._unread
        shown = new & (self.rng.random(new.shape) < share)
        self._unread |= new & ~shown
        members, slots, used = np.nonzero(shown)
        if len(members):
            drifted = state.bias if state.bias.shape[1] else None
            labs.instruments.read(labs.shelf, state.reading, state.stream, members, slots, used, drifted)
            state.age[members, slots, used] = 0
            rows = np.unique(members)
            labs.observe(labs.manager.index, rows, self._observed[MANAGER_AGENT], rows)

    def collect(self, remaining: float) -> None:
        """Play a rollout; help depends on the ``remaining`` share of training."""
        done, refund = 1.0 - remaining, _fading(self.settings.refund, remaining)
        free = _fading(self.settings.free_readings, remaining) if self._hides else 0.0
        near = _fading(self.settings.partial, remaining)
        for learner in self.learners.values():
            learner.network.eval()
        for t in range(1, self.rounds + 1):
            actions = {
                agent: action for agent in self.agents if (action := self._chosen(agent, t, remaining)) is not None
            }
            measured = self.labs.state.charges[:, INSTRUMENTS].copy()
            self._observed, rewards, over, _, self._infos = self.batch.step(actions)
            self._players.renew(np.flatnonzero(over))
            self._read(done, over)
            self.scores += self._infos["manager_0"]["score"][over].tolist()
            for agent, track in self._tracks.items():
                track.reward[t], track.ended[t] = rewards[agent], over
                if agent == MANAGER_AGENT:
                    # After the end of an episode, charges are those of the next one.
                    spent = self.labs.rules.arrays.share * (self.labs.state.charges[:, INSTRUMENTS] - measured)
                    self._refunded += free * np.maximum(spent, 0.0)
                    track.reward[t] = self._credit(rewards[agent], over, near, refund)
                    if self._best is not None:
                        self._best.rewarded(track.reward[t], over)
                elif self._own_episodes:
                    track.ended[t] |= self._infos[agent]["experiment_over"]

    def _credit(self, reward: Arrays, over: BoolArray, near: float, refund: float) -> Arrays:
        """Return [N] the manager's rewards, with help, in the rounds that cause them.

        The environment settles costs, and in some scenarios payments, at the end of the episode. The value of
        unfinished work is a discounted potential, which shifts returns by a constant (`Ng et al., 1999
        <https://people.eecs.berkeley.edu/~russell/papers/icml99-shaping.pdf>`_).

        Args:
            reward: [N] rewards of the round.
            over: [N] True where an episode has just ended and the next one has begun.
            near, refund: remaining strengths of partial payments and of refunds.
        """
        labs, everywhere, info = self.labs, self.labs.members, self._infos[MANAGER_AGENT]
        share = labs.rules.arrays.share
        self._rewarded += reward
        partial = share * near * np.where(over, info["partial"], labs.partial_worth(everywhere)) if near else 0.0
        paid = share * np.where(over, info["paid"], labs.worth(everywhere).mean(axis=1)) + partial
        spent = share * labs.charges(everywhere).sum(axis=1)
        earned = np.where(over, self._rewarded + partial, paid - spent) + self._refunded
        earned += refund * np.maximum(0.5 * paid - earned, 0.0)
        unfinished = labs.unfinished_worth(everywhere)
        credit = earned + np.where(over, 0.0, unfinished) - self._earned
        decides = info["has_turn"] & ~over
        apart = np.maximum(labs.state.ticks - self._decided, 0) if self.settings.by_ticks else 1
        credit -= np.where(decides, (1.0 - self.settings.manager_gamma**apart) * unfinished, 0.0)
        self._earned = np.where(over, 0.0, earned) + unfinished
        self._rewarded[over] = self._refunded[over] = 0.0
        return np.asarray(credit)

    def _noted(self, agent: str, rows: IntArray) -> Arrays:
        """Return observations [B, observed] of a learner in the laboratories ``rows`` [B], with notes if it has any."""
        seen = self._observed[agent][rows]
        if self.notes is None or agent != MANAGER_AGENT:
            return seen
        return self.notes.shown(seen, None, self.labs.manager.turns_had[rows], rows)

    def _chosen(self, agent: str, t: int, remaining: float) -> Arrays | None:
        """Return actions [N] or [N, n] of an agent in round ``t``; None if it has no turn in any laboratory."""
        info, role, manages = self._infos[agent], role_of(agent), agent == MANAGER_AGENT
        rows = np.flatnonzero(info["has_turn"])
        if not len(rows):
            return None
        number = self.agents.index(agent)
        mask = None if "action_mask" not in info else info["action_mask"][rows]
        allowed = None if mask is None else mask.astype(np.bool_)
        if role not in self.learners:
            played = self._players.decide(number, rows)
        elif role in self.fixed:
            played, _ = self.learners[role].act(self._observed[agent][rows], allowed, greedy=True)
        else:
            track, teacher, observed = self._tracks[agent], self._teachers.get(agent), self._noted(agent, rows)
            self.turns[role] += len(rows)
            if manages and allowed is not None and not self._teachers:
                allowed = self._helped(allowed, rows, 1.0 - remaining)
            if teacher is None or self._tried:
                learned = self.learners[role].act(observed, allowed, greedy=teacher is not None)
                played, track.log_probability[t, rows] = learned
                shown = played
            if teacher is not None:
                shown = teacher.advice(self._observed[agent][rows], mask, self.labs.roles[number].turns_had[rows], rows)
                played = played if self._tried else shown
                teacher.played(played, rows)
            if self.notes is not None and manages:
                self.notes.played(played, rows)
            track.acted[t, rows], track.tick[t, rows] = True, self.labs.state.ticks[rows]
            if manages:
                self._decided[rows] = self.labs.state.ticks[rows]
            track.observed[t, rows], track.action[t, rows] = observed, shown
            if track.mask is not None:
                track.mask[t, rows] = allowed
            if not track.shared:
                track.seen[t, rows] = np.concatenate([observed, self.batch.state(rows)], axis=1)
            if self._best is not None and manages:
                self._best.add(track, t, rows)
        space = self.batch.action_space(agent)
        out = np.zeros((self.settings.envs, *(space.shape or ())), dtype=played.dtype)
        out[rows] = played if played.dtype.kind == "i" else np.clip(played, space.low, space.high)  # type: ignore[attr-defined]
        return out

    def _helped(self, mask: BoolArray, rows: IntArray, done: float) -> BoolArray:
        """Return the manager's mask [B, actions] restricted by help; unrestricted where no action would remain.

        Help ends in one laboratory after another. If it ended in all of them at once, untried actions would suddenly
        become likely.
        """
        table, state, settings = self.labs.actions.table, self.labs.state, self.settings
        kinds, helped = table[:, 0], mask.copy()
        starts, submits, discards, measures = (
            np.flatnonzero(kinds == kind) for kind in (START, SUBMIT, DISCARD, MEASURE)
        )
        # In every second laboratory, experiments may also have goals that no order asks for.
        own = np.flatnonzero((self._helps(settings.own_goals, done) & (np.arange(settings.envs) % 2 == 0))[rows])
        limited = np.flatnonzero(self._helps(settings.processed, done)[rows])
        wanted = (table[starts, 3][None, :, None] == state.goal[rows[own]][:, None, :]).any(axis=2)
        helped[np.ix_(own, starts)] &= wanted
        helped[np.ix_(limited, submits)] &= state.last_bench[rows[limited]][:, table[submits, 1]] > 0
        helped[np.ix_(limited, discards)] = False
        read = state.age[rows][:, table[measures, FIRST], table[measures, SECOND]] >= 0
        helped[:, measures] &= ~(read & self._helps(self._shown, done)[rows, None])
        empty = ~helped.any(axis=1)
        helped[empty] = mask[empty]
        return helped

    def update(self, remaining: float, whole: float, learning: Sequence[str]) -> int:
        """Learn from complete turns; return their number.

        Args:
            remaining: remaining share of training after practice, for the manager.
            whole: remaining share of all training, for the benches.
            learning: roles that learn; turns of others are deleted.
        """
        batches: dict[str, list[dict[str, Arrays | None]]] = {role: [] for role in self.learners}
        for agent, track in self._tracks.items():
            learner = self.learners[role_of(agent)]
            turn = self._infos[agent]["has_turn"]
            rows, value = np.flatnonzero(turn), np.zeros(self.settings.envs, dtype=np.float32)
            if len(rows):
                seen = self._noted(agent, rows)
                if not track.shared:
                    seen = np.concatenate([seen, self.batch.state(rows)], axis=1)
                value[rows] = learner.value(seen)
            ticks = self.labs.state.ticks if self.settings.by_ticks else None
            learner.value_turns(track)
            found = track.finished(value, turn.astype(np.bool_), learner.gamma, self.settings.gae_lambda, ticks)
            batches[role_of(agent)].append(found)
        learned = 0
        for role in learning:
            parts, critic_alone = batches[role], self.learners[role].critic_first > 0
            batch = joined(parts)
            count = len(batch["advantage"])  # type: ignore[arg-type]
            if count > 1:
                self.learners[role].update(batch, remaining if role == MANAGER_ROLE else whole, self.rng)
                if role == MANAGER_ROLE:
                    self.learners[role].normalize(np.asarray(batch["observed" if batch["seen"] is None else "seen"]))
            if self._best is not None and role == MANAGER_ROLE and not critic_alone:
                self._best.learn(self.learners[role], self.rng)
            learned += count
        return learned

    def clone(self, shown: str, turns: int, rounds: int, least_std: float) -> dict[str, float]:
        """Clone a policy into every learner, from its play in these laboratories, which then restart.

        Args:
            shown: name of the policy.
            turns: approximate number of turns per role, without those of unfinished episodes.
            rounds: number of DAgger rounds. After the first, the learners play, for as long as the policy did and until
                an episode has ended in every laboratory, and the policy labels their turns.
            least_std: lower bound of the initial standard deviation of continuous actions.

        Returns:
            Accuracy by role, see :meth:`_Learner.clone`.
        """
        found: dict[str, list[dict[str, Arrays | None]]] = {role: [] for role in self.learners}
        hit: dict[str, float] = {}
        first = 0
        for number in range(rounds):
            self._restart(1.0)
            self._tried = number > 0
            seeds = np.random.SeedSequence(self.settings.seed).spawn(len(self.agents))
            self._teachers = {
                agent: Advisor(agent_policy(shown, self.labs, index, own))
                for index, (agent, own) in enumerate(zip(self.agents, seeds, strict=True))
                if agent in self._tracks
            }
            by_ticks = self.settings.by_ticks
            episodes = _Shown(self._tracks, {role: own.gamma for role, own in self.learners.items()}, by_ticks)
            played = 0
            while played < first or not (episodes.all_ended() if number else episodes.enough(turns / rounds)):
                self.collect(0.0)
                episodes.add(self._tracks)
                played += 1
            first = first or played
            for role, part in episodes.by_role().items():
                found[role].append(part)
                hit[role] = self.learners[role].clone(joined(found[role]), self.rng, least_std)
        self._teachers, self._tried = {}, False
        self._restart()
        return hit

    def weights(self, role: str) -> dict[str, Arrays]:
        """Return a role's actor for the whole observation: ``{i}.weight`` [out, in] and ``{i}.bias`` [out]."""
        learner = self.learners[role]
        linear = [layer for layer in learner.network.actor if isinstance(layer, (nn.Linear, TiedLinear))]
        found: dict[str, Arrays] = {}
        for i, layer in enumerate(linear):
            weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
            if i == 0:
                size = weight.shape[1]
                weight = weight * learner.network.scale[:size].numpy()
                bias = bias - weight @ learner.network.mean[:size].numpy()
                whole = np.zeros((len(weight), learner.size), dtype=np.float32)
                whole[:, learner.columns] = weight
                weight = whole
            found[f"{i}.weight"], found[f"{i}.bias"] = weight.copy(), bias.copy()
        if not learner.network.discrete:
            found[LOG_STD] = learner.network.log_std.detach().numpy().copy()
        return found


class _Shown:
    """Demonstrated or labelled turns with their returns.

    Args:
        tracks: rollout buffers by agent.
        gammas: discount by role.
        by_ticks: True for a discount by ticks, False by turns.
    """

    def __init__(self, tracks: Mapping[str, _Track], gammas: Mapping[str, float], by_ticks: bool) -> None:
        self._gammas, self._by_ticks = gammas, by_ticks
        self._turns: dict[str, list[dict[str, Arrays | None]]] = {agent: [] for agent in tracks}
        self._rounds: dict[str, list[tuple[Arrays, ...]]] = {agent: [] for agent in tracks}

    def add(self, tracks: Mapping[str, _Track]) -> None:
        """Add the turns of a rollout, and clear its buffers."""
        for agent, track in tracks.items():
            self._turns[agent].append(track.turns(track.acted))
            self._rounds[agent].append((track.acted.copy(), track.ended.copy(), track.reward.copy(), track.tick.copy()))
            track.clear()

    def _returns(self, agent: str) -> tuple[BoolArray, Arrays]:
        """Return two arrays over turns in order: True if its episode has ended, and its return."""
        acted, ended, rewards, ticks = (np.concatenate(part) for part in zip(*self._rounds[agent], strict=True))
        apart, last = np.ones(acted.shape), ticks[0]
        for t in range(len(acted)) if self._by_ticks else ():
            apart[t] = np.maximum(ticks[t] - last, 0)
            last = np.where(acted[t], ticks[t], last)
        gamma = (self._gammas[role_of(agent)] ** apart).astype(np.float32)
        following = np.zeros(acted.shape[1], dtype=np.float32)
        known, over = np.zeros(acted.shape, dtype=np.bool_), np.zeros(acted.shape[1], dtype=np.bool_)
        returns = np.zeros(acted.shape, dtype=np.float32)
        for t in reversed(range(len(acted))):
            over |= ended[t]
            following = np.where(ended[t], 0.0, following) + rewards[t]
            returns[t], known[t] = following, over
            following = np.where(acted[t], gamma[t] * following, following).astype(np.float32)
        return known[acted], returns[acted]

    def all_ended(self) -> bool:
        """Return True if an episode has ended in every laboratory."""
        ended = [np.concatenate([part[1] for part in parts]).any(axis=0) for parts in self._rounds.values() if parts]
        return bool(ended and np.all(ended))

    def enough(self, turns: float) -> bool:
        """Return True if every role with turns has at least ``turns`` in finished episodes."""
        if not self.all_ended():
            return False
        counts: dict[str, int] = {}
        for agent in self._turns:
            counts[role_of(agent)] = counts.get(role_of(agent), 0) + int(self._returns(agent)[0].sum())
        return all(count >= turns for count in counts.values() if count)

    def by_role(self) -> dict[str, dict[str, Arrays | None]]:
        """Return the turns of finished episodes, with their returns as ``target``, by role."""
        found: dict[str, list[dict[str, Arrays | None]]] = {}
        for agent, turns in self._turns.items():
            known, returns = self._returns(agent)
            if known.any():
                whole: dict[str, Arrays | None] = {**joined(turns), "target": returns}
                found.setdefault(role_of(agent), []).append(
                    {name: None if array is None else array[known] for name, array in whole.items()}
                )
        return {role: joined(parts) for role, parts in found.items()}


def joined(parts: Sequence[Mapping[str, Arrays | None]]) -> dict[str, Arrays | None]:
    """Return several batches of turns as one."""
    return {
        name: None if parts[0][name] is None else np.concatenate([part[name] for part in parts]) for name in parts[0]
    }


def wide_columns(scenario: Scenario) -> IntArray:
    """Return the columns of the manager's observation that :func:`compact` leaves out."""
    whole, kept = (Laboratories(one, 1).manager for one in (scenario, compact(scenario)))
    return np.setdiff1d(np.arange(whole.observation_space.shape[0]), _columns(whole.channels, kept.channels))
