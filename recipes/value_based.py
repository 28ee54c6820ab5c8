"""Value-based learning of a whole team: every role learns action values (IQL, by BenchMARL).

Independent Q-learning (Tan 1993, "Multi-Agent Reinforcement Learning: Independent vs. Cooperative Agents") by
BenchMARL, on the bundled task: both benches of `wurtz_dodecane_direct` under the scripted manager, with discrete
actions and from scratch; half of each reward is the agent's own and half the laboratory's result. Then the manager
learns as well. For a role with one agent, VDN and QMIX mix the values of that agent alone. The comparison is PPO for
the same benches, with continuous actions where they have them (IPPO). Steps are rounds of a laboratory for Q-learning,
and turns of the learning agents for PPO.

    python recipes/value_based.py --out recipes/results/value_based.json

Needs the extra ``train`` and BenchMARL, which requires an older TorchRL than the extra ``torchrl``.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

import torch
from hierarchical import GOAL, TARGET, learned_together
from recipe_parts import AUDIT_SEED, PLAIN, SCRIPTED, Budget, Outcome, cook
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.agents.torchrl.task import laboratory_task
from chemlab.envs.players import as_policy
from chemlab.lab.engine import Laboratories

REWARDS = "mixed"


def learned_values(budget: Budget, roles: Sequence[str]) -> Any:
    """Train some roles with BenchMARL over scripted others for the budget's rounds; return the experiment."""
    from benchmarl.algorithms import IqlConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it logs buffers between the printed results
    envs, rollout, updates = (4, 16, 2) if budget.toy else (64, 64, 200)
    settings = ExperimentConfig.get_from_yaml()
    settings.off_policy_n_envs_per_worker, settings.off_policy_collected_frames_per_batch = envs, envs * rollout
    settings.off_policy_n_optimizer_steps, settings.off_policy_train_batch_size = updates, 256
    settings.off_policy_memory_size, settings.max_n_frames = 200_000, budget.steps
    settings.lr, settings.gamma, settings.exploration_eps_end = 3e-4, 0.99, 0.02
    settings.evaluation, settings.render, settings.loggers, settings.create_json = False, False, [], False
    with tempfile.TemporaryDirectory() as folder:
        settings.save_folder = folder
        experiment = Experiment(
            task=laboratory_task(TARGET.scenario, rewards=REWARDS, roles=roles),
            algorithm_config=IqlConfig.get_from_yaml(),
            model_config=MlpConfig(num_cells=[128, 128], layer_class=torch.nn.Linear, activation_class=torch.nn.Tanh),
            seed=budget.seed,
            config=settings,
        )
        experiment.run()
    return experiment


def greedy(experiment: Any, group: str) -> Callable[[Any, Any], Any]:
    """Return the greedy policy of a role as a function of observations and masks."""

    def act(observation: Any, mask: Any) -> Any:
        seen = {"observation": torch.as_tensor(observation)[:, None], "action_mask": torch.as_tensor(mask)[:, None] > 0}
        rows = TensorDict({group: TensorDict(seen, [len(observation), 1])}, [len(observation)])
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return experiment.group_policies[group](rows)[group, "action"][:, 0].numpy()

    return act


def scored(budget: Budget, roles: Sequence[str]) -> Outcome:
    """Train and score some roles."""
    experiment = learned_values(budget, roles)
    labs = Laboratories(TARGET.scenario.configured(actions="discrete"), budget.episodes)
    policies = make_policies("scripted", labs)
    for group, agents in experiment.group_map.items():
        policies |= dict.fromkeys(agents, as_policy(greedy(experiment, group)))
    return Outcome.of(play_laboratory(labs, policies, GOAL, AUDIT_SEED), experiment.total_frames)


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed of Q-learning for benches and for every role, and of PPO for benches; score the scripted
    laboratory.
    """
    torch.set_num_threads(1)  # networks this small are slower on several threads
    benches = tuple(TARGET.scenario.benches)
    return {
        "IQL": scored(budget, benches),
        "IQL, manager too": scored(budget, ("manager", *benches)),
        PLAIN: learned_together(budget, benches, budget.steps, rewards=REWARDS),
        SCRIPTED: Outcome.of(TARGET.play("scripted", GOAL, budget.episodes, AUDIT_SEED)),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the laboratory of `{TARGET.scenario.name}`, {GOAL}", steps=200_000)
