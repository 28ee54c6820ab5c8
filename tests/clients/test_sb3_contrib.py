"""Stable-Baselines3 and sb3-contrib on views of the laboratory and on single benches made by ``gymnasium.make``.

The batched benches have their own tests, with the adapter's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason='Stable-Baselines3 is not installed: pip install ".[train]"')
pytest.importorskip("sb3_contrib", reason='sb3-contrib is not installed: pip install ".[train]"')

from helpers import watched, weights
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy as evaluate_masked
from sb3_contrib.common.maskable.utils import is_masking_supported
from stable_baselines3.common.env_util import make_vec_env

import chemlab  # noqa: F401 - registers the environments
from chemlab.agents.background import role_vector_env
from chemlab.agents.sb3 import ChemlabVecEnv
from chemlab.config.loading import load_scenario

SMALL: dict[str, Any] = {"n_steps": 16, "batch_size": 32, "n_epochs": 1, "seed": 0, "device": "cpu"}


def learned(model: Any, steps: int) -> dict[str, Any]:
    """Train the model a little; its parameters must have moved, finitely."""
    before = weights(model)
    found, after = watched(model, steps), weights(model)
    assert np.isfinite(after).all()
    assert not np.array_equal(before, after)
    assert found["steps"] >= steps
    return found


def manager_batch(members: int, name: str = "wurtz_dodecane") -> ChemlabVecEnv:
    """The manager's view of a batch of laboratories, for SB3."""
    return ChemlabVecEnv(role_vector_env(members, name, autoreset_mode="SameStep"))


# -- the manager ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["wurtz_dodecane", "wurtz_two_lines"])
def test_masked_ppo_manages_a_batch_of_laboratories(name: str) -> None:
    venv = manager_batch(8, name)
    assert is_masking_supported(venv)
    model = MaskablePPO("MlpPolicy", venv, **SMALL)
    watch = learned(model, 256)
    assert watch["illegal"] == 0
    assert watch["ends"] > 0
    assert max(watch["ticks"]) > 1, "the benches' experiments are single steps of the manager"
    rewards, lengths = evaluate_masked(model, manager_batch(2, name), n_eval_episodes=4, return_episode_rewards=True)
    limit = load_scenario(name).limits.manager_actions
    assert len(rewards) == len(lengths) == 4  # type: ignore[arg-type]
    assert max(lengths) <= limit  # type: ignore[arg-type, type-var]
    assert np.isfinite(rewards).all()


def test_single_and_batched_views_train_alike() -> None:
    """The same seeds, the same episodes: PPO ends with the same weights whichever environment it ran on."""

    def trained(venv: Any) -> Any:
        model = MaskablePPO("MlpPolicy", venv, **SMALL)
        model.learn(64)
        return weights(model)

    batch = trained(manager_batch(2))
    single = trained(make_vec_env("chemlab/LabManager-v1", 2))
    np.testing.assert_allclose(batch, single, rtol=1e-4, atol=1e-6)
