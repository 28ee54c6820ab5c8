"""Common parts of all batched environments: members that start and end independently."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from ..config.loading import plain_scenario
from ..config.scenario import RewardSpec, Scenario
from ..kernels.arrays import FloatArray, IntArray
from ..kernels.rng import checked_seed
from ..kernels.tables import put_back
from ..lab.hidden import World, Worlds

__all__ = ["BatchEnv", "BoundedSpec", "State", "checked_actions", "parsed_reset"]

State = list[npt.NDArray[Any]]


def _all_within(values: npt.NDArray[Any], low: float, high: float) -> bool:
    """Return True if every number is in [low, high] (False for NaN)."""
    return not values.size or bool(low <= values.min() and values.max() <= high)


def checked_actions(
    agent: str,
    actions: Any,
    count: int,
    space: gymnasium.Space[Any],
    rows: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[Any]:
    """Return a batch of actions as int64 [B] or float64 [B, n].

    Args:
        agent: name of the agent, for the error message.
        actions: the given actions.
        count: batch size B.
        space: action space of a member.
        rows: [B] rows that count; others may have any values.

    Raises:
        ValueError: an action is outside the space, or the batch has another shape.
    """
    try:
        values = np.asarray(actions)
    except ValueError:  # lists of different lengths
        values = np.empty((), dtype=object)
    # Kernels need native contiguous arrays, whatever layout, width and byte order is given.
    if isinstance(space, gymnasium.spaces.Discrete):
        last = int(space.n) - 1
        if values.dtype.kind in "iu" and values.shape == (count,):
            numbers = np.ascontiguousarray(values, dtype=np.int64)
            if _all_within(numbers if rows is None else numbers[rows], 0, last):
                return numbers
        raise ValueError(f"{agent}: actions must be {count} integers from 0 to {last}, given {actions!r}")
    shape = (count, *(space.shape or ()))
    if values.dtype.kind in "fiu" and values.shape == shape:
        numbers = np.ascontiguousarray(values, dtype=np.float64)
        if _all_within(numbers if rows is None else numbers[rows], 0.0, 1.0):
            return numbers
    raise ValueError(f"{agent}: actions must be {list(shape)} finite numbers from 0 to 1, given {actions!r}")


def parsed_reset(
    seed: int | Sequence[int | None] | None,
    options: dict[str, Any] | None,
    count: int,
    goals: Sequence[str],
    begun: bool,
    random: np.random.Generator,
) -> tuple[npt.NDArray[np.bool_], list[int | None], str | None, World | None]:
    """Parse the arguments of a batch's ``reset``.

    Args:
        seed: s seeds member i with s + i; a sequence gives each member its own (None: the next episode of its series);
            without a seed, members that have never been seeded get one from ``random``.
        options: ``{"reset_mask": bool [N]}``, ``{"goal": name}``, ``{"world": seed or values}``.
        count: number of members N.
        goals: possible goals.
        begun: whether the batch has been reset before.
        random: source of seeds.

    Returns:
        Members to reset [N], a seed or None for each, a goal or None, a world or None.

    Raises:
        ValueError: an option or goal is unknown, a mask or seeds have the wrong length, or a seed is not a non-negative
            integer.
    """
    options = options or {}
    if set(options) - {"reset_mask", "goal", "world"} or options.get("goal", goals[0]) not in goals:
        raise ValueError(f"reset options: known: reset_mask; world; goal, one of {', '.join(goals)}; given {options!r}")
    mask = np.asarray(options.get("reset_mask", np.ones(count, dtype=np.bool_)))
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise ValueError(f"reset_mask must be {count} booleans, given {mask.dtype} of shape {mask.shape}")
    if not (begun or mask.all()):
        raise ValueError("reset_mask: the first reset must be of all members")
    seeds: list[int | None]
    if isinstance(seed, (Sequence, np.ndarray)) and not isinstance(seed, str):
        seeds = [checked_seed(own, f"seed[{i}]") for i, own in enumerate(seed)]
        if len(seeds) != count:
            raise ValueError(f"seed: needs one for each of {count} members, given {len(seeds)}")
    elif seed is None and not begun:
        seeds = [int(s) for s in random.integers(2**63, size=count)]
    else:
        first = checked_seed(seed)
        seeds = [None if first is None else first + i for i in range(count)]
    return mask, seeds, options.get("goal"), options.get("world")


def _plain(argument: Any) -> Any:
    """Return an environment's argument as equivalent plain data if possible."""
    if isinstance(argument, Scenario):
        return plain_scenario(argument)
    if isinstance(argument, Path):
        return str(argument)
    if isinstance(argument, RewardSpec):
        return argument.model_dump()
    return argument.value if isinstance(argument, AutoresetMode) else argument


class BoundedSpec:
    """Completes an environment's ``spec`` with ``max_episode_steps`` and plain arguments.

    The bound on episodes depends on the scenario, so it cannot be in Gymnasium's registry. It is one more than the
    longest episode, so that time limits of clients or of ``gymnasium.make`` never truncate one. With plain arguments
    ``spec.to_json()`` works, in which Minari stores a dataset's environment: a path becomes text; a loaded scenario its
    name or path, or its content if neither gives the same scenario.
    """

    max_episode_steps: int
    """One more than the maximum number of steps of an episode."""
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """Gymnasium's specification, for environments made by ``gymnasium.make``."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = {name: _plain(argument) for name, argument in spec.kwargs.items()}
            if spec.max_episode_steps is None:
                spec.max_episode_steps = self.max_episode_steps
        self._spec = spec


class BatchEnv(BoundedSpec, gymnasium.vector.VectorEnv[npt.NDArray[np.float32], Any, Any]):
    """Base class of batches: N members with the same spaces in one set of arrays; subclasses define a member's step.

    Args:
        num_envs: number of members N.
        agent: name of the acting agent, for error messages.
        goals: possible values of ``options["goal"]``.
        kinds: number of kinds of safety events.
        longest: maximum number of steps of an episode.
        observation_space, action_space: spaces of a member.
        autoreset_mode: ``NEXT_STEP`` (default: the step after the end resets, its action is ignored), ``SAME_STEP``
            (the step that ends returns the next episode's observation; the last one is ``infos["final_obs"]``) or
            ``DISABLED`` (reset with ``options={"reset_mask": mask}``).
        copy: whether returned arrays are copies; if False, the next step overwrites them.
        render_mode: for compatibility with Gymnasium; must be None, because batches do not render.
        max_episode_steps: for compatibility with Gymnasium; batches do not truncate episodes, so it must exceed
            ``longest``.

    Raises:
        ValueError: a number is out of bounds, or a render mode is given.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int,
        agent: str,
        goals: Sequence[str],
        kinds: int,
        longest: int,
        observation_space: gymnasium.spaces.Box,
        action_space: gymnasium.Space[Any],
        autoreset_mode: str | AutoresetMode,
        copy: bool,
        render_mode: str | None,
        max_episode_steps: int | None,
    ) -> None:
        if max_episode_steps is not None and max_episode_steps <= longest:
            raise ValueError(
                f"max_episode_steps: a batch's episodes take up to {longest} steps and are not truncated, given "
                f"{max_episode_steps}; omit it, or make single environments (vectorization_mode='sync')"
            )
        if render_mode is not None:
            raise ValueError(
                f"render_mode: must be None, as batches do not render, given {render_mode!r}; omit it, or make "
                "single environments (vectorization_mode='sync')"
            )
        self.max_episode_steps = longest + 1
        self.num_envs = num_envs
        self.agent = agent
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = observation_space
        self.single_action_space = action_space
        self.observation_space = gymnasium.vector.utils.batch_space(observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(action_space, num_envs)
        self.action_count = int(action_space.n) if isinstance(action_space, gymnasium.spaces.Discrete) else 0
        """Number of discrete actions; 0 for continuous actions."""
        self.copy = copy
        self._goal_names = tuple(goals)
        self._observations = np.zeros((num_envs, *observation_space.shape), dtype=np.float32)
        self._masks = np.ones((num_envs, self.action_count), dtype=np.int8)
        self._rewards = np.zeros(num_envs)
        self._costs = np.zeros(num_envs)
        self._scores = np.full(num_envs, np.nan)
        self._events = np.zeros((num_envs, kinds))
        self._illegal = np.zeros(num_envs, dtype=np.bool_)
        self._terminated = np.zeros(num_envs, dtype=np.bool_)
        self._pending = np.zeros(num_envs, dtype=np.bool_)
        self._begun = False

    # -- methods of subclasses ----------------------------------------------------------------------------------

    @abstractmethod
    def _seed_member(self, member: int, seed: int) -> None:
        """Restart the member's random streams."""

    @abstractmethod
    def _begin(self, members: IntArray, goal: int | None, world: World | None) -> None:
        """Start episodes and observe them."""

    @property
    @abstractmethod
    def _worlds(self) -> Worlds:
        """Worlds of the members."""

    @abstractmethod
    def _play(self, actions: npt.NDArray[Any]) -> list[tuple[IntArray, npt.NDArray[np.float32]]]:
        """Play checked actions in every member with autoreset, and fill the batch's arrays (``_scores``: NaN without a
        score).

        Returns:
            Members that have ended and, with SAME_STEP, their last observations.
        """

    @abstractmethod
    def _more_arrays(self) -> State:
        """Return the subclass's own arrays that change."""

    def _more_infos(self) -> dict[str, npt.NDArray[Any]]:
        """Return the subclass's own infos by name."""
        return {}

    # -- Gymnasium's interface ----------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start episodes in every member, or in those of ``options["reset_mask"]`` [N].

        Args:
            seed: s seeds member i with s + i; a sequence gives each member its own (None: the next episode of its
                series).
            options: ``{"reset_mask": bool [N]}``, ``{"goal": name}``, ``{"world": seed or values}`` (of all members).

        Raises:
            ValueError: an option, goal or world is unknown, a mask or seeds have the wrong length, or a seed is not a
                non-negative integer; nothing has changed.
        """
        mask, seeds, goal, world = parsed_reset(
            seed, options, self.num_envs, self._goal_names, self._begun, self.np_random
        )
        if world is not None:
            self._worlds.check(world)
        self._begun = False  # until it is finished: after an interruption or a failing policy or model, a reset helps
        super().reset(seed=int(seed) if isinstance(seed, (int, np.integer)) else None)
        for member in np.flatnonzero(mask):
            member_seed = seeds[member]
            if member_seed is not None:
                self._seed_member(int(member), member_seed)
        self._pending[mask] = False
        self._costs[mask], self._events[mask], self._illegal[mask] = 0.0, 0.0, False
        self._scores[mask] = np.nan
        self._begin(np.flatnonzero(mask), None if goal is None else self._goal_names.index(goal), world)
        found = self._returned(self._observations), self._infos()
        self._begun = True
        return found

    def step(
        self, actions: Any
    ) -> tuple[npt.NDArray[np.float32], FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Play one action in every member.

        Args:
            actions: [N] integers, or [N, n] numbers in [0, 1] for continuous actions.

        Raises:
            ValueError: an action is outside the action space (nothing has changed).
            gymnasium.error.ResetNeeded: the episodes have not begun, some are over and autoreset is disabled, or an
                earlier step was interrupted or failed.
        """
        checked = checked_actions(self.agent, actions, self.num_envs, self.single_action_space)
        if not self._begun or (self.autoreset_mode is AutoresetMode.DISABLED and self._pending.any()):
            raise gymnasium.error.ResetNeeded(
                f"{self.agent}: episodes are over, have not begun, or a step was interrupted or failed: call reset()"
            )
        self._begun = False  # until it is finished, as in reset
        finals = self._play(checked)
        infos = self._infos()
        ended = self._terminated.copy()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            # Not zeros_like(), which would write all rows although most stay unchanged.
            final = np.zeros(self._observations.shape, dtype=self._observations.dtype)
            for members, observations in finals:
                final[members] = observations
            infos["final_obs"], infos["_final_obs"] = final, ended
        seen, rewards = self._returned(self._observations), self._returned(self._rewards)
        self._begun = True
        return seen, rewards, ended, np.zeros(self.num_envs, dtype=np.bool_), infos

    def _returned(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return array.copy() if self.copy else array

    def _infos(self) -> dict[str, Any]:
        scored = np.isfinite(self._scores)
        infos: dict[str, Any] = {
            "cost": self._costs.copy(),
            "events": self._events.copy(),
            "illegal_action": self._illegal.copy(),
            "experiment_over": scored,
            "score": np.where(scored, self._scores, 0.0),
            **self._more_infos(),
        }
        if self.action_count:
            infos["action_mask"] = self._returned(self._masks)
        # Gymnasium's masks of members that have an info.
        infos.update({f"_{name}": np.ones(self.num_envs, dtype=np.bool_) for name in infos})
        return infos

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return [N, actions] the current legal actions.

        Raises:
            ValueError: the bench's actions are continuous.
        """
        if not self.action_count:
            raise ValueError(f"{self.agent}: continuous actions have no mask")
        return self._masks.astype(np.bool_)

    def _state_arrays(self) -> State:
        extra: State = [
            self._observations,
            self._masks,
            self._rewards,
            self._costs,
            self._events,
            self._scores,
            self._illegal,
            self._terminated,
            self._pending,
        ]
        return [*self._more_arrays(), *extra]

    def get_state(self) -> State:
        """Return copies of everything that changes, for :meth:`set_state`."""
        return [*(array.copy() for array in self._state_arrays()), np.array([self._begun])]

    def set_state(self, state: State) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical batch; return the observations.

        Raises:
            ValueError: it is of another batch; nothing changes.
        """
        begun = np.zeros(1, dtype=np.bool_)
        put_back([*self._state_arrays(), begun], state)
        self._begun = bool(begun[0])
        return self._returned(self._observations)
