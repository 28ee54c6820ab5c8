"""Train an agent with Stable-Baselines3, so that a crash at any moment costs little and changes nothing.

>>> from pathlib import Path
>>> from chemlab.agents.training.arguments import TrainArguments
>>> from chemlab.agents.training.learn import train
>>> train(TrainArguments("chemlab/WurtzReaction-v0", steps=300_000), Path("runs/wurtz"))   # doctest: +SKIP

What a run writes is described in :mod:`chemlab.agents.training.runs`. A run that was killed goes on from its last
checkpoint: learner, optimizer, replay memory, environments and every random stream are there as they were, so that
what comes out is, bit for bit, what an uninterrupted run on the same machine would have come to.

Needs the extra: ``pip install "chemlab-marl[train]"``.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from chemlab.arrays import IntArray, MaskArray, ObservationArray
from chemlab.files import write_text

from ..evaluation.play import versions as evaluation_versions
from .arguments import ALGORITHMS, Stage, TrainArguments, curriculum_of, label_of, resolved
from .runs import RESULT_SEED, CurvePoint, Evaluation, Run, RunConfig, RunResult, differences, to_text
from .tasks import Task, find_task

try:
    import sb3_contrib
    import stable_baselines3
    import torch
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
    from stable_baselines3.common.noise import NormalActionNoise
    from torch.utils.tensorboard.writer import SummaryWriter

    from ..sb3 import ChemlabVecEnv
    from .checkpoints import load_checkpoint, save_checkpoint, tidy
    from .imitate import imitate
except ImportError as error:
    raise ImportError(f'training needs Stable-Baselines3 ({error}): pip install "chemlab-marl[train]"') from error

__all__ = ["RESULT_SEED", "LearnerPolicy", "Watcher", "load_learner", "open_run", "train", "versions"]

_CLASSES: dict[str, Any] = {"ppo": PPO, "a2c": A2C, "dqn": DQN, "sac": SAC, "td3": TD3, "maskable-ppo": MaskablePPO}
_IMITATED = 20_000
_EVALUATION_SEED = 1_000_000
"""Training episodes have small seeds; the evaluations that choose the best checkpoint and the one that reports it do
not share any either (:data:`~chemlab.agents.training.runs.RESULT_SEED`)."""


class Watcher(Protocol):
    """Is told how a training run goes."""

    def begun(self, step: int, steps: int) -> None:
        """It begins, or goes on from a step above 0."""

    def advanced(self, step: int, mean: float | None) -> None:
        """A rollout is over; mean return of the episodes that ended in it."""

    def evaluated(self, evaluation: Evaluation, best: bool) -> None:
        """The policy has been evaluated."""

    def finishing(self) -> None:
        """Training is over; the final evaluation begins."""


class LearnerPolicy:
    """An SB3 learner as a :class:`~chemlab.agents.policy.Policy`: deterministic, with masks only if it learned so."""

    def __init__(self, model: BaseAlgorithm) -> None:
        self._model: Any = model
        self._masked = isinstance(model, MaskablePPO)

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.agents.policy.Policy`."""
        masks = {"action_masks": mask} if self._masked and mask is not None else {}
        actions, _ = self._model.predict(observation, deterministic=True, **masks)
        return np.asarray(actions)


def load_learner(folder: Path, algo: str) -> BaseAlgorithm:
    """The learner of a checkpoint, to play with rather than to go on learning."""
    small = {"buffer_size": 1} if algo in ("dqn", "sac", "td3") else {}
    model: BaseAlgorithm = _CLASSES[algo].load(folder / "model.zip", device="cpu", **small)
    return model


def _learner(arguments: TrainArguments, venv: ChemlabVecEnv, total: int) -> BaseAlgorithm:
    """A fresh one. Fields that are None stay SB3's."""
    a = arguments
    optional: dict[str, Any] = {"learning_rate": a.learning_rate, "batch_size": a.batch_size, "ent_coef": a.ent_coef}
    settings: dict[str, Any] = {"gamma": a.gamma}
    if a.net_arch is not None:
        settings["policy_kwargs"] = {"net_arch": list(a.net_arch)}
    if a.algo in ("ppo", "a2c", "maskable-ppo"):
        settings["n_steps"] = a.rollout
        optional["gae_lambda"] = a.gae_lambda
        if a.algo != "a2c":
            settings |= {"n_epochs": a.epochs, "clip_range": a.clip_range}
    else:
        settings |= {"train_freq": a.rollout, "gradient_steps": a.gradient_steps}
        settings |= {"buffer_size": a.buffer_size, "learning_starts": a.learning_starts}
    if a.algo == "dqn":
        assert a.exploration_steps is not None, "resolved() fills it in"
        settings["exploration_fraction"] = min(1.0, a.exploration_steps / total)
        settings |= {"exploration_initial_eps": 1.0, "exploration_final_eps": a.exploration_final}
    if a.ent_coef_start is not None:
        settings["ent_coef"] = f"auto_{a.ent_coef_start}"
    if a.algo == "td3" and a.action_noise:
        size = venv.batch.single_action_space.shape or ()
        settings["action_noise"] = NormalActionNoise(np.zeros(size), np.full(size, a.action_noise))
    settings |= {name: value for name, value in optional.items() if value is not None}
    model: BaseAlgorithm = _CLASSES[a.algo]("MlpPolicy", venv, seed=a.seed, device="cpu", **settings)
    return model


class _Purging(TensorBoardOutputFormat):
    """Hides what a run that was killed had logged past its last checkpoint."""

    def __init__(self, folder: Path, step: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=step)
        self._is_closed = False


class _Rounds(BaseCallback):
    """What is done between two rollouts: the curve, evaluations, checkpoints."""

    def __init__(
        self,
        run: Run,
        arguments: TrainArguments,
        venv: ChemlabVecEnv,
        task: Task,
        total: int,
        memory: dict[str, Any],
        begin: int,
        watcher: Watcher | None,
    ) -> None:
        super().__init__()
        self.run, self.arguments, self.venv, self.task = run, arguments, venv, task
        self.total, self.memory, self.watcher = total, memory, watcher
        self.heuristic = _scripted(task, arguments.eval_episodes, _EVALUATION_SEED)
        self._returns: list[float] = []
        self._done = -1
        self._stages = curriculum_of(arguments, tuple(task.scenario.benches))
        self._stage: Stage | None = None
        self._begin_stage(begin)
        self._before = float(memory["seconds"])
        self._begun = time.perf_counter()

    def seconds(self) -> float:
        """Wall time of this run, over all sittings."""
        return self._before + time.perf_counter() - self._begun

    def _on_training_start(self) -> None:
        self._done = self.model.num_timesteps

    def _on_step(self) -> bool:
        if self.locals["dones"].any():
            self._returns += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return True

    def _on_rollout_start(self) -> None:
        self._round_over()
        self._begin_stage(self.model.num_timesteps)

    def _begin_stage(self, step: int) -> None:
        """Let episodes begin as the curriculum says for this step."""
        stage = next((stage for stage in self._stages if step < stage.until), None)
        if stage != self._stage:
            self.task.prepare(self.venv.batch, None if stage is None else stage.shares)
            self._stage = stage

    def _on_training_end(self) -> None:
        self._round_over()

    def _round_over(self) -> None:
        """Before each rollout the learner has learned from the one before: nothing is half done."""
        step = self.model.num_timesteps
        if step == self._done:
            return
        self._done = step
        returns = np.array(self._returns)
        mean, std = (float(returns.mean()), float(returns.std())) if len(returns) else (None, None)
        self._returns = []
        self.run.append(CurvePoint(step, mean, std, len(returns), round(self.seconds(), 3)))
        if mean is not None:
            self.logger.record("rollout/ep_rew_mean", mean)
        self.logger.record("time/fps", step / self.seconds())
        evaluate, best = self._due(step, self.arguments.evaluations), False
        if evaluate:
            best = self._evaluate(step)
        self.logger.dump(step)
        if evaluate or self._due(step, self.arguments.checkpoints):
            self.memory["seconds"] = self.seconds()
            save_checkpoint(self.run, self.model, self.venv, self.memory, best)
        if self.watcher is not None:
            self.watcher.advanced(step, mean)

    def _due(self, step: int, times: int) -> bool:
        """Whether something done so many times, evenly spread, is due after this rollout."""
        size = self.arguments.envs * self.arguments.rollout
        rounds, last = step // size, self.total // size
        return rounds * times // last > (rounds - 1) * times // last

    def _evaluate(self, step: int) -> bool:
        found = self.task.by_goal(LearnerPolicy(self.model), self.arguments.eval_episodes, _EVALUATION_SEED)
        mean = _mean(found)
        evaluation = Evaluation(
            step, mean, found, None if self.heuristic is None else _mean(self.heuristic), self.heuristic
        )
        self.run.append(evaluation)
        self.logger.record("eval/mean_reward", mean)
        best = self.memory["best_mean"] is None or mean > self.memory["best_mean"]
        if best:
            self.memory |= {"best_mean": mean, "best_step": step}
        if self.watcher is not None:
            self.watcher.evaluated(evaluation, best)
        return best


def _mean(by_goal: dict[str, float]) -> float:
    return sum(by_goal.values()) / len(by_goal)


def _scripted(task: Task, episodes: int, seed: int) -> dict[str, float] | None:
    """The scripted policy's means, or None where a bench of one's own has no scripted policy."""
    policy = task.scripted()
    return None if policy is None else task.by_goal(policy, episodes, seed)


def versions() -> dict[str, str]:
    """What a run may depend on."""
    return {
        **evaluation_versions(),
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


def open_run(run: Run, described: RunConfig, defaults: dict[str, Any], go_on: Callable[[], RunResult]) -> RunResult:
    """Begin a run, or go on with it, holding its folder; one that is finished is not run again.

    Args:
        run: the folder.
        described: what is to be run there.
        defaults: of its arguments, for runs that an older version began.
        go_on: trains to the end.

    Raises:
        ValueError: the folder holds another run.
        RunBusy: another process trains it.
    """
    _same_run(run, described.as_dict(), defaults)
    finished = run.result()
    if finished is not None:
        return finished
    with run.locked():
        if run.config() is None:
            write_text(run.config_file, to_text(described.as_dict()))
        run.failed_file.unlink(missing_ok=True)
        return go_on()


def _check_algorithm(algo: str, discrete: bool) -> None:
    other = ("sac", "td3") if discrete else ("dqn", "maskable-ppo")
    if algo in other:
        fitting = ", ".join(name for name in ALGORITHMS if name not in other)
        kind = "discrete" if discrete else "continuous"
        raise ValueError(f"algo: this bench's actions are {kind}: {fitting}; given {algo!r}")


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
    run, arguments = Run(out), resolved(arguments)
    task = find_task(arguments)
    _check_algorithm(arguments.algo, discrete=bool(task.role.action_count))
    described = RunConfig(
        label_of(arguments),
        asdict(arguments),
        arguments.scenario or task.scenario.name,
        task.bench,
        list(task.goals),
        task.fingerprint,
        versions(),
    )
    defaults = {f.name: f.default for f in fields(TrainArguments)}
    return open_run(run, described, defaults, lambda: _train(run, arguments, task, watcher))


def _train(run: Run, arguments: TrainArguments, task: Task, watcher: Watcher | None) -> RunResult:
    # On this size of network a second thread gains nothing, and another number of threads adds in another order.
    torch.set_num_threads(1)
    size = arguments.envs * arguments.rollout
    total = math.ceil(arguments.steps / size) * size
    venv = ChemlabVecEnv(task.batch(arguments.envs))
    memory: dict[str, Any] = {"seconds": 0.0, "best_mean": None, "best_step": None}
    last = run.checkpoint("last")
    if last is None:
        shutil.rmtree(run.checkpoints / "replay", ignore_errors=True)
        model = _learner(arguments, venv, total)
        if arguments.imitate is not None:
            example = task.policy(arguments.imitate)
            imitate(model, task.batch(arguments.envs), example, arguments.imitate_steps or _IMITATED, arguments.seed)
    else:
        model, memory = load_checkpoint(run, last, _CLASSES[arguments.algo], venv)
        tidy(run, model.num_timesteps, memory["best_step"])
    begin = model.num_timesteps
    run.rewind(begin)
    rounds = _Rounds(run, arguments, venv, task, total, memory, begin, watcher)
    if watcher is not None:
        watcher.begun(begin, total)
    if begin < total:
        # The point at the checkpoint's own step has been logged; a hidden one would be a gap.
        purge = begin + 1 if begin else 0
        logger = Logger(str(run.tensorboard), [_Purging(run.tensorboard, purge)])
        model.set_logger(logger)
        try:
            # Logging is done between rollouts, by the callback.
            model.learn(total - begin, rounds, log_interval=None, reset_num_timesteps=not begin)  # type: ignore[arg-type]
        finally:
            logger.close()
    venv.close()
    if watcher is not None:
        watcher.finishing()
    result = _result(run, arguments, task, memory, total)
    write_text(run.result_file, to_text(asdict(result)))
    # A finished run is not gone on with: what only that needs is large.
    shutil.rmtree(run.checkpoints / "replay", ignore_errors=True)
    return result


def _result(run: Run, arguments: TrainArguments, task: Task, memory: dict[str, Any], total: int) -> RunResult:
    found = {}
    for kind in ("best", "last"):
        folder = run.checkpoint(kind)
        assert folder is not None, "the last rollout is followed by an evaluation and a checkpoint"
        learned = LearnerPolicy(load_learner(folder, arguments.algo))
        found[kind] = task.by_goal(learned, arguments.final_episodes, RESULT_SEED)
    heuristic = _scripted(task, arguments.final_episodes, RESULT_SEED)
    return RunResult(
        env_id=arguments.env_id,
        label=label_of(arguments),
        algo=arguments.algo,
        seed=arguments.seed,
        steps=total,
        seconds=round(memory["seconds"], 3),
        frames_per_second=round(total / memory["seconds"], 1),
        best_step=memory["best_step"],
        episodes_per_goal=arguments.final_episodes,
        mean=_mean(found["best"]),
        by_goal=found["best"],
        heuristic_mean=None if heuristic is None else _mean(heuristic),
        heuristic_by_goal=heuristic,
        last_mean=_mean(found["last"]),
        last_by_goal=found["last"],
    )
