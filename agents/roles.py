"""Roles of a laboratory's agents: agents of one role see and do the same, so that one policy can play them all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from chemlab.lab.engine import Laboratories

__all__ = ["MANAGER_ROLE", "chosen_roles", "role_of"]

MANAGER_ROLE = "manager"


def role_of(agent: str) -> str:
    """The role of an agent's id (``rxn_0``): ``manager``, or its bench's key. A role's own name stays."""
    role, _, number = agent.rpartition("_")
    return role if role and number.isdigit() else agent


def chosen_roles(laboratories: Laboratories, roles: Sequence[str] | None) -> list[str]:
    """Roles by name, in the laboratory's order; None: all it has.

    Raises:
        ValueError: a role that the scenario does not have, or none at all.
    """
    known = list(dict.fromkeys(role_of(agent) for agent in laboratories.agents))
    wanted = known if roles is None else list(roles)
    if not wanted or set(wanted) - set(known):
        name = laboratories.scenario.name
        raise ValueError(f"roles: {name} has {', '.join(known)}; given {', '.join(wanted) or 'none'}")
    return [role for role in known if role in wanted]
