"""Kinds of benches, and construction of a scenario's benches."""

from __future__ import annotations

from ..config.datafile import DataError
from ..config.parts import PartError, blamed, load_part
from ..config.scenario import Scenario
from ..physics.chemistry import ChemistryTable
from .bench import Bench, is_bundled
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
        PartError: a bench of the user's own cannot be made, or is not complete.
    """
    kind = scenario.benches[key].kind
    cls = load_part(kind, scenario, f"benches.{key}.kind", BENCH_KINDS, Bench)
    if is_bundled(cls):
        bench: Bench = cls(key, scenario, chemistry)
    else:
        bench = _own_bench(cls, key, scenario, chemistry)
    if bench.spec.actions == "discrete" and not bench.action_count:
        bench = discretised(cls)(key, scenario, chemistry)
    return bench


def _own_bench(cls: type[Bench], key: str, scenario: Scenario, chemistry: ChemistryTable) -> Bench:
    """Build a bench of a user's own class, and check what it declares."""
    where = f"{scenario.origin}: benches.{key}: {scenario.benches[key].kind}"
    with blamed(where, DataError):
        bench = cls(key, scenario, chemistry)
    if not hasattr(bench, "action_space"):
        raise PartError(f"{where}: __init__() must call _set_spaces(channels, action_space)")
    with blamed(f"{where}: action_meanings"):
        meanings = list(bench.action_meanings)
    count = bench.action_count or (bench.action_space.shape or (0,))[0]
    if len(meanings) != count:
        raise PartError(f"{where}: action_meanings must have {count} texts, given {len(meanings)}")
    return bench


def discretised_twin(bench: Bench) -> Discretised | None:
    """Return the same bench with discrete actions; None if its actions are discrete already."""
    if bench.action_count:
        return None
    scenario = bench.scenario.configured(actions="discrete")
    twin = build_bench(bench.key, scenario, bench.chemistry)
    return twin if isinstance(twin, Discretised) else None
