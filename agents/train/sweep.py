"""Many training runs as jobs of an executor, each in a process of its own.

A sweep file is TOML with any number of ``[[runs]]``, which run in their order. Each names scenarios or environments
(``scenario``), algorithms or presets (``algo``, ``preset``) and ``seeds`` (a list, or their number), one or several of
each, and may set any other argument of ``chemlab train``; ``[defaults]`` sets them for the whole file::

    [[runs]]
    scenario = ["chemlab/WurtzReaction-v0", "chemlab/FictitiousReaction-v0"]
    algo = ["ppo", "sac"]
    seeds = 5
    steps = 300_000

Within a table the first seed of every combination runs first. A run's folder is ``OUT/TASK/LABEL/seed-N``; the label
is the algorithm (or preset), or the table's ``name``. A finished run is not repeated, an interrupted one resumes from
its checkpoint, a failed one is tried again by the next sweep; each run's output is in ``log.txt`` in its folder.
"""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chemlab.config.datafile import DataError, read_toml
from chemlab.config.files import write_json
from chemlab.config.parts import may_run

from ..executors import WorkerLost, run_chemlab
from ..runs import Run, RunBusy, differences
from .arguments import Arguments, filled, training_arguments
from .tasks import task_fingerprint

_OWN = ("name", "seeds")
_LISTS = ("env_id", "scenario", "preset", "algo")
"""Keys that may have several values, of which every combination is run."""
_MOST_RUNS = 10_000
_FOLDER = re.compile(r"[^./\\\x00-\x1f\x7f][^/\\\x00-\x1f\x7f]{0,199}")


@dataclass(frozen=True)
class Planned:
    """One run of a sweep."""

    name: str
    arguments: Arguments
    run: Run

    @property
    def log(self) -> Path:
        """Log file of the process."""
        return self.run.path / "log.txt"


@dataclass(frozen=True)
class Status:
    """State of a run: done, running, waiting, interrupted (has a checkpoint and waits), failed, or other (a folder with
    other arguments or a changed scenario). ``mean`` is that of the result, or of the last evaluation so far."""

    state: str
    step: int
    steps: int
    mean: float | None
    note: str = ""


def plan(file: Path, out: Path) -> list[Planned]:
    """Return the runs of a sweep file in the order of execution: the first seed of every combination comes first.

    Raises:
        DataError: the file is missing or not TOML.
        ValueError: a key, a value, a scenario or what it is to train is unknown, or two runs have one folder.
    """
    content = read_toml(file)
    unknown = [key for key in content if key not in ("defaults", "runs")]
    tables = content.get("runs")
    if unknown or not isinstance(tables, list) or not tables:
        raise ValueError(
            f"{file}: needs [[runs]] tables, and may have [defaults]; found {', '.join(content) or 'nothing'}"
        )
    found: dict[Path, Planned] = {}
    turns: dict[Path, int] = {}
    defaults = content.get("defaults", {})
    for number, table in enumerate(tables, start=1):
        where = f"{file}: runs {number}"
        if not isinstance(table, dict) or not isinstance(defaults, dict):
            raise DataError(f"{where}: [[runs]] and [defaults] must be tables")
        values = {**defaults, **table}
        for turn, seed in enumerate(_seeds(values.get("seeds", 1), where)):
            for chosen in itertools.product(*(_several(values, key) for key in _LISTS)):
                own = {k: v for k, v in values.items() if k not in _OWN}
                arguments = training_arguments({**own, "seed": seed, **dict(zip(_LISTS, chosen, strict=True))}, where)
                try:
                    task_fingerprint(arguments)
                except ValueError as error:
                    raise DataError(f"{where}: {error}") from error
                label = str(values.get("name", arguments.label))
                path = out / _folder(arguments, label, where)
                one = Planned(path.relative_to(out).as_posix(), arguments, Run(path))
                if path in found and found[path].arguments != arguments:
                    raise ValueError(f"{where}: {one.name} is another run above; give this table a name")
                found.setdefault(path, one)
                turns.setdefault(path, turn)
                if len(found) > _MOST_RUNS:
                    raise DataError(f"{where}: more than {_MOST_RUNS} runs")
    return [found[path] for path in sorted(found, key=turns.__getitem__)]


def _folder(arguments: Arguments, label: str, where: str) -> Path:
    """Return a run's folder, which must be below the folder of results."""
    folder = arguments.folder(label)
    if len(folder.parts) != 3 or not all(_FOLDER.fullmatch(part) for part in folder.parts):
        raise DataError(
            f"{where}: a run's folder cannot be called {str(folder)!r:.300}: BENCH/LABEL/seed-N, without slashes "
            "and without a dot at the beginning"
        )
    return folder


def _several(values: dict[str, Any], key: str) -> list[Any]:
    value = values.get(key)
    return value if isinstance(value, list) else [value]


def _seeds(value: Any, where: str) -> list[int]:
    seeds = list(range(min(value, _MOST_RUNS + 1))) if type(value) is int else value
    if isinstance(seeds, list) and len(seeds) > _MOST_RUNS:
        raise DataError(f"{where}: seeds: at most {_MOST_RUNS} of them")
    if not isinstance(seeds, list) or not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds):
        raise ValueError(f"{where}: seeds: needs a list of integers from 0 or how many, given {value!r}")
    return seeds


def status_of(planned: Planned) -> Status:
    """Return the state of a run from its folder.

    Raises:
        ValueError: a file there is damaged.
    """
    run, steps = planned.run, planned.arguments.steps
    config = run.config()
    if config is None:
        return _unfinished(planned, 0, None, "waiting")
    now = planned.arguments
    expected = {"arguments": now.stated(), "seed": now.seed, "fingerprint": task_fingerprint(now)}
    found = differences(filled(config), {**config, **expected})
    if config.get("arguments") is None or found:
        what = ", ".join(found.values()) if config.get("arguments") is not None else "of chemlab before 0.3"
        return Status("other", 0, steps, None, f"{what}: {run.path}")
    result = run.result()
    if result is not None:
        return Status("done", result.steps, result.steps, result.mean)
    curve, evaluations = run.curve(), run.evaluations()
    step = curve[-1].step if curve else 0
    mean = evaluations[-1].mean if evaluations else None
    return _unfinished(planned, step, mean, "interrupted")


def _unfinished(planned: Planned, step: int, mean: float | None, otherwise: str) -> Status:
    state = "running" if planned.run.busy() else "failed" if planned.run.failed_file.exists() else otherwise
    return Status(state, step, planned.arguments.steps, mean, _reason(planned.log) if state == "failed" else "")


def _reason(log: Path) -> str:
    """Return a log's file and its last line, which says why a run has failed."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n") if log.exists() else []
    return ": ".join([str(log), *[line.strip() for line in lines if line.strip()][-1:]])


def run_sweep(
    runs: list[Planned], executor: Executor, watch: Callable[[list[Status]], None], interval: float = 0.5
) -> list[Status]:
    """Execute unfinished runs; return the final state of every run.

    Runs that another process trains are left to it and awaited. Closing the executor ends runs; the next sweep resumes
    them.

    Args:
        runs: see :func:`plan`.
        executor: executor of commands, see :func:`chemlab.agents.executors.executor`; its workers must have access to
            the runs' folders.
        watch: called with every run's state at intervals.
        interval: seconds between checks.

    Raises:
        ValueError: a file of a run is damaged.
    """
    queue = [one for one in runs if status_of(one).state not in ("done", "other")]
    active: dict[Future[int], Planned] = {}
    known: dict[str, Status] = {}

    def look(fresh: set[str]) -> list[Status]:
        for one in runs:
            # Files of finished runs do not change, and there may be hundreds of them.
            if one.name not in known or one.name in fresh or known[one.name].state in ("running", "waiting"):
                known[one.name] = status_of(one)
        return [known[one.name] for one in runs]

    while queue or active:
        fresh = set()
        for future in [future for future in active if future.done()]:
            one = active.pop(future)
            fresh.add(one.name)
            code = _exit_code(future)
            if code == RunBusy.exit_code:  # another sweep's process was slightly earlier
                queue.append(one)
            elif code != 0:
                write_json(one.run.failed_file, {"exit_code": code, "log": one.log.name})
        for one in [one for one in queue if not one.run.busy()]:
            queue.remove(one)
            one.run.path.mkdir(parents=True, exist_ok=True)
            one.run.failed_file.unlink(missing_ok=True)
            active[executor.submit(run_chemlab, _words(one), one.log)] = one
        watch(look({one.name for one in active.values()} | fresh))
        if active:
            wait(active, timeout=interval, return_when=FIRST_COMPLETED)
        elif queue:
            time.sleep(interval)
    final = look({one.name for one in runs})
    watch(final)
    return final


def _words(one: Planned) -> list[str]:
    """Return the command that trains a run."""
    words = ["train", one.arguments.scenario, *one.arguments.flags(), "--out", str(one.run.path), "--quiet"]
    return [*words, "--trust"] if may_run(otherwise=False) else words


def _exit_code(ended: Future[int]) -> int:
    try:
        return ended.result()
    except WorkerLost:
        return -9  # like a killed process
