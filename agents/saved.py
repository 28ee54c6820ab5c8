"""Trained policies stored in files, by role: training runs, checkpoints and exported weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

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
        load: loaders by role (a bench's key, or ``manager``). A loader is called with a workplace and a seed; it
            returns the policy, or raises ValueError if the policy does not fit.
        background: policy of the roles that did not learn.
    """

    load: dict[str, Callable[..., Policy]]
    background: str = "scripted"


def _load_exported(name_or_path: str | Path, way: str | None, workplace: Workplace, seed: Seed = None) -> Policy:
    return fitted(load_pretrained(name_or_path).as_played(way, seed), workplace)


def _load_learner(
    folder: Path, algo: str, path: Path, way: str | None, workplace: Workplace, seed: Seed = None
) -> Policy:
    """Load a Stable-Baselines3 learner; it is masked only if trained with masks.

    Raises:
        ValueError: the learner was trained for other spaces, or is to be sampled.
    """
    from .learners import load_learner  # Stable-Baselines3 is optional

    model = load_learner(folder, algo)
    if way == SAMPLED:
        raise ValueError(f"policy: {path}:{way}: only exported policies are sampled; export it, or leave out :{way}")
    trained, needed = ((owner.observation_space, owner.action_space) for owner in (model, workplace))
    if trained != needed:
        raise ValueError(
            f"policy: {path}: was trained for {trained[0]} and {trained[1]}; "
            f"{workplace.key!r} of {workplace.scenario.name} has {needed[0]} and {needed[1]}"
        )
    return as_policy(model)


def _exported_in(folder: Path, way: str | None) -> dict[str, Callable[..., Policy]]:
    """Return loaders of a folder's exported policies by role."""
    return {
        load_pretrained(file).card.bench: partial(_load_exported, file, way)
        for file in sorted(folder.glob("*.safetensors"))
        if file.with_suffix(".json").exists()
    }


def is_saved(name: str) -> bool:
    """Return True if a policy's name is a path or the name of a bundled policy; ``:sampled`` may follow it."""
    name, _ = split_way(name)
    return name in pretrained_names() or Path(name).exists() or _is_exported(Path(name))


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
        return Saved({load_pretrained(name).card.bench: partial(_load_exported, name, way)})
    path = Path(name).resolve()
    if _is_exported(path):
        card = load_pretrained(path).card
        return Saved({card.bench: partial(_load_exported, path, way)}, card.background or "scripted")
    run, folder = _run_of(path)
    config = run.config()
    if config is None:
        exported = _exported_in(path, way) if path.is_dir() else {}
        if exported:
            return Saved(exported)
    if config is None or folder is None:
        lacking = run.config_file if config is None else run.checkpoints
        raise ValueError(
            f"policy: {name}: neither a training run nor a checkpoint of one ({lacking} is missing or empty)"
        )
    background = str(config.get("background") or "scripted")
    exported = _exported_in(folder, way)
    if exported:
        return Saved(exported, background)
    if (folder / "model.zip").exists():
        role = role_of(str(config.get("bench", "")))
        return Saved({role: partial(_load_learner, folder, str(config.get("algo")), path, way)}, background)
    raise ValueError(f"policy: {name}: was trained by a version with other learners; train it again")
