"""Common parts of recipes: arguments, plain PPO, scoring, and the file of results."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from chemlab.agents.episodes import Played, play_bench
from chemlab.agents.evaluate.jobs import AUDIT_SEED
from chemlab.agents.evaluate.play import Target
from chemlab.agents.policies import bench_policy
from chemlab.agents.runs import Run, versions
from chemlab.config.files import check_target, write_json
from chemlab.envs.players import as_policy

PLAIN = "plain PPO"
SCRIPTED = "scripted"
_ENVS, _ROLLOUT = 16, 64
ONCE = {"evaluations": 1, "checkpoints": 1, "eval_episodes": 2, "final_episodes": 2}
"""Arguments of runs of ``chemlab train`` that recipes score."""


class Budget(NamedTuple):
    """Resources of a recipe for one seed.

    Attributes:
        seed: seed of networks, exploration and training environments.
        steps: environment steps of the recipe and of each learner it is compared with.
        episodes: evaluation episodes, the same for all.
        toy: whether to skip everything that takes more than seconds.
    """

    seed: int
    steps: int
    episodes: int
    toy: bool


class Outcome(NamedTuple):
    """Result of a policy: mean return per episode, mean cost (weighted safety events), environment steps taken."""

    mean: float
    cost: float
    steps: int

    @classmethod
    def of(cls, played: Played, steps: int = 0) -> Outcome:
        """Return the means of some episodes."""
        return cls(float(played.returns.mean()), float(played.cost.mean()), steps)


Recipe = Callable[[Budget], Mapping[str, Outcome]]


def cook(recipe: Recipe, page: str | None, environment: str, steps: int, episodes: int = 100) -> dict[str, Any]:
    """Run a recipe as a command for every seed; print the results and optionally store them.

    Args:
        recipe: runs one seed and returns {name: result}; the first is the paradigm's, the others include :data:`PLAIN`
            or :data:`SCRIPTED`, or both.
        page: the module's docstring, whose first line names the paradigm.
        environment: description of the environment.
        steps: default of ``--steps``.
        episodes: default of ``--episodes``.

    Returns:
        The printed data: the mean over seeds of each result, and each seed's.

    Raises:
        SystemExit: the arguments are invalid.
    """
    parser = argparse.ArgumentParser(description=page, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--toy", action="store_true", help="a run of seconds; its numbers are not meaningful")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds, run one after the other")
    parser.add_argument("--steps", type=int, default=steps, help="environment steps for each seed and learner")
    parser.add_argument("--episodes", type=int, default=episodes, help="evaluation episodes of each")
    parser.add_argument("--out", type=Path, help="JSON file for the results")
    given = parser.parse_args()
    if min(given.seeds, given.steps, given.episodes) < 1 or given.seed < 0:
        parser.error("--seeds, --steps and --episodes must be at least 1, --seed at least 0")
    if given.out is not None:
        check_target(given.out, force=True)
    budget = Budget(given.seed, given.steps, given.episodes, given.toy)
    if given.toy:
        budget = budget._replace(steps=min(given.steps, _ENVS * _ROLLOUT), episodes=min(given.episodes, 2))
    found = [recipe(budget._replace(seed=given.seed + i)) for i in range(given.seeds)]
    result = {
        "kind": "recipe",
        "paradigm": (page or "").partition("\n")[0].rstrip("."),
        "environment": environment,
        "command": shlex.join(["python", f"recipes/{Path(sys.argv[0]).name}", *sys.argv[1:]]),
        "toy": given.toy,
        "seeds": given.seeds,
        "episodes": budget.episodes,
        "versions": versions(),
        "outcomes": {who: _summary([one[who] for one in found]) for who in found[0]},
    }
    print(json.dumps(result, indent=1))
    if given.out is not None:
        write_json(given.out, result)
    return result


def _summary(outcomes: list[Outcome]) -> dict[str, Any]:
    return {
        "mean": round(float(np.mean([one.mean for one in outcomes])), 4),
        "cost": round(float(np.mean([one.cost for one in outcomes])), 4),
        "steps": int(np.mean([one.steps for one in outcomes])),
        "by_seed": [round(one.mean, 4) for one in outcomes],
    }


def score(policy: Any, target: Target, goal: str, budget: Budget) -> Outcome:
    """Score a policy, given or named, on the evaluation episodes, which are not used in training."""
    env = target.environment(budget.episodes)
    player = bench_policy(policy, env.bench, AUDIT_SEED) if isinstance(policy, str) else as_policy(policy)
    return Outcome.of(play_bench(env, player, goal, AUDIT_SEED), getattr(policy, "num_timesteps", 0))


def score_run(arguments: Any, target: Target, goal: str, budget: Budget) -> Outcome:
    """Train with ``chemlab train`` and score the last checkpoint, which is not kept.

    Args:
        arguments: arguments of the run.
        target: the laboratory of the evaluation episodes.
        goal: goal of these episodes.
        budget: resources.
    """
    from chemlab.agents.train.learn import train

    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(arguments, run)
        played = target.play(str(Run(run).checkpoint("last")), goal, budget.episodes, AUDIT_SEED)
    return Outcome.of(played, arguments.steps)


def training_envs(target: Target, goal: str) -> Any:
    """Return the bench as a vector environment of Stable-Baselines3, with worlds of the split ``train`` and one
    goal.
    """
    from chemlab.agents.sb3 import ChemlabVecEnv

    return ChemlabVecEnv(_ENVS, scenario=target.scenario, bench=target.bench, goals=goal, starts=target.starts)


def learner(algorithm: str, envs: Any, budget: Budget, **settings: Any) -> Any:
    """Return an untrained learner of ``chemlab train --algo``.

    Args:
        algorithm: its name there.
        envs: environments of :func:`training_envs`.
        budget: resources, of which the seed is used.
        settings: settings that differ from Stable-Baselines3's defaults.
    """
    import torch

    from chemlab.agents.learners import LEARNERS

    torch.set_num_threads(1)  # networks this small are slower on several threads
    network = "MlpLstmPolicy" if algorithm.startswith("recurrent") else "MlpPolicy"
    if isinstance(envs.observation_space, gymnasium.spaces.Dict):
        network = "MultiInputPolicy"
    if algorithm.endswith("ppo"):
        settings = {"n_steps": _ROLLOUT, **settings}
    return LEARNERS[algorithm](network, envs, seed=budget.seed, device="cpu", **settings)


def learned(algorithm: str, envs: Any, budget: Budget, callback: Any = None, **settings: Any) -> Any:
    """Return a learner trained for the budget's steps.

    Args:
        algorithm, envs, budget, settings: see :func:`learner`.
        callback: callback of Stable-Baselines3.
    """
    return learner(algorithm, envs, budget, **settings).learn(budget.steps, callback=callback)
