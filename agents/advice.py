"""Learning with advice: an agent sees, besides its observation, what another policy would play in its place.

It can follow the advice from its first turn on, and has only to learn where something else is better (residual policy
learning: Silver et al., 2018, arXiv:1812.06298, and Johannink et al., 2018, arXiv:1812.03201, add actions of numbers;
here, where actions are chosen, the advice is something that is seen).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.envs.players import Policy
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray

__all__ = ["AdvisedPolicy", "Advisor", "with_advice"]


def with_advice(observation: ObservationArray, advice: IntArray, actions: int) -> ObservationArray:
    """[B, size + actions] observations that end with the advice: a number for each action, 1 for what is advised."""
    shown = np.zeros((len(observation), actions), dtype=np.float32)
    shown[np.arange(len(advice)), advice] = 1.0
    return np.concatenate([observation, shown], axis=1, dtype=np.float32)


class Advisor:
    """A policy that says what it would play, and hears what has been played.

    Args:
        policy: it; one that keeps in mind what it has decided takes back what is not played (as scripted managers do,
            with ``advise`` and ``played``), any other is asked as if it played.
        actions: how many there are to choose from, for :meth:`shown`.
    """

    def __init__(self, policy: Policy, actions: int = 0) -> None:
        self._policy, self._actions = policy, actions

    def advice(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """[B] what the policy would play; arguments as for :meth:`Policy.act`."""
        ask = getattr(self._policy, "advise", self._policy.act)
        return np.asarray(ask(observation, mask, step, members))

    def shown(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> ObservationArray:
        """[B, size + actions] what the advised agent sees; arguments as for :meth:`Policy.act`."""
        return with_advice(observation, self.advice(observation, mask, step, members), self._actions)

    def played(self, actions: IntArray, members: IntArray) -> None:
        """What has been played [B] after the advice."""
        tell = getattr(self._policy, "played", None)
        if tell is not None:
            tell(actions, members)

    def get_memory(self) -> Any:
        """See :class:`chemlab.envs.players.Policy`."""
        return getattr(self._policy, "get_memory", lambda: None)()

    def set_memory(self, memory: Any) -> None:
        """See :class:`chemlab.envs.players.Policy`."""
        remind = getattr(self._policy, "set_memory", None)
        if remind is not None:
            remind(memory)


class AdvisedPolicy:
    """A policy that sees an advisor's advice with what it observes.

    Args:
        policy: that sees both.
        advisor: its advisor.
    """

    def __init__(self, policy: Policy, advisor: Advisor) -> None:
        self._policy, self._advisor = policy, advisor

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`chemlab.envs.players.Policy`."""
        actions = self.advise(observation, mask, step, members)
        self.played(actions, members)
        return actions

    def advise(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """[B] what it would play; what is played instead, :meth:`played` is told. Arguments as for :meth:`act`."""
        return self._policy.act(self._advisor.shown(observation, mask, step, members), mask, step, members)

    def played(self, actions: IntArray, members: IntArray) -> None:
        """What has been played [B] after :meth:`advise`."""
        self._advisor.played(actions, members)

    def get_memory(self) -> Any:
        """See :class:`chemlab.envs.players.Policy`."""
        return getattr(self._policy, "get_memory", lambda: None)(), self._advisor.get_memory()

    def set_memory(self, memory: Any) -> None:
        """See :class:`chemlab.envs.players.Policy`."""
        own, advisors = memory
        remind = getattr(self._policy, "set_memory", None)
        if remind is not None:
            remind(own)
        self._advisor.set_memory(advisors)
