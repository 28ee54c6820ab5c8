"""chemlab: a multi-agent chemistry laboratory for reinforcement-learning research."""

import contextlib
from pathlib import Path

__version__ = "0.2.0"
__all__ = ["__version__"]


def _find_mapped_folders() -> None:
    """In a checkout ``agents`` and ``scenarios`` stand beside this package and not in it: let them be found there."""
    here = Path(__file__).resolve().parent
    if not (here / "agents").is_dir() and (here.parent / "agents").is_dir():
        __path__.append(str(here.parent))


def _register_laboratory() -> None:
    """Make the laboratory known to PettingZoo's registries, which are there from PettingZoo 1.27 on."""
    with contextlib.suppress(ImportError):
        from pettingzoo import aec_registry, parallel_registry, register

        if "chemlab/Laboratory-v0" not in aec_registry:
            register("aec", "chemlab/Laboratory-v0", entry_point="chemlab.laboratory:env")
        if "chemlab/Laboratory-v0" not in parallel_registry:
            register("parallel", "chemlab/Laboratory-v0", entry_point="chemlab.laboratory:parallel_env")


def _register_benches() -> None:
    """Make the single-bench environments known to Gymnasium; entry points are strings, so nothing heavy is imported."""
    from gymnasium.envs.registration import register, registry

    benches: dict[str, dict[str, str]] = {
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
    for name, arguments in benches.items():
        if f"chemlab/{name}-v0" not in registry:
            register(
                f"chemlab/{name}-v0",
                entry_point="chemlab.laboratory.bench_env:BenchEnv",
                vector_entry_point="chemlab.laboratory.bench_env:BenchVectorEnv",
                kwargs=arguments,
            )


def _register_views() -> None:
    """Make the laboratory as one of its agents sees it known to Gymnasium."""
    from gymnasium.envs.registration import register, registry

    for name, arguments in (("LabManager", {"agent": "manager_0"}), ("LabAgent", {})):
        if f"chemlab/{name}-v0" not in registry:
            register(
                f"chemlab/{name}-v0",
                entry_point="chemlab.agents.background:focal_env",
                vector_entry_point="chemlab.agents.background:focal_vector_env",
                kwargs=arguments,
            )


_find_mapped_folders()
_register_laboratory()
_register_benches()
_register_views()
