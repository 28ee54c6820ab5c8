"""The crystallization bench: what its operations and gauges do, its score, its script; batches."""

from typing import Any

import numpy as np
import pytest
from helpers import mapping, play_experiments

import chemlab  # noqa: F401 - registers the single benches
from chemlab.agents.policies import is_scripted, scripted_bench
from chemlab.agents.random_policy import RandomPolicy
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.chemistry import AMOUNTS, TEMPERATURE
from chemlab.roles.bench import CAMERA_PIXELS, channel_slices

SCENARIO, BENCH, GOAL = "recrystallization", "cry", "benzoic_acid"
CRUDE_MOL = 0.3


def begun(members: int = 1, scenario: Any = SCENARIO) -> ExperimentBatch:
    batch = ExperimentBatch(scenario, BENCH, members)
    for m in range(members):
        batch.seed(m, m)
    batch.reset(batch.members)
    return batch


def action(batch: ExperimentBatch, words: str) -> int:
    return next(i for i, meaning in enumerate(batch.bench.action_meanings) if meaning.startswith(words))


def do(batch: ExperimentBatch, *steps: str) -> None:
    for words in steps:
        batch.act(np.full(len(batch.members), action(batch, words)))
        assert not batch.experiments.illegal.any(), words


def held(batch: ExperimentBatch, position: int, name: str) -> float:
    return float(batch.shelf.amounts[0, position, batch.shelf.layout.index(name)])


def test_the_paper_has_no_crystals() -> None:
    values = {"base": "salt_from_oil", "benches": {"cry": {"kind": "crystallization"}}}
    with pytest.raises(DataError, match=r"benches\.cry\.kind: 'crystallization' needs physics = 'real'.*'paper'"):
        ExperimentBatch(load_scenario(values), "cry")


def test_gauges_say_what_is_there() -> None:
    batch = begun()
    sees = channel_slices(batch.bench.channels)
    own = ["layers_CV", "layers_F", "layers_W", "temperature", "volume", "pressure", "solids", "goal"]
    assert list(sees) == own
    do(batch, "add water to CV, 0.2 L", "heat CV, 50 kJ")
    seen, row, known = batch.observe()[0], batch.shelf.rows[0], batch.shelf.known()
    volume = float(row[AMOUNTS : AMOUNTS + len(known.molar_volume)] @ known.molar_volume)
    options = batch.bench.options
    reading = {name: float(seen[sees[name]][0]) for name in ("temperature", "volume", "solids")}
    span = options.hottest_k - options.coolest_k
    assert reading["temperature"] == pytest.approx((row[TEMPERATURE] - options.coolest_k) / span, rel=1e-6)
    assert reading["volume"] == pytest.approx(volume / batch.bench.auxiliary_capacity_l, rel=1e-6)
    names = batch.shelf.layout.materials
    dissolved = dict(zip(batch.shelf.layout.dissolved, batch.shelf.dissolved[0, 0].sum(axis=1), strict=True))
    crystals = {n: held(batch, 0, n) - dissolved[n] for n in (GOAL, "salicylic_acid")}
    solid = sum(known.molar_volume[names.index(n)] * mol for n, mol in {**crystals, "silica": 0.2}.items())
    assert crystals[GOAL] > 0.2
    assert reading["solids"] == pytest.approx(solid / volume, rel=1e-5)


def test_the_camera_sees_crystals_in_their_own_shade() -> None:
    values = mapping(SCENARIO)
    values["benches"]["cry"]["start"] = {"capacity_l": 2.0, "contents": {GOAL: 5.0}}
    batch = begun(1, load_scenario(values))
    picture = batch.observe()[0, :CAMERA_PIXELS]
    share = 5.0 * batch.shelf.known().molar_volume[batch.shelf.layout.index(GOAL)] / 2.0
    shade = np.float32(batch.scenario.materials[GOAL].shade)
    assert (picture == shade).sum() == pytest.approx(100.0 * share, abs=2.0)


def test_seeds_come_from_stock_as_crystals() -> None:
    batch = begun()
    index, molar_mass = batch.shelf.layout.index(GOAL), batch.scenario.materials[GOAL].molar_mass_g_mol
    before = float(batch.shelf.stock[0, index])
    do(batch, "seed CV with the goal, 0.2 g")
    assert held(batch, 0, GOAL) == pytest.approx(CRUDE_MOL + 0.2 / molar_mass, rel=1e-12)
    assert before - batch.shelf.stock[0, index] == pytest.approx(0.2 / molar_mass, rel=1e-12)
    do(batch, *["seed CV with the goal, 0.2 g"] * 3)
    assert batch.shelf.stock[0, index] == 0.0
    assert held(batch, 0, GOAL) == pytest.approx(CRUDE_MOL + before, rel=1e-12)
    assert batch.mask()[0, action(batch, "seed CV")] == 0


def test_what_is_impossible_is_masked() -> None:
    batch = begun()
    legal = dict(zip(batch.bench.action_meanings, batch.mask()[0], strict=True))
    dry_powder = {words for words, possible in legal.items() if not possible}
    assert dry_powder == {w for w in legal if w.startswith(("filter", "dry", "pour F", "pour W"))}
    do(batch, "add water to CV, 0.5 L")
    again = action(batch, "filter CV -> F, 1")
    for _ in range(40):  # what dissolves meanwhile makes the cake smaller
        if not batch.mask()[0, again]:
            break
        do(batch, "filter CV -> F, 1")
    legal = dict(zip(batch.bench.action_meanings, batch.mask()[0], strict=True))
    assert not legal["filter CV -> F, 100 %"]  # what is left stays in the cake
    assert not legal["filter CV -> W, 100 %"]
    assert legal["dry CV, 20 L of air"]
    assert legal["pour F -> CV, 100 %"]


def test_the_score_is_the_gain_of_amount_times_absolute_purity() -> None:
    batch = begun()
    start = CRUDE_MOL**2 / (CRUDE_MOL + 0.02 + 0.1 + 0.2)
    do(batch, "add water to CV, 0.5 L", "filter CV -> F, 1")
    expected = 0.0
    amounts = dict(zip(batch.shelf.layout.materials, batch.shelf.amounts[0].T, strict=True))
    for p in range(3):
        total = sum(mol[p] * (0.5 if name in ("Na+", "Cl-") else 1.0) for name, mol in amounts.items())
        expected += amounts[GOAL][p] ** 2 / total if total > 0.0 else 0.0
    assert float(batch.finish(batch.members)[0]) == pytest.approx(expected - start, rel=1e-9)


def scripted(careful: bool = True) -> tuple[float, float, float]:
    """(score, yield, purity) of the script; what it leaves in CV."""
    batch = begun()
    assert is_scripted(batch.bench)
    score = float(play_experiments(batch, scripted_bench(batch.bench, careful))[0])
    amounts = batch.shelf.amounts[0, 0]
    mol = float(amounts[batch.shelf.layout.index(GOAL)])
    return score, mol / CRUDE_MOL, mol / float(amounts.sum())


def test_the_script_gets_most_of_it_pure() -> None:
    score, recovered, purity = scripted()
    assert 0.90 < recovered < 1.0
    assert purity > 0.999
    # As much as there is, pure, would be 0.155; doing nothing is 0.
    assert 0.12 < score < CRUDE_MOL - CRUDE_MOL**2 / 0.62
    assert play_experiments(begun(16), RandomPolicy(35, 0)).max() < score


def test_without_filtering_hot_the_sand_stays() -> None:
    _, recovered, purity = scripted(careful=False)
    assert recovered > 0.85
    assert purity < 0.65
