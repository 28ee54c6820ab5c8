"""Train several roles of a laboratory together on Stable-Baselines3: a learner for each, one batch of laboratories.

Heterogeneous spaces are no matter: agents of one kind share a learner, PPO where actions are continuous and MaskablePPO
where they are discrete. Experience is collected turn by turn (:mod:`chemlab.agents.training.experience`), so that every
role's reward, elapsed time and episodes are its own.

Two regimes: ``together`` (all learners are updated after every rollout) and ``in-turns`` (round-robin: one role learns
for a while, the others play as they are).

Needs the extra: ``pip install "chemlab-marl[train]"``.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.arrays import IntArray, MaskArray, ObservationArray
from chemlab.laboratory.core import Laboratories
from chemlab.laboratory.policy import play_pass
from chemlab.laboratory.state import RUNNING
from chemlab.scenario import load_scenario

from ..evaluation.play import play_laboratory
from ..policy import Policy, agent_policy
from ..pretrained import fingerprint
from ..roles import MANAGER_ROLE, chosen_roles, role_of
from .arguments import JointArguments
from .experience import Experience
from .runs import Evaluation, Run, RunConfig, RunResult

try:
    import torch
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.buffers import MaskableRolloutBuffer
    from stable_baselines3 import PPO
    from stable_baselines3.common.buffers import RolloutBuffer
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import VecEnv

    from .checkpoints import random_state, restore_random_state
    from .learn import LearnerPolicy, Watcher, load_learner, open_run, versions
    from .rounds import fresh_memory, train_in_rounds
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install "chemlab-marl[train]"') from error

__all__ = ["JointArguments", "load_team", "train_together"]


class _Spaces(VecEnv):
    """What a learner needs to know of an environment: its spaces. Experience comes from elsewhere."""

    def __init__(self, observation_space: gymnasium.Space[Any], action_space: gymnasium.Space[Any]) -> None:
        super().__init__(1, observation_space, action_space)

    def reset(self) -> Any:
        raise NotImplementedError("experience is collected by the laboratory")

    def step_async(self, actions: Any) -> None:
        raise NotImplementedError("experience is collected by the laboratory")

    def step_wait(self) -> Any:
        raise NotImplementedError("experience is collected by the laboratory")

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        if attr_name == "render_mode":
            return [None]
        raise AttributeError(attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise AttributeError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise AttributeError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False]


class _Learner:
    """One role's learner, and the experience it learns from."""

    def __init__(self, model: Any, space: gymnasium.spaces.Box, actions: gymnasium.Space[Any], streams: int) -> None:
        self.model = model
        self.experience = Experience(space, actions, streams)
        self._low = actions.low if isinstance(actions, gymnasium.spaces.Box) else None
        self._high = actions.high if isinstance(actions, gymnasium.spaces.Box) else None

    def sample(
        self, observation: ObservationArray, mask: MaskArray | None
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
        """(action as drawn, action as played, value, log-probability) of a batch."""
        masks = {} if mask is None else {"action_masks": mask.astype(np.bool_)}
        with torch.no_grad():
            seen, _ = self.model.policy.obs_to_tensor(observation)
            drawn, value, log_probability = self.model.policy(seen, **masks)
        action = drawn.numpy()
        played = action if self._low is None else np.clip(action, self._low, self._high)
        return action, played, value.numpy()[:, 0], log_probability.numpy()

    def update(self, gamma: float, gae_lambda: float, by_ticks: bool, remaining: float) -> int:
        """Learn from what is complete, and forget it; returns the number of transitions."""
        model, experience = self.model, self.experience
        rows = experience.finished()
        if len(rows) < 2:  # advantages are normalized, which takes two
            return 0
        advantages = experience.advantages(gamma, gae_lambda, by_ticks)[rows]
        if len(rows) % model.batch_size == 1:  # and so does that of a minibatch
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
    """A learner as the policy of one agent: it explores, and its turns become experience."""

    def __init__(self, learner: _Learner, stream: Callable[[IntArray], IntArray], ticks: IntArray) -> None:
        self._learner, self._stream, self._ticks = learner, stream, ticks

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.laboratory.policy.Policy`."""
        drawn, played, value, log_probability = self._learner.sample(observation, mask)
        self._learner.experience.begin(
            self._stream(members), observation, mask, drawn, value, log_probability, self._ticks[members]
        )
        return played


class _Team:
    """All roles in one batch of laboratories: who learns, who plays, and what comes of it."""

    models = "*.zip"

    def __init__(self, arguments: JointArguments) -> None:
        a = self.arguments = arguments
        scenario = load_scenario(a.scenario)
        self.scenario = scenario if a.rewards is None else scenario.with_rewards(a.rewards)
        self.labs = labs = Laboratories(self.scenario, a.envs)
        # A share of the laboratory's result comes long after the experiment: then an episode is the laboratory's.
        self._shared = self.scenario.rewards.bench_team > 0.0
        self.roles = chosen_roles(labs, None)
        self.learning = chosen_roles(labs, a.roles)
        self.learners: dict[str, _Learner] = {}
        for role in self.learning:
            number = next(i for i, agent in enumerate(labs.agents) if role_of(agent) == role)
            alike = sum(role_of(agent) == role for agent in labs.agents)
            spaces = labs.observation_space(number), labs.action_space(number)
            self.learners[role] = _Learner(self._model(role, *spaces), *spaces, alike * a.envs)
        self.returns: list[float] = []
        seeds = np.random.SeedSequence(a.seed).generate_state(a.envs, np.uint64)
        for member, seed in zip(labs.members, seeds, strict=True):
            labs.seed(int(member), int(seed))
        labs.reset(labs.members)
        self._policies: list[Policy | None] = [self._player(number) for number in range(len(labs.agents))]

    def _model(self, role: str, space: gymnasium.Space[Any], actions: gymnasium.Space[Any]) -> Any:
        a = self.arguments
        discrete = isinstance(actions, gymnasium.spaces.Discrete)
        settings: dict[str, Any] = {
            "learning_rate": a.learning_rate,
            "n_steps": a.batch_size,  # a buffer is made for every update; this only fits the minibatches
            "batch_size": a.batch_size,
            "n_epochs": a.epochs,
            "ent_coef": a.ent_coef if discrete else 0.0,
            "gamma": a.manager_gamma if role == MANAGER_ROLE else a.gamma,
            "gae_lambda": a.gae_lambda,
            "seed": a.seed,
            "device": "cpu",
        }
        model: Any = (MaskablePPO if discrete else PPO)("MlpPolicy", _Spaces(space, actions), **settings)
        model.set_logger(Logger(None, []))
        return model

    def _stream(self, number: int) -> Callable[[IntArray], IntArray]:
        """Which stream of its role's experience an agent's laboratories are."""
        agents = self.labs.agents
        place = sum(role_of(agent) == role_of(agents[number]) for agent in agents[:number])
        return lambda members: place * self.arguments.envs + members

    def _player(self, number: int) -> Policy:
        role = role_of(self.labs.agents[number])
        if role in self.learners:
            return _Acting(self.learners[role], self._stream(number), self.labs.desk.ticks)
        return agent_policy(self.arguments.background, self.labs, number, self.arguments.seed)

    def collect(self) -> None:
        """One rollout: every laboratory plays ``rollout`` rounds, and begins anew where its episode ends."""
        labs = self.labs
        for _ in range(self.arguments.rollout):
            play_pass(labs, self._policies, labs.members, self._after)
            over = labs.members[labs.desk.status != RUNNING]
            if len(over):
                self.returns += labs.result(over).tolist()
                labs.reset(over)

    def _after(self, number: int, members: IntArray) -> None:
        """Everybody's share of a turn; experiments and episodes that it ended."""
        labs = self.labs
        status = labs.desk.status[members]
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
                experience.end(streams[ended], labs.desk.ticks[members[ended]])

    def update(self, learning: list[str], remaining: float) -> int:
        """Let some roles learn from the rollout; the others' experience of it is forgotten."""
        a, turns = self.arguments, 0
        for role, learner in self.learners.items():
            if role in learning:
                gamma = a.manager_gamma if role == MANAGER_ROLE else a.gamma
                turns += learner.update(gamma, a.gae_lambda, a.by_ticks, remaining)
            else:
                learner.experience.forget()
        return turns

    def learn(self, memory: dict[str, Any]) -> tuple[int, list[float]]:
        """See :class:`chemlab.agents.training.rounds.Team`."""
        a = self.arguments
        self.collect()
        at = memory["updates"] // a.period % len(self.learning)
        learning = self.learning if a.regime == "together" else [self.learning[at]]
        turns = max(self.update(learning, 1.0 - memory["step"] / a.steps), 1)
        returns, self.returns = self.returns, []
        return turns, returns

    def scores(self, episodes: int, seed: int, scripted: bool = False) -> dict[str, float]:
        """See :class:`chemlab.agents.training.rounds.Team`."""
        labs = Laboratories(self.scenario, episodes)
        policies: dict[str, Policy] = {}
        for number, agent in enumerate(labs.agents):
            learner = None if scripted else self.learners.get(role_of(agent))
            policies[agent] = (
                agent_policy(self.arguments.background, labs, number, seed)
                if learner is None
                else LearnerPolicy(learner.model)
            )
        return {
            goal: float(play_laboratory(labs, policies, goal, seed).returns.mean()) for goal in self.scenario.lab_goals
        }

    def save(self, folder: Path, memory: dict[str, Any], evaluation: Evaluation) -> None:
        """See :class:`chemlab.agents.training.rounds.Team`."""
        for role, learner in self.learners.items():
            learner.model.save(_file_of(folder, role, learner.model))
        state = {"team": self.get_state(), **random_state(), "progress": memory}
        (folder / "state.pkl").write_bytes(pickle.dumps(state))

    def take_best(self, folder: Path) -> None:
        """See :class:`chemlab.agents.training.rounds.Team`."""
        for role, model in load_team(folder).items():
            self.learners[role].model.policy.load_state_dict(model.policy.state_dict())

    def get_state(self) -> dict[str, Any]:
        """Everything that changes but the learners' networks."""
        memories = [getattr(policy, "get_memory", lambda: None)() for policy in self._policies]
        return {
            "laboratories": self.labs.snapshot(),
            "experience": {role: learner.experience.get_state() for role, learner in self.learners.items()},
            "memories": memories,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from a :meth:`get_state`."""
        self.labs.restore(state["laboratories"])
        for role, learner in self.learners.items():
            learner.experience.set_state(state["experience"][role])
        for policy, memory in zip(self._policies, state["memories"], strict=True):
            remind = getattr(policy, "set_memory", None)
            if remind is not None:
                remind(memory)


def load_team(folder: Path) -> dict[str, Any]:
    """The learners of a joint run's checkpoint, by role."""
    found = {}
    for file in sorted(folder.glob("*.zip")):
        kind = MaskablePPO if "maskable" in file.stem else PPO
        found[file.stem.partition(".")[0]] = kind.load(file, device="cpu")
    return found


def _file_of(folder: Path, role: str, model: Any) -> Path:
    return folder / (f"{role}.maskable.zip" if isinstance(model, MaskablePPO) else f"{role}.zip")


def train_together(arguments: JointArguments, out: Path, watcher: Watcher | None = None) -> RunResult:
    """Train, or go on training, or return the result of a run that is finished.

    Args:
        arguments: who learns what.
        out: the run's folder; what is in it is described in :mod:`chemlab.agents.training.runs`, and a checkpoint has
            a model for each role.
        watcher: is told how it goes.

    Raises:
        ValueError: the folder holds another run, another process trains it, or an argument is wrong.
        DataError: unknown scenario.
    """
    if arguments.regime not in ("together", "in-turns"):
        raise ValueError(f"regime: together or in-turns, given {arguments.regime!r}")
    torch.set_num_threads(1)
    run, team = Run(out), _Team(arguments)
    described = RunConfig(
        f"joint-{arguments.regime}",
        {**asdict(arguments), "algo": "joint", "env_id": "chemlab/Laboratory-v0"},
        arguments.scenario,
        ",".join(team.learning),
        list(team.scenario.lab_goals),
        fingerprint(team.labs.role(0)),
        versions(),
    )
    return open_run(run, described, asdict(JointArguments()), lambda: _train(run, arguments, team, watcher))


def _train(run: Run, arguments: JointArguments, team: _Team, watcher: Watcher | None) -> RunResult:
    memory, last = fresh_memory(), run.checkpoint("last")
    if last is not None:
        memory = _load(last, team)
    elif arguments.begin_from is not None:
        _begin_from(arguments.begin_from, team)
    return train_in_rounds(run, team, arguments, memory, (f"joint-{arguments.regime}", "joint"), watcher)


def _load(folder: Path, team: _Team) -> dict[str, Any]:
    """Put a team back as it was; returns what the loop had to remember."""
    # Only a run's own files are unpickled, as SB3 does with the models beside them.
    state = pickle.loads((folder / "state.pkl").read_bytes())
    for role, model in load_team(folder).items():
        _take_over(team.learners[role], model)
    team.set_state(state["team"])
    restore_random_state(state)
    return dict(state["progress"])


def _take_over(learner: _Learner, model: Any) -> None:
    """Go on with a saved model's networks and optimizer."""
    learner.model.policy.load_state_dict(model.policy.state_dict())
    learner.model.policy.optimizer.load_state_dict(model.policy.optimizer.state_dict())
    learner.model.num_timesteps = model.num_timesteps


def _begin_from(text: str, team: _Team) -> None:
    """Start from the best models of another joint run, or of single runs: in folders of the roles' names, or given as
    ``ROLE=FOLDER``, separated by commas."""
    pairs = [part.partition("=") for part in text.split(",")]
    named = {role: Path(folder) for role, equals, folder in pairs if equals}
    unknown = [role for role in named if role not in team.learners]
    if unknown:
        raise ValueError(f"begin_from: nobody called {', '.join(unknown)} learns; roles: {', '.join(team.learners)}")
    whole = None if named else Run(Path(text)).checkpoint("best")
    found = {} if whole is None else load_team(whole)
    for role, learner in team.learners.items():
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
        mine.policy.load_state_dict(model.policy.state_dict())
    if not found:
        raise ValueError(f"begin_from: {text}: holds neither a joint run nor runs of {', '.join(team.learners)}")
