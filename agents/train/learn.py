"""Training runs that resume after a crash without a change of the result.

>>> from pathlib import Path
>>> from chemlab.agents.train.arguments import PPO
>>> from chemlab.agents.train.learn import train
>>> train(PPO(scenario="wurtz_dodecane", bench="rxn", steps=300_000), Path("runs/wurtz"))   # doctest: +SKIP

:mod:`chemlab.agents.runs` describes the files of a run. A killed run resumes from its last checkpoint with learner,
optimizer, replay buffer, environments and all random streams. Its result is bit for bit that of an uninterrupted run on
the same machine.

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

from pathlib import Path

from chemlab.config.extras import needs
from chemlab.config.files import write_json

from ..runs import Run, RunConfig, RunResult, differences
from .arguments import IPPO, Arguments, Single, filled

with needs("training needs Stable-Baselines3", "train"):
    import torch

    from .joint import Team
    from .loop import Trainee, Watcher, train_in_rounds
    from .single import Agent


def train(arguments: Arguments, out: Path, watcher: Watcher | None = None) -> RunResult:
    """Train, resume training, or return the result of a finished run.

    A run that fails before its first checkpoint leaves no ``config.json``, so that the folder can be used again.

    Args:
        arguments: arguments of the algorithm (:mod:`chemlab.agents.train.arguments`).
        out: the run's folder.
        watcher: observer of the run.

    Raises:
        ValueError: the folder has another run, or an argument does not fit the task.
        RunBusy: another process trains the run.
        DataError: the scenario, bench, goal or initial-state distribution is unknown.
    """
    run = Run(out)
    assert isinstance(arguments, (IPPO, Single)), "each algorithm trains a team or one agent"
    trainee: Trainee = Team(arguments) if isinstance(arguments, IPPO) else Agent(arguments)
    _check_same(run, trainee.config)
    finished = run.result()
    if finished is not None:
        return finished
    if run.checkpoint("last") is None:
        trainee.check()
    # The order of sums depends on the number of threads. With a second core, the critic has a thread of its own.
    torch.set_num_threads(1)
    with run.locked():
        _check_same(run, trainee.config)  # another process may have begun here since
        is_new = run.checkpoint("last") is None
        if run.config() is None:
            write_json(run.config_file, trainee.config.model_dump(exclude_none=True))
        run.failed_file.unlink(missing_ok=True)
        watcher, cloned = watcher or Watcher(), getattr(arguments, "cloned", None)
        if is_new and cloned is not None:
            watcher.cloning(cloned)
        try:
            result = train_in_rounds(run, trainee, trainee.begin(run), watcher)
            trainee.close()
            return result
        except Exception:
            if is_new and run.checkpoint("last") is None:
                run.config_file.unlink(missing_ok=True)
            raise


def _check_same(run: Run, config: RunConfig) -> None:
    """Raise ValueError if the folder has a run with another configuration."""
    saved = run.config()
    if saved is None:
        return
    if saved.get("arguments") is None:
        raise ValueError(f"{run.path}: holds a run of chemlab before 0.3; give another --out, or delete the folder")
    changes = differences(filled(saved), config.model_dump(exclude_none=True))
    if list(changes) == ["fingerprint"]:
        raise ValueError(
            f"{run.path}: scenario {config.scenario!r} has changed since this run was begun; "
            "delete the folder to begin anew, or give another --out"
        )
    if changes:
        text = ", ".join(changes.values())
        raise ValueError(
            f"{run.path}: holds a run with other arguments: {text}; give another --out, or delete the folder"
        )
