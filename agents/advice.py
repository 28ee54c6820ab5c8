"""Teacher hints: the learner observes the action that another policy would play in its place.

The learner can follow the hints from its first turn on and has to learn only the deviations. In residual policy
learning (Silver et al., 2018, arXiv:1812.06298; Johannink et al., 2018, arXiv:1812.03201), continuous actions are
added; for discrete actions, the hint is part of the observation instead.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from chemlab.envs.players import Actions, Policy, Remembering
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.kernels.rng import as_sequence

from .notes import Notes

if TYPE_CHECKING:
    from .pretrained import Card


def with_advice(observation: ObservationArray, advice: IntArray, actions: int) -> ObservationArray:
    """Append hints to observations: [B, size + actions], with a one-hot code of each hinted action."""
    shown = np.zeros((len(observation), actions), dtype=np.float32)
    shown[np.arange(len(advice)), advice] = 1.0
    return np.concatenate([observation, shown], axis=1, dtype=np.float32)


class Advisor(Remembering):
    """A policy that gives hints and is informed of the actions played.

    Args:
        policy: the teacher. A scripted manager (with ``advise`` and ``played``) undoes decisions that were not played;
            any other policy is queried as if it played.
        actions: number of discrete actions, for :meth:`shown`.
    """

    _MEMORY = ("_policy",)

    def __init__(self, policy: Policy, actions: int = 0) -> None:
        self._policy, self._actions = policy, actions

    def advice(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> Actions:
        """Return [B] the actions that the teacher would play; arguments as for :meth:`Policy.act`."""
        ask = getattr(self._policy, "advise", self._policy.act)
        return np.asarray(ask(observation, mask, step, members))

    def shown(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> ObservationArray:
        """Return [B, size + actions] the learner's observations with hints; arguments as for :meth:`Policy.act`."""
        return with_advice(observation, self.advice(observation, mask, step, members), self._actions)

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the teacher's random stream of one member."""
        if hasattr(self._policy, "seed"):
            self._policy.seed(member, seed)

    def played(self, actions: IntArray, members: IntArray) -> None:
        """Inform the teacher of the actions [B] that were played after its hints."""
        tell = getattr(self._policy, "played", None)
        if tell is not None:
            tell(actions, members)


class Advising(Remembering, ABC):
    """Base class of policies that give an action first and are informed of the one that is played."""

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        actions = self.advise(observation, mask, step, members)
        self.played(actions, members)
        return actions

    @abstractmethod
    def advise(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> Actions:
        """Return [B] the actions the policy would play; :meth:`played` confirms them. Arguments as for :meth:`act`."""

    @abstractmethod
    def played(self, actions: IntArray, members: IntArray) -> None:
        """Inform the policy of the actions [B] played after :meth:`advise`."""


class AdvisedPolicy(Advising):
    """A policy that observes the hints of an advisor, or its notes.

    Args:
        policy: the policy that observes them.
        advisor: source of the hints, or notes.
    """

    _MEMORY = ("_policy", "_advisor")

    def __init__(self, policy: Policy, advisor: Advisor | Notes) -> None:
        self._policy, self._advisor = policy, advisor

    def advise(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> Actions:
        return self._policy.act(self._advisor.shown(observation, mask, step, members), mask, step, members)

    def played(self, actions: IntArray, members: IntArray) -> None:
        self._advisor.played(actions, members)

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the random streams of one member."""
        for part, own in ((self._policy, seed), (self._advisor, as_sequence(seed).spawn(1)[0])):
            if hasattr(part, "seed"):
                part.seed(member, own)

    @property
    def card(self) -> Card:
        """Card of the policy.

        Raises:
            AttributeError: it has none.
        """
        return self._policy.card  # type: ignore[attr-defined, no-any-return]
