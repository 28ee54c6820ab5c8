"""One role as a Gymnasium environment, single or in a batch: a bench alone, or a role among others played by policies.

| Id | Role | Observation | Action |
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
| `chemlab/Bench-v1` | `bench` of any `scenario` | follows the scenario | follows the scenario |
| `chemlab/LabManager-v1` | `manager_0` in the laboratory | follows the scenario | follows the scenario |
| `chemlab/LabAgent-v1` | any `agent` in the laboratory | follows the scenario | follows the scenario |

### Arguments
- `scenario` (bundled name, path or loaded scenario) and either `bench` (a bench's key: the bench alone) or `agent` (an
  agent's name: in the laboratory).
- `split`: split of worlds for hidden parameters: `train`, `validation`, `test` or `private:SALT`.
- `actions`: `discrete` replaces continuous actions by a choice among representative ones.
- `render_mode`: `ansi`, `rgb_array`, `rgb_array_true`, `human` or None (single environments).
- A bench alone: `goals` (one, several, or None for all); `starts`, its initial states: `paper`, `lab` or `both`.
- In the laboratory: `policies` of the other agents, `rewards`. The ids and :func:`chemlab.agents.background.role_env`
  take the policies by name (`background`).
- Batches: `num_envs`, `autoreset_mode`, `copy`, for a bench alone `threads`.

### Episodes
For a bench alone, an episode is one experiment. It ends by the agent's `end` or the step limit with `terminated` and
pays the bench's score.

In the laboratory, an episode is the laboratory's. A step is one turn of the agent; the others then play up to its next
one. The episode ends for every agent, with `terminated`, when the manager has submitted its last order or a limit is
reached. For a bench's agent it spans all of its experiments. The reward is everything the agent has earned since its
last turn. `reset` plays on to the agent's first turn (episodes in which it never has one are played over).

Nothing is truncated; `spec.max_episode_steps` is one more than the longest episode.

### Infos
Infos of every step:

- `action_mask` (discrete actions) and `illegal_action` (the action was invalid).
- `cost`: weighted safety events of the agent's own actions in the step; `events`: events of the step by kind, [kinds,
  as in the scenario's `safety_events`], in the laboratory those of all agents.
- `experiment_over` and `score`: whether an experiment of the agent has ended (for the manager, the episode), and the
  score (the sum, should several have ended), else 0.
- In the laboratory also `lab_cost` (of all agents), and `elapsed_ticks` since the agent's last turn: discount what
  follows by gamma to that power if time matters, by gamma once if decisions do. Single environments of the manager have
  `costs`, `goals`, `submitted_mol` and `purity` (:meth:`~chemlab.roles.manager_role.ManagerRole.accounts`).

In single environments, scalars have NumPy types as well.

### Seeds
Member i of a batch reset with seed s plays the same as a single environment reset with seed s + i (or with its own seed
from a list), for any batch size and number of threads, as long as the policies of the others have no other randomness
than what ``seed(member, seed)`` starts (scripted and random ones do).

### Version history
- v1 (environments of any scenario): worlds, version 2.
- v0: first version.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from typing_extensions import Unpack

from ..config.loading import load_scenario, plain_scenario
from ..config.scenario import MANAGER_AGENT, RewardSpec, Scenario, Settings
from ..kernels.arrays import FloatArray
from ..kernels.rng import checked_seed
from ..kernels.tables import put_back
from ..lab.engine import Laboratories
from ..lab.experiments import ExperimentBatch
from ..roles.bench import Bench
from .inputs import check_count, checked_actions, checked_options, parsed_reset
from .rendering import RENDER_MODES, Rendered
from .role_episodes import BenchEpisodes, LaboratoryEpisodes, Policies, RoleEpisodes, State

if TYPE_CHECKING:
    from ..render.scene import Scene


def _plain(argument: Any) -> Any:
    """Return an environment's argument as equivalent plain data if possible."""
    if isinstance(argument, Scenario):
        return plain_scenario(argument)
    if isinstance(argument, Path):
        return str(argument)
    if isinstance(argument, RewardSpec):
        return argument.model_dump()
    return argument.value if isinstance(argument, AutoresetMode) else argument


class _OneRole:
    """Common parts of the single environment and the batch: the played episodes, and Gymnasium's ``spec``.

    The ``spec`` is completed with ``max_episode_steps`` and plain arguments. The bound on episodes depends on the
    scenario, so it cannot be in Gymnasium's registry. It is one more than the longest episode, so that time limits of
    clients or of ``gymnasium.make`` never truncate one. With plain arguments ``spec.to_json()`` works, in which Minari
    stores a dataset's environment: a path becomes text; a loaded scenario its name or path, or its content if neither
    gives the same scenario, and its split. The salt of a private split is left out (``split="private"``): such a spec
    makes no environment until the salt is given again, by ``gymnasium.make(spec, split="private:SALT")``.
    """

    episodes: RoleEpisodes
    scenario: Scenario
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
            if self.scenario.split.name != "train":
                spec.kwargs["split"] = self.scenario.split.public
            if spec.max_episode_steps is None:
                spec.max_episode_steps = self.max_episode_steps
        self._spec = spec

    @property
    def batch(self) -> ExperimentBatch:
        """Experiments of a bench alone (AttributeError in the laboratory)."""
        return cast(BenchEpisodes, self.episodes).batch

    @property
    def bench(self) -> Bench:
        """The bench alone (AttributeError in the laboratory)."""
        return cast(BenchEpisodes, self.episodes).bench

    @property
    def laboratories(self) -> Laboratories:
        """The laboratories (AttributeError for a bench alone)."""
        return cast(LaboratoryEpisodes, self.episodes).laboratories

    @property
    def focal(self) -> int:
        """Index of the agent in the laboratory (AttributeError for a bench alone)."""
        return cast(LaboratoryEpisodes, self.episodes).focal

    @property
    def action_meanings(self) -> list[str]:
        """Description of each action, or of each number of a continuous action."""
        return self.episodes.workplace.action_meanings


def _reject(place: str, **arguments: Any) -> None:
    """Raise a ValueError if an argument is given that does not apply at this place."""
    given = [name for name, value in arguments.items() if value is not None]
    if given:
        raise ValueError(f"{', '.join(given)}: not an argument of {place}; omit it")


def _mode(autoreset_mode: str | AutoresetMode) -> AutoresetMode:
    try:
        return AutoresetMode(autoreset_mode)
    except ValueError:
        names = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode: must be one of {names}, given {autoreset_mode!r:.100}") from None


class RoleVectorEnv(_OneRole, gymnasium.vector.VectorEnv[npt.NDArray[np.float32], Any, Any]):
    """N members with one role each in one set of arrays; see this module's documentation.

    Args:
        num_envs: number of members N.
        scenario: a bundled name, a path to a TOML file, or a loaded scenario.
        agent: name of the acting agent in the laboratory (default: the manager).
        policies: policies of the others.
        bench: key of a bench, for the bench alone.
        goals, starts: of a bench alone, as for :class:`~chemlab.lab.experiments.ExperimentBatch`.
        threads: of a bench alone, threads to step with (default: 1); results do not depend on it.
        autoreset_mode: ``NEXT_STEP`` (default: the step after the end resets, its action is ignored), ``SAME_STEP``
            (the step that ends returns the next episode's observation and mask; the last observation is
            ``infos["final_obs"]``, the other infos are of that step and also in ``infos["final_info"]``) or
            ``DISABLED`` (reset with ``options={"reset_mask": mask}``).
        copy: whether returned arrays are copies; if False, the next step overwrites them.
        render_mode: for compatibility with Gymnasium; must be None, because batches do not render.
        max_episode_steps: for compatibility with Gymnasium; batches do not truncate episodes, so it must exceed the
            longest one.
        settings: ``rewards`` (in the laboratory), ``split`` and ``actions``
            (:meth:`~chemlab.config.scenario.Scenario.configured`).

    Raises:
        DataError: the scenario, bench, goal or kind of initial states is invalid or unknown.
        ValueError: the agent is unknown, an agent has no policy, a number is out of bounds, a render mode is given, or
            an argument of a bench alone is given for the laboratory or the other way round.
        TypeError: an object is not a policy.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        agent: str | None = None,
        policies: Policies | None = None,
        *,
        bench: str | None = None,
        goals: str | Sequence[str] | None = None,
        starts: str | None = None,
        threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        mode = _mode(autoreset_mode)
        for unknown in settings.keys() - Settings.__annotations__:
            known = ["scenario", "agent", "policies", "bench", "goals", "starts", *Settings.__annotations__]
            # Python's words, which TorchRL searches for.
            raise TypeError(f"unexpected keyword argument {unknown!r}; choose from {', '.join(known)}")
        check_count("num_envs", num_envs, "scenario")
        if threads is not None:
            check_count("threads", threads)
        own: RoleEpisodes
        if bench is None:
            _reject("a role in the laboratory (without bench=...)", goals=goals, starts=starts, threads=threads)
            labs = Laboratories(scenario, num_envs, **settings)
            own = LaboratoryEpisodes(labs, MANAGER_AGENT if agent is None else agent, policies, mode)
        else:
            _reject("a bench alone", agent=agent, policies=policies, rewards=settings.get("rewards"))
            loaded = load_scenario(scenario, **settings)
            own = BenchEpisodes(num_envs, loaded, bench, goals, starts or "paper", threads or 1, mode)
        self.episodes = own
        if max_episode_steps is not None and max_episode_steps <= own.longest:
            raise ValueError(
                f"max_episode_steps: a batch's episodes take up to {own.longest} steps and are not truncated, given "
                f"{max_episode_steps}; omit it, or make single environments (vectorization_mode='sync')"
            )
        if render_mode is not None:
            raise ValueError(
                f"render_mode: must be None, as batches do not render, given {render_mode!r}; omit it, or make "
                "single environments (vectorization_mode='sync')"
            )
        self.max_episode_steps = own.longest + 1
        self.num_envs = num_envs
        self.scenario, self.agent = own.scenario, own.agent
        self.render_mode = render_mode
        self.autoreset_mode = mode
        self.metadata = {**self.metadata, "autoreset_mode": mode}
        self.single_observation_space = own.observation_space
        self.single_action_space = own.action_space
        self.observation_space = gymnasium.vector.utils.batch_space(own.observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(own.action_space, num_envs)
        self.action_count = own.action_count
        """Number of discrete actions; 0 for continuous actions."""
        self.copy = copy
        self._begun = False

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
        own = self.episodes
        mask, seeds, goal, world = parsed_reset(
            seed, options, self.num_envs, own.goals, own.worlds, self._begun, self.np_random
        )
        self._begun = False  # until it is finished: after an interruption or a failing policy or model, a reset helps
        super().reset(seed=int(seed) if isinstance(seed, (int, np.integer)) else None)
        for member in np.flatnonzero(mask):
            member_seed = seeds[member]
            if member_seed is not None:
                own.seed(int(member), member_seed)
        own.pending[mask] = False
        own.clear(slice(None))  # of the others, too: in a reset nothing happens to them
        own.begin(np.flatnonzero(mask), None if goal is None else own.goals.index(goal), world)
        found = self._returned(own.observations), self._infos()
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
        own = self.episodes
        checked = checked_actions(self.agent, actions, self.num_envs, self.single_action_space)
        if not self._begun or (self.autoreset_mode is AutoresetMode.DISABLED and own.pending.any()):
            raise self._reset_needed()
        self._begun = False  # until it is finished, as in reset
        finals = own.play(checked)
        infos = self._infos()
        ended = own.terminated.copy()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and ended.any():
            # Not zeros_like(), which would write all rows although most stay unchanged.
            final = np.zeros(own.observations.shape, dtype=own.observations.dtype)
            for members, observations in finals:
                final[members] = observations
            infos["final_obs"], infos["_final_obs"] = final, ended
            last = {name: infos[name] for name in infos if name[0] != "_" and name not in ("final_obs", "action_mask")}
            infos["final_info"], infos["_final_info"] = {**last, **{f"_{name}": ended for name in last}}, ended
        seen, rewards = self._returned(own.observations), self._returned(own.rewards)
        self._begun = True
        return seen, rewards, ended, np.zeros(self.num_envs, dtype=np.bool_), infos

    def _reset_needed(self) -> gymnasium.error.ResetNeeded:
        return gymnasium.error.ResetNeeded(
            f"{self.agent}: the episode is over, has not begun, or a step was interrupted or failed: call reset()"
        )

    def _returned(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return array.copy() if self.copy else array

    def _infos(self) -> dict[str, Any]:
        own = self.episodes
        scored = np.isfinite(own.scores)
        infos: dict[str, Any] = {
            "cost": own.costs.copy(),
            "events": own.events.copy(),
            "illegal_action": own.illegal.copy(),
            "experiment_over": scored,
            "score": np.where(scored, own.scores, 0.0),
            **own.more_infos(),
        }
        if self.action_count:
            infos["action_mask"] = self._returned(own.masks)
        # Gymnasium's masks of members that have an info.
        infos.update({f"_{name}": np.ones(self.num_envs, dtype=np.bool_) for name in infos})
        return infos

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return [N, actions] the current legal actions.

        Raises:
            ValueError: the agent's actions are continuous.
        """
        if not self.action_count:
            raise ValueError(f"{self.agent}: continuous actions have no mask")
        return self.episodes.masks.astype(np.bool_)

    def get_state(self) -> State:
        """Return copies of everything that changes, including policies' memories, for :meth:`set_state`."""
        memories = np.empty(1, dtype=object)
        memories[0] = self.episodes.get_memory()
        return [*(array.copy() for array in self.episodes.arrays()), np.array([self._begun]), memories]

    def set_state(self, state: State) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical batch; return the observations.

        Raises:
            ValueError: it is of another batch; nothing changes.
        """
        begun, memories = np.zeros(1, dtype=np.bool_), np.empty(1, dtype=object)
        put_back([*self.episodes.arrays(), begun, memories], state)
        self._begun = bool(begun[0])
        self.episodes.set_memory(memories[0])
        return self._returned(self.episodes.observations)

    def close_extras(self, **kwargs: Any) -> None:
        """Stop threads."""
        if hasattr(self, "episodes"):  # Gymnasium closes even an environment whose constructor failed
            self.episodes.close()


class RoleEnv(_OneRole, Rendered, gymnasium.Env[npt.NDArray[np.float32], Any]):
    """One role as an environment, a :class:`RoleVectorEnv` of one; see this module's documentation.

    Args:
        scenario, agent, policies, bench, goals, starts, rewards, split, actions: as for :class:`RoleVectorEnv`.
        render_mode: ``ansi``, ``rgb_array``, ``rgb_array_true``, ``human`` or None.

    Raises:
        DataError, ValueError, TypeError: as for :class:`RoleVectorEnv`; ValueError also for an unknown render mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's class attribute
        "render_modes": list(RENDER_MODES),
        "render_fps": 8,
    }

    def __init__(
        self,
        scenario: str | Path | Scenario = "wurtz_dodecane",
        agent: str | None = None,
        policies: Policies | None = None,
        *,
        bench: str | None = None,
        goals: str | Sequence[str] | None = None,
        starts: str | None = None,
        render_mode: str | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        self._set_render_mode(render_mode)
        self.vector = RoleVectorEnv(
            1,
            scenario,
            agent,
            policies,
            bench=bench,
            goals=goals,
            starts=starts,
            autoreset_mode=AutoresetMode.DISABLED,
            **settings,
        )
        self.episodes = self.vector.episodes
        self.scenario, self.agent = self.vector.scenario, self.vector.agent
        self.max_episode_steps = self.vector.max_episode_steps
        self.observation_space: gymnasium.Space[Any] = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Start an episode; in the laboratory, the others play up to the agent's first turn.

        Args:
            seed: starts a series of episodes that depends on the seed alone; None: the next episode of the series (the
                first reset draws a seed).
            options: ``{"goal": name}`` sets the goal instead of drawing it, ``{"world":
                seed or values}`` sets the world (see :meth:`chemlab.lab.hidden.Worlds.begin`).

        Raises:
            ValueError: an option or goal is unknown, the world is invalid, or the seed is not a non-negative integer;
                nothing has changed.
        """
        seed = checked_seed(seed)
        checked_options(options, self.episodes.goals, self.episodes.worlds)
        observations, _ = self.vector.reset(seed=seed, options=options)
        super().reset(seed=seed)
        self._show()
        return observations[0], self._info()

    def step(self, action: Any) -> tuple[npt.NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Play one action; in the laboratory, the others then play up to the next turn of the agent.

        Raises:
            ValueError: the action is outside the action space (nothing has changed).
            gymnasium.error.ResetNeeded: the episode is over or has not begun, or an earlier step was interrupted or
                failed.
        """
        own, vector = self.episodes, self.vector
        checked = own.checked(action)
        if not vector._begun or own.pending.item(0):
            raise vector._reset_needed()
        vector._begun = False  # until it is finished, as in reset
        own.play_one(checked)
        found = own.observations[0].copy(), own.rewards.item(0), own.pending.item(0), False, self._info()
        vector._begun = True
        self._show()
        return found

    def _info(self) -> dict[str, Any]:
        own = self.episodes
        score = own.scores[0]
        scored = bool(score == score)  # NaN without a score
        info: dict[str, Any] = {
            # NumPy types, as required by TorchRL; booleans are zero-dimensional arrays, because Gymnasium's vector
            # environments treat NumPy booleans as objects.
            "cost": own.costs[0],
            "events": own.events[0].copy(),
            "illegal_action": np.array(own.illegal[0]),
            "experiment_over": np.array(scored),
            "score": score if scored else np.float64(0.0),
        }
        for name, values in own.more_infos().items():
            info[name] = values[0]
        if own.action_count:
            info["action_mask"] = own.masks[0].copy()
        info.update(own.accounts())
        return info

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Return the legal actions, in the format of sb3-contrib's MaskablePPO.

        Raises:
            ValueError: the agent's actions are continuous.
        """
        masks: npt.NDArray[np.bool_] = self.vector.action_masks()[0]
        return masks

    def get_state(self) -> State:
        """Return copies of everything that changes, including policies' memories, for :meth:`set_state`."""
        return self.vector.get_state()

    def set_state(self, state: State) -> npt.NDArray[np.float32]:
        """Restore a :meth:`get_state` of this or of an identical environment; return the observation."""
        observation: npt.NDArray[np.float32] = self.vector.set_state(state)[0]
        return observation

    def _text(self) -> str:
        return self.episodes.text()

    def _scene(self) -> Scene:
        return self.episodes.scene()
