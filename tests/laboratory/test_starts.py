"""Recorded starting vessels: what the files may hold, and that each vessel is in them once."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import chemlab
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.envs.role_env import RoleVectorEnv
from chemlab.lab.engine import Laboratories
from chemlab.lab.experiments import ExperimentBatch
from chemlab.lab.starts import Start, goals_met, lab_starts, starts_file, write_starts
from chemlab.physics.chemistry import AMOUNTS


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"benches": {"rxn": {"dodecane": [1]}}}, r"rxn.dodecane: no vessel 1 among 1; run: chemlab export starts "),
        ({"benches": {"rxn": {"gold": [0]}}}, r"benches.rxn.gold: vessel 0: unknown 'gold'"),
        ({"benches": {}}, r"has no vessels of bench 'rxn'"),
        ({"vessels": [{"capacity_l": 1.0, "contents_mol": {"gold": 1.0}}]}, r"vessel 0: unknown 'gold'"),
        ({"vessels": [{"capacity_l": 1.0, "contents_mol": {}, "last_bench": "submit"}]}, r"unknown 'submit'"),
        ({"same_as": "../x.json"}, r"same_as: .*pattern"),
        ({"same_as": "nowhere.json"}, r"nowhere.json: no such file"),
    ],
)
def test_recorded_vessels_that_do_not_fit(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text('base = "wurtz_dodecane"\nname = "lab"\n')
    content = {
        "scenario": "lab",
        "vessels": [{"capacity_l": 1.0, "contents_mol": {"water": 1.0}, "last_bench": "dit"}],
        "benches": {"rxn": {"dodecane": [0, 0]}},
    }
    path = tmp_path / "lab.starts.json"
    path.write_text(json.dumps(content))
    first, second = lab_starts(load_scenario(tmp_path / "lab.toml"), "rxn")
    assert first == second
    assert (first.goal, first.contents_mol, first.last_bench) == ("dodecane", {"water": 1.0}, "dit")
    path.write_text(json.dumps({**content, **change}))
    with pytest.raises(DataError, match=message):
        lab_starts(load_scenario(tmp_path / "lab.toml"), "rxn")


@pytest.mark.parametrize("name", ["", '\nname = "wurtz_dodecane"'])
def test_files_that_inherit_have_starts_of_their_own(name: str, tmp_path: Path) -> None:
    """A file without a name is called as its file; even one with the base's name does not touch what comes with it."""
    file = tmp_path / "2 My-lab.toml"
    file.write_text(f'base = "wurtz_dodecane"{name}\n')
    scenario = load_scenario(file)
    assert scenario.name == ("wurtz_dodecane" if name else "my_lab")
    assert starts_file(scenario) == tmp_path / "2 My-lab.starts.json"
    shipped = load_scenario("wurtz_dodecane")
    assert starts_file(load_scenario(shipped.model_dump())) == starts_file(shipped)


def test_what_is_recorded_is_read_again_and_stored_once(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text('base = "wurtz_dodecane"\nname = "lab"\n')
    scenario = load_scenario(tmp_path / "lab.toml")
    one, two = Start("dodecane", 1.0, 1.2, {"water": 1.25}), Start("NaCl", 1.0, 1.2, {"water": 1.25}, "dit", 2)
    recorded = {"dit": [one, one, two, one], "submit": [two, one._replace(goal="NaCl")]}
    write_starts(starts_file(scenario), scenario, recorded)
    assert len(json.loads(starts_file(scenario).read_text())["vessels"]) == 2
    # Grouped by goal, in the order of recording within each: that is what is drawn from.
    assert lab_starts(scenario, "dit") == [one, one, one, two]
    assert lab_starts(scenario, "submit") == recorded["submit"]


@pytest.mark.parametrize("path", sorted((Path(chemlab.__file__).parent / "data" / "starts").glob("*.json")))
def test_no_shipped_vessel_is_stored_twice(path: Path) -> None:
    vessels = json.loads(path.read_text()).get("vessels", [])
    assert len({json.dumps(vessel, sort_keys=True) for vessel in vessels}) == len(vessels)


def test_a_role_that_no_bench_has_is_refused(tmp_path: Path) -> None:
    """It would be an index beyond the manager's observation."""
    (tmp_path / "lab.toml").write_text('base = "wurtz_dodecane"\nname = "lab"\n')
    scenario = load_scenario(tmp_path / "lab.toml")

    def prepare(role: int) -> None:
        start = Start("dodecane", 1.0, 1.2, {"water": 1.25}, "dit", role)
        write_starts(starts_file(scenario), scenario, {"dit": [start]})
        Laboratories(scenario).prepare({"dit": 1.0})

    prepare(2)
    with pytest.raises(DataError, match="last_position = 3 must be below 3"):
        prepare(3)


def test_goals_that_a_bench_has_met(tmp_path: Path) -> None:
    """Of `relay` each oven has its own; where nothing fits that is recorded, all."""
    relay = load_scenario("relay")
    assert [goals_met(relay, bench) for bench in ("rxn", "fin")] == [["F"], ["E"]]
    file = tmp_path / "mine.toml"
    file.write_text('base = "relay"\nname = "mine"\n', encoding="utf-8")
    mine = load_scenario(file)
    assert goals_met(mine, "rxn") == ["F", "E"]
    starts_file(mine).write_text('{"scenario": "mine", "vessels": [], "benches": {}}', encoding="utf-8")
    assert goals_met(mine, "rxn") == ["F", "E"]
    said = r"no vessel of goal 'F' for bench 'fin'; choose from E by --goal .*--goals .*goals="
    with pytest.raises(DataError, match=said):
        RoleVectorEnv(1, "relay", bench="fin", starts="lab")


def test_hidden_contents_are_of_declared_vessels_only() -> None:
    """Recorded vessels keep what they held, declared ones get what is drawn, also where either may be drawn."""
    batch = ExperimentBatch("rush", "rxn", 32, starts="both")
    for member in batch.members.tolist():
        batch.seed(member, member)
    batch.reset(batch.members, world={"titre": {"rxn": 0.5}})
    pool, amounts = batch.pool.arrays, slice(AMOUNTS, AMOUNTS + len(batch.scenario.materials))
    kept = [np.flatnonzero((pool.rows[:, amounts] == row).all(axis=1)) for row in batch.shelf.vessels[:, 0, amounts]]
    assert {len(rows) > 0 for rows in kept} == {True, False}
    assert not pool.declared[np.concatenate(kept)].any()
