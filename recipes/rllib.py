"""Training on Ray RLlib, on one machine or a cluster: the manager over scripted benches.

The environment is `chemlab.agents.rllib.LaboratoryMultiAgentEnv`, one turn per step. Env runners gather experience on
the nodes that Ray assigns, and lost ones are replaced; this process trains a policy for each role. `algorithm_config()`
makes RLlib's settings for any roles of any scenario; their `build_algo()` makes its `Algorithm`, with `train()`,
`save_to_path()` and `restore_from_path()`. Beside it, the same manager trained by `chemlab train` with PPO's same
settings, and the scripted one.

    python recipes/rllib.py --out recipes/results/rllib.json
    CHEMLAB_RUNNERS=64 RAY_ADDRESS=auto python recipes/rllib.py

Needs the extra ``rllib``.
"""

from __future__ import annotations

import itertools
import math
import os
import shutil
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.connectors.learner import GeneralAdvantageEstimation
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module.apis.value_function_api import ValueFunctionAPI
from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule
from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS, NUM_ENV_STEPS_SAMPLED
from recipe_parts import AUDIT_SEED, ONCE, PLAIN, SCRIPTED, Budget, Outcome, cook, score_run
from torch import nn

from chemlab import load_scenario
from chemlab.agents.episodes import play_laboratory
from chemlab.agents.evaluate.play import Target
from chemlab.agents.executors import connected
from chemlab.agents.policies import make_policies
from chemlab.agents.rllib import LaboratoryMultiAgentEnv
from chemlab.agents.roles import MANAGER_ROLE, role_of
from chemlab.agents.train.arguments import MaskablePPO
from chemlab.lab.engine import Laboratories

TARGET = Target(load_scenario("salt_from_oil"))
GOAL = "NaCl"
SETTINGS: dict[str, Any] = {"learning_rate": 1e-3, "gae_lambda": 0.95, "ent_coef": 0.01, "epochs": 10}
BATCH, MINIBATCH = 512, 128
_NEVER = -1e8
"""Logit of an illegal action; finite, so that entropies stay so."""


def _network(sizes: list[int], gain: float) -> nn.Sequential:
    """Tanh layers with orthogonal weights, ``gain`` for the last layer: the initialization of SB3's PPO."""
    layers: list[nn.Module] = []
    for i, (before, after) in enumerate(itertools.pairwise(sizes)):
        last = i == len(sizes) - 2
        layer = nn.Linear(before, after)
        nn.init.orthogonal_(layer.weight, gain if last else math.sqrt(2.0))
        nn.init.zeros_(layer.bias)
        layers += [layer] if last else [layer, nn.Tanh()]
    return nn.Sequential(*layers)


class RoleModule(TorchRLModule, ValueFunctionAPI):
    """Policy and value network of a role, two tanh layers of 64 each.

    Discrete roles: logits; those of illegal actions (0 in ``action_mask``) are so low that they are never drawn.
    Continuous ones: means, and a standard deviation that does not depend on the observation.
    """

    def setup(self) -> None:
        """Make the networks."""
        space, actions = self.observation_space, self.action_space
        seen = space["observations"] if isinstance(space, gymnasium.spaces.Dict) else space
        self.discrete = isinstance(actions, gymnasium.spaces.Discrete)
        outputs = int(actions.n if self.discrete else actions.shape[0])
        self.policy = _network([seen.shape[0], 64, 64, outputs], 0.01)
        self.value = _network([seen.shape[0], 64, 64, 1], 1.0)
        self.log_std = None if self.discrete else nn.Parameter(torch.zeros(outputs))

    def _forward(self, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        seen = batch[Columns.OBS]
        if not self.discrete:
            mean = self.policy(seen)
            return {Columns.ACTION_DIST_INPUTS: torch.cat([mean, self.log_std.expand_as(mean)], dim=-1)}
        logits = self.policy(seen["observations"])
        return {Columns.ACTION_DIST_INPUTS: torch.where(seen["action_mask"] != 0, logits, _NEVER)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        """[B] expected returns."""
        seen = batch[Columns.OBS]
        return self.value(seen["observations"] if self.discrete else seen).squeeze(-1)

    def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
        """Play as a policy of chemlab's, deterministically."""
        with torch.no_grad():
            found = self.policy(torch.as_tensor(observation))
            if self.discrete:
                return torch.where(torch.as_tensor(mask) != 0, found, _NEVER).argmax(dim=-1).numpy()
            return found.numpy().clip(0.0, 1.0)


class _PerRoleAdvantages(GeneralAdvantageEstimation):
    """RLlib's advantages with a discount for each role; RLlib has one for all."""

    def __init__(self, gammas: dict[str, float], lambda_: float) -> None:
        super().__init__(gamma=1.0, lambda_=lambda_)
        self._gammas = gammas

    def __call__(self, *, batch: dict[str, Any], **kwargs: Any) -> dict[str, Any]:
        for role in list(batch):
            self.gamma = self._gammas[role]
            batch.update(super().__call__(batch={role: batch[role]}, **kwargs))
        return batch


class PerRolePPOLearner(PPOTorchLearner):
    """RLlib's PPO with the discount of each module's own settings."""

    def build(self) -> None:
        """Put the advantages in place."""
        super().build()
        gammas = {role: self.config.get_config_for_module(role).gamma for role in self.module.keys()}  # noqa: SIM118
        pieces = self._learner_connector.connectors
        (place,) = (i for i, piece in enumerate(pieces) if isinstance(piece, GeneralAdvantageEstimation))
        pieces[place] = _PerRoleAdvantages(gammas, self.config.lambda_)


def _policy_of(agent: str, *_: Any, **__: Any) -> str:
    return role_of(agent)


def algorithm_config(
    scenario: Any,
    roles: Sequence[str],
    background: str = "scripted",
    seed: int = 0,
    runners: int = 1,
    envs: int = 8,
    gamma: float = 0.99,
    manager_gamma: float = 1.0,
    learning_rate: float = 3e-4,
    gae_lambda: float = 0.95,
    ent_coef: float = 0.01,
    epochs: int = 10,
    batch: int = 4096,
    minibatch: int = 256,
) -> PPOConfig:
    """RLlib's settings for roles of a laboratory that learn over background policies; ``.build_algo()`` uses them.

    ``batch`` is the number of turns gathered by all ``runners`` together before each update.
    """
    settings = {"scenario": scenario, "roles": list(roles), "background": background}
    env = LaboratoryMultiAgentEnv(settings)
    specs, overrides = {}, {}
    for role in roles:
        agent = next(agent for agent in env.possible_agents if role_of(agent) == role)
        space, actions = env.observation_spaces[agent], env.action_spaces[agent]
        specs[role] = RLModuleSpec(module_class=RoleModule, observation_space=space, action_space=actions)
        discrete = isinstance(actions, gymnasium.spaces.Discrete)
        overrides[role] = PPOConfig.overrides(
            gamma=manager_gamma if role == MANAGER_ROLE else gamma, entropy_coeff=ent_coef if discrete else 0.0
        )
    return (
        PPOConfig()
        # Continuous actions are drawn where they are played, and clipped; RLlib's check plays without masks.
        .environment(
            LaboratoryMultiAgentEnv,
            env_config=settings,
            normalize_actions=False,
            clip_actions=True,
            disable_env_checking=True,
        )
        .env_runners(num_env_runners=runners, num_envs_per_env_runner=envs, sample_timeout_s=600.0)
        .fault_tolerance(restart_failed_env_runners=True, delay_between_env_runner_restarts_s=1.0)
        .multi_agent(policies=set(roles), policy_mapping_fn=_policy_of)
        .rl_module(
            rl_module_spec=MultiRLModuleSpec(rl_module_specs=specs), algorithm_config_overrides_per_module=overrides
        )
        .learners(learner_class=PerRolePPOLearner, num_learners=0)
        .training(
            lr=learning_rate,
            lambda_=gae_lambda,
            clip_param=0.2,
            train_batch_size_per_learner=batch,
            minibatch_size=minibatch,
            num_epochs=epochs,
            use_kl_loss=False,
            vf_loss_coeff=0.5,
            vf_clip_param=float("inf"),
            grad_clip=0.5,
            grad_clip_by="global_norm",
        )
        .debugging(seed=seed, log_level="ERROR")
    )


def modules(algorithm: Algorithm, roles: Sequence[str]) -> dict[str, RoleModule]:
    """The networks of each role, as they are now; each plays as a policy of chemlab's."""
    weights, found = algorithm.learner_group.get_weights(), {}
    for role in roles:
        module = algorithm.config.rl_module_spec.rl_module_specs[role].build()
        module.set_state(weights[role])
        found[role] = module
    return found


def manager(budget: Budget) -> Outcome:
    """Train the manager with RLlib, and score it."""
    runners = int(os.environ.get("CHEMLAB_RUNNERS", "1"))
    with connected(os.environ.get("RAY_ADDRESS"), runners):
        config = algorithm_config(
            TARGET.scenario,
            [MANAGER_ROLE],
            seed=budget.seed,
            runners=runners,
            batch=BATCH,
            minibatch=MINIBATCH,
            **SETTINGS,
        )
        algorithm, steps = config.build_algo(), 0
        while steps < budget.steps:
            steps += int(algorithm.train()[ENV_RUNNER_RESULTS].get(NUM_ENV_STEPS_SAMPLED, 0))
        learned = modules(algorithm, [MANAGER_ROLE])[MANAGER_ROLE]
        algorithm.stop()
        shutil.rmtree(algorithm.logdir, ignore_errors=True)  # RLlib makes one in the home folder; it is empty
    labs = Laboratories(TARGET.scenario, budget.episodes)
    policies = {**make_policies("scripted", labs), labs.manager.name: learned}
    return Outcome.of(play_laboratory(labs, policies, GOAL, AUDIT_SEED), steps)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """One seed of RLlib's manager, of the same trained by ``chemlab train``, and the scripted one."""
    size = {"envs": 8, "rollout": BATCH // 8, "batch_size": MINIBATCH, "gamma": 1.0}
    plain = MaskablePPO(
        scenario=TARGET.scenario.name,
        roles=(MANAGER_ROLE,),
        seed=budget.seed,
        steps=budget.steps,
        **SETTINGS,
        **size,
        **ONCE,
    )
    np.random.seed(budget.seed)  # noqa: NPY002 - RLlib draws from the global stream
    return {
        "RLlib": manager(budget),
        PLAIN: score_run(plain, TARGET, GOAL, budget),
        SCRIPTED: Outcome.of(TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the manager of `{TARGET.scenario.name}`, {GOAL}", steps=20_000)
