"""What recipes share: their arguments, plain PPO, who scored what, and the file where that is kept."""

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

from chemlab.agents.evaluate.jobs import AUDIT_SEED
from chemlab.agents.evaluate.play import BenchTarget, LaboratoryTarget
from chemlab.agents.player import Played, play_bench
from chemlab.agents.policies import bench_policy
from chemlab.agents.runs import Run, versions
from chemlab.config.files import check_target, write_text
from chemlab.envs.players import as_policy

__all__ = [
    "AUDIT_SEED",
    "ONCE",
    "PLAIN",
    "SCRIPTED",
    "Budget",
    "Outcome",
    "cook",
    "learned",
    "learner",
    "score",
    "score_run",
    "training_envs",
]

PLAIN = "plain PPO"
SCRIPTED = "scripted"
_ENVS, _ROLLOUT = 16, 64
ONCE = {"evaluations": 1, "checkpoints": 1, "eval_episodes": 2, "final_episodes": 2}
"""What runs of ``chemlab train`` and ``train-together`` are told where recipes score them."""


class Budget(NamedTuple):
    """What a recipe may take for one seed.

    Attributes:
        seed: of networks, exploration and training environments.
        steps: environment steps, of the recipe and of whoever it is compared with.
        episodes: played to score each of them, the same for all.
        toy: whether to leave out everything that takes more than seconds.
    """

    seed: int
    steps: int
    episodes: int
    toy: bool


class Outcome(NamedTuple):
    """What somebody came to: mean return of an episode, mean cost (weighted safety events), environment steps taken."""

    mean: float
    cost: float
    steps: int

    @classmethod
    def of(cls, played: Played, steps: int = 0) -> Outcome:
        """The means of some episodes."""
        return cls(float(played.returns.mean()), float(played.cost.mean()), steps)


Recipe = Callable[[Budget], Mapping[str, Outcome]]


def cook(recipe: Recipe, page: str | None, environment: str, steps: int, episodes: int = 100) -> dict[str, Any]:
    """Run a recipe as a command: for every seed, then print, and perhaps keep, what everybody came to.

    Args:
        recipe: one seed of it: {who: what they came to}; the first is the paradigm's, beside :data:`PLAIN` or
            :data:`SCRIPTED`, or both.
        page: the module's documentation, whose first line says what paradigm it is.
        environment: where it is played.
        steps: default of ``--steps``.
        episodes: default of ``--episodes``.

    Returns:
        What is printed: of everybody the mean over seeds, and each seed's.

    Raises:
        SystemExit: the arguments are none.
    """
    parser = argparse.ArgumentParser(description=page, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--toy", action="store_true", help="seconds instead of minutes; the numbers mean nothing")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--seeds", type=int, default=1, help="how many, one after the other")
    parser.add_argument("--steps", type=int, default=steps, help="environment steps for each seed and learner")
    parser.add_argument("--episodes", type=int, default=episodes, help="episodes that score each of them")
    parser.add_argument("--out", type=Path, help="a JSON file to keep the numbers in")
    given = parser.parse_args()
    if min(given.seeds, given.steps, given.episodes) < 1 or given.seed < 0:
        parser.error("--seeds, --steps and --episodes must be at least 1, --seed at least 0")
    if given.out is not None:
        check_target(given.out)
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
        write_text(given.out, json.dumps(result, indent=1) + "\n")
    return result


def _summary(outcomes: list[Outcome]) -> dict[str, Any]:
    return {
        "mean": round(float(np.mean([one.mean for one in outcomes])), 4),
        "cost": round(float(np.mean([one.cost for one in outcomes])), 4),
        "steps": int(np.mean([one.steps for one in outcomes])),
        "by_seed": [round(one.mean, 4) for one in outcomes],
    }


def score(policy: Any, target: BenchTarget, goal: str, budget: Budget) -> Outcome:
    """What a policy, or the one of that name, comes to in episodes that nobody trains on, the same for everybody."""
    env = target.environment(budget.episodes)
    player = bench_policy(policy, env.bench, AUDIT_SEED) if isinstance(policy, str) else as_policy(policy)
    return Outcome.of(play_bench(env, player, goal, AUDIT_SEED), getattr(policy, "num_timesteps", 0))


def score_run(
    train: Callable[..., Any], arguments: Any, target: LaboratoryTarget, goal: str, budget: Budget
) -> Outcome:
    """What a run of ``chemlab train`` or ``train-together`` comes to with its last checkpoint, which is not kept.

    Args:
        train: the function behind the command.
        arguments: what it is told.
        target: the laboratory, in episodes that nobody trains on.
        goal: of these.
        budget: how many they are.
    """
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        train(arguments, run)
        played = target.play(str(Run(run).checkpoint("last")), goal, budget.episodes, AUDIT_SEED)
    return Outcome.of(played, arguments.steps)


def training_envs(target: BenchTarget, goal: str) -> Any:
    """The bench as Stable-Baselines3 wants it, in worlds of the split ``train``, all experiments for one goal."""
    from chemlab.agents.sb3 import ChemlabVecEnv

    return ChemlabVecEnv(_ENVS, scenario=target.scenario, bench=target.bench, goals=goal, starts=target.starts)


def learner(algorithm: str, envs: Any, budget: Budget, **settings: Any) -> Any:
    """A learner of ``chemlab train --algo`` that has learned nothing yet.

    Args:
        algorithm: its name there.
        envs: :func:`training_envs`.
        budget: of it, the seed.
        settings: of the learner, where they are not Stable-Baselines3's own.
    """
    import torch

    from chemlab.agents.learners import LEARNERS

    torch.set_num_threads(1)  # networks this small are slower on several
    network = "MlpLstmPolicy" if algorithm.startswith("recurrent") else "MlpPolicy"
    if isinstance(envs.observation_space, gymnasium.spaces.Dict):
        network = "MultiInputPolicy"
    if algorithm.endswith("ppo"):
        settings = {"n_steps": _ROLLOUT, **settings}
    return LEARNERS[algorithm](network, envs, seed=budget.seed, device="cpu", **settings)


def learned(algorithm: str, envs: Any, budget: Budget, callback: Any = None, **settings: Any) -> Any:
    """The same when it has taken the budget's steps.

    Args:
        algorithm, envs, budget, settings: see :func:`learner`.
        callback: Stable-Baselines3's.
    """
    return learner(algorithm, envs, budget, **settings).learn(budget.steps, callback=callback)
