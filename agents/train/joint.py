"""Train several roles of a laboratory together on Stable-Baselines3: a learner for each, one batch of laboratories.

Spaces may differ: agents of one kind share a learner, PPO for continuous actions and MaskablePPO for discrete ones.
Experience is collected turn by turn (:mod:`chemlab.agents.train.experience`), so that every role has its own rewards,
elapsed time and episodes.

Two regimes: ``together`` (all learners are updated after every rollout) and ``in-turns`` (round-robin: one role learns
for a while, the others are fixed).

Critics observe the agent's observation (IPPO), or the laboratory's true state as well (MAPPO); actors never do.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.config.loading import load_scenario
from chemlab.envs.global_state import GlobalState
from chemlab.envs.players import Players, as_policy
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import goals_met
from chemlab.roles.manager_state import RUNNING

from ..advice import Advisor
from ..episodes import play_laboratory
from ..policies import Policy, agent_policy
from ..pretrained import PretrainedPolicy, load_pretrained
from ..roles import MANAGER_ROLE, chosen_roles, role_of
from ..runs import Evaluation, Run
from .arguments import IPPO, MAPPO, LeanPPO
from .experience import Experience

try:
    import torch
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.buffers import MaskableRolloutBuffer
    from stable_baselines3 import PPO
    from stable_baselines3.common.buffers import RolloutBuffer
    from stable_baselines3.common.logger import Logger

    from ..centralised import CentralisedPolicy, MaskableCentralisedPolicy
    from ..learners import load_learner, load_team, save_team
    from .checkpoints import load_state, random_state, restore_random_state, save_state
    from .imitate import fit
    from .loop import Progress, Trainee, reached
    from .networks import save_learned
    from .tasks import rewarded, task_fingerprint
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install ".[train]"') from error

__all__ = ["Team"]


class _Learner:
    """The learner of one role with its experience."""

    def __init__(self, model: Any, space: gymnasium.spaces.Box, actions: gymnasium.Space[Any], streams: int) -> None:
        self.model = model
        self.experience = Experience(space, actions, streams)
        self._low = actions.low if isinstance(actions, gymnasium.spaces.Box) else None
        self._high = actions.high if isinstance(actions, gymnasium.spaces.Box) else None

    def sample(
        self, observation: ObservationArray, mask: MaskArray | None
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
        """Return (sampled action, played action, value, log-probability) of a batch."""
        masks = {} if mask is None else {"action_masks": mask.astype(np.bool_)}
        with torch.no_grad():
            seen, _ = self.model.policy.obs_to_tensor(observation)
            drawn, value, log_probability = self.model.policy(seen, **masks)
        action = drawn.numpy()
        played = action if self._low is None else np.clip(action, self._low, self._high)
        return action, played, value.numpy()[:, 0], log_probability.numpy()

    def update(self, gamma: float, gae_lambda: float, by_ticks: bool, remaining: float) -> int:
        """Learn from complete transitions and drop them; return their number."""
        model, experience = self.model, self.experience
        rows = experience.finished()
        if len(rows) < 2:  # advantages are normalized, which requires two
            return 0
        advantages = experience.advantages(gamma, gae_lambda, by_ticks)[rows]
        if len(rows) % model.batch_size == 1:  # the same holds for a minibatch
            rows, advantages = rows[:-1], advantages[:-1]
        masked = isinstance(model, MaskablePPO)
        kind = MaskableRolloutBuffer if masked else RolloutBuffer
        buffer: Any = kind(len(rows), model.observation_space, model.action_space, "cpu", gae_lambda, gamma, n_envs=1)
        buffer.observations[:, 0] = experience.observation[rows]
        buffer.actions[:, 0] = experience.action[rows].reshape(len(rows), -1)
        buffer.rewards[:, 0] = experience.reward[rows]
        buffer.values[:, 0] = experience.value[rows]
        buffer.log_probs[:, 0] = experience.log_probability[rows]
        buffer.advantages[:, 0] = advantages
        buffer.returns[:, 0] = advantages + experience.value[rows]
        if masked:
            buffer.action_masks[:, 0] = experience.mask[rows]
        buffer.pos, buffer.full = len(rows), True
        model.rollout_buffer = buffer
        model.num_timesteps += len(rows)
        model._current_progress_remaining = remaining
        model.train()
        experience.forget()
        return len(rows)


class _Acting:
    """A learner as the exploring policy of one agent, whose turns become experience.

    If ``shown`` is given, its actions become experience and are played, or those of ``tried`` are played if that is
    given as well. If ``whole`` is given, the learner's critic observes it as well.
    """

    def __init__(
        self,
        learner: _Learner,
        stream: Callable[[IntArray], IntArray],
        ticks: IntArray,
        whole: GlobalState | None = None,
        shown: Advisor | None = None,
        tried: Policy | None = None,
    ) -> None:
        self._learner, self._stream, self._ticks, self._whole = learner, stream, ticks, whole
        self._shown, self._tried = shown, tried

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        seen = observation
        if self._whole is not None:
            seen = np.concatenate([observation, self._whole.see(members)], axis=1)
        if self._shown is None:
            drawn, played, value, log_probability = self._learner.sample(seen, mask)
        else:
            drawn = played = self._shown.advice(observation, mask, step, members)
            if self._tried is not None:
                played = self._tried.act(observation, mask, step, members)
            self._shown.played(played, members)
            value = log_probability = np.zeros(len(members))
        self._learner.experience.begin(
            self._stream(members), seen, mask, drawn, value, log_probability, self._ticks[members]
        )
        return played


class Team(Trainee):
    """Roles of a laboratory in one batch of laboratories; a policy by name plays the others.

    Raises:
        DataError: the scenario is unknown.
        ValueError: a role or reward mix is unknown, or the background policies do not fit.
    """

    arguments: Any

    def __init__(self, arguments: IPPO | LeanPPO) -> None:
        a = self.arguments = arguments
        self.steps, self._background = a.steps, a.background or "scripted"
        self.scenario = rewarded(a.scenario, a.rewards)
        labs = Laboratories(load_scenario(a.scenario), 1)
        # A run may use another reward mix than the scenario: the task is the same.
        self._workplaces = {role_of(role.name): role.workplace for role in reversed(labs.roles)}
        labs = Laboratories(self.scenario, 1)
        self.learning = chosen_roles(labs, None if a.roles in (None, ("all",)) else a.roles)
        for number, agent in enumerate(labs.agents):
            if role_of(agent) not in self.learning:
                agent_policy(self._background, labs, number)
        roles, goals = ",".join(self.learning), list(self.scenario.lab_goals)
        self.config = self.described(a.scenario, roles, goals, task_fingerprint(a))
        self.config = self.config.model_copy(update={"background": self._background})
        self._taken: dict[str, PretrainedPolicy] | None = None

    def check(self) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        labs = Laboratories(self.scenario, 1)
        for number, agent in enumerate(labs.agents):
            if self.arguments.bc is not None and role_of(agent) in self.learning:
                agent_policy(self.arguments.bc, labs, number)
        if self.arguments.begin_from is not None:
            self.make()
            self._begin_from(self.arguments.begin_from)

    def begin(self, run: Run) -> Progress:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        a, last = self.arguments, run.checkpoint("last")
        self.make()
        if last is not None:
            return self._load(last)
        progress = Progress()
        if a.bc is not None:
            begun = time.perf_counter()
            self.imitate(a.bc, a.bc_steps, a.bc_rounds)
            progress.seconds = time.perf_counter() - begun
        if a.begin_from is not None:
            self._begin_from(a.begin_from)
        return progress

    def make(self) -> None:
        """Make the laboratories, and untrained learners."""
        a = self.arguments
        self.labs = labs = Laboratories(self.scenario, a.envs, split=a.split)
        # A share of the laboratory's result arrives long after the experiment: then an episode is the laboratory's.
        self._shared = self.scenario.rewards.bench_team > 0.0
        self._whole = GlobalState(labs) if isinstance(a, MAPPO) else None
        self.learners: dict[str, _Learner] = {}
        for role in self.learning:
            number = next(i for i, agent in enumerate(labs.agents) if role_of(agent) == role)
            alike = sum(role_of(agent) == role for agent in labs.agents)
            actions = labs.action_space(number)
            model = self._model(role, labs.observation_space(number), actions)
            self.learners[role] = _Learner(model, model.observation_space, actions, alike * a.envs)
        self.returns: list[float] = []
        seeds = np.random.SeedSequence(a.seed).generate_state(a.envs, np.uint64)
        for member, seed in zip(labs.members, seeds, strict=True):
            labs.seed(int(member), int(seed))
        self._begin_anew()

    def _model(self, role: str, space: gymnasium.spaces.Box, actions: gymnasium.Space[Any]) -> Any:
        a = self.arguments
        discrete = isinstance(actions, gymnasium.spaces.Discrete)
        settings: dict[str, Any] = {
            "learning_rate": a.learning_rate,
            "n_steps": a.batch_size,  # a buffer is made for every update; this only fits the minibatches
            "batch_size": a.batch_size,
            "n_epochs": a.epochs,
            "ent_coef": a.ent_coef if discrete else 0.0,
            "clip_range": a.clip_range,
            "gamma": a.manager_gamma if role == MANAGER_ROLE else a.gamma,
            "gae_lambda": a.gae_lambda,
            "seed": a.seed,
            "device": "cpu",
            "policy_kwargs": {"net_arch": list(a.net_arch)},
        }
        network: Any = "MlpPolicy"
        if self._whole is not None:
            network = MaskableCentralisedPolicy if discrete else CentralisedPolicy
            settings["policy_kwargs"]["own"] = space.shape[0]
            low, high = (
                np.append(*both) for both in ((space.low, self._whole.space.low), (space.high, self._whole.space.high))
            )
            space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        algorithm: Any = MaskablePPO if discrete else PPO
        model = algorithm(network, None, **settings, _init_setup_model=False)
        # Experience is collected by the laboratory, so the learner has spaces but no environment.
        model.observation_space, model.action_space, model.n_envs = space, actions, 1
        model._setup_model()
        model.set_logger(Logger(None, []))
        return model

    def _stream(self, number: int) -> Callable[[IntArray], IntArray]:
        """Return the function from an agent's laboratories to the streams of its role's experience."""
        agents = self.labs.agents
        place = sum(role_of(agent) == role_of(agents[number]) for agent in agents[:number])
        return lambda members: place * self.arguments.envs + members

    def _begin_anew(self, shown: str | None = None, tried: bool = False) -> None:
        """Start new episodes.

        Args:
            shown: None: the learners play and explore. Otherwise the policy of this name plays in their place.
            tried: the learners play without exploring, and that policy labels their turns.
        """
        for learner in self.learners.values():
            learner.experience.abandon()
        self.labs.reset(self.labs.members)
        self._ended = np.zeros(len(self.labs.members), dtype=np.bool_)
        """[N] laboratories in which an episode has ended since"""
        self._players = Players(
            self.labs, [self._player(number, shown, tried) for number in range(len(self.labs.agents))]
        )

    def _player(self, number: int, shown: str | None, tried: bool) -> Policy:
        labs, seed, role = self.labs, self.arguments.seed, role_of(self.labs.agents[number])
        if role in self.learners:
            learner = self.learners[role]
            teacher = None if shown is None else Advisor(agent_policy(shown, labs, number, seed))
            own = as_policy(learner.model) if tried else None
            return _Acting(learner, self._stream(number), labs.state.ticks, self._whole, teacher, own)
        return agent_policy(self._background, labs, number, seed)

    def imitate(self, shown: str, turns: int, rounds: int = 1) -> dict[str, float]:
        """Clone a policy into every learner by playing its role in these laboratories, which then restart.

        Args:
            shown: name of the policy.
            turns: approximate number of turns per role; unfinished episodes are left out.
            rounds: number of rounds. After the first the learners play together, for as long as the policy did, and
                until an episode has ended in every laboratory, because mistakes make long episodes.

        Returns:
            Accuracy by role (see :func:`~.imitate.imitate`).
        """
        hit: dict[str, float] = {}
        first = 0
        for number in range(rounds):
            self._begin_anew(shown, tried=number > 0)
            collected = 0
            while collected < first or not (self._ended.all() if number else self._fewest_turns() >= turns / rounds):
                self.collect()
                collected += 1
            first = first or collected
            hit = {role: self._clone(learner) for role, learner in self.learners.items()}
        for learner in self.learners.values():
            model = learner.model
            learner.experience = Experience(model.observation_space, model.action_space, learner.experience.streams)
        self.returns = []
        self._begin_anew()
        return hit

    def _fewest_turns(self) -> int:
        """Return the number of turns in finished episodes of the role with the fewest."""
        return min(len(learner.experience.whole()) for learner in self.learners.values())

    def _clone(self, learner: _Learner) -> float:
        """Fit a learner to its experience; see :func:`~.imitate.fit`."""
        model, e, a = learner.model, learner.experience, self.arguments
        rows = e.whole()
        returns = e.advantages(model.gamma, 1.0, a.by_ticks)[rows].astype(np.float32)  # of values that are zero
        masks = e.mask[rows] if isinstance(model, MaskablePPO) else None
        actions = e.action[rows].astype(np.int64 if masks is not None else np.float32)
        return fit(model, e.observation[rows], masks, actions, returns, a.seed, spread=a.bc_std)

    def collect(self) -> None:
        """Play one rollout: every laboratory plays ``rollout`` rounds, with new episodes when one ends."""
        labs = self.labs
        for _ in range(self.arguments.rollout):
            self._players.play_pass(labs.members, self._after)
            over = labs.members[labs.state.status != RUNNING]
            if len(over):
                self.returns += labs.result(over).tolist()
                self._ended[over] = True
                labs.reset(over)

    def _after(self, number: int, members: IntArray) -> None:
        """Record the rewards of a turn, and the experiments and episodes that it ended."""
        labs = self.labs
        status = labs.state.status[members]
        for other, agent in enumerate(labs.agents):
            learner = self.learners.get(role_of(agent))
            if learner is None:
                continue
            streams, experience = self._stream(other)(members), learner.experience
            experience.earn(streams, labs.rewards[members, other])
            ended = status != RUNNING
            if other > 0 and not self._shared:
                ended |= np.isfinite(labs.scores[members, other])
            if ended.any():
                experience.end(streams[ended], labs.state.ticks[members[ended]])

    def update(self, learning: list[str], remaining: float) -> int:
        """Update some roles from the rollout; the other roles' experience is dropped."""
        a, turns = self.arguments, 0
        for role, learner in self.learners.items():
            if role in learning:
                gamma = a.manager_gamma if role == MANAGER_ROLE else a.gamma
                turns += learner.update(gamma, a.gae_lambda, a.by_ticks, remaining)
            else:
                learner.experience.forget()
        return turns

    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        a = self.arguments
        self.collect()
        at = progress.rounds // a.period % len(self.learning)
        learning = self.learning if a.regime == "together" else [self.learning[at]]
        turns = max(self.update(learning, 1.0 - progress.step / a.steps), 1)
        returns, self.returns = self.returns, []
        return turns, returns

    def scores(self, episodes: int, seed: int, sampled: bool) -> dict[str, float]:
        """See :class:`~chemlab.agents.train.loop.Trainee`: scores of the laboratory."""
        own = {role: as_policy(learner.model) for role, learner in self.learners.items()}
        return self._played(self._taken or own, episodes, seed)

    def scripted(self, episodes: int, seed: int) -> dict[str, float]:
        """See :class:`~chemlab.agents.train.loop.Trainee`: the background plays every role."""
        return self._played({}, episodes, seed)

    def _played(self, learned: Mapping[str, Policy], episodes: int, seed: int) -> dict[str, float]:
        labs = Laboratories(self.scenario, episodes, split=self.arguments.evaluation_split)
        policies = {
            agent: learned.get(role_of(agent)) or agent_policy(self._background, labs, number, seed)
            for number, agent in enumerate(labs.agents)
        }
        return {
            goal: float(play_laboratory(labs, policies, goal, seed).returns.mean()) for goal in self.scenario.lab_goals
        }

    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        save_team(folder, {role: learner.model for role, learner in self.learners.items()})
        save_state(folder, {"team": self.get_state(), **random_state(), "progress": vars(progress)})
        for agent in self.labs.agents:
            role = role_of(agent)
            if role in self.learners and not (folder / f"{role}.json").exists():
                save_learned(
                    folder,
                    self.learners[role].model,
                    self._workplaces[role],
                    self.config,
                    goals=list(self.scenario.lab_goals if role == MANAGER_ROLE else goals_met(self.scenario, role)),
                    starts="lab",
                    step=progress.step,
                    command=self.arguments.command_line(),
                    evaluation=reached(self.arguments, evaluation),
                    background=self._background,
                )

    def _load(self, folder: Path) -> Progress:
        """Resume from a checkpoint."""
        state = load_state(folder)
        for role, model in load_team(folder).items():
            mine = self.learners[role].model
            mine.policy.load_state_dict(model.policy.state_dict())
            mine.policy.optimizer.load_state_dict(model.policy.optimizer.state_dict())
            mine.num_timesteps = model.num_timesteps
        self.set_state(state["team"])
        restore_random_state(state)
        return Progress.of(state["progress"], folder)

    def take(self, folder: Path) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        self._taken = {role: load_pretrained(folder / role) for role in self.learning}

    def close(self) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`: there is nothing to release."""

    def get_state(self) -> dict[str, Any]:
        """Return everything that changes except the learners' networks."""
        return {
            "laboratories": self.labs.snapshot(),
            "experience": {role: learner.experience.get_state() for role, learner in self.learners.items()},
            "memories": self._players.get_memory(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a :meth:`get_state`."""
        self.labs.restore(state["laboratories"])
        for role, learner in self.learners.items():
            learner.experience.set_state(state["experience"][role])
        self._players.set_memory(state["memories"])

    def _begin_from(self, text: str) -> None:
        """Start from the best models of another run of several roles, or of single-role runs.

        The text names a folder with folders of the roles' names, or ``ROLE=FOLDER``, separated by commas.
        """
        pairs = [part.partition("=") for part in text.split(",")]
        named = {role: Path(folder) for role, equals, folder in pairs if equals}
        unknown = [role for role in named if role not in self.learners]
        if unknown:
            raise ValueError(
                f"begin_from: nobody called {', '.join(unknown)} learns; roles: {', '.join(self.learners)}"
            )
        whole = None if named else Run(Path(text)).checkpoint("best")
        found = {} if whole is None else load_team(whole)
        for role, learner in self.learners.items():
            if role not in found:
                single = Run(named[role] if role in named else Path(text) / role)
                best, config = single.checkpoint("best"), single.config()
                if best is None or config is None:
                    if role in named:
                        raise ValueError(f"begin_from: {single.path}: holds no training run with a checkpoint")
                    continue
                found[role] = load_learner(best, str(config["algo"]))
            model, mine = found[role], learner.model
            if (model.observation_space, model.action_space) != (mine.observation_space, mine.action_space):
                raise ValueError(f"begin_from: {text}: {role} was trained for other spaces ({model.observation_space})")
            learned, own = model.policy.state_dict(), mine.policy.state_dict()
            if {name.partition(".")[0] for name in learned} != {name.partition(".")[0] for name in own}:
                raise ValueError(f"begin_from: {text}: {role} was trained by an algorithm that has other networks")
            if {name: layer.shape for name, layer in learned.items()} != {
                name: layer.shape for name, layer in own.items()
            }:
                raise ValueError(f"begin_from: {text}: {role} has other hidden layers; give them with --net-arch")
            mine.policy.load_state_dict(learned)
        if not found:
            raise ValueError(
                f"begin_from: {text}: holds neither a run of several roles nor runs of {', '.join(self.learners)}"
            )
