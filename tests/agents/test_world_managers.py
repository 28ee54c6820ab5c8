"""Scripted managers of scenarios with a world: what they believe, when they look, what they carry on."""

import functools
import math
from typing import Any

import numpy as np
import pytest
from helpers import Watched, mapping, refused

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies, scripted_manager
from chemlab.agents.scripted.belief import run_experiment
from chemlab.agents.scripted.exploration import CampaignManager, _foreseen, has_unknown_rate
from chemlab.agents.scripted.extraction import ScriptedExtraction
from chemlab.agents.scripted.foresee import foresees
from chemlab.agents.scripted.identify import IdentifyingManager, has_unlabelled_vessels
from chemlab.agents.scripted.reaction import ScriptedReaction
from chemlab.agents.scripted.schedule import _RATES, SchedulingManager, has_orders_to_schedule
from chemlab.agents.scripted.script import midpoints
from chemlab.agents.scripted.upkeep import UpkeepManager, has_wearing_lines
from chemlab.config.inherit import scenario_names
from chemlab.config.loading import load_scenario
from chemlab.envs.players import Players
from chemlab.kernels.arrays import FloatArray
from chemlab.lab.engine import Laboratories
from chemlab.lab.sampling import quantiles
from chemlab.physics.chemistry import TEMPERATURE
from chemlab.roles.manager_actions import MEASURE, SUBMIT

GAS = 8.314462618


def played(name: str, policy: str, members: int, values: dict[str, Any] | None = None) -> tuple[Laboratories, Watched]:
    labs = Laboratories(load_scenario(values or name), members, split="validation")
    policies = make_policies(policy, labs, 0)
    policies["manager_0"] = watched = Watched(policies["manager_0"], labs)
    play_laboratory(labs, policies, None, 100)
    return labs, watched


def test_managers_are_chosen_by_what_is_hidden() -> None:
    for name in scenario_names():
        scenario = load_scenario(name)
        if foresees(scenario):
            continue  # tests/agents/test_foresee.py
        manager = scripted_manager(Laboratories(scenario))
        assert isinstance(manager, IdentifyingManager) == has_unlabelled_vessels(scenario) == (name == "unlabelled")
        assert isinstance(manager, CampaignManager) == (has_unknown_rate(scenario) is not None) == (name == "campaign")
        assert isinstance(manager, UpkeepManager) == has_wearing_lines(scenario) == (name == "failing")
        scheduled = name in ("rush", "relay", "refine")
        assert isinstance(manager, SchedulingManager) == has_orders_to_schedule(scenario) == scheduled


def test_the_vessel_that_is_chosen_is_the_right_one() -> None:
    labs, watched = played("unlabelled", "scripted", 40)
    goals = ("dodecane", "5,6-dimethyldecane", "4,5-diethyloctane")
    halide = {goal: f"{carbon}-chlorohexane" for carbon, goal in enumerate(goals, start=1)}
    kinds, better = labs.actions.table, []
    for member in range(40):
        goal = labs.scenario.goals[labs.state.goal[member, 0]]
        held, titre = (labs.worlds.values(member)[name] for name in ("identity", "titre"))
        first = next(action for action in watched.actions[member] if labs.actions.decode(action)[0] == "start")
        slot = f"slot_{labs.actions.decode(first)[2]}"
        assert held[slot] == halide[goal]
        other = next(name for name in held if name != slot and held[name] == halide[goal])
        better.append(titre[slot] > titre[other])
        looks = [action for action in watched.actions[member] if kinds[action, 0] == MEASURE]
        assert len(looks) == len(set(looks))
    # Of two that are right it need not know both, but a poor one makes it go on looking.
    assert np.mean(better) > 0.7


def test_nobody_looks_where_it_costs_more_than_it_is_worth() -> None:
    values = mapping("unlabelled")
    for instrument in values["instruments"].values():
        instrument["price"] = 0.39
    labs, watched = played("unlabelled", "scripted", 5, values)
    assert [labs.actions.decode(actions[0])[0] for actions in watched.actions] == ["start"] * 5


def test_a_reading_changes_what_the_other_vessels_may_hold() -> None:
    """Bayes by hand: one vessel of eight is seen to hold the first halide, so of the other seven one does."""
    labs = Laboratories("unlabelled")
    manager: Any = scripted_manager(labs)
    labs.begin()
    seen, mask = labs.observe(0, labs.members), labs.mask(0, labs.members)
    manager.act(seen, mask, np.zeros(1, dtype=np.int64), labs.members)
    belief = manager._kept[0]
    assert manager._posterior(belief).sum(axis=2) == pytest.approx(np.full((8, 4), 0.25))
    belief.likelihood[0] = 1e-12
    belief.likelihood[0, 0] = 1.0
    after = manager._posterior(belief).sum(axis=2)
    assert after[0] == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert after[1:] == pytest.approx(np.tile([1 / 7, 2 / 7, 2 / 7, 2 / 7], (7, 1)))


def test_batches_are_foreseen_as_two_first_order_steps_go() -> None:
    """A -> P -> W in closed form, step by step at the temperature that the oven has."""
    scenario = load_scenario("campaign")
    rates = np.array([0.3, 1.0, 3.0])
    readings, worth = _foreseen(scenario, "rate", tuple(rates), "gas_chromatograph", "rxn_0")
    labs = Laboratories(scenario)
    a_at, p_at = (labs.instruments.analytes[0].index(name) for name in ("1-chlorohexane", "2-chlorohexane"))
    tick = scenario.benches["rxn"].model_extra["tick"]  # type: ignore[index]
    least = scenario.specifications["2-chlorohexane"].purity_at_least
    for row, rate in enumerate(rates):
        a, p = 1.0, 0.0
        for run in range(8):
            assert readings[row, run, a_at] == pytest.approx(a, abs=2e-3)
            assert readings[row, run, p_at] == pytest.approx(p, abs=2e-3)
            good = p * p / 4.0 if p >= least else 0.0
            if abs(p - least) > 2e-3:
                assert worth[row, run] == pytest.approx(good - 0.00002 * 20 * run, abs=2e-3)
            for step in range(20):
                temperature = 345.0 if step == 0 else 350.0
                k1, k2 = (rate * pre * math.exp(-85000.0 / (GAS * temperature)) * tick for pre in (4.86e12, 4.86e11))
                left = math.exp(-k1)
                p = p * math.exp(-k2) + a * k1 / (k2 - k1) * (left - math.exp(-k2))
                a *= left


def test_what_the_first_batch_has_taught_is_not_measured_again() -> None:
    looks: dict[str, np.ndarray[Any, Any]] = {}
    for policy in ("scripted", "scripted:memoryless"):
        labs, watched = played("campaign", policy, 30)
        counts = np.zeros((30, 4))
        for member, actions in enumerate(watched.actions):
            batch = 0
            for kind in labs.actions.table[actions, 0]:
                counts[member, min(batch, 3)] += kind == MEASURE
                batch += kind == SUBMIT
        looks[policy] = counts.mean(axis=0)
    assert looks["scripted"][0] > 3.0 * looks["scripted"][1:].mean()
    assert looks["scripted:memoryless"][1:].mean() > 2.0 * looks["scripted"][1:].mean()


@pytest.mark.slow
def test_earlier_looks_are_worth_remembering() -> None:
    """What a vessel showed before the last portion tells more of its kinetics than what it shows after it."""
    one, other = (played("selectivity", name, 120)[0] for name in ("scripted", "scripted:memoryless"))
    gained = one.result(one.members) - other.result(other.members)
    assert gained.mean() > 2.0 * gained.std() / np.sqrt(120.0)


@pytest.mark.slow
def test_memories_are_put_back() -> None:
    """An episode that is taken up again half way goes on as it did; with the notes of learned managers, too."""
    names = ("campaign", "unlabelled", "failing", "rush", "relay", "refine", "crude")
    for name, policy in [*((name, "scripted") for name in names), ("rush", "trained"), ("failing", "trained")]:
        labs = Laboratories(name, 2, split="test")
        players = Players(labs, list(make_policies(policy, labs, 0).values()))
        labs.begin(7)
        for _ in range(30):
            players.play_pass(labs.members)
        saved, memory = labs.snapshot(), players.get_memory()
        players.play_on(labs.members)
        scores = labs.result(labs.members)
        labs.restore(saved)
        players.set_memory(memory)
        players.play_on(labs.members)
        assert (labs.result(labs.members) == scores).all()


@pytest.mark.parametrize("scenario", ["campaign", "runaway"])
def test_who_lapses_goes_on(scenario: str) -> None:
    """Also where what was meant to be submitted is there still, when all should be over."""
    labs = Laboratories(scenario, 12, split="test")
    played = play_laboratory(labs, make_policies("scripted,manager=scripted@0.3", labs, 1), None, 0)
    assert labs.state.status.all()
    assert np.isfinite(played.returns).all()


def test_policies_of_who_has_no_choice_are_refused() -> None:
    for name, scenario, said in (("memoryless", "unlabelled", "nothing to forget"), ("fifo", "campaign", "no orders")):
        message = f"scripted:{name}: the scripted manager of {scenario} has {said}"
        refused(message, make_policies, f"scripted:{name}", Laboratories(scenario))


def failing(**wear: Any) -> dict[str, Any]:
    """The shipped scenario with other benches, whose gains are as they say."""
    values = mapping("failing")
    values["world"] = {}
    for bench in values["benches"].values():
        bench["wear"] = {"repair_price": 0.01, "repair_ticks": 10, **wear}
    return values


def counted(labs: Laboratories, watched: Watched) -> dict[str, float]:
    """How often the manager does what, in the mean over episodes."""
    kinds = [labs.actions.decode(action)[0] for actions in watched.actions for action in actions]
    return {kind: kinds.count(kind) / len(watched.actions) for kind in ("measure", "calibrate", "repair", "submit")}


def test_a_line_that_is_known_is_not_looked_at() -> None:
    """Its batches are taken off within what the specification allows, by the clock alone."""
    labs, watched = played("failing", "scripted", 4, failing(gain=0.8))
    assert counted(labs, watched) == {"measure": 0.0, "calibrate": 0.0, "repair": 0.0, "submit": 6.0}
    assert (labs.state.submitted[..., 1] >= 0.76).all()


def test_particles_follow_the_vessel() -> None:
    """A reading without noise leaves those that show it; without any, they spread as the gains do."""
    values = failing(spread=0.5)
    values["instruments"]["gas_chromatograph"] |= {"noise": 0.0, "drift": None}
    labs = Laboratories(load_scenario(values))
    manager: Any = scripted_manager(labs)
    labs.begin(3)
    players = Players(labs, [manager, *list(make_policies("scripted", labs, 0).values())[1:]])
    while labs.state.ticks[0] < 30:
        players.play_pass(labs.members)
    belief = manager._kept[0]
    line = belief.lines[0]
    manager._observe(labs.observe(0, labs.members)[0], 1, 0)
    assert line.speed.std() == pytest.approx(0.5, rel=0.25)
    gain = labs.experiments[0].gain[0, 0]
    true = gain * 3.0  # runs of ten ticks
    manager._resample(belief, line, manager._expected_readings(np.array([true]))[0])
    assert line.age.mean() == pytest.approx(true, rel=0.05)
    assert np.exp(line.speed.mean()) == pytest.approx(gain, rel=0.05)


@pytest.mark.slow
def test_repairs_and_calibrations_are_worth_their_price() -> None:
    """On the same episodes, against managers for whom they are too dear."""
    scores = {}
    for case in ("as it is", "no repair", "no calibration"):
        values = mapping("failing")
        for bench in values["benches"].values():
            bench["wear"]["repair_price"] *= 100.0 if case == "no repair" else 1.0
        if case == "no calibration":
            values["instruments"]["gas_chromatograph"]["drift"]["price"] = 2.0 * values["limits"]["budget"]
        labs, watched = played("failing", "scripted", 25, values)
        scores[case], counts = labs.result(labs.members), counted(labs, watched)
        assert (counts["repair"] > 1.0) == (case != "no repair")
        assert (counts["calibrate"] > 1.0) == (case != "no calibration")
    for case in ("no repair", "no calibration"):
        gained = scores["as it is"] - scores[case]
        assert gained.mean() > 2.0 * gained.std() / 25**0.5 > 0.0, case


def known_shop(name: str, orders: int, **terms: list[float]) -> dict[str, Any]:
    """A scenario with orders of which everything is known at once, and full vessels."""
    values = mapping(name)
    values["orders"] = orders
    values["demand"]["order"] = [{key: given[o] for key, given in terms.items()} for o in range(orders)]
    titre = {"of": ["slot_0", "slot_1", "slot_2", "slot_3"], "test": []}
    values["world"]["draws"] = {
        key: draw | (titre if key == "titre" else {})
        for key, draw in values["world"]["draws"].items()
        if key in ("titre", "first_limit", "second_limit")
    }
    values["world"]["draws"]["titre"]["distribution"] = {"kind": "uniform", "low": 0.9, "high": 1.0}
    return values


def test_where_reagent_is_short_the_orders_that_pay_best_are_met() -> None:
    """Three runs for five orders: the three dearest; who takes them as they come takes the first three."""
    prices = [0.5, 1.0, 0.25, 3.0, 2.0]
    values = known_shop("rush", 5, price=prices, amount_at_least_mol=[1.0] * 5)
    for policy, dearest in (("scripted", [1, 3, 4]), ("scripted:fifo", [0, 1, 2])):
        labs, _ = played("rush", policy, 3, values)
        for member in range(3):
            assert np.flatnonzero(labs.state.paid[member]).tolist() == dearest
            assert labs.state.paid[member].sum() == sum(prices[o] for o in dearest)


def test_an_order_that_cannot_be_met_in_time_is_let_go() -> None:
    values = known_shop("rush", 3, within=[19.0, 30.0, 30.0], price=[5.0, 1.0, 1.0])
    labs, _ = played("rush", "scripted", 2, values)
    assert (labs.state.paid > 0.0).tolist() == [[False, True, True]] * 2


def test_a_near_deadline_gets_the_quick_grade() -> None:
    labs, watched = played("relay", "scripted", 2, known_shop("relay", 1, within=[25.0]))
    for actions in watched.actions:
        starts = [labs.actions.decode(a) for a in actions if labs.actions.decode(a)[0] == "start"]
        slot = starts[0][2]
        assert [start[1:] for start in starts] == [("rxn_0", slot, "F", "quick"), ("fin_0", slot, "E", "quick")]


@pytest.mark.parametrize("margin_k", [0.0, None])
def test_a_bench_that_is_told_keeps_below_the_temperature_at_which_too_much_is_lost(margin_k: float | None) -> None:
    """At a tenth of the loss's time constant a run, by Arrhenius; with a fixed habit, as at the median."""
    labs = Laboratories("relay")
    step = next(one for one in labs.scenario.family.reaction if set(one.reactants) == {"F"})
    for factor in (0.1, 1.0, 10.0):
        labs.begin(world={"first_limit": factor})
        agent: Any = ScriptedReaction(labs.benches[0], margin_k=margin_k)  # type: ignore[arg-type]
        for action in (labs.actions.encode("start", "rxn_0", 0, "F", "slow"), labs.actions.encode("wait")):
            labs.act(0, labs.members, np.array([action]))
        row, hottest = labs.experiments[0].places[0, 0], 0.0
        for turn in range(12):
            actions = agent.act(labs.observe(1, labs.members), None, np.array([turn]), labs.members)
            labs.act(1, labs.members, actions)
            hottest = max(hottest, float(labs.shelf.rows[row, TEMPERATURE]))
        rate = step.pre_exponential * (1.0 if margin_k is None else factor)
        limit = step.activation_energy_j_mol / (GAS * math.log(rate * 40 * 0.05 / 0.1))
        assert hottest == pytest.approx(min(limit, 348.15), abs=0.2)


@functools.cache
def team_scores(scenario: str, policy: str, episodes: int = 20) -> FloatArray:
    labs = Laboratories(scenario, episodes, split="validation")
    return play_laboratory(labs, make_policies(policy, labs, 0), None, 0).returns


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "role"), [("relay", "rxn"), ("relay", "fin"), ("refine", "rxn"), ("refine", "ext")]
)
def test_a_cooperative_scenario_needs_each_member(scenario: str, role: str) -> None:
    """With one member random, at least 0.3 of what the team gains over random play is lost."""
    names = ("scripted", "random", f"scripted,{role}=random")
    team, random, replaced = (team_scores(scenario, name).mean() for name in names)
    assert replaced <= team - 0.3 * (team - random)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "partners", "wrong", "episodes"),
    [
        ("relay", "scripted", "scripted:hot", 120),
        ("relay", "scripted:hot", "scripted", 60),
        ("refine", "scripted:hot", "scripted", 40),
    ],
)
def test_the_best_manager_of_a_cooperative_scenario_depends_on_the_partners(
    scenario: str, partners: str, wrong: str, episodes: int
) -> None:
    """The manager that counts on its partners' habits scores more than one that counts on others'."""
    gain = team_scores(scenario, partners, episodes) - team_scores(scenario, f"{partners},manager={wrong}", episodes)
    assert gain.mean() > 2.0 * gain.std() / np.sqrt(len(gain))


def test_a_manager_foresees_what_partners_with_its_habit_make() -> None:
    """A feed of known strength where the product burns early: what comes out of the oven, which differs by habit."""
    labs, made, foreseen = Laboratories(known_shop("relay", 1, within=[300.0])), [], []
    draws = labs.scenario.world.draws
    for name in ("scripted", "scripted:hot", "scripted:fixed"):
        manager: Any
        manager, *benches = make_policies(name, labs).values()
        world = {"first_limit": quantiles(draws["first_limit"], midpoints(_RATES))[-1], "second_limit": 1.0}
        labs.reset(labs.members, world={**world, "titre": dict.fromkeys(draws["titre"].of, manager._titres[-1])})
        run_experiment(labs, [None, *benches], ("rxn_0", "F", "slow"), labs.members)
        made.append(labs.shelf.vessel(0, 0).amounts()["F"])
        foreseen.append(manager._made[0, 0, 0, -1, -1, -1])
    assert foreseen == pytest.approx(made, rel=1e-9)
    assert np.diff(np.sort(made)).min() > 0.02


@pytest.mark.parametrize("margin_k", [0.0, None])
def test_a_funnel_that_is_told_takes_more_water_where_water_takes_less(margin_k: float | None) -> None:
    """At equal shares of an impurity in a wash, by the law of partition; with a fixed habit, as at the median."""
    labs = Laboratories("refine")
    sizes = np.array([0.05, 0.1, 0.2, 0.3, 0.4])
    for polarity in (0.5, 0.7, 0.9):
        labs.begin(world={"washing": polarity})
        for action in (labs.actions.encode("start", "ext_0", 0, "F", "slow"), labs.actions.encode("wait")):
            labs.act(0, labs.members, np.array([action]))
        seen, mask = labs.observe(2, labs.members), labs.mask(2, labs.members)
        funnel = ScriptedExtraction(labs.benches[1], margin_k=margin_k)  # type: ignore[arg-type]
        action = int(funnel.act(seen, mask, np.zeros(1, np.int64), labs.members)[0])
        litres, at = 3.0 * 0.09213842 / 0.8622, 0.7 if margin_k is None else polarity  # of toluene
        wanted = litres * 0.6 / 0.4 * (1.0 - at) / (at - 0.099)
        meaning = labs.benches[1].action_meanings[action]
        assert meaning == f"add water to EV, {sizes[np.abs(sizes - wanted).argmin()]:g} L"


def test_reports_decide_what_a_manager_takes_a_rate_for() -> None:
    """The manager believes a higher rate of loss, and so a cooler oven, after runs that made less than others."""
    believed = []
    for factor in (0.05, 20.0):
        labs = Laboratories("relay", 1)
        labs.begin(3, world={"first_limit": factor})
        policies = list(make_policies("scripted", labs, 0).values())
        Players(labs, policies).play_on(labs.members)
        rates = policies[0].get_memory()[0][0].rates[0]
        believed.append(float(rates @ np.arange(len(rates))))
    assert believed[0] < believed[1]


def submitted(specification: dict[str, Any], **contents: float) -> Laboratories:
    """A laboratory with one vessel, in which any may be submitted, after its submission."""
    values = mapping("campaign") | {"world": {}, "demand": {}}
    values["specifications"] = {"2-chlorohexane": specification}
    values["shelf"]["vessel"][0]["contents"] = {"2-chlorohexane": 3.0, "1-chlorohexane": 1.0, **contents}
    labs = Laboratories(load_scenario(values))
    labs.begin(0)
    labs.act(0, labs.members, np.array([labs.actions.encode("submit", 0, 0)]))
    return labs


def test_what_falls_short_of_its_specification_is_worth_nothing() -> None:
    """Three moles of four, of which an order gets three quarters of a quarter of the score."""
    for specification, met in (
        ({}, True),
        ({"purity_at_least": 0.749}, True),
        ({"purity_at_least": 0.751}, False),
        ({"amount_at_least_mol": 2.999}, True),
        ({"amount_at_least_mol": 3.001}, False),
    ):
        labs = submitted(specification)
        worth = pytest.approx(0.25 * 3.0 / 4.0 * 0.75 if met else 0.0, rel=1e-12)
        assert (labs.rewards[0, 0], labs.result(labs.members)[0]) == (worth, worth), specification


def test_purity_may_be_meant_among_some_materials() -> None:
    """Six moles of ether leave three in four of the isomers what they are: 0.75 as without it, 0.3 of everything."""
    for among, purity in ((["1-chlorohexane", "2-chlorohexane"], 0.75), ([], 0.3)):
        labs = submitted({"purity_among": among}, diethyl_ether=6.0)
        assert labs.outcome()["orders"][0]["purity"] == pytest.approx(purity, rel=1e-12)
        assert labs.result(labs.members)[0] == pytest.approx(0.25 * 3.0 / 4.0 * purity, rel=1e-12)


def test_purity_among_what_is_not_there_is_refused() -> None:
    def campaign(**changed: Any) -> dict[str, Any]:
        return mapping("campaign") | {"demand": {}} | changed

    itself = "purity_among: '2-chlorohexane' itself must be one of them"
    among = {"purity_among": ["1-chlorohexane"]}
    refused(itself, load_scenario, campaign(specifications={"2-chlorohexane": among}))
    nothing = {"purity_among": ["2-chlorohexane", "toluene"]}
    said = "purity_among: 'toluene' cannot occur; known: "
    refused(said, load_scenario, campaign(specifications={"2-chlorohexane": nothing}))
    # It counts for the goal, whatever is asked for.
    refused(r"grades\.g\.purity_among", load_scenario, campaign(grades={"g": among}))
    refused(r"demand\.order\.0\.purity_among", load_scenario, campaign(orders=1, demand={"order": [among]}))
