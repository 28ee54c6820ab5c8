"""Registration of the environments with Gymnasium and PettingZoo.

A registry is filled as soon as its library is imported, before or after chemlab. ``import chemlab`` itself imports
neither, because that takes several times as long as everything else that a command such as ``chemlab --help`` needs.
Gymnasium has loaded no plugins by entry points since version 1.0, so an import hook is used.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

_BENCHES: dict[str, dict[str, str]] = {
    "WurtzReaction": {"scenario": "wurtz_dodecane", "bench": "rxn"},
    "FictitiousReaction": {"scenario": "fictitious", "bench": "rxn"},
    "WurtzExtraction": {"scenario": "wurtz_dodecane", "bench": "ext"},
    "SaltFromOilExtraction": {"scenario": "salt_from_oil", "bench": "ext"},
    "WurtzDistillation": {"scenario": "wurtz_dodecane", "bench": "dit"},
    "RealWurtzReaction": {"scenario": "wurtz_real", "bench": "rxn"},
    "RealWurtzExtraction": {"scenario": "wurtz_real", "bench": "ext"},
    "RealWurtzDistillation": {"scenario": "wurtz_real", "bench": "dit"},
    "BenzoicAcidCrystallization": {"scenario": "recrystallization", "bench": "cry"},
    "Bench": {"bench": "rxn"},
}


def _register_laboratory() -> None:
    """Register the laboratory with PettingZoo, which has registries from version 1.27 on."""
    with contextlib.suppress(ImportError):
        from pettingzoo import aec_registry, parallel_registry, register

        if "chemlab/Laboratory-v1" not in aec_registry:
            register("aec", "chemlab/Laboratory-v1", entry_point="chemlab.laboratory:env")
        if "chemlab/Laboratory-v1" not in parallel_registry:
            register("parallel", "chemlab/Laboratory-v1", entry_point="chemlab.laboratory:parallel_env")


def _register_views() -> None:
    """Register the environments of one role with Gymnasium, those of any scenario as version 1.

    Entry points are strings, so nothing heavy is imported.
    """
    from gymnasium.envs.registration import register, registry

    views: dict[str, tuple[str, str, dict[str, str]]] = {
        name: ("chemlab.envs.role_env:RoleEnv", "chemlab.envs.role_env:RoleVectorEnv", arguments)
        for name, arguments in _BENCHES.items()
    }
    for name, arguments in (("LabManager", {"agent": "manager_0"}), ("LabAgent", {})):
        views[name] = "chemlab.agents.background:role_env", "chemlab.agents.background:role_vector_env", arguments
    for name, (entry_point, vector_entry_point, arguments) in views.items():
        env_id = f"chemlab/{name}-v{0 if 'scenario' in arguments else 1}"
        if env_id not in registry:
            register(
                env_id,
                entry_point=entry_point,
                vector_entry_point=vector_entry_point,
                kwargs=arguments,
            )


_REGISTRIES: dict[str, Callable[[], None]] = {"gymnasium": _register_views, "pettingzoo": _register_laboratory}


class _ThenRegister:
    """Loader of a library that registers the environments after the library has been executed."""

    def __init__(self, loader: Any, register: Callable[[], None]) -> None:
        self._loader, self._register = loader, register

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)  # while a copy is being made
        return getattr(self._loader, name)

    def exec_module(self, module: ModuleType) -> None:
        """Execute the library with its own loader, then register."""
        module.__loader__ = self._loader
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        self._register()


class _Registering:
    """Finder of the libraries with registries, which delegates to the finders after it.

    Finding a library has no side effects, because it may be looked up without being imported
    (``importlib.util.find_spec``), or be imported again.
    """

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the specification of a library with a registry; None for anything else."""
        register = _REGISTRIES.get(name)
        if register is None or self not in sys.meta_path:
            return None
        for finder in sys.meta_path[sys.meta_path.index(self) + 1 :]:
            found = finder.find_spec(name, path, target) if hasattr(finder, "find_spec") else None
            if found is not None:
                loader: Any = found.loader
                if hasattr(loader, "exec_module"):
                    loader = _ThenRegister(loader, register)
                    found.loader = loader
                return found
        return None


def register_environments() -> None:
    """Fill the registries: at once for imported libraries, otherwise on their import."""
    for name, register in _REGISTRIES.items():
        if name in sys.modules:
            register()
    if not any(isinstance(finder, _Registering) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Registering())
