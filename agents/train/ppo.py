"""Proximal policy optimization for any roles of a batch of laboratories, from nothing: IPPO, or MAPPO.

One file, after CleanRL: a network for each role, which agents of one kind share; experience turn by turn; masked
categorical or normal actions. Critics see what their agent observes (IPPO) or the laboratory's state, too (MAPPO).

The manager learns without readings of many numbers (spectra, pictures). What is exported takes the whole observation,
with weights of 0 there.

Needs PyTorch: ``pip install ".[train]"``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.config.scenario import Scenario
from chemlab.envs.batch import BatchedLaboratory
from chemlab.kernels.arrays import BoolArray, IntArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import goals_met
from chemlab.roles.bench import Channel, channel_slices
from chemlab.roles.manager_actions import DISCARD, KINDS, START, SUBMIT

from ..former_names import GREEDY, SAMPLED
from ..policies import Policy, agent_policy
from ..pretrained import LOG_STD, Card, PretrainedPolicy, save_policy
from ..roles import MANAGER_ROLE, role_of
from ..runs import Evaluation, Run
from .arguments import LeanPPO

try:
    import torch
    from torch import nn

    from .checkpoints import load_state, random_state, restore_random_state, save_state
    from .joint import Team
    from .loop import Progress, reached
except ImportError as error:
    raise ImportError(f'training needs PyTorch ({error}): pip install ".[train]"') from error

__all__ = ["FromNothing", "PPOTeam"]

_WIDE = 32
"""Channels of more numbers are left out of the manager's view."""
_FORBIDDEN = -1e9
"""Logit of an action that the mask forbids."""

Arrays = npt.NDArray[Any]


class _Network(nn.Module):
    """Actor and critic of one role."""

    def __init__(self, observed: int, state: int, actions: int, discrete: bool, hidden: Sequence[int]) -> None:
        super().__init__()
        self.discrete = discrete
        self.actor = _layers(observed, hidden, actions, 0.01)
        self.critic = _layers(observed + state, hidden, 1, 1.0)
        if not discrete:
            self.log_std = nn.Parameter(torch.full((actions,), -1.0))
            nn.init.constant_(self.actor[-1].bias, 0.5)  # type: ignore[arg-type]

    def distribution(self, observed: torch.Tensor, mask: torch.Tensor | None) -> torch.distributions.Distribution:
        """Distribution of actions [B] (discrete) or [B, n]."""
        out = self.actor(observed)
        if not self.discrete:
            return torch.distributions.Normal(out, self.log_std.exp().expand_as(out), validate_args=False)
        logits = out if mask is None else out.masked_fill(~mask, _FORBIDDEN)
        return torch.distributions.Categorical(logits=logits, validate_args=False)


def _layers(size: int, hidden: Sequence[int], out: int, gain: float) -> nn.Sequential:
    """Fully connected layers with tanh between them, orthogonally initialized."""
    widths = [size, *hidden, out]
    linear = [nn.Linear(a, b) for a, b in itertools.pairwise(widths)]
    for i, layer in enumerate(linear):
        nn.init.orthogonal_(layer.weight, gain if i == len(hidden) else 2.0**0.5)
        nn.init.zeros_(layer.bias)
    modules: list[nn.Module] = []
    for layer in linear:
        modules += [layer, nn.Tanh()]
    return nn.Sequential(*modules[:-1])


def compact(scenario: Scenario) -> Scenario:
    """A scenario whose manager does not observe readings of more than :data:`_WIDE` numbers (spectra, pictures)."""
    table = Laboratories(scenario, 1).instruments
    wide = {name for name, channel in zip(table.names, table.channels, strict=True) if channel.size > _WIDE}
    kept = tuple(name for name in scenario.seen_instruments if name not in wide)
    return scenario.model_copy(update={"manager": scenario.manager.model_copy(update={"readings": kept})})


def _columns(whole: Sequence[Channel], part: Sequence[Channel]) -> IntArray:
    """Columns of the channels ``part`` in an observation of the channels ``whole``."""
    slices = channel_slices(whole)
    return np.concatenate([np.arange(slices[one.name].start, slices[one.name].stop) for one in part])


class _Learner:
    """One role: its network and optimizer.

    Args:
        columns: where what it observes stands in the observation of the whole scenario, of ``size`` numbers.
    """

    def __init__(self, columns: IntArray, size: int, network: _Network, settings: LeanPPO, gamma: float) -> None:
        self.columns, self.size, self.network, self.gamma = columns, size, network, gamma
        self.settings = settings
        self.optimizer = torch.optim.Adam(network.parameters(), lr=settings.learning_rate, eps=1e-5)

    def act(self, observed: Arrays, mask: BoolArray | None) -> tuple[Arrays, Arrays]:
        """Draw actions; return them with their log-probabilities."""
        with torch.no_grad():
            allowed = None if mask is None else torch.from_numpy(mask)
            distribution = self.network.distribution(torch.from_numpy(observed), allowed)
            action = distribution.sample()
            log_probability = distribution.log_prob(action)
        if not self.network.discrete:
            log_probability = log_probability.sum(1)
        return action.numpy(), log_probability.numpy()

    def value(self, observed: Arrays) -> Arrays:
        """Values [B] of what the critic sees."""
        with torch.no_grad():
            return np.asarray(self.network.critic(torch.from_numpy(observed))[:, 0].numpy())

    def update(self, batch: Mapping[str, Arrays | None], remaining: float, rng: np.random.Generator) -> None:
        """Learn from a batch of turns.

        Args:
            batch: ``observed`` [B, size], ``seen`` [B, size] (by the critic), ``mask`` [B, A] or None, ``action``,
                ``log_probability``, ``advantage`` and ``target`` [B].
            remaining: share of training that is left.
            rng: draws the minibatches.
        """
        s = self.settings
        tensors = {name: None if array is None else torch.from_numpy(array) for name, array in batch.items()}
        for group in self.optimizer.param_groups:
            group["lr"] = s.learning_rate * max(remaining, 0.05)
        count = len(tensors["advantage"])  # type: ignore[arg-type]
        for _ in range(s.epochs):
            for rows in torch.from_numpy(rng.permutation(count)).split(s.batch_size):  # type: ignore[no-untyped-call]
                if len(rows) < 2:  # advantages are normalized
                    continue
                policy, value, entropy = self._losses({n: None if t is None else t[rows] for n, t in tensors.items()})
                loss = policy + 0.5 * value - s.ent_coef * max(remaining, 0.1) * entropy
                self.optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(self.network.parameters(), 0.5)
                self.optimizer.step()

    def _losses(self, batch: Mapping[str, Any]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Clipped policy loss, value loss and entropy of a minibatch."""
        distribution = self.network.distribution(batch["observed"], batch["mask"])
        log_probability, entropy = distribution.log_prob(batch["action"]), _entropy(distribution)
        if not self.network.discrete:
            log_probability = log_probability.sum(1)
        advantage = batch["advantage"]
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        ratio = (log_probability - batch["log_probability"]).exp()
        clip = self.settings.clip_range
        policy = -torch.min(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage).mean()
        value = (self.network.critic(batch["seen"])[:, 0] - batch["target"]).square().mean()
        return policy, value, entropy


def _entropy(distribution: torch.distributions.Distribution) -> torch.Tensor:
    """Mean entropy; forbidden actions contribute nothing."""
    if isinstance(distribution, torch.distributions.Categorical):
        logits = distribution.logits.clamp(min=-50.0)
        return -(distribution.probs * logits).sum(1).mean()
    return distribution.entropy().sum(1).mean()


class _Track:
    """Turns of one agent in N laboratories over a rollout.

    Row 0 holds turns of the rollout before whose next turn had not come; the rows after it are the rounds.
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

    def __getstate__(self) -> dict[str, Any]:
        # Between rollouts there is nothing but row 0.
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
        """Everything by turn, by name."""
        found = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return {name: value for name, value in found.items() if name != "seen" or not self.shared}

    def finished(
        self, next_value: Arrays, has_turn: BoolArray, gamma: float, gae_lambda: float
    ) -> dict[str, Arrays | None]:
        """Return the turns that are complete, with advantages; keep the others for the next rollout.

        Args:
            next_value: [N] value of the present observation, where the agent has the turn.
            has_turn: [N] where it has.
            gamma, gae_lambda: see :class:`~.arguments.LeanPPO`.
        """
        rows, envs = self.acted.shape
        value, advantage, reward = next_value * has_turn, np.zeros(envs, np.float32), np.zeros(envs, np.float32)
        known = has_turn.copy()
        advantages, complete = np.zeros((rows, envs), np.float32), np.zeros((rows, envs), np.bool_)
        open_reward = np.zeros(envs, np.float32)
        for t in range(rows - 1, -1, -1):
            over = self.ended[t]
            value[over] = advantage[over] = reward[over] = 0.0
            known |= over
            reward += self.reward[t]
            acted = self.acted[t]
            found = reward + gamma * value - self.value[t] + gamma * gae_lambda * advantage
            complete[t] = acted & known
            advantages[t] = np.where(known, found, 0.0)
            open_reward = np.where(acted & ~known, reward, open_reward)
            value = np.where(acted, self.value[t], value)
            advantage = np.where(acted, advantages[t], advantage)
            reward = np.where(acted, 0.0, reward)
            known |= acted
        batch: dict[str, Arrays | None] = {
            "observed": self.observed[complete],
            "mask": None if self.mask is None else self.mask[complete],
            "action": self.action[complete],
            "log_probability": self.log_probability[complete],
            "advantage": advantages[complete],
            "target": advantages[complete] + self.value[complete],
        }
        batch["seen"] = batch["observed"] if self.shared else self.seen[complete]
        self._carry(self.acted & ~complete, open_reward)
        return batch

    def _carry(self, waiting: BoolArray, reward: Arrays) -> None:
        """Move turns that wait for their next one to row 0; forget the rest."""
        t, n = np.nonzero(waiting)
        for array in self.arrays().values():
            kept = array[t, n]
            if array.dtype == np.bool_ and array.ndim == 2:
                array[:] = False
            array[0, n] = kept
        self.reward[:] = 0.0
        self.reward[0] = np.where(waiting.any(axis=0), reward, 0.0)


class PPOTeam:
    """Roles that learn together in a batch of laboratories; a policy by name plays the others.

    Args:
        scenario: the laboratory.
        roles: who learns: ``manager`` or benches' keys.
        settings: arguments of the run.
        background: policy of the roles that do not learn.

    Attributes:
        turns: by role, how many turns there have been.
        scores: of the episodes that ended since they were taken.
    """

    def __init__(self, scenario: Scenario, roles: Sequence[str], settings: LeanPPO, background: str) -> None:
        self.settings, seed = settings, settings.seed
        torch.manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        full = Laboratories(scenario, 1)
        seen_by_all = compact(scenario) if MANAGER_ROLE in roles else scenario
        self.batch = BatchedLaboratory(settings.envs, seen_by_all, copy=False, split=settings.split)
        self.labs = labs = self.batch.laboratories
        self.agents = self.batch.possible_agents
        self.learners: dict[str, _Learner] = {}
        self._background: dict[str, Policy] = {}
        self._tracks: dict[str, _Track] = {}
        state = self.batch.state_space.shape[0] if settings.central_critic else 0
        # Where a bench earns by its own experiments alone, its episode is the experiment.
        self._own_episodes = labs.scenario.rewards.bench_team == 0.0
        for number, agent in enumerate(self.agents):
            role, space = role_of(agent), self.batch.action_space(agent)
            if role not in roles:
                self._background[agent] = agent_policy(background, labs, number, seed)
                continue
            count = labs.action_counts[number]
            if role not in self.learners:
                whole = full.observation_sizes[number]
                columns = _columns(full.roles[number].channels, labs.roles[number].channels)
                size = count or int(space.shape[0])  # type: ignore[index]
                network = _Network(len(columns), state, size, bool(count), settings.net_arch)
                if role == MANAGER_ROLE and settings.balanced:
                    _balance(network, labs.actions.table[:, 0])
                gamma = settings.manager_gamma if role == MANAGER_ROLE else settings.gamma
                self.learners[role] = _Learner(columns, whole, network, settings, gamma)
            seen = len(self.learners[role].columns)
            self._tracks[agent] = _Track(
                settings.rollout, settings.envs, seen, seen + state, () if count else tuple(space.shape or ()), count
            )
        self.turns = dict.fromkeys(self.learners, 0)
        self.scores: list[float] = []
        self._observed, self._infos = self.batch.reset(seed=seed)

    def collect(self, remaining: float) -> None:
        """Play a rollout."""
        for t in range(1, self.settings.rollout + 1):
            actions = {
                agent: action for agent in self.agents if (action := self._chosen(agent, t, remaining)) is not None
            }
            self._observed, rewards, over, _, self._infos = self.batch.step(actions)
            score = self._infos["manager_0"]["score"]
            self.scores += score[over].tolist()
            for agent, track in self._tracks.items():
                track.reward[t] = rewards[agent]
                track.ended[t] = over
                if role_of(agent) != MANAGER_ROLE and self._own_episodes:
                    track.ended[t] |= self._infos[agent]["experiment_over"]
                elif role_of(agent) == MANAGER_ROLE and over.any():
                    refund = max(1.0 - (1.0 - remaining) / self.settings.refund, 0.0) if self.settings.refund else 0.0
                    track.reward[t, over] += refund * np.maximum(-score[over], 0.0)

    def _chosen(self, agent: str, t: int, remaining: float) -> Arrays | None:
        """Actions [N] of an agent in round ``t``; None if it has the turn nowhere."""
        info = self._infos[agent]
        rows = np.flatnonzero(info["has_turn"])
        if not len(rows):
            return None
        number = self.agents.index(agent)
        mask = None if "action_mask" not in info else info["action_mask"][rows]
        if agent in self._background:
            played = self._background[agent].act(
                self._observed[agent][rows], mask, self.labs.turns_had(number)[rows], rows
            )
        else:
            learner, track = self.learners[role_of(agent)], self._tracks[agent]
            self.turns[role_of(agent)] += len(rows)
            observed = self._observed[agent][rows]
            allowed = None if mask is None else mask.astype(np.bool_)
            if role_of(agent) == MANAGER_ROLE and allowed is not None:
                allowed = self._helped(allowed, rows, 1.0 - remaining < self.settings.processed)
            played, log_probability = learner.act(observed, allowed)
            track.acted[t, rows] = True
            track.observed[t, rows], track.action[t, rows] = observed, played
            track.log_probability[t, rows] = log_probability
            if track.mask is not None:
                track.mask[t, rows] = allowed
            if not track.shared:
                track.seen[t, rows] = np.concatenate([observed, self.batch.state(rows)], axis=1)
            track.value[t, rows] = learner.value(track.seen[t, rows])
        space = self.batch.action_space(agent)
        out = np.zeros((self.settings.envs, *(space.shape or ())), dtype=played.dtype)
        out[rows] = played if played.dtype.kind == "i" else np.clip(played, space.low, space.high)  # type: ignore[attr-defined]
        return out

    def _helped(self, mask: BoolArray, rows: IntArray, processed: bool) -> BoolArray:
        """The manager's mask with the help that is given; the mask itself where that would leave nothing."""
        table, state = self.labs.actions.table, self.labs.state
        kinds, helped = table[:, 0], mask.copy()
        if self.settings.own_goals:
            starts = np.flatnonzero(kinds == START)
            wanted = (table[starts, 3][None, :, None] == state.goal[rows][:, None, :]).any(axis=2)
            helped[:, starts] &= wanted
        if processed:
            submits = np.flatnonzero(kinds == SUBMIT)
            helped[:, submits] &= state.last_bench[rows][:, table[submits, 1]] > 0
            helped[:, kinds == DISCARD] = False
        empty = ~helped.any(axis=1)
        helped[empty] = mask[empty]
        return helped

    def update(self, remaining: float) -> int:
        """Learn from the turns that are complete; return how many they were."""
        batches: dict[str, list[dict[str, Arrays | None]]] = {role: [] for role in self.learners}
        for agent, track in self._tracks.items():
            learner = self.learners[role_of(agent)]
            turn = self._infos[agent]["has_turn"]
            rows, value = np.flatnonzero(turn), np.zeros(self.settings.envs, dtype=np.float32)
            if len(rows):
                seen = self._observed[agent][rows]
                if not track.shared:
                    seen = np.concatenate([seen, self.batch.state(rows)], axis=1)
                value[rows] = learner.value(seen)
            found = track.finished(value, turn.astype(np.bool_), learner.gamma, self.settings.gae_lambda)
            batches[role_of(agent)].append(found)
        learned = 0
        for role, parts in batches.items():
            whole = {
                name: None if parts[0][name] is None else np.concatenate([part[name] for part in parts])
                for name in parts[0]
            }
            count = len(whole["advantage"])  # type: ignore[arg-type]
            if count > 1:
                self.learners[role].update(whole, remaining, self.rng)
            learned += count
        return learned

    def weights(self, role: str) -> dict[str, Arrays]:
        """Weights of a role's actor over the whole observation: ``{i}.weight`` [out, in] and ``{i}.bias`` [out]."""
        learner = self.learners[role]
        linear = [layer for layer in learner.network.actor if isinstance(layer, nn.Linear)]
        found: dict[str, Arrays] = {}
        for i, layer in enumerate(linear):
            weight = layer.weight.detach().numpy()
            if i == 0:
                whole = np.zeros((len(weight), learner.size), dtype=np.float32)
                whole[:, learner.columns] = weight
                weight = whole
            found[f"{i}.weight"], found[f"{i}.bias"] = weight.copy(), layer.bias.detach().numpy().copy()
        if not learner.network.discrete:
            found[LOG_STD] = learner.network.log_std.detach().numpy().copy()
        return found


class FromNothing(Team):
    """A run of :class:`PPOTeam`: its evaluations, checkpoints and exported policies."""

    def check(self) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`: there is nothing to check."""

    def begin(self, run: Run) -> Progress:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        last = run.checkpoint("last")
        if last is None:
            self.team = PPOTeam(self.scenario, self.learning, self.arguments, self._background)
            return Progress()
        state = load_state(last)
        self.team = state["team"]
        restore_random_state(state)
        return Progress.of(state["progress"], last)

    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        remaining = 1.0 - progress.step / self.steps
        self.team.collect(remaining)
        turns = max(self.team.update(remaining), 1)
        scores, self.team.scores = self.team.scores, []
        for role, had in self.team.turns.items():
            self.logger.record(f"turns/{role}", had)
        return turns, scores

    def scores(self, episodes: int, seed: int, sampled: bool) -> dict[str, float]:
        """See :class:`~chemlab.agents.train.loop.Trainee`: scores of the laboratory."""
        learned = self._taken or {role: self._policy(role, 0, None) for role in self.learning}
        way = SAMPLED if sampled else GREEDY
        seeds = np.random.SeedSequence(seed).spawn(len(learned))
        played = {role: policy.played(way, own) for (role, policy), own in zip(learned.items(), seeds, strict=True)}
        return self._played(played, episodes, seed)

    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        save_state(folder, {"team": self.team, **random_state(), "progress": vars(progress)})
        for role in self.learning:
            policy = self._policy(role, progress.step, evaluation)
            save_policy(folder / role, policy.card, policy.weights)

    def _policy(self, role: str, step: int, evaluation: Evaluation | None) -> PretrainedPolicy:
        """Return the policy of a role for the whole scenario."""
        config, manager = self.config, role == MANAGER_ROLE
        card = Card.of(
            self._workplaces[role],
            name=role,
            **{name: getattr(config, name) for name in ("env_id", "algo", "label", "seed", "versions")},
            goals=list(self.scenario.lab_goals) if manager else goals_met(self.scenario, role),
            starts="lab",
            step=step,
            command=self.arguments.command_line(),
            activation="tanh",
            output="argmax" if self.team.learners[role].network.discrete else "clip",
            evaluation=reached(self.arguments, evaluation),
            background=self._background,
            sampled=evaluation is not None and evaluation.sampled,
        )
        return PretrainedPolicy(card, self.team.weights(role))


def _balance(network: _Network, kinds: IntArray) -> None:
    """Set the last biases so that every kind of action is drawn equally often at first."""
    counts = np.bincount(kinds, minlength=len(KINDS))
    with torch.no_grad():
        network.actor[-1].bias.copy_(torch.from_numpy(-np.log(counts[kinds]).astype(np.float32)))  # type: ignore[operator]
