"""chemlab: a multi-agent chemistry laboratory for reinforcement-learning research."""

__version__ = "0.1.0"
__all__ = ["__version__"]
