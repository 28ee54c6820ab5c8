"""What docstrings and comments say of spaces agrees with the spaces themselves."""

from __future__ import annotations

import re
from typing import Any

import gymnasium
import pytest

from chemlab.envs import role_env
from chemlab.lab.experiments import ExperimentBatch
from chemlab.roles import reaction_bench as reaction
from chemlab.roles import separation_benches

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
    assert "Discrete(41): 8 processes x 5 magnitudes, end" in (separation_benches.__doc__ or "")
    assert "Discrete(35): 11 processes, end" in (separation_benches.__doc__ or "")
    assert "Discrete(31): 3 processes x 10 magnitudes, end" in (separation_benches.__doc__ or "")
