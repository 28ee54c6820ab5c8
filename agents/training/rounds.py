"""The loop of a run in which several roles of a laboratory learn, whoever computes the updates.

A round is a rollout and the update after it. Between rounds nothing is half done: there the curve grows a point, the
roles are evaluated together, and a checkpoint is written.
"""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from chemlab.files import write_text

from .checkpoints import commit_checkpoint, tidy
from .learn import RESULT_SEED, Watcher
from .runs import CurvePoint, Evaluation, Run, RunResult, to_text

__all__ = ["EVALUATION_SEED", "Settings", "Team", "fresh_memory", "train_in_rounds"]

EVALUATION_SEED = 1_000_000
"""As for single agents: training, the choice of the best checkpoint and the final report share no seeds."""


class Settings(Protocol):
    """Those arguments of a run that the loop follows."""

    @property
    def steps(self) -> int:
        """Turns to learn from."""

    @property
    def seed(self) -> int:
        """The run's seed."""

    @property
    def evaluations(self) -> int:
        """How often roles are evaluated, and a checkpoint is written."""

    @property
    def eval_episodes(self) -> int:
        """Episodes a goal in each evaluation."""

    @property
    def final_episodes(self) -> int:
        """Episodes a goal in the last one."""


class Team(Protocol):
    """The roles that learn."""

    models: str
    """Pattern of the files of a checkpoint that play."""

    def learn(self, memory: dict[str, Any]) -> tuple[int, list[float]]:
        """One round: turns learned from (at least 1) and the scores of the episodes that ended in it."""

    def scores(self, episodes: int, seed: int, scripted: bool = False) -> dict[str, float]:
        """Mean score of the laboratory for each goal, played deterministically; ``scripted``: by the background."""

    def save(self, folder: Path, memory: dict[str, Any], evaluation: Evaluation) -> None:
        """Write all that is needed to go on, and what plays."""

    def take_best(self, folder: Path) -> None:
        """Play as a checkpoint's files do from now on."""


def fresh_memory() -> dict[str, Any]:
    """What the loop has to remember, at the beginning."""
    return {"seconds": 0.0, "best_mean": None, "best_step": None, "step": 0, "updates": 0}


def _mean(by_goal: dict[str, float]) -> float:
    return sum(by_goal.values()) / len(by_goal)


def train_in_rounds(
    run: Run,
    team: Team,
    settings: Settings,
    memory: dict[str, Any],
    names: tuple[str, str],
    watcher: Watcher | None,
) -> RunResult:
    """Train to the end from where ``memory`` says the team is, and report.

    Args:
        run: the run's folder, held by the caller.
        team: what learns.
        settings: the arguments.
        memory: :func:`fresh_memory`, or that of the last checkpoint.
        names: label and algorithm, for the result.
        watcher: is told how it goes.
    """
    s = settings
    if memory["step"]:
        tidy(run, memory["step"], memory["best_step"])
    run.rewind(memory["step"])
    scripted = team.scores(s.eval_episodes, EVALUATION_SEED, scripted=True)
    begun, before = time.perf_counter(), memory["seconds"]
    if watcher is not None:
        watcher.begun(memory["step"], s.steps)
    due = s.steps / s.evaluations
    while memory["step"] < s.steps:
        was = memory["step"]
        turns, scores = team.learn(memory)
        memory["step"] += turns
        memory["updates"] += 1
        memory["seconds"] = before + time.perf_counter() - begun
        returns = np.array(scores)
        mean, std = (float(returns.mean()), float(returns.std())) if len(returns) else (None, None)
        run.append(CurvePoint(memory["step"], mean, std, len(returns), round(memory["seconds"], 3)))
        if memory["step"] >= s.steps or memory["step"] // due > was // due:
            _evaluate(run, team, settings, memory, scripted, watcher)
        if watcher is not None:
            watcher.advanced(memory["step"], mean)
    if watcher is not None:
        watcher.finishing()
    result = _result(run, team, settings, memory, names)
    write_text(run.result_file, to_text(asdict(result)))
    return result


def _evaluate(
    run: Run,
    team: Team,
    settings: Settings,
    memory: dict[str, Any],
    scripted: dict[str, float],
    watcher: Watcher | None,
) -> None:
    """Evaluate the team, and write a checkpoint."""
    found = team.scores(settings.eval_episodes, EVALUATION_SEED)
    evaluation = Evaluation(memory["step"], _mean(found), found, _mean(scripted), scripted)
    run.append(evaluation)
    best = memory["best_mean"] is None or evaluation.mean > memory["best_mean"]
    if best:
        memory |= {"best_mean": evaluation.mean, "best_step": memory["step"]}

    def save(folder: Path) -> None:
        team.save(folder, memory, evaluation)

    commit_checkpoint(run, memory["step"], save, team.models, best, memory["best_step"])
    if watcher is not None:
        watcher.evaluated(evaluation, best)


def _result(run: Run, team: Team, settings: Settings, memory: dict[str, Any], names: tuple[str, str]) -> RunResult:
    episodes = settings.final_episodes
    last = team.scores(episodes, RESULT_SEED)
    best = run.checkpoint("best")
    assert best is not None, "the last update is followed by an evaluation and a checkpoint"
    team.take_best(best)
    found = team.scores(episodes, RESULT_SEED)
    scripted = team.scores(episodes, RESULT_SEED, scripted=True)
    return RunResult(
        env_id="chemlab/Laboratory-v0",
        label=names[0],
        algo=names[1],
        seed=settings.seed,
        steps=memory["step"],
        seconds=round(memory["seconds"], 3),
        frames_per_second=round(memory["step"] / memory["seconds"], 1),
        best_step=memory["best_step"],
        episodes_per_goal=episodes,
        mean=_mean(found),
        by_goal=found,
        heuristic_mean=_mean(scripted),
        heuristic_by_goal=scripted,
        last_mean=_mean(last),
        last_by_goal=last,
    )
