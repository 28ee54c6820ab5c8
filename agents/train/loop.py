"""The loop of every training run: rounds, evaluations, checkpoints and the result.

A round is a rollout and the update after it. After a round, a point is added to the curve; if due, the learner is
evaluated and a checkpoint is written. A new kind of learner is a subclass of :class:`Trainee`.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.extras import needs
from chemlab.config.files import naming, write_json

from ..runs import RESULT_SEED, CurvePoint, Evaluation, Run, RunConfig, RunResult, versions
from .arguments import Arguments

with needs("training needs Stable-Baselines3", "train"):
    import sb3_contrib
    import stable_baselines3
    import torch
    from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
    from torch.utils.tensorboard.writer import SummaryWriter

    from .checkpoints import commit_checkpoint, tidy


EVALUATION_SEED = 1_000_000
"""First seed of the evaluations that choose the best checkpoint.

The final evaluation begins at :data:`~chemlab.agents.runs.RESULT_SEED`.
"""


class Watcher:
    """Observer of a training run; the methods of this class do nothing."""

    def cloning(self, policy: str) -> None:
        """Called before a policy is cloned, with its name."""

    def begun(self, step: int, steps: int) -> None:
        """Called when training begins, or resumes from a step above 0, with the total number of steps."""

    def advanced(self, step: int, mean: float | None, note: str = "") -> None:
        """Called after a round, with the mean return of the episodes that ended in it and the learner's note."""

    def evaluated(self, evaluation: Evaluation, best: bool) -> None:
        """Called after an evaluation and its checkpoint; ``best`` is True for the highest mean so far."""

    def finishing(self) -> None:
        """Called before the final evaluation."""


@dataclass
class Progress:
    """State of the loop, stored in each checkpoint.

    ``seconds`` is wall time over all sessions. ``sampled`` is True if the policy's actions are drawn, as in the last
    evaluation; before the first one, the argument ``play`` decides.
    """

    step: int = 0
    rounds: int = 0
    seconds: float = 0.0
    best_mean: float | None = None
    best_step: int | None = None
    sampled: bool = False
    best_sampled: bool = False

    @classmethod
    def of(cls, saved: Mapping[str, Any], folder: Path) -> Progress:
        """Restore the progress of a checkpoint.

        Raises:
            ValueError: the checkpoint is from another version.
        """
        if set(saved) != {f.name for f in fields(cls)}:
            raise ValueError(f"{folder}: not a checkpoint of this version; delete the run's folder to begin anew")
        return cls(**saved)


class Trainee(ABC):
    """One or several learners with their environments. The constructor only checks the arguments.

    Attributes:
        arguments: arguments of the run.
        config: content of the run's ``config.json``.
        steps: number of training steps.
        logger: TensorBoard logger, set by the loop; losses may be logged there.
        note: description of the last round for the progress line, if it was not of ordinary episodes.
        has_policy: True if it starts from a clone or a trained policy, which is evaluated before training.
    """

    arguments: Arguments
    config: RunConfig
    steps: int
    logger: Logger
    note: str = ""
    has_policy: bool = False

    @abstractmethod
    def check(self) -> None:
        """Check the other requirements of a new run before anything is written; ValueError if one is not met."""

    @abstractmethod
    def begin(self, run: Run) -> Progress:
        """Make the learner and its environments, new or from the run's last checkpoint, and return its progress."""

    @abstractmethod
    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """Train for a round; return its steps (at least 1) and the returns of the episodes that ended in it."""

    @abstractmethod
    def scores(self, episodes: int, seed: int, sampled: bool) -> dict[str, float]:
        """Return the policy's mean return by goal, ``sampled`` or greedy (after :meth:`take`, as its card states)."""

    @abstractmethod
    def scripted(self, episodes: int, seed: int) -> dict[str, float] | None:
        """Return the scripted policy's mean return by goal on the same episodes; None if there is no such policy."""

    @abstractmethod
    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """Write a checkpoint: the policies, with their evaluation if there is one, and the state for resuming."""

    @abstractmethod
    def take(self, folder: Path) -> None:
        """Load the policies of a checkpoint, which :meth:`scores` evaluates from now on."""

    def close(self) -> None:  # noqa: B027 - nothing to release by default
        """Release resources of training after the final evaluation."""

    def described(self, scenario: str, bench: str, goals: list[str], fingerprint: str) -> RunConfig:
        """Return the run's ``config.json``."""
        a = self.arguments
        return RunConfig(
            label=a.label,
            env_id=a.env_id,
            algo=a.algo,
            seed=a.seed,
            scenario=scenario,
            bench=bench,
            goals=goals,
            fingerprint=fingerprint,
            background=a.background,
            starts=getattr(a, "starts", "paper"),
            rewards=getattr(a, "rewards", None),
            arguments=a.stated(),
            versions={
                **versions(),
                "stable-baselines3": stable_baselines3.__version__,
                "sb3-contrib": sb3_contrib.__version__,
                "torch": torch.__version__,
            },
        )


def evaluation_fields(arguments: Arguments, evaluation: Evaluation | None) -> dict[str, Any]:
    """Return the ``evaluation`` of a checkpoint's card; empty without an evaluation."""
    if evaluation is None:
        return {}
    values = {"episodes_per_goal": arguments.eval_episodes, "seed": EVALUATION_SEED, **asdict(evaluation)}
    return {name: value for name, value in values.items() if name not in ("step", "sampled", "other_mean")}


class _TensorBoardFiles(TensorBoardOutputFormat):
    """TensorBoard's files without the points after the checkpoint of a resumed run; disk errors name the folder."""

    def __init__(self, folder: Path, step: int) -> None:
        self._folder = folder
        # The point of the checkpoint's own step remains: it is not logged again.
        with naming(folder):
            self.writer = SummaryWriter(str(folder), purge_step=step + 1 if step else 0)
        self._is_closed = False

    def write(self, *args: Any, **more: Any) -> None:
        with naming(self._folder):
            super().write(*args, **more)

    def close(self) -> None:
        with naming(self._folder):
            super().close()


@contextmanager
def _tensorboard(run: Run, step: int) -> Iterator[Logger]:
    previous_hook = threading.excepthook

    def hook(error: threading.ExceptHookArgs) -> None:
        # Errors of TensorBoard's writer thread are raised again by the next call.
        if type(error.thread).__name__ != "_AsyncWriterThread":
            previous_hook(error)

    threading.excepthook = hook
    try:
        with closing(Logger(str(run.tensorboard), [_TensorBoardFiles(run.tensorboard, step)])) as logger:
            yield logger
    finally:
        threading.excepthook = previous_hook


def train_in_rounds(run: Run, trainee: Trainee, progress: Progress, watcher: Watcher) -> RunResult:
    """Train to the end from ``progress``, and write the result.

    Args:
        run: the run's folder, locked by the caller.
        trainee: the learner.
        progress: progress of a new run, or of the last checkpoint.
        watcher: observer of the run.
    """
    a, p, total = trainee.arguments, progress, trainee.steps
    tidy(run, p.step, p.best_step)
    run.rewind(p.step)
    scripted = trainee.scripted(a.eval_episodes, EVALUATION_SEED)
    begun = time.perf_counter() - p.seconds
    watcher.begun(p.step, total)
    with _tensorboard(run, p.step) as logger:
        trainee.logger = logger

        def assess(evaluate: bool, save: bool, point: CurvePoint | None = None) -> None:
            evaluation, best = None, False
            if evaluate:
                evaluation = _evaluation(p.step, trainee, scripted)
                run.append(evaluation)
                p.sampled = evaluation.sampled
                best = p.best_mean is None or evaluation.mean > p.best_mean
                if best:
                    p.best_mean, p.best_step, p.best_sampled = evaluation.mean, p.step, p.sampled
            if point is not None:
                _log(logger, point, evaluation)
            if evaluate or save:
                p.seconds = time.perf_counter() - begun
                commit_checkpoint(run, p.step, lambda folder: trainee.save(folder, p, evaluation), best, p.best_step)
            if evaluation is not None:
                watcher.evaluated(evaluation, best)

        if p.best_step is None:
            p.sampled = getattr(a, "play", "greedy") == "sampled"
        if trainee.has_policy and p.best_step is None:
            assess(evaluate=True, save=True)
        while p.step < total:
            before = p.step
            steps, returns = trainee.learn(p)
            p.step, p.rounds, p.seconds = p.step + steps, p.rounds + 1, time.perf_counter() - begun
            point = _point(p, returns)
            run.append(point)
            # Evenly spread over the run; the last ones follow the last round.
            evaluate, save = (p.step * n // total > before * n // total for n in (a.evaluations, a.checkpoints))
            assess(evaluate, save, point)
            watcher.advanced(p.step, point.return_mean, trainee.note)
    watcher.finishing()
    result = _result(run, trainee, p)
    write_json(run.result_file, asdict(result))
    return result


def _mean(by_goal: dict[str, float]) -> float:
    return sum(by_goal.values()) / len(by_goal)


def _point(progress: Progress, returns: list[float]) -> CurvePoint:
    mean, std = (float(np.mean(returns)), float(np.std(returns))) if returns else (None, None)
    return CurvePoint(progress.step, mean, std, len(returns), round(progress.seconds, 3))


_WAYS = {"greedy": (False,), "sampled": (True,), "better": (False, True)}
"""Values of ``sampled`` in an evaluation, by the argument ``play``."""


def _evaluation(step: int, trainee: Trainee, scripted: dict[str, float] | None) -> Evaluation:
    """Evaluate the policy greedily, sampled, or both; return the evaluation with the higher mean."""
    a = trainee.arguments
    by_way = {way: trainee.scores(a.eval_episodes, EVALUATION_SEED, way) for way in _WAYS[getattr(a, "play", "greedy")]}
    sampled = max(by_way, key=lambda way: _mean(by_way[way]))
    scripted_mean = None if scripted is None else _mean(scripted)
    other_mean = _mean(by_way[not sampled]) if len(by_way) > 1 else None
    return Evaluation(step, _mean(by_way[sampled]), by_way[sampled], scripted_mean, scripted, sampled, other_mean)


def _log(logger: Logger, point: CurvePoint, evaluation: Evaluation | None) -> None:
    if point.return_mean is not None:
        logger.record("rollout/ep_rew_mean", point.return_mean)
    if evaluation is not None:
        logger.record("eval/mean_reward", evaluation.mean)
    logger.record("time/fps", point.step / point.seconds if point.seconds else 0.0)
    logger.dump(point.step)


def _result(run: Run, trainee: Trainee, progress: Progress) -> RunResult:
    """Evaluate the last and the best checkpoint, and return the run's result."""
    config, episodes = trainee.config, trainee.arguments.final_episodes
    best = run.checkpoint("best")
    assert best is not None, "the last round is followed by an evaluation and a checkpoint"
    assert progress.best_step is not None, "the best checkpoint has been set"
    last = trainee.scores(episodes, RESULT_SEED, progress.sampled)
    trainee.take(best)
    by_goal = trainee.scores(episodes, RESULT_SEED, progress.best_sampled)
    scripted = trainee.scripted(episodes, RESULT_SEED)
    return RunResult(
        env_id=config.env_id,
        label=config.label,
        algo=config.algo,
        seed=config.seed,
        steps=progress.step,
        seconds=round(progress.seconds, 3),
        frames_per_second=round(progress.step / progress.seconds, 1),
        best_step=progress.best_step,
        episodes_per_goal=episodes,
        mean=_mean(by_goal),
        by_goal=by_goal,
        scripted_mean=None if scripted is None else _mean(scripted),
        scripted_by_goal=scripted,
        last_mean=_mean(last),
        last_by_goal=last,
        sampled=progress.best_sampled,
        last_sampled=progress.sampled,
    )
