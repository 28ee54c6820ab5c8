"""TorchRL's ``PettingZooWrapper`` around the laboratory, AEC and parallel: specs, masks, rollouts, a training step."""

from typing import Any

import pytest
from helpers import FEATURED

pytest.importorskip("torchrl", reason="TorchRL is not installed: pip install torch==2.13.0 torchrl")

import torch
from tensordict import TensorDictBase
from torchrl.envs.libs.gym import GymEnv
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.envs.utils import check_env_specs

from chemlab.laboratory import env as laboratory_env
from chemlab.laboratory import parallel_env

FACTORIES = {"aec": laboratory_env, "parallel": parallel_env}

pytestmark = pytest.mark.filterwarnings(
    "ignore:PettingZoo in TorchRL is tested using version", "ignore::DeprecationWarning", "ignore::FutureWarning"
)


def wrapped(api: str, name: str = "wurtz_dodecane", **arguments: Any) -> PettingZooWrapper:
    """A laboratory in TorchRL's wrapper."""
    return PettingZooWrapper(env=FACTORIES[api](name), use_mask=True, **arguments)


def played(api: str, rollout: TensorDictBase, env: PettingZooWrapper) -> dict[str, int]:
    """How many actions each group has played; each must have been allowed by its mask, and none been lost."""
    counts = {}
    for group in env.group_map:
        taken = rollout[group]
        # In AEC "mask" says who acts; in the parallel API everybody is present and "has_turn" does.
        acting = taken["mask"] if api == "aec" else taken["info", "has_turn"].bool()
        counts[group] = int(acting.sum())
        if env.has_action_mask[group]:
            allowed = taken["action_mask"].gather(-1, taken["action"].unsqueeze(-1)).squeeze(-1)
            assert allowed[acting].all()
            assert not rollout["next", group, "info", "illegal_action"][acting].any()
    return counts


@pytest.mark.parametrize("api", FACTORIES)
@pytest.mark.parametrize("name", FEATURED)
def test_specs(name: str, api: str) -> None:
    env = wrapped(api, name, return_state=True)
    env.set_seed(0)
    check_env_specs(env)
    groups = {agent: group for group, agents in env.group_map.items() for agent in agents}
    assert list(groups) == env.possible_agents
    for agent, group in groups.items():
        # AEC: a group an agent; parallel: a group a role, whose agents share their spaces.
        assert group == (agent if api == "aec" else agent.rpartition("_")[0])
        assert env.has_action_mask[group] == hasattr(env.action_space(agent), "n")
        assert env.observation_spec[group, "observation"].shape[1:] == env.observation_space(agent).shape


@pytest.mark.parametrize("api", FACTORIES)
@pytest.mark.parametrize("name", ["relay", "wurtz_two_lines"])
def test_rollouts_play_legal_actions_only(name: str, api: str) -> None:
    env = wrapped(api, name)
    env.set_seed(1)
    torch.manual_seed(0)  # in one of 60 rollouts, two benches take the last of a bottle in the same round
    counts = played(api, env.rollout(150, break_when_any_done=False), env)
    # `submit` is one of many legal actions, so random episodes are short: benches are not always reached.
    assert counts[next(iter(env.group_map))] > 10
    assert sum(counts.values()) > 30


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("chemlab/LabManager-v1", {}), ("chemlab/LabAgent-v1", {"agent": "rxn_0"}), ("chemlab/WurtzExtraction-v0", {})],
)
def test_the_default_reader_takes_infos_of_single_views(name: str, arguments: dict[str, Any]) -> None:
    env = GymEnv(name, **arguments).auto_register_info_dict()
    env.set_seed(0)
    rollout = env.rollout(5)["next"]
    assert rollout["cost"].dtype == rollout["score"].dtype == torch.float64
    assert rollout["experiment_over"].dtype == rollout["illegal_action"].dtype == torch.bool
    assert len(rollout["cost"]) == len(rollout["reward"])
