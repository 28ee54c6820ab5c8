"""What a policy is, whoever made it: a batch of observations and masks in, a batch of actions out."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..bench.base import MaskArray, ObservationArray
from ..shelf import IntArray

__all__ = ["Policy", "as_policy"]


class Policy(Protocol):
    """A policy for one role, evaluated on a batch; it sees what an RL agent sees and the public scenario."""

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """Actions for a batch.

        Args:
            observation: [B, size].
            mask: [B, actions] legal actions, or None where actions are continuous.
            step: [B] how many turns the agent has had in this experiment (the manager: in this episode). At 0 a
                policy with a memory forgets.
            members: [B] which member of the batch each row is, for policies with a memory.

        Returns:
            [B] int64 actions, or [B, n] float64 where actions are continuous.
        """
        ...  # a protocol has no body


class _Called:
    """A function of (observation [B, size], mask [B, actions] or None) as a policy."""

    def __init__(self, function: Callable[[ObservationArray, MaskArray | None], Any]) -> None:
        self._function = function

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`Policy`."""
        return np.asarray(self._function(observation, mask))


class _Model:
    """A trained model with Stable-Baselines3's ``predict``, as a policy; masks are handed to models that take them."""

    def __init__(self, model: Any, deterministic: bool = True) -> None:
        self._model, self._deterministic = model, deterministic
        self._masked = "action_masks" in inspect.signature(model.predict).parameters

    def act(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> npt.NDArray[Any]:
        """See :class:`Policy`."""
        masks = {"action_masks": mask} if self._masked and mask is not None else {}
        actions, _ = self._model.predict(observation, deterministic=self._deterministic, **masks)
        return np.asarray(actions)


def as_policy(given: Any) -> Policy:
    """Anything that can play, as a :class:`Policy`.

    Args:
        given: a policy, a model with Stable-Baselines3's ``predict`` (sb3-contrib's maskable ones get the mask), or a
            function of (observation [B, size], mask [B, actions] or None) that returns a batch of actions.

    Raises:
        TypeError: it is none of these.
    """
    if hasattr(given, "act"):
        policy: Policy = given
        return policy
    if hasattr(given, "predict"):
        return _Model(given)
    if callable(given):
        return _Called(given)
    raise TypeError(
        f"a policy must have act(), be a model with predict(), or be a function of (observation, mask); given {given!r}"
    )
