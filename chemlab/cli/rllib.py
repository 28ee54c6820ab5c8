"""Learning on a cluster: train-rllib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..agents.rllib.arguments import RllibArguments, folder_of, load_rllib_arguments
from .common import readable_errors
from .training import _command, _watched

__all__: list[str] = []


def _train_rllib(config: Path | None, folder: Path | None, quiet: bool, as_json: bool, flags: dict[str, Any]) -> None:
    with readable_errors():
        arguments = load_rllib_arguments(config, flags)
        from ..agents.rllib.train import train_rllib

        place = folder or Path("runs") / folder_of(arguments)
        _watched(place, quiet, as_json, lambda watcher: train_rllib(arguments, place, watcher))


_command(
    "train-rllib",
    RllibArguments,
    "scenario",
    """Train roles of a laboratory with Ray RLlib, here or on a cluster; an interrupted run goes on where it was.

    Returns are the laboratory's scores. A lost env runner is replaced. The run's folder is like that of train, with
    a policy for each role that plays without Ray: chemlab evaluate SCENARIO --policy FOLDER.
    """,
    "The run's folder. Default: runs/SCENARIO-rllib/ROLES/seed-SEED.",
    _train_rllib,
)
