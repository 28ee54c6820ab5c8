"""Interface of a policy: a batch of observations and masks in, a batch of actions out."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..kernels.arrays import IntArray, MaskArray, ObservationArray
from ..kernels.rng import as_sequence
from ..lab.engine import Laboratories
from ..roles.manager_state import RUNNING
from .inputs import checked_actions

_MOST_TRIES = 1000

Actions = npt.NDArray[Any]
"""Actions of a batch: [B] int64, or [B, n] float64 if they are continuous."""


class Policy(Protocol):
    """A policy for one role, evaluated on a batch; it has an agent's observation and the public scenario.

    An optional ``seed(member, seed)`` restarts a member's random stream; environments call it for every episode, so
    that episodes are independent. Optional ``get_memory()`` and ``set_memory(memory)`` return and restore a copy of its
    memory, so that an environment that it plays in can be restored. An optional ``reads(members)`` returns [B] whether
    it reads the observation of a laboratory; it is given zeros where it does not.
    """

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """Return the actions for a batch.

        Args:
            observation: [B, size] observations.
            mask: [B, actions] legal actions, or None for continuous actions.
            step: [B] number of turns of the agent in this experiment (the manager: in this episode). At 0, a policy
                with a memory clears it.
            members: [B] environment index of each row, for policies with a memory.

        Returns:
            [B] int64 actions, or [B, n] float64 for continuous actions.
        """
        ...  # a protocol has no body


class _Called:
    """A function of (observation [B, size], mask [B, actions] or None) as a policy."""

    def __init__(self, function: Callable[[ObservationArray, MaskArray | None], Any]) -> None:
        self._function = function

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        actions = self._function(observation, mask)
        try:
            return np.asarray(actions)
        except ValueError:  # lists of different lengths: the check of actions names the agent
            return np.asarray(actions, dtype=object)


class Watching:
    """Plays as another policy does, and tells of every call.

    Args:
        policy: the other one. Its memory and its random streams are left alone.
        told: called with the arguments of :meth:`Policy.act` and the actions.
    """

    def __init__(self, policy: Policy, told: Callable[..., None]) -> None:
        self._policy, self._told = policy, told

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`Policy`."""
        actions = self._policy.act(observation, mask, step, members)
        self._told(observation, mask, step, members, actions)
        return actions


class Memory:
    """Memory of a policy for each member of a batch: arrays that are zero at the start of an experiment or episode.

    Args:
        sizes: length of each array.
    """

    def __init__(self, *sizes: int) -> None:
        self._arrays = [np.zeros((0, size)) for size in sizes]

    def recall(self, step: IntArray, members: IntArray) -> list[npt.NDArray[np.float64]]:
        """Return [B, size] of each array for the members; see :meth:`Policy.act`."""
        try:
            found = [array[members] for array in self._arrays]
        except IndexError:  # members that are new
            lacking = int(members.max()) + 1 - len(self._arrays[0])
            self._arrays = [np.concatenate([a, np.zeros((lacking, a.shape[1]))]) for a in self._arrays]
            return self.recall(step, members)
        for array in found:
            array[step == 0] = 0.0
        return found

    def keep(self, members: IntArray, *values: npt.NDArray[Any]) -> None:
        """Store values [B, size] of the members."""
        for array, own in zip(self._arrays, values, strict=True):
            array[members] = own


class Remembering:
    """Base class of policies with a memory, in the attributes ``_MEMORY``; of a policy there, its own memory."""

    _MEMORY: tuple[str, ...] = ("_memory",)

    def get_memory(self) -> Any:
        """See :class:`Policy`."""
        parts = [getattr(self, name) for name in self._MEMORY]
        return [_own_memory(part) if _is_policy(part) else copy.deepcopy(part) for part in parts]

    def set_memory(self, memory: Any) -> None:
        """See :class:`Policy`."""
        for name, kept in zip(self._MEMORY, memory, strict=True):
            part = getattr(self, name)
            if _is_policy(part):
                _remind(part, kept)
            else:
                setattr(self, name, copy.deepcopy(kept))


def _is_policy(part: Any) -> bool:
    """Return whether something is a policy or an advisor, and not data."""
    return hasattr(part, "act") or hasattr(part, "get_memory")


def _own_memory(policy: Any) -> Any:
    """Return a copy of a policy's memory; None if it has none."""
    return getattr(policy, "get_memory", lambda: None)()


def _remind(policy: Any, memory: Any) -> None:
    """Restore a :func:`_own_memory`."""
    if hasattr(policy, "set_memory"):
        policy.set_memory(memory)


class _RecurrentModel(Remembering):
    """A model of sb3-contrib's ``RecurrentPPO`` as a policy; plays its most probable action.

    sb3-contrib passes no masks; models whose observations end with the mask receive it there.
    """

    def __init__(self, model: Any) -> None:
        self._model, lstm = model, model.policy.lstm_actor
        self._shape = (lstm.num_layers, lstm.hidden_size)
        self._memory = Memory(*2 * [lstm.num_layers * lstm.hidden_size])
        self._size = model.observation_space.shape[0]

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        if mask is not None and observation.shape[1] + mask.shape[1] == self._size:
            observation = np.concatenate([observation, mask], axis=1, dtype=np.float32)
        layers, hidden = self._shape
        kept = [
            array.reshape(-1, layers, hidden).swapaxes(0, 1).astype(np.float32)
            for array in self._memory.recall(step, members)
        ]
        actions, state = self._model.predict(observation, tuple(kept), step == 0, deterministic=True)
        self._memory.keep(members, *(np.swapaxes(array, 0, 1).reshape(len(members), -1) for array in state))
        return np.asarray(actions)


class _Model:
    """A trained model with Stable-Baselines3's ``predict`` as a policy; models that accept masks receive them."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._masked = "action_masks" in inspect.signature(model.predict).parameters

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        masks = {"action_masks": mask} if self._masked and mask is not None else {}
        actions, _ = self._model.predict(observation, deterministic=True, **masks)
        return np.asarray(actions)


def as_policy(given: Any, agent: str = "") -> Policy:
    """Convert an object to a :class:`Policy`.

    Args:
        given: a policy, a model with Stable-Baselines3's ``predict`` (sb3-contrib's maskable ones receive the mask), or
            a function of (observation [B, size], mask [B, actions] or None) that returns a batch of actions.
        agent: name of its agent, for the error message.

    Raises:
        TypeError: it is none of these.
    """
    if hasattr(given, "act"):
        policy: Policy = given
        return policy
    if hasattr(given, "predict"):
        recurrent = hasattr(getattr(given, "policy", None), "lstm_actor")
        return _RecurrentModel(given) if recurrent else _Model(given)
    if callable(given):
        return _Called(given)
    raise TypeError(
        f"{agent}{': ' if agent else ''}a policy must have act(), be a model with predict(), or be a function of "
        f"(observation, mask); given {given!r}"
    )


def _nothing(number: int, members: IntArray) -> None:
    """Do nothing after a turn."""


class Players:
    """Policies of the agents of some laboratories; agents without a policy are played by the caller.

    Args:
        laboratories: the laboratories.
        policies: policy of every agent in order, or None.
        act: plays an agent's actions: (index, members [B], actions [B, ...]); default: :meth:`Laboratories.act`.
    """

    def __init__(
        self,
        laboratories: Laboratories,
        policies: Sequence[Policy | None],
        act: Callable[[int, IntArray, npt.NDArray[Any]], None] | None = None,
    ) -> None:
        self._labs, self._policies, self._act = laboratories, list(policies), act or laboratories.act
        self._played = np.array([policy is not None for policy in policies])

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the random streams of one laboratory's policies."""
        sequences = as_sequence(seed).spawn(len(self._policies))
        for policy, sequence in zip(self._policies, sequences, strict=True):
            start = getattr(policy, "seed", None)
            if start is not None:
                start(member, sequence)

    def renew(self, members: IntArray) -> None:
        """Restart the random streams in laboratories [B] whose episodes have just begun.

        First episodes after a seed are excluded, because :meth:`seed` has set their streams.
        """
        if not any(hasattr(policy, "seed") for policy in self._policies):
            return
        episodes = self._labs.episodes
        for member in members[episodes.begun[members] > 1].tolist():
            self.seed(member, episodes.sequence(member))

    def get_memory(self) -> list[Any]:
        """Return the memory of every policy, for :meth:`set_memory`."""
        return [_own_memory(policy) for policy in self._policies]

    def set_memory(self, memory: Sequence[Any]) -> None:
        """Restore the memory of a :meth:`get_memory`."""
        for policy, own in zip(self._policies, memory, strict=True):
            _remind(policy, own)

    def decide(self, number: int, members: IntArray, step: IntArray | None = None) -> npt.NDArray[Any]:
        """Return actions [B, ...] of an agent with a policy, in laboratories [B] in which it has the turn.

        ``step`` [B] is as for :meth:`Policy.act`; default: the turns that the agent has had.

        Raises:
            ValueError: the policy's actions are outside its agent's space; the message names the agent.
        """
        labs, policy = self._labs, self._policies[number]
        assert policy is not None, "agents without a policy cannot decide"
        seen, mask = self._seen(number, members), labs.mask(number, members)
        with np.errstate(under="ignore"):  # tiny probabilities underflow to 0
            actions = policy.act(seen, mask, labs.roles[number].turns_had[members] if step is None else step, members)
        return checked_actions(labs.agents[number], actions, len(members), labs.action_space(number))

    def _seen(self, number: int, members: IntArray) -> ObservationArray:
        """Return [B, size] the observations that an agent's policy reads; zeros elsewhere."""
        labs, reads = self._labs, getattr(self._policies[number], "reads", None)
        if reads is None:
            return labs.observe(number, members)
        rows = np.flatnonzero(reads(members))
        seen = np.zeros((len(members), labs.observation_sizes[number]), dtype=np.float32)
        return labs.observe(number, members[rows], seen, rows) if len(rows) else seen

    def play_pass(self, members: IntArray, after: Callable[[int, IntArray], None] = _nothing) -> None:
        """Let every agent play once, in order, in the laboratories in which it has the turn.

        This is a manager's action and the tick that may follow it. Policies of one agent are evaluated on all of these
        laboratories together.

        Args:
            members: [B] environment indices.
            after: called after every turn with the agent index and the environment indices.

        Raises:
            ValueError: a policy's actions are outside its agent's space; the message names the agent.
        """
        labs = self._labs
        for number, policy in enumerate(self._policies):
            if policy is None:
                continue
            group = labs.having_turn(number, members)
            if len(group):
                self._act(number, group, self.decide(number, group))
                after(number, group)

    def play_on(self, members: IntArray, after: Callable[[int, IntArray], None] = _nothing) -> None:
        """Play until in every laboratory the episode is over or an agent without a policy has the turn.

        Arguments and errors are those of :meth:`play_pass`.
        """
        state = self._labs.state
        while True:
            members = members[(state.status[members] == RUNNING) & self._played[self._labs.turn_of(members)]]
            if not len(members):
                return
            self.play_pass(members, after)

    def begin(self, members: IntArray, reset: Callable[[IntArray], None]) -> None:
        """Start new episodes and play up to the first turn of an agent without a policy.

        Episodes without such a turn are played to the end and replaced.

        Args:
            members: [B] environment indices.
            reset: starts an episode in some of them.

        Raises:
            RuntimeError: the policies never start the others.
        """
        waiting = members
        for tries in range(_MOST_TRIES):
            self._labs.episodes.again[waiting] = tries > 0
            reset(waiting)
            if not tries:
                self.renew(waiting)
            self.play_on(waiting)
            waiting = waiting[self._labs.state.status[waiting] != RUNNING]
            if not len(waiting):
                return
        others = [agent for agent, played in zip(self._labs.agents, self._played, strict=True) if not played]
        raise RuntimeError(
            f"{', '.join(others)}: had no turn in {_MOST_TRIES} episodes: the other policies never start it"
        )
