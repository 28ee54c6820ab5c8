"""The laboratory for one of its agents, with background policies by name; see :mod:`chemlab.envs.focal`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy.typing as npt

from chemlab.envs.focal import FocalEnv, FocalVectorEnv, Policies
from chemlab.envs.players import Players
from chemlab.kernels.arrays import IntArray
from chemlab.lab.engine import MANAGER_AGENT, Laboratories

from .policies import agent_policy
from .roles import role_of

__all__ = ["Background", "background_players", "focal_env", "focal_vector_env"]

Background = str | Mapping[str, Any]
"""Policies of the other agents: a policy's name for all of them, or a name, a policy, a model or a function by agent id
(``rxn_0``) or role (``rxn``, ``manager``); scripted policies play all others."""


def focal_env(
    scenario: Any = "wurtz_dodecane", agent: str = MANAGER_AGENT, background: Background = "scripted", **arguments: Any
) -> FocalEnv:
    """The laboratory for one agent.

    Args:
        scenario: a shipped name, a path to a TOML file, or a loaded scenario.
        agent: id of the agent that acts.
        background: who plays the others.
        arguments: more of :class:`~chemlab.envs.focal.FocalEnv`'s (``rewards``, ``render_mode``, ...).

    Raises:
        DataError: the scenario is wrong or unknown.
        ValueError: unknown agent, policy or render mode.
        TypeError: a background policy is none.
    """
    return FocalEnv(scenario, agent, background_policies(background), **arguments)


def focal_vector_env(
    num_envs: int = 1,
    scenario: Any = "wurtz_dodecane",
    agent: str = MANAGER_AGENT,
    background: Background = "scripted",
    **arguments: Any,
) -> FocalVectorEnv:
    """A batch of laboratories for one agent; ``num_envs`` of them, else as :func:`focal_env`.

    Args:
        num_envs, scenario, agent, background: see :func:`focal_env`.
        arguments: more of :class:`~chemlab.envs.focal.FocalVectorEnv`'s (``autoreset_mode``, ``copy``, ...).
    """
    return FocalVectorEnv(num_envs, scenario, agent, background_policies(background), **arguments)


def background_policies(background: Background) -> Policies:
    """A function that gives every agent of some laboratories the policy that ``background`` names.

    Raises (when called):
        ValueError: unknown policy, or a name that is no agent's.
    """

    def choose(laboratories: Laboratories) -> dict[str, Any]:
        given = {} if isinstance(background, str) else dict(background)
        roles = {agent: role_of(agent) for agent in laboratories.agents}
        unknown = set(given) - set(roles) - set(roles.values())
        if unknown:
            raise ValueError(
                f"background: no agent is called {', '.join(sorted(unknown))}; agents: {', '.join(laboratories.agents)}"
            )
        chosen = {}
        for number, (agent, role) in enumerate(roles.items()):
            fallback = background if isinstance(background, str) else "scripted"
            policy = given.get(agent, given.get(role, fallback))
            chosen[agent] = agent_policy(policy, laboratories, number) if isinstance(policy, str) else policy
        return chosen

    return choose


def background_players(
    laboratories: Laboratories,
    learning: Collection[str],
    background: str,
    act: Callable[[int, IntArray, npt.NDArray[Any]], None] | None = None,
) -> Players:
    """Make the players of the roles that are not trained.

    Args:
        laboratories: where they play.
        learning: the roles that somebody else moves.
        background: the others' policy, by name (see :func:`~.policies.make_policies`).
        act: as for :class:`~chemlab.envs.players.Players`.

    Raises:
        ValueError: unknown policy, or one that does not fit.
    """
    policies = [
        None if role_of(agent) in learning else agent_policy(background, laboratories, number)
        for number, agent in enumerate(laboratories.agents)
    ]
    return Players(laboratories, policies, act)
