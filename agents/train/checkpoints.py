"""Crash-safe checkpoints with the complete state of a run.

A checkpoint is written into a draft folder, which is then renamed; the previous checkpoint is removed afterwards. Each
row of the replay buffer is written once: a checkpoint adds a file with the rows since the previous one.
"""

from __future__ import annotations

import pickle
import random
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer

from chemlab.config.files import DRAFT, draft_of, naming, open_regular, sync_file, sync_folder

from ..learners import load_learner, save_learner
from ..runs import Run
from ..sb3 import ChemlabVecEnv
from ..seals import read_sealed, seal_file

_CHECKPOINT = re.compile(r"(new(-best|-first)?|last|best|first)-\d+")
"""Names of checkpoints and of their drafts."""
_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Arrays of a replay buffer."""


def random_state() -> dict[str, Any]:
    """Return the state of the process's random generators, for :func:`restore_random_state`."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002 - SB3 draws from the global stream
        "torch": torch.get_rng_state(),
    }


def restore_random_state(state: dict[str, Any]) -> None:
    """Restore the state of the process's random generators."""
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])  # noqa: NPY002 - SB3 draws from the global stream
    torch.set_rng_state(state["torch"])


def commit_checkpoint(run: Run, step: int, write: Callable[[Path], None], best: bool, best_step: int | None) -> None:
    """Write the ``last`` checkpoint, and copies of its policies: ``best`` if it is the best, ``first`` before training.

    Args:
        run: the run.
        step: training step.
        write: function that writes the checkpoint's files into a folder.
        best: True if these policies are the best so far.
        best_step: step of the best policies.
    """
    draft = run.checkpoints / f"new-{step}"
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    with naming(draft):
        write(draft)
    run.keep_lines(draft)
    for kind, kept in (("best", best), ("first", step == 0)):
        if kept:
            copy = run.checkpoints / f"new-{kind}-{step}"
            shutil.rmtree(copy, ignore_errors=True)
            copy.mkdir()
            for file in draft.iterdir():
                if file.suffix != ".jsonl" and not file.name.startswith("state.pkl"):
                    shutil.copyfile(file, copy / file.name)
            _renamed(copy, run.checkpoints / f"{kind}-{step}")
    _renamed(draft, run.checkpoints / f"last-{step}")
    tidy(run, step, best_step)


def save_agent(run: Run, folder: Path, model: BaseAlgorithm, venv: ChemlabVecEnv, progress: dict[str, Any]) -> None:
    """Write everything that :func:`load_agent` needs into the folder of a checkpoint.

    Args:
        run: the run; its replay buffer is stored beside the checkpoints.
        folder: folder of the checkpoint.
        model, venv: the learner between two rollouts, and its environments.
        progress: state of the training loop.
    """
    save_learner(folder, model)
    state = {
        "replay_rows": _save_replay(run, model) if hasattr(model, "replay_buffer") else 0,
        "environments": venv.get_state(),
        "memory": getattr(model, "_last_lstm_states", None),
        "action_space": model.action_space.np_random.bit_generator.state,
        **random_state(),
        "progress": progress,
    }
    save_state(folder, state)


def save_state(folder: Path, state: dict[str, Any]) -> None:
    """Write the state for resuming into the folder of a checkpoint, for :func:`load_state`."""
    (folder / "state.pkl").write_bytes(pickle.dumps(state))
    seal_file(folder / "state.pkl")


def load_state(folder: Path) -> dict[str, Any]:
    """Read the state written by :func:`save_state`.

    Raises:
        DataError: the file has no valid signature (:mod:`~chemlab.agents.seals`).
    """
    return dict(pickle.loads(read_sealed(folder / "state.pkl")))


def _renamed(draft: Path, final: Path) -> None:
    """Rename a draft after flushing it to disk; replace a folder of that name, which is from a crash at this step."""
    for file in draft.iterdir():
        sync_file(file)
    sync_folder(draft)
    shutil.rmtree(final, ignore_errors=True)
    draft.rename(final)
    sync_folder(final.parent)


def tidy(run: Run, last: int, best: int | None) -> None:
    """Remove drafts and all checkpoints except ``first`` and those of the steps ``last`` and ``best``."""
    keep = {f"last-{last}", f"best-{best}", "first-0"}
    for folder in run.checkpoints.iterdir():
        if _CHECKPOINT.fullmatch(folder.name) and folder.name not in keep:
            shutil.rmtree(folder, ignore_errors=True)


def _save_replay(run: Run, model: Any) -> int:
    """Write the new rows of the replay buffer, and return the total number of rows so far."""
    buffer: ReplayBuffer = model.replay_buffer
    size, rows = buffer.buffer_size, int(model.num_timesteps // model.n_envs)
    files = _replay_files(run)
    written = max((stop for _, stop, _ in files), default=0)
    for _, stop, file in files:
        if stop <= written - size:  # no longer needed by the last checkpoint
            file.unlink()
    start = max(written, rows - size)
    if start < rows:
        at = np.arange(start, rows) % size
        target = run.checkpoints / "replay" / f"{start}-{rows}.npz"
        with draft_of(target) as draft, draft.open("wb") as handle:
            np.savez(handle, **{name: getattr(buffer, name)[at] for name in _ARRAYS})
    return rows


def _replay_files(run: Run) -> list[tuple[int, int, Path]]:
    """Return (first row, row after the last, file), in order."""
    names = ((file.stem.partition("-"), file) for file in (run.checkpoints / "replay").glob("*-*.npz"))
    return sorted((int(a), int(b), file) for (a, _, b), file in names if a.isdecimal() and b.isdecimal())


def forget_replay(run: Run) -> None:
    """Remove the files of the run's replay buffer, which only resuming needs."""
    folder = run.checkpoints / "replay"
    for file in [*(file for *_, file in _replay_files(run)), *folder.glob(f"{DRAFT}*")]:
        file.unlink()
    with suppress(OSError):  # it does not exist, or contains other files
        folder.rmdir()


def _load_replay(run: Run, buffer: ReplayBuffer, rows: int) -> None:
    """Fill a replay buffer from the files of ``rows`` rows, and remove later ones; ValueError if one is missing."""
    size, available = buffer.buffer_size, 0
    for start, stop, file in _replay_files(run):
        if stop > rows:  # a crash interrupted the checkpoint of this file
            file.unlink()
            continue
        if stop > rows - size:
            limit = 2 * sum(getattr(buffer, name).nbytes for name in _ARRAYS)
            with open_regular(file, limit) as opened, np.load(opened) as saved:
                at = np.arange(start, stop) % size
                for name in _ARRAYS:
                    getattr(buffer, name)[at] = saved[name]
        available = stop
    if available != rows:
        raise ValueError(f"{run.checkpoints / 'replay'}: has {available} of {rows} rows; delete the run to start again")
    buffer.pos, buffer.full = rows % size, rows >= size


def load_agent(run: Run, folder: Path, algo: str, venv: ChemlabVecEnv) -> tuple[BaseAlgorithm, dict[str, Any]]:
    """Restore the learner, the environments and the process's random generators from a ``last`` checkpoint.

    Returns:
        The learner, and the state of the training loop.

    Raises:
        ValueError: files of the replay buffer are missing.
        DataError: the checkpoint has no valid signature.
    """
    state = load_state(folder)
    model = load_learner(folder, algo, env=venv, force_reset=False)
    if hasattr(model, "replay_buffer"):
        _load_replay(run, model.replay_buffer, state["replay_rows"])
    if model.num_timesteps:  # the environments of a clone have not begun; the caller seeds them
        venv.set_state(state["environments"])
    if state.get("memory") is not None:
        model._last_lstm_states = state["memory"]  # type: ignore[attr-defined]
    model.action_space.np_random.bit_generator.state = state["action_space"]
    restore_random_state(state)  # last, because loading a learner seeds the generators
    return model, dict(state["progress"])
