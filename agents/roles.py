"""Roles: agents of one role have equal spaces, so that one policy can play all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import gymnasium

    from chemlab.lab.engine import Laboratories

MANAGER_ROLE = "manager"


def role_of(agent: str) -> str:
    """Return the role of an agent (``rxn_0``): ``manager``, or its bench's key. The name of a role is its own role."""
    role, _, number = agent.rpartition("_")
    return role if role and number.isdigit() else agent


def chosen_roles(laboratories: Laboratories, roles: Sequence[str] | None) -> list[str]:
    """Return the chosen roles, or role, in the laboratory's order; None selects all. The only agent of a role may stand
    for it.

    Raises:
        ValueError: a role is unknown, or none is given.
    """
    every = [role_of(agent) for agent in laboratories.agents]
    known = list(dict.fromkeys(every))
    only = {agent: role_of(agent) for agent in laboratories.agents if every.count(role_of(agent)) == 1}
    given = [roles] if isinstance(roles, str) else roles
    wanted = known if given is None else [only.get(role, role) for role in given]
    if not wanted or set(wanted) - set(known):
        name = laboratories.scenario.name
        raise ValueError(f"roles: {name} has {', '.join(known)}; given {', '.join(wanted) or 'none'}")
    return [role for role in known if role in wanted]


def action_size(space: gymnasium.Space[Any]) -> int:
    """Return the length of a continuous action; 0 for discrete actions."""
    return int((space.shape or (0,))[0])
