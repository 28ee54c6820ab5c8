"""A bench of a user's own in a laboratory: one entry in a scenario file, and everything else knows it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import laboratory, litres

import chemlab.scenarios
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.parts import PartError
from chemlab.envs.aec import raw_env
from chemlab.lab.experiments import ExperimentBatch
from chemlab.physics.chemistry import AMOUNTS, TEMPERATURE
from chemlab.record.recorder import EpisodeLines
from chemlab.roles.bench import channel_slices

FILTER, END = range(2)
ENTRY = """
[benches.fil]
kind = "filtration_bench:FiltrationBench"
step_limit = 5
auxiliary_capacity_l = 1.2
"""


@pytest.fixture
def scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of wurtz_dodecane with one more bench, whose module is on the import path."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    shipped = Path(chemlab.scenarios.__path__[0]) / "wurtz_dodecane.toml"
    file = tmp_path / "with_filter.toml"
    file.write_text(shipped.read_text() + ENTRY)
    return file


def test_the_laboratory_has_its_agent(scenario: Path) -> None:
    env = raw_env(scenario)
    assert env.possible_agents == ["manager_0", "rxn_0", "ext_0", "dit_0", "fil_0"]
    assert env.action_space("fil_0").n == 2
    assert env.observation_space("fil_0").shape == (2 + len(env.scenario.goals),)
    bench = ExperimentBatch(scenario, "fil").bench
    assert bench.observation_space == env.observation_space("fil_0")
    assert bench.action_space == env.action_space("fil_0")
    # The manager can start it on every slot for every goal, recall it, and sees where a vessel was last.
    meanings = env.laboratories.actions.action_meanings
    assert sum(meaning.startswith("start fil_0 ") for meaning in meanings) == 8 * len(env.scenario.goals)
    assert "recall fil_0" in meanings
    sizes = {channel.name: channel.size for channel in env.laboratories.channels}
    assert sizes["slot_0_last_bench"] == 1 + 4
    assert sizes["fil_0_busy"] == 1


def test_its_own_arrays_are_part_of_the_state_and_of_its_hash(scenario: Path) -> None:
    scenario.write_text(scenario.read_text().replace("filtration_bench:Filtration", "clogging_bench:Clogging"))
    env = raw_env(scenario)
    env.reset(seed=0, options={"goal": "dodecane"})
    labs, lines = env.laboratories, EpisodeLines(env.laboratories, 0)
    clogged = labs.experiments[3].clogged
    at = channel_slices(env.state_channels)["fil_0_clogged"]
    assert not {"fil_0_scratch", "fil_0_supply", "fil_0_jacket"} & {channel.name for channel in env.state_channels}
    assert env.state()[at].tolist() == [0.5]
    labs.shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "dodecane": 1.0, "Na": 2.0})
    for action in (labs.actions.encode("start", "fil_0", 0, "dodecane"), labs.actions.encode("wait"), FILTER, END):
        env.step(action)
    # The experiment is over, and the filter stays as it is.
    assert not labs.busy[3, 0]
    assert clogged.tolist() == [1.0]
    assert env.state()[at].tolist() == [0.75]
    before = lines._state()
    clogged[0] = 2.0
    assert env.state()[at] == np.float32(0.5 + np.arctan(2.0) / np.pi)
    assert lines._state() != before
    clogged[0] = 1.0
    labs.experiments[3].scratch[0] = 7.0
    assert lines._state() == before
    env.reset()
    assert clogged.tolist() == [0.0]
    assert env.state()[at].tolist() == [0.5]


def test_a_manager_routes_a_vessel_through_it(scenario: Path) -> None:
    env = laboratory(load_scenario(scenario))
    labs, shelf = env.laboratories, env.laboratories.shelf
    shelf.fill(0, 0, 1.2, {"diethyl_ether": 4.0, "dodecane": 1.0, "Na": 2.0})
    total = shelf.total()
    sees = channel_slices(env.laboratories.benches[3].channels)
    env.step(labs.actions.encode("start", "fil_0", 0, "dodecane"))
    env.step(labs.actions.encode("wait"))
    assert env.agent_selection == "fil_0"
    assert env.infos["fil_0"]["action_mask"].tolist() == [1, 1]
    funnel_before = float(env.observe("fil_0")[sees["fill_funnel"]][0])
    env.step(0)
    assert env.agent_selection == "fil_0"
    assert not env.infos["fil_0"]["illegal_action"]
    # Nothing but metal in the funnel now: filtering again is a lost turn.
    assert env.infos["fil_0"]["action_mask"].tolist() == [0, 1]
    seen = env.observe("fil_0")
    metal_l = litres(env.scenario, {"Na": 2.0})
    assert seen[sees["fill_funnel"]][0] == pytest.approx(metal_l / 1.2, rel=1e-6)
    assert seen[sees["fill_filtrate"]][0] == pytest.approx(funnel_before - metal_l / 1.2, rel=1e-5)
    vessels = shelf.vessels.copy()
    env.step(0)
    assert env.infos["fil_0"]["illegal_action"]
    assert env.rewards["fil_0"] == -env.scenario.costs.illegal_action
    np.testing.assert_array_equal(shelf.vessels, vessels)
    env.step(1)
    # 1 mol of 7 before, 1 of 5 after: purity 1/7 became 1/5.
    score = pytest.approx(1.0 / 5.0 - 1.0 / 7.0, rel=1e-12)
    assert (env.infos["fil_0"]["score"], env.rewards["fil_0"]) == (score, score)
    assert env.agent_selection == "manager_0"
    # The funnel is back on its slot, the filtrate on the first free one.
    assert shelf.vessel(0, 0).amounts(1e-12) == {"Na": 2.0}
    assert shelf.vessel(0, 2).amounts(1e-12) == {"dodecane": 1.0, "diethyl_ether": 4.0}
    np.testing.assert_allclose(shelf.total(), total, rtol=1e-12)
    env.step(labs.actions.encode("submit", 2))
    cost = sum(labs.costs().values())
    assert env.rewards["manager_0"] == pytest.approx(1.0 * (1.0 / 5.0) / 0.5 - cost, rel=1e-12)


def test_a_mistake_in_its_options_is_named(scenario: Path) -> None:
    """Others: tests/parts/test_parts.py."""
    scenario.write_text(f"{scenario.read_text()}paper = 3\n")
    with pytest.raises(DataError, match=r"with_filter\.toml: benches\.fil.*paper"):
        raw_env(scenario)


OWN = """
import numpy as np
from chemlab.physics.chemistry import AMOUNTS
from chemlab.roles.bench import Channel, gymnasium
from filtration_bench import FiltrationBench


class Own(FiltrationBench):
    def __init__(self, key, scenario, chemistry):
        super().__init__(key, scenario, chemistry)
        {made}

    def {method}(self, shelf, experiments, members, *given):
        found = super().{method}(shelf, experiments, members, *given)
        {wrong}
        return found

    {more}
"""
SPACE = "self._set_spaces([Channel('a', {size}, '', 0.0, 1.0, '')], {space})"


@pytest.mark.parametrize(
    ("method", "wrong", "words"),
    [
        ("made", "raise ValueError('jammed')", r"Own: ValueError: jammed"),
        ("made", "del self.action_space", r"Own: __init__\(\) must call _set_spaces"),
        ("made", SPACE.format(size="2.0", space="self.action_space"), "a Channel has a name and an integer size"),
        ("made", SPACE.replace("0.0", "1.0").format(size=2, space="self.action_space"), "low must be below high"),
        ("made", SPACE.format(size=2, space="gymnasium.spaces.Discrete(2, start=1)"), "must be Discrete"),
        ("made", SPACE.format(size=2, space="gymnasium.spaces.Box(-1.0, 1.0, (2,))"), "must be Discrete"),
        ("more", "action_meanings = ['filter']", "action_meanings must have 2 texts, given 1"),
        ("act", "raise ValueError('jammed')", r"act\(\): ValueError: jammed"),
        ("act", "experiments.events[members] = np.nan", r"act\(\) has left a number in the safety events"),
        ("act", "shelf.stock[members] -= 99.0", r"act\(\) has left a number in the stock"),
        ("act", "shelf.rows[experiments.places[members], AMOUNTS] = np.nan", "negative or not finite in a vessel"),
        ("act", "experiments.steps[members] = 0", r"act\(\): must add 1 to experiments.steps"),
        ("act", "experiments.steps[members] = 5; experiments.ended[:] = False", r"step_limit = 5"),
        ("see", "raise KeyError('dial')", r"see\(\): KeyError: 'dial'"),
        ("mask", "given[0][:] = 0", r"mask\(\): must write 0 or 1 .* given \[\[0, 0\]\]"),
        ("mask", "given[0][:] = 7", r"mask\(\): must write 0 or 1"),
        ("measure", "found = found + np.nan", r"measure\(\): must be finite"),
        ("measure", "found = 0.5", r"measure\(\): must have shape \(1,\), given shape \(\)"),
    ],
)
def test_a_mistake_in_its_class_is_named(scenario: Path, method: str, wrong: str, words: str) -> None:
    """Also where its last action ends the experiment."""
    parts = {"made": "pass", "method": "act", "wrong": "pass", "more": ""}
    parts |= {method: wrong} if method in parts else {"method": method, "wrong": wrong}
    (scenario.parent / "own.py").write_text(OWN.format(**parts))
    scenario.write_text(scenario.read_text().replace("filtration_bench:FiltrationBench", "own.py:Own"))

    def play() -> None:
        env = laboratory(scenario)
        env.step(env.laboratories.actions.encode("start", "fil_0", 0, "dodecane"))
        env.step(env.laboratories.actions.encode("wait"))
        env.last()
        env.step(END)

    with pytest.raises(PartError, match=rf"with_filter\.toml: benches\.fil: .*{words}"):
        play()


@pytest.mark.parametrize(
    ("method", "wrong", "words"),
    [
        ("see", "out[:, 0] = 1.5", r"see\(\).*from 0 to 1"),
        ("see", "out[:, 0] = np.nan", r"see\(\)"),
        ("act", "shelf.rows[experiments.places[members, 0], TEMPERATURE] = -11_819.0", r"-11819 K.*50 to 5000 K"),
        ("act", "shelf.rows[experiments.places[members, 0], AMOUNTS] = np.nan", "negative or not finite"),
    ],
)
def test_what_no_space_or_vessel_holds_is_refused(
    scenario: Path, monkeypatch: pytest.MonkeyPatch, method: str, wrong: str, words: str
) -> None:
    """An observation outside its space, and contents that no vessel can have, are errors that name the bench."""
    batch = ExperimentBatch(scenario, "fil")
    kind = type(batch.bench)
    known = getattr(kind, method)

    def spoilt(self: Any, shelf: Any, experiments: Any, members: Any, given: Any) -> None:
        known(self, shelf, experiments, members, given)
        names = {"out": given, "shelf": shelf, "experiments": experiments, "members": members}
        exec(wrong, {**names, "np": np, "TEMPERATURE": TEMPERATURE, "AMOUNTS": AMOUNTS})

    batch.seed(0, 0)
    batch.reset(batch.members)
    monkeypatch.setattr(kind, method, spoilt)
    batch.act(np.zeros(1, dtype=np.int64))
    with pytest.raises(PartError, match=rf"benches\.fil.*{words}"):
        batch.observe()
