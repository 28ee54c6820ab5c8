"""Benchmarks of how costs grow: what they measure is what they say, and what they make of figures; nothing is timed."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "studies" / "speed"))  # they import one another

from chemlab.config.loading import load_scenario
from chemlab.lab.engine import Laboratories
from studies.speed.growth import AXES, Play, isomers, memory, turns


@pytest.mark.parametrize(("materials", "reactions"), [(10, 6), (20, 200), (200, 6)])
def test_a_laboratory_of_isomers_is_as_large_as_asked_for(materials: int, reactions: int) -> None:
    spec = isomers(materials, reactions)
    assert len(spec.family.reaction) == reactions
    assert len({(*step.reactants, *step.products) for step in spec.family.reaction}) == reactions
    assert len([name for name in spec.materials if name.startswith("m")]) == materials
    total = sum(step.pre_exponential for step in spec.family.reaction)
    assert total == pytest.approx(1e5, rel=1e-4), "together they are as fast as ever"


@pytest.mark.slow
def test_memory_is_at_least_what_the_laboratory_holds() -> None:
    """Its shelf and its manager's observation."""
    spec = AXES["laboratories"][1](1)
    labs = Laboratories(spec, 1)
    assert memory(spec) > labs.shelf.vessels[0].nbytes + 4 * labs.observation_sizes[0]


@pytest.mark.parametrize("name", ["crude", "failing"])
def test_episodes_leave_nothing_in_memory(name: str) -> None:
    """After hundreds of episodes more, laboratories hold what they held before."""
    play = Play(load_scenario(name), 32)
    held = []
    tracemalloc.start()
    for count in (6_000, 12_000):
        turns(play, count, 0.0)
        gc.collect()
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[1] - held[0] < 16_384


def test_a_simulated_round_is_the_sum_of_its_parts() -> None:
    pytest.importorskip("ray.rllib")
    from studies.speed.runners import simulate

    found = {"runner_s": [1e-3], "apart_s": 1e-5, "update_s": 2e-5, "turn_bytes": 1000.0, "weights_bytes": 5000}
    one = simulate(found, 8, 100, gigabits=1.0)
    parts = {"playing": 0.1, "sending": (800 * 1000 + 8 * 5000) / 125e6, "taking apart": 8e-3, "updating": 16e-3}
    assert one == pytest.approx({**parts, "turns_a_second": 800 / sum(parts.values())})
    uneven = simulate({**found, "runner_s": [1e-3, 2e-3]}, 64, 100, gigabits=1.0)
    assert uneven["playing"] == pytest.approx(0.2), "of 64 runners there is always a slow one"
