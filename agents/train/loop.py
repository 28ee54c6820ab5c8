"""The loop of every training run: rounds, evaluations, checkpoints and the result.

A round is a rollout and the update after it. Between rounds nothing is half done: there the curve grows a point, the
learner is evaluated, and checkpoints are written. A new learner is a :class:`Trainee`.
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
"""First seed of the evaluations that choose the best checkpoint. The final one begins at
:data:`~chemlab.agents.runs.RESULT_SEED`; training has :func:`~chemlab.agents.runs.training_seeds`."""


class Watcher:
    """Observer of a training run; this one ignores everything."""

    def cloning(self, policy: str) -> None:
        """Behaviour cloning of a policy begins."""

    def begun(self, step: int, steps: int) -> None:
        """Training begins, or resumes from a step above 0."""

    def advanced(self, step: int, mean: float | None, note: str = "") -> None:
        """A round is over; mean return of the episodes that ended in it, and the learner's note."""

    def evaluated(self, evaluation: Evaluation, best: bool) -> None:
        """An evaluation is over, and a checkpoint written."""

    def finishing(self) -> None:
        """Training is over; the final evaluation begins."""


@dataclass
class Progress:
    """State of the loop, stored in each checkpoint.

    ``seconds`` is wall time over all sittings; ``sampled`` says how the policy plays: as in the last evaluation, at
    first as ``play`` says.
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
            ValueError: the checkpoint is another version's.
        """
        if set(saved) != {f.name for f in fields(cls)}:
            raise ValueError(f"{folder}: not a checkpoint of this version; delete the run's folder to begin anew")
        return cls(**saved)


class Trainee(ABC):
    """A learner, or several, with the environments that they learn in. Making one checks the arguments only.

    Attributes:
        arguments: of the run.
        config: the run's ``config.json``.
        steps: how many of them it learns from.
        logger: set by the loop; losses may be logged there.
        note: what the last round was, where it was not of the episodes that are evaluated.
        has_policy: whether it begins with a policy, which is evaluated before anything is learned.
    """

    arguments: Arguments
    config: RunConfig
    steps: int
    logger: Logger
    note: str = ""
    has_policy: bool = False

    @abstractmethod
    def check(self) -> None:
        """Check what only a run that begins needs, before anything is written; ValueError if it is wrong."""

    @abstractmethod
    def begin(self, run: Run) -> Progress:
        """Make the learner and its environments: new, or as the run's last checkpoint has them."""

    @abstractmethod
    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """Train for a round; return its steps (at least 1) and the returns of the episodes that ended in it."""

    @abstractmethod
    def scores(self, episodes: int, seed: int, sampled: bool) -> dict[str, float]:
        """Evaluate the policy, sampled or greedy (after :meth:`take`, as its card says): mean return by goal."""

    @abstractmethod
    def scripted(self, episodes: int, seed: int) -> dict[str, float] | None:
        """Evaluate the scripted policy on the same episodes; None where there is none."""

    @abstractmethod
    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """Write a checkpoint: the policies, with their evaluation if there is one, and the state to resume from."""

    @abstractmethod
    def take(self, folder: Path) -> None:
        """Play as the policies of a checkpoint from now on."""

    @abstractmethod
    def close(self) -> None:
        """Release what only training needs."""

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


def reached(arguments: Arguments, evaluation: Evaluation | None) -> dict[str, Any]:
    """Return what a checkpoint's card states of its evaluation; nothing where there was none."""
    if evaluation is None:
        return {}
    values = {"episodes_per_goal": arguments.eval_episodes, "seed": EVALUATION_SEED, **asdict(evaluation)}
    for name in ("step", "sampled", "other_mean"):
        del values[name]
    return values


class _Purging(TensorBoardOutputFormat):
    """TensorBoard's files, without what a killed run logged past its last checkpoint; disk errors name the folder."""

    def __init__(self, folder: Path, step: int) -> None:
        self._folder = folder
        # The point at the checkpoint's own step has been logged; purging it would leave a gap.
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
    others = threading.excepthook

    def told(error: threading.ExceptHookArgs) -> None:
        # TensorBoard's thread writes the file; its errors are reported by the next call.
        if type(error.thread).__name__ != "_AsyncWriterThread":
            others(error)

    threading.excepthook = told
    try:
        with closing(Logger(str(run.tensorboard), [_Purging(run.tensorboard, step)])) as logger:
            yield logger
    finally:
        threading.excepthook = others


def train_in_rounds(run: Run, trainee: Trainee, progress: Progress, watcher: Watcher) -> RunResult:
    """Train to the end from ``progress``, and write the result.

    Args:
        run: the run's folder, held by the caller.
        trainee: the learner.
        progress: a fresh one, or that of the last checkpoint.
        watcher: observes the run.
    """
    a, p, total = trainee.arguments, progress, trainee.steps
    if p.step:
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
                _save(run, trainee, p, evaluation, best)
            if evaluation is not None:
                watcher.evaluated(evaluation, best)

        if p.best_step is None:
            p.sampled = getattr(a, "play", "greedy") == "sampled"
        if trainee.has_policy and p.best_step is None:
            assess(evaluate=True, save=True)
        while p.step < total:
            before = p.step
            turns, ended = trainee.learn(p)
            p.step, p.rounds, p.seconds = p.step + turns, p.rounds + 1, time.perf_counter() - begun
            point = _point(p, ended)
            run.append(point)
            # Evenly spread over the run, and after the last round.
            evaluate, save = (p.step * n // total > before * n // total for n in (a.evaluations, a.checkpoints))
            assess(evaluate, save, point)
            watcher.advanced(p.step, point.return_mean, trainee.note)
    watcher.finishing()
    result = _result(run, trainee, p)
    write_json(run.result_file, asdict(result))
    return result


def _mean(by_goal: dict[str, float]) -> float:
    return sum(by_goal.values()) / len(by_goal)


def _point(progress: Progress, ended: list[float]) -> CurvePoint:
    returns = np.array(ended)
    mean, std = (float(returns.mean()), float(returns.std())) if ended else (None, None)
    return CurvePoint(progress.step, mean, std, len(ended), round(progress.seconds, 3))


_WAYS = {"greedy": (False,), "sampled": (True,), "better": (False, True)}
"""Ways of an evaluation by the argument ``play``: False is greedy, True sampled."""


def _evaluation(step: int, trainee: Trainee, scripted: dict[str, float] | None) -> Evaluation:
    """Evaluate the policy greedily, sampled, or both; the higher mean counts."""
    a = trainee.arguments
    found = {way: trainee.scores(a.eval_episodes, EVALUATION_SEED, way) for way in _WAYS[getattr(a, "play", "greedy")]}
    sampled = max(found, key=lambda way: _mean(found[way]))
    beside = None if scripted is None else _mean(scripted)
    other = _mean(found[not sampled]) if len(found) > 1 else None
    return Evaluation(step, _mean(found[sampled]), found[sampled], beside, scripted, sampled, other)


def _log(logger: Logger, point: CurvePoint, evaluation: Evaluation | None) -> None:
    if point.return_mean is not None:
        logger.record("rollout/ep_rew_mean", point.return_mean)
    if evaluation is not None:
        logger.record("eval/mean_reward", evaluation.mean)
    logger.record("time/fps", point.step / point.seconds if point.seconds else 0.0)
    logger.dump(point.step)


def _save(run: Run, trainee: Trainee, progress: Progress, evaluation: Evaluation | None, best: bool) -> None:
    def write(folder: Path) -> None:
        trainee.save(folder, progress, evaluation)

    commit_checkpoint(run, progress.step, write, best, progress.best_step)


def _result(run: Run, trainee: Trainee, progress: Progress) -> RunResult:
    config, episodes = trainee.config, trainee.arguments.final_episodes
    best = run.checkpoint("best")
    assert best is not None, "the last round is followed by an evaluation and a checkpoint"
    assert progress.best_step is not None, "the best checkpoint has been set"
    last = trainee.scores(episodes, RESULT_SEED, progress.sampled)
    trainee.take(best)
    found = trainee.scores(episodes, RESULT_SEED, progress.best_sampled)
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
        mean=_mean(found),
        by_goal=found,
        scripted_mean=None if scripted is None else _mean(scripted),
        scripted_by_goal=scripted,
        last_mean=_mean(last),
        last_by_goal=last,
        sampled=progress.best_sampled,
        last_sampled=progress.sampled,
    )
