"""What a run on RLlib is: one dataclass, TOML files and flags. Ray is not imported here."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from ..training.arguments import _argument as argument
from ..training.arguments import merged

__all__ = ["LABEL", "PLACE", "RllibArguments", "check_arguments", "command_of", "folder_of", "load_rllib_arguments"]

LABEL = "rllib"
"""What figures call the algorithm."""

PLACE = ("address", "runners")
"""Arguments that say where a run is computed, not what it learns: a run may go on in another place."""


@dataclass(frozen=True)
class RllibArguments:
    """Everything that decides what a run on RLlib learns, and where; ``chemlab train-rllib --help`` is made from
    this."""

    scenario: str = argument("wurtz_dodecane", "Scenario: a shipped name or a path.")
    roles: tuple[str, ...] | None = argument(
        None, "Roles that learn: manager and bench keys; repeat the option. Default: all."
    )
    background: str = argument("heuristic", "Who plays the roles that do not learn, by name.")
    rewards: str | None = argument(None, "Another reward mix than the scenario's.")
    steps: int = argument(1_000_000, "Turns of learning agents, all laboratories together.")
    address: str | None = argument(
        None, "Ray cluster: HOST:PORT, or auto for the one that runs on this machine. Default: a Ray of its own."
    )
    runners: int = argument(1, "Env runners: processes that play, anywhere in the cluster, a CPU each.")
    envs: int = argument(8, "Laboratories in each env runner.")
    batch: int = argument(4096, "Turns gathered before each update, all runners and roles together.")
    seed: int = argument(0, "Seed of networks, exploration and laboratories.")
    gamma: float = argument(0.99, "Discount a turn of a bench's agent.")
    manager_gamma: float = argument(1.0, "Discount a decision of the manager.")
    gae_lambda: float = argument(0.95, "GAE lambda.")
    learning_rate: float = argument(3e-4, "Learning rate.")
    ent_coef: float = argument(0.01, "Weight of the entropy of discrete actions.")
    clip_range: float = argument(0.2, "PPO's clip range.")
    batch_size: int = argument(256, "Minibatch of each role.")
    epochs: int = argument(10, "PPO's passes over a batch.")
    evaluations: int = argument(10, "Evaluations during training, evenly spread, a checkpoint with each.")
    eval_episodes: int = argument(20, "Episodes a goal in each of them.")
    final_episodes: int = argument(100, "Episodes a goal in the evaluation at the end.")


def load_rllib_arguments(path: Path | None, flags: Mapping[str, Any]) -> RllibArguments:
    """Arguments of a run on RLlib from a TOML file and flags, which win.

    Raises:
        DataError: the file is missing or not TOML.
        ValueError: unknown field, or a value of the wrong type or out of bounds.
    """
    arguments = merged(RllibArguments, path, flags, "train-rllib")
    check_arguments(arguments, "train-rllib")
    return arguments


def check_arguments(arguments: RllibArguments, where: str) -> None:
    """Refuse numbers that are out of bounds.

    Raises:
        ValueError: which one, and its bound.
    """
    a = arguments
    counts = ("steps", "runners", "envs", "batch", "batch_size", "epochs", "evaluations", "eval_episodes")
    for name in (*counts, "final_episodes"):
        if getattr(a, name) < 1:
            raise ValueError(f"{where}: {name}: must be at least 1, given {getattr(a, name)}")
    if a.seed < 0:
        raise ValueError(f"{where}: seed: must be at least 0, given {a.seed}")
    if a.learning_rate <= 0.0:
        raise ValueError(f"{where}: learning_rate: must be above 0, given {a.learning_rate}")
    if a.batch < a.runners * a.envs:
        raise ValueError(
            f"{where}: batch: must be at least a turn in each of the {a.runners * a.envs} laboratories "
            f"(runners x envs), given {a.batch}"
        )
    if a.batch_size > a.batch:
        raise ValueError(f"{where}: batch_size: must be at most batch, {a.batch}, given {a.batch_size}")


def folder_of(arguments: RllibArguments) -> Path:
    """Where a run stands in a folder of results: scenario, who learns, seed."""
    return Path(
        f"{Path(arguments.scenario).stem}-rllib", "-".join(arguments.roles or ("all",)), f"seed-{arguments.seed}"
    )


def command_of(arguments: RllibArguments) -> str:
    """The command that trains it again."""
    words = ["chemlab", "train-rllib", arguments.scenario]
    default = asdict(RllibArguments())
    for f in fields(arguments):
        value = getattr(arguments, f.name)
        if f.name == "scenario" or f.name in PLACE or value == default[f.name]:
            continue
        for item in value if isinstance(value, tuple) else (value,):
            words += [f"--{f.name.replace('_', '-')}", str(item)]
    return shlex.join(words)
