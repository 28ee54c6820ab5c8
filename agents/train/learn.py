"""Train with Stable-Baselines3, so that a crash at any moment costs little and changes nothing.

>>> from pathlib import Path
>>> from chemlab.agents.train.arguments import PPO
>>> from chemlab.agents.train.learn import train
>>> train(PPO(scenario="wurtz_dodecane", bench="rxn", steps=300_000), Path("runs/wurtz"))   # doctest: +SKIP

:mod:`chemlab.agents.runs` describes what a run writes. A killed run resumes from its last checkpoint with learner,
optimizer, replay memory, environments and every random stream, so that its result is, bit for bit, that of an
uninterrupted run on the same machine.

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


def _trainee(arguments: Arguments) -> Trainee:
    """Return the learner of an algorithm; a new engine is chosen here."""
    if isinstance(arguments, IPPO):
        return Team(arguments)
    assert isinstance(arguments, Single), "every other algorithm trains one agent"
    return Agent(arguments)


def train(arguments: Arguments, out: Path, watcher: Watcher | None = None) -> RunResult:
    """Train, resume training, or return the result of a finished run.

    A run that fails before its first checkpoint leaves no ``config.json``, so that other arguments may follow.

    Args:
        arguments: of the algorithm (:mod:`chemlab.agents.train.arguments`).
        out: the run's folder.
        watcher: observes the run.

    Raises:
        ValueError: the folder holds another run, or an argument does not fit the task.
        RunBusy: another process trains it.
        DataError: unknown scenario, bench, goal or starting states.
    """
    run = Run(out)
    trainee = _trainee(arguments)
    _check_same(run, trainee.config)
    finished = run.result()
    if finished is not None:
        return finished
    begins = run.checkpoint("last") is None
    if begins:
        trainee.check()
    # Sums depend on the number of threads; the critic has a thread of its own where there is a second core.
    torch.set_num_threads(1)
    with run.locked():
        if run.config() is None:
            write_json(run.config_file, trainee.config.model_dump(exclude_none=True))
        run.failed_file.unlink(missing_ok=True)
        watcher, shown = watcher or Watcher(), getattr(arguments, "bc", None)
        if begins and shown is not None:
            watcher.cloning(shown)
        try:
            result = train_in_rounds(run, trainee, trainee.begin(run), watcher)
            trainee.close()
            return result
        except Exception:
            if begins and run.checkpoint("last") is None:
                run.config_file.unlink(missing_ok=True)
            raise


def _check_same(run: Run, config: RunConfig) -> None:
    """Refuse a folder with another run."""
    saved = run.config()
    if saved is None:
        return
    if saved.get("arguments") is None:
        raise ValueError(f"{run.path}: holds a run of chemlab before 0.3; give another --out, or delete the folder")
    found = differences(filled(saved), config.model_dump(exclude_none=True))
    if list(found) == ["fingerprint"]:
        raise ValueError(
            f"{run.path}: scenario {config.scenario!r} has changed since this run was begun; "
            "delete the folder to begin anew, or give another --out"
        )
    if found:
        what = ", ".join(found.values())
        raise ValueError(
            f"{run.path}: holds a run with other arguments: {what}; give another --out, or delete the folder"
        )
