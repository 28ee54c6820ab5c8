"""The manager against closed forms: its action table, what its actions do, its charges, and what it sees."""

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, allowed, laboratory, litres, manager, refused

from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.text import named_costs, named_events
from chemlab.physics.shelf import Shelf
from chemlab.physics.spectra import spectrum
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import ManagerActions
from chemlab.roles.manager_state import COST_ITEMS

WURTZ = "wurtz_dodecane"


def do(env: raw_env, meaning: str) -> None:
    """Let the selected bench, which has discrete actions, do what ``meaning`` says."""
    bench = env.laboratories.benches[env.possible_agents.index(env.agent_selection) - 1]
    env.step(bench.action_meanings.index(meaning))


def seen(env: raw_env, name: str) -> npt.NDArray[np.float32]:
    """One part of what the manager sees."""
    return env.observe("manager_0")[channel_slices(env.laboratories.channels)[name]]


def occupied(env: raw_env) -> list[int]:
    """Slots on which the manager sees a vessel."""
    return [s for s in range(env.scenario.shelf.slots) if seen(env, f"slot_{s}_occupied")[0] == 1.0]


@pytest.mark.parametrize("name", FEATURED)
def test_every_action_has_one_number_and_one_meaning(name: str) -> None:
    scenario = load_scenario(name)
    actions = ManagerActions.of(scenario)
    decoded = [actions.decode(number) for number in range(len(actions))]
    assert [actions.encode(*action) for action in decoded] == list(range(len(actions)))  # type: ignore[arg-type]
    assert len(set(actions.action_meanings)) == len(actions)
    slots = range(scenario.shelf.slots)
    asked = [(g, k) for g in scenario.goals for k in scenario.grades] or [(g,) for g in scenario.goals]
    expected = {("start", b, s, *goal) for b in scenario.bench_agents() for s in slots for goal in asked}
    expected |= {("measure", s, i) for s in slots for i in scenario.instruments}
    expected |= {("discard", s) for s in slots}
    orders = [(o,) for o in range(scenario.orders)] if scenario.orders > 1 else [()]
    expected |= {("submit", s, *order) for s in slots for order in orders}
    expected |= {("recall", b) for b in scenario.bench_agents()} | {("wait",)}
    wearing = {key for key, bench in scenario.benches.items() if bench.wear is not None}
    expected |= {("repair", b) for b in scenario.bench_agents() if b.rpartition("_")[0] in wearing}
    expected |= {("calibrate", n) for n, one in scenario.instruments.items() if one.drift is not None}
    assert set(decoded) == expected


def test_an_action_that_does_not_exist_is_refused() -> None:
    actions = ManagerActions.of(load_scenario(WURTZ))
    for action, part in (
        (("ponder",), "'ponder'"),
        (("start", "rxn_0", 0), "takes 3"),
        (("start", "rxn_9", 0, "dodecane"), "'rxn_9'"),
        (("start", "rxn_0", 8, "dodecane"), "8"),
        (("start", "rxn_0", 0, "gold"), "'gold'"),
        (("discard", -1), "-1"),
    ):
        refused(f"manager action.*{part}", actions.encode, *action)


def test_starting_reserves_slots_and_is_masked_without_them() -> None:
    env = laboratory({"base": WURTZ, "shelf": {"slots": 4}})
    starts = {bench: ("start", bench, 1, "dodecane") for bench in ("rxn_0", "ext_0", "dit_0")}
    # Two vessels, two free slots: an extraction takes the vessel and reserves both free slots for its beakers.
    assert all(allowed(env, *start) for start in starts.values())
    manager(env, "start", "ext_0", 0, "dodecane")
    assert occupied(env) == [1]
    assert not allowed(env, *starts["ext_0"])  # busy
    assert not allowed(env, *starts["dit_0"])  # no slots for its beakers
    assert allowed(env, *starts["rxn_0"])  # nothing comes back but the vessel itself
    for slot in (0, 2, 3):  # nothing stands there
        assert not allowed(env, "start", "rxn_0", slot, "dodecane")
        assert not allowed(env, "measure", slot, "balance")
        assert not allowed(env, "discard", slot)
        assert not allowed(env, "submit", slot)
    # Its beakers stayed empty: they are gone, and their slots are free again.
    manager(env, "recall", "ext_0")
    assert occupied(env) == [0, 1]
    assert all(allowed(env, *start) for start in starts.values())
    # The slot that a vessel left is kept for it: of three, two are not left for the beakers of an extraction.
    env = laboratory({"base": WURTZ, "shelf": {"slots": 3}})
    manager(env, "start", "rxn_0", 0, "dodecane")
    assert not allowed(env, *starts["ext_0"])


def test_vessels_come_back_main_to_its_origin_others_to_reserved_slots() -> None:
    env = laboratory(WURTZ)
    shelf = env.laboratories.shelf
    shelf.fill(0, 1, 1.2, {"diethyl_ether": 4.0, "dodecane": 1.0})
    manager(env, "start", "ext_0", 1, "dodecane")
    assert occupied(env) == [0]
    manager(env, "wait")
    do(env, "pour EV -> B2, 40 %")
    do(env, "end the experiment")
    # EV stands where it came from; B1 stayed empty; B2 is on the first free slot.
    assert env.agent_selection == "manager_0"
    assert occupied(env) == [0, 1, 2]
    assert shelf.vessel(0, 1).amounts(1e-9) == pytest.approx({"diethyl_ether": 2.4, "dodecane": 0.6}, rel=1e-12)
    assert shelf.vessel(0, 2).amounts(1e-9) == pytest.approx({"diethyl_ether": 1.6, "dodecane": 0.4}, rel=1e-12)
    # Slots keep their vessel's history: none, ext as main vessel, ext as B2.
    keys = ["none", *env.scenario.benches]
    assert [keys[int(seen(env, f"slot_{s}_last_bench").argmax())] for s in (0, 1, 2)] == ["none", "ext", "ext"]
    positions = [seen(env, f"slot_{s}_last_position").tolist() for s in (0, 1, 2)]
    assert positions == [[0, 0, 0], [1, 0, 0], [0, 0, 1]]


def test_a_vessel_on_the_shelf_rests() -> None:
    env = laboratory(WURTZ)
    labs = env.laboratories
    labs.shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "dodecane": 1.0, "NaCl": 1.0})
    manager(env, "start", "dit_0", 0, "dodecane")
    manager(env, "wait")
    do(env, "heat DV, 20 kJ")
    do(env, "heat DV, 20 kJ")
    assert labs.shelf.rows[labs.experiments[2].places[0, 0], 0] > 300.0
    do(env, "end the experiment")
    ambient = env.scenario.ambient_temperature_k
    for slot in occupied(env):
        vessel = labs.shelf.vessel(0, slot)
        assert vessel.temperature_k == ambient
        assert vessel.settling == 1.0
        # Precipitation equilibrium: [salt][solvent] = [cation][anion]; the volume cancels (PHYSICS section 5).
        mol = dict(zip(env.scenario.materials, labs.shelf.amounts[0, slot], strict=True))
        assert mol["NaCl"] * mol["diethyl_ether"] == pytest.approx(mol["Na+"] * mol["Cl-"], rel=1e-9, abs=1e-12)


def test_recalling_frees_the_bench_and_keeps_the_turn() -> None:
    env = laboratory(WURTZ)
    manager(env, "start", "ext_0", 0, "dodecane")
    manager(env, "start", "rxn_0", 1, "dodecane")
    assert occupied(env) == []
    assert allowed(env, "recall", "ext_0")
    assert not allowed(env, "recall", "dit_0")
    manager(env, "recall", "ext_0")
    assert env.laboratories.busy[:, 0].tolist() == [True, False, False]
    assert occupied(env) == [0]
    assert not allowed(env, "recall", "ext_0")
    assert allowed(env, "start", "ext_0", 0, "dodecane")
    # The reaction goes on; when it is recalled too, there is nothing to wait for.
    assert allowed(env, "wait")
    manager(env, "recall", "rxn_0")
    assert not allowed(env, "wait")
    assert env.laboratories.state.ticks[0] == 0


def test_a_recalled_experiment_pays_for_what_it_lost() -> None:
    """And its accident, where accidents have a price."""
    safety = {"reward_price": 0.125, "weights": {"spill_l": 2.0}}
    env = laboratory({"base": WURTZ, "benches": {"ext": {"auxiliary_capacity_l": 0.2}}, "safety": safety})
    env.laboratories.shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "dodecane": 1.0})
    manager(env, "start", "ext_0", 0, "dodecane")
    manager(env, "start", "rxn_0", 1, "dodecane")
    manager(env, "wait")
    env.step(np.array([0.5, 0.5, 0.0, 0.0, 0.0, 0.0]))
    do(env, "pour EV -> B2, 100 %")  # 0.64 L into 0.2 L
    filled = litres(env.scenario, {"diethyl_ether": 4.0, "dodecane": 1.0})
    spilled = filled - 0.2
    assert named_events(env.scenario, env.infos["ext_0"]) == pytest.approx({"spill_l": spilled}, rel=1e-9)
    assert env.infos["ext_0"]["cost"] == pytest.approx(2.0 * spilled, rel=1e-9)
    assert env.rewards["ext_0"] == pytest.approx(-0.125 * 2.0 * spilled, rel=1e-9)
    assert env.laboratories.costs()["safety"] == pytest.approx(0.125 * 2.0 * spilled, rel=1e-9)
    while env.agent_selection != "manager_0":
        env.step(np.array([0.5, 0.5, 0.0, 0.0, 0.0, 0.0]) if env.agent_selection == "rxn_0" else 39)
    manager(env, "recall", "ext_0")
    # Pure dodecane (ether does not count) before and after; what is left of it is what fits into B2.
    assert env.rewards["ext_0"] == pytest.approx(0.2 / filled - 1.0, rel=1e-9)
    assert env.infos["ext_0"]["score"] == env.rewards["ext_0"]
    assert not env.laboratories.busy.any()
    assert env.agent_selection == "manager_0"


def test_what_the_instruments_read() -> None:
    contents = {"water": 5.0, "diethyl_ether": 4.0, "dodecane": 1.0}
    env = laboratory({"base": WURTZ, "shelf": {"vessel": [{"capacity_l": 1.2, "contents": contents}]}})
    scenario, labs = env.scenario, env.laboratories
    for instrument in ("gas_chromatograph", "layer_camera", "uv_vis"):
        manager(env, "measure", 0, instrument)
    # Chromatograph: mole fractions of the volatile materials, in the order its channel names; the residue is last.
    channel = next(channel for channel in labs.channels if channel.name == "slot_0_gas_chromatograph")
    names = channel.meaning.removeprefix("last reading: ").split(", ")
    fractions = dict(zip(names, seen(env, "slot_0_gas_chromatograph").tolist(), strict=True))
    for name, mol in contents.items():
        assert fractions.pop(name) == pytest.approx(mol / 10.0, rel=1e-6)
    assert set(fractions.values()) == {0.0}
    # Camera: bottom first, water below ether (with the dodecane in it) below air, sharp.
    shades = [scenario.materials[name].shade for name in ("water", "diethyl_ether", "air")]
    picture = seen(env, "slot_0_layer_camera")
    nearest = np.abs(picture[:, None] - np.array(shades)).argmin(axis=1)
    assert np.abs(picture - np.array(shades)[nearest]).max() < 1e-6
    assert (np.diff(nearest) >= 0).all()
    assert (nearest < 2).sum() == pytest.approx(100.0 * litres(scenario, contents) / 1.2, abs=1.0)
    # UV-Vis: the spectrum of what is in there (its closed form: tests/physics/test_spectra.py).
    light = np.zeros(200)
    spectrum(labs.shelf.rows[0], labs.shelf.chem(), light)
    np.testing.assert_allclose(seen(env, "slot_0_uv_vis"), light, rtol=1e-5, atol=1e-6)
    assert light.max() > 0.05


def test_a_sample_goes_to_waste() -> None:
    env = laboratory({"base": WURTZ, "instruments": {"gas_chromatograph": {"sample_fraction": 0.25}}})
    labs = env.laboratories
    labs.shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "dodecane": 1.0})
    total = labs.shelf.total()
    manager(env, "measure", 0, "gas_chromatograph")
    assert labs.shelf.vessel(0, 0).amounts(1e-9) == pytest.approx({"diethyl_ether": 3.0, "dodecane": 0.75}, rel=1e-12)
    np.testing.assert_allclose(labs.shelf.total(), total, rtol=1e-12)
    # A balance takes none.
    manager(env, "measure", 0, "balance")
    assert labs.shelf.vessel(0, 0).amounts(1e-9) == pytest.approx({"diethyl_ether": 3.0, "dodecane": 0.75}, rel=1e-12)


def test_measuring_ends_with_the_budget() -> None:
    env = laboratory({"base": WURTZ, "limits": {"budget": 0.025}})
    manager(env, "measure", 0, "gas_chromatograph")  # 0.01 each
    manager(env, "measure", 0, "gas_chromatograph")
    assert seen(env, "budget")[0] == pytest.approx(0.005 / 0.025, rel=1e-5)
    assert not allowed(env, "measure", 0, "gas_chromatograph")
    assert allowed(env, "measure", 0, "uv_vis")
    manager(env, "measure", 0, "uv_vis")  # 0.002
    manager(env, "measure", 0, "uv_vis")
    manager(env, "measure", 0, "balance")  # 0.0005
    manager(env, "measure", 0, "balance")
    assert not any(allowed(env, "measure", slot, name) for slot in (0, 1) for name in env.scenario.instruments)


def test_stock_is_finite_and_shared() -> None:
    env = laboratory({"base": WURTZ, "benches": {"rxn": {"count": 2}}})
    labs, index = env.laboratories, env.laboratories.shelf.layout.index
    manager(env, "start", "rxn_0", 0, "dodecane")
    manager(env, "start", "rxn_1", 1, "dodecane")
    manager(env, "wait")
    left = channel_slices(labs.benches[0].channels)["reagents"]
    assert env.observe("rxn_1")[left].tolist() == [1.0, 1.0, 1.0, 1.0]
    # 1-chlorohexane: all; 2-chlorohexane: a quarter; sodium: all 3 mol of it; no 3-chlorohexane.
    env.step(np.array([0.5, 0.5, 1.0, 0.25, 0.0, 1.0]))
    for agent in ("rxn_0", "rxn_1"):
        np.testing.assert_allclose(env.observe(agent)[left], [0.0, 0.75, 1.0, 0.0], atol=1e-6)
    assert labs.shelf.stock[0, index("1-chlorohexane")] == pytest.approx(0.0, abs=1e-12)
    expected = {**dict.fromkeys(env.scenario.stock, 1.0), "1-chlorohexane": 0.0, "2-chlorohexane": 0.75, "Na": 0.0}
    np.testing.assert_allclose(seen(env, "stock"), list(expected.values()), atol=1e-6)
    # The other bench asks for everything and gets what there is: nothing of the first, of the second the rest.
    env.step(np.array([0.5, 0.5, 1.0, 1.0, 0.0, 1.0]))
    contents = dict(zip(env.scenario.materials, labs.shelf.amounts[0, labs.experiments[1].places[0, 0]], strict=True))
    assert contents["2-chlorohexane"] == pytest.approx(0.75, rel=1e-12)
    assert contents["1-chlorohexane"] == contents["Na"] == contents["dodecane"] == 0.0


def test_an_empty_bottle_is_masked() -> None:
    half_a_litre = 0.5 / litres(load_scenario(WURTZ), {"water": 1.0})
    env = laboratory({"base": WURTZ, "stock": {"water": half_a_litre}})
    labs = env.laboratories
    manager(env, "start", "ext_0", 0, "dodecane")
    manager(env, "wait")
    adding = labs.benches[1].action_meanings.index("add water to EV, 0.4 L")
    do(env, "add water to EV, 0.4 L")
    assert env.infos["ext_0"]["action_mask"][adding] == 1
    do(env, "add water to EV, 0.4 L")  # 0.1 L is what is left
    contents = labs.shelf.amounts[0, labs.experiments[1].places[0, 0]]
    assert contents[labs.shelf.layout.index("water")] == pytest.approx(half_a_litre, rel=1e-9)
    assert env.infos["ext_0"]["action_mask"][adding] == 0


def test_discarding_fills_the_waste_and_frees_the_slot() -> None:
    env = laboratory(WURTZ)
    labs = env.laboratories
    contents = {"diethyl_ether": 4.0, "dodecane": 0.5}
    labs.shelf.fill(0, 1, 1.2, contents)
    manager(env, "discard", 1)
    assert occupied(env) == [0]
    waste = {n: float(x) for n, x in zip(env.scenario.materials, labs.shelf.waste[0], strict=True) if x > 0.0}
    assert waste == pytest.approx(contents, rel=1e-12)
    # Without the last vessel there would be nothing left to do.
    assert not allowed(env, "discard", 0)


def test_costs_are_itemized_and_add_up() -> None:
    env = laboratory(WURTZ)
    scenario, labs, costs = env.scenario, env.laboratories, env.scenario.costs
    labs.shelf.fill(0, 0, 1.2, {"diethyl_ether": 3.0, "dodecane": 1.0})
    manager(env, "measure", 0, "uv_vis")
    manager(env, "measure", 1, "balance")
    env.step(labs.actions.encode("wait"))  # illegal: no bench is busy
    env.step(labs.actions.encode("recall", "rxn_0"))  # illegal too
    manager(env, "start", "ext_0", 1, "dodecane")
    manager(env, "wait")
    do(env, "add water to EV, 0.1 L")
    do(env, "add diethyl_ether to EV, 0.2 L")
    do(env, "settle, 6 units of settling time")
    do(env, "end the experiment")
    thrown = labs.shelf.vessel(0, 1).amounts()
    manager(env, "discard", 1)
    manager(env, "submit", 0)
    mol = {name: litre / litres(scenario, {name: 1.0}) for name, litre in (("water", 0.1), ("diethyl_ether", 0.2))}
    expected = {
        "instruments": scenario.instruments["uv_vis"].price + scenario.instruments["balance"].price,
        "stock": sum(costs.stock_per_mol[name] * used for name, used in mol.items()),
        "waste": costs.waste_per_l * litres(scenario, thrown),
        "time": 4 * costs.tick,
        "illegal_actions": 2 * costs.illegal_action,
        "safety": 0.0,
    }
    assert tuple(expected) == COST_ITEMS
    assert named_costs(env.infos["manager_0"]) == pytest.approx(expected, rel=1e-9)
    assert all(value > 0.0 for key, value in expected.items() if key != "safety")
    # 1 mol of dodecane in 4 mol, of at most 0.5.
    assert env.rewards["manager_0"] == pytest.approx(1.0 * 0.25 / 0.5 - sum(expected.values()), rel=1e-9)


def test_dissolved_salt_counts_as_salt_and_nothing_as_nothing() -> None:
    for contents, purity, paid in (({"water": 6.0, "Na+": 2.0, "Cl-": 2.0}, 2.0 / 8.0, 2.0 * (2.0 / 8.0)), ({}, 0, 0)):
        env = laboratory("salt_from_oil")
        env.laboratories.shelf.fill(0, 0, 1.2, contents)
        manager(env, "submit", 0)
        # Two pairs of ions are 2 mol of salt in 8 mol, of at most 1.
        assert env.rewards["manager_0"] == pytest.approx(paid, rel=1e-12)
        assert env.infos["manager_0"]["purity"] == pytest.approx([purity], rel=1e-12)


def test_the_outside_of_a_vessel_is_what_it_is() -> None:
    env = laboratory(WURTZ)
    labs = env.laboratories
    shelf: Shelf = labs.shelf
    largest = max([v.capacity_l for v in env.scenario.shelf.vessel] + [b.auxiliary_capacity_l for b in labs.benches])
    shelf.fill(0, 3, 0.75 * largest, {"water": 10.0})
    shelf.vessels[0, 3, 0] = 350.0
    assert seen(env, "slot_3_occupied")[0] == 1.0
    assert seen(env, "slot_3_capacity")[0] == pytest.approx(0.75, rel=1e-6)
    fill = litres(env.scenario, {"water": 10.0}) / (0.75 * largest)
    assert seen(env, "slot_3_fill")[0] == pytest.approx(fill, rel=1e-6)
    channel = next(channel for channel in labs.channels if channel.name == "slot_3_temperature")
    warmth = (350.0 - channel.low) / (channel.high - channel.low)
    assert seen(env, "slot_3_temperature")[0] == pytest.approx(warmth, rel=1e-6)
    # An empty slot is zeros, but for readings that have never been taken and a vessel that has been nowhere.
    assert seen(env, "slot_4_occupied")[0] == seen(env, "slot_4_fill")[0] == seen(env, "slot_4_capacity")[0] == 0.0


def test_the_manager_sees_its_benches() -> None:
    env = laboratory(WURTZ)
    goals = list(env.scenario.goals)
    manager(env, "start", "dit_0", 1, "NaCl")
    manager(env, "wait")
    do(env, "cool DV, 2 kJ")
    assert seen(env, "dit_0_busy")[0] == 1.0
    assert seen(env, "dit_0_goal").tolist() == [float(goal == "NaCl") for goal in goals]
    assert seen(env, "dit_0_steps_left")[0] == pytest.approx(49 / 50, rel=1e-6)
    for part in ("busy", "goal", "steps_left"):
        assert not seen(env, f"rxn_0_{part}").any()
    limits = env.scenario.limits
    assert seen(env, "actions")[0] == pytest.approx(1.0 - 2 / limits.manager_actions, rel=1e-6)
    assert seen(env, "ticks")[0] == pytest.approx(1.0 - 1 / limits.ticks, rel=1e-6)
