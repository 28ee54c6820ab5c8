"""Policies by name, for every role of a laboratory."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from chemlab.config.scenario import Scenario
from chemlab.envs.players import Actions, Policy
from chemlab.kernels.arrays import IntArray, MaskArray, ObservationArray
from chemlab.kernels.rng import as_sequence
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import Bench
from chemlab.roles.discrete import Discretised
from chemlab.roles.reaction_bench import ReactionBench

from .advice import AdvisedPolicy, Advising, Advisor
from .discretised import NearestPolicy
from .former_names import current_name, split_way
from .notes import Notes
from .open_loop import plan_for
from .pretrained import PretrainedPolicy, Seed, load_pretrained, pretrained_for, pretrained_names
from .random_policy import RandomPolicy
from .roles import action_size, role_of
from .saved import Saved, find_saved, is_saved, saved_files
from .scripted.crystallization import ScriptedCrystallization
from .scripted.distillation import ScriptedDistillation
from .scripted.exploration import CampaignManager, has_unknown_rate
from .scripted.extraction import ScriptedExtraction
from .scripted.foresee import ForeseeingManager, foresees
from .scripted.fractions import ScriptedFraction
from .scripted.identify import IdentifyingManager, has_unlabelled_vessels
from .scripted.reaction import ScriptedReaction
from .scripted.real import ScriptedRealReaction
from .scripted.router import SynthesisManager
from .scripted.schedule import SchedulingManager, has_orders_to_schedule
from .scripted.screening import ScreeningManager, ScriptedScreening, catalysts
from .scripted.script import Setting
from .scripted.upkeep import UpkeepManager, has_wearing_lines
from .scripted.workup import ScriptedWorkup

_MARGINS_K: dict[str, float | None] = {"scripted:hot": -8.0, "scripted:fixed": None}
"""Temperature margins of reaction benches by policy name, as for :class:`~.scripted.reaction.ScriptedReaction`."""

_SCRIPTS: dict[str, dict[str, type[Any]]] = {
    "paper": {
        "reaction": ScriptedReaction,
        "extraction": ScriptedExtraction,
        "distillation": ScriptedDistillation,
    },
    "real": {
        "reaction": ScriptedRealReaction,
        "extraction": ScriptedWorkup,
        "distillation": ScriptedFraction,
        "crystallization": ScriptedCrystallization,
    },
}
"""Scripted policies by physics backend and kind of bench."""

_DEEPEST = 8
"""Maximum number of training runs, each with the next one as its background."""
_LEARNED = ("pretrained", "pretrained-isolated", "trained")
"""Names of policies with bundled weights."""
_UNSCRIPTED: set[str] = set()
"""Kinds of benches without a scripted policy for which a warning has been given."""


class LapsingPolicy(Advising):
    """Epsilon-random policy: plays a random legal action with a given probability, otherwise another policy's action.

    A policy with memory knows which action was played.

    Args:
        policy: the other policy.
        probability: probability of a random action in each turn, in [0, 1].
        size, seed: as for :class:`RandomPolicy`.
    """

    _MEMORY = ("_lapses", "_random", "_policy")

    def __init__(self, policy: Policy, probability: float, size: int, seed: Seed = None) -> None:
        first, second = as_sequence(seed).spawn(2)
        self._policy, self._probability = policy, probability
        self._lapses, self._random = RandomPolicy(1, first), RandomPolicy(size, second)

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the random streams of one environment."""
        parts = self._lapses, self._random, self._policy
        for part, sequence in zip(parts, as_sequence(seed).spawn(3), strict=True):
            if hasattr(part, "seed"):
                part.seed(member, sequence)

    def advise(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> Actions:
        intended = Advisor(self._policy).advice(observation, mask, step, members)
        drawn = self._random.act(observation, mask, step, members)
        lapse = self._lapses.act(observation, None, step, members)[:, 0] < self._probability
        return np.where(lapse if intended.ndim == 1 else lapse[:, None], drawn, intended)

    def played(self, actions: IntArray, members: IntArray) -> None:
        Advisor(self._policy).played(actions, members)


def policy_names() -> tuple[str, ...]:
    """Return the names that :func:`make_policies` accepts."""
    ablated = ("scripted:unsafe", "scripted:no-extraction", "scripted:memoryless", "scripted:fifo")
    scripted = ("scripted", *ablated, *_MARGINS_K)
    return (*scripted, "random", "pretrained", "pretrained-isolated", "trained", "plan")


def make_policies(name: str, laboratories: Laboratories, seed: int | None = None) -> dict[str, Policy]:
    """Make a policy for each agent of a laboratory.

    Args:
        name: one of :func:`policy_names` (below), the name of a bundled policy
            (:func:`~.pretrained.pretrained_names`), or the path of a training run, a checkpoint or exported weights for
            the trained roles (the run's background plays the others). A learned policy plays greedily or sampled, as
            its card says; ``:greedy`` or ``:sampled`` after its name overrides this. ``@0.1`` after a name is the share
            of random legal actions. Exceptions follow after commas, by role or agent:
            ``pretrained@0.1,manager=runs/first:sampled``.

            * ``scripted``; with an ability removed: ``scripted:unsafe`` (no actions that serve only safety or
              measurement), ``scripted:no-extraction`` (the manager does not use extraction), ``scripted:memoryless``
              (the manager forgets its findings at the end of a batch, or at the next measurement), ``scripted:fifo``
              (the manager processes one order at a time, in the order of arrival); with other conventions:
              ``scripted:hot`` (reaction benches to which the highest useful temperature is revealed work above it,
              extraction benches to which polarities are revealed wash with more) and ``scripted:fixed`` (such benches
              play as for the median, whatever is revealed). The manager relies on the convention; other agents play as
              ``scripted``
            * ``random``
            * ``pretrained``: bundled benches and the scripted manager; ``pretrained-isolated``: the same with benches
              trained on single benches; ``trained``: a bundled manager as well, with the benches of its training
            * ``plan``: the manager plays the best bundled open-loop plan for these benches; ``plan:FILE``: a plan file
        laboratories: the laboratories of the agents.
        seed: seed of random policies; :meth:`chemlab.envs.players.Players.seed` replaces it in each episode.

    Raises:
        ValueError: the name is unknown, or no policy of that name fits.
    """
    seeds = np.random.SeedSequence(seed).spawn(len(laboratories.agents))
    return {
        agent: agent_policy(name, laboratories, number, sequence)
        for number, (agent, sequence) in enumerate(zip(laboratories.agents, seeds, strict=True))
    }


def _name_for(name: str, agent: str, agents: Sequence[str]) -> str:
    """Return the part of a policy's name that applies to an agent."""
    general, *exceptions = name.split(",")
    known = {*agents, *map(role_of, agents)}
    if general.partition("=")[0] in known:
        raise ValueError(f"policy: {name!r}: begin with the policy of the other agents, as in 'scripted,{name}'")
    for exception in exceptions:
        role, _, policy = exception.partition("=")
        if role not in known or not policy:
            raise ValueError(f"policy: {exception!r}: must be ROLE=POLICY; roles: {', '.join(sorted(known))}")
        if role in (agent, role_of(agent)):
            general = policy
    return general


def _way(name: str) -> tuple[str, str | None]:
    """Split ``:greedy`` or ``:sampled`` from a name of :func:`policy_names`; paths are returned as they are."""
    general, way = split_way(name)
    if way is None or general not in policy_names():
        return name, None
    if general not in _LEARNED:
        raise ValueError(f"policy: {name}: only learned policies are greedy or sampled; give {general!r}")
    return general, way


def _probability(name: str, text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"policy: {name!r}: the share of random actions after @ must be from 0 to 1")
    return share


def _saved(name: str, others: Sequence[str]) -> Saved:
    """Find a bundled or saved policy.

    Raises:
        ValueError: it does not exist; the message lists ``others``, the names that are accepted as well.
    """
    if not is_saved(name):
        near = difflib.get_close_matches(name, [*others, *pretrained_names()], 1)
        raise ValueError(
            f"policy: must be one of {', '.join(others)}, a bundled policy, or an existing path; "
            f"given {name!r:.200}{f'; did you mean {near[0]}?' if near else ''}"
        )
    return find_saved(name)


def agent_policy(name: str, laboratories: Laboratories, number: int, seed: Seed = None, depth: int = 0) -> Policy:
    """Return a policy by name (see :func:`make_policies`) for one agent.

    Args:
        name: the policy's name.
        laboratories: the laboratories of the agent.
        number: agent index.
        seed: seed of a random policy.
        depth: number of training runs whose backgrounds have led to this policy.

    Raises:
        ValueError: the name is unknown, or no policy of that name fits.
    """
    if depth > _DEEPEST:
        raise ValueError(f"policy: {name}: more than {_DEEPEST} runs, each in the background of the one before")
    name = current_name(name)
    role, workplace = role_of(laboratories.agents[number]), laboratories.roles[number].workplace
    is_bench = isinstance(workplace, Bench)
    chosen = _name_for(name, laboratories.agents[number], laboratories.agents)
    base, at, share = chosen.rpartition("@")
    if at and not is_saved(chosen):
        policy = agent_policy(base, laboratories, number, seed, depth)
        return LapsingPolicy(policy, _probability(chosen, share), action_size(workplace.action_space), seed)
    if chosen == "plan" or chosen.startswith("plan:"):
        if not is_bench:
            benches = name.split(",")[0].partition("@")[0]
            benches = "scripted" if benches.partition(":")[0] == "plan" else benches
            return plan_for(laboratories, benches, chosen.partition(":")[2] or None)
        chosen = "scripted"
    chosen, way = _way(chosen)
    if chosen not in policy_names():
        saved = _saved(chosen, policy_names())
        if role in saved.load:
            return as_trained(saved.load[role](workplace, seed), laboratories, number, seed, depth)
        if chosen != name.partition(",")[0]:
            raise ValueError(
                f"policy: {role}={chosen}: has policies for {', '.join(saved.load)} only; leave it out, or name the "
                f"policy of this role: {role}={saved.background}"
            )
        try:
            return agent_policy(saved.background, laboratories, number, seed, depth + 1)
        except ValueError as error:
            raise ValueError(f"{chosen}: background of this run: {error}" if depth == 0 else str(error)) from error
    if chosen == "random":
        return RandomPolicy(action_size(workplace.action_space), seed)
    if chosen == "trained" and is_bench:
        return agent_policy(_partners(laboratories), laboratories, number, seed, depth + 1)
    if chosen == "trained" or (chosen in ("pretrained", "pretrained-isolated") and is_bench):
        pretrained = pretrained_for(workplace, laboratory=True, alone=chosen == "pretrained-isolated")
        return as_trained(pretrained.as_played(way, seed), laboratories, number, seed, depth)
    careful, margin_k = chosen != "scripted:unsafe", _MARGINS_K.get(chosen, 0.0)
    if isinstance(workplace, Bench):
        return scripted_bench(workplace, careful, seed, margin_k)
    extraction = [key for key, bench in laboratories.scenario.benches.items() if bench.kind == "extraction"]
    skip = extraction if chosen == "scripted:no-extraction" else []
    remember, schedule = chosen != "scripted:memoryless", chosen != "scripted:fifo"
    return scripted_manager(laboratories, careful, skip, remember, schedule, margin_k)


def policy_files(name: str, depth: int = 0) -> list[Path]:
    """Return the files of a policy by name (see :func:`make_policies`) and of its background."""
    found = list[Path]()
    for i, part in enumerate(current_name(name).split(",")):
        chosen = part.partition("=")[2] if i else part
        base, at, _ = chosen.rpartition("@")
        chosen = base if at and not is_saved(chosen) else chosen
        if chosen.startswith("plan:"):
            found.append(Path(chosen.partition(":")[2]))
        elif _way(chosen)[0] not in policy_names() and is_saved(chosen):
            files = saved_files(chosen)
            cards = [load_pretrained(file).card for file in files if file.suffix == ".safetensors"]
            others = {find_saved(chosen).background, *(card.advice for card in cards if card.advice)}
            found += files
            for other in sorted(others) if depth < _DEEPEST else ():
                found += policy_files(other, depth + 1)
    return found


def as_trained(policy: Policy, laboratories: Laboratories, number: int, seed: Seed = None, depth: int = 0) -> Policy:
    """Return a trained policy with the notes or the advisor of its training, if it had any."""
    card = policy.card if isinstance(policy, PretrainedPolicy) else None
    if card is not None and card.notes:
        return AdvisedPolicy(policy, Notes(laboratories))
    if card is None or card.advice is None:
        return policy
    advisor = agent_policy(card.advice, laboratories, number, seed, depth + 1)
    return AdvisedPolicy(policy, Advisor(advisor, len(laboratories.actions)))


def _partners(laboratories: Laboratories) -> str:
    """Return the background of a laboratory's bundled manager; ``pretrained`` if there is no such manager."""
    try:
        return pretrained_for(laboratories.manager.workplace, laboratory=True).card.background or "scripted"
    except ValueError:
        return "pretrained"


def is_scripted(bench: Bench) -> bool:
    """Return True if a scripted policy exists for a bench."""
    return bench.spec.kind in _SCRIPTS.get(bench.scenario.physics, {})


def scripted_bench(bench: Bench, careful: bool = True, seed: Seed = None, margin_k: float | None = 0.0) -> Policy:
    """Return the scripted policy of a bench; for kinds without one, a random policy and a warning.

    Args:
        bench: the bench.
        careful: False omits actions that serve only safety.
        seed: seed of random actions.
        margin_k: see :class:`.scripted.reaction.ScriptedReaction`.
    """
    kind = bench.spec.kind
    if is_scripted(bench):
        script = _SCRIPTS[bench.scenario.physics][kind]
        margin = {"margin_k": margin_k} if script in (ScriptedReaction, ScriptedExtraction) else {}
        policy: Policy = script(bench, careful, **margin)
        if isinstance(bench, ReactionBench) and catalysts(bench.scenario):
            policy = ScriptedScreening(bench)
        return NearestPolicy(policy, bench) if isinstance(bench, Discretised) else policy
    if kind not in _UNSCRIPTED:
        _UNSCRIPTED.add(kind)
        warnings.warn(
            f"bench {bench.key!r} plays random legal actions: there is no scripted policy for kind {kind!r} "
            f"(only for {', '.join(_SCRIPTS.get(bench.scenario.physics, {}))})",
            stacklevel=2,
        )
    return RandomPolicy(action_size(bench.action_space), seed)


def has_memory(scenario: Scenario) -> bool:
    """Return True if the scripted manager of a scenario keeps findings for later decisions."""
    return (
        (has_orders_to_schedule(scenario) and _has_reports(scenario))
        or has_unknown_rate(scenario) is not None
        or foresees(scenario)
        or has_wearing_lines(scenario)
    )


def _has_reports(scenario: Scenario) -> bool:
    return any(bench.report is not None for bench in scenario.benches.values())


def scripted_manager(
    laboratories: Laboratories,
    careful: bool = True,
    skip: Collection[str] = (),
    remember: bool = True,
    schedule: bool = True,
    margin_k: float | None = 0.0,
) -> Policy:
    """Return the scripted manager for a scenario.

    Args:
        laboratories: the laboratories.
        careful: False omits actions that serve only safety and measurement.
        skip: benches that are not used.
        remember: False clears the belief at the end of a batch, or at the next measurement.
        schedule: False processes one order at a time in order of arrival.
        margin_k: temperature margin of the reaction benches that the manager assumes.

    Raises:
        ValueError: the scripted manager of the scenario has no memory or no schedule to remove.
    """
    labs = laboratories
    positions = {bench.key: len(bench.positions) for bench in labs.benches}
    setting = Setting(labs.scenario, labs.channels, labs.actions, labs.instruments, positions, careful, skip, margin_k)
    if has_orders_to_schedule(labs.scenario) and (remember or _has_reports(labs.scenario)):
        return SchedulingManager(setting, schedule, remember, script=scripted_bench)
    if not schedule:
        raise ValueError(f"scripted:fifo: the scripted manager of {labs.scenario.name} has no orders to choose from")
    if not (remember or has_memory(labs.scenario)):
        raise ValueError(f"scripted:memoryless: the scripted manager of {labs.scenario.name} has nothing to forget")
    if has_unknown_rate(labs.scenario) is not None:
        return CampaignManager(setting, remember=remember)
    if catalysts(labs.scenario) and remember:
        return ScreeningManager(setting)
    if foresees(labs.scenario):
        return ForeseeingManager(setting, remember=remember, script=scripted_bench)
    if has_wearing_lines(labs.scenario):
        return UpkeepManager(setting, remember=remember)
    return (IdentifyingManager if has_unlabelled_vessels(labs.scenario) else SynthesisManager)(setting)


def bench_policy(name: str, bench: Bench, seed: int = 0) -> Policy:
    """Make a policy for a bench by name.

    Args:
        name: ``scripted``, ``random``, ``pretrained``, a bundled policy
            (:func:`~chemlab.agents.pretrained.pretrained_names`), or a path: a training run's folder, a checkpoint in
            it (folder or ``model.zip``), or exported weights (``.safetensors``).
        bench: the bench.
        seed: seed of a random policy.

    Raises:
        ValueError: the name is unknown, or no policy of that name fits the bench.
    """
    name, way = _way(current_name(name))
    if name == "scripted":
        return scripted_bench(bench, seed=seed)
    if name == "random":
        return RandomPolicy(action_size(bench.action_space), seed)
    if name == "pretrained":
        return pretrained_for(bench).as_played(way, seed)
    saved = _saved(name, ("scripted", "random", "pretrained")).load
    # A run of one role may play any bench that it fits; a run of several roles plays benches of these roles.
    role = next(iter(saved)) if len(saved) == 1 else bench.key
    if role not in saved:
        raise ValueError(f"policy: {name} is for {', '.join(saved)}; given bench {bench.key!r}")
    return saved[role](bench, seed)
