"""Scenes say what is in the arrays, in true proportions, and leave the arrays as they are."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import FEATURED, laboratory, manager, mapping, molar_volume
from moments import episode, filled

from chemlab.agents.episodes import PlayedTurn, play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.chemistry import AMOUNTS, CAPACITY
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX
from chemlab.render.scene import (
    MIXTURE_SLICES,
    Camera,
    VesselPicture,
    bench_scene,
    laboratory_scene,
    material_pictures,
    visible_scene,
)

WURTZ = load_scenario("wurtz_any")


def slot_0(labs: Laboratories) -> VesselPicture:
    return laboratory_scene(labs).shelf[0].vessel


def litres(name: str, mol: float) -> float:
    return mol * molar_volume(WURTZ, name)


def test_layers_have_the_volumes_of_what_they_consist_of_densest_first() -> None:
    vessel = slot_0(filled({"diethyl_ether": 3.0, "water": 10.0, "Na": 0.5, "NaCl": 1.0}))
    assert [(layer.material, layer.phase) for layer in vessel.layers] == [
        ("NaCl", "solid"),  # 2.165 kg/L
        ("Na", "solid"),  # 0.97 kg/L
        ("water", "liquid"),
        ("diethyl_ether", "liquid"),
    ]
    expected = [litres("NaCl", 1.0), litres("Na", 0.5), litres("water", 10.0), litres("diethyl_ether", 3.0)]
    np.testing.assert_allclose([layer.volume_l for layer in vessel.layers], expected, rtol=1e-6)
    assert (vessel.volume_l, vessel.mixture) == (pytest.approx(sum(expected)), ())
    assert dict(vessel.contents) == {"diethyl_ether": 3.0, "water": 10.0, "Na": 0.5, "NaCl": 1.0}


def test_without_a_solvent_solutes_are_layers_and_ions_a_crust() -> None:
    vessel = slot_0(filled({"dodecane": 1.0, "Na+": 0.5, "Cl-": 0.5}))
    phases = {layer.material: layer.phase for layer in vessel.layers}
    assert phases == {"Na+": "solid", "Cl-": "solid", "dodecane": "liquid"}
    assert vessel.layers[-1].volume_l == pytest.approx(litres("dodecane", 1.0), rel=1e-6)
    crust = sum(layer.volume_l for layer in vessel.layers[:-1])
    assert crust == pytest.approx(litres("Na+", 0.5) + litres("Cl-", 0.5), rel=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.5, 0.7, 0.9])
def test_while_it_settles_every_liquid_keeps_its_volume_and_the_denser_one_sinks(share: float) -> None:
    clock = T_MIX + share * (CLOCK_SETTLED - T_MIX)
    vessel = slot_0(filled({"diethyl_ether": 4.0, "water": 20.0, "Na": 0.2}, clock=clock))
    assert vessel.settling == pytest.approx(share, abs=1e-9)
    volumes = np.array([layer.volume_l for layer in vessel.layers if layer.phase == "liquid"])
    np.testing.assert_allclose(volumes, [litres("water", 20.0), litres("diethyl_ether", 4.0)], rtol=1e-6)
    if vessel.mixture:
        mixture = np.array(vessel.mixture)
        np.testing.assert_allclose(mixture.sum(axis=1), 1.0, atol=1e-6)
        np.testing.assert_allclose(mixture.mean(axis=0), volumes / volumes.sum(), atol=1e-6)
        assert (np.diff(mixture[:, 0]) < 1e-6).all()
        assert mixture.shape == (MIXTURE_SLICES, 2)
        assert (np.ptp(mixture[:, 0]) < 1e-6) == (share == 0.0), "freshly stirred, it is the same at every height"
    else:
        assert share > 0.5


@pytest.mark.parametrize("name", FEATURED)
def test_layers_add_up_to_the_contents_throughout_an_episode(name: str) -> None:
    seen = 0
    for scene in episode(name):
        vessels = [slot.vessel for slot in scene.shelf] + [v for bench in scene.benches for v in bench.vessels]
        for vessel in vessels:
            if vessel is not None:
                seen += 1
                assert sum(layer.volume_l for layer in vessel.layers) == pytest.approx(vessel.volume_l, abs=1e-6)
                assert vessel.capacity_l <= scene.largest_capacity_l
    assert seen > 10


def test_a_bench_holds_what_was_brought_to_it_and_the_shelf_keeps_places_for_it() -> None:
    labs = filled({"diethyl_ether": 4.0, "dodecane": 0.3})
    labs.act(0, labs.members, np.array([labs.actions.encode("start", "ext_0", 0, "dodecane")]))
    scene = laboratory_scene(labs)
    assert scene.shelf[0].vessel is None
    # Vessels stand in slots 0 and 1 of the scenario; the beakers' places are the next two.
    assert [slot.slot for slot in scene.shelf if slot.reserved_for == "ext_0"] == [0, 2, 3]
    bench = next(bench for bench in scene.benches if bench.agent == "ext_0")
    assert (bench.busy, bench.goal, bench.step, bench.step_limit) == (True, "dodecane", 0, 50)
    assert [vessel.position for vessel in bench.vessels] == ["EV", "B1", "B2"]
    assert bench.vessels[0].volume_l == pytest.approx(litres("diethyl_ether", 4.0) + litres("dodecane", 0.3))
    assert all(vessel.volume_l == 0.0 for vessel in bench.vessels[1:])
    assert not any(other.busy or other.vessels for other in scene.benches if other is not bench)


def test_what_an_agent_sees_is_its_observation() -> None:
    batch = ExperimentBatch("wurtz_dodecane", "dit", 3)
    for member in range(3):
        batch.seed(member, member)
    batch.reset(batch.members)
    batch.act(np.full(3, 6))
    observation = batch.observe()
    for member in range(3):
        (bench,) = bench_scene(batch, member).benches
        told = np.concatenate([channel.values for channel in bench.seen])
        np.testing.assert_array_equal(told, observation[member, : len(told)])
        assert len(told) + len(batch.bench.goals.names) == observation.shape[1]
        np.testing.assert_allclose(bench.vessels[0].camera, bench.seen[0].values, rtol=1e-6)  # float32 is seen


def test_readings_are_what_was_measured() -> None:
    """And every chromatograph names its own bars."""
    instruments = {name: {"kind": name} for name in ("hplc", "gas_chromatograph", "thermometer", "balance")}
    env = laboratory({**mapping("salt_from_oil"), "name": "measured", "instruments": instruments})
    for name in instruments:
        manager(env, "measure", 0, name)
    slot, other, *_ = laboratory_scene(env.laboratories).shelf
    readings = {reading.instrument: reading for reading in slot.readings}
    for name, rest in (("hplc", "ions"), ("gas_chromatograph", "residue")):
        assert readings[name].labels[-1] == rest
        assert len(readings[name].labels) == len(readings[name].values)
    shares = dict(zip(readings["gas_chromatograph"].labels, readings["gas_chromatograph"].values, strict=True))
    assert shares == pytest.approx({"water": 0.0, "hexane": 4 / 5.5, "dodecane": 0.5 / 5.5, "residue": 1 / 5.5})
    told = {name: readings[name] for name in ("thermometer", "balance")}
    kelvin, kilograms = (one.low + one.values[0] * (one.high - one.low) for one in told.values())
    assert kelvin == pytest.approx(slot.vessel.temperature_k)
    masses = {name: m.molar_mass_g_mol / 1000.0 for name, m in env.scenario.materials.items()}
    assert kilograms == pytest.approx(sum(mol * masses[name] for name, mol in slot.vessel.contents), rel=0.01)
    assert not other.readings


def test_costs_stock_and_waste_are_the_laboratorys() -> None:
    labs = filled({"diethyl_ether": 4.0})
    labs.shelf.stock[0, labs.shelf.layout.index("Na")] -= 2.0
    labs.shelf.waste[0, labs.shelf.layout.index("water")] = 5.0
    labs.act(0, labs.members, np.array([labs.actions.encode("measure", 0, "uv_vis")]))
    scene = laboratory_scene(labs)
    costs = dict(scene.costs)
    prices = WURTZ.costs
    assert costs["instruments"] == pytest.approx(WURTZ.instruments["uv_vis"].price)
    assert costs["stock"] == pytest.approx(2.0 * prices.stock_per_mol["Na"])
    assert scene.waste_l == pytest.approx(litres("water", 5.0))
    assert costs["waste"] == pytest.approx(scene.waste_l * prices.waste_per_l)
    assert scene.result == pytest.approx(-sum(costs.values()))
    bottle = next(bottle for bottle in scene.stock if bottle.material == "Na")
    assert (bottle.mol, bottle.full_mol) == (1.0, 3.0)


@pytest.mark.parametrize("name", FEATURED)
def test_a_look_changes_nothing(name: str) -> None:
    env = laboratory(name, 3)
    labs = env.laboratories

    def watch(turn: PlayedTurn) -> None:
        before = labs.snapshot()
        laboratory_scene(labs)
        for array, kept in zip(labs.snapshot(), before, strict=True):
            np.testing.assert_array_equal(array, kept)

    play_episode(env, make_policies("random", labs, 3), 3, watch=watch)


@pytest.mark.parametrize(("name", "policy"), [("refine", "scripted"), ("wurtz_two_lines", "random")])
def test_a_camera_that_keeps_pictures_sees_what_a_new_one_sees(name: str, policy: str) -> None:
    env = laboratory(name)
    labs = env.laboratories
    camera, equal = Camera(labs.scenario, labs.shelf), list[bool]()

    def compare(turn: PlayedTurn) -> None:
        equal.append(laboratory_scene(labs, camera=camera) == laboratory_scene(labs))

    play_episode(env, make_policies(policy, labs, 0), 0, watch=compare)
    assert len(equal) > 20
    assert all(equal)


@pytest.mark.parametrize("name", FEATURED)
def test_materials_have_tags_and_colours_of_their_own(name: str) -> None:
    scenario = load_scenario(name)
    pictures = material_pictures(scenario)
    assert {picture.name for picture in pictures} == {n for n, m in scenario.materials.items() if m.role != "gas"}
    tags, colors = {picture.tag for picture in pictures}, {picture.color for picture in pictures}
    assert len(tags) == len(colors) == len(pictures)
    assert all(0 < len(tag) <= 4 for tag in tags)


def test_pictures_of_hidden_parameters_show_what_people_see() -> None:
    """Worlds that look alike give one picture; that of the true contents tells them apart, and says so by its mode."""

    def pictures(mode: str) -> set[bytes]:
        env = raw_env("unlabelled", render_mode=mode)
        found = set()
        for seed in range(4):
            env.reset(seed=seed, options={"goal": "dodecane"})
            frame = env.render()
            assert isinstance(frame, np.ndarray)
            found.add(frame.tobytes())
        return found

    assert len(pictures("rgb_array")) == 1
    assert len(pictures("rgb_array_true")) == 4
    wurtz = laboratory("wurtz_dodecane")
    scene = laboratory_scene(wurtz.laboratories)
    assert visible_scene(scene, wurtz.scenario) is scene
    relay = laboratory("relay")
    scene = laboratory_scene(relay.laboratories)
    assert scene.result == float(relay.laboratories.result(relay.laboratories.members)[0]) < 0.0
    assert np.isnan(visible_scene(scene, relay.scenario).result), "its orders are paid at the end"


def test_a_bench_shows_nothing_before_its_first_turn() -> None:
    """Starting and recalling a bench is no free look at a vessel's layers and channels."""
    env = laboratory("unlabelled")
    env.step(env.laboratories.actions.encode("start", "rxn_0", 0, "dodecane"))
    (bench,) = [b for b in visible_scene(laboratory_scene(env.laboratories), env.scenario).benches if b.busy]
    assert bench.seen == ()
    assert [layer.material for layer in bench.vessels[0].layers] == [""]
    assert bench.vessels[0].contents == ()
    env.step(env.laboratories.actions.encode("wait"))
    (bench,) = [b for b in visible_scene(laboratory_scene(env.laboratories), env.scenario).benches if b.busy]
    assert [channel.name for channel in bench.seen] == ["temperature", "pressure", "reagents"], "others always read 0"
    assert bench.vessels[0].contents == ()


@pytest.mark.parametrize(("name", "agent"), [("rush", "rxn_0"), ("unlabelled", "dit_0")])
def test_pictures_of_hidden_parameters_have_the_resolution_of_observations(name: str, agent: str) -> None:
    """At a bench no layer, piston or camera tells of the contents, and the stock no trace that a bench has taken."""
    labs = Laboratories(name, 4)
    labs.begin()
    for action in (("start", agent, 0, labs.scenario.goals[0]), ("wait",)):
        labs.act(0, labs.members, np.full(4, labs.actions.encode(*action)))
    gauge, full = labs.scenario.shelf.gauge, labs.scenario.stock
    labs.shelf.stock[:] *= 1.0 - 0.1 * gauge
    labs.shelf.waste[:] = labs.safety_totals[:] = 1e-3
    for member, row in enumerate(labs.shelf.vessels[:, 1]):  # an overfull vessel
        row[AMOUNTS:] *= 1.0 + 0.01 * member
        row[CAPACITY] = labs.shelf.vessel(member, 1).volume_l / 0.98
    number, scenes = labs.bench_agents.index(agent), [laboratory_scene(labs, member) for member in range(4)]
    assert len({scene.benches[number].vessels for scene in scenes}) == 4
    seen = [visible_scene(scene, labs.scenario) for scene in scenes]
    vessels = [[replace(vessel, camera=()) for vessel in scene.benches[number].vessels] for scene in seen]
    assert all(own == vessels[0] for own in vessels)
    assert [(bottle.material, bottle.mol) for bottle in seen[0].stock] == list(full.items())
    assert (seen[0].waste_l, seen[0].safety) == (0.0, ())
    assert np.isnan(seen[0].result)
    full_ones = [scene.shelf[1].vessel for scene in seen]
    assert all(vessel is not None and vessel.volume_l == vessel.capacity_l for vessel in full_ones)
    for scene in seen:
        shown = {channel.name: channel.values for channel in scene.benches[number].seen}
        for vessel in scene.benches[number].vessels:
            assert vessel.camera == shown.get(f"layers_{vessel.position}", ())
