"""Training of one agent, on a single bench or in a laboratory, with Stable-Baselines3 or sb3-contrib.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

import math
import time
import warnings
from pathlib import Path

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from chemlab.config.scenario import MANAGER_AGENT
from chemlab.envs.players import as_policy

from ..learners import LEARNERS
from ..pretrained import PretrainedPolicy, load_pretrained, save_policy
from ..recurrent import MaskedLstmPolicy
from ..runs import Evaluation, Run, training_seeds
from ..sb3 import ChemlabVecEnv
from .arguments import ALGORITHMS, SAC, TD3, OnPolicy, Recurrent, Replay, Single, Stage, curriculum_of
from .checkpoints import forget_replay, load_agent, save_agent
from .imitate import LEAST_STD, imitate
from .loop import Progress, Trainee, evaluation_fields
from .networks import card_of, learned_policy
from .tasks import find_task

_SETTINGS = {
    **{name: name for name in ("learning_rate", "gamma", "gae_lambda", "ent_coef", "clip_range", "batch_size")},
    **{name: name for name in ("gradient_steps", "buffer_size", "learning_starts")},
    "epochs": "n_epochs",
    "exploration_final": "exploration_final_eps",
}
"""Names of Stable-Baselines3's settings by argument."""


def _learner(arguments: Single, venv: ChemlabVecEnv, total: int) -> BaseAlgorithm:
    """Return an untrained learner for ``total`` training steps."""
    a = arguments
    settings = {setting: getattr(a, name) for name, setting in _SETTINGS.items() if hasattr(a, name)}
    settings["train_freq" if isinstance(a, Replay) else "n_steps"] = a.rollout
    settings["policy_kwargs"] = {"net_arch": list(a.net_arch)}
    if isinstance(a, Recurrent):
        settings["policy_kwargs"]["lstm_hidden_size"] = a.memory
    if hasattr(a, "exploration_steps"):
        settings |= {"exploration_fraction": min(1.0, a.exploration_steps / total), "exploration_initial_eps": 1.0}
    if isinstance(a, SAC) and a.ent_coef is None:
        settings["ent_coef"] = f"auto_{a.ent_coef_start}"
    if isinstance(a, TD3) and a.action_noise:
        size = venv.batch.single_action_space.shape or ()
        settings["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, a.action_noise))
    network = {"recurrent-ppo": "MlpLstmPolicy", "maskable-recurrent-ppo": MaskedLstmPolicy}.get(a.algo, "MlpPolicy")
    model: BaseAlgorithm = LEARNERS[a.algo](network, venv, seed=a.seed, device="cpu", **settings)
    return model


class _EpisodeReturns(BaseCallback):
    """Collects the returns of completed episodes, of a training run of ``total`` steps."""

    def __init__(self, total: int) -> None:
        super().__init__()
        self._total = total
        self.returns: list[float] = []

    def _on_training_start(self) -> None:
        # DQN's exploration schedule spans the whole run, but each call of learn() is for one rollout.
        self.model._total_timesteps = self._total

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self.returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return True


class Agent(Trainee):
    """A Stable-Baselines3 learner with its environments.

    Raises:
        ValueError: an argument does not fit the task.
        DataError: the scenario, bench, goal or kind of initial states is unknown.
    """

    arguments: Single
    model: BaseAlgorithm
    venv: ChemlabVecEnv

    def __init__(self, arguments: Single) -> None:
        a = self.arguments = arguments
        task = self._task = find_task(a)
        _check_algorithm(a.algo, discrete=bool(task.workplace.action_count))
        if isinstance(a, Recurrent) and task.background is not None and task.agent != MANAGER_AGENT:
            raise ValueError(
                f"algo: {a.algo}: the LSTM must be reset for each experiment, and {task.agent} has several in an "
                "episode; train the bench on its own (--bench), or the manager"
            )
        warning = task.warning()
        if warning is not None:
            warnings.warn(warning, stacklevel=4)
        self._rollout = a.envs * a.rollout
        self.steps = math.ceil(a.steps / self._rollout) * self._rollout
        self._stages = curriculum_of(a, tuple(task.scenario.benches))
        self._stage: Stage | None = None
        self._hints: str | None = getattr(a, "hints", None)
        self.has_policy = getattr(a, "cloned", None) is not None
        self._taken: PretrainedPolicy | None = None
        self.config = self.described(a.scenario, task.agent, list(task.goals), task.fingerprint)

    def check(self) -> None:
        bc = getattr(self.arguments, "bc", None)
        if bc is not None:
            self._task.policy(bc)
        if self._hints is not None:
            self._task.advisor(self._hints)
        if self._stages:  # otherwise a mistake in a later stage would end the run in the middle
            batch = self._task.batch(1)
            for stage in self._stages:
                self._task.prepare(batch, stage.shares)

    def begin(self, run: Run) -> Progress:
        self._run, a, task = run, self.arguments, self._task
        advisor = None if self._hints is None else task.advisor(self._hints, a.seed)
        self.venv = ChemlabVecEnv(task.batch(a.envs), show_masks=a.algo == "maskable-recurrent-ppo", advisor=advisor)
        last, progress = run.checkpoint("last"), Progress()
        if last is not None:
            self.model, saved = load_agent(run, last, a.algo, self.venv)
            progress = Progress.of(saved, last)
        else:
            forget_replay(run)
            self.model, begun = _learner(a, self.venv, self.steps), time.perf_counter()
            if isinstance(a, OnPolicy) and a.cloned is not None:
                batch, teacher = task.batch(a.envs), task.policy(a.cloned, a.seed)
                hinted, least_std = self._hints is not None, getattr(a, "bc_std", LEAST_STD)
                imitate(self.model, batch, teacher, a.bc_steps, a.seed, hinted, a.bc_rounds, least_std)
            progress.seconds = time.perf_counter() - begun
        if not progress.step:
            self.venv.seed(training_seeds(a.seed, a.envs))
        self._player = task.advised(as_policy(self.model), self._hints)
        return progress

    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """See :class:`~chemlab.agents.train.loop.Trainee`; initial states are those of the curriculum's stage.

        Raises:
            ArithmeticError: the network's weights or outputs are no longer finite.
        """
        stage = next((stage for stage in self._stages if progress.step < stage.until), None)
        if stage != self._stage:
            self._task.prepare(self.venv.batch, None if stage is None else stage.shares)
            self._stage = stage
        episodes, first = _EpisodeReturns(self.steps), not progress.step
        self.model.set_logger(self.logger)
        try:
            # The training loop writes the log between rounds.
            self.model.learn(self._rollout, episodes, log_interval=None, reset_num_timesteps=first)  # type: ignore[arg-type]
            diverged = any(not weights.isfinite().all() for weights in self.model.policy.parameters())
        except ValueError as error:  # PyTorch's own message contains whole tensors
            diverged = "Expected parameter" in str(error)
            if not diverged:
                raise
        if diverged:
            raise ArithmeticError("training diverged; give a lower learning_rate, and another --out")
        return self._rollout, episodes.returns

    def scores(self, episodes: int, seed: int, sampled: bool) -> dict[str, float]:
        if self._taken is None and not sampled:
            player = self._player
        else:
            player = self._task.advised(self._taken or self._policy(0, None, sampled), self._hints)
        return self._task.by_goal(player, episodes, seed)

    def scripted(self, episodes: int, seed: int) -> dict[str, float] | None:
        return self._task.scripted(episodes, seed)

    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        save_agent(self._run, folder, self.model, self.venv, vars(progress))
        policy = self._policy(progress.step, evaluation, progress.sampled)
        save_policy(folder / policy.card.name, policy.card, policy.weights)

    def _policy(self, step: int, evaluation: Evaluation | None, sampled: bool) -> PretrainedPolicy:
        """Return the learner's policy with its card, to be sampled or greedy."""
        return learned_policy(
            self.model,
            self._task.workplace,
            **card_of(self.config, self._task.workplace),
            goals=list(self._task.goals),
            starts=self.arguments.starts,
            step=step,
            command=self.arguments.command_line(),
            evaluation=evaluation_fields(self.arguments, evaluation),
            background=self._task.background,
            advice=self._hints,
            sampled=sampled,
        )

    def take(self, folder: Path) -> None:
        self._taken = load_pretrained(folder / self._task.workplace.key)

    def close(self) -> None:
        self.venv.close()
        forget_replay(self._run)


def _check_algorithm(algo: str, discrete: bool) -> None:
    """Raise ValueError if an algorithm does not support discrete or continuous actions."""
    unfit = ("sac", "td3") if discrete else ("dqn", "qr-dqn", "maskable-ppo", "maskable-recurrent-ppo")
    if algo in unfit:
        fitting = ", ".join(name for name, kind in ALGORITHMS.items() if issubclass(kind, Single) and name not in unfit)
        kind = "discrete" if discrete else "continuous"
        advice = "" if discrete else f", or with --actions discrete {' or '.join(unfit)}"
        raise ValueError(f"algo: this bench's actions are {kind}: {fitting}{advice}; given {algo!r}")
