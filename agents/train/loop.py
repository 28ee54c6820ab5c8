"""The loop of every training run, whoever computes the updates.

A round is a rollout and the update after it. Between rounds nothing is half done: there the curve grows a point, what
learns is evaluated, and checkpoints are written.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from chemlab.config.files import naming, write_text
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.lab.engine import Laboratories

from ..episodes import play_laboratory
from ..policies import Policy, agent_policy
from ..pretrained import fingerprint
from ..roles import chosen_roles, role_of
from ..runs import RESULT_SEED, CurvePoint, Evaluation, Run, RunConfig, RunResult, differences, to_text, versions
from .arguments import Arguments, TeamArguments

try:
    import sb3_contrib
    import stable_baselines3
    import torch
    from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
    from torch.utils.tensorboard.writer import SummaryWriter

    from .checkpoints import commit_checkpoint, tidy
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install ".[train]"') from error

__all__ = [
    "EVALUATION_SEED",
    "LaboratoryTrainee",
    "Progress",
    "Trainee",
    "Watcher",
    "described_team",
    "open_run",
    "reached",
    "train_in_rounds",
    "training_versions",
]

EVALUATION_SEED = 1_000_000
"""Training episodes have small seeds; the evaluations that choose the best checkpoint and the one that reports it
(:data:`~chemlab.agents.runs.RESULT_SEED`) do not share any either."""


class Watcher(Protocol):
    """Is told how a training run goes."""

    def begun(self, step: int, steps: int) -> None:
        """It begins, or goes on from a step above 0."""

    def advanced(self, step: int, mean: float | None) -> None:
        """A round is over; mean return of the episodes that ended in it."""

    def evaluated(self, evaluation: Evaluation, best: bool) -> None:
        """What learns has been evaluated, and a checkpoint written."""

    def finishing(self) -> None:
        """Training is over; the final evaluation begins."""


@dataclass
class Progress:
    """How far a run is; a checkpoint keeps it."""

    step: int = 0
    rounds: int = 0
    seconds: float = 0.0
    """Wall time over all sittings."""
    best_mean: float | None = None
    best_step: int | None = None

    @classmethod
    def of(cls, saved: Mapping[str, Any], folder: Path) -> Progress:
        """What a checkpoint has kept.

        Raises:
            ValueError: it is another version's.
        """
        if set(saved) != {f.name for f in fields(cls)}:
            raise ValueError(f"{folder}: not a checkpoint of this version; delete the run's folder to begin anew")
        return cls(**saved)


class Trainee(ABC):
    """What a run trains: an agent, or several roles of a laboratory."""

    steps: int
    """How many steps it is to learn from."""
    logger: Logger
    """Set by the loop: its own numbers go there, and losses and the like may, too."""

    @abstractmethod
    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """One round: steps learned from (at least 1) and the returns of the episodes that ended in it."""

    @abstractmethod
    def scores(self, episodes: int, seed: int) -> dict[str, float]:
        """Mean return for each goal, played deterministically."""

    @abstractmethod
    def scripted(self, episodes: int, seed: int) -> dict[str, float] | None:
        """The same of those who play without having learned; None where nobody can."""

    @abstractmethod
    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """Write all that is needed to go on, and what plays (with the evaluation of it, if there is one)."""

    @abstractmethod
    def take(self, folder: Path) -> None:
        """Play as a checkpoint's files do from now on."""


class LaboratoryTrainee(Trainee):
    """Roles of a laboratory that learn; a policy by name plays the others.

    Args:
        arguments: of the run.
        scenario: the laboratory.
    """

    def __init__(self, arguments: TeamArguments, scenario: Scenario) -> None:
        self.scenario, self.steps, self._background = scenario, arguments.steps, arguments.background
        self._evaluation_split = arguments.evaluation_split
        labs = Laboratories(load_scenario(arguments.scenario), 1)
        self.workplaces = {role_of(agent): labs.role(number) for number, agent in reversed([*enumerate(labs.agents)])}
        """By role, where it is to work: a run may reward it otherwise than the scenario does, for no other task."""

    @abstractmethod
    def learned(self) -> Mapping[str, Policy]:
        """What the roles that learn play now, by role, deterministically."""

    def scores(self, episodes: int, seed: int) -> dict[str, float]:
        """See :class:`Trainee`: scores of the laboratory."""
        return self._played(self.learned(), episodes, seed)

    def scripted(self, episodes: int, seed: int) -> dict[str, float]:
        """See :class:`Trainee`: the background plays everybody."""
        return self._played({}, episodes, seed)

    def _played(self, learned: Mapping[str, Policy], episodes: int, seed: int) -> dict[str, float]:
        labs = Laboratories(self.scenario, episodes, split=self._evaluation_split)
        policies = {
            agent: learned.get(role_of(agent)) or agent_policy(self._background, labs, number, seed)
            for number, agent in enumerate(labs.agents)
        }
        return {
            goal: float(play_laboratory(labs, policies, goal, seed).returns.mean()) for goal in self.scenario.lab_goals
        }


def described_team(
    arguments: TeamArguments, label: str, algo: str, packages: dict[str, str]
) -> tuple[Scenario, list[str], RunConfig]:
    """The scenario of a run in which roles learn together, those roles, and its ``config.json``.

    Args:
        arguments: of the run.
        label: what figures call the algorithm.
        algo: the algorithm.
        packages: see :func:`training_versions`.

    Raises:
        DataError: unknown scenario.
        ValueError: unknown role or reward mix, or the policies that are to play the others do not fit.
    """
    a = arguments
    scenario = load_scenario(a.scenario)
    scenario = scenario if a.rewards is None else scenario.with_rewards(a.rewards)
    labs = Laboratories(scenario, 1)
    roles = chosen_roles(labs, a.roles)
    for number, agent in enumerate(labs.agents):
        if role_of(agent) not in roles:
            agent_policy(a.background, labs, number)
    return (
        scenario,
        roles,
        RunConfig(
            label,
            {**a.recorded(), "algo": algo, "env_id": "chemlab/Laboratory-v0"},
            a.scenario,
            ",".join(roles),
            list(scenario.lab_goals),
            fingerprint(labs.role(0)),
            packages,
        ),
    )


def reached(arguments: Arguments, evaluation: Evaluation | None) -> dict[str, Any]:
    """What a checkpoint's card says of its evaluation; nothing where there was none."""
    if evaluation is None:
        return {}
    values = {"episodes_per_goal": arguments.eval_episodes, "seed": EVALUATION_SEED, **asdict(evaluation)}
    del values["step"]
    return values


def training_versions() -> dict[str, str]:
    """What a training run may depend on."""
    return {
        **versions(),
        "stable-baselines3": stable_baselines3.__version__,
        "sb3-contrib": sb3_contrib.__version__,
        "torch": torch.__version__,
    }


def _same_run(run: Run, config: dict[str, Any], defaults: dict[str, Any]) -> None:
    """Refuse to go on with a run that was begun with other arguments."""
    saved = run.config()
    if saved is None:
        return
    found = differences(saved, config, defaults)
    if list(found) == ["fingerprint"]:
        raise ValueError(
            f"{run.path}: scenario {config['scenario']!r} has changed since this run was begun; "
            "delete the folder to begin anew, or give another --out"
        )
    if found:
        what = ", ".join(found.values())
        raise ValueError(
            f"{run.path}: holds a run with other arguments: {what}; give another --out, or delete the folder"
        )


def open_run(
    run: Run,
    described: RunConfig,
    arguments: Arguments,
    go_on: Callable[[], RunResult],
    check: Callable[[], object] = lambda: None,
) -> RunResult:
    """Begin a run, or go on with it, holding its folder; one that is finished is not run again.

    A run that fails before its first checkpoint leaves no ``config.json``, so that other arguments may follow.

    Args:
        run: the folder.
        described: what is to be run there.
        arguments: of the run; what an older version did not know yet had its default.
        go_on: trains to the end.
        check: raises ValueError where a run that begins could not; called before anything is written.

    Raises:
        ValueError: the folder holds another run, or ``check`` found a fault.
        RunBusy: another process trains it.
    """
    _same_run(run, described.as_dict(), type(arguments)().recorded())
    finished = run.result()
    if finished is not None:
        return finished
    begins = run.checkpoint("last") is None
    if begins:
        check()
    # On this size of network a second thread gains nothing, and another number of threads adds in another order.
    torch.set_num_threads(1)
    with run.locked():
        if run.config() is None:
            write_text(run.config_file, to_text(described.as_dict()))
        run.failed_file.unlink(missing_ok=True)
        try:
            return go_on()
        except Exception:
            if begins and run.checkpoint("last") is None:
                run.config_file.unlink(missing_ok=True)
            raise


class _Purging(TensorBoardOutputFormat):
    """Hides what a run that was killed had logged past its last checkpoint; errors of the disk name its folder."""

    def __init__(self, folder: Path, step: int) -> None:
        self._folder = folder
        # The point at the checkpoint's own step has been logged; a hidden one would be a gap.
        with naming(folder):
            self.writer = SummaryWriter(str(folder), purge_step=step + 1 if step else 0)
        self._is_closed = False

    def write(self, *args: Any, **more: Any) -> None:
        """See :class:`stable_baselines3.common.logger.KVWriter`."""
        with naming(self._folder):
            super().write(*args, **more)

    def close(self) -> None:
        """See :class:`stable_baselines3.common.logger.KVWriter`."""
        with naming(self._folder):
            super().close()


@contextmanager
def _tensorboard(run: Run, step: int) -> Iterator[Logger]:
    others = threading.excepthook

    def told(error: threading.ExceptHookArgs) -> None:
        # TensorBoard's thread writes the file; what it could not write is an error of the next call, too.
        if type(error.thread).__name__ != "_AsyncWriterThread":
            others(error)

    threading.excepthook = told
    try:
        with closing(Logger(str(run.tensorboard), [_Purging(run.tensorboard, step)])) as logger:
            yield logger
    finally:
        threading.excepthook = others


def train_in_rounds(
    run: Run,
    described: RunConfig,
    trainee: Trainee,
    arguments: Arguments,
    progress: Progress,
    watcher: Watcher | None = None,
) -> RunResult:
    """Train to the end from where ``progress`` says the trainee is, and report.

    Args:
        run: the run's folder, held by the caller.
        described: what its ``config.json`` says.
        trainee: what learns.
        arguments: how often and on how much it is evaluated and saved.
        progress: a fresh one, or that of the last checkpoint.
        watcher: is told how it goes.
    """
    a, p, total = arguments, progress, trainee.steps
    if p.step:
        tidy(run, p.step, p.best_step)
    run.rewind(p.step)
    scripted = trainee.scripted(a.eval_episodes, EVALUATION_SEED)
    begun = time.perf_counter() - p.seconds
    if watcher is not None:
        watcher.begun(p.step, total)
    with _tensorboard(run, p.step) as logger:
        trainee.logger = logger
        while p.step < total:
            before = p.step
            turns, ended = trainee.learn(p)
            p.step, p.rounds, p.seconds = p.step + turns, p.rounds + 1, time.perf_counter() - begun
            point = _point(p, ended)
            run.append(point)
            # Evenly spread over the run, and after the last round.
            evaluate, save = (p.step * n // total > before * n // total for n in (a.evaluations, a.checkpoints))
            evaluation, best = None, False
            if evaluate:
                evaluation = _evaluation(p.step, trainee.scores(a.eval_episodes, EVALUATION_SEED), scripted)
                run.append(evaluation)
                best = p.best_mean is None or evaluation.mean > p.best_mean
                if best:
                    p.best_mean, p.best_step = evaluation.mean, p.step
            _log(logger, point, evaluation)
            if evaluate or save:
                p.seconds = time.perf_counter() - begun
                _save(run, trainee, p, evaluation, best)
            if watcher is not None:
                if evaluation is not None:
                    watcher.evaluated(evaluation, best)
                watcher.advanced(p.step, point.return_mean)
    if watcher is not None:
        watcher.finishing()
    result = _result(run, described, trainee, arguments, p)
    write_text(run.result_file, to_text(asdict(result)))
    return result


def _mean(by_goal: dict[str, float]) -> float:
    return sum(by_goal.values()) / len(by_goal)


def _point(progress: Progress, ended: list[float]) -> CurvePoint:
    returns = np.array(ended)
    mean, std = (float(returns.mean()), float(returns.std())) if ended else (None, None)
    return CurvePoint(progress.step, mean, std, len(ended), round(progress.seconds, 3))


def _evaluation(step: int, found: dict[str, float], scripted: dict[str, float] | None) -> Evaluation:
    return Evaluation(step, _mean(found), found, None if scripted is None else _mean(scripted), scripted)


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


def _result(run: Run, described: RunConfig, trainee: Trainee, arguments: Arguments, progress: Progress) -> RunResult:
    episodes = arguments.final_episodes
    best = run.checkpoint("best")
    assert best is not None, "the last round is followed by an evaluation and a checkpoint"
    assert progress.best_step is not None, "as the best one was"
    last = trainee.scores(episodes, RESULT_SEED)
    trainee.take(best)
    found = trainee.scores(episodes, RESULT_SEED)
    scripted = trainee.scripted(episodes, RESULT_SEED)
    return RunResult(
        env_id=described.arguments["env_id"],
        label=described.label,
        algo=described.arguments["algo"],
        seed=arguments.seed,
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
    )
