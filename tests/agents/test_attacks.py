"""Teams that use what scenarios once gave away for nothing: free looks, codes in the stock, feedback of customers.

An attacker knows the public scenario and infers what is hidden by Bayes' rule, from what the hole shows and from
nothing else. It must gain next to nothing over the same team without the hole. Where the hole is open again, it must
gain much: otherwise it would not be an attacker.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from helpers import mapping

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.agents.scripted.exploration import CampaignManager
from chemlab.agents.scripted.foresee import run_experiment
from chemlab.agents.scripted.identify import IdentifyingManager, _Belief
from chemlab.agents.scripted.reaction import ScriptedReaction
from chemlab.agents.scripted.script import Setting
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories
from chemlab.roles.bench import channel_slices
from chemlab.roles.reaction_bench import ReactionBench

RUNS, STEPS, MODEL = 40, 20, 0.004
Policies = dict[str, Any]


def without(labs: Laboratories) -> Setting:
    """A manager's laboratory without instruments."""
    positions = {bench.key: len(bench.positions) for bench in labs.benches}
    return Setting(labs.scenario, labs.channels, labs.actions, labs.instruments, positions, False)


class Bench:
    """A scripted oven that keeps the spectra of its present experiment, by member; it holds still in a look.

    What it keeps goes to a manager that sees all (a free look), or to :meth:`code`, which doses a reagent.
    """

    def __init__(self, labs: Laboratories, looks: int = 0) -> None:
        self.bench = cast(ReactionBench, labs.benches[0])
        self.policy, self.looks = ScriptedReaction(self.bench), looks
        self.where = channel_slices(self.bench.channels)
        self.kept: dict[int, list[FloatArray]] = {}
        self.count: dict[int, int] = {}
        self.doses: dict[int, int] = {}

    def act(self, observation: Any, mask: Any, step: Any, members: Any) -> Any:
        actions = self.policy.act(observation, mask, step, members)
        for row, (seen, turn, member) in enumerate(zip(observation, step.tolist(), members.tolist(), strict=True)):
            if turn == 0:
                self.kept[member] = []
                self.count[member] = self.count.get(member, 0) + 1
            self.kept[member].append(seen[self.where["spectrum"]].astype(np.float64))
            if self.count[member] <= self.looks:
                actions[row] = 0.0
                actions[row, :2] = 0.5
            if turn == STEPS - 1 and self.code(member, seen):
                self.dose(member, actions[row])
        return actions

    def code(self, member: int, seen: FloatArray) -> bool:
        """Return True if the bench tells the manager something at the end of an experiment."""
        return False

    def dose(self, member: int, action: FloatArray) -> None:
        """Take so much of the reagent that the manager sees less of it."""
        scenario, name = self.bench.scenario, self.reagent
        resolution = scenario.shelf.gauge * scenario.stock[name]
        least = 0.54 * resolution if member not in self.doses else resolution
        self.doses[member] = 1
        largest = self.bench.options.reagents[name]
        action[2 + self.bench.reagent_names.index(name)] = max(least, 1e-3) / largest

    reagent = ""


class Spectra:
    """Likelihood of the mean of noisy spectra, for each of K candidates.

    Args:
        expected: [..., 200] spectra without noise.
        noise: of one value; half of its variance is the experiment's.
    """

    def __init__(self, expected: FloatArray, noise: float) -> None:
        draw, grid = np.random.default_rng(0).normal, np.linspace(0.0, 1.0, 101)
        shown = draw(0.0, noise * 0.5**0.5, (2000, 1, 1)) + draw(0.0, noise * 0.5**0.5, (2000, STEPS, 1)) + grid
        means = np.clip(shown, 0.0, 1.0).mean(axis=1)
        self.mean = np.interp(expected, grid, means.mean(axis=0))
        self.variance = np.interp(expected, grid, means.var(axis=0)) + MODEL**2

    def likelihood(self, seen: list[FloatArray], at: Any = ...) -> FloatArray:
        off = (np.mean(seen, axis=0) - self.mean[at]) ** 2 / self.variance[at] + np.log(self.variance[at])
        power = -0.5 * off.sum(axis=-1)
        return np.asarray(np.exp(power - power.max()) + 1e-12)


def quiet(scenario: Scenario) -> Scenario:
    """The scenario without noise of what benches observe."""
    benches = {key: bench.model_copy(update={"noise": {}}) for key, bench in scenario.benches.items()}
    return scenario.model_copy(update={"benches": benches})


def bench_noise(scenario: Scenario) -> float:
    return scenario.benches["rxn"].noise.get("spectrum", 0.0)


# -- four batches in one world ----------------------------------------------------------------------------------------


class Campaign(CampaignManager):
    """Infers the rate from the oven's spectra, or from what customers say."""

    def __init__(self, labs: Laboratories, bench: Bench | None = None, feedback: bool = False) -> None:
        super().__init__(without(labs))
        self.labs, self.bench, self.feedback = labs, bench, feedback
        self.spectra, self.purity = foreseen_batches(labs.scenario, self._numbers)
        self.sent: dict[int, tuple[int, int]] = {}

    def _see(self, observation: Any, step: int, member: int) -> None:
        super()._see(observation, step, member)
        belief = self._kept[member]
        if self.bench is not None and self.bench.kept.get(member):
            run = belief.runs[belief.slots[0]] - 1
            self.learn(belief, self.spectra.likelihood(self.bench.kept.pop(member), np.s_[:, run]))
        if self.feedback and member in self.sent:
            order, runs = self.sent.pop(member)
            said, paid = float(self.labs.feedback(member)[order, 1]), float(self.labs.rewards[member, 0])
            if said > 0.0:
                self.learn(belief, np.exp(-0.5 * ((said - self.purity[:, runs]) / 0.01) ** 2) + 1e-12)
            elif paid > 0.0:
                self.learn(belief, (self._worth[:, runs] > 0.0) + 1e-12)

    def learn(self, belief: Any, likelihood: FloatArray) -> None:
        belief.weights = belief.weights * likelihood / (belief.weights @ likelihood)

    def _decide(self, observation: Any, mask: Any, step: int, member: int) -> int:
        belief = self._kept[member]
        before = belief.orders[0], self._runs(belief)
        action = super()._decide(observation, mask, step, member)
        if before[0] not in belief.orders:
            self.sent[member] = before
        return action


def foreseen_batches(scenario: Scenario, rates: FloatArray) -> tuple[Spectra, FloatArray]:
    """Spectra of each run at each rate, and the purity after each number of runs."""
    labs = Laboratories(quiet(scenario), len(rates))
    for member, rate in enumerate(rates.tolist()):
        labs.reset(labs.members[member : member + 1], world={"rate": rate})
    oven, goal = Bench(labs), scenario.goals[0]
    part = labs.rules.arrays.parts[0, 0]
    shown, purity = [], []
    for _ in range(RUNS):
        amounts = labs.shelf.amounts[:, 0]
        purity.append(amounts[:, part] / (amounts @ labs.rules.arrays.counts[0]))
        run_experiment(labs, [None, oven], ("rxn_0", goal), labs.members)  # type: ignore[list-item]
        shown.append([np.mean(oven.kept[member], axis=0) for member in labs.members.tolist()])
    amounts = labs.shelf.amounts[:, 0]
    purity.append(amounts[:, part] / (amounts @ labs.rules.arrays.counts[0]))
    return Spectra(np.array(shown).swapaxes(0, 1), bench_noise(scenario)), np.array(purity).T


class StopBench(Bench):
    """Says when a batch is to be submitted, by a trace of the thinner."""

    reagent = "diethyl_ether"

    def __init__(self, labs: Laboratories) -> None:
        super().__init__(labs)
        wanted = mapping("campaign")["specifications"]["2-chlorohexane"]["purity_at_least"]
        specification = labs.scenario.specifications["2-chlorohexane"].model_copy(
            update={"purity_at_least": wanted * 1.012}  # what the traces take
        )
        spec = labs.scenario.model_copy(update={"specifications": {"2-chlorohexane": specification}})
        self.filter = Campaign(Laboratories(spec))
        self.weights: dict[int, FloatArray] = {}
        self.runs: dict[int, int] = {}

    def code(self, member: int, seen: FloatArray) -> bool:
        run, prior = self.runs.get(member, 0), self.weights.get(member, self.filter._prior())
        weights = prior * self.filter.spectra.likelihood(self.kept[member], np.s_[:, run])
        self.weights[member] = weights / weights.sum()
        stop = run == RUNS - 1 or (self.weights[member] @ self.filter._worth[:, run + 1 :]).argmax() == 0
        self.runs[member] = 0 if stop else run + 1
        return bool(stop)


class StopManager(CampaignManager):
    """Submits where the stock has become less; it sees nothing else."""

    def __init__(self, labs: Laboratories) -> None:
        super().__init__(without(labs))
        self.level: dict[int, float] = {}

    def _decide(self, observation: Any, mask: Any, step: int, member: int) -> int:
        belief, wait = self._kept[member], self._actions.encode("wait")
        if mask[wait]:
            return wait
        stock, slot = self._value(observation, "stock"), belief.slots[0]
        told = stock < self.level.setdefault(member, stock) - 1e-6
        self.level[member] = stock
        if not told:
            return self._actions.encode("start", str(self._rxn), slot, self._goal(observation, belief.orders[0]))
        submit = self._encode_submit(slot, belief.orders.pop(0))
        belief.slots.pop(0)
        return submit


def campaign_look(labs: Laboratories) -> Policies:
    bench = Bench(labs)
    return {"manager_0": Campaign(labs, bench), "rxn_0": bench}


def campaign_code(labs: Laboratories) -> Policies:
    return {"manager_0": StopManager(labs), "rxn_0": StopBench(labs)}


def campaign_feedback(labs: Laboratories) -> Policies:
    return {"manager_0": Campaign(labs, feedback=True)}


# -- vessels without a label ------------------------------------------------------------------------------------------


class Unlabelled(IdentifyingManager):
    """Brings every vessel to the oven some times before it chooses one.

    Args:
        labs: the laboratories.
        looks: at how many vessels it looks, again and again.
        bench: whose spectra it sees; None: it takes the vessel after whose look the stock has become less.
    """

    def __init__(self, labs: Laboratories, looks: int, bench: Bench | None = None) -> None:
        super().__init__(without(labs)._replace(careful=True))
        self._instrument = None  # it analyses products only
        self.looks, self.bench = looks, bench
        self.done: dict[int, int] = {}
        self.level: dict[int, float] = {}
        self.told: dict[int, int] = {}
        if bench is not None:
            self.spectra = foreseen_contents(self, labs)

    def _see(self, observation: Any, step: int, member: int) -> None:
        super()._see(observation, step, member)
        done = self.done.setdefault(member, 0)
        if not done or self._beliefs[member].chosen or self._value(observation, "rxn_0_busy") > 0.5:
            return
        v = (done - 1) % len(self._vessels)
        if self.bench is not None and self.bench.kept.get(member):
            self._beliefs[member].likelihood[v] *= self.spectra.likelihood(self.bench.kept.pop(member))
        stock = self._value(observation, "stock")
        if stock < self.level.setdefault(member, 1.0) - 1e-6:
            self.told[member] = v
        self.level[member] = stock

    def _decide(self, observation: Any, mask: Any, step: int, member: int) -> int:
        belief, wait = self._beliefs[member], self._actions.encode("wait")
        if not belief.chosen:
            if mask[wait]:
                return wait
            if self.done[member] < self.looks:
                slot = self._vessels[self.done[member] % len(self._vessels)]
                self.done[member] += 1
                goal = self._scenario.goals[int(observation[self._slices[self._orders[0]]].argmax())]
                return self._actions.encode("start", "rxn_0", slot, goal)
            if self.bench is None and member in self.told:
                belief.likelihood[self.told[member], : len(self._options) - 1] *= 1e6
                belief.likelihood[self.told[member]] *= self._ordered(observation)[0] + 1e-9
        return super()._decide(observation, mask, step, member)


def foreseen_contents(manager: IdentifyingManager, labs: Laboratories) -> Spectra:
    """Spectra [options, titres, 200] that the oven shows of a vessel."""
    spec, options = labs.scenario, list(itertools.product(manager._options, manager._titres.tolist()))
    known = Laboratories(quiet(spec), len(options))
    known.reset(known.members)
    layout, (identity, titre) = known.shelf.layout, (spec.world.draws["identity"], spec.world.draws["titre"])
    volume = known.shelf.chemistry.world().molar_volume
    litres = spec.shelf.vessel[0].contents[str(identity.material)] * volume[layout.index(str(identity.material))]
    names, inert = list(dict.fromkeys([*manager._options, str(titre.inert)])), layout.index(str(titre.inert))
    for row, (option, share) in zip(known.shelf.amounts[:, 0], options, strict=True):
        row[[layout.index(name) for name in names]] = 0.0
        row[layout.index(option)] += share * litres / volume[layout.index(option)]
        row[inert] += (1.0 - share) * litres / volume[inert]
    oven = Bench(known, looks=1)
    benches = make_policies("scripted", known) | {"rxn_0": oven}
    policies = [None, *(benches[agent] for agent in known.bench_agents)]
    run_experiment(known, policies, ("rxn_0", spec.goals[0]), known.members)
    shown = np.array([np.mean(oven.kept[member], axis=0) for member in known.members.tolist()])
    return Spectra(shown.reshape(len(manager._options), len(manager._titres), -1), bench_noise(spec))


class RecordBench(Bench):
    """Says, by a trace of sodium, that the vessel of this look is the best one so far."""

    reagent = "Na"

    def __init__(self, labs: Laboratories, looks: int) -> None:
        super().__init__(labs, looks)
        self.knows = IdentifyingManager(without(labs))
        self.spectra = foreseen_contents(self.knows, labs)
        self.beliefs: dict[int, _Belief] = {}
        self.best: dict[int, int] = {}

    def code(self, member: int, seen: FloatArray) -> bool:
        look, vessels = self.count[member] - 1, len(self.knows._vessels)
        if look >= self.looks:
            return False
        shape = (vessels, len(self.knows._options), len(self.knows._titres))
        belief = self.beliefs.setdefault(member, _Belief(np.ones(shape)))
        v = look % vessels
        belief.likelihood[v] *= self.spectra.likelihood(self.kept[member])
        if look < self.looks - vessels:
            return False
        goal = self.bench.scenario.goals[int(seen[self.where["goal"]].argmax())]
        expected = (self.knows._posterior(belief) * self.knows._worth(goal)).sum(axis=(1, 2))
        return bool(expected[: v + 1].argmax() == v)


def unlabelled_look(looks: int) -> Callable[[Laboratories], Policies]:
    def team(labs: Laboratories) -> Policies:
        bench = Bench(labs, looks)
        return {"manager_0": Unlabelled(labs, looks, bench), "rxn_0": bench}

    return team


def unlabelled_code(looks: int) -> Callable[[Laboratories], Policies]:
    return lambda labs: {"manager_0": Unlabelled(labs, looks), "rxn_0": RecordBench(labs, looks)}


# -- what they gain ---------------------------------------------------------------------------------------------------


def reopened(name: str, *holes: str) -> dict[str, Any]:
    """A scenario with holes as in version 1: no noise, no resolution, exact feedback."""
    values = mapping(name)
    if "noise" in holes:
        values["benches"]["rxn"]["noise"] = {}
    if "gauge" in holes:
        values["shelf"]["gauge"] = 0.0
    if "feedback" in holes:
        values["demand"]["feedback"] = 0.0
    return values


def scores(values: dict[str, Any], team: str | Callable[[Laboratories], Policies], episodes: int) -> FloatArray:
    labs = Laboratories(load_scenario(values), episodes, split="validation")
    policies = make_policies(team if isinstance(team, str) else "scripted", labs, 0)
    if not isinstance(team, str):
        policies |= team(labs)
    return play_laboratory(labs, policies, None, 0).returns


ATTACKS: list[tuple[str, str, Callable[[Laboratories], Policies], tuple[str, ...]]] = [
    ("unlabelled", "free look", unlabelled_look(16), ("noise",)),
    ("unlabelled", "stock code", unlabelled_code(16), ("noise", "gauge")),
    ("campaign", "free look", campaign_look, ("noise",)),
    ("campaign", "stock code", campaign_code, ("noise", "gauge")),
    ("campaign", "submission feedback", campaign_feedback, ("feedback",)),
]
WITHOUT: dict[str, Any] = {"unlabelled": unlabelled_look(0), "campaign": "scripted,manager=scripted:unsafe"}
EPISODES = {"unlabelled": 150, "campaign": 40}


@functools.cache
def scale(name: str) -> tuple[FloatArray, float]:
    """Scores without instruments or holes, and the raw score of 0.05: the scripted team is at 1, random play at 0."""
    values, episodes = mapping(name), EPISODES[name]
    scripted, random = (scores(values, team, episodes).mean() for team in ("scripted", "random"))
    return scores(values, WITHOUT[name], episodes), 0.05 * float(scripted - random)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "attack", "team", "holes"), ATTACKS, ids=lambda value: str(value).replace(" ", "-"))
def test_a_team_gains_nothing_by_a_hole(name: str, attack: str, team: Any, holes: tuple[str, ...]) -> None:
    """It gains at most 0.05; where the hole is open again, ten times as much."""
    base, bound = scale(name)
    assert (scores(mapping(name), team, EPISODES[name]) - base).mean() <= bound
    opened = scores(reopened(name, *holes), team, EPISODES[name]) - base
    assert opened.mean() >= 10.0 * bound


def test_a_submission_ends_the_episode_of_one_order() -> None:
    """So in `unlabelled` customers say nothing that could be used."""
    assert load_scenario("unlabelled").orders == 1
