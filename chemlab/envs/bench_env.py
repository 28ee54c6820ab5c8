"""Single benches as Gymnasium environments, one at a time and batched; both are views of the laboratory's bench.

| Id | Bench | Observation | Action |
|---|---|---|---|
| `chemlab/WurtzReaction-v0` | rxn of `wurtz_dodecane` | Box(214) | Box(6) |
| `chemlab/FictitiousReaction-v0` | rxn of `fictitious` | Box(212) | Box(6) |
| `chemlab/WurtzExtraction-v0` | ext of `wurtz_dodecane` | Box(307) | Discrete(41) |
| `chemlab/SaltFromOilExtraction-v0` | ext of `salt_from_oil` | Box(301) | Discrete(41) |
| `chemlab/WurtzDistillation-v0` | dit of `wurtz_dodecane` | Box(310) | Discrete(31) |
| `chemlab/BenzoicAcidCrystallization-v0` | cry of `recrystallization` | Box(305) | Discrete(35) |
| `chemlab/RealWurtzReaction-v0` | rxn of `wurtz_real` | Box(208) | Box(5) |
| `chemlab/RealWurtzExtraction-v0` | ext of `wurtz_real` | Box(301) | Discrete(41) |
| `chemlab/RealWurtzDistillation-v0` | dit of `wurtz_real` | Box(304) | Discrete(31) |
| `chemlab/Bench-v0` | `bench` of any `scenario` | follows the scenario | follows the scenario |

### Arguments
- `scenario` (bundled name, path or loaded scenario), `bench` (its key), `goals` (one, several, or None for all).
- `starts`: initial states: `paper`, `lab` or `both`.
- `render_mode`: `ansi`, `rgb_array`, `rgb_array_true`, `human` or None (single environments).
- `split`: split of worlds for hidden parameters: `train`, `validation`, `test` or `private:SALT`.
- `actions`: `discrete` replaces continuous actions by a choice among representative ones.
- Batches: `num_envs`, `autoreset_mode`, `threads`, `copy`.

### Episodes
An episode is one experiment. It ends by the agent's `end` or the step limit with `terminated` and pays the bench's
score; nothing is truncated. `spec.max_episode_steps` is one more than the step limit. Infos in every step:
`action_mask` (discrete actions), `cost` (weighted safety events of the step), `events` (the same by kind, [kinds, as in
the scenario's `safety_events`]), `illegal_action` (the action was invalid), `experiment_over`, and `score` (0 until
then). In single environments, scalars have NumPy types as well.

### Seeds
Member i of a batch reset with seed s plays the same as a single environment reset with seed s + i (or with its own seed
from a list), for any batch size and number of threads.

### Version history
- v0: first version.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from ..config.loading import load_scenario
from ..config.scenario import Scenario
from ..kernels.arrays import IntArray
from ..kernels.rng import checked_seed
from ..kernels.tables import put_back
from ..lab.experiments import ExperimentBatch
from ..lab.hidden import World, Worlds
from .rendering import RENDER_MODES, Rendered
from .vector import BatchEnv, BoundedSpec, State

if TYPE_CHECKING:
    from ..render.scene import Scene

__all__ = ["BenchEnv", "BenchVectorEnv"]


class BenchEnv(BoundedSpec, Rendered, gymnasium.Env[npt.NDArray[np.float32], Any]):
    """One bench of a scenario as a Gymnasium environment; see this module's documentation for arguments and infos.

    Raises:
        DataError: the scenario, bench, goal or kind of initial states is unknown.
        ValueError: the render mode is unknown.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's class attribute
        "render_modes": list(RENDER_MODES),
        "render_fps": 4,
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        bench: str = "rxn",
        goals: str | Sequence[str] | None = None,
        starts: str = "paper",
        render_mode: str | None = None,
        split: str | None = None,
        actions: str | None = None,
    ) -> None:
        self._set_render_mode(render_mode)
        self.scenario = spec = load_scenario(scenario, split=split, actions=actions)
        self.batch = ExperimentBatch(spec, bench, 1, goals, starts)
        self.bench = self.batch.bench
        self.observation_space: gymnasium.Space[Any] = self.bench.observation_space
        self.action_space = self.bench.action_space
        self.max_episode_steps = self.bench.step_limit + 1
        self._observation = np.zeros((1, *self.bench.observation_space.shape), dtype=np.float32)
        self._consequences = np.zeros(1), np.zeros(1)
        self._over = True
        self._seeded = False

    @property
    def action_meanings(self) -> list[str]:
        """Description of each action, or of each number of a continuous action."""
        return self.bench.action_meanings

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start an experiment.

        Args:
            seed: starts a series of episodes that depends on the seed alone; None: the next episode of the series (the
                first reset draws a seed).
            options: ``{"goal": name}`` sets the goal instead of drawing it, ``{"world": seed or values}`` sets the
                world (see :meth:`chemlab.lab.hidden.Worlds.begin`).

        Raises:
            ValueError: an option or goal is unknown, the world is invalid, or the seed is not a non-negative integer;
                nothing has changed.
        """
        seed = checked_seed(seed)
        options = options or {}
        goals = self.batch.scenario.goals
        if set(options) - {"goal", "world"} or options.get("goal", goals[0]) not in goals:
            raise ValueError(f"reset options: known: world; goal, one of {', '.join(goals)}; given {options!r}")
        goal, world = options.get("goal"), options.get("world")
        if world is not None:
            self.batch.worlds.check(world)
        super().reset(seed=seed)
        self._over = True  # until it is finished: after an interruption only a reset helps
        if seed is not None or not self._seeded:
            self.batch.seed(0, int(self.np_random.integers(2**63)) if seed is None else seed)
            self._seeded = True
        self.batch.reset(self.batch.members, None if goal is None else goals.index(goal), world=world)
        found = self._observe(), self._info(stepped=False)
        self._over = False
        self._show()
        return found

    def step(self, action: Any) -> tuple[npt.NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Play one action of the experiment.

        Raises:
            ValueError: the action is outside the action space (nothing has changed).
            gymnasium.error.ResetNeeded: the experiment is over or has not begun, or an earlier step was interrupted or
                failed.
        """
        batch = self.batch
        checked = self.bench.checked(batch.experiments.agent, action)
        if self._over:
            raise gymnasium.error.ResetNeeded(
                "the experiment is over, has not begun, or a step was interrupted or failed: call reset()"
            )
        self._over = True  # until it is finished, as in reset
        batch.act(checked)
        cost, reward = self._consequences
        cost[0], reward[0] = 0.0, 0.0
        self.bench.consequences(batch.shelf, batch.experiments, batch.members, cost, reward)
        total = float(reward[0])
        # The last observation and mask are of the running experiment: read them first.
        observation, info = self._observe(), self._info(float(cost[0]))
        over = bool(batch.experiments.ended[0])
        if over:
            score = float(batch.finish(batch.members)[0])
            info["experiment_over"], info["score"] = np.array(True), np.float64(score)
            total += score
        self._over = over
        self._show()
        return observation, total, over, False, info

    def _observe(self) -> npt.NDArray[np.float32]:
        self.batch.observe(self._observation)
        return np.array(self._observation[0])

    def _info(self, cost: float = 0.0, stepped: bool = True) -> dict[str, Any]:
        experiments = self.batch.experiments
        info: dict[str, Any] = {
            # NumPy types, as required by TorchRL; booleans are zero-dimensional arrays, because Gymnasium's vector
            # environments treat NumPy booleans as objects.
            "cost": np.float64(cost),
            "events": experiments.events[0].copy() if stepped else np.zeros(len(self.bench.scenario.safety_events)),
            "illegal_action": np.array(experiments.illegal[0]),
            "experiment_over": np.array(False),
            "score": np.float64(0.0),
        }
        if self.bench.action_count:
            info["action_mask"] = self.batch.mask()[0]
        return info

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return the legal actions, in the format of sb3-contrib's MaskablePPO.

        Raises:
            ValueError: the bench's actions are continuous.
        """
        if not self.bench.action_count:
            raise ValueError(f"{self.batch.experiments.agent}: continuous actions have no mask")
        return np.asarray(self.batch.mask()[0], dtype=np.bool_)

    def get_state(self) -> State:
        """Return copies of everything that changes, for :meth:`set_state` (planning, debugging)."""
        flags = np.array([self._over, self._seeded])
        return [*(array.copy() for array in self.batch.arrays()), flags]

    def set_state(self, state: State) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical environment; return the observation.

        Raises:
            ValueError: it is of another environment; nothing changes.
        """
        flags = np.zeros(2, dtype=np.bool_)
        put_back([*self.batch.arrays(), flags], state)
        self._over, self._seeded = map(bool, flags)
        return self._observe()

    def _scene(self) -> Scene:
        from ..render.scene import bench_scene

        return bench_scene(self.batch)

    def _text(self) -> str:
        experiments, bench = self.batch.experiments, self.bench
        lines = [
            f"{bench.scenario.title} - {bench.key}, goal {bench.goals.names[experiments.goal[0]]}, "
            f"step {experiments.steps[0]}/{bench.spec.step_limit}"
        ]
        for p, position in enumerate(bench.positions):
            vessel = self.batch.shelf.vessel(0, p)
            lines.append(
                f"  {position:<6} {vessel.volume_l:.2f}/{vessel.capacity_l:.2f} L, {vessel.temperature_k:.1f} K"
            )
        return "\n".join(lines)


class BenchVectorEnv(BatchEnv):
    """N experiments on one bench in one set of arrays, stepped by the same kernels as :class:`BenchEnv`.

    Args:
        num_envs: number of experiments N.
        scenario, bench, goals, starts, split, actions: as for :class:`BenchEnv`.
        autoreset_mode: ``NEXT_STEP`` (default: the step after the end resets, its action is ignored), ``SAME_STEP``
            (the step that ends returns the next episode's observation; the last one is ``infos["final_obs"]``) or
            ``DISABLED`` (reset with ``options={"reset_mask": mask}``).
        threads: threads to step with; results do not depend on it.
        copy: whether returned arrays are copies; if False, the next step overwrites them.
        render_mode: for compatibility with Gymnasium; must be None, because batches do not render.
        max_episode_steps: for compatibility with Gymnasium; must exceed the bench's step limit.

    Raises:
        DataError: the scenario, bench, goal or kind of initial states is unknown.
        ValueError: a number is out of bounds, or a render mode is given.
    """

    # A class attribute, because Gymnasium closes even an environment whose constructor failed.
    _pool: ThreadPoolExecutor | None = None
    _pool_process = 0
    """Id of the process of those threads; a forked child has none of them."""

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        bench: str = "rxn",
        goals: str | Sequence[str] | None = None,
        starts: str = "paper",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        copy: bool = True,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        split: str | None = None,
        actions: str | None = None,
    ) -> None:
        for name, number in (("num_envs", num_envs), ("threads", threads)):
            if number < 1:
                raise ValueError(f"{name} must be at least 1, given {number}")
        spec = load_scenario(scenario, split=split, actions=actions)
        self.batch = ExperimentBatch(spec, bench, num_envs, goals, starts)
        self.bench = self.batch.bench
        super().__init__(
            num_envs,
            self.batch.experiments.agent,
            self.batch.scenario.goals,
            len(self.batch.scenario.safety_events),
            self.bench.step_limit,
            self.bench.observation_space,
            self.bench.action_space,
            autoreset_mode,
            copy,
            render_mode,
            max_episode_steps,
        )
        self.threads = min(threads, num_envs)
        self._waiting: list[Future[Any]] = []
        bounds = np.linspace(0, num_envs, self.threads + 1).astype(int)
        # Each thread has its own members and scratch, and touches only its own rows.
        self._chunks = [
            (np.arange(low, high), self.bench if i == 0 else self.bench.separate_scratch())
            for i, (low, high) in enumerate(itertools.pairwise(bounds))
        ]

    def _seed_member(self, member: int, seed: int) -> None:
        self.batch.seed(member, seed)

    @property
    def _worlds(self) -> Worlds:
        return self.batch.worlds

    def _begin(self, members: IntArray, goal: int | None, world: World | None) -> None:
        self._join()
        self.batch.reset(members, goal, world=world)
        for chunk, bench in self._chunks:
            self._look(chunk, bench)

    def _play(self, actions: npt.NDArray[Any]) -> list[tuple[IntArray, npt.NDArray[np.float32]]]:
        if self.threads == 1:
            return [self._step_chunk(*self._chunks[0], actions)]
        if self._pool is None or self._pool_process != os.getpid():
            self._pool = ThreadPoolExecutor(self.threads - 1, thread_name_prefix="chemlab")
            self._pool_process = os.getpid()
        for chunk in self._chunks[1:]:
            self._waiting.append(self._pool.submit(self._step_chunk, *chunk, actions))
        own = self._step_chunk(*self._chunks[0], actions)
        return [own, *(future.result() for future in self._join())]

    def _join(self) -> list[Future[Any]]:
        """Wait for the other threads' part of a step, including an interrupted one."""
        wait(self._waiting)
        done, self._waiting = self._waiting, []
        return done

    def _step_chunk(
        self, members: npt.NDArray[np.int64], bench: Any, actions: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
        """Step one thread's members; return the ended ones and, with SAME_STEP, their last observations."""
        batch = self.batch
        shelf, experiments = batch.shelf, batch.experiments
        low, high = int(members[0]), int(members[-1]) + 1
        self._terminated[low:high] = False
        self._scores[low:high] = np.nan
        acting, waiting = members, self._pending[low:high]
        if waiting.any():
            if self.autoreset_mode is AutoresetMode.NEXT_STEP:
                batch.reset(members[waiting], None, bench)
            acting = members[~waiting]
            self._rewards[members[waiting]] = 0.0
            self._costs[members[waiting]], self._illegal[members[waiting]] = 0.0, False
            self._events[members[waiting]] = 0.0
            waiting[:] = False
        rows: Any = slice(low, high) if len(acting) == len(members) else acting
        batch.act(actions[rows], acting, bench)
        self._rewards[rows], self._costs[rows] = 0.0, 0.0
        bench.consequences(shelf, experiments, acting, self._costs, self._rewards)
        # A reset in the same step overwrites these.
        self._illegal[rows], self._events[rows] = experiments.illegal[rows], experiments.events[rows]
        ended = acting[experiments.ended[rows]]
        last = np.zeros((0, self._observations.shape[1]), dtype=np.float32)
        if len(ended):
            self._terminated[ended] = True
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                last = np.empty((len(ended), self._observations.shape[1]), dtype=np.float32)
                bench.observe(shelf, experiments, ended, last)
                self._score(bench, ended)
                batch.reset(ended, None, bench)
            else:
                # The last observation is of the running experiment: read it first.
                self._look(members, bench)
                self._score(bench, ended)
                self._pending[ended] = True
                return ended, last
        self._look(members, bench)
        return ended, last

    def _score(self, bench: Any, ended: npt.NDArray[np.int64]) -> None:
        score = bench.finish(self.batch.shelf, self.batch.experiments, ended)
        self._scores[ended] = score
        self._rewards[ended] += score

    def _look(self, members: npt.NDArray[np.int64], bench: Any) -> None:
        low, high = int(members[0]), int(members[-1]) + 1
        shelf, experiments = self.batch.shelf, self.batch.experiments
        bench.observe(shelf, experiments, members, self._observations[low:high])
        if bench.action_count:
            bench.mask(shelf, experiments, members, self._masks[low:high])

    @property
    def action_meanings(self) -> list[str]:
        """Description of each action, or of each number of a continuous action."""
        return self.bench.action_meanings

    def _more_arrays(self) -> State:
        self._join()
        return self.batch.arrays()

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        if self._pool is not None and self._pool_process == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # Threads cannot be pickled or copied; they are restarted when needed.
        return {**vars(self), "_pool": None, "_waiting": []}
