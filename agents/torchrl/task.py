"""A laboratory as a BenchMARL task, for training every role with MAPPO, IPPO, IQL, VDN, QMIX and others.

>>> from benchmarl.algorithms import MappoConfig
>>> from benchmarl.experiment import Experiment, ExperimentConfig
>>> from benchmarl.models.mlp import MlpConfig
>>> from chemlab.agents.torchrl.task import laboratory_task
>>> Experiment(                                                                    # doctest: +SKIP
...     task=laboratory_task("unlabelled"), algorithm_config=MappoConfig.get_from_yaml(),
...     model_config=MlpConfig.get_from_yaml(), seed=0, config=ExperimentConfig.get_from_yaml(),
... ).run()

All actions are discrete (the manager's always are). Only a centralized critic observes the true state.
BenchMARL does not distinguish steps without a turn; in these the agent has a single legal action, a no-op, which
contributes no gradient.

Needs BenchMARL, which requires an older TorchRL than :mod:`~chemlab.agents.torchrl.env` does:
``pip install torch``, then ``pip install benchmarl .``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario

from .env import TorchLaboratory

try:
    from benchmarl.environments import TaskClass
except ImportError as error:
    raise ImportError(f"a task for BenchMARL needs it ({error}): pip install benchmarl") from error


class ChemlabTask(TaskClass):
    """A laboratory as a BenchMARL task.

    ``config`` has arguments of :class:`~chemlab.agents.torchrl.env.TorchLaboratory`: ``scenario``, ``rewards``,
    ``split``, ``roles``, ``background``, and ``state`` (False: a centralized critic observes the observations of its
    group).
    """

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], TorchLaboratory]:
        """Return a function that makes N laboratories with discrete actions."""
        return lambda: TorchLaboratory(num_envs, actions="discrete", seed=seed, device=device, **self.config)

    def supports_continuous_actions(self) -> bool:
        """Return False: the manager's actions are discrete."""
        return False

    def supports_discrete_actions(self) -> bool:
        """Return True."""
        return True

    def max_steps(self, env: Any) -> int:
        """Return the maximum number of rounds of an episode: manager actions plus ticks."""
        limits = load_scenario(self.config["scenario"]).limits
        return int(limits.manager_actions + limits.ticks)

    def has_render(self, env: Any) -> bool:
        """Return False: batches are not rendered."""
        return False

    def group_map(self, env: Any) -> dict[str, list[str]]:
        """Return the agents by role."""
        return dict(env.group_map)

    def observation_spec(self, env: Any) -> Any:
        """Return the spec of the agents' observations."""
        return self._only(env, "observation")

    def info_spec(self, env: Any) -> Any:
        """Return the spec of the infos."""
        return self._only(env, "info")

    def action_mask_spec(self, env: Any) -> Any:
        """Return the spec of the action masks."""
        return self._only(env, "action_mask")

    def state_spec(self, env: Any) -> Any:
        """Return the spec of the true state, or None."""
        spec = env.full_observation_spec_unbatched.clone()
        for key in list(spec.keys()):
            if key != "state":
                del spec[key]
        return spec if len(list(spec.keys())) else None

    def action_spec(self, env: Any) -> Any:
        """Return the spec of the actions."""
        return env.full_action_spec_unbatched

    @staticmethod
    def env_name() -> str:
        """Return the environment's name in BenchMARL's results."""
        return "chemlab"

    @staticmethod
    def _only(env: Any, entry: str) -> Any:
        """Return one entry of every group."""
        spec = env.full_observation_spec_unbatched.clone()
        for group in list(spec.keys()):
            if group not in env.group_map:
                del spec[group]
                continue
            for key in list(spec[group].keys()):
                if key != entry:
                    del spec[group, key]
        return spec


def laboratory_task(scenario: str | Path | Scenario = "wurtz_dodecane", **config: Any) -> ChemlabTask:
    """Make a BenchMARL task of a scenario.

    Args:
        scenario: a shipped name, a path to a TOML file, or a loaded scenario.
        config: more arguments of :class:`~chemlab.agents.torchrl.env.TorchLaboratory`.

    Raises:
        DataError: the scenario is invalid or unknown.
    """
    spec = load_scenario(scenario)
    return ChemlabTask(spec.name, {"scenario": spec, **config})
