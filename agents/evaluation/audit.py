"""What a scenario asks of its agents, measured: ``chemlab audit``.

Scores are normalised: 0 is random legal play, 1 what a planner reaches that knows each episode's world. Whatever is
compared plays the same episodes: of the split ``test``, where the scenario draws any worlds. What has to be chosen (the
best policy, the best plan, the best donor) is chosen on others.

| measure | what |
|---|---|
| ``random`` | random legal actions of everybody: 0 |
| ``reference`` | the best of the policies that come with chemlab |
| ``blind`` | the best of a donor's episode again, a constant plan of the manager, the same of everybody |
| ``clairvoyant`` | for each episode by itself, the best plan that a search finds on it: 1 |
| ``worth_of_measuring`` | reference less the best without instruments |
| ``worth_of_bench`` | by key, reference less the best that never uses it |
| ``worth_of_memory`` | reference less the same policy without what it remembers of earlier batches or looks |
| ``worth_of_reports`` | reference less the same policy where benches say nothing of what they have made |
| ``coordination`` | the team's result less that of its orders run apart |
| ``contention`` | moments at which an order is kept waiting by another, in an episode, by what for |
| ``headroom`` | 1 less the reference |
| ``generalization`` | reference in test less in train |
| ``noise`` | standard deviation of one constant plan's score over episodes |

Blind play is a donor's actions played again by everybody; a constant plan of the manager, found by a search, over
benches that see; and that plan with the benches' actions of a donor's episode played again, too.

Orders that are all there from the beginning are run apart each in a laboratory of its own. Orders that come over time
contend for one laboratory: apart means that each is worked on by itself, in the order in which they come, and none is
let go for another. Who also hears from benches what they have made is told from who does not: ``worth_of_reports``.

Each has a ``value`` and the ends ``low`` and ``high`` of its 95 % bootstrap interval over episodes; what cannot be said
is null, with a ``reason``.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from chemlab.arrays import FloatArray
from chemlab.datafile import DataError, read_json, validated
from chemlab.files import write_text
from chemlab.laboratory.actions import ManagerActions
from chemlab.laboratory.core import MANAGER_AGENT, Laboratories
from chemlab.record import scenario_hash
from chemlab.scenario import Scenario, load_scenario

from ..plans import all_contexts
from ..player import play_laboratory
from ..policies import make_policies, manager_heuristic
from ..runs import versions
from . import statistics
from .contention import CONTENDED, Contention
from .plans import PlanSearch, best_in_episode, replay_actions, search_plan

__all__ = ["BUDGETS", "GATES", "AuditBudget", "audit", "job_count", "measure_rows", "verdict"]

AUDIT_SEED = 4_000_000
"""Of the first episode that is scored: seeds that neither training nor a search plays."""
_CHOICE_SEED = 4_500_000
"""Of the first episode that policies are chosen on."""
_POLICIES = ("heuristic", "hasty", "direct", "pretrained", "trained")
_NO_BUDGET = 1e-9
_CHUNK = 10
"""Episodes that one process searches in, one after the other."""
_TENTHS = 10
"""Into so many parts the clairvoyant's curve divides its budget."""
_PART_BYTES = 10_000_000
"""Of a file of a finished part: that of 200 episodes is a tenth of a megabyte."""

GATES = {
    "blind": "at most 0.5 of the reference",
    "measuring": "worth at least 0.1, its interval above 0",
    "benches": "each worth at least 0.1",
    "coordination": "worth at least 0.1, where there are several orders",
    "headroom": "at least 0.15",
    "noise": "above 0.1",
}
"""What a world scenario has to prove."""


@dataclass(frozen=True)
class AuditBudget:
    """How much is played.

    Attributes:
        episodes: that everybody is scored on.
        plans: tried by the search for the best constant plan.
        fewer: the same for each bench left out.
        donors: of replayed episodes, for each public context.
        planned: plans that the clairvoyant tries in each episode.
    """

    episodes: int
    plans: int
    fewer: int
    donors: int
    planned: int


BUDGETS = {
    "small": AuditBudget(episodes=40, plans=2_000, fewer=400, donors=20, planned=240),
    "full": AuditBudget(episodes=200, plans=40_000, fewer=4_000, donors=20, planned=1_500),
}
"""``small``: under two minutes on two cores; ``full``: under thirty."""


# -- what is played, each in a process of its own ---------------------------------------------------------------------


@dataclass(frozen=True)
class _Job:
    """Something to be played.

    Attributes:
        name: under which it is kept.
        kind: a key of ``_KINDS``.
        arguments: of that function, besides scenario and budget.
    """

    name: str
    kind: str
    arguments: dict[str, Any]


def _played(scenario: Scenario, policies: Callable[[Laboratories], Any], episodes: int, seed: int, split: str) -> Any:
    labs = Laboratories(scenario, episodes, split=split)
    return play_laboratory(labs, policies(labs), None, seed)


def _play(
    scenario: Scenario,
    budget: AuditBudget,
    policy: str,
    split: str,
    seed: int,
    instruments: bool = True,
    without: str = "",
    episodes: int | None = None,
    contended: bool = False,
    reports: bool = True,
) -> dict[str, Any]:
    """Scores of a policy by name in so many episodes (default: the budget's), or None where none of this name fits."""
    if not reports:
        mute = {key: bench.model_copy(update={"report": None}) for key, bench in scenario.benches.items()}
        scenario = scenario.model_copy(update={"benches": mute})
    if not instruments:
        limits = scenario.limits.model_copy(update={"budget": _NO_BUDGET})
        scenario = scenario.model_copy(update={"limits": limits})

    def policies(labs: Laboratories) -> Any:
        found = make_policies(policy, labs, seed)
        if without:
            found[MANAGER_AGENT] = manager_heuristic(labs, policy != "hasty", [without])
        if contended:
            found[MANAGER_AGENT] = counter = Contention(found[MANAGER_AGENT], labs)
            counters.append(counter)
        return found

    counters: list[Contention] = []
    try:
        count = budget.episodes if episodes is None else episodes
        scores = _played(scenario, policies, count, seed, split).returns.tolist()
        return {"scores": scores, **({"contention": counters[0].events().tolist()} if contended else {})}
    except ValueError as error:
        return {"scores": None, "reason": str(error)}


def _plan(scenario: Scenario, budget: AuditBudget, without: str = "", split: str = "test") -> dict[str, Any]:
    """The best constant plan that a search finds in training worlds, and its scores; with all benches, also those with
    the benches' actions repeated."""
    most = budget.fewer if without else budget.plans
    search = search_plan(scenario, budget=most, without=[without] if without else ())
    found: dict[str, Any] = {"scores": search.play(budget.episodes, AUDIT_SEED, split).tolist()}
    if not without:
        found["plans"] = [[list(context), list(plan)] for context, plan in search.plans.items()]
        found["everybody"] = _replayed(scenario, budget, search, split)
    return found


def _replayed(scenario: Scenario, budget: AuditBudget, policy: str | PlanSearch, split: str = "test") -> list[float]:
    blind = replay_actions(scenario, policy, budget.donors, budget.episodes, AUDIT_SEED, split=split)
    scores: list[float] = blind.scores.tolist()
    return scores


def _replay(scenario: Scenario, budget: AuditBudget, policy: str) -> dict[str, Any]:
    return {"scores": _replayed(scenario, budget, policy)}


def _foresee(
    scenario: Scenario, budget: AuditBudget, first: int, plans: list[Any], split: str = "test"
) -> dict[str, Any]:
    """The best that a search finds in each of some episodes, and what it had found by each tenth of its budget."""
    known = {tuple(context): tuple(plan) for context, plan in plans}
    scores, curves = [], []
    for episode in range(first, min(first + _CHUNK, budget.episodes)):
        seed = AUDIT_SEED + episode
        score, curve = best_in_episode(scenario, seed, split, budget.planned, known)
        reached = [
            max(s for tried, s in curve if tried <= max(part * budget.planned / _TENTHS, curve[0][0]))
            for part in range(1, _TENTHS + 1)
        ]
        scores.append(score)
        curves.append(reached)
    return {"scores": scores, "curves": curves}


def _apart(scenario: Scenario, budget: AuditBudget, policy: str) -> dict[str, Any]:
    """Mean over the orders of what each comes to in a laboratory that has no other."""
    labs = Laboratories(scenario, budget.episodes, split="test")
    for member in labs.members.tolist():
        labs.seed(member, np.random.SeedSequence(AUDIT_SEED + member))
    labs.reset(labs.members)
    goals = np.array(scenario.goals)[labs.state.goal]
    alone = _alone(scenario)
    scores = np.zeros(goals.shape)
    for goal in np.unique(goals):
        one = Laboratories(alone, budget.episodes, split="test")
        returns = play_laboratory(one, make_policies(policy, one, AUDIT_SEED), str(goal), AUDIT_SEED).returns
        scores += (goals == goal) * returns[:, None]
    return {"scores": scores.mean(axis=1).tolist()}


def _alone(scenario: Scenario) -> Scenario:
    """The laboratory for one of the orders. Its share of the score is the whole there: prices grow by as much."""
    times = scenario.orders
    instruments = {}
    for name, spec in scenario.instruments.items():
        drift = spec.drift and spec.drift.model_copy(update={"price": times * spec.drift.price})
        instruments[name] = spec.model_copy(update={"price": times * spec.price, "drift": drift})
    benches = {}
    for key, bench in scenario.benches.items():
        wear = bench.wear and bench.wear.model_copy(update={"repair_price": times * bench.wear.repair_price})
        benches[key] = bench.model_copy(update={"wear": wear})
    costs = scenario.costs.model_copy(
        update={
            "stock_per_mol": {name: times * price for name, price in scenario.costs.stock_per_mol.items()},
            "waste_per_l": times * scenario.costs.waste_per_l,
            "tick": times * scenario.costs.tick,
            "illegal_action": times * scenario.costs.illegal_action,
        }
    )
    safety = scenario.safety.model_copy(update={"reward_price": times * scenario.safety.reward_price})
    limits = scenario.limits.model_copy(update={"budget": times * scenario.limits.budget})
    prices = {"benches": benches, "instruments": instruments, "costs": costs, "safety": safety, "limits": limits}
    return scenario.model_copy(update={"orders": 1, **prices})


_KINDS: dict[str, Callable[..., dict[str, Any]]] = {
    "play": _play,
    "plan": _plan,
    "replay": _replay,
    "foresee": _foresee,
    "apart": _apart,
}


def _run(job: _Job, scenario: Scenario, budget: AuditBudget) -> dict[str, Any]:
    return _KINDS[job.kind](scenario, budget, **job.arguments)


class _Result(BaseModel):
    """What a job has come to, as a file has it: which of these depends on its kind."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    scores: list[float] | None
    reason: str = ""
    contention: list[list[float]] = []
    plans: list[tuple[list[str], list[int]]] = []
    everybody: list[float] = []
    curves: list[list[float]] = []

    def is_of(self, job: _Job, budget: AuditBudget, scenario: Scenario) -> bool:
        """Whether it has what such a job comes to, of as many episodes, and plans that can be played."""
        given, wanted = self.model_fields_set, {"scores"}
        if job.kind == "play" and self.scores is None:
            return given == {"scores", "reason"}
        episodes = job.arguments.get("episodes") or budget.episodes
        if job.kind == "play" and job.arguments.get("contended"):
            wanted |= {"contention"}
        if job.kind == "foresee":
            wanted |= {"curves"}
            episodes = min(_CHUNK, budget.episodes - job.arguments["first"])
        if job.kind == "plan" and not job.arguments.get("without"):
            wanted |= {"plans", "everybody"}
        lists = [getattr(self, name) for name in wanted - {"plans"}]
        rows = [*((row, len(CONTENDED)) for row in self.contention), *((row, _TENTHS) for row in self.curves)]
        count = len(ManagerActions.of(scenario))
        return (
            given == wanted
            and all(part is not None and len(part) == episodes for part in lists)
            and all(len(row) == width for row, width in rows)
            and ("plans" not in wanted or {tuple(context) for context, _ in self.plans} == {*all_contexts(scenario)})
            and all(0 <= action < count for _, plan in self.plans for action in plan)
        )


class _Part(BaseModel):
    """A file of a finished part."""

    model_config = ConfigDict(extra="forbid")

    stamp: str
    result: _Result


def _end_with_parent() -> None:
    """Let this process end when the one that started it does, however that ends: a pool's processes would wait on."""

    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _Crew:
    """Runs jobs in as many processes as there are, and keeps what each has come to.

    Args:
        scenario: the audited one.
        budget: how much is played.
        keep: folder of results, from which a broken-off audit goes on; None: nowhere.
        processes: how many.
        watch: called with (jobs done, name of the last).
    """

    def __init__(
        self, scenario: Scenario, budget: AuditBudget, keep: Path | None, processes: int, watch: Callable[[str], None]
    ) -> None:
        self._scenario, self._budget, self._keep, self._watch = scenario, budget, keep, watch
        self._made_of = [scenario_hash(scenario), vars(budget), versions()]
        # Threads of numerical libraries do not survive a fork.
        spawn = get_context("spawn")
        self._pool = ProcessPoolExecutor(processes, spawn, _end_with_parent) if processes > 1 else None

    def close(self) -> None:
        """Let the processes go."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def run(self, jobs: Sequence[_Job]) -> dict[str, dict[str, Any]]:
        """What every job has come to, by name."""
        found = {job.name: kept for job in jobs if (kept := self._kept(job)) is not None}
        for name in found:
            self._watch(name)
        missing = [job for job in jobs if job.name not in found]
        for job, result in self._results(missing):
            if self._keep is not None:
                write_text(self._keep / f"{job.name}.json", json.dumps({"stamp": self._stamp(job), "result": result}))
            found[job.name] = result
            self._watch(job.name)
        return found

    def _results(self, jobs: Sequence[_Job]) -> Iterator[tuple[_Job, dict[str, Any]]]:
        if self._pool is None:
            yield from ((job, _run(job, self._scenario, self._budget)) for job in jobs)
            return
        waiting = {self._pool.submit(_run, job, self._scenario, self._budget): job for job in jobs}
        for future in as_completed(waiting):
            yield waiting[future], future.result()

    def _stamp(self, job: _Job) -> str:
        """What tells a part from that of another scenario, version, budget or policy."""
        told = json.dumps([*self._made_of, job.kind, job.arguments]).encode()
        return hashlib.blake2b(told, digest_size=16).hexdigest()

    def _kept(self, job: _Job) -> dict[str, Any] | None:
        """What was kept of a job; None, and it is played again, where that is nothing or cannot be what it came to."""
        path = None if self._keep is None else self._keep / f"{job.name}.json"
        if path is None or not path.is_file():
            return None
        try:
            part: _Part = validated(_Part, read_json(path, _PART_BYTES), str(path))
        except DataError:
            return None
        fits = part.stamp == self._stamp(job) and part.result.is_of(job, self._budget, self._scenario)
        return part.result.model_dump(mode="json", exclude_unset=True) if fits else None


# -- the audit --------------------------------------------------------------------------------------------------------


def audit(
    scenario: str | Path | Scenario,
    budget: str | AuditBudget = "small",
    keep: Path | None = None,
    processes: int | None = None,
    watch: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure what a scenario asks of its agents.

    Args:
        scenario: a shipped name, a path, or a loaded scenario.
        budget: one of :data:`BUDGETS`, or numbers of one's own.
        keep: folder in which results of finished parts are kept, so that a broken-off audit goes on there.
        processes: default: as many as there are cores.
        watch: called with the name of each part that has been played.

    Returns:
        Plain data: the measures of this module's table, each with ``value``, ``low`` and ``high`` (or null and a
        ``reason``), ``gates`` by name, and how it was made.

    Raises:
        DataError: no such scenario.
        ValueError: unknown budget.
    """
    spec = load_scenario(scenario)
    if isinstance(budget, str) and budget not in BUDGETS:
        raise ValueError(f"budget: known: {', '.join(BUDGETS)}; given {budget!r}")
    chosen = BUDGETS[budget] if isinstance(budget, str) else budget
    crew = _Crew(spec, chosen, keep, processes or os.cpu_count() or 1, watch or (lambda _: None))
    try:
        found = crew.run(_first_jobs(spec))
        reference = _best(found, "choose")
        found |= crew.run(_second_jobs(spec, chosen, reference, found["plan"]["plans"]))
    finally:
        crew.close()
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
        **_measures(spec, found, reference),
    }


def job_count(scenario: Scenario, budget: AuditBudget) -> int:
    """How many parts an audit has."""
    return len(_first_jobs(scenario)) + len(_second_jobs(scenario, budget, "heuristic", []))


def _first_jobs(spec: Scenario) -> list[_Job]:
    """All that needs to know nothing: the searches first, they take longest."""
    jobs = [_Job("plan", "plan", {})]
    jobs += [_Job(f"plan-without-{key}", "plan", {"without": key}) for key in spec.benches]
    for policy in _POLICIES:
        own = {"policy": policy, "split": "validation", "seed": _CHOICE_SEED}
        jobs.append(_Job(f"choose-{policy}", "play", own))
    return jobs


def _second_jobs(spec: Scenario, budget: AuditBudget, reference: str, plans: list[Any]) -> list[_Job]:
    """All that needs to know the best policy and plan."""
    jobs = [
        _Job(f"foresee-{first}", "foresee", {"first": first, "plans": plans})
        for first in range(0, budget.episodes, _CHUNK)
    ]
    jobs.append(_Job("replay", "replay", {"policy": reference}))
    test = {"split": "test", "seed": AUDIT_SEED}
    jobs += [
        _Job("random", "play", {"policy": "random", **test}),
        _Job("test", "play", {"policy": reference, "contended": True, **test}),
    ]
    jobs.append(_Job("forgetful", "play", {"policy": "forgetful", **test}))
    jobs.append(_Job("train", "play", {"policy": reference, "split": "train", "seed": AUDIT_SEED}))
    for policy in ("heuristic", "hasty"):
        jobs.append(_Job(f"blindfold-{policy}", "play", {"policy": policy, "instruments": False, **test}))
        jobs += [
            _Job(f"without-{key}-{policy}", "play", {"policy": policy, "without": key, **test}) for key in spec.benches
        ]
    if any(bench.report is not None for bench in spec.benches.values()):
        jobs.append(_Job("mute", "play", {"policy": reference, "reports": False, **test}))
    if spec.demand.order:
        jobs.append(_Job("apart", "play", {"policy": "serial", **test}))
    elif spec.orders > 1:
        jobs.append(_Job("apart", "apart", {"policy": reference}))
    return jobs


def _best(found: Mapping[str, dict[str, Any]], prefix: str) -> str:
    """Which of the policies has the best mean."""
    means = {
        name.removeprefix(f"{prefix}-"): float(np.mean(one["scores"]))
        for name, one in found.items()
        if name.startswith(f"{prefix}-") and one["scores"] is not None
    }
    return max(means, key=lambda name: means[name])


class _Scale:
    """Statistics of scores on the audit's scale, with intervals: every resample draws episodes anew, the same of
    everybody, and scales by its own random and clairvoyant ones.

    Args:
        random, clairvoyant: [E] scores of each episode.
    """

    def __init__(self, random: FloatArray, clairvoyant: FloatArray) -> None:
        draw = np.random.default_rng(0)
        n = len(random)
        self._samples = np.concatenate([np.arange(n)[None], draw.integers(n, size=(statistics.RESAMPLES, n))])
        self._zero = random[self._samples].mean(axis=1)
        self._span = np.maximum(clairvoyant[self._samples].mean(axis=1) - self._zero, 1e-9)

    def mean(self, scores: FloatArray) -> FloatArray:
        """[1 + R] normalised means: of the episodes themselves, then of every resample."""
        return np.asarray((scores[self._samples].mean(axis=1) - self._zero) / self._span)

    def deviation(self, scores: FloatArray) -> FloatArray:
        """[1 + R] standard deviations on the scale."""
        return np.asarray(scores[self._samples].std(axis=1) / self._span)


def _told(values: FloatArray) -> dict[str, Any]:
    tail = 50.0 * (1.0 - statistics.CONFIDENCE)
    low, high = np.percentile(values[1:], [tail, 100.0 - tail])
    return {"value": float(values[0]), "low": float(low), "high": float(high)}


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


def _measures(spec: Scenario, found: Mapping[str, dict[str, Any]], policy: str) -> dict[str, Any]:
    chunks = sorted((name for name in found if name.startswith("foresee-")), key=lambda n: int(n.partition("-")[2]))
    foreseen = np.concatenate([np.array(found[name]["scores"]) for name in chunks])
    curve = np.concatenate([np.array(found[name]["curves"]) for name in chunks])
    plan, test = np.array(found["plan"]["scores"]), np.array(found["test"]["scores"])
    random = np.array(found["random"]["scores"])
    # Whoever knows the world can do what the others did there.
    clairvoyant = np.maximum.reduce([foreseen, test, plan])
    scale = _Scale(random, clairvoyant)
    ways = {"replay": _scores(found, "replay"), "plan": plan, "everybody": np.array(found["plan"]["everybody"])}
    way, blind = _greatest(ways)
    blindfolded = {name: _scores(found, f"blindfold-{name}") for name in ("heuristic", "hasty")} | {"plan": plan}
    reference = scale.mean(test)
    measures: dict[str, Any] = {
        "random": {**_told(scale.mean(random)), "score": float(random.mean())},
        "reference": {**_told(reference), "score": float(test.mean())},
        "blind": {
            **_told(scale.mean(blind)),
            "score": float(blind.mean()),
            "way": way,
            "ways": {name: float(scale.mean(scores)[0]) for name, scores in ways.items() if scores is not None},
        },
        "clairvoyant": {
            **_told(scale.mean(clairvoyant)),
            "score": float(clairvoyant.mean()),
            "curve": [float(scale.mean(np.maximum.reduce([column, test, plan]))[0]) for column in curve.T],
        },
        "worth_of_measuring": _worth(reference, scale, blindfolded)
        if spec.instruments
        else _untold("the scenario has no instruments"),
        "worth_of_bench": {
            key: _worth(
                reference,
                scale,
                {name: _scores(found, f"without-{key}-{name}") for name in ("heuristic", "hasty")}
                | {"plan": _scores(found, f"plan-without-{key}")},
            )
            for key in spec.benches
        },
        "worth_of_memory": _untold("the scripted manager has nothing to forget"),
        "coordination": _untold("there is one order"),
        "worth_of_reports": _untold("benches report nothing"),
        "contention": _contention(found),
        "headroom": _told(1.0 - reference),
        "generalization": _told(reference - scale.mean(np.array(found["train"]["scores"])))
        if spec.world.draws
        else _untold("the scenario draws no world"),
        "noise": _told(scale.deviation(plan)),
    }
    forgetful = _scores(found, "forgetful")
    if forgetful is not None:
        measures["worth_of_memory"] = _told(reference - scale.mean(forgetful))
    mute, apart = _scores(found, "mute"), _scores(found, "apart")
    if mute is not None:
        measures["worth_of_reports"] = _told(reference - scale.mean(mute))
    if apart is not None:
        measures["coordination"] = _told(reference - scale.mean(apart))
    elif spec.orders > 1:
        measures["coordination"] = _untold("nobody that comes along takes one order at a time")
    return {**measures, "gates": _gates(spec, measures)}


def _contention(found: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """What was contended for in an episode of the reference: all kinds together, and by kind."""
    counts = np.array(found["test"]["contention"])
    draw = np.random.default_rng(0).integers(len(counts), size=(statistics.RESAMPLES, len(counts)))
    means = counts.sum(axis=1)[draw].mean(axis=1)
    told = _told(np.concatenate([[counts.sum(axis=1).mean()], means]))
    return {**told, "kinds": dict(zip(CONTENDED, counts.mean(axis=0).tolist(), strict=True))}


def _worth(reference: FloatArray, scale: _Scale, others: Mapping[str, FloatArray | None]) -> dict[str, Any]:
    """The reference less the best of those that do without something."""
    name, scores = _greatest(others)
    return {**_told(reference - scale.mean(scores)), "without": name}


def _gates(spec: Scenario, measures: Mapping[str, Any]) -> dict[str, bool | None]:
    """Which of :data:`GATES` are met; None where one does not apply."""
    measuring, noise = measures["worth_of_measuring"], measures["noise"]["value"]
    coordination = measures["coordination"]["value"]
    met = measuring["value"] is not None and measuring["value"] >= 0.1 and measuring["low"] > 0.0
    return {
        "blind": bool(measures["blind"]["value"] <= 0.5 * measures["reference"]["value"]),
        "measuring": bool(met),
        "benches": all(worth["value"] >= 0.1 for worth in measures["worth_of_bench"].values()),
        "coordination": None if coordination is None else bool(coordination >= 0.1),
        "headroom": bool(measures["headroom"]["value"] >= 0.15),
        "noise": bool(noise > 0.1),
    }


def measure_rows(found: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """An audit's measures in words: name, value with its interval (or why there is none), and whose it is."""
    for name, measure in found.items():
        if isinstance(measure, dict) and "value" in measure:
            said = measure["reason"] if measure["value"] is None else statistics.interval_text(measure)
            yield name.replace("_", " "), said, measure.get("way") or measure.get("without") or ""
        elif name == "worth_of_bench":
            yield from (
                (f"worth of {key}", statistics.interval_text(own), own["without"]) for key, own in measure.items()
            )


def verdict(found: Mapping[str, Any]) -> str:
    """An audit's gates as a sentence."""
    failed = [name for name, met in found["gates"].items() if met is False]
    if not failed:
        return f"{found['scenario']}: every gate is met"
    if "blind" in failed:
        return f"{found['scenario']}: a blind plan does; not met: {', '.join(failed)}"
    return f"{found['scenario']}: not met: {', '.join(failed)}"
