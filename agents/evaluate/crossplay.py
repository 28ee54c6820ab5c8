"""Zero-shot coordination with unseen partners (``chemlab crossplay``): every manager plays with every set of benches.

A policy may adapt to the partners of its training rather than to the laboratory. Each policy is therefore scored with
these partners and with unseen ones: scripted, unsafe, epsilon-random, or trained with other seeds and algorithms. The
gap is the score with the partner of training minus the mean score with unseen partners (the focal and background
populations of Melting Pot: Leibo et al. 2021, Agapiou et al. 2022). Weak partners lower every score; the gap of the
scripted agents, which were written for one another, is a reference.

Episodes, worlds and scale are those of :mod:`~chemlab.agents.evaluate.benchmark`: 0 is random legal play, 1 the
best score of each episode, usually the oracle's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.scenario import MANAGER_AGENT, Scenario
from chemlab.envs.players import Policy
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories
from chemlab.record import scenario_hash

from ..former_names import current_name, split_way
from ..policies import agent_policy, make_policies, policy_names
from ..roles import MANAGER_ROLE
from ..runs import Run, find_runs
from ..saved import find_saved, is_saved
from .benchmark import provenance, reference_jobs
from .jobs import AUDIT_SEED, AuditBudget, Job, JobRunner, budget_of, foreseen, planner_jobs
from .scale import Scale, interval

PARTNERS = ("scripted", "scripted:unsafe", "scripted@0.1")
"""Default policies of a side: scripted, unsafe, epsilon-random."""
_EQUIVALENT = {
    MANAGER_ROLE: dict.fromkeys(("pretrained", "pretrained-isolated"), "scripted"),
    "benches": dict.fromkeys(("scripted:no-extraction", "scripted:memoryless", "scripted:fifo", "plan"), "scripted"),
}
"""Names of policies that differ on the other side only, and the equal policy of this side, by side."""


@dataclass(frozen=True)
class Player:
    """A policy of one side of the laboratory.

    Attributes:
        name: name of the policy.
        policy: name of the policy that is played, or path of its checkpoint.
        partner: policy of the other side in training, or for which the policy was written; None: there is none.
    """

    name: str
    policy: str
    partner: str | None = None


def find_players(
    scenario: Scenario, managers: Sequence[str], benches: Sequence[str]
) -> tuple[list[Player], list[Player]]:
    """Return the managers and the sets of benches of policies by name or path, and the partners of their training.

    Args:
        scenario: the scenario.
        managers, benches: names or paths, see :func:`~chemlab.agents.policies.make_policies`; a folder of runs stands
            for all runs in it.

    Raises:
        ValueError: a policy is unknown, given twice, has none for its side, or does not fit the scenario.
    """
    labs = Laboratories(scenario)
    names = {MANAGER_ROLE: managers, "benches": benches}
    sides: dict[str, list[Player]] = {side: [] for side in names}
    for side, given in names.items():
        for name in (one for folder in given for one in _runs_of(current_name(folder))):
            player = _player(name, labs, side)
            if any(_origin(player.policy) == _origin(other.policy) for other in sides[side]):
                raise ValueError(f"{side}: {name}: given twice")
            sides[side].append(player)
    # Partners of training are added until no partner is missing, because they have partners in turn.
    missing = True
    while missing:
        missing = False
        for side, other in ((MANAGER_ROLE, "benches"), ("benches", MANAGER_ROLE)):
            for name in [player.partner for player in sides[other] if player.partner is not None]:
                if all(_origin(name) != _origin(player.policy) for player in sides[side]):
                    sides[side].append(_player(name, labs, side))
                    missing = True
    for manager in sides[MANAGER_ROLE]:
        for team in sides["benches"]:
            make_policies(_team_policy(manager, team), labs)
    return sides[MANAGER_ROLE], sides["benches"]


def _runs_of(name: str) -> list[str]:
    """Return the paths of the runs in a folder; any other name is returned as it is."""
    folder = Path(name)
    runs = find_runs(folder) if folder.is_dir() and folder.parent.name != "checkpoints" else []
    return [str(run.path) for run in runs] or [name]


def _player(name: str, labs: Laboratories, side: str) -> Player:
    """Return the player of a policy by name; raise ValueError if it has no policy for this side, or none that fits."""
    if side == MANAGER_ROLE and "," in name:
        raise ValueError(f"{side}: {name!r}: give one policy; benches are given with --benches")
    policies = _policies(name, labs, side)
    equivalent = _on_side(name, labs, side)
    if equivalent != name:
        raise ValueError(f"{side}: {name} has no policy for this side: it plays as {equivalent!r}; give this name")
    run = Run(Path(name))
    checkpoint = None if run.config() is None else run.checkpoint("best") or run.checkpoint("last")
    backgrounds = {policy.card.background for policy in policies if hasattr(policy, "card")}
    return Player(name, str(checkpoint or name), _partner(name, backgrounds, labs, side))


def _policies(name: str, labs: Laboratories, side: str) -> list[Policy]:
    """Return the policies of a side's agents; raise ValueError if the name is unknown, or one does not fit."""
    numbers = [role.index for role in ([labs.manager] if side == MANAGER_ROLE else labs.bench_roles)]
    return [agent_policy(name, labs, number) for number in numbers]


def _partner(name: str, backgrounds: set[str | None], labs: Laboratories, side: str) -> str | None:
    """Return the partner of training, or None; ``backgrounds`` are those of the policies' cards."""
    other = "benches" if side == MANAGER_ROLE else MANAGER_ROLE
    if name == "scripted":
        return name
    saved = find_saved(name) if name not in policy_names() and is_saved(name) else None
    if saved is not None and _has(saved.load, labs, other):
        return name
    if saved is not None and not backgrounds:
        backgrounds = {saved.background}
    known = sorted(background for background in backgrounds if background is not None)
    # Epsilon-random policies, and policies with exceptions, differ from the trained ones.
    trained = saved is not None or name in policy_names()
    if not trained or len(known) != 1:
        return None
    _policies(known[0], labs, other)  # raises an error if a run is its own background, instead of endless recursion
    return _on_side(known[0], labs, other)


def _on_side(name: str, labs: Laboratories, side: str) -> str:
    """Return the name of the policy that plays on one side if ``name`` is given for all roles."""
    general, *exceptions = name.split(",")
    of_manager = [text for text in exceptions if text.partition("=")[0] in (MANAGER_ROLE, MANAGER_AGENT)]
    if side == MANAGER_ROLE:
        chosen, kept = of_manager[-1].partition("=")[2] if of_manager else general, []
    else:
        chosen, kept = general, [text for text in exceptions if text not in of_manager]
    base, at, share = chosen.rpartition("@")
    if at and not is_saved(chosen):
        chosen = f"{_on_side(base, labs, side)}@{share}"
    elif chosen in policy_names():
        if chosen == "trained" and side == "benches":
            chosen = agent_policy(chosen, labs, 0).card.background or "scripted"  # type: ignore[attr-defined]
        chosen = _EQUIVALENT[side].get(chosen, chosen)
    elif is_saved(chosen):
        saved = find_saved(chosen)
        chosen = chosen if _has(saved.load, labs, side) else _on_side(saved.background, labs, side)
    return ",".join([chosen, *kept])


def _has(roles: Collection[str], labs: Laboratories, side: str) -> bool:
    """Return True if any of the roles is on a side."""
    return MANAGER_ROLE in roles if side == MANAGER_ROLE else any(key in roles for key in labs.scenario.benches)


def _origin(policy: str) -> str:
    """Return the identity of a policy: its name, or the path of its run for all checkpoints of the run."""
    policy, _ = split_way(policy)
    path = Path(policy)
    if not path.exists():
        return policy
    path = path.resolve()
    return str(next((parent.parent for parent in (path, *path.parents) if parent.name == "checkpoints"), path))


def _team_policy(manager: Player, benches: Player) -> str:
    """Return the name of a cell's policy for :func:`~chemlab.agents.policies.make_policies`."""
    return f"{benches.policy},{MANAGER_ROLE}={manager.policy}"


def _cell_job(policy: str, split: str) -> Job:
    name = hashlib.blake2b(policy.encode(), digest_size=8).hexdigest()
    return Job(f"cross-{name}", "play", {"policy": policy, "split": split, "seed": AUDIT_SEED})


def crossplay_count(managers: Sequence[Player], benches: Sequence[Player], budget: AuditBudget, split: str) -> int:
    """Return the number of jobs of :func:`crossplay`."""
    return len(reference_jobs(split)) + len(planner_jobs(budget, [], split)) + len(managers) * len(benches)


def crossplay(
    scenario: Scenario,
    managers: Sequence[Player],
    benches: Sequence[Player],
    budget: str | AuditBudget = "small",
    split: str = "test",
    keep: Path | None = None,
    executor: Executor | None = None,
    watch: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Play every manager with every set of benches.

    Args:
        scenario: the laboratory.
        managers, benches: players of both sides, see :func:`find_players`.
        budget, split, executor, watch: as for :func:`~chemlab.agents.evaluate.benchmark.benchmark`.
        keep: folder of cached results; an audit's or a benchmark's folder of this scenario has those of the scale.

    Returns:
        Plain data: ``managers`` and ``benches``; ``cells`` (manager, benches, policy for ``chemlab run``, whether they
        were trained together, raw score, normalized score with interval); ``gaps`` of all players with scores for the
        partner of training and for unseen partners; settings and versions.

    Raises:
        ValueError: the budget is unknown, a policy does not fit, or no score is above random play.
    """
    chosen = budget_of(budget)
    runner = JobRunner(scenario, chosen, keep, executor, watch)
    jobs = {(m.name, b.name): _cell_job(_team_policy(m, b), split) for m in managers for b in benches}
    results = runner.run([*reference_jobs(split), *jobs.values()])
    results |= runner.run(planner_jobs(chosen, results["plan"]["plans"], split))
    scores: dict[tuple[str, str], FloatArray] = {}
    for pair, job in jobs.items():
        if results[job.name]["scores"] is None:
            raise ValueError(f"{' with '.join(pair)}: {results[job.name]['reason']}")
        scores[pair] = np.array(results[job.name]["scores"])
    random, plan = (np.array(results[name]["scores"]) for name in ("random", "plan"))
    # A planner that knows the hidden parameters could play what any other policy played.
    oracle = np.maximum.reduce([foreseen(results), random, plan, *scores.values()])
    scale = Scale(random, oracle)
    if scale.span <= 0.0:
        raise ValueError(f"{scenario.name}: no policy scores above random legal play ({random.mean():.3f}): no scale")
    scaled = {pair: scale.mean(values) for pair, values in scores.items()}
    return {
        "kind": "crossplay",
        "format": 1,
        "scenario": scenario.name,
        "scenario_hash": scenario_hash(scenario),
        **provenance(budget, chosen, split),
        "random": float(random.mean()),
        "oracle": float(oracle.mean()),
        "managers": [vars(player) for player in managers],
        "benches": [vars(player) for player in benches],
        "cells": [
            {
                "manager": m.name,
                "benches": b.name,
                "policy": _team_policy(m, b),
                "together": _trained_with(m, b) or _trained_with(b, m),
                "score": float(scores[m.name, b.name].mean()),
                **interval(scaled[m.name, b.name]),
            }
            for m in managers
            for b in benches
        ],
        "gaps": [
            *_gaps(MANAGER_ROLE, managers, benches, scaled),
            *_gaps("benches", benches, managers, {(b, m): values for (m, b), values in scaled.items()}),
        ],
    }


def _trained_with(player: Player, other: Player) -> bool:
    """Return True if ``other`` is the player's partner of training."""
    return player.partner is not None and _origin(player.partner) == _origin(other.policy)


def _gaps(
    side: str, players: Sequence[Player], others: Sequence[Player], scaled: dict[tuple[str, str], FloatArray]
) -> Iterator[dict[str, Any]]:
    """Yield the gap of each player of a side; ``scaled`` has normalized scores by (player, other)."""
    for player in players:
        with_partner = [scaled[player.name, other.name] for other in others if _trained_with(player, other)]
        strangers = [other for other in others if not _trained_with(player, other)]
        unseen = [one for one in strangers if player.partner is None or _origin(player.policy) != _origin(one.policy)]
        if with_partner and unseen:
            with_unseen = np.mean([scaled[player.name, other.name] for other in unseen], axis=0)
            yield {
                "side": side,
                "policy": player.name,
                "partner": player.partner,
                "unseen": [other.name for other in unseen],
                "with_partner": interval(with_partner[0]),
                "with_unseen": interval(with_unseen),
                "gap": interval(with_partner[0] - with_unseen),
            }
