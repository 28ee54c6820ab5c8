"""Many training runs as jobs of an executor, each in a separate process.

A sweep file is TOML with one or more ``[[runs]]`` tables. A table has one or several scenarios or environments
(``scenario``), algorithms (``algo``), presets (``preset``) and ``seeds`` (a list, or their number). It may set any
other argument of ``chemlab train``; ``[defaults]`` sets arguments for all tables::

    [[runs]]
    scenario = ["chemlab/WurtzReaction-v0", "chemlab/FictitiousReaction-v0"]
    algo = ["ppo", "sac"]
    seeds = 5
    steps = 300_000

The first seed of every combination runs first. A run's folder is ``OUT/TASK/LABEL/seed-N``; the label is the algorithm
(or preset), or the table's ``name``. A finished run is not repeated, an interrupted one resumes from its checkpoint,
and a failed one is tried again by the next sweep. The output of a run is in ``log.txt`` in its folder.
"""

from __future__ import annotations

import itertools
import re
import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chemlab.config.datafile import DataError, read_toml
from chemlab.config.files import write_json
from chemlab.config.parts import may_run

from ..executors import run_chemlab
from ..runs import Run, RunBusy, differences
from .arguments import Arguments, filled, training_arguments
from .tasks import task_fingerprint

_LISTS = ("env_id", "scenario", "preset", "algo")
"""Keys that may have several values; every combination of them is a run."""
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
    """State of a run.

    Attributes:
        state: done, running, waiting (not begun), interrupted (has begun and waits), failed, or other (its folder has
            a run with other arguments or of a changed scenario).
        step: training steps so far.
        steps: training steps in total.
        mean: mean of the result, or else of the last evaluation.
        note: log file and reason of a failure, or the difference of another run.
    """

    state: str
    step: int
    steps: int
    mean: float | None
    note: str = ""


def plan(file: Path, out: Path) -> list[Planned]:
    """Return the runs of a sweep file in the order of execution, with their folders below ``out``.

    Raises:
        DataError: the file is missing or not TOML.
        ValueError: a key, a value, a scenario or a task is unknown, or different runs have the same folder.
    """
    content = read_toml(file)
    unknown = [key for key in content if key not in ("defaults", "runs")]
    tables = content.get("runs")
    if unknown or not isinstance(tables, list) or not tables:
        raise ValueError(
            f"{file}: needs [[runs]] tables, and may have [defaults]; found {', '.join(content) or 'nothing'}"
        )
    runs: dict[Path, Planned] = {}
    rounds: dict[Path, int] = {}
    defaults = content.get("defaults", {})
    for number, table in enumerate(tables, start=1):
        where = f"{file}: runs {number}"
        if not isinstance(table, dict) or not isinstance(defaults, dict):
            raise DataError(f"{where}: [[runs]] and [defaults] must be tables")
        values = {**defaults, **table}
        name, seeds = values.pop("name", None), _seeds(values.pop("seeds", 1), where)
        lists = [value if isinstance(value := values.get(key), list) else [value] for key in _LISTS]
        for round_index, seed in enumerate(seeds):
            for chosen in itertools.product(*lists):
                own = {**values, **dict(zip(_LISTS, chosen, strict=True)), "seed": seed}
                arguments = training_arguments(own, where)
                try:
                    task_fingerprint(arguments)
                except ValueError as error:
                    raise DataError(f"{where}: {error}") from error
                folder = _folder(arguments, arguments.label if name is None else str(name), where)
                run = runs.setdefault(out / folder, Planned(folder.as_posix(), arguments, Run(out / folder)))
                if run.arguments != arguments:
                    raise ValueError(f"{where}: {run.name} is another run above; give this table a name")
                rounds.setdefault(out / folder, round_index)
                if len(runs) > _MOST_RUNS:
                    raise DataError(f"{where}: more than {_MOST_RUNS} runs")
    return [runs[path] for path in sorted(runs, key=rounds.__getitem__)]


def _folder(arguments: Arguments, label: str, where: str) -> Path:
    """Return a run's folder, relative to the folder of results; DataError if it is not below that folder."""
    folder = arguments.folder(label)
    if len(folder.parts) != 3 or not all(_FOLDER.fullmatch(part) for part in folder.parts):
        raise DataError(
            f"{where}: a run's folder cannot be called {str(folder)!r:.300}: BENCH/LABEL/seed-N, without slashes "
            "and without a dot at the beginning"
        )
    return folder


def _seeds(value: Any, where: str) -> list[int]:
    """Return the seeds of a table, given as a list or as their number."""
    seeds = list(range(min(value, _MOST_RUNS + 1))) if type(value) is int else value
    if isinstance(seeds, list) and len(seeds) > _MOST_RUNS:
        raise DataError(f"{where}: seeds: at most {_MOST_RUNS} of them")
    if not isinstance(seeds, list) or not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds):
        raise ValueError(f"{where}: seeds: must be the number of seeds or a list of integers from 0; given {value!r}")
    return seeds


def status_of(planned: Planned) -> Status:
    """Return the state of a run from its folder.

    Raises:
        ValueError: a file of the run is damaged.
    """
    run, arguments = planned.run, planned.arguments
    config, step = run.config(), 0
    mean: float | None = None
    if config is not None:
        expected = {"arguments": arguments.stated(), "seed": arguments.seed, "fingerprint": task_fingerprint(arguments)}
        other = ", ".join(differences(filled(config), {**config, **expected}).values())
        other = "of chemlab before 0.3" if config.get("arguments") is None else other
        if other:
            return Status("other", 0, arguments.steps, None, f"{other}: {run.path}")
        result = run.result()
        if result is not None:
            return Status("done", result.steps, result.steps, result.mean)
        curve, evaluations = run.curve(), run.evaluations()
        step = curve[-1].step if curve else 0
        mean = evaluations[-1].mean if evaluations else None
    if run.busy():
        return Status("running", step, arguments.steps, mean)
    if run.failed_file.exists():
        return Status("failed", step, arguments.steps, mean, _reason(planned.log))
    return Status("waiting" if config is None else "interrupted", step, arguments.steps, mean)


def _reason(log: Path) -> str:
    """Return a log's path and its last line, which states the reason of a failure."""
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n") if log.exists() else []
    return ": ".join([str(log), *[line.strip() for line in lines if line.strip()][-1:]])


def run_sweep(
    runs: list[Planned], executor: Executor, watch: Callable[[list[Status]], None], interval: float = 0.5
) -> list[Status]:
    """Execute all unfinished runs, and return the final state of every run.

    A run that another process trains is not started, but awaited. Closing the executor ends its runs; the next sweep
    resumes them.

    Args:
        runs: the runs (:func:`plan`).
        executor: executor of commands (:func:`chemlab.agents.executors.executor`); its workers need access to the
            runs' folders.
        watch: called at intervals with the state of every run.
        interval: seconds between checks.

    Raises:
        ValueError: a file of a run is damaged.
    """
    queue = [one for one in runs if status_of(one).state not in ("done", "other")]
    active: dict[Future[int], Planned] = {}
    known: dict[str, Status] = {}

    def states(changed: set[str]) -> list[Status]:
        for one in runs:
            # Files of finished runs do not change, and there may be hundreds of them.
            if one.name not in known or one.name in changed or known[one.name].state in ("running", "waiting"):
                known[one.name] = status_of(one)
        return [known[one.name] for one in runs]

    while queue or active:
        changed = set()
        for future in [future for future in active if future.done()]:
            one = active.pop(future)
            changed.add(one.name)
            code = _exit_code(future, one.log)
            if code == RunBusy.exit_code:  # another sweep has just started it
                queue.append(one)
            elif code != 0:
                with suppress(OSError):  # a full disk
                    write_json(one.run.failed_file, {"exit_code": code, "log": one.log.name})
        for one in [one for one in queue if not one.run.busy()]:
            queue.remove(one)
            one.run.path.mkdir(parents=True, exist_ok=True)
            one.run.failed_file.unlink(missing_ok=True)
            active[executor.submit(run_chemlab, _command(one), one.log)] = one
        watch(states({one.name for one in active.values()} | changed))
        if active:
            wait(active, timeout=interval, return_when=FIRST_COMPLETED)
        elif queue:
            time.sleep(interval)
    final = states({one.name for one in runs})
    watch(final)
    return final


def _command(one: Planned) -> list[str]:
    """Return the words of the command that trains a run."""
    words = ["train", one.arguments.scenario, *one.arguments.flags(), "--out", str(one.run.path), "--quiet"]
    return [*words, "--trust"] if may_run(otherwise=False) else words


def _exit_code(future: Future[int], log: Path) -> int:
    """Return the exit code of a finished command; without one, return -9 and append the reason to the log.

    A command has no exit code if its worker was lost or could not start it. Such a run must not end the others.
    """
    try:
        return future.result()
    except OSError as error:
        with suppress(OSError), log.open("a", encoding="utf-8") as output:
            output.write(f"{error}\n")
        return -9
