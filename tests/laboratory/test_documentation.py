"""What docstrings and comments say of spaces agrees with the spaces themselves."""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import deepcopy
from pickle import dumps, loads
from typing import Any

import gymnasium
import numpy as np
import pytest

from chemlab.agents.policies import make_policies
from chemlab.envs import role_env
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.roles import (
    crystallization_bench as crystallization,
)
from chemlab.roles import (
    distillation_bench as distillation,
)
from chemlab.roles import (
    extraction_bench as extraction,
)
from chemlab.roles import (
    reaction_bench as reaction,
)

ROW = re.compile(r"^\| `(chemlab/[\w-]+)` \| (\w+) of `(\w+)` \| Box\((\d+)\) \| (Box|Discrete)\((\d+)\) \|", re.M)
ROWS = ROW.findall(role_env.__doc__ or "")


def test_the_table_lists_every_registered_bench() -> None:
    """Nothing registered is missing from the module's table."""
    benches = [name for name, spec in gymnasium.registry.items() if str(spec.entry_point).endswith(":RoleEnv")]
    registered = set(benches) - {"chemlab/Bench-v1"}
    assert {row[0] for row in ROWS} == registered


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_the_table_tells_the_true_spaces(row: tuple[str, ...]) -> None:
    """Observation and action sizes of the documentation are those of the environment."""
    name, bench, scenario, observations, kind, actions = row
    env: Any = gymnasium.make(name).unwrapped
    assert env.observation_space.shape == (int(observations),)
    space = env.action_space
    assert type(space).__name__ == kind
    assert (space.n if kind == "Discrete" else space.shape[0]) == int(actions)
    assert (env.bench.key, env.bench.scenario.name) == (bench, scenario)


def test_bench_modules_tell_the_parts() -> None:
    """The parts that the benches' own tables name are the declared channels, in order and size."""
    names = {
        key: [c.name for c in ExperimentBatch("wurtz_dodecane", key).bench.channels] for key in ("rxn", "ext", "dit")
    }
    assert names["rxn"] == ["spectrum", "temperature", "volume", "pressure", "reagents", "goal"]
    assert names["ext"] == ["layers_EV", "layers_B1", "layers_B2", "goal"]
    assert names["dit"] == ["layers_DV", "layers_B1", "layers_B2", "temperature", "volume", "pressure", "goal"]
    assert "spectrum 200, temperature, volume, pressure, n reagents left, goal" in (reaction.__doc__ or "")
    assert "Discrete(41): 8 processes x 5 magnitudes, end" in (extraction.__doc__ or "")
    assert "Discrete(35): 11 processes, end" in (crystallization.__doc__ or "")
    assert "Discrete(31): 3 processes x 10 magnitudes, end" in (distillation.__doc__ or "")


@pytest.mark.parametrize("how", [deepcopy, lambda labs: loads(dumps(labs))], ids=["copy", "pickle"])
def test_copies_of_laboratories_go_on_alike(how: Callable[[Laboratories], Laboratories]) -> None:
    """A copy taken in the middle of an episode plays on as the original does, with arrays of its own."""
    labs = Laboratories("wurtz_dodecane", 3)
    for m in labs.members:
        labs.seed(int(m), int(m))
    labs.reset(labs.members)

    def play(one: Laboratories, turns: int) -> list[float]:
        policies = make_policies("random", one, seed=1)
        seen = []
        for _ in range(turns):
            for m in range(3):
                member = np.array([m])
                if one.state.status[m]:
                    one.reset(member)
                agent = one.turn(m)
                observation, mask = one.observe(agent, member), one.mask(agent, member)
                one.act(agent, member, policies[one.agents[agent]].act(observation, mask, np.array([1]), member))
                seen += [float(observation.sum()), float(one.rewards[m].sum())]
        return seen

    play(labs, 60)
    twin = how(labs)
    kept = [array.copy() for array in twin.snapshot()]
    expected = play(labs, 60)
    for array, before in zip(twin.snapshot(), kept, strict=True):
        np.testing.assert_array_equal(array, before)
    assert play(twin, 60) == expected
    assert len(set(expected)) > 50
