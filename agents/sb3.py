"""Batched benches and batched single-agent views for Stable-Baselines3 and sb3-contrib: ``ChemlabVecEnv``.

>>> from stable_baselines3 import PPO                                              # doctest: +SKIP
>>> from chemlab.agents.sb3 import ChemlabVecEnv                                   # doctest: +SKIP
>>> PPO("MlpPolicy", ChemlabVecEnv(10, bench="rxn"), n_steps=256).learn(100_000)   # doctest: +SKIP

Needs the extra: ``pip install ".[train]"``.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from chemlab.config.extras import needs
from chemlab.envs.inputs import checked_options, parsed_seeds
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.lab.episode_streams import Guarded

from .advice import Advisor

with needs("chemlab.agents.sb3 needs Stable-Baselines3", "train"):
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv

Indices = int | Iterable[int] | None
Infos = list[dict[str, Any]]


class ChemlabVecEnv(Guarded, VecEnv):
    """A batch as SB3's ``VecEnv``: N members stepped by one call, each reset as soon as it ends.

    Args:
        env: number of members N, or an existing batch: a :class:`~chemlab.envs.role_env.RoleVectorEnv`
            (in the laboratory: :func:`chemlab.agents.background.role_vector_env`) with ``autoreset_mode="SameStep"``,
            bare or in Gymnasium's vector wrappers (observations must stay arrays).
        show_masks: whether observations end with the mask of discrete actions, one number per action, for learners that
            do not support masks (:class:`~chemlab.agents.recurrent.MaskedLstmPolicy`).
        advisor: source of teacher hints in the observations (before the masks), for discrete actions.
        arguments: with a number, :class:`RoleVectorEnv`'s own: ``scenario``, ``bench``, ``goals``, ``threads``, ...

    Infos: a member's info has ``TimeLimit.truncated`` (True only under wrappers that truncate; ends of experiments,
    submissions and limits terminate), ``cost`` (weighted safety events of the step) and ``illegal_action``; in views of
    the laboratory ``elapsed_ticks``. At an episode's end it also has ``terminal_observation``, ``score`` and
    ``episode`` ("r", "l", "t") as in SB3's ``Monitor``, so that ``rollout/ep_rew_mean`` is logged without a monitor.

    Masks: ``env_method("action_masks")`` returns one mask per member. Continuous actions have no such attribute, so
    that sb3-contrib's ``is_masking_supported`` is False.

    Seeds: :meth:`seed` with s gives member i the seed s + i at the next reset, so that it plays the same as a single
    environment reset with s + i.

    Raises:
        ValueError: another autoreset mode, masks of continuous actions, or arguments beside an existing batch.
        TypeError: the environment is not a batched bench.
    """

    def __init__(
        self,
        env: int | gymnasium.vector.VectorEnv[Any, Any, Any],
        *,
        show_masks: bool = False,
        advisor: Advisor | None = None,
        **arguments: Any,
    ) -> None:
        if isinstance(env, (int, np.integer)):
            chosen: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, **arguments}
            if "agent" not in arguments:
                chosen.setdefault("bench", "rxn")
            env = RoleVectorEnv(int(env), **chosen)
        elif arguments:
            raise ValueError(f"an existing batch takes no arguments, given {', '.join(arguments)}")
        batch = env.unwrapped if isinstance(env, gymnasium.vector.VectorEnv) else env
        if not isinstance(batch, RoleVectorEnv):
            raise TypeError(f"needs a number of members or one of chemlab's batches, given {env!r}")
        if batch.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode must be SAME_STEP, as SB3 does it, given {batch.autoreset_mode}")
        if (show_masks or advisor is not None) and not batch.action_count:
            raise ValueError(f"{'show_masks' if show_masks else 'advisor'}: continuous actions have no masks")
        self.env = env
        self.batch = batch
        self._advisor, self._show_masks = advisor, show_masks
        self._legal = np.ones((batch.action_count or 0) * show_masks, dtype=np.float32)
        advice = (batch.num_envs, (batch.action_count or 0) * (advisor is not None))
        self._advice = np.zeros(advice, dtype=np.float32)
        self._actions: Any = None
        self._started = time.time()
        self._returns = np.zeros(batch.num_envs)
        self._lengths = np.zeros(batch.num_envs, dtype=np.int64)
        space: Any = env.single_observation_space
        if show_masks or advisor is not None:
            added = np.ones(advice[1] + len(self._legal), dtype=np.float32)
            low, high = np.append(space.low, 0.0 * added), np.append(space.high, added)
            space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        super().__init__(batch.num_envs, space, env.single_action_space)

    def seed(self, seed: int | Sequence[int] | None = None) -> Sequence[int | None]:
        """Set the seeds of the members at the next reset: of member i, seed + i, or each its own; None: draw them.

        Raises:
            ValueError: a seed is not a non-negative integer, or they are not one for each member.
        """
        if seed is None:
            return super().seed(seed)
        self._seeds = parsed_seeds(seed, self.num_envs)
        return self._seeds

    @staticmethod
    def _info(cost: float = 0.0, illegal: bool = False) -> dict[str, Any]:
        return {"TimeLimit.truncated": False, "cost": cost, "illegal_action": illegal}

    def reset(self) -> npt.NDArray[np.float32]:
        """Start experiments in every member with the seeds and options set before; return [N, size] observations.

        Raises:
            ValueError: an option, goal or world is unknown; nothing has changed.
        """
        own, seeds = self.batch.episodes, None if all(seed is None for seed in self._seeds) else self._seeds
        options = [checked_options(one, own.goals, own.worlds) for one in self._options]
        kinds = [one for i, one in enumerate(options) if one not in options[:i]]
        if len(kinds) > 1 and not self.batch._begun:  # a first reset is of all members
            self._entered(self.env.reset, seed=seeds)  # type: ignore[arg-type]
        for kind in kinds:
            alike: Any = {**kind, "reset_mask": np.array([one == kind for one in options])}
            observations, infos = self._entered(self.env.reset, seed=seeds, options=alike)  # type: ignore[arg-type]
        self.reset_infos = [self._info(float(cost)) for cost in infos["cost"]]
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        kept = self._kept(observations)
        self._unfinished = False
        return kept

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Store the actions [N] or [N, n] for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.bool_], Infos]:
        """Play the stored actions; return observations [N, size], rewards [N], whether each episode has ended [N],
        infos.

        Raises:
            ValueError: an action is outside the action space (nothing has changed).
            gymnasium.error.ResetNeeded: an earlier step was interrupted or failed.
        """
        observations, rewards, terminated, truncated, found = self._guarded(self.env.step, self._actions)
        if self._advisor is not None:
            self._advisor.played(self._actions, np.arange(self.num_envs))
        dones = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        # New dictionaries in every step, because wrappers write into them.
        infos = list(map(self._info, found["cost"].tolist(), found["illegal_action"].tolist()))
        if "elapsed_ticks" in found:  # steps of the laboratory's views differ in length
            for info, ticks in zip(infos, found["elapsed_ticks"].tolist(), strict=True):
                info["elapsed_ticks"] = ticks
        for i in np.flatnonzero(dones):
            info = infos[i]
            info["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
            info["terminal_observation"] = self._ended(found["final_obs"][i], int(i))
            if found["experiment_over"][i]:
                info["score"] = float(found["score"][i])
            info["episode"] = {
                "r": round(float(self._returns[i]), 6),
                "l": int(self._lengths[i]),
                "t": round(time.time() - self._started, 6),
            }
            self._returns[i], self._lengths[i] = 0.0, 0
        kept = self._kept(observations)
        self._unfinished = False
        return kept, rewards.astype(np.float32), dones, infos

    def _ended(self, observation: npt.NDArray[np.float32], member: int) -> npt.NDArray[np.float32]:
        # No action follows the last observation, so it has no hint; the last hint is shown, because value functions
        # were never trained on observations without one.
        return np.concatenate([observation, self._advice[member], self._legal])

    def _kept(self, observations: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        if self._advisor is not None:
            legal = self.batch.action_masks().astype(np.int8)
            observations = self._advisor.shown(observations, legal, self._lengths, np.arange(self.num_envs))
            self._advice = observations[:, -self._advice.shape[1] :]
        return self._with_masks(observations)

    def _with_masks(self, observations: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        if self._show_masks:
            return np.concatenate([observations, self.batch.action_masks()], axis=1, dtype=np.float32)
        # SB3 still uses the last observations after the next step.
        return observations if self.batch.copy or self._advisor is not None else np.array(observations)

    def close(self) -> None:
        """Stop the batch's threads."""
        self.env.close()

    def get_state(self) -> list[npt.NDArray[Any]]:
        """Return copies of everything that changes, for :meth:`set_state`."""
        memory = np.empty(1, dtype=object)
        memory[0] = None if self._advisor is None else (self._advisor.get_memory(), self._advice.copy())
        return [*self.batch.get_state(), self._returns.copy(), self._lengths.copy(), memory]

    def set_state(self, state: list[npt.NDArray[Any]]) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical batch; return the observations."""
        *batch, self._returns[:], self._lengths[:], memory = state
        self._reset_seeds()
        self._reset_options()
        observations = self.batch.set_state(batch)
        if self._advisor is not None:  # which is not asked again: it may draw
            own, self._advice = memory[0]
            self._advisor.set_memory(own)
            observations = np.concatenate([observations, self._advice], axis=1, dtype=np.float32)
        return self._with_masks(observations)

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return [N, actions] the current legal actions.

        Raises:
            ValueError: the bench's actions are continuous.
        """
        return self.batch.action_masks()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of each member; a shared attribute is repeated.

        Raises:
            AttributeError: there is none of that name.
        """
        members = self._members(indices)
        if attr_name == "action_masks":
            if not self.batch.action_count:
                raise AttributeError("continuous actions have no action_masks")
            return [partial(self._mask_of, member) for member in members]
        if attr_name in ("observation_space", "action_space"):
            return [getattr(self, attr_name)] * len(members)
        return [getattr(self._owner(attr_name), attr_name)] * len(members)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute that the members share.

        Raises:
            AttributeError: there is none of that name.
            ValueError: ``indices`` are not all members.
        """
        if set(self._members(indices)) != set(range(self.num_envs)):
            raise ValueError(f"{attr_name}: members share it, so it is set for all of them, given indices {indices!r}")
        setattr(self._owner(attr_name), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Return ``action_masks`` of each member; any other method of the batch is called once and its result repeated.

        Raises:
            AttributeError: there is none of that name.
        """
        if method_name == "action_masks" and self.batch.action_count:
            masks = self.batch.action_masks()
            return [masks[member] for member in self._members(indices)]
        methods = self.get_attr(method_name, indices)
        return [methods[0](*method_args, **method_kwargs)] * len(methods)

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Return whether members have a wrapper: True for SB3's ``Monitor``, whose ``episode`` infos are provided."""
        return [issubclass(wrapper_class, Monitor)] * len(self._members(indices))

    def _owner(self, name: str) -> Any:
        """Return the outermost vector wrapper that has an attribute, or the batch itself."""
        owner: Any = self.env
        while not hasattr(owner, name) and owner is not self.batch:
            owner = owner.env
        if not hasattr(owner, name):
            raise AttributeError(f"{type(self.batch).__name__} has no attribute {name!r}")
        return owner

    def _mask_of(self, member: int) -> npt.NDArray[np.bool_]:
        """Return [actions] the current legal actions of one member."""
        return np.asarray(self.batch.action_masks()[member])

    def _members(self, indices: Indices) -> Sequence[int]:
        return [range(self.num_envs)[index] for index in self._get_indices(indices)]
