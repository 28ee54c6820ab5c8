"""What worlds are drawn from: declarations and their errors, distributions, splits."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused
from scipy import stats

from chemlab.config.datafile import DataError
from chemlab.config.datamodel import validated
from chemlab.config.draws import Split, WorldSpec
from chemlab.config.loading import load_scenario
from chemlab.kernels.arrays import FloatArray
from chemlab.kernels.tables import Table
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.lab.sampling import (
    WorldDraws,
    compile_draws,
    draw_worlds,
    given_values,
    named_values,
    next_numbers,
    positions,
    world_draws,
)

MATERIALS = ("a", "b", "c", "d")


def number(distribution: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A draw of a number that is nobody's."""
    return {"what": "ambient_pressure", "distribution": distribution, **more}


def identity(kind: str, of: int, options: list[str], **more: Any) -> dict[str, Any]:
    """A draw of what vessels hold."""
    slots = [f"slot_{s}" for s in range(of)]
    return {"what": "identity", "of": slots, "material": "a", **choice(*options, kind=kind), **more}


def choice(*options: Any, kind: str = "choice") -> dict[str, Any]:
    return {"distribution": {"kind": kind, "options": list(options)}}


def between(low: float, high: float) -> dict[str, Any]:
    return {"distribution": {"kind": "uniform", "low": low, "high": high}}


def specified(**draws: Any) -> WorldSpec:
    spec: WorldSpec = validated(WorldSpec, {"draws": draws}, "test")
    return spec


def drawn(spec: WorldSpec, count: int, split: str = "train", seed: int = 0) -> tuple[FloatArray, Table[WorldDraws]]:
    """[count, K] numbers of worlds that one seed after the other begins with, and all of their state."""
    chosen, variables = Split.of(split), compile_draws(spec, MATERIALS)
    table, members = world_draws(count, variables), np.arange(count)
    for member in range(count):
        sequence = chosen.sequence(np.random.SeedSequence(seed + member))
        table.arrays.stream[member, 0] = sequence.generate_state(1, np.uint64)[0]
    next_numbers(members, table.handle, chosen.number)
    draw_worlds(members, variables.handle, table.handle, chosen.test)
    return table.arrays.values, table


@pytest.mark.parametrize(
    ("distribution", "expected"),
    [
        ({"kind": "uniform", "low": -1.0, "high": 3.0}, stats.uniform(-1.0, 4.0)),
        ({"kind": "normal", "mean": 2.0, "sd": 0.5}, stats.norm(2.0, 0.5)),
        ({"kind": "lognormal", "median": 3.0, "sigma": 0.8}, stats.lognorm(0.8, scale=3.0)),
    ],
)
def test_numbers_follow_their_distribution(distribution: dict[str, Any], expected: Any) -> None:
    spec = specified(x=number(distribution))
    values, _ = drawn(spec, 4000)
    # 4000 draws of a fixed seed: the statistic is always the same, and its p-value an ordinary one.
    assert stats.kstest(values[:, 0], expected.cdf).pvalue > 0.01
    # The position of a number is the share of the prior below it.
    found = positions(compile_draws(spec, MATERIALS).arrays, values)
    np.testing.assert_allclose(found, expected.cdf(values), atol=1e-12)


def test_bounds_cut_off() -> None:
    spec = specified(x=number({"kind": "normal", "mean": 1.0, "sd": 1.0, "low": 0.5, "high": 1.5}))
    values, _ = drawn(spec, 2000)
    assert values.min() == 0.5
    assert values.max() == 1.5
    # All that would be below is at the bound.
    assert abs((values == 0.5).mean() - stats.norm(1.0, 1.0).cdf(0.5)) < 0.03


def test_choices_follow_their_weights() -> None:
    options, weights = [1.0, 2.0, 5.0], [1.0, 1.0, 6.0]
    values, _ = drawn(specified(x=number({"kind": "choice", "options": options, "weights": weights})), 4000)
    counts = [int((values == option).sum()) for option in options]
    assert stats.chisquare(counts, 4000 * np.array(weights) / 8.0).pvalue > 0.01


def test_permutations_are_all_as_likely_and_respect_doubles() -> None:
    values, _ = drawn(specified(which=identity("permutation", 3, ["b", "c", "d"])), 6000)
    orders, counts = np.unique(values, axis=0, return_counts=True)
    assert len(orders) == math.factorial(3)
    assert stats.chisquare(counts).pvalue > 0.01
    doubled, _ = drawn(specified(which=identity("permutation", 4, ["b", "d", "d", "d"])), 4000)
    assert (np.sort(doubled, axis=1) == [1, 3, 3, 3]).all()
    assert stats.chisquare((doubled == 1).sum(axis=0)).pvalue > 0.01


def test_an_identity_is_shared_by_an_episode_if_asked_and_keeps_test_options_from_training() -> None:
    one = specified(x=identity("choice", 3, ["b", "c"], shared="episode"))
    each = specified(x=identity("choice", 3, ["b", "c"]))
    assert drawn(one, 2)[0].shape == (2, 1)
    assert drawn(each, 2)[0].shape == (2, 3)
    spec = specified(x=identity("choice", 2, ["b", "c", "d"], test=["d"]))
    assert set(np.unique(drawn(spec, 500)[0])) == {1.0, 2.0}
    assert set(np.unique(drawn(spec, 500, "test")[0])) == {1.0, 2.0, 3.0}


def test_draws_of_a_group_have_the_declared_correlation() -> None:
    normal = {"kind": "normal", "mean": 0.0, "sd": 1.0}
    spec = specified(
        x=number(normal, group="kinetics", correlation=0.64),
        y=number({"kind": "lognormal", "median": 1.0, "sigma": 2.0}, group="kinetics", correlation=0.25),
        z=number(normal),
    )
    values, _ = drawn(spec, 8000)
    scores = np.column_stack([values[:, 0], np.log(values[:, 1]) / 2.0, values[:, 2]])
    found: Any = np.corrcoef(scores.T)
    # The common score weighs sqrt(0.64) in one and sqrt(0.25) in the other; standard error of r below 0.012.
    assert abs(found[0, 1] - 0.8 * 0.5) < 0.04
    assert abs(found[0, 2]) < 0.04
    assert np.allclose(scores.std(axis=0), 1.0, atol=0.03)


def test_splits_share_no_world_and_training_none_of_a_test_region() -> None:
    count = 4_000
    region = (1.5, 2.0)
    spec = specified(x=number({"kind": "uniform", "low": 0.5, "high": 2.0}, test=[region]))
    names = ("train", "validation", "test", "private:" + "1" * 32, "private:" + "2" * 32)
    found = {name: drawn(spec, count, name) for name in names}
    numbers = {name: table.arrays.number[:, 0] for name, (_, table) in found.items()}
    for i, name in enumerate(names):
        assert (numbers[name] & np.uint64(3) == min(i, 3)).all()
        assert len(np.unique(numbers[name])) == count
        for other in names[:i]:
            assert not np.intersect1d(numbers[name], numbers[other]).size
            assert not np.intersect1d(found[name][0], found[other][0]).size
    for name in ("train", "validation"):
        assert found[name][0].max() < region[0]
    # The test split has the whole prior: a third of it lies in the region (four standard errors).
    assert abs((found["test"][0] >= region[0]).mean() - 1.0 / 3.0) < 4.0 * (2.0 / 9.0 / count) ** 0.5


def test_a_world_is_its_number() -> None:
    normal = {"kind": "normal", "mean": 0.0, "sd": 1.0}
    spec = specified(x=number(normal), y=identity("permutation", 3, ["b", "c", "d"]))
    split, variables = Split.of("test"), compile_draws(spec, MATERIALS)
    table = world_draws(3, variables)
    for member, seed in enumerate((5, 6, 5)):
        table.arrays.work[member, 0] = np.uint64(split.world(seed))
    draw_worlds(np.arange(3), variables.handle, table.handle, True)
    values = table.arrays.values
    assert (values[0] == values[2]).all()
    assert (values[0] != values[1]).any()
    assert (given_values(spec, named_values(spec, values[0], MATERIALS), MATERIALS) == values[0]).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"z": 1.0}, "'z' is not drawn; choose from x, y"),
        ({"x": "b"}, "x: must be a finite number"),
        ({"x": 9.0}, "x: must be from 0 to 1, given 9"),
        ({"y": "b"}, "y: must be a table of slot_0, slot_1"),
        ({"y": {"slot_0": "a"}}, "y: must be one of b, c, given 'a'"),
        ({"y": {"slot_7": "b"}}, "y: must be a table of slot_0, slot_1"),
    ],
)
def test_worlds_that_cannot_be_asked_for(given: dict[str, Any], message: str) -> None:
    spec = specified(x=number({"kind": "uniform", "low": 0.0, "high": 1.0}), y=identity("choice", 2, ["b", "c"]))
    refused(message, given_values, spec, given, MATERIALS)


def test_noise_and_orders_of_a_private_split_follow_from_its_salt() -> None:
    """An agent may know the seed of its episode, and could subtract the noise."""
    found: list[list[set[int]]] = []
    for split in ("train", "validation", "private:" + "1" * 32, "private:" + "2" * 32):
        labs = Laboratories("relay", split=split)
        batch = ExperimentBatch(labs.scenario.configured(split=split), "rxn")
        labs.seed(0, 3)
        batch.seed(0, 3)
        found.append([set(one.episodes.first[0, :-1].tolist()) for one in (labs, batch)])
    assert found[0] == found[1], "in public splits, a seed means the same noise"
    for which in (0, 1):
        assert not found[0][which] & found[2][which] | found[2][which] & found[3][which]


@pytest.mark.parametrize(
    "name", ["", "Train", "tests", "private", "private:", "private:quetzal", f"private:{'1' * 31}"]
)
def test_splits_that_there_are_not(name: str) -> None:
    with pytest.raises(ValueError, match=r"split: must be train, validation, test or private:SALT") as refused:
        Split.of(name)
    new = re.findall(r"private:[0-9a-f]{32}", str(refused.value))[0]  # one that the message makes
    assert Split.of(new).number == 3


WURTZ = "2 1-chlorohexane + 2 Na -> dodecane + 2 NaCl"
FEED = {"of": ["slot_0"], "material": "1-chlorohexane"}
BOTTLE = {"of": ["stock"], "material": "Na", "inert": "water"}
RATE = {"what": "pre_exponential", "of": [WURTZ], **between(0.5, 1.5)}
WIDE: dict[str, Any] = {"distribution": {"kind": "lognormal", "median": 1.0, "sigma": 1.0}}
UNKNOWN = {"distribution": {"kind": "uniform", "min": 0.4}}
NORMAL: dict[str, Any] = {"distribution": {"kind": "normal", "mean": 1.0, "sd": 1.0}}


def file(**draw: Any) -> dict[str, Any]:
    """A scenario with one draw."""
    vessel = {"capacity_l": 1.0, "contents": {"diethyl_ether": 4.0, "1-chlorohexane": 1.0}}
    return {
        "base": "wurtz_dodecane",
        "name": "tested",
        "title": "tested",
        "summary": "tested",
        "shelf": {"slots": 8, "vessel": [vessel, {"capacity_l": 1.0}]},
        "world": {"draws": {"x": {**between(0.5, 1.0), **draw}}},
    }


@pytest.mark.parametrize(
    ("what", "more", "message"),
    [
        ("titre", FEED, "x: inert: required for titre"),
        ("titer", {**FEED, "inert": "water"}, "x: inert: only for what = 'titre', given what = 'titer'"),
        ("ambient_pressure", UNKNOWN, "uniform.min: unknown key, given 0.4; known: kind, low, high"),
        ("amount", {"of": ["slot_0"]}, "x: material: required for amount"),
        ("amount", {"of": [], "material": "Na"}, "x: of: name at least one vessel"),
        ("amount", {"of": ["slot_2"], "material": "Na"}, "unknown vessel 'slot_2'; choose from slot_0, slot_1, rxn"),
        ("amount", {"of": ["slot_0"], "material": "Na"}, "x.material: 'Na' is not in slot_0, which has .* only"),
        ("amount", {"of": ["slot_1"], "material": "Na"}, "x.material: 'Na' is not in slot_1, which has nothing"),
        ("amount", {"of": ["stock"], "material": "Na"}, "x.what: a bottle's amount is observed"),
        (
            "titre",
            {**BOTTLE, "material": "dodecane"},
            "there is no bottle of 'dodecane' in stock; choose from 1-chloroh",
        ),
        (
            "titre",
            {**BOTTLE, **between(0.5, 1.5)},
            "x: a titre must be from 0 to 1, given draws from 0.5 to 1.5; set low",
        ),
        ("amount", {**FEED, **WIDE}, "x: slot_0: .* must be at least 0 and fit in capacity_l = 1; give low and high"),
        ("identity", FEED, "x: distribution: must be a choice or a permutation of materials"),
        ("identity", {**FEED, **choice("gold")}, "world.draws.x: unknown material 'gold'"),
        ("colour", {}, "x.what: 'colour' cannot be drawn; choose from identity, amount, titre, "),
        ("boiling_point", {"of": ["Na"]}, "x.what: 'boiling_point' cannot be drawn"),
        ("pre_exponential", {"of": ["A -> B"]}, "x.of: must be some of 2 1-chlorohexane"),
        ("pre_exponential", {}, "x.of: must be some of 2 1-chlorohexane .* given nothing"),
        ("polarity", {"of": ["gold"]}, "x.of: must be some of 1-chlorohexane"),
        ("ambient_pressure", {"of": ["Na"]}, "x.of: must be left out; given Na"),
        (
            "pre_exponential",
            {**RATE, **NORMAL},
            "x: pre_exponential must stay above 0, and could become -inf; give low",
        ),
        ("ambient_pressure", {"test": [[0.5, 0.99]]}, "world.draws.x.test: leaves 0.02 of all worlds to training"),
        ("ambient_pressure", {"test": [[0.9, 0.6]]}, r"test: \[0.9, 0.6\]: must be \[low, high\]"),
        ("ambient_pressure", {"test": [[4.0, 5.0]]}, r"x: test: \[4, 5\]: nothing is drawn there; .* from 0.5 to 1"),
        ("ambient_pressure", {"test": [0.5, 0.6]}, r"x.test.0: must be a list, as in \[1, 2\], given 0.5"),
        ("ambient_pressure", {"correlation": 0.5}, "x: correlation: has no effect without a group"),
        ("ambient_pressure", {"group": "g", "correlation": 2.0}, "correlation: .* less than or equal to 1"),
        ("ambient_pressure", {"distribution": {"kind": "even"}}, "distribution: .*'uniform', 'normal'"),
        ("ambient_pressure", between(2.0, 1.0), "high = 1 must not be below low = 2"),
    ],
)
def test_errors_name_file_key_and_bound(what: str, more: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        Laboratories(load_scenario(file(**{**more, "what": what})))
    assert str(caught.value).startswith("(scenario given as a mapping): world")


@pytest.mark.parametrize(
    ("one", "other", "message"),
    [
        (
            {"what": "titre", "inert": "dodecane", **FEED},
            {"what": "titre", "inert": "water", **FEED},
            "world.draws.other: slot_0: world.draws.one draws its titre already; remove one",
        ),
        (
            {**RATE, "change": "offset", **between(-0.9, 0.0)},
            {**RATE, "change": "offset", **between(-0.9, 0.0)},
            r"world.draws.other: 2 .*: world.draws.one draws its pre_exponential already; remove one",
        ),
        (
            {"what": "amount", **FEED, **choice(3.0)},
            {"what": "amount", **FEED, "material": "diethyl_ether", **choice(1.5)},
            r"world.draws.other: slot_0: 6 to 6 mol, up to 1\.\d+ L with all else .* fit in capacity_l = 1",
        ),
        (
            {**RATE, "group": "g", "test": [[0.5, 1.0]]},
            {**RATE, "what": "activation_energy", "group": "g", "test": [[1.0, 1.5]]},
            "the test regions of one, other, which are correlated, leave about 0 of all worlds to training",
        ),
    ],
)
def test_draws_that_exclude_each_other(one: dict[str, Any], other: dict[str, Any], message: str) -> None:
    tables = file()
    tables["world"] = {"draws": {"one": {**between(0.9, 1.0), **one}, "other": {**between(0.9, 1.0), **other}}}
    with pytest.raises(DataError, match=message):
        Laboratories(load_scenario(tables))


def test_a_draw_of_one_of_two_reactions_of_the_same_equation(tmp_path: Path) -> None:
    step = '[[reaction]]\nreactants = { "1-chlorohexane" = 1 }\nproducts = { "2-chlorohexane" = 1 }\n'
    step += 'pre_exponential = 1.0\nactivation_energy_j_mol = 0\nsource = "A test."\n'
    (tmp_path / "twice.toml").write_text(f'name = "twice"\n{2 * step}')
    tables = file(**RATE | {"of": ["1-chlorohexane -> 2-chlorohexane"]}) | {"base": "wurtz_dodecane_direct"}
    tables |= {"reactions": str(tmp_path / "twice.toml"), "goals": ["1-chlorohexane"], "lab_goals": ["1-chlorohexane"]}
    tables |= {"theoretical_maximum_mol": {"1-chlorohexane": 1.0}, "remove": ["theoretical_maximum_mol"]}
    with pytest.raises(DataError, match=r"x\.of: several reactions are '1-chlorohexane -> .*say which one"):
        Laboratories(load_scenario(tables))
