"""Policies by name, for every role of a laboratory."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import gymnasium
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
from .pretrained import PretrainedPolicy, load_pretrained, pretrained_for, pretrained_names
from .random_policy import RandomPolicy
from .roles import role_of
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
"""Habits by name: kelvin below the highest temperature that a reaction bench thinks right, see ScriptedReaction."""

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
        size: as for :class:`RandomPolicy`.
        seed: as for :class:`RandomPolicy`.
    """

    _MEMORY = ("_lapses", "_random", "_policy")

    def __init__(
        self, policy: Policy, probability: float, size: int, seed: int | np.random.SeedSequence | None = None
    ) -> None:
        first, second = as_sequence(seed).spawn(2)
        self._policy, self._probability = policy, probability
        self._lapses, self._random = RandomPolicy(1, first), RandomPolicy(size, second)

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the streams of one member."""
        parts = self._lapses, self._random, self._policy
        for part, sequence in zip(parts, as_sequence(seed).spawn(3), strict=True):
            if hasattr(part, "seed"):
                part.seed(member, sequence)

    def advise(
        self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray
    ) -> Actions:
        meant = Advisor(self._policy).advice(observation, mask, step, members)
        drawn = self._random.act(observation, mask, step, members)
        lapse = self._lapses.act(observation, None, step, members)[:, 0] < self._probability
        return np.where(lapse if meant.ndim == 1 else lapse[:, None], drawn, meant)

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
            the roles that were trained (its background plays the others). A learned policy plays greedily or sampled,
            as its card says; ``:greedy`` or ``:sampled`` after its name says otherwise. ``@0.1`` after it is the share
            of random legal actions. Exceptions follow after commas, by role or agent:
            ``pretrained@0.1,manager=runs/first:sampled``.

            * ``scripted``; with an ability removed: ``scripted:unsafe`` (no actions that serve only safety or
              measurement), ``scripted:no-extraction`` (the manager does not use extraction), ``scripted:memoryless``
              (the manager forgets its findings at the end of a batch, or at the next measurement), ``scripted:fifo``
              (the manager takes one order at a time, in the order of arrival); with other habits: ``scripted:hot``
              (reaction benches to which the highest useful temperature is revealed work above it, extraction benches to
              which polarities are revealed wash with more) and ``scripted:fixed`` (such benches do what is right at the
              median, whatever is revealed); the manager counts on the habit; others play as ``scripted``
            * ``random``
            * ``pretrained``: bundled benches and the scripted manager; ``pretrained-isolated``: the same with benches
              trained on single benches; ``trained``: a bundled manager as well, with the benches of its training
            * ``plan``: the manager plays the best stored constant plan for these benches, or that in ``plan:FILE``
        laboratories: whose agents they are for.
        seed: of what policies draw, where no episode's seed sets it (:meth:`chemlab.envs.players.Players.seed`).

    Raises:
        ValueError: unknown name, or nothing that fits.
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
    for exception in exceptions:
        whose, _, other = exception.partition("=")
        if whose not in known or not other:
            raise ValueError(f"policy: {exception!r}: must be ROLE=POLICY; roles: {', '.join(sorted(known))}")
        if whose in (agent, role_of(agent)):
            general = other
    return general


def _size(actions: gymnasium.Space[Any]) -> int:
    """Return the size of a continuous action, 0 for a discrete one."""
    return int((actions.shape or (0,))[0])


def _way(name: str) -> tuple[str, str | None]:
    """Split the way to play from the name of bundled weights, as :func:`~.saved.find_saved` does for a path."""
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
        ValueError: there is none; the message has the ``others``, names that may also be given.
    """
    if not is_saved(name):
        near = difflib.get_close_matches(name, [*others, *pretrained_names()], 1)
        raise ValueError(
            f"policy: must be one of {', '.join(others)}, a bundled policy, or an existing path; "
            f"given {name!r:.200}{f'; did you mean {near[0]}?' if near else ''}"
        )
    return find_saved(name)


def agent_policy(
    name: str, laboratories: Laboratories, number: int, seed: int | np.random.SeedSequence | None = None, deep: int = 0
) -> Policy:
    """A policy by name (see :func:`make_policies`) for agent ``number`` of a laboratory.

    Args:
        name, laboratories, number, seed: whose policy it is.
        deep: how many training runs have led here, each with the next one in its background.

    Raises:
        ValueError: unknown name, or no pretrained policy fits.
    """
    if deep > _DEEPEST:
        raise ValueError(f"policy: {name}: more than {_DEEPEST} runs, each in the background of the one before")
    name = current_name(name)
    agent, role = laboratories.agents[number], laboratories.roles[number].workplace
    operates = isinstance(role, Bench)
    own = _name_for(name, agent, laboratories.agents)
    steady, at, share = own.rpartition("@")
    if at and not is_saved(own):
        policy = agent_policy(steady, laboratories, number, seed, deep)
        return LapsingPolicy(policy, _probability(own, share), _size(laboratories.action_space(number)), seed)
    if own == "plan" or own.startswith("plan:"):
        if not operates:
            operators = name.split(",")[0].partition("@")[0]
            operators = "scripted" if operators.partition(":")[0] == "plan" else operators
            return plan_for(laboratories, operators, own.partition(":")[2] or None)
        own = "scripted"
    own, way = _way(own)
    if own not in policy_names():
        saved = _saved(own, policy_names())
        if role_of(agent) in saved.load:
            return as_trained(saved.load[role_of(agent)](role, seed), laboratories, number, seed, deep)
        if own != name.partition(",")[0]:
            raise ValueError(
                f"policy: {role_of(agent)}={own}: has no policy of its own for this role, but for "
                f"{', '.join(saved.load)}; leave it out, or give what is to play: {role_of(agent)}={saved.background}"
            )
        try:
            return agent_policy(saved.background, laboratories, number, seed, deep + 1)
        except ValueError as error:
            raise ValueError(f"{own}: background of this run: {error}" if deep == 0 else str(error)) from error
    if own == "random":
        return RandomPolicy(_size(laboratories.action_space(number)), seed)
    if own == "trained" and operates:
        return agent_policy(_partners(laboratories), laboratories, number, seed, deep + 1)
    if own == "trained" or (own in ("pretrained", "pretrained-isolated") and operates):
        found = pretrained_for(role, laboratory=True, alone=own == "pretrained-isolated")
        return as_trained(found.as_played(way, seed), laboratories, number, seed, deep)
    careful, margin_k = own != "scripted:unsafe", _MARGINS_K.get(own, 0.0)
    if isinstance(role, Bench):
        return scripted_bench(role, careful, seed, margin_k)
    benches = laboratories.scenario.benches
    washing = [key for key, bench in benches.items() if bench.kind == "extraction"]
    skip = washing if own == "scripted:no-extraction" else []
    remember, schedule = own != "scripted:memoryless", own != "scripted:fifo"
    return scripted_manager(laboratories, careful, skip, remember, schedule, margin_k)


def policy_files(name: str, deep: int = 0) -> list[Path]:
    """Return the files from which a policy by name is loaded (see :func:`make_policies`), with its background's."""
    found = list[Path]()
    for number, part in enumerate(current_name(name).split(",")):
        own = part.partition("=")[2] if number else part
        steady, at, _ = own.rpartition("@")
        own = steady if at and not is_saved(own) else own
        if own.startswith("plan:"):
            found.append(Path(own.partition(":")[2]))
        elif _way(own)[0] not in policy_names() and is_saved(own):
            files = saved_files(own)
            cards = [load_pretrained(file).card for file in files if file.suffix == ".safetensors"]
            others = {find_saved(own).background, *(card.advice for card in cards if card.advice)}
            found += files
            for other in sorted(others) if deep < _DEEPEST else ():
                found += policy_files(other, deep + 1)
    return found


def as_trained(
    policy: Policy,
    laboratories: Laboratories,
    number: int,
    seed: int | np.random.SeedSequence | None = None,
    deep: int = 0,
) -> Policy:
    """Return a trained policy with the notes or the advisor of its training, if it had any."""
    if isinstance(policy, PretrainedPolicy) and policy.card.notes:
        return AdvisedPolicy(policy, Notes(laboratories))
    advice = policy.card.advice if isinstance(policy, PretrainedPolicy) else None
    if advice is None:
        return policy
    advisor = agent_policy(advice, laboratories, number, seed, deep + 1)
    return AdvisedPolicy(policy, Advisor(advisor, len(laboratories.actions)))


def _partners(laboratories: Laboratories) -> str:
    """Return the background of the bundled manager of a laboratory; ``pretrained`` without one."""
    try:
        return pretrained_for(laboratories.manager.workplace, laboratory=True).card.background or "scripted"
    except ValueError:
        return "pretrained"


def is_scripted(bench: Bench) -> bool:
    """Return whether a scripted policy exists for a kind of bench."""
    return bench.spec.kind in _SCRIPTS.get(bench.scenario.physics, {})


def scripted_bench(
    bench: Bench, careful: bool = True, seed: int | np.random.SeedSequence | None = None, margin_k: float | None = 0.0
) -> Policy:
    """Return the scripted policy of a bench; for kinds without one, random legal actions with a warning.

    Args:
        bench: the bench.
        careful: False omits actions that serve only safety.
        seed: seed of random actions.
        margin_k: see :class:`.scripted.reaction.ScriptedReaction`.
    """
    kind = bench.spec.kind
    if is_scripted(bench):
        script = _SCRIPTS[bench.scenario.physics][kind]
        habits = {"margin_k": margin_k} if script in (ScriptedReaction, ScriptedExtraction) else {}
        policy: Policy = script(bench, careful, **habits)
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
    return RandomPolicy(_size(bench.action_space), seed)


def has_memory(scenario: Scenario) -> bool:
    """Return whether the scripted manager of a scenario keeps findings for later decisions."""
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
    """Return the scripted manager of some laboratories.

    Args:
        laboratories: the laboratories.
        careful: False omits actions that serve only safety and measurement.
        skip: benches that are not used.
        remember: False clears the belief at the end of a batch, or at the next measurement.
        schedule: False processes one order at a time in order of arrival.
        margin_k: margin of the reaction benches that the manager counts on.

    Raises:
        ValueError: the scripted manager of the scenario has no memory or no schedule that could be removed.
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
        ValueError: there is no such policy for this bench.
    """
    name, way = _way(current_name(name))
    if name == "scripted":
        return scripted_bench(bench, seed=seed)
    if name == "random":
        return RandomPolicy(_size(bench.action_space), seed)
    if name == "pretrained":
        return pretrained_for(bench).as_played(way, seed)
    saved = _saved(name, ("scripted", "random", "pretrained")).load
    # A run of one role may be tried on any bench that it fits; with several roles, the choice must be unambiguous.
    role = next(iter(saved)) if len(saved) == 1 else bench.key
    if role not in saved:
        raise ValueError(f"policy: {name} is for {', '.join(saved)}; given bench {bench.key!r}")
    return saved[role](bench, seed)
