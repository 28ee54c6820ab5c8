"""Kinds of benches, and construction of a scenario's benches."""

from __future__ import annotations

from ..config.parts import load_part
from ..config.scenario import Scenario
from ..physics.chemistry import ChemistryTable
from .bench import Bench
from .discrete import Discretised, discretised

BENCH_KINDS: dict[str, str] = {
    "reaction": "chemlab.roles.reaction_bench:ReactionBench",
    "extraction": "chemlab.roles.separation_benches:ExtractionBench",
    "distillation": "chemlab.roles.separation_benches:DistillationBench",
    "crystallization": "chemlab.roles.separation_benches:CrystallizationBench",
}
"""Built-in kinds of benches by short name."""


def build_bench(key: str, scenario: Scenario, chemistry: ChemistryTable) -> Bench:
    """Build the bench ``key`` of a scenario.

    Raises:
        DataError: the bench kind cannot be found, or its options are invalid.
    """
    cls = load_part(scenario.benches[key].kind, scenario, f"benches.{key}.kind", BENCH_KINDS, Bench)
    bench: Bench = cls(key, scenario, chemistry)
    if bench.spec.actions == "discrete" and not bench.action_count:
        bench = discretised(cls)(key, scenario, chemistry)
    return bench


def discretised_twin(bench: Bench) -> Discretised | None:
    """Return the same bench with discrete actions; None if its actions are discrete already."""
    if bench.action_count:
        return None
    scenario = bench.scenario.configured(actions="discrete")
    twin = build_bench(bench.key, scenario, bench.chemistry)
    return twin if isinstance(twin, Discretised) else None
