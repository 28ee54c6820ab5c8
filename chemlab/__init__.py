"""chemlab: a multi-agent chemistry laboratory for reinforcement-learning research."""

import contextlib

__version__ = "0.1.0"
__all__ = ["__version__"]


def _register() -> None:
    """Make the laboratory known to PettingZoo's registry, which is there from PettingZoo 1.27 on."""
    with contextlib.suppress(ImportError):
        from pettingzoo import aec_registry, register

        if "chemlab/Laboratory-v0" not in aec_registry:
            register("aec", "chemlab/Laboratory-v0", entry_point="chemlab.laboratory:env")


_register()
