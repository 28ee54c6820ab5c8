"""Role: the one interface to the agents of a laboratory, which the manager and every bench implement."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ..kernels.arrays import BoolArray, FloatArray, IntArray, MaskArray, ObservationArray, StreamArray

if TYPE_CHECKING:
    from ..lab.engine import Laboratories
    from .bench import Bench
    from .manager_role import Manager

Workplace: TypeAlias = "Bench | Manager"
"""The static part of a role, without arrays."""

VESSEL_TEMPERATURES_K = 200.0, 800.0
"""Temperatures that observations and the global state show as 0 and 1."""


class Quantity(NamedTuple):
    """One kind of quantity of the global state, of some laboratories."""

    name: str
    unit: str
    meaning: str
    values: npt.NDArray[Any]
    """[B, ...] in ``unit``"""
    low: float = 0.0
    high: float = 1.0


def one_hot(indices: IntArray, size: int) -> FloatArray:
    """[..., size] one-hot vectors."""
    return np.asarray((indices[..., None] == np.arange(size)).astype(np.float64))


class Role(ABC):
    """One agent in N laboratories: its observations, its actions, and their effects.

    Laboratories, environments, records and pictures use this interface only; no index of an agent has a meaning of
    its own. In every method ``members`` [B] are the laboratories that it is about.

    Attributes:
        labs: laboratories of the role.
        name: name of the agent.
        index: index of the agent in ``labs.roles``, and its row in the arrays of rewards, costs and scores.
        cursor: value of :attr:`~.manager_state.ManagerState.cursor` that gives it the turn.
        workplace: static part of the role.
        resting_action: discrete action that is shown as legal without the turn; -1 where actions are continuous.
    """

    def __init__(self, labs: Laboratories, name: str, cursor: int, workplace: Workplace, resting_action: int) -> None:
        self.labs, self.name, self.cursor, self.workplace = labs, name, cursor, workplace
        self.index = labs.agents.index(name)
        self.resting_action = resting_action
        self.key, self.kind, self.channels = workplace.key, workplace.kind, workplace.channels
        self.observation_space, self.action_space = workplace.observation_space, workplace.action_space
        self.action_count = workplace.action_count

    @property
    def action_meanings(self) -> list[str]:
        """Meaning of each discrete action, or of each number of a continuous one."""
        return self.workplace.action_meanings

    @property
    @abstractmethod
    def turns_had(self) -> IntArray:
        """[N] turns that it has had: the manager in this episode, a bench in this experiment."""

    @property
    @abstractmethod
    def illegal(self) -> BoolArray:
        """[N] whether its last action was masked, and so had no effect."""

    @property
    @abstractmethod
    def events(self) -> FloatArray:
        """[N, E] safety events of its last action."""

    @property
    @abstractmethod
    def stream(self) -> StreamArray:
        """[N, 1] its random stream."""

    @abstractmethod
    def observe(self, members: IntArray, out: ObservationArray, rows: IntArray | None = None) -> None:
        """Write its observations into ``out`` [B, size], or into ``rows`` [B] of ``out``."""

    @abstractmethod
    def mask(self, members: IntArray, out: MaskArray) -> None:
        """Write its legal actions into ``out`` [B, actions]; roles with continuous actions have none."""

    @abstractmethod
    def act(self, members: IntArray, actions: npt.NDArray[Any]) -> None:
        """Carry out one action [B] or [B, n] in each laboratory of ``members``, which all give it the turn."""

    @abstractmethod
    def settle(self, members: IntArray, result: FloatArray, charges: FloatArray) -> None:
        """Add to its reward what the end of an episode means for it.

        Args:
            members: [B] laboratories whose episodes are over.
            result: [B] scores of the episodes.
            charges: [B] sums of the costs that are part of them.
        """

    def checked(self, action: Any) -> npt.NDArray[Any]:
        """The action as an array of one member.

        Raises:
            ValueError: it is outside the action space.
        """
        return self.workplace.checked(self.name, action)

    def goal(self, member: int) -> str:
        """Goal of its experiment; nothing for the manager, whose orders have goals."""
        return ""

    def reading(self, action: Any, member: int) -> dict[str, Any] | None:
        """The reading that its last ``action`` has taken: ``slot``, ``instrument`` and ``values``; None if none."""
        return None

    def accounts(self, which: int | slice) -> dict[str, npt.NDArray[Any]]:
        """Further entries of its infos, of one laboratory or, with one more axis, of several."""
        return {}

    def state(self, members: IntArray) -> list[Quantity]:
        """Its own part of the global state."""
        return []

    def condition(self, members: IntArray) -> list[Quantity]:
        """Condition of its apparatus, for the global state."""
        return []

    @abstractmethod
    def arrays(self, member: int) -> list[npt.NDArray[Any]]:
        """Views of all its arrays of one laboratory that the rest of an episode depends on."""
