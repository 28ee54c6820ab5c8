"""Worlds in laboratories: the same in every view, part of the state, unseen until something physical differs."""

from typing import Any

import numpy as np
import pytest
from helpers import molar_volume, refused

from chemlab.agents.episodes import play_episode
from chemlab.agents.policies import make_policies
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.aec import raw_env
from chemlab.envs.batch import BatchedLaboratory
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.physics.chemistry import element_matrix

HALIDES = ("1-chlorohexane", "2-chlorohexane", "3-chlorohexane")
COUPLING = "2 1-chlorohexane + 2 Na -> dodecane + 2 NaCl"
SLOTS = ["slot_0", "slot_1", "slot_2"]
DRAWS = {
    "which": {
        "what": "identity",
        "of": [*SLOTS, "rxn"],
        "material": HALIDES[0],
        "distribution": {"kind": "permutation", "options": [*HALIDES, HALIDES[0]]},
    },
    "titre": {
        "what": "titre",
        "of": [*SLOTS, "rxn"],
        "material": HALIDES[0],
        "inert": "dodecane",
        "distribution": {"kind": "uniform", "low": 0.4, "high": 1.0},
        "test": [[0.4, 0.5]],
    },
    "reagent": {
        "what": "titre",
        "of": ["stock"],
        "material": "2-chlorohexane",
        "inert": "dodecane",
        "distribution": {"kind": "uniform", "low": 0.4, "high": 1.0},
    },
    "label": {
        "what": "identity",
        "of": ["stock"],
        "material": "3-chlorohexane",
        "distribution": {"kind": "choice", "options": [*HALIDES]},
    },
    "rate": {
        "what": "pre_exponential",
        "of": [COUPLING],
        "distribution": {"kind": "lognormal", "median": 1.0, "sigma": 0.8},
        "group": "kinetics",
    },
    "barrier": {
        "what": "activation_energy",
        "of": [COUPLING],
        "change": "offset",
        "distribution": {"kind": "normal", "mean": 0.0, "sd": 500.0, "low": -2000.0, "high": 2000.0},
        "group": "kinetics",
        "correlation": 0.5,
    },
}


def scenario(draws: dict[str, Any] | None = None, **more: Any) -> Scenario:
    """Dodecane from three vessels that look alike."""
    vessel = {"capacity_l": 1.2, "contents": {"diethyl_ether": 4.0, HALIDES[0]: 1.0}}
    return load_scenario(
        {
            "base": "wurtz_dodecane",
            "name": "alike",
            "shelf": {"slots": 8, "vessel": [vessel] * 3, "gauge": 0.05},
            "benches": {"rxn": {"start": vessel}},
            "world": {"draws": DRAWS if draws is None else draws},
            **more,
        }
    )


def worlds(env: Any, member: int = 0) -> tuple[int, dict[str, Any]]:
    owner = getattr(env, "laboratories", None) or getattr(env, "batch", None) or env
    return owner.worlds.number(member), owner.worlds.values(member)


def test_a_world_disturbs_no_other_stream() -> None:
    """With amounts that come out as the file has them anyway, episodes are equal however many numbers are drawn."""
    same = {"kind": "choice", "options": [1.0]}
    feed = {"what": "amount", "of": SLOTS, "material": HALIDES[0], "distribution": same}
    one = scenario({"feed": feed})
    more = scenario({"solvent": {**feed, "material": "diethyl_ether"}, "feed": feed})
    results = []
    for spec in (one, more):
        env = raw_env(spec)
        policies = make_policies("random", env.laboratories, 5)
        results.append([play_episode(env, policies, seed) for seed in range(3)])
    assert results[0] == results[1]


def test_splits_have_worlds_of_their_own() -> None:
    """What they draw: tests/test_world.py."""
    titres = {}
    for split in ("train", "test"):
        labs = Laboratories(scenario(), 100, split=split)
        labs.begin()
        titres[split] = min(min(labs.worlds.values(member)["titre"].values()) for member in range(100))
    assert titres["test"] < 0.5 < titres["train"]
    refused("split: must be train", Laboratories, scenario(), split="dev")


def test_what_is_drawn_is_in_vessels_and_parameters() -> None:
    """Litre for litre: every volume is as the file has it, whatever is in it."""
    spec = scenario()
    labs = Laboratories(spec, 5)
    labs.begin()
    litres = {name: molar_volume(spec, name) for name in spec.materials}
    for member in range(5):
        values, known = labs.worlds.values(member), labs.shelf.known(member)
        for slot, name in enumerate(SLOTS):
            amounts = labs.shelf.vessel(member, slot).amounts()
            material, titre = values["which"][name], values["titre"][name]
            assert amounts[material] * litres[material] == pytest.approx(titre * litres[HALIDES[0]], rel=1e-12)
            inert = amounts["dodecane"] * litres["dodecane"]
            assert inert == pytest.approx((1.0 - titre) * litres[HALIDES[0]], rel=1e-12)
            assert amounts["diethyl_ether"] == pytest.approx(4.0, rel=1e-12)
        step = spec.family.reaction[0]
        assert known.pre_exponential[0] == pytest.approx(step.pre_exponential * values["rate"][COUPLING], rel=1e-12)
        barrier = step.activation_energy_j_mol + values["barrier"][COUPLING]
        assert known.activation_energy[0] == pytest.approx(barrier, rel=1e-12)
        # Reactions that are not named are as the files have them, and so is the world nobody lives in.
        assert (known.pre_exponential[1:] == [other.pre_exponential for other in spec.family.reaction[1:]]).all()
    assert labs.shelf.chemistry.world().pre_exponential[0] == spec.family.reaction[0].pre_exponential


@pytest.mark.parametrize("bench", ["rxn", "ext"])
def test_a_bottle_gives_what_is_in_it(bench: str) -> None:
    """Litre for litre, fed by the reaction bench and added by an operation; in all there is what there was."""
    wash = {"wash": DRAWS["reagent"] | {"material": "water", "inert": "diethyl_ether"}}
    spec = scenario(DRAWS | wash)
    litres = {name: molar_volume(spec, name) for name in spec.materials}
    env = RoleVectorEnv(6, spec, bench=bench)
    env.reset(seed=0)
    batch = env.batch
    shelf, total = batch.shelf, batch.shelf.total()
    vessels, labels = shelf.amounts.sum(axis=1), shelf.stock.copy()
    if bench == "rxn":  # everything but sodium, so that nothing reacts
        fed = [float(name in HALIDES) for name in batch.bench.reagent_names]
        env.step(np.tile(np.array([0.5, 0.5, *fed], dtype=np.float32), (6, 1)))
    else:
        water = [a for a, text in enumerate(batch.bench.action_meanings) if text.startswith("add water")]
        env.step(np.full(6, water[-1]))
    elements = element_matrix(spec)  # salt dissolves
    assert shelf.total() @ elements.T == pytest.approx(total @ elements.T, rel=1e-12, abs=1e-12)
    for member in range(6):
        values = batch.worlds.values(member)
        real = {"2-chlorohexane": (values["reagent"]["stock"], "dodecane")}
        real |= {"3-chlorohexane": (0.0, values["label"]["stock"]), "water": (values["wash"]["stock"], "diethyl_ether")}
        taken = dict(zip(spec.materials, labels[member] - shelf.stock[member], strict=True))
        came = dict.fromkeys(taken, 0.0)
        for label, mol in taken.items():
            share, rest = real.get(label, (1.0, label))
            came[label] += share * mol
            came[rest] += (1.0 - share) * mol * litres[label] / litres[rest]
        assert sum(taken.values()) > 0.4
        found = shelf.amounts[member].sum(axis=0) - vessels[member]
        for name in (*HALIDES, "dodecane", "water", "diethyl_ether"):
            assert found[list(came).index(name)] == pytest.approx(came[name], rel=1e-9, abs=1e-12)


def test_vessels_begin_at_rest_in_their_own_world() -> None:
    """Polarity says how a solute divides between two solvents."""
    contents = {"diethyl_ether": 2.0, "water": 10.0, "dodecane": 0.5}
    distribution = {"kind": "uniform", "low": 1.0, "high": 60.0}
    draws = {"polarity": {"what": "polarity", "of": ["dodecane"], "distribution": distribution}}
    labs = Laboratories(scenario(draws, shelf={"slots": 8, "vessel": [{"capacity_l": 1.2, "contents": contents}]}), 2)
    labs.begin()
    one, other = labs.shelf.dissolved[:, 0]
    assert abs(one - other).max() > 0.01
    assert one.sum() == pytest.approx(other.sum(), rel=1e-12)


def test_a_world_can_be_asked_for() -> None:
    spec = scenario()
    env, batch = raw_env(spec), BatchedLaboratory(3, spec)
    env.reset(seed=1, options={"world": 7})
    number, values = worlds(env)
    vessels = env.laboratories.shelf.vessels[0].copy()
    for world in (7, values):
        env.reset(seed=2, options={"world": world})
        assert worlds(env)[1] == values
        np.testing.assert_array_equal(env.laboratories.shelf.vessels[0], vessels)
    # A part of a world: the rest is drawn as without.
    env.reset(seed=2)
    other = worlds(env)[1]
    env.reset(seed=2, options={"world": {"rate": {COUPLING: 2.0}}})
    assert worlds(env)[1] == {**other, "rate": {COUPLING: 2.0}}
    batch.reset(seed=0, options={"world": 7})
    assert [worlds(batch, member) for member in range(3)] == [(number, values)] * 3


def test_two_worlds_look_equal_until_something_physical_differs() -> None:
    """Observations and masks are the same in every world until a vessel is measured, or something happens in one."""
    labs = Laboratories(scenario(), 40)
    labs.begin(0, "dodecane")

    def seen() -> list[bytes]:
        """What everybody sees, by laboratory."""
        parts = []
        for number in range(len(labs.agents)):
            mask = labs.mask(number, labs.members)
            parts.append([row.tobytes() for row in labs.observe(number, labs.members)])
            parts.append([] if mask is None else [row.tobytes() for row in mask])
        return [b"".join(rows) for rows in zip(*(part for part in parts if part), strict=True)]

    assert len({labs.worlds.number(member) for member in range(40)}) == 40
    assert len({row.tobytes() for row in labs.shelf.vessels}) == 40
    assert len(set(seen())) == 1
    # Carrying vessels about and throwing one away tells nothing, nor does what any other stream draws.
    labs.act(0, labs.members, np.full(40, labs.actions.encode("discard", 2)))
    assert len(set(seen())) == 1
    # A measurement does.
    labs.act(0, labs.members, np.full(40, labs.actions.encode("measure", 0, "gas_chromatograph")))
    assert len(set(seen())) == 40


def estimated(distribution: dict[str, Any]) -> Scenario:
    """The coupling with real physics, and salt of which the formation enthalpy is not known well."""
    draw = {"what": "formation", "of": ["NaCl"], "change": "offset", "distribution": distribution}
    return load_scenario({"base": "wurtz_real", "name": "warm", "world": {"draws": {"heat": draw}}})


def test_a_formation_enthalpy_may_be_drawn_though_it_is_below_0() -> None:
    """With bounds."""
    labs = Laboratories(estimated({"kind": "uniform", "low": -5000.0, "high": 5000.0}), 3)
    labs.begin()
    formation = labs.shelf.chemistry.parameters["formation"]
    salt = labs.shelf.layout.index("NaCl")
    assert formation[0, salt] == pytest.approx(-411_200.0, abs=1000.0)
    drawn = [labs.worlds.values(member)["heat"]["NaCl"] for member in range(3)]
    assert formation[1:, salt] == pytest.approx(formation[0, salt] + np.array(drawn), rel=1e-12)
    assert len(set(drawn)) == 3
    with pytest.raises(DataError, match=r"world\.draws\.heat: formation is unbounded; give low and high"):
        Laboratories(estimated({"kind": "normal", "mean": 0.0, "sd": 1000.0}))
