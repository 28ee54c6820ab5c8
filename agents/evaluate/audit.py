"""Measure what a scenario requires of its agents: ``chemlab audit``.

Scores are normalized: 0 is random legal play, 1 the oracle. All compared policies play the same episodes, of the split
``test`` where the scenario has hidden parameters. Policies, plans and donors are chosen on other episodes. The best of
several rows is the one with the highest score in the scored episodes.

| measure | definition |
|---|---|
| ``random`` | random legal actions of all agents: 0 |
| ``reference`` | the best of the scripted policies, with which the ablations below are compared |
| ``best`` | the best of all policies with observations: scripted, bundled, and the learner with instruments |
| ``strongest`` | the best of all rows, open-loop policies and learners without instruments included |
| ``open_loop`` | the best open-loop policy, of all ``ways`` |
| ``oracle`` | a planner's lower bound of the optimum, with its budget ``curve``: 1 |
| ``value_of_information`` | ``best`` minus the best policy without instruments: the least of three ``ways`` |
| ``value_of_bench`` | by key, the reference minus the best policy that never uses it |
| ``value_of_memory`` | the reference minus the same policy without memory of earlier batches or measurements |
| ``value_of_reports`` | the reference minus the same policy where benches report nothing |
| ``value_of_role`` | by agent, the reference minus the same team with this member replaced |
| ``coordination_gain`` | the team's score minus that of its orders processed separately |
| ``contention`` | number of times in an episode that an order waits for another, by cause |
| ``headroom`` | 1 minus ``best`` |
| ``generalization`` | the reference in ``test`` minus in ``train`` |
| ``open_loop_deviation`` | standard deviation of the score of one open-loop policy over episodes |

The ways of an open-loop policy: ``idle`` (submit the first vessel at once), ``plan`` (a fixed sequence of manager
actions over scripted benches), ``everybody`` (fixed sequences of all agents, from constant actions and a search),
``replay`` and ``plan-replay`` (all agents' actions of the best donor's episode, of the reference or of the plan).

The ways of information: ``scripted`` (scripted and bundled policies without instruments, and open-loop ones),
``feedback`` (policies without instruments that observe what the scenario tells of submissions) and ``central`` (a
controller without instruments that observes what all agents observe). Learners count in the last two.

The oracle searches for the best plan of each episode. It starts from the open-loop policies and from the actions, in
that episode, of every scripted policy (also with exact instruments free of charge) and bundled policy. If any policy of
the audit scored higher in an episode, that is the oracle's score.

A role is replaced by ``random`` actions, by ``scripted:unsafe``, and by a bundled policy that was trained elsewhere
(``other``), where one fits; ``value_of_role`` is the greatest of these losses.

Orders that exist from the beginning are processed separately in a laboratory each. Orders that arrive over time contend
for one laboratory; separately then means one at a time, in the order of arrival, skipping none.

Each measure has a ``value`` and the ends ``low`` and ``high`` of its 95 % interval over episodes (t, with the
jackknife's variance). A measure that cannot be computed has null and a ``reason``. If no policy scores above both
random and idle play, the scenario is impossible: the result then has a sentence ``impossible`` in place of measures.
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

from ..roles import role_of
from ..runs import versions
from . import statistics
from .contention import CONTENDED
from .informed import openings
from .jobs import AUDIT_SEED, AuditBudget, Job, JobRunner, budget_of, foreseen, planner_jobs
from .scale import Scale, interval, missing
from .search import scripted_names

_CHOICE_SEED = 4_500_000
"""Seed of the first episode on which policies are chosen."""
_CAREFUL = ("scripted", "scripted:unsafe")
_TRAINED = ("pretrained", "trained")
_REPLACED = {"random": "random", "unsafe": "scripted:unsafe", "other": "trained"}
"""Policies that replace a member of the team, by name of the row."""
_WITH_INSTRUMENTS = "learner-instruments"

CRITERIA = {
    "open_loop": "at most 0.5 of the best policy",
    "value_of_information": "at least 0.1 in each way, intervals above 0",
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
    turns: int | None = None,
) -> dict[str, Any]:
    """Measure what a scenario requires of its agents.

    Args:
        scenario: a bundled name, a path, or a loaded scenario.
        budget: a name in :data:`~chemlab.agents.evaluate.jobs.BUDGETS`, or a budget.
        keep: folder of cached results, from which an interrupted audit resumes.
        executor: executor of the jobs, see :mod:`chemlab.agents.executors`; None: this process.
        watch: called with the name of each finished job.
        turns: training turns of each learner; default: the budget's.

    Returns:
        Plain data: the measures of this module's table, each with ``value``, ``low`` and ``high`` (or null and a
        ``reason``), ``criteria`` by name, and the settings and versions.

    Raises:
        DataError: the scenario is unknown.
        ValueError: the budget is unknown.
        WorkerLost: a job lost its worker in every attempt.
    """
    spec = load_scenario(scenario)
    chosen = budget_of(budget, turns)
    runner = JobRunner(spec, chosen, keep, executor, watch)
    found = runner.run(choosing_jobs(spec))
    scripted = scripted_names(spec)
    reference, best = _best(found, scripted), _best(found, [*scripted, *_TRAINED])
    plans = open_loop_plans(found)
    found |= runner.run(measuring_jobs(spec, chosen, reference, plans, best))
    return {
        "kind": "audit",
        "format": 2,
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


def open_loop_plans(found: Mapping[str, dict[str, Any]]) -> list[Any]:
    """Return open-loop policies [context, plan, tapes of the benches] of all contexts; the better kind is last."""
    kinds = {"plan": found["plan"]["plans"], "everybody": found["everybody"]["teams"]}
    ranked = sorted(kinds, key=lambda name: float(np.mean(found[name]["chosen"])))
    return [row for name in ranked for row in kinds[name]]


def job_count(scenario: Scenario, budget: AuditBudget) -> int:
    """Return the number of jobs of an audit; up to three more are added if the best policy is a bundled one."""
    return len(choosing_jobs(scenario)) + len(measuring_jobs(scenario, budget, "scripted", []))


def choosing_jobs(spec: Scenario) -> list[Job]:
    """Return the jobs that depend on no other: searches, which take longest, and then policies to choose from."""
    jobs = [Job("everybody", "everybody", {}), Job("plan", "plan", {})]
    jobs += [Job(f"plan-without-{key}", "plan", {"without": key}) for key in spec.benches]
    for policy in [*scripted_names(spec), *_TRAINED]:
        arguments = {"policy": policy, "split": "validation", "seed": _CHOICE_SEED}
        jobs.append(Job(f"choose-{policy}", "play", arguments))
    return jobs


def measuring_jobs(
    spec: Scenario, budget: AuditBudget, reference: str, plans: list[Any], best: str | None = None
) -> list[Job]:
    """Return the jobs that depend on the results of others.

    These are the best scripted policy (``reference``), the :func:`open_loop_plans`, and the best policy of all
    (default: the reference).
    """

    def play(name: str, policy: str, split: str = "test", **options: Any) -> Job:
        return Job(name, "play", {"policy": policy, **options, "split": split, "seed": AUDIT_SEED})

    jobs = planner_jobs(budget, plans)
    jobs += [Job("idle", "idle", {}), Job("replay", "replay", {"policy": reference})]
    jobs += [play("random", "random"), play("test", reference, contended=True)]
    jobs += [play("memoryless", "scripted:memoryless"), play("train", reference, "train")]
    for policy in _CAREFUL:
        jobs.append(play(f"blindfold-{policy}", policy, instruments=False))
        jobs += [play(f"without-{key}-{policy}", policy, without=key) for key in spec.benches]
    for agent in _members(spec):
        jobs += [play(f"role-{agent}-{name}", f"{reference},{agent}={other}") for name, other in _REPLACED.items()]
    if budget.turns:
        learners = {"learner-nothing": (False, []), "learner-plan": (False, plans), _WITH_INSTRUMENTS: (True, [])}
        jobs += [
            Job(name, "learn", {"instruments": instruments, "plans": begin})
            for name, (instruments, begin) in learners.items()
        ]
    if budget.worlds and spec.world.draws:
        jobs += [Job(f"central-{one}", "inform", {"opening": one, "plans": plans}) for one in openings(spec)]
    if best in _TRAINED:
        jobs.append(play("best", best))
        for manager in _CAREFUL:
            jobs.append(play(f"blindfold-{best}-{manager}", f"{best},manager={manager}", instruments=False))
    if any(bench.report is not None for bench in spec.benches.values()):
        jobs.append(play("mute", reference, reports=False))
    if spec.demand.order:
        jobs.append(play("apart", "scripted:fifo"))
    elif spec.orders > 1:
        jobs.append(Job("apart", "apart", {"policy": reference}))
    return jobs


def _members(spec: Scenario) -> list[str]:
    """Return the manager and the first agent of each kind of bench."""
    return list({role_of(agent): agent for agent in reversed(spec.agents())}.values())[::-1]


def _best(found: Mapping[str, dict[str, Any]], policies: Sequence[str]) -> str:
    """Return the policy with the best mean on the episodes for the choice."""
    return _greatest({policy: _scores(found, f"choose-{policy}") for policy in policies})[0]


def _scores(found: Mapping[str, dict[str, Any]], name: str) -> FloatArray | None:
    """Return the scores [E] of a job; None if it was not played or no policy fits."""
    scores = found[name]["scores"] if name in found else None
    return None if scores is None else np.array(scores)


def _greatest(candidates: Mapping[str, FloatArray | None]) -> tuple[str, FloatArray]:
    """Return the name and the scores of the candidate with the best mean."""
    played = {name: scores for name, scores in candidates.items() if scores is not None}
    return max(played.items(), key=lambda item: item[1].mean())


def _named(found: Mapping[str, dict[str, Any]], *starts: str) -> dict[str, FloatArray | None]:
    """Return the scores of all jobs whose names have one of the prefixes."""
    return {name: _scores(found, name) for name in found if name.startswith(starts)}


def _measures(spec: Scenario, found: Mapping[str, dict[str, Any]], policy: str, chosen: str) -> dict[str, Any]:
    """Return all measures and criteria from results of jobs; ``policy`` is the reference, ``chosen`` the best one."""
    test, plan, random = (np.array(found[name]["scores"]) for name in ("test", "plan", "random"))
    open_loop = {name: _scores(found, name) for name in ("idle", "replay", "plan", "everybody")}
    open_loop["plan-replay"] = np.array(found["plan"]["everybody"])
    observing = {chosen: _scores(found, "best"), policy: test, _WITH_INSTRUMENTS: _scores(found, _WITH_INSTRUMENTS)}
    scripted = _named(found, "blindfold-") | open_loop
    learners = {name: scores for name, scores in _named(found, "learner-").items() if name != _WITH_INSTRUMENTS}
    central = _named(found, "central-")
    by_manager = found.get("central-submission", {}).get("feedback")  # managers do not observe looks at vessels
    feedback = {"feedback-submission": None if by_manager is None else np.array(by_manager)}
    rows = {**observing, **scripted, **learners, **feedback, **central}
    others = _best_of_all(found, [*open_loop.values(), *feedback.values()])
    oracle = np.maximum(foreseen(found), others)
    idle = np.array(found["idle"]["scores"])
    if oracle.mean() <= max(random.mean(), idle.mean()) + 1e-9:
        return {"impossible": _impossible(spec, random, idle), "criteria": dict.fromkeys(CRITERIA)}
    scale = Scale(random, oracle)
    best_name, best = _greatest(observing)
    reference, top = scale.mean(test), scale.mean(best)

    def loss(name: str, reason: str) -> dict[str, Any]:
        """Return the reference minus the policy of a job, or the reason why there is none."""
        scores = _scores(found, name)
        return missing(reason) if scores is None else interval(reference - scale.mean(scores))

    measures: dict[str, Any] = {
        "random": _row(scale, {"random": random}),
        "reference": _row(scale, {policy: test}),
        "best": _row(scale, {best_name: best}),
        "strongest": _row(scale, rows),
        "open_loop": {
            **_row(scale, open_loop),
            "ways": {name: float(scale.mean(scores)[0]) for name, scores in open_loop.items() if scores is not None},
        },
        "oracle": {
            **_row(scale, {"planner": oracle}),
            "curve": [float(scale.mean(np.maximum(column, others))[0]) for column in foreseen(found, "curves").T],
        },
        "value_of_information": _information(
            spec, top, scale, {"scripted": scripted, "feedback": learners | feedback, "central": learners | central}
        ),
        "value_of_bench": {
            key: _value(
                reference,
                scale,
                {name: _scores(found, f"without-{key}-{name}") for name in _CAREFUL}
                | {"plan": _scores(found, f"plan-without-{key}")},
            )
            for key in spec.benches
        },
        "value_of_role": {agent: _role(found, agent, reference, scale) for agent in _members(spec)},
        "value_of_memory": loss("memoryless", "the scripted manager has nothing to forget"),
        "value_of_reports": loss("mute", "benches report nothing"),
        "coordination_gain": loss(
            "apart", "there is one order" if spec.orders == 1 else "no bundled policy takes one order at a time"
        ),
        "contention": _contention(found),
        "headroom": interval(1.0 - top),
        "generalization": loss("train", "") if spec.world.draws else missing("the scenario has no hidden parameters"),
        "open_loop_deviation": interval(scale.deviation(plan)),
    }
    return {**measures, "criteria": _criteria(measures)}


def _best_of_all(found: Mapping[str, dict[str, Any]], more: Sequence[FloatArray | None]) -> FloatArray:
    """Return [E] the best score in each scored episode, of all jobs that play these episodes and of ``more`` scores."""
    elsewhere = ("choose-", "foresee-", "train", "apart")  # other episodes, or other laboratories
    scores = [*more, *(_scores(found, name) for name in found if not name.startswith(elsewhere))]
    return np.asarray(np.maximum.reduce([own for own in scores if own is not None]))


def _impossible(spec: Scenario, random: FloatArray, idle: FloatArray) -> str:
    return (
        f"{spec.name}: impossible: no policy and no plan that was tried scores above random legal play "
        f"({random.mean():.3f}) and above submitting the first vessel at once ({idle.mean():.3f}), so there is no "
        "scale; check that the scenario can be solved (stock, limits, prices), or give a budget that tries more plans"
    )


def _row(scale: Scale, candidates: Mapping[str, FloatArray | None]) -> dict[str, Any]:
    """Return the normalized score of the best candidate, its raw score and its name."""
    name, scores = _greatest(candidates)
    return {**interval(scale.mean(scores)), "score": float(scores.mean()), "way": name}


def _contention(found: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return contention counts per episode of the reference, in total and by kind."""
    counts = np.array(found["test"]["contention"])
    total = statistics.mean([counts.sum(axis=1)]).as_dict()
    return {**total, "kinds": dict(zip(CONTENDED, counts.mean(axis=0).tolist(), strict=True))}


def _value(reference: FloatArray, scale: Scale, others: Mapping[str, FloatArray | None]) -> dict[str, Any]:
    """Return the reference minus the best policy without an ability."""
    name, scores = _greatest(others)
    return {**interval(reference - scale.mean(scores)), "without": name}


def _information(
    spec: Scenario, best: FloatArray, scale: Scale, ways: Mapping[str, Mapping[str, FloatArray | None]]
) -> dict[str, Any]:
    """Return the least value of information of all ways with a measurement, and the values of all ways."""
    if not spec.instruments:
        return missing("the scenario has no instruments")
    values = {
        name: _value(best, scale, others)
        if any(own is not None for own in others.values())
        else missing("the budget has no turns for learners")
        for name, others in ways.items()
    }
    known = [value for value in values.values() if value["value"] is not None]
    return {**min(known, key=lambda value: value["value"]), "ways": values}


def _role(found: Mapping[str, dict[str, Any]], agent: str, reference: FloatArray, scale: Scale) -> dict[str, Any]:
    """Return the greatest loss when a member of the team is replaced, and the loss for each replacement."""
    teams = {name: _scores(found, f"role-{agent}-{name}") for name in _REPLACED}
    losses = {name: interval(reference - scale.mean(scores)) for name, scores in teams.items() if scores is not None}
    worst = max(losses, key=lambda name: losses[name]["value"])
    return {**losses[worst], "without": worst, "ways": losses}


def _criteria(measures: Mapping[str, Any]) -> dict[str, bool | None]:
    """Return True for each of :data:`CRITERIA` that is met; None if it does not apply."""
    information, deviation = measures["value_of_information"], measures["open_loop_deviation"]["value"]
    coordination, best = measures["coordination_gain"]["value"], measures["best"]["value"]
    known = [value for value in information.get("ways", {}).values() if value["value"] is not None]
    return {
        "open_loop": bool(best > 0.0 and measures["open_loop"]["value"] <= 0.5 * best),
        "value_of_information": bool(known)
        and all(value["value"] >= 0.1 and (value["low"] or 0.0) > 0.0 for value in known),
        "value_of_bench": all(own["value"] >= 0.1 for own in measures["value_of_bench"].values()),
        "coordination_gain": None if coordination is None else bool(coordination >= 0.1),
        "headroom": bool(measures["headroom"]["value"] >= 0.15),
        "open_loop_deviation": bool(deviation > 0.1),
    }


_SEVERAL = {"value_of_bench": "value of {}", "value_of_role": "{} replaced", "value_of_information": "information, {}"}
"""Measures with several rows, and the names of the rows."""


def measure_rows(found: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield an audit's measures: name, value with interval (or the reason why there is none), and policy."""
    for name, measure in found.items():
        if not isinstance(measure, dict):
            continue
        if "value" in measure:
            yield _row_words(name.replace("_", " "), measure)
        if name in _SEVERAL:
            several = measure.get("ways", {}) if "value" in measure else measure
            yield from (_row_words(_SEVERAL[name].format(key), estimate) for key, estimate in several.items())


def _row_words(name: str, measure: Mapping[str, Any]) -> tuple[str, str, str]:
    value = measure["reason"] if measure["value"] is None else statistics.interval_text(measure)
    return name, value, measure.get("way") or measure.get("without") or ""


def verdict(found: Mapping[str, Any]) -> str:
    """Return a sentence on the criteria that an audit does not meet."""
    if "impossible" in found:
        return str(found["impossible"])
    failed = [name for name, met in found["criteria"].items() if met is False]
    if not failed:
        return f"{found['scenario']}: every criterion is met"
    if "open_loop" in failed:
        way = found["open_loop"]["way"]
        return f"{found['scenario']}: an open-loop policy ({way}) solves it; not met: {', '.join(failed)}"
    return f"{found['scenario']}: not met: {', '.join(failed)}"
