"""chemlab: a multi-agent chemistry laboratory for reinforcement-learning research.

The names in ``__all__`` are the public API; each is imported on first use.
"""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .envs.registration import register_environments

if TYPE_CHECKING:
    from .config.loading import load_scenario
    from .envs.aec import env, raw_env
    from .envs.batch import BatchedLaboratory
    from .envs.parallel import parallel_env
    from .sandbox import Flask

__version__ = "0.2.0"
__all__ = ["BatchedLaboratory", "Flask", "__version__", "env", "load_scenario", "parallel_env", "raw_env"]

_MODULES = {
    "BatchedLaboratory": "envs.batch",
    "Flask": "sandbox",
    "env": "envs.aec",
    "load_scenario": "config.loading",
    "parallel_env": "envs.parallel",
    "raw_env": "envs.aec",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


def _find_mapped_folders() -> None:
    """In a checkout, ``agents`` and ``scenarios`` are beside this package: add their parent to its path."""
    here = Path(__file__).resolve().parent
    if not (here / "agents").is_dir() and (here.parent / "agents").is_dir():
        __path__.append(str(here.parent))


_find_mapped_folders()
register_environments()
