"""Trained policies stored in files, by role: training runs, checkpoints and exported weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chemlab.envs.players import Policy, as_policy
from chemlab.roles.base import Workplace

from .former_names import SAMPLED, split_way
from .pretrained import Seed, fitted, load_pretrained, pretrained_files, pretrained_names
from .roles import role_of
from .runs import Run


@dataclass(frozen=True)
class Saved:
    """Stored policies of one path.

    Attributes:
        load: by role (a bench's key, or ``manager``): a function of a workplace and a seed that makes the policy, or
            raises ValueError if it does not fit.
        background: policies of the roles that did not learn.
    """

    load: dict[str, Callable[..., Policy]]
    background: str = "scripted"


def _exported(name_or_path: str | Path, way: str | None) -> Callable[..., Policy]:
    def load(workplace: Workplace, seed: Seed = None) -> Policy:
        return fitted(load_pretrained(name_or_path).as_played(way, seed), workplace)

    return load


def _learner(folder: Path, algo: str, path: Path, way: str | None) -> Callable[..., Policy]:
    """Return a loader of a Stable-Baselines3 learner; it is masked only if trained with masks."""

    def load(workplace: Workplace, seed: Seed = None) -> Policy:
        from .learners import load_learner  # Stable-Baselines3 is optional

        return _fitting(load_learner(folder, algo), path, workplace, way)

    return load


def _fitting(model: Any, path: Path, workplace: Workplace, way: str | None) -> Policy:
    """Return a learner as a policy.

    Raises:
        ValueError: the learner was trained for other spaces, or is to be sampled.
    """
    if way == SAMPLED:
        raise ValueError(f"policy: {path}:{way}: only exported policies are sampled; export it, or leave out :{way}")
    trained, needed = ((having.observation_space, having.action_space) for having in (model, workplace))
    if trained != needed:
        raise ValueError(
            f"policy: {path}: was trained for {trained[0]} and {trained[1]}; "
            f"{workplace.key!r} of {workplace.scenario.name} has {needed[0]} and {needed[1]}"
        )
    return as_policy(model)


def _cards(folder: Path, way: str | None) -> dict[str, Callable[..., Policy]]:
    """Return loaders of a folder's exported policies by role."""
    return {
        load_pretrained(file).card.bench: _exported(file, way)
        for file in sorted(folder.glob("*.safetensors"))
        if file.with_suffix(".json").exists()
    }


def is_saved(name: str) -> bool:
    """Return True if a policy's name is a path or the name of a bundled policy; ``:sampled`` may follow it."""
    name, _ = split_way(name)
    path = Path(name)
    return (
        name in pretrained_names()
        or path.exists()
        or path.suffix in (".safetensors", ".json")
        or Path(f"{name}.safetensors").exists()
    )


def _is_exported(path: Path) -> bool:
    return path.suffix in (".safetensors", ".json") or path.with_name(f"{path.name}.safetensors").exists()


def _run_of(path: Path) -> tuple[Run, Path | None]:
    """Return the run of a resolved path (its own, or that of its checkpoint), and the checkpoint."""
    folder = path.parent if path.suffix == ".zip" else path
    run = Run(folder.parents[1] if folder.parent.name == "checkpoints" else folder)
    return run, folder if folder != run.path else run.checkpoint("best") or run.checkpoint("last")


def saved_files(name: str) -> list[Path]:
    """Return the files from which :func:`find_saved` loads policies."""
    name, _ = split_way(name)
    path = Path(name).resolve()
    if name in pretrained_names() or _is_exported(path):
        return list(pretrained_files(name))
    run, folder = _run_of(path)
    files = [] if folder is None and not path.is_dir() else sorted((folder or path).iterdir())
    files = [run.config_file, *(file for file in files if file.suffix in (".safetensors", ".json", ".zip"))]
    return [file for file in files if file.is_file()]


def find_saved(name: str) -> Saved:
    """Find the policies of a path or a bundled policy's name.

    The path is a training run (its best checkpoint is used), a checkpoint (folder or ``model.zip``), exported weights
    (``.safetensors``, with or without the suffix) or a folder of these. ``:greedy`` or ``:sampled`` may follow it.

    Raises:
        ValueError: the path holds no policy.
    """
    name, way = split_way(name)
    if name in pretrained_names():
        return Saved({load_pretrained(name).card.bench: _exported(name, way)})
    path = Path(name).resolve()
    if _is_exported(path):
        card = load_pretrained(path).card
        return Saved({card.bench: _exported(path, way)}, card.background or "scripted")
    run, folder = _run_of(path)
    config = run.config()
    if config is None:
        cards = _cards(path, way) if path.is_dir() else {}
        if cards:
            return Saved(cards)
    if config is None or folder is None:
        what = run.config_file if config is None else run.checkpoints
        raise ValueError(f"policy: {name}: neither a training run nor a checkpoint of one ({what} is missing or empty)")
    background = str(config.get("background") or "scripted")
    cards = _cards(folder, way)
    if cards:
        return Saved(cards, background)
    if (folder / "model.zip").exists():
        role = role_of(str(config.get("bench", "")))
        return Saved({role: _learner(folder, str(config.get("algo")), path, way)}, background)
    raise ValueError(f"policy: {name}: was trained by a version with other learners; train it again")
