"""Conformance checks: they pass on every bundled scenario, and find faults that a user's parts can have."""

import json
import re
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import FEATURED, command, mapping, slow_but

from chemlab import conformance
from chemlab.config.datafile import DataError
from chemlab.config.inherit import scenario_names, synthesis_names
from chemlab.config.loading import load_scenario
from chemlab.conformance import CHECKS, check_scenario, doubts
from chemlab.lab.experiments import ExperimentBatch

PARTS = Path(__file__).parent / "parts"
SEEN = "return np.clip(litres / 5.0, 0.0, 1.0)[:, None]"
COUNTED = "CALLS.append(0)\n    return np.full((len(members), 1), len(CALLS) / 1e6)\n\n\nCALLS: list[int] = []"
FAULTS = {
    "spaces": (SEEN, "return 2.0 + litres[:, None]", "must be from 0 to 1"),
    "seeds": (SEEN, "return np.random.random((len(members), 1))", "the same seed gives another episode"),
    "copies": (SEEN, COUNTED, "continues differently"),
}


def written(folder: Path, old: str, new: str) -> Path:
    """The laboratory with parts of a user's own, with one line of its parts replaced."""
    text = (PARTS / "my_parts.py").read_text()
    assert old in text
    (folder / "my_parts.py").write_text(text.replace(old, new))
    path = folder / "my_laboratory.toml"
    path.write_text((PARTS / "my_laboratory.toml").read_text().replace("../bench/", f"{PARTS.parent}/bench/"))
    return path


@pytest.mark.parametrize("name", slow_but([*scenario_names(), *synthesis_names()], *FEATURED))
def test_bundled_scenarios_conform(name: str) -> None:
    results = list(check_scenario(name))
    assert [result.name for result in results] == list(CHECKS)
    assert [(result.name, result.error) for result in results if result.error] == []


def test_parts_of_a_user_and_discrete_actions_conform(tmp_path: Path) -> None:
    for one in (written(tmp_path, "", ""), load_scenario("wurtz_dodecane").configured(actions="discrete")):
        assert [result.error for result in check_scenario(one)] == [None] * len(CHECKS)


@pytest.mark.parametrize("check", FAULTS)
def test_a_fault_is_found(check: str, tmp_path: Path) -> None:
    old, new, message = FAULTS[check]
    with pytest.raises(Exception, match=message):
        CHECKS[check][1](load_scenario(written(tmp_path, old, new)))


def test_a_wrong_mask_is_found_at_a_bench_that_is_rarely_started(tmp_path: Path) -> None:
    text = (PARTS.parent / "bench" / "filtration_bench.py").read_text()
    file, mask = tmp_path / "filter.py", "row[FILTER] = experiments.busy[m] and self._wet(shelf, experiments, m)"
    assert mask in text
    file.write_text(text.replace(mask, "row[FILTER] = 1"))
    benches = {"fil": {"kind": f"{file}:FiltrationBench", "step_limit": 5}}
    with pytest.raises(Exception, match="fil_0: an action that its mask allows was invalid"):
        CHECKS["spaces"][1](load_scenario({"base": "wurtz_dodecane", "name": "filtered", "benches": benches}))


CLOGGED = """
import numpy as np
from clogging_bench import CloggingBench


class Bench(CloggingBench):
    def see(self, shelf, experiments, members, out):
        super().see(shelf, experiments, members, out)
        out[:, 0] = np.minimum(experiments.clogged[members] / 10.0, 1.0)
"""


def test_a_bench_carries_nothing_into_the_next_experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PARTS.parent / "bench"))
    (tmp_path / "clogged.py").write_text(CLOGGED)
    file = tmp_path / "clogged.toml"
    bench = '[benches.fil]\nkind = "clogged.py:Bench"\nstep_limit = 5\nstart = { contents = { water = 1.0 } }\n'
    file.write_text(f'base = "wurtz_dodecane"\n{bench}')
    spec = load_scenario(file)
    CHECKS["seeds"][1](spec)
    reset = ExperimentBatch.reset

    def carried(batch: ExperimentBatch, *arguments: Any, **more: Any) -> None:
        kept = getattr(batch.experiments, "clogged", np.zeros(1)).copy()
        reset(batch, *arguments, **more)
        getattr(batch.experiments, "clogged", np.zeros(1))[:] = kept

    monkeypatch.setattr(ExperimentBatch, "reset", carried)
    with pytest.raises(Exception, match=r"benches\.fil alone: the same seed"):
        CHECKS["seeds"][1](spec)


@pytest.mark.parametrize("name", FEATURED)
def test_bundled_scenarios_leave_no_doubt(name: str) -> None:
    assert doubts(load_scenario(name)) == []


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("stock", {"Na": 0.0}, "benches.rxn: adds 'Na', which is not in stock"),
        ("stock", {"Na": 0.0}, "goals: no reaction makes 'dodecane' from the materials in stock"),
        ("goals", ["dodecane", "NaCl", "hexane"], "goals: no reaction makes 'hexane'"),
        ("theoretical_maximum_mol", {"dodecane": 500.0}, "dodecane: 500 mol, but the atoms in stock .* enough for"),
        ("temperature_k", {"low": 60.0, "high": 100.0, "step": 10.0}, "high = 100 K is -173 degrees Celsius"),
        ("demand", {"missed": 0.1}, "demand: an order is met by any trace of 'dodecane': give specifications"),
        ("demand", {"order": [{"price": 3.0}]}, "demand: an order is met by any trace of 'dodecane'"),
    ],
)
def test_what_can_hardly_be_meant(key: str, value: Any, words: str) -> None:
    tables = mapping("wurtz_dodecane_direct")
    table = tables["benches"]["rxn"] if key == "temperature_k" else tables
    table[key] = {**table.get(key, {}), **value} if isinstance(value, dict) else value
    assert re.search(words, "\n".join(doubts(load_scenario(tables))))


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        ({"composition": {"C": 4.0, "H": 9.0, "O": 1.0}}, "composition: differs from the formula C4H10O"),
        ({"vaporization_enthalpy_j_mol": 26.52}, "vaporization_enthalpy_j_mol: 26.52 is little .* in J/mol, not kJ"),
    ],
)
def test_doubtful_numbers_of_a_material(change: dict[str, Any], doubt: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario({"base": "wurtz_dodecane_direct"})
    ether = scenario.materials["diethyl_ether"].model_copy(update=change)
    monkeypatch.setitem(scenario.materials, "diethyl_ether", ether)
    assert re.match(rf"materials.diethyl_ether.{doubt}", "\n".join(doubts(scenario)))


def test_an_activation_energy_in_kilojoules_is_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario(mapping("wurtz_dodecane_direct"))
    first, *others = scenario.family.reaction
    steps = (first.model_copy(update={"activation_energy_j_mol": 9.0}), *others)
    monkeypatch.setattr(scenario, "_family", scenario.family.model_copy(update={"reaction": steps}))
    assert re.match(r"reactions: 2 1-chlorohexane .*: activation_energy_j_mol = 9;", "\n".join(doubts(scenario)))


def test_options_of_a_bench_of_ones_own_mean_what_it_says(tmp_path: Path) -> None:
    bench = "from pydantic import BaseModel\nfrom filtration_bench import FiltrationBench\n\n\n"
    bench += "class Options(BaseModel):\n    temperature_k: float\n    process: list[str]\n\n\n"
    bench += "class Bench(FiltrationBench):\n    options_model = Options\n"
    (tmp_path / "own.py").write_text(f"import sys\n\nsys.path.append({str(PARTS.parent / 'bench')!r})\n{bench}")
    entry = 'kind = "own.py:Bench"\nstep_limit = 5\ntemperature_k = 90.0\nprocess = ["settle"]\n'
    (tmp_path / "a.toml").write_text(f'base = "wurtz_dodecane"\n[benches.fil]\n{entry}')
    assert doubts(load_scenario(tmp_path / "a.toml")) == []


def test_the_highest_limits_take_no_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = load_scenario({"base": "wurtz_dodecane", "limits": {"ticks": 100_000, "manager_actions": 100_000}})
    rounds: list[int] = []
    over = types.SimpleNamespace(over=True)
    monkeypatch.setattr(conformance, "_played", lambda spec, seed, most: rounds.append(most) or over)
    CHECKS["end"][1](spec)
    assert rounds[0] <= 10_001


def test_every_level_of_a_file_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('base = "wurtz_dodecane"\n[levels.1.limits]\nticks = -3\n')
    with pytest.raises(DataError, match=r"a\.toml: limits\.ticks: .*greater than or equal to 1"):
        doubts(load_scenario(tmp_path / "a.toml"))


def test_the_command(tmp_path: Path) -> None:
    assert command("check", "fictitious").count("passed") == len(CHECKS)
    file = written(tmp_path, "turn.waste[turn.material] += mol", "turn.waste[turn.material] += 0.5 * mol")
    command("check", file, code=2)
    (fault,) = [one for one in json.loads(command("check", file, "--trust", "--json", code=1)) if one["error"]]
    assert (fault["name"], "C changed by" in fault["error"]) == ("conservation", True)
    (tmp_path / "own.py").write_text("class Model:\n    def __init__(self, spec):\n        self.names = spec.nmaes\n")
    (tmp_path / "a.toml").write_text('base = "wurtz_dodecane"\n[benches.rxn]\nmodel = "own.py:Model"\n')
    said = command("check", tmp_path / "a.toml", "--trust", code=2)
    assert ('own.py", line 3' in said, "error: " in said, "site-packages/typer" in said) == (True, True, False)
