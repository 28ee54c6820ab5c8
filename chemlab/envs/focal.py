"""Former names of :mod:`chemlab.envs.role_env`, which are accepted for one release."""

from .role_env import Policies
from .role_env import RoleEnv as FocalEnv
from .role_env import RoleVectorEnv as FocalVectorEnv

__all__ = ["FocalEnv", "FocalVectorEnv", "Policies"]
