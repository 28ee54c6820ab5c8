"""Agents see no contents until somebody measures; laboratories that look alike are compared bit for bit."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from helpers import FEATURED, laboratory, manager

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.envs.aec import raw_env
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import CLOCK, CLOCK_WAS, PRESENT, ROLE_GAS, TEMPERATURE
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX
from chemlab.roles.bench import channel_slices
from chemlab.roles.manager_actions import MEASURE

WURTZ = "wurtz_dodecane"


def disguise(labs: Laboratories, member: int, positions: Any, rng: np.random.Generator) -> None:
    """Put something else of the same volume and temperature into vessels, mixed or settled, in any layers."""
    chem, materials = labs.shelf.known(), len(labs.shelf.layout.materials)
    for position in positions:
        row = labs.shelf.vessels[member, position]
        if row[PRESENT] == 0.0:
            continue
        volume = float(labs.shelf.amounts[member, position] @ chem.molar_volume)
        mixture = rng.random(materials) * (rng.random(materials) < 0.6) + 1e-3
        mixture[chem.role == ROLE_GAS] = 0.0  # vessels hold none
        labs.shelf.amounts[member, position] = mixture * (volume / float(mixture @ chem.molar_volume))
        labs.shelf.dissolved[member, position] = rng.random(labs.shelf.dissolved[member, position].shape)
        row[CLOCK] = row[CLOCK_WAS] = rng.uniform(T_MIX, CLOCK_SETTLED)


def play(labs: Laboratories, rng: np.random.Generator, measure: bool = True) -> int | None:
    """One random legal turn of whoever has it, without submissions; the agent, None at the end of the episode."""
    if labs.state.status[0] != 0:
        return None
    number = labs.turn()
    mask = labs.mask(number, labs.members)
    if mask is None:
        action: npt.NDArray[Any] = rng.random((1, *labs.action_space(number).shape))  # type: ignore[misc]
    else:
        legal = np.flatnonzero(mask[0])
        if number == 0:
            names = [labs.actions.decode(int(a))[0] for a in legal]
            banned = {"submit", "discard"} | (set() if measure else {"measure"})
            legal = np.array([a for a, name in zip(legal, names, strict=True) if name not in banned])
            if not len(legal):
                return None
            weights = np.array([8.0 if labs.actions.decode(int(a))[0] == "wait" else 1.0 for a in legal])
            action = np.array([rng.choice(legal, p=weights / weights.sum())])
        else:
            keep = legal[legal != labs.benches[number - 1].end_action]
            action = np.array([rng.choice(keep if len(keep) and rng.random() < 0.95 else legal)])
    labs.act(number, labs.members, action)
    return number


@pytest.mark.parametrize("name", FEATURED)
def test_the_manager_sees_no_contents_in_running_laboratories(name: str) -> None:
    """In the middle of random play, with benches at work: exchange everything that is hidden; nothing changes."""
    labs = Laboratories(name)
    labs.begin(1)
    rng = np.random.default_rng(1)
    worked, at = 0, channel_slices(labs.channels)
    for turn in range(400):
        if play(labs, rng) is None:
            labs.reset(labs.members)
        if turn % 5:
            continue
        seen, mask, before = labs.observe(0, labs.members), labs.mask(0, labs.members), labs.snapshot()
        worked += labs.busy.any()
        for slot in np.flatnonzero(labs.shelf.vessels[0, : labs.scenario.shelf.slots, PRESENT] == 0.0):
            for part in (part for part in at if part.startswith(f"slot_{slot}_")):  # no reading, no history
                assert (seen[0, at[part]] == float(part.endswith("_age"))).all(), part
        disguise(labs, 0, range(labs.vessels_per_laboratory), rng)
        labs.shelf.waste[:] = rng.random(labs.shelf.waste.shape)
        labs.state.delivered[:] = rng.random(labs.state.delivered.shape)
        labs.state.submitted[:] = rng.random(labs.state.submitted.shape)
        labs.state.stream[:] = 12345
        labs.safety_totals[:] = rng.random(labs.safety_totals.shape)
        for experiments in labs.experiments:
            experiments.baseline[:], experiments.events[:] = rng.random(), rng.random(experiments.events.shape)
            experiments.stream[:] = 54321
            if hasattr(experiments, "image"):
                experiments.image[:] = rng.random(experiments.image.shape)
                experiments.changed[:] = True
        for array in (labs.rewards, labs.cost, labs.scores):
            array[...] = rng.random(array.shape)
        np.testing.assert_array_equal(labs.observe(0, labs.members), seen)
        np.testing.assert_equal(labs.mask(0, labs.members), mask)
        labs.restore(before)
    assert worked > 10


@pytest.mark.parametrize("name", ["failing", "wurtz_two_lines"])
def test_benches_see_nothing_but_their_own(name: str) -> None:
    """What is on the shelf, at other benches, ordered, measured or wasted makes no difference to a bench's view."""
    labs = Laboratories(name)
    labs.begin(2)
    rng = np.random.default_rng(2)
    looked = np.zeros(len(labs.experiments), dtype=int)
    # Experiments on benches with real physics are longer: it takes more turns to see each.
    for turn in range(500 if labs.scenario.physics == "paper" else 1000):
        if play(labs, rng) is None:
            labs.reset(labs.members)
        if turn % 5:
            continue
        for b, experiments in enumerate(labs.experiments):
            seen, mask = labs.observe(b + 1, labs.members), labs.mask(b + 1, labs.members)
            before = labs.snapshot()
            looked[b] += experiments.busy[0]
            own = set(experiments.places[0].tolist())
            others = [p for p in range(labs.vessels_per_laboratory) if p not in own]
            disguise(labs, 0, others, rng)
            labs.shelf.vessels[0, others, TEMPERATURE] += 5.0
            labs.shelf.waste[:] = rng.random(labs.shelf.waste.shape)
            for array in (labs.state.goal, labs.state.ticks, labs.state.actions):
                array[:] = 0
            labs.state.reading[:], labs.state.age[:] = rng.random(labs.state.reading.shape), 3
            labs.state.charges[:] = rng.random(labs.state.charges.shape)
            labs.state.submitted[:] = rng.random(labs.state.submitted.shape)
            for other in labs.experiments:
                if other is not experiments:
                    other.goal[:], other.steps[:] = 0, 7
                    if hasattr(other, "image"):
                        other.image[:] = rng.random(other.image.shape)
            experiments.baseline[:] = rng.random()
            np.testing.assert_array_equal(labs.observe(b + 1, labs.members), seen)
            np.testing.assert_equal(labs.mask(b + 1, labs.members), mask)
            labs.restore(before)
    assert (looked > 0).all()


def reading(env: raw_env, slot: int, instrument: str) -> tuple[npt.NDArray[np.float32], float]:
    """(what the manager sees of a reading, its age)."""
    seen, at = env.observe("manager_0"), channel_slices(env.laboratories.channels)
    return seen[at[f"slot_{slot}_{instrument}"]], float(seen[at[f"slot_{slot}_{instrument}_age"]][0])


def test_a_reading_ages_with_ticks_alone() -> None:
    env = laboratory(WURTZ)
    limit, first = env.scenario.limits.ticks, {}
    env.laboratories.shelf.fill(0, 0, 1.2, {"diethyl_ether": 3.0, "dodecane": 1.0})
    for instrument in env.scenario.instruments:
        assert reading(env, 0, instrument)[1] == 1.0
        manager(env, "measure", 0, instrument)
        first[instrument], age = reading(env, 0, instrument)
        assert age == 0.0
        assert first[instrument].any()
    manager(env, "start", "rxn_0", 1, "dodecane")
    manager(env, "wait")
    for tick in range(1, env.scenario.benches["rxn"].step_limit + 1):
        env.step(np.array([0.5, 0.5, 0.0, 0.0, 0.0, 0.0]))
        for instrument, shown in first.items():
            values, age = reading(env, 0, instrument)
            np.testing.assert_array_equal(values, shown)
            assert age == pytest.approx(tick / limit, rel=1e-6)
    # A new reading is young again.
    manager(env, "measure", 0, "balance")
    assert reading(env, 0, "balance")[1] == 0.0


@pytest.mark.parametrize("way", ["recall", "end"])
def test_a_reading_goes_when_its_vessel_goes_to_a_bench(way: str) -> None:
    """What comes back is another vessel, as far as the manager knows."""
    env = laboratory(WURTZ)
    env.laboratories.shelf.fill(0, 0, 1.2, {"diethyl_ether": 3.0, "dodecane": 1.0})
    for slot in (0, 1):
        for instrument in env.scenario.instruments:
            manager(env, "measure", slot, instrument)
    kept = {instrument: reading(env, 1, instrument)[0] for instrument in env.scenario.instruments}
    manager(env, "start", "ext_0", 0, "dodecane")
    assert not any(reading(env, 0, instrument)[0].any() for instrument in kept)
    if way == "recall":
        manager(env, "recall", "ext_0")
    else:
        manager(env, "wait")
        env.step(env.laboratories.benches[1].end_action)
    seen, at = env.observe("manager_0"), channel_slices(env.laboratories.channels)
    assert seen[at["slot_0_occupied"]] == 1.0
    for instrument, shown in kept.items():
        values, age = reading(env, 0, instrument)
        assert age == 1.0
        assert not values.any()
        np.testing.assert_array_equal(reading(env, 1, instrument)[0], shown)


def test_readings_that_are_left_out_change_nothing_else() -> None:
    """The same episodes, number by number, without the channels of what is not among ``readings``."""
    kept = ["balance", "gas_chromatograph"]
    full = Laboratories(WURTZ, 3)
    compact = Laboratories(load_scenario({"base": WURTZ, "name": "compact", "manager": {"readings": kept}}), 3)
    names = {channel.name for channel in compact.channels}
    lacking = {channel.name for channel in full.channels} - names
    assert lacking == {f"slot_{s}_{name}" for s in range(8) for name in ("uv_vis", "layer_camera")}
    assert (full.observation_sizes[0], compact.observation_sizes[0]) == (2667, 267)
    assert full.observation_sizes[1:] == compact.observation_sizes[1:]
    at = channel_slices(full.channels)
    columns = np.concatenate([np.arange(full.observation_sizes[0])[at[c.name]] for c in compact.channels])
    rng = np.random.default_rng(0)
    for labs in (full, compact):
        labs.begin()
    pictured = 0
    for _ in range(60):
        seen = full.observe(0, full.members)
        np.testing.assert_array_equal(compact.observe(0, compact.members), seen[:, columns])
        pictured += int(seen.any(axis=0).sum() > seen[:, columns].any(axis=0).sum())
        mask = full.mask(0, full.members)
        np.testing.assert_array_equal(compact.mask(0, compact.members), mask)
        measures = [np.flatnonzero(row & (full.actions.table[:, 0] == MEASURE)) for row in mask]
        if not all(map(len, measures)):
            break  # the budget is spent
        actions = np.array([rng.choice(own) for own in measures])
        for labs in (full, compact):
            labs.act(0, labs.members, actions)
        np.testing.assert_array_equal(compact.rewards, full.rewards)
    assert pictured, "something was measured that the one sees and the other does not"


def test_scripted_managers_play_with_what_they_see() -> None:
    """What they do not look at makes no difference; without what they look at they do as without the instrument."""

    def scores(name: str, **changes: Any) -> list[float]:
        labs = Laboratories(load_scenario({"base": name, "name": "other", **changes}), 4)
        return play_laboratory(labs, make_policies("scripted", labs, 0), None, 0).returns.tolist()

    assert scores(WURTZ, manager={"readings": ["balance", "gas_chromatograph"]}) == scores(WURTZ)
    with pytest.raises(DataError, match=r"manager\.readings: 'nose' is not one of instruments \(uv_vis, layer_camera"):
        scores(WURTZ, manager={"readings": ["nose"]})
    nothing, none = scores("unlabelled", manager={"readings": []}), scores("unlabelled", limits={"budget": 1e-9})
    assert nothing == pytest.approx(none, abs=1e-12)
