"""Where jobs are played: here, in processes of this machine, on a Ray cluster, or by Slurm.

Sweeps, audits, benchmarks and evaluations plan what to play and submit it to a :class:`concurrent.futures.Executor`;
whoever has one of their own (Dask's, mpi4py's) may give that. :func:`executor` makes one:

| address | where | at a time |
|---|---|---|
| none | processes of this machine; this one, if there is to be one | as many as there are cores |
| ``auto``, ``HOST:PORT`` | a Ray cluster (extra ``ray``) | as many as it has CPUs |
| ``slurm`` | jobs of Slurm (extra ``slurm``), asked for what ``SBATCH_`` variables of the environment say | 64 |

A job whose worker is lost (killed, out of memory, its machine gone) is played again, :data:`ATTEMPTS` times in all.
What a job comes to depends on its arguments alone, so it is the same wherever it is played, and however often.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar

import chemlab
from chemlab.config.parts import strangers_code, trust

__all__ = ["ATTEMPTS", "Inline", "WorkerLost", "Workers", "completed", "connected", "executor", "run_chemlab"]

ATTEMPTS = 3
"""How often a job is begun, at most."""
_SLURM_AT_A_TIME = 64
_SLURM_MINUTES = 60
_OBJECT_STORE_BYTES = 512 * 1024 * 1024
"""Of a Ray of our own: a batch of turns is some ten megabytes."""

P = ParamSpec("P")
Value = TypeVar("Value")
J = TypeVar("J")


class WorkerLost(OSError):
    """A job has lost its worker, or the process that it had started; a future's: as often as it may."""


# -- executors --------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def executor(address: str | None = None, processes: int | None = None, commands: bool = False) -> Iterator[Executor]:
    """An executor that lasts as long as the context; an error inside ends the jobs that are running, too.

    Args:
        address: see this module's table.
        processes: jobs at a time; None: what the table says.
        commands: jobs are :func:`run_chemlab`, which is a process of its own: here, threads wait for them.

    Raises:
        ValueError: no cluster answers there.
        ImportError: the extra is not installed.
    """
    jobs = _made(address, processes, commands)
    try:
        yield jobs
    except BaseException:
        jobs.shutdown(cancel_futures=True)
        raise
    jobs.shutdown()


def _made(address: str | None, processes: int | None, commands: bool) -> Executor:
    if address is None:
        count = processes or os.cpu_count() or 1
        if commands:
            return Workers(_Commands(), count)
        return Workers(_Processes(count), count) if count > 1 else Inline()
    if address == "slurm":
        return Workers(_Slurm(), processes or _SLURM_AT_A_TIME)
    cluster = _Ray(address)
    return Workers(cluster, processes or cluster.cpus)


def completed(jobs: Executor, function: Callable[[J], Value], arguments: Sequence[J]) -> Iterator[tuple[J, Value]]:
    """Play ``function`` of each argument; yields (argument, what it came to) as soon as one is done.

    Raises:
        WorkerLost: see there.
    """
    waiting: dict[Future[Value], J] = {}
    for argument in arguments:
        future = jobs.submit(function, argument)
        if future.done():  # where it is played while it is submitted, it is kept before the next one is
            yield argument, future.result()
        else:
            waiting[future] = argument
    for future in as_completed(waiting):
        yield waiting[future], future.result()


class Inline(Executor):
    """Plays each job in this process while it is submitted."""

    def submit(self, fn: Callable[P, Value], /, *args: P.args, **kwargs: P.kwargs) -> Future[Value]:
        """See :meth:`concurrent.futures.Executor.submit`."""
        future: Future[Value] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@dataclass(frozen=True)
class _Call:
    """A job as it is sent to a worker.

    Attributes:
        function, arguments, keywords: what is called.
        trusted: what :func:`~chemlab.config.parts.trust` was where it was submitted.
        folder: the working folder there, which paths may start from.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    keywords: Mapping[str, Any]
    trusted: bool | None
    folder: str

    def __call__(self) -> tuple[Any, Exception | None, str]:
        """What it came to, or the error and where that comes from: engines would wrap it, each in its own."""
        if Path(self.folder).is_dir():
            os.chdir(self.folder)
        with contextlib.nullcontext() if self.trusted is None else strangers_code(self.trusted):
            try:
                return self.function(*self.arguments, **self.keywords), None, ""
            except Exception as error:
                return None, error, traceback.format_exc()


class _Place(Protocol):
    """Where calls are played.

    Attributes:
        lost: errors of :meth:`play` that say that the worker was lost.
    """

    lost: tuple[type[BaseException], ...]

    def play(self, call: _Call) -> tuple[Any, Exception | None, str]:
        """What a call comes to, when it has."""

    def close(self) -> None:
        """Let the workers go, and end what they are at."""


class Workers(ThreadPoolExecutor):
    """Has jobs played by the workers of a place, each watched by a thread that begins it again if its worker is lost.

    Args:
        place: where.
        count: jobs at a time.
    """

    def __init__(self, place: _Place, count: int) -> None:
        super().__init__(count, "jobs")
        self._place, self._closing = place, False

    def submit(self, fn: Callable[P, Value], /, *args: P.args, **kwargs: P.kwargs) -> Future[Value]:
        """See :meth:`concurrent.futures.Executor.submit`.

        The future's result may also be :class:`WorkerLost`.
        """
        return super().submit(self._played, _Call(fn, args, kwargs, trust(), os.getcwd()))

    def _played(self, call: _Call) -> Any:
        reason: BaseException | None = None
        for _ in range(ATTEMPTS):
            if self._closing:
                break
            try:
                value, error, where = self._place.play(call)
            except self._place.lost as lost:
                reason = lost
                continue
            if isinstance(error, WorkerLost):
                reason = error
                continue
            if error is not None:
                raise error from RuntimeError(f"in a worker:\n{where}")
            return value
        raise WorkerLost(
            f"a job's worker was lost {ATTEMPTS} times: killed, or out of memory (fewer --processes take less)? "
            "What is finished is kept where there is a folder for it: the same command goes on"
        ) from reason

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the workers go; with ``cancel_futures`` also those that are at a job, which comes to nothing."""
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        if cancel_futures:
            self._closing = True
            self._place.close()
        if wait:
            super().shutdown()
            self._place.close()


# -- places -----------------------------------------------------------------------------------------------------------


class _Commands:
    """This process, whose threads wait for the commands that jobs are."""

    lost: tuple[type[BaseException], ...] = ()

    def play(self, call: _Call) -> tuple[Any, Exception | None, str]:
        """See :class:`_Place`."""
        return call()

    def close(self) -> None:
        """See :class:`_Place`."""
        for child in list(_running):
            child.terminate()


class _Processes:
    """Processes of this machine; together they are made anew when one of them was lost."""

    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, count: int) -> None:
        self._count, self._lock = count, threading.Lock()
        self._pool: ProcessPoolExecutor | None = None
        self._leash: Connection | None = None

    def _running(self) -> ProcessPoolExecutor:
        with self._lock:
            if self._pool is None:
                # Threads of numerical libraries do not survive a fork.
                context = get_context("spawn")
                end, self._leash = context.Pipe(duplex=False)
                self._pool = ProcessPoolExecutor(self._count, context, _end_with, (end,))
            return self._pool

    def play(self, call: _Call) -> tuple[Any, Exception | None, str]:
        """See :class:`_Place`."""
        pool = self._running()
        try:
            return pool.submit(call).result()
        except BrokenExecutor:
            with self._lock:
                if self._pool is pool:
                    self._pool = None
            raise

    def close(self) -> None:
        """See :class:`_Place`."""
        with self._lock:
            pool, leash = self._pool, self._leash
            self._pool = self._leash = None
        if pool is not None and leash is not None:
            pool.shutdown(wait=False, cancel_futures=True)
            leash.close()
            pool.shutdown()


def _end_with(leash: Connection) -> None:
    """Let this process end when nobody holds the other end: its executor was closed, or whoever had it has died."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who waits for the result

    def watch() -> None:
        with contextlib.suppress(EOFError, OSError):
            leash.recv_bytes()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _ray() -> Any:
    """Ray's module."""
    try:
        import ray
    except ImportError as error:
        raise ImportError(f'a cluster needs Ray ({error}): pip install ".[ray]"') from error
    return ray


class _Ray:
    """A Ray cluster's workers, a CPU each."""

    def __init__(self, address: str) -> None:
        self._ray, self._at_work, self._left = _ray(), set[Any](), contextlib.ExitStack()
        self._left.enter_context(connected(address, 1))
        self.cpus = int(self._ray.cluster_resources()["CPU"])
        self._call = self._ray.remote(max_retries=0)(_Call.__call__)
        kinds = ("WorkerCrashedError", "NodeDiedError", "ObjectLostError", "OutOfMemoryError", "TaskCancelledError")
        self.lost: tuple[type[BaseException], ...] = tuple(getattr(self._ray.exceptions, kind) for kind in kinds)

    def play(self, call: _Call) -> tuple[Any, Exception | None, str]:
        """See :class:`_Place`."""
        reference = self._call.remote(call)
        self._at_work.add(reference)
        try:
            found: tuple[Any, Exception | None, str] = self._ray.get(reference)
            return found
        finally:
            self._at_work.discard(reference)

    def close(self) -> None:
        """See :class:`_Place`."""
        for reference in list(self._at_work):
            self._ray.cancel(reference, force=True)
        self._left.close()


class _Slurm:
    """Jobs of Slurm, by submitit; ``cluster="local"`` has it start processes here.

    Args:
        cluster: submitit's name of the engine.
        folder: seen by every machine; what jobs are given, come to and say stays there.
    """

    def __init__(self, cluster: str = "slurm", folder: Path = Path("slurm")) -> None:
        try:
            import submitit
        except ImportError as error:
            raise ImportError(f'Slurm needs submitit ({error}): pip install ".[slurm]"') from error
        try:
            self._engine = submitit.AutoExecutor(folder, cluster)
        except RuntimeError as error:
            raise ValueError(f"address: no Slurm to submit to ({error}); run this where there is an sbatch") from error
        self._engine.update_parameters(name="chemlab", cpus_per_task=1, timeout_min=_SLURM_MINUTES)
        self._lock, self._at_work = threading.Lock(), set[Any]()
        self.lost: tuple[type[BaseException], ...] = (submitit.core.utils.UncompletedJobError,)

    def play(self, call: _Call) -> tuple[Any, Exception | None, str]:
        """See :class:`_Place`."""
        with self._lock:
            job = self._engine.submit(call)
            self._at_work.add(job)
        try:
            found: tuple[Any, Exception | None, str] = job.result()
            return found
        finally:
            self._at_work.discard(job)

    def close(self) -> None:
        """See :class:`_Place`."""
        for job in list(self._at_work):
            job.cancel(check=False)


@contextlib.contextmanager
def connected(address: str | None, runners: int) -> Iterator[None]:
    """Ray, for as long as the context lasts; one that this process is connected to already is used and left alone.

    Args:
        address: of a cluster (``auto``: the one this machine belongs to); None starts a Ray of our own, here.
        runners: env runners that are to find a CPU there.

    Raises:
        ValueError: no cluster answers there, or it has fewer CPUs.
    """
    ray = _ray()
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)  # the level RLlib sets once it is running
    ours = not ray.is_initialized()
    if ours:
        # Unless told otherwise Ray reports its use to its makers.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if address is None:
            count = max(runners, os.cpu_count() or 1)
            ray.init("local", num_cpus=count, include_dashboard=False, object_store_memory=_OBJECT_STORE_BYTES, **quiet)
        else:
            try:
                _knock(address)
                ray.init(address, **quiet)
            except (OSError, RuntimeError, ValueError) as error:  # a ConnectionError is an OSError
                raise ValueError(
                    f"address: no Ray cluster to join at {address!r} ({error}); start one with ray start --head (one "
                    "that asks for a token needs RAY_AUTH_MODE=token here, too)"
                ) from error
    try:
        cpus = int(ray.cluster_resources().get("CPU", 0))
        if cpus < runners:
            raise ValueError(
                f"runners: each takes a CPU, and Ray has {cpus}; given {runners}: ask for fewer or add nodes"
            )
        yield
    finally:
        if ours:
            ray.shutdown()


def _knock(address: str) -> None:
    """OSError where nobody listens at HOST:PORT: Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdigit() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()


# -- commands as jobs -------------------------------------------------------------------------------------------------

_CHILD = f"""import os, sys, threading
sys.path[:] = [path for path in sys.path if path] + [{str(Path(chemlab.__file__).parents[1])!r}]
threading.Thread(target=lambda: os._exit(len(os.read(0, 1)) or 1), daemon=True).start()
from chemlab.cli import main
main()
"""
"""What a child runs: chemlab as it is here. Nothing is imported from the folder that it is started in, which Python
would look through first (``-P`` would keep it from that, from 3.11 on). It ends when its standard input does, which
whoever started it holds."""


_running: set[subprocess.Popen[bytes]] = set()
"""Commands that this process has started and waits for."""


def run_chemlab(words: Sequence[str], log: Path) -> int:
    """Run a command in a process of its own, on one core, which ends with this one; returns its exit code.

    Args:
        words: as they would follow ``chemlab``.
        log: file to which is added what it says.

    Raises:
        WorkerLost: it was killed, or there was no memory for it.
    """
    # Libraries that start threads of their own would share the core with other jobs.
    single = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    with log.open("ab") as said:
        streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": said, "stderr": subprocess.STDOUT}
        with subprocess.Popen([sys.executable, "-c", _CHILD, *words], env={**os.environ, **single}, **streams) as child:
            _running.add(child)
            try:
                code = child.wait()
            finally:
                _running.discard(child)
    if code == -9:
        raise WorkerLost(f"{log}: the command was killed")
    return code
