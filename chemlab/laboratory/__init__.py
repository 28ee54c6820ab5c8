"""The laboratory as environments: ``from chemlab.laboratory import env, raw_env``."""

from .aec import env, raw_env

__all__ = ["env", "raw_env"]
