"""The taskset of chemlab under a name that verifiers finds: it imports modules at the top level only."""

from chemlab.agents.verifiers_taskset import Laboratory, Seats

__all__ = ["Laboratory", "Seats"]
