"""Environments by their names in Gymnasium's and PettingZoo's registries.

A registry is filled when its library is imported, by whoever does: ``import chemlab`` alone imports neither, so
commands that play nothing start at once.
"""

from __future__ import annotations

import contextlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

__all__ = ["register_environments"]

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
    "Bench": {},
}


def _register_laboratory() -> None:
    """Make the laboratory known to PettingZoo's registries, which are there from PettingZoo 1.27 on."""
    with contextlib.suppress(ImportError):
        from pettingzoo import aec_registry, parallel_registry, register

        if "chemlab/Laboratory-v0" not in aec_registry:
            register("aec", "chemlab/Laboratory-v0", entry_point="chemlab.laboratory:env")
        if "chemlab/Laboratory-v0" not in parallel_registry:
            register("parallel", "chemlab/Laboratory-v0", entry_point="chemlab.laboratory:parallel_env")


def _register_views() -> None:
    """Make the single-bench environments, and the laboratory as one of its agents sees it, known to Gymnasium; entry
    points are strings, so nothing heavy is imported."""
    from gymnasium.envs.registration import register, registry

    views: dict[str, tuple[str, str, dict[str, str]]] = {
        name: ("chemlab.laboratory.bench_env:BenchEnv", "chemlab.laboratory.bench_env:BenchVectorEnv", arguments)
        for name, arguments in _BENCHES.items()
    }
    for name, arguments in (("LabManager", {"agent": "manager_0"}), ("LabAgent", {})):
        views[name] = "chemlab.agents.background:focal_env", "chemlab.agents.background:focal_vector_env", arguments
    for name, (entry_point, vector_entry_point, arguments) in views.items():
        if f"chemlab/{name}-v0" not in registry:
            register(
                f"chemlab/{name}-v0",
                entry_point=entry_point,
                vector_entry_point=vector_entry_point,
                kwargs=arguments,
            )


class _Afterwards(importlib.abc.MetaPathFinder):
    """Calls something once a module has been imported."""

    def __init__(self, calls: dict[str, Callable[[], None]]) -> None:
        self.calls = calls

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        call = self.calls.pop(name, None)
        if call is None:
            return None
        spec = importlib.util.find_spec(name)  # as everyone else finds it: this one does not, any more
        loader: Any = spec.loader if spec is not None else None
        if loader is not None:
            execute = loader.exec_module

            def execute_and_call(module: ModuleType) -> None:
                execute(module)
                call()

            loader.exec_module = execute_and_call
        return spec


def register_environments() -> None:
    """Fill the registries: at once where a library has been imported, else when it is."""
    calls = {"pettingzoo": _register_laboratory, "gymnasium": _register_views}
    for name in [name for name in calls if name in sys.modules]:
        calls.pop(name)()
    if calls:
        sys.meta_path.insert(0, _Afterwards(calls))
