"""Benchmarks of how costs grow: what they measure is what they say, and what they make of figures; nothing is timed."""

import gc
import sys
import tracemalloc
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "studies" / "speed"))  # they import one another

from chemlab.config.loading import load_scenario
from studies.speed.growth import Play, isomers, turns


@pytest.mark.parametrize(("materials", "reactions"), [(10, 6), (20, 200), (200, 6)])
def test_a_laboratory_of_isomers_is_as_large_as_asked_for(materials: int, reactions: int) -> None:
    spec = isomers(materials, reactions)
    assert len(spec.family.reaction) == reactions
    assert len({(*step.reactants, *step.products) for step in spec.family.reaction}) == reactions
    assert len([name for name in spec.materials if name.startswith("m")]) == materials
    total = sum(step.pre_exponential for step in spec.family.reaction)
    assert total == pytest.approx(1e5, rel=1e-4), "together they are as fast as ever"


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
