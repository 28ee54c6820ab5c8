"""Policies that training has left in files, by the role they are for: runs, checkpoints, exported weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from chemlab.laboratory.policy import Policy

from .pretrained import Role, load_pretrained, pretrained_names
from .roles import role_of
from .training.runs import Run

__all__ = ["Saved", "find_saved", "is_saved"]


@dataclass(frozen=True)
class Saved:
    """What a path holds.

    Attributes:
        load: by role (a bench's key, or ``manager``): makes its policy for what it is to operate; ValueError if it does
            not fit.
        background: who played the roles that did not learn.
    """

    load: dict[str, Callable[[Role], Policy]]
    background: str = "heuristic"


def _exported(name_or_path: str | Path) -> Callable[[Role], Policy]:
    def load(role: Role) -> Policy:
        policy = load_pretrained(name_or_path)
        policy.check(role)
        return policy

    return load


def _learner(folder: Path, algo: str, path: Path) -> Callable[[Role], Policy]:
    """One of Stable-Baselines3's learners: not masked unless it learned with masks."""

    def load(role: Role) -> Policy:
        from .training.learn import LearnerPolicy, load_learner

        model = load_learner(folder, algo)
        _check_spaces(path, model, role)
        return LearnerPolicy(model)

    return load


def _member(folder: Path, name: str, path: Path) -> Callable[[Role], Policy]:
    """One role of a joint run's checkpoint."""

    def load(role: Role) -> Policy:
        from .training.joint import load_team
        from .training.learn import LearnerPolicy

        model = load_team(folder)[name]
        _check_spaces(path, model, role)
        return LearnerPolicy(model)

    return load


def _check_spaces(path: Path, model: object, role: Role) -> None:
    trained = getattr(model, "observation_space", None), getattr(model, "action_space", None)
    if trained != (role.observation_space, role.action_space):
        raise ValueError(
            f"policy: {path}: was trained for {trained[0]} and {trained[1]}; "
            f"{role.key!r} of {role.scenario.name} has {role.observation_space} and {role.action_space}"
        )


def _cards(folder: Path) -> dict[str, Callable[[Role], Policy]]:
    """Exported policies of a folder, by role."""
    return {
        load_pretrained(file).card.bench: _exported(file)
        for file in sorted(folder.glob("*.safetensors"))
        if file.with_suffix(".json").exists()
    }


def is_saved(name: str) -> bool:
    """Whether a policy's name is a path, or that of one which comes with chemlab."""
    path = Path(name)
    return (
        name in pretrained_names()
        or path.exists()
        or path.suffix in (".safetensors", ".json")
        or Path(f"{name}.safetensors").exists()
    )


def find_saved(name: str) -> Saved:
    """What a path holds: a training run (its best checkpoint), a checkpoint (folder or ``model.zip``), exported weights
    (``.safetensors``, with or without the suffix) or a folder of them; or a policy that comes with chemlab, by name.

    Raises:
        ValueError: nothing that plays.
    """
    if name in pretrained_names():
        return Saved({load_pretrained(name).card.bench: _exported(name)})
    path = Path(name).resolve()  # a checkpoint is known by the folders it stands in, and '.' has no name
    if path.suffix in (".safetensors", ".json") or path.with_name(f"{path.name}.safetensors").exists():
        return Saved({load_pretrained(path).card.bench: _exported(path)})
    folder: Path | None = path.parent if path.suffix == ".zip" else path
    assert folder is not None
    run = Run(folder.parents[1] if folder.parent.name == "checkpoints" else folder)
    if folder == run.path:
        folder = run.checkpoint("best") or run.checkpoint("last")
    config = run.config()
    if config is None:
        cards = _cards(path) if path.is_dir() else {}
        if cards:
            return Saved(cards)
    if config is None or folder is None:
        what = run.config_file if config is None else run.checkpoints
        raise ValueError(f"policy: {name}: neither a training run nor a checkpoint of one ({what} is missing or empty)")
    background = str(config.get("background") or "heuristic")
    cards = _cards(folder)
    if cards:
        return Saved(cards, background)
    if (folder / "model.zip").exists():
        bench = str(config.get("bench", ""))  # a bench's key, or in a laboratory an agent's id
        role = role_of(bench) if bench.rpartition("_")[2].isdigit() else bench
        return Saved({role: _learner(folder, str(config["algo"]), path)}, background)
    members = {file.stem.partition(".")[0] for file in folder.glob("*.zip")}
    return Saved({role: _member(folder, role, path) for role in sorted(members)}, background)
