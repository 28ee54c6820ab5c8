"""Measure what a scenario requires of its agents: ``chemlab audit``.

Scores are normalized: 0 is random legal play, 1 the oracle, a planner with the hidden parameters of each episode. All
compared policies play the same episodes, of the split ``test`` where the scenario has hidden parameters. Choices (the
best policy, plan and donor) are made on other episodes.

| measure | what |
|---|---|
| ``random`` | random legal actions of everybody: 0 |
| ``reference`` | the best of the scripted policies: what follows is what these need, benches of one make throughout |
| ``best`` | the best of all policies that come with chemlab, trained ones included |
| ``open_loop`` | the best of a donor's episode again, a constant plan of the manager, the same of everybody |
| ``oracle`` | for each episode by itself, the best plan that a search finds on it: 1 |
| ``value_of_information`` | reference less the best without instruments |
| ``value_of_bench`` | by key, reference less the best that never uses it |
| ``value_of_memory`` | reference less the same policy without what it remembers of earlier batches or looks |
| ``value_of_reports`` | reference less the same policy where benches say nothing of what they have made |
| ``coordination_gain`` | the team's result less that of its orders run apart |
| ``contention`` | moments at which an order is kept waiting by another, in an episode, by what for |
| ``value_to_best`` | best less the same benches under the better of two managers that measure nothing |
| ``headroom`` | 1 less the best |
| ``generalization`` | reference in test less in train |
| ``open_loop_deviation`` | standard deviation of one constant plan's score over episodes |

Blind play is a donor's actions played again by everybody; a constant plan of the manager, found by a search, over
benches that see; and that plan with the benches' actions of a donor's episode played again, too.

Orders that are all there from the beginning are run apart each in a laboratory of its own. Orders that come over time
contend for one laboratory: apart means that each is worked on by itself, in the order in which they come, and none is
let go for another. ``value_of_reports`` compares managers with and without the benches' self-reported outcomes.

Each has a ``value`` and the ends ``low`` and ``high`` of its 95 % interval over episodes (t, with the
jackknife's variance); what cannot be computed is null, with a ``reason``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray
from chemlab.record import scenario_hash

from ..runs import versions
from . import statistics
from .contention import CONTENDED
from .jobs import AUDIT_SEED, AuditBudget, Crew, Job, budget_of, foreseen, planner_jobs
from .scale import Scale, interval

__all__ = ["CRITERIA", "audit", "choosing_jobs", "job_count", "measure_rows", "measuring_jobs", "verdict"]

_CHOICE_SEED = 4_500_000
"""Of the first episode that policies are chosen on."""
_CAREFUL = ("scripted", "scripted:unsafe")
_SCRIPTED = (*_CAREFUL, "scripted:no-extraction")
_TRAINED = ("pretrained", "trained")

CRITERIA = {
    "open_loop": "at most 0.5 of the reference",
    "value_of_information": "at least 0.1, its interval above 0",
    "value_of_bench": "at least 0.1 for each",
    "coordination_gain": "at least 0.1, where there are several orders",
    "headroom": "at least 0.15",
    "open_loop_deviation": "above 0.1",
}
"""Acceptance criteria of a scenario with hidden parameters, by measure."""


# -- the audit --------------------------------------------------------------------------------------------------------


def audit(
    scenario: str | Path | Scenario,
    budget: str | AuditBudget = "small",
    keep: Path | None = None,
    executor: Executor | None = None,
    watch: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure what a scenario asks of its agents.

    Args:
        scenario: a shipped name, a path, or a loaded scenario.
        budget: one of :data:`~chemlab.agents.evaluate.jobs.BUDGETS`, or numbers of one's own.
        keep: folder in which results of finished parts are kept, so that a broken-off audit goes on there.
        executor: plays the parts, see :mod:`chemlab.agents.executors`; None: this process.
        watch: called with the name of each part that has been played.

    Returns:
        Plain data: the measures of this module's table, each with ``value``, ``low`` and ``high`` (or null and a
        ``reason``), ``criteria`` by name, and how it was made.

    Raises:
        DataError: no such scenario.
        ValueError: unknown budget, or nothing that was played scores above random play.
        WorkerLost: a part lost its worker again and again.
    """
    spec = load_scenario(scenario)
    chosen = budget_of(budget)
    crew = Crew(spec, chosen, keep, executor, watch)
    found = crew.run(choosing_jobs(spec))
    reference, best = _best(found, _SCRIPTED), _best(found, _SCRIPTED + _TRAINED)
    found |= crew.run(measuring_jobs(spec, chosen, reference, found["plan"]["plans"], best))
    return {
        "kind": "audit",
        "format": 1,
        "scenario": spec.name,
        "scenario_hash": scenario_hash(spec),
        "budget": budget if isinstance(budget, str) else "own",
        **{f"budget_{key}": value for key, value in vars(chosen).items()},
        "split": "test" if spec.world.draws else None,
        "seed": AUDIT_SEED,
        "versions": versions(),
        "policy": reference,
        **_measures(spec, found, reference, best),
    }


def job_count(scenario: Scenario, budget: AuditBudget) -> int:
    """Return the number of parts of an audit; a trained best policy adds up to three."""
    return len(choosing_jobs(scenario)) + len(measuring_jobs(scenario, budget, "scripted", []))


def choosing_jobs(spec: Scenario) -> list[Job]:
    """All that needs to know nothing: the searches first, they take longest."""
    jobs = [Job("plan", "plan", {})]
    jobs += [Job(f"plan-without-{key}", "plan", {"without": key}) for key in spec.benches]
    for policy in _SCRIPTED + _TRAINED:
        own = {"policy": policy, "split": "validation", "seed": _CHOICE_SEED}
        jobs.append(Job(f"choose-{policy}", "play", own))
    return jobs


def measuring_jobs(
    spec: Scenario, budget: AuditBudget, reference: str, plans: list[Any], best: str | None = None
) -> list[Job]:
    """All that needs to know the best scripted policy, the best plan, and the best of all (default: the scripted)."""
    jobs = planner_jobs(budget, plans)
    jobs.append(Job("replay", "replay", {"policy": reference}))
    test = {"split": "test", "seed": AUDIT_SEED}
    jobs += [
        Job("random", "play", {"policy": "random", **test}),
        Job("test", "play", {"policy": reference, "contended": True, **test}),
    ]
    jobs.append(Job("memoryless", "play", {"policy": "scripted:memoryless", **test}))
    jobs.append(Job("train", "play", {"policy": reference, "split": "train", "seed": AUDIT_SEED}))
    for policy in _CAREFUL:
        jobs.append(Job(f"blindfold-{policy}", "play", {"policy": policy, "instruments": False, **test}))
        jobs += [
            Job(f"without-{key}-{policy}", "play", {"policy": policy, "without": key, **test}) for key in spec.benches
        ]
    if best in _TRAINED:
        jobs.append(Job("best", "play", {"policy": best, **test}))
        for name, policy in _unseeing(best).items():
            jobs.append(Job(name, "play", {"policy": policy, "instruments": False, **test}))
    if any(bench.report is not None for bench in spec.benches.values()):
        jobs.append(Job("mute", "play", {"policy": reference, "reports": False, **test}))
    if spec.demand.order:
        jobs.append(Job("apart", "play", {"policy": "scripted:fifo", **test}))
    elif spec.orders > 1:
        jobs.append(Job("apart", "apart", {"policy": reference}))
    return jobs


def _unseeing(best: str) -> dict[str, str]:
    """Parts in which the benches of a policy play under scripted managers who can measure nothing, and who plays."""
    return {f"unseeing-{manager}": f"{best},manager={manager}" for manager in _CAREFUL}


def _best(found: Mapping[str, dict[str, Any]], policies: Sequence[str]) -> str:
    """Return the policy with the best mean on the episodes for choices."""
    scores = {policy: _scores(found, f"choose-{policy}") for policy in policies}
    return _greatest(scores)[0]


def _untold(reason: str) -> dict[str, Any]:
    return {"value": None, "low": None, "high": None, "reason": reason}


def _scores(found: Mapping[str, dict[str, Any]], name: str) -> FloatArray | None:
    scores = found[name]["scores"] if name in found else None
    return None if scores is None else np.array(scores)


def _greatest(candidates: Mapping[str, FloatArray | None]) -> tuple[str, FloatArray]:
    """The candidate with the best mean."""
    there = {name: scores for name, scores in candidates.items() if scores is not None}
    name = max(there, key=lambda one: there[one].mean())
    return name, there[name]


def _measures(spec: Scenario, found: Mapping[str, dict[str, Any]], policy: str, chosen: str) -> dict[str, Any]:
    curve = foreseen(found, "curves")
    plan, test = np.array(found["plan"]["scores"]), np.array(found["test"]["scores"])
    random = np.array(found["random"]["scores"])
    best = np.array(found["best"]["scores"]) if "best" in found else test
    unseeing = {} if best is test else {name: _scores(found, name) for name in _unseeing(chosen)}
    # Whoever knows the world can do what the others did there.
    others = [test, plan, best, *(scores for scores in unseeing.values() if scores is not None)]
    oracle = np.maximum.reduce([foreseen(found), *others])
    scale = Scale(random, oracle)
    if scale.span <= 0.0:
        raise ValueError(
            f"{spec.name}: no policy and no plan that was tried scores above random legal play "
            f"({random.mean():.3f} in the mean), so there is no scale and nothing to audit; check that the scenario "
            "can be solved (stock, limits, prices), or give a budget that tries more plans"
        )
    ways = {"replay": _scores(found, "replay"), "plan": plan, "everybody": np.array(found["plan"]["everybody"])}
    way, blind = _greatest(ways)
    blindfolded = {name: _scores(found, f"blindfold-{name}") for name in _CAREFUL} | {"plan": plan}
    reference = scale.mean(test)
    measures: dict[str, Any] = {
        "random": {**interval(scale.mean(random)), "score": float(random.mean())},
        "reference": {**interval(reference), "score": float(test.mean()), "way": policy},
        "best": {**interval(scale.mean(best)), "score": float(best.mean()), "way": chosen},
        "open_loop": {
            **interval(scale.mean(blind)),
            "score": float(blind.mean()),
            "way": way,
            "ways": {name: float(scale.mean(scores)[0]) for name, scores in ways.items() if scores is not None},
        },
        "oracle": {
            **interval(scale.mean(oracle)),
            "score": float(oracle.mean()),
            "curve": [float(scale.mean(np.maximum.reduce([column, *others]))[0]) for column in curve.T],
        },
        "value_of_information": _value(reference, scale, blindfolded)
        if spec.instruments
        else _untold("the scenario has no instruments"),
        "value_to_best": _value(scale.mean(best), scale, unseeing)
        if unseeing and spec.instruments
        else _untold("the best is scripted" if spec.instruments else "the scenario has no instruments"),
        "value_of_bench": {
            key: _value(
                reference,
                scale,
                {name: _scores(found, f"without-{key}-{name}") for name in _CAREFUL}
                | {"plan": _scores(found, f"plan-without-{key}")},
            )
            for key in spec.benches
        },
        "value_of_memory": _untold("the scripted manager has nothing to forget"),
        "coordination_gain": _untold("there is one order"),
        "value_of_reports": _untold("benches report nothing"),
        "contention": _contention(found),
        "headroom": interval(1.0 - scale.mean(best)),
        "generalization": interval(reference - scale.mean(np.array(found["train"]["scores"])))
        if spec.world.draws
        else _untold("the scenario draws no world"),
        "open_loop_deviation": interval(scale.deviation(plan)),
    }
    memoryless = _scores(found, "memoryless")
    if memoryless is not None:
        measures["value_of_memory"] = interval(reference - scale.mean(memoryless))
    mute, apart = _scores(found, "mute"), _scores(found, "apart")
    if mute is not None:
        measures["value_of_reports"] = interval(reference - scale.mean(mute))
    if apart is not None:
        measures["coordination_gain"] = interval(reference - scale.mean(apart))
    elif spec.orders > 1:
        measures["coordination_gain"] = _untold("no bundled policy takes one order at a time")
    return {**measures, "criteria": _criteria(spec, measures)}


def _contention(found: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return contention counts per episode of the reference, in total and by kind."""
    counts = np.array(found["test"]["contention"])
    told = statistics.mean([counts.sum(axis=1)]).as_dict()
    return {**told, "kinds": dict(zip(CONTENDED, counts.mean(axis=0).tolist(), strict=True))}


def _value(reference: FloatArray, scale: Scale, others: Mapping[str, FloatArray | None]) -> dict[str, Any]:
    """Return the reference minus the best policy without an ability."""
    name, scores = _greatest(others)
    return {**interval(reference - scale.mean(scores)), "without": name}


def _criteria(spec: Scenario, measures: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return which of :data:`CRITERIA` are met; None where one does not apply."""
    information, deviation = measures["value_of_information"], measures["open_loop_deviation"]["value"]
    coordination, reference = measures["coordination_gain"]["value"], measures["reference"]["value"]
    met = information["value"] is not None and information["value"] >= 0.1 and (information["low"] or 0.0) > 0.0
    return {
        "open_loop": bool(reference > 0.0 and measures["open_loop"]["value"] <= 0.5 * reference),
        "value_of_information": bool(met),
        "value_of_bench": all(own["value"] >= 0.1 for own in measures["value_of_bench"].values()),
        "coordination_gain": None if coordination is None else bool(coordination >= 0.1),
        "headroom": bool(measures["headroom"]["value"] >= 0.15),
        "open_loop_deviation": bool(deviation > 0.1),
    }


def measure_rows(found: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """An audit's measures in words: name, value with its interval (or why there is none), and whose it is."""
    for name, measure in found.items():
        if isinstance(measure, dict) and "value" in measure:
            said = measure["reason"] if measure["value"] is None else statistics.interval_text(measure)
            yield name.replace("_", " "), said, measure.get("way") or measure.get("without") or ""
        elif name == "value_of_bench":
            yield from (
                (f"value of {key}", statistics.interval_text(own), own["without"]) for key, own in measure.items()
            )


def verdict(found: Mapping[str, Any]) -> str:
    """Return an audit's criteria as a sentence."""
    failed = [name for name, met in found["criteria"].items() if met is False]
    if not failed:
        return f"{found['scenario']}: every criterion is met"
    if "open_loop" in failed:
        return f"{found['scenario']}: an open-loop plan solves it; not met: {', '.join(failed)}"
    return f"{found['scenario']}: not met: {', '.join(failed)}"
