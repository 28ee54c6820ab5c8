"""What tests have workers do; in a module that takes them no time to import."""

import os
import signal
import time
from pathlib import Path

from chemlab.agents.executors import run_chemlab
from chemlab.config.datafile import DataError
from chemlab.config.parts import may_run


def killed_at_first(number: int, folder: Path, times: int) -> int:
    """The square; number 2's process is killed the first times that it is begun, the second time as by a time limit."""
    (folder / f"begun-{number}-{os.getpid()}-{time.monotonic_ns()}").touch()
    begun = len(list(folder.glob("begun-2-*")))
    if number == 2 and begun <= times:
        os.kill(os.getpid(), signal.SIGUSR2 if begun == 2 else signal.SIGKILL)
    return number * number


def held(number: int, folder: Path) -> int:
    """The square, once there is a file ``go-NUMBER``; says on which of a Ray cluster's nodes it is."""
    import ray

    (folder / f"begun-{number}-{ray.get_runtime_context().get_node_id()}").touch()
    while not (folder / f"go-{number}").exists():
        time.sleep(0.05)
    return number * number


def refused(_: int) -> None:
    """An error."""
    raise DataError("file: key: a reason")


def asked() -> tuple[bool, bool]:
    """Whether strangers' code may run here: pickles, parts."""
    return may_run(otherwise=False), may_run(otherwise=True)


def waits(folder: Path) -> None:
    """Too long; leaves its process's number."""
    (folder / f"{os.getpid()}").touch()
    time.sleep(600.0)


def trains_for_long(folder: Path) -> int:
    """The same, by a command."""
    words = ["train", "chemlab/FictitiousReaction-v0", "--steps", "100000000", "--out", str(folder / "run"), "--quiet"]
    (folder / f"{os.getpid()}").touch()
    return run_chemlab(words, folder / "log.txt")
