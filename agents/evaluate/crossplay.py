"""Zero-shot coordination with unseen partners (``chemlab crossplay``): every manager plays with every set of benches.

A policy trained with others may have adapted to them rather than to the laboratory. So each is scored with its partners
of training and with unseen ones: scripted, unsafe, epsilon-random, or trained with other seeds and algorithms. The gap
is the score with its own partners minus the mean over the others (the focal and background populations of Melting Pot:
Leibo et al. 2021, Agapiou et al. 2022). Weak partners lower every score; the gap of the scripted agents, which were
written for one another, is given for comparison.

Episodes, worlds and scale are those of :mod:`~chemlab.agents.evaluate.benchmark`: 0 is random legal play, 1 the
best score of each episode, usually the oracle's.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
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
from .jobs import AUDIT_SEED, AuditBudget, Crew, Job, budget_of, foreseen, planner_jobs
from .scale import Scale, interval

PARTNERS = ("scripted", "scripted:unsafe", "scripted@0.1")
"""Default policies of a side: scripted, unsafe, epsilon-random."""
_ELSEWHERE = {
    MANAGER_ROLE: dict.fromkeys(("pretrained", "pretrained-isolated"), "scripted"),
    "benches": dict.fromkeys(("scripted:no-extraction", "scripted:memoryless", "scripted:fifo", "plan"), "scripted"),
}
"""By side, names that are about the other one, and whom they stand for here."""


@dataclass(frozen=True)
class Player:
    """A policy of one side of the laboratory.

    Attributes:
        name: what it is called.
        policy: what is played: a name, or a checkpoint's path.
        partner: the policy that had the other side when it learned, or for which it was written; None where there was
            none.
    """

    name: str
    policy: str
    partner: str | None = None


# -- who plays --------------------------------------------------------------------------------------------------------


def find_players(
    scenario: Scenario, managers: Sequence[str], benches: Sequence[str]
) -> tuple[list[Player], list[Player]]:
    """The managers, and the sets of benches, that policies by name or path stand for; and the partners with whom those
    of the other side have learned, where they are not named.

    Args:
        scenario: where they are to play.
        managers, benches: names or paths, see :func:`~chemlab.agents.policies.make_policies`; a folder of runs is all
            of them.

    Raises:
        ValueError: unknown, given twice, without a policy for its side, or one that does not fit the scenario.
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
    # Partners may have learned with others in turn.
    missing = True
    while missing:
        missing = False
        for side, other in ((MANAGER_ROLE, "benches"), ("benches", MANAGER_ROLE)):
            for name in [player.partner for player in sides[other] if player.partner is not None]:
                if all(_origin(name) != _origin(player.policy) for player in sides[side]):
                    sides[side].append(_player(name, labs, side))
                    missing = True
    for manager in sides[MANAGER_ROLE]:
        for crew in sides["benches"]:
            make_policies(_together(manager, crew), labs)
    return sides[MANAGER_ROLE], sides["benches"]


def _runs_of(name: str) -> list[str]:
    """A folder's runs; whatever else it is, itself."""
    folder = Path(name)
    runs = find_runs(folder) if folder.is_dir() and folder.parent.name != "checkpoints" else []
    return [str(run.path) for run in runs] or [name]


def _player(name: str, labs: Laboratories, side: str) -> Player:
    if side == MANAGER_ROLE and "," in name:
        raise ValueError(f"{side}: {name!r}: give one policy; benches are given with --benches")
    policies = _policies(name, labs, side)
    meant = _on_side(name, labs, side)
    if meant != name:
        raise ValueError(f"{side}: {name} has none of its own: there it stands for {meant!r}; give that")
    run = Run(Path(name))
    checkpoint = None if run.config() is None else run.checkpoint("best") or run.checkpoint("last")
    backgrounds = {policy.card.background for policy in policies if hasattr(policy, "card")}
    return Player(name, str(checkpoint or name), _partner(name, backgrounds, labs, side))


def _policies(name: str, labs: Laboratories, side: str) -> list[Policy]:
    """Those of a side's agents.

    Raises:
        ValueError: there are none of that name, or they do not fit.
    """
    numbers = [role.index for role in ([labs.manager] if side == MANAGER_ROLE else labs.bench_roles)]
    return [agent_policy(name, labs, number) for number in numbers]


def _partner(name: str, backgrounds: set[str | None], labs: Laboratories, side: str) -> str | None:
    """Return the policy of the other side during training; ``backgrounds`` are those of the policies' cards."""
    other = "benches" if side == MANAGER_ROLE else MANAGER_ROLE
    if name == "scripted":
        return name
    saved = find_saved(name) if name not in policy_names() and is_saved(name) else None
    if saved is not None and _has(saved.load, labs, other):
        return name
    if saved is not None and not backgrounds:
        backgrounds = {saved.background}
    known = sorted(background for background in backgrounds if background is not None)
    # An epsilon-random one, or one with exceptions, is not what has learned.
    whole = saved is not None or name in policy_names()
    if not whole or len(known) != 1:
        return None
    _policies(known[0], labs, other)  # which ends: a run may name itself as its own background
    return _on_side(known[0], labs, other)


def _on_side(name: str, labs: Laboratories, side: str) -> str:
    """Return the policy of one side if ``name`` is given for all roles."""
    general, *exceptions = name.split(",")
    of_manager = [text for text in exceptions if text.partition("=")[0] in (MANAGER_ROLE, MANAGER_AGENT)]
    if side == MANAGER_ROLE:
        own, kept = of_manager[-1].partition("=")[2] if of_manager else general, []
    else:
        own, kept = general, [text for text in exceptions if text not in of_manager]
    steady, at, share = own.rpartition("@")
    if at and not is_saved(own):
        own = f"{_on_side(steady, labs, side)}@{share}"
    elif own in policy_names():
        if own == "trained" and side == "benches":
            own = agent_policy(own, labs, 0).card.background or "scripted"  # type: ignore[attr-defined]
        own = _ELSEWHERE[side].get(own, own)
    elif is_saved(own):
        saved = find_saved(own)
        own = own if _has(saved.load, labs, side) else _on_side(saved.background, labs, side)
    return ",".join([own, *kept])


def _has(roles: Any, labs: Laboratories, side: str) -> bool:
    """Return whether any of the roles is on that side."""
    return MANAGER_ROLE in roles if side == MANAGER_ROLE else any(key in roles for key in labs.scenario.benches)


def _origin(policy: str) -> str:
    """Return the identity of a player: the run for any of its checkpoints."""
    policy, _ = split_way(policy)
    path = Path(policy)
    if not path.exists():
        return policy
    path = path.resolve()
    return str(next((parent.parent for parent in (path, *path.parents) if parent.name == "checkpoints"), path))


def _together(manager: Player, benches: Player) -> str:
    """A cell's policy, as :func:`~chemlab.agents.policies.make_policies` knows it."""
    return f"{benches.policy},{MANAGER_ROLE}={manager.policy}"


# -- what is played ---------------------------------------------------------------------------------------------------


def _cell_job(policy: str, split: str) -> Job:
    name = hashlib.blake2b(policy.encode(), digest_size=8).hexdigest()
    return Job(f"cross-{name}", "play", {"policy": policy, "split": split, "seed": AUDIT_SEED})


def crossplay_count(managers: Sequence[Player], benches: Sequence[Player], budget: AuditBudget, split: str) -> int:
    """Return the number of parts."""
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
    """Play every manager with all the sets of benches.

    Args:
        scenario: the laboratory.
        managers, benches: who plays, see :func:`find_players`.
        budget: of the benchmark: how many episodes, and how long the scale's plans are searched for.
        split: worlds.
        keep: folder in which results of finished parts are kept; an audit's or a benchmark's of this scenario has those
            of the scale.
        executor: plays the parts, see :mod:`chemlab.agents.executors`; None: this process.
        watch: called with the name of each part that has been played.

    Returns:
        Plain data: ``managers`` and ``benches`` as they were given, ``cells`` (a manager with benches: its policy as
        ``chemlab run`` knows it, whether they have learned together, score, the same on the scale with interval),
        ``gaps`` (of everybody that has a partner and met others) and how it was made.

    Raises:
        ValueError: unknown budget, a policy that does not fit after all, or no score above random play.
    """
    chosen = budget_of(budget)
    crew = Crew(scenario, chosen, keep, executor, watch)
    jobs = {(m.name, b.name): _cell_job(_together(m, b), split) for m in managers for b in benches}
    played = crew.run([*reference_jobs(split), *jobs.values()])
    planned = crew.run(planner_jobs(chosen, played["plan"]["plans"], split))
    scores: dict[tuple[str, str], FloatArray] = {}
    for pair, job in jobs.items():
        if played[job.name]["scores"] is None:
            raise ValueError(f"{' with '.join(pair)}: {played[job.name]['reason']}")
        scores[pair] = np.array(played[job.name]["scores"])
    random, plan = (np.array(played[name]["scores"]) for name in ("random", "plan"))
    # Whoever knows the world can do what the others did there.
    oracle = np.maximum.reduce([foreseen(planned), random, plan, *scores.values()])
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
                "policy": _together(m, b),
                "together": _met(m, b) or _met(b, m),
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


def _met(player: Player, other: Player) -> bool:
    """Return whether the other is the player's partner of training."""
    return player.partner is not None and _origin(player.partner) == _origin(other.policy)


def _gaps(
    side: str, players: Sequence[Player], others: Sequence[Player], scaled: dict[tuple[str, str], FloatArray]
) -> Iterator[dict[str, Any]]:
    """Yield what each player of a side loses with unseen partners; ``scaled`` is by player and other."""
    for player in players:
        own = [scaled[player.name, other.name] for other in others if _met(player, other)]
        unseen = [
            other
            for other in others
            if not _met(player, other) and (player.partner is None or _origin(player.policy) != _origin(other.policy))
        ]
        if own and unseen:
            apart = np.mean([scaled[player.name, other.name] for other in unseen], axis=0)
            yield {
                "side": side,
                "policy": player.name,
                "partner": player.partner,
                "unseen": [other.name for other in unseen],
                "with_partner": interval(own[0]),
                "with_unseen": interval(apart),
                "gap": interval(own[0] - apart),
            }
