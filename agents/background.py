"""One role of the laboratory as an environment, with background policies by name; see :mod:`chemlab.envs.role_env`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy.typing as npt

from chemlab.config.scenario import MANAGER_AGENT
from chemlab.envs.players import Players
from chemlab.envs.role_env import RoleEnv, RoleVectorEnv
from chemlab.kernels.arrays import IntArray
from chemlab.lab.engine import Laboratories

from .policies import agent_policy
from .roles import role_of

Background = str | Mapping[str, Any]
"""Policies of other agents: a name for all; or a name, policy, model or function by agent or role, else scripted."""


def role_env(
    scenario: Any = "wurtz_dodecane", agent: str = MANAGER_AGENT, background: Background = "scripted", **arguments: Any
) -> RoleEnv:
    """Return the laboratory for one agent.

    Args:
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        agent: name of the acting agent.
        background: policies of the others.
        arguments: further arguments of :class:`~chemlab.envs.role_env.RoleEnv` (``rewards``, ``render_mode``, ...).

    Raises:
        DataError: the scenario is invalid or unknown.
        ValueError: the agent, a policy or the render mode is unknown.
        TypeError: a background policy is not a policy.
    """
    return RoleEnv(scenario, agent, background_policies(background, agent), **arguments)


def role_vector_env(
    num_envs: int = 1,
    scenario: Any = "wurtz_dodecane",
    agent: str = MANAGER_AGENT,
    background: Background = "scripted",
    **arguments: Any,
) -> RoleVectorEnv:
    """Return a batch of ``num_envs`` laboratories for one agent; otherwise as :func:`role_env`.

    Args:
        num_envs, scenario, agent, background: see :func:`role_env`.
        arguments: further arguments of :class:`~chemlab.envs.role_env.RoleVectorEnv` (``autoreset_mode``, ...).
    """
    return RoleVectorEnv(num_envs, scenario, agent, background_policies(background, agent), **arguments)


def background_policies(background: Background, learner: str | None = None) -> Callable[[Laboratories], dict[str, Any]]:
    """Return a function that makes the policies of all agents of some laboratories as named by ``background``.

    Raises (when called):
        ValueError: a policy or an agent is unknown, or a policy is given for the ``learner`` alone, which has none.
    """

    def choose(laboratories: Laboratories) -> dict[str, Any]:
        given = {} if isinstance(background, str) else dict(background)
        roles = {agent: role_of(agent) for agent in laboratories.agents}
        unknown = set(given) - set(roles) - set(roles.values())
        if unknown:
            raise ValueError(
                f"background: no agent is called {', '.join(sorted(unknown))}; agents: {', '.join(laboratories.agents)}"
            )
        idle = [word for word in given if [agent for agent in roles if word in (agent, roles[agent])] == [learner]]
        if idle:
            raise ValueError(
                f"background: {learner} is played by the caller, so it has no policy; omit {', '.join(idle)}"
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
    """Make the players of the roles that do not learn.

    Args:
        laboratories: the laboratories.
        learning: roles played by the caller.
        background: policies of the others, by name (see :func:`~.policies.make_policies`).
        act: as for :class:`~chemlab.envs.players.Players`.

    Raises:
        ValueError: a policy is unknown or does not fit.
    """
    policies = [
        None if role_of(agent) in learning else agent_policy(background, laboratories, number)
        for number, agent in enumerate(laboratories.agents)
    ]
    return Players(laboratories, policies, act)
