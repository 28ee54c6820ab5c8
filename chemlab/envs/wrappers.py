"""Wrappers for the single-bench environments that Gymnasium does not ship.

| Wrapper | Wraps | What it does |
|---|---|---|
| :class:`PotentialShaping`, :class:`VectorPotentialShaping` | any environment | adds gamma phi(s') - phi(s) |
| :class:`GoalConditioned` | a bench | dict view for hindsight experience replay |
| :class:`ObservationNoise`, :class:`VectorObservationNoise` | a bench | Gaussian noise on named channels |
| :class:`RandomStartCurriculum` | any environment | episodes that begin ever further from the start |

For everything else (statistics, time limits, normalization, frame stacking) Gymnasium's own wrappers work.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode

from ..kernels.arrays import FloatArray
from ..kernels.rng import checked_seed
from ..lab.episodes import Guarded
from ..roles.bench import Bench, channel_slices
from .bench_env import BenchEnv, BenchVectorEnv

__all__ = [
    "GoalConditioned",
    "LinearSchedule",
    "ObservationNoise",
    "PotentialShaping",
    "RandomStartCurriculum",
    "VectorObservationNoise",
    "VectorPotentialShaping",
]

BoolArray = npt.NDArray[np.bool_]
ObservationArray = npt.NDArray[np.float32]
GoalObservation = dict[str, ObservationArray]


def _checked_discount(gamma: float) -> float:
    if not 0.0 <= gamma <= 1.0:
        raise ValueError(f"gamma must be from 0 to 1, given {gamma}")
    return float(gamma)


class PotentialShaping(
    Guarded,
    gymnasium.Wrapper[Any, Any, Any, Any],
    RecordConstructorArgs,
):
    """Potential-based shaping: the reward plus gamma phi(s') - phi(s), where phi of a terminal state is 0.

    An episode's discounted return changes by -phi(s0), whatever is done in it, so the order of policies stays the same
    (Ng, Harada and Russell, 1999). That needs the gamma of the learner. A state that is only truncated keeps its
    potential, because the learner bootstraps there. The environment's own reward is ``info["unshaped_reward"]``.

    Args:
        env: any environment.
        potential: phi, a function of one observation, in units of the reward.
        gamma: the learner's discount, from 0 to 1.

    Raises:
        ValueError: gamma is out of bounds.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], potential: Callable[[Any], float], gamma: float) -> None:
        RecordConstructorArgs.__init__(self, potential=potential, gamma=gamma, _disable_deepcopy=True)
        super().__init__(env)
        self.potential = potential
        self.gamma = _checked_discount(gamma)
        self._phi = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; its first observation's potential is what the returns are lower by."""
        observation, info = self._entered(self.env.reset, seed=seed, options=options)
        self._phi = float(self.potential(observation))
        self._unfinished = False
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step, with the shaped reward."""
        observation, reward, terminated, truncated, info = self._guarded(self.env.step, action)
        before, self._phi = self._phi, 0.0 if terminated else float(self.potential(observation))
        shaped = float(reward) + self.gamma * self._phi - before
        self._unfinished = False
        return observation, shaped, terminated, truncated, {**info, "unshaped_reward": float(reward)}


class VectorPotentialShaping(Guarded, gymnasium.vector.VectorWrapper, RecordConstructorArgs):
    """:class:`PotentialShaping` for batches, in every autoreset mode.

    With ``NEXT_STEP`` the step that only resets a member has no shaping; with ``SAME_STEP`` the potential of a
    truncated episode's last state is that of ``infos["final_obs"]``.

    Args:
        env: any vector environment of N members with an ``autoreset_mode`` in its metadata.
        potential: phi, from observations [N, size] to [N], in units of the reward.
        gamma: the learner's discount, from 0 to 1.

    Raises:
        ValueError: gamma is out of bounds, or the potential's result has another shape than [N].
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Any, Any, Any],
        potential: Callable[[Any], npt.NDArray[Any]],
        gamma: float,
    ) -> None:
        RecordConstructorArgs.__init__(self, potential=potential, gamma=gamma, _disable_deepcopy=True)
        super().__init__(env)
        self.potential = potential
        self.gamma = _checked_discount(gamma)
        self._mode = AutoresetMode(env.metadata["autoreset_mode"])
        self._phi = np.zeros(env.num_envs)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes in every member, or in those of ``options["reset_mask"]``."""
        observations, infos = self._entered(self.env.reset, seed=seed, options=options)  # type: ignore[arg-type]
        begun = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, dtype=np.bool_)))
        self._phi = np.where(begun, self._potentials(observations), self._phi)
        self._over[begun] = False
        self._unfinished = False
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """One step, with the shaped rewards; the environment's own are ``infos["unshaped_reward"]``."""
        observations, rewards, terminated, truncated, infos = self._guarded(self.env.step, actions)
        begun = self._over if self._mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, dtype=np.bool_)
        ended = terminated | truncated
        phi = self._potentials(observations)
        last = phi
        if self._mode is AutoresetMode.SAME_STEP and ended.any():
            final = np.array(observations)
            for i in np.flatnonzero(ended):
                final[i] = infos["final_obs"][i]
            last = self._potentials(final)
        gain = self.gamma * np.where(terminated, 0.0, last) - self._phi
        shaped = rewards + np.where(begun, 0.0, gain)
        self._phi, self._over = phi, ended
        self._unfinished = False
        everyone = np.ones(self.num_envs, dtype=np.bool_)
        infos = {**infos, "unshaped_reward": np.array(rewards), "_unshaped_reward": everyone}
        return observations, shaped, terminated, truncated, infos

    def _potentials(self, observations: Any) -> FloatArray:
        phi = np.asarray(self.potential(observations), dtype=np.float64)
        if phi.shape != (self.num_envs,):
            raise ValueError(f"potential: must give {self.num_envs} numbers, one a member, given shape {phi.shape}")
        return phi


class GoalConditioned(Guarded, gymnasium.Wrapper[GoalObservation, Any, Any, Any], RecordConstructorArgs):
    """A bench as a goal-conditioned environment, for hindsight experience replay (HER).

    | Key | Shape | Meaning |
    |---|---|---|
    | `observation` | [size] | the bench's observation without its `goal` channel |
    | `desired_goal` | [G] | one-hot of the experiment's goal |
    | `achieved_goal` | [G] | at the end: the score that the experiment would have had for each goal; before: zeros |

    :meth:`compute_reward` is the sum of achieved x desired: the desired goal is a list of prices per unit of score, and
    a one-hot asks for a single product. An experiment relabelled with its own achieved goal was asked for what it made,
    in proportion. Scores are the bench's own measure (mol, or mol x purity), not scaled: what is lost counts
    negatively, so a range of [0, 1] could not hold it and keep the sum equal to the score.

    The amounts are hidden while an experiment runs, so the achieved goal is zeros until the end; relabel with the
    ``final`` strategy (``HerReplayBuffer(goal_selection_strategy="final")``), as ``future`` would mostly pick zeros.

    The reward of a step is ``compute_reward(achieved_goal, desired_goal, info)``: the environment's own, with the score
    rounded to float32. What lost turns and priced safety events take off is ``info["penalty"]``.

    Args:
        env: a :class:`~chemlab.envs.bench_env.BenchEnv`, wrapped or not; wrappers between must keep the
            observation flat and its order.

    Raises:
        TypeError: the environment is not a bench.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._bench_env = _single_bench(env)
        bench = self._bench_env.bench
        self._shown = np.ones(bench.observation_space.shape, dtype=np.bool_)
        self._shown[channel_slices(bench.channels)["goal"]] = False
        self._goals = len(bench.goals.names)
        space, size = gymnasium.spaces.Box, int(self._shown.sum())
        self.observation_space: gymnasium.Space[Any] = gymnasium.spaces.Dict(
            {
                "observation": space(0.0, 1.0, (size,), np.float32),
                "achieved_goal": space(-np.inf, np.inf, (self._goals,), np.float32),
                # Not only one-hots: a relabelled goal is an achieved one.
                "desired_goal": space(-np.inf, np.inf, (self._goals,), np.float32),
            }
        )
        self._baseline = np.zeros(self._goals)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[GoalObservation, dict[str, Any]]:
        """Begin an experiment."""
        observation, info = self._entered(self.env.reset, seed=seed, options=options)
        self._baseline = self._measures()
        view = self._view(observation, np.zeros(self._goals))
        self._unfinished = False
        return view, info

    def step(self, action: Any) -> tuple[GoalObservation, float, bool, bool, dict[str, Any]]:
        """One action of the experiment."""
        observation, reward, terminated, truncated, info = self._guarded(self.env.step, action)
        achieved = self._measures() - self._baseline if info["experiment_over"] else np.zeros(self._goals)
        info = {**info, "penalty": info["score"] - float(reward)}
        view = self._view(observation, achieved)
        paid = float(self.compute_reward(view["achieved_goal"], view["desired_goal"], info))
        self._unfinished = False
        return view, paid, terminated, truncated, info

    def compute_reward(self, achieved_goal: npt.NDArray[Any], desired_goal: npt.NDArray[Any], info: Any) -> Any:
        """What steps are worth that reached ``achieved_goal`` when ``desired_goal`` was asked for.

        Args:
            achieved_goal: [..., G]; zeros where the experiment has not ended.
            desired_goal: [..., G].
            info: the step's info, or one a row; ``penalty`` in it is taken off (0 where it is missing).

        Returns:
            float64 [...].
        """
        worth = (np.asarray(achieved_goal, dtype=np.float64) * np.asarray(desired_goal, dtype=np.float64)).sum(axis=-1)
        if isinstance(info, dict):
            return worth - info.get("penalty", 0.0)
        return worth - np.array([one.get("penalty", 0.0) for one in info]).reshape(worth.shape)

    def _measures(self) -> FloatArray:
        """[G] the bench's measure of its vessels, were the experiment run for each goal."""
        batch = self._bench_env.batch
        goal = batch.experiments.goal.copy()
        found = np.empty(self._goals)
        for g in range(self._goals):
            batch.experiments.goal[:] = g
            found[g] = batch.bench.measure(batch.shelf, batch.experiments, batch.members)[0]
        batch.experiments.goal[:] = goal
        return found

    def _view(self, observation: Any, achieved: FloatArray) -> GoalObservation:
        desired = np.zeros(self._goals, dtype=np.float32)
        desired[self._bench_env.batch.experiments.goal[0]] = 1.0
        with np.errstate(under="ignore"):  # traces are 0
            return {
                "observation": observation[self._shown],
                "achieved_goal": achieved.astype(np.float32),
                "desired_goal": desired,
            }


class ObservationNoise(gymnasium.Wrapper[ObservationArray, Any, Any, Any], RecordConstructorArgs):
    """Gaussian noise on an observation, clipped to the observation space.

    Args:
        env: a bench, wrapped or not, with its flat observation.
        scale: standard deviation, in the observation's units: shares of a channel's range.
        channels: names of the channels that are noisy (default: all but the goal).

    Seeds: ``reset(seed=s)`` starts the noise afresh too, from a stream of its own, so that the environment underneath
    plays the same with and without noise.

    Raises:
        TypeError: the environment is not a bench.
        ValueError: the scale is negative or not finite, or a channel is unknown.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], scale: float, channels: Sequence[str] | None = None) -> None:
        RecordConstructorArgs.__init__(self, scale=scale, channels=channels)
        super().__init__(env)
        self._noise = _Noise(_single_bench(env).bench, 1, scale, channels)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationArray, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._noise.seed([seed])
        return self._noise.disturb(0, observation), info

    def step(self, action: Any) -> tuple[ObservationArray, float, bool, bool, dict[str, Any]]:
        """One step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._noise.disturb(0, observation), float(reward), terminated, truncated, info


class VectorObservationNoise(gymnasium.vector.VectorWrapper, RecordConstructorArgs):
    """:class:`ObservationNoise` for batches; member i seeded s sees what a single environment seeded s + i sees.

    Args:
        env: a batched bench, wrapped or not, in any autoreset mode.
        scale: standard deviation, in shares of a channel's range.
        channels: names of the channels that are noisy (default: all but the goal).

    Raises:
        TypeError: the environment is not a batched bench.
        ValueError: the scale is negative or not finite, or a channel is unknown.
    """

    def __init__(
        self, env: gymnasium.vector.VectorEnv[Any, Any, Any], scale: float, channels: Sequence[str] | None = None
    ) -> None:
        RecordConstructorArgs.__init__(self, scale=scale, channels=channels)
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, BenchVectorEnv):
            raise TypeError(f"needs a batched bench (BenchVectorEnv), given {inner!r}")
        self._mode = inner.autoreset_mode
        self._noise = _Noise(inner.bench, env.num_envs, scale, channels)
        self._seen = np.zeros((env.num_envs, *inner.bench.observation_space.shape), dtype=np.float32)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationArray, dict[str, Any]]:
        """Begin episodes in every member, or in those of ``options["reset_mask"]``; the others look the same."""
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        begun = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, dtype=np.bool_)))
        if seed is None or isinstance(seed, (int, np.integer)):
            seed = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        self._noise.seed([one if chosen else None for one, chosen in zip(seed, begun, strict=True)])
        for i in np.flatnonzero(begun):
            self._seen[i] = self._noise.disturb(int(i), observations[i])
        return self._seen.copy(), infos

    def step(self, actions: Any) -> tuple[ObservationArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """One step."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        ended = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and ended.any():
            final = np.array(infos["final_obs"])
            for i in np.flatnonzero(ended):
                final[i] = self._noise.disturb(int(i), final[i])
            infos = {**infos, "final_obs": final}
        for member in range(self.num_envs):
            self._seen[member] = self._noise.disturb(member, observations[member])
        return self._seen.copy(), rewards, terminated, truncated, infos


class _Noise:
    """Random streams of N members, and where in an observation they are added."""

    def __init__(self, bench: Bench, members: int, scale: float, channels: Sequence[str] | None) -> None:
        if not (np.isfinite(scale) and scale >= 0.0):
            raise ValueError(f"scale must be a finite number of at least 0, given {scale}")
        where = channel_slices(bench.channels)
        chosen = [name for name in where if name != "goal"] if channels is None else list(channels)
        unknown = [name for name in chosen if name not in where]
        if unknown:
            raise ValueError(f"channels: bench {bench.key!r} has {', '.join(where)}, given {unknown[0]!r}")
        self._scale = scale
        indices = [i for name in chosen for i in range(where[name].start, where[name].stop)]
        self._index = np.array(indices, dtype=np.int64)
        self._space = bench.observation_space
        self._streams: list[np.random.Generator | None] = [None] * members

    def seed(self, seeds: Sequence[int | None]) -> None:
        """Start streams afresh; those without a seed go on, or begin with one of their own."""
        for i, seed in enumerate(seeds):
            if seed is not None or self._streams[i] is None:
                # A child of the seed, because the environment draws from the seed itself.
                sequence = np.random.SeedSequence(seed, spawn_key=(0,))
                self._streams[i] = np.random.default_rng(sequence)

    def disturb(self, member: int, observation: ObservationArray) -> ObservationArray:
        """A noisy copy of one member's observation."""
        stream = self._streams[member]
        assert stream is not None, "reset() comes before step()"
        seen = np.array(observation, dtype=np.float32)
        where = self._index
        noisy = seen[where] + self._scale * stream.standard_normal(len(where))
        seen[where] = np.clip(noisy, self._space.low[where], self._space.high[where])
        return seen


@dataclass(frozen=True)
class LinearSchedule:
    """Grows from 0 to 1 over a number of episodes, then stays."""

    episodes: int

    def __call__(self, ended: int) -> float:
        """The share reached after ``ended`` episodes."""
        return min(ended / self.episodes, 1.0) if self.episodes > 0 else 1.0


class RandomStartCurriculum(Guarded, gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Episodes that begin after some random legal actions, ever more of them as training goes on.

    At each reset their number is drawn uniformly from 0 to n, where n = ``steps`` x ``schedule(episodes ended)``,
    rounded. If the episode ends before they are played, it is thrown away and another is begun with fewer, so what is
    handed over is never finished. ``info["random_steps"]`` says how many were played; what they earned is not
    rewarded, but a bench's score still counts from the experiment's own beginning, and its step limit counts them.

    Wrappers inside this one see the random actions: put it innermost, right around the environment.

    Args:
        env: an environment with continuous actions in a finite box, or with discrete ones and, where some are illegal,
            an ``action_masks`` method.
        steps: the largest number of random actions.
        schedule: share (0 to 1) of ``steps`` to use after a number of ended episodes; by default 1,000 episodes lead to
            all of them.

    Seeds: ``reset(seed=s)`` starts the random actions afresh too, from a stream of their own. The number of ended
    episodes goes on.

    Raises:
        ValueError: ``steps`` is negative, or the schedule gives a share out of bounds.
        TypeError: the action space is neither a box nor discrete.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        steps: int,
        schedule: Callable[[int], float] = LinearSchedule(1000),
    ) -> None:
        RecordConstructorArgs.__init__(self, steps=steps, schedule=schedule, _disable_deepcopy=True)
        super().__init__(env)
        if steps < 0:
            raise ValueError(f"steps must be at least 0, given {steps}")
        if not isinstance(env.action_space, (gymnasium.spaces.Box, gymnasium.spaces.Discrete)):
            raise TypeError(f"needs a Box or Discrete action space, given {env.action_space!r}")
        self.steps = steps
        self.schedule = schedule
        self.episodes_ended = 0
        self._rng: np.random.Generator | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode and play its random part; the info is that of the last action played."""
        seed = checked_seed(seed)
        if seed is not None or self._rng is None:
            self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
        share = self.schedule(self.episodes_ended)
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"schedule({self.episodes_ended}) must be from 0 to 1, given {share}")
        wanted = int(self._rng.integers(round(share * self.steps) + 1))
        while True:
            observation, info = self._entered(self.env.reset, seed=seed, options=options)
            played, over = 0, False
            while played < wanted and not over:
                observation, _, terminated, truncated, info = self.env.step(self._random_action(self._rng))
                over = terminated or truncated
                played += 1
            if not over:
                self._unfinished = False
                return observation, {**info, "random_steps": played}
            # The next try is shorter than what was just too long, so this comes to an end: at 0 none is played.
            wanted, seed = int(self._rng.integers(played)), None

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One step of the agent's own."""
        observation, reward, terminated, truncated, info = self._guarded(self.env.step, action)
        self.episodes_ended += terminated or truncated
        self._unfinished = False
        return observation, float(reward), terminated, truncated, info

    def _random_action(self, rng: np.random.Generator) -> Any:
        space = self.env.action_space
        if isinstance(space, gymnasium.spaces.Box):
            return rng.uniform(space.low, space.high).astype(space.dtype)
        assert isinstance(space, gymnasium.spaces.Discrete)
        legal = np.ones(int(space.n), dtype=np.bool_)
        if self.env.has_wrapper_attr("action_masks"):
            legal = np.asarray(self.env.get_wrapper_attr("action_masks")(), dtype=np.bool_)
        return int(space.start) + int(rng.choice(np.flatnonzero(legal)))


def _single_bench(env: gymnasium.Env[Any, Any]) -> BenchEnv:
    inner = env.unwrapped
    if not isinstance(inner, BenchEnv):
        raise TypeError(f"needs a single bench (BenchEnv), given {inner!r}")
    return inner
