"""Train roles of a laboratory with RLlib's PPO, on a Ray of its own or on a cluster.

>>> from pathlib import Path
>>> from chemlab.agents.train.arguments import RllibArguments
>>> from chemlab.agents.rllib.train import train_rllib
>>> train_rllib(RllibArguments("wurtz_dodecane", roles=("manager",)), Path("runs/manager"))   # doctest: +SKIP

Env runners play (:mod:`chemlab.agents.rllib.env`), wherever in the cluster Ray puts them; the process that was started
gathers their turns, updates a policy for each role, evaluates and writes the run's folder
(:mod:`chemlab.agents.runs`). A checkpoint has each role's policy as ``ROLE.safetensors`` and ``ROLE.json``,
which play without Ray and PyTorch (:mod:`chemlab.agents.pretrained`).

An env runner that dies is started again and gets the current policies; until then the others play its share. A run
that was stopped goes on from its last checkpoint, with networks and optimizers as they were, in new episodes.

Needs the extra: ``pip install ".[rllib]"``.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from chemlab.config.scenario import Scenario

from ..executors import connected
from ..policies import Policy
from ..pretrained import Card, PretrainedPolicy, load_pretrained, save_policy
from ..roles import MANAGER_ROLE, role_of
from ..runs import Evaluation, Run, RunResult
from ..train.arguments import RllibArguments

try:
    import ray
    import torch
    from ray.rllib.algorithms.algorithm import Algorithm
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.core.columns import Columns
    from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
    from ray.rllib.core.rl_module.rl_module import RLModuleSpec
    from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS, NUM_ENV_STEPS_SAMPLED

    from ..train.checkpoints import load_state, save_state
    from ..train.loop import (
        LaboratoryTrainee,
        Progress,
        Watcher,
        described_team,
        open_run,
        reached,
        train_in_rounds,
        training_versions,
    )
    from .env import LaboratoryMultiAgentEnv
    from .module import PerRolePPOLearner, RoleModule, policy_weights
except ImportError as error:
    raise ImportError(f'training on a cluster needs Ray ({error}): pip install ".[rllib]"') from error

__all__ = ["algorithm_config", "train_rllib"]

LABEL = "rllib"
"""What figures call the algorithm."""

ALGORITHM = "ppo"
_TOLERANCE = 1e-5
_SCORES = "chemlab_scores"
_PATIENCE_S = 600.0
"""How long a runner may take for its share of a batch (kernels compile at first), and a run waits for any runner."""


def _policy_of(agent: str, *_: Any, **__: Any) -> str:
    """Which policy an agent follows; by name, for it travels with every episode."""
    return role_of(agent)


def _log_score(*, metrics_logger: Any, env: Any, env_index: int, **_: Any) -> None:
    """An env runner's episode is over."""
    metrics_logger.log_value(_SCORES, env.envs[env_index].unwrapped.score, reduce="item_series")


def algorithm_config(arguments: RllibArguments, scenario: Scenario, roles: Sequence[str], seed: int) -> PPOConfig:
    """RLlib's settings of a run; ``.build_algo()`` makes of them an algorithm to be used in RLlib's own ways.

    Args:
        arguments: the run's.
        scenario: the laboratory, which goes to env runners as it is: its file need not be there.
        roles: those that learn.
        seed: of networks and exploration; runner i adds i, and 1000 i for its laboratories.
    """
    a = arguments
    settings = {"scenario": scenario, "roles": list(roles), "background": a.background, "split": a.split}
    env = LaboratoryMultiAgentEnv(settings)
    specs, overrides = {}, {}
    for role in roles:
        agent = next(agent for agent in env.possible_agents if role_of(agent) == role)
        space, actions = env.observation_spaces[agent], env.action_spaces[agent]
        specs[role] = RLModuleSpec(module_class=RoleModule, observation_space=space, action_space=actions)
        discrete = isinstance(actions, gymnasium.spaces.Discrete)
        overrides[role] = PPOConfig.overrides(
            gamma=a.manager_gamma if role == MANAGER_ROLE else a.gamma, entropy_coeff=a.ent_coef if discrete else 0.0
        )
    return (
        PPOConfig()
        .environment(
            LaboratoryMultiAgentEnv,
            env_config=settings,
            # Continuous actions are drawn where they are played, and clipped, as SB3 has it.
            normalize_actions=False,
            clip_actions=True,
            disable_env_checking=True,  # RLlib's check plays without masks
        )
        .env_runners(
            num_env_runners=a.runners,
            num_envs_per_env_runner=a.envs,
            rollout_fragment_length="auto",
            sample_timeout_s=_PATIENCE_S,
        )
        .fault_tolerance(restart_failed_env_runners=True, delay_between_env_runner_restarts_s=1.0)
        .multi_agent(
            policies=set(roles),
            policy_mapping_fn=_policy_of,
        )
        .rl_module(
            rl_module_spec=MultiRLModuleSpec(rl_module_specs=specs), algorithm_config_overrides_per_module=overrides
        )
        .learners(learner_class=PerRolePPOLearner, num_learners=0)
        .training(
            lr=a.learning_rate,
            lambda_=a.gae_lambda,
            clip_param=a.clip_range,
            train_batch_size_per_learner=a.batch,
            minibatch_size=a.batch_size,
            num_epochs=a.epochs,
            # The rest as in SB3's PPO.
            use_kl_loss=False,
            vf_loss_coeff=0.5,
            vf_clip_param=float("inf"),
            grad_clip=0.5,
            grad_clip_by="global_norm",
        )
        .callbacks(on_episode_end=_log_score)
        .debugging(seed=seed, log_level="ERROR")
    )


class _Team(LaboratoryTrainee):
    """The roles that learn, as an RLlib algorithm, and those that are played."""

    def __init__(self, arguments: RllibArguments, scenario: Scenario, roles: list[str], step: int) -> None:
        super().__init__(arguments, scenario)
        self._arguments, self.roles = arguments, roles
        # One that goes on draws other episodes than those it has learned from.
        seed = arguments.seed if not step else int(np.random.SeedSequence([arguments.seed, step]).generate_state(1)[0])
        self.config = algorithm_config(arguments, scenario, roles, seed % 2**31)
        self.algorithm: Algorithm = self.config.build_algo()
        self._taken: dict[str, PretrainedPolicy] | None = None

    def learn(self, progress: Progress) -> tuple[int, list[float]]:
        """See :class:`~chemlab.agents.train.loop.Trainee`.

        Raises:
            RuntimeError: all env runners are lost and none has come back.
        """
        waiting = time.monotonic()
        while True:
            found = self.algorithm.train()[ENV_RUNNER_RESULTS]
            turns = int(found.get(NUM_ENV_STEPS_SAMPLED, 0))
            if turns:
                scores = found.get(_SCORES)
                # RLlib has NaN where no episode has ended.
                return turns, [float(score) for score in scores] if isinstance(scores, list) else []
            if time.monotonic() - waiting > _PATIENCE_S:
                raise RuntimeError(
                    f"no env runner has answered for {_PATIENCE_S:.0f} s; see Ray's logs, and run the command again"
                )
            time.sleep(1.0)  # the last runner is lost: Ray is starting it again

    def _states(self) -> dict[str, dict[str, npt.NDArray[Any]]]:
        states: dict[str, dict[str, npt.NDArray[Any]]] = self.algorithm.learner_group.get_weights()
        return {role: states[role] for role in self.roles}

    def learned(self) -> Mapping[str, Policy]:
        """See :class:`~chemlab.agents.train.loop.LaboratoryTrainee`."""
        return self._taken or {role: self._exported(role, state) for role, state in self._states().items()}

    def _exported(
        self, role: str, state: dict[str, npt.NDArray[Any]], step: int = 0, evaluation: dict[str, Any] | None = None
    ) -> PretrainedPolicy:
        """A role's policy without Ray and PyTorch, from its module's weights."""
        a, workplace = self._arguments, self.workplaces[role]
        card = Card.of(
            workplace,
            name=role,
            env_id="chemlab/Laboratory-v0",
            goals=list(self.scenario.lab_goals if role == MANAGER_ROLE else self.scenario.goals),
            starts="lab",
            algo=ALGORITHM,
            label=LABEL,
            seed=a.seed,
            step=step,
            command=a.command_line(),
            versions=_versions(),
            activation="tanh",
            output="argmax" if workplace.action_count else "clip",
            evaluation=evaluation or {},
        )
        return PretrainedPolicy(card, policy_weights(state))

    def _check(self, role: str, policy: PretrainedPolicy, state: dict[str, npt.NDArray[Any]]) -> None:
        """See that a policy puts out what RLlib's module does.

        Raises:
            ValueError: it does not.
        """
        spec = self.config.rl_module_spec.rl_module_specs[role]
        module: Any = spec.build()
        module.set_state(state)
        size = policy.card.observation_size
        seen = np.random.default_rng(0).random((256, size), dtype=np.float32)
        observation: Any = torch.from_numpy(seen)
        if policy.card.output == "argmax":
            masks = torch.ones((256, policy.card.action_size), dtype=torch.int8)
            observation = {"observations": observation, "action_mask": masks}
        with torch.no_grad():
            theirs = module.forward_inference({Columns.OBS: observation})[Columns.ACTION_DIST_INPUTS].numpy()
        theirs, ours = theirs[:, : policy.card.action_size], policy.values(seen)
        difference = float((np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs))).max())
        if not difference <= _TOLERANCE:
            raise ValueError(
                f"{role}: the exported policy differs from RLlib's by {difference:.2g} (allowed: {_TOLERANCE:g})"
            )

    def save(self, folder: Path, progress: Progress, evaluation: Evaluation | None) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`; with networks and optimizers in ``state.pkl``."""
        for role, state in self._states().items():
            policy = self._exported(role, state, progress.step, reached(self._arguments, evaluation))
            self._check(role, policy, state)
            save_policy(folder / role, policy.card, policy_weights(state))
        learned = {"learner_group": self.algorithm.learner_group.get_state(), "progress": vars(progress)}
        save_state(folder, learned)

    def restore(self, state: dict[str, Any]) -> None:
        """Put networks and optimizers back as a checkpoint has them, here and in the env runners."""
        self.algorithm.set_state(state)

    def take(self, folder: Path) -> None:
        """See :class:`~chemlab.agents.train.loop.Trainee`."""
        self._taken = {role: load_pretrained(folder / role) for role in self.roles}

    def stop(self) -> None:
        """End the env runners."""
        self.algorithm.stop()
        shutil.rmtree(self.algorithm.logdir, ignore_errors=True)  # RLlib makes one in the home folder; it is empty


def _versions() -> dict[str, str]:
    return {**training_versions(), "ray": ray.__version__}


def train_rllib(arguments: RllibArguments, out: Path, watcher: Watcher | None = None) -> RunResult:
    """Train, or go on training, or return the result of a run that is finished.

    Args:
        arguments: who learns what, and where.
        out: the run's folder; what is in it is described in :mod:`chemlab.agents.runs`, and a checkpoint has
            a policy for each role. On a cluster it is this machine's.
        watcher: is told how it goes.

    Raises:
        ValueError: the folder holds another run, another process trains it, an argument is wrong, or Ray is not there.
        DataError: unknown scenario.
        RuntimeError: all env runners were lost and none came back.
    """
    run = Run(out)
    scenario, roles, described = described_team(arguments, LABEL, ALGORITHM, _versions())

    def go_on() -> RunResult:
        last, state, progress = run.checkpoint("last"), None, Progress()
        if last is not None:
            state = load_state(last)
            progress = Progress.of(state.pop("progress"), last)
        with connected(arguments.address, arguments.runners):
            team = _Team(arguments, scenario, roles, progress.step)
            try:
                if state is not None:
                    team.restore(state)
                return train_in_rounds(run, described, team, arguments, progress, watcher)
            finally:
                team.stop()

    return open_run(run, described, arguments, go_on)
