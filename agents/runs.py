"""Read and write the folder of a training run. Figures and tables are made from these files alone.

| File | Content |
|---|---|
| `config.json` | :class:`RunConfig`: every argument, the bench, versions; written first |
| `curve.jsonl` | one :class:`CurvePoint` per line and rollout: episodes that ended in it |
| `evaluations.jsonl` | one :class:`Evaluation` per line: learned and scripted policy on paired seeds |
| `result.json` | :class:`RunResult`: best and last checkpoint on held-out seeds; written when the run is finished |
| `failed.json` | written by a sweep: exit code and log of the last attempt, if that failed |
| `checkpoints/` | `last-STEP/`, `best-STEP/`, and `first-0/` of clones before training; replay memory; \
large, not for version control |
| `checkpoints/*-STEP/` | `ROLE.safetensors` and `ROLE.json` are the policies (:mod:`~chemlab.agents.pretrained`); \
`model.zip` (Stable-Baselines3's learner) and `state.pkl` are signed pickles for resuming \
(:mod:`~chemlab.agents.seals`) |
| `tensorboard/` | TensorBoard's event files; not for version control |

Floats have full precision; a missing number (no episode ended; no scripted policy) is `null`.
"""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

import chemlab
from chemlab.config.datafile import DataError, bounded, parse_json, read_json, read_text
from chemlab.config.datamodel import validated
from chemlab.config.files import naming, wait_locked, write_text

RESULT_SEED = 2_000_000
"""Seed of the first episode of the final evaluation; training and intermediate evaluations use other seeds."""


def training_seeds(seed: int, envs: int) -> list[int]:
    """Return 64-bit seeds of a run's environments, which differ from those of other runs and of evaluations."""
    seeds: list[int] = np.random.SeedSequence(seed).generate_state(envs, np.uint64).tolist()
    return seeds


class RunConfig(BaseModel):
    """Content of ``config.json``.

    Attributes:
        label: name of the algorithm in figures: ``ppo``, ``ppo-xl``, ...
        env_id: id of the environment.
        algo: name of the algorithm.
        seed: seed of the run.
        scenario: name or path.
        bench: learning roles: a bench's key, an agent's name, or several roles separated by commas.
        goals: training goals.
        fingerprint: hash of the bench's chemistry, options and prices; equal tasks have equal hashes.
        versions: versions of the software that results may depend on.
        background, starts, rewards: as in the arguments.
        arguments: arguments of :mod:`chemlab.agents.train.arguments` without the seed;
            None in runs before 0.3, which have them beside the others.
    """

    model_config = ConfigDict(extra="allow", strict=True)

    label: str = Field(min_length=1, max_length=200)
    env_id: str
    algo: str
    seed: int
    scenario: str
    bench: str
    goals: list[str]
    fingerprint: str
    versions: dict[str, str] = {}
    background: str | None = None
    starts: str = "paper"
    rewards: str | None = None
    arguments: dict[str, Any] | None = None


_EXACT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Strict parsing of lines and results: unknown keys, NaN and infinity are rejected."""
_FILE_BYTES = 64_000_000
"""Maximum file size: several times that of a curve of a hundred thousand rounds."""


@dataclass(frozen=True)
class CurvePoint:
    """A line of ``curve.jsonl``: the episodes that ended during one rollout."""

    __pydantic_config__ = _EXACT

    step: int
    return_mean: float | None
    return_std: float | None
    episodes: int
    seconds: float
    """Wall time so far, including evaluations and checkpoints, summed over all sessions."""


@dataclass(frozen=True)
class Evaluation:
    """A line of ``evaluations.jsonl``; ``mean`` is the mean over goals.

    ``sampled``: True if actions were drawn from the policy, False if the most probable ones were played.
    ``other_mean``: mean of the policy played the other way, if both were evaluated.
    """

    __pydantic_config__ = _EXACT

    step: int
    mean: float
    by_goal: dict[str, float]
    scripted_mean: float | None
    scripted_by_goal: dict[str, float] | None
    sampled: bool = False
    other_mean: float | None = None


@dataclass(frozen=True)
class RunResult:
    """Content of ``result.json``. ``mean`` and ``by_goal`` are those of the best checkpoint, ``last_...`` of the last.

    ``sampled`` and ``last_sampled``: see :class:`Evaluation`.
    """

    __pydantic_config__ = _EXACT

    env_id: str
    label: str
    algo: str
    seed: int
    steps: int
    seconds: float
    frames_per_second: float
    best_step: int
    episodes_per_goal: int
    mean: float
    by_goal: dict[str, float]
    scripted_mean: float | None
    scripted_by_goal: dict[str, float] | None
    last_mean: float
    last_by_goal: dict[str, float]
    sampled: bool = False
    last_sampled: bool = False


_FORMER_NAMES = {"heuristic_mean": "scripted_mean", "heuristic_by_goal": "scripted_by_goal"}
"""Fields of results and evaluations by their names before 0.3."""


def _renamed(values: Any) -> Any:
    if not isinstance(values, dict):
        return values
    return {_FORMER_NAMES.get(name, name): value for name, value in values.items()}


def checked_config(values: Any, where: str) -> dict[str, Any]:
    """Validate a run's configuration.

    Raises:
        DataError: it is malformed; the message begins with ``where``.
    """
    validated(RunConfig, values, where)
    return dict(values)


def checked_result(values: Any, where: str) -> RunResult:
    """Validate a run's result.

    Raises:
        DataError: it is malformed; the message begins with ``where``.
    """
    result = validated(RunResult, _renamed(bounded(values, where)), where)
    if set(result.by_goal) != set(result.last_by_goal) or not result.by_goal:
        raise DataError(f"{where}: by_goal and last_by_goal must have the same goals")
    return result


class RunBusy(ValueError):
    """Raised if another process is training the run."""

    exit_code = 75
    """Exit code of the command: a retry may succeed (``EX_TEMPFAIL``)."""


Line = TypeVar("Line", CurvePoint, Evaluation)


class Run:
    """Folder of a run.

    Args:
        path: the folder; it need not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config_file = path / "config.json"
        self.curve_file = path / "curve.jsonl"
        self.evaluations_file = path / "evaluations.jsonl"
        self.result_file = path / "result.json"
        self.failed_file = path / "failed.json"
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"

    def config(self) -> dict[str, Any] | None:
        """Return the content of ``config.json``, or None.

        Raises:
            DataError: the file is malformed.
        """
        if not self.config_file.exists():
            return None
        return checked_config(read_json(self.config_file), str(self.config_file))

    def result(self) -> RunResult | None:
        """Return the content of ``result.json``, or None while the run is not finished.

        Raises:
            DataError: the file is malformed.
        """
        if not self.result_file.exists():
            return None
        return checked_result(read_json(self.result_file), str(self.result_file))

    def curve(self) -> list[CurvePoint]:
        """Return the learning curve so far."""
        return list(_lines(self.curve_file, CurvePoint))

    def evaluations(self) -> list[Evaluation]:
        """Return the evaluations so far."""
        return list(_lines(self.evaluations_file, Evaluation))

    def append(self, line: CurvePoint | Evaluation) -> None:
        """Append a line to the curve or to the evaluations."""
        file = self.curve_file if isinstance(line, CurvePoint) else self.evaluations_file
        with naming(file), file.open("a", encoding="utf-8") as handle:
            handle.write(json.dumps(asdict(line)) + "\n")

    def keep_lines(self, folder: Path) -> None:
        """Copy the curve and the evaluations into a checkpoint, so that all resume from the same step."""
        for file in (self.curve_file, self.evaluations_file):
            if file.exists():
                shutil.copyfile(file, folder / file.name)

    def rewind(self, step: int) -> None:
        """Restore curve and evaluations to the last checkpoint at ``step``; without one, they are emptied.

        Later lines are removed, and lost ones restored: a system crash, or a version control system that restores an
        earlier file, may affect them but not the checkpoints.
        """
        last, kinds = self.checkpoint("last"), {self.curve_file: CurvePoint, self.evaluations_file: Evaluation}
        for file, kind in kinds.items():
            copy = file if last is None else last / file.name
            lines = iter(()) if last is None else _lines(copy if copy.exists() else file, kind)
            write_text(file, "".join(json.dumps(asdict(line)) + "\n" for line in lines if line.step <= step))

    def checkpoint(self, kind: str) -> Path | None:
        """Return the folder of the newest complete ``last``, ``best`` or ``first`` checkpoint, or None."""
        folders = {p.name.rpartition("-")[2]: p for p in self.checkpoints.glob(f"{kind}-*") if p.is_dir()}
        steps = [step for step in folders if step.isdecimal() and len(step) < 20]
        return folders[max(steps, key=int)] if steps else None

    @contextmanager
    def locked(self, patience: float = 1.0) -> Iterator[None]:
        """Lock the run; the system releases the lock when the process ends.

        Args:
            patience: seconds to wait for the lock, because :meth:`busy` holds it briefly.

        Raises:
            RunBusy: another process holds the lock.
        """
        self.checkpoints.mkdir(parents=True, exist_ok=True)
        with (self.checkpoints / "lock").open("ab") as handle:
            if not wait_locked(handle.fileno(), patience):
                raise RunBusy(f"{self.path}: another process is training this run; wait for it or give another --out")
            yield

    def busy(self) -> bool:
        """Return True if a process is training this run now."""
        if not (self.checkpoints / "lock").exists():
            return False
        try:
            with self.locked(patience=0.0):
                return False
        except RunBusy:
            return True


def _lines(path: Path, kind: type[Line]) -> Iterator[Line]:
    """Yield the complete lines of a file; a last one truncated by a crash is skipped."""
    if not path.exists():
        return
    for number, line in enumerate(read_text(path, _FILE_BYTES).splitlines(keepends=True), start=1):
        if not line.endswith("\n"):
            return
        where = f"{path}:{number}"
        yield validated(kind, _renamed(parse_json(line, where)), where)


def differences(saved: Mapping[str, Any], expected: Mapping[str, Any]) -> dict[str, str]:
    """Return descriptions of the differences between two configurations, by field; versions are not compared.

    Args:
        saved: content of a ``config.json``.
        expected: the configuration to compare with.
    """

    def fields(config: Mapping[str, Any]) -> dict[str, Any]:
        flat = {**config, **(config.get("arguments") or {})}
        return {name: value for name, value in flat.items() if name not in ("arguments", "versions")}

    ours, theirs = fields(saved), fields(json.loads(json.dumps(dict(expected))))
    return {
        name: f"{name} {ours.get(name)!r} (now {theirs.get(name)!r})"
        for name in {**ours, **theirs}
        if ours.get(name) != theirs.get(name)
    }


def versions() -> dict[str, str]:
    """Return the versions of the software that results may depend on."""
    return {"chemlab": chemlab.__version__, "numpy": np.__version__, "python": platform.python_version()}


def find_runs(folder: Path) -> list[Run]:
    """Return every run below a folder, sorted by path."""
    return [Run(file.parent) for file in sorted(folder.rglob("config.json")) if "checkpoints" not in file.parts]
