"""Jobs of audits and benchmarks, with cached results: an interrupted command resumes with the missing jobs."""

from __future__ import annotations

import functools
import hashlib
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.datafile import DataError, read_json
from chemlab.config.files import write_text
from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories
from chemlab.record import scenario_hash

from ..episodes import play_laboratory
from ..executors import Inline, completed
from ..open_loop import Context, all_contexts
from ..policies import make_policies, policy_files, scripted_manager
from ..runs import versions
from .contention import Contention
from .informed import informed_scores
from .plans import FoundPlan, PlanSearch, TeamPlan, replay_actions
from .search import best_in_episode, search_plan

AUDIT_SEED = 4_000_000
"""Seed of the first scored episode; training and searches use other seeds."""
_NO_BUDGET = 1e-9
_CHUNK = 10
"""Number of episodes of one oracle job."""
_WORLDS_PER_PLAN = 8
"""Training worlds of a controller for each plan in its library."""
_CURVE_POINTS = 10
"""Number of points of the oracle's budget curve."""
_PART_BYTES = 10_000_000
"""Maximum size of a cached result; that of 200 episodes has about 0.1 MB."""


@dataclass(frozen=True)
class AuditBudget:
    """Numbers of episodes and plans.

    Attributes:
        episodes: number of scored episodes of each policy.
        plans: plans tried in the search for the best open-loop plan.
        fewer: plans tried in the searches without one of the benches.
        donors: number of donor episodes for replays, for each public context.
        planned: plans that the oracle tries in each episode.
        turns: training turns of each adversarial learner; 0: no learners.
        worlds: training worlds of the controllers that choose among plans; 0: no such controllers.
    """

    episodes: int
    plans: int
    fewer: int
    donors: int
    planned: int
    turns: int = 0
    worlds: int = 0


BUDGETS = {
    "small": AuditBudget(40, plans=800, fewer=200, donors=10, planned=100, worlds=64),
    "full": AuditBudget(200, plans=40_000, fewer=4_000, donors=20, planned=1_500, turns=1_000_000, worlds=512),
}
"""``small``: no learners; 117 s of one core for a scenario of one order (``tests/agents/cold.toml``)."""


def budget_of(budget: str | AuditBudget, turns: int | None = None) -> AuditBudget:
    """Return a budget, given itself or by its name in :data:`BUDGETS`; ``turns`` replaces the turns of learners.

    Raises:
        ValueError: the name is unknown, or ``turns`` is negative.
    """
    if isinstance(budget, str) and budget not in BUDGETS:
        raise ValueError(f"budget: known: {', '.join(BUDGETS)}; given {budget!r}")
    if turns is not None and turns < 0:
        raise ValueError(f"turns: must be at least 0, given {turns}")
    chosen = BUDGETS[budget] if isinstance(budget, str) else budget
    return chosen if turns is None else replace(chosen, turns=turns)


@dataclass(frozen=True)
class Job:
    """A unit of work with a cached result.

    Attributes:
        name: name of the result.
        kind: key of a function in ``_KINDS``.
        arguments: arguments of the function, besides scenario and budget.
    """

    name: str
    kind: str
    arguments: dict[str, Any]


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
    """Score a policy by name; the scores are None if none fits.

    ``without`` replaces its manager by a scripted one that does not use this bench. ``contended`` counts contention.
    The default number of episodes is the budget's.
    """
    if not reports:
        mute = {key: bench.model_copy(update={"report": None}) for key, bench in scenario.benches.items()}
        scenario = scenario.model_copy(update={"benches": mute})
    if not instruments:
        scenario = without_instruments(scenario)
    try:
        labs = Laboratories(scenario, budget.episodes if episodes is None else episodes, split=split)
        with warnings.catch_warnings():
            if not (instruments and reports):  # these scenarios differ from those of training on purpose
                warnings.simplefilter("ignore", UserWarning)
            policies = make_policies(policy, labs)
        if without:
            policies[MANAGER_AGENT] = scripted_manager(labs, policy != "scripted:unsafe", [without])
        counter = Contention(policies[MANAGER_AGENT], labs) if contended else None
        policies[MANAGER_AGENT] = counter or policies[MANAGER_AGENT]
        scores = {"scores": play_laboratory(labs, policies, None, seed).returns.tolist()}
        return scores if counter is None else {**scores, "contention": counter.events().tolist()}
    except ValueError as error:
        return {"scores": None, "reason": str(error)}


def _plan(scenario: Scenario, budget: AuditBudget, without: str = "", split: str = "test") -> dict[str, Any]:
    """Search for the best open-loop manager in training worlds, and score it.

    With all benches, it is also scored with the benches' actions of a donor's episode.
    """
    plans = budget.fewer if without else budget.plans
    search = search_plan(scenario, budget=plans, without=[without] if without else ())
    chosen = [one.score for one in search.found]
    found: dict[str, Any] = {"scores": search.play(budget.episodes, AUDIT_SEED, split).tolist(), "chosen": chosen}
    if not without:
        found["plans"] = [[list(context), list(plan)] for context, plan in search.plans.items()]
        found["everybody"] = _replay(scenario, budget, search, split)["scores"]
    return found


def _everybody(scenario: Scenario, budget: AuditBudget) -> dict[str, Any]:
    """Search for the best open-loop policy of all agents in training worlds, and score it."""
    search = search_plan(scenario, budget=budget.plans, free=True)
    teams = [[list(one.context), *one.team.as_list()] for one in search.found]
    chosen = [one.score for one in search.found]
    return {"scores": search.play(budget.episodes, AUDIT_SEED, "test").tolist(), "teams": teams, "chosen": chosen}


def _idle(scenario: Scenario, budget: AuditBudget) -> dict[str, Any]:
    """Score the policy that submits the first vessel for the first order, and so on, without any experiment."""
    nothing = [FoundPlan(context, TeamPlan(()), 0.0) for context in all_contexts(scenario)]
    return {"scores": PlanSearch(scenario, "scripted", nothing, 0).play(budget.episodes, AUDIT_SEED, "test").tolist()}


def without_instruments(scenario: Scenario) -> Scenario:
    """Return a scenario without a budget for measurements; free instruments remain available."""
    return scenario.model_copy(update={"limits": scenario.limits.model_copy(update={"budget": _NO_BUDGET})})


def _learn(scenario: Scenario, budget: AuditBudget, instruments: bool, plans: list[Any]) -> dict[str, Any]:
    """Train a team, from nothing or from the last open-loop policy of each context, and score it."""
    from .adversary import learned_scores  # needs PyTorch

    spec = scenario if instruments else without_instruments(scenario)
    begin = {context: teams[-1] for context, teams in _known(plans).items()}
    return {"scores": learned_scores(spec, budget.turns, budget.episodes, AUDIT_SEED, begin or None)}


def _inform(scenario: Scenario, budget: AuditBudget, opening: str, plans: list[Any]) -> dict[str, Any]:
    """Score controllers without instruments that choose among plans by all agents' or the manager's observations."""
    library = max(budget.worlds // _WORLDS_PER_PLAN, 1)
    sizes = budget.worlds, library, budget.planned, budget.episodes
    found = informed_scores(without_instruments(scenario), opening, _known(plans), *sizes, AUDIT_SEED)
    if found is None:
        return {"scores": None, "reason": "the best plan has one submission"}
    return {"scores": found[0], "feedback": found[1]}


def _known(plans: list[Any]) -> dict[Context, list[TeamPlan]]:
    """Return open-loop policies by context, from lists [context, plan] or [context, plan, tapes of the benches]."""
    known: dict[Context, list[TeamPlan]] = {}
    for context, plan, *benches in plans:
        known.setdefault(tuple(context), []).append(TeamPlan.of([plan, *(benches or [()])]))
    return known


def _replay(scenario: Scenario, budget: AuditBudget, policy: str | PlanSearch, split: str = "test") -> dict[str, Any]:
    """Score actions replayed from the best donor's episode."""
    scores = replay_actions(scenario, policy, budget.donors, budget.episodes, AUDIT_SEED, split=split)
    return {"scores": scores.tolist()}


def _foresee(
    scenario: Scenario, budget: AuditBudget, first: int, plans: list[Any], split: str = "test"
) -> dict[str, Any]:
    """Search for the best plan of each of ``_CHUNK`` episodes; ``curves``: best scores after tenths of the budget."""
    known = _known(plans)
    scores, curves = [], []
    for episode in range(first, min(first + _CHUNK, budget.episodes)):
        score, curve = best_in_episode(scenario, AUDIT_SEED + episode, split, budget.planned, known)
        scores.append(score)
        limits = [max(k * budget.planned / _CURVE_POINTS, curve[0][0]) for k in range(1, _CURVE_POINTS + 1)]
        curves.append([max(best for tried, best in curve if tried <= limit) for limit in limits])
    return {"scores": scores, "curves": curves}


def _apart(scenario: Scenario, budget: AuditBudget, policy: str) -> dict[str, Any]:
    """Return the mean over orders of the score of each order in a separate laboratory."""
    labs = Laboratories(scenario, budget.episodes, split="test")
    labs.begin(AUDIT_SEED)
    goals = np.array(scenario.goals)[labs.state.goal]
    single = _with_one_order(scenario)
    scores = np.zeros(goals.shape)
    for goal in np.unique(goals):
        labs = Laboratories(single, budget.episodes, split="test")
        returns = play_laboratory(labs, make_policies(policy, labs), str(goal), AUDIT_SEED).returns
        scores += (goals == goal) * returns[:, None]
    return {"scores": scores.mean(axis=1).tolist()}


def _with_one_order(scenario: Scenario) -> Scenario:
    """Return the scenario with one order. An order then pays n times as much, so all prices are multiplied by n."""

    def dearer(model: Any, *prices: str, **others: Any) -> Any:
        return model.model_copy(update={name: scenario.orders * getattr(model, name) for name in prices} | others)

    instruments = {
        name: dearer(spec, "price", drift=spec.drift and dearer(spec.drift, "price"))
        for name, spec in scenario.instruments.items()
    }
    benches = {k: dearer(b, wear=b.wear and dearer(b.wear, "repair_price")) for k, b in scenario.benches.items()}
    stock = {name: scenario.orders * price for name, price in scenario.costs.stock_per_mol.items()}
    costs = dearer(scenario.costs, "waste_per_l", "tick", "illegal_action", stock_per_mol=stock)
    safety, limits = dearer(scenario.safety, "reward_price"), dearer(scenario.limits, "budget")
    prices = {"benches": benches, "instruments": instruments, "costs": costs, "safety": safety, "limits": limits}
    return scenario.model_copy(update={"orders": 1, **prices})


_KINDS: dict[str, Callable[..., dict[str, Any]]] = {
    "play": _play,
    "plan": _plan,
    "everybody": _everybody,
    "idle": _idle,
    "learn": _learn,
    "inform": _inform,
    "replay": _replay,
    "foresee": _foresee,
    "apart": _apart,
}


def planner_jobs(budget: AuditBudget, plans: list[Any], split: str = "test") -> list[Job]:
    """Return the jobs of the planner that knows the hidden parameters of each episode.

    Args:
        budget: numbers of episodes and of plans tried in each.
        plans: initial plans of the search: [context, plan] or [context, plan, tapes of the benches].
        split: split of the worlds.
    """
    other = {} if split == "test" else {"split": split}
    firsts = range(0, budget.episodes, _CHUNK)
    return [Job(f"foresee-{first}", "foresee", {"first": first, "plans": plans, **other}) for first in firsts]


def foreseen(found: Mapping[str, dict[str, Any]], what: str = "scores") -> FloatArray:
    """Return the oracle's ``scores`` [E] or ``curves`` [E, points] from the results of jobs."""
    names = [name for name in found if name.startswith("foresee-")]
    order = sorted(names, key=lambda name: int(name.partition("-")[2]))
    return np.concatenate([np.array(found[name][what]) for name in order])


def _file_name(job: Job) -> str:
    return f"{job.name.replace(':', '_')}.json"


def _run(job: Job, scenario: Scenario, budget: AuditBudget) -> dict[str, Any]:
    return _KINDS[job.kind](scenario, budget, **job.arguments)


def _policy_hash(job: Job) -> str:
    """Return a hash of the files from which a job's policy is loaded."""
    combined = hashlib.blake2b(digest_size=16)
    for file in policy_files(job.arguments.get("policy", "scripted")):
        combined.update(hashlib.blake2b(file.read_bytes()).digest())
    return combined.hexdigest()


class JobRunner:
    """Executes jobs of a scenario and caches their results.

    Args:
        scenario: the scenario.
        budget: numbers of episodes and plans.
        keep: folder of cached results; None: results are not stored.
        executor: executor of the jobs (:mod:`chemlab.agents.executors`); None: this process.
        watch: called with the name of each finished job.
    """

    def __init__(
        self,
        scenario: Scenario,
        budget: AuditBudget,
        keep: Path | None = None,
        executor: Executor | None = None,
        watch: Callable[[str], None] | None = None,
    ) -> None:
        self._scenario, self._budget, self._keep, self._watch = scenario, budget, keep, watch or (lambda _: None)
        self._inputs = [scenario_hash(scenario), vars(budget), versions()]
        self._executor = executor or Inline()

    def run(self, jobs: Sequence[Job]) -> dict[str, dict[str, Any]]:
        """Return the result of every job, by name."""
        # Hashes of the files before the jobs, which may take long.
        hashes = {job.name: _policy_hash(job) for job in jobs} if self._keep is not None else {}
        found = {job.name: cached for job in jobs if (cached := self.cached(job)) is not None}
        for name in found:
            self._watch(name)
        missing = [job for job in jobs if job.name not in found]
        run = functools.partial(_run, scenario=self._scenario, budget=self._budget)
        for job, result in completed(self._executor, run, missing):
            if self._keep is not None:
                part = {"stamp": self._stamp(job, hashes[job.name], result), "result": result}
                write_text(self._keep / _file_name(job), json.dumps(part))
            found[job.name] = result
            self._watch(job.name)
        return found

    def _stamp(self, job: Job, policy: str, result: dict[str, Any]) -> str:
        """Return a hash of the scenario, budget, versions, arguments, policy files and result of a job."""
        text = json.dumps([*self._inputs, job.kind, job.arguments, policy, result])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def cached(self, job: Job) -> dict[str, Any] | None:
        """Return the cached result of a job; None if there is none, or it is of other inputs or damaged."""
        path = None if self._keep is None else self._keep / _file_name(job)
        if path is None or not path.is_file():
            return None
        try:
            part = read_json(path, _PART_BYTES)
        except DataError:
            return None
        result = part.get("result") if isinstance(part, dict) else None
        known = isinstance(result, dict) and part.get("stamp") == self._stamp(job, _policy_hash(job), result)
        return result if known else None
