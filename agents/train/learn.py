"""Train an agent with Stable-Baselines3, so that a crash at any moment costs little and changes nothing.

>>> from pathlib import Path
>>> from chemlab.agents.train.arguments import TrainArguments
>>> from chemlab.agents.train.learn import train
>>> train(TrainArguments("chemlab/WurtzReaction-v0", steps=300_000), Path("runs/wurtz"))   # doctest: +SKIP

What a run writes is described in :mod:`chemlab.agents.runs`. A run that was killed goes on from its last
checkpoint: learner, optimizer, replay memory, environments and every random stream are there as they were, so that
what comes out is, bit for bit, what an uninterrupted run on the same machine would have come to.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

import math
import shutil
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.envs.players import as_policy
from chemlab.lab.engine import MANAGER_AGENT

from ..pretrained import load_pretrained
from ..runs import Evaluation, Run, RunConfig, RunResult
from .arguments import ALGORITHMS, RECURRENT, Stage, TrainArguments, curriculum_of, label_of, resolved
from .tasks import Task, find_task

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.noise import NormalActionNoise

    from ..learners import LEARNERS
    from ..recurrent import MaskedLstmPolicy
    from ..sb3 import ChemlabVecEnv
    from .checkpoints import load_agent, save_agent
    from .imitate import IMITATED, LEAST_SPREAD, imitate
    from .loop import Progress, Trainee, Watcher, open_run, reached, train_in_rounds, training_versions
    from .networks import save_learned
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install ".[train]"') from error

__all__ = ["train"]


def _learner(arguments: TrainArguments, venv: ChemlabVecEnv, total: int) -> BaseAlgorithm:
    """A fresh one. Fields that are None stay SB3's."""
    a = arguments
    optional: dict[str, Any] = {"learning_rate": a.learning_rate, "batch_size": a.batch_size, "ent_coef": a.ent_coef}
    settings: dict[str, Any] = {"gamma": a.gamma}
    layers = {} if a.net_arch is None else {"net_arch": list(a.net_arch)}
    settings["policy_kwargs"] = layers if a.memory is None else {**layers, "lstm_hidden_size": a.memory}
    if a.algo in ("ppo", "a2c", "maskable-ppo", *RECURRENT):
        settings["n_steps"] = a.rollout
        optional["gae_lambda"] = a.gae_lambda
        if a.algo != "a2c":
            settings |= {"n_epochs": a.epochs, "clip_range": a.clip_range}
    else:
        settings |= {"train_freq": a.rollout, "gradient_steps": a.gradient_steps}
        settings |= {"buffer_size": a.buffer_size, "learning_starts": a.learning_starts}
    if a.algo in ("dqn", "qr-dqn"):
        assert a.exploration_steps is not None, "resolved() fills it in"
        settings["exploration_fraction"] = min(1.0, a.exploration_steps / total)
        settings |= {"exploration_initial_eps": 1.0, "exploration_final_eps": a.exploration_final}
    if a.ent_coef_start is not None:
        settings["ent_coef"] = f"auto_{a.ent_coef_start}"
    if a.algo == "td3" and a.action_noise:
        size = venv.batch.single_action_space.shape or ()
        settings["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, a.action_noise))
    settings |= {name: value for name, value in optional.items() if value is not None}
    network = {"recurrent-ppo": "MlpLstmPolicy", "maskable-recurrent-ppo": MaskedLstmPolicy}.get(a.algo, "MlpPolicy")
    model: BaseAlgorithm = LEARNERS[a.algo](network, venv, seed=a.seed, device="cpu", **settings)
    return model


class _Ended(BaseCallback):
    """Keeps the returns of the episodes that end."""

    def __init__(self, total: int) -> None:
        super().__init__()
        self._total = total
        self.returns: list[float] = []

    def _on_training_start(self) -> None:
        # DQN's exploration falls over the whole run, of which SB3 is told one rollout at a time.
        self.model._total_timesteps = self._total

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self.returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return True


class _Agent(Trainee):
    """One agent: a learner of SB3's and its environments, as the run's last checkpoint has them or fresh ones."""

    def __init__(self, run: Run, arguments: TrainArguments, task: Task, config: RunConfig, command: str) -> None:
        a = self._arguments = arguments
        self._run, self._task, self._rollout = run, task, a.envs * a.rollout
        self._config, self._command = config, command
        self.steps = math.ceil(a.steps / self._rollout) * self._rollout
        advisor = None if a.advice is None else task.advisor(a.advice)
        self.venv = ChemlabVecEnv(task.batch(a.envs), show_masks=a.algo == "maskable-recurrent-ppo", advisor=advisor)
        self._stages = curriculum_of(a, tuple(task.scenario.benches))
        self._stage: Stage | None = None
        last, self.progress = run.checkpoint("last"), Progress()
        if last is not None:
            self.model, progress = load_agent(run, last, a.algo, self.venv)
            self.progress = Progress.of(progress, last)
        else:
            shutil.rmtree(run.checkpoints / "replay", ignore_errors=True)
            self.model = _learner(a, self.venv, self.steps)
            shown = a.imitate or a.advice
            if shown is not None:
                turns, begun = a.imitate_steps or IMITATED, time.perf_counter()
                rounds, spread = a.imitate_rounds or 1, a.imitate_spread or LEAST_SPREAD
                batch, teacher, advised = task.batch(a.envs), task.policy(shown), a.advice is not None
                imitate(self.model, batch, teacher, turns, a.seed, advised, rounds, spread)
                self.progress.seconds = time.perf_counter() - begun
        self._player = task.advised(as_policy(self.model), a.advice)

    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """See :class:`~chemlab.agents.train.loop.Trainee`; episodes begin as the curriculum says for this step."""
        stage = next((stage for stage in self._stages if progress.step < stage.until), None)
        if stage != self._stage:
            self._task.prepare(self.venv.batch, None if stage is None else stage.shares)
            self._stage = stage
        ended, first = _Ended(self.steps), not progress.step
        self.model.set_logger(self.logger)
        # The loop, between rounds, writes what is logged.
        self.model.learn(self._rollout, ended, log_interval=None, reset_num_timesteps=first)  # type: ignore[arg-type]
        return self._rollout, ended.returns

    def scores(self, episodes: int, seed: int) -> dict[str, float]:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        return self._task.by_goal(self._player, episodes, seed)

    def scripted(self, episodes: int, seed: int) -> dict[str, float] | None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        return self._task.scripted(episodes, seed)

    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        save_agent(self._run, folder, self.model, self.venv, vars(progress))
        save_learned(
            folder,
            self.model,
            self._task.workplace,
            self._config,
            goals=list(self._task.goals),
            starts=self._arguments.starts,
            step=progress.step,
            command=self._command,
            evaluation=reached(self._arguments, evaluation),
            background=self._task.background,
            advice=self._arguments.advice,
        )

    def take(self, folder: Path) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        learned = load_pretrained(folder / self._task.workplace.key)
        self._player = self._task.advised(learned, self._arguments.advice)


def _check_algorithm(algo: str, discrete: bool) -> None:
    other = ("sac", "td3") if discrete else ("dqn", "qr-dqn", "maskable-ppo", "maskable-recurrent-ppo")
    if algo in other:
        fitting = ", ".join(name for name in ALGORITHMS if name not in other)
        kind = "discrete" if discrete else "continuous"
        advice = "" if discrete else f", or with --actions discrete {' or '.join(other)}"
        raise ValueError(f"algo: this bench's actions are {kind}: {fitting}{advice}; given {algo!r}")


def train(arguments: TrainArguments, out: Path, watcher: Watcher | None = None) -> RunResult:
    """Train, or go on training, or return the result of a run that is finished.

    Args:
        arguments: what to train.
        out: the run's folder.
        watcher: is told how it goes.

    Raises:
        ValueError: the folder holds another run, another process trains it, or an argument is wrong for this bench.
        DataError: unknown scenario, bench, goal or starting states.
    """
    run, command, arguments = Run(out), arguments.command_line(), resolved(arguments)
    task = find_task(arguments)
    _check_algorithm(arguments.algo, discrete=bool(task.workplace.action_count))
    if arguments.algo in RECURRENT and task.background is not None and task.agent != MANAGER_AGENT:
        raise ValueError(
            f"algo: {arguments.algo}: a laboratory's bench begins anew with each experiment, and {arguments.env_id} "
            "has several in an episode; train the bench on its own (chemlab/Bench-v0), or the manager"
        )
    warning = task.warning()
    if warning is not None:
        warnings.warn(warning, stacklevel=2)
    described = RunConfig(
        label_of(arguments),
        arguments.recorded(),
        arguments.scenario or task.scenario.name,
        task.agent,
        list(task.goals),
        task.fingerprint,
        training_versions(),
    )

    def check() -> None:
        if arguments.imitate is not None:
            task.policy(arguments.imitate)
        if arguments.advice is not None:
            task.advisor(arguments.advice)

    def go_on() -> RunResult:
        agent = _Agent(run, arguments, task, described, command)
        result = train_in_rounds(run, described, agent, arguments, agent.progress, watcher)
        agent.venv.close()
        # A finished run is not gone on with: what only that needs is large.
        shutil.rmtree(run.checkpoints / "replay", ignore_errors=True)
        return result

    return open_run(run, described, arguments, go_on, check)
