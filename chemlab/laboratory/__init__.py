"""The laboratory as environments: ``from chemlab.laboratory import env, raw_env, parallel_env``."""

from .aec import env, raw_env
from .parallel import parallel_env
from .plain import plain_infos

__all__ = ["env", "parallel_env", "plain_infos", "raw_env"]
