"""chemlab: a multi-agent chemistry laboratory for reinforcement-learning research."""

from pathlib import Path

from .envs.registration import register_environments

__version__ = "0.2.0"
__all__ = ["__version__"]


def _find_mapped_folders() -> None:
    """In a checkout ``agents`` and ``scenarios`` stand beside this package and not in it: let them be found there."""
    here = Path(__file__).resolve().parent
    if not (here / "agents").is_dir() and (here.parent / "agents").is_dir():
        __path__.append(str(here.parent))


_find_mapped_folders()
register_environments()
