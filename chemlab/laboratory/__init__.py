"""The laboratory as environments: ``from chemlab.laboratory import env, raw_env, parallel_env``."""

from ..envs.aec import env, raw_env
from ..envs.parallel import parallel_env

__all__ = ["env", "parallel_env", "raw_env"]
