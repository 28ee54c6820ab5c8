"""Learning from demonstrations: a clone of recorded play, which learns on.

Episodes of the scripted laboratory of `wurtz_dodecane` are recorded and exported as a Minari dataset of the manager's
observations, actions and rewards, as ``chemlab export demos`` does for any record. A learner is fitted to the actions
and their returns (behaviour cloning from the dataset alone, without queries) and continues as PPO with masks. The
comparison has the clone itself, whose steps are those of the dataset, and the same learner from scratch. The benches
are scripted in all of them.

    python recipes/demonstrations.py --steps 20000 --out recipes/results/demonstrations.json

Needs the extras ``train`` and ``data`` (Minari).
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import minari
import numpy as np
import numpy.typing as npt
from recipe_parts import AUDIT_SEED, PLAIN, SCRIPTED, Budget, Outcome, cook, learner
from scipy.signal import lfilter

from chemlab import raw_env
from chemlab.agents.background import role_vector_env
from chemlab.agents.demonstrations import write_datasets
from chemlab.agents.episodes import play_laboratory, record_episode
from chemlab.agents.policies import make_policies
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.agents.train.imitate import fit
from chemlab.config.scenario import MANAGER_AGENT
from chemlab.envs.players import as_policy
from chemlab.lab.engine import Laboratories

SCENARIO, GOAL = "wurtz_dodecane", "dodecane"
DEMONSTRATED = 20
"""Number of recorded episodes."""


def dataset(folder: Path, episodes: int, seed: int) -> Any:
    """Record episodes and return the manager's Minari dataset; all files stay in the folder."""
    env = raw_env(SCENARIO)
    labs = env.laboratories
    records = [folder / f"{seed + i}.jsonl" for i in range(episodes)]
    for i, path in enumerate(records):
        record_episode(path, env, make_policies("scripted", labs), seed + i, "scripted")
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    (written,) = write_datasets(records, "recipe/scripted", [MANAGER_AGENT])
    return minari.load_dataset(written.id)


def examples(demonstrated: Any, gamma: float) -> tuple[npt.NDArray[Any], ...]:
    """Return (observations, masks, actions, discounted returns) of the T turns of a dataset."""
    episodes = list(demonstrated.iterate_episodes())
    seen = np.concatenate([episode.observations[:-1] for episode in episodes])
    masks = np.concatenate([episode.infos["action_mask"][:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    returns = [lfilter([1.0], [1.0, -gamma], episode.rewards[::-1])[::-1] for episode in episodes]
    return seen, masks, actions, np.concatenate(returns).astype(np.float32)


def begun(budget: Budget) -> Any:
    """Return an untrained learner for the manager."""
    envs = ChemlabVecEnv(role_vector_env(64, SCENARIO, autoreset_mode="SameStep"))
    return learner("maskable-ppo", envs, budget, n_steps=16, batch_size=256)


def played(budget: Budget, manager: Any = None) -> Outcome:
    """Score a manager, or the scripted one, over scripted benches."""
    labs = Laboratories(SCENARIO, budget.episodes)
    policies = make_policies("scripted", labs)
    if manager is not None:
        policies[MANAGER_AGENT] = as_policy(manager)
    return Outcome.of(play_laboratory(labs, policies, GOAL, AUDIT_SEED), getattr(manager, "num_timesteps", 0))


def recipe(budget: Budget) -> dict[str, Outcome]:
    """Train one seed: the clone before and after PPO, and PPO from scratch; score the scripted manager."""
    model = begun(budget)
    with tempfile.TemporaryDirectory() as folder:
        demonstrated = dataset(Path(folder), 2 if budget.toy else DEMONSTRATED, 1000 * budget.seed)
        fit(model, *examples(demonstrated, model.gamma), seed=budget.seed)
        cloned = played(budget, model)._replace(steps=int(demonstrated.total_steps))
    return {
        "clone, then PPO": played(budget, model.learn(budget.steps)),
        "clone": cloned,
        PLAIN: played(budget, begun(budget).learn(budget.steps)),
        SCRIPTED: played(budget),
    }


if __name__ == "__main__":
    cook(recipe, __doc__, f"the manager of `{SCENARIO}`, {GOAL}", steps=50_000)
