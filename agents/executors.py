"""Executors of jobs: in this process, in processes of this machine, on a Ray cluster, or by Slurm.

Sweeps, audits, benchmarks and evaluations submit their jobs to a :class:`concurrent.futures.Executor`;
other executors (of Dask, mpi4py) work as well. :func:`executor` makes one:

| address | workers | concurrent jobs |
|---|---|---|
| none | processes of this machine; for one job at a time, this process | number of cores |
| ``auto``, ``HOST:PORT`` | a Ray cluster (extra ``ray``) | number of its CPUs |
| ``slurm`` | Slurm jobs (extra ``slurm``) with resources from the environment variables ``SBATCH_...`` | 64 |

A job whose worker is lost (killed, out of memory, at its time limit, node failure) is retried, up to :data:`ATTEMPTS`
attempts in total.
The result of a job depends only on its arguments, not on the worker or the number of attempts.
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
from typing import Any, ParamSpec, TypeVar

import chemlab
from chemlab.config.extras import needs
from chemlab.config.parts import strangers_code, trust

ATTEMPTS = 3
"""Maximum number of attempts per job."""
_SLURM_CONCURRENT = 64
_SLURM_MINUTES = 60
_OBJECT_STORE_BYTES = 512 * 1024 * 1024
"""Size of the object store of a local Ray instance; a batch of turns takes about ten megabytes."""

_Outcome = tuple[Any, Exception | None, str]
"""Outcome of a call: result, error and traceback."""

P = ParamSpec("P")
Value = TypeVar("Value")
J = TypeVar("J")


class WorkerLost(OSError):
    """A job lost its worker or its child process; raised by a future if this happened in every attempt."""


@contextlib.contextmanager
def executor(address: str | None = None, processes: int | None = None, commands: bool = False) -> Iterator[Executor]:
    """Yield an executor for the duration of the context; an error inside the context also ends running jobs.

    Args:
        address: see this module's table.
        processes: number of concurrent jobs; None: the table's default.
        commands: True if jobs are :func:`run_chemlab`, which starts its own process, so that local threads suffice.

    Raises:
        ValueError: no cluster answers at the address.
        ImportError: the extra is not installed.
    """
    jobs = _new_executor(address, processes, commands)
    try:
        yield jobs
    except BaseException:
        jobs.shutdown(cancel_futures=True)
        raise
    jobs.shutdown()


def _new_executor(address: str | None, processes: int | None, commands: bool) -> Executor:
    if address is None:
        count = processes or os.cpu_count() or 1
        if commands:
            return Workers(_Commands(), count)
        return Workers(_Processes(count), count) if count > 1 else Inline()
    if address == "slurm":
        return Workers(_Slurm(), processes or _SLURM_CONCURRENT)
    cluster = _Ray(address)
    return Workers(cluster, processes or cluster.cpus)


def completed(jobs: Executor, function: Callable[[J], Value], arguments: Sequence[J]) -> Iterator[tuple[J, Value]]:
    """Call ``function`` on each argument; yield (argument, result) in the order of completion.

    Raises:
        WorkerLost: a job lost its worker in every attempt.
    """
    waiting: dict[Future[Value], J] = {}
    for argument in arguments:
        future = jobs.submit(function, argument)
        if future.done():  # an inline job is finished on submission; yield it before the next one starts
            yield argument, future.result()
        else:
            waiting[future] = argument
    for future in as_completed(waiting):
        yield waiting[future], future.result()


class Inline(Executor):
    """Executes each job in this process on submission."""

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
    """A function call that is sent to a worker.

    Attributes:
        function, arguments, keywords: the call.
        trusted: value of :func:`~chemlab.config.parts.trust` at submission.
        folder: working directory at submission, the base of relative paths.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    keywords: Mapping[str, Any]
    trusted: bool | None
    folder: str

    def __call__(self) -> _Outcome:
        """Return (result, None, "") or (None, error, traceback): some engines would change the class of an error."""
        if Path(self.folder).is_dir():
            os.chdir(self.folder)
        with contextlib.nullcontext() if self.trusted is None else strangers_code(self.trusted):
            try:
                return self.function(*self.arguments, **self.keywords), None, ""
            except Exception as error:
                return None, error, traceback.format_exc()


class Workers(ThreadPoolExecutor):
    """Executor whose threads each wait for one job of a backend and restart it if its worker is lost.

    Args:
        backend: the workers: ``execute(call)`` returns the outcome, or raises one of ``lost`` if the worker was lost;
            ``close()`` stops the workers and their running calls.
        count: number of concurrent jobs.
    """

    def __init__(self, backend: _Commands | _Processes | _Ray | _Slurm, count: int) -> None:
        super().__init__(count, "jobs")
        self._backend, self._closing = backend, False

    def submit(self, fn: Callable[P, Value], /, *args: P.args, **kwargs: P.kwargs) -> Future[Value]:
        """See :meth:`concurrent.futures.Executor.submit`. The future's exception may also be :class:`WorkerLost`."""
        return super().submit(self._executed, _Call(fn, args, kwargs, trust(), os.getcwd()))

    def _executed(self, call: _Call) -> Any:
        reason: BaseException | None = None
        for _ in range(ATTEMPTS):
            if self._closing:
                break
            try:
                value, error, trace = self._backend.execute(call)
            except self._backend.lost as lost:
                reason = lost
                continue
            if isinstance(error, (WorkerLost, *self._backend.lost)):  # submitit raises its own within the job
                reason = error
                continue
            if error is not None:
                raise error from RuntimeError(f"in a worker:\n{trace}")
            return value
        raise WorkerLost(
            f"a job's worker was lost {ATTEMPTS} times: it was refused or killed, or ran out of memory (use fewer "
            f"--processes) or time (Slurm: SBATCH_TIMELIMIT); last: {' '.join(str(reason).split())[-500:]}. "
            "Finished jobs are kept if there is an output folder: the same command resumes"
        ) from reason

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Stop the workers; with ``cancel_futures`` also running jobs, whose results are discarded."""
        super().shutdown(wait=False, cancel_futures=cancel_futures)
        if cancel_futures:
            self._closing = True
            self._backend.close()
        if wait:
            super().shutdown()
            self._backend.close()


class _Commands:
    """Executes commands: jobs start child processes, and threads of this process wait for them."""

    lost: tuple[type[BaseException], ...] = ()

    def execute(self, call: _Call) -> _Outcome:
        return call()

    def close(self) -> None:
        for child in list(_running):
            child.terminate()


class _Processes:
    """Processes of this machine; all are restarted when one of them is lost."""

    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, count: int) -> None:
        self._count, self._lock = count, threading.Lock()
        self._pool: ProcessPoolExecutor | None = None
        self._parent_end: Connection | None = None

    def execute(self, call: _Call) -> _Outcome:
        with self._lock:
            if self._pool is None:
                # Threads of numerical libraries do not survive a fork.
                context = get_context("spawn")
                child_end, self._parent_end = context.Pipe(duplex=False)
                self._pool = ProcessPoolExecutor(self._count, context, _exit_with_parent, (child_end,))
            pool = self._pool
        try:
            return pool.submit(call).result()
        except BrokenExecutor:
            with self._lock:
                if self._pool is pool:
                    self._pool = None
            raise

    def close(self) -> None:
        with self._lock:
            pool, parent_end = self._pool, self._parent_end
            self._pool = self._parent_end = None
        if pool is not None and parent_end is not None:
            pool.shutdown(wait=False, cancel_futures=True)
            parent_end.close()
            pool.shutdown()


def _exit_with_parent(child_end: Connection) -> None:
    """Exit this process when the parent's end of the pipe closes: its executor was closed, or the parent has died."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process

    def watch() -> None:
        with contextlib.suppress(EOFError, OSError):
            child_end.recv_bytes()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _Ray:
    """Workers of a Ray cluster, one CPU each."""

    def __init__(self, address: str) -> None:
        self._running, self._connection = set[Any](), contextlib.ExitStack()
        self._ray = self._connection.enter_context(connected(address, 1))
        self.cpus = int(self._ray.cluster_resources()["CPU"])
        self._call = self._ray.remote(max_retries=0)(_Call.__call__)
        kinds = ("WorkerCrashedError", "NodeDiedError", "ObjectLostError", "OutOfMemoryError", "TaskCancelledError")
        self.lost: tuple[type[BaseException], ...] = tuple(getattr(self._ray.exceptions, kind) for kind in kinds)

    def execute(self, call: _Call) -> _Outcome:
        reference = self._call.remote(call)
        self._running.add(reference)
        try:
            outcome: _Outcome = self._ray.get(reference)
            return outcome
        finally:
            self._running.discard(reference)

    def close(self) -> None:
        for reference in list(self._running):
            self._ray.cancel(reference, force=True)
        self._connection.close()


class _Slurm:
    """Slurm jobs, submitted by submitit; ``cluster="local"`` starts local processes instead.

    Args:
        cluster: name of the engine in submitit.
        folder: directory that every node can access, for arguments, results and logs of the jobs.
    """

    def __init__(self, cluster: str = "slurm", folder: Path = Path("slurm")) -> None:
        with needs("Slurm needs submitit", "slurm"):
            import submitit
        try:
            self._engine = submitit.AutoExecutor(folder, cluster)
        except RuntimeError as error:
            raise ValueError(f"address: no Slurm found ({error}); run this on a machine with sbatch") from error
        self._engine.update_parameters(name="chemlab", cpus_per_task=1, timeout_min=_SLURM_MINUTES)
        self._lock, self._running = threading.Lock(), set[Any]()
        self.lost: tuple[type[BaseException], ...] = (submitit.core.utils.UncompletedJobError,)

    def execute(self, call: _Call) -> _Outcome:
        with self._lock:
            job = self._engine.submit(call)
            self._running.add(job)
        try:
            outcome: _Outcome = job.result()
            return outcome
        finally:
            self._running.discard(job)

    def close(self) -> None:
        for job in list(self._running):
            job.cancel(check=False)


@contextlib.contextmanager
def connected(address: str | None, runners: int) -> Iterator[Any]:
    """Connect to Ray and yield its module; an existing connection is reused, and kept after the context.

    Args:
        address: address of a cluster (``auto``: the cluster of this machine); None starts a local Ray instance.
        runners: number of env runners, each of which needs a CPU.

    Raises:
        ValueError: no cluster answers at the address, or it has too few CPUs.
    """
    with needs("a cluster needs Ray", "ray"):
        import ray
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)  # the level that RLlib sets later
    connects = not ray.is_initialized()
    if connects:
        # Disable Ray's usage reports unless the user has configured them.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if address is None:
            count = max(runners, os.cpu_count() or 1)
            ray.init("local", num_cpus=count, include_dashboard=False, object_store_memory=_OBJECT_STORE_BYTES, **quiet)
        else:
            try:
                _check_reachable(address)
                ray.init(address, **quiet)
            except (OSError, RuntimeError, ValueError) as error:  # a ConnectionError is an OSError
                raise ValueError(
                    f"address: no Ray cluster to join at {address!r} ({error}); give auto or a cluster's HOST:PORT; "
                    "ray start --head starts one (with token authentication, set RAY_AUTH_MODE=token here as well)"
                ) from error
    try:
        cpus = int(ray.cluster_resources().get("CPU", 0))
        if cpus < runners:
            raise ValueError(
                f"runners: must be at most {cpus}, the number of Ray's CPUs; given {runners}: use fewer or add nodes"
            )
        yield ray
    finally:
        if connects:
            ray.shutdown()


def _check_reachable(address: str) -> None:
    """Raise OSError if nothing listens at HOST:PORT; Ray itself would retry for minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdigit() and "/" not in host:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()


_CHILD = f"""import os, sys, threading
sys.path[:] = [path for path in sys.path if path] + [{str(Path(chemlab.__file__).parents[1])!r}]
threading.Thread(target=lambda: os._exit(len(os.read(0, 1)) or 1), daemon=True).start()
from chemlab.cli import main
main()
"""
"""Program of a child process: this installation of chemlab.

Nothing is imported from the working directory, which Python would search first (``-P`` prevents this from Python 3.11
on). The child exits when its standard input, held by the parent, is closed.
"""


_running: set[subprocess.Popen[bytes]] = set()
"""Running child processes of this process."""


def run_chemlab(words: Sequence[str], log: Path) -> int:
    """Run a command in a child process on one core and return its exit code. The child ends with this process.

    Args:
        words: arguments of ``chemlab``.
        log: file to which the output is appended.

    Raises:
        WorkerLost: the child was killed or ran out of memory.
    """
    # Threads of numerical libraries would compete with other jobs for the core.
    single = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    log.parent.mkdir(parents=True, exist_ok=True)  # a node may not yet see a folder that another one has made
    with log.open("ab") as output:
        streams: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": output, "stderr": subprocess.STDOUT}
        with subprocess.Popen([sys.executable, "-c", _CHILD, *words], env={**os.environ, **single}, **streams) as child:
            _running.add(child)
            try:
                code = child.wait()
            finally:
                _running.discard(child)
    if code < 0 and code != -signal.SIGINT:
        raise WorkerLost(f"{log}: the command was killed by signal {-code}")
    return code
